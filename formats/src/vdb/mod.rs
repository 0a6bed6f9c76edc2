//! OpenVDB files, by a reader of our own.
//!
//! In: the bytes of a file. Out: one grid of it as a volume. The rooms: `archive` (the file and
//! its list of grids), `transform` (from indices to the world), `tree` (nodes), `values` (how
//! nodes store them), `voxels` (boxes).
//!
//! **Which box.** A grid has no extents. The volume is the box around its active voxels and
//! tiles, one voxel wider on each side, so that what surrounds them is seen; or the region asked
//! for, in the grid's own indices, which may lie anywhere. `first_index` says where it begins.
//! A voxel has the value that OpenVDB gives for its index: inactive voxels and tiles keep theirs,
//! and outside all nodes there is the background. In a mask grid what is active is 1.
//!
//! **What it means.** Grids of class "level set" are distances, negative inside; those of class
//! "fog volume" are densities; bool and mask grids are masks. OpenVDB has no unit of length.
//!
//! **What is read.** File versions 213 to 225; grids of float, double, half, the integers, bool
//! and mask, floats also where saved as halves; trees of the usual shape 5_4_3; values stored
//! plain, with zip or Blosc, without inactive values or with them; grids that share a tree; files
//! written as streams, whose grids have no index and are walked over. Affine transforms of every
//! type, turned and mirrored ones too; a sheared one is warned about.
//!
//! **What is refused, by name.** Vectors, strings, points; other trees; frustum transforms; other
//! versions. Several grids of numbers without a choice.
//!
//! **Memory.** Masks and tile values of internal nodes, and four bytes a leaf, never more than
//! the bytes of the file and 32 MiB. Opening a grid walks over its leaves once, reading their
//! sizes; their values are decoded when a box needs them. Work follows the nodes there are, not
//! the box around them.
//!
//! The crate `vdb-rs` does less than this and does some of it wrong (its page here, behind the
//! feature of that name, says what), and OpenVDB itself is a C++ library, so the reader is our own.

mod archive;

mod cursor;

mod grids;

mod transform;

mod tree;

mod values;

#[cfg(feature = "vdb-rs")]
pub(crate) mod vdb_rs;

mod voxels;

use std::ops::Range;

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::{Content, DType, Format, Header, VoxelType};
use crate::parsed::Context;
use crate::volume::{Volume, Voxels};
use archive::Codec;
use grids::{Grid, Grids};
use tree::Tree;
use voxels::VdbVoxels;

/// Whether content begins like a file of this format. The zeros behind the letters are left to
/// the reader, which can say what is wrong with them.
pub(crate) fn detect(head: &[u8]) -> bool {
    head.starts_with(b" BDV")
}

/// Opens a grid of the file.
pub(crate) fn open(file: FileBytes, context: &Context<'_>) -> Result<Volume, Error> {
    let (header, voxels) = read(&file, context)?;
    let mut source = file.source();
    source.held_bytes += voxels.tree.held_bytes;
    source.compressed = voxels.layout.compression.codec != Codec::None;
    Ok(Volume {
        header,
        voxels: Voxels::Random(Box::new(voxels)),
        source,
    })
}

/// Reads a grid, all but the values of its leaves.
fn read(file: &FileBytes, context: &Context<'_>) -> Result<(Header, VdbVoxels), Error> {
    let name = context.name;
    let grids = Grids::read(file)?;
    let chosen = grids.choose(context.options.dataset.as_deref())?;
    let Grid {
        metadata,
        transform,
        layout,
        tree,
    } = grids.load(chosen)?;
    // Grids without a type of voxels are not chosen.
    let voxel = layout.voxel.unwrap_or(VoxelType::U8);
    let (first, dims) = match &context.options.region {
        Some(region) => asked(region, name)?,
        None => around(&tree),
    };
    let mut header = Header::new(Format::Vdb, dims, DType::little(voxel));
    header.first_index = first;
    header.content = content(&metadata.class, voxel);
    transform.place(&mut header, name)?;
    let [major, minor] = grids.header.library;
    header.details = vec![
        ("grid", chosen.unique_name()),
        ("grids", grids.list()),
        ("class", metadata.class),
        ("creator", metadata.creator),
        ("compression", layout.compression.to_string()),
        ("active voxels", tree.active.voxels.to_string()),
        ("leaves", tree.leaves.to_string()),
        ("file version", grids.header.version.to_string()),
        ("written by", format!("OpenVDB {major}.{minor}")),
    ];
    header.details.retain(|(_, value)| !value.is_empty());
    let unlisted = grids.unlisted();
    header
        .warnings
        .extend(unlisted.map(|reason| format!("{name}: {reason}")));
    file.check()?;
    // To walk over the leaves was to touch all of the file.
    voxels::release(file);
    let voxels = VdbVoxels {
        file: file.clone(),
        tree,
        layout,
        first,
        dims,
    };
    Ok((header, voxels))
}

/// First index and extents of the box around what is active, one voxel wider on each side. An
/// empty grid is one voxel.
fn around(tree: &Tree) -> ([i64; 3], [u64; 3]) {
    match tree.active.bounds {
        None => ([0; 3], [1; 3]),
        Some([low, high]) => (
            low.map(|i| i - 1),
            // Indices have 32 bits, so extents fit.
            [0, 1, 2].map(|a| (high[a] - low[a] + 3) as u64),
        ),
    }
}

/// First index and extents of the region asked for.
fn asked(region: &[Range<i64>; 3], name: &str) -> Result<([i64; 3], [u64; 3]), Error> {
    /// Far beyond all indices of grids, and far from overflow.
    const MOST: i64 = 1 << 40;
    let mut dims = [0; 3];
    for (a, range) in region.iter().enumerate() {
        if range.is_empty() || range.start < -MOST || range.end > MOST {
            return Err(Error::unsupported(
                name,
                format!(
                    "the region {}:{} along {} was asked for; a range within {}:{MOST} expected",
                    range.start,
                    range.end,
                    ["x", "y", "z"][a],
                    -MOST
                ),
            ));
        }
        dims[a] = range.end.abs_diff(range.start);
    }
    Ok(([0, 1, 2].map(|a| region[a].start), dims))
}

/// What values of a class are.
fn content(class: &str, voxel: VoxelType) -> Content {
    match class.trim().to_ascii_lowercase().as_str() {
        _ if voxel == VoxelType::Bool => Content::Mask,
        "level set" if voxel.is_float() => Content::LevelSet,
        "fog volume" => Content::Fog,
        _ => Content::Image,
    }
}
