//! Runs of the `curvox` command, as a user would make them.
//!
//! Comes in: a [`Run`], which is a solid, a gridstep and a [`Method`]. Goes out: a Parquet table in
//! the folder `runs`, and beside it a record of the command line, the program and what it took. A run
//! whose record names the same command line and the same program is not repeated.
//!
//! ```text
//!   curvox shape goursat --gridstep 0.25 | curvox run - --threshold 1 ... -o runs/NAME.parquet
//! ```
//!
//! This and [`super::methods`] are the places that know options of `curvox`. Each run is given one thread, so that its processor time is that of one
//! thread, and several runs can go on side by side.

use std::fmt::Write as _;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};

use super::methods::Method;

/// Seed of all noise.
const SEED: u32 = 1;

/// The exit code of `curvox` for what cannot be asked.
const USAGE: i32 = 2;

/// What a solid is made from.
#[derive(Clone, Debug, PartialEq)]
pub enum Solid {
    /// A shape of `curvox shape`, which also knows its curvatures.
    Shape(String),
    /// A volume of the user's: voxels of value >= 1 are inside.
    Volume {
        /// What the user calls it.
        name: String,
        /// Where it is.
        path: PathBuf,
    },
}

/// A run of `curvox`.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// What it is run on.
    pub solid: Solid,
    /// Edge of a voxel in the units of the shape.
    pub gridstep: f64,
    /// The probability p that a voxel at distance 1 of the surface is flipped.
    pub noise: f64,
    /// Whether the surface is closed on the border of the image.
    pub closed: bool,
    /// How.
    pub method: Method,
}

impl Run {
    /// A shape without noise.
    pub fn shape(spec: &str, gridstep: f64, method: Method) -> Self {
        Run {
            solid: Solid::Shape(spec.to_owned()),
            gridstep,
            noise: 0.0,
            closed: false,
            method,
        }
    }

    /// The shape whose curvatures are known, if they are.
    pub fn known_shape(&self) -> Option<&str> {
        match &self.solid {
            // What closes a shape on the border of the image is no part of it.
            Solid::Shape(spec) if !self.closed => Some(spec),
            _ => None,
        }
    }

    /// The solid in a few words.
    pub fn solid_name(&self) -> &str {
        match &self.solid {
            Solid::Shape(spec) => spec.split(':').next().unwrap_or(spec),
            Solid::Volume { name, .. } => name,
        }
    }

    /// The command that writes the volume to standard output; none where the run reads a file.
    fn making(&self) -> Option<Vec<String>> {
        let mut words: Vec<String> = match &self.solid {
            Solid::Shape(spec) => {
                let mut words = vec!["shape".into(), spec.clone()];
                words.extend(["--gridstep".into(), self.gridstep.to_string()]);
                words
            }
            Solid::Volume { path, .. } => {
                if self.noise == 0.0 {
                    return None;
                }
                let path = path.display().to_string();
                ["noise", &path, "--threshold", "1"]
                    .map(String::from)
                    .into()
            }
        };
        if self.noise > 0.0 {
            let noise = [
                "--noise",
                &self.noise.to_string(),
                "--seed",
                &SEED.to_string(),
            ];
            words.extend(noise.map(String::from));
        }
        words.extend(["-o", "-"].map(String::from));
        Some(words)
    }

    /// The command that computes, without its output.
    fn computing(&self) -> Vec<String> {
        let input = match &self.solid {
            Solid::Volume { path, .. } if self.noise == 0.0 => path.display().to_string(),
            _ => "-".into(),
        };
        let mut words: Vec<String> = ["run", &input, "--threshold", "1"].map(String::from).into();
        if matches!(self.solid, Solid::Volume { .. }) {
            words.extend(["--spacing".into(), self.gridstep.to_string()]);
        }
        words.extend(self.method.options());
        if self.closed {
            words.push("--closed".into());
        }
        words.extend(["--threads", "1"].map(String::from));
        words
    }

    /// The whole command line, without the output: what makes this run this run.
    pub fn command_line(&self) -> String {
        let mut line = String::new();
        if let Some(making) = self.making() {
            let _ = write!(line, "curvox {} | ", making.join(" "));
        }
        let _ = write!(line, "curvox {}", self.computing().join(" "));
        line
    }

    /// A name for files: readable, and another one for every command line.
    pub fn file_stem(&self) -> String {
        let hash = fnv(self.command_line().as_bytes());
        let plain = |text: &str| -> String {
            let keep = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
            text.chars().map(keep).collect()
        };
        format!(
            "{}-h{}-{}-{hash:016x}",
            plain(self.solid_name()),
            plain(&self.gridstep.to_string()),
            plain(self.method.estimator.name()),
        )
    }

