//! The surfels of a box of cells, numbered in Khalimsky order.
//!
//! Between consecutive planes of voxels lie the surfels along z (`kz` even), then, row by row,
//! the surfels along y (`ky` even) and those along x. Laid out in that order, one bit a surfel,
//! the rank of a bit is the number of the surfel: no hash, 1.5 bits of index a cell and axis.

use std::ops::Range;

use crate::khalimsky::{Direction, OrientedSurfel, step};
use crate::lattice::Lattice;
use crate::simd::{Level, Work, dispatch};
use crate::volume::{BitBox, PlaneWindow};

/// A box of cells `lo <= c < hi`, in image coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellBox {
    /// First cell.
    pub lo: [i32; 3],
    /// One past the last cell.
    pub hi: [i32; 3],
}

impl CellBox {
    /// Extents of the box.
    #[must_use]
    pub fn size(&self) -> [i32; 3] {
        [0, 1, 2].map(|a| self.hi[a] - self.lo[a])
    }

    /// The box grown by `reach` cells on each side, within a grid of `dims` cells.
    #[must_use]
    pub fn grown(&self, reach: [i32; 3], dims: [i32; 3]) -> CellBox {
        CellBox {
            lo: [0, 1, 2].map(|a| (self.lo[a] - reach[a]).max(0)),
            hi: [0, 1, 2].map(|a| (self.hi[a] + reach[a]).min(dims[a])),
        }
    }

    /// Whether a cell is in the box.
    #[inline]
    #[must_use]
    pub fn contains(&self, c: [i32; 3]) -> bool {
        (0..3).all(|a| self.lo[a] <= c[a] && c[a] < self.hi[a])
    }
}

/// The axis along which surfels of a row separate voxels, in the order of Khalimsky coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Surfels along z: `kz` is even.
    Z,
    /// Surfels along y.
    Y,
    /// Surfels along x.
    X,
}

impl Kind {
    /// The axis: 0, 1 or 2.
    #[inline]
    #[must_use]
    pub const fn axis(self) -> usize {
        match self {
            Kind::X => 0,
            Kind::Y => 1,
            Kind::Z => 2,
        }
    }

    const BY_AXIS: [Kind; 3] = [Kind::X, Kind::Y, Kind::Z];
}

/// The surfels of a box of cells as ranked bits.
#[derive(Clone, Debug)]
pub struct SurfelIndex {
    cells: CellBox,
    words_per_row: usize,
    /// For each plane of cells: the rows of kind Z; then for each y a row of kind Y and one of X.
    words: Vec<u64>,
    /// Number of surfels before each word, and the total.
    rank: Vec<u32>,
}

impl SurfelIndex {
    /// Finds the surfels owned by `cells`. `bits` must hold the voxels from `cells.lo - 1` to
    /// `cells.hi`, at least.
    #[must_use]
    pub fn find(bits: &BitBox, cells: CellBox, lattice: &Lattice) -> Self {
        dispatch(Find {
            bits,
            cells,
            lattice,
        })
    }

    /// Number of surfels.
    #[inline]
    #[must_use]
    pub fn len(&self) -> usize {
        self.rank[self.rank.len() - 1] as usize
    }

    /// Whether there is no surfel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The cells covered.
    #[must_use]
    pub fn cells(&self) -> CellBox {
        self.cells
    }

