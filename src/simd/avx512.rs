//! Vectors of AVX-512: one register each.
//!
//! The operations are only reached through [`super::dispatch`], which looks for the features of the machine
//! first: nobody else names the level. That is what makes them safe to call.

use std::arch::x86_64::*;

use super::{Avx512, LANES, Level};

impl Level for Avx512 {
    const DOUBLES: usize = 8;
    type F = __m512;
    type M = u16;
    type U = __m512i;
    type D = [__m512d; 2];

    #[inline(always)]
    fn multiply_add(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }

    #[inline(always)]
    fn all(x: f32) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_set1_ps(x) }
    }

    #[inline(always)]
    fn load(x: &[f32; LANES]) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_loadu_ps(x.as_ptr()) }
    }

    #[inline(always)]
    fn load_i16(x: &[i16; LANES]) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_cvtepi32_ps(_mm512_cvtepi16_epi32(_mm256_loadu_si256(x.as_ptr().cast()))) }
    }

    #[inline(always)]
    fn load_i8(x: &[i8; LANES]) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_loadu_si128(x.as_ptr().cast()))) }
    }

    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_add_ps(a, b) }
    }

    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_sub_ps(a, b) }
    }

    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_mul_ps(a, b) }
    }

    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_min_ps(a, b) }
    }

    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe { _mm512_max_ps(a, b) }
    }

    #[inline(always)]
    fn at_most(a: Self::F, b: Self::F) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b) }
    }

    #[inline(always)]
    fn store(x: Self::F, to: &mut [f64; LANES]) {
        // SAFETY: see the head of the module.
        unsafe {
            let low = _mm512_cvtps_pd(_mm512_castps512_ps256(x));
            let high = _mm512_cvtps_pd(_mm512_extractf32x8_ps::<1>(x));
            _mm512_storeu_pd(to.as_mut_ptr(), low);
            _mm512_storeu_pd(to.as_mut_ptr().add(8), high);
        }
    }

    #[inline(always)]
    fn store_chosen(x: Self::F, chosen: Self::M, to: &mut [f64; LANES]) {
        // SAFETY: see the head of the module.
        unsafe {
            let low = _mm512_maskz_cvtps_pd(chosen as u8, _mm512_castps512_ps256(x));
            let high = _mm512_maskz_cvtps_pd((chosen >> 8) as u8, _mm512_extractf32x8_ps::<1>(x));
            _mm512_storeu_pd(to.as_mut_ptr(), low);
            _mm512_storeu_pd(to.as_mut_ptr().add(8), high);
        }
    }

    #[inline(always)]
    fn compress(x: Self::F, chosen: Self::M, to: &mut [f32; LANES]) {
        // SAFETY: see the head of the module.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), _mm512_maskz_compress_ps(chosen, x)) }
    }

    #[inline(always)]
    fn compress_u32(x: &[u32; LANES], chosen: Self::M, to: &mut [u32; LANES]) {
        // SAFETY: see the head of the module.
        unsafe {
            let x = _mm512_loadu_si512(x.as_ptr().cast());
            let chosen = _mm512_maskz_compress_epi32(chosen, x);
            _mm512_storeu_si512(to.as_mut_ptr().cast(), chosen);
        }
    }

    #[inline(always)]
    fn mask(on: bool) -> Self::M {
        if on { u16::MAX } else { 0 }
    }

    #[inline(always)]
    fn from_bits(bits: u16) -> Self::M {
        bits
    }

    #[inline(always)]
    fn bits(mask: Self::M) -> u16 {
        mask
    }

    #[inline(always)]
    fn and(a: Self::M, b: Self::M) -> Self::M {
        a & b
    }

    #[inline(always)]
    fn equal(a: &[u32; LANES], b: u32) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe {
            let a = _mm512_loadu_si512(a.as_ptr().cast());
            _mm512_cmpeq_epi32_mask(a, _mm512_set1_epi32(b as i32))
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
        unsafe { _mm512_setzero_si512() }
    }

    #[inline(always)]
    fn add_chosen(sums: Self::U, x: Self::F, chosen: Self::M) -> Self::U {
        // SAFETY: see the head of the module.
        unsafe { _mm512_mask_add_epi32(sums, chosen, sums, _mm512_cvtps_epi32(x)) }
    }

    #[inline(always)]
    fn total(sums: Self::U) -> u64 {
        let mut lanes = [0u32; LANES];
        // SAFETY: see the head of the module.
        unsafe { _mm512_storeu_si512(lanes.as_mut_ptr().cast(), sums) }
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
            let mut to = [_mm512_setzero_pd(); 2];
            for a in 0..3 {
                let halves = [
                    _mm512_castps512_ps256(d[a]),
                    _mm512_extractf32x8_ps::<1>(d[a]),
                ];
                for i in 0..2 {
                    let d = _mm512_cvtps_pd(halves[i]);
                    let square = _mm512_mul_pd(_mm512_set1_pd(w[a]), _mm512_mul_pd(d, d));
                    to[i] = _mm512_add_pd(to[i], square);
                }
            }
            to
        }
    }

    #[inline(always)]
    fn at_most_double(a: Self::D, b: f64) -> Self::M {
        // SAFETY: see the head of the module.
        unsafe {
            let b = _mm512_set1_pd(b);
            let [low, high] = [
                _mm512_cmp_pd_mask::<_CMP_LE_OQ>(a[0], b),
                _mm512_cmp_pd_mask::<_CMP_LE_OQ>(a[1], b),
            ];
            u16::from(low) | u16::from(high) << 8
        }
    }

    #[inline(always)]
    fn scaled(a: Self::D, b: f64) -> Self::F {
        // SAFETY: see the head of the module.
        unsafe {
            let b = _mm512_set1_pd(b);
            let low = _mm512_cvtpd_ps(_mm512_mul_pd(a[0], b));
            let high = _mm512_cvtpd_ps(_mm512_mul_pd(a[1], b));
            _mm512_insertf32x8::<1>(_mm512_castps256_ps512(low), high)
        }
    }

    #[inline(always)]
    fn sum_chosen(a: Self::D, chosen: Self::M) -> f64 {
        // SAFETY: see the head of the module.
        unsafe {
            _mm512_mask_reduce_add_pd(chosen as u8, a[0])
                + _mm512_mask_reduce_add_pd((chosen >> 8) as u8, a[1])
        }
    }
}
