//! Boundary surfels of a box of cells, and how they join.
//!
//! Comes in: the bits of a box of voxels ([`crate::volume::BitBox`]). Goes out: [`SurfelIndex`],
//! the surfels of a box of cells in Khalimsky order with constant-time look-up by place;
//! [`Surfels`], their places; [`Links`], which surfel lies across each of the four sides;
//! and, by a [`Walker`], the part of the surface in a ball that is connected to a surfel.
//!
//! A cell owns the surfels on its lower faces, so each surfel belongs to exactly one cell:
//!
//! ```text
//!        +-------+
//!        |       |      cell c owns the surfels between voxel c and voxels
//!      x |  c    |      c - e_x, c - e_y, c - e_z, whichever of the two is inside
//!        |       |
//!        +---y---+
//! ```
//!
//! Guaranteed: surfels are numbered by (kz, ky, kx); every linel joins exactly two surfels, or
//! one where it lies on the border of an open image; around a pointel the corners of surfels form
//! cycles of 3 to 7 (*umbrellas*), or chains that end on the border.

mod blocks;
mod index;
mod links;
pub(crate) mod squares;
pub(crate) mod vicinity;
mod walk;

pub use blocks::Blocks;
pub use index::{CellBox, Kind, Surfel, SurfelIndex, Surfels};
pub use links::{Link, Links};
pub use walk::{Rim, Walker, displacement};
