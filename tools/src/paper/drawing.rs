//! Rows to coloured surfaces: what the figures with pictures share.

use std::path::Path;

use anyhow::Result;
use curvox::sink::{Palette, SinkError};

use super::convergence::Curvature;
use super::page;
use super::rows::Rows;
use super::study::Study;
use crate::picture::{Bar, ColourMap, Image, Montage, Scene, Stick, View};

/// Dark blue, white, red, and black around 0, as the figures of the paper.
pub fn signed(range: f32, band: f32) -> ColourMap {
    ColourMap::Signed {
        palette: Palette::BlueRed,
        range,
        band,
    }
}

/// The colours of Goursat's figures: H, or G.
pub fn of_goursat(curvature: Curvature) -> ColourMap {
    match curvature {
        Curvature::Mean => signed(0.3, 0.01),
        Curvature::Gaussian => signed(0.1, 0.002),
    }
}

/// A colour bar.
pub fn bar(colours: ColourMap, title: &str) -> Bar {
    Bar {
        colours,
        title: title.to_owned(),
    }
}

/// The surface of a table, each surfel coloured by the value of its row.
///
/// # Errors
/// If the rows cannot be drawn.
pub fn surface(
    study: &Study,
    rows: &Rows,
    colours: ColourMap,
    sticks: &[Stick],
    value: impl Fn(usize) -> f64,
) -> Result<Image> {
    let scene = Scene {
        path: Path::new("rows"),
        info: &rows.info,
        view: View::default(),
        width: study.picture_width(),
        sticks,
    };
    let all = || [Ok::<_, SinkError>(rows.batch.clone())];
    scene.draw(all, |_, _, row| colours.colour(value(row) as f32))
}

/// Writes a montage as `NAME.png`.
///
/// # Errors
/// If it cannot be written.
pub fn write(study: &Study, name: &str, montage: &Montage) -> Result<()> {
    page::write(
        &study.folder,
        &format!("{name}.png"),
        montage.image().with_few_shades().to_png()?,
    )
}
