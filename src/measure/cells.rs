//! Measures of cells: surfels, linels and pointels of a brick.
//!
//! Comes in: the surface of a brick's core with one cell around, and `u` of all its surfels. Goes
//! out: [`CellMeasures`] of the core: either lumped on surfels (eight integers each) or, cell by
//! cell, with each linel and umbrella kept by its *owner*, the surfel of the lowest number among
//! those that share it; and [`CellTotals`], exact integers, each cell counted by its owner.
//!
//! This is for `u` constant on surfels; with a continuous field all measures lie on surfels ([`super::field`]).
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
use crate::surfel::{CellBox, Link};

use super::field::Field;
use super::fixed;
use super::formula::{linel_tensor, swept_area};
use super::surface::Surface;

/// Measures that a surfel carries when linels and pointels are lumped on it: mu0, the six terms of
/// the tensor (xx yy zz xy xz yz) of half of each of its linels, and its shares of mu2. With a
/// continuous field, all the measures of the surfel.
pub type Lumped = [i64; 8];

/// The tensor of a linel: xx yy zz xy xz yz.
pub type Tensor = [i64; 6];

/// How measures are kept until they are summed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Lumped on surfels.
    Lumped,
    /// Cell by cell.
    Cells,
}

/// What is to be evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Asked {
    /// How `u` is continued from surfels to the surface.
    pub field: Field,
    /// How measures are kept; a continuous field has none but on surfels, so it is always lumped.
    pub keep: Keep,
    /// Whether mu_Omega is wanted too.
    pub quality: bool,
}

/// What is remarkable about a surfel, before any ball is looked at: bits of [`CellMeasures::marks`].
pub mod mark {
    /// A pointel of the surfel needed a lift, or with a continuous field the surfel itself: k != 0.
    pub const LIFTED: u8 = 1;
    /// The surfel has a side on the border of an open image, or its normal's ball is cut by it.
    pub const CUT: u8 = 2;
    /// No normal could be estimated.
    pub const DEGENERATE: u8 = 4;
    /// <u, n> <= 0; with a continuous field on the average, mu0 <= 0.
    pub const OPPOSED: u8 = 8;
    /// A surfel around one of its pointels, or itself, is [`CUT`]: its linels and pointels then
    /// have measures that what is beyond the border could change.
    pub const NEAR_CUT: u8 = 16;
}

/// Measures of the cells of a brick's core, in Khalimsky order of their surfels.
#[derive(Clone, Debug, Default)]
pub struct CellMeasures {
    /// One a surfel, with [`Keep::Lumped`].
    pub lumped: Vec<Lumped>,
    /// mu0 of each surfel, with [`Keep::Cells`].
    pub mu0: Vec<i64>,
    /// Tensors of the linels owned, by surfel, then by side.
    pub linels: Vec<Tensor>,
    /// mu2 of the umbrellas owned, by surfel, then by corner.
    pub umbrellas: Vec<i64>,
    /// mu_Omega, if it was asked for: one a surfel with [`Keep::Lumped`], half of that of each of its
    /// linels; with [`Keep::Cells`] one for each of `linels`.
    pub omega: Vec<i64>,
    /// First of `linels` and of `umbrellas` of each surfel, and one past the last.
    pub owned_from: Vec<[u32; 2]>,
    /// One a surfel: bits of [`mark`].
    pub marks: Vec<u8>,
}

impl CellMeasures {
    /// Memory held, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.lumped.len() * 64
            + self.mu0.len() * 8
            + self.linels.len() * 48
            + self.umbrellas.len() * 8
            + self.omega.len() * 8
            + self.owned_from.len() * 8
            + self.marks.len()
    }
}

/// Exact totals over the cells of a surface: additive, so in any order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellTotals {
    /// Surfels along x, y, z.
    pub surfels: [u64; 3],
    /// Linels, split ones twice, those on the border too.
    pub linels: u64,
    /// Linels on the border of an open image: zero if the surface is closed.
    pub border_linels: u64,
    /// Pointels, once for each umbrella or chain.
    pub pointels: u64,
    /// Sum of mu0, in the unit of [`fixed::from_measure`].
    pub mu0: i128,
    /// Sum of mu1, the same unit.
    pub mu1: i128,
    /// Sum of mu2, in the unit of [`fixed::from_solid_angle`].
    pub mu2: i128,
    /// Sum of the lifts k; with a linear field there are none.
    pub lifts: i64,
    /// Sum of |k|: how bad `u` is.
    pub absolute_lifts: u64,
}

impl CellTotals {
    /// Adds the totals of other cells.
    pub fn add(&mut self, other: &Self) {
        for a in 0..3 {
            self.surfels[a] += other.surfels[a];
        }
        self.linels += other.linels;
        self.border_linels += other.border_linels;
        self.pointels += other.pointels;
        self.mu0 += other.mu0;
        self.mu1 += other.mu1;
        self.mu2 += other.mu2;
        self.lifts += other.lifts;
        self.absolute_lifts += other.absolute_lifts;
    }

