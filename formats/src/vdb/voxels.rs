//! Boxes of voxels out of a tree.
//!
//! In: a [`Tree`] and the bytes of the file. Out: [`RandomVoxels`] of a box of the index space.
//! A box costs what its leaves cost; tiles and the space outside the tree are filled in. Whether
//! a box has one value is answered from the nodes alone, so that empty space costs nothing:
//! a box that touches a leaf is said to be unknown, without a look at it.

use std::ops::Range;

use super::cursor::Cursor;
use super::tree::{
    LOWER_CELL_LOG2, LOWER_LOG2, Lower, Node, ROOT_CELL_LOG2, Root, RootContent, Tiles, Tree,
    UPPER_CELL_LOG2, UPPER_LOG2, Upper,
};
use super::values::{Decoder, LEAF_VOXELS, Layout, Value};
use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::Region;
use crate::volume::RandomVoxels;

/// The voxels of a box of a grid.
pub(super) struct VdbVoxels {
    pub(super) file: FileBytes,
    pub(super) tree: Tree,
    pub(super) layout: Layout,
    /// Index in the grid of voxel (0, 0, 0).
    pub(super) first: [i64; 3],
    pub(super) dims: [u64; 3],
}

/// Gives back what is resident of a file that is mapped.
pub(super) fn release(file: &FileBytes) {
    if let (Some(map), Ok(length)) = (file.map(), usize::try_from(file.len())) {
        map.release(0, length);
    }
}

/// A box of the index space of the grid: first index, and the one behind the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Span {
    from: [i64; 3],
    to: [i64; 3],
}

impl Span {
    /// The part of it in the cube of 2^log2 voxels a side at `origin`, if there is one.
    fn within(&self, origin: [i64; 3], log2: u32) -> Option<Self> {
        let span = Self {
            from: [0, 1, 2].map(|a| self.from[a].max(origin[a])),
            to: [0, 1, 2].map(|a| self.to[a].min(origin[a] + (1 << log2))),
        };
        (0..3).all(|a| span.from[a] < span.to[a]).then_some(span)
    }

    /// The cells it touches of a node at `origin`, whose cells have 2^cell_log2 voxels a side,
    /// for a span within the node.
    fn cells(&self, origin: [i64; 3], cell_log2: u32) -> [Range<usize>; 3] {
        [0, 1, 2].map(|a| {
            let first = (self.from[a] - origin[a]) >> cell_log2;
            let last = (self.to[a] - 1 - origin[a]) >> cell_log2;
            first as usize..last as usize + 1
        })
    }

    /// First and last cell of the root it touches.
    fn root_cells(&self) -> [[i64; 3]; 2] {
        [
            self.from.map(|i| i >> ROOT_CELL_LOG2),
            self.to.map(|i| (i - 1) >> ROOT_CELL_LOG2),
        ]
    }
}

/// A piece of a box whose voxels are known or can be decoded.
enum Piece {
    /// All have this value.
    Fill(Span, Value),
    /// They are those of a leaf.
    Leaf {
        span: Span,
        origin: [i64; 3],
        offset: u64,
        bytes: u64,
    },
}

/// The number and the origin of every cell of `span` in a node at `origin`.
fn cells(
    span: &Span,
    origin: [i64; 3],
    log2: u32,
    cell_log2: u32,
) -> impl Iterator<Item = (usize, [i64; 3])> {
    numbers(span.cells(origin, cell_log2), log2).map(move |(n, cell)| {
        let offset = cell.map(|i| (i as i64) << cell_log2);
        (n, [0, 1, 2].map(|a| origin[a] + offset[a]))
    })
}

/// The numbers and places of the cells of a box in a node with 2^log2 cells along each axis.
fn numbers(
    [xs, ys, zs]: [Range<usize>; 3],
    log2: u32,
) -> impl Iterator<Item = (usize, [usize; 3])> {
    xs.flat_map(move |x| {
        let zs = zs.clone();
        ys.clone().flat_map(move |y| {
            zs.clone()
                .map(move |z| ((x << log2 | y) << log2 | z, [x, y, z]))
        })
    })
}

type Visit<'a> = &'a mut dyn FnMut(Piece) -> Result<(), Error>;

