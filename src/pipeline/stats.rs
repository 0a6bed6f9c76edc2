//! What a run spends: processor time of each stage, what it waits for, memory at its peak.
//!
//! Comes in: calls of the stages, around what they do on a worker and around what they wait for. Goes
//! out: [`Stats`]. The time of a stage's thread is what it waits for and what it is busy with (its own
//! work, and waiting for its bricks on the pool). Processor time is that of its thread and of
//! the workers while they were on its bricks. Where nobody asks ([`super::Progress::default`]) nothing is
//! kept; where somebody does, a few clocks are read for each brick.
//!
//! Not guaranteed: that processor time is known. On systems without a clock for threads it is the time
//! that passed.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;

/// What a run spent.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Stats {
    /// Time from the start of the stages to the end of the last.
    pub seconds: f64,
    /// The stages in order.
    pub stages: Vec<StageStats>,
    /// Time that each sink was busy, in order.
    pub sink_seconds: Vec<f64>,
    /// Memory.
    pub memory: MemoryStats,
}

/// What a stage spent.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StageStats {
    /// Its name.
    pub name: String,
    /// Time from its start to its end: the sum of the next four.
    pub seconds: f64,
    /// Time it worked, or waited for its bricks on the pool.
    pub busy_seconds: f64,
    /// Time it waited for the stage before.
    pub input_seconds: f64,
    /// Time it waited for memory for surfels.
    pub memory_seconds: f64,
    /// Time it waited for the stage behind.
    pub output_seconds: f64,
    /// Processor time, of its thread and of workers.
    pub cpu_seconds: f64,
}

/// What was held at once, at most, in bytes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MemoryStats {
    /// Surfels in flight, as they are counted by the plan.
    pub surfel_bytes: u64,
    /// Bits of planes and indices of surfels.
    pub bits_bytes: u64,
}

/// What a stage waits for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Wait {
    Input,
    Memory,
    Output,
}

/// The clock of a stage.
#[derive(Debug)]
pub(super) struct Clock {
    name: String,
    on: bool,
    /// Nanoseconds, as all others.
    total: AtomicU64,
    waits: [AtomicU64; 3],
    cpu: AtomicU64,
}

impl Clock {
    pub(super) fn new(name: impl Into<String>, on: bool) -> Self {
        Self {
            name: name.into(),
            on,
            total: AtomicU64::default(),
            waits: Default::default(),
            cpu: AtomicU64::default(),
        }
    }

    /// Runs the stage, or a part of it, on its own thread.
    pub(super) fn stage<T>(&self, work: impl FnOnce() -> T) -> T {
        let started = Instant::now();
        let result = self.work(work);
        if self.on {
            add(&self.total, started.elapsed());
        }
        result
    }

    /// Does a part of the stage's work, on a worker that does nothing else meanwhile.
    pub(super) fn work<T>(&self, work: impl FnOnce() -> T) -> T {
        if !self.on {
            return work();
        }
        let before = thread_time();
        let result = work();
        self.add_work(thread_time().saturating_sub(before));
        result
    }

    /// Adds work that was done elsewhere.
    pub(super) fn add_work(&self, time: Duration) {
        add(&self.cpu, time);
    }

    /// Waits on the stage's own thread.
    pub(super) fn wait<T>(&self, what: Wait, wait: impl FnOnce() -> T) -> T {
        if !self.on {
            return wait();
        }
        let started = Instant::now();
        let result = wait();
        add(&self.waits[what as usize], started.elapsed());
        result
    }

    pub(super) fn stats(&self) -> StageStats {
        let total = self.total.load(Ordering::Relaxed);
        let [input, memory, output] = [0, 1, 2].map(|i| self.waits[i].load(Ordering::Relaxed));
        let busy = total.saturating_sub(input + memory + output);
        let seconds = |nanoseconds: u64| nanoseconds as f64 * 1e-9;
        StageStats {
            name: self.name.clone(),
            seconds: seconds(total),
            busy_seconds: seconds(busy),
            input_seconds: seconds(input),
            memory_seconds: seconds(memory),
            output_seconds: seconds(output),
            cpu_seconds: seconds(self.cpu.load(Ordering::Relaxed)),
        }
    }
}

fn add(to: &AtomicU64, time: Duration) {
    // Centuries of nanoseconds fit.
    to.fetch_add(time.as_nanos() as u64, Ordering::Relaxed);
}

/// Processor time of all workers of rayon's global pool, on which sinks encode.
pub(super) fn global_pool_time() -> Duration {
    rayon::broadcast(|_| thread_time()).into_iter().sum()
}

/// Processor time of this thread.
#[cfg(unix)]
pub(super) fn thread_time() -> Duration {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `time` is a timespec that the call fills. A failure leaves it at zero.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    Duration::new(time.tv_sec.max(0) as u64, time.tv_nsec.max(0) as u32)
}

/// Time that passed, since there is no clock for threads.
#[cfg(not(unix))]
pub(super) fn thread_time() -> Duration {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_stage_waits_for_is_not_its_work() {
        let clock = Clock::new("sleeper", true);
        let pause = Duration::from_millis(20);
        clock.stage(|| {
            clock.wait(Wait::Input, || std::thread::sleep(pause));
            clock.wait(Wait::Output, || std::thread::sleep(pause));
        });
        clock.add_work(Duration::from_secs(1));
        let stats = clock.stats();
        assert!(stats.input_seconds >= 0.02 && stats.output_seconds >= 0.02);
        assert_eq!(stats.memory_seconds, 0.0);
        let parts = stats.busy_seconds + stats.input_seconds + stats.output_seconds;
        assert!((parts - stats.seconds).abs() < 1e-9);
        assert!((1.0..1.02).contains(&stats.cpu_seconds), "{stats:?}");
    }

    #[test]
    fn a_clock_that_is_off_stands_still() {
        let clock = Clock::new("off", false);
        clock.stage(|| clock.wait(Wait::Memory, || ()));
        let still = Clock::new("off", false).stats();
        assert_eq!(clock.stats(), still);
    }
}
