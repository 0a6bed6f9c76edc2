pub(crate) mod pieces;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use curvox::Error;
use curvox::curvature::Curvature;
use curvox::lattice::Lattice;
use curvox::measure::ball::{BallKernel, BallSums, LocalMeasures};
use curvox::measure::cells::{Asked, CellTotals, mark};
use curvox::measure::evaluate;
use curvox::measure::surface::Surface;
use curvox::normal::refine::{Estimate, RefineKernel, settled};
use curvox::normal::{Around, NormalKernel};
use curvox::pipeline::{Access, Outcome, Plan, Progress, Settings, Source, run};
use curvox::sink::SurfelBatch;
use curvox::surfel::CellBox;
use curvox::volume::{Binarizer, BitPlane, Criterion, PlaneWindow, SolidCounts};
use curvox_formats::{DType, OpenOptions, RawLayout, Unit, VoxelType, open_stream};
pub(crate) use curvox_tools::in_memory::Collected;
use curvox_tools::plain::Solid;
use glam::DVec3;

/// Counter-based random numbers in [0, 1).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Each voxel inside with probability `p`.
pub(crate) fn noise(dims: [usize; 3], p: f64, seed: u64) -> Solid {
    let mut random = Random(seed);
    let inside = (0..dims.iter().product())
        .map(|_| random.next() < p)
        .collect();
    Solid { dims, inside }
}

/// A lumpy blob with noise at its rim: curved, flat and torn places.
pub(crate) fn blob(dims: [usize; 3], seed: u64) -> Solid {
    let mut random = Random(seed);
    let balls: Vec<[f64; 4]> = (0..5)
        .map(|_| {
            let c = [0, 1, 2].map(|a: usize| dims[a] as f64 * (0.2 + 0.6 * random.next()));
            [
                c[0],
                c[1],
                c[2],
                dims.iter().min().map_or(1.0, |&n| n as f64) * (0.1 + 0.2 * random.next()),
            ]
        })
        .collect();
    let mut noise = Random(seed ^ 77);
    Solid::from_fn(dims, |p| {
        balls.iter().any(|b| {
            let d = [0, 1, 2].map(|a| f64::from(p[a]) - b[a]);
            (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt() <= b[3]
        })
    })
    .with_flips(&mut noise, 0.01)
}

pub(crate) trait WithFlips {
    fn with_flips(self, random: &mut Random, p: f64) -> Self;
}

impl WithFlips for Solid {
    fn with_flips(mut self, random: &mut Random, p: f64) -> Self {
        for voxel in &mut self.inside {
            *voxel ^= random.next() < p;
        }
        self
    }
}

pub(crate) fn lattice(solid: &Solid, spacing: [f64; 3], closed: bool) -> Lattice {
    Lattice::new(solid.dims.map(|n| n as u64), spacing, closed).unwrap()
}

/// The voxels of a solid as bits.
pub(crate) fn window(solid: &Solid) -> PlaneWindow {
    let dims = solid.dims.map(|n| n as u32);
    let planes = solid
        .inside
        .chunks(solid.dims[0] * solid.dims[1])
        .map(|stored| {
            let mut plane = BitPlane::outside(dims[0], dims[1]);
            for (row, out) in stored.chunks(solid.dims[0]).zip(plane.rows_mut()) {
                for (x, &inside) in row.iter().enumerate() {
                    out[x / 64] |= u64::from(inside) << (x % 64);
                }
            }
            Arc::new(plane)
        })
        .collect();
    PlaneWindow {
        dims,
        z0: 0,
        planes,
    }
}

/// One surfel as computed in full precision, the volume taken as a single brick.
pub(crate) struct FullRow {
    pub(crate) k: [i32; 3],
    pub(crate) u: DVec3,
    pub(crate) marks: u8,
    pub(crate) sums: BallSums,
    pub(crate) curvature: Option<Curvature>,
}

/// All of a volume as a single brick, at the first radius.
pub(crate) struct Whole {
    pub(crate) rows: Vec<FullRow>,
    pub(crate) totals: CellTotals,
    pub(crate) solid: SolidCounts,
}

/// What of the cells a run with these settings evaluates.
pub(crate) fn asked(settings: &Settings) -> Asked {
    Asked {
        field: settings.field,
        keep: settings.weights.keep(settings.field),
        quality: settings.quality,
    }
}

pub(crate) fn whole(solid: &Solid, settings: &Settings) -> Whole {
    whole_with(solid, settings, None)
}

/// The boundary of a solid as a single brick.
pub(crate) fn surface(solid: &Solid, settings: &Settings) -> (Surface, CellBox) {
    let core = CellBox {
        lo: [0; 3],
        hi: settings.lattice.cell_dims(),
    };
    let window = window(solid);
    let surface = Surface::extract(&window, core, &settings.lattice, settings.adjacency);
    (surface, core)
}

/// The same with these normals instead of estimated ones, if they are given.
pub(crate) fn whole_with(solid: &Solid, settings: &Settings, given: Option<&[DVec3]>) -> Whole {
    let lattice = &settings.lattice;
    let window = window(solid);
    let (surface, core) = surface(solid, settings);
    let mut normals = NormalKernel::new(settings.estimator, lattice, settings.adjacency)
        .unwrap()
        .estimate(&Around::bits(&window), lattice, core, &surface.surfels);
    if let Some(given) = given {
        normals.u = given.to_vec();
    }
    if let Some(radius) = settings.refinement {
        normals.u = refined(&surface, radius, lattice, &normals.u, &normals.degenerate);
    }
    let marks: Vec<u8> = normals
        .degenerate
        .iter()
        .map(|&d| if d { mark::DEGENERATE } else { 0 })
        .collect();
    let edges = lattice.edges();
    let (cells, totals) = evaluate(&surface, core, edges, &normals.u, &marks, asked(settings));
    let marks = cells.marks.clone();
    let measures = LocalMeasures::new(&surface, cells);
    let ball = BallKernel::new(
        settings.radii[0],
        settings.extent,
        settings.weights,
        lattice,
    )
    .unwrap();
    let starts: Vec<usize> = (0..surface.len()).collect();
    let rows = ball
        .sums(&surface, &measures, &starts)
        .into_iter()
        .enumerate()
        .map(|(i, sums)| FullRow {
            k: surface.surfels.khalimsky(i),
            u: normals.u[i],
            marks: marks[i],
            curvature: Curvature::from_sums(&sums, normals.u[i], lattice.voxel_unit_world()),
            sums,
        })
        .collect();
    let mut counts = SolidCounts::default();
    for z in 0..=lattice.dims[2] as i32 {
        counts.add(&SolidCounts::of_plane(&window, z));
    }
    Whole {
        rows,
        totals,
        solid: counts,
    }
}

/// All passes that refine normals.
pub(crate) fn refined(
    surface: &Surface,
    radius: f64,
    lattice: &Lattice,
    first: &[DVec3],
    degenerate: &[bool],
) -> Vec<DVec3> {
    let kernel = RefineKernel::new(radius, lattice).unwrap();
    let starts: Vec<usize> = (0..surface.len()).collect();
    let mut around: Vec<Estimate> = (first.iter())
        .map(|&u| Estimate {
            u,
            offset: 0.0,
            cut: false,
        })
        .collect();
    let mut last = Vec::new();
    for number in 0..kernel.passes() {
        last = kernel.pass(number, surface, &around, &starts);
        for (i, refined) in last.iter_mut().enumerate() {
            if degenerate[i] {
                (refined.estimate.u, refined.estimate.offset) = (first[i], 0.0);
            }
        }
        around = last.iter().map(|refined| refined.estimate).collect();
    }
    let settled = last
        .iter()
        .zip(first)
        .map(|(refined, &u)| settled(refined, u));
    settled.collect()
}

/// The voxels of a solid as an open volume.
pub(crate) fn source(solid: &Solid) -> Source {
    let bytes: Vec<u8> = solid.inside.iter().map(|&v| u8::from(v)).collect();
    let options = OpenOptions {
        raw: Some(RawLayout {
            dims: solid.dims.map(|n| n as u64),
            dtype: DType::little(VoxelType::U8),
            spacing: None,
            unit: Unit::Unknown,
            skip: 0,
        }),
        ..Default::default()
    };
    let volume = open_stream(Box::new(std::io::Cursor::new(bytes)), "test", &options).unwrap();
    let header = &volume.header;
    let criterion = Criterion::AtLeast(1i128.into());
    let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, header.scaling);
    Source { volume, binarizer }
}

