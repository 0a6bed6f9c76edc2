//! A bucket of S3, or of a server that speaks its language.
//!
//! In: the address of a bucket and a key, and the settings of AWS. Out: signed requests for
//! objects and for lists of them. At Amazon a bucket is part of the host's name, elsewhere of the
//! path.

use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use super::aws::{self, Settings};
use super::client::Request;
use super::sign::{self, Credentials, Unsigned};
use super::url::{Address, Scheme, decode, encode_path, encode_value};
use crate::error::Error;

/// A place in a bucket.
pub(super) struct Bucket {
    bucket: String,
    /// Key of the place, without slashes around it.
    prefix: String,
    endpoint: Option<Address>,
    /// The server may know better.
    region: Mutex<String>,
    credentials: Option<Credentials>,
}

impl Bucket {
    /// The bucket of an address `s3://`, with what the environment says.
    pub(super) fn new(address: &Address) -> Result<Self, Error> {
        let variable = |name: &str| std::env::var(name).ok();
        let home = std::env::home_dir();
        let settings = aws::settings(&variable, home.as_deref())?;
        Self::with(address, settings)
    }

    fn with(address: &Address, settings: Settings) -> Result<Self, Error> {
        if address.query.is_some() {
            return Err(Error::unsupported(
                address.name(),
                "an address s3:// has no query; '?' in a key is not read",
            ));
        }
        let endpoint = match &settings.endpoint {
            None => None,
            Some(url) => {
                let endpoint = Address::parse(url)?;
                if endpoint.scheme == Scheme::S3 || endpoint.query.is_some() {
                    return Err(Error::unsupported(
                        "AWS_ENDPOINT_URL",
                        "is no address of a server: http:// or https:// expected",
                    ));
                }
                Some(endpoint)
            }
        };
        let region = settings.region.unwrap_or_else(|| "us-east-1".into());
        check_region(&region)?;
        Ok(Self {
            bucket: address.authority.clone(),
            prefix: address.path.clone(),
            endpoint,
            region: Mutex::new(region),
            credentials: settings.credentials,
        })
    }

    /// Whether requests are encrypted.
    pub(super) fn is_secure(&self) -> bool {
        self.endpoint
            .as_ref()
            .is_none_or(|endpoint| endpoint.scheme == Scheme::Https)
    }

    fn region(&self) -> String {
        let region = self.region.lock().unwrap_or_else(PoisonError::into_inner);
        region.clone()
    }

    /// Takes the region that the server says the bucket is in; false if it was that already.
    pub(super) fn move_to(&self, region: &str) -> bool {
        let mut own = self.region.lock().unwrap_or_else(PoisonError::into_inner);
        if *own == region || check_region(region).is_err() {
            return false;
        }
        *own = region.to_string();
        true
    }

    fn key(&self, below: &str) -> String {
        match (self.prefix.as_str(), below) {
            (prefix, "") => prefix.to_string(),
            ("", below) => below.to_string(),
            (prefix, below) => format!("{prefix}/{below}"),
        }
    }

    /// The request for an object below the place.
    pub(super) fn object(&self, below: &str, range: Option<&str>) -> Request {
        self.request(&self.key(below), "", range)
    }

    /// The request for a page of the names directly below a key.
    pub(super) fn list(&self, below: &str, continued: Option<&str>) -> Request {
        let mut prefix = self.key(below);
        if !prefix.is_empty() {
            prefix.push('/');
        }
        let mut query = String::new();
        if let Some(token) = continued {
            query = format!("continuation-token={}&", encode_value(token));
        }
        query.push_str(&format!(
            "delimiter=%2F&encoding-type=url&list-type=2&prefix={}",
            encode_value(&prefix)
        ));
        self.request("", &query, None)
    }

    fn request(&self, key: &str, query: &str, range: Option<&str>) -> Request {
        let region = self.region();
        let bucket = &self.bucket;
        let (scheme, host, root) = match &self.endpoint {
            Some(endpoint) => {
                let root = match endpoint.path.as_str() {
                    "" => format!("/{bucket}"),
                    path => format!("/{path}/{bucket}"),
                };
                (endpoint.scheme.name(), endpoint.authority.clone(), root)
            }
            None => {
                let domain = if region.starts_with("cn-") {
                    "amazonaws.com.cn"
                } else {
                    "amazonaws.com"
                };
                let server = format!("s3.{region}.{domain}");
                // A name with dots is not covered by the server's certificate.
                if bucket.contains('.') {
                    ("https", server, format!("/{bucket}"))
                } else {
                    ("https", format!("{bucket}.{server}"), String::new())
                }
            }
        };
        let path = format!("{root}/{}", encode_path(key));
        let mut headers = Vec::new();
        if let Some(range) = range {
            headers.push(("range", range.to_string()));
        }
        if let Some(credentials) = &self.credentials {
            let unsigned = Unsigned {
                host: &host,
                path: &path,
                query,
                range,
                region: &region,
            };
            headers.extend(sign::headers(&unsigned, credentials, SystemTime::now()));
        }
        let question = if query.is_empty() { "" } else { "?" };
        Request {
            url: format!("{scheme}://{host}{path}{question}{query}"),
            headers,
        }
    }
}

