//! Grey-level gradient: u from the values themselves, not from the bits.
//!
//! The gradient at the surfel's centroid of the image smoothed by a Gaussian of standard
//! deviation sigma: the sum over voxels p of f(p) times the derivative of the Gaussian at
//! p - centroid, separable, so one derivative and two smoothing weights along the axes. Along its
//! own axis a surfel lies half-way between two voxels, along the others at a voxel's centre.
//! A Gaussian of equal width in the world has weights of its own on each axis of box voxels.
//!
//! ```text
//!   along the surfel's axis    o   o | o   o      distances 1/2, 3/2, ... edges
//!   along the others         o   o   o   o   o    distances 0, 1, 2, ... edges
//! ```
//!
//! Weights end at [`TRUNCATION`] sigma (but at a voxel on each side at least) and are normalised
//! on each axis: smoothing weights sum to 1 and derivative weights give a ramp its slope. So the
//! gradient of a linear image has its exact direction, whatever sigma and the shape of voxels.
//!
//! **Which side is out.** The values of the inner and the outer voxel tell: where the outer voxel
//! is lower, u points down the gradient, else up. For a threshold that is down everywhere, for
//! `value < T` up, and for a range the way the range is left at the surfel. A mask of labels
//! has no gradient worth the name; the command line refuses it.
//!
//! **Degenerate**, with the trivial normal: where the window holds a value that is not finite,
//! where the gradient is zero, and where the two voxels have the same value (only on the closed
//! border of an image, or beyond 2^53).
//!
//! **A gradient against the surfel** (`<u, n> <= 0`) is kept, and its row flagged `normal_opposed`:
//! it says that the step at this surfel is noise on a surface that runs otherwise, and the
//! corrected measures want the normal of that surface. To take the trivial normal there instead
//! was tried on shapes at partial volume with a blur of a voxel and noise of 0.1: errors of H were
//! up to 12 times larger, and no sigma helped.
//!
//! Values beyond the border are those of the nearest voxel. In an open image a row is marked `cut`
//! where its surfel touches the border, or where its window leaves the image and the solid meets the
//! border within the window: a solid clear of the border is taken to be all there is. Sums run in an
//! order that depends on the surfel alone.

use glam::DVec3;

use crate::khalimsky::{OrientedSurfel, axis};
use crate::lattice::{Lattice, LatticeError};
use crate::simd::{Level, Work, dispatch};
use crate::surfel::Surfels;
use crate::volume::{BitBox, GreyBox, GreyWindow, PlaneWindow};

use super::border::Border;
use super::{Normals, touches_border, trivial_normal};

/// Where the weights end, in sigma: the rim weighs 1.1 % of the middle. At 2 the rim would show as
/// a preference for the axes; at 4 a normal costs more than twice as much and reaches further.
pub const TRUNCATION: f64 = 3.0;

/// The least sigma, in voxel units: below it the nearest voxels are all there is, and weights
/// soon cannot be told from 0.
pub const MIN_SIGMA: f64 = 0.3;

/// The largest sigma, in voxel units, so that windows end where balls do.
pub const MAX_SIGMA: f64 = crate::lattice::MAX_RADIUS / TRUNCATION;

/// The values on either side of surfels: the least and the largest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sides {
    inner: [f64; 2],
    outer: [f64; 2],
}

impl Default for Sides {
    fn default() -> Self {
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        Self {
            inner: none,
            outer: none,
        }
    }
}

impl Sides {
    fn add(&mut self, inner: f64, outer: f64) {
        self.join(&Self {
            inner: [inner; 2],
            outer: [outer; 2],
        });
    }

    /// Takes in those of other surfels, in any order.
    pub fn join(&mut self, other: &Self) {
        for (own, other) in [
            (&mut self.inner, other.inner),
            (&mut self.outer, other.outer),
        ] {
            *own = [own[0].min(other[0]), own[1].max(other[1])];
        }
    }

    /// The two values, inner and outer, if all surfels lie between the same two: a mask, most likely.
    #[must_use]
    pub fn of_mask(&self) -> Option<[f64; 2]> {
        let is_one = |[least, most]: [f64; 2]| least == most;
        (is_one(self.inner) && is_one(self.outer)).then_some([self.inner[0], self.outer[0]])
    }
}

