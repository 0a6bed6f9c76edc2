//! MetaImage: the format of MetaIO and ITK, attached (`.mha`) and detached (`.mhd`).
//!
//! In: a header of lines `field = value`, and the voxels behind it (`LOCAL`), in another file, or in
//! several (`LIST`, or a pattern with a number). Out: a header. Read are all scalar types, binary and
//! text, plain and compressed (zlib or gzip), either byte order, `HeaderSize`, `-1` included. Conventions:
//!
//! - World coordinates are those of the file, which ITK writes in the space left-posterior-superior. The
//!   rows of `TransformMatrix` are the directions of the axes, as ITK reads them: row `a` becomes column `a`
//!   of the direction.
//! - `ElementSpacing` is the spacing, else `ElementSize`. The unit is what `DistanceUnits` says, and not
//!   known without: ITK means millimetres, but no file has to.
//! - `Offset`, `Position`, `Origin` are the centre of the first voxel.
//! - A stored value v means `ElementToIntensityFunctionSlope` * v + `ElementToIntensityFunctionOffset`.
//! - `MET_LONG` and `MET_ULONG` have four bytes; without a byte order, voxels are little-endian.
//!
//! Refused: one and two dimensions; several channels; arrays as elements.
//!
//! No library is used: the one there is, MetaIO, is C++ and reads whole images into memory.

mod fields;

use std::fs::File;
use std::path::PathBuf;

use crate::beside::{Pattern, check_count, files, share, steps};
use crate::error::Error;
use crate::header::{ByteOrder, DType, Format, Header, Scaling, VoxelType};
use crate::input::{Compression, Input};
use crate::lines::next_line;
use crate::parsed::{Context, Encoding, Parsed, Start};
use crate::placement::{ROUNDING, take_origin, take_spacing, take_vectors, unit};

pub(crate) use fields::detect;
use fields::{Field, Fields};

pub(crate) fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let name = context.name;
    let fields = Fields::read(input, context)?;
    if let Some(object) = fields.find("ObjectType")
        && !object.value.eq_ignore_ascii_case("Image")
    {
        return Err(Error::unsupported(
            name,
            format!("ObjectType is '{}'; Image expected", object.value),
        )
        .at(object.at));
    }
    let sizes = sizes(&fields, name)?;
    let voxel = voxel(&fields, name)?;
    let binary = fields.is_true("BinaryData", true);
    let big = fields.is_true(
        "BinaryDataByteOrderMSB",
        fields.is_true("ElementByteOrderMSB", false),
    );
    // Numbers in text become little-endian voxels.
    let byte_order = if big && binary {
        ByteOrder::Big
    } else {
        ByteOrder::Little
    };
    let dims = [sizes[0], sizes[1], sizes[2]];
    let mut header = Header::new(Format::MetaImage, dims, DType { voxel, byte_order });
    place(&fields, sizes.len(), &mut header, name)?;
    header.scaling = scaling(&fields, name)?;
    let encoding = match (binary, fields.is_true("CompressedData", false)) {
        (false, _) => Encoding::Text,
        (true, true) => Encoding::Zlib,
        (true, false) => Encoding::Raw,
    };
    details(&fields, encoding, &mut header);

    let too_many = || {
        Error::invalid(
            name,
            format!("DimSize is {sizes:?}, which does not fit any file"),
        )
    };
    let frames = sizes[3..]
        .iter()
        .try_fold(1_u64, |all, size| all.checked_mul(*size));
    let frames = frames.ok_or_else(too_many)?;
    let bytes = header.voxels_bytes().ok_or_else(too_many)?;
    bytes.checked_mul(frames).ok_or_else(too_many)?;
    let frame = context.frame(frames)?;

    let mut parsed = Parsed::new(header, 0);
    parsed.encoding = encoding;
    let header_size = header_size(&fields, encoding, frames, name)?;
    match header_size {
        HeaderSize::Bytes(skip) => parsed.offset = skip,
        HeaderSize::FromEnd => parsed.start = Start::FromEnd,
    }
    let data = fields.need("ElementDataFile", name)?;
    if data.value.eq_ignore_ascii_case("local") {
        let position = input.position();
        // It is counted from the beginning of the file, and not said where it is nothing.
        if parsed.offset > 0 && parsed.offset < position {
            return Err(Error::invalid(
                name,
                format!(
                    "HeaderSize is {}, but the header ends at byte {position}",
                    parsed.offset
                ),
            ));
        }
        parsed.offset = parsed.offset.max(position);
        if encoding == Encoding::Zlib {
            let skip = parsed.offset - position;
            input.skip(skip).map_err(|e| context.read_error(input, e))?;
            let head = input
                .peek(Compression::MAGIC_BYTES)
                .map_err(|e| crate::input::read_error(name, position, e))?;
            parsed.encoding = compressed(head);
        }
        parsed.frames_behind = frames - 1 - frame;
        if let Start::Bytes(skip) = &mut parsed.start {
            *skip = frame.saturating_mul(bytes);
        }
        return Ok(parsed);
    }
    let paths = paths(data, &sizes, input, context)?;
    if encoding == Encoding::Zlib
        && let Some(path) = paths.first()
    {
        let failed = |e| Error::io(path.display().to_string(), "cannot be read", e);
        let mut first = Input::new(File::open(path).map_err(failed)?);
        first.skip(parsed.offset).map_err(failed)?;
        parsed.encoding = compressed(first.peek(Compression::MAGIC_BYTES).map_err(failed)?);
    }
    share(&mut parsed, paths, frame, frames, name)?;
    Ok(parsed)
}

