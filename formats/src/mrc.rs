//! MRC2014 and CCP4 maps, and the older files of the same family.
//!
//! In: a header of 1024 bytes, an extended header, and voxels behind it. Out: a header.
//! Conventions:
//!
//! - Byte order is that of the machine stamp. With an unknown stamp, or one that makes the
//!   header senseless where the other order does not, the order in which extents, mode and axes
//!   are plausible is taken, with a warning.
//! - A file has columns, rows and sections; MAPC, MAPR and MAPS say which axis each of them is.
//!   Voxels are given in (x, y, z) whatever the order is.
//! - Spacing is the cell edge over the sampling (CELLA / MX), in Angstrom. A cell of 0 is none.
//!   A cell with other angles than 90 degrees gives oblique directions, and a warning.
//! - Origin is ORIGIN where one of its words is not 0, else the start (NXSTART) times the
//!   spacing; `details` says which. IMOD wrote ORIGIN with the opposite sign until its flags or
//!   NVERSION said otherwise.
//! - Mode 0 is signed, as MRC2014 says, unless IMOD's flags or the statistics of the header
//!   (DMIN not negative, DMAX above 127) say that bytes are unsigned.
//! - Space group 401 and above is a stack of volumes of MZ sections: the caller chooses a frame.
//!   Space group 0 is a stack of images, taken as a volume with a warning.
//! - Without the magic number, a file is only taken for one of these if its whole header is
//!   plausible; its ORIGIN, which stood elsewhere then, is not used.
//!
//! Refused: complex, colour and 4-bit modes.

use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header, Unit, VoxelType};
use crate::input::Input;
use crate::order::AxisOrder;
use crate::parsed::{Context, Parsed, is_plausible_spacing};
use crate::record::Record;

const HEADER_BYTES: usize = 1024;

/// Offsets of the header's fields, in bytes.
mod at {
    pub(super) const EXTENTS: usize = 0;
    pub(super) const MODE: usize = 12;
    pub(super) const START: usize = 16;
    pub(super) const SAMPLING: usize = 28;
    pub(super) const CELL: usize = 40;
    pub(super) const ANGLES: usize = 52;
    pub(super) const AXES: usize = 64;
    pub(super) const LEAST: usize = 76;
    pub(super) const MOST: usize = 80;
    pub(super) const SPACE_GROUP: usize = 88;
    pub(super) const EXTENDED: usize = 92;
    pub(super) const VERSION: usize = 108;
    pub(super) const IMOD_STAMP: usize = 152;
    pub(super) const IMOD_FLAGS: usize = 156;
    pub(super) const ORIGIN: usize = 196;
    pub(super) const MAGIC: usize = 208;
    pub(super) const MACHINE: usize = 212;
    pub(super) const LABELS: usize = 220;
    /// Behind the last field that is looked at.
    pub(super) const END: usize = 224;
}

const MAGIC: &[u8] = b"MAP ";

/// IMOD's mark, and its flags: bytes are signed; ORIGIN has the sign of the standard; a byte
/// holds two voxels.
const IMOD_STAMP: i32 = 1_146_047_817;
const IMOD_SIGNED: i32 = 1;
const IMOD_ORIGIN: i32 = 4;
const IMOD_HALF_BYTES: i32 = 16;

/// Whether content beginning with `head` is such a file.
pub(crate) fn detect(head: &[u8]) -> bool {
    let Some(bytes) = head.get(..at::END) else {
        return false;
    };
    has_magic(bytes)
        || [ByteOrder::Little, ByteOrder::Big]
            .into_iter()
            .any(|order| is_old_file(&Record { bytes, order }))
}

fn has_magic(bytes: &[u8]) -> bool {
    bytes[at::MAGIC..].starts_with(MAGIC)
}

fn triple(record: &Record<'_>, at: usize) -> [i32; 3] {
    std::array::from_fn(|i| record.i32(at + 4 * i))
}

fn floats(record: &Record<'_>, at: usize) -> [f64; 3] {
    std::array::from_fn(|i| record.f32_decimal(at + 4 * i))
}

/// Axis (0 is x) of columns, rows and sections, if MAPC, MAPR and MAPS name each axis once.
fn axes(record: &Record<'_>) -> Option<[usize; 3]> {
    let axes = triple(record, at::AXES).map(|axis| usize::try_from(axis).unwrap_or(0));
    let mut seen = [false; 4];
    for axis in axes {
        *seen.get_mut(axis)? = true;
    }
    (seen == [false, true, true, true]).then(|| axes.map(|axis| axis - 1))
}

