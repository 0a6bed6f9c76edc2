//! Measures with `u` constant on each surfel (paper, Proposition 3.8).
//!
//! Comes in: the surface of a brick's core with one cell around, and `u` of all its surfels. Goes
//! out: mu0 of surfels, tensors of linels, mu2 of pointels and totals, in the form of [`super::cells`].
//! mu_Omega is evaluated if asked for ([`Asked::quality`]); on a closed surface its integers sum to zero.
//!
//! A linel or umbrella shared by bricks is evaluated by each of them, from the same numbers in the
//! same order, so with the same bits; everything else is evaluated once. Linels are evaluated some at a
//! time (`linels.rs`), umbrellas one by one.
//!
//! **mu2 by the lift.** The area of the spherical polygon u_1 .. u_d around a pointel differs from
//! that of the trivial normals, (4 - d) pi/2, by the areas swept between consecutive surfels
//! ([`super::formula::swept_area`]); these are antisymmetric and integers, so over a closed surface they cancel
//! and what is left is 2 pi (V - E + F). L = (4 - d) pi/2 - sum Q is a lift of the area;
//! mu2 = L - 4 pi k with k the nearest integer of L / 4 pi (half a sphere being +2 pi). It equals the paper's area wherever
//! the normals of the umbrella lie in one hemisphere (condition iii of a corrected normal field).

use glam::DVec3;

use crate::khalimsky::{Direction, SIDES, axis, sign};
use crate::normal::trivial_normal;
use crate::simd::{Level, Work, dispatch};
use crate::surfel::{CellBox, Link};

use super::cells::{
    Around, Asked, CellMeasures, CellTotals, Keep, Numbers, RIM, Umbrellas, mark, spread_cut,
};
use super::fixed;
use super::linels::{LinelMeasures, Linels, TOGETHER};
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
    dispatch(Cells::new(surface, core, edges, u, marks, asked))
}

/// The cells of a core, which are evaluated.
struct Cells<'a> {
    surface: &'a Surface,
    edges: [f64; 3],
    u: &'a [DVec3],
    marks: &'a [u8],
    asked: Asked,
    numbers: Numbers,
    /// Linels and umbrellas of each surfel of the core, with [`Keep::Cells`].
    owned: Vec<[u32; 2]>,
    out: CellMeasures,
    totals: CellTotals,
}

impl Work for Cells<'_> {
    type Output = (CellMeasures, CellTotals);

    #[inline(always)]
    fn run<L: Level>(mut self) -> (CellMeasures, CellTotals) {
        self.surfels();
        let swept = self.linels();
        self.pointels(&swept);
        let mut out = self.out;
        if self.asked.keep == Keep::Cells {
            let mut from = [0u32; 2];
            for n in &self.owned {
                out.owned_from.push(from);
                from = [from[0] + n[0], from[1] + n[1]];
            }
            out.owned_from.push(from);
        }
        out.linels.shrink_to_fit();
        out.umbrellas.shrink_to_fit();
        (out, self.totals)
    }
}

/// A side of a surfel, and what lies across.
#[derive(Clone, Copy)]
struct Side {
    surfel: u32,
    side: u32,
    link: Link,
}

/// The unit vector of each direction.
fn directions() -> [[f64; 3]; 6] {
    [0, 1, 2, 3, 4, 5].map(|direction: Direction| trivial_normal(direction).to_array())
}

impl<'a> Cells<'a> {
    fn new(
        surface: &'a Surface,
        core: CellBox,
        edges: [f64; 3],
        u: &'a [DVec3],
        marks: &'a [u8],
        asked: Asked,
    ) -> Self {
        let numbers = Numbers::of(surface, core);
        let count = numbers.count;
        let if_kept = |keep: Keep, count: usize| if asked.keep == keep { count } else { 0 };
        let lumped_omega = if_kept(Keep::Lumped, if asked.quality { count } else { 0 });
        let out = CellMeasures {
            lumped: vec![[0; 8]; if_kept(Keep::Lumped, count)],
            mu0: Vec::with_capacity(if_kept(Keep::Cells, count)),
            linels: Vec::with_capacity(if_kept(Keep::Cells, count * 9 / 4)),
            umbrellas: Vec::with_capacity(if_kept(Keep::Cells, count * 9 / 8)),
            omega: vec![0; lumped_omega],
            owned_from: Vec::new(),
            marks: Vec::with_capacity(count),
        };
        Self {
            surface,
            edges,
            u,
            marks,
            asked,
            owned: vec![[0; 2]; if_kept(Keep::Cells, count)],
            numbers,
            out,
            totals: CellTotals::default(),
        }
    }

