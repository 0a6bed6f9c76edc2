//! Refined normals: the smoothest surface through the voxels, found by fits that stay within them.
//!
//! Comes in: first normals, from [`super::average`], and the surface around. Goes out: better normals. It is made
//! for clean segmentations of smooth objects; see *Where it gives way*.
//!
//! **What is known of the surface.** It crosses the segment between the inner and the outer voxel of each
//! surfel: at `centroid + offset n`, `|offset| <= 1/2` of the voxel's edge. A fit that smooths only forgets this,
//! and smooths the object with the staircase. Here each pass fits a polynomial height over the
//! tangent plane to the crossings around each surfel, moves the surfel's own crossing to the fit, and
//! clips it to its segment. What is clipped tells the next fit where the surface must be:
//!
//! ```text
//!   u, offset = 0 ---> fit of degree 2 ---> 3 ---> 3 ---> 3 ---> 4 ---> u
//!   (1 - t average      each: sums over C(p), 3 to 15 unknowns, crossing, clip
//!    over 1.2 r)
//! ```
//!
//! A fit at p, in the frame (e1, e2, u(p)), over C(p) with radius `a r` ([`PASSES`]): least squares with weights
//!
//! ```text
//!   w(q) = max(0, <n(q), u(q)>) area(q) ((<u(p), u(q)> - c) / (1 - c))^2 (1 - d^2 / (a r)^2)
//! ```
//!
//! The first two factors are the area of the surface that the surfel stands for; the third ends the fit where the surface
//! has turned by more than arccos c, which is what makes the radius adapt to curvature: height over a
//! plane says nothing of a surface that has turned away. The offset moves by 1.8 times its way to the fit, since
//! repeated smoothing converges slowly. The last fit has degree 4, to undo the bias of those before.
//!
//! Low degrees and large radii smooth the staircase, which is what limits a first fit; the bias they have
//! pushes crossings out of their segments, where clipping holds them. On flat spots parallel to an axis
//! there is nothing to clip, and what is gained is little.
//!
//! **Where it gives way.** Where many surfels of C(p) are ridges ([`crate::measure::surface::Surface::is_ridge`]), the surface
//! is noisy, segments hold nothing, and u(p) is the first normal: between the shares of
//! [`crate::measure::ball::NOISY_SHARE`] it is between both. A fit without enough surfels has a lower degree, or leaves the normal as it is,
//! and so does one that turns it farther than it looks. Surfels that have no normal of their own keep the trivial one.
//!
//! Guaranteed: sums run in the order of the walk over C(p), which knows nothing of the cut into bricks; no
//! fused operations. What the border of an open image could change is told, through all passes: about 10 radii from
//! the border. Not guaranteed: that a surface within all segments exists near u.

use glam::DVec3;

use crate::khalimsky::axis;
use crate::lattice::{Ball, Lattice, LatticeError, MAX_RADIUS};
use crate::measure::ball::{NOISY_SHARE, rise};
use crate::measure::surface::Surface;
use crate::simd::{Level, Work, dispatch};
use crate::surfel::{Walker, displacement};

use super::trivial_normal;

/// A pass over all surfels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pass {
    /// Degree of the polynomial, at most 4.
    pub degree: usize,
    /// Radius of the fit, in radii of the measures.
    pub radius: f64,
    /// Normals that turn to a smaller cosine take no part.
    pub cosine: f64,
    /// How far an offset moves, in ways to the fit.
    pub relaxation: f64,
}

const fn pass(degree: usize, radius: f64, cosine: f64, relaxation: f64) -> Pass {
    Pass {
        degree,
        radius,
        cosine,
        relaxation,
    }
}

