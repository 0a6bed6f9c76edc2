//! Which surfel lies across each side of each surfel.

use crate::khalimsky::{Adjacency, Direction, OrientedSurfel, SIDE_TOWARDS, SIDES, axis, sign};
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

/// Where the surfel across a side is, for one orientation, side and which voxels beside it are inside.
#[derive(Clone, Copy, Debug, Default)]
struct Beyond {
    axis: usize,
    /// Its cell, from the inner voxel.
    cell: [i32; 3],
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
        let (_, strides) = self.bits.bit(self.bits.lo());
        let mut steps = [0isize; 6];
        for (t, step) in steps.iter_mut().enumerate() {
            *step = sign(t as Direction) as isize * strides[axis(t as Direction)];
        }
        let mut of = vec![[Link::BORDER; 4]; self.surfels.list.len()];
        for (i, links) in of.iter_mut().enumerate() {
            let surfel = self.surfels.oriented(i);
            let p = surfel.inner;
            let mut inner = true;
            for a in 0..3 {
                inner &= lo[a] <= p[a] && p[a] < hi[a];
            }
            let o = surfel.orientation as usize;
            let (here, _) = self.bits.bit(p);
            let out = here.wrapping_add_signed(steps[o]);
            let across = |j: usize| {
                let step = steps[SIDES[o][j] as usize];
                let beside = self.bits.at(here.wrapping_add_signed(step))
                    | self.bits.at(out.wrapping_add_signed(step)) << 1;
                &beyond[o][j][beside]
            };
            if inner {
                let bits = [
                    self.index.bit(0, p),
                    self.index.bit(1, p),
                    self.index.bit(2, p),
                ];
                for j in 0..4 {
                    let beyond = across(j);
                    let bit = bits[beyond.axis].wrapping_add_signed(beyond.step);
                    links[j] = Link(self.index.number(bit) << 2 | beyond.side);
                }
            } else {
                for j in 0..4 {
                    let t = SIDES[o][j];
                    let beside = p[axis(t)] + sign(t);
                    if !self.lattice.closed && !(0..dims[axis(t)]).contains(&beside) {
                        continue;
                    }
                    let beyond = across(j);
                    let mut cell = p;
                    for a in 0..3 {
                        cell[a] += beyond.cell[a];
                    }
                    links[j] = if cells.contains(cell) {
                        let bit = self.index.bit(beyond.axis, cell);
                        Link(self.index.number(bit) << 2 | beyond.side)
                    } else {
                        Link::BEYOND
                    };
                }
            }
        }
        Links { of }
    }
}

impl Join<'_> {
    /// By orientation, side, and whether the voxels beside the inner one (1) and the outer one (2) are inside.
    fn beyond(&self) -> [[[Beyond; 4]; 4]; 6] {
        let mut table = [[[Beyond::default(); 4]; 4]; 6];
        for (o, sides) in table.iter_mut().enumerate() {
            let surfel = OrientedSurfel {
                inner: [0; 3],
                orientation: o as Direction,
            };
            for (j, by_voxels) in sides.iter_mut().enumerate() {
                for (beside, to) in by_voxels.iter_mut().enumerate() {
                    let turn = self.adjacency.turn(beside & 1 == 1, beside & 2 == 2);
                    let (beyond, back) = surfel.across(SIDES[o][j], turn);
                    let axis = axis(beyond.orientation);
                    let (cell, strides) = (beyond.cell(), self.index.strides(axis));
                    *to = Beyond {
                        axis,
                        cell,
                        step: (0..3).map(|a| cell[a] as isize * strides[a]).sum(),
                        side: u32::from(SIDE_TOWARDS[beyond.orientation as usize][back as usize]),
                    };
                }
            }
        }
        table
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::khalimsky::{SIDE_TOWARDS, moved};
    use crate::surfel::CellBox;
    use crate::volume::{PlaneWindow, scattered};

    /// Whether a voxel is inside, and whether it is in the image.
    fn voxel(window: &PlaneWindow, p: [i32; 3]) -> (bool, bool) {
        let within = (0..3).all(|a| (0..window.dims[a] as i32).contains(&p[a]));
        (within && window.inside(p), within)
    }

    /// The surfels of a box of cells, by definition.
    fn listed(window: &PlaneWindow, cells: CellBox, closed: bool) -> Vec<OrientedSurfel> {
        let mut list = Vec::new();
        let [x, y, z] = [0, 1, 2].map(|a| 2 * cells.lo[a]..2 * cells.hi[a]);
        for kz in z {
            for ky in y.clone() {
                for kx in x.clone() {
                    let k = [kx, ky, kz];
                    let even = [0, 1, 2].map(|a| k[a] % 2 == 0);
                    let Some(along) = even.iter().position(|&e| e) else {
                        continue;
                    };
                    let after = k.map(|k| k.div_euclid(2));
                    let before = moved(after, 2 * along as Direction + 1);
                    let [(a, there_a), (b, there_b)] = [after, before].map(|p| voxel(window, p));
                    let found = a != b && (closed || there_a && there_b);
                    if even.iter().filter(|&&e| e).count() == 1 && found {
                        let orientation = 2 * along as Direction + Direction::from(a);
                        let inner = if a { after } else { before };
                        list.push(OrientedSurfel { inner, orientation });
                    }
                }
            }
        }
        list
    }

    #[test]
    fn surfels_and_links_are_those_of_the_definition() {
        for (seed, dims) in [[70, 5, 4], [3, 9, 6], [130, 2, 3]].into_iter().enumerate() {
            let window = scattered(dims, seed as u64);
            for closed in [false, true] {
                let lattice = Lattice::new(dims.map(u64::from), [1.0; 3], closed).unwrap();
                let end = lattice.cell_dims();
                for (lo, hi) in [
                    ([0; 3], end),
                    ([1, 1, 1], end.map(|n| n - 1)),
                    ([end[0] / 2, 0, 1], end),
                    ([0, 1, 0], [end[0].min(65), end[1], 2]),
                ] {
                    let cells = CellBox { lo, hi };
                    let bits = BitBox::cut(&window, lo.map(|c| c - 1), hi.map(|c| c + 1));
                    let index = SurfelIndex::find(&bits, cells, &lattice);
                    let surfels = Surfels::list(&index, &bits);
                    let list = listed(&window, cells, closed);
                    let found: Vec<_> = (0..index.len()).map(|i| surfels.oriented(i)).collect();
                    assert_eq!(found, list, "{dims:?} {closed} {cells:?}");
                    for adjacency in [Adjacency::Interior, Adjacency::Exterior] {
                        let links = Links::join(&index, &surfels, &bits, &lattice, adjacency);
                        for (i, &surfel) in list.iter().enumerate() {
                            for (j, &t) in SIDES[surfel.orientation as usize].iter().enumerate() {
                                let [inner, outer] = [surfel.inner, surfel.outer()]
                                    .map(|p| voxel(&window, moved(p, t)));
                                let turn = adjacency.turn(inner.0, outer.0);
                                let (beyond, back) = surfel.across(t, turn);
                                let side = SIDE_TOWARDS[beyond.orientation as usize][back as usize];
                                let at = list.iter().position(|&s| s == beyond);
                                let expected = match at {
                                    _ if !closed && !inner.1 => Link::BORDER,
                                    Some(n) => Link((n as u32) << 2 | u32::from(side)),
                                    None => Link::BEYOND,
                                };
                                assert_eq!(links.of[i][j], expected, "{surfel:?} {t}");
                            }
                        }
                    }
                }
            }
        }
    }
}
