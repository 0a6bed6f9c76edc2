//! Evaluates the cells of a brick, whatever the field of normals is.

use glam::DVec3;

use crate::surfel::CellBox;

use super::cells::{Asked, CellMeasures, CellTotals};
use super::surface::Surface;
use super::{constant, continuous};

/// Evaluates the cells of `core` on a surface that covers one cell more on each side.
///
/// `u` and `marks` are those of all surfels of the surface; the marks of the core are completed
/// with [`super::cells::mark::LIFTED`], [`super::cells::mark::OPPOSED`] and [`super::cells::mark::NEAR_CUT`].
///
/// # Panics
/// With a continuous field, if the surface does not cover the cells around the core.
#[must_use]
pub fn evaluate(
    surface: &Surface,
    core: CellBox,
    edges: [f64; 3],
    u: &[DVec3],
    marks: &[u8],
    asked: Asked,
) -> (CellMeasures, CellTotals) {
    if asked.field.is_continuous() {
        continuous::evaluate(surface, core, edges, u, marks, asked)
    } else {
        constant::evaluate(surface, core, edges, u, marks, asked)
    }
}
