//! Derives slab heights, brick edges and budgets from the memory allowed.
//!
//! What is held at once, for planes of `A` voxels, slabs of `S` planes, `R` and `H` the reaches of
//! normals and sums along z:
//!
//! | what | size |
//! |---|---|
//! | program, sinks | [`FIXED_BYTES`], [`COLUMN_BYTES`] for each column of parts, what the open input holds |
//! | read buffers | three chunks of planes as stored, unless they are mapped; of a volume in pieces, a box and a piece for each task that reads ([`ChunkPlan`]) |
//! | bits, and the index of surfels | 1/8 byte a voxel of 2 R + 4 H + 15 + S planes, about 9/16 more (as if no brick were empty) of 2 H + 8 of them; what slabs of several planes take beyond that is taken from what is left for surfels |
//! | bits of a layer | the same 1/8 byte, for the planes that are read together because pieces are as thick |
//! | grey values | S + R + max(R, H + 3) + 2 planes as stored and three chunks of them, only for the gradient |
//! | a table of normals | its row groups and [`crate::sink::GIVEN_READ_BYTES`], only for given normals |
//! | surfels in flight | [`Plan::surfel_bytes`] each, within [`Plan::in_flight_bytes`] |
//! | rows | [`Plan::row_bytes`] a surfel of a slab, [`Plan::sent_row_bytes`] a surfel of its densest plane, within 1/4 of it |
//! | refined normals | [`Plan::refining_ahead`] planes more on either side of what is held, three slabs a pass, 24 bytes and 33 a pass for each surfel in flight |
//! | mu_Omega, if asked for | 8 bytes more a surfel in flight and of scratch (18 where linels are kept), 4 a row and radius |
//! | scratch of workers | what `scratch.rs` says of the worst brick of S planes, for each; a quarter of what is left for all at most, an eighth where bits take more than that, or what bits leave of 5/8 with a wide reach. At least the worst plane of a brick |
//!
//! The number of surfels is only known when they are met, so slabs adapt: a slab is lowered until
//! the surfels that must be held at once fit ([`Plan::surfel_budget_bytes`]); a surface that does
//! not fit with slabs of one plane stops the run with the memory it would need.
//!
//! Of a volume that is mostly uniform ([`Access::sparse`]), bits, grey values and columns of parts are
//! counted by the tiles in which voxels differ, which are known in advance. The index depends on
//! how the surface is scattered over bricks; it has a share of the memory and stops the run beyond that.

use serde::Serialize;

use crate::curvature::integral::InvariantKernel;
use crate::lattice::Lattice;
use crate::measure::ball::BallKernel;
use crate::normal::refine::RefineKernel;
use crate::normal::{NormalKernel, given};
use crate::sink::{NormalTable, Parts};
use crate::surfel::Surfels;

use super::access::{Access, Sparse};
use super::chunks::ChunkPlan;
use super::scratch::{Needs, Stage};

/// The program itself, its stacks, allocator slack and one open part.
pub const FIXED_BYTES: u64 = 56 << 20;

/// Buffers of each further column of parts that is open at the same time.
pub const COLUMN_BYTES: u64 = 24 << 20;

/// Memory of a surfel in flight for each pass that refines normals: u, offset, marks.
const REFINED_BYTES: u64 = 33;

/// Slabs held for each pass that refines normals beside those within its reach: cut by reach at either end, and one in
/// the channel.
const SLABS_A_PASS: u64 = 3;

/// Stored bytes read at a time; more only makes the buffer larger.
const READ_BYTES: u64 = 4 << 20;

/// Reaches of normals beyond this ask for wide bricks, however few there are.
const WIDE_REACH: i32 = 40;

/// Greatest heights of slabs that are tried; the first two only with a wide reach.
const HEIGHTS: [i32; 14] = [128, 96, 64, 48, 32, 24, 16, 12, 8, 6, 4, 3, 2, 1];

/// Edges of bricks that are tried.
const EDGES: [i32; 7] = [128, 96, 64, 48, 32, 24, 16];

