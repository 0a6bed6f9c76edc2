//! A mesh as a surface: which faces meet where, and what is wrong with it.
//!
//! Comes in: vertices and cycles of corners. Goes out: [`MeshSurface`], in which corner c stands for
//! three things: a corner of a face, the *half-edge* from it to the next corner of the face, and a
//! place in an *umbrella*, the faces around a vertex that hang together by edges.
//!
//! ```text
//!            a                     half-edge c runs v -> b, the one before it a -> v
//!           / \  f  (the face)     link[c]: the half-edge b -> v of the face across
//!          v---b                   the next face of the umbrella, counter-clockwise,
//!            c ->                  lies across a -> v
//! ```
//!
//! Guaranteed: linked half-edges are the only two on their edge and run in opposite directions. At a
//! vertex where the surface touches itself each umbrella is a vertex of its own, so V - E + F
//! is that of the surface taken apart there, as on digital surfaces. Corners that repeat the
//! one before are dropped, and with them faces of fewer than three corners: they have no area
//! and their neighbours meet without them.

use curvox_formats::mesh::Mesh;
use glam::DVec3;
use libm::atan2;

/// No half-edge: the edge is a border.
pub(super) const NONE: u32 = u32::MAX;

/// A vertex of a face farther than this from its plane, in diameters of the face, makes it not
/// planar. Less would report the rounding of files with six digits.
const PLANAR: f64 = 1e-5;

/// What to turn round before anything else.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flip {
    /// Faces: the order of their corners.
    pub faces: bool,
    /// Normals that the file gives.
    pub normals: bool,
}

/// How faces meet at an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// Two faces that run through it in opposite directions.
    Inner,
    /// One face.
    Border,
    /// Three faces or more.
    NonManifold,
    /// Two faces that run through it in the same direction: one of them is turned over.
    Inconsistent,
}

/// What is wrong with a mesh, in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Defects {
    /// Edges of one face.
    pub border_edges: u64,
    /// Edges of three faces or more.
    pub non_manifold_edges: u64,
    /// Edges of two faces that run through it in the same direction.
    pub inconsistent_edges: u64,
    /// Vertices where several umbrellas touch.
    pub non_manifold_vertices: u64,
    /// Vertices of no face.
    pub unused_vertices: u64,
    /// Faces of fewer than three different corners, which are left out.
    pub collapsed_faces: u64,
    /// Faces without area.
    pub zero_area_faces: u64,
    /// Faces on the same vertices as an earlier one.
    pub duplicate_faces: u64,
    /// Faces whose corners do not lie in a plane.
    pub non_planar_faces: u64,
}

/// A mesh, ready for measures.
#[derive(Clone, Debug)]
pub struct MeshSurface {
    /// Positions.
    pub vertices: Vec<DVec3>,
    /// The vertex of each corner.
    pub vertex_of: Vec<u32>,
    /// The face of each corner.
    pub face_of: Vec<u32>,
    /// First corner of each face, and one past the last.
    pub face_from: Vec<u32>,
    /// Number of each face in the file.
    pub file_number: Vec<u32>,
    /// Corner of the file that each corner is.
    pub(super) file_corner: Vec<u32>,
    /// Area of each face times its unit normal (half the sum of p x q along its edges).
    pub vector_area: Vec<DVec3>,
    /// Unit normal of each face; where there is no area, some normal to its longest edge.
    pub normal: Vec<DVec3>,
    /// Whether a face has no area.
    pub(super) flat: Vec<bool>,
    /// Mean of the corners of each face.
    pub centroid: Vec<DVec3>,
    /// The half-edge across each half-edge, or [`NONE`].
    pub(super) link: Vec<u32>,
    /// How faces meet at each half-edge.
    pub kind: Vec<EdgeKind>,
    /// Number of the edge of each half-edge; half-edges of borders have one each.
    pub edge_of: Vec<u32>,
    /// A half-edge of each edge: the lower of the two.
    pub edges: Vec<u32>,
    /// Number of the umbrella of each corner.
    pub umbrella_of: Vec<u32>,
    /// The corner of the lowest number of each umbrella.
    pub(super) umbrella_from: Vec<u32>,
    /// Of each umbrella, whether it is a closed cycle.
    pub closed_umbrella: Vec<bool>,
    /// What is wrong.
    pub defects: Defects,
}

