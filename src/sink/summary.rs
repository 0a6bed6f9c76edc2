//! Totals, histograms and warnings of a run: `summary.json`.
//!
//! Comes in: the rows, and at the end what only the pipeline knows ([`ExactTotals`], parameters,
//! warnings). Goes out: a [`Summary`], the same bytes whatever the cut, the threads and the budget:
//! sums are kept for each part in row order, in `f64`, and added in the order of the parts.
//!
//! Integrals weigh a row by its area mu0, which is negative where the corrected normal opposes the
//! surfel's own (flag `normal_opposed`); histograms and means weigh it by its area if that is
//! positive, else by 0. Rows whose value is NaN or infinite (flag `no_area`) are counted, and are
//! in none of the sums of that value.

use std::collections::BTreeMap;
use std::iter::Copied;
use std::ops::Range;
use std::path::Path;
use std::slice::Iter;

use serde::Serialize;
use serde_json::Value;

use super::SurfelSink;
use super::batch::{CurvatureColumns, Flag, FlagSet, SurfelBatch};
use super::error::SinkError;
use super::info::{RadiusInfo, TableInfo};
use super::parts::Parts;
use super::run_record::pretty;
use super::whole_file::write_whole;

/// Bins of a histogram. Fewer hide the narrow peak of a flat region, more are mostly noise.
pub const HISTOGRAM_BINS: usize = 200;

/// Half the range of a histogram, in units of 1/radius (for G: its square in 1/radius^2). Features
/// beyond 1/radius are smaller than the ball; twice that shows how many there are.
pub const HISTOGRAM_REACH: f64 = 2.0;

/// Totals that come from the cells themselves, not from rows; exact where they are integers.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ExactTotals {
    /// Surfels of the surface.
    pub surfels: u64,
    /// Surfels orthogonal to x, y, z.
    pub surfels_xyz: [u64; 3],
    /// Linels, each joining two surfels.
    pub linels: u64,
    /// Pointels after splitting, that is umbrellas.
    pub pointels: u64,
    /// Euler characteristic V - E + F of the split surface.
    pub euler_counted: i64,
    /// Euler characteristic by Gauss-Bonnet, sum(mu2) / 2 pi + 2 sum(k); `None` if it was not
    /// computed or is no integer, and with a linear field, for which there is no such theorem.
    pub euler_gauss_bonnet: Option<i64>,
    /// Sum of the lifts k of mu2; 0 with a linear field, which has none.
    pub sum_k: i64,
    /// Sum of their absolute values: how bad the normals are.
    pub sum_abs_k: u64,
    /// Corrected area, in world units squared.
    pub mu0: f64,
    /// Twice the integral of H, in world units.
    pub mu1: f64,
    /// Integral of G.
    pub mu2: f64,
    /// Euler characteristic of the solid with 6-adjacency.
    pub chi6: i64,
    /// Euler characteristic of the solid with 26-adjacency.
    pub chi26: i64,
    /// 2x2x2 blocks whose only two outside voxels are antipodal (B).
    pub antipodal_outside: u64,
    /// 2x2x2 blocks whose only two inside voxels are antipodal (A).
    pub antipodal_inside: u64,
    /// Whether the surface was closed at the border of the image.
    pub closed: bool,
    /// Voxels of the solid.
    pub inside_voxels: u64,
    /// Voxels whose value was NaN.
    pub nan_voxels: u64,
}

/// What the pipeline adds to the rows when a run ends.
#[derive(Clone, Debug, Default)]
pub struct RunFacts {
    /// Totals of the cells, if they were counted.
    pub exact: Option<ExactTotals>,
    /// Things the user should know, a sentence each.
    pub warnings: Vec<String>,
    /// The input: path, format, value type, threshold.
    pub input: Value,
    /// Which radii were tried and why one was taken, where it was chosen from the data.
    pub radius_choice: Option<Value>,
}

