//! Robustness to noise: figures 13 and 18, and errors against noise on a shape of known curvature.

use anyhow::Result;

use super::convergence::Curvature;
use super::drawing::{self, bar, surface};
use super::methods::{Estimator, Method};
use super::page::{self, Section, Table, full, number};
use super::pictures::of_group;
use super::plot::{Axis, Line, Panel, svg};
use super::rows::{Errors, Rows};
use super::runs::Run;
use super::slopes::Norm;
use super::study::{Finished, Results, Study};
use super::subjects::{Group, Subject, origin};
use crate::picture::Montage;

/// Noise in the pictures.
const PICTURED: [f64; 4] = [0.0, 0.1, 0.25, 0.5];

/// Noise in the plots.
const PLOTTED: [f64; 7] = [0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5];

/// Choices of normals in the pictures.
const NORMALS: [Estimator; 3] = [Estimator::Ii, Estimator::Vcm, Estimator::Average];

fn plotted(study: &Study) -> &'static [f64] {
    if study.quick { &PLOTTED[..4] } else { &PLOTTED }
}

fn pictured(study: &Study) -> &'static [f64] {
    if study.quick {
        &PICTURED[..3]
    } else {
        &PICTURED
    }
}

/// The first of the second group.
fn subject(study: &Study) -> Option<Subject> {
    Subject::all(study, Group::Second).into_iter().next()
}

/// Figures 13 and 18.
pub fn picture_runs(study: &Study) -> Vec<Run> {
    let Some(subject) = subject(study) else {
        return Vec::new();
    };
    let mut runs = Vec::new();
    for &p in pictured(study) {
        for estimator in NORMALS {
            runs.push(subject.run(Method::of_paper(estimator, subject.gridstep), p));
        }
    }
    runs
}

/// Figure 13.
pub fn pictures_mean(study: &Study, results: &Results) -> Result<Section> {
    pictures(study, results, Curvature::Mean, 13)
}

/// Figure 18.
pub fn pictures_gaussian(study: &Study, results: &Results) -> Result<Section> {
    pictures(study, results, Curvature::Gaussian, 18)
}

fn pictures(
    study: &Study,
    results: &Results,
    curvature: Curvature,
    figure: u32,
) -> Result<Section> {
    let letter = curvature.letter();
    let i = curvature.index();
    let colours = of_group(Group::Second, curvature);
    let mut montage = Montage {
        columns: Vec::new(),
        rows: Vec::new(),
        bars: vec![bar(colours, letter)],
    };
    let mut table = Table::new(&["normals"]);
    let steps = pictured(study);
    table
        .header
        .extend(steps.iter().map(|p| format!("p = {p}")));
    let mut lines: Vec<Vec<String>> = NORMALS.iter().map(|e| vec![e.name().into()]).collect();
    let mut clean: [Option<Rows>; 3] = [const { None }; 3];
    let mut changes: Vec<String> = Vec::new();
    let mut title = String::new();
    if let Some(subject) = subject(study) {
        title = subject.title();
        for &p in steps {
            let mut images = Vec::new();
            for (j, estimator) in NORMALS.into_iter().enumerate() {
                let run = subject.run(Method::of_paper(estimator, subject.gridstep), p);
                let Some(finished) = results.find(&run) else {
                    lines[j].push("-".into());
                    continue;
                };
                let rows = Rows::read(&finished.table)?;
                let columns = &rows.batch.curvatures[0];
                let found = [&columns.mean, &columns.gaussian][i];
                images.push(surface(study, &rows, colours, &[], |row| {
                    f64::from(found[row])
                })?);
                let change = clean[j].as_ref().map(|clean| {
                    let before = &clean.batch.curvatures[0];
                    let before = [&before.mean, &before.gaussian][i];
                    Errors::of(
                        rows.common(clean)
                            .into_iter()
                            .map(|[now, then]| f64::from((found[now] - before[then]).abs())),
                    )
                });
                lines[j].push(change.map_or("0".into(), |e| {
                    format!("{} ({})", number(e.median), number(e.l2))
                }));
                if let Some(change) = change.filter(|_| Some(&p) == steps.last()) {
                    changes.push(format!(
                        "{} {} ({})",
                        estimator.name(),
                        number(change.median),
                        number(change.l2)
                    ));
                }
                if p == 0.0 {
                    montage.columns.push(format!("u = {}", estimator.name()));
                    clean[j] = Some(rows);
                }
            }
            montage.rows.push((format!("p = {p}"), images));
        }
    }
    table.rows = lines;
    let file = format!("figure{figure:02}");
    drawing::write(study, &file, &montage)?;
    page::write(&study.folder, &format!("{file}.csv"), table.csv())?;
    let most = steps.last().copied().unwrap_or(0.0);
    Ok(Section {
        title: format!("Figure {figure}: {letter} with noise"),
        paper: "the method depends mostly on the quality of u; VCM normals are relatively accurate but more unstable \
                than II, II are inaccurate at sharp features."
            .into(),
        finding: format!(
            "at p = {most}, {letter} differs from its value without noise, on the surfels that are in both, by {} \
             (median, and root mean square).",
            changes.join(", ")
        ),
        body: format!(
            "![{letter} with noise]({file}.png)\n\n*{title}. {} A voxel at distance d of the surface is flipped with \
             probability p^d, rows from p = 0 on, columns by normals; the average of the surface is not in the paper. \
             Below: median, and root mean square, of the difference of {letter} from its value without noise, \
             on the surfels that are in both.* \
             Numbers: [{file}.csv]({file}.csv).\n\n{}\n{}",
            origin(study, Group::Second),
            table.markdown(),
            results.refusals(&picture_runs(study))
        ),
    })
}

