//! Sums of measures over the part of the surface in a ball.
//!
//! Comes in: the surface of a brick's core and halo, with the measures of its cells. Goes out:
//! [`BallSums`] for a surfel of the core.
//!
//! **Which surfels** ([`Extent`]). W(p) are the surfels whose centroid is in the closed ball of
//! radius rho around that of p. By default only C(p) counts, the part of W(p) connected to p
//! through linels within W(p), so that another sheet nearby does not pollute the sum; `Whole`
//! takes W(p), the paper's Borel set. Where the reach of the surface exceeds rho both are the same.
//!
//! **Which cells, and how much of them** ([`Weights`]):
//!
//! | weights | a surfel | a linel | a pointel |
//! |---|---|---|---|
//! | `Sharp` | 1 if in the set | 1 if both its surfels are | 1 if its whole umbrella is |
//! | `Lumped` | 1 if in the set | 1/2 for each of its surfels that is | 1/d for each of its d surfels that is |
//! | `Dgtal` | share of its extent in the ball | the same, by its ends and middle | 1 if in the ball |
//! | `Compensated` | W by its distance | as `Lumped`, times W | as `Lumped`, times W |
//!
//! **Compensated weights.** A sum with weights W(d) over the distance d is a mixture of the paper's
//! measures: sum W(d) mu = - integral of mu(B_s) W'(s) ds. So what the paper proves of mu(B_s) for each s
//! (stability, section 4; convergence, section 5) holds for the sum, with constants multiplied by the integral of
//! |W'|. Taken as an average over a disc of the surface a sharp ball has a bias of the second moment of W times the
//! surface Laplacian of the curvature; W = (1 - t)(1 - 2t), t = d^2 / s^2, has no second moment, and
//! leaves the fourth order. It is negative beyond 0.7 s, and its integral is a third of that of 1 - t: it asks for normals that
//! are good. Where the surface is noisy, W gives way to 1 - t over [`ROBUST_WIDENING`] radii:
//!
//! - Where the surface is noise. A *ridge* is a surfel with opposite normals across two opposite sides: a wall one voxel thick, or a
//!   pit or tip one voxel wide. A smooth surface has at most a few where it touches its extreme
//!   planes; noise is made of them. [`NOISY_SHARE`] are the shares of C(p) from which W begins to give way and has given way.
//! - Where negative weights eat up the area, on parts of the surface smaller than the ball: [`EATEN_AREA`].
//!
//! With a continuous field ([`super::field`]) all measures lie on surfels: `Sharp` is then the same as
//! `Lumped`, and `Dgtal` takes a surfel's share of all its measures. mu_Omega is summed if it was evaluated.
//!
//! Guaranteed: sums are of integers, so exact. For that, weights of `Compensated` are rounded to multiples of 2^-15, and the
//! measures they multiply to 2^-26 (`grouped.rs`). Which cells take part is decided in integers
//! (except with `Dgtal`, whose shares, rounded to 2^-48 each, and pointels go by distances in
//! floating point). `Sharp` counts fewer linels
//! than the rim of the set has a share in, so it is low by about 0.6 / rho; it is what makes
//! V - E + F of the set an Euler characteristic. `Lumped` has no such bias.

use std::ops::Range;

use crate::khalimsky::axis;
use crate::lattice::{Ball, Lattice, LatticeError, MAX_RADIUS};
use crate::simd::{Level, Work, dispatch};
use crate::surfel::{Kind, Rim, Surfel, Walker, displacement};
use crate::symmetric::Symmetric;

use super::cells::{Keep, mark};
use super::field::Field;
use super::fixed;
use super::grouped::{self, Falloff, GroupBlock};
pub use super::local::LocalMeasures;
use super::local::{LocalCells, NONE};
use super::mixture::{Mixture, SumsBlock, TOGETHER};
use super::surface::Surface;

/// Which part of the surface in the ball is summed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Extent {
    /// C(p): connected to the surfel within the ball.
    #[default]
    Connected,
    /// W(p): all of it.
    Whole,
}