/// Fills a span, unless it has the value already.
fn fill(span: &Span, value: Value, beneath: Option<Value>, visit: Visit<'_>) -> Result<(), Error> {
    if beneath == Some(value) {
        return Ok(());
    }
    visit(Piece::Fill(*span, value))
}

/// Fills all of a node's span with a value that many of its tiles have, and gives what is then
/// beneath its children and other tiles.
fn fill_common(
    node: &Node,
    span: &Span,
    beneath: Option<Value>,
    visit: Visit<'_>,
) -> Result<Option<Value>, Error> {
    match &node.tiles {
        Tiles::One(value) | Tiles::Two(value, ..) => {
            fill(span, *value, beneath, visit)?;
            Ok(Some(*value))
        }
        Tiles::All(_) => Ok(beneath),
    }
}

impl VdbVoxels {
    /// The box of the index space that a region of the volume is.
    fn span(&self, region: &Region) -> Span {
        // Regions are checked against the extents, and those against the index space.
        Span {
            from: [0, 1, 2].map(|a| self.first[a] + region.origin[a] as i64),
            to: [0, 1, 2].map(|a| self.first[a] + (region.origin[a] + region.size[a]) as i64),
        }
    }

    /// The entries of the root that `span` touches, and whether they cover it.
    fn roots(&self, span: &Span) -> (impl Iterator<Item = &Root>, bool) {
        let [first, last] = span.root_cells();
        let x = |root: &Root| i64::from(root.cell[0]);
        let from = self.tree.roots.partition_point(|root| x(root) < first[0]);
        let to = self.tree.roots.partition_point(|root| x(root) <= last[0]);
        let touched = move |root: &&Root| {
            (1..3).all(|a| (first[a]..=last[a]).contains(&i64::from(root.cell[a])))
        };
        let found = &self.tree.roots[from..to];
        let cells = (0..3)
            .map(|a| i128::from(last[a] - first[a] + 1))
            .product::<i128>();
        let covered = found.iter().filter(touched).count() as i128 == cells;
        (found.iter().filter(touched), covered)
    }

    /// Takes `span` apart. Later pieces lie over earlier ones.
    fn visit(&self, span: &Span, visit: Visit<'_>) -> Result<(), Error> {
        let (roots, covered) = self.roots(span);
        // The value that lies beneath what follows.
        let beneath = if covered {
            None
        } else {
            visit(Piece::Fill(*span, self.tree.background))?;
            Some(self.tree.background)
        };
        for root in roots {
            let origin = root.cell.map(|i| i64::from(i) << ROOT_CELL_LOG2);
            let Some(span) = span.within(origin, ROOT_CELL_LOG2) else {
                continue;
            };
            match &root.content {
                RootContent::Tile(value) => fill(&span, *value, beneath, visit)?,
                RootContent::Upper(upper) => {
                    self.visit_upper(upper, origin, &span, beneath, visit)?;
                }
            }
        }
        Ok(())
    }

    fn visit_upper(
        &self,
        upper: &Upper,
        origin: [i64; 3],
        span: &Span,
        beneath: Option<Value>,
        visit: Visit<'_>,
    ) -> Result<(), Error> {
        let node = &upper.node;
        let beneath = fill_common(node, span, beneath, visit)?;
        for (n, origin) in cells(span, origin, UPPER_LOG2, UPPER_CELL_LOG2) {
            let Some(span) = span.within(origin, UPPER_CELL_LOG2) else {
                continue;
            };
            match node.child(n).and_then(|i| upper.lowers.get(i)) {
                Some(lower) => self.visit_lower(lower, origin, &span, beneath, visit)?,
                None => fill(
                    &span,
                    node.tiles.value(n, self.layout.bytes),
                    beneath,
                    visit,
                )?,
            }
        }
        Ok(())
    }

