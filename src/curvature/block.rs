//! The curvatures of many surfels at once.
//!
//! Comes in: a block of sums over balls, `u` at their centres. Goes out: what [`Curvature`] is of one surfel, number by number,
//! NaN where there is none. The loop over surfels becomes a loop over vectors of them,
//! which changes no bit: neither the level of the machine nor the company of a surfel shows.

use glam::DVec3;

use crate::measure::mixture::{Each, SumsBlock, TOGETHER};
use crate::simd::{Level, Work, dispatch};

use super::Curvature;

/// Curvatures of a block of surfels, in world units. What follows the first `count` of the sums means nothing.
#[derive(Clone, Debug)]
pub(crate) struct CurvatureBlock {
    /// `u` at the surfels, by coordinate; to be set.
    pub(crate) u: [Each<f64>; 3],
    pub(crate) mean: Each<f64>,
    pub(crate) gaussian: Each<f64>,
    pub(crate) k1: Each<f64>,
    pub(crate) k2: Each<f64>,
    /// As they were unless they are asked for.
    pub(crate) d1: [Each<f64>; 3],
    pub(crate) d2: [Each<f64>; 3],
    pub(crate) quality: Each<f64>,
    /// Whether mu0 is not positive, so that all is NaN.
    pub(crate) no_area: Each<bool>,
    /// Whether the principal curvatures are small against the penalty.
    holds: Each<bool>,
}

impl CurvatureBlock {
    /// Nothing.
    pub(crate) fn new() -> Self {
        Self {
            u: [[0.0; TOGETHER]; 3],
            mean: [0.0; TOGETHER],
            gaussian: [0.0; TOGETHER],
            k1: [0.0; TOGETHER],
            k2: [0.0; TOGETHER],
            d1: [[0.0; TOGETHER]; 3],
            d2: [[0.0; TOGETHER]; 3],
            quality: [0.0; TOGETHER],
            no_area: [false; TOGETHER],
            holds: [false; TOGETHER],
        }
    }

    /// Evaluates the curvatures of sums around surfels of normals `u`.
    pub(crate) fn evaluate(&mut self, sums: &SumsBlock, unit_world: f64, directions: bool) {
        dispatch(Evaluate {
            sums,
            unit_world,
            directions,
            to: self,
        });
        for at in 0..sums.count {
            if !self.holds[at] && !self.no_area[at] {
                self.replace_principal(sums, unit_world, at);
            }
        }
    }

    #[inline(always)]
    fn u(&self, at: usize) -> DVec3 {
        DVec3::new(self.u[0][at], self.u[1][at], self.u[2][at])
    }

    #[cold]
    fn replace_principal(&mut self, sums: &SumsBlock, unit_world: f64, at: usize) {
        let (mu0, tensor) = (sums.mu0[at], sums.tensor(at));
        let d;
        ([self.k1[at], self.k2[at]], d) =
            super::principal_by_jacobi(mu0, &tensor, self.u(at), unit_world);
        for (to, d) in [&mut self.d1, &mut self.d2].into_iter().zip(d) {
            for (to, x) in to.iter_mut().zip(d.to_array()) {
                to[at] = x;
            }
        }
    }
}

/// Evaluates all but what is not small against the penalty.
struct Evaluate<'a> {
    sums: &'a SumsBlock,
    unit_world: f64,
    directions: bool,
    to: &'a mut CurvatureBlock,
}

impl Work for Evaluate<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Level>(self) {
        if self.directions {
            evaluate::<true>(self.sums, self.unit_world, self.to);
        } else {
            evaluate::<false>(self.sums, self.unit_world, self.to);
        }
    }
}

