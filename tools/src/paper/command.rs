//! `curvox-tools paper`.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use clap::Args;

use super::page::{self, Section};
use super::runs::{Run, Runner};
use super::study::{Results, Study, Volume, run_all};
use super::{convergence, directions, fields, noise, pictures, rates, shapes, stability, times};

/// The finest gridstep of a quick run.
const QUICK: f64 = 0.25;

/// The figure that shows the time of runs.
const TIMED: u32 = 19;

/// A group of runs, and what is made of them.
struct Figure {
    /// Numbers in the paper; none beyond it.
    numbers: &'static [u32],
    runs: fn(&Study) -> Vec<Run>,
    section: fn(&Study, &Results) -> Result<Section>,
}

const FIGURES: &[Figure] = &[
    Figure {
        numbers: &[4],
        runs: convergence::lipschitz_runs,
        section: convergence::lipschitz,
    },
    Figure {
        numbers: &[5],
        runs: convergence::exponents_runs,
        section: convergence::exponents_mean,
    },
    Figure {
        numbers: &[6],
        runs: convergence::exponents_runs,
        section: convergence::exponents_gaussian,
    },
    Figure {
        numbers: &[8],
        runs: convergence::comparison_runs,
        section: convergence::comparison_mean,
    },
    Figure {
        numbers: &[9],
        runs: pictures::accuracy_runs,
        section: pictures::accuracy_mean,
    },
    Figure {
        numbers: &[10],
        runs: stability::runs,
        section: stability::section,
    },
    Figure {
        numbers: &[11],
        runs: pictures::first_runs,
        section: pictures::first_mean,
    },
    Figure {
        numbers: &[12],
        runs: pictures::second_runs,
        section: pictures::second_mean,
    },
    Figure {
        numbers: &[13],
        runs: noise::picture_runs,
        section: noise::pictures_mean,
    },
    Figure {
        numbers: &[14],
        runs: convergence::comparison_runs,
        section: convergence::comparison_gaussian,
    },
    Figure {
        numbers: &[8, 14],
        runs: convergence::comparison_runs,
        section: rates::section,
    },
    Figure {
        numbers: &[15],
        runs: pictures::accuracy_runs,
        section: pictures::accuracy_gaussian,
    },
    Figure {
        numbers: &[16],
        runs: pictures::first_runs,
        section: pictures::first_gaussian,
    },
    Figure {
        numbers: &[17],
        runs: pictures::second_runs,
        section: pictures::second_gaussian,
    },
    Figure {
        numbers: &[18],
        runs: noise::picture_runs,
        section: noise::pictures_gaussian,
    },
    Figure {
        numbers: &[19],
        runs: times::runs,
        section: times::section,
    },
    Figure {
        numbers: &[20],
        runs: directions::runs,
        section: directions::section,
    },
    Figure {
        numbers: &[],
        runs: shapes::runs,
        section: shapes::section,
    },
    Figure {
        numbers: &[],
        runs: fields::runs,
        section: fields::section,
    },
    Figure {
        numbers: &[],
        runs: noise::error_runs,
        section: noise::errors,
    },
];

/// Options of `paper`.
#[derive(Args, Clone, Debug)]
pub struct PaperArgs {
    /// The folder for the page README.md, the figures and their numbers
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,

    /// The folder for the runs: those already there are not repeated; it takes gigabytes for fine
    /// gridsteps, and may be removed [default: runs in that of the page]
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,

    /// A figure of the paper, by its number; several times for several [default: all, and more]
    #[arg(long, value_name = "N")]
    figure: Vec<u32>,

    /// The finest gridstep: from 1, halved until there [default: 0.03125, with --quick 0.25]
    #[arg(long, value_name = "H")]
    finest: Option<f64>,

    /// A volume to picture, voxels >= 1 inside, and the gridstep its radii follow from; several times
    /// for several. A name that begins with octaflower goes to figures 12, 13, 17, 18, any other to
    /// 11 and 16 [default: shapes of curvox]
    #[arg(long, value_name = "NAME=PATH:H")]
    volume: Vec<Volume>,

    /// Less of everything, for a first look
    #[arg(long)]
    quick: bool,

    /// Runs at a time, one thread each [default: one for each processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
}

impl FromStr for Volume {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("found {text:?}, expected NAME=PATH:H as in dragon=dragon-256.vol:1");
        let (name, rest) = text.split_once('=').ok_or_else(wrong)?;
        let (path, gridstep) = rest.rsplit_once(':').ok_or_else(wrong)?;
        let gridstep: f64 = gridstep.parse().map_err(|_| wrong())?;
        if name.is_empty() || path.is_empty() || !(gridstep > 0.0 && gridstep.is_finite()) {
            return Err(wrong());
        }
        Ok(Volume {
            name: name.to_owned(),
            path: PathBuf::from(path),
            gridstep,
        })
    }
}

