//! Where the chunks of a dataset are.
//!
//! In: the layout of a dataset and the number of a chunk along each axis. Out: the place of the
//! chunk in the file, or that it was never written. Nothing is kept: each question reads the few
//! nodes or pages on the way, which for a map costs no copy, so memory does not grow with the
//! number of chunks, and threads do not wait for each other. Guaranteed: what has a checksum is
//! verified each time (old B-trees, of version 1, have none); depths are bounded.

use std::cmp::Ordering;

use super::btree2::Tree2;
use super::file::{Fields, File};
use super::message::{ChunkIndex, Chunking, Dataspace};
use crate::error::Error;

/// A chunk in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stored {
    pub(super) address: u64,
    /// Bytes there; `None` for those of an unfiltered chunk.
    pub(super) bytes: Option<u64>,
    /// The filters, by bit, that the chunk did not go through.
    pub(super) without: u32,
}

/// The chunk index of a dataset.
pub(super) struct Index {
    /// Extents of a chunk.
    chunk: Vec<u64>,
    /// Number of chunks along each axis, of the largest the dataset may become; `None` for no
    /// limit.
    counts: Vec<Option<u64>>,
    /// Bytes of a chunk before filters.
    chunk_bytes: u64,
    kind: Kind,
}

enum Kind {
    /// Nothing was ever written.
    Empty,
    Tree1(u64),
    Single(Stored),
    Implicit(u64),
    Fixed(Array),
    Extensible(Array, Growth),
    Tree2(Tree2),
}

/// An array of places in the file.
struct Array {
    /// Where its header is, which its blocks repeat.
    header: u64,
    /// Whether entries have sizes and masks.
    client: u8,
    entry_bytes: usize,
    /// Entries of a page, and in all.
    page: u64,
    most: u64,
    /// The first block, if there is one.
    block: Option<u64>,
}

/// How an extensible array grows.
struct Growth {
    /// Bytes of an offset in the array.
    offset_bytes: usize,
    /// Entries in the first block.
    first: u64,
    /// Entries of the smallest data block.
    least: u64,
    /// Blocks that the first one names: how many rows of data blocks, and how many of these.
    rows: u64,
    direct: u64,
    /// Rows in all.
    all_rows: u64,
}

impl Index {
    pub(super) fn open(
        file: &File,
        chunking: &Chunking,
        space: &Dataspace,
        chunk_bytes: u64,
    ) -> Result<Self, Error> {
        let counts: Vec<_> = space
            .most
            .iter()
            .zip(&chunking.dims)
            .map(|(most, chunk)| most.map(|most| most.div_ceil(*chunk)))
            .collect();
        let kind = match (chunking.kind, chunking.address) {
            (_, None) => Kind::Empty,
            (ChunkIndex::Tree1, Some(address)) => Kind::Tree1(address),
            (ChunkIndex::Single(filtered), Some(address)) => Kind::Single(Stored {
                address,
                bytes: filtered.map(|(bytes, _)| bytes),
                without: filtered.map_or(0, |(_, mask)| mask),
            }),
            (ChunkIndex::Implicit, Some(address)) => Kind::Implicit(address),
            (ChunkIndex::FixedArray, Some(address)) => Kind::Fixed(fixed_array(file, address)?),
            (ChunkIndex::ExtensibleArray, Some(address)) => {
                let (array, growth) = extensible_array(file, address)?;
                Kind::Extensible(array, growth)
            }
            (ChunkIndex::Tree2, Some(address)) => {
                let tree = Tree2::open(file, address)?;
                let rank = chunking.dims.len();
                let least = file.offset_bytes() + 8 * rank + if tree.kind == 11 { 5 } else { 0 };
                if ![10, 11].contains(&tree.kind) || tree.record_bytes < least {
                    return Err(Error::invalid(
                        file.name(),
                        format!(
                            "a B-tree of type {} with records of {} bytes as index of chunks",
                            tree.kind, tree.record_bytes
                        ),
                    )
                    .at(file.place(address)));
                }
                Kind::Tree2(tree)
            }
        };
        Ok(Self {
            chunk: chunking.dims.clone(),
            counts,
            chunk_bytes,
            kind,
        })
    }

