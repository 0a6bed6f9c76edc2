//! Zarr 2 and 3, OME-Zarr and N5: arrays in chunks, each an object of a store.
//!
//! In: a store (a folder, a web server, a bucket). Out: a [`Volume`] whose voxels are read chunk by
//! chunk, in any order and from any thread. Metadata is read once, when the container is opened;
//! a chunk when it is needed, and the chunks of a shard alone. Voxels stay in the type and byte
//! order of the array.
//!
//! The rooms: `json` (metadata), `v2`, `v3`, `n5` (what it says), `array` (in one form), `fill`,
//! `chain` (codecs), `tree` and `ome` (which array is meant), `view` (which of its axes), `space`
//! (where it lies), `chunks` (its voxels).
//!
//! Guaranteed: sizes are checked before use; a chunk decodes to the bytes of its shape or is an
//! error; a path in the metadata that leaves the container is refused unless allowed. Refused by
//! name: codecs, types and extensions that are not read, plates, axes that are none of x, y, z, t
//! and c. The crate `zarrs` is not taken, see [`chain`].

mod array;

mod chain;

mod chunks;

mod fill;

mod json;

mod n5;

mod ome;

mod space;

mod tree;

mod v2;

mod v3;

mod view;

use std::path::Path;
use std::sync::Arc;

use crate::chunked::ChunkedVoxels;
use crate::error::Error;
use crate::header::{Format, Header};
use crate::options::OpenOptions;
use crate::store::{Folder, Store};
use crate::volume::{SourceInfo, Volume, Voxels};
use array::shape_text;
use chunks::{ArrayChunks, KEPT_INDEX_BYTES};
use tree::Tree;
use view::View;

/// Whether a folder looks like a Zarr array or group.
pub(crate) fn detect(path: &Path) -> bool {
    ["zarr.json", ".zarray", ".zgroup", ".zattrs"]
        .iter()
        .any(|file| path.join(file).exists())
}

/// Whether a folder looks like an N5 container or dataset.
pub(crate) fn detect_n5(path: &Path) -> bool {
    path.join("attributes.json").exists()
        || path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("n5"))
}

/// Opens the Zarr array or group in a folder.
pub(crate) fn open_folder(path: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    open_folder_as(Format::Zarr, path, options)
}

/// Opens the N5 container or dataset in a folder.
pub(crate) fn open_n5_folder(path: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    open_folder_as(Format::N5, path, options)
}

fn open_folder_as(format: Format, path: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    let store = Arc::new(Folder::new(path));
    let volume = open(store, format, options)?;
    let mut volume = volume.ok_or_else(|| {
        Error::unsupported(
            path.display().to_string(),
            match format {
                Format::N5 => "no N5 metadata found (attributes.json)",
                _ => "no Zarr metadata found (zarr.json, .zarray or .zgroup)",
            },
        )
    })?;
    volume.source.path = Some(path.to_path_buf());
    Ok(volume)
}

/// Opens what is meant in a store; `None` where it holds no container of the format.
pub(crate) fn open(
    store: Arc<dyn Store>,
    format: Format,
    options: &OpenOptions,
) -> Result<Option<Volume>, Error> {
    let Some(found) = Tree::new(Arc::clone(&store), format, options).find()? else {
        return Ok(None);
    };
    let array = found.array;
    let name = store.name(&array.key);
    let axes = found.space.axes.as_deref().or(array.axes.as_deref());
    let view = View::new(&name, &array, axes, options)?;
    let dims = view.pick(&array.shape);
    let mut header = Header::new(array.format, dims, array.dtype);
    found.space.describe(&view, &mut header, &name);
    header.details.extend(found.details);
    if array.shape.len() != 3 || view.axes != [2, 1, 0] {
        let letters: Vec<_> = match axes {
            Some(axes) => axes.to_vec(),
            None => (0..array.shape.len())
                .map(|axis| axis.to_string())
                .collect(),
        };
        header.details.push((
            "axes",
            format!("{} ({})", letters.join(" "), shape_text(&array.shape)),
        ));
    }
    let [x, y, z] = view.pick(array.chunk());
    header.details.push(("chunks", format!("{x} x {y} x {z}")));
    let mut held_bytes = 0;
    if let Some(shard) = &array.shard {
        let [x, y, z] = view.pick(&array.grid);
        header.details.push(("shards", format!("{x} x {y} x {z}")));
        let shards = array.shape.iter().zip(&array.grid);
        let shards = shards.fold(1_u64, |n, (s, g)| n.saturating_mul(s.div_ceil(*g)));
        let bytes = shard.index_bytes().unwrap_or(u64::MAX);
        held_bytes = shards
            .saturating_mul(bytes)
            .min(KEPT_INDEX_BYTES.max(bytes));
    }
    header.details.push(("compression", array.chain.describe()));
    let source = SourceInfo {
        compressed: array.chain.compresses(),
        re_readable: true,
        held_bytes,
        ..SourceInfo::stream(&store.name(""))
    };
    let chunks = ArrayChunks::new(store, array, view);
    let piece = chunks.piece();
    let voxels = ChunkedVoxels::new(&name, &header, piece, Box::new(chunks));
    Ok(Some(Volume {
        header,
        voxels: Voxels::Random(Box::new(voxels)),
        source,
    }))
}
