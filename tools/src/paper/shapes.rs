//! The other shapes of known curvature, as figures 8 and 14 show Goursat's.

use std::fmt::Write as _;

use anyhow::Result;

use super::convergence::{Curvature, POWERS, STROKES, curve, of_value, panel};
use super::methods::{Estimator, Method};
use super::page::{self, ErrorTable, Section, gridstep};
use super::plot::svg;
use super::runs::Run;
use super::slopes::{Curve, Norm, exponent};
use super::study::{Results, Study};

/// The finest gridstep.
const FINEST: f64 = 1.0 / 8.0;

/// Those that DGtal knows too.
const SHAPES: [&str; 5] = ["sphere", "torus", "ellipsoid", "rcube", "leopold"];

/// Shapes other than Goursat's.
pub fn runs(study: &Study) -> Vec<Run> {
    let shapes = if study.quick {
        &SHAPES[..2]
    } else {
        &SHAPES[..]
    };
    let mut runs = Vec::new();
    for shape in shapes {
        for h in study.gridsteps(FINEST) {
            for estimator in [Estimator::Ii, Estimator::Average] {
                runs.push(Run::shape(shape, h, Method::of_paper(estimator, h)));
            }
        }
    }
    runs
}

/// See [`runs`].
pub fn section(study: &Study, results: &Results) -> Result<Section> {
    let runs = runs(study);
    let steps = study.gridsteps(FINEST);
    let mut body = String::new();
    let mut panels = Vec::new();
    let mut csv = String::new();
    let mut flattest: Option<(f64, String)> = None;
    for curvature in [Curvature::Mean, Curvature::Gaussian] {
        let letter = curvature.letter();
        let mut curves = Vec::new();
        for estimator in [Estimator::Ii, Estimator::Average] {
            for shape in SHAPES {
                let of_shape: Vec<Run> = runs
                    .iter()
                    .filter(|run| run.solid_name() == shape && run.method.estimator == estimator)
                    .cloned()
                    .collect();
                let name = format!("{shape}, {}", estimator.name());
                let found = curve(results, &of_shape, &name, of_value(curvature));
                if !found.points.is_empty() {
                    curves.push(found);
                }
            }
        }
        let drawn: Vec<(Curve, usize)> = curves
            .iter()
            .filter(|c| c.name.ends_with(", ii"))
            .cloned()
            .enumerate()
            .map(|(i, c)| (c, i))
            .collect();
        let title = format!("other shapes: error of {letter}, u = II");
        panels.push(panel(
            &title,
            &format!("error of {letter}"),
            &drawn,
            &POWERS,
        ));
        for (curve, _) in &drawn {
            if let Some(b) = exponent(&curve.norms(Norm::L2))
                && flattest.as_ref().is_none_or(|(least, _)| b < *least)
            {
                flattest = Some((b, format!("{letter} of {}", curve.name)));
            }
        }
        let errors = ErrorTable {
            gridsteps: &steps,
            curves: &curves,
            dgtal: &|_, _, _| None,
        };
        for line in errors.csv().lines().skip(usize::from(!csv.is_empty())) {
            let first = if csv.is_empty() { "curvature" } else { letter };
            let _ = writeln!(csv, "{first},{line}");
        }
        let _ = write!(
            body,
            "Errors of {letter}:\n\n{}\n",
            errors.table().markdown()
        );
    }
    page::write(&study.folder, "shapes.svg", svg(&panels)?)?;
    page::write(&study.folder, "shapes.csv", csv)?;
    let finding = match flattest {
        Some((b, what)) if b > 0.12 => {
            format!(
                "with u = ii the l2 error falls on every shape; least steep is {what}, with slope {b:.2}."
            )
        }
        Some((b, what)) => format!("the l2 error of {what} does not fall (slope {b:.2})."),
        None => "too few gridsteps for slopes.".into(),
    };
    Ok(Section {
        title: "Beyond the paper: other shapes".into(),
        paper: String::new(),
        finding,
        body: format!(
            "![errors on other shapes](shapes.svg)\n\n*The sphere (radius 9), the torus (6, 2), the ellipsoid (9, 6, \
             4), a cube with round edges (x^4 + y^4 + z^4 = 9^4) and Leopold's surface, whose ridges have radii far below those of the balls at all these gridsteps; r = rho = 3 h^(1/2), down to \
             h = {}. {STROKES}* Numbers: [shapes.csv](shapes.csv).\n\n{body}{}",
            gridstep(steps.last().copied().unwrap_or(1.0)),
            results.refusals(&runs)
        ),
    })
}
