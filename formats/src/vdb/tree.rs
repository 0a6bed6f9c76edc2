//! The tree of a grid: which parts of space have values of their own, and where those are in the
//! file.
//!
//! In: a cursor at the tree of a grid. Out: [`Tree`]: the root, the internal nodes with their
//! tile values, and for each leaf the offset of its values in the file. Not the values of leaves:
//! they are decoded when they are needed.
//!
//! ```text
//! root        any number of cells of 4096^3 voxels: tile or child
//!   upper     32^3 cells of 128^3: tile or child
//!     lower   16^3 cells of 8^3: tile or leaf
//!       leaf  8^3 voxels
//! ```
//!
//! Within a node z is fastest, unlike everywhere else in this crate. The tree is stored depth
//! first, twice: first the topology (masks of children and of active values, tile values), then
//! the leaves' values. Leaves have no index, so all are walked over once; four bytes are kept for
//! each. Memory is bounded by the bytes of the file and a constant: what is not there is not
//! allocated, and a file whose tiles decompress to more is refused.

use super::archive::version;
use super::cursor::Cursor;
use super::values::{Decoder, Leaf, Value, ones};
use crate::error::Error;

/// Voxels along a cell of the root, of an upper and of a lower node, as powers of two.
pub(super) const ROOT_CELL_LOG2: u32 = 12;
pub(super) const UPPER_CELL_LOG2: u32 = 7;
pub(super) const LOWER_CELL_LOG2: u32 = 3;

/// Cells along an upper and a lower node, as powers of two.
pub(super) const UPPER_LOG2: u32 = 5;
pub(super) const LOWER_LOG2: u32 = 4;

/// A tree without the values of its leaves.
pub(super) struct Tree {
    /// Value outside all nodes and tiles.
    pub(super) background: Value,
    /// Cells of the root that have something, ordered by their place (x, then y, then z).
    pub(super) roots: Vec<Root>,
    /// What is active.
    pub(super) active: Active,
    /// Number of leaves.
    pub(super) leaves: u64,
    /// Bytes of memory that the tree takes.
    pub(super) held_bytes: u64,
    /// Offset in the file of the first leaf's values.
    #[cfg(feature = "vdb-rs")]
    pub(super) leaves_start: u64,
}

/// One cell of the root.
pub(super) struct Root {
    /// Place of the cell, in cells.
    pub(super) cell: [i32; 3],
    pub(super) content: RootContent,
}

pub(super) enum RootContent {
    Tile(Value),
    Upper(Box<Upper>),
}

/// A node whose children are lower nodes.
pub(super) struct Upper {
    pub(super) node: Node,
    /// The children, in the order of their cells.
    pub(super) lowers: Vec<Lower>,
}

/// A node whose children are leaves.
pub(super) struct Lower {
    pub(super) node: Node,
    /// Offset in the file of the first leaf's values.
    start: u64,
    /// Offsets of the leaves' values from `start`, and of their end.
    leaves: Vec<u32>,
}

impl Lower {
    /// Offset and length of the values of leaf `n`.
    pub(super) fn leaf(&self, n: usize) -> Option<(u64, u64)> {
        let from = *self.leaves.get(n)?;
        let to = *self.leaves.get(n + 1)?;
        Some((
            self.start + u64::from(from),
            u64::from(to.saturating_sub(from)),
        ))
    }
}

/// What upper and lower nodes have in common: which cells are children, and the values of those
/// that are tiles.
pub(super) struct Node {
    /// Bit `n` is on where cell `n` is a child.
    pub(super) children: Box<[u64]>,
    /// Children before each word of `children`.
    ranks: Box<[u16]>,
    pub(super) tiles: Tiles,
}

impl Node {
    fn new(children: Box<[u64]>, tiles: Tiles) -> Self {
        let mut before = 0_u16;
        let ranks = children
            .iter()
            .map(|word| {
                let rank = before;
                // A node has 32768 cells at most.
                before += word.count_ones() as u16;
                rank
            })
            .collect();
        Self {
            children,
            ranks,
            tiles,
        }
    }

