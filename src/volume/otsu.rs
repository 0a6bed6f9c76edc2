//! The values of a whole volume: their range, mean, and the threshold of Otsu.
//!
//! Comes in: a volume that can be opened as often as needed. Goes out: [`Values`].
//!
//! Integers of 8 and 16 bits are counted value by value in one pass. Other types take a pass for
//! their range and one for [`BINS`] equal bins over it (one bin a value where integers span fewer).
//!
//! Otsu's threshold splits the values into two classes with the greatest variance between them
//! (N. Otsu, *A threshold selection method from gray-level histograms*, 1979, equation 18). Here a
//! value is in the upper class if it is **at or above** the threshold, which is the lowest value
//! (of bins: the lower end of the lowest filled bin) of that class. Among equal splits the lowest is taken.
//!
//! A volume that is decoded in pieces is read piece by piece, and voxels that are known to be uniform
//! are counted without being read.
//!
//! Guaranteed: the same numbers for any number of threads. Not guaranteed: digits of 64-bit
//! integers beyond the 53 of a float. NaN and infinities are counted and otherwise left out.

use std::sync::atomic::{AtomicBool, Ordering};

use curvox_formats::{
    ByteOrder, Error, ErrorKind, Header, RandomVoxels, Region, Volume, VoxelType, Voxels,
};
use half::f16;
use rayon::prelude::*;

use super::tiles::{PieceGrid, TileMap};

/// Bins of values that are not counted one by one. Fewer make the threshold coarse where a few
/// outliers stretch the range.
pub const BINS: usize = 1 << 16;

/// Stored bytes read at a time.
const READ_BYTES: u64 = 4 << 20;

/// Voxels that a task takes at a time; sums depend on it, so it is fixed.
const TASK_VOXELS: usize = 1 << 18;

/// What the values of a volume are like, after scaling.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Values {
    /// Voxels.
    pub voxels: u64,
    /// Voxels that are not a number.
    pub nan: u64,
    /// Voxels that are infinite.
    pub infinite: u64,
    /// Smallest finite value; `None` if there is none.
    pub min: Option<f64>,
    /// Largest finite value.
    pub max: Option<f64>,
    /// Mean of the finite values.
    pub mean: Option<f64>,
    /// Threshold of Otsu; `None` if there are not two different values.
    pub otsu: Option<f64>,
}

/// Reads all values of the volume that `open` gives, once or twice.
///
/// # Errors
/// Those of opening and reading; of kind `Cancelled` once `stop` is set.
pub fn survey<E: From<Error>>(
    mut open: impl FnMut() -> Result<Volume, E>,
    stop: &AtomicBool,
) -> Result<Values, E> {
    let volume = open()?;
    let header = volume.header.clone();
    let scaling = header.scaling;
    let scaled = |stored: f64| scaling.map_or(stored, |s| s.slope * stored + s.intercept);
    let mut bins = Bins::of_type(header.voxel);
    let range = scan(volume, bins.as_mut(), stop)?;
    if bins.is_none()
        && let Some(mut over) = Bins::over(&range, header.voxel)
    {
        scan(open()?, Some(&mut over), stop)?;
        bins = Some(over);
    }
    let descending = scaling.is_some_and(|s| s.slope < 0.0);
    let otsu = bins.and_then(|bins| {
        if descending {
            // The upper class is the lower one of what is stored; its lowest value is the
            // largest stored.
            let flipped: Vec<u64> = bins.counts.iter().rev().copied().collect();
            let bin = flipped.len() - 1 - split(&flipped)?;
            Some(bins.upper(bin))
        } else {
            Some(bins.lower(split(&bins.counts)?))
        }
    });
    let (mut min, mut max) = (range.min.map(scaled), range.max.map(scaled));
    if descending {
        (min, max) = (max, min);
    }
    Ok(Values {
        voxels: range.voxels,
        nan: range.nan,
        infinite: range.infinite,
        min,
        max,
        mean: (range.finite() > 0).then(|| scaled(range.sum / range.finite() as f64)),
        otsu: otsu.map(scaled),
    })
}

