//! Folders of slices: one image a plane.
//!
//! In: a folder, or a pattern such as `scan/slice_*.tif`. Out: a volume whose planes are the
//! images, in the order of their names: runs of digits count as numbers, so `slice_2` comes
//! before `slice_10`. The rooms: `names` (order, patterns, gaps in the numbers), `images` (PNG,
//! JPEG and PGM; TIFF is in its own module).
//!
//! What a file is, its content says. In a folder, hidden files, sub-folders and files that are no
//! images are left out, with a note; a pattern must match images only. All slices must be of one
//! kind, size and type, and the two that are not are named. A folder with one image is that
//! file. Slices of OME-TIFF that belong together are read as their OME-XML says. The spacing is
//! known only where ImageJ noted it.
//!
//! Guaranteed: a file is open only while it is examined or a plane is read from it, so folders
//! may have any number; a slice that changed or vanished meanwhile is an error that names it;
//! memory is one slice and what it becomes, and some hundred bytes for each file.
//!
//! One image alone is refused: it has no third dimension.

mod images;

mod names;

use std::path::{Path, PathBuf};

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::Format;
use crate::open::open;
use crate::options::{IoMode, OpenOptions};
use crate::parsed::Context;
use crate::tiff;
use crate::volume::{SourceInfo, Volume};

pub(crate) use names::is_pattern;

/// What sort of image a slice is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Tiff,
    Png,
    Jpeg,
    Pgm,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Tiff => "TIFF",
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::Pgm => "PGM",
        }
    }

    /// The kind that content begins like.
    fn of(head: &[u8]) -> Option<Self> {
        if tiff::detect(head) {
            Some(Self::Tiff)
        } else if head.starts_with(images::PNG_MAGIC) {
            Some(Self::Png)
        } else if head.starts_with(crate::jpeg::MAGIC) {
            Some(Self::Jpeg)
        } else if head.starts_with(b"P5") && head.get(2).is_some_and(u8::is_ascii_whitespace) {
            Some(Self::Pgm)
        } else {
            None
        }
    }

    /// The kind of the image at `path`, if it is one.
    fn of_file(path: &Path) -> Result<Option<Self>, Error> {
        const HEAD_BYTES: u64 = 132;
        let bytes = FileBytes::open(path, IoMode::Read)?;
        let head = bytes.read(0, bytes.len().min(HEAD_BYTES))?;
        Ok(Self::of(&head))
    }
}

/// Whether content is an image that can only be a slice.
pub(crate) fn is_image(head: &[u8]) -> bool {
    matches!(Kind::of(head), Some(Kind::Png | Kind::Jpeg))
}

/// Refuses an image that is not part of a folder.
pub(crate) fn refuse_one(bytes: FileBytes, _: &Context<'_>) -> Result<Volume, Error> {
    Err(Error::unsupported(
        bytes.name(),
        "is one 2-D image (PNG or JPEG), and a volume has several planes: name the folder of the \
         slices, or a pattern such as 'slice_*.png' in quotes",
    ))
}

/// Whether a folder has slices in it. Looks at some files only.
pub(crate) fn detect(folder: &Path) -> bool {
    /// Slices are most of the files of their folder.
    const LOOKED_AT: usize = 64;
    let Ok(list) = names::in_folder(folder) else {
        return false;
    };
    let mut files = list.files.iter().take(LOOKED_AT);
    files.any(|path| matches!(Kind::of_file(path), Ok(Some(_))))
}

/// Opens the volume that the images in a folder make up.
pub(crate) fn open_folder(folder: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    let name = folder.display().to_string();
    let mut list = names::in_folder(folder)?;
    let mut slices = Vec::new();
    for path in list.files.drain(..) {
        match Kind::of_file(&path)? {
            Some(kind) => slices.push((path, kind)),
            None => list.others.push(path),
        }
    }
    let mut warnings = Vec::new();
    if let Some(first) = list.others.first() {
        warnings.push(format!(
            "{name}: {} entries that are no slices are left out, {} for one",
            list.others.len(),
            names::file_name(first)
        ));
    }
    open_list(folder, &name, slices, warnings, options)
}

/// Opens the volume that the files matching a pattern make up.
pub(crate) fn open_pattern(pattern: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    let name = pattern.display().to_string();
    let files = names::matching(pattern)?;
    let mut slices = Vec::new();
    for path in files {
        let Some(kind) = Kind::of_file(&path)? else {
            return Err(Error::unsupported(
                path.display().to_string(),
                "matches the pattern, but is no TIFF, PNG, JPEG or PGM image",
            ));
        };
        slices.push((path, kind));
    }
    let folder = pattern.parent().unwrap_or(Path::new(""));
    open_list(folder, &name, slices, Vec::new(), options)
}

fn open_list(
    folder: &Path,
    name: &str,
    slices: Vec<(PathBuf, Kind)>,
    mut warnings: Vec<String>,
    options: &OpenOptions,
) -> Result<Volume, Error> {
    let Some((first, kind)) = slices.first().cloned() else {
        return Err(Error::unsupported(
            name,
            "there are no slices: expected TIFF, PNG, JPEG or PGM images",
        ));
    };
    if let Some((other, found)) = slices.iter().find(|(_, other)| *other != kind) {
        return Err(Error::unsupported(
            name,
            format!(
                "slices of different kinds: {} is {}, {} is {}",
                names::file_name(&first),
                kind.name(),
                names::file_name(other),
                found.name()
            ),
        ));
    }
    let series = kind == Kind::Tiff && tiff::is_series(FileBytes::open(&first, IoMode::Read)?)?;
    if slices.len() == 1 || series {
        // The format asked for was that of the folder.
        let options = OpenOptions {
            format: None,
            region: None,
            ..options.clone()
        };
        let mut volume = open(&first, &options)?;
        if series {
            warnings.push(format!(
                "{name}: read as the OME-XML of {} says",
                names::file_name(&first)
            ));
        }
        volume.header.warnings.extend(warnings);
        return Ok(volume);
    }
    if let Some(dataset) = &options.dataset {
        return Err(Error::unsupported(
            name,
            format!("dataset {dataset} was asked for, but slices have no names of that sort"),
        ));
    }
    let paths: Vec<PathBuf> = slices.into_iter().map(|(path, _)| path).collect();
    warnings.extend(names::doubts(&paths).map(|doubt| format!("{name}: {doubt}")));
    let source = SourceInfo {
        path: Some(folder.to_path_buf()),
        re_readable: true,
        ..SourceInfo::stream(name)
    };
    let mut volume = match kind {
        Kind::Tiff => tiff::open_slices(source, &paths, options)?,
        Kind::Png => images::open(source, &paths, &images::Png, options)?,
        Kind::Jpeg => images::open(source, &paths, &images::Jpeg, options)?,
        Kind::Pgm => images::open(source, &paths, &images::Pgm, options)?,
    };
    debug_assert_eq!(volume.header.format, Format::Slices);
    let digits = volume.header.dims[2].to_string();
    volume
        .header
        .details
        .insert(0, ("slices", format!("{digits} {} files", kind.name())));
    warnings.append(&mut volume.header.warnings);
    volume.header.warnings = warnings;
    Ok(volume)
}
