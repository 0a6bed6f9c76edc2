//! NIfTI-1 and NIfTI-2, single files and pairs, either byte order.
//!
//! In: the fixed header of 348 (540) bytes. Out: a header. Conventions:
//!
//! - Spacing is |pixdim[1..3]|, never the length of the columns of the sform: a registered image
//!   may carry a scaling there that its voxels do not have. A spacing that is zero, not a number
//!   or absurd is left out, with a warning, and lengths are then in voxels.
//! - NIfTI-1 has single precision numbers. A spacing is the shortest decimal that gives the
//!   stored number, 3.2 and not 3.2000000477, so that both versions of a file agree. Everything
//!   else is the stored number.
//! - Origin and direction come from the sform if its code is set, else from the quaternion
//!   (qform), else they are unknown. A matrix without directions is ignored with a warning.
//! - A stored value v means scl_slope * v + scl_inter, unless the slope is 0 or not finite.
//! - Axes beyond the third count volumes; with more than one, the caller chooses a frame.
//!
//! Analyze 7.5 pairs, which have the same header with fewer fields, are read here, too; what is
//! different about them is in `analyze`.
//!
//! Refused: complex, colour and 128-bit voxels, CIFTI, one and two dimensions.

use std::path::{Path, PathBuf};

use crate::analyze;
use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header, IDENTITY, Scaling, Unit, VoxelType};
use crate::input::Input;
use crate::parsed::{Context, Elsewhere, Parsed, is_plausible_spacing};
use crate::record::Record;

const SIZE_1: usize = 348;
const SIZE_2: usize = 540;

/// The format whose header begins with `head`.
pub(crate) fn detect(head: &[u8]) -> Option<Format> {
    let size: [u8; 4] = head.get(..4)?.try_into().ok()?;
    let (little, big) = (u32::from_le_bytes(size), u32::from_be_bytes(size));
    if little == SIZE_1 as u32 || big == SIZE_1 as u32 {
        Some(if analyze::is_analyze(head) {
            Format::Analyze
        } else {
            Format::Nifti1
        })
    } else if little == SIZE_2 as u32 || big == SIZE_2 as u32 {
        Some(Format::Nifti2)
    } else {
        None
    }
}

/// The header file beside `path`, if `path` is named like the voxels of a pair.
pub(crate) fn header_of_image(path: &Path) -> Option<PathBuf> {
    let candidates = siblings(path, "img", "hdr")?;
    candidates.into_iter().find(|candidate| {
        // Other programs have .hdr files, too; they keep their .img to themselves.
        let head = std::fs::File::open(candidate).ok().and_then(|file| {
            let mut input = Input::new(file);
            let head = input.peek(crate::input::Compression::MAGIC_BYTES).ok()?;
            if let Some(compression) = crate::input::Compression::detect(head) {
                input = input.decompressed(compression).ok()?;
            }
            Some(input.peek(4).ok()?.to_vec())
        });
        head.is_some_and(|head| detect(&head).is_some())
    })
}

/// Paths that differ from `path` in the extension `from`, which becomes `to`, compressed or not.
/// The spelling that matches `path` comes first.
fn siblings(path: &Path, from: &str, to: &str) -> Option<Vec<PathBuf>> {
    const COMPRESSED: [&str; 4] = ["", ".gz", ".zst", ".bz2"];
    let file = path.file_name()?.to_str()?;
    COMPRESSED.into_iter().find_map(|suffix| {
        let stem = file.strip_suffix(suffix)?;
        let (stem, extension) = stem.rsplit_once('.')?;
        if !extension.eq_ignore_ascii_case(from) {
            return None;
        }
        // As FOO.HDR lies beside FOO.IMG.
        let upper = extension.chars().all(|c| c.is_ascii_uppercase());
        let to = if upper {
            to.to_ascii_uppercase()
        } else {
            to.to_string()
        };
        let others = COMPRESSED.into_iter().filter(|other| *other != suffix);
        let suffixes = std::iter::once(suffix).chain(others);
        Some(
            suffixes
                .map(|s| path.with_file_name(format!("{stem}.{to}{s}")))
                .collect(),
        )
    })
}

