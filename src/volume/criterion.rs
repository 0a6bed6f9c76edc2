//! What is inside: from stored voxels to bits.
//!
//! A [`Criterion`] is an interval of values. For integer voxels it is turned, once, into an
//! interval of *stored* integers, exactly (thresholds beyond 2^53 do not pass through a float; a
//! scaling is inverted by search, so rounding is that of the scaled value). Floats are compared
//! as `f64`. NaN is outside and counted.

use std::fmt;
use std::str::FromStr;

use curvox_formats::{ByteOrder, Scaling, VoxelType};
use half::f16;

use crate::simd::{Level, Work, dispatch};

/// A number as typed: whole numbers keep all their digits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number {
    real: f64,
    whole: Option<i128>,
}

impl Number {
    /// As the nearest float.
    #[must_use]
    pub fn real(self) -> f64 {
        self.real
    }

    fn ceil(self) -> i128 {
        // `as` saturates, which is what an interval of integers wants
        self.whole.unwrap_or(self.real.ceil() as i128)
    }

    fn floor(self) -> i128 {
        self.whole.unwrap_or(self.real.floor() as i128)
    }
}

impl From<f64> for Number {
    fn from(real: f64) -> Self {
        Self { real, whole: None }
    }
}

impl From<i128> for Number {
    fn from(whole: i128) -> Self {
        Self {
            real: whole as f64,
            whole: Some(whole),
        }
    }
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.whole {
            Some(whole) => write!(f, "{whole}"),
            None => write!(f, "{}", self.real),
        }
    }
}

/// Why a criterion cannot be understood.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CriterionError {
    /// Not a number.
    #[error("'{0}' is not a number")]
    Number(String),
    /// Not a range.
    #[error("'{0}' is not a range A..B of two numbers with A <= B")]
    Range(String),
}

impl FromStr for Number {
    type Err = CriterionError;

    fn from_str(text: &str) -> Result<Self, CriterionError> {
        if let Ok(whole) = text.parse::<i128>() {
            return Ok(whole.into());
        }
        match text.parse::<f64>() {
            Ok(real) if !real.is_nan() => Ok(real.into()),
            _ => Err(CriterionError::Number(text.into())),
        }
    }
}

/// Which values are inside the solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Criterion {
    /// `value >= T`.
    AtLeast(Number),
    /// `value < T`.
    Below(Number),
    /// `A <= value <= B`.
    Between(Number, Number),
    /// `value == N`: a label.
    Label(Number),
}

impl Criterion {
    /// Reads `A..B`, both ends included.
    ///
    /// # Errors
    /// If it is not two numbers in ascending order.
    pub fn range(text: &str) -> Result<Self, CriterionError> {
        let error = || CriterionError::Range(text.into());
        let (a, b) = text.split_once("..").ok_or_else(error)?;
        let (a, b): (Number, Number) = (
            a.trim().parse().map_err(|_| error())?,
            b.trim().parse().map_err(|_| error())?,
        );
        let descending = match (a.whole, b.whole) {
            (Some(a), Some(b)) => a > b,
            _ => a.real > b.real,
        };
        if descending {
            return Err(error());
        }
        Ok(Criterion::Between(a, b))
    }

    fn holds(&self, value: f64) -> bool {
        match self {
            Criterion::AtLeast(t) => value >= t.real,
            Criterion::Below(t) => value < t.real,
            Criterion::Between(a, b) => value >= a.real && value <= b.real,
            Criterion::Label(n) => value == n.real,
        }
    }

    /// The whole numbers inside, as a closed interval; empty if the first exceeds the second.
    fn whole(&self) -> (i128, i128) {
        match self {
            Criterion::AtLeast(t) => (t.ceil(), i128::MAX),
            Criterion::Below(t) => (i128::MIN, t.ceil().saturating_sub(1)),
            Criterion::Between(a, b) => (a.ceil(), b.floor()),
            Criterion::Label(n) => (n.ceil(), n.floor()),
        }
    }
}

impl fmt::Display for Criterion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Criterion::AtLeast(t) => write!(f, "value >= {t}"),
            Criterion::Below(t) => write!(f, "value < {t}"),
            Criterion::Between(a, b) => write!(f, "{a} <= value <= {b}"),
            Criterion::Label(n) => write!(f, "value == {n}"),
        }
    }
}

