//! Zarr version 3: `zarr.json`.
//!
//! In: the metadata of an array. Out: an [`Array`]. Read: regular grids, both encodings of keys,
//! the codecs `bytes`, `transpose`, `gzip`, `zstd`, `blosc`, `crc32c` and `sharding_indexed`, and
//! those of numcodecs that version 2 has, under their prefixed names. Refused by name: other
//! codecs, types, grids and extensions, unless the metadata says that an extension need not be
//! understood, and storage transformers. Also refused: codecs behind the sharding codec, and
//! shards within shards, of which no part could be read alone.

use serde_json::Value;

use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, VoxelType};
use crate::zarr::array::{Array, Keys, Shard};
use crate::zarr::chain::{Chain, Step};
use crate::zarr::fill::fill_value;
use crate::zarr::json::{Document, short};
use crate::zarr::v2::{compressor, names};

/// What `zarr.json` of an array may say.
const KNOWN: [&str; 12] = [
    "zarr_format",
    "node_type",
    "shape",
    "data_type",
    "chunk_grid",
    "chunk_key_encoding",
    "fill_value",
    "codecs",
    "attributes",
    "storage_transformers",
    "dimension_names",
    "consolidated_metadata",
];

/// Refuses a `zarr_format` other than 3.
pub(crate) fn check_version(document: &Document) -> Result<(), Error> {
    let version = document.required("zarr_format")?;
    if version.as_u64() == Some(3) {
        return Ok(());
    }
    Err(document.unsupported(format!(
        "zarr_format is {version}; 3, or 2 in .zarray, is read"
    )))
}

/// The attributes of a node.
pub(crate) fn attributes(document: &Document) -> Document {
    let value = document.optional("attributes");
    let value = value.filter(|value| value.is_object()).cloned();
    let empty = || Value::Object(serde_json::Map::new());
    Document::new(&document.name, value.unwrap_or_else(empty))
}

/// The array described by a `zarr.json`.
pub(crate) fn array(document: &Document, key: &str) -> Result<Array, Error> {
    check_extensions(document)?;
    let shape = document.extents("shape", 0)?;
    let axes = shape.len();
    let grid = {
        let (name, configuration) =
            named(document, "chunk_grid", document.required("chunk_grid")?)?;
        if name != "regular" {
            return Err(
                document.unsupported(format!("the chunk grid '{name}' is not read; 'regular' is"))
            );
        }
        configuration.extents("chunk_shape", 1)?
    };
    let keys = keys(document)?;
    let voxel = data_type(document)?;

    let list = document.required("codecs")?;
    let mut codecs = Codecs::parse(document, list, (0..axes).collect(), voxel)?;
    let mut shard = None;
    if let Some(sharding) = codecs.sharding.take() {
        if !codecs.chain.steps.is_empty() {
            return Err(document.unsupported(format!(
                "the codecs {} behind sharding_indexed are not read",
                codecs.chain.describe()
            )));
        }
        let (parsed, inner) = shards(document, &sharding, &codecs.memory, &grid, voxel)?;
        shard = Some(parsed);
        codecs = inner;
    }
    let dtype = DType {
        voxel,
        byte_order: codecs.byte_order,
    };
    let array = Array {
        format: Format::Zarr,
        key: key.to_string(),
        fill: fill_value(document, dtype)?,
        grid,
        shard,
        dtype,
        keys,
        memory: codecs.memory,
        chain: codecs.chain,
        axes: names(document.optional("dimension_names"), axes),
        attributes: attributes(document),
        shape,
    };
    array.check(document)?;
    Ok(array)
}

/// Refuses what would have to be understood and is not.
fn check_extensions(document: &Document) -> Result<(), Error> {
    let keys = document.value.as_object().into_iter().flatten();
    for (key, value) in keys {
        let optional = value.get("must_understand") == Some(&Value::Bool(false));
        if !KNOWN.contains(&key.as_str()) && !optional {
            return Err(document.unsupported(format!(
                "'{key}' is not known, and not marked as something that need not be"
            )));
        }
    }
    match document.optional("storage_transformers") {
        None => Ok(()),
        Some(Value::Array(list)) if list.is_empty() => Ok(()),
        Some(list) => Err(document.unsupported(format!(
            "storage transformers are not read: {}",
            short(list)
        ))),
    }
}

