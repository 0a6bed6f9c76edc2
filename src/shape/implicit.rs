//! What an implicit shape is: a function of space, its first two derivatives, a box around it.

use glam::{DMat3, DVec3};

/// An axis-aligned box, in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundingBox {
    /// The corner with the smallest coordinates.
    pub lo: DVec3,
    /// The corner with the largest coordinates.
    pub hi: DVec3,
}

impl BoundingBox {
    /// The box `[-x, x] * [-y, y] * [-z, z]` for half edges (x, y, z).
    pub fn centred(half_edges: DVec3) -> Self {
        BoundingBox {
            lo: -half_edges,
            hi: half_edges,
        }
    }

    /// Half of the longest edge: the length against which tolerances are taken.
    pub fn half_longest_edge(&self) -> f64 {
        0.5 * (self.hi - self.lo).max_element()
    }
}

/// A solid `{ x : F(x) <= 0 }` with a function F that is twice differentiable.
///
/// F grows outward across the surface F = 0, so that its gradient is an outward normal. F is any
/// such function, not a distance. All lengths are in world units.
///
/// Implementations compute with `+ - * /`, square roots and functions of the `libm` crate alone,
/// never with fused multiply-adds, so that a digitisation is the same on any machine.
pub trait ImplicitShape: Send + Sync {
    /// F at `p`: at most 0 inside, above 0 outside.
    fn value(&self, p: DVec3) -> f64;

    /// The gradient of F at `p`.
    fn gradient(&self, p: DVec3) -> DVec3;

    /// The symmetric matrix of the second derivatives of F at `p`.
    fn hessian(&self, p: DVec3) -> DMat3;

    /// The box to digitise. It holds the whole shape when the shape is bounded, and a window of it
    /// when it is not (cylinder, plane, gyroid).
    fn bounding_box(&self) -> BoundingBox;

    /// F along a row: `out[i]` is F at (`x[i]`, `y`, `z`), bit for bit what [`Self::value`] gives.
    ///
    /// # Panics
    /// If `x` and `out` differ in length.
    fn values_along_x(&self, x: &[f64], y: f64, z: f64, out: &mut [f64]) {
        assert_eq!(x.len(), out.len(), "one value per abscissa");
        for (value, &x) in out.iter_mut().zip(x) {
            *value = self.value(DVec3::new(x, y, z));
        }
    }
}

impl<S: ImplicitShape + ?Sized> ImplicitShape for Box<S> {
    fn value(&self, p: DVec3) -> f64 {
        (**self).value(p)
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        (**self).gradient(p)
    }

    fn hessian(&self, p: DVec3) -> DMat3 {
        (**self).hessian(p)
    }

    fn bounding_box(&self) -> BoundingBox {
        (**self).bounding_box()
    }

    fn values_along_x(&self, x: &[f64], y: f64, z: f64, out: &mut [f64]) {
        (**self).values_along_x(x, y, z, out);
    }
}

impl<S: ImplicitShape + ?Sized> ImplicitShape for &S {
    fn value(&self, p: DVec3) -> f64 {
        (**self).value(p)
    }

    fn gradient(&self, p: DVec3) -> DVec3 {
        (**self).gradient(p)
    }

    fn hessian(&self, p: DVec3) -> DMat3 {
        (**self).hessian(p)
    }

    fn bounding_box(&self) -> BoundingBox {
        (**self).bounding_box()
    }

    fn values_along_x(&self, x: &[f64], y: f64, z: f64, out: &mut [f64]) {
        (**self).values_along_x(x, y, z, out);
    }
}

/// Checks that a length given as a parameter keeps polynomials of degree 6 finite and not denormal.
pub(super) fn check_length(
    shape: &'static str,
    name: &'static str,
    value: f64,
) -> Result<(), super::ShapeError> {
    // NaN fails the test as it should.
    if (1e-9..=1e9).contains(&value) {
        Ok(())
    } else {
        Err(super::ShapeError::Parameter {
            shape,
            name,
            value,
            expected: "a length from 1e-9 to 1e9",
        })
    }
}
