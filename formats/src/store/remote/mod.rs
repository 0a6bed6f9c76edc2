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

mod url;

use crate::error::Error;
use crate::options::OpenOptions;
use crate::volume::Volume;

use url::Address;

/// Opens the volume at an address: `http://`, `https://` or `s3://BUCKET/KEY`.
///
/// For S3, the region is that of `AWS_REGION` or the profile, the endpoint that of
/// `AWS_ENDPOINT_URL`, and the credentials those of `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`
/// and `AWS_SESSION_TOKEN`, or of the profile `AWS_PROFILE`; without any, requests are anonymous.
/// `CURVOX_HTTP_TIMEOUT` is how many seconds a silent server is waited for, 30 if not set.
///
/// # Errors
///
/// As [`open`](crate::open), if the server does not answer or refuses to, and if this build was
/// made without the feature `remote`.
pub fn open_url(url: &str, options: &OpenOptions) -> Result<Volume, Error> {
    let address = Address::parse(url)?;
    open_address(&address, options)
}

#[cfg(not(feature = "remote"))]
fn open_address(address: &Address, _: &OpenOptions) -> Result<Volume, Error> {
    Err(Error::unsupported(
        address.name(),
        "this build reads no addresses: it was made without the feature 'remote'",
    ))
}

#[cfg(feature = "remote")]
fn open_address(address: &Address, options: &OpenOptions) -> Result<Volume, Error> {
    use std::sync::Arc;

    use crate::crop::crop;
    use crate::header::Format;
    use crate::open::open_stream;
    use crate::zarr;

    let objects = Arc::new(objects::Objects::new(address)?);
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
                return match &options.region {
                    None => Ok(Some(volume)),
                    Some(region) => crop(volume, region).map(Some),
                };
            }
        }
        Ok(None)
    };
    let file = || match objects.stream()? {
        Some(body) => open_stream(Box::new(body), &address.name(), options).map(Some),
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
