//! The solid, the size of its voxels, and balls in exact integers.

/// A set of voxels in an image; voxels outside of the image are outside of the solid.
#[derive(Clone, Debug)]
pub struct Solid {
    /// Voxels along x, y, z.
    pub dims: [usize; 3],
    /// Is the voxel inside? x fastest.
    pub inside: Vec<bool>,
}

impl Solid {
    /// The voxels where `inside([x, y, z])` holds.
    pub fn from_fn(dims: [usize; 3], inside: impl Fn([i32; 3]) -> bool) -> Self {
        let mut bits = Vec::with_capacity(dims.iter().product());
        for z in 0..dims[2] {
            for y in 0..dims[1] {
                for x in 0..dims[0] {
                    bits.push(inside([x as i32, y as i32, z as i32]));
                }
            }
        }
        Solid { dims, inside: bits }
    }

    /// Does the image have this voxel?
    pub fn has(&self, voxel: [i32; 3]) -> bool {
        (0..3).all(|a| voxel[a] >= 0 && (voxel[a] as usize) < self.dims[a])
    }

    /// Is this voxel of the image, or outside of the image, inside the solid?
    pub fn is_inside(&self, voxel: [i32; 3]) -> bool {
        self.has(voxel) && self.inside[self.index(voxel)]
    }

    /// Index in `inside` of a voxel of the image.
    pub fn index(&self, [x, y, z]: [i32; 3]) -> usize {
        (z as usize * self.dims[1] + y as usize) * self.dims[0] + x as usize
    }
}

/// The unit of length of all computations: the longest edge of a voxel.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Edges of a voxel along x, y, z, divided by the longest: at most 1.
    pub edges: [f64; 3],
    /// The longest edge, in world units.
    pub unit_world: f64,
}

impl Scale {
    /// The scale of an image of this spacing (world units).
    ///
    /// # Panics
    /// If an edge is not positive and finite.
    pub fn new(spacing_world: [f64; 3]) -> Self {
        let unit_world = spacing_world.into_iter().fold(0.0, f64::max);
        assert!(
            spacing_world.iter().all(|&s| s > 0.0 && s.is_finite()),
            "spacing {spacing_world:?} is not positive"
        );
        Scale {
            edges: spacing_world.map(|s| s / unit_world),
            unit_world,
        }
    }

    /// Are the voxels cubes?
    pub fn is_cubic(&self) -> bool {
        self.edges == [1.0; 3]
    }

    /// Area of a surfel orthogonal to `axis`, in squared units.
    pub fn area(&self, axis: usize) -> f64 {
        self.edges[(axis + 1) % 3] * self.edges[(axis + 2) % 3]
    }
}

/// A closed ball in the lattice of voxels or of Khalimsky coordinates, in pure integers:
/// `d` belongs to it if `sum weights[a] d[a]^2 <= threshold`.
#[derive(Clone, Copy, Debug)]
pub struct LatticeBall {
    /// 1 for cubes, else squared edges in units of 2^-20.
    pub weights: [i64; 3],
    /// The largest weighted square that belongs to the ball.
    pub threshold: i64,
    /// The squared radius in the unit of the weighted squares, not rounded down.
    pub squared_radius: f64,
}

impl LatticeBall {
    /// The ball of `radius` (in units of [`Scale`]) on voxels.
    pub fn on_voxels(scale: &Scale, radius: f64) -> Self {
        Self::new(scale, radius * radius)
    }

    /// The ball of `radius` (in units of [`Scale`]) on Khalimsky coordinates, which count halves.
    pub fn on_khalimsky(scale: &Scale, radius: f64) -> Self {
        Self::new(scale, 4.0 * radius * radius)
    }

    fn new(scale: &Scale, squared: f64) -> Self {
        assert!(
            squared > 0.0 && squared < 1e9,
            "squared radius {squared} is out of range"
        );
        if scale.is_cubic() {
            let squared_radius = snapped(squared);
            LatticeBall {
                weights: [1; 3],
                threshold: squared_radius.floor() as i64,
                squared_radius,
            }
        } else {
            const UNIT: f64 = (1u64 << 20) as f64;
            LatticeBall {
                weights: scale.edges.map(|s| (s * s * UNIT).round() as i64),
                threshold: (squared * UNIT * (1.0 + 1e-12)).floor() as i64,
                squared_radius: squared * UNIT,
            }
        }
    }

    /// Weighted square of the length of `d`.
    pub fn square(&self, d: [i32; 3]) -> i64 {
        (0..3)
            .map(|a| self.weights[a] * i64::from(d[a]) * i64::from(d[a]))
            .sum()
    }

    /// Does `d` belong to the ball?
    pub fn has(&self, d: [i32; 3]) -> bool {
        self.square(d) <= self.threshold
    }

    /// The largest extent along `axis` in the ball, given the part of the weighted square already spent.
    pub fn half_width(&self, axis: usize, spent: i64) -> Option<i32> {
        let rest = self.threshold - spent;
        (rest >= 0).then(|| (rest / self.weights[axis]).isqrt() as i32)
    }
}

/// Squared radii such as (3/sqrt(h))^2 are meant to be integers; rounding must not lose a tie.
pub fn snapped(squared: f64) -> f64 {
    let nearest = squared.round();
    if (squared - nearest).abs() <= 1e-9 * nearest {
        nearest
    } else {
        squared
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radius_meant_to_be_a_root_keeps_its_ties() {
        let scale = Scale::new([0.5; 3]);
        let ball = LatticeBall::on_voxels(&scale, 3.0 * 0.5f64.sqrt() / 0.5);
        assert_eq!(ball.threshold, 18);
        assert!(ball.has([3, 3, 0]) && !ball.has([3, 3, 1]));
    }

    #[test]
    fn half_widths_and_membership_agree_on_boxes() {
        let scale = Scale::new([0.4, 1.0, 2.5]);
        let ball = LatticeBall::on_voxels(&scale, 3.0);
        for z in -4..=4 {
            for y in -9..=9 {
                let half = ball.half_width(0, ball.square([0, y, z]));
                for x in -25..=25i32 {
                    assert_eq!(
                        ball.has([x, y, z]),
                        half.is_some_and(|half| x.abs() <= half)
                    );
                }
            }
        }
    }
}
