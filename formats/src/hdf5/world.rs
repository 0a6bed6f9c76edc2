//! Spacing, origin and directions, by the conventions of those who write HDF5.
//!
//! In: the chosen dataset. Out: the header with what the file says of the world. Read:
//! `element_size_um` (Fiji, ilastik), `voxel_size`, `pixel_size` and `resolution` with a unit, the
//! axes of NeXus, the extents of Imaris, the dimensions of MINC 2. What cannot be used is warned
//! about.

use super::attribute::Attributes;
use super::choose::Choice;
use super::dataset::{Dataset, Selection};
use crate::error::Error;
use crate::header::{Header, Scaling, Unit};

/// Fills the header. What comes back is a scale for each plane, where these differ, or one
/// for all that a header cannot have.
pub(super) fn describe(
    choice: &Choice<'_>,
    dataset: &Dataset,
    own: &Attributes,
    selection: &Selection,
    header: &mut Header,
) -> Result<Option<Vec<Scaling>>, Error> {
    let parts: Vec<_> = dataset.path.trim_matches('/').split('/').collect();
    match parts.as_slice() {
        [image, level, time, channel, "Data"] if image.starts_with("DataSet") => {
            let info = image.replacen("DataSet", "DataSetInfo", 1);
            let group = format!("/{image}/{level}/{time}/{channel}");
            imaris(choice, &format!("/{info}/Image"), &group, header)?;
            return Ok(None);
        }
        ["minc-2.0", "image", level, "image"] => {
            minc(choice, dataset, own, header)?;
            return scaling(choice, own, level, header);
        }
        _ => {}
    }
    if sizes(own, dataset, selection, header) {
        return Ok(None);
    }
    nexus(choice, dataset, own, selection, header)?;
    Ok(None)
}

fn positive(spacing: [f64; 3]) -> bool {
    spacing.iter().all(|s| s.is_finite() && *s > 0.0)
}

/// Sizes of a voxel as an attribute of the dataset, in the order of its axes. Whether there is
/// one that can be used.
fn sizes(own: &Attributes, dataset: &Dataset, selection: &Selection, header: &mut Header) -> bool {
    let [z, y, x] = selection.volume;
    // Along x, y, z, from a value for each axis of the dataset or of the volume.
    let ordered = |values: &[f64]| {
        let at = |axis: Option<usize>, n: usize| {
            let axis = if values.len() == dataset.dims.len() {
                axis
            } else {
                Some(n)
            };
            axis.and_then(|axis| values.get(axis).copied())
        };
        match values.len() {
            n if n == 3 || n == dataset.dims.len() => Some([at(x, 2)?, at(y, 1)?, at(z, 0)?]),
            _ => None,
        }
    };
    for name in ["element_size_um", "voxel_size", "pixel_size", "resolution"] {
        let Some(values) = own.numbers(name) else {
            continue;
        };
        let unit = if name == "element_size_um" {
            Some(Unit::Micrometre)
        } else {
            [
                format!("{name}_unit"),
                format!("{name}_units"),
                "unit".into(),
                "units".into(),
            ]
            .iter()
            .find_map(|name| own.texts(name)?.first()?.trim().parse().ok())
            .filter(|unit| *unit != Unit::Unknown)
        };
        match (ordered(&values).filter(|spacing| positive(*spacing)), unit) {
            (Some(spacing), Some(unit)) => {
                header.spacing = Some(spacing);
                header.unit = unit;
                return true;
            }
            (Some(_), None) => header.warnings.push(format!(
                "attribute {name} of dataset {} was ignored: it has no unit of length",
                dataset.path
            )),
            (None, _) => header.warnings.push(format!(
                "attribute {name} of dataset {} was ignored: {values:?} are not three sizes",
                dataset.path
            )),
        }
    }
    false
}

