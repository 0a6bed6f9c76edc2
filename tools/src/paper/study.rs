//! What is asked, and what the runs gave.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Instant;

use anyhow::{Context, Result};

use super::page::gridstep;
use super::rows::{Measured, Rows, Truth, truth};
use super::runs::{Outcome, Record, Run, Runner};

/// The coarsest gridstep.
const COARSEST: f64 = 1.0;

/// A volume of the user's.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// What it is called; a name that begins with `octaflower` puts it into figures 12, 13, 17, 18,
    /// any other into 11 and 16.
    pub name: String,
    /// Where it is.
    pub path: PathBuf,
    /// The gridstep that parameters follow from.
    pub gridstep: f64,
}

/// What is asked.
#[derive(Clone, Debug)]
pub struct Study {
    /// The finest gridstep.
    pub finest: f64,
    /// Fewer shapes and parameters, smaller pictures.
    pub quick: bool,
    /// Volumes to picture.
    pub volumes: Vec<Volume>,
    /// Where everything goes.
    pub folder: PathBuf,
}

impl Study {
    /// Gridsteps 1, 1/2, 1/4, ... down to the finest, or to `limit` if that is coarser.
    pub fn gridsteps(&self, limit: f64) -> Vec<f64> {
        let finest = self.finest.max(limit);
        let all = std::iter::successors(Some(COARSEST), |h| Some(h / 2.0));
        all.take_while(|&h| h >= finest).collect()
    }

    /// Width of one picture of several, in pixels.
    pub fn picture_width(&self) -> u32 {
        if self.quick { 200 } else { 230 }
    }
}

/// A run that gave a table.
#[derive(Clone, Debug)]
pub struct Finished {
    /// What it took.
    pub record: Record,
    /// Its table.
    pub table: PathBuf,
    /// What was measured on it.
    pub measured: Measured,
}

/// What the runs gave.
#[derive(Debug, Default)]
pub struct Results {
    finished: BTreeMap<String, Finished>,
    refused: BTreeMap<String, String>,
}

impl Results {
    /// What a run gave; none if it was refused.
    pub fn find(&self, run: &Run) -> Option<&Finished> {
        self.finished.get(&run.command_line())
    }

    /// Why a run was refused.
    pub fn refusal(&self, run: &Run) -> Option<&str> {
        self.refused.get(&run.command_line()).map(String::as_str)
    }

    /// Those of the runs that were refused, by estimator and reason, as a list of Markdown.
    pub fn refusals(&self, runs: &[Run]) -> String {
        let mut groups: BTreeMap<(&str, &str), Vec<f64>> = BTreeMap::new();
        for run in runs {
            if let Some(reason) = self.refusal(run) {
                let key = (run.method.estimator.name(), reason);
                groups.entry(key).or_default().push(run.gridstep);
            }
        }
        let mut text = String::new();
        for ((estimator, reason), mut steps) in groups {
            steps.sort_unstable_by(|a, b| b.total_cmp(a));
            steps.dedup();
            let steps: Vec<String> = steps.into_iter().map(gridstep).collect();
            let _ = writeln!(
                text,
                "- Not run: {estimator} at h = {}: curvox says: {reason}",
                steps.join(", ")
            );
        }
        if !text.is_empty() {
            text.push('\n');
        }
        text
    }

    /// Runs that gave a table.
    pub fn count(&self) -> usize {
        self.finished.len()
    }
}

type Truths = Arc<Vec<Option<Truth>>>;

/// Truths in use: the methods on one digitisation share theirs.
#[derive(Default)]
struct TruthShelf(Mutex<HashMap<String, Weak<Vec<Option<Truth>>>>>);

