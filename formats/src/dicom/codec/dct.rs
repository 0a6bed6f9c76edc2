//! JPEG by sequential DCT (ITU-T T.81, annexes A, F): one component of 8 or 12 bits.
//!
//! The inverse transform is computed in single precision and rounded once, so samples differ
//! from those of other decoders by at most one: the process is lossy, and no decoder's samples
//! are the right ones.

use super::jpeg::{Bits, Huffman, be16};
use super::{CodecResult, Extents, ends_early, reserve};

/// Row and column of the coefficients in the order they are stored: index 8 * row + column.
const ZIGZAG: [u8; 64] = [
    0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20,
    13, 6, 7, 14, 21, 28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51, 58, 59,
    52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63,
];

/// Reads the tables of a DQT segment.
pub(super) fn read_quantization(
    mut segment: &[u8],
    tables: &mut [Option<[u16; 64]>; 4],
) -> CodecResult<()> {
    while let Some((&kind, rest)) = segment.split_first() {
        let wide = kind >> 4 != 0;
        let bytes = if wide { 128 } else { 64 };
        let values = rest.get(..bytes).ok_or("a quantization table ends early")?;
        segment = &rest[bytes..];
        let mut table = [0; 64];
        for (i, step) in table.iter_mut().enumerate() {
            *step = if wide {
                be16(values, 2 * i)?
            } else {
                values[i].into()
            };
        }
        *tables
            .get_mut(usize::from(kind & 15))
            .ok_or("a quantization table has a number above 3")? = Some(table);
    }
    Ok(())
}

/// Replaces `out` by the samples of a scan.
pub(super) fn decode(
    bits: &mut Bits<'_>,
    dc: &Huffman,
    ac: &Huffman,
    steps: &[u16; 64],
    precision: u8,
    restart: usize,
    extents: Extents,
    out: &mut Vec<u16>,
) -> CodecResult<()> {
    let Extents { columns, rows } = extents;
    reserve(out, extents.samples())?;
    out.resize(extents.samples(), 0);
    let cosines = cosines();
    let (middle, most) = (
        (1_i32 << (precision - 1)) as f32,
        ((1_i32 << precision) - 1) as f32,
    );
    let across = columns.div_ceil(8);
    let blocks = across * rows.div_ceil(8);
    let mut last = 0_i32;
    for block in 0..blocks {
        if restart > 0 && block > 0 && block % restart == 0 {
            bits.restart()?;
            last = 0;
        }
        let (x, y) = (block % across * 8, block / across * 8);
        let early = || ends_early(y * columns + x, extents.samples());
        let mut coefficients = [0.0_f32; 64];
        let size = dc.next(bits).ok_or_else(early)?;
        if size > 15 {
            return Err("a DC difference has more than 15 bits".into());
        }
        last = last.wrapping_add(bits.difference(size).ok_or_else(early)?);
        coefficients[0] = last as f32 * f32::from(steps[0]);
        let mut k = 1;
        while k < 64 {
            let symbol = ac.next(bits).ok_or_else(early)?;
            let (run, size) = (usize::from(symbol >> 4), symbol & 15);
            if size == 0 {
                if run < 15 {
                    break;
                }
                k += 16;
                continue;
            }
            k += run;
            let value = bits.difference(size).ok_or_else(early)?;
            let (Some(&to), Some(&step)) = (ZIGZAG.get(k), steps.get(k)) else {
                return Err("a JPEG block has more than 64 coefficients".into());
            };
            coefficients[usize::from(to)] = value as f32 * f32::from(step);
            k += 1;
        }
        let samples = inverse(&coefficients, &cosines);
        for (row, from) in samples.chunks_exact(8).enumerate().take(rows - y) {
            let start = (y + row) * columns + x;
            let width = (columns - x).min(8);
            for (to, &value) in out[start..start + width].iter_mut().zip(from) {
                *to = (value + middle).round().clamp(0.0, most) as u16;
            }
        }
    }
    Ok(())
}

/// `cosines[x][u]` = C(u) / 2 * cos((2 x + 1) u pi / 16) (A.3.3).
fn cosines() -> [[f32; 8]; 8] {
    let mut table = [[0.0; 8]; 8];
    for (x, row) in table.iter_mut().enumerate() {
        for (u, value) in row.iter_mut().enumerate() {
            let scale = if u == 0 {
                std::f64::consts::FRAC_1_SQRT_2
            } else {
                1.0
            };
            let angle = (2 * x + 1) as f64 * u as f64 * std::f64::consts::PI / 16.0;
            *value = (scale / 2.0 * angle.cos()) as f32;
        }
    }
    table
}

/// The inverse transform, rows and then columns.
fn inverse(coefficients: &[f32; 64], cosines: &[[f32; 8]; 8]) -> [f32; 64] {
    let mut rows = [0.0_f32; 64];
    for v in 0..8 {
        let from = &coefficients[8 * v..8 * v + 8];
        if from.iter().all(|&c| c == 0.0) {
            continue;
        }
        for x in 0..8 {
            rows[8 * v + x] = from.iter().zip(&cosines[x]).map(|(a, b)| a * b).sum();
        }
    }
    let mut samples = [0.0_f32; 64];
    for y in 0..8 {
        for v in 0..8 {
            let weight = cosines[y][v];
            for x in 0..8 {
                samples[8 * y + x] += weight * rows[8 * v + x];
            }
        }
    }
    samples
}
