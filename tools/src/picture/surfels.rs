//! Surfels as a picture.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use curvox::sink::{CurvatureColumns, Palette, SinkError, SurfelBatch, TableInfo};
use glam::{DMat3, DVec2, DVec3};

use super::bar::{self, Bar};
use super::colours::ColourMap;
use super::image::Image;
use super::raster::{Canvas, SAMPLES};
use super::view::{Frame, View};

/// Smallest and largest width of a picture. Below, the colour bar is not legible; above, the
/// samples take gigabytes.
pub(super) const WIDTHS: std::ops::RangeInclusive<u32> = 160..=4096;

/// Most height of the scene, as a share of the picture's width.
const TALLEST: f64 = 1.25;

/// White around the scene, as a share of the picture's width.
const MARGIN: f64 = 0.03;

/// Light on a surface that the eye sees at a right angle is 1, at a grazing angle this. Lower hides
/// colours, higher hides shapes.
const GRAZING_LIGHT: f64 = 0.35;

/// The side of a surfel that faces the solid; seen where the border of the image cuts the surface.
const INNER_SIDE: f32 = 0.35;

/// What a picture shows.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureOptions {
    /// Column of the table: `mean_curvature`, `gaussian_curvature`, `k1` or `k2`, with the ending
    /// of a radius or, for the first radius, without.
    pub column: String,
    /// The colours run from minus to plus this; `None` for 1/radius, or its square for Gaussian
    /// curvature.
    pub range: Option<f32>,
    /// Where it is seen from.
    pub view: View,
    /// Width in pixels; the height follows.
    pub width: u32,
    /// The colours.
    pub palette: Palette,
}

impl Default for PictureOptions {
    fn default() -> Self {
        Self {
            column: "mean_curvature".into(),
            range: None,
            view: View::default(),
            width: 800,
            palette: Palette::default(),
        }
    }
}

/// A column of curvatures.
struct Shown {
    /// Which of the radii.
    radius: usize,
    values: fn(&CurvatureColumns) -> &Vec<f32>,
    /// 1 for a curvature in 1/length, 2 for one in 1/length squared.
    power: i32,
}

impl Shown {
    fn find(name: &str, info: &TableInfo) -> Result<Self> {
        type Values = fn(&CurvatureColumns) -> &Vec<f32>;
        let columns: [(&str, Values, i32); 4] = [
            ("mean_curvature", |at| &at.mean, 1),
            ("gaussian_curvature", |at| &at.gaussian, 2),
            ("k1", |at| &at.k1, 1),
            ("k2", |at| &at.k2, 1),
        ];
        for (column, values, power) in columns {
            let Some(ending) = name.strip_prefix(column) else {
                continue;
            };
            let radius = info.radii.iter().position(|r| r.suffix() == ending);
            let first = ending.is_empty().then_some(0);
            if let Some(radius) = first.or(radius) {
                return Ok(Self {
                    radius,
                    values,
                    power,
                });
            }
        }
        let endings: Vec<_> = info.radii.iter().map(|r| r.suffix()).collect();
        bail!(
            "column: found {name:?}, expected mean_curvature, gaussian_curvature, k1 or k2, \
             alone or with one of the endings {}",
            endings.join(" ")
        )
    }
}

/// Draws the surfels of a table. `rows` begins to read them, and is called twice; `path` names the
/// table in errors.
///
/// # Errors
///
/// If rows cannot be read or are no surfels, if there are none, or if an option does not fit.
pub fn draw_surfels<I>(
    path: &Path,
    info: &TableInfo,
    rows: impl Fn() -> I,
    options: &PictureOptions,
) -> Result<Image>
where
    I: IntoIterator<Item = Result<SurfelBatch, SinkError>>,
{
    let shown = Shown::find(&options.column, info)?;
    let range = match options.range {
        Some(range) => range,
        None => info.radii[shown.radius].world.powi(-shown.power) as f32,
    };
    ensure!(
        range.is_finite() && range > 0.0,
        "range: found {range}, expected a positive number"
    );
    let colours = ColourMap::of_palette(options.palette, range);
    let scene = Scene {
        path,
        info,
        view: options.view,
        width: options.width,
        sticks: &[],
    };
    let picture = scene.draw(rows, |batch, row, _| {
        let values = batch.curvatures.get(shown.radius).map(shown.values);
        let value = values.and_then(|values| values.get(row)).copied();
        colours.colour(value.unwrap_or(f32::NAN))
    })?;
    let [width, height] = picture.size();
    let mut image = Image::white([width, height + bar::height(width)]);
    image.paste([0, 0], &picture);
    let square = if shown.power == 2 { "^2" } else { "" };
    let title = format!(
        "{} (1/{}{square})",
        options.column.replace('_', " "),
        info.unit
    );
    Bar { colours, title }.draw(&mut image, 0, width);
    Ok(image)
}

