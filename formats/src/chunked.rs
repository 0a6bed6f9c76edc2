//! Boxes of voxels out of pieces that are decoded one by one: chunks of a grid, tiles and strips,
//! slices.
//!
//! In: [`Chunks`], which decodes the piece with a given number. Out: [`RandomVoxels`].
//! Guaranteed: a box decodes each piece it touches once and nothing else; a piece known to be
//! uniform is not decoded; memory is the box and, for each thread that reads, one piece. Not
//! guaranteed: that two boxes within one piece decode it once, so whoever wants each piece once
//! reads boxes along [`RandomVoxels::chunk`].

use std::sync::{Mutex, PoisonError};

use crate::error::Error;
use crate::header::{Header, Region};
use crate::volume::RandomVoxels;

/// Pieces of a volume, all of one shape, on a grid that begins at voxel (0, 0, 0).
pub(crate) trait Chunks: Send + Sync {
    /// Replaces `out` by the voxels of piece `index`, x fastest, in the type and byte order of
    /// the header. Always a whole piece: where it passes the end of the volume, the rest is
    /// padding that nobody looks at.
    ///
    /// # Errors
    ///
    /// If the piece cannot be read or decoded.
    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error>;

    /// The value of all voxels of the piece, where that is known without reading it.
    fn uniform(&self, index: [u64; 3]) -> Option<[u8; 8]> {
        let _ = index;
        None
    }

    /// Bytes of all that is stored in one piece, where it goes on along further axes; `None` where
    /// it holds the voxels of this volume alone.
    fn whole_bytes(&self) -> Option<u64> {
        None
    }

    /// # Errors
    ///
    /// If what was read changed meanwhile.
    fn check(&self) -> Result<(), Error> {
        Ok(())
    }
}

/// The voxels of a volume in pieces.
pub(crate) struct ChunkedVoxels {
    name: String,
    dims: [u64; 3],
    voxel_bytes: usize,
    chunk: [u64; 3],
    chunks: Box<dyn Chunks>,
    /// Buffers of pieces, to be used again.
    spare: Mutex<Vec<Vec<u8>>>,
}

impl ChunkedVoxels {
    /// The volume of `header` in pieces of the shape `chunk`, each extent at least 1 and at most
    /// what memory holds.
    pub(crate) fn new(
        name: &str,
        header: &Header,
        chunk: [u64; 3],
        chunks: Box<dyn Chunks>,
    ) -> Self {
        debug_assert!(chunk.iter().all(|n| *n > 0));
        Self {
            name: name.to_string(),
            dims: header.dims,
            voxel_bytes: header.voxel.bytes(),
            chunk,
            chunks,
            spare: Mutex::new(Vec::new()),
        }
    }

    fn check_region(&self, region: &Region) -> Result<(), Error> {
        region.check_inside(self.dims, &self.name)
    }

    /// Bytes of a piece.
    fn chunk_bytes(&self) -> Option<usize> {
        let [x, y, z] = self.chunk;
        let voxels = x.checked_mul(y)?.checked_mul(z)?;
        usize::try_from(voxels.checked_mul(self.voxel_bytes as u64)?).ok()
    }

    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
        self.chunks.decode(index, out)?;
        let expected = self.chunk_bytes();
        if Some(out.len()) == expected {
            return Ok(());
        }
        Err(Error::invalid(
            &self.name,
            format!(
                "chunk {index:?} has {} bytes, expected {}",
                out.len(),
                expected.unwrap_or(usize::MAX)
            ),
        ))
    }

    /// Numbers of the first and the last piece that the region touches along an axis.
    fn touched(&self, region: &Region, axis: usize) -> std::ops::RangeInclusive<u64> {
        let first = region.origin[axis];
        first / self.chunk[axis]..=(first + region.size[axis] - 1) / self.chunk[axis]
    }

    /// Copies what a piece and the region share. `piece` is a whole piece, or one voxel that
    /// stands for all of it.
    fn copy_shared(&self, index: [u64; 3], piece: &[u8], region: &Region, out: &mut [u8]) {
        let bytes = self.voxel_bytes;
        let one = piece.len() == bytes;
        // In voxels of the volume; all within the extents, so nothing overflows.
        let first = [0, 1, 2].map(|a| (index[a] * self.chunk[a]).max(region.origin[a]));
        let end = [0, 1, 2].map(|a| {
            (index[a] * self.chunk[a])
                .saturating_add(self.chunk[a])
                .min(region.origin[a] + region.size[a])
        });
        let run = (end[0] - first[0]) as usize * bytes;
        let place = |at: [u64; 3], origin: [u64; 3], size: [u64; 3]| {
            let [x, y, z] = [0, 1, 2].map(|a| (at[a] - origin[a]) as usize);
            ((z * size[1] as usize + y) * size[0] as usize + x) * bytes
        };
        let corner = [0, 1, 2].map(|a| index[a] * self.chunk[a]);
        for z in first[2]..end[2] {
            for y in first[1]..end[1] {
                let to = place([first[0], y, z], region.origin, region.size);
                let to = &mut out[to..to + run];
                if one {
                    to.chunks_exact_mut(bytes)
                        .for_each(|voxel| voxel.copy_from_slice(piece));
                } else {
                    let from = place([first[0], y, z], corner, self.chunk);
                    to.copy_from_slice(&piece[from..from + run]);
                }
            }
        }
    }
}

