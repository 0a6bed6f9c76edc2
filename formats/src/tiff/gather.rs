//! The pages that were chosen, checked one by one on their way to a volume.
//!
//! In: offsets of directories, in the order of the planes. Out: [`Planes`]. Guaranteed: all
//! pages have one size and type; each block they list is inside its file and can hold what it
//! promises; the tables of all pages together are not longer than the files, so that a small file
//! cannot keep the program busy; pages that are plain bytes one behind the other are found out.

use std::sync::Arc;

use super::ifd::{Entry, Ifd, Tiff, tag};
use super::page::{Compression, Layout, Page, Place};
use super::voxels::{Planes, Source};
use crate::error::Error;
use crate::header::ByteOrder;

/// Pages, in the order of the planes.
#[derive(Default)]
pub(super) struct Gathered {
    sources: Vec<Source>,
    pages: Vec<(u32, Page)>,
    order: Option<ByteOrder>,
    /// Bytes of all tables read, and of all files: the first must not be more.
    tables_bytes: u64,
    files_bytes: u64,
    /// Uncompressed pages one behind the other: where they start, and where the next would.
    run: Option<(u64, u64)>,
    is_run: bool,
    /// Blocks that the files leave out.
    missing: u64,
}

impl Gathered {
    /// Counts in another file, of the given length, and gives its number.
    pub(super) fn add_source(&mut self, source: Source, bytes: u64) -> u32 {
        self.is_run = self.sources.is_empty();
        self.sources.push(source);
        self.files_bytes = self.files_bytes.saturating_add(bytes);
        // The caller lists files it found on a disk.
        (self.sources.len() - 1) as u32
    }

    /// Adds the page of the directory `ifd` as the next plane. `label` names a plane.
    pub(super) fn add(
        &mut self,
        tiff: &Tiff,
        source: u32,
        ifd: &Ifd,
        label: impl Fn(usize) -> String,
    ) -> Result<(), Error> {
        let like = self.pages.last().map(|(_, page)| &page.layout);
        let page = Page::read(tiff, ifd, like)?;
        let number = self.pages.len();
        if let Some((_, first)) = self.pages.first() {
            if !page.layout.same_voxels(&first.layout) {
                return Err(Error::invalid(
                    tiff.name(),
                    format!(
                        "not one volume: {} has {}, {} has {}",
                        label(0),
                        first.layout.in_words(),
                        label(number),
                        page.layout.in_words()
                    ),
                )
                .at(ifd.at));
            }
            if self.order != Some(tiff.order) && page.layout.voxel.bytes() > 1 {
                return Err(Error::unsupported(
                    tiff.name(),
                    format!("{} and {} differ in byte order", label(0), label(number)),
                ));
            }
        }
        self.order = Some(tiff.order);
        self.scan(tiff, ifd, &page)?;
        self.pages.push((source, page));
        Ok(())
    }

    /// Looks at every block a page lists.
    fn scan(&mut self, tiff: &Tiff, ifd: &Ifd, page: &Page) -> Result<(), Error> {
        let layout = &*page.layout;
        let Place::Tables { offsets, counts } = page.place else {
            return Ok(());
        };
        let offsets = self.table(tiff, &offsets)?;
        let counts = counts.map(|counts| self.table(tiff, &counts)).transpose()?;
        let [across, down] = layout.blocks();
        let planes = if layout.planar { layout.samples } else { 1 };
        let (mut stored, mut promised, mut missing) = (0_u64, 0_u64, 0);
        let mut run = None;
        let mut is_run = !layout.tiled && layout.is_plain();
        // Page::read has checked that the tables are as long as that.
        for index in 0..across * down * planes {
            let at = index as usize;
            let row = index / across % down;
            let expected = layout.row_bytes() * layout.block_rows(row);
            let offset = offsets.get(at).copied().unwrap_or(0);
            let count = match &counts {
                Some(counts) => counts.get(at).copied().unwrap_or(0),
                None => expected,
            };
            if offset == 0 && count == 0 {
                missing += 1;
                is_run = false;
                continue;
            }
            if offset
                .checked_add(count)
                .is_none_or(|end| end > tiff.bytes.len())
            {
                return Err(Error::invalid(
                    tiff.name(),
                    format!(
                        "the file ends early: strip or tile {index} of a page is {count} bytes at \
                         byte {offset}, the file has {}",
                        tiff.bytes.len()
                    ),
                )
                .at(offset));
            }
            if layout.compression == Compression::None && count < expected {
                return Err(Error::invalid(
                    tiff.name(),
                    format!("a strip or tile has {count} bytes, expected {expected}"),
                )
                .at(offset));
            }
            stored = stored.saturating_add(count);
            promised = promised.saturating_add(expected);
            let (start, next) = run.unwrap_or((offset, offset));
            is_run &= next == offset;
            run = Some((start, next.saturating_add(expected)));
        }
        self.check_ratio(tiff, ifd, layout, [stored, promised, missing])?;
        self.missing += missing;
        self.is_run &= is_run;
        if let Some((start, next)) = run {
            let before = self.run.unwrap_or((start, start));
            self.is_run &= before.1 == start;
            self.run = Some((before.0, next));
        }
        Ok(())
    }

