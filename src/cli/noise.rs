//! `curvox noise`: what is inside a volume, with the noise of the papers, as a volume of 0 and 1.

use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use clap::Args;
use curvox_formats::write::WriteSpec;
use curvox_formats::{DType, Volume, VoxelType};

use crate::error::Error;
use crate::shape::{Noise, NoisyPlanes};
use crate::volume::{Binarizer, Criterion, Number};

use super::exit::usage;
use super::input::{self, CriterionArgs, InputArgs, Inside};
use super::values;
use super::volume_output::VolumeOutputArgs;

/// Arguments of `curvox noise`.
#[derive(Args, Clone, Debug)]
pub(crate) struct NoiseArgs {
    #[command(flatten)]
    input: InputArgs,

    #[command(flatten)]
    criterion: CriterionArgs,

    /// Flip voxels near the surface: probability P at distance 1, P^d at distance d
    ///
    /// The distance d of a voxel is the Euclidean one, in voxels, from its centre to the nearest centre
    /// of a voxel of the other phase in the image without noise; 1 for a voxel that has a surfel.
    /// Voxels count as cubes whatever their size, and beyond the border of the image there is no
    /// phase. P is from 0 to 0.9.
    #[arg(long, value_name = "P", allow_negative_numbers = true)]
    noise: f64,

    /// Seed of the noise: the same input, criterion and seed give the same voxels
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,

    #[command(flatten)]
    output: VolumeOutputArgs,
}

/// Adds noise.
pub(crate) fn run(args: &NoiseArgs, stop: &AtomicBool) -> Result<()> {
    let noise = Noise::new(args.noise, args.seed).map_err(|error| usage(error.to_string()))?;
    let format = args.output.format("noise")?;
    let volume = args.input.open()?;
    // Extents that the rest could not hold are refused here.
    let dims = input::lattice(&volume, false)?.dims.map(|n| n as usize);
    refuse_input_as_output(volume.source.path.as_deref(), args.output.file())?;
    let criterion = match args.criterion.inside(&volume.header, &args.input)? {
        Inside::Given(criterion) => criterion,
        Inside::Otsu => Criterion::AtLeast(Number::from(values::otsu(&args.input, &volume, stop)?)),
    };
    let header = &volume.header;
    let mut spec = WriteSpec::new(format, header.dims, DType::little(VoxelType::U8));
    spec.spacing = header.spacing;
    spec.unit = header.unit;
    spec.origin = header.origin;
    spec.direction = header.direction;
    let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, header.scaling);
    tell(&volume.header.warnings);
    let mut source = Bits::new(volume, binarizer, dims);
    args.output.write(&spec, |put| {
        let read = |_: usize, out: &mut Vec<u8>| {
            if stop.load(Ordering::Relaxed) {
                return Err(Error::Stopped);
            }
            source.next_plane(out)
        };
        let mut planes = NoisyPlanes::new(noise, dims, 0..dims[2], read);
        let mut plane = Vec::new();
        while planes.next_plane(&mut plane)?.is_some() {
            put(&plane)?;
        }
        drop(planes);
        // Only now is it known that compressed bytes were sound.
        tell(&source.voxels.finish().map_err(Error::Input)?);
        Ok(())
    })
}

/// Refuses to write the volume over the one it comes from.
fn refuse_input_as_output(input: Option<&Path>, output: Option<&Path>) -> Result<()> {
    let (Some(input), Some(output)) = (input, output) else {
        return Ok(());
    };
    match (input.canonicalize(), output.canonicalize()) {
        (Ok(from), Ok(to)) if from == to => Err(usage(format!(
            "-o {} is the input itself",
            output.display()
        ))),
        _ => Ok(()),
    }
}

/// Says on standard error what a user should know.
fn tell(warnings: &[String]) {
    for warning in warnings {
        // Nobody may be reading; the volume is written all the same.
        let _ = writeln!(std::io::stderr(), "curvox: warning: {warning}");
    }
}

/// Planes of 0 and 1 out of a volume.
struct Bits {
    voxels: Box<dyn curvox_formats::ForwardVoxels>,
    name: String,
    binarizer: Binarizer,
    dims: [usize; 3],
    stored: Vec<u8>,
}

impl Bits {
    fn new(volume: Volume, binarizer: Binarizer, dims: [usize; 3]) -> Self {
        Self {
            name: volume.source.name.clone(),
            voxels: volume.into_forward(),
            binarizer,
            dims,
            stored: Vec::new(),
        }
    }

    fn next_plane(&mut self, out: &mut Vec<u8>) -> Result<(), Error> {
        let [nx, ny, _] = self.dims;
        if self.voxels.read_planes(1, &mut self.stored)? == 0 {
            return Err(curvox_formats::Error::invalid(
                &self.name,
                "the voxels end before the last plane",
            )
            .into());
        }
        out.clear();
        let mut words = vec![0; nx.div_ceil(64)];
        for row in self.stored.chunks_exact(self.stored.len() / ny) {
            self.binarizer.pack_row(row, &mut words);
            out.extend((0..nx).map(|x| (words[x / 64] >> (x % 64) & 1) as u8));
        }
        Ok(())
    }
}
