//! Curvatures, in world units: from measures, or by plain integral invariants ([`integral`]).
//!
//! Comes in: sums over a ball ([`BallSums`]) in voxel units, and `u` at its centre. Goes out:
//! [`Curvature`]: H = mu1 / (2 mu0), G = mu2 / mu0, k1 <= k2 and their directions. This is the one
//! place where lengths become world lengths.
//!
//! **Principal curvatures.** With M the summed tensor, k1 and k2 are the eigenvalues of
//! M / mu0 - 1000 u u^T other than the one near -1000: the penalty keeps the eigenvector along `u`
//! out. k1 + k2 is not exactly 2 H, since M may have a part along `u`; the difference is reported
//! with the totals.
//!
//! **Quality of u.** mu_Omega / mu0 is minus the circulation of `u` around the set, counter-clockwise seen
//! from outside, per area: zero if `u` is the normal field of a surface (paper, Remark 3.3). A mirror
//! changes its sign. It compares with H: it is the rate at which `u` turns about itself rather
//! than bends with a surface.
//!
//! Guaranteed: k1 <= k2; directions are unit vectors, up to sign. Not guaranteed: a meaning of the
//! directions at umbilics, where k1 = k2.

mod block;
pub mod integral;
pub mod uncertainty;

pub(crate) use block::CurvatureBlock;

use glam::DVec3;

use crate::measure::ball::BallSums;
use crate::symmetric::{BesidePenalty, Symmetric, beside_penalty, eigen};

/// Penalty on the normal direction. Much smaller, and the normal part of the tensor mixes with
/// the principal directions; much larger, and rounding of the eigenvalues shows. DGtal's value.
const NORMAL_PENALTY: f64 = 1000.0;

/// Where curvatures come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// The corrected curvature measures.
    #[default]
    Measures,
    /// Plain integral invariants: see [`integral`].
    Invariants,
}

/// Curvatures at a surfel, in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature {
    /// H, positive on a convex body.
    pub mean: f64,
    /// G.
    pub gaussian: f64,
    /// Smaller principal curvature.
    pub k1: f64,
    /// Larger principal curvature.
    pub k2: f64,
    /// Direction of `k1`, in image axes.
    pub d1: DVec3,
    /// Direction of `k2`, in image axes.
    pub d2: DVec3,
    /// mu_Omega / mu0 in image axes, so of the other sign in a world where they are left-handed; 0 unless
    /// mu_Omega was evaluated, not a number with integral invariants.
    pub quality: f64,
}

impl Curvature {
    /// Curvatures from sums around a surfel of normal `u`; `voxel_unit_world` is the length of a
    /// voxel unit. `None` where mu0 is not positive, so that no quotient means anything.
    #[must_use]
    pub fn from_sums(sums: &BallSums, u: DVec3, voxel_unit_world: f64) -> Option<Self> {
        let BallSums {
            mu0,
            tensor,
            mu2,
            omega,
            ..
        } = sums;
        Self::from_measures(*mu0, tensor, *mu2, *omega, u, voxel_unit_world)
    }

    /// Curvatures from the measures mu0, tensor, mu2 and mu_Omega of a part of a surface around a place
    /// of normal `u`, in units whose length in the world is `unit_world`. `None` where mu0 is not
    /// positive.
    #[must_use]
    pub fn from_measures(
        mu0: f64,
        tensor: &Symmetric,
        mu2: f64,
        omega: f64,
        u: DVec3,
        unit_world: f64,
    ) -> Option<Self> {
        if mu0 <= 0.0 {
            return None;
        }
        let (mut found, holds) = Self::by_penalty(mu0, tensor, mu2, omega, u, unit_world);
        if !holds {
            ([found.k1, found.k2], [found.d1, found.d2]) =
                principal_by_jacobi(mu0, tensor, u, unit_world);
        }
        Some(found)
    }

    /// The same, without branches, and whether the principal curvatures are small against the penalty: otherwise they and
    /// their directions mean nothing. Nothing means anything where mu0 is not positive.
    #[inline(always)]
    fn by_penalty(
        mu0: f64,
        tensor: &Symmetric,
        mu2: f64,
        omega: f64,
        u: DVec3,
        unit_world: f64,
    ) -> (Self, bool) {
        let (per_length, per_area) = (1.0 / unit_world, 1.0 / mu0);
        let BesidePenalty {
            holds,
            values: [k1, k2],
            vectors: [d1, d2],
        } = beside_penalty(&tensor.scaled(per_area), u, NORMAL_PENALTY);
        let mu1 = tensor.xx + tensor.yy + tensor.zz;
        let found = Self {
            mean: 0.5 * mu1 * per_area * per_length,
            gaussian: mu2 * per_area * per_length * per_length,
            k1: k1 * per_length,
            k2: k2 * per_length,
            d1,
            d2,
            quality: omega * per_area * per_length,
        };
        (found, holds)
    }
}

/// Principal curvatures and directions from mu0 and the tensor where curvatures are not small against the penalty.
fn principal_by_jacobi(
    mu0: f64,
    tensor: &Symmetric,
    u: DVec3,
    unit_world: f64,
) -> ([f64; 2], [DVec3; 2]) {
    let (shape, per_length) = (tensor.scaled(1.0 / mu0), 1.0 / unit_world);
    let principal = eigen(&shape.zip(&Symmetric::outer(u, u), |m, uu| m - NORMAL_PENALTY * uu));
    // Without the direction of the penalty; where curvatures are beyond it, they stay.
    let far = |i: usize| (principal.values[i] + NORMAL_PENALTY).abs();
    let normal = (0..3).fold(0, |best, i| if far(i) < far(best) { i } else { best });
    let kept = [[1, 2], [0, 2], [0, 1]][normal];
    (
        kept.map(|i| principal.values[i] * per_length),
        kept.map(|i| principal.vectors[i]),
    )
}

/// A direction with its sign fixed: the largest component by size, the first of equals, is positive.
#[must_use]
pub fn upward(d: DVec3) -> DVec3 {
    let a = d.to_array();
    let largest = (0..3).fold(0, |best, i| {
        if a[i].abs() > a[best].abs() * (1.0 + 1e-9) {
            i
        } else {
            best
        }
    });
    if a[largest] < 0.0 { -d } else { d }
}
