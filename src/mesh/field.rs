//! Corrected normal fields on meshes.
//!
//! Comes in: a surface, the normals of its file, and what to take. Goes out: [`NormalField`]: a unit
//! vector for each face, or one for each umbrella (vertex) to interpolate between.
//!
//! | normals | constant field: u of a face | interpolated field: u at a vertex |
//! |---|---|---|
//! | given for faces | as given | mean of the faces around, weighted by their angles |
//! | given for vertices or corners | mean of its corners | as given; mean where corners differ |
//! | faces | the naive normal | as for given faces |
//! | vertices | mean of its corners | mean of the naive normals around, weighted by angles |
//!
//! Unless a field is asked for, normals of vertices are interpolated ([`NormalSource::suitable_field`]): the means
//! of a constant field lose what varies over a face, and its sums, which lie on edges and vertices, jump
//! as these enter the ball.
//!
//! Angles as weights make the mean independent of how polygons are cut into triangles
//! (Thürmer and Wüthrich, 1998). Every mean is of unit vectors, made a unit vector. Where a
//! file gives the zero vector, or vectors cancel, the naive normal is taken and the face is marked.

use curvox_formats::mesh::{Mesh, MeshFormat};
use glam::DVec3;

use crate::measure::field::Field;

use super::surface::{Flip, MeshSurface};

/// Which normals to take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NormalSource {
    /// `Given` where the file has normals, else `Vertices`. The facet normals of STL are the naive
    /// ones by definition of that format, and do not count here.
    #[default]
    Auto,
    /// Those of the file.
    Given,
    /// The naive normals of the faces: gives the normal cycle.
    Faces,
    /// Means of the naive normals around each vertex.
    Vertices,
}

impl NormalSource {
    /// The field that suits these normals: interpolated between those of vertices, constant where they
    /// are those of faces, also if a file repeats them at the corners of each face.
    #[must_use]
    pub fn suitable_field(self, mesh: &Mesh) -> Field {
        match choose(mesh, self, Field::Interpolated) {
            Some(UsedNormals::Vertices | UsedNormals::GivenVertices) => Field::Interpolated,
            Some(UsedNormals::GivenCorners) if !same_within_faces(mesh) => Field::Interpolated,
            _ => Field::Constant,
        }
    }
}

/// Whether the corners of each face have one normal.
fn same_within_faces(mesh: &Mesh) -> bool {
    let normals = mesh.corner_normals.as_deref().unwrap_or_default();
    (0..mesh.faces()).all(|f| {
        let of_face = normals.get(mesh.face(f)).unwrap_or_default();
        of_face.windows(2).all(|pair| pair[0] == pair[1])
    })
}

/// Where the normals came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UsedNormals {
    /// The file, for faces.
    GivenFaces,
    /// The file, for vertices.
    GivenVertices,
    /// The file, for corners.
    GivenCorners,
    /// The naive normals.
    Faces,
    /// Means around vertices.
    Vertices,
}

impl UsedNormals {
    /// A few words.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::GivenFaces => "given for faces",
            Self::GivenVertices => "given for vertices",
            Self::GivenCorners => "given for corners",
            Self::Faces => "naive normals of faces",
            Self::Vertices => "means of naive normals around vertices, weighted by angles",
        }
    }
}

/// A corrected normal field.
#[derive(Clone, Debug)]
pub struct NormalField {
    /// Its kind.
    pub field: Field,
    /// Where its vectors came from.
    pub used: UsedNormals,
    /// A unit vector for each face: u itself, or the mean of its corners.
    pub of_face: Vec<DVec3>,
    /// A unit vector for each umbrella; empty for a constant field.
    pub of_umbrella: Vec<DVec3>,
    /// Faces where a vector was missing and the naive normal was taken.
    pub degenerate: Vec<bool>,
}

