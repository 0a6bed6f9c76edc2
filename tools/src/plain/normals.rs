//! Corrected normals u, one per surfel, pointing outwards.
//!
//! In: the solid, its surface, an estimator with its radius. Out: a unit vector per surfel and
//! whether the estimator had nothing to say there (then u is the trivial normal).

use super::algebra::{ENTRIES, Symmetric, Vector, dot, eigen, norm, normalised, scaled};
use super::solid::{LatticeBall, Scale, Solid};
use super::surface::{Surface, Surfel, minus};
use super::voronoi::{self, Ties};
use super::walk::{Walk, in_ball};

/// The estimators of u.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Estimator {
    /// u = n: the measures are those of the normal cycle.
    Trivial,
    /// Digital integral invariants: an eigenvector of the covariance of the solid in a ball
    /// around the inner and around the outer voxel.
    IntegralInvariant {
        /// Radius of the ball, world units.
        radius_world: f64,
        /// Which eigenvector, and which of its two directions.
        orientation: Orientation,
    },
    /// The Voronoi covariance measure: see [`voronoi`].
    VoronoiCovariance {
        /// Radius R that cuts the cells, world units.
        voronoi_radius_world: f64,
        /// Radius r of the hat, world units.
        radius_world: f64,
        /// To whom a point with several nearest sites belongs.
        ties: Ties,
        /// What decides the side.
        orientation: Orientation,
    },
    /// Sum of the trivial normals over the connected ball, times area and 1 - d^2/r^2.
    SurfaceAverage {
        /// Radius r of the ball, world units.
        radius_world: f64,
    },
}

/// From a covariance to a direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orientation {
    /// II: the eigenvector nearest to the first moment of the solid, pointing away from it.
    Moment,
    /// VCM: on the side of the surface average within 3 voxels, or r if that is less.
    Surface,
    /// DGtal's rules. II: the eigenvector of the smallest eigenvalue, on the side of the trivial
    /// normal. VCM: on the side of the convolution of trivial normals over a ring of 3 voxels.
    Dgtal,
}

/// The normals of all surfels.
#[derive(Clone, Debug)]
pub struct Normals {
    /// Unit vectors.
    pub u: Vec<Vector>,
    /// u is the trivial normal for want of anything better.
    pub degenerate: Vec<bool>,
}

/// The normals of all surfels of `surface`, which is the boundary of `solid`.
pub fn estimate(solid: &Solid, surface: &Surface, scale: &Scale, estimator: Estimator) -> Normals {
    match estimator {
        Estimator::Trivial => Normals {
            u: surface.surfels.iter().map(Surfel::normal).collect(),
            degenerate: vec![false; surface.len()],
        },
        Estimator::IntegralInvariant {
            radius_world,
            orientation,
        } => {
            let ball = LatticeBall::on_voxels(scale, radius_world / scale.unit_world);
            integral_invariant(solid, surface, scale, &ball, orientation)
        }
        Estimator::VoronoiCovariance {
            voronoi_radius_world,
            radius_world,
            ties,
            orientation,
        } => {
            let radii = [voronoi_radius_world, radius_world].map(|r| r / scale.unit_world);
            voronoi::estimate(surface, scale, radii, ties, orientation)
        }
        Estimator::SurfaceAverage { radius_world } => {
            let ball = LatticeBall::on_khalimsky(scale, radius_world / scale.unit_world);
            surface_average(surface, scale, &ball)
        }
    }
}

/// Sums over the voxels of the solid in a ball, x being relative to the centre, in voxels.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    count: i64,
    first: [i64; 3],
    second: [i64; 6],
}

impl Moments {
    /// The rows of the ball are runs |x| <= half-width; each row is walked voxel by voxel.
    fn of(solid: &Solid, centre: [i32; 3], rows: &[([i32; 2], i32)]) -> Self {
        let mut sums = Moments::default();
        for &([dy, dz], half) in rows {
            let (y, z) = (centre[1] + dy, centre[2] + dz);
            let from = (centre[0] - half).max(0);
            let to = (centre[0] + half).min(solid.dims[0] as i32 - 1);
            if from > to || !solid.has([from, y, z]) {
                continue;
            }
            let start = solid.index([from, y, z]);
            let (mut n, mut sx, mut sxx) = (0i64, 0i64, 0i64);
            for (i, &inside) in solid.inside[start..=start + (to - from) as usize]
                .iter()
                .enumerate()
            {
                let dx = i64::from(from - centre[0]) + i as i64;
                let one = i64::from(inside);
                n += one;
                sx += one * dx;
                sxx += one * dx * dx;
            }
            let (dy, dz) = (i64::from(dy), i64::from(dz));
            sums.count += n;
            let first = [sx, n * dy, n * dz];
            let second = [sxx, n * dy * dy, n * dz * dz, sx * dy, sx * dz, n * dy * dz];
            (0..3).for_each(|a| sums.first[a] += first[a]);
            (0..6).for_each(|e| sums.second[e] += second[e]);
        }
        sums
    }