#[inline(always)]
fn evaluate<const DIRECTIONS: bool>(sums: &SumsBlock, unit_world: f64, to: &mut CurvatureBlock) {
    for at in 0..TOGETHER {
        let (mu0, mu2, omega) = (sums.mu0[at], sums.mu2[at], sums.omega[at]);
        let tensor = sums.tensor(at);
        let (found, holds) = Curvature::by_penalty(mu0, &tensor, mu2, omega, to.u(at), unit_world);
        let no_area = mu0 <= 0.0;
        to.mean[at] = if no_area { f64::NAN } else { found.mean };
        to.gaussian[at] = if no_area { f64::NAN } else { found.gaussian };
        to.k1[at] = if no_area { f64::NAN } else { found.k1 };
        to.k2[at] = if no_area { f64::NAN } else { found.k2 };
        to.quality[at] = if no_area { f64::NAN } else { found.quality };
        if DIRECTIONS {
            to.d1[0][at] = if no_area { f64::NAN } else { found.d1.x };
            to.d1[1][at] = if no_area { f64::NAN } else { found.d1.y };
            to.d1[2][at] = if no_area { f64::NAN } else { found.d1.z };
            to.d2[0][at] = if no_area { f64::NAN } else { found.d2.x };
            to.d2[1][at] = if no_area { f64::NAN } else { found.d2.y };
            to.d2[2][at] = if no_area { f64::NAN } else { found.d2.z };
        }
        to.no_area[at] = no_area;
        to.holds[at] = holds;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::at_every_level;
    use crate::symmetric::{Symmetric, eigen};

    struct Evaluated<'a>(&'a SumsBlock, &'a [Each<f64>; 3]);

    impl Work for Evaluated<'_> {
        type Output = CurvatureBlock;

        #[inline(always)]
        fn run<L: Level>(self) -> CurvatureBlock {
            let mut to = CurvatureBlock::new();
            to.u = *self.1;
            let (sums, unit_world) = (self.0, 0.5);
            let work = Evaluate {
                sums,
                unit_world,
                directions: true,
                to: &mut to,
            };
            work.run::<L>();
            to
        }
    }

    /// Random sums, with what is no number, infinite, zero, and large beside the penalty among them.
    fn blocks() -> Vec<(SumsBlock, [Each<f64>; 3])> {
        let mut random = crate::testing::numbers(7);
        let special = [
            0.0,
            -0.0,
            -1.0,
            f64::NAN,
            f64::INFINITY,
            f64::MIN_POSITIVE,
            1e300,
        ];
        let block = |n: usize| {
            let mut sums = SumsBlock::new();
            sums.count = TOGETHER;
            let mut u = [[0.0; TOGETHER]; 3];
            for at in 0..TOGETHER {
                let size = [1.0, 1e-6, 1e3][(n + at) % 3];
                sums.mu0[at] = 3.0 + random();
                sums.mu2[at] = random();
                sums.omega[at] = random();
                for term in &mut sums.tensor {
                    term[at] = size * random();
                }
                let of_surfel = DVec3::new(random(), random(), random()).normalize();
                for (to, x) in u.iter_mut().zip(of_surfel.to_array()) {
                    to[at] = x;
                }
                if n % 2 == 1 && at % 4 == 0 {
                    let x = special[(n + at / 4) % special.len()];
                    match (n / 2) % 3 {
                        0 => sums.mu0[at] = x,
                        1 => sums.tensor[at % 6][at] = x,
                        _ => sums.mu2[at] = x,
                    }
                }
            }
            (sums, u)
        };
        (0..60).map(block).collect()
    }

    fn numbers(of: &CurvatureBlock, at: usize) -> [f64; 11] {
        let [d1, d2] = [&of.d1, &of.d2].map(|d| d.map(|x| x[at]));
        [
            of.mean[at],
            of.gaussian[at],
            of.k1[at],
            of.k2[at],
            of.quality[at],
            d1[0],
            d1[1],
            d1[2],
            d2[0],
            d2[1],
            d2[2],
        ]
    }

    fn same(a: f64, b: f64) -> bool {
        a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan()
    }

    #[test]
    fn a_level_does_not_show() {
        for (sums, u) in blocks() {
            let found = at_every_level(|| Evaluated(&sums, &u));
            for other in &found[1..] {
                for at in 0..TOGETHER {
                    let (a, b) = (numbers(&found[0], at), numbers(other, at));
                    assert!(a.into_iter().zip(b).all(|(a, b)| same(a, b)), "{a:?} {b:?}");
                }
                assert_eq!(found[0].holds, other.holds);
                assert_eq!(found[0].no_area, other.no_area);
            }
        }
    }

    #[test]
    fn the_company_of_a_surfel_does_not_show() {
        let (mut replaced, mut without_area) = (0, 0);
        for (sums, u) in blocks() {
            let mut block = CurvatureBlock::new();
            block.u = u;
            block.evaluate(&sums, 0.5, true);
            for at in 0..TOGETHER {
                let u = block.u(at);
                let alone = Curvature::from_sums(&sums.sums(at), u, 0.5);
                let alone = alone.map_or([f64::NAN; 11], |c| {
                    let [d1, d2] = [c.d1, c.d2];
                    [
                        c.mean, c.gaussian, c.k1, c.k2, c.quality, d1.x, d1.y, d1.z, d2.x, d2.y,
                        d2.z,
                    ]
                });
                let found = numbers(&block, at);
                let equal = found.into_iter().zip(alone).all(|(a, b)| same(a, b));
                assert!(equal, "{found:?} {alone:?}");
                replaced += usize::from(!block.holds[at] && !block.no_area[at]);
                without_area += usize::from(block.no_area[at]);
            }
        }
        assert!(replaced > 500 && without_area > 20);
    }

    #[test]
    fn principal_curvatures_are_those_of_jacobi() {
        for (sums, u) in blocks().into_iter().step_by(2) {
            let mut block = CurvatureBlock::new();
            block.u = u;
            block.evaluate(&sums, 1.0, false);
            for at in 0..TOGETHER {
                let shape = sums.tensor(at).scaled(1.0 / sums.mu0[at]);
                let u = block.u(at);
                let penalised = shape.zip(&Symmetric::outer(u, u), |m, uu| m - 1e3 * uu);
                let k = eigen(&penalised).values;
                let size = shape.terms().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
                // large curvatures may be below the penalty
                if size < 1.0 {
                    assert!((block.k1[at] - k[1]).abs() < 2e-12);
                    assert!((block.k2[at] - k[2]).abs() < 2e-12);
                }
                assert!(block.k1[at] <= block.k2[at]);
            }
        }
    }
}