    /// The run in a few words, for progress.
    pub fn label(&self) -> String {
        let mut label = format!(
            "{} h={} {}",
            self.solid_name(),
            self.gridstep,
            self.method.estimator.name()
        );
        if self.noise > 0.0 {
            let _ = write!(label, " p={}", self.noise);
        }
        if let Some(radius) = self.method.normal_radius {
            let _ = write!(label, " r={radius:.1}");
        }
        let radii: Vec<_> = self
            .method
            .radii
            .iter()
            .map(|r| format!("{r:.1}"))
            .collect();
        let _ = write!(label, " rho={}", radii.join(","));
        label
    }

    /// About how much work it is, to begin with the longest.
    pub fn work(&self) -> f64 {
        let surfels = self.gridstep.powi(-2);
        let per_surfel: f64 = self.method.radii.iter().map(|r| 1.0 + r * r / 20.0).sum();
        surfels * (per_surfel + self.method.normal_radius.map_or(0.0, |r| r * r / 10.0))
    }
}

/// The hash of Fowler, Noll and Vo (FNV-1a, 64 bits): the same on every machine.
fn fnv(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// What a run took, as it is kept beside its table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The command line.
    pub command: String,
    /// Version and checksum of the program.
    pub program: String,
    /// Seconds on the clock.
    pub wall_seconds: f64,
    /// Processor seconds, user and system, of `curvox run` alone; none where that is not known.
    pub cpu_seconds: Option<f64>,
    /// Processes that wanted a processor of the machine at its end, averaged over a minute (this run
    /// is one); none where that is not known.
    pub load: Option<f64>,
}

/// How a run ended.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// With a table.
    Done {
        /// What it took.
        record: Record,
        /// The Parquet file.
        table: PathBuf,
        /// Whether it was there already.
        kept: bool,
    },
    /// `curvox` says that it cannot be asked for this.
    Refused(String),
}

/// The program, and where its results are kept.
#[derive(Clone, Debug)]
pub struct Runner {
    program: PathBuf,
    identity: String,
    folder: PathBuf,
}

impl Runner {
    /// Finds `curvox`: the path in the variable CURVOX; else beside this executable, where it is
    /// built if it is missing. Results go to `folder`, which is made.
    ///
    /// # Errors
    /// If there is no program that answers, or the folder cannot be made.
    pub fn new(folder: PathBuf) -> Result<Self> {
        let program = find_program()?;
        let said = Command::new(&program)
            .arg("--version")
            .output()
            .with_context(|| program.display().to_string())?;
        ensure!(
            said.status.success(),
            "{}: --version fails",
            program.display()
        );
        let bytes = fs::read(&program).with_context(|| program.display().to_string())?;
        let version = String::from_utf8_lossy(&said.stdout).trim().to_owned();
        let identity = format!("{version} {:016x}", fnv(&bytes));
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(Runner {
            program,
            identity,
            folder,
        })
    }

    /// Version of the program, and a checksum of it.
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Runs, unless that was done before.
    ///
    /// # Errors
    /// If the run fails, other than by refusing what it is asked.
    pub fn run(&self, run: &Run) -> Result<Outcome> {
        let stem = run.file_stem();
        let table = self.folder.join(format!("{stem}.parquet"));
        let record_path = self.folder.join(format!("{stem}.json"));
        let command = run.command_line();
        let earlier: Option<Record> = fs::read(&record_path)
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok());
        if let Some(record) = earlier.filter(|record| {
            record.command == command && record.program == self.identity && table.is_file()
        }) {
            return Ok(Outcome::Done {
                record,
                table,
                kept: true,
            });
        }
        // Without its record a table is of an unknown run.
        let _ = fs::remove_file(&record_path);
        let Spent {
            status,
            message,
            wall_seconds,
            cpu_seconds,
        } = self.spawn(run, &table).with_context(|| command.clone())?;
        if status.code() == Some(USAGE) {
            let first = message.lines().next().unwrap_or_default();
            let reason = first
                .trim_start_matches("error: ")
                .trim_start_matches("curvox: ");
            return Ok(Outcome::Refused(reason.to_owned()));
        }
        ensure!(status.success(), "{command}: {status}: {}", message.trim());
        let record = Record {
            command,
            program: self.identity.clone(),
            wall_seconds,
            cpu_seconds,
            load: load(),
        };
        // Whole or not at all, for the next time relies on it.
        let unfinished = record_path.with_extension("unfinished");
        let place = || record_path.display().to_string();
        fs::write(&unfinished, serde_json::to_vec_pretty(&record)?).with_context(place)?;
        fs::rename(&unfinished, &record_path).with_context(place)?;
        Ok(Outcome::Done {
            record,
            table,
            kept: false,
        })
    }

    fn spawn(&self, run: &Run, table: &Path) -> Result<Spent> {
        let started = Instant::now();
        let mut maker = None;
        let mut computing = Command::new(&self.program);
        computing.args(run.computing());
        computing.args(["--quiet", "--overwrite", "-o"]).arg(table);
        computing.stdin(Stdio::null());
        if let Some(words) = run.making() {
            let mut child = Command::new(&self.program)
                .args(words)
                .stdin(Stdio::null())
                .stdout(Stdio::piped())
                .stderr(Stdio::piped())
                .spawn()?;
            if let Some(volume) = child.stdout.take() {
                computing.stdin(volume);
            }
            maker = Some(child);
        }
        let mut child = computing
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()?;
        // This holds the reading end of the pipe, which must close when the child ends.
        drop(computing);
        let message = text_of(&mut child)?;
        let mut spent = wait(child, started)?;
        spent.message = message;
        if let Some(mut maker) = maker {
            let why = text_of(&mut maker)?;
            let status = maker.wait()?;
            // A run that refuses leaves the pipe; that is no fault of the other end.
            if !status.success() && spent.status.code() != Some(USAGE) {
                spent.status = status;
                spent.message = why;
            }
        }
        Ok(spent)
    }
}

