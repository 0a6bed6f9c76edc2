//! One strip or tile of a page, from stored bytes to voxels.
//!
//! In: a [`Page`] and which block of it. Out: the voxels of the block, whole rows of its full
//! width. Guaranteed: memory is the stored bytes and what they become, never more than the layout
//! promised nor more than the codec can make of so many bytes; a block that gives too little is
//! an error with its place. JPEG is by `zune-jpeg`, asked for grey, and only after its own header
//! states the extents of the block.

use std::borrow::Cow;

use super::ifd::Tiff;
use super::page::{Compression, Page, Place};
use super::samples::to_voxels;
use super::unpress::{self, Fax};
use crate::error::Error;
use crate::jpeg;

/// Decodes blocks of one page.
pub(super) struct Blocks<'a> {
    pub(super) tiff: &'a Tiff,
    pub(super) page: &'a Page,
    /// Which of several samples.
    pub(super) sample: u64,
}

impl Blocks<'_> {
    /// Where the block in column `x` and row `y` of blocks is: offset and stored bytes. `None`
    /// where the file leaves the block out, which stands for zeros.
    fn find(&self, x: u64, y: u64) -> Result<Option<(u64, u64)>, Error> {
        let layout = &self.page.layout;
        let promised = || layout.row_bytes() * layout.block_rows(y);
        let (offsets, counts) = match self.page.place {
            Place::At(offset) => return Ok(Some((offset, promised()))),
            Place::Tables { offsets, counts } => (offsets, counts),
        };
        let [across, down] = layout.blocks();
        let plane = if layout.planar { self.sample } else { 0 };
        let index = (plane * down + y) * across + x;
        let offset = self.tiff.value(&offsets, index)?;
        let count = match counts {
            Some(counts) => self.tiff.value(&counts, index)?,
            None => promised(),
        };
        Ok((offset != 0 || count != 0).then_some((offset, count)))
    }

    /// Replaces `out` by the voxels of the block in column `x` and row `y` of blocks.
    pub(super) fn decode(&self, x: u64, y: u64, out: &mut Vec<u8>) -> Result<(), Error> {
        let layout = &*self.page.layout;
        let rows = layout.block_rows(y);
        let expected = layout.row_bytes() * rows;
        let Some((offset, count)) = self.find(x, y)? else {
            let voxels = layout.block[0] * rows * layout.voxel.bytes() as u64;
            out.clear();
            out.resize(self.size(voxels)?, 0);
            return Ok(());
        };
        let failed = |what: String| {
            let kind = if layout.tiled { "tile" } else { "strip" };
            Error::invalid(self.tiff.name(), format!("a {kind} {what}")).at(offset)
        };
        let most = count.saturating_mul(layout.compression.most(layout.row_bytes()));
        if expected > most {
            return Err(failed(format!(
                "of {count} bytes ({}) cannot give the {expected} bytes it should",
                layout.compression.name()
            )));
        }
        let stored = if layout.compression == Compression::None {
            expected
        } else {
            count
        };
        let mut data = self.tiff.bytes.read(offset, stored)?;
        if layout.bits_reversed && layout.compression != Compression::Jpeg {
            data.to_mut().iter_mut().for_each(|b| *b = b.reverse_bits());
        }
        let size = self.size(expected)?;
        let (width, rows) = (layout.block[0], self.size(rows)?);
        let result = match layout.compression {
            Compression::None => {
                out.clear();
                out.extend_from_slice(&data);
                Ok(())
            }
            Compression::Lzw => unpress::lzw(&data, size, out),
            Compression::PackBits => unpress::packbits(&data, size, out),
            Compression::Deflate => unpress::deflate(&data, size, out),
            Compression::Zstd => unpress::zstd(&data, size, out),
            Compression::Huffman => self.fax(Fax::Huffman, &data, rows, out),
            Compression::Group3 => self.fax(Fax::Group3, &data, rows, out),
            Compression::Group4 => self.fax(Fax::Group4, &data, rows, out),
            Compression::Jpeg => self.jpeg(data, width, rows as u64, out)?,
        };
        result.map_err(failed)?;
        if !layout.is_plain() {
            to_voxels(out, layout, self.tiff.order, self.sample);
        }
        Ok(())
    }

    fn fax(
        &self,
        kind: Fax,
        data: &[u8],
        rows: usize,
        out: &mut Vec<u8>,
    ) -> Result<(), unpress::Failure> {
        let layout = &self.page.layout;
        if layout.bits != 1 || layout.interleaved() != 1 {
            return Err("has CCITT compression, but not one sample of one bit".into());
        }
        unpress::fax(kind, data, layout.block[0], rows, out)
    }

    fn jpeg(
        &self,
        data: Cow<'_, [u8]>,
        width: u64,
        rows: u64,
        out: &mut Vec<u8>,
    ) -> Result<Result<(), unpress::Failure>, Error> {
        if self.page.layout.bits != 8 {
            return Ok(Err(format!(
                "has JPEG compression of {} bits a sample, 8 expected",
                self.page.layout.bits
            )));
        }
        let tables = match &self.page.jpeg_tables {
            Some(entry) => self.tiff.raw(entry)?,
            None => Cow::Borrowed(&[][..]),
        };
        // The tables come without their end mark, the image without its start mark.
        let data = match (
            tables.strip_suffix(b"\xff\xd9"),
            data.strip_prefix(b"\xff\xd8"),
        ) {
            (Some(tables), Some(image)) if tables.len() >= 2 => {
                Cow::Owned([tables, image].concat())
            }
            _ => data,
        };
        Ok(jpeg::grey(
            &data,
            width,
            rows,
            self.page.layout.block[1],
            out,
        ))
    }

    fn size(&self, bytes: u64) -> Result<usize, Error> {
        usize::try_from(bytes).map_err(|_| {
            Error::unsupported(
                self.tiff.name(),
                format!("{bytes} bytes of pixels do not fit memory"),
            )
        })
    }

    /// Replaces `out` by the voxels of a box of the page.
    pub(super) fn read(
        &self,
        origin: [u64; 2],
        size: [u64; 2],
        out: &mut Vec<u8>,
    ) -> Result<(), Error> {
        let layout = &*self.page.layout;
        let [block_x, block_y] = layout.block;
        let range = |axis: usize| {
            let end = origin[axis] + size[axis];
            origin[axis] / layout.block[axis]..end.div_ceil(layout.block[axis])
        };
        let (columns, rows) = (range(0), range(1));
        let whole = size[0] == block_x
            && columns.end - columns.start == 1
            && rows.end - rows.start == 1
            && origin[0].is_multiple_of(block_x)
            && origin[1].is_multiple_of(block_y)
            && size[1] == layout.block_rows(rows.start);
        if whole {
            return self.decode(columns.start, rows.start, out);
        }
        let voxel = layout.voxel.bytes() as u64;
        let bytes = self.size(size[0] * size[1] * voxel)?;
        let mut piece = Vec::new();
        // Grows with what was decoded: the first block must be there before memory is taken.
        out.clear();
        for y in rows {
            for x in columns.clone() {
                self.decode(x, y, &mut piece)?;
                if out.is_empty() {
                    out.resize(bytes, 0);
                }
                let first = [(x * block_x).max(origin[0]), (y * block_y).max(origin[1])];
                let end = [
                    ((x + 1) * block_x).min(origin[0] + size[0]),
                    (y * block_y + layout.block_rows(y)).min(origin[1] + size[1]),
                ];
                let run = ((end[0] - first[0]) * voxel) as usize;
                for row in first[1]..end[1] {
                    let from =
                        (((row - y * block_y) * block_x + first[0] - x * block_x) * voxel) as usize;
                    let to =
                        (((row - origin[1]) * size[0] + first[0] - origin[0]) * voxel) as usize;
                    out[to..to + run].copy_from_slice(&piece[from..from + run]);
                }
            }
        }
        Ok(())
    }
}