/// The passes. *Measured* with prototypes on sphere, ellipsoid, torus, Goursat's surface and the rounded cube at h = 1 to 1/8: two
/// passes of degree 3 less cost a tenth of the accuracy; degree 4 from the start gives 1.2 to 1.5 times the error,
/// degree 3 to the end 1.1 times; radii of 1.6 and 2 are within a twentieth, 1.4 is a tenth worse.
pub const PASSES: [Pass; 5] = [
    pass(2, 1.5, 0.7, 1.8),
    pass(3, 1.8, 0.7, 1.8),
    pass(3, 1.8, 0.7, 1.8),
    pass(3, 1.8, 0.7, 1.8),
    pass(4, 2.0, 0.6, 1.0),
];

/// Radius of the average that the first normals are, in radii of the measures.
pub const FIRST_RADIUS: f64 = 1.2;

/// The passes made ready for a radius.
#[derive(Clone, Debug)]
pub struct RefineKernel {
    balls: Vec<Ball>,
    edges: DVec3,
}

/// What is known of a surfel between passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Unit normal.
    pub u: DVec3,
    /// Where the surface crosses the segment of the surfel: from the centroid along n, in edges of the voxel.
    pub offset: f64,
    /// What is beyond the border of an open image could change the estimate.
    pub cut: bool,
}

/// What a pass gives for a surfel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refined {
    /// The estimate.
    pub estimate: Estimate,
    /// How noisy the surface around is: 0 not at all, 1 as noise.
    pub noise: f64,
}

/// A surfel as a fit takes it.
#[derive(Clone, Copy, Debug)]
struct Sample {
    u: DVec3,
    /// From its centroid to where the surface crosses its segment, in voxel units. Not a place: that would be rounded as the
    /// box lies.
    shift: DVec3,
    /// The area of the surface that it stands for.
    area: f64,
    cut: bool,
}

/// A pass over some surfels.
struct PassOver<'a> {
    kernel: &'a RefineKernel,
    number: usize,
    surface: &'a Surface,
    around: &'a [Estimate],
    starts: &'a [usize],
}

impl Work for PassOver<'_> {
    type Output = Vec<Refined>;

    #[inline(always)]
    fn run<L: Level>(self) -> Vec<Refined> {
        let Self {
            kernel,
            number,
            surface,
            around,
            starts,
        } = self;
        let [ex, ey, ez] = kernel.edges.to_array();
        let areas = [ey * ez, ez * ex, ex * ey];
        let mut samples = Vec::with_capacity(around.len());
        for (surfel, estimate) in surface.surfels.list.iter().zip(around) {
            let along = axis(surfel.orientation);
            let n = trivial_normal(surfel.orientation);
            samples.push(Sample {
                u: estimate.u,
                shift: n * (estimate.offset * kernel.edges[along]),
                area: n.dot(estimate.u).max(0.0) * areas[along],
                cut: estimate.cut,
            });
        }
        let mut ridges = Vec::new();
        if number + 1 == kernel.passes() {
            ridges.extend((0..surface.len()).map(|i| surface.is_ridge(i)));
        }
        let mut scratch = Scratch::default();
        let mut refined = Vec::with_capacity(starts.len());
        for &start in starts {
            let (pass, ball) = (&PASSES[number], &kernel.balls[number]);
            let rim = (scratch.walker).walk(&surface.surfels, &surface.links, ball, start);
            let mut share = 0.0;
            if !ridges.is_empty() {
                let part = scratch.walker.part();
                let count = part.iter().filter(|&&q| ridges[q as usize]).count();
                share = count as f64 / part.len().max(1) as f64;
            }
            let estimate = kernel.fitted(
                pass,
                ball,
                surface,
                &samples,
                start,
                around[start].offset,
                &mut scratch,
            );
            refined.push(Refined {
                estimate: Estimate {
                    cut: estimate.cut || rim.open,
                    ..estimate
                },
                noise: rise(share, NOISY_SHARE),
            });
        }
        refined
    }
}

/// Surfels around one, in its frame and in radii: coordinates, heights, weights.
#[derive(Debug, Default)]
struct Scratch {
    walker: Walker,
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    w: Vec<f64>,
}

impl RefineKernel {
    /// The largest radius, in voxel units: fits look twice as far.
    pub const LARGEST_RADIUS: f64 = MAX_RADIUS / 2.0;

