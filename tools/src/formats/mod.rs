//! The table of what is read: every file of a folder of test data, and what became of it.
//!
//! In: a folder as `curvox-tools formats` wants it, with `formats/manifest.json`,
//! `hostile/expected.json` and whatever else; what other programs see in the rest
//! (`docs/formats/independent.json`). Out: a page of Markdown with a row a volume. Every file of
//! the folder is in it: as a volume, as a part of one, or as something that is no volume, with
//! what curvox says of it.
//!
//! Voxels are right if their SHA-256 in canonical form (little-endian, x fastest, the type that is
//! stated) is the one expected. Times are medians: all planes read forward, and the same files read
//! with `read(2)`, both from the page cache, per gigabyte of file.

mod list;
mod page;
mod read;

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::Value;

/// Options of the command.
#[derive(Args, Clone, Debug)]
pub struct FormatsArgs {
    /// Folder of test data
    data: PathBuf,

    /// What other programs see in its files
    #[arg(
        long,
        value_name = "JSON",
        default_value = "docs/formats/independent.json"
    )]
    independent: PathBuf,

    /// The page to write
    #[arg(
        short,
        long,
        value_name = "MD",
        default_value = "docs/formats/README.md"
    )]
    output: PathBuf,

    /// Reads of each file that are timed
    #[arg(long, default_value_t = 5)]
    repeat: usize,
}

impl FormatsArgs {
    /// Reads everything and writes the page.
    ///
    /// # Errors
    ///
    /// If the folder or the facts cannot be read, or the page cannot be written.
    pub fn run(&self) -> Result<()> {
        let facts: BTreeMap<String, Value> = serde_json::from_slice(
            &std::fs::read(&self.independent)
                .with_context(|| self.independent.display().to_string())?,
        )?;
        let (entries, parts) = list::entries(&self.data, &facts)?;
        let rows: Vec<_> = entries
            .into_iter()
            .map(|entry| {
                let result = read::read(&self.data, &entry, self.repeat);
                (entry, result)
            })
            .collect();
        let page = page::page(&rows, &parts);
        std::fs::write(&self.output, page).with_context(|| self.output.display().to_string())?;
        println!("{}", page::verdict(&rows));
        Ok(())
    }
}
