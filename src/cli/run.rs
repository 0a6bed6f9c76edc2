//! `curvox run`: from a volume to curvatures.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use serde_json::{Map, Value, json};

use crate::error::Error;
use crate::pipeline::{Progress, Source, run as run_pipeline};
use crate::sink::{RunState, SummarySink, SurfelSink};

use super::exit;
use super::input;
use super::job::{Job, JobArgs};
use super::output::Target;
use super::progress::{self, Style};
use super::report;
use super::stats::{Amounts, RunStats, StatsTo};

/// Arguments of `curvox run`.
#[derive(Args, Clone, Debug)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    pub(crate) job: JobArgs,

    /// Tell at the end what the stages spent: time, waits, memory, bytes written
    ///
    /// On standard error as a table (a JSON line with --json), or as JSON in a file that is not among the
    /// results: those are the same bytes for every run. With --stats=FILE the equals sign is needed; a file that
    /// exists is replaced with --overwrite only.
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, help_heading = "Messages")]
    stats: Option<Option<PathBuf>>,
}

/// Runs.
pub(crate) fn run(args: &RunArgs, verbose: bool, stop: &AtomicBool) -> Result<()> {
    let job_args = &args.job;
    let started = Instant::now();
    let target = job_args.output.target()?;
    let stats_to = StatsTo::of(args.stats.as_ref(), &target)?;
    let style = Style::choose(job_args.output.quiet, job_args.output.json, verbose);
    let job = job_args.prepare(style.of_bar(), stop)?;
    refuse_input_as_output(job.volume.source.path.as_deref(), &target)?;
    refuse_normals_as_output(job_args.method.normals_from(), &target)?;
    if let Some(to) = &stats_to {
        let inputs = [
            job.volume.source.path.as_deref(),
            job_args.method.normals_from(),
        ];
        to.prepare(inputs, job_args.output.overwrite)?;
    }
    let plan = &job.plan;
    tracing::info!(
        brick_edge = plan.brick_edge,
        slab_planes = plan.slab_planes,
        threads = plan.threads,
        halo = ?plan.ball_reach,
        "planned"
    );
    tracing::debug!(?plan, "memory in bytes");
    let mut sinks = job_args.output.open(
        &target,
        &job.info,
        asked(job_args, &job),
        fingerprint(job_args, &job),
        job.settings.memory_bytes,
    )?;
    let mut totals = SummarySink::new(job.info.clone())?;
    let header = &job.volume.header;
    let voxels = header.dims.iter().product();
    let stored_bytes = voxels * header.voxel.bytes() as u64;
    let facts = report::Facts::of(&job);
    let Job {
        volume,
        binarizer,
        settings,
        plan,
        ..
    } = job;
    let recorder = sinks.recorder.clone();
    let work = || -> Result<(report::Report, Option<RunStats>)> {
        let mut outcome = {
            let mut list: Vec<&mut dyn SurfelSink> = vec![&mut totals];
            for sink in &mut sinks.list {
                list.push(sink.as_mut());
            }
            let source = Source { volume, binarizer };
            let progress = Progress {
                measured: stats_to.is_some(),
                ..Progress::default()
            };
            let planes = settings.lattice.cell_dims()[2].unsigned_abs().into();
            progress::watched(
                |done| progress::show(style, &progress, planes, done),
                || run_pipeline(source, &settings, &plan, &mut list, &progress, stop),
            )
            // Ctrl-C ends the whole pipeline of a shell: an input that then ends is no bad input.
            .map_err(|error| {
                if stop.load(Ordering::Relaxed) {
                    Error::Stopped
                } else {
                    error
                }
            })?
        };
        let summary = totals.summary(facts.run_facts(&settings.lattice, &outcome, &totals));
        sinks.write_summary(&summary)?;
        let stats = outcome.stats.take().map(|stats| {
            let amounts = Amounts {
                voxels,
                stored_bytes,
                surfels: outcome.cells.surfel_count(),
            };
            let names: Vec<_> = std::iter::once("totals")
                .chain(sinks.names.iter().copied())
                .collect();
            RunStats::new(stats, plan, amounts, &names, &target, started)
        });
        let report = report::Report {
            summary,
            otsu: facts.otsu,
            target: target.clone(),
            seconds: started.elapsed().as_secs_f64(),
        };
        Ok((report, stats))
    };
    let result = work();
    if let Some(recorder) = recorder {
        let (state, message) = match &result {
            Ok(_) => (RunState::Complete, None),
            Err(error) => (RunState::Failed, Some(exit::message(error))),
        };
        // The first error is the one to report.
        recorder.end(state, message).or_else(
            |error| {
                if result.is_ok() { Err(error) } else { Ok(()) }
            },
        )?;
    }
    let (report, stats) = result?;
    if job_args.output.json {
        let line = format!("{}\n", report.json());
        if target == Target::Stdout {
            let _ = std::io::stderr().write_all(line.as_bytes());
        } else {
            std::io::stdout()
                .write_all(line.as_bytes())
                .map_err(exit::stdout_error)?;
        }
    } else if !job_args.output.quiet {
        // Nobody may be reading; the results are written all the same.
        let _ = std::io::stderr().write_all(report.text().as_bytes());
    }
    if let (Some(stats), Some(to)) = (stats, stats_to) {
        stats.tell(&to, job_args.output.json)?;
    }
    Ok(())
}

