//! Slices that are PNG, JPEG or PGM images.
//!
//! In: files of one kind. Out: the volume of their grey values. PNG is by the crate `png`
//! (interlaced files, checksums, limits on memory), JPEG by `zune-jpeg`, PGM is a line of text and
//! plain bytes. Samples of 1, 2 and 4 bits become bytes; those of 16 bits stay in the order of
//! the file, most significant byte first. Colour, palettes and transparency are refused by name.
//! Guaranteed: an image is decoded only if its header still says what it said at first, and
//! nothing is taken for an image that its file is too short to hold.

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use png::{BitDepth, ColorType, Decoder, Limits, Transformations};

use super::names::file_name;
use crate::bytes::FileBytes;
use crate::chunked::{ChunkedVoxels, Chunks};
use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header, VoxelType};
use crate::input::DEFLATE_MOST;
use crate::jpeg;
use crate::map::Fingerprint;
use crate::options::{IoMode, OpenOptions};
use crate::volume::{SourceInfo, Volume, Voxels};

/// The bytes a PNG image begins with.
pub(super) const PNG_MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

/// What an image says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Facts {
    extents: [u64; 2],
    /// Bits of a sample.
    bits: u32,
}

impl Facts {
    fn voxel(self) -> VoxelType {
        match self.bits {
            1 => VoxelType::Bool,
            2..=8 => VoxelType::U8,
            _ => VoxelType::U16,
        }
    }

    fn in_words(self) -> String {
        let [x, y] = self.extents;
        format!("{x} x {y} pixels of {} bits", self.bits)
    }
}

/// A kind of image.
pub(super) trait Image: Send + Sync {
    /// Reads what comes before the pixels.
    fn examine(&self, file: File) -> Result<Facts, String>;

    /// Replaces `out` by the pixels of an image that is known to be as `facts` says.
    fn decode(&self, data: &[u8], facts: Facts, out: &mut Vec<u8>) -> Result<(), String>;

    /// The most bytes of pixels, packed as they are, that a byte of a file can stand for.
    fn most(&self) -> u64;

    /// What to tell of every image of this kind.
    fn warning(&self, name: &str) -> Option<String> {
        let _ = name;
        None
    }
}

/// Slices, all with the same facts.
struct Slices {
    files: Vec<(PathBuf, Fingerprint)>,
    image: &'static dyn Image,
    facts: Facts,
}

/// The volume of images of one kind, at least one.
pub(super) fn open(
    mut source: SourceInfo,
    paths: &[PathBuf],
    image: &'static dyn Image,
    options: &OpenOptions,
) -> Result<Volume, Error> {
    let name = source.name.clone();
    for (asked, what) in [
        (options.channel.unwrap_or(0), "channel"),
        (options.frame.unwrap_or(0), "frame"),
        (u64::from(options.level.unwrap_or(0)), "level"),
    ] {
        if asked > 0 {
            return Err(Error::unsupported(
                &name,
                format!("{what} {asked} was asked for, but these slices have only one"),
            ));
        }
    }
    let mut files = Vec::with_capacity(paths.len());
    let mut first: Option<(Facts, &Path)> = None;
    let mut length = 0_u64;
    for path in paths {
        let slice = path.display().to_string();
        let file = File::open(path).map_err(|e| Error::io(&slice, "cannot be opened", e))?;
        let metadata = file
            .metadata()
            .map_err(|e| Error::io(&slice, "cannot be read", e))?;
        let facts = image
            .examine(file)
            .map_err(|what| Error::unsupported(&slice, what))?;
        let [x, y] = facts.extents;
        let bytes = x.saturating_mul(y).saturating_mul(facts.bits.into()) / 8;
        if x == 0 || y == 0 || bytes > metadata.len().saturating_mul(image.most()) {
            return Err(Error::invalid(
                &slice,
                format!(
                    "claims {}, which its {} bytes cannot hold",
                    facts.in_words(),
                    metadata.len()
                ),
            ));
        }
        match first {
            Some((other, other_path)) if other != facts => {
                return Err(Error::invalid(
                    &name,
                    format!(
                        "not one volume: {} has {}, {} has {}",
                        file_name(other_path),
                        other.in_words(),
                        file_name(path),
                        facts.in_words()
                    ),
                ));
            }
            _ => first = first.or(Some((facts, path))),
        }
        length = length.saturating_add(metadata.len());
        files.push((path.clone(), Fingerprint::of(&metadata)));
    }
    let Some((facts, _)) = first else {
        return Err(Error::unsupported(&name, "there are no slices"));
    };
    let [x, y] = facts.extents;
    let dtype = DType {
        voxel: facts.voxel(),
        byte_order: if facts.bits > 8 {
            ByteOrder::Big
        } else {
            ByteOrder::Little
        },
    };
    let mut header = Header::new(Format::Slices, [x, y, files.len() as u64], dtype);
    if facts.bits < 8 {
        header.details.push(("bits", facts.bits.to_string()));
    }
    header.warnings.extend(image.warning(&name));
    source.compressed = image.most() > 1;
    source.length_bytes = Some(length);
    let names: usize = files.iter().map(|(path, _)| path.as_os_str().len()).sum();
    source.held_bytes = (size_of_val(&*files) + names) as u64;
    let slices = Box::new(Slices {
        files,
        image,
        facts,
    });
    let voxels = ChunkedVoxels::new(&name, &header, [x, y, 1], slices);
    Ok(Volume {
        header,
        voxels: Voxels::Random(Box::new(voxels)),
        source,
    })
}