impl RandomVoxels for ChunkedVoxels {
    fn read_box(&self, region: &Region, out: &mut Vec<u8>) -> Result<(), Error> {
        self.check_region(region)?;
        region.make_room(self.voxel_bytes, out, &self.name)?;
        if out.is_empty() {
            return Ok(());
        }
        let mut piece = self
            .spare
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop()
            .unwrap_or_default();
        for z in self.touched(region, 2) {
            for y in self.touched(region, 1) {
                for x in self.touched(region, 0) {
                    let index = [x, y, z];
                    if let Some(value) = self.chunks.uniform(index) {
                        self.copy_shared(index, &value[..self.voxel_bytes], region, out);
                        continue;
                    }
                    let origin = [0, 1, 2].map(|a| index[a] * self.chunk[a]);
                    if region.origin == origin && region.size == self.chunk {
                        self.decode(index, out)?;
                    } else {
                        self.decode(index, &mut piece)?;
                        self.copy_shared(index, &piece, region, out);
                    }
                }
            }
        }
        self.spare
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(piece);
        self.chunks.check()
    }

    fn planes(&self, z: u64, count: u64) -> Result<Option<&[u8]>, Error> {
        let [x, y, _] = self.dims;
        self.check_region(&Region {
            origin: [0, 0, z],
            size: [x, y, count],
        })?;
        Ok(None)
    }

    fn check(&self) -> Result<(), Error> {
        self.chunks.check()
    }

    fn chunk(&self) -> Option<[u64; 3]> {
        Some(self.chunk)
    }

    /// The piece as stored, which is hardly more than decoded, between two filters, and decoded.
    fn decode_bytes(&self) -> u64 {
        let own = self.chunk_bytes().map_or(u64::MAX, |bytes| bytes as u64);
        let whole = self.chunks.whole_bytes().unwrap_or(own);
        whole.saturating_mul(2).saturating_add(own)
    }

    fn uniform(&self, region: &Region) -> Option<[u8; 8]> {
        /// Asking more pieces than this one by one would cost more than it saves.
        const MOST_PIECES: u64 = 4096;
        if !region.is_inside(self.dims) || region.voxels() == Some(0) {
            return None;
        }
        let touched = [0, 1, 2].map(|a| self.touched(region, a));
        let count = |r: &std::ops::RangeInclusive<u64>| r.end() - r.start() + 1;
        let pieces = touched
            .iter()
            .try_fold(1_u64, |n, r| n.checked_mul(count(r)))?;
        if pieces > MOST_PIECES {
            return None;
        }
        let [xs, ys, zs] = touched;
        let mut value = None;
        for z in zs {
            for y in ys.clone() {
                for x in xs.clone() {
                    let here = self.chunks.uniform([x, y, z])?;
                    if *value.get_or_insert(here) != here {
                        return None;
                    }
                }
            }
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::conformance;
    use crate::header::{DType, Format, VoxelType};
    use crate::volume::{SourceInfo, Volume, Voxels};

    /// Voxels that say where they are; some pieces are uniform.
    struct Numbered {
        chunk: [u64; 3],
    }

    impl Chunks for Numbered {
        fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
            assert!(self.uniform(index).is_none());
            out.clear();
            for z in 0..self.chunk[2] {
                for y in 0..self.chunk[1] {
                    for x in 0..self.chunk[0] {
                        let at: Vec<_> = (0..3)
                            .map(|a| index[a] * self.chunk[a] + [x, y, z][a])
                            .collect();
                        out.extend(((at[2] * 40 + at[1]) * 40 + at[0]).to_le_bytes());
                    }
                }
            }
            Ok(())
        }

        fn uniform(&self, index: [u64; 3]) -> Option<[u8; 8]> {
            (index.iter().sum::<u64>() % 3 == 2).then_some([7; 8])
        }
    }

    proptest! {
        #[test]
        fn pieces_of_any_shape_give_planes_and_boxes(
            dims in [1_u64..20, 1_u64..20, 1_u64..20],
            chunk in [1_u64..9, 1_u64..9, 1_u64..30],
        ) {
            let header = Header::new(Format::Zarr, dims, DType::little(VoxelType::U64));
            let open = || {
                let chunks = Box::new(Numbered { chunk });
                Ok(Volume {
                    header: header.clone(),
                    voxels: Voxels::Random(Box::new(ChunkedVoxels::new("n", &header, chunk, chunks))),
                    source: SourceInfo::stream("n"),
                })
            };
            conformance::check(open).map_err(TestCaseError::fail)?;
            let Voxels::Random(voxels) = open().unwrap().voxels else { unreachable!() };
            let mut out = Vec::new();
            voxels.read_box(&Region::whole(dims), &mut out).unwrap();
            for (n, voxel) in out.chunks(8).enumerate() {
                let n = n as u64;
                let at = [n % dims[0], n / dims[0] % dims[1], n / dims[0] / dims[1]];
                let index = [0, 1, 2].map(|a| at[a] / chunk[a]);
                let expected = if index.iter().sum::<u64>() % 3 == 2 {
                    [7; 8]
                } else {
                    ((at[2] * 40 + at[1]) * 40 + at[0]).to_le_bytes()
                };
                prop_assert_eq!(voxel, &expected);
                let one = Region { origin: at, size: [1; 3] };
                let uniform = voxels.uniform(&one);
                prop_assert_eq!(uniform.is_some(), expected == [7; 8]);
            }
        }
    }
}
