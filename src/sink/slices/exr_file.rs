//! One slice as an OpenEXR file.
//!
//! Comes in: the surfels of a slice, in lists of [`LINES`] rows of pixels. Goes out: a scan line
//! file, ZIP compressed, whole or not at all. Bytes are fixed by the surfels: chunks lie in
//! increasing order, and header attributes are sorted by name.

use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::OnceLock;

use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock};
use exr::block::writer::ChunksWriter;
use exr::block::{BlockIndex, UncompressedBlock};
use exr::compression::Compression;
use exr::error::Error as ExrError;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{AttributeValue, ChannelDescription, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::f16;
use rayon::prelude::*;

use super::palette::Palette;
use crate::sink::error::SinkError;
use crate::sink::info::TableInfo;
use crate::sink::whole_file::WholeFile;

/// Rows of pixels in a block of the file: what ZIP compression in OpenEXR prescribes.
pub(super) const LINES: u32 = 16;

/// Preview channels, half float, in the file's alphabetical order.
const PREVIEW: [&str; 3] = ["B", "G", "R"];

/// Float channels, in the file's alphabetical order; [`mean_of`] fills them in this order.
const LAYERS: [&str; 9] = [
    "curv.G",
    "curv.H",
    "curv.area",
    "curv.k1",
    "curv.k2",
    "normal.X",
    "normal.Y",
    "normal.Z",
    "surf.count",
];

const PIXEL_BYTES: usize = PREVIEW.len() * 2 + LAYERS.len() * 4;

/// A surfel of a slice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixel {
    /// Row within the block, then pixel, then face: the order of averaging; see [`Drawing::place`].
    pub(super) place: u64,
    /// H, G, k1, k2.
    pub(super) curvature: [f32; 4],
    pub(super) area: f32,
    pub(super) normal: [f32; 3],
}

/// The surfels of a slice, in lists of [`LINES`] rows; rows beyond the lists are empty.
pub(super) struct Frame {
    pub(super) index: u32,
    pub(super) bands: Vec<Vec<Pixel>>,
}

/// What all slices of a run have in common.
pub(super) struct Drawing {
    size: [u32; 2],
    palette: Palette,
    range: f32,
    attributes: Vec<(&'static str, String)>,
    /// Compressed blocks without surfels: a whole one, and the last of an image.
    blank: [OnceLock<Vec<u8>>; 2],
}

impl Drawing {
    pub(super) fn new(
        info: &TableInfo,
        axis: usize,
        size: [u32; 2],
        palette: Palette,
        range: f32,
    ) -> Self {
        let axis_name = ["x", "y", "z"][axis];
        let rows = ["y right, z down", "x right, z down", "x right, y down"][axis];
        let json = |value: &[f64]| serde_json::json!(value).to_string();
        let attributes = vec![
            ("curvox.axis", axis_name.to_owned()),
            ("curvox.conventions", info.conventions.join("\n")),
            ("curvox.dims", serde_json::json!(info.dims).to_string()),
            (
                "curvox.direction",
                serde_json::json!(info.direction).to_string(),
            ),
            ("curvox.origin", json(&info.origin)),
            ("curvox.parameters", info.parameters.to_string()),
            (
                "curvox.pixels",
                format!("{rows}; first row and column are voxel 0"),
            ),
            (
                "curvox.preview",
                format!("curv.H, {}, scale ±{range:?}", palette.name()),
            ),
            ("curvox.radii", serde_json::json!(info.radii).to_string()),
            ("curvox.radiusShown", info.radii[0].label.clone()),
            (
                "curvox.sign",
                "normals point from inside to outside; a convex body has H > 0".to_owned(),
            ),
            ("curvox.spacing", json(&info.spacing)),
            ("curvox.unit", info.unit.clone()),
            ("curvox.version", info.version.clone()),
        ];
        Self {
            size,
            palette,
            range,
            attributes,
            blank: Default::default(),
        }
    }

    /// Where a surfel goes within its list of rows.
    pub(super) fn place(&self, x: u32, row: u32, face: u8) -> u64 {
        (u64::from(row) * u64::from(self.size[0]) + u64::from(x)) * 8 + u64::from(face)
    }

    /// Memory of one block while it is drawn and compressed.
    pub(super) fn band_bytes(width: u32) -> u64 {
        3 * u64::from(width) * u64::from(LINES) * PIXEL_BYTES as u64
    }

