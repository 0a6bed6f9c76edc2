//! The measures of a surfel on which `u` is not constant, as pure formulas.
//!
//! x runs over a rectangle, `x = s a e_s + t b e_t` with `e_s x e_t = n` and (s, t) in the unit
//! square; `u` is bilinear in the four normals of its corners, or that vector brought to unit
//! length. The forms of the paper (Definition 3.1, Proposition 3.5), pulled back to the square, are
//!
//! ```text
//! mu0      = det(x_s, x_t, u)
//! mu1      = det(u, x_s, u_t) + det(u, u_s, x_t)                     = trace of the tensor
//! mu2      = det(u, u_s, u_t)
//! tensor   = sym[ (x_t x u) u_s^T - (x_s x u) u_t^T ]                (minus mu^{X,Y}, Remark 3.7)
//! mu_Omega = <x_s, u_t> - <x_t, u_s>                                 = - circulation of u
//! ```
//!
//! with the signs of [`super::formula`]: a convex body has positive measures, mu1 is *twice* the
//! integral of H. On a surface with its own normal n, dn = S, the tensor is S: its eigenvalues are
//! 0, k1 and k2. On a linel, where `u` turns and x stands still, it is [`super::formula::linel_tensor`].
//!
//! mu_Omega is exact: d<u, dx> = -(dx ^ du), so it is minus the integral of <u, dx> along the sides,
//! counter-clockwise seen from outside, which has a closed form ([`circulation`]).
//!
//! Bilinear `u`: every form is a polynomial of degree 2 or less in s and in t, so 2 x 2 Gauss points are
//! exact. `u` of unit length: mu0 and the tensor by 4 x 4 Gauss points. Their error is below 1e-8 of
//! the area where neighbouring corners differ by at most 15 degrees, 2e-6 up to 30, 2e-3 up to 60
//! (a test has the figures); where the bilinear vector vanishes on the surfel the field is not
//! defined, and they mean nothing. mu2 is an area on the sphere, not a quadrature: see
//! [`super::field`].

use glam::DVec3;
use libm::{atanh, log};

use crate::symmetric::Symmetric;

/// Gauss points of two and four nodes on [0, 1], with their weights.
const GAUSS_2: [(f64, f64); 2] = [
    (0.5 - 0.288_675_134_594_812_9, 0.5),
    (0.5 + 0.288_675_134_594_812_9, 0.5),
];
const GAUSS_4: [(f64, f64); 4] = [
    (0.5 - 0.430_568_155_797_026_3, 0.173_927_422_568_726_92),
    (0.5 - 0.169_990_521_792_428_13, 0.326_072_577_431_273_07),
    (0.5 + 0.169_990_521_792_428_13, 0.326_072_577_431_273_07),
    (0.5 + 0.430_568_155_797_026_3, 0.173_927_422_568_726_92),
];

/// Square of a length below which a vector counts as zero, so that it has no direction.
const NO_LENGTH: f64 = 1e-24;

/// Bound of a term of the tensor of a surfel in voxel units. No field of unit vectors exceeds it, for its rows
/// are arcs of at most pi; a quadrature near a point where the bilinear vector vanishes could.
const LARGEST_TERM: f64 = 2.0 * std::f64::consts::PI;

/// A rectangle and the normals at its corners.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Side along s, in voxel units.
    pub x_s: DVec3,
    /// Side along t.
    pub x_t: DVec3,
    /// Unit normals at (s, t) = (0, 0), (1, 0), (1, 1), (0, 1): counter-clockwise seen from outside.
    pub u: [DVec3; 4],
}

/// Integrals over a patch, in voxel units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PatchMeasures {
    /// Corrected area.
    pub mu0: f64,
    /// The tensor, whose trace is mu1.
    pub tensor: Symmetric,
    /// The integral of det(u, u_s, u_t), a solid angle if `u` has unit length.
    pub mu2: f64,
}

