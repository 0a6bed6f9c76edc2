//! Starts the stages, joins them, reports.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crossbeam_channel::bounded;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::Error;
use crate::khalimsky::Adjacency;
use crate::lattice::Lattice;
use crate::measure::ball::{BallKernel, Extent, Weights};
use crate::measure::cells::CellTotals;
use crate::normal::{Estimator, NormalKernel, Orientation};
use crate::sink::SurfelSink;
use crate::volume::SolidCounts;

use super::budget::Budget;
use super::plan::{Plan, PlanRequest};
use super::reader::{ReadCounts, Source, read};
use super::stages;

/// What to compute.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The voxel grid.
    pub lattice: Lattice,
    /// Which surfels join at a linel shared by four.
    pub adjacency: Adjacency,
    /// The normals.
    pub estimator: Estimator,
    /// Radii of the balls of the measures, in voxel units.
    pub radii: Vec<f64>,
    /// Which part of the surface in a ball is summed.
    pub extent: Extent,
    /// How cells at its rim count.
    pub weights: Weights,
    /// Whether to give principal directions.
    pub directions: bool,
    /// Worker threads.
    pub threads: usize,
    /// Memory allowed.
    pub memory_bytes: u64,
    /// Edge of bricks, if it is to be fixed.
    pub brick: Option<i32>,
}

/// Settings made ready.
pub(super) struct Kernels {
    pub(super) normals: NormalKernel,
    pub(super) balls: Vec<BallKernel>,
}

impl Settings {
    /// The default method on a lattice: integral invariant normals and connected, lumped sums at 3
    /// voxel units, one radius, within 1 GiB, on all processors.
    #[must_use]
    pub fn new(lattice: Lattice) -> Self {
        Self {
            lattice,
            adjacency: Adjacency::Interior,
            estimator: Estimator::IntegralInvariant {
                radius: 3.0,
                orientation: Orientation::Moment,
            },
            radii: vec![3.0],
            extent: Extent::Connected,
            weights: Weights::Lumped,
            directions: false,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            memory_bytes: 1 << 30,
            brick: None,
        }
    }

    fn kernels(&self) -> Result<Kernels, Error> {
        let normals = NormalKernel::new(self.estimator, &self.lattice, self.adjacency)?;
        let balls = self
            .radii
            .iter()
            .map(|&radius| BallKernel::new(radius, self.extent, self.weights, &self.lattice))
            .collect::<Result<_, _>>()?;
        Ok(Kernels { normals, balls })
    }

    /// How a run of these settings would use its memory.
    ///
    /// # Errors
    /// If radii cannot be used or the memory is too small.
    pub fn plan(&self, voxel_bytes: u64, buffered: bool, sink_bytes: u64) -> Result<Plan, Error> {
        let kernels = self.kernels()?;
        Ok(Plan::new(&PlanRequest {
            lattice: &self.lattice,
            normals: &kernels.normals,
            balls: &kernels.balls,
            directions: self.directions,
            memory_bytes: self.memory_bytes,
            sink_bytes,
            threads: self.threads,
            brick: self.brick,
            voxel_bytes,
            buffered,
        })?)
    }
}

/// How far a run is; read it from any thread.
#[derive(Debug, Default)]
pub struct Progress {
    /// Planes read and packed.
    pub planes_read: AtomicU64,
    /// Surfels found.
    pub surfels_found: AtomicU64,
    /// Planes whose rows were handed to the sinks.
    pub planes_done: AtomicU64,
    /// Rows handed to the sinks.
    pub rows_done: AtomicU64,
}

/// What a run found, beside the rows.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Totals over the cells of the surface.
    pub cells: CellTotals,
    /// Counts over the voxels.
    pub solid: SolidCounts,
    /// What the reader learned.
    pub read: ReadCounts,
}

/// What all stages share.
pub(super) struct Shared<'a> {
    pub(super) settings: &'a Settings,
    pub(super) lattice: &'a Lattice,
    pub(super) kernels: &'a Kernels,
    pub(super) plan: &'a Plan,
    pub(super) pool: &'a ThreadPool,
    pub(super) budget: &'a Arc<Budget>,
    pub(super) progress: &'a Progress,
    /// Set from outside to stop the run.
    stop: &'a AtomicBool,
    /// Set by a stage that failed, so that stages that wait for memory wake up.
    failed: &'a AtomicBool,
}

