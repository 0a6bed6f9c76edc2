//! Values of nodes: which types there are, and how a node's values are stored.
//!
//! In: a cursor at the values of a node, and the node's mask of active values. Out: all its
//! values, inactive ones too, as little-endian bytes; or the cursor behind them.
//!
//! Since file version 222 a node's values begin with a byte that says which inactive values were
//! left out, and what they were:
//!
//! | byte | inactive values |
//! |---|---|
//! | 0 | the background |
//! | 1 | minus the background |
//! | 2 | one value, which follows |
//! | 3 | minus the background, or the background where a selection mask is on |
//! | 4 | one value, or the background where the mask is on |
//! | 5 | one value, or another where the mask is on; both follow |
//! | 6 | stored with the active ones |
//!
//! Then come the stored values, with a size of eight bytes in front where they are compressed;
//! not above zero, it is minus the size of values that were left as they are. Half floats become
//! floats (or doubles) here; the background and inactive values are never stored as halves.

use super::archive::{Codec, Compression, version};
use super::cursor::Cursor;
use crate::codec::{blosc, exactly};
use crate::error::Error;
use crate::header::VoxelType;

/// Bytes of one value, the first ones used.
pub(super) type Value = [u8; 8];

/// Voxels of a leaf: eight along each axis.
pub(super) const LEAF_VOXELS: usize = 512;

/// How leaves store their values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Leaf {
    /// As any node.
    Values,
    /// A bit a voxel, beside the mask of active voxels.
    Bits,
    /// Not at all: the active voxels are those that are on.
    Mask,
}

/// What a grid holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Content {
    /// Numbers, which are read.
    Scalar(VoxelType, Leaf),
    /// Vectors of so many bytes (stored as halves: so many), which are only read over.
    Vector(usize, usize),
    /// Something whose end cannot be found without reading it as OpenVDB does.
    Opaque(&'static str),
}

/// Type of a grid: its values, and the shape of its tree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Kind {
    /// As written in the file: `Tree_float_5_4_3`.
    pub(super) tree: String,
    /// The list of grids says that real numbers are stored as half floats. How they are stored is
    /// said by the metadata of the grid.
    half: bool,
    pub(super) content: Content,
}

impl Kind {
    /// The kind that a file calls `tree`.
    pub(super) fn of(tree: &str, half: bool) -> Self {
        let parts = tree
            .strip_prefix("Tree_")
            .and_then(|rest| rest.split_once('_'));
        let content = match parts {
            Some((value, "5_4_3")) => Self::content(value),
            Some(_) => Content::Opaque("a tree of another shape than 5_4_3"),
            None => Content::Opaque("not a known type of tree"),
        };
        Self {
            tree: tree.to_owned(),
            half,
            content,
        }
    }

    fn content(value: &str) -> Content {
        use VoxelType::{Bool, F16, F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
        let voxel = match value {
            "float" => F32,
            "double" => F64,
            "half" => F16,
            "int8" => I8,
            "uint8" => U8,
            "int16" => I16,
            "uint16" => U16,
            "int32" => I32,
            "uint32" => U32,
            "int64" => I64,
            "uint64" => U64,
            "bool" => return Content::Scalar(Bool, Leaf::Bits),
            "mask" => return Content::Scalar(Bool, Leaf::Mask),
            "vec2i" => return Content::Vector(8, 8),
            "vec2s" => return Content::Vector(8, 4),
            "vec2d" => return Content::Vector(16, 4),
            "vec3i" => return Content::Vector(12, 12),
            "vec3s" => return Content::Vector(12, 6),
            "vec3d" => return Content::Vector(24, 6),
            "string" => return Content::Opaque("a grid of strings"),
            "ptidx32" | "ptidx64" | "ptdataidx32" | "ptdataidx64" => {
                return Content::Opaque("a grid of points");
            }
            _ => return Content::Opaque("values of an unknown type"),
        };
        Content::Scalar(voxel, Leaf::Values)
    }

    /// Short description for lists: `float`, `float as half`, `vec3s`.
    pub(super) fn short(&self) -> String {
        let name = value_name(&self.tree);
        let half = if self.half { " as half" } else { "" };
        format!("{name}{half}")
    }

    /// What a grid of this kind is, if it cannot even be read over.
    pub(super) fn opaque(&self) -> Option<&'static str> {
        match self.content {
            Content::Opaque(reason) => Some(reason),
            _ => None,
        }
    }

