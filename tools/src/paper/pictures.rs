//! Coloured surfaces: figures 9 and 15 (accuracy on Goursat's), 11, 12, 16 and 17 (digital shapes).

use anyhow::Result;

use super::convergence::Curvature;
use super::drawing::{self, bar, of_goursat, signed, surface};
use super::methods::{Estimator, Method};
use super::page::{self, Section, Table, gridstep, number};
use super::rows::{Rows, Truth, truth};
use super::runs::Run;
use super::study::{Results, Study};
use super::subjects::{Group, Subject, origin};
use crate::picture::{ColourMap, Montage};

const GOURSAT: &str = "goursat";

/// Gridsteps of figure 9.
const SHOWN: [f64; 3] = [0.5, 0.25, 0.125];

/// Corrected measures and plain integral invariants, with the radii of section 6.1.
fn pair(h: f64) -> [Method; 2] {
    [
        Method::of_paper(Estimator::Ii, h),
        Method::plain(h, 1.0 / 3.0, &[6.0]),
    ]
}

fn shown(study: &Study) -> Vec<f64> {
    let all = SHOWN.into_iter();
    let steps: Vec<f64> = all.filter(|&h| h >= study.finest).collect();
    if steps.is_empty() {
        vec![study.finest]
    } else {
        steps
    }
}

/// Figures 9 and 15.
pub fn accuracy_runs(study: &Study) -> Vec<Run> {
    let steps = shown(study).into_iter();
    steps
        .flat_map(|h| pair(h).map(|method| Run::shape(GOURSAT, h, method)))
        .collect()
}

/// Figure 9.
pub fn accuracy_mean(study: &Study, results: &Results) -> Result<Section> {
    accuracy(study, results, Curvature::Mean, 9)
}

/// Figure 15.
pub fn accuracy_gaussian(study: &Study, results: &Results) -> Result<Section> {
    accuracy(study, results, Curvature::Gaussian, 15)
}

/// Where the errors of a run are.
struct Places {
    /// The share of the squared error that the tenth of the surfels with the largest true |value|
    /// carries.
    extremal: f64,
    /// The share of neighbours between which the error changes its sign.
    oscillates: f64,
}

fn places(rows: &Rows, truth: &[Option<Truth>], curvature: Curvature) -> Places {
    let i = curvature.index();
    let found = column(rows, curvature);
    let error = |row: usize| Some(f64::from(found[row]) - truth[row]?.values[i]);
    let mut by_size: Vec<(f64, f64)> = (0..rows.len())
        .filter_map(|row| Some((truth[row]?.values[i].abs(), error(row)?.powi(2))))
        .collect();
    by_size.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let sum = |part: &[(f64, f64)]| part.iter().map(|p| p.1).sum::<f64>();
    let tenth = &by_size[..by_size.len().div_ceil(10)];
    let neighbours = rows.neighbours();
    let changes = neighbours.iter().filter(|&&[a, b]| {
        matches!((error(a as usize), error(b as usize)), (Some(a), Some(b)) if (a > 0.0) != (b > 0.0))
    });
    Places {
        extremal: sum(tenth) / sum(&by_size),
        oscillates: changes.count() as f64 / neighbours.len().max(1) as f64,
    }
}

fn column(rows: &Rows, curvature: Curvature) -> &[f32] {
    let columns = &rows.batch.curvatures[0];
    match curvature {
        Curvature::Mean => &columns.mean,
        Curvature::Gaussian => &columns.gaussian,
    }
}

fn percent(share: f64) -> String {
    if share.is_finite() {
        format!("{:.0} %", 100.0 * share)
    } else {
        "-".into()
    }
}