/// Whether the header makes sense in this byte order. Small numbers do in one order only.
fn makes_sense(record: &Record<'_>) -> bool {
    /// Beyond any detector and any reconstruction.
    const MOST_EXTENT: i32 = 1 << 20;
    let unset = triple(record, at::AXES) == [0; 3];
    triple(record, at::EXTENTS)
        .iter()
        .all(|n| (1..=MOST_EXTENT).contains(n))
        && (0..=255).contains(&record.i32(at::MODE))
        && (unset || axes(record).is_some())
}

/// Whether the header is that of a file without magic number, as they were before 2000: then
/// every field that all those files have must be right, since other content must not be taken
/// for one.
fn is_old_file(record: &Record<'_>) -> bool {
    const MOST_EXTENDED_BYTES: i32 = 1 << 28;
    let cell = floats(record, at::CELL);
    let angles = floats(record, at::ANGLES);
    makes_sense(record)
        && axes(record).is_some()
        && matches!(record.i32(at::MODE), 0..=2 | 6)
        && triple(record, at::SAMPLING).iter().all(|n| *n > 0)
        && (0..=MOST_EXTENDED_BYTES).contains(&record.i32(at::EXTENDED))
        && cell.iter().all(|edge| (0.0..=1e9).contains(edge))
        && angles.iter().all(|angle| (0.0..180.0).contains(angle))
        && (0..=10).contains(&record.i32(at::LABELS))
}

pub(crate) fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let name = context.name;
    let bytes = context.header_bytes(input, HEADER_BYTES)?;
    let mut warnings = Vec::new();
    let record = Record {
        bytes: &bytes,
        order: byte_order(&bytes, &mut warnings, name),
    };
    if !has_magic(&bytes) {
        if !is_old_file(&record) {
            return Err(Error::invalid(
                name,
                format!(
                    "the magic is \"{}\", \"MAP \" expected, and without it the header is not \
                     plausible",
                    bytes[at::MAGIC..at::MACHINE].escape_ascii()
                ),
            )
            .at(at::MAGIC as u64));
        }
        warnings.push(format!(
            "{name}: no magic number; taken as an old MRC or CCP4 file in {} byte order, since \
             the whole header is plausible",
            order_name(record.order)
        ));
    }
    let voxel = voxel(&record, &mut warnings, name)?;
    let axes = match axes(&record) {
        Some(axes) => axes,
        None if triple(&record, at::AXES) == [0; 3] => {
            warnings.push(format!(
                "{name}: MAPC, MAPR and MAPS are 0; columns, rows and sections are taken as x, y \
                 and z"
            ));
            [0, 1, 2]
        }
        None => {
            return Err(Error::invalid(
                name,
                format!(
                    "MAPC, MAPR and MAPS are {:?}, each of 1, 2 and 3 once expected",
                    triple(&record, at::AXES)
                ),
            )
            .at(at::AXES as u64));
        }
    };
    let (dims, frames) = extents(&record, axes, name)?;
    let mut header = Header::new(
        Format::Mrc,
        dims,
        DType {
            voxel,
            byte_order: record.order,
        },
    );
    header.warnings = warnings;
    if record.i32(at::SPACE_GROUP) == 0 && has_magic(&bytes) && dims[axes[2]] > 1 {
        header.warnings.push(format!(
            "{name}: the space group (ISPG) is 0, a stack of images; its sections are taken as \
             the planes of one volume"
        ));
    }
    place(&record, axes, &mut header, name);

    let offset = HEADER_BYTES as u64 + extended_bytes(&record, context)?;
    let mut parsed = Parsed::new(header, offset);
    parsed.order = AxisOrder::of(axes);
    parsed.choose_frame(frames, context)?;
    Ok(parsed)
}

fn order_name(order: ByteOrder) -> &'static str {
    match order {
        ByteOrder::Little => "little-endian",
        ByteOrder::Big => "big-endian",
    }
}

