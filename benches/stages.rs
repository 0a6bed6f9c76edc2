//! How long does each stage take, by radius? Voxels or surfels per second on one thread.
//!
//! The shape is Goursat's, digitised so that the paper's radii are 3, 6 and 12 voxels (gridsteps
//! 1, 1/4 and 1/16; the finest is cut to a corner to stay quick).

use std::sync::Arc;

use curvox::khalimsky::Adjacency;
use curvox::lattice::Lattice;
use curvox::measure::ball::{BallKernel, Extent, LocalMeasures, Weights};
use curvox::measure::cells::{Asked, Keep};
use curvox::measure::evaluate;
use curvox::measure::field::Field;
use curvox::measure::surface::Surface;
use curvox::normal::{Around, Estimator, NormalKernel, Orientation};
use curvox::shape::{Digitisation, Goursat, Grid};
use curvox::surfel::{CellBox, SurfelIndex};
use curvox::volume::{Binarizer, BitBox, BitPlane, Criterion, PlaneWindow, SolidCounts};
use curvox_formats::{ByteOrder, VoxelType};
use divan::{Bencher, counter::ItemsCount};

fn main() {
    divan::main();
}

/// A brick in the middle of the side of Goursat's shape, with all planes around it.
struct Scene {
    window: PlaneWindow,
    lattice: Lattice,
    core: CellBox,
}

/// Radii in voxels and the gridsteps at which the paper uses them.
const RADII: [f64; 3] = [3.0, 6.0, 12.0];

/// What of the cells the default method wants.
const LUMPED: Asked = Asked {
    field: Field::Constant,
    keep: Keep::Lumped,
    quality: false,
};

fn scene(radius: f64) -> Scene {
    let h = 9.0 / (radius * radius);
    let digitisation = Digitisation::new(Goursat, Grid::cubic(h)).unwrap();
    let dims = digitisation.dims().map(|n| n as u32);
    let mut stored = Vec::new();
    let planes = (0..dims[2] as usize)
        .map(|z| {
            digitisation.plane(z, &mut stored);
            let mut plane = BitPlane::outside(dims[0], dims[1]);
            let criterion = Criterion::AtLeast(1i128.into());
            let binarizer = Binarizer::new(criterion, VoxelType::U8, ByteOrder::Little, None);
            for (row, out) in stored.chunks(dims[0] as usize).zip(plane.rows_mut()) {
                binarizer.pack_row(row, out);
            }
            Arc::new(plane)
        })
        .collect();
    let lattice = Lattice::new(dims.map(u64::from), [h; 3], false).unwrap();
    let window = PlaneWindow {
        dims,
        z0: 0,
        planes,
    };
    // The largest cube of at most 64 voxels an edge at the low corner of the shape.
    let lo = dims.map(|n| (n / 12) as i32);
    let hi = [0, 1, 2].map(|a| (lo[a] + 64).min(dims[a] as i32));
    Scene {
        window,
        lattice,
        core: CellBox { lo, hi },
    }
}

#[divan::bench(args = [1usize, 2, 4])]
fn pack_voxels(bencher: Bencher<'_, '_>, bytes: usize) {
    let voxel = [VoxelType::U8, VoxelType::U16, VoxelType::F32][bytes.trailing_zeros() as usize];
    let row = vec![17u8; bytes << 20];
    let mut out = vec![0u64; (1 << 20) / 64];
    let criterion = Criterion::AtLeast(100i128.into());
    let binarizer = Binarizer::new(criterion, voxel, ByteOrder::Little, None);
    bencher
        .counter(ItemsCount::new(1usize << 20))
        .bench_local(|| binarizer.pack_row(&row, &mut out));
}

#[divan::bench]
fn search_empty_planes(bencher: Bencher<'_, '_>) {
    let mut plane = BitPlane::outside(4096, 4096);
    // What is known of the plane would leave nothing to search.
    let _ = plane.rows_mut();
    let plane = Arc::new(plane);
    let window = PlaneWindow {
        dims: [4096, 4096, 2],
        z0: 0,
        planes: vec![plane; 2],
    };
    let lattice = Lattice::new([4096, 4096, 2], [1.0; 3], false).unwrap();
    bencher
        .counter(ItemsCount::new(1usize << 24))
        .bench_local(|| SurfelIndex::count_plane(&window, 1, &lattice));
}

#[divan::bench]
fn count_solid(bencher: Bencher<'_, '_>) {
    let scene = scene(6.0);
    let voxels = scene.lattice.dims[0] as usize * scene.lattice.dims[1] as usize;
    bencher
        .counter(ItemsCount::new(voxels))
        .bench_local(|| SolidCounts::of_plane(&scene.window, scene.core.lo[2] + 5));
}