impl Patch {
    /// Measures with `u` bilinear and not of unit length inside: exact but for rounding.
    #[must_use]
    pub fn linear(&self) -> PatchMeasures {
        self.integrate(&GAUSS_2, |u, u_s, u_t| (u, u_s, u_t))
    }

    /// Measures with `u` bilinear and then brought to unit length, by quadrature. Terms are kept
    /// within the bounds of a field without zeros.
    #[must_use]
    pub fn normalised(&self) -> PatchMeasures {
        let mut sums = self.integrate(&GAUSS_4, normalised);
        let within = |x: f64| x.clamp(-LARGEST_TERM, LARGEST_TERM);
        sums.tensor = Symmetric::from_terms(sums.tensor.terms().map(within));
        sums
    }

    fn integrate(
        &self,
        nodes: &[(f64, f64)],
        field: impl Fn(DVec3, DVec3, DVec3) -> (DVec3, DVec3, DVec3),
    ) -> PatchMeasures {
        let [u00, u10, u11, u01] = self.u;
        let area = self.x_s.cross(self.x_t);
        let mut sums = PatchMeasures::default();
        for &(t, weight_t) in nodes {
            // along the row, u runs from `from` to `to`
            let (from, to) = (u00 + (u01 - u00) * t, u10 + (u11 - u10) * t);
            for &(s, weight_s) in nodes {
                let (u, u_s, u_t) = field(
                    from + (to - from) * s,
                    to - from,
                    (u01 - u00) + ((u11 - u10) - (u01 - u00)) * s,
                );
                let weight = weight_s * weight_t;
                sums.mu0 += weight * area.dot(u);
                sums.mu2 += weight * u.dot(u_s.cross(u_t));
                let first = Symmetric::outer(self.x_t.cross(u), u_s);
                let second = Symmetric::outer(self.x_s.cross(u), u_t);
                let here = first.zip(&second, |a, b| a - b);
                sums.tensor = sums.tensor.zip(&here, |sum, x| sum + weight * x);
            }
        }
        sums
    }
}

/// A vector brought to unit length, with its derivatives; zeros where it has no direction.
fn normalised(v: DVec3, v_s: DVec3, v_t: DVec3) -> (DVec3, DVec3, DVec3) {
    let squared = v.length_squared();
    if squared < NO_LENGTH {
        return Default::default();
    }
    let length = squared.sqrt();
    let u = v / length;
    (
        u,
        (v_s - u * u.dot(v_s)) / length,
        (v_t - u * u.dot(v_t)) / length,
    )
}