    /// Which child cell `n` is, if it is one.
    pub(super) fn child(&self, n: usize) -> Option<usize> {
        let (word, bit) = (*self.children.get(n / 64)?, n % 64);
        let rank = *self.ranks.get(n / 64)?;
        let below = word & ((1 << bit) - 1);
        (word >> bit & 1 != 0).then(|| usize::from(rank) + below.count_ones() as usize)
    }
}

/// Values of the tiles of a node.
pub(super) enum Tiles {
    /// All the same.
    One(Value),
    /// Two values: the second where the mask is on.
    Two(Value, Value, Box<[u64]>),
    /// One after the other, children's places unused.
    All(Vec<u8>),
}

impl Tiles {
    /// The tiles of a node: `values` has one a cell, of which those of children say nothing.
    fn new(values: Vec<u8>, bytes: usize, children: &[u64], decoder: &Decoder) -> Self {
        let mut found: Vec<(&[u8], usize)> = Vec::with_capacity(2);
        let mut mask = vec![0_u64; children.len()];
        let cells = values.chunks_exact(bytes);
        for (n, value) in cells.enumerate() {
            if children[n / 64] >> (n % 64) & 1 != 0 {
                continue;
            }
            match found.iter().position(|(known, _)| *known == value) {
                Some(0) => {}
                Some(_) => mask[n / 64] |= 1 << (n % 64),
                None if found.len() == 2 => return Self::All(values),
                None => {
                    if found.len() == 1 {
                        mask[n / 64] |= 1 << (n % 64);
                    }
                    found.push((value, n));
                }
            }
        }
        let value = |i: usize| found.get(i).map(|(value, _)| decoder.layout.value(value));
        match (value(0), value(1)) {
            (Some(first), Some(second)) => Self::Two(first, second, mask.into()),
            (Some(only), None) => Self::One(only),
            // All cells are children.
            _ => Self::One(decoder.background),
        }
    }

    /// Value of cell `n`.
    pub(super) fn value(&self, n: usize, bytes: usize) -> Value {
        match self {
            Self::One(value) => *value,
            Self::Two(first, second, mask) => {
                if mask[n / 64] >> (n % 64) & 1 != 0 {
                    *second
                } else {
                    *first
                }
            }
            Self::All(values) => {
                let mut value = Value::default();
                value[..bytes].copy_from_slice(&values[n * bytes..][..bytes]);
                value
            }
        }
    }

    /// Bytes held.
    fn held(&self) -> usize {
        match self {
            Self::One(_) => 0,
            Self::Two(_, _, mask) => mask.len() * 8,
            Self::All(values) => values.len(),
        }
    }
}

/// What is active in a tree: its number of voxels and the box around them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Active {
    pub(super) voxels: u64,
    /// First and last voxel of the box; `None` if nothing is active.
    pub(super) bounds: Option<[[i64; 3]; 2]>,
}

impl Active {
    fn add(&mut self, voxels: u64, first: [i64; 3], last: [i64; 3]) {
        self.voxels = self.voxels.saturating_add(voxels);
        let [low, high] = self.bounds.get_or_insert([first, last]);
        for a in 0..3 {
            low[a] = low[a].min(first[a]);
            high[a] = high[a].max(last[a]);
        }
    }

    /// A tile of 2^log2 voxels a side.
    fn add_tile(&mut self, first: [i64; 3], log2: u32) {
        let last = first.map(|i| i + (1 << log2) - 1);
        self.add(1 << (3 * log2), first, last);
    }

