//! Folders of TIFF files with one page each.
//!
//! In: the files, in order. Out: a volume whose planes are their pages. Each file is examined
//! once, closed, and opened again when its plane is wanted.

use std::fs::File;
use std::path::PathBuf;

use super::gather::{Gathered, at_level};
use super::ifd::{Tiff, tag};
use super::page::{Layout, Page};
use super::stack::{self, Stack};
use super::voxels::Source;
use super::{About, Choice, Directories, ome};
use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::{ByteOrder, Format};
use crate::map::Fingerprint;
use crate::options::{IoMode, OpenOptions};
use crate::parsed::Context;
use crate::volume::{SourceInfo, Volume};

/// Whether the file describes a volume of several files, of which it is one.
pub(crate) fn is_series(bytes: FileBytes) -> Result<bool, Error> {
    let tiff = Tiff::new(bytes)?;
    let directories = Directories::walk(&tiff)?;
    let first = tiff.directory(directories.all[0])?;
    let description = tiff.text(&first, tag::DESCRIPTION)?.unwrap_or_default();
    Ok(ome::is_series(&description))
}

/// The volume of slices in TIFF files, at least one.
pub(crate) fn open_slices(
    source: SourceInfo,
    paths: &[PathBuf],
    options: &OpenOptions,
) -> Result<Volume, Error> {
    let context = Context {
        name: &source.name.clone(),
        path: None,
        options,
        length: None,
    };
    let level = options.level.unwrap_or(0);
    let mut gathered = Gathered::default();
    let mut first: Option<(Stack, Choice, [u64; 2], ByteOrder)> = None;
    for path in paths {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|e| Error::io(&name, "cannot be opened", e))?;
        let metadata = file
            .metadata()
            .map_err(|e| Error::io(&name, "cannot be read", e))?;
        let closed = Source::Closed {
            path: path.clone(),
            fingerprint: Fingerprint::of(&metadata),
        };
        let tiff = Tiff::new(FileBytes::of_file(file, path, IoMode::Read)?)?;
        let directories = Directories::walk(&tiff)?;
        let [page] = directories.main.as_slice() else {
            return Err(several(&name, directories.main.len() as u64));
        };
        let ifd = tiff.directory(*page)?;
        if first.is_none() {
            let layout: &Layout = &Page::read(&tiff, &ifd, None)?.layout;
            let extents = [layout.width, layout.height];
            let stack = stack::read(&tiff, &ifd, 1, extents)?;
            let planes = stack
                .channels
                .saturating_mul(stack.slices)
                .saturating_mul(stack.frames);
            if planes > 1 {
                return Err(several(&name, planes));
            }
            let choice = Choice::of(
                &source.name,
                [1, 1],
                layout,
                stack.palette_is_display,
                &context,
            )?;
            first = Some((stack, choice, extents, tiff.order));
        }
        let number = gathered.add_source(closed, tiff.bytes.len());
        let ifd = at_level(&tiff, ifd, level)?;
        let label = |n: usize| {
            let path = paths.get(n).and_then(|path| path.file_name());
            path.map_or_else(
                || format!("slice {n}"),
                |name| name.to_string_lossy().into_owned(),
            )
        };
        gathered.add(&tiff, number, &ifd, label)?;
    }
    let Some((stack, choice, extents, order)) = first else {
        return Err(Error::unsupported(&source.name, "there are no slices"));
    };
    let mut about = About {
        scaling: stack.scaling,
        ..About::default()
    };
    if stack.depth_is_noted {
        (about.spacing, about.unit) = (stack.spacing, stack.unit);
    }
    about.note_missing(&source.name, &gathered);
    about.warnings.extend(stack.warnings);
    let gathered = gathered.into_planes(&source.name)?;
    about.coarsen(extents, &gathered.1);
    let slices = paths.len() as u64;
    Ok(about.volume(
        Format::Slices,
        source,
        gathered,
        order,
        choice.sample,
        slices,
    ))
}

fn several(name: &str, pages: u64) -> Error {
    Error::unsupported(
        name,
        format!(
            "has {pages} pages, where the slices of a folder have one each: name the file itself, \
             or a pattern without it"
        ),
    )
}
