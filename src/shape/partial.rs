//! Grey images of a shape: each voxel the part of it that is inside, blurred and with noise if
//! wanted, as a scanner would see it.
//!
//! **In:** a [`Digitisation`], a [`Scanner`]. **Out:** planes of values in increasing z, 0 outside
//! and 1 inside but for blur and noise; the surface is at 1/2.
//!
//! ```text
//!   fraction inside  ->  blur, along x and y, then z  ->  + noise
//!   (sub-boxes cut by tangent planes)  (point spread)     (white, normal)
//! ```
//!
//! **The fraction.** A voxel near the surface is cut into 4^3 boxes, and each box by the plane
//! through the point of the surface nearest its centre (to second order along the gradient).
//! The part of a box on one side of a plane is exact. For a curvature k and voxels of edge h what
//! is neglected is about k h / 200 of a voxel. A voxel is near if its centre is within its
//! diagonal of the surface, to first order; others are all in or all out by their centre.
//!
//! **The blur** is a Gaussian of equal width in the world, so of weights of its own along each axis
//! of box voxels; it ends at 4 sigma; beyond the image its nearest voxel goes on. **The noise** is
//! added after it, to each voxel for itself.
//!
//! **Guaranteed:** the same shape, grid, scanner and seed give the same values on any machine and
//! for any number of threads: arithmetic, square roots and the `libm` crate alone; the noise of a
//! voxel depends on the seed and its index.
//!
//! **Not guaranteed:** that the voxels at 1/2 or above are those of the digitisation: a voxel whose
//! centre is inside may be less than half inside, where the surface bends.

use std::collections::VecDeque;

use glam::DVec3;
use rayon::prelude::*;

use super::noise::scramble;
use super::{Digitisation, ImplicitShape, ShapeError};

/// The largest width of a blur, in voxels: the window of planes grows with it.
pub const MAX_BLUR: f64 = 16.0;

/// Boxes a voxel near the surface is cut into, along each axis.
const CUTS: usize = 4;

/// Where the blur ends, in sigma: what is cut off weighs less than a grey level of 16 bits.
const TRUNCATION: f64 = 4.0;

/// What stands between a shape and its image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scanner {
    /// Standard deviation of the blur, in lengths of the longest edge of a voxel; 0 for none.
    pub blur: f64,
    /// Standard deviation of the noise, where inside and outside differ by 1; 0 for none.
    pub noise: f64,
    /// Seed of the noise.
    pub seed: u64,
}

/// Planes of a grey image, made in one pass forward.
#[derive(Debug)]
pub struct GreyPlanes<'a, S> {
    digitisation: &'a Digitisation<S>,
    scanner: Scanner,
    /// Weights of the blur at distances 0, 1, ... voxels along each axis.
    weights: [Vec<f64>; 3],
    /// Planes of fractions, blurred along x and y.
    window: VecDeque<Vec<f64>>,
    /// z of the first plane in `window`.
    window_start: usize,
    /// z of the next plane to give.
    next: usize,
}

impl<'a, S: ImplicitShape> GreyPlanes<'a, S> {
    /// The planes of the image of a shape.
    ///
    /// # Errors
    /// If the blur is not from 0 to [`MAX_BLUR`], or the noise not from 0 to 10.
    pub fn new(digitisation: &'a Digitisation<S>, scanner: Scanner) -> Result<Self, ShapeError> {
        for (what, value, limit) in [
            ("blur", scanner.blur, MAX_BLUR),
            ("grey noise", scanner.noise, 10.0),
        ] {
            if !(0.0..=limit).contains(&value) {
                return Err(ShapeError::Scanner { what, value, limit });
            }
        }
        let spacing = digitisation.spacing();
        let longest = spacing.max_element();
        let weights = [0, 1, 2].map(|a| {
            let sigma = scanner.blur * longest / spacing[a];
            let far = (TRUNCATION * sigma) as usize;
            let weight = |i: usize| {
                let d = i as f64;
                if i == 0 {
                    1.0
                } else {
                    libm::exp(-d * d / (2.0 * sigma * sigma))
                }
            };
            let weights: Vec<f64> = (0..=far).map(weight).collect();
            let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
            weights.iter().map(|w| w / sum).collect()
        });
        Ok(Self {
            digitisation,
            scanner,
            weights,
            window: VecDeque::new(),
            window_start: 0,
            next: 0,
        })
    }

