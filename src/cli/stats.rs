//! `--stats`: what a run spent, as a table or as JSON.
//!
//! Comes in: what the pipeline measured, the plan, and the files that were written. Goes out: text on
//! standard error, or a file of JSON outside the results: results are the same bytes every time, and
//! times are not.

use std::fmt::Write;
use std::fs::{OpenOptions, remove_file};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use serde_json::{Value, json};

use crate::pipeline::{Plan, Stats};
use crate::sink::{SLICES_DIRECTORY, SURFELS_DIRECTORY};

use super::exit::usage;
use super::output::{Target, refuse_existing};
use super::sizes;

/// Where the statistics go.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum StatsTo {
    /// A table on standard error, or a line with `--json`.
    Stderr,
    /// JSON in a file.
    File(PathBuf),
}

impl StatsTo {
    /// What was asked for by `--stats[=FILE]`.
    ///
    /// # Errors
    /// If the file would be one of the results.
    pub(crate) fn of(asked: Option<&Option<PathBuf>>, target: &Target) -> Result<Option<Self>> {
        let Some(asked) = asked else { return Ok(None) };
        let Some(file) = asked else {
            return Ok(Some(Self::Stderr));
        };
        let absolute =
            |path: &Path| real(&std::path::absolute(path).unwrap_or_else(|_| path.into()));
        if let Target::Directory(results) | Target::Parquet(results) | Target::Csv(results) = target
            && absolute(file).starts_with(absolute(results))
        {
            return Err(usage(format!(
                "--stats={}: would be among the results, which are the same bytes for every run; choose \
                 another place",
                file.display()
            )));
        }
        Ok(Some(Self::File(file.clone())))
    }

    /// Makes sure, before the run, that the file can be written and is none of `inputs`.
    ///
    /// # Errors
    /// If it is one, or exists and is not to be replaced, or cannot be made.
    pub(crate) fn prepare(&self, inputs: [Option<&Path>; 2], overwrite: bool) -> Result<()> {
        let Self::File(path) = self else {
            return Ok(());
        };
        let place = real(path);
        for input in inputs.into_iter().flatten() {
            if place.starts_with(real(input)) {
                return Err(usage(format!("--stats={} is an input", path.display())));
            }
        }
        refuse_existing(path, overwrite)?;
        let exists = path.exists();
        let tried = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(path);
        let tried = tried.and_then(|_| if exists { Ok(()) } else { remove_file(path) });
        tried.map_err(|error| {
            anyhow::anyhow!("--stats={}: cannot be written: {error}", path.display())
        })
    }
}

/// A path with links followed as far as it exists: what is yet to be made is not there.
fn real(path: &Path) -> PathBuf {
    match (path.canonicalize(), path.parent(), path.file_name()) {
        (Ok(real), ..) => real,
        (Err(_), Some(parent), Some(name)) => real(parent).join(name),
        _ => path.into(),
    }
}

/// What was processed, known before and after the run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Amounts {
    pub(crate) voxels: u64,
    pub(crate) stored_bytes: u64,
    pub(crate) surfels: u64,
}

/// A sink and what it wrote.
#[derive(Clone, Debug, Serialize)]
struct Written {
    name: &'static str,
    seconds: f64,
    /// Not known of streams.
    bytes: Option<u64>,
    bytes_per_surfel: Option<f64>,
}

/// All that is told.
#[derive(Clone, Debug)]
pub(crate) struct RunStats {
    stats: Stats,
    plan: Plan,
    amounts: Amounts,
    written: Vec<Written>,
    seconds: f64,
    cpu_seconds: Option<f64>,
    peak_resident_bytes: Option<u64>,
}

