//! The table as one file or one stream: Parquet, CSV, or an Arrow IPC stream.
//!
//! Comes in: batches in Khalimsky order. Goes out: one table with the columns of the dataset.
//! A file appears whole or not at all; a stream is written as rows come. One file has one order of
//! rows, so an image wider than one column of parts ([`super::PART_EDGE`]) is refused: its columns
//! arrive interleaved, and need the dataset.
//!
//! CSV: a header line, commas, no quotes, `\n`; floats with the fewest digits that read back to
//! the same `f32`, `NaN` where there is no value. It cannot carry the metadata.

use std::collections::HashMap;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_ipc::writer::StreamWriter;
use arrow_schema::SchemaRef;

use super::SurfelSink;
use super::batch::SurfelBatch;
use super::columns::{self, OrderCheck, ROW_GROUP_ROWS};
use super::error::SinkError;
use super::info::TableInfo;
use super::parquet::{Encoder, TableFormat};
use super::parts::Parts;
use super::whole_file::WholeFile;

/// Name of standard output on the command line.
pub const STDOUT: &str = "-";

/// Writes a whole table to one place.
pub struct SingleSink {
    path: PathBuf,
    info: TableInfo,
    order: OrderCheck,
    /// `None` once finished, or after an error.
    table: Option<Box<dyn Table>>,
}

/// A format of table on some writer.
trait Table: Send {
    fn rows(&mut self, batch: &SurfelBatch, path: &Path) -> Result<(), SinkError>;
    fn end(self: Box<Self>, path: &Path) -> Result<(), SinkError>;
}

impl SingleSink {
    /// Begins a Parquet file.
    ///
    /// # Errors
    ///
    /// If `info` is not valid, the image is too wide, or the file cannot be made.
    pub fn parquet_file(path: &Path, info: TableInfo) -> Result<Self, SinkError> {
        let format = TableFormat::new(&info)?;
        refuse_columns(&info)?;
        let encoder = Encoder::new(WholeFile::create(path)?, &format, &info)
            .map_err(|error| SinkError::parquet(path, "write", error))?;
        Ok(Self::new(path, info, ParquetTable { encoder }))
    }

    /// Begins a CSV file.
    ///
    /// # Errors
    ///
    /// If `info` is not valid, the image is too wide, or the file cannot be made.
    pub fn csv_file(path: &Path, info: TableInfo) -> Result<Self, SinkError> {
        info.check()?;
        refuse_columns(&info)?;
        let output = BufWriter::with_capacity(1 << 18, WholeFile::create(path)?);
        let table = CsvTable::new(output, commit_buffered, &info);
        Ok(Self::new(path, info, table))
    }

    /// Begins CSV on a stream; `path` names it in messages.
    ///
    /// # Errors
    ///
    /// If `info` is not valid or the image is too wide.
    pub fn csv_stream(
        output: impl Write + Send + 'static,
        path: &Path,
        info: TableInfo,
    ) -> Result<Self, SinkError> {
        info.check()?;
        refuse_columns(&info)?;
        let output = BufWriter::with_capacity(1 << 16, output);
        let table = CsvTable::new(output, flush_only, &info);
        Ok(Self::new(path, info, table))
    }

    /// Begins an Arrow IPC stream; `path` names it in messages.
    ///
    /// # Errors
    ///
    /// If `info` is not valid, the image is too wide, or the schema cannot be written.
    pub fn arrow_stream(
        output: impl Write + Send + 'static,
        path: &Path,
        info: TableInfo,
    ) -> Result<Self, SinkError> {
        info.check()?;
        refuse_columns(&info)?;
        let metadata: HashMap<_, _> = info.metadata().into_iter().collect();
        let schema = columns::schema(&info)
            .as_ref()
            .clone()
            .with_metadata(metadata);
        let schema = Arc::new(schema);
        let writer = StreamWriter::try_new(BufWriter::new(output), &schema)
            .map_err(|error| SinkError::arrow(path, "write", error))?;
        let waiting = SurfelBatch::with_capacity(&info, 0);
        Ok(Self::new(
            path,
            info,
            ArrowTable {
                writer,
                schema,
                waiting,
            },
        ))
    }

    fn new(path: &Path, info: TableInfo, table: impl Table + 'static) -> Self {
        let table: Box<dyn Table> = Box::new(table);
        let order = OrderCheck::default();
        Self {
            path: path.to_owned(),
            info,
            order,
            table: Some(table),
        }
    }
}

fn closed() -> SinkError {
    SinkError::Contract("the table is closed or has failed".into())
}

fn refuse_columns(info: &TableInfo) -> Result<(), SinkError> {
    if Parts::new(info.dims).columns() == [1, 1] {
        return Ok(());
    }
    Err(SinkError::Unsupported(format!(
        "an image of {:?} voxels is too wide for a single table; write to a directory instead",
        info.dims
    )))
}

impl SurfelSink for SingleSink {
    fn write(&mut self, batch: &SurfelBatch) -> Result<(), SinkError> {
        // Put back only when all went well.
        let mut table = self.table.take().ok_or_else(closed)?;
        batch.check(&self.info)?;
        self.order.check(batch, &Parts::new(self.info.dims))?;
        table.rows(batch, &self.path)?;
        self.table = Some(table);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.table.take().ok_or_else(closed)?.end(&self.path)
    }
}

