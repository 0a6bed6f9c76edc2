//! Surface average: u is the mean of the trivial normals of the surface connected to the surfel.
//!
//! u(p) is the direction of the sum over q in C(p) of (1 - t) n(q) area(q), with t = d^2 / r^2 and
//! d the distance of the centroids. It uses the surface only, so another sheet nearby cannot
//! disturb it. The sums of n and of n d^2 are integers, so exact: the same for any cut. On an island (a
//! closed part within the ball) the sum means nothing and u = n.
//!
//! C(p) is found for groups of surfels at once ([`crate::surfel`]); candidates are sorted by orientation, so that
//! for each of the six only how many are in C(p) and their squared distances have to be summed.

use glam::DVec3;

use crate::khalimsky::{Adjacency, axis, sign};
use crate::lattice::{Ball, Lattice};
use crate::simd::{LANES, Level, Work, dispatch};
use crate::surfel::squares::{Boxes, Cubes, Squares};
use crate::surfel::vicinity::{Candidates, Groups, Sort, Vicinity};
use crate::surfel::{Blocks, CellBox, Links, SurfelIndex, Surfels, displacement};
use crate::volume::{BitBox, PlaneWindow};

use super::{Normals, trivial_normal};

/// The surface average at one radius.
#[derive(Clone, Debug)]
pub struct AverageKernel {
    ball: Ball,
    areas: [f64; 3],
    adjacency: Adjacency,
}

impl AverageKernel {
    /// Prepares for a ball in Khalimsky coordinates and voxels of the given edges.
    #[must_use]
    pub fn new(ball: Ball, edges: [f64; 3], adjacency: Adjacency) -> Self {
        let areas = [
            edges[1] * edges[2],
            edges[2] * edges[0],
            edges[0] * edges[1],
        ];
        Self {
            ball,
            areas,
            adjacency,
        }
    }

    pub(super) fn ball(&self) -> &Ball {
        &self.ball
    }

    pub(super) fn estimate(
        &self,
        window: &PlaneWindow,
        lattice: &Lattice,
        core: CellBox,
        core_surfels: &Surfels,
    ) -> Normals {
        let cells = core.grown(self.ball.reach(), lattice.cell_dims());
        let bits = BitBox::cut(window, cells.lo.map(|c| c - 1), cells.hi.map(|c| c + 1));
        let index = SurfelIndex::find(&bits, cells, lattice);
        let surfels = Surfels::list(&index, &bits);
        let links = Links::join(&index, &surfels, &bits, lattice, self.adjacency);
        let blocks = Blocks::sort(cells.size(), &surfels, &links);
        let starts: Vec<usize> = (0..core_surfels.list.len())
            .map(|i| {
                let surfel = core_surfels.oriented(i);
                let number = index.find_at(axis(surfel.orientation), surfel.cell());
                number.expect("surfels of the core are in the grown box") as usize
            })
            .collect();
        let sums = dispatch(Averages {
            ball: &self.ball,
            surfels: &surfels,
            blocks: &blocks,
            starts: &starts,
        });
        let mut normals = Normals::default();
        for (sums, surfel) in sums.iter().zip(&core_surfels.list) {
            let v = DVec3::from_array([0, 1, 2].map(|a| {
                let [n, squares] = sums.normals[a];
                self.areas[a] * (n as f64 - squares as f64 / self.ball.squared)
            }));
            let degenerate = sums.is_island || v == DVec3::ZERO;
            normals.degenerate.push(degenerate);
            normals.cut.push(sums.open);
            normals.u.push(if degenerate {
                trivial_normal(surfel.orientation)
            } else {
                v.normalize()
            });
        }
        normals
    }
}

/// What is summed around one surfel.
#[derive(Clone, Copy, Debug, Default)]
struct Average {
    /// Per axis: sum of n, and of n times the squared distance.
    normals: [[i64; 2]; 3],
    is_island: bool,
    open: bool,
}

/// The sums around some surfels of a box.
struct Averages<'a> {
    ball: &'a Ball,
    surfels: &'a Surfels,
    blocks: &'a Blocks,
    starts: &'a [usize],
}

impl Work for Averages<'_> {
    type Output = Vec<Average>;

    #[inline(always)]
    fn run<L: Level>(self) -> Vec<Average> {
        if self.ball.metric.is_cubic() {
            self.sum::<L, _>(Cubes)
        } else {
            self.sum::<L, _>(Boxes::of_ball(self.ball))
        }
    }
}