/// The fields that matter, of either version.
pub(crate) struct Fields {
    pub(crate) magic: [u8; 4],
    pub(crate) dim: [i64; 8],
    pub(crate) datatype: i16,
    bitpix: i16,
    pixdim: [f64; 8],
    vox_offset: f64,
    pub(crate) slope: f64,
    pub(crate) intercept: f64,
    pub(crate) intent: i64,
    pub(crate) qform: i64,
    pub(crate) sform: i64,
    quaternion: [f64; 3],
    qoffset: [f64; 3],
    srow: [[f64; 4]; 3],
    units: i64,
}

impl Fields {
    fn of_version_1(record: &Record<'_>) -> Self {
        Self {
            magic: [
                record.bytes[344],
                record.bytes[345],
                record.bytes[346],
                record.bytes[347],
            ],
            dim: std::array::from_fn(|i| i64::from(record.i16(40 + 2 * i))),
            datatype: record.i16(70),
            bitpix: record.i16(72),
            pixdim: std::array::from_fn(|i| record.f32_decimal(76 + 4 * i)),
            vox_offset: record.f32(108),
            slope: record.f32(112),
            intercept: record.f32(116),
            intent: i64::from(record.i16(68)),
            qform: i64::from(record.i16(252)),
            sform: i64::from(record.i16(254)),
            quaternion: std::array::from_fn(|i| record.f32(256 + 4 * i)),
            qoffset: std::array::from_fn(|i| record.f32(268 + 4 * i)),
            srow: std::array::from_fn(|r| {
                std::array::from_fn(|c| record.f32(280 + 16 * r + 4 * c))
            }),
            units: i64::from(record.bytes[123]),
        }
    }

    fn of_version_2(record: &Record<'_>) -> Self {
        // A 64-bit offset beyond 2^53 is no file's; as a float it fails the checks just as well.
        let vox_offset = record.i64(168) as f64;
        Self {
            magic: [
                record.bytes[4],
                record.bytes[5],
                record.bytes[6],
                record.bytes[7],
            ],
            dim: std::array::from_fn(|i| record.i64(16 + 8 * i)),
            datatype: record.i16(12),
            bitpix: record.i16(14),
            pixdim: std::array::from_fn(|i| record.f64(104 + 8 * i)),
            vox_offset,
            slope: record.f64(176),
            intercept: record.f64(184),
            intent: i64::from(record.i32(504)),
            qform: i64::from(record.i32(344)),
            sform: i64::from(record.i32(348)),
            quaternion: std::array::from_fn(|i| record.f64(352 + 8 * i)),
            qoffset: std::array::from_fn(|i| record.f64(376 + 8 * i)),
            srow: std::array::from_fn(|r| {
                std::array::from_fn(|c| record.f64(400 + 32 * r + 8 * c))
            }),
            units: i64::from(record.i32(500)),
        }
    }
}

