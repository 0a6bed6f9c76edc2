//! What is kept of the cells of a brick: surfels, linels and pointels.
//!
//! [`CellMeasures`] of a brick's core are either lumped on surfels (eight integers each) or, cell by
//! cell, with each linel and umbrella kept by its *owner*, the surfel of the lowest number among
//! those that share it. [`CellTotals`] are exact integers, each cell counted by its owner. They are made by
//! [`super::constant`] or [`super::continuous`], as the field of normals is.

use crate::surfel::{CellBox, Link, Links};

use super::field::Field;
use super::fixed;
use super::surface::Surface;

/// Measures that a surfel carries when linels and pointels are lumped on it: mu0, the six terms of
/// the tensor (xx yy zz xy xz yz) of half of each of its linels, and its shares of mu2. With a
/// continuous field, all the measures of the surfel.
pub type Lumped = [i64; 8];

/// The tensor of a linel: xx yy zz xy xz yz.
pub type Tensor = [i64; 6];

/// How measures are kept until they are summed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Lumped on surfels.
    Lumped,
    /// Cell by cell.
    Cells,
}

/// What is to be evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Asked {
    /// How `u` is continued from surfels to the surface.
    pub field: Field,
    /// How measures are kept; a continuous field has none but on surfels, so it is always lumped.
    pub keep: Keep,
    /// Whether mu_Omega is wanted too.
    pub quality: bool,
}

/// What is remarkable about a surfel, before any ball is looked at: bits of [`CellMeasures::marks`].
pub mod mark {
    /// A pointel of the surfel needed a lift, or with a continuous field the surfel itself: k != 0.
    pub const LIFTED: u8 = 1;
    /// The surfel has a side on the border of an open image, or its normal's ball is cut by it.
    pub const CUT: u8 = 2;
    /// No normal could be estimated.
    pub const DEGENERATE: u8 = 4;
    /// <u, n> <= 0; with a continuous field on the average, mu0 <= 0.
    pub const OPPOSED: u8 = 8;
    /// A surfel around one of its pointels, or itself, is [`CUT`]: its linels and pointels then
    /// have measures that what is beyond the border could change.
    pub const NEAR_CUT: u8 = 16;
    /// The trivial normals across two opposite sides are opposite: a wall, tip or pit one voxel thick.
    pub const RIDGE: u8 = 32;
}

/// Measures of the cells of a brick's core, in Khalimsky order of their surfels.
#[derive(Clone, Debug, Default)]
pub struct CellMeasures {
    /// One a surfel, with [`Keep::Lumped`].
    pub lumped: Vec<Lumped>,
    /// mu0 of each surfel, with [`Keep::Cells`].
    pub mu0: Vec<i64>,
    /// Tensors of the linels owned, by surfel, then by side.
    pub linels: Vec<Tensor>,
    /// mu2 of the umbrellas owned, by surfel, then by corner.
    pub umbrellas: Vec<i64>,
    /// mu_Omega, if it was asked for: one a surfel with [`Keep::Lumped`], half of that of each of its
    /// linels; with [`Keep::Cells`] one for each of `linels`.
    pub omega: Vec<i64>,
    /// First of `linels` and of `umbrellas` of each surfel, and one past the last.
    pub owned_from: Vec<[u32; 2]>,
    /// One a surfel: bits of [`mark`].
    pub marks: Vec<u8>,
}

/// Adds to a list and leaves no room at its end, as it is held for long.
pub(crate) fn append<T>(list: &mut Vec<T>, next: Vec<T>) {
    list.reserve_exact(next.len());
    list.extend(next);
}

impl CellMeasures {
    /// Adds those of the surfels that follow.
    pub fn append(&mut self, next: Self) {
        if self.marks.is_empty() {
            *self = next;
            return;
        }
        let [linels, umbrellas] = [self.linels.len(), self.umbrellas.len()].map(|n| n as u32);
        // the end of what is there is where the next ones start
        let from = next.owned_from.iter().skip(1);
        let owned: Vec<_> = from.map(|n| [n[0] + linels, n[1] + umbrellas]).collect();
        append(&mut self.owned_from, owned);
        append(&mut self.lumped, next.lumped);
        append(&mut self.mu0, next.mu0);
        append(&mut self.linels, next.linels);
        append(&mut self.umbrellas, next.umbrellas);
        append(&mut self.omega, next.omega);
        append(&mut self.marks, next.marks);
    }

    /// Memory held, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.lumped.len() * 64
            + self.mu0.len() * 8
            + self.linels.len() * 48
            + self.umbrellas.len() * 8
            + self.omega.len() * 8
            + self.owned_from.len() * 8
            + self.marks.len()
    }
}

/// Exact totals over the cells of a surface: additive, so in any order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellTotals {
    /// Surfels along x, y, z.
    pub surfels: [u64; 3],
    /// Linels, split ones twice, those on the border too.
    pub linels: u64,
    /// Linels on the border of an open image: zero if the surface is closed.
    pub border_linels: u64,
    /// Pointels, once for each umbrella or chain.
    pub pointels: u64,
    /// Sum of mu0, in the unit of [`fixed::from_measure`].
    pub mu0: i128,
    /// Sum of mu1, the same unit.
    pub mu1: i128,
    /// Sum of mu2, in the unit of [`fixed::from_solid_angle`].
    pub mu2: i128,
    /// Sum of the lifts k; with a linear field there are none.
    pub lifts: i64,
    /// Sum of |k|: how bad `u` is.
    pub absolute_lifts: u64,
}

