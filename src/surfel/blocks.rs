//! The surfels of a box by place: in blocks of cells, so that those near each other are near in memory.
//!
//! Comes in: [`Surfels`] and [`Links`] of a box. Goes out: [`Blocks`], the same surfels in the
//! order of blocks of [`EDGE`]^3 cells (x fastest), with what is asked of them around every group of
//! neighbours: coordinates, the steps to the surfels across their sides, and the component of the
//! surface each is on. A row of blocks along x is one run of consecutive surfels.
//!
//! Numbers in the order of blocks are called *places* here, to tell them from the numbers of [`Surfels`].

use std::ops::Range;

use super::index::Surfels;
use super::links::{Link, Links};

use crate::simd::LANES;

/// Edge of a block in cells.
pub(super) const EDGE: i32 = 4;

/// No place.
pub(super) const NONE: u32 = u32::MAX;

/// A component of the surface of a box, joined by links within the box.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Component {
    /// Surfels of it.
    pub(super) size: u32,
    /// A side of it leads to a surfel that the box does not cover.
    pub(super) goes_on: bool,
}

/// Sixteen surfels in the order of their places.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chunk {
    /// Khalimsky coordinates, as in [`Surfels`].
    pub(super) k: [[i16; LANES]; 3],
    /// Displacements to the surfels across the sides, by side and axis; 0 where there is none.
    pub(super) steps: [[[i8; LANES]; 3]; 4],
    /// Which component of the surface.
    pub(super) component: [u32; LANES],
}

/// Surfels of a box in the order of blocks.
#[derive(Clone, Debug, Default)]
pub struct Blocks {
    /// Blocks along x, y, z.
    dims: [i32; 3],
    /// First place of each block, and the number of surfels.
    start: Vec<u32>,
    /// The surfel at each place.
    surfel: Vec<u32>,
    /// The place of each surfel.
    place: Vec<u32>,
    /// What loops over vectors read, sixteen places at a time.
    pub(super) chunks: Vec<Chunk>,
    /// The places across the sides, by side; [`NONE`] where there is none. Filled up to whole chunks.
    pub(super) across: [Vec<u32>; 4],
    pub(super) components: Vec<Component>,
    /// A side is on the border of an open image.
    pub(super) open: Vec<bool>,
}

impl Blocks {
    /// Sorts the surfels of a box of `size` cells.
    #[must_use]
    pub fn sort(size: [i32; 3], surfels: &Surfels, links: &Links) -> Self {
        let dims = size.map(|n| (n + EDGE - 1) / EDGE);
        let [nx, ny, nz] = dims.map(|n| n as usize);
        let block_of = |k: [i16; 3]| {
            let [x, y, z] = k.map(|k| (k >> 1) as usize / EDGE as usize);
            (z * ny + y) * nx + x
        };
        let count = surfels.list.len();
        let mut start = vec![0u32; nx * ny * nz + 1];
        for surfel in &surfels.list {
            start[block_of(surfel.k) + 1] += 1;
        }
        for block in 1..start.len() {
            start[block] += start[block - 1];
        }
        let mut next = start.clone();
        let mut surfel = vec![0u32; count];
        let mut place = Vec::with_capacity(count);
        for (number, at) in surfels.list.iter().enumerate() {
            let next = &mut next[block_of(at.k)];
            surfel[*next as usize] = number as u32;
            place.push(*next);
            *next += 1;
        }
        let mut blocks = Self {
            dims,
            start,
            surfel,
            place,
            ..Self::default()
        };
        blocks.describe(surfels, links);
        blocks.join(links);
        blocks
    }

    fn describe(&mut self, surfels: &Surfels, links: &Links) {
        let count = self.surfel.len();
        for side in &mut self.across {
            *side = Vec::with_capacity(count.next_multiple_of(LANES));
        }
        self.open = Vec::with_capacity(count);
        self.chunks = Vec::with_capacity(count.div_ceil(LANES));
        for numbers in self.surfel.chunks(LANES) {
            let mut chunk = Chunk {
                k: [[0; LANES]; 3],
                steps: [[[0; LANES]; 3]; 4],
                component: [NONE; LANES],
            };
            for (lane, &number) in numbers.iter().enumerate() {
                let k = surfels.list[number as usize].k;
                for a in 0..3 {
                    chunk.k[a][lane] = k[a];
                }
                let links = &links.of[number as usize];
                let mut open = false;
                for side in 0..4 {
                    let (place, to) = match links[side].surfel() {
                        Some(n) => (self.place[n], surfels.list[n].k),
                        None => (NONE, k),
                    };
                    open |= links[side] == Link::BORDER;
                    self.across[side].push(place);
                    for a in 0..3 {
                        // surfels that share a linel are at most two half cells apart
                        chunk.steps[side][a][lane] = (to[a] - k[a]) as i8;
                    }
                }
                self.open.push(open);
            }
            self.chunks.push(chunk);
        }
        for side in &mut self.across {
            side.resize(count.next_multiple_of(LANES), NONE);
        }
    }

