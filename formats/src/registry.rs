//! The table of formats: their names, how they are recognised, and who reads them.
//!
//! One entry a format, in two tables: [`formats`], which says to a user what there is, and
//! [`READERS`], which says to this crate how each is read. A format is recognised by its content.
//! To add one: a variant of [`Format`], an entry in each table, a module.

use std::path::Path;

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::header::Format;
use crate::input::Input;
use crate::options::OpenOptions;
use crate::parsed::{Context, Parsed};
use crate::volume::Volume;
use crate::{
    dicom, metaimage, mgh, mrc, nifti, npy, npz, nrrd, raw, slices, tiff, vdb, vol, vtk, zarr,
};

/// What there is to know about a format before a file is opened.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct FormatInfo {
    /// The format.
    pub format: Format,
    /// Names as typed on a command line, the usual one first.
    pub names: &'static [&'static str],
    /// Its name in print.
    pub title: &'static str,
    /// Extensions its files usually have. Only for print: the content decides.
    pub extensions: &'static str,
    /// What of it is read.
    pub variants: &'static str,
    /// Whether it can be read from a pipe without being copied first.
    pub forward: bool,
    /// Choices it may ask for.
    pub choices: Choices,
    /// The cargo feature that this build was made without, if it is needed to read the format.
    pub missing_feature: Option<&'static str>,
}

/// Which choices a file of a format may offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Choices {
    /// Of a volume in time.
    pub frame: bool,
    /// Of a channel.
    pub channel: bool,
    /// Of an array, grid, series or member.
    pub dataset: bool,
    /// Of a level of a pyramid.
    pub level: bool,
}

const NONE: Choices = Choices {
    frame: false,
    channel: false,
    dataset: false,
    level: false,
};

const FRAME: Choices = Choices {
    frame: true,
    ..NONE
};

const DATASET: Choices = Choices {
    dataset: true,
    ..NONE
};

const ALL: Choices = Choices {
    frame: true,
    channel: true,
    dataset: true,
    level: true,
};

/// All formats, in the order of the table that is printed.
pub fn formats() -> &'static [FormatInfo] {
    FORMATS
}

/// The entry of a format. Every format has one.
pub(crate) fn info(format: Format) -> &'static FormatInfo {
    // Raw stands first, and a test says that all are there.
    FORMATS
        .iter()
        .find(|info| info.format == format)
        .unwrap_or(&FORMATS[0])
}

