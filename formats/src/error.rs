//! What can go wrong while a volume is opened or read.
//!
//! An error says where (path, and byte offset where it applies), what was found and what was
//! expected, in one readable line. The kind tells a caller what to do about it.

use std::fmt;
use std::io;

/// What sort of failure an [`Error`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The input may be fine, but it is not something this crate reads, or a choice is missing.
    Unsupported,
    /// The input contradicts its own format: damaged, cut or written wrongly.
    Invalid,
    /// The system could not read (or write) the bytes.
    Io,
    /// The caller asked to stop.
    Cancelled,
}

/// A failure to open, read or write a volume.
#[derive(Debug)]
pub struct Error {
    kind: ErrorKind,
    path: String,
    offset: Option<u64>,
    message: String,
    source: Option<io::Error>,
}

impl Error {
    /// An error of the given kind about the input called `path`.
    pub fn new(kind: ErrorKind, path: impl Into<String>, message: impl Into<String>) -> Self {
        Self {
            kind,
            path: path.into(),
            offset: None,
            message: message.into(),
            source: None,
        }
    }

    /// Something this crate does not read.
    pub fn unsupported(path: impl Into<String>, message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Unsupported, path, message)
    }

    /// Bytes that contradict their own format.
    pub fn invalid(path: impl Into<String>, message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Invalid, path, message)
    }

    /// A failure of the system while doing `what`.
    pub fn io(path: impl Into<String>, what: &str, source: io::Error) -> Self {
        let mut error = Self::new(ErrorKind::Io, path, format!("{what}: {source}"));
        error.source = Some(source);
        error
    }

    /// The same error with the byte offset it is about, counted in the (decompressed) input.
    #[must_use]
    pub fn at(mut self, offset: u64) -> Self {
        self.offset = Some(offset);
        self
    }

    /// What sort of failure this is.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// Path or name of the input.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Byte offset the error is about, where there is one.
    pub fn offset(&self) -> Option<u64> {
        self.offset
    }

    /// What was found and what was expected, without the place.
    pub fn message(&self) -> &str {
        &self.message
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path)?;
        if let Some(offset) = self.offset {
            write!(f, ", byte {offset}")?;
        }
        write!(f, ": {}", self.message)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.source.as_ref().map(|e| e as _)
    }
}
