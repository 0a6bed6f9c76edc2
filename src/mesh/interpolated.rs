//! Measures of a triangle under a normal field interpolated between its corners.
//!
//! Comes in: the corners x and the vectors w there. Goes out: [`FaceMeasure`]. With the triangle
//! as x(s, t) = x0 + s (x1 - x0) + t (x2 - x0), subscripts for derivatives, and u the field, the forms
//! of the paper's Definition 3.1, pulled back, are
//!
//! ```text
//! mu0      = <u, x_s x x_t>
//! M        = sym[(x_t x u) u_s^T - (x_s x u) u_t^T],   mu1 = tr M = <u, x_s x u_t + u_s x x_t>
//! mu2      = <u, u_s x u_t>
//! mu_Omega = <x_s, u_t> - <x_t, u_s>
//! ```
//!
//! with our sign: on a sphere with u outward, mu1 is 2/R mu0. A continuous field has no measures
//! on edges and vertices.
//!
//! **Linear**, u = w: all but u are constant, so mu0, M and mu_Omega are those of the mean of w,
//! and mu2 is half the determinant of w0, w1, w2.
//! **Unit**, u = w / |w|: mu2 is the area of a spherical triangle; the others are integrals of smooth
//! functions, by Gauss quadrature of rising order until two orders agree, in quarters of the triangle
//! where that does not come about. Guaranteed there: 1e-13 of the size of the triangle, unless w comes
//! near zero, where no direction is defined.

use std::sync::OnceLock;

use glam::DVec3;

use crate::measure::formula::spherical_triangle;
use crate::symmetric::Symmetric;

/// What a face carries.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaceMeasure {
    /// Corrected area.
    pub mu0: f64,
    /// The tensor whose trace is mu1.
    pub tensor: Symmetric,
    /// A solid angle.
    pub mu2: f64,
    /// mu_Omega, a length.
    pub omega: f64,
}

impl FaceMeasure {
    /// Adds a share of another measure.
    pub fn add(&mut self, other: &Self, share: f64) {
        self.mu0 += share * other.mu0;
        self.tensor = self.tensor.zip(&other.tensor, |a, b| a + share * b);
        self.mu2 += share * other.mu2;
        self.omega += share * other.omega;
    }

    /// mu1.
    #[must_use]
    pub fn mu1(&self) -> f64 {
        self.tensor.xx + self.tensor.yy + self.tensor.zz
    }
}

/// Measures of a triangle whose field is linear between `w` at its corners.
#[must_use]
pub fn linear_triangle(x: [DVec3; 3], w: [DVec3; 3]) -> FaceMeasure {
    let [x_s, x_t] = [x[1] - x[0], x[2] - x[0]];
    let [w_s, w_t] = [w[1] - w[0], w[2] - w[0]];
    let mut measure = density(x_s, x_t, (w[0] + w[1] + w[2]) / 3.0, w_s, w_t);
    measure.mu2 = w[0].dot(w[1].cross(w[2]));
    let mut half = FaceMeasure::default();
    half.add(&measure, 0.5);
    half
}

/// Measures of a triangle whose field is linear between the unit vectors `u` at its corners, then
/// made a unit vector.
#[must_use]
pub fn unit_triangle(x: [DVec3; 3], u: [DVec3; 3]) -> FaceMeasure {
    let mut measure = integral(x, u, 0);
    measure.mu2 = spherical_triangle(u[0], u[1], u[2]);
    measure
}

/// mu0, M and mu_Omega in the parameters s, t.
fn density(x_s: DVec3, x_t: DVec3, u: DVec3, u_s: DVec3, u_t: DVec3) -> FaceMeasure {
    let first = Symmetric::outer(x_t.cross(u), u_s);
    let second = Symmetric::outer(x_s.cross(u), u_t);
    FaceMeasure {
        mu0: u.dot(x_s.cross(x_t)),
        tensor: first.zip(&second, |a, b| a - b),
        mu2: 0.0,
        omega: x_s.dot(u_t) - x_t.dot(u_s),
    }
}

