//! The bytes of an HDF5 file by address, and the fields of its structures.
//!
//! In: bytes and the superblock. Out: pieces of the file at addresses counted from the
//! superblock, and [`Fields`], which takes them apart. Guaranteed: a piece is checked against the
//! length of the file before it is read; a field beyond the end of its structure is an error with
//! its place; reading the description of the file ends, for what is read while opening is counted
//! and limited.

use std::borrow::Cow;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::bytes::FileBytes;
use crate::error::Error;

/// What every HDF5 file has at byte 0, 512, 1024 and so on, doubling.
const SIGNATURE: &[u8; 8] = b"\x89HDF\r\n\x1a\n";

/// A file and what its superblock says.
pub(super) struct File {
    bytes: FileBytes,
    /// Where the superblock is, and addresses begin.
    base: u64,
    /// Bytes of an address and of a length.
    offset_bytes: usize,
    length_bytes: usize,
    /// Bytes that were read to find out what the file holds.
    described: AtomicU64,
}

impl File {
    /// The file, and the address of its root group.
    pub(super) fn open(bytes: FileBytes) -> Result<(Self, u64), Error> {
        let mut base = 0_u64;
        loop {
            let here = bytes.len().checked_sub(base).is_some_and(|n| n >= 8)
                && *bytes.read(base, 8)? == *SIGNATURE;
            if here {
                break;
            }
            base = if base == 0 {
                512
            } else {
                base.saturating_mul(2)
            };
            if base >= bytes.len() {
                return Err(Error::invalid(
                    bytes.name(),
                    "no HDF5 signature at byte 0, 512, 1024 and so on",
                ));
            }
        }
        let mut file = Self {
            bytes,
            base,
            offset_bytes: 8,
            length_bytes: 8,
            described: AtomicU64::new(0),
        };
        let root = file.superblock()?;
        Ok((file, root))
    }

    /// Reads the superblock; the address of the root group.
    fn superblock(&mut self) -> Result<u64, Error> {
        // The longest has 8 + 16 + 4 * 8 + 8 + 40 bytes.
        let most = (self.bytes.len() - self.base).min(112);
        let block = self.read(0, most)?.into_owned();
        let mut fields = self.fields(0, &block);
        fields.skip(8)?;
        let version = fields.u8()?;
        if version > 3 {
            return Err(fields.unsupported(format!("superblock version {version}")));
        }
        if version < 2 {
            fields.skip(4)?;
        }
        let sizes = [fields.u8()?, fields.u8()?];
        for size in sizes {
            if ![2, 4, 8].contains(&size) {
                return Err(fields.invalid(format!(
                    "addresses or lengths of {size} bytes; 2, 4 or 8 expected"
                )));
            }
        }
        let at = fields.at;
        self.offset_bytes = sizes[0].into();
        self.length_bytes = sizes[1].into();
        let mut fields = self.fields(0, &block);
        fields.skip(at)?;
        // Flags; before them, in old versions, numbers that each B-tree node repeats.
        fields.skip(match version {
            0 => 9,
            1 => 13,
            _ => 1,
        })?;
        // The base address is not used: the place of the superblock counts, as for libhdf5.
        fields.offset()?;
        fields.offset()?;
        let end = fields.offset()?;
        let root = if version < 2 {
            fields.offset()?;
            fields.offset()?;
            fields.offset()?
        } else {
            let root = fields.offset()?;
            fields.checksum("superblock")?;
            root
        };
        if let Some(end) = end
            && end > self.bytes.len()
        {
            return Err(Error::invalid(
                self.name(),
                format!(
                    "the file ends early: its superblock says {end} bytes, it has {}",
                    self.bytes.len()
                ),
            )
            .at(self.bytes.len()));
        }
        root.ok_or_else(|| Error::invalid(self.name(), "the file has no root group").at(self.base))
    }

    pub(super) fn name(&self) -> &str {
        self.bytes.name()
    }

    pub(super) fn bytes(&self) -> &FileBytes {
        &self.bytes
    }

