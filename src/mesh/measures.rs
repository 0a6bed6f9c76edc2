//! Measures of faces, edges and vertices of a mesh, and their totals.
//!
//! Comes in: a surface and a field. Goes out: [`MeshMeasures`], one entry a face, edge and umbrella,
//! and [`MeshTotals`].
//!
//! **Constant u** (paper, Proposition 3.8): mu0 on faces, mu1 (as a tensor) and mu_Omega on edges, mu2
//! on vertices: the area of the spherical polygon of u around the vertex, as the nearest to 0 of all that differ by whole
//! spheres. Its lift is that of [`crate::measure::cells`]: L = 2 pi - the angles around the vertex, less what
//! is swept between the naive and the corrected normals across its edges; L = mu2 + 4 pi k. The sum of L
//! over a closed mesh is 2 pi (V - E + F). k is an integer, but half of one where an umbrella crosses
//! itself: the polygon of its naive normals then has not the area 2 pi - angles but 2 pi more.
//! Polygons are cut into triangles at their centroid for L, so faces need not be planar; the
//! sum of k counts the centroids, where mu2 is 0.
//!
//! **Interpolated u**: all on faces ([`super::interpolated`]); polygons are cut into triangles at
//! their centroid, where u is the mean direction of the corners.
//!
//! A face the field of which is known has a measure; an edge has one where two faces meet
//! ([`super::EdgeKind::Inner`]), an umbrella where it is a closed cycle.

use std::f64::consts::TAU;

use glam::DVec3;
use rayon::prelude::*;

use crate::measure::field::Field;
use crate::measure::formula::{OPPOSITE, linel_tensor, spherical_triangle, swept_area};
use crate::symmetric::Symmetric;

use super::field::NormalField;
use super::interpolated::{FaceMeasure, linear_triangle, unit_triangle};
use super::surface::MeshSurface;

/// What an edge carries.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EdgeMeasure {
    /// The tensor whose trace is mu1.
    pub tensor: Symmetric,
    /// mu_Omega, a length.
    pub omega: f64,
}

/// Measures of all cells of a mesh.
#[derive(Clone, Debug)]
pub struct MeshMeasures {
    /// One a face.
    pub faces: Vec<FaceMeasure>,
    /// One an edge; empty for an interpolated field.
    pub edges: Vec<EdgeMeasure>,
    /// mu2 of each umbrella; empty for an interpolated field.
    pub umbrellas: Vec<f64>,
    /// Lift k of each umbrella, an integer or half of one; empty for an interpolated field.
    pub lifts: Vec<f64>,
    /// Sums of k and |k| over the centroids of polygons: not 0 only for strange ones.
    centroid_lifts: [f64; 2],
}

/// Sums over a whole mesh.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct MeshTotals {
    /// Corrected area.
    pub mu0: f64,
    /// Twice the integral of H.
    pub mu1: f64,
    /// Integral of G.
    pub mu2: f64,
    /// mu_Omega: 0 on a closed mesh, whatever the field.
    pub mu_omega: f64,
    /// Sum of |mu_Omega| over faces and edges: how far the field is from one of normals.
    pub sum_abs_mu_omega: f64,
    /// Area, as the faces have it.
    pub naive_area: f64,
    /// Euler characteristic V - E + F.
    pub euler_counted: i64,
    /// Euler characteristic by Gauss-Bonnet, sum(mu2) / 2 pi + 2 sum(k); `None` on an open
    /// mesh, for a linear field, or if it is no integer.
    pub euler_gauss_bonnet: Option<i64>,
    /// Sum of the lifts k of mu2.
    pub sum_k: f64,
    /// Sum of their absolute values: how bad the normals are, or the mesh.
    pub sum_abs_k: f64,
    /// Whether every edge joins two faces.
    pub closed: bool,
    /// Volume inside, if closed.
    pub volume: Option<f64>,
}

impl MeshMeasures {
    /// Measures all cells.
    #[must_use]
    pub fn new(surface: &MeshSurface, field: &NormalField) -> Self {
        match field.field {
            Field::Constant => constant(surface, field),
            Field::Interpolated => on_faces(surface, field, unit_triangle),
            Field::Linear => on_faces(surface, field, linear_triangle),
        }
    }

    /// Adds up.
    #[must_use]
    pub fn totals(&self, surface: &MeshSurface, field: &NormalField) -> MeshTotals {
        let mut sum = FaceMeasure::default();
        let mut absolute = 0.0;
        for face in &self.faces {
            sum.add(face, 1.0);
            absolute += face.omega.abs();
        }
        for edge in &self.edges {
            sum.tensor = sum.tensor.zip(&edge.tensor, |a, b| a + b);
            sum.omega += edge.omega;
            absolute += edge.omega.abs();
        }
        sum.mu2 += self.umbrellas.iter().sum::<f64>();
        let sum_k = self.lifts.iter().sum::<f64>() + self.centroid_lifts[0];
        let absolute_lifts = self.lifts.iter().map(|k| k.abs());
        let sum_abs_k = absolute_lifts.sum::<f64>() + self.centroid_lifts[1];
        let closed = surface.is_closed();
        let by_gauss_bonnet = sum.mu2 / TAU + 2.0 * sum_k;
        // Rounding of a million angles is some 1e-12; what is not near an integer is no sum of them.
        let whole = (by_gauss_bonnet - by_gauss_bonnet.round()).abs() < 1e-6;
        let counts = closed && field.field != Field::Linear && whole;
        MeshTotals {
            mu0: sum.mu0,
            mu1: sum.mu1(),
            mu2: sum.mu2,
            mu_omega: sum.omega,
            sum_abs_mu_omega: absolute,
            naive_area: surface.area(),
            euler_counted: surface.euler(),
            euler_gauss_bonnet: counts.then_some(by_gauss_bonnet.round() as i64),
            sum_k,
            sum_abs_k,
            closed,
            volume: closed.then(|| surface.volume()),
        }
    }
}

