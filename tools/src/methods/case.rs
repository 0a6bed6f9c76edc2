//! A digitised shape, and what the methods give on it.

use std::fmt::Write as _;
use std::time::Instant;

use anyhow::Result;
use curvox::lattice::Lattice;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{NamedMethod, Settings};
use curvox::shape::{
    BoxedShape, Digitisation, Grid, Noise, NoisyPlanes, SurfaceTruth, by_spec, closest_point,
};
use curvox::sink::{Flag, SurfelBatch};
use curvox::volume::Criterion;
use curvox_formats::VoxelType;
use glam::DVec3;
use rayon::prelude::*;

use crate::in_memory::{places, rows_of};
use crate::moved::Moved;

use super::METHODS;
use super::bars::Shares;

/// What to digitise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Task {
    pub(super) shape: &'static str,
    pub(super) gridstep: f64,
    pub(super) position: u64,
    pub(super) noise: f64,
    /// Voxels of 1 x 1 x 2 and the same volume.
    pub(super) flat: bool,
    /// Radius in voxels, if not the paper's.
    pub(super) radius: Option<f64>,
}

/// A digitised shape.
pub(super) struct Case {
    task: Task,
    digitisation: Digitisation<Moved<BoxedShape>>,
    stored: Vec<u8>,
}

/// What a method gave on a case.
pub(super) struct Trial {
    pub(super) surfels: usize,
    pub(super) left_out: usize,
    /// l2 and linf of each quantity.
    pub(super) errors: [[f64; 2]; 4],
    /// How the errors of H and G compare with their bars, if it gives some.
    pub(super) shares: Option<[Shares; 2]>,
    pub(super) microseconds: f64,
}

impl Case {
    pub(super) fn new(task: Task) -> Result<Self> {
        let Task {
            shape,
            gridstep,
            position,
            noise,
            flat,
            ..
        } = task;
        let moved = Moved::numbered(by_spec(shape)?, position, gridstep);
        let edge = gridstep / 2f64.cbrt();
        let spacing = if flat {
            DVec3::new(edge, edge, 2.0 * edge)
        } else {
            DVec3::splat(gridstep)
        };
        let digitisation = Digitisation::new(moved, Grid::boxes(spacing))?;
        let dims = digitisation.dims();
        let mut stored = Vec::new();
        let mut plane = Vec::new();
        if noise > 0.0 {
            let source = |z: usize, out: &mut Vec<u8>| {
                digitisation.plane(z, out);
                Ok::<_, std::convert::Infallible>(())
            };
            let mut planes =
                NoisyPlanes::new(Noise::new(noise, position)?, dims, 0..dims[2], source);
            while planes
                .next_plane::<std::convert::Infallible>(&mut plane)?
                .is_some()
            {
                stored.extend_from_slice(&plane);
            }
        } else {
            for z in 0..dims[2] {
                digitisation.plane(z, &mut plane);
                stored.extend_from_slice(&plane);
            }
        }
        Ok(Self {
            task,
            digitisation,
            stored,
        })
    }

    /// What each of the methods gives, which are lines of the table too.
    pub(super) fn trials(&self, csv: &mut String) -> Result<Vec<Trial>> {
        let mut trials = Vec::new();
        let computed: Result<Vec<_>> = METHODS
            .into_iter()
            .map(|(_, method, oriented)| self.computed(method, oriented))
            .collect();
        let computed = computed?;
        let mut truth = self.truth(&computed[0].0);
        // What is an island to one method, or has no value, is left out for all.
        let without = Flag::Island.bit() | Flag::NoArea.bit();
        for (rows, _) in &computed {
            let flags = rows.iter().flat_map(|batch| &batch.curvatures[0].flags);
            for (truth, flags) in truth.iter_mut().zip(flags) {
                if flags & without != 0 {
                    *truth = None;
                }
            }
        }
        for ((name, ..), (rows, seconds)) in METHODS.into_iter().zip(computed) {
            let mut trial = errors(&rows, &truth, self.radius());
            trial.microseconds = seconds * 1e6 / trial.surfels.max(1) as f64;
            let spacing = if self.task.flat { "1x1x2" } else { "1x1x1" };
            let _ = write!(
                csv,
                "\"{}\",{},{},{},{spacing},{},\"{name}\",{},{}",
                self.task.shape,
                self.task.gridstep,
                self.task.position,
                self.task.noise,
                self.radius(),
                trial.surfels,
                trial.left_out
            );
            for error in trial.errors.iter().flatten() {
                let _ = write!(csv, ",{error:.6}");
            }
            for q in 0..2 {
                let resolved = trial.shares.as_ref().map(|s| s[q].resolved());
                let _ = match resolved.filter(|_| q == 0) {
                    Some(share) => write!(csv, ",{share:.4}"),
                    None if q == 0 => write!(csv, ","),
                    None => Ok(()),
                };
                for bars in [1.0, 2.0] {
                    let share = trial.shares.as_ref().map(|s| s[q].within(bars));
                    let _ = match share {
                        Some(share) => write!(csv, ",{share:.4}"),
                        None => write!(csv, ","),
                    };
                }
            }
            let _ = writeln!(csv, ",{:.2}", trial.microseconds);
            trials.push(trial);
        }
        Ok(trials)
    }

