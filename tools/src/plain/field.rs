//! The measures of surfels whose corrected normal is continuous, from one pointel to the next.
//!
//! In: a surface, u per surfel, the scale. Out: all measures of each surfel. Linels and pointels
//! carry none (Lachaud, Romon, Thibert, *Corrected curvature measures*, Example 2.4 and
//! Proposition 3.5). Guaranteed: mu0 and the tensor by 4 x 4 Gauss points, exact for
//! [`Field::Linear`]; mu_Omega by a closed form; mu2 of [`Field::Interpolated`] is the area of a spherical quadrilateral in
//! (-2 pi, 2 pi]. Not guaranteed: a meaning where neighbouring pointels
//! have opposite normals.

use super::algebra::{
    ENTRIES, Symmetric, Vector, cross, determinant, dot, norm, normalised, scaled,
};
use super::cells::{HALF_SPHERE_SLACK, MU2_UNIT, QUARTER, UNIT};
use super::formula::triangle_area;
use super::solid::Scale;
use super::sums::FixedSums;
use super::surface::{OPEN, Surface, Surfel};

/// How u goes on from surfels to the whole surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Field {
    /// Constant on each surfel.
    #[default]
    Constant,
    /// Bilinear between pointels, then of unit length.
    Interpolated,
    /// Bilinear between pointels.
    Linear,
}

/// The normal of each umbrella: the mean direction of its surfels, each counting the same.
pub fn pointel_normals(surface: &Surface, u: &[Vector]) -> Vec<Vector> {
    let sum = |vectors: &mut dyn Iterator<Item = Vector>| {
        vectors.fold([0.0; 3], |s, v| [0, 1, 2].map(|a| s[a] + v[a]))
    };
    (0..surface.umbrella_count() as u32)
        .map(|umbrella| {
            // from the surfel of the lowest index on
            let mut members = surface.umbrella(umbrella).to_vec();
            let lowest = (0..members.len()).min_by_key(|&i| members[i]).unwrap_or(0);
            members.rotate_left(lowest);
            let of_u = sum(&mut members.iter().map(|&f| u[f as usize]));
            let of_n = sum(&mut members
                .iter()
                .map(|&f| surface.surfels[f as usize].normal()));
            if norm(of_u) > 1e-9 {
                normalised(of_u)
            } else if norm(of_n) > 1e-9 {
                normalised(of_n)
            } else {
                u[members[0] as usize]
            }
        })
        .collect()
}

/// The measures of all surfels.
pub fn measures(surface: &Surface, u: &[Vector], scale: &Scale, field: Field) -> Vec<FixedSums> {
    let of_pointels = pointel_normals(surface, u);
    let units = |x: f64| (x / UNIT).round_ties_even() as i64;
    (0..surface.len())
        .map(|f| {
            let surfel = &surface.surfels[f];
            let corners = surface.umbrellas_of[f].map(|o| of_pointels[o as usize]);
            let integrals = integrals(surfel, corners, scale, field);
            let mu2 = match field {
                Field::Linear => (integrals.mu2 / MU2_UNIT).round_ties_even() as i64,
                Field::Constant | Field::Interpolated => area(&outline(surface, f, corners)),
            };
            FixedSums {
                mu0: units(integrals.mu0),
                tensor: integrals.tensor.map(|x| units(x.clamp(-BOUND, BOUND))),
                mu2,
                omega: units(integrals.omega),
            }
        })
        .collect()
}

/// No term of the tensor of a field without zeros is larger.
const BOUND: f64 = 2.0 * std::f64::consts::PI;

#[derive(Default)]
struct Integrals {
    mu0: f64,
    tensor: Symmetric,
    mu2: f64,
    omega: f64,
}

/// The Gauss points of [-1, 1] with four nodes, and their weights.
fn gauss() -> [(f64, f64); 4] {
    let root = |sign: f64| (3.0 / 7.0 + sign * 2.0 / 7.0 * (6.0f64 / 5.0).sqrt()).sqrt();
    let weight = |sign: f64| (18.0 - sign * 30.0f64.sqrt()) / 36.0;
    [
        (-root(1.0), weight(1.0)),
        (-root(-1.0), weight(-1.0)),
        (root(-1.0), weight(-1.0)),
        (root(1.0), weight(1.0)),
    ]
}

/// Where corner i is, in units of half an edge along the steps of sides 0 and 1.
const CORNERS: [[f64; 2]; 4] = [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]];