fn on_faces(
    surface: &MeshSurface,
    field: &NormalField,
    triangle: fn([DVec3; 3], [DVec3; 3]) -> FaceMeasure,
) -> MeshMeasures {
    let of_face = |face: usize| {
        let corners = surface.corners(face);
        let at = |c: usize| (surface.place(c), field.at_corner(surface, c));
        let first = corners.start;
        if corners.len() == 3 {
            let [(a, u), (b, v), (c, w)] = [first, first + 1, first + 2].map(at);
            return triangle([a, b, c], [u, v, w]);
        }
        let (middle, mean) = (surface.centroid[face], field.of_face[face]);
        let mut sum = FaceMeasure::default();
        for c in corners {
            let ((a, u), (b, v)) = (at(c), at(surface.after(c)));
            sum.add(&triangle([a, b, middle], [u, v, mean]), 1.0);
        }
        sum
    };
    MeshMeasures {
        faces: (0..surface.faces()).into_par_iter().map(of_face).collect(),
        edges: Vec::new(),
        umbrellas: Vec::new(),
        lifts: Vec::new(),
        centroid_lifts: [0.0; 2],
    }
}

fn constant(surface: &MeshSurface, field: &NormalField) -> MeshMeasures {
    let u = &field.of_face;
    let faces = (0..surface.faces())
        .map(|f| FaceMeasure {
            mu0: u[f].dot(surface.vector_area[f]),
            ..FaceMeasure::default()
        })
        .collect();
    let measured: Vec<(EdgeMeasure, f64)> = surface
        .edges
        .par_iter()
        .map(|&c| measure_edge(surface, u, c as usize))
        .collect();

    // 2 pi - angles of each umbrella, then less what is swept across its edges, in order of corners.
    let mut lift = vec![TAU; surface.closed_umbrella.len()];
    for c in 0..surface.vertex_of.len() {
        lift[surface.umbrella_of[c] as usize] -= surface.angle(c);
    }
    for (&c, &(_, swept)) in surface.edges.iter().zip(&measured) {
        let c = c as usize;
        // At its end the half-edge's face comes before the other, at its beginning after it.
        lift[surface.umbrella_of[surface.after(c)] as usize] -= swept;
        lift[surface.umbrella_of[c] as usize] += swept;
    }
    let mut centroid_lifts = [0.0; 2];
    for f in (0..surface.faces()).filter(|&f| surface.corners(f).len() > 3) {
        let k = sweep_spokes(surface, u, f, &mut lift);
        centroid_lifts[0] += k;
        centroid_lifts[1] += k.abs();
    }
    let umbrellas: Vec<f64> = (0..lift.len())
        .into_par_iter()
        .map(|umbrella| spherical_polygon(surface, u, umbrella))
        .collect();
    let lifts = lift.iter().zip(&umbrellas).zip(&surface.closed_umbrella);
    let lifts = lifts.map(|((lift, mu2), &closed)| if closed { lift_of(lift - mu2) } else { 0.0 });
    MeshMeasures {
        faces,
        edges: measured.iter().map(|(edge, _)| *edge).collect(),
        lifts: lifts.collect(),
        umbrellas,
        centroid_lifts,
    }
}

/// The k that is nearest to a solid angle of 4 pi k, an integer or half of one.
fn lift_of(angle: f64) -> f64 {
    0.5 * (angle / TAU).round()
}

/// mu2 of an umbrella: the area of the polygon of its u, in (-2 pi, 2 pi]; 0 if it is no cycle.
fn spherical_polygon(surface: &MeshSurface, u: &[DVec3], umbrella: usize) -> f64 {
    if !surface.closed_umbrella[umbrella] {
        return 0.0;
    }
    let start = surface.umbrella_from[umbrella] as usize;
    let mut points = Vec::with_capacity(8);
    let mut at = start;
    loop {
        let c = surface.before(at);
        let across = surface.across(c).unwrap_or(c);
        let (here, there) = (Turn::new(surface, u, c), Turn::new(surface, u, across));
        points.push(here.u);
        if here.u.dot(there.u) < OPPOSITE {
            // No arc is the shortest: by way of the faces, as for the area swept.
            points.extend(here.detour);
            points.push(here.n);
            points.extend(crest(here.n, there.n, direction(surface, c)));
            points.push(there.n);
            points.extend(there.detour);
        }
        at = across;
        if at == start {
            break;
        }
    }
    polygon_area(&points)
}

