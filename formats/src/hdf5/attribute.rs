//! Attributes: small named values of groups and datasets.
//!
//! In: an object. Out: its attributes that are numbers or texts; others, and those in a heap that
//! are larger than 64 KiB, are left out, for nothing here asks for them.

use super::btree2::Tree2;
use super::file::File;
use super::heap::{FractalHeap, global};
use super::message::{What, attribute};
use super::object::{Message, Object, kind};
use crate::error::{Error, ErrorKind};
use crate::header::{ByteOrder, DType, VoxelType};

/// The values of an attribute.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Values {
    Numbers(Vec<f64>),
    Texts(Vec<String>),
}

/// Texts of an attribute beyond these are left out: nothing asked for here has more than one for
/// each axis.
const MOST_TEXTS: usize = 64;

/// The attributes of an object.
#[derive(Debug, Default)]
pub(super) struct Attributes(Vec<(String, Values)>);

impl Attributes {
    pub(super) fn read(file: &File, object: &Object) -> Result<Self, Error> {
        let mut found = Self::default();
        for message in object.all(file, kind::ATTRIBUTE)? {
            found.add(file, &message)?;
        }
        if let Some(message) = object.first(file, kind::ATTRIBUTE_INFO)? {
            let mut fields = message.fields(file);
            fields.version("an attribute info message", 0)?;
            let flags = fields.u8()?;
            fields.skip(if flags & 1 != 0 { 2 } else { 0 })?;
            if let (Some(heap), Some(names)) = (fields.offset()?, fields.offset()?) {
                let heap = FractalHeap::open(file, heap)?;
                Tree2::open(file, names)?.visit(file, |record| {
                    // An attribute that is shared, or too large for the heap, is left out.
                    let shared = record.get(8).is_some_and(|flags| flags & 2 != 0);
                    let id = record.get(..8).unwrap_or_default();
                    match heap.object(id) {
                        Ok(_) if shared => Ok(()),
                        Ok(body) => {
                            found.add(file, &Message::of(kind::ATTRIBUTE, message.address, body))
                        }
                        Err(e) if e.kind() == ErrorKind::Unsupported => Ok(()),
                        Err(e) => Err(e),
                    }
                })?;
            }
        }
        Ok(found)
    }

    fn add(&mut self, file: &File, message: &Message) -> Result<(), Error> {
        let mut fields = message.fields(file);
        let (name, datatype, space, data) = match attribute(&mut fields, file) {
            Ok(parts) => parts,
            Err(e) if e.kind() == ErrorKind::Unsupported => return Ok(()),
            Err(e) => return Err(e),
        };
        let bytes = datatype.bytes as usize;
        let count = space.count().and_then(|n| usize::try_from(n).ok());
        let data = count
            .and_then(|count| data.get(..count.checked_mul(bytes)?))
            .ok_or_else(|| {
                fields.invalid(format!(
                    "attribute {name} of {:?} values of {bytes} bytes in {} bytes",
                    space.dims,
                    data.len()
                ))
            })?;
        if bytes == 0 {
            return Ok(());
        }
        let values = match datatype.what {
            What::Number(dtype) => Values::Numbers(numbers(dtype, data)),
            What::Text => Values::Texts(data.chunks_exact(bytes).map(text).collect()),
            What::LongText => {
                let mut texts = Vec::new();
                for value in data.chunks_exact(bytes).take(MOST_TEXTS) {
                    let mut fields = file.fields(message.address, value);
                    fields.u32()?;
                    let text = match (fields.offset()?, fields.u32()?) {
                        // Nothing there: an empty text.
                        (None | Some(0), _) => Vec::new(),
                        (Some(address), index) => global(file, address, index)?,
                    };
                    texts.push(self::text(&text));
                }
                Values::Texts(texts)
            }
            What::Other(_) => return Ok(()),
        };
        self.0.push((name, values));
        Ok(())
    }

    fn values(&self, name: &str) -> Option<&Values> {
        self.0
            .iter()
            .find(|(found, _)| found == name)
            .map(|(_, values)| values)
    }

    /// The numbers of an attribute, also where they are written as text.
    pub(super) fn numbers(&self, name: &str) -> Option<Vec<f64>> {
        match self.values(name)? {
            Values::Numbers(numbers) => Some(numbers.clone()),
            Values::Texts(_) => {
                let text = self.text(name)?;
                let words = text.split([' ', ',']).filter(|word| !word.is_empty());
                words.map(|word| word.trim().parse().ok()).collect()
            }
        }
    }

    /// The only number of an attribute.
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        match self.numbers(name)?.as_slice() {
            [number] => Some(*number),
            _ => None,
        }
    }

    /// The texts of an attribute.
    pub(super) fn texts(&self, name: &str) -> Option<Vec<String>> {
        match self.values(name)? {
            Values::Texts(texts) => Some(texts.clone()),
            Values::Numbers(_) => None,
        }
    }

    /// The text of an attribute; one letter a value, as Imaris writes it, is one text.
    pub(super) fn text(&self, name: &str) -> Option<String> {
        let texts = self.texts(name)?;
        let letters = texts.len() > 1 && texts.iter().all(|text| text.len() <= 1);
        (texts.len() == 1 || letters).then(|| texts.concat())
    }
}

/// A text without what fills it up.
fn text(bytes: &[u8]) -> String {
    let text = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).into_owned()
}

/// Values as numbers. Those beyond 2^53 are rounded.
pub(super) fn numbers(dtype: DType, data: &[u8]) -> Vec<f64> {
    data.chunks_exact(dtype.voxel.bytes())
        .map(|value| {
            let mut le = [0; 8];
            for (to, from) in le.iter_mut().zip(value) {
                *to = *from;
            }
            if dtype.byte_order == ByteOrder::Big {
                le[..value.len()].reverse();
            }
            let bits = u64::from_le_bytes(le);
            match dtype.voxel {
                VoxelType::Bool | VoxelType::U8 | VoxelType::U16 | VoxelType::U32 => bits as f64,
                VoxelType::U64 => bits as f64,
                VoxelType::I8 => f64::from(bits as i8),
                VoxelType::I16 => f64::from(bits as i16),
                VoxelType::I32 => f64::from(bits as i32),
                VoxelType::I64 => bits as i64 as f64,
                VoxelType::F16 => half(bits as u16),
                VoxelType::F32 => f64::from(f32::from_bits(bits as u32)),
                VoxelType::F64 => f64::from_bits(bits),
            }
        })
        .collect()
}

/// An IEEE half-precision number.
fn half(bits: u16) -> f64 {
    let mantissa = f64::from(bits & 0x3ff);
    let value = match bits >> 10 & 31 {
        0 => mantissa / f64::from(1 << 24),
        31 if mantissa == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1.0 + mantissa / 1024.0) * 2_f64.powi(i32::from(exponent) - 15),
    };
    if bits & 0x8000 != 0 { -value } else { value }
}
