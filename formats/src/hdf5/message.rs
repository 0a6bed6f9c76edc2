//! The messages of a dataset: its extents, type, layout, filters and fill value.
//!
//! In: the fields of a message. Out: what it says. What is well-formed but of no use for voxels
//! (texts, compound values, virtual datasets) comes out as a name, for whoever lists or refuses
//! it.

use super::file::{Fields, File};
use super::object::{Message, Object, kind, shared};
use crate::error::Error;
use crate::header::{ByteOrder, DType, VoxelType};

/// Most dimensions of a dataset.
const MOST_RANK: usize = 32;

/// The extents of a dataset or attribute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Dataspace {
    pub(super) dims: Vec<u64>,
    /// What they may grow to; `None` for no limit.
    pub(super) most: Vec<Option<u64>>,
    /// Whether there is not even a single value.
    null: bool,
}

impl Dataspace {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Error> {
        let version = fields.u8()?;
        let rank = usize::from(fields.u8()?);
        let flags = fields.u8()?;
        let null = match version {
            1 => {
                fields.skip(5)?;
                false
            }
            2 => fields.u8()? == 2,
            _ => return Err(fields.unsupported(format!("version {version} of a dataspace"))),
        };
        if rank > MOST_RANK {
            return Err(fields.invalid(format!("a dataset of {rank} dimensions")));
        }
        let lengths = (0..rank).map(|_| fields.length());
        let dims = lengths.collect::<Result<Vec<_>, _>>()?;
        let most = if flags & 1 != 0 {
            let limits = (0..rank).map(|_| fields.limit());
            limits.collect::<Result<_, _>>()?
        } else {
            dims.iter().copied().map(Some).collect()
        };
        Ok(Self { dims, most, null })
    }

    /// Number of values, if it fits.
    pub(super) fn count(&self) -> Option<u64> {
        if self.null {
            return Some(0);
        }
        self.dims.iter().try_fold(1_u64, |n, d| n.checked_mul(*d))
    }
}

/// The type of a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Datatype {
    /// Bytes of a value.
    pub(super) bytes: u32,
    pub(super) what: What,
}

/// What a value is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum What {
    /// A number that can be a voxel.
    Number(DType),
    /// A text of fixed length.
    Text,
    /// A text in the global heap.
    LongText,
    /// Something else, by name.
    Other(&'static str),
}

impl What {
    /// What the values are, in words.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Number(_) => "numbers",
            Self::Text | Self::LongText => "texts",
            Self::Other(what) => what,
        }
    }
}

impl Datatype {
    /// The type of a dataset, which may be kept with another object.
    pub(super) fn of(file: &File, object: &Object) -> Result<Option<Self>, Error> {
        let message = object.first(file, kind::DATATYPE)?;
        message
            .map(|message| Self::read(&mut message.fields(file)))
            .transpose()
    }

    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Error> {
        let class = fields.u8()?;
        let bits = [fields.u8()?, fields.u8()?, fields.u8()?];
        let bytes = fields.u32()?;
        let order = match bits[0] & 1 {
            0 => ByteOrder::Little,
            _ => ByteOrder::Big,
        };
        let what = match class & 15 {
            0 | 4 => integer(fields, bytes, class & 15 == 0 && bits[0] & 8 != 0, order)?,
            1 => float(fields, bytes, bits, order)?,
            2 => What::Other("times"),
            3 => What::Text,
            5 => What::Other("opaque values"),
            6 => What::Other("compound values"),
            7 => What::Other("references"),
            8 => enumeration(fields, class >> 4, u16::from_le_bytes([bits[0], bits[1]]))?,
            9 if bits[0] & 15 == 1 => What::LongText,
            9 => What::Other("lists of variable length"),
            10 => What::Other("arrays"),
            11 => What::Other("complex numbers"),
            _ => What::Other("values of an unknown type"),
        };
        Ok(Self { bytes, what })
    }
}

fn integer(
    fields: &mut Fields<'_>,
    bytes: u32,
    signed: bool,
    byte_order: ByteOrder,
) -> Result<What, Error> {
    let offset = fields.u16()?;
    let precision = fields.u16()?;
    if offset != 0 || u32::from(precision) != bytes.saturating_mul(8) {
        return Ok(What::Other("integers that do not fill their bytes"));
    }
    let voxel = match (bytes, signed) {
        (1, false) => VoxelType::U8,
        (1, true) => VoxelType::I8,
        (2, false) => VoxelType::U16,
        (2, true) => VoxelType::I16,
        (4, false) => VoxelType::U32,
        (4, true) => VoxelType::I32,
        (8, false) => VoxelType::U64,
        (8, true) => VoxelType::I64,
        _ => return Ok(What::Other("integers of an unusual size")),
    };
    Ok(What::Number(DType { voxel, byte_order }))
}

