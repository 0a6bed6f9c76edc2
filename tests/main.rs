//! Integration tests: the definitions, the theorems and the promises of curvox, as facts.

/// Volumes to test with, and ways to run the production code on them.
mod common;

/// Production agrees with the plain reference, surfel by surfel.
mod agreement;

/// Gauss-Bonnet and Euler characteristics, in integers.
mod topology;

/// How a volume is cut does not show.
mod brick_invariance;

/// What is beyond the border of the image is unknown, and says so.
mod border;

/// Mirrored, rotated and transposed volumes give the same values.
mod symmetry;

/// Shapes of known curvature.
mod analytic;

/// The binary, run as a user would.
mod cli;