impl MeshSurface {
    /// Finds how the faces of a mesh meet.
    #[must_use]
    pub fn new(mesh: &Mesh, flip: Flip) -> Self {
        let mut surface = Self {
            vertices: mesh.vertices.iter().map(|&v| DVec3::from(v)).collect(),
            vertex_of: Vec::with_capacity(mesh.corners.len()),
            face_of: Vec::with_capacity(mesh.corners.len()),
            face_from: vec![0],
            file_number: Vec::with_capacity(mesh.faces()),
            file_corner: Vec::with_capacity(mesh.corners.len()),
            vector_area: Vec::new(),
            normal: Vec::new(),
            flat: Vec::new(),
            centroid: Vec::new(),
            link: Vec::new(),
            kind: Vec::new(),
            edge_of: Vec::new(),
            edges: Vec::new(),
            umbrella_of: Vec::new(),
            umbrella_from: Vec::new(),
            closed_umbrella: Vec::new(),
            defects: Defects::default(),
        };
        surface.take_faces(mesh, flip);
        surface.measure_faces();
        surface.link_edges();
        surface.find_umbrellas();
        surface.count_duplicates();
        surface
    }

    /// Number of faces.
    #[must_use]
    pub fn faces(&self) -> usize {
        self.file_number.len()
    }

    /// The corners of a face.
    ///
    /// # Panics
    /// If there is no such face.
    #[must_use]
    pub fn corners(&self, face: usize) -> std::ops::Range<usize> {
        self.face_from[face] as usize..self.face_from[face + 1] as usize
    }

    /// The corner after `c` in its face.
    #[must_use]
    pub fn after(&self, c: usize) -> usize {
        let range = self.corners(self.face_of[c] as usize);
        if c + 1 == range.end {
            range.start
        } else {
            c + 1
        }
    }

    /// The corner before `c` in its face.
    #[must_use]
    pub fn before(&self, c: usize) -> usize {
        let range = self.corners(self.face_of[c] as usize);
        if c == range.start {
            range.end - 1
        } else {
            c - 1
        }
    }

    /// The place of a corner.
    #[must_use]
    pub fn place(&self, c: usize) -> DVec3 {
        self.vertices[self.vertex_of[c] as usize]
    }

    /// The half-edge across, where exactly two faces meet.
    #[must_use]
    pub fn across(&self, c: usize) -> Option<usize> {
        let link = self.link[c];
        (link != NONE).then_some(link as usize)
    }

