//! What a run tells at its end: warnings, and the summary for people and for machines.

use std::fmt::Write;

use serde_json::{Value, json};

use crate::curvature::Method;
use crate::lattice::Lattice;
use crate::measure::field::Field;
use crate::measure::fixed;
use crate::normal::Estimator;
use crate::pipeline::Outcome;
use crate::sink::{ExactTotals, FlagCount, RadiusSummary, RunFacts, Summary, SummarySink};

use super::job::Job;
use super::method::in_words;
use super::output::Target;
use super::scale;
use super::sizes;

/// A share of rows flagged `radius_too_large` above which the user is told: curvature at a few
/// sharp corners is normal, at every tenth surfel the ball is too large for the shape.
const LARGE_RADIUS_SHARE: f64 = 0.1;

/// A radius below this many voxels sees too few cells for a curvature.
const SMALLEST_RADIUS: f64 = 2.0;

/// What is known before the run.
pub(crate) struct Facts {
    pub(crate) otsu: Option<f64>,
    radius_choice: Option<Value>,
    input: Value,
    warnings: Vec<String>,
    estimator: Estimator,
    closed: bool,
    /// Whether Gauss-Bonnet is a theorem for the field of the run.
    gauss_bonnet: bool,
    /// The name in front of the format's warnings, which the summary must not depend on.
    name: String,
}

impl Facts {
    pub(crate) fn of(job: &Job) -> Self {
        let header = &job.volume.header;
        let name = job.volume.source.name.clone();
        let mut warnings: Vec<String> = header
            .warnings
            .iter()
            .map(|w| without_name(w, &name))
            .collect();
        let edges = job.settings.lattice.edges();
        let shortest = |radius: f64| {
            let axis = (0..3)
                .min_by(|&a, &b| (radius / edges[a]).total_cmp(&(radius / edges[b])))
                .unwrap_or(0);
            (radius / edges[axis], ["x", "y", "z"][axis])
        };
        let radii = job
            .method
            .radii
            .iter()
            .map(|r| (r.label.as_str(), r.voxels));
        let all = radii
            .map(|(label, voxels)| (format!("radius {label}"), voxels))
            .chain(
                job.method
                    .normal_radius
                    .map(|v| ("normal radius".into(), v)),
            );
        for (what, voxels) in all {
            let (least, axis) = shortest(voxels);
            if least < SMALLEST_RADIUS {
                warnings.push(format!(
                    "{what} is {least:.3} voxels along {axis}: below {SMALLEST_RADIUS} voxels the \
                     steps of the grid show; take a larger radius"
                ));
            }
        }
        if job.settings.curvature == Method::Invariants {
            warnings.push(
                "curvature is by plain integral invariants (--curvature ii), given to compare with: it \
                 does not converge for radii that shrink like the square root of the gridstep, and other \
                 sheets in the ball disturb it"
                    .into(),
            );
        }
        Self {
            otsu: job.otsu,
            radius_choice: job.radius_choice.as_ref().map(|choice| json!(choice)),
            input: json!({
                "format": header.format.name(),
                "dtype": header.dtype().to_string(),
                "scaling": header.scaling.map(|s| json!({"slope": s.slope, "intercept": s.intercept})),
                "inside": job.criterion.to_string(),
                "threshold_by_otsu": job.otsu.is_some(),
            }),
            warnings,
            estimator: job.settings.estimator,
            closed: job.settings.lattice.closed,
            gauss_bonnet: job.settings.field != Field::Linear,
            name,
        }
    }

    /// Adds what the run found.
    pub(crate) fn run_facts(
        &self,
        lattice: &Lattice,
        outcome: &Outcome,
        rows: &SummarySink,
    ) -> RunFacts {
        let mut warnings = self.warnings.clone();
        warnings.extend(
            outcome
                .read
                .warnings
                .iter()
                .map(|w| without_name(w, &self.name)),
        );
        if outcome.unmatched_normals > 0 {
            warnings.push(format!(
                "{} rows of the given normals belong to no surfel of this image and were not used: \
                 the table may be of another threshold",
                outcome.unmatched_normals
            ));
        }
        let mut exact = exact_totals(lattice, outcome);
        if !self.gauss_bonnet {
            exact.euler_gauss_bonnet = None;
        }
        let summary = rows.summary(RunFacts::default());
        warnings.extend(self.advice(&exact, &summary.radii));
        if let Some([inner, outer]) = outcome.sides.of_mask() {
            warnings.push(format!(
                "the value is {inner} inside every surfel and {outer} outside: the image looks like a \
                 mask, and its gradient has the steps of its voxels; take --normals ii or average, \
                 or the grey image it was made from"
            ));
        }
        RunFacts {
            exact: Some(exact),
            warnings,
            input: self.input.clone(),
            radius_choice: self.radius_choice.clone(),
        }
    }

