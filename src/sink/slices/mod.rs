//! Curvature slices: one OpenEXR image for each chosen slice of the volume.
//!
//! Comes in: rows. Goes out: `slices/z00000.exr` and so on, also for chosen slices without
//! surfels. A pixel is a voxel; it shows the surfels whose *inner* voxel it is. Row 0 of an image
//! is the voxel row with the smallest coordinate:
//!
//! ```text
//! across z: x to the right, y down      across y: x to the right, z down
//! across x: y to the right, z down
//! ```
//!
//! | channel | type | at a voxel with surfels (0 elsewhere) |
//! |---|---|---|
//! | `R` `G` `B` | half | preview of `curv.H`, linear light, no alpha: see [`Palette`] |
//! | `curv.H` `curv.G` `curv.k1` `curv.k2` | float | plain mean over the voxel's surfels with a finite value; 0 if there is none |
//! | `curv.area` | float | sum of their areas mu0 |
//! | `normal.X` `normal.Y` `normal.Z` | float | their mean normal, scaled to length 1 (0 if they cancel) |
//! | `surf.count` | float | their number, 1 to 6, with or without finite curvature |
//!
//! With several radii, the curvatures are those of the first. Bytes depend on the rows alone:
//! the surfels of a voxel are sorted before they are averaged.
//!
//! Memory: an image keeps the surfels it has received (40 bytes each) until it is complete: for z
//! when the rows have passed it, for x and y at the end. [`SliceMemory`] says how much that is.

mod exr_file;
mod palette;
mod selection;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use exr_file::{Drawing, Frame, LINES, Pixel};
pub use palette::Palette;
pub use selection::{SliceError, SliceSelection};

use super::SurfelSink;
use super::batch::SurfelBatch;
use super::error::SinkError;
use super::info::TableInfo;
use super::output::{SLICES_DIRECTORY, make_folder};
use super::parts::Parts;

/// Surfels for each pixel of a slice that a plan should expect: a rough surface in every tenth
/// voxel, with its staircase.
const EXPECTED_SURFELS_PER_PIXEL: u64 = 5;
const EXPECTED_DIVISOR: u64 = 20;

/// Surfels for each pixel that a slice can have at most: with a share f of inside pixels, 2 f
/// across the slice and the lesser of 4 f and 4 (1 - f) along it. (The border of a closed image
/// adds less than a row.)
const MOST_SURFELS_PER_PIXEL: u64 = 3;

/// What slices look like.
#[derive(Clone, Debug, PartialEq)]
pub struct SliceOptions {
    /// Which slices.
    pub selection: SliceSelection,
    /// Colours of the preview.
    pub palette: Palette,
    /// The preview's scale runs from minus to plus this mean curvature, in 1/world-unit; `None`
    /// for 1/radius.
    pub range: Option<f32>,
    /// Stop with an error rather than keep more than this many bytes of surfels; `None` for no
    /// limit.
    pub budget_bytes: Option<u64>,
}

/// Memory that slices take while a run is under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SliceMemory {
    /// For a surface such as a scan has.
    pub expected_bytes: u64,
    /// For the worst possible image.
    pub bound_bytes: u64,
}

impl SliceMemory {
    /// What a selection takes. `planes_whole` says that all columns of parts advance together, so
    /// that slices across z are complete when the rows have passed them.
    ///
    /// # Errors
    ///
    /// If an index of the selection is beyond the image.
    pub fn of(
        dims: [u32; 3],
        selection: &SliceSelection,
        planes_whole: bool,
    ) -> Result<Self, SliceError> {
        let chosen = selection.indices(dims)?.len() as u64;
        // Rows at an even kz touch two voxel planes.
        let open = if selection.axis() == 2 && planes_whole {
            chosen.min(2)
        } else {
            chosen
        };
        let (width, height) = frame_size(dims, selection.axis());
        let pixels = u64::from(width)
            .saturating_mul(u64::from(height))
            .saturating_mul(open);
        // A growing list may hold twice its contents.
        let per_surfel = 2 * size_of::<Pixel>() as u64;
        let drawing = Drawing::band_bytes(width).saturating_mul(threads() as u64 * 2);
        let with = |surfels: u64| surfels.saturating_mul(per_surfel).saturating_add(drawing);
        let expected = pixels.saturating_mul(EXPECTED_SURFELS_PER_PIXEL) / EXPECTED_DIVISOR;
        let most = pixels.saturating_mul(MOST_SURFELS_PER_PIXEL);
        Ok(Self {
            expected_bytes: with(expected),
            bound_bytes: with(most),
        })
    }
}