pub(crate) fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let name = context.name;
    let head = input
        .peek(SIZE_1)
        .map_err(|e| crate::input::read_error(name, 0, e))?;
    let Some(format) = detect(head) else {
        return Err(Error::invalid(
            name,
            format!(
                "not a NIfTI header: it begins with {:02x?}, the size 348 or 540 expected",
                &head[..head.len().min(4)]
            ),
        )
        .at(0));
    };
    let (size, magic_at) = if format == Format::Nifti2 {
        (SIZE_2, 4)
    } else {
        (SIZE_1, 344)
    };
    let order = if u32::from_le_bytes([head[0], head[1], head[2], head[3]]) == size as u32 {
        ByteOrder::Little
    } else {
        ByteOrder::Big
    };
    let bytes = context.header_bytes(input, size)?;
    let record = Record {
        bytes: &bytes,
        order,
    };
    let mut warnings = Vec::new();
    let mut fields = if format == Format::Nifti2 {
        Fields::of_version_2(&record)
    } else {
        Fields::of_version_1(&record)
    };
    if format == Format::Analyze {
        analyze::adapt(&record, &mut fields, &mut warnings, name)?;
    }
    let pair = match (&fields.magic, format) {
        (b"n+1\0", Format::Nifti1) | (b"n+2\0", Format::Nifti2) => false,
        (b"ni1\0", Format::Nifti1 | Format::Analyze) | (b"ni2\0", Format::Nifti2) => true,
        (magic, _) => {
            return Err(Error::invalid(
                name,
                format!(
                    "the magic is \"{}\", \"n+1\" or \"ni1\" (NIfTI-2: \"n+2\", \"ni2\") expected",
                    magic.escape_ascii()
                ),
            )
            .at(magic_at));
        }
    };
    if (3000..3100).contains(&fields.intent) {
        return Err(Error::unsupported(
            name,
            format!(
                "intent code {}: CIFTI, which is not a volume",
                fields.intent
            ),
        ));
    }

    let voxel = voxel(&fields, format, name)?;
    let (dims, frames) = dims(&fields, format, name)?;
    let mut header = Header::new(
        format,
        dims,
        DType {
            voxel,
            byte_order: order,
        },
    );
    header.warnings = warnings;
    place(&fields, &mut header, name);
    if format == Format::Analyze {
        analyze::complete(&record, &mut header);
    }
    header.scaling = scaling(&fields, &mut header.warnings, name);

    let offset = voxel_offset(&fields, format, pair, &mut header.warnings, name)?;
    let mut parsed = Parsed::new(header, offset);
    parsed.choose_frame(frames, context)?;
    if pair {
        let path = context.path.unwrap_or(Path::new(""));
        let Some(images) = siblings(path, "hdr", "img") else {
            return Err(Error::unsupported(
                name,
                "the header of a pair, whose voxels are in a file of the same name ending in \
                 .img; this is not the path of a file ending in .hdr, so they cannot be found",
            ));
        };
        parsed.elsewhere = Elsewhere::FirstOf(images);
    }
    Ok(parsed)
}

fn voxel(fields: &Fields, format: Format, name: &str) -> Result<VoxelType, Error> {
    let at = if format == Format::Nifti2 { 12 } else { 70 };
    let (voxel, refused) = match fields.datatype {
        2 => (VoxelType::U8, ""),
        4 => (VoxelType::I16, ""),
        8 => (VoxelType::I32, ""),
        16 => (VoxelType::F32, ""),
        64 => (VoxelType::F64, ""),
        256 => (VoxelType::I8, ""),
        512 => (VoxelType::U16, ""),
        768 => (VoxelType::U32, ""),
        1024 => (VoxelType::I64, ""),
        1280 => (VoxelType::U64, ""),
        1 => (VoxelType::Bool, "one bit a voxel"),
        32 | 1792 | 2048 => (VoxelType::F32, "complex voxels"),
        128 | 2304 => (VoxelType::U8, "colour voxels"),
        1536 => (VoxelType::F64, "128-bit floating point voxels"),
        other => {
            return Err(Error::invalid(name, format!("datatype is {other}, no known code")).at(at));
        }
    };
    if !refused.is_empty() {
        let code = fields.datatype;
        return Err(Error::unsupported(
            name,
            format!("datatype is {code}: {refused} are not read"),
        )
        .at(at));
    }
    let bits = voxel.bytes() * 8;
    // Zero is what writers leave that do not know the field.
    if fields.bitpix != 0 && usize::try_from(fields.bitpix) != Ok(bits) {
        return Err(Error::invalid(
            name,
            format!(
                "bitpix is {}, but datatype {} has {bits} bits",
                fields.bitpix, fields.datatype
            ),
        )
        .at(at + 2));
    }
    Ok(voxel)
}

