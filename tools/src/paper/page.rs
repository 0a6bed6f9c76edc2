//! The page: figure by figure what the paper says, our numbers, and what they say of it.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};

use super::slopes::{Curve, Norm, Points, exponent, last_three};

/// Rows of texts under a header.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Names of the columns.
    pub header: Vec<String>,
    /// As many texts as there are columns, each.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// An empty table.
    pub fn new(header: &[&str]) -> Self {
        Table {
            header: header.iter().map(ToString::to_string).collect(),
            rows: Vec::new(),
        }
    }

    /// Comma-separated values (RFC 4180).
    pub fn csv(&self) -> String {
        let mut text = String::new();
        for row in std::iter::once(&self.header).chain(&self.rows) {
            let cells: Vec<String> = row
                .iter()
                .map(|cell| {
                    if cell.contains([',', '"', '\n']) {
                        format!("\"{}\"", cell.replace('"', "\"\""))
                    } else {
                        cell.clone()
                    }
                })
                .collect();
            let _ = writeln!(text, "{}", cells.join(","));
        }
        text
    }

    /// A table of Markdown.
    pub fn markdown(&self) -> String {
        let mut text = format!("| {} |\n", self.header.join(" | "));
        let _ = writeln!(text, "|{}", "---|".repeat(self.header.len()));
        for row in &self.rows {
            let cells: Vec<_> = row.iter().map(|cell| cell.replace('|', "\\|")).collect();
            let _ = writeln!(text, "| {} |", cells.join(" | "));
        }
        text
    }
}

/// One or more figures of the paper, or an experiment beyond it.
#[derive(Clone, Debug)]
pub struct Section {
    /// As it is called on the page.
    pub title: String,
    /// What the paper says.
    pub paper: String,
    /// What the numbers say of it, in a sentence or two.
    pub finding: String,
    /// Pictures, tables, details: Markdown.
    pub body: String,
}

/// Three significant digits, plain.
pub fn number(value: f64) -> String {
    if !value.is_finite() {
        return "-".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    let digits = (2 - libm::log10(value.abs()).floor() as i32).clamp(0, 8);
    let text = format!("{value:.*}", digits as usize);
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Full digits, for files that other programs read.
pub fn full(value: f64) -> String {
    if value.is_finite() {
        format!("{value}")
    } else {
        String::new()
    }
}

/// A slope, or a dash.
pub fn slope(value: Option<f64>) -> String {
    value.map_or("-".into(), |v| format!("{v:.2}"))
}

/// A gridstep: 1, 1/2, 1/4.
pub fn gridstep(h: f64) -> String {
    let inverse = 1.0 / h;
    if h < 1.0 && (inverse - inverse.round()).abs() < 1e-9 {
        format!("1/{}", inverse.round())
    } else {
        format!("{h}")
    }
}

/// What a slope says of one expected: in words that are true whatever the numbers.
pub fn compared(found: Option<f64>, expected: f64, paper: &str) -> String {
    // Slopes of five points of this noise are not known better.
    const SAME: f64 = 0.12;
    match found {
        None => "too few gridsteps for a slope".into(),
        Some(b) if b > expected + SAME => {
            format!("slope {b:.2}, steeper than the {paper} of the paper")
        }
        Some(b) if b >= expected - SAME => format!("slope {b:.2}, the {paper} of the paper"),
        Some(b) if b > SAME => format!("slope {b:.2}, less steep than the {paper} of the paper"),
        Some(b) => format!("slope {b:.2}: the error does not fall"),
    }
}

/// The errors of estimators, with slopes, and DGtal's where they are known: a table of both norms.
pub struct ErrorTable<'a> {
    /// Gridsteps, falling.
    pub gridsteps: &'a [f64],
    /// Ours.
    pub curves: &'a [Curve],
    /// DGtal's number for a curve, if there is one.
    pub dgtal: &'a dyn Fn(&str, f64, Norm) -> Option<f64>,
}

impl ErrorTable<'_> {
    fn theirs(&self, name: &str, norm: Norm) -> Points {
        let all = self.gridsteps.iter();
        all.filter_map(|&h| Some((h, (self.dgtal)(name, h, norm)?)))
            .collect()
    }

    /// With numbers for a reader.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&["estimator", "norm", ""]);
        let steps = self.gridsteps.iter();
        table
            .header
            .extend(steps.map(|&h| format!("h = {}", gridstep(h))));
        table
            .header
            .extend(["slope".into(), "slope, last 3".into()]);
        for curve in self.curves {
            for norm in Norm::BOTH {
                let ours = curve.norms(norm);
                let theirs = self.theirs(&curve.name, norm);
                let label = |who: &str| vec![curve.name.clone(), norm.name().into(), who.into()];
                let at = |points: &Points, h: f64| {
                    points.iter().find(|p| p.0 == h).map_or(f64::NAN, |p| p.1)
                };
                let line = |who: &str, points: &Points| {
                    let mut row = label(who);
                    row.extend(self.gridsteps.iter().map(|&h| number(at(points, h))));
                    row.extend([slope(exponent(points)), slope(last_three(points))]);
                    row
                };
                table.rows.push(line("curvox", &ours));
                if theirs.is_empty() {
                    continue;
                }
                table.rows.push(line("DGtal", &theirs));
                let mut row = label("ratio");
                row.extend(self.gridsteps.iter().map(|&h| {
                    let ratio = at(&ours, h) / at(&theirs, h);
                    if ratio.is_finite() {
                        format!("{ratio:.2}")
                    } else {
                        "-".into()
                    }
                }));
                row.extend([String::new(), String::new()]);
                table.rows.push(row);
            }
        }
        table
    }

    /// With all digits, a line for each number.
    pub fn csv(&self) -> String {
        let mut table = Table::new(&["estimator", "gridstep", "norm", "curvox", "dgtal"]);
        for curve in self.curves {
            for norm in Norm::BOTH {
                for (h, error) in curve.norms(norm) {
                    let theirs = (self.dgtal)(&curve.name, h, norm);
                    table.rows.push(vec![
                        curve.name.clone(),
                        full(h),
                        norm.name().into(),
                        full(error),
                        theirs.map_or(String::new(), full),
                    ]);
                }
            }
        }
        table.csv()
    }
}

