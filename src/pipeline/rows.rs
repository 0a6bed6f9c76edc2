//! Rows of a brick: sums to curvatures and flags, and rows to batches.

use std::ops::Range;

use glam::DVec3;

use crate::curvature::{Curvature, upward};
use crate::khalimsky::sign;
use crate::measure::ball::{BallSums, LocalMeasures};
use crate::measure::cells::{CellMeasures, mark};
use crate::measure::fixed;
use crate::measure::surface::Surface;
use crate::sink::{CurvatureColumns, Flag, FlagSet, SurfelBatch};
use crate::surfel::CellBox;

use super::shared::Shared;

/// Rows of the core of a brick, in Khalimsky order.
#[derive(Debug, Default)]
pub(super) struct BrickRows {
    surfels: Vec<SurfelRow>,
    /// For each radius, one a surfel.
    curvatures: Vec<Vec<CurvatureRow>>,
    /// The same of d1 and d2; empty unless they are wanted.
    directions: Vec<Vec<[[f32; 3]; 2]>>,
}

#[derive(Clone, Copy, Debug)]
struct SurfelRow {
    k: [i32; 3],
    side: i8,
    normal: [f32; 3],
    area: f32,
}

#[derive(Clone, Copy, Debug)]
struct CurvatureRow {
    values: [f32; 4],
    flags: FlagSet,
}

/// A batch with room for `count` rows.
pub(super) fn empty_batch(shared: &Shared<'_>, column: [u32; 2], count: usize) -> SurfelBatch {
    let floats = || Vec::with_capacity(count);
    let triple = || [floats(), floats(), floats()];
    let direction = || {
        if shared.settings.directions {
            triple()
        } else {
            Default::default()
        }
    };
    let curvatures = |_| CurvatureColumns {
        mean: floats(),
        gaussian: floats(),
        k1: floats(),
        k2: floats(),
        d1: direction(),
        d2: direction(),
        flags: Vec::with_capacity(count),
    };
    SurfelBatch {
        column,
        k: [0; 3].map(|_| Vec::with_capacity(count)),
        side: Vec::with_capacity(count),
        position: triple(),
        normal: triple(),
        area: floats(),
        curvatures: shared.kernels.balls.iter().map(curvatures).collect(),
    }
}

impl BrickRows {
    pub(super) fn compute(
        shared: &Shared<'_>,
        surface: &Surface,
        measures: &LocalMeasures,
        core: CellBox,
        u: &[DVec3],
        own: &CellMeasures,
    ) -> Self {
        let lattice = shared.lattice;
        let unit = lattice.voxel_unit_world();
        let balls = &shared.kernels.balls;
        let mut rows = Self {
            surfels: Vec::with_capacity(u.len()),
            ..Default::default()
        };
        let cores: Vec<usize> = (0..surface.len())
            .filter(|&i| core.contains(surface.surfels.oriented(i).cell()))
            .collect();
        for (number, &start) in cores.iter().enumerate() {
            let surfel = surface.surfels.oriented(start);
            let mu0 = if own.lumped.is_empty() {
                own.mu0[number]
            } else {
                own.lumped[number][0]
            };
            rows.surfels.push(SurfelRow {
                k: surfel.khalimsky(),
                side: sign(surfel.orientation) as i8,
                normal: to_world(shared, u[number]),
                area: (fixed::to_measure(i128::from(mu0)) * unit * unit) as f32,
            });
        }
        for ball in balls {
            let radius_world = ball.radius() * unit;
            let mut curvatures = Vec::with_capacity(u.len());
            let mut principal = Vec::new();
            for (number, sums) in ball.sums(surface, measures, &cores).iter().enumerate() {
                let curvature = Curvature::from_sums(sums, u[number], unit);
                let values = curvature.map_or([f32::NAN; 4], |c| {
                    [c.mean, c.gaussian, c.k1, c.k2].map(|x| x as f32)
                });
                let flags = flags(sums, own.marks[number], curvature.as_ref(), radius_world);
                curvatures.push(CurvatureRow { values, flags });
                if shared.settings.directions {
                    principal.push(directions(shared, curvature.as_ref()));
                }
            }
            rows.curvatures.push(curvatures);
            if shared.settings.directions {
                rows.directions.push(principal);
            }
        }
        rows
    }

    /// Appends the rows `run` to a batch.
    pub(super) fn append_to(
        &self,
        batch: &mut SurfelBatch,
        run: Range<usize>,
        shared: &Shared<'_>,
    ) {
        for row in &self.surfels[run.clone()] {
            let position = shared.lattice.khalimsky_to_world(row.k);
            for a in 0..3 {
                batch.k[a].push(row.k[a]);
                batch.position[a].push(position[a] as f32);
                batch.normal[a].push(row.normal[a]);
            }
            batch.side.push(row.side);
            batch.area.push(row.area);
        }
        for (rows, columns) in self.curvatures.iter().zip(&mut batch.curvatures) {
            for row in &rows[run.clone()] {
                columns.mean.push(row.values[0]);
                columns.gaussian.push(row.values[1]);
                columns.k1.push(row.values[2]);
                columns.k2.push(row.values[3]);
                columns.flags.push(row.flags);
            }
        }
        for (directions, columns) in self.directions.iter().zip(&mut batch.curvatures) {
            for [d1, d2] in &directions[run.clone()] {
                for a in 0..3 {
                    columns.d1[a].push(d1[a]);
                    columns.d2[a].push(d2[a]);
                }
            }
        }
    }
}

/// d1 and d2 in world axes.
fn directions(shared: &Shared<'_>, curvature: Option<&Curvature>) -> [[f32; 3]; 2] {
    match curvature {
        None => [[f32::NAN; 3]; 2],
        Some(c) => [c.d1, c.d2].map(|d| to_world(shared, upward(d))),
    }
}

fn to_world(shared: &Shared<'_>, v: DVec3) -> [f32; 3] {
    shared
        .lattice
        .vector_to_world(v.to_array())
        .map(|x| x as f32)
}

fn flags(sums: &BallSums, marks: u8, curvature: Option<&Curvature>, radius_world: f64) -> FlagSet {
    let mut flags = 0;
    let mut set = |on: bool, flag: Flag| {
        if on {
            flags |= flag.bit();
        }
    };
    set(sums.cut, Flag::Border);
    set(sums.several_sheets, Flag::SeveralSheets);
    set(sums.rim.is_island(), Flag::Island);
    set(marks & mark::OPPOSED != 0, Flag::NormalOpposed);
    set(marks & mark::LIFTED != 0, Flag::Lifted);
    set(marks & mark::DEGENERATE != 0, Flag::DegenerateNormal);
    set(curvature.is_none(), Flag::NoArea);
    if let Some(c) = curvature {
        let largest = c.k1.abs().max(c.k2.abs());
        set(largest * radius_world > 1.0, Flag::RadiusTooLarge);
    }
    flags
}
