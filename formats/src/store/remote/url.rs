//! Addresses, taken apart and put together again.
//!
//! The query of an address may be a token: it is sent, and never shown. A user and a password are
//! refused, for command lines are seen by others and kept in histories.

use crate::error::Error;

/// Where a volume is.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct Address {
    pub(super) scheme: Scheme,
    /// Host and port, or the name of a bucket.
    pub(super) authority: String,
    /// Without slashes around it; not encoded for a bucket, as given otherwise.
    pub(super) path: String,
    /// Without the question mark.
    pub(super) query: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scheme {
    Http,
    Https,
    S3,
}

impl Scheme {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Http => "http",
            Self::Https => "https",
            Self::S3 => "s3",
        }
    }
}

impl Address {
    pub(super) fn parse(url: &str) -> Result<Self, Error> {
        let schemes = [Scheme::Http, Scheme::Https, Scheme::S3];
        let split = url.split_once("://").and_then(|(scheme, rest)| {
            let known = schemes
                .into_iter()
                .find(|known| known.name().eq_ignore_ascii_case(scheme))?;
            Some((known, rest))
        });
        let Some((scheme, rest)) = split else {
            return Err(Error::unsupported(
                shown(url),
                "is no address that is read: http://, https:// or s3:// expected",
            ));
        };
        let rest = rest.split('#').next().unwrap_or(rest);
        let (rest, query) = match rest.split_once('?') {
            Some((rest, query)) => (rest, Some(query.to_string())),
            None => (rest, None),
        };
        let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
        let path = path.trim_matches('/');
        if authority.contains('@') {
            return Err(Error::unsupported(
                shown(url),
                "a user or password in an address is not read: it would be seen by others",
            ));
        }
        let strange = |c: char| c.is_control() || c.is_whitespace();
        let in_bucket = scheme == Scheme::S3;
        let bad_path = match scheme {
            Scheme::S3 => path.contains(char::is_control),
            _ => path.contains(strange),
        };
        let bad_host = authority.is_empty()
            || !authority
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || ".-_:[]".contains(c))
            || (in_bucket && authority.contains([':', '[', ']']));
        if bad_host || bad_path || query.as_deref().is_some_and(|q| q.contains(strange)) {
            return Err(Error::unsupported(
                shown(url),
                format!(
                    "is not an address of the form {}",
                    match scheme {
                        Scheme::S3 => "s3://BUCKET/KEY",
                        _ => "http://HOST/PATH, with spaces and the like as %20",
                    }
                ),
            ));
        }
        Ok(Self {
            scheme,
            authority: authority.to_string(),
            path: path.to_string(),
            query,
        })
    }

    /// The address without anything secret.
    pub(super) fn name(&self) -> String {
        let (scheme, authority) = (self.scheme.name(), &self.authority);
        match self.path.as_str() {
            "" => format!("{scheme}://{authority}"),
            path => format!("{scheme}://{authority}/{path}"),
        }
    }

    /// The extension of the last name, in small letters.
    pub(super) fn extension(&self) -> Option<&'static str> {
        const CONTAINERS: [&str; 2] = ["zarr", "n5"];
        let name = self.path.rsplit('/').next()?;
        let (stem, extension) = name.rsplit_once('.')?;
        if stem.is_empty() || extension.is_empty() {
            return None;
        }
        let container = CONTAINERS
            .into_iter()
            .find(|known| known.eq_ignore_ascii_case(extension));
        Some(container.unwrap_or("other"))
    }
}

/// An address for a message, whatever it is: without a user, a password and a query.
fn shown(url: &str) -> String {
    let url = url.split(['?', '#']).next().unwrap_or_default();
    match url.split_once("://") {
        Some((scheme, rest)) => {
            let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
            let host = authority.rsplit('@').next().unwrap_or_default();
            format!("{scheme}://{host}/{path}")
        }
        None => match url.rsplit_once('@') {
            Some((_, rest)) => rest.to_string(),
            None => url.to_string(),
        },
    }
}

/// Encodes what is not plain in a path; slashes stay.
#[cfg(feature = "remote")]
pub(super) fn encode_path(path: &str) -> String {
    encode(path, b"-._~/")
}

/// Encodes what is not plain in a value of a query.
#[cfg(feature = "remote")]
pub(super) fn encode_value(value: &str) -> String {
    encode(value, b"-._~")
}

#[cfg(feature = "remote")]
fn encode(text: &str, plain: &[u8]) -> String {
    let mut out = String::with_capacity(text.len());
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || plain.contains(&byte) {
            out.push(char::from(byte));
        } else {
            out.push_str(&format!("%{byte:02X}"));
        }
    }
    out
}

/// Decodes `%20` and the like.
#[cfg(feature = "remote")]
pub(super) fn decode(text: &str) -> String {
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while let Some(&byte) = bytes.get(at) {
        let code = text
            .get(at + 1..at + 3)
            .filter(|_| byte == b'%')
            .and_then(|digits| u8::from_str_radix(digits, 16).ok());
        out.push(code.unwrap_or(byte));
        at += if code.is_some() { 3 } else { 1 };
    }
    String::from_utf8_lossy(&out).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_taken_apart_and_nothing_secret_is_shown() {
        let address = Address::parse("https://h.org:8080/a/b.zarr/?token=geheim#x").unwrap();
        assert_eq!(address.name(), "https://h.org:8080/a/b.zarr");
        assert_eq!(address.query.as_deref(), Some("token=geheim"));
        assert_eq!(address.extension(), Some("zarr"));
        let address = Address::parse("S3://bucket/some where/x.N5").unwrap();
        assert_eq!(address.scheme, Scheme::S3);
        assert_eq!(address.extension(), Some("n5"));
        assert_eq!(Address::parse("http://h").unwrap().name(), "http://h");
    }

    #[test]
    fn a_user_and_a_password_are_refused_and_not_repeated() {
        for url in [
            "https://me:geheim@h.org/a",
            "s3://geheim:geheim@bucket/a",
            "ftp://me:geheim@h.org/a",
            "me:geheim@h.org/a",
            "http://h.org/a b?geheim",
            "http:///geheim@",
        ] {
            let message = Address::parse(url).err().unwrap().to_string();
            let hidden = url.starts_with("http:///") || !message.contains("geheim");
            assert!(hidden, "{message}");
        }
    }

    #[cfg(feature = "remote")]
    #[test]
    fn what_is_encoded_is_decoded() {
        let text = "a b/\u{e9}%+~";
        assert_eq!(encode_path(text), "a%20b/%C3%A9%25%2B~");
        assert_eq!(decode(&encode_path(text)), text);
        assert_eq!(encode_value("a/b"), "a%2Fb");
        assert_eq!(decode("%zz%2"), "%zz%2");
    }
}
