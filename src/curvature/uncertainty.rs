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
//! + t log(max(|c - c0|, c/10) / c),
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

use crate::measure::ball::{Compensation, Evidence, NOISY_SHARE, rise};

use super::Curvature;

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

/// One bar of H and of G, in the world units of `curvature`.
///
/// `radius` is that of the sums and `normal_radius` that of the normals as a radius of sums (what
/// [`crate::normal::refine::FIRST_RADIUS`] multiplies), in voxel units; `unit_world` is the length of a voxel unit.
#[must_use]
pub fn error_bars(
    evidence: &Evidence,
    curvature: &Curvature,
    radius: f64,
    normal_radius: f64,
    unit_world: f64,
) -> [f64; 2] {
    let area = radius * normal_radius.min(radius);
    let scale = area * area.sqrt();
    // Refined normals are those of the default where the surface is noise.
    let refined = match evidence.compensation {
        Compensation::Averaged => 0.0,
        Compensation::Refined => 1.0 - rise(evidence.ridges, NOISY_SHARE),
    };
    let model = AVERAGED.into_iter().zip(REFINED);
    let model = model.map(|(a, b)| a * (1.0 - refined) + b * refined);
    let [least, most] = CONTRASTS;
    // not clamp, of what is no number it is the most
    let within = |x: f64| if x < most { x.max(least) } else { most };
    let contrast = within(evidence.difference * scale);
    let mean = (evidence.mean_difference.abs() * scale).min(contrast);
    let [k1, k2] = [curvature.k1, curvature.k2].map(|k| k * unit_world);
    let [c1, c2] = [k1, k2].map(|k| k * k * k);
    let tilt = TILT * (c1 * c1 + c2 * c2 + (c1 + c2) * (c1 + c2)).sqrt() * scale * radius * radius;
    let left = (contrast - tilt).abs().max(0.1 * contrast) / contrast;
    let ridges = evidence.ridges.min(MOST_RIDGES);
    // 0 up to 1, as for most surfels
    let above_one = |x: f64| if x > 1.0 { libm::log(x) } else { 0.0 };
    let terms = [
        1.0,
        libm::log(contrast),
        above_one(0.2 * contrast),
        ridges,
        ridges * ridges,
        libm::log(mean.max(0.1 * contrast)),
        above_one(k1.abs().max(k2.abs()) * radius / 0.25),
        libm::log(left.min(most)),
    ];
    // Their weights reach less far, so noise makes the two sums differ more.
    let of_noise = match evidence.compensation {
        Compensation::Averaged => 0.0,
        Compensation::Refined => REFINED_NOISE * (1.0 - refined),
    };
    let logarithm: f64 = terms.into_iter().zip(model).map(|(x, c)| x * c).sum();
    let of_mean = libm::exp(logarithm + of_noise) / (scale * unit_world);
    let principal = curvature.k1 * curvature.k1 + curvature.k2 * curvature.k2;
    let of_gaussian = of_mean * (GAUSSIAN[0] * principal.sqrt() + GAUSSIAN[1] * of_mean);
    [of_mean, of_gaussian]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn curvature(k1: f64, k2: f64) -> Curvature {
        Curvature {
            mean: 0.5 * (k1 + k2),
            gaussian: k1 * k2,
            k1,
            k2,
            d1: DVec3::X,
            d2: DVec3::Y,
            quality: 0.0,
        }
    }

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
        let round = curvature(0.05, 0.05);
        let of =
            |difference, ridges| error_bars(&evidence(difference, ridges), &round, 5.0, 5.0, 1.0);
        for i in 0..2 {
            assert!(of(0.002, 0.0)[i] < of(0.004, 0.0)[i]);
            assert!(of(0.004, 0.0)[i] < of(0.1, 0.0)[i]);
            assert!(of(0.004, 0.0)[i] < of(0.004, 0.2)[i]);
            assert!(of(0.004, 1.0)[i] > 0.8 * of(0.004, 0.0)[i]);
        }
        let sharp = error_bars(&evidence(0.004, 0.0), &curvature(0.0, 0.3), 5.0, 5.0, 1.0);
        assert!(sharp[0] > of(0.004, 0.0)[0]);
        let of_coarse_normals = error_bars(&evidence(0.004, 0.0), &round, 5.0, 2.0, 1.0);
        assert!(of_coarse_normals[0] > of(0.004, 0.0)[0]);
    }

    #[test]
    fn bars_are_lengths_to_the_minus_one_and_two() {
        let in_voxels = error_bars(&evidence(0.01, 0.0), &curvature(0.1, 0.2), 4.0, 4.0, 1.0);
        let of_half = curvature(0.2, 0.4);
        let in_halves = error_bars(&evidence(0.01, 0.0), &of_half, 4.0, 4.0, 0.5);
        assert!((in_halves[0] - 2.0 * in_voxels[0]).abs() < 1e-12);
        assert!((in_halves[1] - 4.0 * in_voxels[1]).abs() < 1e-12);
    }

    #[test]
    fn bars_of_nonsense_are_long_and_finite() {
        let nothing = evidence(f64::NAN, 1.0);
        let bars = error_bars(&nothing, &curvature(1.0, 1.0), 3.0, 3.0, 1.0);
        assert!(bars.iter().all(|b| b.is_finite() && *b > 0.05));
        let exact = error_bars(&evidence(0.0, 0.0), &curvature(0.0, 0.0), 3.0, 3.0, 1.0);
        assert!(exact.iter().all(|&b| b > 0.0));
    }
}
