//! The same code compiled twice: for any machine, and for the instructions most machines have.
//!
//! The hot loops count and shift bits and add integers. On x86-64 the baseline has no population
//! count and adds two integers at a time; with AVX2, BMI and POPCNT, found at run time, they
//! take about half the instructions. Floating point is not affected: no fused operations are
//! enabled, so both versions give the same bits.

/// Work that is worth compiling for better instructions. `run` must be `#[inline(always)]`, and
/// so must the hot functions it calls, or they are compiled for the baseline.
pub(crate) trait Work {
    /// What the work gives.
    type Output;

    /// Does the work.
    fn run(self) -> Self::Output;
}

/// Does the work with the best instructions this machine has.
#[inline]
pub(crate) fn dispatch<W: Work>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt")
    {
        // SAFETY: the features the function is compiled for were just found.
        return unsafe { with_x86_64_v3(work) };
    }
    work.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn with_x86_64_v3<W: Work>(work: W) -> W::Output {
    work.run()
}
