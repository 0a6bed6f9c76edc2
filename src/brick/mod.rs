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
//! Bricks without surfels are not kept, and where the voxels of a slab are known to be uniform they
//! are never looked for, so that a slab costs by its surface and not by its extents.
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

    /// The cells of brick `number` of a slab.
    #[must_use]
    pub fn core(&self, number: usize, z: &Range<i32>) -> CellBox {
        let nx = self.columns()[0] as usize;
        let at = [(number % nx) as i32, (number / nx) as i32];
        let lo = at.map(|i| i * self.edge);
        let hi = [0, 1].map(|a| (lo[a] + self.edge).min(self.cell_dims[a]));
        CellBox {
            lo: [lo[0], lo[1], z.start],
            hi: [hi[0], hi[1], z.end],
        }
    }

    /// The bricks of planes `z` that can have surfels, as far as that is known before any voxel is
    /// looked at: all of them, unless the planes are in tiles. In ascending order. `closed` says that
    /// there are surfels on the border of the image.
    #[must_use]
    pub fn occupied(&self, window: &PlaneWindow, z: Range<i32>, closed: bool) -> Vec<usize> {
        let mut numbers = Vec::new();
        let [x, y, _] = self.cell_dims;
        let nx = self.columns()[0] as usize;
        window.rectangles(
            [0; 2],
            [x, y],
            z,
            self.edge,
            closed,
            &mut |lo, hi, known| {
                if known.is_none() {
                    let [bricks_x, bricks_y] = [0, 1].map(|a| {
                        (lo[a] / self.edge) as usize..((hi[a] - 1) / self.edge + 1) as usize
                    });
                    numbers
                        .extend(bricks_y.flat_map(|y| bricks_x.clone().map(move |x| y * nx + x)));
                }
            },
        );
        numbers.sort_unstable();
        numbers
    }
}

/// Something computed for each brick of a slab that has surfels, which are indexed.
pub trait Slab {
    /// Planes of cells of the slab.
    fn z(&self) -> Range<i32>;

    /// Numbers of the bricks with surfels, in ascending order.
    fn numbers(&self) -> &[usize];

    /// The surfels of the brick whose number is at this place among [`Self::numbers`].
    fn index(&self, at: usize) -> &SurfelIndex;

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
    /// one brick, as long as can be: its slab, its place among the bricks of the slab, and the numbers of the surfels
    /// in it. Rows of which `occupied` says no have no surfels.
    ///
    /// # Panics
    /// If a plane of the box is not held.
    pub fn for_each_run<'a>(
        &'a self,
        grid: &BrickGrid,
        cells: CellBox,
        occupied: impl Fn(Kind, i32, i32) -> bool,
        mut f: impl FnMut(&'a S, usize, Range<usize>),
    ) {
        let nx = grid.columns()[0] as usize;
        let [bricks_x, bricks_y] = [0, 1].map(|a| {
            (cells.lo[a] / grid.edge) as usize..((cells.hi[a] - 1) / grid.edge + 1) as usize
        });
        // Bricks of a row of bricks with surfels in a plane, and the cells of theirs along x that count.
        let mut row: Vec<(usize, Range<i32>)> = Vec::new();
        for z in cells.lo[2]..cells.hi[2] {
            let slab = self
                .slabs
                .iter()
                .find(|s| s.z().contains(&z))
                .expect("plane held");
            let numbers = slab.numbers();
            let mut held = (0, 0..0);
            let mut rows = |kinds: &[Kind]| {
                for by in bricks_y.clone() {
                    // The bricks of this row of bricks that meet the box.
                    let from = numbers.partition_point(|&n| n < by * nx + bricks_x.start);
                    let to = numbers.partition_point(|&n| n < by * nx + bricks_x.end);
                    row.clear();
                    for (at, &number) in (from..to).zip(&numbers[from..to]) {
                        if !slab.index(at).planes(z..z + 1).is_empty() {
                            let lo = (number % nx) as i32 * grid.edge;
                            row.push((at, cells.lo[0].max(lo)..cells.hi[0].min(lo + grid.edge)));
                        }
                    }
                    if row.is_empty() {
                        continue;
                    }
                    let first = by as i32 * grid.edge;
                    for y in first.max(cells.lo[1])..(first + grid.edge).min(cells.hi[1]) {
                        for &kind in kinds {
                            if !occupied(kind, y, z) {
                                continue;
                            }
                            for &(at, ref x) in &row {
                                let run = slab.index(at).range(kind, x.clone(), y, z);
                                if run.is_empty() {
                                    continue;
                                }
                                if at == held.0 && run.start == held.1.end {
                                    held.1.end = run.end;
                                    continue;
                                }
                                let (at, run) = std::mem::replace(&mut held, (at, run));
                                if !run.is_empty() {
                                    f(slab, at, run);
                                }
                            }
                        }
                    }
                }
            };
            rows(&[Kind::Z]);
            rows(&[Kind::Y, Kind::X]);
            let (at, run) = held;
            if !run.is_empty() {
                f(slab, at, run);
            }
        }
    }
}
