//! The input: which file, how it is read, which voxels are inside.

use std::ffi::OsStr;
use std::io::IsTerminal;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, ValueEnum};
use curvox_formats::mesh::{MeshFormat, recognise_mesh};
use curvox_formats::{
    Content, DType, Format, Header, IoMode, OpenOptions, RawLayout, Unit, Volume, VoxelType,
    is_url, open, open_stream, open_url, url_name,
};

use serde_json::{Value, json};

use crate::lattice::{Lattice, LatticeError};
use crate::volume::{Criterion, Number};

use super::exit::{BadInput, usage};
use super::lengths::{self, IndexBox, Spacing};

/// Standard input on the command line.
pub(crate) const STDIN: &str = "-";

/// Options of the input.
#[derive(Args, Clone, Debug)]
pub(crate) struct InputArgs {
    /// Volume to read: a file, a folder, a quoted pattern of slices, a URL, or - for standard input
    ///
    /// Patterns as in 'scan/slice_*.tif', in natural order. URLs begin with http://, https:// or s3://
    /// and need the cargo feature 'remote'; credentials come from the environment or the profile of AWS,
    /// never from here.
    ///
    /// The format is recognised by the content, not the name; `curvox formats` lists what is read.
    /// Compression of the whole file (gzip, bzip2, zstd) is undone on the way.
    #[arg(value_name = "INPUT")]
    pub(crate) input: PathBuf,

    /// Format, instead of recognising it: a name out of `curvox formats`
    #[arg(long, value_name = "FORMAT", help_heading = "Input")]
    format: Option<Format>,

    /// Voxels along x, y, z of a file without a header
    #[arg(long, value_name = "X,Y,Z", value_parser = lengths::dims, requires = "dtype", help_heading = "Input")]
    dims: Option<[u64; 3]>,

    /// Voxel type of a file without a header: u8, i16, u16le, f32be, ...
    #[arg(long, value_name = "TYPE", requires = "dims", help_heading = "Input")]
    dtype: Option<DType>,

    /// Bytes before the first voxel of a file without a header
    #[arg(long, value_name = "N", requires = "dims", help_heading = "Input")]
    skip: Option<u64>,

    /// Size of a voxel with its unit, instead of what the file says: 1,1,2um or 0.5mm
    #[arg(
        long,
        value_name = "X,Y,Z+UNIT",
        allow_hyphen_values = true,
        help_heading = "Input"
    )]
    spacing: Option<Spacing>,

    /// Which volume of a file with several, a point in time mostly, from 0
    #[arg(long, value_name = "N", help_heading = "Input")]
    frame: Option<u64>,

    /// Which channel of a file with several, from 0
    #[arg(long, value_name = "N", help_heading = "Input")]
    channel: Option<u64>,

    /// Which array, grid, series or member of a file with several: its name, path or number
    ///
    /// A file that holds several lists them when none is chosen.
    #[arg(long, value_name = "NAME", help_heading = "Input")]
    dataset: Option<String>,

    /// Which level of a pyramid, from 0, the finest
    #[arg(long, value_name = "N", help_heading = "Input")]
    level: Option<u32>,

    /// Only these voxels, in the indices of the file; the end is not included: 0:64,10:74,-5:20
    ///
    /// Rows and slices then count from the corner of the box; `first_index` in the metadata says where
    /// that is in the file.
    #[arg(long, value_name = "X0:X1,Y0:Y1,Z0:Z1", value_parser = lengths::region, allow_hyphen_values = true, help_heading = "Input")]
    region: Option<IndexBox>,

    /// Let a header name files outside its own folder
    #[arg(long, help_heading = "Input")]
    allow_outside: bool,

    /// Folder for a copy of an input that can only be read front to back, where its format needs
    /// another order and a quarter of the memory does not hold it
    ///
    /// The copy has no name and vanishes with the program.
    #[arg(long, value_name = "DIR", help_heading = "Input")]
    spill: Option<PathBuf>,

    /// How a plain file is read: map (mapped), read (at offsets), auto (read on network file systems)
    #[arg(long, value_enum, default_value = "auto", help_heading = "Input")]
    io: Io,
}

#[derive(ValueEnum, Clone, Copy, Debug)]
enum Io {
    Map,
    Read,
    Auto,
}

impl InputArgs {
    /// Whether the input is standard input.
    pub(crate) fn is_stdin(&self) -> bool {
        self.input == Path::new(STDIN)
    }

    /// The name of the input in messages.
    pub(crate) fn name(&self) -> String {
        if self.is_stdin() {
            "standard input".into()
        } else if let Some(url) = self.url() {
            // What may be secret in it is not shown.
            url_name(url)
        } else {
            self.input.display().to_string()
        }
    }

    /// The input, if it is an address.
    fn url(&self) -> Option<&str> {
        self.input.to_str().filter(|text| is_url(text))
    }