    /// The active voxels of a leaf.
    fn add_leaf(&mut self, origin: [i64; 3], mask: &[u64; 8]) {
        let all = mask.iter().fold(0, |all, word| all | word);
        if all == 0 {
            return;
        }
        // A word is a plane of x, a byte of it a row of y.
        let first_x = mask.iter().position(|word| *word != 0).unwrap_or(0);
        let last_x = mask.iter().rposition(|word| *word != 0).unwrap_or(0);
        let row = all.to_le_bytes().iter().fold(0, |row, byte| row | byte);
        let first = [
            first_x as i64,
            i64::from(all.trailing_zeros() / 8),
            i64::from(row.trailing_zeros()),
        ];
        let last = [
            last_x as i64,
            i64::from(7 - all.leading_zeros() / 8),
            i64::from(7 - row.leading_zeros()),
        ];
        let place = |offset: [i64; 3]| std::array::from_fn(|a| origin[a] + offset[a]);
        self.add(ones(mask) as u64, place(first), place(last));
    }
}

/// Offset in voxels of cell `n` of a node with 2^log2 cells along each axis.
fn cell_offset(n: usize, log2: u32, cell_log2: u32) -> [i64; 3] {
    let n = n as i64;
    let last = (1 << log2) - 1;
    [n >> (2 * log2), n >> log2 & last, n & last].map(|i| i << cell_log2)
}

/// Numbers of the bits that are on.
pub(super) fn bits_on(mask: &[u64]) -> impl Iterator<Item = usize> + '_ {
    mask.iter().enumerate().flat_map(|(i, &word)| {
        let mut left = word;
        std::iter::from_fn(move || {
            let bit = left.trailing_zeros() as usize;
            left &= left.wrapping_sub(1);
            (bit < 64).then_some(64 * i + bit)
        })
    })
}

/// Reads a tree.
pub(super) struct TreeReader<'a, 'c> {
    cursor: &'a mut Cursor<'c>,
    decoder: Decoder,
    /// Bytes that the tree may still take.
    budget: u64,
    active: Active,
    leaves: u64,
}

/// Reads a child at the place given.
type Child<'f, Reader> = &'f mut dyn FnMut(&mut Reader, [i64; 3]) -> Result<(), Error>;

const WHAT: &str = "the topology of a tree";

/// Bytes a tree may take beyond those of the file: enough for the tiles of any small file.
const EXTRA_BYTES: u64 = 32 << 20;

impl<'a, 'c> TreeReader<'a, 'c> {
    /// A reader of the tree at the cursor.
    pub(super) fn new(cursor: &'a mut Cursor<'c>, decoder: Decoder) -> Self {
        let mut reader = Self {
            cursor,
            decoder,
            budget: 0,
            active: Active::default(),
            leaves: 0,
        };
        reader.budget = reader.allowed();
        reader
    }

    /// Bytes a tree may take.
    fn allowed(&self) -> u64 {
        self.cursor.file_bytes().saturating_add(EXTRA_BYTES)
    }