    pub(super) fn offset_bytes(&self) -> usize {
        self.offset_bytes
    }

    pub(super) fn length_bytes(&self) -> usize {
        self.length_bytes
    }

    /// Place in the file of an address.
    pub(super) fn place(&self, address: u64) -> u64 {
        self.base.saturating_add(address)
    }

    /// `count` bytes at `address`.
    pub(super) fn read(&self, address: u64, count: u64) -> Result<Cow<'_, [u8]>, Error> {
        self.bytes.read(self.place(address), count)
    }

    /// `count` bytes at `address` that describe the file. Structures that refer to each other in
    /// circles, or over and over, end here.
    pub(super) fn describe(&self, address: u64, count: u64) -> Result<Cow<'_, [u8]>, Error> {
        /// A group is read again for each path through it.
        const TIMES: u64 = 4;
        const SLACK_BYTES: u64 = 64 << 20;
        let before = self.described.fetch_add(count, Ordering::Relaxed);
        let most = self
            .bytes
            .len()
            .saturating_mul(TIMES)
            .saturating_add(SLACK_BYTES);
        if before.saturating_add(count) > most {
            return Err(Error::invalid(
                self.name(),
                "the structures of the file refer to each other over and over",
            )
            .at(self.place(address)));
        }
        self.read(address, count)
    }

    /// The fields of a structure whose `bytes` are at `address`.
    pub(super) fn fields<'a>(&'a self, address: u64, bytes: &'a [u8]) -> Fields<'a> {
        Fields {
            file: self,
            bytes,
            at: 0,
            start: self.place(address),
        }
    }
}

/// A structure of little-endian fields, taken from the front.
#[derive(Clone)]
pub(super) struct Fields<'a> {
    file: &'a File,
    bytes: &'a [u8],
    at: usize,
    /// Place in the file of the first of `bytes`.
    start: u64,
}

impl<'a> Fields<'a> {
    /// An error about the bytes last taken.
    pub(super) fn invalid(&self, message: impl Into<String>) -> Error {
        Error::invalid(self.file.name(), message).at(self.position())
    }

    /// The same for what this reader does not know.
    pub(super) fn unsupported(&self, what: impl std::fmt::Display) -> Error {
        Error::unsupported(self.file.name(), format!("{what} is not read here")).at(self.position())
    }

    /// Place in the file of the next field.
    pub(super) fn position(&self) -> u64 {
        self.start.saturating_add(self.at as u64)
    }

