//! A budget of bytes shared by the stages of a run.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Bytes that may be in use at once.
#[derive(Debug)]
pub struct Budget {
    limit: u64,
    used: Mutex<Used>,
    returned: Condvar,
}

#[derive(Debug, Default)]
struct Used {
    /// All that was taken.
    bytes: u64,
    /// Of these, what is for surfels.
    surfel_bytes: u64,
    /// At most until now.
    most_surfel_bytes: u64,
    /// What is held as long as the grants, and not taken from the budget.
    beside_bytes: u64,
    most_beside_bytes: u64,
}

/// Bytes taken from a budget; given back on drop.
#[derive(Debug)]
pub struct Grant {
    budget: Arc<Budget>,
    bytes: u64,
    surfel_bytes: u64,
    beside_bytes: u64,
}

impl Budget {
    /// A budget of `limit` bytes.
    #[must_use]
    pub fn new(limit: u64) -> Arc<Self> {
        Arc::new(Self {
            limit,
            used: Mutex::default(),
            returned: Condvar::new(),
        })
    }

    /// The bytes that may be in use at once.
    #[must_use]
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Takes bytes, waiting until they are there; `None` once `stopped` says so. `surfel_bytes` of them are for surfels, and counted by
    /// themselves.
    ///
    /// The caller makes sure that enough of what is in use will be given back without this grant:
    /// see `stages::choose_slab`.
    pub fn take(
        self: &Arc<Self>,
        bytes: u64,
        surfel_bytes: u64,
        stopped: impl Fn() -> bool,
    ) -> Option<Grant> {
        let mut used = self.used();
        while used.bytes > 0 && used.bytes + bytes > self.limit {
            if stopped() {
                return None;
            }
            // Woken by a grant given back; the time-out only bounds how long a stop goes unseen.
            let waited = self.returned.wait_timeout(used, Duration::from_millis(100));
            used = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        used.bytes += bytes;
        used.surfel_bytes += surfel_bytes;
        used.most_surfel_bytes = used.most_surfel_bytes.max(used.surfel_bytes);
        Some(Grant {
            budget: Arc::clone(self),
            bytes,
            surfel_bytes,
            beside_bytes: 0,
        })
    }

    /// The bytes that were in use at once, at most: for surfels, and beside the grants.
    #[must_use]
    pub fn most_used(&self) -> [u64; 2] {
        let used = self.used();
        [used.most_surfel_bytes, used.most_beside_bytes]
    }

    fn used(&self) -> MutexGuard<'_, Used> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Grant {
    /// Counts bytes that are held as long as the grant, beside the budget; `ahead_bytes` are
    /// held for now only.
    pub fn note_beside(&mut self, bytes: u64, ahead_bytes: u64) {
        self.beside_bytes += bytes;
        let mut used = self.budget.used();
        used.beside_bytes += bytes;
        let now = used.beside_bytes + ahead_bytes;
        used.most_beside_bytes = used.most_beside_bytes.max(now);
    }
}

impl Drop for Grant {
    fn drop(&mut self) {
        let mut used = self.budget.used();
        used.bytes -= self.bytes;
        used.surfel_bytes -= self.surfel_bytes;
        used.beside_bytes -= self.beside_bytes;
        self.budget.returned.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_when_a_grant_is_dropped() {
        let budget = Budget::new(10);
        let first = budget.take(8, 7, || false).unwrap();
        let waiting = std::thread::spawn({
            let budget = Arc::clone(&budget);
            move || budget.take(5, 5, || false).map(|g| g.bytes)
        });
        std::thread::sleep(Duration::from_millis(20));
        assert!(!waiting.is_finished());
        drop(first);
        assert_eq!(waiting.join().unwrap(), Some(5));
        assert_eq!(budget.most_used(), [7, 0]);
    }

    #[test]
    fn what_is_held_beside_goes_with_the_grant() {
        let budget = Budget::new(10);
        let mut first = budget.take(4, 4, || false).unwrap();
        first.note_beside(100, 7);
        drop(first);
        let mut second = budget.take(6, 6, || false).unwrap();
        second.note_beside(20, 0);
        assert_eq!(budget.most_used(), [6, 107]);
    }

    #[test]
    fn a_stop_ends_the_wait() {
        let budget = Budget::new(10);
        let _first = budget.take(8, 8, || false).unwrap();
        assert!(budget.take(5, 5, || true).is_none());
    }
}
