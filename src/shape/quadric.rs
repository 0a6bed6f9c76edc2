//! Shapes of degree one and two: sphere, ellipsoid, cylinder, plane.

use super::implicit::check_length;
use super::{BoundingBox, ImplicitShape, ShapeError};
use glam::{DMat3, DVec3};

/// The ball F = x^2 + y^2 + z^2 - radius^2, centred at the origin. H = 1/radius, G = 1/radius^2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    radius: f64,
}

impl Sphere {
    /// A ball of this radius, in world units.
    ///
    /// # Errors
    /// If `radius` is not a length from 1e-9 to 1e9.
    pub fn new(radius: f64) -> Result<Self, ShapeError> {
        check_length("sphere", "radius", radius)?;
        Ok(Sphere { radius })
    }
}

impl Default for Sphere {
    /// Radius 9, DGtal's `sphere9`.
    fn default() -> Self {
        Sphere { radius: 9.0 }
    }
}

impl ImplicitShape for Sphere {
    fn value(&self, p: DVec3) -> f64 {
        p.x * p.x + p.y * p.y + p.z * p.z - self.radius * self.radius
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        2.0 * p
    }

    fn hessian(&self, _p: DVec3) -> DMat3 {
        DMat3::from_diagonal(DVec3::splat(2.0))
    }

    fn bounding_box(&self) -> BoundingBox {
        BoundingBox::centred(DVec3::splat(self.radius))
    }
}

/// The ellipsoid F = c.x x^2 + c.y y^2 + c.z z^2 - level, centred at the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipsoid {
    coefficients: DVec3,
    level: f64,
    half_edges: DVec3,
}

impl Ellipsoid {
    /// An ellipsoid of these semi-axes, in world units.
    ///
    /// F = b^2 c^2 x^2 + a^2 c^2 y^2 + a^2 b^2 z^2 - a^2 b^2 c^2: without a division, so that a
    /// voxel exactly on the surface is found inside when semi-axes and gridstep are short numbers.
    ///
    /// # Errors
    /// If a semi-axis is not a length from 1e-9 to 1e9.
    pub fn with_semi_axes(a: f64, b: f64, c: f64) -> Result<Self, ShapeError> {
        check_length("ellipsoid", "a", a)?;
        check_length("ellipsoid", "b", b)?;
        check_length("ellipsoid", "c", c)?;
        let (a2, b2, c2) = (a * a, b * b, c * c);
        Ok(Ellipsoid {
            coefficients: DVec3::new(b2 * c2, a2 * c2, a2 * b2),
            level: a2 * b2 * c2,
            half_edges: DVec3::new(a, b, c),
        })
    }

    /// DGtal's `ellipsoid`, F = 3 x^2 + 2 y^2 + z^2 - 90, in the box of half edge 10 its users take.
    pub fn dgtal() -> Self {
        Ellipsoid {
            coefficients: DVec3::new(3.0, 2.0, 1.0),
            level: 90.0,
            half_edges: DVec3::splat(10.0),
        }
    }
}

impl ImplicitShape for Ellipsoid {
    fn value(&self, p: DVec3) -> f64 {
        let c = self.coefficients;
        c.x * (p.x * p.x) + c.y * (p.y * p.y) + c.z * (p.z * p.z) - self.level
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        2.0 * self.coefficients * p
    }

    fn hessian(&self, _p: DVec3) -> DMat3 {
        DMat3::from_diagonal(2.0 * self.coefficients)
    }

    fn bounding_box(&self) -> BoundingBox {
        BoundingBox::centred(self.half_edges)
    }
}

/// The endless cylinder F = x^2 + y^2 - radius^2 along z. H = 1/(2 radius), G = 0.
///
/// It is capped by the border of the image alone, where no surface is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cylinder {
    radius: f64,
    half_length: f64,
}

impl Cylinder {
    /// A cylinder of this radius, digitised (margins apart) for |z| <= `half_length`.
    ///
    /// # Errors
    /// If one of them is not a length from 1e-9 to 1e9.
    pub fn new(radius: f64, half_length: f64) -> Result<Self, ShapeError> {
        check_length("cylinder", "radius", radius)?;
        check_length("cylinder", "half_length", half_length)?;
        Ok(Cylinder {
            radius,
            half_length,
        })
    }
}

impl ImplicitShape for Cylinder {
    fn value(&self, p: DVec3) -> f64 {
        p.x * p.x + p.y * p.y - self.radius * self.radius
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        DVec3::new(2.0 * p.x, 2.0 * p.y, 0.0)
    }

    fn hessian(&self, _p: DVec3) -> DMat3 {
        DMat3::from_diagonal(DVec3::new(2.0, 2.0, 0.0))
    }

    fn bounding_box(&self) -> BoundingBox {
        BoundingBox::centred(DVec3::new(self.radius, self.radius, self.half_length))
    }
}

/// The half space F = normal . x - level. H = G = 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    normal: DVec3,
    level: f64,
    half_edge: f64,
}

impl Plane {
    /// The half space `normal . x <= level`, digitised in the cube `[-half_edge, half_edge]^3`.
    ///
    /// `normal` points outward, may have any length, and is used as given: with small integers,
    /// voxels exactly on the plane are found inside.
    ///
    /// # Errors
    /// If `normal` or `half_edge` is not of a length from 1e-9 to 1e9, or `level` not from -1e9 to
    /// 1e9.
    pub fn new(normal: DVec3, level: f64, half_edge: f64) -> Result<Self, ShapeError> {
        check_length("plane", "half_edge", half_edge)?;
        if !(1e-9..=1e9).contains(&normal.length()) {
            return Err(ShapeError::Parameter {
                shape: "plane",
                name: "nx, ny, nz",
                value: normal.length(),
                expected: "a normal whose length is from 1e-9 to 1e9",
            });
        }
        if !(-1e9..=1e9).contains(&level) {
            return Err(ShapeError::Parameter {
                shape: "plane",
                name: "level",
                value: level,
                expected: "a number from -1e9 to 1e9",
            });
        }
        Ok(Plane {
            normal,
            level,
            half_edge,
        })
    }
}

impl ImplicitShape for Plane {
    fn value(&self, p: DVec3) -> f64 {
        self.normal.x * p.x + self.normal.y * p.y + self.normal.z * p.z - self.level
    }

    fn gradient(&self, _p: DVec3) -> DVec3 {
        self.normal
    }

    fn hessian(&self, _p: DVec3) -> DMat3 {
        DMat3::ZERO
    }

    fn bounding_box(&self) -> BoundingBox {
        BoundingBox::centred(DVec3::splat(self.half_edge))
    }
}
