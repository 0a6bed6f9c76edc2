//! Errors and times of the named methods on shapes of known curvature.
//!
//! Each shape is digitised at several gridsteps h, with its axes along the grid and in general positions
//! ([`crate::moved`]), with and without noise of the paper's section 6.1.6 or box voxels; each method is run with
//! the paper's radius 3 h^(1/2). Errors are taken at the closest point of the true surface, over the surfels
//! within two voxels of it that are on no island, as specks that the noise puts elsewhere have no true curvature, and that have a
//! value with every method.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use curvox::lattice::Lattice;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{Access, NamedMethod, Progress, Settings, Source, run};
use curvox::shape::{
    BoxedShape, Digitisation, Grid, Noise, NoisyPlanes, SurfaceTruth, by_spec, closest_point,
};
use curvox::sink::{Flag, SurfelBatch};
use curvox::volume::{Binarizer, Criterion};
use curvox_formats::{DType, OpenOptions, RawLayout, Unit, VoxelType, open_stream};
use glam::DVec3;

use crate::grey::Rows;
use crate::moved::Moved;

/// The shapes, the last two of which were not looked at while the methods were made.
const SHAPES: [&str; 7] = [
    "sphere",
    "ellipsoid90",
    "torus",
    "goursat",
    "rcube",
    "leopold",
    "ellipsoid:a=10,b=7,c=3",
];

/// Methods by name, and whether their normals are turned away from the solid instead of by DGtal's rule. The first is what the
/// last two are compared with; the second is it without the normals that DGtal's rule reverses.
const METHODS: [(&str, NamedMethod, bool); 4] = [
    ("paper", NamedMethod::Paper, false),
    ("paper, oriented", NamedMethod::Paper, true),
    ("default", NamedMethod::Default, false),
    ("refined", NamedMethod::Refined, false),
];

/// The methods that are compared.
const COMPARED: std::ops::Range<usize> = 2..4;

const QUANTITIES: [&str; 4] = ["H", "G", "k1", "k2"];

/// Options of `methods`.
#[derive(Args, Clone, Debug)]
pub struct MethodsArgs {
    /// Directory to write methods.csv and tables.md to
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,

    /// Gridsteps
    #[arg(long, value_delimiter = ',', default_value = "1,0.5,0.25,0.125")]
    gridsteps: Vec<f64>,

    /// Positions: 0 is that of the lattice, other numbers are general ones
    #[arg(long, value_delimiter = ',', default_value = "0,1,2")]
    positions: Vec<u64>,

    /// Probabilities of the noise, each with the coarser gridsteps at position 1
    #[arg(long, value_delimiter = ',', default_value = "0.1,0.3,0.5")]
    noise: Vec<f64>,
}

/// A digitised shape and how it was made.
struct Case {
    shape: &'static str,
    gridstep: f64,
    position: u64,
    noise: f64,
    flat: bool,
    digitisation: Digitisation<Moved<BoxedShape>>,
    stored: Vec<u8>,
}

/// A table: its title, and for each shape and gridstep the trials.
struct Section {
    title: String,
    rows: Vec<(String, Vec<Trial>)>,
}

/// What a method gave on a case.
struct Trial {
    surfels: usize,
    left_out: usize,
    /// l2 and linf of each quantity.
    errors: [[f64; 2]; 4],
    microseconds: f64,
}

