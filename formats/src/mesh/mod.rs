//! Polygonal meshes: OBJ, PLY and STL files, whole in memory.
//!
//! In: a path or a stream, perhaps compressed with gzip or zstd. Out: a [`Mesh`]: vertices, faces
//! as cycles of vertices in the order stored, and the normals the file gives for vertices, faces
//! or corners.
//!
//! Guaranteed: indices are in range, every face has at least three corners, coordinates and
//! normals are finite; a count in a header is never believed before the bytes are there; an
//! error names the line, or the byte offset of a binary file. Not guaranteed: anything of
//! geometry or topology (faces may be degenerate, repeated or not planar); and a text file without a
//! count (OBJ) that was cut at the end of a line cannot be told from a whole one.
//!
//! The zero vector stands for a normal that is not given, as it does in STL.

mod obj;
mod ply;
mod stl;
mod text;

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::str::FromStr;

use crate::detect::looks_like_no_mesh;
use crate::error::Error;
use crate::input::decompress;
use crate::input::{Input, read_error};

/// Formats of meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum MeshFormat {
    /// Wavefront OBJ.
    Obj,
    /// PLY (Stanford), ASCII or binary.
    Ply,
    /// STL, ASCII or binary.
    Stl,
}

impl MeshFormat {
    /// The name, as typed and printed: `obj`, `ply`, `stl`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Stl => "stl",
        }
    }
}

impl FromStr for MeshFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        [Self::Obj, Self::Ply, Self::Stl]
            .into_iter()
            .find(|format| format.name() == text)
            .ok_or_else(|| format!("'{text}' is not a format of meshes; obj, ply and stl are"))
    }
}

/// Vertices and faces.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// The format it was read from.
    pub format: MeshFormat,
    /// Positions.
    pub vertices: Vec<[f64; 3]>,
    /// Vertices of the corners of all faces, face after face, in the order stored.
    pub corners: Vec<u32>,
    /// First corner of each face, and one past the last.
    pub face_from: Vec<u32>,
    /// A normal for each vertex, if the file has them; not always of length one.
    pub vertex_normals: Option<Vec<[f64; 3]>>,
    /// A normal for each face, if the file has them.
    pub face_normals: Option<Vec<[f64; 3]>>,
    /// A normal for each corner, if the file has them.
    pub corner_normals: Option<Vec<[f64; 3]>>,
    /// What is strange but readable, a sentence each.
    pub warnings: Vec<String>,
}

impl Mesh {
    fn new(format: MeshFormat) -> Self {
        Self {
            format,
            vertices: Vec::new(),
            corners: Vec::new(),
            face_from: vec![0],
            vertex_normals: None,
            face_normals: None,
            corner_normals: None,
            warnings: Vec::new(),
        }
    }

    /// A mesh made in memory.
    ///
    /// # Panics
    /// If a face has fewer than three corners or names a vertex that is not there.
    #[must_use]
    pub fn from_faces<F: AsRef<[u32]>>(vertices: Vec<[f64; 3]>, faces: &[F]) -> Self {
        let mut mesh = Self::new(MeshFormat::Obj);
        for face in faces {
            let face = face.as_ref();
            assert!(face.len() > 2, "a face has at least three corners");
            assert!(face.iter().all(|&v| (v as usize) < vertices.len()));
            mesh.corners.extend_from_slice(face);
            mesh.face_from.push(mesh.corners.len() as u32);
        }
        mesh.vertices = vertices;
        mesh
    }

    /// Number of faces.
    #[must_use]
    pub fn faces(&self) -> usize {
        self.face_from.len() - 1
    }

    /// The corners of face `f`, as a range of [`Mesh::corners`].
    ///
    /// # Panics
    /// If there is no such face.
    #[must_use]
    pub fn face(&self, f: usize) -> std::ops::Range<usize> {
        self.face_from[f] as usize..self.face_from[f + 1] as usize
    }

    /// Ends a face whose corners were pushed, if there is room for their numbers.
    fn end_face(&mut self) -> Result<(), &'static str> {
        let end = u32::try_from(self.corners.len())
            .map_err(|_| "more than 2^32 corners of faces are not read")?;
        self.face_from.push(end);
        Ok(())
    }

    /// Makes vertices at exactly the same place one vertex; gives how many went away. Normals of
    /// vertices become normals of corners, so that none is lost.
    pub fn merge_equal_vertices(&mut self) -> usize {
        if let Some(normals) = self.vertex_normals.take() {
            let of_corners = self.corners.iter().map(|&v| normals[v as usize]);
            self.corner_normals = Some(of_corners.collect());
        }
        let mut numbers: HashMap<[u64; 3], u32> = HashMap::with_capacity(self.vertices.len());
        let mut kept = Vec::new();
        let mut number_of = Vec::with_capacity(self.vertices.len());
        for &vertex in &self.vertices {
            let number = *numbers.entry(place(vertex)).or_insert_with(|| {
                kept.push(vertex);
                kept.len() as u32 - 1
            });
            number_of.push(number);
        }
        for corner in &mut self.corners {
            *corner = number_of[*corner as usize];
        }
        let gone = self.vertices.len() - kept.len();
        self.vertices = kept;
        gone
    }

    /// What every reader ends with: something must be there.
    fn finish(self, name: &str) -> Result<Self, Error> {
        if self.faces() == 0 {
            return Err(Error::invalid(
                name,
                format!("holds no faces ({} vertices)", self.vertices.len()),
            ));
        }
        Ok(self)
    }
}

