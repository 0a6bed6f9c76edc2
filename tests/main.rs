//! Integration tests: the definitions, the theorems and the promises of curvox, as facts.

/// Volumes to test with, and ways to run the production code on them.
mod common;

/// Production agrees with the plain reference, surfel by surfel.
mod accuracy;
mod agreement;

/// Gauss-Bonnet and Euler characteristics, in integers.
mod topology;

/// Theorems of the paper on digital surfaces.
mod theorems;

/// How a volume is cut does not show.
mod brick_invariance;

/// Volumes that are decoded in pieces, and those that are mostly uniform.
mod pieces;

/// Normals out of grey values.
mod grey;

/// What is beyond the border of the image is unknown, and says so.
mod border;

/// Mirrored, rotated and transposed volumes give the same values.
mod symmetry;

/// Normals by the Voronoi covariance measure.
mod voronoi;

/// Curvature by plain integral invariants.
mod invariants;

/// Shapes of known curvature.
mod analytic;

/// Theorems of meshes, and meshes with everything wrong.
mod mesh;

/// Schwarz's lantern.
mod lantern;

/// The binary, run as a user would.
mod cli;
/// Numbers from elsewhere: DGtal's tables, the truth, counted facts about volumes.
mod reference;

/// The built command, run as a user runs it.
#[cfg(all(unix, feature = "cli"))]
mod command;

/// The command on broken, strange and real files, and on one volume in many formats.
#[cfg(all(unix, feature = "cli"))]
mod hostile;

/// The command when something fails: outputs, inputs, pipes, signals.
#[cfg(all(unix, feature = "cli"))]
mod failures;
