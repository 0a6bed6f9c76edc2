//! The order in which a file stores the axes.
//!
//! In: which axis varies fastest, which next, which slowest. Out: where a voxel lies, and planes
//! brought into the canonical order, x fastest.

/// The axes (0 is x) from the fastest to the slowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct AxisOrder([usize; 3]);

impl AxisOrder {
    /// x varies fastest, then y: the canonical order.
    pub(crate) const X_FASTEST: Self = Self([0, 1, 2]);
    /// z varies fastest, then y.
    pub(crate) const Z_FASTEST: Self = Self([2, 1, 0]);

    /// The order in which `axes[0]` varies fastest; `axes` holds 0, 1 and 2 once each.
    pub(crate) fn of(axes: [usize; 3]) -> Self {
        debug_assert!([0, 1, 2].iter().all(|axis| axes.contains(axis)));
        Self(axes)
    }

    pub(crate) fn fastest(self) -> usize {
        self.0[0]
    }

    pub(crate) fn slowest(self) -> usize {
        self.0[2]
    }

    /// Whether planes of constant z are stored one behind the other, so that they can be given
    /// one by one while the file is read forward.
    pub(crate) fn has_whole_planes(self) -> bool {
        self.slowest() == 2
    }

    /// Voxels between neighbours along x, y and z, of a volume whose voxels fit `u64`.
    pub(crate) fn strides(self, dims: [u64; 3]) -> [u64; 3] {
        let [fast, middle, slow] = self.0;
        let mut strides = [1; 3];
        strides[middle] = dims[fast];
        strides[slow] = dims[fast] * dims[middle];
        strides
    }
}

/// Brings a plane of `nx` times `ny` voxels that is stored y fastest into the order x fastest.
/// `from` and `to` have the bytes of the plane.
pub(crate) fn transpose_plane(
    voxel_bytes: usize,
    nx: usize,
    ny: usize,
    from: &[u8],
    to: &mut [u8],
) {
    match voxel_bytes {
        1 => transpose::<1>(nx, ny, from, to),
        2 => transpose::<2>(nx, ny, from, to),
        4 => transpose::<4>(nx, ny, from, to),
        _ => transpose::<8>(nx, ny, from, to),
    }
}

fn transpose<const B: usize>(nx: usize, ny: usize, from: &[u8], to: &mut [u8]) {
    /// Columns written together, so that writes fill whole cache lines.
    const TILE: usize = 32;
    for first in (0..nx).step_by(TILE) {
        let end = (first + TILE).min(nx);
        for y in 0..ny {
            let row = &mut to[(y * nx + first) * B..(y * nx + end) * B];
            for (x, voxel) in (first..end).zip(row.chunks_exact_mut(B)) {
                let at = (x * ny + y) * B;
                voxel.copy_from_slice(&from[at..at + B]);
            }
        }
    }
}
