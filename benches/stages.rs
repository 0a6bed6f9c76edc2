//! How long does each stage take, by radius, gridstep, noise and size of brick? Voxels or surfels per second on one
//! thread.
//!
//! The shape is Goursat's. Cases vary one thing at a time: the radius at the gridstep where it is the paper's, then from
//! 6 voxels the gridstep, the noise, the edge of the brick. The brick lies around a point of the surface in no special
//! direction. Cases that take long end after two seconds.

use std::convert::Infallible;
use std::sync::Arc;

use curvox::khalimsky::Adjacency;
use curvox::lattice::Lattice;
use curvox::measure::ball::{BallKernel, Compensation, Extent, LocalMeasures, Weights};
use curvox::measure::cells::{Asked, Keep};
use curvox::measure::evaluate;
use curvox::measure::field::Field;
use curvox::measure::surface::Surface;
use curvox::normal::{Around, Estimator, NormalKernel, Orientation};
use curvox::pipeline::Settings;
use curvox::shape::{Digitisation, Goursat, Grid, Noise, NoisyPlanes};
use curvox::sink::{DatasetSink, RadiusInfo, SurfelSink, TableInfo};
use curvox::surfel::{CellBox, SurfelIndex};
use curvox::volume::{Binarizer, BitBox, BitPlane, Criterion, PlaneWindow, SolidCounts};
use curvox_formats::{ByteOrder, VoxelType};
use curvox_tools::in_memory::rows_of;
use divan::{Bencher, counter::ItemsCount};

fn main() {
    divan::main();
}

/// A brick around a point of Goursat's surface, with all planes around it.
struct Scene {
    window: PlaneWindow,
    lattice: Lattice,
    core: CellBox,
}

/// What a stage is timed on.
#[derive(Clone, Copy, Debug)]
struct Case {
    /// Radius of normals or balls, in voxels.
    radius: f64,
    gridstep: f64,
    /// Probability that a voxel beside the surface flips.
    noise: f64,
    /// Edge of the brick, in voxels.
    brick: i32,
}

impl std::fmt::Display for Case {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Case {
            radius,
            gridstep,
            noise,
            brick,
        } = self;
        write!(
            f,
            "r {radius} h 1/{} noise {noise} brick {brick}",
            1.0 / gridstep
        )
    }
}

/// The radius is the paper's at this gridstep.
const fn of_paper(radius: f64) -> Case {
    Case {
        radius,
        gridstep: 9.0 / (radius * radius),
        noise: 0.0,
        brick: 64,
    }
}

/// A smaller brick of a finer grid.
const fn fine(brick: i32) -> Case {
    Case {
        gridstep: 0.0625,
        brick,
        ..of_paper(6.0)
    }
}

const CASES: [Case; 8] = [
    of_paper(3.0),
    of_paper(6.0),
    of_paper(12.0),
    Case {
        noise: 0.1,
        ..of_paper(6.0)
    },
    fine(64),
    fine(16),
    fine(32),
    fine(128),
];

/// Where on the surface the brick lies, seen from the centre.
const DIRECTION: [f64; 3] = [0.81, 0.49, 0.32];

/// Shapes whose rows are written.
const WRITTEN: [Case; 2] = [
    Case {
        gridstep: 0.25,
        ..of_paper(3.0)
    },
    Case {
        gridstep: 0.25,
        noise: 0.1,
        ..of_paper(3.0)
    },
];

const COMPENSATED: Weights = Weights::Compensated(Compensation::Averaged);

/// What of the cells the default method wants.
const LUMPED: Asked = Asked {
    field: Field::Constant,
    keep: Keep::Lumped,
    quality: false,
};

