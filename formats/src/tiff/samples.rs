//! From the bytes of a decompressed block to voxels.
//!
//! In: rows of samples as they lie in the file after decompression. Out: voxels of the type and
//! byte order that the header states. Three steps, in this order: the predictor is undone, packed
//! or interleaved samples are taken apart, and what counts white as 0 is turned round.

use super::page::{Layout, Predictor};
use crate::header::ByteOrder;

/// Turns whole rows of a block into voxels of one sample. `rows` holds `layout.row_bytes()` a row.
pub(super) fn to_voxels(rows: &mut Vec<u8>, layout: &Layout, order: ByteOrder, sample: u64) {
    // Fit: the bytes of a block were checked to.
    let row_bytes = layout.row_bytes() as usize;
    let interleaved = layout.interleaved() as usize;
    let sample_bytes = layout.bits / 8;
    match layout.predictor {
        Predictor::None => {}
        Predictor::Horizontal => {
            for row in rows.chunks_exact_mut(row_bytes) {
                match (sample_bytes, order) {
                    (1, _) => add_bytes(row, interleaved),
                    (2, ByteOrder::Little) => add(
                        row,
                        interleaved,
                        u16::from_le_bytes,
                        u16::to_le_bytes,
                        u16::wrapping_add,
                    ),
                    (2, ByteOrder::Big) => add(
                        row,
                        interleaved,
                        u16::from_be_bytes,
                        u16::to_be_bytes,
                        u16::wrapping_add,
                    ),
                    (4, ByteOrder::Little) => add(
                        row,
                        interleaved,
                        u32::from_le_bytes,
                        u32::to_le_bytes,
                        u32::wrapping_add,
                    ),
                    (4, ByteOrder::Big) => add(
                        row,
                        interleaved,
                        u32::from_be_bytes,
                        u32::to_be_bytes,
                        u32::wrapping_add,
                    ),
                    (_, ByteOrder::Little) => add(
                        row,
                        interleaved,
                        u64::from_le_bytes,
                        u64::to_le_bytes,
                        u64::wrapping_add,
                    ),
                    (_, ByteOrder::Big) => add(
                        row,
                        interleaved,
                        u64::from_be_bytes,
                        u64::to_be_bytes,
                        u64::wrapping_add,
                    ),
                }
            }
        }
        Predictor::Float => {
            let mut by_significance = Vec::new();
            for row in rows.chunks_exact_mut(row_bytes) {
                add_bytes(row, interleaved);
                by_significance.clear();
                by_significance.extend_from_slice(row);
                join_bytes(&by_significance, row, sample_bytes, order);
            }
        }
    }
    let voxel_bytes = layout.voxel.bytes();
    if layout.bits != voxel_bytes * 8 {
        *rows = unpack(
            rows,
            layout,
            order,
            if layout.planar { 0 } else { sample as usize },
        );
    } else if interleaved > 1 {
        pick(rows, interleaved, sample as usize, voxel_bytes);
    }
    if layout.inverted() {
        turn_round(rows, layout, order);
    }
}

/// Sums along a row, of samples of one byte.
fn add_bytes(row: &mut [u8], step: usize) {
    for i in step..row.len() {
        row[i] = row[i].wrapping_add(row[i - step]);
    }
}

/// Sums along a row, of samples of `N` bytes.
fn add<T: Copy, const N: usize>(
    row: &mut [u8],
    step: usize,
    read: impl Fn([u8; N]) -> T,
    write: impl Fn(T) -> [u8; N],
    sum: impl Fn(T, T) -> T,
) {
    let (samples, _) = row.as_chunks_mut::<N>();
    for i in step..samples.len() {
        samples[i] = write(sum(read(samples[i]), read(samples[i - step])));
    }
}