    /// Bytes not yet taken.
    pub(super) fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], Error> {
        let taken = self
            .bytes
            .get(self.at..)
            .and_then(|rest| rest.get(..count))
            .ok_or_else(|| {
                self.invalid(format!(
                    "a structure ends early: {count} bytes expected, {} left",
                    self.left()
                ))
            })?;
        self.at += count;
        Ok(taken)
    }

    pub(super) fn skip(&mut self, count: usize) -> Result<(), Error> {
        self.take(count).map(|_| ())
    }

    /// A number of `width` bytes, at most 8.
    pub(super) fn uint(&mut self, width: usize) -> Result<u64, Error> {
        let bytes = self.take(width)?;
        Ok(bytes
            .iter()
            .rev()
            .fold(0, |value, byte| value << 8 | u64::from(*byte)))
    }

    pub(super) fn u8(&mut self) -> Result<u8, Error> {
        Ok(self.uint(1)? as u8)
    }

    pub(super) fn u16(&mut self) -> Result<u16, Error> {
        Ok(self.uint(2)? as u16)
    }

    pub(super) fn u32(&mut self) -> Result<u32, Error> {
        Ok(self.uint(4)? as u32)
    }

    pub(super) fn length(&mut self) -> Result<u64, Error> {
        self.uint(self.file.length_bytes)
    }

    /// A length that may have no limit, which is all bits set.
    pub(super) fn limit(&mut self) -> Result<Option<u64>, Error> {
        let width = self.file.length_bytes;
        self.unless_all_ones(width)
    }

    fn unless_all_ones(&mut self, width: usize) -> Result<Option<u64>, Error> {
        let value = self.uint(width)?;
        Ok((value != u64::MAX >> (64 - 8 * width as u32)).then_some(value))
    }

    /// An address; `None` where there is none, which is all bits set.
    pub(super) fn offset(&mut self) -> Result<Option<u64>, Error> {
        let width = self.file.offset_bytes;
        self.unless_all_ones(width)
    }

    /// An address that must be there.
    pub(super) fn address(&mut self, what: &str) -> Result<u64, Error> {
        let missing = self.invalid(format!("the address of {what} is missing"));
        self.offset()?.ok_or(missing)
    }

    /// The four letters that a structure begins with.
    pub(super) fn magic(&mut self, expected: &[u8; 4]) -> Result<(), Error> {
        let before = self.clone();
        let found = self.take(4)?;
        if found == expected {
            return Ok(());
        }
        Err(before.invalid(format!(
            "'{}' found, '{}' expected",
            found.escape_ascii(),
            expected.escape_ascii()
        )))
    }

    /// A version, which must be `expected`.
    pub(super) fn version(&mut self, what: &str, expected: u8) -> Result<(), Error> {
        let before = self.clone();
        let found = self.u8()?;
        if found == expected {
            return Ok(());
        }
        Err(before.unsupported(format!("version {found} of {what}")))
    }

    /// The checksum of all fields before it.
    pub(super) fn checksum(&mut self, what: &str) -> Result<(), Error> {
        let before = self.clone();
        let stored = self.u32()?;
        let found = checksum(&self.bytes[..before.at]);
        if stored == found {
            return Ok(());
        }
        Err(before.invalid(format!(
            "the checksum of the {what} is {found:08x}, {stored:08x} is stored: it is damaged"
        )))
    }
}

/// Bob Jenkins' `lookup3` hash with initial value 0, which HDF5 uses as a checksum.
pub(super) fn checksum(bytes: &[u8]) -> u32 {
    let seed = 0xdead_beef_u32.wrapping_add(bytes.len() as u32);
    let [mut a, mut b, mut c] = [seed; 3];
    // Bytes beyond the end count as zero.
    let words = |block: &[u8; 12]| {
        let (words, _) = block.as_chunks::<4>();
        [words[0], words[1], words[2]].map(u32::from_le_bytes)
    };
    let mut rest = bytes;
    while let Some((block, tail)) = rest.split_first_chunk::<12>()
        && !tail.is_empty()
    {
        let [x, y, z] = words(block);
        a = a.wrapping_add(x);
        b = b.wrapping_add(y);
        c = c.wrapping_add(z);
        for (shift, which) in [(4, 0), (6, 1), (8, 2), (16, 0), (19, 1), (4, 2)] {
            // The roles of the three rotate.
            let (x, y, z) = match which {
                0 => (&mut a, &mut c, b),
                1 => (&mut b, &mut a, c),
                _ => (&mut c, &mut b, a),
            };
            *x = x.wrapping_sub(*y) ^ y.rotate_left(shift);
            *y = y.wrapping_add(z);
        }
        rest = tail;
    }
    if rest.is_empty() {
        return c;
    }
    let mut last = [0; 12];
    last[..rest.len()].copy_from_slice(rest);
    let [x, y, z] = words(&last);
    a = a.wrapping_add(x);
    b = b.wrapping_add(y);
    c = c.wrapping_add(z);
    c = (c ^ b).wrapping_sub(b.rotate_left(14));
    a = (a ^ c).wrapping_sub(c.rotate_left(11));
    b = (b ^ a).wrapping_sub(a.rotate_left(25));
    c = (c ^ b).wrapping_sub(b.rotate_left(16));
    a = (a ^ c).wrapping_sub(c.rotate_left(4));
    b = (b ^ a).wrapping_sub(a.rotate_left(14));
    (c ^ b).wrapping_sub(b.rotate_left(24))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_lookup3() {
        // The values its author gives.
        assert_eq!(checksum(b""), 0xdead_beef);
        assert_eq!(checksum(b"Four score and seven years ago"), 0x1777_0551);
    }
}
