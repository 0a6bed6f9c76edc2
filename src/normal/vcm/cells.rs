//! Covariance matrices of the Voronoi cells of the sites.
//!
//! Which sites are nearest to a point p follows from squared distances D at p and its six
//! neighbours, without a map of sites: a nearest site p + v is no nearer than D(p + e) to the
//! neighbour p + e, so along each axis of squared edge w
//!
//! ```text
//!    D(p + e) <= |v - e|^2 = D(p) - 2 w v + w     and     D(p - e) <= D(p) + 2 w v + w
//! ```
//!
//! and v lies in an interval, a single number nearly everywhere. Where it is not, p may have several
//! nearest sites: the candidates of norm D that are sites. Each has an equal share of p, or the last
//! of them has all of it ([`Ties`]).

use crate::lattice::Ball;
use crate::surfel::CellBox;

use super::distance::{Slacks, Word};
use super::sites::Sites;

/// Sums over a cell of (p - q)(p - q)^T in voxels: xx, yy, zz, xy, xz, yz; see [`shift`].
pub(super) type Covariance = [i64; 6];

/// Binary places of the sums, so that they fit: a share 1/n of a point is rounded once, to 2^-shift.
/// It depends on the radius and the shape of the voxels alone, never on the volume.
pub(super) fn shift(ball: &Ball) -> u32 {
    let wide = ball.reach().map(|r| f64::from(2 * r + 1));
    let longest = wide.iter().fold(1.0f64, |most, &w| most.max(w));
    // a cell has fewer points than the box, each with terms below (longest / 2)^2
    let bound = wide[0] * wide[1] * wide[2] * (0.25 * longest * longest);
    (62 - bound.log2().ceil() as i32).clamp(0, 44) as u32
}

/// Whose a point with several nearest sites is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ties {
    /// Equally of all.
    Shared,
    /// Of the last in the order of z, y, x.
    Last,
}

/// The cells of the sites `wanted`, whose points are looked for in `points`; `sites` are all that
/// may be nearest.
pub(super) struct Cells<'a> {
    pub(super) sites: &'a Sites,
    pub(super) wanted: &'a Sites,
    pub(super) points: CellBox,
    pub(super) ball: &'a Ball,
    pub(super) ties: Ties,
}

