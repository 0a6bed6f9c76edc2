//! DGtal's own cell measures and walk, so that every row of its tables is explained.
//!
//! Not a definition of anything: where this module and [`plain`](crate::plain) differ, `plain` is what
//! curvox means, and this is what DGtal's `CorrectedNormalCurrentComputer` and `SurfaceMesh` give.
//!
//! In: surfels in the order of the table (it decides how faces around a pointel are chained), a
//! corrected normal each, the radius in voxels. Out: sums over DGtal's ball, and curvatures. Guaranteed:
//! the same cells, weights and branches as DGtal. Not guaranteed: the last bits, nor the directions.
//!
//! The differences, by name:
//!
//! * [`mesh`]: pointels and linels of equal coordinates are one, so cells are not split. Faces that
//!   share a linel are neighbours, the four at a non-manifold linel all of one another.
//! * [`cells`]: mu1 by asin, which *folds* an angle beyond 90 degrees back; no mu1 at a linel of
//!   four faces, no mu2 at a pointel whose faces do not chain: they are *dropped*. mu2 is a *fan* of
//!   triangles around the mean normal, which can be 4 pi off and which leaves out thin triangles.
//! * [`ball`]: the faces of positive weight reached through neighbours.

pub mod ball;
pub mod cells;
pub mod mesh;

pub use ball::{Ball, Curvatures};
pub use cells::{Cells, Fan};
pub use mesh::{Linel, Mesh};
