//! What the bytes of volume files mean: headers, voxels, maps and pipes.
//!
//! In: a path or a stream. Out: a [`Volume`], which is a [`Header`] and its voxels, by planes in
//! order or by boxes. Nothing is decoded early: voxels stay bytes in the type and byte order of
//! the file.
//!
//! ```no_run
//! use std::path::Path;
//! use curvox_formats::{OpenOptions, Voxels, open};
//!
//! let volume = open(Path::new("scan.nii.gz"), &OpenOptions::default())?;
//! println!("{:?} voxels of {}", volume.header.dims, volume.header.voxel);
//! let mut planes = volume.into_forward();
//! let mut bytes = Vec::new();
//! while planes.read_planes(16, &mut bytes)? > 0 { /* x fastest */ }
//! for warning in planes.finish()? {
//!     eprintln!("{warning}");
//! }
//! # Ok::<(), curvox_formats::Error>(())
//! ```
//!
//! The rooms, in the order of the data: `input` (bytes forward, decompressed), `map` and `bytes`
//! (bytes anywhere), one file or folder a format, `registry` and `detect` (which of them), `open`
//! (who gets what), `parsed` (what a header says), `lines`, `placement` and `beside` (text headers, places in the
//! world, files that a header names), `text` and `shares` (voxels as text, in several files), `forward`, `stream`, `stored` and `chunked`
//! (planes and boxes), `crop` (a part of them), [`mesh`] (polygons), [`mod@write`] (small
//! outputs), [`conformance`] (what every reader must do).
//!
//! Guaranteed: the format is recognised by content, never by name; sizes from a file are checked
//! before use; a damaged file is an error that names the place, not a panic or a huge
//! allocation. Not guaranteed: that voxel values make sense (NaN, bytes other than 0 and 1 in a
//! `bool`), which is for whoever interprets them.

// Without the SIGBUS guard some helpers of the map have no use.
#![cfg_attr(not(unix), allow(dead_code))]

mod codec;

pub mod conformance;

mod analyze;

mod beside;

mod bytes;

mod chunked;

mod crop;

mod detect;

mod dicom;

mod error;

mod forward;

#[cfg(feature = "hdf5")]
mod hdf5;

mod header;

mod input;

mod jpeg;
mod lines;

mod map;

pub mod mesh;

mod metaimage;

mod mgh;

mod mrc;

mod nifti;

mod npy;

mod npz;

mod nrrd;

mod open;

mod options;

mod order;

mod parsed;

mod placement;

mod raw;

mod record;

mod registry;

mod shares;
mod slices;
mod store;

mod stored;

mod stream;

mod text;
mod tiff;
mod vdb;

mod vol;

mod volume;

mod vtk;

pub mod write;

mod zarr;
mod zip;

pub use error::{Error, ErrorKind};
pub use header::{
    ByteOrder, Content, DType, Format, Header, ParseError, Region, Scaling, Unit, VoxelType,
};
pub use open::{open, open_stream};
pub use options::{IoMode, OpenOptions, RawLayout};
pub use registry::{Choices, FormatInfo, formats};
pub use store::open_url;
pub use volume::{ForwardVoxels, RandomVoxels, SourceInfo, Volume, Voxels};
