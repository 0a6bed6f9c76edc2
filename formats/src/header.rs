//! What a file says about its volume, in one form for every format.
//!
//! In: nothing; the format modules fill these types. Out: [`Header`] and the small types it is
//! made of. Guaranteed of a header that a reader returns: each extent is at least 1, the number
//! of bytes of the volume fits `u64`, a spacing is finite and positive, and the columns of
//! `direction` have unit length. Not guaranteed: that the axes are orthogonal (a sheared file is
//! warned about) or that the voxels are there (a stream is only known by reading it).

use std::fmt;
use std::str::FromStr;

use crate::error::Error;

/// The file formats this crate tells apart. Their names and what is read of them are in
/// [`formats`](crate::formats).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Format {
    /// Voxels without a header; the caller knows the layout.
    Raw,
    /// NumPy `.npy`, format 1.0, 2.0 or 3.0.
    Npy,
    /// NumPy `.npz`: a zip archive of `.npy` members.
    Npz,
    /// DGtal `.vol`: one byte a voxel.
    Vol,
    /// DGtal `.longvol`: eight (or four) bytes a voxel.
    Longvol,
    /// NIfTI-1, single file or pair.
    Nifti1,
    /// NIfTI-2, single file or pair.
    Nifti2,
    /// Analyze 7.5, a pair.
    Analyze,
    /// NRRD, attached or detached.
    Nrrd,
    /// MetaImage, attached or detached.
    MetaImage,
    /// MRC2014, CCP4.
    Mrc,
    /// FreeSurfer MGH.
    Mgh,
    /// Legacy VTK, structured points.
    Vtk,
    /// TIFF, BigTIFF, ImageJ stack, OME-TIFF.
    Tiff,
    /// A folder or a set of slices, one image a plane.
    Slices,
    /// DICOM, a folder or a multi-frame file.
    Dicom,
    /// Zarr 2 and 3, OME-Zarr.
    Zarr,
    /// N5.
    N5,
    /// HDF5.
    Hdf5,
    /// OpenVDB.
    Vdb,
    /// OpenVDB, read by the crate `vdb-rs`.
    VdbRs,
}

impl Format {
    /// Short name, as typed on a command line.
    pub fn name(self) -> &'static str {
        crate::registry::info(self).names[0]
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A word that names no value of the wanted type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("'{found}' is not {expected}")]
pub struct ParseError {
    found: String,
    expected: &'static str,
}

impl ParseError {
    fn new(found: &str, expected: &'static str) -> Self {
        Self {
            found: found.into(),
            expected,
        }
    }
}

impl FromStr for Format {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, ParseError> {
        let wanted = s.to_ascii_lowercase();
        crate::registry::formats()
            .iter()
            .find(|info| info.names.contains(&wanted.as_str()))
            .map(|info| info.format)
            .ok_or_else(|| ParseError::new(s, "a format; `curvox formats` lists them"))
    }
}

/// The type of one stored voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VoxelType {
    /// One byte, 0 or 1.
    Bool,
    /// Unsigned, 8 bits.
    U8,
    /// Signed, 8 bits.
    I8,
    /// Unsigned, 16 bits.
    U16,
    /// Signed, 16 bits.
    I16,
    /// Unsigned, 32 bits.
    U32,
    /// Signed, 32 bits.
    I32,
    /// Unsigned, 64 bits.
    U64,
    /// Signed, 64 bits.
    I64,
    /// IEEE 754 half precision.
    F16,
    /// IEEE 754 single precision.
    F32,
    /// IEEE 754 double precision.
    F64,
}

impl VoxelType {
    /// All types, for tests and tables.
    pub const ALL: [Self; 12] = [
        Self::Bool,
        Self::U8,
        Self::I8,
        Self::U16,
        Self::I16,
        Self::U32,
        Self::I32,
        Self::U64,
        Self::I64,
        Self::F16,
        Self::F32,
        Self::F64,
    ];

