//! `curvox completions` and `curvox man`: what goes with the binary.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, Command};
use clap_complete::Shell;
use clap_mangen::Man;

use crate::sink::SinkError;

use super::exit;

/// Arguments of `curvox completions`.
#[derive(Args, Clone, Debug)]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Arguments of `curvox man`.
#[derive(Args, Clone, Debug)]
pub(crate) struct ManArgs {
    /// Write a page for each subcommand into this directory, instead of the main page to standard
    /// output
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Prints the completions of a shell.
pub(crate) fn completions(args: &CompletionsArgs, mut command: Command) -> Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "curvox", &mut text);
    exit::print(&String::from_utf8_lossy(&text))
}

/// Prints the manual, or writes its pages.
pub(crate) fn man(args: &ManArgs, mut command: Command) -> Result<()> {
    command.build();
    match &args.out {
        None => exit::print(&page(command, Path::new("standard output"))?),
        Some(directory) => {
            std::fs::create_dir_all(directory)
                .map_err(|error| SinkError::io(directory, "create the directory", error))?;
            pages(&command, directory)
        }
    }
}

fn pages(command: &Command, directory: &Path) -> Result<()> {
    let name = command.get_display_name().unwrap_or(command.get_name());
    let path = directory.join(format!("{name}.1"));
    std::fs::write(&path, page(command.clone(), &path)?)
        .map_err(|error| SinkError::io(&path, "write", error))?;
    let below = command.get_subcommands().filter(|c| !c.is_hide_set());
    below
        .filter(|c| c.get_name() != "help")
        .try_for_each(|c| pages(c, directory))
}

fn page(command: Command, path: &Path) -> Result<String, SinkError> {
    let mut text = Vec::new();
    Man::new(command)
        .render(&mut text)
        .map_err(|error| SinkError::io(path, "write", error))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}
