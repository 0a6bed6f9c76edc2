//! Normals by the Voronoi covariance measure, by its definition.
//!
//! In: a surface, the radii R and r. Out: a unit vector per surfel. Each point of the lattice of pointels
//! is given to the nearest pointel of the surface, if that is within R: every site is tried at
//! every point around it. The covariance of what a site received, summed around each pointel with a hat
//! of radius r, has its longest direction along the normal; a surfel adds those of its four pointels.

use super::algebra::{ENTRIES, Symmetric, Vector, dot, eigen, norm, normalised, scaled};
use super::normals::{Normals, Orientation, surface_average};
use super::solid::{LatticeBall, Scale};
use super::surface::{Surface, minus};
use super::walk::{Walk, ball_reach};

/// To whom a point belongs that has several nearest sites.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ties {
    /// To all in equal parts.
    Shared,
    /// To the last in the order of z, y, x, as in DGtal's separable passes.
    Last,
}

/// Eigenvalues this close, relative to the largest, are one.
const SAME_EIGENVALUE: f64 = 1e-7;

/// Shorter projections have no direction.
const NOTHING: f64 = 1e-9;

/// Radius of what decides the side, in units of the longest edge.
const SIDE_RADIUS: f64 = 3.0;

/// The points around the sites, by their place.
struct Points {
    lo: [i32; 3],
    size: [usize; 3],
}

impl Points {
    fn around(sites: &[[i32; 3]], reach: [i32; 3]) -> Self {
        let extreme = |a: usize, pick: fn(i32, i32) -> i32| {
            let along = sites.iter().map(|site| site[a]);
            along.reduce(pick).unwrap_or(0)
        };
        let lo = [0, 1, 2].map(|a| extreme(a, i32::min) - reach[a]);
        let size = [0, 1, 2].map(|a| (extreme(a, i32::max) + reach[a] + 1 - lo[a]) as usize);
        Points { lo, size }
    }

    fn at(&self, p: [i32; 3]) -> usize {
        let [x, y, z] = [0, 1, 2].map(|a| (p[a] - self.lo[a]) as usize);
        (z * self.size[1] + y) * self.size[0] + x
    }
}

/// Calls `visit` with each displacement in a ball.
fn for_each_in(ball: &LatticeBall, mut visit: impl FnMut([i32; 3], i64)) {
    let [rx, ry, rz] = ball_reach(ball);
    for z in -rz..=rz {
        for y in -ry..=ry {
            for x in -rx..=rx {
                let d = [x, y, z];
                if ball.has(d) {
                    visit(d, ball.square(d));
                }
            }
        }
    }
}

fn plus(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [0, 1, 2].map(|i| a[i] + b[i])
}

/// The normals of all surfels; `radii` are R and r.
pub fn estimate(
    surface: &Surface,
    scale: &Scale,
    radii: [f64; 2],
    ties: Ties,
    orientation: Orientation,
) -> Normals {
    let pointels = |f: usize| {
        let surfel = surface.surfels[f];
        [0, 1, 2, 3].map(|corner| surfel.pointel(corner).map(|k| k.div_euclid(2)))
    };
    let mut sites: Vec<[i32; 3]> = (0..surface.len()).flat_map(pointels).collect();
    sites.sort_unstable_by_key(|&[x, y, z]| [z, y, x]);
    sites.dedup();
    let [offset, hat] = radii.map(|r| LatticeBall::on_voxels(scale, r));
    let covariances = covariances(&sites, scale, &offset, ties);

    let around = Points::around(&sites, ball_reach(&hat));
    let mut number = vec![None; around.size.iter().product()];
    for (i, &site) in sites.iter().enumerate() {
        number[around.at(site)] = Some(i);
    }
    let mut summed = vec![[0.0; 6]; sites.len()];
    for_each_in(&hat, |d, squared| {
        let weight = 1.0 - (squared as f64 / hat.squared_radius).sqrt();
        for (&site, sum) in sites.iter().zip(&mut summed) {
            if let Some(other) = number[around.at(plus(site, d))] {
                (0..6).for_each(|e| sum[e] += weight * covariances[other][e]);
            }
        }
    });

    let sides = match orientation {
        Orientation::Dgtal => ring(surface, scale),
        Orientation::Moment | Orientation::Surface => {
            let ball = LatticeBall::on_khalimsky(scale, radii[1].min(SIDE_RADIUS));
            surface_average(surface, scale, &ball).u
        }
    };
    let mut normals = Normals {
        u: Vec::new(),
        degenerate: Vec::new(),
    };
    for f in 0..surface.len() {
        let n = surface.surfels[f].normal();
        let mut sum = [0.0; 3];
        for pointel in pointels(f) {
            let Some(i) = number[around.at(pointel)] else {
                continue;
            };
            if summed[i] == [0.0; 6] {
                continue;
            }
            let e = direction(summed[i], sides[f], n, orientation);
            (0..3).for_each(|a| sum[a] += e[a]);
        }
        let degenerate = norm(sum) <= NOTHING;
        normals.u.push(if degenerate { n } else { normalised(sum) });
        normals.degenerate.push(degenerate);
    }
    normals
}