/// A criterion made ready for voxels as they are stored.
#[derive(Clone, Debug)]
pub struct Binarizer {
    criterion: Criterion,
    voxel: VoxelType,
    big_endian: bool,
    scaling: Option<Scaling>,
    /// Stored integers that are inside.
    stored: (i128, i128),
}

/// Smallest and largest stored value of an integer type.
fn limits(voxel: VoxelType) -> (i128, i128) {
    match voxel {
        VoxelType::Bool | VoxelType::U8 => (0, 255),
        VoxelType::I8 => (-128, 127),
        VoxelType::U16 => (0, i128::from(u16::MAX)),
        VoxelType::I16 => (i128::from(i16::MIN), i128::from(i16::MAX)),
        VoxelType::U32 => (0, i128::from(u32::MAX)),
        VoxelType::I32 => (i128::from(i32::MIN), i128::from(i32::MAX)),
        VoxelType::U64 => (0, i128::from(u64::MAX)),
        VoxelType::I64 => (i128::from(i64::MIN), i128::from(i64::MAX)),
        VoxelType::F16 | VoxelType::F32 | VoxelType::F64 => (0, -1),
    }
}

/// First integer in `lo..=hi` for which a predicate that turns from false to true is true.
fn first_true(lo: i128, hi: i128, predicate: impl Fn(i128) -> bool) -> i128 {
    let (mut lo, mut hi) = (lo, hi + 1);
    while lo < hi {
        let middle = lo + (hi - lo) / 2;
        if predicate(middle) {
            hi = middle
        } else {
            lo = middle + 1
        }
    }
    lo
}

impl Binarizer {
    /// Prepares a criterion for a stored type.
    #[must_use]
    pub fn new(
        criterion: Criterion,
        voxel: VoxelType,
        byte_order: ByteOrder,
        scaling: Option<Scaling>,
    ) -> Self {
        let (least, most) = limits(voxel);
        let stored = if voxel.is_float() {
            (0, -1)
        } else if let Some(scaling) = scaling {
            // The values inside are an interval and scaling is monotone, so the stored values
            // inside are one too: search where it begins and ends, upwards in value.
            let up = if scaling.slope > 0.0 { 1 } else { -1 };
            let (from, to) = if up > 0 {
                (least, most)
            } else {
                (-most, -least)
            };
            let value = |v: i128| scaling.slope * (up * v) as f64 + scaling.intercept;
            let (first, past) = match criterion {
                Criterion::AtLeast(t) => (first_true(from, to, |v| value(v) >= t.real), to + 1),
                Criterion::Below(t) => (from, first_true(from, to, |v| value(v) >= t.real)),
                Criterion::Between(a, b) => (
                    first_true(from, to, |v| value(v) >= a.real),
                    first_true(from, to, |v| value(v) > b.real),
                ),
                Criterion::Label(n) => (
                    first_true(from, to, |v| value(v) >= n.real),
                    first_true(from, to, |v| value(v) > n.real),
                ),
            };
            if up > 0 {
                (first, past - 1)
            } else {
                (1 - past, -first)
            }
        } else {
            let (a, b) = criterion.whole();
            (a.max(least), b.min(most))
        };
        Self {
            criterion,
            voxel,
            big_endian: byte_order == ByteOrder::Big,
            scaling,
            stored,
        }
    }

    /// Packs a row of stored voxels into `out`, bit 0 of word 0 first, and gives the number of
    /// NaNs met. `out` must have a word for every 64 voxels, rounded up.
    pub fn pack_row(&self, row: &[u8], out: &mut [u64]) -> u64 {
        dispatch(PackRow {
            binarizer: self,
            row,
            out,
        })
    }

