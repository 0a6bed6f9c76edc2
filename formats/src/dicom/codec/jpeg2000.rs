//! JPEG 2000 (ITU-T T.800), by crate `hayro-jpeg2000`: pure Rust without `unsafe`.
//!
//! The crate allocates what the codestream's headers ask for. So these are read here first, and
//! extents, components, tiles and precincts are bounded by the frame before it is called.
//! Samples come as single precision numbers, which are exact for the 16 bits read here.

use hayro_jpeg2000::{DecodeSettings, DecoderContext, Image};

use super::{CodecResult, Extents, reserve};

/// Replaces `out` by the samples of `data`, and gives their precision in bits: 16 for signed
/// samples, which come in two's complement.
pub(in crate::dicom) fn decode(
    data: &[u8],
    extents: Extents,
    out: &mut Vec<u16>,
) -> CodecResult<u8> {
    let size = check_headers(data, extents)?;
    let settings = DecodeSettings {
        resolve_palette_indices: false,
        strict: true,
        target_resolution: None,
    };
    let failed = |e| format!("the JPEG 2000 data is damaged: {e}");
    let image = Image::new(data, &settings).map_err(failed)?;
    let mut context = DecoderContext::default();
    let decoded = image.decode(&mut context).map_err(failed)?;
    let [component] = decoded.components() else {
        return Err(format!(
            "the compressed image has {} components, 1 expected",
            decoded.components().len()
        ));
    };
    extents.check(image.width() as usize, image.height() as usize)?;
    let samples = component.samples();
    if samples.len() < extents.samples() {
        return Err(super::ends_early(samples.len(), extents.samples()));
    }
    // The crate moves signed samples up as if they were unsigned.
    let down = if size.signed {
        1_i32 << (size.precision - 1)
    } else {
        0
    };
    let most = f32::from(u16::MAX >> (16 - size.precision));
    reserve(out, extents.samples())?;
    let samples = samples.iter().take(extents.samples());
    out.extend(samples.map(|&value| (value.round().clamp(0.0, most) as i32 - down) as u16));
    Ok(if size.signed { 16 } else { size.precision })
}

struct Size {
    precision: u8,
    signed: bool,
}

/// Reads the main header and refuses what would cost more than the frame is worth.
fn check_headers(data: &[u8], extents: Extents) -> CodecResult<Size> {
    const SIZ: u16 = 0xff51;
    const COD: u16 = 0xff52;
    const COC: u16 = 0xff53;
    const SOT: u16 = 0xff90;
    /// More tiles than this are refused; each costs some hundred bytes beside its samples.
    const MOST_TILES: u64 = 1 << 14;
    if !data.starts_with(&[0xff, 0x4f]) {
        return Err("not a JPEG 2000 codestream: it does not begin with FF 4F".into());
    }
    let early = || "the JPEG 2000 header ends early".to_string();
    let be16 = |at: usize| -> CodecResult<u16> {
        let bytes = data.get(at..at + 2).and_then(|b| b.try_into().ok());
        bytes.map(u16::from_be_bytes).ok_or_else(early)
    };
    let be32 = |at: usize| -> CodecResult<u64> {
        Ok((u64::from(be16(at)?) << 16) | u64::from(be16(at + 2)?))
    };
    let mut found = None;
    let mut at = 2;
    loop {
        let marker = be16(at)?;
        if marker == SOT {
            break;
        }
        let length = usize::from(be16(at + 2)?);
        if length < 2 {
            return Err(early());
        }
        let body = at + 4;
        match marker {
            SIZ => {
                let [x1, y1, x0, y0] = [
                    be32(body + 2)?,
                    be32(body + 6)?,
                    be32(body + 10)?,
                    be32(body + 14)?,
                ];
                let [tile_x, tile_y] = [be32(body + 18)?, be32(body + 22)?];
                let components = be16(body + 34)?;
                if components != 1 {
                    return Err(format!(
                        "the compressed image has {components} components, 1 expected"
                    ));
                }
                let (Some(width), Some(height)) = (x1.checked_sub(x0), y1.checked_sub(y0)) else {
                    return Err("the JPEG 2000 image begins behind its end".into());
                };
                // Fits: both are at most 32 bits wide.
                extents.check(width as usize, height as usize)?;
                if tile_x == 0 || tile_y == 0 {
                    return Err("a JPEG 2000 tile has no extent".into());
                }
                // Offsets are at most as large as the grid, so this is an upper bound.
                let tiles = x1.div_ceil(tile_x).saturating_mul(y1.div_ceil(tile_y));
                if tiles > MOST_TILES {
                    return Err(format!(
                        "{tiles} JPEG 2000 tiles in one frame, at most {MOST_TILES} are read"
                    ));
                }
                let depth = *data.get(body + 36).ok_or_else(early)?;
                let precision = (depth & 0x7f) + 1;
                if precision > 16 {
                    return Err(format!(
                        "a JPEG 2000 precision of {precision} bits is not read, at most 16 are"
                    ));
                }
                found = Some(Size {
                    precision,
                    signed: depth & 0x80 != 0,
                });
            }
            COD => check_style(data, body, body + 5)?,
            COC => check_style(data, body + 1, body + 2)?,
            _ => {}
        }
        at += 2 + length;
    }
    found.ok_or_else(|| "the JPEG 2000 header has no size".into())
}

/// Checks the coding style whose flags are at `flags` and whose parameters begin at `style`.
fn check_style(data: &[u8], flags: usize, style: usize) -> CodecResult<()> {
    let early = || "the JPEG 2000 header ends early".to_string();
    let byte = |at: usize| data.get(at).copied().ok_or_else(early);
    let levels = byte(style)?;
    // Bit 6 of the block style: high-throughput block coding.
    if byte(style + 3)? & 0x40 != 0 {
        return Err("high-throughput JPEG 2000 is not read".into());
    }
    if byte(flags)? & 1 == 0 {
        return Ok(());
    }
    for level in 0..=usize::from(levels) {
        let exponents = byte(style + 5 + level)?;
        // Precincts of fewer samples than this cost more memory than the samples. The lowest
        // levels hold so few samples that their precincts do not matter.
        let (x, y) = (exponents & 15, exponents >> 4);
        if x + y < 6 && level + 3 > usize::from(levels) {
            return Err(format!(
                "JPEG 2000 precincts of 2^{x} x 2^{y} samples are not read"
            ));
        }
    }
    Ok(())
}
