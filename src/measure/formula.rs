//! The measures of a surfel, a linel and a pointel as pure formulas.
//!
//! Signs: normals point outward and a convex body has positive mean curvature, so mu1 of a convex
//! edge is positive. (The paper's Definition 3.4 has the opposite sign of H.) mu1 integrates to
//! *twice* the integral of H: H = mu1 / (2 mu0), and G = mu2 / mu0.
//!
//! Angles are taken by the arc tangent of two arguments, never the arc sine, so they reach pi.
//!
//! There are no branches and no calls, so that a loop over many linels becomes a loop over vectors of them, with the same bits:
//! where something is undefined, what was computed is not chosen.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use glam::DVec3;

use crate::symmetric::Symmetric;

/// Normals whose scalar product is below this count as opposite: within 2e-6 of a half turn, where the
/// arc between them is rounding noise. There the paper's condition (ii) of a corrected normal
/// field fails; for mu2 the arc is taken through the trivial normals, and mu1 is 0.
pub(crate) const OPPOSITE: f64 = -1.0 + 2e-12;

/// Two normals whose cross product is shorter than this count as parallel; the rotation axis
/// between them would be rounding noise, and their measure is below it.
const PARALLEL: f64 = 1e-12;

/// The tangent of pi / 8.
const TAN_PI_8: f64 = 0.414_213_562_373_095_03;

/// The arc tangent of t is t - t^3 (A0 + A1 t^2 + ..) up to the tangent of pi / 8, to 2^-58 of itself (the minimax polynomial
/// of FreeBSD's msun).
const ARC_TANGENT: [f64; 11] = [
    0.333_333_333_333_329_3,
    -0.199_999_999_998_764_83,
    0.142_857_142_725_034_66,
    -0.111_111_104_054_623_56,
    0.090_908_871_334_365_07,
    -0.076_918_762_050_448_3,
    0.066_610_731_373_875_31,
    -0.058_335_701_337_905_735,
    0.049_768_779_946_159_324,
    -0.036_531_572_744_216_916,
    0.016_285_820_115_365_782,
];

/// The angle of the point (x, y) from the x axis, from -pi to pi, right to 2^-51 of itself. On the
/// negative x axis it is pi, whatever the sign of `y`, and at the origin 0.
#[inline(always)]
#[must_use]
pub(crate) fn angle(y: f64, x: f64) -> f64 {
    let (across, along) = (y.abs(), x.abs());
    let steep = across > along;
    let short = if steep { along } else { across };
    let long = if steep { across } else { along };
    // past pi / 8, the tangent of what is missing to pi / 4
    let wide = short > TAN_PI_8 * long;
    let top = if wide { short - long } else { short };
    let bottom = if wide { short + long } else { long };
    let t = top / if bottom == 0.0 { 1.0 } else { bottom };
    let a = &ARC_TANGENT;
    let (z, w) = (t * t, (t * t) * (t * t));
    let even = z * (a[0] + w * (a[2] + w * (a[4] + w * (a[6] + w * (a[8] + w * a[10])))));
    let odd = w * (a[1] + w * (a[3] + w * (a[5] + w * (a[7] + w * a[9]))));
    let angle = t - t * (even + odd);
    let angle = if wide { FRAC_PI_4 + angle } else { angle };
    let angle = if steep { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

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
    let undefined = (sin < PARALLEL) | (cos < OPPOSITE);
    let length = if undefined { 0.0 } else { length };
    let psi = angle(sin, cos);
    let e1 = cross * (1.0 / if undefined { 1.0 } else { sin });
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
    Symmetric {
        xx: length * (aw.xx - bu.xx),
        yy: length * (aw.yy - bu.yy),
        zz: length * (aw.zz - bu.zz),
        xy: length * (aw.xy - bu.xy),
        xz: length * (aw.xz - bu.xz),
        yz: length * (aw.yz - bu.yz),
    }
}

/// Signed area of the spherical triangle of three unit vectors: positive if they turn
/// counter-clockwise seen from outside the sphere; in (-2 pi, 2 pi].
#[inline(always)]
#[must_use]
pub fn spherical_triangle(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    2.0 * angle(a.dot(b.cross(c)), 1.0 + a.dot(b) + b.dot(c) + c.dot(a))
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
    let undefined = (u_f.dot(u_g) < OPPOSITE) | ((from_f < OPPOSITE) & (from_g < OPPOSITE));
    let (from, to) = if from_f >= from_g {
        (n_f, u_g)
    } else {
        (n_g, u_f)
    };
    let area = spherical_triangle(n_f, n_g, to) + spherical_triangle(from, u_g, u_f);
    if undefined { 0.0 } else { area }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::numbers;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn angles_are_those_of_libm() {
        let special = [
            0.0,
            f64::MIN_POSITIVE,
            1e-300,
            1e-17,
            1e-8,
            TAN_PI_8,
            0.5,
            1.0 - f64::EPSILON / 2.0,
            1.0,
            1.0 + f64::EPSILON,
            1e8,
            1e300,
        ];
        let mut random = numbers(3);
        let mut points: Vec<[f64; 2]> = special
            .iter()
            .flat_map(|&y| special.map(|x| [[y, x], [y, -x], [-y, x], [-y, -x]]))
            .flatten()
            .collect();
        for size in [1.0, 1e-3, 1e-9] {
            points.extend((0..100_000).map(|_| [size * random(), random()]));
            points.extend((0..100_000).map(|_| [random(), size * random()]));
        }
        for [y, x] in points {
            let (found, expected) = (angle(y, x), libm::atan2(y, x));
            if y == 0.0 {
                assert_eq!(found, if x < 0.0 { PI } else { 0.0 });
                continue;
            }
            let unit = f64::EPSILON * expected.abs();
            assert!(
                (found - expected).abs() <= 2.0 * unit,
                "{y:e} {x:e}: {found:e} {expected:e}"
            );
            assert_eq!(angle(-y, x), -found);
        }
        for (y, x) in [(f64::NAN, 1.0), (1.0, f64::NAN)] {
            assert!(angle(y, x).is_nan());
        }
    }

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
