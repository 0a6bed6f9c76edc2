//! Voxels written as text: numbers, or hexadecimal digits.
//!
//! In: an [`Input`] that stands at the first number. Out: an [`Input`] of the bytes of the voxels, numbers
//! as little-endian bytes of their type, digits as the bytes they are. Numbers are separated by blanks,
//! line ends or commas; digits may have blanks between them. Guaranteed: a number that its type cannot
//! hold, and text that is no number, are errors that name the place; memory is one buffer. What follows
//! the expected voxels is noted.

use std::io::{self, BufRead, Read};

use crate::header::VoxelType;
use crate::input::{Input, Layer, TextError};

/// How much is decoded at a time.
const STEP_BYTES: usize = 64 << 10;

/// `voxels` numbers of `input`, as voxels of a type.
pub(crate) fn numbers(input: Input, voxel: VoxelType, voxels: u64) -> Input {
    Input::over(Box::new(Text {
        input,
        left: voxels,
        decoded: Vec::new(),
        taken: 0,
        step: move |input: &mut Input, out: &mut Vec<u8>| number(input, voxel, out),
    }))
}

/// `bytes` bytes of `input`, written as two hexadecimal digits each.
pub(crate) fn hexadecimal(input: Input, bytes: u64) -> Input {
    Input::over(Box::new(Text {
        input,
        left: bytes,
        decoded: Vec::new(),
        taken: 0,
        step: byte,
    }))
}

/// A layer that decodes `left` values, each by one call of `step`, which says whether there was one.
struct Text<F> {
    input: Input,
    left: u64,
    decoded: Vec<u8>,
    taken: usize,
    step: F,
}

impl<F> Read for Text<F>
where
    F: FnMut(&mut Input, &mut Vec<u8>) -> io::Result<bool>,
{
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.taken == self.decoded.len() {
            self.decoded.clear();
            self.taken = 0;
            while self.left > 0 && self.decoded.len() < STEP_BYTES {
                if !(self.step)(&mut self.input, &mut self.decoded)? {
                    self.left = 0;
                    break;
                }
                self.left -= 1;
            }
        }
        let have = &self.decoded[self.taken..];
        let count = have.len().min(out.len());
        out[..count].copy_from_slice(&have[..count]);
        self.taken += count;
        Ok(count)
    }
}

impl<F> Layer for Text<F>
where
    F: FnMut(&mut Input, &mut Vec<u8>) -> io::Result<bool> + Send,
{
    fn notes(&mut self) -> Vec<String> {
        let mut notes = self.input.notes();
        if self.left == 0 && matches!(skip_separators(&mut self.input), Ok(Some(_))) {
            notes.push(format!(
                "text follows the last voxel at byte {}; it is ignored",
                self.input.position()
            ));
        }
        notes
    }
}

fn is_separator(byte: u8) -> bool {
    byte.is_ascii_whitespace() || byte == 0x0b || byte == b','
}

/// Passes separators and gives the byte behind them; `None` at the end.
fn skip_separators(input: &mut Input) -> io::Result<Option<u8>> {
    loop {
        let some = input.fill_buf()?;
        if some.is_empty() {
            return Ok(None);
        }
        match some.iter().position(|b| !is_separator(*b)) {
            Some(count) => {
                let byte = some[count];
                input.consume(count);
                return Ok(Some(byte));
            }
            None => {
                let count = some.len();
                input.consume(count);
            }
        }
    }
}

fn wrong(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, TextError(message))
}

/// Appends the bytes of the next number; false at the end.
fn number(input: &mut Input, voxel: VoxelType, out: &mut Vec<u8>) -> io::Result<bool> {
    /// The longest text of a number; a double printed with all its digits has 340.
    const NUMBER_MOST_BYTES: usize = 512;
    if skip_separators(input)?.is_none() {
        return Ok(false);
    }
    let at = input.position();
    let head = input.peek(NUMBER_MOST_BYTES)?;
    let end = head.iter().position(|b| is_separator(*b));
    let count = end.unwrap_or(head.len());
    let word = &head[..count];
    let shown = || word[..count.min(24)].escape_ascii();
    if end.is_none() && head.len() == NUMBER_MOST_BYTES {
        return Err(wrong(format!(
            "the number at byte {at} of the text is longer than {NUMBER_MOST_BYTES} letters: '{}...'",
            shown()
        )));
    }
    let text = std::str::from_utf8(word).unwrap_or("");
    if !append(text, voxel, out) {
        return Err(wrong(format!(
            "'{}' at byte {at} of the text is not a number that a voxel of type {voxel} can hold",
            shown()
        )));
    }
    input.consume(count);
    Ok(true)
}

/// Appends the bytes of the number in `text`; false if the type cannot hold it.
fn append(text: &str, voxel: VoxelType, out: &mut Vec<u8>) -> bool {
    fn put<const N: usize>(out: &mut Vec<u8>, bytes: Option<[u8; N]>) -> bool {
        bytes.is_some_and(|bytes| {
            out.extend_from_slice(&bytes);
            true
        })
    }
    match voxel {
        VoxelType::Bool => put(
            out,
            whole::<u8>(text).filter(|v| *v <= 1).map(u8::to_le_bytes),
        ),
        VoxelType::U8 => put(out, whole::<u8>(text).map(u8::to_le_bytes)),
        VoxelType::I8 => put(out, whole::<i8>(text).map(i8::to_le_bytes)),
        VoxelType::U16 => put(out, whole::<u16>(text).map(u16::to_le_bytes)),
        VoxelType::I16 => put(out, whole::<i16>(text).map(i16::to_le_bytes)),
        VoxelType::U32 => put(out, whole::<u32>(text).map(u32::to_le_bytes)),
        VoxelType::I32 => put(out, whole::<i32>(text).map(i32::to_le_bytes)),
        VoxelType::U64 => put(out, whole::<u64>(text).map(u64::to_le_bytes)),
        VoxelType::I64 => put(out, whole::<i64>(text).map(i64::to_le_bytes)),
        VoxelType::F32 => put(out, real(text, f32::is_infinite).map(f32::to_le_bytes)),
        VoxelType::F64 => put(out, real(text, f64::is_infinite).map(f64::to_le_bytes)),
        // No format writes it as text.
        VoxelType::F16 => false,
    }
}

