//! NRRD, nearly raw raster data: the format of teem, versions 1 to 5, attached and detached.
//!
//! In: a header of text lines, and the voxels behind it, in another file, or in several (`LIST`, or a
//! pattern with a number). Out: a header. Read are all scalar types, raw, text, hexadecimal, gzip, bzip2
//! and Zstandard encodings (the last is not in the specification), `line skip` and `byte skip`, `-1`
//! included. Conventions:
//!
//! - x is the first axis of space in the file, whatever direction it has: voxels are never reordered.
//! - Spacing is the length of a space direction, else `spacings`, else from `axis mins` and `axis maxs`. Not
//!   a number means unknown, in silence; zero is left out with a warning.
//! - World coordinates are those of the file, in its own `space`, which is among the details.
//! - `line skip` counts lines of the stored data, `byte skip` counts bytes of the decompressed data.
//! - `min`, `max`, `old min`, `old max`, `thicknesses`, `measurement frame`, `sample units` and key/value
//!   pairs do not change voxels and are passed over.
//!
//! Refused: one and two axes; axes of colours, vectors, lists and the like before the axes of space, by
//! the name of their kind; `block` voxels; voxels of several bytes without `endian`.
//!
//! No library is used: those there are read whole arrays into memory, or one file each.

mod axes;

mod fields;

mod place;

use crate::beside::{Pattern, check_count, files, share, steps};
use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header, VoxelType};
use crate::input::Input;
use crate::parsed::{Context, Encoding, Parsed, Start};

use axes::Axes;
pub(crate) use fields::MAGIC;
use fields::{Field, Fields};

pub(crate) fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let name = context.name;
    let mut fields = Fields::read(input, context)?;
    let mut warnings = std::mem::take(&mut fields.warnings);
    let axes = Axes::read(&fields, &mut warnings, name)?;
    let voxel = voxel(&fields, name)?;
    let encoding = encoding(&fields, name)?;
    let byte_order = byte_order(&fields, voxel, encoding, name)?;
    let mut header = Header::new(Format::Nrrd, axes.dims, DType { voxel, byte_order });
    header.warnings = warnings;
    place::place(&fields, &axes, &mut header, name)?;
    details(&fields, &mut header);

    let frame = context.frame(axes.frames)?;
    let bytes = header.voxels_bytes();
    let all = bytes.and_then(|bytes| bytes.checked_mul(axes.frames));
    let (Some(bytes), Some(_)) = (bytes, all) else {
        return Err(Error::invalid(
            name,
            format!("sizes are {:?}, which do not fit any file", axes.sizes),
        ));
    };
    let paths = match fields.find("data file") {
        None => None,
        Some(field) => Some(files(&names(field, &fields, &axes, context)?, context)?),
    };
    let lines = match fields.find("line skip") {
        None => 0,
        Some(field) => field.number(name, "a number of lines")?,
    };
    let skip = byte_skip(&fields, encoding, paths.as_ref().map_or(1, Vec::len), name)?;
    let mut parsed = Parsed::new(header, 0);
    parsed.encoding = encoding;
    // Text is skipped as it is stored, compressed data as it is meant.
    match skip {
        Some(skip) if matches!(encoding, Encoding::Text | Encoding::Hex) => parsed.offset = skip,
        Some(skip) => parsed.start = Start::Bytes(skip),
        None if axes.frames > 1 => {
            return Err(Error::unsupported(
                name,
                "byte skip is -1 and the data has several volumes, which is not read",
            ));
        }
        None => parsed.start = Start::FromEnd,
    }
    match paths {
        Some(paths) => {
            parsed.lines = lines;
            share(&mut parsed, paths, frame, axes.frames, name)?;
        }
        None => {
            crate::forward::skip_lines(input, lines, name)?;
            parsed.offset = parsed.offset.saturating_add(input.position());
            parsed.frames_behind = axes.frames - 1 - frame;
            if let Start::Bytes(skip) = &mut parsed.start {
                *skip = skip.saturating_add(frame.saturating_mul(bytes));
            }
        }
    }
    Ok(parsed)
}

fn voxel(fields: &Fields, name: &str) -> Result<VoxelType, Error> {
    let field = fields.need("type", name)?;
    let words: Vec<_> = field.value.split_whitespace().collect();
    Ok(match words.join(" ").to_ascii_lowercase().as_str() {
        "signed char" | "int8" | "int8_t" => VoxelType::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => VoxelType::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
            VoxelType::I16
        }
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => {
            VoxelType::U16
        }
        "int" | "signed int" | "int32" | "int32_t" => VoxelType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => VoxelType::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => VoxelType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => {
            VoxelType::U64
        }
        "float" => VoxelType::F32,
        "double" => VoxelType::F64,
        "block" => {
            return Err(Error::unsupported(
                name,
                "type is block: voxels of several values are not read",
            )
            .at(field.at));
        }
        // The specification leaves it out on purpose.
        "char" => return Err(field.wrong(name, "signed char or unsigned char")),
        _ => return Err(field.wrong(name, "a type such as uint8, short or float")),
    })
}

