//! The rule that cuts the surfel table into parts.
//!
//! Comes in: the dimensions of the image. Goes out: for each surfel, the part that holds it. The
//! rule knows nothing of bricks, slabs, threads or memory, so that any run over the same image
//! leaves the same parts.
//!
//! A part is a box of [`PART_PLANES`] planes by at most [`PART_EDGE`] x [`PART_EDGE`] voxels. A
//! surfel belongs to the voxel cell `floor(K / 2)`; on the far border of a closed image, where
//! that would be one beyond, to the last cell. Parts count along x, then y, then z:
//!
//! ```text
//! part = (layer * columns_y + cy) * columns_x + cx
//! ```

/// Planes in a part. More: fewer files, but more is lost when a run is killed, and fewer shards.
pub const PART_PLANES: u32 = 64;

/// Voxels in a part along x and y. Smaller: whole planes of usual scans would fall in columns.
pub const PART_EDGE: u32 = 8192;

/// How an image of given dimensions is cut into parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    dims: [u32; 3],
}

impl Parts {
    /// The parts of an image of `dims` voxels (x, y, z).
    #[must_use]
    pub fn new(dims: [u32; 3]) -> Self {
        Self { dims }
    }

    /// Columns of parts along x and y; never 0.
    #[must_use]
    pub fn columns(&self) -> [u32; 2] {
        [
            self.dims[0].div_ceil(PART_EDGE).max(1),
            self.dims[1].div_ceil(PART_EDGE).max(1),
        ]
    }

    /// Layers of parts along z; never 0.
    #[must_use]
    pub fn layers(&self) -> u32 {
        self.dims[2].div_ceil(PART_PLANES).max(1)
    }

    /// Number of parts, with or without surfels.
    #[must_use]
    pub fn count(&self) -> u64 {
        let [x, y] = self.columns();
        u64::from(x) * u64::from(y) * u64::from(self.layers())
    }

    /// The part that holds the surfel with Khalimsky coordinates `k`.
    #[must_use]
    pub fn part_of(&self, k: [i32; 3]) -> u64 {
        self.index(self.layer_of(k[2]), self.column_of(k))
    }

    /// The index of the part in a layer and a column.
    #[must_use]
    pub fn index(&self, layer: u32, column: [u32; 2]) -> u64 {
        let [columns_x, columns_y] = self.columns().map(u64::from);
        (u64::from(layer) * columns_y + u64::from(column[1])) * columns_x + u64::from(column[0])
    }

    /// The layer that holds surfels with this `kz`.
    #[must_use]
    pub fn layer_of(&self, kz: i32) -> u32 {
        self.cell(kz, 2) / PART_PLANES
    }

    /// The column that holds the surfel with Khalimsky coordinates `k`.
    #[must_use]
    pub fn column_of(&self, k: [i32; 3]) -> [u32; 2] {
        [
            self.cell(k[0], 0) / PART_EDGE,
            self.cell(k[1], 1) / PART_EDGE,
        ]
    }

    /// The voxel cell of a Khalimsky coordinate, clamped to the image.
    fn cell(&self, k: i32, axis: usize) -> u32 {
        // A negative coordinate is outside any image; the nearest cell is the first.
        let cell = u32::try_from(k.div_euclid(2)).unwrap_or(0);
        cell.min(self.dims[axis].saturating_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn small_image_is_one_part() {
        let parts = Parts::new([100, 80, 64]);
        assert_eq!((parts.count(), parts.columns()), (1, [1, 1]));
        assert_eq!(parts.part_of([200, 159, 127]), 0);
    }

    #[test]
    fn far_border_of_a_closed_image_belongs_to_the_last_part() {
        let parts = Parts::new([8192, 3, 128]);
        assert_eq!(parts.part_of([2 * 8192, 1, 1]), 0);
        assert_eq!(parts.part_of([1, 1, 256]), 1);
        assert_eq!(parts.part_of([1, 1, 128]), 1);
        assert_eq!(parts.part_of([1, 1, 127]), 0);
    }

    #[test]
    fn parts_count_along_x_then_y_then_z() {
        let parts = Parts::new([8193, 16385, 65]);
        assert_eq!(parts.columns(), [2, 3]);
        assert_eq!(parts.count(), 12);
        assert_eq!(parts.part_of([2 * 8192 + 1, 1, 1]), 1);
        assert_eq!(parts.part_of([1, 2 * 8192 + 1, 1]), 2);
        assert_eq!(parts.part_of([2 * 8192 + 1, 2 * 16384 + 1, 129]), 11);
    }

    proptest! {
        #[test]
        fn each_surfel_has_a_part_below_the_count(
            dims in [1_u32..20_000, 1_u32..20_000, 1_u32..5_000],
            at in [0.0_f64..=1.0, 0.0_f64..=1.0, 0.0_f64..=1.0],
        ) {
            let parts = Parts::new(dims);
            let k = [0, 1, 2].map(|a| (f64::from(dims[a]) * 2.0 * at[a]) as i32);
            prop_assert!(parts.part_of(k) < parts.count());
        }
    }
}