    fn options(&self) -> Result<OpenOptions> {
        let raw = match (self.dims, self.dtype) {
            (Some(dims), Some(dtype)) => {
                if let Some(format) = self.format.filter(|&f| f != Format::Raw) {
                    return Err(usage(format!(
                        "--dims and --dtype are for files without a header; --format {format} has one"
                    )));
                }
                let spacing = self.spacing;
                Some(RawLayout {
                    dims,
                    dtype,
                    spacing: spacing.map(|s| s.edges),
                    unit: spacing.map_or(Unit::Unknown, |s| s.unit),
                    skip: self.skip.unwrap_or(0),
                })
            }
            _ if self.format == Some(Format::Raw) => {
                return Err(usage(
                    "--format raw needs the layout: --dims X,Y,Z --dtype u16le, and --spacing 1,1,2um if known",
                ));
            }
            _ => None,
        };
        Ok(OpenOptions {
            format: self.format,
            raw,
            io: match self.io {
                Io::Map => IoMode::Map,
                Io::Read => IoMode::Read,
                Io::Auto => IoMode::Auto,
            },
            frame: self.frame,
            channel: self.channel,
            dataset: self.dataset.clone(),
            level: self.level,
            region: self.region.clone().map(|IndexBox(ranges)| ranges),
            outside: self.allow_outside,
            spill: self.spill.clone(),
            ..OpenOptions::default()
        })
    }

    /// The format of the mesh that the input is, unless it is said to be a volume.
    pub(crate) fn mesh_format(&self) -> Option<MeshFormat> {
        let said = self.is_stdin() || self.format.is_some() || self.dims.is_some();
        if said {
            None
        } else {
            recognise_mesh(&self.input)
        }
    }

    /// Opens a path or a URL.
    fn open_named(&self, options: &OpenOptions) -> Result<Volume, curvox_formats::Error> {
        match self.url() {
            Some(url) => open_url(url, options),
            None => open(&self.input, options),
        }
    }

    /// What was chosen of a file with several volumes, as the command line says it; what was
    /// chosen by default is among the details of the header.
    pub(crate) fn chosen(&self) -> Value {
        let region = self.region.as_ref().map(|IndexBox(ranges)| {
            let ends = ranges.iter().map(|range| [range.start, range.end]);
            ends.collect::<Vec<_>>()
        });
        json!({
            "dataset": self.dataset,
            "frame": self.frame,
            "channel": self.channel,
            "level": self.level,
            "region": region,
        })
    }

    /// The same input, of which only a box is read, in the indices of the file.
    pub(crate) fn within(&self, region: [Range<i64>; 3]) -> Self {
        Self {
            region: Some(IndexBox(region)),
            ..self.clone()
        }
    }

    /// Opens the volume for whoever is not bound to a memory.
    pub(crate) fn open(&self) -> Result<Volume> {
        self.open_within(OpenOptions::default().spool_limit_bytes)
    }

    /// Opens the volume, of which the reader may hold so many bytes in memory; its header is as the
    /// command line says where that overrides the file.
    pub(crate) fn open_within(&self, spool_limit_bytes: u64) -> Result<Volume> {
        let options = OpenOptions {
            spool_limit_bytes,
            ..self.options()?
        };
        let mut volume = if self.is_stdin() {
            if std::io::stdin().is_terminal() {
                return Err(usage(
                    "standard input is a terminal; name a file, or pipe a volume in",
                ));
            }
            open_stream(Box::new(std::io::stdin()), &self.name(), &options)?
        } else {
            self.open_named(&options)
                .map_err(|error| match self.mesh_format() {
                    Some(format) => BadInput(format!(
                        "{}: is a mesh ({}), not a volume; its curvatures: curvox mesh {0} -o out",
                        self.name(),
                        format.name()
                    ))
                    .into(),
                    None => anyhow::Error::from(error),
                })?
        };
        if let Some(Spacing { edges, unit }) = self.spacing {
            let header = &mut volume.header;
            // What the file has at index 0 stays there; a region moves with the size of voxels.
            let mut origin = header.index_origin();
            // A file that names no unit means one all the same, and now it is said.
            if origin != [0.0; 3] && header.unit != unit && header.unit != Unit::Unknown {
                if let Some(ratio) = lengths::ratio(header.unit, unit) {
                    origin = origin.map(|c| c * ratio);
                } else {
                    origin = [0.0; 3];
                    header.warnings.push(
                        "the origin is in another unit than --spacing and was set to 0".into(),
                    );
                }
            }
            if header.spacing != Some(edges) || header.unit != unit {
                header.spacing = Some(edges);
                header.unit = unit;
                header.set_index_origin(origin);
            }
        }
        Ok(volume)
    }
}