    /// Overwrites `out` with the next plane, x fastest; false after the last one.
    pub fn next_plane(&mut self, out: &mut Vec<f64>) -> bool {
        let [nx, ny, nz] = self.digitisation.dims();
        let z = self.next;
        if z >= nz {
            return false;
        }
        let far = self.weights[2].len() - 1;
        while self.window_start + far < z {
            self.window.pop_front();
            self.window_start += 1;
        }
        let (from, to) = (self.window_start + self.window.len(), (z + far + 1).min(nz));
        let new: Vec<Vec<f64>> = (from..to.max(from))
            .into_par_iter()
            .map(|z| self.blurred_in_plane(z))
            .collect();
        self.window.extend(new);
        out.clear();
        out.resize(nx * ny, 0.0);
        let this = &*self;
        let plane = |z: usize| &this.window[z - this.window_start];
        out.par_chunks_exact_mut(nx)
            .enumerate()
            .for_each(|(y, row)| {
                let row_of = |z: usize| &plane(z)[y * nx..(y + 1) * nx];
                let weights = &this.weights[2];
                for (value, v) in row.iter_mut().zip(row_of(z)) {
                    *value = weights[0] * v;
                }
                for (i, weight) in weights.iter().enumerate().skip(1) {
                    let below = row_of(z.saturating_sub(i));
                    let above = row_of((z + i).min(nz - 1));
                    for ((value, a), b) in row.iter_mut().zip(below).zip(above) {
                        *value += weight * (a + b);
                    }
                }
                if this.scanner.noise > 0.0 {
                    let key = scramble(scramble(scramble(this.scanner.seed) ^ z as u64) ^ y as u64);
                    for (x, value) in row.iter_mut().enumerate() {
                        *value += this.scanner.noise * normal_draw(key ^ x as u64);
                    }
                }
            });
        self.next += 1;
        true
    }

    /// A plane of fractions, blurred along x and y.
    fn blurred_in_plane(&self, z: usize) -> Vec<f64> {
        let [nx, ny, _] = self.digitisation.dims();
        let mut plane = fractions(self.digitisation, z);
        let [along_x, along_y, _] = &self.weights;
        if along_x.len() > 1 {
            let mut blurred = vec![0.0; nx];
            for row in plane.chunks_exact_mut(nx) {
                for (x, value) in blurred.iter_mut().enumerate() {
                    *value = along_x[0] * row[x];
                    for (i, weight) in along_x.iter().enumerate().skip(1) {
                        *value += weight * (row[x.saturating_sub(i)] + row[(x + i).min(nx - 1)]);
                    }
                }
                row.copy_from_slice(&blurred);
            }
        }
        if along_y.len() > 1 {
            let source = plane.clone();
            for (y, row) in plane.chunks_exact_mut(nx).enumerate() {
                for (x, value) in row.iter_mut().enumerate() {
                    *value = along_y[0] * source[y * nx + x];
                    for (i, weight) in along_y.iter().enumerate().skip(1) {
                        let (a, b) = (y.saturating_sub(i), (y + i).min(ny - 1));
                        *value += weight * (source[a * nx + x] + source[b * nx + x]);
                    }
                }
            }
        }
        plane
    }
}

/// A draw of the normal distribution of width 1, by the transform of Box and Muller.
fn normal_draw(key: u64) -> f64 {
    const ONE: f64 = (1u64 << 53) as f64;
    let first = scramble(key);
    let second = scramble(first);
    // Above 0, so that the logarithm is finite.
    let radius = (-2.0 * libm::log(((first >> 11) as f64 + 0.5) / ONE)).sqrt();
    radius * libm::cos(std::f64::consts::TAU * ((second >> 11) as f64 / ONE))
}

/// The part of each voxel of a plane that is inside the shape.
fn fractions<S: ImplicitShape>(digitisation: &Digitisation<S>, z: usize) -> Vec<f64> {
    let [nx, ny, _] = digitisation.dims();
    let mut values = Vec::new();
    digitisation.plane_values(z, &mut values);
    let shape = digitisation.shape();
    let edges = digitisation.spacing();
    let diagonal = edges.length();
    for y in 0..ny {
        for x in 0..nx {
            let value = &mut values[y * nx + x];
            let centre = digitisation.voxel_to_world([x, y, z]);
            // Not more than a diagonal away, to first order.
            let near = value.abs() <= diagonal * shape.gradient(centre).length();
            *value = if near {
                fraction(shape, centre, edges)
            } else {
                f64::from(*value <= 0.0)
            };
        }
    }
    values
}

/// The part of a box that is inside a shape, by parts.
fn fraction<S: ImplicitShape>(shape: &S, centre: DVec3, edges: DVec3) -> f64 {
    let small = edges / CUTS as f64;
    let place = |i: usize| (i as f64 + 0.5) / CUTS as f64 - 0.5;
    let mut sum = 0.0;
    for z in 0..CUTS {
        for y in 0..CUTS {
            for x in 0..CUTS {
                let p = centre + edges * DVec3::new(place(x), place(y), place(z));
                let value = shape.value(p);
                let gradient = shape.gradient(p);
                let slope = gradient.length();
                sum += if slope > 0.0 {
                    let n = gradient / slope;
                    let bend = n.dot(shape.hessian(p) * n);
                    half_space_part(n, distance(value, slope, bend), small)
                } else {
                    f64::from(value <= 0.0)
                };
            }
        }
    }
    sum / (CUTS * CUTS * CUTS) as f64
}