fn accuracy(
    study: &Study,
    results: &Results,
    curvature: Curvature,
    figure: u32,
) -> Result<Section> {
    let letter = curvature.letter();
    let i = curvature.index();
    let colours = of_goursat(curvature);
    let errors = ColourMap::Error {
        range: if curvature == Curvature::Mean {
            0.05
        } else {
            0.025
        },
    };
    let names = ["corrected measures", "plain II"];
    let mut montage = Montage {
        columns: Vec::new(),
        rows: vec![(format!("true {letter}"), Vec::new())],
        bars: vec![
            bar(colours, letter),
            bar(errors, &format!("error of {letter}")),
        ],
    };
    for name in names {
        montage.rows.push((format!("{letter}, {name}"), Vec::new()));
        montage
            .rows
            .push((format!("its error, {name}"), Vec::new()));
    }
    let mut table = Table::new(&[
        "h",
        "estimator",
        "l2",
        "linf",
        "squared error on the tenth of the surfels with the largest true value",
        "neighbours between which the error changes sign",
    ]);
    let mut finding = String::new();
    for h in shown(study) {
        montage.columns.push(format!("h = {h}"));
        let mut known: Option<Vec<Option<Truth>>> = None;
        for (j, method) in pair(h).into_iter().enumerate() {
            let Some(finished) = results.find(&Run::shape(GOURSAT, h, method)) else {
                continue;
            };
            let rows = Rows::read(&finished.table)?;
            if known.is_none() {
                let truth = truth(GOURSAT, &rows)?;
                let value = |row: usize| truth[row].map_or(f64::NAN, |t| t.values[i]);
                let image = surface(study, &rows, colours, &[], value)?;
                montage.rows[0].1.push(image);
                known = Some(truth);
            }
            let truth = known.as_deref().unwrap_or_default();
            let found = column(&rows, curvature);
            let value = |row: usize| f64::from(found[row]);
            let error = |row: usize| value(row) - truth[row].map_or(f64::NAN, |t| t.values[i]);
            let [image, of_error] = [
                surface(study, &rows, colours, &[], value)?,
                surface(study, &rows, errors, &[], error)?,
            ];
            montage.rows[1 + 2 * j].1.push(image);
            montage.rows[2 + 2 * j].1.push(of_error);
            let places = places(&rows, truth, curvature);
            let measured = finished.measured.at.first().and_then(|at| at.values);
            let [l2, linf] = measured.map_or([f64::NAN; 2], |e| [e[i].l2, e[i].linf]);
            table.rows.push(vec![
                gridstep(h),
                names[j].into(),
                number(l2),
                number(linf),
                percent(places.extremal),
                percent(places.oscillates),
            ]);
            if j == 0 {
                let localised = if places.extremal > 0.1 {
                    "more"
                } else {
                    "no more"
                };
                finding = format!(
                    "at h = {} the tenth of the surfels with the largest |{letter}| carries {} of the squared \
                     error, {localised} than its share; ",
                    gridstep(h),
                    percent(places.extremal)
                );
                finding.push_str(&format!(
                    "the error changes sign between {} of neighbours",
                    percent(places.oscillates)
                ));
            } else {
                finding.push_str(&format!(" (plain II: {})", percent(places.oscillates)));
            }
        }
    }
    montage.rows.retain(|(_, images)| !images.is_empty());
    let file = format!("figure{figure:02}");
    drawing::write(study, &file, &montage)?;
    page::write(&study.folder, &format!("{file}.csv"), table.csv())?;
    let [range, band, red] = match curvature {
        Curvature::Mean => ["0.3", "0.01", "0.025"],
        Curvature::Gaussian => ["0.1", "0.002", "0.0125"],
    };
    Ok(Section {
        title: format!("Figure {figure}: where {letter} and its errors are"),
        paper: format!(
            "errors of {letter} are mostly on places of extremal curvature; the corrected estimator converges \
             faster everywhere and does not oscillate around the correct value."
        ),
        finding: format!("{finding}."),
        body: format!(
            "![{letter} and its errors on Goursat's surface]({file}.png)\n\n*From above: true {letter}; {letter} by \
             corrected measures, and its error; {letter} by plain integral invariants (r' = 6 h^(1/3)), and its \
             error. {letter} from dark blue (-{range}) over white to red ({range}), black within ±{band}; errors \
             from white (0) over red ({red}) to black (twice that and more).* Numbers: [{file}.csv]({file}.csv).\
             \n\n{}\n{}",
            table.markdown(),
            results.refusals(&accuracy_runs(study))
        ),
    })
}

/// Estimators that figures 11, 12, 16 and 17 show.
fn methods(h: f64) -> [Method; 3] {
    [
        Method::of_paper(Estimator::Ii, h),
        Method::of_paper(Estimator::Trivial, h),
        Method::plain(h, 1.0 / 3.0, &[6.0]),
    ]
}

fn subject_runs(study: &Study, group: Group) -> Vec<Run> {
    Subject::all(study, group)
        .iter()
        .flat_map(|subject| methods(subject.gridstep).map(|method| subject.run(method, 0.0)))
        .collect()
}

/// Figures 11 and 16.
pub fn first_runs(study: &Study) -> Vec<Run> {
    subject_runs(study, Group::First)
}

/// Figures 12 and 17.
pub fn second_runs(study: &Study) -> Vec<Run> {
    subject_runs(study, Group::Second)
}

/// Figure 11.
pub fn first_mean(study: &Study, results: &Results) -> Result<Section> {
    subjects(study, results, Group::First, Curvature::Mean, 11)
}

