use curvox::khalimsky::Adjacency;
use curvox::measure::cells::CellTotals;
use curvox::measure::field::Field;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{Outcome, Settings};
use curvox::volume::SolidCounts;
use curvox_tools::plain::Solid;
use proptest::prelude::*;

use crate::common::{lattice, noise, piped};

/// V - E + F as the solid has it (see `curvox::volume::SolidCounts`).
fn by_solid(solid: &SolidCounts, adjacency: Adjacency) -> i128 {
    i128::from(match adjacency {
        Adjacency::Interior => 2 * solid.chi6 + 2 * solid.antipodal_outside as i64,
        Adjacency::Exterior => 2 * solid.chi26 + 2 * solid.antipodal_inside as i64,
    })
}

fn check(outcome: &Outcome, adjacency: Adjacency) {
    let cells: &CellTotals = &outcome.cells;
    assert_eq!(cells.border_linels, 0);
    assert_eq!(cells.euler_gauss_bonnet(), Some(cells.euler_counted()));
    assert_eq!(cells.euler_counted(), by_solid(&outcome.solid, adjacency));
}

fn closed(solid: &Solid, adjacency: Adjacency, estimator: Estimator, field: Field) -> Outcome {
    let mut settings = Settings::new(lattice(solid, [1.0, 0.8, 0.9], true));
    settings.adjacency = adjacency;
    settings.estimator = estimator;
    settings.field = field;
    settings.radii = vec![1.5];
    settings.brick = Some(8);
    piped(solid, &settings).1
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn gauss_bonnet_holds_in_integers_on_any_closed_surface(
        seed: u64,
        dims in [1usize..20, 1usize..20, 1usize..20],
        p in 0.02f64..0.98,
        exterior: bool,
        which in 0..4,
        interpolated: bool,
    ) {
        let adjacency = if exterior { Adjacency::Exterior } else { Adjacency::Interior };
        let estimator = match which {
            0 => Estimator::Trivial,
            1 => Estimator::IntegralInvariant { radius: 2.3, orientation: Orientation::Moment },
            2 => Estimator::IntegralInvariant { radius: 3.0, orientation: Orientation::Trivial },
            _ => Estimator::SurfaceAverage { radius: 2.0 },
        };
        let solid = noise(dims, p, seed);
        let field = if interpolated { Field::Interpolated } else { Field::Constant };
        check(&closed(&solid, adjacency, estimator, field), adjacency);
    }
}

#[test]
fn a_ball_has_the_euler_characteristic_of_a_sphere_and_a_torus_has_none() {
    let ball = Solid::from_fn([25; 3], |p| {
        p.iter().map(|x| (x - 12) * (x - 12)).sum::<i32>() <= 100
    });
    let torus = Solid::from_fn([41, 41, 17], |p| {
        let [x, y, z] = [p[0] - 20, p[1] - 20, p[2] - 8].map(f64::from);
        let ring = (x * x + y * y).sqrt() - 12.0;
        ring * ring + z * z <= 25.0
    });
    let estimator = Estimator::IntegralInvariant {
        radius: 3.0,
        orientation: Orientation::Moment,
    };
    for (solid, chi) in [(ball, 2), (torus, 0)] {
        for adjacency in [Adjacency::Interior, Adjacency::Exterior] {
            for field in [Field::Constant, Field::Interpolated] {
                let outcome = closed(&solid, adjacency, estimator, field);
                assert_eq!(outcome.cells.euler_counted(), chi);
                assert_eq!(outcome.cells.absolute_lifts, 0);
                check(&outcome, adjacency);
            }
        }
    }
}

#[test]
fn empty_and_full_images_have_no_surface_unless_closed() {
    for (fill, surfels_closed) in [(false, 0), (true, 2 * (8 * 9 + 9 * 10 + 10 * 8))] {
        let solid = Solid::from_fn([8, 9, 10], |_| fill);
        for closed in [false, true] {
            let settings = Settings::new(lattice(&solid, [1.0; 3], closed));
            let (rows, outcome) = piped(&solid, &settings);
            let expected = if closed { surfels_closed } else { 0 };
            assert_eq!(rows.len(), expected);
            assert_eq!(outcome.cells.surfel_count(), expected as u64);
        }
    }
}
