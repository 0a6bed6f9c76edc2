//! What the stages of a run share: settings, the pool, the budget, progress and the stop flags.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::ThreadPool;

use crate::lattice::Lattice;
use crate::volume::ValueType;

use super::budget::Budget;
use super::plan::{Plan, omega_bytes};
use super::scratch::{Needs, Scratch};
use super::settings::{Kernels, Settings};

/// How far a run is; read it from any thread.
#[derive(Debug, Default)]
pub struct Progress {
    /// Planes read and packed.
    pub planes_read: AtomicU64,
    /// Surfels found.
    pub surfels_found: AtomicU64,
    /// Planes whose rows were handed to the sinks.
    pub planes_done: AtomicU64,
    /// Rows handed to the sinks.
    pub rows_done: AtomicU64,
    /// Whether to measure what the stages spend: [`super::Outcome::stats`].
    pub measured: bool,
}

/// What all stages share.
pub(super) struct Shared<'a> {
    pub(super) settings: &'a Settings,
    pub(super) lattice: &'a Lattice,
    /// How stored voxels become values.
    pub(super) values: ValueType,
    pub(super) kernels: &'a Kernels,
    pub(super) plan: &'a Plan,
    pub(super) pool: &'a ThreadPool,
    pub(super) budget: &'a Arc<Budget>,
    pub(super) scratch: &'a Scratch,
    pub(super) progress: &'a Progress,
    /// Set from outside to stop the run.
    pub(super) stop: &'a AtomicBool,
    /// Set by a stage that failed, so that stages that wait for memory wake up.
    pub(super) failed: &'a AtomicBool,
}

impl Shared<'_> {
    /// What the scratch memory of a brick depends on.
    pub(super) fn needs(&self) -> Needs<'_> {
        let lumped = self.kernels.balls.iter().all(|b| b.weights().are_lumped());
        Needs {
            normals: &self.kernels.normals,
            ball_reach: self.plan.ball_reach,
            lumped,
            invariants: !self.kernels.invariants.is_empty(),
            omega_bytes: omega_bytes(self.settings.quality, lumped),
            row_bytes: self.plan.row_bytes,
        }
    }

    /// Whether the run is to end early. Raises the flag that wakes stages that wait.
    pub(super) fn stopped(&self) -> bool {
        if self.stop.load(Ordering::Relaxed) {
            self.failed.store(true, Ordering::Relaxed);
        }
        self.failed.load(Ordering::Relaxed)
    }
}