/// Bricks of this edge may be few.
const NARROW_BRICK: i32 = 64;

/// Wider ones are so many a slab and worker, at least.
const BRICKS_A_THREAD: u64 = 4;

/// Slabs with an index held at once beside the planes within reach of the sums: three in the
/// window of the sums, which reach cuts anywhere, one in a channel, one measured and one it waits
/// for, one in a channel, one whose normals are made.
const SLABS_IN_FLIGHT: u64 = 8;

/// The same with passes that refine normals.
fn slabs_in_flight(passes: usize) -> u64 {
    SLABS_IN_FLIGHT + SLABS_A_PASS * passes as u64
}

/// Planes of rows on their way at once: one made, two in the channel, one in the sinks.
const SENT_PLANES: u64 = 4;

/// Memory of mu_Omega of a surfel, or of its linels, which are two on the average.
pub(super) fn omega_bytes(asked: bool, lumped: bool) -> u64 {
    match (asked, lumped) {
        (false, _) => 0,
        (true, true) => 8,
        (true, false) => 18,
    }
}

/// How a run will use its memory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// The memory allowed.
    pub memory_bytes: u64,
    /// Worker threads.
    pub threads: usize,
    /// Edge of a brick along x and y, in cells.
    pub brick_edge: i32,
    /// Greatest height of a slab, in planes.
    pub slab_planes: i32,
    /// Planes read at a time.
    pub read_planes: u64,
    /// Reach of the normals, in voxels.
    pub normal_reach: [i32; 3],
    /// Reaches of the passes that refine normals, in cells.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub refining_reach: Vec<[i32; 3]>,
    /// Reach of the sums or integral invariants, in cells: the halo of a brick.
    pub ball_reach: [i32; 3],
    /// Memory of bits and indices, with slabs of one plane.
    pub bits_bytes: u64,
    /// Memory of grey values; 0 unless normals are made from them.
    pub grey_bytes: u64,
    /// Memory of the read buffer.
    pub read_bytes: u64,
    /// Memory of the workers' scratch.
    pub scratch_bytes: u64,
    /// Memory of everything that does not depend on the volume, and of the sinks.
    pub fixed_bytes: u64,
    /// Memory left for surfels in flight, a quarter of it for the rows of a slab. Where surfels leave room, bits and
    /// indices of slabs of several planes share it.
    pub surfel_budget_bytes: u64,
    /// Memory of a surfel in flight.
    pub surfel_bytes: u64,
    /// Memory of a row of a slab, as computed.
    pub row_bytes: u64,
    /// Memory of a row of the densest plane, as handed to the sinks.
    pub sent_row_bytes: u64,
    /// Columns of parts that may be open at once.
    #[serde(skip)]
    pub open_columns: u64,
    /// How pieces are read, where voxels are stored in pieces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chunks: Option<ChunkPlan>,
}

/// Why there is no plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// The memory allowed is too small.
    #[error(
        "{} MiB of memory do not hold what a volume of {} x {} x {} voxels needs at these radii{}; \
         allow at least {} MiB with --memory",
        allowed_bytes >> 20, dims[0], dims[1], dims[2],
        if *grey { ", with the grey values of the planes within reach" } else { "" },
        needed_bytes.div_ceil(1 << 20)
    )]
    Memory {
        /// The memory allowed.
        allowed_bytes: u64,
        /// Memory that would do.
        needed_bytes: u64,
        /// Extents of the volume.
        dims: [u32; 3],
        /// Whether grey values are held.
        grey: bool,
    },
    /// A ball spans too many cells.
    #[error("the ball spans {0} voxels along an axis, expected at most {max}; use a smaller radius or resample flat voxels", max = Surfels::MAX_CELLS / 2)]
    Reach(i32),
    /// The brick edge cannot be used.
    #[error("brick edge of {0} voxels, expected 8 to 1024")]
    Brick(i32),
}

