//! The table of the faces of a mesh, and its summary.
//!
//! Comes in: a surface, its field, and sums around each face. Goes out: [`FaceTable`], written as
//! Parquet or CSV, and [`MeshSummary`], written as `summary.json`. A row is a face, in the order of
//! the file; faces that were left out have none. Everything is in the unit of the mesh's coordinates.
//!
//! Columns and flags that surfels have too have their names, types and bits. Centroids are `f64`,
//! since meshes may lie anywhere.

use std::fs;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

use arrow_array::{ArrayRef, Float32Array, Float64Array, RecordBatch, UInt16Array, UInt32Array};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use serde::Serialize;
use serde_json::{Value, json};

use crate::curvature::upward;
use crate::mesh::{Defects, FaceSums, MeshMeasures, MeshSurface, MeshTotals, NormalField};

use super::batch::{CurvatureColumns, Flag, FlagSet};
use super::columns::ROW_GROUP_ROWS;
use super::error::SinkError;
use super::info::RadiusInfo;
use super::output::SUMMARY_FILE;
use super::run_record::pretty;
use super::summary::{Distribution, FlagCount, RadiusSums, RowTotals};
use super::whole_file::{WholeFile, write_whole};

/// Name of the table inside an output directory.
pub const FACES_FILE: &str = "faces.parquet";

/// Key of the radius in the metadata; tables of surfels have several radii under another key.
pub(super) const RADIUS_KEY: &str = "curvox.radius";

/// Bit of the flag `non_manifold`: the ball cuts an edge of three faces or more, or of two that run
/// through it in the same direction. Surfels have no such edges.
pub const NON_MANIFOLD: FlagSet = 1 << 15;

/// Bit of the flag `radius_too_small`: the field is constant and the ball holds no vertex. G is 0 then, and
/// H comes from parts of edges or is 0 too, by the method and not by the surface. The values stay,
/// since on a mesh of large flat faces they are right.
pub const RADIUS_TOO_SMALL: FlagSet = 1 << 14;

/// The flags that surfels do not have.
const MESH_FLAGS: [(&str, FlagSet); 2] = [
    ("radius_too_small", RADIUS_TOO_SMALL),
    ("non_manifold", NON_MANIFOLD),
];

/// What is said of all rows.
#[derive(Clone, Debug)]
pub struct FaceTableInfo {
    /// The radius as typed.
    pub radius_label: String,
    /// The radius.
    pub radius: f64,
    /// Whether the table has the principal directions d1, d2.
    pub directions: bool,
    /// Whether the table has the column `quality`.
    pub quality: bool,
    /// Every parameter that the rows depend on.
    pub parameters: Value,
    /// Conventions in words, a sentence each.
    pub conventions: Vec<String>,
    /// Version of curvox.
    pub version: String,
}

/// Values of a column.
enum Column {
    Number(Vec<u32>),
    Place(Vec<f64>),
    Value(Vec<f32>),
    Flags(Vec<FlagSet>),
}

/// Rows of faces as columns with names and descriptions.
pub struct FaceTable {
    info: FaceTableInfo,
    rows: usize,
    columns: Vec<(String, String, Column)>,
    stats: RowStats,
}

/// What the rows give.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RowStats {
    /// The radius as typed.
    pub label: String,
    /// The radius.
    pub radius: f64,
    /// Over all rows.
    pub all: RowTotals,
    /// Over the rows without the flag `border`.
    pub without_border: RowTotals,
    /// Rows that carry each flag.
    pub flags: Vec<FlagCount>,
    /// H.
    pub mean_curvature: Distribution,
    /// G.
    pub gaussian_curvature: Distribution,
    /// Smaller principal curvature.
    pub k1: Distribution,
    /// Larger principal curvature.
    pub k2: Distribution,
    /// Root mean square, weighted by area, of (k1 + k2) / 2 - H.
    pub principal_mismatch_rms: Option<f64>,
    /// Root mean square of the quality mu_Omega / mu0, weighted by area; `None` if it was not asked for.
    pub quality_rms: Option<f64>,
}

