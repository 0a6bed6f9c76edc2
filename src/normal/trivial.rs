//! u = n, the surfel's own direction (paper, section 6.1.3, TN). With it the corrected normal
//! current is the normal cycle of the voxels: neither accurate nor convergent, kept to compare.

use crate::lattice::Lattice;
use crate::surfel::Surfels;

use super::{Normals, touches_border, trivial_normal};

/// Trivial normals of surfels.
#[must_use]
pub fn estimate(surfels: &Surfels, lattice: &Lattice) -> Normals {
    let count = surfels.list.len();
    Normals {
        u: surfels
            .list
            .iter()
            .map(|s| trivial_normal(s.orientation))
            .collect(),
        degenerate: vec![false; count],
        cut: (0..count)
            .map(|i| touches_border(surfels.oriented(i), lattice))
            .collect(),
        ..Normals::default()
    }
}