/// How cells at the rim of the ball count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weights {
    /// A cell counts wholly or not at all.
    Sharp,
    /// Linels and pointels are shared out to their surfels.
    Lumped,
    /// DGtal's inclusion ratios.
    Dgtal,
    /// Lumped, with weights that fall with the distance and have no second moment where the surface is
    /// smooth.
    Compensated(Compensation),
}

/// Which normals compensated weights are made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compensation {
    /// Averages of the surface, and others that are not refined. *Measured* of gradients of grey values: the limits of refined normals are
    /// no better on clean images, and 1.2 times as wrong with noise.
    Averaged,
    /// Refined normals, which are good enough for a smaller ball and smaller differences.
    Refined,
}

impl Compensation {
    /// Support of W, in radii. *Measured*: of refined normals 1.2 and 1.6 give 1.5 % more than 1.4.
    #[must_use]
    pub fn support(self) -> f64 {
        match self {
            Compensation::Averaged => 1.6,
            Compensation::Refined => 1.4,
        }
    }

    /// Contrasts between which W takes over from the robust weights. *Measured*: on spheres, where both are right, 95 % of averages are below
    /// 0.44 and of refined normals below 0.27; limits of half as much, and of 1.3 (averages) or 2 times, give up to 3 % more.
    #[must_use]
    pub fn contrast(self) -> [f64; 2] {
        match self {
            Compensation::Averaged => [0.5, 1.3],
            Compensation::Refined => [0.2, 0.6],
        }
    }
}

/// Support of the robust weights 1 - t, in radii.
pub const ROBUST_WIDENING: f64 = 1.2;

/// Shares of ridges in C(p) between which the weights change. *Measured* at radius 3 h^(-1/2) voxels: on smooth shapes
/// at most 0.063 (0.053 from h = 1/2 on) but for a torus whose tube is two voxels thick, 0.18; with noise p = 0.1 of the
/// paper's section 6.1.6 99 in 100 surfels have at least 0.138, at p = 0.3 at least 0.46.
pub const NOISY_SHARE: [f64; 2] = [0.07, 0.14];

/// Corrected area by the compensated weights over that by the robust ones, below which
/// the weights have changed and above which they do not: it is 1 on a plane, and on a sphere that is larger than the ball.
pub const EATEN_AREA: [f64; 2] = [0.4, 0.6];

impl Weights {
    /// Whether linels and pointels are shared out to their surfels.
    #[must_use]
    pub fn are_lumped(self) -> bool {
        matches!(self, Weights::Lumped | Weights::Compensated(_))
    }

    /// Support of the sums, in radii.
    #[must_use]
    pub fn support(self) -> f64 {
        match self {
            // The same for both: where they agree to be robust, they sum the same part of the surface.
            Weights::Compensated(_) => Compensation::Averaged.support(),
            _ => 1.0,
        }
    }

    /// How the measures of a field must be kept to be summed with these weights.
    #[must_use]
    pub fn keep(self, field: Field) -> Keep {
        if field.is_continuous() || self.are_lumped() {
            Keep::Lumped
        } else {
            Keep::Cells
        }
    }
}

/// Sums at one surfel, in voxel units.
#[derive(Clone, Copy, Debug)]
pub struct BallSums {
    /// Corrected area.
    pub mu0: f64,
    /// Sum of the tensors of linels; its trace is mu1.
    pub tensor: Symmetric,
    /// Sum of mu2, a solid angle.
    pub mu2: f64,
    /// Sum of mu_Omega, a length; 0 unless it was evaluated.
    pub omega: f64,
    /// How C(p) ends.
    pub rim: Rim,
    /// The ball holds surfels that are not connected to this one within it.
    pub several_sheets: bool,
    /// The border of an open image cuts what was summed, or what its normals came from.
    pub cut: bool,
    /// What compensated weights tell beside; `None` with others.
    pub evidence: Option<Evidence>,
}

/// What the two sums of compensated weights tell of how good they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Which weights.
    pub compensation: Compensation,
    /// Norm (Frobenius) of the difference of the tensors over mu0, in 1/voxel unit.
    pub difference: f64,
    /// Difference of H, in 1/voxel unit.
    pub mean_difference: f64,
    /// Share of ridges among the surfels of the ball.
    pub ridges: f64,
}

