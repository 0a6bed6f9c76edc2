//! What can go wrong when results are written or read back, with the place it happened.

use std::io;
use std::path::{Path, PathBuf};

use arrow_schema::ArrowError;
use parquet::errors::ParquetError;

/// An error of a sink, or of reading back what a sink wrote.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SinkError {
    /// The operating system refused an operation on a file.
    #[error("{}: {}{note}", path.display(), describe(operation, source))]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// What was being done, as a verb: "write", "create".
        operation: &'static str,
        /// Why it was refused.
        #[source]
        source: io::Error,
        /// What is left on disk, as a clause beginning with "; ", or nothing.
        note: String,
    },
    /// The reader of a pipe went away. A command line tool ends quietly here.
    #[error("{}: the reader closed the pipe", path.display())]
    BrokenPipe {
        /// The pipe, `-` for standard output.
        path: PathBuf,
    },
    /// Something is already there, and must not be overwritten.
    #[error("{}: {found}; {advice}", path.display())]
    Occupied {
        /// The place asked for.
        path: PathBuf,
        /// What was found.
        found: String,
        /// What to do about it.
        advice: &'static str,
    },
    /// A file is not what it should be.
    #[error("{}: {place}: found {found}, expected {expected}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The part of the file: a byte offset, a column, a field.
        place: String,
        /// What was found.
        found: String,
        /// What should have been there.
        expected: String,
    },
    /// The result of a run that did not reach its end.
    #[error("{}: {what}", path.display())]
    Incomplete {
        /// The directory of the run.
        path: PathBuf,
        /// How far it came.
        what: String,
    },
    /// A request that this output cannot carry.
    #[error("{0}")]
    Unsupported(String),
    /// Rows that break the contract of a sink: a bug of the caller, not of the input.
    #[error("internal error: {0}")]
    Contract(String),
}

/// Says in words why the system refused, most frequent reasons first.
fn describe(operation: &str, source: &io::Error) -> String {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "no space left on device".to_owned()
        }
        _ => format!("cannot {operation}: {source}"),
    }
}

impl SinkError {
    /// An [`SinkError::Io`], or [`SinkError::BrokenPipe`] if that is what it is.
    pub(crate) fn io(path: &Path, operation: &'static str, source: io::Error) -> Self {
        if source.kind() == io::ErrorKind::BrokenPipe {
            return SinkError::BrokenPipe {
                path: path.to_owned(),
            };
        }
        SinkError::Io {
            path: path.to_owned(),
            operation,
            source,
            note: String::new(),
        }
    }

    /// An error of the Parquet writer: nearly always the system's, passed through.
    pub(crate) fn parquet(path: &Path, operation: &'static str, error: ParquetError) -> Self {
        match error {
            ParquetError::External(inner) => match inner.downcast::<io::Error>() {
                Ok(source) => SinkError::io(path, operation, *source),
                Err(other) => SinkError::io(path, operation, io::Error::other(other)),
            },
            other => SinkError::io(path, operation, io::Error::other(other)),
        }
    }

    /// An error of the Arrow stream writer.
    pub(crate) fn arrow(path: &Path, operation: &'static str, error: ArrowError) -> Self {
        match error {
            ArrowError::IoError(_, source) => SinkError::io(path, operation, source),
            other => SinkError::io(path, operation, io::Error::other(other)),
        }
    }

    /// An error of the EXR writer.
    pub(crate) fn exr(path: &Path, operation: &'static str, error: exr::error::Error) -> Self {
        match error {
            exr::error::Error::Io(source) => SinkError::io(path, operation, source),
            other => SinkError::io(path, operation, io::Error::other(other)),
        }
    }

    /// Adds to an [`SinkError::Io`] what is left on disk.
    #[must_use]
    pub(crate) fn with_note(mut self, text: &str) -> Self {
        if let SinkError::Io { note, .. } = &mut self {
            *note = format!("; {text}");
        }
        self
    }

    /// Whether the reader of a pipe went away: not a failure worth a message.
    #[must_use]
    pub fn is_broken_pipe(&self) -> bool {
        matches!(self, SinkError::BrokenPipe { .. })
    }
}
