//! Boxes of voxels out of uncompressed bytes: a map, a file that is read, or memory.
//!
//! In: bytes and where the voxels lie in them. Out: [`RandomVoxels`]. Guaranteed: every access
//! is checked against the extents; the resident part of a map stays small when `release` is
//! called, and during transposed reads without it. Files that store the axes in another order
//! (NumPy's Fortran order of a (z, y, x) array, permuted maps) are transposed while reading.
//! Where z is not the slowest axis, a box of many planes costs little more than one plane, so
//! such files are best read in thick boxes.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::{Header, Region};
use crate::order::AxisOrder;
use crate::volume::RandomVoxels;

/// Rows are read together up to this size ...
const SPAN_BYTES: usize = 128 << 10;
/// ... if no more than this lies unused between them: a page or two is read anyway.
const GAP_BYTES: usize = 16 << 10;
/// Mapped bytes touched before they are given back.
const RELEASE_BYTES: u64 = 16 << 20;

/// Mapped bytes asked for before they are used. Fewer leave the device idle while planes are packed; more
/// only fill the page cache.
const AHEAD_BYTES: usize = 16 << 20;

/// Voxels stored one behind the other.
#[derive(Debug)]
pub(crate) struct StoredVoxels {
    bytes: FileBytes,
    name: String,
    /// Offset of the first voxel.
    offset: u64,
    dims: [u64; 3],
    voxel_bytes: usize,
    order: AxisOrder,
    /// Where the bytes end that were given back last.
    released: AtomicU64,
    /// Where the bytes end that are expected to be read soon.
    expected: AtomicUsize,
}

impl StoredVoxels {
    /// The voxels of `header` in `bytes` from `offset`. The caller has checked that the bytes
    /// reach as far as the header says, so offsets within the volume fit `u64`.
    pub(crate) fn new(
        bytes: FileBytes,
        name: &str,
        offset: u64,
        header: &Header,
        order: AxisOrder,
    ) -> Self {
        if order.has_whole_planes()
            && let Some(map) = bytes.map()
        {
            map.expect_sequential();
        }
        Self {
            bytes,
            name: name.to_string(),
            offset,
            dims: header.dims,
            voxel_bytes: header.voxel.bytes(),
            order,
            released: AtomicU64::new(0),
            expected: AtomicUsize::new(0),
        }
    }

    fn check_region(&self, region: &Region) -> Result<(), Error> {
        region.check_inside(self.dims, &self.name)
    }

    /// Copies a box of canonically stored voxels: rows, or planes where the box has whole ones.
    fn read_rows(&self, region: &Region, out: &mut [u8]) -> Result<(), Error> {
        let [nx, ny, _] = self.dims;
        let voxel = self.voxel_bytes as u64;
        let at = |x: u64, y: u64, z: u64| self.offset + ((z * ny + y) * nx + x) * voxel;
        let [x, y, z] = region.origin;
        // The longest runs that are contiguous in the file and in the box.
        let (run, runs_y, runs_z) = if region.size[0] < nx {
            (region.size[0], region.size[1], region.size[2])
        } else if region.size[1] < ny {
            (nx * region.size[1], 1, region.size[2])
        } else {
            (nx * ny * region.size[2], 1, 1)
        };
        let Ok(run_bytes) = usize::try_from(run * voxel) else {
            return Ok(());
        };
        let mut runs = out.chunks_exact_mut(run_bytes.max(1));
        for k in 0..runs_z {
            for j in 0..runs_y {
                if let Some(out) = runs.next() {
                    self.bytes.read_into(at(x, y + j, z + k), out)?;
                }
            }
        }
        Ok(())
    }

    /// Copies a box of voxels stored x fastest, then z: rows, plane by plane.
    fn read_swapped(&self, region: &Region, out: &mut [u8]) -> Result<(), Error> {
        let step = self.steps();
        let [sx, sy, sz] = self.sizes(region)?;
        let run = sx * self.voxel_bytes;
        let stride = self.size(step[2])?;
        let rows = if stride - run <= GAP_BYTES {
            (SPAN_BYTES / stride).clamp(1, sz)
        } else {
            1
        };
        let reads = !self.bytes.in_memory();
        let mut buffer = vec![0; if reads { (rows - 1) * stride + run } else { 0 }];
        let mut release = Release::new(self, region);
        for y in 0..sy {
            for first in (0..sz).step_by(rows) {
                let rows = rows.min(sz - first);
                let span = (rows - 1) * stride + run;
                let start = self.at(region, [0, y, first]);
                let bytes = if reads {
                    self.bytes.read_into(start, &mut buffer[..span])?;
                    &buffer[..span]
                } else {
                    self.bytes.slice(start, span as u64)?.unwrap_or_default()
                };
                for row in 0..rows {
                    let to = ((first + row) * sy + y) * run;
                    let from = row * stride;
                    out[to..to + run].copy_from_slice(&bytes[from..from + run]);
                }
            }
            release.slow_steps(1, y + 1 == sy);
        }
        Ok(())
    }

