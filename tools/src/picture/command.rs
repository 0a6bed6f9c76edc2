//! `curvox-tools picture`.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use curvox::sink::{Check, OutputInfo, Palette};

use super::image::Image;
use super::slice::slice_preview;
use super::surfels::{PictureOptions, draw_surfels};
use super::view::View;

const SURFELS_SIZE: u32 = 800;
const SLICE_SIZE: u32 = 512;

/// Options of `picture`.
#[derive(Args, Clone, Debug)]
pub struct PictureArgs {
    /// What a run left: a directory, a .parquet file of the table, or an .exr slice
    input: PathBuf,

    /// The PNG file to write
    #[arg(short, long, value_name = "FILE.png")]
    output: PathBuf,

    /// Column of the table: mean_curvature, gaussian_curvature, k1 or k2; mean_curvature_5vx when
    /// there are several radii
    #[arg(long, default_value = "mean_curvature")]
    column: String,

    /// The colours run from -R to R [default: 1/radius, squared for Gaussian curvature]
    #[arg(long, value_name = "R")]
    range: Option<f32>,

    /// Direction from the scene to the eye: X,Y,Z or one of x -x y -y z -z; z is up
    #[arg(long, value_name = "DIR", allow_hyphen_values = true)]
    view: Option<View>,

    /// Width in pixels [default: 800]; of a slice, the longer side, in whole multiples of its own
    /// pixels [default: 512]
    #[arg(long, value_name = "W")]
    size: Option<u32>,

    /// Colours: blue-red, blue-orange
    #[arg(long, value_name = "NAME", default_value = "blue-red")]
    palette: Palette,
}

impl PictureArgs {
    /// Draws the picture and writes it.
    ///
    /// # Errors
    ///
    /// If the input cannot be read or the output cannot be written.
    pub fn run(self) -> Result<()> {
        let ending = self.input.extension().unwrap_or_default();
        let image = if ending.eq_ignore_ascii_case("exr") {
            slice_preview(&self.input, self.size.unwrap_or(SLICE_SIZE))?
        } else {
            self.draw_table()?
        };
        let place = || self.output.display().to_string();
        let bytes = image.to_png().with_context(place)?;
        std::fs::write(&self.output, bytes).with_context(place)
    }

    fn draw_table(&self) -> Result<Image> {
        let output = OutputInfo::open(&self.input, Check::Footers)?;
        output.ensure_complete()?;
        let table = output
            .table
            .as_ref()
            .with_context(|| format!("{}: there are no surfels to draw", self.input.display()))?;
        let options = PictureOptions {
            column: self.column.clone(),
            range: self.range,
            view: self.view.unwrap_or_default(),
            width: self.size.unwrap_or(SURFELS_SIZE),
            palette: self.palette,
        };
        draw_surfels(&self.input, table, || output.clone().into_rows(), &options)
    }
}
