//! Normal estimators: a unit vector `u` for each surfel, pointing out of the solid.
//!
//! Comes in: what is [`Around`] a brick (bits; stored values or given normals where the estimator
//! asks for them) and the surfels of its core. Goes out: [`Normals`], one `u`
//! a surfel, in the axes of the image. Each estimator declares its reach; nothing it gives
//! depends on voxels beyond.
//!
//! | estimator | from | paper |
//! |---|---|---|
//! | [`trivial`] | the surfel's own direction; the measures become those of the normal cycle | 6.1.3, TN |
//! | [`integral`] | covariance of the solid in a ball (digital integral invariants) | 6.1.3, II |
//! | [`vcm`] | covariance of the Voronoi cells of the surface's pointels | 6.1.3, VCM |
//! | [`average`] | the trivial normals of the connected surface in a ball | introduction: "a local average of the naive normals" |
//! | [`gradient`] | the gradient of the smoothed grey values at the surfel's centroid | |
//! | [`given`] | a table of normals | |
//!
//! Guaranteed: `|u| = 1` to rounding; a surfel where nothing can be estimated gets its trivial
//! normal and is marked degenerate. Not guaranteed: that u points to the outer side of the
//! surfel (`<u, n>` may be negative on thin parts); such rows are flagged.

pub mod average;
mod border;
pub mod given;
pub mod gradient;
pub mod integral;
mod moments;
pub mod refine;
pub mod trivial;
pub mod vcm;

use glam::DVec3;

use crate::khalimsky::{Adjacency, Direction, OrientedSurfel, axis, sign};
use crate::lattice::{Lattice, LatticeError};
use crate::surfel::{CellBox, Surfels};
use crate::volume::{GreyWindow, PlaneWindow};

use given::GivenNormals;

/// Which way a normal of the covariance points. A covariance gives a line, not a direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Orientation {
    /// The eigenvector nearest the first moment of the solid in the ball, pointing away from it.
    #[default]
    Moment,
    /// The eigenvector of the smallest eigenvalue, on the outer side of the surfel: DGtal's rule.
    /// It reverses some normals where the trivial normal is nearly tangent to the surface.
    Trivial,
}

/// A normal estimator and its radius in voxel units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Estimator {
    /// u = n.
    Trivial,
    /// Digital integral invariants.
    IntegralInvariant {
        /// Radius of the ball of voxels.
        radius: f64,
        /// Which way u points.
        orientation: Orientation,
    },
    /// The Voronoi covariance measure.
    VoronoiCovariance {
        /// R: cells are cut at this distance from their site.
        voronoi_radius: f64,
        /// r: radius of the hat the cells are summed with.
        radius: f64,
        /// Which way u points.
        side: vcm::Side,
    },
    /// Average of the trivial normals of the surface connected to the surfel in a ball.
    SurfaceAverage {
        /// Radius of the ball of surfels.
        radius: f64,
    },
    /// Gradient of the grey values, smoothed by a Gaussian.
    Gradient {
        /// Standard deviation of the Gaussian.
        sigma: f64,
    },
    /// Normals out of a table.
    Given,
}

/// What an estimator may look at around a brick.
#[derive(Clone, Copy, Debug)]
pub struct Around<'a> {
    /// Which voxels are inside.
    pub bits: &'a PlaneWindow,
    /// Stored values of the same planes; for [`NormalKernel::Gradient`].
    pub grey: Option<&'a GreyWindow>,
    /// Normals of the surfels of the slab; for [`NormalKernel::Given`].
    pub given: Option<&'a GivenNormals>,
}

impl<'a> Around<'a> {
    /// Bits alone.
    #[must_use]
    pub fn bits(bits: &'a PlaneWindow) -> Self {
        Self {
            bits,
            grey: None,
            given: None,
        }
    }
}

/// Normals of consecutive surfels.
#[derive(Clone, Debug, Default)]
pub struct Normals {
    /// Unit normals, in image axes and voxel units (so of box voxels in true proportion).
    pub u: Vec<DVec3>,
    /// Whether nothing could be estimated and `u` is the trivial normal.
    pub degenerate: Vec<bool>,
    /// Whether the border of an open image cuts what the normal was estimated from: the surfel
    /// touches the border, its ball of voxels leaves the image where the solid meets the border, or
    /// its part of the surface meets the border.
    pub cut: Vec<bool>,
    /// The values on either side of those surfels where they differ; of [`gradient`] alone.
    pub sides: gradient::Sides,
}

