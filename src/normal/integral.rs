//! Digital integral invariants: u from the covariance of the solid in a ball of voxels.
//!
//! Paper, section 6.1.3 (II); Lachaud, Coeurjolly, Levallois, *Robust and convergent curvature and
//! normal estimators with digital integral invariants*. The ball is centred on the inner voxel and
//! on the outer voxel of the surfel; the two covariances (and first moments) are averaged.
//! Voxels outside the image count as outside.
//!
//! ```text
//!    moments of the voxels X in the ball around c, about c, in integers:
//!       n = |X|,  s = sum (q - c),  S = sum (q - c)(q - c)^T
//!    covariance  S - s s^T / n     (one rounding: (n S - s s^T) / n)
//! ```
//!
//! The moments depend on the centre only, so each voxel that is inner or outer to some surfel is
//! evaluated once. Rows of the ball are windows of bits; a run of inside voxels adds its count
//! and power sums in constant time.
//!
//! **Which eigenvector.** With [`Orientation::Moment`] the one nearest the first moment
//! (largest |cos|), pointing away from it. Ties, made explicit because small solids are full of
//! them: eigenvalues closer than [`SAME_EIGENVALUE`] share their eigenspace and the first
//! moment's projection on it is the candidate; candidates whose |cos| differ by less than
//! [`SAME_COSINE`] are decided for the smaller eigenvalue.

use glam::DVec3;

use crate::khalimsky::OrientedSurfel;
use crate::lattice::{Ball, Lattice};
use crate::simd::{Level, Work, dispatch};
use crate::surfel::{CellBox, Surfels};
use crate::symmetric::{Eigen, Symmetric, eigen};
use crate::volume::{BitBox, PlaneWindow};

use super::{Normals, Orientation, touches_border, trivial_normal};

/// Eigenvalues closer than this, relative to the largest, count as equal. Larger would merge
/// directions that a shape really distinguishes; smaller would let rounding choose the basis of
/// an eigenspace, so that a mirrored volume got other normals.
pub const SAME_EIGENVALUE: f64 = 1e-7;

/// Cosines closer than this count as equal, so that rounding does not decide between eigenvectors
/// to which the first moment is equally near.
pub const SAME_COSINE: f64 = 1e-9;

/// Rows of the ball of voxels in one plane.
#[derive(Clone, Debug)]
struct BallPlane {
    dz: i32,
    /// For each row its displacement along y and its half-width along x.
    rows: Vec<(i32, i32)>,
}

/// Integral invariants at one radius.
#[derive(Clone, Debug)]
pub struct IntegralKernel {
    ball: Ball,
    edges: [f64; 3],
    orientation: Orientation,
    planes: Vec<BallPlane>,
    /// `power[x + widest]` = (sum of x', sum of x'^2) over x' < x, from -widest.
    power: Vec<[i64; 2]>,
    widest: i32,
}

/// The moments about each of some voxels.
struct MomentsOf<'a> {
    kernel: &'a IntegralKernel,
    bits: &'a BitBox,
    voxels: &'a [[i32; 3]],
}

impl Work for MomentsOf<'_> {
    type Output = Vec<Moments>;

    #[inline(always)]
    fn run<L: Level>(self) -> Vec<Moments> {
        // A loop and not an iterator: what an adapter calls is compiled for the baseline.
        let mut moments = Vec::with_capacity(self.voxels.len());
        for &c in self.voxels {
            moments.push(self.kernel.moments(self.bits, c));
        }
        moments
    }
}

/// Moments of the solid in a ball about its centre, in voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Moments {
    pub(crate) count: i64,
    first: [i64; 3],
    /// xx, yy, zz, xy, xz, yz
    second: [i64; 6],
}

/// Moments about the voxels beside some surfels.
pub(crate) struct BesideSurfels {
    /// The voxels in reach.
    pub(crate) bits: BitBox,
    /// One for each voxel that is inner or outer to a surfel.
    pub(crate) moments: Vec<Moments>,
    /// For each surfel the numbers of its inner and its outer voxel.
    pub(crate) pairs: Vec<(u32, u32)>,
}

