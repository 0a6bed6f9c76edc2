//! An open image that answers "is this voxel inside?", one bit a voxel.
//!
//! Comes in: stored voxels and a [`Criterion`]. Goes out: [`BitPlane`]s, one per plane of the
//! image in order of z; a [`PlaneWindow`] of them; and a [`BitBox`], any box of voxels cut out of
//! a window with the outside of the image filled with zeros. Where normals ask for the values
//! themselves, a [`GreyWindow`] of stored planes and a [`GreyBox`] cut out of it.
//!
//! Where a source knows that most of a volume is uniform, planes are kept in tiles ([`TileMap`]),
//! and what follows asks the window where the voxels can differ ([`PlaneWindow::rectangles`])
//! before it looks at any.

mod bits;
mod criterion;
mod euler;
mod grey;
pub mod otsu;
mod squares;
mod tiles;

#[cfg(test)]
pub(crate) use bits::tests::scattered;
pub use bits::{BitBox, BitPlane, PlaneWindow};
pub use criterion::{Binarizer, Criterion, CriterionError, Number};
pub use euler::SolidCounts;
pub use grey::{GreyBox, GreyPlane, GreyWindow, ValueType};
pub use tiles::{BandTiles, PieceGrid, TILE_WIDTH, TileMap};
