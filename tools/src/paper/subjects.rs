//! Digital shapes to look at: the user's volumes, or shapes of curvox in their place.

use super::methods::Method;
use super::runs::{Run, Solid};
use super::study::Study;

/// Shapes that stand in for the paper's: round arms and blunt ends for the dragon, and a gyroid that
/// the border of the image closes with flat faces and sharp creases for the octaflower.
const INSTEAD: [(&str, bool); 2] = [("leopold", false), ("gyroid:period=12,half_edge=9", true)];

/// Volumes whose name begins so belong to the second group.
const SECOND: &str = "octaflower";

/// The two sets of digital shapes of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// The dragon: figures 11 and 16.
    First,
    /// The octaflower: figures 12, 13, 17 and 18.
    Second,
}

/// A digital shape at a gridstep.
#[derive(Clone, Debug, PartialEq)]
pub struct Subject {
    /// What it is made from.
    pub solid: Solid,
    /// The gridstep its radii follow from.
    pub gridstep: f64,
    /// Whether the border of the image closes it.
    pub closed: bool,
}

impl Subject {
    /// The volumes of a group, or the shape that stands in for them at two resolutions.
    pub fn all(study: &Study, group: Group) -> Vec<Self> {
        let is_second = |name: &str| name.starts_with(SECOND);
        let given: Vec<Subject> = study
            .volumes
            .iter()
            .filter(|volume| is_second(&volume.name) == (group == Group::Second))
            .map(|volume| Subject {
                solid: Solid::Volume {
                    name: volume.name.clone(),
                    path: volume.path.clone(),
                },
                gridstep: volume.gridstep,
                closed: false,
            })
            .collect();
        if !given.is_empty() {
            return given;
        }
        let (spec, closed) = INSTEAD[usize::from(group == Group::Second)];
        // The paper's volumes have two resolutions, each half of the other.
        let fine = study.finest.max(if study.quick { 0.5 } else { 0.125 });
        [(2.0 * fine).min(1.0), fine]
            .map(|gridstep| Subject {
                solid: Solid::Shape(spec.to_owned()),
                gridstep,
                closed,
            })
            .into()
    }

    /// A run on it.
    pub fn run(&self, method: Method, noise: f64) -> Run {
        Run {
            solid: self.solid.clone(),
            gridstep: self.gridstep,
            noise,
            closed: self.closed,
            method,
        }
    }

    /// In a picture.
    pub fn title(&self) -> String {
        let name = match &self.solid {
            Solid::Shape(spec) => spec.split(':').next().unwrap_or(spec),
            Solid::Volume { name, .. } => name,
        };
        format!("{name}, h = {}", self.gridstep)
    }
}

/// Where the shapes come from, for captions.
pub fn origin(study: &Study, group: Group) -> String {
    let is_given = Subject::all(study, group)
        .iter()
        .any(|subject| matches!(subject.solid, Solid::Volume { .. }));
    let (instead, paper) = match group {
        Group::First => ("Leopold's surface", "dragon"),
        Group::Second => (
            "a gyroid, which the border of the image closes with flat faces and sharp creases",
            "octaflower",
        ),
    };
    if is_given {
        "The volumes are those given with `--volume`.".into()
    } else {
        format!(
            "The paper shows the {paper}; no volume was given (`--volume {paper}=PATH:H`), so this is {instead}."
        )
    }
}
