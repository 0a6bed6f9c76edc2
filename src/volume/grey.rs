//! Grey values: stored planes kept beside the bits, and boxes of values cut out of them.
//!
//! Comes in: planes as the file stores them, and how their bytes become values ([`ValueType`]).
//! Goes out: a [`GreyBox`], any box of voxels as `f64`, with byte order and scaling undone (so a
//! negative slope turns the values over, as it should).
//!
//! Guaranteed: beyond the border of the image a box holds the value of the nearest voxel. Whole
//! numbers beyond 2^53 are rounded to the nearest `f64`. NaN stays NaN.

use std::sync::Arc;

use curvox_formats::{ByteOrder, Header, Scaling, VoxelType};
use half::f16;

use super::tiles::{Content, TILE_WIDTH, TileMap};

/// How stored bytes become values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueType {
    /// Type of a stored voxel.
    pub voxel: VoxelType,
    /// Order of its bytes.
    pub byte_order: ByteOrder,
    /// What turns stored values into values; `None` when they are the values.
    pub scaling: Option<Scaling>,
}

impl ValueType {
    /// The values of a volume.
    #[must_use]
    pub fn of(header: &Header) -> Self {
        Self {
            voxel: header.voxel,
            byte_order: header.byte_order,
            scaling: header.scaling,
        }
    }

    /// Turns stored voxels into as many values.
    pub fn decode(&self, stored: &[u8], out: &mut [f64]) {
        macro_rules! decode {
            ($type:ty, $to_f64:expr) => {{
                let chunks = stored.as_chunks::<{ size_of::<$type>() }>().0;
                if self.byte_order == ByteOrder::Big {
                    for (value, &bytes) in out.iter_mut().zip(chunks) {
                        *value = $to_f64(<$type>::from_be_bytes(bytes));
                    }
                } else {
                    for (value, &bytes) in out.iter_mut().zip(chunks) {
                        *value = $to_f64(<$type>::from_le_bytes(bytes));
                    }
                }
            }};
        }
        match self.voxel {
            VoxelType::Bool | VoxelType::U8 => decode!(u8, f64::from),
            VoxelType::I8 => decode!(i8, f64::from),
            VoxelType::U16 => decode!(u16, f64::from),
            VoxelType::I16 => decode!(i16, f64::from),
            VoxelType::U32 => decode!(u32, f64::from),
            VoxelType::I32 => decode!(i32, f64::from),
            VoxelType::U64 => decode!(u64, |x| x as f64),
            VoxelType::I64 => decode!(i64, |x| x as f64),
            VoxelType::F16 => decode!(f16, f64::from),
            VoxelType::F32 => decode!(f32, f64::from),
            VoxelType::F64 => decode!(f64, |x| x),
        }
        if let Some(scaling) = self.scaling {
            for value in out {
                *value = scaling.slope * *value + scaling.intercept;
            }
        }
    }
}

/// A plane of the image as stored.
#[derive(Clone, Debug)]
pub enum GreyPlane {
    /// All rows, one after the other.
    Rows(Vec<u8>),
    /// The rows of each tile that the map keeps.
    Tiles {
        /// Which tiles those are, and the values of the others.
        map: Arc<TileMap>,
        /// [`TILE_WIDTH`] voxels for each row of each tile.
        bytes: Vec<u8>,
    },
}

/// Consecutive planes of the image as stored, shared.
#[derive(Clone, Debug)]
pub struct GreyWindow {
    /// Extents of the image.
    pub dims: [u32; 3],
    /// Index of the first plane held.
    pub z0: i32,
    /// What the bytes mean.
    pub values: ValueType,
    /// The planes held.
    pub planes: Vec<Arc<GreyPlane>>,
}

impl GreyWindow {
    /// Decodes the voxels of row `y` of plane `z` from `from` on, as many as `out` holds.
    ///
    /// # Panics
    /// If the plane is not held: a stage declared too short a reach.
    fn decode(&self, y: i32, z: i32, from: i32, out: &mut [f64]) {
        let plane = usize::try_from(z - self.z0)
            .ok()
            .and_then(|i| self.planes.get(i))
            .expect("plane within the declared reach");
        let bytes = self.values.voxel.bytes();
        let (y, from) = (y as usize, from as usize);
        match &**plane {
            GreyPlane::Rows(stored) => {
                let at = (y * self.dims[0] as usize + from) * bytes;
                self.values.decode(&stored[at..at + out.len() * bytes], out);
            }
            GreyPlane::Tiles { map, bytes: kept } => {
                let (width, band) = (TILE_WIDTH as usize, map.band());
                let to = from + out.len();
                let tiles = (from / width) as u32..to.div_ceil(width) as u32;
                for (tiles, content) in map.row(y as u32, tiles) {
                    for (i, tile) in tiles.enumerate() {
                        let start = tile as usize * width;
                        let x = start.max(from)..(start + width).min(to);
                        let part = &mut out[x.start - from..x.end - from];
                        match content {
                            Content::Uniform { value, .. } => {
                                self.values.decode(&value[..bytes], &mut part[..1]);
                                part.fill(part[0]);
                            }
                            Content::Tiles(first) => {
                                let row = (first as usize + i) * band + map.row_in_tile(y);
                                let at = (row * width + x.start - start) * bytes;
                                self.values.decode(&kept[at..at + part.len() * bytes], part);
                            }
                        }
                    }
                }
            }
        }
    }
}