/// The name and the configuration of an extension, which may be its name alone.
fn named(document: &Document, key: &str, value: &Value) -> Result<(String, Document), Error> {
    let (name, configuration) = match value {
        Value::String(name) => (Some(name.as_str()), None),
        _ => (
            value.get("name").and_then(Value::as_str),
            value.get("configuration"),
        ),
    };
    let name = name.ok_or_else(|| document.wrong(key, value, "a name"))?;
    let empty = || Value::Object(serde_json::Map::new());
    let configuration = configuration.cloned().unwrap_or_else(empty);
    Ok((
        name.to_string(),
        Document::new(&document.name, configuration),
    ))
}

fn keys(document: &Document) -> Result<Keys, Error> {
    let value = document.required("chunk_key_encoding")?;
    let (name, configuration) = named(document, "chunk_key_encoding", value)?;
    let separator = match configuration.optional("separator").map(Value::as_str) {
        None => None,
        Some(Some("/")) => Some('/'),
        Some(Some(".")) => Some('.'),
        Some(_) => {
            return Err(document.invalid("the 'separator' of keys is neither '/' nor '.'"));
        }
    };
    match name.as_str() {
        "default" => Ok(Keys::Default {
            separator: separator.unwrap_or('/'),
        }),
        "v2" => Ok(Keys::Plain {
            separator: separator.unwrap_or('.'),
        }),
        other => Err(document.unsupported(format!(
            "the chunk key encoding '{other}' is not read; 'default' and 'v2' are"
        ))),
    }
}

fn data_type(document: &Document) -> Result<VoxelType, Error> {
    let value = document.required("data_type")?;
    let (name, _) = named(document, "data_type", value)?;
    Ok(match name.as_str() {
        "bool" => VoxelType::Bool,
        "int8" => VoxelType::I8,
        "int16" => VoxelType::I16,
        "int32" => VoxelType::I32,
        "int64" => VoxelType::I64,
        "uint8" => VoxelType::U8,
        "uint16" => VoxelType::U16,
        "uint32" => VoxelType::U32,
        "uint64" => VoxelType::U64,
        "float16" => VoxelType::F16,
        "float32" => VoxelType::F32,
        "float64" => VoxelType::F64,
        other => {
            return Err(document.unsupported(format!(
                "the data type '{other}' is not read; bool, int8 to int64, uint8 to uint64 and \
                 float16 to float64 are"
            )));
        }
    })
}

/// A list of codecs, understood.
struct Codecs {
    /// Axes of the array from the slowest to the fastest, after all transpositions.
    memory: Vec<usize>,
    byte_order: ByteOrder,
    /// Of the codec that makes bytes, if that is sharding.
    sharding: Option<Document>,
    chain: Chain,
}

impl Codecs {
    /// `memory` are the axes of the array in the order they come in.
    fn parse(
        document: &Document,
        list: &Value,
        mut memory: Vec<usize>,
        voxel: VoxelType,
    ) -> Result<Self, Error> {
        let list = list
            .as_array()
            .ok_or_else(|| document.wrong("codecs", list, "a list"))?;
        let mut byte_order = None;
        let mut sharding = None;
        let mut steps = Vec::new();
        for codec in list {
            let (name, configuration) = named(document, "codecs", codec)?;
            let is_array = byte_order.is_none() && sharding.is_none();
            match name.as_str() {
                "transpose" if is_array => {
                    memory = transposed(document, &configuration, &memory)?;
                }
                "bytes" if is_array => byte_order = Some(endian(&configuration, voxel)?),
                "sharding_indexed" if is_array => sharding = Some(configuration),
                "transpose" | "bytes" | "sharding_indexed" => {
                    return Err(document.invalid(format!("the codec '{name}' is out of order")));
                }
                _ if is_array => {
                    return Err(document.unsupported(format!(
                        "the codec '{name}' is not read; transpose, bytes and sharding_indexed are"
                    )));
                }
                name => steps.push(step(document, name, &configuration)?),
            }
        }
        if byte_order.is_none() && sharding.is_none() {
            return Err(document.invalid("no codec makes bytes: 'bytes' expected"));
        }
        steps.reverse();
        Ok(Self {
            memory,
            byte_order: byte_order.unwrap_or_default(),
            sharding,
            chain: Chain { steps },
        })
    }
}

/// A codec from bytes to bytes.
fn step(document: &Document, name: &str, configuration: &Document) -> Result<Step, Error> {
    let numcodecs = name.strip_prefix("numcodecs.");
    let step = match (name, numcodecs) {
        ("crc32c", _) => Some(Step::Crc32c),
        ("gzip" | "zstd" | "blosc", _) => compressor(name, configuration),
        (_, Some("shuffle")) => {
            let mut value = configuration.value.clone();
            if let Some(object) = value.as_object_mut() {
                object.insert("id".into(), "shuffle".into());
            }
            return super::v2::step(document, "codecs", &value);
        }
        (_, Some(id)) => compressor(id, configuration),
        _ => None,
    };
    step.ok_or_else(|| {
        document.unsupported(format!(
            "the codec '{name}' is not read; gzip, zstd, blosc and crc32c are"
        ))
    })
}