/// The contents of `summary.json`; fields appear in this order.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Always `curvox summary 1`.
    pub format: &'static str,
    /// Version of curvox.
    pub version: String,
    /// Things the user should know, a sentence each.
    pub warnings: Vec<String>,
    /// The input as the pipeline describes it.
    pub input: Value,
    /// Voxels along x, y, z.
    pub dims: [u32; 3],
    /// Edges of a voxel, in world units.
    pub spacing: [f64; 3],
    /// The world unit of all lengths; areas are in its square, H in its inverse.
    pub unit: String,
    /// World coordinates of the centre of voxel (0, 0, 0).
    pub origin: [f64; 3],
    /// Rows of the direction matrix.
    pub direction: [[f64; 3]; 3],
    /// Rows of the table.
    pub rows: u64,
    /// Totals of the cells.
    pub exact: Option<ExactTotals>,
    /// Which radii were tried and why one was taken, where it was chosen from the data.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_choice: Option<Value>,
    /// What the rows give at each radius.
    pub radii: Vec<RadiusSummary>,
    /// Conventions in words, a sentence each.
    pub conventions: Vec<String>,
    /// Parameters of the run.
    pub parameters: Value,
}

/// What the rows give at one radius.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RadiusSummary {
    /// The radius as the user wrote it.
    pub label: String,
    /// In voxels.
    pub voxels: f64,
    /// In world units.
    pub world: f64,
    /// Over all rows.
    pub all: RowTotals,
    /// Over the rows without the flag `border`.
    pub without_border: RowTotals,
    /// Rows that carry each flag, lowest bit first.
    pub flags: Vec<FlagCount>,
    /// H.
    pub mean_curvature: Distribution,
    /// G.
    pub gaussian_curvature: Distribution,
    /// Smaller principal curvature.
    pub k1: Distribution,
    /// Larger principal curvature.
    pub k2: Distribution,
    /// Root mean square, weighted by area, of (k1 + k2) / 2 - H: how far the principal curvatures
    /// are from the mean one.
    pub principal_mismatch_rms: Option<f64>,
    /// Median of the error bars of H, in 1/world-unit, over the rows without the flag `border` that have one; `None` if there are none.
    pub mean_curvature_error_median: Option<f32>,
    /// Root mean square, weighted by area, of the quality of the normals, mu_Omega / mu0; `None` if it
    /// was not asked for.
    pub quality_rms: Option<f64>,
}

/// Sums over rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RowTotals {
    /// Rows.
    pub rows: u64,
    /// Sum of the areas mu0.
    pub area: f64,
    /// Sum of H mu0: half of mu1.
    pub integral_mean_curvature: f64,
    /// Sum of G mu0.
    pub integral_gaussian_curvature: f64,
}

/// Rows that carry a flag.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FlagCount {
    /// Name of the flag.
    pub name: &'static str,
    /// Its bit.
    pub bit: u16,
    /// Rows that carry it.
    pub rows: u64,
}

/// How a value is distributed over the surface.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Distribution {
    /// Rows where the value is NaN or infinite.
    pub not_finite: u64,
    /// Smallest value; `None` without finite values.
    pub min: Option<f32>,
    /// Largest value.
    pub max: Option<f32>,
    /// Mean weighted by area; `None` without area.
    pub mean: Option<f64>,
    /// Area in each interval of values.
    pub histogram: Histogram,
}

/// Area by value, in equal bins between two fixed ends.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Histogram {
    /// Lower end of the first bin.
    pub low: f64,
    /// Upper end of the last bin.
    pub high: f64,
    /// Area below `low`.
    pub below: f64,
    /// Area at or above `high`.
    pub above: f64,
    /// Area in each bin; a bin holds its lower end and not its upper.
    pub area: Vec<f64>,
}

/// Sums rows; a sink that writes nothing until asked.
#[derive(Clone, Debug)]
pub struct SummarySink {
    info: TableInfo,
    parts: Parts,
    /// By part, so that the order in which columns alternate does not show in the sums.
    sums: BTreeMap<u64, PartSums>,
}

#[derive(Clone, Debug)]
struct PartSums {
    rows: u64,
    radii: Vec<RadiusSums>,
}

