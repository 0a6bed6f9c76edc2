//! The stages between the reader and the sinks: each a loop over slabs, bricks in parallel.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crossbeam_channel::{Receiver, Sender};
use glam::DVec3;
use rayon::prelude::*;

use crate::brick::{BrickGrid, Slab, SlabWindow};
use crate::curvature::Method;
use crate::error::Error;
use crate::measure;
use crate::measure::ball::LocalMeasures;
use crate::measure::cells::{Asked, CellMeasures, CellTotals, Keep, mark};
use crate::measure::surface::Surface;
use crate::normal::Around;
use crate::normal::gradient::Sides;
use crate::surfel::{CellBox, SurfelIndex, Surfels};
use crate::volume::{BitBox, BitPlane, GreyWindow, PlaneWindow, SolidCounts};

use super::budget::Grant;
use super::given;
use super::reader::Plane;
use super::rows::{BrickRows, Own};
use super::scratch::Stage;
use super::sending::{Rows, columns_of, send_plane};
use super::shared::Shared;
use super::stats::{Clock, Wait};

/// Surfels of a brick and their normals.
#[derive(Debug)]
pub(super) struct NormalBrick {
    pub(super) index: Arc<SurfelIndex>,
    pub(super) u: Vec<DVec3>,
    pub(super) marks: Vec<u8>,
    /// While normals are refined: where the surface crosses the segments of the surfels, none before the
    /// first pass.
    pub(super) offsets: Vec<f64>,
    /// While normals are refined: those before the first pass, once they differ from `u`.
    pub(super) first: Option<Arc<Vec<DVec3>>>,
    sides: Sides,
}

impl NormalBrick {
    /// The same surfels with other normals.
    pub(super) fn with_normals(
        &self,
        u: Vec<DVec3>,
        offsets: Vec<f64>,
        first: Option<Arc<Vec<DVec3>>>,
        marks: Vec<u8>,
    ) -> Self {
        Self {
            index: Arc::clone(&self.index),
            u,
            marks,
            offsets,
            first,
            sides: Sides::default(),
        }
    }
}

/// A slab with normals.
#[derive(Debug)]
pub(super) struct NormalSlab {
    pub(super) z: Range<i32>,
    pub(super) planes: Vec<Arc<BitPlane>>,
    /// Numbers of the bricks with surfels.
    pub(super) numbers: Vec<usize>,
    pub(super) bricks: Vec<NormalBrick>,
    /// Shared by all that hold something of these surfels.
    pub(super) grant: Arc<Grant>,
}

/// A slab with measures of its cells.
#[derive(Debug)]
pub(super) struct MeasureSlab {
    normals: Arc<NormalSlab>,
    /// Of the same bricks.
    measures: Vec<CellMeasures>,
}

impl Slab for NormalSlab {
    fn z(&self) -> Range<i32> {
        self.z.clone()
    }

    fn numbers(&self) -> &[usize] {
        &self.numbers
    }

    fn index(&self, at: usize) -> &SurfelIndex {
        &self.bricks[at].index
    }

    fn planes(&self) -> &[Arc<BitPlane>] {
        &self.planes
    }
}

impl Slab for MeasureSlab {
    fn z(&self) -> Range<i32> {
        self.normals.z()
    }

    fn numbers(&self) -> &[usize] {
        self.normals.numbers()
    }

    fn index(&self, at: usize) -> &SurfelIndex {
        self.normals.index(at)
    }

    fn planes(&self) -> &[Arc<BitPlane>] {
        self.normals.planes()
    }
}

pub(super) fn grid(shared: &Shared<'_>) -> BrickGrid {
    BrickGrid {
        cell_dims: shared.lattice.cell_dims(),
        edge: shared.plan.brick_edge,
    }
}

/// Planes that have arrived and are still needed.
struct Arrived<'a> {
    shared: &'a Shared<'a>,
    clock: &'a Clock,
    input: &'a Receiver<Vec<Plane>>,
    window: PlaneWindow,
    /// The same planes as stored, if the normals ask for values.
    grey: Option<GreyWindow>,
    /// Surfels of each plane of cells from `counted_from` on.
    counts: VecDeque<u64>,
    counted_from: i32,
    done: bool,
}