    /// The name of the index, for print.
    pub(super) fn name(&self) -> &'static str {
        match self.kind {
            Kind::Empty => "no index",
            Kind::Tree1(_) => "version 1 B-tree",
            Kind::Single(_) => "single chunk",
            Kind::Implicit(_) => "implicit index",
            Kind::Fixed(_) => "fixed array",
            Kind::Extensible(..) => "extensible array",
            Kind::Tree2(_) => "version 2 B-tree",
        }
    }

    /// The chunk with this number along each axis, slowest first.
    pub(super) fn find(&self, file: &File, number: &[u64]) -> Result<Option<Stored>, Error> {
        match &self.kind {
            Kind::Empty => Ok(None),
            Kind::Tree1(root) => self.find_in_tree1(file, *root, number),
            Kind::Single(stored) => Ok(number.iter().all(|n| *n == 0).then_some(*stored)),
            Kind::Implicit(address) => {
                let place = self
                    .linear(number, false)
                    .and_then(|n| n.checked_mul(self.chunk_bytes)?.checked_add(*address));
                Ok(place.map(|address| Stored {
                    address,
                    bytes: None,
                    without: 0,
                }))
            }
            Kind::Fixed(array) => match self.linear(number, false) {
                Some(n) if n < array.most => array.find_fixed(file, n),
                _ => Ok(None),
            },
            Kind::Extensible(array, growth) => match self.linear(number, true) {
                Some(n) => array.find_extensible(file, growth, n),
                None => Ok(None),
            },
            Kind::Tree2(tree) => {
                let width = tree.record_bytes - 8 * number.len();
                let record = tree.find(file, |record| {
                    let numbers = record[width..].as_chunks::<8>().0;
                    let found = numbers.iter().map(|bytes| u64::from_le_bytes(*bytes));
                    found.cmp(number.iter().copied())
                })?;
                let Some(record) = record else {
                    return Ok(None);
                };
                entry(&mut file.fields(0, &record[..width]), tree.kind == 11)
            }
        }
    }

    /// The number of a chunk in an array of all of them. An array that grows has its one axis
    /// without limit moved to the front.
    fn linear(&self, number: &[u64], grows: bool) -> Option<u64> {
        let mut order: Vec<usize> = (0..number.len()).collect();
        if grows && let Some(axis) = self.counts.iter().position(Option::is_none) {
            order.remove(axis);
            order.insert(0, axis);
        }
        let mut linear = 0_u64;
        for (i, axis) in order.into_iter().enumerate() {
            let count = match self.counts[axis] {
                Some(count) => count,
                None if i == 0 => 1,
                None => return None,
            };
            linear = linear.checked_mul(count)?.checked_add(number[axis])?;
        }
        Some(linear)
    }

    fn find_in_tree1(
        &self,
        file: &File,
        root: u64,
        number: &[u64],
    ) -> Result<Option<Stored>, Error> {
        let wanted: Option<Vec<u64>> = number
            .iter()
            .zip(&self.chunk)
            .map(|(n, chunk)| n.checked_mul(*chunk))
            .collect();
        let Some(wanted) = wanted else {
            return Ok(None);
        };
        let offset = file.offset_bytes();
        let head_bytes = 8 + 2 * offset;
        // Bytes and filters of a chunk, its first voxel, and 0 along the axis of the value's bytes.
        let key_bytes = 8 + 8 * (number.len() + 1);
        let pair = key_bytes + offset;
        let (mut address, mut above) = (root, None);
        loop {
            let head = file.read(address, head_bytes as u64)?;
            let mut fields = file.fields(address, &head);
            fields.magic(b"TREE")?;
            let kind = fields.u8()?;
            let level = fields.u8()?;
            if kind != 1 || above.is_some_and(|above: u8| level.checked_add(1) != Some(above)) {
                return Err(fields.invalid(format!(
                    "a node of type {kind} and level {level} in the B-tree of chunks"
                )));
            }
            let count = usize::from(fields.u16()?);
            let body_address = address.saturating_add(head_bytes as u64);
            let body = file.read(body_address, (count * pair) as u64)?;
            let first = |i: usize| {
                let key = &body[i * pair + 8..i * pair + key_bytes];
                let numbers = key.as_chunks::<8>().0.iter();
                numbers
                    .take(wanted.len())
                    .map(|bytes| u64::from_le_bytes(*bytes))
            };
            // The last key that is not behind the wanted one.
            let (mut low, mut high) = (0, count);
            while low < high {
                let middle = (low + high) / 2;
                if first(middle).cmp(wanted.iter().copied()) == Ordering::Greater {
                    high = middle;
                } else {
                    low = middle + 1;
                }
            }
            let Some(at) = low.checked_sub(1) else {
                return Ok(None);
            };
            let mut fields = file.fields(
                body_address.saturating_add((at * pair) as u64),
                &body[at * pair..(at + 1) * pair],
            );
            let bytes = fields.u32()?;
            let without = fields.u32()?;
            fields.skip(key_bytes - 8)?;
            let child = fields.address("a node of a B-tree")?;
            if level == 0 {
                let found = first(at).eq(wanted.iter().copied());
                return Ok(found.then_some(Stored {
                    address: child,
                    bytes: Some(bytes.into()),
                    without,
                }));
            }
            (address, above) = (child, Some(level));
        }
    }
}