    /// Why a grid of this kind is not read; `None` if it is.
    pub(super) fn refusal(&self) -> Option<String> {
        let reason = match self.content {
            Content::Scalar(..) => return None,
            Content::Vector(..) => "a grid of vectors",
            Content::Opaque(reason) => reason,
        };
        Some(format!(
            "{reason} ({}); grids of numbers, bool and mask with trees 5_4_3 are read",
            self.tree
        ))
    }
}

/// The name of the values in the name of a tree, or the whole of it.
fn value_name(tree: &str) -> &str {
    match tree.strip_prefix("Tree_") {
        Some(rest) => rest.strip_suffix("_5_4_3").unwrap_or(rest),
        None => tree,
    }
}

/// How the values of one grid are stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    /// Type of the voxels; `None` for vectors, which are only read over.
    pub(super) voxel: Option<VoxelType>,
    pub(super) leaf: Leaf,
    /// Bytes of a value.
    pub(super) bytes: usize,
    /// Bytes of a value among those of a node: fewer where they are stored as halves.
    stored: usize,
    pub(super) compression: Compression,
    pub(super) version: u32,
}

impl Layout {
    /// How a grid of this kind is stored, real numbers as halves or not; `None` if that is not
    /// known.
    pub(super) fn new(
        kind: &Kind,
        half: bool,
        compression: Compression,
        file_version: u32,
    ) -> Option<Self> {
        let (voxel, leaf, bytes, half_bytes) = match kind.content {
            Content::Scalar(voxel, leaf) => {
                let bytes = voxel.bytes();
                let half_bytes = if voxel.is_float() { 2 } else { bytes };
                (Some(voxel), leaf, bytes, half_bytes)
            }
            Content::Vector(bytes, half) => (None, Leaf::Values, bytes, half),
            Content::Opaque(_) => return None,
        };
        Some(Self {
            voxel,
            leaf,
            bytes,
            stored: if half { half_bytes } else { bytes },
            compression,
            version: file_version,
        })
    }

    /// Whether real numbers are stored as halves.
    #[cfg(feature = "vdb-rs")]
    pub(super) fn has_halves(&self) -> bool {
        self.stored != self.bytes
    }

    /// The value that the bytes of one in the file are.
    pub(super) fn value(&self, bytes: &[u8]) -> Value {
        let mut value = Value::default();
        for (to, from) in value.iter_mut().zip(bytes) {
            *to = *from;
        }
        if self.voxel == Some(VoxelType::Bool) {
            value[0] = u8::from(value[0] != 0);
        }
        value
    }

    /// Minus a value, as OpenVDB has it: of a bool, the other one.
    fn negative(&self, value: Value) -> Value {
        let mut negative = value;
        match self.voxel {
            None => {}
            Some(VoxelType::Bool) => negative[0] ^= 1,
            Some(voxel) if voxel.is_float() => negative[voxel.bytes() - 1] ^= 0x80,
            // The low bytes of minus a number are minus its low bytes.
            Some(_) => negative = u64::from_le_bytes(value).wrapping_neg().to_le_bytes(),
        }
        for byte in &mut negative[self.bytes.min(8)..] {
            *byte = 0;
        }
        negative
    }
}