impl TruthShelf {
    /// Two threads may compute the same; both are right.
    fn of(&self, run: &Run, rows: &Rows) -> Result<Option<Truths>> {
        let Some(shape) = run.known_shape() else {
            return Ok(None);
        };
        let key = format!("{shape} {} {}", run.gridstep, run.noise);
        let shelf = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(truths) = shelf().get(&key).and_then(Weak::upgrade) {
            return Ok(Some(truths));
        }
        let truths = Arc::new(truth(shape, rows)?);
        shelf().insert(key, Arc::downgrade(&truths));
        Ok(Some(truths))
    }
}

/// Makes all runs and measures them: first those whose time counts, one after the other, then the rest,
/// several at a time. Tells each on standard error.
///
/// # Errors
/// If a run fails, or its table cannot be read.
pub fn run_all(
    runner: &Runner,
    alone: &[Run],
    wanted: Vec<Run>,
    workers: usize,
) -> Result<Results> {
    let started = Instant::now();
    let mut distinct: Vec<Run> = Vec::new();
    let mut seen = std::collections::BTreeSet::new();
    for run in wanted {
        if seen.insert(run.command_line()) {
            distinct.push(run);
        }
    }
    // Runs on one digitisation together, for they share their truth; the largest of them first, so
    // that no long one is left for the end.
    distinct.sort_by(|a, b| {
        let key = |run: &Run| (run.gridstep, run.noise);
        let (a_key, b_key) = (key(a), key(b));
        a_key
            .0
            .total_cmp(&b_key.0)
            .then_with(|| a.solid_name().cmp(b.solid_name()))
            .then_with(|| a_key.1.total_cmp(&b_key.1))
            .then_with(|| b.work().total_cmp(&a.work()))
    });
    let total = distinct.len();
    let is_alone = |run: &Run| alone.contains(run);
    let (first, rest) = distinct.into_iter().partition::<Vec<Run>, _>(is_alone);
    let queue = Mutex::new(VecDeque::from(first));
    let results = Mutex::new(Results::default());
    let failure: Mutex<Option<anyhow::Error>> = Mutex::new(None);
    let shelf = TruthShelf::default();
    let work = || -> Result<()> {
        // Kept until the next, so that the next can share it.
        let mut latest: Option<Truths> = None;
        loop {
            let failed = lock(&failure).is_some();
            let Some(run) = lock(&queue).pop_front().filter(|_| !failed) else {
                return Ok(());
            };
            let outcome = runner.run(&run)?;
            let elapsed = started.elapsed().as_secs_f64();
            let told = match outcome {
                Outcome::Refused(reason) => {
                    lock(&results)
                        .refused
                        .insert(run.command_line(), reason.clone());
                    format!("not run: {reason}")
                }
                Outcome::Done {
                    record,
                    table,
                    kept,
                } => {
                    let rows = Rows::read(&table)?;
                    let truths = shelf.of(&run, &rows)?;
                    let measured = Measured::of(&rows, truths.as_ref().map(|t| &t[..]))
                        .with_context(|| table.display().to_string())?;
                    latest = truths.or(latest.take());
                    let told = format!(
                        "{} surfels, {}{}",
                        measured.surfels,
                        record
                            .cpu_seconds
                            .map_or(String::new(), |s| format!("{s:.1} s of processor")),
                        if kept { ", there already" } else { "" }
                    );
                    let finished = Finished {
                        record,
                        table,
                        measured,
                    };
                    lock(&results).finished.insert(run.command_line(), finished);
                    told
                }
            };
            let done = {
                let results = lock(&results);
                results.finished.len() + results.refused.len()
            };
            eprintln!("[{elapsed:7.1} s] {done}/{total} {}: {told}", run.label());
        }
    };
    work()?;
    lock(&queue).extend(rest);
    std::thread::scope(|scope| {
        for _ in 0..workers.max(1) {
            scope.spawn(|| {
                if let Err(error) = work() {
                    lock(&failure).get_or_insert(error);
                }
            });
        }
    });
    match failure.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error),
        None => Ok(results.into_inner().unwrap_or_else(PoisonError::into_inner)),
    }
}

/// What a lock guards is whole between statements, so a thread that panicked spoils nothing.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