impl Arrived<'_> {
    fn end(&self) -> i32 {
        self.window.z0 + self.window.planes.len() as i32
    }

    /// Waits until the planes before `z` are here, or the volume has ended.
    fn wait_for(&mut self, z: i32) -> Result<(), Error> {
        let depth = self.window.dims[2] as i32;
        while self.end() < z.min(depth) {
            let Ok(planes) = self.clock.wait(Wait::Input, || self.input.recv()) else {
                return Err(Error::Stopped);
            };
            let before = self.end();
            for plane in planes {
                self.window.planes.push(plane.bits);
                if let Some(grey) = &mut self.grey {
                    grey.planes.extend(plane.stored);
                }
            }
            self.count(before..self.end());
        }
        let cells = self.shared.lattice.cell_dims()[2];
        if self.end() == depth && !self.done {
            self.done = true;
            self.count(depth..cells);
        }
        Ok(())
    }

    fn count(&mut self, planes: Range<i32>) {
        let (window, lattice, clock) = (&self.window, self.shared.lattice, self.clock);
        let counts: Vec<u64> = self.shared.pool.install(|| {
            planes
                .into_par_iter()
                .map(|z| clock.work(|| SurfelIndex::count_plane(window, z, lattice)))
                .collect()
        });
        self.counts.extend(counts);
    }

    /// Memory of the planes from `z` on.
    fn bytes_from(&self, z: i32) -> u64 {
        let from = (z - self.window.z0).clamp(0, self.window.planes.len() as i32);
        held_bytes(&self.window.planes[from as usize..])
    }

    /// Surfels of planes of cells, as far as they have arrived.
    fn surfels(&self, z: Range<i32>) -> u64 {
        let from = (z.start - self.counted_from).max(0) as usize;
        let to = (z.end - self.counted_from).max(0) as usize;
        let to = to.min(self.counts.len());
        self.counts.range(from.min(to)..to).sum()
    }

    /// The same, and as many in each plane that has not arrived as in the densest that has.
    fn expected(&self, z: Range<i32>) -> u64 {
        let end = self.counted_from + self.counts.len() as i32;
        let missing = (z.end - end.max(z.start)).max(0) as u64;
        let densest = self.counts.iter().max().copied().unwrap_or(0);
        self.surfels(z) + missing * densest
    }

    fn release_before(&mut self, planes: i32, counts: i32) {
        let drop = (planes - self.window.z0).clamp(0, self.window.planes.len() as i32);
        self.window.planes.drain(..drop as usize);
        self.window.z0 += drop;
        if let Some(grey) = &mut self.grey {
            grey.planes.drain(..drop as usize);
            grey.z0 += drop;
        }
        while self.counted_from < counts && !self.counts.is_empty() {
            self.counts.pop_front();
            self.counted_from += 1;
        }
    }
}

/// Memory of planes; those without a voxel inside are one.
fn held_bytes(planes: &[Arc<BitPlane>]) -> u64 {
    let held = planes.iter().filter(|plane| !plane.is_outside());
    held.map(|plane| plane.bytes() as u64).sum()
}

/// What the stage of the normals counts on the way.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    pub(super) solid: SolidCounts,
    /// Rows of a table of normals that belong to no surfel.
    pub(super) unmatched_normals: u64,
    /// The values on either side of the surfels, for normals made of values.
    pub(super) sides: Sides,
}

