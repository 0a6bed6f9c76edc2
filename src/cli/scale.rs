//! `--radius auto`: the radius at which two estimates agree best.
//!
//! Comes in: an input that can be read again, and all that a run needs but the radius. Goes out: a [`RadiusChoice`].
//!
//! **How.** One pass counts the surfels of cubes of [`CUBE`] voxels. A volume of few surfels is then taken whole; of
//! another [`SAMPLES`] cubes are, at equal steps through its surfels in the order of the cubes. On these the run is made for one
//! radius after the other, from small to large, and the median over their surfels of the difference of H between the two sums that
//! compensated weights make is looked at ([`crate::curvature::uncertainty`]): it falls as long as the staircase of the grid and noise are what
//! limits H, and rises once the ball flattens what it should measure. The first radius after which it rises is taken, or the last one
//! before most surfels are cut by the border or a tenth of them have features smaller than the ball.
//!
//! Guaranteed: the choice depends on the voxels and the method alone, not on memory, threads or time. Not chosen: a radius for each surfel; a run has one
//! scale, so that its values compare.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use curvox_formats::Volume;
use serde::Serialize;
use serde_json::Value;

use crate::curvature::uncertainty::ErrorKind;
use crate::lattice::Lattice;
use crate::measure::ball::Weights;
use crate::normal::Estimator;
use crate::pipeline::{Access, Progress, Settings, Source, run as run_pipeline};
use crate::sink::{Flag, SinkError, SurfelBatch, SurfelSink};
use crate::volume::{Binarizer, Criterion};

use super::exit::usage;
use super::input::{self, InputArgs};
use super::progress::{self, Style};
use super::report::number;

/// Edge of the cubes that are sampled, in voxels.
const CUBE: i32 = 64;

/// Cubes that are sampled.
const SAMPLES: u64 = 8;

/// Surfels up to which a volume is taken whole.
const WHOLE: u64 = 100_000;

/// Radii that are tried, in default radii: with cubic voxels 3, 4, 5, 6, 8, 10 and 12 voxels.
const TRIED: [f64; 7] = [0.5, 2.0 / 3.0, 5.0 / 6.0, 1.0, 4.0 / 3.0, 5.0 / 3.0, 2.0];

/// Share of the surfels of the first radius that must be off the border with another, for it to be compared.
const LEAST_SHARE: f64 = 0.5;

/// Share of rows flagged `radius_too_large` that a radius must not reach, unless smaller radii have as many (as noise has).
/// Of a body that fits in the ball all is summed in either way, and the two agree.
const MOST_TOO_LARGE: f64 = 0.1;

/// Rows that say nothing of the radius.
const LEFT_OUT: u16 =
    Flag::Border.bit() | Flag::Island.bit() | Flag::NoArea.bit() | Flag::DegenerateNormal.bit();

/// The radii that are tried, in voxels.
fn radii(lattice: &Lattice) -> [f64; 7] {
    let default = default_radius(lattice);
    TRIED.map(|factor| (10.0 * factor * default).round() / 10.0)
}

/// The largest radius that is tried, in voxels.
pub(crate) fn largest_radius(lattice: &Lattice) -> f64 {
    radii(lattice)[TRIED.len() - 1]
}

/// The radius when nothing chooses one, in voxels (the longest edge): six mean edges (geometric), and at least three of the
/// longest.
///
/// *Measured* on a sphere of radius 20 voxels, rms error of H: 7.9 % at 3, 1.6 % at 5, 1.0 % at 6.
/// Voxels as long as those of clinical scans would get a ball of centimetres by their longest edge alone.
pub(crate) fn default_radius(lattice: &Lattice) -> f64 {
    let [x, y, z] = lattice.edges();
    let mean = (x * y * z).cbrt();
    // to a tenth, as people write it
    ((60.0 * mean).round() / 10.0).max(3.0)
}

/// A radius that was tried.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Tried {
    /// In voxels.
    pub(crate) voxels: f64,
    /// Median of the difference of H between the two sums, in 1/world-unit.
    pub(crate) median_difference: f64,
    /// Surfels it was taken over.
    pub(crate) surfels: u64,
}

