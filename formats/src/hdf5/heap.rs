//! Heaps: where names, links and attributes are kept that do not fit an object header.
//!
//! In: the address of a heap and the identifier of an object in it. Out: the object's bytes.
//! Of fractal heaps, objects kept outside the blocks (more than 64 KiB) and blocks that are
//! compressed are not read; both are never links of a group.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::HashSet;

use super::file::{Fields, File};
use crate::error::Error;

/// The names of an old group.
pub(super) struct LocalHeap<'a> {
    file: &'a File,
    address: u64,
    data: Cow<'a, [u8]>,
}

impl<'a> LocalHeap<'a> {
    pub(super) fn open(file: &'a File, address: u64) -> Result<Self, Error> {
        let head = file.describe(address, 8)?;
        let mut fields = file.fields(address, &head);
        fields.magic(b"HEAP")?;
        fields.version("a local heap", 0)?;
        let rest_address = address.saturating_add(8);
        let rest = file.describe(rest_address, 24)?;
        let mut fields = file.fields(rest_address, &rest);
        let size = fields.length()?;
        fields.length()?;
        let data = fields.address("a local heap's data")?;
        Ok(Self {
            file,
            address: data,
            data: file.describe(data, size)?,
        })
    }

    /// The text at `offset`, which ends with a zero byte.
    pub(super) fn text(&self, offset: u64) -> Result<String, Error> {
        let text = usize::try_from(offset)
            .ok()
            .and_then(|offset| self.data.get(offset..))
            .and_then(|rest| rest.split(|byte| *byte == 0).next());
        let text = text.ok_or_else(|| {
            Error::invalid(
                self.file.name(),
                format!(
                    "a name at byte {offset} of a heap of {} bytes",
                    self.data.len()
                ),
            )
            .at(self.file.place(self.address))
        })?;
        Ok(String::from_utf8_lossy(text).into_owned())
    }
}

/// Object `index` of the global heap collection at `address`: a text of variable length.
pub(super) fn global(file: &File, address: u64, index: u32) -> Result<Vec<u8>, Error> {
    let head = file.describe(address, 8 + file.length_bytes() as u64)?;
    let mut fields = file.fields(address, &head);
    fields.magic(b"GCOL")?;
    fields.version("a global heap", 1)?;
    fields.skip(3)?;
    let size = fields.length()?;
    let whole = file.describe(address, size)?;
    let mut fields = file.fields(address, &whole);
    fields.skip(head.len())?;
    while fields.left() >= head.len() {
        let found = u32::from(fields.u16()?);
        fields.skip(6)?;
        let size = fields.length()?;
        // Object 0 is the free space at the end.
        if found == 0 {
            break;
        }
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let object = fields.take(size)?;
        if found == index {
            return Ok(object.to_vec());
        }
        fields.skip((8 - size % 8) % 8)?;
    }
    Err(fields.invalid(format!("object {index} is not in its global heap")))
}

/// The links of a new group, or attributes, if there are many.
pub(super) struct FractalHeap<'a> {
    file: &'a File,
    address: u64,
    /// Bytes of an offset and of a length in an identifier.
    offset_bytes: usize,
    length_bytes: usize,
    /// Whether direct blocks have a checksum.
    checked: bool,
    /// Blocks in a row, bytes of the first, bytes of the largest direct block.
    width: u64,
    first_bytes: u64,
    direct_most: u64,
    root: Option<u64>,
    root_rows: u16,
    /// Blocks whose checksums were verified.
    verified: RefCell<HashSet<u64>>,
}

impl<'a> FractalHeap<'a> {
    pub(super) fn open(file: &'a File, address: u64) -> Result<Self, Error> {
        let (offset, length) = (file.offset_bytes(), file.length_bytes());
        // Twelve lengths, three addresses and 22 other bytes.
        let bytes = 22 + 12 * length + 3 * offset;
        let block = file.describe(address, bytes as u64 + 4)?;
        let mut fields = file.fields(address, &block);
        fields.magic(b"FRHP")?;
        fields.version("a fractal heap", 0)?;
        fields.skip(2)?;
        let filter_bytes = fields.u16()?;
        if filter_bytes != 0 {
            return Err(fields.unsupported("a compressed heap of links or attributes"));
        }
        let flags = fields.u8()?;
        let object_most = fields.u32()?;
        fields.length()?;
        fields.offset()?;
        fields.length()?;
        fields.offset()?;
        for _ in 0..8 {
            fields.length()?;
        }
        let width = fields.u16()?;
        let first_bytes = fields.length()?;
        let direct_most = fields.length()?;
        let bits = fields.u16()?;
        fields.u16()?;
        let root = fields.offset()?;
        let root_rows = fields.u16()?;
        let powers = width.is_power_of_two()
            && first_bytes.is_power_of_two()
            && direct_most.is_power_of_two()
            && first_bytes <= direct_most
            && bits <= 64
            && direct_most <= 1 << 32;
        if !powers {
            return Err(fields.invalid(format!(
                "a fractal heap of {width} blocks of {first_bytes} to {direct_most} bytes"
            )));
        }
        fields.checksum("fractal heap")?;
        let width_of = |most: u64| most.max(1).ilog2() as usize / 8 + 1;
        Ok(Self {
            file,
            address,
            offset_bytes: usize::from(bits).div_ceil(8),
            length_bytes: width_of(object_most.into())
                .min((direct_most.ilog2() as usize).div_ceil(8)),
            checked: flags & 2 != 0,
            width: width.into(),
            first_bytes,
            direct_most,
            root,
            root_rows,
            verified: RefCell::default(),
        })
    }