/// An entry of an array or record of a tree: where a chunk is, and with filters its bytes and the
/// filters it went without.
fn entry(fields: &mut Fields<'_>, filtered: bool) -> Result<Option<Stored>, Error> {
    let address = fields.offset()?;
    let (bytes, without) = if filtered {
        let width = fields.left().saturating_sub(4);
        if !(1..=8).contains(&width) {
            return Err(fields.invalid(format!("the bytes of a chunk as {width} bytes")));
        }
        (Some(fields.uint(width)?), fields.u32()?)
    } else {
        (None, 0)
    };
    Ok(address.map(|address| Stored {
        address,
        bytes,
        without,
    }))
}

impl Array {
    /// The head of each block: letters, version, client, the address of the header.
    fn block_head(&self, fields: &mut Fields<'_>, letters: &[u8; 4]) -> Result<(), Error> {
        fields.magic(letters)?;
        fields.version("a block of an array of chunks", 0)?;
        let client = fields.u8()?;
        let header = fields.offset()?;
        if client != self.client || header != Some(self.header) {
            return Err(fields.invalid("a block of another array of chunks"));
        }
        Ok(())
    }

    fn head_bytes(file: &File) -> u64 {
        6 + file.offset_bytes() as u64
    }

    /// Entry `n` of those that begin `skip` bytes behind `address`.
    fn entry(
        &self,
        file: &File,
        bytes: &[u8],
        address: u64,
        skip: u64,
        n: u64,
    ) -> Result<Option<Stored>, Error> {
        let mut fields = file.fields(address, bytes);
        let at = skip + n * self.entry_bytes as u64;
        fields.skip(usize::try_from(at).unwrap_or(usize::MAX))?;
        let place = address.saturating_add(at);
        entry(
            &mut file.fields(place, fields.take(self.entry_bytes)?),
            self.client == 1,
        )
    }

    /// Entry `n` of a page of `count` entries.
    fn in_page(
        &self,
        file: &File,
        address: u64,
        count: u64,
        n: u64,
    ) -> Result<Option<Stored>, Error> {
        let bytes = count.saturating_mul(self.entry_bytes as u64);
        let page = file.read(address, bytes.saturating_add(4))?;
        verify(file, address, &page, "page of an array of chunks")?;
        self.entry(file, &page, address, 0, n)
    }

