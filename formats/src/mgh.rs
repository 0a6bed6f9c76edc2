//! FreeSurfer MGH volumes, version 1; MGZ is the same in gzip data.
//!
//! In: a header of 284 bytes, big-endian, and voxels behind it, x fastest. Out: a header. With
//! `goodRASFlag` the file has voxel sizes in millimetres, the directions of the axes, and the
//! position of the centre of the volume, from which the centre of voxel (0, 0, 0) follows;
//! without, all of them are unknown. Several frames follow each other, and the caller chooses
//! one. What follows the voxels (scan parameters and tags) is not looked at.
//!
//! Refused: other versions, and types that are no single number a voxel.

use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header, Unit, VoxelType};
use crate::input::Input;
use crate::parsed::{Context, Parsed, is_plausible_spacing};
use crate::placement::{take_origin, take_vectors};
use crate::record::Record;

const HEADER_BYTES: usize = 284;

/// Bytes of the header that are in use.
const FIELD_BYTES: usize = 90;

/// Whether content beginning with `head` is such a file. There is no magic number: version 1 is,
/// so the fields behind it are looked at as well.
pub(crate) fn detect(head: &[u8]) -> bool {
    /// Beyond any frame's extent; a surface overlay has some 10^5 columns.
    const MOST: i32 = 1 << 27;
    let Some(bytes) = head.get(..FIELD_BYTES) else {
        return false;
    };
    let record = Record {
        bytes,
        order: ByteOrder::Big,
    };
    let counts = [4, 8, 12, 16].map(|at| record.i32(at));
    record.i32(0) == 1
        && counts.iter().all(|n| (1..=MOST).contains(n))
        && (0..=16).contains(&record.i32(20))
        && (0..=1).contains(&record.i16(28))
}

pub(crate) fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let name = context.name;
    let bytes = context.header_bytes(input, HEADER_BYTES)?;
    let record = Record {
        bytes: &bytes,
        order: ByteOrder::Big,
    };
    let version = record.i32(0);
    if version != 1 {
        return Err(
            Error::unsupported(name, format!("MGH version {version} found, 1 expected")).at(0),
        );
    }
    let extent = |at: usize, what: &str| match u64::try_from(record.i32(at)) {
        Ok(extent) if extent > 0 => Ok(extent),
        _ => Err(Error::invalid(
            name,
            format!("{what} is {}, at least 1 expected", record.i32(at)),
        )
        .at(at as u64)),
    };
    let dims = [
        extent(4, "width")?,
        extent(8, "height")?,
        extent(12, "depth")?,
    ];
    let frames = extent(16, "nframes")?;
    let dtype = DType::big(voxel(record.i32(20), name)?);
    let mut header = Header::new(Format::Mgh, dims, dtype);
    place(&record, &mut header, name);
    let mut parsed = Parsed::new(header, HEADER_BYTES as u64);
    parsed.choose_frame(frames, context)?;
    parsed.footer = true;
    Ok(parsed)
}

fn voxel(code: i32, name: &str) -> Result<VoxelType, Error> {
    let refused = match code {
        0 => return Ok(VoxelType::U8),
        1 => return Ok(VoxelType::I32),
        3 => return Ok(VoxelType::F32),
        4 => return Ok(VoxelType::I16),
        10 => return Ok(VoxelType::U16),
        2 => "long integers, whose size differs between machines,",
        5 => "bitmaps",
        6 => "tensors",
        7 | 8 => "complex voxels",
        9 => "colour voxels",
        _ => {
            return Err(Error::invalid(name, format!("type is {code}, no known code")).at(20));
        }
    };
    Err(Error::unsupported(name, format!("type is {code}: {refused} are not read")).at(20))
}

/// Spacing, origin and direction.
fn place(record: &Record<'_>, header: &mut Header, name: &str) {
    if record.i16(28) <= 0 {
        header.warnings.push(format!(
            "{name}: goodRASFlag is {}: the file does not say the size of a voxel and where it \
             lies",
            record.i16(28)
        ));
        return;
    }
    let spacing: [f64; 3] = std::array::from_fn(|a| record.f32_decimal(30 + 4 * a));
    if let Some(a) = spacing.iter().position(|s| !is_plausible_spacing(*s)) {
        header.warnings.push(format!(
            "{name}: the voxel size along {} is {:e}, which is none; spacing and place are taken \
             as unknown",
            ["x", "y", "z"][a],
            spacing[a]
        ));
        return;
    }
    header.spacing = Some(spacing);
    header.unit = Unit::Millimetre;
    // Stored axis by axis: the direction of x first.
    let axes: [[f64; 3]; 3] =
        std::array::from_fn(|a| std::array::from_fn(|r| record.f32(42 + 12 * a + 4 * r)));
    let Some(lengths) = take_vectors(header, axes, "the directions", name) else {
        return;
    };
    // What differs by more than rounding was not written by FreeSurfer.
    if lengths.iter().any(|length| (length - 1.0).abs() > 1e-2) {
        header.warnings.push(format!(
            "{name}: the directions have lengths {lengths:?}, 1 expected; the voxel sizes are used"
        ));
    }
    let centre: [f64; 3] = std::array::from_fn(|r| record.f32(78 + 4 * r));
    // The centre lies at index dims / 2, not (dims - 1) / 2.
    let half = |a: usize| spacing[a] * (header.dims[a] as f64 / 2.0);
    let origin =
        std::array::from_fn(|r| centre[r] - (0..3).map(|a| axes[a][r] * half(a)).sum::<f64>());
    take_origin(header, origin, "the centre", name);
}