fn float(
    fields: &mut Fields<'_>,
    bytes: u32,
    bits: [u8; 3],
    byte_order: ByteOrder,
) -> Result<What, Error> {
    let offset = fields.u16()?;
    let precision = u32::from(fields.u16()?);
    let parts = [fields.u8()?, fields.u8()?, fields.u8()?, fields.u8()?];
    let bias = fields.u32()?;
    // Where exponent and mantissa are, how many bits they have, the bias, where the sign is.
    let voxel = match (bytes, parts, bias, bits[1]) {
        (2, [10, 5, 0, 10], 15, 15) => VoxelType::F16,
        (4, [23, 8, 0, 23], 127, 31) => VoxelType::F32,
        (8, [52, 11, 0, 52], 1023, 63) => VoxelType::F64,
        _ => return Ok(What::Other("floating-point numbers that are not IEEE 754")),
    };
    // The first bit of the mantissa is implied; the order of bytes is not the VAX's.
    if offset != 0 || precision != 8 * bytes || bits[0] & 0x70 != 0x20 {
        return Ok(What::Other("floating-point numbers that are not IEEE 754"));
    }
    Ok(What::Number(DType { voxel, byte_order }))
}

/// An enumeration is its integers; h5py's `FALSE` and `TRUE` are a `bool`.
fn enumeration(fields: &mut Fields<'_>, version: u8, count: u16) -> Result<What, Error> {
    let base = Datatype::read(fields)?;
    let mut names = Vec::new();
    for _ in 0..count.min(3) {
        let rest = fields.clone().take(fields.left())?;
        let length = rest
            .iter()
            .position(|byte| *byte == 0)
            .unwrap_or(rest.len());
        names.push(rest[..length].to_vec());
        let whole = length + 1;
        // Names of old versions fill up to eight bytes.
        fields.skip(if version < 3 {
            whole.div_ceil(8) * 8
        } else {
            whole
        })?;
    }
    let values = fields.clone().take(usize::from(count).min(fields.left()))?;
    let boolean = names == [b"FALSE".to_vec(), b"TRUE".to_vec()] && values == [0, 1];
    Ok(match base.what {
        What::Number(dtype) if boolean && base.bytes == 1 => What::Number(DType {
            voxel: VoxelType::Bool,
            ..dtype
        }),
        what => what,
    })
}

/// How the values of a dataset are stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Layout {
    /// In the object header: where, and how many bytes.
    Compact { address: u64, bytes: u64 },
    /// One behind the other, if they were ever written.
    Contiguous { address: Option<u64> },
    /// In chunks.
    Chunked(Chunking),
    /// In other datasets.
    Virtual,
}

/// Chunks of a dataset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Chunking {
    /// Extents of a chunk.
    pub(super) dims: Vec<u64>,
    pub(super) kind: ChunkIndex,
    /// Where the index is, if a chunk was ever written.
    pub(super) address: Option<u64>,
    /// Whether chunks that pass the end of the dataset are not filtered.
    pub(super) edges_unfiltered: bool,
}

impl Chunking {
    /// Chunks that were never written.
    pub(super) fn empty(dims: Vec<u64>) -> Self {
        Self {
            dims,
            kind: ChunkIndex::Implicit,
            address: None,
            edges_unfiltered: false,
        }
    }
}

/// How chunks are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ChunkIndex {
    Tree1,
    /// There is one; with filters, its bytes and those it went without.
    Single(Option<(u64, u32)>),
    Implicit,
    FixedArray,
    ExtensibleArray,
    Tree2,
}

impl Layout {
    pub(super) fn read(message: &Message, file: &File) -> Result<Self, Error> {
        let mut fields = message.fields(file);
        let version = fields.u8()?;
        match version {
            1 | 2 => Self::read_v1(&mut fields, file),
            3..=5 => Self::read_v3(&mut fields, version, file),
            _ => Err(fields.unsupported(format!("version {version} of a layout"))),
        }
    }