/// Sums over rows at one radius.
#[derive(Clone, Debug)]
pub(super) struct RadiusSums {
    all: RowTotals,
    without_border: RowTotals,
    flags: [u64; Flag::ALL.len()],
    values: [ValueSums; 4],
    mismatch: f64,
    mismatch_area: f64,
    quality: f64,
    quality_area: f64,
    /// Rows by the error bar of H.
    errors: Counts,
}

/// Numbers that are not negative, and how often each was met. As few as error bars have digits, they are counted in pages.
#[derive(Clone, Debug)]
struct Counts {
    /// By the eight leading bits; of numbers whose sixteen last bits are 0 by the eight that follow. Empty before the first.
    pages: Vec<Vec<u64>>,
    /// All others, by their bits.
    others: BTreeMap<u32, u64>,
}

#[derive(Clone, Debug)]
struct ValueSums {
    not_finite: u64,
    min: f32,
    max: f32,
    weighted: f64,
    weight: f64,
    histogram: Histogram,
}

impl SummarySink {
    /// Begins the sums.
    ///
    /// # Errors
    ///
    /// If `info` is not valid.
    pub fn new(info: TableInfo) -> Result<Self, SinkError> {
        info.check()?;
        Ok(Self {
            parts: Parts::new(info.dims),
            info,
            sums: BTreeMap::new(),
        })
    }

    /// The totals of all rows so far.
    #[must_use]
    pub fn summary(&self, facts: RunFacts) -> Summary {
        let mut total = PartSums::new(&self.info);
        for sums in self.sums.values() {
            total.add(sums);
        }
        let info = &self.info;
        let radii = info.radii.iter().zip(total.radii);
        let radii = radii.map(|(radius, sums)| sums.finish(radius));
        Summary {
            format: "curvox summary 1",
            version: info.version.clone(),
            warnings: facts.warnings,
            input: facts.input,
            dims: info.dims,
            spacing: info.spacing,
            unit: info.unit.clone(),
            origin: info.origin,
            direction: info.direction,
            rows: total.rows,
            exact: facts.exact,
            radius_choice: facts.radius_choice,
            radii: radii.collect(),
            conventions: info.conventions.clone(),
            parameters: info.parameters.clone(),
        }
    }
}

