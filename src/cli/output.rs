//! Where the results go: a directory, one file, or standard output.

use std::fs::{self, OpenOptions};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde_json::Value;

use crate::sink::{
    DatasetSink, Palette, Parts, RunRecorder, STDOUT, SUMMARY_FILE, SingleSink, SinkError,
    SliceMemory, SliceOptions, SliceSelection, SliceSink, Summary, SurfelSink, TableInfo,
    prepare_output,
};

use super::exit::usage;

/// Options of the output.
#[derive(Args, Clone, Debug)]
pub(crate) struct OutputArgs {
    /// Where the results go: a directory, a file .parquet or .csv, or - for standard output
    ///
    /// A directory receives surfels/part-*.parquet, summary.json, run.json and, with --slices,
    /// slices/*.exr. Single files and standard output receive the table alone.
    #[arg(short, long, value_name = "OUT", help_heading = "Output")]
    output: Option<PathBuf>,

    /// Replace the results of an earlier run
    #[arg(long, help_heading = "Output")]
    pub(crate) overwrite: bool,

    /// Table on standard output: csv, arrow (an Arrow IPC stream) [default: csv]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "FORMAT",
        help_heading = "Output"
    )]
    to: Option<TableStream>,

    /// Curvature slices as OpenEXR: 10,20  3..40  every:8  all; x=10 or --axis x across x
    #[arg(long, value_name = "SLICES", help_heading = "Output")]
    slices: Option<String>,

    /// The axis the slices are across: x, y or z [default: z]
    #[arg(long, value_name = "AXIS", requires = "slices", value_parser = ["x", "y", "z"], hide_possible_values = true, help_heading = "Output")]
    axis: Option<String>,

    /// Colours of the slices' preview: blue-red, blue-orange
    #[arg(
        long,
        value_name = "NAME",
        requires = "slices",
        default_value = "blue-red",
        help_heading = "Output"
    )]
    palette: Palette,

    /// No progress, no summary, no warnings on standard error
    #[arg(short, long, help_heading = "Messages")]
    pub(crate) quiet: bool,

    /// Progress and errors as JSON lines on standard error, the final summary as JSON on standard
    /// output (on standard error when the table goes to standard output)
    #[arg(long, help_heading = "Messages")]
    pub(crate) json: bool,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum TableStream {
    Csv,
    Arrow,
}

/// Pixels of a slice that is still drawn: a file of more would have hundreds of gigabytes.
const MOST_SLICE_PIXELS: u64 = 1 << 32;

/// Where the results go.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Target {
    /// A directory of parts.
    Directory(PathBuf),
    /// A Parquet file.
    Parquet(PathBuf),
    /// A CSV file.
    Csv(PathBuf),
    /// Standard output.
    Stdout,
    /// A device or named pipe.
    Device(PathBuf),
}

/// Endings that say a table was meant, of formats that are not written.
const OTHER_ENDINGS: [&str; 37] = [
    "arrow", "feather", "ipc", "tsv", "txt", "json", "jsonl", "xml", "xls", "xlsx", "ods", "gz",
    "zst", "zip", "vtk", "vtp", "vtu", "vti", "ply", "obj", "stl", "off", "exr", "png", "tif",
    "tiff", "npy", "npz", "nii", "vol", "raw", "h5", "hdf5", "pq", "mat", "html", "pdf",
];

impl OutputArgs {
    /// Where the results go.
    ///
    /// # Errors
    /// If that is not said, or options do not fit it.
    pub(crate) fn target(&self) -> Result<Target> {
        let Some(path) = &self.output else {
            return Err(where_to(
                "table in parts, summary.json, run.json, slices",
                "CSV or --to arrow",
            ));
        };
        let target = target_of(path)?;
        let streams = matches!(target, Target::Stdout | Target::Device(_));
        if self.to.is_some() && !streams {
            return Err(usage(
                "--to is for standard output (-o -); the format of a file follows from its name",
            ));
        }
        if self.slices.is_some() && !matches!(target, Target::Directory(_)) {
            return Err(usage("--slices needs a directory as output (-o DIR)"));
        }
        if target == Target::Stdout
            && self.to == Some(TableStream::Arrow)
            && std::io::stdout().is_terminal()
        {
            return Err(usage(
                "an Arrow stream is binary and standard output is a terminal; redirect it",
            ));
        }
        Ok(target)
    }

