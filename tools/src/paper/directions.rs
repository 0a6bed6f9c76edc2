//! Principal curvatures and directions: figure 20, and their errors.

use std::collections::BTreeMap;

use anyhow::Result;
use glam::DVec3;

use super::dgtal::{self, Quantity};
use super::drawing::{self, bar, signed, surface};
use super::methods::{Estimator, Method};
use super::page::{self, Section, Table, full, gridstep, number};
use super::rows::{Rows, Truth, UMBILIC, truth};
use super::runs::Run;
use super::slopes::Norm;
use super::study::{Results, Study};
use crate::picture::{Montage, Stick};

/// Shapes of the table.
const SHAPES: [&str; 3] = ["goursat", "torus", "ellipsoid"];

/// The finest gridsteps of the table: of the shape of the picture, which has DGtal's numbers beside,
/// and of the others.
const FINEST: [f64; 2] = [1.0 / 16.0, 1.0 / 8.0];

const NORMALS: [Estimator; 2] = [Estimator::Vcm, Estimator::Ii];

/// The shape of the picture.
const PICTURED: &str = "goursat";

/// Edge of the cubes that have one stick each, in the units of the shape: fewer do not show the lines
/// of curvature, more run into each other.
const SPACING: f64 = 1.25;

fn pictured_gridstep(study: &Study) -> f64 {
    study.finest.max(if study.quick { 0.5 } else { 0.25 })
}

fn steps(study: &Study, shape: &str) -> Vec<f64> {
    study.gridsteps(FINEST[usize::from(shape != PICTURED)])
}

fn run(shape: &str, h: f64, estimator: Estimator) -> Run {
    Run::shape(shape, h, Method::of_paper(estimator, h))
}

/// Figure 20 and its table.
pub fn runs(study: &Study) -> Vec<Run> {
    let mut runs = Vec::new();
    for shape in SHAPES {
        for h in steps(study, shape) {
            runs.extend(NORMALS.map(|estimator| run(shape, h, estimator)));
        }
    }
    let beside = steps(study, PICTURED).into_iter();
    runs.extend(beside.map(|h| run(PICTURED, h, Estimator::Paper)));
    runs
}

/// A stick for each cube of space, at the surfel nearest to its middle.
fn sticks(rows: &Rows, direction: impl Fn(usize) -> Option<DVec3>) -> Vec<Stick> {
    let mut nearest: BTreeMap<[i64; 3], (f64, usize)> = BTreeMap::new();
    for row in 0..rows.len() {
        let x = rows.centroid(row) / SPACING;
        let cube = x.floor();
        let distance = (x - cube - DVec3::splat(0.5)).length_squared();
        let entry = nearest
            .entry(cube.to_array().map(|c| c as i64))
            .or_insert((distance, row));
        if distance < entry.0 {
            *entry = (distance, row);
        }
    }
    nearest
        .into_values()
        .filter_map(|(_, row)| {
            Some(Stick {
                centre: rows.centroid(row),
                direction: direction(row)?,
                length: 0.8 * SPACING,
            })
        })
        .collect()
}

fn picture(study: &Study, results: &Results) -> Result<Option<Estimator>> {
    let h = pictured_gridstep(study);
    let found = NORMALS
        .into_iter()
        .find_map(|e| Some((e, results.find(&run(PICTURED, h, e))?)));
    let Some((estimator, finished)) = found else {
        return Ok(None);
    };
    let rows = Rows::read(&finished.table)?;
    let truth = truth(PICTURED, &rows)?;
    let columns = &rows.batch.curvatures[0];
    let colours = signed(0.3, 0.01);
    let mut estimated = Vec::new();
    let mut expected = Vec::new();
    for (i, (values, directions)) in [(&columns.k1, &columns.d1), (&columns.k2, &columns.d2)]
        .into_iter()
        .enumerate()
    {
        let of_row = |row: usize| {
            Some(DVec3::from_array(
                [0, 1, 2].map(|a| f64::from(directions[a][row])),
            ))
        };
        let drawn = sticks(&rows, of_row);
        estimated.push(surface(study, &rows, colours, &drawn, |row| {
            f64::from(values[row])
        })?);
        let of_truth = |row: usize| {
            let truth: Truth = truth[row]?;
            Some(DVec3::from_array(truth.directions[i].map(f64::from)))
        };
        let drawn = sticks(&rows, of_truth);
        let value = |row: usize| truth[row].map_or(f64::NAN, |t| t.values[2 + i]);
        expected.push(surface(study, &rows, colours, &drawn, value)?);
    }
    let montage = Montage {
        columns: vec!["d1 and k1".into(), "d2 and k2".into()],
        rows: vec![
            (format!("estimated, u = {}", estimator.name()), estimated),
            ("expected".into(), expected),
        ],
        bars: vec![bar(colours, "k1, k2")],
    };
    drawing::write(study, "figure20", &montage)?;
    Ok(Some(estimator))
}