/// Reads the values of nodes of one grid. Holds what is needed from node to node.
pub(super) struct Decoder {
    pub(super) layout: Layout,
    /// Value outside the tree.
    pub(super) background: Value,
    inflate: Option<flate2::Decompress>,
    /// Stored values, decompressed.
    packed: Vec<u8>,
    /// Stored values that were halves.
    wide: Vec<u8>,
    /// Which of two inactive values a voxel has.
    selection: Vec<u64>,
}

/// What the first bytes of a node's values say.
struct Prefix {
    /// Inactive values are stored as well.
    stores_all: bool,
    /// Inactive values where the selection mask is off and on.
    inactive: [Value; 2],
}

const WHAT: &str = "the values of a node";

impl Decoder {
    pub(super) fn new(layout: Layout, background: Value) -> Self {
        Self {
            layout,
            background,
            inflate: None,
            packed: Vec::new(),
            wide: Vec::new(),
            selection: Vec::new(),
        }
    }

    /// Reads what stands before the values of a node with a mask of `words` words.
    fn prefix(&mut self, cursor: &mut Cursor<'_>, words: usize) -> Result<Prefix, Error> {
        let layout = self.layout;
        self.selection.clear();
        self.selection.resize(words, 0);
        let mut prefix = Prefix {
            stores_all: true,
            inactive: [self.background; 2],
        };
        if layout.version < version::NODE_MASKS {
            return Ok(prefix);
        }
        let at = cursor.offset();
        let case = cursor.u8(WHAT)?;
        if case > 6 {
            return Err(cursor.invalid(
                at,
                format!("the values of a node begin with {case}, 0 to 6 expected"),
            ));
        }
        prefix.stores_all = !layout.compression.active_mask || case == 6;
        if case == 1 || case == 3 {
            prefix.inactive[0] = layout.negative(self.background);
        }
        if matches!(case, 2 | 4 | 5) {
            prefix.inactive[0] = layout.value(cursor.take(layout.bytes, WHAT)?);
        }
        if case == 5 {
            prefix.inactive[1] = layout.value(cursor.take(layout.bytes, WHAT)?);
        }
        if matches!(case, 3..=5) {
            cursor.mask(&mut self.selection, WHAT)?;
        }
        Ok(prefix)
    }

    /// Replaces `out` by the values of a node: all `count` of them if they are all stored, which
    /// old files do with fewer than the mask has bits; else as many as the mask `active` has bits.
    pub(super) fn node(
        &mut self,
        cursor: &mut Cursor<'_>,
        active: &[u64],
        count: usize,
        out: &mut Vec<u8>,
    ) -> Result<(), Error> {
        let layout = self.layout;
        let prefix = self.prefix(cursor, active.len())?;
        let stored = if prefix.stores_all {
            count
        } else {
            ones(active)
        };
        out.clear();
        if layout.voxel.is_none() {
            return self.skip_stored(cursor, stored);
        }
        let packed = stored_values(
            cursor,
            &layout,
            stored,
            &mut self.inflate,
            &mut self.packed,
            &mut self.wide,
        )?;
        if prefix.stores_all {
            out.extend_from_slice(packed);
            return Ok(());
        }
        out.resize(active.len() * 64 * layout.bytes, 0);
        let (selection, inactive) = (&self.selection, prefix.inactive);
        match layout.bytes {
            1 => expand::<1>(packed, active, selection, inactive, out),
            2 => expand::<2>(packed, active, selection, inactive, out),
            4 => expand::<4>(packed, active, selection, inactive, out),
            _ => expand::<8>(packed, active, selection, inactive, out),
        }
        Ok(())
    }

    /// Moves behind `count` stored values.
    fn skip_stored(&self, cursor: &mut Cursor<'_>, count: usize) -> Result<(), Error> {
        match size(cursor, &self.layout, count)? {
            Stored::Plain(bytes) | Stored::Compressed(bytes) => cursor.skip(bytes as u64, WHAT),
        }
    }

