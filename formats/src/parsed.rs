//! What a format module is told, and what it finds out, where voxels follow a header.
//!
//! In: a [`Context`] and the bytes of the header. Out: [`Parsed`]: the header, and where and how
//! the voxels are stored. Nothing is read here beyond headers.

use std::path::{Component, Path, PathBuf};

use crate::error::Error;
use crate::header::{Header, VoxelType};
use crate::input::{Input, read_error};
use crate::options::OpenOptions;
use crate::order::AxisOrder;

/// How the bytes of the voxels are encoded, apart from a compression of the whole file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    /// As they are.
    Raw,
    /// zlib data (RFC 1950).
    Zlib,
    /// gzip members.
    Gzip,
    /// bzip2 streams.
    Bzip2,
    /// Zstandard frames.
    Zstd,
    /// Numbers in text.
    Text,
    /// Two hexadecimal digits for each byte.
    Hex,
    /// One bit a voxel, the first in the highest bit of a byte; the voxels are `bool`.
    Bits,
}

/// The files that hold the voxels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Elsewhere {
    /// The file of the header.
    Here,
    /// The first of these that exists.
    FirstOf(Vec<PathBuf>),
    /// All of these, in order; each holds the same number of voxels.
    Files(Vec<PathBuf>),
}

/// Where the voxels begin in the decoded data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Start {
    /// After this many bytes.
    Bytes(u64),
    /// So that they end where the data ends.
    FromEnd,
}

/// What a format module found out.
#[derive(Debug)]
pub(crate) struct Parsed {
    pub(crate) header: Header,
    /// Lines to pass in files other than the header's, before `offset` is counted.
    pub(crate) lines: u64,
    /// Offset of the (encoded) voxels in the (decompressed) file that holds them.
    pub(crate) offset: u64,
    pub(crate) encoding: Encoding,
    /// Where in the decoded data the voxels begin.
    pub(crate) start: Start,
    pub(crate) order: AxisOrder,
    pub(crate) elsewhere: Elsewhere,
    /// The header says four bytes a voxel, but eight are as likely (see `vol`).
    pub(crate) maybe_eight_bytes: bool,
    /// How many volumes of the same size follow the one to be read.
    pub(crate) frames_behind: u64,
    /// What follows the voxels belongs to the file, however much it is.
    pub(crate) footer: bool,
}

impl Parsed {
    pub(crate) fn new(header: Header, offset: u64) -> Self {
        Self {
            header,
            lines: 0,
            offset,
            encoding: Encoding::Raw,
            start: Start::Bytes(0),
            order: AxisOrder::X_FASTEST,
            elsewhere: Elsewhere::Here,
            maybe_eight_bytes: false,
            frames_behind: 0,
            footer: false,
        }
    }

    /// Moves on to the frame that the caller wants, of `frames` one behind the other.
    ///
    /// # Errors
    ///
    /// If the choice is missing or there is no such frame, or if no file can hold so many.
    pub(crate) fn choose_frame(&mut self, frames: u64, context: &Context<'_>) -> Result<(), Error> {
        let frame = context.frame(frames)?;
        let bytes = self.header.voxels_bytes();
        let skip = bytes.and_then(|bytes| bytes.checked_mul(frame)?.checked_add(self.offset));
        let end = bytes.and_then(|bytes| bytes.checked_mul(frames));
        let (Some(offset), Some(_)) = (skip, end) else {
            return Err(Error::invalid(
                context.name,
                format!(
                    "{frames} frames of {:?} voxels do not fit any file",
                    self.header.dims
                ),
            ));
        };
        self.offset = offset;
        self.frames_behind = frames - 1 - frame;
        Ok(())
    }

    /// Bytes behind the voxels that are no surprise.
    pub(crate) fn bytes_behind(&self) -> u64 {
        if self.footer {
            return u64::MAX;
        }
        let bytes = self.header.voxels_bytes().unwrap_or(u64::MAX);
        bytes.saturating_mul(self.frames_behind)
    }
}

/// What a format module is told.
pub(crate) struct Context<'a> {
    pub(crate) name: &'a str,
    pub(crate) path: Option<&'a Path>,
    pub(crate) options: &'a OpenOptions,
    /// Bytes of the file, where it is uncompressed and its length known.
    pub(crate) length: Option<u64>,
}

