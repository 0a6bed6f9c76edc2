//! Sums of the measures over the ball around a surfel.

use super::cells::{Cells, MU2_UNIT, UNIT, nearest_quotient};
use super::solid::{LatticeBall, Scale, snapped};
use super::surface::{OPEN, Surface, minus};
use super::walk::{Walk, ball_reach, in_ball};

/// Which cells of the ball count, and how much.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weights {
    /// A linel counts if both its surfels do, a pointel if its whole umbrella does.
    Sharp,
    /// A surfel carries half of its linels and an equal share of its umbrellas.
    Lumped,
    /// DGtal's inclusion ratios, by the distances of the points of a cell.
    Dgtal,
    /// Lumped, times (1 - t)(1 - 2t) with t the squared distance over that of the support, in
    /// radii; where the surface is noise, or both differ by no more than the staircase makes them, times
    /// 1 - t, with a support of 1.2 radii. Weights are computed in single precision and rounded to multiples
    /// of 2^-15, measures to 2^-26.
    Compensated {
        /// 1.4 radii and a small contrast, instead of 1.6 and a larger one.
        refined: bool,
    },
}

impl Weights {
    /// Radius of the surfels that take part, in radii.
    fn support(self) -> f64 {
        match self {
            Weights::Compensated { .. } => 1.6,
            _ => 1.0,
        }
    }
}

/// Which surfels of the ball count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BallKind {
    /// Those connected to the centre inside the ball.
    Connected,
    /// All: the paper's Borel set.
    Whole,
}

/// Sums in the units of `Scale`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sums {
    /// Corrected area.
    pub mu0: f64,
    /// Symmetric tensor, xx yy zz xy xz yz.
    pub tensor: [f64; 6],
    /// Corrected Gaussian curvature integral.
    pub mu2: f64,
    /// mu_Omega.
    pub omega: f64,
}

impl Sums {
    /// *Twice* the integral of the mean curvature.
    pub fn mu1(&self) -> f64 {
        self.tensor[0] + self.tensor[1] + self.tensor[2]
    }
}

/// The same sums, exact: integers times `UNIT`, for mu2 `MU2_UNIT`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FixedSums {
    /// Corrected area.
    pub mu0: i64,
    /// Symmetric tensor, xx yy zz xy xz yz.
    pub tensor: [i64; 6],
    /// Corrected Gaussian curvature integral.
    pub mu2: i64,
    /// mu_Omega.
    pub omega: i64,
}

impl Sums {
    /// With all terms rounded as compensated sums have them: mu2 is counted in quarter turns.
    fn rounded(self) -> Self {
        let round = |x: f64, one: f64| {
            let unit = one / f64::from(1 << 26);
            (x / unit).round_ties_even() * unit
        };
        Sums {
            mu0: round(self.mu0, 1.0),
            tensor: self.tensor.map(|x| round(x, 1.0)),
            mu2: round(self.mu2, std::f64::consts::FRAC_PI_2),
            omega: round(self.omega, 1.0),
        }
    }
}

impl From<FixedSums> for Sums {
    fn from(fixed: FixedSums) -> Self {
        // mu1 is the trace of the rounded tensor: i64 sums up to 2^53 are exact in f64.
        Sums {
            mu0: fixed.mu0 as f64 * UNIT,
            tensor: fixed.tensor.map(|m| m as f64 * UNIT),
            mu2: fixed.mu2 as f64 * MU2_UNIT,
            omega: fixed.omega as f64 * UNIT,
        }
    }
}

/// The ball of a run and its rule of belonging.
#[derive(Clone, Copy, Debug)]
pub struct Ball {
    lattice: LatticeBall,
    /// Radius in the units of `Scale`, its square snapped to integers meant.
    radius: f64,
    scale: Scale,
    weights: Weights,
    reach: [i32; 3],
}