    /// The radius, in world units.
    fn radius(&self) -> f64 {
        let h = self.task.gridstep;
        match self.task.radius {
            Some(voxels) => voxels * h,
            None => 3.0 * h.sqrt(),
        }
    }

    /// Settings of a method at a radius in world units.
    pub(super) fn settings(
        &self,
        method: NamedMethod,
        oriented: bool,
        radius: f64,
    ) -> Result<Settings> {
        let dims = self.digitisation.dims().map(|n| n as u64);
        let lattice = Lattice::new(dims, self.digitisation.spacing().to_array(), false)?;
        let radius = radius / lattice.voxel_unit_world();
        let mut settings = Settings::new(lattice).with_method(method, radius);
        if oriented {
            settings.estimator = Estimator::IntegralInvariant {
                radius,
                orientation: Orientation::Moment,
            };
        }
        settings.memory_bytes = 8 << 30;
        Ok(settings)
    }

    /// The voxels, 1 inside.
    pub(super) fn stored(&self) -> &[u8] {
        &self.stored
    }

    /// The rows of a method, and the seconds of the whole run.
    fn computed(&self, method: NamedMethod, oriented: bool) -> Result<(Vec<SurfelBatch>, f64)> {
        let settings = self.settings(method, oriented, self.radius())?;
        let inside = Criterion::AtLeast(1i128.into());
        let started = Instant::now();
        let rows = rows_of(&self.stored, VoxelType::U8, inside, &settings)?;
        Ok((rows, started.elapsed().as_secs_f64()))
    }

    /// The true surface closest to each row; `None` farther than two voxels away.
    fn truth(&self, rows: &[SurfelBatch]) -> Vec<Option<SurfaceTruth>> {
        let far = 2.0 * self.digitisation.spacing().max_element();
        let all: Vec<_> = places(rows).collect();
        let near = all.into_par_iter().map(|(batch, i)| {
            let k = [0, 1, 2].map(|a| i64::from(batch.k[a][i]));
            closest_point(
                self.digitisation.shape(),
                self.digitisation.khalimsky_to_world(k),
            )
            .filter(|c| c.signed_distance.abs() <= far)
            .map(|c| c.truth)
        });
        near.collect()
    }
}

fn errors(rows: &[SurfelBatch], truth: &[Option<SurfaceTruth>], radius: f64) -> Trial {
    let mut trial = Trial {
        surfels: truth.len(),
        left_out: 0,
        errors: [[0.0; 2]; 4],
        shares: None,
        microseconds: 0.0,
    };
    for ((batch, i), truth) in places(rows).zip(truth) {
        let at = &batch.curvatures[0];
        let Some(truth) = truth else {
            trial.left_out += 1;
            continue;
        };
        let pairs = [
            (at.mean[i], truth.mean_curvature),
            (at.gaussian[i], truth.gaussian_curvature),
            (at.k1[i], truth.k1),
            (at.k2[i], truth.k2),
        ];
        // What is smaller than the ball leaves no trace by which to tell how large the error is.
        let is_resolved = truth.k1.abs().max(truth.k2.abs()) * radius <= 1.0;
        if let (Some(&mean), Some(&gaussian)) = (at.mean_error.get(i), at.gaussian_error.get(i)) {
            let shares = trial.shares.get_or_insert_with(Default::default);
            for (q, (shares, bar)) in shares.iter_mut().zip([mean, gaussian]).enumerate() {
                let (found, truth) = pairs[q];
                shares.add((f64::from(found) - truth).abs(), bar.into(), is_resolved);
            }
        }
        for ([l2, linf], (found, truth)) in trial.errors.iter_mut().zip(pairs) {
            let error = (f64::from(found) - truth).abs();
            *l2 += error * error;
            // In total order NaN is the largest; f64::max would hide it.
            if error.total_cmp(linf).is_gt() {
                *linf = error;
            }
        }
    }
    let count = (trial.surfels - trial.left_out).max(1) as f64;
    for [l2, _] in &mut trial.errors {
        *l2 = (*l2 / count).sqrt();
    }
    trial
}