impl IntegralKernel {
    /// Prepares for a ball of voxels of the given edges (in voxel units).
    #[must_use]
    pub fn new(ball: Ball, edges: [f64; 3], orientation: Orientation) -> Self {
        let mut planes = Vec::new();
        let [widest, _, rz] = ball.reach();
        for dz in -rz..=rz {
            let used_z = ball.metric.squared([0, 0, dz]);
            let Some(ry) = ball.half_width(1, used_z) else {
                continue;
            };
            let rows = (-ry..=ry)
                .filter_map(|dy| {
                    let used = ball.metric.squared([0, dy, dz]);
                    ball.half_width(0, used).map(|half_width| (dy, half_width))
                })
                .collect();
            planes.push(BallPlane { dz, rows });
        }
        let mut power = vec![[0, 0]];
        let mut sums = [0, 0];
        for x in i64::from(-widest)..=i64::from(widest) {
            sums[0] += x;
            sums[1] += x * x;
            power.push(sums);
        }
        Self {
            ball,
            edges,
            orientation,
            planes,
            power,
            widest,
        }
    }

    pub(crate) fn ball(&self) -> &Ball {
        &self.ball
    }

    /// Moments about voxel `c`; `bits` must cover the ball.
    #[inline(always)]
    fn moments(&self, bits: &BitBox, c: [i32; 3]) -> Moments {
        let mut m = Moments::default();
        let x = c[0] - bits.lo()[0];
        for plane in &self.planes {
            // Sums over the plane: of 1, x, x^2, y, y^2, xy.
            let (mut n, mut sx, mut sxx, mut sy, mut syy, mut sxy) =
                (0i64, 0i64, 0i64, 0i64, 0i64, 0i64);
            for &(dy, w) in &plane.rows {
                let words = bits.row(c[1] + dy, c[2] + plane.dz);
                let (mut count, mut sum, mut squares) = (0i64, 0i64, 0i64);
                let mut done = 0;
                while done < 2 * w + 1 {
                    let length = (2 * w + 1 - done).min(64);
                    let window = BitBox::bits(words, (x - w + done) as usize);
                    let mut rest = window & (!0 >> (64 - length));
                    // index into `power` of the window's bit 0
                    let mut at = (done - w + self.widest) as usize;
                    while rest != 0 {
                        let gap = rest.trailing_zeros();
                        rest >>= gap;
                        let run = rest.trailing_ones();
                        let (from, to) = (
                            self.power[at + gap as usize],
                            self.power[at + (gap + run) as usize],
                        );
                        count += i64::from(run);
                        sum += to[0] - from[0];
                        squares += to[1] - from[1];
                        at += (gap + run) as usize;
                        // twice, since a run may be the whole word
                        rest = rest >> (run - 1) >> 1;
                    }
                    done += length;
                }
                let dy = i64::from(dy);
                n += count;
                sx += sum;
                sxx += squares;
                sy += dy * count;
                syy += dy * dy * count;
                sxy += dy * sum;
            }
            let dz = i64::from(plane.dz);
            m.count += n;
            m.first[0] += sx;
            m.first[1] += sy;
            m.first[2] += dz * n;
            m.second[0] += sxx;
            m.second[1] += syy;
            m.second[2] += dz * dz * n;
            m.second[3] += sxy;
            m.second[4] += dz * sx;
            m.second[5] += dz * sy;
        }
        m
    }

    /// Covariance in voxel units; zero where there is no voxel.
    pub(crate) fn covariance(&self, m: &Moments) -> Symmetric {
        if m.count == 0 {
            return Symmetric::default();
        }
        const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        Symmetric::from_terms([0, 1, 2, 3, 4, 5].map(|t| {
            let (i, j) = PAIRS[t];
            // Wide: for flat voxels a ball can hold many of them along an axis.
            let numerator = i128::from(m.count) * i128::from(m.second[t])
                - i128::from(m.first[i]) * i128::from(m.first[j]);
            self.edges[i] * self.edges[j] * (numerator as f64 / m.count as f64)
        }))
    }

