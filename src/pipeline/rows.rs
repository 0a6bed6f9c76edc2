//! Rows of a brick: sums to curvatures and flags, and rows to batches.

use std::ops::Range;

use glam::DVec3;

use crate::curvature::uncertainty::{Bars, ErrorKind};
use crate::curvature::{CurvatureBlock, upward};
use crate::khalimsky::{OrientedSurfel, sign};
use crate::measure::ball::{BallKernel, LocalMeasures, NOISY_SHARE};
use crate::measure::cells::{CellMeasures, append, mark};
use crate::measure::fixed;
use crate::measure::mixture::{SumsBlock, TOGETHER};
use crate::measure::surface::Surface;
use crate::normal::Estimator;
use crate::normal::refine::FIRST_RADIUS;
use crate::sink::{CurvatureColumns, Flag, FlagSet, SurfelBatch};
use crate::surfel::{CellBox, Surfels};
use crate::volume::PlaneWindow;

use super::shared::Shared;

/// Rows of the core of a brick, in Khalimsky order.
#[derive(Debug, Default)]
pub(super) struct BrickRows {
    surfels: Vec<SurfelRow>,
    /// For each radius.
    curvatures: Vec<CurvatureColumns>,
}

#[derive(Clone, Copy, Debug)]
struct SurfelRow {
    k: [i32; 3],
    side: i8,
    normal: [f32; 3],
    area: f32,
}

/// What is known of some consecutive surfels of a brick.
#[derive(Clone, Debug)]
pub(super) struct Own<'a> {
    /// Normals of all surfels of the brick.
    pub(super) u: &'a [DVec3],
    /// Measures of all of them.
    pub(super) measures: &'a CellMeasures,
    /// Which they are.
    pub(super) surfels: Range<usize>,
}

impl Own<'_> {
    fn u(&self) -> &[DVec3] {
        &self.u[self.surfels.clone()]
    }

    fn marks(&self) -> &[u8] {
        &self.measures.marks[self.surfels.clone()]
    }
}

/// A batch with room for `count` rows.
pub(super) fn empty_batch(shared: &Shared<'_>, column: [u32; 2], count: usize) -> SurfelBatch {
    let floats = || Vec::with_capacity(count);
    let only_if = |asked: bool| if asked { floats() } else { Vec::new() };
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
        mean_error: only_if(shared.settings.gives_errors()),
        gaussian_error: only_if(shared.settings.gives_errors()),
        k1: floats(),
        k2: floats(),
        d1: direction(),
        d2: direction(),
        quality: only_if(shared.settings.quality),
        flags: Vec::with_capacity(count),
    };
    SurfelBatch {
        column,
        k: [0; 3].map(|_| Vec::with_capacity(count)),
        side: Vec::with_capacity(count),
        position: triple(),
        normal: triple(),
        area: floats(),
        curvatures: shared.settings.radii.iter().map(curvatures).collect(),
    }
}

impl BrickRows {
    pub(super) fn compute(
        shared: &Shared<'_>,
        surface: &Surface,
        measures: &LocalMeasures,
        core: CellBox,
        own: &Own<'_>,
    ) -> Self {
        let (u, marks) = (own.u(), own.marks());
        let cores: Vec<usize> = (0..surface.len())
            .filter(|&i| core.contains(surface.surfels.oriented(i).cell()))
            .collect();
        let mut rows = Self {
            surfels: surfel_rows(
                shared,
                cores.iter().map(|&i| surface.surfels.oriented(i)),
                own,
            ),
            ..Default::default()
        };
        for ball in &shared.kernels.balls {
            let mut filled = Filled::new(shared, ball, u, marks);
            ball.for_each_block(surface, measures, &cores, &mut |sums| filled.put(sums));
            rows.curvatures.push(filled.columns);
        }
        rows
    }

