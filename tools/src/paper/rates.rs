//! Exponents of convergence side by side: figures 8 and 14 in one table.

use anyhow::Result;

use super::convergence::{Curvature, comparison_curves, dgtal_of};
use super::page::{self, Section, Table, slope};
use super::slopes::{Norm, Points, exponent, last_three};
use super::study::{Results, Study};

/// The exponent of the paper.
const PAPER: f64 = 2.0 / 3.0;

/// Corrected measures that converge, by DGtal's weights and by ours.
const SHOWN: [&str; 4] = ["ii", "paper ii", "vcm", "paper vcm"];

/// Gridsteps that DGtal's numbers are known for, for exponents over the same ones.
const COMMON: f64 = 1.0 / 16.0;

/// Exponents of the errors of H and G; of the runs of [`super::convergence::comparison_runs`].
///
/// # Errors
/// If a file cannot be written.
pub fn section(study: &Study, results: &Results) -> Result<Section> {
    let mut table = Table::new(&["quantity", "norm", "u", "who", "all", "last 3"]);
    let mut least = f64::INFINITY;
    for curvature in [Curvature::Mean, Curvature::Gaussian] {
        let theirs = dgtal_of(curvature);
        let curves = comparison_curves(study, results, curvature);
        for norm in Norm::BOTH {
            for name in SHOWN {
                let Some(curve) = curves.iter().find(|curve| curve.name == name) else {
                    continue;
                };
                let ours: Points = curve.norms(norm);
                let common: Points = ours.iter().copied().filter(|p| p.0 >= COMMON).collect();
                let beside: Points = common
                    .iter()
                    .filter_map(|&(h, _)| Some((h, theirs(name, h, norm)?)))
                    .collect();
                let mut add = |who: &str, points: &Points| {
                    table.rows.push(vec![
                        curvature.letter().into(),
                        norm.name().into(),
                        name.into(),
                        who.into(),
                        slope(exponent(points)),
                        slope(last_three(points)),
                    ]);
                };
                add("curvox", &common);
                if ours.len() > common.len() {
                    let finest = ours.last().map_or(1.0, |p| p.0);
                    add(&format!("curvox, to h = {}", page::gridstep(finest)), &ours);
                }
                if name.starts_with("paper") {
                    add("DGtal", &beside);
                }
                if norm == Norm::L2 {
                    least = exponent(&common).map_or(least, |b| least.min(b));
                }
            }
        }
    }
    page::write(&study.folder, "slopes.csv", table.csv())?;
    let finding = if least.is_finite() {
        format!(
            "exponents of the l2 errors of H and G are at least {least:.2} with II and VCM normals, {} the {PAPER:.2} of \
             the paper.",
            if least >= PAPER { "above" } else { "below" }
        )
    } else {
        "too few gridsteps for slopes.".into()
    };
    Ok(Section {
        title: "Figures 8 and 14: exponents".into(),
        paper: "H and G converge like h^(2/3) with II and with VCM normals (section 6.1).".into(),
        finding,
        body: format!(
            "Exponents of h over all gridsteps, and over the last three. Errors on a digital surface go up and down \
             with the way the grid meets the shape, so exponents over three gridsteps differ from those over all.\n\n\
             Numbers: [slopes.csv](slopes.csv).\n\n{}",
            table.markdown()
        ),
    })
}
