//! Error bars: how far H and G may be from the truth.
//!
//! Comes in: what the compensated sums of a ball tell beside their values ([`Evidence`]), the curvatures, the radii. Goes out:
//! an error of H and one of G.
//!
//! **What is promised.** Of many surfels 68 in 100 have an error below one bar and 95 in 100 below two. It is a
//! statement about surfaces like those it was calibrated on (below), all surfels taken together: on one shape the bars can be too
//! long throughout (spheres, wide tori) and on another too short (flat discs with a sharp rim), as an error that is the same all over a shape cannot be
//! seen from inside. Where features are smaller than the ball and the estimate is flattened altogether, no bar is long enough: flag
//! `radius_too_large` is for these.
//!
//! **How.** The two sums that compensated weights make, one with and one without negative weights, differ by what the
//! staircase and the noise do to either, and by what the second flattens. The staircase and noise decide H to c / rho^3, so
//! everything is measured in that unit: with epsilon = error of H times rho^3 and the contrast c = |difference of the tensors| rho^3,
//!
//! log epsilon = a + b log c + b' max(log(c/5), 0) + r s + r' s^2 + d log max(e, c/10) + k max(log(kappa rho / 0.25), 0)
//! + t log(min(max(|c - c0|, c/10) / c, 50)),
//!
//! s the share of ridges ([`crate::measure::ball`]), e the same as c of the difference of H alone, kappa the larger principal
//! curvature by size. c0 is the contrast of a surface of constant curvatures: as u tilts within the ball the tensor loses in the
//! tangent plane and gains along the normal by the second moments of u, about k^3 in each direction, which is none of H's bias.
//! (*Measured* on a sphere of 2 and 3 radii of the ball and a torus whose tube has 0.7 and 1.3, c is c0 to 7 %.)
//! Where normals are of a radius r below that of the sums, rho^3 becomes (rho r)^1.5: an error of u at distance r is
//! averaged along the rim of the ball.
//!
//! The error of G follows from that of a principal curvature: (k1^2 + k2^2)^(1/2) sigma and sigma^2.
//!
//! **Calibrated** on a sphere, tori, ellipsoids (flat, long, round), Goursat's surface and a rounded cube, along the grid and in general
//! positions, h = 1, 1/2 and 1/4, noise p = 0 to 0.5 of the paper's section 6.1.6, radii of 2 to 18 voxels,
//! by the least sum of the quantile losses at 68 % for one bar and 95 % for two, each case with the same weight; then lengthened by 14 % (default)
//! and 2 % (refined) for the cases of docs/accuracy, at radii that are usual for them.
//! What was tried beside: the spread over three widths (1 % less loss, a fifth more time), the roughness as the area of the
//! surfels over that of u (no gain over the ridges), the direction of u (none). Without the hinge at c = 5 the loss is 7 %, without c0 3 % larger.
//!
//! **To choose a radius** the bare difference of the two sums is the better guide ([`ErrorKind::Differences`]): its median over a surface
//! falls with the radius while the grid and noise decide, and rises once the ball flattens. Bars have c in them, and so take
//! spheres and tori for flattened long before H is.

use crate::elementary::{exp, log};
use crate::measure::ball::{Compensation, Evidence, NOISY_SHARE, rise};
use crate::measure::mixture::{Each, SumsBlock, TOGETHER};
use crate::simd::{Level, Work, dispatch};

use super::block::CurvatureBlock;

/// What the error columns hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ErrorKind {
    /// Error bars.
    #[default]
    Bars,
    /// The size of the difference of H between the two sums, in the column of H; NaN in that of G.
    Differences,
}

/// Coefficients of the logarithm of the error: 1, log c, log c / 5, s, s^2, log e, log of kappa rho / 0.25, log of what is left of c without c0.
type Model = [f64; 8];

const AVERAGED: Model = [0.02, 0.48, 1.04, 1.41, -2.57, 0.34, 0.49, 0.30];
const REFINED: Model = [-0.92, 0.32, -0.32, 3.90, -4.77, 0.31, 0.54, 0.19];

/// What is added where refined normals give way to noise.
const REFINED_NOISE: f64 = -0.13;

/// c0 over the norm of the cubes of the principal curvatures times rho^5.
const TILT: f64 = 0.229;

