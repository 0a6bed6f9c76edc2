//! The value of voxels that are not stored.

use serde_json::Value;

use crate::error::Error;
use crate::header::{ByteOrder, DType, VoxelType};
use crate::zarr::json::Document;

/// The bytes of a voxel of the document's `fill_value`, in the type and byte order of `dtype`.
///
/// `null`, which says that such voxels are undefined, gives zeros, as zarr-python reads them.
pub(crate) fn fill_value(document: &Document, dtype: DType) -> Result<[u8; 8], Error> {
    let Some(value) = document.optional("fill_value") else {
        return Ok([0; 8]);
    };
    let bits = bits(value, dtype.voxel).ok_or_else(|| {
        document.wrong(
            "fill_value",
            value,
            &format!("a value of type {}", dtype.voxel),
        )
    })?;
    let count = dtype.voxel.bytes();
    let mut bytes = bits.to_le_bytes();
    if dtype.byte_order == ByteOrder::Big {
        bytes[..count].reverse();
    }
    Ok(bytes)
}

/// The bits of a value as the type stores them; `None` when it is not of the type.
fn bits(value: &Value, voxel: VoxelType) -> Option<u64> {
    match voxel {
        VoxelType::Bool => match value {
            Value::Bool(value) => Some(u64::from(*value)),
            _ => value.as_u64().filter(|value| *value <= 1),
        },
        VoxelType::F16 | VoxelType::F32 | VoxelType::F64 => float_bits(value, voxel),
        _ => {
            // As written by some: a whole number with a point.
            let whole = value.as_f64().filter(|f| f.fract() == 0.0);
            let number = value
                .as_i64()
                .map(i128::from)
                .or_else(|| value.as_u64().map(i128::from))
                .or_else(|| whole.map(|f| f as i128))?;
            let bits = 8 * voxel.bytes() as u32;
            let (least, most) = match voxel {
                VoxelType::U8 | VoxelType::U16 | VoxelType::U32 | VoxelType::U64 => {
                    (0, (1_i128 << bits) - 1)
                }
                _ => (-(1_i128 << (bits - 1)), (1_i128 << (bits - 1)) - 1),
            };
            let mask = u64::MAX >> (64 - bits);
            (least..=most)
                .contains(&number)
                .then_some(number as u64 & mask)
        }
    }
}

fn float_bits(value: &Value, voxel: VoxelType) -> Option<u64> {
    let number = match value {
        Value::String(text) => match text.as_str() {
            "NaN" => f64::NAN,
            "Infinity" => f64::INFINITY,
            "-Infinity" => f64::NEG_INFINITY,
            text => {
                // The bits themselves, for NaNs that are special.
                let digits = text.strip_prefix("0x")?;
                let right = digits.len() == 2 * voxel.bytes();
                return u64::from_str_radix(digits, 16).ok().filter(|_| right);
            }
        },
        _ => value.as_f64()?,
    };
    Some(match voxel {
        VoxelType::F16 => half::f16::from_f64(number).to_bits().into(),
        VoxelType::F32 => (number as f32).to_bits().into(),
        _ => number.to_bits(),
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn values_of_every_type_become_their_bytes() {
        for (value, voxel, expected) in [
            (json!(null), VoxelType::I16, Some(0)),
            (json!(true), VoxelType::Bool, Some(1)),
            (json!(0), VoxelType::Bool, Some(0)),
            (json!(2), VoxelType::Bool, None),
            (json!(-2), VoxelType::I8, Some(0xfe)),
            (json!(-2.0), VoxelType::I16, Some(0xfffe)),
            (json!(128), VoxelType::I8, None),
            (json!(-1), VoxelType::U8, None),
            (json!(u64::MAX), VoxelType::U64, Some(u64::MAX)),
            (json!(i64::MIN), VoxelType::I64, Some(1 << 63)),
            (json!("NaN"), VoxelType::F32, Some(0x7fc0_0000)),
            (json!("-Infinity"), VoxelType::F16, Some(0xfc00)),
            (json!("0x7fc00001"), VoxelType::F32, Some(0x7fc0_0001)),
            (json!("0x7fc00001"), VoxelType::F64, None),
            (json!(1.5), VoxelType::F64, Some(1.5_f64.to_bits())),
            (json!("some"), VoxelType::F64, None),
            (json!("0"), VoxelType::U8, None),
        ] {
            let document = Document::new("a", json!({ "fill_value": value }));
            let found = fill_value(&document, DType::little(voxel)).ok();
            assert_eq!(
                found.map(u64::from_le_bytes),
                expected,
                "{value} as {voxel}"
            );
        }
        let document = Document::new("a", json!({ "fill_value": 1 }));
        let big = fill_value(&document, DType::big(VoxelType::U16)).unwrap();
        assert_eq!(big[..2], [0, 1]);
    }
}