/// How a process ended.
struct Spent {
    status: ExitStatus,
    message: String,
    wall_seconds: f64,
    cpu_seconds: Option<f64>,
}

fn text_of(child: &mut Child) -> Result<String> {
    let mut bytes = Vec::new();
    if let Some(mut stderr) = child.stderr.take() {
        stderr.read_to_end(&mut bytes)?;
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Waits for a process, and learns what it used.
#[cfg(unix)]
fn wait(child: Child, started: Instant) -> Result<Spent> {
    use std::os::unix::process::ExitStatusExt;

    let pid = i32::try_from(child.id())?;
    let mut status = 0;
    // SAFETY: a rusage is integers alone, for which all bits zero is a value.
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    loop {
        // SAFETY: `pid` is a child of this process that nobody else waits for, since `child` is owned
        // here and has not been waited for; both pointers are to places that outlive the call.
        let ended = unsafe { libc::wait4(pid, &mut status, 0, &mut usage) };
        if ended == pid {
            break;
        }
        let error = std::io::Error::last_os_error();
        if error.kind() != std::io::ErrorKind::Interrupted {
            return Err(error.into());
        }
    }
    let seconds = |t: libc::timeval| t.tv_sec as f64 + t.tv_usec as f64 * 1e-6;
    Ok(Spent {
        status: ExitStatus::from_raw(status),
        message: String::new(),
        wall_seconds: started.elapsed().as_secs_f64(),
        cpu_seconds: Some(seconds(usage.ru_utime) + seconds(usage.ru_stime)),
    })
}

/// Waits for a process; what it used is not known here.
#[cfg(not(unix))]
fn wait(mut child: Child, started: Instant) -> Result<Spent> {
    Ok(Spent {
        status: child.wait()?,
        message: String::new(),
        wall_seconds: started.elapsed().as_secs_f64(),
        cpu_seconds: None,
    })
}

/// The load average of the last minute, where the system tells it.
fn load() -> Option<f64> {
    let text = fs::read_to_string("/proc/loadavg").ok()?;
    text.split_whitespace().next()?.parse().ok()
}

fn find_program() -> Result<PathBuf> {
    if let Some(path) = std::env::var_os("CURVOX") {
        return Ok(PathBuf::from(path));
    }
    let own = std::env::current_exe().context("where this program is")?;
    let mut folder = own.parent().context("where this program is")?;
    // Tests are in a folder of their own.
    if folder.ends_with("deps") {
        folder = folder.parent().unwrap_or(folder);
    }
    let program = folder.join(format!("curvox{}", std::env::consts::EXE_SUFFIX));
    if !program.is_file() {
        eprintln!("building curvox, which is not in {}", folder.display());
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let status = Command::new(cargo)
            .args(["build", "--release", "-p", "curvox"])
            .current_dir(workspace)
            .status()
            .context("cargo")?;
        ensure!(status.success(), "curvox cannot be built: {status}");
    }
    if !program.is_file() {
        bail!(
            "{}: expected the program curvox; build it, or name it in the variable CURVOX",
            program.display()
        );
    }
    Ok(program)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper::methods::{Estimator, Field};

    #[test]
    fn every_command_line_has_a_name_of_its_own() {
        let run = Run::shape("goursat", 0.5, Method::of_paper(Estimator::Ii, 0.5));
        let noisy = Run {
            noise: 0.25,
            ..run.clone()
        };
        let closed = Run {
            closed: true,
            ..run.clone()
        };
        let other = Run::shape("goursat", 0.5, Method::of_paper(Estimator::Average, 0.5));
        let linear = Run {
            method: Method::of_paper(Estimator::Ii, 0.5).with(Field::Linear),
            ..run.clone()
        };
        let stems = [&run, &noisy, &closed, &other, &linear].map(Run::file_stem);
        for (i, stem) in stems.iter().enumerate() {
            assert!(!stems[..i].contains(stem), "{stem}");
            assert!(stem.starts_with("goursat-h0-5-"));
        }
        assert_eq!(
            run.command_line(),
            "curvox shape goursat --gridstep 0.5 -o - | curvox run - --threshold 1 \
             --normals ii --normal-radius 4.242640687119285vx --radius 4.242640687119285vx --directions --threads 1"
        );
    }
}