    /// Moves behind the buffer of a leaf.
    pub(super) fn skip_leaf(&mut self, cursor: &mut Cursor<'_>) -> Result<(), Error> {
        let layout = self.layout;
        let mut active = [0; LEAF_VOXELS / 64];
        cursor.mask(&mut active, WHAT)?;
        match layout.leaf {
            Leaf::Mask => cursor.skip(12, WHAT),
            Leaf::Bits if layout.version >= version::BOOL_LEAVES => cursor.skip(12 + 64, WHAT),
            Leaf::Bits => {
                for _ in 0..old_buffers(cursor)? {
                    self.skip_stored(cursor, LEAF_VOXELS)?;
                }
                Ok(())
            }
            Leaf::Values => {
                let buffers = if layout.version < version::NODE_MASKS {
                    old_buffers(cursor)?
                } else {
                    1
                };
                let prefix = self.prefix(cursor, active.len())?;
                let stored = if prefix.stores_all {
                    LEAF_VOXELS
                } else {
                    ones(&active)
                };
                self.skip_stored(cursor, stored)?;
                for _ in 1..buffers {
                    self.skip_stored(cursor, LEAF_VOXELS)?;
                }
                Ok(())
            }
        }
    }

    /// Replaces `out` by the 512 values of the leaf at the cursor, z fastest.
    pub(super) fn leaf(&mut self, cursor: &mut Cursor<'_>, out: &mut Vec<u8>) -> Result<(), Error> {
        let layout = self.layout;
        let mut bits = [0; LEAF_VOXELS / 64];
        cursor.mask(&mut bits, WHAT)?;
        match layout.leaf {
            Leaf::Values => {
                if layout.version < version::NODE_MASKS {
                    old_buffers(cursor)?;
                }
                return self.node(cursor, &bits, LEAF_VOXELS, out);
            }
            Leaf::Bits if layout.version < version::BOOL_LEAVES => {
                old_buffers(cursor)?;
                self.node(cursor, &bits, LEAF_VOXELS, out)?;
                out.iter_mut()
                    .for_each(|value| *value = u8::from(*value != 0));
                return Ok(());
            }
            Leaf::Bits => {
                cursor.skip(12, WHAT)?;
                cursor.mask(&mut bits, WHAT)?;
            }
            Leaf::Mask => {}
        }
        out.clear();
        for word in bits {
            out.extend((0..64).map(|bit| u8::from(word >> bit & 1 != 0)));
        }
        Ok(())
    }
}

/// Reads the origin of a leaf of old files, which is known, and its number of buffers, of which
/// the first is read.
fn old_buffers(cursor: &mut Cursor<'_>) -> Result<u8, Error> {
    cursor.skip(12, WHAT)?;
    let at = cursor.offset();
    match cursor.u8(WHAT)? {
        count @ 1..128 => Ok(count),
        count => Err(cursor.invalid(at, format!("a leaf has {count} buffers, 1 to 127 expected"))),
    }
}

/// Number of bits that are on.
pub(super) fn ones(mask: &[u64]) -> usize {
    mask.iter().map(|word| word.count_ones() as usize).sum()
}

/// Bytes that the values of a node take in the file.
enum Stored {
    Plain(usize),
    Compressed(usize),
}

/// Reads the size in front of `count` stored values.
fn size(cursor: &mut Cursor<'_>, layout: &Layout, count: usize) -> Result<Stored, Error> {
    let expected = count * layout.stored;
    // Of no halves nothing is stored, not even the size.
    let no_halves = count == 0 && layout.stored != layout.bytes;
    if layout.compression.codec == Codec::None || no_halves {
        return Ok(Stored::Plain(expected));
    }
    let at = cursor.offset();
    let size = cursor.i64(WHAT)?;
    match usize::try_from(size) {
        Ok(bytes) if bytes > 0 => Ok(Stored::Compressed(bytes)),
        _ if size.checked_neg() == i64::try_from(expected).ok() => Ok(Stored::Plain(expected)),
        _ => Err(cursor.invalid(
            at,
            format!("values of a node have the size {size}, -{expected} or above 0 expected"),
        )),
    }
}