/// The first bin of the upper class; `None` if fewer than two bins are filled.
fn split(counts: &[u64]) -> Option<usize> {
    let total: u64 = counts.iter().sum();
    // Otsu's split does not change under affine maps of the values, so bins stand for them.
    let moment = |counts: &[u64]| -> u128 {
        let terms = counts.iter().enumerate();
        terms.map(|(i, &n)| i as u128 * u128::from(n)).sum()
    };
    let whole = moment(counts);
    let (mut below, mut sum_below) = (0u64, 0u128);
    let mut best: Option<(f64, usize)> = None;
    for (bin, &count) in counts.iter().enumerate() {
        if count > 0 && below > 0 {
            let above = total - below;
            let mean_below = sum_below as f64 / below as f64;
            let mean_above = (whole - sum_below) as f64 / above as f64;
            let between = below as f64 * above as f64 * (mean_above - mean_below).powi(2);
            if best.is_none_or(|(most, _)| between > most) {
                best = Some((between, bin));
            }
        }
        below += count;
        sum_below += bin as u128 * u128::from(count);
    }
    best.map(|(_, bin)| bin)
}

/// Counts of stored values.
#[derive(Clone, Debug)]
struct Bins {
    low: f64,
    width: f64,
    /// One value a bin.
    single: bool,
    counts: Vec<u64>,
}

impl Bins {
    /// One bin for each value of a type of 8 or 16 bits.
    fn of_type(voxel: VoxelType) -> Option<Self> {
        let (low, count) = match voxel {
            VoxelType::Bool | VoxelType::U8 => (0.0, 1 << 8),
            VoxelType::I8 => (f64::from(i8::MIN), 1 << 8),
            VoxelType::U16 => (0.0, 1 << 16),
            VoxelType::I16 => (f64::from(i16::MIN), 1 << 16),
            _ => return None,
        };
        Some(Self {
            low,
            width: 1.0,
            single: true,
            counts: vec![0; count],
        })
    }

    /// Bins over a range; `None` if it is empty.
    fn over(range: &Range, voxel: VoxelType) -> Option<Self> {
        let (low, high) = (range.min?, range.max?);
        let single = !voxel.is_float() && high - low < BINS as f64;
        // Halves, so that the range of all floats does not overflow.
        let width = (high / BINS as f64) - (low / BINS as f64);
        Some(Self {
            low,
            width: if single { 1.0 } else { width },
            single,
            counts: vec![0; BINS],
        })
    }

    fn bin(&self, value: f64) -> usize {
        let place = (value / self.width) - (self.low / self.width);
        // Saturates at 0 below and for NaN.
        (place as usize).min(self.counts.len() - 1)
    }

    fn lower(&self, bin: usize) -> f64 {
        self.low + bin as f64 * self.width
    }

    /// The upper end of a bin: its value, where it has one.
    fn upper(&self, bin: usize) -> f64 {
        if self.single {
            self.lower(bin)
        } else {
            self.lower(bin + 1)
        }
    }
}

/// What a pass finds, of stored values.
#[derive(Clone, Debug, Default)]
struct Range {
    voxels: u64,
    nan: u64,
    infinite: u64,
    min: Option<f64>,
    max: Option<f64>,
    sum: f64,
}

impl Range {
    fn finite(&self) -> u64 {
        self.voxels - self.nan - self.infinite
    }

    /// Adds voxels of one value; tells whether that is finite.
    fn see(&mut self, value: f64, count: u64) -> bool {
        self.voxels += count;
        if !value.is_finite() {
            if value.is_nan() {
                self.nan += count;
            } else {
                self.infinite += count;
            }
            return false;
        }
        if self.min.is_none_or(|min| value < min) {
            self.min = Some(value);
        }
        if self.max.is_none_or(|max| value > max) {
            self.max = Some(value);
        }
        self.sum += value * count as f64;
        true
    }

    fn add(&mut self, other: &Self) {
        self.voxels += other.voxels;
        self.nan += other.nan;
        self.infinite += other.infinite;
        self.sum += other.sum;
        for value in [other.min, other.max].into_iter().flatten() {
            if self.min.is_none_or(|min| value < min) {
                self.min = Some(value);
            }
            if self.max.is_none_or(|max| value > max) {
                self.max = Some(value);
            }
        }
    }
}

/// A pass over all voxels.
struct Scan<'a> {
    header: Header,
    bins: Option<&'a mut Bins>,
    range: Range,
}

