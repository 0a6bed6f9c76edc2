//! The codecs of encapsulated pixel data.
//!
//! In: the bytes of one frame and the extents that the data set promises. Out: samples of at
//! most 16 bits, row after row, or the bytes of the samples (RLE). Guaranteed: never more output
//! than promised, an image of other extents is an error, and damaged data is an error or wrong
//! samples, not a panic; memory is bounded by a small multiple of frame and input.

pub(super) mod dct;

pub(super) mod jpeg;

#[cfg(feature = "jpeg2000")]
pub(super) mod jpeg2000;

pub(super) mod jpegls;

pub(super) mod rle;

/// What is wrong with compressed data.
pub(super) type CodecResult<T> = Result<T, String>;

/// Columns and rows that a frame must have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extents {
    pub(super) columns: usize,
    pub(super) rows: usize,
}

impl Extents {
    /// Samples of one frame. The caller has checked that the product fits.
    pub(super) fn samples(self) -> usize {
        self.columns * self.rows
    }

    /// An error if the compressed image has other extents.
    pub(super) fn check(self, columns: usize, rows: usize) -> CodecResult<()> {
        if (columns, rows) == (self.columns, self.rows) {
            return Ok(());
        }
        Err(format!(
            "the compressed image has {columns} x {rows} samples, {} x {} expected",
            self.columns, self.rows
        ))
    }
}

/// What the data ends with where more is needed.
pub(super) fn ends_early(found: usize, expected: usize) -> String {
    format!("the compressed data ends early: {found} samples of {expected}")
}

/// A zeroed or empty buffer for `count` samples, or an error instead of an abort.
pub(super) fn reserve(out: &mut Vec<u16>, count: usize) -> CodecResult<()> {
    out.clear();
    out.try_reserve_exact(count)
        .map_err(|_| "the frame does not fit memory".to_string())
}
