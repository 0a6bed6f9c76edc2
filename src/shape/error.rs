//! What can go wrong when a shape, a digitisation or a noise is asked for.

use thiserror::Error;

/// A shape, digitisation or noise that cannot be made as asked.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ShapeError {
    /// No shape has this name.
    #[error("unknown shape `{name}`; the known shapes are {known}")]
    UnknownShape {
        /// The name asked for.
        name: String,
        /// All known names, separated by commas.
        known: String,
    },
    /// The shape has no such parameter.
    #[error("shape `{shape}` has no parameter `{name}`; its parameters are: {known}")]
    UnknownParameter {
        /// The shape.
        shape: &'static str,
        /// The parameter asked for.
        name: String,
        /// The parameters it has, separated by commas, or `none`.
        known: String,
    },
    /// The same parameter is given twice.
    #[error("parameter `{name}` of shape `{shape}` is given twice")]
    RepeatedParameter {
        /// The shape.
        shape: &'static str,
        /// The parameter.
        name: String,
    },
    /// A parameter has a value that makes no shape.
    #[error("parameter `{name}` of shape `{shape}` is {value}, expected {expected}")]
    Parameter {
        /// The shape.
        shape: &'static str,
        /// The parameter.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// The text of a shape cannot be read.
    #[error("cannot read `{found}` in shape `{spec}`, expected name:parameter=number,...")]
    Spec {
        /// The whole text.
        spec: String,
        /// The part that cannot be read.
        found: String,
    },
    /// The spacing of the grid is not a positive finite length.
    #[error("voxel spacing along {axis} is {value}, expected a finite length above 0")]
    Spacing {
        /// `x`, `y` or `z`.
        axis: char,
        /// The spacing given, in world units.
        value: f64,
    },
    /// The offset of the grid is more than one voxel.
    #[error("grid offset along {axis} is {value} voxels, expected a number from -1 to 1")]
    Offset {
        /// `x`, `y` or `z`.
        axis: char,
        /// The offset given, in voxels.
        value: f64,
    },
    /// The digitisation would have too many voxels along an axis.
    #[error(
        "digitisation needs {voxels:.3e} voxels along {axis}, at most {limit} are possible; \
         take a larger gridstep"
    )]
    TooManyVoxels {
        /// `x`, `y` or `z`.
        axis: char,
        /// How many voxels it would have (a float: it may be beyond any integer).
        voxels: f64,
        /// How many are possible.
        limit: usize,
    },
    /// One plane of the digitisation would have too many voxels.
    #[error(
        "a plane of the digitisation has {nx} x {ny} voxels, at most {limit} are possible; \
         take a larger gridstep"
    )]
    PlaneTooLarge {
        /// Voxels along x.
        nx: usize,
        /// Voxels along y.
        ny: usize,
        /// How many are possible in one plane.
        limit: usize,
    },
    /// The probability of the noise is out of range.
    #[error("noise probability is {value}, expected a number from 0 to {limit}")]
    NoiseProbability {
        /// The probability given.
        value: f64,
        /// The largest possible.
        limit: f64,
    },
    /// The blur or the grey noise of a scanner is out of range.
    #[error("{what} is {value}, expected a number from 0 to {limit}")]
    Scanner {
        /// `blur` or `grey noise`.
        what: &'static str,
        /// The width given.
        value: f64,
        /// The largest possible.
        limit: f64,
    },
}
