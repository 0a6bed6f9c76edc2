//! The method: normals, radii, ball, weights; what the rows depend on.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Result;
use clap::{Args, ValueEnum};
use curvox_formats::Unit;
use serde_json::{Value, json};

use crate::curvature;
use crate::khalimsky::Adjacency;
use crate::lattice::Lattice;
use crate::measure::ball::{BallKernel, Compensation, Extent, Weights};
use crate::measure::field::Field;
use crate::normal::gradient::GradientKernel;
use crate::normal::refine::{FIRST_RADIUS, RefineKernel};
use crate::normal::vcm::Side;
use crate::normal::{Estimator, Orientation};
use crate::sink::RadiusInfo;
use crate::volume::Criterion;

use super::exit::{Usage, usage};
use super::lengths::Length;
use super::scale::default_radius;

/// Options of the method.
#[derive(Args, Clone, Debug)]
pub(crate) struct MethodArgs {
    /// Radii of the balls the measures (or, with --curvature ii, the solid) are summed over; several give columns for each [default: 6vx; less for voxels that are not cubes]
    ///
    /// Larger takes away more of the staircase of the grid and of noise, and flattens more detail; a curvature 1/R wants a radius well below R.
    /// auto tries radii from half to twice the default, on samples of a large image, and takes the one at which two estimates of H with
    /// different weights agree best. It reads the input many times (no pipe; a compressed file is better unpacked first), and is for
    /// --method default and refined with their own normals and weights.
    /// The default is 6 mean edges of a voxel (geometric mean, to a tenth), and at least 3 of the longest: 3.8vx for voxels of 1 x 1 x 2.
    #[arg(
        long,
        value_name = "LENGTH[,LENGTH]|auto",
        value_delimiter = ',',
        allow_hyphen_values = true,
        help_heading = "Method"
    )]
    radius: Vec<Radius>,

    /// Radius of the ball the normals are estimated in [default: the smallest --radius, 1.2 times that for average]
    #[arg(
        long,
        value_name = "LENGTH",
        allow_hyphen_values = true,
        help_heading = "Method"
    )]
    normal_radius: Option<Length>,

    /// Normals: average (of the surface), ii (digital integral invariants), vcm (Voronoi covariance
    /// measure), gradient (of the grey values), given (--normals-from), trivial [default: average; with --method paper and --curvature ii: ii]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "NAME",
        help_heading = "Method"
    )]
    normals: Option<Normals>,

    /// Where vcm normals cut the cells of the surface's pointels; what is looked at reaches twice as far [default: 10/3 of the radius of the normals]
    #[arg(
        long,
        value_name = "LENGTH",
        allow_hyphen_values = true,
        help_heading = "Method"
    )]
    voronoi_radius: Option<Length>,

    /// Width of the Gaussian whose derivative --normals gradient takes [default: 1.5vx]
    ///
    /// Its standard deviation; weights end at three of them. Smaller keeps finer detail, larger
    /// smooths more noise. Beyond the border of the image values are those of the nearest voxels.
    #[arg(
        long,
        value_name = "LENGTH",
        allow_hyphen_values = true,
        help_heading = "Method"
    )]
    sigma: Option<Length>,

    /// Take the normals from a table: a Parquet file, or the directory of a run
    ///
    /// Columns kx ky kz side (whole numbers) and nx ny nz (f32 or f64, world axes, any length but
    /// 0), a row for each surfel in any order. Rows that belong to no surfel are counted. Tables
    /// sorted by kz, as curvox writes them, are read fastest.
    #[arg(long, value_name = "PATH", help_heading = "Method")]
    normals_from: Option<PathBuf>,

    /// Which way normals point: moment (ii: away from the solid), surface (vcm: as the surface around), dgtal (DGtal's rule for either) [default: moment or surface]
    ///
    /// dgtal reverses some ii normals where the surfel is nearly orthogonal to the surface; for vcm it also gives a
    /// point between several pointels to the last of them instead of to all.
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "RULE",
        help_heading = "Method"
    )]
    orientation: Option<OrientationRule>,

    /// Normals between surfels: constant (on each), interpolated (between pointels, unit length), linear (not unit) [default: constant]
    ///
    /// constant: measures lie on surfels, linels and pointels. interpolated and linear: the normal of a
    /// pointel is the mean of those of the surfels around it, and is continued over each surfel;
    /// then all measures lie on surfels, and --weights sharp is the same as lumped.
    /// interpolated keeps the Gauss-Bonnet theorem exactly; linear is faster and does not.
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        default_value = "constant",
        hide_default_value = true,
        value_name = "NAME",
        help_heading = "Method"
    )]
    field: FieldName,

    /// Curvature: measures (corrected curvature measures), ii (plain integral invariants of the solid) [default: measures]
    ///
    /// ii takes H, G, k1, k2 from the volume and covariance of the solid in the ball of --radius; normals
    /// and area stay what they are. It converges only if the radius shrinks slower than the gridstep h,
    /// such as h^(1/3): at radii like h^(1/2), where the measures converge, its error stays. It is given to compare with.
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        default_value = "measures",
        hide_default_value = true,
        value_name = "NAME",
        help_heading = "Method"
    )]
    curvature: CurvatureName,

    /// Surface summed: connected (to the surfel within the ball), whole (all of the ball) [default: connected]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "SET",
        help_heading = "Method"
    )]
    ball: Option<BallSet>,

    /// How cells of the ball count: compensated (by their distance), lumped (shared out to surfels), sharp (all or nothing), dgtal (ratios) [default: compensated]
    ///
    /// compensated: positive weights that fall with the distance, up to 1.2 times the radius; where the curvature changes
    /// within the ball, weights that turn negative, up to 1.6 times the radius, so that it is not flattened (but not where the
    /// surface is noise, as many walls and tips one voxel thick show). With --normals ii, vcm and trivial the default is lumped.
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "RULE",
        help_heading = "Method"
    )]
    weights: Option<WeightRule>,

    /// A named choice of the options above, each of which still overrides it
    ///
    /// default: as said at each option; robust and fast. refined: for clean segmentations of smooth objects, half
    /// the paper's error on most, and a few times the time: the normals are fitted in five passes such that the surface stays between the
    /// voxels on either side. Where the surface is noise it is as the default. paper: as the authors of the corrected
    /// curvature measures compute them with DGtal: --normals ii --orientation dgtal --ball connected --weights dgtal.
    #[arg(
        long,
        value_enum,
        default_value = "default",
        value_name = "NAME",
        help_heading = "Method"
    )]
    method: Method,

    /// How surfels join where four meet: interior (solid 6-connected), exterior (solid 26-connected)
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        default_value = "interior",
        value_name = "NAME",
        help_heading = "Method"
    )]
    adjacency: AdjacencyName,

    /// Close the surface on the border of the image, as if nothing of the solid went on beyond it
    #[arg(long, help_heading = "Method")]
    pub(crate) closed: bool,

    /// Give the principal directions too (columns d1x ... d2z)
    #[arg(long, help_heading = "Method")]
    directions: bool,

    /// Give the quality of the normals too (column quality: mu_Omega / mu0, 0 for the normals of a surface)
    ///
    /// In 1/length, to be compared with |mean_curvature|: how fast the normals turn about
    /// themselves, as those of no surface do. Its sign is that of a sense of rotation, and changes in a mirror.
    #[arg(long, help_heading = "Method")]
    quality: bool,
}

