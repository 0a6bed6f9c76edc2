//! Reading back what a run left.
//!
//! Comes in: an output directory, or a Parquet file of the table. Goes out: rows, columns,
//! metadata, how far the run came, totals ([`OutputInfo`]), or the rows themselves ([`RowReader`]).
//! A file that is cut off or changed is an error with its place, and so is an output that is no
//! curvox table. What is only incomplete is told, and is an error on request.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use arrow_array::Array;
use arrow_array::RecordBatch;
use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Int8Type, Int32Type, UInt16Type};
use arrow_schema::SchemaRef;
use parquet::arrow::arrow_reader::{ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};
use serde_json::Value;

use super::batch::{CurvatureColumns, SurfelBatch};
use super::columns::schema;
use super::dataset::is_intact;
use super::error::SinkError;
use super::faces::{FACES_FILE, RADIUS_KEY};
use super::info::TableInfo;
use super::output::{SUMMARY_FILE, SURFELS_DIRECTORY};
use super::parts::Parts;
use super::run_record::{RUN_FILE, RunRecord, RunState, lists_empty_parts};

/// Rows of a batch that [`RowReader`] gives.
const READ_ROWS: usize = 8192;

/// How thoroughly files are checked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Check {
    /// Sizes and footers: quick.
    #[default]
    Footers,
    /// The checksum of every part as well: reads all bytes.
    Checksums,
}

/// What an output holds.
#[derive(Clone, Debug)]
pub struct OutputInfo {
    /// The place asked for.
    pub path: PathBuf,
    /// Rows in all files.
    pub rows: u64,
    /// Bytes in all files of the table.
    pub bytes: u64,
    /// Files of the table that have rows, in order.
    pub files: Vec<PathBuf>,
    /// Names and types of the columns, in order; empty if no file was written.
    pub columns: Vec<(String, String)>,
    /// Key-value metadata of the table.
    pub metadata: BTreeMap<String, String>,
    /// Frame, units and parameters out of the metadata; `None` if no file was written, and for meshes.
    pub table: Option<TableInfo>,
    /// The record of the run; `None` for a single file.
    pub run: Option<RunRecord>,
    /// `summary.json`; `None` for a single file or an unfinished run.
    pub summary: Option<Value>,
}

impl OutputInfo {
    /// Looks at an output directory or at a Parquet file of the table; also at those of a mesh, which have no
    /// frame ([`OutputInfo::table`]) and no record of a run.
    ///
    /// # Errors
    ///
    /// If there is nothing, if it is no curvox output, or if a file of a finished part is missing
    /// or is not what was written.
    pub fn open(path: &Path, check: Check) -> Result<Self, SinkError> {
        let found = fs::metadata(path).map_err(|source| SinkError::io(path, "open", source))?;
        if found.is_dir() {
            Self::open_directory(path, check)
        } else {
            Self::open_file(path)
        }
    }

