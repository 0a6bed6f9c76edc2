//! Curvatures by plain digital integral invariants, by their definition.
//!
//! In: a solid, its surface, a radius. Out: curvatures per surfel, from the voxels of the solid in
//! the balls around its inner and its outer voxel, counted one by one. No normals, no measures.

use std::f64::consts::PI;

use super::Curvature;
use super::algebra::{ENTRIES, Symmetric, eigen};
use super::solid::{LatticeBall, Scale, Solid};
use super::surface::Surface;
use super::walk::ball_reach;

/// Number of voxels and covariance about their mean, in the units of `scale`.
fn spread(solid: &Solid, scale: &Scale, ball: &LatticeBall, centre: [i32; 3]) -> (f64, Symmetric) {
    let [rx, ry, rz] = ball_reach(ball);
    let (mut count, mut first, mut second) = (0.0, [0.0; 3], [0.0; 6]);
    for z in -rz..=rz {
        for y in -ry..=ry {
            for x in -rx..=rx {
                let d = [x, y, z];
                if !ball.has(d) || !solid.is_inside([0, 1, 2].map(|a| centre[a] + d[a])) {
                    continue;
                }
                let at = [0, 1, 2].map(|a| f64::from(d[a]) * scale.edges[a]);
                count += 1.0;
                (0..3).for_each(|a| first[a] += at[a]);
                for (e, (a, b)) in ENTRIES.into_iter().enumerate() {
                    second[e] += at[a] * at[b];
                }
            }
        }
    }
    if count > 0.0 {
        for (e, (a, b)) in ENTRIES.into_iter().enumerate() {
            second[e] -= first[a] * first[b] / count;
        }
    }
    (count, second)
}

/// The curvatures of all surfels at a radius in world units.
pub fn curvatures(
    solid: &Solid,
    surface: &Surface,
    scale: &Scale,
    radius_world: f64,
) -> Vec<Curvature> {
    let r = radius_world / scale.unit_world;
    let ball = LatticeBall::on_voxels(scale, r);
    let voxel: f64 = scale.edges.iter().product();
    let unit = scale.unit_world;
    surface
        .surfels
        .iter()
        .map(|surfel| {
            let inner = spread(solid, scale, &ball, surfel.inner());
            let outer = spread(solid, scale, &ball, surfel.outer());
            let volume = 0.5 * (inner.0 + outer.0) * voxel;
            let mut covariance = [0.0; 6];
            (0..6).for_each(|e| covariance[e] = 0.5 * (inner.1[e] + outer.1[e]) * voxel);
            let (values, vectors) = eigen(covariance);
            let principal = |own: f64, other: f64| {
                6.0 / (PI * r.powi(6)) * (other - 3.0 * own) + 8.0 / (5.0 * r)
            };
            let k1 = principal(values[2], values[1]);
            let k2 = principal(values[1], values[2]);
            Curvature {
                quality: f64::NAN,
                mean: (8.0 / (3.0 * r) - 4.0 * volume / (PI * r.powi(4))) / unit,
                gaussian: k1 * k2 / (unit * unit),
                k1: k1 / unit,
                k2: k2 / unit,
                d1: vectors[2],
                d2: vectors[1],
            }
        })
        .collect()
}