    /// Where the results would go, if that is said.
    ///
    /// # Errors
    /// As [`OutputArgs::target`], except that nothing need be said.
    pub(crate) fn maybe_target(&self) -> Result<Option<Target>> {
        match self.output {
            Some(_) => self.target().map(Some),
            None => Ok(None),
        }
    }

    /// The slices chosen.
    fn selection(&self) -> Result<Option<SliceSelection>> {
        let Some(text) = &self.slices else {
            return Ok(None);
        };
        let names_axis = text.trim_start().starts_with(['x', 'y', 'z']);
        let text = match &self.axis {
            Some(axis) if names_axis && !text.trim_start().starts_with(axis.as_str()) => {
                return Err(usage(format!(
                    "--slices {text} is not across --axis {axis}"
                )));
            }
            Some(axis) if !names_axis => format!("{axis}={text}"),
            _ => text.clone(),
        };
        text.parse()
            .map(Some)
            .map_err(|error| usage(format!("--slices: {error}")))
    }

    /// Memory that the sinks hold during the whole run.
    ///
    /// # Errors
    /// If slices cannot be understood or are beyond the image.
    pub(crate) fn sink_bytes(&self, dims: [u32; 3], memory: u64) -> Result<u64> {
        let Some(selection) = self.selection()? else {
            return Ok(0);
        };
        let [width, height] = SliceSink::size(dims, selection.axis()).map(u64::from);
        if width * height > MOST_SLICE_PIXELS {
            return Err(usage(format!(
                "--slices: a slice of {width} x {height} pixels is too large for an image; leave --slices \
                 out, or crop the volume"
            )));
        }
        let bytes = SliceMemory::of(dims, &selection, true)
            .map_err(|error| usage(format!("--slices: {error}")))?;
        // What a scan needs, and more than that while it takes no more than a quarter.
        Ok(bytes.bound_bytes.min(bytes.expected_bytes.max(memory / 4)))
    }

    /// Makes the sinks, so that an output that cannot be written is found before the run.
    pub(crate) fn open(
        &self,
        target: &Target,
        info: &TableInfo,
        asked: Value,
        input: Value,
        memory: u64,
    ) -> Result<Sinks> {
        let mut sinks = Sinks::default();
        match target {
            Target::Directory(path) => {
                let selection = self.selection()?;
                prepare_output(path, self.overwrite)?;
                let parts = Parts::new(info.dims).count();
                let recorder =
                    RunRecorder::create(path, env!("CARGO_PKG_VERSION"), asked, input, parts)?;
                let recorder = Arc::new(recorder);
                sinks.recorder = Some(Arc::clone(&recorder));
                sinks.directory = Some(path.clone());
                sinks.add(
                    "table",
                    DatasetSink::create(path, info.clone(), Some(recorder))?,
                );
                if let Some(selection) = selection {
                    let options = SliceOptions {
                        selection,
                        palette: self.palette,
                        range: None,
                        budget_bytes: Some(self.sink_bytes(info.dims, memory)?),
                    };
                    sinks.add("slices", SliceSink::create(path, info.clone(), &options)?);
                }
            }
            Target::Parquet(path) => {
                self.refuse_existing(path)?;
                sinks.add("table", SingleSink::parquet_file(path, info.clone())?);
            }
            Target::Csv(path) => {
                self.refuse_existing(path)?;
                sinks.add("table", SingleSink::csv_file(path, info.clone())?);
            }
            Target::Stdout => {
                let path = Path::new("standard output");
                sinks.add("table", self.stream(std::io::stdout(), path, info)?);
            }
            Target::Device(path) => {
                let file = OpenOptions::new()
                    .write(true)
                    .open(path)
                    .map_err(|error| SinkError::io(path, "open", error))?;
                sinks.add("table", self.stream(file, path, info)?);
            }
        }
        Ok(sinks)
    }

