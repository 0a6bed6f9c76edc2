//! Volumes written plane by plane: header first, voxels as they come.
//!
//! In: a [`WriteSpec`] and planes in order of z, x fastest, bytes in the spec's byte order. Out:
//! a complete file in any `Write`. Guaranteed: what the readers of this crate read back is the
//! spec and the bytes given, as far as the format can say it; too few or too many bytes are an
//! error of [`VolumeWriter::finish`] or [`VolumeWriter::write_planes`]. Not guaranteed: `.npy`,
//! `.vol` and raw files have no spacing, so it is lost there; NIfTI has no way to say that it is
//! unknown, so it is written as 1 in no unit.

use std::io::{self, Write};

use flate2::write::ZlibEncoder;

use crate::error::Error;
use crate::header::{ByteOrder, DType, IDENTITY, Unit, VoxelType};

/// The file formats that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum WriteFormat {
    /// Voxels alone.
    Raw,
    /// NumPy `.npy`, version 1.0, C order.
    Npy,
    /// NIfTI, single file: NIfTI-1, or NIfTI-2 if an extent exceeds 32767.
    Nifti,
    /// DGtal `.vol` version 2 (plain) or `.longvol` by voxel type (u8, or u64).
    Vol,
    /// DGtal `.vol` version 3 (zlib) or `.longvol` by voxel type (u8, or u64).
    VolZlib,
}

/// What is to be written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WriteSpec {
    /// Format of the file.
    pub format: WriteFormat,
    /// Voxels along x, y, z.
    pub dims: [u64; 3],
    /// Type and byte order of the voxels that will be given.
    pub dtype: DType,
    /// Edge lengths of a voxel.
    pub spacing: Option<[f64; 3]>,
    /// Unit of spacing and origin.
    pub unit: Unit,
    /// World position of the centre of voxel (0, 0, 0).
    pub origin: [f64; 3],
    /// World directions of the axes, in columns.
    pub direction: [[f64; 3]; 3],
}

impl WriteSpec {
    /// A volume without a place in the world.
    pub fn new(format: WriteFormat, dims: [u64; 3], dtype: DType) -> Self {
        Self {
            format,
            dims,
            dtype,
            spacing: None,
            unit: Unit::Unknown,
            origin: [0.0; 3],
            direction: IDENTITY,
        }
    }
}

enum Body<W: Write> {
    Plain(W),
    Zlib(Box<ZlibEncoder<W>>),
}

/// Writes one volume.
pub struct VolumeWriter<W: Write> {
    body: Body<W>,
    name: String,
    expected: u64,
    written: u64,
}

impl<W: Write> VolumeWriter<W> {
    /// Writes the header to `out`; `name` stands for it in messages.
    ///
    /// # Errors
    ///
    /// If the format cannot hold such a volume, or `out` cannot be written.
    pub fn new(mut out: W, name: &str, spec: &WriteSpec) -> Result<Self, Error> {
        let expected = spec
            .dims
            .iter()
            .try_fold(spec.dtype.voxel.bytes() as u64, |product, n| {
                product.checked_mul(*n)
            })
            .filter(|bytes| *bytes > 0 && *bytes <= u64::MAX >> 2)
            .ok_or_else(|| {
                Error::invalid(name, format!("{:?} voxels cannot be written", spec.dims))
            })?;
        let header = match spec.format {
            WriteFormat::Raw => Vec::new(),
            WriteFormat::Npy => npy_header(spec),
            WriteFormat::Nifti => nifti_header(spec, name)?,
            WriteFormat::Vol => vol_header(spec, 2, name)?,
            WriteFormat::VolZlib => vol_header(spec, 3, name)?,
        };
        out.write_all(&header)
            .map_err(|e| cannot_write(name, 0, e))?;
        let body = match spec.format {
            WriteFormat::VolZlib => Body::Zlib(Box::new(ZlibEncoder::new(
                out,
                flate2::Compression::default(),
            ))),
            _ => Body::Plain(out),
        };
        Ok(Self {
            body,
            name: name.to_string(),
            expected,
            written: 0,
        })
    }

    /// Writes the next voxels, whole planes or any part of them.
    ///
    /// # Errors
    ///
    /// If more is given than the volume has, or `out` cannot be written.
    pub fn write_planes(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let count = bytes.len() as u64;
        if count > self.expected - self.written {
            return Err(Error::invalid(
                &self.name,
                format!(
                    "{} bytes of voxels were given, the volume has {}",
                    self.written.saturating_add(count),
                    self.expected
                ),
            ));
        }
        match &mut self.body {
            Body::Plain(out) => out.write_all(bytes),
            Body::Zlib(out) => out.write_all(bytes),
        }
        .map_err(|e| cannot_write(&self.name, self.written, e))?;
        self.written += count;
        Ok(())
    }

