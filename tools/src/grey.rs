//! Normals from grey values against normals from bits, on images such as scanners give.
//!
//! Shapes of known curvature are rendered at partial volume, blurred by a Gaussian of one voxel and
//! given white noise of several widths, as 16 bits ([`curvox::shape::GreyPlanes`]). At the
//! half-way threshold H is computed from the bits, with integral invariants and lumped sums and as by default, and with
//! gradients of the values and compensated sums, all at the paper's radius 3 h^(-1/2) voxels.
//!
//! Errors are taken at the closest point of the true surface, over the surfels within two voxels
//! of it that are on no island (specks that the noise puts elsewhere have no true curvature); how
//! many are left out is told.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use curvox::lattice::Lattice;
use curvox::measure::ball::{Compensation, Weights};
use curvox::normal::refine::FIRST_RADIUS;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::Settings;
use curvox::shape::{
    BoxedShape, Digitisation, GreyPlanes, Grid, Scanner, SurfaceTruth, by_spec, closest_point,
};
use curvox::sink::{Flag, SurfelBatch};
use curvox::volume::Criterion;
use curvox_formats::VoxelType;
use glam::DVec3;

use crate::in_memory::{places, rows_of};

/// The shapes.
const SHAPES: [&str; 3] = ["sphere:radius=9", "torus:major=6,minor=2", "goursat"];

/// Position of the grid, in voxels: generic, so that no symmetry flatters the results.
const OFFSET: DVec3 = DVec3::new(0.31, -0.17, 0.43);

/// Blur and noise of the scanners.
const SCANNERS: [[f64; 2]; 5] = [[0.0, 0.0], [1.0, 0.0], [1.0, 0.02], [1.0, 0.05], [1.0, 0.1]];

/// Half of the 16 bits: the level of the surface.
const HALF: f64 = 32768.0;

/// Options of `grey`.
#[derive(Args, Clone, Debug)]
pub struct GreyArgs {
    /// Directory to write grey.csv and grey.md to
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,

    /// Gridsteps
    #[arg(long, value_delimiter = ',', default_value = "1,0.5,0.25,0.125")]
    gridsteps: Vec<f64>,

    /// Widths of the Gaussian of the gradient, in voxels
    #[arg(long, value_delimiter = ',', default_value = "1,1.25,1.5,2")]
    sigmas: Vec<f64>,

    /// Seed of the noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Errors of one way to compute normals on one image.
struct Trial {
    normals: String,
    surfels: usize,
    left_out: usize,
    opposed: usize,
    degenerate: usize,
    /// Root mean square angle of u to the true normal, in degrees.
    angle: f64,
    l2: f64,
    linf: f64,
}

/// An image of a shape.
struct Scan {
    digitisation: Digitisation<BoxedShape>,
    gridstep: f64,
    stored: Vec<u8>,
}

impl GreyArgs {
    /// Makes the study and writes it.
    ///
    /// # Errors
    /// If a gridstep or sigma cannot be used, or the files cannot be written.
    pub fn run(self) -> Result<()> {
        fs::create_dir_all(&self.output).with_context(|| self.output.display().to_string())?;
        let mut csv = String::from(
            "shape,gridstep,blur,noise,normals,surfels,left_out,opposed,degenerate,\
             angle_rms_degrees,H_l2,H_linf\n",
        );
        let mut table = String::from("| shape | h | blur, noise |");
        let names = ["ii".to_owned(), "default".to_owned()].into_iter();
        let names = names.chain(self.sigmas.iter().map(|s| format!("gradient {s}vx")));
        let names: Vec<String> = names.collect();
        let _ = writeln!(table, " {} |", names.join(" | "));
        let _ = writeln!(table, "|---|---|---|{}", "---|".repeat(names.len()));
        for spec in SHAPES {
            let shape = spec.split(':').next().unwrap_or(spec);
            for &gridstep in &self.gridsteps {
                for [blur, noise] in SCANNERS {
                    let scanner = Scanner {
                        blur,
                        noise,
                        seed: self.seed,
                    };
                    let scan = Scan::new(spec, gridstep, scanner)?;
                    let _ = write!(table, "| {shape} | {gridstep} | {blur}, {noise} |");
                    for trial in scan.trials(&self.sigmas)? {
                        let _ = writeln!(
                            csv,
                            "{shape},{gridstep},{blur},{noise},{},{},{},{},{},{:.4},{:.6},{:.6}",
                            trial.normals,
                            trial.surfels,
                            trial.left_out,
                            trial.opposed,
                            trial.degenerate,
                            trial.angle,
                            trial.l2,
                            trial.linf
                        );
                        let _ = write!(table, " {:.4} / {:.3} |", trial.l2, trial.linf);
                    }
                    let _ = writeln!(table);
                }
            }
        }
        write(&self.output.join("grey.csv"), &csv)?;
        let text = format!(
            "# H from grey values and from bits\n\n\
             Errors of H, l2 / linf, at equal radius 3 h^(1/2); blur and sigma in voxels, noise \
             where inside and outside differ by 1.\n\n{table}"
        );
        write(&self.output.join("grey.md"), &text)
    }
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| path.display().to_string())
}

