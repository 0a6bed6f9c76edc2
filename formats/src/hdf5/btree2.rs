//! Version 2 B-trees: indexes of links, of attributes, and of the chunks of datasets that grow
//! along several axes.
//!
//! In: the address of a tree. Out: all records of it, or the one that a comparison leads to.
//! Guaranteed: each node's checksum is verified; the depth is bounded by the header, and each
//! level is one less than the one above.

use std::cmp::Ordering;

use super::file::{Fields, File};
use crate::error::Error;

/// A tree.
pub(super) struct Tree2 {
    /// What its records are.
    pub(super) kind: u8,
    node_bytes: u32,
    pub(super) record_bytes: usize,
    depth: u16,
    root: Option<u64>,
    root_records: u64,
    /// For each level from the leaves: bytes of the number of records below a child.
    total_bytes: Vec<usize>,
    /// Bytes of the number of records of a child.
    count_bytes: usize,
}

/// A child of an inner node: its address, and its number of records.
type Child = (u64, u64);

impl Tree2 {
    pub(super) fn open(file: &File, address: u64) -> Result<Self, Error> {
        let bytes = 16 + file.offset_bytes() + 2 + file.length_bytes() + 4;
        let block = file.describe(address, bytes as u64)?;
        let mut fields = file.fields(address, &block);
        fields.magic(b"BTHD")?;
        fields.version("a B-tree", 0)?;
        let kind = fields.u8()?;
        let node_bytes = fields.u32()?;
        let record_bytes = usize::from(fields.u16()?);
        let depth = fields.u16()?;
        fields.skip(2)?;
        let root = fields.offset()?;
        let root_records = u64::from(fields.u16()?);
        fields.length()?;
        fields.checksum("B-tree")?;
        /// More levels than any file has records for.
        const MOST_DEPTH: u16 = 32;
        if record_bytes == 0 || record_bytes > 4096 || depth > MOST_DEPTH || node_bytes < 16 {
            return Err(fields.invalid(format!(
                "a B-tree of depth {depth} with records of {record_bytes} bytes in nodes of \
                 {node_bytes}"
            )));
        }
        // The numbers in a node are as wide as the largest they can be.
        let width = |most: u64| most.max(1).ilog2() as usize / 8 + 1;
        let room = u64::from(node_bytes) - 10;
        let leaf_most = room / record_bytes as u64;
        let count_bytes = width(leaf_most);
        let mut total_bytes = vec![0];
        let mut total_most = leaf_most;
        for level in 1..=usize::from(depth) {
            let below = total_bytes[level - 1];
            let pointer = (file.offset_bytes() + count_bytes + below) as u64;
            let most = room.saturating_sub(pointer) / (record_bytes as u64 + pointer);
            total_most = (most + 1).saturating_mul(total_most).saturating_add(most);
            total_bytes.push(width(total_most));
        }
        Ok(Self {
            kind,
            node_bytes,
            record_bytes,
            depth,
            root,
            root_records,
            total_bytes,
            count_bytes,
        })
    }

    /// Verifies a node and gives its records and, at level 1 and above, its children.
    fn node<'a>(
        &self,
        file: &'a File,
        address: u64,
        node: &'a [u8],
        level: u16,
        count: u64,
    ) -> Result<(&'a [u8], Fields<'a>), Error> {
        let mut fields = file.fields(address, node);
        fields.magic(if level == 0 { b"BTLF" } else { b"BTIN" })?;
        fields.version("a B-tree node", 0)?;
        let kind = fields.u8()?;
        if kind != self.kind {
            return Err(fields.invalid(format!(
                "a B-tree node of type {kind} in a tree of type {}",
                self.kind
            )));
        }
        let bytes = usize::try_from(count)
            .ok()
            .and_then(|count| count.checked_mul(self.record_bytes))
            .unwrap_or(usize::MAX);
        let records = fields.take(bytes)?;
        let children = fields.clone();
        if level > 0 {
            let pointer = self.pointer_bytes(file, level);
            let bytes = (count + 1).saturating_mul(pointer as u64);
            fields.skip(usize::try_from(bytes).unwrap_or(usize::MAX))?;
        }
        fields.checksum("B-tree node")?;
        Ok((records, children))
    }

    /// Bytes of a child in a node at `level`.
    fn pointer_bytes(&self, file: &File, level: u16) -> usize {
        file.offset_bytes() + self.count_bytes + self.total_bytes[usize::from(level) - 1]
    }

    fn child(&self, fields: &mut Fields<'_>, level: u16) -> Result<Child, Error> {
        let address = fields.address("a B-tree node")?;
        let count = fields.uint(self.count_bytes)?;
        fields.skip(self.total_bytes[usize::from(level) - 1])?;
        Ok((address, count))
    }

    /// Gives all records to `visit`, not in order.
    pub(super) fn visit(
        &self,
        file: &File,
        mut visit: impl FnMut(&[u8]) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let mut todo = Vec::new();
        todo.extend(self.root.map(|root| (root, self.root_records, self.depth)));
        while let Some((address, count, level)) = todo.pop() {
            // What is described is counted, so a tree with many ways to one node ends.
            let node = file.describe(address, self.node_bytes.into())?;
            let (records, mut children) = self.node(file, address, &node, level, count)?;
            records
                .chunks_exact(self.record_bytes)
                .try_for_each(&mut visit)?;
            if level > 0 {
                for _ in 0..=count {
                    let (address, count) = self.child(&mut children, level)?;
                    todo.push((address, count, level - 1));
                }
            }
        }
        Ok(())
    }

    /// The record that `compare` calls equal; it says how a record lies to the one wanted.
    pub(super) fn find(
        &self,
        file: &File,
        compare: impl Fn(&[u8]) -> Ordering,
    ) -> Result<Option<Vec<u8>>, Error> {
        let Some(root) = self.root else {
            return Ok(None);
        };
        let (mut address, mut count) = (root, self.root_records);
        for level in (0..=self.depth).rev() {
            let node = file.read(address, self.node_bytes.into())?;
            let (records, mut children) = self.node(file, address, &node, level, count)?;
            let record = |i: usize| &records[i * self.record_bytes..(i + 1) * self.record_bytes];
            // The first record that is not before the wanted one.
            let (mut low, mut high) = (0, records.len() / self.record_bytes);
            while low < high {
                let middle = (low + high) / 2;
                match compare(record(middle)) {
                    Ordering::Equal => return Ok(Some(record(middle).to_vec())),
                    Ordering::Less => low = middle + 1,
                    Ordering::Greater => high = middle,
                }
            }
            if level > 0 {
                children.skip(low * self.pointer_bytes(file, level))?;
                (address, count) = self.child(&mut children, level)?;
            }
        }
        Ok(None)
    }
}