/// Second stage: extracts the surfels of each slab and estimates their normals.
pub(super) fn normals(
    shared: &Shared<'_>,
    clock: &Clock,
    input: &Receiver<Vec<Plane>>,
    out: &Sender<Arc<NormalSlab>>,
) -> Result<Found, Error> {
    let grid = grid(shared);
    let dims = shared.lattice.dims;
    let depth = grid.cell_dims[2];
    let reach = shared.kernels.normals.reach()[2] + 1;
    let mut arrived = Arrived {
        shared,
        clock,
        input,
        window: PlaneWindow {
            dims,
            z0: 0,
            planes: Vec::new(),
        },
        grey: shared.kernels.normals.needs_grey().then(|| GreyWindow {
            dims,
            z0: 0,
            values: shared.values,
            planes: Vec::new(),
        }),
        counts: VecDeque::new(),
        counted_from: 0,
        done: false,
    };
    // Grey planes are large; beyond what is needed of them, surfels are guessed.
    let ahead = reach.max(if arrived.grey.is_some() {
        shared.plan.planes_ahead()
    } else {
        shared.plan.planes_until_release()
    });
    let mut slabs: VecDeque<Chosen> = VecDeque::new();
    let mut indices = Indices::default();
    let mut found = Found::default();
    let mut z = 0;
    while z < depth {
        arrived.wait_for(z + shared.plan.slab_planes + ahead)?;
        let chosen = choose_slab(shared, &grid, &arrived, &mut slabs, &indices, z)?;
        let (end, surfels) = (chosen.z.end, chosen.surfels);
        let bytes = chosen.bytes(shared);
        let taken = clock.wait(Wait::Memory, || {
            let surfel_bytes = bytes - chosen.extra_bytes;
            (shared.budget).take(bytes, surfel_bytes, || shared.stopped())
        });
        let Some(mut grant) = taken else {
            return Err(Error::Stopped);
        };
        let window = &arrived.window;
        let numbers = grid.occupied(window, z..end, shared.lattice.closed);
        let given = given::of_slab(shared, window, &grid, z..end, &numbers, surfels)?;
        let (given, unmatched) = given.unzip();
        found.unmatched_normals += unmatched.unwrap_or(0);
        let around = Around {
            bits: window,
            grey: arrived.grey.as_ref(),
            given: given.as_ref(),
        };
        let (numbers, bricks): (Vec<usize>, Vec<NormalBrick>) = shared.pool.install(|| {
            numbers
                .into_par_iter()
                .filter_map(|number| {
                    let core = grid.core(number, &(z..end));
                    let brick = clock.work(|| normal_brick(shared, &around, core))?;
                    Some((number, brick))
                })
                .unzip()
        });
        bricks.iter().for_each(|b| found.sides.join(&b.sides));
        indices.add(shared, z..end, &bricks)?;
        // Blocks of voxels end one plane above the image.
        let blocks = z..if end == depth {
            dims[2] as i32 + 1
        } else {
            end
        };
        let counted: Vec<SolidCounts> = shared.pool.install(|| {
            blocks
                .into_par_iter()
                .map(|z| clock.work(|| SolidCounts::of_plane(window, z)))
                .collect()
        });
        counted.iter().for_each(|c| found.solid.add(c));
        shared
            .progress
            .surfels_found
            .fetch_add(surfels, Ordering::Relaxed);
        let planes = window.narrowed(z..end).planes;
        let index = bricks.iter().map(|brick| brick.index.bytes() as u64);
        grant.note_beside(
            held_bytes(&planes) + index.sum::<u64>(),
            arrived.bytes_from(end),
        );
        tracing::debug!(from = z, to = end, surfels, "slab has normals");
        let slab = NormalSlab {
            z: z..end,
            planes,
            numbers,
            bricks,
            grant: Arc::new(grant),
        };
        let slab = Arc::new(slab);
        if shared.stopped() || clock.wait(Wait::Output, || out.send(slab)).is_err() {
            return Err(Error::Stopped);
        }
        slabs.push_back(chosen);
        z = end;
        arrived.release_before(z - reach - 1, slabs.front().map_or(z, |s| s.z.start));
    }
    // The reader has more to say only if it fails; its channel closes when it is done.
    Ok(found)
}

/// Memory of the indices of slabs, where only a part of what it can be at worst was planned.
#[derive(Debug, Default)]
struct Indices {
    /// Of slabs that may be held: planes, bricks with surfels, bytes of their indices.
    slabs: VecDeque<(Range<i32>, usize, u64)>,
}

impl Indices {
    fn bytes(&self) -> u64 {
        self.slabs.iter().map(|s| s.2).sum()
    }

    /// How many of the slabs are surely let go before the next one is computed.
    fn released(&self, shared: &Shared<'_>) -> usize {
        let oldest = (self.slabs.len() + 1).saturating_sub(shared.plan.slabs_in_flight() as usize);
        let Some(slab) = self.slabs.get(oldest) else {
            return 0;
        };
        let from = slab.0.start - 2 * (shared.plan.ball_reach[2] + shared.plan.refining_ahead());
        self.slabs.partition_point(|s| s.0.end <= from)
    }

