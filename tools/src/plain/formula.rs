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
    if sine < 1e-12 || are_opposite(u_f, u_g) {
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

/// Do two unit vectors differ by a half turn, so that there is no one arc between them?
fn are_opposite(a: Vector, b: Vector) -> bool {
    dot(a, b) < -1.0 + 2e-12
}

/// Signed area of the spherical triangle a, b, c: positive if counter-clockwise seen from outside.
pub fn triangle_area(a: Vector, b: Vector, c: Vector) -> f64 {
    let cosines = 1.0 + dot(a, b) + dot(b, c) + dot(c, a);
    2.0 * determinant(a, b, c).atan2(cosines)
}

/// Area of the spherical quadrilateral n_f, n_g, u_g, u_f, for f before g in the order of surfels.
/// The shorter diagonal splits it; on a tie the one from n_f.
pub fn swept_area(n_f: Vector, n_g: Vector, u_g: Vector, u_f: Vector) -> f64 {
    let (from_f, from_g) = (dot(n_f, u_g), dot(n_g, u_f));
    if are_opposite(u_f, u_g) || (are_opposite(n_f, u_g) && are_opposite(n_g, u_f)) {
        // No arc: it is taken through n_f and n_g.
        0.0
    } else if from_f >= from_g {
        triangle_area(n_f, n_g, u_g) + triangle_area(n_f, u_g, u_f)
    } else {
        triangle_area(n_f, n_g, u_f) + triangle_area(n_g, u_g, u_f)
    }
}

#[cfg(test)]
mod tests {
    use super::super::algebra::normalised;
    use super::*;

    const E: Vector = [0.0, 1.0, 0.0];
    const Z: Vector = [0.0, 0.0, 1.0];
    const X: Vector = [1.0, 0.0, 0.0];

    #[test]
    fn convex_edge_of_a_box_has_a_quarter_turn_bending_across_it() {
        let m = linel_tensor(E, Z, X);
        let quarter = std::f64::consts::FRAC_PI_2;
        assert!((m[0] + m[1] + m[2] - quarter).abs() < 1e-15);
        assert!((m[0] - quarter / 2.0).abs() < 1e-15 && m[1].abs() < 1e-15);
        assert_eq!(linel_tensor([0.0, -1.0, 0.0], X, Z), m);
    }

    #[test]
    fn closed_form_of_the_tensor_agrees_with_quadrature() {
        for (u_f, u_g) in [
            ([0.3, -0.2, 0.9], [0.8, 0.1, 0.2]),
            ([0.1, 0.2, 0.9], [0.1, -0.3, -0.8]),
            ([0.0, 0.0, 1.0], [0.001, 0.0, 1.0]),
        ] {
            let (u_f, u_g) = (normalised(u_f), normalised(u_g));
            let m = linel_tensor(E, u_f, u_g);
            let e1 = normalised(cross(u_f, u_g));
            let psi = norm(cross(u_f, u_g)).atan2(dot(u_f, u_g));
            const STEPS: usize = 2000;
            let mut sum = [0.0; 6];
            for step in 0..STEPS {
                let theta = psi * (step as f64 + 0.5) / STEPS as f64;
                let w = cross(e1, u_f);
                let v = [0, 1, 2].map(|a| theta.cos() * u_f[a] + theta.sin() * w[a]);
                let (a, b) = (cross(E, v), cross(e1, v));
                for (entry, (i, j)) in ENTRIES.into_iter().enumerate() {
                    sum[entry] += 0.5 * (a[i] * b[j] + a[j] * b[i]) * psi / STEPS as f64;
                }
            }
            for entry in 0..6 {
                assert!((sum[entry] - m[entry]).abs() < 1e-6, "{sum:?} {m:?}");
            }
            assert!((m[0] + m[1] + m[2] - psi * dot(E, e1)).abs() < 1e-14);
        }
    }

    #[test]
    fn octant_has_area_pi_over_2_and_a_flip_changes_the_sign() {
        let octant = triangle_area(X, E, Z);
        assert!((octant - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        assert_eq!(triangle_area(E, X, Z), -octant);
    }
}
