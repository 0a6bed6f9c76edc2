//! The gyroid: a periodic surface that divides space into two connected halves.

use super::implicit::check_length;
use super::{BoundingBox, ImplicitShape, ShapeError};
use glam::{DMat3, DVec3};
use std::f64::consts::TAU;

/// The solid sin X cos Y + sin Y cos Z + sin Z cos X <= level, with X = 2 pi x / period and so on.
///
/// At level 0 this is Schoen's gyroid approximated to first order: nearly a minimal surface, so H
/// is small but *not* 0, and G < 0 almost everywhere. It has no border of its own: the image cuts it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gyroid {
    period: f64,
    level: f64,
    half_edge: f64,
}

impl Gyroid {
    /// A gyroid of this period, digitised in the cube `[-half_edge, half_edge]^3`.
    ///
    /// # Errors
    /// If `period` or `half_edge` is not a length from 1e-9 to 1e9, or `level` is not strictly
    /// between -1.5 and 1.5, the extrema of the left side.
    pub fn new(period: f64, level: f64, half_edge: f64) -> Result<Self, ShapeError> {
        check_length("gyroid", "period", period)?;
        check_length("gyroid", "half_edge", half_edge)?;
        if !(level > -1.5 && level < 1.5) {
            return Err(ShapeError::Parameter {
                shape: "gyroid",
                name: "level",
                value: level,
                expected: "a number between -1.5 and 1.5",
            });
        }
        Ok(Gyroid {
            period,
            level,
            half_edge,
        })
    }

    /// 2 pi / period
    fn frequency(&self) -> f64 {
        TAU / self.period
    }

    /// (sin, cos) of each scaled coordinate, by the `libm` crate: the standard library's would
    /// differ from one system to another, and with it a voxel close to the surface.
    fn sines(&self, p: DVec3) -> (DVec3, DVec3) {
        let a = self.frequency() * p;
        (
            DVec3::new(libm::sin(a.x), libm::sin(a.y), libm::sin(a.z)),
            DVec3::new(libm::cos(a.x), libm::cos(a.y), libm::cos(a.z)),
        )
    }

    fn combine(&self, s: DVec3, c: DVec3) -> f64 {
        s.x * c.y + s.y * c.z + s.z * c.x - self.level
    }
}

impl ImplicitShape for Gyroid {
    fn value(&self, p: DVec3) -> f64 {
        let (s, c) = self.sines(p);
        self.combine(s, c)
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        let (s, c) = self.sines(p);
        let w = self.frequency();
        w * DVec3::new(
            c.x * c.y - s.z * s.x,
            c.y * c.z - s.x * s.y,
            c.z * c.x - s.y * s.z,
        )
    }

    fn hessian(&self, p: DVec3) -> DMat3 {
        let (s, c) = self.sines(p);
        let w2 = self.frequency() * self.frequency();
        let (xy, xz, yz) = (-c.x * s.y, -c.z * s.x, -c.y * s.z);
        let diagonal = -DVec3::new(
            s.x * c.y + s.z * c.x,
            s.y * c.z + s.x * c.y,
            s.z * c.x + s.y * c.z,
        );
        w2 * DMat3::from_cols(
            DVec3::new(diagonal.x, xy, xz),
            DVec3::new(xy, diagonal.y, yz),
            DVec3::new(xz, yz, diagonal.z),
        )
    }

    fn bounding_box(&self) -> BoundingBox {
        BoundingBox::centred(DVec3::splat(self.half_edge))
    }

    fn values_along_x(&self, x: &[f64], y: f64, z: f64, out: &mut [f64]) {
        assert_eq!(x.len(), out.len(), "one value per abscissa");
        // The sines of y and z are the same all along the row.
        let (mut s, mut c) = self.sines(DVec3::new(0.0, y, z));
        let w = self.frequency();
        for (value, &x) in out.iter_mut().zip(x) {
            let a = w * x;
            (s.x, c.x) = (libm::sin(a), libm::cos(a));
            *value = self.combine(s, c);
        }
    }
}
