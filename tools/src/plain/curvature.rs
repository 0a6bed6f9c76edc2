//! From sums of measures to curvatures, in world units. The only place where units change.

use super::algebra::{ENTRIES, Vector, eigen};
use super::sums::Sums;

/// Curvatures at a surfel, world units; NaN where mu0 of the ball is not positive.
#[derive(Clone, Copy, Debug)]
pub struct Curvature {
    /// Mean curvature H = mu1 / (2 mu0), positive on convex bodies.
    pub mean: f64,
    /// Gaussian curvature G = mu2 / mu0.
    pub gaussian: f64,
    /// The smaller principal curvature.
    pub k1: f64,
    /// The larger principal curvature.
    pub k2: f64,
    /// Unit direction of k1, up to sign.
    pub d1: Vector,
    /// Unit direction of k2, up to sign.
    pub d2: Vector,
    /// mu_Omega / mu0: 0 if u is the normal field of a surface.
    pub quality: f64,
}

impl Curvature {
    /// The curvatures of a ball whose centre has the corrected normal `u`.
    ///
    /// Adding -1000 mu0 u u^T to the tensor sends the eigenvector nearest to u far away; the
    /// two others are the principal directions.
    pub fn new(sums: &Sums, u: Vector, unit_world: f64) -> Self {
        if sums.mu0 <= 0.0 {
            let nan = f64::NAN;
            return Curvature {
                mean: nan,
                gaussian: nan,
                k1: nan,
                k2: nan,
                d1: [nan; 3],
                d2: [nan; 3],
                quality: nan,
            };
        }
        let far = -1000.0 * sums.mu0;
        let mut matrix = sums.tensor;
        for (e, (i, j)) in ENTRIES.into_iter().enumerate() {
            matrix[e] += far * u[i] * u[j];
        }
        let (values, vectors) = eigen(matrix);
        let mut along_u = 0;
        for e in 1..3 {
            if (values[e] - far).abs() < (values[along_u] - far).abs() {
                along_u = e;
            }
        }
        let (first, second) = [(1, 2), (0, 2), (0, 1)][along_u];
        Curvature {
            mean: sums.mu1() / (2.0 * sums.mu0) / unit_world,
            gaussian: sums.mu2 / sums.mu0 / (unit_world * unit_world),
            k1: values[first] / sums.mu0 / unit_world,
            k2: values[second] / sums.mu0 / unit_world,
            d1: vectors[first],
            d2: vectors[second],
            quality: sums.omega / sums.mu0 / unit_world,
        }
    }
}