    /// The moments about the inner and outer voxels of the surfels of `core`.
    pub(crate) fn beside(
        &self,
        window: &PlaneWindow,
        core: CellBox,
        surfels: &Surfels,
    ) -> BesideSurfels {
        let reach = self.ball.reach();
        let lo = [0, 1, 2].map(|a| core.lo[a] - 1 - reach[a]);
        let hi = [0, 1, 2].map(|a| core.hi[a] + reach[a]);
        let bits = BitBox::cut(window, lo, hi);
        // Voxels of the core and one below are inner or outer to its surfels.
        let near = core.lo.map(|c| c - 1);
        let size = [0, 1, 2].map(|a| (core.hi[a] - near[a]) as usize);
        let mut slots = vec![0u32; size[0] * size[1] * size[2]];
        let mut voxels = Vec::new();
        let mut at = |p: [i32; 3]| -> u32 {
            let [x, y, z] = [0, 1, 2].map(|a| (p[a] - near[a]) as usize);
            let slot = &mut slots[(z * size[1] + y) * size[0] + x];
            if *slot == 0 {
                voxels.push(p);
                *slot = voxels.len() as u32;
            }
            *slot - 1
        };
        let pairs: Vec<(u32, u32)> = (0..surfels.list.len())
            .map(|i| {
                let surfel = surfels.oriented(i);
                (at(surfel.inner), at(surfel.outer()))
            })
            .collect();
        let moments = dispatch(MomentsOf {
            kernel: self,
            bits: &bits,
            voxels: &voxels,
        });
        BesideSurfels {
            bits,
            moments,
            pairs,
        }
    }

    pub(super) fn estimate(
        &self,
        window: &PlaneWindow,
        lattice: &Lattice,
        core: CellBox,
        surfels: &Surfels,
    ) -> Normals {
        let mut normals = Normals::default();
        if surfels.list.is_empty() {
            return normals;
        }
        let BesideSurfels {
            bits,
            moments,
            pairs,
        } = self.beside(window, core, surfels);
        let evaluated: Vec<(Symmetric, [i64; 3])> = moments
            .iter()
            .map(|m| (self.covariance(m), m.first))
            .collect();
        for (surfel, (inner, outer)) in surfels.list.iter().zip(pairs) {
            let (a, b) = (&evaluated[inner as usize], &evaluated[outer as usize]);
            let covariance = a.0.zip(&b.0, |a, b| 0.5 * (a + b));
            let first = [0, 1, 2].map(|i| a.1[i] + b.1[i]);
            let n = trivial_normal(surfel.orientation);
            let u = match self.orientation {
                Orientation::Trivial if covariance == Symmetric::default() => None,
                Orientation::Trivial => {
                    let u = eigen(&covariance).vectors[0];
                    Some(if u.dot(n) < 0.0 { -u } else { u })
                }
                Orientation::Moment if first == [0; 3] => None,
                Orientation::Moment => {
                    let moment =
                        DVec3::from_array([0, 1, 2].map(|i| 0.5 * self.edges[i] * first[i] as f64));
                    Some(-nearest_direction(&eigen(&covariance), moment))
                }
            };
            normals.degenerate.push(u.is_none());
            normals.cut.push(false);
            normals.u.push(u.unwrap_or(n));
        }
        if !lattice.closed {
            for (i, cut) in normals.cut.iter_mut().enumerate() {
                let surfel = surfels.oriented(i);
                *cut = touches_border(surfel, lattice) || self.is_cut(&bits, surfel, lattice);
            }
        }
        normals
    }