    /// The `f32` that are inside, as a closed interval; empty if the first exceeds the second.
    fn stored_f32(&self) -> (f32, f32) {
        // The smallest that is not below, and the largest that is not above.
        let ceil = |x: f64| {
            let nearest = x as f32;
            if f64::from(nearest) < x {
                nearest.next_up()
            } else {
                nearest
            }
        };
        let floor = |x: f64| {
            let nearest = x as f32;
            if f64::from(nearest) > x {
                nearest.next_down()
            } else {
                nearest
            }
        };
        match self.criterion {
            Criterion::AtLeast(t) => (ceil(t.real), f32::INFINITY),
            // Nothing is below the lowest.
            Criterion::Below(t) if t.real == f64::NEG_INFINITY => (0.0, f32::NEG_INFINITY),
            Criterion::Below(t) => (f32::NEG_INFINITY, ceil(t.real).next_down()),
            Criterion::Between(a, b) => (ceil(a.real), floor(b.real)),
            Criterion::Label(n) => (ceil(n.real), floor(n.real)),
        }
    }
}

/// A row to be packed.
struct PackRow<'a> {
    binarizer: &'a Binarizer,
    row: &'a [u8],
    out: &'a mut [u64],
}

impl Work for PackRow<'_> {
    type Output = u64;

    #[inline(always)]
    fn run<L: Level>(self) -> u64 {
        let Self {
            binarizer,
            row,
            out,
        } = self;
        macro_rules! integer {
            ($type:ty, $distance:ty) => {{
                let (lo, hi) = binarizer.stored;
                if lo > hi {
                    out.fill(0);
                    return 0;
                }
                // within the limits of the type by construction
                let (lo, hi) = (lo as $type, hi as $type);
                let width = hi.wrapping_sub(lo) as $distance;
                const BYTES: usize = size_of::<$type>();
                // one comparison instead of two: what is below `lo` wraps to far above
                let inside = |v: $type| v.wrapping_sub(lo) as $distance <= width;
                if binarizer.big_endian && BYTES > 1 {
                    pack::<BYTES>(row, out, |b| inside(<$type>::from_be_bytes(b)), |_| false)
                } else {
                    pack::<BYTES>(row, out, |b| inside(<$type>::from_le_bytes(b)), |_| false)
                }
            }};
        }
        macro_rules! float {
            ($type:ty, $to_f64:expr) => {{
                const BYTES: usize = size_of::<$type>();
                if binarizer.big_endian {
                    let value = |b: [u8; BYTES]| -> f64 { $to_f64(<$type>::from_be_bytes(b)) };
                    pack_floats(binarizer, row, out, value)
                } else {
                    let value = |b: [u8; BYTES]| -> f64 { $to_f64(<$type>::from_le_bytes(b)) };
                    pack_floats(binarizer, row, out, value)
                }
            }};
        }
        match binarizer.voxel {
            VoxelType::Bool | VoxelType::U8 => integer!(u8, u8),
            VoxelType::I8 => integer!(i8, u8),
            VoxelType::U16 => integer!(u16, u16),
            VoxelType::I16 => integer!(i16, u16),
            VoxelType::U32 => integer!(u32, u32),
            VoxelType::I32 => integer!(i32, u32),
            VoxelType::U64 => integer!(u64, u64),
            VoxelType::I64 => integer!(i64, u64),
            VoxelType::F16 => float!(f16, f64::from),
            VoxelType::F32 if binarizer.scaling.is_none() => {
                // Compared as they are stored, twice as many at a time.
                let (lo, hi) = binarizer.stored_f32();
                let inside = |v: f32| (v >= lo) & (v <= hi);
                if binarizer.big_endian {
                    let value = |b: [u8; 4]| f32::from_be_bytes(b);
                    pack::<4>(row, out, |b| inside(value(b)), |b| value(b).is_nan())
                } else {
                    let value = |b: [u8; 4]| f32::from_le_bytes(b);
                    pack::<4>(row, out, |b| inside(value(b)), |b| value(b).is_nan())
                }
            }
            VoxelType::F32 => float!(f32, f64::from),
            VoxelType::F64 => float!(f64, |x| x),
        }
    }
}

#[inline(always)]
fn pack_floats<const BYTES: usize>(
    binarizer: &Binarizer,
    row: &[u8],
    out: &mut [u64],
    value: impl Fn([u8; BYTES]) -> f64 + Copy,
) -> u64 {
    let is_nan = |b| value(b).is_nan();
    match (binarizer.scaling, binarizer.criterion) {
        (None, Criterion::AtLeast(t)) => {
            let t = t.real;
            pack::<BYTES>(row, out, |b| value(b) >= t, is_nan)
        }
        (None, criterion) => pack::<BYTES>(row, out, |b| criterion.holds(value(b)), is_nan),
        (Some(s), criterion) => pack::<BYTES>(
            row,
            out,
            |b| criterion.holds(s.slope * value(b) + s.intercept),
            is_nan,
        ),
    }
}