/// A row of cells in the ball around a surfel of one kind, relative to its cell.
#[derive(Clone, Copy, Debug)]
struct BallRow {
    kind: Kind,
    dy: i32,
    dz: i32,
    x_from: i32,
    x_to: i32,
}

/// Sums over balls of one radius.
#[derive(Clone, Debug)]
pub struct BallKernel {
    /// As asked for, in voxel units.
    radius: f64,
    ball: Ball,
    /// The surfels that can take part: W(p), or for `Dgtal` those that may have a share.
    wide: Ball,
    extent: Extent,
    weights: Weights,
    edges: [f64; 3],
    /// Rows of `wide` around a surfel along x, y, z.
    rows: [Vec<BallRow>; 3],
}

/// Gives `receive` the sums around each of some surfels.
struct SumsOf<'a> {
    kernel: &'a BallKernel,
    surface: &'a Surface,
    measures: &'a LocalMeasures,
    starts: &'a [usize],
    receive: &'a mut dyn FnMut(&SumsBlock),
}

impl Work for SumsOf<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Level>(self) {
        let mut block = SumsBlock::new();
        if let Some(falloff) = self.kernel.falloff(self.measures) {
            let task = grouped::Task {
                surface: self.surface,
                ball: &self.kernel.ball,
                extent: self.kernel.extent,
                falloff,
                lumped: &self.measures.lumped,
                omega: &self.measures.omega,
                marks: &self.measures.marks,
                starts: self.starts,
            };
            let mut receive = |sums: &GroupBlock| {
                dispatch(self.kernel.mixture(sums, falloff, &mut block));
                (self.receive)(&block);
            };
            grouped::sum::<L>(&task, &mut receive);
            return;
        }
        let mut scratch = BallScratch::default();
        // A loop and not an iterator: what an adapter calls is compiled for the baseline.
        for (number, &start) in self.starts.iter().enumerate() {
            let sums = self
                .kernel
                .sum(self.surface, self.measures, start, &mut scratch);
            block.push(number, &sums);
            if block.count == TOGETHER {
                (self.receive)(&block);
                block.count = 0;
            }
        }
        if block.count > 0 {
            (self.receive)(&block);
        }
    }
}

/// Scratch memory of sums over one surface.
#[derive(Clone, Debug, Default)]
struct BallScratch {
    walker: Walker,
    linel_seen: Vec<u32>,
    umbrella_seen: Vec<(u32, u32)>,
    epoch: u32,
}

/// One, in the unit of the shares of `Dgtal`: finer than the measures they multiply.
const SHARE_ONE: f64 = (1u64 << 48) as f64;

/// Half the diagonal of a surfel: no point of it is farther from its centroid, in voxel units.
const HALF_DIAGONAL: f64 = 0.708;

impl BallKernel {
    /// Whether measures can be summed over balls of a radius, in voxel units.
    ///
    /// # Errors
    /// [`LatticeError::Ball`] or [`LatticeError::Radius`].
    pub fn check(radius: f64, weights: Weights, lattice: &Lattice) -> Result<(), LatticeError> {
        let [x, y, z] = lattice.edges();
        let largest = match weights {
            // sums in 128 bits, which have room
            Weights::Compensated(_) => MAX_RADIUS / weights.support(),
            _ => (fixed::MOST_VOXELS * x * y * z * 0.75 / std::f64::consts::PI).cbrt(),
        };
        if radius > largest {
            return Err(LatticeError::Ball { radius, largest });
        }
        let support = radius * weights.support();
        lattice.metric().khalimsky_ball(support).map(drop)
    }

    /// Prepares for a radius in voxel units.
    ///
    /// # Errors
    /// If the radius cannot be used.
    pub fn new(
        radius: f64,
        extent: Extent,
        weights: Weights,
        lattice: &Lattice,
    ) -> Result<Self, LatticeError> {
        Self::check(radius, weights, lattice)?;
        let metric = lattice.metric();
        let ball = metric.khalimsky_ball(radius * weights.support())?;
        let wide = match weights {
            Weights::Dgtal => metric.wider_ball(&ball, HALF_DIAGONAL),
            Weights::Sharp | Weights::Lumped | Weights::Compensated(_) => ball,
        };
        let rows = [0, 1, 2].map(|axis| ball_rows(&wide, axis));
        let edges = lattice.edges();
        Ok(Self {
            radius,
            ball,
            wide,
            extent,
            weights,
            edges,
            rows,
        })
    }