/// Positions along the axes of a signal, in datasets beside it that an attribute names.
fn nexus(
    choice: &Choice<'_>,
    dataset: &Dataset,
    own: &Attributes,
    selection: &Selection,
    header: &mut Header,
) -> Result<(), Error> {
    let Some((parent, name)) = dataset.path.rsplit_once('/') else {
        return Ok(());
    };
    let group = choice.attributes(if parent.is_empty() { "/" } else { parent })?;
    let names = if group.text("signal").as_deref() == Some(name) {
        group.texts("axes")
    } else {
        None
    };
    let names = names.or_else(|| own.texts("axes")).unwrap_or_default();
    let names: Vec<String> = match names.as_slice() {
        [one] => {
            let one = one.trim_matches(['[', ']']);
            one.split([':', ','])
                .map(|name| name.trim().to_owned())
                .collect()
        }
        _ => names,
    };
    if names.len() != dataset.dims.len() {
        return Ok(());
    }
    let (mut steps, mut starts, mut units) = ([1.0; 3], [0.0; 3], Vec::new());
    // z, y, x in the selection, x first in the header.
    for (a, axis) in selection.volume.into_iter().rev().enumerate() {
        let Some(name) = axis.and_then(|axis| names.get(axis)) else {
            return Ok(());
        };
        let path = format!("{parent}/{name}");
        let Some(positions) = choice.dataset(&path)? else {
            return Ok(());
        };
        let unit = positions.attributes(choice.file)?.text("units");
        units.push(
            unit.and_then(|unit| unit.trim().parse().ok())
                .unwrap_or(Unit::Unknown),
        );
        let values = positions.values(choice.file)?.unwrap_or_default();
        let Some((start, step)) = regular(&values, header.dims[a]) else {
            header.warnings.push(format!(
                "positions {path} were ignored: they are not {} in equal steps",
                header.dims[a]
            ));
            return Ok(());
        };
        (starts[a], steps[a]) = (start, step);
    }
    if units.iter().any(|unit| *unit != units[0]) {
        header.warnings.push(format!(
            "positions along the axes of {} were ignored: their units differ",
            dataset.path
        ));
        return Ok(());
    }
    header.spacing = Some(steps.map(f64::abs));
    header.unit = units[0];
    header.origin = starts;
    for a in 0..3 {
        header.direction[a][a] = steps[a].signum();
    }
    Ok(())
}

/// First value and step of `count` values, if they are in equal steps.
fn regular(values: &[f64], count: u64) -> Option<(f64, f64)> {
    /// Positions in single precision, or given with few digits, are as equal as this.
    const TOLERANCE: f64 = 1e-3;
    let (first, last) = (*values.first()?, *values.last()?);
    if values.len() as u64 != count || count < 2 {
        return None;
    }
    let step = (last - first) / (count - 1) as f64;
    let equal = values
        .windows(2)
        .all(|pair| ((pair[1] - pair[0]) / step - 1.0).abs() <= TOLERANCE);
    (equal && step.is_finite() && step != 0.0 && first.is_finite()).then_some((first, step))
}

/// Imaris: extents of the whole image; chunks fill it up, and the size is an attribute.
fn imaris(choice: &Choice<'_>, info: &str, group: &str, header: &mut Header) -> Result<(), Error> {
    let size = choice.attributes(group)?;
    let info = choice.attributes(info)?;
    for (a, axis) in ["X", "Y", "Z"].into_iter().enumerate() {
        let Some(n) = size.number(&format!("ImageSize{axis}")) else {
            continue;
        };
        if !(1.0..=header.dims[a] as f64).contains(&n) {
            return Err(Error::invalid(
                choice.file.name(),
                format!(
                    "{group} has ImageSize{axis} {n}, its dataset {} voxels along {axis}",
                    header.dims[a]
                ),
            ));
        }
        header.dims[a] = n as u64;
    }
    let extent = |which: &str, a: usize| info.number(&format!("Ext{which}{a}"));
    let (mut spacing, mut origin) = ([0.0; 3], [0.0; 3]);
    for a in 0..3 {
        let (Some(from), Some(to)) = (extent("Min", a), extent("Max", a)) else {
            return Ok(());
        };
        spacing[a] = (to - from) / header.dims[a] as f64;
        origin[a] = from + spacing[a] / 2.0;
    }
    if !positive(spacing) || !origin.iter().all(|x| x.is_finite()) {
        header
            .warnings
            .push("the extents of the Imaris image were ignored: they are not in order".into());
        return Ok(());
    }
    header.spacing = Some(spacing);
    header.origin = origin;
    // Imaris counts in micrometres where nothing else is said.
    header.unit = match info.text("Unit") {
        Some(unit) => unit.trim().parse().unwrap_or(Unit::Unknown),
        None => Unit::Micrometre,
    };
    Ok(())
}