    /// Rows whose curvatures are plain integral invariants. `surfels` are those of `core`.
    pub(super) fn by_invariants(
        shared: &Shared<'_>,
        voxels: &PlaneWindow,
        core: CellBox,
        surfels: &Surfels,
        own: &Own<'_>,
    ) -> Self {
        let unit = shared.lattice.voxel_unit_world();
        let oriented = (0..surfels.list.len()).map(|i| surfels.oriented(i));
        let mut rows = Self {
            surfels: surfel_rows(shared, oriented, own),
            ..Default::default()
        };
        for kernel in &shared.kernels.invariants {
            let radius_world = kernel.radius() * unit;
            let found = kernel.curvatures(voxels, shared.lattice, core, surfels);
            let mut columns = blank_columns(shared, found.len());
            for (row, ((c, cut), &marks)) in found.iter().zip(own.marks()).enumerate() {
                columns.mean[row] = c.mean as f32;
                columns.gaussian[row] = c.gaussian as f32;
                columns.k1[row] = c.k1 as f32;
                columns.k2[row] = c.k2 as f32;
                columns.flags[row] = mark_flags(marks)
                    | curvature_flags(false, [c.k1, c.k2], radius_world)
                    | flag(*cut || marks & mark::CUT != 0, Flag::Border);
                if shared.settings.directions {
                    put_direction(&mut columns.d1, row, shared, c.d1);
                    put_direction(&mut columns.d2, row, shared, c.d2);
                }
                if shared.settings.quality {
                    columns.quality[row] = quality_in_world(shared, c.quality);
                }
            }
            rows.curvatures.push(columns);
        }
        rows
    }

    /// Adds the rows of the planes that follow.
    pub(super) fn append(&mut self, next: Self) {
        if self.surfels.is_empty() {
            *self = next;
            return;
        }
        append(&mut self.surfels, next.surfels);
        for (to, next) in self.curvatures.iter_mut().zip(&next.curvatures) {
            extend(to, next, 0..next.flags.len());
        }
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
        for (from, to) in self.curvatures.iter().zip(&mut batch.curvatures) {
            extend(to, from, run.clone());
        }
    }
}

/// Appends some rows of columns to others, which hold the same.
fn extend(to: &mut CurvatureColumns, from: &CurvatureColumns, run: Range<usize>) {
    let of = |to: &mut Vec<f32>, from: &[f32]| {
        if !from.is_empty() {
            // rows of a brick are held for long, and batches have the room
            to.reserve_exact(run.len());
            to.extend_from_slice(&from[run.clone()]);
        }
    };
    of(&mut to.mean, &from.mean);
    of(&mut to.gaussian, &from.gaussian);
    of(&mut to.k1, &from.k1);
    of(&mut to.k2, &from.k2);
    of(&mut to.mean_error, &from.mean_error);
    of(&mut to.gaussian_error, &from.gaussian_error);
    of(&mut to.quality, &from.quality);
    for a in 0..3 {
        of(&mut to.d1[a], &from.d1[a]);
        of(&mut to.d2[a], &from.d2[a]);
    }
    to.flags.reserve_exact(run.len());
    to.flags.extend_from_slice(&from.flags[run.clone()]);
}

/// Columns of `count` rows to be filled.
fn blank_columns(shared: &Shared<'_>, count: usize) -> CurvatureColumns {
    let floats = |asked: bool| vec![f32::NAN; if asked { count } else { 0 }];
    let settings = shared.settings;
    let triple = || [(); 3].map(|()| floats(settings.directions));
    CurvatureColumns {
        mean: floats(true),
        gaussian: floats(true),
        mean_error: floats(settings.gives_errors()),
        gaussian_error: floats(settings.gives_errors()),
        k1: floats(true),
        k2: floats(true),
        d1: triple(),
        d2: triple(),
        quality: floats(settings.quality),
        flags: vec![0; count],
    }
}

/// Columns of one radius, filled block by block.
struct Filled<'a> {
    shared: &'a Shared<'a>,
    /// Of each row.
    u: &'a [DVec3],
    marks: &'a [u8],
    bars: Bars,
    /// Of the block at hand.
    curvatures: CurvatureBlock,
    errors: [[f64; TOGETHER]; 2],
    columns: CurvatureColumns,
}

