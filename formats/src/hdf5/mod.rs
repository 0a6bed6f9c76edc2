//! HDF5: the volume of a file, found by name or by the conventions of those who wrote it.
//!
//! In: the bytes of a file. Out: a [`Volume`]. Read: superblocks 0 to 3, behind a user block or
//! not (MATLAB 7.3); groups of both kinds, in headers and in heaps, and soft links; datasets of
//! integers, IEEE numbers (also half precision) and h5py's `bool` in either byte order, compact,
//! contiguous or in chunks by any of the six indexes; the filters of [`filter`]; fill values;
//! attributes. The conventions of Imaris, BigDataViewer, MINC 2 (scaled, plane by plane if the file
//! says so), Data Exchange and NeXus, and sizes of voxels as Fiji and ilastik write them.
//!
//! Guaranteed: what has a checksum is verified; sizes and places are checked against the file
//! before use; structures that refer to each other in circles are an error; memory is a chunk and
//! its compressed bytes, however many chunks there are; threads share nothing that waits. Refused
//! by name: external and virtual datasets, links to other files, other filters (szip, n-bit,
//! scale-offset, Blosc 2, zfp), values that are not numbers. Not read: messages shared through a heap of the file, compressed heaps, attributes above
//! 64 KiB.
//!
//! The reader is our own. Crates were measured on 95 files of h5py and on copies with a few wrong
//! bytes: `hdf5-reader` 0.12 read all 74 with filters it knows, without a panic in 190 000
//! damaged copies, but takes 190 ms for each small box out of a version 1 B-tree of 1.5 million
//! chunks, or 157 bytes of memory for each chunk, lists no dataset of a group in which one is
//! virtual, names no place in its errors, and brings `ndarray` and a dozen more crates;
//! `rust-hdf5` 0.7 and `hdf5-pure` 0.47 allocate tens of GiB for damaged copies. libhdf5 itself
//! is C that reads hostile bytes, behind one lock for all threads. This reader gave the voxels of
//! h5py for 640 files of random shapes, chunks, filters and versions, and went through 139 500
//! damaged copies, 96 000 of them with checksums ignored, without a panic, 2 seconds or 64 MiB
//! beyond the file.

mod attribute;

mod btree2;

mod choose;

mod convention;

mod dataset;

mod file;

mod filter;

mod group;

mod heap;

mod index;

mod message;

mod object;

mod scaled;

mod world;

use std::sync::Arc;

use crate::bytes::FileBytes;
use crate::chunked::ChunkedVoxels;
use crate::error::Error;
use crate::header::DType;
use crate::parsed::Context;
use crate::volume::{Volume, Voxels};

use choose::{Choice, select};
use file::File;
use scaled::ScaledPlanes;

/// Opens the volume of a file.
pub(crate) fn read(bytes: FileBytes, context: &Context<'_>) -> Result<Volume, Error> {
    let (file, root) = File::open(bytes)?;
    let file = Arc::new(file);
    let choice = Choice {
        file: &file,
        root,
        options: context.options,
    };
    let chosen = choice.choose()?;
    let dataset = &chosen.dataset;
    let own = dataset.attributes(&file)?;
    let letters = own.text("axistags").map(|tags| axis_letters(&tags));
    let selection = select(&choice, &chosen, letters.as_deref())?;
    let mut header = dataset.header(&file, &selection)?;
    let scales = world::describe(&choice, dataset, &own, &selection, &mut header)?;
    let mut voxels = dataset.voxels(&file, &selection, &mut header)?;
    if let Some(scales) = scales {
        let scaled = ScaledPlanes::new(voxels, header.dtype(), header.dims, scales);
        let dtype = DType::little(scaled.voxel());
        header.details.push((
            "values",
            format!("{}, each plane with its scale", header.dtype()),
        ));
        (header.voxel, header.byte_order) = (dtype.voxel, dtype.byte_order);
        let chunk = scaled.chunk();
        voxels = Box::new(ChunkedVoxels::new(
            context.name,
            &header,
            chunk,
            Box::new(scaled),
        ));
    }
    file.bytes().check()?;
    Ok(Volume {
        header,
        voxels: Voxels::Random(voxels),
        source: file.bytes().source(),
    })
}

/// The letters of axes in the text that vigra and ilastik describe them with.
fn axis_letters(tags: &str) -> String {
    tags.split("\"key\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').nth(1)?.chars().next())
        .collect()
}