/// The compression of data beginning with `head`. The library reads both.
fn compressed(head: &[u8]) -> Encoding {
    match Compression::detect(head) {
        Some(Compression::Gzip) => Encoding::Gzip,
        _ => Encoding::Zlib,
    }
}

/// The extents, at least three.
fn sizes(fields: &Fields, name: &str) -> Result<Vec<u64>, Error> {
    /// As many as the library has room for.
    const DIMENSIONS_MOST: usize = 10;
    let field = fields.need("NDims", name)?;
    let expected = "a number from 1 to 10";
    let count: usize = field
        .value
        .parse()
        .map_err(|_| field.wrong(name, expected))?;
    if !(1..=DIMENSIONS_MOST).contains(&count) {
        return Err(field.wrong(name, expected));
    }
    if count < 3 {
        return Err(Error::unsupported(
            name,
            format!("NDims is {count}: an image of {count} dimensions, 3 expected"),
        )
        .at(field.at));
    }
    let field = fields.need("DimSize", name)?;
    let sizes: Result<Vec<u64>, _> = field.value.split_whitespace().map(str::parse).collect();
    sizes
        .ok()
        .filter(|sizes| sizes.len() == count && !sizes.contains(&0))
        .ok_or_else(|| field.wrong(name, &format!("{count} numbers of at least 1")))
}

fn voxel(fields: &Fields, name: &str) -> Result<VoxelType, Error> {
    if let Some(field) = fields.find("ElementNumberOfChannels")
        && field.value != "1"
    {
        return Err(match field.value.parse::<u64>() {
            Ok(channels) if channels > 1 => Error::unsupported(
                name,
                format!(
                    "ElementNumberOfChannels is {channels}: voxels of several values are not read"
                ),
            )
            .at(field.at),
            _ => field.wrong(name, "1"),
        });
    }
    let field = fields.need("ElementType", name)?;
    Ok(match field.value.to_ascii_uppercase().as_str() {
        "MET_CHAR" | "MET_ASCII_CHAR" => VoxelType::I8,
        "MET_UCHAR" => VoxelType::U8,
        "MET_SHORT" => VoxelType::I16,
        "MET_USHORT" => VoxelType::U16,
        "MET_INT" | "MET_LONG" => VoxelType::I32,
        "MET_UINT" | "MET_ULONG" => VoxelType::U32,
        "MET_LONG_LONG" => VoxelType::I64,
        "MET_ULONG_LONG" => VoxelType::U64,
        "MET_FLOAT" => VoxelType::F32,
        "MET_DOUBLE" => VoxelType::F64,
        other if other.starts_with("MET_") && other.ends_with("_ARRAY") => {
            return Err(Error::unsupported(
                name,
                format!("ElementType is {other}: voxels of several values are not read"),
            )
            .at(field.at));
        }
        _ => return Err(field.wrong(name, "a type such as MET_UCHAR, MET_SHORT or MET_FLOAT")),
    })
}

