//! Surface average: u is the mean of the trivial normals of the surface connected to the surfel.
//!
//! u(p) is the direction of the sum over q in C(p) of (1 - t) n(q) area(q), with t = d^2 / r^2 and
//! d the distance of the centroids. It uses the surface only, so another sheet nearby cannot
//! disturb it. The sums of n and of n d^2 are integers, so exact: the same for any cut. On an island (a closed part within the ball) the sum means nothing and u = n.

use glam::DVec3;

use crate::khalimsky::{Adjacency, axis, sign};
use crate::lattice::{Ball, Lattice};
use crate::surfel::{CellBox, Links, SurfelIndex, Surfels, Walker, displacement};
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
        let mut walker = Walker::default();
        let mut normals = Normals::default();
        for i in 0..core_surfels.list.len() {
            let surfel = core_surfels.oriented(i);
            let start = index
                .find_at(axis(surfel.orientation), surfel.cell())
                .expect("surfels of the core are in the grown box")
                as usize;
            let rim = walker.walk(&surfels, &links, &self.ball, start);
            let centre = surfels.list[start].k;
            // Per axis: sum of n, and of n times the squared distance.
            let mut sums = [[0i64; 2]; 3];
            for &q in walker.part() {
                let other = &surfels.list[q as usize];
                let n = i64::from(sign(other.orientation));
                let sum = &mut sums[axis(other.orientation)];
                sum[0] += n;
                sum[1] += n * self.ball.metric.squared(displacement(other.k, centre));
            }
            let v = DVec3::from_array([0, 1, 2].map(|a| {
                self.areas[a] * (sums[a][0] as f64 - sums[a][1] as f64 / self.ball.squared)
            }));
            let degenerate = rim.is_island() || v == DVec3::ZERO;
            normals.degenerate.push(degenerate);
            normals.cut.push(rim.open);
            normals.u.push(if degenerate {
                trivial_normal(surfel.orientation)
            } else {
                v.normalize()
            });
        }
        normals
    }
}
