//! N5: `attributes.json`, and the header of its blocks.
//!
//! In: the attributes of a dataset. Out: an [`Array`], its axes turned round, since N5 names x
//! first. A block begins with a header, big-endian: mode (2 bytes), number of axes (2), extents
//! (4 each); blocks at the border are smaller than the others, and those that are not there are 0.
//! Read: all whole and floating types, the compressions raw, gzip (also as zlib), bzip2, lz4,
//! blosc and zstd. Refused by name: xz, jpeg, and blocks of varying length.

use serde_json::Value;

use crate::error::Error;
use crate::header::{DType, Format, VoxelType};
use crate::zarr::array::{Array, Keys, product};
use crate::zarr::chain::{Chain, Step};
use crate::zarr::json::Document;
use crate::zarr::space::Space;

/// The most bytes of the header of a block: that of 32 axes.
pub(crate) const HEADER_MOST: u64 = 4 + 4 * 32;

/// The dataset described by attributes; `None` when they are those of a group.
pub(crate) fn array(document: &Document, key: &str) -> Result<Option<Array>, Error> {
    if document.optional("dimensions").is_none() || document.optional("dataType").is_none() {
        return Ok(None);
    }
    let turned = |mut extents: Vec<u64>| {
        extents.reverse();
        extents
    };
    let shape = turned(document.extents("dimensions", 0)?);
    let grid = turned(document.extents("blockSize", 1)?);
    let voxel = match document.text("dataType")? {
        "uint8" => VoxelType::U8,
        "uint16" => VoxelType::U16,
        "uint32" => VoxelType::U32,
        "uint64" => VoxelType::U64,
        "int8" => VoxelType::I8,
        "int16" => VoxelType::I16,
        "int32" => VoxelType::I32,
        "int64" => VoxelType::I64,
        "float32" => VoxelType::F32,
        "float64" => VoxelType::F64,
        other => {
            return Err(document.unsupported(format!(
                "the data type '{other}' is not read; whole and floating numbers are"
            )));
        }
    };
    let steps = compression(document)?.into_iter().collect();
    let array = Array {
        format: Format::N5,
        key: key.to_string(),
        memory: (0..shape.len()).collect(),
        shape,
        grid,
        shard: None,
        dtype: DType::big(voxel),
        fill: [0; 8],
        keys: Keys::N5,
        chain: Chain { steps },
        axes: None,
        attributes: document.clone(),
    };
    array.check(document)?;
    Ok(Some(array))
}

fn compression(document: &Document) -> Result<Option<Step>, Error> {
    // As written by the first version.
    let old = document.optional("compressionType");
    let value = match document.optional("compression") {
        Some(value) => value,
        None => old.ok_or_else(|| document.invalid("has no 'compression'"))?,
    };
    let kind = value.get("type").unwrap_or(value).as_str();
    let kind = kind.ok_or_else(|| document.wrong("compression", value, "a 'type'"))?;
    Ok(Some(match kind {
        "raw" => return Ok(None),
        "gzip" if value.get("useZlib") == Some(&Value::Bool(true)) => Step::Zlib,
        "gzip" => Step::Gzip,
        "bzip2" => Step::Bzip2,
        "lz4" => Step::Lz4Java,
        "zstd" => Step::Zstd,
        "blosc" => {
            let inner = value.get("cname").and_then(Value::as_str);
            Step::Blosc(inner.unwrap_or("any").to_string())
        }
        other => {
            return Err(document.unsupported(format!(
                "the compression '{other}' is not read; raw, gzip, bzip2, lz4, blosc and zstd are"
            )));
        }
    }))
}

/// Takes the header off a block and gives the block's shape, in the order of the array's axes:
/// that of the grid, or at least what of it lies in the array.
pub(crate) fn block(
    name: &str,
    data: &mut Vec<u8>,
    array: &Array,
    place: &[u64],
) -> Result<Vec<u64>, Error> {
    let chunk = &array.grid;
    let short = |found: usize| {
        Error::invalid(
            name,
            format!("the header of the block ends early: the object has {found} bytes"),
        )
    };
    let Some(&[m0, m1, a0, a1]) = data.first_chunk::<4>() else {
        return Err(short(data.len()));
    };
    let (mode, axes) = (u16::from_be_bytes([m0, m1]), u16::from_be_bytes([a0, a1]));
    if mode != 0 {
        return Err(Error::unsupported(
            name,
            format!("blocks of mode {mode} (varying length, or an object) are not read"),
        ));
    }
    if usize::from(axes) != chunk.len() {
        return Err(Error::invalid(
            name,
            format!("a block of {axes} axes, {} expected", chunk.len()),
        )
        .at(2));
    }
    let end = 4 + 4 * chunk.len();
    let extents = data.get(4..end).ok_or_else(|| short(data.len()))?;
    let (extents, _) = extents.as_chunks::<4>();
    let shape: Vec<_> = extents
        .iter()
        .rev()
        .map(|extent| u64::from(u32::from_be_bytes(*extent)))
        .collect();
    let fits = (0..shape.len()).all(|axis| {
        let most = chunk[axis];
        let there = array.shape[axis].saturating_sub(place[axis].saturating_mul(most));
        (there.min(most)..=most).contains(&shape[axis])
    });
    if !fits || product(&shape).is_none() {
        return Err(Error::invalid(
            name,
            format!("a block of {shape:?} in a grid of blocks of {chunk:?} (slowest axis first)"),
        )
        .at(4));
    }
    data.drain(..end);
    Ok(shape)
}