fn threads() -> usize {
    rayon::current_num_threads()
}

/// Width and height of the slices across an axis.
fn frame_size(dims: [u32; 3], axis: usize) -> (u32, u32) {
    match axis {
        0 => (dims[1], dims[2]),
        1 => (dims[0], dims[2]),
        _ => (dims[0], dims[1]),
    }
}

/// Draws the chosen slices.
pub struct SliceSink {
    folder: PathBuf,
    info: TableInfo,
    axis: usize,
    drawing: Drawing,
    /// Chosen slices not yet written; an image has lists of surfels, one for [`LINES`] rows.
    open: BTreeMap<u32, Vec<Vec<Pixel>>>,
    /// For each column of parts, rows below this `kz` have all come.
    passed: BTreeMap<[u32; 2], i32>,
    held_bytes: u64,
    budget_bytes: u64,
    /// Finished, or stopped by an error: nothing more may become a file.
    closed: bool,
}

impl SliceSink {
    /// Begins the slices below `directory`, which [`super::prepare_output`] made ready.
    ///
    /// # Errors
    ///
    /// If `info` is not valid, a slice is beyond the image, or the folder cannot be made.
    pub fn create(
        directory: &Path,
        info: TableInfo,
        options: &SliceOptions,
    ) -> Result<Self, SinkError> {
        info.check()?;
        let chosen = options
            .selection
            .indices(info.dims)
            .map_err(|error| SinkError::Unsupported(error.to_string()))?;
        let axis = options.selection.axis();
        let (width, height) = frame_size(info.dims, axis);
        // The narrowing loses digits of a colour scale only.
        let range = options.range.unwrap_or((1.0 / info.radii[0].world) as f32);
        if !(range > 0.0 && range.is_finite()) {
            return Err(SinkError::Unsupported(format!(
                "a preview range of ±{range}"
            )));
        }
        let drawing = Drawing::new(&info, axis, [width, height], options.palette, range);
        let folder = directory.join(SLICES_DIRECTORY);
        make_folder(&folder)?;
        let [columns_x, columns_y] = Parts::new(info.dims).columns();
        let passed = (0..columns_y)
            .flat_map(|y| (0..columns_x).map(move |x| ([x, y], i32::MIN)))
            .collect();
        let open = chosen
            .into_iter()
            .map(|index| (index, Vec::new()))
            .collect();
        let budget_bytes = options.budget_bytes.unwrap_or(u64::MAX);
        Ok(Self {
            folder,
            info,
            axis,
            drawing,
            open,
            passed,
            held_bytes: 0,
            budget_bytes,
            closed: false,
        })
    }

    /// Width and height of the slices across an axis.
    #[must_use]
    pub fn size(dims: [u32; 3], axis: usize) -> [u32; 2] {
        let (width, height) = frame_size(dims, axis);
        [width, height]
    }

    /// The file name of a slice.
    #[must_use]
    pub fn file_name(axis: usize, index: u32) -> String {
        format!("{}{index:05}.exr", ['x', 'y', 'z'][axis])
    }

    /// Refuses anything after the end or an error; see [`SurfelSink`].
    fn begin(&mut self) -> Result<(), SinkError> {
        // Open again only when the operation has succeeded.
        if std::mem::replace(&mut self.closed, true) {
            return Err(SinkError::Contract(
                "the slices are closed or have failed".into(),
            ));
        }
        Ok(())
    }

    /// Notes that a column has passed `kz`, and writes what that completes.
    fn pass(&mut self, column: [u32; 2], kz: i32) -> Result<(), SinkError> {
        match self.passed.get_mut(&column) {
            Some(passed) => *passed = kz.max(*passed),
            None => {
                return Err(SinkError::Contract(format!(
                    "there is no column {column:?}"
                )));
            }
        }
        self.write_passed()
    }

    /// Writes the slices across z that no further row can touch.
    fn write_passed(&mut self) -> Result<(), SinkError> {
        if self.axis != 2 {
            return Ok(());
        }
        let kz = self.passed.values().copied().min().unwrap_or(i32::MIN);
        while let Some((&index, _)) = self.open.first_key_value() {
            // Voxel plane `index` has surfels with kz from 2 index to 2 index + 2.
            if i64::from(kz) <= 2 * i64::from(index) + 2 {
                break;
            }
            self.write_slice(index)?;
        }
        Ok(())
    }

