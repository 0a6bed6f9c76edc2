//! `curvox plan`: what a run would take, without running it. Writes nothing.

use std::fmt::Write;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::Args;
use curvox_formats::{Region, Voxels};
use serde_json::{Value, json};

use crate::error::Error;
use crate::sink::Parts;
use crate::volume::Binarizer;

use super::exit;
use super::job::{Job, JobArgs};
use super::method::in_words;
use super::output::Target;
use super::progress::Style;
use super::scale;
use super::sizes;

/// Arguments of `curvox plan`.
#[derive(Args, Clone, Debug)]
pub(crate) struct PlanArgs {
    #[command(flatten)]
    pub(crate) job: JobArgs,
}

/// Places where surfels are counted for the estimate. More read more of the file; fewer miss
/// small objects.
const SAMPLES: u64 = 16;

/// Stored bytes read at most for one sample; planes above that are not sampled.
const SAMPLE_BYTES: u64 = 64 << 20;

/// Bytes of a Parquet row, seen on scans: what does not depend on the radius, and for each radius
/// without and with directions, and what the quality and the error bars add.
const PARQUET_ROW: [u64; 5] = [19, 17, 41, 4, 2];

/// The same for CSV.
const CSV_ROW: [u64; 5] = [73, 50, 115, 13, 20];

/// Tells the plan.
pub(crate) fn run(args: &PlanArgs, stop: &AtomicBool) -> Result<()> {
    let args = &args.job;
    let target = args.output.maybe_target()?;
    let style = Style::choose(args.output.quiet, args.output.json, false);
    let job = args.prepare(style.of_bar(), stop)?;
    let surfels = estimate(&job)?;
    let text = if args.output.json {
        format!("{}\n", as_json(&job, surfels, target.as_ref()))
    } else {
        as_text(&job, surfels, target.as_ref())
    };
    exit::print(&text)
}

/// Surfels of the whole image, from pairs of planes spread over it; `None` if the input cannot be
/// read at any place.
fn estimate(job: &Job) -> Result<Option<u64>, Error> {
    let Voxels::Random(voxels) = &job.volume.voxels else {
        return Ok(None);
    };
    let header = &job.volume.header;
    let [nx, ny, nz] = header.dims;
    if header
        .plane_bytes()
        .is_none_or(|bytes| bytes > SAMPLE_BYTES / 2)
    {
        return Ok(None);
    }
    let samples = SAMPLES.min(nz);
    let mut buffer = Vec::new();
    let mut found = 0;
    for sample in 0..samples {
        // The middle of each of `samples` equal ranges of planes.
        let z = (2 * sample + 1) * nz / (2 * samples);
        let region = Region {
            origin: [0, 0, z],
            size: [nx, ny, 2.min(nz - z)],
        };
        voxels.read_box(&region, &mut buffer)?;
        let row_bytes = buffer.len() / (ny * region.size[2]).max(1) as usize;
        found += surfels_of(&buffer, row_bytes, ny as usize, nx as usize, &job.binarizer);
    }
    voxels.check()?;
    Ok(Some((found as f64 * nz as f64 / samples as f64) as u64))
}

/// Surfels in a plane and between it and the next, if that is there.
fn surfels_of(bytes: &[u8], row_bytes: usize, ny: usize, nx: usize, binarizer: &Binarizer) -> u64 {
    let words = nx.div_ceil(64);
    let rows: Vec<Vec<u64>> = bytes
        .chunks_exact(row_bytes)
        .map(|row| {
            let mut bits = vec![0; words];
            binarizer.pack_row(row, &mut bits);
            bits
        })
        .collect();
    let between = |a: &[u64], b: &[u64]| -> u64 {
        let pairs = a.iter().zip(b);
        pairs.map(|(a, b)| u64::from((a ^ b).count_ones())).sum()
    };
    let mut found = 0;
    for y in 0..ny.min(rows.len()) {
        let row = &rows[y];
        for w in 0..words {
            let next = row.get(w + 1).copied().unwrap_or(0);
            let shifted = row[w] >> 1 | next << 63;
            // Pairs of voxels x, x + 1 that are both in the image.
            let pairs = (nx - 1).saturating_sub(64 * w).min(64);
            let mask = if pairs == 64 { !0 } else { (1 << pairs) - 1 };
            found += u64::from(((row[w] ^ shifted) & mask).count_ones());
        }
        if y + 1 < ny {
            found += between(row, &rows[y + 1]);
        }
        if let Some(above) = rows.get(ny + y) {
            found += between(row, above);
        }
    }
    found
}

