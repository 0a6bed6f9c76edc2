//! Which surfel lies across each side of each surfel.

use crate::khalimsky::{
    Adjacency, Direction, OrientedSurfel, SIDE_TOWARDS, SIDES, Turn, axis, moved, sign,
};
use crate::lattice::Lattice;
use crate::simd::{Level, Work, dispatch};
use crate::volume::BitBox;

use super::index::{SurfelIndex, Surfels};

/// What lies across a side of a surfel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link(u32);

impl Link {
    /// Nothing: the linel is on the border of an open image.
    pub const BORDER: Link = Link(u32::MAX);
    /// A surfel that the box does not cover.
    pub const BEYOND: Link = Link(u32::MAX - 1);

    /// The number of the surfel across, if the box covers one.
    #[inline]
    #[must_use]
    pub fn surfel(self) -> Option<usize> {
        if self.0 < u32::MAX - 1 {
            Some((self.0 >> 2) as usize)
        } else {
            None
        }
    }

    /// The side of that surfel which is the shared linel; without meaning if there is none.
    #[inline]
    #[must_use]
    pub fn side_there(self) -> usize {
        (self.0 & 3) as usize
    }
}

/// Joining the surfels of an index.
struct Join<'a> {
    index: &'a SurfelIndex,
    surfels: &'a Surfels,
    bits: &'a BitBox,
    lattice: &'a Lattice,
    adjacency: Adjacency,
}

/// Where the surfel across a side is, for one orientation, side and turn.
#[derive(Clone, Copy, Debug, Default)]
struct Beyond {
    axis: usize,
    /// Its bit in the index, from the bit that a surfel of its kind would have in the cell of the inner
    /// voxel.
    step: isize,
    /// The side of it that is the shared linel.
    side: u32,
}

impl Work for Join<'_> {
    type Output = Links;

    #[inline(always)]
    fn run<L: Level>(self) -> Links {
        let cells = self.index.cells();
        let dims = self.lattice.dims.map(|n| n as i32);
        // Around inner voxels here all cells are covered, and no side is on the border of the image.
        let mut lo = [0; 3];
        let mut hi = [0; 3];
        for a in 0..3 {
            lo[a] = (cells.lo[a] + 2).max(1);
            hi[a] = (cells.hi[a] - 2).min(dims[a] - 1);
        }
        let beyond = self.beyond();
        let mut turns = [0usize; 4];
        for (beside, turn) in turns.iter_mut().enumerate() {
            *turn = match self.adjacency.turn(beside & 1 == 1, beside & 2 == 2) {
                Turn::Convex => 0,
                Turn::Flat => 1,
                Turn::Concave => 2,
            };
        }
        let (_, strides) = self.bits.bit(self.bits.lo());
        let mut of = Vec::with_capacity(self.surfels.list.len());
        for i in 0..self.surfels.list.len() {
            let surfel = self.surfels.oriented(i);
            let p = surfel.inner;
            let mut inner = true;
            for a in 0..3 {
                inner &= lo[a] <= p[a] && p[a] < hi[a];
            }
            if !inner {
                of.push(self.at_the_edge(surfel));
                continue;
            }
            let o = surfel.orientation as usize;
            let along = |t: Direction| sign(t) as isize * strides[axis(t)];
            let (here, _) = self.bits.bit(p);
            let out = here.wrapping_add_signed(along(surfel.orientation));
            let bits = [
                self.index.bit(0, p),
                self.index.bit(1, p),
                self.index.bit(2, p),
            ];
            let mut links = [Link::BORDER; 4];
            for j in 0..4 {
                let step = along(SIDES[o][j]);
                let beside = self.bits.at(here.wrapping_add_signed(step))
                    | self.bits.at(out.wrapping_add_signed(step)) << 1;
                let beyond = &beyond[o][j][turns[beside]];
                let bit = bits[beyond.axis].wrapping_add_signed(beyond.step);
                links[j] = Link(self.index.number(bit) << 2 | beyond.side);
            }
            of.push(links);
        }
        Links { of }
    }
}