    /// Writes a slice.
    pub(super) fn write(&self, path: &Path, frame: &Frame) -> Result<(), SinkError> {
        let mut file = WholeFile::create(path)?;
        self.encode(&mut file, frame)
            .map_err(|error| SinkError::exr(path, "write", error))?;
        file.commit()
    }

    fn encode<W: Read + Write + Seek>(
        &self,
        output: &mut W,
        frame: &Frame,
    ) -> Result<(), ExrError> {
        let header = self.header(frame.index)?;
        let mut buffered = BufWriter::with_capacity(1 << 18, &mut *output);
        exr::block::write(
            &mut buffered,
            [header].into_iter().collect(),
            true,
            |meta, chunks| {
                let count = meta.headers[0].chunk_count;
                // A few blocks a thread: more would hold more memory, fewer leave threads idle.
                let group = rayon::current_num_threads() * 2;
                for first in (0..count).step_by(group) {
                    let drawn: Vec<Chunk> = (first..count.min(first + group))
                        .into_par_iter()
                        .map(|block| self.chunk(&meta.headers, block, frame.bands.get(block)))
                        .collect::<Result<_, _>>()?;
                    for (i, chunk) in drawn.into_iter().enumerate() {
                        chunks.write_chunk(first + i, chunk)?;
                    }
                }
                Ok(())
            },
        )?;
        buffered.flush()?;
        drop(buffered);
        sort_attributes(output)
    }

    fn header(&self, index: u32) -> Result<Header, ExrError> {
        let half = PREVIEW.iter().map(|name| (*name, SampleType::F16));
        let float = LAYERS.iter().map(|name| (*name, SampleType::F32));
        let channels = half
            .chain(float)
            .map(|(name, kind)| ChannelDescription::new(Text::from(name), kind, false))
            .collect();
        let mut own = LayerAttributes::default();
        let index =
            i32::try_from(index).map_err(|_| ExrError::NotSupported("slice index".into()))?;
        own.other
            .insert(Text::from("curvox.index"), AttributeValue::I32(index));
        for (name, value) in &self.attributes {
            own.other
                .insert(Text::from(*name), AttributeValue::Text(text(value)));
        }
        let size = Vec2(self.size[0] as usize, self.size[1] as usize);
        Ok(Header::new(Text::from("slice"), size, channels)
            .with_encoding(
                Compression::ZIP16,
                BlockDescription::ScanLines,
                LineOrder::Increasing,
            )
            .with_attributes(own))
    }

    /// The compressed block `block`, from its surfels in any order.
    fn chunk(
        &self,
        headers: &[Header],
        block: usize,
        pixels: Option<&Vec<Pixel>>,
    ) -> Result<Chunk, ExrError> {
        let width = self.size[0] as usize;
        let first = block * LINES as usize;
        let lines = (self.size[1] as usize - first).min(LINES as usize);
        let compress = |data: Vec<u8>| {
            let index = BlockIndex {
                layer: 0,
                pixel_position: Vec2(0, first),
                pixel_size: Vec2(width, lines),
                level: Vec2(0, 0),
            };
            UncompressedBlock { index, data }.compress_to_chunk(headers)
        };
        let bytes = width * lines * PIXEL_BYTES;
        match pixels.filter(|pixels| !pixels.is_empty()) {
            Some(pixels) => compress(self.draw(pixels, bytes)),
            None => {
                let blank = &self.blank[usize::from(lines != LINES as usize)];
                if let Some(compressed_pixels_le) = blank.get().cloned() {
                    let y_coordinate = i32::try_from(first).map_err(|_| {
                        ExrError::NotSupported("more than 2^31 rows of pixels".into())
                    })?;
                    let block = CompressedScanLineBlock {
                        y_coordinate,
                        compressed_pixels_le,
                    };
                    let compressed_block = CompressedBlock::ScanLine(block);
                    return Ok(Chunk {
                        layer_index: 0,
                        compressed_block,
                    });
                }
                let chunk = compress(vec![0; bytes])?;
                if let CompressedBlock::ScanLine(made) = &chunk.compressed_block {
                    blank.get_or_init(|| made.compressed_pixels_le.clone());
                }
                Ok(chunk)
            }
        }
    }

