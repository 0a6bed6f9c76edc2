//! Polyhedral surfaces: corrected curvature measures of meshes, in memory.
//!
//! Comes in: a mesh as its file has it ([`curvox_formats::mesh::Mesh`]). Goes out: what it is as a
//! surface ([`MeshSurface`], [`Defects`]), a corrected normal field on it ([`NormalField`]), measures
//! of faces, edges and vertices with their totals ([`MeshMeasures`], [`MeshTotals`]), and for each
//! face the sums over the surface connected to it within a ball ([`ball_sums`]).
//!
//! Paper: Lachaud, Romon, Thibert, *Corrected curvature measures*, Proposition 3.8 (u constant on
//! each face) and Proposition 3.5 (u interpolated); the closed forms of linear fields are those of
//! Lachaud, Romon, Thibert, Coeurjolly, *Interpolated corrected curvature measures for polygonal
//! surfaces* (2020), with the signs of [`crate::measure::formula`]: a convex body has H > 0.
//!
//! Guaranteed: an edge has a measure only where exactly two faces meet that run through it in
//! opposite directions; all other edges are borders, counted and marked. On a closed mesh and for
//! constant u, sum(mu2) + 4 pi sum(k) = 2 pi (V - E + F) up to rounding. Results do not depend on the
//! number of threads. Not guaranteed: that faces do not intersect; that a field given by a file
//! is a good one, for which see mu_Omega.

mod field;
mod interpolated;
mod measures;
mod sums;
mod surface;

pub use field::{NormalField, NormalSource, UsedNormals};
pub use interpolated::{FaceMeasure, linear_triangle, unit_triangle};
pub use measures::{EdgeMeasure, MeshMeasures, MeshTotals};
pub use sums::{FaceSums, ball_sums};
pub use surface::{Defects, EdgeKind, Flip, MeshSurface};
