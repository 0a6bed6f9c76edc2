//! Errors and times of the named methods on shapes of known curvature.
//!
//! Each shape is digitised at several gridsteps h, with its axes along the grid and in general positions
//! ([`crate::moved`]), with and without noise of the paper's section 6.1.6 or box voxels; each method is run with
//! the paper's radius 3 h^(1/2). Errors are taken at the closest point of the true surface, over the surfels
//! within two voxels of it that are on no island, as specks that the noise puts elsewhere have no true curvature, and that have a
//! value with every method.
//!
//! Beside the errors of each case: how they compare with the error bars (`bars`), how they vary with the position of the grid, and how far a
//! voxel is felt (`beyond`).

mod bars;
mod beyond;
mod case;
mod plots;
mod tables;

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use curvox::pipeline::NamedMethod;

use bars::Calibration;
use case::{Case, Task};
use tables::{Row, Section};

/// The shapes.
const SHAPES: [&str; 9] = [
    "sphere",
    "ellipsoid90",
    "torus",
    "goursat",
    "rcube",
    "leopold",
    "ellipsoid:a=10,b=7,c=3",
    "torus:major=7,minor=3.5",
    "ellipsoid:a=10,b=8,c=6",
];

/// Gridsteps below take minutes a case, and are for one shape.
const FINE: f64 = 0.1;

/// That shape.
const FINEST: &str = "goursat";

/// How many of the shapes were looked at while the methods and their error bars were made.
const LOOKED_AT: usize = 5;

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
    /// Directory to write methods.csv, tables.md and the plots to
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,

    /// Gridsteps; those below 0.1 for Goursat's surface at the second position only
    #[arg(long, value_delimiter = ',', default_value = "1,0.5,0.25,0.125,0.0625")]
    gridsteps: Vec<f64>,

    /// Positions: 0 is that of the lattice, other numbers are general ones
    #[arg(long, value_delimiter = ',', default_value = "0,1")]
    positions: Vec<u64>,

    /// Probabilities of the noise, each with the gridsteps 1 and 1/2 at position 1
    #[arg(long, value_delimiter = ',', default_value = "0.1,0.3,0.5")]
    noise: Vec<f64>,
}

impl MethodsArgs {
    /// Makes the study and writes it.
    ///
    /// # Errors
    /// If a gridstep or noise cannot be used, or the files cannot be written.
    pub fn run(self) -> Result<()> {
        fs::create_dir_all(&self.output).with_context(|| self.output.display().to_string())?;
        let mut csv = String::from(
            "shape,gridstep,position,noise,spacing,radius,method,surfels,left_out,H_l2,H_linf,G_l2,G_linf,\
             k1_l2,k1_linf,k2_l2,k2_linf,resolved,H_within_1,H_within_2,G_within_1,G_within_2,microseconds\n",
        );
        let mut sections: Vec<Section> = Vec::new();
        let mut calibration = Calibration::default();
        for (title, tasks) in self.plan() {
            let mut rows = Vec::new();
            for task in tasks {
                let name = format!("{} | {}", task.shape, task.gridstep);
                let trials = Case::new(task)?.trials(&mut csv)?;
                calibration.add(&task, &trials);
                rows.push(Row { task, name, trials });
            }
            sections.push(Section { title, rows });
            self.write("methods.csv", &csv)?;
            self.write("tables.md", &tables::page(&sections))?;
        }
        let mut page = tables::page(&sections) + &calibration.table();
        self.write("bars.svg", &calibration.plot()?)?;
        for shape in plots::SHAPES {
            let name = format!("{}.svg", shape.replace([':', '=', ','], "-"));
            self.write(&name, &plots::errors(shape, &sections)?)?;
        }
        page += &beyond::positions(&mut csv)?;
        page += &beyond::reach()?;
        self.write("methods.csv", &csv)?;
        self.write("tables.md", &page)
    }

    /// The sections, with what is digitised for each.
    fn plan(&self) -> Vec<(String, Vec<Task>)> {
        let mut plan = Vec::new();
        let mut add = |title: String, gridsteps: &[f64], task: &dyn Fn(Task) -> Task| {
            let tasks = SHAPES.into_iter().flat_map(|shape| {
                let gridsteps = gridsteps
                    .iter()
                    .filter(move |&&h| h > FINE || shape == FINEST);
                gridsteps.map(move |&gridstep| Task {
                    shape,
                    gridstep,
                    position: 1,
                    noise: 0.0,
                    flat: false,
                    radius: None,
                })
            });
            plan.push((title, tasks.map(task).collect()));
        };
        for (i, &position) in self.positions.iter().enumerate() {
            let fine = |h: &f64| *h > FINE || i == 1;
            let gridsteps: Vec<f64> = self.gridsteps.iter().copied().filter(fine).collect();
            let title = if position == 0 {
                "Axes along the grid".to_owned()
            } else {
                format!("General position {position}")
            };
            add(title, &gridsteps, &|task| Task { position, ..task });
        }
        let title = "Radius of 6 voxels at every gridstep, general position".to_owned();
        add(title, &[1.0, 0.5, 0.25], &|task| Task {
            radius: Some(6.0),
            ..task
        });
        for &noise in &self.noise {
            let title = format!("Noise p = {noise}, general position");
            add(title, &[1.0, 0.5], &|task| Task { noise, ..task });
        }
        let title = "Voxels 1 x 1 x 2 of the same volume, general position".to_owned();
        add(title, &[0.5], &|task| Task { flat: true, ..task });
        plan
    }

    fn write(&self, name: &str, text: &str) -> Result<()> {
        let path = self.output.join(name);
        fs::write(&path, text).with_context(|| path.display().to_string())
    }
}
