//! The measures of a surfel, a linel and a pointel as pure formulas.
//!
//! Signs: normals point outward and a convex body has positive mean curvature, so mu1 of a convex
//! edge is positive. (The paper's Definition 3.4 has the opposite sign of H.) mu1 integrates to
//! *twice* the integral of H: H = mu1 / (2 mu0), and G = mu2 / mu0.
//!
//! Angles are taken by the arc tangent of two arguments, never the arc sine, so they reach pi.

use glam::DVec3;
use libm::atan2;

use crate::symmetric::Symmetric;

/// Normals whose scalar product is below this count as opposite: within 2e-6 of a half turn, where the
/// arc between them is rounding noise. There the paper's condition (ii) of a corrected normal
/// field fails; for mu2 the arc is taken through the trivial normals, and mu1 is 0.
pub(crate) const OPPOSITE: f64 = -1.0 + 2e-12;

/// Two normals whose cross product is shorter than this count as parallel; the rotation axis
/// between them would be rounding noise, and their measure is below it.
const PARALLEL: f64 = 1e-12;

/// Tensor of a linel (minus mu^{X,Y} of Remark 3.7, symmetrised), whose trace is mu1 (paper, Proposition 3.8).
///
/// `u_f` is the normal of the face on whose boundary the linel runs in direction `e` (unit,
/// counter-clockwise seen from outside), `u_g` the normal of the other face, `length` its length.
///
/// With Psi the angle from `u_f` to `u_g`, `e1 = u_f x u_g / |u_f x u_g|` and v(t) the normal
/// rotated by t about `e1`:
///
/// ```text
/// M = length * integral from 0 to Psi of sym[(e x v) (e1 x v)^T] dt,   tr M = Psi <e, e1> length
/// ```
///
/// Zero where the normals are parallel; also where they are opposite, where the paper's
/// condition (ii) fails and there is no axis to turn about.
#[inline(always)]
#[must_use]
pub fn linel_tensor(u_f: DVec3, u_g: DVec3, e: DVec3, length: f64) -> Symmetric {
    let cross = u_f.cross(u_g);
    let sin = cross.length();
    let cos = u_f.dot(u_g);
    if sin < PARALLEL || cos < OPPOSITE {
        return Symmetric::default();
    }
    let psi = atan2(sin, cos);
    let e1 = cross / sin;
    // v(t) = cos t u_f + sin t w,  e1 x v = cos t w - sin t u_f
    let w = e1.cross(u_f);
    let (eu, ew) = (e.cross(u_f), e.cross(w));
    // integrals of cos^2, sin^2 and sin cos from 0 to psi
    let cc = 0.5 * (psi + sin * cos);
    let ss = 0.5 * (psi - sin * cos);
    let sc = 0.5 * sin * sin;
    // (cos eu + sin ew) (cos w - sin u_f)^T, integrated
    let a = eu * cc + ew * sc;
    let b = eu * sc + ew * ss;
    let (aw, bu) = (Symmetric::outer(a, w), Symmetric::outer(b, u_f));
    aw.zip(&bu, |aw, bu| length * (aw - bu))
}

/// Signed area of the spherical triangle of three unit vectors: positive if they turn
/// counter-clockwise seen from outside the sphere; in (-2 pi, 2 pi].
#[inline(always)]
#[must_use]
pub fn spherical_triangle(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    2.0 * atan2(a.dot(b.cross(c)), 1.0 + a.dot(b) + b.dot(c) + c.dot(a))
}

/// Area swept on the sphere between the trivial normals and the corrected normals of two
/// surfels f and g that share a linel: the quadrilateral n_f -> n_g -> u_g -> u_f.
///
/// Cut along the shorter diagonal; on a tie along n_f - u_g, so callers pass the surfel with the
/// lower number as f and take the negative for (g, f), which makes the area exactly antisymmetric.
/// Zero where u_f and u_g, or the ends of the diagonal, are opposite: the arc from u_f to u_g then
/// runs through n_f and n_g.
#[inline(always)]
#[must_use]
pub fn swept_area(n_f: DVec3, n_g: DVec3, u_f: DVec3, u_g: DVec3) -> f64 {
    let (from_f, from_g) = (n_f.dot(u_g), n_g.dot(u_f));
    if u_f.dot(u_g) < OPPOSITE || from_f.max(from_g) < OPPOSITE {
        0.0
    } else if from_f >= from_g {
        spherical_triangle(n_f, n_g, u_g) + spherical_triangle(n_f, u_g, u_f)
    } else {
        spherical_triangle(n_f, n_g, u_f) + spherical_triangle(n_g, u_g, u_f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn turned(angle: f64) -> DVec3 {
        DVec3::new(angle.sin(), 0.0, angle.cos())
    }

    #[test]
    fn the_trace_is_the_angle_times_the_length_along_the_axis() {
        for (i, angle) in [1e-9, 1e-3, 0.7, FRAC_PI_2, 2.5, PI - 1e-3]
            .into_iter()
            .enumerate()
        {
            let (u_f, u_g) = (turned(0.3), turned(0.3 + angle));
            // the rotation from u_f to u_g is about +y
            let e = DVec3::new(0.2 * i as f64, 1.0, 0.1).normalize();
            let trace = linel_tensor(u_f, u_g, e, 2.0).to_mat3();
            let trace = trace.x_axis.x + trace.y_axis.y + trace.z_axis.z;
            assert!(
                (trace - 2.0 * angle * e.y).abs() < 1e-14,
                "{angle}: {trace}"
            );
        }
    }

    #[test]
    fn a_convex_edge_bends_across_itself() {
        // the edge of a cube between +z and +x runs along +y on the boundary of +z
        let m = linel_tensor(DVec3::Z, DVec3::X, DVec3::Y, 1.0);
        assert!((m.yy).abs() < 1e-15 && (m.xx + m.zz - FRAC_PI_2).abs() < 1e-15);
        // the same edge seen from the other face
        let n = linel_tensor(DVec3::X, DVec3::Z, -DVec3::Y, 1.0);
        for (a, b) in m.terms().into_iter().zip(n.terms()) {
            assert!((a - b).abs() < 1e-15);
        }
    }

    #[test]
    fn an_octant_is_an_eighth_of_the_sphere() {
        let area = spherical_triangle(DVec3::X, DVec3::Y, DVec3::Z);
        assert!((area - FRAC_PI_2).abs() < 1e-15);
        assert!((spherical_triangle(DVec3::X, DVec3::Z, DVec3::Y) + FRAC_PI_2).abs() < 1e-15);
    }

    #[test]
    fn nothing_is_swept_when_u_is_n() {
        assert_eq!(swept_area(DVec3::X, DVec3::Y, DVec3::X, DVec3::Y), 0.0);
        assert_eq!(swept_area(DVec3::Z, DVec3::Z, DVec3::Z, DVec3::Z), 0.0);
    }
}
