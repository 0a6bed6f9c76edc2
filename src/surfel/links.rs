//! Which surfel lies across each side of each surfel.

use crate::khalimsky::{Adjacency, Direction, SIDE_TOWARDS, SIDES, axis, moved};
use crate::lattice::Lattice;
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
        let dims = lattice.dims.map(|n| n as i32);
        let cells = index.cells();
        let mut of = Vec::with_capacity(surfels.list.len());
        for i in 0..surfels.list.len() {
            let surfel = surfels.oriented(i);
            let outer = surfel.outer();
            let mut links = [Link::BORDER; 4];
            for (j, link) in links.iter_mut().enumerate() {
                let t: Direction = SIDES[surfel.orientation as usize][j];
                if !lattice.closed {
                    let a = axis(t);
                    let beside = surfel.inner[a] + crate::khalimsky::sign(t);
                    if beside < 0 || beside >= dims[a] {
                        continue;
                    }
                }
                let turn = adjacency.turn(
                    bits.inside(moved(surfel.inner, t)),
                    bits.inside(moved(outer, t)),
                );
                let (beyond, back) = surfel.across(t, turn);
                let cell = beyond.cell();
                *link = if cells.contains(cell) {
                    match index.find_at(axis(beyond.orientation), cell) {
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
            of.push(links);
        }
        Self { of }
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
