//! Corrected normal fields that are continuous: interpolated between pointels.
//!
//! Comes in: the surface of a brick's core with one cell around, and `u` of all its surfels. Goes
//! out: measures of the core, all of them on its surfels (paper, Example 2.4: with a continuous `u`
//! linels and pointels carry none), in the form of [`super::cells`].
//!
//! **The field.** Each umbrella has the sum of `u` of its surfels, brought to unit length, every
//! surfel counting 1: all are estimates of one normal, and small faces of flat voxels are no
//! worse than large ones. Where the surface is split, so is the field; a chain on the border of
//! an open image takes the surfels it has. If the sum vanishes, the trivial normals are summed
//! instead, and if these do too, `u` of the first surfel stands. On a surfel `u` is bilinear in its four
//! pointels: [`Field::Interpolated`] brings it to unit length everywhere, [`Field::Linear`] leaves
//! it as it is (Remark 2.11). The measures are integrals over the surfel ([`super::patch`]).
//!
//! **mu2 and Gauss-Bonnet.** With `u` of unit length, mu2 of a surfel is the area of the spherical
//! quadrilateral of its pointels' normals: edges of a bilinear patch of vectors are great arcs. With
//! T(a, b, c) the area of a triangle on the sphere and n the trivial normals, modulo 4 pi
//!
//! ```text
//! area of surfel f           =  sum over its linels v -> w of T(n_f, u_v, u_w)
//! across a linel of f and g:    T(n_f, u_v, u_w) + T(n_g, u_w, u_v) = T(u_v, n_g, n_f) + T(u_w, n_f, n_g)
//! around a pointel of degree d: sum of T(u_v, n_f, n_g), f before g  =  (4 - d) pi/2
//! ```
//!
//! Terms T(u_v, n_f, n_g) are rounded, and what their umbrella lacks to (4 - d) pi/2 is given to its
//! first linel; T(n_f, u_v, u_w) is rounded for the surfel of lower number, and that of the other
//! is the difference. So over a closed surface the sum of the lifts L is 2 pi (V - E + F)
//! in integers, mu2 = L - 4 pi k with k the nearest integer of L / 4 pi, and
//!
//! ```text
//! sum(mu2) + 4 pi sum(k) = 2 pi (V - E + F)     exactly, with Field::Interpolated, for every u
//! ```
//!
//! Each mu2 is right to some 20 units of 9e-14. k is not 0 where the normals of a surfel turn more than
//! a hemisphere, or away from the surface by as much. The n are all tilted by
//! 2e-3, so that no `u` made of trivial normals is opposite to one, where T is undefined. Where the
//! normals of neighbouring pointels are opposite, the arc between them runs through the mean of the two n beside,
//! or, if that is one of them, through the direction of the linel.
//!
//! Not guaranteed: a Gauss-Bonnet theorem for [`Field::Linear`]. Its `u` is shorter than 1
//! between pointels, so the sum of mu2 is only near 2 pi (V - E + F), and there are no lifts. Nor a
//! meaning where the bilinear vector vanishes on a surfel.

use glam::{DQuat, DVec3};

use crate::khalimsky::{Direction, SIDES, axis, sign, step};
use crate::normal::trivial_normal;
use crate::surfel::{CellBox, Link};

use super::cells::{
    Around, Asked, CellMeasures, CellTotals, Lumped, Numbers, RIM, Umbrellas, mark, spread_cut,
};
use super::field::Field;
use super::fixed;
use super::formula::{OPPOSITE, spherical_triangle};
use super::patch::{Patch, circulation};
use super::surface::Surface;

/// A sum of unit vectors shorter than this has no direction.
const NO_DIRECTION: f64 = 1e-9;

/// Two unit vectors whose scalar product is this large in size do not tell on which side an arc passes.
const COLLINEAR: f64 = 0.99;

/// The trivial normals, tilted together: the areas between them stay the same.
fn tilted_normals() -> [DVec3; 6] {
    let tilt = DQuat::from_xyzw(0.000_57, 0.000_31, -0.000_79, 1.0).normalize();
    [0, 1, 2, 3, 4, 5].map(|o: Direction| tilt * trivial_normal(o))
}

