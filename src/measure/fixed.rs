//! Fixed-point numbers of the measures.
//!
//! | measure | unit |
//! |---|---|
//! | mu0, tensor (mu1), mu_Omega | 2^-40, of areas and lengths in voxel units |
//! | mu2 of a pointel, or of a surfel with a continuous field | (pi/2) 2^-44, so that 4 pi is 2^47 exactly |
//! | mu2 lumped on surfels | (pi/2) 2^-40 |
//!
//! Range. A voxel has at most 3 surfels to its name, and a surfel carries at most 4 halves of a
//! tensor whose terms are at most pi, which is 2 pi 2^40 < 2^42.7; and at most 4 thirds of a mu2
//! of at most 2 pi, which is 4/3 2^42 < 2^42.5. With a continuous field a term of the tensor of a surfel is at most
//! 2 pi (rows and columns of the field are arcs of at most pi; quadrature is held to it), its mu2
//! at most 2 pi (linear: |u| <= 1 and |u_s|, |u_t| <= 2, so at most 4), within the same bounds. mu_Omega is at most 4 on a
//! surfel: half of 4 linels of at most 2, or 4 sides of at most 1. So the lumps of a voxel are below 2^44.3, and
//! balls of up to [`MOST_VOXELS`] voxels sum to less than 2^62.3, whatever the volume and `u`.
//! Sums of unlumped measures are kept in 128 bits.

/// Most voxels in a ball whose measures are summed: 39.7 voxels of radius for cubes.
pub const MOST_VOXELS: f64 = (1u64 << 18) as f64;

/// One, in the unit of mu0 and the tensor.
pub const ONE: f64 = (1u64 << 40) as f64;

/// `pi / 2` in the unit of mu2 of a pointel.
pub const QUARTER_TURN: i64 = 1 << 44;

/// The full sphere, `4 pi`, in the unit of mu2 of a pointel.
pub const SPHERE: i64 = 8 * QUARTER_TURN;

/// The nearest integer, halves to even, of a number below 2^51 in size; 0 of any other, which no measure is. The same of -x is
/// exactly the negative.
#[inline(always)]
fn nearest(x: f64) -> i64 {
    // so large that the last binary digit of a sum with it stands for 1
    const LARGE: f64 = 1.5 * (1u64 << 52) as f64;
    const LIMIT: f64 = (1u64 << 51) as f64;
    let x = if x.abs() < LIMIT { x } else { 0.0 };
    (x + LARGE).to_bits().wrapping_sub(LARGE.to_bits()) as i64
}

/// Rounds an area or tensor term once, half to even.
#[inline(always)]
#[must_use]
pub fn from_measure(x: f64) -> i64 {
    nearest(x * ONE)
}

/// Rounds a solid angle once, half to even, to the unit of mu2 of a pointel.
#[inline(always)]
#[must_use]
pub fn from_solid_angle(x: f64) -> i64 {
    nearest(x * (QUARTER_TURN as f64 / std::f64::consts::FRAC_PI_2))
}

/// Areas up to this much above half the sphere count as half the sphere: 4e-9 quarter turns. Less,
/// and rounding would choose between 2 pi and -2 pi where the normals of an umbrella lie on a
/// great circle, as they do around thin symmetric parts; much more would be a wrong area.
const HALF_SPHERE_SLACK: i64 = 1 << 16;

/// The integer nearest to `lift` over the full sphere; half a sphere is +2 pi, never -2 pi, so that
/// mirrored umbrellas agree.
#[inline]
#[must_use]
pub fn nearest_lift(lift: i64) -> i64 {
    (lift + SPHERE / 2 - 1 - HALF_SPHERE_SLACK).div_euclid(SPHERE)
}

/// A sum of areas or tensor terms as a number.
#[inline]
#[must_use]
pub fn to_measure(sum: i128) -> f64 {
    number(sum) / ONE
}

/// A sum as a number; nearly all fit 64 bits, which is quicker.
#[inline]
pub(super) fn number(sum: i128) -> f64 {
    /// Apart, or the compiler makes one conversion of both.
    #[cold]
    #[inline(never)]
    fn wide(sum: i128) -> f64 {
        sum as f64
    }
    i64::try_from(sum).map_or_else(|_| wide(sum), |sum| sum as f64)
}

/// A sum of mu2 of pointels as a solid angle.
#[inline]
#[must_use]
pub fn to_solid_angle(sum: i128) -> f64 {
    sum as f64 * (std::f64::consts::FRAC_PI_2 / QUARTER_TURN as f64)
}

/// Unit of mu2 lumped on surfels, as a solid angle.
pub const LUMPED_SOLID_ANGLE: f64 = std::f64::consts::FRAC_PI_2 / ONE;

/// The share of one of `degree` surfels in mu2 of a pointel, rounded half away from zero, in the
/// unit of lumped mu2.
#[inline]
#[must_use]
pub fn lumped_share(mu2: i64, degree: usize) -> i64 {
    // Numbers below 2^49 and a small divisor: the quotient is no whole number unless it was one,
    // and a division of doubles is quicker.
    let sixteenths = (mu2.abs() + 8 * degree as i64) >> 4;
    let share = (sixteenths as f64 / degree as f64) as i64;
    if mu2 < 0 { -share } else { share }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sphere_is_four_pi() {
        assert_eq!(from_solid_angle(4.0 * std::f64::consts::PI), SPHERE);
        assert!((to_solid_angle(i128::from(SPHERE)) - 4.0 * std::f64::consts::PI).abs() < 1e-15);
    }

    #[test]
    fn half_a_sphere_is_positive_however_it_was_rounded() {
        for slip in [-3, 0, 3] {
            assert_eq!(nearest_lift(SPHERE / 2 + slip), 0);
            assert_eq!(nearest_lift(-SPHERE / 2 + slip), -1);
        }
        assert_eq!(nearest_lift(SPHERE - 5), 1);
        assert_eq!(nearest_lift(QUARTER_TURN), 0);
    }

    #[test]
    fn measures_are_rounded_to_even_and_odd() {
        for (x, expected) in [
            (0.5, 0),
            (1.5, 2),
            (2.5, 2),
            (2.499_999_999, 2),
            (0.499_999_999, 0),
            (1e15 + 0.5, 1_000_000_000_000_000),
            (1e15 + 1.5, 1_000_000_000_000_002),
            (2e15, 2_000_000_000_000_000),
        ] {
            assert_eq!(nearest(x), expected, "{x}");
            assert_eq!(nearest(-x), -expected, "{x}");
        }
        for x in [f64::NAN, f64::INFINITY, 1e300, 3e15] {
            assert_eq!([nearest(x), nearest(-x)], [0, 0]);
        }
    }

    #[test]
    fn shares_are_odd_and_rounded() {
        assert_eq!(lumped_share(16 * 3 * 5 + 24, 3), 6);
        assert_eq!(lumped_share(-(16 * 3 * 5 + 24), 3), -6);
        assert_eq!(lumped_share(16 * 3 * 5 + 23, 3), 5);
        for degree in 1..=12 {
            let divisor = 16 * degree as i64;
            for share in [0, 1, 77, SPHERE / 2 / divisor, (1 << 49) / divisor - 1] {
                for (above, expected) in [
                    (-divisor / 2, share),
                    (divisor / 2 - 1, share),
                    (divisor / 2, share + 1),
                ] {
                    let mu2 = share * divisor + above;
                    if mu2 > 0 {
                        assert_eq!(lumped_share(mu2, degree), expected, "{mu2} {degree}");
                        assert_eq!(lumped_share(-mu2, degree), -expected, "{mu2} {degree}");
                    }
                }
            }
        }
    }
}
