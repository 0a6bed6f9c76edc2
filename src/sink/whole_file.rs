//! A file that appears whole or not at all.
//!
//! Comes in: bytes. Goes out: the file under its name, once [`WholeFile::commit`] returned. Until
//! then the bytes are in a hidden temporary file of the same directory, `.NAME.partial`; dropping
//! the value removes it. A killed process may leave the temporary file, never half of the named
//! one. A target that exists and is no regular file (a pipe, `/dev/stdout`) is written directly.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::hash::Hasher;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use twox_hash::XxHash64;

use super::error::SinkError;

/// Ending of the temporary files; readers skip them because their names begin with a dot.
pub(crate) const PARTIAL: &str = ".partial";

/// A file under construction.
#[derive(Debug)]
pub(crate) struct WholeFile {
    target: PathBuf,
    /// `None` when the target is written directly, and once committed.
    temporary: Option<PathBuf>,
    file: File,
}

impl WholeFile {
    /// Begins a file that will be named `target`, replacing what is there.
    pub(crate) fn create(target: &Path) -> Result<Self, SinkError> {
        let special = fs::metadata(target).is_ok_and(|found| !found.is_file());
        let (path, temporary) = if special {
            (target.to_owned(), None)
        } else {
            let temporary = temporary_of(target);
            (temporary.clone(), Some(temporary))
        };
        let mut options = OpenOptions::new();
        // Some formats patch their header at the end, hence read as well.
        options
            .write(true)
            .read(!special)
            .create(!special)
            .truncate(!special);
        let file = options
            .open(&path)
            .map_err(|source| SinkError::io(target, "create", source))?;
        Ok(Self {
            target: target.to_owned(),
            temporary,
            file,
        })
    }

    /// Puts the bytes on the device and gives the file its name.
    pub(crate) fn commit(mut self) -> Result<(), SinkError> {
        let Some(temporary) = &self.temporary else {
            return Ok(());
        };
        self.file
            .sync_all()
            .map_err(|source| SinkError::io(&self.target, "write", source))?;
        fs::rename(temporary, &self.target)
            .map_err(|source| SinkError::io(&self.target, "name", source))?;
        self.temporary = None;
        sync_parent(&self.target);
        Ok(())
    }
}

/// Asks the system to keep the new name over a power cut.
///
/// Not all systems and file systems can open or sync a directory. The file itself is already
/// safe and named, so a refusal is no error.
fn sync_parent(path: &Path) {
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    if let Ok(directory) = File::open(parent) {
        let _ = directory.sync_all();
    }
}

/// The temporary name of a file: fixed, so that the next run overwrites what a killed one left.
pub(crate) fn temporary_of(target: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(target.file_name().unwrap_or_default());
    name.push(PARTIAL);
    target.with_file_name(name)
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        if let Some(temporary) = &self.temporary {
            // An error here has no one to go to; the name says what the file is.
            let _ = fs::remove_file(temporary);
        }
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Read for WholeFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.file.read(bytes)
    }
}

impl Seek for WholeFile {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.file.seek(position)
    }
}

/// A writer that counts and digests what passes through it.
pub(crate) struct Digesting<W> {
    inner: W,
    hash: XxHash64,
    bytes: u64,
}

impl<W> Digesting<W> {
    pub(crate) fn new(inner: W) -> Self {
        Self {
            inner,
            hash: XxHash64::with_seed(0),
            bytes: 0,
        }
    }

    /// The writer, the bytes it received and their checksum.
    pub(crate) fn into_parts(self) -> (W, u64, String) {
        (self.inner, self.bytes, checksum_text(&self.hash))
    }
}

impl<W: Write> Write for Digesting<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.hash.write(&bytes[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

fn checksum_text(hash: &XxHash64) -> String {
    format!("xxh64:{:016x}", hash.finish())
}

/// The checksum of a file, as written in `run.json`: 64-bit xxHash with seed 0.
///
/// # Errors
///
/// If the file cannot be read.
pub(crate) fn checksum_of_file(path: &Path) -> Result<String, SinkError> {
    let mut file = File::open(path).map_err(|source| SinkError::io(path, "open", source))?;
    let mut hash = XxHash64::with_seed(0);
    let mut buffer = vec![0; 1 << 18];
    loop {
        match file.read(&mut buffer) {
            Ok(0) => return Ok(checksum_text(&hash)),
            Ok(length) => hash.write(&buffer[..length]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(source) => return Err(SinkError::io(path, "read", source)),
        }
    }
}

/// Writes small text files (`run.json`, `summary.json`) whole or not at all.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), SinkError> {
    let mut file = WholeFile::create(path)?;
    file.write_all(bytes)
        .map_err(|source| SinkError::io(path, "write", source))?;
    file.commit()
}