/// Contrasts that are told apart: below and above the fit has seen next to nothing.
const CONTRASTS: [f64; 2] = [0.05, 50.0];

/// Share of ridges above which the fit has seen next to nothing.
const MOST_RIDGES: f64 = 0.6;

/// Error of G over (k1^2 + k2^2)^(1/2) sigma, and over sigma^2.
const GAUSSIAN: [f64; 2] = [1.1, 2.5];

/// One bar of H and of G, in world units, for principal curvatures k1 and k2 in world units.
///
/// `radius` is that of the sums and `normal_radius` that of the normals as a radius of sums (what
/// [`crate::normal::refine::FIRST_RADIUS`] multiplies), in voxel units; `unit_world` is the length of a voxel unit.
///
/// There are no branches and no calls, so that a loop over many surfels becomes a loop over vectors of them.
#[inline(always)]
#[must_use]
pub fn error_bars(
    evidence: &Evidence,
    [k1, k2]: [f64; 2],
    radius: f64,
    normal_radius: f64,
    unit_world: f64,
) -> [f64; 2] {
    let area = radius * normal_radius.min(radius);
    let scale = area * area.sqrt();
    // Refined normals are those of the default where the surface is noise. Their weights reach less far,
    // so noise makes the two sums differ more.
    let (refined, of_noise) = match evidence.compensation {
        Compensation::Averaged => (0.0, 0.0),
        Compensation::Refined => {
            let noise = rise(evidence.ridges, NOISY_SHARE);
            (1.0 - noise, REFINED_NOISE * noise)
        }
    };
    let [least, most] = CONTRASTS;
    // not clamp, of what is no number it is the most
    let contrast = evidence.difference * scale;
    let at_least = contrast.max(least);
    let contrast = if contrast < most { at_least } else { most };
    let mean = (evidence.mean_difference.abs() * scale).min(contrast);
    let (l1, l2) = (k1 * unit_world, k2 * unit_world);
    let (c1, c2) = (l1 * l1 * l1, l2 * l2 * l2);
    let tilt = TILT * (c1 * c1 + c2 * c2 + (c1 + c2) * (c1 + c2)).sqrt() * scale * radius * radius;
    let left = (contrast - tilt).abs().max(0.1 * contrast) / contrast;
    let ridges = evidence.ridges.min(MOST_RIDGES);
    // 0 up to 1, as for most surfels
    let (much, bent) = (0.2 * contrast, l1.abs().max(l2.abs()) * radius / 0.25);
    let (log_much, log_bent) = (log(much), log(bent));
    let terms = [
        1.0,
        log(contrast),
        if much > 1.0 { log_much } else { 0.0 },
        ridges,
        ridges * ridges,
        log(mean.max(0.1 * contrast)),
        if bent > 1.0 { log_bent } else { 0.0 },
        log(left.min(most)),
    ];
    let mut logarithm = of_noise;
    for i in 0..terms.len() {
        let coefficient = AVERAGED[i] * (1.0 - refined) + REFINED[i] * refined;
        logarithm += terms[i] * coefficient;
    }
    let of_mean = exp(logarithm) / (scale * unit_world);
    let of_gaussian = of_mean * (GAUSSIAN[0] * (k1 * k1 + k2 * k2).sqrt() + GAUSSIAN[1] * of_mean);
    [of_mean, of_gaussian]
}

/// What the bars of a block of surfels go by.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bars {
    /// In voxel units.
    pub(crate) radius: f64,
    /// That of the normals as a radius of sums, in voxel units.
    pub(crate) normal_radius: f64,
    /// Length of a voxel unit.
    pub(crate) unit_world: f64,
}

impl Bars {
    /// Bars of H and of G of each surfel.
    pub(crate) fn of(
        &self,
        compensation: Compensation,
        sums: &SumsBlock,
        curvatures: &CurvatureBlock,
        to: &mut [Each<f64>; 2],
    ) {
        dispatch(BarsOf {
            bars: self,
            compensation,
            sums,
            curvatures,
            to,
        });
    }
}

struct BarsOf<'a> {
    bars: &'a Bars,
    compensation: Compensation,
    sums: &'a SumsBlock,
    curvatures: &'a CurvatureBlock,
    to: &'a mut [Each<f64>; 2],
}

