//! Stability with respect to parameters: figure 10.

use anyhow::Result;

use super::convergence::Curvature;
use super::methods::{Estimator, Method};
use super::page::{self, Section, Table, full, gridstep, number};
use super::plot::{Axis, HeatMap, Line, Panel, heat_maps, svg};
use super::rows::Errors;
use super::runs::Run;
use super::slopes::Norm;
use super::study::{Results, Study};

const GOURSAT: &str = "goursat";

/// The range in which the paper finds almost the same errors: k, and m.
const STABLE: [[f64; 2]; 2] = [[2.5, 4.0], [2.5, 6.0]];

/// Gridsteps of figure 10.
const SHOWN: [f64; 3] = [0.5, 0.25, 0.125];

struct Parameters {
    /// r = k h^(1/2).
    normals: &'static [f64],
    /// rho = m h^(1/2).
    measures: &'static [f64],
    /// r' = k' h^(1/3).
    plain: &'static [f64],
}

fn parameters(study: &Study) -> Parameters {
    if study.quick {
        Parameters {
            normals: &[2.0, 3.0, 4.0],
            measures: &[2.0, 3.0, 4.0, 6.0],
            plain: &[4.0, 6.0, 8.0],
        }
    } else {
        Parameters {
            normals: &[1.5, 2.0, 2.5, 3.0, 4.0, 6.0],
            measures: &[1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 8.0],
            plain: &[2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0],
        }
    }
}

fn steps(study: &Study) -> Vec<f64> {
    let all = SHOWN.into_iter();
    let steps: Vec<f64> = all.filter(|&h| h >= study.finest).collect();
    if steps.is_empty() {
        vec![study.finest]
    } else {
        steps
    }
}

fn corrected(study: &Study, h: f64, k: f64) -> Run {
    let measures = parameters(study).measures;
    Run::shape(
        GOURSAT,
        h,
        Method::corrected(Estimator::Ii, h, 0.5, k, measures),
    )
}

fn plain(study: &Study, h: f64) -> Run {
    Run::shape(
        GOURSAT,
        h,
        Method::plain(h, 1.0 / 3.0, parameters(study).plain),
    )
}

/// One run for each k, with all m at once.
pub fn runs(study: &Study) -> Vec<Run> {
    let mut runs = Vec::new();
    for h in steps(study) {
        runs.extend(
            parameters(study)
                .normals
                .iter()
                .map(|&k| corrected(study, h, k)),
        );
        runs.push(plain(study, h));
    }
    runs
}

fn errors(results: &Results, run: &Run, place: usize) -> Option<Errors> {
    let values = results.find(run)?.measured.at.get(place)?.values?;
    Some(values[Curvature::Mean.index()])
}

