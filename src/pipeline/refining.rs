//! The stages between normals and measures that refine normals, one for each pass.
//!
//! A pass wants the estimates of all surfels within its reach after the pass before, so each is a
//! stage with a window of slabs, as the sums are, and nothing is estimated twice. The surfels of a slab
//! are counted in its grant once, for all that the passes hold of them ([`super::plan`]).

use std::sync::Arc;

use crossbeam_channel::{Receiver, Sender};
use rayon::prelude::*;

use crate::brick::{BrickGrid, SlabWindow};
use crate::error::Error;
use crate::measure::cells::mark;
use crate::measure::surface::Surface;
use crate::normal::refine::{Estimate, RefineKernel, Refined, settled};
use crate::surfel::CellBox;
use crate::volume::PlaneWindow;

use super::scratch::Stage;
use super::shared::Shared;
use super::stages::{NormalBrick, NormalSlab, grid};
use super::stats::{Clock, Wait};

/// Pass `number` of `kernel` over all slabs.
pub(super) fn refine(
    shared: &Shared<'_>,
    clock: &Clock,
    kernel: &RefineKernel,
    number: usize,
    input: &Receiver<Arc<NormalSlab>>,
    out: &Sender<Arc<NormalSlab>>,
) -> Result<(), Error> {
    let grid = grid(shared);
    let depth = grid.cell_dims[2];
    // and the bits of one plane more
    let ahead = kernel.reach(number)[2] + 1;
    let mut window = SlabWindow::<NormalSlab>::default();
    let mut z = 0;
    while z < depth {
        let slab = loop {
            if let Some(slab) = window.starting_at(z)
                && window.end() >= (slab.z.end + ahead).min(depth)
            {
                break slab;
            }
            match clock.wait(Wait::Input, || input.recv()) {
                Ok(next) => window.push(next),
                Err(_) => return Err(Error::Stopped),
            }
        };
        let voxels = window.voxels(shared.lattice.dims);
        let bricks: Vec<Option<NormalBrick>> = shared.pool.install(|| {
            (0..slab.numbers.len())
                .into_par_iter()
                .map(|at| {
                    (!shared.stopped()).then(|| {
                        let around = (&grid, &window, &voxels);
                        clock.work(|| refine_brick(shared, kernel, number, around, &slab, at))
                    })
                })
                .collect()
        });
        let Some(bricks) = bricks.into_iter().collect() else {
            return Err(Error::Stopped);
        };
        let end = slab.z.end;
        tracing::debug!(
            from = z,
            to = end,
            pass = number,
            "slab has refined normals"
        );
        let refined = NormalSlab {
            z: slab.z.clone(),
            planes: slab.planes.clone(),
            numbers: slab.numbers.clone(),
            bricks,
            grant: Arc::clone(&slab.grant),
        };
        let refined = Arc::new(refined);
        if shared.stopped() || clock.wait(Wait::Output, || out.send(refined)).is_err() {
            return Err(Error::Stopped);
        }
        z = end;
        window.release_before(z - ahead);
    }
    Ok(())
}

fn refine_brick(
    shared: &Shared<'_>,
    kernel: &RefineKernel,
    number: usize,
    (grid, window, voxels): (&BrickGrid, &SlabWindow<NormalSlab>, &PlaneWindow),
    slab: &NormalSlab,
    at: usize,
) -> NormalBrick {
    let core = grid.core(slab.numbers[at], &slab.z);
    let brick = &slab.bricks[at];
    let is_last = number + 1 == kernel.passes();
    let first = brick.first.as_deref().unwrap_or(&brick.u);
    let mut marks = brick.marks.clone();
    let mut u = Vec::with_capacity(brick.u.len());
    let mut offsets = Vec::with_capacity(if is_last { 0 } else { brick.u.len() });
    let pass = |piece| {
        let around = (grid, window, voxels);
        for mut refined in refined_piece(shared, kernel, number, around, piece) {
            let (mark, first) = (&mut marks[u.len()], first[u.len()]);
            if refined.estimate.cut {
                *mark |= mark::CUT;
            }
            if *mark & mark::DEGENERATE != 0 {
                (refined.estimate.u, refined.estimate.offset) = (first, 0.0);
            }
            if is_last {
                u.push(settled(&refined, first));
            } else {
                u.push(refined.estimate.u);
                offsets.push(refined.estimate.offset);
            }
        }
    };
    let stage = Stage::Refining(kernel.reach(number));
    (shared.scratch).in_pieces(shared, voxels, stage, core, pass);
    let first = match &brick.first {
        _ if is_last => None,
        Some(first) => Some(Arc::clone(first)),
        None => Some(Arc::new(brick.u.clone())),
    };
    brick.with_normals(u, offsets, first, marks)
}

/// Estimates of the cells `core` of a brick after a pass.
fn refined_piece(
    shared: &Shared<'_>,
    kernel: &RefineKernel,
    number: usize,
    (grid, window, voxels): (&BrickGrid, &SlabWindow<NormalSlab>, &PlaneWindow),
    core: CellBox,
) -> Vec<Refined> {
    let around = core.grown(kernel.reach(number), grid.cell_dims);
    let surface = Surface::extract(voxels, around, shared.lattice, shared.settings.adjacency);
    let mut estimates = Vec::with_capacity(surface.len());
    let occupied = |kind, y, z| surface.index.has_any(kind, y, z);
    window.for_each_run(grid, around, occupied, |slab, at, run| {
        let from = &slab.bricks[at];
        estimates.extend(run.map(|i| Estimate {
            u: from.u[i],
            offset: from.offsets.get(i).copied().unwrap_or(0.0),
            cut: from.marks[i] & mark::CUT != 0,
        }));
    });
    let starts: Vec<usize> = (0..surface.len())
        .filter(|&i| core.contains(surface.surfels.oriented(i).cell()))
        .collect();
    kernel.pass(number, &surface, &estimates, &starts)
}
