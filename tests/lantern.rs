//! Schwarz's lantern (Lachaud, Romon, Thibert, *Corrected curvature measures*, section 3.3): area, mean
//! and Gaussian curvature of a cylinder from a polyhedron whose area and normals do not converge.
//!
//! With u constant on triangles everything is as the paper says. With u interpolated, mu1 = 2 pi h and mu2 = 0
//! hold exactly, but two statements of the paper hold in the limit n -> infinity only, or not at all:
//!
//! * mu0 is not the area 2 pi r h of the cylinder. u is radial, so <u, n> dH2 is |p| dtheta dz, with |p| <= r the
//!   distance from the axis, and not r dtheta dz. mu0 does not depend on m, and is
//!   2 pi r h (1 - O(1/n^2)).
//! * mu1 is not (2 / r) mu0: u turns along the circles alone, so mu1 = dtheta dz = mu0 / |p|. In the
//!   limit mu1 = mu0 / r, which is twice the integral of H = 1 / (2 r), as it should.
//!
//! With u linear, not made a unit vector, mu1 = mu0 / r holds exactly.

use std::f64::consts::{PI, TAU};

use curvox::measure::field::Field;
use curvox::mesh::{MeshTotals, NormalSource};
use curvox_tools::meshes::{Polyhedron, lantern};

use crate::mesh::{Measured, measured};

const CASES: [(u32, u32, f64, f64); 6] = [
    (1, 3, 1.0, 1.0),
    (6, 7, 1.0, 2.0),
    (5, 12, 3.0, 0.5),
    (40, 9, 0.1, 7.0),
    (120, 8, 2.0, 1.0),
    (64, 64, 10.0, 25.0),
];

fn close(found: f64, expected: f64, tolerance: f64, what: &str) {
    assert!(
        (found - expected).abs() <= tolerance * expected.abs(),
        "{what}: {found}, not {expected}"
    );
}

fn constant(mesh: &Polyhedron) -> Measured {
    let mut given = mesh.clone();
    given.normals.clear();
    measured(&given, NormalSource::Given, Field::Constant)
}

fn interpolated(mesh: &Polyhedron) -> Measured {
    let mut given = mesh.clone();
    given.face_normals = None;
    measured(&given, NormalSource::Given, Field::Interpolated)
}

/// mu0 with u interpolated: 2 m n times the integral of |p| dtheta dz over a triangle. At a height t
/// of its band the triangle is a segment at distance c from the axis, half as long as
/// r (1 - t) sin(pi/n), along which |p| dtheta = c ds / |p|.
fn interpolated_area(n: u32, r: f64, h: f64) -> f64 {
    let (sin, cos) = (PI / f64::from(n)).sin_cos();
    let segment = |t: f64| {
        let c = (1.0 - t) * cos + t;
        2.0 * c * ((1.0 - t) * sin / c).asinh()
    };
    // Simpson's rule; the integrand is smooth.
    let steps = 2000;
    let sum: f64 = (0..=steps)
        .map(|i| {
            let weight = match i {
                0 => 1.0,
                i if i == steps => 1.0,
                i if i % 2 == 1 => 4.0,
                _ => 2.0,
            };
            weight * segment(f64::from(i) / f64::from(steps))
        })
        .sum();
    2.0 * f64::from(n) * r * h * sum / (3.0 * f64::from(steps))
}

#[test]
fn with_u_of_the_cylinder_on_each_triangle_mu1_and_mu2_are_exact() {
    for (m, n, r, h) in CASES {
        let lantern = constant(&lantern(m, n, r, h));
        let MeshTotals { mu0, mu1, mu2, .. } = lantern.totals;
        let what = format!("m = {m}, n = {n}");
        close(
            mu0,
            2.0 * f64::from(n) * r * h * (PI / f64::from(n)).sin(),
            1e-12,
            &what,
        );
        close(mu1, TAU * h, 1e-12, &what);
        assert!(mu2.abs() < 1e-12 * f64::from(m * n), "{what}: {mu2}");
        assert_eq!(lantern.totals.sum_abs_k, 0.0, "{what}");
        // The edges at the rims have one face, so no measure.
        assert_eq!(lantern.surface.defects.border_edges, u64::from(2 * n));
        assert_eq!(lantern.totals.euler_counted, 0);
        assert_eq!(lantern.totals.euler_gauss_bonnet, None);
    }
}

#[test]
fn the_angle_between_u_and_the_faces_is_the_papers() {
    for (m, n, r, h) in CASES {
        let lantern = constant(&lantern(m, n, r, h));
        let tangent = 2.0 * f64::from(m) * r / h * (0.5 * PI / f64::from(n)).sin().powi(2);
        for (u, normal) in lantern.field.of_face.iter().zip(&lantern.surface.normal) {
            let cos = u.dot(*normal);
            close(u.cross(*normal).length() / cos, tangent, 1e-11, "tangent");
        }
    }
}

#[test]
fn the_naive_area_grows_without_bound_and_the_corrected_area_does_not() {
    let (n, r, h) = (12, 1.0, 1.0);
    let mut last = 0.0;
    for m in [1, 10, 100, 1000] {
        let lantern = constant(&lantern(m, n, r, h));
        let naive = lantern.totals.naive_area;
        let (sin, slope) = (
            (PI / f64::from(n)).sin(),
            2.0 * f64::from(m) * r / h * (0.5 * PI / f64::from(n)).sin().powi(2),
        );
        let expected = 2.0 * f64::from(n) * r * h * sin * (1.0 + slope * slope).sqrt();
        close(naive, expected, 1e-11, "naive area");
        assert!(naive > last);
        last = naive;
        close(lantern.totals.mu0, 2.0 * f64::from(n) * sin, 1e-12, "mu0");
    }
    assert!(last > 30.0 * TAU * r * h, "{last}");
}