/// The normals at pointels, and what Gauss-Bonnet needs of them.
struct Pointels {
    /// Unit normals.
    u: Vec<DVec3>,
    /// The pointel at each corner of each surfel; those of the core are all known.
    at: Vec<[u32; 4]>,
    /// T(u_v, n_f, n_g) around the pointel at each corner of f, g being across the side of the
    /// same number.
    fans: Vec<[i64; 4]>,
}

/// Evaluates the core of a surface with a continuous field; see [`super::evaluate`].
pub(super) fn evaluate(
    surface: &Surface,
    core: CellBox,
    edges: [f64; 3],
    u: &[DVec3],
    marks: &[u8],
    asked: Asked,
) -> (CellMeasures, CellTotals) {
    let Asked { field, quality, .. } = asked;
    let mut totals = CellTotals::default();
    let core = Numbers::of(surface, core);
    let mut out = CellMeasures {
        lumped: Vec::with_capacity(core.count),
        marks: Vec::with_capacity(core.count),
        ..Default::default()
    };
    for (i, &mark) in marks.iter().enumerate() {
        if core.of[i] != RIM {
            let near = if mark & mark::CUT != 0 {
                mark::NEAR_CUT
            } else {
                0
            };
            let ridge = if surface.is_ridge(i) { mark::RIDGE } else { 0 };
            out.marks.push(mark | near | ridge);
        }
    }
    let normals = tilted_normals();
    let pointels = pointels(
        surface,
        &core,
        u,
        marks,
        &normals,
        &mut out.marks,
        &mut totals,
    );
    for (i, surfel) in surface.surfels.list.iter().enumerate() {
        if core.of[i] == RIM {
            continue;
        }
        let corners = pointels.at[i].map(|p| pointels.u[p as usize]);
        let sides = SIDES[surfel.orientation as usize];
        let edge = |direction: Direction| {
            let mut e = DVec3::ZERO;
            e[axis(direction)] = f64::from(sign(direction)) * edges[axis(direction)];
            e
        };
        let patch = Patch {
            x_s: edge(sides[0]),
            x_t: edge(sides[1]),
            u: [corners[2], corners[3], corners[0], corners[1]],
        };
        let measures = match field {
            Field::Linear => patch.linear(),
            Field::Constant | Field::Interpolated => patch.normalised(),
        };
        let tensor = measures.tensor.terms().map(fixed::from_measure);
        let mu0 = fixed::from_measure(measures.mu0);
        let (mu2, k) = match field {
            Field::Linear => (fixed::from_solid_angle(measures.mu2), 0),
            Field::Constant | Field::Interpolated => {
                let lift = lift(surface, &pointels, &normals, i);
                let k = fixed::nearest_lift(lift);
                (lift - k * fixed::SPHERE, k)
            }
        };
        if quality {
            let omega: i64 = (0..4)
                .map(|j| {
                    let (from, to) = (corners[(j + 3) % 4], corners[j]);
                    let along = edge(sides[(j + 1) % 4]);
                    let unit = field != Field::Linear;
                    -fixed::from_measure(circulation(along, from, to, unit))
                })
                .sum();
            out.omega.push(omega);
        }
        let [xx, yy, zz, xy, xz, yz] = tensor;
        let lump: Lumped = [mu0, xx, yy, zz, xy, xz, yz, fixed::lumped_share(mu2, 1)];
        out.lumped.push(lump);
        let mark = &mut out.marks[core.of[i] as usize];
        if mu0 <= 0 {
            *mark |= mark::OPPOSED;
        }
        if k != 0 {
            *mark |= mark::LIFTED;
        }
        totals.surfels[axis(surfel.orientation)] += 1;
        for link in surface.links.of[i] {
            totals.linels += u64::from(link.surfel().is_none_or(|n| n > i));
            totals.border_linels += u64::from(link == Link::BORDER);
        }
        totals.mu0 += i128::from(mu0);
        totals.mu1 += i128::from(xx) + i128::from(yy) + i128::from(zz);
        totals.mu2 += i128::from(mu2);
        totals.lifts += k;
        totals.absolute_lifts += k.unsigned_abs();
    }
    (out, totals)
}