impl Scan {
    fn new(spec: &str, gridstep: f64, scanner: Scanner) -> Result<Self> {
        let mut grid = Grid::cubic(gridstep);
        grid.offset = OFFSET;
        let digitisation = Digitisation::new(by_spec(spec)?, grid)?;
        let mut planes = GreyPlanes::new(&digitisation, scanner)?;
        let (mut stored, mut plane) = (Vec::new(), Vec::new());
        while planes.next_plane(&mut plane) {
            for value in &plane {
                let level = (HALF * (0.5 + value)).round() as u16;
                stored.extend_from_slice(&level.to_le_bytes());
            }
        }
        drop(planes);
        Ok(Self {
            digitisation,
            gridstep,
            stored,
        })
    }

    fn trials(&self, sigmas: &[f64]) -> Result<Vec<Trial>> {
        let radius = 3.0 / self.gridstep.sqrt();
        let invariants = Estimator::IntegralInvariant {
            radius,
            orientation: Orientation::Moment,
        };
        let average = Estimator::SurfaceAverage {
            radius: FIRST_RADIUS * radius,
        };
        let averaged = Weights::Compensated(Compensation::Averaged);
        let mut ways = vec![
            ("ii".to_owned(), invariants, Weights::Lumped),
            ("default".to_owned(), average, averaged),
        ];
        for &sigma in sigmas {
            let gradient = Estimator::Gradient { sigma };
            ways.push((format!("gradient_{sigma}vx"), gradient, averaged));
        }
        let mut truth = None;
        ways.into_iter()
            .map(|(name, estimator, weights)| {
                let rows = self.computed(estimator, weights, radius)?;
                let truth = truth.get_or_insert_with(|| self.truth(&rows));
                Ok(self.errors(name, &rows, truth))
            })
            .collect()
    }

    fn computed(
        &self,
        estimator: Estimator,
        weights: Weights,
        radius: f64,
    ) -> Result<Vec<SurfelBatch>> {
        let dims = self.digitisation.dims().map(|n| n as u64);
        let mut settings = Settings::new(Lattice::new(dims, [self.gridstep; 3], false)?);
        settings.estimator = estimator;
        settings.weights = weights;
        settings.radii = vec![radius];
        let inside = Criterion::AtLeast(HALF.into());
        rows_of(&self.stored, VoxelType::U16, inside, &settings)
    }

    /// The geometry of the true surface closest to each row; `None` farther than two voxels away.
    fn truth(&self, rows: &[SurfelBatch]) -> Vec<Option<SurfaceTruth>> {
        let places: Vec<DVec3> = rows
            .iter()
            .flat_map(|batch| {
                (0..batch.len()).map(|i| {
                    let k = [0, 1, 2].map(|a| i64::from(batch.k[a][i]));
                    self.digitisation.khalimsky_to_world(k)
                })
            })
            .collect();
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let shape = self.digitisation.shape();
        let near = |p: &DVec3| {
            closest_point(shape, *p)
                .filter(|c| c.signed_distance.abs() <= 2.0 * self.gridstep)
                .map(|c| c.truth)
        };
        std::thread::scope(|scope| {
            let share = places.len().div_ceil(threads).max(1);
            let parts: Vec<_> = places
                .chunks(share)
                .map(|part| scope.spawn(move || part.iter().map(near).collect::<Vec<_>>()))
                .collect();
            let joined = parts.into_iter().map(|part| match part.join() {
                Ok(found) => found,
                Err(panic) => std::panic::resume_unwind(panic),
            });
            joined.flatten().collect()
        })
    }

    fn errors(
        &self,
        normals: String,
        rows: &[SurfelBatch],
        truth: &[Option<SurfaceTruth>],
    ) -> Trial {
        let mut trial = Trial {
            normals,
            surfels: truth.len(),
            left_out: 0,
            opposed: 0,
            degenerate: 0,
            angle: 0.0,
            l2: 0.0,
            linf: 0.0,
        };
        for ((batch, i), truth) in places(rows).zip(truth) {
            let at = &batch.curvatures[0];
            let has = |flag: Flag| at.flags[i] & flag.bit() != 0;
            let Some(truth) = truth.as_ref().filter(|_| !has(Flag::Island)) else {
                trial.left_out += 1;
                continue;
            };
            trial.opposed += usize::from(has(Flag::NormalOpposed));
            trial.degenerate += usize::from(has(Flag::DegenerateNormal));
            let u = DVec3::from_array([0, 1, 2].map(|a| f64::from(batch.normal[a][i])));
            trial.angle += u.angle_between(truth.normal).to_degrees().powi(2);
            let error = (f64::from(at.mean[i]) - truth.mean_curvature).abs();
            trial.l2 += error * error;
            // In total order NaN is the largest; f64::max would hide it.
            if error.total_cmp(&trial.linf).is_gt() {
                trial.linf = error;
            }
        }
        let count = (trial.surfels - trial.left_out).max(1) as f64;
        trial.angle = (trial.angle / count).sqrt();
        trial.l2 = (trial.l2 / count).sqrt();
        trial
    }
}