impl Work for BarsOf<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Level>(self) {
        let Self {
            bars,
            compensation,
            sums,
            curvatures,
            to,
        } = self;
        // apart, so that nothing is chosen within the loop
        match compensation {
            Compensation::Averaged => evaluate(bars, Compensation::Averaged, sums, curvatures, to),
            Compensation::Refined => evaluate(bars, Compensation::Refined, sums, curvatures, to),
        }
    }
}

#[inline(always)]
fn evaluate(
    bars: &Bars,
    compensation: Compensation,
    sums: &SumsBlock,
    curvatures: &CurvatureBlock,
    to: &mut [Each<f64>; 2],
) {
    let Bars {
        radius,
        normal_radius,
        unit_world,
    } = *bars;
    for at in 0..TOGETHER {
        let evidence = Evidence {
            compensation,
            difference: sums.difference[at],
            mean_difference: sums.mean_difference[at],
            ridges: sums.ridges[at],
        };
        let principal = [curvatures.k1[at], curvatures.k2[at]];
        let found = error_bars(&evidence, principal, radius, normal_radius, unit_world);
        to[0][at] = found[0];
        to[1][at] = found[1];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::at_every_level;
    use crate::testing::numbers;

    fn evidence(difference: f64, ridges: f64) -> Evidence {
        Evidence {
            compensation: Compensation::Averaged,
            difference,
            mean_difference: 0.4 * difference,
            ridges,
        }
    }

    #[test]
    fn bars_grow_with_what_they_are_made_of() {
        let round = [0.05, 0.05];
        let of =
            |difference, ridges| error_bars(&evidence(difference, ridges), round, 5.0, 5.0, 1.0);
        for i in 0..2 {
            assert!(of(0.002, 0.0)[i] < of(0.004, 0.0)[i]);
            assert!(of(0.004, 0.0)[i] < of(0.1, 0.0)[i]);
            assert!(of(0.004, 0.0)[i] < of(0.004, 0.2)[i]);
            assert!(of(0.004, 1.0)[i] > 0.8 * of(0.004, 0.0)[i]);
        }
        let sharp = error_bars(&evidence(0.004, 0.0), [0.0, 0.3], 5.0, 5.0, 1.0);
        assert!(sharp[0] > of(0.004, 0.0)[0]);
        let of_coarse_normals = error_bars(&evidence(0.004, 0.0), round, 5.0, 2.0, 1.0);
        assert!(of_coarse_normals[0] > of(0.004, 0.0)[0]);
    }

    #[test]
    fn bars_are_lengths_to_the_minus_one_and_two() {
        let in_voxels = error_bars(&evidence(0.01, 0.0), [0.1, 0.2], 4.0, 4.0, 1.0);
        let of_half = [0.2, 0.4];
        let in_halves = error_bars(&evidence(0.01, 0.0), of_half, 4.0, 4.0, 0.5);
        assert!((in_halves[0] - 2.0 * in_voxels[0]).abs() < 1e-12);
        assert!((in_halves[1] - 4.0 * in_voxels[1]).abs() < 1e-12);
    }

    #[test]
    fn bars_of_nonsense_are_long_and_finite() {
        let nothing = evidence(f64::NAN, 1.0);
        let bars = error_bars(&nothing, [1.0, 1.0], 3.0, 3.0, 1.0);
        assert!(bars.iter().all(|b| b.is_finite() && *b > 0.05));
        let exact = error_bars(&evidence(0.0, 0.0), [0.0, 0.0], 3.0, 3.0, 1.0);
        assert!(exact.iter().all(|&b| b > 0.0));
    }

    struct Evaluated<'a>(&'a SumsBlock, &'a CurvatureBlock, Compensation);

    impl Work for Evaluated<'_> {
        type Output = [Each<f64>; 2];

        #[inline(always)]
        fn run<L: Level>(self) -> [Each<f64>; 2] {
            let mut to = [[0.0; TOGETHER]; 2];
            let bars = Bars {
                radius: 3.0,
                normal_radius: 2.5,
                unit_world: 0.5,
            };
            let work = BarsOf {
                bars: &bars,
                compensation: self.2,
                sums: self.0,
                curvatures: self.1,
                to: &mut to,
            };
            work.run::<L>();
            to
        }
    }

    /// The formula of the page, by libm.
    fn by_libm(evidence: &Evidence, k: [f64; 2]) -> [f64; 2] {
        let (radius, unit) = (3.0f64, 0.5);
        let scale = (radius * 2.5).powf(1.5);
        let noise = rise(evidence.ridges, NOISY_SHARE);
        let (refined, of_noise) = match evidence.compensation {
            Compensation::Averaged => (0.0, 0.0),
            Compensation::Refined => (1.0 - noise, REFINED_NOISE * noise),
        };
        let c = (evidence.difference * scale).clamp(0.05, 50.0);
        let c = if c.is_nan() { 50.0 } else { c };
        let e = (evidence.mean_difference.abs() * scale).min(c).max(0.1 * c);
        let cubes = k.map(|k| (k * unit).powi(3));
        let sum = cubes[0] + cubes[1];
        let size = (cubes[0].powi(2) + cubes[1].powi(2) + sum.powi(2)).sqrt();
        let left = (c - TILT * size * scale * radius * radius).abs();
        let s = evidence.ridges.min(MOST_RIDGES);
        let kappa = k[0].abs().max(k[1].abs()) * unit;
        let terms = [
            1.0,
            libm::log(c),
            libm::log(c / 5.0).max(0.0),
            s,
            s * s,
            libm::log(e),
            libm::log(kappa * radius / 0.25).max(0.0),
            libm::log((left.max(0.1 * c) / c).min(50.0)),
        ];
        let model = |i: usize| AVERAGED[i] * (1.0 - refined) + REFINED[i] * refined;
        let logarithm: f64 = (0..8).map(|i| terms[i] * model(i)).sum();
        let of_mean = libm::exp(logarithm + of_noise) / (scale * unit);
        let of_gaussian = GAUSSIAN[0] * (k[0] * k[0] + k[1] * k[1]).sqrt() + GAUSSIAN[1] * of_mean;
        [of_mean, of_mean * of_gaussian]
    }

    #[test]
    fn bars_of_blocks_are_those_of_the_formula_at_every_level() {
        let mut number = numbers(13);
        let mut random = move || 0.5 * (number() + 1.0);
        let special = [0.0, f64::NAN, f64::INFINITY, 1e-300, 1e300, -3.0];
        for n in 0..200 {
            let mut sums = SumsBlock::new();
            let mut curvatures = CurvatureBlock::new();
            for at in 0..TOGETHER {
                let size = [0.01, 1.0, 30.0][at % 3];
                sums.difference[at] = size * random();
                sums.mean_difference[at] = sums.difference[at] * (random() - 0.5);
                sums.ridges[at] = 0.2 * random();
                curvatures.k1[at] = 0.3 - 2.0 * size * random();
                curvatures.k2[at] = curvatures.k1[at] + random();
                let x = special[n % special.len()];
                match at {
                    3 => sums.difference[at] = x,
                    7 => sums.mean_difference[at] = x,
                    11 => curvatures.k1[at] = x,
                    15 => (curvatures.k1[at], curvatures.k2[at]) = (x, x),
                    _ => {}
                }
            }
            for compensation in [Compensation::Averaged, Compensation::Refined] {
                let found = at_every_level(|| Evaluated(&sums, &curvatures, compensation));
                for (bars, at) in found
                    .iter()
                    .flat_map(|f| (0..TOGETHER).map(move |at| (f, at)))
                {
                    let evidence = Evidence {
                        compensation,
                        difference: sums.difference[at],
                        mean_difference: sums.mean_difference[at],
                        ridges: sums.ridges[at],
                    };
                    let expected = by_libm(&evidence, [curvatures.k1[at], curvatures.k2[at]]);
                    for i in 0..2 {
                        let (a, b, first) = (bars[i][at], expected[i], found[0][i][at]);
                        let is_near = (a / b - 1.0).abs() < 1e-12 || a == b;
                        assert!(
                            is_near || a.is_nan() && b.is_nan(),
                            "{a:e} {b:e} {evidence:?}"
                        );
                        assert!(a.to_bits() == first.to_bits() || a.is_nan() && first.is_nan());
                    }
                }
            }
        }
    }
}
