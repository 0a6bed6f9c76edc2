//! What can stop a run.

use crate::lattice::LatticeError;
use crate::pipeline::PlanError;
use crate::sink::SinkError;

/// An error of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The input cannot be read, or is damaged.
    #[error(transparent)]
    Input(#[from] curvox_formats::Error),
    /// The results cannot be written.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// The extents, spacing or radii cannot be used.
    #[error(transparent)]
    Lattice(#[from] LatticeError),
    /// The memory allowed is too small.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The surface is too dense for the memory allowed.
    #[error(
        "the surface is too dense for the memory allowed: around plane {plane} {surfels} surfels \
         must be held at once, which takes about {} MiB with everything else; allow at least that with --memory (more \
         if it gets denser further on), or take a smaller radius",
        needed_bytes.div_ceil(1 << 20)
    )]
    TooDense {
        /// Plane of voxels where it was found.
        plane: i32,
        /// Surfels within reach of that plane.
        surfels: u64,
        /// Memory that would do as far as the volume was read.
        needed_bytes: u64,
    },
    /// The surface of a volume that is mostly uniform is too scattered for the memory allowed.
    #[error(
        "the surface is too scattered for the memory allowed: around plane {plane} {what}, which takes \
         about {} MiB with everything else; allow that with --memory",
        needed_bytes.div_ceil(1 << 20)
    )]
    TooScattered {
        /// Plane of voxels where it was found.
        plane: i32,
        /// What is too much there.
        what: String,
        /// Memory that would do.
        needed_bytes: u64,
    },
    /// The worker threads could not be started.
    #[error("cannot start worker threads: {0}")]
    Threads(String),
    /// The run was asked to stop.
    #[error("interrupted")]
    Stopped,
}
