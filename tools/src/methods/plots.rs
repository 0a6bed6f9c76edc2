//! Errors against the gridstep.

use anyhow::Result;

use crate::paper::plot::{Axis, Line, Panel, svg};

use super::tables::{Row, Section};
use super::{METHODS, QUANTITIES};

/// Shapes that are plotted.
pub(super) const SHAPES: [&str; 3] = ["sphere", "goursat", "ellipsoid90"];

/// H and G of a shape in the first general position: l2 thin, linf thick.
pub(super) fn errors(shape: &str, sections: &[Section]) -> Result<String> {
    let is_plotted = |row: &&Row| {
        let t = &row.task;
        let as_in_the_paper = t.radius.is_none() && !t.flat && t.noise == 0.0;
        t.shape == shape && t.position == 1 && as_in_the_paper
    };
    let rows: Vec<&Row> = (sections.iter())
        .flat_map(|section| section.rows.iter().filter(is_plotted))
        .collect();
    let panels = [0, 1].map(|q| {
        let lines = (0..METHODS.len()).flat_map(|m| [false, true].map(|thick| (m, thick)));
        let lines = lines.map(|(m, thick)| Line {
            name: format!("{}, {}", METHODS[m].0, if thick { "linf" } else { "l2" }),
            colour: m,
            thick,
            dashed: METHODS[m].0.starts_with("paper"),
            points: (rows.iter())
                .map(|row| {
                    let [l2, linf] = row.trials[m].errors[q];
                    (row.task.gridstep, if thick { linf } else { l2 })
                })
                .collect(),
        });
        Panel {
            title: format!("{shape}, error of {}", QUANTITIES[q]),
            x: "gridstep h".into(),
            y: "error".into(),
            x_axis: Axis::Gridstep,
            lines: lines.collect(),
        }
    });
    svg(&panels)
}
