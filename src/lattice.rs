//! Where voxels lie: extents, spacing, and the integer metric that decides what is in a ball.
//!
//! Inside, lengths are in *voxel units*: 1 is the **longest** edge of a voxel, written `vx` on the
//! command line. For cubic voxels that is the voxel itself. Conversion to world units happens
//! once, in [`crate::curvature`].
//!
//! Guaranteed: whether a point is in a ball is decided in integers (squared edges are fixed-point
//! numbers of 20 bits where voxels are not cubes), so it cannot depend on the order of
//! operations, the cut of the volume or the machine.

use std::fmt;

/// Fixed-point one of squared edges, for voxels that are not cubes.
const BOX_ONE: u64 = 1 << 20;

/// Radii of balls are bounded so that squared lengths in a ball, in voxels of any shape, fit 32 bits
/// and its rows stay short. Balls of measures are bounded further, by what a sum can hold: see [`crate::measure::fixed`].
pub const MAX_RADIUS: f64 = 63.0;

/// The largest extent of a volume along an axis: Khalimsky coordinates are `i32`.
pub const MAX_EXTENT: u64 = (1 << 30) - 2;

/// The voxel grid of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    /// Number of voxels along x, y, z.
    pub dims: [u32; 3],
    /// Edges of a voxel in world units.
    pub spacing: [f64; 3],
    /// World coordinates of the centre of voxel (0, 0, 0).
    pub origin: [f64; 3],
    /// World directions of the three axes (`direction[a]` is the unit vector of axis `a`).
    pub direction: [[f64; 3]; 3],
    /// Whether the outside of the image counts as known to be outside the solid, so that the
    /// surface closes on the image border. Otherwise the surface is open there.
    pub closed: bool,
}

/// Why a lattice or a radius cannot be used.
#[derive(Clone, Debug, PartialEq)]
pub enum LatticeError {
    /// An extent is zero or too large.
    Extent {
        /// 0, 1 or 2.
        axis: usize,
        /// Number of voxels asked.
        extent: u64,
    },
    /// A spacing is not a positive, finite length of usable magnitude.
    Spacing {
        /// 0, 1 or 2.
        axis: usize,
        /// The spacing given.
        spacing: f64,
    },
    /// The edges of the voxel differ so much that a ball cannot be resolved.
    Aspect([f64; 3]),
    /// A radius is not positive, not finite or above [`MAX_RADIUS`], in voxel units.
    Radius(f64),
    /// The width of a Gaussian cannot be used, in voxel units.
    Sigma {
        /// Width asked.
        sigma: f64,
        /// The least and the largest that can be used.
        limits: [f64; 2],
    },
    /// A ball of measures is larger than a sum can be.
    Ball {
        /// Radius asked, in voxel units.
        radius: f64,
        /// Largest radius for voxels of this shape.
        largest: f64,
    },
}

impl fmt::Display for LatticeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LatticeError::Extent { axis, extent } => write!(
                f,
                "extent along {} is {extent} voxels, expected 1 to {MAX_EXTENT}",
                ["x", "y", "z"][*axis]
            ),
            LatticeError::Spacing { axis, spacing } => write!(
                f,
                "spacing along {} is {spacing}, expected a positive length between 1e-18 and 1e18",
                ["x", "y", "z"][*axis]
            ),
            LatticeError::Aspect(s) => write!(
                f,
                "voxel edges {} x {} x {} differ by more than a factor of 256; resample the image",
                s[0], s[1], s[2]
            ),
            LatticeError::Ball { radius, largest } => write!(
                f,
                "a ball of measures of radius {radius} voxels is too large for voxels of this \
                 shape and these weights, expected at most {largest:.2}; take a smaller radius, or \
                 resample the image to larger voxels"
            ),
            LatticeError::Sigma {
                sigma,
                limits: [least, largest],
            } => write!(
                f,
                "sigma of {sigma} voxels, expected {least} to {largest:.2}"
            ),
            LatticeError::Radius(radius) => write!(
                f,
                "radius of {radius} voxels, expected more than 0 and at most {MAX_RADIUS}"
            ),
        }
    }
}

impl std::error::Error for LatticeError {}

