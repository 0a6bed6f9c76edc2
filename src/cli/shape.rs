//! `curvox shape`: digitised shapes of known curvature, with noise if wanted.

use std::fmt::Write as _;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use clap::{Args, ValueEnum};
use curvox_formats::write::{VolumeWriter, WriteFormat, WriteSpec};
use curvox_formats::{DType, VoxelType};
use glam::DVec3;
use rayon::prelude::*;

use crate::error::Error;
use crate::shape::{
    BoxedShape, Digitisation, Grid, Noise, NoisyPlanes, SHAPES, ShapeError, by_spec,
};
use crate::sink::{STDOUT, SinkError};

use super::exit::{self, usage};

/// Arguments of `curvox shape`.
#[derive(Args, Clone, Debug)]
pub(crate) struct ShapeArgs {
    /// Shape and its parameters: goursat, sphere:radius=9, torus:major=6,minor=2; --list shows all
    #[arg(
        value_name = "NAME[:PARAMETER=VALUE,...]",
        required_unless_present = "list"
    )]
    shape: Option<String>,

    /// List the shapes and their parameters
    #[arg(long)]
    list: bool,

    /// Edges of a voxel in the units of the shape: one number, or three along x, y, z
    #[arg(
        long,
        value_name = "H[,H,H]",
        value_delimiter = ',',
        required_unless_present = "list"
    )]
    gridstep: Vec<f64>,

    /// Position of the grid, in voxels, each from -1 to 1 [default: 0,0,0]
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    offset: Vec<f64>,

    /// Voxels around the bounding box of the shape
    #[arg(long, value_name = "N", default_value_t = crate::shape::REFERENCE_MARGIN)]
    margin: u16,

    /// Flip voxels near the surface: probability P at distance 1, P^d at distance d
    #[arg(long, value_name = "P")]
    noise: Option<f64>,

    /// Seed of the noise
    #[arg(long, value_name = "S", default_value_t = 1, requires = "noise")]
    seed: u64,

    /// File to write, or - for standard output
    #[arg(short, long, value_name = "FILE", default_value = STDOUT)]
    output: PathBuf,

    /// Format: nii, npy, vol, raw; nii alone carries the voxel size [default: from the name, else nii]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "FORMAT")]
    to: Option<To>,

    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum To {
    Nii,
    Npy,
    Vol,
    Raw,
}

/// Digitises.
pub(crate) fn run(args: &ShapeArgs, stop: &AtomicBool) -> Result<()> {
    let Some(spec) = args.shape.as_deref().filter(|_| !args.list) else {
        return exit::print(&list());
    };
    let wrong = |error: ShapeError| usage(error.to_string());
    let shape = by_spec(spec).map_err(wrong)?;
    let mut grid = Grid::boxes(triple("--gridstep", &args.gridstep)?);
    if !args.offset.is_empty() {
        grid.offset = triple("--offset", &args.offset)?;
    }
    grid.margin = args.margin;
    let digitisation = Digitisation::new(shape, grid).map_err(wrong)?;
    let noise = args
        .noise
        .map(|p| Noise::new(p, args.seed))
        .transpose()
        .map_err(wrong)?;
    let format = args.format()?;
    let dims = digitisation.dims();
    let mut volume = WriteSpec::new(
        format,
        // Extents are at most 2^30.
        dims.map(|n| n as u64),
        DType::little(VoxelType::U8),
    );
    // Without a unit: shapes are in units of their own, so radii are typed in voxels.
    volume.spacing = Some(digitisation.spacing().to_array());
    volume.origin = digitisation.origin().to_array();
    let path = &args.output;
    if path == Path::new(STDOUT) {
        if io::stdout().is_terminal() {
            return Err(usage(
                "a volume is binary and standard output is a terminal; \
                 give a file (-o ball.nii) or pipe it: curvox shape ... | curvox run - --threshold 1 -o out",
            ));
        }
        return write(
            io::stdout().lock(),
            path,
            &volume,
            &digitisation,
            noise,
            stop,
        );
    }
    let exists = path.exists();
    let made = OpenOptions::new()
        .write(true)
        .create(true)
        .create_new(!args.overwrite && !is_special(path))
        .truncate(args.overwrite)
        .open(path);
    let file: File = made.map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => SinkError::Occupied {
            path: path.clone(),
            found: "exists already".into(),
            advice: "use --overwrite to replace it",
        },
        _ => SinkError::io(path, "create", error),
    })?;
    let out = BufWriter::with_capacity(1 << 18, file);
    let result = write(out, path, &volume, &digitisation, noise, stop);
    if result.is_err() && !exists {
        // A file cut short would look like a damaged volume.
        let _ = std::fs::remove_file(path);
    }
    result
}