impl Join<'_> {
    /// By orientation, side and turn (convex, flat, concave).
    fn beyond(&self) -> [[[Beyond; 3]; 4]; 6] {
        let mut table = [[[Beyond::default(); 3]; 4]; 6];
        for (o, sides) in table.iter_mut().enumerate() {
            let surfel = OrientedSurfel {
                inner: [0; 3],
                orientation: o as Direction,
            };
            for (j, by_turn) in sides.iter_mut().enumerate() {
                let turns = [Turn::Convex, Turn::Flat, Turn::Concave];
                for (to, turn) in by_turn.iter_mut().zip(turns) {
                    let (beyond, back) = surfel.across(SIDES[o][j], turn);
                    let axis = axis(beyond.orientation);
                    let (cell, strides) = (beyond.cell(), self.index.strides(axis));
                    *to = Beyond {
                        axis,
                        step: (0..3).map(|a| cell[a] as isize * strides[a]).sum(),
                        side: u32::from(SIDE_TOWARDS[beyond.orientation as usize][back as usize]),
                    };
                }
            }
        }
        table
    }

    /// The links of a surfel at the edge of the box, or on the border of the image.
    fn at_the_edge(&self, surfel: OrientedSurfel) -> [Link; 4] {
        let dims = self.lattice.dims.map(|n| n as i32);
        let outer = surfel.outer();
        let mut links = [Link::BORDER; 4];
        for (j, link) in links.iter_mut().enumerate() {
            let t: Direction = SIDES[surfel.orientation as usize][j];
            if !self.lattice.closed {
                let a = axis(t);
                let beside = surfel.inner[a] + sign(t);
                if beside < 0 || beside >= dims[a] {
                    continue;
                }
            }
            let turn = self.adjacency.turn(
                self.bits.inside(moved(surfel.inner, t)),
                self.bits.inside(moved(outer, t)),
            );
            let (beyond, back) = surfel.across(t, turn);
            let cell = beyond.cell();
            *link = if self.index.cells().contains(cell) {
                match self.index.find_at(axis(beyond.orientation), cell) {
                    Some(n) => {
                        let side = SIDE_TOWARDS[beyond.orientation as usize][back as usize];
                        Link(n << 2 | u32::from(side))
                    }
                    None => unreachable!("a turn leads to a surfel of the same bits"),
                }
            } else {
                Link::BEYOND
            };
        }
        links
    }
}

/// The four links of each surfel of a box, by side.
#[derive(Clone, Debug, Default)]
pub struct Links {
    /// `of[i][j]` lies across side `j` of surfel `i`.
    pub of: Vec<[Link; 4]>,
}

impl Links {
    /// Joins the surfels of `index`. `bits` must hold the voxels from `cells.lo - 1` to
    /// `cells.hi`, at least.
    #[must_use]
    pub fn join(
        index: &SurfelIndex,
        surfels: &Surfels,
        bits: &BitBox,
        lattice: &Lattice,
        adjacency: Adjacency,
    ) -> Self {
        dispatch(Join {
            index,
            surfels,
            bits,
            lattice,
            adjacency,
        })
    }

    /// The next corner counter-clockwise around the pointel at corner `j` of surfel `i`, as seen
    /// from outside: across side `j`. `Err` is the link that leads nowhere.
    #[inline]
    pub(crate) fn next_corner(&self, i: usize, j: usize) -> Result<(usize, usize), Link> {
        let link = self.of[i][j];
        match link.surfel() {
            // There the linel leaves the pointel; the side before it arrives there.
            Some(n) => Ok((n, (link.side_there() + 3) % 4)),
            None => Err(link),
        }
    }

    /// The next corner clockwise: across side `j + 1`.
    #[inline]
    pub(crate) fn previous_corner(&self, i: usize, j: usize) -> Result<(usize, usize), Link> {
        let link = self.of[i][(j + 1) % 4];
        match link.surfel() {
            Some(n) => Ok((n, link.side_there())),
            None => Err(link),
        }
    }
}