/// Points a side of the rules, in the order they are tried.
const ORDERS: [usize; 8] = [3, 5, 7, 10, 14, 19, 25, 32];

/// Two orders agree if they differ by less than this share of the triangle's size: some tens of
/// roundings. Less is never reached; more would show in totals of machine precision.
const AGREE: f64 = 4e-15;

/// How often a triangle is quartered before its integral is taken as it is: the field then has a
/// place without direction in it.
const MOST_CUTS: u32 = 6;

fn integral(x: [DVec3; 3], w: [DVec3; 3], cuts: u32) -> FaceMeasure {
    let [x_s, x_t] = [x[1] - x[0], x[2] - x[0]];
    let [w_s, w_t] = [w[1] - w[0], w[2] - w[0]];
    let at = |s: f64, t: f64| {
        let v = w[0] + w_s * s + w_t * t;
        let length = v.length();
        if length == 0.0 {
            return FaceMeasure::default();
        }
        let u = v / length;
        let [u_s, u_t] = [w_s, w_t].map(|d| (d - u * u.dot(d)) / length);
        density(x_s, x_t, u, u_s, u_t)
    };
    let mut last: Option<FaceMeasure> = None;
    for (rule, _) in rules().iter().zip(ORDERS) {
        let mut sum = FaceMeasure::default();
        // In s and t = b (1 - s) the triangle is a square.
        for &(s, weight) in rule {
            for &(b, weight_b) in rule {
                sum.add(&at(s, b * (1.0 - s)), weight * weight_b * (1.0 - s));
            }
        }
        if let Some(last) = last
            && agree(&sum, &last, x_s, x_t)
        {
            return sum;
        }
        last = Some(sum);
    }
    if cuts == MOST_CUTS {
        return last.unwrap_or_default();
    }
    let half = |v: [DVec3; 3]| {
        [
            (v[0] + v[1]) * 0.5,
            (v[1] + v[2]) * 0.5,
            (v[2] + v[0]) * 0.5,
        ]
    };
    let (mx, mw) = (half(x), half(w));
    let mut sum = FaceMeasure::default();
    for i in 0..3 {
        let j = (i + 2) % 3;
        sum.add(
            &integral([x[i], mx[i], mx[j]], [w[i], mw[i], mw[j]], cuts + 1),
            1.0,
        );
    }
    sum.add(&integral(mx, mw, cuts + 1), 1.0);
    sum
}

fn agree(a: &FaceMeasure, b: &FaceMeasure, x_s: DVec3, x_t: DVec3) -> bool {
    let area = x_s.cross(x_t).length();
    let length = x_s.length() + x_t.length();
    let terms = a.tensor.terms().into_iter().zip(b.tensor.terms());
    (a.mu0 - b.mu0).abs() <= AGREE * area
        && (a.omega - b.omega).abs() <= AGREE * length
        && terms
            .into_iter()
            .all(|(a, b)| (a - b).abs() <= AGREE * length)
}

/// Points in [0, 1] and weights of the Gauss-Legendre rules of [`ORDERS`].
fn rules() -> &'static [Vec<(f64, f64)>; 8] {
    static RULES: OnceLock<[Vec<(f64, f64)>; 8]> = OnceLock::new();
    RULES.get_or_init(|| ORDERS.map(gauss_legendre))
}

