//! Vectors as arrays: the compiler makes of them what the baseline of the machine has.

use super::{LANES, Level, Portable};

/// `f` of each lane.
#[inline(always)]
fn each<T: Copy + Default, A: Copy, B: Copy>(
    a: &[A; LANES],
    b: &[B; LANES],
    f: impl Fn(A, B) -> T,
) -> [T; LANES] {
    let mut to = [T::default(); LANES];
    for i in 0..LANES {
        to[i] = f(a[i], b[i]);
    }
    to
}

impl Level for Portable {
    const DOUBLES: usize = 2;
    type F = [f32; LANES];
    type M = [u32; LANES];
    type U = [u32; LANES];
    type D = [f64; LANES];

    #[inline(always)]
    fn multiply_add(a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }

    #[inline(always)]
    fn all(x: f32) -> Self::F {
        [x; LANES]
    }

    #[inline(always)]
    fn load(x: &[f32; LANES]) -> Self::F {
        *x
    }

    #[inline(always)]
    fn load_i16(x: &[i16; LANES]) -> Self::F {
        each(x, x, |x, _| f32::from(x))
    }

    #[inline(always)]
    fn load_i8(x: &[i8; LANES]) -> Self::F {
        each(x, x, |x, _| f32::from(x))
    }

    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        each(&a, &b, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        each(&a, &b, |a, b| a - b)
    }

    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        each(&a, &b, |a, b| a * b)
    }

    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        each(&a, &b, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        each(&a, &b, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn at_most(a: Self::F, b: Self::F) -> Self::M {
        each(&a, &b, |a, b| if a <= b { u32::MAX } else { 0 })
    }

    #[inline(always)]
    fn store(x: Self::F, to: &mut [f64; LANES]) {
        *to = each(&x, &x, |x, _| f64::from(x));
    }

    #[inline(always)]
    fn store_chosen(x: Self::F, chosen: Self::M, to: &mut [f64; LANES]) {
        *to = each(&x, &chosen, |x, m| {
            f64::from(f32::from_bits(x.to_bits() & m))
        });
    }

    #[inline(always)]
    fn compress(x: Self::F, chosen: Self::M, to: &mut [f32; LANES]) {
        let mut next = 0;
        for i in 0..LANES {
            to[next & (LANES - 1)] = x[i];
            next += (chosen[i] & 1) as usize;
        }
    }

    #[inline(always)]
    fn compress_u32(x: &[u32; LANES], chosen: Self::M, to: &mut [u32; LANES]) {
        let mut next = 0;
        for i in 0..LANES {
            to[next & (LANES - 1)] = x[i];
            next += (chosen[i] & 1) as usize;
        }
    }

    #[inline(always)]
    fn mask(on: bool) -> Self::M {
        [if on { u32::MAX } else { 0 }; LANES]
    }

    #[inline(always)]
    fn from_bits(bits: u16) -> Self::M {
        let mut mask = [0; LANES];
        for (i, lane) in mask.iter_mut().enumerate() {
            *lane = 0u32.wrapping_sub(u32::from(bits >> i & 1));
        }
        mask
    }

    #[inline(always)]
    fn bits(mask: Self::M) -> u16 {
        let mut bits = 0;
        for (i, lane) in mask.iter().enumerate() {
            bits |= ((lane & 1) as u16) << i;
        }
        bits
    }

    #[inline(always)]
    fn and(a: Self::M, b: Self::M) -> Self::M {
        each(&a, &b, |a, b| a & b)
    }

    #[inline(always)]
    fn equal(a: &[u32; LANES], b: u32) -> Self::M {
        each(a, a, |a, _| if a == b { u32::MAX } else { 0 })
    }

    #[inline(always)]
    fn looked_up(names: &[u32; LANES], table: &[u32]) -> Self::M {
        each(names, names, |n, _| {
            if table[n as usize] != 0 { u32::MAX } else { 0 }
        })
    }

    #[inline(always)]
    fn zero() -> Self::U {
        [0; LANES]
    }

    #[inline(always)]
    fn add_chosen(sums: Self::U, x: Self::F, chosen: Self::M) -> Self::U {
        // the mantissa, once the exponent is that of 2^23
        const UNIT: f32 = (1u32 << 23) as f32;
        let chosen = each(&x, &chosen, |x, m| (x + UNIT).to_bits() & 0x007f_ffff & m);
        each(&sums, &chosen, |sum, x| sum.wrapping_add(x))
    }

    #[inline(always)]
    fn total(sums: Self::U) -> u64 {
        let mut total = 0;
        for sum in sums {
            total += u64::from(sum);
        }
        total
    }

    #[inline(always)]
    fn weighted_square(w: &[f64; 3], d: [Self::F; 3]) -> Self::D {
        let mut to = [0.0; LANES];
        for i in 0..LANES {
            let [x, y, z] = [f64::from(d[0][i]), f64::from(d[1][i]), f64::from(d[2][i])];
            to[i] = w[0] * (x * x) + w[1] * (y * y) + w[2] * (z * z);
        }
        to
    }

    #[inline(always)]
    fn at_most_double(a: Self::D, b: f64) -> Self::M {
        each(&a, &a, |a, _| if a <= b { u32::MAX } else { 0 })
    }

    #[inline(always)]
    fn scaled(a: Self::D, b: f64) -> Self::F {
        each(&a, &a, |a, _| (a * b) as f32)
    }

    #[inline(always)]
    fn sum_chosen(a: Self::D, chosen: Self::M) -> f64 {
        let mut sum = 0.0;
        for i in 0..LANES {
            sum += if chosen[i] != 0 { a[i] } else { 0.0 };
        }
        sum
    }
}
