//! The tests of this crate, as one binary.
//!
//! Files are made by the tests themselves. Tests that read the shared folder of volumes find it
//! through `CURVOX_TEST_DATA` and say so when they are skipped.

#![allow(unreachable_pub)]

/// Files made in memory, temporary folders, and other tools of the tests.
mod support;

/// SHA-256, to compare volumes with the sums in the manifest.
mod sha256;

/// What is written is read back: every type, order, byte order, version and compression.
mod round_trip;

/// A pipe gives what the file gives.
mod streams;

/// Headers that say strange things.
mod headers;

/// Damage of any kind is an error, in bounded memory.
mod damaged;

/// The small files beside the tests: what each must give.
mod fixtures;

/// Damaged copies of them.
mod mutation;

/// Meshes: every form of OBJ, PLY and STL, and damage to them.
mod meshes;

/// DICOM series, slices with one thing changed at a time.
mod dicom;

/// MetaImage: headers, and the files of the shared folder.
mod metaimage;

/// NRRD: headers, and the files of the shared folder.
mod nrrd;
/// OpenVDB grids.
mod vdb;

/// Files that change while they are mapped.
mod guard;

/// The shared folder: same volumes in many formats, broken files, real files.
mod shared;

/// MRC and CCP4 maps, and axes in any order.
mod mrc;

/// FreeSurfer MGH.
mod mgh;

/// Analyze 7.5.
mod analyze;

/// Legacy VTK.
mod vtk;

/// NumPy archives.
mod npz;

/// Figures, not checks: run with `--release -- --ignored --nocapture speed`.
mod speed;
