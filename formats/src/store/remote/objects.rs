//! A web server or a bucket as a place with objects.

use std::sync::{Mutex, PoisonError};

use ureq::Body;
use ureq::http::Response;

use super::body::Streamed;
use super::bucket::{Bucket, error_code, page};
use super::client::{Client, Failure, Request, header, read_body, status_text};
use super::url::{Address, Scheme, encode_path};
use crate::error::Error;
use crate::store::{Part, Stamp, Store};

/// A server that does not serve parts gives the whole object instead; up to this size it is
/// taken for the part that is wanted.
const WHOLE_MOST: u64 = 64 << 20;

/// Files whose absence says something. A server that does not tell strangers what is missing
/// refuses them instead, as S3 does.
const METADATA: [&str; 6] = [
    "zarr.json",
    ".zarray",
    ".zgroup",
    ".zattrs",
    ".zmetadata",
    "attributes.json",
];

/// Objects on a server.
pub(super) struct Objects {
    client: Client,
    place: Place,
    name: String,
    /// The message of the first refusal that was taken for a missing file.
    denied: Mutex<Option<String>>,
}

enum Place {
    Web(Address),
    Bucket(Bucket),
}

impl Objects {
    pub(super) fn new(address: &Address) -> Result<Self, Error> {
        let (place, client) = match address.scheme {
            Scheme::S3 => {
                let bucket = Bucket::new(address)?;
                let client = Client::new(bucket.is_secure(), true);
                (Place::Bucket(bucket), client)
            }
            scheme => (
                Place::Web(address.clone()),
                Client::new(scheme == Scheme::Https, false),
            ),
        };
        Ok(Self {
            client,
            place,
            name: address.name(),
            denied: Mutex::default(),
        })
    }

    /// The refusal that may be why nothing was found.
    pub(super) fn denied(&self) -> Option<Error> {
        let denied = self.denied.lock().unwrap_or_else(PoisonError::into_inner);
        let message = denied.clone()?;
        Some(refused(&self.name, message))
    }

    /// The object itself as a stream; `None` where it is not there.
    pub(super) fn stream(self: &std::sync::Arc<Self>) -> Result<Option<Streamed>, Error> {
        let answer = self.client.retry(&self.name, || self.open("", None))?;
        Ok(answer.map(|response| Streamed::new(std::sync::Arc::clone(self), response)))
    }

    /// Asks for what follows `from` of the streamed object; an answer with all of it is a failure.
    pub(super) fn resume(&self, from: u64) -> Result<Response<Body>, Error> {
        let range = format!("bytes={from}-");
        self.client.retry(&self.name, || {
            let response = self.open("", Some(&range))?.ok_or_else(|| {
                Failure::Final(Error::invalid(&self.name, "is gone while it is read"))
            })?;
            if content_range(&response).is_none_or(|(first, _)| first != from) {
                return Err(Failure::Final(Error::invalid(
                    &self.name,
                    format!("breaks off at byte {from}, and the server does not serve the rest"),
                )));
            }
            Ok(response)
        })
    }

    fn request(&self, key: &str, range: Option<&str>) -> Request {
        match &self.place {
            Place::Bucket(bucket) => bucket.object(key, range),
            Place::Web(address) => {
                let mut url = address.name();
                if !key.is_empty() {
                    url.push('/');
                    url.push_str(&encode_path(key));
                }
                if let Some(query) = &address.query {
                    url.push('?');
                    url.push_str(query);
                }
                let range = range.map(|range| ("range", range.to_string()));
                Request {
                    url,
                    headers: range.into_iter().collect(),
                }
            }
        }
    }

    /// Sends a request and judges the answer: one with the object, or none.
    fn open(&self, key: &str, range: Option<&str>) -> Result<Option<Response<Body>>, Failure> {
        let name = Store::name(self, key);
        let response = self.client.send(&name, &self.request(key, range))?;
        self.judge(&name, key, response)
    }

    fn judge(
        &self,
        name: &str,
        key: &str,
        response: Response<Body>,
    ) -> Result<Option<Response<Body>>, Failure> {
        let text = status_text(&response);
        let status = response.status().as_u16();
        // A bucket in another region says so.
        if let Place::Bucket(bucket) = &self.place
            && matches!(status, 301 | 307 | 400)
            && let Some(region) = header(&response, "x-amz-bucket-region")
            && bucket.move_to(region)
        {
            return Err(Failure::Passing {
                message: "the bucket is in another region".into(),
                pause: Some(std::time::Duration::ZERO),
            });
        }
        match status {
            200 | 206 => {
                let coding = header(&response, "content-encoding").unwrap_or("identity");
                if coding.eq_ignore_ascii_case("identity") {
                    return Ok(Some(response));
                }
                let coding: String = coding.chars().take(20).collect();
                Err(Failure::Final(Error::unsupported(
                    name,
                    format!("is served with the encoding '{coding}', which was not asked for"),
                )))
            }
            404 | 410 => Ok(None),
            416 => Err(Failure::Final(Error::invalid(
                name,
                "ends early: the server does not have the part that is expected",
            ))),
            401 | 403 => {
                let message = match self.reason(name, response) {
                    Some(code) => format!("{text}, {code}"),
                    None => text,
                };
                if METADATA.contains(&key.rsplit('/').next().unwrap_or_default()) {
                    let mut denied = self.denied.lock().unwrap_or_else(PoisonError::into_inner);
                    denied.get_or_insert(message);
                    return Ok(None);
                }
                Err(Failure::Final(refused(name, message)))
            }
            300..=399 => Err(Failure::Final(other(
                name,
                format!("the server redirects too often, or to nowhere ({text})"),
            ))),
            _ => {
                let code = self.reason(name, response);
                let code = code.map(|code| format!(", {code}")).unwrap_or_default();
                Err(Failure::Final(other(
                    name,
                    format!("the server answers {text}{code}"),
                )))
            }
        }
    }