/// A short line on the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stick {
    /// Its middle, in the world.
    pub centre: DVec3,
    /// Along it, a unit vector.
    pub direction: DVec3,
    /// In world units.
    pub length: f64,
}

/// Width of a stick, as a share of its length on the picture when it is seen at a right angle.
const STICK_WIDTH: f64 = 0.16;

/// How far sticks are lifted towards the eye, in voxels: the staircase of the surface rises up to
/// one voxel above its mean, and would hide them; more would show those behind the rim.
const STICK_LIFT: f64 = 1.5;

/// What is drawn, but for the colours.
pub struct Scene<'a> {
    /// Names the table in errors.
    pub path: &'a Path,
    /// Frame of the surfels.
    pub info: &'a TableInfo,
    /// Where it is seen from.
    pub view: View,
    /// Width in pixels; the height follows.
    pub width: u32,
    /// Black lines on the surface.
    pub sticks: &'a [Stick],
}

impl Scene<'_> {
    /// Draws the surfels, shaded, and the sticks. `rows` begins to read the surfels, and is called
    /// twice; `colour` gives the linear light of a row of a batch, which is that many rows after the
    /// first.
    ///
    /// # Errors
    ///
    /// If rows cannot be read or are no surfels, if there are none, or if the width does not fit.
    pub fn draw<I>(
        &self,
        rows: impl Fn() -> I,
        mut colour: impl FnMut(&SurfelBatch, usize, usize) -> [f32; 3],
    ) -> Result<Image>
    where
        I: IntoIterator<Item = Result<SurfelBatch, SinkError>>,
    {
        ensure!(
            WIDTHS.contains(&self.width),
            "size: found {}, expected {} to {}",
            self.width,
            WIDTHS.start(),
            WIDTHS.end()
        );
        let width = usize::try_from(self.width)?;
        let frame = self.view.frame();
        let voxel = Voxel::of(self.info, &frame);

        let mut extent = Extent::default();
        for_each_surfel(self.path, rows(), |batch, row, axis| {
            extent.add(frame.world_to_frame(centre(batch, row)?), voxel.edges(axis));
            Ok(())
        })?;
        let place = extent
            .place(width)
            .with_context(|| format!("{}: there are no surfels to draw", self.path.display()))?;

        let mut canvas = Canvas::new([width, place.height]);
        let mut passed = 0;
        for_each_surfel(self.path, rows(), |batch, row, axis| {
            let outer = voxel.faces_eye[axis] * f64::from(batch.side[row]) > 0.0;
            let colour = if outer {
                colour(batch, row, passed)
            } else {
                [INNER_SIDE; 3]
            };
            passed += 1;
            let u = DVec3::from_array([0, 1, 2].map(|a| f64::from(batch.normal[a][row])));
            // Of a surface seen from within, the normal points away. A NaN becomes 0.
            let cosine = (frame.eye.dot(u) * if outer { 1.0 } else { -1.0 })
                .clamp(-1.0, 1.0)
                .max(0.0);
            let light = (GRAZING_LIGHT + (1.0 - GRAZING_LIGHT) * cosine) as f32;
            canvas.draw(
                place.on_canvas(frame.world_to_frame(centre(batch, row)?)),
                voxel.edges(axis).map(|edge| place.edge_on_canvas(edge)),
                colour.map(|channel| channel * light),
            );
            Ok(())
        })?;
        let edges = self.info.spacing;
        let lift = STICK_LIFT * edges[0].max(edges[1]).max(edges[2]);
        for stick in self.sticks {
            let middle = frame.world_to_frame(stick.centre + frame.eye * lift);
            let along = frame.world_to_frame(stick.direction * stick.length);
            let across = along.truncate().perp().normalize_or_zero() * (stick.length * STICK_WIDTH);
            canvas.draw(
                place.on_canvas(middle),
                [along, across.extend(0.0)].map(|edge| place.edge_on_canvas(edge)),
                [0.0; 3],
            );
        }
        let mut image = Image::white([width, place.height]);
        canvas.into_image(&mut image);
        Ok(image)
    }
}