impl Chunks for Slices {
    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
        // The index is within the volume, which has a plane for each file.
        let (path, fingerprint) = &self.files[index[2] as usize];
        let name = path.display().to_string();
        let file = File::open(path).map_err(|e| Error::io(&name, "cannot be opened again", e))?;
        fingerprint.check(&file, Some(path))?;
        let bytes = FileBytes::of_file(file, path, IoMode::Read)?;
        let data = bytes.read(0, bytes.len())?;
        bytes.check()?;
        self.image
            .decode(&data, self.facts, out)
            .map_err(|what| Error::invalid(&name, what))
    }
}

/// Widens samples of 1, 2 or 4 bits, highest bit first, to bytes. Rows begin on byte borders.
fn unpack(packed: &[u8], facts: Facts, out: &mut Vec<u8>) {
    let [width, _] = facts.extents;
    let (width, bits) = (width as usize, facts.bits as usize);
    out.clear();
    for row in packed.chunks_exact((width * bits).div_ceil(8)) {
        out.extend((0..width).map(|x| {
            let shift = 8 - bits - x * bits % 8;
            row[x * bits / 8] >> shift & ((1 << bits) - 1)
        }));
    }
}

/// PNG.
pub(super) struct Png;

impl Png {
    fn facts(info: &png::Info<'_>) -> Result<Facts, String> {
        let colour = match info.color_type {
            ColorType::Grayscale => None,
            ColorType::Rgb => Some("colour (RGB)"),
            ColorType::Indexed => Some("colour (palette)"),
            ColorType::GrayscaleAlpha => Some("grey with transparency"),
            ColorType::Rgba => Some("colour with transparency (RGBA)"),
        };
        if let Some(colour) = colour {
            return Err(format!(
                "is a PNG image in {colour}, which is not read; convert it to grey"
            ));
        }
        Ok(Facts {
            extents: [info.width.into(), info.height.into()],
            bits: match info.bit_depth {
                BitDepth::One => 1,
                BitDepth::Two => 2,
                BitDepth::Four => 4,
                BitDepth::Eight => 8,
                BitDepth::Sixteen => 16,
            },
        })
    }
}

impl Image for Png {
    fn examine(&self, file: File) -> Result<Facts, String> {
        let mut decoder = Decoder::new(BufReader::new(file));
        let info = decoder
            .read_header_info()
            .map_err(|e| format!("has a damaged PNG header: {e}"))?;
        Self::facts(info)
    }

    fn decode(&self, data: &[u8], facts: Facts, out: &mut Vec<u8>) -> Result<(), String> {
        /// What the decoder needs beside the rows it works on.
        const SLACK_BYTES: usize = 4 << 20;
        let damaged = |e| format!("is damaged PNG data: {e}");
        let rows = facts.extents[0] as usize * 16;
        let limits = Limits {
            bytes: rows.saturating_add(SLACK_BYTES),
        };
        let mut decoder = Decoder::new_with_limits(Cursor::new(data), limits);
        decoder.set_transformations(Transformations::IDENTITY);
        decoder.set_ignore_text_chunk(true);
        decoder.set_ignore_iccp_chunk(true);
        let mut reader = decoder.read_info().map_err(damaged)?;
        if Self::facts(reader.info())? != facts {
            return Err(format!("has no longer {}", facts.in_words()));
        }
        let size = reader.output_buffer_size().ok_or("does not fit memory")?;
        out.clear();
        out.resize(size, 0);
        reader.next_frame(out).map_err(damaged)?;
        // To the end, where the checksums are.
        reader.finish().map_err(damaged)?;
        if facts.bits < 8 {
            let packed = std::mem::take(out);
            unpack(&packed, facts, out);
        }
        Ok(())
    }

