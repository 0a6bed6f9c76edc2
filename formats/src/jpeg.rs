//! Grey JPEG images, as slices and as strips of TIFF.
//!
//! In: the bytes of a JPEG image. Out: its grey values, one byte each. By `zune-jpeg`: kept up,
//! no `unsafe` on this path, and in its strict mode a truncated scan is an error instead of a
//! grey area. Guaranteed: nothing is decoded before the image's own header states the extents
//! that were promised. Colour and arithmetic coding are refused. JPEG is lossy, so values may
//! differ by one from those of other decoders.

use std::io::{BufRead, Seek};

use zune_core::bytestream::{ZByteReaderTrait, ZCursor};
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// The bytes a JPEG image begins with.
pub(crate) const MAGIC: &[u8] = b"\xff\xd8\xff";

/// The most pixels that a byte can stand for: a block of 64 takes some bits at least.
pub(crate) const MOST: u64 = 4096;

fn decoder<T: ZByteReaderTrait>(data: T) -> Result<(JpegDecoder<T>, [u64; 2]), String> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX))
        .jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = JpegDecoder::new_with_options(data, options);
    decoder
        .decode_headers()
        .map_err(|e| format!("has a damaged JPEG header: {e}"))?;
    let info = decoder.info().ok_or("has no JPEG header")?;
    if info.components != 1 {
        return Err(format!(
            "is a colour JPEG ({} components), which is not read; convert it to grey",
            info.components
        ));
    }
    let extents = [u64::from(info.width), u64::from(info.height)];
    Ok((decoder, extents))
}

/// Width and height of an image that is known to be grey.
pub(crate) fn extents(data: impl BufRead + Seek) -> Result<[u64; 2], String> {
    decoder(data).map(|(_, extents)| extents)
}

/// Replaces `out` by the first `rows` rows of an image of `width` pixels and at most `most_rows`
/// rows.
pub(crate) fn grey(
    data: &[u8],
    width: u64,
    rows: u64,
    most_rows: u64,
    out: &mut Vec<u8>,
) -> Result<(), String> {
    let (mut decoder, [found_width, found_rows]) = decoder(ZCursor::new(data))?;
    if found_width != width || !(rows..=most_rows.max(rows)).contains(&found_rows) {
        return Err(format!(
            "holds a JPEG of {found_width} x {found_rows} pixels, {width} x {rows} expected"
        ));
    }
    out.clear();
    // Both are below 65536.
    out.resize((found_width * found_rows) as usize, 0);
    decoder
        .decode_into(out)
        .map_err(|e| format!("is damaged JPEG data: {e}"))?;
    out.truncate((width * rows) as usize);
    Ok(())
}
