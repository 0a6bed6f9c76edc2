//! What the sums of a group with each weight make together, for many surfels at once.
//!
//! Comes in: [`GroupBlock`], sums of measures by weight around up to [`TOGETHER`] surfels. Goes out: [`SumsBlock`], what
//! [`BallSums`] is of one surfel, number by number. The loops over surfels become loops over vectors of them,
//! which changes no bit: neither the level of the machine nor the company of a surfel shows.

use crate::simd::{Level, Work};
use crate::surfel::Rim;
use crate::symmetric::Symmetric;

use super::ball::{
    BallSums, Compensation, EATEN_AREA, Evidence, NOISY_SHARE, ROBUST_WIDENING, rise,
};
use super::fixed;
use super::grouped::GroupBlock;

/// Surfels that are evaluated together: what loops pass to each other stays in the nearest cache.
pub(crate) const TOGETHER: usize = 32;

/// A number of each surfel.
pub(crate) type Each<T> = [T; TOGETHER];

/// Sums around up to [`TOGETHER`] surfels, in voxel units. What follows the first `count` means nothing.
#[derive(Clone, Debug)]
pub(crate) struct SumsBlock {
    pub(crate) count: usize,
    /// Which of the surfels asked for it is.
    pub(crate) number: Each<u32>,
    /// Corrected areas.
    pub(crate) mu0: Each<f64>,
    /// Terms of the tensors xx yy zz xy xz yz.
    pub(crate) tensor: [Each<f64>; 6],
    pub(crate) mu2: Each<f64>,
    pub(crate) omega: Each<f64>,
    pub(crate) rim: Each<Rim>,
    pub(crate) several_sheets: Each<bool>,
    pub(crate) cut: Each<bool>,
    /// Which compensated weights; with others, what follows is 0.
    pub(crate) compensation: Option<Compensation>,
    /// As in [`Evidence`].
    pub(crate) difference: Each<f64>,
    pub(crate) mean_difference: Each<f64>,
    pub(crate) ridges: Each<f64>,
}

impl SumsBlock {
    /// Nothing.
    pub(crate) fn new() -> Self {
        Self {
            count: 0,
            number: [0; TOGETHER],
            mu0: [0.0; TOGETHER],
            tensor: [[0.0; TOGETHER]; 6],
            mu2: [0.0; TOGETHER],
            omega: [0.0; TOGETHER],
            rim: [Rim::CLOSED; TOGETHER],
            several_sheets: [false; TOGETHER],
            cut: [false; TOGETHER],
            compensation: None,
            difference: [0.0; TOGETHER],
            mean_difference: [0.0; TOGETHER],
            ridges: [0.0; TOGETHER],
        }
    }

    /// Adds the sums around one surfel, without evidence. There must be room.
    pub(super) fn push(&mut self, number: usize, sums: &BallSums) {
        let at = self.count;
        self.count += 1;
        self.number[at] = number as u32;
        self.mu0[at] = sums.mu0;
        for (to, term) in self.tensor.iter_mut().zip(sums.tensor.terms()) {
            to[at] = term;
        }
        self.mu2[at] = sums.mu2;
        self.omega[at] = sums.omega;
        self.rim[at] = sums.rim;
        self.several_sheets[at] = sums.several_sheets;
        self.cut[at] = sums.cut;
    }

    /// The sums around one surfel.
    pub(crate) fn sums(&self, at: usize) -> BallSums {
        BallSums {
            mu0: self.mu0[at],
            tensor: self.tensor(at),
            mu2: self.mu2[at],
            omega: self.omega[at],
            rim: self.rim[at],
            several_sheets: self.several_sheets[at],
            cut: self.cut[at],
            evidence: self.compensation.map(|compensation| Evidence {
                compensation,
                difference: self.difference[at],
                mean_difference: self.mean_difference[at],
                ridges: self.ridges[at],
            }),
        }
    }