    /// Number of surfels.
    #[must_use]
    pub fn surfel_count(&self) -> u64 {
        self.surfels.iter().sum()
    }

    /// V - E + F, counted.
    #[must_use]
    pub fn euler_counted(&self) -> i128 {
        i128::from(self.pointels) - i128::from(self.linels) + i128::from(self.surfel_count())
    }

    /// V - E + F by Gauss-Bonnet, (sum(mu2) + 4 pi sum(k)) / 2 pi; `None` if the surface is open or
    /// (impossible on a closed surface with `u` of unit length) the quotient is not whole.
    #[must_use]
    pub fn euler_gauss_bonnet(&self) -> Option<i128> {
        let lifted = self.mu2 + i128::from(self.lifts) * i128::from(fixed::SPHERE);
        let whole = i128::from(fixed::SPHERE / 2);
        (self.border_linels == 0 && lifted % whole == 0).then_some(lifted / whole)
    }
}

/// In place of the number of a surfel that is not in the core.
pub(super) const RIM: u32 = u32::MAX;

/// Numbers within the core of the surfels of a surface.
pub(super) struct Numbers {
    /// Of each surfel; [`RIM`] outside of the core.
    pub(super) of: Vec<u32>,
    /// Surfels of the core.
    pub(super) count: usize,
}

impl Numbers {
    pub(super) fn of(surface: &Surface, core: CellBox) -> Self {
        let mut of = vec![RIM; surface.len()];
        let mut count = 0;
        for (i, number) in of.iter_mut().enumerate() {
            if core.contains(surface.surfels.oriented(i).cell()) {
                *number = count;
                count += 1;
            }
        }
        Self {
            of,
            count: count as usize,
        }
    }
}

/// Marks the surfels of the core around a pointel as near a cut if one of all is cut.
pub(super) fn spread_cut(members: &[usize], marks: &[u8], core: &Numbers, core_marks: &mut [u8]) {
    if members.iter().any(|&m| marks[m] & mark::CUT != 0) {
        for &m in members {
            if core.of[m] != RIM {
                core_marks[core.of[m] as usize] |= mark::NEAR_CUT;
            }
        }
    }
}

/// Evaluates the cells of `core` on a surface that covers one cell more on each side.
///
/// `u` and `marks` are those of all surfels of the surface; the marks of the core are completed
/// with [`mark::LIFTED`], [`mark::OPPOSED`] and [`mark::NEAR_CUT`].
///
/// # Panics
/// With a continuous field, if the surface does not cover the cells around the core.
#[must_use]
pub fn evaluate(
    surface: &Surface,
    core: CellBox,
    edges: [f64; 3],
    u: &[DVec3],
    marks: &[u8],
    asked: Asked,
) -> (CellMeasures, CellTotals) {
    let Asked {
        field,
        keep,
        quality,
    } = asked;
    if field.is_continuous() {
        return super::field::evaluate(surface, core, edges, u, marks, field, quality);
    }
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
    let mut lumped: Vec<Lumped> = vec![[0; 8]; if keep == Keep::Lumped { core_count } else { 0 }];
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
        out.marks.push(marks[i] | opposed | near);
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
                totals.mu1 += i128::from(whole[0]) + i128::from(whole[1]) + i128::from(whole[2]);
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

/// What is found around a pointel.
pub(super) enum Around {
    /// An umbrella; its surfels are listed counter-clockwise from the one asked.
    Cycle,
    /// A chain that ends on the border of an open image.
    Chain,
    /// Another surfel of it has a lower number.
    NotLowest,
    /// It leaves the box.
    Beyond,
}

/// Lists the surfels around corner `j` of surfel `i`, if `i` is the lowest of them.
pub(super) fn umbrella(surface: &Surface, i: usize, j: usize, members: &mut Vec<usize>) -> Around {
    members.clear();
    let (mut at, mut corner) = (i, j);
    loop {
        members.push(at);
        match surface.links.next_corner(at, corner) {
            Ok((n, _)) if n < i => return Around::NotLowest,
            Ok((n, c)) if n == i && c == j => return Around::Cycle,
            Ok((n, c)) => (at, corner) = (n, c),
            Err(Link::BORDER) => break,
            Err(_) => return Around::Beyond,
        }
    }
    (at, corner) = (i, j);
    loop {
        match surface.links.previous_corner(at, corner) {
            Ok((n, _)) if n < i => return Around::NotLowest,
            Ok((n, c)) => {
                members.push(n);
                (at, corner) = (n, c);
            }
            Err(Link::BORDER) => return Around::Chain,
            Err(_) => return Around::Beyond,
        }
    }
}