/// `count` values as they are stored, decompressed, and no longer halves.
fn stored_values<'a>(
    cursor: &'a mut Cursor<'_>,
    layout: &Layout,
    count: usize,
    inflate: &mut Option<flate2::Decompress>,
    packed: &'a mut Vec<u8>,
    wide: &'a mut Vec<u8>,
) -> Result<&'a [u8], Error> {
    let expected = count * layout.stored;
    let at = cursor.offset();
    let narrow = match size(cursor, layout, count)? {
        Stored::Plain(bytes) => cursor.take(bytes, WHAT)?,
        Stored::Compressed(bytes) => {
            let blosc = layout.compression.codec == Codec::Blosc;
            let decoded = {
                let data = cursor.take(bytes, WHAT)?;
                if expected == 0 {
                    // Blosc of nothing is a header, zlib of nothing a few bytes.
                    packed.clear();
                    Ok(())
                } else if blosc {
                    blosc::decode(data, expected, packed)
                        .and_then(|()| exactly(expected, packed))
                        .map_err(|e| e.message().to_owned())
                } else {
                    unzip(data, expected, inflate, packed)
                }
            };
            if let Err(reason) = decoded {
                return Err(cursor.invalid(
                    at,
                    format!(
                        "{count} values of a node, {bytes} bytes compressed, are damaged: {reason}"
                    ),
                ));
            }
            packed
        }
    };
    if layout.stored == layout.bytes {
        return Ok(narrow);
    }
    wide.clear();
    let halves = narrow
        .chunks_exact(2)
        .map(|half| half::f16::from_le_bytes([half[0], half[1]]));
    if layout.bytes == 4 {
        wide.extend(halves.flat_map(|half| half.to_f32().to_le_bytes()));
    } else {
        wide.extend(halves.flat_map(|half| half.to_f64().to_le_bytes()));
    }
    Ok(wide)
}

/// Decompresses zlib data that must give `expected` bytes.
fn unzip(
    data: &[u8],
    expected: usize,
    inflate: &mut Option<flate2::Decompress>,
    out: &mut Vec<u8>,
) -> Result<(), String> {
    let inflate = inflate.get_or_insert_with(|| flate2::Decompress::new(true));
    inflate.reset(true);
    out.clear();
    out.reserve_exact(expected);
    // No more is written than the capacity, which may be larger from the node before.
    let status = inflate
        .decompress_vec(data, out, flate2::FlushDecompress::Finish)
        .map_err(|e| e.to_string())?;
    if status != flate2::Status::StreamEnd || out.len() != expected {
        let state = if status == flate2::Status::StreamEnd {
            ""
        } else {
            " and no end"
        };
        return Err(format!(
            "{} bytes{state} found, {expected} expected",
            out.len()
        ));
    }
    Ok(())
}

/// Spreads the stored active values over a node and fills in the inactive ones.
fn expand<const W: usize>(
    packed: &[u8],
    active: &[u64],
    selection: &[u64],
    inactive: [Value; 2],
    out: &mut [u8],
) {
    let inactive = inactive.map(|value| {
        let mut short = [0; W];
        short.copy_from_slice(&value[..W]);
        short
    });
    let mut packed = packed.as_chunks::<W>().0.iter();
    let nodes = out.as_chunks_mut::<W>().0.chunks_exact_mut(64);
    for ((out, &active), &selection) in nodes.zip(active).zip(selection) {
        for (bit, out) in out.iter_mut().enumerate() {
            *out = if active >> bit & 1 != 0 {
                packed.next().copied().unwrap_or([0; W])
            } else {
                inactive[(selection >> bit & 1) as usize]
            };
        }
    }
}
