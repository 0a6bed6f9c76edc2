//! How long does a whole run take, from planes in memory to rows, by radius and threads?

use std::sync::atomic::AtomicBool;

use curvox::lattice::Lattice;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{Access, Progress, Settings, Source, run};
use curvox::shape::{Digitisation, Goursat, Grid};
use curvox::volume::{Binarizer, Criterion};
use curvox_formats::{DType, OpenOptions, RawLayout, Unit, VoxelType, open_stream};
use divan::{Bencher, counter::ItemsCount};

fn main() {
    divan::main();
}

/// Radii in voxels (the paper's at gridsteps 1/4, 1/4 and 1/16) and threads.
const CASES: [(f64, usize); 6] = [(3.0, 1), (3.0, 2), (6.0, 1), (6.0, 2), (12.0, 1), (12.0, 2)];

#[divan::bench(args = CASES, sample_count = 5, sample_size = 1)]
fn goursat_surfels(bencher: Bencher<'_, '_>, (radius, threads): (f64, usize)) {
    let h = if radius > 6.0 { 0.0625 } else { 0.125 };
    let digitisation = Digitisation::new(Goursat, Grid::cubic(h)).unwrap();
    let dims = digitisation.dims().map(|n| n as u64);
    let (mut bytes, mut plane) = (Vec::new(), Vec::new());
    for z in 0..dims[2] as usize {
        digitisation.plane(z, &mut plane);
        bytes.extend_from_slice(&plane);
    }
    let lattice = Lattice::new(dims, [h; 3], false).unwrap();
    let settings = Settings {
        estimator: Estimator::IntegralInvariant {
            radius,
            orientation: Orientation::Moment,
        },
        radii: vec![radius],
        threads,
        ..Settings::new(lattice)
    };
    let layout = RawLayout {
        dims,
        dtype: DType::little(VoxelType::U8),
        spacing: None,
        unit: Unit::Unknown,
        skip: 0,
    };
    let options = OpenOptions {
        raw: Some(layout),
        ..Default::default()
    };
    let once = |bytes: Vec<u8>| {
        let volume =
            open_stream(Box::new(std::io::Cursor::new(bytes)), "goursat", &options).unwrap();
        let criterion = Criterion::AtLeast(1i128.into());
        let binarizer = Binarizer::new(criterion, VoxelType::U8, volume.header.byte_order, None);
        let plan = settings.plan(&Access::forward(1), 0).unwrap();
        let (progress, stop) = (Progress::default(), AtomicBool::new(false));
        run(
            Source { volume, binarizer },
            &settings,
            &plan,
            &mut [],
            &progress,
            &stop,
        )
        .unwrap()
    };
    let surfels = once(bytes.clone()).cells.surfel_count();
    bencher
        .counter(ItemsCount::new(surfels))
        .with_inputs(|| bytes.clone())
        .bench_local_values(once);
}
