//! Exact squared distances to the nearest site, as far as they matter.
//!
//! Kept is not the squared distance D but its *slack* `limit + 1 - D`, or 0 where D exceeds the
//! limit: then adding a squared displacement is a saturating subtraction, the nearest site is the
//! largest slack, and nothing overflows. One axis after the other (the distance is separable),
//!
//! ```text
//!    x: from the bits    y: max over d of (slack(y + d) - w_y d^2)    z: likewise
//! ```
//!
//! with `|d|` up to the radius. That is more arithmetic than lower envelopes of parabolas, but
//! a row of 16 points a time and without a branch; rows that cannot contribute are left out.

use crate::lattice::Ball;
use crate::surfel::CellBox;

use super::sites::Sites;

/// An unsigned integer that holds slacks.
pub(super) trait Word: Copy + Ord + Default {
    /// The number, which fits.
    fn of(x: i64) -> Self;

    /// As a number.
    fn get(self) -> i64;

    /// The difference, or zero.
    fn less(self, by: Self) -> Self;
}

macro_rules! word {
    ($word:ty) => {
        impl Word for $word {
            #[inline(always)]
            fn of(x: i64) -> Self {
                x as $word
            }

            #[inline(always)]
            fn get(self) -> i64 {
                self as i64
            }

            #[inline(always)]
            fn less(self, by: Self) -> Self {
                self.saturating_sub(by)
            }
        }
    };
}
word!(u16);
word!(u32);

/// Slacks along x and y, before the last axis.
pub(super) struct Slacks<T> {
    /// The points asked for.
    points: CellBox,
    /// Planes of sites.
    z0: i32,
    depth: usize,
    /// Squared displacements along z, from the radius below to the radius above.
    steps_z: Vec<T>,
    /// Rows along x, for each y of the points, for each plane of sites.
    rows: Vec<T>,
    /// The largest slack of each row.
    most: Vec<T>,
}

/// Squared displacements along an axis, for |d| up to the radius.
fn steps<T: Word>(ball: &Ball, axis: usize) -> Vec<T> {
    let radius = i64::from(ball.half_width(axis, 0).unwrap_or(0));
    let weight = ball.metric.weights[axis];
    (-radius..=radius).map(|d| T::of(weight * d * d)).collect()
}

/// Raises `out` to `from - step`; gives nothing where `from` is not above the step.
#[inline(always)]
fn raise<T: Word>(out: &mut [T], from: &[T], step: T) {
    for (out, &from) in out.iter_mut().zip(from) {
        *out = (*out).max(from.less(step));
    }
}

#[inline(always)]
fn largest<T: Word>(row: &[T]) -> T {
    row.iter().fold(T::default(), |most, &x| most.max(x))
}

impl<T: Word> Slacks<T> {
    /// Squared distances up to the limit of `ball` from `points` to the sites.
    #[inline(always)]
    pub(super) fn new(sites: &Sites, points: CellBox, ball: &Ball) -> Self {
        let [width, height, _] = points.size().map(|n| n as usize);
        let extent = sites.extent;
        let [_, site_rows, depth] = extent.size().map(|n| n as usize);
        let (steps_x, steps_y) = (steps::<T>(ball, 0), steps::<T>(ball, 1));
        let full = T::of(ball.limit + 1);
        let bump: Vec<T> = steps_x.iter().map(|&step| full.less(step)).collect();
        let reach = [steps_x.len() as i32 / 2, steps_y.len() as i32 / 2];
        let mut slacks = Self {
            points,
            z0: extent.lo[2],
            depth,
            steps_z: steps(ball, 2),
            rows: vec![T::default(); width * height * depth],
            most: vec![T::default(); height * depth],
        };
        let mut plane = vec![T::default(); width * site_rows];
        let mut plane_most = vec![T::default(); site_rows];
        for plane_z in 0..depth {
            let z = extent.lo[2] + plane_z as i32;
            for (row, (out, most)) in plane
                .chunks_exact_mut(width)
                .zip(&mut plane_most)
                .enumerate()
            {
                if *most > T::default() {
                    out.fill(T::default());
                }
                let y = extent.lo[1] + row as i32;
                along_x(sites, y, z, points, &bump, reach[0], out);
                *most = largest(out);
            }
            for row in 0..height {
                let y = points.lo[1] + row as i32;
                let at = row * depth + plane_z;
                let out = &mut slacks.rows[at * width..][..width];
                let from = (y - reach[1]).max(extent.lo[1]);
                let to = (y + reach[1]).min(extent.hi[1] - 1);
                for other in from..=to {
                    let source = (other - extent.lo[1]) as usize;
                    let step = steps_y[(other - y + reach[1]) as usize];
                    if plane_most[source] > step {
                        raise(out, &plane[source * width..][..width], step);
                    }
                }
                slacks.most[at] = largest(out);
            }
        }
        slacks
    }

    /// The slacks of the points at `y`, rows along x for each z, into `out`.
    #[inline(always)]
    pub(super) fn at_y(&self, y: i32, out: &mut Vec<T>) {
        let [width, _, planes] = self.points.size().map(|n| n as usize);
        out.clear();
        out.resize(width * planes, T::default());
        let reach = self.steps_z.len() as i32 / 2;
        let first = (y - self.points.lo[1]) as usize * self.depth;
        for (plane, out) in out.chunks_exact_mut(width).enumerate() {
            let z = self.points.lo[2] + plane as i32;
            let from = (z - reach).max(self.z0);
            let to = (z + reach).min(self.z0 + self.depth as i32 - 1);
            for other in from..=to {
                let at = first + (other - self.z0) as usize;
                let step = self.steps_z[(other - z + reach) as usize];
                if self.most[at] > step {
                    raise(out, &self.rows[at * width..][..width], step);
                }
            }
        }
    }
}

/// Slacks of a row, from the sites of that row alone; `out` is zero.
#[inline(always)]
fn along_x<T: Word>(
    sites: &Sites,
    y: i32,
    z: i32,
    points: CellBox,
    bump: &[T],
    reach: i32,
    out: &mut [T],
) {
    let (lo, hi) = (points.lo[0], points.hi[0]);
    let extent = sites.extent;
    // Each site has the points nearer to it than to its neighbours in the row.
    let mut fill = |site: i32, from: i32, to: i32| {
        let from = from.max(site - reach).max(lo);
        let to = to.min(site + reach + 1).min(hi);
        if from < to {
            let source = &bump[(from - site + reach) as usize..(to - site + reach) as usize];
            out[(from - lo) as usize..(to - lo) as usize].copy_from_slice(source);
        }
    };
    let mut last: Option<i32> = None;
    let mut from = i32::MIN;
    sites.for_each_in_row([extent.lo[0], extent.hi[0] - 1], y, z, |site, _| {
        if let Some(before) = last {
            let middle = (before + site + 1).div_euclid(2);
            fill(before, from, middle);
            from = middle;
        }
        last = Some(site);
    });
    if let Some(before) = last {
        fill(before, from, i32::MAX);
    }
}