    fn write_slice(&mut self, index: u32) -> Result<(), SinkError> {
        let Some(bands) = self.open.remove(&index) else {
            return Ok(());
        };
        let held: usize = bands.iter().map(Vec::len).sum();
        self.held_bytes -= (held * size_of::<Pixel>()) as u64;
        let path = self.folder.join(Self::file_name(self.axis, index));
        self.drawing.write(&path, &Frame { index, bands })
    }

    /// Keeps the rows `range` that lie in chosen slices not yet written.
    fn take(&mut self, batch: &SurfelBatch, range: Range<usize>) -> Result<(), SinkError> {
        let Some(at) = batch.curvatures.first() else {
            return Ok(());
        };
        let [right, down] = match self.axis {
            0 => [1, 2],
            1 => [0, 2],
            _ => [0, 1],
        };
        let mut added = 0;
        for row in range {
            let (voxel, face) = inner_voxel(batch.k_at(row), batch.side[row], self.info.dims)?;
            let Some(bands) = self.open.get_mut(&voxel[self.axis]) else {
                continue;
            };
            let band = (voxel[down] / LINES) as usize;
            if bands.len() <= band {
                bands.resize_with(band + 1, Vec::new);
            }
            let [nx, ny, nz] = [0, 1, 2].map(|axis| batch.normal[axis][row]);
            bands[band].push(Pixel {
                place: self.drawing.place(voxel[right], voxel[down] % LINES, face),
                curvature: [at.mean[row], at.gaussian[row], at.k1[row], at.k2[row]],
                area: batch.area[row],
                normal: [nx, ny, nz],
            });
            added += size_of::<Pixel>() as u64;
        }
        self.held_bytes += added;
        if self.held_bytes > self.budget_bytes {
            return Err(SinkError::Unsupported(format!(
                "the chosen slices hold {} surfels, {} bytes, at once, above the {} bytes granted; \
                 choose fewer slices or raise the memory",
                self.held_bytes / size_of::<Pixel>() as u64,
                self.held_bytes,
                self.budget_bytes
            )));
        }
        Ok(())
    }
}

/// The voxel on the inside of a surfel, and which of its six faces the surfel is, in the Khalimsky
/// order of their centres.
fn inner_voxel(k: [i32; 3], side: i8, dims: [u32; 3]) -> Result<([u32; 3], u8), SinkError> {
    let contract =
        || SinkError::Contract(format!("{k:?} with side {side} is no surfel of the image"));
    let mut even = None;
    for axis in 0..3 {
        if k[axis] & 1 == 0 && even.replace(axis).is_some() {
            return Err(contract());
        }
    }
    let axis = even
        .filter(|_| side == 1 || side == -1)
        .ok_or_else(contract)?;
    let mut inner = k;
    inner[axis] -= i32::from(side);
    let mut voxel = [0; 3];
    for a in 0..3 {
        // Odd now, so this is (K - 1) / 2.
        let index = u32::try_from(inner[a].div_euclid(2)).map_err(|_| contract())?;
        if index >= dims[a] {
            return Err(contract());
        }
        voxel[a] = index;
    }
    let face = match (axis, side) {
        (2, -1) => 0,
        (1, -1) => 1,
        (0, -1) => 2,
        (0, _) => 3,
        (1, _) => 4,
        _ => 5,
    };
    Ok((voxel, face))
}

impl SurfelSink for SliceSink {
    fn write(&mut self, batch: &SurfelBatch) -> Result<(), SinkError> {
        self.begin()?;
        batch.check(&self.info)?;
        // Plane by plane, so that no more slices are open than need be.
        let mut from = 0;
        while from < batch.len() {
            let kz = batch.k[2][from];
            let to = from + batch.k[2][from..].partition_point(|&k| k <= kz);
            self.pass(batch.column, kz)?;
            self.take(batch, from..to)?;
            from = to;
        }
        self.closed = false;
        Ok(())
    }

    fn advance(&mut self, column: [u32; 2], kz: i32) -> Result<(), SinkError> {
        self.begin()?;
        self.pass(column, kz)?;
        self.closed = false;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.begin()?;
        while let Some((&index, _)) = self.open.first_key_value() {
            self.write_slice(index)?;
        }
        Ok(())
    }
}
