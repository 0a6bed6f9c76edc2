//! The skeleton of a TIFF file: its header, its directories, and the values of their entries.
//!
//! In: the bytes of a file. Out: [`Tiff`], and of each directory an [`Ifd`], the entries as they
//! are. Values are read only when asked for, and checked against the length of the file before.
//! Guaranteed: a chain of directories ends, as none is visited twice and all of them together
//! are not longer than the file.

use std::borrow::Cow;
use std::collections::HashSet;

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::ByteOrder;

/// Numbers of the entries that are read, as in TIFF 6.0 and its supplements.
pub(super) mod tag {
    pub(crate) const NEW_SUBFILE_TYPE: u16 = 254;
    pub(crate) const SUBFILE_TYPE: u16 = 255;
    pub(crate) const WIDTH: u16 = 256;
    pub(crate) const LENGTH: u16 = 257;
    pub(crate) const BITS_PER_SAMPLE: u16 = 258;
    pub(crate) const COMPRESSION: u16 = 259;
    pub(crate) const PHOTOMETRIC: u16 = 262;
    pub(crate) const FILL_ORDER: u16 = 266;
    pub(crate) const DESCRIPTION: u16 = 270;
    pub(crate) const STRIP_OFFSETS: u16 = 273;
    pub(crate) const SAMPLES_PER_PIXEL: u16 = 277;
    pub(crate) const ROWS_PER_STRIP: u16 = 278;
    pub(crate) const STRIP_BYTE_COUNTS: u16 = 279;
    pub(crate) const X_RESOLUTION: u16 = 282;
    pub(crate) const Y_RESOLUTION: u16 = 283;
    pub(crate) const PLANAR_CONFIGURATION: u16 = 284;
    pub(crate) const T4_OPTIONS: u16 = 292;
    pub(crate) const T6_OPTIONS: u16 = 293;
    pub(crate) const RESOLUTION_UNIT: u16 = 296;
    pub(crate) const PREDICTOR: u16 = 317;
    pub(crate) const TILE_WIDTH: u16 = 322;
    pub(crate) const TILE_LENGTH: u16 = 323;
    pub(crate) const TILE_OFFSETS: u16 = 324;
    pub(crate) const TILE_BYTE_COUNTS: u16 = 325;
    pub(crate) const SUB_IFDS: u16 = 330;
    pub(crate) const SAMPLE_FORMAT: u16 = 339;
    pub(crate) const JPEG_TABLES: u16 = 347;
    pub(crate) const UIC2: u16 = 33629;
    pub(crate) const LSM_INFO: u16 = 34412;
    pub(crate) const NDPI_FORMAT: u16 = 65420;
}

/// The bytes every TIFF file begins with, classic and big, in both byte orders.
const MAGIC: [&[u8; 4]; 4] = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];

/// Whether content begins like a TIFF file. The preamble of a DICOM file may do so as well.
pub(crate) fn detect(head: &[u8]) -> bool {
    MAGIC.iter().any(|magic| head.starts_with(*magic))
        && head.get(128..132) != Some(b"DICM".as_slice())
}

/// A TIFF file.
#[derive(Clone)]
pub(super) struct Tiff {
    pub(super) bytes: FileBytes,
    pub(super) order: ByteOrder,
    /// BigTIFF: offsets of 64 bits.
    pub(super) big: bool,
    first: u64,
}

/// One entry of a directory. `at` is where its values are, in the entry itself or elsewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    pub(super) tag: u16,
    pub(super) kind: u16,
    pub(super) count: u64,
    pub(super) at: u64,
}

impl Entry {
    /// Bytes of one value; `None` for a type this crate does not know.
    pub(super) fn value_bytes(&self) -> Option<u64> {
        value_bytes(self.kind)
    }
}

fn value_bytes(kind: u16) -> Option<u64> {
    Some(match kind {
        // BYTE, ASCII, SBYTE, UNDEFINED
        1 | 2 | 6 | 7 => 1,
        // SHORT, SSHORT
        3 | 8 => 2,
        // LONG, SLONG, FLOAT, IFD
        4 | 9 | 11 | 13 => 4,
        // RATIONAL, SRATIONAL, DOUBLE, LONG8, SLONG8, IFD8
        5 | 10 | 12 | 16 | 17 | 18 => 8,
        _ => return None,
    })
}

/// A directory: the entries of one page.
#[derive(Clone, Debug)]
pub(super) struct Ifd {
    /// Where it is.
    pub(super) at: u64,
    /// Offset of the next one; 0 after the last.
    next: u64,
    entries: Vec<Entry>,
    /// Bytes it takes.
    bytes: u64,
}

impl Ifd {
    /// The entry of that number. Where there are two, the first counts.
    pub(super) fn entry(&self, tag: u16) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.tag == tag)
    }
}