struct ParquetTable {
    encoder: Encoder<WholeFile>,
}

impl Table for ParquetTable {
    fn rows(&mut self, batch: &SurfelBatch, path: &Path) -> Result<(), SinkError> {
        self.encoder
            .push(batch, 0..batch.len())
            .map_err(|error| SinkError::parquet(path, "write", error))
    }

    fn end(self: Box<Self>, path: &Path) -> Result<(), SinkError> {
        let (file, _) = self
            .encoder
            .finish()
            .map_err(|error| SinkError::parquet(path, "write", error))?;
        file.commit()
    }
}

/// How the writer below a CSV table is brought to its end.
type End<W> = fn(BufWriter<W>, &Path) -> Result<(), SinkError>;

fn commit_buffered(output: BufWriter<WholeFile>, path: &Path) -> Result<(), SinkError> {
    let file = output
        .into_inner()
        .map_err(|error| SinkError::io(path, "write", error.into_error()))?;
    file.commit()
}

fn flush_only<W: Write>(mut output: BufWriter<W>, path: &Path) -> Result<(), SinkError> {
    output
        .flush()
        .map_err(|source| SinkError::io(path, "write", source))
}

struct CsvTable<W: Write> {
    output: BufWriter<W>,
    end: End<W>,
    /// Written before the first row.
    header: Option<String>,
    line: Vec<u8>,
}

impl<W: Write> CsvTable<W> {
    fn new(output: BufWriter<W>, end: End<W>, info: &TableInfo) -> Self {
        let names: Vec<String> = columns::column_descriptions(info)
            .into_iter()
            .map(|(name, _)| name)
            .collect();
        Self {
            output,
            end,
            header: Some(names.join(",") + "\n"),
            line: Vec::new(),
        }
    }

    fn write_header(&mut self, path: &Path) -> Result<(), SinkError> {
        let Some(header) = self.header.take() else {
            return Ok(());
        };
        self.output
            .write_all(header.as_bytes())
            .map_err(|source| SinkError::io(path, "write", source))
    }
}

impl<W: Write + Send> Table for CsvTable<W> {
    fn rows(&mut self, batch: &SurfelBatch, path: &Path) -> Result<(), SinkError> {
        self.write_header(path)?;
        for row in 0..batch.len() {
            self.line.clear();
            csv_row(batch, row, &mut self.line)
                .and_then(|()| self.output.write_all(&self.line))
                .map_err(|source| SinkError::io(path, "write", source))?;
        }
        Ok(())
    }

    fn end(mut self: Box<Self>, path: &Path) -> Result<(), SinkError> {
        self.write_header(path)?;
        (self.end)(self.output, path)
    }
}

/// Appends one row to a line. `{:?}` of a float is its shortest text that reads back the same.
fn csv_row(batch: &SurfelBatch, row: usize, line: &mut Vec<u8>) -> std::io::Result<()> {
    let [kx, ky, kz] = batch.k_at(row);
    write!(line, "{kx},{ky},{kz},{}", batch.side[row])?;
    for column in batch
        .position
        .iter()
        .chain(&batch.normal)
        .chain([&batch.area])
    {
        write!(line, ",{:?}", column[row])?;
    }
    for at in &batch.curvatures {
        let values = [&at.mean, &at.gaussian];
        let errors = [&at.mean_error, &at.gaussian_error];
        for column in (values.into_iter().chain(errors).chain([&at.k1, &at.k2]))
            .chain(at.d1.iter().chain(&at.d2))
            .chain([&at.quality])
            .filter(|column| !column.is_empty())
        {
            write!(line, ",{:?}", column[row])?;
        }
        write!(line, ",{}", at.flags[row])?;
    }
    line.push(b'\n');
    Ok(())
}

struct ArrowTable<W: Write> {
    writer: StreamWriter<BufWriter<W>>,
    schema: SchemaRef,
    waiting: SurfelBatch,
}

impl<W: Write> ArrowTable<W> {
    fn send(&mut self, path: &Path) -> Result<(), SinkError> {
        let batch = columns::take_record_batch(&mut self.waiting, &self.schema)?;
        self.writer
            .write(&batch)
            .map_err(|error| SinkError::arrow(path, "write", error))
    }
}

impl<W: Write + Send> Table for ArrowTable<W> {
    fn rows(&mut self, batch: &SurfelBatch, path: &Path) -> Result<(), SinkError> {
        let mut from = 0;
        while from < batch.len() {
            let to = batch.len().min(from + ROW_GROUP_ROWS - self.waiting.len());
            self.waiting.extend_from(batch, from..to);
            from = to;
            if self.waiting.len() == ROW_GROUP_ROWS {
                self.send(path)?;
            }
        }
        Ok(())
    }

    fn end(mut self: Box<Self>, path: &Path) -> Result<(), SinkError> {
        if !self.waiting.is_empty() {
            self.send(path)?;
        }
        self.writer
            .finish()
            .and_then(|()| Ok(self.writer.get_mut().flush()?))
            .map_err(|error| SinkError::arrow(path, "write", error))
    }
}