/// Spacing, unit, origin and direction.
fn place(fields: &Fields, count: usize, header: &mut Header, name: &str) -> Result<(), Error> {
    let triple = |field: &Field| -> Result<[f64; 3], Error> {
        let all = field.numbers(3, name)?;
        Ok([all[0], all[1], all[2]])
    };
    let mut lengths = [1.0; 3];
    let matrix = fields.last_of(&["Orientation", "Rotation", "TransformMatrix"]);
    if let Some(field) = matrix {
        let all = field.numbers(count * count, name)?;
        let row = |a: usize| [all[a * count], all[a * count + 1], all[a * count + 2]];
        // All zeros is what writers leave that have none.
        if all.iter().any(|x| *x != 0.0) {
            let rows = [row(0), row(1), row(2)];
            lengths = take_vectors(header, rows, field.name(), name).unwrap_or(lengths);
        }
    }
    if let Some(field) = fields.last_of(&["ElementSize", "ElementSpacing"]) {
        let mut edges = triple(field)?;
        if lengths.iter().any(|length| (length - 1.0).abs() > ROUNDING) {
            header.warnings.push(format!(
                "{name}: the transform scales the axes by {lengths:?}; the spacing is scaled with \
                 them"
            ));
            edges = std::array::from_fn(|a| edges[a] * lengths[a]);
        }
        take_spacing(header, edges, field.name(), name);
    }
    if let Some(field) = fields.last_of(&["Offset", "Position", "Origin", "ImagePosition"]) {
        take_origin(header, triple(field)?, field.name(), name);
    }
    if let Some(field) = fields.find("DistanceUnits")
        && header.spacing.is_some()
    {
        match unit(&field.value) {
            Some(unit) => header.unit = unit,
            None => header.warnings.push(format!(
                "{name}: DistanceUnits is '{}', which is not known; the unit is taken as unknown",
                field.value.chars().take(20).collect::<String>()
            )),
        }
    }
    Ok(())
}

fn scaling(fields: &Fields, name: &str) -> Result<Option<Scaling>, Error> {
    let number = |field: &str, default: f64| -> Result<f64, Error> {
        match fields.find(field) {
            None => Ok(default),
            Some(field) => match field.numbers(1, name)?[0] {
                number if number.is_finite() => Ok(number),
                _ => Err(field.wrong(name, "a finite number")),
            },
        }
    };
    let slope = number("ElementToIntensityFunctionSlope", 1.0)?;
    let intercept = number("ElementToIntensityFunctionOffset", 0.0)?;
    if slope == 0.0 {
        let field = fields.need("ElementToIntensityFunctionSlope", name)?;
        return Err(field.wrong(name, "a number that is not 0"));
    }
    Ok((slope != 1.0 || intercept != 0.0).then_some(Scaling { slope, intercept }))
}

/// Facts for print.
fn details(fields: &Fields, encoding: Encoding, header: &mut Header) {
    /// What fits a line.
    const LETTERS_MOST: usize = 80;
    let space = "left-posterior-superior, as ITK writes it".to_string();
    header.details.push(("space", space));
    let encoding = match encoding {
        Encoding::Text => "text",
        Encoding::Raw => "binary",
        _ => "compressed",
    };
    header.details.push(("encoding", encoding.to_string()));
    for (field, detail) in [
        ("AnatomicalOrientation", "anatomical orientation"),
        ("ElementDataFile", "data file"),
    ] {
        if let Some(field) = fields.find(field) {
            let value = field.value.chars().take(LETTERS_MOST).collect();
            header.details.push((detail, value));
        }
    }
}

/// Where the voxels begin in their file.
enum HeaderSize {
    Bytes(u64),
    FromEnd,
}

fn header_size(
    fields: &Fields,
    encoding: Encoding,
    frames: u64,
    name: &str,
) -> Result<HeaderSize, Error> {
    let Some(field) = fields.find("HeaderSize") else {
        return Ok(HeaderSize::Bytes(0));
    };
    let size: i64 = field
        .value
        .parse()
        .map_err(|_| field.wrong(name, "a number of bytes, or -1,"))?;
    if let Ok(size) = u64::try_from(size) {
        return Ok(HeaderSize::Bytes(size));
    }
    if size != -1 {
        return Err(field.wrong(name, "a number of bytes, or -1,"));
    }
    if encoding != Encoding::Raw || frames > 1 {
        return Err(Error::unsupported(
            name,
            "HeaderSize is -1, which is read with plain binary data of one volume",
        )
        .at(field.at));
    }
    Ok(HeaderSize::FromEnd)
}

