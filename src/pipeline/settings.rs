//! What to compute, and the kernels made ready for it.

use crate::curvature::Method;
use crate::curvature::integral::InvariantKernel;
use crate::curvature::uncertainty::ErrorKind;
use crate::error::Error;
use crate::khalimsky::Adjacency;
use crate::lattice::Lattice;
use crate::measure::ball::{BallKernel, Compensation, Extent, Weights};
use crate::measure::field::Field;
use crate::normal::refine::{FIRST_RADIUS, RefineKernel};
use crate::normal::{Estimator, NormalKernel, Orientation};
use crate::sink::{NormalTable, SinkError};

use super::access::Access;
use super::plan::{Plan, PlanRequest};

/// A way to curvatures that has a name, as `--method` of the command has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NamedMethod {
    /// Averages of the surface and compensated weights.
    Default,
    /// The same with refined normals.
    Refined,
    /// Integral invariants and DGtal's weights, as the authors of the paper have it.
    Paper,
}

/// What to compute.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The voxel grid.
    pub lattice: Lattice,
    /// Which surfels join at a linel shared by four.
    pub adjacency: Adjacency,
    /// The normals.
    pub estimator: Estimator,
    /// Whether the normals are refined ([`crate::normal::refine`]), and the radius it is scaled with, in voxel units.
    pub refinement: Option<f64>,
    /// The table of normals, for [`Estimator::Given`].
    pub given: Option<NormalTable>,
    /// How the normals are continued over the surface.
    pub field: Field,
    /// Where curvatures come from.
    pub curvature: Method,
    /// Radii of the balls of the measures, or of the integral invariants, in voxel units.
    pub radii: Vec<f64>,
    /// Which part of the surface in a ball is summed.
    pub extent: Extent,
    /// How cells at its rim count.
    pub weights: Weights,
    /// Whether to give principal directions.
    pub directions: bool,
    /// What the columns of errors hold, where there are some.
    pub error_kind: ErrorKind,
    /// Whether to give mu_Omega / mu0, the quality of the normals.
    pub quality: bool,
    /// Worker threads.
    pub threads: usize,
    /// Memory allowed.
    pub memory_bytes: u64,
    /// Edge of bricks, if it is to be fixed.
    pub brick: Option<i32>,
}

/// Settings made ready.
pub(super) struct Kernels {
    pub(super) normals: NormalKernel,
    pub(super) refinement: Option<RefineKernel>,
    /// One a radius, or none where curvatures come from invariants.
    pub(super) balls: Vec<BallKernel>,
    /// One a radius, or none where curvatures come from measures.
    pub(super) invariants: Vec<InvariantKernel>,
}

impl Settings {
    /// The plainest choices on a lattice: integral invariant normals and connected, lumped sums at 3
    /// voxel units, one radius, within 1 GiB, on all processors. See [`Self::with_method`] for better ones.
    #[must_use]
    pub fn new(lattice: Lattice) -> Self {
        Self {
            lattice,
            adjacency: Adjacency::Interior,
            estimator: Estimator::IntegralInvariant {
                radius: 3.0,
                orientation: Orientation::Moment,
            },
            field: Field::Constant,
            curvature: Method::Measures,
            refinement: None,
            given: None,
            radii: vec![3.0],
            extent: Extent::Connected,
            weights: Weights::Lumped,
            directions: false,
            error_kind: ErrorKind::Bars,
            quality: false,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            memory_bytes: 1 << 30,
            brick: None,
        }
    }

    /// With the normals, sums and weights of a named method at one radius, in voxel units.
    #[must_use]
    pub fn with_method(mut self, method: NamedMethod, radius: f64) -> Self {
        self.curvature = Method::Measures;
        self.field = Field::Constant;
        self.extent = Extent::Connected;
        self.radii = vec![radius];
        self.refinement = (method == NamedMethod::Refined).then_some(radius);
        let average = Estimator::SurfaceAverage {
            radius: FIRST_RADIUS * radius,
        };
        (self.estimator, self.weights) = match method {
            NamedMethod::Default => (average, Weights::Compensated(Compensation::Averaged)),
            NamedMethod::Refined => (average, Weights::Compensated(Compensation::Refined)),
            NamedMethod::Paper => (
                Estimator::IntegralInvariant {
                    radius,
                    orientation: Orientation::Trivial,
                },
                Weights::Dgtal,
            ),
        };
        self
    }

    /// Whether rows have the errors to expect of H and G ([`crate::curvature::uncertainty`]): they are made from what the
    /// compensated weights tell with the normals they are made for.
    #[must_use]
    pub fn gives_errors(&self) -> bool {
        self.curvature == Method::Measures
            && matches!(self.weights, Weights::Compensated(_))
            && matches!(self.estimator, Estimator::SurfaceAverage { .. })
    }

    pub(super) fn kernels(&self) -> Result<Kernels, Error> {
        let normals = NormalKernel::new(self.estimator, &self.lattice, self.adjacency)?;
        if (self.estimator == Estimator::Given) != self.given.is_some() {
            return Err(SinkError::Unsupported(
                "given normals and a table of them go together".into(),
            )
            .into());
        }
        let (mut balls, mut invariants) = (Vec::new(), Vec::new());
        for &radius in &self.radii {
            match self.curvature {
                Method::Measures => {
                    balls.push(BallKernel::new(
                        radius,
                        self.extent,
                        self.weights,
                        &self.lattice,
                    )?);
                }
                Method::Invariants => invariants.push(InvariantKernel::new(radius, &self.lattice)?),
            }
        }
        let refinement = (self.refinement)
            .map(|radius| RefineKernel::new(radius, &self.lattice))
            .transpose()?;
        Ok(Kernels {
            normals,
            refinement,
            balls,
            invariants,
        })
    }

    /// How a run of these settings would use its memory, on voxels that can be read like this.
    ///
    /// # Errors
    /// If radii cannot be used or the memory is too small.
    pub fn plan(&self, access: &Access, sink_bytes: u64) -> Result<Plan, Error> {
        let kernels = self.kernels()?;
        Ok(Plan::new(&PlanRequest {
            lattice: &self.lattice,
            normals: &kernels.normals,
            refinement: kernels.refinement.as_ref(),
            given: self.given.as_ref(),
            balls: &kernels.balls,
            invariants: &kernels.invariants,
            directions: self.directions,
            errors: self.gives_errors(),
            quality: self.quality,
            memory_bytes: self.memory_bytes,
            sink_bytes,
            threads: self.threads,
            brick: self.brick,
            access,
        })?)
    }
}
