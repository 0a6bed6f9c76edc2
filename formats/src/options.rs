//! How a volume is to be opened: what the caller says beyond the path.

use std::ops::Range;
use std::path::PathBuf;

use crate::header::{DType, Format, Unit};

/// How the bytes of an uncompressed file are reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum IoMode {
    /// Mapped on local file systems, read on network file systems.
    #[default]
    Auto,
    /// Mapped.
    Map,
    /// Read at offsets. Slower, but a failing network is an error instead of a stall.
    Read,
}

/// The layout of a file without a header. Voxels are stored x fastest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawLayout {
    /// Voxels along x, y, z.
    pub dims: [u64; 3],
    /// Their type and byte order.
    pub dtype: DType,
    /// Edge lengths of a voxel in `unit`, if known.
    pub spacing: Option<[f64; 3]>,
    /// Unit of `spacing`.
    pub unit: Unit,
    /// Bytes before the first voxel.
    pub skip: u64,
}

/// How to open a volume.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// The format; `None` to recognise it.
    pub format: Option<Format>,
    /// The layout of a file without a header. When given, the file is taken as such.
    pub raw: Option<RawLayout>,
    /// How uncompressed files are read.
    pub io: IoMode,
    /// Which volume of a file with several (points in time, mostly), from 0.
    pub frame: Option<u64>,
    /// Which channel of a file with several, from 0.
    pub channel: Option<u64>,
    /// Which array, grid, series or member of a file with several: its name or path.
    pub dataset: Option<String>,
    /// Which level of a pyramid, from 0, the finest. 0 when not given.
    pub level: Option<u32>,
    /// Only this box of voxels, in the file's own indices along x, y, z.
    pub region: Option<[Range<i64>; 3]>,
    /// Whether a header may name files outside its own folder.
    pub outside: bool,
    /// Where inputs that cannot be read forward are copied to, if memory does not hold them.
    pub spill: Option<PathBuf>,
    /// The most bytes held in memory for inputs that cannot run forward, for instance an array
    /// in Fortran order from a pipe.
    pub spool_limit_bytes: u64,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            format: None,
            raw: None,
            io: IoMode::Auto,
            frame: None,
            channel: None,
            dataset: None,
            level: None,
            region: None,
            outside: false,
            spill: None,
            spool_limit_bytes: 256 << 20,
        }
    }
}
