//! DGtal's numbers on Goursat's surface, to set ours beside.
//!
//! Measured with DGtal 2.1.1, development head (commit 1574af90 of 2026-06-07), C++20, g++ 12.2,
//! `-O3 -DNDEBUG -march=native`, Eigen 3.4, Boost 1.74. Corrected curvatures (CNC): u and measures at
//! radius 3 h^(1/2); VCM with R = 10 h^(1/2); plain integral invariants: r' = 6 h^(1/3). Errors over
//! all surfels against the curvature at the exact closest point. Times are processor time of one
//! thread of a shared x86-64 Xeon, with the sums over balls timed on at most about 22000 surfels.

use super::slopes::Norm;

/// Gridsteps of the tables below.
pub const GRIDSTEPS: [f64; 5] = [1.0, 0.5, 0.25, 0.125, 0.0625];

/// Surfels at each gridstep.
pub const SURFELS: [usize; 5] = [2454, 9510, 37590, 151_374, 604_278];

/// A quantity with known errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// H and G by corrected measures, u = II.
    Mean,
    /// See `Mean`.
    Gaussian,
    /// H and G by corrected measures, u = VCM.
    MeanVcm,
    /// See `MeanVcm`.
    GaussianVcm,
    /// H and G by the normal cycle.
    MeanTrivial,
    /// See `MeanTrivial`.
    GaussianTrivial,
    /// H and G by plain integral invariants.
    MeanPlain,
    /// See `MeanPlain`.
    GaussianPlain,
    /// Principal curvatures by corrected measures, u = II.
    K1,
    /// See `K1`.
    K2,
    /// Normals, in radians.
    NormalIi,
    /// See `NormalIi`.
    NormalVcm,
}

/// l2 and linf of the errors of a quantity at each gridstep; NaN where it was not computed.
const fn table(quantity: Quantity) -> [[f64; 2]; 5] {
    const NONE: [f64; 2] = [f64::NAN; 2];
    match quantity {
        Quantity::Mean => [
            [0.03083, 0.10191],
            [0.02694, 0.09113],
            [0.01023, 0.04350],
            [0.00807, 0.03742],
            [0.00356, 0.01632],
        ],
        Quantity::Gaussian => [
            [0.01122, 0.06051],
            [0.00922, 0.05329],
            [0.00425, 0.02987],
            [0.00322, 0.02524],
            [0.00138, 0.01131],
        ],
        Quantity::MeanVcm => [
            [0.04054, 0.13435],
            [0.02471, 0.08536],
            [0.01127, 0.04938],
            [0.00634, 0.03496],
            [0.00352, 0.02042],
        ],
        Quantity::GaussianVcm => [
            [0.01446, 0.07125],
            [0.00894, 0.05131],
            [0.00449, 0.03262],
            [0.00270, 0.02348],
            [0.00138, 0.01383],
        ],
        Quantity::MeanTrivial => [
            [0.06964, 0.12899],
            [0.05619, 0.14804],
            [0.06161, 0.19804],
            [0.06532, 0.19287],
            [0.06775, 0.43153],
        ],
        Quantity::GaussianTrivial => [
            [0.06562, 0.22422],
            [0.06913, 0.21774],
            [0.18632, 0.69277],
            [0.43506, 2.11805],
            [1.01458, 6.39690],
        ],
        Quantity::MeanPlain => [
            [0.03709, 0.11974],
            [0.03055, 0.08608],
            [0.02138, 0.07214],
            [0.01662, 0.05169],
            NONE,
        ],
        Quantity::GaussianPlain => [
            [0.01453, 0.07553],
            [0.01182, 0.06390],
            [0.00909, 0.05492],
            [0.00663, 0.04198],
            NONE,
        ],
        Quantity::K1 => [
            [0.02821, 0.12094],
            [0.02054, 0.09492],
            [0.00958, 0.05524],
            [0.00762, 0.04382],
            [0.00411, 0.02087],
        ],
        Quantity::K2 => [
            [0.07751, 0.16821],
            [0.05955, 0.14370],
            [0.02871, 0.07581],
            [0.01901, 0.05549],
            [0.00840, 0.02539],
        ],
        Quantity::NormalIi => [
            [0.07073, 0.17756],
            [0.05876, 0.11810],
            [0.01830, 0.04921],
            [0.01324, 0.04243],
            [0.00682, 0.03047],
        ],
        Quantity::NormalVcm => [
            [0.11172, 0.18270],
            [0.05710, 0.11401],
            [0.02140, 0.04640],
            [0.01071, 0.03955],
            [0.00499, 0.02053],
        ],
    }
}

/// DGtal's error at a gridstep, if it was measured.
pub fn error(quantity: Quantity, gridstep: f64, norm: Norm) -> Option<f64> {
    let at = GRIDSTEPS.iter().position(|&h| h == gridstep)?;
    let column = match norm {
        Norm::L2 => 0,
        Norm::Linf => 1,
    };
    Some(table(quantity)[at][column]).filter(|error| error.is_finite())
}

/// Processor microseconds a surfel at each gridstep: normals by II, the mesh, and two sums over
/// balls, which is what H takes.
pub const MEAN_MICROSECONDS: [f64; 5] = [56.1, 105.0, 213.0, 720.0, 1390.0];

/// The same with normals by VCM.
pub const MEAN_VCM_MICROSECONDS: [f64; 5] = [95.0, 161.0, 255.0, 749.0, 1310.0];

/// H by plain integral invariants.
pub const PLAIN_MICROSECONDS: [f64; 4] = [13.9, 37.7, 112.0, 415.0];
