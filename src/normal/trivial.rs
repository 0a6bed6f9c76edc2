//! u = n, the surfel's own direction (paper, section 6.1.3, TN). With it the corrected normal
//! current is the normal cycle of the voxels: neither accurate nor convergent, kept to compare.

use crate::surfel::Surfels;

use super::{Normals, trivial_normal};

/// Trivial normals of surfels.
#[must_use]
pub fn estimate(surfels: &Surfels) -> Normals {
    Normals {
        u: surfels
            .list
            .iter()
            .map(|s| trivial_normal(s.orientation))
            .collect(),
        degenerate: vec![false; surfels.list.len()],
    }
}
