use std::sync::atomic::AtomicBool;

use curvox::Error;
use curvox::lattice::Lattice;
use curvox::normal::Estimator;
use curvox::pipeline::{Access, Outcome, Plan, Progress, Settings, Source, run};
use curvox::sink::{DatasetSink, RadiusInfo, SurfelBatch, SurfelSink, TableInfo};
use curvox::volume::otsu::survey;
use curvox::volume::{Binarizer, Criterion};
use curvox_formats::{ForwardVoxels, OpenOptions, RawLayout, Region, Unit, Volume, open_stream};
use proptest::prelude::*;

use crate::common::pieces::{Kind, Pieces, Thing};
use crate::common::{Collected, bits};

fn settings(dims: [u64; 3], gradient: bool) -> Settings {
    let mut settings = Settings::new(Lattice::new(dims, [1.0, 1.1, 0.9], false).unwrap());
    if gradient {
        settings.estimator = Estimator::Gradient { sigma: 1.0 };
    } else {
        settings.estimator = Estimator::SurfaceAverage { radius: 2.0 };
    }
    settings.radii = vec![2.0];
    settings.threads = 2;
    settings
}

fn read(
    volume: Volume,
    settings: &Settings,
    plan: &Plan,
    criterion: Criterion,
    more: &mut dyn SurfelSink,
) -> Result<(SurfelBatch, Outcome), Error> {
    let header = &volume.header;
    let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, header.scaling);
    let mut rows = Collected::default();
    let outcome = run(
        Source { volume, binarizer },
        settings,
        plan,
        &mut [&mut rows, more],
        &Progress::default(),
        &AtomicBool::new(false),
    )?;
    Ok((rows.joined(), outcome))
}

fn at_least(value: i128) -> Criterion {
    Criterion::AtLeast(value.into())
}

/// The same voxels as a stream, which knows of no pieces.
fn stream(pieces: &Pieces) -> Volume {
    let mut bytes = Vec::new();
    pieces.bytes(&Region::whole(pieces.dims), &mut bytes);
    let options = OpenOptions {
        raw: Some(RawLayout {
            dims: pieces.dims,
            dtype: pieces.header().dtype(),
            spacing: None,
            unit: Unit::Unknown,
            skip: 0,
        }),
        ..Default::default()
    };
    open_stream(Box::new(std::io::Cursor::new(bytes)), "s", &options).unwrap()
}

fn streamed(pieces: &Pieces, settings: &Settings, criterion: Criterion) -> (SurfelBatch, Outcome) {
    let volume = stream(pieces);
    let plan = settings.plan(&Access::of(&volume), 0).unwrap();
    read(
        volume,
        settings,
        &plan,
        criterion,
        &mut Collected::default(),
    )
    .unwrap()
}

fn piecewise(
    pieces: &Pieces,
    settings: &Settings,
    criterion: Criterion,
) -> (SurfelBatch, Outcome, Plan) {
    let volume = pieces.volume();
    let plan = settings.plan(&Access::of(&volume), 0).unwrap();
    let (rows, outcome) = read(
        volume,
        settings,
        &plan,
        criterion,
        &mut Collected::default(),
    )
    .unwrap();
    (rows, outcome, plan)
}

fn agree(found: &(SurfelBatch, Outcome, Plan), expected: &(SurfelBatch, Outcome)) {
    assert!(bits(&found.0) == bits(&expected.0));
    assert_eq!(found.1.cells, expected.1.cells);
    assert_eq!(found.1.solid, expected.1.solid);
    assert_eq!(found.1.sides, expected.1.sides);
}