impl Cells<'_> {
    /// The sums over each wanted site's cell, by its number.
    #[inline(always)]
    pub(super) fn covariances<T: Word>(&self) -> Vec<Covariance> {
        let mut sums = vec![[0; 6]; self.wanted.len()];
        // One more on each side, for the neighbours.
        let around = CellBox {
            lo: self.points.lo.map(|x| x - 1),
            hi: self.points.hi.map(|x| x + 1),
        };
        let slacks = Slacks::<T>::new(self.sites, around, self.ball);
        let width = around.size()[0] as usize;
        let full = self.ball.limit + 1;
        let one = 1i64 << shift(self.ball);
        let mut nearest = Vec::new();
        // The rows at y - 1, y and y + 1.
        let mut rows: [Vec<T>; 3] = Default::default();
        slacks.at_y(around.lo[1], &mut rows[1]);
        slacks.at_y(self.points.lo[1], &mut rows[2]);
        for y in self.points.lo[1]..self.points.hi[1] {
            rows.rotate_left(1);
            slacks.at_y(y + 1, &mut rows[2]);
            for z in self.points.lo[2]..self.points.hi[2] {
                let at = (z - around.lo[2]) as usize * width;
                let here = &rows[1][at..at + width];
                let across = [
                    &rows[0][at..at + width],
                    &rows[2][at..at + width],
                    &rows[1][at - width..at],
                    &rows[1][at + width..at + 2 * width],
                ];
                for i in 1..width - 1 {
                    let slack = here[i].get();
                    // beyond the radius of all sites, or a site itself
                    if slack == 0 || slack == full {
                        continue;
                    }
                    let p = [around.lo[0] + i as i32, y, z];
                    let x = self.interval(0, slack, here[i - 1], here[i + 1]);
                    if self.misses(0, p[0], x) {
                        continue;
                    }
                    let y = self.interval(1, slack, across[0][i], across[1][i]);
                    let z = self.interval(2, slack, across[2][i], across[3][i]);
                    if self.misses(1, p[1], y) || self.misses(2, p[2], z) {
                        continue;
                    }
                    if x[0] == x[1] && y[0] == y[1] && z[0] == z[1] {
                        self.add(&mut sums, p, [x[0], y[0], z[0]], one);
                        continue;
                    }
                    self.candidates(p, full - slack, [x, y, z], &mut nearest);
                    if self.ties == Ties::Last {
                        if let Some(&last) = nearest.iter().max_by_key(|v| [v[2], v[1], v[0]]) {
                            self.add(&mut sums, p, last, one);
                        }
                        continue;
                    }
                    let count = nearest.len() as i64;
                    for &v in &nearest {
                        self.add(&mut sums, p, v, (one + count / 2) / count);
                    }
                }
            }
        }
        sums
    }

    /// Where v of a nearest site lies along an axis, given the slacks at p and at its neighbours.
    #[inline(always)]
    fn interval<T: Word>(&self, axis: usize, slack: i64, below: T, above: T) -> [i64; 2] {
        let w = self.ball.metric.weights[axis];
        let (least, most) = (slack - below.get() - w, above.get() - slack + w);
        if w == 1 {
            [(least + 1) >> 1, most >> 1]
        } else {
            let edges = 2 * w;
            [
                (least + edges - 1).div_euclid(edges),
                most.div_euclid(edges),
            ]
        }
    }

    /// Whether no site of the interval is wanted.
    #[inline(always)]
    fn misses(&self, axis: usize, p: i32, [least, most]: [i64; 2]) -> bool {
        let p = i64::from(p);
        p + most < i64::from(self.wanted.extent.lo[axis])
            || p + least >= i64::from(self.wanted.extent.hi[axis])
    }

    /// The v of norm `squared` such that p + v is a site, for v in a box.
    fn candidates(
        &self,
        p: [i32; 3],
        squared: i64,
        bounds: [[i64; 2]; 3],
        nearest: &mut Vec<[i64; 3]>,
    ) {
        nearest.clear();
        let widths = bounds.map(|[least, most]| most - least);
        // The longest axis is solved for, the others tried.
        let c = (0..3).fold(0, |c, a| if widths[a] > widths[c] { a } else { c });
        let (a, b) = ((c + 1) % 3, (c + 2) % 3);
        let w = self.ball.metric.weights;
        for va in bounds[a][0]..=bounds[a][1] {
            for vb in bounds[b][0]..=bounds[b][1] {
                let rest = squared - w[a] * va * va - w[b] * vb * vb;
                if rest < 0 || rest % w[c] != 0 {
                    continue;
                }
                let root = (rest / w[c]).isqrt();
                if w[c] * root * root != rest {
                    continue;
                }
                let roots = [-root, root];
                for &vc in &roots[usize::from(root == 0)..] {
                    if !(bounds[c][0]..=bounds[c][1]).contains(&vc) {
                        continue;
                    }
                    let mut v = [0; 3];
                    (v[a], v[b], v[c]) = (va, vb, vc);
                    let site = [0, 1, 2].map(|i| p[i] + v[i] as i32);
                    if self.sites.extent.contains(site) && self.sites.contains(site) {
                        nearest.push(v);
                    }
                }
            }
        }
        debug_assert!(!nearest.is_empty(), "a finite distance is that of a site");
    }

    /// Adds a share of p to the site p + v, if it is wanted.
    #[inline(always)]
    fn add(&self, sums: &mut [Covariance], p: [i32; 3], v: [i64; 3], share: i64) {
        let site = [0, 1, 2].map(|i| p[i] + v[i] as i32);
        if !self.wanted.extent.contains(site) {
            return;
        }
        let sum = &mut sums[self.wanted.number(site)];
        let [x, y, z] = v;
        for (sum, term) in sum
            .iter_mut()
            .zip([x * x, y * y, z * z, x * y, x * z, y * z])
        {
            *sum += share * term;
        }
    }
}