/// How far along the gradient a function of given value, slope and second derivative is 0, with
/// the sign of the value: the smaller root of value - slope d + bend d^2 / 2.
fn distance(value: f64, slope: f64, bend: f64) -> f64 {
    let square = slope * slope - 2.0 * bend * value;
    if square > 0.0 {
        // The form that does not cancel.
        2.0 * value / (slope + square.sqrt())
    } else {
        value / slope
    }
}

/// The part of a box of the given edges with `n . x <= -d`, x from its centre.
///
/// In a unit cube with m_i = |n_i| edge_i and its lowest corner at the level 0, the volume below a
/// level t is the sum over the corners below it of (+-)(t - level)^3 / (6 m1 m2 m3); where some m_i
/// vanish, the same with fewer factors.
fn half_space_part(n: DVec3, d: f64, edges: DVec3) -> f64 {
    let m = (n * edges).abs();
    let whole = m.x + m.y + m.z;
    let level = 0.5 * whole - d;
    if level <= 0.0 {
        return 0.0;
    }
    if level >= whole {
        return 1.0;
    }
    // By symmetry the smaller part, which loses fewer digits.
    if 2.0 * level > whole {
        return 1.0 - part_below(m, whole - level);
    }
    part_below(m, level)
}

/// The part of the unit cube with `m . x <= level`, for m >= 0 and a level from 0 to half of the
/// sum of m.
fn part_below(m: DVec3, level: f64) -> f64 {
    let mut m = m.to_array();
    m.sort_by(f64::total_cmp);
    let [a, b, c] = m;
    // Edges so nearly along the plane that their share cannot be told in the sum of cubes.
    if a < 1e-4 * c {
        // The mean over x of the part of the square below level - a x: at the middle, to second order.
        return square_below(b, c, level - 0.5 * a);
    }
    let cube = |x: f64| if x > 0.0 { x * x * x } else { 0.0 };
    let t = level;
    let sum = cube(t) - cube(t - a) - cube(t - b) - cube(t - c)
        + cube(t - a - b)
        + cube(t - a - c)
        + cube(t - b - c)
        - cube(t - a - b - c);
    (sum / (6.0 * a * b * c)).clamp(0.0, 1.0)
}