/// A whole number, also as programs write it that know only real ones: 3.0, 1e3.
fn whole<T: std::str::FromStr + TryFrom<i64>>(text: &str) -> Option<T> {
    /// Up to here every whole number is a double.
    const EXACT: f64 = 9_007_199_254_740_992.0;
    if let Ok(number) = text.parse() {
        return Some(number);
    }
    let number: f64 = text.parse().ok()?;
    if number.fract() != 0.0 || number.abs() > EXACT {
        return None;
    }
    // Exact: it is whole and small.
    T::try_from(number as i64).ok()
}

/// A real number. One that is too large is infinite, which must be what the text says.
fn real<T: std::str::FromStr + Copy>(text: &str, is_infinite: fn(T) -> bool) -> Option<T> {
    let number: T = text.parse().ok()?;
    let said = text.trim_start_matches(['+', '-']).starts_with(['i', 'I']);
    (said || !is_infinite(number)).then_some(number)
}

/// Appends the next byte, written as two digits; false at the end.
fn byte(input: &mut Input, out: &mut Vec<u8>) -> io::Result<bool> {
    let mut value = 0;
    for digit in 0..2 {
        let Some(letter) = skip_separators(input)? else {
            if digit == 0 {
                return Ok(false);
            }
            return Err(wrong(format!(
                "the text ends at byte {} within a byte of two hexadecimal digits",
                input.position()
            )));
        };
        let Some(four_bits) = char::from(letter).to_digit(16) else {
            return Err(wrong(format!(
                "'{}' at byte {} of the text is not a hexadecimal digit",
                [letter].escape_ascii(),
                input.position()
            )));
        };
        value = value << 4 | four_bits as u8;
        input.consume(1);
    }
    out.push(value);
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, voxel: VoxelType, count: u64) -> Result<Vec<u8>, String> {
        let input = Input::new(io::Cursor::new(text.as_bytes().to_vec()));
        let mut bytes = Vec::new();
        numbers(input, voxel, count)
            .read_to_end(&mut bytes)
            .map_err(|e| e.to_string())?;
        Ok(bytes)
    }

    #[test]
    fn numbers_become_voxels_of_their_type() {
        assert_eq!(
            read("1 2\n3,4\r\n255 ", VoxelType::U8, 5),
            Ok(vec![1, 2, 3, 4, 255])
        );
        assert_eq!(
            read("-1 +2 3.0 1e2", VoxelType::I8, 4),
            Ok(vec![255, 2, 3, 100])
        );
        let floats = read("1.5 inf -Infinity 1e-50", VoxelType::F32, 4).unwrap();
        let values: Vec<_> = floats
            .chunks(4)
            .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
            .collect();
        assert_eq!(values, [1.5, f32::INFINITY, f32::NEG_INFINITY, 0.0]);
        let large = read("18446744073709551615", VoxelType::U64, 1).unwrap();
        assert_eq!(large, [255; 8]);
    }

    #[test]
    fn numbers_that_do_not_fit_are_named_with_their_place() {
        for (text, voxel) in [
            ("7 256", VoxelType::U8),
            ("7 -1", VoxelType::U8),
            ("7 1.5", VoxelType::I16),
            ("7 1e39", VoxelType::F32),
            ("7 1e400", VoxelType::F64),
            ("7 x", VoxelType::F64),
            ("7 nan", VoxelType::I32),
            ("7 9007199254740993.0", VoxelType::U32),
        ] {
            let message = read(text, voxel, 2).unwrap_err();
            assert!(message.contains("at byte 2 of the text"), "{message}");
        }
        assert!(read(&"1".repeat(600), VoxelType::F64, 1).is_err());
    }

    #[test]
    fn no_more_than_the_expected_numbers_are_read() {
        assert_eq!(read("1 2 3", VoxelType::U8, 2), Ok(vec![1, 2]));
        assert_eq!(read("1", VoxelType::U8, 2), Ok(vec![1]));
        let input = Input::new(io::Cursor::new(b"1 2 x".to_vec()));
        let mut input = numbers(input, VoxelType::U8, 2);
        assert_eq!(input.skip(9).unwrap(), 2);
        assert_eq!(input.notes().len(), 1);
    }

    #[test]
    fn digits_become_bytes() {
        let hex = |text: &str, count| {
            let input = Input::new(io::Cursor::new(text.as_bytes().to_vec()));
            let mut bytes = Vec::new();
            hexadecimal(input, count)
                .read_to_end(&mut bytes)
                .map_err(|e| e.to_string())?;
            Ok(bytes)
        };
        assert_eq!(hex("00fF\n7 f", 3), Ok(vec![0, 255, 127]));
        let message: Result<_, String> = hex("00f", 2);
        assert!(message.unwrap_err().contains("byte 3"));
        assert!(hex("0g", 1).unwrap_err().contains("byte 1"));
    }
}