/// Weights of consecutive voxels along an axis.
#[derive(Clone, Debug)]
struct Taps {
    /// The first voxel, from the cell of the surfel.
    first: i32,
    smooth: Vec<f64>,
    slope: Vec<f64>,
}

impl Taps {
    /// Weights at `first..=last` cells from a point that lies `shift` of an edge below the centre
    /// of the cell.
    fn new(first: i32, last: i32, shift: f64, edge: f64, sigma: f64) -> Self {
        let distances: Vec<f64> = (first..=last)
            .map(|i| (f64::from(i) + shift) * edge)
            .collect();
        let gauss: Vec<f64> = distances
            .iter()
            .map(|d| libm::exp(-d * d / (2.0 * sigma * sigma)))
            .collect();
        let sum: f64 = gauss.iter().sum();
        let moment: f64 = gauss.iter().zip(&distances).map(|(g, d)| g * d * d).sum();
        Self {
            first,
            smooth: gauss.iter().map(|g| g / sum).collect(),
            slope: gauss
                .iter()
                .zip(&distances)
                .map(|(g, d)| g * d / moment)
                .collect(),
        }
    }

    fn len(&self) -> usize {
        self.smooth.len()
    }
}

/// The gradient at one sigma.
#[derive(Clone, Debug)]
pub struct GradientKernel {
    /// For each axis: weights about the centre of the cell, and about its lower face.
    taps: Box<[[Taps; 2]; 3]>,
    reach: [i32; 3],
}

/// The gradients at some surfels.
struct GradientsAt<'a> {
    kernel: &'a GradientKernel,
    values: &'a GreyBox,
    surfels: &'a Surfels,
}

impl Work for GradientsAt<'_> {
    type Output = Vec<DVec3>;

    #[inline(always)]
    fn run<L: Level>(self) -> Vec<DVec3> {
        let mut gradients = Vec::with_capacity(self.surfels.list.len());
        for i in 0..self.surfels.list.len() {
            gradients.push(self.kernel.gradient(self.values, self.surfels.oriented(i)));
        }
        gradients
    }
}

impl GradientKernel {
    /// Prepares for a sigma and voxels of the given edges, both in voxel units.
    ///
    /// # Errors
    /// [`LatticeError::Sigma`].
    pub fn new(sigma: f64, edges: [f64; 3]) -> Result<Self, LatticeError> {
        if !(MIN_SIGMA..=MAX_SIGMA).contains(&sigma) {
            return Err(LatticeError::Sigma {
                sigma,
                limits: [MIN_SIGMA, MAX_SIGMA],
            });
        }
        let mut reach = [0; 3];
        let taps = [0, 1, 2].map(|a| {
            let edge = edges[a];
            // A length such as 3 * 1.2 is meant to be exact.
            let far = TRUNCATION * sigma / edge * (1.0 + 1e-12);
            let centred = (far as i32).max(1);
            let between = ((far + 0.5) as i32).max(1);
            reach[a] = centred.max(between);
            [
                Taps::new(-centred, centred, 0.0, edge, sigma),
                Taps::new(-between, between - 1, 0.5, edge, sigma),
            ]
        });
        Ok(Self {
            taps: Box::new(taps),
            reach,
        })
    }

    pub(super) fn reach(&self) -> [i32; 3] {
        self.reach
    }

    /// The gradient of the smoothed values at a surfel's centroid.
    #[inline(always)]
    fn gradient(&self, values: &GreyBox, surfel: OrientedSurfel) -> DVec3 {
        let cell = surfel.cell();
        let own = axis(surfel.orientation);
        let taps = |a: usize| &self.taps[a][usize::from(a == own)];
        let [along_x, along_y, along_z] = [taps(0), taps(1), taps(2)];
        let x = cell[0] + along_x.first;
        let mut gradient = [0.0; 3];
        for iz in 0..along_z.len() {
            let z = cell[2] + along_z.first + iz as i32;
            // Over the plane: smoothed, and derived along x and y.
            let (mut smooth, mut by_x, mut by_y) = (0.0, 0.0, 0.0);
            for iy in 0..along_y.len() {
                let y = cell[1] + along_y.first + iy as i32;
                let row = values.row([x, y, z], along_x.len());
                let [s, d] = weighted(row, &along_x.smooth, &along_x.slope);
                smooth += along_y.smooth[iy] * s;
                by_x += along_y.smooth[iy] * d;
                by_y += along_y.slope[iy] * s;
            }
            gradient[0] += along_z.smooth[iz] * by_x;
            gradient[1] += along_z.smooth[iz] * by_y;
            gradient[2] += along_z.slope[iz] * smooth;
        }
        DVec3::from_array(gradient)
    }

