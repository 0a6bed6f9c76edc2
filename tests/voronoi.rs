//! Normals by the Voronoi covariance measure.

use curvox::measure::ball::Weights;
use curvox::normal::Estimator;
use curvox::normal::vcm::Side;
use curvox::pipeline::Settings;
use curvox_tools::goursat;
use curvox_tools::npz::Table;
use curvox_tools::plain::Solid;
use glam::DVec3;

use crate::common::{FullRow, lattice, whole};
use crate::reference::folder;

fn rows(solid: &Solid, spacing: [f64; 3], [voronoi_radius, radius]: [f64; 2]) -> Vec<FullRow> {
    let settings = Settings {
        estimator: Estimator::VoronoiCovariance {
            voronoi_radius,
            radius,
            side: Side::Surface,
        },
        ..Settings::new(lattice(solid, spacing, false))
    };
    whole(solid, &settings).rows
}

fn trivial(k: [i32; 3], solid: &Solid) -> DVec3 {
    let axis = (0..3).find(|&a| k[a] % 2 == 0).unwrap();
    let inside = solid.is_inside(k.map(|k| k.div_euclid(2)));
    let mut n = DVec3::ZERO;
    n[axis] = if inside { -1.0 } else { 1.0 };
    n
}

#[test]
fn voronoi_normals_of_a_plane_along_the_grid_are_its_normal() {
    let solid = Solid::from_fn([20, 14, 16], |p| p[2] < 8);
    for spacing in [[1.0; 3], [1.0, 0.5, 0.7]] {
        for row in rows(&solid, spacing, [5.0, 2.0]) {
            assert!((row.u - DVec3::Z).length() < 1e-12, "{:?} {}", row.k, row.u);
        }
    }
}

#[test]
fn voronoi_normals_of_an_oblique_plane_are_near_its_normal() {
    let normal = DVec3::new(0.28, -0.46, 1.0).normalize();
    for spacing in [[1.0; 3], [1.0, 0.8, 0.6]] {
        let solid = Solid::from_fn([60, 60, 60], |p| {
            let x = DVec3::from_array([0, 1, 2].map(|a| f64::from(p[a] - 30) * spacing[a]));
            x.dot(normal) < 0.1
        });
        let middle = rows(&solid, spacing, [10.0, 4.0])
            .into_iter()
            .filter(|row| row.k.iter().all(|k| (50..70).contains(k)));
        let mut seen = 0;
        for row in middle {
            let angle = row.u.dot(normal).min(1.0).acos().to_degrees();
            assert!(angle < 1.5, "{:?} {angle} degrees", row.k);
            seen += 1;
        }
        assert!(seen > 50);
    }
}

#[test]
fn both_sides_of_a_thin_plate_point_out() {
    for thick in [1, 2] {
        let solid = Solid::from_fn([24, 24, 16], |p| {
            (0..2).all(|a| (2..22).contains(&p[a])) && (7..7 + thick).contains(&p[2])
        });
        for row in rows(&solid, [1.0; 3], [8.0, 3.0]) {
            let n = trivial(row.k, &solid);
            let inner = row.k[..2].iter().all(|k| (12..36).contains(k));
            if inner && n.z != 0.0 {
                assert!(row.u.dot(n) > 0.9, "{thick} {:?} {}", row.k, row.u);
            }
        }
    }
}

#[test]
fn a_lone_voxel_has_its_trivial_normals() {
    let solid = Solid::from_fn([9, 9, 9], |p| p == [4, 4, 4]);
    for radii in [[4.0, 2.0], [0.5, 0.5]] {
        for row in rows(&solid, [1.0; 3], radii) {
            let n = trivial(row.k, &solid);
            assert!((row.u - n).length() < 1e-9, "{:?} {} {n}", row.k, row.u);
        }
    }
}

/// Root mean square and largest.
fn norms(errors: impl Iterator<Item = f64>) -> [f64; 2] {
    let (mut count, mut squares, mut largest) = (0, 0.0, 0.0f64);
    for error in errors {
        assert!(!error.is_nan());
        count += 1;
        squares += error * error;
        largest = largest.max(error.abs());
    }
    [(squares / f64::from(count)).sqrt(), largest]
}

/// DGtal's conventions give DGtal's normals; ours, which share ties, serve as well.
#[test]
fn voronoi_normals_of_goursat_are_dgtals_or_serve_as_well() {
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", "Voronoi normals of Goursat") else {
        return;
    };
    // Of the errors, and of the angles in degrees.
    let bounds = [
        (Side::Dgtal, 1.01, [1e-7; 3]),
        (Side::Surface, 1.03, [1.5, 0.75, 0.5]),
    ];
    for (i, gridstep) in [1.0, 0.5, 0.25].into_iter().enumerate() {
        let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz"))).unwrap();
        let (solid, origin) = goursat::digitised(gridstep);
        let radius = 3.0 / f64::sqrt(gridstep);
        for (side, ratio, angles) in bounds {
            let settings = Settings {
                estimator: Estimator::VoronoiCovariance {
                    voronoi_radius: 10.0 / f64::sqrt(gridstep),
                    radius,
                    side,
                },
                weights: Weights::Dgtal,
                radii: vec![radius],
                ..Settings::new(lattice(&solid, [gridstep; 3], false))
            };
            let rows = whole(&solid, &settings).rows;
            let by_place: std::collections::HashMap<_, _> = rows.iter().map(|r| (r.k, r)).collect();
            let places = table.triples("k").unwrap();
            let ours: Vec<&FullRow> = places
                .iter()
                .map(|place| by_place[&place.map(|k| k as i32 + 2 * origin)])
                .collect();
            let theirs = table.triples("normal_VCM").unwrap();
            let degrees = ours.iter().zip(&theirs).map(|(row, u)| {
                let u = DVec3::from_array(*u).normalize();
                row.u.cross(u).length().atan2(row.u.dot(u)).to_degrees()
            });
            let [rms, largest] = norms(degrees);
            println!(
                "h = {gridstep}, {side:?}: angles to DGtal's, degrees, rms {rms:.2e} largest {largest:.2e}"
            );
            assert!(
                rms < angles[i] && largest < 3.0 * angles[i],
                "{rms} {largest}"
            );
            for (truth, column, pick) in [("H_true", "H_CNC_VCM", 0), ("G_true", "G_CNC_VCM", 1)] {
                let truth = table.column(truth).unwrap();
                let own = ours.iter().zip(truth).map(|(row, truth)| {
                    let c = row.curvature.unwrap();
                    [c.mean, c.gaussian][pick] - truth
                });
                let own = norms(own);
                let dgtal = table.column(column).unwrap();
                let dgtal = norms(dgtal.iter().zip(truth).map(|(a, b)| a - b));
                println!("  {column}: l2 / linf {own:.5?}, DGtal's {dgtal:.5?}");
                assert!(own[0] < ratio * dgtal[0] && own[1] < ratio * dgtal[1]);
            }
        }
    }
}