    /// Where the reader is.
    pub(super) fn cursor(&mut self) -> &mut Cursor<'c> {
        self.cursor
    }

    /// Counts bytes that are kept.
    fn keep(&mut self, bytes: usize) -> Result<(), Error> {
        match self.budget.checked_sub(bytes as u64) {
            Some(left) => {
                self.budget = left;
                Ok(())
            }
            None => Err(self.cursor.unsupported(
                "the tiles of the tree take more memory than the file has bytes; it is not read",
            )),
        }
    }

    /// Reads the topology: all but the leaves' places.
    pub(super) fn topology(&mut self) -> Result<Tree, Error> {
        let at = self.cursor.offset();
        let buffers = self.cursor.i32(WHAT)?;
        if buffers != 1 {
            return Err(self
                .cursor
                .invalid(at, format!("a tree of {buffers} buffers, 1 expected")));
        }
        let bytes = self.decoder.layout.bytes;
        let background = self.cursor.take(bytes, WHAT)?;
        self.decoder.background = self.decoder.layout.value(background);
        if self.decoder.layout.leaf == Leaf::Mask {
            // A mask says what is on; outside the tree nothing is.
            self.decoder.background = Value::default();
        }
        let tiles = self.cursor.u32(WHAT)?;
        let children = self.cursor.u32(WHAT)?;
        // Origin, value and state of a tile; of a child the origin and two masks at least.
        let least = u64::from(tiles) * (13 + bytes as u64) + u64::from(children) * (12 + 8192);
        self.cursor.expect(least, WHAT)?;
        self.keep((tiles as usize + children as usize) * size_of::<Root>())?;
        let mut roots = Vec::with_capacity(tiles as usize + children as usize);
        for _ in 0..tiles {
            roots.push(self.root_tile()?);
        }
        for _ in 0..children {
            let (cell, origin) = self.root_cell()?;
            let upper = self.upper(origin)?;
            roots.push(Root {
                cell,
                content: RootContent::Upper(Box::new(upper)),
            });
        }
        roots.sort_by_key(|root| root.cell);
        if let Some(pair) = roots.windows(2).find(|pair| pair[0].cell == pair[1].cell) {
            return Err(self.cursor.invalid(
                at,
                format!(
                    "the root has two entries at {:?}, one expected",
                    pair[0].cell.map(|i| i64::from(i) << ROOT_CELL_LOG2)
                ),
            ));
        }
        Ok(Tree {
            background: self.decoder.background,
            roots,
            active: self.active,
            leaves: self.leaves,
            held_bytes: 0,
            #[cfg(feature = "vdb-rs")]
            leaves_start: 0,
        })
    }

    /// The place of a root cell, in cells and in voxels.
    fn root_cell(&mut self) -> Result<([i32; 3], [i64; 3]), Error> {
        let at = self.cursor.offset();
        let origin = [
            self.cursor.i32(WHAT)?,
            self.cursor.i32(WHAT)?,
            self.cursor.i32(WHAT)?,
        ];
        if origin.iter().any(|i| i & ((1 << ROOT_CELL_LOG2) - 1) != 0) {
            return Err(self.cursor.invalid(
                at,
                format!("an entry of the root is at {origin:?}, multiples of 4096 expected"),
            ));
        }
        Ok((origin.map(|i| i >> ROOT_CELL_LOG2), origin.map(i64::from)))
    }

    fn root_tile(&mut self) -> Result<Root, Error> {
        let (cell, origin) = self.root_cell()?;
        let layout = self.decoder.layout;
        let mut value = layout.value(self.cursor.take(layout.bytes, WHAT)?);
        let active = self.cursor.u8(WHAT)? != 0;
        if active {
            self.active.add_tile(origin, ROOT_CELL_LOG2);
        }
        if layout.leaf == Leaf::Mask {
            value = layout.value(&[u8::from(active)]);
        }
        Ok(Root {
            cell,
            content: RootContent::Tile(value),
        })
    }

    /// Reads masks and tiles of a node at `origin` and calls `child` where its children are.
    fn node(
        &mut self,
        origin: [i64; 3],
        log2: u32,
        cell_log2: u32,
        child_bytes: u64,
        child: Child<'_, Self>,
    ) -> Result<Node, Error> {
        let cells = 1_usize << (3 * log2);
        let layout = self.decoder.layout;
        let mut children = vec![0; cells / 64].into_boxed_slice();
        let mut active = vec![0; cells / 64];
        self.cursor.mask(&mut children, WHAT)?;
        self.cursor.mask(&mut active, WHAT)?;
        let count = ones(&children);
        self.cursor.expect(count as u64 * child_bytes, WHAT)?;
        let place = |n: usize| {
            let offset = cell_offset(n, log2, cell_log2);
            std::array::from_fn(|a| origin[a] + offset[a])
        };
        let mut values = Vec::new();
        if layout.version < version::INTERNAL_COMPRESSION {
            // Children and tile values alternate, cell by cell.
            for n in 0..cells {
                if children[n / 64] >> (n % 64) & 1 != 0 {
                    child(self, place(n))?;
                    values.resize(values.len() + layout.bytes, 0);
                } else {
                    values.extend_from_slice(self.cursor.take(layout.bytes, WHAT)?);
                }
            }
        } else if layout.version < version::NODE_MASKS {
            // Values of tiles alone.
            let mut stored = Vec::new();
            self.decoder
                .node(self.cursor, &active, cells - count, &mut stored)?;
            values.resize(cells * layout.bytes, 0);
            let tiles = (0..cells).filter(|n| children[n / 64] >> (n % 64) & 1 == 0);
            for (n, value) in tiles.zip(stored.chunks_exact(layout.bytes)) {
                values[n * layout.bytes..][..layout.bytes].copy_from_slice(value);
            }
        } else {
            self.decoder
                .node(self.cursor, &active, cells, &mut values)?;
        }
        for n in bits_on(&active).filter(|n| children[n / 64] >> (n % 64) & 1 == 0) {
            self.active.add_tile(place(n), cell_log2);
        }
        let tiles = if layout.voxel.is_none() {
            Tiles::One(Value::default())
        } else if layout.leaf == Leaf::Mask {
            Tiles::Two(Value::default(), layout.value(&[1]), active.into())
        } else {
            if layout.leaf == Leaf::Bits {
                values.iter_mut().for_each(|v| *v = u8::from(*v != 0));
            }
            Tiles::new(values, layout.bytes, &children, &self.decoder)
        };
        // Masks, ranks, and what the tiles take.
        self.keep(children.len() * 10 + tiles.held())?;
        if layout.version >= version::INTERNAL_COMPRESSION {
            for n in bits_on(&children) {
                child(self, place(n))?;
            }
        }
        Ok(Node::new(children, tiles))
    }

    fn upper(&mut self, origin: [i64; 3]) -> Result<Upper, Error> {
        self.keep(size_of::<Upper>())?;
        let mut lowers = Vec::new();
        // A lower node has two masks of 512 bytes at least.
        let node = self.node(
            origin,
            UPPER_LOG2,
            UPPER_CELL_LOG2,
            1024,
            &mut |reader, origin| {
                // The vector grows by doubling.
                reader.keep(2 * size_of::<Lower>())?;
                lowers.push(reader.lower(origin)?);
                Ok(())
            },
        )?;
        Ok(Upper { node, lowers })
    }

    fn lower(&mut self, origin: [i64; 3]) -> Result<Lower, Error> {
        let mut leaves = 0;
        let node = self.node(
            origin,
            LOWER_LOG2,
            LOWER_CELL_LOG2,
            64,
            &mut |reader, origin| {
                let mut mask = [0; 8];
                reader.cursor.mask(&mut mask, WHAT)?;
                reader.active.add_leaf(origin, &mask);
                leaves += 1;
                Ok(())
            },
        )?;
        self.leaves += leaves;
        Ok(Lower {
            node,
            start: 0,
            leaves: Vec::new(),
        })
    }

    /// Walks over the values of all leaves, which follow the topology, and notes where they are.
    pub(super) fn locate_leaves(&mut self, tree: &mut Tree) -> Result<(), Error> {
        #[cfg(feature = "vdb-rs")]
        {
            tree.leaves_start = self.cursor.offset();
        }
        for root in &mut tree.roots {
            let RootContent::Upper(upper) = &mut root.content else {
                continue;
            };
            for lower in &mut upper.lowers {
                let count = ones(&lower.node.children);
                self.keep((count + 1) * size_of::<u32>())?;
                lower.start = self.cursor.offset();
                lower.leaves.reserve_exact(count + 1);
                lower.leaves.push(0);
                for _ in 0..count {
                    self.decoder.skip_leaf(self.cursor)?;
                    let length = self.cursor.offset() - lower.start;
                    let Ok(length) = u32::try_from(length) else {
                        return Err(self.cursor.invalid(
                            lower.start,
                            format!(
                                "the values of {count} leaves have {length} bytes, fewer expected"
                            ),
                        ));
                    };
                    lower.leaves.push(length);
                }
            }
        }
        tree.held_bytes = self.allowed() - self.budget;
        Ok(())
    }
}