    /// Whether the ball of a surfel leaves the image where the solid meets the border (within the
    /// box around the ball): how it goes on is unknown, and it was taken to end there. A solid
    /// that stays clear of the border is taken to be all there is.
    pub(crate) fn is_cut(&self, bits: &BitBox, surfel: OrientedSurfel, lattice: &Lattice) -> bool {
        let reach = self.ball.reach();
        let (p, q) = (surfel.inner, surfel.outer());
        let last = lattice.dims.map(|n| n as i32 - 1);
        let lo = [0, 1, 2].map(|a| p[a].min(q[a]) - reach[a]);
        let hi = [0, 1, 2].map(|a| p[a].max(q[a]) + reach[a]);
        let meets = |a: usize, face: i32| {
            let mut from = lo.map(|x| x.max(0));
            let mut to = [0, 1, 2].map(|b| hi[b].min(last[b]));
            (from[a], to[a]) = (face, face);
            (from[2]..=to[2]).any(|z| {
                (from[1]..=to[1]).any(|y| (from[0]..=to[0]).any(|x| bits.inside([x, y, z])))
            })
        };
        (0..3).any(|a| lo[a] < 0 && meets(a, 0) || hi[a] > last[a] && meets(a, last[a]))
    }
}

/// The eigendirection nearest a nonzero vector, on its side. See the module page for ties.
fn nearest_direction(e: &Eigen, v: DVec3) -> DVec3 {
    let scale = e.values.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let same = |i: usize, j: usize| e.values[j] - e.values[i] <= SAME_EIGENVALUE * scale;
    let mut best = (0.0, v);
    let mut i = 0;
    while i < 3 {
        // eigenvectors i..j span one eigenspace
        let mut j = i + 1;
        while j < 3 && same(j - 1, j) {
            j += 1;
        }
        let projection: DVec3 = if j - i == 3 {
            v
        } else {
            (i..j).map(|k| e.vectors[k] * e.vectors[k].dot(v)).sum()
        };
        let length = projection.length();
        if length > best.0 * (1.0 + SAME_COSINE) {
            best = (length, projection);
        }
        i = j;
    }
    best.1.normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Lattice;
    use crate::volume::BitPlane;
    use std::sync::Arc;

    fn noise(dims: [u32; 3]) -> PlaneWindow {
        let mut state = 7u64;
        let planes = (0..dims[2])
            .map(|_| {
                let mut plane = BitPlane::outside(dims[0], dims[1]);
                for row in plane.rows_mut() {
                    for x in 0..dims[0] as usize {
                        state = state
                            .wrapping_mul(6364136223846793005)
                            .wrapping_add(1442695040888963407);
                        row[x / 64] |= (state >> 40 & 1) << (x % 64);
                    }
                }
                Arc::new(plane)
            })
            .collect();
        PlaneWindow {
            dims,
            z0: 0,
            planes,
        }
    }

    #[test]
    fn moments_are_those_of_counting_voxels() {
        let dims = [150, 9, 8];
        let window = noise(dims);
        for (radius, spacing) in [
            (3.0, [1.0; 3]),
            (2.5, [1.0, 0.6, 0.8]),
            (5.0, [0.1, 1.0, 0.9]),
        ] {
            let lattice = Lattice::new(dims.map(u64::from), spacing, false).unwrap();
            let ball = lattice.metric().voxel_ball(radius).unwrap();
            let kernel = IntegralKernel::new(ball, lattice.edges(), Orientation::Moment);
            let r = ball.reach();
            for c in [[75, 4, 4], [1, 0, 7], [149, 8, 0]] {
                let lo = [0, 1, 2].map(|a| c[a] - r[a]);
                let hi = [0, 1, 2].map(|a| c[a] + r[a] + 1);
                let bits = BitBox::cut(&window, lo, hi);
                let mut expected = Moments::default();
                for z in lo[2]..hi[2] {
                    for y in lo[1]..hi[1] {
                        for x in lo[0]..hi[0] {
                            let d = [x - c[0], y - c[1], z - c[2]];
                            if ball.contains(d) && bits.inside([x, y, z]) {
                                let d = d.map(i64::from);
                                expected.count += 1;
                                for a in 0..3 {
                                    expected.first[a] += d[a];
                                    expected.second[a] += d[a] * d[a];
                                }
                                expected.second[3] += d[0] * d[1];
                                expected.second[4] += d[0] * d[2];
                                expected.second[5] += d[1] * d[2];
                            }
                        }
                    }
                }
                assert_eq!(kernel.moments(&bits, c), expected);
            }
        }
    }
}
