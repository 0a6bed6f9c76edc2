//! Where the solid meets the border of an open image.

use crate::lattice::Lattice;
use crate::volume::BitBox;

/// The faces of the image that a box leaves, with the voxels of the solid on them counted.
pub(super) struct Border {
    faces: Vec<Face>,
}

/// A face of the image within the box.
struct Face {
    axis: usize,
    /// Plane of voxels, 0 or the last, and which.
    at: i32,
    above: bool,
    /// The part of the face that is in the box, along the two other axes.
    lo: [i32; 2],
    hi: [i32; 2],
    /// Voxels of the solid in the rectangle from `lo` to below (x, y): rows of `hi - lo + 1`.
    sums: Vec<u32>,
}

/// The two other axes.
fn others(axis: usize) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][axis]
}

impl Border {
    /// Counts the solid on the faces of the image that the voxels `lo <= p < hi`, all in `bits`, leave.
    pub(super) fn count(bits: &BitBox, lo: [i32; 3], hi: [i32; 3], lattice: &Lattice) -> Self {
        let mut faces = Vec::new();
        let last = lattice.dims.map(|n| n as i32 - 1);
        for axis in 0..3 {
            for (above, leaves, at) in [
                (false, lo[axis] < 0, 0),
                (true, hi[axis] - 1 > last[axis], last[axis]),
            ] {
                if !leaves {
                    continue;
                }
                let [a, b] = others(axis);
                let from = [a, b].map(|i| lo[i].max(0));
                let to = [a, b].map(|i| hi[i].min(last[i] + 1));
                let width = (to[0] - from[0] + 1) as usize;
                let mut sums = vec![0; width];
                for q in from[1]..to[1] {
                    let (mut row, above) = (0, sums.len() - width);
                    sums.push(0);
                    for p in from[0]..to[0] {
                        let mut voxel = [at; 3];
                        (voxel[a], voxel[b]) = (p, q);
                        row += u32::from(bits.inside(voxel));
                        sums.push(row + sums[above + (p - from[0]) as usize + 1]);
                    }
                }
                if sums.last().is_some_and(|&all| all > 0) {
                    faces.push(Face {
                        axis,
                        at,
                        above,
                        lo: from,
                        hi: to,
                        sums,
                    });
                }
            }
        }
        Self { faces }
    }

    /// Whether the box `lo <= p < hi` leaves the image where the solid meets its border.
    pub(super) fn is_met(&self, lo: [i32; 3], hi: [i32; 3]) -> bool {
        self.faces.iter().any(|face| {
            let leaves = if face.above {
                hi[face.axis] - 1 > face.at
            } else {
                lo[face.axis] < 0
            };
            leaves && face.count(lo, hi) > 0
        })
    }
}

impl Face {
    /// Voxels of the solid on the part of the face in the box `lo <= p < hi`.
    fn count(&self, lo: [i32; 3], hi: [i32; 3]) -> u32 {
        let axes = others(self.axis);
        let place = |corner: [i32; 3]| {
            [0, 1].map(|i| (corner[axes[i]].clamp(self.lo[i], self.hi[i]) - self.lo[i]) as usize)
        };
        let width = (self.hi[0] - self.lo[0] + 1) as usize;
        let ([x0, y0], [x1, y1]) = (place(lo), place(hi));
        let below = |x: usize, y: usize| self.sums[y * width + x];
        below(x1, y1) + below(x0, y0) - below(x0, y1) - below(x1, y0)
    }
}