/// An estimator made ready for a lattice.
#[derive(Clone, Debug)]
pub enum NormalKernel {
    /// See [`trivial`].
    Trivial,
    /// See [`integral`].
    Integral(integral::IntegralKernel),
    /// See [`vcm`].
    Vcm(Box<vcm::VcmKernel>),
    /// See [`average`].
    Average(average::AverageKernel),
    /// See [`gradient`].
    Gradient(gradient::GradientKernel),
    /// See [`given`].
    Given,
}

impl NormalKernel {
    /// Prepares an estimator.
    ///
    /// # Errors
    /// If the radius cannot be used.
    pub fn new(
        estimator: Estimator,
        lattice: &Lattice,
        adjacency: Adjacency,
    ) -> Result<Self, LatticeError> {
        Ok(match estimator {
            Estimator::Trivial => Self::Trivial,
            Estimator::IntegralInvariant {
                radius,
                orientation,
            } => Self::Integral(integral::IntegralKernel::new(
                lattice.metric().voxel_ball(radius)?,
                lattice.edges(),
                orientation,
            )),
            Estimator::VoronoiCovariance {
                voronoi_radius,
                radius,
                side,
            } => Self::Vcm(Box::new(vcm::VcmKernel::new(
                voronoi_radius,
                radius,
                side,
                lattice,
                adjacency,
            )?)),
            Estimator::SurfaceAverage { radius } => Self::Average(average::AverageKernel::new(
                lattice.metric().khalimsky_ball(radius)?,
                lattice.edges(),
                adjacency,
            )),
            Estimator::Gradient { sigma } => {
                Self::Gradient(gradient::GradientKernel::new(sigma, lattice.edges())?)
            }
            Estimator::Given => Self::Given,
        })
    }

    /// How many voxels beyond its cell a surfel's normal looks, along each axis.
    #[must_use]
    pub fn reach(&self) -> [i32; 3] {
        match self {
            Self::Trivial | Self::Given => [0; 3],
            // one more for the inner or outer voxel, which may be the cell below
            Self::Integral(kernel) => kernel.ball().reach().map(|r| r + 1),
            Self::Vcm(kernel) => kernel.reach(),
            // the bits around the surfels in the ball tell how they join
            Self::Average(kernel) => kernel.ball().reach().map(|r| r + 1),
            Self::Gradient(kernel) => kernel.reach(),
        }
    }

    /// Whether it looks at stored values ([`Around::grey`]).
    #[must_use]
    pub fn needs_grey(&self) -> bool {
        matches!(self, Self::Gradient(_))
    }

    /// Memory while the normals of a brick of at most `core` cells are made, for the worst volume;
    /// `None` if that is what the surfels within reach take.
    #[must_use]
    pub fn scratch_bytes(&self, core: [i32; 3]) -> Option<u64> {
        match self {
            Self::Trivial
            | Self::Integral(_)
            | Self::Average(_)
            | Self::Gradient(_)
            | Self::Given => None,
            Self::Vcm(kernel) => Some(kernel.scratch_bytes(core)),
        }
    }

    /// Normals of the surfels owned by `core`, in Khalimsky order. `surfels` are those of `core`.
    ///
    /// # Panics
    /// If `around` lacks what this estimator looks at.
    #[must_use]
    pub fn estimate(
        &self,
        around: &Around<'_>,
        lattice: &Lattice,
        core: CellBox,
        surfels: &Surfels,
    ) -> Normals {
        let window = around.bits;
        match self {
            Self::Trivial => trivial::estimate(surfels, lattice),
            Self::Integral(kernel) => kernel.estimate(window, lattice, core, surfels),
            Self::Vcm(kernel) => kernel.estimate(window, lattice, core, surfels),
            Self::Average(kernel) => kernel.estimate(window, lattice, core, surfels),
            Self::Gradient(kernel) => {
                let grey = around.grey.expect("stored values for the gradient");
                kernel.estimate(window, grey, lattice, surfels)
            }
            Self::Given => {
                let given = around.given.expect("a table of normals");
                given::estimate(given, surfels, lattice)
            }
        }
    }
}

/// The trivial normal of an orientation.
#[inline]
#[must_use]
pub fn trivial_normal(orientation: Direction) -> DVec3 {
    let mut n = DVec3::ZERO;
    n[axis(orientation)] = f64::from(sign(orientation));
    n
}

/// Whether a side of a surfel lies on the border of an open image.
#[must_use]
pub fn touches_border(surfel: OrientedSurfel, lattice: &Lattice) -> bool {
    !lattice.closed
        && (0..3).any(|a| {
            let last = lattice.dims[a] as i32 - 1;
            a != axis(surfel.orientation) && (surfel.inner[a] == 0 || surfel.inner[a] == last)
        })
}