/// Writes a file of the page.
///
/// # Errors
/// If it cannot be written.
pub fn write(folder: &Path, name: &str, contents: impl AsRef<[u8]>) -> Result<()> {
    let path = folder.join(name);
    fs::write(&path, contents).with_context(|| path.display().to_string())
}

/// The page as Markdown.
pub fn markdown(introduction: &str, sections: &[Section]) -> String {
    let mut text =
        String::from("# The experiments of *Corrected curvature measures*, run with curvox\n\n");
    text.push_str(introduction);
    text.push_str("\n## In short\n\n");
    let mut short = Table::new(&["", "what curvox finds"]);
    for section in sections {
        let row = vec![
            format!("[{}](#{})", section.title, anchor(&section.title)),
            section.finding.clone(),
        ];
        short.rows.push(row);
    }
    text.push_str(&short.markdown());
    for section in sections {
        let _ = write!(text, "\n## {}\n\n", section.title);
        if !section.paper.is_empty() {
            let _ = write!(text, "**The paper:** {}\n\n", section.paper);
        }
        let _ = write!(text, "**curvox:** {}\n\n{}", section.finding, section.body);
    }
    text
}

/// The name that a heading has in links, as GitHub makes it.
fn anchor(heading: &str) -> String {
    heading
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        for (value, text) in [
            (0.030_83, "0.0308"),
            (1234.6, "1235"),
            (2.5, "2.5"),
            (0.0, "0"),
            (0.000_012_3, "0.0000123"),
            (f64::NAN, "-"),
        ] {
            assert_eq!(number(value), text);
        }
        assert_eq!(gridstep(0.125), "1/8");
        assert_eq!(gridstep(1.0), "1");
    }

    #[test]
    fn words_follow_from_the_slope() {
        assert!(compared(Some(0.71), 2.0 / 3.0, "2/3").contains("0.71, the 2/3"));
        assert!(compared(Some(0.9), 2.0 / 3.0, "2/3").contains("steeper"));
        assert!(compared(Some(0.3), 2.0 / 3.0, "2/3").contains("less steep"));
        assert!(compared(Some(-0.3), 2.0 / 3.0, "2/3").contains("does not fall"));
    }

    #[test]
    fn tables_escape_what_their_formats_need() {
        let mut table = Table::new(&["a", "b"]);
        table.rows.push(vec!["x, y".into(), "|k|".into()]);
        assert_eq!(table.csv(), "a,b\n\"x, y\",|k|\n");
        assert!(table.markdown().contains("| x, y | \\|k\\| |"));
    }

    #[test]
    fn anchors_are_those_of_github() {
        assert_eq!(anchor("Figure 8: H, by normals"), "figure-8-h-by-normals");
    }
}