/// The normals of all pointels that touch the core; marks the core's surfels near a cut.
fn pointels(
    surface: &Surface,
    core: &Numbers,
    u: &[DVec3],
    marks: &[u8],
    normals: &[DVec3; 6],
    core_marks: &mut [u8],
    totals: &mut CellTotals,
) -> Pointels {
    let count = surface.len();
    let orientation = |i: usize| surface.surfels.list[i].orientation;
    let mut pointels = Pointels {
        u: Vec::with_capacity(core.count + core.count / 4),
        at: vec![[u32::MAX; 4]; count],
        fans: vec![[0; 4]; count],
    };
    let mut umbrellas = Umbrellas::of(surface);
    let mut members: Vec<usize> = Vec::with_capacity(8);
    for i in 0..count {
        for j in 0..4 {
            let around = umbrellas.find(i, j);
            if around == Around::Nothing {
                continue;
            }
            members.clear();
            members.extend(umbrellas.corners.iter().map(|&c| c as usize / 4));
            if members.iter().all(|&m| core.of[m] == RIM) {
                continue;
            }
            totals.pointels += u64::from(core.of[i] != RIM);
            if members.iter().any(|&m| marks[m] & mark::CUT != 0) {
                spread_cut(&umbrellas.corners, core, core_marks);
            }
            let sum: DVec3 = members.iter().map(|&m| u[m]).sum();
            let trivial = || -> DVec3 {
                let normals = members.iter().map(|&m| trivial_normal(orientation(m)));
                normals.sum()
            };
            let normal = [sum, trivial()]
                .into_iter()
                .find(|v| v.length() > NO_DIRECTION)
                .map_or(u[members[0]], |v| v / v.length());
            let number = pointels.u.len() as u32;
            pointels.u.push(normal);
            // from the first surfel on, counter-clockwise, then what a chain has on its other side
            let (mut at, mut corner) = (i, j);
            let mut left = (4 - members.len() as i64) * fixed::QUARTER_TURN;
            loop {
                pointels.at[at][corner] = number;
                let Ok((next, there)) = surface.links.next_corner(at, corner) else {
                    break;
                };
                let fan = fan(normal, normals, orientation(at), orientation(next));
                pointels.fans[at][corner] = fan;
                left -= fan;
                (at, corner) = (next, there);
                if (at, corner) == (i, j) {
                    break;
                }
            }
            match around {
                Around::Cycle => pointels.fans[i][j] += left,
                _ => {
                    let (mut at, mut corner) = (i, j);
                    while let Ok((before, there)) = surface.links.previous_corner(at, corner) {
                        pointels.fans[before][there] =
                            fan(normal, normals, orientation(before), orientation(at));
                        pointels.at[before][there] = number;
                        (at, corner) = (before, there);
                    }
                }
            }
        }
    }
    pointels
}

/// T(u, n_f, n_g), rounded.
fn fan(u: DVec3, normals: &[DVec3; 6], f: Direction, g: Direction) -> i64 {
    if f == g {
        return 0;
    }
    let area = spherical_triangle(u, normals[f as usize], normals[g as usize]);
    fixed::from_solid_angle(area)
}

/// The lift of the area of surfel `i`: the sum over its linels.
fn lift(surface: &Surface, pointels: &Pointels, normals: &[DVec3; 6], i: usize) -> i64 {
    let orientation = |f: usize| surface.surfels.list[f].orientation;
    // T(n_f, u_v, u_w) of the linel v -> w that is side `j` of surfel f
    let term = |f: usize, j: usize| {
        let n = normals[orientation(f) as usize];
        let [v, w] = [(j + 3) % 4, j].map(|corner| pointels.u[pointels.at[f][corner] as usize]);
        let area = if v.dot(w) < OPPOSITE {
            let beside = surface.links.of[f][j].surfel().unwrap_or(f);
            let sum = trivial_normal(orientation(f)) + trivial_normal(orientation(beside));
            let mean = sum / sum.length();
            let between = if mean.dot(v).abs() < COLLINEAR {
                mean
            } else {
                let along = SIDES[orientation(f) as usize][(j + 1) % 4];
                DVec3::from_array(step(along).map(f64::from))
            };
            spherical_triangle(n, v, between) + spherical_triangle(n, between, w)
        } else {
            spherical_triangle(n, v, w)
        };
        fixed::from_solid_angle(area)
    };
    (0..4)
        .map(|j| {
            let link = surface.links.of[i][j];
            match link.surfel() {
                Some(n) if n < i => {
                    let there = link.side_there();
                    pointels.fans[i][j] + pointels.fans[n][there] - term(n, there)
                }
                _ => term(i, j),
            }
        })
        .sum()
}
