//! DGtal's numbers, if they are at hand.

use std::path::PathBuf;

use curvox_tools::agreement::{Comparison, compare};
use curvox_tools::npz::Table;
use curvox_tools::plain::algebra::{dot, normalised};
use curvox_tools::plain::{Adjacency, Estimator, Orientation, Scale, Surface, Ties, normals};
use curvox_tools::{goursat, vol};

/// The folder an environment variable names; says so if it is not set.
fn folder(variable: &str, test: &str) -> Option<PathBuf> {
    let folder = std::env::var_os(variable).map(PathBuf::from);
    if folder.is_none() {
        println!("SKIPPED: {test}: {variable} is not set");
    }
    folder
}

/// Every row is DGtal's when its cells and walk are repeated, and every row whose ball has no
/// cause to differ is the plain reference's.
fn assert_explained(comparisons: &[Comparison]) {
    for comparison in comparisons {
        for column in &comparison.columns {
            assert_eq!(column.emulated.beyond, 0, "{} {column:?}", comparison.name);
            assert!(column.clean.rows > 0);
            assert_eq!(column.clean.beyond, 0, "{} {column:?}", comparison.name);
        }
    }
}

#[test]
fn goursat_agrees_with_dgtal_on_every_row() {
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", "agreement with DGtal on Goursat") else {
        return;
    };
    for gridstep in [1.0, 0.5] {
        let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz"))).unwrap();
        let (solid, origin) = goursat::digitised(gridstep);
        let comparisons = compare(&solid, gridstep, 2 * origin, &table).unwrap();
        assert_explained(&comparisons);
        let columns = comparisons.iter().flat_map(|c| &c.columns);
        columns.for_each(|column| assert_eq!(column.caused.beyond, 0, "{column:?}"));
    }
}

#[test]
fn every_row_of_the_dragon_is_explained() {
    let test = "agreement with DGtal on the dragon";
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", test) else {
        return;
    };
    let Some(data) = folder("CURVOX_TEST_DATA", test) else {
        return;
    };
    let table = Table::read(&reference.join("dragon128_h1.npz")).unwrap();
    let solid = vol::read(&data.join("vol-gallery/dragon-128.vol")).unwrap();
    // The file's first voxel has coordinate -1.
    let comparisons = compare(&solid, 1.0, 2, &table).unwrap();
    assert_explained(&comparisons);
    for comparison in &comparisons {
        assert!(comparison.largest_remainder < 1e-7);
        // The causes are no excuse: nearly every row that has one differs.
        for column in &comparison.columns {
            let agree = column.caused.rows - column.caused.beyond;
            assert!(32 * agree < column.caused.rows, "{column:?}");
        }
    }
    // Two normals lie in the plane of their surfel: rounding decides their sign, and only that.
    let by_rule = &comparisons[0];
    assert_eq!(by_rule.columns[0].caused.beyond, 2);
    assert_eq!(by_rule.opposite_normals, 2);
    // Rows that agree in G though they have a cause: what their fans add cancels.
    let gaussian = by_rule.columns[2].caused;
    assert_eq!(gaussian.rows - gaussian.beyond, by_rule.cancelled);
}

#[test]
fn voronoi_normals_of_goursat_are_dgtals_up_to_ties() {
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", "Voronoi normals of Goursat") else {
        return;
    };
    for (gridstep, rms, most) in [(1.0, 1.5, 4.0), (0.5, 0.75, 2.0)] {
        let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz"))).unwrap();
        let (solid, origin) = goursat::digitised(gridstep);
        let scale = Scale::new([gridstep; 3]);
        let surface = Surface::new(&solid, false, Adjacency::Interior);
        let by = |ties| {
            let estimator = Estimator::VoronoiCovariance {
                voronoi_radius_world: 10.0 * gridstep.sqrt(),
                radius_world: 3.0 * gridstep.sqrt(),
                ties,
                orientation: Orientation::Dgtal,
            };
            normals::estimate(&solid, &surface, &scale, estimator).u
        };
        let (last, shared) = (by(Ties::Last), by(Ties::Shared));
        let expected = table.triples("normal_VCM").unwrap();
        let (mut squares, mut largest) = (0.0f64, 0.0f64);
        for (place, u) in table.triples("k").unwrap().iter().zip(&expected) {
            let k = place.map(|k| k as i32 + 2 * origin);
            let f = surface.find(k).unwrap() as usize;
            // DGtal averages four unit vectors and leaves the length as it is.
            let u = normalised(*u);
            for a in 0..3 {
                assert!(
                    (last[f][a] - u[a]).abs() < 1e-9,
                    "{k:?} {:?} {u:?}",
                    last[f]
                );
            }
            let angle = dot(shared[f], u).clamp(-1.0, 1.0).acos().to_degrees();
            squares += angle * angle;
            largest = largest.max(angle);
        }
        let found = (squares / expected.len() as f64).sqrt();
        println!("h = {gridstep}: rms {found} degrees, largest {largest}");
        assert!(found < rms && largest < most, "{found} {largest}");
    }
}
