//! Scratch memory of the workers: what a stage takes for a brick, and bricks in pieces where that is too much.
//!
//! What a brick takes depends on the surfels within its reach, which are few in nearly all bricks and, in noise, more than
//! one a voxel. So a brick asks for what it needs when it is its turn: surfels are counted where the
//! worst there can be ([`DENSE`]) is more than a worker's share. A brick that needs more is done in pieces of
//! fewer planes, each with its own halo; a single plane that still needs more waits until the others have given back enough.
//! [`super::plan`] sees to it that the worst plane of a brick fits.

use std::sync::Arc;

use crate::lattice::Lattice;
use crate::normal::NormalKernel;
use crate::surfel::{CellBox, SurfelIndex};
use crate::volume::{BitBox, PlaneWindow};

use super::budget::Budget;
use super::shared::Shared;

/// Bits and index of a box, for each 16 voxels.
const BOX_BYTES: u64 = 11;

/// Scratch for each surfel of a brick and its halo: place, links, measures, and the same in the order of blocks.
const SCRATCH_BYTES: u64 = 92 + FLOAT_BYTES + BLOCK_BYTES;

/// The same for surfels in the order of blocks: coordinates, steps, neighbours, components, tags, labels.
const BLOCK_BYTES: u64 = 84;

/// The same for the measures of a surfel as floating point numbers.
const FLOAT_BYTES: u64 = 64;

/// Scratch for each surfel of a brick whose sums are made, beside its row: its number, where it is put.
const SUMMED_BYTES: u64 = 16;

/// The same as [`SCRATCH_BYTES`] where linels and pointels are summed each for itself.
const CELL_SCRATCH_BYTES: u64 = 300;

/// Scratch for each surfel of a brick, and one cell around, whose measures are made.
const MEASURED_BYTES: u64 = 300;

/// Scratch for each surfel that a normal may look at.
const NORMAL_SCRATCH_BYTES: u64 = 50;

/// Scratch for each voxel of a brick whose integral invariants are taken, at worst.
const INVARIANT_SCRATCH_BYTES: u64 = 300;

/// Scratch for each surfel of a brick and its halo in a pass that refines normals: place, links, estimate, sample.
const REFINING_SCRATCH_BYTES: u64 = 170;

/// Surfels a voxel of the worst volumes: random noise has 1.5.
const DENSE: f64 = 1.6;

/// A stage that takes scratch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    Normals,
    /// A pass that refines normals, by its reach.
    Refining([i32; 3]),
    Cells,
    Sums,
}

/// What the scratch of a brick depends on beside its surfels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Needs<'a> {
    pub(super) normals: &'a NormalKernel,
    pub(super) ball_reach: [i32; 3],
    /// Whether measures are lumped on surfels.
    pub(super) lumped: bool,
    /// Whether curvatures are plain integral invariants.
    pub(super) invariants: bool,
    /// Bytes more for each surfel, of mu_Omega.
    pub(super) omega_bytes: u64,
    /// Bytes of a row.
    pub(super) row_bytes: u64,
}