fn thing(lo: [u64; 3], size: u64, kind: Kind) -> Thing {
    Thing {
        lo,
        size: [size; 3],
        kind,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn pieces_of_any_shape_give_the_same_rows_and_are_decoded_once(
        dims in [1u64..90, 1u64..50, 1u64..40],
        chunk in [1u64..=20, 1u64..=20, 1u64..=20],
        before in [0u64..20, 0u64..20, 0u64..20],
        seed: u64,
        tells: bool,
        wide: bool,
        gradient: bool,
    ) {
        let mut pieces = Pieces::new(dims, chunk, vec![
            Thing { lo: [0; 3], size: dims, kind: Kind::Noise(seed) },
            Thing { lo: dims.map(|n| n / 3), size: dims.map(|n| n / 2), kind: Kind::Solid(200) },
        ]);
        (pieces.tells, pieces.wide) = (tells, wide);
        pieces.before = [0, 1, 2].map(|a| before[a] % chunk[a]);
        let settings = settings(dims, gradient);
        let found = piecewise(&pieces, &settings, at_least(180));
        agree(&found, &streamed(&pieces, &settings, at_least(180)));
        prop_assert_eq!(found.2.chunks.unwrap().decoded_times, 1);
        prop_assert!(matches!(pieces.counts(), None | Some((1, 1))), "{:?}", pieces.counts());
    }

    #[test]
    fn sparse_volumes_give_the_rows_of_dense_ones(
        dims in [150u64..400, 130u64..260, 30u64..110],
        chunk in [1u64..=100, 1u64..=100, 1u64..=100],
        before in [0u64..100, 0u64..100, 0u64..100],
        at in proptest::collection::vec(([0.0f64..1.0, 0.0f64..1.0, 0.0f64..1.0], 4u64..30, 0usize..3), 0..5),
        seed: u64,
        inverted: bool,
        closed: bool,
        wide: bool,
        gradient: bool,
        brick in proptest::option::of(8i32..100),
    ) {
        let things = at.iter().map(|&(at, size, kind)| thing(
            [0, 1, 2].map(|a| ((dims[a] as f64 - 1.0) * at[a]) as u64),
            size,
            [Kind::Ball, Kind::Noise(seed), Kind::Solid(100)][kind],
        ));
        let mut things: Vec<_> = things.collect();
        for thing in &mut things {
            for a in 0..3 {
                thing.size[a] = thing.size[a].min(dims[a] - thing.lo[a]);
            }
        }
        let mut pieces = Pieces::new(dims, chunk, things);
        pieces.wide = wide;
        pieces.before = [0, 1, 2].map(|a| before[a] % chunk[a]);
        let mut settings = settings(dims, gradient);
        settings.lattice = Lattice::new(dims, [1.0; 3], closed).unwrap();
        settings.brick = brick;
        let criterion = if inverted { Criterion::Below(50i128.into()) } else { at_least(50) };
        let found = piecewise(&pieces, &settings, criterion);
        let tiled = found.2.chunks.as_ref().unwrap().tiles.is_some();
        prop_assume!(tiled || at.len() > 1);
        agree(&found, &streamed(&pieces, &settings, criterion));
        prop_assert!(matches!(pieces.counts(), None | Some((1, 1))), "{:?}", pieces.counts());
    }
}

#[test]
fn a_layer_that_does_not_fit_is_read_in_parts() {
    let dims = [900, 700, 260];
    let mut pieces = Pieces::new(
        dims,
        [64, 64, 256],
        vec![thing([200, 300, 40], 180, Kind::Ball)],
    );
    pieces.tells = false;
    let mut settings = settings(dims, false);
    settings.memory_bytes = 96 << 20;
    settings.threads = 1;
    let found = piecewise(&pieces, &settings, at_least(30));
    let times = found.2.chunks.as_ref().unwrap().decoded_times;
    assert!(times > 1);
    let (least, most) = pieces.counts().unwrap();
    assert!(
        least >= 1 && u64::from(most) == times,
        "{least} {most} {times}"
    );
    settings.memory_bytes = 1 << 30;
    let once = piecewise(&pieces, &settings, at_least(30));
    assert_eq!(once.2.chunks.as_ref().unwrap().decoded_times, 1);
    agree(&found, &(once.0, once.1));
}

#[test]
fn two_small_things_in_opposite_corners_of_a_huge_volume_take_default_memory() {
    let dims = [100_000; 3];
    let far = 99_900;
    let pieces = Pieces::new(
        dims,
        [8; 3],
        vec![
            thing([40, 50, 60], 40, Kind::Ball),
            thing([far + 2, far + 7, far + 30], 41, Kind::Ball),
        ],
    );
    for gradient in [false, true] {
        let settings = settings(dims, gradient);
        let folder = tempfile::tempdir().unwrap();
        let volume = pieces.volume();
        let plan = settings.plan(&Access::of(&volume), 0).unwrap();
        assert!(plan.fixed_bytes + plan.bits_bytes + plan.grey_bytes < settings.memory_bytes / 4);
        let info = TableInfo {
            dims: settings.lattice.dims,
            spacing: settings.lattice.spacing,
            unit: "vx".into(),
            first_index: [0; 3],
            origin: [0.0; 3],
            direction: settings.lattice.direction,
            radii: vec![RadiusInfo {
                label: "2vx".into(),
                voxels: 2.0,
                world: 2.0,
            }],
            directions: false,
            errors: false,
            quality: false,
            parameters: serde_json::Value::Null,
            version: "test".into(),
            conventions: Vec::new(),
        };
        let mut parts = DatasetSink::create(folder.path(), info, None).unwrap();
        let (rows, outcome) = read(volume, &settings, &plan, at_least(20), &mut parts).unwrap();
        let with_rows = parts.parts_done();
        assert_eq!(
            with_rows.iter().map(|p| p.rows).sum::<u64>(),
            rows.len() as u64
        );
        assert!(with_rows.iter().all(|p| p.file.is_some()));
        // Each thing alone, in a small volume, has the same rows.
        let mut expected = Vec::new();
        let mut solid = curvox::volume::SolidCounts::default();
        for (at, alone) in [([0, 0, 0], 0), ([far, far, far], 1)] {
            let mut alone = pieces.things[alone].clone();
            alone.lo = [0, 1, 2].map(|a| alone.lo[a] - at[a]);
            let small = Pieces::new([100; 3], [100; 3], vec![alone]);
            let mut of_small = settings.clone();
            of_small.lattice = Lattice::new([100; 3], settings.lattice.spacing, false).unwrap();
            let (mut rows, outcome) = streamed(&small, &of_small, at_least(20));
            for a in 0..3 {
                let shift = 2 * at[a] as i32;
                rows.k[a].iter_mut().for_each(|k| *k += shift);
            }
            expected.push(rows);
            solid.add(&outcome.solid);
        }
        let mut expected = Collected(expected).joined();
        expected.position = rows.position.clone();
        assert!(bits(&rows) == bits(&expected));
        assert_eq!(outcome.solid, solid);
    }
}

#[test]
fn many_specks_all_over_a_volume_lower_the_slabs_or_say_what_they_take() {
    let dims = [4000, 4000, 80];
    let specks = |n: u64| (0..n).map(move |i| 30 + i * (3900 / n));
    let things = specks(60)
        .flat_map(|y| specks(60).map(move |x| thing([x, y, 30], 3, Kind::Ball)))
        .collect();
    let pieces = Pieces::new(dims, [8; 3], things);
    let mut settings = settings(dims, false);
    let (_, _, plan) = piecewise(&pieces, &settings, at_least(1));
    assert!(plan.chunks.as_ref().unwrap().tiles.is_some());
    // All slabs as high as planned would not fit.
    let (edge, planes) = (plan.brick_edge as u64, plan.slab_planes as u64);
    let index_bytes = plan.index_bytes().unwrap();
    assert!(
        planes >= 32 && index_bytes < 3600 * edge * planes * 36,
        "{edge} {planes} {index_bytes}"
    );
    settings.memory_bytes = 80 << 20;
    let volume = pieces.volume();
    match settings.plan(&Access::of(&volume), 0) {
        Err(error) => assert!(error.to_string().contains("--memory"), "{error}"),
        Ok(plan) => {
            let found = read(
                volume,
                &settings,
                &plan,
                at_least(1),
                &mut Collected::default(),
            );
            if let Err(error) = found {
                assert!(error.to_string().contains("--memory"), "{error}");
            }
        }
    }
}

#[test]
fn values_of_pieces_are_those_of_the_stream() {
    let dims = [700, 300, 200];
    let things = vec![
        thing([100, 100, 90], 60, Kind::Ball),
        thing([400, 0, 0], 120, Kind::Solid(40)),
        thing([550, 150, 130], 50, Kind::Noise(7)),
    ];
    for (chunk, tells) in [
        ([64, 64, 64], true),
        ([30, 17, 1], false),
        ([700, 300, 1], false),
    ] {
        let mut pieces = Pieces::new(dims, chunk, things.clone());
        pieces.tells = tells;
        pieces.before = chunk.map(|n| n / 3);
        let stop = AtomicBool::new(false);
        let of_pieces = survey(|| Ok::<_, curvox_formats::Error>(pieces.volume()), &stop).unwrap();
        assert_eq!(pieces.counts(), Some((1, 1)));
        let of_stream = survey(|| Ok::<_, curvox_formats::Error>(stream(&pieces)), &stop).unwrap();
        assert_eq!(of_pieces, of_stream);
    }
}

#[test]
fn planes_in_order_decode_each_piece_once() {
    let dims = [50, 40, 77];
    let mut pieces = Pieces::new(
        dims,
        [16, 16, 16],
        vec![thing([3, 4, 5], 33, Kind::Noise(3))],
    );
    pieces.tells = false;
    pieces.before = [1, 2, 5];
    let mut whole = Vec::new();
    pieces.bytes(&Region::whole(dims), &mut whole);
    for count in [1, 3, 16, 20, 100] {
        pieces.decoded.lock().unwrap().clear();
        let mut forward: Box<dyn ForwardVoxels> = pieces.volume().into_forward();
        let (mut all, mut some) = (Vec::new(), Vec::new());
        loop {
            let found = forward.read_planes(count, &mut some).unwrap();
            assert_eq!(some.len() as u64, found * 50 * 40);
            if found == 0 {
                break;
            }
            all.extend_from_slice(&some);
        }
        assert_eq!(forward.finish().unwrap(), Vec::<String>::new());
        assert!(all == whole);
        assert_eq!(pieces.counts(), Some((1, 1)));
    }
}
