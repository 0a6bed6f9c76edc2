//! Planes of a stream that can be read only once.
//!
//! In: an [`Input`] that stands at the first voxel. Out: [`ForwardVoxels`]. Guaranteed: memory
//! follows the bytes that are there, not the size the header claims; a stream that ends early is
//! an error that says how much of the volume there was.

use crate::error::Error;
use crate::header::Header;
use crate::input::{Input, read_error};
use crate::volume::ForwardVoxels;

/// The planes of a stream.
pub(crate) struct StreamVoxels {
    input: Input,
    name: String,
    plane_bytes: u64,
    planes: u64,
    done: u64,
    /// Bytes of further volumes behind this one.
    behind: u64,
    finished: bool,
}

impl StreamVoxels {
    /// Planes of `input`, which stands at the first voxel. The header has been checked, so its
    /// sizes fit.
    pub(crate) fn new(input: Input, name: &str, header: &Header, frames_behind: u64) -> Self {
        let volume_bytes = header.voxels_bytes().unwrap_or(u64::MAX);
        Self {
            input,
            name: name.to_string(),
            plane_bytes: header.plane_bytes().unwrap_or(u64::MAX),
            planes: header.dims[2],
            done: 0,
            behind: volume_bytes.saturating_mul(frames_behind),
            finished: false,
        }
    }
}

impl ForwardVoxels for StreamVoxels {
    fn read_planes(&mut self, count: u64, out: &mut Vec<u8>) -> Result<u64, Error> {
        out.clear();
        let count = count.min(self.planes - self.done);
        // Fits: it is at most the bytes of the volume, which were checked.
        let wanted = count.saturating_mul(self.plane_bytes);
        let found = self
            .input
            .append(wanted, out)
            .map_err(|e| read_error(&self.name, self.input.position(), e))?;
        if found < wanted {
            let total = self.planes.saturating_mul(self.plane_bytes);
            let have = self.done * self.plane_bytes + found;
            return Err(ends_early(
                &self.name,
                self.input.position(),
                have,
                total,
                self.plane_bytes,
            ));
        }
        self.done += count;
        Ok(count)
    }

    fn finish(&mut self) -> Result<Vec<String>, Error> {
        if self.finished || self.done < self.planes {
            return Ok(Vec::new());
        }
        self.finished = true;
        let volume = self.planes.saturating_mul(self.plane_bytes);
        look_behind(&mut self.input, &self.name, 0, volume, self.behind)
    }
}

/// Reads what follows the voxels (`volume_bytes` in all), so that checksums are verified, and
/// gives warnings. `read` bytes behind the voxels have been read already; `frames` bytes there
/// are other volumes that belong to the file.
pub(crate) fn look_behind(
    input: &mut Input,
    name: &str,
    read: u64,
    volume_bytes: u64,
    frames: u64,
) -> Result<Vec<String>, Error> {
    /// Read on for at least this much to reach the checksum. A stream that holds far more than
    /// its volume (or never ends) must not keep the program busy.
    const AT_LEAST_BYTES: u64 = 64 << 20;
    let end = input.position() - read;
    let most = AT_LEAST_BYTES.max(volume_bytes);
    let skipped = input
        .skip(most + 1)
        .map_err(|e| read_error(name, input.position(), e))?;
    let mut warnings = Vec::new();
    let behind = read + skipped;
    if skipped > most {
        warnings.push(format!(
            "{name}: at least {behind} bytes follow the voxels, from byte {end}; they were not \
             read to their end, so a checksum there was not verified"
        ));
    } else if behind > frames {
        warnings.push(trailing(name, end + frames, behind - frames));
    }
    warnings.extend(
        input
            .notes()
            .into_iter()
            .map(|note| format!("{name}: {note}")),
    );
    Ok(warnings)
}

/// The warning on bytes behind the voxels.
pub(crate) fn trailing(name: &str, end: u64, extra: u64) -> String {
    format!("{name}: {extra} bytes follow the voxels, from byte {end}; they are ignored")
}

/// The error of a volume whose bytes end too soon, at `offset`.
pub(crate) fn ends_early(
    name: &str,
    offset: u64,
    have: u64,
    total: u64,
    plane_bytes: u64,
) -> Error {
    let planes = have.checked_div(plane_bytes).unwrap_or(0);
    let of = total.checked_div(plane_bytes).unwrap_or(0);
    Error::invalid(
        name,
        format!(
            "the data ends early: {have} bytes of voxels ({planes} whole planes) found, {total} \
             ({of} planes) expected"
        ),
    )
    .at(offset)
}