static FORMATS: &[FormatInfo] = &[
    FormatInfo {
        format: Format::Raw,
        names: &["raw"],
        title: "raw voxels",
        extensions: "any",
        variants: "any type, either byte order, x fastest; the caller gives the layout",
        forward: true,
        choices: NONE,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Nifti1,
        names: &["nifti1", "nifti", "nii"],
        title: "NIfTI-1",
        extensions: ".nii .nii.gz .hdr/.img",
        variants: "single file and pair, either byte order",
        forward: true,
        choices: FRAME,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Nifti2,
        names: &["nifti2"],
        title: "NIfTI-2",
        extensions: ".nii .nii.gz .hdr/.img",
        variants: "single file and pair, either byte order",
        forward: true,
        choices: FRAME,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Analyze,
        names: &["analyze"],
        title: "Analyze 7.5",
        extensions: ".hdr/.img",
        variants: "pair, either byte order; SPM's factor and types",
        forward: true,
        choices: FRAME,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Nrrd,
        names: &["nrrd", "nhdr"],
        title: "NRRD",
        extensions: ".nrrd .nhdr",
        variants: "attached, detached, lists and patterns of files; raw, text, hex, gzip, bzip2, zstd",
        forward: true,
        choices: FRAME,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::MetaImage,
        names: &["metaimage", "mha", "mhd"],
        title: "MetaImage",
        extensions: ".mha .mhd",
        variants: "attached, detached, lists and patterns of files; binary, text, zlib",
        forward: true,
        choices: FRAME,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Mgh,
        names: &["mgh", "mgz"],
        title: "FreeSurfer MGH",
        extensions: ".mgh .mgz",
        variants: "version 1; u8, i16, u16, i32, f32; frames",
        forward: true,
        choices: FRAME,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Mrc,
        names: &["mrc", "ccp4", "map"],
        title: "MRC/CCP4",
        extensions: ".mrc .map .ccp4 .rec .st",
        variants: "modes 0, 1, 2, 6, 12, either byte order, any order of axes; volume stacks",
        forward: true,
        choices: FRAME,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Vtk,
        names: &["vtk"],
        title: "VTK legacy",
        extensions: ".vtk",
        variants: "structured points, binary and ASCII, point and cell data, scalars and fields",
        forward: true,
        choices: DATASET,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Tiff,
        names: &["tiff", "tif"],
        title: "TIFF",
        extensions: ".tif .tiff .ome.tif .btf .lsm",
        variants: "BigTIFF, ImageJ, OME; strips and tiles; LZW, deflate, zstd, PackBits, CCITT, grey JPEG; 1 to 64 bits",
        forward: false,
        choices: Choices {
            frame: true,
            channel: true,
            dataset: true,
            level: true,
        },
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Slices,
        names: &["slices"],
        title: "slices",
        extensions: "a folder or 'pattern*' of .tif .png .jpg .pgm",
        variants: "one grey image a plane, in natural order",
        forward: false,
        choices: Choices {
            frame: true,
            channel: true,
            dataset: true,
            level: true,
        },
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Dicom,
        names: &["dicom", "dcm"],
        title: "DICOM",
        extensions: "folder, .dcm",
        variants: "series in a folder, multi-frame file; plain, deflate, RLE, JPEG, JPEG-LS, JPEG 2000",
        forward: false,
        choices: Choices {
            frame: true,
            dataset: true,
            ..NONE
        },
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Zarr,
        names: &["zarr", "ome-zarr"],
        title: "Zarr, OME-Zarr",
        extensions: ".zarr .ome.zarr",
        variants: "version 2 and 3, shards, OME-Zarr 0.1 to 0.5; blosc, zstd, lz4, gzip, zlib, bz2",
        forward: false,
        choices: ALL,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::N5,
        names: &["n5"],
        title: "N5",
        extensions: ".n5",
        variants: "raw, gzip, bzip2, lz4, blosc, zstd; pyramids s0, s1",
        forward: false,
        choices: ALL,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Hdf5,
        names: &["hdf5", "h5"],
        title: "HDF5",
        extensions: ".h5 .hdf5 .nxs .ims .mnc .mat",
        variants: "contiguous, compact and chunked datasets; deflate, shuffle, fletcher32, lzf, \
                   blosc, bitshuffle, lz4, zstd, bzip2; Imaris, BigDataViewer, MINC 2, Data \
                   Exchange, NeXus, MATLAB 7.3",
        forward: false,
        choices: ALL,
        missing_feature: if cfg!(feature = "hdf5") {
            None
        } else {
            Some("hdf5")
        },
    },
    FormatInfo {
        format: Format::Vdb,
        names: &["vdb", "openvdb"],
        title: "OpenVDB",
        extensions: ".vdb",
        variants: "versions 213 to 225; grids of numbers, bool and mask; none, zip, Blosc, active \
                   mask, half; affine transforms; streams",
        forward: false,
        choices: DATASET,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::VdbRs,
        names: &["vdb-rs"],
        title: "OpenVDB by vdb-rs",
        extensions: ".vdb",
        variants: "a second reader, only when asked for: float and int32, background 0, no stream, \
                   scale and translation; the rest is refused",
        forward: false,
        choices: DATASET,
        #[cfg(feature = "vdb-rs")]
        missing_feature: None,
        #[cfg(not(feature = "vdb-rs"))]
        missing_feature: Some("vdb-rs"),
    },
    FormatInfo {
        format: Format::Npy,
        names: &["npy"],
        title: "NumPy array",
        extensions: ".npy",
        variants: "format 1 to 3, C and Fortran order, either byte order",
        forward: true,
        choices: NONE,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Npz,
        names: &["npz"],
        title: "NumPy archive",
        extensions: ".npz",
        variants: "stored and deflated members",
        forward: false,
        choices: DATASET,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Vol,
        names: &["vol"],
        title: "DGtal vol",
        extensions: ".vol",
        variants: "version 1 to 3, plain and zlib",
        forward: true,
        choices: NONE,
        missing_feature: None,
    },
    FormatInfo {
        format: Format::Longvol,
        names: &["longvol"],
        title: "DGtal longvol",
        extensions: ".longvol",
        variants: "4 and 8 bytes a voxel, plain and zlib",
        forward: true,
        choices: NONE,
        missing_feature: None,
    },
];

