//! Surface average: u is the mean of the trivial normals of the surface connected to the surfel.
//!
//! u(p) is the direction of the sum over q in C(p) of (1 - t) n(q) area(q), with t = d^2 / r^2 and
//! d the distance of the centroids. It uses the surface only, so another sheet nearby cannot
//! disturb it. The weights are integers (limit - squared distance) and the sums exact: the same
//! for any cut. On an island (a closed part within the ball) the sum means nothing and u = n.

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
            let mut sums = [0i64; 3];
            for &q in walker.part() {
                let other = &surfels.list[q as usize];
                let weight =
                    self.ball.limit - self.ball.metric.squared(displacement(other.k, centre));
                sums[axis(other.orientation)] += i64::from(sign(other.orientation)) * weight;
            }
            let degenerate = rim.is_island() || sums == [0; 3];
            normals.degenerate.push(degenerate);
            normals.u.push(if degenerate {
                trivial_normal(surfel.orientation)
            } else {
                let v = [0, 1, 2].map(|a| sums[a] as f64 * self.areas[a]);
                DVec3::from_array(v).normalize()
            });
        }
        normals
    }
}