impl Tiff {
    /// Reads the header of the file.
    pub(super) fn new(bytes: FileBytes) -> Result<Self, Error> {
        let head = bytes.read(0, 8)?;
        let order = match head.get(..2) {
            Some(b"II") => ByteOrder::Little,
            _ => ByteOrder::Big,
        };
        let big = number(order, &head[2..4]) == 43;
        let first = if big {
            let sizes = bytes.read(4, 4)?;
            if number(order, &sizes[..2]) != 8 || number(order, &sizes[2..]) != 0 {
                return Err(Error::invalid(
                    bytes.name(),
                    format!(
                        "the BigTIFF header says offsets of {} bytes, 8 expected",
                        number(order, &sizes[..2])
                    ),
                )
                .at(4));
            }
            number(order, &bytes.read(8, 8)?)
        } else {
            number(order, &head[4..8])
        };
        Ok(Self {
            bytes: bytes.clone(),
            order,
            big,
            first,
        })
    }

    pub(super) fn name(&self) -> &str {
        self.bytes.name()
    }

    /// An unsigned number of `count` bytes, at most 8.
    pub(super) fn number_at(&self, at: u64, count: u64) -> Result<u64, Error> {
        Ok(number(self.order, &self.bytes.read(at, count)?))
    }

    /// The directories of the file, in order.
    pub(super) fn directories(&self) -> Directories<'_> {
        Directories {
            tiff: self,
            next: self.first,
            seen: HashSet::new(),
            bytes: 0,
        }
    }

    /// The directory at `at`.
    pub(super) fn directory(&self, at: u64) -> Result<Ifd, Error> {
        let (count_bytes, entry_bytes, offset_bytes) = if self.big {
            (8_u64, 20_u64, 8_u64)
        } else {
            (2, 12, 4)
        };
        let count = self.number_at(at, count_bytes)?;
        // The count was read, so `at + count_bytes` is inside the file.
        let start = at + count_bytes;
        let bytes = count
            .checked_mul(entry_bytes)
            .and_then(|n| usize::try_from(n).ok());
        let Some(bytes) = bytes.filter(|n| *n as u64 <= self.bytes.len() - start) else {
            return Err(Error::invalid(
                self.name(),
                format!(
                    "a directory claims {count} entries of {entry_bytes} bytes, but the file ends \
                     at byte {}",
                    self.bytes.len()
                ),
            )
            .at(at));
        };
        let table = self.bytes.read(start, bytes as u64)?;
        let mut entries = Vec::with_capacity(bytes / entry_bytes as usize);
        for (i, raw) in table.chunks_exact(entry_bytes as usize).enumerate() {
            let kind = number(self.order, &raw[2..4]) as u16;
            let values_at = 4 + offset_bytes as usize;
            let count = number(self.order, &raw[4..values_at]);
            let inline = value_bytes(kind)
                .and_then(|size| size.checked_mul(count))
                .is_some_and(|n| n <= offset_bytes);
            let entry_at = start + i as u64 * entry_bytes;
            let at = if inline {
                entry_at + values_at as u64
            } else {
                number(self.order, &raw[values_at..])
            };
            entries.push(Entry {
                tag: number(self.order, &raw[..2]) as u16,
                kind,
                count,
                at,
            });
        }
        let end = start + bytes as u64;
        // Some writers leave the link after the last directory out.
        let next = if self.bytes.len() - end < offset_bytes {
            0
        } else {
            self.number_at(end, offset_bytes)?
        };
        Ok(Ifd {
            at,
            next,
            entries,
            bytes: count_bytes + bytes as u64,
        })
    }

    /// Value number `index` of an entry of unsigned integers.
    pub(super) fn value(&self, entry: &Entry, index: u64) -> Result<u64, Error> {
        let size = self.integer_bytes(entry)?;
        if index >= entry.count {
            return Err(self.bad_entry(
                entry,
                format!("has {} values, more were expected", entry.count),
            ));
        }
        let at = index
            .checked_mul(size)
            .and_then(|n| n.checked_add(entry.at));
        let at = at.ok_or_else(|| self.bad_entry(entry, "is beyond the end of the file".into()))?;
        self.number_at(at, size)
    }

    /// Checks that an entry holds unsigned integers, and gives the bytes of each.
    fn integer_bytes(&self, entry: &Entry) -> Result<u64, Error> {
        match entry.kind {
            1 | 3 | 4 | 13 | 16 | 18 => Ok(entry.value_bytes().unwrap_or(8)),
            kind => Err(self.bad_entry(
                entry,
                format!("has type {kind}, an unsigned integer was expected"),
            )),
        }
    }

    /// Calls `each` with every value of an entry of unsigned integers, read in pieces.
    pub(super) fn for_each_value(
        &self,
        entry: &Entry,
        mut each: impl FnMut(u64) -> Result<(), Error>,
    ) -> Result<(), Error> {
        const PIECE_BYTES: u64 = 64 << 10;
        let size = self.integer_bytes(entry)?;
        let bytes = self.check_values(entry)?;
        let mut at = entry.at;
        let end = at + bytes;
        while at < end {
            let count = PIECE_BYTES.min(end - at);
            for raw in self.bytes.read(at, count)?.chunks_exact(size as usize) {
                each(number(self.order, raw))?;
            }
            at += count;
        }
        Ok(())
    }

    /// The bytes of an entry's values, if all of them are in the file.
    fn check_values(&self, entry: &Entry) -> Result<u64, Error> {
        let size = entry
            .value_bytes()
            .ok_or_else(|| self.bad_entry(entry, format!("has the unknown type {}", entry.kind)))?;
        entry
            .count
            .checked_mul(size)
            .filter(|n| {
                entry
                    .at
                    .checked_add(*n)
                    .is_some_and(|end| end <= self.bytes.len())
            })
            .ok_or_else(|| {
                self.bad_entry(
                    entry,
                    format!(
                        "claims {} values of {size} bytes at byte {}, but the file ends at byte {}",
                        entry.count,
                        entry.at,
                        self.bytes.len()
                    ),
                )
            })
    }

    /// All bytes of an entry's values.
    pub(super) fn raw(&self, entry: &Entry) -> Result<Cow<'_, [u8]>, Error> {
        let bytes = self.check_values(entry)?;
        self.bytes.read(entry.at, bytes)
    }

    /// The first value of an entry, if the directory has it.
    pub(super) fn first(&self, ifd: &Ifd, tag: u16) -> Result<Option<u64>, Error> {
        ifd.entry(tag).map(|entry| self.value(entry, 0)).transpose()
    }

    /// The text of an entry, up to its first zero byte, if the directory has it.
    pub(super) fn text(&self, ifd: &Ifd, tag: u16) -> Result<Option<Cow<'_, [u8]>>, Error> {
        let Some(entry) = ifd.entry(tag) else {
            return Ok(None);
        };
        if !matches!(entry.kind, 1 | 2 | 7) {
            return Ok(None);
        }
        let mut raw = self.raw(entry)?;
        let end = raw.iter().position(|b| *b == 0).unwrap_or(raw.len());
        match &mut raw {
            Cow::Borrowed(bytes) => *bytes = &bytes[..end],
            Cow::Owned(bytes) => bytes.truncate(end),
        }
        Ok(Some(raw))
    }

    /// The first value of a RATIONAL entry as (numerator, denominator), if the directory has it.
    pub(super) fn rational(&self, ifd: &Ifd, tag: u16) -> Result<Option<(f64, f64)>, Error> {
        let Some(entry) = ifd.entry(tag) else {
            return Ok(None);
        };
        if entry.kind != 5 || entry.count == 0 {
            return Ok(None);
        }
        let above = self.number_at(entry.at, 4)?;
        let below = self.number_at(entry.at.saturating_add(4), 4)?;
        Ok(Some((above as f64, below as f64)))
    }

    fn bad_entry(&self, entry: &Entry, what: String) -> Error {
        Error::invalid(
            self.name(),
            format!("entry {} of a directory {what}", entry.tag),
        )
        .at(entry.at)
    }
}

