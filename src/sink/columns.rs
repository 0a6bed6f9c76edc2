//! The columns of the surfel table: names, types, order, and rows as Arrow arrays.
//!
//! Comes in: [`SurfelBatch`]es cut anywhere. Goes out: record batches of exactly
//! [`ROW_GROUP_ROWS`] rows (fewer in the last), so that what is written does not show the cut.

use std::ops::Range;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::{ArrayRef, Float32Array, Int8Array, Int32Array, UInt16Array};
use arrow_schema::{DataType, Field, Schema, SchemaRef};

use super::batch::{CurvatureColumns, SurfelBatch};
use super::error::SinkError;
use super::info::TableInfo;
use super::parts::Parts;

/// Rows of a row group.
///
/// Fewer: more headers and worse compression. More: each open part holds more memory (about 60
/// bytes a row, twice while it is encoded), and a reader that wants a small box reads more.
pub const ROW_GROUP_ROWS: usize = 131_072;

const AXES: [char; 3] = ['x', 'y', 'z'];

/// Names and meanings of all columns, in order.
pub(crate) fn column_descriptions(info: &TableInfo) -> Vec<(String, String)> {
    let unit = &info.unit;
    let mut columns = Vec::new();
    let mut add = |name: String, text: String| columns.push((name, text));
    for axis in AXES {
        add(
            format!("k{axis}"),
            format!("Khalimsky (doubled) coordinate along {axis}"),
        );
    }
    add(
        "side".into(),
        "outward sign along the axis whose coordinate is even: +1 or -1".into(),
    );
    for axis in AXES {
        add(
            axis.into(),
            format!("world coordinate of the surfel's centre along {axis}, in {unit}"),
        );
    }
    for axis in AXES {
        add(
            format!("n{axis}"),
            format!("outward unit corrected normal along world {axis}"),
        );
    }
    add(
        "area".into(),
        format!("corrected area mu0 of the surfel, in {unit}^2"),
    );
    let [mean, gaussian] = if info.parameters["curvature"] == "ii" {
        [
            "H by plain integral invariants",
            "G = k1 k2 by plain integral invariants",
        ]
    } else {
        ["H = mu1 / (2 mu0)", "G = mu2 / mu0"]
    };
    for radius in &info.radii {
        let end = if info.radii.len() > 1 {
            radius.suffix()
        } else {
            String::new()
        };
        let at = format!("at radius {}", radius.label);
        add(
            format!("mean_curvature{end}"),
            format!("{mean} {at}, in 1/{unit}"),
        );
        add(
            format!("gaussian_curvature{end}"),
            format!("{gaussian} {at}, in 1/{unit}^2"),
        );
        if info.errors {
            add(
                format!("mean_curvature_error{end}"),
                format!(
                    "error to expect of H {at}, in 1/{unit}: 68 % are within it, 95 % within twice it; NaN on islands"
                ),
            );
            add(
                format!("gaussian_curvature_error{end}"),
                format!("the same of G {at}, in 1/{unit}^2"),
            );
        }
        add(
            format!("k1{end}"),
            format!("smaller principal curvature {at}, in 1/{unit}"),
        );
        add(
            format!("k2{end}"),
            format!("larger principal curvature {at}, in 1/{unit}"),
        );
        if info.directions {
            for (d, k) in [("d1", "k1"), ("d2", "k2")] {
                for axis in AXES {
                    let text = format!("direction of {k} along world {axis}, sign arbitrary");
                    add(format!("{d}{axis}{end}"), text);
                }
            }
        }
        if info.quality {
            let text = format!(
                "quality of the normals, mu_Omega / mu0 {at}, in 1/{unit}: 0 if they are those of a \
                 surface; compare its size with mean_curvature"
            );
            add(format!("quality{end}"), text);
        }
        add(
            format!("flags{end}"),
            format!("reasons to look twice {at}, bits named in curvox.flags"),
        );
    }
    columns
}

/// The Arrow schema; no column has nulls.
pub(crate) fn schema(info: &TableInfo) -> SchemaRef {
    let fields = column_descriptions(info).into_iter().map(|(name, _)| {
        let kind = match name.as_str() {
            "kx" | "ky" | "kz" => DataType::Int32,
            "side" => DataType::Int8,
            name if name.starts_with("flags") => DataType::UInt16,
            _ => DataType::Float32,
        };
        Field::new(name, kind, false)
    });
    Arc::new(Schema::new(fields.collect::<Vec<_>>()))
}