    fn visit_lower(
        &self,
        lower: &Lower,
        origin: [i64; 3],
        span: &Span,
        beneath: Option<Value>,
        visit: Visit<'_>,
    ) -> Result<(), Error> {
        let node = &lower.node;
        let beneath = fill_common(node, span, beneath, visit)?;
        for (n, origin) in cells(span, origin, LOWER_LOG2, LOWER_CELL_LOG2) {
            let Some(span) = span.within(origin, LOWER_CELL_LOG2) else {
                continue;
            };
            match node.child(n).and_then(|i| lower.leaf(i)) {
                Some((offset, bytes)) => visit(Piece::Leaf {
                    span,
                    origin,
                    offset,
                    bytes,
                })?,
                None => fill(
                    &span,
                    node.tiles.value(n, self.layout.bytes),
                    beneath,
                    visit,
                )?,
            }
        }
        Ok(())
    }

    fn read<const W: usize>(&self, region: &Region, out: &mut [u8]) -> Result<(), Error> {
        let span = self.span(region);
        let mut decoder = Decoder::new(self.layout, self.tree.background);
        let mut values = Vec::new();
        let mut target = Target::<W> {
            voxels: out.as_chunks_mut().0,
            span,
            // The region fits memory, so its extents do.
            size: region.size.map(|n| n as usize),
        };
        self.visit(&span, &mut |piece| {
            match piece {
                Piece::Fill(span, value) => target.fill(&span, value),
                Piece::Leaf {
                    span,
                    origin,
                    offset,
                    bytes,
                } => {
                    let mut cursor = Cursor::over(&self.file, offset, bytes)?;
                    decoder.leaf(&mut cursor, &mut values)?;
                    target.leaf(&span, origin, values.as_chunks().0);
                }
            }
            Ok(())
        })
    }
}

/// The voxels that are read, x fastest.
struct Target<'a, const W: usize> {
    voxels: &'a mut [[u8; W]],
    span: Span,
    size: [usize; 3],
}

impl<const W: usize> Target<'_, W> {
    /// The voxels of row (y, z) of `span`, which lies within.
    fn row(&mut self, span: &Span, y: i64, z: i64) -> &mut [[u8; W]] {
        let [x0, y0, z0] = self.span.from;
        let (x, y, z) = (span.from[0] - x0, (y - y0) as usize, (z - z0) as usize);
        let start = (z * self.size[1] + y) * self.size[0] + x as usize;
        let count = (span.to[0] - span.from[0]) as usize;
        &mut self.voxels[start..start + count]
    }

    fn fill(&mut self, span: &Span, value: Value) {
        let mut short = [0; W];
        short.copy_from_slice(&value[..W]);
        for z in span.from[2]..span.to[2] {
            for y in span.from[1]..span.to[1] {
                self.row(span, y, z).fill(short);
            }
        }
    }

    /// Copies the part of a leaf at `origin` that is `span`.
    fn leaf(&mut self, span: &Span, origin: [i64; 3], values: &[[u8; W]]) {
        let Some(values) = values.first_chunk::<LEAF_VOXELS>() else {
            return;
        };
        let x = (span.from[0] - origin[0]) as usize;
        for z in span.from[2]..span.to[2] {
            for y in span.from[1]..span.to[1] {
                let column = ((y - origin[1]) << 3 | (z - origin[2])) as usize;
                let from = values[column..].iter().step_by(64).skip(x);
                for (to, from) in self.row(span, y, z).iter_mut().zip(from) {
                    *to = *from;
                }
            }
        }
    }
}

/// The one value of several parts, as far as they were looked at.
struct Same(Option<Value>);

impl Same {
    /// Whether `value` is that of all the others, too.
    fn is(&mut self, value: Value) -> bool {
        *self.0.get_or_insert(value) == value
    }
}

/// Whether no cell of the ranges is on, or all are, in a mask of a node; `None` for a mixture.
fn all_or_none(mask: &[u64], cells: &[Range<usize>; 3], log2: u32) -> Option<bool> {
    let [xs, ys, zs] = cells;
    // A row of z lies within a word.
    let row = (!0_u64 >> (64 - zs.len().clamp(1, 64))) << zs.start;
    let mut found = None;
    for x in xs.clone() {
        for y in ys.clone() {
            let n = (x << log2 | y) << log2;
            let on = mask[n / 64] >> (n % 64) & row;
            let on = match on {
                0 => false,
                all if all == row => true,
                _ => return None,
            };
            if *found.get_or_insert(on) != on {
                return None;
            }
        }
    }
    found
}

