//! The choice of instructions at run time.

use std::fmt;
use std::sync::OnceLock;

#[cfg(target_arch = "x86_64")]
use super::{Avx2, Avx512};
use super::{Level, Portable};

/// Work that is worth compiling for better instructions. `run` must be `#[inline(always)]`, and
/// so must the hot functions it calls, or they are compiled for the baseline.
pub(crate) trait Work {
    /// What the work gives.
    type Output;

    /// Does the work.
    fn run<L: Level>(self) -> Self::Output;
}

/// Name of a level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Instructions {
    /// The baseline of the architecture.
    Portable,
    /// AVX2, FMA, BMI and POPCNT.
    Avx2,
    /// AVX-512 F, BW, DQ and VL as well.
    Avx512,
}

impl fmt::Display for Instructions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Instructions::Portable => "portable",
            Instructions::Avx2 => "avx2",
            Instructions::Avx512 => "avx512",
        })
    }
}

/// Name of the variable of the environment that lowers the level.
const VARIABLE: &str = "CURVOX_SIMD";

/// The best level of this machine.
fn best() -> Instructions {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("fma")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt")
    {
        if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
        {
            return Instructions::Avx512;
        }
        return Instructions::Avx2;
    }
    Instructions::Portable
}

/// The level that is used: the best of this machine, unless `CURVOX_SIMD` asks for a lower one.
///
/// # Errors
/// What is wrong with `CURVOX_SIMD`.
pub(crate) fn instructions() -> Result<Instructions, String> {
    static CHOSEN: OnceLock<Result<Instructions, String>> = OnceLock::new();
    CHOSEN
        .get_or_init(|| {
            let best = best();
            let Some(asked) = std::env::var_os(VARIABLE) else {
                return Ok(best);
            };
            let levels = [
                Instructions::Portable,
                Instructions::Avx2,
                Instructions::Avx512,
            ];
            match levels.iter().find(|l| asked == l.to_string().as_str()) {
                Some(&level) if level <= best => Ok(level),
                Some(level) => Err(format!(
                    "{VARIABLE}={level}: this machine has {best} at most"
                )),
                None => Err(format!(
                    "{VARIABLE}={}: expected portable, avx2 or avx512",
                    asked.to_string_lossy()
                )),
            }
        })
        .clone()
}

/// Does the work with the best instructions this machine has.
#[inline]
pub(crate) fn dispatch<W: Work>(work: W) -> W::Output {
    match instructions().unwrap_or(Instructions::Portable) {
        // SAFETY: the features the function is compiled for were found on this machine.
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx512 => unsafe { with_avx512(work) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx2 => unsafe { with_avx2(work) },
        _ => work.run::<Portable>(),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn with_avx2<W: Work>(work: W) -> W::Output {
    work.run::<Avx2>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn with_avx512<W: Work>(work: W) -> W::Output {
    work.run::<Avx512>()
}

/// What every level of this machine gives for the same work.
#[cfg(test)]
pub(crate) fn at_every_level<W: Work>(work: impl Fn() -> W) -> Vec<W::Output> {
    let mut outputs = vec![work().run::<Portable>()];
    #[cfg(target_arch = "x86_64")]
    if best() >= Instructions::Avx2 {
        // SAFETY: the features were just found.
        outputs.push(unsafe { with_avx2(work()) });
    }
    #[cfg(target_arch = "x86_64")]
    if best() >= Instructions::Avx512 {
        // SAFETY: the features were just found.
        outputs.push(unsafe { with_avx512(work()) });
    }
    outputs
}
