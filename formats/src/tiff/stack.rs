//! How the pages of a file are planes of volumes, by what its writer noted.
//!
//! In: the description of the first page and the number of pages. Out: a [`Stack`]: how many
//! channels, planes and points in time there are, in which order, and what is known of space.
//! Understood are the notes of ImageJ, of `tifffile` (an array's shape) and of Zeiss LSM; OME has
//! a module of its own. Without notes the pages are the planes, in order.

use super::ifd::{Ifd, Tiff, tag};
use super::units;
use crate::error::Error;
use crate::header::{Scaling, Unit};
use crate::parsed::is_plausible_spacing;

/// What the pages of a file make up.
#[derive(Debug, Default)]
pub(super) struct Stack {
    /// Who wrote the notes that were followed; empty without notes.
    pub(super) kind: &'static str,
    pub(super) channels: u64,
    pub(super) slices: u64,
    pub(super) frames: u64,
    /// Steps from a plane to that of the next channel, slice and frame.
    pub(super) strides: [u64; 3],
    /// One directory stands for all planes, which lie one behind the other.
    pub(super) contiguous: bool,
    /// A palette only says how values are shown.
    pub(super) palette_is_display: bool,
    pub(super) spacing: Option<[f64; 3]>,
    /// The distance of planes was noted, not taken for 1.
    pub(super) depth_is_noted: bool,
    pub(super) unit: Unit,
    pub(super) scaling: Option<Scaling>,
    pub(super) warnings: Vec<String>,
}

impl Stack {
    /// Planes in order: `strides` follow from the order of the axes.
    fn new(kind: &'static str, [channels, slices, frames]: [u64; 3], strides: [u64; 3]) -> Self {
        Self {
            kind,
            channels,
            slices,
            frames,
            strides,
            ..Self::default()
        }
    }

    /// All pages as the planes of one volume.
    fn plain(pages: u64) -> Self {
        Self::new("", [1, pages, 1], [pages, 1, pages])
    }

    /// The number of planes of all channels and frames, if it can be one.
    fn planes(&self) -> Option<u64> {
        self.channels
            .checked_mul(self.slices)?
            .checked_mul(self.frames)
    }
}

/// What the notes of a file with `pages` pages say; the first of them is `ifd`.
pub(super) fn read(tiff: &Tiff, ifd: &Ifd, pages: u64, extents: [u64; 2]) -> Result<Stack, Error> {
    let text = tiff.text(ifd, tag::DESCRIPTION)?.unwrap_or_default();
    if text.starts_with(b"ImageJ=") {
        // Written as Latin-1 by old versions; what is needed of it is ASCII.
        return imagej(tiff, ifd, pages, &String::from_utf8_lossy(&text));
    }
    if let Some(entry) = ifd.entry(tag::LSM_INFO) {
        return lsm(tiff, &tiff.raw(entry)?, pages, extents);
    }
    if let Some(entry) = ifd.entry(tag::UIC2)
        && entry.count > 1
        && pages == 1
    {
        return Err(Error::unsupported(
            tiff.name(),
            format!(
                "is a MetaMorph stack (STK) of {} planes, which is not read: save it as TIFF \
                 with ImageJ",
                entry.count
            ),
        ));
    }
    let mut stack = shaped(&text, pages, extents).unwrap_or_else(|| Stack::plain(pages));
    stack.warnings.extend(resolution_note(tiff, ifd)?);
    Ok(stack)
}

/// Edge lengths of a pixel by the resolution entries, in the unit the file means.
fn pixel(tiff: &Tiff, ifd: &Ifd) -> Result<Option<[f64; 2]>, Error> {
    let edge = |tag| -> Result<Option<f64>, Error> {
        let ratio = tiff.rational(ifd, tag)?;
        Ok(ratio
            .map(|(above, below)| below / above)
            .filter(|s| is_plausible_spacing(*s)))
    };
    let x = edge(tag::X_RESOLUTION)?;
    let y = edge(tag::Y_RESOLUTION)?;
    Ok(x.zip(y).map(|(x, y)| [x, y]))
}

/// What to tell of the resolution entries of a plain file, which do not say how far planes are
/// apart.
fn resolution_note(tiff: &Tiff, ifd: &Ifd) -> Result<Option<String>, Error> {
    let factor = match tiff.first(ifd, tag::RESOLUTION_UNIT)? {
        Some(2) => 25.4,
        Some(3) => 10.0,
        _ => return Ok(None),
    };
    let Some([x, y]) = pixel(tiff, ifd)? else {
        return Ok(None);
    };
    let [x, y] = [x * factor, y * factor];
    Ok(Some(format!(
        "{}: pixels are {} x {} mm by the resolution entries, but how far planes are apart is not \
         said: lengths are in voxels unless --spacing is given",
        tiff.name(),
        rounded(x),
        rounded(y)
    )))
}