    fn find_fixed(&self, file: &File, n: u64) -> Result<Option<Stored>, Error> {
        let Some(block) = self.block else {
            return Ok(None);
        };
        let head = Self::head_bytes(file);
        let pages = if self.most > self.page {
            self.most.div_ceil(self.page)
        } else {
            0
        };
        let bitmap = pages.div_ceil(8);
        let entries = if pages == 0 {
            self.most.saturating_mul(self.entry_bytes as u64)
        } else {
            0
        };
        let prefix_bytes = head.saturating_add(bitmap).saturating_add(entries);
        let prefix = file.read(block, prefix_bytes.saturating_add(4))?;
        verify(file, block, &prefix, "array of chunks")?;
        self.block_head(&mut file.fields(block, &prefix), b"FADB")?;
        if pages == 0 {
            return self.entry(file, &prefix, block, head, n);
        }
        let page = n / self.page;
        if !bit(&prefix, head, page) {
            return Ok(None);
        }
        let page_bytes = self
            .page
            .saturating_mul(self.entry_bytes as u64)
            .saturating_add(4);
        let address = page
            .checked_mul(page_bytes)
            .and_then(|at| at.checked_add(prefix_bytes.checked_add(4)?.checked_add(block)?))
            .unwrap_or(u64::MAX);
        let count = self.page.min(self.most - page * self.page);
        self.in_page(file, address, count, n % self.page)
    }

    fn find_extensible(
        &self,
        file: &File,
        growth: &Growth,
        n: u64,
    ) -> Result<Option<Stored>, Error> {
        let Some(block) = self.block else {
            return Ok(None);
        };
        let offset = file.offset_bytes() as u64;
        let head = Self::head_bytes(file);
        // The first block: entries, then addresses of data blocks and of blocks of them.
        let entries = growth.first * self.entry_bytes as u64;
        let supers = growth.all_rows - growth.rows;
        let bytes = head + entries + (growth.direct + supers) * offset;
        let first = file.read(block, bytes + 4)?;
        verify(file, block, &first, "index of an array of chunks")?;
        self.block_head(&mut file.fields(block, &first), b"EAIB")?;
        if n < growth.first {
            return self.entry(file, &first, block, head, n);
        }
        let n = n - growth.first;
        let row = u64::from((n / growth.least + 1).ilog2());
        if row >= growth.all_rows {
            return Ok(None);
        }
        // At most 63 rows, of at most 2^32 blocks.
        let row_start = ((1_u64 << row) - 1).saturating_mul(growth.least);
        let blocks = 1_u64 << (row / 2);
        let size = growth.least.saturating_mul(1 << row.div_ceil(2));
        let within = n - row_start;
        let column = within / size;
        let n = within % size;
        let address_at = |bytes: &[u8], at: u64| -> Result<Option<u64>, Error> {
            let mut fields = file.fields(block, bytes);
            fields.skip(usize::try_from(at).unwrap_or(usize::MAX))?;
            fields.offset()
        };
        let pages = if size > self.page {
            size / self.page
        } else {
            0
        };
        let (data, written) = if row < growth.rows {
            // Blocks of the rows before.
            let before = (0..row).map(|row| 1_u64 << (row / 2)).sum::<u64>();
            let at = head + entries + (before + column) * offset;
            (address_at(&first, at)?, true)
        } else {
            let at = head + entries + (growth.direct + row - growth.rows) * offset;
            let Some(address) = address_at(&first, at)? else {
                return Ok(None);
            };
            let bitmap_at = head + growth.offset_bytes as u64;
            let bitmap = blocks.saturating_mul(pages.div_ceil(8));
            let addresses = bitmap_at.saturating_add(bitmap);
            let bytes = addresses.saturating_add(blocks * offset).saturating_add(4);
            let whole = file.read(address, bytes)?;
            verify(file, address, &whole, "block of an array of chunks")?;
            self.block_head(&mut file.fields(address, &whole), b"EASB")?;
            let written = pages == 0 || bit(&whole, bitmap_at, column * pages + n / self.page);
            (address_at(&whole, addresses + column * offset)?, written)
        };
        let Some(data) = data else {
            return Ok(None);
        };
        let head = head + growth.offset_bytes as u64;
        if pages == 0 {
            let bytes = size
                .saturating_mul(self.entry_bytes as u64)
                .saturating_add(head);
            let whole = file.read(data, bytes.saturating_add(4))?;
            verify(file, data, &whole, "data of an array of chunks")?;
            self.block_head(&mut file.fields(data, &whole), b"EADB")?;
            return self.entry(file, &whole, data, head, n);
        }
        if !written {
            return Ok(None);
        }
        let prefix = file.read(data, head + 4)?;
        verify(file, data, &prefix, "data of an array of chunks")?;
        self.block_head(&mut file.fields(data, &prefix), b"EADB")?;
        let page_bytes = self
            .page
            .saturating_mul(self.entry_bytes as u64)
            .saturating_add(4);
        let address = (n / self.page)
            .checked_mul(page_bytes)
            .and_then(|at| at.checked_add(head + 4)?.checked_add(data))
            .unwrap_or(u64::MAX);
        self.in_page(file, address, self.page, n % self.page)
    }
}