#[divan::bench(args = RADII)]
fn extract_and_join(bencher: Bencher<'_, '_>, radius: f64) {
    let scene = scene(radius);
    let extract = || {
        Surface::extract(
            &scene.window,
            scene.core,
            &scene.lattice,
            Adjacency::Interior,
        )
    };
    bencher
        .counter(ItemsCount::new(extract().len()))
        .bench_local(extract);
}

#[divan::bench(args = RADII)]
fn integral_invariant_normals(bencher: Bencher<'_, '_>, radius: f64) {
    let estimator = Estimator::IntegralInvariant {
        radius,
        orientation: Orientation::Moment,
    };
    normals(bencher, radius, estimator);
}

#[divan::bench(args = RADII)]
fn surface_average_normals(bencher: Bencher<'_, '_>, radius: f64) {
    normals(bencher, radius, Estimator::SurfaceAverage { radius });
}

fn normals(bencher: Bencher<'_, '_>, radius: f64, estimator: Estimator) {
    let Scene {
        window,
        lattice,
        core,
    } = scene(radius);
    let surface = Surface::extract(&window, core, &lattice, Adjacency::Interior);
    let kernel = NormalKernel::new(estimator, &lattice, Adjacency::Interior).unwrap();
    bencher
        .counter(ItemsCount::new(surface.len()))
        .bench_local(|| kernel.estimate(&Around::bits(&window), &lattice, core, &surface.surfels));
}

#[divan::bench(args = RADII)]
fn measures_of_cells(bencher: Bencher<'_, '_>, radius: f64) {
    measures(bencher, radius, LUMPED);
}

#[divan::bench(args = RADII)]
fn measures_with_quality(bencher: Bencher<'_, '_>, radius: f64) {
    let quality = true;
    measures(bencher, radius, Asked { quality, ..LUMPED });
}

#[divan::bench(args = RADII)]
fn measures_of_an_interpolated_field(bencher: Bencher<'_, '_>, radius: f64) {
    let field = Field::Interpolated;
    measures(bencher, radius, Asked { field, ..LUMPED });
}

#[divan::bench(args = RADII)]
fn measures_of_a_linear_field(bencher: Bencher<'_, '_>, radius: f64) {
    let field = Field::Linear;
    measures(bencher, radius, Asked { field, ..LUMPED });
}

fn measures(bencher: Bencher<'_, '_>, radius: f64, asked: Asked) {
    let Scene {
        window,
        lattice,
        core,
    } = scene(radius);
    let around = core.grown([1; 3], lattice.cell_dims());
    let surface = Surface::extract(&window, around, &lattice, Adjacency::Interior);
    let owned = (0..surface.len())
        .filter(|&i| core.contains(surface.surfels.oriented(i).cell()))
        .count();
    let u = surface
        .surfels
        .list
        .iter()
        .map(|s| curvox::normal::trivial_normal(s.orientation));
    // tilted, so that no angle is special
    let u: Vec<_> = u
        .map(|n| (n + glam::DVec3::new(0.31, -0.17, 0.23)).normalize())
        .collect();
    let marks = vec![0; surface.len()];
    bencher
        .counter(ItemsCount::new(owned))
        .bench_local(|| evaluate(&surface, core, lattice.edges(), &u, &marks, asked));
}

#[divan::bench(args = RADII)]
fn connected_sums(bencher: Bencher<'_, '_>, radius: f64) {
    sums(bencher, radius, Extent::Connected);
}

#[divan::bench(args = RADII)]
fn whole_sums(bencher: Bencher<'_, '_>, radius: f64) {
    sums(bencher, radius, Extent::Whole);
}

fn sums(bencher: Bencher<'_, '_>, radius: f64, extent: Extent) {
    let Scene {
        window,
        lattice,
        core,
    } = scene(radius);
    let ball = BallKernel::new(radius, extent, Weights::Lumped, &lattice).unwrap();
    let around = core.grown(ball.reach(), lattice.cell_dims());
    let surface = Surface::extract(&window, around, &lattice, Adjacency::Interior);
    let normals = surface
        .surfels
        .list
        .iter()
        .map(|s| curvox::normal::trivial_normal(s.orientation));
    let u: Vec<_> = normals.collect();
    let marks = vec![0; surface.len()];
    let (cells, _) = evaluate(&surface, around, lattice.edges(), &u, &marks, LUMPED);
    let measures = LocalMeasures::new(&surface, cells);
    let starts: Vec<usize> = (0..surface.len())
        .filter(|&i| core.contains(surface.surfels.oriented(i).cell()))
        .collect();
    bencher
        .counter(ItemsCount::new(starts.len()))
        .bench_local(|| ball.sums(&surface, &measures, &starts));
}

#[divan::bench]
fn cut_a_box_of_bits(bencher: Bencher<'_, '_>) {
    let scene = scene(6.0);
    let (lo, hi) = (scene.core.lo.map(|x| x - 5), scene.core.hi.map(|x| x + 5));
    bencher.bench_local(|| BitBox::cut(&scene.window, lo, hi));
}