    /// Completes the file and gives back what it was written to, flushed.
    ///
    /// # Errors
    ///
    /// If voxels are missing, or `out` cannot be written.
    pub fn finish(self) -> Result<W, Error> {
        if self.written < self.expected {
            return Err(Error::invalid(
                &self.name,
                format!(
                    "{} bytes of voxels were given, the volume has {}",
                    self.written, self.expected
                ),
            ));
        }
        let end = |e| cannot_write(&self.name, self.written, e);
        let mut out = match self.body {
            Body::Plain(out) => out,
            Body::Zlib(out) => out.finish().map_err(end)?,
        };
        out.flush().map_err(end)?;
        Ok(out)
    }
}

fn cannot_write(name: &str, at: u64, error: io::Error) -> Error {
    Error::io(name, "cannot be written", error).at(at)
}

fn npy_header(spec: &WriteSpec) -> Vec<u8> {
    /// NumPy aligns voxels to this, so that they can be mapped as any type.
    const ALIGNMENT: usize = 64;
    let kind = match spec.dtype.voxel {
        VoxelType::Bool => 'b',
        VoxelType::U8 | VoxelType::U16 | VoxelType::U32 | VoxelType::U64 => 'u',
        VoxelType::I8 | VoxelType::I16 | VoxelType::I32 | VoxelType::I64 => 'i',
        VoxelType::F16 | VoxelType::F32 | VoxelType::F64 => 'f',
    };
    let bytes = spec.dtype.voxel.bytes();
    let order = match (bytes, spec.dtype.byte_order) {
        (1, _) => '|',
        (_, ByteOrder::Little) => '<',
        (_, ByteOrder::Big) => '>',
    };
    let [x, y, z] = spec.dims;
    let mut text = format!(
        "{{'descr': '{order}{kind}{bytes}', 'fortran_order': False, 'shape': ({z}, {y}, {x}), }}"
    );
    let lead = crate::npy::MAGIC.len() + 4;
    while !(lead + text.len() + 1).is_multiple_of(ALIGNMENT) {
        text.push(' ');
    }
    text.push('\n');
    let mut header = crate::npy::MAGIC.to_vec();
    header.extend_from_slice(&[1, 0]);
    // At most three 20-digit numbers and 128 other bytes, so it fits.
    header.extend_from_slice(&(text.len() as u16).to_le_bytes());
    header.extend_from_slice(text.as_bytes());
    header
}

fn vol_header(spec: &WriteSpec, version: u8, name: &str) -> Result<Vec<u8>, Error> {
    let (prefix, bytes) = match (spec.dtype.voxel, spec.dtype.byte_order) {
        (VoxelType::U8, _) => ("V", 1),
        (VoxelType::U64, ByteOrder::Little) => ("Lv", 8),
        _ => {
            return Err(Error::unsupported(
                name,
                format!(
                    ".vol holds u8 and .longvol u64le voxels, not {}",
                    spec.dtype
                ),
            ));
        }
    };
    let [x, y, z] = spec.dims;
    // DGtal reads extents as 32-bit integers.
    if spec.dims.iter().any(|n| i32::try_from(*n).is_err()) {
        return Err(Error::unsupported(
            name,
            format!(".vol cannot hold {:?} voxels", spec.dims),
        ));
    }
    Ok(format!(
        "Center-X: {}\nCenter-Y: {}\nCenter-Z: {}\nX: {x}\nY: {y}\nZ: {z}\n{prefix}oxel-Size: \
         {bytes}\nAlpha-Color: 0\n{prefix}oxel-Endian: 0\nInt-Endian: 0123\nVersion: \
         {version}\n.\n",
        x / 2,
        y / 2,
        z / 2
    )
    .into_bytes())
}

/// Numbers put at offsets of a header, in the byte order of the voxels.
struct Record {
    bytes: Vec<u8>,
    order: ByteOrder,
}

impl Record {
    fn put<const N: usize>(&mut self, at: usize, mut little: [u8; N]) {
        if self.order == ByteOrder::Big {
            little.reverse();
        }
        self.bytes[at..at + N].copy_from_slice(&little);
    }
}

