//! DGtal `.vol` and `.longvol` files.
//!
//! In: lines `Key: value` up to a line `.`, and voxels behind it, x fastest. Out: a header.
//! Versions: without a `Version` line (the first files) a binary copy of the extents stands
//! before the voxels; 1 and 2 are plain; 3 is zlib data. `.vol` has one byte a voxel. The format
//! has no physical spacing: `Voxel-Size` counts bytes, and `Center-X` and the like place the
//! object in a grid, not in the world, so both leave spacing and origin alone.
//!
//! `.longvol` says `Lvoxel-Size: 4`, yet DGtal writes eight bytes a voxel (least significant
//! first) with that very line. The amount of data decides: if eight bytes a voxel are there,
//! eight it is, with a warning.

use std::io::BufRead;

use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header, VoxelType, voxel_count};
use crate::input::Input;
use crate::parsed::{Context, Encoding, Parsed};

/// Keys a file can begin with. Their order is free.
const KEYS: [&str; 14] = [
    "X",
    "Y",
    "Z",
    "Center-X",
    "Center-Y",
    "Center-Z",
    "Version",
    "Voxel-Size",
    "Lvoxel-Size",
    "Voxel-Endian",
    "Lvoxel-Endian",
    "Int-Endian",
    "Alpha-Color",
    "Voxel-Type",
];

/// Whether `head` begins like one of these files, with a line of text `Key: value`; which of the
/// two is decided by `parse`.
pub(crate) fn detect(head: &[u8]) -> Option<Format> {
    let colon = head.iter().take(32).position(|b| *b == b':')?;
    let known = KEYS.iter().any(|key| key.as_bytes() == &head[..colon]);
    // Of two bytes alone, such as "X:", binary voxels could be the owner.
    let text = head[colon + 1..]
        .iter()
        .take_while(|b| **b != b'\n')
        .all(|b| b.is_ascii_graphic() || b.is_ascii_whitespace());
    (known && text && head.len() > colon + 1).then_some(Format::Vol)
}

/// Longest line and most lines of a header; DGtal stops at 128 bytes and 64 lines.
const MOST_LINE_BYTES: usize = 1024;
const MOST_LINES: usize = 256;

pub(crate) fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let name = context.name;
    let fields = Fields::read(input, context)?;
    let dims = [
        fields.extent("X", name)?,
        fields.extent("Y", name)?,
        fields.extent("Z", name)?,
    ];
    let version = fields.number("Version", name)?;
    let (format, voxel_bytes, size_at) = match fields.find("Lvoxel-Size") {
        Some(field) => (
            Format::Longvol,
            fields.number("Lvoxel-Size", name)?,
            field.at,
        ),
        None => {
            let at = fields.find("Voxel-Size").map_or(0, |field| field.at);
            (Format::Vol, fields.number("Voxel-Size", name)?, at)
        }
    };
    let voxel = match (format, voxel_bytes) {
        (Format::Vol, Some(1) | None) => VoxelType::U8,
        (Format::Longvol, Some(4)) => VoxelType::U32,
        (Format::Longvol, Some(8)) => VoxelType::U64,
        (Format::Longvol, other) => {
            let other = other.unwrap_or(0);
            return Err(Error::unsupported(
                name,
                format!("Lvoxel-Size is {other}; 4 or 8 bytes expected"),
            )
            .at(size_at));
        }
        (_, other) => {
            let other = other.unwrap_or(0);
            return Err(Error::unsupported(
                name,
                format!("Voxel-Size is {other}; 1 byte expected (.longvol has more)"),
            )
            .at(size_at));
        }
    };
    let zlib = match version {
        None | Some(1 | 2) => false,
        Some(3) => true,
        Some(other) => {
            let at = fields.find("Version").map_or(0, |field| field.at);
            return Err(Error::unsupported(
                name,
                format!("Version is {other}; 1, 2 (plain) or 3 (zlib) expected"),
            )
            .at(at));
        }
    };
    let mut header = Header::new(
        format,
        dims,
        DType {
            voxel,
            byte_order: ByteOrder::Little,
        },
    );
    if fields.find("Voxel-Size").is_none() && format == Format::Vol {
        header.warnings.push(format!(
            "{name}: no Voxel-Size in the header; 1 byte assumed"
        ));
    }
    // All known files say 0123 and hold little-endian words, whatever machine wrote them.
    if let Some(order) = fields.find("Int-Endian")
        && voxel.bytes() > 1
        && order.value != "0123"
    {
        return Err(Error::unsupported(
            name,
            format!("Int-Endian is '{}'; 0123 expected", order.value),
        )
        .at(order.at));
    }
    if version.is_none() {
        skip_binary_extents(input, context, &mut header)?;
    }

    let mut parsed = Parsed::new(header, input.position());
    if zlib {
        parsed.encoding = Encoding::Zlib;
    }
    if voxel == VoxelType::U32 {
        match context.length.filter(|_| !zlib) {
            None => parsed.maybe_eight_bytes = true,
            Some(length) => {
                let eight = voxel_count(dims).and_then(|n| n.checked_mul(8));
                if eight.is_some_and(|eight| length.saturating_sub(parsed.offset) >= eight) {
                    take_eight_bytes(&mut parsed.header, name);
                }
            }
        }
    }
    Ok(parsed)
}