    /// The values of a table of offsets or lengths.
    fn table(&mut self, tiff: &Tiff, entry: &Entry) -> Result<Vec<u64>, Error> {
        let bytes = entry.count.saturating_mul(entry.value_bytes().unwrap_or(8));
        self.tables_bytes = self.tables_bytes.saturating_add(bytes);
        if self.tables_bytes > self.files_bytes {
            return Err(Error::invalid(
                tiff.name(),
                "the tables of strips or tiles overlap: together they are longer than the file",
            )
            .at(entry.at));
        }
        let mut values = Vec::new();
        tiff.for_each_value(entry, |value| {
            values.push(value);
            Ok(())
        })?;
        Ok(values)
    }

    /// Refuses a page that its stored bytes cannot possibly hold.
    fn check_ratio(
        &self,
        tiff: &Tiff,
        ifd: &Ifd,
        layout: &Layout,
        [stored, promised, missing]: [u64; 3],
    ) -> Result<(), Error> {
        /// A block that is left out stands for at most this much: tiles are small.
        const MISSING_BYTES: u64 = 16 << 20;
        let most = stored.saturating_mul(layout.compression.most(layout.row_bytes()));
        let block = layout.row_bytes().saturating_mul(layout.block[1]);
        if promised <= most && (missing == 0 || block <= MISSING_BYTES) {
            return Ok(());
        }
        Err(Error::invalid(
            tiff.name(),
            format!(
                "a page claims {}, but its {stored} stored bytes ({}) cannot hold that",
                layout.in_words(),
                layout.compression.name()
            ),
        )
        .at(ifd.at))
    }

    /// Where a single uncompressed page has all its bytes, if it does.
    pub(super) fn start(&self) -> Option<u64> {
        self.run.filter(|_| self.is_run).map(|(start, _)| start)
    }

    /// How many blocks are left out and read as zeros.
    pub(super) fn missing(&self) -> u64 {
        self.missing
    }

    /// The planes and the layout they have in common.
    pub(super) fn into_planes(self, name: &str) -> Result<(Planes, Arc<Layout>), Error> {
        let Some((_, page)) = self.pages.first() else {
            return Err(Error::invalid(name, "has no page"));
        };
        let layout = Arc::clone(&page.layout);
        let start = self.start();
        let planes = match (start, self.sources.as_slice()) {
            (Some(first), [Source::Open(tiff)]) => Planes::Regular {
                tiff: tiff.clone(),
                page: page.clone(),
                first,
                stride: layout.row_bytes() * layout.height,
            },
            _ => Planes::Pages {
                sources: self.sources,
                pages: self.pages,
            },
        };
        Ok((planes, layout))
    }
}

/// The directory of a page at a level of its pyramid: level 0 is the page itself.
pub(super) fn at_level(tiff: &Tiff, ifd: Ifd, level: u32) -> Result<Ifd, Error> {
    if level == 0 {
        return Ok(ifd);
    }
    let levels = levels(&ifd);
    match ifd.entry(tag::SUB_IFDS) {
        Some(entry) if u64::from(level) < levels => {
            tiff.directory(tiff.value(entry, u64::from(level) - 1)?)
        }
        _ => Err(Error::unsupported(
            tiff.name(),
            format!(
                "there is no level {level}: the page has {levels} level{}, from 0",
                if levels == 1 { "" } else { "s" }
            ),
        )
        .at(ifd.at)),
    }
}

/// How many levels a page has, itself included.
pub(super) fn levels(ifd: &Ifd) -> u64 {
    1_u64.saturating_add(ifd.entry(tag::SUB_IFDS).map_or(0, |entry| entry.count))
}
