//! OpenVDB files by the crate `vdb-rs` 0.6, as a second reader beside our own.
//!
//! In: the bytes of a file. Out: a volume whose header is that of our reader and whose voxels are
//! those of `vdb-rs`, so that the two can be compared. It is taken only when it is asked for.
//!
//! **Where `vdb-rs` is wrong**, and what becomes of it here:
//!
//! | `vdb-rs` 0.6 | here |
//! |---|---|
//! | takes a missing inactive value for 0, whatever the background is: level sets lose their sign | refused unless the background is 0 |
//! | leaves out root tiles, or reads one as a voxel | refused |
//! | gives no voxels for double, int64, bool, mask and vectors | refused; float and int32 are read |
//! | loses its place in halves compressed with zip or Blosc where a node has no active value | refused |
//! | panics on scales without translation that differ by axis, on affine and frustum transforms | refused |
//! | panics on files written as streams, on versions before 219, on two buffers a leaf | refused: 222 and later are read |
//! | does not find the tree of an instance | refused |
//! | panics, allocates what a damaged file claims, or aborts | our reader reads all of the file first, and a panic becomes an error |
//! | holds all of the grid, 20 KiB a lower node | refused beyond the limit for inputs held in memory |

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use ::vdb_rs::{Grid, Node4, Node5, ParseError, VdbReader};

use super::archive::{Codec, Metadata, version};
use super::cursor::Cursor;
use super::grids::Grids;
use super::tree::{RootContent, Tree, Upper};
use super::values::{Decoder, LEAF_VOXELS, Value};
use super::voxels::VdbVoxels;
use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::{Format, Region, VoxelType};
use crate::parsed::Context;
use crate::volume::{RandomVoxels, Volume, Voxels};

/// Opens a grid of the file, if it is one that `vdb-rs` reads right.
pub(crate) fn open(file: FileBytes, context: &Context<'_>) -> Result<Volume, Error> {
    let (mut header, own) = super::read(&file, context)?;
    let name = checked_name(&file, context, &own)?;
    let held = held_bytes(&own.tree);
    let limit = context.options.spool_limit_bytes;
    if held > limit {
        return Err(Error::unsupported(
            context.name,
            format!(
                "vdb-rs would hold {held} bytes of the grid in memory, {limit} are allowed; our \
                 own reader (format vdb) holds little"
            ),
        ));
    }
    decode_all(&own)?;
    let bytes = file.read(0, file.len())?;
    let whole = std::io::Cursor::new(&*bytes);
    let failed = |reason: String| {
        Error::unsupported(
            context.name,
            format!("vdb-rs cannot read the file: {reason}"),
        )
    };
    let voxels = catch_unwind(AssertUnwindSafe(|| {
        let mut reader = VdbReader::new(whole)?;
        Ok::<Box<dyn RandomVoxels>, ParseError>(match header.voxel {
            VoxelType::F32 => Box::new(Theirs::new(reader.read_grid::<f32>(&name)?, &own)),
            _ => Box::new(Theirs::new(reader.read_grid::<i32>(&name)?, &own)),
        })
    }))
    .map_err(|_| failed("it panicked".into()))?
    .map_err(|e| failed(e.to_string()))?;
    file.check()?;
    header.format = Format::VdbRs;
    let mut source = file.source();
    source.compressed = true;
    source.mapped = false;
    source.held_bytes = held;
    Ok(Volume {
        header,
        voxels: Voxels::Random(voxels),
        source,
    })
}

/// The name of the chosen grid as `vdb-rs` has it, if it reads that grid right.
fn checked_name(file: &FileBytes, context: &Context<'_>, own: &VdbVoxels) -> Result<String, Error> {
    let grids = Grids::read(file)?;
    let grid = grids.choose(context.options.dataset.as_deref())?;
    let mut map = String::new();
    // It reads the metadata of all grids, so all must be sound.
    for other in grids.all() {
        let cursor = &mut Cursor::new(file, other.start);
        grids.header.compression(cursor)?;
        Metadata::read(cursor)?;
        if std::ptr::eq(other, grid) {
            map = cursor.string("the transform of a grid")?;
        }
    }
    let layout = &own.layout;
    let compressed = layout.compression.codec != Codec::None;
    let tiles = own.tree.roots.iter();
    let tiles = tiles.filter(|root| matches!(root.content, RootContent::Tile(_)));
    let reasons = [
        (
            grids.header.version < version::NODE_MASKS,
            "a file version before 222",
        ),
        (!grids.header.has_offsets, "a file written as a stream"),
        (grid.is_instance(), "a grid that shares the tree of another"),
        (
            !matches!(
                grid.kind.tree.as_str(),
                "Tree_float_5_4_3" | "Tree_int32_5_4_3"
            ),
            "a grid of another type than float and int32",
        ),
        (
            own.tree.background != Value::default(),
            "a background other than 0",
        ),
        (tiles.count() > 0, "tiles of the root"),
        (
            layout.has_halves() && compressed,
            "halves that are compressed",
        ),
        (
            !matches!(
                map.as_str(),
                "UniformScaleMap" | "UniformScaleTranslateMap" | "ScaleTranslateMap"
            ),
            "a transform of this type",
        ),
        (
            u64::try_from(grid.leaves) != Ok(own.tree.leaves_start),
            "leaves that are not where the index says",
        ),
    ];
    match reasons.into_iter().find(|(found, _)| *found) {
        None => Ok(grid.raw_name().to_owned()),
        Some((_, what)) => Err(Error::unsupported(
            context.name,
            format!("vdb-rs does not read {what} right; our own reader (format vdb) does"),
        )),
    }
}

