//! The order of the planes of a stack, and where they lie in the world.
//!
//! In: planes with positions, or with numbers only. Out: the planes from first to last, spacing,
//! origin and directions in millimetres, in the space of DICOM: x to the patient's left, y to
//! the back, z to the head (LPS). z runs along the normal of the planes, and its spacing is the
//! distance of positions: SliceThickness and SpacingBetweenSlices often say something else.
//!
//! Refused: two planes at one position, steps that differ by more than a hundredth, a stack that
//! is sheared (gantry tilt): such voxels are no boxes.

use crate::error::Error;
use crate::header::IDENTITY;
use crate::parsed::is_plausible_spacing;

use super::image::{Frame, Image};
use super::series::{Plane, SAME_POSITION, along};

/// Relative deviation of a step between planes beyond which they are refused, or warned about.
const UNEVEN: f64 = 0.01;
const UNEVEN_WARNING: f64 = 0.001;

/// Angle in degrees between the normal and the line of positions beyond which a stack is
/// sheared, or warned about. 0.1 degrees over 500 mm are less than 1 mm.
const TILT: f64 = 0.1;
const TILT_WARNING: f64 = 0.01;

/// Sideways distance of a plane from the line of positions, in pixels.
const SHIFT: f64 = 0.5;
const SHIFT_WARNING: f64 = 0.05;

/// Planes in order, and their place.
pub(super) struct Geometry {
    pub(super) spacing: Option<[f64; 3]>,
    pub(super) origin: [f64; 3],
    pub(super) direction: [[f64; 3]; 3],
    /// What decided on the order.
    pub(super) order: &'static str,
    pub(super) warnings: Vec<String>,
}

