//! Voxels as bits: planes of the image, windows of planes, boxes cut out of a window.

use std::sync::Arc;

use rayon::slice::ParallelSliceMut;

/// One plane of the image, one bit a voxel, x fastest; each row starts on a word.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BitPlane {
    words: Vec<u64>,
    words_per_row: usize,
}

impl BitPlane {
    /// A plane of `dims_x * dims_y` voxels, all outside.
    #[must_use]
    pub fn outside(dims_x: u32, dims_y: u32) -> Self {
        let words_per_row = (dims_x as usize).div_ceil(64);
        Self {
            words: vec![0; words_per_row * dims_y as usize],
            words_per_row,
        }
    }

    /// The words of row `y`; bits past the last voxel are zero.
    #[inline]
    #[must_use]
    pub fn row(&self, y: usize) -> &[u64] {
        &self.words[y * self.words_per_row..(y + 1) * self.words_per_row]
    }

    /// All rows, to be filled in parallel; bits past the last voxel of a row must stay zero.
    pub fn par_rows_mut(&mut self) -> rayon::slice::ChunksExactMut<'_, u64> {
        self.words.par_chunks_exact_mut(self.words_per_row)
    }

    /// All rows, to be filled; bits past the last voxel of a row must stay zero.
    pub fn rows_mut(&mut self) -> std::slice::ChunksExactMut<'_, u64> {
        self.words.chunks_exact_mut(self.words_per_row)
    }

    /// Number of inside voxels.
    #[must_use]
    pub fn count_inside(&self) -> u64 {
        self.words.iter().map(|w| u64::from(w.count_ones())).sum()
    }

    /// Memory of a plane.
    #[must_use]
    pub fn bytes(dims_x: u32, dims_y: u32) -> u64 {
        u64::from(dims_x).div_ceil(64) * 8 * u64::from(dims_y)
    }
}

/// Consecutive planes of the image, shared. Planes below 0 and from `dims[2]` on are outside.
#[derive(Clone, Debug)]
pub struct PlaneWindow {
    /// Extents of the image.
    pub dims: [u32; 3],
    /// Index of the first plane held.
    pub z0: i32,
    /// The planes held.
    pub planes: Vec<Arc<BitPlane>>,
}

impl PlaneWindow {
    /// Row `y` of plane `z`; `None` where the image has ended.
    ///
    /// # Panics
    /// If the plane is part of the image but not held: a stage declared too short a reach.
    #[inline]
    #[must_use]
    pub fn row(&self, y: i32, z: i32) -> Option<&[u64]> {
        if y < 0 || z < 0 || y >= self.dims[1] as i32 || z >= self.dims[2] as i32 {
            return None;
        }
        let plane = usize::try_from(z - self.z0)
            .ok()
            .and_then(|i| self.planes.get(i));
        Some(
            plane
                .expect("plane within the declared reach")
                .row(y as usize),
        )
    }

    /// The planes `z` in `range` that exist, as a window of their own.
    #[must_use]
    pub fn narrowed(&self, range: std::ops::Range<i32>) -> PlaneWindow {
        let end = self.z0 + self.planes.len() as i32;
        let from = range.start.clamp(self.z0, end);
        let to = range.end.clamp(from, end);
        PlaneWindow {
            dims: self.dims,
            z0: from,
            planes: self.planes[(from - self.z0) as usize..(to - self.z0) as usize].to_vec(),
        }
    }
}

/// A box of voxels as bits, with the outside of the image filled with zeros.
#[derive(Clone, Debug, Default)]
pub struct BitBox {
    lo: [i32; 3],
    size: [i32; 3],
    words_per_row: usize,
    words: Vec<u64>,
}

