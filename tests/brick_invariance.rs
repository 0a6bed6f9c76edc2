use curvox::khalimsky::Adjacency;
use curvox::measure::ball::Weights;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::Settings;
use proptest::prelude::*;

use crate::common::{bits, blob, lattice, noise, piped};

#[test]
fn the_cut_does_not_show() {
    let solid = blob([150, 70, 90], 11);
    for weights in [Weights::Lumped, Weights::Sharp, Weights::Dgtal] {
        let mut settings = Settings::new(lattice(&solid, [1.0, 1.2, 1.1], false));
        settings.weights = weights;
        settings.radii = vec![3.0, 2.0];
        let (expected, outcome) = piped(&solid, &settings);
        let expected = bits(&expected);
        for (brick, memory_mib, threads) in [
            (Some(16), 1024, 1),
            (Some(32), 200, 2),
            (Some(64), 1024, 7),
            (Some(100), 400, 3),
            (None, 96, 2),
        ] {
            settings.brick = brick;
            settings.memory_bytes = memory_mib << 20;
            settings.threads = threads;
            let (rows, again) = piped(&solid, &settings);
            assert!(
                bits(&rows) == expected,
                "{weights:?} {brick:?} {memory_mib} MiB {threads} threads"
            );
            assert_eq!(again.cells, outcome.cells);
            assert_eq!(again.solid, outcome.solid);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn the_cut_does_not_show_on_noise(
        seed: u64,
        dims in [1usize..40, 1usize..30, 1usize..40],
        p in 0.05f64..0.95,
        closed: bool,
        exterior: bool,
        which in 0..3,
        weights in 0..3,
        brick in 8i32..30,
        threads in 1usize..8,
    ) {
        let solid = noise(dims, p, seed);
        let mut settings = Settings::new(lattice(&solid, [1.0; 3], closed));
        settings.adjacency = if exterior { Adjacency::Exterior } else { Adjacency::Interior };
        settings.estimator = match which {
            0 => Estimator::Trivial,
            1 => Estimator::IntegralInvariant { radius: 2.0, orientation: Orientation::Moment },
            _ => Estimator::SurfaceAverage { radius: 2.5 },
        };
        settings.weights = [Weights::Lumped, Weights::Sharp, Weights::Dgtal][weights];
        settings.radii = vec![2.0];
        settings.directions = true;
        settings.threads = 1;
        let (expected, outcome) = piped(&solid, &settings);
        settings.brick = Some(brick);
        settings.threads = threads;
        let (rows, again) = piped(&solid, &settings);
        prop_assert!(bits(&rows) == bits(&expected));
        prop_assert_eq!(again.cells, outcome.cells);
        prop_assert_eq!(again.solid, outcome.solid);
    }
}
