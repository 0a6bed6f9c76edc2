//! Shapes of degree four and six: Goursat, torus, rounded cube, Leopold.
//!
//! They are the polynomials of DGtal's `Shortcuts`, so that results compare with its own.

use super::implicit::check_length;
use super::{BoundingBox, ImplicitShape, ShapeError};
use glam::{DMat3, DVec3};

/// The symmetric matrix of these diagonal and off-diagonal (xy, xz, yz) terms.
fn symmetric(diagonal: DVec3, xy: f64, xz: f64, yz: f64) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(diagonal.x, xy, xz),
        DVec3::new(xy, diagonal.y, yz),
        DVec3::new(xz, yz, diagonal.z),
    )
}

/// The "Goursat" shape, the running example of Lachaud, Romon, Thibert, *Corrected curvature
/// measures*, section 6.1.1: P >= 0 with P = 4 - 0.015 (x^4 + y^4 + z^4) + x^2 + y^2 + z^2.
///
/// F = -2P, DGtal's polynomial; box `[-10, 10]^3`. Mean curvature goes from -0.1070 to 0.3448,
/// Gaussian curvature from -0.0337 to 0.1189; the reach is above 2.9.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Goursat;

impl ImplicitShape for Goursat {
    fn value(&self, p: DVec3) -> f64 {
        let (x2, y2, z2) = (p.x * p.x, p.y * p.y, p.z * p.z);
        0.03 * (x2 * x2 + y2 * y2 + z2 * z2) - 2.0 * (x2 + y2 + z2) - 8.0
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        (0.12 * (p * p) - DVec3::splat(4.0)) * p
    }

    fn hessian(&self, p: DVec3) -> DMat3 {
        DMat3::from_diagonal(0.36 * (p * p) - DVec3::splat(4.0))
    }

    fn bounding_box(&self) -> BoundingBox {
        BoundingBox::centred(DVec3::splat(10.0))
    }
}

/// The torus F = (x^2 + y^2 + z^2 + R^2 - r^2)^2 - 4 R^2 (x^2 + y^2) around the z axis.
///
/// The integral of G over it is 0; that of H is 2 pi^2 R.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Torus {
    major: f64,
    minor: f64,
}

impl Torus {
    /// A torus of these radii: `major` from the axis to the core circle, `minor` around it.
    ///
    /// # Errors
    /// If one of them is not a length from 1e-9 to 1e9, or `minor` is not below `major` (the
    /// surface would cross itself).
    pub fn new(major: f64, minor: f64) -> Result<Self, ShapeError> {
        check_length("torus", "major", major)?;
        check_length("torus", "minor", minor)?;
        if minor >= major {
            return Err(ShapeError::Parameter {
                shape: "torus",
                name: "minor",
                value: minor,
                expected: "a radius below `major`",
            });
        }
        Ok(Torus { major, minor })
    }
}

impl Default for Torus {
    /// Radii 6 and 2, DGtal's `torus`.
    fn default() -> Self {
        Torus {
            major: 6.0,
            minor: 2.0,
        }
    }
}

impl Torus {
    /// x^2 + y^2 + z^2 + R^2 - r^2
    fn quadratic(&self, p: DVec3) -> f64 {
        p.x * p.x + p.y * p.y + p.z * p.z + (self.major * self.major - self.minor * self.minor)
    }
}

impl ImplicitShape for Torus {
    fn value(&self, p: DVec3) -> f64 {
        let s = self.quadratic(p);
        s * s - 4.0 * (self.major * self.major) * (p.x * p.x + p.y * p.y)
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        let s = self.quadratic(p);
        let r2 = self.major * self.major;
        4.0 * s * p - 8.0 * r2 * DVec3::new(p.x, p.y, 0.0)
    }

    fn hessian(&self, p: DVec3) -> DMat3 {
        let s = self.quadratic(p);
        let r2 = self.major * self.major;
        let diagonal = DVec3::splat(4.0 * s) + 8.0 * (p * p) - 8.0 * r2 * DVec3::new(1.0, 1.0, 0.0);
        symmetric(diagonal, 8.0 * p.x * p.y, 8.0 * p.x * p.z, 8.0 * p.y * p.z)
    }

    fn bounding_box(&self) -> BoundingBox {
        let outer = self.major + self.minor;
        BoundingBox::centred(DVec3::new(outer, outer, self.minor))
    }
}

/// The cube with round edges F = x^4 + y^4 + z^4 - half_edge^4. Flat (H = G = 0) at the middle of
/// its six faces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundedCube {
    half_edge: f64,
}

impl RoundedCube {
    /// A cube from `-half_edge` to `half_edge`, in world units.
    ///
    /// # Errors
    /// If `half_edge` is not a length from 1e-9 to 1e9.
    pub fn new(half_edge: f64) -> Result<Self, ShapeError> {
        check_length("rcube", "half_edge", half_edge)?;
        Ok(RoundedCube { half_edge })
    }
}

impl Default for RoundedCube {
    /// Half edge 9, DGtal's `rcube` (9^4 = 6561).
    fn default() -> Self {
        RoundedCube { half_edge: 9.0 }
    }
}

impl ImplicitShape for RoundedCube {
    fn value(&self, p: DVec3) -> f64 {
        let (x2, y2, z2) = (p.x * p.x, p.y * p.y, p.z * p.z);
        let e2 = self.half_edge * self.half_edge;
        x2 * x2 + y2 * y2 + z2 * z2 - e2 * e2
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        4.0 * (p * p) * p
    }

    fn hessian(&self, p: DVec3) -> DMat3 {
        DMat3::from_diagonal(12.0 * (p * p))
    }

    fn bounding_box(&self) -> BoundingBox {
        BoundingBox::centred(DVec3::splat(self.half_edge))
    }
}

/// DGtal's `leopold` F = x^2 y^2 z^2 + 4 x^2 + 4 y^2 + 3 z^2 - 100: six blunt arms with hollows
/// between them. It reaches 5 along x and y, 5.774 along z.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Leopold;

impl ImplicitShape for Leopold {
    fn value(&self, p: DVec3) -> f64 {
        let (x2, y2, z2) = (p.x * p.x, p.y * p.y, p.z * p.z);
        x2 * y2 * z2 + 4.0 * x2 + 4.0 * y2 + 3.0 * z2 - 100.0
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        let (x2, y2, z2) = (p.x * p.x, p.y * p.y, p.z * p.z);
        2.0 * p * DVec3::new(y2 * z2 + 4.0, x2 * z2 + 4.0, x2 * y2 + 3.0)
    }

    fn hessian(&self, p: DVec3) -> DMat3 {
        let (x2, y2, z2) = (p.x * p.x, p.y * p.y, p.z * p.z);
        symmetric(
            2.0 * DVec3::new(y2 * z2 + 4.0, x2 * z2 + 4.0, x2 * y2 + 3.0),
            4.0 * p.x * p.y * z2,
            4.0 * p.x * p.z * y2,
            4.0 * p.y * p.z * x2,
        )
    }

    fn bounding_box(&self) -> BoundingBox {
        BoundingBox::centred(DVec3::splat(6.0))
    }
}
