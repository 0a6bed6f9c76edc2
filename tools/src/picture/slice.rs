//! The preview of a curvature slice, enlarged.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, read};

use super::image::{Image, srgb};

/// Most pixels along a side of a slice.
const LARGEST: usize = 1 << 14;

/// The R, G, B preview of an EXR slice, each of its pixels a square of whole pixels; the longer
/// side has `size` pixels or a little less, or those of the slice if it has more.
///
/// # Errors
///
/// If the file is no whole EXR image with R, G and B, or is larger than 16384 pixels.
pub fn slice_preview(path: &Path, size: u32) -> Result<Image> {
    let place = || path.display().to_string();
    // Looked at first, so that no size is believed before it is checked.
    let meta = MetaData::read_from_file(path, false).with_context(place)?;
    let header = meta.headers.first().with_context(place)?;
    let [width, height] = [header.layer_size.x(), header.layer_size.y()];
    ensure!(
        width.max(height) <= LARGEST,
        "{}: found {width} x {height} pixels, expected at most {LARGEST} along a side",
        place()
    );
    let factor = (usize::try_from(size)? / width.max(height).max(1)).max(1);
    let found = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            move |size, _| Image::white([size.x() * factor, size.y() * factor]),
            move |image, at, (r, g, b): (f32, f32, f32)| {
                let corner = [at.x() * factor, at.y() * factor];
                image.fill(corner, [factor; 2], srgb([r, g, b]));
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .with_context(place)?;
    Ok(found.layer_data.channel_data.pixels)
}