    /// Radius, in voxel units.
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// How cells count.
    #[must_use]
    pub fn weights(&self) -> Weights {
        self.weights
    }

    /// How many cells beyond its own a surfel's sums look, along each axis.
    #[must_use]
    pub fn reach(&self) -> [i32; 3] {
        // To know which linel is whose, the owners around the ball need all their own links.
        let rim = if self.weights.are_lumped() { 0 } else { 2 };
        self.wide.reach().map(|r| r + rim)
    }

    /// Sums around some surfels of the surface, which must cover their reach.
    ///
    /// # Panics
    /// If a surfel is named twice, with measures lumped on surfels.
    #[must_use]
    pub fn sums(
        &self,
        surface: &Surface,
        measures: &LocalMeasures,
        starts: &[usize],
    ) -> Vec<BallSums> {
        let mut sums = vec![None; starts.len()];
        self.for_each_block(surface, measures, starts, &mut |block| {
            for at in 0..block.count {
                sums[block.number[at] as usize] = Some(block.sums(at));
            }
        });
        sums.into_iter().flatten().collect()
    }

    /// Gives `receive` the sums around some surfels of the surface, which must cover their reach, in
    /// no particular order.
    ///
    /// # Panics
    /// As [`Self::sums`].
    pub(crate) fn for_each_block(
        &self,
        surface: &Surface,
        measures: &LocalMeasures,
        starts: &[usize],
        receive: &mut dyn FnMut(&SumsBlock),
    ) {
        dispatch(SumsOf {
            kernel: self,
            surface,
            measures,
            starts,
            receive,
        });
    }

    #[inline(always)]
    fn sum(
        &self,
        surface: &Surface,
        measures: &LocalMeasures,
        start: usize,
        scratch: &mut BallScratch,
    ) -> BallSums {
        let rim = scratch
            .walker
            .walk(&surface.surfels, &surface.links, &self.ball, start);
        let connected = scratch.walker.part().len();
        let mut in_ball = 0;
        if self.weights == Weights::Dgtal {
            let centre = surface.surfels.list[start].k;
            self.for_each_run(surface, start, |run| {
                for i in run {
                    let d = displacement(surface.surfels.list[i].k, centre);
                    in_ball += usize::from(self.ball.contains(d));
                }
            });
        } else {
            self.for_each_row(surface, start, |kind, x, y, z| {
                in_ball += surface.index.count(kind, x, y, z) as usize;
            });
        }
        let mut marks = 0;
        if self.extent == Extent::Connected && self.weights != Weights::Dgtal {
            for &q in scratch.walker.part() {
                marks |= measures.marks[q as usize];
            }
        } else {
            // more than C(p) is summed; with DGtal's weights, hardly more than W(p)
            self.for_each_run(surface, start, |run| {
                for &mark in &measures.marks[run] {
                    marks |= mark;
                }
            });
        }
        // A sharp sum of cells has only linels and pointels whose surfels all belong.
        let cut = match (self.weights, &measures.cells) {
            (Weights::Sharp, Some(_)) => mark::CUT,
            _ => mark::NEAR_CUT,
        };
        let summed = match (self.weights, &measures.cells) {
            (Weights::Sharp, Some(cells)) => self.sum_sharp(surface, cells, start, scratch),
            (Weights::Dgtal, Some(cells)) => self.sum_dgtal(surface, cells, start, scratch),
            (Weights::Dgtal, None) => self.sum_shares(surface, measures, start, scratch),
            _ => unreachable!("lumped measures are summed by groups"),
        };
        BallSums {
            mu0: summed.mu0,
            tensor: summed.tensor,
            mu2: summed.mu2,
            omega: summed.omega,
            rim,
            several_sheets: in_ball > connected,
            cut: marks & cut != 0,
            evidence: None,
        }
    }

