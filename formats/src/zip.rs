//! The members of a zip archive, stored or deflated.
//!
//! In: the bytes of an archive. Out: its list of members, where the bytes of a member lie, and
//! what deflated ones decode to. Guaranteed: the list is read from the directory at the end of
//! the archive, whose place and size are checked first, so memory follows the size of the
//! archive; a deflated member gives as many bytes as the directory says, or an error, and its
//! checksum is verified at its end. Not guaranteed: the checksum of a stored member, which is
//! used where it lies.
//!
//! Of a crate, little more than the directory would be used, and what is needed of it, the place
//! of a stored member in a map and bounds on what a directory may cost, is not what those crates
//! are made for.
//!
//! Refused: encrypted members, other compressions, archives in several parts.

use std::io::{self, Read};

use flate2::Crc;
use flate2::bufread::DeflateDecoder;

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::input::{Input, Layer};

/// The begin of an archive: the header of its first member.
pub(crate) const MAGIC: &[u8] = b"PK\x03\x04";

const LOCAL_BYTES: u64 = 30;
const ENTRY_BYTES: usize = 46;
const END_BYTES: usize = 22;
const LOCATOR_BYTES: u64 = 20;
const END64_BYTES: u64 = 56;
/// Stands in a field of 4 bytes whose number needs 8, and is elsewhere.
const ELSEWHERE: u64 = 0xffff_ffff;

/// The name of the first member of an archive that begins with `head`.
pub(crate) fn first_name(head: &[u8]) -> Option<&[u8]> {
    if !head.starts_with(MAGIC) {
        return None;
    }
    let length = usize::from(u16::from_le_bytes([*head.get(26)?, *head.get(27)?]));
    head.get(LOCAL_BYTES as usize..)?.get(..length)
}

/// A file in the archive, as the directory has it.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    pub(crate) name: String,
    flags: u16,
    method: u16,
    checksum: u32,
    packed_bytes: u64,
    pub(crate) bytes: u64,
    /// Where its own header lies.
    at: u64,
}

fn u16_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]))
}

fn u32_at(bytes: &[u8], at: usize) -> u64 {
    u16_at(bytes, at) | u16_at(bytes, at + 2) << 16
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u32_at(bytes, at) | u32_at(bytes, at + 4) << 32
}

/// All members, in the order of the directory.
pub(crate) fn members(archive: &FileBytes) -> Result<Vec<Member>, Error> {
    let (count, from, bytes) = directory(archive)?;
    let directory = archive.read(from, bytes)?;
    let invalid =
        |message: String, at: usize| Error::invalid(archive.name(), message).at(from + at as u64);
    let mut members = Vec::new();
    let mut at = 0;
    for _ in 0..count {
        let entry = directory.get(at..).unwrap_or_default();
        if entry.len() < ENTRY_BYTES || !entry.starts_with(b"PK\x01\x02") {
            return Err(invalid(
                format!(
                    "the directory of the archive is damaged: {} members found, {count} expected",
                    members.len()
                ),
                at,
            ));
        }
        let name_end = ENTRY_BYTES + u16_at(entry, 28) as usize;
        let extra_end = name_end + u16_at(entry, 30) as usize;
        let end = extra_end + u16_at(entry, 32) as usize;
        if entry.len() < end {
            return Err(invalid(
                "the directory of the archive ends early".into(),
                at,
            ));
        }
        let mut member = Member {
            name: String::from_utf8_lossy(&entry[ENTRY_BYTES..name_end]).into_owned(),
            flags: u16_at(entry, 8) as u16,
            method: u16_at(entry, 10) as u16,
            checksum: u32_at(entry, 16) as u32,
            packed_bytes: u32_at(entry, 20),
            bytes: u32_at(entry, 24),
            at: u32_at(entry, 42),
        };
        member.take_large(&entry[name_end..extra_end]);
        members.push(member);
        at += end;
    }
    Ok(members)
}

/// Number of members, offset and bytes of the directory.
fn directory(archive: &FileBytes) -> Result<(u64, u64, u64), Error> {
    /// The longest comment that may follow the last record.
    const MOST_COMMENT_BYTES: u64 = 0xffff;
    let length = archive.len();
    let tail_bytes = length.min(END_BYTES as u64 + MOST_COMMENT_BYTES);
    let tail_at = length - tail_bytes;
    let tail = archive.read(tail_at, tail_bytes)?;
    let end = (0..(tail.len() + 1).saturating_sub(END_BYTES))
        .rev()
        .find(|at| {
            let record = &tail[*at..];
            record.starts_with(b"PK\x05\x06")
                && record.len() as u64 >= END_BYTES as u64 + u16_at(record, 20)
        });
    let Some(end) = end else {
        return Err(Error::invalid(
            archive.name(),
            "the archive has no directory at its end: it was cut",
        )
        .at(length));
    };
    let record = &tail[end..end + END_BYTES];
    let end_at = tail_at + end as u64;
    let mut found = (u16_at(record, 10), u32_at(record, 16), u32_at(record, 12));
    let mut parts = (u16_at(record, 4), u16_at(record, 6));
    let large = found.0 == 0xffff || found.1 == ELSEWHERE || found.2 == ELSEWHERE;
    if large && let Some(locator_at) = end_at.checked_sub(LOCATOR_BYTES) {
        let locator = archive.read(locator_at, LOCATOR_BYTES)?;
        if locator.starts_with(b"PK\x06\x07") {
            let record = archive.read(u64_at(&locator, 8), END64_BYTES)?;
            if !record.starts_with(b"PK\x06\x06") {
                return Err(Error::invalid(
                    archive.name(),
                    "the large directory of the archive is not where it is said to be",
                )
                .at(u64_at(&locator, 8)));
            }
            found = (
                u64_at(&record, 32),
                u64_at(&record, 48),
                u64_at(&record, 40),
            );
            parts = (u32_at(&record, 16), u32_at(&record, 20));
        }
    }
    if parts != (0, 0) {
        return Err(
            Error::unsupported(archive.name(), "an archive in several parts is not read")
                .at(end_at),
        );
    }
    let (count, from, bytes) = found;
    let fits = from.checked_add(bytes).is_some_and(|end| end <= end_at);
    if !fits || count > bytes / ENTRY_BYTES as u64 {
        return Err(Error::invalid(
            archive.name(),
            format!(
                "the directory of the archive is said to have {count} members in {bytes} bytes \
                 at byte {from}, but it must end before byte {end_at}"
            ),
        )
        .at(end_at));
    }
    Ok((count, from, bytes))
}