/// The voxels of a case, 1 inside, and their number along x, y, z.
fn digitised(case: Case) -> (Vec<u8>, [usize; 3]) {
    let digitisation = Digitisation::new(Goursat, Grid::cubic(case.gridstep)).unwrap();
    let dims = digitisation.dims();
    let source = |z: usize, out: &mut Vec<u8>| {
        digitisation.plane(z, out);
        Ok::<_, Infallible>(())
    };
    let noise = Noise::new(case.noise, 1).unwrap();
    let mut planes = NoisyPlanes::new(noise, dims, 0..dims[2], source);
    let (mut stored, mut plane) = (Vec::new(), Vec::new());
    while let Ok(Some(_)) = planes.next_plane::<Infallible>(&mut plane) {
        stored.extend_from_slice(&plane);
    }
    (stored, dims)
}

fn scene(case: Case) -> Scene {
    let (stored, dims) = digitised(case);
    let nx = dims[0];
    let criterion = Criterion::AtLeast(1i128.into());
    let binarizer = Binarizer::new(criterion, VoxelType::U8, ByteOrder::Little, None);
    let planes = stored
        .chunks(dims[0] * dims[1])
        .map(|stored| {
            let mut plane = BitPlane::outside(dims[0] as u32, dims[1] as u32);
            for (row, out) in stored.chunks(dims[0]).zip(plane.rows_mut()) {
                binarizer.pack_row(row, out);
            }
            Arc::new(plane)
        })
        .collect();
    let dims = dims.map(|n| n as u32);
    let lattice = Lattice::new(dims.map(u64::from), [case.gridstep; 3], false).unwrap();
    let window = PlaneWindow {
        dims,
        z0: 0,
        planes,
    };
    // From the centre outwards to the first voxel that is not inside.
    let outwards =
        |step: i32| DIRECTION.map(|d| (f64::from(step) * d) as i32 + (dims[0] / 2) as i32);
    let at = |[x, y, z]: [i32; 3]| (z as usize * nx + y as usize) * nx + x as usize;
    let surface = (0..).map(outwards).find(|&voxel| stored[at(voxel)] == 0);
    let edge = case.brick.min(dims[0] as i32);
    let lo = surface
        .unwrap()
        .map(|x| (x - edge / 2).clamp(0, dims[0] as i32 - edge));
    let hi = lo.map(|x| x + edge);
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
    let scene = scene(of_paper(6.0));
    let voxels = scene.lattice.dims[0] as usize * scene.lattice.dims[1] as usize;
    bencher
        .counter(ItemsCount::new(voxels))
        .bench_local(|| SolidCounts::of_plane(&scene.window, scene.core.lo[2] + 5));
}