fn row_bytes(job: &Job, [fixed, plain, directed, quality, errors]: [u64; 5]) -> u64 {
    let each = if job.info.directions { directed } else { plain }
        + if job.info.quality { quality } else { 0 }
        + if job.info.errors { errors } else { 0 };
    fixed + each * job.info.radii.len() as u64
}

/// Bytes of the output: the name of the format, and of a row.
fn output_row(job: &Job, target: Option<&Target>) -> (&'static str, u64) {
    match target {
        Some(Target::Csv(_) | Target::Stdout | Target::Device(_)) => {
            ("CSV", row_bytes(job, CSV_ROW))
        }
        _ => ("Parquet", row_bytes(job, PARQUET_ROW)),
    }
}

fn columns(job: &Job) -> Vec<String> {
    let text = job
        .info
        .metadata()
        .into_iter()
        .find(|(key, _)| key == "curvox.columns")
        .map(|(_, value)| value)
        .unwrap_or_default();
    let value: Value = serde_json::from_str(&text).unwrap_or_default();
    value.as_array().map_or_else(Vec::new, |columns| {
        columns
            .iter()
            .filter_map(|column| column["name"].as_str().map(str::to_owned))
            .collect()
    })
}

fn as_json(job: &Job, surfels: Option<u64>, target: Option<&Target>) -> Value {
    let (format, bytes) = output_row(job, target);
    let header = &job.volume.header;
    json!({
        "input": {
            "format": header.format.name(),
            "dims": header.dims,
            "dtype": header.dtype().to_string(),
            "spacing": job.info.spacing,
            "unit": job.info.unit,
            "mapped": job.volume.source.mapped,
            "compressed": job.volume.source.compressed,
            "held_bytes": job.volume.source.held_bytes,
            "copied_bytes": job.volume.source.spilled_bytes,
        },
        "parameters": job.info.parameters,
        "radii": job.info.radii,
        "radius_choice": job.radius_choice,
        "otsu_threshold": job.otsu,
        "plan": job.plan,
        "parts": Parts::new(job.info.dims).count(),
        "columns": columns(job),
        "output_format": format,
        "output_bytes_per_row": bytes,
        "estimated_surfels": surfels,
        "estimated_output_bytes": surfels.map(|n| n * bytes),
    })
}

fn as_text(job: &Job, surfels: Option<u64>, target: Option<&Target>) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut text, job, surfels, target);
    text
}