/// The bits of a place; 0 and -0 are one place.
fn place(vertex: [f64; 3]) -> [u64; 3] {
    vertex.map(|x| (x + 0.0).to_bits())
}

/// Reads the mesh in the file at `path`.
///
/// # Errors
///
/// If the file cannot be read, is of no known format (and none is given), or is damaged.
pub fn open_mesh(path: &Path, format: Option<MeshFormat>) -> Result<Mesh, Error> {
    let name = path.display().to_string();
    let cannot_open = |e| Error::io(&name, "cannot be opened", e);
    if std::fs::metadata(path).map_err(cannot_open)?.is_dir() {
        return Err(Error::unsupported(
            &name,
            "is a folder; a file was expected",
        ));
    }
    let file = File::open(path).map_err(cannot_open)?;
    read_mesh(Box::new(file), &name, format)
}

/// Reads the mesh in a stream; `name` names it in messages, and its ending decides where the
/// content does not.
///
/// # Errors
///
/// As [`open_mesh`].
pub fn read_mesh(
    reader: Box<dyn Read + Send>,
    name: &str,
    format: Option<MeshFormat>,
) -> Result<Mesh, Error> {
    let (mut input, _) = decompress(Input::new(reader), name)?;
    let format = match format {
        Some(format) => format,
        None => detect(&mut input, name)?,
    };
    let mut mesh = match format {
        MeshFormat::Obj => obj::read(&mut input, name),
        MeshFormat::Ply => ply::read(&mut input, name),
        MeshFormat::Stl => stl::read(&mut input, name),
    }?
    .finish(name)?;
    mesh.warnings.extend(input.notes());
    Ok(mesh)
}

/// The format of meshes that a file has, by its first bytes or its name; `None` if it is something else, cannot
/// be read, or could be anything: a binary STL under another name has nothing to know it by.
#[must_use]
pub fn recognise_mesh(path: &Path) -> Option<MeshFormat> {
    if !path.is_file() {
        return None;
    }
    let name = path.display().to_string();
    let file = File::open(path).ok()?;
    let (mut input, _) = decompress(Input::new(file), &name).ok()?;
    let head = input.peek(HEAD_BYTES).ok()?;
    by_head_or_name(head, &name).ok()?
}

/// Bytes that decide the format.
const HEAD_BYTES: usize = 1024;

/// The format by the first bytes, then by the ending of the name, then by the first word. An error is
/// the name of another format the content has.
fn by_head_or_name(head: &[u8], name: &str) -> Result<Option<MeshFormat>, String> {
    if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
        return Ok(Some(MeshFormat::Ply));
    }
    if stl::begins_solid(head) {
        return Ok(Some(MeshFormat::Stl));
    }
    if let Some(other) = looks_like_no_mesh(head) {
        return Err(other);
    }
    let lower = name.to_ascii_lowercase();
    let stem = lower
        .strip_suffix(".gz")
        .or_else(|| lower.strip_suffix(".zst"))
        .unwrap_or(&lower);
    for format in [MeshFormat::Obj, MeshFormat::Ply, MeshFormat::Stl] {
        let ending = stem.strip_suffix(format.name());
        if ending.is_some_and(|rest| rest.ends_with('.')) {
            return Ok(Some(format));
        }
    }
    Ok(obj::looks_like(head).then_some(MeshFormat::Obj))
}

/// The format, of which something is expected to be there.
fn detect(input: &mut Input, name: &str) -> Result<MeshFormat, Error> {
    let head = input.peek(HEAD_BYTES).map_err(|e| read_error(name, 0, e))?;
    let found = by_head_or_name(head, name).map_err(|other| {
        Error::unsupported(name, format!("not a mesh: the content looks like {other}"))
    })?;
    if let Some(format) = found {
        return Ok(format);
    }
    // Binary STL has no magic number; that its length fits is checked by its reader.
    if head.contains(&0) && head.len() >= stl::HEADER_BYTES {
        return Ok(MeshFormat::Stl);
    }
    let shown: Vec<_> = head.iter().take(8).map(|b| format!("{b:02x}")).collect();
    Err(Error::unsupported(
        name,
        format!(
            "the format is not recognised (first bytes {}); expected a mesh as OBJ, PLY or STL",
            shown.join(" ")
        ),
    ))
}