    fn empty(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            rows: 0,
            bytes: 0,
            files: Vec::new(),
            columns: Vec::new(),
            metadata: BTreeMap::new(),
            table: None,
            run: None,
            summary: None,
        }
    }

    fn open_file(path: &Path) -> Result<Self, SinkError> {
        let mut info = Self::empty(path);
        info.add_file(path)?;
        Ok(info)
    }

    fn open_directory(path: &Path, check: Check) -> Result<Self, SinkError> {
        let mut info = Self::empty(path);
        let faces = path.join(FACES_FILE);
        if faces.exists() && !path.join(RUN_FILE).exists() {
            info.add_file(&faces)?;
            info.summary = read_summary(path)?;
            return Ok(info);
        }
        let run = RunRecord::read(path)?;
        let folder = path.join(SURFELS_DIRECTORY);
        for part in &run.parts {
            let Some(name) = &part.file else { continue };
            // The name must not lead out of the folder.
            let file = folder.join(Path::new(name).file_name().unwrap_or_default());
            let size = fs::metadata(&file)
                .map_err(|e| SinkError::io(&file, "open", e))?
                .len();
            if size != part.bytes {
                return Err(damaged(&file, "size", size, part.bytes));
            }
            if check == Check::Checksums && !is_intact(&folder, part) {
                let expected = part.checksum.as_deref().unwrap_or_default();
                return Err(damaged(&file, "checksum", "another", expected));
            }
            let rows = info.add_file(&file)?;
            if rows != part.rows {
                return Err(damaged(&file, "number of rows", rows, part.rows));
            }
        }
        info.summary = read_summary(path)?;
        info.run = Some(run);
        Ok(info)
    }

    /// Adds a file of the table, which must look like those before it; gives its rows.
    fn add_file(&mut self, path: &Path) -> Result<u64, SinkError> {
        let builder = open_parquet(path)?;
        let metadata: BTreeMap<_, _> = key_values(&builder).collect();
        let table = if metadata.contains_key(RADIUS_KEY) {
            None
        } else {
            Some(table_info(path, &builder)?)
        };
        if !self.files.is_empty() && metadata != self.metadata {
            return Err(damaged(
                path,
                "metadata",
                "another run's",
                "that of the parts before it",
            ));
        }
        let fields = builder.schema().fields();
        self.columns = fields
            .iter()
            .map(|f| (f.name().clone(), f.data_type().to_string()))
            .collect();
        self.metadata = metadata;
        self.table = table;
        let rows = u64::try_from(builder.metadata().file_metadata().num_rows())
            .map_err(|_| damaged(path, "number of rows", "a negative one", "at least 0"))?;
        self.rows = self.rows.saturating_add(rows);
        let size = fs::metadata(path).map_err(|source| SinkError::io(path, "open", source))?;
        self.bytes = self.bytes.saturating_add(size.len());
        self.files.push(path.to_owned());
        Ok(rows)
    }

    /// Whether the rows are faces of a mesh.
    #[must_use]
    pub fn is_of_mesh(&self) -> bool {
        self.metadata.contains_key(RADIUS_KEY)
    }

    /// Asks that the run reached its end.
    ///
    /// # Errors
    ///
    /// If it is running, was killed, failed, or lacks parts.
    pub fn ensure_complete(&self) -> Result<(), SinkError> {
        let Some(run) = &self.run else { return Ok(()) };
        let parts = format!("{} of {} parts are done", run.parts.len(), run.parts_total);
        let what = match run.state {
            RunState::Running => format!("the run is under way or was killed: {parts}"),
            RunState::Failed => {
                let why = run.message.as_deref().unwrap_or("no reason was recorded");
                format!("the run failed ({why}): {parts}")
            }
            RunState::Complete
                if run.parts.len() as u64 != run.parts_total
                    && lists_empty_parts(run.parts_total) =>
            {
                format!("the run ended, yet {parts}")
            }
            RunState::Complete => return Ok(()),
        };
        Err(SinkError::Incomplete {
            path: self.path.clone(),
            what,
        })
    }

    /// The rows of all files, in order.
    #[must_use]
    pub fn into_rows(self) -> RowReader {
        let mut files = self.files;
        files.reverse();
        RowReader {
            files,
            open: None,
            failed: false,
        }
    }
}

/// The rows of a table, batch by batch; the last item may be an error.
pub struct RowReader {
    /// Files not yet begun, last first.
    files: Vec<PathBuf>,
    open: Option<(PathBuf, TableInfo, ParquetRecordBatchReader)>,
    failed: bool,
}

impl RowReader {
    fn step(&mut self) -> Result<Option<SurfelBatch>, SinkError> {
        loop {
            if let Some((path, info, reader)) = &mut self.open {
                if let Some(batch) = reader.next() {
                    let batch =
                        batch.map_err(|error| damaged(path, "rows", error, "readable pages"))?;
                    return surfel_batch(path, info, &batch).map(Some);
                }
                self.open = None;
            }
            let Some(path) = self.files.pop() else {
                return Ok(None);
            };
            let builder = open_parquet(&path)?.with_batch_size(READ_ROWS);
            let info = table_info(&path, &builder)?;
            let reader = builder
                .build()
                .map_err(|error| damaged(&path, "rows", error, "a table"))?;
            self.open = Some((path, info, reader));
        }
    }
}

impl Iterator for RowReader {
    type Item = Result<SurfelBatch, SinkError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let item = self.step().transpose();
        self.failed = matches!(item, Some(Err(_)));
        item
    }
}

type Builder = ParquetRecordBatchReaderBuilder<File>;

fn open_parquet(path: &Path) -> Result<Builder, SinkError> {
    let file = File::open(path).map_err(|source| SinkError::io(path, "open", source))?;
    Builder::try_new(file).map_err(|error| damaged(path, "footer", error, "a whole Parquet file"))
}

/// `summary.json` of a directory, if it is there.
fn read_summary(directory: &Path) -> Result<Option<Value>, SinkError> {
    let path = directory.join(SUMMARY_FILE);
    if !path.exists() {
        return Ok(None);
    }
    let text = fs::read_to_string(&path).map_err(|source| SinkError::io(&path, "read", source))?;
    serde_json::from_str(&text)
        .map(Some)
        .map_err(|error| damaged(&path, "contents", error, "JSON"))
}

fn key_values(builder: &Builder) -> impl Iterator<Item = (String, String)> {
    let entries = builder.metadata().file_metadata().key_value_metadata();
    entries
        .into_iter()
        .flatten()
        .filter(|entry| entry.key.starts_with("curvox."))
        .map(|entry| (entry.key.clone(), entry.value.clone().unwrap_or_default()))
}