fn encoding(fields: &Fields, name: &str) -> Result<Encoding, Error> {
    let field = fields.need("encoding", name)?;
    Ok(match field.value.to_ascii_lowercase().as_str() {
        "raw" => Encoding::Raw,
        "txt" | "text" | "ascii" => Encoding::Text,
        "hex" => Encoding::Hex,
        "gz" | "gzip" => Encoding::Gzip,
        "bz2" | "bzip2" => Encoding::Bzip2,
        "zst" | "zstd" => Encoding::Zstd,
        _ => {
            return Err(Error::unsupported(
                name,
                format!(
                    "encoding is '{}'; raw, text, hex, gzip, bzip2 or zstd expected",
                    field.value
                ),
            )
            .at(field.at));
        }
    })
}

fn byte_order(
    fields: &Fields,
    voxel: VoxelType,
    encoding: Encoding,
    name: &str,
) -> Result<ByteOrder, Error> {
    // Numbers in text become little-endian voxels.
    if voxel.bytes() == 1 || encoding == Encoding::Text {
        return Ok(ByteOrder::Little);
    }
    let Some(field) = fields.find("endian") else {
        return Err(Error::invalid(
            name,
            format!(
                "the header has no field 'endian', without which voxels of type {voxel} cannot be \
                 read"
            ),
        ));
    };
    match field.value.to_ascii_lowercase().as_str() {
        "little" => Ok(ByteOrder::Little),
        "big" => Ok(ByteOrder::Big),
        _ => Err(field.wrong(name, "little or big")),
    }
}

/// Facts for print.
fn details(fields: &Fields, header: &mut Header) {
    /// What fits a line.
    const LETTERS_MOST: usize = 80;
    let version = format!("NRRD000{}", fields.version);
    header.details.push(("version", version));
    for (field, detail) in [
        ("encoding", "encoding"),
        ("space", "space"),
        ("content", "content"),
        ("data file", "data file"),
    ] {
        if let Some(field) = fields.find(field) {
            let value = field.value.chars().take(LETTERS_MOST).collect();
            header.details.push((detail, value));
        }
    }
}

/// Bytes to skip; `None` for as many as come before the voxels at the end.
fn byte_skip(
    fields: &Fields,
    encoding: Encoding,
    files: usize,
    name: &str,
) -> Result<Option<u64>, Error> {
    let Some(field) = fields.find("byte skip") else {
        return Ok(Some(0));
    };
    let skip: i64 = field.number(name, "a number of bytes")?;
    if skip != -1 {
        return match u64::try_from(skip) {
            Ok(skip) => Ok(Some(skip)),
            Err(_) => Err(field.wrong(name, "a number of bytes, or -1 for the last of the file,")),
        };
    }
    let text = matches!(encoding, Encoding::Text | Encoding::Hex);
    if text || (files > 1 && encoding != Encoding::Raw) {
        return Err(Error::unsupported(
            name,
            "byte skip is -1, which is read with raw data and with one compressed file",
        )
        .at(field.at));
    }
    Ok(None)
}

/// The names of the files that hold the voxels.
fn names(
    field: &Field,
    fields: &Fields,
    axes: &Axes,
    context: &Context<'_>,
) -> Result<Vec<String>, Error> {
    let name = context.name;
    let value = field.value.as_str();
    if value == "LIST" || value.starts_with("LIST ") {
        check_pieces(field, fields.list.len() as u64, &value[4..], axes, name)?;
        return Ok(fields.list.clone());
    }
    let (word, numbers) = value.split_once([' ', '\t']).unwrap_or((value, ""));
    let Some(pattern) = Pattern::parse(word) else {
        if value.is_empty() {
            return Err(field.wrong(name, "the name of a file"));
        }
        return Ok(vec![value.to_string()]);
    };
    let expected = "a pattern and its first number, last number and step";
    let mut words = numbers.split_whitespace();
    let mut next = || -> Option<i64> { words.next()?.parse().ok() };
    let (Some(first), Some(last), Some(step)) = (next(), next(), next()) else {
        return Err(field.wrong(name, expected));
    };
    let count = steps(first, last, step).ok_or_else(|| field.wrong(name, expected))?;
    check_pieces(field, count, words.next().unwrap_or(""), axes, name)?;
    check_count(count, context)?;
    // Between first and last, whatever happens on the way.
    Ok((0..count)
        .map(|i| pattern.name(first.wrapping_add((i as i64).wrapping_mul(step))))
        .collect())
}

/// Whether so many files, each of an array of `dimension` axes (one less than all, if not said), are the
/// whole array.
fn check_pieces(
    field: &Field,
    files: u64,
    dimension: &str,
    axes: &Axes,
    name: &str,
) -> Result<(), Error> {
    let dimension = match dimension.trim() {
        "" => axes.count - 1,
        text => text
            .parse()
            .ok()
            .filter(|d| (1..=axes.count).contains(d))
            .ok_or_else(|| field.wrong(name, "a number of axes of each file"))?,
    };
    let slowest = axes.sizes[axes.count - 1];
    let pieces = axes.sizes[dimension..]
        .iter()
        .try_fold(1_u64, |all, size| all.checked_mul(*size));
    let right = if dimension == axes.count {
        files > 0 && slowest.is_multiple_of(files)
    } else {
        pieces == Some(files)
    };
    if right {
        return Ok(());
    }
    let expected = if dimension == axes.count {
        format!("a divisor of {slowest}")
    } else {
        pieces.map_or("fewer".into(), |n| n.to_string())
    };
    Err(Error::invalid(
        name,
        format!(
            "the header names {files} files of {dimension} axes each; {expected} expected for \
             sizes {:?}",
            axes.sizes
        ),
    )
    .at(field.at))
}
