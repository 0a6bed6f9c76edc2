//! The plain reference of the speed tables: a breadth-first walk a surfel over flat arrays, scalar.
//!
//! In: a solid, the radii of a method. Out: what its normals, sums and all the rest take a surfel. Everything is that of
//! [`crate::plain`], with two things taken out of the inner loop that nobody would leave there: the measures of a
//! surfel and its share of those around it are added up once, in one array, and what tells that a surfel is part of a
//! ridge too. (Repeated at each visit, as the oracle does for its simplicity, they make its sums three times as
//! slow.) No bound is made from a distance, nothing is shared between the balls of neighbours.
//!
//! Walks are timed on stretches of consecutive surfels, spread over the surface; the rest on the whole.

use std::hint::black_box;
use std::ops::Range;

use crate::plain::algebra::{Vector, norm, normalised};
use crate::plain::normals;
use crate::plain::solid::LatticeBall;
use crate::plain::surface::OPEN;
use crate::plain::{
    Adjacency, Ball, Cells, Curvature, Estimator, Orientation, Scale, Solid, Sums, Surface, Walk,
    Weights,
};

use super::clock::timed;
use super::runs::Method;

/// Stretches of surfels that are timed.
const STRETCHES: usize = 8;

/// Support of compensated weights and of those that replace them on noise, in radii.
const SUPPORTS: [f64; 2] = [1.6, 1.2];

/// A solid made ready to be walked.
pub struct Plain {
    solid: Solid,
    scale: Scale,
    surface: Surface,
    /// What each surfel carries: mu0, the tensor, mu2.
    lumps: Vec<[f64; 8]>,
    /// Has the surfel opposite normals across two opposite sides?
    ridges: Vec<bool>,
}

/// Processor time, microseconds a surfel.
#[derive(Clone, Copy, Debug)]
pub struct PlainTime {
    /// Normals.
    pub normals: f64,
    /// Sums over the balls.
    pub sums: f64,
    /// The surface, the measures of its cells, curvatures from sums.
    pub rest: f64,
}

impl Plain {
    /// The surface of a solid. Measures are made with its trivial normals: none takes another time.
    pub fn new(solid: Solid) -> Self {
        let scale = Scale::new([1.0; 3]);
        let surface = Surface::new(&solid, false, Adjacency::Interior);
        let trivial = normals::estimate(&solid, &surface, &scale, Estimator::Trivial);
        Self::with_normals(solid, scale, surface, &trivial.u)
    }

    fn with_normals(solid: Solid, scale: Scale, surface: Surface, u: &[Vector]) -> Self {
        let cells = Cells::new(&surface, u, &scale);
        let lumps = lumps(&surface, &cells, &scale);
        let ridges = (0..surface.len()).map(|f| is_ridge(&surface, f)).collect();
        Plain {
            solid,
            scale,
            surface,
            lumps,
            ridges,
        }
    }

    /// Number of surfels.
    pub fn surfels(&self) -> usize {
        self.surface.len()
    }

    /// Times a method at a radius in voxels, its walks on about `sample` surfels.
    pub fn time(&self, method: Method, radius: f64, sample: usize) -> PlainTime {
        let stretches = stretches(self.surface.len(), STRETCHES, sample / STRETCHES);
        let count: usize = stretches.iter().map(Range::len).sum();
        let each = |seconds: f64, count: usize| seconds * 1e6 / count.max(1) as f64;
        let normal_radius = method.normal_radius(radius);
        let normals = match method {
            Method::Default => timed(|| self.averages(normal_radius, &stretches)).1,
            Method::Invariants => timed(|| self.invariants(normal_radius, &stretches)).1,
        };
        let (sums, summing) = timed(|| match method {
            Method::Default => self.compensated(radius, &stretches),
            Method::Invariants => self.lumped(radius, &stretches),
        });
        let ((), curvatures) = timed(|| {
            for sums in &sums {
                black_box(Curvature::new(sums, [0.6, 0.0, 0.8], 1.0));
            }
        });
        let ((), cells) = timed(|| {
            let surface = Surface::new(&self.solid, false, Adjacency::Interior);
            let u = vec![[0.6, 0.0, 0.8]; surface.len()];
            black_box(Cells::new(&surface, &u, &self.scale));
        });
        PlainTime {
            normals: each(normals.cpu, count),
            sums: each(summing.cpu, count),
            rest: each(curvatures.cpu, count) + each(cells.cpu, self.surface.len()),
        }
    }

