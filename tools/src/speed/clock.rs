//! Time of this process, and what repeats of a measurement say together.

use std::time::Instant;

/// Time that something took, in seconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Time {
    /// Processor time of the whole process, user and system, all threads.
    pub cpu: f64,
    /// On the clock.
    pub wall: f64,
}

/// Times one call.
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, Time) {
    let (cpu, wall) = (processor_seconds(), Instant::now());
    let result = work();
    let time = Time {
        cpu: processor_seconds() - cpu,
        wall: wall.elapsed().as_secs_f64(),
    };
    (result, time)
}

fn processor_seconds() -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the pointer is to a timespec that outlives the call.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    assert_eq!(status, 0, "the system has a clock of processor time");
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// The middle one, or the mean of the two in the middle; NaN of nothing.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let half = sorted.len() / 2;
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[half],
        _ => 0.5 * (sorted[half - 1] + sorted[half]),
    }
}

/// Largest less smallest, over the median: how far repeats differ.
pub fn spread(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let smallest = values.iter().copied().fold(f64::INFINITY, f64::min);
    (largest - smallest) / median(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_is_the_middle_of_odd_and_the_mean_of_even_counts() {
        assert!(median(&[]).is_nan());
        assert_eq!(median(&[3.0]), 3.0);
        assert_eq!(median(&[9.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[9.0, 1.0, 2.0, 4.0]), 3.0);
    }

    #[test]
    fn spread_is_relative_to_the_median() {
        assert_eq!(spread(&[2.0, 2.0]), 0.0);
        assert_eq!(spread(&[1.0, 2.0, 4.0]), 1.5);
    }

    #[test]
    fn processor_time_grows_with_work() {
        let ((), time) = timed(|| {
            let started = processor_seconds();
            while processor_seconds() < started + 0.002 {}
        });
        assert!(time.cpu >= 0.002 && time.wall > 0.0);
    }
}
