//! The bytes of a file, anywhere in it: mapped, read at offsets, held in memory, or joined from
//! several files.
//!
//! In: a path, or bytes. Out: [`FileBytes`], which is cheap to clone and shared between threads.
//! Guaranteed: a range is checked against the length before anything is allocated; a file that
//! changes while it is used is an error of [`FileBytes::check`]. Not guaranteed: that bytes given
//! before a `check` are the file's, so use them first and trust them after it.

use std::borrow::Cow;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::error::Error;
use crate::map::{Fingerprint, GuardedMap};
use crate::options::IoMode;
use crate::volume::SourceInfo;

/// Bytes that can be read at any offset.
#[derive(Clone, Debug)]
pub(crate) struct FileBytes(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    name: String,
    path: Option<PathBuf>,
    length: u64,
    store: Store,
}

#[derive(Debug)]
enum Store {
    Map(GuardedMap),
    File {
        file: File,
        fingerprint: Fingerprint,
    },
    Memory(Vec<u8>),
    Joined(Vec<Segment>),
}

/// A run of bytes out of one of several files.
#[derive(Debug)]
struct Segment {
    path: PathBuf,
    fingerprint: Fingerprint,
    /// Where the run begins in its file, and in the whole.
    from: u64,
    start: u64,
    length: u64,
}