    /// Prepares for the radius of the measures, in voxel units.
    ///
    /// # Errors
    /// If it cannot be used.
    pub fn new(radius: f64, lattice: &Lattice) -> Result<Self, LatticeError> {
        let largest = Self::LARGEST_RADIUS;
        if radius > largest {
            return Err(LatticeError::Ball { radius, largest });
        }
        let metric = lattice.metric();
        let balls: Result<Vec<Ball>, _> = PASSES
            .iter()
            .map(|pass| metric.khalimsky_ball(pass.radius * radius))
            .collect();
        Ok(Self {
            balls: balls?,
            edges: DVec3::from_array(lattice.edges()),
        })
    }

    /// How many passes there are.
    #[must_use]
    pub fn passes(&self) -> usize {
        self.balls.len()
    }

    /// How many cells beyond its own a surfel's pass looks, along each axis.
    #[must_use]
    pub fn reach(&self, number: usize) -> [i32; 3] {
        // one more to know which surfels are ridges
        self.balls[number].reach().map(|r| r + 1)
    }

    /// Pass `number` over the surfels `starts` of a surface that covers its reach, with the estimates of all
    /// surfels after the pass before.
    ///
    /// # Panics
    /// If there are not as many estimates as surfels.
    #[must_use]
    pub fn pass(
        &self,
        number: usize,
        surface: &Surface,
        around: &[Estimate],
        starts: &[usize],
    ) -> Vec<Refined> {
        assert_eq!(around.len(), surface.len(), "an estimate for each surfel");
        dispatch(PassOver {
            kernel: self,
            number,
            surface,
            around,
            starts,
        })
    }

    /// The fit around a surfel, over the walk in `scratch`.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the body of a loop")]
    fn fitted(
        &self,
        pass: &Pass,
        ball: &Ball,
        surface: &Surface,
        samples: &[Sample],
        start: usize,
        offset: f64,
        scratch: &mut Scratch,
    ) -> Estimate {
        let Scratch { walker, x, y, z, w } = scratch;
        let surfels = &surface.surfels.list;
        let Sample { u, mut cut, .. } = samples[start];
        let (e1, e2) = tangents(u);
        let centre = surfels[start].k;
        let half = self.edges * 0.5;
        let per_radius = 1.0 / ball.radius;
        let per_squared = 1.0 / ball.squared;
        let per_turn = 1.0 / (1.0 - pass.cosine);
        let steepest = 1.0 / (pass.cosine * pass.cosine) - 1.0;
        for list in [&mut *x, &mut *y, &mut *z, &mut *w] {
            list.clear();
        }
        for &q in walker.part() {
            let sample = &samples[q as usize];
            let cosine = u.dot(sample.u);
            if cosine <= pass.cosine || sample.area <= 0.0 {
                continue;
            }
            cut |= sample.cut;
            let d = displacement(surfels[q as usize].k, centre);
            let t = ball.metric.squared(d) as f64 * per_squared;
            let turned = (cosine - pass.cosine) * per_turn;
            let v = (DVec3::from_array(d.map(f64::from)) * half + sample.shift) * per_radius;
            x.push(v.dot(e1));
            y.push(v.dot(e2));
            z.push(v.dot(u));
            w.push(sample.area * turned * turned * (1.0 - t));
        }
        let whole = w.len().next_multiple_of(LANES);
        for list in [&mut *x, &mut *y, &mut *z, &mut *w] {
            list.resize(whole, 0.0);
        }
        let fit = match pass.degree {
            2 => Fit::new::<2>(x, y, z, w),
            3 => Fit::new::<3>(x, y, z, w),
            _ => Fit::new::<4>(x, y, z, w),
        };
        let along = axis(surfels[start].orientation);
        let edge = trivial_normal(surfels[start].orientation) * self.edges[along] * per_radius;
        match fit.crossing([edge.dot(e1), edge.dot(e2), edge.dot(u)], offset) {
            // A normal that turns out of those that took part comes from too few of them.
            Some((at, [fx, fy])) if fx * fx + fy * fy <= steepest => Estimate {
                u: (u - e1 * fx - e2 * fy).normalize(),
                offset: (offset + pass.relaxation * (at - offset)).clamp(-0.5, 0.5),
                cut,
            },
            _ => Estimate { u, offset, cut },
        }
    }
}