    /// Memory held, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.words.len() * 8 + self.rank.len() * 4
    }

    /// Memory of an index of a box of cells, at most.
    #[must_use]
    pub fn most_bytes(size: [i32; 3]) -> u64 {
        let rows = 3 * size[1] as u64 * size[2] as u64;
        rows * (size[0] as u64).div_ceil(64) * 12 + 4
    }

    #[inline(always)]
    fn row_start(&self, kind: Kind, y: i32, z: i32) -> usize {
        let size_y = (self.cells.hi[1] - self.cells.lo[1]) as usize;
        let (y, z) = (
            (y - self.cells.lo[1]) as usize,
            (z - self.cells.lo[2]) as usize,
        );
        let row = match kind {
            Kind::Z => 3 * size_y * z + y,
            Kind::Y => 3 * size_y * z + size_y + 2 * y,
            Kind::X => 3 * size_y * z + size_y + 2 * y + 1,
        };
        row * self.words_per_row
    }

    /// Number of surfels before the cell at `x` (which may be one past the row) of a row.
    #[inline(always)]
    fn rank_at(&self, row_start: usize, x: i32) -> u32 {
        let x = (x - self.cells.lo[0]) as usize;
        let (w, bit) = (x / 64, x % 64);
        let at = row_start + w;
        if bit == 0 {
            return self.rank[at];
        }
        self.rank[at] + (self.words[at] & low_bits(bit as u32)).count_ones()
    }

    /// Numbers of the surfels of one kind in the cells `x` of a row.
    #[inline(always)]
    #[must_use]
    pub fn range(&self, kind: Kind, x: Range<i32>, y: i32, z: i32) -> Range<usize> {
        let row = self.row_start(kind, y, z);
        self.rank_at(row, x.start) as usize..self.rank_at(row, x.end) as usize
    }

    /// Numbers of the surfels of planes `z` of cells, which must be covered.
    #[must_use]
    pub fn planes(&self, z: Range<i32>) -> Range<usize> {
        let rows = 3 * (self.cells.hi[1] - self.cells.lo[1]) as usize;
        let before = |z: i32| {
            let planes = (z - self.cells.lo[2]) as usize;
            self.rank[planes * rows * self.words_per_row] as usize
        };
        before(z.start)..before(z.end)
    }

    /// Whether a row has surfels of one kind.
    #[inline(always)]
    #[must_use]
    pub fn has_any(&self, kind: Kind, y: i32, z: i32) -> bool {
        let row = self.row_start(kind, y, z);
        self.rank[row] != self.rank[row + self.words_per_row]
    }

    /// How many surfels of one kind are in the cells `x` of a row.
    #[inline(always)]
    #[must_use]
    pub fn count(&self, kind: Kind, x: Range<i32>, y: i32, z: i32) -> u32 {
        let row = self.row_start(kind, y, z);
        let (from, to) = (
            (x.start - self.cells.lo[0]) as usize,
            (x.end - self.cells.lo[0]) as usize,
        );
        let (first, last) = (from / 64, to / 64);
        let head = self.words[row + first] & !low_bits((from % 64) as u32);
        let tail = low_bits((to % 64) as u32);
        if first == last {
            return (head & tail).count_ones();
        }
        let mut count = head.count_ones();
        for word in &self.words[row + first + 1..row + last] {
            count += word.count_ones();
        }
        // a row that ends with its last word has no word for its end
        if tail != 0 {
            count += (self.words[row + last] & tail).count_ones();
        }
        count
    }

    /// The number of the bit of a surfel of kind `axis` of a cell among all bits.
    #[inline(always)]
    pub(super) fn bit(&self, axis: usize, cell: [i32; 3]) -> usize {
        let row = self.row_start(Kind::BY_AXIS[axis], cell[1], cell[2]);
        64 * row + (cell[0] - self.cells.lo[0]) as usize
    }

    /// How far the bits of a kind are for the next cell along each axis.
    pub(super) fn strides(&self, axis: usize) -> [isize; 3] {
        let row = 64 * self.words_per_row as isize;
        let rows_a_y = if axis == 2 { 1 } else { 2 };
        let size_y = (self.cells.hi[1] - self.cells.lo[1]) as isize;
        [1, rows_a_y * row, 3 * size_y * row]
    }

    /// Number of the surfel of a bit, which must be set.
    #[inline(always)]
    pub(super) fn number(&self, bit: usize) -> u32 {
        let word = self.words[bit / 64];
        debug_assert!(word >> (bit % 64) & 1 == 1, "a surfel");
        self.rank[bit / 64] + (word & low_bits((bit % 64) as u32)).count_ones()
    }

    /// Number of the surfel of a cell along an axis, if there is one. The cell must be covered.
    #[inline]
    #[must_use]
    pub fn find_at(&self, axis: usize, cell: [i32; 3]) -> Option<u32> {
        let row = self.row_start(Kind::BY_AXIS[axis], cell[1], cell[2]);
        let x = (cell[0] - self.cells.lo[0]) as usize;
        let (w, bit) = (x / 64, x % 64);
        let word = self.words[row + w];
        if word >> bit & 1 == 0 {
            return None;
        }
        Some(self.rank[row + w] + (word & low_bits(bit as u32)).count_ones())
    }

    /// Calls `f` for each surfel in order: its kind and owning cell.
    #[inline(always)]
    pub fn for_each(&self, mut f: impl FnMut(Kind, [i32; 3])) {
        let CellBox { lo, hi } = self.cells;
        let mut row = 0;
        for z in lo[2]..hi[2] {
            for y in lo[1]..hi[1] {
                self.scan(Kind::Z, row, [y, z], &mut f);
                row += 1;
            }
            for y in lo[1]..hi[1] {
                self.scan(Kind::Y, row, [y, z], &mut f);
                self.scan(Kind::X, row + 1, [y, z], &mut f);
                row += 2;
            }
        }
    }

    /// Calls `f` for each surfel of a row.
    #[inline(always)]
    fn scan(&self, kind: Kind, row: usize, [y, z]: [i32; 2], f: &mut impl FnMut(Kind, [i32; 3])) {
        let first = row * self.words_per_row;
        if self.rank[first] == self.rank[first + self.words_per_row] {
            return;
        }
        let words = &self.words[first..][..self.words_per_row];
        for (w, &word) in words.iter().enumerate() {
            let mut rest = word;
            while rest != 0 {
                let x = self.cells.lo[0] + 64 * w as i32 + rest.trailing_zeros() as i32;
                f(kind, [x, y, z]);
                rest &= rest - 1;
            }
        }
    }

    /// Number of surfels in each plane of cells, without keeping an index: what a slab will cost.
    #[must_use]
    pub fn count_plane(window: &PlaneWindow, z: i32, lattice: &Lattice) -> u64 {
        let mut count = 0;
        let [x, y, _] = lattice.cell_dims();
        let planes = z..z + 1;
        window.rectangles(
            [0; 2],
            [x, y],
            planes,
            64,
            lattice.closed,
            &mut |lo, hi, known| {
                if known.is_none() {
                    let rows = CountRows {
                        window,
                        lo,
                        hi,
                        z,
                        lattice,
                    };
                    count += dispatch(rows);
                }
            },
        );
        count
    }
}