/// MINC 2: each axis is a dimension with a step, a start and a direction.
fn minc(
    choice: &Choice<'_>,
    dataset: &Dataset,
    own: &Attributes,
    header: &mut Header,
) -> Result<(), Error> {
    let order = own
        .text("dimorder")
        .unwrap_or_else(|| "zspace,yspace,xspace".into());
    let names: Vec<_> = order.split(',').map(str::trim).collect();
    if names.len() != dataset.dims.len() {
        return Err(Error::invalid(
            choice.file.name(),
            format!(
                "dimorder '{order}' of a dataset of extents {:?}",
                dataset.dims
            ),
        ));
    }
    let mut starts = [0.0; 3];
    let mut steps = [1.0; 3];
    let mut any = false;
    for (a, name) in names.iter().rev().take(3).enumerate() {
        let world = match name.bytes().next() {
            Some(b'x') => 0,
            Some(b'y') => 1,
            Some(b'z') => 2,
            _ => {
                return Err(Error::unsupported(
                    choice.file.name(),
                    format!("a MINC volume with the dimension {name} is not read here"),
                ));
            }
        };
        let path = format!("/minc-2.0/dimensions/{name}");
        let dimension = choice.attributes(&path)?;
        let step = dimension.number("step");
        any |= step.is_some();
        steps[a] = step.unwrap_or(1.0);
        starts[a] = dimension.number("start").unwrap_or(0.0);
        let mut cosines = [0.0; 3];
        cosines[world] = 1.0;
        if let Some(values) = dimension.numbers("direction_cosines")
            && let Ok(values) = <[f64; 3]>::try_from(values)
        {
            cosines = values;
        }
        let length = cosines.iter().map(|c| c * c).sum::<f64>().sqrt();
        let sound = length.is_finite() && length > 1e-6 && steps[a].is_finite() && steps[a] != 0.0;
        if !sound || !starts[a].is_finite() {
            return Err(Error::invalid(
                choice.file.name(),
                format!(
                    "{path} has step {}, start {} and cosines {cosines:?}",
                    steps[a], starts[a]
                ),
            ));
        }
        for row in 0..3 {
            header.direction[row][a] = cosines[row] / length;
        }
        if let Some(unit) = dimension.text("units") {
            header.unit = unit.trim().parse().unwrap_or(Unit::Unknown);
        }
    }
    // Starts are along the directions, before these turn around for a negative step.
    for row in 0..3 {
        header.origin[row] = (0..3).map(|a| header.direction[row][a] * starts[a]).sum();
    }
    for a in 0..3 {
        if steps[a] < 0.0 {
            (0..3).for_each(|row| header.direction[row][a] *= -1.0);
        }
    }
    if any {
        header.spacing = Some(steps.map(f64::abs));
    } else {
        header.unit = Unit::Unknown;
    }
    Ok(())
}

/// Stored values of MINC lie in `valid_range`, and mean `image-min` to `image-max`, of the volume or
/// of each plane.
fn scaling(
    choice: &Choice<'_>,
    own: &Attributes,
    level: &str,
    header: &mut Header,
) -> Result<Option<Vec<Scaling>>, Error> {
    if header.voxel.is_float() {
        return Ok(None);
    }
    let planes = header.dims[2];
    let values = |name: &str| -> Result<Option<Vec<f64>>, Error> {
        let path = format!("/minc-2.0/image/{level}/{name}");
        let Some(dataset) = choice.dataset(&path)? else {
            return Ok(None);
        };
        let found = dataset.values(choice.file)?.unwrap_or_default();
        if found.len() as u64 == planes || found.len() == 1 {
            return Ok(Some(found));
        }
        Err(Error::unsupported(
            choice.file.name(),
            format!(
                "{} scales the values; 1 value or {planes}, one a plane, are read here",
                dataset.describe()
            ),
        ))
    };
    let (Some(low), Some(high)) = (values("image-min")?, values("image-max")?) else {
        return Ok(None);
    };
    let bits = 8 * header.voxel.bytes() as i32;
    let usual = match header.voxel.name().starts_with('i') {
        true => (-2_f64.powi(bits - 1), 2_f64.powi(bits - 1) - 1.0),
        false => (0.0, 2_f64.powi(bits) - 1.0),
    };
    let range = match own.numbers("valid_range").as_deref() {
        Some([a, b]) if a < b => (*a, *b),
        Some([a, b]) if b < a => (*b, *a),
        _ => usual,
    };
    // A single value is that of all planes.
    let of = |values: &[f64], n: usize| values.get(n).or(values.first()).copied().unwrap_or(0.0);
    let scales: Vec<_> = (0..low.len().max(high.len()))
        .map(|n| {
            let slope = (of(&high, n) - of(&low, n)) / (range.1 - range.0);
            let intercept = of(&low, n) - slope * range.0;
            Scaling { slope, intercept }
        })
        .collect();
    if let Some(odd) = scales
        .iter()
        .find(|s| !s.slope.is_finite() || !s.intercept.is_finite())
    {
        return Err(Error::invalid(
            choice.file.name(),
            format!("image-min and image-max of the MINC volume give the scale {odd:?}"),
        ));
    }
    let Some((first, rest)) = scales.split_first() else {
        return Ok(None);
    };
    let same = rest.iter().all(|scale| scale == first);
    // A plane of one value has slope 0, which only a scale for each plane can have.
    if !same || first.slope == 0.0 {
        return Ok(Some(scales));
    }
    if first.slope != 1.0 || first.intercept != 0.0 {
        header.scaling = Some(*first);
    }
    Ok(None)
}
