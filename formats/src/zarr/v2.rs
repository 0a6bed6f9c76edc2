//! Zarr version 2: `.zarray` and `.zattrs`.
//!
//! In: the metadata of an array. Out: an [`Array`]. Read: C and Fortran order, numbers in either
//! byte order, both separators, the compressors of numcodecs that are general (zlib, gzip, bz2,
//! zstd, lz4, blosc), the filters `delta` and `shuffle`. Refused by name: other codecs and other
//! types.

use serde_json::Value;

use crate::error::Error;
use crate::header::{ByteOrder, DType, Format};
use crate::parsed::voxel_type;
use crate::zarr::array::{Array, Keys};
use crate::zarr::chain::{Chain, Delta, Step};
use crate::zarr::fill::fill_value;
use crate::zarr::json::Document;

/// The array described by a `.zarray`.
pub(crate) fn array(document: &Document, key: &str, attributes: Document) -> Result<Array, Error> {
    check_version(document)?;
    let shape = document.extents("shape", 0)?;
    let grid = document.extents("chunks", 1)?;
    let dtype = dtype(document, "dtype", document.required("dtype")?)?;
    let mut memory: Vec<_> = (0..shape.len()).collect();
    match document.text("order")? {
        "C" => {}
        "F" => memory.reverse(),
        other => {
            return Err(document.invalid(format!("'order' is '{other}', C or F expected")));
        }
    }
    let separator = match document.optional("dimension_separator").map(Value::as_str) {
        None | Some(Some(".")) => '.',
        Some(Some("/")) => '/',
        Some(_) => {
            return Err(document.invalid("'dimension_separator' is neither '.' nor '/'"));
        }
    };
    let mut steps = Vec::new();
    if let Some(compressor) = document.optional("compressor") {
        steps.push(step(document, "compressor", compressor)?);
    }
    if let Some(filters) = document.optional("filters") {
        let list = filters
            .as_array()
            .ok_or_else(|| document.wrong("filters", filters, "a list"))?;
        for filter in list.iter().rev() {
            steps.push(step(document, "filters", filter)?);
        }
    }
    let axes = names(attributes.optional("_ARRAY_DIMENSIONS"), shape.len());
    let array = Array {
        format: Format::Zarr,
        key: key.to_string(),
        shape,
        grid,
        shard: None,
        dtype,
        fill: fill_value(document, dtype)?,
        keys: Keys::Plain { separator },
        memory,
        chain: Chain { steps },
        axes,
        attributes,
    };
    array.check(document)?;
    Ok(array)
}

/// Names of all axes, if the list has them.
pub(crate) fn names(list: Option<&Value>, count: usize) -> Option<Vec<String>> {
    let names: Option<Vec<_>> = list?
        .as_array()?
        .iter()
        .map(|name| name.as_str().map(str::to_string))
        .collect();
    names.filter(|names| names.len() == count)
}

/// Refuses a `zarr_format` other than 2.
pub(crate) fn check_version(document: &Document) -> Result<(), Error> {
    let version = document.required("zarr_format")?;
    if version.as_u64() == Some(2) {
        return Ok(());
    }
    Err(document.unsupported(format!(
        "zarr_format is {version}; 2, or 3 in zarr.json, is read"
    )))
}

/// A type such as `<i2`.
fn dtype(document: &Document, key: &str, value: &Value) -> Result<DType, Error> {
    let Some(text) = value.as_str() else {
        return Err(document.unsupported(format!(
            "'{key}' is {}: structured types are not read",
            super::json::short(value)
        )));
    };
    let not_read = || {
        document.unsupported(format!(
            "'{key}' is '{text}'; b1, i1..i8, u1..u8 and f2..f8 are read"
        ))
    };
    let bytes = text.as_bytes();
    let [order, kind, size @ ..] = bytes else {
        return Err(not_read());
    };
    let size = std::str::from_utf8(size).ok().and_then(|s| s.parse().ok());
    let voxel = size
        .and_then(|size| voxel_type(*kind, size))
        .ok_or_else(not_read)?;
    let byte_order = match order {
        b'<' | b'|' if voxel.bytes() == 1 => ByteOrder::Little,
        b'>' if voxel.bytes() == 1 => ByteOrder::Little,
        b'<' => ByteOrder::Little,
        b'>' => ByteOrder::Big,
        _ => {
            return Err(document.invalid(format!(
                "'{key}' is '{text}': it does not say its byte order, '<' or '>'"
            )));
        }
    };
    Ok(DType { voxel, byte_order })
}

/// A codec of numcodecs.
pub(crate) fn step(document: &Document, key: &str, value: &Value) -> Result<Step, Error> {
    let codec = Document::new(&document.name, value.clone());
    let id = value
        .get("id")
        .and_then(Value::as_str)
        .ok_or_else(|| document.wrong(key, value, "a codec with an 'id'"))?;
    if let Some(step) = compressor(id, &codec) {
        return Ok(step);
    }
    match id {
        "shuffle" => {
            let element = codec.optional("elementsize").and_then(Value::as_u64);
            match element {
                Some(element @ 1..=255) => Ok(Step::Shuffle(element as usize)),
                None => Ok(Step::Shuffle(4)),
                Some(other) => Err(document.invalid(format!(
                    "'elementsize' of the filter shuffle is {other}, 1 to 255 expected"
                ))),
            }
        }
        "delta" => {
            let voxels = dtype(&codec, "dtype", codec.required("dtype")?)?;
            let stored = match codec.optional("astype") {
                Some(stored) => dtype(&codec, "astype", stored)?,
                None => voxels,
            };
            let delta = Delta { voxels, stored };
            if !delta.is_exact() {
                return Err(document.unsupported(format!(
                    "the filter delta from {} to {} is not read",
                    delta.stored, delta.voxels
                )));
            }
            Ok(Step::Delta(delta))
        }
        other => Err(document.unsupported(format!(
            "the codec '{other}' is not read; blosc, zstd, lz4, zlib, gzip, bz2, delta and \
             shuffle are"
        ))),
    }
}

/// A compressor by its name; `None` for one that is not read.
pub(crate) fn compressor(id: &str, codec: &Document) -> Option<Step> {
    Some(match id {
        "zlib" => Step::Zlib,
        "gzip" => Step::Gzip,
        "bz2" => Step::Bzip2,
        "zstd" => Step::Zstd,
        "lz4" => Step::Lz4,
        "blosc" => {
            let inner = codec.optional("cname").and_then(Value::as_str);
            Step::Blosc(inner.unwrap_or("any").to_string())
        }
        _ => return None,
    })
}
