//! How corrected normals are continued over a surface, of voxels or of polygons.

/// How `u` is continued from surfels, or faces, to the whole surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Field {
    /// Constant on each surfel (paper, Proposition 3.8): measures lie on surfels, linels and pointels.
    #[default]
    Constant,
    /// Linear between pointels (bilinear on a surfel), brought to unit length (Example 2.4).
    Interpolated,
    /// Linear between pointels (Remark 2.11).
    Linear,
}

impl Field {
    /// Whether `u` is continuous, so that all measures lie on surfels.
    #[must_use]
    pub fn is_continuous(self) -> bool {
        self != Field::Constant
    }
}