/// The part of the unit square with `b x + c y <= level`, for 0 <= b <= c and 0 < c.
fn square_below(b: f64, c: f64, level: f64) -> f64 {
    if b < 1e-6 * c {
        return ((level - 0.5 * b) / c).clamp(0.0, 1.0);
    }
    let square = |x: f64| if x > 0.0 { x * x } else { 0.0 };
    let sum = square(level) - square(level - b) - square(level - c) + square(level - b - c);
    (sum / (2.0 * b * c)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::super::{Grid, Plane, Sphere, Torus};
    use super::*;

    fn image<S: ImplicitShape>(shape: S, grid: Grid, scanner: Scanner) -> ([usize; 3], Vec<f64>) {
        let digitisation = Digitisation::new(shape, grid).unwrap();
        let mut planes = GreyPlanes::new(&digitisation, scanner).unwrap();
        let (mut all, mut plane) = (Vec::new(), Vec::new());
        while planes.next_plane(&mut plane) {
            all.extend_from_slice(&plane);
        }
        (digitisation.dims(), all)
    }

    #[test]
    fn the_part_of_a_box_below_a_plane_is_that_of_counting_points() {
        for (n, edges) in [
            ([1.0, 0.0, 0.0], [1.0, 1.0, 1.0]),
            ([0.0, 0.0, -1.0], [0.5, 2.0, 1.5]),
            ([1.0, 1.0, 0.0], [1.0, 1.0, 1.0]),
            ([0.3, -0.5, 0.8], [1.0, 0.4, 2.0]),
            ([1e-5, 0.6, 0.8], [1.0, 1.0, 1.0]),
            ([1e-9, 1e-8, 1.0], [1.0, 1.0, 1.0]),
            ([0.01, 0.7, 0.7], [1.0, 1.0, 1.0]),
        ] {
            let n = DVec3::from(n).normalize();
            let edges = DVec3::from(edges);
            let mut last = 1.0;
            for step in -12..=12 {
                let d = 0.1 * f64::from(step);
                const N: usize = 60;
                let place = |i: usize| (i as f64 + 0.5) / N as f64 - 0.5;
                let mut count = 0;
                for i in 0..N * N * N {
                    let p = DVec3::new(place(i % N), place(i / N % N), place(i / N / N));
                    count += usize::from(n.dot(p * edges) <= -d);
                }
                let expected = count as f64 / (N * N * N) as f64;
                let found = half_space_part(n, d, edges);
                // A plane along an axis takes or leaves a whole layer of points.
                assert!(
                    (found - expected).abs() < 0.6 / N as f64,
                    "{n} {d} {found} {expected}"
                );
                assert!(found <= last);
                last = found;
                let other = half_space_part(-n, -d, edges);
                assert!((found + other - 1.0).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn fractions_of_a_ball_sum_to_its_volume() {
        for spacing in [DVec3::ONE, DVec3::new(0.5, 1.0, 0.8)] {
            let mut grid = Grid::boxes(spacing);
            grid.offset = DVec3::new(0.3, 0.1, -0.4);
            for blur in [0.0, 1.1] {
                let scanner = Scanner {
                    blur,
                    ..Default::default()
                };
                let (_, all) = image(Sphere::new(6.0).unwrap(), grid, scanner);
                let volume = all.iter().sum::<f64>() * spacing.element_product();
                let exact = 4.0 / 3.0 * std::f64::consts::PI * 216.0;
                // a thousandth of a voxel of radius
                assert!((volume / exact - 1.0).abs() < 5e-4, "{volume} {exact}");
                assert!(all.iter().all(|v| (-1e-12..=1.0 + 1e-12).contains(v)));
            }
        }
    }

    #[test]
    fn a_blurred_plane_is_the_error_function_of_the_distance() {
        let plane = Plane::new(DVec3::new(1.0, 2.0, 2.0), 0.3, 8.0).unwrap();
        let grid = Grid::cubic(1.0);
        let scanner = Scanner {
            blur: 1.5,
            ..Default::default()
        };
        let digitisation = Digitisation::new(plane, grid).unwrap();
        let (dims, all) = image(digitisation.shape(), grid, scanner);
        let n = DVec3::new(1.0, 2.0, 2.0) / 3.0;
        for (i, value) in all.iter().enumerate() {
            let p = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
            if (0..3).any(|a| p[a] < 7 || p[a] + 7 >= dims[a]) {
                continue;
            }
            let d = n.dot(digitisation.voxel_to_world(p)) - 0.1;
            // The voxel itself widens the blur by a twelfth of its square.
            let sigma = (1.5f64 * 1.5 + 1.0 / 12.0).sqrt();
            let expected = 0.5 * libm::erfc(d / (sigma * std::f64::consts::SQRT_2));
            assert!((value - expected).abs() < 2e-3, "{p:?} {value} {expected}");
        }
    }

    #[test]
    fn noise_has_the_width_asked_and_the_same_values_for_any_number_of_threads() {
        let scanner = Scanner {
            blur: 0.8,
            noise: 0.1,
            seed: 5,
        };
        let made = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap()
                .install(|| image(Torus::new(6.0, 2.0).unwrap(), Grid::cubic(0.7), scanner).1)
        };
        let noisy = made(1);
        assert!(noisy == made(3));
        let still = Scanner {
            noise: 0.0,
            ..scanner
        };
        let (_, clean) = image(Torus::new(6.0, 2.0).unwrap(), Grid::cubic(0.7), still);
        let count = clean.len() as f64;
        let differences = || noisy.iter().zip(&clean).map(|(a, b)| (a - b) / 0.1);
        let mean = differences().sum::<f64>() / count;
        let variance = differences().map(|d| d * d).sum::<f64>() / count;
        let fourth = differences().map(|d| d.powi(4)).sum::<f64>() / count;
        assert!(mean.abs() < 5.0 / count.sqrt(), "{mean}");
        assert!((variance - 1.0).abs() < 10.0 / count.sqrt(), "{variance}");
        assert!((fourth - 3.0).abs() < 60.0 / count.sqrt(), "{fourth}");
        let other = Scanner { seed: 6, ..scanner };
        assert!(image(Torus::new(6.0, 2.0).unwrap(), Grid::cubic(0.7), other).1 != noisy);
    }

    #[test]
    fn scanners_that_cannot_be_are_errors() {
        let digitisation = Digitisation::new(Sphere::new(3.0).unwrap(), Grid::cubic(1.0)).unwrap();
        for (blur, noise) in [
            (-1.0, 0.0),
            (f64::NAN, 0.0),
            (17.0, 0.0),
            (0.0, f64::NAN),
            (0.0, 11.0),
        ] {
            let scanner = Scanner {
                blur,
                noise,
                seed: 1,
            };
            assert!(GreyPlanes::new(&digitisation, scanner).is_err());
        }
    }
}
