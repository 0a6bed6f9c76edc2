//! `curvox formats`: what is read.

use std::fmt::Write;

use anyhow::Result;
use clap::Args;
use curvox_formats::{Choices, FormatInfo, formats};
use serde_json::{Value, json};

use super::exit;

/// Arguments of `curvox formats`.
#[derive(Args, Clone, Debug)]
pub(crate) struct FormatsArgs {
    /// Print JSON
    #[arg(long, help_heading = "Messages")]
    pub(crate) json: bool,
}

/// Prints the table.
pub(crate) fn run(args: &FormatsArgs) -> Result<()> {
    if args.json {
        let all: Vec<_> = formats().iter().map(as_json).collect();
        exit::print(&format!("{:#}\n", json!(all)))
    } else {
        exit::print(&as_text())
    }
}

fn as_json(info: &FormatInfo) -> Value {
    json!({
        "format": info.names[0],
        "names": info.names,
        "title": info.title,
        "extensions": info.extensions,
        "variants": info.variants,
        "forward": info.forward,
        "options": options(info.choices),
        "read_by_this_build": info.missing_feature.is_none(),
        "feature": info.missing_feature,
    })
}

/// Options that the format may ask for.
fn options(choices: Choices) -> Vec<&'static str> {
    [
        (choices.dataset, "--dataset"),
        (choices.frame, "--frame"),
        (choices.channel, "--channel"),
        (choices.level, "--level"),
    ]
    .into_iter()
    .filter_map(|(offered, option)| offered.then_some(option))
    .collect()
}

fn as_text() -> String {
    let mut text = String::new();
    for info in formats() {
        // Writing to a string cannot fail.
        let _ = write_one(&mut text, info);
    }
    text.push_str(
        "\nAll are recognised by content. gzip, bzip2 and zstd around a whole file are undone. Those marked \
         'pipe' are read from\nstandard input as they come; others are copied first, to memory or \
         with --spill to disk.\n",
    );
    text
}

fn write_one(out: &mut String, info: &FormatInfo) -> std::fmt::Result {
    let pipe = if info.forward { "pipe" } else { "" };
    writeln!(
        out,
        "{:<10} {:<5} {} ({})",
        info.names[0], pipe, info.title, info.extensions
    )?;
    writeln!(out, "                 {}", info.variants)?;
    let options = options(info.choices);
    if !options.is_empty() {
        writeln!(out, "                 {}", options.join(" "))?;
    }
    if let Some(feature) = info.missing_feature {
        writeln!(
            out,
            "                 not read by this build: cargo install curvox --features {feature}"
        )?;
    }
    Ok(())
}