    /// The tensor around one surfel.
    #[inline(always)]
    pub(crate) fn tensor(&self, at: usize) -> Symmetric {
        let t = &self.tensor;
        Symmetric {
            xx: t[0][at],
            yy: t[1][at],
            zz: t[2][at],
            xy: t[3][at],
            xz: t[4][at],
            yz: t[5][at],
        }
    }
}

/// Makes `to` the sums that weights make of those of a group.
pub(super) struct Mixture<'a> {
    /// `None` takes the first weight.
    pub(super) of: Option<Compensation>,
    /// In voxel units.
    pub(super) radius: f64,
    /// What one in the sums is, of one in the measures; a power of two.
    pub(super) unit: f64,
    pub(super) sums: &'a GroupBlock,
    pub(super) to: &'a mut SumsBlock,
}

impl Work for Mixture<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Level>(self) {
        let Self { sums, to, .. } = self;
        to.count = sums.count;
        to.number = sums.number;
        to.rim = sums.rim;
        to.several_sheets = sums.several_sheets;
        to.cut = sums.near_cut;
        to.compensation = self.of;
        // powers of two, so this is exact
        let per_unit = 1.0 / (self.unit * fixed::ONE);
        let angle_per_unit = fixed::LUMPED_SOLID_ANGLE / self.unit;
        match self.of {
            None => first(sums, per_unit, angle_per_unit, to),
            Some(of) => {
                let mut parts = [[0.0; TOGETHER]; 2];
                weigh(of, self.radius, sums, to, &mut parts);
                mix(sums, &parts, per_unit, angle_per_unit, to);
            }
        }
    }
}

/// The sums with the first weight.
#[inline(always)]
fn first(sums: &GroupBlock, per_unit: f64, angle_per_unit: f64, to: &mut SumsBlock) {
    let measures = &sums.measures[0];
    for at in 0..TOGETHER {
        to.mu0[at] = measures[0][at] * per_unit;
        to.mu2[at] = measures[7][at] * angle_per_unit;
        to.omega[at] = sums.omega[0][at] * per_unit;
    }
    for t in 0..6 {
        for at in 0..TOGETHER {
            to.tensor[t][at] = measures[t + 1][at] * per_unit;
        }
    }
}

/// The parts of both sums in the mixture, and the evidence.
#[inline(always)]
fn weigh(
    of: Compensation,
    radius: f64,
    sums: &GroupBlock,
    to: &mut SumsBlock,
    parts: &mut [Each<f64>; 2],
) {
    let supports = [of.support() * radius, ROBUST_WIDENING * radius];
    // The weights of a plane: 1/6 and 1/2 of the discs.
    let per_area = [
        6.0 / (supports[0] * supports[0]),
        2.0 / (supports[1] * supports[1]),
    ];
    let contrasts = of.contrast();
    let [a, b] = &sums.measures;
    for at in 0..TOGETHER {
        // How much the two ways differ, in units of what the staircase makes them differ.
        let (per_a, per_b) = (1.0 / a[0][at], 1.0 / b[0][at]);
        let (mut diagonal, mut across, mut trace) = (0.0, 0.0, 0.0);
        for t in 1..4 {
            let d = a[t][at] * per_a - b[t][at] * per_b;
            diagonal += d * d;
            trace += d;
        }
        for t in 4..7 {
            let d = a[t][at] * per_a - b[t][at] * per_b;
            across += d * d;
        }
        let difference = (diagonal + 2.0 * across).sqrt();
        let ridges = sums.ridges[at] / sums.summed[at];
        to.difference[at] = difference;
        to.mean_difference[at] = 0.5 * trace;
        to.ridges[at] = ridges;
        let areas = [a[0][at] * per_area[0], b[0][at] * per_area[1]];
        let noisy = rise(ridges, NOISY_SHARE);
        let left = rise(areas[0] / areas[1], EATEN_AREA);
        let eaten = if areas[1] > 0.0 { 1.0 - left } else { 1.0 };
        let alike = 1.0 - rise(difference * (radius * radius * radius), contrasts);
        let robust = noisy.max(eaten).max(alike);
        // in units of the area of the smaller disc, for sums of the usual size
        parts[0][at] = 1.0 - robust;
        parts[1][at] = robust * (per_area[1] / per_area[0]);
    }
}

