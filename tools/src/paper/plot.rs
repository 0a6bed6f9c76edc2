//! Plots as SVG.
//!
//! Panels side by side, with one legend to their right. Lines that stand for the largest error are
//! thick and those for its root mean square thin, as in the paper; what is set beside (DGtal, powers)
//! is dashed. Colours are those of Okabe and Ito, told apart with any colour vision. Text is left to the
//! viewer's sans-serif, so no font is needed to draw.

use std::ops::Range;

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, ValueFormatter};
use plotters::prelude::*;

use super::page;

/// After Okabe and Ito: blue, vermilion, green, purple, orange, sky, then black for references.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(60, 60, 60),
];

/// The colour of lines to compare slopes with, whose names are written at their first points.
pub const REFERENCE: usize = 6;

const PANEL: [u32; 2] = [620, 560];
const LEGEND: u32 = 320;
/// Pixels from the beginning of a name of a reference to its first point, and the share of the axis
/// that has room for it.
const NAME_WIDTH: i32 = 64;
const NAME_ROOM: f64 = 0.13;

const FONT: &str = "sans-serif";

/// A line of a plot.
#[derive(Clone, Debug)]
pub struct Line {
    /// In the legend; lines of the same name, colour and stroke are there once.
    pub name: String,
    /// Which of the colours.
    pub colour: usize,
    /// Thick lines are for largest errors.
    pub thick: bool,
    /// Dashed lines are for what ours is compared with.
    pub dashed: bool,
    /// Points, in any order the line goes; what is not positive is left out.
    pub points: Vec<(f64, f64)>,
}

/// How x is marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// In logarithms, with a mark at 1, 2, 5 of each decade.
    Logarithmic,
    /// In logarithms, with a mark at each half of the last: 1, 0.5, 0.25. Fine gridsteps are to the
    /// left, as in the paper.
    Gridstep,
    /// As it is.
    Linear,
}

/// Coordinates with axes.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Above the panel.
    pub title: String,
    /// Below the panel.
    pub x: String,
    /// Beside the panel.
    pub y: String,
    /// The axis of x; that of y is logarithmic.
    pub x_axis: Axis,
    /// The lines.
    pub lines: Vec<Line>,
}

/// An axis from `low` to `high`, with its marks.
struct Scale {
    low: f64,
    high: f64,
    logarithmic: bool,
    marks: Vec<f64>,
}

impl Scale {
    fn of(values: impl Iterator<Item = f64>, axis: Axis, few: i32) -> Self {
        let logarithmic = axis != Axis::Linear;
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in values.filter(|v| v.is_finite()) {
            low = low.min(value);
            high = high.max(value);
        }
        if low > high {
            (low, high) = (0.1, 1.0);
        }
        if logarithmic {
            // A little room, so that no marker is cut.
            (low, high) = (low / 1.15, high * 1.15);
        } else {
            let room = (0.04 * (high - low)).max(1e-9);
            (low, high) = (low - room, high + room);
        }
        // Numbers below an axis take more room than beside it.
        let marks = match axis {
            Axis::Logarithmic => logarithmic_marks(low, high, few),
            Axis::Gridstep => (-30..=30)
                .map(|i| 2_f64.powi(i))
                .filter(|mark| (low..=high).contains(mark))
                .collect(),
            Axis::Linear => linear_marks(low, high),
        };
        Scale {
            low,
            high,
            logarithmic,
            marks,
        }
    }

    /// Room for names before the first points.
    fn make_room(&mut self) {
        if self.logarithmic {
            self.low /= libm::pow(self.high / self.low, NAME_ROOM);
        }
    }

    fn share(&self, value: f64) -> f64 {
        if self.logarithmic {
            libm::log(value / self.low) / libm::log(self.high / self.low)
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }
}

/// 1, 2, 5 in each decade, or 1 alone where there are more decades than `few`.
fn logarithmic_marks(low: f64, high: f64, few: i32) -> Vec<f64> {
    let [first, last] = [low, high].map(libm::log10);
    let steps: &[f64] = if last - first > f64::from(few) {
        &[1.0]
    } else {
        &[1.0, 2.0, 5.0]
    };
    let decades = first.floor() as i32..=last.ceil() as i32;
    decades
        .flat_map(|decade| steps.iter().map(move |step| step * 10_f64.powi(decade)))
        .filter(|mark| (low..=high).contains(mark))
        .collect()
}

fn linear_marks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 8.0;
    let decade = 10_f64.powf(libm::log10(rough).floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|s| s * decade)
        .into_iter()
        .find(|&step| step >= rough)
        .unwrap_or(rough);
    let first = (low / step).ceil() as i64;
    (0..20)
        .map(|i| (first + i) as f64 * step)
        .filter(|&mark| mark <= high)
        .collect()
}

