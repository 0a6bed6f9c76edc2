//! Measures with `u` constant on each surfel (paper, Proposition 3.8).
//!
//! Comes in: the surface of a brick's core with one cell around, and `u` of all its surfels. Goes
//! out: mu0 of surfels, tensors of linels, mu2 of pointels and totals, in the form of [`super::cells`].
//! mu_Omega is evaluated if asked for ([`Asked::quality`]); on a closed surface its integers sum to zero.
//!
//! A linel or umbrella shared by bricks is evaluated by each of them, from the same numbers in the
//! same order, so with the same bits; everything else is evaluated once.
//!
//! **mu2 by the lift.** The area of the spherical polygon u_1 .. u_d around a pointel differs from
//! that of the trivial normals, (4 - d) pi/2, by the areas swept between consecutive surfels
//! ([`super::formula::swept_area`]); these are antisymmetric and integers, so over a closed surface they cancel
//! and what is left is 2 pi (V - E + F). L = (4 - d) pi/2 - sum Q is a lift of the area;
//! mu2 = L - 4 pi k with k the nearest integer of L / 4 pi (half a sphere being +2 pi). It equals the paper's area wherever
//! the normals of the umbrella lie in one hemisphere (condition iii of a corrected normal field).

use glam::DVec3;

use crate::khalimsky::{SIDES, axis, sign};
use crate::normal::trivial_normal;
use crate::simd::{Level, Work, dispatch};
use crate::surfel::{CellBox, Link};

use super::cells::{
    Around, Asked, CellMeasures, CellTotals, Keep, Lumped, Numbers, RIM, Tensor, mark, spread_cut,
    umbrella,
};
use super::fixed;
use super::formula::{linel_tensor, swept_area};
use super::surface::Surface;

/// Evaluates the core of a surface; see [`super::evaluate`].
pub(super) fn evaluate(
    surface: &Surface,
    core: CellBox,
    edges: [f64; 3],
    u: &[DVec3],
    marks: &[u8],
    asked: Asked,
) -> (CellMeasures, CellTotals) {
    dispatch(Cells {
        surface,
        core,
        edges,
        u,
        marks,
        asked,
    })
}

/// The cells of a core, which are evaluated.
struct Cells<'a> {
    surface: &'a Surface,
    core: CellBox,
    edges: [f64; 3],
    u: &'a [DVec3],
    marks: &'a [u8],
    asked: Asked,
}