    /// Copies a box of voxels whose fastest axis is not x, transposing it.
    fn read_transposed(&self, region: &Region, out: &mut [u8]) -> Result<(), Error> {
        match self.voxel_bytes {
            1 => self.transpose::<1>(region, out),
            2 => self.transpose::<2>(region, out),
            4 => self.transpose::<4>(region, out),
            _ => self.transpose::<8>(region, out),
        }
    }

    fn transpose<const B: usize>(&self, region: &Region, out: &mut [u8]) -> Result<(), Error> {
        /// Columns of x transposed together: writes then fill whole cache lines. Fewer waste
        /// them, more columns than this no longer fit the first-level cache.
        const TILE: usize = 32;
        let fast = self.order.fastest();
        // The axis that is neither x nor the fastest; 1 and 2 are y and z.
        let third = 3 - fast;
        let step = self.steps();
        let size = self.sizes(region)?;
        let (sx, runs, run) = (size[0], size[third], size[fast] * B);
        let (x_step, row_step) = (self.size(step[0])?, self.size(step[third])?);
        // Voxels between neighbours in the box.
        let to_step = [1, sx, sx * size[1]];
        let x_slowest = self.order.slowest() == 0;
        // What lies close together is read together: rows along the third axis, or columns.
        let rows = if x_slowest && row_step - run <= GAP_BYTES {
            (SPAN_BYTES / row_step).clamp(1, runs)
        } else {
            1
        };
        let joint = !x_slowest && x_step - run <= GAP_BYTES;

        // Only a file that is read needs a buffer; mapped bytes are used where they are.
        let reads = !self.bytes.in_memory();
        let span_most = (rows - 1) * row_step + run;
        let pitch = if joint { x_step } else { span_most };
        let tile = TILE.min(sx);
        let mut buffer = vec![
            0;
            if reads {
                (tile - 1) * pitch + span_most
            } else {
                0
            }
        ];
        let mut copy = |first: usize, row: usize| -> Result<(), Error> {
            let columns = TILE.min(sx - first);
            let rows = rows.min(runs - row);
            let span = (rows - 1) * row_step + run;
            let start = |c: usize| {
                let mut at = [0; 3];
                (at[0], at[third]) = (first + c, row);
                self.at(region, at)
            };
            if reads && joint {
                let all = (columns - 1) * pitch + span;
                self.bytes.read_into(start(0), &mut buffer[..all])?;
            } else if reads {
                for c in 0..columns {
                    let to = &mut buffer[c * pitch..c * pitch + span];
                    self.bytes.read_into(start(c), to)?;
                }
            }
            let mut spans: [&[u8]; TILE] = [&[]; TILE];
            for (c, bytes) in spans.iter_mut().take(columns).enumerate() {
                *bytes = if reads {
                    &buffer[c * pitch..c * pitch + span]
                } else {
                    let span = self.bytes.slice(start(c), span as u64)?;
                    span.unwrap_or_default()
                };
            }
            for k in 0..rows {
                for f in 0..size[fast] {
                    let to = ((row + k) * to_step[third] + f * to_step[fast] + first) * B;
                    let from = k * row_step + f * B;
                    let to = out[to..to + columns * B].chunks_exact_mut(B);
                    for (voxel, span) in to.zip(&spans) {
                        voxel.copy_from_slice(&span[from..from + B]);
                    }
                }
            }
            Ok(())
        };

        // The slowest axis outermost, so that the file is walked from its begin to its end.
        let mut release = Release::new(self, region);
        if x_slowest {
            for first in (0..sx).step_by(TILE) {
                for row in (0..runs).step_by(rows) {
                    copy(first, row)?;
                }
                release.slow_steps(TILE.min(sx - first) as u64, first + TILE >= sx);
            }
        } else {
            for row in 0..runs {
                for first in (0..sx).step_by(TILE) {
                    copy(first, row)?;
                }
                release.slow_steps(1, row + 1 == runs);
            }
        }
        Ok(())
    }

