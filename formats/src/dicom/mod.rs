//! DICOM: a folder with the files of a series, or one multi-frame file.
//!
//! In: a folder, or the bytes of a file. Out: a volume, one plane a chunk.
//!
//! - A folder's files and those of its subfolders are looked at, one level deep, as archives
//!   export them; what is not DICOM, has no pixels, or is called DICOMDIR is left out. Files are
//!   recognised by content, with or without the preamble.
//! - Planes are grouped into volumes (`series`), one is chosen, its planes are sorted by position
//!   and checked (`geometry`). Headers are read once; pixels are read when a plane is asked for,
//!   from a file that is opened then and must not have changed.
//! - Space is that of DICOM, in millimetres: x to the left, y to the back, z to the head (LPS).
//!   Formats with x to the right and y to the front (NIfTI) have the signs of x and y exchanged;
//!   nothing is converted.
//! - Voxels are the stored samples, RescaleSlope and RescaleIntercept (or DoseGridScaling) are
//!   the header's scaling. Where they differ from plane to plane, as in PET, voxels are the
//!   values, as `f32` (`f64` for 32-bit samples). MONOCHROME1 is not inverted.
//! - Syntaxes: native in either byte order, implicit or explicit, deflated, RLE, JPEG lossless
//!   and DCT of 8 and 12 bits, JPEG-LS, JPEG 2000.
//! - Multi-frame files have positions, spacing and scaling in functional groups, dose grids in
//!   offsets; segmentations have single bits.
//!
//! Refused by name: colour, palettes, Siemens mosaics, cine, single planes, uneven or sheared
//! stacks, planes that share a position, video, JPEG XL, high-throughput JPEG 2000 (the decoders
//! in Rust are months old).
//!
//! The parser is our own: of a data set it needs some forty elements, all of them short. The
//! crates of dicom-rs (0.10 was tried) hold whole data sets in memory and know no series; they
//! bring seventy crates, and need C++ for JPEG-LS. Damaged copies of small fixtures made them
//! hold up to 4 GiB and panic in 17 of some hundred compressed files. Of the codecs, JPEG 2000 is that
//! of `hayro-jpeg2000` (no `unsafe`, no further crates); the others are small and our own.

mod codec;

mod element;

mod fragments;

mod geometry;

mod image;

mod pixels;

mod place;

mod series;

mod stream;

mod syntax;

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use crate::bytes::FileBytes;
use crate::chunked::ChunkedVoxels;
use crate::error::Error;
use crate::header::{ByteOrder, Content, DType, Format, Header, Scaling, Unit, VoxelType};
use crate::options::OpenOptions;
use crate::parsed::Context;
use crate::volume::{SourceInfo, Volume, Voxels};

use fragments::Fragments;
use image::{Found, Image, SampleKind, Words};
use pixels::Planes;
use place::Place;
use series::Stack;

/// Whether content that begins with `head` is DICOM.
pub(crate) fn detect(head: &[u8]) -> bool {
    image::is_dicom(head)
}

/// Whether a folder, or one of its subfolders, holds DICOM files.
pub(crate) fn detect_folder(folder: &Path) -> bool {
    /// Files that are looked at before a folder counts as something else.
    const MOST_FILES: usize = 64;
    let Ok(Listing { files, folders }) = list(folder) else {
        return false;
    };
    let any = |files: &[PathBuf]| {
        files
            .iter()
            .take(MOST_FILES)
            .any(|path| is_dicom_file(path))
    };
    any(&files)
        || folders
            .iter()
            .take(MOST_FILES)
            .any(|folder| list(folder).is_ok_and(|listing| any(&listing.files)))
}

fn is_dicom_file(path: &Path) -> bool {
    const HEAD_BYTES: u64 = 1024;
    let mut head = Vec::new();
    File::open(path)
        .and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head))
        .is_ok()
        && detect(&head)
}

/// What a folder holds, sorted by name.
struct Listing {
    files: Vec<PathBuf>,
    folders: Vec<PathBuf>,
}

fn list(folder: &Path) -> std::io::Result<Listing> {
    let mut listing = Listing {
        files: Vec::new(),
        folders: Vec::new(),
    };
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        // Follows links; what cannot be examined or is no file (a pipe) is left out.
        match std::fs::metadata(&path) {
            Ok(metadata) if metadata.is_dir() => listing.folders.push(path),
            Ok(metadata) if metadata.is_file() => listing.files.push(path),
            _ => {}
        }
    }
    listing.files.sort();
    listing.folders.sort();
    Ok(listing)
}

