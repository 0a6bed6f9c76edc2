//! The table as a directory of parts: `surfels/part-00000.parquet` and so on.
//!
//! Comes in: batches, per column of parts in Khalimsky order; columns may alternate as they like.
//! Goes out: one file for each part that has rows. A part appears when a later layer of its column
//! begins, when [`SurfelSink::advance`] passes it, or at the end; it appears whole or not at all.
//! Dropping the sink early leaves the finished parts and no temporary file. At most one part of
//! each column is open at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::errors::ParquetError;

use super::SurfelSink;
use super::batch::SurfelBatch;
use super::columns::{OrderCheck, ROW_GROUP_ROWS, row_bytes};
use super::error::SinkError;
use super::info::TableInfo;
use super::output::{SURFELS_DIRECTORY, make_folder};
use super::parquet::{Encoder, TableFormat};
use super::parts::Parts;
use super::run_record::{PartRecord, RunRecorder, lists_empty_parts};
use super::whole_file::{Digesting, WholeFile, checksum_of_file};

const PARTS_BEFORE: &str = "the parts before it are complete";

/// Writes the table as a directory of parts.
pub struct DatasetSink {
    folder: PathBuf,
    info: TableInfo,
    format: TableFormat,
    parts: Parts,
    order: OrderCheck,
    columns: BTreeMap<[u32; 2], ColumnState>,
    recorder: Option<Arc<RunRecorder>>,
    /// Parts finished by the run that is resumed: their rows are not written again.
    kept: BTreeSet<u64>,
    done: Vec<PartRecord>,
    /// Finished, or stopped by an error: nothing more may become a file.
    closed: bool,
}

/// How far a column of parts is.
#[derive(Default)]
struct ColumnState {
    /// Layers below this one are finished.
    layer: u32,
    open: Option<OpenPart>,
}

struct OpenPart {
    path: PathBuf,
    encoder: Encoder<Digesting<WholeFile>>,
}

impl DatasetSink {
    /// Begins the table below `directory`, which [`super::prepare_output`] made ready.
    ///
    /// With a `recorder`, finished parts are reported to it. If it was made by
    /// [`RunRecorder::resume`], parts it lists are kept when their size and checksum are right and
    /// written again otherwise; the caller sends all rows or leaves out the kept parts, as it
    /// likes.
    ///
    /// # Errors
    ///
    /// If `info` is not valid or the folder cannot be made.
    pub fn create(
        directory: &Path,
        info: TableInfo,
        recorder: Option<Arc<RunRecorder>>,
    ) -> Result<Self, SinkError> {
        let format = TableFormat::new(&info)?;
        let parts = Parts::new(info.dims);
        let folder = directory.join(SURFELS_DIRECTORY);
        make_folder(&folder)?;
        let mut kept = BTreeSet::new();
        let mut done = Vec::new();
        for record in recorder.iter().flat_map(|recorder| recorder.record().parts) {
            if is_intact(&folder, &record) {
                kept.insert(record.part);
                done.push(record);
            } else if let Some(recorder) = &recorder {
                recorder.forget(record.part);
            }
        }
        let columns = if lists_empty_parts(parts.count()) {
            let [columns_x, columns_y] = parts.columns();
            (0..columns_y)
                .flat_map(|y| (0..columns_x).map(move |x| ([x, y], ColumnState::default())))
                .collect()
        } else {
            BTreeMap::new()
        };
        let order = OrderCheck::default();
        Ok(Self {
            folder,
            info,
            format,
            parts,
            order,
            columns,
            recorder,
            kept,
            done,
            closed: false,
        })
    }

    /// Memory the sink holds at most, besides the batches it is given: a row group of rows for
    /// each column of parts, and one being encoded.
    #[must_use]
    pub fn memory_bytes(info: &TableInfo) -> u64 {
        let [columns_x, columns_y] = Parts::new(info.dims).columns().map(u64::from);
        // Encoded pages and the encoders' own buffers are about as large as the rows, each.
        let groups = columns_x * columns_y + 2;
        groups * row_bytes(info) * ROW_GROUP_ROWS as u64
    }

    /// Finished parts so far, by index; parts without rows included.
    #[must_use]
    pub fn parts_done(&self) -> Vec<PartRecord> {
        let mut done = self.done.clone();
        done.sort_by_key(|record| record.part);
        done
    }

    /// Whether a resumed run keeps this part, so that its rows need not be computed.
    #[must_use]
    pub fn is_kept(&self, part: u64) -> bool {
        self.kept.contains(&part)
    }

    /// Files of the parts a resumed run keeps, by part. Read back with [`super::OutputInfo`], their
    /// rows give the other sinks what they would have received.
    #[must_use]
    pub fn kept_files(&self) -> Vec<(u64, PathBuf)> {
        let files = self
            .done
            .iter()
            .filter(|record| self.kept.contains(&record.part));
        let mut files: Vec<_> = files
            .filter_map(|record| Some((record.part, self.folder.join(record.file.as_ref()?))))
            .collect();
        files.sort();
        files
    }

    /// Refuses anything after the end or an error; see [`SurfelSink`].
    fn begin(&mut self) -> Result<(), SinkError> {
        // Open again only when the operation has succeeded.
        if std::mem::replace(&mut self.closed, true) {
            return Err(SinkError::Contract(
                "the table is closed or has failed".into(),
            ));
        }
        Ok(())
    }