/// Two unit vectors that are a direct frame with `u`.
#[inline(always)]
fn tangents(u: DVec3) -> (DVec3, DVec3) {
    let [x, y, z] = u.abs().to_array();
    let a = if x <= y && x <= z {
        DVec3::X
    } else if y <= z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    let e1 = (a - u * a.dot(u)).normalize();
    (e1, u.cross(e1))
}

/// Points summed side by side: the same on every machine, whatever it adds at once.
const LANES: usize = 8;

/// The highest degree of a fit.
const MOST_DEGREE: usize = 4;

/// Coefficients of a polynomial of degree 4 in two variables.
const TERMS: usize = 15;

/// Exponents of the terms, by degree: the first 3, 6, 10 are those of degree 1, 2, 3.
const EXPONENTS: [[usize; 2]; TERMS] = {
    let mut exponents = [[0; 2]; TERMS];
    let (mut at, mut degree) = (0, 0);
    while degree <= MOST_DEGREE {
        let mut b = 0;
        while b <= degree {
            exponents[at] = [degree - b, b];
            at += 1;
            b += 1;
        }
        degree += 1;
    }
    exponents
};

/// A pivot smaller than this, relative to its diagonal entry, is none: the points do not tell the term from those before.
const SMALLEST_PIVOT: f64 = 1e-9;

/// A height over the plane, as a polynomial.
#[derive(Clone, Copy, Debug)]
struct Fit {
    coefficients: [f64; TERMS],
    /// How many of them there are: a whole degree.
    terms: usize,
}

impl Fit {
    /// The least squares fit of degree `D`, or of the highest degree that the points tell.
    #[inline(always)]
    fn new<const D: usize>(x: &[f64], y: &[f64], z: &[f64], w: &[f64]) -> Self {
        const POWERS: usize = 2 * MOST_DEGREE + 1;
        let mut moments = [[[0.0f64; LANES]; POWERS]; POWERS];
        let mut heights = [[[0.0f64; LANES]; MOST_DEGREE + 1]; MOST_DEGREE + 1];
        let points = x.as_chunks().0.iter().zip(y.as_chunks().0);
        for ((x, y), (z, w)) in points.zip(z.as_chunks().0.iter().zip(w.as_chunks().0)) {
            let mut powers: [[f64; LANES]; POWERS] = [*w; POWERS];
            for a in 1..=2 * D {
                powers[a] = times(&powers[a - 1], x);
            }
            let mut of_y = [1.0; LANES];
            for b in 0..=2 * D {
                let row = moments[b][..=2 * D - b].iter_mut();
                for (sum, power) in row.zip(&powers) {
                    add_product(sum, power, &of_y);
                }
                if b <= D {
                    let height = times(&of_y, z);
                    let row = heights[b][..=D - b].iter_mut();
                    for (sum, power) in row.zip(&powers) {
                        add_product(sum, power, &height);
                    }
                }
                of_y = times(&of_y, y);
            }
        }
        let sum =
            |l: &[f64; LANES]| ((l[0] + l[1]) + (l[2] + l[3])) + ((l[4] + l[5]) + (l[6] + l[7]));
        let terms = (D + 1) * (D + 2) / 2;
        let mut matrix = [[0.0f64; TERMS]; TERMS];
        let mut right = [0.0f64; TERMS];
        for i in 0..terms {
            let [a, b] = EXPONENTS[i];
            right[i] = sum(&heights[b][a]);
            for j in 0..=i {
                let [c, d] = EXPONENTS[j];
                matrix[i][j] = sum(&moments[b + d][a + c]);
            }
        }
        solve(&mut matrix, right, terms)
    }

