//! How true errors compare with error bars: calibration curves.

use std::fmt::Write as _;

use anyhow::Result;

use crate::paper::plot::{Axis, Line, Panel, svg};

use super::case::{Task, Trial};
use super::{COMPARED, LOOKED_AT, METHODS, QUANTITIES, SHAPES};

/// Lengths that errors are compared with, in bars.
const STEPS: usize = 16;

/// Share of the surfels of a case that the ball is small enough for, below which the case is left out.
const LEAST_RESOLVED: f64 = 0.75;

/// Bars in a step.
const STEP: f64 = 0.25;

/// How many errors are within so many bars.
#[derive(Clone, Debug, Default)]
pub(super) struct Shares {
    /// By the first length that holds the error, where the ball is no larger than the feature.
    counts: [u64; STEPS],
    resolved: u64,
    all: u64,
}

impl Shares {
    pub(super) fn add(&mut self, error: f64, bar: f64, is_resolved: bool) {
        self.all += 1;
        if !is_resolved {
            return;
        }
        self.resolved += 1;
        // in no step if either is no number
        if let Some(count) = (0..STEPS).find(|&i| error <= bar * STEP * (i + 1) as f64) {
            self.counts[count] += 1;
        }
    }

    /// The share of errors within so many bars, a whole number of steps.
    pub(super) fn within(&self, bars: f64) -> f64 {
        let steps = (bars / STEP).round() as usize;
        self.counts[..steps.min(STEPS)].iter().sum::<u64>() as f64 / self.resolved.max(1) as f64
    }

    /// The share of surfels whose true curvatures are at most 1/radius.
    pub(super) fn resolved(&self) -> f64 {
        self.resolved as f64 / self.all.max(1) as f64
    }
}

/// The cases of one noise, method and quantity, of shapes that were looked at while bars were made or of others.
struct Curve {
    noise: f64,
    is_new: bool,
    method: usize,
    quantity: usize,
    cases: Vec<Shares>,
}

/// Calibration: all cases with the same weight.
#[derive(Default)]
pub(super) struct Calibration {
    curves: Vec<Curve>,
}

impl Curve {
    /// The mean over cases of the share within so many bars.
    fn mean(&self, bars: f64) -> f64 {
        let sum: f64 = self.cases.iter().map(|s| s.within(bars)).sum();
        sum / self.cases.len().max(1) as f64
    }
}

impl Calibration {
    pub(super) fn add(&mut self, task: &Task, trials: &[Trial]) {
        let noise = task.noise;
        let is_new = !SHAPES[..LOOKED_AT].contains(&task.shape);
        for method in COMPARED {
            let Some(shares) = &trials[method].shares else {
                continue;
            };
            if shares[0].resolved() < LEAST_RESOLVED {
                continue;
            }
            for (quantity, shares) in shares.iter().enumerate() {
                let is_same = |c: &&mut Curve| {
                    (c.noise, c.is_new) == (noise, is_new)
                        && (c.method, c.quantity) == (method, quantity)
                };
                match self.curves.iter_mut().find(is_same) {
                    Some(curve) => curve.cases.push(shares.clone()),
                    None => self.curves.push(Curve {
                        noise,
                        is_new,
                        method,
                        quantity,
                        cases: vec![shares.clone()],
                    }),
                }
            }
        }
    }

    /// A table of the shares within one and two bars.
    pub(super) fn table(&self) -> String {
        let mut text = String::from(
            "\n## Error bars\n\nShare of the surfels whose error is within one and within two bars: the mean over the cases above (each \
             with the same weight), and the least and largest of a case; *new* are the shapes that were not looked at while the bars were made. Meant are 0.68 and 0.95. Counted are the surfels whose true \
             principal curvatures are at most 1/radius and the cases in which these are three quarters of all at least: what is smaller than the ball is flattened without a trace, and no bar says so.\n\n\
             | shapes | noise | method | of | cases | within one | each | within two | each |\n|---|---|---|---|---|---|---|---|---|\n",
        );
        for curve in &self.curves {
            let (method, quantity) = (METHODS[curve.method].0, QUANTITIES[curve.quantity]);
            let shapes = if curve.is_new { "new" } else { "known" };
            let count = curve.cases.len();
            let _ = write!(
                text,
                "| {shapes} | {} | {method} | {quantity} | {count} |",
                curve.noise
            );
            for bars in [1.0, 2.0] {
                let each = || curve.cases.iter().map(|s| s.within(bars));
                let least = each().fold(1.0, f64::min);
                let largest = each().fold(0.0, f64::max);
                let mean = curve.mean(bars);
                let _ = write!(text, " {mean:.3} | {least:.2} to {largest:.2} |");
            }
            let _ = writeln!(text);
        }
        text
    }

    /// Curves: the share of errors beyond so many bars.
    pub(super) fn plot(&self) -> Result<String> {
        let normal = (1..=12).map(|i| {
            let bars = STEP * f64::from(i);
            (bars, libm::erfc(bars / std::f64::consts::SQRT_2))
        });
        let normal: Vec<_> = normal.collect();
        let panel = |m: usize, q: usize| {
            let of = (self.curves.iter()).filter(|c| (c.method, c.quantity) == (m, q));
            let mut lines: Vec<Line> = of
                .map(|curve| Line {
                    name: format!(
                        "p = {}{}",
                        curve.noise,
                        if curve.is_new { ", new shapes" } else { "" }
                    ),
                    colour: [0.0, 0.1, 0.3, 0.5]
                        .iter()
                        .position(|&p| p == curve.noise)
                        .unwrap_or(4),
                    thick: false,
                    dashed: curve.is_new,
                    points: (normal.iter())
                        .map(|&(bars, _)| (bars, 1.0 - curve.mean(bars)))
                        .collect(),
                })
                .collect();
            lines.push(Line {
                name: "normal errors".into(),
                colour: 5,
                thick: false,
                dashed: true,
                points: normal.clone(),
            });
            Panel {
                title: format!("{}, {}", METHODS[m].0, QUANTITIES[q]),
                x: "bars".into(),
                y: "share of larger errors".into(),
                x_axis: Axis::Linear,
                lines,
            }
        };
        let panels = COMPARED.flat_map(|m| [0, 1].map(|q| panel(m, q)));
        svg(&panels.collect::<Vec<_>>())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_count_errors_by_their_bars() {
        let mut shares = Shares::default();
        for (error, bar) in [
            (0.5, 1.0),
            (1.0, 1.0),
            (3.0, 2.0),
            (9.0, 1.0),
            (f64::NAN, 1.0),
        ] {
            shares.add(error, bar, true);
        }
        assert_eq!(shares.within(1.0), 0.4);
        assert_eq!(shares.within(2.0), 0.6);
        assert_eq!(shares.within(100.0), 0.6);
        shares.add(0.1, 1.0, false);
        assert_eq!((shares.within(1.0), shares.resolved()), (0.4, 5.0 / 6.0));
    }
}
