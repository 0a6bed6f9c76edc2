//! Voxels behind a header, out of bytes that run forward.
//!
//! In: a [`Parsed`] header and an [`Input`] that has not passed the voxels yet. Out: a volume that
//! runs forward, or, where that cannot serve (another order of axes, a start that is counted from
//! the end), one over a copy. A copy is held in memory up to a limit, beyond it on disk, if the
//! caller says where.

use std::fs::File;
use std::io::{BufRead, Read, Write};
use std::path::Path;

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::input::{Compression, Input, read_error};
use crate::options::OpenOptions;
use crate::parsed::{Encoding, Parsed, Start};
use crate::stored::StoredVoxels;
use crate::stream::{StreamVoxels, ends_early, look_behind};
use crate::volume::{SourceInfo, Volume, Voxels};
use crate::{text, vol};

/// The volume of an input that runs forward.
pub(crate) fn forward(
    parsed: Parsed,
    mut input: Input,
    name: &str,
    options: &OpenOptions,
    mut source: SourceInfo,
) -> Result<Volume, Error> {
    let behind = parsed.bytes_behind();
    input = decode(input, &parsed, name)?;
    let Parsed {
        mut header,
        start,
        order,
        maybe_eight_bytes,
        ..
    } = parsed;
    if let Start::Bytes(skip) = start {
        skip_to_voxels(&mut input, skip, skip, name)?;
    }
    if order.has_whole_planes() && !maybe_eight_bytes && start != Start::FromEnd {
        let voxels = StreamVoxels::new(input, name, &header, order, behind);
        return Ok(Volume {
            header,
            voxels: Voxels::Forward(Box::new(voxels)),
            source,
        });
    }

    let why = if maybe_eight_bytes {
        "the size of a voxel is only known at the end of the stream"
    } else if start == Start::FromEnd {
        "the place of the voxels is only known at the end of the stream"
    } else {
        "the axes are stored in another order"
    };
    let mut bytes = header.voxels_bytes().unwrap_or(u64::MAX);
    let most = match start {
        Start::FromEnd => None,
        Start::Bytes(_) if maybe_eight_bytes => Some(bytes.saturating_mul(2)),
        Start::Bytes(_) => Some(bytes),
    };
    let copy = copy(&mut input, most, why, name, options)?;
    let found = copy.len();
    if maybe_eight_bytes && Some(found) == most {
        vol::take_eight_bytes(&mut header, name);
        bytes = found;
    }
    if found < bytes {
        let plane = header.plane_bytes().unwrap_or(u64::MAX);
        return Err(ends_early(name, input.position(), found, bytes, plane));
    }
    let start = match start {
        Start::FromEnd => found - bytes,
        Start::Bytes(_) => 0,
    };
    header.warnings.extend(look_behind(
        &mut input,
        name,
        found - bytes - start,
        bytes,
        behind,
    )?);
    let copied = copy.source();
    source.held_bytes = copied.held_bytes;
    source.spilled_bytes = found - copied.held_bytes;
    let voxels = StoredVoxels::new(copy, name, start, &header, order);
    Ok(Volume {
        header,
        voxels: Voxels::Random(Box::new(voxels)),
        source,
    })
}

/// The decoded data that `input` holds from the offset of `parsed` on.
pub(crate) fn decode(mut input: Input, parsed: &Parsed, name: &str) -> Result<Input, Error> {
    let offset = parsed.offset;
    let skip = offset.saturating_sub(input.position());
    skip_to_voxels(&mut input, skip, offset, name)?;
    let compression = match parsed.encoding {
        Encoding::Raw => return Ok(input),
        Encoding::Bits => return Ok(input.bits()),
        Encoding::Text | Encoding::Hex => {
            let skip = match parsed.start {
                Start::Bytes(skip) => skip,
                Start::FromEnd => 0,
            };
            let volume = parsed.header.voxels_bytes().unwrap_or(u64::MAX);
            let volumes = parsed.frames_behind.saturating_add(1);
            let bytes = volume.saturating_mul(volumes).saturating_add(skip);
            let voxel = parsed.header.voxel;
            return Ok(if parsed.encoding == Encoding::Hex {
                text::hexadecimal(input, bytes)
            } else {
                text::numbers(input, voxel, bytes / voxel.bytes() as u64)
            });
        }
        Encoding::Zlib => return input.zlib().map_err(|e| read_error(name, offset, e)),
        Encoding::Gzip => Compression::Gzip,
        Encoding::Bzip2 => Compression::Bzip2,
        Encoding::Zstd => Compression::Zstd,
    };
    input
        .decompressed(compression)
        .map_err(|e| read_error(name, offset, e))
}

