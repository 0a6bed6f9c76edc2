//! OME-TIFF: which page of which file is which plane, by the OME-XML of the first page.
//!
//! In: the XML, and the file it was found in. Out: the planes of one image, channel and point in
//! time. Pages may be in other files beside this one, and the XML may be in a companion file;
//! both must be in the same folder unless the caller allows others. Files are told by their
//! UUID first, so that one that was renamed is still itself. Guaranteed: memory follows the XML,
//! not the sizes it claims; each plane of the volume is listed, or it is refused.

mod xml;

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use super::gather::{Gathered, at_level};
use super::ifd::Tiff;
use super::page::Page;
use super::voxels::{Source, reopen};
use super::{About, Choice, Directories, flat, units};
use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::{Format, Unit};
use crate::map::Fingerprint;
use crate::options::{IoMode, OpenOptions};
use crate::parsed::{Context, beside, is_plausible_spacing};
use crate::volume::Volume;
use xml::{Image, Ome, TiffData};

/// Whether the description of a page is OME-XML.
pub(super) fn detect(description: &[u8]) -> bool {
    /// The root element is near the beginning, behind a comment on how to edit the file.
    const HEAD_BYTES: usize = 4096;
    let head = &description[..description.len().min(HEAD_BYTES)];
    head.first() == Some(&b'<') && (find(head, b"<OME ") || find(head, b":OME "))
}

fn find(text: &[u8], word: &[u8]) -> bool {
    text.windows(word.len()).any(|window| window == word)
}

/// Files of one data set.
struct Files<'a> {
    /// The file that was opened, and its pages.
    tiff: &'a Tiff,
    directories: &'a Directories,
    /// The file that the names of others are relative to; `None` for a stream.
    path: Option<&'a Path>,
    options: &'a OpenOptions,
    /// Others, by name.
    others: BTreeMap<&'a str, Other>,
}

/// Another file, and where its pages are. It is not kept open: there may be thousands.
struct Other {
    path: PathBuf,
    fingerprint: Fingerprint,
    pages: Vec<u64>,
}

/// A page: the name of its file (`None` for this one) and its number there.
type Spot<'a> = (Option<&'a str>, u64);

/// Opens the image that the OME-XML of `tiff` describes.
pub(super) fn open(
    tiff: &Tiff,
    directories: &Directories,
    description: &[u8],
    context: &Context<'_>,
) -> Result<Volume, Error> {
    let ome = describe(tiff, description, context)?;
    let name = tiff.name();
    let image = choose_image(name, &ome, context.options.dataset.as_deref())?;
    let bad = |what: String| {
        Error::invalid(
            name,
            format!("the OME-XML of image {}: {what}", image.label()),
        )
    };
    let samples = image.samples.max(1);
    if image.sizes.contains(&0) || image.sizes[3] % samples != 0 {
        return Err(bad(format!(
            "has sizes X Y Z C T of {:?} and {samples} samples a pixel",
            image.sizes
        )));
    }
    let [x, y, slices, channels, frames] = image.sizes;
    let counts = [channels / samples, frames];
    let first = tiff.directory(directories.all[0])?;
    let page = Page::read(tiff, &first, None)?;
    let choice = Choice::of(name, counts, &page.layout, false, context)?;
    if slices < 2 {
        return Err(flat(name, [x, y]));
    }
    let mut files = Files {
        tiff,
        directories,
        path: context.path,
        options: context.options,
        others: BTreeMap::new(),
    };
    let spots = files.spots(&ome, image, counts, [choice.channel, choice.frame])?;
    if spots.len() as u64 != slices {
        let lost = (0..slices).find(|z| !spots.contains_key(z)).unwrap_or(0);
        return Err(bad(format!(
            "lists {} of {slices} planes; the first that is missing is z {lost}",
            spots.len()
        )));
    }
    let (gathered, extents) = files.gather(&spots)?;
    if extents != [x, y] {
        return Err(bad(format!(
            "says {x} x {y} pixels, but the pages have {} x {}",
            extents[0], extents[1]
        )));
    }
    let mut about = About::default();
    space(name, image, &mut about);
    about.details.push(("notes", "OME".into()));
    about.details.push(("image", image.label()));
    about.note_levels(&first);
    about.note_missing(name, &gathered);
    let gathered = gathered.into_planes(name)?;
    about.coarsen(extents, &gathered.1);
    let source = tiff.bytes.source();
    Ok(about.volume(
        Format::Tiff,
        source,
        gathered,
        tiff.order,
        choice.sample,
        slices,
    ))
}

