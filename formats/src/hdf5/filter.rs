//! Filters: what chunks went through when they were written, undone in reverse.
//!
//! In: the filters of a dataset and the bytes of a chunk. Out: the chunk. Guaranteed: no step gives
//! more than the chunk has (and what checksums and the heads of an outer compression add), and
//! the last gives exactly that. Filters that are not known are refused by name before a voxel is
//! read.
//!
//! Read: deflate, shuffle, Fletcher-32 (verified), LZF, Blosc, bitshuffle (alone, with LZ4 and
//! with zstd), LZ4, zstd, bzip2.

use std::borrow::Cow;

use super::message::Filter;
use crate::codec::{self, CodecError, blosc, exactly, shuffle};

mod id {
    pub(super) const DEFLATE: u16 = 1;
    pub(super) const SHUFFLE: u16 = 2;
    pub(super) const FLETCHER: u16 = 3;
    pub(super) const BZIP2: u16 = 307;
    pub(super) const LZF: u16 = 32000;
    pub(super) const BLOSC: u16 = 32001;
    pub(super) const LZ4: u16 = 32004;
    pub(super) const BITSHUFFLE: u16 = 32008;
    pub(super) const ZSTD: u16 = 32015;
}

/// The name of a filter, for print.
pub(super) fn name(filter: &Filter) -> String {
    let name = match filter.id {
        id::DEFLATE => "deflate",
        id::SHUFFLE => "shuffle",
        id::FLETCHER => "fletcher32",
        id::BZIP2 => "bzip2",
        id::LZF => "lzf",
        id::BLOSC => "blosc",
        id::LZ4 => "lz4",
        id::BITSHUFFLE => match filter.values.get(4) {
            Some(2) => "bitshuffle+lz4",
            Some(3) => "bitshuffle+zstd",
            _ => "bitshuffle",
        },
        id::ZSTD => "zstd",
        4 => "szip",
        5 => "n-bit",
        6 => "scale-offset",
        32013 => "zfp",
        32017 => "sz",
        32018 => "fcidecomp",
        32019 => "jpeg",
        32024 => "sz3",
        32026 => "blosc2",
        32028 => "jetraw",
        other => return format!("filter {other}"),
    };
    name.to_owned()
}

/// Whether the filter is undone here.
pub(super) fn is_known(filter: &Filter) -> bool {
    let bitshuffle = |filter: &Filter| matches!(filter.values.get(4), None | Some(0 | 2 | 3));
    match filter.id {
        id::BITSHUFFLE => bitshuffle(filter),
        id => [
            id::DEFLATE,
            id::SHUFFLE,
            id::FLETCHER,
            id::BZIP2,
            id::LZF,
            id::BLOSC,
            id::LZ4,
            id::ZSTD,
        ]
        .contains(&id),
    }
}

/// Undoes the filters of a chunk, but for those whose bits in `without` are set. `out` is
/// replaced by the `expected` bytes of the chunk, whose voxels have `voxel_bytes`.
pub(super) fn undo(
    filters: &[Filter],
    without: u32,
    stored: Cow<'_, [u8]>,
    expected: usize,
    voxel_bytes: usize,
    out: &mut Vec<u8>,
) -> Result<(), CodecError> {
    let used: Vec<_> = filters
        .iter()
        .enumerate()
        .filter(|(n, _)| *n >= 32 || without >> n & 1 == 0)
        .map(|(_, filter)| filter)
        .collect();
    let mut data = stored;
    let mut spare = Vec::new();
    for (n, filter) in used.iter().enumerate().rev() {
        // Compression within compression may add heads and tables.
        let slack = if n == 0 { 0 } else { expected / 8 + 1024 };
        let most = expected.saturating_add(slack);
        if filter.id == id::FLETCHER {
            let content = fletcher(&data)?.len();
            data = match data {
                Cow::Borrowed(bytes) => Cow::Borrowed(&bytes[..content]),
                Cow::Owned(mut bytes) => {
                    bytes.truncate(content);
                    Cow::Owned(bytes)
                }
            };
            continue;
        }
        let target = if n == 0 { &mut *out } else { &mut spare };
        one(filter, &data, most, voxel_bytes, target)?;
        if n == 0 {
            return exactly(expected, out);
        }
        let before = std::mem::replace(&mut data, Cow::Owned(std::mem::take(&mut spare)));
        if let Cow::Owned(bytes) = before {
            spare = bytes;
        }
    }
    exactly(expected, &data)?;
    out.clear();
    out.extend_from_slice(&data);
    Ok(())
}

