//! Squared distances of many pairs at once, exact: in single precision for cubes, whose distances are small
//! integers, else in double precision.

use crate::lattice::Ball;
use crate::simd::{Level, dot};

/// Squared distances in the unit of a ball's limit.
pub(crate) trait Squares: Copy {
    /// Those of a vector of displacements.
    type Of<L: Level>: Copy;

    /// Of displacements in Khalimsky coordinates.
    fn of<L: Level>(self, d: [L::F; 3]) -> Self::Of<L>;

    /// Where they are at most a limit.
    fn at_most<L: Level>(squares: Self::Of<L>, limit: f64) -> L::M;

    /// Times a factor, rounded.
    fn scaled<L: Level>(squares: Self::Of<L>, factor: f64) -> L::F;

    /// Adds those chosen, which must be at most a ball's limit, to two sums, of which one is used.
    fn sum<L: Level>(squares: Self::Of<L>, chosen: L::M, sums: (L::U, u64)) -> (L::U, u64);
}

/// Voxels are cubes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cubes;

impl Squares for Cubes {
    type Of<L: Level> = L::F;

    #[inline(always)]
    fn of<L: Level>(self, d: [L::F; 3]) -> L::F {
        dot::<L>(d, d)
    }

    #[inline(always)]
    fn at_most<L: Level>(squares: L::F, limit: f64) -> L::M {
        // an integer below 2^14
        L::at_most(squares, L::all(limit as f32))
    }

    #[inline(always)]
    fn scaled<L: Level>(squares: L::F, factor: f64) -> L::F {
        L::mul(squares, L::all(factor as f32))
    }

    #[inline(always)]
    fn sum<L: Level>(squares: L::F, chosen: L::M, sums: (L::U, u64)) -> (L::U, u64) {
        // at most 4 * 63^2 < 2^14 each, and no lane sees 2^18 of them
        (L::add_chosen(sums.0, squares, chosen), sums.1)
    }
}

/// Voxels are boxes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Boxes([f64; 3]);

impl Boxes {
    pub(crate) fn of_ball(ball: &Ball) -> Self {
        Self(ball.metric.weights.map(|w| w as f64))
    }
}

impl Squares for Boxes {
    type Of<L: Level> = L::D;

    #[inline(always)]
    fn of<L: Level>(self, d: [L::F; 3]) -> L::D {
        L::weighted_square(&self.0, d)
    }

    #[inline(always)]
    fn at_most<L: Level>(squares: L::D, limit: f64) -> L::M {
        L::at_most_double(squares, limit)
    }

    #[inline(always)]
    fn scaled<L: Level>(squares: L::D, factor: f64) -> L::F {
        L::scaled(squares, factor)
    }

    #[inline(always)]
    fn sum<L: Level>(squares: L::D, chosen: L::M, sums: (L::U, u64)) -> (L::U, u64) {
        // at most 2^34 each
        (sums.0, sums.1 + L::sum_chosen(squares, chosen) as u64)
    }
}