/// Finds the surfels of an index.
struct Find<'a> {
    bits: &'a BitBox,
    cells: CellBox,
    lattice: &'a Lattice,
}

impl Work for Find<'_> {
    type Output = SurfelIndex;

    #[inline(always)]
    fn run<L: Level>(self) -> SurfelIndex {
        let Self {
            bits,
            cells,
            lattice,
        } = self;
        let size = cells.size();
        let words_per_row = (size[0] as usize).div_ceil(64);
        let rows = 3 * (size[1] * size[2]) as usize;
        let mut words = vec![0u64; rows * words_per_row];
        let x0 = (cells.lo[0] - bits.lo()[0]) as usize;
        // Bits of cells that may own a surfel along x, and along y and z, in each word of a row.
        let masks = |lo: i32, hi: i32| -> Vec<u64> {
            (0..words_per_row)
                .map(|w| {
                    let first = cells.lo[0] + 64 * w as i32;
                    let from = (lo - first).clamp(0, 64) as u32;
                    let to = (hi.min(cells.hi[0]) - first).clamp(0, 64) as u32;
                    low_bits(to) & !low_bits(from)
                })
                .collect()
        };
        let dims = lattice.dims.map(|n| n as i32);
        // On an open image no surfel lies on the border: cell 0 owns none along the axis.
        let first = i32::from(!lattice.closed);
        let end = dims.map(|n| n + i32::from(lattice.closed));
        let along_x = masks(first, end[0]);
        let across_x = masks(0, dims[0]);
        let row_words = size[1] as usize * words_per_row;
        // The voxels of two planes from the first cell of each row on; first the row before the first cell.
        let mut planes = [const { Vec::new() }; 2];
        self.plane_into(x0, words_per_row, cells.lo[2] - 1, &mut planes[0]);
        for (dz, plane) in words.chunks_exact_mut((3 * row_words).max(1)).enumerate() {
            let z = cells.lo[2] + dz as i32;
            let [here, below] = &mut planes;
            std::mem::swap(here, below);
            self.plane_into(x0, words_per_row, z, here);
            let (z_rows, yx_rows) = plane.split_at_mut(row_words);
            if (first..end[2]).contains(&z) {
                // up to the last row of voxels
                let held = (dims[1] - cells.lo[1]).clamp(0, size[1]) as usize * words_per_row;
                let both = here[words_per_row..].iter().zip(&below[words_per_row..]);
                for (out, (here, below)) in z_rows[..held].iter_mut().zip(both) {
                    *out = here ^ below;
                }
                for row in z_rows[..held].chunks_exact_mut(words_per_row) {
                    for (out, mask) in row.iter_mut().zip(&across_x) {
                        *out &= mask;
                    }
                }
            }
            if z >= dims[2] {
                continue;
            }
            let rows = yx_rows.chunks_exact_mut(2 * words_per_row);
            let both = here.windows(2 * words_per_row).step_by(words_per_row);
            for (dy, (pair, both)) in rows.zip(both).enumerate() {
                let y = cells.lo[1] + dy as i32;
                let (before, here) = both.split_at(words_per_row);
                let (along_y, along_x_row) = pair.split_at_mut(words_per_row);
                if (first..end[1]).contains(&y) {
                    for w in 0..words_per_row {
                        along_y[w] = (here[w] ^ before[w]) & across_x[w];
                    }
                }
                if y < dims[1] {
                    let row = bits.row(y, z);
                    let mut carry = BitBox::bits(row, x0 - 1) & 1;
                    for w in 0..words_per_row {
                        along_x_row[w] = (here[w] ^ (here[w] << 1 | carry)) & along_x[w];
                        carry = here[w] >> 63;
                    }
                }
            }
        }
        let mut total = 0u32;
        let mut rank = vec![0; words.len() + 1];
        for (rank, word) in rank.iter_mut().zip(&words) {
            *rank = total;
            total += word.count_ones();
        }
        rank[words.len()] = total;
        SurfelIndex {
            cells,
            words_per_row,
            words,
            rank,
        }
    }
}