/// What a plan is made from.
#[derive(Clone, Copy, Debug)]
pub struct PlanRequest<'a> {
    /// The voxel grid.
    pub lattice: &'a Lattice,
    /// The normals.
    pub normals: &'a NormalKernel,
    /// The passes that refine them.
    pub refinement: Option<&'a RefineKernel>,
    /// The table of normals, if they are given.
    pub given: Option<&'a NormalTable>,
    /// The sums, one for each radius.
    pub balls: &'a [BallKernel],
    /// The plain integral invariants, one for each radius; then there are no sums.
    pub invariants: &'a [InvariantKernel],
    /// Whether directions are among the results.
    pub directions: bool,
    /// Whether errors to expect are among them.
    pub errors: bool,
    /// Whether mu_Omega is among them.
    pub quality: bool,
    /// Memory allowed.
    pub memory_bytes: u64,
    /// Further memory that the sinks hold during the whole run.
    pub sink_bytes: u64,
    /// Worker threads.
    pub threads: usize,
    /// Edge of bricks and greatest height of slabs, if they are to be fixed.
    pub brick: Option<i32>,
    /// How voxels can be read.
    pub access: &'a Access,
}

impl Plan {
    /// Planes that must follow a slab before its sums can be made: those within their reach, and two more for the
    /// measures of their cells.
    #[must_use]
    pub fn planes_ahead(&self) -> i32 {
        self.refining_ahead() + self.ball_reach[2] + 4
    }

    /// Planes that must follow a slab before it can be let go: it is within reach of the sums of others, too.
    #[must_use]
    pub fn planes_until_release(&self) -> i32 {
        self.planes_ahead() + self.refining_ahead() + self.ball_reach[2] + 1
    }

    /// Memory for surfels in flight, and for the bits and indices of high slabs: what the rows of a slab leave of
    /// [`Self::surfel_budget_bytes`].
    #[must_use]
    pub fn in_flight_bytes(&self) -> u64 {
        self.surfel_budget_bytes / 4 * 3
    }

    /// How many planes each stage below the normals looks ahead of a slab, and behind.
    pub(super) fn looks_ahead(&self) -> impl Iterator<Item = i32> {
        let refining = self.refining_reach.iter().map(|reach| reach[2] + 1);
        refining.chain([2, self.ball_reach[2] + 1])
    }

    /// How many planes the passes that refine normals look ahead together.
    #[must_use]
    pub fn refining_ahead(&self) -> i32 {
        self.refining_reach.iter().map(|reach| reach[2] + 1).sum()
    }

    /// Slabs with an index held at once beside the planes within reach.
    pub(super) fn slabs_in_flight(&self) -> u64 {
        slabs_in_flight(self.refining_reach.len())
    }

    /// Memory for indices, if they may take less than they can at worst.
    #[must_use]
    pub fn index_bytes(&self) -> Option<u64> {
        self.chunks.as_ref()?.index_bytes
    }

    /// Makes a plan.
    ///
    /// # Errors
    /// If the memory cannot hold the least that is needed, or a ball is too wide.
    pub fn new(request: &PlanRequest<'_>) -> Result<Self, PlanError> {
        let refused = |needed_bytes| PlanError::Memory {
            allowed_bytes: request.memory_bytes,
            needed_bytes,
            dims: request.lattice.dims,
            grey: request.normals.needs_grey(),
        };
        match Self::within(request)? {
            Some(plan) => Ok(plan),
            None => {
                // What would do, to a MiB, by trying.
                let mib = |n: u64| PlanRequest {
                    memory_bytes: n << 20,
                    ..*request
                };
                let mut enough = 1u64;
                while Self::within(&mib(enough))?.is_none() {
                    if enough >= 1 << 40 {
                        return Err(refused(u64::MAX));
                    }
                    enough *= 2;
                }
                let mut short = enough / 2;
                while enough - short > 1 {
                    let middle = short + (enough - short) / 2;
                    if Self::within(&mib(middle))?.is_some() {
                        enough = middle;
                    } else {
                        short = middle;
                    }
                }
                Err(refused(enough << 20))
            }
        }
    }

