//! Voronoi covariance measure: u from how the nearest pointels of the surface lie around.
//!
//! Merigot, Ovsjanikov, Guibas, *Voronoi-based curvature and feature estimation from point
//! clouds*; Cuel, Lachaud, Thibert, *Voronoi-based geometry estimator for 3D digital surfaces*; the
//! paper's 6.1.3 (VCM). Comes in: the bits around a brick and the surfels of its core. Goes out: a
//! normal a surfel.
//!
//! ```text
//!    sites q: the pointels of the surface
//!    V(q) = sum over lattice points p with |p - q| <= R whose nearest site is q of (p - q)(p - q)^T
//!    M(P) = sum over sites q with |q - P| < r of (1 - |q - P| / r) V(q)
//!    e(P) = eigenvector of the largest eigenvalue of M(P), turned to one side
//!    u    = direction of the sum of e(P) over the four pointels P of the surfel
//! ```
//!
//! Lattice points are those of the pointels, inside the image and beyond it. A point with several
//! nearest sites is shared equally between them, so that mirrored and rotated volumes have
//! mirrored and rotated normals; with [`Side::Dgtal`] it is the last one's in the order of z, y, x, as
//! in DGtal. Lengths are
//! true lengths of box voxels, membership is decided in integers ([`crate::lattice::Metric`]).
//!
//! **Which side.** A covariance gives a line. With [`Side::Surface`] the surface average
//! ([`super::average`]) within [`SIDE_RADIUS`] decides: what is connected to the surfel, so
//! the other side of a thin part or of a gap has no say. [`Side::Dgtal`] is DGtal's average, whose weights *grow*
//! with the distance; it differs on parts smaller than its ball. Ties, made explicit because small solids
//! are full of them: eigenvalues closer than [`SAME_EIGENVALUE`] share their eigenspace, and e is the
//! projection of the side on it; where that is nothing, of the trivial normal; else P does not count.
//!
//! Guaranteed: u depends on voxels within 2 R + r + 1 alone, in exact integers up to M(P), whose sum
//! runs in the order of the sites: no cut shows. A normal not marked `cut` would be the same if the
//! image went on, unless a part of the solid that does not meet the border came near. Not
//! guaranteed: that parts of the solid nearer than r are kept apart: sites count by distance.

mod cells;
mod distance;
mod sites;

use glam::DVec3;

use crate::khalimsky::{Adjacency, axis, sign};
use crate::lattice::{Ball, Lattice, LatticeError};
use crate::simd::{Level, Work, dispatch};
use crate::surfel::{CellBox, Links, SurfelIndex, Surfels, Walker, displacement};
use crate::symmetric::{Eigen, Symmetric, eigen};
use crate::volume::{BitBox, PlaneWindow};

use super::average::AverageKernel;
use super::integral::SAME_EIGENVALUE;
use super::{Normals, touches_border, trivial_normal};

use super::border::Border;
use cells::{Cells, Covariance, Ties};
use sites::Sites;

/// Radius of the part of the surface that decides on which side u points, in voxel units, unless r
/// is smaller. Larger, and both sides of a thin part meet around its rim; smaller, and noise decides.
pub const SIDE_RADIUS: f64 = 3.0;

/// A side whose cosine with e is smaller does not choose between e and -e: rounding would.
const NO_SIDE: f64 = 1e-9;

/// Which way u points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Side {
    /// As the surface average around the surfel.
    #[default]
    Surface,
    /// As the sum of (2/3 + d/9) n over the surface connected to the surfel at distances d < 3:
    /// DGtal's convolution of trivial normals over a ring of 3. Ties between sites go as in DGtal too.
    Dgtal,
}

/// The Voronoi covariance measure at one pair of radii.
#[derive(Clone, Debug)]
pub struct VcmKernel {
    /// R: how far from its site a point counts.
    offset: Ball,
    /// r: how far from a pointel a site counts.
    hat: Ball,
    edges: [f64; 3],
    adjacency: Adjacency,
    side: Side,
    average: AverageKernel,
    /// The ball of [`Side::Dgtal`], on surfels.
    ring: Ball,
    /// Rows of the hat's ball: displacements along y and z, half-width along x.
    rows: Vec<([i32; 2], i32)>,
}