    /// mu0 and marks of the surfels of the core; and their linels on the border.
    #[inline(always)]
    fn surfels(&mut self) {
        let edges = self.edges;
        let areas = [
            edges[1] * edges[2],
            edges[2] * edges[0],
            edges[0] * edges[1],
        ];
        let mut total = 0;
        for (i, surfel) in self.surface.surfels.list.iter().enumerate() {
            let number = self.numbers.of[i];
            if number == RIM {
                continue;
            }
            let along = axis(surfel.orientation);
            let cosine = f64::from(sign(surfel.orientation)) * self.u[i][along];
            let mu0 = fixed::from_measure(cosine * areas[along]);
            self.totals.surfels[along] += 1;
            total += i128::from(mu0);
            let opposed = if cosine <= 0.0 { mark::OPPOSED } else { 0 };
            let near = if self.marks[i] & mark::CUT != 0 {
                mark::NEAR_CUT
            } else {
                0
            };
            let ridge = if self.surface.is_ridge(i) {
                mark::RIDGE
            } else {
                0
            };
            self.out.marks.push(self.marks[i] | opposed | near | ridge);
            match self.asked.keep {
                Keep::Lumped => self.out.lumped[number as usize][0] = mu0,
                Keep::Cells => self.out.mu0.push(mu0),
            }
            for link in self.surface.links.of[i] {
                let border = u64::from(link == Link::BORDER);
                self.totals.linels += border;
                self.totals.border_linels += border;
            }
        }
        self.totals.mu0 += total;
    }

    /// Tensors of the linels that touch the core. Gives the swept areas of all, by surfel and side.
    #[inline(always)]
    fn linels(&mut self) -> Vec<[i64; 4]> {
        let surface = self.surface;
        let directions = directions();
        let mut swept = vec![[0i64; 4]; surface.len()];
        let mut linels = Linels::new();
        let mut measures = LinelMeasures::new();
        let nowhere = Side {
            surfel: 0,
            side: 0,
            link: Link::BORDER,
        };
        // A surfel adds at most 4, of which those that are not its own are overwritten.
        let mut sides = [nowhere; TOGETHER + 3];
        let mut held = 0;
        let count = surface.len();
        for i in 0..count {
            for (j, &link) in surface.links.of[i].iter().enumerate() {
                sides[held] = Side {
                    surfel: i as u32,
                    side: j as u32,
                    link,
                };
                held += usize::from(link.surfel().is_some_and(|n| n >= i));
            }
            while held >= TOGETHER || (held > 0 && i + 1 == count) {
                let now = held.min(TOGETHER);
                for (at, side) in sides[..now].iter().enumerate() {
                    self.set(&mut linels, at, side, &directions);
                }
                let share = match self.asked.keep {
                    Keep::Lumped => 0.5,
                    Keep::Cells => 1.0,
                };
                linels.evaluate(share, &mut measures);
                for (at, side) in sides[..now].iter().enumerate() {
                    self.take(&measures, at, side, &mut swept);
                }
                sides.copy_within(now..held, 0);
                held -= now;
            }
        }
        swept
    }

    /// Sets what the formulas take of a linel.
    #[inline(always)]
    fn set(&self, linels: &mut Linels, at: usize, side: &Side, directions: &[[f64; 3]; 6]) {
        let Some((f, g, along)) = self.linel(side) else {
            return;
        };
        let list = &self.surface.surfels.list;
        let normal = |i: usize| directions[list[i].orientation as usize];
        linels.set(
            at,
            [normal(f), normal(g)],
            [self.u[f], self.u[g]],
            directions[along as usize],
            self.edges[axis(along)],
        );
    }

    /// The surfels of a linel, that of the lower number first, and where it runs along its boundary.
    #[inline(always)]
    fn linel(&self, side: &Side) -> Option<(usize, usize, Direction)> {
        let f = side.surfel as usize;
        let sides = SIDES[self.surface.surfels.list[f].orientation as usize];
        let along = sides[(side.side as usize + 1) % 4];
        side.link.surfel().map(|g| (f, g, along))
    }