impl Lattice {
    /// A lattice with axes along the world's and its first voxel at the origin.
    ///
    /// # Errors
    /// [`LatticeError`] for extents or spacings that cannot be used.
    pub fn new(dims: [u64; 3], spacing: [f64; 3], closed: bool) -> Result<Self, LatticeError> {
        let mut extents = [0; 3];
        for axis in 0..3 {
            extents[axis] = match u32::try_from(dims[axis]) {
                Ok(n) if n > 0 && dims[axis] <= MAX_EXTENT => n,
                _ => {
                    return Err(LatticeError::Extent {
                        axis,
                        extent: dims[axis],
                    });
                }
            };
            if !(1e-18..=1e18).contains(&spacing[axis]) {
                return Err(LatticeError::Spacing {
                    axis,
                    spacing: spacing[axis],
                });
            }
        }
        let longest = spacing.iter().copied().fold(0.0, f64::max);
        let shortest = spacing.iter().copied().fold(f64::INFINITY, f64::min);
        if longest > 256.0 * shortest {
            return Err(LatticeError::Aspect(spacing));
        }
        Ok(Self {
            dims: extents,
            spacing,
            origin: [0.0; 3],
            direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            closed,
        })
    }

    /// Length of one voxel unit (the longest edge) in world units.
    #[must_use]
    pub fn voxel_unit_world(&self) -> f64 {
        self.spacing.iter().copied().fold(0.0, f64::max)
    }

    /// Edges of a voxel in voxel units: at most 1, and exactly 1 for cubic voxels.
    #[must_use]
    pub fn edges(&self) -> [f64; 3] {
        let unit = self.voxel_unit_world();
        self.spacing.map(|s| s / unit)
    }

    /// Extents of the grid of cells that own surfels (see
    /// [`crate::khalimsky::OrientedSurfel::cell`]): one more than `dims` when surfels lie on the
    /// image border.
    #[must_use]
    pub fn cell_dims(&self) -> [i32; 3] {
        // extents are at most MAX_EXTENT, which fits i32
        self.dims.map(|n| n as i32 + i32::from(self.closed))
    }

    /// The integer metric of this lattice.
    #[must_use]
    pub fn metric(&self) -> Metric {
        let edges = self.edges();
        if edges == [1.0; 3] {
            return Metric {
                weights: [1; 3],
                one: 1,
            };
        }
        Metric {
            weights: edges.map(|e| (e * e * BOX_ONE as f64).round() as i64),
            one: BOX_ONE,
        }
    }

    /// World coordinates of a point given in Khalimsky coordinates.
    #[must_use]
    pub fn khalimsky_to_world(&self, k: [i32; 3]) -> [f64; 3] {
        let mut world = self.origin;
        for a in 0..3 {
            let along = f64::from(k[a] - 1) * 0.5 * self.spacing[a];
            for i in 0..3 {
                world[i] += self.direction[a][i] * along;
            }
        }
        world
    }

    /// A vector given in voxel axes, in world axes.
    #[must_use]
    pub fn vector_to_world(&self, v: [f64; 3]) -> [f64; 3] {
        let mut world = [0.0; 3];
        for a in 0..3 {
            for i in 0..3 {
                world[i] += self.direction[a][i] * v[a];
            }
        }
        world
    }
}

/// Squared lengths on the lattice, in integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metric {
    /// Squared edges in fixed point.
    pub weights: [i64; 3],
    one: u64,
}

impl Metric {
    /// Squared length of the longest edge of a voxel.
    #[must_use]
    pub fn one(&self) -> u64 {
        self.one
    }

    /// Whether voxels are cubes.
    #[must_use]
    pub fn is_cubic(&self) -> bool {
        self.one == 1
    }

    /// Squared length of a vector of voxel (or doubled) coordinates.
    #[inline]
    #[must_use]
    pub fn squared(&self, d: [i32; 3]) -> i64 {
        let d = d.map(i64::from);
        self.weights[0] * d[0] * d[0]
            + self.weights[1] * d[1] * d[1]
            + self.weights[2] * d[2] * d[2]
    }

    /// A ball of voxels: `q` is in it if `squared(q - centre) <= limit`.
    ///
    /// # Errors
    /// [`LatticeError::Radius`].
    pub fn voxel_ball(&self, radius: f64) -> Result<Ball, LatticeError> {
        self.ball(radius, 1.0)
    }

    /// A ball of cells in Khalimsky coordinates: `floor(4 rho^2)` and doubled distances.
    ///
    /// # Errors
    /// [`LatticeError::Radius`].
    pub fn khalimsky_ball(&self, radius: f64) -> Result<Ball, LatticeError> {
        self.ball(radius, 4.0)
    }

    fn ball(&self, radius: f64, factor: f64) -> Result<Ball, LatticeError> {
        if !(radius > 0.0 && radius <= MAX_RADIUS) {
            return Err(LatticeError::Radius(radius));
        }
        Ok(self.unchecked_ball(radius, factor))
    }