    /// Bytes of one voxel.
    pub fn bytes(self) -> usize {
        match self {
            Self::Bool | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Short name: `u8`, `f32`, `bool`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F16 => "f16",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// Whether voxels of this type are IEEE 754 numbers.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F16 | Self::F32 | Self::F64)
    }
}

impl fmt::Display for VoxelType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

const VOXEL_TYPES: &str =
    "a voxel type: bool, u8, i8, u16, i16, u32, i32, u64, i64, f16, f32 or f64";

impl FromStr for VoxelType {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, ParseError> {
        let wanted = s.to_ascii_lowercase();
        Self::ALL
            .into_iter()
            .find(|t| t.name() == wanted)
            .ok_or_else(|| ParseError::new(s, VOXEL_TYPES))
    }
}

/// Order of the bytes of a voxel of several bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum ByteOrder {
    /// Least significant byte first.
    #[default]
    Little,
    /// Most significant byte first.
    Big,
}

/// A voxel type and its byte order, as in `u16`, `u16le` or `f32be`. Little when not said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DType {
    /// Type of the voxels.
    pub voxel: VoxelType,
    /// Order of their bytes.
    pub byte_order: ByteOrder,
}

impl DType {
    /// A little-endian type.
    pub fn little(voxel: VoxelType) -> Self {
        Self {
            voxel,
            byte_order: ByteOrder::Little,
        }
    }

    /// A big-endian type.
    pub fn big(voxel: VoxelType) -> Self {
        Self {
            voxel,
            byte_order: ByteOrder::Big,
        }
    }
}

impl fmt::Display for DType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let order = match (self.voxel.bytes(), self.byte_order) {
            (1, _) => "",
            (_, ByteOrder::Little) => "le",
            (_, ByteOrder::Big) => "be",
        };
        write!(f, "{}{order}", self.voxel)
    }
}

impl FromStr for DType {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, ParseError> {
        const EXPECTED: &str = "a voxel type such as u8, i16, u16le or f32be";
        let lower = s.to_ascii_lowercase();
        let (name, byte_order) = if let Some(name) = lower.strip_suffix("le") {
            (name, ByteOrder::Little)
        } else if let Some(name) = lower.strip_suffix("be") {
            (name, ByteOrder::Big)
        } else {
            (lower.as_str(), ByteOrder::Little)
        };
        let voxel = name.parse().map_err(|_| ParseError::new(s, EXPECTED))?;
        Ok(Self { voxel, byte_order })
    }
}

/// Unit of the spacing and origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Unit {
    /// The file does not say.
    #[default]
    Unknown,
    /// 1 m.
    Metre,
    /// 1e-2 m.
    Centimetre,
    /// 1e-3 m.
    Millimetre,
    /// 1e-6 m.
    Micrometre,
    /// 1e-9 m.
    Nanometre,
    /// 1e-10 m.
    Angstrom,
}

impl Unit {
    /// Symbol for print: `mm`, `um`; empty when unknown. ASCII, and read back by `FromStr`.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Unknown => "",
            Self::Metre => "m",
            Self::Centimetre => "cm",
            Self::Millimetre => "mm",
            Self::Micrometre => "um",
            Self::Nanometre => "nm",
            Self::Angstrom => "A",
        }
    }

    /// Length of the unit in metres; `None` when unknown.
    pub fn metres(self) -> Option<f64> {
        Some(match self {
            Self::Unknown => return None,
            Self::Metre => 1.0,
            Self::Centimetre => 1e-2,
            Self::Millimetre => 1e-3,
            Self::Micrometre => 1e-6,
            Self::Nanometre => 1e-9,
            Self::Angstrom => 1e-10,
        })
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if *self == Self::Unknown {
            "unknown"
        } else {
            self.symbol()
        })
    }
}

impl FromStr for Unit {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, ParseError> {
        Ok(match s {
            "" | "unknown" => Self::Unknown,
            "m" | "meter" | "metre" => Self::Metre,
            "cm" | "centimeter" | "centimetre" => Self::Centimetre,
            "mm" | "millimeter" | "millimetre" => Self::Millimetre,
            // U+00B5 (micro sign) and U+03BC (Greek mu) look the same and both occur.
            "um" | "\u{b5}m" | "\u{3bc}m" | "micron" | "micrometer" | "micrometre" => {
                Self::Micrometre
            }
            "nm" | "nanometer" | "nanometre" => Self::Nanometre,
            "A" | "\u{c5}" | "\u{212b}" | "angstrom" => Self::Angstrom,
            _ => return Err(ParseError::new(s, "a unit: m, cm, mm, um, nm or A")),
        })
    }
}

