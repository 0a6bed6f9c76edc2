//! Voxels behind a header, out of bytes that run forward.
//!
//! In: a [`Parsed`] header and an [`Input`] that has not passed the voxels yet. Out: a volume that
//! runs forward, or, where that cannot serve (another order of axes, a start that is counted from
//! the end), one over a copy. A copy is held in memory up to a limit, beyond it on disk, if the
//! caller says where.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::input::{Input, read_error};
use crate::options::OpenOptions;
use crate::parsed::{Encoding, Parsed, Start};
use crate::stored::{AxisOrder, StoredVoxels};
use crate::stream::{StreamVoxels, ends_early, look_behind};
use crate::vol;
use crate::volume::{SourceInfo, Volume, Voxels};

/// The volume of an input that runs forward.
pub(crate) fn forward(
    parsed: Parsed,
    mut input: Input,
    name: &str,
    options: &OpenOptions,
    mut source: SourceInfo,
) -> Result<Volume, Error> {
    let Parsed {
        mut header,
        offset,
        encoding,
        start,
        order,
        maybe_eight_bytes,
        frames_behind,
        ..
    } = parsed;
    let skip = offset.saturating_sub(input.position());
    skip_to_voxels(&mut input, skip, offset, name)?;
    input = match encoding {
        Encoding::Raw => input,
        Encoding::Zlib => input.zlib().map_err(|e| read_error(name, offset, e))?,
    };
    if let Start::Bytes(skip) = start {
        skip_to_voxels(&mut input, skip, skip, name)?;
    }
    if order == AxisOrder::XFastest && !maybe_eight_bytes && start != Start::FromEnd {
        let voxels = StreamVoxels::new(input, name, &header, frames_behind);
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
        0,
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

fn skip_to_voxels(input: &mut Input, skip: u64, start: u64, name: &str) -> Result<(), Error> {
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
                "{why}, so {bytes} would have to be held in memory, more than the limit of \
                 {limit}: name a folder for a copy with --spill, or uncompress it to a file first"
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