/// Six digits are enough to read.
fn rounded(length: f64) -> f64 {
    format!("{length:.5e}").parse().unwrap_or(length)
}

/// The notes of ImageJ: lines of `key=value`.
fn imagej(tiff: &Tiff, ifd: &Ifd, pages: u64, text: &str) -> Result<Stack, Error> {
    let value = |key: &str| {
        text.lines()
            .filter_map(|line| line.split_once('='))
            .find(|(name, _)| *name == key)
            .map(|(_, value)| value.trim())
    };
    let number =
        |key: &str| -> Option<f64> { value(key)?.parse().ok().filter(|n: &f64| n.is_finite()) };
    let bad = |what: String| {
        Error::invalid(tiff.name(), format!("the ImageJ description {what}")).at(ifd.at)
    };
    let count = |key: &str| -> Result<Option<u64>, Error> {
        match value(key) {
            None => Ok(None),
            Some(text) => match text.parse::<u64>() {
                Ok(n) if n > 0 => Ok(Some(n)),
                _ => Err(bad(format!("says {key}={text}, expected a count"))),
            },
        }
    };
    let images = count("images")?.unwrap_or(1);
    let (channels, frames) = (
        count("channels")?.unwrap_or(1),
        count("frames")?.unwrap_or(1),
    );
    let slices = match count("slices")? {
        Some(n) => n,
        None if channels == 1 && frames == 1 => images,
        None => 1,
    };
    // Channels fastest, then slices, then frames.
    let all = channels.saturating_mul(slices);
    let mut stack = Stack::new("ImageJ", [channels, slices, frames], [1, channels, all]);
    if stack.planes() != Some(images) {
        return Err(bad(format!(
            "says {images} images, but {channels} channels, {slices} slices and {frames} frames"
        )));
    }
    if pages != images && pages != 1 {
        return Err(bad(format!(
            "says {images} images, but the file has {pages} pages"
        )));
    }
    stack.contiguous = pages != images;
    stack.palette_is_display = true;
    if slices == 1 && channels == 1 && frames > 1 {
        (stack.slices, stack.frames) = (frames, 1);
        stack.strides = [1, 1, frames];
        stack.warnings.push(format!(
            "{}: ImageJ notes {frames} frames of one slice; they are read as {frames} planes",
            tiff.name()
        ));
    }
    imagej_space(
        tiff,
        ifd,
        &mut stack,
        value("unit").map(unescaped),
        number("spacing"),
    )?;
    imagej_values(tiff, &mut stack, value("cf"), number("c0"), number("c1"));
    Ok(stack)
}

/// Spacing as ImageJ takes it: pixels by the resolution entries, planes by its own line.
fn imagej_space(
    tiff: &Tiff,
    ifd: &Ifd,
    stack: &mut Stack,
    unit: Option<String>,
    depth: Option<f64>,
) -> Result<(), Error> {
    let depth = depth.map(f64::abs).filter(|s| is_plausible_spacing(*s));
    let pixel = pixel(tiff, ifd)?;
    let known = unit.as_deref().and_then(units::length);
    if known.is_none() && depth.is_none() && pixel.is_none_or(|[x, y]| x == 1.0 && y == 1.0) {
        return Ok(());
    }
    let [x, y] = pixel.unwrap_or([1.0; 2]);
    let (unit, factor) = known.unwrap_or((Unit::Unknown, 1.0));
    stack.unit = unit;
    stack.depth_is_noted = depth.is_some();
    // ImageJ leaves a depth of 1 out.
    stack.spacing = Some([x, y, depth.unwrap_or(1.0)].map(|s| s * factor));
    if depth.is_none() && stack.planes() > Some(1) {
        stack.warnings.push(format!(
            "{}: ImageJ notes no distance of the planes, and means 1 {} by that",
            tiff.name(),
            match (unit, factor) {
                (Unit::Unknown, _) => "unit",
                (unit, 1.0) => unit.symbol(),
                _ => "inch",
            }
        ));
    }
    Ok(())
}

/// Calibrated values: a straight line, as signed 16 bits are stored, or something else.
fn imagej_values(
    tiff: &Tiff,
    stack: &mut Stack,
    function: Option<&str>,
    c0: Option<f64>,
    c1: Option<f64>,
) {
    match (function, c0, c1) {
        (None, ..) => {}
        (Some("0"), Some(intercept), Some(slope)) if slope != 0.0 => {
            if (slope, intercept) != (1.0, 0.0) {
                stack.scaling = Some(Scaling { slope, intercept });
            }
        }
        (Some(function), ..) => stack.warnings.push(format!(
            "{}: ImageJ notes a calibration of values (function {function}) that is not a \
             straight line; values are as stored",
            tiff.name()
        )),
    }
}