/// The file says four bytes a voxel and holds eight.
pub(crate) fn take_eight_bytes(header: &mut Header, name: &str) {
    header.voxel = VoxelType::U64;
    header.warnings.push(format!(
        "{name}: Lvoxel-Size says 4 bytes a voxel, but the data has 8 for each (as DGtal writes \
         them); 8 are read"
    ));
}

/// Files without a version repeat the extents as three machine integers and a line end.
fn skip_binary_extents(
    input: &mut Input,
    context: &Context<'_>,
    header: &mut Header,
) -> Result<(), Error> {
    let start = input.position();
    let bytes = context.header_bytes(input, 13)?;
    if bytes[12] != b'\n' {
        return Err(Error::invalid(
            context.name,
            "the header has no Version, and no copy of the extents ending in a line end follows it",
        )
        .at(start));
    }
    let word = |i: usize| {
        [
            bytes[4 * i],
            bytes[4 * i + 1],
            bytes[4 * i + 2],
            bytes[4 * i + 3],
        ]
    };
    let little = [0, 1, 2].map(|i| u64::from(u32::from_le_bytes(word(i))));
    let big = [0, 1, 2].map(|i| u64::from(u32::from_be_bytes(word(i))));
    if little != header.dims && big != header.dims {
        header.warnings.push(format!(
            "{}: the binary copy of the extents says {little:?}, the header {:?}; the header is \
             used",
            context.name, header.dims
        ));
    }
    Ok(())
}

/// One line of the header.
struct Field {
    key: String,
    value: String,
    at: u64,
}

struct Fields(Vec<Field>);

impl Fields {
    /// Reads lines up to the line `.`, and consumes it.
    fn read(input: &mut Input, context: &Context<'_>) -> Result<Self, Error> {
        let name = context.name;
        let mut fields: Vec<Field> = Vec::new();
        for _ in 0..MOST_LINES {
            let at = input.position();
            let line = read_line(input, context)?;
            if line == b"." {
                return Ok(Self(fields));
            }
            let text = std::str::from_utf8(&line).ok();
            let Some((key, value)) = text.and_then(|text| text.split_once(':')) else {
                return Err(Error::invalid(
                    name,
                    "a line of the header is not 'Key: value'; is its last line, '.', missing?",
                )
                .at(at));
            };
            let (key, value) = (key.trim().to_string(), value.trim().to_string());
            if fields.iter().any(|field| field.key == key) {
                return Err(Error::invalid(name, format!("the header has {key} twice")).at(at));
            }
            fields.push(Field { key, value, at });
        }
        Err(Error::invalid(
            name,
            format!("no line '.' within {MOST_LINES} lines: the header does not end"),
        )
        .at(input.position()))
    }

    fn find(&self, key: &str) -> Option<&Field> {
        self.0.iter().find(|field| field.key == key)
    }

    fn number(&self, key: &str, name: &str) -> Result<Option<u64>, Error> {
        let Some(field) = self.find(key) else {
            return Ok(None);
        };
        field.value.parse().map(Some).map_err(|_| {
            Error::invalid(
                name,
                format!("{key} is '{}', a whole number expected", field.value),
            )
            .at(field.at)
        })
    }

    fn extent(&self, key: &str, name: &str) -> Result<u64, Error> {
        self.number(key, name)?
            .ok_or_else(|| Error::invalid(name, format!("the header has no {key}")).at(0))
    }
}

/// A line without its end, which is LF or CR LF.
fn read_line(input: &mut Input, context: &Context<'_>) -> Result<Vec<u8>, Error> {
    let at = input.position();
    let mut line = Vec::new();
    loop {
        let have = match input.fill_buf() {
            Ok(have) => have,
            Err(e) => return Err(context.read_error(input, e)),
        };
        let end = have.iter().take(MOST_LINE_BYTES).position(|b| *b == b'\n');
        let step = end.unwrap_or(have.len().min(MOST_LINE_BYTES));
        line.extend_from_slice(&have[..step]);
        let empty = have.is_empty();
        input.consume(step + usize::from(end.is_some()));
        if end.is_some() && line.len() <= MOST_LINE_BYTES {
            if line.last() == Some(&b'\r') {
                line.pop();
            }
            return Ok(line);
        }
        if empty || line.len() >= MOST_LINE_BYTES {
            return Err(Error::invalid(
                context.name,
                "the header does not end: a line '.' was expected before the voxels",
            )
            .at(at));
        }
    }
}