impl Find<'_> {
    /// The rows of a plane of voxels, from that before the first cell on, each from its first cell on.
    #[inline(always)]
    fn plane_into(&self, x0: usize, words_per_row: usize, z: i32, to: &mut Vec<u64>) {
        let rows = self.cells.lo[1] - 1..self.cells.hi[1];
        to.resize(rows.len() * words_per_row, 0);
        for (y, to) in rows.zip(to.chunks_exact_mut(words_per_row)) {
            let row = self.bits.row(y, z);
            for (w, to) in to.iter_mut().enumerate() {
                *to = BitBox::bits(row, x0 + 64 * w);
            }
        }
    }
}

/// Counts the surfels of the cells `lo <= c < hi` of a plane; `lo[0]` is a multiple of 64.
struct CountRows<'a> {
    window: &'a PlaneWindow,
    lo: [i32; 2],
    hi: [i32; 2],
    z: i32,
    lattice: &'a Lattice,
}

impl Work for CountRows<'_> {
    type Output = u64;

    #[inline(always)]
    fn run<L: Level>(self) -> u64 {
        let Self {
            window,
            lo,
            hi,
            z,
            lattice,
        } = self;
        let dims = lattice.dims.map(|n| n as i32);
        // One word before, for its last voxel.
        let skipped = usize::from(lo[0] > 0);
        let first = lo[0] as usize / 64 - skipped;
        let words = first..(hi[0] as usize).div_ceil(64);
        let zero = vec![0u64; words.len()];
        let mut buffers = [const { Vec::new() }; 3];
        let mut count = 0u64;
        for y in lo[1]..hi[1] {
            let [b0, b1, b2] = &mut buffers;
            let rows = [
                window.span([y, z], words.clone(), b0),
                window.span([y - 1, z], words.clone(), b1),
                window.span([y, z - 1], words.clone(), b2),
            ];
            // Rows of the image have one length; beyond it there are none.
            let held = rows.map(<[u64]>::len).into_iter().max().unwrap_or(0);
            let [here, before, below] = rows.map(|r| if r.is_empty() { &zero[..held] } else { r });
            let along_y = lattice.closed || (1..dims[1]).contains(&y);
            let along_z =
                (0..dims[1]).contains(&y) && (lattice.closed || (1..dims[2]).contains(&z));
            let mut carry = 0;
            if skipped == 1 && held > 0 {
                carry = here[0] >> 63;
            }
            for w in skipped..held {
                if along_z {
                    count += u64::from((here[w] ^ below[w]).count_ones());
                }
                if along_y {
                    count += u64::from((here[w] ^ before[w]).count_ones());
                }
                let mut along_x = here[w] ^ (here[w] << 1 | carry);
                carry = here[w] >> 63;
                if !lattice.closed {
                    // no surfel before the first voxel, none after the last
                    let at = 64 * (first + w) as i32;
                    if at == 0 {
                        along_x &= !1;
                    }
                    if dims[0] - at < 64 {
                        along_x &= low_bits((dims[0] - at) as u32);
                    }
                }
                count += u64::from(along_x.count_ones());
            }
            // The surfel behind a row that ends with its last word.
            if words.len() > held.max(skipped) {
                count += carry;
            }
        }
        count
    }
}

