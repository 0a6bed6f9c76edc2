//! Tests of the plain reference.

/// Volumes to test with.
mod volumes;

/// Theorems in integers: how cells join, Euler characteristics, the sum of mu2.
mod topology;

/// What the measures of known shapes must be; symmetries; balls against brute force.
mod geometry;

/// DGtal's numbers, if they are at hand.
mod agreement;

/// What DGtal's cells and walk do on small solids.
mod dgtal;

/// What the writers of meshes refuse.
mod meshes;

/// The experiments of the paper, quickly.
mod paper;