fn write_text(
    out: &mut String,
    job: &Job,
    surfels: Option<u64>,
    target: Option<&Target>,
) -> std::fmt::Result {
    let header = &job.volume.header;
    let source = &job.volume.source;
    let [x, y, z] = job.info.dims;
    let voxels = u64::from(x) * u64::from(y) * u64::from(z);
    let access = match (&job.volume.voxels, source.mapped) {
        (Voxels::Random(_), true) => "mapped",
        (Voxels::Random(_), false) => "read at offsets",
        (Voxels::Forward(_), _) => "read once, forward",
    };
    writeln!(
        out,
        "input      {} of {}, {access}",
        header.format,
        header.dtype()
    )?;
    if source.spilled_bytes > 0 {
        writeln!(
            out,
            "copy       {} on disk, for the format is not read front to back",
            sizes::show(source.spilled_bytes)
        )?;
    }
    writeln!(out, "voxels     {x} x {y} x {z} = {}", sizes::count(voxels))?;
    let [sx, sy, sz] = job.info.spacing;
    writeln!(out, "voxel      {sx} x {sy} x {sz} {}", job.info.unit)?;
    if let Some(otsu) = job.otsu {
        writeln!(out, "threshold  {otsu} (Otsu)")?;
    }
    writeln!(out, "inside     {}", job.criterion)?;
    writeln!(out, "normals    {}", in_words(&job.info.parameters))?;
    for radius in &job.info.radii {
        writeln!(
            out,
            "radius     {} = {} voxels = {} {}",
            radius.label, radius.voxels, radius.world, job.info.unit
        )?;
    }
    if let Some(choice) = &job.radius_choice {
        let [chosen, medians] = scale::in_words(&json!(choice), &job.info.unit);
        writeln!(out, "chosen     {chosen}\n           {medians}")?;
    }
    let plan = &job.plan;
    writeln!(
        out,
        "cut        bricks of {0} x {0}, slabs of at most {1} {3}, {2} threads",
        plan.brick_edge,
        plan.slab_planes,
        plan.threads,
        if plan.slab_planes == 1 {
            "plane"
        } else {
            "planes"
        }
    )?;
    if let Some(chunks) = &plan.chunks {
        let [cx, cy, cz] = chunks.shape;
        let times = match chunks.decoded_times {
            1 => "each decoded once".to_owned(),
            n => format!("each decoded {n} times, since a layer of them does not fit the memory"),
        };
        writeln!(
            out,
            "pieces     {cx} x {cy} x {cz} voxels, read in layers of {} planes, {times}",
            chunks.layer_planes
        )?;
        if let Some(tiles) = chunks.tiles {
            writeln!(
                out,
                "sparse     {} boxes of 64 x {} x {} voxels are read and kept; the rest is known to be \
                 uniform\n             a surface scattered over more bricks than the memory of indices \
                 holds stops the run",
                sizes::count(tiles),
                chunks.band_rows,
                chunks.layer_planes
            )?;
        }
    }
    let passes = match plan.refining_reach.len() {
        0 => String::new(),
        n => format!(
            "{n} passes that refine them with {} planes together, ",
            plan.refining_ahead()
        ),
    };
    writeln!(
        out,
        "halo       {:?} voxels for normals, {passes}{:?} cells for sums",
        plan.normal_reach, plan.ball_reach
    )?;
    writeln!(
        out,
        "memory     {} allowed:",
        sizes::show(plan.memory_bytes)
    )?;
    let index_bytes = plan.index_bytes().unwrap_or(0);
    for (what, bytes) in [
        ("program, reader, sinks", plan.fixed_bytes),
        ("read buffer", plan.read_bytes),
        (
            if index_bytes > 0 {
                "bits"
            } else {
                "bits and indices"
            },
            plan.bits_bytes,
        ),
        ("grey values", plan.grey_bytes),
        ("indices", index_bytes),
        ("scratch of workers", plan.scratch_bytes),
        ("surfels in flight", plan.in_flight_bytes()),
        (
            "rows of a slab",
            plan.surfel_budget_bytes - plan.in_flight_bytes(),
        ),
    ] {
        if bytes == 0 && matches!(what, "grey values" | "indices") {
            continue;
        }
        writeln!(out, "             {what:<22} {:>12}", sizes::show(bytes))?;
    }
    writeln!(
        out,
        "             room for {} surfels of {} bytes in flight",
        sizes::count(plan.in_flight_bytes() / plan.surfel_bytes.max(1)),
        plan.surfel_bytes
    )?;
    writeln!(out, "columns    {}", columns(job).join(" "))?;
    writeln!(out, "parts      {}", Parts::new(job.info.dims).count())?;
    let (format, bytes) = output_row(job, target);
    match surfels {
        Some(n) => writeln!(
            out,
            "output     about {} surfels (counted on {} of {z} planes), about {} as {format} \
             ({bytes} bytes a row, as seen on scans)",
            sizes::count(n),
            SAMPLES.min(u64::from(z)),
            sizes::show(n * bytes)
        ),
        None => writeln!(
            out,
            "output     about {bytes} bytes a surfel as {format}; how many surfels there are is only \
             known by reading, and this input cannot be sampled"
        ),
    }
}