    /// What the user should know about this surface.
    fn advice(&self, exact: &ExactTotals, radii: &[RadiusSummary]) -> Vec<String> {
        let mut advice = Vec::new();
        if exact.nan_voxels > 0 {
            advice.push(format!(
                "{} voxels are not a number (NaN) and count as outside",
                exact.nan_voxels
            ));
        }
        if exact.surfels == 0 {
            advice.push(if exact.inside_voxels == 0 {
                "the surface is empty: no voxel is inside; check the threshold, range or label"
                    .into()
            } else {
                "the surface is empty: every voxel is inside; check the threshold".into()
            });
            return advice;
        }
        let share = |n: u64| n as f64 / exact.surfels as f64;
        if !exact.closed {
            let border = radii.first().map_or(0, |r| flagged(r, "border"));
            advice.push(format!(
            "the surface is open at the border of the image: {border} surfels ({:.1} %) are flagged \
             `border`, and their curvatures are cut short; --closed closes it there",
            100.0 * share(border)
        ));
        }
        for radius in radii {
            let rows = flagged(radius, "radius_too_large");
            if share(rows) > LARGE_RADIUS_SHARE {
                advice.push(format!(
                "{:.1} % of the surfels are flagged `radius_too_large` at radius {}: features are \
                 smaller than the ball; take a smaller radius or a finer image",
                100.0 * share(rows),
                radius.label
            ));
            }
        }
        let opposed = radii.first().map_or(0, |r| flagged(r, "normal_opposed"));
        // A few surfels at a corner are no reason to doubt a run.
        if share(opposed) > 1e-3 {
            advice.push(format!(
            "{opposed} surfels ({:.2} %) have a normal that does not point out of the solid (flag \
             `normal_opposed`){}",
            100.0 * share(opposed),
            why_opposed(self.estimator, share(opposed))
        ));
        }
        let degenerate = radii.first().map_or(0, |r| flagged(r, "degenerate_normal"));
        if share(degenerate) > 1e-3 {
            advice.push(format!(
            "{degenerate} surfels ({:.2} %) have the direction of their face for a normal (flag \
             `degenerate_normal`): {}",
            100.0 * share(degenerate),
            why_degenerate(self.estimator, self.closed)
        ));
        }
        if exact.sum_abs_k > 0 {
            advice.push(format!(
                "the normals wind more than a hemisphere, sum |k| = {} ({:.3} % of \
             {} pointels): G is not reliable at the rows flagged `lifted`",
                exact.sum_abs_k,
                100.0 * exact.sum_abs_k as f64 / exact.pointels as f64,
                exact.pointels
            ));
        }
        advice
    }
}

/// A warning without the path in front.
fn without_name(warning: &str, name: &str) -> String {
    warning
        .strip_prefix(name)
        .and_then(|rest| rest.strip_prefix(": "))
        .unwrap_or(warning)
        .to_owned()
}

/// Totals of the cells, in world units.
fn exact_totals(lattice: &Lattice, outcome: &Outcome) -> ExactTotals {
    let (cells, solid) = (&outcome.cells, &outcome.solid);
    let unit = lattice.voxel_unit_world();
    // Counts of cells are far below 2^63.
    let whole = |n: i128| i64::try_from(n).unwrap_or(i64::MAX);
    ExactTotals {
        surfels: cells.surfel_count(),
        surfels_xyz: cells.surfels,
        linels: cells.linels,
        pointels: cells.pointels,
        euler_counted: whole(cells.euler_counted()),
        euler_gauss_bonnet: cells.euler_gauss_bonnet().map(whole),
        sum_k: cells.lifts,
        sum_abs_k: cells.absolute_lifts,
        mu0: fixed::to_measure(cells.mu0) * unit * unit,
        mu1: fixed::to_measure(cells.mu1) * unit,
        mu2: fixed::to_solid_angle(cells.mu2),
        chi6: solid.chi6,
        chi26: solid.chi26,
        antipodal_outside: solid.antipodal_outside,
        antipodal_inside: solid.antipodal_inside,
        closed: cells.border_linels == 0,
        inside_voxels: solid.voxels,
        nan_voxels: outcome.read.nan,
    }
}