    /// Takes the measures of a linel.
    #[inline(always)]
    fn take(&mut self, measures: &LinelMeasures, at: usize, side: &Side, swept: &mut [[i64; 4]]) {
        let Some((f, g, along)) = self.linel(side) else {
            return;
        };
        swept[f][side.side as usize] = measures.swept[at];
        swept[g][side.link.side_there()] = -measures.swept[at];
        let [mine, other] = [self.numbers.of[f], self.numbers.of[g]];
        if mine != RIM {
            self.totals.linels += 1;
            self.totals.mu1 += i128::from(measures.mu1[at]);
        }
        match self.asked.keep {
            Keep::Lumped => {
                for number in [mine, other] {
                    if number != RIM {
                        let lump = &mut self.out.lumped[number as usize];
                        for t in 0..6 {
                            lump[t + 1] += measures.tensor[t][at];
                        }
                    }
                }
            }
            Keep::Cells => {
                if mine != RIM {
                    let mut tensor = [0; 6];
                    for t in 0..6 {
                        tensor[t] = measures.tensor[t][at];
                    }
                    self.out.linels.push(tensor);
                    self.owned[mine as usize][0] += 1;
                }
            }
        }
        if self.asked.quality {
            self.take_omega([f, g], along);
        }
    }

    /// mu_Omega of the linel of two surfels.
    ///
    /// <e, u_f - u_g> length (Proposition 3.8), rounded such that opposite sides of a surfel
    /// cancel: over a closed surface the sum is exactly zero.
    #[inline(always)]
    fn take_omega(&mut self, [f, g]: [usize; 2], along: Direction) {
        let a = axis(along);
        let part_of_omega = |part: f64| {
            let length = part * self.edges[a] * f64::from(sign(along));
            fixed::from_measure(length * self.u[f][a]) - fixed::from_measure(length * self.u[g][a])
        };
        match self.asked.keep {
            Keep::Lumped => {
                let half = part_of_omega(0.5);
                for i in [f, g] {
                    let number = self.numbers.of[i];
                    if number != RIM {
                        self.out.omega[number as usize] += half;
                    }
                }
            }
            Keep::Cells => {
                if self.numbers.of[f] != RIM {
                    self.out.omega.push(part_of_omega(1.0));
                }
            }
        }
    }

    /// mu2 of the umbrellas that touch the core, of which `swept` has the areas swept.
    #[inline(always)]
    fn pointels(&mut self, swept: &[[i64; 4]]) {
        let mut umbrellas = Umbrellas::of(self.surface);
        for i in 0..self.surface.len() {
            for j in 0..4 {
                match umbrellas.find(i, j) {
                    Around::Cycle => self.umbrella(i, &umbrellas.corners, swept),
                    // its surfels touch the border, so they are cut themselves
                    Around::Chain => {
                        self.totals.pointels += u64::from(self.numbers.of[i] != RIM);
                    }
                    Around::Nothing => {}
                }
            }
        }
    }