    fn most(&self) -> u64 {
        DEFLATE_MOST
    }
}

/// JPEG.
pub(super) struct Jpeg;

impl Image for Jpeg {
    fn examine(&self, file: File) -> Result<Facts, String> {
        let extents = jpeg::extents(BufReader::new(file))?;
        Ok(Facts { extents, bits: 8 })
    }

    fn decode(&self, data: &[u8], facts: Facts, out: &mut Vec<u8>) -> Result<(), String> {
        let [width, rows] = facts.extents;
        jpeg::grey(data, width, rows, rows, out)
    }

    fn most(&self) -> u64 {
        jpeg::MOST
    }

    fn warning(&self, name: &str) -> Option<String> {
        Some(crate::tiff::lossy(name))
    }
}

/// Binary PGM.
pub(super) struct Pgm;

impl Pgm {
    /// Facts and the number of bytes before the pixels.
    fn header(data: &[u8]) -> Result<(Facts, usize), String> {
        let mut at = 2;
        let mut numbers = [0_u64; 3];
        for number in &mut numbers {
            loop {
                match data.get(at) {
                    Some(b'#') => {
                        let end = data[at..].iter().position(|b| *b == b'\n');
                        at += end.ok_or("has a PGM header without an end")?;
                    }
                    Some(b) if b.is_ascii_whitespace() => at += 1,
                    _ => break,
                }
            }
            let digits = data[at.min(data.len())..]
                .iter()
                .take_while(|b| b.is_ascii_digit())
                .count();
            let text = String::from_utf8_lossy(&data[at..at + digits]);
            *number = text
                .parse()
                .map_err(|_| format!("has a PGM header with '{text}' for a number"))?;
            at += digits;
        }
        let [x, y, highest] = numbers;
        if !(1..=u64::from(u16::MAX)).contains(&highest) || x.max(y) > u64::from(u32::MAX) {
            return Err(format!(
                "has a PGM header of {x} x {y} pixels up to {highest}"
            ));
        }
        let bits = if highest > 255 { 16 } else { 8 };
        Ok((
            Facts {
                extents: [x, y],
                bits,
            },
            at + 1,
        ))
    }
}

impl Image for Pgm {
    fn examine(&self, file: File) -> Result<Facts, String> {
        /// Comments may be longer, but are not.
        const HEAD_BYTES: u64 = 4096;
        let mut head = Vec::new();
        let mut start = std::io::Read::take(file, HEAD_BYTES);
        std::io::Read::read_to_end(&mut start, &mut head)
            .map_err(|e| format!("cannot be read: {e}"))?;
        Self::header(&head).map(|(facts, _)| facts)
    }

    fn decode(&self, data: &[u8], facts: Facts, out: &mut Vec<u8>) -> Result<(), String> {
        let (found, start) = Self::header(data)?;
        let [x, y] = facts.extents;
        let bytes =
            usize::try_from(x * y * u64::from(facts.bits / 8)).map_err(|e| e.to_string())?;
        let pixels = data.get(start..).unwrap_or(&[]);
        if found != facts || pixels.len() < bytes {
            return Err(format!(
                "ends early: {} bytes of pixels found, {bytes} expected",
                pixels.len()
            ));
        }
        out.clear();
        out.extend_from_slice(&pixels[..bytes]);
        Ok(())
    }

    fn most(&self) -> u64 {
        1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pgm_header_may_have_comments() {
        let (facts, start) = Pgm::header(b"P5\n# a comment\n3 2 # more\n255\nabcdef").unwrap();
        assert_eq!(
            facts,
            Facts {
                extents: [3, 2],
                bits: 8
            }
        );
        assert_eq!(start, 30);
        for bad in [
            "P5",
            "P5 3",
            "P5 3 2 x",
            "P5 3 2 0 ",
            "P5 3 2 65536 ",
            "P5 #",
        ] {
            assert!(Pgm::header(bad.as_bytes()).is_err(), "{bad}");
        }
    }
}
