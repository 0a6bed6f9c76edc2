//! Measures of faces, edges and vertices of a mesh, and their totals.
//!
//! Comes in: a surface and a field. Goes out: [`MeshMeasures`], one entry a face, edge and umbrella,
//! and [`MeshTotals`].
//!
//! **Constant u** (paper, Proposition 3.8): mu0 on faces, mu1 (as a tensor) and mu_Omega on edges, mu2
//! on vertices, by the lift of [`crate::measure::cells`]: the spherical polygon of the naive normals around a vertex
//! has the area 2 pi - sum of angles, modulo 4 pi; what is swept between the naive and the corrected
//! normals across its edges is taken off; the nearest multiple of 4 pi, k times, is taken off too.
//! Polygons are cut into triangles at their centroid for that, so faces need not be planar;
//! the sum of k counts the centroids, where mu2 is 0.
//!
//! **Interpolated u**: all on faces ([`super::interpolated`]); polygons are cut into triangles at
//! their centroid, where u is the mean direction of the corners.
//!
//! A face the field of which is known has a measure; an edge has one where two faces meet
//! ([`super::EdgeKind::Inner`]), an umbrella where it is a closed cycle.

use std::f64::consts::TAU;

use glam::DVec3;
use rayon::prelude::*;

use crate::measure::formula::{linel_tensor, spherical_triangle, swept_area};
use crate::symmetric::Symmetric;

use super::field::{Field, NormalField};
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
    /// Lift k of each umbrella; empty for an interpolated field.
    pub lifts: Vec<i32>,
    /// Sum of k over the centroids of polygons: not 0 only for strange ones.
    centroid_lifts: [i64; 2],
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
    pub sum_k: i64,
    /// Sum of their absolute values: how bad the normals are.
    pub sum_abs_k: u64,
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
        let lifts = || self.lifts.iter().map(|&k| i64::from(k));
        let sum_k = lifts().sum::<i64>() + self.centroid_lifts[0];
        let sum_abs_k = lifts().map(i64::abs).sum::<i64>() + self.centroid_lifts[1];
        let closed = surface.is_closed();
        let by_gauss_bonnet = sum.mu2 / TAU + 2.0 * sum_k as f64;
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
            sum_abs_k: sum_abs_k.unsigned_abs(),
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
        centroid_lifts: [0; 2],
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
    let mut centroid_lifts = [0; 2];
    for f in (0..surface.faces()).filter(|&f| surface.corners(f).len() > 3) {
        let k = sweep_spokes(surface, u[f], f, &mut lift);
        centroid_lifts[0] += k;
        centroid_lifts[1] += k.abs();
    }
    let mut lifts = Vec::with_capacity(lift.len());
    for (mu2, &closed) in lift.iter_mut().zip(&surface.closed_umbrella) {
        let k = if closed { nearest_lift(*mu2) } else { 0.0 };
        *mu2 = if closed { *mu2 - 2.0 * TAU * k } else { 0.0 };
        // Some hundreds at most: a vertex has fewer than 2^32 faces in theory only.
        lifts.push(k as i32);
    }
    MeshMeasures {
        faces,
        edges: measured.into_iter().map(|(edge, _)| edge).collect(),
        umbrellas: lift,
        lifts,
        centroid_lifts,
    }
}

/// How many whole spheres to take off; half a sphere stays.
fn nearest_lift(lift: f64) -> f64 {
    // Rounding must not decide what half a sphere is.
    ((lift - 1e-9) / (2.0 * TAU)).round()
}

/// Measures of the edge of a half-edge, and what is swept from its face to the one across.
fn measure_edge(surface: &MeshSurface, u: &[DVec3], c: usize) -> (EdgeMeasure, f64) {
    let Some(across) = surface.across(c) else {
        return Default::default();
    };
    let u_f = u[surface.face_of[c] as usize];
    let u_g = u[surface.face_of[across] as usize];
    let along = surface.place(surface.after(c)) - surface.place(c);
    let length = along.length();
    let Some(e) = along.try_normalize() else {
        return Default::default();
    };
    let (n_f, n_g) = (surface.side_normal(c), surface.side_normal(across));
    let edge = EdgeMeasure {
        tensor: linel_tensor(u_f, u_g, e, length),
        omega: along.dot(u_f - u_g),
    };
    (edge, swept(n_f, n_g, u_f, u_g, e))
}

/// The area swept from (n_f, n_g) to (u_f, u_g) across an edge along `e` of f's boundary. Where the
/// surface folds back on itself, n_g = -n_f, the arc between them runs over the crest.
fn swept(n_f: DVec3, n_g: DVec3, u_f: DVec3, u_g: DVec3, e: DVec3) -> f64 {
    /// Nearer to a fold than this, the arc of n_f and n_g has lost half its digits.
    const FOLDED: f64 = -1.0 + 1e-8;
    if n_f.dot(n_g) > FOLDED {
        return swept_area(n_f, n_g, u_f, u_g);
    }
    let crest = e.cross(n_f);
    spherical_triangle(n_f, crest, u_f)
        + spherical_triangle(crest, n_g, u_g)
        + spherical_triangle(crest, u_g, u_f)
}

/// Takes off what is swept across the edges from the centroid of a polygon to its corners, where u is the
/// same on both sides; gives the lift k of the centroid.
fn sweep_spokes(surface: &MeshSurface, u: DVec3, face: usize, lift: &mut [f64]) -> i64 {
    let middle = surface.centroid[face];
    let mut at_middle = TAU;
    for c in surface.corners(face) {
        let last = surface.before(c);
        let spoke = (surface.place(c) - middle).normalize_or_zero();
        // Seen from the triangle behind, the spoke runs from the corner to the centroid.
        let swept = swept(
            surface.side_normal(c),
            surface.side_normal(last),
            u,
            u,
            spoke,
        );
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
    nearest_lift(at_middle) as i64
}
