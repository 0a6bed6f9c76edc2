//! What the environment and the files of AWS say: region, endpoint, credentials.
//!
//! In the order of AWS's own tools: variables of the environment, then the profile, in the file
//! of credentials and in that of settings. Read of a profile are keys; roles, single sign-on and
//! programs that print keys are not, and a profile that was asked for and has no keys is an error.

use std::path::{Path, PathBuf};

use super::sign::Credentials;
use crate::error::Error;

/// What there is to know.
pub(super) struct Settings {
    pub(super) region: Option<String>,
    pub(super) endpoint: Option<String>,
    pub(super) credentials: Option<Credentials>,
}

/// Keys and values of one section of a file.
struct Section(Vec<(String, String)>);

impl Section {
    fn get(&self, key: &str) -> Option<String> {
        let (_, value) = self.0.iter().find(|(known, _)| known == key)?;
        Some(value.clone()).filter(|value| !value.is_empty())
    }
}

/// Reads settings; `variable` gives the variables of the environment.
pub(super) fn settings(
    variable: &dyn Fn(&str) -> Option<String>,
    home: Option<&Path>,
) -> Result<Settings, Error> {
    let variable = |name: &str| variable(name).filter(|value| !value.is_empty());
    let asked = variable("AWS_PROFILE");
    let profile = asked.as_deref().unwrap_or("default");
    let file = |name: &str, usual: &str| match variable(name) {
        Some(path) => Some(PathBuf::from(path)),
        None => home.map(|home| home.join(".aws").join(usual)),
    };
    let keys = file("AWS_SHARED_CREDENTIALS_FILE", "credentials");
    let config = file("AWS_CONFIG_FILE", "config");
    let keys = section(keys, &[profile])?;
    let config = section(config, &[&format!("profile {profile}"), profile])?;
    if asked.is_some() && keys.is_none() && config.is_none() {
        return Err(Error::unsupported(
            "AWS_PROFILE",
            format!("there is no profile '{profile}' in the files of AWS"),
        ));
    }
    let of_profile = |key: &str| {
        [&keys, &config]
            .into_iter()
            .flatten()
            .find_map(|section| section.get(key))
    };
    let credentials = match (
        variable("AWS_ACCESS_KEY_ID"),
        variable("AWS_SECRET_ACCESS_KEY"),
    ) {
        (Some(access_key), Some(secret_key)) => Some(Credentials {
            access_key,
            secret_key,
            session_token: variable("AWS_SESSION_TOKEN"),
        }),
        (None, None) => match (
            of_profile("aws_access_key_id"),
            of_profile("aws_secret_access_key"),
        ) {
            (Some(access_key), Some(secret_key)) => Some(Credentials {
                access_key,
                secret_key,
                session_token: of_profile("aws_session_token"),
            }),
            _ if asked.is_some() => {
                return Err(Error::unsupported(
                    "AWS_PROFILE",
                    format!(
                        "the profile '{profile}' has no access key and secret key; roles and \
                         single sign-on are not read"
                    ),
                ));
            }
            _ => None,
        },
        (Some(_), None) => {
            return Err(Error::unsupported(
                "AWS_ACCESS_KEY_ID",
                "is set, and AWS_SECRET_ACCESS_KEY is not",
            ));
        }
        (None, Some(_)) => {
            return Err(Error::unsupported(
                "AWS_SECRET_ACCESS_KEY",
                "is set, and AWS_ACCESS_KEY_ID is not",
            ));
        }
    };
    if let Some(credentials) = &credentials {
        check(credentials)?;
    }
    Ok(Settings {
        region: variable("AWS_REGION")
            .or_else(|| variable("AWS_DEFAULT_REGION"))
            .or_else(|| of_profile("region")),
        endpoint: variable("AWS_ENDPOINT_URL_S3")
            .or_else(|| variable("AWS_ENDPOINT_URL"))
            .or_else(|| of_profile("endpoint_url")),
        credentials,
    })
}

/// Refuses what cannot stand in a header, without repeating it.
fn check(credentials: &Credentials) -> Result<(), Error> {
    let plain = |text: &str| text.bytes().all(|byte| byte.is_ascii_graphic());
    let token = credentials.session_token.as_deref().unwrap_or("");
    if plain(&credentials.access_key) && plain(&credentials.secret_key) && plain(token) {
        return Ok(());
    }
    Err(Error::unsupported(
        "AWS",
        "the access key, the secret key or the session token has characters that none has",
    ))
}