    /// Where the rest of the message is, which holds a compact dataset.
    fn compact(fields: &Fields<'_>, file: &File, bytes: u64) -> Result<Self, Error> {
        if bytes > fields.left() as u64 {
            return Err(fields.invalid(format!(
                "a compact dataset of {bytes} bytes in a message with {} left",
                fields.left()
            )));
        }
        let address = fields.position().saturating_sub(file.place(0));
        Ok(Self::Compact { address, bytes })
    }

    fn read_v1(fields: &mut Fields<'_>, file: &File) -> Result<Self, Error> {
        let rank = usize::from(fields.u8()?);
        let class = fields.u8()?;
        fields.skip(5)?;
        let address = if class == 0 { None } else { fields.offset()? };
        if rank > MOST_RANK + 1 {
            return Err(fields.invalid(format!("a layout of {rank} dimensions")));
        }
        let mut dims = Vec::new();
        for _ in 0..rank {
            dims.push(u64::from(fields.u32()?));
        }
        match class {
            0 => {
                let bytes = u64::from(fields.u32()?);
                Self::compact(fields, file, bytes)
            }
            1 => Ok(Self::Contiguous { address }),
            2 => {
                // Behind the extents, the bytes of a value.
                dims.pop();
                Ok(Self::Chunked(Chunking {
                    dims,
                    kind: ChunkIndex::Tree1,
                    address,
                    edges_unfiltered: false,
                }))
            }
            _ => Err(fields.unsupported(format!("layout class {class}"))),
        }
    }

    fn read_v3(fields: &mut Fields<'_>, version: u8, file: &File) -> Result<Self, Error> {
        let class = fields.u8()?;
        match (class, version) {
            (0, _) => {
                let bytes = u64::from(fields.u16()?);
                Self::compact(fields, file, bytes)
            }
            (1, _) => Ok(Self::Contiguous {
                address: fields.offset()?,
            }),
            (2, 3) => {
                let rank = usize::from(fields.u8()?);
                let address = fields.offset()?;
                let mut dims = Self::extents(fields, rank, 4)?;
                dims.pop();
                Ok(Self::Chunked(Chunking {
                    dims,
                    kind: ChunkIndex::Tree1,
                    address,
                    edges_unfiltered: false,
                }))
            }
            (2, _) => {
                let flags = fields.u8()?;
                let rank = usize::from(fields.u8()?);
                let width = usize::from(fields.u8()?);
                if !(1..=8).contains(&width) {
                    return Err(fields.invalid(format!("extents of {width} bytes")));
                }
                let mut dims = Self::extents(fields, rank, width)?;
                dims.pop();
                let kind = match fields.u8()? {
                    1 if flags & 2 != 0 => {
                        let bytes = fields.length()?;
                        ChunkIndex::Single(Some((bytes, fields.u32()?)))
                    }
                    1 => ChunkIndex::Single(None),
                    2 => ChunkIndex::Implicit,
                    3 => {
                        fields.skip(1)?;
                        ChunkIndex::FixedArray
                    }
                    4 => {
                        fields.skip(5)?;
                        ChunkIndex::ExtensibleArray
                    }
                    5 => {
                        fields.skip(6)?;
                        ChunkIndex::Tree2
                    }
                    other => {
                        return Err(fields.unsupported(format!("chunk index type {other}")));
                    }
                };
                Ok(Self::Chunked(Chunking {
                    dims,
                    kind,
                    address: fields.offset()?,
                    edges_unfiltered: flags & 1 != 0,
                }))
            }
            (3, _) => Ok(Self::Virtual),
            _ => Err(fields.unsupported(format!("layout class {class}"))),
        }
    }

    fn extents(fields: &mut Fields<'_>, rank: usize, width: usize) -> Result<Vec<u64>, Error> {
        if rank > MOST_RANK + 1 {
            return Err(fields.invalid(format!("a layout of {rank} dimensions")));
        }
        (0..rank).map(|_| fields.uint(width)).collect()
    }
}

/// A step that chunks went through when they were written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Filter {
    pub(super) id: u16,
    pub(super) values: Vec<u32>,
}

