//! PNG files: 8-bit RGB, one IDAT chunk.
//!
//! Each row takes the filter whose bytes have the least sum of magnitudes, the heuristic that the
//! PNG specification recommends (section 12.7 of the third edition).

use std::io::{self, Write};

use flate2::write::ZlibEncoder;
use flate2::{Compression, Crc};

use super::image::Image;

const SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
const BYTES_PER_PIXEL: usize = 3;

impl Image {
    /// The bytes of a PNG file.
    ///
    /// # Errors
    ///
    /// If the picture has no pixels or is too large for the format.
    pub fn to_png(&self) -> io::Result<Vec<u8>> {
        let too_large = |_| io::Error::new(io::ErrorKind::InvalidInput, "too large for PNG");
        let [width, height] = self.size();
        if width == 0 || height == 0 {
            let kind = io::ErrorKind::InvalidInput;
            return Err(io::Error::new(kind, "a picture without pixels"));
        }
        let mut header = Vec::new();
        for length in [width, height] {
            // The format reserves the sign bit.
            let length = i32::try_from(length).map_err(too_large)?;
            header.extend(length.to_be_bytes());
        }
        // 8 bits, RGB, deflate, the five filters, not interlaced.
        header.extend([8, 2, 0, 0, 0]);

        let mut compressed = ZlibEncoder::new(Vec::new(), Compression::best());
        let mut above = vec![0; width * BYTES_PER_PIXEL];
        for y in 0..height {
            let row = self.row(y).as_flattened();
            compressed.write_all(&filtered(row, &above))?;
            above.copy_from_slice(row);
        }

        let mut file = SIGNATURE.to_vec();
        for (kind, data) in [
            (b"IHDR", header),
            (b"IDAT", compressed.finish()?),
            (b"IEND", Vec::new()),
        ] {
            let length = i32::try_from(data.len()).map_err(too_large)?;
            file.extend(length.to_be_bytes());
            let mut crc = Crc::new();
            for bytes in [kind.as_slice(), &data] {
                crc.update(bytes);
                file.extend_from_slice(bytes);
            }
            file.extend(crc.sum().to_be_bytes());
        }
        Ok(file)
    }
}

/// A row as it is compressed: the number of its filter, then the filtered bytes.
fn filtered(row: &[u8], above: &[u8]) -> Vec<u8> {
    let mut best = (u64::MAX, Vec::new());
    for filter in 0..=4 {
        let mut bytes = Vec::with_capacity(row.len() + 1);
        bytes.push(filter);
        bytes.extend((0..row.len()).map(|i| {
            let [left, upper_left] = match i.checked_sub(BYTES_PER_PIXEL) {
                Some(j) => [row[j], above[j]],
                None => [0, 0],
            };
            row[i].wrapping_sub(predicted(filter, left, above[i], upper_left))
        }));
        let magnitudes = bytes[1..]
            .iter()
            .map(|&b| u64::from(b.min(b.wrapping_neg())));
        let sum = magnitudes.sum();
        if sum < best.0 {
            best = (sum, bytes);
        }
    }
    best.1
}

/// What a filter expects of a byte, from those before it (section 9.2 of the specification).
pub(super) fn predicted(filter: u8, left: u8, above: u8, upper_left: u8) -> u8 {
    match filter {
        0 => 0,
        1 => left,
        2 => above,
        3 => left.midpoint(above),
        _ => {
            let [a, b, c] = [left, above, upper_left].map(i16::from);
            let distance = |x: i16| (a + b - c - x).abs();
            if distance(a) <= distance(b) && distance(a) <= distance(c) {
                left
            } else if distance(b) <= distance(c) {
                above
            } else {
                upper_left
            }
        }
    }
}