impl Averages<'_> {
    #[inline(always)]
    fn sum<L: Level, S: Squares>(&self, squares: S) -> Vec<Average> {
        let blocks = self.blocks;
        let mut averages = vec![Average::default(); self.starts.len()];
        let mut number = vec![u32::MAX; blocks.len()];
        for (n, &start) in self.starts.iter().enumerate() {
            number[blocks.place(start)] = n as u32;
        }
        let mut orientations: Vec<u32> = (blocks.order().iter())
            .map(|&surfel| u32::from(self.surfels.list[surfel as usize].orientation))
            .collect();
        let mut tags: Vec<u32> = (0..blocks.len())
            .map(|place| u32::from(blocks.is_open(place)))
            .collect();
        orientations.resize(blocks.len() + LANES, 0);
        tags.resize(blocks.len() + LANES, 0);
        let limit = self.ball.limit as f64;
        let mut vicinity = Vicinity::<6>::new(blocks, *self.ball);
        let groups = Groups::of(blocks, |place| number[place] != u32::MAX);
        for group in 0..groups.len() {
            let members = groups.members(group);
            vicinity.gather::<L>(members, &tags, Sort::ByClass(&orientations));
            vicinity.connect::<L, S>(squares);
            for (m, &member) in members.iter().enumerate() {
                let centre = vicinity.relative(member as usize);
                let connected = vicinity.connected(m);
                let mut average = Average::default();
                let (mut count, mut open) = (0, 0);
                for orientation in 0..6 {
                    let mut own = Counted::default();
                    if connected.main {
                        let list = &vicinity.lists()[orientation];
                        own.add::<L, S, false>(squares, limit, list, centre, &[]);
                    }
                    let list = &vicinity.labelled()[orientation];
                    own.add::<L, S, true>(squares, limit, list, centre, connected.labels);
                    let sign = i64::from(sign(orientation as u8));
                    let sums = &mut average.normals[axis(orientation as u8)];
                    sums[0] += sign * i64::from(own.count);
                    sums[1] += sign * own.squares as i64;
                    count += own.count;
                    open += own.open;
                }
                for &place in vicinity.excluded(m) {
                    let orientation = orientations[place as usize] as u8;
                    let d = displacement(blocks.k_at(place as usize), blocks.k_at(member as usize));
                    let sign = i64::from(sign(orientation));
                    let sums = &mut average.normals[axis(orientation)];
                    sums[0] -= sign;
                    sums[1] -= sign * self.ball.metric.squared(d);
                    count -= 1;
                    open -= tags[place as usize];
                }
                let open = open > 0;
                let rim = vicinity.rim(m, count, open);
                average.is_island = rim.is_island();
                average.open = rim.open;
                averages[number[member as usize] as usize] = average;
            }
        }
        averages
    }
}

/// What of a list is in C(p).
#[derive(Clone, Copy, Debug, Default)]
struct Counted {
    count: u32,
    squares: u64,
    open: u32,
}

impl Counted {
    #[inline(always)]
    fn add<L: Level, S: Squares, const LABELLED: bool>(
        &mut self,
        squares: S,
        limit: f64,
        list: &Candidates,
        centre: [f32; 3],
        labels: &[u32],
    ) {
        let n = list.padded();
        let [x, y, z] = [&list.x, &list.y, &list.z].map(|x| x[..n].as_chunks::<LANES>().0);
        let label = list.label[..n].as_chunks::<LANES>().0;
        let centre = centre.map(L::all);
        let mut sums = (L::zero(), 0);
        for i in 0..x.len() {
            let square = squares.of::<L>([
                L::sub(L::load(&x[i]), centre[0]),
                L::sub(L::load(&y[i]), centre[1]),
                L::sub(L::load(&z[i]), centre[2]),
            ]);
            let mut counted = S::at_most::<L>(square, limit);
            if LABELLED {
                counted = L::and(counted, L::looked_up(&label[i], labels));
            }
            self.count += L::bits(counted).count_ones();
            if let Some([open, ..]) = list.tagged(i) {
                self.open += (L::bits(counted) & open).count_ones();
            }
            sums = S::sum::<L>(square, counted, sums);
        }
        self.squares += L::total(sums.0) + sums.1;
    }
}