/// See [`runs`].
pub fn section(study: &Study, results: &Results) -> Result<Section> {
    let drawn = picture(study, results)?;
    let mut table = Table::new(&[
        "shape",
        "u",
        "h",
        "k1: l2",
        "linf",
        "k2: l2",
        "linf",
        "d1: rms degrees",
        "max",
        "d2: rms degrees",
        "max",
        "without umbilics",
    ]);
    let mut csv = Table::new(&[
        "shape",
        "normals",
        "gridstep",
        "k1_l2",
        "k1_linf",
        "k2_l2",
        "k2_linf",
        "d1_rms",
        "d1_max",
        "d1_median",
        "d2_rms",
        "d2_max",
        "d2_median",
    ]);
    let mut finding = Vec::new();
    for shape in SHAPES {
        for estimator in NORMALS {
            let mut finest = None;
            for h in steps(study, shape) {
                let Some(finished) = results.find(&run(shape, h, estimator)) else {
                    continue;
                };
                let Some(at) = finished.measured.at.first() else {
                    continue;
                };
                let (Some(values), Some(directions)) = (at.values, at.directions) else {
                    continue;
                };
                let [k1, k2] = [values[2], values[3]];
                let [d1, d2] = directions;
                let share = d1.count as f64 / finished.measured.surfels as f64;
                let mut row = vec![shape.to_owned(), estimator.name().into(), gridstep(h)];
                row.extend([k1.l2, k1.linf, k2.l2, k2.linf].map(number));
                row.extend([d1.l2, d1.linf, d2.l2, d2.linf].map(number));
                row.push(format!("{:.1} %", 100.0 * share));
                table.rows.push(row);
                let mut row = vec![shape.to_owned(), estimator.name().into(), full(h)];
                let ks = [k1.l2, k1.linf, k2.l2, k2.linf];
                let ds = [d1.l2, d1.linf, d1.median, d2.l2, d2.linf, d2.median];
                row.extend(ks.into_iter().chain(ds).map(full));
                csv.rows.push(row);
                finest = Some((h, d1.l2, d2.l2));
            }
            if let Some((h, d1, d2)) = finest {
                finding.push(format!(
                    "{shape}, u = {}, h = {}: d1 within {} degrees, d2 within {}",
                    estimator.name(),
                    gridstep(h),
                    number(d1),
                    number(d2)
                ));
            }
        }
    }
    page::write(&study.folder, "figure20.csv", csv.csv())?;
    let beside = beside(study, results);
    let picture = match drawn {
        Some(estimator) => format!(
            "![principal directions on Goursat's surface](figure20.png)\n\n*Goursat at h = {}, u = {}: above, estimated; \
             below, expected. Left d1 as sticks and k1 as colours, right d2 and k2; dark blue (-0.3), white, red \
             (0.3), black within ±0.01. Directions at umbilics, which are none, are drawn too.*",
            gridstep(pictured_gridstep(study)),
            estimator.name()
        ),
        None => "The picture was not made, for want of its run.".into(),
    };
    Ok(Section {
        title: "Figure 20: principal directions and curvatures".into(),
        paper: "estimated principal directions, with u = VCM, look as expected (preliminary results, no numbers).".into(),
        finding: format!("root mean square of angles: {}.", finding.join("; ")),
        body: format!(
            "{picture} Numbers: [figure20.csv](figure20.csv).\n\nAngles are between lines, in degrees, over surfels that \
             are no umbilics: |k2 - k1| R >= {UMBILIC}, with true k1 and k2, and R the radius of the sphere that \
             has as much area as the surface. The last column is their share.\n\n{}\n{}\n{}",
            table.markdown(),
            beside.markdown(),
            results.refusals(&runs(study))
        ),
    })
}

/// Errors of k1 and k2 beside DGtal's.
fn beside(study: &Study, results: &Results) -> Table {
    let steps = steps(study, PICTURED);
    let mut table = Table::new(&["goursat, u = ii", "norm", ""]);
    let header = steps.iter().map(|&h| format!("h = {}", gridstep(h)));
    table.header.extend(header);
    for (i, quantity) in [Quantity::K1, Quantity::K2].into_iter().enumerate() {
        for norm in Norm::BOTH {
            let mut add = |who: &str, value: &dyn Fn(f64) -> Option<f64>| {
                let mut row = vec![format!("k{}", i + 1), norm.name().into(), who.into()];
                let values = steps.iter().map(|&h| value(h).unwrap_or(f64::NAN));
                row.extend(values.map(number));
                table.rows.push(row);
            };
            let theirs = |h: f64| dgtal::error(quantity, h, norm);
            add("DGtal", &theirs);
            for estimator in [Estimator::Ii, Estimator::Paper] {
                let ours = |h: f64| {
                    let finished = results.find(&run(PICTURED, h, estimator))?;
                    Some(norm.of(&finished.measured.at.first()?.values?[2 + i]))
                };
                add(&format!("curvox, {}", estimator.name()), &ours);
                add("ratio", &|h| Some(ours(h)? / theirs(h)?));
            }
        }
    }
    table
}
