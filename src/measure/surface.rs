//! The surface of a box of cells, ready for measures: surfels, links, bits.

use crate::khalimsky::{Adjacency, Direction, opposite};
use crate::lattice::Lattice;
use crate::surfel::{CellBox, Links, SurfelIndex, Surfels};
use crate::volume::{BitBox, PlaneWindow};

/// Surfels of a box of cells and how they join.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Look-up by place.
    pub index: SurfelIndex,
    /// Places.
    pub surfels: Surfels,
    /// What lies across each side.
    pub links: Links,
}

impl Surface {
    /// Extracts the surface owned by `cells`, which may extend beyond the image. The window must
    /// hold one plane more on each side.
    #[must_use]
    pub fn extract(
        window: &PlaneWindow,
        cells: CellBox,
        lattice: &Lattice,
        adjacency: Adjacency,
    ) -> Self {
        let bits = BitBox::cut(window, cells.lo.map(|c| c - 1), cells.hi.map(|c| c + 1));
        let index = SurfelIndex::find(&bits, cells, lattice);
        let surfels = Surfels::list(&index, &bits);
        let links = Links::join(&index, &surfels, &bits, lattice, adjacency);
        Self {
            index,
            surfels,
            links,
        }
    }

    /// Whether the trivial normals across two opposite sides of a surfel are opposite: it is on a wall, tip or pit one
    /// voxel thick. Smooth surfaces have few such surfels, noise is made of them.
    #[inline]
    #[must_use]
    pub fn is_ridge(&self, i: usize) -> bool {
        // Opposite to nothing.
        const NONE: Direction = 64;
        let links = &self.links.of[i];
        let across = |side: usize| {
            let n = links[side].surfel();
            n.map_or(NONE, |n| self.surfels.list[n].orientation)
        };
        (across(0) == opposite(across(2))) | (across(1) == opposite(across(3)))
    }

    /// Number of surfels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.surfels.list.len()
    }

    /// Whether there is no surfel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.surfels.list.is_empty()
    }
}
