//! A budget of bytes shared by the stages of a run.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Bytes that may be in use at once.
#[derive(Debug)]
pub struct Budget {
    limit: u64,
    used: Mutex<u64>,
    returned: Condvar,
}

/// Bytes taken from a budget; given back on drop.
#[derive(Debug)]
pub struct Grant {
    budget: Arc<Budget>,
    bytes: u64,
}

impl Budget {
    /// A budget of `limit` bytes.
    #[must_use]
    pub fn new(limit: u64) -> Arc<Self> {
        Arc::new(Self {
            limit,
            used: Mutex::new(0),
            returned: Condvar::new(),
        })
    }

    /// The bytes that may be in use at once.
    #[must_use]
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Takes bytes, waiting until they are there; `None` once `stopped` says so.
    ///
    /// The caller makes sure that enough of what is in use will be given back without this grant:
    /// see `stages::choose_slab`.
    pub fn take(self: &Arc<Self>, bytes: u64, stopped: impl Fn() -> bool) -> Option<Grant> {
        let mut used = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        while *used > 0 && *used + bytes > self.limit {
            if stopped() {
                return None;
            }
            // Woken by a grant given back; the time-out only bounds how long a stop goes unseen.
            let waited = self.returned.wait_timeout(used, Duration::from_millis(100));
            used = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        *used += bytes;
        Some(Grant {
            budget: Arc::clone(self),
            bytes,
        })
    }
}

impl Drop for Grant {
    fn drop(&mut self) {
        let mut used = self
            .budget
            .used
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        *used -= self.bytes;
        self.budget.returned.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_when_a_grant_is_dropped() {
        let budget = Budget::new(10);
        let first = budget.take(8, || false).unwrap();
        let waiting = std::thread::spawn({
            let budget = Arc::clone(&budget);
            move || budget.take(5, || false).map(|g| g.bytes)
        });
        std::thread::sleep(Duration::from_millis(20));
        assert!(!waiting.is_finished());
        drop(first);
        assert_eq!(waiting.join().unwrap(), Some(5));
    }

    #[test]
    fn a_stop_ends_the_wait() {
        let budget = Budget::new(10);
        let _first = budget.take(8, || false).unwrap();
        assert!(budget.take(5, || true).is_none());
    }
}