/// Surfels and pointels of a core, and where their sites are.
struct Around<'a> {
    kernel: &'a VcmKernel,
    sites: &'a Sites,
    wanted: &'a Sites,
    points: CellBox,
    pointels: &'a [[i32; 3]],
}

impl Work for Around<'_> {
    type Output = Vec<Symmetric>;

    #[inline(always)]
    fn run<L: Level>(self) -> Vec<Symmetric> {
        let cells = Cells {
            sites: self.sites,
            wanted: self.wanted,
            points: self.points,
            ball: &self.kernel.offset,
            ties: match self.kernel.side {
                Side::Surface => Ties::Shared,
                Side::Dgtal => Ties::Last,
            },
        };
        // Slacks run from 0 to the limit and one more.
        let covariances = if self.kernel.offset.limit < i64::from(u16::MAX) {
            cells.covariances::<u16>()
        } else {
            cells.covariances::<u32>()
        };
        let scaled = self.kernel.scaled(covariances);
        let mut sums = Vec::with_capacity(self.pointels.len());
        for &p in self.pointels {
            sums.push(self.kernel.sum(self.wanted, &scaled, p));
        }
        sums
    }
}

/// The four pointels of a surfel at Khalimsky coordinates `k`.
fn corners(k: [i32; 3]) -> [[i32; 3]; 4] {
    let even = (0..3).find(|&a| k[a] % 2 == 0).unwrap_or(0);
    let (a, b) = ((even + 1) % 3, (even + 2) % 3);
    [(-1, -1), (1, -1), (-1, 1), (1, 1)].map(|(da, db)| {
        let mut corner = k;
        corner[a] += da;
        corner[b] += db;
        corner.map(|k| k / 2)
    })
}

/// A box grown by `reach` on each side.
fn grown(cells: CellBox, reach: [i32; 3]) -> CellBox {
    CellBox {
        lo: [0, 1, 2].map(|a| cells.lo[a] - reach[a]),
        hi: [0, 1, 2].map(|a| cells.hi[a] + reach[a]),
    }
}

impl VcmKernel {
    /// Prepares for cells cut at `voronoi_radius` and a hat of `radius`, in voxel units.
    ///
    /// # Errors
    /// If a radius cannot be used.
    pub fn new(
        voronoi_radius: f64,
        radius: f64,
        side: Side,
        lattice: &Lattice,
        adjacency: Adjacency,
    ) -> Result<Self, LatticeError> {
        let metric = lattice.metric();
        let hat = metric.voxel_ball(radius)?;
        let [_, _, rz] = hat.reach();
        let mut rows = Vec::new();
        for dz in -rz..=rz {
            let Some(ry) = hat.half_width(1, metric.squared([0, 0, dz])) else {
                continue;
            };
            for dy in -ry..=ry {
                if let Some(half_width) = hat.half_width(0, metric.squared([0, dy, dz])) {
                    rows.push(([dy, dz], half_width));
                }
            }
        }
        let edges = lattice.edges();
        let around = metric.khalimsky_ball(radius.min(SIDE_RADIUS))?;
        Ok(Self {
            offset: metric.voxel_ball(voronoi_radius)?,
            hat,
            edges,
            adjacency,
            side,
            average: AverageKernel::new(around, edges, adjacency),
            ring: metric.khalimsky_ball(SIDE_RADIUS)?,
            rows,
        })
    }

    fn side_ball(&self) -> &Ball {
        match self.side {
            Side::Surface => self.average.ball(),
            Side::Dgtal => &self.ring,
        }
    }

    pub(super) fn reach(&self) -> [i32; 3] {
        let (offset, hat, side) = (
            self.offset.reach(),
            self.hat.reach(),
            self.side_ball().reach(),
        );
        // A point lies within R of its site, and a nearer one within R of the point.
        [0, 1, 2].map(|a| (2 * offset[a] + hat[a] + 1).max(side[a] + 1))
    }

