//! The sites of the Voronoi cells: pointels of the surface, one bit each.
//!
//! Pointel P is the lower corner of voxel P. It is a corner of some surfel exactly if the voxels
//! around it are neither all inside nor all outside; on the border of an open image, where no
//! surfels are made, only the voxels of the image count.

use crate::lattice::Lattice;
use crate::surfel::CellBox;
use crate::volume::BitBox;

/// The sites in a box of pointels, numbered in the order z, y, x.
pub(super) struct Sites {
    /// The pointels covered.
    pub(super) extent: CellBox,
    words_per_row: usize,
    words: Vec<u64>,
    /// Number of sites before each word, and the total.
    rank: Vec<u32>,
}

/// The `n` lowest bits, none below 0 and all from 64 on.
#[inline(always)]
fn low_bits(n: i32) -> u64 {
    match n.clamp(0, 64) {
        64 => !0,
        n => (1 << n) - 1,
    }
}

impl Sites {
    /// Finds the sites of `extent`. `bits` must hold the voxels around all its pointels, from
    /// `extent.lo - 1` to below `extent.hi`.
    pub(super) fn find(bits: &BitBox, extent: CellBox, lattice: &Lattice) -> Self {
        let size = extent.size();
        let words_per_row = (size[0] as usize).div_ceil(64);
        let mut words = vec![0; words_per_row * (size[1] * size[2]) as usize];
        let dims = lattice.dims.map(|n| n as i32);
        let known = |a: usize, at: i32| lattice.closed || (0..dims[a]).contains(&at);
        for (row, out) in words.chunks_exact_mut(words_per_row).enumerate() {
            let y = extent.lo[1] + row as i32 % size[1];
            let z = extent.lo[2] + row as i32 / size[1];
            let mut around: [&[u64]; 4] = [&[]; 4];
            let mut rows = 0;
            for (y, z) in [(y - 1, z - 1), (y, z - 1), (y - 1, z), (y, z)] {
                if known(1, y) && known(2, z) {
                    around[rows] = bits.row(y, z);
                    rows += 1;
                }
            }
            for (w, word) in out.iter_mut().enumerate() {
                // Which of the voxels above or below along x are inside somewhere, and outside.
                let sides = |x: i32| {
                    let counted = if lattice.closed {
                        !0
                    } else {
                        low_bits(dims[0] - x) & !low_bits(-x)
                    };
                    let at = (x - bits.lo()[0]) as usize;
                    let (mut inside, mut outside) = (0, 0);
                    for row in &around[..rows] {
                        let voxels = BitBox::bits(row, at);
                        inside |= voxels & counted;
                        outside |= !voxels & counted;
                    }
                    [inside, outside]
                };
                let x = extent.lo[0] + 64 * w as i32;
                let (above, below) = (sides(x), sides(x - 1));
                *word = (above[0] | below[0]) & (above[1] | below[1]) & low_bits(extent.hi[0] - x);
            }
        }
        let mut rank = Vec::with_capacity(words.len() + 1);
        let mut total = 0;
        for word in &words {
            rank.push(total);
            total += word.count_ones();
        }
        rank.push(total);
        Self {
            extent,
            words_per_row,
            words,
            rank,
        }
    }

    /// Number of sites.
    pub(super) fn len(&self) -> usize {
        self.rank[self.rank.len() - 1] as usize
    }

    /// Index of the first word of a row.
    #[inline(always)]
    fn row_start(&self, y: i32, z: i32) -> usize {
        let size_y = self.extent.hi[1] - self.extent.lo[1];
        let row = (z - self.extent.lo[2]) * size_y + (y - self.extent.lo[1]);
        row as usize * self.words_per_row
    }

    /// Whether a pointel of the box is a site.
    #[inline(always)]
    pub(super) fn contains(&self, p: [i32; 3]) -> bool {
        let x = (p[0] - self.extent.lo[0]) as usize;
        self.words[self.row_start(p[1], p[2]) + x / 64] >> (x % 64) & 1 == 1
    }

    /// Number of a site of the box.
    #[inline(always)]
    pub(super) fn number(&self, p: [i32; 3]) -> usize {
        let x = p[0] - self.extent.lo[0];
        let at = self.row_start(p[1], p[2]) + (x / 64) as usize;
        (self.rank[at] + (self.words[at] & low_bits(x % 64)).count_ones()) as usize
    }

    /// Calls `f` with x and the number of each site from `lo` to `hi`, both included, of a row of
    /// the box, in order.
    #[inline(always)]
    pub(super) fn for_each_in_row(
        &self,
        [lo, hi]: [i32; 2],
        y: i32,
        z: i32,
        mut f: impl FnMut(i32, usize),
    ) {
        let x0 = self.extent.lo[0];
        let row = self.row_start(y, z);
        for w in (lo - x0) / 64..=(hi - x0) / 64 {
            let first = x0 + 64 * w;
            let word = self.words[row + w as usize];
            let mut rest = word & low_bits(hi + 1 - first) & !low_bits(lo - first);
            if rest == 0 {
                continue;
            }
            let before = word & low_bits(lo - first);
            let mut number = (self.rank[row + w as usize] + before.count_ones()) as usize;
            while rest != 0 {
                f(first + rest.trailing_zeros() as i32, number);
                number += 1;
                rest &= rest - 1;
            }
        }
    }
}