/// Passes so many lines.
pub(crate) fn skip_lines(input: &mut Input, lines: u64, name: &str) -> Result<(), Error> {
    for passed in 0..lines {
        loop {
            let some = match input.fill_buf() {
                Ok(some) => some,
                Err(e) => return Err(read_error(name, input.position(), e)),
            };
            if some.is_empty() {
                return Err(Error::invalid(
                    name,
                    format!("the data has {passed} lines, of which {lines} are to be skipped"),
                )
                .at(input.position()));
            }
            let end = some.iter().position(|b| *b == b'\n');
            let count = end.map_or(some.len(), |end| end + 1);
            input.consume(count);
            if end.is_some() {
                break;
            }
        }
    }
    Ok(())
}

pub(crate) fn skip_to_voxels(
    input: &mut Input,
    skip: u64,
    start: u64,
    name: &str,
) -> Result<(), Error> {
    let skipped = input
        .skip(skip)
        .map_err(|e| read_error(name, input.position(), e))?;
    if skipped == skip {
        return Ok(());
    }
    Err(Error::invalid(
        name,
        format!(
            "the data ends before the first voxel: {} bytes found, the voxels start at byte \
             {start}",
            input.position()
        ),
    )
    .at(input.position()))
}

/// A copy of the next `most` bytes of `input` (fewer where it ends), or of all of it; `why` says
/// to what end.
///
/// # Errors
///
/// If memory may not hold it and no place on disk is given, or reading or writing fails.
pub(crate) fn copy(
    input: &mut Input,
    most: Option<u64>,
    why: &str,
    name: &str,
    options: &OpenOptions,
) -> Result<FileBytes, Error> {
    let limit = options.spool_limit_bytes;
    let too_much = |bytes: &str| {
        Error::unsupported(
            name,
            format!(
                "{why}, so {bytes} would have to be held in memory, of which {limit} bytes ({} MiB) may be used for \
                 that: allow more, name a folder for a copy on disk (--spill), or uncompress it to a \
                 file first",
                limit >> 20
            ),
        )
    };
    if let (Some(most), None) = (most, &options.spill)
        && most > limit
    {
        return Err(too_much(&format!("its {most} bytes of voxels")));
    }
    let mut held = Vec::new();
    let wanted = most.unwrap_or(u64::MAX).min(limit.saturating_add(1));
    input
        .append(wanted, &mut held)
        .map_err(|e| read_error(name, input.position(), e))?;
    if held.len() as u64 <= limit {
        held.shrink_to_fit();
        return Ok(FileBytes::memory(name, held));
    }
    match &options.spill {
        None => Err(too_much("all of it")),
        Some(folder) => {
            let rest = most.map_or(u64::MAX, |most| most - held.len() as u64);
            spill(input, &held, rest, name, folder)
        }
    }
}

/// Writes `held` and then up to `rest` bytes of `input` to a file in `folder` that has no name
/// and vanishes with the program.
fn spill(
    input: &mut Input,
    held: &[u8],
    rest: u64,
    name: &str,
    folder: &Path,
) -> Result<FileBytes, Error> {
    /// Copied at a time.
    const STEP_BYTES: usize = 1 << 20;
    let failed = |e| Error::io(folder.display().to_string(), "a copy cannot be written", e);
    let mut file: File = tempfile::tempfile_in(folder).map_err(failed)?;
    file.write_all(held).map_err(failed)?;
    let mut buffer = vec![0; STEP_BYTES];
    let mut left = rest;
    while left > 0 {
        let step = usize::try_from(left).unwrap_or(STEP_BYTES).min(STEP_BYTES);
        let count = input
            .read(&mut buffer[..step])
            .map_err(|e| read_error(name, input.position(), e))?;
        if count == 0 {
            break;
        }
        file.write_all(&buffer[..count]).map_err(failed)?;
        left -= count as u64;
    }
    FileBytes::of_unnamed(file, name)
}