    /// Memory while the normals of a brick of this size are made, at worst.
    pub(super) fn scratch_bytes(&self, core: [i32; 3]) -> u64 {
        let (offset, hat, side) = (
            self.offset.reach(),
            self.hat.reach(),
            self.side_ball().reach(),
        );
        let volume =
            |more: [i32; 3]| -> f64 { (0..3).map(|a| f64::from(core[a] + 1 + more[a])).product() };
        let own = volume([0; 3]);
        let hats = volume(hat.map(|r| 2 * r));
        let voxels = volume([0, 1, 2].map(|a| 2 * hat[a] + 4 * offset[a] + 1));
        // points along x and y, sites along z
        let slacks = volume([
            2 * (hat[0] + offset[0] + 1),
            2 * (hat[1] + offset[1] + 1),
            2 * hat[2] + 4 * offset[2],
        ]);
        let word = if self.offset.limit < i64::from(u16::MAX) {
            2.0
        } else {
            4.0
        };
        // Bits, sites and ranks are held throughout; first slacks and a matrix a site, with the
        // numbers of the pointels of each surfel; then eigenvectors a pointel, sides and normals.
        let first = slacks * word + hats * 48.0 + own * 50.0;
        let then = own * 240.0 + volume(side.map(|r| 2 * r)) * 80.0;
        (voxels * 0.4 + first.max(then)) as u64
    }

    /// Matrices in voxel units.
    fn scaled(&self, covariances: Vec<Covariance>) -> Vec<[f64; 6]> {
        let [x, y, z] = self.edges;
        let one = (1u64 << cells::shift(&self.offset)) as f64;
        let units = [x * x, y * y, z * z, x * y, x * z, y * z].map(|edges| edges / one);
        covariances
            .into_iter()
            .map(|terms| [0, 1, 2, 3, 4, 5].map(|t| units[t] * terms[t] as f64))
            .collect()
    }

    /// M at a pointel.
    #[inline(always)]
    fn sum(&self, wanted: &Sites, scaled: &[[f64; 6]], p: [i32; 3]) -> Symmetric {
        let mut sum = [0.0; 6];
        let extent = wanted.extent;
        let metric = self.hat.metric;
        for &([dy, dz], half_width) in &self.rows {
            let (y, z) = (p[1] + dy, p[2] + dz);
            let lo = (p[0] - half_width).max(extent.lo[0]);
            let hi = (p[0] + half_width).min(extent.hi[0] - 1);
            let within = extent.lo[1] <= y && y < extent.hi[1] && extent.lo[2] <= z;
            if !within || z >= extent.hi[2] || lo > hi {
                continue;
            }
            wanted.for_each_in_row([lo, hi], y, z, |x, number| {
                let squared = metric.squared([x - p[0], dy, dz]) as f64;
                let weight = 1.0 - (squared / self.hat.squared).sqrt();
                for (sum, term) in sum.iter_mut().zip(scaled[number]) {
                    *sum += weight * term;
                }
            });
        }
        Symmetric::from_terms(sum)
    }