/// Whether a path is a device or a pipe, which is there already and cannot be replaced.
fn is_special(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir())
}

impl ShapeArgs {
    fn format(&self) -> Result<WriteFormat> {
        let ending = self
            .output
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        let to = match (self.to, ending.as_deref()) {
            (Some(to), _) => to,
            (None, Some("nii") | None) => To::Nii,
            (None, Some("npy")) => To::Npy,
            (None, Some("vol")) => To::Vol,
            (None, Some("raw")) => To::Raw,
            (None, Some("gz")) => {
                return Err(usage(
                    "compressed volumes are not written; pipe through gzip: curvox shape ... | gzip > ball.nii.gz",
                ));
            }
            (None, Some(other)) => {
                return Err(usage(format!(
                    "-o {}: .{other} is not a format that is written; say --to nii, npy, vol or raw",
                    self.output.display()
                )));
            }
        };
        Ok(match to {
            To::Nii => WriteFormat::Nifti,
            To::Npy => WriteFormat::Npy,
            To::Vol => WriteFormat::Vol,
            To::Raw => WriteFormat::Raw,
        })
    }
}

fn triple(flag: &str, numbers: &[f64]) -> Result<DVec3> {
    match *numbers {
        [all] => Ok(DVec3::splat(all)),
        [x, y, z] => Ok(DVec3::new(x, y, z)),
        _ => Err(usage(format!(
            "{flag}: found {} numbers, expected 1 or 3",
            numbers.len()
        ))),
    }
}

/// Writes all planes, as many at a time as there are threads.
fn write(
    out: impl Write,
    path: &Path,
    volume: &WriteSpec,
    digitisation: &Digitisation<BoxedShape>,
    noise: Option<Noise>,
    stop: &AtomicBool,
) -> Result<()> {
    let failed = |error: curvox_formats::Error| write_error(path, error);
    let name = path.display().to_string();
    let mut writer = VolumeWriter::new(out, &name, volume).map_err(failed)?;
    let dims = digitisation.dims();
    let batch = rayon::current_num_threads().max(1);
    let mut clean = Batches {
        digitisation,
        planes: Vec::new(),
        first: 0,
        batch,
    };
    let stopped = || {
        if stop.load(Ordering::Relaxed) {
            Err(Error::Stopped)
        } else {
            Ok(())
        }
    };
    let mut plane = Vec::new();
    match noise {
        None => {
            for z in 0..dims[2] {
                stopped()?;
                writer.write_planes(clean.plane(z)).map_err(failed)?;
            }
        }
        Some(noise) => {
            let source = |z: usize, out: &mut Vec<u8>| -> Result<(), Error> {
                out.clear();
                out.extend_from_slice(clean.plane(z));
                stopped()
            };
            let mut noisy = NoisyPlanes::new(noise, dims, 0..dims[2], source);
            while noisy.next_plane(&mut plane)?.is_some() {
                writer.write_planes(&plane).map_err(failed)?;
            }
        }
    }
    writer.finish().map_err(failed)?;
    Ok(())
}

/// Planes without noise, computed a batch at a time.
struct Batches<'a> {
    digitisation: &'a Digitisation<BoxedShape>,
    planes: Vec<Vec<u8>>,
    /// z of the first of `planes`.
    first: usize,
    batch: usize,
}

impl Batches<'_> {
    /// Plane `z`; asked for in increasing order.
    fn plane(&mut self, z: usize) -> &[u8] {
        if z < self.first || z >= self.first + self.planes.len() {
            let end = (z + self.batch).min(self.digitisation.dims()[2]);
            self.planes.resize_with(end - z, Vec::new);
            let planes = self.planes.par_iter_mut().enumerate();
            planes.for_each(|(i, out)| self.digitisation.plane(z + i, out));
            self.first = z;
        }
        &self.planes[z - self.first]
    }
}

/// An error of writing, as an output's; the library of formats has one kind of error for both.
fn write_error(path: &Path, error: curvox_formats::Error) -> anyhow::Error {
    use std::error::Error as _;
    let source = error.source().and_then(|s| s.downcast_ref::<io::Error>());
    match source {
        Some(source) => {
            let source = io::Error::new(source.kind(), source.to_string());
            SinkError::io(path, "write", source).into()
        }
        None => usage(error.to_string()),
    }
}

fn list() -> String {
    let mut text = String::new();
    for shape in &SHAPES {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{}\n    {}", shape.name, shape.description);
        for parameter in shape.parameters {
            let _ = writeln!(
                text,
                "    {} = {}: {}",
                parameter.name, parameter.default, parameter.meaning
            );
        }
    }
    text
}
