//! The tables, as Markdown.

use std::fmt::Write as _;

use super::case::{Task, Trial};
use super::{COMPARED, METHODS, QUANTITIES};

/// What the methods gave on a case.
pub(super) struct Row {
    pub(super) task: Task,
    /// Shape and gridstep.
    pub(super) name: String,
    pub(super) trials: Vec<Trial>,
}

/// A table: its title, and the cases.
pub(super) struct Section {
    pub(super) title: String,
    pub(super) rows: Vec<Row>,
}

/// The tables: errors of the first method, and of the compared ones as ratios to it.
pub(super) fn page(sections: &[Section]) -> String {
    let mut page = String::from(
        "# Errors of the methods\n\n\
         Made by `cargo run --release -p curvox-tools -- methods -o docs/accuracy`. Of `paper` errors l2 / linf; of the \
         others their ratios to these, and the ratio of times (the whole run). Radius 3 h^(1/2) unless said. A ratio above 1 is worse. \
         *Oriented* is the paper's method with its normals turned away from the solid; DGtal's rule reverses some of them, which ruins G.\n",
    );
    for Section { title, rows } in sections {
        let _ = writeln!(page, "\n## {title}\n");
        let heads: Vec<String> = (QUANTITIES.iter())
            .map(|q| format!("paper {q} | default | refined"))
            .collect();
        let _ = writeln!(page, "| shape | h | {} | time |", heads.join(" | "));
        let _ = writeln!(page, "|---|---|{}", "---|".repeat(3 * QUANTITIES.len() + 1));
        for Row { name, trials, .. } in rows {
            let _ = write!(page, "| {name} |");
            for q in 0..QUANTITIES.len() {
                let [l2, linf] = trials[0].errors[q];
                let _ = write!(page, " {l2:.4} / {linf:.3} |");
                for trial in &trials[COMPARED] {
                    let [a, b] = trial.errors[q];
                    let _ = write!(page, " {:.2} / {:.2} |", a / l2, b / linf);
                }
            }
            let times = trials[COMPARED]
                .iter()
                .map(|t| format!("{:.2}", t.microseconds / trials[0].microseconds));
            let _ = writeln!(page, " {} |", times.collect::<Vec<_>>().join(" / "));
        }
        let _ = writeln!(page);
        for (to, of) in [(0, "`paper`"), (1, "the same, oriented")] {
            for m in COMPARED {
                let ratios = |quantities: usize| -> Vec<f64> {
                    let pairs = rows.iter().flat_map(|Row { trials, .. }| {
                        let errors = |i: usize| trials[i].errors[..quantities].iter().flatten();
                        errors(m)
                            .zip(errors(to))
                            .map(|(a, b)| a / b)
                            .collect::<Vec<_>>()
                    });
                    pairs.collect()
                };
                let (all, of_h_and_g) = (ratios(4), ratios(2));
                let _ = writeln!(
                    page,
                    "- **{}** to {of}: geometric mean of all ratios {:.3}, largest {:.2}, above 1.05 {} of {}; of H and G {:.3}, \
                     largest {:.2}, above 1/2 {} of {}.",
                    METHODS[m].0,
                    geometric_mean(&all),
                    largest(&all),
                    above(&all, 1.05),
                    all.len(),
                    geometric_mean(&of_h_and_g),
                    largest(&of_h_and_g),
                    above(&of_h_and_g, 0.5),
                    of_h_and_g.len(),
                );
            }
        }
    }
    page
}

fn geometric_mean(ratios: &[f64]) -> f64 {
    let logarithms: f64 = ratios.iter().map(|&x| libm::log(x)).sum();
    libm::exp(logarithms / ratios.len().max(1) as f64)
}

fn largest(ratios: &[f64]) -> f64 {
    ratios
        .iter()
        .copied()
        .fold(0.0, |a, b| if b.total_cmp(&a).is_gt() { b } else { a })
}

fn above(ratios: &[f64], limit: f64) -> usize {
    // in total order what is no number is above
    ratios
        .iter()
        .filter(|x| x.total_cmp(&limit).is_gt())
        .count()
}