/// The covariance of each site's cell.
fn covariances(
    sites: &[[i32; 3]],
    scale: &Scale,
    ball: &LatticeBall,
    ties: Ties,
) -> Vec<Symmetric> {
    let points = Points::around(sites, ball_reach(ball));
    // The nearest distance, how many sites have it, the last of them.
    let mut nearest = vec![(i64::MAX, 0u32, 0usize); points.size.iter().product()];
    for (i, &site) in sites.iter().enumerate() {
        for_each_in(ball, |d, squared| {
            let best = &mut nearest[points.at(plus(site, d))];
            if squared < best.0 {
                *best = (squared, 1, i);
            } else if squared == best.0 {
                *best = (squared, best.1 + 1, i);
            }
        });
    }
    let mut sums = vec![[0.0; 6]; sites.len()];
    for (i, &site) in sites.iter().enumerate() {
        for_each_in(ball, |d, squared| {
            let (least, count, last) = nearest[points.at(plus(site, d))];
            let share = match ties {
                _ if squared > least => 0.0,
                Ties::Shared => 1.0 / f64::from(count),
                Ties::Last => f64::from(u8::from(last == i)),
            };
            for (e, (a, b)) in ENTRIES.into_iter().enumerate() {
                let term = f64::from(d[a] * d[b]) * scale.edges[a] * scale.edges[b];
                sums[i][e] += share * term;
            }
        });
    }
    sums
}

/// The longest direction of a covariance, on one side.
fn direction(matrix: Symmetric, side: Vector, n: Vector, orientation: Orientation) -> Vector {
    let (values, vectors) = eigen(matrix);
    if orientation == Orientation::Dgtal {
        let e = vectors[2];
        return if dot(e, side) < 0.0 {
            scaled(e, -1.0)
        } else {
            e
        };
    }
    let same = |i: usize, j: usize| values[j] - values[i] <= SAME_EIGENVALUE * values[2];
    let first = match (same(0, 1), same(1, 2)) {
        (_, false) => 2,
        (false, true) => 1,
        (true, true) => 0,
    };
    for v in [side, n] {
        let mut projection = [0.0; 3];
        for e in &vectors[first..] {
            let along = dot(*e, v);
            (0..3).for_each(|a| projection[a] += along * e[a]);
        }
        if norm(projection) > NOTHING {
            return normalised(projection);
        }
    }
    [0.0; 3]
}

/// DGtal's convolved trivial normals: weights of 2/3 at the surfel that grow to 1 at the rim.
fn ring(surface: &Surface, scale: &Scale) -> Vec<Vector> {
    let ball = LatticeBall::on_khalimsky(scale, SIDE_RADIUS);
    let mut walk = Walk::new(surface);
    let mut sums = Vec::with_capacity(surface.len());
    for p in 0..surface.len() as u32 {
        let centre = surface.surfels[p as usize].k;
        let squared = |g: u32| ball.square(minus(surface.surfels[g as usize].k, centre)) as f64;
        walk.connected(p, |g| squared(g) < ball.squared_radius);
        let mut sum = [0.0; 3];
        for &g in &walk.members {
            let distance = SIDE_RADIUS * (squared(g) / ball.squared_radius).sqrt();
            let surfel = surface.surfels[g as usize];
            sum[surfel.axis] += f64::from(surfel.sign) * (2.0 / 3.0 + distance / 9.0);
        }
        sums.push(sum);
    }
    sums
}