    /// Whether a slab of planes `z` fits, if every brick that can have surfels has some.
    fn have_room(
        &self,
        shared: &Shared<'_>,
        grid: &BrickGrid,
        window: &PlaneWindow,
        z: Range<i32>,
    ) -> bool {
        let Some(room) = shared.plan.index_bytes() else {
            return true;
        };
        let size = [grid.edge, grid.edge, z.end - z.start];
        let bricks = grid.occupied(window, z, shared.lattice.closed).len() as u64;
        let held: u64 = self.slabs.range(self.released(shared)..).map(|s| s.2).sum();
        held + bricks * SurfelIndex::most_bytes(size) <= room
    }

    /// Adds a slab; refuses it if those that may be held with it are too large together.
    fn add(
        &mut self,
        shared: &Shared<'_>,
        z: Range<i32>,
        bricks: &[NormalBrick],
    ) -> Result<(), Error> {
        let plan = shared.plan;
        let Some(room) = plan.index_bytes() else {
            return Ok(());
        };
        self.slabs.drain(..self.released(shared));
        let plane = z.start;
        let bytes = bricks.iter().map(|brick| brick.index.bytes() as u64).sum();
        self.slabs.push_back((z, bricks.len(), bytes));
        let held = self.bytes();
        if held <= room {
            return Ok(());
        }
        let bricks: usize = self.slabs.iter().map(|s| s.1).sum();
        Err(Error::TooScattered {
            plane,
            what: format!("{bricks} bricks have surfels that must be held at once"),
            // A quarter of what the surfels are given is for indices, and half of what is added
            // goes to bits and scratch at most.
            needed_bytes: plan.memory_bytes + 8 * (held - room),
        })
    }
}

/// A slab that was chosen.
#[derive(Clone, Debug)]
struct Chosen {
    z: Range<i32>,
    surfels: u64,
    /// What its bits and indices take beyond those of slabs of one plane, which have memory of their own.
    extra_bytes: u64,
}

impl Chosen {
    fn bytes(&self, shared: &Shared<'_>) -> u64 {
        self.surfels * shared.plan.surfel_bytes + self.extra_bytes
    }
}

/// Chooses the slab that begins at plane `z`, and counts its surfels.
///
/// While this slab waits for memory, the stages below go on as far as the slabs before it let
/// them: each of them works on a slab once the stage before has done the planes that it looks ahead
/// ([`Plan::looks_ahead`]), and holds as many below. What is still held then, with the
/// slab itself, must fit the budget; then waiting always ends. A slab of several planes is only
/// chosen if the planes that must follow before *it* can be let go would fit too (with grey values those of them that have not
/// arrived are guessed, so there a slab can be too high for what comes); with it come its bits and indices, for
/// which nothing else is set aside ([`Plan::bits_bytes`]).
fn choose_slab(
    shared: &Shared<'_>,
    grid: &BrickGrid,
    arrived: &Arrived<'_>,
    slabs: &mut VecDeque<Chosen>,
    indices: &Indices,
    z: i32,
) -> Result<Chosen, Error> {
    let depth = shared.lattice.cell_dims()[2];
    let (mut done, mut lowest) = (z, z);
    for ahead in shared.plan.looks_ahead() {
        let waits = slabs.iter().find(|s| s.z.end + ahead > done);
        done = waits.map_or(done, |s| s.z.start);
        let held = slabs.iter().find(|s| s.z.end > done - ahead);
        lowest = lowest.min(held.map_or(z, |s| s.z.start));
    }
    while slabs.front().is_some_and(|s| s.z.end <= lowest) {
        slabs.pop_front();
    }
    let held: u64 = slabs.iter().map(|slab| slab.bytes(shared)).sum();
    let plan = shared.plan;
    let (room, room_of_rows) = (shared.budget.limit(), plan.surfel_budget_bytes / 4);
    let mut height = plan.slab_planes.min(depth - z);
    loop {
        let end = z + height;
        let slab = Chosen {
            z: z..end,
            surfels: arrived.surfels(z..end),
            extra_bytes: if height > 1 {
                extra_bytes(shared, grid, arrived, z..end)
            } else {
                0
            },
        };
        let densest = (z..end)
            .map(|z| arrived.surfels(z..z + 1))
            .max()
            .unwrap_or(0);
        let rows = slab.surfels * plan.row_bytes + densest * plan.sent_row_bytes;
        let bytes = held + slab.bytes(shared);
        let follow = arrived.expected(end..(end + plan.planes_until_release()).min(depth));
        let fits = bytes <= room && rows <= room_of_rows;
        let may_be_higher = || {
            bytes + follow * plan.surfel_bytes <= room
                && indices.have_room(shared, grid, &arrived.window, z..end)
        };
        if fits && (height == 1 || may_be_higher()) {
            return Ok(slab);
        }
        if height == 1 {
            // A larger plan spends part of what is added on bits and scratch: at most 5/8.
            let more =
                (bytes.saturating_sub(room) * 4 / 3).max(rows.saturating_sub(room_of_rows) * 4);
            return Err(Error::TooDense {
                plane: z,
                surfels: slabs.iter().map(|s| s.surfels).sum::<u64>() + slab.surfels,
                needed_bytes: plan.memory_bytes + 3 * more,
            });
        }
        height /= 2;
    }
}

