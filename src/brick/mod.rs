//! How a volume is cut: slabs along z, bricks within a slab, and the exchange of halos.
//!
//! A *slab* is some planes of cells at full extent; its *bricks* are squares of it. Every cell is
//! in the core of exactly one brick. What a brick needs of its neighbours, its *halo*, it copies
//! from what they computed: arrays in Khalimsky order are copied run by run, in the order of the
//! larger box, so the copy is in Khalimsky order too.
//!
//! ```text
//!        +-----+-----+-----+     rows of the box (brick + halo), in order, are pieces of rows
//!        |     |     |     |     of the bricks it meets:
//!        |   +-+-----+-+   |
//!        +---+-+-----+-+---+         z plane, y row: [left run][own run][right run]
//!        |   | | own | |   |
//!        +---+-+-----+-+---+     The surfels of each run are consecutive in their brick.
//!        |   +-+-----+-+   |
//!        +-----+-----+-----+
//! ```
//!
//! Guaranteed: how the volume was cut does not show in anything that is computed.

use std::ops::Range;
use std::sync::Arc;

use crate::surfel::{CellBox, Kind, SurfelIndex};
use crate::volume::{BitPlane, PlaneWindow};

/// The squares a slab is cut into.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrickGrid {
    /// Extents of the grid of cells.
    pub cell_dims: [i32; 3],
    /// Edge of a brick along x and y, in cells.
    pub edge: i32,
}

impl BrickGrid {
    /// Number of bricks along x and y.
    #[must_use]
    pub fn columns(&self) -> [i32; 2] {
        [0, 1].map(|a| (self.cell_dims[a] + self.edge - 1) / self.edge)
    }

    /// Number of bricks of a slab.
    #[must_use]
    pub fn len(&self) -> usize {
        let [x, y] = self.columns();
        (x * y) as usize
    }

    /// Whether there is no brick; never, since a volume has voxels.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The cells of brick `number` of a slab.
    #[must_use]
    pub fn core(&self, number: usize, z: &Range<i32>) -> CellBox {
        let nx = self.columns()[0];
        let at = [number as i32 % nx, number as i32 / nx];
        let lo = at.map(|i| i * self.edge);
        let hi = [0, 1].map(|a| (lo[a] + self.edge).min(self.cell_dims[a]));
        CellBox {
            lo: [lo[0], lo[1], z.start],
            hi: [hi[0], hi[1], z.end],
        }
    }
}

/// Something computed for each brick of a slab, with the surfels of each brick indexed.
pub trait Slab {
    /// Planes of cells of the slab.
    fn z(&self) -> Range<i32>;

    /// The surfels of brick `number`.
    fn index(&self, number: usize) -> &SurfelIndex;

    /// Planes of voxels of the slab.
    fn planes(&self) -> &[Arc<BitPlane>];
}

/// Consecutive slabs, the lowest first, shared with the stages that still need them.
#[derive(Debug)]
pub struct SlabWindow<S> {
    slabs: std::collections::VecDeque<Arc<S>>,
}

impl<S> Default for SlabWindow<S> {
    fn default() -> Self {
        Self {
            slabs: std::collections::VecDeque::new(),
        }
    }
}

impl<S: Slab> SlabWindow<S> {
    /// Adds the next slab.
    ///
    /// # Panics
    /// If it does not follow the last one.
    pub fn push(&mut self, slab: Arc<S>) {
        if let Some(last) = self.slabs.back() {
            assert_eq!(last.z().end, slab.z().start, "slabs follow each other");
        }
        self.slabs.push_back(slab);
    }

    /// One past the last plane held.
    #[must_use]
    pub fn end(&self) -> i32 {
        self.slabs.back().map_or(0, |s| s.z().end)
    }

    /// Drops the slabs that end at or before plane `z`.
    pub fn release_before(&mut self, z: i32) {
        while self.slabs.front().is_some_and(|s| s.z().end <= z) {
            self.slabs.pop_front();
        }
    }

    /// The slab that starts at plane `z`.
    #[must_use]
    pub fn starting_at(&self, z: i32) -> Option<Arc<S>> {
        self.slabs.iter().find(|s| s.z().start == z).cloned()
    }

    /// The voxels of the slabs held.
    #[must_use]
    pub fn voxels(&self, dims: [u32; 3]) -> PlaneWindow {
        PlaneWindow {
            dims,
            z0: self.slabs.front().map_or(0, |s| s.z().start),
            planes: self
                .slabs
                .iter()
                .flat_map(|s| s.planes().iter().cloned())
                .collect(),
        }
    }

    /// Visits the surfels of a box of cells in Khalimsky order, as runs of consecutive surfels of
    /// one brick: its slab, its number, and the numbers of the surfels in it.
    ///
    /// # Panics
    /// If a plane of the box is not held.
    pub fn for_each_run<'a>(
        &'a self,
        grid: &BrickGrid,
        cells: CellBox,
        mut f: impl FnMut(&'a S, usize, Range<usize>),
    ) {
        let nx = grid.columns()[0];
        let bricks_x = cells.lo[0] / grid.edge..(cells.hi[0] - 1) / grid.edge + 1;
        let mut row = |slab: &'a S, kind, y: i32, z| {
            for bx in bricks_x.clone() {
                let number = (y / grid.edge * nx + bx) as usize;
                let index = slab.index(number);
                if index.is_empty() {
                    continue;
                }
                let from = cells.lo[0].max(bx * grid.edge);
                let to = cells.hi[0].min((bx + 1) * grid.edge);
                let run = index.range(kind, from..to, y, z);
                if !run.is_empty() {
                    f(slab, number, run);
                }
            }
        };
        for z in cells.lo[2]..cells.hi[2] {
            let slab = self
                .slabs
                .iter()
                .find(|s| s.z().contains(&z))
                .expect("plane held");
            for y in cells.lo[1]..cells.hi[1] {
                row(slab, Kind::Z, y, z);
            }
            for y in cells.lo[1]..cells.hi[1] {
                row(slab, Kind::Y, y, z);
                row(slab, Kind::X, y, z);
            }
        }
    }
}