impl<'a> Filled<'a> {
    fn new(shared: &'a Shared<'a>, ball: &BallKernel, u: &'a [DVec3], marks: &'a [u8]) -> Self {
        let settings = shared.settings;
        Self {
            shared,
            u,
            marks,
            bars: Bars {
                radius: ball.radius(),
                normal_radius: match (settings.refinement, settings.estimator) {
                    (Some(radius), _) => radius,
                    (None, Estimator::SurfaceAverage { radius }) => radius / FIRST_RADIUS,
                    _ => ball.radius(),
                },
                unit_world: shared.lattice.voxel_unit_world(),
            },
            curvatures: CurvatureBlock::new(),
            errors: [[0.0; TOGETHER]; 2],
            columns: blank_columns(shared, u.len()),
        }
    }

    /// Fills the rows of a block of sums.
    fn put(&mut self, sums: &SumsBlock) {
        let settings = self.shared.settings;
        let rows = &sums.number[..sums.count];
        for (at, &row) in rows.iter().enumerate() {
            let u = self.u[row as usize];
            for (to, x) in self.curvatures.u.iter_mut().zip(u.to_array()) {
                to[at] = x;
            }
        }
        let found = &mut self.curvatures;
        found.evaluate(sums, self.bars.unit_world, settings.directions);
        let radius_world = self.bars.radius * self.bars.unit_world;
        let columns = &mut self.columns;
        for (at, &row) in rows.iter().enumerate() {
            let row = row as usize;
            columns.mean[row] = found.mean[at] as f32;
            columns.gaussian[row] = found.gaussian[at] as f32;
            columns.k1[row] = found.k1[at] as f32;
            columns.k2[row] = found.k2[at] as f32;
            let principal = [found.k1[at], found.k2[at]];
            columns.flags[row] = flag(sums.cut[at], Flag::Border)
                | flag(sums.several_sheets[at], Flag::SeveralSheets)
                | flag(sums.rim[at].is_island(), Flag::Island)
                | flag(sums.ridges[at] > NOISY_SHARE[0], Flag::Rough)
                | mark_flags(self.marks[row])
                | curvature_flags(found.no_area[at], principal, radius_world);
        }
        if settings.gives_errors() {
            self.put_errors(sums);
        }
        let (found, columns) = (&self.curvatures, &mut self.columns);
        if settings.directions {
            let direction = |d: &[[f64; TOGETHER]; 3], at: usize| DVec3::from(d.map(|d| d[at]));
            for (at, &row) in rows.iter().enumerate() {
                let (d1, d2) = (direction(&found.d1, at), direction(&found.d2, at));
                put_direction(&mut columns.d1, row as usize, self.shared, d1);
                put_direction(&mut columns.d2, row as usize, self.shared, d2);
            }
        }
        if settings.quality {
            for (at, &row) in rows.iter().enumerate() {
                columns.quality[row as usize] = quality_in_world(self.shared, found.quality[at]);
            }
        }
    }

    /// Fills the columns of errors, once the flags are known.
    fn put_errors(&mut self, sums: &SumsBlock) {
        let Some(compensation) = sums.compensation else {
            return;
        };
        let (found, errors) = (&self.curvatures, &mut self.errors);
        match self.shared.settings.error_kind {
            ErrorKind::Bars => self.bars.of(compensation, sums, found, errors),
            ErrorKind::Differences => {
                errors[1] = [f64::NAN; TOGETHER];
                for (error, difference) in errors[0].iter_mut().zip(sums.mean_difference) {
                    *error = difference.abs() / self.bars.unit_world;
                }
            }
        }
        // Islands and surfels without a normal of their own are no part of a surface whose curvature could be missed.
        let none = Flag::Island.bit() | Flag::DegenerateNormal.bit() | Flag::NoArea.bit();
        let columns = &mut self.columns;
        for (at, &row) in sums.number[..sums.count].iter().enumerate() {
            let row = row as usize;
            if columns.flags[row] & none == 0 {
                columns.mean_error[row] = short(errors[0][at]);
                columns.gaussian_error[row] = short(errors[1][at]);
            }
        }
    }
}

