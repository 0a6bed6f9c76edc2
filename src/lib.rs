//! Corrected curvature measures of huge 3D images, streamed brick by brick.

pub mod shape;