/// A box of voxels: `origin` is its first voxel, `size` its extents, in (x, y, z).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Region {
    /// First voxel.
    pub origin: [u64; 3],
    /// Number of voxels along each axis.
    pub size: [u64; 3],
}

impl Region {
    /// The whole of a volume of the given extents.
    pub fn whole(dims: [u64; 3]) -> Self {
        Self {
            origin: [0; 3],
            size: dims,
        }
    }

    /// An error unless the region is inside a volume of the given extents.
    pub(crate) fn check_inside(&self, dims: [u64; 3], name: &str) -> Result<(), Error> {
        if self.is_inside(dims) {
            return Ok(());
        }
        Err(Error::invalid(
            name,
            format!(
                "a box of {:?} voxels at {:?} was asked for, the volume has {dims:?}",
                self.size, self.origin
            ),
        ))
    }

    /// Gives `out` the size of the region's voxels, whatever its bytes are.
    pub(crate) fn make_room(
        &self,
        voxel_bytes: usize,
        out: &mut Vec<u8>,
        name: &str,
    ) -> Result<(), Error> {
        let too_large = || Error::unsupported(name, "the box does not fit memory");
        let bytes = self
            .voxels()
            .and_then(|n| n.checked_mul(voxel_bytes as u64))
            .and_then(|n| usize::try_from(n).ok())
            .ok_or_else(too_large)?;
        // Not cleared first: a buffer of the same size is then not written twice.
        out.truncate(bytes);
        out.try_reserve_exact(bytes - out.len())
            .map_err(|_| too_large())?;
        out.resize(bytes, 0);
        Ok(())
    }

    /// Number of voxels; `None` when it does not fit `u64`.
    pub fn voxels(&self) -> Option<u64> {
        voxel_count(self.size)
    }

    /// Whether every voxel of the region is one of a volume of the given extents. An empty
    /// region inside or on the border counts as inside.
    pub fn is_inside(&self, dims: [u64; 3]) -> bool {
        (0..3).all(|a| {
            self.origin[a]
                .checked_add(self.size[a])
                .is_some_and(|end| end <= dims[a])
        })
    }
}

/// How a stored value becomes the value meant: `value = slope * stored + intercept`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scaling {
    /// Factor; finite and not zero.
    pub slope: f64,
    /// Added after the factor; finite.
    pub intercept: f64,
}

/// What the values of a volume mean, where the file says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Content {
    /// Values of an image; what is inside is the caller's choice.
    #[default]
    Image,
    /// Distances to a surface, negative inside.
    LevelSet,
    /// Densities, higher inside.
    Fog,
    /// True or not zero inside.
    Mask,
}

impl Content {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::LevelSet => "level set",
            Self::Fog => "fog volume",
            Self::Mask => "mask",
        }
    }
}

/// What a file says about its volume.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Format the header was read from.
    pub format: Format,
    /// Voxels along x, y, z; each at least 1.
    pub dims: [u64; 3],
    /// Type of the stored voxels.
    pub voxel: VoxelType,
    /// Order of their bytes.
    pub byte_order: ByteOrder,
    /// Edge lengths of a voxel along x, y, z in `unit`; finite and positive. `None` when the
    /// file has none, and lengths are then in voxels.
    pub spacing: Option<[f64; 3]>,
    /// Unit of `spacing` and `origin`.
    pub unit: Unit,
    /// World position of the centre of voxel (0, 0, 0).
    pub origin: [f64; 3],
    /// World directions of the axes: `direction[row][column]`, column `a` is the unit vector of
    /// axis `a`, so world = origin + direction * (spacing * index).
    pub direction: [[f64; 3]; 3],
    /// How stored values become values; `None` when they are the values.
    pub scaling: Option<Scaling>,
    /// What the values mean.
    pub content: Content,
    /// Index of voxel (0, 0, 0) in the file's own index space: not zero for a cut-out region, or
    /// where the space has no natural corner (OpenVDB).
    pub first_index: [i64; 3],
    /// Further facts for print, as (name, value): compression, chunks, the chosen dataset.
    pub details: Vec<(&'static str, String)>,
    /// What a user should be told: trailing bytes, a spacing that was ignored, and the like.
    pub warnings: Vec<String>,
}

