//! Pictures of what a run left.
//!
//! Comes in: the surfel table of a curvox output, or one of its slices. Goes out: a PNG file.
//!
//! A surfel is drawn as the parallelogram it is in the world, seen along one direction (no
//! perspective), coloured by a curvature and shaded by its corrected normal:
//!
//! ```text
//!            up          right, up and eye are unit vectors at right angles;
//!            |           eye points from the scene to the viewer, and up is as near
//!            o--- right  to world z as can be
//!         eye (out of the page)
//! ```
//!
//! Guaranteed: the same rows and options give the same pixels on every machine, in whatever
//! batches the rows come; memory depends on the size of the picture, not on the number of rows,
//! which are read twice. Not guaranteed: that thin parts show where a surfel is smaller than a
//! quarter of a pixel.

mod bar;
mod colours;
mod command;
mod glyphs;
mod image;
mod montage;
mod png;
mod raster;
mod slice;
mod surfels;
mod view;

#[cfg(test)]
mod tests;

pub use bar::Bar;
pub use colours::ColourMap;
pub use command::PictureArgs;
pub use image::Image;
pub use montage::Montage;
pub use slice::slice_preview;
pub use surfels::{PictureOptions, Scene, Stick, draw_surfels};
pub use view::{Frame, View};
