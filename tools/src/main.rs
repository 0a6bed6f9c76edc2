//! Experiments around curvox, on the command line.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Parser, Subcommand};

use curvox_tools::accuracy::KnownShape;
use curvox_tools::agreement::{self, Comparison};
use curvox_tools::formats::FormatsArgs;
use curvox_tools::grey::GreyArgs;
use curvox_tools::meshes::MeshCommand;
use curvox_tools::methods::MethodsArgs;
use curvox_tools::npz::Table;
use curvox_tools::paper::PaperArgs;
use curvox_tools::picture::PictureArgs;
use curvox_tools::speed::SpeedArgs;
use curvox_tools::{goursat, vol};

#[derive(Parser)]
#[command(about = "Experiments around curvox", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Compare the plain reference with DGtal's numbers, row by row
    Reference {
        /// Folder of goursat_h1.npz, goursat_h0.5.npz, ...
        reference: PathBuf,
        /// Gridsteps of the Goursat tables to compare with
        #[arg(long, value_delimiter = ',', default_value = "1,0.5,0.25")]
        gridsteps: Vec<f64>,
        /// The volume of dragon128_h1.npz, to compare with that too
        #[arg(long)]
        dragon: Option<PathBuf>,
    },
    /// Errors of every choice of normals, weights and ball on shapes of known curvature
    Errors {
        /// Folder of goursat_h1.npz, goursat_h0.5.npz, ...
        reference: PathBuf,
        /// Gridsteps of the Goursat tables
        #[arg(long, value_delimiter = ',', default_value = "1,0.5,0.25")]
        gridsteps: Vec<f64>,
    },
    #[command(flatten)]
    Mesh(MeshCommand),
    /// Draw what a run left as a PNG file: its surfels, or one of its slices
    Picture(PictureArgs),
    /// Repeat the experiments of the paper with the curvox command: figures, numbers, one page
    Paper(PaperArgs),
    /// Errors of H with normals from grey values and from bits, on images such as scanners give
    Grey(GreyArgs),
    /// Errors and times of the named methods on shapes of known curvature, in any position, with noise
    Methods(MethodsArgs),
    /// Read every file of a folder of test data and write a page on what became of each
    Formats(FormatsArgs),
    /// Processor time a surfel of whole runs in memory, beside plain walks over the surface
    Speed(SpeedArgs),
}

fn main() -> Result<()> {
    match Arguments::parse().command {
        Command::Reference {
            reference,
            gridsteps,
            dragon,
        } => {
            for gridstep in gridsteps {
                let name = format!("goursat_h{gridstep}.npz");
                let table = Table::read(&reference.join(&name))?;
                let (solid, origin) = goursat::digitised(gridstep);
                print_comparisons(
                    &name,
                    &agreement::compare(&solid, gridstep, 2 * origin, &table)?,
                );
            }
            if let Some(path) = dragon {
                let name = "dragon128_h1.npz";
                let table = Table::read(&reference.join(name))?;
                // The file's first voxel has coordinate -1.
                print_comparisons(
                    name,
                    &agreement::compare(&vol::read(&path)?, 1.0, 2, &table)?,
                );
            }
        }
        Command::Picture(arguments) => arguments.run()?,
        Command::Mesh(command) => command.run()?,
        Command::Paper(arguments) => arguments.run()?,
        Command::Grey(arguments) => arguments.run()?,
        Command::Methods(arguments) => arguments.run()?,
        Command::Formats(arguments) => arguments.run()?,
        Command::Speed(arguments) => arguments.run()?,
        Command::Errors {
            reference,
            gridsteps,
        } => {
            println!(
                "| shape | h | normals | weights | ball | H l2 / linf | G | k1 | k2 | us normals + sums |"
            );
            println!("|---|---|---|---|---|---|---|---|---|---|");
            for gridstep in gridsteps {
                print_trials("goursat", &KnownShape::goursat(&reference, gridstep)?);
                print_trials("torus", &KnownShape::torus(gridstep));
                print_trials("shell", &KnownShape::shell(gridstep));
            }
        }
    }
    Ok(())
}

fn print_trials(name: &str, shape: &KnownShape) {
    for trial in shape.trials() {
        print!(
            "| {name} | {} | {} | {:?} | {:?} |",
            shape.gridstep, trial.normals, trial.weights, trial.ball
        );
        for e in trial.errors {
            print!(" {:.5} / {:.5} |", e.l2, e.linf);
        }
        println!(
            " {:.1} + {:.1} |",
            trial.microseconds[0], trial.microseconds[1]
        );
    }
}

fn print_comparisons(name: &str, comparisons: &[Comparison]) {
    for comparison in comparisons {
        println!("\n{name}, {}", comparison.name);
        println!(
            "| column | bound | as DGtal: largest | beyond | with a cause: differ | agree | without: differ | agree | largest |"
        );
        println!("|---|---|---|---|---|---|---|---|---|");
        for column in &comparison.columns {
            let (emulated, caused, clean) = (&column.emulated, &column.caused, &column.clean);
            println!(
                "| {} | {:.0e} | {:.1e} | {} of {} | {} | {} | {} | {} | {:.1e} |",
                column.name,
                column.bound,
                emulated.largest,
                emulated.beyond,
                emulated.rows,
                caused.beyond,
                caused.rows - caused.beyond,
                clean.beyond,
                clean.rows - clean.beyond,
                clean.largest
            );
        }
        println!("| cause | cells | rows with it | of them differ | and have no other |");
        println!("|---|---|---|---|---|");
        for t in &comparison.tallies {
            println!(
                "| {:?} | {} | {} | {} | {} |",
                t.cause, t.cells, t.rows, t.differ, t.differ_alone
            );
        }
        println!(
            "normals of opposite sign {}; rows whose fans cancel {}; largest difference of mu2 at an umbrella, modulo 4 pi: {:.1e}",
            comparison.opposite_normals, comparison.cancelled, comparison.largest_remainder
        );
    }
}