/// Whether bit `n`, highest first, is set behind `skip` bytes.
fn bit(bytes: &[u8], skip: u64, n: u64) -> bool {
    usize::try_from(skip.saturating_add(n / 8))
        .ok()
        .and_then(|at| bytes.get(at))
        .is_some_and(|byte| byte & (0x80 >> (n % 8)) != 0)
}

/// Verifies the checksum that a block ends with.
fn verify(file: &File, address: u64, block: &[u8], what: &str) -> Result<(), Error> {
    let mut fields = file.fields(address, block);
    fields.skip(block.len().saturating_sub(4))?;
    fields.checksum(what)
}

/// What both arrays begin with: letters, version, client, bytes of an entry.
fn array_head(
    fields: &mut Fields<'_>,
    letters: &[u8; 4],
    file: &File,
) -> Result<(u8, usize), Error> {
    fields.magic(letters)?;
    fields.version("an array of chunks", 0)?;
    let client = fields.u8()?;
    let entry_bytes = usize::from(fields.u8()?);
    let plain = file.offset_bytes();
    let expected = match client {
        0 => plain..=plain,
        _ => plain + 5..=plain + 12,
    };
    if client > 1 || !expected.contains(&entry_bytes) {
        return Err(fields.invalid(format!(
            "an array of kind {client} with entries of {entry_bytes} bytes as index of chunks"
        )));
    }
    Ok((client, entry_bytes))
}

fn fixed_array(file: &File, address: u64) -> Result<Array, Error> {
    let bytes = 12 + file.length_bytes() + file.offset_bytes();
    let block = file.describe(address, bytes as u64)?;
    let mut fields = file.fields(address, &block);
    let (client, entry_bytes) = array_head(&mut fields, b"FAHD", file)?;
    let page_bits = fields.u8()?;
    let most = fields.length()?;
    let data = fields.offset()?;
    fields.checksum("array of chunks")?;
    if page_bits > 32 {
        return Err(fields.invalid(format!("an array with pages of 2^{page_bits} entries")));
    }
    Ok(Array {
        header: address,
        client,
        entry_bytes,
        page: 1 << page_bits,
        most,
        block: data,
    })
}

fn extensible_array(file: &File, address: u64) -> Result<(Array, Growth), Error> {
    let bytes = 16 + 6 * file.length_bytes() + file.offset_bytes();
    let block = file.describe(address, bytes as u64)?;
    let mut fields = file.fields(address, &block);
    let (client, entry_bytes) = array_head(&mut fields, b"EAHD", file)?;
    let bits = fields.u8()?;
    let first = fields.u8()?;
    let least = fields.u8()?;
    let pointers = fields.u8()?;
    let page_bits = fields.u8()?;
    for _ in 0..6 {
        fields.length()?;
    }
    let block = fields.offset()?;
    fields.checksum("array of chunks")?;
    let sound = least.is_power_of_two()
        && pointers.is_power_of_two()
        && pointers > 1
        && bits <= 64
        && u32::from(bits) >= least.ilog2()
        && page_bits <= 32;
    let all_rows = 1 + u64::from(bits).saturating_sub(u64::from(least.max(1).ilog2()));
    let rows = 2 * u64::from(pointers.max(1).ilog2());
    if !sound || rows > all_rows || all_rows > 63 {
        return Err(fields.invalid(format!(
            "an array of 2^{bits} chunks in blocks of {least} and {pointers}"
        )));
    }
    let array = Array {
        header: address,
        client,
        entry_bytes,
        page: 1 << page_bits,
        most: u64::MAX,
        block,
    };
    let growth = Growth {
        offset_bytes: usize::from(bits).div_ceil(8),
        first: first.into(),
        least: least.into(),
        rows,
        direct: 2 * (u64::from(pointers) - 1),
        all_rows,
    };
    Ok((array, growth))
}