impl MethodsArgs {
    /// Makes the study and writes it.
    ///
    /// # Errors
    /// If a gridstep or noise cannot be used, or the files cannot be written.
    pub fn run(self) -> Result<()> {
        fs::create_dir_all(&self.output).with_context(|| self.output.display().to_string())?;
        let mut csv = String::from(
            "shape,gridstep,position,noise,spacing,method,surfels,left_out,H_l2,H_linf,G_l2,G_linf,\
             k1_l2,k1_linf,k2_l2,k2_linf,microseconds\n",
        );
        let mut sections: Vec<Section> = Vec::new();
        let coarse: Vec<f64> = (self.gridsteps.iter().copied())
            .filter(|h| (0.4..0.8).contains(h))
            .collect();
        let mut plan: Vec<(String, Vec<f64>, u64, f64, bool)> = Vec::new();
        for &position in &self.positions {
            let title = if position == 0 {
                "Axes along the grid".to_owned()
            } else {
                format!("General position {position}")
            };
            plan.push((title, self.gridsteps.clone(), position, 0.0, false));
        }
        for &noise in &self.noise {
            let title = format!("Noise p = {noise}, general position");
            plan.push((title, coarse.clone(), 1, noise, false));
        }
        let title = "Voxels 1 x 1 x 2 of the same volume, general position".to_owned();
        plan.push((title, coarse, 1, 0.0, true));
        for (title, gridsteps, position, noise, flat) in plan {
            let mut rows = Vec::new();
            for shape in SHAPES {
                for &gridstep in &gridsteps {
                    let case = Case::new(shape, gridstep, position, noise, flat)?;
                    let trials = case.trials(&mut csv)?;
                    rows.push((format!("{shape} | {gridstep}"), trials));
                }
            }
            sections.push(Section { title, rows });
            write(&self.output.join("methods.csv"), &csv)?;
            write(&self.output.join("tables.md"), &page(&sections))?;
        }
        Ok(())
    }
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| path.display().to_string())
}