/// Bytes that `vdb-rs` needs for a tree of values of four bytes.
fn held_bytes(tree: &Tree) -> u64 {
    /// Values and masks of a node, and some for the table it stands in.
    const UPPER: u64 = (4 + 1) * 32768;
    const LOWER: u64 = (4 + 1) * 4096;
    const LEAF: u64 = (4 + 1) * 512;
    let lowers: u64 = uppers(tree).map(|upper| upper.lowers.len() as u64).sum();
    UPPER * uppers(tree).count() as u64 + LOWER * lowers + LEAF * tree.leaves
}

fn uppers(tree: &Tree) -> impl Iterator<Item = &Upper> {
    tree.roots.iter().filter_map(|root| match &root.content {
        RootContent::Upper(upper) => Some(&**upper),
        RootContent::Tile(_) => None,
    })
}

/// Decodes every leaf, so that nothing damaged reaches `vdb-rs`, which trusts sizes.
fn decode_all(own: &VdbVoxels) -> Result<(), Error> {
    let mut decoder = Decoder::new(own.layout, own.tree.background);
    let mut values = Vec::new();
    for lower in uppers(&own.tree).flat_map(|upper| &upper.lowers) {
        for (offset, bytes) in (0..).map_while(|n| lower.leaf(n)) {
            decoder.leaf(&mut Cursor::over(&own.file, offset, bytes)?, &mut values)?;
        }
    }
    Ok(())
}

/// A value of four bytes.
trait Word: Copy + Send + Sync {
    fn bytes(self) -> [u8; 4];
}

impl Word for f32 {
    fn bytes(self) -> [u8; 4] {
        self.to_le_bytes()
    }
}

impl Word for i32 {
    fn bytes(self) -> [u8; 4] {
        self.to_le_bytes()
    }
}

/// Voxels of a grid that `vdb-rs` holds.
struct Theirs<T> {
    file: FileBytes,
    first: [i64; 3],
    dims: [u64; 3],
    roots: HashMap<[i64; 3], Node5<T>>,
}

/// Where the voxels of a block of 8^3 are.
enum Block<'a, T> {
    Leaf(&'a [T]),
    Tile(T),
    /// Outside the tree, where all is 0.
    Outside,
}

/// Number of the cell of a voxel in a node with 2^log2 cells of 2^cell_log2 voxels an axis.
fn number(index: [i64; 3], log2: u32, cell_log2: u32) -> usize {
    let [x, y, z] = index.map(|i| (i >> cell_log2 & ((1 << log2) - 1)) as usize);
    (x << log2 | y) << log2 | z
}

impl<T: Word> Theirs<T> {
    fn new(grid: Grid<T>, own: &VdbVoxels) -> Self {
        let roots = grid.tree.root_nodes.into_iter();
        Self {
            file: own.file.clone(),
            first: own.first,
            dims: own.dims,
            roots: roots
                .map(|node| (node.origin.to_array().map(|i| i64::from(i) >> 12), node))
                .collect(),
        }
    }

    /// The block of the voxel at `index`; `None` where a node has fewer values than cells.
    fn block(&self, index: [i64; 3]) -> Option<Block<'_, T>> {
        let Some(upper) = self.roots.get(&index.map(|i| i >> 12)) else {
            return Some(Block::Outside);
        };
        let n = number(index, 5, 7);
        let Some(lower): Option<&Node4<T>> = upper.nodes.get(&(n as u32)) else {
            return upper.data.get(n).map(|value| Block::Tile(*value));
        };
        let n = number(index, 4, 3);
        match lower.nodes.get(&(n as u32)) {
            Some(leaf) => Some(Block::Leaf(leaf.buffer.get(..LEAF_VOXELS)?)),
            None => lower.data.get(n).map(|value| Block::Tile(*value)),
        }
    }
}

impl<T: Word> RandomVoxels for Theirs<T> {
    fn read_box(&self, region: &Region, out: &mut Vec<u8>) -> Result<(), Error> {
        let name = self.file.name();
        region.check_inside(self.dims, name)?;
        region.make_room(4, out, name)?;
        let first = [0, 1, 2].map(|a| self.first[a] + region.origin[a] as i64);
        let mut voxels = out.as_chunks_mut::<4>().0.iter_mut();
        let [nx, ny, nz] = region.size.map(|n| n as i64);
        for z in first[2]..first[2] + nz {
            for y in first[1]..first[1] + ny {
                let mut block = Block::Outside;
                for x in first[0]..first[0] + nx {
                    if x == first[0] || x & 7 == 0 {
                        block = self.block([x, y, z]).ok_or_else(|| {
                            Error::invalid(name, "vdb-rs gave a node with too few values")
                        })?;
                    }
                    let value = match block {
                        Block::Leaf(values) => values[number([x, y, z], 3, 0)].bytes(),
                        Block::Tile(value) => value.bytes(),
                        Block::Outside => [0; 4],
                    };
                    if let Some(voxel) = voxels.next() {
                        *voxel = value;
                    }
                }
            }
        }
        Ok(())
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

    /// All that is used is in memory.
    fn check(&self) -> Result<(), Error> {
        Ok(())
    }
}