    /// Finds the components.
    fn join(&mut self, links: &Links) {
        let count = self.surfel.len();
        let mut parent: Vec<u32> = (0..count as u32).collect();
        for place in 0..count {
            for side in &self.across {
                let other = side[place];
                if other < place as u32 {
                    unite(&mut parent, place as u32, other);
                }
            }
        }
        for place in 0..count as u32 {
            let root = find(&mut parent, place);
            // the root is the first of its component
            let component = if root == place {
                self.components.push(Component::default());
                self.components.len() as u32 - 1
            } else {
                self.component(root as usize)
            };
            self.chunks[place as usize / LANES].component[place as usize % LANES] = component;
            let component = &mut self.components[component as usize];
            component.size += 1;
            let across = &links.of[self.surfel[place as usize] as usize];
            component.goes_on |= across.contains(&Link::BEYOND);
        }
    }

    /// How many surfels there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.surfel.len()
    }

    /// Whether there is no surfel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.surfel.is_empty()
    }

    /// The surfel at each place.
    #[must_use]
    pub fn order(&self) -> &[u32] {
        &self.surfel
    }

    /// The place of a surfel.
    #[inline]
    #[must_use]
    pub fn place(&self, surfel: usize) -> usize {
        self.place[surfel] as usize
    }

    /// Whether the surfel at a place has a side on the border of an open image.
    #[inline]
    #[must_use]
    pub fn is_open(&self, place: usize) -> bool {
        self.open[place]
    }

    /// Khalimsky coordinates of a place.
    #[inline]
    pub(crate) fn k_at(&self, place: usize) -> [i16; 3] {
        let (chunk, lane) = (&self.chunks[place / LANES], place % LANES);
        [chunk.k[0][lane], chunk.k[1][lane], chunk.k[2][lane]]
    }

    /// The component of a place.
    #[inline]
    pub(super) fn component(&self, place: usize) -> u32 {
        self.chunks[place / LANES].component[place % LANES]
    }

    /// Places of the surfels of each block that has any.
    pub fn blocks(&self) -> impl Iterator<Item = Range<usize>> {
        self.start
            .windows(2)
            .map(|pair| pair[0] as usize..pair[1] as usize)
            .filter(|run| !run.is_empty())
    }

    /// Lists the places of the blocks that meet a box, given by its Khalimsky coordinates: a run
    /// for each row of blocks.
    pub(super) fn runs(&self, lo: [i32; 3], hi: [i32; 3], runs: &mut Vec<Range<usize>>) {
        runs.clear();
        let from = [0, 1, 2].map(|a| (lo[a].max(0) >> 1) / EDGE);
        let to = [0, 1, 2].map(|a| ((hi[a] >> 1) / EDGE).min(self.dims[a] - 1));
        if from[0] > to[0] {
            return;
        }
        for z in from[2]..=to[2] {
            for y in from[1]..=to[1] {
                let row = (z * self.dims[1] + y) * self.dims[0];
                let first = self.start[(row + from[0]) as usize] as usize;
                let end = self.start[(row + to[0] + 1) as usize] as usize;
                if first < end {
                    runs.push(first..end);
                }
            }
        }
    }
}

/// The root of an element of a forest; halves the path to it.
#[inline(always)]
pub(super) fn find(parent: &mut [u32], mut i: u32) -> u32 {
    while parent[i as usize] != i {
        let above = parent[parent[i as usize] as usize];
        parent[i as usize] = above;
        i = above;
    }
    i
}

/// Joins two trees; the smaller root stays one.
#[inline(always)]
pub(super) fn unite(parent: &mut [u32], a: u32, b: u32) {
    let (a, b) = (find(parent, a), find(parent, b));
    if a < b {
        parent[b as usize] = a;
    } else {
        parent[a as usize] = b;
    }
}