/// The mixture of both sums.
#[inline(always)]
fn mix(
    sums: &GroupBlock,
    parts: &[Each<f64>; 2],
    per_unit: f64,
    angle_per_unit: f64,
    to: &mut SumsBlock,
) {
    let [a, b] = &sums.measures;
    for at in 0..TOGETHER {
        let (p, q) = (parts[0][at], parts[1][at]);
        to.mu0[at] = (a[0][at] * p + b[0][at] * q) * per_unit;
        to.mu2[at] = (a[7][at] * p + b[7][at] * q) * angle_per_unit;
        to.omega[at] = (sums.omega[0][at] * p + sums.omega[1][at] * q) * per_unit;
    }
    for t in 0..6 {
        for at in 0..TOGETHER {
            let mixed = a[t + 1][at] * parts[0][at] + b[t + 1][at] * parts[1][at];
            to.tensor[t][at] = mixed * per_unit;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::at_every_level;
    use crate::testing::numbers;

    struct Mixed<'a>(Option<Compensation>, &'a GroupBlock);

    impl Work for Mixed<'_> {
        type Output = SumsBlock;

        #[inline(always)]
        fn run<L: Level>(self) -> SumsBlock {
            let mut to = SumsBlock::new();
            let work = Mixture {
                of: self.0,
                radius: RADIUS,
                unit: 2.0,
                sums: self.1,
                to: &mut to,
            };
            work.run::<L>();
            to
        }
    }

    const RADIUS: f64 = 3.0;

    /// Random sums, of surfaces from smooth to noise, with 0 among them.
    fn blocks() -> Vec<GroupBlock> {
        let mut random = numbers(11);
        let block = |n: usize| {
            let mut sums = GroupBlock::new();
            sums.count = TOGETHER;
            for at in 0..TOGETHER {
                let apart = [0.003, 0.1, 1.0][(n + at) % 3];
                let area = 40.0 * fixed::ONE;
                // what a plane has, nearly
                let shares = [of_plane(0), of_plane(1)];
                let of_both: [f64; 8] = [0; 8].map(|_| 0.1 * random());
                for (k, share) in shares.into_iter().enumerate() {
                    for t in 1..8 {
                        let x = (of_both[t] + 0.1 * apart * random()) * area * share;
                        sums.measures[k][t][at] = x.round();
                    }
                    let x = (1.0 + apart * random()) * area * share;
                    sums.measures[k][0][at] = x.round();
                    sums.omega[k][at] = (random() * area).round();
                }
                sums.summed[at] = 100.0;
                sums.ridges[at] = [0.0, 9.0, 30.0][(n + at / 3) % 3];
                match (n + at) % 16 {
                    3 => sums.measures[0][0][at] = 0.0,
                    7 => sums.measures[1][0][at] = 0.0,
                    11 => sums.measures = [[[0.0; TOGETHER]; 8]; 2],
                    _ => {}
                }
            }
            sums
        };
        (0..60).map(block).collect()
    }

    /// The share of the area that a weight gives to a plane, but for a factor.
    fn of_plane(k: usize) -> f64 {
        let support = [Compensation::Averaged.support(), ROBUST_WIDENING][k];
        support * support / [6.0, 2.0][k]
    }

    /// The definition, for one surfel.
    fn expected(of: Compensation, sums: &GroupBlock, at: usize) -> ([f64; 9], [f64; 3]) {
        let m = [0, 1].map(|k| sums.measures[k].map(|x| x[at]));
        let per_area = [
            6.0 / (of.support() * RADIUS).powi(2),
            2.0 / (ROBUST_WIDENING * RADIUS).powi(2),
        ];
        let area = [m[0][0] * per_area[0], m[1][0] * per_area[1]];
        let eaten = if area[1] > 0.0 {
            1.0 - rise(area[0] / area[1], EATEN_AREA)
        } else {
            1.0
        };
        let apart = [1, 2, 3, 4, 5, 6].map(|t| m[0][t] / m[0][0] - m[1][t] / m[1][0]);
        let [a, b, c, d, e, f] = apart.map(|x| x * x);
        let difference = (a + b + c + 2.0 * (d + e + f)).sqrt();
        let ridges = sums.ridges[at] / sums.summed[at];
        let alike = 1.0 - rise(difference * RADIUS.powi(3), of.contrast());
        let robust = rise(ridges, NOISY_SHARE).max(eaten).max(alike);
        let parts = [1.0 - robust, robust * per_area[1] / per_area[0]];
        let mixed = |x: [f64; 2]| (x[0] * parts[0] + x[1] * parts[1]) / (2.0 * fixed::ONE);
        let mut found = [0.0; 9];
        for t in 0..8 {
            found[t] = mixed([m[0][t], m[1][t]]);
        }
        found[7] *= std::f64::consts::FRAC_PI_2;
        found[8] = mixed([sums.omega[0][at], sums.omega[1][at]]);
        let trace = apart[0] + apart[1] + apart[2];
        (found, [difference, 0.5 * trace, ridges])
    }

    #[test]
    fn mixtures_are_those_of_the_definition_at_every_level() {
        let near = |a: f64, b: f64, size: f64| {
            (a - b).abs() <= 1e-13 * size || a == b || a.is_nan() && b.is_nan()
        };
        let mut partly = 0;
        for sums in blocks() {
            for of in [Compensation::Averaged, Compensation::Refined] {
                let found = at_every_level(|| Mixed(Some(of), &sums));
                for (block, at) in found
                    .iter()
                    .flat_map(|b| (0..TOGETHER).map(move |at| (b, at)))
                {
                    let (x, evidence) = expected(of, &sums, at);
                    let sums_found = block.sums(at);
                    let t = sums_found.tensor.terms();
                    let ours = [
                        sums_found.mu0,
                        t[0],
                        t[1],
                        t[2],
                        t[3],
                        t[4],
                        t[5],
                        sums_found.mu2,
                        sums_found.omega,
                    ];
                    for (a, b) in ours.into_iter().zip(x) {
                        assert!(near(a, b, 100.0), "{ours:?} {x:?}");
                    }
                    let e = sums_found.evidence.expect("they are compensated");
                    let ours = [e.difference, e.mean_difference, e.ridges];
                    for (a, b) in ours.into_iter().zip(evidence) {
                        assert!(near(a, b, 1.0), "{ours:?} {evidence:?}");
                    }
                    let robust = sums.measures[1][0][at] / (2.0 * fixed::ONE);
                    partly += usize::from(!near(sums_found.mu0, robust, 100.0));
                }
                for other in &found[1..] {
                    for at in 0..TOGETHER {
                        let (a, b) = (found[0].sums(at), other.sums(at));
                        assert_eq!(format!("{a:?}"), format!("{b:?}"));
                    }
                }
            }
        }
        assert!(partly > 1000);
    }

    #[test]
    fn without_compensation_the_first_weight_counts() {
        for sums in blocks() {
            for block in at_every_level(|| Mixed(None, &sums)) {
                for at in 0..TOGETHER {
                    let found = block.sums(at);
                    let m = sums.measures[0].map(|x| x[at] / (2.0 * fixed::ONE));
                    assert_eq!(found.mu0, m[0]);
                    assert_eq!(found.tensor.terms(), [m[1], m[2], m[3], m[4], m[5], m[6]]);
                    assert_eq!(found.mu2, m[7] * std::f64::consts::FRAC_PI_2);
                    assert_eq!(found.omega, sums.omega[0][at] / (2.0 * fixed::ONE));
                    assert!(found.evidence.is_none());
                }
            }
        }
    }
}