    /// A ball of cells wider than another by `more` voxel units.
    #[must_use]
    pub fn wider_ball(&self, ball: &Ball, more: f64) -> Ball {
        self.unchecked_ball(ball.radius + more, if ball.doubled { 4.0 } else { 1.0 })
    }

    fn unchecked_ball(&self, radius: f64, factor: f64) -> Ball {
        let mut squared = factor * radius * radius;
        let limit = if self.one == 1 {
            // Radii such as 3 / sqrt(h) are meant to have whole squares; without the snap the
            // last bit of the division would decide whether a whole shell of voxels is in.
            let nearest = squared.round();
            if (squared - nearest).abs() <= 1e-9 * nearest {
                squared = nearest;
            }
            squared.floor()
        } else {
            squared *= self.one as f64;
            (squared * (1.0 + 1e-12)).floor()
        };
        Ball {
            radius,
            metric: *self,
            squared,
            limit: limit as i64,
            doubled: factor > 1.0,
        }
    }
}

/// A closed ball on the lattice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Radius in voxel units, as asked.
    pub radius: f64,
    /// The metric it is measured in.
    pub metric: Metric,
    /// Square of the radius in the unit of the metric (doubled where the ball is).
    pub squared: f64,
    /// Squared distances up to this are inside: the integer part of `squared`.
    pub limit: i64,
    doubled: bool,
}

impl Ball {
    /// Whether a displacement (in voxels or doubled, as the ball was made) stays in the ball.
    #[inline]
    #[must_use]
    pub fn contains(&self, d: [i32; 3]) -> bool {
        self.metric.squared(d) <= self.limit
    }

    /// Largest displacement along an axis that stays in the ball, given what the others have used.
    #[must_use]
    pub fn half_width(&self, axis: usize, used: i64) -> Option<i32> {
        let rest = self.limit - used;
        if rest < 0 {
            return None;
        }
        let weight = self.metric.weights[axis];
        let mut w = ((rest / weight) as f64).sqrt() as i64;
        while weight * w * w > rest {
            w -= 1;
        }
        while weight * (w + 1) * (w + 1) <= rest {
            w += 1;
        }
        i32::try_from(w).ok()
    }

    /// How many cells away along each axis the ball can reach: a doubled displacement up to `w`
    /// leads from an odd coordinate to an even one at most `(w + 1) / 2` cells on.
    #[must_use]
    pub fn reach(&self) -> [i32; 3] {
        [0, 1, 2].map(|axis| {
            let w = self.half_width(axis, 0).unwrap_or(0);
            if self.doubled { (w + 1) / 2 } else { w }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_of_radii_meant_to_be_whole_are_whole() {
        let metric = Lattice::new([9; 3], [0.5; 3], false).unwrap().metric();
        for (h, squared) in [(0.5f64, 18), (0.25, 36), (0.125, 72), (0.0625, 144)] {
            let radius = 3.0 * h.sqrt() / h;
            assert_eq!(metric.voxel_ball(radius).unwrap().limit, squared);
            assert_eq!(metric.khalimsky_ball(radius).unwrap().limit, 4 * squared);
        }
    }

    #[test]
    fn half_widths_are_the_widest_that_fit() {
        let metric = Lattice::new([9; 3], [1.0, 0.7, 2.0], false)
            .unwrap()
            .metric();
        let ball = metric.voxel_ball(6.3).unwrap();
        for axis in 0..3 {
            let w = ball.half_width(axis, 0).unwrap();
            let mut d = [0; 3];
            d[axis] = w;
            assert!(ball.contains(d));
            d[axis] = w + 1;
            assert!(!ball.contains(d));
        }
        assert_eq!(ball.half_width(0, ball.limit + 1), None);
    }

    #[test]
    fn unusable_lattices_and_radii_are_refused() {
        assert!(Lattice::new([0, 1, 1], [1.0; 3], false).is_err());
        assert!(Lattice::new([1 << 31, 1, 1], [1.0; 3], false).is_err());
        assert!(Lattice::new([1; 3], [1.0, f64::NAN, 1.0], false).is_err());
        assert!(Lattice::new([1; 3], [1.0, 0.0, 1.0], false).is_err());
        assert!(Lattice::new([1; 3], [1.0, 1.0, 1e4], false).is_err());
        let metric = Lattice::new([1; 3], [1.0; 3], false).unwrap().metric();
        assert!(metric.voxel_ball(0.0).is_err());
        assert!(metric.voxel_ball(63.5).is_err());
        assert!(metric.voxel_ball(f64::NAN).is_err());
    }
}