/// Reads the metadata back, and checks that the columns are those it announces.
fn table_info(path: &Path, builder: &Builder) -> Result<TableInfo, SinkError> {
    let entries: BTreeMap<_, _> = key_values(builder).collect();
    let text = |key: &str| {
        entries
            .get(key)
            .ok_or_else(|| damaged(path, "metadata", "none", format!("key {key}")))
    };
    let json = |key: &str| -> Result<Value, SinkError> {
        serde_json::from_str(text(key)?)
            .map_err(|error| damaged(path, &format!("metadata {key}"), error, "JSON"))
    };
    let has = |start: &str| {
        let mut fields = builder.schema().fields().iter();
        fields.any(|f| f.name().starts_with(start))
    };
    let value = serde_json::json!({
        "dims": json("curvox.dims")?,
        "spacing": json("curvox.spacing")?,
        "unit": text("curvox.unit")?,
        "first_index": json("curvox.first_index")?,
        "origin": json("curvox.origin")?,
        "direction": json("curvox.direction")?,
        "radii": json("curvox.radii")?,
        "directions": has("d1x"),
        "errors": has("mean_curvature_error"),
        "quality": has("quality"),
        "parameters": json("curvox.parameters")?,
        "version": text("curvox.version")?,
        "conventions": text("curvox.conventions")?.lines().collect::<Vec<_>>(),
    });
    let info: TableInfo = serde_json::from_value(value)
        .map_err(|error| damaged(path, "metadata", error, "what curvox writes"))?;
    info.check()
        .map_err(|error| damaged(path, "metadata", error, "what curvox writes"))?;
    let expected: SchemaRef = schema(&info);
    for (i, field) in expected.fields().iter().enumerate() {
        let found = builder.schema().fields().get(i);
        let same = found.is_some_and(|found| {
            found.name() == field.name() && found.data_type() == field.data_type()
        });
        if !same {
            let found = found.map_or("none".into(), |f| format!("{} {}", f.name(), f.data_type()));
            let wanted = format!("{} {}", field.name(), field.data_type());
            return Err(damaged(path, &format!("column {i}"), found, wanted));
        }
    }
    Ok(info)
}

/// Rows out of an Arrow batch whose columns `table_info` has checked.
fn surfel_batch(
    path: &Path,
    info: &TableInfo,
    batch: &RecordBatch,
) -> Result<SurfelBatch, SinkError> {
    if batch.columns().iter().any(|column| column.null_count() > 0) {
        return Err(damaged(path, "rows", "nulls", "a value in every column"));
    }
    let mut columns = batch.columns().iter();
    let mut next = || {
        columns
            .next()
            .ok_or_else(|| damaged(path, "rows", "too few", "columns"))
    };
    let mut rows = SurfelBatch::default();
    for k in &mut rows.k {
        *k = next()?.as_primitive::<Int32Type>().values().to_vec();
    }
    rows.side = next()?.as_primitive::<Int8Type>().values().to_vec();
    let mut float = |column: &mut Vec<f32>| -> Result<(), SinkError> {
        *column = next()?.as_primitive::<Float32Type>().values().to_vec();
        Ok(())
    };
    rows.position.iter_mut().try_for_each(&mut float)?;
    rows.normal.iter_mut().try_for_each(&mut float)?;
    float(&mut rows.area)?;
    for _ in &info.radii {
        let mut at = CurvatureColumns::default();
        let mut float = |column: &mut Vec<f32>| -> Result<(), SinkError> {
            *column = next()?.as_primitive::<Float32Type>().values().to_vec();
            Ok(())
        };
        float(&mut at.mean)?;
        float(&mut at.gaussian)?;
        if info.errors {
            float(&mut at.mean_error)?;
            float(&mut at.gaussian_error)?;
        }
        float(&mut at.k1)?;
        float(&mut at.k2)?;
        if info.directions {
            at.d1
                .iter_mut()
                .chain(&mut at.d2)
                .try_for_each(&mut float)?;
        }
        if info.quality {
            float(&mut at.quality)?;
        }
        at.flags = next()?.as_primitive::<UInt16Type>().values().to_vec();
        rows.curvatures.push(at);
    }
    if !rows.is_empty() {
        rows.column = Parts::new(info.dims).column_of(rows.k_at(0));
    }
    Ok(rows)
}

pub(super) fn damaged(
    path: &Path,
    place: &str,
    found: impl ToString,
    expected: impl ToString,
) -> SinkError {
    SinkError::Damaged {
        path: path.to_owned(),
        place: place.to_owned(),
        found: found.to_string(),
        expected: expected.to_string(),
    }
}