/// Voxels that are looked at together. Fewer take longer where all are alike; more are alike less often.
const LOOK: usize = 256;

/// One bit a voxel; gives how many are no number.
#[inline(always)]
fn pack<const BYTES: usize>(
    row: &[u8],
    out: &mut [u64],
    inside: impl Fn([u8; BYTES]) -> bool,
    is_nan: impl Fn([u8; BYTES]) -> bool,
) -> u64 {
    let voxels = row.as_chunks::<BYTES>().0;
    let mut nan = 0;
    for (chunk, words) in voxels.chunks(LOOK).zip(out.chunks_mut(LOOK / 64)) {
        // Voxels that are all alike are by far the most, and are told faster than packed.
        let (mut all, mut any, mut of_chunk) = (true, false, 0u32);
        for &voxel in chunk {
            let inside = inside(voxel);
            all &= inside;
            any |= inside;
            of_chunk += u32::from(is_nan(voxel));
        }
        nan += u64::from(of_chunk);
        if !any {
            words.fill(0);
            continue;
        }
        let (whole, rest) = chunk.as_chunks::<64>();
        if all && rest.is_empty() {
            words.fill(!0);
            continue;
        }
        for (chunk, word) in whole.iter().zip(&mut *words) {
            *word = packed(chunk, &inside);
        }
        if let Some(word) = words.get_mut(whole.len())
            && !rest.is_empty()
        {
            let mut last = [[0; BYTES]; 64];
            last[..rest.len()].copy_from_slice(rest);
            *word = packed(&last, &inside) & ((1 << rest.len()) - 1);
        }
    }
    nan
}