    pub(super) fn estimate(
        &self,
        bits: &PlaneWindow,
        window: &GreyWindow,
        lattice: &Lattice,
        surfels: &Surfels,
    ) -> Normals {
        let mut normals = Normals::default();
        if surfels.list.is_empty() {
            return normals;
        }
        let (mut lo, mut hi) = ([i32::MAX; 3], [i32::MIN; 3]);
        for i in 0..surfels.list.len() {
            let cell = surfels.oriented(i).cell();
            for a in 0..3 {
                lo[a] = lo[a].min(cell[a] - self.reach[a]);
                hi[a] = hi[a].max(cell[a] + self.reach[a] + 1);
            }
        }
        let values = GreyBox::cut(window, lo, hi);
        let border =
            (!lattice.closed).then(|| Border::count(&BitBox::cut(bits, lo, hi), lo, hi, lattice));
        let gradients = dispatch(GradientsAt {
            kernel: self,
            values: &values,
            surfels,
        });
        for (i, gradient) in gradients.into_iter().enumerate() {
            let surfel = surfels.oriented(i);
            let (inner, outer) = (values.value(surfel.inner), values.value(surfel.outer()));
            let step = outer - inner;
            if step.abs() > 0.0 {
                normals.sides.add(inner, outer);
            }
            let n = trivial_normal(surfel.orientation);
            let u = direction(gradient, step);
            normals.degenerate.push(u.is_none());
            normals.cut.push(border.as_ref().is_some_and(|border| {
                let (lo, hi) = self.window(surfel);
                touches_border(surfel, lattice) || border.is_met(lo, hi)
            }));
            normals.u.push(u.unwrap_or(n));
        }
        normals
    }

    /// The voxels `lo <= p < hi` that have weights.
    fn window(&self, surfel: OrientedSurfel) -> ([i32; 3], [i32; 3]) {
        let (own, cell) = (axis(surfel.orientation), surfel.cell());
        let taps = |a: usize| &self.taps[a][usize::from(a == own)];
        let lo = [0, 1, 2].map(|a| cell[a] + taps(a).first);
        (lo, [0, 1, 2].map(|a| lo[a] + taps(a).len() as i32))
    }
}

/// The unit vector along a gradient if the values grow across the surfel, against it if they
/// fall; `None` if there is none.
fn direction(gradient: DVec3, step: f64) -> Option<DVec3> {
    let largest = gradient.abs().max_element();
    // Also refuses NaN, of which `max_element` may lose sight.
    let usable = gradient.is_finite() && largest > 0.0 && step.abs() > 0.0;
    // Scaled first, so that squares neither overflow nor vanish.
    usable.then(|| (gradient / largest).normalize() * step.signum())
}

/// The sums of a row with two sets of weights: four accumulators each, then what is left.
#[inline(always)]
fn weighted(row: &[f64], smooth: &[f64], slope: &[f64]) -> [f64; 2] {
    let (fours, rest) = row.as_chunks::<4>();
    let (smooth4, smooth_rest) = smooth.as_chunks::<4>();
    let (slope4, slope_rest) = slope.as_chunks::<4>();
    let (mut s, mut d) = ([0.0; 4], [0.0; 4]);
    for ((values, smooth), slope) in fours.iter().zip(smooth4).zip(slope4) {
        for lane in 0..4 {
            s[lane] += values[lane] * smooth[lane];
            d[lane] += values[lane] * slope[lane];
        }
    }
    let mut sums = [(s[0] + s[1]) + (s[2] + s[3]), (d[0] + d[1]) + (d[2] + d[3])];
    for ((value, smooth), slope) in rest.iter().zip(smooth_rest).zip(slope_rest) {
        sums[0] += value * smooth;
        sums[1] += value * slope;
    }
    sums
}
