//! What a directory says about the pixels of its page.
//!
//! In: an [`Ifd`]. Out: a [`Page`]: its [`Layout`] (size, type, compression, how it is cut into
//! strips or tiles) and where the tables of its blocks are. The tables stay in the file until a
//! block is wanted, so a page takes little memory however many strips it has. Guaranteed: sizes
//! are not 0, a block's bytes fit memory addresses, and the tables are long enough for the page.
//! What cannot be read is refused by its name.

use std::sync::Arc;

use super::ifd::{Entry, Ifd, Tiff, tag};
use crate::error::Error;
use crate::header::VoxelType;

/// How the bytes of a block are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    /// CCITT modified Huffman: rows of one dimension, each on a byte border.
    Huffman,
    /// CCITT group 3, one-dimensional.
    Group3,
    /// CCITT group 4.
    Group4,
    Lzw,
    Jpeg,
    Deflate,
    PackBits,
    Zstd,
}

impl Compression {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Huffman => "CCITT modified Huffman",
            Self::Group3 => "CCITT group 3",
            Self::Group4 => "CCITT group 4",
            Self::Lzw => "LZW",
            Self::Jpeg => "JPEG",
            Self::Deflate => "deflate",
            Self::PackBits => "PackBits",
            Self::Zstd => "zstd",
        }
    }

    /// The most bytes that one compressed byte can become.
    pub(super) fn most(self, width: u64) -> u64 {
        match self {
            Self::None => 1,
            // Two bytes stand for at most 128.
            Self::PackBits => 64,
            // A code of 9 bits or more stands for at most 4096 bytes.
            Self::Lzw => 4096,
            Self::Deflate => crate::input::DEFLATE_MOST,
            Self::Jpeg => crate::jpeg::MOST,
            // A block of four bytes stands for at most 128 KiB.
            Self::Zstd => 32 << 10,
            // A bit stands for at most a row.
            Self::Huffman | Self::Group3 | Self::Group4 => width.saturating_mul(8),
        }
    }
}

/// What was done to the samples before compression.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Predictor {
    None,
    /// Differences along the row.
    Horizontal,
    /// Bytes of floating point numbers by significance, then their differences.
    Float,
}

/// What the colours of a page mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Colour {
    Grey,
    Rgb,
    Palette,
}

/// How the pixels of a page are stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) width: u64,
    pub(super) height: u64,
    /// Type of a voxel as it is given out.
    pub(super) voxel: VoxelType,
    /// Bits of a stored sample.
    pub(super) bits: usize,
    /// Samples of a pixel.
    pub(super) samples: u64,
    /// Each sample has blocks of its own.
    pub(super) planar: bool,
    pub(super) colour: Colour,
    /// Stored 0 is to be shown white.
    pub(super) white_is_zero: bool,
    /// The lowest bit of a byte comes first.
    pub(super) bits_reversed: bool,
    pub(super) compression: Compression,
    pub(super) predictor: Predictor,
    pub(super) tiled: bool,
    /// Extents of a strip or tile. The last strip of a page is cut at its end, a tile never.
    pub(super) block: [u64; 2],
}

/// Where the blocks of a page are.
#[derive(Clone, Copy, Debug)]
pub(super) enum Place {
    /// By tables; without one of lengths only where these are known.
    Tables {
        offsets: Entry,
        counts: Option<Entry>,
    },
    /// One block, uncompressed.
    At(u64),
}

/// A page of a TIFF file.
#[derive(Clone, Debug)]
pub(super) struct Page {
    pub(super) layout: Arc<Layout>,
    pub(super) place: Place,
    /// Tables that all JPEG blocks share.
    pub(super) jpeg_tables: Option<Entry>,
}

impl Layout {
    /// Blocks along x and y.
    pub(super) fn blocks(&self) -> [u64; 2] {
        [
            self.width.div_ceil(self.block[0]),
            self.height.div_ceil(self.block[1]),
        ]
    }

    /// Samples that lie side by side in a row of a block.
    pub(super) fn interleaved(&self) -> u64 {
        if self.planar { 1 } else { self.samples }
    }

    /// Rows of the blocks in row `y` of blocks.
    pub(super) fn block_rows(&self, y: u64) -> u64 {
        if self.tiled {
            self.block[1]
        } else {
            self.block[1].min(self.height - y * self.block[1])
        }
    }