    /// Runs of surfel numbers that make up the wide ball.
    #[inline(always)]
    fn for_each_run(&self, surface: &Surface, start: usize, mut f: impl FnMut(Range<usize>)) {
        self.for_each_row(surface, start, |kind, x, y, z| {
            f(surface.index.range(kind, x, y, z))
        });
    }

    /// Rows of cells that make up the wide ball.
    #[inline(always)]
    fn for_each_row(
        &self,
        surface: &Surface,
        start: usize,
        mut f: impl FnMut(Kind, Range<i32>, i32, i32),
    ) {
        let surfel = surface.surfels.oriented(start);
        let (cell, cells) = (surfel.cell(), surface.index.cells());
        for row in &self.rows[axis(surfel.orientation)] {
            let (y, z) = (cell[1] + row.dy, cell[2] + row.dz);
            if y < cells.lo[1] || y >= cells.hi[1] || z < cells.lo[2] || z >= cells.hi[2] {
                continue;
            }
            let from = (cell[0] + row.x_from).max(cells.lo[0]);
            let to = (cell[0] + row.x_to).min(cells.hi[0]);
            if from < to {
                f(row.kind, from..to, y, z);
            }
        }
    }

    /// How the weights of lumped measures fall off; `None` if cells count by themselves, or by DGtal's shares.
    fn falloff(&self, measures: &LocalMeasures) -> Option<Falloff> {
        match (self.weights, &measures.cells) {
            (Weights::Dgtal, _) | (Weights::Sharp, Some(_)) => None,
            (Weights::Sharp, None) | (Weights::Lumped, _) => Some(Falloff::Sharp),
            (Weights::Compensated(of), _) => {
                let one = 4.0 * self.ball.metric.one() as f64;
                let supports = [of.support(), ROBUST_WIDENING].map(|radii| radii * self.radius);
                Some(Falloff::Compensated(supports.map(|s| one * s * s)))
            }
        }
    }

