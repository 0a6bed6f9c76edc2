//! Vectors of AVX2: two registers each.
//!
//! The operations are only reached through [`super::dispatch`], which looks for the features of the machine
//! first: nobody else names the level. That is what makes them safe to call.

use std::arch::x86_64::*;

use super::{Avx2, LANES, Level};

/// For each choice of eight lanes, the numbers of those chosen, in order.
static ORDERS: [[u32; 8]; 256] = {
    let mut orders = [[0; 8]; 256];
    let mut bits = 0;
    while bits < 256 {
        let (mut lane, mut next) = (0, 0);
        while lane < 8 {
            if bits >> lane & 1 == 1 {
                orders[bits][next] = lane;
                next += 1;
            }
            lane += 1;
        }
        bits += 1;
    }
    orders
};

#[inline(always)]
fn order(bits: usize) -> __m256i {
    // SAFETY: see the head of the module; an order is eight integers.
    unsafe { _mm256_loadu_si256(ORDERS[bits].as_ptr().cast()) }
}

impl Level for Avx2 {
    const DOUBLES: usize = 4;
    type F = [__m256; 2];
    type M = [__m256; 2];
    type U = [__m256i; 2];
    type D = [__m256d; 4];

    #[inline(always)]
    fn multiply_add(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }

    #[inline(always)]
    fn all(x: f32) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_set1_ps(x); 2] }
    }

    #[inline(always)]
    fn load(x: &[f32; LANES]) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe {
            [
                _mm256_loadu_ps(x.as_ptr()),
                _mm256_loadu_ps(x.as_ptr().add(8)),
            ]
        }
    }

    #[inline(always)]
    fn load_i16(x: &[i16; LANES]) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe {
            let low = _mm256_cvtepi16_epi32(_mm_loadu_si128(x.as_ptr().cast()));
            let high = _mm256_cvtepi16_epi32(_mm_loadu_si128(x.as_ptr().add(8).cast()));
            [_mm256_cvtepi32_ps(low), _mm256_cvtepi32_ps(high)]
        }
    }

    #[inline(always)]
    fn load_i8(x: &[i8; LANES]) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe {
            let low = _mm256_cvtepi8_epi32(_mm_loadl_epi64(x.as_ptr().cast()));
            let high = _mm256_cvtepi8_epi32(_mm_loadl_epi64(x.as_ptr().add(8).cast()));
            [_mm256_cvtepi32_ps(low), _mm256_cvtepi32_ps(high)]
        }
    }

    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_add_ps(a[0], b[0]), _mm256_add_ps(a[1], b[1])] }
    }

    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1])] }
    }

    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1])] }
    }

    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_min_ps(a[0], b[0]), _mm256_min_ps(a[1], b[1])] }
    }

    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_max_ps(a[0], b[0]), _mm256_max_ps(a[1], b[1])] }
    }

    #[inline(always)]
    fn at_most(a: Self::F, b: Self::F) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe {
            [
                _mm256_cmp_ps::<_CMP_LE_OQ>(a[0], b[0]),
                _mm256_cmp_ps::<_CMP_LE_OQ>(a[1], b[1]),
            ]
        }
    }

    #[inline(always)]
    fn store(x: Self::F, to: &mut [f64; LANES]) {
        // SAFETY: see the head of the module.
        unsafe {
            for i in 0..2 {
                let low = _mm256_cvtps_pd(_mm256_castps256_ps128(x[i]));
                let high = _mm256_cvtps_pd(_mm256_extractf128_ps::<1>(x[i]));
                _mm256_storeu_pd(to.as_mut_ptr().add(8 * i), low);
                _mm256_storeu_pd(to.as_mut_ptr().add(8 * i + 4), high);
            }
        }
    }

    #[inline(always)]
    fn store_chosen(x: Self::F, chosen: Self::M, to: &mut [f64; LANES]) {
        // SAFETY: see the head of the module.
        unsafe {
            for i in 0..2 {
                let x = _mm256_and_ps(x[i], chosen[i]);
                let low = _mm256_cvtps_pd(_mm256_castps256_ps128(x));
                let high = _mm256_cvtps_pd(_mm256_extractf128_ps::<1>(x));
                _mm256_storeu_pd(to.as_mut_ptr().add(8 * i), low);
                _mm256_storeu_pd(to.as_mut_ptr().add(8 * i + 4), high);
            }
        }
    }

    #[inline(always)]
    fn compress(x: Self::F, chosen: Self::M, to: &mut [f32; LANES]) {
        // SAFETY: see the head of the module.
        unsafe {
            let bits = Self::bits(chosen);
            let mut lanes = [0.0; LANES];
            let [low, high] = [(bits & 255) as usize, (bits >> 8) as usize];
            let first = _mm256_permutevar8x32_ps(x[0], order(low));
            let second = _mm256_permutevar8x32_ps(x[1], order(high));
            _mm256_storeu_ps(lanes.as_mut_ptr(), first);
            // at most 8 come before
            _mm256_storeu_ps(lanes.as_mut_ptr().add(low.count_ones() as usize), second);
            *to = lanes;
        }
    }

    #[inline(always)]
    fn compress_u32(x: &[u32; LANES], chosen: Self::M, to: &mut [u32; LANES]) {
        // SAFETY: see the head of the module.
        unsafe {
            let bits = Self::bits(chosen);
            let mut lanes = [0; LANES];
            let [low, high] = [(bits & 255) as usize, (bits >> 8) as usize];
            let first = _mm256_loadu_si256(x.as_ptr().cast());
            let second = _mm256_loadu_si256(x.as_ptr().add(8).cast());
            let first = _mm256_permutevar8x32_epi32(first, order(low));
            let second = _mm256_permutevar8x32_epi32(second, order(high));
            _mm256_storeu_si256(lanes.as_mut_ptr().cast(), first);
            let after = low.count_ones() as usize;
            // at most 8 come before
            _mm256_storeu_si256(lanes.as_mut_ptr().add(after).cast(), second);
            *to = lanes;
        }
    }

    #[inline(always)]
    fn mask(on: bool) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_castsi256_ps(_mm256_set1_epi32(-i32::from(on))); 2] }
    }

    #[inline(always)]
    fn from_bits(bits: u16) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe {
            let lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let half = |bits: u16| {
                let bits = _mm256_and_si256(_mm256_set1_epi32(i32::from(bits)), lanes);
                _mm256_castsi256_ps(_mm256_cmpeq_epi32(bits, lanes))
            };
            [half(bits & 255), half(bits >> 8)]
        }
    }

    #[inline(always)]
    fn bits(mask: Self::M) -> u16 {
        // SAFETY: see the head of the module.
        unsafe { (_mm256_movemask_ps(mask[0]) | _mm256_movemask_ps(mask[1]) << 8) as u16 }
    }

    #[inline(always)]
    fn and(a: Self::M, b: Self::M) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_and_ps(a[0], b[0]), _mm256_and_ps(a[1], b[1])] }
    }

    #[inline(always)]
    fn equal(a: &[u32; LANES], b: u32) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe {
            let b = _mm256_set1_epi32(b as i32);
            let low = _mm256_loadu_si256(a.as_ptr().cast());
            let high = _mm256_loadu_si256(a.as_ptr().add(8).cast());
            [
                _mm256_castsi256_ps(_mm256_cmpeq_epi32(low, b)),
                _mm256_castsi256_ps(_mm256_cmpeq_epi32(high, b)),
            ]
        }
    }

    #[inline(always)]
    fn looked_up(names: &[u32; LANES], table: &[u32]) -> Self::M {
        let mut bits = 0;
        for (i, &name) in names.iter().enumerate() {
            bits |= u16::from(table[name as usize] != 0) << i;
        }
        Self::from_bits(bits)
    }

    #[inline(always)]
    fn zero() -> Self::U {
        // SAFETY: see the head of the module.
        unsafe { [_mm256_setzero_si256(); 2] }
    }

    #[inline(always)]
    fn add_chosen(sums: Self::U, x: Self::F, chosen: Self::M) -> Self::U {
        // SAFETY: see the head of the module.
        unsafe {
            let low = _mm256_cvtps_epi32(_mm256_and_ps(x[0], chosen[0]));
            let high = _mm256_cvtps_epi32(_mm256_and_ps(x[1], chosen[1]));
            [
                _mm256_add_epi32(sums[0], low),
                _mm256_add_epi32(sums[1], high),
            ]
        }
    }

    #[inline(always)]
    fn total(sums: Self::U) -> u64 {
        let mut lanes = [0u32; LANES];
        // SAFETY: see the head of the module.
        unsafe {
            _mm256_storeu_si256(lanes.as_mut_ptr().cast(), sums[0]);
            _mm256_storeu_si256(lanes.as_mut_ptr().add(8).cast(), sums[1]);
        }
        let mut total = 0;
        for lane in lanes {
            total += u64::from(lane);
        }
        total
    }

    #[inline(always)]
    fn weighted_square(w: &[f64; 3], d: [Self::F; 3]) -> Self::D {
        // SAFETY: see the head of the module.
        unsafe {
            let mut to = [_mm256_setzero_pd(); 4];
            for a in 0..3 {
                let w = _mm256_set1_pd(w[a]);
                for i in 0..2 {
                    let quarters = [
                        _mm256_castps256_ps128(d[a][i]),
                        _mm256_extractf128_ps::<1>(d[a][i]),
                    ];
                    for j in 0..2 {
                        let d = _mm256_cvtps_pd(quarters[j]);
                        let square = _mm256_mul_pd(w, _mm256_mul_pd(d, d));
                        to[2 * i + j] = _mm256_add_pd(to[2 * i + j], square);
                    }
                }
            }
            to
        }
    }

    #[inline(always)]
    fn at_most_double(a: Self::D, b: f64) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe {
            let b = _mm256_set1_pd(b);
            let mut bits = 0;
            for i in 0..4 {
                let within = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LE_OQ>(a[i], b));
                bits |= (within as u16) << (4 * i);
            }
            Self::from_bits(bits)
        }
    }

    #[inline(always)]
    fn scaled(a: Self::D, b: f64) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe {
            let b = _mm256_set1_pd(b);
            let mut to = [_mm256_setzero_ps(); 2];
            for i in 0..2 {
                let low = _mm256_cvtpd_ps(_mm256_mul_pd(a[2 * i], b));
                let high = _mm256_cvtpd_ps(_mm256_mul_pd(a[2 * i + 1], b));
                to[i] = _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(low), high);
            }
            to
        }
    }

    #[inline(always)]
    fn sum_chosen(a: Self::D, chosen: Self::M) -> f64 {
        let bits = Self::bits(chosen);
        let mut lanes = [0.0; LANES];
        // SAFETY: see the head of the module.
        unsafe {
            for i in 0..4 {
                _mm256_storeu_pd(lanes.as_mut_ptr().add(4 * i), a[i]);
            }
        }
        let mut sum = 0.0;
        for (i, lane) in lanes.iter().enumerate() {
            sum += if bits >> i & 1 != 0 { *lane } else { 0.0 };
        }
        sum
    }
}
