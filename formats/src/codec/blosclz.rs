//! BloscLZ, the compressor of Blosc's own: a descendant of FastLZ.
//!
//! A stream is a row of instructions. The upper three bits of its first byte are 0 for a run of
//! literals, whose length less one is in the lower five, or a match of 3 bytes and more further
//! back. A match has an 8-bit (with the lower five bits of the instruction 13-bit) distance,
//! and behind the largest one a distance of 16 bits more. The first instruction is always a run.

use super::CodecError;

/// The largest distance of the short form.
const SHORT_MOST: usize = 8191;

/// Decodes a stream into `out` and gives the number of bytes written.
pub(super) fn decode_into(data: &[u8], out: &mut [u8]) -> Result<usize, CodecError> {
    let mut rest = data;
    let mut written = 0_usize;
    let Some(first) = next(&mut rest) else {
        return Ok(0);
    };
    let mut instruction = usize::from(first & 31);
    loop {
        if instruction < 32 {
            let count = instruction + 1;
            let (literals, behind) = rest.split_at_checked(count).ok_or_else(cut)?;
            out.get_mut(written..written + count)
                .ok_or_else(too_long)?
                .copy_from_slice(literals);
            written += count;
            rest = behind;
        } else {
            let mut byte = || next(&mut rest).ok_or_else(cut);
            let mut count = (instruction >> 5) + 2;
            let mut distance = (instruction & 31) << 8;
            if instruction >> 5 == 7 {
                loop {
                    let more = byte()?;
                    count += usize::from(more);
                    if more != 255 {
                        break;
                    }
                }
            }
            let low = byte()?;
            if low == 255 && distance == 31 << 8 {
                let far = [byte()?, byte()?];
                distance = SHORT_MOST + usize::from(u16::from_be_bytes(far)) + 1;
            } else {
                distance += usize::from(low) + 1;
            }
            let from = written.checked_sub(distance).ok_or_else(|| {
                CodecError::damaged("the BloscLZ data refers to bytes before its beginning")
            })?;
            let room = out.get_mut(..written + count).ok_or_else(too_long)?;
            repeat(room, from, written);
            written += count;
        }
        match next(&mut rest) {
            Some(byte) => instruction = usize::from(byte),
            None => return Ok(written),
        }
    }
}

/// Takes the next byte.
fn next(rest: &mut &[u8]) -> Option<u8> {
    let (byte, behind) = rest.split_first()?;
    *rest = behind;
    Some(*byte)
}

/// Fills `out[to..]` by what begins at `from`, which may run into what is being filled.
fn repeat(out: &mut [u8], from: usize, to: usize) {
    let (count, mut done) = (out.len() - to, 0);
    // What is there doubles with every step.
    while done < count {
        let step = (to - from + done).min(count - done);
        out.copy_within(from..from + step, to + done);
        done += step;
    }
}

fn cut() -> CodecError {
    CodecError::damaged("the BloscLZ data ends early")
}

fn too_long() -> CodecError {
    CodecError::damaged("the BloscLZ data is longer than its block")
}
