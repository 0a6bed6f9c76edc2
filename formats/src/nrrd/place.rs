//! Where a NRRD volume lies.
//!
//! In: the fields and the axes of space. Out: spacing, unit, origin and direction. Space directions come
//! first, then spacings, then the ends of the axes. The world is the one of the file: which one, its field
//! `space` says, and so do the details.

use crate::error::Error;
use crate::header::{Header, Unit};
use crate::placement::{take_origin, take_spacing, take_vectors, unit};

use super::axes::{Axes, has_time};
use super::fields::Fields;

/// Fills in what the header says of the world.
pub(super) fn place(
    fields: &Fields,
    axes: &Axes,
    header: &mut Header,
    file: &str,
) -> Result<(), Error> {
    let spacings = fields.find("spacings");
    let spacings = spacings.map(|f| f.numbers(axes.count, file)).transpose()?;
    let spacings = spacings.map(|all| axes.space.map(|axis| all[axis]));
    let directions = axes.directions.as_ref().and_then(|all| {
        let [x, y, z] = axes.space.map(|axis| all[axis]);
        Some([x?, y?, z?])
    });
    let (scale, scale_unit) = factors(fields, axes, directions.is_some(), header, file)?;
    if let Some(vectors) = directions {
        let vectors = vectors.map(|v| [v[0] * scale[0], v[1] * scale[1], v[2] * scale[2]]);
        header.spacing = take_vectors(header, vectors, "space directions", file);
        if header.spacing.is_some() && spacings.is_some_and(|s| s.iter().any(|s| !s.is_nan())) {
            header.warnings.push(format!(
                "{file}: the header has spacings and space directions; the directions are used"
            ));
        }
        origin_of_space(fields, scale, header, file)?;
    } else {
        let ends = Ends::read(fields, axes, file)?;
        let (edges, field) = match (spacings, &ends) {
            (Some(spacings), _) => (Some(spacings), "spacings"),
            (None, Some(ends)) => (ends.spacing(axes), "axis maxs"),
            (None, None) => (None, ""),
        };
        // Not a number is how this format says that a spacing is unknown.
        if let Some(edges) = edges
            && !edges.iter().all(|s| s.is_nan())
        {
            let edges = std::array::from_fn(|a| edges[a] * scale[a]);
            take_spacing(header, edges, field, file);
        }
        if let (Some(ends), Some(edges)) = (ends, edges) {
            let origin = ends.origin(edges);
            let origin = std::array::from_fn(|a| origin[a] * scale[a]);
            take_origin(header, origin, "axis mins", file);
        } else if fields.find("space origin").is_some() {
            origin_of_space(fields, scale, header, file)?;
        }
    }
    if header.spacing.is_some() {
        header.unit = scale_unit;
    }
    Ok(())
}

fn origin_of_space(
    fields: &Fields,
    scale: [f64; 3],
    header: &mut Header,
    file: &str,
) -> Result<(), Error> {
    let Some(field) = fields.find("space origin") else {
        return Ok(());
    };
    let count = if has_time(fields) { 4 } else { 3 };
    let vectors = field.vectors(file)?;
    match vectors.as_slice() {
        [None] => {}
        [Some(v)] if v.len() == count => {
            let origin = [v[0] * scale[0], v[1] * scale[1], v[2] * scale[2]];
            take_origin(header, origin, "space origin", file);
        }
        _ => return Err(field.wrong(file, &format!("a vector of {count} numbers"))),
    }
    Ok(())
}

/// The unit of lengths, and the factors that bring each axis to it. Different units become the first.
fn factors(
    fields: &Fields,
    axes: &Axes,
    of_space: bool,
    header: &mut Header,
    file: &str,
) -> Result<([f64; 3], Unit), Error> {
    let time = usize::from(has_time(fields));
    let found = match (fields.find("space units"), fields.find("units")) {
        (Some(field), _) if of_space => {
            let texts = field.texts(3 + time, file)?;
            Some([texts[0].clone(), texts[1].clone(), texts[2].clone()])
        }
        (_, Some(field)) => {
            let texts = field.texts(axes.count, file)?;
            Some(axes.space.map(|axis| texts[axis].clone()))
        }
        _ => None,
    };
    let Some(texts) = found else {
        return Ok(([1.0; 3], Unit::Unknown));
    };
    if let Some(text) = texts.iter().find(|text| unit(text).is_none()) {
        header.warnings.push(format!(
            "{file}: '{text}' is no unit of length that is known; the unit is taken as unknown"
        ));
        return Ok(([1.0; 3], Unit::Unknown));
    }
    let units = texts.map(|text| unit(&text).unwrap_or_default());
    if units.iter().all(|u| *u == units[0]) {
        return Ok(([1.0; 3], units[0]));
    }
    match units.map(Unit::metres) {
        [Some(x), Some(y), Some(z)] => {
            header.warnings.push(format!(
                "{file}: the axes have different units; lengths are brought to {}",
                units[0]
            ));
            Ok(([1.0, y / x, z / x], units[0]))
        }
        _ => {
            header.warnings.push(format!(
                "{file}: the unit of some axes is not known; it is taken as unknown for all"
            ));
            Ok(([1.0; 3], Unit::Unknown))
        }
    }
}

/// The ends of the axes of space, where the header has them.
struct Ends {
    first: [f64; 3],
    last: Option<[f64; 3]>,
    /// Samples are at the nodes of a grid, not in the middle of its cells.
    node: [bool; 3],
}

impl Ends {
    fn read(fields: &Fields, axes: &Axes, file: &str) -> Result<Option<Self>, Error> {
        let of_space = |name| -> Result<Option<[f64; 3]>, Error> {
            let Some(field) = fields.find(name) else {
                return Ok(None);
            };
            let all = field.numbers(axes.count, file)?;
            Ok(Some(axes.space.map(|axis| all[axis])))
        };
        let (first, last) = (of_space("axis mins")?, of_space("axis maxs")?);
        let Some(first) = first.filter(|first| first.iter().all(|x| x.is_finite())) else {
            return Ok(None);
        };
        let last = last.filter(|last| last.iter().all(|x| x.is_finite()));
        let node = match fields.find("centerings") {
            Some(field) => {
                let all = field.texts(axes.count, file)?;
                axes.space
                    .map(|axis| all[axis].eq_ignore_ascii_case("node"))
            }
            None => [false; 3],
        };
        Ok(Some(Self { first, last, node }))
    }

    /// The edges of a voxel, if both ends are known.
    fn spacing(&self, axes: &Axes) -> Option<[f64; 3]> {
        let last = self.last?;
        Some(std::array::from_fn(|a| {
            let cells = if self.node[a] {
                axes.dims[a].saturating_sub(1)
            } else {
                axes.dims[a]
            };
            // As exact as a spacing has to be.
            (last[a] - self.first[a]) / cells as f64
        }))
    }

    /// The position of the first sample.
    fn origin(&self, edges: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| {
            if self.node[a] || !edges[a].is_finite() {
                self.first[a]
            } else {
                self.first[a] + edges[a] / 2.0
            }
        })
    }
}
