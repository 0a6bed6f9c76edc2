//! What tells an Analyze 7.5 header from a NIfTI-1 header, which was made from it.
//!
//! In: the fields of a NIfTI-1 header. Out: the same fields, with those that Analyze does not have
//! set to what NIfTI says where nothing is known; `nifti` does the rest. Conventions:
//!
//! - Lengths are in millimetres unless `vox_units` names another unit.
//! - The format does not say which side is left, and the origin that SPM keeps in the field
//!   `originator` means something else to every program: directions and origin are unknown.
//! - SPM keeps a factor of the values in the field `funused1`; it is used, with a warning.
//! - SPM's types 130, 132 and 136 are i8, u16 and u32.

use crate::error::Error;
use crate::header::{Header, Unit};
use crate::nifti::Fields;
use crate::record::Record;

/// Offset of `regular`, which is "r": all volumes of the file have the same extents.
const REGULAR: usize = 38;
/// Offset of `vox_units`, four bytes of text.
const UNITS: usize = 56;
/// Offset of `originator`, five numbers in the files of SPM.
const ORIGINATOR: usize = 253;
/// Offset of NIfTI's magic, where Analyze has a number of no importance.
const MAGIC: usize = 344;

/// Whether `header`, which has the size of a NIfTI-1 header, is one of Analyze 7.5.
pub(crate) fn is_analyze(header: &[u8]) -> bool {
    let Some(magic) = header.get(MAGIC..MAGIC + 4) else {
        return false;
    };
    // A damaged NIfTI magic still looks like text.
    let text = magic[..3].iter().all(u8::is_ascii_graphic);
    magic == [0; 4] || (!text && header[REGULAR] == b'r')
}

/// Turns the fields into those of a NIfTI-1 header that says as much.
pub(crate) fn adapt(
    record: &Record<'_>,
    fields: &mut Fields,
    warnings: &mut Vec<String>,
    name: &str,
) -> Result<(), Error> {
    let regular = record.bytes[REGULAR];
    // Some writers leave it empty.
    if !matches!(regular, b'r' | 0) {
        return Err(Error::unsupported(
            name,
            format!(
                "an Analyze 7.5 header whose field 'regular' is '{}', 'r' expected",
                regular.escape_ascii()
            ),
        )
        .at(REGULAR as u64));
    }
    fields.magic = *b"ni1\0";
    fields.intent = 0;
    (fields.qform, fields.sform) = (0, 0);
    fields.intercept = 0.0;
    if fields.slope != 0.0 && fields.slope != 1.0 {
        warnings.push(format!(
            "{name}: funused1 is {}; it is taken as SPM's factor of the values",
            fields.slope
        ));
    }
    // Some writers count an axis of time that they leave empty.
    if fields.dim[4] == 0 {
        fields.dim[4] = 1;
    }
    fields.datatype = match fields.datatype {
        code @ (1 | 2 | 4 | 8 | 16 | 32 | 64 | 128) => code,
        130 => 256,
        132 => 512,
        136 => 768,
        other => {
            return Err(Error::invalid(
                name,
                format!("datatype is {other}, no known code of Analyze 7.5"),
            )
            .at(70));
        }
    };
    warnings.push(format!(
        "{name}: left-right orientation is not stated by Analyze"
    ));
    Ok(())
}

/// Sets what only Analyze says.
pub(crate) fn complete(record: &Record<'_>, header: &mut Header) {
    if header.spacing.is_some() {
        let text = String::from_utf8_lossy(&record.bytes[UNITS..UNITS + 4]);
        let unit = text.trim_matches(['\0', ' ']).parse().unwrap_or_default();
        header.unit = match unit {
            Unit::Unknown => Unit::Millimetre,
            unit => unit,
        };
    }
    let originator: [i16; 3] = std::array::from_fn(|a| record.i16(ORIGINATOR + 2 * a));
    if originator != [0; 3] {
        header.details.push((
            "originator",
            format!("{originator:?}, not used as an origin"),
        ));
    }
}
