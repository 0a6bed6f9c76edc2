//! Decompression of one strip or tile.
//!
//! In: the stored bytes and the number of bytes they must give. Out: exactly that many, or an
//! error in words. Guaranteed: output grows with what is really there and never beyond what was
//! asked for. Deflate is by `flate2`, zstd by `zstd`, LZW by `weezl` (streams through a buffer of
//! our size, stops when it is full), the code tables of CCITT and group 4 by `fax`, whose other
//! row loops want end-of-line marks that TIFF need not have. PackBits is a few lines.

use std::convert::Infallible;
use std::io::Read;

use fax::decoder::{DecodeStatus, Group4Decoder};
use fax::maps::{black, white};
use fax::{BitReader, ByteReader};
use weezl::{BitOrder, LzwStatus, decode::Configuration};

/// What went wrong, in words.
pub(super) type Failure = String;

fn too_few(found: usize, expected: usize) -> Failure {
    format!("gives {found} bytes, {expected} expected")
}

/// Deflate with the wrapping of zlib.
pub(super) fn deflate(data: &[u8], expected: usize, out: &mut Vec<u8>) -> Result<(), Failure> {
    let damaged = |e| format!("is damaged deflate data: {e}");
    out.clear();
    out.reserve(expected.min(data.len().saturating_mul(4)));
    let mut reader = flate2::bufread::ZlibDecoder::new(data);
    reader
        .by_ref()
        .take(expected as u64)
        .read_to_end(out)
        .map_err(damaged)?;
    if out.len() < expected {
        return Err(too_few(out.len(), expected));
    }
    // To the end of the data, where the checksum is.
    reader.read(&mut [0]).map_err(damaged)?;
    Ok(())
}

/// zstd: one or more frames.
pub(super) fn zstd(data: &[u8], expected: usize, out: &mut Vec<u8>) -> Result<(), Failure> {
    let damaged = |e| format!("is damaged zstd data, or more than {expected} bytes: {e}");
    out.clear();
    out.reserve_exact(expected);
    let mut decoder = zstd::bulk::Decompressor::new().map_err(damaged)?;
    decoder.decompress_to_buffer(data, out).map_err(damaged)?;
    if out.len() < expected {
        return Err(too_few(out.len(), expected));
    }
    out.truncate(expected);
    Ok(())
}

/// LZW as TIFF has it: highest bit first, codes grow one early.
pub(super) fn lzw(data: &[u8], expected: usize, out: &mut Vec<u8>) -> Result<(), Failure> {
    const FIRST_BYTES: usize = 64 << 10;
    out.clear();
    if data.len() >= 2 && data[0] == 0 && data[1] & 1 == 1 {
        return Err("is LZW in the old bit order, which is not read".into());
    }
    let mut decoder = Configuration::with_tiff_size_switch(BitOrder::Msb, 8)
        .with_yield_on_full_buffer(true)
        .build();
    let (mut from, mut done) = (0, 0);
    while done < expected {
        if done == out.len() {
            let more = (out.len() * 2).max(FIRST_BYTES).max(data.len());
            out.resize(more.min(expected), 0);
        }
        let result = decoder.decode_bytes(&data[from..], &mut out[done..]);
        from += result.consumed_in;
        done += result.consumed_out;
        let progress = result.consumed_in + result.consumed_out > 0;
        match result.status {
            Ok(LzwStatus::Ok) if progress => {}
            Ok(_) => break,
            Err(error) => return Err(format!("is damaged LZW data: {error}")),
        }
    }
    if done < expected {
        return Err(too_few(done, expected));
    }
    Ok(())
}

/// PackBits: runs and literals of up to 128 bytes.
pub(super) fn packbits(data: &[u8], expected: usize, out: &mut Vec<u8>) -> Result<(), Failure> {
    out.clear();
    let mut rest = data;
    while out.len() < expected {
        let Some((&head, behind)) = rest.split_first() else {
            return Err(too_few(out.len(), expected));
        };
        let room = expected - out.len();
        match head as i8 {
            // Does nothing.
            -128 => rest = behind,
            literal @ 0.. => {
                let count = literal as usize + 1;
                let Some((bytes, behind)) = behind.split_at_checked(count) else {
                    return Err(too_few(out.len() + behind.len().min(room), expected));
                };
                out.extend_from_slice(&bytes[..count.min(room)]);
                rest = behind;
            }
            run => {
                let Some((&byte, behind)) = behind.split_first() else {
                    return Err(too_few(out.len(), expected));
                };
                let count = 1 + usize::from(run.unsigned_abs());
                out.resize(out.len() + count.min(room), byte);
                rest = behind;
            }
        }
    }
    Ok(())
}