/// Which radius was chosen, and why.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct RadiusChoice {
    /// In voxels.
    pub(crate) voxels: f64,
    /// The radii that were tried.
    pub(crate) tried: Vec<Tried>,
    /// Surfels of the volume.
    pub(crate) surfels: u64,
    /// Cubes of the volume that were looked at; 0 if it was taken whole.
    pub(crate) cubes: usize,
    /// The reason, a sentence.
    pub(crate) reason: String,
}

/// What choosing a radius needs.
pub(crate) struct Search<'a> {
    /// The input.
    pub(crate) input: &'a InputArgs,
    /// It, opened.
    pub(crate) volume: &'a Volume,
    /// Its voxel grid.
    pub(crate) lattice: &'a Lattice,
    /// What is inside.
    pub(crate) criterion: Criterion,
    /// Memory allowed.
    pub(crate) memory_bytes: u64,
    /// Whether progress is shown.
    pub(crate) style: Style,
    /// Set to stop.
    pub(crate) stop: &'a AtomicBool,
}

/// Counts surfels by cube.
#[derive(Default)]
struct Census(BTreeMap<[i32; 3], u64>);

/// Keeps the differences at the surfels in a box.
struct Differences {
    /// The box, in cells of the region that is read.
    core: [Range<i32>; 3],
    found: Found,
}

/// What was found at a radius.
#[derive(Default)]
struct Found {
    differences: Vec<f32>,
    /// Of these, flagged `radius_too_large`.
    too_large: u64,
}

/// Why no larger radius was tried.
#[derive(Clone, Copy, PartialEq)]
enum End {
    /// All were tried.
    Largest,
    /// The difference rose.
    Rose,
    /// The border and islands take too many surfels.
    TooFew,
    /// Features are smaller than the ball.
    TooLarge,
}

/// The cell of a row along an axis.
fn cell(batch: &SurfelBatch, axis: usize, row: usize) -> i32 {
    batch.k[axis][row].div_euclid(2)
}