/// The number of a level such as `s0`.
pub(crate) fn level(name: &str) -> Option<u32> {
    let digits = name.strip_prefix('s')?;
    let plain = digits == "0" || !digits.starts_with('0');
    digits.parse().ok().filter(|_| plain)
}

/// What the attributes of a dataset, and those of the groups around it, nearest first, say of
/// its place in the world.
pub(crate) fn space(array: &Array, around: &[Document]) -> Space {
    let axes = array.shape.len();
    let own = &array.attributes;
    let mut space = Space::new(axes);
    if let Some(transform) = own.optional("transform") {
        cosem(transform, axes, &mut space);
        if space.scale.is_some() {
            return space;
        }
    }
    let all = || std::iter::once(own).chain(around);
    for document in all() {
        let pixel = document.optional("pixelResolution");
        let list = match pixel {
            Some(Value::Object(pixel)) => pixel.get("dimensions"),
            Some(list) => Some(list),
            None => document.optional("resolution"),
        };
        let Some(scale) = list.and_then(|list| numbers(list, axes)) else {
            continue;
        };
        let unit = pixel
            .and_then(|pixel| pixel.get("unit"))
            .or_else(|| document.optional("units"))
            .or_else(|| document.optional("unit"));
        space.units = match unit {
            Some(Value::String(unit)) => vec![Some(unit.clone()); axes],
            Some(Value::Array(units)) if units.len() == axes => units
                .iter()
                .rev()
                .map(|unit| unit.as_str().map(str::to_string))
                .collect(),
            _ => vec![None; axes],
        };
        space.scale = Some(scale);
        break;
    }
    if let (Some(scale), Some(factors)) = (&mut space.scale, factors(array, around)) {
        for (axis, factor) in factors.iter().enumerate() {
            // The middle of the voxels that were averaged.
            space.translation[axis] = scale[axis] * (factor - 1.0) / 2.0;
            scale[axis] *= factor;
        }
    }
    space
}

/// How many voxels of the finest level a voxel stands for.
fn factors(array: &Array, around: &[Document]) -> Option<Vec<f64>> {
    let axes = array.shape.len();
    if let Some(own) = array.attributes.optional("downsamplingFactors") {
        return numbers(own, axes);
    }
    let level = level(array.key.rsplit('/').next()?)?;
    let group = around.first()?;
    let list = group
        .optional("downsamplingFactors")
        .or_else(|| group.optional("scales"))?;
    numbers(list.get(usize::try_from(level).ok()?)?, axes)
}

/// Numbers, x first, turned into the order of the array's axes.
fn numbers(list: &Value, axes: usize) -> Option<Vec<f64>> {
    let list = list.as_array()?;
    // Resolutions often have three numbers where the array has a fourth axis.
    if list.len() > axes || list.len() < 3.min(axes) {
        return None;
    }
    let mut numbers = list.iter().map(Value::as_f64).collect::<Option<Vec<_>>>()?;
    numbers.resize(axes, 1.0);
    numbers.reverse();
    Some(numbers)
}

/// The `transform` of COSEM's datasets, whose axes are z, y, x unless its `order` is F.
fn cosem(transform: &Value, axes: usize, space: &mut Space) {
    let fortran = transform.get("order").and_then(Value::as_str) == Some("F");
    let list = |key: &str| {
        let list = transform.get(key)?.as_array()?;
        let mut list = list.clone();
        if fortran {
            list.reverse();
        }
        (list.len() == axes).then_some(list)
    };
    let floats = |key: &str| {
        list(key)?
            .iter()
            .map(Value::as_f64)
            .collect::<Option<Vec<_>>>()
    };
    let texts = |key: &str| {
        list(key)?
            .iter()
            .map(|text| text.as_str().map(str::to_string))
            .collect::<Option<Vec<_>>>()
    };
    space.scale = floats("scale");
    if let Some(translation) = floats("translate") {
        space.translation = translation;
    }
    if let Some(units) = texts("units") {
        space.units = units.into_iter().map(Some).collect();
    }
    space.axes = texts("axes");
}
