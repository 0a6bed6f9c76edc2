//! Objects with names, from where chunked formats read their metadata and chunks: a folder, a web
//! server, a bucket.
//!
//! In: a place, and keys such as `0/c/1/2/3`, relative to it. Out: the bytes of an object, or of
//! a part of it, or the news that it is not there. Guaranteed: no more bytes than the caller
//! allows are read or held; an object that is shorter than the part asked for is an error with
//! its name. Not guaranteed: that two parts are of the same version of an object, unless the
//! caller compares their [`Stamp`]s.

mod folder;

mod remote;

use crate::error::Error;

pub(crate) use folder::Folder;
pub use remote::open_url;

/// Which bytes of an object are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// All, if these are at most so many.
    All { most: u64 },
    /// Exactly `count` bytes from `offset` on.
    At { offset: u64, count: u64 },
    /// Exactly the last `count` bytes.
    Last { count: u64 },
}

impl Part {
    /// The most bytes that are wanted.
    pub(crate) fn most(self) -> u64 {
        match self {
            Self::All { most } => most,
            Self::At { count, .. } | Self::Last { count } => count,
        }
    }

    /// The error of an object of `length` bytes that does not have the part, if so.
    fn check(self, name: &str, length: u64) -> Result<(), Error> {
        match self {
            Self::All { most } if length > most => Err(Error::invalid(
                name,
                format!("has {length} bytes, at most {most} are expected"),
            )),
            Self::At { offset, count }
                if offset.checked_add(count).is_none_or(|end| end > length) =>
            {
                Err(Error::invalid(
                    name,
                    format!("ends early: {count} bytes expected at byte {offset}, it has {length}"),
                )
                .at(offset))
            }
            Self::Last { count } if count > length => Err(Error::invalid(
                name,
                format!("ends early: it has {length} bytes, the last {count} are expected"),
            )),
            _ => Ok(()),
        }
    }
}

/// What tells one version of an object from another, where that is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Stamp(Option<String>);

impl Stamp {
    /// Whether the two are known to be of different versions.
    pub(crate) fn differs(&self, other: &Self) -> bool {
        matches!((&self.0, &other.0), (Some(a), Some(b)) if a != b)
    }
}

/// A place with objects.
pub(crate) trait Store: Send + Sync {
    /// The name of an object in messages: its path, or its address without anything secret.
    fn name(&self, key: &str) -> String;

    /// Replaces `out` by a part of an object; `None` where there is no such object.
    ///
    /// # Errors
    ///
    /// If it cannot be read, or does not have that part.
    fn get(&self, key: &str, part: Part, out: &mut Vec<u8>) -> Result<Option<Stamp>, Error>;

    /// Whether an object is known not to be there, where that costs next to nothing to find out.
    fn lacks(&self, key: &str) -> bool {
        let _ = key;
        false
    }

    /// Names of what is directly below a key; `None` where the place cannot list.
    ///
    /// # Errors
    ///
    /// If it cannot be read.
    fn children(&self, key: &str) -> Result<Option<Vec<String>>, Error>;
}

/// Joins a key and a name below it.
pub(crate) fn join(key: &str, below: &str) -> String {
    if key.is_empty() {
        below.to_string()
    } else {
        format!("{key}/{below}")
    }
}