fn flagged(radius: &RadiusSummary, name: &str) -> u64 {
    radius
        .flags
        .iter()
        .find(|f| f.name == name)
        .map_or(0, |f| f.rows)
}

/// Where normals point inward, and what helps: what is said after that they do.
fn why_opposed(estimator: Estimator, share: f64) -> &'static str {
    match estimator {
        Estimator::IntegralInvariant { .. } | Estimator::VoronoiCovariance { .. } => {
            ", mostly on parts thinner than the normal radius; of the normals, `average` suits thin \
             parts better"
        }
        Estimator::SurfaceAverage { .. } => {
            ", mostly on parts thinner than the normal radius; a smaller one has fewer"
        }
        Estimator::Gradient { .. } => {
            ", where noise makes steps that the grey values around do not follow; a larger --sigma \
             or a smoother image has fewer"
        }
        Estimator::Given if share > 0.5 => ": those of the table point inward; reverse them",
        Estimator::Given => ", as the table has them",
        Estimator::Trivial => "",
    }
}

/// Why surfels have no normal of their own.
fn why_degenerate(estimator: Estimator, closed: bool) -> &'static str {
    match estimator {
        Estimator::IntegralInvariant { .. } => {
            "the solid in their ball has no direction, as that of a speck"
        }
        Estimator::VoronoiCovariance { .. } => {
            "the surface around them has no outer side, as that of a sheet or a speck"
        }
        Estimator::SurfaceAverage { .. } => {
            "their part of the surface is an island smaller than the ball of the normals, or its \
             normals cancel out; a smaller --normal-radius has fewer"
        }
        Estimator::Gradient { .. } if closed => {
            "values have no slope where --closed closes the surface on the border, as beyond it they \
             are repeated, or are not finite (NaN)"
        }
        Estimator::Gradient { .. } => "values around have no slope or are not finite (NaN)",
        Estimator::Given | Estimator::Trivial => "none could be found",
    }
}

/// The end of a run.
pub(crate) struct Report {
    pub(crate) summary: Summary,
    pub(crate) otsu: Option<f64>,
    pub(crate) target: Target,
    pub(crate) seconds: f64,
}

pub(super) fn place(target: &Target) -> String {
    match target {
        Target::Directory(path)
        | Target::Parquet(path)
        | Target::Csv(path)
        | Target::Device(path) => path.display().to_string(),
        Target::Stdout => "standard output".into(),
    }
}

impl Report {
    /// One JSON object, without histograms.
    pub(crate) fn json(&self) -> Value {
        let mut summary = serde_json::to_value(&self.summary).unwrap_or_default();
        if let Some(radii) = summary["radii"].as_array_mut() {
            for radius in radii {
                for value in ["mean_curvature", "gaussian_curvature", "k1", "k2"] {
                    if let Some(value) = radius[value].as_object_mut() {
                        value.remove("histogram");
                    }
                }
            }
        }
        json!({
            "event": "done",
            "output": place(&self.target),
            "seconds": self.seconds,
            "otsu_threshold": self.otsu,
            "summary": summary,
        })
    }

