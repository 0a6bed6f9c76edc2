//! Rows of a brick: sums to curvatures and flags, and rows to batches.

use std::ops::Range;

use glam::DVec3;

use crate::curvature::Curvature;
use crate::khalimsky::sign;
use crate::measure::ball::{BallScratch, BallSums, LocalMeasures};
use crate::measure::cells::{CellMeasures, mark};
use crate::measure::fixed;
use crate::measure::surface::Surface;
use crate::sink::{CurvatureColumns, Flag, FlagSet, SurfelBatch};
use crate::surfel::CellBox;

use super::run::Shared;

/// Rows of the core of a brick, in Khalimsky order.
#[derive(Debug, Default)]
pub(super) struct BrickRows {
    surfels: Vec<SurfelRow>,
    /// For each radius, one a surfel.
    curvatures: Vec<Vec<CurvatureRow>>,
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
    directions: [[f32; 3]; 2],
    flags: FlagSet,
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
        let mut scratch = BallScratch::default();
        let mut rows = Self {
            surfels: Vec::with_capacity(u.len()),
            curvatures: balls.iter().map(|_| Vec::with_capacity(u.len())).collect(),
        };
        for start in 0..surface.len() {
            let surfel = surface.surfels.oriented(start);
            if !core.contains(surfel.cell()) {
                continue;
            }
            let number = rows.surfels.len();
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
            for (ball, column) in balls.iter().zip(&mut rows.curvatures) {
                let sums = ball.sum(surface, measures, start, &mut scratch);
                let curvature = Curvature::from_sums(&sums, u[number], unit);
                let flags = flags(
                    &sums,
                    own.marks[number],
                    curvature.as_ref(),
                    ball.radius() * unit,
                );
                column.push(CurvatureRow::new(shared, curvature, flags));
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
        if batch.curvatures.is_empty() {
            batch.curvatures = vec![CurvatureColumns::default(); self.curvatures.len()];
        }
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
                if shared.settings.directions {
                    for a in 0..3 {
                        columns.d1[a].push(row.directions[0][a]);
                        columns.d2[a].push(row.directions[1][a]);
                    }
                }
            }
        }
    }
}

impl CurvatureRow {
    fn new(shared: &Shared<'_>, curvature: Option<Curvature>, flags: FlagSet) -> Self {
        match curvature {
            None => Self {
                values: [f32::NAN; 4],
                directions: [[f32::NAN; 3]; 2],
                flags,
            },
            Some(c) => Self {
                values: [c.mean, c.gaussian, c.k1, c.k2].map(|x| x as f32),
                directions: [c.d1, c.d2].map(|d| to_world(shared, upward(d))),
                flags,
            },
        }
    }
}

/// A direction with its sign fixed: the largest component by size, the first of equals, is positive.
fn upward(d: DVec3) -> DVec3 {
    let a = d.to_array();
    let largest = (0..3).fold(0, |best, i| {
        if a[i].abs() > a[best].abs() * (1.0 + 1e-9) {
            i
        } else {
            best
        }
    });
    if a[largest] < 0.0 { -d } else { d }
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
    set(sums.marks & mark::CUT != 0 || sums.rim.open, Flag::Border);
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
