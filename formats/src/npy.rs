//! NumPy `.npy` files, format 1.0, 2.0 and 3.0.
//!
//! In: magic, version, length and text of the header, and voxels behind it. Out: a header; the
//! array's axes are (z, y, x), so the last one is x. C order is the canonical order, Fortran
//! order stores z fastest. Guaranteed: the header text is parsed as a literal, never evaluated,
//! and nothing is unpickled. Refused: complex, structured, text and object types, and any number
//! of axes but three. No spacing is stored in this format.

use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header};
use crate::input::Input;
use crate::npy::literal::Literal;
use crate::order::AxisOrder;
use crate::parsed::{Context, Parsed, voxel_type};

mod literal;

pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";

/// A header of a plain array takes about 100 bytes. The limit keeps a wrong length from being
/// allocated, and leaves room for the padding some writers reserve.
const MOST_HEADER_BYTES: u64 = 1 << 20;

pub(crate) fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let name = context.name;
    let lead = context.header_bytes(input, MAGIC.len() + 2)?;
    if !lead.starts_with(MAGIC) {
        return Err(Error::invalid(name, "does not start with the NumPy magic").at(0));
    }
    let (major, minor) = (lead[6], lead[7]);
    let header_bytes = match major {
        1 => {
            let b = context.header_bytes(input, 2)?;
            u64::from(u16::from_le_bytes([b[0], b[1]]))
        }
        2 | 3 => {
            let b = context.header_bytes(input, 4)?;
            u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        }
        _ => {
            return Err(Error::unsupported(
                name,
                format!(".npy version {major}.{minor} found, 1.0, 2.0 or 3.0 expected"),
            )
            .at(6));
        }
    };
    if header_bytes > MOST_HEADER_BYTES {
        return Err(Error::invalid(
            name,
            format!("the header claims {header_bytes} bytes; a plain array needs about 100"),
        )
        .at(8));
    }
    let start = input.position();
    let count = usize::try_from(header_bytes).unwrap_or(usize::MAX);
    let text = context.header_bytes(input, count)?;
    let invalid = |message: String| Error::invalid(name, message).at(start);
    let text = String::from_utf8(text)
        .map_err(|_| invalid("the header is neither ASCII nor UTF-8".into()))?;
    let dict = literal::parse(&text).map_err(|(at, message)| {
        Error::invalid(
            name,
            format!("the header is not a plain literal: {message}"),
        )
        .at(start + at as u64)
    })?;

    let Literal::Dict(entries) = dict else {
        return Err(invalid("the header is not a dictionary".into()));
    };
    let (mut descr, mut fortran, mut shape) = (None, None, None);
    for (key, value) in entries {
        let slot = match &key {
            Literal::Text(key) if key == "descr" => &mut descr,
            Literal::Text(key) if key == "fortran_order" => &mut fortran,
            Literal::Text(key) if key == "shape" => &mut shape,
            other => return Err(invalid(format!("the header has an unknown key {other}"))),
        };
        if slot.replace(value).is_some() {
            return Err(invalid(format!("the header has the key {key} twice")));
        }
    }
    let missing = |key: &str| invalid(format!("the header has no key '{key}'"));
    let dtype = dtype(&descr.ok_or_else(|| missing("descr"))?, name, start)?;
    let order = match fortran.ok_or_else(|| missing("fortran_order"))? {
        Literal::Bool(false) => AxisOrder::X_FASTEST,
        Literal::Bool(true) => AxisOrder::Z_FASTEST,
        other => {
            return Err(invalid(format!(
                "fortran_order is {other}, True or False expected"
            )));
        }
    };
    let dims = dims(&shape.ok_or_else(|| missing("shape"))?, name, start)?;

    let mut parsed = Parsed::new(Header::new(Format::Npy, dims, dtype), input.position());
    // With one voxel along z both orders are the same up to a swap of x and y; no special case.
    parsed.order = order;
    Ok(parsed)
}

fn dtype(descr: &Literal, name: &str, start: u64) -> Result<DType, Error> {
    let unsupported = |what: String| Error::unsupported(name, what).at(start);
    let text = match descr {
        Literal::Text(text) => text,
        Literal::List(_) | Literal::Tuple(_) => {
            return Err(unsupported(
                "a structured dtype; one number a voxel is expected".into(),
            ));
        }
        other => {
            return Err(
                Error::invalid(name, format!("descr is {other}, a dtype was expected")).at(start),
            );
        }
    };
    let bytes = text.as_bytes();
    let (order, kind, size) = match bytes {
        [order @ (b'<' | b'>' | b'|' | b'='), kind, size @ ..] => (Some(*order), *kind, size),
        [kind, size @ ..] => (None, *kind, size),
        [] => return Err(Error::invalid(name, "descr is empty").at(start)),
    };
    match kind {
        b'c' => {
            return Err(unsupported(format!(
                "complex voxels (dtype '{text}') are not read"
            )));
        }
        b'O' => {
            return Err(unsupported(format!(
                "Python objects (dtype '{text}') are not read, and never unpickled"
            )));
        }
        b'V' | b'S' | b'a' | b'U' | b'M' | b'm' => {
            return Err(unsupported(format!("dtype '{text}' is not a number")));
        }
        _ => {}
    }
    let size = std::str::from_utf8(size).ok().and_then(|s| s.parse().ok());
    let voxel = size
        .and_then(|size| voxel_type(kind, size))
        .ok_or_else(|| {
            unsupported(format!(
                "dtype '{text}' is not read; b1, i1..i8, u1..u8 and f2..f8 are"
            ))
        })?;
    let byte_order = match order {
        _ if voxel.bytes() == 1 => ByteOrder::Little,
        Some(b'<') => ByteOrder::Little,
        Some(b'>') => ByteOrder::Big,
        _ => {
            return Err(Error::invalid(
                name,
                format!("dtype '{text}' does not say its byte order, '<' or '>' expected"),
            )
            .at(start));
        }
    };
    Ok(DType { voxel, byte_order })
}

/// Extents (x, y, z) of an array of shape (z, y, x).
fn dims(shape: &Literal, name: &str, start: u64) -> Result<[u64; 3], Error> {
    let invalid = |what: String| Error::invalid(name, what).at(start);
    let Literal::Tuple(axes) = shape else {
        return Err(invalid(format!("shape is {shape}, a tuple was expected")));
    };
    let mut sizes = Vec::new();
    for axis in axes {
        let Literal::Int(size) = axis else {
            return Err(invalid(format!(
                "shape is {shape}, whole numbers were expected"
            )));
        };
        sizes.push(
            u64::try_from(*size)
                .map_err(|_| invalid(format!("shape is {shape}: {size} is no extent")))?,
        );
    }
    match sizes[..] {
        [0, _, _] | [_, 0, _] | [_, _, 0] => Err(invalid(format!(
            "shape is {shape}: an axis of size 0 holds no voxels"
        ))),
        [z, y, x] => Ok([x, y, z]),
        _ => {
            let hint = match sizes[..] {
                [_, _, _, 1..=4] => "; the last axis looks like colour: choose one channel first",
                [_, _] => "; one slice is stored as (1, y, x)",
                _ => "",
            };
            Err(Error::unsupported(
                name,
                format!(
                    "shape is {shape}: {} axes found, (z, y, x) expected{hint}",
                    sizes.len()
                ),
            )
            .at(start))
        }
    }
}