    /// The height and its slopes at a place.
    #[inline(always)]
    fn at(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let powers = |x: f64| [1.0, x, x * x, x * x * x, x * x * x * x];
        let (px, py) = (powers(x), powers(y));
        let (mut height, mut slopes) = (0.0, [0.0; 2]);
        for (c, [a, b]) in self.coefficients[..self.terms].iter().zip(EXPONENTS) {
            height += c * px[a] * py[b];
            if a > 0 {
                slopes[0] += c * a as f64 * px[a - 1] * py[b];
            }
            if b > 0 {
                slopes[1] += c * b as f64 * px[a] * py[b - 1];
            }
        }
        (height, slopes)
    }

    /// Where the line through the origin, `along` for each edge, crosses the fit: in edges, from a first guess, and
    /// the slopes of the fit there, as far as the segment goes. `None` if they do not tell.
    #[inline(always)]
    fn crossing(&self, along: [f64; 3], guess: f64) -> Option<(f64, [f64; 2])> {
        if self.terms < 3 {
            return None;
        }
        let mut at = guess;
        for _ in 0..2 {
            let (height, [fx, fy]) = self.at(at * along[0], at * along[1]);
            // how fast the line rises over the fit
            let rise = along[2] - fx * along[0] - fy * along[1];
            let length = along[0].abs().max(along[1].abs()).max(along[2].abs());
            if rise.abs() < 0.05 * length {
                break;
            }
            at = (at - (at * along[2] - height) / rise).clamp(-2.0, 2.0);
        }
        let inside = at.clamp(-0.5, 0.5);
        let (_, slopes) = self.at(inside * along[0], inside * along[1]);
        let sound = at.is_finite() && slopes.iter().all(|slope| slope.is_finite());
        sound.then_some((at, slopes))
    }
}

#[inline(always)]
fn times(a: &[f64; LANES], b: &[f64; LANES]) -> [f64; LANES] {
    std::array::from_fn(|lane| a[lane] * b[lane])
}

#[inline(always)]
fn add_product(sum: &mut [f64; LANES], a: &[f64; LANES], b: &[f64; LANES]) {
    for lane in 0..LANES {
        sum[lane] += a[lane] * b[lane];
    }
}

/// Solves by L D L^T, in place of the lower triangle; with fewer terms, a whole degree, where a pivot vanishes.
#[inline(always)]
fn solve(a: &mut [[f64; TERMS]; TERMS], mut right: [f64; TERMS], mut terms: usize) -> Fit {
    for j in 0..terms {
        let mut pivot = a[j][j];
        for k in 0..j {
            pivot -= a[j][k] * a[j][k] * a[k][k];
        }
        if pivot <= SMALLEST_PIVOT * a[j][j] || !pivot.is_finite() {
            terms = [10, 6, 3, 0]
                .into_iter()
                .find(|&whole| whole <= j)
                .unwrap_or(0);
            break;
        }
        for i in j + 1..terms {
            let mut s = a[i][j];
            for k in 0..j {
                s -= a[i][k] * a[j][k] * a[k][k];
            }
            a[i][j] = s / pivot;
        }
        a[j][j] = pivot;
    }
    for i in 0..terms {
        for k in 0..i {
            right[i] -= a[i][k] * right[k];
        }
    }
    for i in (0..terms).rev() {
        right[i] /= a[i][i];
        for k in i + 1..terms {
            right[i] -= a[k][i] * right[k];
        }
    }
    Fit {
        coefficients: right,
        terms,
    }
}

/// The normal of a surfel after the last pass: refined where the surface is smooth, the first one where it is noise.
#[must_use]
pub fn settled(refined: &Refined, first: DVec3) -> DVec3 {
    let mixed = refined.estimate.u * (1.0 - refined.noise) + first * refined.noise;
    mixed.try_normalize().unwrap_or(first)
}
