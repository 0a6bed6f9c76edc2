//! Time against surfels and against accuracy: figure 19.

use anyhow::Result;

use super::convergence::{Curvature, of_paper, plain};
use super::dgtal::{self, Quantity};
use super::methods::Estimator;
use super::page::{self, Section, Table, full, gridstep, number, slope};
use super::plot::{Axis, Line, Panel, svg};
use super::runs::Run;
use super::slopes::{Norm, Points, exponent};
use super::study::{Results, Study};

const THIRD: f64 = 1.0 / 3.0;

/// Why times differ.
const WHY: &str = "**Why they differ.** In curvox a row of the ball is a window of bits, whose runs of voxels add their counts \
    and moments at once; measures are integers in flat arrays, and one walk over the surface in the ball sums all of \
    them, principal directions too. DGtal walks through the ball once for each measure, with sets of surfels. Plain II is \
    faster in curvox for the same reasons, so what corrected measures gain over it at a given accuracy is less than in \
    the paper.\n";

/// A program with an estimator.
struct Timed {
    name: String,
    colour: usize,
    dashed: bool,
    /// Gridstep, surfels, seconds, l2 error of H.
    points: Vec<[f64; 4]>,
}

impl Timed {
    fn against(&self, column: usize) -> Points {
        self.points.iter().map(|p| (p[column], p[2])).collect()
    }

    /// Exponent of the time over surfels; without h = 1, where starting a program takes most.
    fn growth(&self) -> Option<f64> {
        let fine = self.points.iter().filter(|p| p[0] < 1.0);
        let points: Points = fine.map(|p| (p[1], p[2])).collect();
        exponent(&points)
    }

    /// The time to reach an error, along the line between measured points or, beyond them, along the
    /// last piece of it; with whether it is beyond.
    fn time_for(&self, error: f64) -> Option<(f64, bool)> {
        let points = self.against(3);
        let pieces: Vec<&[(f64, f64)]> = points.windows(2).collect();
        let around = pieces
            .iter()
            .find(|piece| (piece[1].0..=piece[0].0).contains(&error));
        let piece = around.or(pieces.last())?;
        let [(e0, t0), (e1, t1)] = [piece[0], piece[1]];
        let share = libm::log(error / e0) / libm::log(e1 / e0);
        let time = t0 * libm::pow(t1 / t0, share);
        time.is_finite().then_some((time, around.is_none()))
    }
}

/// Figure 19.
pub fn runs(study: &Study) -> Vec<Run> {
    [
        of_paper(study, Estimator::Ii),
        of_paper(study, Estimator::Vcm),
        plain(study, THIRD),
    ]
    .concat()
}

fn ours(results: &Results, runs: &[Run], name: &str, colour: usize) -> Timed {
    let points = runs.iter().filter_map(|run| {
        let finished = results.find(run)?;
        let errors = finished.measured.at.first()?.values?[Curvature::Mean.index()];
        Some([
            run.gridstep,
            finished.measured.surfels as f64,
            finished.record.cpu_seconds?,
            errors.l2,
        ])
    });
    Timed {
        name: format!("curvox, {name}"),
        colour,
        dashed: false,
        points: points.collect(),
    }
}

fn theirs(quantity: Quantity, microseconds: &[f64], name: &str, colour: usize) -> Timed {
    let points = microseconds.iter().enumerate().filter_map(|(i, us)| {
        let (h, surfels) = (dgtal::GRIDSTEPS[i], dgtal::SURFELS[i] as f64);
        let error = dgtal::error(quantity, h, Norm::L2)?;
        Some([h, surfels, us * 1e-6 * surfels, error])
    });
    Timed {
        name: format!("DGtal, {name}"),
        colour,
        dashed: true,
        points: points.collect(),
    }
}