impl Shared<'_> {
    /// Whether the run is to end early. Raises the flag that wakes stages that wait.
    pub(super) fn stopped(&self) -> bool {
        if self.stop.load(Ordering::Relaxed) {
            self.failed.store(true, Ordering::Relaxed);
        }
        self.failed.load(Ordering::Relaxed)
    }
}

/// Runs the pipeline to its end: every row goes to every sink, in order, and the sinks finish.
///
/// `stop` may be set from any thread; the run then returns [`Error::Stopped`] as soon as the
/// bricks in work are done (and, for an input that blocks, its next bytes have come), and the
/// sinks are left as they are when dropped: what is complete stays.
///
/// # Errors
/// The first error of any stage.
///
/// # Panics
/// If a stage panics, which is a bug.
pub fn run(
    source: Source,
    settings: &Settings,
    plan: &Plan,
    sinks: &mut [&mut dyn SurfelSink],
    progress: &Progress,
    stop: &AtomicBool,
) -> Result<Outcome, Error> {
    let kernels = settings.kernels()?;
    let pool = ThreadPoolBuilder::new()
        .num_threads(settings.threads)
        .thread_name(|i| format!("curvox-{i}"))
        .build()
        .map_err(|e| Error::Threads(e.to_string()))?;
    let budget = Budget::new(plan.surfel_budget_bytes / 4 * 3);
    let failed = AtomicBool::new(false);
    let shared = Shared {
        settings,
        lattice: &settings.lattice,
        kernels: &kernels,
        plan,
        pool: &pool,
        budget: &budget,
        progress,
        stop,
        failed: &failed,
    };
    let shared = &shared;
    std::thread::scope(|scope| {
        let (planes_out, planes_in) = bounded(1);
        let (normals_out, normals_in) = bounded(1);
        let (cells_out, cells_in) = bounded(1);
        let (rows_out, rows_in) = bounded(2);
        // Says that the input was sound to its end; only then may the sinks finish.
        let (sound_out, sound_in) = bounded(1);
        /// Runs a stage; a failure wakes the others.
        fn stage<T>(
            shared: &Shared<'_>,
            work: impl FnOnce() -> Result<T, Error>,
        ) -> Result<T, Error> {
            let result = work();
            if result.is_err() {
                shared.failed.store(true, Ordering::Relaxed);
            }
            result
        }
        // Each closure owns its ends of the channels, so they close when the stage returns.
        let reader = scope.spawn(move || {
            stage(shared, || {
                let counts = read(source, shared, planes_out)?;
                // Nobody listens only if the sinks have failed, which they report themselves.
                let _ = sound_out.send(());
                Ok(counts)
            })
        });
        let normals = scope.spawn(move || {
            stage(shared, || {
                let (planes_in, normals_out) = (planes_in, normals_out);
                stages::normals(shared, &planes_in, &normals_out)
            })
        });
        let cells = scope.spawn(move || {
            stage(shared, || {
                let (normals_in, cells_out) = (normals_in, cells_out);
                stages::cells(shared, &normals_in, &cells_out)
            })
        });
        let sums = scope.spawn(move || {
            stage(shared, || {
                let (cells_in, rows_out) = (cells_in, rows_out);
                stages::sums(shared, &cells_in, &rows_out)
            })
        });
        let sunk = stage(shared, || stages::sink(shared, rows_in, &sound_in, sinks));
        let reader = joined(reader);
        let normals = joined(normals);
        let cells = joined(cells);
        let sums = joined(sums);
        let mut outcome = Outcome::default();
        let mut stopped = false;
        // The first error in the order of the stages that is not an echo of another's.
        let mut note = |result: Result<(), Error>| match result {
            Err(Error::Stopped) => {
                stopped = true;
                Ok(())
            }
            other => other,
        };
        let reader = reader.map(|read| outcome.read = read);
        let normals = normals.map(|solid| outcome.solid = solid);
        let cells = cells.map(|totals| outcome.cells = totals);
        for result in [sunk, reader, normals, cells, sums] {
            note(result)?;
        }
        if stopped {
            return Err(Error::Stopped);
        }
        Ok(outcome)
    })
}

fn joined<T>(handle: std::thread::ScopedJoinHandle<'_, T>) -> T {
    handle
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
