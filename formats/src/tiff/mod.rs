//! TIFF: stacks of pages, ImageJ hyperstacks, OME-TIFF.
//!
//! In: the bytes of a TIFF or BigTIFF file of either byte order. Out: a volume whose planes are
//! its pages. The rooms: `ifd` (directories and entries), `page` (what they say of pixels),
//! `stack` and `ome` (how pages make a volume, by the notes of ImageJ, tifffile, LSM and OME),
//! `voxels` (the planes, wherever they are), `block`, `unpress` and `samples` (one strip or tile).
//!
//! Read: strips and tiles; no compression, LZW, deflate, PackBits, zstd, CCITT modified Huffman,
//! group 3 (one-dimensional) and group 4, grey JPEG; predictors 1, 2 and 3; samples of 1 to 16
//! bits unsigned, 8 to 64 bits signed and unsigned, 16, 32 and 64 bits floating point; white as 0
//! (turned round); both fill orders; pyramids in sub-directories by level; several samples, also
//! in planes of their own, and channels by number. Uncompressed pages one behind the other are
//! mapped as they are. Pages marked as reduced copies or masks are left out.
//!
//! Refused by name: colour, unless a channel of it is asked for; other compressions; pages of
//! different size or type; one page alone, which is no volume. A plain TIFF does not say how far
//! its planes are apart, so its resolution entries give a warning instead of a spacing. Bytes
//! behind the last page and pages that the notes do not mention are ignored.
//!
//! Guaranteed: the chain of directories ends; every table and block is inside the file, and can
//! hold what it promises, before the first voxel is read; memory is one block and what it becomes
//! for each thread, and some hundred bytes a page.
//!
//! The crate `tiff` (0.11) is not used. It shows one page of an ImageJ stack above 4 GB, whose
//! other planes no directory lists; gives an 8-bit sample of 4 bits packed, and values turned round
//! or not by type; has no FillOrder; keeps the tables of a page in memory and one decoder a
//! thread. The walk over directories is the smaller part, and the codecs are libraries: `weezl`,
//! `flate2`, `zstd`, `fax`, `zune-jpeg`. OME-XML is read by `quick-xml`, which runs forward in
//! constant memory and expands no entities of a document's own.

mod block;

mod gather;

mod ifd;

mod ome;

mod page;

mod samples;

mod slice;

mod stack;

mod units;

mod unpress;

mod voxels;

use std::sync::Arc;

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header, Scaling, Unit};
use crate::parsed::Context;
use crate::stream::ends_early;
use crate::volume::{SourceInfo, Volume, Voxels};

pub(crate) use ifd::detect;
pub(crate) use slice::{is_series, open_slices};

use gather::{Gathered, at_level, levels};
use ifd::{Ifd, Tiff, tag};
use page::{Colour, Compression, Layout, Page, Place, Predictor, is_secondary};
use stack::Stack;
use voxels::{PlaneVoxels, Planes, Source};

/// Opens the volume in a TIFF file.
pub(crate) fn open(bytes: FileBytes, context: &Context<'_>) -> Result<Volume, Error> {
    let tiff = Tiff::new(bytes)?;
    let directories = Directories::walk(&tiff)?;
    let first = tiff.directory(directories.all[0])?;
    if !tiff.big
        && tiff.bytes.len() > u64::from(u32::MAX)
        && first.entry(tag::NDPI_FORMAT).is_some()
    {
        return Err(Error::unsupported(
            tiff.name(),
            "is an NDPI file above 4 GB, whose offsets do not follow TIFF",
        ));
    }
    let description = tiff.text(&first, tag::DESCRIPTION)?.unwrap_or_default();
    if ome::detect(&description) {
        return ome::open(&tiff, &directories, &description, context);
    }
    if let Some(dataset) = &context.options.dataset {
        return Err(Error::unsupported(
            tiff.name(),
            format!("dataset {dataset} was asked for, but this TIFF file has no named images"),
        ));
    }
    // The notes of writers are about pages, so smaller copies of them do not count.
    let Some(&start) = directories.main.first() else {
        return Err(Error::invalid(
            tiff.name(),
            "all pages are marked as reduced copies or masks of others",
        ));
    };
    let start = tiff.directory(start)?;
    let page = Page::read(&tiff, &start, None)?;
    let extents = [page.layout.width, page.layout.height];
    let stack = stack::read(&tiff, &first, directories.main.len() as u64, extents)?;
    let counts = [stack.channels, stack.frames];
    let choice = Choice::of(
        tiff.name(),
        counts,
        &page.layout,
        stack.palette_is_display,
        context,
    )?;
    if stack.slices < 2 {
        return Err(flat(tiff.name(), extents));
    }
    let mut gathered = Gathered::default();
    gathered.add_source(Source::Open(tiff.clone()), tiff.bytes.len());
    let level = context.options.level.unwrap_or(0);
    let [channel, slice, frame] = stack.strides;
    let offset = choice.channel * channel + choice.frame * frame;
    if stack.contiguous {
        gathered.add(&tiff, 0, &at_level(&tiff, start.clone(), level)?, |_| {
            "the page".into()
        })?;
    } else {
        for z in 0..stack.slices {
            // The stack has as many planes as there are pages.
            let ifd = tiff.directory(directories.main[(offset + z * slice) as usize])?;
            let ifd = at_level(&tiff, ifd, level)?;
            gathered.add(&tiff, 0, &ifd, |n| {
                format!("page {}", offset + n as u64 * slice)
            })?;
        }
    }
    let mut about = About {
        spacing: stack.spacing,
        unit: stack.unit,
        scaling: stack.scaling,
        ..About::default()
    };
    about
        .details
        .extend((!stack.kind.is_empty()).then(|| ("notes", stack.kind.to_string())));
    about.note_levels(&start);
    about.note_missing(tiff.name(), &gathered);
    about.warnings.extend(stack.warnings.iter().cloned());
    let gathered = if stack.contiguous {
        contiguous(&tiff, page, gathered.start(), &stack, offset)?
    } else {
        gathered.into_planes(tiff.name())?
    };
    about.coarsen(extents, &gathered.1);
    let source = tiff.bytes.source();
    Ok(about.volume(
        Format::Tiff,
        source,
        gathered,
        tiff.order,
        choice.sample,
        stack.slices,
    ))
}