/// The word of 64 voxels.
#[inline(always)]
fn packed<const BYTES: usize>(
    chunk: &[[u8; BYTES]; 64],
    inside: &impl Fn([u8; BYTES]) -> bool,
) -> u64 {
    // Flags first, so that the comparisons are vectorised.
    let mut flags = [0u8; 64];
    for (flag, &voxel) in flags.iter_mut().zip(chunk) {
        *flag = u8::from(inside(voxel));
    }
    // Eight flags at a time are gathered by a multiplication that moves bit 0 of byte i to bit 56 + i.
    let mut word = 0;
    for (i, eight) in flags.as_chunks::<8>().0.iter().enumerate() {
        let bits = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        word |= bits << (8 * i);
    }
    word
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(binarizer: &Binarizer, row: &[u8], count: usize) -> (Vec<bool>, u64) {
        let mut out = vec![0; count.div_ceil(64)];
        let nan = binarizer.pack_row(row, &mut out);
        (
            (0..count)
                .map(|i| out[i / 64] >> (i % 64) & 1 == 1)
                .collect(),
            nan,
        )
    }

    #[test]
    fn every_byte_is_told_apart() {
        let row: Vec<u8> = (0..=255).chain(0..77).collect();
        for threshold in [0u8, 1, 100, 128, 255] {
            let criterion = Criterion::AtLeast(i128::from(threshold).into());
            let b = Binarizer::new(criterion, VoxelType::U8, ByteOrder::Little, None);
            let expected: Vec<bool> = row.iter().map(|&v| v >= threshold).collect();
            assert_eq!(bits(&b, &row, row.len()), (expected, 0));
        }
    }

    #[test]
    fn large_integers_do_not_pass_through_floats() {
        let threshold = (1u64 << 63) + 3;
        let values = [threshold - 1, threshold, threshold + 1, 0, u64::MAX];
        let row: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
        let criterion = Criterion::AtLeast(threshold.to_string().parse().unwrap());
        let b = Binarizer::new(criterion, VoxelType::U64, ByteOrder::Big, None);
        assert_eq!(bits(&b, &row, 5).0, [false, true, true, false, true]);
    }

    #[test]
    fn nan_is_outside_and_counted() {
        let values = [1.0f32, f32::NAN, -1.0, f32::INFINITY, 0.0, -0.0, 1e-45];
        let row: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let inside = |c| {
            bits(
                &Binarizer::new(c, VoxelType::F32, ByteOrder::Little, None),
                &row,
                7,
            )
        };
        assert_eq!(
            inside(Criterion::AtLeast("1e-45".parse().unwrap())),
            (vec![true, false, false, true, false, false, true], 1)
        );
        assert_eq!(
            inside(Criterion::Below(0.0.into())),
            (vec![false, false, true, false, false, false, false], 1)
        );
    }

    #[test]
    fn every_type_is_packed_as_its_values_say() {
        // Rows of more than one look, alike for long, with a tail; values around every threshold.
        let thresholds = [
            0.0,
            -0.0,
            1.0,
            1.5,
            -3.25,
            100.0,
            0.1,
            1e-46,
            1e300,
            -1e300,
            f64::INFINITY,
            f64::NEG_INFINITY,
            16_777_217.0,
        ];
        let mut values = Vec::new();
        for t in thresholds {
            let near = t as f32;
            values.extend([near, near.next_up(), near.next_down(), f32::NAN]);
            values.extend([t as f32; 130]);
        }
        let criteria = thresholds.iter().flat_map(|&t| {
            [
                Criterion::AtLeast(t.into()),
                Criterion::Below(t.into()),
                Criterion::Between(t.into(), (t + 0.5).into()),
                Criterion::Label(t.into()),
            ]
        });
        for criterion in criteria {
            for order in [ByteOrder::Little, ByteOrder::Big] {
                let b = Binarizer::new(criterion, VoxelType::F32, order, None);
                let bytes = |v: &f32| match order {
                    ByteOrder::Little => v.to_le_bytes(),
                    ByteOrder::Big => v.to_be_bytes(),
                };
                let row: Vec<u8> = values.iter().flat_map(bytes).collect();
                let expected: Vec<bool> =
                    values.iter().map(|&v| criterion.holds(v.into())).collect();
                let nan = values.iter().filter(|v| v.is_nan()).count() as u64;
                assert_eq!(bits(&b, &row, values.len()), (expected, nan), "{criterion}");
                let b = Binarizer::new(criterion, VoxelType::I16, order, None);
                let whole: Vec<i16> = values.iter().map(|&v| v as i16).collect();
                let bytes = |v: &i16| match order {
                    ByteOrder::Little => v.to_le_bytes(),
                    ByteOrder::Big => v.to_be_bytes(),
                };
                let row: Vec<u8> = whole.iter().flat_map(bytes).collect();
                let expected: Vec<bool> =
                    whole.iter().map(|&v| criterion.holds(v.into())).collect();
                assert_eq!(bits(&b, &row, whole.len()), (expected, 0), "{criterion}");
            }
        }
    }

    #[test]
    fn scaled_integers_agree_with_scaled_values() {
        for (slope, intercept) in [(2.0, -1024.0), (-0.5, 3.0), (0.1, 0.05)] {
            let scaling = Scaling { slope, intercept };
            let row: Vec<u8> = (0..=255).collect();
            for criterion in [
                Criterion::AtLeast(2.05.into()),
                Criterion::Below(2.05.into()),
                Criterion::Between((-1000.0).into(), 2.0.into()),
                Criterion::Label(1.0.into()),
            ] {
                let b = Binarizer::new(criterion, VoxelType::U8, ByteOrder::Little, Some(scaling));
                let expected: Vec<bool> = row
                    .iter()
                    .map(|&v| criterion.holds(slope * f64::from(v) + intercept))
                    .collect();
                assert_eq!(bits(&b, &row, 256).0, expected, "{criterion} {slope}");
            }
        }
    }

    #[test]
    fn ranges_and_numbers_are_read() {
        assert_eq!(
            Criterion::range("1..2.5").unwrap(),
            Criterion::Between(1i128.into(), 2.5.into())
        );
        for bad in [
            "",
            "1",
            "2..1",
            "a..b",
            "1..nan",
            "9007199254740993..9007199254740992",
        ] {
            assert!(Criterion::range(bad).is_err(), "{bad}");
        }
        assert!("nan".parse::<Number>().is_err());
        assert_eq!(Criterion::Label(1.5.into()).whole(), (2, 1));
    }
}