/// Bits and indices of a slab of planes `z`, if every brick that can have surfels has some; 0 where they are planned
/// for the whole volume.
fn extra_bytes(shared: &Shared<'_>, grid: &BrickGrid, arrived: &Arrived<'_>, z: Range<i32>) -> u64 {
    if shared.plan.index_bytes().is_some() {
        return 0;
    }
    let window = &arrived.window;
    let size = [grid.edge, grid.edge, z.end - z.start];
    let bricks = grid
        .occupied(window, z.clone(), shared.lattice.closed)
        .len() as u64;
    held_bytes(&window.narrowed(z).planes) + bricks * SurfelIndex::most_bytes(size)
}

/// The brick of these cells; `None` if it has no surfel, or nobody wants to know any more.
fn normal_brick(shared: &Shared<'_>, around: &Around<'_>, core: CellBox) -> Option<NormalBrick> {
    let bits = BitBox::cut(around.bits, core.lo.map(|c| c - 1), core.hi.map(|c| c + 1));
    let index = SurfelIndex::find(&bits, core, shared.lattice);
    if index.is_empty() || shared.stopped() {
        return None;
    }
    let mut brick = NormalBrick {
        u: Vec::with_capacity(index.len()),
        marks: Vec::with_capacity(index.len()),
        offsets: Vec::new(),
        first: None,
        sides: Sides::default(),
        index: Arc::new(index),
    };
    let estimate = |piece: CellBox| {
        let surfels = if piece == core {
            Surfels::list(&brick.index, &bits)
        } else {
            Surfels::list(&SurfelIndex::find(&bits, piece, shared.lattice), &bits)
        };
        let kernel = &shared.kernels.normals;
        let normals = kernel.estimate(around, shared.lattice, piece, &surfels);
        brick.u.extend(normals.u);
        let marks = normals.degenerate.iter().zip(&normals.cut);
        brick.marks.extend(marks.map(|(&degenerate, &cut)| {
            (if degenerate { mark::DEGENERATE } else { 0 }) | (if cut { mark::CUT } else { 0 })
        }));
        brick.sides.join(&normals.sides);
    };
    (shared.scratch).in_pieces(shared, around.bits, Stage::Normals, core, estimate);
    Some(brick)
}

/// What of the cells is evaluated, and how it is kept.
fn asked(shared: &Shared<'_>) -> Asked {
    let settings = shared.settings;
    Asked {
        field: settings.field,
        keep: if shared.kernels.balls.is_empty() {
            Keep::Lumped
        } else {
            settings.weights.keep(settings.field)
        },
        quality: settings.quality,
    }
}

