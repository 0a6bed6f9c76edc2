//! Euler characteristics of the solid, counted on voxels.
//!
//! chi26 is that of the closed solid, the union of closed voxels (26-connected); chi6 that of its
//! interior (6-connected). Both are alternating sums of cells over all 2x2x2 neighbourhoods of the
//! image, the outside of the image counting as outside the solid.
//!
//! The boundary, split so that every linel joins two surfels, obeys
//! V - E + F = 2 chi6 + 2 B with interior adjacency and 2 chi26 + 2 A with exterior adjacency,
//! where B (A) counts 2x2x2 blocks whose only two outside (inside) voxels are antipodal. (At such
//! a block the adjacency of surfels, which is decided at linels, keeps one umbrella where the
//! solid has two, or none.) This ties the surface to the solid and is tested as a law.

use crate::simd::{Level, Work, dispatch};
use crate::volume::PlaneWindow;

/// Counts over the 2x2x2 blocks of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SolidCounts {
    /// Inside voxels.
    pub voxels: u64,
    /// Euler characteristic of the union of closed voxels.
    pub chi26: i64,
    /// Euler characteristic of its interior.
    pub chi6: i64,
    /// A: blocks whose only two inside voxels are antipodal.
    pub antipodal_inside: u64,
    /// B: blocks whose only two outside voxels are antipodal.
    pub antipodal_outside: u64,
}

impl SolidCounts {
    /// Adds the counts of other planes.
    pub fn add(&mut self, other: &Self) {
        self.voxels += other.voxels;
        self.chi26 += other.chi26;
        self.chi6 += other.chi6;
        self.antipodal_inside += other.antipodal_inside;
        self.antipodal_outside += other.antipodal_outside;
    }

    /// Counts of plane `z` and the cells between it and plane `z - 1`. Summed over
    /// `0 <= z <= dims[2]` they are those of the image.
    #[must_use]
    pub fn of_plane(window: &PlaneWindow, z: i32) -> Self {
        let mut counts = Self::default();
        let blocks = [0, 1].map(|a| window.dims[a] as i32 + 1);
        let mut found = |lo: [i32; 2], hi: [i32; 2], known| match known {
            Some(false) => {}
            Some(true) => counts.add_solid(window.dims, lo, hi, z),
            None => counts.add(&dispatch(CountRows { window, lo, hi, z })),
        };
        window.rectangles([0; 2], blocks, z..z + 1, 64, false, &mut found);
        counts
    }

    /// The blocks `lo <= c < hi` of plane `z` of an image of which all voxels there are inside.
    fn add_solid(&mut self, dims: [u32; 3], lo: [i32; 2], hi: [i32; 2], z: i32) {
        // Blocks along an axis of which only the second voxel is in the image, both, only the first.
        let kinds = |lo: i32, hi: i32, dims: u32| {
            let [first, last] = [lo == 0, hi > dims as i32].map(i64::from);
            [first, i64::from(hi - lo) - first - last, last]
        };
        let along = [
            kinds(lo[0], hi[0], dims[0]),
            kinds(lo[1], hi[1], dims[1]),
            kinds(z, z + 1, dims[2]),
        ];
        for n in 0..27 {
            let kind = [n % 3, n / 3 % 3, n / 9];
            let count: i64 = (0..3).map(|a| along[a][kind[a]]).product();
            if count == 0 {
                continue;
            }
            let [(x0, x1), (y0, y1), (z0, z1)] = kind.map(|kind| (kind > 0, kind < 2));
            let rows = [y1 && z1, y0 && z1, y1 && z0, y0 && z0];
            let mut one = Self::default();
            one.add_word(
                rows.map(|row| u64::from(row && x1)),
                rows.map(|row| u64::from(row && x0)),
            );
            let times = count.unsigned_abs();
            self.add(&Self {
                voxels: one.voxels * times,
                chi26: one.chi26 * count,
                chi6: one.chi6 * count,
                antipodal_inside: one.antipodal_inside * times,
                antipodal_outside: one.antipodal_outside * times,
            });
        }
    }

    /// `here` and `before` (one voxel less in x) of the rows (y, z), (y-1, z), (y, z-1), (y-1, z-1).
    #[inline(always)]
    fn add_word(&mut self, here: [u64; 4], before: [u64; 4]) {
        let [a, b, c, d] = here;
        let [e, f, g, h] = before;
        let n = |x: u64| i64::from(x.count_ones());
        let voxels = n(a);
        self.voxels += voxels.unsigned_abs();
        let surfels = n(a | e) + n(a | b) + n(a | c);
        let linels = n(a | b | e | f) + n(a | c | e | g) + n(a | b | c | d);
        let pointels = n(a | b | c | d | e | f | g | h);
        self.chi26 += pointels - linels + surfels - voxels;
        let surfels = n(a & e) + n(a & b) + n(a & c);
        let linels = n(a & b & e & f) + n(a & c & e & g) + n(a & b & c & d);
        let pointels = n(a & b & c & d & e & f & g & h);
        self.chi6 += voxels - surfels + linels - pointels;
        // The four antipodal pairs: the voxel opposite to (x, y, z) is (x-1, y-1, z-1), ...
        let pairs = [(a, h), (b, g), (c, f), (d, e)];
        for i in 0..4 {
            let both = pairs[i].0 & pairs[i].1;
            let neither = !(pairs[i].0 | pairs[i].1);
            let (mut all, mut any) = (!0, 0);
            for (j, &(p, q)) in pairs.iter().enumerate() {
                if j != i {
                    all &= p & q;
                    any |= p | q;
                }
            }
            self.antipodal_inside += u64::from((both & !any).count_ones());
            self.antipodal_outside += u64::from((neither & all).count_ones());
        }
    }
}

/// Counts the blocks `lo <= c < hi` of plane `z`; `lo[0]` is a multiple of 64.
struct CountRows<'a> {
    window: &'a PlaneWindow,
    lo: [i32; 2],
    hi: [i32; 2],
    z: i32,
}

impl Work for CountRows<'_> {
    type Output = SolidCounts;

    #[inline(always)]
    fn run<L: Level>(self) -> SolidCounts {
        let Self { window, lo, hi, z } = self;
        let mut counts = SolidCounts::default();
        // One word before, for its last voxel.
        let skipped = usize::from(lo[0] > 0);
        let words = lo[0] as usize / 64 - skipped..(hi[0] as usize).div_ceil(64);
        let mut buffers = [const { Vec::new() }; 4];
        for y in lo[1]..hi[1] {
            let [b0, b1, b2, b3] = &mut buffers;
            let rows = [
                window.span([y, z], words.clone(), b0),
                window.span([y - 1, z], words.clone(), b1),
                window.span([y, z - 1], words.clone(), b2),
                window.span([y - 1, z - 1], words.clone(), b3),
            ];
            let mut carry = if skipped == 1 {
                rows.map(|r| r.first().copied().unwrap_or(0) >> 63)
            } else {
                [0; 4]
            };
            for w in skipped..words.len() {
                let here = rows.map(|r| r.get(w).copied().unwrap_or(0));
                let before = [0, 1, 2, 3].map(|i| here[i] << 1 | carry[i]);
                carry = here.map(|h| h >> 63);
                if here == [0; 4] && before == [0; 4] || here == [!0; 4] && before == [!0; 4] {
                    counts.voxels += u64::from(here[0].count_ones());
                    continue;
                }
                counts.add_word(here, before);
            }
        }
        counts
    }
}
