//! The named methods against the truth and each other: what the README and docs/accuracy say of them.

use curvox::pipeline::{NamedMethod, Settings};
use curvox::shape::{
    Digitisation, Grid, ImplicitShape, Noise, NoisyPlanes, by_spec, closest_point,
};
use curvox::sink::{Flag, SurfelBatch};
use curvox_tools::moved::Moved;
use curvox_tools::plain::Solid;
use glam::DVec3;

use crate::common::{lattice, piped};

struct Case<S> {
    digitisation: Digitisation<S>,
    solid: Solid,
}

impl<S: ImplicitShape> Case<S> {
    fn new(shape: S, gridstep: f64, noise: f64) -> Self {
        let digitisation = Digitisation::new(shape, Grid::cubic(gridstep)).unwrap();
        let dims = digitisation.dims();
        let (mut inside, mut plane) = (Vec::new(), Vec::new());
        let source = |z: usize, out: &mut Vec<u8>| {
            digitisation.plane(z, out);
            Ok::<_, std::convert::Infallible>(())
        };
        let mut planes = NoisyPlanes::new(Noise::new(noise, 1).unwrap(), dims, 0..dims[2], source);
        while planes.next_plane(&mut plane).unwrap().is_some() {
            inside.extend(plane.iter().map(|&v| v != 0));
        }
        drop(planes);
        Self {
            digitisation,
            solid: Solid { dims, inside },
        }
    }

    fn rows(&self, method: NamedMethod, radius: f64) -> SurfelBatch {
        let spacing = self.digitisation.spacing().to_array();
        let settings = Settings::new(lattice(&self.solid, spacing, false));
        piped(&self.solid, &settings.with_method(method, radius)).0
    }

    /// l2 and linf of H, then of G, of each method, over the surfels near the surface that are an island to none.
    fn errors<const N: usize>(&self, methods: [NamedMethod; N], radius: f64) -> [[f64; 4]; N] {
        let all = methods.map(|method| self.rows(method, radius));
        let far = 2.0 * self.digitisation.spacing().max_element();
        let mut errors = [[0.0f64; 4]; N];
        let mut count = 0.0;
        for i in 0..all[0].len() {
            let k = [0, 1, 2].map(|a| i64::from(all[0].k[a][i]));
            let place = self.digitisation.khalimsky_to_world(k);
            let close = closest_point(self.digitisation.shape(), place);
            let Some(close) = close.filter(|c| c.signed_distance.abs() < far) else {
                continue;
            };
            let is_island =
                |rows: &SurfelBatch| rows.curvatures[0].flags[i] & Flag::Island.bit() != 0;
            if all.iter().any(is_island) {
                continue;
            }
            count += 1.0;
            let truth = [close.truth.mean_curvature, close.truth.gaussian_curvature];
            for (errors, rows) in errors.iter_mut().zip(&all) {
                let at = &rows.curvatures[0];
                let found = [at.mean[i], at.gaussian[i]].map(f64::from);
                for q in 0..2 {
                    let error = (found[q] - truth[q]).abs();
                    assert!(error.is_finite(), "{k:?}");
                    errors[2 * q] += error * error;
                    errors[2 * q + 1] = errors[2 * q + 1].max(error);
                }
            }
        }
        for errors in &mut errors {
            errors[0] = (errors[0] / count).sqrt();
            errors[2] = (errors[2] / count).sqrt();
        }
        errors
    }

    /// Ratios to the errors of the paper's method.
    fn ratios(&self, method: NamedMethod, gridstep: f64) -> [f64; 4] {
        let radius = 3.0 / gridstep.sqrt();
        let [paper, errors] = self.errors([NamedMethod::Paper, method], radius);
        std::array::from_fn(|i| errors[i] / paper[i])
    }
}

fn moved(
    shape: &str,
    number: u64,
    gridstep: f64,
    noise: f64,
) -> Case<Moved<curvox::shape::BoxedShape>> {
    let shape = Moved::numbered(by_spec(shape).unwrap(), number, gridstep);
    Case::new(shape, gridstep, noise)
}

#[test]
fn refined_normals_halve_the_errors_of_the_paper_in_general_position() {
    for (shape, gridstep, limit) in [
        ("sphere", 0.5, 0.5),
        ("ellipsoid90", 0.5, 0.5),
        ("goursat", 0.5, 0.55),
        ("rcube", 0.5, 0.6),
        ("ellipsoid90", 0.25, 0.5),
    ] {
        for number in [1, 2] {
            let ratios = moved(shape, number, gridstep, 0.0).ratios(NamedMethod::Refined, gridstep);
            println!("{shape} {gridstep} {number}: {ratios:.3?}");
            assert!(
                ratios.iter().all(|&r| r < limit),
                "{shape} {number}: {ratios:?}"
            );
        }
    }
}