/// Undoes one filter; `out` is replaced by at most `most` bytes.
fn one(
    filter: &Filter,
    data: &[u8],
    most: usize,
    voxel_bytes: usize,
    out: &mut Vec<u8>,
) -> Result<(), CodecError> {
    match filter.id {
        id::DEFLATE => codec::zlib(data, most, out),
        id::BZIP2 => codec::bzip2(data, most, out),
        id::ZSTD => codec::zstd(data, most, out),
        id::BLOSC => blosc::decode(data, most, out),
        id::LZF => lzf(data, most, out),
        id::LZ4 => lz4(data, most, out),
        id::SHUFFLE => {
            let element = filter.values.first().map_or(voxel_bytes, |n| *n as usize);
            sized(data.len(), most, out)?;
            shuffle::unshuffle(element, data, out);
            Ok(())
        }
        id::BITSHUFFLE => bitshuffle(filter, data, most, voxel_bytes, out),
        other => Err(CodecError::unsupported(format!(
            "filter {other} is not read here"
        ))),
    }
}

/// Makes `out` `bytes` long.
fn sized(bytes: usize, most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    if bytes > most {
        return Err(codec::too_much("filtered", most));
    }
    out.clear();
    out.resize(bytes, 0);
    Ok(())
}

/// Takes Fletcher's checksum off the end: two sums of 16 bits over big-endian words.
fn fletcher(data: &[u8]) -> Result<&[u8], CodecError> {
    let Some((content, stored)) = data.split_last_chunk::<4>() else {
        return Err(CodecError::damaged("a chunk too short for its checksum"));
    };
    let (mut a, mut b) = (0_u32, 0_u32);
    let fold = |sum: u32| (sum & 0xffff) + (sum >> 16);
    // 360 words fit 32 bits before the sums must be folded.
    for block in content.chunks(720) {
        let (words, odd) = block.as_chunks::<2>();
        for word in words {
            a += u32::from(u16::from_be_bytes(*word));
            b += a;
        }
        if let [byte] = odd {
            a += u32::from(*byte) << 8;
            b += a;
        }
        (a, b) = (fold(a), fold(b));
    }
    (a, b) = (fold(a), fold(b));
    let (found, stored) = (b << 16 | a, u32::from_le_bytes(*stored));
    // Some old libraries stored the bytes of each half the other way round.
    let swapped = (stored & 0x00ff_00ff) << 8 | (stored >> 8 & 0x00ff_00ff);
    if found != stored && found != swapped {
        return Err(CodecError::damaged(format!(
            "its Fletcher-32 checksum is {found:08x}, {stored:08x} is stored: it is damaged"
        )));
    }
    Ok(content)
}

/// Decodes LZF: runs of up to 32 bytes as they are, and references up to 8 KiB back.
fn lzf(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    let cut = || CodecError::damaged("the LZF data is cut");
    out.clear();
    let mut rest = data;
    let mut next = |count: usize| -> Result<&[u8], CodecError> {
        let (taken, left) = rest.split_at_checked(count).ok_or_else(cut)?;
        rest = left;
        Ok(taken)
    };
    while let Ok(&[control]) = next(1) {
        let length = usize::from(control >> 5);
        if length == 0 {
            let run = usize::from(control) + 1;
            if out.len() + run > most {
                return Err(codec::too_much("LZF", most));
            }
            out.extend_from_slice(next(run)?);
            continue;
        }
        let length = length
            + 2
            + if length == 7 {
                usize::from(next(1)?[0])
            } else {
                0
            };
        let back = (usize::from(control & 31) << 8 | usize::from(next(1)?[0])) + 1;
        let from = out.len().checked_sub(back).ok_or_else(|| {
            CodecError::damaged(format!(
                "the LZF data refers {back} bytes back, of {} decoded",
                out.len()
            ))
        })?;
        if out.len() + length > most {
            return Err(codec::too_much("LZF", most));
        }
        if back >= length {
            out.extend_from_within(from..from + length);
        } else {
            // The reference overlaps what it makes.
            for i in 0..length {
                let byte = out[from + i];
                out.push(byte);
            }
        }
    }
    Ok(())
}

/// A number of `N` bytes, big-endian, from the front.
fn number<const N: usize>(data: &mut &[u8]) -> Result<usize, CodecError> {
    let (bytes, rest) = data
        .split_first_chunk::<N>()
        .ok_or_else(|| CodecError::damaged("the compressed data is cut"))?;
    *data = rest;
    let value = bytes
        .iter()
        .fold(0_u64, |n, byte| n << 8 | u64::from(*byte));
    usize::try_from(value).map_err(|_| CodecError::damaged(format!("a size of {value} bytes")))
}

