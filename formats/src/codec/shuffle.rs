//! Bytes and bits put in another order before compression, and put back here.
//!
//! A byte shuffle stores the first bytes of all elements, then the second bytes, and so on. A bit
//! shuffle does the same with bits: for each byte of an element and each bit of it, lowest first,
//! that bit of all elements, eight elements a byte. Bytes behind the last whole element stay.

/// Undoes a byte shuffle of elements of `element` bytes; the two slices are equally long.
pub(crate) fn unshuffle(element: usize, data: &[u8], out: &mut [u8]) {
    match element {
        0 | 1 => copy(data, out),
        2 => fixed::<2>(data, out),
        4 => fixed::<4>(data, out),
        8 => fixed::<8>(data, out),
        _ => any(element, data, out),
    }
}

/// Copies as much as both have.
fn copy(data: &[u8], out: &mut [u8]) {
    for (o, d) in out.iter_mut().zip(data) {
        *o = *d;
    }
}

fn any(element: usize, data: &[u8], out: &mut [u8]) {
    let count = data.len() / element;
    let whole = count * element;
    for (i, group) in out[..whole].chunks_exact_mut(element).enumerate() {
        for (j, byte) in group.iter_mut().enumerate() {
            *byte = data[j * count + i];
        }
    }
    copy(&data[whole..], &mut out[whole..]);
}

/// The sizes of numbers, with loops the compiler can unroll.
fn fixed<const N: usize>(data: &[u8], out: &mut [u8]) {
    let count = data.len() / N;
    let whole = count * N;
    let rows: [&[u8]; N] = std::array::from_fn(|j| &data[j * count..(j + 1) * count]);
    let (groups, _) = out[..whole].as_chunks_mut::<N>();
    for (i, group) in groups.iter_mut().enumerate().take(count) {
        *group = std::array::from_fn(|j| rows[j][i]);
    }
    copy(&data[whole..], &mut out[whole..]);
}

/// Undoes a bit shuffle of elements of `element` bytes, whose number is a multiple of eight; the
/// two slices are equally long.
pub(crate) fn unshuffle_bits(element: usize, data: &[u8], out: &mut [u8]) {
    let count = data.len() / element.max(1) / 8 * 8;
    let row = count / 8;
    let whole = count * element;
    for j in 0..element {
        let rows: [&[u8]; 8] =
            std::array::from_fn(|bit| &data[(8 * j + bit) * row..(8 * j + bit + 1) * row]);
        for i in 0..row {
            let bits = transposed(u64::from_le_bytes(std::array::from_fn(|bit| rows[bit][i])));
            let group = &mut out[8 * i * element..8 * (i + 1) * element];
            for (byte, value) in group
                .iter_mut()
                .skip(j)
                .step_by(element)
                .zip(bits.to_le_bytes())
            {
                *byte = value;
            }
        }
    }
    copy(&data[whole..], &mut out[whole..]);
}

/// Eight rows of eight bits become eight columns: the exchange of blocks of 1, 2 and 4.
fn transposed(mut x: u64) -> u64 {
    let swap = |x: u64, shift: u32, mask: u64| {
        let t = (x ^ (x >> shift)) & mask;
        x ^ t ^ (t << shift)
    };
    x = swap(x, 7, 0x00aa_00aa_00aa_00aa);
    x = swap(x, 14, 0x0000_cccc_0000_cccc);
    swap(x, 28, 0x0000_0000_f0f0_f0f0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(count: usize) -> Vec<u8> {
        (0..count).map(|i| (i * 37 + i / 251) as u8).collect()
    }

    #[test]
    fn bytes_come_back_in_their_order_for_every_size() {
        for element in 1..=17 {
            for count in [0, 1, 7, 8, 100, 1000] {
                let data = bytes(count);
                let elements = count / element;
                let mut shuffled = data.clone();
                for i in 0..elements {
                    for j in 0..element {
                        shuffled[j * elements + i] = data[i * element + j];
                    }
                }
                let mut out = vec![0; count];
                unshuffle(element, &shuffled, &mut out);
                assert_eq!(out, data, "{element} bytes, {count} in all");
            }
        }
    }

    #[test]
    fn bits_come_back_in_their_order_for_every_size() {
        for element in 1..=9 {
            for elements in [0, 8, 16, 80] {
                let count = elements * element;
                let data = bytes(count);
                let mut shuffled = vec![0; count];
                for i in 0..elements {
                    for bit in 0..8 * element {
                        let value = data[i * element + bit / 8] >> (bit % 8) & 1;
                        shuffled[bit * elements / 8 + i / 8] |= value << (i % 8);
                    }
                }
                let mut out = vec![0; count];
                unshuffle_bits(element, &shuffled, &mut out);
                assert_eq!(out, data, "{element} bytes, {elements} elements");
            }
        }
    }
}