/// Text with escapes such as `\u00B5` resolved.
fn unescaped(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some((before, behind)) = rest.split_once("\\u") {
        out.push_str(before);
        let code = behind
            .get(..4)
            .and_then(|hex| u32::from_str_radix(hex, 16).ok());
        match code.and_then(char::from_u32) {
            Some(c) => {
                out.push(c);
                rest = &behind[4..];
            }
            None => {
                out.push_str("\\u");
                rest = behind;
            }
        }
    }
    out.push_str(rest);
    out
}

/// The notes of `tifffile`: the shape of the array, slowest axis first.
fn shaped(text: &[u8], pages: u64, extents: [u64; 2]) -> Option<Stack> {
    let list = std::str::from_utf8(text.strip_prefix(b"{\"shape\": [")?).ok()?;
    let (list, rest) = list.split_once(']')?;
    let shape: Vec<u64> = list
        .split(',')
        .map(|n| n.trim().parse().ok())
        .collect::<Option<_>>()?;
    let [x, y] = extents;
    // A last axis may be samples of a pixel.
    let planes = match shape.as_slice() {
        [planes @ .., a, b] if [*a, *b] == [y, x] => planes,
        [planes @ .., a, b, _] if [*a, *b] == [y, x] => planes,
        _ => return None,
    };
    let (slices, frames) = planes.split_last()?;
    let frames = frames.iter().try_fold(1_u64, |n, k| n.checked_mul(*k))?;
    let count = slices.checked_mul(frames)?;
    let contiguous = pages == 1 && count > 1 && rest.contains("\"truncated\": true");
    if count != pages && !contiguous {
        return None;
    }
    let mut stack = Stack::new("", [1, *slices, frames], [count, 1, *slices]);
    stack.contiguous = contiguous;
    Some(stack)
}

/// The notes of Zeiss LSM: sizes along the axes, and of a voxel in metres.
fn lsm(tiff: &Tiff, info: &[u8], pages: u64, extents: [u64; 2]) -> Result<Stack, Error> {
    let bytes = |at: usize, n: usize| info.get(at..at + n).unwrap_or(&[]);
    let int = |at: usize| super::ifd::number(tiff.order, bytes(at, 4));
    let metres = |at: usize| f64::from_bits(super::ifd::number(tiff.order, bytes(at, 8)));
    let (x, y, slices, frames) = (int(8), int(12), int(16), int(24));
    if tiff.bytes.len() > u64::from(u32::MAX) {
        return Err(Error::unsupported(
            tiff.name(),
            "is an LSM file above 4 GB, whose offsets have wrapped round: save it as OME-TIFF",
        ));
    }
    if [x, y] != extents || slices.checked_mul(frames) != Some(pages) {
        return Err(Error::unsupported(
            tiff.name(),
            format!(
                "is an LSM file of {x} x {y} x {slices} voxels and {frames} points in time, which \
                 are not its {pages} pages of {} x {} pixels: save it as OME-TIFF",
                extents[0], extents[1]
            ),
        ));
    }
    let mut stack = Stack::new("Zeiss LSM", [1, slices, frames], [pages, 1, slices]);
    let spacing = [40, 48, 56].map(|at| metres(at) * 1e6);
    if spacing.iter().all(|s| is_plausible_spacing(*s)) {
        stack.spacing = Some(spacing);
        stack.unit = Unit::Micrometre;
    }
    Ok(stack)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_become_letters_and_others_stay() {
        assert_eq!(unescaped("\\u00B5m"), "\u{b5}m");
        assert_eq!(unescaped("a\\u12 \\uD800 \\u"), "a\\u12 \\uD800 \\u");
    }

    #[test]
    fn a_shape_with_more_axes_is_several_volumes() {
        let text = b"{\"shape\": [2, 3, 4, 5, 6]}";
        let stack = shaped(text, 24, [6, 5]).unwrap();
        assert_eq!((stack.slices, stack.frames, stack.strides[2]), (4, 6, 4));
        assert!(shaped(text, 23, [6, 5]).is_none());
        assert!(shaped(text, 1, [6, 5]).is_none());
        let text = b"{\"shape\": [4, 5, 6], \"truncated\": true}";
        assert!(shaped(text, 1, [6, 5]).unwrap().contiguous);
        let text = b"{\"shape\": [4, 5, 6, 3]}";
        assert_eq!(shaped(text, 4, [6, 5]).unwrap().slices, 4);
    }
}
