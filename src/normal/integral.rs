//! Digital integral invariants: u from the covariance of the solid in a ball of voxels.
//!
//! Paper, section 6.1.3 (II); Lachaud, Coeurjolly, Levallois, *Robust and convergent curvature and
//! normal estimators with digital integral invariants*. The ball is centred on the inner voxel and
//! on the outer voxel of the surfel; the two covariances (and first moments) are averaged.
//! Voxels outside the image count as outside.
//!
//! ```text
//!    moments of the voxels X in the ball around c, about c, in integers:
//!       n = |X|,  s = sum (q - c),  S = sum (q - c)(q - c)^T
//!    covariance  S - s s^T / n     (one rounding: (n S - s s^T) / n)
//! ```
//!
//! The moments depend on the centre only, so each voxel that is inner or outer to some surfel is
//! evaluated once: see `moments.rs`.
//!
//! **Which eigenvector.** With [`Orientation::Moment`] the one nearest the first moment
//! (largest |cos|), pointing away from it. Ties, made explicit because small solids are full of
//! them: eigenvalues closer than [`SAME_EIGENVALUE`] share their eigenspace and the first
//! moment's projection on it is the candidate; candidates whose |cos| differ by less than
//! [`SAME_COSINE`] are decided for the smaller eigenvalue.

use glam::DVec3;

use crate::khalimsky::OrientedSurfel;
use crate::lattice::{Ball, Lattice};
use crate::surfel::{CellBox, Surfels};
use crate::symmetric::{Symmetric, eigen, eigenvector_near};
use crate::volume::{BitBox, PlaneWindow};

use super::border::Border;
use super::moments::{MomentKernel, Moments};
use super::{Normals, Orientation, touches_border, trivial_normal};

/// Eigenvalues closer than this, relative to the largest, count as equal. Larger would merge
/// directions that a shape really distinguishes; smaller would let rounding choose the basis of
/// an eigenspace, so that a mirrored volume got other normals.
pub const SAME_EIGENVALUE: f64 = 1e-7;

/// Cosines closer than this count as equal, so that rounding does not decide between eigenvectors
/// to which the first moment is equally near.
pub const SAME_COSINE: f64 = 1e-9;

/// An eigenvector whose squared cosine is larger than a half is the nearest of the three; a little more, so that
/// rounding and [`SAME_COSINE`] have no say.
const SURELY_NEAREST: f64 = 0.51;

/// Integral invariants at one radius.
#[derive(Clone, Debug)]
pub struct IntegralKernel {
    moments: MomentKernel,
    edges: [f64; 3],
    /// Whether 64 bits hold the numerators of a covariance.
    narrow: bool,
    orientation: Orientation,
}

/// Moments about the voxels beside some surfels.
pub(crate) struct BesideSurfels {
    /// One for each voxel that is inner or outer to a surfel.
    pub(crate) moments: Vec<Moments>,
    /// For each surfel the numbers of its inner and its outer voxel.
    pub(crate) pairs: Vec<(u32, u32)>,
    reach: [i32; 3],
    /// The border of an open image.
    border: Option<Border>,
}

impl BesideSurfels {
    /// Whether a surfel touches the border of an open image, or its ball leaves the image where the solid
    /// meets the border (within the box around the ball): how it goes on is unknown, and it was
    /// taken to end there. A solid that stays clear of the border is taken to be all there is.
    pub(crate) fn is_cut(&self, surfel: OrientedSurfel, lattice: &Lattice) -> bool {
        self.border.as_ref().is_some_and(|border| {
            let (p, q) = (surfel.inner, surfel.outer());
            let lo = [0, 1, 2].map(|a| p[a].min(q[a]) - self.reach[a]);
            let hi = [0, 1, 2].map(|a| p[a].max(q[a]) + self.reach[a] + 1);
            touches_border(surfel, lattice) || border.is_met(lo, hi)
        })
    }
}

impl IntegralKernel {
    /// Prepares for a ball of voxels of the given edges (in voxel units).
    #[must_use]
    pub fn new(ball: Ball, edges: [f64; 3], orientation: Orientation) -> Self {
        // Sums of coordinates are at most the count times the reach, and squares likewise.
        let [x, y, z] = ball.reach().map(f64::from);
        let most = (2.0 * x + 1.0) * (2.0 * y + 1.0) * (2.0 * z + 1.0) * x.max(y).max(z);
        Self {
            narrow: most * most < 2f64.powi(62),
            moments: MomentKernel::new(ball),
            edges,
            orientation,
        }
    }

    pub(crate) fn ball(&self) -> &Ball {
        self.moments.ball()
    }

    /// Covariance in voxel units; zero where there is no voxel.
    pub(crate) fn covariance(&self, m: &Moments) -> Symmetric {
        if m.count == 0 {
            return Symmetric::default();
        }
        const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        let mut terms = [0.0; 6];
        for (t, (i, j)) in PAIRS.into_iter().enumerate() {
            let numerator = if self.narrow {
                (m.count * m.second[t] - m.first[i] * m.first[j]) as f64
            } else {
                // For flat voxels a ball can hold many of them along an axis.
                let wide = i128::from(m.count) * i128::from(m.second[t])
                    - i128::from(m.first[i]) * i128::from(m.first[j]);
                wide as f64
            };
            terms[t] = self.edges[i] * self.edges[j] * (numerator / m.count as f64);
        }
        Symmetric::from_terms(terms)
    }

