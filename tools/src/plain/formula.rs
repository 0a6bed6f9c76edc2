//! Pure formulas of the measures of one cell, for a constant u per surfel.
//!
//! Lachaud, Romon, Thibert, *Corrected curvature measures*, section 3.2, with the signs chosen
//! such that a convex body has positive measures.

use super::algebra::{ENTRIES, Symmetric, Vector, cross, determinant, dot, norm, scaled};

/// The angle and the tensor on a linel of unit length.
///
/// `e` is the unit direction in which the boundary of the first surfel, counter-clockwise seen
/// from outside, runs along the linel. With v(theta) turning from `u_f` to `u_g` about
/// e1 = u_f x u_g / |u_f x u_g|, the tensor is the symmetric part of
/// integral over 0..Psi of (e x v) (x) (e1 x v) d theta.
/// Its trace is mu1 = Psi <e, e1> (Proposition 3.5), *twice* the integral of the mean curvature;
/// it is minus DGtal's muXY.
pub fn linel_tensor(e: Vector, u_f: Vector, u_g: Vector) -> Symmetric {
    let c = cross(u_f, u_g);
    let sine = norm(c);
    if sine < 1e-12 {
        return [0.0; 6];
    }
    let psi = sine.atan2(dot(u_f, u_g));
    let e1 = scaled(c, 1.0 / sine);
    // v = cos u_f + sin w, so that e x v = cos a + sin b and e1 x v = cos w - sin u_f.
    let w = cross(e1, u_f);
    let a = cross(e, u_f);
    let b = cross(e, w);
    let (sin_psi, cos_psi) = psi.sin_cos();
    let cos_cos = 0.5 * (psi + sin_psi * cos_psi);
    let sin_sin = 0.5 * (psi - sin_psi * cos_psi);
    let sin_cos = 0.5 * sin_psi * sin_psi;
    ENTRIES.map(|(i, j)| {
        let symmetric = |x: Vector, y: Vector| 0.5 * (x[i] * y[j] + x[j] * y[i]);
        cos_cos * symmetric(a, w) - sin_cos * symmetric(a, u_f) + sin_cos * symmetric(b, w)
            - sin_sin * symmetric(b, u_f)
    })
}

/// Signed area of the spherical triangle a, b, c: positive if counter-clockwise seen from outside.
pub fn triangle_area(a: Vector, b: Vector, c: Vector) -> f64 {
    let cosines = 1.0 + dot(a, b) + dot(b, c) + dot(c, a);
    2.0 * determinant(a, b, c).atan2(cosines)
}

/// Area of the spherical quadrilateral n_f, n_g, u_g, u_f, for f before g in the order of surfels.
/// The shorter diagonal splits it; on a tie the one from n_f.
pub fn swept_area(n_f: Vector, n_g: Vector, u_g: Vector, u_f: Vector) -> f64 {
    if dot(n_f, u_g) >= dot(n_g, u_f) {
        triangle_area(n_f, n_g, u_g) + triangle_area(n_f, u_g, u_f)
    } else {
        triangle_area(n_f, n_g, u_f) + triangle_area(n_g, u_g, u_f)
    }
}