/// The files that hold the voxels.
fn paths(
    data: &Field,
    sizes: &[u64],
    input: &mut Input,
    context: &Context<'_>,
) -> Result<Vec<PathBuf>, Error> {
    let name = context.name;
    let value = data.value.as_str();
    if value == "LIST" || value.starts_with("LIST ") {
        return files(&list(data, sizes, input, context)?, context);
    }
    if value.is_empty() {
        return Err(data.wrong(name, "LOCAL, LIST or the name of a file"));
    }
    if let Some(names) = numbered(data, sizes[sizes.len() - 1], context)? {
        return files(&names, context);
    }
    // The library looks for a compressed file of the same name, too.
    let compressed = format!("{value}.gz");
    if !context.beside(value)?.is_file() && context.beside(&compressed)?.is_file() {
        return files(&[compressed], context);
    }
    files(&[value.to_string()], context)
}

/// The names that follow `LIST`, which may say how many dimensions each file has.
fn list(
    data: &Field,
    sizes: &[u64],
    input: &mut Input,
    context: &Context<'_>,
) -> Result<Vec<String>, Error> {
    let name = context.name;
    let dimensions = match data.value[4..].trim() {
        "" => sizes.len() - 1,
        text => {
            let dimensions = text.parse::<usize>();
            let dimensions = dimensions.map_err(|_| data.wrong(name, "LIST and a number"))?;
            // As the library has it.
            if dimensions == 0 || dimensions > sizes.len() {
                sizes.len() - 1
            } else {
                dimensions
            }
        }
    };
    let count = sizes[dimensions..]
        .iter()
        .try_fold(1_u64, |all, size| all.checked_mul(*size));
    let count = count.ok_or_else(|| data.wrong(name, "fewer files"))?;
    check_count(count, context)?;
    let mut names = Vec::new();
    while (names.len() as u64) < count {
        match next_line(input, context)? {
            Some(line) if line.text.is_empty() => {}
            Some(line) => names.push(line.text),
            None => {
                return Err(Error::invalid(
                    name,
                    format!("the header lists {} files, {count} expected", names.len()),
                )
                .at(input.position()));
            }
        }
    }
    Ok(names)
}

/// The names that a pattern stands for, one for each of the last axis: the pattern, and up to three
/// numbers (first, last, step). `None` if there is no pattern.
fn numbered(data: &Field, count: u64, context: &Context<'_>) -> Result<Option<Vec<String>>, Error> {
    let name = context.name;
    let mut text = data.value.as_str();
    let mut numbers = Vec::new();
    while numbers.len() < 3
        && let Some((before, word)) = text.rsplit_once([' ', '\t'])
        && let Ok(number) = word.parse::<i64>()
    {
        numbers.insert(0, number);
        text = before.trim_end();
    }
    let Some(pattern) = Pattern::parse(text) else {
        return Ok(None);
    };
    check_count(count, context)?;
    // Not more than the files that are read.
    let steps_between = i64::try_from(count).unwrap_or(i64::MAX) - 1;
    let (first, step) = match numbers.as_slice() {
        [] => (1, 1),
        [first] => (*first, 1),
        [first, last] if steps_between > 0 => (
            *first,
            last.saturating_sub(*first)
                .checked_div(steps_between)
                .unwrap_or(1),
        ),
        [first, _] => (*first, 1),
        [first, last, step, ..] => {
            let there = steps(*first, *last, *step)
                .ok_or_else(|| data.wrong(name, "a first number, a last number and a step"))?;
            if there < count {
                return Err(Error::invalid(
                    name,
                    format!("the pattern stands for {there} files, {count} expected"),
                )
                .at(data.at));
            }
            (*first, *step)
        }
    };
    let names = (0..count)
        .map(|i| pattern.name(first.wrapping_add((i as i64).wrapping_mul(step))))
        .collect();
    Ok(Some(names))
}