/// Goes through the rows: batch, row in it, the axis across the surfel.
fn for_each_surfel<I>(
    path: &Path,
    rows: I,
    mut take: impl FnMut(&SurfelBatch, usize, usize) -> Result<()>,
) -> Result<()>
where
    I: IntoIterator<Item = Result<SurfelBatch, SinkError>>,
{
    let mut passed = 0_u64;
    for batch in rows {
        let batch = batch?;
        for row in 0..batch.len() {
            let k = batch.k_at(row);
            let at = || format!("{}: row {passed}", path.display());
            let mut even = (0..3).filter(|&axis| k[axis] & 1 == 0);
            let (Some(axis), None) = (even.next(), even.next()) else {
                bail!(
                    "{}: found {k:?}, expected exactly one even coordinate",
                    at()
                );
            };
            take(&batch, row, axis).with_context(at)?;
            passed += 1;
        }
    }
    Ok(())
}

/// The world coordinates of a surfel's centre.
fn centre(batch: &SurfelBatch, row: usize) -> Result<DVec3> {
    let centre = DVec3::from_array([0, 1, 2].map(|axis| f64::from(batch.position[axis][row])));
    ensure!(
        centre.is_finite(),
        "position: found {centre}, expected finite numbers"
    );
    Ok(centre)
}

/// A voxel as it is seen.
struct Voxel {
    /// Its three edges, in the frame of the picture.
    edges: [DVec3; 3],
    /// For the face across each axis: positive if the one with side +1 faces the eye.
    faces_eye: [f64; 3],
}

impl Voxel {
    fn of(info: &TableInfo, frame: &Frame) -> Self {
        // The rows of `direction` are those of the matrix, glam takes columns.
        let direction = DMat3::from_cols_array_2d(&info.direction).transpose();
        let world = [0, 1, 2].map(|axis| direction.col(axis) * info.spacing[axis]);
        let faces_eye = [0, 1, 2].map(|axis| {
            let across = world[(axis + 1) % 3].cross(world[(axis + 2) % 3]);
            // In a mirrored or sheared image the product may point inward.
            frame.eye.dot(across) * across.dot(world[axis]).signum()
        });
        Self {
            edges: world.map(|edge| frame.world_to_frame(edge)),
            faces_eye,
        }
    }

    /// The edges of a surfel across the axis.
    fn edges(&self, axis: usize) -> [DVec3; 2] {
        [self.edges[(axis + 1) % 3], self.edges[(axis + 2) % 3]]
    }
}

/// What the scene takes in the picture's plane, in world units.
struct Extent {
    low: DVec2,
    high: DVec2,
}

impl Default for Extent {
    fn default() -> Self {
        Self {
            low: DVec2::INFINITY,
            high: DVec2::NEG_INFINITY,
        }
    }
}

impl Extent {
    fn add(&mut self, centre: DVec3, edges: [DVec3; 2]) {
        let half = 0.5 * (edges[0].abs() + edges[1].abs()).truncate();
        self.low = self.low.min(centre.truncate() - half);
        self.high = self.high.max(centre.truncate() + half);
    }

    /// Where the scene goes in a picture of so many pixels; `None` if it has no size.
    fn place(&self, width: usize) -> Option<Place> {
        let size = self.high - self.low;
        let width = width as f64;
        let room = width * (1.0 - 2.0 * MARGIN);
        let scale = (room / size.x).min(width * TALLEST / size.y);
        if !(size.is_finite() && scale.is_finite() && scale > 0.0) {
            return None;
        }
        let height = size.y * scale + 2.0 * MARGIN * width;
        Some(Place {
            middle: 0.5 * (self.low + self.high),
            scale: scale * SAMPLES as f64,
            // At most TALLEST and the margins times a width within WIDTHS.
            height: height.ceil() as usize,
            canvas_middle: 0.5 * SAMPLES as f64 * DVec2::new(width, height.ceil()),
        })
    }
}

/// From the frame of the picture to the canvas.
struct Place {
    /// Middle of the scene, in the frame.
    middle: DVec2,
    /// Samples for each world unit.
    scale: f64,
    /// Pixels.
    height: usize,
    /// Samples.
    canvas_middle: DVec2,
}

impl Place {
    fn edge_on_canvas(&self, v: DVec3) -> DVec3 {
        DVec3::new(v.x, -v.y, v.z) * self.scale
    }

    fn on_canvas(&self, p: DVec3) -> DVec3 {
        self.edge_on_canvas(p - self.middle.extend(0.0)) + self.canvas_middle.extend(0.0)
    }
}