fn endian(configuration: &Document, voxel: VoxelType) -> Result<ByteOrder, Error> {
    match configuration.optional("endian").map(Value::as_str) {
        Some(Some("little")) => Ok(ByteOrder::Little),
        Some(Some("big")) if voxel.bytes() > 1 => Ok(ByteOrder::Big),
        Some(Some("big")) => Ok(ByteOrder::Little),
        None if voxel.bytes() == 1 => Ok(ByteOrder::Little),
        None => Err(configuration.invalid("the codec 'bytes' does not say its 'endian'")),
        Some(_) => Err(configuration.invalid("'endian' is neither 'little' nor 'big'")),
    }
}

/// The axes in the order that a transposition gives them.
fn transposed(
    document: &Document,
    configuration: &Document,
    memory: &[usize],
) -> Result<Vec<usize>, Error> {
    let order = configuration.required("order")?;
    let wrong = || {
        document.wrong(
            "order",
            order,
            &format!("each of the axes 0 to {} once", memory.len().max(1) - 1),
        )
    };
    let list = match order {
        Value::String(text) if text == "C" => return Ok(memory.to_vec()),
        Value::String(text) if text == "F" => {
            return Ok(memory.iter().rev().copied().collect());
        }
        _ => order.as_array().ok_or_else(wrong)?,
    };
    let mut out = Vec::with_capacity(memory.len());
    for item in list {
        let axis = item.as_u64().and_then(|axis| usize::try_from(axis).ok());
        let axis = axis.and_then(|axis| memory.get(axis)).ok_or_else(wrong)?;
        if out.contains(axis) {
            return Err(wrong());
        }
        out.push(*axis);
    }
    if out.len() != memory.len() {
        return Err(wrong());
    }
    Ok(out)
}

/// The sharding codec, and the codecs inside. `memory` are the axes of the array in the order
/// that the codec sees.
fn shards(
    document: &Document,
    configuration: &Document,
    memory: &[usize],
    grid: &[u64],
    voxel: VoxelType,
) -> Result<(Shard, Codecs), Error> {
    let seen = configuration.extents("chunk_shape", 1)?;
    let mut inner = vec![1; grid.len()];
    let mut count = vec![1; grid.len()];
    if seen.len() != grid.len() || memory.len() != grid.len() {
        return Err(document.invalid(format!(
            "chunks of {} axes in shards of {}",
            seen.len(),
            grid.len()
        )));
    }
    for (&axis, &extent) in memory.iter().zip(&seen) {
        if !grid[axis].is_multiple_of(extent) {
            return Err(document.invalid(format!(
                "shards of {grid:?} are not whole chunks of {seen:?}"
            )));
        }
        inner[axis] = extent;
        count[axis] = grid[axis] / extent;
    }
    let index = match configuration.optional("index_codecs") {
        None => None,
        Some(list) => Some(Codecs::parse(document, list, Vec::new(), VoxelType::U64)?),
    };
    let (big_endian, checksum) = match &index {
        None => (false, true),
        Some(index) => match index.chain.steps[..] {
            _ if index.sharding.is_some() => {
                return Err(document.invalid("the index of a shard is itself sharded"));
            }
            [] => (index.byte_order == ByteOrder::Big, false),
            [Step::Crc32c] => (index.byte_order == ByteOrder::Big, true),
            _ => {
                return Err(document.unsupported(format!(
                    "the index of a shard with the codecs {} is not read; crc32c is",
                    index.chain.describe()
                )));
            }
        },
    };
    let at_end = match configuration.optional("index_location").map(Value::as_str) {
        None | Some(Some("end")) => true,
        Some(Some("start")) => false,
        Some(_) => {
            return Err(document.invalid("'index_location' is neither 'start' nor 'end'"));
        }
    };
    let list = configuration.required("codecs")?;
    let codecs = Codecs::parse(document, list, memory.to_vec(), voxel)?;
    if codecs.sharding.is_some() {
        return Err(document.unsupported("shards within shards are not read"));
    }
    let shard = Shard {
        inner,
        count,
        order: memory.to_vec(),
        big_endian,
        checksum,
        at_end,
    };
    Ok((shard, codecs))
}