fn byte_order(bytes: &[u8], warnings: &mut Vec<String>, name: &str) -> ByteOrder {
    let makes_sense = |order| makes_sense(&Record { bytes, order });
    let stamp = &bytes[at::MACHINE..at::MACHINE + 2];
    let stated = match stamp {
        [0x44, 0x41 | 0x44] => Some(ByteOrder::Little),
        [0x11, 0x11] => Some(ByteOrder::Big),
        _ => None,
    };
    let likely = if !makes_sense(ByteOrder::Little) && makes_sense(ByteOrder::Big) {
        ByteOrder::Big
    } else {
        ByteOrder::Little
    };
    match stated {
        Some(stated) if stated == likely || makes_sense(stated) || !makes_sense(likely) => {
            return stated;
        }
        // Said by the warning on the missing magic number.
        None if !has_magic(bytes) => return likely,
        _ => {}
    }
    warnings.push(format!(
        "{name}: the machine stamp is {:02x} {:02x}, but extents, mode and axes make sense in {} \
         byte order, which is used",
        stamp[0],
        stamp[1],
        order_name(likely)
    ));
    likely
}

fn voxel(record: &Record<'_>, warnings: &mut Vec<String>, name: &str) -> Result<VoxelType, Error> {
    let mode = record.i32(at::MODE);
    let refused = match mode {
        0 => return bytes_voxel(record, warnings, name),
        1 => return Ok(VoxelType::I16),
        2 => return Ok(VoxelType::F32),
        6 => return Ok(VoxelType::U16),
        12 => return Ok(VoxelType::F16),
        3 | 4 => "complex voxels (a transform)",
        16 => "colour voxels",
        101 => "4-bit voxels",
        _ => {
            return Err(
                Error::invalid(name, format!("mode is {mode}; 0, 1, 2, 6 or 12 expected"))
                    .at(at::MODE as u64),
            );
        }
    };
    Err(
        Error::unsupported(name, format!("mode is {mode}: {refused} are not read"))
            .at(at::MODE as u64),
    )
}

/// Mode 0: signed or not.
fn bytes_voxel(
    record: &Record<'_>,
    warnings: &mut Vec<String>,
    name: &str,
) -> Result<VoxelType, Error> {
    if record.i32(at::IMOD_STAMP) == IMOD_STAMP {
        let flags = record.i32(at::IMOD_FLAGS);
        if flags & IMOD_HALF_BYTES != 0 {
            return Err(Error::unsupported(
                name,
                format!("imodFlags is {flags}: bytes of two 4-bit voxels are not read"),
            )
            .at(at::IMOD_FLAGS as u64));
        }
        return Ok(if flags & IMOD_SIGNED != 0 {
            VoxelType::I8
        } else {
            VoxelType::U8
        });
    }
    let (least, most) = (record.f32(at::LEAST), record.f32(at::MOST));
    if least >= 0.0 && (128.0..256.0).contains(&most) {
        warnings.push(format!(
            "{name}: mode is 0, whose bytes are signed, but the header says that values reach \
             from {least} to {most}; they are taken as unsigned"
        ));
        return Ok(VoxelType::U8);
    }
    Ok(VoxelType::I8)
}

/// Voxels along x, y and z of one volume, and the number of volumes.
fn extents(record: &Record<'_>, axes: [usize; 3], name: &str) -> Result<([u64; 3], u64), Error> {
    /// Space groups of stacks of volumes, by the standard.
    const VOLUME_STACKS: std::ops::RangeInclusive<i32> = 401..=630;
    let mut dims = [0; 3];
    for (i, count) in triple(record, at::EXTENTS).into_iter().enumerate() {
        let at = at::EXTENTS + 4 * i;
        dims[axes[i]] = match u64::try_from(count) {
            Ok(count) if count > 0 => count,
            _ => {
                return Err(Error::invalid(
                    name,
                    format!("{} is {count}, at least 1 expected", ["NX", "NY", "NZ"][i]),
                )
                .at(at as u64));
            }
        };
    }
    let group = record.i32(at::SPACE_GROUP);
    if !VOLUME_STACKS.contains(&group) {
        return Ok((dims, 1));
    }
    if axes != [0, 1, 2] {
        return Err(Error::unsupported(
            name,
            format!(
                "ISPG is {group}, a stack of volumes, and MAPC, MAPR and MAPS are not 1, 2, 3: \
                 such a stack is not read"
            ),
        )
        .at(at::SPACE_GROUP as u64));
    }
    let sections = record.i32(at::SAMPLING + 8);
    match u64::try_from(sections) {
        Ok(sections) if sections > 0 && dims[2] % sections == 0 => {
            let frames = dims[2] / sections;
            Ok(([dims[0], dims[1], sections], frames))
        }
        _ => Err(Error::invalid(
            name,
            format!(
                "ISPG is {group}, a stack of volumes, but NZ is {}, no multiple of the {sections} \
                 sections of a volume (MZ)",
                dims[2]
            ),
        )
        .at(at::SAMPLING as u64 + 8)),
    }
}