/// Third stage: measures of cells, with the normals of the surfels around.
pub(super) fn cells(
    shared: &Shared<'_>,
    clock: &Clock,
    input: &Receiver<Arc<NormalSlab>>,
    out: &Sender<MeasureSlab>,
) -> Result<CellTotals, Error> {
    let grid = grid(shared);
    let depth = grid.cell_dims[2];
    let mut window = SlabWindow::<NormalSlab>::default();
    let mut totals = CellTotals::default();
    let mut z = 0;
    while z < depth {
        let slab = loop {
            // The surface of the core and one cell around needs the bits of one plane more.
            if let Some(slab) = window.starting_at(z)
                && window.end() >= (slab.z.end + 2).min(depth)
            {
                break slab;
            }
            match clock.wait(Wait::Input, || input.recv()) {
                Ok(next) => window.push(next),
                Err(_) => return Err(Error::Stopped),
            }
        };
        let voxels = window.voxels(shared.lattice.dims);
        let evaluated: Vec<(CellMeasures, CellTotals)> = shared.pool.install(|| {
            (slab.numbers.par_iter())
                .map(|&number| {
                    if shared.stopped() {
                        return Default::default();
                    }
                    let core = grid.core(number, &slab.z);
                    clock.work(|| measure_brick(shared, &grid, &window, &voxels, core))
                })
                .collect()
        });
        let mut measures = Vec::with_capacity(evaluated.len());
        for (brick, of_brick) in evaluated {
            totals.add(&of_brick);
            measures.push(brick);
        }
        let end = slab.z.end;
        tracing::debug!(from = z, to = end, "slab has measures");
        let slab = MeasureSlab {
            normals: slab,
            measures,
        };
        if shared.stopped() || clock.wait(Wait::Output, || out.send(slab)).is_err() {
            return Err(Error::Stopped);
        }
        z = end;
        window.release_before(z - 2);
    }
    Ok(totals)
}

fn measure_brick(
    shared: &Shared<'_>,
    grid: &BrickGrid,
    window: &SlabWindow<NormalSlab>,
    voxels: &PlaneWindow,
    core: CellBox,
) -> (CellMeasures, CellTotals) {
    let (mut measures, mut totals) = (CellMeasures::default(), CellTotals::default());
    let evaluate = |piece| {
        let (of_piece, totals_of_piece) = measure_piece(shared, grid, window, voxels, piece);
        totals.add(&totals_of_piece);
        measures.append(of_piece);
    };
    (shared.scratch).in_pieces(shared, voxels, Stage::Cells, core, evaluate);
    (measures, totals)
}

fn measure_piece(
    shared: &Shared<'_>,
    grid: &BrickGrid,
    window: &SlabWindow<NormalSlab>,
    voxels: &PlaneWindow,
    core: CellBox,
) -> (CellMeasures, CellTotals) {
    let around = core.grown([1; 3], grid.cell_dims);
    let surface = Surface::extract(voxels, around, shared.lattice, shared.settings.adjacency);
    let mut u = Vec::with_capacity(surface.len());
    let mut marks = Vec::with_capacity(surface.len());
    let occupied = |kind, y, z| surface.index.has_any(kind, y, z);
    window.for_each_run(grid, around, occupied, |slab, at, run| {
        u.extend_from_slice(&slab.bricks[at].u[run.clone()]);
        marks.extend_from_slice(&slab.bricks[at].marks[run]);
    });
    assert_eq!(
        u.len(),
        surface.len(),
        "bricks and their union have the same surfels"
    );
    measure::evaluate(
        &surface,
        core,
        shared.lattice.edges(),
        &u,
        &marks,
        asked(shared),
    )
}

/// Fourth stage: sums over balls, curvatures, rows.
pub(super) fn sums(
    shared: &Shared<'_>,
    clock: &Clock,
    input: &Receiver<MeasureSlab>,
    out: &Sender<Rows>,
) -> Result<(), Error> {
    let grid = grid(shared);
    let depth = grid.cell_dims[2];
    let reach = shared.plan.ball_reach[2];
    let mut window = SlabWindow::<MeasureSlab>::default();
    let mut z = 0;
    while z < depth {
        let slab = loop {
            if let Some(slab) = window.starting_at(z)
                && window.end() >= (slab.z().end + reach + 1).min(depth)
            {
                break slab;
            }
            match clock.wait(Wait::Input, || input.recv()) {
                Ok(next) => window.push(Arc::new(next)),
                Err(_) => return Err(Error::Stopped),
            }
        };
        let voxels = window.voxels(shared.lattice.dims);
        let rows: Vec<BrickRows> = shared.pool.install(|| {
            (0..slab.numbers().len())
                .into_par_iter()
                .map(|at| {
                    if shared.stopped() {
                        return BrickRows::default();
                    }
                    clock.work(|| row_brick(shared, &grid, &window, &voxels, &slab, at))
                })
                .collect()
        });
        if shared.stopped() {
            return Err(Error::Stopped);
        }
        let columns = columns_of(shared, &grid, slab.numbers());
        for plane in slab.z() {
            if send_plane(shared, &grid, &window, &rows, &columns, plane, clock, out).is_err() {
                return Err(Error::Stopped);
            }
        }
        tracing::debug!(from = z, to = slab.z().end, "slab has curvatures");
        z = slab.z().end;
        window.release_before(z - reach - 1);
    }
    Ok(())
}