#[divan::bench(args = CASES, max_time = 2)]
fn extract_and_join(bencher: Bencher<'_, '_>, case: Case) {
    let scene = scene(case);
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

#[divan::bench(args = CASES, max_time = 2)]
fn integral_invariant_normals(bencher: Bencher<'_, '_>, case: Case) {
    let estimator = Estimator::IntegralInvariant {
        radius: case.radius,
        orientation: Orientation::Moment,
    };
    normals(bencher, case, estimator);
}

#[divan::bench(args = CASES, max_time = 2)]
fn surface_average_normals(bencher: Bencher<'_, '_>, case: Case) {
    let radius = case.radius;
    normals(bencher, case, Estimator::SurfaceAverage { radius });
}

fn normals(bencher: Bencher<'_, '_>, case: Case, estimator: Estimator) {
    let Scene {
        window,
        lattice,
        core,
    } = scene(case);
    let surface = Surface::extract(&window, core, &lattice, Adjacency::Interior);
    let kernel = NormalKernel::new(estimator, &lattice, Adjacency::Interior).unwrap();
    bencher
        .counter(ItemsCount::new(surface.len()))
        .bench_local(|| kernel.estimate(&Around::bits(&window), &lattice, core, &surface.surfels));
}

#[divan::bench(args = CASES, max_time = 2)]
fn measures_of_cells(bencher: Bencher<'_, '_>, case: Case) {
    measures(bencher, case, LUMPED);
}

#[divan::bench(args = CASES, max_time = 2)]
fn measures_with_quality(bencher: Bencher<'_, '_>, case: Case) {
    let quality = true;
    measures(bencher, case, Asked { quality, ..LUMPED });
}

#[divan::bench(args = CASES, max_time = 2)]
fn measures_of_an_interpolated_field(bencher: Bencher<'_, '_>, case: Case) {
    let field = Field::Interpolated;
    measures(bencher, case, Asked { field, ..LUMPED });
}

#[divan::bench(args = CASES, max_time = 2)]
fn measures_of_a_linear_field(bencher: Bencher<'_, '_>, case: Case) {
    let field = Field::Linear;
    measures(bencher, case, Asked { field, ..LUMPED });
}

fn measures(bencher: Bencher<'_, '_>, case: Case, asked: Asked) {
    let Scene {
        window,
        lattice,
        core,
    } = scene(case);
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

#[divan::bench(args = CASES, max_time = 2)]
fn connected_lumped_sums(bencher: Bencher<'_, '_>, case: Case) {
    sums(bencher, case, Extent::Connected, Weights::Lumped);
}

#[divan::bench(args = CASES, max_time = 2)]
fn whole_lumped_sums(bencher: Bencher<'_, '_>, case: Case) {
    sums(bencher, case, Extent::Whole, Weights::Lumped);
}

#[divan::bench(args = CASES, max_time = 2)]
fn connected_compensated_sums(bencher: Bencher<'_, '_>, case: Case) {
    sums(bencher, case, Extent::Connected, COMPENSATED);
}

#[divan::bench(args = CASES, max_time = 2)]
fn whole_compensated_sums(bencher: Bencher<'_, '_>, case: Case) {
    sums(bencher, case, Extent::Whole, COMPENSATED);
}

fn sums(bencher: Bencher<'_, '_>, case: Case, extent: Extent, weights: Weights) {
    let Scene {
        window,
        lattice,
        core,
    } = scene(case);
    let ball = BallKernel::new(case.radius, extent, weights, &lattice).unwrap();
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
    let scene = scene(of_paper(6.0));
    let (lo, hi) = (scene.core.lo.map(|x| x - 5), scene.core.hi.map(|x| x + 5));
    bencher.bench_local(|| BitBox::cut(&scene.window, lo, hi));
}

#[divan::bench(args = WRITTEN, max_time = 2)]
fn write_parquet(bencher: Bencher<'_, '_>, case: Case) {
    let (stored, dims) = digitised(case);
    let lattice = Lattice::new(dims.map(|n| n as u64), [1.0; 3], false).unwrap();
    let settings = Settings::new(lattice);
    let inside = Criterion::AtLeast(1i128.into());
    let batches = rows_of(&stored, VoxelType::U8, inside, &settings).unwrap();
    let info = TableInfo {
        dims: dims.map(|n| n as u32),
        spacing: [1.0; 3],
        unit: "vx".into(),
        first_index: [0; 3],
        origin: [0.0; 3],
        direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        radii: vec![RadiusInfo {
            label: "3vx".into(),
            voxels: 3.0,
            world: 3.0,
        }],
        directions: false,
        errors: false,
        quality: false,
        parameters: serde_json::json!({}),
        version: String::new(),
        conventions: Vec::new(),
    };
    bencher
        .counter(ItemsCount::new(
            batches.iter().map(|batch| batch.len()).sum::<usize>(),
        ))
        .with_inputs(|| {
            let folder = tempfile::tempdir().unwrap();
            let sink = DatasetSink::create(folder.path(), info.clone(), None).unwrap();
            (folder, sink)
        })
        .bench_local_values(|(folder, mut sink)| {
            for batch in &batches {
                sink.write(batch).unwrap();
            }
            sink.finish().unwrap();
            // Its files are removed after the clock has stopped.
            folder
        });
}