    /// What the weights make of sums over groups.
    fn mixture<'a>(
        &self,
        sums: &'a GroupBlock,
        falloff: Falloff,
        to: &'a mut SumsBlock,
    ) -> Mixture<'a> {
        Mixture {
            of: match self.weights {
                Weights::Compensated(of) => Some(of),
                _ => None,
            },
            radius: self.radius,
            unit: falloff.unit(),
            sums,
            to,
        }
    }

    fn sum_sharp(
        &self,
        surface: &Surface,
        cells: &LocalCells,
        start: usize,
        scratch: &mut BallScratch,
    ) -> Summed {
        scratch.begin(cells);
        let BallScratch {
            walker,
            linel_seen,
            umbrella_seen,
            epoch,
            ..
        } = scratch;
        let mut sums = WideSums::default();
        // A linel counts when its second surfel is met, an umbrella when its last one is.
        let mut add = |i: usize| {
            sums.mu0 += i128::from(cells.mu0[i]);
            for j in 0..4 {
                let linel = cells.linel_of[i][j];
                if linel != NONE {
                    if linel_seen[linel as usize] == *epoch {
                        sums.add_linel(cells, linel as usize, 1);
                    } else {
                        linel_seen[linel as usize] = *epoch;
                    }
                }
                let pointel = cells.umbrella_of[i][j];
                if pointel != NONE {
                    let seen = &mut umbrella_seen[pointel as usize];
                    *seen = if seen.0 == *epoch {
                        (*epoch, seen.1 + 1)
                    } else {
                        (*epoch, 1)
                    };
                    if seen.1 == u32::from(cells.degree[pointel as usize]) {
                        sums.mu2 += i128::from(cells.umbrellas[pointel as usize]);
                    }
                }
            }
        };
        match self.extent {
            Extent::Connected => walker.part().iter().for_each(|&q| add(q as usize)),
            Extent::Whole => self.for_each_run(surface, start, |range| range.for_each(&mut add)),
        }
        sums.to_measures(1.0)
    }

    fn sum_dgtal(
        &self,
        surface: &Surface,
        cells: &LocalCells,
        start: usize,
        scratch: &mut BallScratch,
    ) -> Summed {
        scratch.begin(cells);
        let centre = surface.surfels.list[start].k;
        let BallScratch {
            walker,
            linel_seen,
            umbrella_seen,
            epoch,
            ..
        } = scratch;
        let mut sums = WideSums::default();
        let mut add = |i: usize, share: i128| {
            sums.mu0 += share * i128::from(cells.mu0[i]);
            let surfel = &surface.surfels.list[i];
            for j in 0..4 {
                let linel = cells.linel_of[i][j];
                if linel != NONE && linel_seen[linel as usize] != *epoch {
                    linel_seen[linel as usize] = *epoch;
                    let share = self.linel_share(surfel, j, centre);
                    sums.add_linel(cells, linel as usize, share);
                }
                let pointel = cells.umbrella_of[i][j];
                if pointel != NONE && umbrella_seen[pointel as usize].0 != *epoch {
                    umbrella_seen[pointel as usize].0 = *epoch;
                    let k = corner(surfel, j);
                    if self.distance(k, centre) <= self.ball.radius {
                        sums.mu2 += i128::from(cells.umbrellas[pointel as usize]);
                    }
                }
            }
        };
        self.for_each_share(surface, start, walker, &mut add);
        sums.to_measures(SHARE_ONE)
    }

    /// DGtal's weights where all measures lie on surfels.
    fn sum_shares(
        &self,
        surface: &Surface,
        measures: &LocalMeasures,
        start: usize,
        scratch: &mut BallScratch,
    ) -> Summed {
        let mut sums = WideSums::default();
        self.for_each_share(surface, start, &mut scratch.walker, &mut |i, share| {
            let lump = &measures.lumped[i];
            sums.mu0 += share * i128::from(lump[0]);
            for (sum, x) in sums.tensor.iter_mut().zip(&lump[1..7]) {
                *sum += share * i128::from(*x);
            }
            sums.mu2 += share * i128::from(lump[7]);
            sums.omega += share * i128::from(measures.omega.get(i).copied().unwrap_or(0));
        });
        let mut summed = sums.to_measures(SHARE_ONE);
        summed.mu2 = sums.mu2 as f64 / SHARE_ONE * fixed::LUMPED_SOLID_ANGLE;
        summed
    }

    /// Calls `add` with each surfel that takes part and its share.
    fn for_each_share(
        &self,
        surface: &Surface,
        start: usize,
        walker: &mut Walker,
        add: &mut impl FnMut(usize, i128),
    ) {
        let centre = surface.surfels.list[start].k;
        let mut belongs = |i: usize| {
            let share = self.surfel_share(surface, i, centre);
            if share > 0 {
                add(i, share);
            }
            share > 0
        };
        match self.extent {
            Extent::Connected => {
                walker.walk_where(&surface.links, surface.len(), start, belongs);
            }
            Extent::Whole => self.for_each_run(surface, start, |range| {
                for i in range {
                    belongs(i);
                }
            }),
        }
    }

    /// Distance of two places in Khalimsky coordinates, in voxel units.
    fn distance(&self, k: [i32; 3], centre: [i16; 3]) -> f64 {
        let mut squared = 0.0;
        for a in 0..3 {
            let d = 0.5 * self.edges[a] * f64::from(k[a] - i32::from(centre[a]));
            squared += d * d;
        }
        squared.sqrt()
    }

    /// DGtal's inclusion ratio of a cell by the distances of some of its points.
    fn inclusion(&self, nearest: f64, farthest: f64) -> i128 {
        let radius = self.ball.radius;
        let share = if farthest <= radius {
            1.0
        } else if radius <= nearest {
            0.0
        } else {
            (radius - nearest) / (farthest - nearest)
        };
        (share * SHARE_ONE).round() as i128
    }

    fn surfel_share(&self, surface: &Surface, i: usize, centre: [i16; 3]) -> i128 {
        let surfel = &surface.surfels.list[i];
        let d = self.distance(surfel.k.map(i32::from), centre);
        let (mut nearest, mut farthest) = (d, d);
        for j in 0..4 {
            let d = self.distance(corner(surfel, j), centre);
            nearest = nearest.min(d);
            farthest = farthest.max(d);
        }
        self.inclusion(nearest, farthest)
    }

    fn linel_share(&self, surfel: &Surfel, j: usize, centre: [i16; 3]) -> i128 {
        let (a, b) = (corner(surfel, (j + 3) % 4), corner(surfel, j));
        let middle = [0, 1, 2].map(|i| (a[i] + b[i]) / 2);
        let d = [a, middle, b].map(|k| self.distance(k, centre));
        self.inclusion(d[0].min(d[1]).min(d[2]), d[0].max(d[1]).max(d[2]))
    }
}