#[test]
fn the_corrected_area_converges_as_1_over_n_squared() {
    for field in [constant as fn(&Polyhedron) -> Measured, interpolated] {
        let errors = [8, 16, 32].map(|n| {
            let mu0 = field(&lantern(3, n, 1.0, 1.0)).totals.mu0;
            assert!(mu0 < TAU);
            TAU - mu0
        });
        for pair in errors.windows(2) {
            assert!((3.8..4.2).contains(&(pair[0] / pair[1])), "{errors:?}");
        }
    }
}

#[test]
fn with_interpolated_u_mu1_is_exact_and_mu0_is_that_of_the_radial_field() {
    for (m, n, r, h) in CASES {
        let lantern = interpolated(&lantern(m, n, r, h));
        let MeshTotals { mu0, mu1, mu2, .. } = lantern.totals;
        let what = format!("m = {m}, n = {n}");
        close(mu0, interpolated_area(n, r, h), 1e-12, &what);
        close(mu1, TAU * h, 1e-12, &what);
        assert!(mu2.abs() < 1e-12, "{what}: {mu2}");
        assert!(lantern.totals.euler_gauss_bonnet.is_none());
    }
}

#[test]
fn with_interpolated_u_mu0_does_not_depend_on_m() {
    let mu0 = [1, 2, 7, 50, 300].map(|m| interpolated(&lantern(m, 9, 2.0, 3.0)).totals.mu0);
    for other in &mu0[1..] {
        close(*other, mu0[0], 1e-12, "mu0");
    }
}

#[test]
fn with_interpolated_u_mu1_lies_between_mu0_over_r_and_mu0_over_the_least_distance() {
    // On every face, not in sum alone: the paper's 2 / r would be twice as much.
    let (m, n, r) = (20, 11, 3.0);
    let lantern = interpolated(&lantern(m, n, r, 4.0));
    let least = r * (PI / f64::from(n)).cos();
    for face in &lantern.measures.faces {
        let ratio = face.mu1() / face.mu0;
        assert!((1.0 / r..1.0 / least).contains(&ratio), "{ratio}");
        assert!(face.omega.abs() < 1e-2 * face.mu0);
    }
}

#[test]
fn with_linear_u_the_curvatures_of_the_cylinder_are_exact_on_every_face() {
    // u = (x, y) / r wherever a point of the lantern lies: mu1 = mu0 / r, whatever the ball.
    for (m, n, r, h) in CASES {
        let mut given = lantern(m, n, r, h);
        given.face_normals = None;
        let lantern = measured(&given, NormalSource::Given, Field::Linear);
        close(lantern.totals.mu1, lantern.totals.mu0 / r, 1e-12, "mu1");
        assert!(lantern.totals.mu2.abs() < 1e-12);
        for (f, sums) in lantern.sums(0.3 * r).iter().enumerate().step_by(7) {
            let c = sums.curvature(lantern.field.of_face[f]).unwrap();
            close(c.mean, 0.5 / r, 1e-12, "H");
            assert!(c.gaussian.abs() < 1e-12 / (r * r), "{c:?}");
        }
    }
}

#[test]
fn curvatures_of_faces_are_those_of_the_cylinder() {
    let (m, n, r, h) = (60, 40, 1.0, 2.0);
    let mesh = lantern(m, n, r, h);
    for (lantern, tolerance) in [(constant(&mesh), 0.05), (interpolated(&mesh), 0.004)] {
        let radius = 0.5;
        let sums = lantern.sums(radius);
        let mut inner = 0;
        for (f, sums) in sums.iter().enumerate() {
            let z = lantern.surface.centroid[f].z;
            // The rims: an edge as wide as a triangle may reach into the ball.
            if (radius + 0.1..h - radius - 0.1).contains(&z) {
                assert!(!sums.border && !sums.several_sheets && !sums.island);
                let c = sums.curvature(lantern.field.of_face[f]).unwrap();
                assert!((c.mean - 0.5 / r).abs() < tolerance, "{c:?}");
                assert!(c.gaussian.abs() < 1e-10, "{c:?}");
                // u turns within the ball, by up to radius / r: a part of the tensor is along the u in its middle.
                let turned = 0.3 * (radius / r).powi(2);
                assert!(c.k1.abs() < tolerance, "{c:?}");
                assert!((c.k2 - 1.0 / r).abs() < tolerance + turned, "{c:?}");
                assert!(c.d1.z.abs() > 0.99, "{c:?}");
                inner += 1;
            } else if z < 0.5 * radius {
                assert!(sums.border);
            }
        }
        assert!(inner > 1000);
    }
}

#[test]
fn naive_normals_of_a_lantern_are_no_good() {
    // m = n^2: the faces stand at a fixed angle to the cylinder, however fine the lantern.
    let lantern = lantern(144, 12, 1.0, 1.0);
    let naive = measured(&lantern, NormalSource::Faces, Field::Constant).totals;
    assert!(naive.mu0 > 2.0 * TAU, "{}", naive.mu0);
    let corrected = constant(&lantern).totals;
    assert!(corrected.mu0 < TAU);
}