/// The points where the Legendre polynomial of degree n is zero, by Newton's method.
fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    let legendre = |x: f64| {
        let (mut p, mut before) = (x, 1.0);
        for k in 2..=n {
            let k = k as f64;
            (p, before) = (((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k, p);
        }
        // The value and the derivative.
        (p, n as f64 * (x * p - before) / (x * x - 1.0))
    };
    (0..n)
        .map(|i| {
            let angle = std::f64::consts::PI * (i as f64 + 0.75) / (n as f64 + 0.5);
            let mut x = libm::cos(angle);
            // Quadratic from a start that is good to three digits.
            for _ in 0..6 {
                let (value, slope) = legendre(x);
                x -= value / slope;
            }
            let slope = legendre(x).1;
            let weight = 2.0 / ((1.0 - x * x) * slope * slope);
            (0.5 * (1.0 - x), 0.5 * weight)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauss_rules_integrate_polynomials_of_their_degree() {
        for (rule, n) in rules().iter().zip(ORDERS) {
            for degree in 0..2 * n {
                let sum: f64 = rule.iter().map(|(x, w)| w * x.powi(degree as i32)).sum();
                let exact = 1.0 / (degree as f64 + 1.0);
                assert!((sum - exact).abs() < 1e-15, "{n} {degree}: {sum}");
            }
        }
    }

    #[test]
    fn on_a_sphere_mu1_is_two_over_the_radius_times_mu0() {
        // u = x / R: then x_s = R u_s along the sphere, and linear u is x / R in the triangle, too
        let radius = 3.0;
        let u = [
            DVec3::new(1.0, 0.1, 0.2).normalize(),
            DVec3::new(0.7, 0.6, 0.1).normalize(),
            DVec3::new(0.8, 0.2, 0.7).normalize(),
        ];
        let x = u.map(|u| u * radius);
        let linear = linear_triangle(x, u);
        assert!((linear.mu1() - 2.0 / radius * linear.mu0).abs() < 1e-15);
        assert!((linear.mu2 - linear.mu0 / (radius * radius)).abs() < 1e-15);
        assert!(linear.omega.abs() < 1e-15);
        let unit = unit_triangle(x, u);
        assert!(unit.omega.abs() < 1e-14, "{}", unit.omega);
        // du is the projection off u, over |x|: symmetric, so M is as well, and M u = 0 only on average
        let sphere = spherical_triangle(u[0], u[1], u[2]);
        assert!((unit.mu2 - sphere).abs() < 1e-15);
        assert!(unit.mu0 < sphere * radius * radius && unit.mu1() > 2.0 / radius * unit.mu0);
    }

    #[test]
    fn unit_and_linear_fields_agree_on_small_triangles() {
        let mut gaps = [0.0; 2];
        for (gap, h) in gaps.iter_mut().zip([1e-2, 1e-3]) {
            let x = [
                DVec3::ZERO,
                DVec3::new(h, 0.2 * h, 0.0),
                DVec3::new(0.0, h, 0.3 * h),
            ];
            let u = x.map(|x| (DVec3::Z + x * 0.7 + DVec3::new(x.y, x.z, x.x) * 0.2).normalize());
            let (a, b) = (unit_triangle(x, u), linear_triangle(x, u));
            *gap = (a.mu0 / b.mu0 - 1.0)
                .abs()
                .max((a.mu1() / b.mu1() - 1.0).abs());
        }
        assert!(gaps[0] < 1e-3 && gaps[1] < 2e-2 * gaps[0], "{gaps:?}");
    }

    #[test]
    fn omega_is_a_boundary_integral() {
        // mu_Omega = - integral of <u, dx> around the triangle
        let x = [
            DVec3::ZERO,
            DVec3::new(2.0, 0.2, 0.0),
            DVec3::new(0.0, 1.0, 0.3),
        ];
        let u = [
            DVec3::new(0.1, 0.2, 1.0).normalize(),
            DVec3::new(-0.5, 0.8, 0.9).normalize(),
            DVec3::new(0.7, 0.1, 0.6).normalize(),
        ];
        let mut around = 0.0;
        for i in 0..3 {
            let j = (i + 1) % 3;
            for &(t, weight) in &rules()[7] {
                let v = u[i] * (1.0 - t) + u[j] * t;
                around += weight * v.normalize().dot(x[j] - x[i]);
            }
        }
        assert!((unit_triangle(x, u).omega + around).abs() < 1e-14);
    }
}