/// The integral of <u, dx> along a side `e` (a vector, with its length) on which `u` goes from the unit
/// vector `a` to `b` on a straight line and has, if `normalised`, unit length.
///
/// With S the sine of half the angle from a to b, |(1 - t) a + t b|^2 = (1 - S^2) + 4 S^2 (t - 1/2)^2,
/// so the integral is <e, (a + b) / 2> times artanh(S) / S. Going back gives exactly the negative.
#[must_use]
pub fn circulation(e: DVec3, a: DVec3, b: DVec3, is_normalised: bool) -> f64 {
    let middle = (a + b) * 0.5;
    let straight = e.dot(middle);
    if !is_normalised {
        return straight;
    }
    let sine = 0.5 * (a - b).length();
    let cosine = middle.length();
    let stretch = if sine < 1e-8 || cosine * cosine < NO_LENGTH {
        1.0
    } else if sine < 0.5 {
        atanh(sine) / sine
    } else {
        log((1.0 + sine) / cosine) / sine
    };
    straight * stretch
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::formula::spherical_triangle;

    struct Random(u64);

    impl Random {
        fn next(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }

        fn vector(&mut self) -> DVec3 {
            DVec3::from_array([0; 3].map(|_| 2.0 * self.next() - 1.0))
        }

        /// A patch whose neighbouring normals differ by at most `angle` degrees.
        fn patch(&mut self, angle: f64) -> Patch {
            loop {
                let middle = self.vector().normalize();
                let u = [0; 4].map(|_| {
                    let v = self.vector();
                    (middle + angle.to_radians() * (v - middle * middle.dot(v))).normalize()
                });
                let patch = Patch {
                    x_s: DVec3::X * (0.2 + self.next()),
                    x_t: DVec3::Y * (0.2 + self.next()),
                    u,
                };
                let widest = (0..4).map(|i| u[i].angle_between(u[(i + 1) % 4]));
                let widest = widest.fold(0.0, f64::max);
                if widest <= angle.to_radians() {
                    return patch;
                }
            }
        }
    }

    /// Any field, by the midpoint rule on `n` x `n` points.
    fn brute(patch: &Patch, n: usize, is_normalised: bool) -> PatchMeasures {
        let nodes: Vec<_> = (0..n)
            .map(|i| ((i as f64 + 0.5) / n as f64, 1.0 / n as f64))
            .collect();
        patch.integrate(&nodes, |u, u_s, u_t| {
            if is_normalised {
                normalised(u, u_s, u_t)
            } else {
                (u, u_s, u_t)
            }
        })
    }

    /// Largest difference of mu0 and the terms of the tensor, per area.
    fn apart(patch: &Patch, a: &PatchMeasures, b: &PatchMeasures) -> f64 {
        let terms = a.tensor.terms().into_iter().zip(b.tensor.terms());
        let all = terms.chain([(a.mu0, b.mu0)]);
        all.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / patch.x_s.cross(patch.x_t).length()
    }

    /// The same nodes, on `n` x `n` parts of the square.
    fn refined(patch: &Patch, n: usize) -> PatchMeasures {
        let nodes: Vec<_> = (0..n)
            .flat_map(|i| GAUSS_4.map(|(s, weight)| ((i as f64 + s) / n as f64, weight / n as f64)))
            .collect();
        patch.integrate(&nodes, normalised)
    }

    #[test]
    fn two_by_two_points_are_exact_for_a_bilinear_field() {
        let mut random = Random(1);
        for _ in 0..500 {
            let patch = random.patch(90.0);
            let (two, four) = (
                patch.linear(),
                patch.integrate(&GAUSS_4, |u, u_s, u_t| (u, u_s, u_t)),
            );
            assert!(apart(&patch, &two, &four) < 1e-14 && (two.mu2 - four.mu2).abs() < 1e-14);
            let brute = brute(&patch, 40, false);
            assert!(apart(&patch, &two, &brute) < 2e-3 && (two.mu2 - brute.mu2).abs() < 2e-3);
        }
    }

    #[test]
    fn four_by_four_points_have_the_error_stated() {
        let mut random = Random(2);
        for (angle, bound) in [(5.0, 1e-12), (15.0, 1e-8), (30.0, 2e-6), (60.0, 2e-3)] {
            let mut largest = 0.0f64;
            for _ in 0..2000 {
                let patch = random.patch(angle);
                largest = largest.max(apart(&patch, &patch.normalised(), &refined(&patch, 4)));
            }
            println!("{angle} degrees: {largest:e}");
            assert!(largest < bound, "{angle} degrees: {largest:e}");
        }
    }

    #[test]
    fn mu2_of_unit_normals_is_the_area_of_the_spherical_quadrilateral() {
        let mut random = Random(3);
        for _ in 0..500 {
            let patch = random.patch(40.0);
            let [a, b, c, d] = patch.u;
            let area = spherical_triangle(a, b, c) + spherical_triangle(a, c, d);
            assert!((refined(&patch, 4).mu2 - area).abs() < 1e-10);
        }
    }

    #[test]
    fn the_trace_of_the_tensor_is_mu1_and_circulation_is_minus_mu_omega() {
        let mut random = Random(4);
        for _ in 0..300 {
            let patch = random.patch(50.0);
            let [u00, u10, u11, u01] = patch.u;
            for is_normalised in [false, true] {
                let (mut mu1, mut omega) = (0.0, 0.0);
                let nodes: Vec<_> = (0..4)
                    .flat_map(|i| GAUSS_4.map(|(s, w)| ((f64::from(i) + s) / 4.0, w / 4.0)))
                    .collect();
                for &(t, wt) in &nodes {
                    for &(s, ws) in &nodes {
                        let (from, to) = (u00 + (u01 - u00) * t, u10 + (u11 - u10) * t);
                        let (low, high) = (u00 + (u10 - u00) * s, u01 + (u11 - u01) * s);
                        let v = (from + (to - from) * s, to - from, high - low);
                        let (u, u_s, u_t) = if is_normalised {
                            normalised(v.0, v.1, v.2)
                        } else {
                            v
                        };
                        mu1 += ws * wt * u.dot(patch.x_s.cross(u_t) + u_s.cross(patch.x_t));
                        omega += ws * wt * (patch.x_s.dot(u_t) - patch.x_t.dot(u_s));
                    }
                }
                let tensor = if is_normalised {
                    refined(&patch, 4).tensor
                } else {
                    patch.linear().tensor
                };
                assert!((tensor.xx + tensor.yy + tensor.zz - mu1).abs() < 1e-10);
                let sides = [
                    (patch.x_s, u00, u10),
                    (patch.x_t, u10, u11),
                    (-patch.x_s, u11, u01),
                    (-patch.x_t, u01, u00),
                ];
                let around: f64 = sides
                    .iter()
                    .map(|&(e, a, b)| circulation(e, a, b, is_normalised))
                    .sum();
                assert!((around + omega).abs() < 1e-10, "{around} {omega}");
                for (e, a, b) in sides {
                    let (there, back) = (
                        circulation(e, a, b, is_normalised),
                        circulation(-e, b, a, is_normalised),
                    );
                    assert_eq!(there, -back);
                }
            }
        }
    }

    #[test]
    fn a_small_tangent_patch_has_the_principal_curvatures_of_its_surface() {
        use crate::symmetric::eigen;
        // z = (k1 x^2 + k2 y^2) / 2, turned by an angle; corners have its exact normals
        let (k1, k2, h) = (-0.4, 0.7, 1e-3);
        let (c, s) = (0.8, 0.6);
        let normal = |x: f64, y: f64| {
            let (p, q) = (c * x + s * y, -s * x + c * y);
            let (gp, gq) = (k1 * p, k2 * q);
            DVec3::new(gp * c - gq * s, gp * s + gq * c, 1.0).normalize()
        };
        let corners = [(0.0, 0.0), (h, 0.0), (h, h), (0.0, h)];
        let patch = Patch {
            x_s: DVec3::X * h,
            x_t: DVec3::Y * h,
            u: corners.map(|(x, y)| normal(x - 0.5 * h, y - 0.5 * h)),
        };
        for m in [patch.linear(), patch.normalised()] {
            let values = eigen(&m.tensor).values.map(|v| v / m.mu0);
            for (found, expected) in values.into_iter().zip([k1, 0.0, k2]) {
                assert!((found - expected).abs() < 1e-6, "{values:?}");
            }
            assert!((m.mu2 / m.mu0 - k1 * k2).abs() < 1e-6);
        }
    }

    #[test]
    fn terms_stay_within_their_bound_where_the_field_vanishes() {
        let (x_s, x_t) = (DVec3::X, DVec3::Y);
        let up = DVec3::new(0.6, 0.0, 0.8);
        for u in [[up, -up, up, -up], [up, up, -up, -up], [up, -up, -up, up]] {
            let m = Patch { x_s, x_t, u }.normalised();
            assert!(m.mu0.abs() <= 1.0);
            assert!(m.tensor.terms().iter().all(|t| t.abs() <= LARGEST_TERM));
        }
        assert_eq!(circulation(x_s, up, -up, true), 0.0);
    }
}