/// The `n` lowest bits, `n <= 64`.
#[inline(always)]
fn low_bits(n: u32) -> u64 {
    if n >= 64 { !0 } else { (1 << n) - 1 }
}

/// A surfel of a box: its Khalimsky coordinates relative to the box's first cell, its orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Surfel {
    /// Khalimsky coordinates less `2 * cells.lo`.
    pub k: [i16; 3],
    /// From the inner to the outer voxel.
    pub orientation: Direction,
}

/// The unit steps along all directions.
const STEPS: [[i32; 3]; 6] = [step(0), step(1), step(2), step(3), step(4), step(5)];

/// The places of the surfels of an index, in its order.
#[derive(Clone, Debug, Default)]
pub struct Surfels {
    /// Khalimsky coordinates of the origin of the relative ones.
    pub k0: [i32; 3],
    /// The surfels.
    pub list: Vec<Surfel>,
}

impl Surfels {
    /// Extents of boxes whose relative coordinates fit 16 bits.
    pub const MAX_CELLS: i32 = 16_000;

    /// Lists the surfels of an index; `bits` tells which voxel is the inner one.
    ///
    /// # Panics
    /// If the box is longer than [`Self::MAX_CELLS`] along an axis.
    #[must_use]
    pub fn list(index: &SurfelIndex, bits: &BitBox) -> Self {
        let lo = index.cells().lo;
        assert!(
            index.cells().size().iter().all(|&n| n <= Self::MAX_CELLS),
            "box too long"
        );
        let mut list = Vec::with_capacity(index.len());
        index.for_each(|kind, cell| {
            let axis = kind.axis();
            // The cell itself inside: the surfel looks down the axis; else it looks up.
            let inside = bits.at(bits.bit(cell).0);
            let orientation = 2 * axis as Direction + inside as Direction;
            let mut k = [0, 1, 2].map(|a| (2 * (cell[a] - lo[a]) + 1) as i16);
            k[axis] -= 1;
            list.push(Surfel { k, orientation });
        });
        Self {
            k0: lo.map(|c| 2 * c),
            list,
        }
    }