fn integrals(surfel: &Surfel, corners: [Vector; 4], scale: &Scale, field: Field) -> Integrals {
    let mut sums = Integrals::default();
    // x = p b/2 + q c/2 with p and q from -1 to 1
    let [x_p, x_q] = [0, 1].map(|side| {
        let step = surfel.steps()[side];
        [0, 1, 2].map(|a| 0.5 * f64::from(step[a]) * scale.edges[a])
    });
    for (p, weight_p) in gauss() {
        for (q, weight_q) in gauss() {
            let weight = weight_p * weight_q;
            let combined = |factor: fn([f64; 2], f64, f64) -> f64| {
                let mut v = [0.0; 3];
                for (corner, normal) in CORNERS.into_iter().zip(corners) {
                    (0..3).for_each(|a| v[a] += 0.25 * factor(corner, p, q) * normal[a]);
                }
                v
            };
            let mut u = combined(|[cp, cq], p, q| (1.0 + cp * p) * (1.0 + cq * q));
            let mut u_p = combined(|[cp, cq], _, q| cp * (1.0 + cq * q));
            let mut u_q = combined(|[cp, cq], p, _| cq * (1.0 + cp * p));
            if field == Field::Interpolated {
                let length = norm(u);
                if length < 1e-12 {
                    continue;
                }
                u = scaled(u, 1.0 / length);
                let across = |d: Vector| {
                    let along = dot(u, d);
                    [0, 1, 2].map(|a| (d[a] - along * u[a]) / length)
                };
                (u_p, u_q) = (across(u_p), across(u_q));
            }
            sums.mu0 += weight * determinant(x_p, x_q, u);
            sums.mu2 += weight * determinant(u, u_p, u_q);
            let (a, b) = (cross(x_q, u), cross(x_p, u));
            for (entry, (i, j)) in ENTRIES.into_iter().enumerate() {
                let first = 0.5 * (a[i] * u_p[j] + a[j] * u_p[i]);
                let second = 0.5 * (b[i] * u_q[j] + b[j] * u_q[i]);
                sums.tensor[entry] += weight * (first - second);
            }
        }
    }
    // Minus the circulation of u around the surfel (Stokes), side by side.
    for (side, &to) in corners.iter().enumerate() {
        let from = corners[(side + 3) % 4];
        let step = surfel.steps()[(side + 1) % 4];
        let edge = [0, 1, 2].map(|a| f64::from(step[a]) * scale.edges[a]);
        let middle = [0, 1, 2].map(|a| 0.5 * (from[a] + to[a]));
        let sine = norm([0, 1, 2].map(|a| 0.5 * (from[a] - to[a])));
        // The mean of 1/|u| along the side, before it had unit length.
        let stretch = match field {
            Field::Interpolated if sine >= 1.0 => 0.0,
            Field::Interpolated if sine > 1e-5 => 0.5 * ((1.0 + sine) / (1.0 - sine)).ln() / sine,
            Field::Interpolated => 1.0 + sine * sine / 3.0,
            Field::Constant | Field::Linear => 1.0,
        };
        sums.omega -= stretch * dot(edge, middle);
    }
    sums
}

/// The corners of a spherical quadrilateral, counter-clockwise; between opposite ones, where there is no one arc,
/// also the mean of the trivial normals of the two surfels beside; if that is one of them, the direction in
/// which the boundary of the first surfel runs.
fn outline(surface: &Surface, f: usize, corners: [Vector; 4]) -> Vec<Vector> {
    let mut outline = Vec::new();
    for side in 0..4 {
        let (v, w) = (corners[(side + 3) % 4], corners[side]);
        outline.push(v);
        if dot(v, w) < -1.0 + 2e-12 {
            let n = surface.surfels[f].normal();
            let beside = surface.neighbours[f][side];
            let other = match beside {
                OPEN => n,
                g => surface.surfels[g as usize].normal(),
            };
            let mean = normalised([0, 1, 2].map(|a| n[a] + other[a]));
            let sign = if beside < f as u32 { -1.0 } else { 1.0 };
            let along = surface.surfels[f].steps()[(side + 1) % 4];
            outline.push(if dot(mean, v).abs() < 0.99 {
                mean
            } else {
                along.map(|x| sign * f64::from(x))
            });
        }
    }
    outline
}

/// Area of a spherical polygon, modulo the sphere in (-2 pi, 2 pi].
///
/// The sum of the triangles from any apex to the sides; of some apexes the one from which no
/// triangle is nearly degenerate.
fn area(outline: &[Vector]) -> i64 {
    let fan = |apex: Vector| {
        let mut sum = 0.0;
        let mut least = f64::INFINITY;
        for (&v, &w) in outline.iter().zip(outline.iter().cycle().skip(1)) {
            let cosines = 1.0 + dot(apex, v) + dot(v, w) + dot(w, apex);
            least = least.min(determinant(apex, v, w).hypot(cosines));
            sum += triangle_area(apex, v, w);
        }
        (least, sum)
    };
    let mut best = (0.0, 0.0);
    for x in [-0.8, 0.9] {
        for y in [-1.1, 0.7] {
            for z in [-0.6, 1.0] {
                let candidate = fan(normalised([x, y, z]));
                if candidate.0 > best.0 {
                    best = candidate;
                }
            }
        }
    }
    let area = (best.1 / MU2_UNIT).round_ties_even() as i64;
    let sphere = 8 * QUARTER;
    area - (area + 4 * QUARTER - 1 - HALF_SPHERE_SLACK).div_euclid(sphere) * sphere
}