/// See [`runs`].
pub fn section(study: &Study, results: &Results) -> Result<Section> {
    let timed = [
        ours(results, &of_paper(study, Estimator::Ii), "u = II", 0),
        ours(results, &of_paper(study, Estimator::Vcm), "u = VCM", 1),
        ours(results, &plain(study, THIRD), "plain II", 3),
        theirs(Quantity::Mean, &dgtal::MEAN_MICROSECONDS, "u = II", 0),
        theirs(
            Quantity::MeanVcm,
            &dgtal::MEAN_VCM_MICROSECONDS,
            "u = VCM",
            1,
        ),
        theirs(
            Quantity::MeanPlain,
            &dgtal::PLAIN_MICROSECONDS,
            "plain II",
            3,
        ),
    ];
    let panel = |title: &str, x: &str, column: usize| Panel {
        title: title.into(),
        x: x.into(),
        y: "processor seconds, one thread".into(),
        x_axis: Axis::Logarithmic,
        lines: timed
            .iter()
            .map(|t| Line {
                name: t.name.clone(),
                colour: t.colour,
                thick: !t.dashed,
                dashed: t.dashed,
                points: t.against(column),
            })
            .collect(),
    };
    let drawn = svg(&[
        panel("time against surfels", "surfels", 1),
        panel("time against accuracy", "l2 error of H", 3),
    ])?;
    page::write(&study.folder, "figure19.svg", drawn)?;
    let mut csv = Table::new(&["estimator", "gridstep", "surfels", "seconds", "l2_error"]);
    let mut table = Table::new(&["estimator"]);
    let steps = study.gridsteps(0.0);
    table
        .header
        .extend(steps.iter().map(|&h| format!("h = {}", gridstep(h))));
    table.header.push("time ~ surfels^".into());
    for t in timed.iter().filter(|t| !t.points.is_empty()) {
        for point in &t.points {
            let mut row = vec![t.name.clone()];
            row.extend(point.map(full));
            csv.rows.push(row);
        }
        let mut row = vec![t.name.clone()];
        row.extend(steps.iter().map(|h| {
            let at = t.points.iter().find(|p| p[0] == *h);
            at.map_or("-".into(), |p| number(p[2] / p[1] * 1e6))
        }));
        row.push(slope(t.growth()));
        table.rows.push(row);
    }
    page::write(&study.folder, "figure19.csv", csv.csv())?;

    let [corrected, _, plain_ii, dgtal_corrected, _, dgtal_plain] = &timed;
    let grows = |t: &Timed| match t.growth() {
        Some(b) => format!("like surfels^{b:.2}"),
        None => "unknown (not run)".into(),
    };
    let mut finding = vec![format!(
        "growth of time with corrected measures {} (DGtal: {}), with plain II {} (DGtal: {})",
        grows(corrected),
        grows(dgtal_corrected),
        grows(plain_ii),
        grows(dgtal_plain)
    )];
    // At the finest gridstep that both have.
    let common = corrected.points.iter().rev().find_map(|p| {
        let other = dgtal_corrected.points.iter().find(|q| q[0] == p[0])?;
        Some((p[0], other[2] / p[2]))
    });
    if let Some((h, ratio)) = common {
        finding.push(format!(
            "at h = {} DGtal takes {} times curvox's time for H, on another machine of the kind",
            gridstep(h),
            number(ratio)
        ));
    }
    // What plain II reaches at its finest.
    if let Some(&[_, _, seconds, error]) = plain_ii.points.last()
        && let Some((time, beyond)) = corrected.time_for(error)
    {
        finding.push(format!(
            "for an l2 error of {}, where plain II takes {} s, corrected measures take {} s{}: {} times less",
            number(error),
            number(seconds),
            number(time),
            if beyond { " (extrapolated)" } else { "" },
            number(seconds / time)
        ));
    }
    let target = 0.0065;
    if let (Some((plain_time, _)), Some((time, _))) =
        (plain_ii.time_for(target), corrected.time_for(target))
    {
        finding.push(format!(
            "for the paper's 0.0065, extrapolated for plain II, {} times less",
            number(plain_time / time)
        ));
    }
    let load = runs(study)
        .iter()
        .filter_map(|run| results.find(run)?.record.load)
        .fold(f64::NAN, f64::max);
    let load = if load.is_finite() {
        format!(
            "**How far to trust the times.** Runs were made one after the other; the load average of the machine \
             was at most {load:.1}, of which one to two are the run and the shape piped to it. Processor time under a higher load \
             is longer than on a quiet machine, for cores share caches and memory.\n\n"
        )
    } else {
        String::new()
    };
    Ok(Section {
        title: "Figure 19: time".into(),
        paper: "the time of corrected measures grows like N^(3/2) in the number N of surfels, that of plain integral \
                invariants like N^2; for a given accuracy corrected measures are much faster, 5000 times for an \
                l2 error of 0.0065. G and principal curvatures take almost the same; VCM normals are faster than II for large shapes, but need \
                more memory."
            .into(),
        finding: format!("{}.", finding.join("; ")),
        body: format!(
            "![time against surfels and against accuracy](figure19.svg)\n\n*Goursat, one thread. curvox: processor time \
             (user and system) of whole runs, from the voxels in a pipe to the Parquet file with H, G, k1, k2, d1, d2 \
             together. DGtal: normals, mesh and the two sums for H alone (plain II: H alone), on a similar \
             machine, not in the same run. Exponents are fitted without h = 1.* Numbers: [figure19.csv](figure19.csv).\n\n\
             Microseconds a surfel:\n\n{}\n{load}{}\n{}",
            table.markdown(),
            WHY,
            results.refusals(&runs(study))
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_between_and_beyond_points_follow_their_power() {
        // Time is error^-3.
        let timed = Timed {
            name: String::new(),
            colour: 0,
            dashed: false,
            points: [0.4, 0.2, 0.1]
                .map(|e: f64| [e, e.powi(-2), e.powi(-3), e])
                .into(),
        };
        assert!((timed.growth().unwrap() - 1.5).abs() < 1e-12);
        for (error, beyond) in [(0.3, false), (0.15, false), (0.05, true)] {
            let (time, extrapolated) = timed.time_for(error).unwrap();
            assert!((time * error.powi(3) - 1.0).abs() < 1e-9);
            assert_eq!(extrapolated, beyond);
        }
    }
}
