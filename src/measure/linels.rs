//! The measures of many linels at once.
//!
//! Comes in: what the formulas ([`super::formula`]) take of each of [`TOGETHER`] linels, number by number. Goes out: their
//! measures, rounded ([`super::fixed`]). The loop over linels becomes a loop over vectors of them, which
//! changes no bit: neither the level of the machine nor the company of a linel shows.

use glam::DVec3;

use super::fixed;
use super::formula::{linel_tensor, swept_area};

/// Linels that are evaluated together. With fewer, the ends of the loops cost more than their
/// middles; with many more, what they pass to each other does not stay in the nearest cache.
pub(super) const TOGETHER: usize = 32;

/// A number of each linel.
type Each<T> = [T; TOGETHER];

/// A vector of each linel, by coordinate.
type Vectors = [Each<f64>; 3];

/// Linels between surfels f and g: f has the lower number, and the linel runs along its boundary.
pub(super) struct Linels {
    n_f: Vectors,
    n_g: Vectors,
    u_f: Vectors,
    u_g: Vectors,
    e: Vectors,
    length: Each<f64>,
}

/// Measures of linels.
pub(super) struct LinelMeasures {
    /// Areas swept from f to g, in the unit of [`fixed::from_solid_angle`].
    pub(super) swept: Each<i64>,
    /// Terms of the tensors xx yy zz xy xz yz, or of their halves.
    pub(super) tensor: [Each<i64>; 6],
    /// Traces of the whole tensors.
    pub(super) mu1: Each<i64>,
}

#[inline(always)]
fn put(to: &mut Vectors, at: usize, v: [f64; 3]) {
    for (to, v) in to.iter_mut().zip(v) {
        to[at] = v;
    }
}

#[inline(always)]
fn vector(of: &Vectors, at: usize) -> DVec3 {
    DVec3::new(of[0][at], of[1][at], of[2][at])
}

impl Linels {
    /// Linels without measures.
    pub(super) fn new() -> Self {
        Self {
            n_f: [[0.0; TOGETHER]; 3],
            n_g: [[0.0; TOGETHER]; 3],
            u_f: [[0.0; TOGETHER]; 3],
            u_g: [[0.0; TOGETHER]; 3],
            e: [[0.0; TOGETHER]; 3],
            length: [0.0; TOGETHER],
        }
    }

    /// Sets a linel: the trivial normals of f and g, their `u`, the unit vector `e` along it and its length.
    #[inline(always)]
    pub(super) fn set(
        &mut self,
        at: usize,
        n: [[f64; 3]; 2],
        u: [DVec3; 2],
        e: [f64; 3],
        length: f64,
    ) {
        put(&mut self.n_f, at, n[0]);
        put(&mut self.n_g, at, n[1]);
        put(&mut self.u_f, at, u[0].to_array());
        put(&mut self.u_g, at, u[1].to_array());
        put(&mut self.e, at, e);
        self.length[at] = length;
    }

    /// Evaluates all linels; of each tensor the part `share`, 1/2 or 1, is rounded.
    #[inline(always)]
    pub(super) fn evaluate(&self, share: f64, to: &mut LinelMeasures) {
        for at in 0..TOGETHER {
            let (n_f, n_g) = (vector(&self.n_f, at), vector(&self.n_g, at));
            let (u_f, u_g) = (vector(&self.u_f, at), vector(&self.u_g, at));
            let area = swept_area(n_f, n_g, u_f, u_g);
            to.swept[at] = fixed::from_solid_angle(area);
        }
        for at in 0..TOGETHER {
            let (u_f, u_g) = (vector(&self.u_f, at), vector(&self.u_g, at));
            let m = linel_tensor(u_f, u_g, vector(&self.e, at), self.length[at]);
            to.tensor[0][at] = fixed::from_measure(share * m.xx);
            to.tensor[1][at] = fixed::from_measure(share * m.yy);
            to.tensor[2][at] = fixed::from_measure(share * m.zz);
            to.tensor[3][at] = fixed::from_measure(share * m.xy);
            to.tensor[4][at] = fixed::from_measure(share * m.xz);
            to.tensor[5][at] = fixed::from_measure(share * m.yz);
            let whole = [m.xx, m.yy, m.zz];
            to.mu1[at] = fixed::from_measure(whole[0])
                + fixed::from_measure(whole[1])
                + fixed::from_measure(whole[2]);
        }
    }
}

impl LinelMeasures {
    /// Nothing.
    pub(super) fn new() -> Self {
        Self {
            swept: [0; TOGETHER],
            tensor: [[0; TOGETHER]; 6],
            mu1: [0; TOGETHER],
        }
    }
}