impl Member {
    /// Takes the numbers that need 8 bytes from the extra fields of the directory.
    fn take_large(&mut self, extra: &[u8]) {
        let mut rest = extra;
        while rest.len() >= 4 {
            let length = u16_at(rest, 2) as usize;
            let Some(field) = rest.get(4..4 + length) else {
                return;
            };
            if u16_at(rest, 0) == 1 {
                let mut numbers = field.chunks_exact(8).map(|n| u64_at(n, 0));
                for value in [&mut self.bytes, &mut self.packed_bytes, &mut self.at] {
                    if *value == ELSEWHERE
                        && let Some(number) = numbers.next()
                    {
                        *value = number;
                    }
                }
                return;
            }
            rest = &rest[4 + length..];
        }
    }

    /// Whether the bytes of the member stand in the archive as they are.
    pub(crate) fn is_stored(&self) -> bool {
        self.method == 0
    }

    /// Where the bytes of the member, stored or packed, begin. All of them are there.
    ///
    /// # Errors
    ///
    /// If they are not, or are encrypted or packed in another way.
    pub(crate) fn place(&self, archive: &FileBytes) -> Result<u64, Error> {
        let name = archive.name();
        let unsupported = |message| Err(Error::unsupported(name, message).at(self.at));
        if self.flags & 1 != 0 {
            return unsupported(format!("the member '{}' is encrypted", self.name));
        }
        match self.method {
            0 | 8 => {}
            method => {
                return unsupported(format!(
                    "the member '{}' is compressed by method {method}; stored (0) and deflated \
                     (8) ones are read",
                    self.name
                ));
            }
        }
        let header = archive.read(self.at, LOCAL_BYTES)?;
        let start = self.at + LOCAL_BYTES + u16_at(&header, 26) + u16_at(&header, 28);
        let there = start
            .checked_add(self.packed_bytes)
            .is_some_and(|end| end <= archive.len());
        let sizes_agree = !self.is_stored() || self.bytes == self.packed_bytes;
        if header.starts_with(MAGIC) && there && sizes_agree {
            return Ok(start);
        }
        Err(Error::invalid(
            name,
            format!(
                "the member '{}' is not where the directory says: {} bytes, expected within the \
                 {} of the file",
                self.name,
                self.packed_bytes,
                archive.len()
            ),
        )
        .at(self.at))
    }

    /// The bytes of the member, from `place` on, read forward and decoded.
    pub(crate) fn read(&self, archive: &FileBytes, place: u64) -> Input {
        let packed = Input::new(Range {
            bytes: archive.clone(),
            at: place,
            left: self.packed_bytes,
        });
        if self.is_stored() {
            return packed;
        }
        Input::over(Box::new(Inflated {
            decoder: DeflateDecoder::new(packed),
            crc: Crc::new(),
            left: self.bytes,
            checksum: self.checksum,
        }))
    }

    /// Whether so many bytes cannot possibly be in what is packed.
    pub(crate) fn cannot_hold(&self, bytes: u64) -> bool {
        bytes > self.bytes
            || (!self.is_stored() && bytes / crate::input::DEFLATE_MOST > self.packed_bytes)
    }
}

/// A run of an archive, read forward.
struct Range {
    bytes: FileBytes,
    at: u64,
    left: u64,
}

impl Read for Range {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let count = usize::try_from(self.left)
            .unwrap_or(usize::MAX)
            .min(out.len());
        if count == 0 {
            return Ok(0);
        }
        let changed = |e: Error| io::Error::other(e.message().to_string());
        self.bytes
            .read_into(self.at, &mut out[..count])
            .and_then(|()| self.bytes.check())
            .map_err(changed)?;
        self.at += count as u64;
        self.left -= count as u64;
        Ok(count)
    }
}

/// A deflated member, which must be as long as the directory says and have its checksum.
struct Inflated {
    decoder: DeflateDecoder<Input>,
    crc: Crc,
    left: u64,
    checksum: u32,
}

impl Read for Inflated {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if out.is_empty() {
            return Ok(0);
        }
        let invalid = |message: &str| Err(io::Error::new(io::ErrorKind::InvalidData, message));
        let count = self.decoder.read(out)?;
        if count as u64 > self.left {
            return invalid("it is longer than the directory of the archive says");
        }
        self.left -= count as u64;
        self.crc.update(&out[..count]);
        if count == 0 && self.left > 0 {
            return invalid("it is shorter than the directory of the archive says");
        }
        if count == 0 && self.crc.sum() != self.checksum {
            return invalid("its checksum is wrong");
        }
        Ok(count)
    }
}

impl Layer for Inflated {}