    /// The normals of the surface average.
    fn averages(&self, radius: f64, stretches: &[Range<usize>]) -> Vec<Vector> {
        let ball = LatticeBall::on_khalimsky(&self.scale, radius);
        let mut walk = Walk::new(&self.surface);
        let mut normals = Vec::new();
        for p in stretches.iter().cloned().flatten() {
            self.walk(&mut walk, &ball, p);
            let (mut signs, mut signed_squares) = ([0i64; 3], [0i64; 3]);
            for &q in &walk.members {
                let surfel = self.surface.surfels[q as usize];
                signs[surfel.axis] += i64::from(surfel.sign);
                signed_squares[surfel.axis] += i64::from(surfel.sign) * self.square(&ball, p, q);
            }
            let sum = [0, 1, 2].map(|axis| {
                let weighted =
                    ball.squared_radius * signs[axis] as f64 - signed_squares[axis] as f64;
                weighted / ball.squared_radius * self.scale.area(axis)
            });
            let island = !walk.meets_border && !walk.meets_rim;
            normals.push(
                if island || norm(sum) <= 1e-12 * walk.members.len() as f64 {
                    self.surface.surfels[p].normal()
                } else {
                    normalised(sum)
                },
            );
        }
        normals
    }

    /// The normals of integral invariants, each voxel of the ball visited.
    fn invariants(&self, radius: f64, stretches: &[Range<usize>]) -> Vec<Vector> {
        let estimator = Estimator::IntegralInvariant {
            radius_world: radius,
            orientation: Orientation::Moment,
        };
        let mut normals = Vec::new();
        // They look at nothing of a surface but its surfels, so any other will hold them.
        let nothing = Solid {
            dims: [1; 3],
            inside: vec![false],
        };
        let mut part = Surface::new(&nothing, false, Adjacency::Interior);
        for stretch in stretches {
            part.surfels.clear();
            part.surfels
                .extend_from_slice(&self.surface.surfels[stretch.clone()]);
            normals.extend(normals::estimate(&self.solid, &part, &self.scale, estimator).u);
        }
        normals
    }

    fn lumped(&self, radius: f64, stretches: &[Range<usize>]) -> Vec<Sums> {
        let ball = LatticeBall::on_khalimsky(&self.scale, radius);
        let mut walk = Walk::new(&self.surface);
        let mut sums = Vec::new();
        for p in stretches.iter().cloned().flatten() {
            self.walk(&mut walk, &ball, p);
            let mut sum = [0.0; 8];
            for &q in &walk.members {
                let own = &self.lumps[q as usize];
                (0..8).for_each(|i| sum[i] += own[i]);
            }
            sums.push(sums_of(&sum));
        }
        sums
    }

    fn compensated(&self, radius: f64, stretches: &[Range<usize>]) -> Vec<Sums> {
        let ball = LatticeBall::on_khalimsky(&self.scale, SUPPORTS[0] * radius);
        // Squares of Khalimsky displacements are four times those of voxels.
        let per_square = SUPPORTS.map(|support| 0.25 / (support * radius).powi(2));
        let mut walk = Walk::new(&self.surface);
        let mut results = Vec::new();
        for p in stretches.iter().cloned().flatten() {
            self.walk(&mut walk, &ball, p);
            let mut sums = [[0.0; 8]; 2];
            let mut ridges = 0.0;
            for &q in &walk.members {
                let own = &self.lumps[q as usize];
                let square = self.square(&ball, p, q) as f64;
                let [s, t] = per_square.map(|per_square| (square * per_square).min(1.0));
                let weights = [(1.0 - s) * (1.0 - 2.0 * s), 1.0 - t];
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    (0..8).for_each(|i| sum[i] += weight * own[i]);
                }
                ridges += f64::from(u8::from(self.ridges[q as usize]));
            }
            let noisy = ridges / walk.members.len() as f64;
            results.push(blended(&sums, noisy, radius));
        }
        results
    }

    fn walk(&self, walk: &mut Walk<'_>, ball: &LatticeBall, p: usize) {
        walk.connected(p as u32, |q| self.square(ball, p, q) <= ball.threshold);
    }

    fn square(&self, ball: &LatticeBall, p: usize, q: u32) -> i64 {
        let (p, q) = (
            self.surface.surfels[p].k,
            self.surface.surfels[q as usize].k,
        );
        ball.square([q[0] - p[0], q[1] - p[1], q[2] - p[2]])
    }
}

/// Sums with the weights that the evidence is for: see `Weights::Compensated` of the plain reference.
fn blended(sums: &[[f64; 8]; 2], ridges: f64, radius: f64) -> Sums {
    let rise = |x: f64, from: f64, to: f64| {
        let s = ((x - from) / (to - from)).clamp(0.0, 1.0);
        s * s * (3.0 - 2.0 * s)
    };
    let squares = SUPPORTS.map(|support| (support * radius).powi(2));
    let of_plane = [squares[0] / 6.0, squares[1] / 2.0];
    let area = [0, 1].map(|i| sums[i][0] / of_plane[i]);
    let eaten = if area[1] > 0.0 {
        1.0 - rise(area[0] / area[1], 0.4, 0.6)
    } else {
        1.0
    };
    let difference: f64 = (1..7)
        .map(|e| {
            let difference = sums[0][e] / sums[0][0] - sums[1][e] / sums[1][0];
            difference * difference * if e < 4 { 1.0 } else { 2.0 }
        })
        .sum();
    let contrast = difference.sqrt() * radius.powi(3);
    let robust = rise(ridges, 0.07, 0.14)
        .max(eaten)
        .max(1.0 - rise(contrast, 0.5, 1.3));
    let parts = [1.0 - robust, robust * of_plane[0] / of_plane[1]];
    sums_of(&std::array::from_fn(|i| {
        parts[0] * sums[0][i] + parts[1] * sums[1][i]
    }))
}