impl VdbVoxels {
    /// The value of all voxels of `span`, if its nodes say so.
    fn one_value(&self, span: &Span) -> Option<Value> {
        let mut same = Same(None);
        let (roots, covered) = self.roots(span);
        if !covered {
            same.is(self.tree.background);
        }
        for root in roots {
            let origin = root.cell.map(|i| i64::from(i) << ROOT_CELL_LOG2);
            let span = span.within(origin, ROOT_CELL_LOG2)?;
            let agrees = match &root.content {
                RootContent::Tile(value) => same.is(*value),
                RootContent::Upper(upper) => self.one_value_upper(upper, origin, &span, &mut same),
            };
            if !agrees {
                return None;
            }
        }
        same.0
    }

    fn one_value_upper(
        &self,
        upper: &Upper,
        origin: [i64; 3],
        span: &Span,
        same: &mut Same,
    ) -> bool {
        let node = &upper.node;
        let cells = span.cells(origin, UPPER_CELL_LOG2);
        let no_children = all_or_none(&node.children, &cells, UPPER_LOG2) == Some(false);
        if no_children {
            return self.one_tile(node, &cells, UPPER_LOG2, same);
        }
        let mut touched = self::cells(span, origin, UPPER_LOG2, UPPER_CELL_LOG2);
        touched.all(|(n, origin)| {
            let lower = node.child(n).and_then(|i| upper.lowers.get(i));
            match (lower, span.within(origin, UPPER_CELL_LOG2)) {
                (Some(lower), Some(span)) => {
                    let cells = span.cells(origin, LOWER_CELL_LOG2);
                    let leaves = &lower.node.children;
                    all_or_none(leaves, &cells, LOWER_LOG2) == Some(false)
                        && self.one_tile(&lower.node, &cells, LOWER_LOG2, same)
                }
                (None, _) => same.is(node.tiles.value(n, self.layout.bytes)),
                (Some(_), None) => true,
            }
        })
    }

    /// Whether the tiles of `cells`, none of which is a child, have the same value.
    fn one_tile(&self, node: &Node, cells: &[Range<usize>; 3], log2: u32, same: &mut Same) -> bool {
        match &node.tiles {
            Tiles::One(value) => same.is(*value),
            Tiles::Two(first, second, mask) => match all_or_none(mask, cells, log2) {
                Some(false) => same.is(*first),
                Some(true) => same.is(*second),
                None => false,
            },
            Tiles::All(_) => numbers(cells.clone(), log2)
                .all(|(n, _)| same.is(node.tiles.value(n, self.layout.bytes))),
        }
    }
}

impl RandomVoxels for VdbVoxels {
    fn read_box(&self, region: &Region, out: &mut Vec<u8>) -> Result<(), Error> {
        let name = self.file.name();
        region.check_inside(self.dims, name)?;
        self.file.check()?;
        region.make_room(self.layout.bytes, out, name)?;
        if out.is_empty() {
            return Ok(());
        }
        match self.layout.bytes {
            1 => self.read::<1>(region, out)?,
            2 => self.read::<2>(region, out)?,
            4 => self.read::<4>(region, out)?,
            _ => self.read::<8>(region, out)?,
        }
        self.file.check()
    }

    fn planes(&self, z: u64, count: u64) -> Result<Option<&[u8]>, Error> {
        let [x, y, _] = self.dims;
        let region = Region {
            origin: [0, 0, z],
            size: [x, y, count],
        };
        region.check_inside(self.dims, self.file.name())?;
        Ok(None)
    }

    fn check(&self) -> Result<(), Error> {
        self.file.check()
    }

    /// Leaves.
    fn chunk(&self) -> Option<[u64; 3]> {
        Some([1 << LOWER_CELL_LOG2; 3])
    }

    fn chunk_start(&self) -> [u64; 3] {
        self.first
            .map(|i| i.rem_euclid(1 << LOWER_CELL_LOG2).unsigned_abs())
    }

    /// Leaves of a plane lie all over the file, so all of it is given back.
    fn release(&self, _z_end: u64) {
        release(&self.file);
    }

    fn uniform(&self, region: &Region) -> Option<Value> {
        if !region.is_inside(self.dims) || region.size.contains(&0) {
            return None;
        }
        self.one_value(&self.span(region))
    }
}
