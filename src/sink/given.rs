//! A table of normals, read back slab by slab.
//!
//! Comes in: a Parquet file, or the directory of a finished run, with the columns `kx ky kz side`
//! (whole numbers) and `nx ny nz` (`f32` or `f64`, world axes, of any length but 0). Goes out: the
//! rows whose surfel lies in some planes, each with its place in the files.
//!
//! Only row groups whose statistics of `kz` meet the planes are read. Files that are in no order
//! or have no statistics are read whole for every slab: right, only slower. Held in memory: the
//! ranges of the row groups, and a batch of rows.
//!
//! Pages may be stored as they are or in Snappy, gzip, LZ4 or Zstandard, as tools of tables write
//! them by default; other codecs are refused when the table is opened. Whole numbers may be signed
//! or not, of 8 to 64 bits.
//!
//! A value that is missing or beyond 2^63, a normal of length 0 or not finite, and a side that is
//! not 1 or -1 are errors that name the row.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type,
    UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::DataType;
use glam::DVec3;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder,
};
use parquet::basic::Compression;
use parquet::file::statistics::Statistics;
use serde_json::{Value, json};

use super::error::SinkError;
use super::info::TableInfo;
use super::read::{Check, OutputInfo, damaged};

/// The columns read, in the order in which they are used.
const COLUMNS: [&str; 7] = ["kx", "ky", "kz", "side", "nx", "ny", "nz"];

/// Rows of a batch. More would only take memory.
const BATCH_ROWS: usize = 8192;

/// Memory of reading: pages of the columns, as stored and decoded, a batch and a footer.
pub const GIVEN_READ_BYTES: u64 = 24 << 20;

/// A table of normals, open to be read.
#[derive(Clone, Debug, PartialEq)]
pub struct NormalTable {
    path: PathBuf,
    files: Vec<NormalFile>,
    /// What the metadata of curvox say of the image the table was made of.
    made_of: BTreeMap<String, Value>,
    /// How that image differs from another; see [`NormalTable::compare`].
    differences: Vec<String>,
}

#[derive(Clone, Debug, PartialEq)]
struct NormalFile {
    path: PathBuf,
    groups: Vec<Group>,
    rows: u64,
}

/// A row group.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Group {
    /// Smallest and largest `kz`.
    kz: (i64, i64),
    /// Number of its first row in the file.
    first: u64,
}

/// A row as stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalRow {
    /// Khalimsky coordinates.
    pub k: [i64; 3],
    /// Outward sign along the even axis.
    pub side: i8,
    /// Unit normal in world axes.
    pub normal: DVec3,
    /// Number of the file.
    pub file: u32,
    /// Number of the row in its file, from 0.
    pub row: u64,
}

impl NormalTable {
    /// Opens a Parquet file or the directory of a run that reached its end.
    ///
    /// # Errors
    ///
    /// If there is nothing, if it is no table, or if a column is missing or of another type.
    pub fn open(path: &Path) -> Result<Self, SinkError> {
        let found = std::fs::metadata(path).map_err(|e| SinkError::io(path, "open", e))?;
        let paths = if found.is_dir() {
            let info = OutputInfo::open(path, Check::Footers)?;
            info.ensure_complete()?;
            info.files
        } else {
            vec![path.to_owned()]
        };
        let files: Vec<NormalFile> = paths
            .into_iter()
            .map(NormalFile::open)
            .collect::<Result<_, _>>()?;
        let made_of = match files.first() {
            Some(file) => made_of(&file.metadata()?),
            None => BTreeMap::new(),
        };
        Ok(Self {
            path: path.to_owned(),
            files,
            made_of,
            differences: Vec::new(),
        })
    }

    /// Notes how the image the table was made of, if its metadata say so, differs from another.
    pub fn compare(&mut self, other: &TableInfo) {
        let all = [
            ("dims", json!(other.dims)),
            ("spacing", json!(other.spacing)),
            ("inside", other.parameters["inside"].clone()),
            ("closed", other.parameters["closed"].clone()),
        ];
        let differences = all.into_iter().filter_map(|(name, here)| {
            let there = self.made_of.get(name).filter(|there| **there != here)?;
            Some(format!("{name} {there} in the table, {here} here"))
        });
        self.differences = differences.collect();
    }