/// Which of the codes of CCITT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fax {
    /// Rows of runs, each on a byte border.
    Huffman,
    /// Rows of runs, with or without end-of-line marks before them.
    Group3,
    /// Rows by difference from the row above.
    Group4,
}

/// CCITT codes to packed rows, in which a set bit is black.
pub(super) fn fax(
    kind: Fax,
    data: &[u8],
    width: u64,
    rows: usize,
    out: &mut Vec<u8>,
) -> Result<(), Failure> {
    out.clear();
    let width = u32::try_from(width)
        .ok()
        .filter(|n| *n <= i32::MAX as u32)
        .ok_or("is too wide for CCITT")?;
    // The code tables look ahead, also behind the last code.
    let input = data.iter().copied().chain([0; 4]).map(Ok::<u8, Infallible>);
    let stopped = |row: usize| format!("gives {row} rows, {rows} expected");
    if kind == Fax::Group4 {
        let Ok(mut decoder) = Group4Decoder::new(input, width);
        for row in 0..rows {
            match decoder.advance() {
                Ok(DecodeStatus::Incomplete) => pack(decoder.transition(), width, out),
                Ok(DecodeStatus::End) | Err(_) => return Err(stopped(row)),
            }
        }
        return Ok(());
    }
    let Ok(mut reader) = ByteReader::new(input);
    let mut ends = Vec::new();
    for row in 0..rows {
        match kind {
            Fax::Huffman => {
                let Ok(()) = reader.consume(reader.bits_to_byte_boundary());
            }
            // No code begins with nine zeros: only fill and an end-of-line mark do.
            _ => {
                if reader.peek(9) == Some(0) {
                    while reader.peek(1) == Some(0) {
                        let Ok(()) = reader.consume(1);
                    }
                    let Ok(()) = reader.consume(1);
                }
            }
        }
        runs(&mut reader, width, &mut ends).ok_or_else(|| stopped(row))?;
        pack(&ends, width, out);
    }
    Ok(())
}

/// The ends of the runs of a row, white first; `None` unless they fill it exactly.
fn runs(reader: &mut impl BitReader, width: u32, ends: &mut Vec<u32>) -> Option<()> {
    ends.clear();
    let mut end = 0_u32;
    let mut is_black = false;
    while end < width || ends.is_empty() {
        loop {
            let run = if is_black {
                black::decode(reader)?
            } else {
                white::decode(reader)?
            };
            end = end.checked_add(run.into()).filter(|end| *end <= width)?;
            // Longer runs are make-up codes, before one that ends the run.
            if run < 64 {
                break;
            }
        }
        ends.push(end);
        is_black = !is_black;
    }
    Some(())
}

/// Appends a row of bits that change at the given places, 0 first.
fn pack(ends: &[u32], width: u32, out: &mut Vec<u8>) {
    let start = out.len();
    out.resize(start + width.div_ceil(8) as usize, 0);
    let row = &mut out[start..];
    for pair in ends.chunks(2) {
        let from = pair[0].min(width);
        let to = pair.get(1).map_or(width, |to| (*to).min(width));
        for x in from..to {
            row[x as usize / 8] |= 0x80 >> (x % 8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packbits_stops_at_what_was_asked_for() {
        let mut out = Vec::new();
        // The example of the specification.
        let data = [
            0xfe, 0xaa, 0x02, 0x80, 0x00, 0x2a, 0xfd, 0xaa, 0x03, 0x80, 0x00, 0x2a, 0x22, 0xf7,
            0xaa,
        ];
        packbits(&data, 24, &mut out).unwrap();
        assert_eq!(&out[..8], [0xaa, 0xaa, 0xaa, 0x80, 0, 0x2a, 0xaa, 0xaa]);
        assert_eq!(out.len(), 24);
        packbits(&data, 5, &mut out).unwrap();
        assert_eq!(out, [0xaa, 0xaa, 0xaa, 0x80, 0]);
        assert_eq!(
            packbits(&data, 25, &mut out).unwrap_err(),
            "gives 24 bytes, 25 expected"
        );
    }

    #[test]
    fn damaged_codes_are_errors() {
        let mut out = Vec::new();
        for kind in [Fax::Huffman, Fax::Group3, Fax::Group4] {
            assert!(fax(kind, &[0; 100], 40, 40, &mut out).is_err(), "{kind:?}");
            assert!(fax(kind, &[], 40, 1, &mut out).is_err(), "{kind:?}");
        }
        assert!(lzw(&[], 10, &mut out).is_err());
        assert!(lzw(&[0x80], 10, &mut out).is_err());
    }
}
