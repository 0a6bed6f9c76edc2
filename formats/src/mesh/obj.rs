//! Wavefront OBJ: vertices, normals and polygons.
//!
//! In: text. Out: a mesh. Read are `v` (the first three numbers), `vn` and `f` with all forms of
//! a corner: `v`, `v/vt`, `v//vn`, `v/vt/vn`, counted from 1, or from the end with negative
//! numbers; a backslash at the end of a line joins the next. Ignored are texture coordinates, names, groups,
//! smoothing, materials, points and lines; anything else is ignored with a warning. An index
//! must name what stands above it in the file.
//!
//! Normals belong to corners here. A corner without one has the zero vector.

use std::collections::BTreeMap;

use crate::error::Error;
use crate::input::Input;

use super::text::{Lines, shown, text, words};
use super::{Mesh, MeshFormat};

/// Statements that say nothing of the surface.
const IGNORED: [&[u8]; 12] = [
    b"vt", b"vp", b"o", b"g", b"s", b"mtllib", b"usemtl", b"p", b"l", b"usemap", b"lod", b"mg",
];

/// Whether text begins as OBJ files do: the first statement is one of OBJ.
pub(super) fn looks_like(head: &[u8]) -> bool {
    for line in head.split(|&b| b == b'\n') {
        match words(line).next() {
            None => {}
            Some(word) if word[0] == b'#' => {}
            Some(word) => {
                return [&b"v"[..], b"vn", b"f"].contains(&word) || IGNORED.contains(&word);
            }
        }
    }
    false
}

pub(super) fn read(input: &mut Input, name: &str) -> Result<Mesh, Error> {
    let mut lines = Lines::new(input, name);
    let mut mesh = Mesh::new(MeshFormat::Obj);
    let mut normals: Vec<[f64; 3]> = Vec::new();
    let mut of_corners: Vec<[f64; 3]> = Vec::new();
    let mut strange: BTreeMap<String, u64> = BTreeMap::new();
    while lines.advance()? {
        while lines.line().trim_ascii_end().ends_with(b"\\") && lines.join_next()? {}
        let mut words = lines.words();
        let Some(keyword) = words.next() else {
            continue;
        };
        match keyword {
            b"v" => {
                let vertex = lines.triple("a vertex", words)?;
                if !vertex.iter().all(|x| x.is_finite()) {
                    return Err(lines.invalid("a coordinate is not finite"));
                }
                if mesh.vertices.len() >= u32::MAX as usize {
                    return Err(lines.invalid("more than 2^32 vertices are not read"));
                }
                mesh.vertices.push(vertex);
            }
            b"vn" => {
                let normal = lines.triple("a normal", words)?;
                // Some writers store NaN where there is no normal.
                let finite = normal.iter().all(|x| x.is_finite());
                normals.push(if finite { normal } else { [0.0; 3] });
            }
            b"f" => {
                let first = mesh.corners.len();
                for word in words {
                    let (vertex, normal) =
                        corner(&lines, word, mesh.vertices.len(), normals.len())?;
                    mesh.corners.push(vertex);
                    of_corners.push(normal.map_or([0.0; 3], |n| normals[n]));
                }
                let corners = mesh.corners.len() - first;
                if corners < 3 {
                    return Err(
                        lines.invalid(format!("a face of {corners} corners; 3 or more expected"))
                    );
                }
                mesh.end_face().map_err(|e| lines.invalid(e))?;
            }
            word if word[0] == b'#' || IGNORED.contains(&word) => {}
            word => {
                const MOST_KINDS: usize = 8;
                let word = shown(word);
                if strange.len() < MOST_KINDS || strange.contains_key(&word) {
                    *strange.entry(word).or_default() += 1;
                }
            }
        }
    }
    if !lines.ended() {
        mesh.warnings
            .push("the last line has no line end: the file may have been cut".into());
    }
    if !strange.is_empty() {
        let list: Vec<_> = strange
            .iter()
            .map(|(word, count)| format!("'{word}' ({count})"))
            .collect();
        mesh.warnings
            .push(format!("statements that are not read: {}", list.join(", ")));
    }
    if of_corners.iter().any(|n| *n != [0.0; 3]) {
        mesh.corner_normals = Some(of_corners);
    }
    Ok(mesh)
}

/// Numbers of the vertex and the normal of a corner: `v`, `v/vt`, `v//vn` or `v/vt/vn`.
fn corner(
    lines: &Lines<'_>,
    word: &[u8],
    vertices: usize,
    normals: usize,
) -> Result<(u32, Option<usize>), Error> {
    let mut parts = word.split(|&b| b == b'/');
    let (vertex, texture, normal) = (parts.next(), parts.next(), parts.next());
    if parts.next().is_some() {
        return Err(lines.invalid(format!(
            "the corner '{}' has more than two slashes",
            shown(word)
        )));
    }
    if let Some(texture) = texture.filter(|t| !t.is_empty())
        && text(texture).parse::<i64>().is_err()
    {
        return Err(lines.invalid(format!("the corner '{}' is no index", shown(word))));
    }
    let vertex = index(lines, vertex.unwrap_or(b""), vertices, "vertices")?;
    let normal = match normal {
        None | Some(b"") => None,
        Some(normal) => Some(index(lines, normal, normals, "normals")?),
    };
    // There are at most 2^32 - 1 vertices.
    Ok((vertex as u32, normal))
}

fn index(lines: &Lines<'_>, word: &[u8], count: usize, what: &str) -> Result<usize, Error> {
    let number: i64 = text(word)
        .parse()
        .map_err(|_| lines.invalid(format!("'{}' is no index of {what}", shown(word))))?;
    // Counts are below 2^63.
    let found = match number {
        1.. => number - 1,
        0 => -1,
        _ => number.saturating_add(count as i64),
    };
    usize::try_from(found)
        .ok()
        .filter(|&found| found < count)
        .ok_or_else(|| {
            lines.invalid(format!(
                "index {number} names none of the {count} {what} above"
            ))
        })
}