/// A box of values; beyond the border of the image, those of the nearest voxels.
#[derive(Clone, Debug)]
pub struct GreyBox {
    lo: [i32; 3],
    size: [usize; 3],
    values: Vec<f64>,
}

impl GreyBox {
    /// Cuts the voxels `lo <= p < hi` out of a window. The box must not be empty.
    #[must_use]
    pub fn cut(window: &GreyWindow, lo: [i32; 3], hi: [i32; 3]) -> Self {
        let size = [0, 1, 2].map(|a| (hi[a] - lo[a]) as usize);
        let mut values = vec![0.0; size[0] * size[1] * size[2]];
        let last = window.dims.map(|n| n as i32 - 1);
        // The part of a row that is in the image; one voxel at least, for a row beside it.
        let from = lo[0].clamp(0, last[0]);
        let to = hi[0].clamp(from + 1, last[0] + 1);
        for (row, out) in values.chunks_exact_mut(size[0]).enumerate() {
            let y = (lo[1] + (row % size[1]) as i32).clamp(0, last[1]);
            let z = (lo[2] + (row / size[1]) as i32).clamp(0, last[2]);
            let before = ((from - lo[0]).max(0) as usize).min(size[0] - 1);
            let within = ((to - from) as usize).min(size[0] - before);
            let (left, rest) = out.split_at_mut(before);
            let (middle, right) = rest.split_at_mut(within);
            window.decode(y, z, from, middle);
            left.fill(middle[0]);
            right.fill(middle[within - 1]);
        }
        Self { lo, size, values }
    }

    /// The values of `count` voxels of a row, from voxel `p` on.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, p: [i32; 3], count: usize) -> &[f64] {
        let [x, y, z] = [0, 1, 2].map(|a| (p[a] - self.lo[a]) as usize);
        let at = (z * self.size[1] + y) * self.size[0] + x;
        &self.values[at..at + count]
    }

    /// The value of voxel `p`.
    #[inline]
    #[must_use]
    pub fn value(&self, p: [i32; 3]) -> f64 {
        self.row(p, 1)[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value_type(voxel: VoxelType, byte_order: ByteOrder, scaling: Option<Scaling>) -> ValueType {
        ValueType {
            voxel,
            byte_order,
            scaling,
        }
    }

    #[test]
    fn values_are_decoded_in_both_byte_orders_and_scaled() {
        let stored = [-3i16, 0, 700];
        let little: Vec<u8> = stored.iter().flat_map(|v| v.to_le_bytes()).collect();
        let big: Vec<u8> = stored.iter().flat_map(|v| v.to_be_bytes()).collect();
        let scaling = Scaling {
            slope: -0.5,
            intercept: 1.0,
        };
        let mut out = [0.0; 3];
        value_type(VoxelType::I16, ByteOrder::Big, None).decode(&big, &mut out);
        assert_eq!(out, [-3.0, 0.0, 700.0]);
        value_type(VoxelType::I16, ByteOrder::Little, Some(scaling)).decode(&little, &mut out);
        assert_eq!(out, [2.5, 1.0, -349.0]);
        let mut out = [0.0; 2];
        let halves: Vec<u8> = [f16::from_f32(0.25), f16::NAN]
            .iter()
            .flat_map(|v| v.to_be_bytes())
            .collect();
        value_type(VoxelType::F16, ByteOrder::Big, None).decode(&halves, &mut out);
        assert!(out[0] == 0.25 && out[1].is_nan());
    }

    #[test]
    fn a_box_repeats_the_nearest_voxel_beyond_the_border() {
        let dims = [5, 3, 4];
        let at = |x: i32, y: i32, z: i32| (x + 10 * y + 50 * z) as u8;
        let planes = (0..4)
            .map(|z| {
                let plane = (0..15).map(|i| at(i % 5, i / 5, z)).collect();
                Arc::new(GreyPlane::Rows(plane))
            })
            .collect();
        let window = GreyWindow {
            dims,
            z0: 0,
            values: value_type(VoxelType::U8, ByteOrder::Little, None),
            planes,
        };
        for (lo, hi) in [
            ([-3, -2, -1], [7, 5, 6]),
            ([1, 1, 1], [3, 2, 3]),
            ([5, 0, 0], [8, 1, 1]),
            ([-4, 0, 0], [-1, 1, 1]),
            ([4, 2, 3], [5, 3, 4]),
        ] {
            let cut = GreyBox::cut(&window, lo, hi);
            for z in lo[2]..hi[2] {
                for y in lo[1]..hi[1] {
                    for x in lo[0]..hi[0] {
                        let expected = at(x.clamp(0, 4), y.clamp(0, 2), z.clamp(0, 3));
                        assert_eq!(cut.value([x, y, z]), f64::from(expected), "{x} {y} {z}");
                    }
                }
            }
        }
    }
}
