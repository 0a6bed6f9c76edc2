//! Plain digital integral invariants: curvatures from the solid in a ball, without normals.
//!
//! Coeurjolly, Lachaud, Levallois, *Multigrid convergent principal curvature estimators in digital
//! geometry*; the paper compares with them in 6.1.4. Comes in: the bits around a brick, the
//! surfels of its core. Goes out: [`Curvature`] and whether the border cuts the ball, a surfel each.
//!
//! With r the radius, V the volume of the solid in the ball around a surfel's inner voxel and around
//! its outer voxel, averaged, and l1 <= l2 the two largest eigenvalues of its covariance, averaged,
//!
//! ```text
//!    H  = 8 / (3 r) - 4 V / (pi r^4)
//!    k1 = 6 (l1 - 3 l2) / (pi r^6) + 8 / (5 r)     k2 = 6 (l2 - 3 l1) / (pi r^6) + 8 / (5 r)
//!    G  = k1 k2
//! ```
//!
//! A voxel counts with its volume, in true proportion where it is a box. d1 is the eigenvector of l2, d2 that of l1.
//!
//! Guaranteed: integer counts, so no cut shows; k1 <= k2. Not guaranteed: (k1 + k2) / 2 = H, which
//! come from different moments. **Convergence** needs a radius that shrinks slower than the gridstep h, such as
//! h^(1/3) in world units: with h^(1/2) the error of a count divided by the powers of r
//! stays as large as the curvature. Other sheets in the ball disturb all of it.

use std::f64::consts::PI;

use crate::lattice::{Lattice, LatticeError};
use crate::normal::Orientation;
use crate::normal::integral::IntegralKernel;
use crate::surfel::{CellBox, Surfels};
use crate::symmetric::eigen;
use crate::volume::PlaneWindow;

use super::Curvature;

/// Plain integral invariants at one radius.
#[derive(Clone, Debug)]
pub struct InvariantKernel {
    solid: IntegralKernel,
    /// Volume of a voxel, in voxel units.
    voxel: f64,
}

impl InvariantKernel {
    /// Prepares for a ball of `radius` voxel units.
    ///
    /// # Errors
    /// If the radius cannot be used.
    pub fn new(radius: f64, lattice: &Lattice) -> Result<Self, LatticeError> {
        let edges = lattice.edges();
        let ball = lattice.metric().voxel_ball(radius)?;
        Ok(Self {
            solid: IntegralKernel::new(ball, edges, Orientation::default()),
            voxel: edges[0] * edges[1] * edges[2],
        })
    }

    /// The radius in voxel units.
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.solid.ball().radius
    }

    /// How many voxels beyond its cell a surfel's curvature looks, along each axis.
    #[must_use]
    pub fn reach(&self) -> [i32; 3] {
        self.solid.ball().reach().map(|r| r + 1)
    }

    /// Curvatures at the surfels of `core`, and whether the border of an open image cuts the ball
    /// where the solid meets it.
    #[must_use]
    pub fn curvatures(
        &self,
        window: &PlaneWindow,
        lattice: &Lattice,
        core: CellBox,
        surfels: &Surfels,
    ) -> Vec<(Curvature, bool)> {
        if surfels.list.is_empty() {
            return Vec::new();
        }
        let beside = self.solid.beside(window, lattice, core, surfels);
        let r = self.radius();
        let unit = lattice.voxel_unit_world();
        let factor = 6.0 / (PI * r.powi(6));
        let curvatures = beside.pairs.iter().enumerate().map(|(i, &(inner, outer))| {
            let [inner, outer] = [inner, outer].map(|n| &beside.moments[n as usize]);
            let volume = 0.5 * (inner.count + outer.count) as f64 * self.voxel;
            let [a, b] = [inner, outer].map(|m| self.solid.covariance(m));
            let covariance = a.zip(&b, |a, b| 0.5 * self.voxel * (a + b));
            let e = eigen(&covariance);
            let [_, l1, l2] = e.values;
            let k1 = factor * (l1 - 3.0 * l2) + 8.0 / (5.0 * r);
            let k2 = factor * (l2 - 3.0 * l1) + 8.0 / (5.0 * r);
            let curvature = Curvature {
                quality: f64::NAN,
                mean: (8.0 / (3.0 * r) - 4.0 * volume / (PI * r.powi(4))) / unit,
                gaussian: k1 * k2 / (unit * unit),
                k1: k1 / unit,
                k2: k2 / unit,
                d1: e.vectors[2],
                d2: e.vectors[1],
            };
            (curvature, beside.is_cut(surfels.oriented(i), lattice))
        });
        curvatures.collect()
    }
}