    /// Bytes of a row of a block. Fits: see [`Page::read`].
    pub(super) fn row_bytes(&self) -> u64 {
        (self.block[0] * self.interleaved() * self.bits as u64).div_ceil(8)
    }

    /// Whether stored 0 is the highest value. Of signed and floating point numbers there is none.
    pub(super) fn inverted(&self) -> bool {
        use VoxelType::{Bool, U8, U16, U32, U64};
        self.white_is_zero && matches!(self.voxel, Bool | U8 | U16 | U32 | U64)
    }

    /// Whether the stored bytes are the voxels.
    pub(super) fn is_plain(&self) -> bool {
        self.compression == Compression::None
            && self.predictor == Predictor::None
            && self.samples == 1
            && self.bits == self.voxel.bytes() * 8
            && !self.inverted()
            && !self.bits_reversed
    }

    /// Whether pages of both layouts are planes of one volume.
    pub(super) fn same_voxels(&self, other: &Self) -> bool {
        (self.width, self.height, self.voxel, self.bits, self.samples)
            == (
                other.width,
                other.height,
                other.voxel,
                other.bits,
                other.samples,
            )
    }

    /// Size and type in words, to tell pages apart.
    pub(super) fn in_words(&self) -> String {
        let samples = match self.samples {
            1 => String::new(),
            n => format!(", {n} samples a pixel"),
        };
        format!(
            "{} x {} pixels of {} ({} bits{samples})",
            self.width, self.height, self.voxel, self.bits
        )
    }
}

/// Whether a page is a smaller copy or a mask of another one, to be left out.
pub(super) fn is_secondary(tiff: &Tiff, ifd: &Ifd) -> Result<bool, Error> {
    if let Some(kind) = tiff.first(ifd, tag::NEW_SUBFILE_TYPE)? {
        return Ok(kind & 0b101 != 0);
    }
    Ok(tiff.first(ifd, tag::SUBFILE_TYPE)? == Some(2))
}

impl Page {
    /// What a directory says of its page. `like` is the layout of another page, shared if equal.
    pub(super) fn read(tiff: &Tiff, ifd: &Ifd, like: Option<&Arc<Layout>>) -> Result<Self, Error> {
        let (layout, place) = Facts { tiff, ifd }.layout()?;
        let layout = match like {
            Some(like) if **like == layout => Arc::clone(like),
            _ => Arc::new(layout),
        };
        let jpeg_tables = ifd.entry(tag::JPEG_TABLES).copied();
        Ok(Self {
            layout,
            place,
            jpeg_tables,
        })
    }
}

/// A directory that is being understood.
struct Facts<'a> {
    tiff: &'a Tiff,
    ifd: &'a Ifd,
}