/// The directories of a file, one after the other.
pub(super) struct Directories<'a> {
    tiff: &'a Tiff,
    next: u64,
    seen: HashSet<u64>,
    bytes: u64,
}

impl Iterator for Directories<'_> {
    type Item = Result<Ifd, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next == 0 {
            return None;
        }
        let at = std::mem::take(&mut self.next);
        Some(self.visit(at))
    }
}

impl Directories<'_> {
    fn visit(&mut self, at: u64) -> Result<Ifd, Error> {
        let tiff = self.tiff;
        let page = self.seen.len();
        if !self.seen.insert(at) {
            return Err(Error::invalid(
                tiff.name(),
                format!(
                    "the chain of pages comes back to an earlier one after page {}",
                    page.saturating_sub(1)
                ),
            )
            .at(at));
        }
        if at >= tiff.bytes.len() {
            return Err(Error::invalid(
                tiff.name(),
                format!(
                    "page {page} is said to be at byte {at}, but the file ends at byte {}",
                    tiff.bytes.len()
                ),
            )
            .at(at));
        }
        let ifd = tiff.directory(at)?;
        // Distinct directories do not overlap, so together they are part of the file.
        self.bytes = self.bytes.saturating_add(ifd.bytes);
        if self.bytes > tiff.bytes.len() {
            return Err(Error::invalid(
                tiff.name(),
                "the directories of the pages overlap: together they are longer than the file",
            )
            .at(at));
        }
        self.next = ifd.next;
        Ok(ifd)
    }
}

/// An unsigned number of at most 8 bytes.
pub(super) fn number(order: ByteOrder, raw: &[u8]) -> u64 {
    let add = |n: u64, b: &u8| n << 8 | u64::from(*b);
    match order {
        ByteOrder::Little => raw.iter().rev().fold(0, add),
        ByteOrder::Big => raw.iter().fold(0, add),
    }
}