/// The area of a closed spherical polygon, in (-2 pi, 2 pi].
fn polygon_area(points: &[DVec3]) -> f64 {
    // Triangles from any vector do, up to whole spheres, if it is opposite to none of the points.
    let least = |v: DVec3| points.iter().fold(1.0f64, |least, p| least.min(v.dot(*p)));
    let mut middle = points.iter().sum::<DVec3>().normalize_or(DVec3::X);
    if least(middle) < -0.99 {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        for candidate in axes.into_iter().chain(axes.map(|v| -v)) {
            if least(candidate) > least(middle) {
                middle = candidate;
            }
        }
    }
    let last = points.len().saturating_sub(1);
    let area: f64 = (0..points.len())
        .map(|i| spherical_triangle(middle, points[i], points[if i == last { 0 } else { i + 1 }]))
        .sum();
    // Half a sphere stays, and rounding must not decide it.
    let spheres = ((area - 1e-9) / (2.0 * TAU)).round();
    area - 2.0 * TAU * spheres
}

/// How a triangle's naive normal turns into u.
struct Turn {
    n: DVec3,
    u: DVec3,
    /// By way of this vector, where they are opposite.
    detour: Option<DVec3>,
}

impl Turn {
    /// In the triangle of half-edge `c`.
    fn new(surface: &MeshSurface, u: &[DVec3], c: usize) -> Self {
        let face = surface.face_of[c] as usize;
        let (n, u) = (surface.side_normal(c), u[face]);
        let detour = (n.dot(u) < FOLDED).then(|| {
            // One for the triangle, whichever of its edges is asked.
            let corners = surface.corners(face);
            let of = if corners.len() == 3 { corners.start } else { c };
            direction(surface, of)
        });
        Self { n, u, detour }
    }
}

/// Unit vector along a half-edge.
fn direction(surface: &MeshSurface, c: usize) -> DVec3 {
    (surface.place(surface.after(c)) - surface.place(c)).normalize_or(DVec3::X)
}

/// Vectors nearer to opposite than this have lost half the digits of the arc between them.
const FOLDED: f64 = -1.0 + 1e-9;

/// Where a surface folds back on itself, n_g = -n_f, the arc between them runs over this.
fn crest(n_f: DVec3, n_g: DVec3, e: DVec3) -> Option<DVec3> {
    (n_f.dot(n_g) < FOLDED).then(|| e.cross(n_f))
}

/// The area swept from (n_f, n_g) to (u_f, u_g) across an edge along `e` of f's boundary, up to whole spheres.
fn swept(f: &Turn, g: &Turn, e: DVec3) -> f64 {
    let crest = crest(f.n, g.n, e);
    if f.u.dot(g.u) < OPPOSITE {
        return 0.0;
    }
    if crest.is_none() && f.detour.is_none() && g.detour.is_none() {
        return swept_area(f.n, g.n, f.u, g.u);
    }
    let mut points = vec![f.n];
    points.extend(crest);
    points.push(g.n);
    points.extend(g.detour);
    points.push(g.u);
    points.push(f.u);
    points.extend(f.detour);
    polygon_area(&points)
}

/// Measures of the edge of a half-edge, and what is swept from its face to the one across.
fn measure_edge(surface: &MeshSurface, u: &[DVec3], c: usize) -> (EdgeMeasure, f64) {
    let Some(across) = surface.across(c) else {
        return Default::default();
    };
    let (f, g) = (Turn::new(surface, u, c), Turn::new(surface, u, across));
    let along = surface.place(surface.after(c)) - surface.place(c);
    let Some(e) = along.try_normalize() else {
        return Default::default();
    };
    let edge = EdgeMeasure {
        tensor: linel_tensor(f.u, g.u, e, along.length()),
        omega: along.dot(f.u - g.u),
    };
    (edge, swept(&f, &g, e))
}

/// Takes off what is swept across the edges from the centroid of a polygon to its corners, where u is the
/// same on both sides; gives the lift k of the centroid.
fn sweep_spokes(surface: &MeshSurface, u: &[DVec3], face: usize, lift: &mut [f64]) -> f64 {
    let middle = surface.centroid[face];
    let mut at_middle = TAU;
    for c in surface.corners(face) {
        let last = surface.before(c);
        let spoke = (surface.place(c) - middle).normalize_or_zero();
        // A side of the triangle of `c`, which has the spoke from the centroid to the corner.
        let [first, second] = [c, last].map(|c| Turn::new(surface, u, c));
        let swept = swept(&first, &second, spoke);
        // At the corner the triangle of `c` comes first, counter-clockwise; at the centroid last.
        lift[surface.umbrella_of[c] as usize] -= swept;
        at_middle += swept;
        // The triangle's angles add up to pi; two of them are at its corners.
        let (p, q) = (
            surface.place(c) - middle,
            surface.place(surface.after(c)) - middle,
        );
        at_middle -= libm::atan2(p.cross(q).length(), p.dot(q));
    }
    // u is one vector all around, so the area is 0 but for whole spheres.
    lift_of(at_middle)
}