/// Puts numbers together whose bytes lie apart, all most significant ones first.
fn join_bytes(apart: &[u8], row: &mut [u8], sample_bytes: usize, order: ByteOrder) {
    let count = row.len() / sample_bytes;
    for (significance, bytes) in apart.chunks_exact(count).enumerate() {
        let at = match order {
            ByteOrder::Big => significance,
            ByteOrder::Little => sample_bytes - 1 - significance,
        };
        for (number, byte) in row.chunks_exact_mut(sample_bytes).zip(bytes) {
            number[at] = *byte;
        }
    }
}

/// Keeps one of the samples that lie side by side, in place.
fn pick(rows: &mut Vec<u8>, interleaved: usize, sample: usize, bytes: usize) {
    let pixels = rows.len() / (interleaved * bytes);
    for i in 0..pixels {
        let from = (i * interleaved + sample) * bytes;
        rows.copy_within(from..from + bytes, i * bytes);
    }
    rows.truncate(pixels * bytes);
}

/// Widens samples of fewer than 16 bits, packed with the highest bit first and each row on a
/// byte border, to one or two bytes.
fn unpack(rows: &[u8], layout: &Layout, order: ByteOrder, sample: usize) -> Vec<u8> {
    let (bits, interleaved) = (layout.bits, layout.interleaved() as usize);
    let width = layout.block[0] as usize;
    let row_bytes = layout.row_bytes() as usize;
    let mut out = Vec::with_capacity(rows.len() / row_bytes * width * layout.voxel.bytes());
    for row in rows.chunks_exact(row_bytes) {
        for x in 0..width {
            let start = (x * interleaved + sample) * bits;
            let (byte, shift) = (start / 8, start % 8);
            // A sample of at most 15 bits lies in at most three bytes.
            let three = (0..3).fold(0_u32, |n, i| {
                n << 8 | u32::from(row.get(byte + i).copied().unwrap_or(0))
            });
            let value = three >> (24 - shift - bits) & ((1 << bits) - 1);
            match (layout.voxel.bytes(), order) {
                (1, _) => out.push(value as u8),
                (_, ByteOrder::Little) => out.extend_from_slice(&(value as u16).to_le_bytes()),
                (_, ByteOrder::Big) => out.extend_from_slice(&(value as u16).to_be_bytes()),
            }
        }
    }
    out
}

/// Turns unsigned values round: the highest becomes 0.
fn turn_round(voxels: &mut [u8], layout: &Layout, order: ByteOrder) {
    let size = layout.voxel.bytes();
    let highest = u64::MAX >> (64 - layout.bits);
    let mut mask = [0; 8];
    match order {
        ByteOrder::Little => mask.copy_from_slice(&highest.to_le_bytes()),
        ByteOrder::Big => {
            mask.copy_from_slice(&highest.to_be_bytes());
            mask.rotate_left(8 - size);
        }
    }
    for voxel in voxels.chunks_exact_mut(size) {
        for (byte, mask) in voxel.iter_mut().zip(mask) {
            *byte ^= mask;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_lying_apart_are_joined_by_significance() {
        let apart = [1, 2, 10, 20, 100, 200, 3, 4];
        let mut row = [0; 8];
        join_bytes(&apart, &mut row, 4, ByteOrder::Big);
        assert_eq!(row, [1, 10, 100, 3, 2, 20, 200, 4]);
        join_bytes(&apart, &mut row, 4, ByteOrder::Little);
        assert_eq!(row, [3, 100, 10, 1, 4, 200, 20, 2]);
    }

    #[test]
    fn sums_wrap_and_keep_samples_apart() {
        let mut row = [250, 1, 10, 1, 10, 1];
        add_bytes(&mut row, 2);
        assert_eq!(row, [250, 1, 4, 2, 14, 3]);
        let mut row = [0xff, 0xff, 0, 2];
        add(
            &mut row,
            1,
            u16::from_be_bytes,
            u16::to_be_bytes,
            u16::wrapping_add,
        );
        assert_eq!(row, [0xff, 0xff, 0, 1]);
    }
}
