use curvox::curvature::Method;
use curvox::khalimsky::Adjacency;
use curvox::measure::ball::{Compensation, Extent, Weights};
use curvox::measure::field::Field;
use curvox::normal::vcm::Side;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{Access, Settings};
use proptest::prelude::*;

use curvox::Error;
use curvox_tools::plain::Solid;

use crate::common::{Random, bits, blob, lattice, noise, piped, tried_with, whole};

#[test]
fn the_cut_does_not_show() {
    let solid = blob([150, 70, 90], 11);
    for (weights, field) in [
        (Weights::Lumped, Field::Constant),
        (Weights::Sharp, Field::Constant),
        (Weights::Dgtal, Field::Constant),
        (Weights::Lumped, Field::Interpolated),
        (Weights::Dgtal, Field::Linear),
    ] {
        let mut settings = Settings::new(lattice(&solid, [1.0, 1.2, 1.1], false));
        settings.weights = weights;
        settings.field = field;
        settings.quality = true;
        settings.radii = vec![3.0, 2.0];
        let (expected, outcome) = piped(&solid, &settings);
        let expected = bits(&expected);
        for (brick, memory_mib, threads) in [
            (Some(16), 1024, 1),
            (Some(32), 200, 2),
            (Some(64), 1536, 7),
            (Some(100), 1024, 3),
            (None, 100, 2),
        ] {
            settings.brick = brick;
            settings.memory_bytes = memory_mib << 20;
            settings.threads = threads;
            let (rows, again) = piped(&solid, &settings);
            assert!(
                bits(&rows) == expected,
                "{weights:?} {field:?} {brick:?} {memory_mib} MiB {threads} threads"
            );
            assert_eq!(again.cells, outcome.cells);
            assert_eq!(again.solid, outcome.solid);
        }
    }
}

#[test]
fn the_cut_does_not_show_in_voronoi_normals_with_box_voxels() {
    let solid = blob([75, 60, 66], 12);
    let mut settings = Settings::new(lattice(&solid, [1.0, 0.7, 0.9], false));
    settings.estimator = Estimator::VoronoiCovariance {
        voronoi_radius: 8.0,
        radius: 3.0,
        side: Side::Dgtal,
    };
    let (expected, _) = piped(&solid, &settings);
    let expected = bits(&expected);
    for (brick, threads) in [(16, 2), (30, 1), (100, 3)] {
        settings.brick = Some(brick);
        settings.threads = threads;
        let (rows, _) = piped(&solid, &settings);
        assert!(bits(&rows) == expected, "{brick}");
    }
}

/// As the command's default method, or refined.
fn with_average(mut settings: Settings, radius: f64, refined: bool) -> Settings {
    settings.estimator = Estimator::SurfaceAverage {
        radius: 1.2 * radius,
    };
    settings.refinement = refined.then_some(radius);
    settings.weights = Weights::Compensated(if refined {
        Compensation::Refined
    } else {
        Compensation::Averaged
    });
    settings.radii = vec![radius];
    settings
}