type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn minus(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn times(a: Vector, factor: f64) -> Vector {
    a.map(|x| x * factor)
}

fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

/// Sorts the planes, of which there are at least two, and says where they lie.
pub(super) fn arrange(
    planes: &mut [Plane],
    images: &[Image],
    name: &str,
) -> Result<Geometry, Error> {
    let first = planes[0].frame(images).clone();
    let placed = first.position.is_some() && first.normal().is_some();
    let mut keyed = Vec::with_capacity(planes.len());
    for plane in planes.iter() {
        let Some(key) = along(plane.frame(images), &first) else {
            return Err(Error::unsupported(
                name,
                format!(
                    "{} has neither a position (ImagePositionPatient and \
                     ImageOrientationPatient) nor an InstanceNumber: the order of the planes is \
                     not known",
                    plane.name(images)
                ),
            ));
        };
        keyed.push((key, *plane));
    }
    keyed.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    for (plane, (_, sorted)) in planes.iter_mut().zip(&keyed) {
        *plane = *sorted;
    }
    for pair in keyed.windows(2) {
        if pair[1].0 - pair[0].0 <= SAME_POSITION {
            let uid = |plane: Plane| &images[plane.image].instance_uid;
            let (a, b) = (pair[0].1, pair[1].1);
            if a.image != b.image && uid(a) == uid(b) && !uid(a).is_empty() {
                return Err(Error::unsupported(
                    name,
                    format!(
                        "{} and {} are the same image (SOPInstanceUID {}): remove one of them",
                        a.name(images),
                        b.name(images),
                        uid(a)
                    ),
                ));
            }
            let what = if placed { "position" } else { "InstanceNumber" };
            return Err(Error::unsupported(
                name,
                format!(
                    "{} and {} have the same {what}, and nothing that is known tells their \
                     volumes apart",
                    a.name(images),
                    b.name(images)
                ),
            ));
        }
    }
    let mut geometry = Geometry {
        spacing: None,
        origin: [0.0; 3],
        direction: directions(&first),
        order: "position",
        warnings: Vec::new(),
    };
    let step = if placed {
        Some(by_position(&keyed, images, name, &mut geometry)?)
    } else {
        by_number(&keyed, images, name, &mut geometry)
    };
    let in_plane = first.spacing.map(|[rows, columns]| [columns, rows]);
    match (in_plane, step) {
        (Some([x, y]), Some(z)) if [x, y, z].into_iter().all(is_plausible_spacing) => {
            geometry.spacing = Some([x, y, z]);
        }
        (Some([x, y]), Some(z)) => geometry.warnings.push(format!(
            "{name}: the spacing {x} x {y} x {z} is not usable; lengths are in voxels"
        )),
        (Some([x, y]), None) => geometry.warnings.push(format!(
            "{name}: the pixel spacing is {x} x {y} mm, but the distance of the planes is not \
             known; lengths are in voxels"
        )),
        (None, _) => geometry.warnings.push(format!(
            "{name}: there is no PixelSpacing; lengths are in voxels"
        )),
    }
    Ok(geometry)
}

/// Columns: directions of x, y and z.
fn directions(first: &Frame) -> [[f64; 3]; 3] {
    let (Some([ax, ay, az, bx, by, bz]), Some(normal)) = (first.orientation, first.normal()) else {
        return IDENTITY;
    };
    let unit = |v: Vector| times(v, 1.0 / length(v));
    let (x, y) = (unit([ax, ay, az]), unit([bx, by, bz]));
    if [x, y].into_iter().flatten().any(|n| !n.is_finite()) {
        return IDENTITY;
    }
    [0, 1, 2].map(|row| [x[row], y[row], normal[row]])
}

/// The distance of planes by their positions, checked.
fn by_position(
    keyed: &[(f64, Plane)],
    images: &[Image],
    name: &str,
    geometry: &mut Geometry,
) -> Result<f64, Error> {
    let at = |i: usize| keyed[i].1.frame(images).position.unwrap_or_default();
    let last = keyed.len() - 1;
    let total = keyed[last].0 - keyed[0].0;
    let step = total / last as f64;
    let mut steps: Vec<_> = keyed.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    steps.sort_by(f64::total_cmp);
    let median = steps[steps.len() / 2];
    let mut worst = 0.0_f64;
    for pair in keyed.windows(2) {
        let gap = pair[1].0 - pair[0].0;
        let deviation = (gap - median).abs() / median;
        worst = worst.max(deviation);
        if deviation > UNEVEN {
            let missing = (gap / median).round() - 1.0;
            let whole = (gap / median - missing - 1.0).abs() < 0.02;
            let hint = match missing {
                n if n == 1.0 && whole => ": a plane is missing between them".to_string(),
                n if n > 1.0 && whole => format!(": {n} planes are missing between them"),
                _ => String::new(),
            };
            return Err(Error::unsupported(
                name,
                format!(
                    "the planes are not evenly spaced: {} and {} are {gap:.6} mm apart, most \
                     others {median:.6} mm{hint}",
                    pair[0].1.name(images),
                    pair[1].1.name(images)
                ),
            ));
        }
    }
    if worst > UNEVEN_WARNING {
        geometry.warnings.push(format!(
            "{name}: the distance of planes differs by up to {:.2} %; their mean {step:.6} mm is \
             taken",
            worst * 100.0
        ));
    }

    let normal = [0, 1, 2].map(|row| geometry.direction[row][2]);
    let line = minus(at(last), at(0));
    let sideways = length(minus(line, times(normal, total)));
    let angle = sideways.atan2(total).to_degrees();
    if angle > TILT {
        return Err(Error::unsupported(
            name,
            format!(
                "the planes are shifted against each other by {angle:.3} degrees (gantry tilt): \
                 such voxels are no boxes; resample the volume first"
            ),
        ));
    }
    if angle > TILT_WARNING {
        geometry.warnings.push(format!(
            "{name}: the planes are shifted against each other by {angle:.3} degrees, which is \
             ignored"
        ));
    }
    let pixel = keyed[0]
        .1
        .frame(images)
        .spacing
        .map_or(step, |[rows, columns]| rows.min(columns));
    let mut farthest = 0.0_f64;
    for i in 0..=last {
        let expected = times(line, (keyed[i].0 - keyed[0].0) / total);
        let off = minus(minus(at(i), at(0)), expected);
        let shift = length(minus(off, times(normal, dot(off, normal)))) / pixel;
        farthest = farthest.max(shift);
        if shift > SHIFT {
            return Err(Error::unsupported(
                name,
                format!(
                    "{} lies {:.3} mm beside the line of the other planes",
                    keyed[i].1.name(images),
                    shift * pixel
                ),
            ));
        }
    }
    if farthest > SHIFT_WARNING {
        geometry.warnings.push(format!(
            "{name}: planes lie up to {:.3} mm beside their line, which is ignored",
            farthest * pixel
        ));
    }
    geometry.origin = at(0);
    let unit = last_digit(at(0)).min(last_digit(at(last)));
    Ok(decimal(step, unit, last as f64))
}

/// The shortest decimal number that `step` may stand for, positions being decimal numbers with
/// `unit` as their last digit: 1.5 and not 1.4999999.
fn decimal(step: f64, unit: f64, steps: f64) -> f64 {
    /// Rounding of sums, and the most that positions with few digits may change.
    const LEAST: f64 = 1e-9;
    const MOST: f64 = 1e-5;
    // Each coordinate of the first and the last position is off by up to half a unit.
    let uncertain = unit * 3.0_f64.sqrt() / steps;
    let allowed = uncertain.clamp(LEAST * step, MOST * step);
    (0..9)
        .filter_map(|digits| format!("{step:.digits$e}").parse().ok())
        .find(|number: &f64| (number - step).abs() <= allowed)
        .unwrap_or(step)
}

/// The last digit of coordinates, as text writes them.
fn last_digit(position: Vector) -> f64 {
    let digits = position
        .iter()
        .map(|n| n.to_string().split_once('.').map_or(0, |(_, d)| d.len()))
        .max();
    0.1_f64.powi(digits.unwrap_or(0).min(15) as i32)
}

/// The distance of planes that have numbers only.
fn by_number(
    keyed: &[(f64, Plane)],
    images: &[Image],
    name: &str,
    geometry: &mut Geometry,
) -> Option<f64> {
    let first = keyed[0].1.frame(images);
    let one_file = keyed[0].1.image == keyed[keyed.len() - 1].1.image;
    geometry.order = if one_file {
        "frame number"
    } else {
        "InstanceNumber"
    };
    let (step, from) = match (first.between, first.thickness) {
        (Some(step), _) if is_plausible_spacing(step.abs()) => {
            (Some(step.abs()), "SpacingBetweenSlices")
        }
        (_, Some(step)) if is_plausible_spacing(step) => (Some(step), "SliceThickness"),
        _ => (None, ""),
    };
    let distance = match step {
        Some(step) => format!("their distance {step} mm is {from}"),
        None => "their distance is not known".to_string(),
    };
    geometry.warnings.push(format!(
        "{name}: the planes have no positions: their order is that of {}, and {distance}",
        geometry.order
    ));
    if let Some(gap) = keyed.windows(2).find(|pair| pair[1].0 - pair[0].0 != 1.0) {
        geometry.warnings.push(format!(
            "{name}: numbers are missing between {} and {}: planes may be, too",
            gap[0].1.name(images),
            gap[1].1.name(images)
        ));
    }
    step
}
