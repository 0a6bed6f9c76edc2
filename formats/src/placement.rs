//! Where a volume lies, from what text headers say of it.
//!
//! In: edge lengths of a voxel, or vectors from voxel to voxel. Out: spacing, direction and origin of a
//! [`Header`]. What is no number, zero or absurd leaves the spacing unknown, with a warning; a negative
//! edge reverses the direction of its axis, so that the world stays as the file has it.

use crate::header::{Header, Unit};
use crate::parsed::is_plausible_spacing;

/// Cosines and relative lengths that differ by less come from rounding of printed numbers.
pub(crate) const ROUNDING: f64 = 1e-3;

/// Takes edge lengths, called `field` in the file `name`.
pub(crate) fn take_spacing(header: &mut Header, edges: [f64; 3], field: &str, name: &str) {
    if let Some(bad) = edges.iter().find(|s| !is_plausible_spacing(s.abs())) {
        header.warnings.push(format!(
            "{name}: {field} has {bad:e}, which is no voxel size; the spacing is taken as unknown"
        ));
        return;
    }
    header.spacing = Some(edges.map(f64::abs));
    if edges.iter().any(|s| *s < 0.0) {
        header.warnings.push(format!(
            "{name}: {field} is {edges:?}; a negative edge is taken as an axis that runs backwards"
        ));
        for (axis, edge) in edges.into_iter().enumerate() {
            if edge < 0.0 {
                for row in &mut header.direction {
                    // Not -0 where there is nothing.
                    row[axis] = if row[axis] == 0.0 { 0.0 } else { -row[axis] };
                }
            }
        }
    }
}

/// Takes vectors along the axes, called `field` in the file `name`: their directions, and their lengths,
/// which are given back. `None` if they are no axes.
pub(crate) fn take_vectors(
    header: &mut Header,
    vectors: [[f64; 3]; 3],
    field: &str,
    name: &str,
) -> Option<[f64; 3]> {
    let lengths = vectors.map(length);
    if let Some(bad) = lengths.iter().find(|s| !is_plausible_spacing(**s)) {
        header.warnings.push(format!(
            "{name}: {field} has a vector of length {bad:e}, which is no axis; it is ignored"
        ));
        return None;
    }
    let unit: [[f64; 3]; 3] = std::array::from_fn(|axis| vectors[axis].map(|x| x / lengths[axis]));
    let dot = |a: usize, b: usize| (0..3).map(|r| unit[a][r] * unit[b][r]).sum::<f64>();
    let volume: f64 = (0..3)
        .map(|r| {
            let (s, t) = ((r + 1) % 3, (r + 2) % 3);
            unit[0][r] * (unit[1][s] * unit[2][t] - unit[1][t] * unit[2][s])
        })
        .sum();
    if volume.abs() < 1e-6 {
        header.warnings.push(format!(
            "{name}: the vectors of {field} lie in a plane; their directions are ignored"
        ));
        return Some(lengths);
    }
    if [dot(0, 1), dot(1, 2), dot(2, 0)]
        .iter()
        .any(|d| d.abs() > ROUNDING)
    {
        header.warnings.push(format!(
            "{name}: the axes of {field} are not orthogonal (sheared); voxels are taken as boxes"
        ));
    }
    header.direction = std::array::from_fn(|r| std::array::from_fn(|axis| unit[axis][r]));
    Some(lengths)
}

/// The length of a vector. That of an oblique one is only as exact as its printed components, so its last
/// digits are rounded off: cubic voxels stay cubic.
fn length(vector: [f64; 3]) -> f64 {
    let length = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    if vector.iter().filter(|x| **x != 0.0).count() < 2 {
        return length;
    }
    // More digits would keep the errors of the root, fewer could change what a file says.
    format!("{length:.13e}").parse().unwrap_or(length)
}

/// Takes the position of the first voxel.
pub(crate) fn take_origin(header: &mut Header, origin: [f64; 3], field: &str, name: &str) {
    if origin.iter().all(|x| x.is_finite()) {
        header.origin = origin;
    } else if !origin.iter().all(|x| x.is_nan()) {
        header.warnings.push(format!(
            "{name}: {field} is {origin:?}, which is no position; it is ignored"
        ));
    }
}

/// A unit as people write it; `None` if it is not known.
pub(crate) fn unit(text: &str) -> Option<Unit> {
    let text = text.trim().trim_matches('"');
    if matches!(text, "?" | "???" | "none") {
        return Some(Unit::Unknown);
    }
    if let Ok(unit) = text.parse() {
        return Some(unit);
    }
    // One letter can mean anything: M is mega.
    if text.chars().count() < 2 {
        return None;
    }
    let lower = text.to_lowercase();
    let singular = lower.strip_suffix('s').unwrap_or(&lower);
    lower.parse().or_else(|_| singular.parse()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_oblique_vector_has_the_length_that_was_meant() {
        let (sine, cosine) = 0.3_f64.sin_cos();
        for meant in [0.3, 1.9, 0.7031249999999999] {
            assert_eq!(length([0.0, -meant, 0.0]), meant);
            let turned = length([meant * sine, meant * cosine, 0.0]);
            assert!((turned - meant).abs() < 1e-13);
        }
        assert_eq!(length([0.3 * sine, 0.0, 0.3 * cosine]), 0.3);
    }

    #[test]
    fn units_are_read_as_people_write_them() {
        for (text, expected) in [
            ("mm", Some(Unit::Millimetre)),
            ("\"mm\"", Some(Unit::Millimetre)),
            ("MM", Some(Unit::Millimetre)),
            ("millimeters", Some(Unit::Millimetre)),
            ("Millimetre", Some(Unit::Millimetre)),
            ("microns", Some(Unit::Micrometre)),
            ("\u{b5}m", Some(Unit::Micrometre)),
            ("um", Some(Unit::Micrometre)),
            ("cm", Some(Unit::Centimetre)),
            ("meters", Some(Unit::Metre)),
            ("Angstroms", Some(Unit::Angstrom)),
            ("", Some(Unit::Unknown)),
            ("???", Some(Unit::Unknown)),
            ("M", None),
            ("s", None),
            ("pixels", None),
        ] {
            assert_eq!(unit(text), expected, "{text}");
        }
    }
}