impl BitBox {
    /// Cuts the voxels `lo <= p < hi` out of a window.
    #[must_use]
    pub fn cut(window: &PlaneWindow, lo: [i32; 3], hi: [i32; 3]) -> Self {
        let size = [0, 1, 2].map(|a| hi[a] - lo[a]);
        // One word more than the voxels need lets `bits` read two words without a test.
        let words_per_row = (size[0] as usize).div_ceil(64) + 1;
        let mut words = vec![0; words_per_row * (size[1] * size[2]) as usize];
        for (row, out) in words.chunks_exact_mut(words_per_row).enumerate() {
            let y = lo[1] + row as i32 % size[1];
            let z = lo[2] + row as i32 / size[1];
            let Some(source) = window.row(y, z) else {
                continue;
            };
            let last = words_per_row - 1;
            for (w, word) in out[..last].iter_mut().enumerate() {
                let first = lo[0] + 64 * w as i32;
                let at = first.div_euclid(64);
                let shift = first.rem_euclid(64) as u32;
                let fetch = |i: i32| {
                    usize::try_from(i)
                        .ok()
                        .and_then(|i| source.get(i))
                        .copied()
                        .unwrap_or(0)
                };
                let mut value = fetch(at) >> shift;
                if shift != 0 {
                    value |= fetch(at + 1) << (64 - shift);
                }
                let room = size[0] - 64 * w as i32;
                if room < 64 {
                    value &= (1 << room) - 1;
                }
                *word = value;
            }
        }
        Self {
            lo,
            size,
            words_per_row,
            words,
        }
    }

    /// First voxel of the box.
    #[must_use]
    pub fn lo(&self) -> [i32; 3] {
        self.lo
    }

    /// Extents of the box.
    #[must_use]
    pub fn size(&self) -> [i32; 3] {
        self.size
    }

    /// The words of the row at `y`, `z` (image coordinates); bit 0 is the voxel `lo[0]`. The last
    /// word is a guard and holds no voxel.
    #[inline]
    #[must_use]
    pub fn row(&self, y: i32, z: i32) -> &[u64] {
        let row = ((z - self.lo[2]) * self.size[1] + (y - self.lo[1])) as usize;
        &self.words[row * self.words_per_row..(row + 1) * self.words_per_row]
    }

    /// Whether a voxel of the box is inside the solid.
    #[inline]
    #[must_use]
    pub fn inside(&self, p: [i32; 3]) -> bool {
        let x = (p[0] - self.lo[0]) as usize;
        self.row(p[1], p[2])[x / 64] >> (x % 64) & 1 == 1
    }

    /// Up to 64 voxels of a row from `x` on, bit 0 being `x`.
    #[inline]
    #[must_use]
    pub fn bits(row: &[u64], x: usize) -> u64 {
        let (at, shift) = (x / 64, x % 64);
        // shifting twice makes a shift of 0 contribute nothing from the next word
        row[at] >> shift | (row[at + 1] << 1) << (63 - shift)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_holds_the_voxels_of_the_window_and_zeros_around() {
        let dims = [131, 5, 4];
        let inside = |x: i32, y: i32, z: i32| (x * 7 + y * 3 + z * 5 + x * y) % 3 == 0;
        let planes = (0..4)
            .map(|z| {
                let mut plane = BitPlane::outside(dims[0], dims[1]);
                for (y, row) in plane.rows_mut().enumerate() {
                    for x in 0..131 {
                        row[x / 64] |= u64::from(inside(x as i32, y as i32, z)) << (x % 64);
                    }
                }
                Arc::new(plane)
            })
            .collect();
        let window = PlaneWindow {
            dims,
            z0: 0,
            planes,
        };
        for lo in [[-3, -2, -1], [0, 0, 0], [60, 1, 2], [64, 0, 1], [126, 3, 3]] {
            let hi = [lo[0] + 75, lo[1] + 4, lo[2] + 3];
            let cut = BitBox::cut(&window, lo, hi);
            for z in lo[2]..hi[2] {
                for y in lo[1]..hi[1] {
                    for x in lo[0]..hi[0] {
                        let within =
                            (0..131).contains(&x) && (0..5).contains(&y) && (0..4).contains(&z);
                        assert_eq!(cut.inside([x, y, z]), within && inside(x, y, z));
                    }
                    let row = cut.row(y, z);
                    for x in 0..11 {
                        let bits = BitBox::bits(row, x);
                        assert_eq!(bits & 1 == 1, cut.inside([lo[0] + x as i32, y, z]));
                        assert_eq!(
                            bits >> 63 & 1 == 1,
                            cut.inside([lo[0] + x as i32 + 63, y, z])
                        );
                    }
                }
            }
        }
    }
}