/// A radius as typed.
#[derive(Clone, Debug, PartialEq)]
enum Radius {
    /// To be chosen from the data.
    Auto,
    /// Given.
    Length(Length),
}

impl FromStr for Radius {
    type Err = Usage;

    fn from_str(text: &str) -> Result<Self, Usage> {
        if text.trim().eq_ignore_ascii_case("auto") {
            return Ok(Self::Auto);
        }
        text.parse().map(Self::Length)
    }
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
pub(super) enum FieldName {
    Constant,
    Interpolated,
    Linear,
}

impl From<FieldName> for Field {
    fn from(name: FieldName) -> Self {
        match name {
            FieldName::Constant => Field::Constant,
            FieldName::Interpolated => Field::Interpolated,
            FieldName::Linear => Field::Linear,
        }
    }
}

impl From<Field> for FieldName {
    fn from(field: Field) -> Self {
        match field {
            Field::Constant => FieldName::Constant,
            Field::Interpolated => FieldName::Interpolated,
            Field::Linear => FieldName::Linear,
        }
    }
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum Method {
    Default,
    Refined,
    Paper,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum Normals {
    Ii,
    Vcm,
    Average,
    Gradient,
    Given,
    Trivial,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum OrientationRule {
    Moment,
    Surface,
    Dgtal,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum CurvatureName {
    Measures,
    Ii,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum BallSet {
    Connected,
    Whole,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum WeightRule {
    Compensated,
    Lumped,
    Sharp,
    Dgtal,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum AdjacencyName {
    Interior,
    Exterior,
}

/// A method made ready for a voxel grid.
#[derive(Clone, Debug)]
pub(crate) struct ResolvedMethod {
    pub(crate) estimator: Estimator,
    /// The radius normals are refined with, in voxel units, if they are.
    pub(crate) refinement: Option<f64>,
    pub(crate) curvature: curvature::Method,
    pub(crate) extent: Extent,
    pub(crate) weights: Weights,
    pub(crate) adjacency: Adjacency,
    pub(crate) field: Field,
    pub(crate) directions: bool,
    pub(crate) quality: bool,
    pub(crate) radii: Vec<RadiusInfo>,
    /// The radius of the normals in voxel units, if they have one.
    pub(crate) normal_radius: Option<f64>,
    /// The options, without the criterion.
    parameters: Value,
}

fn name_of(value: impl ValueEnum) -> String {
    value
        .to_possible_value()
        .map_or_else(String::new, |v| v.get_name().to_owned())
}

/// Sigma of the gradient, in voxels. On shapes at partial volume, blurred by a voxel, with noise up to
/// 0.1, gridsteps 1 to 1/8 (`curvox-tools grey`), the geometric means of the errors of H with lumped sums, l2 and linf,
/// against integral invariants are 0.62 and 0.68 at 1, 0.57 and 0.59 at 1.5, 0.60 and 0.59 at 2:
/// smaller lets noise through, larger flattens coarse shapes (1.4 times the error on Goursat).
const DEFAULT_SIGMA: f64 = 1.5;

impl MethodArgs {
    /// The table of normals asked for.
    pub(crate) fn normals_from(&self) -> Option<&Path> {
        self.normals_from.as_deref()
    }

    /// Whether the radius is to be chosen from the data.
    pub(crate) fn radius_is_auto(&self) -> bool {
        self.radius.contains(&Radius::Auto)
    }

    /// The same with one radius, in voxels.
    pub(crate) fn with_radius(&self, voxels: f64) -> Self {
        Self {
            radius: vec![Radius::Length(Length::voxels(voxels))],
            ..self.clone()
        }
    }

    /// The lengths of the radii; those that are still to be chosen are the default.
    fn lengths(&self, lattice: &Lattice) -> Result<Vec<Length>> {
        if self.radius_is_auto() && self.radius.len() > 1 {
            return Err(usage(
                "--radius auto chooses one radius; leave the others out",
            ));
        }
        let default = Length::voxels(default_radius(lattice));
        let given: Vec<Length> = (self.radius.iter())
            .map(|radius| match radius {
                Radius::Auto => default.clone(),
                Radius::Length(length) => length.clone(),
            })
            .collect();
        Ok(if given.is_empty() {
            vec![default]
        } else {
            given
        })
    }

    /// The normals asked for, by `--normals` or by what only one kind of them takes.
    fn named_normals(&self) -> Result<Normals> {
        match (self.normals, &self.normals_from) {
            (None | Some(Normals::Given), Some(_)) => Ok(Normals::Given),
            (Some(other), Some(_)) => Err(usage(format!(
                "--normals-from gives the normals; --normals {} would compute them",
                name_of(other)
            ))),
            (Some(Normals::Given), None) => Err(usage(
                "--normals given needs the table: --normals-from PATH",
            )),
            (Some(named), None) => Ok(named),
            (None, None) if self.method == Method::Paper => Ok(Normals::Ii),
            // the normals of the same ball as the curvature
            (None, None) if self.curvature == CurvatureName::Ii => Ok(Normals::Ii),
            (None, None) => Ok(Normals::Average),
        }
    }

    /// The weights for normals, unless they are named.
    fn weights(&self, normals: Normals) -> WeightRule {
        let own = match normals {
            _ if self.method == Method::Paper => WeightRule::Dgtal,
            // A table of the default's normals gives the default's curvatures.
            Normals::Average | Normals::Given | Normals::Gradient => WeightRule::Compensated,
            // Measured with ii: compensated is worse on spheres and better on Goursat's surface.
            _ => WeightRule::Lumped,
        };
        self.weights.unwrap_or(own)
    }

    /// Checks that refined normals can be had.
    fn check_refined(&self, normals: Normals, by_invariants: bool) -> Result<()> {
        if self.method != Method::Refined {
            return Ok(());
        }
        if by_invariants {
            return Err(usage(
                "--method refined is for --curvature measures; integral invariants do not depend on normals",
            ));
        }
        if normals != Normals::Average {
            return Err(usage(format!(
                "--method refined starts from --normals average, and cannot refine {}",
                name_of(normals)
            )));
        }
        if self.normal_radius.is_some() {
            return Err(usage(
                "--method refined scales the normals with the smallest --radius; --normal-radius has no use",
            ));
        }
        Ok(())
    }

    /// The rule of orientation of normals that have one.
    fn orientation(&self, normals: Normals) -> Result<Option<OrientationRule>> {
        let own = match normals {
            Normals::Ii => OrientationRule::Moment,
            Normals::Vcm => OrientationRule::Surface,
            Normals::Average | Normals::Gradient | Normals::Given | Normals::Trivial => {
                return match self.orientation {
                    None => Ok(None),
                    Some(_) => Err(usage(format!(
                        "--orientation is for --normals ii and vcm; {} normals have theirs",
                        name_of(normals)
                    ))),
                };
            }
        };
        match self.orientation {
            None if self.method == Method::Paper => Ok(Some(OrientationRule::Dgtal)),
            None => Ok(Some(own)),
            Some(rule) if rule == own || rule == OrientationRule::Dgtal => Ok(Some(rule)),
            Some(rule) => Err(usage(format!(
                "--orientation {} is not for --normals {}, expected {} or dgtal",
                name_of(rule),
                name_of(normals),
                name_of(own)
            ))),
        }
    }

    /// Fills in defaults and converts lengths.
    ///
    /// # Errors
    /// If a length cannot be converted or used, or options contradict each other.
    pub(crate) fn resolve(&self, lattice: &Lattice, world: Unit) -> Result<ResolvedMethod> {
        let normals = self.named_normals()?;
        let orientation = self.orientation(normals)?;
        let by_invariants = self.curvature == CurvatureName::Ii;
        self.check_refined(normals, by_invariants)?;
        let refined = self.method == Method::Refined;
        for (flag, is_given) in [
            ("--ball", self.ball.is_some()),
            ("--weights", self.weights.is_some()),
            ("--field", self.field != FieldName::Constant),
            ("--quality", self.quality),
        ] {
            if by_invariants && is_given {
                return Err(usage(format!(
                    "{flag} is for --curvature measures; integral invariants take all voxels of the ball"
                )));
            }
        }
        let ball = self.ball.unwrap_or(BallSet::Connected);
        let weight_rule = self.weights(normals);
        let weights = match weight_rule {
            WeightRule::Compensated => Weights::Compensated(if refined {
                Compensation::Refined
            } else {
                Compensation::Averaged
            }),
            WeightRule::Lumped => Weights::Lumped,
            WeightRule::Sharp => Weights::Sharp,
            WeightRule::Dgtal => Weights::Dgtal,
        };
        let unit = lattice.voxel_unit_world();
        let in_voxels = |flag: &str, length: &Length| -> Result<f64> {
            let voxels = length.in_voxels(flag, unit, world)?;
            lattice
                .metric()
                .voxel_ball(voxels)
                .map_err(|error| usage(format!("{flag} {length}: {error}")))?;
            Ok(voxels)
        };
        let asked = self.lengths(lattice)?;
        let mut radii = Vec::with_capacity(asked.len());
        for length in &asked {
            let voxels = if by_invariants {
                in_voxels("--radius", length)?
            } else {
                let voxels = length.in_voxels("--radius", unit, world)?;
                BallKernel::check(voxels, weights, lattice)
                    .map_err(|error| usage(format!("--radius {length}: {error}")))?;
                voxels
            };
            radii.push(RadiusInfo {
                label: length.to_string(),
                voxels,
                world: rounded(voxels * unit),
            });
        }
        // Normals decide the accuracy as much as sums do: the paper takes one radius for both.
        let smallest = (1..radii.len()).fold(0, |best, i| {
            if radii[i].voxels < radii[best].voxels {
                i
            } else {
                best
            }
        });
        let own_length = match normals {
            Normals::Average => asked[smallest].times(FIRST_RADIUS),
            _ => asked[smallest].clone(),
        };
        let normal_length = self.normal_radius.as_ref().unwrap_or(&own_length);
        let refinement = refined.then_some(radii[smallest].voxels);
        if refinement.is_some_and(|radius| radius > RefineKernel::LARGEST_RADIUS) {
            return Err(usage(format!(
                "--radius {}: --method refined takes up to {} voxels, as it looks twice as far",
                asked[smallest],
                RefineKernel::LARGEST_RADIUS
            )));
        }
        let normal_radius = if !matches!(normals, Normals::Ii | Normals::Vcm | Normals::Average) {
            if self.normal_radius.is_some() {
                return Err(usage(format!(
                    "--normal-radius has no use with --normals {}",
                    name_of(normals)
                )));
            }
            None
        } else {
            Some(in_voxels("--normal-radius", normal_length)?)
        };
        let default_sigma = Length::voxels(DEFAULT_SIGMA);
        let sigma_length = self.sigma.as_ref().unwrap_or(&default_sigma);
        let sigma = if normals == Normals::Gradient {
            let sigma = sigma_length.in_voxels("--sigma", unit, world)?;
            GradientKernel::new(sigma, lattice.edges())
                .map_err(|error| usage(format!("--sigma {sigma_length}: {error}")))?;
            sigma
        } else if self.sigma.is_some() {
            return Err(usage(format!(
                "--sigma is for --normals gradient; {} normals have none",
                name_of(normals)
            )));
        } else {
            0.0
        };
        let as_dgtal = orientation == Some(OrientationRule::Dgtal);
        let voronoi_radius = match (&self.voronoi_radius, normal_radius) {
            (Some(_), _) if normals != Normals::Vcm => {
                return Err(usage("--voronoi-radius is for --normals vcm"));
            }
            (Some(length), _) => Some(in_voxels("--voronoi-radius", length)?),
            (None, Some(radius)) if normals == Normals::Vcm => {
                let voxels = radius * 10.0 / 3.0;
                lattice.metric().voxel_ball(voxels).map_err(|error| {
                    usage(format!(
                        "--voronoi-radius, by default 10/3 of {normal_length}: {error}"
                    ))
                })?;
                Some(voxels)
            }
            _ => None,
        };
        let estimator = match (normals, normal_radius, voronoi_radius) {
            (Normals::Ii, Some(radius), _) => Estimator::IntegralInvariant {
                radius,
                orientation: if as_dgtal {
                    Orientation::Trivial
                } else {
                    Orientation::Moment
                },
            },
            (Normals::Vcm, Some(radius), Some(voronoi_radius)) => Estimator::VoronoiCovariance {
                voronoi_radius,
                radius,
                side: if as_dgtal { Side::Dgtal } else { Side::Surface },
            },
            (Normals::Average, Some(radius), _) => Estimator::SurfaceAverage { radius },
            (Normals::Gradient, _, _) => Estimator::Gradient { sigma },
            (Normals::Given, _, _) => Estimator::Given,
            _ => Estimator::Trivial,
        };
        let mut parameters = json!({
            "normals": name_of(normals),
            "field": name_of(self.field),
            "curvature": name_of(self.curvature),
            "radii": asked.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "adjacency": name_of(self.adjacency),
            "closed": self.closed,
            "directions": self.directions,
            "quality": self.quality,
        });
        if let Some(radius) = normal_radius {
            parameters["normal_radius"] = json!(normal_length.to_string());
            parameters["normal_radius_voxels"] = json!(radius);
        }
        if normals == Normals::Gradient {
            parameters["sigma"] = json!(sigma_length.to_string());
            parameters["sigma_voxels"] = json!(sigma);
        }
        if !by_invariants {
            parameters["ball"] = json!(name_of(ball));
            parameters["weights"] = json!(name_of(weight_rule));
        }
        if let Some(radius) = refinement {
            parameters["refinement_radius_voxels"] = json!(radius);
        }
        if let Some(orientation) = orientation {
            parameters["orientation"] = json!(name_of(orientation));
        }
        if let Some(radius) = voronoi_radius {
            parameters["voronoi_radius_voxels"] = json!(radius);
        }
        Ok(ResolvedMethod {
            estimator,
            refinement,
            curvature: match self.curvature {
                CurvatureName::Measures => curvature::Method::Measures,
                CurvatureName::Ii => curvature::Method::Invariants,
            },
            extent: match ball {
                BallSet::Connected => Extent::Connected,
                BallSet::Whole => Extent::Whole,
            },
            weights,
            adjacency: match self.adjacency {
                AdjacencyName::Interior => Adjacency::Interior,
                AdjacencyName::Exterior => Adjacency::Exterior,
            },
            field: self.field.into(),
            directions: self.directions,
            quality: self.quality,
            radii,
            normal_radius,
            parameters,
        })
    }
}

impl ResolvedMethod {
    /// All that the rows depend on beside the voxels: nothing of threads, memory, bricks or paths.
    pub(crate) fn parameters(&self, criterion: Criterion) -> Value {
        let mut parameters = self.parameters.clone();
        parameters["inside"] = json!(criterion.to_string());
        parameters
    }
}
/// Normals, field and curvature of the parameters of a run, in a line for people.
pub(crate) fn in_words(parameters: &Value) -> String {
    let text = |key: &str| parameters[key].as_str().unwrap_or("?");
    let mut words = text("normals").to_owned();
    if !parameters["refinement_radius_voxels"].is_null() {
        words = format!("refined {words}");
    }
    for (key, before) in [("normal_radius", " of radius "), ("sigma", " of sigma ")] {
        if let Some(length) = parameters[key].as_str() {
            words += &format!("{before}{length}");
        }
    }
    if let Some(voxels) = parameters["voronoi_radius_voxels"].as_f64() {
        words += &format!(" and Voronoi radius {}vx", (voxels * 1e3).round() / 1e3);
    }
    words
        + &match text("curvature") {
            "ii" => ", curvature by integral invariants".to_owned(),
            _ => format!(", field {}, curvature by measures", text("field")),
        }
}

/// A length for print, without the noise of its last digits.
fn rounded(x: f64) -> f64 {
    format!("{x:.12e}").parse().unwrap_or(x)
}