    fn stream(
        &self,
        output: impl std::io::Write + Send + 'static,
        path: &Path,
        info: &TableInfo,
    ) -> Result<SingleSink> {
        Ok(match self.to {
            Some(TableStream::Arrow) => SingleSink::arrow_stream(output, path, info.clone())?,
            _ => SingleSink::csv_stream(output, path, info.clone())?,
        })
    }

    fn refuse_existing(&self, path: &Path) -> Result<(), SinkError> {
        refuse_existing(path, self.overwrite)
    }
}

/// The question where the results should go, with what a directory and standard output would get.
pub(super) fn where_to(directory: &str, stdout: &str) -> anyhow::Error {
    usage(format!(
        "where should the results go? Say one of:\n  \
         -o DIR          a directory: {directory}\n  \
         -o OUT.parquet  one Parquet file\n  \
         -o OUT.csv      one CSV file\n  \
         -o -            standard output, {stdout}"
    ))
}

/// Refuses a file that is there already, unless it may be replaced.
pub(super) fn refuse_existing(path: &Path, overwrite: bool) -> Result<(), SinkError> {
    if !overwrite && fs::symlink_metadata(path).is_ok() {
        return Err(SinkError::Occupied {
            path: path.to_owned(),
            found: "exists already".into(),
            advice: "use --overwrite to replace it",
        });
    }
    Ok(())
}

pub(super) fn target_of(path: &Path) -> Result<Target> {
    if path == Path::new(STDOUT) {
        return Ok(Target::Stdout);
    }
    let found = fs::metadata(path).ok();
    if found.as_ref().is_some_and(fs::Metadata::is_dir) {
        return Ok(Target::Directory(path.to_owned()));
    }
    if found.is_some_and(|found| !found.is_file()) {
        return Ok(Target::Device(path.to_owned()));
    }
    let ending = path
        .extension()
        .map(|e| e.to_string_lossy().to_ascii_lowercase());
    let is_folder = path.as_os_str().to_string_lossy().ends_with('/');
    match ending.as_deref() {
        Some("parquet") if !is_folder => Ok(Target::Parquet(path.to_owned())),
        Some("csv") if !is_folder => Ok(Target::Csv(path.to_owned())),
        Some(other) if !is_folder && OTHER_ENDINGS.contains(&other) => Err(usage(format!(
            "-o {}: .{other} is not a format of the table; end the name in .parquet or .csv, \
             write to standard output (-o -), or end it in / for a directory",
            path.display()
        ))),
        _ => Ok(Target::Directory(path.to_owned())),
    }
}

/// The sinks of a run.
#[derive(Default)]
pub(crate) struct Sinks {
    pub(crate) list: Vec<Box<dyn SurfelSink>>,
    /// What each writes, in words.
    pub(crate) names: Vec<&'static str>,
    pub(crate) recorder: Option<Arc<RunRecorder>>,
    directory: Option<PathBuf>,
}

impl Sinks {
    fn add(&mut self, name: &'static str, sink: impl SurfelSink + 'static) {
        self.names.push(name);
        self.list.push(Box::new(sink));
    }

    /// Writes `summary.json`, where the output is a directory.
    pub(crate) fn write_summary(&self, summary: &Summary) -> Result<(), SinkError> {
        match &self.directory {
            Some(directory) => summary.write(&directory.join(SUMMARY_FILE)),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_decide_where_results_go() {
        let target = |text: &str| target_of(Path::new(text));
        assert_eq!(target("-").unwrap(), Target::Stdout);
        assert_eq!(target("a/b.CSV").unwrap(), Target::Csv("a/b.CSV".into()));
        assert_eq!(
            target("b.parquet").unwrap(),
            Target::Parquet("b.parquet".into())
        );
        assert_eq!(
            target("b.parquet/").unwrap(),
            Target::Directory("b.parquet/".into())
        );
        assert_eq!(
            target("scan.v2").unwrap(),
            Target::Directory("scan.v2".into())
        );
        for other in ["b.ply", "b.vtp", "b.STL", "b.xlsx", "a/b.nii"] {
            assert!(target(other).is_err(), "{other}");
        }
        assert_eq!(
            target("b.vtp/").unwrap(),
            Target::Directory("b.vtp/".into())
        );
    }
}