impl RunStats {
    /// Of a run that has ended; `sinks` are the names of the sinks.
    pub(crate) fn new(
        stats: Stats,
        plan: Plan,
        amounts: Amounts,
        sinks: &[&'static str],
        target: &Target,
        started: Instant,
    ) -> Self {
        let written = sinks.iter().zip(&stats.sink_seconds);
        let written = written
            .map(|(&name, &seconds)| {
                let bytes = written_bytes(name, target);
                let per_surfel = |bytes: u64| bytes as f64 / amounts.surfels as f64;
                Written {
                    name,
                    seconds,
                    bytes,
                    bytes_per_surfel: bytes.filter(|_| amounts.surfels > 0).map(per_surfel),
                }
            })
            .collect();
        Self {
            stats,
            plan,
            amounts,
            written,
            seconds: started.elapsed().as_secs_f64(),
            cpu_seconds: cpu_seconds(),
            peak_resident_bytes: peak_resident_bytes(),
        }
    }

    /// Writes a file, or to standard error.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn tell(&self, to: &StatsTo, json: bool) -> Result<()> {
        use std::io::Write;
        let text = match to {
            StatsTo::File(path) => {
                let text = serde_json::to_string_pretty(&self.json())? + "\n";
                return std::fs::write(path, text).map_err(|error| {
                    anyhow::anyhow!("--stats={}: cannot be written: {error}", path.display())
                });
            }
            StatsTo::Stderr if json => {
                let mut line = self.json();
                line["event"] = "stats".into();
                format!("{line}\n")
            }
            StatsTo::Stderr => self.text(),
        };
        // Nobody may be reading; the results are written all the same.
        let _ = std::io::stderr().write_all(text.as_bytes());
        Ok(())
    }

    fn json(&self) -> Value {
        let Amounts {
            voxels,
            stored_bytes,
            surfels,
        } = self.amounts;
        json!({
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "stages_cpu_seconds": self.stages_cpu_seconds(),
            "threads": self.plan.threads,
            "voxels": voxels,
            "stored_bytes": stored_bytes,
            "surfels": surfels,
            "stages": self.stats.stages,
            "sinks": self.written,
            "memory": {
                "allowed_bytes": self.plan.memory_bytes,
                "planned_bits_bytes": self.plan.bits_bytes,
                "most_bits_bytes": self.stats.memory.bits_bytes,
                "planned_surfel_bytes": self.plan.in_flight_bytes(),
                "most_surfel_bytes": self.stats.memory.surfel_bytes,
                "bytes_per_surfel": self.plan.surfel_bytes,
                "planned_scratch_bytes": self.plan.scratch_bytes,
                "planned_fixed_bytes": self.plan.fixed_bytes,
                "peak_resident_bytes": self.peak_resident_bytes,
            },
        })
    }

    fn stages_cpu_seconds(&self) -> f64 {
        self.stats
            .stages
            .iter()
            .map(|stage| stage.cpu_seconds)
            .sum()
    }

    fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_text(&mut text);
        text
    }

    fn write_text(&self, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            "stage          busy s    CPU s   waits s: input   memory   output   CPU"
        )?;
        for stage in &self.stats.stages {
            let rate = match stage.name.as_str() {
                "read" => format!(
                    "{}, {:.2} GB/s",
                    per(stage.cpu_seconds, self.amounts.voxels, "voxel"),
                    self.amounts.stored_bytes as f64 * 1e-9 / stage.cpu_seconds.max(1e-9)
                ),
                _ => per(stage.cpu_seconds, self.amounts.surfels, "surfel"),
            };
            writeln!(
                out,
                "{:<12} {:>8.3} {:>8.3} {:>16.3} {:>8.3} {:>8.3}   {rate}",
                stage.name,
                stage.busy_seconds,
                stage.cpu_seconds,
                stage.input_seconds,
                stage.memory_seconds,
                stage.output_seconds,
            )?;
        }
        let stages = self.stages_cpu_seconds();
        writeln!(
            out,
            "{:<12} {:>8.3} {stages:>8.3} {:>35}{}",
            "stages",
            self.stats.seconds,
            "",
            per(stages, self.amounts.surfels, "surfel")
        )?;
        if let Some(cpu) = self.cpu_seconds {
            let note = "with what came before, and threads that wait";
            writeln!(
                out,
                "{:<12} {:>8.3} {cpu:>8.3} {:>35}{note}",
                "process", self.seconds, ""
            )?;
        }
        for sink in &self.written {
            let bytes = sink.bytes.map_or(String::new(), sizes::show);
            let each = sink
                .bytes_per_surfel
                .map_or(String::new(), |each| format!("{each:.2} bytes a surfel"));
            writeln!(
                out,
                "  {:<10} {:>8.3} {:>25} {each}",
                sink.name, sink.seconds, bytes
            )?;
        }
        let memory = &self.stats.memory;
        let each = self.plan.surfel_bytes;
        writeln!(out, "memory            planned      at most")?;
        let mut line = |name: &str, planned: u64, most: u64, note: String| {
            let (planned, most) = (sizes::show(planned), sizes::show(most));
            writeln!(out, "{name:<12} {planned:>12} {most:>12}   {note}")
        };
        let note = if memory.bits_bytes > self.plan.bits_bytes {
            "with what high slabs take of the surfels' memory"
        } else {
            ""
        };
        let note = note.to_owned();
        line("bits, index", self.plan.bits_bytes, memory.bits_bytes, note)?;
        let flying = sizes::count(memory.surfel_bytes / each.max(1));
        line(
            "surfels",
            self.plan.in_flight_bytes(),
            memory.surfel_bytes,
            format!("{flying} in flight, {each} bytes each"),
        )?;
        if let Some(peak) = self.peak_resident_bytes {
            line("resident", self.plan.memory_bytes, peak, String::new())?;
        }
        Ok(())
    }
}

/// Nanoseconds for each of some things.
fn per(seconds: f64, count: u64, what: &str) -> String {
    if count == 0 {
        return String::new();
    }
    let each = seconds * 1e9 / count as f64;
    let digits = if each < 10.0 { 3 } else { 0 };
    format!("{each:.digits$} ns a {what}")
}

/// Bytes of the files that the sink of this name wrote.
fn written_bytes(name: &str, target: &Target) -> Option<u64> {
    match (name, target) {
        ("table", Target::Directory(path)) => files_bytes(&path.join(SURFELS_DIRECTORY)),
        ("slices", Target::Directory(path)) => files_bytes(&path.join(SLICES_DIRECTORY)),
        ("table", Target::Parquet(path) | Target::Csv(path)) => {
            Some(std::fs::metadata(path).ok()?.len())
        }
        _ => None,
    }
}

fn files_bytes(folder: &Path) -> Option<u64> {
    let files = std::fs::read_dir(folder).ok()?;
    Some(
        files
            .filter_map(|file| Some(file.ok()?.metadata().ok()?.len()))
            .sum(),
    )
}

/// Processor time of the process.
#[cfg(unix)]
fn cpu_seconds() -> Option<f64> {
    let used = resources()?;
    let seconds = |time: libc::timeval| time.tv_sec as f64 + time.tv_usec as f64 * 1e-6;
    Some(seconds(used.ru_utime) + seconds(used.ru_stime))
}

#[cfg(unix)]
fn resources() -> Option<libc::rusage> {
    // SAFETY: all zeros is a valid rusage, which the call fills.
    let mut used: libc::rusage = unsafe { std::mem::zeroed() };
    // SAFETY: as above.
    let failed = unsafe { libc::getrusage(libc::RUSAGE_SELF, &mut used) } != 0;
    (!failed).then_some(used)
}

#[cfg(not(unix))]
fn cpu_seconds() -> Option<f64> {
    None
}

/// The most memory that was resident.
fn peak_resident_bytes() -> Option<u64> {
    // On Linux the resources of a process begin with those of the one that started it.
    #[cfg(target_os = "linux")]
    {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix("VmHWM:"))?;
        let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
        Some(kib << 10)
    }
    #[cfg(all(unix, not(target_os = "linux")))]
    {
        let unit = if cfg!(target_os = "macos") { 1 } else { 1024 };
        Some(u64::try_from(resources()?.ru_maxrss).ok()? * unit)
    }
    #[cfg(not(unix))]
    None
}