/// Bytes of a row in memory.
pub(crate) fn row_bytes(info: &TableInfo) -> u64 {
    let widths = schema(info)
        .fields()
        .iter()
        .map(|f| f.data_type().primitive_width())
        .collect::<Vec<_>>();
    widths.into_iter().flatten().map(|width| width as u64).sum()
}

/// Moves the rows out of `rows`, which keeps its shape but is empty afterwards.
pub(crate) fn take_record_batch(
    rows: &mut SurfelBatch,
    schema: &SchemaRef,
) -> Result<RecordBatch, SinkError> {
    fn float(column: &mut Vec<f32>) -> ArrayRef {
        Arc::new(Float32Array::from(std::mem::take(column)))
    }
    let mut arrays: Vec<ArrayRef> = Vec::with_capacity(schema.fields().len());
    for column in &mut rows.k {
        arrays.push(Arc::new(Int32Array::from(std::mem::take(column))));
    }
    arrays.push(Arc::new(Int8Array::from(std::mem::take(&mut rows.side))));
    arrays.extend(rows.position.iter_mut().map(float));
    arrays.extend(rows.normal.iter_mut().map(float));
    arrays.push(float(&mut rows.area));
    let has = |start: &str| schema.fields().iter().any(|f| f.name().starts_with(start));
    let (directions, quality) = (has("d1x"), has("quality"));
    let errors = has("mean_curvature_error");
    for at in &mut rows.curvatures {
        arrays.extend([&mut at.mean, &mut at.gaussian].map(float));
        if errors {
            arrays.extend([&mut at.mean_error, &mut at.gaussian_error].map(float));
        }
        arrays.extend([&mut at.k1, &mut at.k2].map(float));
        if directions {
            arrays.extend(at.d1.iter_mut().map(float));
            arrays.extend(at.d2.iter_mut().map(float));
        }
        if quality {
            arrays.push(float(&mut at.quality));
        }
        arrays.push(Arc::new(UInt16Array::from(std::mem::take(&mut at.flags))));
    }
    RecordBatch::try_new(Arc::clone(schema), arrays)
        .map_err(|error| SinkError::Contract(format!("columns do not fit the schema: {error}")))
}

impl SurfelBatch {
    /// No rows, with room for `rows`, and the columns that `info` asks for.
    #[must_use]
    pub fn with_capacity(info: &TableInfo, rows: usize) -> Self {
        let floats = || Vec::with_capacity(rows);
        let only_if = |asked: bool| if asked { floats() } else { Vec::new() };
        let triple = || [floats(), floats(), floats()];
        let direction = || {
            if info.directions {
                triple()
            } else {
                Default::default()
            }
        };
        Self {
            column: [0, 0],
            k: std::array::from_fn(|_| Vec::with_capacity(rows)),
            side: Vec::with_capacity(rows),
            position: triple(),
            normal: triple(),
            area: floats(),
            curvatures: info
                .radii
                .iter()
                .map(|_| CurvatureColumns {
                    mean: floats(),
                    gaussian: floats(),
                    mean_error: only_if(info.errors),
                    gaussian_error: only_if(info.errors),
                    k1: floats(),
                    k2: floats(),
                    d1: direction(),
                    d2: direction(),
                    quality: only_if(info.quality),
                    flags: Vec::with_capacity(rows),
                })
                .collect(),
        }
    }

    /// Appends the rows `range` of another batch with the same columns.
    ///
    /// # Panics
    ///
    /// If the range is beyond the other batch.
    pub fn extend_from(&mut self, other: &SurfelBatch, range: Range<usize>) {
        fn copy<T: Copy>(to: &mut Vec<T>, from: &[T], range: &Range<usize>) {
            to.extend_from_slice(&from[range.clone()]);
        }
        fn copy_triple<T: Copy>(to: &mut [Vec<T>; 3], from: &[Vec<T>; 3], range: &Range<usize>) {
            for (to, from) in to.iter_mut().zip(from) {
                copy(to, from, range);
            }
        }
        let r = &range;
        copy_triple(&mut self.k, &other.k, r);
        copy(&mut self.side, &other.side, r);
        copy_triple(&mut self.position, &other.position, r);
        copy_triple(&mut self.normal, &other.normal, r);
        copy(&mut self.area, &other.area, r);
        for (to, from) in self.curvatures.iter_mut().zip(&other.curvatures) {
            copy(&mut to.mean, &from.mean, r);
            copy(&mut to.gaussian, &from.gaussian, r);
            copy(&mut to.k1, &from.k1, r);
            copy(&mut to.k2, &from.k2, r);
            if !from.d1[0].is_empty() {
                copy_triple(&mut to.d1, &from.d1, r);
                copy_triple(&mut to.d2, &from.d2, r);
            }
            if !from.mean_error.is_empty() {
                copy(&mut to.mean_error, &from.mean_error, r);
                copy(&mut to.gaussian_error, &from.gaussian_error, r);
            }
            if !from.quality.is_empty() {
                copy(&mut to.quality, &from.quality, r);
            }
            copy(&mut to.flags, &from.flags, r);
        }
    }

