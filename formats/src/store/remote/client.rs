//! One request, and the same again when the server could not answer it.
//!
//! In: a request. Out: an answer that is final: found, not found, refused. What may pass (a busy
//! or failing server, a connection that breaks or is silent) is tried again with growing pauses.

use std::io::Read;
use std::thread::sleep;
use std::time::Duration;

use ureq::Body;
use ureq::http::Response;

use crate::error::Error;

/// Tries of one request, the first included. Pauses between them add up to three seconds.
const TRIES: u32 = 5;

const FIRST_PAUSE: Duration = Duration::from_millis(200);

/// The longest pause that a server can ask for.
const LONGEST_PAUSE: Duration = Duration::from_secs(10);

/// How long a server may be silent, unless said otherwise.
const SILENCE: Duration = Duration::from_secs(30);

const REDIRECTS: u32 = 5;

/// Connections to one host that are kept for the next request.
const KEPT_CONNECTIONS: usize = 32;

/// What is asked for.
pub(super) struct Request {
    pub(super) url: String,
    pub(super) headers: Vec<(&'static str, String)>,
}

/// Why there is no answer.
pub(super) enum Failure {
    /// May pass.
    Passing {
        message: String,
        /// The pause that the server asks for.
        pause: Option<Duration>,
    },
    Final(Error),
}

impl Failure {
    pub(super) fn passing(message: impl Into<String>) -> Self {
        Self::Passing {
            message: message.into(),
            pause: None,
        }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Final(error)
    }
}

/// Sends requests; shared between threads, which keep connections open for each other.
#[derive(Clone)]
pub(super) struct Client {
    agent: ureq::Agent,
}

impl Client {
    /// `secure` refuses redirects to unencrypted addresses, `signed` any redirects.
    pub(super) fn new(secure: bool, signed: bool) -> Self {
        let seconds = std::env::var("CURVOX_HTTP_TIMEOUT").ok();
        let seconds = seconds.and_then(|s| s.parse().ok());
        let silence = match seconds {
            Some(seconds @ 1..=3600) => Duration::from_secs(seconds),
            _ => SILENCE,
        };
        let config = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .https_only(secure)
            .max_redirects(if signed { 0 } else { REDIRECTS })
            .max_redirects_will_error(false)
            .accept_encoding("identity")
            .user_agent(concat!("curvox/", env!("CARGO_PKG_VERSION")))
            .max_idle_connections(4 * KEPT_CONNECTIONS)
            .max_idle_connections_per_host(KEPT_CONNECTIONS)
            .timeout_connect(Some(silence))
            .timeout_per_read(Some(silence))
            .timeout_per_write(Some(silence))
            .build();
        Self {
            agent: config.new_agent(),
        }
    }

    /// Tries until the failure is final, or was passing too often.
    pub(super) fn retry<T>(
        &self,
        name: &str,
        mut attempt: impl FnMut() -> Result<T, Failure>,
    ) -> Result<T, Error> {
        let mut tries = 1;
        let mut next = FIRST_PAUSE;
        loop {
            match attempt() {
                Ok(answer) => return Ok(answer),
                Err(Failure::Final(error)) => return Err(error),
                Err(Failure::Passing { message, pause }) => {
                    if tries == TRIES {
                        let source = std::io::Error::other(message);
                        return Err(Error::io(name, "no answer after 5 tries", source));
                    }
                    sleep(pause.unwrap_or(next).min(LONGEST_PAUSE));
                    next *= 2;
                    tries += 1;
                }
            }
        }
    }

    /// Sends a request once. Answers that may pass are failures here; others are given.
    pub(super) fn send(&self, name: &str, request: &Request) -> Result<Response<Body>, Failure> {
        let mut builder = self.agent.get(&request.url);
        for (header, value) in &request.headers {
            builder = builder.header(*header, value);
        }
        let response = builder.call().map_err(|e| failure(name, &e))?;
        let status = response.status().as_u16();
        if matches!(status, 408 | 429 | 500 | 502 | 503 | 504) {
            let pause = header(&response, "retry-after").and_then(|text| text.parse().ok());
            return Err(Failure::Passing {
                message: format!("the server answers {}", status_text(&response)),
                pause: pause.map(Duration::from_secs),
            });
        }
        Ok(response)
    }
}

/// A header of an answer, as text.
pub(super) fn header<'a>(response: &'a Response<Body>, name: &str) -> Option<&'a str> {
    response.headers().get(name)?.to_str().ok()
}

/// As `404 Not Found`.
pub(super) fn status_text(response: &Response<Body>) -> String {
    response.status().to_string()
}

/// Replaces `out` by the body of an answer, of at most so many bytes.
pub(super) fn read_body(
    name: &str,
    response: Response<Body>,
    most: u64,
    out: &mut Vec<u8>,
) -> Result<(), Failure> {
    out.clear();
    let length = response.body().content_length();
    let too_long = |length: u64| {
        Failure::Final(Error::invalid(
            name,
            format!("has {length} bytes or more, at most {most} are expected"),
        ))
    };
    if let Some(length) = length.filter(|length| *length > most) {
        return Err(too_long(length));
    }
    out.reserve(usize::try_from(length.unwrap_or(0)).unwrap_or(0));
    let reader = response.into_body().into_reader();
    let mut reader = reader.take(most.saturating_add(1));
    let read = reader.read_to_end(out);
    read.map_err(|e| Failure::passing(format!("the answer breaks off: {e}")))?;
    let found = out.len() as u64;
    if found > most {
        return Err(too_long(found));
    }
    if length.is_some_and(|length| length != found) {
        return Err(Failure::passing(format!(
            "the answer breaks off after {found} bytes"
        )));
    }
    Ok(())
}

/// What went wrong before there was an answer, in words without the address.
fn failure(name: &str, error: &ureq::Error) -> Failure {
    let stop = |message: String| {
        let source = std::io::Error::other(message);
        Failure::Final(Error::io(name, "cannot be asked for", source))
    };
    match error {
        ureq::Error::Timeout(_) => Failure::passing("the server is silent"),
        ureq::Error::Io(e) => match e.kind() {
            std::io::ErrorKind::TimedOut => Failure::passing("the server is silent"),
            // TLS failures come as these.
            std::io::ErrorKind::InvalidData => stop(format!("the secure connection fails: {e}")),
            _ => Failure::passing(format!("the connection fails: {e}")),
        },
        ureq::Error::ConnectionFailed => Failure::passing("the connection fails"),
        ureq::Error::Protocol(e) => Failure::passing(format!("the answer is not HTTP: {e}")),
        ureq::Error::HostNotFound => stop("the host is not known".into()),
        ureq::Error::Tls(e) => stop(format!("the secure connection fails: {e}")),
        ureq::Error::Rustls(e) => stop(format!("the secure connection fails: {e}")),
        ureq::Error::RequireHttpsOnly(_) => {
            stop("the server redirects to an address that is not secure".into())
        }
        ureq::Error::LargeResponseHeader(..) => stop("the header of the answer is too long".into()),
        ureq::Error::ConnectProxyFailed(_) => stop("the proxy refuses".into()),
        ureq::Error::InvalidProxyUrl => stop("the address of the proxy is wrong".into()),
        ureq::Error::BadUri(_) | ureq::Error::Http(_) => stop("the address is not valid".into()),
        _ => stop("the request cannot be made".into()),
    }
}
