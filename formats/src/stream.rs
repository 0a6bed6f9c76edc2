//! Planes of a stream that can be read only once.
//!
//! In: an [`Input`] that stands at the first voxel. Out: [`ForwardVoxels`]. Guaranteed: memory
//! follows the bytes that are there, not the size the header claims; a stream that ends early is
//! an error that says how much of the volume there was.

use std::io;

use crate::error::Error;
use crate::header::Header;
use crate::input::{Input, read_error};
use crate::order::{AxisOrder, transpose_plane};
use crate::volume::ForwardVoxels;

/// The planes of a stream.
pub(crate) struct StreamVoxels {
    input: Input,
    name: String,
    /// Voxels along x and y, and bytes of one.
    plane: [u64; 2],
    voxel_bytes: usize,
    order: AxisOrder,
    /// A plane in the order of the file, where that is not the canonical one.
    stored: Vec<u8>,
    plane_bytes: u64,
    planes: u64,
    done: u64,
    /// Bytes that may follow the volume.
    behind: u64,
    finished: bool,
}

impl StreamVoxels {
    /// Planes of `input`, which stands at the first voxel, stored in an order of whole planes;
    /// `behind` bytes may follow them. The header has been checked, so its sizes fit.
    pub(crate) fn new(
        input: Input,
        name: &str,
        header: &Header,
        order: AxisOrder,
        behind: u64,
    ) -> Self {
        debug_assert!(order.has_whole_planes());
        Self {
            input,
            name: name.to_string(),
            plane: [header.dims[0], header.dims[1]],
            voxel_bytes: header.voxel.bytes(),
            order,
            stored: Vec::new(),
            plane_bytes: header.plane_bytes().unwrap_or(u64::MAX),
            planes: header.dims[2],
            done: 0,
            behind,
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
        let found = if self.order == AxisOrder::X_FASTEST {
            self.input.append(wanted, out)
        } else {
            self.transposed(count, out)
        };
        let found = found.map_err(|e| read_error(&self.name, self.input.position(), e))?;
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

impl StreamVoxels {
    /// Appends up to `count` planes to `out`, x fastest; gives the number of bytes there were.
    fn transposed(&mut self, count: u64, out: &mut Vec<u8>) -> io::Result<u64> {
        // A plane in memory has extents that fit.
        let [nx, ny] = self.plane.map(|n| usize::try_from(n).unwrap_or(usize::MAX));
        let mut found = 0;
        for _ in 0..count {
            self.stored.clear();
            let bytes = self.input.append(self.plane_bytes, &mut self.stored)?;
            found += bytes;
            if bytes < self.plane_bytes {
                break;
            }
            let start = out.len();
            out.resize(start + self.stored.len(), 0);
            transpose_plane(self.voxel_bytes, nx, ny, &self.stored, &mut out[start..]);
        }
        Ok(found)
    }
}

/// Reads what follows the voxels (`volume_bytes` in all), so that checksums are verified, and
/// gives warnings. `read` bytes behind the voxels have been read already; `frames` bytes there
/// are other volumes that belong to the file, `u64::MAX` where all of them do.
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
    // Where anything may follow, nothing is worth a note.
    if frames < u64::MAX {
        let notes = input.notes().into_iter();
        warnings.extend(notes.map(|note| format!("{name}: {note}")));
    }
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
