//! A place in the file that moves forward, every step checked.
//!
//! In: the bytes of the file. Out: the next few of them. Guaranteed: a count that reaches beyond
//! the end of the file is an error that names what was being read, before anything is allocated.
//! Bytes are fetched by windows, so that many small reads of a file that is not mapped cost few
//! calls of the system.

use std::borrow::Cow;

use crate::bytes::FileBytes;
use crate::error::Error;

/// Bytes fetched at once. Smaller windows cost more calls, larger ones are thrown away unread
/// where a grid is skipped.
const WINDOW_BYTES: u64 = 256 << 10;

/// Reads forward from an offset.
pub(super) struct Cursor<'a> {
    file: &'a FileBytes,
    window: Cow<'a, [u8]>,
    /// Offset in the file of the first byte of the window.
    start: u64,
    /// Bytes of the window that are read.
    used: usize,
}

impl<'a> Cursor<'a> {
    /// A cursor at `offset`.
    pub(super) fn new(file: &'a FileBytes, offset: u64) -> Self {
        Self {
            file,
            window: Cow::Borrowed(&[]),
            start: offset,
            used: 0,
        }
    }

    /// A cursor at the first of `count` bytes that will be read and are fetched at once.
    pub(super) fn over(file: &'a FileBytes, offset: u64, count: u64) -> Result<Self, Error> {
        Ok(Self {
            file,
            window: file.read(offset, count)?,
            start: offset,
            used: 0,
        })
    }

    /// Offset of the next byte.
    pub(super) fn offset(&self) -> u64 {
        self.start.saturating_add(self.used as u64)
    }

    /// Bytes of the file from here on.
    pub(super) fn remaining(&self) -> u64 {
        self.file.len().saturating_sub(self.offset())
    }

    /// Length of the file.
    pub(super) fn file_bytes(&self) -> u64 {
        self.file.len()
    }

    /// An error about the contents at `offset`.
    pub(super) fn invalid(&self, offset: u64, message: impl Into<String>) -> Error {
        Error::invalid(self.file.name(), message).at(offset)
    }

    /// Something at the current place that is not read.
    pub(super) fn unsupported(&self, message: impl Into<String>) -> Error {
        Error::unsupported(self.file.name(), message).at(self.offset())
    }

    /// Checks that `count` more bytes are there.
    pub(super) fn expect(&self, count: u64, what: &str) -> Result<(), Error> {
        let found = self.remaining();
        if count > found {
            return Err(self.invalid(
                self.offset(),
                format!("the file ends in {what}: {found} bytes found, {count} expected"),
            ));
        }
        Ok(())
    }

    /// The next `count` bytes; `what` says what they are part of.
    pub(super) fn take(&mut self, count: usize, what: &str) -> Result<&[u8], Error> {
        if self.window.len() - self.used < count {
            self.expect(count as u64, what)?;
            let offset = self.offset();
            let bytes = WINDOW_BYTES.max(count as u64).min(self.remaining());
            self.window = self.file.read(offset, bytes)?;
            self.start = offset;
            self.used = 0;
        }
        let from = self.used;
        self.used += count;
        Ok(self.window.get(from..from + count).unwrap_or_default())
    }

    /// The next `N` bytes.
    pub(super) fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], Error> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N, what)?);
        Ok(array)
    }

    pub(super) fn u8(&mut self, what: &str) -> Result<u8, Error> {
        Ok(self.array::<1>(what)?[0])
    }

    pub(super) fn u32(&mut self, what: &str) -> Result<u32, Error> {
        self.array(what).map(u32::from_le_bytes)
    }

    pub(super) fn i32(&mut self, what: &str) -> Result<i32, Error> {
        self.array(what).map(i32::from_le_bytes)
    }

    pub(super) fn i64(&mut self, what: &str) -> Result<i64, Error> {
        self.array(what).map(i64::from_le_bytes)
    }

    pub(super) fn f64(&mut self, what: &str) -> Result<f64, Error> {
        self.array(what).map(f64::from_le_bytes)
    }

    /// Leaves out `count` bytes, which must be there.
    pub(super) fn skip(&mut self, count: u64, what: &str) -> Result<(), Error> {
        self.expect(count, what)?;
        match usize::try_from(count) {
            Ok(count) if count <= self.window.len() - self.used => self.used += count,
            _ => {
                self.start = self.offset() + count;
                self.window = Cow::Borrowed(&[]);
                self.used = 0;
            }
        }
        Ok(())
    }

    /// A length and that many bytes. Names of the format are ASCII in practice; what is not
    /// text, and control characters, are shown as a question mark or a replacement character.
    pub(super) fn string(&mut self, what: &str) -> Result<String, Error> {
        /// A longer name is a sign of damage, not a name.
        const MOST_BYTES: u32 = 1 << 16;
        let at = self.offset();
        let length = self.u32(what)?;
        self.expect(u64::from(length), what)?;
        if length > MOST_BYTES {
            return Err(self.invalid(
                at,
                format!("{what} has {length} bytes, at most {MOST_BYTES} expected"),
            ));
        }
        let bytes = self.take(length as usize, what)?;
        Ok(String::from_utf8_lossy(bytes).into_owned())
    }

    /// A mask of as many bits as `words` holds.
    pub(super) fn mask(&mut self, words: &mut [u64], what: &str) -> Result<(), Error> {
        let bytes = self.take(words.len() * 8, what)?;
        for (word, bytes) in words.iter_mut().zip(bytes.chunks_exact(8)) {
            let mut array = [0; 8];
            array.copy_from_slice(bytes);
            *word = u64::from_le_bytes(array);
        }
        Ok(())
    }
}