impl CellTotals {
    /// Adds the totals of other cells.
    pub fn add(&mut self, other: &Self) {
        for a in 0..3 {
            self.surfels[a] += other.surfels[a];
        }
        self.linels += other.linels;
        self.border_linels += other.border_linels;
        self.pointels += other.pointels;
        self.mu0 += other.mu0;
        self.mu1 += other.mu1;
        self.mu2 += other.mu2;
        self.lifts += other.lifts;
        self.absolute_lifts += other.absolute_lifts;
    }

    /// Number of surfels.
    #[must_use]
    pub fn surfel_count(&self) -> u64 {
        self.surfels.iter().sum()
    }

    /// V - E + F, counted.
    #[must_use]
    pub fn euler_counted(&self) -> i128 {
        i128::from(self.pointels) - i128::from(self.linels) + i128::from(self.surfel_count())
    }

    /// V - E + F by Gauss-Bonnet, (sum(mu2) + 4 pi sum(k)) / 2 pi; `None` if the surface is open or
    /// (impossible on a closed surface with `u` of unit length) the quotient is not whole.
    #[must_use]
    pub fn euler_gauss_bonnet(&self) -> Option<i128> {
        let lifted = self.mu2 + i128::from(self.lifts) * i128::from(fixed::SPHERE);
        let whole = i128::from(fixed::SPHERE / 2);
        (self.border_linels == 0 && lifted % whole == 0).then_some(lifted / whole)
    }
}

/// In place of the number of a surfel that is not in the core.
pub(super) const RIM: u32 = u32::MAX;

/// Numbers within the core of the surfels of a surface.
pub(super) struct Numbers {
    /// Of each surfel; [`RIM`] outside of the core.
    pub(super) of: Vec<u32>,
    /// Surfels of the core.
    pub(super) count: usize,
}

impl Numbers {
    pub(super) fn of(surface: &Surface, core: CellBox) -> Self {
        let surfels = &surface.surfels;
        // Khalimsky coordinates of the core, as those of surfels are kept.
        let (mut lo, mut hi) = ([0; 3], [0; 3]);
        for a in 0..3 {
            lo[a] = 2 * core.lo[a] - surfels.k0[a];
            hi[a] = 2 * core.hi[a] - surfels.k0[a];
        }
        let mut of = Vec::with_capacity(surface.len());
        let mut count = 0;
        for surfel in &surfels.list {
            let mut within = true;
            for a in 0..3 {
                let k = i32::from(surfel.k[a]);
                within &= (lo[a] <= k) & (k < hi[a]);
            }
            of.push(if within { count } else { RIM });
            count += u32::from(within);
        }
        Self {
            of,
            count: count as usize,
        }
    }
}

/// Marks the surfels of the core around a pointel as near a cut.
pub(super) fn spread_cut(corners: &[u32], core: &Numbers, core_marks: &mut [u8]) {
    for &corner in corners {
        let number = core.of[corner as usize / 4];
        if number != RIM {
            core_marks[number as usize] |= mark::NEAR_CUT;
        }
    }
}

/// What is found around a pointel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Around {
    /// An umbrella; its corners are listed counter-clockwise from the one asked.
    Cycle,
    /// A chain that ends on the border of an open image; its corners are listed counter-clockwise from the one
    /// asked, then clockwise from the one before it.
    Chain,
    /// Found before, or it leaves the box.
    Nothing,
}

/// The umbrellas and chains of a surface. If corners are asked in order, each is found once, from the
/// lowest of its surfels.
pub(super) struct Umbrellas<'a> {
    links: &'a Links,
    /// Corners that were passed.
    seen: Vec<[bool; 4]>,
    /// Corners of what was found last; corner `j` of surfel `i` is `4 i + j`.
    pub(super) corners: Vec<u32>,
}

impl<'a> Umbrellas<'a> {
    pub(super) fn of(surface: &'a Surface) -> Self {
        Self {
            links: &surface.links,
            seen: vec![[false; 4]; surface.len()],
            corners: Vec::with_capacity(8),
        }
    }

    /// Lists the corners around corner `j` of surfel `i`.
    #[inline(always)]
    pub(super) fn find(&mut self, i: usize, j: usize) -> Around {
        if self.seen[i][j] {
            return Around::Nothing;
        }
        self.corners.clear();
        let (mut at, mut corner) = (i, j);
        loop {
            self.pass(at, corner);
            match self.links.next_corner(at, corner) {
                Ok(next) if next == (i, j) => return Around::Cycle,
                // it was found to leave the box, from another corner
                Ok((n, c)) if self.seen[n][c] => return Around::Nothing,
                Ok(next) => (at, corner) = next,
                Err(Link::BORDER) => break,
                Err(_) => return Around::Nothing,
            }
        }
        (at, corner) = (i, j);
        loop {
            match self.links.previous_corner(at, corner) {
                Ok(before) => (at, corner) = before,
                Err(Link::BORDER) => return Around::Chain,
                Err(_) => return Around::Nothing,
            }
            self.pass(at, corner);
        }
    }

    #[inline(always)]
    fn pass(&mut self, at: usize, corner: usize) {
        self.seen[at][corner] = true;
        self.corners.push((4 * at + corner) as u32);
    }
}
