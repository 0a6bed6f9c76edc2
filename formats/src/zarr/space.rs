//! Where an array lies in the world: scales, translations and units of its axes, as a header says
//! it.

use crate::header::{Header, IDENTITY, Unit};
use crate::zarr::view::View;

/// What is known of each axis of an array, in the order of its axes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Space {
    /// Names, where they say more than those of the array.
    pub(crate) axes: Option<Vec<String>>,
    /// Steps from voxel to voxel.
    pub(crate) scale: Option<Vec<f64>>,
    /// Of the first voxel.
    pub(crate) translation: Vec<f64>,
    pub(crate) units: Vec<Option<String>>,
}

impl Space {
    /// Nothing known of so many axes.
    pub(crate) fn new(axes: usize) -> Self {
        Self {
            axes: None,
            scale: None,
            translation: vec![0.0; axes],
            units: vec![None; axes],
        }
    }

    /// Writes what the view's axes have into a header.
    pub(crate) fn describe(&self, view: &View, header: &mut Header, name: &str) {
        let Some(scale) = &self.scale else { return };
        let scale = view.axes.map(|axis| scale[axis]);
        let translation = view.axes.map(|axis| self.translation[axis]);
        if !scale.iter().all(|s| s.is_finite() && *s != 0.0) {
            header.warnings.push(format!(
                "{name}: the scale {scale:?} is not one of voxels; it is ignored"
            ));
            return;
        }
        let units = view.axes.map(|axis| self.units[axis].as_deref());
        let (unit, factor) = self.unit(units, header, name);
        let spacing = [0, 1, 2].map(|a| scale[a].abs() * factor[a]);
        let origin = [0, 1, 2].map(|a| translation[a] * factor[a]);
        if !spacing.iter().all(|s| s.is_finite() && *s > 0.0) {
            header.warnings.push(format!(
                "{name}: the scale {scale:?} is beyond all lengths; it is ignored"
            ));
            return;
        }
        header.unit = unit;
        header.spacing = Some(spacing);
        if origin.iter().all(|x| x.is_finite()) {
            header.origin = origin;
        } else {
            header.warnings.push(format!(
                "{name}: the translation {translation:?} is no position; it is ignored"
            ));
        }
        header.direction = IDENTITY;
        for axis in 0..3 {
            // An axis that runs against the world's.
            if scale[axis] < 0.0 {
                header.direction[axis][axis] = -1.0;
            }
        }
    }

    /// One unit for all three axes, and what lengths along each are multiplied by.
    fn unit(&self, units: [Option<&str>; 3], header: &mut Header, name: &str) -> (Unit, [f64; 3]) {
        let known = units.map(|unit| unit.map_or(Some((Unit::Unknown, 1.0)), length));
        if let Some(strange) = (0..3).find(|axis| known[*axis].is_none()) {
            header.warnings.push(format!(
                "{name}: the unit '{}' is not a length that is known; lengths have no unit",
                units[strange].unwrap_or_default()
            ));
            return (Unit::Unknown, [1.0; 3]);
        }
        let known = known.map(|known| known.unwrap_or((Unit::Unknown, 1.0)));
        let first = known[0].0;
        let metres = known.map(|(unit, _)| unit.metres());
        match (first.metres(), metres) {
            (Some(one), [Some(_), Some(_), Some(_)]) => {
                let factor = [0, 1, 2].map(|axis| {
                    let (unit, times) = known[axis];
                    if unit == first {
                        times
                    } else {
                        times * metres[axis].unwrap_or(one) / one
                    }
                });
                (first, factor)
            }
            (None, [None, None, None]) => (Unit::Unknown, [1.0; 3]),
            _ => {
                header.warnings.push(format!(
                    "{name}: only some of the axes x, y, z have a unit; lengths have none"
                ));
                (Unit::Unknown, [1.0; 3])
            }
        }
    }
}

/// A unit of length, and how many of it one of the named is.
fn length(name: &str) -> Option<(Unit, f64)> {
    if let Ok(unit) = name.parse() {
        return Some((unit, 1.0));
    }
    Some(match name {
        "pixel" | "pixels" | "px" | "voxel" | "voxels" | "none" => (Unit::Unknown, 1.0),
        "picometer" | "pm" => (Unit::Nanometre, 1e-3),
        "femtometer" => (Unit::Nanometre, 1e-6),
        "decimeter" | "dm" => (Unit::Centimetre, 10.0),
        "kilometer" | "km" => (Unit::Metre, 1e3),
        "inch" | "in" => (Unit::Millimetre, 25.4),
        "foot" => (Unit::Millimetre, 304.8),
        "millimeters" | "millimetres" => (Unit::Millimetre, 1.0),
        "micrometers" | "micrometres" | "microns" => (Unit::Micrometre, 1.0),
        "nanometers" | "nanometres" => (Unit::Nanometre, 1.0),
        _ => return None,
    })
}
