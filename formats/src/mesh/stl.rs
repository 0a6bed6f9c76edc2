//! STL: loose triangles with a normal each, as text or binary.
//!
//! In: a file. Out: a mesh of triangles; corners at exactly the same place are one vertex.
//! Binary or text is decided by content: a file that does not begin with `solid` is binary, and one that
//! does is so if its length fits the binary header or its first bytes are no text. Several solids in a text file are one mesh.
//! A facet normal of zero is one that is not given. Attributes and colours are ignored.

use crate::error::Error;
use crate::input::{Input, read_error};

use super::text::{shown, text};
use super::{Mesh, MeshFormat};

/// Text of 80 bytes and the number of triangles.
pub(super) const HEADER_BYTES: usize = 84;
/// A normal, three corners, two bytes of attributes.
const FACET_BYTES: usize = 50;

/// Whether content begins with the word `solid`, as text files do.
pub(super) fn begins_solid(head: &[u8]) -> bool {
    let head = head.trim_ascii_start();
    head.len() > 5 && head[..5].eq_ignore_ascii_case(b"solid") && head[5].is_ascii_whitespace()
}

/// Whether bytes hold what no text does. A triangle of a binary file has zeros as soon as it has short
/// numbers or no attributes.
fn is_no_text(head: &[u8]) -> bool {
    head.iter()
        .any(|b| b.is_ascii_control() && !b.is_ascii_whitespace())
}

pub(super) fn read(input: &mut Input, name: &str) -> Result<Mesh, Error> {
    const LOOK_BYTES: usize = HEADER_BYTES + 4 * FACET_BYTES;
    let head = input.peek(LOOK_BYTES).map_err(|e| read_error(name, 0, e))?;
    let solid = begins_solid(head) && !is_no_text(head);
    let mut bytes = Vec::new();
    let append = |input: &mut Input, count: u64, bytes: &mut Vec<u8>| {
        let read = input.append(count, bytes);
        read.map_err(|e| read_error(name, input.position(), e))
    };
    if solid {
        append(input, u64::MAX, &mut bytes)?;
    } else {
        // No more than the header claims, or an endless input would be held in memory.
        append(input, HEADER_BYTES as u64, &mut bytes)?;
        if let Some((_, length)) = claimed(&bytes) {
            append(input, length - HEADER_BYTES as u64, &mut bytes)?;
        }
    }
    let found = bytes.len() as u64;
    let fits = claimed(&bytes).is_some_and(|(_, length)| length == found);
    let mut mesh = if solid && !fits {
        read_text(&bytes, name)?
    } else {
        let Some((count, length)) = claimed(&bytes) else {
            return Err(Error::invalid(
                name,
                format!(
                    "{found} bytes found; a binary STL begins with {HEADER_BYTES}, a text one with 'solid'"
                ),
            ));
        };
        if length > found {
            return Err(Error::invalid(
                name,
                format!(
                    "the header claims {count} triangles in {length} bytes, {found} bytes found"
                ),
            )
            .at(80));
        }
        let mut mesh = read_binary(&bytes[HEADER_BYTES..], name)?;
        let more = input.peek(1).map_err(|e| read_error(name, length, e))?;
        if !more.is_empty() {
            mesh.warnings.push(format!(
                "bytes follow the {count} triangles at byte {length}; they are ignored"
            ));
        }
        mesh
    };
    mesh.merge_equal_vertices();
    Ok(mesh)
}

/// The number of triangles in a binary header, and the bytes of the file that follow from it.
fn claimed(bytes: &[u8]) -> Option<(u32, u64)> {
    let count = bytes.get(80..HEADER_BYTES)?;
    let count = u32::from_le_bytes([count[0], count[1], count[2], count[3]]);
    Some((
        count,
        HEADER_BYTES as u64 + FACET_BYTES as u64 * u64::from(count),
    ))
}

/// Adds a triangle whose corners are vertices of its own.
fn push(mesh: &mut Mesh, normal: [f64; 3], corners: [[f64; 3]; 3]) -> Result<(), &'static str> {
    let first = u32::try_from(mesh.vertices.len())
        .ok()
        .filter(|&first| first < u32::MAX - 3)
        .ok_or("more than 2^32 corners of triangles are not read")?;
    mesh.vertices.extend(corners);
    mesh.corners.extend([first, first + 1, first + 2]);
    mesh.end_face()?;
    mesh.face_normals.get_or_insert_default().push(normal);
    Ok(())
}