/// Where the directories of a file are.
struct Directories {
    /// All of the chain, at least one.
    all: Vec<u64>,
    /// Those that are no smaller copies or masks of others.
    main: Vec<u64>,
}

impl Directories {
    fn walk(tiff: &Tiff) -> Result<Self, Error> {
        let (mut all, mut main) = (Vec::new(), Vec::new());
        for ifd in tiff.directories() {
            let ifd = ifd?;
            all.push(ifd.at);
            if !is_secondary(tiff, &ifd)? {
                main.push(ifd.at);
            }
        }
        if all.is_empty() {
            return Err(Error::invalid(tiff.name(), "has no page").at(4));
        }
        Ok(Self { all, main })
    }
}

/// Which of the channels and points in time is read.
struct Choice {
    /// Channel of planes.
    channel: u64,
    /// Sample of the pixels.
    sample: u64,
    frame: u64,
}

impl Choice {
    /// What the options ask for. Channels are those of planes times samples of a pixel.
    fn of(
        name: &str,
        [channels, frames]: [u64; 2],
        layout: &Layout,
        palette_is_display: bool,
        context: &Context<'_>,
    ) -> Result<Self, Error> {
        let samples = layout.samples;
        let all = channels.saturating_mul(samples);
        let options = context.options;
        if options.channel.is_none() {
            match layout.colour {
                Colour::Rgb => {
                    return Err(Error::unsupported(
                        name,
                        format!(
                            "the pixels are colour (RGB), {samples} samples each; choose one with \
                             --channel N, 0 to {}",
                            all - 1
                        ),
                    ));
                }
                Colour::Palette if !palette_is_display => {
                    return Err(Error::unsupported(
                        name,
                        "the pixels are colour (palette); --channel 0 takes their numbers in the \
                         palette as values",
                    ));
                }
                _ => {}
            }
        }
        let channel = pick(name, "channels", "--channel", options.channel, all)?;
        let frame = pick(name, "volumes in time", "--frame", options.frame, frames)?;
        Ok(Self {
            channel: channel / samples,
            sample: channel % samples,
            frame,
        })
    }
}

/// The one of `count` that was asked for, or the only one.
fn pick(
    name: &str,
    what: &str,
    option: &str,
    asked: Option<u64>,
    count: u64,
) -> Result<u64, Error> {
    let last = count.saturating_sub(1);
    match asked {
        Some(n) if n < count => Ok(n),
        Some(n) => Err(Error::unsupported(
            name,
            format!("{option} {n} was asked for, but there are {count} {what}, 0 to {last}"),
        )),
        None if count == 1 => Ok(0),
        None => Err(Error::unsupported(
            name,
            format!("has {count} {what}; choose one with {option} N, 0 to {last}"),
        )),
    }
}

/// The error of an image with one plane.
fn flat(name: &str, [x, y]: [u64; 2]) -> Error {
    Error::unsupported(
        name,
        format!(
            "is one 2-D image of {x} x {y} pixels, and a volume has several planes: name the folder \
             of the slices, or a pattern such as 'slice_*.tif' in quotes"
        ),
    )
}