/// Figure 12.
pub fn second_mean(study: &Study, results: &Results) -> Result<Section> {
    subjects(study, results, Group::Second, Curvature::Mean, 12)
}

/// Figure 16.
pub fn first_gaussian(study: &Study, results: &Results) -> Result<Section> {
    subjects(study, results, Group::First, Curvature::Gaussian, 16)
}

/// Figure 17.
pub fn second_gaussian(study: &Study, results: &Results) -> Result<Section> {
    subjects(study, results, Group::Second, Curvature::Gaussian, 17)
}

/// The colours of the figures of a group.
pub fn of_group(group: Group, curvature: Curvature) -> ColourMap {
    match (group, curvature) {
        (Group::First, Curvature::Mean) => signed(0.3, 0.01),
        (Group::Second, Curvature::Mean) => signed(0.2, 0.005),
        (_, Curvature::Gaussian) => signed(0.05, 0.0005),
    }
}

fn subjects(
    study: &Study,
    results: &Results,
    group: Group,
    curvature: Curvature,
    figure: u32,
) -> Result<Section> {
    let letter = curvature.letter();
    let i = curvature.index();
    let colours = of_group(group, curvature);
    let mut montage = Montage {
        columns: Vec::new(),
        rows: methods(1.0)
            .map(|method| {
                (
                    format!("{letter}, {}", method.estimator.phrase()),
                    Vec::new(),
                )
            })
            .into(),
        bars: vec![bar(colours, letter)],
    };
    let mut table = Table::new(&[
        "shape",
        "estimator",
        "surfels",
        "roughness",
        "times corrected",
    ]);
    let mut ratios: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    for subject in Subject::all(study, group) {
        montage.columns.push(subject.title());
        let mut corrected = f64::NAN;
        for (j, method) in methods(subject.gridstep).into_iter().enumerate() {
            let name = method.estimator.phrase();
            let Some(finished) = results.find(&subject.run(method, 0.0)) else {
                continue;
            };
            let rows = Rows::read(&finished.table)?;
            let found = column(&rows, curvature);
            let image = surface(study, &rows, colours, &[], |row| f64::from(found[row]))?;
            montage.rows[j].1.push(image);
            let roughness = finished
                .measured
                .at
                .first()
                .map_or(f64::NAN, |at| at.roughness[i]);
            if j == 0 {
                corrected = roughness;
            } else {
                ratios[j - 1].push(roughness / corrected);
            }
            table.rows.push(vec![
                subject.title(),
                name.into(),
                finished.measured.surfels.to_string(),
                number(roughness),
                number(roughness / corrected),
            ]);
        }
    }
    montage.rows.retain(|(_, images)| !images.is_empty());
    let file = format!("figure{figure:02}");
    drawing::write(study, &file, &montage)?;
    page::write(&study.folder, &format!("{file}.csv"), table.csv())?;
    let said = |name: &str, all: &[f64]| {
        let list: Vec<String> = all.iter().map(|&r| number(r)).collect();
        if list.is_empty() {
            format!("{name} was not run")
        } else {
            format!("{} times with {name}", list.join(" and "))
        }
    };
    let [range, band] = match colours {
        ColourMap::Signed { range, band, .. } => [range, band],
        ColourMap::Error { range } => [range, 0.0],
    };
    Ok(Section {
        title: format!("Figure {figure}: {letter} on digital shapes, set {}", match group {
            Group::First => "one",
            Group::Second => "two",
        }),
        paper: match curvature {
            Curvature::Mean => {
                "the normal cycle and plain integral invariants oscillate around the correct values, corrected \
                 measures are stable where the curvature is zero and delineate small scales."
            }
            Curvature::Gaussian => {
                "plain integral invariants oscillate; the normal cycle is clearly incorrect and gives only \
                 extremal values."
            }
        }
        .into(),
        finding: format!(
            "neighbouring values of {letter} differ (root mean square), against corrected measures, {}, {}.",
            said("the normal cycle", &ratios[0]),
            said("plain II", &ratios[1])
        ),
        body: format!(
            "![{letter} on digital shapes]({file}.png)\n\n*{} Radii as in section 6.1; {letter} from dark blue \
             (-{range}) over white to red ({range}), black within ±{band}. Roughness is the root mean square of \
             the differences of {letter} between surfels that share a linel.* Numbers: [{file}.csv]({file}.csv).\
             \n\n{}\n{}",
            origin(study, group),
            table.markdown(),
            results.refusals(&subject_runs(study, group))
        ),
    })
}