const HDF5_MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";

/// How the voxels of a file are found.
#[derive(Clone, Copy)]
pub(crate) enum Reader {
    /// The header first, the voxels after it (or in other files), one behind the other.
    Header(fn(&mut Input, &Context<'_>) -> Result<Parsed, Error>),
    /// The bytes are needed in an order of the reader's own.
    Bytes(fn(FileBytes, &Context<'_>) -> Result<Volume, Error>),
    /// Nothing in this build: see [`FormatInfo::missing_feature`].
    #[cfg(not(feature = "hdf5"))]
    Missing,
}

/// A format and who reads it.
pub(crate) struct Entry {
    pub(crate) format: Format,
    /// Whether content that begins with these bytes (1024, or all there are) is of this format.
    pub(crate) detect: fn(&[u8]) -> bool,
    pub(crate) reader: Reader,
}

/// Readers of files. The first that recognises the content is taken.
pub(crate) static READERS: &[Entry] = &[
    // Before others: a DICOM file may begin with the header of another format, TIFF mostly.
    Entry {
        format: Format::Dicom,
        detect: dicom::detect,
        reader: Reader::Bytes(dicom::open_file),
    },
    Entry {
        format: Format::Npy,
        detect: |head| head.starts_with(npy::MAGIC),
        reader: Reader::Header(npy::parse),
    },
    Entry {
        format: Format::Npz,
        detect: npz::detect,
        reader: Reader::Bytes(npz::open),
    },
    Entry {
        format: Format::Analyze,
        detect: |head| nifti::detect(head) == Some(Format::Analyze),
        reader: Reader::Header(nifti::parse),
    },
    Entry {
        format: Format::Nifti1,
        detect: |head| nifti::detect(head) == Some(Format::Nifti1),
        reader: Reader::Header(nifti::parse),
    },
    Entry {
        format: Format::Nifti2,
        detect: |head| nifti::detect(head) == Some(Format::Nifti2),
        reader: Reader::Header(nifti::parse),
    },
    Entry {
        format: Format::Nrrd,
        detect: |head| head.starts_with(nrrd::MAGIC),
        reader: Reader::Header(nrrd::parse),
    },
    Entry {
        format: Format::MetaImage,
        detect: metaimage::detect,
        reader: Reader::Header(metaimage::parse),
    },
    Entry {
        format: Format::Vol,
        detect: |head| vol::detect(head) == Some(Format::Vol),
        reader: Reader::Header(vol::parse),
    },
    Entry {
        format: Format::Longvol,
        detect: |head| vol::detect(head) == Some(Format::Longvol),
        reader: Reader::Header(vol::parse),
    },
    Entry {
        format: Format::Vtk,
        detect: vtk::detect,
        reader: Reader::Header(vtk::parse),
    },
    Entry {
        format: Format::Tiff,
        detect: tiff::detect,
        reader: Reader::Bytes(tiff::open),
    },
    Entry {
        format: Format::Hdf5,
        // MATLAB writes behind 512 bytes of its own.
        detect: |head| {
            [0, 512]
                .iter()
                .any(|at| head.get(*at..).is_some_and(|h| h.starts_with(HDF5_MAGIC)))
        },
        #[cfg(feature = "hdf5")]
        reader: Reader::Bytes(crate::hdf5::read),
        #[cfg(not(feature = "hdf5"))]
        reader: Reader::Missing,
    },
    Entry {
        format: Format::Vdb,
        detect: vdb::detect,
        reader: Reader::Bytes(vdb::open),
    },
    #[cfg(feature = "vdb-rs")]
    Entry {
        format: Format::VdbRs,
        detect: |_| false,
        reader: Reader::Bytes(vdb::vdb_rs::open),
    },
    Entry {
        format: Format::Slices,
        detect: slices::is_image,
        reader: Reader::Bytes(slices::refuse_one),
    },
    Entry {
        format: Format::Mrc,
        detect: mrc::detect,
        reader: Reader::Header(mrc::parse),
    },
    Entry {
        format: Format::Mgh,
        detect: mgh::detect,
        reader: Reader::Header(mgh::parse),
    },
    Entry {
        format: Format::Raw,
        detect: |_| false,
        reader: Reader::Header(raw::parse),
    },
];

/// Whether a format is recognised by plausible numbers rather than by a mark of its own, so that
/// a layout given by the caller counts more.
pub(crate) fn is_weakly_marked(format: Format) -> bool {
    matches!(format, Format::Analyze | Format::Mgh | Format::Mrc)
}

/// A format whose volumes are folders.
pub(crate) struct Folder {
    pub(crate) format: Format,
    /// Whether the folder looks like one.
    pub(crate) detect: fn(&Path) -> bool,
    pub(crate) open: fn(&Path, &OpenOptions) -> Result<Volume, Error>,
}

/// Readers of folders. The first that recognises the folder is taken.
pub(crate) static FOLDERS: &[Folder] = &[
    Folder {
        format: Format::Zarr,
        detect: zarr::detect,
        open: zarr::open_folder,
    },
    Folder {
        format: Format::N5,
        detect: zarr::detect_n5,
        open: zarr::open_n5_folder,
    },
    Folder {
        format: Format::Dicom,
        detect: dicom::detect_folder,
        open: dicom::open_folder,
    },
    Folder {
        format: Format::Slices,
        detect: slices::detect,
        open: slices::open_folder,
    },
];

/// Refuses choices that the format does not offer.
pub(crate) fn check_choices(
    format: Format,
    name: &str,
    options: &OpenOptions,
) -> Result<(), Error> {
    let info = info(format);
    let asked = [
        (
            options.frame.is_some_and(|n| n > 0),
            info.choices.frame,
            "frame",
            "holds one volume",
        ),
        (
            options.channel.is_some_and(|n| n > 0),
            info.choices.channel,
            "channel",
            "has one channel",
        ),
        (
            options.dataset.is_some(),
            info.choices.dataset,
            "dataset",
            "has no named datasets",
        ),
        (
            options.level.is_some_and(|n| n > 0),
            info.choices.level,
            "level",
            "has one level",
        ),
    ];
    for (asked, offered, what, has) in asked {
        if asked && !offered {
            let which = match what {
                "frame" => options.frame.map(|n| n.to_string()),
                "channel" => options.channel.map(|n| n.to_string()),
                "level" => options.level.map(|n| n.to_string()),
                _ => options.dataset.clone(),
            };
            return Err(Error::unsupported(
                name,
                format!(
                    "{what} {} was asked for, but a {} file {has}",
                    which.unwrap_or_default(),
                    info.names[0]
                ),
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reader_has_an_entry_and_every_name_is_one_format() {
        for entry in READERS {
            assert_eq!(info(entry.format).format, entry.format);
        }
        for folder in FOLDERS {
            assert_eq!(info(folder.format).format, folder.format);
        }
        let mut names: Vec<_> = FORMATS.iter().flat_map(|f| f.names).collect();
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count);
        for info in FORMATS {
            assert_eq!(info.names[0].parse(), Ok(info.format));
        }
    }
}