impl Needs<'_> {
    /// Scratch of a stage for the cells `core`. `surfels` tells how many surfels a box has at most, which
    /// may extend beyond the volume.
    pub(super) fn bytes(
        &self,
        stage: Stage,
        core: CellBox,
        surfels: impl Fn(CellBox) -> u64,
    ) -> u64 {
        let grown = |reach: [i32; 3]| CellBox {
            lo: [0, 1, 2].map(|a| core.lo[a] - reach[a]),
            hi: [0, 1, 2].map(|a| core.hi[a] + reach[a]),
        };
        let volume = |cells: CellBox| cells.size().map(|n| n as u64).iter().product::<u64>();
        // of those that extract the surface around
        let extracted = |reach: [i32; 3], each: u64| {
            let around = grown(reach);
            surfels(around) * each + box_bytes(around)
        };
        match stage {
            Stage::Normals if self.normals.needs_grey() => {
                volume(grown(self.normals.reach())) * size_of::<f64>() as u64
                    + surfels(core) * NORMAL_SCRATCH_BYTES
            }
            Stage::Normals => {
                let by_blocks = matches!(self.normals, NormalKernel::Average(_));
                let each = NORMAL_SCRATCH_BYTES + if by_blocks { BLOCK_BYTES } else { 0 };
                (self.normals.scratch_bytes(core.size()))
                    .unwrap_or_else(|| extracted(self.normals.reach(), each))
            }
            Stage::Refining(reach) => extracted(reach, REFINING_SCRATCH_BYTES),
            Stage::Cells => extracted([1; 3], MEASURED_BYTES + self.omega_bytes),
            Stage::Sums if self.invariants => {
                // surfels of the core alone, and the bits around it
                let bits = volume(grown(self.ball_reach.map(|r| r + 64)));
                volume(grown([1; 3])) * INVARIANT_SCRATCH_BYTES + bits / 8
            }
            Stage::Sums => {
                let each = if self.lumped {
                    SCRATCH_BYTES
                } else {
                    CELL_SCRATCH_BYTES
                };
                extracted(self.ball_reach, each + self.omega_bytes)
                    + surfels(core) * (SUMMED_BYTES + self.row_bytes)
            }
        }
    }

    /// Whether what a stage takes depends on surfels more than on anything else.
    pub(super) fn by_surfels(&self, stage: Stage) -> bool {
        match stage {
            Stage::Normals => {
                !self.normals.needs_grey() && self.normals.scratch_bytes([1; 3]).is_none()
            }
            Stage::Sums => !self.invariants,
            Stage::Refining(_) | Stage::Cells => true,
        }
    }

    /// The most that a stage can take for a core of this size, whatever the volume.
    pub(super) fn most_bytes(&self, stage: Stage, size: [i32; 3], cell_dims: [i32; 3]) -> u64 {
        let core = CellBox {
            lo: [0; 3],
            hi: [0, 1, 2].map(|a| size[a].min(cell_dims[a])),
        };
        self.bytes(stage, core, |cells| at_most(cells, cell_dims))
    }
}

/// Bits and index of a box of cells.
fn box_bytes(cells: CellBox) -> u64 {
    cells.size().map(|n| n as u64).iter().product::<u64>() * BOX_BYTES / 16
}

/// Surfels of a box of cells, at most.
fn at_most(cells: CellBox, cell_dims: [i32; 3]) -> u64 {
    let size = cells.size();
    let held = (0..3).map(|a| f64::from(size[a].min(cell_dims[a])));
    (held.product::<f64>() * DENSE) as u64
}

/// The scratch memory of a run.
#[derive(Debug)]
pub(super) struct Scratch {
    budget: Arc<Budget>,
    /// What each worker may take while all of them work.
    share: u64,
}

impl Scratch {
    pub(super) fn new(bytes: u64, threads: usize) -> Self {
        Self {
            budget: Budget::new(bytes),
            share: bytes / threads.max(1) as u64,
        }
    }

    /// Calls `work` for pieces of `core`, from the lowest on, while there is memory for each; the whole
    /// core if it fits. The window must hold the bits within reach of the stage, and one more. Ends early if the run is stopped.
    pub(super) fn in_pieces(
        &self,
        shared: &Shared<'_>,
        window: &PlaneWindow,
        stage: Stage,
        core: CellBox,
        mut work: impl FnMut(CellBox),
    ) {
        let needs = shared.needs();
        let cell_dims = shared.lattice.cell_dims();
        let piece = |z: i32, height: i32| {
            let mut piece = core;
            piece.lo[2] = z;
            piece.hi[2] = (z + height).min(core.hi[2]);
            piece
        };
        let (mut z, mut height) = (core.lo[2], core.size()[2]);
        while z < core.hi[2] {
            let bytes = loop {
                let piece = piece(z, height);
                let most = needs.bytes(stage, piece, |cells| at_most(cells, cell_dims));
                if most <= self.share {
                    break most;
                }
                // Counting takes bits and an index.
                let around = needs.bytes(stage, piece, |_| 0);
                let Some(_counting) = self.budget.take(around, 0, || shared.stopped()) else {
                    return;
                };
                let counted = |cells| count(window, cells, shared.lattice);
                let bytes = needs.bytes(stage, piece, counted);
                if bytes <= self.share || height == 1 {
                    break bytes;
                }
                height = (height + 1) / 2;
            };
            let Some(_grant) = self.budget.take(bytes, 0, || shared.stopped()) else {
                return;
            };
            work(piece(z, height));
            z += height;
            height = (2 * height).min(core.hi[2] - z);
        }
    }
}

/// Surfels of a box of cells, which may extend beyond the volume.
fn count(window: &PlaneWindow, cells: CellBox, lattice: &Lattice) -> u64 {
    let cells = cells.grown([0; 3], lattice.cell_dims());
    let bits = BitBox::cut(window, cells.lo.map(|c| c - 1), cells.hi.map(|c| c + 1));
    SurfelIndex::find(&bits, cells, lattice).len() as u64
}