/// One pass over all voxels.
fn scan(volume: Volume, bins: Option<&mut Bins>, stop: &AtomicBool) -> Result<Range, Error> {
    let header = volume.header.clone();
    let name = volume.source.name.clone();
    let stopped = || {
        if stop.load(Ordering::Relaxed) {
            return Err(Error::new(ErrorKind::Cancelled, &name, "interrupted"));
        }
        Ok(())
    };
    let mut scan = Scan {
        header,
        bins,
        range: Range::default(),
    };
    if let Voxels::Random(voxels) = &volume.voxels
        && let Some(pieces) = PieceGrid::of(voxels.as_ref())
    {
        scan.pieces(voxels.as_ref(), &pieces, stopped)?;
        voxels.check()?;
        return Ok(scan.range);
    }
    let plane_bytes = scan.header.plane_bytes().unwrap_or(u64::MAX).max(1);
    let planes = (READ_BYTES / plane_bytes).max(1);
    let mut forward = volume.into_forward();
    let mut buffer = Vec::new();
    while forward.read_planes(planes, &mut buffer)? > 0 {
        stopped()?;
        let seen: Vec<_> = buffer
            .par_chunks(TASK_VOXELS * scan.header.voxel.bytes())
            .map(|chunk| scan.see(chunk))
            .collect();
        scan.add(seen);
    }
    forward.finish()?;
    Ok(scan.range)
}

impl Scan<'_> {
    /// The values of some voxels, fewer than 2^32, and how many are in each bin.
    fn see(&self, stored: &[u8]) -> (Range, Vec<u32>) {
        let counting = self.bins.as_deref();
        let mut range = Range::default();
        let mut counts = vec![0u32; counting.map_or(0, |b| b.counts.len())];
        for_each_value(&self.header, stored, |value| {
            if range.see(value, 1)
                && let Some(bins) = counting
            {
                counts[bins.bin(value)] += 1;
            }
        });
        (range, counts)
    }

    fn add(&mut self, seen: Vec<(Range, Vec<u32>)>) {
        for (of_chunk, counts) in seen {
            self.range.add(&of_chunk);
            if let Some(bins) = self.bins.as_deref_mut() {
                for (sum, n) in bins.counts.iter_mut().zip(counts) {
                    *sum += u64::from(n);
                }
            }
        }
    }

    /// All voxels of a volume that is decoded in pieces, each decoded once as far as layers of them
    /// go; those that are known to be uniform are counted without being read.
    fn pieces(
        &mut self,
        voxels: &dyn RandomVoxels,
        pieces: &PieceGrid,
        stopped: impl Fn() -> Result<(), Error>,
    ) -> Result<(), Error> {
        /// Boxes at once; each holds its own counts.
        const BOXES: usize = 64;
        let dims = self.header.dims;
        let voxel_bytes = self.header.voxel.bytes() as u64;
        let [Ok(x), Ok(y), Ok(depth)] = dims.map(u32::try_from) else {
            return Err(Error::unsupported(
                "the image",
                "an extent beyond 2^32 voxels",
            ));
        };
        let band = pieces.band_rows(dims);
        let piece = pieces.shape;
        // Large thin pieces, such as slices, are not read several at a time.
        let narrowest = band.saturating_mul(piece[0].min(dims[0])) * voxel_bytes;
        let planes = match pieces.tiled_planes() {
            planes if narrowest.saturating_mul(planes) > READ_BYTES => planes.min(piece[2]),
            planes => planes,
        };
        let mut z = 0;
        while z < dims[2] {
            let end = pieces.step_end(2, z, planes).min(dims[2]);
            let uniform = |region: &Region| voxels.uniform(region);
            let map = TileMap::find([x, y, depth], pieces, z..end, uniform, |_| false);
            for (count, value) in map.uniform() {
                let header = self.header.clone();
                for_each_value(&header, &value[..voxel_bytes as usize], |value| {
                    let count = count * (end - z);
                    if self.range.see(value, count)
                        && let Some(bins) = self.bins.as_deref_mut()
                    {
                        let bin = bins.bin(value);
                        bins.counts[bin] += count;
                    }
                });
            }
            // Pieces that follow each other, as many as are worth a read.
            let column_bytes = band * (end - z) * voxel_bytes;
            let across = (READ_BYTES / (column_bytes * piece[0].min(dims[0])).max(1)).max(1);
            let wide = piece[0].saturating_mul(across);
            let mut boxes = Vec::new();
            for kept in map.kept() {
                for columns in kept.columns {
                    let mut from = u64::from(columns.start);
                    while from < columns.end.into() {
                        let to = pieces.step_end(0, from, wide).min(columns.end.into());
                        let rows = u64::from(kept.rows.start)..u64::from(kept.rows.end);
                        boxes.push(Region {
                            origin: [from, rows.start, z],
                            size: [to - from, rows.end - rows.start, end - z],
                        });
                        from = to;
                    }
                }
            }
            for some in boxes.chunks(BOXES) {
                stopped()?;
                let seen: Vec<_> = some
                    .par_iter()
                    .map_init(Vec::new, |buffer, region| {
                        voxels.read_box(region, buffer)?;
                        Ok(self.see(buffer))
                    })
                    .collect::<Result<_, Error>>()?;
                self.add(seen);
            }
            voxels.release(end);
            z = end;
        }
        Ok(())
    }
}

