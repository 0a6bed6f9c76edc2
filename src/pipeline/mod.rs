//! The stages as threads, the channels between them, and the memory they may use.
//!
//! ```text
//!   reader ------> normals ------> cells ------> sums ------> sink
//!    planes of      surfels and u,  measures of   curvature     in order
//!    bits           slab by slab    cells         rows
//! ```
//!
//! Between normals and cells there is one more stage for each pass that refines normals, if any.
//!
//! Each arrow is a bounded channel that holds one message; each box is an OS thread that owns its
//! state and nothing else. Within a stage the bricks of a slab are spread over a rayon pool; no
//! worker of the pool ever waits on a channel. A stage waits for the slabs its reach asks for, so
//! a halo is what the neighbours computed, never computed again.
//!
//! **Stopping.** A stage that fails, or finds the stop flag set, returns; its channels close, the
//! stages above see a closed channel and return quietly, the stages below drain what they have.
//! The first error of the lowest stage in the order above is reported.
//!
//! **Memory.** A slab takes its surfels from a budget before it is computed and gives them back
//! when its last user drops it ([`budget`]). Slab heights adapt to the surface met; [`plan`]
//! derives the rest from the memory allowed. Workers wait for scratch memory alone, which they take for one brick, or a piece of
//! one, at a time (`scratch`). Nothing of it can show in the results.

mod access;
pub mod budget;
mod chunks;
mod given;
mod layers;
pub mod plan;
mod reader;
mod refining;
mod rows;
mod run;
mod scratch;
mod sending;
mod settings;
mod shared;
mod stages;
mod stats;

pub use access::{Access, Sparse};
pub use chunks::ChunkPlan;
pub use plan::{Plan, PlanError};
pub use reader::{ReadCounts, Source};
pub use run::{Outcome, run};
pub use settings::{NamedMethod, Settings};
pub use shared::Progress;
pub use stats::{MemoryStats, StageStats, Stats};