    /// Makes room for `rows` rows, in all columns but those that are seldom asked for.
    pub(crate) fn reserve_rows(&mut self, rows: usize) {
        self.k.iter_mut().for_each(|column| column.reserve(rows));
        self.side.reserve(rows);
        let triples = self.position.iter_mut().chain(&mut self.normal);
        triples.for_each(|column| column.reserve(rows));
        self.area.reserve(rows);
        for at in &mut self.curvatures {
            let values = [&mut at.mean, &mut at.gaussian, &mut at.k1, &mut at.k2];
            values.into_iter().for_each(|column| column.reserve(rows));
            at.flags.reserve(rows);
        }
    }

    /// The Khalimsky coordinates of a row.
    ///
    /// # Panics
    ///
    /// If there is no such row.
    #[must_use]
    pub fn k_at(&self, row: usize) -> [i32; 3] {
        [self.k[0][row], self.k[1][row], self.k[2][row]]
    }

    /// Whether all columns that `info` asks for are there, equally long.
    pub(crate) fn check(&self, info: &TableInfo) -> Result<(), SinkError> {
        let rows = self.len();
        let mut lengths = vec![self.area.len()];
        lengths.extend(self.k.iter().map(Vec::len));
        lengths.extend(self.position.iter().chain(&self.normal).map(Vec::len));
        let direction_rows = if info.directions { rows } else { 0 };
        let mut whole = self.curvatures.len() == info.radii.len();
        for at in &self.curvatures {
            lengths.extend([&at.mean, &at.gaussian, &at.k1, &at.k2].map(Vec::len));
            lengths.push(at.flags.len());
            whole &= at
                .d1
                .iter()
                .chain(&at.d2)
                .all(|column| column.len() == direction_rows);
            let has = |column: &Vec<f32>, asked: bool| column.len() == if asked { rows } else { 0 };
            whole &= has(&at.quality, info.quality);
            whole &= has(&at.mean_error, info.errors) && has(&at.gaussian_error, info.errors);
        }
        if whole && lengths.iter().all(|&length| length == rows) {
            return Ok(());
        }
        Err(SinkError::Contract(format!(
            "a batch of {rows} rows has columns of other lengths, or lacks columns"
        )))
    }
}

/// Checks that the rows of each column of parts come in Khalimsky order and stay in their column.
#[derive(Debug, Default)]
pub(crate) struct OrderCheck {
    last: std::collections::BTreeMap<[u32; 2], [i32; 3]>,
}

impl OrderCheck {
    pub(crate) fn check(&mut self, batch: &SurfelBatch, parts: &Parts) -> Result<(), SinkError> {
        let zyx = |row: usize| [batch.k[2][row], batch.k[1][row], batch.k[0][row]];
        let mut last = self
            .last
            .get(&batch.column)
            .copied()
            .unwrap_or([i32::MIN; 3]);
        for row in 0..batch.len() {
            let here = zyx(row);
            if here <= last {
                return Err(SinkError::Contract(format!(
                    "surfel {:?} after {:?} is not in Khalimsky order",
                    batch.k_at(row),
                    [last[2], last[1], last[0]],
                )));
            }
            last = here;
        }
        // Within a column kx and ky lie in one range, so the extremes tell for all rows.
        for axis in 0..2 {
            let (low, high) = extremes(&batch.k[axis]);
            for k in [low, high] {
                let mut at = [0; 3];
                at[axis] = k;
                if !batch.is_empty() && parts.column_of(at)[axis] != batch.column[axis] {
                    return Err(SinkError::Contract(format!(
                        "a surfel at {k} along axis {axis} is not in column {:?}",
                        batch.column
                    )));
                }
            }
        }
        self.last.insert(batch.column, last);
        Ok(())
    }
}

fn extremes(values: &[i32]) -> (i32, i32) {
    values.iter().fold((i32::MAX, i32::MIN), |(low, high), &v| {
        (low.min(v), high.max(v))
    })
}