impl FileBytes {
    /// The bytes of the file at `path`.
    ///
    /// # Errors
    ///
    /// If it cannot be opened.
    pub(crate) fn open(path: &Path, io: IoMode) -> Result<Self, Error> {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|e| Error::io(&name, "cannot be opened", e))?;
        Self::of_file(file, path, io)
    }

    /// The bytes of `file`, which was opened from `path`.
    ///
    /// # Errors
    ///
    /// If it cannot be examined.
    pub(crate) fn of_file(file: File, path: &Path, io: IoMode) -> Result<Self, Error> {
        let name = path.display().to_string();
        let failed = |e| Error::io(&name, "cannot be read", e);
        let map = match io {
            IoMode::Map => true,
            IoMode::Read => false,
            IoMode::Auto => !is_remote(&file),
        };
        let length = file.metadata().map_err(failed)?.len();
        // Address space can be short (32 bits) and guards can run out: then read.
        let mapped = if map {
            let again = file.try_clone().map_err(failed)?;
            GuardedMap::new(again, path).ok().flatten()
        } else {
            None
        };
        let store = match mapped {
            Some(map) => Store::Map(map),
            None => Store::File {
                fingerprint: Fingerprint::of(&file.metadata().map_err(failed)?),
                file,
            },
        };
        Ok(Self::new(name, Some(path.to_path_buf()), length, store))
    }

    /// The bytes of a file that has no path any more.
    ///
    /// # Errors
    ///
    /// If it cannot be examined.
    pub(crate) fn of_unnamed(file: File, name: &str) -> Result<Self, Error> {
        let metadata = file
            .metadata()
            .map_err(|e| Error::io(name, "cannot be examined", e))?;
        let fingerprint = Fingerprint::of(&metadata);
        let store = Store::File { file, fingerprint };
        Ok(Self::new(name.to_string(), None, metadata.len(), store))
    }

    /// Bytes held in memory; `name` stands for them in messages.
    pub(crate) fn memory(name: &str, bytes: Vec<u8>) -> Self {
        let length = bytes.len() as u64;
        Self::new(name.to_string(), None, length, Store::Memory(bytes))
    }

    /// `length` bytes of each file, one behind the other; `from` says where in a file of the
    /// given length they begin, or refuses it. Files are opened when they are read.
    ///
    /// # Errors
    ///
    /// If a file cannot be examined, or is refused.
    pub(crate) fn joined(
        name: &str,
        paths: &[PathBuf],
        length: u64,
        from: impl Fn(&Path, u64) -> Result<u64, Error>,
    ) -> Result<Self, Error> {
        let mut segments = Vec::with_capacity(paths.len());
        let mut start = 0_u64;
        for path in paths {
            let metadata = std::fs::metadata(path)
                .map_err(|e| Error::io(path.display().to_string(), "cannot be opened", e))?;
            segments.push(Segment {
                path: path.clone(),
                from: from(path, metadata.len())?,
                fingerprint: Fingerprint::of(&metadata),
                start,
                length,
            });
            start = start.saturating_add(length);
        }
        let path = paths.first().cloned();
        Ok(Self::new(
            name.to_string(),
            path,
            start,
            Store::Joined(segments),
        ))
    }

    fn new(name: String, path: Option<PathBuf>, length: u64, store: Store) -> Self {
        Self(Arc::new(Inner {
            name,
            path,
            length,
            store,
        }))
    }

    /// The name of the file in messages.
    pub(crate) fn name(&self) -> &str {
        &self.0.name
    }

    /// The path of the file; `None` for a stream that was copied.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.0.path.as_deref()
    }

    /// The number of bytes.
    pub(crate) fn len(&self) -> u64 {
        self.0.length
    }

    /// Whether the bytes are mapped.
    pub(crate) fn is_mapped(&self) -> bool {
        matches!(self.0.store, Store::Map(_))
    }

    /// Whether the bytes are in memory, mapped or held.
    pub(crate) fn in_memory(&self) -> bool {
        matches!(self.0.store, Store::Map(_) | Store::Memory(_))
    }

    /// The map, if there is one.
    pub(crate) fn map(&self) -> Option<&GuardedMap> {
        match &self.0.store {
            Store::Map(map) => Some(map),
            _ => None,
        }
    }

    /// Where the bytes come from.
    pub(crate) fn source(&self) -> SourceInfo {
        SourceInfo {
            name: self.0.name.clone(),
            path: self.0.path.clone(),
            compressed: false,
            mapped: self.is_mapped(),
            re_readable: self.0.path.is_some(),
            length_bytes: self.0.path.is_some().then_some(self.0.length),
            held_bytes: match &self.0.store {
                Store::Memory(bytes) => bytes.len() as u64,
                _ => 0,
            },
            spilled_bytes: 0,
        }
    }

    /// An error unless `count` bytes at `offset` are there.
    fn check_range(&self, offset: u64, count: u64) -> Result<(), Error> {
        if offset
            .checked_add(count)
            .is_some_and(|end| end <= self.0.length)
        {
            return Ok(());
        }
        Err(Error::invalid(
            &self.0.name,
            format!(
                "the file ends early: {count} bytes expected at byte {offset}, the file has {}",
                self.0.length
            ),
        )
        .at(offset))
    }

    /// The bytes `offset..offset + count` where they are in memory; `None` where they must be
    /// read.
    ///
    /// # Errors
    ///
    /// If the range leaves the file.
    pub(crate) fn slice(&self, offset: u64, count: u64) -> Result<Option<&[u8]>, Error> {
        self.check_range(offset, count)?;
        let all = match &self.0.store {
            Store::Map(map) => map.bytes(),
            Store::Memory(bytes) => bytes,
            Store::File { .. } | Store::Joined(_) => return Ok(None),
        };
        let range = usize::try_from(offset)
            .ok()
            .zip(usize::try_from(count).ok());
        let slice = range.and_then(|(start, count)| all.get(start..start.checked_add(count)?));
        slice.map(Some).ok_or_else(|| {
            Error::unsupported(&self.0.name, "the file does not fit the address space").at(offset)
        })
    }

    /// The bytes `offset..offset + count`, copied only where they must be.
    ///
    /// # Errors
    ///
    /// If the range leaves the file, or it cannot be read.
    pub(crate) fn read(&self, offset: u64, count: u64) -> Result<Cow<'_, [u8]>, Error> {
        if let Some(bytes) = self.slice(offset, count)? {
            return Ok(Cow::Borrowed(bytes));
        }
        let too_large =
            || Error::unsupported(&self.0.name, format!("{count} bytes do not fit memory"));
        let count = usize::try_from(count).map_err(|_| too_large())?;
        let mut bytes = Vec::new();
        bytes.try_reserve_exact(count).map_err(|_| too_large())?;
        bytes.resize(count, 0);
        self.read_into(offset, &mut bytes)?;
        Ok(Cow::Owned(bytes))
    }

    /// Fills `out` from `offset` on.
    ///
    /// # Errors
    ///
    /// As [`FileBytes::read`].
    pub(crate) fn read_into(&self, offset: u64, out: &mut [u8]) -> Result<(), Error> {
        if let Some(bytes) = self.slice(offset, out.len() as u64)? {
            out.copy_from_slice(bytes);
            return Ok(());
        }
        match &self.0.store {
            Store::File { file, .. } => read_exact_at(file, out, offset)
                .map_err(|e| Error::io(&self.0.name, "cannot be read", e).at(offset)),
            Store::Joined(segments) => read_joined(segments, offset, out),
            Store::Map(_) | Store::Memory(_) => Ok(()),
        }
    }

    /// An error if the file changed since it was opened.
    pub(crate) fn check(&self) -> Result<(), Error> {
        match &self.0.store {
            Store::Map(map) => map.check(),
            Store::File { file, fingerprint } => fingerprint.check(file, self.path()),
            // Each is checked when it is read.
            Store::Memory(_) | Store::Joined(_) => Ok(()),
        }
    }
}