impl Case {
    fn new(
        shape: &'static str,
        gridstep: f64,
        position: u64,
        noise: f64,
        flat: bool,
    ) -> Result<Self> {
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
            shape,
            gridstep,
            position,
            noise,
            flat,
            digitisation,
            stored,
        })
    }

    fn trials(&self, csv: &mut String) -> Result<Vec<Trial>> {
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
            let mut trial = errors(&rows, &truth);
            trial.microseconds = seconds * 1e6 / trial.surfels.max(1) as f64;
            let spacing = if self.flat { "1x1x2" } else { "1x1x1" };
            let _ = write!(
                csv,
                "\"{}\",{},{},{},{spacing},\"{name}\",{},{}",
                self.shape, self.gridstep, self.position, self.noise, trial.surfels, trial.left_out
            );
            for error in trial.errors.iter().flatten() {
                let _ = write!(csv, ",{error:.6}");
            }
            let _ = writeln!(csv, ",{:.2}", trial.microseconds);
            trials.push(trial);
        }
        Ok(trials)
    }

    /// The rows of a method, on one thread, and the seconds of the whole run.
    fn computed(&self, method: NamedMethod, oriented: bool) -> Result<(Vec<SurfelBatch>, f64)> {
        let dims = self.digitisation.dims().map(|n| n as u64);
        let options = OpenOptions {
            raw: Some(RawLayout {
                dims,
                dtype: DType::little(VoxelType::U8),
                spacing: None,
                unit: Unit::Unknown,
                skip: 0,
            }),
            ..Default::default()
        };
        let bytes = std::io::Cursor::new(self.stored.clone());
        let volume = open_stream(Box::new(bytes), "shape", &options)?;
        let header = &volume.header;
        let spacing = self.digitisation.spacing().to_array();
        let lattice = Lattice::new(dims, spacing, false)?;
        let radius = 3.0 * self.gridstep.sqrt() / lattice.voxel_unit_world();
        let mut settings = Settings::new(lattice).with_method(method, radius);
        if oriented {
            settings.estimator = Estimator::IntegralInvariant {
                radius,
                orientation: Orientation::Moment,
            };
        }
        settings.threads = 1;
        settings.memory_bytes = 4 << 30;
        let criterion = Criterion::AtLeast(1i128.into());
        let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, None);
        let plan = settings.plan(&Access::forward(1), 0)?;
        let mut rows = Rows::default();
        let started = Instant::now();
        run(
            Source { volume, binarizer },
            &settings,
            &plan,
            &mut [&mut rows],
            &Progress::default(),
            &AtomicBool::new(false),
        )?;
        Ok((rows.0, started.elapsed().as_secs_f64()))
    }

    /// The true surface closest to each row; `None` farther than two voxels away.
    fn truth(&self, rows: &[SurfelBatch]) -> Vec<Option<SurfaceTruth>> {
        let far = 2.0 * self.digitisation.spacing().max_element();
        let places = rows.iter().flat_map(|b| (0..b.len()).map(move |i| (b, i)));
        let near = places.map(|(batch, i)| {
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

fn errors(rows: &[SurfelBatch], truth: &[Option<SurfaceTruth>]) -> Trial {
    let mut trial = Trial {
        surfels: truth.len(),
        left_out: 0,
        errors: [[0.0; 2]; 4],
        microseconds: 0.0,
    };
    let places = rows.iter().flat_map(|b| (0..b.len()).map(move |i| (b, i)));
    for ((batch, i), truth) in places.zip(truth) {
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

/// The tables: errors of the first method, and of the compared ones as ratios to it.
fn page(sections: &[Section]) -> String {
    let mut page = String::from(
        "# Errors of the methods\n\n\
         Made by `cargo run --release -p curvox-tools -- methods -o docs/accuracy`. Of `paper` errors l2 / linf; of the \
         others their ratios to these, and the ratio of times (the whole run, one thread). Radius 3 h^(1/2). A ratio above 1 is worse. \
         *Oriented* is the paper's method with its normals turned away from the solid; DGtal's rule reverses some of them, which ruins G.\n",
    );
    for Section { title, rows } in sections {
        let _ = writeln!(page, "\n## {title}\n");
        let heads: Vec<String> = (QUANTITIES.iter())
            .map(|q| format!("paper {q} | default | refined"))
            .collect();
        let _ = writeln!(page, "| shape | h | {} | time |", heads.join(" | "));
        let _ = writeln!(page, "|---|---|{}", "---|".repeat(3 * QUANTITIES.len() + 1));
        for (name, trials) in rows {
            let _ = write!(page, "| {name} |");
            for q in 0..QUANTITIES.len() {
                let [l2, linf] = trials[0].errors[q];
                let _ = write!(page, " {l2:.4} / {linf:.3} |");
                for trial in &trials[COMPARED] {
                    let [a, b] = trial.errors[q];
                    let _ = write!(page, " {:.2} / {:.2} |", a / l2, b / linf);
                }
            }
            let times = trials[COMPARED]
                .iter()
                .map(|t| format!("{:.2}", t.microseconds / trials[0].microseconds));
            let _ = writeln!(page, " {} |", times.collect::<Vec<_>>().join(" / "));
        }
        let _ = writeln!(page);
        for (to, of) in [(0, "`paper`"), (1, "the same, oriented")] {
            for m in COMPARED {
                let ratios = |quantities: usize| -> Vec<f64> {
                    let pairs = rows.iter().flat_map(|(_, trials)| {
                        let errors = |i: usize| trials[i].errors[..quantities].iter().flatten();
                        errors(m)
                            .zip(errors(to))
                            .map(|(a, b)| a / b)
                            .collect::<Vec<_>>()
                    });
                    pairs.collect()
                };
                let (all, of_h_and_g) = (ratios(4), ratios(2));
                let _ = writeln!(
                    page,
                    "- **{}** to {of}: geometric mean of all ratios {:.3}, largest {:.2}, above 1.05 {} of {}; of H and G {:.3}, \
                     largest {:.2}, above 1/2 {} of {}.",
                    METHODS[m].0,
                    geometric_mean(&all),
                    largest(&all),
                    above(&all, 1.05),
                    all.len(),
                    geometric_mean(&of_h_and_g),
                    largest(&of_h_and_g),
                    above(&of_h_and_g, 0.5),
                    of_h_and_g.len(),
                );
            }
        }
    }
    page
}

fn geometric_mean(ratios: &[f64]) -> f64 {
    let logarithms: f64 = ratios.iter().map(|&x| libm::log(x)).sum();
    libm::exp(logarithms / ratios.len().max(1) as f64)
}

fn largest(ratios: &[f64]) -> f64 {
    ratios
        .iter()
        .copied()
        .fold(0.0, |a, b| if b.total_cmp(&a).is_gt() { b } else { a })
}

fn above(ratios: &[f64], limit: f64) -> usize {
    // in total order what is no number is above
    ratios
        .iter()
        .filter(|x| x.total_cmp(&limit).is_gt())
        .count()
}
