//! The logarithm and the exponential function, for many numbers at once.
//!
//! There are no branches and no calls, so that a loop over many numbers becomes a loop over vectors of them, with the same bits:
//! where something is undefined, what was computed is not chosen. Both are within one unit of the last digit: the
//! reductions and polynomials are those of FreeBSD's msun, which is what libm has.

/// ln 2, with 32 binary digits and what is left.
const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];

/// log((1 + s) / (1 - s)) / s - 2 is s^2 (L0 + L1 s^2 + ..) for s up to 3 - 8^(1/2), to 2^-58.
const LOGARITHM: [f64; 7] = [
    6.666_666_666_666_735e-1,
    3.999_999_999_940_942e-1,
    2.857_142_874_366_239e-1,
    2.222_219_843_214_978_4e-1,
    1.818_357_216_161_805e-1,
    1.531_383_769_920_937_3e-1,
    1.479_819_860_511_658_6e-1,
];

/// r (e^r + 1) / (e^r - 1) - 2 is r^2 (P0 + P1 r^2 + ..) for r up to half of ln 2, to 2^-59.
const EXPONENTIAL: [f64; 5] = [
    1.666_666_666_666_660_2e-1,
    -2.777_777_777_701_559_3e-3,
    6.613_756_321_437_934e-5,
    -1.653_390_220_546_525_2e-6,
    4.138_136_797_057_238_5e-8,
];

/// Added and taken away again, it leaves the nearest integer; its last binary digit is 1.
const ROUNDING: f64 = 1.5 * (1u64 << 52) as f64;

/// The bits of 2^52, whose last binary digit is 1.
const LARGE: u64 = 0x4330_0000_0000_0000;

/// The bits of 1, and those of 2^(-1/2) up to the twentieth digit.
const ONE: u64 = 0x3ff0_0000_0000_0000;
const ROOT_HALF: u64 = 0x3fe6_a09e_0000_0000;

/// Subnormal numbers are multiplied by this.
const TO_NORMAL: f64 = (1u64 << 54) as f64;

/// The natural logarithm: of 0 minus infinity, of negative numbers not a number.
#[inline(always)]
#[must_use]
pub(crate) fn log(x: f64) -> f64 {
    let small = x < f64::MIN_POSITIVE;
    let normal = if small { x * TO_NORMAL } else { x };
    // x = 2^n m, m from 2^(-1/2) to 2^(1/2)
    let bits = normal.to_bits().wrapping_add(ONE - ROOT_HALF);
    let exponent = f64::from_bits((bits >> 52) | LARGE) - f64::from_bits(LARGE);
    let n = exponent - if small { 1023.0 + 54.0 } else { 1023.0 };
    let m = f64::from_bits((bits & 0x000f_ffff_ffff_ffff).wrapping_add(ROOT_HALF));
    let f = m - 1.0;
    let half_square = 0.5 * f * f;
    let s = f / (2.0 + f);
    let l = &LOGARITHM;
    let (z, w) = (s * s, (s * s) * (s * s));
    let odd = w * (l[1] + w * (l[3] + w * l[5]));
    let even = z * (l[0] + w * (l[2] + w * (l[4] + w * l[6])));
    let near = s * (half_square + (even + odd)) + n * LN_2[1] - half_square + f;
    let logarithm = near + n * LN_2[0];
    // infinity and what is no number stay
    let logarithm = if x < f64::INFINITY { logarithm } else { x };
    let logarithm = if x == 0.0 {
        f64::NEG_INFINITY
    } else {
        logarithm
    };
    if x < 0.0 { f64::NAN } else { logarithm }
}

/// The exponential function.
#[inline(always)]
#[must_use]
pub(crate) fn exp(x: f64) -> f64 {
    // beyond these it is 0 and infinite
    let x = if x < -746.0 { -746.0 } else { x };
    let x = if x > 710.0 { 710.0 } else { x };
    let n = (x * std::f64::consts::LOG2_E + ROUNDING) - ROUNDING;
    let (high, low) = (x - n * LN_2[0], n * LN_2[1]);
    let r = high - low;
    let p = &EXPONENTIAL;
    let z = r * r;
    let c = r - z * (p[0] + z * (p[1] + z * (p[2] + z * (p[3] + z * p[4]))));
    let near = 1.0 + (r * c / (2.0 - c) - low + high);
    // 2^n may be no number of its own: in two steps, the first of which is exact
    let first = (n * 0.5 + ROUNDING) - ROUNDING;
    near * power_of_two(first) * power_of_two(n - first)
}

/// 2^n for integers n from -1022 to 1023.
#[inline(always)]
fn power_of_two(n: f64) -> f64 {
    f64::from_bits((n + (ROUNDING + 1023.0)).to_bits() << 52)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::{Level, Work, at_every_level};

    struct Both<'a>(&'a [f64]);

    impl Work for Both<'_> {
        type Output = Vec<[u64; 2]>;

        #[inline(always)]
        fn run<L: Level>(self) -> Vec<[u64; 2]> {
            let mut found = vec![[0; 2]; self.0.len()];
            for (to, &x) in found.iter_mut().zip(self.0) {
                *to = [log(x).to_bits(), exp(x).to_bits()];
            }
            found
        }
    }

    /// All but the sign and the digits of what is no number.
    fn same(found: f64, expected: f64) -> bool {
        let unit = f64::EPSILON * expected.abs();
        found == expected || found.is_nan() && expected.is_nan() || (found - expected).abs() <= unit
    }

    #[test]
    fn they_are_those_of_libm_at_every_level() {
        let mut numbers = vec![
            0.0,
            f64::from_bits(1),
            f64::MIN_POSITIVE / 3.0,
            f64::MIN_POSITIVE,
            1e-17,
            std::f64::consts::FRAC_1_SQRT_2,
            1.0 - f64::EPSILON / 2.0,
            1.0,
            1.0 + f64::EPSILON,
            std::f64::consts::SQRT_2,
            2.0,
            708.5,
            709.782,
            709.79,
            745.1,
            745.14,
            746.1,
            1e4,
            1e300,
            f64::MAX,
            f64::INFINITY,
            f64::NAN,
        ];
        let mut seed = 5u64;
        for n in 0..300_000u64 {
            seed = seed
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            let share = (seed >> 11) as f64 / (1u64 << 53) as f64;
            numbers.push(match n % 4 {
                0 => f64::from_bits(seed),
                1 => 750.0 * share,
                2 => 4.0 * share,
                _ => share * share * share * 1e-6 + 1.0,
            });
        }
        for at in 0..numbers.len() {
            numbers.push(-numbers[at]);
        }
        let found = at_every_level(|| Both(&numbers));
        for other in &found[1..] {
            for (x, (a, b)) in numbers.iter().zip(found[0].iter().zip(other)) {
                for (a, b) in a.iter().zip(b) {
                    let no_numbers = f64::from_bits(*a).is_nan() && f64::from_bits(*b).is_nan();
                    assert!(a == b || no_numbers, "{x:e}");
                }
            }
        }
        for (&x, found) in numbers.iter().zip(&found[0]) {
            let [log, exp] = found.map(f64::from_bits);
            assert!(same(log, libm::log(x)), "{x:e}: {log:e} {:e}", libm::log(x));
            // subnormal numbers are rounded to their unit
            let near = (exp - libm::exp(x)).abs() <= f64::from_bits(1);
            let is_same = same(exp, libm::exp(x)) || near;
            assert!(is_same, "{x:e}: {exp:e} {:e}", libm::exp(x));
        }
        assert_eq!(log(1.0).to_bits(), 0);
        assert_eq!(exp(0.0), 1.0);
    }
}