/// Opens the volume in a folder.
pub(crate) fn open_folder(folder: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    let name = folder.display().to_string();
    let cannot_list = |e| Error::io(&name, "cannot be listed", e);
    let Listing { mut files, folders } = list(folder).map_err(cannot_list)?;
    for inner in folders {
        files.extend(list(&inner).map_err(cannot_list)?.files);
    }
    let mut scan = Scan::default();
    let mut other = 0_usize;
    for path in &files {
        if path.file_name().is_some_and(|name| name == "DICOMDIR") {
            continue;
        }
        let (place, bytes) = Place::of_file(path)?;
        match image::read(place, bytes, &mut scan.words)? {
            Found::Image(image) => scan.images.push(*image),
            Found::NoPixels(series) => scan.without_pixels.push((series, path.clone())),
            Found::NotDicom => other += 1,
        }
    }
    let mut notes = Vec::new();
    if other > 0 {
        notes.push(format!(
            "{name}: {other} files that are not DICOM were left out"
        ));
    }
    if !scan.without_pixels.is_empty() {
        notes.push(format!(
            "{name}: {} DICOM files without pixels were left out",
            scan.without_pixels.len()
        ));
    }
    let source = SourceInfo {
        path: Some(folder.to_path_buf()),
        re_readable: true,
        ..SourceInfo::stream(&name)
    };
    scan.open(&name, options, notes, source)
}

/// Opens the volume in one file.
pub(crate) fn open_file(bytes: FileBytes, context: &Context<'_>) -> Result<Volume, Error> {
    let mut scan = Scan::default();
    let source = bytes.source();
    match image::read(Place::Bytes(bytes.clone()), bytes, &mut scan.words)? {
        Found::Image(image) => scan.images.push(*image),
        Found::NoPixels(_) => {
            return Err(Error::unsupported(
                context.name,
                "this DICOM file has no pixels (a report, a plan, an index)",
            ));
        }
        Found::NotDicom => return Err(Error::invalid(context.name, "is not a DICOM file")),
    }
    scan.open(context.name, context.options, Vec::new(), source)
}

/// Images that were found.
#[derive(Default)]
struct Scan {
    images: Vec<Image>,
    words: Words,
    /// Files without, and their series.
    without_pixels: Vec<(String, PathBuf)>,
}

impl Scan {
    /// The volume that is wanted of those that the images make.
    fn open(
        self,
        name: &str,
        options: &OpenOptions,
        notes: Vec<String>,
        mut source: SourceInfo,
    ) -> Result<Volume, Error> {
        let Self {
            images,
            words,
            without_pixels,
        } = self;
        if images.is_empty() {
            return Err(Error::unsupported(name, "holds no DICOM image"));
        }
        let stacks = series::stacks(&images, &words);
        let (stack, left_out) = series::choose(stacks, &images, name, options)?;
        let (images, mut stack) = used(images, stack);
        if let [plane] = stack.planes.as_slice() {
            return Err(Error::unsupported(
                name,
                format!(
                    "{} is one plane; a volume is needed: name the folder that holds the files of \
                     its series",
                    plane.name(&images)
                ),
            ));
        }
        let series = &images[0].series_uid;
        if let Some((_, path)) = without_pixels.iter().find(|(of, _)| of == series) {
            return Err(Error::invalid(
                path.display().to_string(),
                "is of the series, but has no pixels: the file was cut, or it is no image and \
                 does not belong here",
            ));
        }
        for image in &images {
            pixels::check(image)?;
        }
        let geometry = geometry::arrange(&mut stack.planes, &images, name)?;

        let first = &images[stack.planes[0].image];
        let dims = [
            u64::from(first.columns),
            u64::from(first.rows),
            stack.planes.len() as u64,
        ];
        let scalings = Scalings::of(&stack, &images);
        let voxel = match (&scalings, first.allocated) {
            (Scalings::Different, 1 | 8 | 16) => VoxelType::F32,
            (Scalings::Different, _) => VoxelType::F64,
            // Checked above.
            _ => pixels::voxel_type(first).unwrap_or(VoxelType::U8),
        };
        let mut header = Header::new(Format::Dicom, dims, DType::little(voxel));
        header.byte_order = ByteOrder::Little;
        header.spacing = geometry.spacing;
        if geometry.spacing.is_some() {
            header.unit = Unit::Millimetre;
        }
        header.origin = geometry.origin;
        header.direction = geometry.direction;
        if let Scalings::One(scaling) = scalings {
            header.scaling = Some(scaling);
        }
        if first.modality == "SEG" && first.allocated == 1 {
            header.content = Content::Mask;
        }
        header.details = details(&stack, &images, geometry.order);
        header.warnings = notes;
        header.warnings.extend(left_out);
        header.warnings.extend(geometry.warnings);
        header
            .warnings
            .extend(warnings(&stack, &images, name, &scalings, voxel));

        let mut fragments = HashMap::new();
        for (i, image) in images.iter().enumerate() {
            if matches!(image.syntax, syntax::Syntax::Encapsulated(_)) && image.frames.len() > 1 {
                fragments.insert(i, Fragments::find(image, &image.place.bytes()?)?);
            }
        }
        source.compressed |= images
            .iter()
            .any(|image| !matches!(image.syntax, syntax::Syntax::Native));
        source.mapped = false;
        let planes = Planes {
            values: matches!(scalings, Scalings::Different).then_some(voxel),
            images,
            planes: stack.planes,
            fragments,
            inflating: Mutex::new(None),
        };
        source.held_bytes += planes.held_bytes();
        let chunk = [dims[0], dims[1], 1];
        let voxels = ChunkedVoxels::new(name, &header, chunk, Box::new(planes));
        Ok(Volume {
            header,
            voxels: Voxels::Random(Box::new(voxels)),
            source,
        })
    }
}