fn read_joined(segments: &[Segment], offset: u64, out: &mut [u8]) -> Result<(), Error> {
    let mut at = offset;
    let mut rest = out;
    let first = segments.partition_point(|s| s.start + s.length <= offset);
    for segment in &segments[first..] {
        if rest.is_empty() {
            break;
        }
        let within = at - segment.start;
        let count = (segment.length - within).min(rest.len() as u64);
        // At most the length of a slice.
        let (now, later) = rest.split_at_mut(count as usize);
        let name = segment.path.display().to_string();
        let file =
            File::open(&segment.path).map_err(|e| Error::io(&name, "cannot be opened", e))?;
        segment.fingerprint.check(&file, Some(&segment.path))?;
        let from = segment.from + within;
        read_exact_at(&file, now, from)
            .map_err(|e| Error::io(&name, "cannot be read", e).at(from))?;
        segment.fingerprint.check(&file, Some(&segment.path))?;
        at += count;
        rest = later;
    }
    Ok(())
}

/// Fills `out` from `offset` on, without moving the file's position.
fn read_exact_at(file: &File, out: &mut [u8], offset: u64) -> io::Result<()> {
    #[cfg(unix)]
    {
        std::os::unix::fs::FileExt::read_exact_at(file, out, offset)
    }
    #[cfg(windows)]
    {
        let mut done = 0;
        while done < out.len() {
            let from = offset + done as u64;
            match std::os::windows::fs::FileExt::seek_read(file, &mut out[done..], from) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(n) => done += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }
}

/// Whether a file is on a network file system, where a lost server would stall a map.
#[cfg(target_os = "linux")]
fn is_remote(file: &File) -> bool {
    use std::os::fd::AsRawFd;
    /// Magic numbers of statfs(2): NFS, SMB, CIFS, SMB2, FUSE, Lustre, 9P, AFS, Ceph, GPFS.
    const REMOTE: [u32; 10] = [
        0x6969,
        0x517b,
        0xff53_4d42,
        0xfe53_4d42,
        0x6573_5546,
        0x0bd0_0bd0,
        0x0102_1997,
        0x5346_414f,
        0x00c3_6400,
        0x4750_4653,
    ];
    // SAFETY: statfs is a plain C struct for which all zeros is valid; fstatfs fills it for an
    // open descriptor.
    let kind = unsafe {
        let mut about: libc::statfs = std::mem::zeroed();
        if libc::fstatfs(file.as_raw_fd(), &mut about) != 0 {
            return false;
        }
        about.f_type
    };
    // The field's width and sign differ between targets; the numbers have 32 bits.
    REMOTE.contains(&(kind as u32))
}

#[cfg(not(target_os = "linux"))]
fn is_remote(_: &File) -> bool {
    false
}
