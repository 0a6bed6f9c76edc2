//! Where the bytes of an image are: a file that is opened when it is needed, or bytes at hand.
//!
//! A series may have thousands of files, so none is kept open. Guaranteed: a file that is no
//! longer what it was when its header was read is an error.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::map::Fingerprint;
use crate::options::IoMode;

#[derive(Debug)]
pub(super) enum Place {
    File {
        path: PathBuf,
        fingerprint: Fingerprint,
        length: u64,
    },
    Bytes(FileBytes),
}

impl Place {
    /// The file at `path`, and its bytes for now.
    pub(super) fn of_file(path: &Path) -> Result<(Self, FileBytes), Error> {
        let failed = |e| Error::io(path.display().to_string(), "cannot be opened", e);
        let file = File::open(path).map_err(failed)?;
        let metadata = file.metadata().map_err(failed)?;
        let place = Self::File {
            path: path.to_path_buf(),
            fingerprint: Fingerprint::of(&metadata),
            length: metadata.len(),
        };
        Ok((place, FileBytes::of_file(file, path, IoMode::Read)?))
    }

    /// The bytes, the same as when the place was made. [`FileBytes::check`] them after use.
    pub(super) fn bytes(&self) -> Result<FileBytes, Error> {
        match self {
            Self::File {
                path, fingerprint, ..
            } => {
                let file = File::open(path).map_err(|e| {
                    Error::io(path.display().to_string(), "cannot be opened again", e)
                })?;
                fingerprint.check(&file, Some(path))?;
                FileBytes::of_file(file, path, IoMode::Read)
            }
            Self::Bytes(bytes) => {
                bytes.check()?;
                Ok(bytes.clone())
            }
        }
    }

    pub(super) fn len(&self) -> u64 {
        match self {
            Self::File { length, .. } => *length,
            Self::Bytes(bytes) => bytes.len(),
        }
    }

    /// The name in messages.
    pub(super) fn name(&self) -> String {
        match self {
            Self::File { path, .. } => path.display().to_string(),
            Self::Bytes(bytes) => bytes.name().to_string(),
        }
    }

    /// The name without its folder, for lists.
    pub(super) fn short_name(&self) -> String {
        let path = match self {
            Self::File { path, .. } => Some(path.as_path()),
            Self::Bytes(bytes) => bytes.path(),
        };
        path.and_then(Path::file_name)
            .map_or_else(|| self.name(), |name| name.to_string_lossy().into_owned())
    }
}