/// The contents of `summary.json`; fields appear in this order.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeshSummary {
    /// Always `curvox mesh summary 1`.
    pub format: &'static str,
    /// Version of curvox.
    pub version: String,
    /// Things the user should know, a sentence each.
    pub warnings: Vec<String>,
    /// The input: name, format, vertices and faces of the file.
    pub input: Value,
    /// Faces with a row.
    pub rows: u64,
    /// Edges; each half-edge of a border counts.
    pub edges: u64,
    /// Vertices, each as often as it has umbrellas.
    pub vertices: u64,
    /// Mean length of the edges.
    pub mean_edge: f64,
    /// Diagonal of the bounding box.
    pub diagonal: f64,
    /// What is wrong with the mesh.
    pub defects: Defects,
    /// Sums over the whole mesh.
    pub totals: MeshTotals,
    /// What the rows give.
    pub radius: RowStats,
    /// Conventions in words, a sentence each.
    pub conventions: Vec<String>,
    /// Parameters of the run.
    pub parameters: Value,
}

impl MeshSummary {
    /// Writes the summary into a directory, whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, directory: &Path) -> Result<(), SinkError> {
        write_whole(&directory.join(SUMMARY_FILE), pretty(self)?.as_bytes())
    }
}

/// Makes `path` a directory that the results of a mesh may be written to.
///
/// # Errors
/// If it is a file, or holds anything else; if it holds results and `overwrite` is false; or if the
/// system refuses.
pub fn prepare_mesh_output(path: &Path, overwrite: bool) -> Result<(), SinkError> {
    if fs::metadata(path).is_ok_and(|found| !found.is_dir()) {
        return Err(SinkError::Occupied {
            path: path.to_owned(),
            found: "is a file, not a directory".into(),
            advice: "choose another place, or end the name in .parquet or .csv",
        });
    }
    fs::create_dir_all(path)
        .map_err(|source| SinkError::io(path, "create the directory", source))?;
    let list = fs::read_dir(path).map_err(|source| SinkError::io(path, "list", source))?;
    for entry in list {
        let entry = entry.map_err(|source| SinkError::io(path, "list", source))?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let ours = [FACES_FILE, SUMMARY_FILE].contains(&name.as_ref());
        if ours && overwrite || name.starts_with('.') {
            continue;
        }
        return Err(SinkError::Occupied {
            path: path.to_owned(),
            found: format!("holds {name}"),
            advice: if ours {
                "use --overwrite to replace it"
            } else {
                "choose an empty or new directory"
            },
        });
    }
    Ok(())
}

impl FaceTable {
    /// Makes the rows.
    ///
    /// # Panics
    /// If the parts are not of one mesh.
    #[must_use]
    pub fn new(
        info: FaceTableInfo,
        surface: &MeshSurface,
        field: &NormalField,
        measures: &MeshMeasures,
        sums: &[FaceSums],
    ) -> Self {
        let rows = surface.faces();
        assert_eq!(rows, sums.len(), "one sum a face");
        let floats = || Vec::with_capacity(rows);
        let triple = || [floats(), floats(), floats()];
        let mut at = CurvatureColumns {
            mean: floats(),
            gaussian: floats(),
            k1: floats(),
            k2: floats(),
            d1: triple(),
            d2: triple(),
            flags: Vec::with_capacity(rows),
            quality: Vec::new(),
            mean_error: Vec::new(),
            gaussian_error: Vec::new(),
        };
        let mut area = floats();
        let mut normal = triple();
        let mut stats = RadiusSums::new(info.radius);
        let mut mesh_flags = [0; MESH_FLAGS.len()];
        for (f, sums) in sums.iter().enumerate() {
            let u = field.of_face[f];
            let curvature = sums.curvature(u);
            let values = curvature.map_or([f64::NAN; 4], |c| [c.mean, c.gaussian, c.k1, c.k2]);
            let columns = [&mut at.mean, &mut at.gaussian, &mut at.k1, &mut at.k2];
            for (column, value) in columns.into_iter().zip(values) {
                column.push(value as f32);
            }
            let directions = curvature.map_or([[f64::NAN; 3]; 2], |c| {
                [c.d1, c.d2].map(|d| upward(d).to_array())
            });
            for axis in 0..3 {
                at.d1[axis].push(directions[0][axis] as f32);
                at.d2[axis].push(directions[1][axis] as f32);
                normal[axis].push(u[axis] as f32);
            }
            let mut flags = 0;
            let mut set = |on: bool, flag: FlagSet| flags |= if on { flag } else { 0 };
            let lifted = |c: usize| {
                let lift = measures.lifts.get(surface.umbrella_of[c] as usize);
                lift.is_some_and(|&k| k != 0.0)
            };
            let largest = values[2].abs().max(values[3].abs());
            set(sums.border, Flag::Border.bit());
            set(sums.several_sheets, Flag::SeveralSheets.bit());
            set(sums.island, Flag::Island.bit());
            set(largest * info.radius > 1.0, Flag::RadiusTooLarge.bit());
            set(u.dot(surface.normal[f]) <= 0.0, Flag::NormalOpposed.bit());
            set(surface.corners(f).any(lifted), Flag::Lifted.bit());
            set(field.degenerate[f], Flag::DegenerateNormal.bit());
            set(curvature.is_none(), Flag::NoArea.bit());
            set(sums.no_vertex, RADIUS_TOO_SMALL);
            set(sums.non_manifold, NON_MANIFOLD);
            for (rows, (_, bit)) in mesh_flags.iter_mut().zip(MESH_FLAGS) {
                *rows += u64::from(flags & bit != 0);
            }
            at.flags.push(flags);
            let mu0 = measures.faces[f].mu0;
            area.push(mu0 as f32);
            if info.quality {
                let quality = curvature.map_or(f64::NAN, |c| c.quality);
                at.quality.push(quality as f32);
            }
        }
        stats.rows(&area, &at, 0..area.len());
        let summary = stats.finish(&RadiusInfo {
            label: info.radius_label.clone(),
            voxels: info.radius,
            world: info.radius,
        });
        let mut flags = summary.flags;
        flags.extend(
            MESH_FLAGS
                .into_iter()
                .zip(mesh_flags)
                .map(|((name, bit), rows)| FlagCount { name, bit, rows }),
        );
        let stats = RowStats {
            label: summary.label,
            radius: info.radius,
            all: summary.all,
            without_border: summary.without_border,
            flags,
            mean_curvature: summary.mean_curvature,
            gaussian_curvature: summary.gaussian_curvature,
            k1: summary.k1,
            k2: summary.k2,
            principal_mismatch_rms: summary.principal_mismatch_rms,
            quality_rms: summary.quality_rms,
        };
        let mut table = Self {
            info,
            rows,
            columns: Vec::new(),
            stats,
        };
        table.name_columns(surface, normal, area, at);
        table
    }

