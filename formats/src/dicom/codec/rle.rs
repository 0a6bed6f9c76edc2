//! RLE Lossless (DICOM PS3.5, annex G): one PackBits segment a byte of the sample, the most
//! significant first.

use super::{CodecResult, Extents};

/// Replaces `out` by the samples of `data`, `sample_bytes` each, least significant byte first.
pub(in crate::dicom) fn decode(
    data: &[u8],
    extents: Extents,
    sample_bytes: usize,
    out: &mut Vec<u8>,
) -> CodecResult<()> {
    const HEADER_BYTES: usize = 64;
    let word = |i: usize| -> Option<usize> {
        let bytes = data.get(4 * i..4 * i + 4)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(bytes)).ok()
    };
    if data.len() < HEADER_BYTES {
        return Err(format!(
            "the RLE header ends early: {} bytes found, {HEADER_BYTES} expected",
            data.len()
        ));
    }
    let segments = word(0).unwrap_or(0);
    if segments != sample_bytes {
        return Err(format!(
            "{segments} RLE segments found, {sample_bytes} expected"
        ));
    }
    let samples = extents.samples();
    out.clear();
    out.try_reserve_exact(samples * sample_bytes)
        .map_err(|_| "the frame does not fit memory".to_string())?;
    out.resize(samples * sample_bytes, 0);
    for segment in 0..segments {
        let start = word(1 + segment).unwrap_or(0);
        // The last segment ends with the data; offsets need not rise in damaged files.
        let end = (segment + 1 < segments)
            .then(|| word(2 + segment))
            .flatten()
            .unwrap_or(data.len());
        let bytes = data
            .get(start..end)
            .filter(|_| start >= HEADER_BYTES)
            .ok_or_else(|| {
                format!(
                    "RLE segment {segment} is said to be at {start}..{end} of {} bytes",
                    data.len()
                )
            })?;
        let byte = sample_bytes - 1 - segment;
        let found = unpack(
            bytes,
            out.iter_mut()
                .skip(byte)
                .step_by(sample_bytes)
                .take(samples),
        );
        if found < samples {
            return Err(format!(
                "RLE segment {segment} ends early: {found} bytes of {samples}"
            ));
        }
    }
    Ok(())
}

/// Unpacks PackBits into the bytes of `out`, and gives how many were filled.
fn unpack<'a>(mut data: &[u8], mut out: impl Iterator<Item = &'a mut u8>) -> usize {
    let mut filled = 0;
    while let Some((&control, rest)) = data.split_first() {
        data = rest;
        let control = control.cast_signed();
        if control >= 0 {
            let count = (control as usize + 1).min(data.len());
            let (literal, rest) = data.split_at(count);
            data = rest;
            for &value in literal {
                let Some(to) = out.next() else { return filled };
                *to = value;
                filled += 1;
            }
        } else if control != i8::MIN {
            let Some((&value, rest)) = data.split_first() else {
                return filled;
            };
            data = rest;
            for _ in 0..1 - i32::from(control) {
                let Some(to) = out.next() else { return filled };
                *to = value;
                filled += 1;
            }
        }
    }
    filled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_and_literals_fill_the_bytes_of_samples() {
        let mut data = vec![0; 64];
        data[0] = 2;
        data[4] = 64;
        data[8] = 66;
        // High bytes: a run of four ones. Low bytes: two literals, a no-op, a run of two.
        data.extend([0xfd, 1, 1, 10, 11, 0x80, 0xff, 12]);
        let extents = Extents {
            columns: 2,
            rows: 2,
        };
        let mut out = vec![9; 3];
        decode(&data, extents, 2, &mut out).unwrap();
        assert_eq!(out, [10, 1, 11, 1, 12, 1, 12, 1]);
        data.truncate(71);
        assert!(decode(&data, extents, 2, &mut out).is_err());
        data[8] = 200;
        assert!(decode(&data, extents, 2, &mut out).is_err());
        assert!(decode(&data, extents, 1, &mut out).is_err());
        assert!(decode(&data[..63], extents, 2, &mut out).is_err());
    }
}
