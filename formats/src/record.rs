//! Numbers at offsets of a fixed header, in either byte order.
//!
//! In: the bytes of a header, which are known to be there. Out: numbers. The offsets are those of
//! a format's own table, constants in the code that asks, never numbers out of a file.

use crate::header::ByteOrder;

/// Reads numbers at offsets of a header that is known to be long enough.
#[derive(Clone, Copy)]
pub(crate) struct Record<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) order: ByteOrder,
}

impl Record<'_> {
    pub(crate) fn array<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut array = [0; N];
        array.copy_from_slice(&self.bytes[at..at + N]);
        if self.order == ByteOrder::Big {
            array.reverse();
        }
        array
    }

    pub(crate) fn i16(&self, at: usize) -> i16 {
        i16::from_le_bytes(self.array(at))
    }

    pub(crate) fn i32(&self, at: usize) -> i32 {
        i32::from_le_bytes(self.array(at))
    }

    pub(crate) fn i64(&self, at: usize) -> i64 {
        i64::from_le_bytes(self.array(at))
    }

    pub(crate) fn f32(&self, at: usize) -> f64 {
        f64::from(f32::from_le_bytes(self.array(at)))
    }

    pub(crate) fn f64(&self, at: usize) -> f64 {
        f64::from_le_bytes(self.array(at))
    }

    /// The shortest decimal number that a stored single precision number stands for.
    pub(crate) fn f32_decimal(&self, at: usize) -> f64 {
        let stored = f32::from_le_bytes(self.array(at));
        // Rust prints the shortest text that reads back as the same number.
        stored.to_string().parse().unwrap_or(f64::from(stored))
    }
}