    /// Whether every edge joins two faces.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.link.iter().all(|&link| link != NONE)
    }

    /// V - E + F, with a vertex for each umbrella and an edge for each half-edge on a border.
    #[must_use]
    pub fn euler(&self) -> i64 {
        // Each is at most 2^32.
        self.closed_umbrella.len() as i64 - self.edges.len() as i64 + self.faces() as i64
    }

    /// Volume inside; of use on closed meshes alone. Negative if the faces point inward.
    #[must_use]
    pub fn volume(&self) -> f64 {
        // From the middle of the mesh, or far from the origin little would be left of the digits.
        let count = self.vertices.len().max(1) as f64;
        let middle = self.vertices.iter().sum::<DVec3>() / count;
        let mut six_fold = 0.0;
        for face in 0..self.faces() {
            let apex = self.centroid[face] - middle;
            for c in self.corners(face) {
                let (p, q) = (self.place(c) - middle, self.place(self.after(c)) - middle);
                six_fold += apex.dot(p.cross(q));
            }
        }
        six_fold / 6.0
    }

    /// Area, as the faces have it.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.vector_area.iter().map(|a| a.length()).sum()
    }

    /// Mean length of the edges.
    #[must_use]
    pub fn mean_edge(&self) -> f64 {
        let lengths = self.edges.iter().map(|&c| {
            let c = c as usize;
            self.place(c).distance(self.place(self.after(c)))
        });
        lengths.sum::<f64>() / self.edges.len() as f64
    }

    /// Diagonal of the bounding box of the vertices of faces.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &v in &self.vertex_of {
            low = low.min(self.vertices[v as usize]);
            high = high.max(self.vertices[v as usize]);
        }
        low.distance(high)
    }

    /// Unit normal of the triangle of half-edge `c` and the centroid of its face, or of the face if
    /// that is a triangle. Where the triangle has no area, normal to it all the same.
    pub(super) fn side_normal(&self, c: usize) -> DVec3 {
        let face = self.face_of[c] as usize;
        if self.corners(face).len() == 3 {
            return self.normal[face];
        }
        let (p, q) = (self.place(c), self.place(self.after(c)));
        let (p, q) = (p - self.centroid[face], q - self.centroid[face]);
        let cross = p.cross(q);
        if cross.length() > NO_AREA * (p.length_squared() + q.length_squared()) {
            cross.normalize()
        } else {
            normal_to(q - p, self.normal[face])
        }
    }

    /// Angle at corner `c` of its face, by way of the centroid if the face is no triangle.
    pub(super) fn angle(&self, c: usize) -> f64 {
        let here = self.place(c);
        let next = self.place(self.after(c)) - here;
        let last = self.place(self.before(c)) - here;
        let face = self.face_of[c] as usize;
        if self.corners(face).len() == 3 {
            return angle_between(next, last);
        }
        let middle = self.centroid[face] - here;
        angle_between(next, middle) + angle_between(middle, last)
    }

    fn take_faces(&mut self, mesh: &Mesh, flip: Flip) {
        let mut used = vec![false; mesh.vertices.len()];
        for f in 0..mesh.faces() {
            let range = mesh.face(f);
            let first = self.vertex_of.len();
            let mut take = |c: usize| {
                let v = mesh.corners[c];
                used[v as usize] = true;
                if self.vertex_of.len() == first || self.vertex_of.last() != Some(&v) {
                    self.vertex_of.push(v);
                    self.file_corner.push(c as u32);
                }
            };
            if flip.faces {
                range.rev().for_each(&mut take);
            } else {
                range.for_each(&mut take);
            }
            while self.vertex_of.len() > first + 1
                && self.vertex_of.last() == Some(&self.vertex_of[first])
            {
                self.vertex_of.pop();
                self.file_corner.pop();
            }
            if self.vertex_of.len() - first < 3 {
                self.vertex_of.truncate(first);
                self.file_corner.truncate(first);
                self.defects.collapsed_faces += 1;
                continue;
            }
            let number = self.file_number.len() as u32;
            self.face_of.resize(self.vertex_of.len(), number);
            self.face_from.push(self.vertex_of.len() as u32);
            self.file_number.push(f as u32);
        }
        self.defects.unused_vertices = used.iter().filter(|used| !**used).count() as u64;
    }

    fn measure_faces(&mut self) {
        for face in 0..self.faces() {
            let range = self.corners(face);
            let places: Vec<DVec3> = range.map(|c| self.place(c)).collect();
            let centroid = places.iter().sum::<DVec3>() / places.len() as f64;
            let mut twice = DVec3::ZERO;
            let (mut longest, mut size) = (DVec3::ZERO, 0.0f64);
            for (i, &p) in places.iter().enumerate() {
                let q = places[(i + 1) % places.len()];
                twice += (p - centroid).cross(q - centroid);
                if (q - p).length_squared() > longest.length_squared() {
                    longest = q - p;
                }
                size = size.max(p.distance(centroid));
            }
            let flat = twice.length() <= NO_AREA * longest.length_squared();
            let normal = if flat {
                self.defects.zero_area_faces += 1;
                normal_to(longest, DVec3::ZERO)
            } else {
                twice.normalize()
            };
            let far = |p: &DVec3| (*p - centroid).dot(normal).abs() > PLANAR * size;
            self.defects.non_planar_faces += u64::from(!flat && places.iter().any(far));
            self.flat.push(flat);
            self.centroid.push(centroid);
            self.vector_area.push(0.5 * twice);
            self.normal.push(normal);
        }
    }

    fn link_edges(&mut self) {
        let half_edges = self.vertex_of.len();
        // By the two vertices, the lower first; then by number, so nothing depends on the sort.
        let mut keyed: Vec<(u64, u32)> = (0..half_edges)
            .map(|c| {
                let (a, b) = (self.vertex_of[c], self.vertex_of[self.after(c)]);
                (u64::from(a.min(b)) << 32 | u64::from(a.max(b)), c as u32)
            })
            .collect();
        keyed.sort_unstable();
        self.link = vec![NONE; half_edges];
        self.kind = vec![EdgeKind::Border; half_edges];
        for group in keyed.chunk_by(|a, b| a.0 == b.0) {
            let kind = match *group {
                [_] => EdgeKind::Border,
                [(_, a), (_, b)] => {
                    if self.vertex_of[a as usize] == self.vertex_of[b as usize] {
                        EdgeKind::Inconsistent
                    } else {
                        self.link[a as usize] = b;
                        self.link[b as usize] = a;
                        EdgeKind::Inner
                    }
                }
                _ => EdgeKind::NonManifold,
            };
            for &(_, c) in group {
                self.kind[c as usize] = kind;
            }
            match kind {
                EdgeKind::Inner => {}
                EdgeKind::Border => self.defects.border_edges += 1,
                EdgeKind::NonManifold => self.defects.non_manifold_edges += 1,
                EdgeKind::Inconsistent => self.defects.inconsistent_edges += 1,
            }
        }
        self.edge_of = vec![NONE; half_edges];
        for c in 0..half_edges {
            match self.across(c) {
                Some(d) if d < c => self.edge_of[c] = self.edge_of[d],
                _ => {
                    self.edge_of[c] = self.edges.len() as u32;
                    self.edges.push(c as u32);
                }
            }
        }
    }

    fn find_umbrellas(&mut self) {
        let corners = self.vertex_of.len();
        self.umbrella_of = vec![NONE; corners];
        let mut umbrellas_at = vec![0u32; self.vertices.len()];
        for start in 0..corners {
            if self.umbrella_of[start] != NONE {
                continue;
            }
            let number = self.closed_umbrella.len() as u32;
            umbrellas_at[self.vertex_of[start] as usize] += 1;
            let mut at = start;
            let closed = loop {
                self.umbrella_of[at] = number;
                // Counter-clockwise: across the half-edge that ends here.
                match self.across(self.before(at)) {
                    Some(next) if next == start => break true,
                    Some(next) => at = next,
                    None => break false,
                }
            };
            at = start;
            while !closed && let Some(last) = self.across(at) {
                at = self.after(last);
                self.umbrella_of[at] = number;
            }
            self.umbrella_from.push(start as u32);
            self.closed_umbrella.push(closed);
        }
        self.defects.non_manifold_vertices = umbrellas_at.iter().filter(|&&n| n > 1).count() as u64;
    }

    fn count_duplicates(&mut self) {
        let sorted = |face: usize| {
            let mut vertices = self.vertex_of[self.corners(face)].to_vec();
            vertices.sort_unstable();
            vertices
        };
        let mut keyed: Vec<(u64, usize)> = (0..self.faces())
            .map(|face| {
                let key = sorted(face).iter().fold(0u64, |key, &v| {
                    (key ^ u64::from(v))
                        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
                        .rotate_left(29)
                });
                (key, face)
            })
            .collect();
        keyed.sort_unstable();
        let mut count = 0;
        for group in keyed.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() > 1) {
            let mut lists: Vec<_> = group.iter().map(|&(_, face)| sorted(face)).collect();
            lists.sort_unstable();
            count += lists.windows(2).filter(|pair| pair[0] == pair[1]).count() as u64;
        }
        self.defects.duplicate_faces = count;
    }
}

/// Twice an area below this share of the square of a length is rounding.
const NO_AREA: f64 = 1e-14;

/// Angle between two vectors, in [0, pi].
fn angle_between(a: DVec3, b: DVec3) -> f64 {
    atan2(a.cross(b).length(), a.dot(b))
}

/// A unit vector normal to `edge`, the one nearest to `wish` if that says anything.
fn normal_to(edge: DVec3, wish: DVec3) -> DVec3 {
    let along = edge.normalize_or(DVec3::X);
    let across = wish - along * wish.dot(along);
    if across.length_squared() > 1e-6 {
        across.normalize()
    } else {
        along.any_orthonormal_vector()
    }
}