impl Facts<'_> {
    fn number(&self, tag: u16) -> Result<Option<u64>, Error> {
        self.tiff.first(self.ifd, tag)
    }

    fn invalid(&self, what: impl Into<String>) -> Error {
        Error::invalid(self.tiff.name(), format!("a page {}", what.into())).at(self.ifd.at)
    }

    fn unsupported(&self, what: impl Into<String>) -> Error {
        Error::unsupported(self.tiff.name(), what).at(self.ifd.at)
    }

    fn extent(&self, tag: u16, name: &str) -> Result<u64, Error> {
        match self.number(tag)? {
            Some(0) => Err(self.invalid(format!("has {name} 0"))),
            Some(n) if n <= u64::from(u32::MAX) => Ok(n),
            Some(n) => Err(self.invalid(format!("has {name} {n}, at most {} expected", u32::MAX))),
            None => Err(self.invalid(format!("has no {name} (entry {tag})"))),
        }
    }

    /// The value that all samples have in common.
    fn of_all_samples(&self, tag: u16, name: &str, default: u64) -> Result<u64, Error> {
        let Some(entry) = self.ifd.entry(tag) else {
            return Ok(default);
        };
        let first = self.tiff.value(entry, 0)?;
        self.tiff.for_each_value(entry, |value| {
            if value == first {
                return Ok(());
            }
            Err(self.unsupported(format!(
                "the samples of a pixel differ in {name}: {first} and {value}"
            )))
        })?;
        Ok(first)
    }

    fn layout(&self) -> Result<(Layout, Place), Error> {
        let width = self.extent(tag::WIDTH, "width")?;
        let height = self.extent(tag::LENGTH, "height")?;
        let samples = self.number(tag::SAMPLES_PER_PIXEL)?.unwrap_or(1);
        if !(1..=u64::from(u16::MAX)).contains(&samples) {
            return Err(self.invalid(format!("has {samples} samples a pixel")));
        }
        let (bits, voxel) = self.sample()?;
        let compression = self.compression()?;
        let (colour, white_is_zero) = self.colour()?;
        let predictor = self.predictor(compression, bits, voxel)?;
        let tiled = self.ifd.entry(tag::TILE_WIDTH).is_some()
            || self.ifd.entry(tag::TILE_OFFSETS).is_some();
        let block = if tiled {
            [
                self.extent(tag::TILE_WIDTH, "tile width")?,
                self.extent(tag::TILE_LENGTH, "tile height")?,
            ]
        } else {
            match self.number(tag::ROWS_PER_STRIP)? {
                Some(0) => return Err(self.invalid("has strips of 0 rows")),
                rows => [width, rows.unwrap_or(height).min(height)],
            }
        };
        let planar = samples > 1 && self.number(tag::PLANAR_CONFIGURATION)? == Some(2);
        let layout = Layout {
            width,
            height,
            voxel,
            bits,
            samples,
            planar,
            colour,
            white_is_zero,
            bits_reversed: self.number(tag::FILL_ORDER)? == Some(2),
            compression,
            predictor,
            tiled,
            block,
        };
        self.check_block(&layout)?;
        if compression == Compression::Jpeg && layout.interleaved() > 1 {
            return Err(
                self.unsupported("JPEG with several samples a pixel is colour, which is not read")
            );
        }
        let place = self.place(&layout)?;
        Ok((layout, place))
    }

    /// Refuses blocks whose bytes cannot be addressed.
    fn check_block(&self, layout: &Layout) -> Result<(), Error> {
        // Voxels may be wider than stored samples, but never by more than a factor of 8.
        let bits = layout.block[0]
            .checked_mul(layout.interleaved())
            .and_then(|n| n.checked_mul(64))
            .and_then(|n| n.checked_mul(layout.block[1]));
        if bits.is_none_or(|bits| usize::try_from(bits).is_err()) {
            return Err(self.invalid(format!(
                "has blocks of {} x {} pixels, which fit no memory",
                layout.block[0], layout.block[1]
            )));
        }
        Ok(())
    }

    /// Bits of a sample and the type it is given out as.
    fn sample(&self) -> Result<(usize, VoxelType), Error> {
        let bits = self.of_all_samples(tag::BITS_PER_SAMPLE, "bits", 1)?;
        let format = self.of_all_samples(tag::SAMPLE_FORMAT, "format", 1)?;
        let voxel = match (format, bits) {
            // 4: undefined, taken as unsigned, as others do.
            (1 | 4, 1) => VoxelType::Bool,
            (1 | 4, 2..=8) => VoxelType::U8,
            (1 | 4, 9..=16) => VoxelType::U16,
            (1 | 4, 32) => VoxelType::U32,
            (1 | 4, 64) => VoxelType::U64,
            (2, 8) => VoxelType::I8,
            (2, 16) => VoxelType::I16,
            (2, 32) => VoxelType::I32,
            (2, 64) => VoxelType::I64,
            (3, 16) => VoxelType::F16,
            (3, 32) => VoxelType::F32,
            (3, 64) => VoxelType::F64,
            (5 | 6, _) => return Err(self.unsupported("the samples are complex numbers")),
            (1..=4, _) => {
                let kind = ["unsigned", "signed", "floating point", "undefined"]
                    .get(format as usize - 1)
                    .unwrap_or(&"");
                return Err(self.unsupported(format!("{kind} samples of {bits} bits are not read")));
            }
            _ => return Err(self.invalid(format!("has the unknown sample format {format}"))),
        };
        Ok((bits as usize, voxel))
    }

    fn compression(&self) -> Result<Compression, Error> {
        let code = self.number(tag::COMPRESSION)?.unwrap_or(1);
        let name = match code {
            1 => return Ok(Compression::None),
            2 => return Ok(Compression::Huffman),
            3 if self.number(tag::T4_OPTIONS)?.unwrap_or(0) & 0b11 == 0 => {
                return Ok(Compression::Group3);
            }
            3 => "CCITT group 3 in two dimensions or uncompressed mode",
            4 if self.number(tag::T6_OPTIONS)?.unwrap_or(0) & 0b10 == 0 => {
                return Ok(Compression::Group4);
            }
            4 => "CCITT group 4 with uncompressed mode",
            5 => return Ok(Compression::Lzw),
            7 => return Ok(Compression::Jpeg),
            8 | 32946 => return Ok(Compression::Deflate),
            32773 => return Ok(Compression::PackBits),
            50000 => return Ok(Compression::Zstd),
            6 => "old-style JPEG",
            9 | 10 => "JBIG",
            32766 => "NeXT",
            32809 => "ThunderScan",
            33003 | 33004 | 33005 | 34712 => "JPEG 2000",
            34661 => "JBIG",
            34676 | 34677 => "SGI Log",
            34887 => "LERC",
            34892 => "lossy JPEG of DNG",
            34925 => "LZMA",
            34926 | 50001 => "WebP",
            34933 => "PNG",
            22610 | 34934 => "JPEG XR",
            50002 | 52546 => "JPEG XL",
            _ => {
                return Err(self.unsupported(format!("compression {code} is not known")));
            }
        };
        Err(self.unsupported(format!("compression {code} ({name}) is not read")))
    }

    /// What the samples stand for, and whether 0 is white.
    fn colour(&self) -> Result<(Colour, bool), Error> {
        let name = match self.number(tag::PHOTOMETRIC)?.unwrap_or(1) {
            0 => return Ok((Colour::Grey, true)),
            1 => return Ok((Colour::Grey, false)),
            2 => return Ok((Colour::Rgb, false)),
            3 => return Ok((Colour::Palette, false)),
            4 => return Ok((Colour::Grey, false)),
            5 => "CMYK",
            6 => "YCbCr",
            8..=10 => "CIE L*a*b*",
            32803 => "a colour filter array",
            32844 | 32845 => "logarithmic luminance",
            // Linear raw: grey where there is one sample.
            34892 => return Ok((Colour::Grey, false)),
            other => {
                return Err(
                    self.unsupported(format!("photometric interpretation {other} is not known"))
                );
            }
        };
        Err(self.unsupported(format!("the pixels are colour ({name}), which is not read")))
    }

    fn predictor(
        &self,
        compression: Compression,
        bits: usize,
        voxel: VoxelType,
    ) -> Result<Predictor, Error> {
        // Only these codecs have predictors; elsewhere the entry means nothing.
        if !matches!(
            compression,
            Compression::Lzw | Compression::Deflate | Compression::Zstd
        ) {
            return Ok(Predictor::None);
        }
        match self.number(tag::PREDICTOR)?.unwrap_or(1) {
            1 => Ok(Predictor::None),
            2 if matches!(bits, 8 | 16 | 32 | 64) => Ok(Predictor::Horizontal),
            3 if voxel.is_float() => Ok(Predictor::Float),
            3 => Err(self.invalid(format!(
                "has the predictor of floating point, but samples of {voxel}"
            ))),
            other => Err(self.unsupported(format!(
                "predictor {other} with samples of {bits} bits is not read"
            ))),
        }
    }

    fn place(&self, layout: &Layout) -> Result<Place, Error> {
        let (offsets, counts) = if layout.tiled && self.ifd.entry(tag::TILE_OFFSETS).is_some() {
            (tag::TILE_OFFSETS, tag::TILE_BYTE_COUNTS)
        } else {
            (tag::STRIP_OFFSETS, tag::STRIP_BYTE_COUNTS)
        };
        let Some(offsets) = self.ifd.entry(offsets).copied() else {
            return Err(
                self.invalid("does not say where its pixels are (no strip or tile offsets)")
            );
        };
        let counts = self.ifd.entry(counts).copied();
        if counts.is_none() && layout.compression != Compression::None {
            return Err(self.invalid("does not say how long its compressed strips are"));
        }
        let [x, y] = layout.blocks();
        // Each factor is below 2^32, 2^32 and 2^16, and the first two together below 2^58.
        let blocks = (x * y).saturating_mul(if layout.planar { layout.samples } else { 1 });
        for entry in [Some(offsets), counts].into_iter().flatten() {
            if entry.count < blocks {
                return Err(self.invalid(format!(
                    "has {blocks} strips or tiles, but entry {} lists {}",
                    entry.tag, entry.count
                )));
            }
        }
        Ok(Place::Tables { offsets, counts })
    }
}
