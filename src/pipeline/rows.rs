//! Rows of a brick: sums to curvatures and flags, and rows to batches.

use std::ops::Range;

use glam::DVec3;

use crate::curvature::uncertainty::{self, ErrorKind};
use crate::curvature::{Curvature, upward};
use crate::khalimsky::{OrientedSurfel, sign};
use crate::measure::ball::{BallSums, Evidence, LocalMeasures};
use crate::measure::cells::{CellMeasures, extend, mark};
use crate::measure::fixed;
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
    /// For each radius, one a surfel.
    curvatures: Vec<Vec<CurvatureRow>>,
    /// The same of d1 and d2; empty unless they are wanted.
    directions: Vec<Vec<[[f32; 3]; 2]>>,
    /// The same of the errors to expect of H and G.
    errors: Vec<Vec<[f32; 2]>>,
    /// The same of mu_Omega / mu0.
    quality: Vec<Vec<f32>>,
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
        let unit = shared.lattice.voxel_unit_world();
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
            let radius_world = ball.radius() * unit;
            let mut curvatures = Vec::with_capacity(u.len());
            let mut principal = Vec::new();
            let mut errors = Vec::new();
            let mut quality = Vec::new();
            for (number, sums) in ball.sums(surface, measures, &cores).iter().enumerate() {
                let curvature = Curvature::from_sums(sums, u[number], unit);
                let values = curvature.map_or([f32::NAN; 4], |c| {
                    [c.mean, c.gaussian, c.k1, c.k2].map(|x| x as f32)
                });
                let flags = flags(sums, marks[number], curvature.as_ref(), radius_world);
                curvatures.push(CurvatureRow { values, flags });
                if shared.settings.gives_errors() {
                    // Islands and surfels without a normal of their own are no part of a surface whose curvature could be missed.
                    let of_no_surface = Flag::Island.bit() | Flag::DegenerateNormal.bit();
                    let bars = curvature
                        .zip(sums.evidence.filter(|_| flags & of_no_surface == 0))
                        .map(|(c, evidence)| error_bars(shared, &evidence, &c, ball.radius()));
                    errors.push(bars.map_or([f32::NAN; 2], |bars| bars.map(short)));
                }
                if shared.settings.directions {
                    principal.push(directions(shared, curvature.as_ref()));
                }
                if shared.settings.quality {
                    quality.push(curvature.map_or(f32::NAN, |c| quality_in_world(shared, &c)));
                }
            }
            rows.curvatures.push(curvatures);
            if shared.settings.directions {
                rows.directions.push(principal);
            }
            if shared.settings.gives_errors() {
                rows.errors.push(errors);
            }
            if shared.settings.quality {
                rows.quality.push(quality);
            }
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
            let curvatures = found.iter().zip(own.marks()).map(|((c, cut), &marks)| {
                let mut flags = mark_flags(marks) | curvature_flags(Some(c), radius_world);
                if *cut || marks & mark::CUT != 0 {
                    flags |= Flag::Border.bit();
                }
                CurvatureRow {
                    values: [c.mean, c.gaussian, c.k1, c.k2].map(|x| x as f32),
                    flags,
                }
            });
            rows.curvatures.push(curvatures.collect());
            if shared.settings.directions {
                let principal = found.iter().map(|(c, _)| directions(shared, Some(c)));
                rows.directions.push(principal.collect());
            }
            if shared.settings.quality {
                let quality = found.iter().map(|(c, _)| quality_in_world(shared, c));
                rows.quality.push(quality.collect());
            }
        }
        rows
    }

    /// Adds the rows of the planes that follow.
    pub(super) fn append(&mut self, next: Self) {
        if self.surfels.is_empty() {
            *self = next;
            return;
        }
        fn each<T>(to: &mut [Vec<T>], next: Vec<Vec<T>>) {
            for (to, next) in to.iter_mut().zip(next) {
                extend(to, next);
            }
        }
        extend(&mut self.surfels, next.surfels);
        each(&mut self.curvatures, next.curvatures);
        each(&mut self.directions, next.directions);
        each(&mut self.errors, next.errors);
        each(&mut self.quality, next.quality);
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
        for (errors, columns) in self.errors.iter().zip(&mut batch.curvatures) {
            for [mean, gaussian] in &errors[run.clone()] {
                columns.mean_error.push(*mean);
                columns.gaussian_error.push(*gaussian);
            }
        }
        for (quality, columns) in self.quality.iter().zip(&mut batch.curvatures) {
            columns.quality.extend_from_slice(&quality[run.clone()]);
        }
    }
}

/// What the columns of errors hold, in world units.
fn error_bars(
    shared: &Shared<'_>,
    evidence: &Evidence,
    curvature: &Curvature,
    radius: f64,
) -> [f64; 2] {
    let settings = shared.settings;
    let of_normals = match (settings.refinement, settings.estimator) {
        (Some(radius), _) => radius,
        (None, Estimator::SurfaceAverage { radius }) => radius / FIRST_RADIUS,
        _ => radius,
    };
    let unit = shared.lattice.voxel_unit_world();
    match settings.error_kind {
        ErrorKind::Bars => uncertainty::error_bars(evidence, curvature, radius, of_normals, unit),
        ErrorKind::Differences => [evidence.mean_difference.abs() / unit, f64::NAN],
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

/// d1 and d2 in world axes.
fn directions(shared: &Shared<'_>, curvature: Option<&Curvature>) -> [[f32; 3]; 2] {
    match curvature {
        None => [[f32::NAN; 3]; 2],
        Some(c) => [c.d1, c.d2].map(|d| to_world(shared, upward(d))),
    }
}

/// mu_Omega / mu0 as seen in the world: where the axes of the image are left-handed there, a turn
/// counter-clockwise in the image is one clockwise in the world.
fn quality_in_world(shared: &Shared<'_>, curvature: &Curvature) -> f32 {
    let [a, b, c] = shared.lattice.direction.map(DVec3::from_array);
    let quality = curvature.quality as f32;
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

/// The flags, of those given, whose condition holds.
fn flags_of<const N: usize>(conditions: [(bool, Flag); N]) -> FlagSet {
    let set = conditions.into_iter().filter(|&(on, _)| on);
    set.fold(0, |flags, (_, flag)| flags | flag.bit())
}

fn flags(sums: &BallSums, marks: u8, curvature: Option<&Curvature>, radius_world: f64) -> FlagSet {
    flags_of([
        (sums.cut, Flag::Border),
        (sums.several_sheets, Flag::SeveralSheets),
        (sums.rim.is_island(), Flag::Island),
        (sums.is_rough(), Flag::Rough),
    ]) | mark_flags(marks)
        | curvature_flags(curvature, radius_world)
}

/// What was known of the surfel before any ball.
fn mark_flags(marks: u8) -> FlagSet {
    flags_of([
        (marks & mark::OPPOSED != 0, Flag::NormalOpposed),
        (marks & mark::LIFTED != 0, Flag::Lifted),
        (marks & mark::DEGENERATE != 0, Flag::DegenerateNormal),
    ])
}

/// What the values tell.
fn curvature_flags(curvature: Option<&Curvature>, radius_world: f64) -> FlagSet {
    let largest = curvature.map_or(0.0, |c| c.k1.abs().max(c.k2.abs()));
    flags_of([
        (curvature.is_none(), Flag::NoArea),
        (largest * radius_world > 1.0, Flag::RadiusTooLarge),
    ])
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