/// Calls `see` with each stored value, in order.
fn for_each_value(header: &Header, bytes: &[u8], mut see: impl FnMut(f64)) {
    let big = header.byte_order == ByteOrder::Big;
    macro_rules! each {
        ($type:ty, $to_f64:expr) => {{
            for &b in bytes.as_chunks::<{ size_of::<$type>() }>().0 {
                let value = if big {
                    <$type>::from_be_bytes(b)
                } else {
                    <$type>::from_le_bytes(b)
                };
                see($to_f64(value));
            }
        }};
    }
    match header.voxel {
        VoxelType::Bool | VoxelType::U8 => each!(u8, f64::from),
        VoxelType::I8 => each!(i8, f64::from),
        VoxelType::U16 => each!(u16, f64::from),
        VoxelType::I16 => each!(i16, f64::from),
        VoxelType::U32 => each!(u32, f64::from),
        VoxelType::I32 => each!(i32, f64::from),
        // The nearest float is meant.
        VoxelType::U64 => each!(u64, |v| v as f64),
        VoxelType::I64 => each!(i64, |v| v as f64),
        VoxelType::F16 => each!(f16, f64::from),
        VoxelType::F32 => each!(f32, f64::from),
        VoxelType::F64 => each!(f64, |v| v),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use curvox_formats::{DType, Format, OpenOptions, RawLayout, Scaling, Unit, open_stream};
    use proptest::prelude::*;

    fn values_of(bytes: Vec<u8>, dtype: DType, scaling: Option<Scaling>) -> Values {
        let voxels = bytes.len() / dtype.voxel.bytes();
        let open = || -> Result<Volume, Error> {
            let layout = RawLayout {
                dims: [1, 1, voxels as u64],
                dtype,
                spacing: None,
                unit: Unit::Unknown,
                skip: 0,
            };
            let options = OpenOptions {
                raw: Some(layout),
                // Random bytes can look like the header of another format.
                format: Some(Format::Raw),
                ..OpenOptions::default()
            };
            let reader = std::io::Cursor::new(bytes.clone());
            let mut volume = open_stream(Box::new(reader), "test", &options)?;
            volume.header.scaling = scaling;
            Ok(volume)
        };
        survey(open, &AtomicBool::new(false)).unwrap()
    }

    /// The threshold by trying every value: the lowest of those with the greatest variance.
    fn by_trial(values: &[f64]) -> Option<f64> {
        let mut candidates = values.to_vec();
        candidates.sort_by(f64::total_cmp);
        candidates.dedup();
        let mut best: Option<(f64, f64)> = None;
        for &t in &candidates[1..] {
            let (above, below): (Vec<f64>, Vec<f64>) = values.iter().partition(|&&v| v >= t);
            let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
            let between =
                above.len() as f64 * below.len() as f64 * (mean(&above) - mean(&below)).powi(2);
            if best.is_none_or(|(most, _)| between > most * (1.0 + 1e-12)) {
                best = Some((between, t));
            }
        }
        best.map(|(_, t)| t)
    }

    fn variance_at(values: &[f64], t: f64) -> f64 {
        let (above, below): (Vec<f64>, Vec<f64>) = values.iter().partition(|&&v| v >= t);
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        above.len() as f64 * below.len() as f64 * (mean(&above) - mean(&below)).powi(2)
    }

    proptest! {
        #[test]
        fn threshold_has_the_greatest_variance_between(stored in prop::collection::vec(any::<u8>(), 2..80)) {
            let values: Vec<f64> = stored.iter().map(|&v| f64::from(v)).collect();
            let found = values_of(stored, DType::little(VoxelType::U8), None);
            match by_trial(&values) {
                None => prop_assert_eq!(found.otsu, None),
                Some(t) => {
                    let otsu = found.otsu.unwrap();
                    let (a, b) = (variance_at(&values, otsu), variance_at(&values, t));
                    prop_assert!((a - b).abs() <= 1e-9 * b, "{} {}", otsu, t);
                    prop_assert!(values.contains(&otsu));
                }
            }
        }

        #[test]
        fn scaling_moves_the_threshold_along(stored in prop::collection::vec(any::<i16>(), 2..40), slope in prop::sample::select(vec![2.0, -0.5])) {
            let bytes: Vec<u8> = stored.iter().flat_map(|v| v.to_be_bytes()).collect();
            let scaling = Scaling { slope, intercept: 7.0 };
            let values: Vec<f64> = stored.iter().map(|&v| slope * f64::from(v) + 7.0).collect();
            let found = values_of(bytes, DType::big(VoxelType::I16), Some(scaling));
            prop_assert_eq!(found.min, values.iter().copied().min_by(f64::total_cmp));
            prop_assert_eq!(found.max, values.iter().copied().max_by(f64::total_cmp));
            if let Some(t) = by_trial(&values) {
                let otsu = found.otsu.unwrap();
                let (a, b) = (variance_at(&values, otsu), variance_at(&values, t));
                prop_assert!((a - b).abs() <= 1e-9 * b, "{} {}", otsu, t);
            }
        }

        #[test]
        fn bins_of_floats_split_as_well_as_their_width_allows(stored in prop::collection::vec(-1e3f32..1e3, 2..60)) {
            let bytes: Vec<u8> = stored.iter().flat_map(|v| v.to_le_bytes()).collect();
            let values: Vec<f64> = stored.iter().map(|&v| f64::from(v)).collect();
            let found = values_of(bytes, DType::little(VoxelType::F32), None);
            if let Some(t) = by_trial(&values) {
                let best = variance_at(&values, t);
                prop_assert!(variance_at(&values, found.otsu.unwrap()) >= best * 0.99);
            }
        }
    }

    #[test]
    fn not_numbers_and_infinities_are_left_out() {
        let stored = [1.0f32, f32::NAN, 3.0, f32::INFINITY, f32::NEG_INFINITY];
        let bytes = stored.iter().flat_map(|v| v.to_le_bytes()).collect();
        let found = values_of(bytes, DType::little(VoxelType::F32), None);
        assert_eq!((found.voxels, found.nan, found.infinite), (5, 1, 2));
        assert_eq!(
            (found.min, found.max, found.mean),
            (Some(1.0), Some(3.0), Some(2.0))
        );
        assert!(found.otsu.unwrap() > 1.0 && found.otsu.unwrap() <= 3.0);
    }

    #[test]
    fn one_value_has_no_threshold() {
        for dtype in [VoxelType::U8, VoxelType::F64, VoxelType::I64] {
            let found = values_of(vec![0; 64], DType::little(dtype), None);
            assert_eq!((found.min, found.otsu), (Some(0.0), None), "{dtype}");
        }
        let stored = [f64::MAX, f64::MIN]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let found = values_of(stored, DType::little(VoxelType::F64), None);
        assert!(found.otsu.unwrap() > 0.0);
    }

    #[test]
    fn labels_of_wide_integers_are_counted_one_by_one() {
        let stored = [1_000_000u32, 1_000_007, 1_000_007, 1_000_001];
        let bytes = stored.iter().flat_map(|v| v.to_le_bytes()).collect();
        let found = values_of(bytes, DType::little(VoxelType::U32), None);
        assert_eq!(found.otsu, Some(1_000_007.0));
    }
}