    /// The differences noted, in words.
    #[must_use]
    pub fn differences(&self) -> &[String] {
        &self.differences
    }

    /// Rows in all files.
    #[must_use]
    pub fn rows(&self) -> u64 {
        let rows = self.files.iter().map(|f| f.rows);
        rows.fold(0, u64::saturating_add)
    }

    /// Memory held while the table is open and read.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let groups: usize = self.files.iter().map(|f| f.groups.capacity()).sum();
        GIVEN_READ_BYTES
            + (groups * size_of::<Group>() + self.files.len() * size_of::<NormalFile>()) as u64
    }

    /// The file or directory that was opened.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of a file, by its number.
    ///
    /// # Panics
    /// If no row came from such a file.
    #[must_use]
    pub fn file(&self, file: u32) -> &Path {
        &self.files[file as usize].path
    }

    /// Visits the rows whose `kz` is in a range, in the order of the files.
    ///
    /// # Errors
    ///
    /// If a file cannot be read, holds a row that is no normal, or `f` fails.
    pub fn for_each<E: From<SinkError>>(
        &self,
        kz: Range<i64>,
        mut f: impl FnMut(NormalRow) -> Result<(), E>,
    ) -> Result<(), E> {
        for (number, file) in self.files.iter().enumerate() {
            let groups: Vec<usize> = (0..file.groups.len())
                .filter(|&g| {
                    let (least, most) = file.groups[g].kz;
                    least < kz.end && most >= kz.start
                })
                .collect();
            if groups.is_empty() {
                continue;
            }
            let metadata = file.metadata()?;
            for group in groups {
                let reader = file.group(&metadata, group)?;
                let mut first = file.groups[group].first;
                for batch in reader {
                    let batch = batch
                        .map_err(|error| damaged(&file.path, "rows", error, "readable pages"))?;
                    let columns = Columns::of(&file.path, &batch, first)?;
                    for i in 0..batch.num_rows() {
                        if kz.contains(&columns.k[2][i]) {
                            f(columns.row(file, number as u32, first, i)?)?;
                        }
                    }
                    first += batch.num_rows() as u64;
                }
            }
        }
        Ok(())
    }
}

impl NormalFile {
    fn open(path: PathBuf) -> Result<Self, SinkError> {
        let mut file = Self {
            path,
            groups: Vec::new(),
            rows: 0,
        };
        let metadata = file.metadata()?;
        for (i, name) in COLUMNS.iter().enumerate() {
            let field = metadata.schema().field_with_name(name).ok();
            let found = field.map(|f| f.data_type());
            let (expected, usable) = if i < 4 {
                ("whole numbers", found.is_some_and(DataType::is_integer))
            } else {
                let usable = matches!(found, Some(DataType::Float32 | DataType::Float64));
                ("Float32 or Float64", usable)
            };
            if !usable {
                let found = found.map_or("none".into(), ToString::to_string);
                return Err(damaged(
                    &file.path,
                    &format!("column {name}"),
                    found,
                    expected,
                ));
            }
        }
        let is_unsigned = metadata
            .schema()
            .field_with_name("kz")
            .is_ok_and(|f| f.data_type().is_unsigned_integer());
        let columns = metadata.parquet_schema().columns();
        let kz = columns.iter().position(|c| c.path().string() == "kz");
        let mut first = 0;
        for group in metadata.metadata().row_groups() {
            let other = group.columns().iter().find(|column| {
                COLUMNS.contains(&column.column_path().string().as_str())
                    && !is_read(column.compression())
            });
            if let Some(column) = other {
                return Err(damaged(
                    &file.path,
                    &format!("column {}", column.column_path().string()),
                    format!("pages compressed with {}", codec_name(column.compression())),
                    "none, snappy, gzip, lz4 or zstd",
                ));
            }
            let rows = u64::try_from(group.num_rows()).map_err(|_| {
                damaged(
                    &file.path,
                    "rows of a row group",
                    "a negative number",
                    "0 or more",
                )
            })?;
            let statistics = kz.and_then(|i| group.column(i).statistics());
            let range = statistics.and_then(|s| range_of(s, is_unsigned));
            file.groups.push(Group {
                kz: range.unwrap_or((i64::MIN, i64::MAX)),
                first,
            });
            first = first.saturating_add(rows);
        }
        file.rows = first;
        Ok(file)
    }

