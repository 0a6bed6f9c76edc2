//! PLY: elements with properties, as text or binary.
//!
//! In: a header that names elements and the types of their properties in any order, and their
//! values. Out: a mesh from `vertex` (x y z, perhaps nx ny nz) and `face` (the list
//! `vertex_indices` or `vertex_index`, perhaps nx ny nz); other elements and properties are passed over.
//! Counts of the header are claims: memory grows with the values that are there.
//!
//! Refused: triangle strips in place of faces, and versions other than 1.0.

use std::io::Read;

use crate::error::Error;
use crate::input::{Input, read_error};

use super::text::{Lines, shown, text};
use super::{Mesh, MeshFormat};

#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn named(word: &[u8]) -> Option<Self> {
        Some(match word {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }
}

/// What a property is to the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Meaning {
    Position(usize),
    Normal(usize),
    Corners,
    Other,
}

#[derive(Debug)]
struct Property {
    meaning: Meaning,
    /// The type of the count, for a list.
    list: Option<Scalar>,
    scalar: Scalar,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Vertex,
    Face,
    Other,
}

#[derive(Debug)]
struct Element {
    kind: Kind,
    name: String,
    count: u64,
    properties: Vec<Property>,
}

impl Element {
    fn has(&self, meaning: Meaning) -> bool {
        self.properties.iter().any(|p| p.meaning == meaning)
    }

    fn has_normals(&self) -> bool {
        (0..3).all(|a| self.has(Meaning::Normal(a)))
    }
}

pub(super) fn read(input: &mut Input, name: &str) -> Result<Mesh, Error> {
    let (encoding, elements, header_lines) = read_header(input, name)?;
    let mut values: Box<dyn Values + '_> = match encoding {
        Encoding::Ascii => Box::new(TextValues::new(input, name, header_lines)),
        Encoding::Little | Encoding::Big => Box::new(BinaryValues {
            input,
            name,
            big: encoding == Encoding::Big,
        }),
    };
    let mut mesh = Mesh::new(MeshFormat::Ply);
    for element in &elements {
        read_element(element, values.as_mut(), &mut mesh)?;
    }
    let warning = values.finish()?;
    drop(values);
    mesh.warnings.extend(warning);
    // Faces may stand before the vertices, so their indices are checked at the end.
    let count = mesh.vertices.len();
    for f in 0..mesh.faces() {
        for &v in &mesh.corners[mesh.face(f)] {
            if v as usize >= count {
                return Err(Error::invalid(
                    name,
                    format!("face {f} names vertex {v}; there are {count}, counted from 0"),
                ));
            }
        }
    }
    Ok(mesh)
}

fn read_header(input: &mut Input, name: &str) -> Result<(Encoding, Vec<Element>, u64), Error> {
    /// More than any writer needs; a header without end is no header.
    const MOST_LINES: u64 = 10_000;
    let mut lines = Lines::new(input, name);
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut count = 0;
    loop {
        if !lines.advance()? {
            return Err(lines.invalid("the file ends in the header; 'end_header' expected"));
        }
        count += 1;
        if count > MOST_LINES {
            return Err(lines.invalid("the header does not end"));
        }
        let words: Vec<&[u8]> = lines.words().collect();
        if count == 1 {
            if words != [b"ply"] {
                return Err(lines.invalid("a PLY file begins with 'ply'"));
            }
            continue;
        }
        match words[..] {
            [] | [b"comment" | b"obj_info", ..] => {}
            [b"format", kind, b"1.0"] => {
                encoding = Some(match kind {
                    b"ascii" => Encoding::Ascii,
                    b"binary_little_endian" => Encoding::Little,
                    b"binary_big_endian" => Encoding::Big,
                    _ => {
                        return Err(lines.invalid(format!(
                            "format '{}' found; ascii, binary_little_endian or binary_big_endian expected",
                            shown(kind)
                        )));
                    }
                });
            }
            [b"element", kind, claimed] => elements.push(element(&lines, kind, claimed)?),
            [b"property", ref rest @ ..] => {
                let Some(element) = elements.last_mut() else {
                    return Err(lines.invalid("a property before any element"));
                };
                let property = property(&lines, element.kind, rest)?;
                if property.meaning != Meaning::Other && element.has(property.meaning) {
                    return Err(lines.invalid("this property is there twice"));
                }
                element.properties.push(property);
            }
            [b"end_header"] => break,
            _ => {
                return Err(lines.invalid(format!("'{}' is not understood", shown(lines.line()))));
            }
        }
    }
    let Some(encoding) = encoding else {
        return Err(Error::invalid(name, "the header has no line 'format'"));
    };
    check(&elements, name)?;
    Ok((encoding, elements, count))
}

fn element(lines: &Lines<'_>, kind: &[u8], claimed: &[u8]) -> Result<Element, Error> {
    let count = text(claimed)
        .parse()
        .map_err(|_| lines.invalid(format!("'{}' is no count", shown(claimed))))?;
    Ok(Element {
        kind: match kind {
            b"vertex" => Kind::Vertex,
            b"face" => Kind::Face,
            _ => Kind::Other,
        },
        name: shown(kind),
        count,
        properties: Vec::new(),
    })
}

