//! Rows to Parquet bytes.
//!
//! Comes in: rows in order. Goes out: a Parquet file on any writer. Row groups have exactly
//! [`ROW_GROUP_ROWS`] rows (the last may have fewer) and are encoded from one record batch each,
//! so the bytes depend on the rows alone, not on how the calls cut them. Nothing in the file tells
//! the time or the machine.
//!
//! Encodings: Khalimsky coordinates as deltas and world coordinates split by bytes, both under zstd
//! 1, shrink to about a tenth; error bars, whose low digits are zero, to a third in the same way; sides and
//! flags are dictionaries. Normals, areas and curvatures are plain: their low digits are noise.

use std::io::Write;
use std::ops::Range;
use std::sync::Arc;

use arrow_schema::{DataType, SchemaRef};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_writer::{
    ArrowRowGroupWriterFactory, ArrowWriterOptions, compute_leaves,
};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::{KeyValue, SortingColumn};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::ColumnPath;
use rayon::prelude::*;

use super::batch::SurfelBatch;
use super::columns::{self, ROW_GROUP_ROWS};
use super::error::SinkError;
use super::info::TableInfo;

/// What all parts of a table have in common.
#[derive(Clone, Debug)]
pub(crate) struct TableFormat {
    pub(crate) schema: SchemaRef,
    properties: WriterProperties,
}

impl TableFormat {
    pub(crate) fn new(info: &TableInfo) -> Result<Self, SinkError> {
        info.check()?;
        // In the schema too: there Arrow's readers look for it.
        let in_schema: std::collections::HashMap<_, _> = info.metadata().into_iter().collect();
        let schema = Arc::new(
            columns::schema(info)
                .as_ref()
                .clone()
                .with_metadata(in_schema),
        );
        let metadata = info
            .metadata()
            .into_iter()
            .map(|(key, value)| KeyValue::new(key, value))
            .collect();
        let zstd = Compression::ZSTD(ZstdLevel::default());
        let mut properties = WriterProperties::builder()
            .set_created_by(format!("curvox version {}", info.version))
            .set_key_value_metadata(Some(metadata))
            .set_max_row_group_row_count(Some(ROW_GROUP_ROWS))
            .set_compression(Compression::UNCOMPRESSED)
            .set_statistics_enabled(EnabledStatistics::None)
            .set_dictionary_enabled(false)
            // Khalimsky order: kz, then ky, then kx.
            .set_sorting_columns(Some([2, 1, 0].map(sorted_by).to_vec()));
        for field in schema.fields() {
            let path = ColumnPath::from(field.name().as_str());
            properties = match (field.data_type(), field.name().as_str()) {
                (DataType::Int32, _) => properties
                    .set_column_statistics_enabled(path.clone(), EnabledStatistics::Chunk)
                    .set_column_encoding(path.clone(), Encoding::DELTA_BINARY_PACKED)
                    .set_column_compression(path, zstd),
                (DataType::Float32, name) if is_split(name) => properties
                    .set_column_encoding(path.clone(), Encoding::BYTE_STREAM_SPLIT)
                    .set_column_compression(path, zstd),
                // Digits of measured values look random: zstd would take a sixth off them, and
                // most of the time that a row takes.
                (DataType::Float32, _) => properties.set_column_encoding(path, Encoding::PLAIN),
                // Few distinct values: a dictionary packs them to a bit or two.
                _ => properties.set_column_dictionary_enabled(path, true),
            };
        }
        Ok(Self {
            schema,
            properties: properties.build(),
        })
    }
}

/// Whether a column of floats shrinks when it is split by bytes: world coordinates, and error bars.
fn is_split(name: &str) -> bool {
    matches!(name, "x" | "y" | "z") || name.contains("_curvature_error")
}

fn sorted_by(column: i32) -> SortingColumn {
    SortingColumn {
        column_idx: column,
        descending: false,
        nulls_first: false,
    }
}

/// A Parquet file under construction.
pub(crate) struct Encoder<W: Write + Send> {
    schema: SchemaRef,
    writer: SerializedFileWriter<W>,
    factory: ArrowRowGroupWriterFactory,
    /// Rows not yet encoded, fewer than a row group.
    waiting: SurfelBatch,
    groups: usize,
    rows: u64,
}

impl<W: Write + Send> Encoder<W> {
    pub(crate) fn new(
        output: W,
        format: &TableFormat,
        info: &TableInfo,
    ) -> Result<Self, ParquetError> {
        let options = ArrowWriterOptions::new().with_properties(format.properties.clone());
        let schema = Arc::clone(&format.schema);
        let (writer, factory) =
            ArrowWriter::try_new_with_options(output, Arc::clone(&schema), options)?
                .into_serialized_writer()?;
        let waiting = SurfelBatch::with_capacity(info, 0);
        Ok(Self {
            schema,
            writer,
            factory,
            waiting,
            groups: 0,
            rows: 0,
        })
    }

    /// Adds the rows `range` of a batch.
    pub(crate) fn push(
        &mut self,
        batch: &SurfelBatch,
        mut range: Range<usize>,
    ) -> Result<(), ParquetError> {
        while !range.is_empty() {
            let room = ROW_GROUP_ROWS - self.waiting.len();
            let cut = range.end.min(range.start + room);
            self.waiting.extend_from(batch, range.start..cut);
            self.rows += (cut - range.start) as u64;
            range.start = cut;
            if self.waiting.len() == ROW_GROUP_ROWS {
                self.flush_group()?;
            }
        }
        Ok(())
    }

    /// Writes what is left and the footer; gives the writer back with the number of rows.
    pub(crate) fn finish(mut self) -> Result<(W, u64), ParquetError> {
        if !self.waiting.is_empty() {
            self.flush_group()?;
        }
        let rows = self.rows;
        Ok((self.writer.into_inner()?, rows))
    }

    /// Encodes the waiting rows, columns in parallel, and appends them in order.
    fn flush_group(&mut self) -> Result<(), ParquetError> {
        let batch = columns::take_record_batch(&mut self.waiting, &self.schema)
            .map_err(|error| ParquetError::General(error.to_string()))?;
        let encoders = self.factory.create_column_writers(self.groups)?;
        let chunks = encoders
            .into_par_iter()
            .zip(self.schema.fields().par_iter().zip(batch.columns()))
            .map(|(mut encoder, (field, array))| {
                for leaf in compute_leaves(field, array)? {
                    encoder.write(&leaf)?;
                }
                encoder.close()
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut group = self.writer.next_row_group()?;
        for chunk in chunks {
            chunk.append_to_row_group(&mut group)?;
        }
        group.close()?;
        // A part with one full group will likely fill another.
        self.waiting.reserve_rows(ROW_GROUP_ROWS);
        self.groups += 1;
        Ok(())
    }
}
