//! Normals between surfels: whether a continuous field gains anything, and how good normals are.

use anyhow::Result;

use super::convergence::Curvature;
use super::methods::{Estimator, Field, Method};
use super::page::{self, Section, Table, full, gridstep, number, slope};
use super::runs::Run;
use super::slopes::{Points, exponent};
use super::study::{Results, Study};

const GOURSAT: &str = "goursat";

/// The finest gridstep: what is to be seen is seen there.
const FINEST: f64 = 1.0 / 8.0;

/// An exponent below this is none, with four gridsteps that meet the shape in different ways.
const FALLS: f64 = 0.2;

const NORMALS: [Estimator; 2] = [Estimator::Ii, Estimator::Vcm];

fn run(estimator: Estimator, field: Field, h: f64) -> Run {
    Run::shape(GOURSAT, h, Method::of_paper(estimator, h).with(field))
}

/// The fields with each choice of normals.
pub fn runs(study: &Study) -> Vec<Run> {
    let mut runs = Vec::new();
    for h in study.gridsteps(FINEST) {
        for estimator in NORMALS {
            runs.extend(Field::ALL.map(|field| run(estimator, field, h)));
        }
    }
    runs
}

/// See [`runs`].
///
/// # Errors
/// If a file cannot be written.
pub fn section(study: &Study, results: &Results) -> Result<Section> {
    let steps = study.gridsteps(FINEST);
    let mut table = Table::new(&["what", "u", "field"]);
    let header = steps.iter().map(|&h| format!("h = {}", gridstep(h)));
    table.header.extend(header);
    table.header.push("slope".into());
    let mut csv = Table::new(&["what", "normals", "field", "gridstep", "value"]);
    // Over gridsteps, normals and curvatures: the l2 error against that of the constant field.
    let (mut low, mut high) = (f64::INFINITY, 0.0_f64);
    let mut falls = Vec::new();
    for what in ["l2 error of H", "l2 error of G", "rms quality"] {
        for estimator in NORMALS {
            let value = |field: Field, h: f64| {
                let finished = results.find(&run(estimator, field, h))?;
                let at = finished.measured.at.first()?;
                match what {
                    "l2 error of H" => Some(at.values?[Curvature::Mean.index()].l2),
                    "l2 error of G" => Some(at.values?[Curvature::Gaussian.index()].l2),
                    _ => at.quality,
                }
            };
            for field in Field::ALL {
                let points: Points = steps
                    .iter()
                    .filter_map(|&h| Some((h, value(field, h)?)))
                    .collect();
                if points.is_empty() {
                    continue;
                }
                let mut row = vec![what.into(), estimator.name().into(), field.name().into()];
                row.extend(
                    steps
                        .iter()
                        .map(|&h| number(value(field, h).unwrap_or(f64::NAN))),
                );
                row.push(slope(exponent(&points)));
                table.rows.push(row);
                for &(h, v) in &points {
                    let names = [what, estimator.name(), field.name()].map(String::from);
                    let mut row = Vec::from(names);
                    row.extend([full(h), full(v)]);
                    csv.rows.push(row);
                    if what == "rms quality" || field == Field::Constant {
                        continue;
                    }
                    if let Some(constant) = value(Field::Constant, h) {
                        low = low.min(v / constant);
                        high = high.max(v / constant);
                    }
                }
                if what == "rms quality"
                    && field == Field::Constant
                    && let Some(b) = exponent(&points)
                {
                    let how = if b > FALLS { "falls" } else { "hardly falls" };
                    falls.push(format!("{how} with {} (exponent {b:.2})", estimator.name()));
                }
            }
        }
    }
    page::write(&study.folder, "fields.csv", csv.csv())?;
    let ratios = if low <= high {
        format!(
            "l2 errors of H and G with continuous fields are {low:.3} to {high:.3} times those with the constant one"
        )
    } else {
        "not run".into()
    };
    Ok(Section {
        title: "Beyond the paper: normals between surfels, and their quality".into(),
        paper: "normals may be constant on surfels or interpolated between pointels (example 2.4); its experiments on \
                digital surfaces take constant ones."
            .into(),
        finding: format!(
            "{ratios}; the root mean square of the quality {}.",
            if falls.is_empty() {
                "needs more gridsteps for an exponent".into()
            } else {
                falls.join(", ")
            }
        ),
        body: format!(
            "Goursat, r = rho = 3 h^(1/2), `--field constant`, `interpolated` (unit length) and `linear`. What decides \
             the errors of a digital surface are the normals and the ball, not what the normals do within a surfel. \
             The quality is mu_Omega / mu0 of the ball (`--quality`), in 1/length as H is: how fast the normals turn \
             about themselves, which those of a surface never do. It needs no truth, so it can be looked at on any \
             volume. Numbers: [fields.csv](fields.csv).\n\n{}\n{}",
            table.markdown(),
            results.refusals(&runs(study))
        ),
    })
}