impl SurfelSink for Census {
    fn write(&mut self, batch: &SurfelBatch) -> Result<(), SinkError> {
        for row in 0..batch.len() {
            // by z, then y, then x, as the rows of a run
            let cube = [2, 1, 0].map(|axis| cell(batch, axis, row).div_euclid(CUBE));
            *self.0.entry(cube).or_default() += 1;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

impl SurfelSink for Differences {
    fn write(&mut self, batch: &SurfelBatch) -> Result<(), SinkError> {
        let at = &batch.curvatures[0];
        for row in 0..batch.len() {
            let inside = (0..3).all(|axis| self.core[axis].contains(&cell(batch, axis, row)));
            if inside && at.flags[row] & LEFT_OUT == 0 {
                self.found.differences.push(at.mean_error[row]);
                let is_too_large = at.flags[row] & Flag::RadiusTooLarge.bit() != 0;
                self.found.too_large += u64::from(is_too_large);
            }
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

impl Search<'_> {
    /// Chooses the radius; `settings` are those of a run at a radius in voxels.
    ///
    /// # Errors
    /// If the input cannot be read again, or a run fails.
    pub(crate) fn choose(
        &self,
        settings: impl Fn(f64) -> Result<Settings>,
    ) -> Result<RadiusChoice> {
        if !self.volume.source.re_readable {
            return Err(usage(format!(
                "--radius auto reads the input several times, which {} does not allow; save it to a file first, \
                 or give a radius",
                self.input.name()
            )));
        }
        let cubes = self.census()?;
        let surfels: u64 = cubes.values().sum();
        let sampled = if surfels > WHOLE {
            sample(&cubes, surfels)
        } else {
            Vec::new()
        };
        let mut tried: Vec<Tried> = Vec::new();
        let mut share_before = 0.0;
        let mut end = End::Largest;
        for voxels in radii(self.lattice) {
            let mut found = Found::default();
            if sampled.is_empty() {
                let dims = self.lattice.dims.map(|n| 0..n as i32);
                self.differences(settings(voxels)?, dims, &mut found)?;
            }
            for cube in &sampled {
                let core = [2, 1, 0].map(|i| CUBE * cube[i]..CUBE * (cube[i] + 1));
                self.differences(settings(voxels)?, core, &mut found)?;
            }
            let Found {
                mut differences,
                too_large,
            } = found;
            let count = differences.len();
            let share = too_large as f64 / count.max(1) as f64;
            if let Some(first) = tried.first() {
                if (count as f64) < LEAST_SHARE * first.surfels as f64 {
                    end = End::TooFew;
                    break;
                }
                if share > MOST_TOO_LARGE && share > share_before {
                    end = End::TooLarge;
                    break;
                }
            }
            if count == 0 {
                end = End::TooFew;
                break;
            }
            share_before = share;
            let (_, median, _) = differences.select_nth_unstable_by(count / 2, f32::total_cmp);
            let median = f64::from(*median);
            let rises = tried
                .last()
                .is_some_and(|last| median > last.median_difference);
            tried.push(Tried {
                voxels,
                median_difference: median,
                surfels: count as u64,
            });
            if rises {
                end = End::Rose;
                break;
            }
        }
        // the smaller of equals
        let best = tried
            .iter()
            .min_by(|a, b| a.median_difference.total_cmp(&b.median_difference));
        let voxels = best.map_or(default_radius(self.lattice), |best| best.voxels);
        let is_first = tried.first().is_some_and(|first| first.voxels == voxels);
        let reason = match end {
            _ if surfels == 0 => "there is no surfel; this is the default",
            _ if tried.is_empty() => {
                "no surfel is far enough from the border to compare radii; this is the default"
            }
            End::Rose if is_first => {
                "two estimates of H differ more at larger radii, which flatten; a smaller one may be better still"
            }
            End::TooLarge if is_first => {
                "at larger radii a tenth of the surfels and more have features smaller than the ball; a smaller one may be \
                 better still"
            }
            End::Rose => {
                "two estimates of H agree best at this radius: below, the grid and noise part them, above, flattening"
            }
            End::TooLarge => {
                "two estimates of H agree best at this radius; at larger ones a tenth of the surfels and more have features \
                 smaller than the ball"
            }
            End::TooFew => {
                "two estimates of H agree best at this radius; at larger ones too few surfels are away from the border and on no \
                 island"
            }
            End::Largest => {
                "two estimates of H agree best at this radius, the largest that was tried"
            }
        };
        Ok(RadiusChoice {
            voxels,
            tried,
            surfels,
            cubes: sampled.len(),
            reason: reason.into(),
        })
    }

    /// Surfels by cube.
    fn census(&self) -> Result<BTreeMap<[i32; 3], u64>> {
        let mut settings = Settings::new(self.lattice.clone());
        settings.estimator = Estimator::Trivial;
        settings.weights = Weights::Lumped;
        settings.radii = vec![1.0];
        let mut census = Census::default();
        let volume = self.input.open_within(self.memory_bytes / 4)?;
        self.run(volume, settings, &mut census)?;
        Ok(census.0)
    }

    /// Appends the differences at the surfels of a box of voxels.
    fn differences(
        &self,
        mut settings: Settings,
        core: [Range<i32>; 3],
        out: &mut Found,
    ) -> Result<()> {
        settings.error_kind = ErrorKind::Differences;
        let plan = settings.plan(&Access::of(self.volume), 0)?;
        let first = self.volume.header.first_index;
        let dims = self.lattice.dims;
        // What is cut off all the same is flagged, and left out.
        let around: [Range<i64>; 3] = [0, 1, 2].map(|a| {
            let passes: i32 = plan.refining_reach.iter().map(|reach| reach[a] + 1).sum();
            let reach = plan.ball_reach[a] + plan.normal_reach[a] + passes + 2;
            let (from, to) = (core[a].start - reach, core[a].end + reach);
            i64::from(from.max(0))..i64::from(to).min(i64::from(dims[a]))
        });
        let region = [0, 1, 2].map(|a| around[a].start + first[a]..around[a].end + first[a]);
        let input = self.input.within(region);
        let volume = input.open_within(self.memory_bytes / 4)?;
        settings.lattice = input::lattice(&volume, self.lattice.closed)?;
        let cells = settings.lattice.cell_dims();
        let mut differences = Differences {
            core: [0, 1, 2].map(|a| {
                let from = core[a].start - around[a].start as i32;
                let to = core[a].end - around[a].start as i32;
                // cells beyond the last voxel of the image belong to its last cube
                let last = core[a].end >= dims[a] as i32;
                from..if last { cells[a] } else { to }
            }),
            found: std::mem::take(out),
        };
        self.run(volume, settings, &mut differences)?;
        *out = differences.found;
        Ok(())
    }

    fn run(&self, volume: Volume, mut settings: Settings, sink: &mut dyn SurfelSink) -> Result<()> {
        let held = self.volume.source.held_bytes;
        settings.memory_bytes = self.memory_bytes.saturating_sub(held);
        let plan = settings.plan(&Access::of(&volume), 0)?;
        let header = &volume.header;
        let binarizer = Binarizer::new(
            self.criterion,
            header.voxel,
            header.byte_order,
            header.scaling,
        );
        let source = Source { volume, binarizer };
        let (style, stop) = (self.style, self.stop);
        let progress = Progress::default();
        let planes = settings.lattice.cell_dims()[2].unsigned_abs().into();
        progress::watched(
            |done| progress::show(style, &progress, planes, done),
            || run_pipeline(source, &settings, &plan, &mut [sink], &progress, stop),
        )?;
        Ok(())
    }
}

/// A choice, as the summary has it, in two lines for people.
pub(crate) fn in_words(choice: &Value, unit: &str) -> [String; 2] {
    // as a user types it: 12, not 12.0
    let voxels = |of: &Value| of["voxels"].as_f64().unwrap_or(f64::NAN).to_string();
    let tried = choice["tried"].as_array().into_iter().flatten();
    let tried: Vec<String> = tried
        .map(|t| {
            let difference = t["median_difference"].as_f64().unwrap_or(f64::NAN);
            format!("{}vx {}", voxels(t), number(difference))
        })
        .collect();
    let reason = choice["reason"].as_str().unwrap_or_default();
    let medians = if tried.is_empty() {
        "none was compared".to_owned()
    } else {
        format!("median difference in 1/{unit}: {}", tried.join(", "))
    };
    [format!("{}vx: {reason}", voxels(choice)), medians]
}

/// Cubes at equal steps through the surfels, without repetition.
fn sample(cubes: &BTreeMap<[i32; 3], u64>, surfels: u64) -> Vec<[i32; 3]> {
    let mut sampled: Vec<[i32; 3]> = Vec::new();
    let mut passed = 0;
    for (&cube, &count) in cubes {
        let steps = |n: u64| (n * SAMPLES + surfels / 2) / surfels;
        if steps(passed + count) > steps(passed) {
            sampled.push(cube);
        }
        passed += count;
    }
    sampled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubes_are_sampled_by_their_surfels() {
        let mut cubes = BTreeMap::new();
        for x in 0..100 {
            cubes.insert([0, 0, x], if x < 50 { 1000 } else { 10 });
        }
        let total = cubes.values().sum();
        let sampled = sample(&cubes, total);
        assert_eq!(sampled.len(), 8);
        assert!(sampled.iter().all(|c| c[2] < 50));
        let steps: Vec<i32> = sampled.windows(2).map(|w| w[1][2] - w[0][2]).collect();
        assert!(steps.iter().all(|s| (5..=8).contains(s)), "{steps:?}");
        // a cube that has all of them is taken once
        assert_eq!(sample(&BTreeMap::from([([1, 2, 3], 9)]), 9), [[1, 2, 3]]);
    }

    #[test]
    fn the_default_radius_is_in_mean_edges() {
        let of = |spacing: [f64; 3]| default_radius(&Lattice::new([9; 3], spacing, false).unwrap());
        assert_eq!(of([1.0; 3]), 6.0);
        assert_eq!(of([0.3; 3]), 6.0);
        assert_eq!(of([0.5, 0.5, 1.0]), 3.8);
        assert_eq!(of([0.7, 0.7, 5.0]), 3.0);
    }
}