#[test]
fn under_noise_the_methods_are_no_worse_than_the_paper() {
    for (shape, noise) in [
        ("goursat", 0.1),
        ("sphere", 0.1),
        ("goursat", 0.3),
        ("sphere", 0.5),
        ("rcube", 0.5),
    ] {
        let case = moved(shape, 1, 0.5, noise);
        for method in [NamedMethod::Default, NamedMethod::Refined] {
            let ratios = case.ratios(method, 0.5);
            println!("{shape} p = {noise} {method:?}: {ratios:.3?}");
            // of the largest errors one surfel decides
            assert!(
                ratios[0] < 1.0 && ratios[2] < 1.0,
                "{noise} {method:?}: {ratios:?}"
            );
            assert!(
                ratios.iter().all(|&r| r < 1.1),
                "{noise} {method:?}: {ratios:?}"
            );
        }
    }
}

#[test]
fn a_sphere_of_20_voxels_has_its_curvature() {
    let sphere = Moved::numbered(by_spec("sphere:radius=20").unwrap(), 4, 1.0);
    let case = Case::new(sphere, 1.0, 0.0);
    for (method, radius, percent) in [
        (NamedMethod::Default, 5.0, 2.2),
        (NamedMethod::Default, 6.0, 1.3),
        (NamedMethod::Refined, 4.0, 2.0),
        (NamedMethod::Refined, 5.0, 1.3),
    ] {
        let [[l2, ..]] = case.errors([method], radius);
        println!("{method:?} at {radius}: {:.2} %", l2 * 20.0 * 100.0);
        assert!(l2 * 20.0 * 100.0 < percent, "{method:?} at {radius}: {l2}");
        assert!(
            case.rows(method, radius).curvatures[0]
                .mean
                .iter()
                .all(|&h| h > 0.0)
        );
    }
}

/// Voxels of a cube of 60 whose centre `p`, from the middle, is `inside`.
fn solid(inside: impl Fn(DVec3) -> bool) -> Solid {
    Solid::from_fn([60; 3], |p| {
        inside(DVec3::from_array(p.map(f64::from)) - DVec3::new(29.83, 30.21, 30.07))
    })
}

fn rows_of(solid: &Solid, method: NamedMethod) -> SurfelBatch {
    let settings = Settings::new(lattice(solid, [1.0; 3], false));
    piped(solid, &settings.with_method(method, 3.0)).0
}

#[test]
fn each_sheet_of_a_wall_two_voxels_thick_is_as_if_the_other_were_not_there() {
    let outer = 22.0;
    let ball = solid(|p| p.length() <= outer);
    let shell = solid(|p| p.length() <= outer && p.length() > outer - 2.0);
    for method in [NamedMethod::Default, NamedMethod::Refined] {
        let alone = rows_of(&ball, method);
        let both = rows_of(&shell, method);
        let places: std::collections::HashMap<_, _> = (0..both.len())
            .map(|i| (([0, 1, 2].map(|a| both.k[a][i]), both.side[i]), i))
            .collect();
        let mut others = 0;
        for i in 0..alone.len() {
            let place = ([0, 1, 2].map(|a| alone.k[a][i]), alone.side[i]);
            let j = places[&place];
            others += u32::from(both.curvatures[0].flags[j] & Flag::SeveralSheets.bit() != 0);
            assert_eq!(
                alone.curvatures[0].mean[i].to_bits(),
                both.curvatures[0].mean[j].to_bits(),
                "{method:?} {place:?}"
            );
        }
        assert!(others > 1000);
    }
}

#[test]
fn faces_of_a_cube_are_flat_away_from_its_edges() {
    let cube = solid(|p| p.abs().max_element() <= 16.3);
    for (method, reach, rest) in [
        (NamedMethod::Default, 9.0, 1e-6),
        (NamedMethod::Refined, 13.0, 1e-3),
    ] {
        let rows = rows_of(&cube, method);
        let at = &rows.curvatures[0];
        let mut flat = 0;
        for i in 0..rows.len() {
            let place = DVec3::from_array([0, 1, 2].map(|a| f64::from(rows.k[a][i]) * 0.5 - 0.5));
            let mut from_middle = (place - DVec3::new(29.83, 30.21, 30.07)).abs().to_array();
            from_middle.sort_by(f64::total_cmp);
            let to_edge = 16.3 - from_middle[1];
            if to_edge > reach {
                flat += 1;
                assert!(
                    at.mean[i].abs() < rest && at.gaussian[i].abs() < rest,
                    "{place}"
                );
            } else if to_edge > 4.0 {
                assert!(at.mean[i].abs() < 0.04, "{place}: {}", at.mean[i]);
            }
        }
        assert!(flat > 100);
    }
}