/// Bytes of the extended header.
fn extended_bytes(record: &Record<'_>, context: &Context<'_>) -> Result<u64, Error> {
    let count = record.i32(at::EXTENDED);
    let invalid =
        |message: String| Err(Error::invalid(context.name, message).at(at::EXTENDED as u64));
    let Ok(bytes) = u64::try_from(count) else {
        return invalid(format!("NSYMBT is {count}, a number of bytes expected"));
    };
    match context.length {
        Some(length) if bytes > length.saturating_sub(HEADER_BYTES as u64) => invalid(format!(
            "NSYMBT is {count}: the extended header would end at byte {}, the file has {length} \
             bytes",
            bytes + HEADER_BYTES as u64
        )),
        _ => Ok(bytes),
    }
}

/// Spacing, origin and direction.
fn place(record: &Record<'_>, axes: [usize; 3], header: &mut Header, name: &str) {
    let cell = floats(record, at::CELL);
    let sampling = triple(record, at::SAMPLING);
    let spacing: [f64; 3] = std::array::from_fn(|a| cell[a] / f64::from(sampling[a]));
    if !spacing.iter().all(|s| is_plausible_spacing(*s)) {
        header.warnings.push(format!(
            "{name}: the cell is {cell:?} Angstrom for {sampling:?} voxels, which gives no voxel \
             size; the spacing is taken as unknown"
        ));
        return;
    }
    header.spacing = Some(spacing);
    header.unit = Unit::Angstrom;
    oblique(floats(record, at::ANGLES), header, name);

    let magic = has_magic(record.bytes);
    let stated = floats(record, at::ORIGIN);
    if magic && stated.iter().any(|x| *x != 0.0) {
        if !stated.iter().all(|x| x.is_finite() && x.abs() <= 1e15) {
            header.warnings.push(format!(
                "{name}: ORIGIN is {stated:?}, which is no place; it is ignored"
            ));
            return;
        }
        let imod = record.i32(at::IMOD_STAMP) == IMOD_STAMP
            && record.i32(at::IMOD_FLAGS) & IMOD_ORIGIN == 0
            && record.i32(at::VERSION) < 20140;
        header.origin = if imod { stated.map(|x| -x) } else { stated };
        let source = if imod {
            "ORIGIN, with the sign of IMOD"
        } else {
            "ORIGIN"
        };
        header.details.push(("origin from", source.into()));
        return;
    }
    let start = triple(record, at::START);
    if start == [0; 3] {
        return;
    }
    let mut steps = [0.0; 3];
    for i in 0..3 {
        steps[axes[i]] = f64::from(start[i]) * spacing[axes[i]];
    }
    header.origin = header
        .direction
        .map(|row| (0..3).map(|a| row[a] * steps[a]).sum());
    header
        .details
        .push(("origin from", "NXSTART, NYSTART, NZSTART".into()));
}

/// Takes the directions from the angles of the cell: x along a, y in the plane of a and b.
fn oblique(angles: [f64; 3], header: &mut Header, name: &str) {
    /// Old files leave the angles 0.
    const UNSET: [f64; 3] = [0.0; 3];
    if angles == UNSET || angles.iter().all(|angle| (angle - 90.0).abs() < 1e-3) {
        return;
    }
    // The cosine of 90 degrees is 0, and not almost.
    let cosines = angles.map(|angle| match angle {
        90.0 => 0.0,
        other => other.to_radians().cos(),
    });
    let [alpha, beta, gamma] = cosines;
    let sine = (1.0 - gamma * gamma).sqrt();
    let y = [gamma, sine, 0.0];
    let across = (alpha - beta * gamma) / sine;
    let up = 1.0 - beta.powi(2) - across.powi(2);
    let possible = angles.iter().all(|angle| (1.0..=179.0).contains(angle)) && up > 1e-6;
    if !possible {
        header.warnings.push(format!(
            "{name}: the angles of the cell are {angles:?}, which no cell has; right angles are \
             taken"
        ));
        return;
    }
    let z = [beta, across, up.sqrt()];
    header.direction = std::array::from_fn(|r| [[1.0, 0.0, 0.0][r], y[r], z[r]]);
    header.warnings.push(format!(
        "{name}: the angles of the cell are {angles:?}, so the axes are not orthogonal (sheared); \
         voxels are taken as boxes"
    ));
}