fn check_region(region: &str) -> Result<(), Error> {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-';
    if !region.is_empty() && region.chars().all(plain) {
        return Ok(());
    }
    Err(Error::unsupported(
        "AWS_REGION",
        format!("'{}' is no name of a region", region.escape_debug()),
    ))
}

/// A page of names.
pub(super) struct Page {
    pub(super) names: Vec<String>,
    /// What to ask for the next page with.
    pub(super) next: Option<String>,
}

/// Reads the answer to [`Bucket::list`]: the last names of its common prefixes.
pub(super) fn page(xml: &str) -> Page {
    let mut names = Vec::new();
    let mut rest = xml;
    while let Some((inside, behind)) = element(rest, "CommonPrefixes") {
        if let Some((prefix, _)) = element(inside, "Prefix") {
            let prefix = decode(prefix);
            let name = prefix.trim_end_matches('/').rsplit('/').next();
            names.extend(name.filter(|name| !name.is_empty()).map(str::to_string));
        }
        rest = behind;
    }
    let next = element(xml, "NextContinuationToken").map(|(token, _)| unescape(token));
    Page { names, next }
}

/// The code of an error of S3, such as `NoSuchKey`.
pub(super) fn error_code(xml: &str) -> Option<&str> {
    let (code, _) = element(xml, "Code")?;
    let plain = code.len() < 64 && code.chars().all(|c| c.is_ascii_alphanumeric());
    Some(code).filter(|_| plain)
}

/// What stands in the first element of that name, and what behind it.
fn element<'a>(xml: &'a str, name: &str) -> Option<(&'a str, &'a str)> {
    let (_, rest) = xml.split_once(&format!("<{name}>"))?;
    rest.split_once(&format!("</{name}>"))
}

fn unescape(text: &str) -> String {
    text.replace("&lt;", "<")
        .replace("&gt;", ">")
        .replace("&quot;", "\"")
        .replace("&apos;", "'")
        .replace("&amp;", "&")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bucket(url: &str, endpoint: Option<&str>) -> Bucket {
        let settings = Settings {
            region: None,
            endpoint: endpoint.map(str::to_string),
            credentials: None,
        };
        Bucket::with(&Address::parse(url).unwrap(), settings).unwrap()
    }

    #[test]
    fn keys_become_addresses_at_amazon_and_elsewhere() {
        let here = bucket("s3://b/a z", None);
        let url = here.object("c/0/1", None).url;
        assert_eq!(url, "https://b.s3.us-east-1.amazonaws.com/a%20z/c/0/1");
        assert!(here.move_to("eu-west-1"));
        assert!(!here.move_to("eu-west-1"));
        assert!(!here.move_to("evil.org/"));
        let url = here.list("g", Some("t=")).url;
        assert_eq!(
            url,
            "https://b.s3.eu-west-1.amazonaws.com/?continuation-token=t%3D&delimiter=%2F&\
             encoding-type=url&list-type=2&prefix=a%20z%2Fg%2F"
        );
        let dots = bucket("s3://a.b/k", None).object("", None).url;
        assert_eq!(dots, "https://s3.us-east-1.amazonaws.com/a.b/k");
        let own = bucket("s3://b/k", Some("http://localhost:9000/s3/"));
        assert_eq!(own.object("x", None).url, "http://localhost:9000/s3/b/k/x");
        assert!(!own.is_secure());
    }

    #[test]
    fn lists_are_read_page_by_page() {
        let xml = "<?xml?><R><Prefix>x</Prefix><NextContinuationToken>a&amp;b</NextContinuationToken>\
                   <CommonPrefixes><Prefix>x/one%20two/</Prefix></CommonPrefixes>\
                   <CommonPrefixes><Prefix>x/3/</Prefix></CommonPrefixes></R>";
        let page = page(xml);
        assert_eq!(page.names, ["one two", "3"]);
        assert_eq!(page.next.as_deref(), Some("a&b"));
        assert_eq!(
            error_code("<Error><Code>NoSuchKey</Code>"),
            Some("NoSuchKey")
        );
        assert_eq!(error_code("<Code>a b</Code>"), None);
    }
}