    /// Bytes between neighbours along x, y and z. They fit, as the volume does.
    fn steps(&self) -> [u64; 3] {
        let strides = self.order.strides(self.dims);
        strides.map(|n| n * self.voxel_bytes as u64)
    }

    /// Offset of a voxel of the region.
    fn at(&self, region: &Region, at: [usize; 3]) -> u64 {
        let step = self.steps();
        let from = |axis: usize| (region.origin[axis] + at[axis] as u64) * step[axis];
        self.offset + from(0) + from(1) + from(2)
    }

    fn size(&self, bytes: u64) -> Result<usize, Error> {
        usize::try_from(bytes)
            .map_err(|_| Error::unsupported(&self.name, "the box does not fit memory"))
    }

    fn sizes(&self, region: &Region) -> Result<[usize; 3], Error> {
        let [x, y, z] = region.size;
        Ok([self.size(x)?, self.size(y)?, self.size(z)?])
    }

    fn release_bytes(&self, start: u64, end: u64) {
        if let Some(map) = self.bytes.map()
            && let (Ok(start), Ok(end)) = (usize::try_from(start), usize::try_from(end))
        {
            map.release(start, end);
        }
    }
}

impl RandomVoxels for StoredVoxels {
    fn read_box(&self, region: &Region, out: &mut Vec<u8>) -> Result<(), Error> {
        self.check_region(region)?;
        self.check()?;
        region.make_room(self.voxel_bytes, out, &self.name)?;
        if out.is_empty() {
            return Ok(());
        }
        if self.order == AxisOrder::X_FASTEST {
            self.read_rows(region, out)?;
        } else if self.order.fastest() == 0 {
            self.read_swapped(region, out)?;
        } else {
            self.read_transposed(region, out)?;
        }
        self.check()
    }

    fn planes(&self, z: u64, count: u64) -> Result<Option<&[u8]>, Error> {
        let [nx, ny, _] = self.dims;
        self.check_region(&Region {
            origin: [0, 0, z],
            size: [nx, ny, count],
        })?;
        if self.order != AxisOrder::X_FASTEST {
            return Ok(None);
        }
        self.check()?;
        let plane = nx * ny * self.voxel_bytes as u64;
        let (start, count) = (self.offset + z * plane, count * plane);
        let bytes = self.bytes.slice(start, count)?;
        if let (Some(map), Ok(start), Some(bytes)) = (self.bytes.map(), start.try_into(), bytes) {
            let end = start + bytes.len();
            map.fetch(start, end);
            // What is ahead, as far as that was not said before.
            let ahead = end + AHEAD_BYTES;
            let before = self.expected.swap(ahead, Ordering::Relaxed);
            map.expect(if before < ahead { before.max(end) } else { end }, ahead);
        }
        Ok(bytes)
    }

    fn check(&self) -> Result<(), Error> {
        self.bytes.check()
    }

    fn release(&self, z_end: u64) {
        let [nx, ny, nz] = self.dims;
        if self.order.has_whole_planes() {
            let plane = nx * ny * self.voxel_bytes as u64;
            let end = self.offset + z_end.min(nz) * plane;
            // What was given back before need not be looked at again, unless reading began anew.
            let before = self.released.swap(end, Ordering::Relaxed);
            let start = if before < end { before } else { 0 };
            self.release_bytes(start.max(self.offset), end);
        }
    }
}

/// Gives mapped bytes back while a box is read whose planes are not stored one by one, so that
/// all of the file is touched. Where they are, [`RandomVoxels::release`] does it.
struct Release<'a> {
    voxels: &'a StoredVoxels,
    /// Bytes of one step along the slowest axis.
    step: u64,
    /// Steps along the slowest axis that were read, from the begin of the volume.
    done: u64,
    touched: u64,
}

impl<'a> Release<'a> {
    fn new(voxels: &'a StoredVoxels, region: &Region) -> Self {
        let slowest = voxels.order.slowest();
        Self {
            voxels,
            step: voxels.steps()[slowest],
            done: region.origin[slowest],
            touched: 0,
        }
    }

    /// `count` more steps along the slowest axis were read, the last ones if so.
    fn slow_steps(&mut self, count: u64, last: bool) {
        self.done += count;
        self.touched = self.touched.saturating_add(count * self.step);
        if !self.voxels.order.has_whole_planes() && (self.touched >= RELEASE_BYTES || last) {
            self.touched = 0;
            let start = self.voxels.offset;
            self.voxels
                .release_bytes(start, start + self.done * self.step);
        }
    }
}