    fn metadata(&self) -> Result<ArrowReaderMetadata, SinkError> {
        let mut file = self.file()?;
        let mut start = Vec::new();
        Read::by_ref(&mut file)
            .take(4)
            .read_to_end(&mut start)
            .map_err(|e| SinkError::io(&self.path, "read", e))?;
        if start != *b"PAR1" {
            return Err(damaged(
                &self.path,
                "beginning",
                start.escape_ascii(),
                "PAR1, of a Parquet file; tables in CSV or other formats are not read",
            ));
        }
        ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())
            .map_err(|error| damaged(&self.path, "footer", error, "a whole Parquet file"))
    }

    fn file(&self) -> Result<File, SinkError> {
        File::open(&self.path).map_err(|e| SinkError::io(&self.path, "open", e))
    }

    fn group(
        &self,
        metadata: &ArrowReaderMetadata,
        group: usize,
    ) -> Result<parquet::arrow::arrow_reader::ParquetRecordBatchReader, SinkError> {
        if group >= metadata.metadata().num_row_groups() {
            return Err(damaged(
                &self.path,
                "row groups",
                "fewer",
                "those of before",
            ));
        }
        let mask = ProjectionMask::columns(metadata.parquet_schema(), COLUMNS);
        ParquetRecordBatchReaderBuilder::new_with_metadata(self.file()?, metadata.clone())
            .with_row_groups(vec![group])
            .with_projection(mask)
            .with_batch_size(BATCH_ROWS)
            .build()
            .map_err(|error| damaged(&self.path, "rows", error, "a table"))
    }
}

/// What the metadata of curvox say of the image a table was made of.
fn made_of(metadata: &ArrowReaderMetadata) -> BTreeMap<String, Value> {
    let entries = metadata.metadata().file_metadata().key_value_metadata();
    let mut found = BTreeMap::new();
    for entry in entries.into_iter().flatten() {
        let text = entry.value.as_deref().unwrap_or_default();
        let Ok(value) = serde_json::from_str::<Value>(text) else {
            continue;
        };
        match entry.key.as_str() {
            "curvox.dims" => drop(found.insert("dims".into(), value)),
            "curvox.spacing" => drop(found.insert("spacing".into(), value)),
            "curvox.parameters" => {
                for name in ["inside", "closed"] {
                    if let Some(value) = value.get(name) {
                        found.insert(name.into(), value.clone());
                    }
                }
            }
            _ => {}
        }
    }
    found
}

/// Whether pages in a codec can be read.
fn is_read(codec: Compression) -> bool {
    matches!(
        codec,
        Compression::UNCOMPRESSED
            | Compression::SNAPPY
            | Compression::GZIP(_)
            | Compression::LZ4
            | Compression::LZ4_RAW
            | Compression::ZSTD(_)
    )
}

/// The name of a codec, without its level.
fn codec_name(codec: Compression) -> String {
    let name = codec.to_string().to_ascii_lowercase();
    name.split('(').next().unwrap_or_default().to_owned()
}

/// Smallest and largest of a column of whole numbers, by its statistics.
fn range_of(statistics: &Statistics, is_unsigned: bool) -> Option<(i64, i64)> {
    // Ends in the old fields were compared as signed numbers by some writers.
    if is_unsigned && statistics.is_min_max_deprecated() {
        return None;
    }
    let widened = |x: i32| {
        if is_unsigned {
            i64::from(x.cast_unsigned())
        } else {
            i64::from(x)
        }
    };
    match statistics {
        Statistics::Int32(s) => Some((widened(*s.min_opt()?), widened(*s.max_opt()?))),
        // Beyond 2^63 there is no surfel; such rows are an error when they are read.
        Statistics::Int64(s) => Some((*s.min_opt()?, *s.max_opt()?))
            .filter(|(least, most)| !is_unsigned || (*least >= 0 && *most >= 0)),
        _ => None,
    }
}

/// The columns of a batch.
struct Columns {
    k: [Vec<i64>; 3],
    side: Vec<i64>,
    normal: [Vec<f64>; 3],
}

