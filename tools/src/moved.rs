//! Shapes in general position: turned, and shifted by parts of a voxel.
//!
//! Symmetric shapes whose axes are those of the grid flatter some estimators and punish others.

use curvox::shape::{BoundingBox, ImplicitShape};
use glam::{DMat3, DQuat, DVec3};

use crate::random::Random;

/// A shape after a motion.
#[derive(Clone, Debug)]
pub struct Moved<S> {
    shape: S,
    rotation: DMat3,
    shift: DVec3,
}

impl<S: ImplicitShape> Moved<S> {
    /// The shape turned about the origin and then shifted.
    pub fn new(shape: S, rotation: DQuat, shift: DVec3) -> Self {
        Self {
            shape,
            rotation: DMat3::from_quat(rotation.normalize()),
            shift,
        }
    }

    /// The motion of a number: 0 is none, others turn in any direction and shift by up to half of `gridstep`.
    pub fn numbered(shape: S, number: u64, gridstep: f64) -> Self {
        if number == 0 {
            return Self::new(shape, DQuat::IDENTITY, DVec3::ZERO);
        }
        let mut random = Random(number);
        let mut draw = || random.draw() - 0.5;
        // A uniform direction in four dimensions, without functions of a libm.
        let turn = loop {
            let q = DQuat::from_xyzw(draw(), draw(), draw(), draw());
            if (0.01..0.25).contains(&q.length_squared()) {
                break q;
            }
        };
        let shift = DVec3::new(draw(), draw(), draw()) * gridstep;
        Self::new(shape, turn, shift)
    }

    fn back(&self, p: DVec3) -> DVec3 {
        self.rotation.transpose() * (p - self.shift)
    }
}

impl<S: ImplicitShape> ImplicitShape for Moved<S> {
    fn value(&self, p: DVec3) -> f64 {
        self.shape.value(self.back(p))
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        self.rotation * self.shape.gradient(self.back(p))
    }

    fn hessian(&self, p: DVec3) -> DMat3 {
        self.rotation * self.shape.hessian(self.back(p)) * self.rotation.transpose()
    }

    fn bounding_box(&self) -> BoundingBox {
        let BoundingBox { lo, hi } = self.shape.bounding_box();
        let mut moved = BoundingBox {
            lo: DVec3::INFINITY,
            hi: DVec3::NEG_INFINITY,
        };
        for corner in 0..8 {
            let along = |a: usize| if corner >> a & 1 == 0 { lo[a] } else { hi[a] };
            let p = self.rotation * DVec3::new(along(0), along(1), along(2)) + self.shift;
            moved.lo = moved.lo.min(p);
            moved.hi = moved.hi.max(p);
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use curvox::shape::{Goursat, closest_point};

    #[test]
    fn a_moved_shape_has_the_curvatures_of_the_shape() {
        for number in 1..20 {
            let moved = Moved::numbered(Goursat, number, 0.5);
            let p = DVec3::new(7.9, 1.2, -2.4);
            let there = moved.rotation * p + moved.shift;
            let (a, b) = (closest_point(&Goursat, p), closest_point(&moved, there));
            let (a, b) = (a.unwrap(), b.unwrap());
            assert!((a.signed_distance - b.signed_distance).abs() < 1e-9);
            assert!((a.truth.mean_curvature - b.truth.mean_curvature).abs() < 1e-9);
            assert!((a.truth.gaussian_curvature - b.truth.gaussian_curvature).abs() < 1e-9);
            let turned = moved.rotation * a.truth.normal;
            assert!(turned.distance(b.truth.normal) < 1e-9);
            let inside = moved.bounding_box();
            assert!(there.cmpge(inside.lo).all() && there.cmple(inside.hi).all());
        }
    }

    #[test]
    fn derivatives_are_those_of_the_moved_function() {
        let moved = Moved::numbered(Goursat, 3, 1.0);
        let p = DVec3::new(3.1, -5.2, 6.3);
        let step = 1e-5;
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let slope =
                (moved.value(p + axis * step) - moved.value(p - axis * step)) / (2.0 * step);
            assert!((slope - moved.gradient(p).dot(axis)).abs() < 1e-5);
            let turn =
                (moved.gradient(p + axis * step) - moved.gradient(p - axis * step)) / (2.0 * step);
            assert!((turn - moved.hessian(p) * axis).length() < 1e-5);
        }
    }
}