impl Context<'_> {
    /// The next `count` bytes of a header, or an error that says how many there were.
    pub(crate) fn header_bytes(&self, input: &mut Input, count: usize) -> Result<Vec<u8>, Error> {
        let start = input.position();
        let mut bytes = Vec::new();
        input
            .append(count as u64, &mut bytes)
            .map_err(|e| self.read_error(input, e))?;
        if bytes.len() < count {
            return Err(Error::invalid(
                self.name,
                format!(
                    "the header ends early: {} bytes found, {count} expected",
                    bytes.len()
                ),
            )
            .at(start));
        }
        Ok(bytes)
    }

    /// The error a failed read of the header is.
    pub(crate) fn read_error(&self, input: &Input, error: std::io::Error) -> Error {
        read_error(self.name, input.position(), error)
    }

    /// The volume to read out of `frames`: the one that was asked for, or the only one.
    pub(crate) fn frame(&self, frames: u64) -> Result<u64, Error> {
        match self.options.frame {
            None if frames == 1 => Ok(0),
            None => Err(Error::unsupported(
                self.name,
                format!(
                    "holds {frames} volumes (time points or channels): choose one with --frame N, \
                     0 to {}",
                    frames - 1
                ),
            )),
            Some(frame) if frame < frames => Ok(frame),
            Some(frame) => Err(Error::invalid(
                self.name,
                format!("frame {frame} was asked for, 0 to {} are there", frames - 1),
            )),
        }
    }

    /// The path of the file that the header calls `named`, which must lie in the header's folder
    /// unless the caller allows others.
    pub(crate) fn beside(&self, named: &str) -> Result<PathBuf, Error> {
        let Some(path) = self.path else {
            return Err(Error::unsupported(
                self.name,
                format!(
                    "the voxels are in another file, '{named}', which cannot be found from a stream"
                ),
            ));
        };
        beside(path, named, self.options.outside)
            .map_err(|message| Error::unsupported(self.name, message))
    }
}

/// The path of the file that `header` calls `named`. Messages name what was asked for.
pub(crate) fn beside(header: &Path, named: &str, outside: bool) -> Result<PathBuf, String> {
    // What another system wrote as a path must not be a strange name here.
    let named = named.replace('\\', "/");
    let relative = Path::new(&named);
    let folder = header.parent().unwrap_or(Path::new(""));
    let full = folder.join(relative);
    if outside {
        return Ok(full);
    }
    let leaves = |why: &str| {
        format!(
            "the header names the file '{named}', which {why}; headers may only name files in \
             their own folder unless others are allowed (--allow-outside)"
        )
    };
    let mut components = relative.components();
    if components.any(|c| !matches!(c, Component::Normal(_) | Component::CurDir)) {
        return Err(leaves("is outside its folder"));
    }
    // A link may lead anywhere. A file that is not there is somebody else's message.
    let here = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    if let (Ok(real), Ok(here)) = (full.canonicalize(), here.canonicalize())
        && !real.starts_with(here)
    {
        return Err(leaves("is a link to outside its folder"));
    }
    Ok(full)
}

/// Whether a number can be the edge of a voxel in any unit. Beyond the bounds (an atomic nucleus
/// in metres; a light year in millimetres is 1e19) lie only fields that were never filled in.
pub(crate) fn is_plausible_spacing(spacing: f64) -> bool {
    const BOUNDS: std::ops::RangeInclusive<f64> = 1e-15..=1e15;
    BOUNDS.contains(&spacing)
}

/// Refuses extents that no memory or file can have.
pub(crate) fn check_extents(header: &Header, name: &str) -> Result<(), Error> {
    let [x, y, z] = header.dims;
    if x == 0 || y == 0 || z == 0 {
        return Err(Error::invalid(
            name,
            format!("the volume has {x} x {y} x {z} voxels; each extent must be at least 1"),
        ));
    }
    // Signed, as offsets in files are; a factor of two stays for intermediate sums.
    const MOST_BYTES: u64 = u64::MAX >> 2;
    if header.voxels_bytes().is_none_or(|bytes| bytes > MOST_BYTES) {
        return Err(Error::invalid(
            name,
            format!(
                "{x} x {y} x {z} voxels of {} do not fit any file",
                header.voxel
            ),
        ));
    }
    Ok(())
}

/// A voxel type of the given kind and size, for formats that state them apart.
pub(crate) fn voxel_type(kind: u8, bytes: u64) -> Option<VoxelType> {
    Some(match (kind, bytes) {
        (b'b', 1) => VoxelType::Bool,
        (b'u', 1) => VoxelType::U8,
        (b'u', 2) => VoxelType::U16,
        (b'u', 4) => VoxelType::U32,
        (b'u', 8) => VoxelType::U64,
        (b'i', 1) => VoxelType::I8,
        (b'i', 2) => VoxelType::I16,
        (b'i', 4) => VoxelType::I32,
        (b'i', 8) => VoxelType::I64,
        (b'f', 2) => VoxelType::F16,
        (b'f', 4) => VoxelType::F32,
        (b'f', 8) => VoxelType::F64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_named_file_may_not_leave_the_folder() {
        let header = Path::new("/data/scan/head.nhdr");
        assert_eq!(
            beside(header, "raw/head.raw", false),
            Ok(PathBuf::from("/data/scan/raw/head.raw"))
        );
        for named in ["../x.raw", "/etc/passwd", "a/../../x", "..\\x.raw"] {
            let message = beside(header, named, false).unwrap_err();
            assert!(message.contains("outside"), "{message}");
            assert!(beside(header, named, true).is_ok());
        }
    }
}