/// The images that a stack uses, and the stack renumbered.
fn used(images: Vec<Image>, mut stack: Stack) -> (Vec<Image>, Stack) {
    let mut numbers = BTreeMap::new();
    for plane in &stack.planes {
        numbers.insert(plane.image, 0);
    }
    for (new, number) in numbers.values_mut().enumerate() {
        *number = new;
    }
    let images = images
        .into_iter()
        .enumerate()
        .filter(|(i, _)| numbers.contains_key(i))
        .map(|(_, image)| image)
        .collect();
    for plane in &mut stack.planes {
        plane.image = numbers[&plane.image];
    }
    (images, stack)
}

/// How the planes of a stack are scaled.
enum Scalings {
    /// Not at all.
    None,
    One(Scaling),
    /// From plane to plane otherwise.
    Different,
}

impl Scalings {
    fn of(stack: &Stack, images: &[Image]) -> Self {
        let first = pixels::scaling(stack.planes[0], images);
        let same = stack
            .planes
            .iter()
            .all(|&plane| pixels::scaling(plane, images) == first);
        match (same, first.slope == 1.0 && first.intercept == 0.0) {
            (true, true) => Self::None,
            (true, false) => Self::One(first),
            (false, _) => Self::Different,
        }
    }
}

/// Facts for print.
fn details(stack: &Stack, images: &[Image], order: &str) -> Vec<(&'static str, String)> {
    let image = &images[stack.planes[0].image];
    let mut details = vec![("series", image.series_uid.clone())];
    let mut push = |name, value: String| {
        if !value.is_empty() {
            details.push((name, value));
        }
    };
    push("description", image.description.clone());
    push("modality", image.modality.clone());
    push("volume", stack.label().to_string());
    push("files", images.len().to_string());
    push("order of planes", order.to_string());
    push("space", "LPS (x left, y back, z head)".into());
    let mut compression: Vec<_> = images.iter().map(|image| image.syntax.name()).collect();
    compression.sort_unstable();
    compression.dedup();
    push("compression", compression.join("; "));
    if image.kind != SampleKind::Float {
        push("bits stored", image.stored.to_string());
    }
    if let Some(padding) = image.padding {
        push("padding value", padding.to_string());
    }
    details
}

/// What a user should be told of the pixels.
fn warnings(
    stack: &Stack,
    images: &[Image],
    name: &str,
    scalings: &Scalings,
    voxel: VoxelType,
) -> Vec<String> {
    let image = &images[stack.planes[0].image];
    let mut warnings = Vec::new();
    if matches!(scalings, Scalings::Different) {
        warnings.push(format!(
            "{name}: RescaleSlope or RescaleIntercept differ from plane to plane: voxels are the \
             scaled values, as {voxel}"
        ));
    }
    let zero = |plane: &series::Plane| plane.frame(images).slope == Some(0.0);
    if stack.planes.iter().any(zero) {
        warnings.push(format!("{name}: a RescaleSlope of 0 is ignored"));
    }
    if images.iter().any(|image| image.lookup) {
        warnings.push(format!(
            "{name}: a modality lookup table is not applied: voxels are the stored values"
        ));
    }
    if images.iter().any(|image| image.lossy) {
        warnings.push(format!(
            "{name}: the pixels were compressed with loss at some time"
        ));
    }
    if images
        .iter()
        .any(|image| image.photometric == "MONOCHROME1")
    {
        warnings.push(format!(
            "{name}: low values are meant to be shown bright (MONOCHROME1); voxels are not \
             inverted"
        ));
    }
    if let Some(from) = image.spacing_from {
        warnings.push(format!("{name}: the pixel spacing is that of {from}"));
    }
    warnings
}
