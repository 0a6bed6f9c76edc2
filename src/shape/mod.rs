//! Implicit shapes of known curvature, digitised on demand: the ground truth.
//!
//! **In:** a shape named with its parameters ([`by_name`], [`by_spec`]) or made as a struct
//! ([`Goursat`], [`Sphere`], ...), a gridstep, and optionally a noise level.
//!
//! **Out:** planes of voxels ([`Digitisation`]), the same planes with noise ([`NoisyPlanes`]),
//! planes of grey values as a scanner would see them ([`GreyPlanes`]),
//! and, for any point near the surface, the closest point of the surface with its normal, mean,
//! Gaussian and principal curvatures ([`closest_point`], [`truth_on_surface`]).
//!
//! ```text
//!   ImplicitShape  F(x) <= 0 inside,  grad F, Hess F
//!     |                    |
//!     v                    v
//!   Digitisation        closest_point, truth_on_surface
//!     |  planes of 0/1     (normal, H, G, k1 <= k2, d1, d2)
//!     v
//!   NoisyPlanes            flips with probability p^delta
//! ```
//!
//! **Guaranteed:** the same shape, gridstep, offset and seed give the same voxels on any machine,
//! in any order of planes and on any thread: values are made of `+ - * /` and square roots, or of
//! the `libm` crate's own functions. Curvatures are exact up to rounding. Normals point outward
//! (F grows outward) and a convex body has H > 0; a sphere of radius R has H = 1/R, G = 1/R^2.
//!
//! **Not guaranteed:** that a digitisation has the topology of its shape (it does when the
//! gridstep is small against the reach of the shape), nor that [`closest_point`] finds the nearest
//! of several local closest points: it is the nearest one within the reach of the surface.

mod digitise;
mod error;
mod gyroid;
mod implicit;
mod named;
mod noise;
mod partial;
mod polynomial;
mod quadric;
mod truth;

#[cfg(test)]
mod npz;
#[cfg(test)]
mod reference_tests;

pub use digitise::{Digitisation, Grid, MAX_AXIS_VOXELS, MAX_PLANE_VOXELS, REFERENCE_MARGIN};
pub use error::ShapeError;
pub use gyroid::Gyroid;
pub use implicit::{BoundingBox, ImplicitShape};
pub use named::{BoxedShape, NAMES, ParameterInfo, SHAPES, ShapeInfo, by_name, by_spec};
pub use noise::{MAX_NOISE, Noise, NoisyPlanes};
pub use partial::{GreyPlanes, MAX_BLUR, Scanner};
pub use polynomial::{Goursat, Leopold, RoundedCube, Torus};
pub use quadric::{Cylinder, Ellipsoid, Plane, Sphere};
pub use truth::{ClosestPoint, SurfaceTruth, closest_point, truth_on_surface};