    /// Writes the rows `range`, all of one layer.
    fn write_layer(
        &mut self,
        batch: &SurfelBatch,
        range: Range<usize>,
        layer: u32,
    ) -> Result<(), SinkError> {
        self.close_below(batch.column, layer)?;
        let part = self.parts.index(layer, batch.column);
        if self.kept.contains(&part) {
            return Ok(());
        }
        let state = self.columns.entry(batch.column).or_default();
        if state.layer > layer {
            return Err(SinkError::Contract(format!(
                "rows for part {part}, which is finished"
            )));
        }
        let open = match &mut state.open {
            Some(open) => open,
            None => {
                let path = self.folder.join(part_name(part));
                state
                    .open
                    .insert(OpenPart::create(path, &self.format, &self.info)?)
            }
        };
        open.encoder
            .push(batch, range)
            .map_err(|error| write_error(&open.path, error))
    }

    /// Finishes the layers of a column below `layer`, those without rows too.
    fn close_below(&mut self, column: [u32; 2], layer: u32) -> Result<(), SinkError> {
        let first = self.done.len();
        self.close_files(column, layer)?;
        match &self.recorder {
            Some(recorder) => recorder.parts_done(self.done[first..].iter().cloned()),
            None => Ok(()),
        }
    }

    /// The same without a word to the recorder.
    fn close_files(&mut self, column: [u32; 2], layer: u32) -> Result<(), SinkError> {
        let columns = self.parts.columns();
        if column[0] >= columns[0] || column[1] >= columns[1] {
            return Err(SinkError::Contract(format!(
                "there is no column {column:?} of parts"
            )));
        }
        let with_empty = lists_empty_parts(self.parts.count());
        let state = self.columns.entry(column).or_default();
        while state.layer < layer {
            let part = self.parts.index(state.layer, column);
            let open = state.open.take();
            state.layer += 1;
            if self.kept.contains(&part) {
                continue;
            }
            match open {
                Some(open) => self.done.push(open.close(part)?),
                None if with_empty => self.done.push(PartRecord {
                    part,
                    file: None,
                    rows: 0,
                    bytes: 0,
                    checksum: None,
                }),
                None => {}
            }
        }
        Ok(())
    }
}

impl SurfelSink for DatasetSink {
    fn write(&mut self, batch: &SurfelBatch) -> Result<(), SinkError> {
        self.begin()?;
        batch.check(&self.info)?;
        self.order.check(batch, &self.parts)?;
        let mut from = 0;
        while from < batch.len() {
            let layer = self.parts.layer_of(batch.k[2][from]);
            let rest = &batch.k[2][from..];
            let to = from + rest.partition_point(|&kz| self.parts.layer_of(kz) == layer);
            self.write_layer(batch, from..to, layer)?;
            from = to;
        }
        self.closed = false;
        Ok(())
    }

    fn advance(&mut self, column: [u32; 2], kz: i32) -> Result<(), SinkError> {
        self.begin()?;
        // A coordinate at or beyond the image's end still belongs to the last layer.
        self.close_below(column, self.parts.layer_of(kz))?;
        self.closed = false;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.begin()?;
        let columns: Vec<_> = self.columns.keys().copied().collect();
        let first = self.done.len();
        for column in columns {
            self.close_files(column, self.parts.layers())?;
        }
        if let Some(recorder) = &self.recorder {
            recorder.parts_done(self.done[first..].iter().cloned())?;
        }
        if self.done.iter().all(|record| record.file.is_none()) {
            // Without a surfel, one empty part still says which columns and units there would be.
            let path = self.folder.join(part_name(0));
            let record = OpenPart::create(path, &self.format, &self.info)?.close(0)?;
            self.done.retain(|done| done.part != 0);
            self.done.push(record.clone());
            if let Some(recorder) = &self.recorder {
                recorder.forget(0);
                recorder.part_done(record)?;
            }
        }
        Ok(())
    }
}

impl OpenPart {
    fn create(path: PathBuf, format: &TableFormat, info: &TableInfo) -> Result<Self, SinkError> {
        let file = WholeFile::create(&path).map_err(|error| error.with_note(PARTS_BEFORE))?;
        let encoder = Encoder::new(Digesting::new(file), format, info)
            .map_err(|error| write_error(&path, error))?;
        Ok(Self { path, encoder })
    }

    fn close(self, part: u64) -> Result<PartRecord, SinkError> {
        let Self { path, encoder } = self;
        let (output, rows) = encoder
            .finish()
            .map_err(|error| write_error(&path, error))?;
        let (file, bytes, checksum) = output.into_parts();
        file.commit()
            .map_err(|error| error.with_note(PARTS_BEFORE))?;
        tracing::info!(part, rows, bytes, "part complete");
        let file = Some(part_name(part));
        Ok(PartRecord {
            part,
            file,
            rows,
            bytes,
            checksum: Some(checksum),
        })
    }
}

fn write_error(path: &Path, error: ParquetError) -> SinkError {
    SinkError::parquet(path, "write", error).with_note(PARTS_BEFORE)
}

/// The file name of a part.
fn part_name(part: u64) -> String {
    format!("part-{part:05}.parquet")
}

/// Whether the file of a recorded part is there and unchanged.
pub(crate) fn is_intact(folder: &Path, record: &PartRecord) -> bool {
    let Some(name) = &record.file else {
        return record.rows == 0;
    };
    let path = folder.join(name);
    std::fs::metadata(&path).is_ok_and(|found| found.len() == record.bytes)
        && checksum_of_file(&path).is_ok_and(|sum| Some(sum) == record.checksum)
}