    /// The object with this identifier.
    pub(super) fn object(&self, id: &[u8]) -> Result<Vec<u8>, Error> {
        let mut fields = self.file.fields(self.address, id);
        let first = fields.u8()?;
        match (first >> 6, first >> 4 & 3) {
            (0, 0) => {}
            (0, 2) => {
                let length = usize::from(first & 15) + 1;
                return Ok(fields.take(length)?.to_vec());
            }
            _ => return Err(fields.unsupported("an object outside the blocks of its heap")),
        }
        let offset = fields.uint(self.offset_bytes)?;
        let length = fields.uint(self.length_bytes)?;
        let (block, start, size) = self.direct_block(offset)?;
        let within = offset - start;
        if within.checked_add(length).is_none_or(|end| end > size) {
            return Err(fields.invalid(format!(
                "an object of {length} bytes at byte {within} of a block of {size}"
            )));
        }
        if self.checked && !self.verified.borrow().contains(&block) {
            self.verify(block, size)?;
            self.verified.borrow_mut().insert(block);
        }
        Ok(self
            .file
            .describe(block.saturating_add(within), length)?
            .into_owned())
    }

    /// The rest of the head of a block behind its letters: the heap's address, and the block's
    /// offset in the heap.
    fn block_head(&self, fields: &mut Fields<'_>, start: u64) -> Result<(), Error> {
        fields.version("a block of a fractal heap", 0)?;
        let heap = fields.offset()?;
        let offset = fields.uint(self.offset_bytes)?;
        if heap != Some(self.address) || offset != start {
            return Err(fields.invalid("a block of another heap, or of another place in it"));
        }
        Ok(())
    }

    fn verify(&self, block: u64, size: u64) -> Result<(), Error> {
        let mut bytes = self.file.describe(block, size)?.into_owned();
        let at = 5 + self.file.offset_bytes() + self.offset_bytes;
        let short = || {
            self.file
                .fields(block, &[])
                .invalid("a heap block is too short")
        };
        let place = bytes.get_mut(at..at + 4).ok_or_else(short)?;
        let mut stored = [0; 4];
        stored.copy_from_slice(place);
        place.fill(0);
        if super::file::checksum(&bytes) == u32::from_le_bytes(stored) {
            return Ok(());
        }
        Err(self
            .file
            .fields(block, &bytes)
            .invalid("the checksum of a block of a fractal heap is wrong: it is damaged"))
    }

    /// Bytes of each block in a row.
    fn row_bytes(&self, row: u64) -> u64 {
        self.first_bytes
            .checked_shl(u32::try_from(row.saturating_sub(1)).unwrap_or(64))
            .unwrap_or(0)
    }

    /// Address, offset in the heap, and size of the direct block that has `offset`.
    fn direct_block(&self, offset: u64) -> Result<(u64, u64, u64), Error> {
        let outside = || {
            Error::invalid(
                self.file.name(),
                format!("an object at byte {offset} of a heap, which ends before"),
            )
            .at(self.file.place(self.address))
        };
        let root = self.root.ok_or_else(outside)?;
        if self.root_rows == 0 {
            return if offset < self.first_bytes {
                Ok((root, 0, self.first_bytes))
            } else {
                Err(outside())
            };
        }
        let (mut block, mut start, mut rows) = (root, 0_u64, u64::from(self.root_rows));
        // Each step leads into a smaller block.
        loop {
            let within = offset - start;
            let first_row = self.width.saturating_mul(self.first_bytes);
            let (row, row_start) = if within < first_row {
                (0, 0)
            } else {
                let row = u64::from((within / first_row).ilog2()) + 1;
                (
                    row,
                    first_row.checked_shl(row as u32 - 1).ok_or_else(outside)?,
                )
            };
            let size = self.row_bytes(row);
            if row >= rows || size == 0 {
                return Err(outside());
            }
            let column = (within - row_start) / size;
            let child_start = start + row_start + column * size;
            let child = self.child(block, start, rows, row * self.width + column)?;
            let child = child.ok_or_else(outside)?;
            if size <= self.direct_most {
                return Ok((child, child_start, size));
            }
            let child_rows = u64::from((size / first_row).max(1).ilog2()) + 1;
            (block, start, rows) = (child, child_start, child_rows.min(row));
        }
    }

    /// The address of child `n` of an indirect block of so many rows.
    fn child(&self, block: u64, start: u64, rows: u64, n: u64) -> Result<Option<u64>, Error> {
        let head = 5 + self.file.offset_bytes() + self.offset_bytes;
        let children = rows.saturating_mul(self.width);
        let bytes = children.saturating_mul(self.file.offset_bytes() as u64);
        let whole = self
            .file
            .describe(block, bytes.saturating_add(head as u64 + 4))?;
        let mut fields = self.file.fields(block, &whole);
        let mut end = fields.clone();
        end.skip(whole.len() - 4)?;
        end.checksum("indirect block of a fractal heap")?;
        fields.magic(b"FHIB")?;
        self.block_head(&mut fields, start)?;
        // Within the block, whose length fits.
        fields.skip(n as usize * self.file.offset_bytes())?;
        fields.offset()
    }
}