/// With the eight leading binary digits, which is all that an error bar means, and packs well.
fn short(x: f64) -> f32 {
    if x.is_nan() {
        return f32::NAN;
    }
    let bits = (x as f32).to_bits();
    // Adding half of what is cut off rounds to nearest; from a finite number it makes infinity at most.
    f32::from_bits((bits + 0x8000) & 0xffff_0000)
}

/// Sets a row of d1 or d2, in world axes.
fn put_direction(columns: &mut [Vec<f32>; 3], row: usize, shared: &Shared<'_>, d: DVec3) {
    for (column, x) in columns.iter_mut().zip(to_world(shared, upward(d))) {
        column[row] = x;
    }
}

/// mu_Omega / mu0 as seen in the world: where the axes of the image are left-handed there, a turn
/// counter-clockwise in the image is one clockwise in the world.
fn quality_in_world(shared: &Shared<'_>, quality: f64) -> f32 {
    let [a, b, c] = shared.lattice.direction.map(DVec3::from_array);
    let quality = quality as f32;
    if a.cross(b).dot(c) < 0.0 {
        // not a minus sign, which would leave -0
        0.0 - quality
    } else {
        quality
    }
}

fn to_world(shared: &Shared<'_>, v: DVec3) -> [f32; 3] {
    shared
        .lattice
        .vector_to_world(v.to_array())
        .map(|x| x as f32)
}

/// What does not depend on the radius.
fn surfel_rows(
    shared: &Shared<'_>,
    surfels: impl Iterator<Item = OrientedSurfel>,
    own: &Own<'_>,
) -> Vec<SurfelRow> {
    let unit = shared.lattice.voxel_unit_world();
    let measures = own.measures;
    surfels
        .zip(own.surfels.clone())
        .map(|(surfel, number)| {
            let mu0 = if measures.lumped.is_empty() {
                measures.mu0[number]
            } else {
                measures.lumped[number][0]
            };
            SurfelRow {
                k: surfel.khalimsky(),
                side: sign(surfel.orientation) as i8,
                normal: to_world(shared, own.u[number]),
                area: (fixed::to_measure(i128::from(mu0)) * unit * unit) as f32,
            }
        })
        .collect()
}

/// The flag if its condition holds.
fn flag(on: bool, flag: Flag) -> FlagSet {
    FlagSet::from(on) * flag.bit()
}

/// What was known of the surfel before any ball.
fn mark_flags(marks: u8) -> FlagSet {
    flag(marks & mark::OPPOSED != 0, Flag::NormalOpposed)
        | flag(marks & mark::LIFTED != 0, Flag::Lifted)
        | flag(marks & mark::DEGENERATE != 0, Flag::DegenerateNormal)
}

/// What the values tell; those of no area are no numbers.
fn curvature_flags(no_area: bool, [k1, k2]: [f64; 2], radius_world: f64) -> FlagSet {
    let largest = k1.abs().max(k2.abs());
    flag(no_area, Flag::NoArea) | flag(largest * radius_world > 1.0, Flag::RadiusTooLarge)
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn error_bars_keep_eight_digits() {
        for (x, y) in [(1.0, 1.0), (1.003, 1.0), (1.005, 1.0078125), (0.0, 0.0)] {
            assert_eq!(short(x), y);
        }
        for exponent in -100..100 {
            let x = 1.234567 * f64::powi(2.0, exponent);
            assert!((f64::from(short(x)) / x - 1.0).abs() <= 1.0 / 256.0);
        }
        assert!(short(f64::NAN).is_nan());
        assert_eq!(short(f64::INFINITY), f32::INFINITY);
        assert_eq!(short(f64::from(f32::MAX)), f32::INFINITY);
    }
}