    fn name_columns(
        &mut self,
        surface: &MeshSurface,
        normal: [Vec<f32>; 3],
        area: Vec<f32>,
        at: CurvatureColumns,
    ) {
        const AXES: [char; 3] = ['x', 'y', 'z'];
        let radius = format!("at radius {}", self.info.radius_label);
        let mut columns = Vec::new();
        let mut add = |name: String, text: String, column: Column| {
            columns.push((name, text, column));
        };
        add(
            "face".into(),
            "number of the face in the file, from 0".into(),
            Column::Number(surface.file_number.clone()),
        );
        for (i, axis) in AXES.into_iter().enumerate() {
            let places = surface.centroid.iter().map(|c| c[i]).collect();
            let text = format!("coordinate of the centroid along {axis}");
            add(axis.into(), text, Column::Place(places));
        }
        for (column, axis) in normal.into_iter().zip(AXES) {
            let text = format!("unit corrected normal along {axis}");
            add(format!("n{axis}"), text, Column::Value(column));
        }
        let text = "corrected area mu0 of the face".into();
        add("area".into(), text, Column::Value(area));
        for (name, text, column) in [
            ("mean_curvature", "H = mu1 / (2 mu0)", at.mean),
            ("gaussian_curvature", "G = mu2 / mu0", at.gaussian),
            ("k1", "smaller principal curvature", at.k1),
            ("k2", "larger principal curvature", at.k2),
        ] {
            add(
                name.into(),
                format!("{text} {radius}"),
                Column::Value(column),
            );
        }
        if self.info.directions {
            for (d, k, columns) in [("d1", "k1", at.d1), ("d2", "k2", at.d2)] {
                for (column, axis) in columns.into_iter().zip(AXES) {
                    let text = format!("direction of {k} along {axis}, sign arbitrary");
                    add(format!("{d}{axis}"), text, Column::Value(column));
                }
            }
        }
        if self.info.quality {
            let text = format!("mu_Omega / mu0 {radius}: 0 for the normals of a surface");
            add("quality".into(), text, Column::Value(at.quality));
        }
        let text = format!("reasons to look twice {radius}, bits named in curvox.flags");
        add("flags".into(), text, Column::Flags(at.flags));
        self.columns = columns;
    }

