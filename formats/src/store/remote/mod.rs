//! Volumes on web servers and in buckets.
//!
//! In: an address, `http://`, `https://` or `s3://`. Out: a [`Volume`]: a container in chunks,
//! whose objects are asked for one by one from the threads that read, or any other file, which
//! is streamed forward. Which of the two is found out by asking for the container's metadata.
//!
//! Credentials come from the environment or from the profile of AWS, never from an address: one
//! with a user and a password is refused. What is secret (keys, signatures, the query of an
//! address, which may hold a token) is in no message and in no name.
//!
//! Guaranteed: an answer is read up to the size that is expected of it; a server that fails or
//! is silent is asked again a few times, with growing pauses, and then it is an error; redirects
//! are followed a few times, and never with credentials. Not guaranteed: anything about a server
//! that changes an object while it is read, unless it tells versions apart (`ETag`).
//!
//! The client is `ureq`, with `rustls`: it blocks, as the threads that read do, and needs neither
//! a runtime nor a system library. Requests to S3 are signed here: the small crates for it sign
//! addresses instead of headers, and addresses end up in messages and logs.

#[cfg(feature = "remote")]
mod aws;

#[cfg(feature = "remote")]
mod body;

#[cfg(feature = "remote")]
mod bucket;

#[cfg(feature = "remote")]
mod client;

#[cfg(feature = "remote")]
mod objects;

#[cfg(feature = "remote")]
mod sign;

#[cfg(feature = "remote")]
mod url;

use crate::error::Error;
use crate::options::OpenOptions;
use crate::volume::Volume;

/// Whether a text is an address that [`open_url`](crate::open_url) takes, and not a path.
pub fn is_url(text: &str) -> bool {
    text.split_once("://").is_some_and(|(scheme, _)| {
        let known = ["http", "https", "s3"];
        known.iter().any(|known| known.eq_ignore_ascii_case(scheme))
    })
}

/// An address for a message or a record: without a user, a password and a query, which may hold a
/// token.
pub fn url_name(url: &str) -> String {
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

/// Opens all of the volume at an address.
#[cfg(not(feature = "remote"))]
pub(crate) fn open_whole_url(url: &str, _: &OpenOptions) -> Result<Volume, Error> {
    Err(Error::unsupported(
        url_name(url),
        "this build reads no addresses: it was made without the feature 'remote' (cargo install \
         curvox --features remote)",
    ))
}

/// Opens all of the volume at an address.
#[cfg(feature = "remote")]
pub(crate) fn open_whole_url(url: &str, options: &OpenOptions) -> Result<Volume, Error> {
    use std::sync::Arc;

    use crate::header::Format;
    use crate::open::open_whole_stream;
    use crate::zarr;

    let address = url::Address::parse(url)?;
    let objects = Arc::new(objects::Objects::new(&address)?);
    let formats = match options.format {
        _ if options.raw.is_some() => &[][..],
        Some(Format::Zarr) => &[Format::Zarr][..],
        Some(Format::N5) => &[Format::N5][..],
        Some(_) => &[][..],
        None if address.extension() == Some("n5") => &[Format::N5, Format::Zarr][..],
        None => &[Format::Zarr, Format::N5][..],
    };
    let container = || {
        for format in formats {
            if let Some(volume) = zarr::open(Arc::clone(&objects) as _, *format, options)? {
                return Ok(Some(volume));
            }
        }
        Ok(None)
    };
    let file = || match objects.stream()? {
        Some(body) => open_whole_stream(Box::new(body), &address.name(), options).map(Some),
        None => Ok(None),
    };
    // A name with an extension is most likely a file; others are most likely not.
    let is_file = address
        .extension()
        .is_some_and(|extension| !["zarr", "n5"].contains(&extension));
    let found = if formats.is_empty() {
        file()?
    } else if is_file {
        match file()? {
            Some(volume) => Some(volume),
            None => container()?,
        }
    } else {
        match container()? {
            Some(volume) => Some(volume),
            None => file()?,
        }
    };
    if let Some(volume) = found {
        return Ok(volume);
    }
    Err(objects.denied().unwrap_or_else(|| {
        Error::io(
            address.name(),
            "cannot be opened",
            std::io::Error::new(
                std::io::ErrorKind::NotFound,
                "not found (404): neither a file, nor metadata of Zarr or N5 below it",
            ),
        )
    }))
}