    /// sum x x^T - (sum x)(sum x)^T / n, in the units of `scale`.
    fn covariance(&self, scale: &Scale) -> Symmetric {
        let mut c = [0.0; 6];
        if self.count > 0 {
            for (e, (a, b)) in ENTRIES.into_iter().enumerate() {
                // The difference is taken in integers: it loses nothing.
                let times_n = self.count * self.second[e] - self.first[a] * self.first[b];
                c[e] = times_n as f64 / self.count as f64 * scale.edges[a] * scale.edges[b];
            }
        }
        c
    }
}

fn integral_invariant(
    solid: &Solid,
    surface: &Surface,
    scale: &Scale,
    ball: &LatticeBall,
    orientation: Orientation,
) -> Normals {
    let rows = ball_rows(ball);
    // Many surfels share a voxel: each is evaluated once.
    let mut voxels: Vec<[i32; 3]> = surface
        .surfels
        .iter()
        .flat_map(|s| [s.inner(), s.outer()])
        .collect();
    voxels.sort_unstable();
    voxels.dedup();
    let moments: Vec<Moments> = voxels
        .iter()
        .map(|&v| Moments::of(solid, v, &rows))
        .collect();
    let moments_at = |voxel: [i32; 3]| {
        &moments[voxels
            .binary_search(&voxel)
            .expect("every voxel beside a surfel was evaluated")]
    };

    let mut normals = Normals {
        u: Vec::new(),
        degenerate: Vec::new(),
    };
    for surfel in &surface.surfels {
        let (inner, outer) = (moments_at(surfel.inner()), moments_at(surfel.outer()));
        let (a, b) = (inner.covariance(scale), outer.covariance(scale));
        let mut covariance = [0.0; 6];
        (0..6).for_each(|e| covariance[e] = 0.5 * (a[e] + b[e]));
        let (_, eigenvectors) = eigen(covariance);
        let n = surfel.normal();
        let u = match orientation {
            // A lone voxel in a small ball spreads nowhere.
            Orientation::Dgtal if covariance == [0.0; 6] => None,
            Orientation::Dgtal => {
                let e = eigenvectors[0];
                Some(if dot(e, n) < 0.0 { scaled(e, -1.0) } else { e })
            }
            Orientation::Moment | Orientation::Surface => {
                let mut m = [0.0; 3];
                for a in 0..3 {
                    m[a] = 0.5 * (inner.first[a] + outer.first[a]) as f64 * scale.edges[a];
                }
                away_from(m, eigenvectors)
            }
        };
        normals.u.push(u.unwrap_or(n));
        normals.degenerate.push(u.is_none());
    }
    normals
}

/// The eigenvector nearest to `m`, pointing away from it.
fn away_from(m: Vector, eigenvectors: [Vector; 3]) -> Option<Vector> {
    if m == [0.0; 3] {
        return None;
    }
    let mut nearest = eigenvectors[0];
    for e in eigenvectors {
        if dot(e, m).abs() > dot(nearest, m).abs() {
            nearest = e;
        }
    }
    Some(if dot(nearest, m) > 0.0 {
        scaled(nearest, -1.0)
    } else {
        nearest
    })
}

/// The ball as rows along x: (dy, dz) and the half-width.
fn ball_rows(ball: &LatticeBall) -> Vec<([i32; 2], i32)> {
    let mut rows = Vec::new();
    let z_max = ball.half_width(2, 0).unwrap_or(0);
    let y_max = ball.half_width(1, 0).unwrap_or(0);
    for z in -z_max..=z_max {
        for y in -y_max..=y_max {
            if let Some(half) = ball.half_width(0, ball.square([0, y, z])) {
                rows.push(([y, z], half));
            }
        }
    }
    rows
}

/// With D the weighted square of the distance in Khalimsky coordinates and R that of the radius,
/// 1 - d^2/r^2 = (R - D) / R. So two integer sums per axis give the sum over the ball.
pub(super) fn surface_average(surface: &Surface, scale: &Scale, ball: &LatticeBall) -> Normals {
    let mut normals = Normals {
        u: Vec::new(),
        degenerate: Vec::new(),
    };
    let mut walk = Walk::new(surface);
    for p in 0..surface.len() as u32 {
        walk.connected(p, |g| in_ball(surface, ball, p, g));
        let centre = surface.surfels[p as usize];
        let mut signs = [0i64; 3];
        let mut signed_squares = [0i64; 3];
        for &q in &walk.members {
            let q = surface.surfels[q as usize];
            signs[q.axis] += i64::from(q.sign);
            signed_squares[q.axis] += i64::from(q.sign) * ball.square(minus(q.k, centre.k));
        }
        let mut sum = [0.0; 3];
        for axis in 0..3 {
            let weighted = ball.squared_radius * signs[axis] as f64 - signed_squares[axis] as f64;
            sum[axis] = weighted / ball.squared_radius * scale.area(axis);
        }
        // A closed surface inside the ball has sum n = 0: what remains says nothing.
        let island = !walk.meets_border && !walk.meets_rim;
        let degenerate = island || norm(sum) <= 1e-12 * walk.members.len() as f64;
        normals.u.push(if degenerate {
            centre.normal()
        } else {
            normalised(sum)
        });
        normals.degenerate.push(degenerate);
    }
    normals
}