    /// What the rows give.
    #[must_use]
    pub fn stats(&self) -> &RowStats {
        &self.stats
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Writes a Parquet file, whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_parquet(&self, path: &Path) -> Result<(), SinkError> {
        let fields = self.columns.iter().map(|(name, _, column)| {
            let kind = match column {
                Column::Number(_) => DataType::UInt32,
                Column::Place(_) => DataType::Float64,
                Column::Value(_) => DataType::Float32,
                Column::Flags(_) => DataType::UInt16,
            };
            Field::new(name, kind, false)
        });
        let schema = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
        let properties = WriterProperties::builder()
            .set_created_by(format!("curvox version {}", self.info.version))
            .set_key_value_metadata(Some(self.metadata()))
            .set_max_row_group_row_count(Some(ROW_GROUP_ROWS))
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .build();
        let failed = |error| SinkError::parquet(path, "write", error);
        let mut writer = ArrowWriter::try_new(
            WholeFile::create(path)?,
            Arc::clone(&schema),
            Some(properties),
        )
        .map_err(failed)?;
        let mut from = 0;
        while from < self.rows {
            let to = self.rows.min(from + ROW_GROUP_ROWS);
            let arrays = self.columns.iter().map(|(_, _, column)| -> ArrayRef {
                match column {
                    Column::Number(v) => Arc::new(UInt32Array::from(v[from..to].to_vec())),
                    Column::Place(v) => Arc::new(Float64Array::from(v[from..to].to_vec())),
                    Column::Value(v) => Arc::new(Float32Array::from(v[from..to].to_vec())),
                    Column::Flags(v) => Arc::new(UInt16Array::from(v[from..to].to_vec())),
                }
            });
            let batch = RecordBatch::try_new(Arc::clone(&schema), arrays.collect())
                .map_err(|error| SinkError::arrow(path, "write", error))?;
            writer.write(&batch).map_err(failed)?;
            from = to;
        }
        writer.into_inner().map_err(failed)?.commit()
    }

    /// Writes a CSV file, whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_csv_file(&self, path: &Path) -> Result<(), SinkError> {
        let mut output = BufWriter::with_capacity(1 << 18, WholeFile::create(path)?);
        self.write_csv(&mut output, path)?;
        output
            .into_inner()
            .map_err(|error| SinkError::io(path, "write", error.into_error()))?
            .commit()
    }

    /// Writes CSV as surfels are: commas, no quotes, the fewest digits that read back the same.
    ///
    /// # Errors
    /// If the output, which `path` names, cannot be written.
    pub fn write_csv(&self, output: &mut impl Write, path: &Path) -> Result<(), SinkError> {
        let failed = |source| SinkError::io(path, "write", source);
        let names: Vec<_> = self.columns.iter().map(|c| c.0.as_str()).collect();
        writeln!(output, "{}", names.join(",")).map_err(failed)?;
        let mut line = Vec::new();
        for row in 0..self.rows {
            line.clear();
            for (i, (_, _, column)) in self.columns.iter().enumerate() {
                if i > 0 {
                    line.push(b',');
                }
                match column {
                    Column::Number(v) => write!(line, "{}", v[row]),
                    Column::Place(v) => write!(line, "{:?}", v[row]),
                    Column::Value(v) => write!(line, "{:?}", v[row]),
                    Column::Flags(v) => write!(line, "{}", v[row]),
                }
                .map_err(failed)?;
            }
            line.push(b'\n');
            output.write_all(&line).map_err(failed)?;
        }
        output.flush().map_err(failed)
    }

    /// What surfels have too, under the same keys; sorted by key.
    fn metadata(&self) -> Vec<KeyValue> {
        let columns: Vec<_> = self
            .columns
            .iter()
            .map(|(name, text, _)| json!({"name": name, "description": text}))
            .collect();
        let flags: serde_json::Map<String, Value> = Flag::ALL
            .iter()
            .map(|flag| (flag.name().to_owned(), json!(flag.bit())))
            .chain(MESH_FLAGS.map(|(name, bit)| (name.to_owned(), json!(bit))))
            .collect();
        [
            ("curvox.columns", json!(columns).to_string()),
            ("curvox.conventions", self.info.conventions.join("\n")),
            ("curvox.flags", Value::Object(flags).to_string()),
            ("curvox.parameters", self.info.parameters.to_string()),
            (RADIUS_KEY, json!(self.info.radius).to_string()),
            ("curvox.version", self.info.version.clone()),
        ]
        .into_iter()
        .map(|(key, value)| KeyValue::new(key.to_owned(), value))
        .collect()
    }
}