/// The OME-XML, from the companion file if the description only names one.
fn describe(tiff: &Tiff, description: &[u8], context: &Context<'_>) -> Result<Ome, Error> {
    let ome = xml::parse(description).map_err(|what| damaged(tiff.name(), &what))?;
    let Some(named) = &ome.companion else {
        return Ok(ome);
    };
    let path = context.beside(named)?;
    let bytes = FileBytes::open(&path, context.options.io)?;
    let text = bytes.read(0, bytes.len())?;
    let mut companion = xml::parse(&text).map_err(|what| damaged(bytes.name(), &what))?;
    bytes.check()?;
    // Which of the files this one is, only its own XML says.
    companion.uuid = ome.uuid;
    Ok(companion)
}

fn damaged(name: &str, what: &str) -> Error {
    Error::invalid(name, format!("the OME-XML is damaged: {what}"))
}

/// The image with that name, ID or number, or the only one.
fn choose_image<'a>(name: &str, ome: &'a Ome, asked: Option<&str>) -> Result<&'a Image, Error> {
    /// More are not worth reading in a message.
    const SHOWN: usize = 20;
    let list = || {
        let labels: Vec<_> = ome.images.iter().take(SHOWN).map(Image::label).collect();
        let more = ome.images.len().saturating_sub(SHOWN);
        match more {
            0 => labels.join(", "),
            n => format!("{} and {n} more", labels.join(", ")),
        }
    };
    match (asked, ome.images.as_slice()) {
        (_, []) => Err(Error::invalid(name, "the OME-XML describes no image")),
        (None, [image]) => Ok(image),
        (None, images) => Err(Error::unsupported(
            name,
            format!(
                "has {} images: {}; choose one with --dataset NAME",
                images.len(),
                list()
            ),
        )),
        (Some(asked), images) => images
            .iter()
            .find(|image| image.name == asked || image.id == asked)
            .or_else(|| images.get(asked.parse::<usize>().ok()?))
            .ok_or_else(|| {
                Error::unsupported(
                    name,
                    format!("there is no image '{asked}'; there are: {}", list()),
                )
            }),
    }
}

/// Whether the OME-XML of a page describes more than that page.
pub(super) fn is_series(description: &[u8]) -> bool {
    detect(description)
        && xml::parse(description).is_ok_and(|ome| {
            ome.companion.is_some()
                || ome.images.len() > 1
                || ome.images.iter().any(|image| {
                    let [.., z, c, t] = image.sizes;
                    z.saturating_mul(c).saturating_mul(t) > image.samples.max(1)
                })
        })
}

/// Fills in the spacing, if the image has all of it.
fn space(name: &str, image: &Image, about: &mut About) {
    let edges = [0, 1, 2].map(|a| {
        let (size, unit) = image.physical[a].as_ref()?;
        let size: f64 = size.trim().parse().ok()?;
        // Without a unit, micrometres are meant.
        let (unit, factor) = units::length(unit.as_deref().unwrap_or("um"))?;
        let edge = size * factor;
        is_plausible_spacing(edge).then_some((edge, unit))
    });
    match edges {
        [Some((x, unit)), Some((y, y_unit)), Some((z, z_unit))] => {
            // All in the unit of x.
            let ratio = |other: Unit| match (other.metres(), unit.metres()) {
                (Some(other_metres), Some(metres)) if other != unit => other_metres / metres,
                _ => 1.0,
            };
            about.spacing = Some([x, y * ratio(y_unit), z * ratio(z_unit)]);
            about.unit = unit;
        }
        [None, None, None] => {}
        [x, y, z] => {
            let shown =
                [x, y, z].map(|e| e.map_or("unknown".into(), |(s, unit)| format!("{s} {unit}")));
            about.warnings.push(format!(
                "{name}: the OME-XML says voxels of {}: lengths are in voxels unless --spacing is \
                 given",
                shown.join(" x ")
            ));
        }
    }
}