fn property(lines: &Lines<'_>, kind: Kind, words: &[&[u8]]) -> Result<Property, Error> {
    let scalar = |word: &[u8]| {
        Scalar::named(word)
            .ok_or_else(|| lines.invalid(format!("'{}' is no type of PLY", shown(word))))
    };
    let (list, value, name) = match words {
        [b"list", count, value, name] => (Some(scalar(count)?), scalar(value)?, *name),
        [value, name] => (None, scalar(value)?, *name),
        _ => return Err(lines.invalid("a property is a type and a name")),
    };
    if list.is_some_and(|count| !count.is_integer()) {
        return Err(lines.invalid("the count of a list must be of an integer type"));
    }
    let axis = |names: [&[u8]; 3]| names.iter().position(|n| *n == name);
    let meaning = match (kind, list) {
        (Kind::Face, Some(_)) if [&b"vertex_indices"[..], b"vertex_index"].contains(&name) => {
            if !value.is_integer() {
                return Err(lines.invalid("indices of vertices must be of an integer type"));
            }
            Meaning::Corners
        }
        (Kind::Vertex | Kind::Face, None) => {
            if let Some(axis) = axis([b"nx", b"ny", b"nz"]) {
                Meaning::Normal(axis)
            } else if let (Kind::Vertex, Some(axis)) = (kind, axis([b"x", b"y", b"z"])) {
                Meaning::Position(axis)
            } else {
                Meaning::Other
            }
        }
        _ => Meaning::Other,
    };
    Ok(Property {
        meaning,
        list,
        scalar: value,
    })
}

/// Checks that the elements of a mesh are there, once each.
fn check(elements: &[Element], name: &str) -> Result<(), Error> {
    let one = |kind: Kind, word: &str| -> Result<&Element, Error> {
        let mut found = elements.iter().filter(|e| e.kind == kind);
        match (found.next(), found.next()) {
            (Some(element), None) => Ok(element),
            (None, _) => {
                let strips = elements.iter().any(|e| e.name == "tristrips");
                let what = if strips && kind == Kind::Face {
                    "has triangle strips and no faces; strips are not read".into()
                } else {
                    format!("the header has no element '{word}'")
                };
                Err(Error::unsupported(name, what))
            }
            (Some(_), Some(_)) => Err(Error::invalid(
                name,
                format!("the header has the element '{word}' twice"),
            )),
        }
    };
    let vertex = one(Kind::Vertex, "vertex")?;
    let face = one(Kind::Face, "face")?;
    if !(0..3).all(|a| vertex.has(Meaning::Position(a))) {
        return Err(Error::invalid(
            name,
            "the vertices lack one of the properties x, y and z",
        ));
    }
    if !face.has(Meaning::Corners) {
        return Err(Error::invalid(
            name,
            "the faces lack the list vertex_indices",
        ));
    }
    if vertex.count > u64::from(u32::MAX) {
        return Err(Error::unsupported(
            name,
            format!("{} vertices; at most 2^32 - 1 are read", vertex.count),
        ));
    }
    Ok(())
}

/// The values of the elements, one after another.
trait Values {
    /// Begins the next element of its kind.
    fn begin(&mut self) -> Result<(), Error>;
    /// The next value.
    fn value(&mut self, scalar: Scalar) -> Result<f64, Error>;
    /// Ends an element.
    fn end(&mut self) -> Result<(), Error>;
    /// Passes over elements that take no room.
    fn takes_room(&self) -> bool;
    /// An error at the last value read.
    fn invalid(&self, message: String) -> Error;
    /// After the last element; perhaps a warning.
    fn finish(&mut self) -> Result<Option<String>, Error>;
}

fn read_element(element: &Element, values: &mut dyn Values, mesh: &mut Mesh) -> Result<(), Error> {
    if element.properties.is_empty() && !values.takes_room() {
        return Ok(());
    }
    let mut normals = Vec::new();
    for number in 0..element.count {
        values.begin()?;
        let (mut position, mut normal) = ([0.0; 3], [0.0; 3]);
        for property in &element.properties {
            let count = match property.list {
                None => 1,
                Some(scalar) => {
                    let count = values.value(scalar)?;
                    if count < 0.0 {
                        return Err(values.invalid(format!(
                            "{} {number} has a list of {count} values",
                            element.name
                        )));
                    }
                    // An integer of at most 32 bits.
                    count as u64
                }
            };
            if property.meaning == Meaning::Corners && count < 3 {
                return Err(values.invalid(format!(
                    "face {number} has {count} corners; 3 or more expected"
                )));
            }
            for _ in 0..count {
                let value = values.value(property.scalar)?;
                match property.meaning {
                    Meaning::Position(_) if !value.is_finite() => {
                        return Err(values.invalid(format!(
                            "vertex {number} has a coordinate that is not finite"
                        )));
                    }
                    Meaning::Position(axis) => position[axis] = value,
                    Meaning::Normal(axis) => normal[axis] = value,
                    Meaning::Corners => {
                        if !(0.0..4_294_967_295.0).contains(&value) {
                            return Err(
                                values.invalid(format!("face {number} names vertex {value}"))
                            );
                        }
                        mesh.corners.push(value as u32);
                    }
                    Meaning::Other => {}
                }
            }
        }
        values.end()?;
        match element.kind {
            Kind::Vertex => mesh.vertices.push(position),
            Kind::Face => mesh.end_face().map_err(|e| values.invalid(e.to_string()))?,
            Kind::Other => {}
        }
        if element.has_normals() {
            // Some writers store NaN where there is no normal.
            let finite = normal.iter().all(|x: &f64| x.is_finite());
            normals.push(if finite { normal } else { [0.0; 3] });
        }
    }
    if element.has_normals() && !normals.is_empty() {
        match element.kind {
            Kind::Vertex => mesh.vertex_normals = Some(normals),
            Kind::Face => mesh.face_normals = Some(normals),
            Kind::Other => {}
        }
    }
    Ok(())
}

