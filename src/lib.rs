//! Corrected curvature measures of huge 3D images, streamed brick by brick.

pub mod error;

pub mod khalimsky;

pub mod lattice;

pub mod volume;

pub mod surfel;

pub mod symmetric;

pub mod normal;

pub mod measure;

pub mod curvature;

pub mod sink;

pub mod brick;

pub mod pipeline;

pub use error::Error;