    /// The plan, if the memory can hold it.
    fn within(request: &PlanRequest<'_>) -> Result<Option<Self>, PlanError> {
        let PlanRequest {
            lattice,
            normals,
            balls,
            invariants,
            ..
        } = *request;
        let reaches = balls.iter().map(BallKernel::reach);
        let ball_reach = reaches
            .chain(invariants.iter().map(InvariantKernel::reach))
            .fold([1; 3], |reach: [i32; 3], other| {
                [0, 1, 2].map(|a| reach[a].max(other[a]))
            });
        let normal_reach = normals.reach();
        let refining_reach: Vec<[i32; 3]> = request.refinement.map_or(Vec::new(), |kernel| {
            (0..kernel.passes()).map(|n| kernel.reach(n)).collect()
        });
        let refining_ahead: i32 = refining_reach.iter().map(|reach| reach[2] + 1).sum();
        let widest = ball_reach
            .into_iter()
            .chain(normal_reach)
            .chain(refining_reach.iter().flatten().copied())
            .max()
            .unwrap_or(0);
        if widest > Surfels::MAX_CELLS / 4 {
            return Err(PlanError::Reach(2 * widest));
        }
        if let Some(edge) = request.brick
            && !(8..=1024).contains(&edge)
        {
            return Err(PlanError::Brick(edge));
        }
        let lumped = balls.iter().all(|b| b.weights().are_lumped());
        let radii = (balls.len() + invariants.len()) as u64;
        let only_if = |asked: bool, bytes: u64| if asked { bytes } else { 0 };
        let asked_bytes = only_if(request.directions, 24)
            + only_if(request.errors, 8)
            + only_if(request.quality, 4);
        let row_bytes = 32 + radii * (20 + asked_bytes);
        let sent_row_bytes = SENT_PLANES * (41 + radii * (18 + asked_bytes));
        let omega_bytes = omega_bytes(request.quality, lumped);
        // u, measures, marks, and the row it was given in
        let given_row = request.given.map_or(0, |_| given::ROW_BYTES);
        let passes = refining_reach.len() as u64;
        let refined = only_if(passes > 0, 24) + passes * REFINED_BYTES;
        let surfel_bytes = 30 + omega_bytes + if lumped { 65 } else { 130 } + given_row + refined;
        let [x, y, z] = lattice.dims.map(u64::from);
        let plane_bits = x.div_ceil(64) * 8 * y;
        let access = request.access;
        let sparse = access.sparse.as_ref();
        let stored_plane = (x * y).saturating_mul(access.voxel_bytes);
        let columns = Parts::new(lattice.dims).columns();
        let columns = match sparse {
            Some(sparse) => sparse.columns,
            None => u64::from(columns[0]) * u64::from(columns[1]),
        };
        let fixed_bytes = FIXED_BYTES
            + (columns - 1) * COLUMN_BYTES
            + request.sink_bytes
            + request.access.held_bytes
            + request.given.map_or(0, NormalTable::bytes);
        let mut read_planes = (READ_BYTES / stored_plane.max(1)).clamp(1, 64).min(z);
        let after_fixed = request.memory_bytes.saturating_sub(fixed_bytes);
        let grey_plane = if normals.needs_grey() {
            stored_plane
        } else {
            0
        };
        // The first layer that takes a third of the memory at most, or the thinnest.
        let reading = access.pieces.and_then(|pieces| {
            let planes = |n: u64| {
                ChunkPlan::reading(access, pieces, [x, y, z], n, request.threads, after_fixed)
            };
            let mut last = None;
            for height in ChunkPlan::heights(access, pieces, z, read_planes) {
                let reading = planes(height);
                let layer = height.min(z).saturating_mul(plane_bits + grey_plane);
                let fits = layer.saturating_add(reading.box_bytes) <= after_fixed / 3;
                last = Some(reading);
                if fits {
                    break;
                }
            }
            last
        });
        let (layer_planes, read_bytes) = match &reading {
            Some(reading) => (reading.plan.layer_planes.min(z), reading.box_bytes),
            None if access.buffered => (0, 2 * read_planes * stored_plane),
            None => (0, 0),
        };
        // Planes on their way: packed, sent, and arrived before they are needed. Packed ones of a
        // layer count by themselves.
        let mut waiting = 3 * read_planes;
        if reading.is_some() {
            read_planes = if sparse.is_some() {
                layer_planes
            } else {
                read_planes.min(layer_planes)
            };
            waiting = 2 * read_planes;
        }
        let (layer_bits, layer_grey) = match sparse {
            Some(_) => (0, 0),
            None => (
                plane_bits.saturating_mul(layer_planes),
                grey_plane.saturating_mul(layer_planes),
            ),
        };
        let tiles = |planes: u64, row_bytes: u64| {
            let rows = reading.as_ref().map_or(0, |reading| reading.plan.band_rows);
            sparse.map(|sparse| sparse.window_bytes(planes + layer_planes, rows, row_bytes))
        };
        let (normal_z, ball_z) = (normal_reach[2] as u64, ball_reach[2] as u64);
        let bits_bytes = |edge: i32, slab: i32| {
            let slabs = slabs_in_flight(refining_reach.len());
            let indexed = |height: u64| 2 * (ball_z + refining_ahead as u64) + slabs * height;
            // ahead as far as a slab is held, beside what is indexed
            let ahead = 2 * ball_z + refining_ahead as u64 + 7;
            let packed = 2 * normal_z + ahead + slab as u64 + waiting;
            if let Some(bytes) = tiles(packed + indexed(slab as u64).min(z + 1), 8) {
                return bytes;
            }
            // Higher slabs are paid for when they are chosen.
            let indexed = indexed(1).min(z + 1);
            let packed = packed + indexed;
            // 3 words of 12 bytes for each word of a row; rows start on a word in each brick
            let edge = edge as u64;
            let plane_index = x.div_ceil(edge) * edge.div_ceil(64) * 36 * y;
            let packed = plane_bits.saturating_mul(packed.min(z + 1));
            packed.saturating_add(plane_index.saturating_mul(indexed))
        };
        let grey_bytes = |slab: i32| {
            if !normals.needs_grey() {
                return 0;
            }
            let below = normal_z + 1;
            let ahead = below.max(ball_z + refining_ahead as u64 + 4);
            let planes = slab as u64 + below + ahead + waiting;
            tiles(planes, Sparse::grey_row_bytes(access.voxel_bytes))
                .unwrap_or_else(|| stored_plane.saturating_mul(planes.min(z)))
        };
        let needs = Needs {
            normals,
            ball_reach,
            lumped,
            invariants: !invariants.is_empty(),
            omega_bytes,
            row_bytes,
        };
        let stages = refining_reach.iter().map(|&reach| Stage::Refining(reach));
        let stages: Vec<Stage> = [Stage::Normals, Stage::Cells, Stage::Sums]
            .into_iter()
            .chain(stages)
            .collect();
        let cell_dims = lattice.cell_dims();
        let scratch_bytes = |edge: i32, slab: i32| {
            let of_stage = |&stage: &Stage| needs.most_bytes(stage, [edge, edge, slab], cell_dims);
            stages.iter().map(of_stage).max().unwrap_or(0)
        };
        let layer_bytes = layer_bits.saturating_add(layer_grey);
        let base = (fixed_bytes.saturating_add(read_bytes)).saturating_add(layer_bytes);
        let left = request.memory_bytes.saturating_sub(base);
        let is_wide = normal_reach.into_iter().max() > Some(WIDE_REACH);
        // What depends on surfels is cut in pieces where they are many; the rest is known, and is not cut if it can be helped.
        let least_scratch = |edge: i32, slab: i32, uncut: bool| {
            let of_stage = |&stage: &Stage| {
                if needs.by_surfels(stage) || !uncut {
                    needs.most_bytes(stage, [edge, edge, 1], cell_dims)
                } else {
                    needs.most_bytes(stage, [edge, edge, slab], cell_dims) * request.threads as u64
                }
            };
            stages.iter().map(of_stage).max().unwrap_or(0)
        };
        // Grey values come first. They are large, so a slab is only higher than one plane if they
        // leave 3/4. Of the rest bits may take up to 3/8, or 1/2 if nothing else fits, and scratch up to 1/4, or 1/8 where bits
        // take much; but what bits leave of 5/8 where wide bricks save much work. What then is left is for surfels.
        let for_scratch = |edge: i32, slab: i32| {
            let rest = left.saturating_sub(grey_bytes(slab));
            let bits = bits_bytes(edge, slab);
            if is_wide {
                (rest / 8 * 5).saturating_sub(bits)
            } else if bits > rest / 8 {
                rest / 8
            } else {
                rest / 4
            }
        };
        let fits = |edge: i32, slab: i32, eighths: u64, uncut: bool| {
            let grey = grey_bytes(slab);
            let rest = left.saturating_sub(grey);
            (slab == 1 || grey <= left / 4)
                && bits_bytes(edge, slab) <= rest / 8 * eighths
                && least_scratch(edge, slab, uncut) <= for_scratch(edge, slab)
        };
        // Rims are done again, so wide bricks save work, as long as there are enough for the workers.
        let [columns_x, columns_y] = [0, 1].map(|a| cell_dims[a] as u64);
        let enough = |edge: i32| {
            let bricks = columns_x.div_ceil(edge as u64) * columns_y.div_ceil(edge as u64);
            edge <= NARROW_BRICK || is_wide || bricks >= BRICKS_A_THREAD * request.threads as u64
        };
        let edges: Vec<i32> = match request.brick {
            Some(edge) => vec![edge],
            None => EDGES.into_iter().filter(|&edge| enough(edge)).collect(),
        };
        let chosen = |eighths: u64, uncut: bool| {
            HEIGHTS[if is_wide { 0 } else { 2 }..]
                .iter()
                .flat_map(|&slab| edges.iter().map(move |&edge| (edge, slab.min(edge))))
                // low slabs beside wide bricks halo as much as narrow bricks do: prefer cubes
                .filter(|&(edge, slab)| fits(edge, slab, eighths, uncut))
                .max_by_key(|&(edge, slab)| (edge.min(2 * slab), slab, edge))
        };
        let any = chosen(3, true).or_else(|| chosen(4, true));
        let any = any
            .or_else(|| chosen(3, false))
            .or_else(|| chosen(4, false));
        let chosen = match (any, request.brick) {
            (Some((edge, _)), Some(fixed)) if edge == fixed && fits(edge, edge, 3, true) => {
                Some((edge, edge))
            }
            (chosen, _) => chosen,
        };
        let Some((brick_edge, slab_planes)) = chosen else {
            return Ok(None);
        };
        let (bits_bytes, grey_bytes, scratch_bytes) = (
            bits_bytes(brick_edge, slab_planes),
            grey_bytes(slab_planes),
            (scratch_bytes(brick_edge, slab_planes) * request.threads as u64)
                .min(for_scratch(brick_edge, slab_planes)),
        );
        let mut surfel_budget_bytes = left - bits_bytes - grey_bytes - scratch_bytes;
        let mut chunks = reading.map(|reading| reading.plan);
        if let (Some(chunks), Some(_)) = (&mut chunks, sparse) {
            let index = surfel_budget_bytes / 4;
            chunks.index_bytes = Some(index);
            surfel_budget_bytes -= index;
        }
        Ok(Some(Self {
            memory_bytes: request.memory_bytes,
            threads: request.threads,
            brick_edge,
            slab_planes,
            read_planes,
            normal_reach,
            refining_reach,
            ball_reach,
            bits_bytes: bits_bytes + layer_bits,
            grey_bytes: grey_bytes + layer_grey,
            read_bytes,
            scratch_bytes,
            fixed_bytes,
            surfel_budget_bytes,
            surfel_bytes,
            row_bytes,
            sent_row_bytes,
            open_columns: columns,
            chunks,
        }))
    }
}