    /// The code that S3 gives with an error. Nothing else of it: it repeats keys and signatures.
    fn reason(&self, name: &str, response: Response<Body>) -> Option<String> {
        if matches!(self.place, Place::Web(_)) {
            return None;
        }
        let mut body = Vec::new();
        read_body(name, response, 1 << 16, &mut body).ok()?;
        error_code(&String::from_utf8_lossy(&body)).map(str::to_string)
    }

    fn read(
        &self,
        name: &str,
        key: &str,
        part: Part,
        out: &mut Vec<u8>,
    ) -> Result<Option<Stamp>, Failure> {
        let range = match part {
            Part::All { .. } => None,
            Part::At { offset, count } => {
                let last = offset.saturating_add(count).saturating_sub(1);
                Some(format!("bytes={offset}-{last}"))
            }
            Part::Last { count } => Some(format!("bytes=-{count}")),
        };
        let Some(response) = self.open(key, range.as_deref())? else {
            return Ok(None);
        };
        let stamp = stamp(&response);
        let most = part.most();
        if response.status().as_u16() == 206 {
            let right = match (part, content_range(&response)) {
                (Part::At { offset, .. }, Some((first, _))) => first == offset,
                (Part::Last { count }, Some((first, Some(length)))) => {
                    length.checked_sub(count) == Some(first)
                }
                (Part::Last { .. }, Some((_, None))) => true,
                _ => false,
            };
            if !right {
                // Fewer bytes than the last so many: all there are.
                let (_, length) = content_range(&response).unwrap_or((0, None));
                if let Some(length) = length {
                    part.check(name, length)?;
                }
                return Err(Failure::Final(other(
                    name,
                    "the server gives another part than asked for".into(),
                )));
            }
            read_body(name, response, most, out)?;
            if out.len() as u64 != most {
                return Err(Failure::Final(Error::invalid(
                    name,
                    format!("ends early: {} bytes found, {most} expected", out.len()),
                )));
            }
            return Ok(Some(stamp));
        }
        if let Part::All { .. } = part {
            read_body(name, response, most, out)?;
            return Ok(Some(stamp));
        }
        let length = response.body().content_length();
        if length.is_none_or(|length| length > WHOLE_MOST) {
            return Err(Failure::Final(Error::unsupported(
                name,
                format!(
                    "the server does not serve parts of objects, and this one is larger than \
                     {WHOLE_MOST} bytes"
                ),
            )));
        }
        read_body(name, response, WHOLE_MOST, out)?;
        let length = out.len() as u64;
        part.check(name, length)?;
        let start = match part {
            Part::At { offset, .. } => offset,
            _ => length - most,
        };
        // Checked to lie within what was read.
        out.drain(..start as usize);
        out.truncate(most as usize);
        Ok(Some(stamp))
    }
}

fn refused(name: &str, message: String) -> Error {
    let source = std::io::Error::new(std::io::ErrorKind::PermissionDenied, message);
    Error::io(name, "access is refused", source)
}

fn other(name: &str, message: String) -> Error {
    Error::io(name, "cannot be read", std::io::Error::other(message))
}

/// The version of an object, where the server tells.
pub(super) fn stamp(response: &Response<Body>) -> Stamp {
    Stamp(header(response, "etag").map(str::to_string))
}

/// The first byte of a partial answer, and the length of the whole object.
fn content_range(response: &Response<Body>) -> Option<(u64, Option<u64>)> {
    let (range, length) = header(response, "content-range")?
        .strip_prefix("bytes ")?
        .split_once('/')?;
    let (first, _) = range.split_once('-')?;
    Some((first.trim().parse().ok()?, length.trim().parse().ok()))
}

impl Store for Objects {
    fn name(&self, key: &str) -> String {
        if key.is_empty() {
            self.name.clone()
        } else {
            format!("{}/{key}", self.name)
        }
    }

    fn get(&self, key: &str, part: Part, out: &mut Vec<u8>) -> Result<Option<Stamp>, Error> {
        out.clear();
        if part.most() == 0 {
            return Ok(Some(Stamp(None)));
        }
        let name = Store::name(self, key);
        self.client
            .retry(&name, || self.read(&name, key, part, out))
    }

    fn children(&self, key: &str) -> Result<Option<Vec<String>>, Error> {
        /// Of 1000 names each.
        const MOST_PAGES: usize = 20;
        const MOST_PAGE_BYTES: u64 = 8 << 20;
        let Place::Bucket(bucket) = &self.place else {
            return Ok(None);
        };
        let name = Store::name(self, key);
        let mut names = Vec::new();
        let mut next: Option<String> = None;
        for _ in 0..MOST_PAGES {
            let mut body = Vec::new();
            let found = self.client.retry(&name, || {
                let request = bucket.list(key, next.as_deref());
                let response = self.client.send(&name, &request)?;
                let Some(response) = self.judge(&name, "", response)? else {
                    return Ok(false);
                };
                read_body(&name, response, MOST_PAGE_BYTES, &mut body)?;
                Ok(true)
            })?;
            if !found {
                break;
            }
            let found = page(&String::from_utf8_lossy(&body));
            names.extend(found.names);
            next = found.next;
            if next.is_none() {
                break;
            }
        }
        names.sort();
        Ok(Some(names))
    }
}
