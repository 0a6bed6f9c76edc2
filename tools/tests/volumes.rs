//! Volumes to test with.

use curvox_tools::plain::{Estimator, Orientation, Solid};

/// Each voxel is inside with probability `p`.
pub(crate) fn noise(dims: [usize; 3], p: f64, seed: u64) -> Solid {
    // SplitMix64: a counter, scrambled.
    let mut state = seed;
    let mut random = move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    };
    let inside = (0..dims.iter().product()).map(|_| random() < p).collect();
    Solid { dims, inside }
}

/// The ball of this radius (in world units) in the middle of an image with some space around it.
pub(crate) fn ball(radius_world: f64, spacing_world: [f64; 3]) -> Solid {
    let centre = spacing_world.map(|s| (radius_world / s).ceil() as i32 + 3);
    let dims = centre.map(|c| 2 * c as usize + 1);
    Solid::from_fn(dims, |voxel| {
        let d = [0, 1, 2].map(|a| f64::from(voxel[a] - centre[a]) * spacing_world[a]);
        d[0] * d[0] + d[1] * d[1] + d[2] * d[2] <= radius_world * radius_world
    })
}

/// Two balls grown together, without symmetry, voxels of 1.
pub(crate) fn pear() -> Solid {
    Solid::from_fn([26, 24, 22], |[x, y, z]| {
        let within = |cx: f64, cy: f64, cz: f64, r: f64| {
            let d = [f64::from(x) - cx, f64::from(y) - cy, f64::from(z) - cz];
            d[0] * d[0] + d[1] * d[1] + d[2] * d[2] <= r * r
        };
        within(9.2, 10.1, 9.3, 6.4) || within(15.3, 13.2, 12.4, 5.1)
    })
}

/// Every estimator, with this radius.
pub(crate) fn estimators(radius_world: f64) -> [Estimator; 4] {
    [
        Estimator::Trivial,
        Estimator::IntegralInvariant {
            radius_world,
            orientation: Orientation::Moment,
        },
        Estimator::IntegralInvariant {
            radius_world,
            orientation: Orientation::Dgtal,
        },
        Estimator::SurfaceAverage { radius_world },
    ]
}