impl NormalField {
    /// Finds the vectors. `None` if normals of the file are asked for and it has none.
    #[must_use]
    pub fn new(
        mesh: &Mesh,
        surface: &MeshSurface,
        source: NormalSource,
        field: Field,
        flip: Flip,
    ) -> Option<Self> {
        let used = choose(mesh, source, field)?;
        let mut degenerate = vec![false; surface.faces()];
        let sign = if flip.normals { -1.0 } else { 1.0 };
        let unit = |n: [f64; 3]| (DVec3::from(n) * sign).try_normalize();

        // A vector for each corner, or for each face.
        let faces = |degenerate: &mut [bool], given: Option<&Vec<[f64; 3]>>| -> Vec<DVec3> {
            (0..surface.faces())
                .map(|f| {
                    let number = surface.file_number[f] as usize;
                    let found = given.map_or(Some(surface.normal[f]), |given| unit(given[number]));
                    degenerate[f] |= found.is_none() || given.is_none() && surface.flat[f];
                    found.unwrap_or(surface.normal[f])
                })
                .collect()
        };
        let corners = |degenerate: &mut [bool], given: &dyn Fn(usize) -> [f64; 3]| -> Vec<DVec3> {
            (0..surface.vertex_of.len())
                .map(|c| {
                    let f = surface.face_of[c] as usize;
                    let found = unit(given(c));
                    degenerate[f] |= found.is_none();
                    found.unwrap_or(surface.normal[f])
                })
                .collect()
        };
        let missing = Vec::new();
        let of_vertices = mesh.vertex_normals.as_ref().unwrap_or(&missing);
        let of_corners = mesh.corner_normals.as_ref().unwrap_or(&missing);
        let (of_face, of_umbrella) = match used {
            UsedNormals::GivenFaces | UsedNormals::Faces => {
                let given = (used == UsedNormals::GivenFaces)
                    .then_some(mesh.face_normals.as_ref())
                    .flatten();
                let of_face = faces(&mut degenerate, given);
                let around = |c: usize| of_face[surface.face_of[c] as usize] * surface.angle(c);
                let of_umbrella = match field {
                    Field::Constant => Vec::new(),
                    _ => umbrella_means(surface, around),
                };
                (of_face, of_umbrella)
            }
            UsedNormals::Vertices => {
                let around =
                    |c: usize| surface.normal[surface.face_of[c] as usize] * surface.angle(c);
                (Vec::new(), umbrella_means(surface, around))
            }
            UsedNormals::GivenVertices => {
                let given = |c: usize| of_vertices[surface.vertex_of[c] as usize];
                let u = corners(&mut degenerate, &given);
                (Vec::new(), umbrella_means(surface, |c| u[c]))
            }
            UsedNormals::GivenCorners => {
                let given = |c: usize| of_corners[surface.file_corner[c] as usize];
                let u = corners(&mut degenerate, &given);
                if field == Field::Constant {
                    // Corners of a vertex may differ, so not by way of the vertices.
                    let of_face = face_means(surface, &mut degenerate, |c| u[c]);
                    (of_face, Vec::new())
                } else {
                    (Vec::new(), umbrella_means(surface, |c| u[c]))
                }
            }
        };
        // With vectors at vertices, a face has the mean of its corners.
        let of_face = if of_umbrella.is_empty() || (!of_face.is_empty() && field == Field::Constant)
        {
            of_face
        } else {
            let at = |c: usize| of_umbrella[surface.umbrella_of[c] as usize];
            face_means(surface, &mut degenerate, at)
        };
        Some(Self {
            field,
            used,
            of_face,
            of_umbrella: if field == Field::Constant {
                Vec::new()
            } else {
                of_umbrella
            },
            degenerate,
        })
    }

    /// u at a corner, and in the middle of a face, of an interpolated field.
    pub(super) fn at_corner(&self, surface: &MeshSurface, c: usize) -> DVec3 {
        self.of_umbrella[surface.umbrella_of[c] as usize]
    }
}

fn choose(mesh: &Mesh, source: NormalSource, field: Field) -> Option<UsedNormals> {
    let at_corners = match (&mesh.corner_normals, &mesh.vertex_normals) {
        (Some(_), _) => Some(UsedNormals::GivenCorners),
        (None, Some(_)) => Some(UsedNormals::GivenVertices),
        (None, None) => None,
    };
    let at_faces = mesh.face_normals.as_ref().map(|_| UsedNormals::GivenFaces);
    let given = match field {
        Field::Constant => at_faces.or(at_corners),
        Field::Interpolated | Field::Linear => at_corners.or(at_faces),
    };
    match source {
        NormalSource::Given => given,
        NormalSource::Faces => Some(UsedNormals::Faces),
        NormalSource::Vertices => Some(UsedNormals::Vertices),
        NormalSource::Auto if mesh.format == MeshFormat::Stl => Some(UsedNormals::Vertices),
        NormalSource::Auto => given.or(Some(UsedNormals::Vertices)),
    }
}

/// The direction of the sum; the vector itself where all are the same, without rounding.
#[derive(Clone, Copy, Default)]
struct Mean {
    first: Option<DVec3>,
    differ: bool,
    sum: DVec3,
}

impl Mean {
    fn add(&mut self, v: DVec3) {
        let first = *self.first.get_or_insert(v);
        self.differ |= first != v;
        self.sum += v;
    }

    fn direction(&self) -> Option<DVec3> {
        // A sum of unit vectors shorter than this is what is left of their rounding.
        const CANCELLED: f64 = 1e-12;
        match self.first {
            Some(first) if !self.differ => first.try_normalize().map(|u| {
                let unit = (first.length_squared() - 1.0).abs() < 1e-15;
                if unit { first } else { u }
            }),
            _ => (self.sum.length() > CANCELLED)
                .then(|| self.sum.try_normalize())
                .flatten(),
        }
    }
}

/// The mean direction around each umbrella. Where vectors cancel, that of one of them.
fn umbrella_means(surface: &MeshSurface, at: impl Fn(usize) -> DVec3) -> Vec<DVec3> {
    let mut means = vec![Mean::default(); surface.closed_umbrella.len()];
    for c in 0..surface.vertex_of.len() {
        means[surface.umbrella_of[c] as usize].add(at(c));
    }
    means
        .iter()
        .map(|mean| {
            let any = || mean.first.and_then(|v| v.try_normalize());
            mean.direction().or_else(any).unwrap_or(DVec3::Z)
        })
        .collect()
}

fn face_means(
    surface: &MeshSurface,
    degenerate: &mut [bool],
    at: impl Fn(usize) -> DVec3,
) -> Vec<DVec3> {
    (0..surface.faces())
        .map(|f| {
            let mut mean = Mean::default();
            surface.corners(f).for_each(|c| mean.add(at(c)));
            let found = mean.direction();
            degenerate[f] |= found.is_none();
            found.unwrap_or(surface.normal[f])
        })
        .collect()
}