impl Work for Cells<'_> {
    type Output = (CellMeasures, CellTotals);

    #[inline(always)]
    fn run<L: Level>(self) -> (CellMeasures, CellTotals) {
        let Cells {
            surface,
            core,
            edges,
            u,
            marks,
            asked,
        } = self;
        let Asked { keep, quality, .. } = asked;
        let count = surface.len();
        let links = &surface.links.of;
        let mut totals = CellTotals::default();
        let numbers = Numbers::of(surface, core);
        let (core_number, core_count) = (&numbers.of, numbers.count);
        let mut out = CellMeasures {
            marks: Vec::with_capacity(core_count),
            ..Default::default()
        };
        let normals: Vec<DVec3> = surface
            .surfels
            .list
            .iter()
            .map(|s| trivial_normal(s.orientation))
            .collect();
        let areas = [
            edges[1] * edges[2],
            edges[2] * edges[0],
            edges[0] * edges[1],
        ];
        let mut lumped: Vec<Lumped> =
            vec![[0; 8]; if keep == Keep::Lumped { core_count } else { 0 }];
        for i in 0..count {
            if core_number[i] == RIM {
                continue;
            }
            let along = axis(surface.surfels.list[i].orientation);
            let cosine = u[i].dot(normals[i]);
            let mu0 = fixed::from_measure(cosine * areas[along]);
            totals.surfels[along] += 1;
            totals.mu0 += i128::from(mu0);
            let opposed = if cosine <= 0.0 { mark::OPPOSED } else { 0 };
            let near = if marks[i] & mark::CUT != 0 {
                mark::NEAR_CUT
            } else {
                0
            };
            let ridge = if surface.is_ridge(i) { mark::RIDGE } else { 0 };
            out.marks.push(marks[i] | opposed | near | ridge);
            match keep {
                Keep::Lumped => lumped[core_number[i] as usize][0] = mu0,
                Keep::Cells => out.mu0.push(mu0),
            }
        }

        // Linels: swept areas of all, tensors of those that touch the core.
        let mut swept = vec![[0i64; 4]; count];
        let mut linels = Vec::with_capacity(if keep == Keep::Cells {
            core_count * 9 / 4
        } else {
            0
        });
        let lumped_omega = quality && keep == Keep::Lumped;
        let mut omega = vec![0i64; if lumped_omega { core_count } else { 0 }];
        let mut owned = vec![[0u32; 2]; if keep == Keep::Cells { core_count } else { 0 }];
        for i in 0..count {
            let orientation = surface.surfels.list[i].orientation;
            for j in 0..4 {
                let link = links[i][j];
                let Some(n) = link.surfel() else {
                    if link == Link::BORDER && core_number[i] != RIM {
                        totals.linels += 1;
                        totals.border_linels += 1;
                    }
                    continue;
                };
                if n < i {
                    continue;
                }
                let q = fixed::from_solid_angle(swept_area(normals[i], normals[n], u[i], u[n]));
                swept[i][j] = q;
                swept[n][link.side_there()] = -q;
                let (mine, other) = (core_number[i], core_number[n]);
                if mine == RIM && other == RIM {
                    continue;
                }
                let along = SIDES[orientation as usize][(j + 1) % 4];
                let mut e = DVec3::ZERO;
                e[axis(along)] = f64::from(sign(along));
                let tensor = linel_tensor(u[i], u[n], e, edges[axis(along)]).terms();
                let whole: Tensor = tensor.map(fixed::from_measure);
                if mine != RIM {
                    totals.linels += 1;
                    totals.mu1 +=
                        i128::from(whole[0]) + i128::from(whole[1]) + i128::from(whole[2]);
                }
                // <e, u_i - u_n> length (Proposition 3.8), rounded such that opposite sides of a surfel
                // cancel: over a closed surface the sum is exactly zero.
                let part_of_omega = |part: f64| {
                    let on = |u: DVec3| fixed::from_measure(part * edges[axis(along)] * e.dot(u));
                    on(u[i]) - on(u[n])
                };
                match keep {
                    Keep::Lumped => {
                        let half = tensor.map(|x| fixed::from_measure(0.5 * x));
                        for number in [mine, other] {
                            if number != RIM {
                                let lump = &mut lumped[number as usize];
                                for t in 0..6 {
                                    lump[t + 1] += half[t];
                                }
                            }
                        }
                        if quality {
                            let half = part_of_omega(0.5);
                            for number in [mine, other] {
                                if number != RIM {
                                    omega[number as usize] += half;
                                }
                            }
                        }
                    }
                    Keep::Cells if mine != RIM => {
                        linels.push(whole);
                        if quality {
                            omega.push(part_of_omega(1.0));
                        }
                        owned[mine as usize][0] += 1;
                    }
                    Keep::Cells => {}
                }
            }
        }

        // Pointels: one umbrella or chain at a time, by its lowest surfel.
        let mut umbrellas = Vec::with_capacity(if keep == Keep::Cells {
            core_count * 9 / 8
        } else {
            0
        });
        let mut members: Vec<usize> = Vec::with_capacity(8);
        for i in 0..count {
            for j in 0..4 {
                match umbrella(surface, i, j, &mut members) {
                    Around::Cycle => {}
                    Around::Chain => {
                        // its surfels touch the border, so they are cut themselves
                        if core_number[i] != RIM {
                            totals.pointels += 1;
                        }
                        continue;
                    }
                    Around::NotLowest | Around::Beyond => continue,
                }
                if members.iter().all(|&m| core_number[m] == RIM) {
                    continue;
                }
                spread_cut(&members, marks, &numbers, &mut out.marks);
                let mut lift = (4 - members.len() as i64) * fixed::QUARTER_TURN;
                let (mut at, mut corner) = (i, j);
                for _ in 0..members.len() {
                    lift -= swept[at][corner];
                    if let Ok(next) = surface.links.next_corner(at, corner) {
                        (at, corner) = next;
                    }
                }
                let k = fixed::nearest_lift(lift);
                let mu2 = lift - k * fixed::SPHERE;
                if core_number[i] != RIM {
                    totals.pointels += 1;
                    totals.mu2 += i128::from(mu2);
                    totals.lifts += k;
                    totals.absolute_lifts += k.unsigned_abs();
                    if keep == Keep::Cells {
                        umbrellas.push(mu2);
                        owned[core_number[i] as usize][1] += 1;
                    }
                }
                let share = fixed::lumped_share(mu2, members.len());
                for &m in &members {
                    if core_number[m] == RIM {
                        continue;
                    }
                    let number = core_number[m] as usize;
                    if keep == Keep::Lumped {
                        lumped[number][7] += share;
                    }
                    if k != 0 {
                        out.marks[number] |= mark::LIFTED;
                    }
                }
            }
        }
        if keep == Keep::Cells {
            let mut from = [0u32; 2];
            for n in &owned {
                out.owned_from.push(from);
                from = [from[0] + n[0], from[1] + n[1]];
            }
            out.owned_from.push(from);
        }
        out.lumped = lumped;
        out.omega = omega;
        linels.shrink_to_fit();
        umbrellas.shrink_to_fit();
        out.linels = linels;
        out.umbrellas = umbrellas;
        (out, totals)
    }
}