/// 0 below a range, 1 above it, and smooth between.
#[inline(always)]
pub(crate) fn rise(x: f64, [from, to]: [f64; 2]) -> f64 {
    // not clamp: of what is no number it is 0
    let s = if x > from {
        ((x - from) / (to - from)).min(1.0)
    } else {
        0.0
    };
    s * s * (3.0 - 2.0 * s)
}

/// Relative Khalimsky coordinates of the pointel at corner `j`: where side `j` ends.
fn corner(surfel: &Surfel, j: usize) -> [i32; 3] {
    use crate::khalimsky::{SIDES, sign};
    let mut k = surfel.k.map(i32::from);
    for side in [j, (j + 1) % 4] {
        let direction = SIDES[surfel.orientation as usize][side];
        k[axis(direction)] += sign(direction);
    }
    k
}

/// Sums wide enough for any ball.
#[derive(Default)]
struct WideSums {
    mu0: i128,
    tensor: [i128; 6],
    mu2: i128,
    omega: i128,
}

/// The sums of a ball as numbers, in voxel units.
struct Summed {
    mu0: f64,
    tensor: Symmetric,
    mu2: f64,
    omega: f64,
}

impl WideSums {
    fn add_linel(&mut self, cells: &LocalCells, linel: usize, share: i128) {
        for (sum, x) in self.tensor.iter_mut().zip(&cells.linels[linel]) {
            *sum += share * i128::from(*x);
        }
        if let Some(&omega) = cells.omega.get(linel) {
            self.omega += share * i128::from(omega);
        }
    }

    /// As numbers; `one` is what a share of 1 was multiplied by, but for mu2 of pointels.
    fn to_measures(&self, one: f64) -> Summed {
        Summed {
            mu0: fixed::to_measure(self.mu0) / one,
            tensor: Symmetric::from_terms(self.tensor.map(|t| fixed::to_measure(t) / one)),
            mu2: fixed::to_solid_angle(self.mu2),
            omega: fixed::to_measure(self.omega) / one,
        }
    }
}

impl BallScratch {
    fn begin(&mut self, cells: &LocalCells) {
        if self.linel_seen.len() != cells.linels.len()
            || self.umbrella_seen.len() != cells.umbrellas.len()
            || self.epoch == u32::MAX
        {
            self.linel_seen = vec![0; cells.linels.len()];
            self.umbrella_seen = vec![(0, 0); cells.umbrellas.len()];
            self.epoch = 0;
        }
        self.epoch += 1;
    }
}

/// Rows of cells whose surfels of each kind are in the ball around a surfel along `axis`.
fn ball_rows(ball: &Ball, axis: usize) -> Vec<BallRow> {
    let odd = |kind: usize, a: usize| i32::from(kind != a);
    let reach = ball.reach();
    let mut rows = Vec::new();
    for dz in -reach[2]..=reach[2] {
        for dy in -reach[1]..=reach[1] {
            for kind in [Kind::Z, Kind::Y, Kind::X] {
                let k = |a: usize, d: i32| 2 * d + odd(kind.axis(), a) - odd(axis, a);
                let used = ball.metric.squared([0, k(1, dy), k(2, dz)]);
                let Some(w) = ball.half_width(0, used) else {
                    continue;
                };
                // cells with -w <= 2 dx + shift <= w
                let shift = k(0, 0);
                let x_from = (-w - shift + 1).div_euclid(2);
                let x_to = (w - shift).div_euclid(2) + 1;
                if x_from < x_to {
                    rows.push(BallRow {
                        kind,
                        dy,
                        dz,
                        x_from,
                        x_to,
                    });
                }
            }
        }
    }
    rows
}