/// The planes behind a page that stands for all of them.
fn contiguous(
    tiff: &Tiff,
    page: Page,
    start: Option<u64>,
    stack: &Stack,
    offset: u64,
) -> Result<(Planes, Arc<Layout>), Error> {
    let layout = &page.layout;
    let all = stack
        .channels
        .saturating_mul(stack.slices)
        .saturating_mul(stack.frames);
    let Some(start) = start else {
        return Err(Error::unsupported(
            tiff.name(),
            format!(
                "{all} planes are noted, but only one page is listed and it is not plain bytes \
                 ({}, {})",
                layout.compression.name(),
                layout.in_words()
            ),
        ));
    };
    let plane = layout.row_bytes() * layout.height;
    let bytes = plane.saturating_mul(all);
    let found = tiff.bytes.len().saturating_sub(start);
    if found < bytes {
        return Err(ends_early(
            tiff.name(),
            tiff.bytes.len(),
            found,
            bytes,
            plane,
        ));
    }
    // All products are below `bytes`, which is part of the file.
    let first = start + offset * plane;
    let stride = stack.strides[1] * plane;
    let whole = Layout {
        block: [layout.width, layout.height],
        ..(**layout).clone()
    };
    let page = Page {
        layout: Arc::new(whole),
        place: Place::At(first),
        ..page
    };
    let layout = Arc::clone(&page.layout);
    let planes = Planes::Regular {
        tiff: tiff.clone(),
        page,
        first,
        stride,
    };
    Ok((planes, layout))
}

/// What is known beside the voxels.
#[derive(Default)]
struct About {
    spacing: Option<[f64; 3]>,
    unit: Unit,
    scaling: Option<Scaling>,
    details: Vec<(&'static str, String)>,
    warnings: Vec<String>,
}

impl About {
    fn note_levels(&mut self, ifd: &Ifd) {
        let levels = levels(ifd);
        self.details
            .extend((levels > 1).then(|| ("levels", levels.to_string())));
    }

    fn note_missing(&mut self, name: &str, gathered: &Gathered) {
        let missing = gathered.missing();
        self.warnings.extend((missing > 0).then(|| {
            format!(
                "{name}: {missing} strips or tiles are left out in the file; they are read as 0"
            )
        }));
    }

    /// Widens the spacing of pages of the given extents to that of a level of their pyramids.
    fn coarsen(&mut self, extents: [u64; 2], layout: &Layout) {
        if let Some(spacing) = &mut self.spacing {
            spacing[0] *= extents[0] as f64 / layout.width as f64;
            spacing[1] *= extents[1] as f64 / layout.height as f64;
        }
    }

    /// What to tell of how the pixels are stored.
    fn note_layout(&mut self, name: &str, layout: &Layout) {
        let predictor = match layout.predictor {
            Predictor::None => "",
            Predictor::Horizontal => ", horizontal predictor",
            Predictor::Float => ", floating point predictor",
        };
        self.details.push((
            "compression",
            format!("{}{predictor}", layout.compression.name()),
        ));
        self.details.push((
            "blocks",
            match (layout.tiled, layout.block) {
                (true, [x, y]) => format!("tiles of {x} x {y}"),
                (false, [_, y]) => format!("strips of {y} rows"),
            },
        ));
        if layout.bits != layout.voxel.bytes() * 8 {
            self.details.push(("bits", layout.bits.to_string()));
        }
        if layout.inverted() {
            self.details
                .push(("white", "stored as 0, turned round".into()));
        } else if layout.white_is_zero {
            self.warnings.push(format!(
                "{name}: 0 is to be shown white; values of {} are read as stored",
                layout.voxel
            ));
        }
        if layout.colour == Colour::Palette {
            self.warnings.push(format!(
                "{name}: values are numbers of colours in a palette, which is ignored"
            ));
        }
        if layout.compression == Compression::Jpeg {
            self.warnings.push(lossy(name));
        }
    }

    /// The volume of planes that were gathered.
    fn volume(
        mut self,
        format: Format,
        mut source: SourceInfo,
        (planes, layout): (Planes, Arc<Layout>),
        order: ByteOrder,
        sample: u64,
        slices: u64,
    ) -> Volume {
        self.note_layout(&source.name, &layout);
        let dtype = DType {
            voxel: layout.voxel,
            byte_order: order,
        };
        let dims = [layout.width, layout.height, slices];
        let mut header = Header::new(format, dims, dtype);
        header.spacing = self.spacing;
        header.unit = self.unit;
        header.scaling = self.scaling;
        header.details = self.details;
        header.warnings = self.warnings;
        source.compressed |= layout.compression != Compression::None;
        let planes = PlaneVoxels::new(planes, sample, dims);
        let voxels = planes.into_voxels(&source.name, &header);
        Volume {
            header,
            voxels: Voxels::Random(voxels),
            source,
        }
    }
}

/// The warning on values that went through JPEG.
pub(crate) fn lossy(name: &str) -> String {
    format!("{name}: JPEG changes values; surfaces near its blocks are not those of the object")
}