/// The filters of a dataset, in the order of writing.
pub(super) fn filters(message: &Message, file: &File) -> Result<Vec<Filter>, Error> {
    let mut fields = message.fields(file);
    let version = fields.u8()?;
    let count = fields.u8()?;
    match version {
        1 => fields.skip(6)?,
        2 => {}
        _ => return Err(fields.unsupported(format!("version {version} of filters"))),
    }
    let mut filters = Vec::new();
    for _ in 0..count {
        let id = fields.u16()?;
        let name_bytes = match version {
            2 if id < 256 => 0,
            _ => usize::from(fields.u16()?),
        };
        fields.skip(2)?;
        let values = fields.u16()?;
        fields.skip(if version == 1 {
            name_bytes.div_ceil(8) * 8
        } else {
            name_bytes
        })?;
        let filter = Filter {
            id,
            values: (0..values)
                .map(|_| fields.u32())
                .collect::<Result<_, _>>()?,
        };
        if version == 1 && values % 2 == 1 {
            fields.skip(4)?;
        }
        filters.push(filter);
    }
    Ok(filters)
}

/// The value of voxels that were never written, as bytes; 0 if the file does not say.
pub(super) fn fill(file: &File, object: &Object, bytes: usize) -> Result<[u8; 8], Error> {
    let mut value = [0; 8];
    let found = if let Some(message) = object.first(file, kind::FILL)? {
        let mut fields = message.fields(file);
        let version = fields.u8()?;
        let defined = match version {
            1 | 2 => {
                fields.skip(2)?;
                fields.u8()? != 0 || version == 1
            }
            3 => fields.u8()? & 0x20 != 0,
            _ => return Err(fields.unsupported(format!("version {version} of a fill value"))),
        };
        if defined {
            sized(&mut fields)?
        } else {
            Vec::new()
        }
    } else if let Some(message) = object.first(file, kind::OLD_FILL)? {
        sized(&mut message.fields(file))?
    } else {
        Vec::new()
    };
    if found.len() == bytes && bytes <= 8 {
        value[..bytes].copy_from_slice(&found);
    }
    Ok(value)
}

/// A number of bytes, and the bytes.
fn sized(fields: &mut Fields<'_>) -> Result<Vec<u8>, Error> {
    // Nothing at all stands for no value in old files.
    if fields.left() < 4 {
        return Ok(Vec::new());
    }
    let count = usize::try_from(fields.u32()?).unwrap_or(usize::MAX);
    // -1 stands for "undefined".
    if count == u32::MAX as usize {
        return Ok(Vec::new());
    }
    Ok(fields.take(count)?.to_vec())
}

/// The parts of an attribute message: its name, type, extents, and the fields of its values.
pub(super) fn attribute<'a>(
    fields: &mut Fields<'a>,
    file: &File,
) -> Result<(String, Datatype, Dataspace, &'a [u8]), Error> {
    let version = fields.u8()?;
    let flags = fields.u8()?;
    if !(1..=3).contains(&version) {
        return Err(fields.unsupported(format!("version {version} of an attribute")));
    }
    let sizes = [fields.u16()?, fields.u16()?, fields.u16()?].map(usize::from);
    fields.skip(if version == 3 { 1 } else { 0 })?;
    let mut part = |size: usize| -> Result<(u64, &'a [u8]), Error> {
        let address = fields.position().saturating_sub(file.place(0));
        let bytes = fields.take(size)?;
        if version == 1 {
            fields.skip((8 - size % 8) % 8)?;
        }
        Ok((address, bytes))
    };
    let (_, name) = part(sizes[0])?;
    let (type_address, type_bytes) = part(sizes[1])?;
    let (space_address, space_bytes) = part(sizes[2])?;
    let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
    let datatype = read_or_shared(
        file,
        type_address,
        type_bytes,
        kind::DATATYPE,
        flags & 1 != 0,
    )?;
    let dataspace = read_or_shared(
        file,
        space_address,
        space_bytes,
        kind::DATASPACE,
        flags & 2 != 0,
    )?;
    Ok((
        String::from_utf8_lossy(name).into_owned(),
        Datatype::read(&mut datatype.fields(file))?,
        Dataspace::read(&mut dataspace.fields(file))?,
        fields.take(fields.left())?,
    ))
}

fn read_or_shared(
    file: &File,
    address: u64,
    bytes: &[u8],
    kind: u16,
    is_shared: bool,
) -> Result<Message, Error> {
    if is_shared {
        return shared(&mut file.fields(address, bytes), kind, file);
    }
    Ok(Message::of(kind, address, bytes.to_vec()))
}