/// Runs the pipeline on a solid.
pub(crate) fn tried(solid: &Solid, settings: &Settings) -> Result<(SurfelBatch, Outcome), Error> {
    let plan = settings.plan(&Access::forward(1), 0)?;
    tried_with(solid, settings, &plan)
}

/// Runs the pipeline on a solid with a plan of one's own.
pub(crate) fn tried_with(
    solid: &Solid,
    settings: &Settings,
    plan: &Plan,
) -> Result<(SurfelBatch, Outcome), Error> {
    let mut rows = Collected::default();
    let outcome = run(
        source(solid),
        settings,
        plan,
        &mut [&mut rows],
        &Progress::default(),
        &AtomicBool::new(false),
    )?;
    Ok((rows.joined(), outcome))
}

/// Runs the pipeline on a solid, which must work.
pub(crate) fn piped(solid: &Solid, settings: &Settings) -> (SurfelBatch, Outcome) {
    tried(solid, settings).unwrap()
}

/// Bits of all floats, so that NaN equals itself.
pub(crate) fn bits(batch: &SurfelBatch) -> Vec<u64> {
    let mut out: Vec<u64> = Vec::new();
    let mut ints = |v: &[i32]| out.extend(v.iter().map(|&x| x as u64));
    batch.k.iter().for_each(|v| ints(v));
    out.extend(batch.side.iter().map(|&x| x as u64));
    let mut floats = |v: &[f32]| out.extend(v.iter().map(|x| u64::from(x.to_bits())));
    batch
        .position
        .iter()
        .chain(&batch.normal)
        .for_each(|v| floats(v));
    floats(&batch.area);
    for c in &batch.curvatures {
        for v in [&c.mean, &c.gaussian, &c.k1, &c.k2, &c.quality] {
            floats(v);
        }
        floats(&c.mean_error);
        floats(&c.gaussian_error);
        c.d1.iter().chain(&c.d2).for_each(|v| floats(v));
    }
    for c in &batch.curvatures {
        out.extend(c.flags.iter().map(|&f| u64::from(f)));
    }
    out
}
