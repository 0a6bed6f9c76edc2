//! The planes of a volume, wherever the pages are that hold them.
//!
//! In: for each plane its page, and the file it is in. Out: [`RandomVoxels`]: plain bytes where
//! the planes lie uncompressed one behind the other, else pieces that are decoded when wanted.
//! Pages that are cut in the same way are read in their own tiles or in bands of strips, others
//! and those of closed files plane by plane. A file among several is opened for each piece and closed after it, so that
//! thousands of them need no handles; that it is still the same is checked each time.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::block::Blocks;
use super::ifd::Tiff;
use super::page::{Layout, Page, Place};
use crate::bytes::FileBytes;
use crate::chunked::{ChunkedVoxels, Chunks};
use crate::error::Error;
use crate::header::Header;
use crate::map::Fingerprint;
use crate::options::IoMode;
use crate::order::AxisOrder;
use crate::stored::StoredVoxels;
use crate::volume::RandomVoxels;

/// A file that holds planes.
pub(crate) enum Source {
    /// Kept open.
    Open(Tiff),
    /// Opened when a plane is wanted.
    Closed {
        path: PathBuf,
        fingerprint: Fingerprint,
    },
}

/// Where the planes are.
pub(super) enum Planes {
    /// Each in a page of its own, of the file with the given number.
    Pages {
        sources: Vec<Source>,
        pages: Vec<(u32, Page)>,
    },
    /// Uncompressed, at equal distances. The page stands for all of them.
    Regular {
        tiff: Tiff,
        page: Page,
        first: u64,
        stride: u64,
    },
}

/// The planes of a volume, and which of several samples is meant.
pub(super) struct PlaneVoxels {
    pub(super) planes: Planes,
    pub(super) sample: u64,
    dims: [u64; 3],
    chunk: [u64; 3],
}

impl PlaneVoxels {
    pub(super) fn new(planes: Planes, sample: u64, dims: [u64; 3]) -> Self {
        let chunk = chunk(&planes, dims);
        Self {
            planes,
            sample,
            dims,
            chunk,
        }
    }

    /// The voxels, in the plainest way there is.
    pub(super) fn into_voxels(self, name: &str, header: &Header) -> Box<dyn RandomVoxels> {
        if let Planes::Regular {
            tiff,
            page,
            first,
            stride,
        } = &self.planes
            && page.layout.is_plain()
            && header.plane_bytes() == Some(*stride)
        {
            let bytes = tiff.bytes.clone();
            return Box::new(StoredVoxels::new(
                bytes,
                name,
                *first,
                header,
                AxisOrder::X_FASTEST,
            ));
        }
        let chunk = self.chunk;
        Box::new(ChunkedVoxels::new(name, header, chunk, Box::new(self)))
    }

    fn read(
        &self,
        tiff: &Tiff,
        page: &Page,
        index: [u64; 3],
        out: &mut Vec<u8>,
    ) -> Result<(), Error> {
        let blocks = Blocks {
            tiff,
            page,
            sample: self.sample,
        };
        let origin = [0, 1].map(|a| index[a] * self.chunk[a]);
        let size = [0, 1].map(|a| self.chunk[a].min(self.dims[a] - origin[a]));
        blocks.read(origin, size, out)?;
        let voxel = page.layout.voxel.bytes();
        // Fits: it is at most a plane, of which a part was just read.
        pad(
            out,
            size[0] as usize * voxel,
            self.chunk.map(|n| n as usize),
            voxel,
        );
        Ok(())
    }
}

/// Extents of the pieces that planes are best read in.
fn chunk(planes: &Planes, dims: [u64; 3]) -> [u64; 3] {
    let whole = [dims[0], dims[1], 1];
    let layout: &Layout = match planes {
        Planes::Regular { .. } => return whole,
        Planes::Pages { sources, pages } => match pages.split_first() {
            Some(((_, first), rest))
                if rest
                    .iter()
                    .all(|(_, page)| page.layout.block == first.layout.block)
                    && sources
                        .iter()
                        .all(|source| matches!(source, Source::Open(_))) =>
            {
                &first.layout
            }
            _ => return whole,
        },
    };
    let [x, y] = layout.block;
    if layout.tiled {
        return [x.min(dims[0]), y.min(dims[1]), 1];
    }
    // Thin strips are read in bands, so that looking up a piece costs less than reading it.
    const BAND_BYTES: u64 = 256 << 10;
    let strip = (x * y).saturating_mul(layout.voxel.bytes() as u64).max(1);
    let strips = BAND_BYTES.div_ceil(strip);
    [dims[0], y.saturating_mul(strips).min(dims[1]), 1]
}

/// Widens rows to the full extents of a piece; `row` are the bytes of a row now.
fn pad(out: &mut Vec<u8>, row: usize, chunk: [usize; 3], voxel: usize) {
    let wanted = chunk[0] * voxel;
    let rows = out.len().checked_div(row).unwrap_or(0);
    out.resize(wanted * chunk[1], 0);
    if wanted > row {
        for y in (1..rows).rev() {
            out.copy_within(y * row..(y + 1) * row, y * wanted);
        }
    }
}

impl Chunks for PlaneVoxels {
    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
        match &self.planes {
            Planes::Regular {
                tiff,
                page,
                first,
                stride,
            } => {
                let page = Page {
                    place: Place::At(first + index[2] * stride),
                    ..page.clone()
                };
                self.read(tiff, &page, index, out)
            }
            Planes::Pages { sources, pages } => {
                // The index is within the volume, and so are its page and file.
                let (source, page) = &pages[index[2] as usize];
                match &sources[*source as usize] {
                    Source::Open(tiff) => self.read(tiff, page, index, out),
                    Source::Closed { path, fingerprint } => {
                        let tiff = reopen(path, fingerprint, IoMode::Read)?;
                        self.read(&tiff, page, index, out)?;
                        tiff.bytes.check()
                    }
                }
            }
        }
    }

    fn check(&self) -> Result<(), Error> {
        match &self.planes {
            Planes::Regular { tiff, .. } => tiff.bytes.check(),
            Planes::Pages { sources, .. } => sources.iter().try_for_each(|source| match source {
                Source::Open(tiff) => tiff.bytes.check(),
                // Checked whenever it is read.
                Source::Closed { .. } => Ok(()),
            }),
        }
    }
}

/// Opens a file again, if it is still the one that was examined.
pub(super) fn reopen(path: &Path, fingerprint: &Fingerprint, io: IoMode) -> Result<Tiff, Error> {
    let name = path.display().to_string();
    let file = File::open(path).map_err(|e| Error::io(&name, "cannot be opened again", e))?;
    fingerprint.check(&file, Some(path))?;
    Tiff::new(FileBytes::of_file(file, path, io)?)
}