#[test]
fn the_cut_does_not_show_in_refined_normals() {
    let solid = blob([110, 60, 100], 13);
    for (spacing, refined) in [([1.0; 3], false), ([1.0; 3], true), ([1.0, 0.8, 1.3], true)] {
        let settings = Settings::new(lattice(&solid, spacing, false));
        let mut settings = with_average(settings, 2.5, refined);
        settings.quality = true;
        let (expected, outcome) = piped(&solid, &settings);
        let whole = whole(&solid, &settings);
        for (row, mean) in whole.rows.iter().zip(&expected.curvatures[0].mean) {
            let of_row = row.curvature.map_or(f32::NAN, |c| c.mean as f32);
            assert_eq!(of_row.to_bits(), mean.to_bits(), "{:?}", row.k);
        }
        let expected = bits(&expected);
        for (brick, memory_mib, threads) in [
            (Some(16), 1024, 1),
            (Some(30), 1024, 2),
            (Some(64), 1536, 7),
            (None, 130, 2),
        ] {
            settings.brick = brick;
            settings.memory_bytes = memory_mib << 20;
            settings.threads = threads;
            let (rows, again) = piped(&solid, &settings);
            assert!(
                bits(&rows) == expected,
                "{brick:?} {memory_mib} MiB {threads} threads"
            );
            assert_eq!(again.cells, outcome.cells);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn the_cut_does_not_show_in_refined_normals_of_noise(
        seed: u64,
        dims in [1usize..30, 1usize..24, 1usize..40],
        p in 0.02f64..0.98,
        closed: bool,
        refined: bool,
        whole: bool,
        brick in 8i32..24,
        threads in 1usize..4,
    ) {
        let solid = noise(dims, p, seed);
        let settings = Settings::new(lattice(&solid, [1.0; 3], closed));
        let mut settings = with_average(settings, 1.5, refined);
        if whole {
            settings.extent = Extent::Whole;
        }
        settings.directions = true;
        settings.threads = 1;
        let (expected, outcome) = piped(&solid, &settings);
        settings.brick = Some(brick);
        settings.threads = threads;
        let (rows, again) = piped(&solid, &settings);
        prop_assert!(bits(&rows) == bits(&expected));
        prop_assert_eq!(again.cells, outcome.cells);
    }

    #[test]
    fn the_cut_does_not_show_on_noise(
        seed: u64,
        dims in [1usize..40, 1usize..30, 1usize..40],
        p in 0.05f64..0.95,
        closed: bool,
        exterior: bool,
        which in 0usize..4,
        weights in 0usize..3,
        field in 0usize..4,
        quality: bool,
        invariants: bool,
        brick in 8i32..30,
        threads in 1usize..8,
    ) {
        let solid = noise(dims, p, seed);
        let mut settings = Settings::new(lattice(&solid, [1.0; 3], closed));
        settings.adjacency = if exterior { Adjacency::Exterior } else { Adjacency::Interior };
        settings.estimator = match which {
            0 => Estimator::Trivial,
            1 => Estimator::IntegralInvariant { radius: 2.0, orientation: Orientation::Moment },
            2 => Estimator::VoronoiCovariance {
                voronoi_radius: 3.5,
                radius: 2.0,
                side: Side::Surface,
            },
            _ => Estimator::SurfaceAverage { radius: 2.5 },
        };
        settings.weights = [Weights::Lumped, Weights::Sharp, Weights::Dgtal][weights];
        settings.radii = vec![2.0];
        if invariants {
            settings.curvature = Method::Invariants;
        }
        settings.directions = true;
        settings.field = [Field::Constant, Field::Interpolated, Field::Linear][field % 3];
        settings.quality = quality;
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

/// However little scratch there is, down to one plane of a brick at a time.
#[test]
fn bricks_in_pieces_do_not_show() {
    for (solid, voxels) in [
        (blob([40, 36, 30], 14), [1.0, 1.0, 1.0]),
        (noise([16, 40, 20], 0.4, 15), [1.0, 0.8, 1.2]),
    ] {
        let plain = Settings::new(lattice(&solid, voxels, false));
        let with = |change: &dyn Fn(&mut Settings)| {
            let mut settings = plain.clone();
            settings.radii = vec![3.0, 2.0];
            settings.quality = true;
            settings.directions = true;
            settings.threads = 2;
            change(&mut settings);
            settings
        };
        let vcm = Estimator::VoronoiCovariance {
            voronoi_radius: 6.0,
            radius: 3.0,
            side: Side::Dgtal,
        };
        for settings in [
            with(&|s| s.weights = Weights::Lumped),
            with(&|s| s.weights = Weights::Sharp),
            with(&|s| s.estimator = Estimator::Trivial),
            with(&|s| s.estimator = vcm),
            with(&|s| (s.field, s.weights) = (Field::Interpolated, Weights::Dgtal)),
            with(&|s| s.curvature = Method::Invariants),
            with_average(plain.clone(), 2.5, false),
            with_average(plain.clone(), 2.0, true),
        ] {
            let mut plan = settings.plan(&Access::forward(1), 0).unwrap();
            let (expected, outcome) = tried_with(&solid, &settings, &plan).unwrap();
            let expected = bits(&expected);
            for scratch_bytes in [1, 1 << 21] {
                plan.scratch_bytes = scratch_bytes;
                let (rows, again) = tried_with(&solid, &settings, &plan).unwrap();
                assert!(bits(&rows) == expected, "{scratch_bytes}: {settings:?}");
                assert_eq!(again.cells, outcome.cells);
            }
        }
    }
}

/// A volume whose density of surfels changes along z.
fn layered(seed: u64) -> Solid {
    let mut random = Random(seed);
    let dims = [96, 64, 100];
    let mut solid = Solid {
        dims,
        inside: Vec::new(),
    };
    let mut left = 0;
    let mut p = 0.0;
    for _ in 0..dims[2] {
        if left == 0 {
            left = 1 + (random.next() * 40.0) as usize;
            p = [0.0, 0.003, 0.05, 0.5][(random.next() * 4.0) as usize];
        }
        left -= 1;
        solid
            .inside
            .extend((0..dims[0] * dims[1]).map(|_| random.next() < p));
    }
    solid
}

#[test]
fn tight_memory_neither_stalls_nor_shows() {
    for seed in 0..6 {
        let solid = layered(seed);
        let mut settings = Settings::new(lattice(&solid, [1.0; 3], false));
        settings.estimator = Estimator::Trivial;
        settings.radii = vec![1.0];
        settings.threads = 2;
        settings.weights = if seed % 2 == 0 {
            Weights::Dgtal
        } else {
            Weights::Lumped
        };
        if seed % 3 == 0 {
            settings = with_average(settings, 1.0, true);
        }
        let (expected, _) = piped(&solid, &settings);
        let expected = bits(&expected);
        for memory_mib in [70, 76, 84, 100, 128] {
            settings.memory_bytes = memory_mib << 20;
            let (done, waiting) = std::sync::mpsc::channel();
            let (solid, asked) = (solid.clone(), settings.clone());
            std::thread::spawn(move || {
                let rows = asked.plan(&Access::forward(1), 0).ok().map(|mut plan| {
                    let high = tried_with(&solid, &asked, &plan).map(|(rows, _)| bits(&rows));
                    plan.slab_planes = 1;
                    let low = tried_with(&solid, &asked, &plan).map(|(rows, _)| bits(&rows));
                    (high, low)
                });
                // Nobody listens only if the time is over.
                let _ = done.send(rows);
            });
            // Refusing for want of memory is fine; waiting for ever is not, nor refusing what slabs of one plane could do.
            let minutes = std::time::Duration::from_secs(120);
            match waiting.recv_timeout(minutes).expect("the pipeline stalls") {
                Some((Ok(high), Ok(low))) => assert!(high == expected && low == expected),
                Some((Ok(high), Err(Error::TooDense { .. }))) => assert!(high == expected),
                Some((Err(Error::TooDense { .. }), Err(Error::TooDense { .. }))) | None => {}
                Some((high, low)) => panic!("{:?} {:?}", high.err(), low.err()),
            }
        }
    }
}