/// Which voxels are inside.
#[derive(Args, Clone, Debug)]
#[group(multiple = false)]
pub(crate) struct CriterionArgs {
    /// Inside: value >= T
    #[arg(
        long,
        value_name = "T",
        allow_hyphen_values = true,
        help_heading = "Inside"
    )]
    threshold: Option<Number>,

    /// Inside: A <= value <= B
    #[arg(long, value_name = "A..B", value_parser = Criterion::range, allow_hyphen_values = true, help_heading = "Inside")]
    range: Option<Criterion>,

    /// Inside: value < T
    #[arg(
        long,
        value_name = "T",
        allow_hyphen_values = true,
        help_heading = "Inside"
    )]
    below: Option<Number>,

    /// Inside: value == N, one label of many
    #[arg(
        long,
        value_name = "N",
        allow_hyphen_values = true,
        help_heading = "Inside"
    )]
    label: Option<Number>,

    /// Inside: value >= the threshold of Otsu; the input is read twice, so it cannot be a pipe
    #[arg(long, help_heading = "Inside")]
    otsu: bool,
}

/// What the command line says about the inside.
pub(crate) enum Inside {
    /// A criterion.
    Given(Criterion),
    /// The threshold is to be found.
    Otsu,
}

impl CriterionArgs {
    /// The criterion asked for.
    ///
    /// # Errors
    /// If there is none and the file does not say itself what is inside.
    pub(crate) fn inside(&self, header: &Header, input: &InputArgs) -> Result<Inside> {
        let given = self
            .threshold
            .map(Criterion::AtLeast)
            .or(self.range)
            .or(self.below.map(Criterion::Below))
            .or(self.label.map(Criterion::Label));
        match given {
            Some(criterion) => Ok(Inside::Given(criterion)),
            None if self.otsu => Ok(Inside::Otsu),
            None if header.content == Content::LevelSet => {
                Ok(Inside::Given(Criterion::Below(Number::from(0))))
            }
            None if header.voxel == VoxelType::Bool || header.content == Content::Mask => {
                Ok(Inside::Given(Criterion::AtLeast(Number::from(1))))
            }
            None => {
                let look = if input.is_stdin() {
                    String::new()
                } else {
                    format!(
                        "\n\nTo see the values in the image, and the threshold of Otsu:\n  \
                         curvox info --values {}",
                        input.name()
                    )
                };
                Err(usage(format!(
                    "which voxels are inside? Say one of:\n  \
                     --threshold T   value >= T\n  \
                     --range A..B    A <= value <= B\n  \
                     --below T       value < T\n  \
                     --label N       value == N\n  \
                     --otsu          value >= the threshold of Otsu (not for pipes){look}"
                )))
            }
        }
    }
}

/// The voxel grid of a volume, and the unit of its world.
pub(crate) fn lattice(volume: &Volume, closed: bool) -> Result<Lattice> {
    let header = &volume.header;
    let spacing = header.spacing.unwrap_or([1.0; 3]);
    let mut lattice = Lattice::new(header.dims, spacing, closed).map_err(|error| {
        let place = match error {
            LatticeError::Spacing { .. } | LatticeError::Aspect(_) => {
                format!("{error} (set it with --spacing)")
            }
            _ => error.to_string(),
        };
        BadInput(format!("{}: {place}", volume.source.name))
    })?;
    lattice.origin = header.origin;
    // The header has axes in columns, the lattice one vector an axis.
    lattice.direction = transposed(header.direction);
    Ok(lattice)
}

/// Rows to columns.
pub(crate) fn transposed(m: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|a| [0, 1, 2].map(|i| m[i][a]))
}

/// How the unit of the world is written in outputs: `um`, `mm`; `unit` where the image has a voxel
/// size without a unit; `vx` where it has none and lengths are in voxels.
pub(crate) fn unit_name(volume: &Volume) -> &'static str {
    match (volume.header.spacing, volume.header.unit) {
        (None, _) => "vx",
        (Some(_), Unit::Unknown) => "unit",
        (Some(_), unit) => unit.symbol(),
    }
}

/// An argument of the command line for a record: an address without what may be secret.
pub(crate) fn shown(argument: &OsStr) -> String {
    let text = argument.to_string_lossy();
    if is_url(&text) {
        url_name(&text)
    } else {
        text.into_owned()
    }
}

/// The modification time of a file, in seconds since 1970.
pub(crate) fn modified(path: &Path) -> Option<u64> {
    let time = std::fs::metadata(path).ok()?.modified().ok()?;
    Some(time.duration_since(std::time::UNIX_EPOCH).ok()?.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_recorded_without_the_query_of_an_address() {
        let of = |argument: &str| shown(OsStr::new(argument));
        assert_eq!(of("https://h/a.zarr?token=geheim"), "https://h/a.zarr");
        assert_eq!(of("--dataset"), "--dataset");
        assert_eq!(of("what?.tif"), "what?.tif");
    }
}