    /// The samples of a block, row by row, in each row channel by channel.
    fn draw(&self, pixels: &[Pixel], bytes: usize) -> Vec<u8> {
        let width = self.size[0] as usize;
        let mut sorted = pixels.to_vec();
        sorted.sort_unstable_by_key(|pixel| pixel.place);
        let mut data = vec![0; bytes];
        for group in sorted.chunk_by(|a, b| a.place / 8 == b.place / 8) {
            // Below the number of pixels of a block, which is addressable.
            let pixel = (group[0].place / 8) as usize;
            let (row, x) = (pixel / width, pixel % width);
            let line = &mut data[row * width * PIXEL_BYTES..][..width * PIXEL_BYTES];
            let (preview, layers) = line.split_at_mut(width * PREVIEW.len() * 2);
            let values = mean_of(group);
            let [r, g, b] = self.palette.colour(values[1], self.range);
            for (channel, value) in [b, g, r].into_iter().enumerate() {
                let at = (channel * width + x) * 2;
                preview[at..at + 2].copy_from_slice(&f16::from_f32(value).to_ne_bytes());
            }
            for (channel, value) in values.into_iter().enumerate() {
                let at = (channel * width + x) * 4;
                layers[at..at + 4].copy_from_slice(&value.to_ne_bytes());
            }
        }
        data
    }
}

/// The values of [`LAYERS`] for the surfels of one voxel.
fn mean_of(surfels: &[Pixel]) -> [f32; 9] {
    let mean = |which: usize| {
        let values = surfels
            .iter()
            .map(|s| s.curvature[which])
            .filter(|v| v.is_finite());
        let (count, sum) = values.fold((0_u32, 0.0), |(n, sum), v| (n + 1, sum + f64::from(v)));
        if count == 0 {
            0.0
        } else {
            (sum / f64::from(count)) as f32
        }
    };
    let sum = |value: &dyn Fn(&Pixel) -> f32| -> f64 {
        surfels
            .iter()
            .map(value)
            .filter(|v| v.is_finite())
            .map(f64::from)
            .sum()
    };
    let n = [0, 1, 2].map(|axis| sum(&|s| s.normal[axis]));
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    let [nx, ny, nz] = n.map(|c| {
        if length > 0.0 {
            (c / length) as f32
        } else {
            0.0
        }
    });
    let [h, g, k1, k2] = [0, 1, 2, 3].map(mean);
    [
        g,
        h,
        sum(&|s| s.area) as f32,
        k1,
        k2,
        nx,
        ny,
        nz,
        surfels.len() as f32,
    ]
}

/// Text as EXR headers hold it, one byte a character; other characters become `?`.
fn text(value: &str) -> Text {
    let ascii = value.replace('±', "+-").replace(['µ', 'μ'], "u");
    let bytes = ascii
        .chars()
        .map(|c| u8::try_from(c).ok().filter(u8::is_ascii).unwrap_or(b'?'));
    Text::from_bytes_unchecked(bytes.collect())
}

/// Puts the attributes of the header in the order of their names.
///
/// The exr crate keeps them in a hash map, so their order differs from run to run. Sorting moves
/// bytes within the header and leaves its length, and with it all offsets, as they are.
fn sort_attributes<W: Read + Write + Seek>(file: &mut W) -> Result<(), ExrError> {
    // After the magic number and the version.
    const START: u64 = 8;
    let broken = || ExrError::Invalid("header just written".into());
    file.seek(SeekFrom::Start(START))?;
    let mut attributes: Vec<Vec<u8>> = Vec::new();
    {
        let mut input = std::io::BufReader::new(&mut *file);
        loop {
            let mut bytes = Vec::new();
            read_name(&mut input, &mut bytes)?;
            if bytes.len() == 1 {
                break;
            }
            read_name(&mut input, &mut bytes)?;
            let mut size = [0; 4];
            input.read_exact(&mut size)?;
            bytes.extend_from_slice(&size);
            let length = bytes.len();
            let size = usize::try_from(i32::from_le_bytes(size)).map_err(|_| broken())?;
            bytes.resize(length + size, 0);
            input.read_exact(&mut bytes[length..])?;
            attributes.push(bytes);
        }
    }
    attributes.sort_unstable();
    file.seek(SeekFrom::Start(START))?;
    file.write_all(&attributes.concat())?;
    file.flush()?;
    Ok(())
}

/// Appends bytes up to and with the next zero.
fn read_name(input: &mut impl std::io::BufRead, bytes: &mut Vec<u8>) -> Result<(), ExrError> {
    input.read_until(0, bytes)?;
    if bytes.last() == Some(&0) {
        Ok(())
    } else {
        Err(ExrError::Invalid("header just written".into()))
    }
}