fn nifti_header(spec: &WriteSpec, name: &str) -> Result<Vec<u8>, Error> {
    let datatype: i16 = match spec.dtype.voxel {
        // NIfTI has no such type; 0 and 1 in a byte are the same bytes.
        VoxelType::Bool | VoxelType::U8 => 2,
        VoxelType::I16 => 4,
        VoxelType::I32 => 8,
        VoxelType::F32 => 16,
        VoxelType::F64 => 64,
        VoxelType::I8 => 256,
        VoxelType::U16 => 512,
        VoxelType::U32 => 768,
        VoxelType::I64 => 1024,
        VoxelType::U64 => 1280,
        VoxelType::F16 => {
            return Err(Error::unsupported(
                name,
                "NIfTI has no half precision voxels",
            ));
        }
    };
    let spacing = spec.spacing.unwrap_or([1.0; 3]);
    // Units NIfTI knows; others are converted to the nearest smaller one it has.
    let (code, scale): (u8, f64) = match spec.unit {
        Unit::Unknown => (0, 1.0),
        Unit::Metre => (1, 1.0),
        Unit::Millimetre => (2, 1.0),
        Unit::Micrometre => (3, 1.0),
        Unit::Centimetre => (2, 10.0),
        Unit::Nanometre => (3, 1e-3),
        Unit::Angstrom => (3, 1e-4),
    };
    let bits = spec.dtype.voxel.bytes() * 8;
    let spacing = spacing.map(|s| s * scale);
    let origin = spec.origin.map(|x| x * scale);
    // Without a spacing nothing is known about the world, and no transform is claimed.
    let code_sform: i32 = if spec.spacing.is_some() { 2 } else { 0 };
    let row = |r: usize| {
        [0, 1, 2, 3].map(|c| match c {
            3 => origin[r],
            _ => spec.direction[r][c] * spacing[c],
        })
    };
    let small: Vec<i16> = spec
        .dims
        .iter()
        .filter_map(|n| i16::try_from(*n).ok())
        .collect();

    if let [x, y, z] = small[..] {
        let mut record = Record {
            bytes: vec![0; 352],
            order: spec.dtype.byte_order,
        };
        record.put(0, 348_i32.to_le_bytes());
        for (i, n) in [3, x, y, z, 1, 1, 1, 1].into_iter().enumerate() {
            record.put(40 + 2 * i, n.to_le_bytes());
        }
        record.put(70, datatype.to_le_bytes());
        record.put(72, (bits as i16).to_le_bytes());
        // Single precision is what the format has.
        for (i, s) in [1.0, spacing[0], spacing[1], spacing[2]]
            .into_iter()
            .enumerate()
        {
            record.put(76 + 4 * i, (s as f32).to_le_bytes());
        }
        record.put(108, 352_f32.to_le_bytes());
        record.put(112, 1_f32.to_le_bytes());
        record.bytes[123] = code;
        record.put(254, (code_sform as i16).to_le_bytes());
        for r in 0..3 {
            for (c, value) in row(r).into_iter().enumerate() {
                record.put(280 + 16 * r + 4 * c, (value as f32).to_le_bytes());
            }
        }
        record.bytes[344..348].copy_from_slice(b"n+1\0");
        return Ok(record.bytes);
    }

    let mut record = Record {
        bytes: vec![0; 544],
        order: spec.dtype.byte_order,
    };
    record.put(0, 540_i32.to_le_bytes());
    record.bytes[4..12].copy_from_slice(b"n+2\0\r\n\x1a\n");
    record.put(12, datatype.to_le_bytes());
    record.put(14, (bits as i16).to_le_bytes());
    let [x, y, z] = spec.dims;
    for (i, n) in [3, x, y, z, 1, 1, 1, 1].into_iter().enumerate() {
        record.put(16 + 8 * i, n.to_le_bytes());
    }
    for (i, s) in [1.0, spacing[0], spacing[1], spacing[2]]
        .into_iter()
        .enumerate()
    {
        record.put(104 + 8 * i, s.to_le_bytes());
    }
    record.put(168, 544_i64.to_le_bytes());
    record.put(176, 1_f64.to_le_bytes());
    record.put(348, code_sform.to_le_bytes());
    for r in 0..3 {
        for (c, value) in row(r).into_iter().enumerate() {
            record.put(400 + 32 * r + 8 * c, value.to_le_bytes());
        }
    }
    record.put(500, i32::from(code).to_le_bytes());
    Ok(record.bytes)
}
