//! `curvox shape`: digitised shapes of known curvature, with noise if wanted; or grey images of them.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use clap::{Args, ValueEnum};
use curvox_formats::write::{WriteFormat, WriteSpec};
use curvox_formats::{DType, VoxelType};
use glam::DVec3;
use rayon::prelude::*;

use crate::error::Error;
use crate::shape::{
    BoxedShape, Digitisation, GreyPlanes, Grid, Noise, NoisyPlanes, SHAPES, Scanner, ShapeError,
    by_spec,
};

use super::exit::{self, usage};
use super::lengths::Length;
use super::volume_output::{Put, VolumeOutputArgs};

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
        allow_hyphen_values = true,
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
    #[arg(long, value_name = "P", allow_negative_numbers = true)]
    noise: Option<f64>,

    /// Write grey values: of each voxel the part that is inside, as a scanner would see it
    ///
    /// Outside is 1/4 and inside 3/4 of the range of u8 and u16 (64 and 192, 16384 and 49152), 0 and 1
    /// of f32; the surface is half-way: --threshold 128, 32768 or 0.5.
    #[arg(long, conflicts_with = "noise")]
    partial: bool,

    /// Blur of the grey values: standard deviation of a Gaussian in voxels, as 1vx
    #[arg(
        long,
        value_name = "SIGMA",
        allow_hyphen_values = true,
        requires = "partial"
    )]
    blur: Option<Length>,

    /// Noise of the grey values after the blur: standard deviation, where inside and outside differ by 1
    #[arg(
        long,
        value_name = "SIGMA",
        allow_negative_numbers = true,
        requires = "partial"
    )]
    grey_noise: Option<f64>,

    /// Type of the grey values: u8, u16, f32 [default: u16; u8 in a .vol]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "TYPE",
        requires = "partial"
    )]
    dtype: Option<GreyType>,

    /// Seed of the noise [default: 1]
    #[arg(long, value_name = "S")]
    seed: Option<u64>,

    #[command(flatten)]
    output: VolumeOutputArgs,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum GreyType {
    U8,
    U16,
    F32,
}

impl GreyType {
    fn voxel(self) -> VoxelType {
        match self {
            GreyType::U8 => VoxelType::U8,
            GreyType::U16 => VoxelType::U16,
            GreyType::F32 => VoxelType::F32,
        }
    }

    /// Replaces `out` by values as they are stored, little endian.
    fn store(self, values: &[f64], out: &mut Vec<u8>) {
        out.clear();
        // Room on both sides, so that noise is rarely cut off. `as` saturates.
        let level = |value: f64, range: f64| (range * (0.25 + 0.5 * value)).round();
        for &value in values {
            match self {
                GreyType::U8 => out.push(level(value, 256.0) as u8),
                GreyType::U16 => out.extend((level(value, 65536.0) as u16).to_le_bytes()),
                GreyType::F32 => out.extend((value as f32).to_le_bytes()),
            }
        }
    }
}

/// Digitises.
pub(crate) fn run(args: &ShapeArgs, stop: &AtomicBool) -> Result<()> {
    let Some(spec) = args.shape.as_deref().filter(|_| !args.list) else {
        return exit::print(&list());
    };
    let wrong = |error: ShapeError| match error {
        ShapeError::Spacing { axis, value } => usage(format!(
            "--gridstep is {value} along {axis}, expected a finite length above 0"
        )),
        other => usage(other.to_string()),
    };
    let shape = by_spec(spec).map_err(wrong)?;
    let mut grid = Grid::boxes(triple("--gridstep", &args.gridstep)?);
    if !args.offset.is_empty() {
        grid.offset = triple("--offset", &args.offset)?;
    }
    grid.margin = args.margin;
    if args.seed.is_some() && args.noise.is_none() && args.grey_noise.is_none() {
        return Err(usage("--seed is for --noise or --grey-noise"));
    }
    let seed = args.seed.unwrap_or(1);
    let digitisation = Digitisation::new(shape, grid).map_err(wrong)?;
    let noise = args
        .noise
        .map(|p| Noise::new(p, seed))
        .transpose()
        .map_err(wrong)?;
    let format = args.output.format("shape")?;
    let grey = args.partial.then(|| {
        let natural = if format == WriteFormat::Vol {
            GreyType::U8
        } else {
            GreyType::U16
        };
        args.dtype.unwrap_or(natural)
    });
    let dims = digitisation.dims();
    let mut volume = WriteSpec::new(
        format,
        // Extents are at most 2^30.
        dims.map(|n| n as u64),
        DType::little(grey.map_or(VoxelType::U8, GreyType::voxel)),
    );
    // Without a unit: shapes are in units of their own, so radii are typed in voxels.
    volume.spacing = Some(digitisation.spacing().to_array());
    volume.origin = digitisation.origin().to_array();
    let stopped = || {
        if stop.load(Ordering::Relaxed) {
            Err(Error::Stopped)
        } else {
            Ok(())
        }
    };
    match grey {
        None => args.output.write(&volume, |put| {
            write_bits(put, &digitisation, noise, stopped)
        }),
        Some(grey) => {
            let blur = args.blur.as_ref().map(|length| {
                length.as_voxels().ok_or_else(|| {
                    usage(format!(
                        "--blur {length}: shapes are in units of their own; write it in voxels, as 1vx"
                    ))
                })
            });
            let scanner = Scanner {
                blur: blur.transpose()?.unwrap_or(0.0),
                noise: args.grey_noise.unwrap_or(0.0),
                seed,
            };
            let mut planes = GreyPlanes::new(&digitisation, scanner).map_err(wrong)?;
            args.output.write(&volume, |put| {
                let (mut values, mut stored) = (Vec::new(), Vec::new());
                while planes.next_plane(&mut values) {
                    stopped()?;
                    grey.store(&values, &mut stored);
                    put(&stored)?;
                }
                Ok(())
            })
        }
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

/// Hands on all planes of 0 and 1, computed as many at a time as there are threads.
fn write_bits(
    put: &mut Put<'_>,
    digitisation: &Digitisation<BoxedShape>,
    noise: Option<Noise>,
    stopped: impl Fn() -> Result<(), Error>,
) -> Result<()> {
    let dims = digitisation.dims();
    let batch = rayon::current_num_threads().max(1);
    let mut clean = Batches {
        digitisation,
        planes: Vec::new(),
        first: 0,
        batch,
    };
    let mut plane = Vec::new();
    match noise {
        None => {
            for z in 0..dims[2] {
                stopped()?;
                put(clean.plane(z))?;
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
                put(&plane)?;
            }
        }
    }
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