impl SurfelSink for SummarySink {
    fn write(&mut self, batch: &SurfelBatch) -> Result<(), SinkError> {
        batch.check(&self.info)?;
        let mut from = 0;
        while from < batch.len() {
            let layer = self.parts.layer_of(batch.k[2][from]);
            let rest = &batch.k[2][from..];
            let to = from + rest.partition_point(|&kz| self.parts.layer_of(kz) <= layer);
            let part = self.parts.index(layer, batch.column);
            let sums = self
                .sums
                .entry(part)
                .or_insert_with(|| PartSums::new(&self.info));
            sums.rows += (to - from) as u64;
            for (sums, at) in sums.radii.iter_mut().zip(&batch.curvatures) {
                sums.rows(&batch.area, at, from..to);
            }
            from = to;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

impl Summary {
    /// Writes the summary as JSON, whole or not at all.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), SinkError> {
        write_whole(path, pretty(self)?.as_bytes())
    }
}

impl PartSums {
    fn new(info: &TableInfo) -> Self {
        Self {
            rows: 0,
            radii: info
                .radii
                .iter()
                .map(|r| RadiusSums::new(r.world))
                .collect(),
        }
    }

    fn add(&mut self, other: &Self) {
        self.rows += other.rows;
        for (sums, other) in self.radii.iter_mut().zip(&other.radii) {
            sums.add(other);
        }
    }
}

impl RadiusSums {
    pub(super) fn new(radius_world: f64) -> Self {
        let linear = ValueSums::new(HISTOGRAM_REACH / radius_world);
        let square = ValueSums::new(linear.histogram.high * linear.histogram.high);
        Self {
            all: RowTotals::default(),
            without_border: RowTotals::default(),
            flags: [0; Flag::ALL.len()],
            values: [linear.clone(), square, linear.clone(), linear],
            mismatch: 0.0,
            mismatch_area: 0.0,
            quality: 0.0,
            quality_area: 0.0,
            errors: Counts::new(),
        }
    }

    /// Adds the rows `run` of some columns, column by column: each sum is in row order.
    pub(super) fn rows(&mut self, area: &[f32], at: &CurvatureColumns, run: Range<usize>) {
        let area = &area[run.clone()];
        let [mean, gaussian, k1, k2] =
            [&at.mean, &at.gaussian, &at.k1, &at.k2].map(|column| of_rows(column, &run));
        let flags = &at.flags[run.clone()];
        let border = |flags: FlagSet| flags & Flag::Border.bit() != 0;
        let totals = area
            .iter()
            .zip(flags)
            .zip(mean.clone().zip(gaussian.clone()));
        for ((&area, &flags), (mean, gaussian)) in totals {
            self.all.row(f64::from(area), mean, gaussian);
            if !border(flags) {
                self.without_border.row(f64::from(area), mean, gaussian);
            }
            if flags != 0 {
                for (count, flag) in self.flags.iter_mut().zip(Flag::ALL) {
                    *count += u64::from(flags & flag.bit() != 0);
                }
            }
        }
        let of_values = [mean.clone(), gaussian, k1.clone(), k2.clone()];
        for (sums, values) in self.values.iter_mut().zip(of_values) {
            for (&area, value) in area.iter().zip(values) {
                sums.row(weight(area), value);
            }
        }
        for ((&area, mean), (k1, k2)) in area.iter().zip(mean).zip(k1.zip(k2)) {
            let mismatch = 0.5 * (f64::from(k1) + f64::from(k2)) - f64::from(mean);
            if mismatch.is_finite() {
                self.mismatch += weight(area) * mismatch * mismatch;
                self.mismatch_area += weight(area);
            }
        }
        if !at.mean_error.is_empty() {
            for (error, &flags) in of_rows(&at.mean_error, &run).zip(flags) {
                if error.is_finite() && !border(flags) {
                    self.errors.add(error.abs(), 1);
                }
            }
        }
        if !at.quality.is_empty() {
            for (quality, &area) in of_rows(&at.quality, &run).zip(area) {
                if quality.is_finite() {
                    self.quality += weight(area) * f64::from(quality) * f64::from(quality);
                    self.quality_area += weight(area);
                }
            }
        }
    }

    pub(super) fn finish(self, radius: &RadiusInfo) -> RadiusSummary {
        let [mean, gaussian, k1, k2] = self.values.map(ValueSums::finish);
        let counts = Flag::ALL.iter().zip(self.flags);
        RadiusSummary {
            label: radius.label.clone(),
            voxels: radius.voxels,
            world: radius.world,
            all: self.all,
            without_border: self.without_border,
            flags: counts
                .map(|(flag, rows)| FlagCount {
                    name: flag.name(),
                    bit: flag.bit(),
                    rows,
                })
                .collect(),
            mean_curvature: mean,
            gaussian_curvature: gaussian,
            k1,
            k2,
            principal_mismatch_rms: (self.mismatch_area > 0.0)
                .then(|| (self.mismatch / self.mismatch_area).sqrt()),
            mean_curvature_error_median: self.errors.median(),
            quality_rms: (self.quality_area > 0.0)
                .then(|| (self.quality / self.quality_area).sqrt()),
        }
    }

    fn add(&mut self, other: &Self) {
        self.all.add(&other.all);
        self.without_border.add(&other.without_border);
        for (count, other) in self.flags.iter_mut().zip(other.flags) {
            *count += other;
        }
        for (sums, other) in self.values.iter_mut().zip(&other.values) {
            sums.add(other);
        }
        self.mismatch += other.mismatch;
        self.mismatch_area += other.mismatch_area;
        self.quality += other.quality;
        self.quality_area += other.quality_area;
        for (error, rows) in other.errors.all() {
            self.errors.add(f32::from_bits(error), rows);
        }
    }
}

/// Some rows of a column.
fn of_rows<'a>(column: &'a [f32], run: &Range<usize>) -> Copied<Iter<'a, f32>> {
    column[run.clone()].iter().copied()
}

/// What a row weighs: NaN areas compare false and weigh nothing.
fn weight(area: f32) -> f64 {
    if area > 0.0 { f64::from(area) } else { 0.0 }
}