impl Ball {
    /// The ball of `radius`, in the units of `scale`.
    pub fn new(scale: &Scale, radius: f64, weights: Weights) -> Self {
        let lattice = LatticeBall::on_khalimsky(scale, radius * weights.support());
        // DGtal counts a surfel if one of its points is in the ball: up to one more voxel.
        let more = if weights == Weights::Dgtal { 2 } else { 0 };
        Ball {
            lattice,
            radius: 0.5 * snapped(4.0 * radius * radius).sqrt(),
            scale: *scale,
            weights,
            reach: ball_reach(&lattice).map(|reach| reach + more),
        }
    }

    /// Bound of the members' distance from the centre along each axis, in Khalimsky coordinates.
    pub fn reach(&self) -> [i32; 3] {
        self.reach
    }

    /// Is surfel `g` in the ball around surfel `centre`?
    pub fn has(&self, surface: &Surface, centre: u32, g: u32) -> bool {
        match self.weights {
            Weights::Sharp | Weights::Lumped | Weights::Compensated { .. } => {
                in_ball(surface, &self.lattice, centre, g)
            }
            Weights::Dgtal => self.surfel_share(surface, centre, g) > 0.0,
        }
    }

    /// The sums over the members of `walk`, found around `centre`; the second, exact form
    /// exists for weights that are not fractions.
    pub fn sum(
        &self,
        surface: &Surface,
        cells: &Cells,
        walk: &Walk,
        centre: u32,
    ) -> (Sums, Option<FixedSums>) {
        if let Weights::Compensated { refined } = self.weights {
            return (
                self.compensated(surface, cells, walk, centre, refined),
                None,
            );
        }
        if let Some(of_surfels) = &cells.of_surfels {
            return self.sum_of_surfels(surface, of_surfels, walk, centre);
        }
        let fixed = match self.weights {
            Weights::Sharp => sharp(surface, cells, walk),
            Weights::Lumped => lumped(surface, cells, walk),
            Weights::Dgtal => return (self.shares(surface, cells, walk, centre), None),
            Weights::Compensated { .. } => unreachable!("summed above"),
        };
        (fixed.into(), Some(fixed))
    }

    /// The sums where all measures lie on surfels: a member counts wholly, or by DGtal's share.
    fn sum_of_surfels(
        &self,
        surface: &Surface,
        of_surfels: &[FixedSums],
        walk: &Walk,
        centre: u32,
    ) -> (Sums, Option<FixedSums>) {
        let (mut sums, mut fixed) = (Sums::default(), FixedSums::default());
        for &f in &walk.members {
            let own = &of_surfels[f as usize];
            if self.weights == Weights::Dgtal {
                let share = self.surfel_share(surface, centre, f);
                let own = Sums::from(*own);
                sums.mu0 += share * own.mu0;
                (0..6).for_each(|e| sums.tensor[e] += share * own.tensor[e]);
                sums.mu2 += share * own.mu2;
                sums.omega += share * own.omega;
            } else {
                fixed.mu0 += own.mu0;
                add(&mut fixed.tensor, own.tensor);
                fixed.mu2 += own.mu2;
                fixed.omega += own.omega;
            }
        }
        if self.weights == Weights::Dgtal {
            (sums, None)
        } else {
            (fixed.into(), Some(fixed))
        }
    }