fn piece<'a>(data: &mut &'a [u8], count: usize) -> Result<&'a [u8], CodecError> {
    let (taken, rest) = data.split_at_checked(count).ok_or_else(|| {
        CodecError::damaged(format!(
            "the compressed data is cut: {} bytes of {count}",
            data.len()
        ))
    })?;
    *data = rest;
    Ok(taken)
}

/// Decodes the LZ4 filter: the sizes of the whole and of a block, then each block behind its
/// compressed size.
fn lz4(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    let mut rest = data;
    let whole = number::<8>(&mut rest)?;
    let block = number::<4>(&mut rest)?;
    if whole > most {
        return Err(codec::too_much("LZ4", most));
    }
    out.clear();
    let mut decoded = Vec::new();
    while out.len() < whole {
        let expected = block.min(whole - out.len());
        if expected == 0 {
            return Err(CodecError::damaged("LZ4 blocks of 0 bytes"));
        }
        let bytes = number::<4>(&mut rest)?;
        let packed = piece(&mut rest, bytes)?;
        if bytes == expected {
            // Did not get smaller, so it was left as it is.
            out.extend_from_slice(packed);
        } else {
            codec::lz4_block(packed, expected, &mut decoded)?;
            exactly(expected, &decoded)?;
            out.extend_from_slice(&decoded);
        }
    }
    Ok(())
}

/// Undoes bitshuffle: blocks of elements whose bits were put together, then compressed. Elements
/// beyond a multiple of eight are as they were.
fn bitshuffle(
    filter: &Filter,
    data: &[u8],
    most: usize,
    voxel_bytes: usize,
    out: &mut Vec<u8>,
) -> Result<(), CodecError> {
    /// Elements that are not eight are not shuffled.
    const MULTIPLE: usize = 8;
    /// What the library takes when it is not told: blocks of about 8 KiB, at least 128 elements.
    const TARGET_BYTES: usize = 8192;
    const LEAST: usize = 128;
    let value = |n: usize| filter.values.get(n).map(|value| *value as usize);
    let element = value(2).filter(|n| *n > 0).unwrap_or(voxel_bytes);
    let compression = value(4).unwrap_or(0);
    let mut rest = data;
    let (whole, block) = if compression == 0 {
        let told = value(3).filter(|n| *n > 0);
        let usual = (TARGET_BYTES / element / MULTIPLE * MULTIPLE).max(LEAST);
        (data.len(), told.unwrap_or(usual))
    } else {
        let whole = number::<8>(&mut rest)?;
        (whole, number::<4>(&mut rest)? / element)
    };
    if whole > most || element > most {
        return Err(codec::too_much("bitshuffle", most));
    }
    if block == 0 || !block.is_multiple_of(MULTIPLE) {
        return Err(CodecError::damaged(format!(
            "blocks of {block} elements; a multiple of 8 expected"
        )));
    }
    out.clear();
    let elements = whole / element;
    let mut left = elements / MULTIPLE * MULTIPLE;
    let (mut decoded, mut unshuffled) = (Vec::new(), Vec::new());
    while left > 0 {
        let count = block.min(left);
        let bytes = count * element;
        let shuffled = if compression == 0 {
            piece(&mut rest, bytes)?
        } else {
            let packed = number::<4>(&mut rest)?;
            let packed = piece(&mut rest, packed)?;
            if compression == 2 {
                codec::lz4_block(packed, bytes, &mut decoded)?;
            } else {
                codec::zstd(packed, bytes, &mut decoded)?;
            }
            exactly(bytes, &decoded)?;
            &decoded[..]
        };
        unshuffled.resize(bytes, 0);
        shuffle::unshuffle_bits(element, shuffled, &mut unshuffled);
        out.extend_from_slice(&unshuffled);
        left -= count;
    }
    let tail = piece(&mut rest, whole - out.len())?;
    out.extend_from_slice(tail);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_of_lzf_may_overlap_what_it_makes() {
        // One letter, then nine more of it; then two others.
        let data = [0, b'a', 0xe0, 0, 0, 1, b'b', b'c'];
        let mut out = Vec::new();
        lzf(&data, 12, &mut out).unwrap();
        assert_eq!(out, b"aaaaaaaaaabc");
        assert!(lzf(&data, 11, &mut out).is_err());
        assert!(lzf(&data[..7], 12, &mut out).is_err());
        assert!(lzf(&[0x20, 0], 12, &mut out).is_err());
    }

    #[test]
    fn a_damaged_chunk_does_not_have_its_checksum() {
        let mut data = b"abcdefghi".to_vec();
        data.extend([0; 4]);
        assert!(fletcher(&data).is_err());
    }
}
