//! The command line: arguments, exit codes, progress, reports. Nothing numerical.
//!
//! Comes in: the arguments of the process. Goes out: an exit code; results where `-o` says,
//! messages on standard error. One file for each subcommand; what they share: `input`, `method`,
//! `output` (options), `job` (a run made ready), `lengths` and `sizes` (what is typed),
//! `conventions` (what is said), `exit`, `signals`, `progress`, `report`, `stats`.

mod conventions;
mod exit;
mod formats;
mod generate;
mod info;
mod input;
mod job;
mod lengths;
mod mesh;
mod method;
mod noise;
mod output;
mod plan;
mod progress;
mod report;
mod run;
mod scale;
mod shape;
mod signals;
mod sizes;
mod stats;
mod values;
mod volume_output;

use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::{ArgAction, CommandFactory, Parser, Subcommand};
use serde_json::json;

use crate::error::Error;

/// Arguments of the process.
#[derive(Parser, Debug)]
#[command(
    name = "curvox",
    version,
    about = "Corrected curvature of the boundary of what is in a 3D image, of any size",
    long_about = conventions::LONG_ABOUT,
    after_help = conventions::EXIT_HELP,
    after_long_help = conventions::long_help(conventions::EXAMPLES),
    arg_required_else_help = true,
    max_term_width = 100
)]
struct Cli {
    /// Say more on standard error: -v steps, -vv details
    #[arg(short, long, action = ArgAction::Count, global = true, help_heading = "Messages")]
    verbose: u8,

    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Compute curvatures of the boundary of what is in a volume
    #[command(
        after_help = conventions::EXIT_HELP,
        after_long_help = conventions::long_help(conventions::RUN_EXAMPLES)
    )]
    Run(Box<run::RunArgs>),
    /// Tell what a run would take, without running it: cut, memory, columns, size of the output
    ///
    /// With --radius auto the radius is chosen as a run would choose it, which computes the samples.
    #[command(after_help = conventions::EXIT_HELP)]
    Plan(Box<plan::PlanArgs>),
    /// Tell what a volume or a mesh is, or what a run left
    #[command(after_help = conventions::EXIT_HELP)]
    Info(Box<info::InfoArgs>),
    /// Add the noise of the papers to what is inside a volume: a volume of 0 and 1
    #[command(
        after_help = conventions::EXIT_HELP,
        after_long_help = conventions::long_help(conventions::NOISE_EXAMPLES)
    )]
    Noise(Box<noise::NoiseArgs>),
    /// Digitise a shape of known curvature
    #[command(
        after_help = conventions::EXIT_HELP,
        after_long_help = conventions::long_help(conventions::SHAPE_EXAMPLES)
    )]
    Shape(Box<shape::ShapeArgs>),
    /// Compute curvatures of a mesh: an OBJ, PLY or STL file
    #[command(
        after_help = conventions::EXIT_HELP,
        after_long_help = mesh::long_help()
    )]
    Mesh(Box<mesh::MeshArgs>),
    /// List the formats that are read, and what of each
    #[command(after_help = conventions::EXIT_HELP)]
    Formats(formats::FormatsArgs),
    /// Print completions for a shell
    Completions(generate::CompletionsArgs),
    /// Print the manual, or write its pages
    Man(generate::ManArgs),
}

/// The whole program.
#[must_use]
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Help goes to standard output with code 0, mistakes to standard error with 2.
            let code = if error.use_stderr() {
                exit::USAGE
            } else {
                exit::DONE
            };
            let _ = error.print();
            return ExitCode::from(code);
        }
    };
    log_to_stderr(cli.verbose);
    let json = cli.command.json();
    match signals::stop_flag().and_then(|stop| {
        let result = crate::simd::instructions()
            .map_err(exit::usage)
            .and_then(|level| {
                tracing::debug!(%level, "instructions");
                cli.command.run(cli.verbose > 0, &stop)
            });
        // What fails after Ctrl-C fails because of it: the rest of a pipeline has ended too.
        match result {
            Err(_) if stop.load(Ordering::Relaxed) => Err(Error::Stopped.into()),
            other => other,
        }
    }) {
        Ok(()) => ExitCode::from(exit::DONE),
        Err(error) => {
            let code = exit::code(&error);
            if code != exit::DONE {
                let text = if json {
                    json!({"event": "error", "code": code, "message": exit::message(&error)})
                        .to_string()
                } else {
                    format!("curvox: {}", exit::message(&error))
                };
                // Nobody may be reading; the code says it all the same.
                let _ = writeln!(std::io::stderr(), "{text}");
            }
            ExitCode::from(code)
        }
    }
}

impl Command {
    /// Whether messages are to be JSON.
    fn json(&self) -> bool {
        match self {
            Command::Run(args) => args.job.output.json,
            Command::Plan(args) => args.job.output.json,
            Command::Info(args) => args.json,
            Command::Formats(args) => args.json,
            Command::Mesh(args) => args.json,
            Command::Noise(_) | Command::Shape(_) | Command::Completions(_) | Command::Man(_) => {
                false
            }
        }
    }

    fn run(&self, verbose: bool, stop: &AtomicBool) -> anyhow::Result<()> {
        match self {
            Command::Run(args) => run::run(args, verbose, stop),
            Command::Plan(args) => plan::run(args, stop),
            Command::Info(args) => info::run(args, stop),
            Command::Formats(args) => formats::run(args),
            Command::Noise(args) => noise::run(args, stop),
            Command::Shape(args) => shape::run(args, stop),
            Command::Mesh(args) => mesh::run(args, verbose, stop),
            Command::Completions(args) => generate::completions(args, Cli::command()),
            Command::Man(args) => generate::man(args, Cli::command()),
        }
    }
}

fn log_to_stderr(verbose: u8) {
    let level = match verbose {
        0 => return,
        1 => tracing::Level::INFO,
        _ => tracing::Level::DEBUG,
    };
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .with_max_level(level)
        .init();
}