    pub(super) fn estimate(
        &self,
        window: &PlaneWindow,
        lattice: &Lattice,
        core: CellBox,
        surfels: &Surfels,
    ) -> Normals {
        let mut normals = Normals::default();
        let count = surfels.list.len();
        if count == 0 {
            return normals;
        }
        let pointels_of = |i: usize| corners(surfels.khalimsky(i));
        let mut own = CellBox {
            lo: [i32::MAX; 3],
            hi: [i32::MIN; 3],
        };
        for p in (0..count).flat_map(pointels_of) {
            for a in 0..3 {
                own.lo[a] = own.lo[a].min(p[a]);
                own.hi[a] = own.hi[a].max(p[a] + 1);
            }
        }
        let (offset, hat) = (self.offset.reach(), self.hat.reach());
        // There are no sites beyond the image.
        let pointels = lattice.dims.map(|n| n as i32 + 1);
        let near = own.grown(hat, pointels);
        let all = own.grown([0, 1, 2].map(|a| hat[a] + 2 * offset[a]), pointels);
        let reach = self.reach();
        let lo = [0, 1, 2].map(|a| own.lo[a] - reach[a]);
        let hi = [0, 1, 2].map(|a| own.hi[a] - 1 + reach[a]);
        let bits = BitBox::cut(window, lo, hi);
        let sites = Sites::find(&bits, all, lattice);
        let wanted = Sites::find(&bits, near, lattice);
        let mut order: Vec<[i32; 3]> = Vec::new();
        let mut slots = vec![u32::MAX; wanted.len()];
        let slots_of: Vec<[u32; 4]> = (0..count)
            .map(|i| {
                pointels_of(i).map(|p| {
                    let slot = &mut slots[wanted.number(p)];
                    if *slot == u32::MAX {
                        *slot = order.len() as u32;
                        order.push(p);
                    }
                    *slot
                })
            })
            .collect();
        drop(slots);
        let matrices = dispatch(Around {
            kernel: self,
            sites: &sites,
            wanted: &wanted,
            points: grown(near, offset),
            pointels: &order,
        });
        let lines: Vec<Option<Eigen>> = matrices
            .iter()
            .map(|m| (*m != Symmetric::default()).then(|| eigen(m)))
            .collect();
        let sides = self.sides(window, lattice, core, surfels);
        let border = (!lattice.closed).then(|| Border::count(&bits, lo, hi, lattice));
        for (i, slots) in slots_of.iter().enumerate() {
            let surfel = surfels.oriented(i);
            let n = trivial_normal(surfel.orientation);
            let sum: DVec3 = slots
                .iter()
                .filter_map(|&slot| lines[slot as usize].as_ref())
                .map(|line| self.turned(line, sides[i], n))
                .sum();
            // Four unit vectors on one side add to more, unless each is nearly its tangent.
            let degenerate = sum.length() <= NO_SIDE;
            normals.degenerate.push(degenerate);
            normals.u.push(if degenerate { n } else { sum.normalize() });
            normals.cut.push(border.as_ref().is_some_and(|border| {
                let [corner, .., last] = pointels_of(i);
                let lo = [0, 1, 2].map(|a| corner[a] - reach[a]);
                let hi = [0, 1, 2].map(|a| last[a] + reach[a]);
                touches_border(surfel, lattice) || border.is_met(lo, hi)
            }));
        }
        normals
    }

    /// The eigendirection of the largest eigenvalue on one side; see the module page for ties.
    fn turned(&self, line: &Eigen, side: DVec3, n: DVec3) -> DVec3 {
        let [.., e] = line.vectors;
        if self.side == Side::Dgtal {
            return if e.dot(side) < 0.0 { -e } else { e };
        }
        let [smallest, middle, largest] = line.values;
        let same = SAME_EIGENVALUE * largest;
        let dimensions = 1 + usize::from(largest - middle <= same)
            * (1 + usize::from(middle - smallest <= same));
        [side, n]
            .into_iter()
            .map(|v| -> DVec3 {
                match dimensions {
                    3 => v,
                    _ => line.vectors[3 - dimensions..]
                        .iter()
                        .map(|&e| e * e.dot(v))
                        .sum(),
                }
            })
            .find(|projection| projection.length() > NO_SIDE)
            .map_or(DVec3::ZERO, DVec3::normalize)
    }

    /// For each surfel of the core a vector on the side u is to be.
    fn sides(
        &self,
        window: &PlaneWindow,
        lattice: &Lattice,
        core: CellBox,
        core_surfels: &Surfels,
    ) -> Vec<DVec3> {
        if self.side == Side::Surface {
            return self.average.estimate(window, lattice, core, core_surfels).u;
        }
        let cells = core.grown(self.ring.reach(), lattice.cell_dims());
        let bits = BitBox::cut(window, cells.lo.map(|c| c - 1), cells.hi.map(|c| c + 1));
        let index = SurfelIndex::find(&bits, cells, lattice);
        let surfels = Surfels::list(&index, &bits);
        let links = Links::join(&index, &surfels, &bits, lattice, self.adjacency);
        let mut walker = Walker::default();
        let own = (0..surfels.list.len()).filter(|&i| core.contains(surfels.oriented(i).cell()));
        own.map(|start| {
            let centre = surfels.list[start].k;
            let squared = |q: usize| {
                self.ring
                    .metric
                    .squared(displacement(surfels.list[q].k, centre)) as f64
            };
            walker.walk_where(&links, surfels.list.len(), start, |q| {
                squared(q) < self.ring.squared
            });
            let mut sum = DVec3::ZERO;
            for &q in walker.part() {
                let orientation = surfels.list[q as usize].orientation;
                let distance = SIDE_RADIUS * (squared(q as usize) / self.ring.squared).sqrt();
                sum[axis(orientation)] +=
                    f64::from(sign(orientation)) * (2.0 / 3.0 + distance / 9.0);
            }
            sum
        })
        .collect()
    }
}
