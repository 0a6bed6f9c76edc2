//! Boxes of voxels out of uncompressed bytes: a map, a file that is read, or memory.
//!
//! In: bytes and where the voxels lie in them. Out: [`RandomVoxels`]. Guaranteed: every access
//! is checked against the extents; the resident part of a map stays small when `release` is
//! called, and during transposed reads without it. Files that store z fastest (NumPy's Fortran
//! order of a (z, y, x) array) are transposed while reading: a box of many planes then costs
//! little more than one plane, so such files are best read in thick boxes.

use std::fs::File;
use std::io;
use std::path::PathBuf;

use crate::error::Error;
use crate::header::{Header, Region};
use crate::map::{Fingerprint, GuardedMap};
use crate::volume::RandomVoxels;

/// In which order the voxels are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AxisOrder {
    /// x varies fastest, then y: the canonical order.
    XFastest,
    /// z varies fastest, then y.
    ZFastest,
}

/// Where the bytes are.
#[derive(Debug)]
pub(crate) enum Bytes {
    Map(GuardedMap),
    File {
        file: File,
        path: PathBuf,
        fingerprint: Fingerprint,
    },
    Memory(Vec<u8>),
}

/// Voxels stored one behind the other.
#[derive(Debug)]
pub(crate) struct StoredVoxels {
    bytes: Bytes,
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
        bytes: Bytes,
        name: &str,
        offset: u64,
        header: &Header,
        order: AxisOrder,
    ) -> Self {
        if let (Bytes::Map(map), AxisOrder::XFastest) = (&bytes, order) {
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
        if region.is_inside(self.dims) {
            return Ok(());
        }
        Err(Error::invalid(
            &self.name,
            format!(
                "a box of {:?} voxels at {:?} was asked for, the volume has {:?}",
                region.size, region.origin, self.dims
            ),
        ))
    }

    /// The mapped or held bytes `start..start + count` of the file, if there are such.
    fn slice(&self, start: u64, count: u64) -> Result<Option<&[u8]>, Error> {
        let all = match &self.bytes {
            Bytes::Map(map) => map.bytes(),
            Bytes::Memory(bytes) => bytes,
            Bytes::File { .. } => return Ok(None),
        };
        let range = usize::try_from(start).ok().zip(usize::try_from(count).ok());
        let slice = range.and_then(|(start, count)| all.get(start..start.checked_add(count)?));
        // Reached only if the caller of `new` did not check the length.
        slice
            .map(Some)
            .ok_or_else(|| Error::invalid(&self.name, "the data ends early").at(start))
    }

    /// Fills `out` from the bytes at `start`.
    fn copy(&self, start: u64, out: &mut [u8]) -> Result<(), Error> {
        if let Some(bytes) = self.slice(start, out.len() as u64)? {
            out.copy_from_slice(bytes);
        } else if let Bytes::File { file, .. } = &self.bytes {
            read_exact_at(file, out, start)
                .map_err(|e| Error::io(&self.name, "cannot be read", e).at(start))?;
        }
        Ok(())
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
                    self.copy(at(x, y + j, z + k), out)?;
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
        let reads = matches!(self.bytes, Bytes::File { .. });
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
                        self.copy(start, &mut buffer[..span])?;
                        &buffer[..span]
                    } else {
                        self.slice(start, span as u64)?.unwrap_or_default()
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
        if let Bytes::Map(map) = &self.bytes
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
        let too_large = || Error::unsupported(&self.name, "the box does not fit memory");
        let bytes = region
            .voxels()
            .and_then(|n| n.checked_mul(self.voxel_bytes as u64))
            .and_then(|n| usize::try_from(n).ok())
            .ok_or_else(too_large)?;
        // Not cleared first: a buffer of the same size is then not written twice.
        out.truncate(bytes);
        out.try_reserve_exact(bytes - out.len())
            .map_err(|_| too_large())?;
        out.resize(bytes, 0);
        if bytes == 0 {
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
        self.slice(self.offset + z * plane, count * plane)
    }

    fn check(&self) -> Result<(), Error> {
        match &self.bytes {
            Bytes::Map(map) => map.check(),
            Bytes::File {
                file,
                path,
                fingerprint,
            } => fingerprint.check(file, path),
            Bytes::Memory(_) => Ok(()),
        }
    }

    fn release(&self, z_end: u64) {
        let [nx, ny, nz] = self.dims;
        if self.order == AxisOrder::XFastest {
            let plane = nx * ny * self.voxel_bytes as u64;
            self.release_bytes(self.offset, self.offset + z_end.min(nz) * plane);
        }
    }
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
