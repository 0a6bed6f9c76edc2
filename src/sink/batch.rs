//! Rows of the surfel table, as columns.

/// Rows of consecutive surfels in Khalimsky order, as columns of equal length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfelBatch {
    /// Column of parts all these rows belong to, along x and y.
    pub column: [u32; 2],
    /// Khalimsky (doubled) coordinates `kx ky kz`: exactly one of the three is even.
    pub k: [Vec<i32>; 3],
    /// Outward sign along the even axis: +1 or -1.
    pub side: Vec<i8>,
    /// World coordinates of the surfel's centre.
    pub position: [Vec<f32>; 3],
    /// Unit corrected normal `u`, outward, in world axes.
    pub normal: [Vec<f32>; 3],
    /// Corrected area of the surfel itself, mu0, the integral of <u, n> over it, in world units squared.
    pub area: Vec<f32>,
    /// Curvatures, one entry per measure radius, in the order asked.
    pub curvatures: Vec<CurvatureColumns>,
}

/// Curvatures of the rows of a batch at one measure radius.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CurvatureColumns {
    /// Mean curvature H = mu1 / (2 mu0), in 1/world-unit; NaN where mu0 of the ball is not positive.
    pub mean: Vec<f32>,
    /// Gaussian curvature G = mu2 / mu0, in 1/world-unit squared.
    pub gaussian: Vec<f32>,
    /// Smaller principal curvature, in 1/world-unit.
    pub k1: Vec<f32>,
    /// Larger principal curvature, in 1/world-unit.
    pub k2: Vec<f32>,
    /// Direction of `k1`, in world axes, sign arbitrary; empty unless directions were asked for.
    pub d1: [Vec<f32>; 3],
    /// Direction of `k2`, in world axes, sign arbitrary; empty unless directions were asked for.
    pub d2: [Vec<f32>; 3],
    /// Error to expect of `mean`, in 1/world-unit: see [`crate::curvature::uncertainty`]; empty for methods that give
    /// none, NaN on islands and where no normal could be estimated.
    pub mean_error: Vec<f32>,
    /// The same of `gaussian`, in 1/world-unit squared.
    pub gaussian_error: Vec<f32>,
    /// Quality of the normals, mu_Omega / mu0, in 1/world-unit; empty unless it was asked for.
    pub quality: Vec<f32>,
    /// What to know before trusting the row: see [`Flag`].
    pub flags: Vec<FlagSet>,
}

/// Several [`Flag`]s as bits.
pub type FlagSet = u16;

/// A reason to look twice at a row, one bit each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Flag {
    /// The neighbourhood is cut by the border of the image.
    Border = 1 << 0,
    /// The ball holds other sheets of the surface that are not connected to the surfel within it.
    SeveralSheets = 1 << 1,
    /// The connected surface part is closed and lies wholly within the ball.
    Island = 1 << 2,
    /// |k1| or |k2| exceeds 1/radius: the feature is smaller than the ball.
    RadiusTooLarge = 1 << 3,
    /// The corrected normal does not point outward: <u, n> <= 0 (with a continuous field, on the average).
    NormalOpposed = 1 << 4,
    /// The normals around a pointel of this surfel (with a continuous field: on this surfel) wind more
    /// than a hemisphere: the lift k is not 0.
    Lifted = 1 << 5,
    /// No normal could be estimated; the trivial normal was used.
    DegenerateNormal = 1 << 6,
    /// mu0 of the ball is not positive: the curvatures are NaN.
    NoArea = 1 << 7,
    /// Noise, or walls, pits and tips one voxel thick: on a sheet that thin, values are those of noise.
    Rough = 1 << 8,
}

impl Flag {
    /// All flags, lowest bit first.
    pub const ALL: [Flag; 9] = [
        Flag::Border,
        Flag::SeveralSheets,
        Flag::Island,
        Flag::RadiusTooLarge,
        Flag::NormalOpposed,
        Flag::Lifted,
        Flag::DegenerateNormal,
        Flag::NoArea,
        Flag::Rough,
    ];

    /// The bit of this flag in a [`FlagSet`].
    #[must_use]
    pub const fn bit(self) -> FlagSet {
        self as FlagSet
    }

    /// The name used in schemas and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Flag::Border => "border",
            Flag::SeveralSheets => "several_sheets",
            Flag::Island => "island",
            Flag::RadiusTooLarge => "radius_too_large",
            Flag::NormalOpposed => "normal_opposed",
            Flag::Lifted => "lifted",
            Flag::DegenerateNormal => "degenerate_normal",
            Flag::NoArea => "no_area",
            Flag::Rough => "rough",
        }
    }
}

impl SurfelBatch {
    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.side.len()
    }

    /// Whether there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.side.is_empty()
    }
}
