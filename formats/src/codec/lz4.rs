//! LZ4 blocks and the frames that numcodecs and Java's lz4 library put around them.
//!
//! numcodecs writes the decoded size as 4 bytes, little-endian, then one block. Java's
//! `LZ4BlockOutputStream`, which N5 uses, writes blocks that each have a header of 21 bytes:
//! `LZ4Block`, a byte of method and level, the sizes before and after, and an xxHash-32 of the
//! decoded bytes, of which the upper four bits are dropped. An empty block ends the stream.

use twox_hash::XxHash32;

use super::{CodecError, exactly, too_much};

/// The most bytes that a byte of an LZ4 block can stand for.
const MOST_A_BYTE: usize = 255;

/// Decodes one block into the whole of `out`.
pub(super) fn block_into(data: &[u8], out: &mut [u8]) -> Result<usize, CodecError> {
    lz4_flex::block::decompress_into(data, out)
        .map_err(|e| CodecError::damaged(format!("the LZ4 data is damaged or cut: {e}")))
}

/// Decodes one LZ4 block without any header; `out` is replaced.
pub(crate) fn lz4_block(data: &[u8], expected: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    out.clear();
    append(data, expected, out)
}

/// Decodes one block of `expected` bytes behind what is in `out`.
fn append(data: &[u8], expected: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    if expected > data.len().saturating_mul(MOST_A_BYTE).saturating_add(64) {
        return Err(CodecError::damaged(format!(
            "{} bytes of LZ4 data cannot decode to {expected} bytes",
            data.len()
        )));
    }
    let start = out.len();
    out.resize(start.saturating_add(expected), 0);
    let decoded = out
        .get_mut(start..)
        .map_or(Ok(0), |room| block_into(data, room));
    out.truncate(start + *decoded.as_ref().unwrap_or(&0));
    decoded?;
    exactly(expected, &out[start..])
}

/// Decodes what numcodecs writes: the decoded size and one block.
pub(crate) fn lz4_sized(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    out.clear();
    let Some((size, block)) = data.split_first_chunk::<4>() else {
        return Err(CodecError::damaged(format!(
            "{} bytes found, at least the 4 of an LZ4 size expected",
            data.len()
        )));
    };
    let size = usize::try_from(u32::from_le_bytes(*size)).unwrap_or(usize::MAX);
    if size > most {
        return Err(too_much("LZ4", most));
    }
    lz4_block(block, size, out)
}

/// Decodes a stream of Java's `LZ4BlockOutputStream`.
pub(crate) fn lz4_java(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    const MAGIC: &[u8; 8] = b"LZ4Block";
    const HEADER: usize = 21;
    const SEED: u32 = 0x9747_b28c;
    out.clear();
    let mut rest = data;
    // A stream may end without the empty block, as Java's reader allows.
    while let Some((header, after)) = rest.split_first_chunk::<HEADER>() {
        if !header.starts_with(MAGIC) {
            return Err(CodecError::damaged(
                "a block does not begin with 'LZ4Block'",
            ));
        }
        let field = |at: usize| {
            u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
        };
        let (packed, size, sum) = (field(9) as usize, field(13) as usize, field(17));
        if size == 0 {
            return Ok(());
        }
        if size > most - out.len() {
            out.clear();
            return Err(too_much("LZ4", most));
        }
        let Some((block, behind)) = after.split_at_checked(packed) else {
            return Err(CodecError::damaged(format!(
                "a block of {packed} bytes is cut after {}",
                after.len()
            )));
        };
        let start = out.len();
        match header[8] & 0xf0 {
            0x10 => {
                exactly(size, block)?;
                out.extend_from_slice(block);
            }
            0x20 => append(block, size, out)?,
            method => {
                return Err(CodecError::damaged(format!(
                    "a block has the unknown method {method:#04x}"
                )));
            }
        }
        if XxHash32::oneshot(SEED, &out[start..]) & 0x0fff_ffff != sum {
            return Err(CodecError::damaged("a block has a wrong checksum"));
        }
        rest = behind;
    }
    if rest.is_empty() {
        return Ok(());
    }
    Err(CodecError::damaged(format!(
        "the header of a block is cut after {} of {HEADER} bytes",
        rest.len()
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn java_block(method: u8, packed: &[u8], decoded: &[u8]) -> Vec<u8> {
        let mut block = b"LZ4Block".to_vec();
        block.push(method | 5);
        block.extend((packed.len() as u32).to_le_bytes());
        block.extend((decoded.len() as u32).to_le_bytes());
        let sum = XxHash32::oneshot(0x9747_b28c, decoded) & 0x0fff_ffff;
        block.extend(sum.to_le_bytes());
        block.extend(packed);
        block
    }

    #[test]
    fn a_size_that_the_data_cannot_have_is_refused_before_it_is_allocated() {
        let mut out = Vec::new();
        let mut data = u32::MAX.to_le_bytes().to_vec();
        data.extend([0; 20]);
        assert!(lz4_sized(&data, usize::MAX, &mut out).is_err());
        assert_eq!(out.capacity(), 0);
    }

    #[test]
    fn java_streams_of_raw_and_packed_blocks_decode_and_wrong_sums_do_not() {
        let text = b"a surfel is a surfel is a surfel is a surfel is a surfel".to_vec();
        let packed = lz4_flex::block::compress(&text);
        let mut stream = java_block(0x20, &packed, &text);
        stream.extend(java_block(0x10, &text, &text));
        stream.extend(java_block(0x10, b"", b""));
        let mut out = Vec::new();
        lz4_java(&stream, 2 * text.len(), &mut out).unwrap();
        assert_eq!(out, [text.clone(), text.clone()].concat());
        assert!(lz4_java(&stream, 2 * text.len() - 1, &mut out).is_err());
        for at in 0..stream.len() {
            let mut damaged = stream.clone();
            damaged[at] ^= 0x40;
            let _ = lz4_java(&damaged, 2 * text.len(), &mut out);
            let _ = lz4_java(&stream[..at], 2 * text.len(), &mut out);
        }
        stream[17] ^= 1;
        assert!(lz4_java(&stream, 2 * text.len(), &mut out).is_err());
    }
}
