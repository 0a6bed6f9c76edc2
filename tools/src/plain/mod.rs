//! The plain reference: every measure by its definition.
//!
//! In: a solid in memory, the spacing, radii, conventions. Out: a row per surfel in the order of
//! (kz, ky, kx), and totals. Guaranteed: lengths are computed in units of the longest voxel edge
//! and brought back to world units in one place, [`curvature`]; balls are pure integers; sums of
//! cell measures are exact, except with DGtal's fractional weights. Not guaranteed: speed, small
//! memory, or the last bit of `u` and of the formulas, which use the platform's `sqrt` and `atan2`.
//!
//! [`solid`] -> [`surface`] -> [`normals`] -> [`cells`] (by [`formula`] or [`field`]) -> [`sums`] (over a
//! [`walk`]) -> [`curvature`]; and [`totals`]. Each step is public, to be tested and timed alone.

pub mod algebra;
pub mod cells;
pub mod curvature;
pub mod field;
pub mod formula;
pub mod invariants;
pub mod normals;
pub mod solid;
pub mod sums;
pub mod surface;
pub mod totals;
pub mod voronoi;
pub mod walk;

pub use cells::Cells;
pub use curvature::Curvature;
pub use field::Field;
pub use normals::{Estimator, Normals, Orientation};
pub use solid::{Scale, Solid};
pub use sums::{Ball, BallKind, FixedSums, Sums, Weights};
pub use surface::{Adjacency, Surface, Surfel};
pub use totals::{SolidTotals, Totals};
pub use voronoi::Ties;
pub use walk::Walk;

use algebra::{Vector, dot};
use walk::for_each_within;

/// What to compute. Lengths are in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Edges of a voxel along x, y, z.
    pub spacing_world: [f64; 3],
    /// Are surfels made on the border of the image?
    pub closed: bool,
    /// How surfels join at a linel shared by four.
    pub adjacency: Adjacency,
    /// The corrected normals.
    pub normals: Estimator,
    /// How the normals go on over the surface.
    pub field: Field,
    /// Radius rho of the ball of the measures.
    pub rho_world: f64,
    /// Which cells of the ball count, and how much.
    pub weights: Weights,
    /// Which surfels of the ball count.
    pub ball: BallKind,
    /// Count the surfels of the whole ball, for the flag `several_sheets`? It can cost more than a walk.
    pub count_sheets: bool,
}

impl Settings {
    /// The defaults: open border, interior adjacency, II normals away from the first moment,
    /// sharp connected ball, one radius for everything.
    pub fn new(spacing_world: [f64; 3], radius_world: f64) -> Self {
        Settings {
            spacing_world,
            closed: false,
            adjacency: Adjacency::Interior,
            normals: Estimator::IntegralInvariant {
                radius_world,
                orientation: Orientation::Moment,
            },
            field: Field::Constant,
            rho_world: radius_world,
            weights: Weights::Sharp,
            ball: BallKind::Connected,
            count_sheets: true,
        }
    }
}

/// What may be wrong with a row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags {
    /// The connected ball has a surfel with a side on the border of the image.
    pub border: bool,
    /// The whole ball has more surfels than the connected one (only if they were counted).
    pub several_sheets: bool,
    /// The connected ball is a closed surface.
    pub island: bool,
    /// <u, n> <= 0; with a continuous field on the average, mu0 <= 0.
    pub reversed: bool,
    /// An umbrella of this surfel has a lift: k != 0; never with a continuous field.
    pub lift: bool,
    /// u is the trivial normal for want of anything better.
    pub degenerate: bool,
}

/// One surfel.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Where it is.
    pub surfel: Surfel,
    /// The corrected normal.
    pub u: Vector,
    /// mu0 of the surfel itself, squared world units.
    pub area: f64,
    /// Curvatures, world units.
    pub curvature: Curvature,
    /// Surfels summed.
    pub members: usize,
    /// The sums behind the curvatures, in units of the longest voxel edge.
    pub sums: Sums,
    /// The sums as exact integers, if the weights are not fractions.
    pub fixed_sums: Option<FixedSums>,
    /// What may be wrong.
    pub flags: Flags,
}

/// Everything about a solid.
#[derive(Clone, Debug)]
pub struct Analysis {
    /// The surface that was measured.
    pub surface: Surface,
    /// The measures of its cells.
    pub cells: Cells,
    /// One row a surfel, in the order of (kz, ky, kx).
    pub rows: Vec<Row>,
    /// Sums over the whole surface.
    pub totals: Totals,
}

/// Computes everything about `solid`.
///
/// # Panics
/// If the spacing or a radius is not positive, or the surface has 2^32 - 1 surfels or more.
pub fn analyse(solid: &Solid, settings: &Settings) -> Analysis {
    let scale = Scale::new(settings.spacing_world);
    let surface = Surface::new(solid, settings.closed, settings.adjacency);
    let normals = normals::estimate(solid, &surface, &scale, settings.normals);
    let cells = Cells::with_field(&surface, &normals.u, &scale, settings.field);
    let rows = measure(&surface, &normals, &cells, &scale, settings);
    let totals = Totals::new(solid, &surface, &cells);
    Analysis {
        surface,
        cells,
        rows,
        totals,
    }
}

/// The rows of all surfels, given the normals and the measures of the cells.
pub fn measure(
    surface: &Surface,
    normals: &Normals,
    cells: &Cells,
    scale: &Scale,
    settings: &Settings,
) -> Vec<Row> {
    let ball = Ball::new(
        scale,
        settings.rho_world / scale.unit_world,
        settings.weights,
    );
    let mut walk = Walk::new(surface);
    let mut rows = Vec::with_capacity(surface.len());
    for p in 0..surface.len() as u32 {
        let surfel = surface.surfels[p as usize];
        let u = normals.u[p as usize];
        let belongs = |g| ball.has(surface, p, g);
        walk.connected(p, belongs);
        let mut flags = Flags {
            border: walk.meets_border,
            several_sheets: false,
            island: !walk.meets_border && !walk.meets_rim,
            reversed: match cells.of_surfels {
                Some(_) => cells.mu0[p as usize] <= 0,
                None => dot(u, surfel.normal()) <= 0.0,
            },
            lift: surface.umbrellas_of[p as usize]
                .iter()
                .any(|&o| cells.lift[o as usize] != 0),
            degenerate: normals.degenerate[p as usize],
        };
        if settings.count_sheets {
            let mut in_whole_ball = 0;
            for_each_within(surface, p, ball.reach(), |g| {
                in_whole_ball += usize::from(belongs(g))
            });
            flags.several_sheets = walk.members.len() < in_whole_ball;
        }
        if settings.ball == BallKind::Whole {
            walk.whole(p, ball.reach(), belongs);
        }
        let (sums, fixed_sums) = ball.sum(surface, cells, &walk, p);
        rows.push(Row {
            surfel,
            u,
            area: cells.mu0[p as usize] as f64 * cells::UNIT * scale.unit_world * scale.unit_world,
            curvature: Curvature::new(&sums, u, scale.unit_world),
            members: walk.members.len(),
            sums,
            fixed_sums,
            flags,
        });
    }
    rows
}
