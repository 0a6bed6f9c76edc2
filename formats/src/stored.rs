//! Boxes of voxels out of uncompressed bytes: a map, a file that is read, or memory.
//!
//! In: bytes and where the voxels lie in them. Out: [`RandomVoxels`]. Guaranteed: every access
//! is checked against the extents; the resident part of a map stays small when `release` is
//! called, and during transposed reads without it. Files that store z fastest (NumPy's Fortran
//! order of a (z, y, x) array) are transposed while reading: a box of many planes then costs
//! little more than one plane, so such files are best read in thick boxes.

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::{Header, Region};
use crate::volume::RandomVoxels;

/// In which order the voxels are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AxisOrder {
    /// x varies fastest, then y: the canonical order.
    XFastest,
    /// z varies fastest, then y.
    ZFastest,
}

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
        if let (Some(map), AxisOrder::XFastest) = (bytes.map(), order) {
            map.expect_sequential();
        }
        Self {
            bytes,
            name: name.to_string(),
            offset,
            dims: header.dims,
            voxel_bytes: header.voxel.bytes(),
            order,
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

    /// Copies a box of voxels stored with z fastest, transposing it.
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
        /// Rows are read together up to this size ...
        const SPAN_BYTES: usize = 128 << 10;
        /// ... if no more than this lies unused between them: a page or two is read anyway.
        const GAP_BYTES: usize = 16 << 10;
        /// Mapped bytes touched before they are given back.
        const RELEASE_BYTES: u64 = 16 << 20;
        let [_, ny, nz] = self.dims;
        let [x0, y0, z0] = region.origin;
        let too_large = || Error::unsupported(&self.name, "the box does not fit memory");
        let size = |n: u64| usize::try_from(n).map_err(|_| too_large());
        let (sx, sy, sz) = (
            size(region.size[0])?,
            size(region.size[1])?,
            size(region.size[2])?,
        );
        let at = |x: u64, y: u64| self.offset + ((x * ny + y) * nz + z0) * B as u64;
        let run = sz.checked_mul(B).ok_or_else(too_large)?;
        let stride = size(nz * B as u64)?;
        let rows = if stride - run <= GAP_BYTES {
            (SPAN_BYTES / stride).clamp(1, sy)
        } else {
            1
        };

        // Only a file that is read needs buffers; mapped bytes are used where they are.
        let span_most = (rows - 1) * stride + run;
        let reads = !self.bytes.in_memory();
        let mut buffers = vec![vec![0; if reads { span_most } else { 0 }]; TILE.min(sx)];
        let mut touched = 0;
        for first in (0..sx).step_by(TILE) {
            let columns = TILE.min(sx - first);
            for y in (0..sy).step_by(rows) {
                let rows = rows.min(sy - y);
                let span = (rows - 1) * stride + run;
                let mut spans: [&[u8]; TILE] = [&[]; TILE];
                for (c, buffer) in buffers.iter_mut().take(columns).enumerate() {
                    let start = at(x0 + (first + c) as u64, y0 + y as u64);
                    spans[c] = if reads {
                        self.bytes.read_into(start, &mut buffer[..span])?;
                        &buffer[..span]
                    } else {
                        self.bytes.slice(start, span as u64)?.unwrap_or_default()
                    };
                }
                for row in 0..rows {
                    for z in 0..sz {
                        let to = ((z * sy + y + row) * sx + first) * B;
                        let from = row * stride + z * B;
                        let to = out[to..to + columns * B].chunks_exact_mut(B);
                        for (voxel, span) in to.zip(&spans) {
                            voxel.copy_from_slice(&span[from..from + B]);
                        }
                    }
                }
            }
            touched += (columns as u64).saturating_mul(ny * nz * B as u64);
            if touched >= RELEASE_BYTES || first + columns >= sx {
                touched = 0;
                self.release_bytes(self.offset, at(x0 + (first + columns - 1) as u64, ny - 1));
            }
        }
        Ok(())
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
        match self.order {
            AxisOrder::XFastest => self.read_rows(region, out)?,
            AxisOrder::ZFastest => self.read_transposed(region, out)?,
        }
        self.check()
    }

    fn planes(&self, z: u64, count: u64) -> Result<Option<&[u8]>, Error> {
        let [nx, ny, _] = self.dims;
        self.check_region(&Region {
            origin: [0, 0, z],
            size: [nx, ny, count],
        })?;
        if self.order != AxisOrder::XFastest {
            return Ok(None);
        }
        self.check()?;
        let plane = nx * ny * self.voxel_bytes as u64;
        self.bytes.slice(self.offset + z * plane, count * plane)
    }

    fn check(&self) -> Result<(), Error> {
        self.bytes.check()
    }

    fn release(&self, z_end: u64) {
        let [nx, ny, nz] = self.dims;
        if self.order == AxisOrder::XFastest {
            let plane = nx * ny * self.voxel_bytes as u64;
            self.release_bytes(self.offset, self.offset + z_end.min(nz) * plane);
        }
    }
}