/// The axes of the world.
pub(crate) const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl Header {
    /// A header with the given layout and nothing known about the world.
    pub fn new(format: Format, dims: [u64; 3], dtype: DType) -> Self {
        Self {
            format,
            dims,
            voxel: dtype.voxel,
            byte_order: dtype.byte_order,
            spacing: None,
            unit: Unit::Unknown,
            origin: [0.0; 3],
            direction: IDENTITY,
            scaling: None,
            content: Content::Image,
            first_index: [0; 3],
            details: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Type and byte order of the voxels.
    pub fn dtype(&self) -> DType {
        DType {
            voxel: self.voxel,
            byte_order: self.byte_order,
        }
    }

    /// World position of index 0 of the file's own index space, which need not be in the volume.
    pub fn index_origin(&self) -> [f64; 3] {
        let first = self.offset_of_first();
        [0, 1, 2].map(|row| self.origin[row] - first[row])
    }

    /// Moves the volume so that index 0 of the file's own index space is at `position`: what is to
    /// be done when the spacing of a volume that was cut out is replaced.
    pub fn set_index_origin(&mut self, position: [f64; 3]) {
        let first = self.offset_of_first();
        self.origin = [0, 1, 2].map(|row| position[row] + first[row]);
    }

    /// From index 0 of the file's own index space to voxel (0, 0, 0), in the world.
    fn offset_of_first(&self) -> [f64; 3] {
        let spacing = self.spacing.unwrap_or([1.0; 3]);
        self.direction.map(|row| {
            // In this order regions are cut out, so that nothing is lost on the way back.
            (0..3).fold(0.0, |sum, a| {
                sum + row[a] * spacing[a] * self.first_index[a] as f64
            })
        })
    }

    /// Bytes of one plane of constant z; `None` when it does not fit `u64`.
    pub fn plane_bytes(&self) -> Option<u64> {
        let [x, y, _] = self.dims;
        // A voxel has at most 8 bytes, so the cast is exact.
        x.checked_mul(y)?.checked_mul(self.voxel.bytes() as u64)
    }

    /// Bytes of all voxels; `None` when it does not fit `u64`.
    pub fn voxels_bytes(&self) -> Option<u64> {
        self.plane_bytes()?.checked_mul(self.dims[2])
    }
}

/// Product of three extents, if it fits.
pub(crate) fn voxel_count(dims: [u64; 3]) -> Option<u64> {
    dims[0].checked_mul(dims[1])?.checked_mul(dims[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_name_reads_back_in_both_byte_orders() {
        for voxel in VoxelType::ALL {
            assert_eq!(voxel.name().parse::<VoxelType>(), Ok(voxel));
            for dtype in [DType::little(voxel), DType::big(voxel)] {
                let back: DType = dtype.to_string().parse().unwrap();
                assert_eq!(back.voxel, voxel);
                if voxel.bytes() > 1 {
                    assert_eq!(back, dtype);
                }
            }
        }
        assert!("u12".parse::<DType>().is_err());
        assert!("le".parse::<DType>().is_err());
    }

    #[test]
    fn units_read_back_from_their_symbols() {
        for unit in [
            Unit::Unknown,
            Unit::Metre,
            Unit::Centimetre,
            Unit::Millimetre,
            Unit::Micrometre,
            Unit::Nanometre,
            Unit::Angstrom,
        ] {
            assert_eq!(unit.symbol().parse(), Ok(unit));
        }
        assert!("furlong".parse::<Unit>().is_err());
    }

    #[test]
    fn a_region_that_overflows_is_not_inside() {
        let region = Region {
            origin: [u64::MAX, 0, 0],
            size: [2, 1, 1],
        };
        assert!(!region.is_inside([u64::MAX; 3]));
        assert!(Region::whole([3, 4, 5]).is_inside([3, 4, 5]));
    }
}