    /// The moments about the inner and outer voxels of the surfels of `core`.
    pub(crate) fn beside(
        &self,
        window: &PlaneWindow,
        lattice: &Lattice,
        core: CellBox,
        surfels: &Surfels,
    ) -> BesideSurfels {
        let reach = self.ball().reach();
        let lo = [0, 1, 2].map(|a| core.lo[a] - 1 - reach[a]);
        let hi = [0, 1, 2].map(|a| core.hi[a] + reach[a]);
        let bits = BitBox::cut(window, lo, hi);
        // Voxels of the core and one below are inner or outer to its surfels.
        let near = core.lo.map(|c| c - 1);
        let size = [0, 1, 2].map(|a| (core.hi[a] - near[a]) as usize);
        let mut slots = vec![0u32; size[0] * size[1] * size[2]];
        let mut voxels = Vec::new();
        let mut at = |p: [i32; 3]| -> u32 {
            let [x, y, z] = [0, 1, 2].map(|a| (p[a] - near[a]) as usize);
            let slot = &mut slots[(z * size[1] + y) * size[0] + x];
            if *slot == 0 {
                voxels.push(p);
                *slot = voxels.len() as u32;
            }
            *slot - 1
        };
        let pairs: Vec<(u32, u32)> = (0..surfels.list.len())
            .map(|i| {
                let surfel = surfels.oriented(i);
                (at(surfel.inner), at(surfel.outer()))
            })
            .collect();
        let moments = self.moments.about(&bits, &voxels);
        BesideSurfels {
            moments,
            pairs,
            reach,
            border: (!lattice.closed).then(|| Border::count(&bits, lo, hi, lattice)),
        }
    }

    pub(super) fn estimate(
        &self,
        window: &PlaneWindow,
        lattice: &Lattice,
        core: CellBox,
        surfels: &Surfels,
    ) -> Normals {
        let mut normals = Normals::default();
        if surfels.list.is_empty() {
            return normals;
        }
        let beside = self.beside(window, lattice, core, surfels);
        let covariances: Vec<Symmetric> =
            beside.moments.iter().map(|m| self.covariance(m)).collect();
        for (i, &(inner, outer)) in beside.pairs.iter().enumerate() {
            let [a, b] = [inner, outer].map(|at| &beside.moments[at as usize].first);
            let first = [0, 1, 2].map(|i| a[i] + b[i]);
            let [a, b] = [inner, outer].map(|at| &covariances[at as usize]);
            let covariance = a.zip(b, |a, b| 0.5 * (a + b));
            let surfel = surfels.oriented(i);
            let n = trivial_normal(surfel.orientation);
            let moment =
                DVec3::from_array([0, 1, 2].map(|i| 0.5 * self.edges[i] * first[i] as f64));
            let u = match self.orientation {
                Orientation::Trivial if covariance == Symmetric::default() => None,
                Orientation::Trivial => {
                    let u = smallest_direction(&covariance, moment);
                    Some(if u.dot(n) < 0.0 { -u } else { u })
                }
                Orientation::Moment if first == [0; 3] => None,
                Orientation::Moment => Some(-nearest_direction(&covariance, moment)),
            };
            normals.degenerate.push(u.is_none());
            normals.cut.push(beside.is_cut(surfel, lattice));
            normals.u.push(u.unwrap_or(n));
        }
        normals
    }
}

/// The eigenvector of the smallest eigenvalue, which is expected near `v`.
fn smallest_direction(m: &Symmetric, v: DVec3) -> DVec3 {
    match eigenvector_near(m, v) {
        Some(near) if near.is_smallest => near.vector,
        _ => eigen(m).vectors[0],
    }
}

/// The eigendirection nearest a nonzero vector, on its side. See the module page for ties.
fn nearest_direction(m: &Symmetric, v: DVec3) -> DVec3 {
    if let Some(near) = eigenvector_near(m, v) {
        let along = near.vector.dot(v);
        // Beyond 45 degrees another may be as near.
        if along * along >= SURELY_NEAREST * v.length_squared() {
            return if along < 0.0 {
                -near.vector
            } else {
                near.vector
            };
        }
    }
    let e = eigen(m);
    let scale = e.values.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let same = |i: usize, j: usize| e.values[j] - e.values[i] <= SAME_EIGENVALUE * scale;
    let mut best = (0.0, v);
    let mut i = 0;
    while i < 3 {
        // eigenvectors i..j span one eigenspace
        let mut j = i + 1;
        while j < 3 && same(j - 1, j) {
            j += 1;
        }
        let projection: DVec3 = if j - i == 3 {
            v
        } else {
            (i..j).map(|k| e.vectors[k] * e.vectors[k].dot(v)).sum()
        };
        let length = projection.length();
        if length > best.0 * (1.0 + SAME_COSINE) {
            best = (length, projection);
        }
        i = j;
    }
    best.1.normalize()
}