    /// Compensated sums, in the proportion of those that a plane would have with the narrower weights.
    fn compensated(
        &self,
        surface: &Surface,
        cells: &Cells,
        walk: &Walk,
        centre: u32,
        refined: bool,
    ) -> Sums {
        let (support, contrasts) = if refined {
            (1.4, [0.2, 0.6])
        } else {
            (1.6, [0.5, 1.3])
        };
        let supports = [support * self.radius, 1.2 * self.radius];
        let mut sums = [Sums::default(); 2];
        let mut ridges = 0.0;
        for &f in &walk.members {
            let own: Sums = match &cells.of_surfels {
                Some(of_surfels) => of_surfels[f as usize],
                None => lump(surface, cells, f),
            }
            .into();
            let own = own.rounded();
            let d = minus(
                surface.surfels[f as usize].k,
                surface.surfels[centre as usize].k,
            );
            let t = supports.map(|support| self.squared_in(d, support).min(1.0));
            let weights = [(1.0 - t[0]) * (1.0 - 2.0 * t[0]), 1.0 - t[1]];
            for (sums, weight) in sums.iter_mut().zip(weights) {
                let weight = f64::from((weight * 32768.0).round_ties_even()) / 32768.0;
                sums.mu0 += weight * own.mu0;
                (0..6).for_each(|e| sums.tensor[e] += weight * own.tensor[e]);
                sums.mu2 += weight * own.mu2;
                sums.omega += weight * own.omega;
            }
            let across = surface.neighbours[f as usize];
            let outward = |g: u32| surface.surfels[g as usize].normal();
            let opposite = |a: u32, b: u32| {
                a != OPEN && b != OPEN && (0..3).all(|i| outward(a)[i] == -outward(b)[i])
            };
            if opposite(across[0], across[2]) || opposite(across[1], across[3]) {
                ridges += 1.0;
            }
        }
        // 0 below, 1 above, a cubic between
        let rise = |x: f64, from: f64, to: f64| {
            let s = if x > from {
                ((x - from) / (to - from)).min(1.0)
            } else {
                0.0
            };
            s * s * (3.0 - 2.0 * s)
        };
        let of_plane = [supports[0].powi(2) / 6.0, supports[1].powi(2) / 2.0];
        let area = [0, 1].map(|i| sums[i].mu0 / of_plane[i]);
        let noisy = rise(ridges / walk.members.len() as f64, 0.07, 0.14);
        let eaten = if area[1] > 0.0 {
            1.0 - rise(area[0] / area[1], 0.4, 0.6)
        } else {
            1.0
        };
        let per_area = sums.map(|s| s.tensor.map(|t| t / s.mu0));
        let difference: f64 = (0..6)
            .map(|e| (per_area[0][e] - per_area[1][e]).powi(2) * if e < 3 { 1.0 } else { 2.0 })
            .sum();
        let contrast = difference.sqrt() * self.radius.powi(3);
        let robust = noisy
            .max(eaten)
            .max(1.0 - rise(contrast, contrasts[0], contrasts[1]));
        let parts = [1.0 - robust, robust * of_plane[0] / of_plane[1]];
        let mix = |a: f64, b: f64| parts[0] * a + parts[1] * b;
        Sums {
            mu0: mix(sums[0].mu0, sums[1].mu0),
            tensor: std::array::from_fn(|e| mix(sums[0].tensor[e], sums[1].tensor[e])),
            mu2: mix(sums[0].mu2, sums[1].mu2),
            omega: mix(sums[0].omega, sums[1].omega),
        }
    }

    /// The squared length of a displacement over that of `support`, in single precision.
    fn squared_in(&self, d: [i32; 3], support: f64) -> f32 {
        let square = self.lattice.square(d) as f64;
        if self.scale.is_cubic() {
            square as f32 * (1.0 / (4.0 * support * support)) as f32
        } else {
            const UNIT: f64 = (1u64 << 20) as f64;
            (square * (1.0 / (4.0 * UNIT * support * support))) as f32
        }
    }

    /// DGtal's sums. An edge or vertex of a counted face counts once, by its own share.
    fn shares(&self, surface: &Surface, cells: &Cells, walk: &Walk, centre: u32) -> Sums {
        let mut sums = Sums::default();
        for &f in &walk.members {
            let surfel = &surface.surfels[f as usize];
            let share = self.surfel_share(surface, centre, f);
            sums.mu0 += share * (cells.mu0[f as usize] as f64 * UNIT);
            for side in 0..4 {
                let g = surface.neighbours[f as usize][side];
                if g == OPEN || g < f && walk.has(g) {
                    continue;
                }
                let along = surfel.steps()[(side + 1) % 4];
                let middle = surfel.linel(side);
                let from_middle = |sign: i32| [0, 1, 2].map(|a| middle[a] + sign * along[a]);
                let share = self.share(surface, centre, &[middle, from_middle(-1), from_middle(1)]);
                let sheet = surface.sheets_of[f as usize][side] as usize;
                let tensor = cells.tensor[sheet];
                (0..6).for_each(|e| sums.tensor[e] += share * (tensor[e] as f64 * UNIT));
                sums.omega += share * (cells.omega[sheet] as f64 * UNIT);
            }
            for corner in 0..4 {
                let umbrella = surface.umbrellas_of[f as usize][corner];
                let is_first = surface
                    .umbrella(umbrella)
                    .iter()
                    .all(|&g| g >= f || !walk.has(g));
                if is_first && self.distance(surface, centre, surfel.pointel(corner)) <= self.radius
                {
                    sums.mu2 += cells.mu2[umbrella as usize] as f64 * MU2_UNIT;
                }
            }
        }
        sums
    }