impl Columns {
    fn of(path: &Path, batch: &RecordBatch, first: u64) -> Result<Self, SinkError> {
        let column = |name: &str| -> Result<&ArrayRef, SinkError> {
            let column = batch
                .column_by_name(name)
                .ok_or_else(|| damaged(path, &format!("column {name}"), "none", "numbers"))?;
            match (0..column.len()).find(|&i| column.is_null(i)) {
                Some(i) => Err(damaged(
                    path,
                    &format!("row {}, column {name}", first + i as u64),
                    "nothing",
                    "a number",
                )),
                None => Ok(column),
            }
        };
        // The types were checked when the file was opened; it may have been replaced since.
        let changed = |name: &str| {
            damaged(
                path,
                &format!("column {name}"),
                "another type",
                "that of before",
            )
        };
        let whole = |name: &str| -> Result<Vec<i64>, SinkError> {
            let array = column(name)?;
            if array.data_type() == &DataType::UInt64 {
                let values = array.as_primitive::<UInt64Type>().values();
                return signed(values).map_err(|i| {
                    damaged(
                        path,
                        &format!("row {}, column {name}", first + i as u64),
                        values[i],
                        "a whole number below 2^63",
                    )
                });
            }
            integers(array).ok_or_else(|| changed(name))
        };
        let real = |name: &str| floats(column(name)?).ok_or_else(|| changed(name));
        Ok(Self {
            k: [whole("kx")?, whole("ky")?, whole("kz")?],
            side: whole("side")?,
            normal: [real("nx")?, real("ny")?, real("nz")?],
        })
    }

    fn row(
        &self,
        file: &NormalFile,
        number: u32,
        first: u64,
        i: usize,
    ) -> Result<NormalRow, SinkError> {
        let row = first + i as u64;
        let wrong =
            |found: String, expected| damaged(&file.path, &format!("row {row}"), found, expected);
        let side = match self.side[i] {
            1 => 1,
            -1 => -1,
            other => return Err(wrong(format!("side {other}"), "1 or -1")),
        };
        let [x, y, z] = [0, 1, 2].map(|a| self.normal[a][i]);
        let vector = DVec3::new(x, y, z);
        let largest = vector.abs().max_element();
        if !(vector.is_finite() && largest > 0.0) {
            return Err(wrong(
                format!("the normal ({x}, {y}, {z})"),
                "a vector with a direction",
            ));
        }
        Ok(NormalRow {
            k: [0, 1, 2].map(|a| self.k[a][i]),
            side,
            // Scaled first, so that squares neither overflow nor vanish.
            normal: (vector / largest).normalize(),
            file: number,
            row,
        })
    }
}

/// Numbers as signed ones, or which is the first that is too large.
fn signed(values: &[u64]) -> Result<Vec<i64>, usize> {
    let each = values.iter().enumerate();
    each.map(|(i, &x)| i64::try_from(x).map_err(|_| i))
        .collect()
}

/// Whole numbers that all fit; `None` if they are none.
fn integers(array: &ArrayRef) -> Option<Vec<i64>> {
    macro_rules! widened {
        ($type:ty) => {{
            let values = array.as_primitive::<$type>().values();
            values.iter().map(|&x| i64::from(x)).collect()
        }};
    }
    Some(match array.data_type() {
        DataType::Int8 => widened!(Int8Type),
        DataType::Int16 => widened!(Int16Type),
        DataType::Int32 => widened!(Int32Type),
        DataType::Int64 => widened!(Int64Type),
        DataType::UInt8 => widened!(UInt8Type),
        DataType::UInt16 => widened!(UInt16Type),
        DataType::UInt32 => widened!(UInt32Type),
        _ => return None,
    })
}

/// Floats; `None` if they are none.
fn floats(array: &ArrayRef) -> Option<Vec<f64>> {
    Some(match array.data_type() {
        DataType::Float32 => {
            let values = array.as_primitive::<Float32Type>().values();
            values.iter().map(|&x| f64::from(x)).collect()
        }
        DataType::Float64 => array.as_primitive::<Float64Type>().values().to_vec(),
        _ => return None,
    })
}
