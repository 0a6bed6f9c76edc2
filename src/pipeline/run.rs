//! Starts the stages, joins them, reports.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crossbeam_channel::bounded;
use rayon::ThreadPoolBuilder;

use crate::error::Error;
use crate::measure::cells::CellTotals;
use crate::normal::gradient::Sides;
use crate::sink::SurfelSink;
use crate::volume::{SolidCounts, ValueType};

use super::budget::Budget;
use super::plan::Plan;
use super::reader::{ReadCounts, Source, read};
use super::refining;
use super::scratch::Scratch;
use super::sending;
use super::settings::Settings;
use super::shared::{Progress, Shared};
use super::stages;
use super::stats::{self, Clock, MemoryStats, Stats};

/// What a run found, beside the rows.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Totals over the cells of the surface.
    pub cells: CellTotals,
    /// Counts over the voxels.
    pub solid: SolidCounts,
    /// What the reader learned.
    pub read: ReadCounts,
    /// Rows of the table of given normals that belong to no surfel.
    pub unmatched_normals: u64,
    /// The values on either side of the surfels, for normals made of values.
    pub sides: Sides,
    /// What it spent, if [`Progress::measured`].
    pub stats: Option<Stats>,
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
    let budget = Budget::new(plan.in_flight_bytes());
    let scratch = Scratch::new(plan.scratch_bytes, settings.threads);
    let failed = AtomicBool::new(false);
    let shared = Shared {
        settings,
        lattice: &settings.lattice,
        values: ValueType::of(&source.volume.header),
        kernels: &kernels,
        plan,
        pool: &pool,
        budget: &budget,
        scratch: &scratch,
        progress,
        stop,
        failed: &failed,
    };
    let shared = &shared;
    let started = Instant::now();
    let clock = |name: &str| Clock::new(name, progress.measured);
    let passes = (shared.kernels.refinement.as_ref()).map_or(0, |kernel| kernel.passes());
    let clocks = [
        clock("read"),
        clock("normals"),
        clock("cells"),
        clock("sums"),
        clock("sinks"),
    ];
    let [
        read_clock,
        normals_clock,
        cells_clock,
        sums_clock,
        sinks_clock,
    ] = &clocks;
    let pass_clocks: Vec<_> = (1..=passes)
        .map(|n| clock(&format!("refine {n}")))
        .collect();
    let pass_clocks = &pass_clocks;
    let sink_clocks: Vec<_> = sinks.iter().map(|_| clock("sink")).collect();
    let encoded_before = progress.measured.then(stats::global_pool_time);
    let mut outcome = std::thread::scope(|scope| {
        let (planes_out, planes_in) = bounded(1);
        let (normals_out, normals_in) = bounded(1);
        let (cells_out, cells_in) = bounded(1);
        let (rows_out, rows_in) = bounded(2);
        // Says that the input was sound to its end; only then may the sinks finish.
        let (sound_out, sound_in) = bounded(1);
        /// Runs a stage; a failure wakes the others.
        fn stage<T>(
            shared: &Shared<'_>,
            clock: &Clock,
            work: impl FnOnce() -> Result<T, Error>,
        ) -> Result<T, Error> {
            let result = clock.stage(work);
            if result.is_err() {
                shared.failed.store(true, Ordering::Relaxed);
            }
            result
        }
        // Each closure owns its ends of the channels, so they close when the stage returns.
        let reader = scope.spawn(move || {
            stage(shared, read_clock, || {
                let counts = read(source, shared, read_clock, planes_out)?;
                // Nobody listens only if the sinks have failed, which they report themselves.
                let _ = sound_out.send(());
                Ok(counts)
            })
        });
        let normals = scope.spawn(move || {
            stage(shared, normals_clock, || {
                let (planes_in, normals_out) = (planes_in, normals_out);
                stages::normals(shared, normals_clock, &planes_in, &normals_out)
            })
        });
        let mut normals_in = normals_in;
        let mut passes = Vec::new();
        if let Some(kernel) = &shared.kernels.refinement {
            for (number, clock) in pass_clocks.iter().enumerate() {
                let (refined_out, refined_in) = bounded(1);
                let input = std::mem::replace(&mut normals_in, refined_in);
                passes.push(scope.spawn(move || {
                    stage(shared, clock, || {
                        let (input, refined_out) = (input, refined_out);
                        refining::refine(shared, clock, kernel, number, &input, &refined_out)
                    })
                }));
            }
        }
        let cells = scope.spawn(move || {
            stage(shared, cells_clock, || {
                let (normals_in, cells_out) = (normals_in, cells_out);
                stages::cells(shared, cells_clock, &normals_in, &cells_out)
            })
        });
        let sums = scope.spawn(move || {
            stage(shared, sums_clock, || {
                let (cells_in, rows_out) = (cells_in, rows_out);
                stages::sums(shared, sums_clock, &cells_in, &rows_out)
            })
        });
        let sunk = stage(shared, sinks_clock, || {
            sending::sink(shared, sinks_clock, &sink_clocks, rows_in, &sound_in, sinks)
        });
        let reader = joined(reader);
        let normals = joined(normals);
        // All are joined before any is looked at.
        let passes: Vec<_> = passes.into_iter().map(joined).collect();
        let passes = passes.into_iter().collect();
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
        let normals = normals.map(|found| {
            outcome.solid = found.solid;
            outcome.unmatched_normals = found.unmatched_normals;
            outcome.sides = found.sides;
        });
        let cells = cells.map(|totals| outcome.cells = totals);
        for result in [sunk, reader, normals, passes, cells, sums] {
            note(result)?;
        }
        if stopped {
            return Err(Error::Stopped);
        }
        tracing::info!(
            surfels = outcome.cells.surfel_count(),
            inside_voxels = outcome.solid.voxels,
            nan_voxels = outcome.read.nan,
            "all rows written"
        );
        Ok(outcome)
    })?;
    if let Some(before) = encoded_before {
        sinks_clock.add_work(stats::global_pool_time().saturating_sub(before));
        let (first, last) = clocks.split_at(2);
        let clocks = first.iter().chain(pass_clocks).chain(last);
        let [surfel_bytes, bits_bytes] = budget.most_used();
        outcome.stats = Some(Stats {
            seconds: started.elapsed().as_secs_f64(),
            stages: clocks.map(Clock::stats).collect(),
            sink_seconds: sink_clocks.iter().map(|c| c.stats().seconds).collect(),
            memory: MemoryStats {
                surfel_bytes,
                bits_bytes,
            },
        });
    }
    Ok(outcome)
}

fn joined<T>(handle: std::thread::ScopedJoinHandle<'_, T>) -> T {
    handle
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
