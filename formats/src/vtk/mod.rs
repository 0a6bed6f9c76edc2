//! Legacy VTK files with a data set of structured points, versions 1 to 5.
//!
//! In: lines of text, and the values of arrays behind their names, as big-endian numbers
//! (`BINARY`) or as text (`ASCII`). Out: a header. The file is read forward up to the first value
//! of the chosen array, so a pipe serves as well as a file. Conventions:
//!
//! - Values of `POINT_DATA` lie at the points of the grid; those of `CELL_DATA` in the middle of
//!   the boxes between them, so there is one less along each axis and the origin is half a
//!   spacing further.
//! - `ASPECT_RATIO` is an old name of `SPACING`. A negative spacing turns the axis around.
//!   The format has no unit.
//! - The array of `SCALARS`, the active one, is read unless the caller names another; of the
//!   arrays of a `FIELD` the only one, or the one that the caller names.
//! - `long` has 8 bytes, unless the file is only long enough for the 4 bytes of other machines;
//!   `vtkIdType` is stored in 4.
//! - What follows the array, other arrays and metadata, is not looked at.
//!
//! Refused: other kinds of data sets, arrays of several components, strings.

mod text;

mod arrays;

use crate::error::Error;
use crate::header::{Format, Header};
use crate::input::Input;
use crate::parsed::{Context, Parsed};
use crate::placement::{take_origin, take_spacing};
use crate::vtk::arrays::{Chosen, choose};
use crate::vtk::text::Text;

const MAGIC: &[u8] = b"# vtk DataFile Version";

/// Whether content beginning with `head` is a legacy VTK file, of whatever data set.
pub(crate) fn detect(head: &[u8]) -> bool {
    head.get(..MAGIC.len())
        .is_some_and(|head| head.eq_ignore_ascii_case(MAGIC))
}

/// The points of the grid.
struct Grid {
    /// Points along x, y, z.
    points: [u64; 3],
    /// Index of the first point.
    first: [i64; 3],
    spacing: Option<[f64; 3]>,
    origin: [f64; 3],
}

impl Grid {
    /// Boxes along x, y, z; an axis of one point has one flat box.
    fn cells(&self) -> [u64; 3] {
        self.points.map(|n| n.saturating_sub(1).max(1))
    }
}

pub(crate) fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let mut text = Text::new(input, context);
    let binary = preamble(&mut text)?;
    let grid = grid(&mut text, binary)?;
    let chosen = choose(&mut text, &grid, binary)?;
    header(&grid, chosen, &mut text, binary)
}

/// The three lines before the data set; whether values are binary.
fn preamble(text: &mut Text<'_>) -> Result<bool, Error> {
    let line = text.line()?;
    let version = line.get(MAGIC.len()..).unwrap_or_default().trim();
    let major = version.split('.').next().unwrap_or_default();
    if !detect(line.as_bytes()) || !matches!(major, "1" | "2" | "3" | "4" | "5") {
        return Err(text.unsupported(format!(
            "the first line is '{line}'; a legacy VTK file of version 1 to 5 expected"
        )));
    }
    // The title, free text.
    text.line()?;
    let kind = text.line()?;
    match kind.trim().to_ascii_uppercase().as_str() {
        "BINARY" => Ok(true),
        "ASCII" => Ok(false),
        _ => Err(text.invalid(format!(
            "the third line is '{}', ASCII or BINARY expected",
            kind.trim()
        ))),
    }
}

/// Everything up to POINT_DATA or CELL_DATA, which is left for the next reader.
fn grid(text: &mut Text<'_>, binary: bool) -> Result<Grid, Error> {
    text.expect("DATASET")?;
    let kind = text.word()?;
    if !kind.eq_ignore_ascii_case("STRUCTURED_POINTS") {
        return Err(text.unsupported(format!(
            "the data set is {}; only STRUCTURED_POINTS are voxels",
            kind.to_ascii_uppercase()
        )));
    }
    let (mut points, mut first, mut spacing, mut origin) = (None, [0; 3], None, [0.0; 3]);
    while let Some(word) = text.peek_word()? {
        match word.to_ascii_uppercase().as_str() {
            "POINT_DATA" | "CELL_DATA" => break,
            "DIMENSIONS" => {
                text.word()?;
                points = Some([text.count()?, text.count()?, text.count()?]);
            }
            "EXTENT" => {
                text.word()?;
                let mut extent = [0_u64; 3];
                for axis in 0..3 {
                    let (from, to) = (text.index()?, text.index()?);
                    first[axis] = from;
                    extent[axis] = to
                        .checked_sub(from)
                        .and_then(|n| u64::try_from(n).ok()?.checked_add(1))
                        .ok_or_else(|| text.invalid(format!("EXTENT goes from {from} to {to}")))?;
                }
                points = Some(extent);
            }
            "SPACING" | "ASPECT_RATIO" => {
                text.word()?;
                spacing = Some([text.real()?, text.real()?, text.real()?]);
            }
            "ORIGIN" => {
                text.word()?;
                origin = [text.real()?, text.real()?, text.real()?];
            }
            "FIELD" => {
                text.word()?;
                arrays::skip_field(text, binary)?;
            }
            "METADATA" => text.skip_metadata()?,
            _ => return Err(text.invalid(format!("'{word}' is no keyword of this data set"))),
        }
    }
    let Some(points) = points else {
        return Err(text.invalid("the data set has no DIMENSIONS".into()));
    };
    if points.contains(&0) {
        return Err(text.invalid(format!("DIMENSIONS are {points:?}, at least 1 expected")));
    }
    Ok(Grid {
        points,
        first,
        spacing,
        origin,
    })
}

/// The header of the array that was chosen; the text stands at its first value.
fn header(grid: &Grid, chosen: Chosen, text: &mut Text<'_>, binary: bool) -> Result<Parsed, Error> {
    let dims = if chosen.cells {
        grid.cells()
    } else {
        grid.points
    };
    let mut header = Header::new(Format::Vtk, dims, chosen.kind.dtype(binary));
    place(grid, chosen.cells, &mut header, text.context.name);
    header.details.push(("array", chosen.name));
    if chosen.cells {
        header.details.push(("values of", "cells".into()));
    }
    let mut parsed = Parsed::new(header, text.position());
    parsed.encoding = chosen.kind.encoding(binary);
    parsed.footer = true;
    if chosen.kind.is_long() && binary {
        arrays::long_or_short(&mut parsed, text.context);
    }
    Ok(parsed)
}

/// Spacing, origin and direction.
fn place(grid: &Grid, cells: bool, header: &mut Header, name: &str) {
    let mut origin = grid.origin;
    if let Some(signed) = grid.spacing {
        take_spacing(header, signed, "SPACING", name);
    }
    // Without a spacing, edges are 1.
    if header.spacing.is_some() || grid.spacing.is_none() {
        let signed = grid.spacing.unwrap_or([1.0; 3]);
        for axis in 0..3 {
            let middle = cells && grid.points[axis] > 1;
            let half = if middle { 0.5 } else { 0.0 };
            origin[axis] += signed[axis] * (grid.first[axis] as f64 + half);
        }
    }
    header.first_index = grid.first;
    take_origin(header, origin, "ORIGIN", name);
}