/// A number for a mark: without needless digits.
fn mark_text(value: f64) -> String {
    let rounded: f64 = format!("{value:.3e}").parse().unwrap_or(value);
    if rounded != 0.0 && !(1e-4..1e6).contains(&rounded.abs()) {
        format!("{rounded:e}")
    } else {
        format!("{rounded}")
    }
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let length = f64::from(limit.1 - limit.0);
        limit.0 + (length * self.share(*value)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        // Without the lighter lines between the marks.
        if hint.weight().allow_light_points() {
            Vec::new()
        } else {
            self.marks.clone()
        }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Scale {
    fn format(value: &f64) -> String {
        mark_text(*value)
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// The panels side by side, as an SVG file.
///
/// # Errors
/// If drawing fails.
pub fn svg(panels: &[Panel]) -> Result<String> {
    let mut text = String::new();
    {
        let width = PANEL[0] * panels.len() as u32 + LEGEND;
        let root = SVGBackend::with_string(&mut text, (width, PANEL[1])).into_drawing_area();
        root.fill(&WHITE).map_err(drawing)?;
        let (rest, legend) = root.split_horizontally(PANEL[0] * panels.len() as u32);
        let areas = rest.split_evenly((1, panels.len()));
        for (area, panel) in areas.iter().zip(panels) {
            draw_panel(area, panel)?;
        }
        draw_legend(&legend, panels)?;
        root.present().map_err(drawing)?;
    }
    Ok(text)
}

fn drawing(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow!("drawing: {error}")
}

fn style(line: &Line) -> ShapeStyle {
    let width = if line.thick { 4 } else { 2 };
    COLOURS[line.colour % COLOURS.len()].stroke_width(width)
}

fn draw_panel(area: &Area, panel: &Panel) -> Result<()> {
    let is_shown = |&(x, y): &(f64, f64)| {
        y > 0.0 && y.is_finite() && x.is_finite() && (x > 0.0 || panel.x_axis == Axis::Linear)
    };
    let shown: Vec<(&Line, Vec<(f64, f64)>)> = panel
        .lines
        .iter()
        .map(|line| (line, line.points.iter().copied().filter(is_shown).collect()))
        .collect();
    let all = || shown.iter().flat_map(|(_, points)| points.iter().copied());
    let mut x = Scale::of(all().map(|p| p.0), panel.x_axis, 2);
    if shown
        .iter()
        .any(|(line, points)| line.colour == REFERENCE && !points.is_empty())
    {
        x.make_room();
    }
    let y = Scale::of(all().map(|p| p.1), Axis::Logarithmic, 3);
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, (FONT, 24))
        .margin(12)
        .x_label_area_size(52)
        .y_label_area_size(84)
        .build_cartesian_2d(x, y)
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .x_desc(&panel.x)
        .y_desc(&panel.y)
        .axis_desc_style((FONT, 22))
        .label_style((FONT, 19))
        .bold_line_style(RGBColor(224, 224, 224))
        .axis_style(RGBColor(60, 60, 60))
        .draw()
        .map_err(drawing)?;
    // References below what they are there for.
    let (below, above): (Vec<_>, Vec<_>) = shown
        .into_iter()
        .partition(|(line, _)| line.colour == REFERENCE);
    let mut names = Vec::new();
    for (line, points) in below.into_iter().chain(above) {
        if let (REFERENCE, Some(&end)) = (line.colour, points.first()) {
            names.push((line.name.clone(), end));
        }
        if line.dashed {
            let dashes = DashedLineSeries::new(points, 9, 7, style(line));
            chart.draw_series(dashes).map_err(drawing)?;
        } else {
            let whole = LineSeries::new(points.iter().copied(), style(line));
            chart.draw_series(whole).map_err(drawing)?;
            let size = if line.thick { 6 } else { 4 };
            let filled = COLOURS[line.colour % COLOURS.len()].filled();
            let markers = points.into_iter().map(|p| Circle::new(p, size, filled));
            chart.draw_series(markers).map_err(drawing)?;
        }
    }
    for (name, end) in names {
        let label = EmptyElement::at(end) + Text::new(name, (-NAME_WIDTH, -9), (FONT, 17));
        chart.draw_series([label]).map_err(drawing)?;
    }
    Ok(())
}

fn draw_legend(area: &Area, panels: &[Panel]) -> Result<()> {
    let mut seen: Vec<&Line> = Vec::new();
    for line in panels.iter().flat_map(|panel| &panel.lines) {
        let is_same = |other: &&Line| {
            other.name == line.name
                && other.colour == line.colour
                && other.thick == line.thick
                && other.dashed == line.dashed
        };
        // Powers have their names beside them.
        let is_told = line.colour == REFERENCE || line.points.is_empty();
        if !is_told && !seen.iter().any(is_same) {
            seen.push(line);
        }
    }
    for (i, line) in seen.into_iter().enumerate() {
        let y = 60 + 27 * i as i32;
        let ends = [(6, y), (52, y)];
        if line.dashed {
            for x in (6..52).step_by(16) {
                let dash = PathElement::new([(x, y), ((x + 9).min(52), y)], style(line));
                area.draw(&dash).map_err(drawing)?;
            }
        } else {
            area.draw(&PathElement::new(ends, style(line)))
                .map_err(drawing)?;
        }
        let label = Text::new(line.name.clone(), (62, y - 9), (FONT, 19));
        area.draw(&label).map_err(drawing)?;
    }
    Ok(())
}

/// A number for each pair of parameters, as a table of colours.
#[derive(Clone, Debug)]
pub struct HeatMap {
    /// Above it.
    pub title: String,
    /// Below it, and its columns.
    pub x: (String, Vec<String>),
    /// Beside it, and its rows from the bottom.
    pub y: (String, Vec<String>),
    /// Rows of positive numbers; none where there is none.
    pub values: Vec<Vec<Option<f64>>>,
}

const CELL: [i32; 2] = [78, 44];

/// The maps in rows of `columns`, in one scale of colours for each column of maps: white is the
/// least, blue the most, in logarithms.
///
/// # Errors
/// If drawing fails.
pub fn heat_maps(maps: &[HeatMap], columns: usize) -> Result<String> {
    let most = |of: fn(&HeatMap) -> usize| maps.iter().map(of).max().unwrap_or(1) as i32;
    let size = [
        100 + CELL[0] * most(|map| map.x.1.len()),
        110 + CELL[1] * most(|map| map.y.1.len()),
    ];
    let rows = maps.len().div_ceil(columns);
    let mut text = String::new();
    {
        let whole = (
            size[0] as u32 * columns as u32,
            size[1] as u32 * rows as u32,
        );
        let root = SVGBackend::with_string(&mut text, whole).into_drawing_area();
        root.fill(&WHITE).map_err(drawing)?;
        for (i, (area, map)) in root
            .split_evenly((rows, columns))
            .iter()
            .zip(maps)
            .enumerate()
        {
            let column = maps.iter().skip(i % columns).step_by(columns);
            let values = || {
                column
                    .clone()
                    .flat_map(|m| m.values.iter().flatten().flatten())
            };
            let low = values().copied().fold(f64::INFINITY, f64::min);
            let high = values().copied().fold(0.0, f64::max);
            draw_map(area, map, low, high)?;
        }
        root.present().map_err(drawing)?;
    }
    Ok(text)
}

fn draw_map(area: &Area, map: &HeatMap, low: f64, high: f64) -> Result<()> {
    let write = |text: &str, at: (i32, i32), size: i32, colour: &RGBColor| {
        area.draw(&Text::new(
            text.to_owned(),
            at,
            (FONT, size).into_font().color(colour),
        ))
        .map_err(drawing)
    };
    write(&map.title, (80, 8), 20, &BLACK)?;
    let bottom = 40 + CELL[1] * map.y.1.len() as i32;
    for (row, values) in map.values.iter().enumerate() {
        let y = bottom - CELL[1] * (row as i32 + 1);
        write(&map.y.1[row], (44, y + 14), 17, &BLACK)?;
        for (column, value) in values.iter().enumerate() {
            let x = 80 + CELL[0] * column as i32;
            let Some(value) = value else {
                write("-", (x + 34, y + 14), 15, &BLACK)?;
                continue;
            };
            let share = libm::log(value / low) / libm::log(high / low).max(1e-9);
            let share = share.clamp(0.0, 1.0);
            let mix = |end: u8| (255.0 + (f64::from(end) - 255.0) * share).round() as u8;
            let colour = RGBColor(mix(0), mix(90), mix(170));
            let cell = [(x, y), (x + CELL[0] - 2, y + CELL[1] - 2)];
            area.draw(&Rectangle::new(cell, colour.filled()))
                .map_err(drawing)?;
            let ink = if share > 0.55 { WHITE } else { BLACK };
            write(&page::number(*value), (x + 8, y + 13), 15, &ink)?;
        }
    }
    for (column, name) in map.x.1.iter().enumerate() {
        let x = 80 + CELL[0] * column as i32;
        write(name, (x + 22, bottom + 6), 17, &BLACK)?;
    }
    write(&map.x.0, (80, bottom + 30), 17, &BLACK)?;
    write(&map.y.0, (4, 22), 17, &BLACK)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel() -> Panel {
        Panel {
            title: "errors & <slopes>".into(),
            x: "h".into(),
            y: "error of H".into(),
            x_axis: Axis::Gridstep,
            lines: [(true, false), (false, true)]
                .map(|(thick, dashed)| Line {
                    name: format!("thick {thick}"),
                    colour: 1,
                    thick,
                    dashed,
                    points: vec![(1.0, 0.1), (0.5, 0.05), (0.25, f64::NAN), (0.125, 0.0)],
                })
                .into(),
        }
    }

    /// Every element that is opened is closed, and texts are escaped.
    fn is_well_formed(svg: &str) -> bool {
        let mut open = Vec::new();
        for piece in svg.split('<').skip(1) {
            let Some((tag, text)) = piece.split_once('>') else {
                return false;
            };
            if text.contains('&') && !(text.contains("&amp;") || text.contains("&lt;")) {
                return false;
            }
            let name = tag.split_whitespace().next().unwrap_or_default();
            if let Some(name) = name.strip_prefix('/') {
                if open.pop() != Some(name) {
                    return false;
                }
            } else if !tag.ends_with('/') {
                open.push(name);
            }
        }
        open.is_empty() && svg.starts_with("<svg")
    }

    #[test]
    fn plots_are_well_formed() {
        let drawn = svg(&[panel(), panel()]).unwrap();
        assert!(is_well_formed(&drawn), "{drawn}");
        assert!(drawn.contains("errors &amp; &lt;slopes&gt;"));
        assert!(!is_well_formed("<svg><text></svg>"));
        let map = HeatMap {
            title: "H".into(),
            x: ("k".into(), vec!["1".into(), "2".into()]),
            y: ("m".into(), vec!["1".into()]),
            values: vec![vec![Some(0.1), None]],
        };
        assert!(is_well_formed(&heat_maps(&[map], 1).unwrap()));
    }

    #[test]
    fn a_panel_without_points_is_drawn() {
        let mut empty = panel();
        empty.lines.clear();
        assert!(is_well_formed(&svg(&[empty]).unwrap()));
    }

    #[test]
    fn marks_are_round_numbers_within_the_axis() {
        assert_eq!(logarithmic_marks(0.04, 1.1, 2), [0.05, 0.1, 0.2, 0.5, 1.0]);
        assert_eq!(linear_marks(0.9, 4.1), [1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]);
        assert_eq!(mark_text(0.1 + 0.2), "0.3");
        assert_eq!(mark_text(2e-5), "2e-5");
    }

    #[test]
    fn gridsteps_are_marked_by_halves_fine_ones_to_the_left() {
        let scale = Scale::of([0.125, 1.0].into_iter(), Axis::Gridstep, 2);
        assert_eq!(scale.marks, [0.125, 0.25, 0.5, 1.0]);
        assert!(scale.share(0.125) < scale.share(1.0));
    }
}