/// The request, for `run.json`.
fn asked(args: &JobArgs, job: &Job) -> Value {
    json!({
        "arguments": std::env::args_os().skip(1).map(|a| input::shown(&a)).collect::<Vec<_>>(),
        "parameters": job.info.parameters,
        "normals_from": args.method.normals_from().map(|path| json!({
            "path": std::path::absolute(path).unwrap_or_else(|_| path.to_owned()),
            "modified": input::modified(path),
        })),
        "memory_bytes": args.resources.memory,
        "threads": job.settings.threads,
        "brick": args.resources.brick,
    })
}

/// Refuses to write the results over the image they come from.
pub(crate) fn refuse_input_as_output(input: Option<&Path>, target: &Target) -> Result<()> {
    let (Some(input), Target::Parquet(output) | Target::Csv(output)) = (input, target) else {
        return Ok(());
    };
    match (input.canonicalize(), output.canonicalize()) {
        (Ok(input), Ok(output)) if input == output => Err(exit::usage(format!(
            "-o {} is the input itself",
            output.display()
        ))),
        _ => Ok(()),
    }
}

/// Refuses to write the results over the normals they are made with.
fn refuse_normals_as_output(normals: Option<&Path>, target: &Target) -> Result<()> {
    let (Some(normals), Target::Directory(output) | Target::Parquet(output) | Target::Csv(output)) =
        (normals, target)
    else {
        return Ok(());
    };
    match (normals.canonicalize(), output.canonicalize()) {
        // A part of a table lies in the directory that would be replaced.
        (Ok(normals), Ok(output)) if normals.starts_with(&output) => Err(exit::usage(format!(
            "-o {} holds the normals of --normals-from",
            output.display()
        ))),
        _ => Ok(()),
    }
}

/// What tells the input from another, for `run.json`.
fn fingerprint(args: &JobArgs, job: &Job) -> Value {
    let (header, source) = (&job.volume.header, &job.volume.source);
    let path = source.path.as_deref();
    let details = header.details.iter();
    let details: Map<String, Value> = details
        .map(|(name, value)| ((*name).to_owned(), json!(value)))
        .collect();
    json!({
        "name": args.input.name(),
        "path": path.map(|p| std::path::absolute(p).unwrap_or_else(|_| p.to_owned())),
        "size_bytes": source.length_bytes,
        "modified": path.and_then(input::modified),
        "format": header.format.name(),
        "dims": header.dims,
        "dtype": header.dtype().to_string(),
        "first_index": header.first_index,
        "chosen": args.input.chosen(),
        "details": details,
    })
}
