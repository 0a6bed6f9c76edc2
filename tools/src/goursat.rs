//! The Goursat polynomial of the paper (section 6.1), digitised.

use crate::plain::Solid;

/// The shape lies in the box of this half-width, in world units.
const HALF_BOX: f64 = 10.0;

/// Voxels added on each side of the box.
const RIM: i32 = 5;

/// The Gauss digitisation of {4 - 0.015 (x^4 + y^4 + z^4) + x^2 + y^2 + z^2 >= 0} in [-10, 10]^3
/// enlarged by 5 voxels, and the index of the voxel at the origin along each axis.
pub fn digitised(gridstep: f64) -> (Solid, i32) {
    let origin = (HALF_BOX / gridstep).round() as i32 + RIM;
    let width = (2 * origin + 1) as usize;
    let solid = Solid::from_fn([width; 3], |voxel| {
        let [x, y, z] = voxel.map(|i| f64::from(i - origin) * gridstep);
        let (xx, yy, zz) = (x * x, y * y, z * z);
        4.0 - 0.015 * (xx * xx + yy * yy + zz * zz) + xx + yy + zz >= 0.0
    });
    (solid, origin)
}