    /// A few lines.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_text(&mut text);
        text
    }

    fn write_text(&self, out: &mut String) -> std::fmt::Result {
        let summary = &self.summary;
        let unit = &summary.unit;
        if let Some(otsu) = self.otsu {
            writeln!(out, "threshold  {otsu} (Otsu)")?;
        }
        writeln!(out, "normals    {}", in_words(&summary.parameters))?;
        if let Some(choice) = &summary.radius_choice {
            let [chosen, medians] = scale::in_words(choice, unit);
            writeln!(out, "radius     {chosen}\n           {medians}")?;
        }
        writeln!(out, "surfels    {}", sizes::count(summary.rows))?;
        if let Some(exact) = &summary.exact {
            writeln!(out, "area       {} {unit}^2", number(exact.mu0))?;
            let open = if exact.closed {
                "closed"
            } else {
                "open at the border of the image"
            };
            writeln!(
                out,
                "Euler      V - E + F = {}, {open}",
                exact.euler_counted
            )?;
            match exact.euler_gauss_bonnet {
                Some(chi) => writeln!(
                    out,
                    "lifts      sum|k| = {}, Gauss-Bonnet gives {chi}",
                    exact.sum_abs_k
                )?,
                None if self.summary.parameters["field"] == "linear" => writeln!(
                    out,
                    "integral G {} (a linear field has no Gauss-Bonnet theorem)",
                    number(exact.mu2)
                )?,
                None => writeln!(out, "lifts      sum|k| = {}", exact.sum_abs_k)?,
            }
        }
        let mean = |value: Option<f64>| value.map_or("none".into(), number);
        for radius in &summary.radii {
            writeln!(
                out,
                "at {:<7} mean H {} 1/{unit}, mean G {} 1/{unit}^2",
                radius.label,
                mean(radius.mean_curvature.mean),
                mean(radius.gaussian_curvature.mean),
            )?;
            if let Some(error) = radius.mean_curvature_error_median {
                writeln!(
                    out,
                    "  error    bars of H: median {} 1/{unit} (68 in 100 are within theirs)",
                    number(error.into())
                )?;
            }
            if let Some(quality) = radius.quality_rms {
                writeln!(
                    out,
                    "  quality  {} 1/{unit} (root mean square; 0 for the normals of a surface)",
                    number(quality)
                )?;
            }
            flag_counts(out, &radius.flags)?;
        }
        for warning in &summary.warnings {
            writeln!(out, "warning    {warning}")?;
        }
        writeln!(out, "results    {}", place(&self.target))?;
        writeln!(out, "time       {:.2} s", self.seconds)
    }
}

/// Five digits, in powers of ten where that is shorter.
pub(super) fn number(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value.abs()) {
        let digits = if value == 0.0 {
            1
        } else {
            // Between -3 and 6 by the test above.
            (4 - value.abs().log10().floor() as i32).clamp(0, 8)
        };
        format!("{value:.*}", digits.unsigned_abs() as usize)
    } else {
        format!("{value:.4e}")
    }
}

/// The line of the flags that some rows carry.
pub(super) fn flag_counts(out: &mut impl Write, flags: &[FlagCount]) -> std::fmt::Result {
    let flags: Vec<String> = flags
        .iter()
        .filter(|flag| flag.rows > 0)
        .map(|flag| format!("{} {}", flag.name, sizes::count(flag.rows)))
        .collect();
    if !flags.is_empty() {
        writeln!(out, "  flags    {}", flags.join(", "))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_five_digits() {
        assert_eq!(number(0.0), "0.0");
        assert_eq!(number(1234.5678), "1234.6");
        assert_eq!(number(-0.012345678), "-0.012346");
        assert_eq!(number(1.5e9), "1.5000e9");
    }

    #[test]
    fn warnings_lose_the_path_in_front() {
        assert_eq!(
            without_name("a/b.nii: trailing bytes", "a/b.nii"),
            "trailing bytes"
        );
        assert_eq!(without_name("trailing bytes", "a/b.nii"), "trailing bytes");
    }

    #[test]
    fn an_empty_surface_says_which_kind() {
        let empty = ExactTotals::default();
        let facts = Facts {
            radius_choice: None,
            otsu: None,
            input: Value::Null,
            warnings: Vec::new(),
            estimator: Estimator::Trivial,
            closed: false,
            gauss_bonnet: true,
            name: String::new(),
        };
        assert!(facts.advice(&empty, &[])[0].contains("no voxel is inside"));
        let full = ExactTotals {
            inside_voxels: 8,
            ..ExactTotals::default()
        };
        assert!(facts.advice(&full, &[])[0].contains("every voxel is inside"));
    }
}
