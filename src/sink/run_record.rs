//! `run.json`: what was asked, of which input, and how far the run came.
//!
//! Comes in: the request and the fingerprint of the input, then each part as it is finished. Goes
//! out: the file, written anew (whole or not at all) at the start, after each part and at the end,
//! so that a killed run can be told from a complete one and resumed. It holds wall times, so
//! unlike the table, the slices and `summary.json` its bytes differ from run to run.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::error::SinkError;
use super::whole_file::write_whole;

/// Name of the record inside the output directory.
pub const RUN_FILE: &str = "run.json";

/// First field of the record: how a curvox output is recognised.
const FORMAT: &str = "curvox run 1";

/// How far a run came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RunState {
    /// Begun and not ended: still at work, or killed.
    Running,
    /// All parts and totals are written.
    Complete,
    /// Ended by an error; see [`RunRecord::message`].
    Failed,
}

/// A finished part of the table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartRecord {
    /// Index of the part, by the rule of [`super::Parts`].
    pub part: u64,
    /// Name below `surfels/`; `None` for a part without rows, which has no file.
    pub file: Option<String>,
    /// Rows in the part.
    pub rows: u64,
    /// Size of the file.
    pub bytes: u64,
    /// `xxh64:` and 16 hexadecimal digits, as `xxh64sum` prints them; `None` without a file.
    pub checksum: Option<String>,
}

/// Whether the record of a run of so many parts lists those without rows.
///
/// More would make the record, which is written after each part, larger than the table of a sparse
/// volume; its parts without rows are those that are not listed when the run is complete.
pub(crate) fn lists_empty_parts(parts_total: u64) -> bool {
    parts_total <= 1 << 16
}

/// The contents of `run.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Always `curvox run 1`.
    pub format: String,
    /// Version of curvox that wrote it.
    pub version: String,
    /// How far the run came.
    pub state: RunState,
    /// Why it failed, if it did.
    pub message: Option<String>,
    /// The request.
    pub asked: Value,
    /// What identifies the input: size, name, checksums of samples, as the caller chose.
    pub input: Value,
    /// Seconds since 1970 at the start.
    pub started: u64,
    /// Seconds since 1970 at the last change of this file.
    pub updated: u64,
    /// Parts of a whole run, with or without rows.
    pub parts_total: u64,
    /// Finished parts, by index; of more than 65536 parts only those with rows.
    pub parts: Vec<PartRecord>,
}

impl RunRecord {
    /// Reads `run.json` of an output directory.
    ///
    /// # Errors
    ///
    /// If the file is missing, is not JSON, or is not the record of a curvox run.
    pub fn read(directory: &Path) -> Result<Self, SinkError> {
        let path = directory.join(RUN_FILE);
        let text =
            fs::read_to_string(&path).map_err(|source| SinkError::io(&path, "read", source))?;
        let record: Self = serde_json::from_str(&text).map_err(|error| SinkError::Damaged {
            path: path.clone(),
            place: format!("line {} column {}", error.line(), error.column()),
            found: error.to_string(),
            expected: "the record of a curvox run".into(),
        })?;
        if record.format != FORMAT {
            return Err(SinkError::Damaged {
                path,
                place: "field `format`".into(),
                found: format!("{:?}", record.format),
                expected: format!("{FORMAT:?}"),
            });
        }
        Ok(record)
    }
}

/// Keeps `run.json` up to date. Shared by the sinks and the pipeline, any thread may report.
#[derive(Debug)]
pub struct RunRecorder {
    path: PathBuf,
    state: Mutex<Recorded>,
}

#[derive(Debug)]
struct Recorded {
    record: RunRecord,
    parts: BTreeMap<u64, PartRecord>,
}

impl RunRecorder {
    /// Begins a record in a prepared output directory and writes it.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn create(
        directory: &Path,
        version: &str,
        asked: Value,
        input: Value,
        parts_total: u64,
    ) -> Result<Self, SinkError> {
        let now = seconds();
        let record = RunRecord {
            format: FORMAT.to_owned(),
            version: version.to_owned(),
            state: RunState::Running,
            message: None,
            asked,
            input,
            started: now,
            updated: now,
            parts_total,
            parts: Vec::new(),
        };
        let recorder = Self {
            path: directory.join(RUN_FILE),
            state: Mutex::new(Recorded {
                record,
                parts: BTreeMap::new(),
            }),
        };
        recorder.lock().save(&recorder.path)?;
        Ok(recorder)
    }

    /// Takes up the record of a run that did not reach its end.
    ///
    /// Whether the request and the input are the same is for the caller to compare, with
    /// [`RunRecorder::record`]; whether the parts on disk are intact is for
    /// [`super::DatasetSink::create`].
    ///
    /// # Errors
    ///
    /// If there is no readable record in the directory.
    pub fn resume(directory: &Path) -> Result<Self, SinkError> {
        let mut record = RunRecord::read(directory)?;
        let parts = std::mem::take(&mut record.parts);
        let parts = parts.into_iter().map(|part| (part.part, part)).collect();
        record.state = RunState::Running;
        record.message = None;
        Ok(Self {
            path: directory.join(RUN_FILE),
            state: Mutex::new(Recorded { record, parts }),
        })
    }

    /// The record as it stands.
    #[must_use]
    pub fn record(&self) -> RunRecord {
        self.lock().snapshot()
    }

    /// Notes a finished part and writes the record.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn part_done(&self, part: PartRecord) -> Result<(), SinkError> {
        self.parts_done([part])
    }

    /// Notes several finished parts and writes the record once.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn parts_done(&self, parts: impl IntoIterator<Item = PartRecord>) -> Result<(), SinkError> {
        let mut state = self.lock();
        let before = state.parts.len();
        state
            .parts
            .extend(parts.into_iter().map(|part| (part.part, part)));
        if state.parts.len() == before {
            return Ok(());
        }
        state.save(&self.path)
    }

    /// Takes a part off the list, because its file is no longer what was recorded.
    pub(crate) fn forget(&self, part: u64) {
        self.lock().parts.remove(&part);
    }

    /// Writes the record for the last time: call it after all other files are in place.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn end(&self, state: RunState, message: Option<String>) -> Result<(), SinkError> {
        let mut recorded = self.lock();
        recorded.record.state = state;
        recorded.record.message = message;
        recorded.save(&self.path)
    }

    fn lock(&self) -> MutexGuard<'_, Recorded> {
        // Nothing is left half changed inside, so a panic elsewhere does no harm here.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Recorded {
    fn snapshot(&self) -> RunRecord {
        RunRecord {
            parts: self.parts.values().cloned().collect(),
            ..self.record.clone()
        }
    }

    fn save(&mut self, path: &Path) -> Result<(), SinkError> {
        self.record.updated = seconds();
        write_whole(path, pretty(&self.snapshot())?.as_bytes())
    }
}

/// JSON for people, ending in a newline.
pub(crate) fn pretty<T: Serialize>(value: &T) -> Result<String, SinkError> {
    let mut text = serde_json::to_string_pretty(value)
        .map_err(|error| SinkError::Contract(format!("cannot be written as JSON: {error}")))?;
    text.push('\n');
    Ok(text)
}

fn seconds() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |time| time.as_secs())
}