const GOURSAT: &str = "goursat";

/// Estimators in the plots.
const PLOTTED_ESTIMATORS: [Estimator; 5] = [
    Estimator::Ii,
    Estimator::Vcm,
    Estimator::Average,
    Estimator::Trivial,
    Estimator::PlainIi,
];

fn plotted_gridstep(study: &Study) -> f64 {
    study.finest.max(if study.quick { 0.5 } else { 0.25 })
}

fn plotted_run(study: &Study, estimator: Estimator, p: f64) -> Run {
    let h = plotted_gridstep(study);
    let method = match estimator {
        Estimator::PlainIi => Method::plain(h, 1.0 / 3.0, &[6.0]),
        _ => Method::of_paper(estimator, h),
    };
    Run {
        noise: p,
        ..Run::shape(GOURSAT, h, method)
    }
}

/// Errors against noise.
pub fn error_runs(study: &Study) -> Vec<Run> {
    let all = PLOTTED_ESTIMATORS.into_iter();
    all.flat_map(|e| {
        plotted(study)
            .iter()
            .map(move |&p| plotted_run(study, e, p))
    })
    .collect()
}

/// See [`error_runs`].
pub fn errors(study: &Study, results: &Results) -> Result<Section> {
    let steps = plotted(study);
    let most = steps.last().copied().unwrap_or(0.0);
    let mut csv = Table::new(&[
        "curvature",
        "estimator",
        "p",
        "l2",
        "linf",
        "median",
        "left_out",
    ]);
    let mut table = Table::new(&["curvature", "estimator", "norm"]);
    table
        .header
        .extend(steps.iter().map(|p| format!("p = {p}")));
    let mut panels = Vec::new();
    let mut best = Vec::new();
    let mut specks = 0;
    for curvature in [Curvature::Mean, Curvature::Gaussian] {
        let letter = curvature.letter();
        let mut lines = Vec::new();
        let mut at_most: Option<(f64, &str)> = None;
        for (colour, estimator) in PLOTTED_ESTIMATORS.into_iter().enumerate() {
            let all: Vec<(f64, &Finished)> = steps
                .iter()
                .filter_map(|&p| Some((p, results.find(&plotted_run(study, estimator, p))?)))
                .collect();
            let measured = |finished: &Finished| {
                let values = finished.measured.at.first()?.values?;
                Some(values[curvature.index()])
            };
            if all.is_empty() {
                continue;
            }
            for norm in Norm::BOTH {
                let points: Vec<(f64, f64)> = all
                    .iter()
                    .filter_map(|(p, finished)| Some((*p, norm.of(&measured(finished)?))))
                    .collect();
                let mut row = vec![letter.into(), estimator.name().into(), norm.name().into()];
                row.extend(steps.iter().map(|p| {
                    let found = points.iter().find(|point| point.0 == *p);
                    number(found.map_or(f64::NAN, |point| point.1))
                }));
                table.rows.push(row);
                if norm == Norm::L2 {
                    if let Some(&(p, last)) = points.last()
                        && p == most
                        && at_most.is_none_or(|best| last < best.0)
                    {
                        at_most = Some((last, estimator.name()));
                    }
                    lines.push(Line {
                        name: estimator.name().into(),
                        colour,
                        thick: false,
                        dashed: false,
                        points,
                    });
                }
            }
            for (p, finished) in all {
                if let Some(e) = measured(finished) {
                    specks = specks.max(finished.measured.left_out);
                    csv.rows.push(vec![
                        letter.into(),
                        estimator.name().into(),
                        full(p),
                        full(e.l2),
                        full(e.linf),
                        full(e.median),
                        finished.measured.left_out.to_string(),
                    ]);
                }
            }
        }
        if let Some((error, name)) = at_most {
            best.push(format!("of {letter}: {name} ({})", number(error)));
        }
        panels.push(Panel {
            title: format!("l2 error of {letter} against noise"),
            x: "p".into(),
            y: format!("l2 error of {letter}"),
            x_axis: Axis::Linear,
            lines,
        });
    }
    page::write(&study.folder, "noise.svg", svg(&panels)?)?;
    page::write(&study.folder, "noise.csv", csv.csv())?;
    Ok(Section {
        title: "Beyond the paper: errors against noise".into(),
        paper: String::new(),
        finding: format!("smallest l2 error at p = {}: {}.", most, best.join(", ")),
        body: format!(
            "![errors against noise](noise.svg)\n\n*Goursat at h = {}, noise p as above, against the surface without \
             noise, r = rho = 3 h^(1/2), plain II with r' = 6 h^(1/3). Left out: surfels of specks that lie wholly \
             within their ball (at most {specks} of a run).* Numbers: [noise.csv](noise.csv).\n\n{}\n{}",
            page::gridstep(plotted_gridstep(study)),
            table.markdown(),
            results.refusals(&error_runs(study))
        ),
    })
}