struct TextValues<'a> {
    lines: Lines<'a>,
    /// Where the next word of the line begins.
    at: usize,
}

impl<'a> TextValues<'a> {
    fn new(input: &'a mut Input, name: &'a str, header_lines: u64) -> Self {
        Self {
            lines: Lines::after(input, name, header_lines),
            at: 0,
        }
    }
}

impl Values for TextValues<'_> {
    fn begin(&mut self) -> Result<(), Error> {
        self.at = 0;
        loop {
            if !self.lines.advance()? {
                return Err(self.lines.invalid("the file ends before its last element"));
            }
            if self.lines.words().next().is_some() {
                return Ok(());
            }
        }
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, Error> {
        let line = self.lines.line();
        let rest = &line[self.at..];
        let blank = rest
            .iter()
            .position(|b| !b.is_ascii_whitespace())
            .ok_or_else(|| self.lines.invalid("fewer values than the header says"))?;
        let rest = &rest[blank..];
        let end = rest
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(rest.len());
        let word = &rest[..end];
        if scalar.is_integer() {
            let number: i64 = text(word)
                .parse()
                .ok()
                .filter(|n: &i64| n.unsigned_abs() <= u64::from(u32::MAX))
                .ok_or_else(|| {
                    self.lines
                        .invalid(format!("'{}' is no integer of 32 bits", shown(word)))
                })?;
            self.at += blank + end;
            return Ok(number as f64);
        }
        let number = self.lines.any_number(word)?;
        self.at += blank + end;
        Ok(number)
    }

    fn end(&mut self) -> Result<(), Error> {
        let line = self.lines.line();
        if line[self.at..].trim_ascii().is_empty() {
            return Ok(());
        }
        Err(self.lines.invalid("more values than the header says"))
    }

    fn takes_room(&self) -> bool {
        true
    }

    fn invalid(&self, message: String) -> Error {
        self.lines.invalid(message)
    }

    fn finish(&mut self) -> Result<Option<String>, Error> {
        if !self.lines.ended() {
            return Ok(Some(
                "the last line has no line end: the file may have been cut".into(),
            ));
        }
        while self.lines.advance()? {
            if self.lines.words().next().is_some() {
                return Ok(Some(
                    "lines follow the last element; they are ignored".into(),
                ));
            }
        }
        Ok(None)
    }
}

struct BinaryValues<'a> {
    input: &'a mut Input,
    name: &'a str,
    big: bool,
}

impl Values for BinaryValues<'_> {
    fn begin(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, Error> {
        let mut bytes = [0; 8];
        let size = scalar.bytes();
        let at = self.input.position();
        let found = self
            .input
            .read_up_to(&mut bytes[..size])
            .map_err(|e| read_error(self.name, at, e))?;
        if found < size {
            return Err(
                Error::invalid(self.name, "the file ends before its last element")
                    .at(at + found as u64),
            );
        }
        if self.big {
            bytes[..size].reverse();
        }
        let [a, b, c, d, ..] = bytes;
        let value = match scalar {
            Scalar::I8 => f64::from(i8::from_le_bytes([a])),
            Scalar::U8 => f64::from(a),
            Scalar::I16 => f64::from(i16::from_le_bytes([a, b])),
            Scalar::U16 => f64::from(u16::from_le_bytes([a, b])),
            Scalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Scalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Scalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Scalar::F64 => f64::from_le_bytes(bytes),
        };
        Ok(value)
    }

    fn end(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn takes_room(&self) -> bool {
        false
    }

    fn invalid(&self, message: String) -> Error {
        Error::invalid(self.name, message).at(self.input.position())
    }

    fn finish(&mut self) -> Result<Option<String>, Error> {
        let at = self.input.position();
        let mut byte = [0];
        let more = self
            .input
            .read(&mut byte)
            .map_err(|e| read_error(self.name, at, e))?;
        Ok((more > 0)
            .then(|| format!("bytes follow the last element at byte {at}; they are ignored")))
    }
}