    /// mu2 of an umbrella, whose lowest surfel is `i`.
    #[inline(always)]
    fn umbrella(&mut self, i: usize, corners: &[u32], swept: &[[i64; 4]]) {
        let mut lift = (4 - corners.len() as i64) * fixed::QUARTER_TURN;
        let mut marks = 0;
        let mut touches = false;
        for &corner in corners {
            let (at, corner) = (corner as usize / 4, corner as usize % 4);
            lift -= swept[at][corner];
            marks |= self.marks[at];
            touches |= self.numbers.of[at] != RIM;
        }
        if !touches {
            return;
        }
        if marks & mark::CUT != 0 {
            spread_cut(corners, &self.numbers, &mut self.out.marks);
        }
        let k = fixed::nearest_lift(lift);
        let mu2 = lift - k * fixed::SPHERE;
        let owner = self.numbers.of[i];
        if owner != RIM {
            self.totals.pointels += 1;
            self.totals.mu2 += i128::from(mu2);
            self.totals.lifts += k;
            self.totals.absolute_lifts += k.unsigned_abs();
            if self.asked.keep == Keep::Cells {
                self.out.umbrellas.push(mu2);
                self.owned[owner as usize][1] += 1;
            }
        }
        let share = fixed::lumped_share(mu2, corners.len());
        let lifted = if k != 0 { mark::LIFTED } else { 0 };
        for &corner in corners {
            let number = self.numbers.of[corner as usize / 4];
            if number == RIM {
                continue;
            }
            if self.asked.keep == Keep::Lumped {
                self.out.lumped[number as usize][7] += share;
            }
            self.out.marks[number as usize] |= lifted;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::khalimsky::Adjacency;
    use crate::lattice::Lattice;
    use crate::measure::cells::Tensor;
    use crate::measure::field::Field;
    use crate::measure::formula::{linel_tensor, swept_area};
    use crate::simd::at_every_level;
    use crate::testing::numbers;
    use crate::volume::scattered;

    /// Normals of all kinds: any, near the trivial ones, the trivial ones, their opposites, one and the same.
    fn normals(surface: &Surface, seed: u64) -> Vec<DVec3> {
        let mut number = numbers(seed);
        let list = &surface.surfels.list;
        let of = |surfel: &crate::surfel::Surfel| {
            let n = trivial_normal(surfel.orientation);
            let any = DVec3::new(number(), number(), number()).normalize();
            match (8.0 * (number() + 1.0)) as i32 {
                0 => n,
                1 => -n,
                2 => DVec3::X,
                3 => -DVec3::X,
                4 => (DVec3::X + 1e-7 * any).normalize(),
                5 => (-DVec3::X + 1e-13 * any).normalize(),
                6..10 => (n + 0.7 * any).normalize(),
                _ => any,
            }
        };
        list.iter().map(of).collect()
    }

    /// Measures of all cells, each by itself.
    fn plainly(cells: &Cells) -> (CellMeasures, CellTotals) {
        let (surface, u, of) = (cells.surface, cells.u, &cells.numbers.of);
        let edges = cells.edges;
        let count = surface.len();
        let list = &surface.surfels.list;
        let n = |i: usize| trivial_normal(list[i].orientation);
        let (mut out, mut totals) = (cells.out.clone(), CellTotals::default());
        let mut owned = vec![(Vec::<Tensor>::new(), Vec::<i64>::new()); count];
        let mut swept = vec![[0; 4]; count];
        let mut lumped = vec![[0; 8]; count];
        let mut omega = vec![0; count];
        let mut omegas = Vec::new();
        let mut lifted = vec![false; count];
        for i in 0..count {
            let a = axis(list[i].orientation);
            let area = edges[(a + 1) % 3] * edges[(a + 2) % 3];
            lumped[i][0] = fixed::from_measure(u[i].dot(n(i)) * area);
            for j in 0..4 {
                let link = surface.links.of[i][j];
                let Some(g) = link.surfel().filter(|&g| g >= i) else {
                    continue;
                };
                let area = fixed::from_solid_angle(swept_area(n(i), n(g), u[i], u[g]));
                (swept[i][j], swept[g][link.side_there()]) = (area, -area);
                let along = SIDES[list[i].orientation as usize][(j + 1) % 4];
                let (e, length) = (trivial_normal(along), edges[axis(along)]);
                let tensor = linel_tensor(u[i], u[g], e, length).terms();
                owned[i].0.push(tensor.map(fixed::from_measure));
                for f in [i, g] {
                    for t in 0..6 {
                        lumped[f][t + 1] += fixed::from_measure(0.5 * tensor[t]);
                    }
                    let on = |u: DVec3| fixed::from_measure(0.5 * length * e.dot(u));
                    omega[f] += on(u[i]) - on(u[g]);
                }
                if of[i] != RIM {
                    let on = |u: DVec3| fixed::from_measure(length * e.dot(u));
                    omegas.push(on(u[i]) - on(u[g]));
                }
            }
        }
        for i in 0..count {
            for j in 0..4 {
                // all corners around, until one is met again
                let mut corners = vec![(i, j)];
                let closed = loop {
                    let (at, corner) = corners[corners.len() - 1];
                    match surface.links.next_corner(at, corner) {
                        Ok(next) if next == (i, j) => break true,
                        Ok(next) => corners.push(next),
                        Err(_) => break false,
                    }
                };
                if !closed || corners.iter().any(|&(n, _)| n < i) {
                    continue;
                }
                let turned: i64 = corners.iter().map(|&(n, c)| swept[n][c]).sum();
                let lift = (4 - corners.len() as i64) * fixed::QUARTER_TURN - turned;
                let k = fixed::nearest_lift(lift);
                let mu2 = lift - k * fixed::SPHERE;
                owned[i].1.push(mu2);
                for &(n, _) in &corners {
                    lumped[n][7] += fixed::lumped_share(mu2, corners.len());
                    lifted[n] |= k != 0;
                }
                if of[i] != RIM {
                    totals.lifts += k;
                    totals.absolute_lifts += k.unsigned_abs();
                }
            }
        }
        let mut from = [0, 0];
        for i in (0..count).filter(|&i| of[i] != RIM) {
            let opposed = u[i].dot(n(i)) <= 0.0;
            let ridge = surface.is_ridge(i);
            out.marks.push(
                [
                    (opposed, mark::OPPOSED),
                    (ridge, mark::RIDGE),
                    (lifted[i], mark::LIFTED),
                ]
                .iter()
                .map(|&(on, bit)| if on { bit } else { 0 })
                .sum(),
            );
            let (linels, umbrellas) = &owned[i];
            totals.surfels[axis(list[i].orientation)] += 1;
            totals.linels += linels.len() as u64;
            totals.pointels += umbrellas.len() as u64;
            totals.mu0 += i128::from(lumped[i][0]);
            let traces = linels.iter().map(|m| m[..3].iter().sum::<i64>());
            totals.mu1 += i128::from(traces.sum::<i64>());
            totals.mu2 += i128::from(umbrellas.iter().sum::<i64>());
            match cells.asked.keep {
                Keep::Lumped => {
                    out.lumped[of[i] as usize] = lumped[i];
                    out.omega[of[i] as usize] = omega[i];
                }
                Keep::Cells => {
                    out.owned_from.push(from);
                    from = [
                        from[0] + linels.len() as u32,
                        from[1] + umbrellas.len() as u32,
                    ];
                    out.mu0.push(lumped[i][0]);
                    out.linels.extend(linels);
                    out.umbrellas.extend(umbrellas);
                }
            }
        }
        if cells.asked.keep == Keep::Cells {
            out.owned_from.push(from);
            out.omega = omegas;
        }
        (out, totals)
    }

    fn same(a: &(CellMeasures, CellTotals), b: &(CellMeasures, CellTotals)) {
        assert_eq!(a.1, b.1);
        assert_eq!(a.0.lumped, b.0.lumped);
        assert_eq!(a.0.mu0, b.0.mu0);
        assert_eq!(a.0.linels, b.0.linels);
        assert_eq!(a.0.umbrellas, b.0.umbrellas);
        assert_eq!(a.0.omega, b.0.omega);
        assert_eq!(a.0.owned_from, b.0.owned_from);
        assert_eq!(a.0.marks, b.0.marks);
    }

    /// A closed image of scattered voxels, and a box of its cells with one cell around.
    fn surface(seed: u64, core: CellBox, adjacency: Adjacency) -> Surface {
        let dims = [9, 8, 7];
        let lattice = Lattice::new(dims.map(u64::from), [1.0; 3], true).unwrap();
        let cells = core.grown([1; 3], lattice.cell_dims());
        Surface::extract(&scattered(dims, seed), cells, &lattice, adjacency)
    }

    #[test]
    fn measures_in_groups_are_those_of_each_cell() {
        let cores = [([0; 3], [10, 9, 8]), ([2, 3, 1], [7, 6, 5])];
        for (seed, (lo, hi)) in (1..).zip(cores.into_iter().cycle()).take(8) {
            let core = CellBox { lo, hi };
            let adjacency = [Adjacency::Interior, Adjacency::Exterior][seed as usize / 2 % 2];
            let surface = surface(seed, core, adjacency);
            let u = normals(&surface, seed);
            let marks = vec![0; surface.len()];
            for keep in [Keep::Lumped, Keep::Cells] {
                let asked = Asked {
                    field: Field::Constant,
                    keep,
                    quality: true,
                };
                let cells = || Cells::new(&surface, core, [1.0, 0.7, 0.9], &u, &marks, asked);
                let expected = plainly(&cells());
                for found in at_every_level(cells) {
                    same(&found, &expected);
                }
            }
        }
    }

    #[test]
    fn normals_that_are_none_do_no_harm() {
        let core = CellBox {
            lo: [0; 3],
            hi: [10, 9, 8],
        };
        let surface = surface(5, core, Adjacency::Interior);
        let mut u = normals(&surface, 5);
        for (i, u) in u.iter_mut().enumerate() {
            match i % 11 {
                0 => u.x = f64::NAN,
                1 => *u = DVec3::ZERO,
                2 => *u *= 1e200,
                3 => u.y = f64::INFINITY,
                _ => {}
            }
        }
        let marks = vec![0; surface.len()];
        let asked = Asked {
            field: Field::Constant,
            keep: Keep::Lumped,
            quality: true,
        };
        let levels = at_every_level(|| Cells::new(&surface, core, [1.0; 3], &u, &marks, asked));
        for found in &levels {
            same(found, &levels[0]);
            assert_eq!(
                found.1.euler_gauss_bonnet(),
                Some(found.1.euler_counted()),
                "areas are swept to and fro, whatever they are"
            );
        }
    }
}