impl<'a> Files<'a> {
    /// Where the planes of a channel and point in time are, by z.
    fn spots(
        &mut self,
        ome: &'a Ome,
        image: &'a Image,
        [channels, frames]: [u64; 2],
        [channel, frame]: [u64; 2],
    ) -> Result<BTreeMap<u64, Spot<'a>>, Error> {
        let slices = image.sizes[2];
        // Number of a plane in the order of the image, and back.
        let order = image.order(self.tiff.name())?;
        let counts = [slices, channels, frames];
        let number = |at: [u64; 3]| -> Option<u64> {
            let [a, b, c] = order.map(|axis| at[axis]);
            let [na, nb, _] = order.map(|axis| counts[axis]);
            c.checked_mul(nb)?
                .checked_add(b)?
                .checked_mul(na)?
                .checked_add(a)
        };
        let at = |n: u64| -> [u64; 3] {
            let [na, nb, _] = order.map(|axis| counts[axis]);
            let along = [n % na, n / na % nb, n / na / nb];
            let mut at = [0; 3];
            for (axis, value) in order.into_iter().zip(along) {
                at[axis] = value;
            }
            at
        };
        let mut spots = BTreeMap::new();
        for data in &image.tiff_data {
            let TiffData {
                first, ifd, count, ..
            } = *data;
            if first.iter().zip(counts).any(|(n, count)| *n >= count) {
                return Err(damaged(
                    self.tiff.name(),
                    &format!("a plane Z C T {first:?} is listed, but there are {counts:?}"),
                ));
            }
            let Some(start) = number(first) else { continue };
            // One plane is the usual case, and then most files need not be looked at.
            if count == Some(1) && (first[1], first[2]) != (channel, frame) {
                continue;
            }
            let file = data.file.as_ref().filter(|file| !self.is_this(ome, file));
            let file = file.map(|file| file.name.as_str());
            let pages = self.page_count(file)?;
            let left = pages.saturating_sub(ifd);
            let count = count.unwrap_or(left);
            if count > left {
                return Err(damaged(
                    self.tiff.name(),
                    &format!("it lists {count} pages from page {ifd} on, but the file has {pages}"),
                ));
            }
            for i in 0..count {
                let Some(n) = start.checked_add(i) else { break };
                let [z, c, t] = at(n);
                if t >= frames {
                    break;
                }
                if (c, t) == (channel, frame) {
                    spots.insert(z, (file, ifd + i));
                }
            }
        }
        Ok(spots)
    }

    /// Whether a file that the XML names is the one that was opened.
    fn is_this(&self, ome: &Ome, file: &xml::FileName) -> bool {
        if ome.uuid.is_some() && ome.uuid == file.uuid {
            return true;
        }
        let own = self.path.and_then(Path::file_name);
        own.is_some_and(|own| own == file.name.as_str())
    }

    /// How many pages a file has. Other files are opened for that.
    fn page_count(&mut self, file: Option<&'a str>) -> Result<u64, Error> {
        let Some(named) = file else {
            return Ok(self.directories.all.len() as u64);
        };
        if let Some(other) = self.others.get(named) {
            return Ok(other.pages.len() as u64);
        }
        let Some(here) = self.path else {
            return Err(Error::unsupported(
                self.tiff.name(),
                format!(
                    "some planes are in another file, '{named}', which cannot be found from a stream"
                ),
            ));
        };
        let path = beside(here, named, self.options.outside)
            .map_err(|message| Error::unsupported(self.tiff.name(), message))?;
        let name = path.display().to_string();
        let file = File::open(&path).map_err(|e| Error::io(&name, "cannot be opened", e))?;
        let metadata = file
            .metadata()
            .map_err(|e| Error::io(&name, "cannot be read", e))?;
        let other = Other {
            fingerprint: Fingerprint::of(&metadata),
            pages: Directories::walk(&Tiff::new(FileBytes::of_file(file, &path, IoMode::Read)?)?)?
                .all,
            path,
        };
        let count = other.pages.len() as u64;
        self.others.insert(named, other);
        Ok(count)
    }

    /// The pages at `spots`, and the extents of the first at level 0.
    fn gather(&self, spots: &BTreeMap<u64, Spot<'a>>) -> Result<(Gathered, [u64; 2]), Error> {
        /// Fewer files than this are kept open.
        const OPEN_FILES: usize = 16;
        let keep = self.others.len() < OPEN_FILES;
        let level = self.options.level.unwrap_or(0);
        let mut gathered = Gathered::default();
        let mut numbers = BTreeMap::new();
        let mut extents = None;
        let mut last: Option<(Option<&str>, Tiff)> = None;
        for (file, page) in spots.values().copied() {
            let tiff = match (last.take(), file.and_then(|file| self.others.get(file))) {
                (Some((named, tiff)), _) if named == file => tiff,
                (_, None) => self.tiff.clone(),
                (_, Some(other)) => reopen(&other.path, &other.fingerprint, self.options.io)?,
            };
            let number = *numbers.entry(file).or_insert_with(|| {
                let source = match file.and_then(|file| self.others.get(file)) {
                    Some(other) if !keep => Source::Closed {
                        path: other.path.clone(),
                        fingerprint: other.fingerprint.clone(),
                    },
                    _ => Source::Open(tiff.clone()),
                };
                gathered.add_source(source, tiff.bytes.len())
            });
            let pages = match file.and_then(|file| self.others.get(file)) {
                Some(other) => &other.pages,
                None => &self.directories.all,
            };
            // `spots` checked the number against these pages.
            let ifd = tiff.directory(pages[page as usize])?;
            if extents.is_none() {
                let layout = Page::read(&tiff, &ifd, None)?.layout;
                extents = Some([layout.width, layout.height]);
            }
            let ifd = at_level(&tiff, ifd, level)?;
            gathered.add(&tiff, number, &ifd, |z| format!("the page of z {z}"))?;
            last = Some((file, tiff));
        }
        Ok((gathered, extents.unwrap_or([0; 2])))
    }
}