    fn surfel_share(&self, surface: &Surface, centre: u32, g: u32) -> f64 {
        let g = &surface.surfels[g as usize];
        self.share(
            surface,
            centre,
            &[g.k, g.pointel(0), g.pointel(1), g.pointel(2), g.pointel(3)],
        )
    }

    /// DGtal's inclusion ratio of a cell given some of its points.
    fn share(&self, surface: &Surface, centre: u32, points: &[[i32; 3]]) -> f64 {
        let mut nearest = f64::INFINITY;
        let mut farthest = 0.0f64;
        for &point in points {
            let d = self.distance(surface, centre, point);
            nearest = nearest.min(d);
            farthest = farthest.max(d);
        }
        if farthest <= self.radius {
            1.0
        } else if self.radius <= nearest {
            0.0
        } else {
            (self.radius - nearest) / (farthest - nearest)
        }
    }

    /// Distance of a Khalimsky point from the centroid of surfel `centre`.
    fn distance(&self, surface: &Surface, centre: u32, point: [i32; 3]) -> f64 {
        let d = minus(point, surface.surfels[centre as usize].k);
        let square: f64 = (0..3)
            .map(|a| (f64::from(d[a]) * self.scale.edges[a]).powi(2))
            .sum();
        0.5 * square.sqrt()
    }
}

fn sharp(surface: &Surface, cells: &Cells, walk: &Walk) -> FixedSums {
    let mut sums = FixedSums::default();
    for &f in &walk.members {
        sums.mu0 += cells.mu0[f as usize];
        for side in 0..4 {
            // Both surfels see the linel: the first adds it.
            let g = surface.neighbours[f as usize][side];
            if g != OPEN && g > f && walk.has(g) {
                let sheet = surface.sheets_of[f as usize][side] as usize;
                add(&mut sums.tensor, cells.tensor[sheet]);
                sums.omega += cells.omega[sheet];
            }
        }
        for umbrella in surface.umbrellas_of[f as usize] {
            // All surfels of the umbrella see the pointel: the first adds it.
            if surface
                .umbrella(umbrella)
                .iter()
                .all(|&g| g >= f && walk.has(g))
            {
                sums.mu2 += cells.mu2[umbrella as usize];
            }
        }
    }
    sums
}

fn lumped(surface: &Surface, cells: &Cells, walk: &Walk) -> FixedSums {
    let mut sums = FixedSums::default();
    for &f in &walk.members {
        let own = lump(surface, cells, f);
        sums.mu0 += own.mu0;
        add(&mut sums.tensor, own.tensor);
        sums.mu2 += own.mu2;
        sums.omega += own.omega;
    }
    sums
}

/// What a surfel carries.
fn lump(surface: &Surface, cells: &Cells, f: u32) -> FixedSums {
    let mut own = FixedSums {
        mu0: cells.mu0[f as usize],
        ..Default::default()
    };
    for sheet in surface.sheets_of[f as usize] {
        add(&mut own.tensor, cells.half_tensor[sheet as usize]);
        own.omega += cells.half_omega[sheet as usize];
    }
    for umbrella in surface.umbrellas_of[f as usize] {
        let degree = surface.umbrella(umbrella).len() as i64;
        own.mu2 += nearest_quotient(cells.mu2[umbrella as usize], degree);
    }
    own
}

fn add(sum: &mut [i64; 6], tensor: [i64; 6]) {
    (0..6).for_each(|e| sum[e] += tensor[e]);
}
