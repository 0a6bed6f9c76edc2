//! What a run leaves: the surfel table, curvature slices, totals.
//!
//! Comes in: [`SurfelBatch`]es, rows of consecutive surfels in Khalimsky order (kz, then ky, then
//! kx), each within one *column* of parts. Goes out: files. Every sink
//! receives the same batches in the same order whatever the bricks, threads and budget, but the
//! batches may be cut anywhere: a sink must not let the cut of the batches show in its bytes.

mod batch;

pub use batch::{CurvatureColumns, Flag, FlagSet, SurfelBatch};