impl Counts {
    fn new() -> Self {
        Self {
            pages: Vec::new(),
            others: BTreeMap::new(),
        }
    }

    /// Counts a number that is not negative some times more.
    fn add(&mut self, x: f32, times: u64) {
        let bits = x.to_bits();
        if bits & 0xffff != 0 {
            *self.others.entry(bits).or_default() += times;
            return;
        }
        if self.pages.is_empty() {
            self.pages = vec![Vec::new(); 256];
        }
        let page = &mut self.pages[(bits >> 24) as usize];
        if page.is_empty() {
            *page = vec![0; 256];
        }
        page[(bits >> 16 & 0xff) as usize] += times;
    }

    /// All numbers met, as bits, and how often: in order.
    fn all(&self) -> BTreeMap<u32, u64> {
        let mut all = self.others.clone();
        for (page, counts) in self.pages.iter().enumerate() {
            for (digits, &count) in counts.iter().enumerate() {
                if count > 0 {
                    all.insert((page as u32) << 24 | (digits as u32) << 16, count);
                }
            }
        }
        all
    }

    /// The lower of two in the middle.
    fn median(&self) -> Option<f32> {
        let all = self.all();
        let half = all.values().sum::<u64>().div_ceil(2);
        let mut passed = 0;
        let middle = all.iter().find(|(_, count)| {
            passed += **count;
            passed >= half
        });
        middle.map(|(bits, _)| f32::from_bits(*bits))
    }
}

impl RowTotals {
    fn row(&mut self, area: f64, mean: f32, gaussian: f32) {
        self.rows += 1;
        self.area += area;
        if mean.is_finite() {
            self.integral_mean_curvature += area * f64::from(mean);
        }
        if gaussian.is_finite() {
            self.integral_gaussian_curvature += area * f64::from(gaussian);
        }
    }

    fn add(&mut self, other: &Self) {
        self.rows += other.rows;
        self.area += other.area;
        self.integral_mean_curvature += other.integral_mean_curvature;
        self.integral_gaussian_curvature += other.integral_gaussian_curvature;
    }
}

impl ValueSums {
    fn new(reach: f64) -> Self {
        Self {
            not_finite: 0,
            min: f32::INFINITY,
            max: f32::NEG_INFINITY,
            weighted: 0.0,
            weight: 0.0,
            histogram: Histogram {
                low: -reach,
                high: reach,
                below: 0.0,
                above: 0.0,
                area: vec![0.0; HISTOGRAM_BINS],
            },
        }
    }

    fn row(&mut self, weight: f64, value: f32) {
        if !value.is_finite() {
            self.not_finite += 1;
            return;
        }
        self.widen(value, value);
        let value = f64::from(value);
        self.weighted += weight * value;
        self.weight += weight;
        self.histogram.add(weight, value);
    }

    fn add(&mut self, other: &Self) {
        self.not_finite += other.not_finite;
        self.widen(other.min, other.max);
        self.weighted += other.weighted;
        self.weight += other.weight;
        let (to, from) = (&mut self.histogram, &other.histogram);
        to.below += from.below;
        to.above += from.above;
        for (bin, other) in to.area.iter_mut().zip(&from.area) {
            *bin += other;
        }
    }

    /// Comparisons rather than `f32::min`, which may return either of 0 and -0.
    fn widen(&mut self, min: f32, max: f32) {
        if min < self.min {
            self.min = min;
        }
        if max > self.max {
            self.max = max;
        }
    }

    fn finish(self) -> Distribution {
        let any = self.min <= self.max;
        Distribution {
            not_finite: self.not_finite,
            min: any.then_some(self.min),
            max: any.then_some(self.max),
            mean: (self.weight > 0.0).then(|| self.weighted / self.weight),
            histogram: self.histogram,
        }
    }
}

impl Histogram {
    fn add(&mut self, area: f64, value: f64) {
        let bins = self.area.len();
        let place = (value - self.low) / (self.high - self.low) * bins as f64;
        if place < 0.0 {
            self.below += area;
        } else if place >= bins as f64 {
            self.above += area;
        } else {
            // In 0..bins by the tests above.
            self.area[place as usize] += area;
        }
    }
}