/// Figure 10.
pub fn section(study: &Study, results: &Results) -> Result<Section> {
    let Parameters {
        normals,
        measures,
        plain: constants,
    } = parameters(study);
    let mut csv = Table::new(&["estimator", "gridstep", "k", "m", "l2", "linf"]);
    let mut maps = Vec::new();
    let mut table = Table::new(&[
        "h",
        "norm",
        "best k, m",
        "its error",
        "k in [2.5, 4], m in [2.5, 6]: least",
        "most",
        "most / least",
    ]);
    let mut spread: Option<(f64, f64)> = None;
    for h in steps(study) {
        for norm in Norm::BOTH {
            let mut values = Vec::new();
            let mut best: Option<(f64, f64, f64)> = None;
            let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
            for (j, &m) in measures.iter().enumerate() {
                let mut row = Vec::new();
                for &k in normals {
                    let found = errors(results, &corrected(study, h, k), j);
                    row.push(found.map(|e| norm.of(&e)));
                    let Some(e) = found else { continue };
                    let error = norm.of(&e);
                    if best.is_none_or(|b| error < b.0) {
                        best = Some((error, k, m));
                    }
                    let [ks, ms] = STABLE;
                    if (ks[0]..=ks[1]).contains(&k) && (ms[0]..=ms[1]).contains(&m) {
                        least = least.min(error);
                        most = most.max(error);
                    }
                    if norm == Norm::L2 {
                        let numbers = [h, k, m, e.l2, e.linf].map(full);
                        let mut row = vec!["corrected".to_owned()];
                        row.extend(numbers);
                        csv.rows.push(row);
                    }
                }
                values.push(row);
            }
            let name = norm.name();
            maps.push(HeatMap {
                title: format!("{name} error of H, h = {}", gridstep(h)),
                x: ("k, where r = k h^(1/2)".into(), texts(normals)),
                y: ("m".into(), texts(measures)),
                values,
            });
            let Some((error, k, m)) = best else { continue };
            table.rows.push(vec![
                gridstep(h),
                name.into(),
                format!("{k}, {m}"),
                number(error),
                number(least),
                number(most),
                number(most / least),
            ]);
            if norm == Norm::Linf {
                spread = Some((h, most / least));
            }
        }
    }
    page::write(
        &study.folder,
        "figure10-corrected.svg",
        heat_maps(&maps, 2)?,
    )?;

    let mut lines = Vec::new();
    let mut plain_spread = None;
    for (colour, h) in steps(study).into_iter().enumerate() {
        for norm in Norm::BOTH {
            let run = plain(study, h);
            let points: Vec<(f64, f64)> = constants
                .iter()
                .enumerate()
                .filter_map(|(j, &k)| Some((k, norm.of(&errors(results, &run, j)?))))
                .collect();
            if points.is_empty() {
                continue;
            }
            if norm == Norm::Linf {
                // The same factor between the ends as [2.5, 4] has, around k' = 6.
                let near: Vec<f64> = points
                    .iter()
                    .filter(|p| (4.5..=7.5).contains(&p.0))
                    .map(|p| p.1)
                    .collect();
                let most = near.iter().copied().fold(0.0, f64::max);
                let least = near.iter().copied().fold(f64::INFINITY, f64::min);
                if near.len() > 1 {
                    plain_spread = Some((h, most / least));
                }
                for &(k, linf) in &points {
                    let l2 = errors(results, &run, place(constants, k)).map_or(f64::NAN, |e| e.l2);
                    csv.rows.push(vec![
                        "plain II".into(),
                        full(h),
                        full(k),
                        String::new(),
                        full(l2),
                        full(linf),
                    ]);
                }
            }
            lines.push(Line {
                name: format!("h = {}, {}", gridstep(h), norm.name()),
                colour,
                thick: norm == Norm::Linf,
                dashed: false,
                points,
            });
        }
    }
    let drawn = svg(&[Panel {
        title: "plain II: error of H against k'".into(),
        x: "k', where r' = k' h^(1/3)".into(),
        y: "error of H".into(),
        x_axis: Axis::Linear,
        lines,
    }])?;
    page::write(&study.folder, "figure10-plain.svg", drawn)?;
    page::write(&study.folder, "figure10.csv", csv.csv())?;
    let mut finding = match spread {
        Some((h, ratio)) => format!(
            "for k in [2.5, 4] and m in [2.5, 6] the largest error at h = {} varies by a factor of {ratio:.2}",
            gridstep(h)
        ),
        None => "not run".into(),
    };
    if let Some((h, ratio)) = plain_spread {
        finding.push_str(&format!(
            "; that of plain II for k' from 5 to 7 at h = {} by {ratio:.2}",
            gridstep(h)
        ));
    }
    Ok(Section {
        title: "Figure 10: how errors of H depend on parameters".into(),
        paper: "best results have the same constants at finer scales, so the exponents of h are consistent; errors \
                are almost the same for k in [2.5, 4] and m in [2.5, 6], so corrected measures are more stable than \
                plain integral invariants."
            .into(),
        finding: format!("{finding}."),
        body: format!(
            "![errors of corrected measures against k and m](figure10-corrected.svg)\n\n*Errors of H on Goursat, u = II: \
             r = k h^(1/2) from left to right, rho = m h^(1/2) upwards; the darker the larger, one scale for each \
             norm.*\n\n![errors of plain II against k'](figure10-plain.svg)\n\n*Plain integral invariants. Thick \
             lines are l-infinity errors, thin lines l2 errors.* Numbers: [figure10.csv](figure10.csv).\n\n{}\n{}",
            table.markdown(),
            results.refusals(&runs(study))
        ),
    })
}

fn place(all: &[f64], value: f64) -> usize {
    all.iter().position(|&v| v == value).unwrap_or(all.len())
}

fn texts(values: &[f64]) -> Vec<String> {
    values.iter().map(ToString::to_string).collect()
}