fn row_brick(
    shared: &Shared<'_>,
    grid: &BrickGrid,
    window: &SlabWindow<MeasureSlab>,
    voxels: &PlaneWindow,
    slab: &MeasureSlab,
    at: usize,
) -> BrickRows {
    let core = grid.core(slab.numbers()[at], &slab.z());
    let mut rows = BrickRows::default();
    let compute = |piece| rows.append(row_piece(shared, grid, window, voxels, slab, at, piece));
    (shared.scratch).in_pieces(shared, voxels, Stage::Sums, core, compute);
    rows
}

/// Rows of the cells `core` of a brick, which are some of its planes.
fn row_piece(
    shared: &Shared<'_>,
    grid: &BrickGrid,
    window: &SlabWindow<MeasureSlab>,
    voxels: &PlaneWindow,
    slab: &MeasureSlab,
    at: usize,
    core: CellBox,
) -> BrickRows {
    let brick = &slab.normals.bricks[at];
    let own = Own {
        u: &brick.u,
        measures: &slab.measures[at],
        surfels: brick.index.planes(core.lo[2]..core.hi[2]),
    };
    if shared.settings.curvature == Method::Invariants {
        let bits = BitBox::cut(voxels, core.lo.map(|c| c - 1), core.hi.map(|c| c + 1));
        let surfels = Surfels::list(&SurfelIndex::find(&bits, core, shared.lattice), &bits);
        return BrickRows::by_invariants(shared, voxels, core, &surfels, &own);
    }
    let around = core.grown(shared.plan.ball_reach, grid.cell_dims);
    let surface = Surface::extract(voxels, around, shared.lattice, shared.settings.adjacency);
    let mut gathered = CellMeasures::default();
    let by_cells = asked(shared).keep == Keep::Cells;
    if by_cells {
        gathered.owned_from.push([0, 0]);
    }
    let occupied = |kind, y, z| surface.index.has_any(kind, y, z);
    window.for_each_run(grid, around, occupied, |slab, at, run| {
        let from = &slab.measures[at];
        gathered.marks.extend_from_slice(&from.marks[run.clone()]);
        if by_cells {
            gathered.mu0.extend_from_slice(&from.mu0[run.clone()]);
            let [linels, umbrellas] = [0, 1].map(|i| {
                from.owned_from[run.start][i] as usize..from.owned_from[run.end][i] as usize
            });
            let shift = [
                (gathered.linels.len() as u32).wrapping_sub(linels.start as u32),
                (gathered.umbrellas.len() as u32).wrapping_sub(umbrellas.start as u32),
            ];
            gathered.owned_from.extend(
                from.owned_from[run.start + 1..=run.end]
                    .iter()
                    .map(|n| [n[0].wrapping_add(shift[0]), n[1].wrapping_add(shift[1])]),
            );
            if shared.settings.quality {
                gathered
                    .omega
                    .extend_from_slice(&from.omega[linels.clone()]);
            }
            gathered.linels.extend_from_slice(&from.linels[linels]);
            gathered
                .umbrellas
                .extend_from_slice(&from.umbrellas[umbrellas]);
        } else {
            if shared.settings.quality {
                gathered.omega.extend_from_slice(&from.omega[run.clone()]);
            }
            gathered.lumped.extend_from_slice(&from.lumped[run]);
        }
    });
    let measures = LocalMeasures::new(&surface, gathered);
    BrickRows::compute(shared, &surface, &measures, core, &own)
}