fn sums_of(values: &[f64; 8]) -> Sums {
    Sums {
        mu0: values[0],
        tensor: std::array::from_fn(|e| values[1 + e]),
        mu2: values[7],
        omega: 0.0,
    }
}

/// What each surfel carries: the lumped sum over it alone.
fn lumps(surface: &Surface, cells: &Cells, scale: &Scale) -> Vec<[f64; 8]> {
    let ball = Ball::new(scale, 1.0, Weights::Lumped);
    let mut walk = Walk::new(surface);
    let lump = |f: u32| {
        walk.connected(f, |_| false);
        let (sums, _) = ball.sum(surface, cells, &walk, f);
        let [xx, yy, zz, xy, xz, yz] = sums.tensor;
        [sums.mu0, xx, yy, zz, xy, xz, yz, sums.mu2]
    };
    (0..surface.len() as u32).map(lump).collect()
}

fn is_ridge(surface: &Surface, f: usize) -> bool {
    let across = surface.neighbours[f];
    let opposite = |a: u32, b: u32| {
        a != OPEN && b != OPEN && {
            let (a, b) = (&surface.surfels[a as usize], &surface.surfels[b as usize]);
            a.axis == b.axis && a.sign == -b.sign
        }
    };
    opposite(across[0], across[2]) || opposite(across[1], across[3])
}

/// `count` ranges of `size` numbers below `length`, evenly spread; all numbers if there are not that many.
fn stretches(length: usize, count: usize, size: usize) -> Vec<Range<usize>> {
    if count * size >= length {
        return std::iter::once(0..length).collect();
    }
    let starts = (0..count).map(|i| (2 * i + 1) * length / (2 * count) - size / 2);
    starts.map(|start| start..start + size).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::goursat;

    #[test]
    fn stretches_lie_within_and_do_not_meet() {
        assert_eq!(
            stretches(10, 2, 5),
            std::iter::once(0..10).collect::<Vec<_>>()
        );
        assert_eq!(stretches(100, 2, 10), [20..30, 70..80]);
        for (length, count, size) in [(101, 8, 12), (1000, 8, 1), (17, 8, 2)] {
            let ranges = stretches(length, count, size);
            assert!(ranges.windows(2).all(|w| w[0].end <= w[1].start));
            assert!(ranges.last().unwrap().end <= length);
            assert!(ranges.iter().all(|range| range.len() == size));
        }
    }

    /// What is timed gives the numbers of the oracle, which is slower and simpler.
    #[test]
    fn walks_give_the_normals_and_sums_of_the_plain_reference() {
        let (solid, _) = goursat::digitised(1.0);
        let scale = Scale::new([1.0; 3]);
        let surface = Surface::new(&solid, false, Adjacency::Interior);
        let radius = 3.0;
        let average = Estimator::SurfaceAverage {
            radius_world: radius,
        };
        let u = normals::estimate(&solid, &surface, &scale, average).u;
        let cells = Cells::new(&surface, &u, &scale);
        let plain = Plain::with_normals(solid, scale, surface.clone(), &u);
        let stretches = stretches(surface.len(), 4, 50);
        let of_stretches = |all: &[Vector]| -> Vec<Vector> {
            let parts = stretches.iter().map(|range| &all[range.clone()]);
            parts.flatten().copied().collect()
        };
        assert_eq!(plain.averages(radius, &stretches), of_stretches(&u));
        let invariants = Estimator::IntegralInvariant {
            radius_world: radius,
            orientation: Orientation::Moment,
        };
        let all = normals::estimate(&plain.solid, &surface, &scale, invariants).u;
        assert_eq!(plain.invariants(radius, &stretches), of_stretches(&all));
        for (weights, found) in [
            (Weights::Lumped, plain.lumped(radius, &stretches)),
            (
                Weights::Compensated { refined: false },
                plain.compensated(radius, &stretches),
            ),
        ] {
            let ball = Ball::new(&scale, radius, weights);
            let mut walk = Walk::new(&surface);
            for (p, found) in stretches.iter().cloned().flatten().zip(found) {
                walk.connected(p as u32, |q| ball.has(&surface, p as u32, q));
                let (expected, _) = ball.sum(&surface, &cells, &walk, p as u32);
                // the reference rounds compensated weights to 2^-15, which these walks do without
                let slack = match weights {
                    Weights::Compensated { .. } => 1e-4,
                    _ => 1e-9,
                };
                let near = |a: f64, b: f64| (a - b).abs() < slack * expected.mu0;
                assert!(near(found.mu0, expected.mu0) && near(found.mu2, expected.mu2));
                assert!((0..6).all(|e| near(found.tensor[e], expected.tensor[e])));
            }
        }
    }
}