impl PaperArgs {
    /// Makes the runs, the figures and the page.
    ///
    /// # Errors
    /// If an option does not fit, a run fails, or a file cannot be written.
    pub fn run(self) -> Result<()> {
        let started = Instant::now();
        let finest = self
            .finest
            .unwrap_or(if self.quick { QUICK } else { 0.03125 });
        ensure!(
            (1e-3..=1.0).contains(&finest),
            "finest gridstep: found {finest}, expected 0.001 to 1"
        );
        let known: Vec<u32> = FIGURES.iter().flat_map(|f| f.numbers).copied().collect();
        for number in &self.figure {
            ensure!(
                known.contains(number),
                "figure: found {number}, expected one of {known:?}"
            );
        }
        for volume in &self.volume {
            let path = volume.path.display();
            ensure!(
                volume.path.is_file(),
                "{path}: expected a volume, found no file"
            );
        }
        let chosen: Vec<&Figure> = FIGURES
            .iter()
            .filter(|figure| {
                self.figure.is_empty() || figure.numbers.iter().any(|n| self.figure.contains(n))
            })
            .collect();
        let study = Study {
            finest,
            quick: self.quick,
            volumes: self.volume,
            folder: self.output,
        };
        let runs = self.runs.unwrap_or_else(|| study.folder.join("runs"));
        let runner = Runner::new(runs)?;
        std::fs::create_dir_all(&study.folder)
            .with_context(|| study.folder.display().to_string())?;
        let workers = match self.jobs {
            Some(jobs) => jobs.into(),
            None => std::thread::available_parallelism().map_or(1, usize::from),
        };
        let wanted = chosen
            .iter()
            .flat_map(|figure| (figure.runs)(&study))
            .collect();
        let timed = chosen.iter().any(|f| f.numbers.contains(&TIMED));
        let alone = if timed {
            times::runs(&study)
        } else {
            Vec::new()
        };
        let results = run_all(&runner, &alone, wanted, workers)?;
        let mut sections = Vec::new();
        for figure in chosen {
            let section = (figure.section)(&study, &results)?;
            let elapsed = started.elapsed().as_secs_f64();
            eprintln!("[{elapsed:7.1} s] {}", section.title);
            sections.push(section);
        }
        let introduction = introduction(&study, &runner, &results)?;
        let text = page::markdown(&introduction, &sections);
        page::write(&study.folder, "README.md", text)?;
        eprintln!(
            "[{:7.1} s] {}",
            started.elapsed().as_secs_f64(),
            study.folder.join("README.md").display()
        );
        Ok(())
    }
}

/// The options that the page depends on, as typed.
fn said(study: &Study) -> String {
    let quick = if study.quick { " --quick" } else { "" };
    let volumes = if study.volumes.is_empty() {
        ""
    } else {
        " --volume ..."
    };
    format!("{quick} --finest {}{volumes}", study.finest)
}

fn introduction(study: &Study, runner: &Runner, results: &Results) -> Result<String> {
    let mut text = String::new();
    let version = runner.identity().rsplit_once(' ').context("a version")?.0;
    write!(
        text,
        "J.-O. Lachaud, P. Romon, B. Thibert: *Corrected curvature measures*, Discrete & Computational \
         Geometry, 2022, sections 5 and 6, repeated with {version}. Figures have the numbers of the paper. \
         {} runs of the command, each on one thread, gridsteps from 1 to {}.\n\n\
         Unless said otherwise the shape is Goursat's surface 4 - 0.015 (x^4 + y^4 + z^4) + x^2 + y^2 + z^2 = 0, \
         normals u and measures have the radii r = rho = 3 h^(1/2) of section 6.1, errors are over all surfels \
         against the curvature at the exact closest point of the surface, l2 is the root of the mean square and \
         linf the largest. Slopes are exponents of h fitted by least squares in logarithms, over all gridsteps and over the last \
         three. DGtal is the library of the paper's authors (2.1.1, development head of June 2026), measured on \
         the same voxels at the same radii; `ratio` is curvox's error over DGtal's. *plain II* are digital \
         integral invariants without measures.\n\n\
         Rows `paper ...` are `--method paper`, the choices of the paper's authors in DGtal; the others share \
         linels and pointels out to surfels (`--weights lumped`) and orient normals away from the solid. curvox's own methods \
         are in `docs/accuracy`. Runs that would take minutes end at h = 1/16.\n\n\
         Made by `cargo run --release -p curvox-tools -- paper -o docs/paper --runs target/paper{}`, on {}.\n",
        results.count(),
        page::gridstep(study.finest),
        said(study),
        std::env::consts::ARCH,
    )?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn volumes_are_a_name_a_path_and_a_gridstep() {
        let volume: Volume = "dragon=a:b/dragon.vol:0.5".parse().unwrap();
        assert_eq!(volume.path, PathBuf::from("a:b/dragon.vol"));
        assert_eq!((volume.name.as_str(), volume.gridstep), ("dragon", 0.5));
        for wrong in ["", "dragon", "dragon=x", "=x:1", "d=x:0", "d=x:inf", "d=:1"] {
            assert!(wrong.parse::<Volume>().is_err(), "{wrong}");
        }
    }
}
