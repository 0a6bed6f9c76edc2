//! Curvature by plain integral invariants.

use curvox::curvature::integral::InvariantKernel;
use curvox::curvature::{Curvature, Method};
use curvox::khalimsky::Adjacency;
use curvox::measure::surface::Surface;
use curvox::normal::Estimator;
use curvox::pipeline::Settings;
use curvox::sink::Flag;
use curvox::surfel::CellBox;
use curvox_tools::goursat;
use curvox_tools::npz::Table;
use curvox_tools::plain::{self, Scale, Solid, invariants};

use crate::common::{blob, lattice, noise, piped, window};
use crate::reference::folder;

/// Place and curvature of the surfels of some cells, taken as a single brick.
fn of_cells(
    solid: &Solid,
    spacing: [f64; 3],
    radius: f64,
    core: CellBox,
) -> Vec<([i32; 3], Curvature)> {
    let lattice = lattice(solid, spacing, false);
    let window = window(solid);
    let surface = Surface::extract(&window, core, &lattice, Adjacency::Interior);
    let kernel = InvariantKernel::new(radius, &lattice).unwrap();
    let found = kernel.curvatures(&window, &lattice, core, &surface.surfels);
    let places = (0..surface.len()).map(|i| surface.surfels.khalimsky(i));
    places.zip(found.into_iter().map(|(c, _)| c)).collect()
}

/// The same of all surfels.
fn single(solid: &Solid, spacing: [f64; 3], radius: f64) -> Vec<([i32; 3], Curvature)> {
    let core = CellBox {
        lo: [0; 3],
        hi: solid.dims.map(|n| n as i32),
    };
    of_cells(solid, spacing, radius, core)
}

#[test]
fn curvatures_are_those_of_counting_voxels() {
    for (solid, spacing, radius) in [
        (noise([12, 9, 10], 0.4, 3), [0.5; 3], 3.2),
        (blob([26, 22, 20], 4), [1.0, 0.7, 0.45], 4.0),
    ] {
        let surface = plain::Surface::new(&solid, false, plain::Adjacency::Interior);
        let scale = Scale::new(spacing);
        let radius_world = radius * scale.unit_world;
        let expected = invariants::curvatures(&solid, &surface, &scale, radius_world);
        let found = single(&solid, spacing, radius);
        assert_eq!(found.len(), expected.len());
        for (i, ((k, c), plain)) in found.iter().zip(&expected).enumerate() {
            assert_eq!(*k, surface.surfels[i].k);
            for (a, b) in [
                (c.mean, plain.mean),
                (c.gaussian, plain.gaussian),
                (c.k1, plain.k1),
                (c.k2, plain.k2),
            ] {
                assert!((a - b).abs() < 1e-10, "{k:?} {c:?} {plain:?}");
            }
        }
    }
}

#[test]
fn a_sphere_has_its_curvature_also_in_the_widest_ball() {
    // H of the continuous ball is exact; a centre off by half a voxel adds 2 / r^2.
    for (sphere, radius, slack) in [(40, 16.0, 0.3), (80, 60.5, 0.05)] {
        let middle = sphere + 4;
        let solid = Solid::from_fn([2 * middle as usize + 1; 3], |p| {
            p.map(|x| (x - middle).pow(2)).iter().sum::<i32>() <= sphere * sphere
        });
        // Where the normal is far from the axes.
        let away = (f64::from(sphere) / 3f64.sqrt()) as i32;
        let core = CellBox {
            lo: [middle + away - 6; 3],
            hi: [middle + away + 6; 3],
        };
        let found = of_cells(&solid, [1.0; 3], radius, core);
        assert!(found.len() > 100);
        for (k, c) in found {
            let in_radii = [c.mean, c.k1, c.k2].map(|x| x * f64::from(sphere));
            assert!((in_radii[0] - 1.0).abs() < slack, "{k:?} {in_radii:?}");
            let near = in_radii[1..].iter().all(|x| (x - 1.0).abs() < 1.3 * slack);
            assert!(near, "{k:?} {in_radii:?}");
        }
    }
}

#[test]
fn goursat_has_dgtals_integral_invariants() {
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", "integral invariants of Goursat") else {
        return;
    };
    for gridstep in [1.0, 0.5, 0.25] {
        let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz"))).unwrap();
        let (solid, origin) = goursat::digitised(gridstep);
        let radius = table.column("r_II").unwrap()[0] / gridstep;
        let found: std::collections::HashMap<_, _> =
            single(&solid, [gridstep; 3], radius).into_iter().collect();
        let (mean, gaussian) = (table.column("H_II").unwrap(), table.column("G_II").unwrap());
        for (row, place) in table.triples("k").unwrap().iter().enumerate() {
            let c = &found[&place.map(|k| k as i32 + 2 * origin)];
            assert!((c.mean - mean[row]).abs() < 1e-9, "{place:?} {c:?}");
            assert!((c.gaussian - gaussian[row]).abs() < 1e-9, "{place:?} {c:?}");
        }
    }
}

#[test]
fn the_pipeline_gives_the_rows_of_a_single_brick_at_any_cut() {
    let solid = blob([70, 44, 60], 8);
    let spacing = [1.0, 1.0, 0.8];
    let mut settings = Settings::new(lattice(&solid, spacing, false));
    settings.curvature = Method::Invariants;
    settings.estimator = Estimator::Trivial;
    settings.radii = vec![4.0, 9.5];
    settings.directions = true;
    let expected = [4.0, 9.5].map(|radius| single(&solid, spacing, radius));
    let mut before = None;
    for (brick, threads) in [(None, 1), (Some(16), 2), (Some(40), 3)] {
        settings.brick = brick;
        settings.threads = threads;
        let (rows, _) = piped(&solid, &settings);
        for (columns, expected) in rows.curvatures.iter().zip(&expected) {
            assert_eq!(rows.len(), expected.len());
            for (i, (k, c)) in expected.iter().enumerate() {
                assert_eq!([rows.k[0][i], rows.k[1][i], rows.k[2][i]], *k);
                assert_eq!(columns.mean[i], c.mean as f32);
                assert_eq!(columns.gaussian[i], c.gaussian as f32);
                assert_eq!(columns.k1[i], c.k1 as f32);
                assert_eq!(columns.k2[i], c.k2 as f32);
                assert_eq!(columns.flags[i] & Flag::NoArea.bit(), 0);
            }
        }
        let bits = crate::common::bits(&rows);
        assert!(
            before.get_or_insert_with(|| bits.clone()) == &bits,
            "{brick:?}"
        );
    }
}