fn read_binary(facets: &[u8], name: &str) -> Result<Mesh, Error> {
    let mut mesh = Mesh::new(MeshFormat::Stl);
    for (i, facet) in facets.chunks_exact(FACET_BYTES).enumerate() {
        let at = |j: usize| (HEADER_BYTES + i * FACET_BYTES + 4 * j) as u64;
        let mut numbers = [0.0; 12];
        for (j, x) in numbers.iter_mut().enumerate() {
            let b = &facet[4 * j..4 * j + 4];
            *x = f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        }
        if let Some(j) = (3..12).find(|&j| !numbers[j].is_finite()) {
            let what = format!("triangle {i} has a coordinate that is not finite");
            return Err(Error::invalid(name, what).at(at(j)));
        }
        let mut parts = numbers.chunks_exact(3).map(|c| [c[0], c[1], c[2]]);
        let mut next = || parts.next().unwrap_or_default();
        let normal = next();
        // Some writers store NaN where there is no normal.
        let normal = if normal.iter().all(|x| x.is_finite()) {
            normal
        } else {
            [0.0; 3]
        };
        push(&mut mesh, normal, [next(), next(), next()])
            .map_err(|e| Error::unsupported(name, e).at(at(0)))?;
    }
    Ok(mesh)
}

/// The words of a text with their lines.
struct Words<'a> {
    rest: &'a [u8],
    line: u64,
    name: &'a str,
}

impl<'a> Words<'a> {
    fn next(&mut self) -> Option<&'a [u8]> {
        while let Some((first, rest)) = self.rest.split_first() {
            if !first.is_ascii_whitespace() {
                let end = self
                    .rest
                    .iter()
                    .position(u8::is_ascii_whitespace)
                    .unwrap_or(self.rest.len());
                let (word, rest) = self.rest.split_at(end);
                self.rest = rest;
                return Some(word);
            }
            self.line += u64::from(*first == b'\n');
            self.rest = rest;
        }
        None
    }

    fn skip_line(&mut self) {
        let end = self.rest.iter().position(|&b| b == b'\n');
        self.rest = &self.rest[end.unwrap_or(self.rest.len())..];
    }

    fn invalid(&self, message: impl AsRef<str>) -> Error {
        let text = format!("line {}: {}", self.line, message.as_ref());
        Error::invalid(self.name, text)
    }

    fn expect(&mut self, keyword: &str) -> Result<(), Error> {
        match self.next() {
            Some(word) if word.eq_ignore_ascii_case(keyword.as_bytes()) => Ok(()),
            Some(word) => {
                Err(self.invalid(format!("'{}' found, '{keyword}' expected", shown(word))))
            }
            None => Err(self.ends(keyword)),
        }
    }

    fn ends(&self, expected: &str) -> Error {
        self.invalid(format!("the file ends where '{expected}' was expected"))
    }

    fn triple(&mut self, not_finite: Option<f64>) -> Result<[f64; 3], Error> {
        let mut out = [0.0; 3];
        for x in &mut out {
            let word = self.next().ok_or_else(|| self.ends("a number"))?;
            let number: f64 = text(word)
                .parse()
                .map_err(|_| self.invalid(format!("'{}' is not a number", shown(word))))?;
            *x = if number.is_finite() {
                number
            } else {
                not_finite.ok_or_else(|| {
                    self.invalid(format!("'{}' is not a finite number", shown(word)))
                })?
            };
        }
        Ok(out)
    }
}

fn read_text(bytes: &[u8], name: &str) -> Result<Mesh, Error> {
    let mut mesh = Mesh::new(MeshFormat::Stl);
    let mut words = Words {
        rest: bytes,
        line: 1,
        name,
    };
    while let Some(word) = words.next() {
        if !word.eq_ignore_ascii_case(b"solid") {
            return Err(words.invalid(format!("'{}' found, 'solid' expected", shown(word))));
        }
        words.skip_line();
        loop {
            let word = words.next().ok_or_else(|| words.ends("endsolid"))?;
            if word.eq_ignore_ascii_case(b"endsolid") {
                words.skip_line();
                break;
            }
            if !word.eq_ignore_ascii_case(b"facet") {
                return Err(words.invalid(format!(
                    "'{}' found, 'facet' or 'endsolid' expected",
                    shown(word)
                )));
            }
            words.expect("normal")?;
            let normal = words.triple(Some(0.0))?;
            words.expect("outer")?;
            words.expect("loop")?;
            let mut corners = [[0.0; 3]; 3];
            for corner in &mut corners {
                words.expect("vertex")?;
                *corner = words.triple(None)?;
            }
            words.expect("endloop")?;
            words.expect("endfacet")?;
            push(&mut mesh, normal, corners).map_err(|e| words.invalid(e))?;
        }
    }
    Ok(mesh)
}
