//! Vectors of sixteen numbers, for the loops that most time goes to, and the choice of instructions for them.
//!
//! [`dispatch`] compiles [`Work`] for several kinds of machine and takes the best of them at run time:
//!
//! | level | instructions | sixteen numbers of single precision are |
//! |---|---|---|
//! | [`Portable`] | the baseline: SSE2 on x86-64, NEON on AArch64 | an array |
//! | `Avx2` | AVX2, FMA, BMI, POPCNT: most x86-64 machines since 2013 | two registers |
//! | `Avx512` | AVX-512 F, BW, DQ, VL as well: servers since 2017 | one register |
//!
//! Work is plain Rust that the compiler turns into vectors of what a level has, or asks the [`Level`] for operations on
//! vectors where that was not enough. A level may not show in any result: each operation is rounded by itself, as IEEE 754 says,
//! sums of floating point numbers are exact or in a fixed order, and [`Level::multiply_add`] is used only where the product
//! is exact.
//!
//! `CURVOX_SIMD=portable|avx2|avx512` in the environment lowers the level, to compare them.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod dispatch;
mod portable;
#[cfg(test)]
mod tests;

#[cfg(test)]
pub(crate) use dispatch::at_every_level;
#[cfg(feature = "cli")]
pub(crate) use dispatch::instructions;
pub(crate) use dispatch::{Work, dispatch};

/// Numbers in a vector.
pub(crate) const LANES: usize = 16;

/// Any machine.
pub(crate) struct Portable;

/// x86-64 with AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
pub(crate) struct Avx2;

/// x86-64 with AVX-512.
#[cfg(target_arch = "x86_64")]
pub(crate) struct Avx512;

/// A kind of machine, and its vectors of sixteen numbers.
pub(crate) trait Level: Sized {
    /// Numbers of double precision that one instruction takes.
    const DOUBLES: usize;
    /// Numbers of single precision.
    type F: Copy;
    /// A choice of lanes.
    type M: Copy;
    /// Sums of integers.
    type U: Copy;
    /// Numbers of double precision.
    type D: Copy;

    /// `a * b + c`, fused where the level has the instruction: the same bits only if `a * b` is
    /// exact.
    fn multiply_add(a: f64, b: f64, c: f64) -> f64;

    fn all(x: f32) -> Self::F;
    fn load(x: &[f32; LANES]) -> Self::F;
    fn load_i16(x: &[i16; LANES]) -> Self::F;
    fn load_i8(x: &[i8; LANES]) -> Self::F;
    fn add(a: Self::F, b: Self::F) -> Self::F;
    fn sub(a: Self::F, b: Self::F) -> Self::F;
    fn mul(a: Self::F, b: Self::F) -> Self::F;
    /// The smaller one.
    fn min(a: Self::F, b: Self::F) -> Self::F;
    /// The larger one.
    fn max(a: Self::F, b: Self::F) -> Self::F;
    /// Where a <= b.
    fn at_most(a: Self::F, b: Self::F) -> Self::M;
    /// Stores the numbers in double precision.
    fn store(x: Self::F, to: &mut [f64; LANES]);
    /// Stores the chosen numbers in double precision, and 0 elsewhere.
    fn store_chosen(x: Self::F, chosen: Self::M, to: &mut [f64; LANES]);
    /// Stores the chosen numbers one after another from the start; what follows them there is undefined.
    fn compress(x: Self::F, chosen: Self::M, to: &mut [f32; LANES]);
    /// The same of integers.
    fn compress_u32(x: &[u32; LANES], chosen: Self::M, to: &mut [u32; LANES]);

    /// All or no lanes.
    fn mask(on: bool) -> Self::M;
    /// Lane i by bit i.
    fn from_bits(bits: u16) -> Self::M;
    /// Bit i by lane i.
    fn bits(mask: Self::M) -> u16;
    fn and(a: Self::M, b: Self::M) -> Self::M;
    /// Where two integers are equal.
    fn equal(a: &[u32; LANES], b: u32) -> Self::M;
    /// Where the entry of `table` that is named is not 0.
    fn looked_up(names: &[u32; LANES], table: &[u32]) -> Self::M;

    /// No integers.
    fn zero() -> Self::U;
    /// Adds the numbers chosen, which are integers from 0 to 2^22, to sums that stay below 2^32.
    fn add_chosen(sums: Self::U, x: Self::F, chosen: Self::M) -> Self::U;
    /// All sums together; below 2^36.
    fn total(sums: Self::U) -> u64;

    /// `w[0] x^2 + w[1] y^2 + w[2] z^2` in double precision.
    fn weighted_square(w: &[f64; 3], d: [Self::F; 3]) -> Self::D;
    /// Where a <= b.
    fn at_most_double(a: Self::D, b: f64) -> Self::M;
    /// `a * b` in double precision, rounded to single precision.
    fn scaled(a: Self::D, b: f64) -> Self::F;
    /// The sum of those chosen, exact if they are integers and the sum is below 2^53.
    fn sum_chosen(a: Self::D, chosen: Self::M) -> f64;
}

/// The nearest integers, halves to even, of numbers below 2^22 in size.
#[inline(always)]
pub(crate) fn rounded<L: Level>(x: L::F) -> L::F {
    // the last binary digit of what is added is 1
    const LARGE: f32 = 1.5 * (1u32 << 23) as f32;
    L::sub(L::add(x, L::all(LARGE)), L::all(LARGE))
}

/// `x + y + z` of three products.
#[inline(always)]
pub(crate) fn dot<L: Level>(a: [L::F; 3], b: [L::F; 3]) -> L::F {
    L::add(
        L::add(L::mul(a[0], b[0]), L::mul(a[1], b[1])),
        L::mul(a[2], b[2]),
    )
}
