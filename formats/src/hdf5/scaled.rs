//! Values that each plane scales in its own way: MINC.
//!
//! In: stored voxels and a scale for each plane. Out: the values, in single precision where that
//! holds all stored values, else in double.

use crate::chunked::Chunks;
use crate::error::Error;
use crate::header::{DType, Region, Scaling, VoxelType};
use crate::volume::RandomVoxels;

use super::attribute::numbers;

/// Voxels whose planes are scaled.
pub(super) struct ScaledPlanes {
    stored: Box<dyn RandomVoxels>,
    dtype: DType,
    dims: [u64; 3],
    /// Shape of the pieces, which is that of the stored ones within the volume.
    chunk: [u64; 3],
    /// One for each plane, or one for all.
    scales: Vec<Scaling>,
}

impl ScaledPlanes {
    pub(super) fn new(
        stored: Box<dyn RandomVoxels>,
        dtype: DType,
        dims: [u64; 3],
        scales: Vec<Scaling>,
    ) -> Self {
        Self {
            chunk: match stored.chunk() {
                Some(chunk) => [0, 1, 2].map(|a| chunk[a].min(dims[a])),
                None => [dims[0], dims[1], 1],
            },
            stored,
            dtype,
            dims,
            scales,
        }
    }

    pub(super) fn chunk(&self) -> [u64; 3] {
        self.chunk
    }

    /// The type of the values, little-endian.
    pub(super) fn voxel(&self) -> VoxelType {
        match self.dtype.voxel.bytes() {
            1 | 2 => VoxelType::F32,
            _ => VoxelType::F64,
        }
    }
}

impl Chunks for ScaledPlanes {
    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
        let origin = [0, 1, 2].map(|a| index[a] * self.chunk[a]);
        let size = [0, 1, 2].map(|a| self.chunk[a].min(self.dims[a] - origin[a]));
        let mut stored = Vec::new();
        self.stored
            .read_box(&Region { origin, size }, &mut stored)?;
        // Extents of what was just held in memory.
        let [nx, ny, _] = size.map(|n| n as usize);
        let [cx, cy, cz] = self.chunk.map(|n| n as usize);
        let bytes = self.voxel().bytes();
        out.clear();
        for (n, row) in stored.chunks(nx * self.dtype.voxel.bytes()).enumerate() {
            let (y, z) = (n % ny, n / ny);
            let scale = match self.scales.as_slice() {
                [all] => all,
                each => &each[origin[2] as usize + z],
            };
            out.resize((z * cy + y) * cx * bytes, 0);
            for value in numbers(self.dtype, row) {
                let value = scale.slope * value + scale.intercept;
                match bytes {
                    4 => out.extend((value as f32).to_le_bytes()),
                    _ => out.extend(value.to_le_bytes()),
                }
            }
        }
        out.resize(cx * cy * cz * bytes, 0);
        Ok(())
    }

    fn check(&self) -> Result<(), Error> {
        self.stored.check()
    }
}