/// Extents and number of frames.
fn dims(fields: &Fields, format: Format, name: &str) -> Result<([u64; 3], u64), Error> {
    let at = if format == Format::Nifti2 { 16 } else { 40 };
    let count = fields.dim[0];
    if !(1..=7).contains(&count) {
        return Err(Error::invalid(name, format!("dim[0] is {count}, 3 to 7 expected")).at(at));
    }
    if count < 3 {
        return Err(Error::unsupported(
            name,
            format!("dim[0] is {count}: an image of {count} dimensions, 3 expected"),
        )
        .at(at));
    }
    let extent = |i: usize| match u64::try_from(fields.dim[i]) {
        Ok(extent) if extent > 0 => Ok(extent),
        _ => Err(Error::invalid(
            name,
            format!("dim[{i}] is {}, at least 1 expected", fields.dim[i]),
        )
        .at(at)),
    };
    let dims = [extent(1)?, extent(2)?, extent(3)?];
    let mut frames: u64 = 1;
    for i in 4..=7 {
        if i as i64 <= count {
            frames = frames.checked_mul(extent(i)?).ok_or_else(|| {
                Error::invalid(name, "dim[4] to dim[7] multiply to no possible number").at(at)
            })?;
        }
    }
    Ok((dims, frames))
}

fn voxel_offset(
    fields: &Fields,
    format: Format,
    pair: bool,
    warnings: &mut Vec<String>,
    name: &str,
) -> Result<u64, Error> {
    let (first, at) = if format == Format::Nifti2 {
        (544, 168)
    } else {
        (352, 108)
    };
    let offset = fields.vox_offset;
    // Beyond 2^53 a float no longer counts bytes.
    if !(0.0..=9.0e15).contains(&offset) || offset.fract() != 0.0 {
        return Err(Error::invalid(
            name,
            format!("vox_offset is {offset}, a whole number of bytes expected"),
        )
        .at(at));
    }
    // Checked just above.
    let offset = offset as u64;
    if pair || offset >= first {
        return Ok(offset);
    }
    if offset == 0 {
        warnings.push(format!(
            "{name}: vox_offset is 0; voxels are read from byte {first}"
        ));
        return Ok(first);
    }
    Err(Error::invalid(
        name,
        format!("vox_offset is {offset}, inside the header; at least {first} expected"),
    )
    .at(at))
}

fn scaling(fields: &Fields, warnings: &mut Vec<String>, name: &str) -> Option<Scaling> {
    let (slope, intercept) = (fields.slope, fields.intercept);
    // The standard: slope 0 means that values are stored as they are.
    if slope == 0.0 {
        return None;
    }
    if !slope.is_finite() || !intercept.is_finite() {
        warnings.push(format!(
            "{name}: scl_slope is {slope} and scl_inter {intercept}; values are taken unscaled"
        ));
        return None;
    }
    (slope != 1.0 || intercept != 0.0).then_some(Scaling { slope, intercept })
}

/// Spacing, unit, origin and direction.
fn place(fields: &Fields, header: &mut Header, name: &str) {
    let pixdim = [fields.pixdim[1], fields.pixdim[2], fields.pixdim[3]];
    let spacing = pixdim.map(f64::abs);
    if let Some(i) = spacing.iter().position(|s| !is_plausible_spacing(*s)) {
        header.warnings.push(format!(
            "{name}: pixdim[{}] is {:e}, which is no voxel size; the spacing is taken as unknown",
            i + 1,
            pixdim[i]
        ));
    } else {
        header.spacing = Some(spacing);
        header.unit = match fields.units & 7 {
            1 => Unit::Metre,
            2 => Unit::Millimetre,
            3 => Unit::Micrometre,
            0 => Unit::Unknown,
            other => {
                header.warnings.push(format!(
                    "{name}: xyzt_units has the unknown code {other} for lengths"
                ));
                Unit::Unknown
            }
        };
        if pixdim.iter().any(|s| *s < 0.0) {
            header.warnings.push(format!(
                "{name}: pixdim[1..3] is {pixdim:?}; the sign carries no meaning and is dropped"
            ));
        }
    }
    if fields.sform > 0 && sform(fields, header, name) {
        return;
    }
    if fields.qform > 0 {
        qform(fields, header, name);
    }
}

