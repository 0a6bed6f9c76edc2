//! The table of solids whose surface meets itself in every ball: sheets, hairs, scans.

use std::f64::consts::TAU;

use anyhow::Result;
use curvox::measure::ball::Extent;

use super::SpeedArgs;
use super::clock::median;
use super::runs::{self, Destination, Method};
use super::subject::Subject;
use crate::random::Random;

/// Radii, in voxels.
const RADII: [f64; 2] = [3.0, 6.0];

/// Edge of the volumes, in voxels.
const EDGE: usize = 200;

/// The same for an impression.
const QUICK_EDGE: usize = 80;

/// Periods of the gyroids, in voxels: their sheets are half of that apart.
const PERIODS: [f64; 3] = [50.0, 25.0, 15.0];

/// Hairs for each 200^3 voxels.
const HAIRS: usize = 900;

/// Steps of a hair, one voxel each.
const STEPS: usize = 240;

/// How much a hair bends at a step.
const BEND: f64 = 0.18;

/// Three numbers from -1 to 1.
fn vector(random: &mut Random) -> [f64; 3] {
    [0; 3].map(|_| 2.0 * random.draw() - 1.0)
}

fn subject(name: String, edge: usize, inside: impl Fn([usize; 3]) -> bool) -> Subject {
    let mut stored = Vec::with_capacity(edge * edge * edge);
    for z in 0..edge {
        for y in 0..edge {
            stored.extend((0..edge).map(|x| u8::from(inside([x, y, z]))));
        }
    }
    Subject {
        name,
        dims: [edge; 3],
        stored: stored.into(),
    }
}

/// One side of the gyroid, in a cube.
fn gyroid(edge: usize, period: f64) -> Subject {
    let waves: Vec<[f64; 2]> = (0..edge)
        .map(|i| (TAU * i as f64 / period).sin_cos().into())
        .collect();
    let name = format!("gyroid, period {period}");
    subject(name, edge, |voxel| {
        let [[sx, cx], [sy, cy], [sz, cz]] = voxel.map(|i| waves[i]);
        sx * cy + sy * cz + sz * cx > 0.0
    })
}

/// Tubes of a radius of 1.5 to 2 voxels that bend at random, a fifth of a cube.
fn hairs(edge: usize) -> Subject {
    let mut random = Random(7);
    let mut stored = vec![0u8; edge * edge * edge];
    let unit = |v: [f64; 3]| {
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
        v.map(|x| x / length)
    };
    let far = edge as f64 - 5.0;
    for _ in 0..HAIRS * edge.pow(3) / EDGE.pow(3) {
        let mut at = [0; 3].map(|_| 5.0 + random.draw() * (edge as f64 - 10.0));
        let mut along = unit(vector(&mut random));
        let radius = 1.5 + 0.5 * random.draw();
        for _ in 0..STEPS {
            let bend = vector(&mut random);
            along = unit([0, 1, 2].map(|a| along[a] + 2.0 * BEND * bend[a]));
            for a in 0..3 {
                if !(4.0..=far).contains(&(at[a] + along[a])) {
                    along[a] = -along[a];
                }
                at[a] += along[a];
            }
            let lo = at.map(|x| x as usize - 2);
            for z in lo[2]..lo[2] + 6 {
                for y in lo[1]..lo[1] + 6 {
                    for x in lo[0]..lo[0] + 6 {
                        let d = [x, y, z].map(|i| i as f64);
                        let squared: f64 = (0..3).map(|a| (d[a] - at[a]) * (d[a] - at[a])).sum();
                        if squared <= radius * radius {
                            stored[(z * edge + y) * edge + x] = 1;
                        }
                    }
                }
            }
        }
    }
    Subject {
        name: "hairs".into(),
        dims: [edge; 3],
        stored: stored.into(),
    }
}

pub(super) fn print(args: &SpeedArgs) -> Result<()> {
    let edge = if args.quick { QUICK_EDGE } else { EDGE };
    let mut subjects = vec![Subject::goursat(args.gridstep, 0.0)?];
    subjects.extend(PERIODS.map(|period| gyroid(edge, period)));
    subjects.push(hairs(edge));
    for spec in &args.volumes {
        subjects.push(Subject::of_file(spec)?);
    }
    println!(
        "Surfaces that are dense or rough, {edge}^3 voxels where nothing else is said, default method: processor time of whole runs.\n"
    );
    println!("| solid | surfels | radius | us a surfel | times the first |");
    println!("|---|---|---|---|---|");
    for radius in RADII {
        let mut smooth = f64::NAN;
        for (i, subject) in subjects.iter().enumerate() {
            let settings = runs::settings(subject, Method::Default, Extent::Connected, radius)?;
            let (mut times, mut surfels) = (Vec::new(), 0);
            for _ in 0..args.repeats {
                let finished = runs::once(subject, &settings, Destination::Dropped)?;
                surfels = finished.surfels;
                times.push(finished.microseconds());
            }
            let time = median(&times);
            if i == 0 {
                smooth = time;
            }
            println!(
                "| {} | {surfels} | {radius} | {time:.2} | {:.1} |",
                subject.name,
                time / smooth
            );
        }
    }
    println!();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_a_gyroid_and_a_fifth_of_hairs_are_inside() {
        let share = |subject: &Subject| {
            let inside = subject.stored.iter().filter(|&&v| v == 1).count();
            inside as f64 / subject.stored.len() as f64
        };
        assert!((share(&gyroid(60, 15.0)) - 0.5).abs() < 0.01);
        let hairs = share(&hairs(60));
        assert!((0.1..0.35).contains(&hairs), "{hairs}");
    }
}