    /// Khalimsky coordinates of surfel `i` in the image.
    #[inline]
    #[must_use]
    pub fn khalimsky(&self, i: usize) -> [i32; 3] {
        let k = self.list[i].k;
        [0, 1, 2].map(|a| self.k0[a] + i32::from(k[a]))
    }

    /// Surfel `i` by its inner voxel.
    #[inline]
    #[must_use]
    pub fn oriented(&self, i: usize) -> OrientedSurfel {
        let orientation = self.list[i].orientation;
        let (mut inner, out) = (self.khalimsky(i), STEPS[orientation as usize]);
        for a in 0..3 {
            inner[a] = (inner[a] - out[a]) >> 1;
        }
        OrientedSurfel { inner, orientation }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brick::BrickGrid;
    use crate::volume::{BitPlane, SolidCounts};

    /// Planes with a box of inside voxels and its opposite, with what is known of their squares or without.
    fn window(lo: [u32; 3], hi: [u32; 3], opposite: bool, known: bool) -> PlaneWindow {
        let dims = [150, 130, 3];
        let planes = (0..dims[2]).map(|z| {
            let mut words = vec![0u64; 3 * dims[1] as usize];
            for y in 0..dims[1] {
                for x in 0..dims[0] {
                    let inside = (0..3).all(|a| (lo[a]..hi[a]).contains(&[x, y, z][a]));
                    let word = &mut words[(3 * y + x / 64) as usize];
                    *word |= u64::from(inside != opposite) << (x % 64);
                }
            }
            let mut plane = BitPlane::from_rows(dims[0], words);
            if !known {
                let _ = plane.rows_mut();
            }
            Arc::new(plane)
        });
        PlaneWindow {
            dims,
            z0: 0,
            planes: planes.collect(),
        }
    }

    #[test]
    fn what_is_known_of_squares_does_not_show() {
        for (lo, hi) in [
            ([0; 3], [0; 3]),
            ([0; 3], [150, 130, 3]),
            ([64, 64, 1], [128, 128, 2]),
            ([63, 0, 0], [65, 1, 3]),
            ([149, 129, 2], [150, 130, 3]),
            ([0, 64, 0], [150, 128, 2]),
        ] {
            for opposite in [false, true] {
                let [plain, known] = [false, true].map(|known| window(lo, hi, opposite, known));
                for z in 0..=3 {
                    let counts = [&plain, &known].map(|window| SolidCounts::of_plane(window, z));
                    assert_eq!(counts[0], counts[1], "{lo:?} {hi:?} {opposite} {z}");
                }
                for closed in [false, true] {
                    let lattice = Lattice::new([150, 130, 3], [1.0; 3], closed).unwrap();
                    let grid = BrickGrid {
                        cell_dims: lattice.cell_dims(),
                        edge: 24,
                    };
                    let mut held = 0;
                    for z in 0..grid.cell_dims[2] {
                        let counts =
                            [&plain, &known].map(|w| SurfelIndex::count_plane(w, z, &lattice));
                        assert_eq!(counts[0], counts[1], "{lo:?} {hi:?} {opposite} {z}");
                        held += counts[0];
                    }
                    // Every surfel is in a brick that is looked into.
                    let z = 0..grid.cell_dims[2];
                    let bricks = grid.occupied(&known, z.clone(), closed).into_iter();
                    let found = bricks.map(|number| {
                        let core = grid.core(number, &z);
                        let (lo, hi) = (core.lo.map(|c| c - 1), core.hi.map(|c| c + 1));
                        let bits = BitBox::cut(&known, lo, hi);
                        SurfelIndex::find(&bits, core, &lattice).len() as u64
                    });
                    assert_eq!(
                        found.sum::<u64>(),
                        held,
                        "{lo:?} {hi:?} {opposite} {closed}"
                    );
                }
            }
        }
    }
}