/// The first of the named sections of a file, if there is such a file and section.
fn section(path: Option<PathBuf>, names: &[&str]) -> Result<Option<Section>, Error> {
    /// More than any such file has.
    const MOST_BYTES: u64 = 1 << 20;
    let Some(path) = path else { return Ok(None) };
    let shown = path.display().to_string();
    let failed = |e| Error::io(&shown, "cannot be read", e);
    match std::fs::metadata(&path) {
        Ok(metadata) if metadata.is_file() && metadata.len() <= MOST_BYTES => {}
        Ok(_) => {
            return Err(Error::unsupported(
                &shown,
                "is not a file of AWS's settings",
            ));
        }
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(failed(e)),
    }
    let text = std::fs::read_to_string(&path).map_err(failed)?;
    let mut found: Option<Section> = None;
    let mut inside = false;
    for line in text.lines() {
        // Settings of settings are indented, and none of them is needed.
        if line.starts_with([' ', '\t', '#', ';']) {
            continue;
        }
        let line = line.trim();
        if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            let name: Vec<_> = name.split_whitespace().collect();
            inside = names.contains(&name.join(" ").as_str());
            if inside && found.is_none() {
                found = Some(Section(Vec::new()));
            }
        } else if inside
            && let Some(section) = &mut found
            && let Some((key, value)) = line.split_once('=')
        {
            let pair = (key.trim().to_ascii_lowercase(), value.trim().to_string());
            section.0.push(pair);
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(variables: &[(&str, &str)], home: Option<&Path>) -> Result<Settings, Error> {
        let variable = |name: &str| {
            let found = variables.iter().find(|(known, _)| *known == name)?;
            Some(found.1.to_string())
        };
        settings(&variable, home)
    }

    fn key(settings: &Settings) -> Option<&str> {
        settings.credentials.as_ref().map(|c| c.access_key.as_str())
    }

    #[test]
    fn variables_come_before_the_profile_and_nothing_is_anonymous() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join(".aws");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(
            folder.join("credentials"),
            "# keys\n[default]\naws_access_key_id = A\naws_secret_access_key=S\n\n[ two ]\n\
             aws_access_key_id = B\naws_secret_access_key = T\naws_session_token = U\n",
        )
        .unwrap();
        std::fs::write(
            folder.join("config"),
            "[default]\nregion = r1\n[profile two]\nregion=r2\ns3 =\n  region = no\n\
             endpoint_url = http://here\n[profile role]\nrole_arn = x\n",
        )
        .unwrap();
        let home = Some(home.path());
        let plain = read(&[], home).unwrap();
        assert_eq!(key(&plain), Some("A"));
        assert_eq!(plain.region.as_deref(), Some("r1"));
        assert_eq!(plain.endpoint, None);
        let two = read(&[("AWS_PROFILE", "two"), ("AWS_REGION", "r3")], home).unwrap();
        assert_eq!(key(&two), Some("B"));
        assert!(two.credentials.unwrap().session_token.is_some());
        assert_eq!(two.region.as_deref(), Some("r3"));
        assert_eq!(two.endpoint.as_deref(), Some("http://here"));
        let keys = [("AWS_ACCESS_KEY_ID", "C"), ("AWS_SECRET_ACCESS_KEY", "V")];
        assert_eq!(key(&read(&keys, home).unwrap()), Some("C"));
        assert!(read(&keys[..1], home).is_err());
        assert!(read(&[("AWS_PROFILE", "three")], home).is_err());
        assert!(read(&[("AWS_PROFILE", "role")], home).is_err());
        assert_eq!(key(&read(&[], None).unwrap()), None);
    }

    #[test]
    fn keys_with_strange_characters_are_refused_and_not_repeated() {
        let keys = [
            ("AWS_ACCESS_KEY_ID", "geheim\n"),
            ("AWS_SECRET_ACCESS_KEY", "geheim"),
        ];
        let message = read(&keys, None).err().unwrap().to_string();
        assert!(!message.contains("geheim"));
    }
}