/// Takes origin and direction from the sform; false if it has none.
fn sform(fields: &Fields, header: &mut Header, name: &str) -> bool {
    /// Cosines and relative lengths that differ by less come from rounding to single precision.
    const ROUNDING: f64 = 1e-3;
    let rows = &fields.srow;
    let column = |c: usize| [rows[0][c], rows[1][c], rows[2][c]];
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let lengths = [0, 1, 2].map(|c| norm(column(c)));
    let finite = rows.iter().flatten().all(|x| x.is_finite());
    if !finite || lengths.iter().any(|length| !is_plausible_spacing(*length)) {
        header.warnings.push(format!(
            "{name}: the sform is no transform (columns of length {lengths:?}); it is ignored"
        ));
        return false;
    }
    let unit = [0, 1, 2].map(|c| column(c).map(|x| x / lengths[c]));
    let dot = |a: usize, b: usize| (0..3).map(|r| unit[a][r] * unit[b][r]).sum::<f64>();
    let triple = (0..3)
        .map(|r| {
            let (s, t) = ((r + 1) % 3, (r + 2) % 3);
            unit[0][r] * (unit[1][s] * unit[2][t] - unit[1][t] * unit[2][s])
        })
        .sum::<f64>();
    if triple.abs() < 1e-6 {
        header
            .warnings
            .push(format!("{name}: the sform is singular; it is ignored"));
        return false;
    }
    if [dot(0, 1), dot(1, 2), dot(2, 0)]
        .iter()
        .any(|d| d.abs() > ROUNDING)
    {
        header.warnings.push(format!(
            "{name}: the axes of the sform are not orthogonal (sheared); voxels are taken as \
             boxes of the size in pixdim"
        ));
    } else if let Some(spacing) = header.spacing
        && (0..3).any(|a| (lengths[a] - spacing[a]).abs() > ROUNDING * spacing[a])
    {
        header.warnings.push(format!(
            "{name}: the sform scales the axes by {lengths:?}, pixdim says {spacing:?}; pixdim is \
             used"
        ));
    }
    header.origin = [rows[0][3], rows[1][3], rows[2][3]];
    header.direction = std::array::from_fn(|r| std::array::from_fn(|c| unit[c][r]));
    true
}

/// Takes origin and direction from the quaternion (a, b, c, d), a >= 0, of the qform.
fn qform(fields: &Fields, header: &mut Header, name: &str) {
    let [b, c, d] = fields.quaternion;
    let square = b * b + c * c + d * d;
    if !square.is_finite() || !fields.qoffset.iter().all(|x| x.is_finite()) {
        header
            .warnings
            .push(format!("{name}: the qform is not finite; it is ignored"));
        return;
    }
    // Rounding can bring the sum slightly above 1: then the rotation is by 180 degrees.
    let (a, scale) = if square > 1.0 {
        (0.0, 1.0 / square.sqrt())
    } else {
        ((1.0 - square).sqrt(), 1.0)
    };
    let (b, c, d) = (b * scale, c * scale, d * scale);
    let flip = if fields.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
    let rotation = [
        [
            a * a + b * b - c * c - d * d,
            2.0 * (b * c - a * d),
            2.0 * (b * d + a * c),
        ],
        [
            2.0 * (b * c + a * d),
            a * a + c * c - b * b - d * d,
            2.0 * (c * d - a * b),
        ],
        [
            2.0 * (b * d - a * c),
            2.0 * (c * d + a * b),
            a * a + d * d - b * b - c * c,
        ],
    ];
    debug_assert_eq!(header.direction, IDENTITY);
    header.direction = rotation.map(|[x, y, z]| [x, y, z * flip]);
    header.origin = fields.qoffset;
}
