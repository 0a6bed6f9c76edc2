//! A run made ready: what `run` does and `plan` tells, from the same arguments.

use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use clap::Args;
use curvox_formats::{Content, Volume};

use crate::lattice::Lattice;
use crate::normal::Estimator;
use crate::pipeline::{Access, Plan, Settings};
use crate::sink::{NormalTable, TableInfo};
use crate::volume::{Binarizer, Criterion, Number};

use super::conventions;
use super::exit::{BadInput, usage};
use super::input::{self, CriterionArgs, InputArgs, Inside};
use super::method::{MethodArgs, ResolvedMethod};
use super::output::OutputArgs;
use super::progress::Style;
use super::scale::{self, RadiusChoice, Search};
use super::{sizes, values};

/// Arguments of `run` and `plan`.
#[derive(Args, Clone, Debug)]
pub(crate) struct JobArgs {
    #[command(flatten)]
    pub(crate) input: InputArgs,
    #[command(flatten)]
    pub(crate) criterion: CriterionArgs,
    #[command(flatten)]
    pub(crate) method: MethodArgs,
    #[command(flatten)]
    pub(crate) output: OutputArgs,
    #[command(flatten)]
    pub(crate) resources: ResourceArgs,
}

/// What a run may use. None of it shows in the results.
#[derive(Args, Clone, Debug)]
pub(crate) struct ResourceArgs {
    /// Memory the run may use: 512MiB, 1GiB, 4GB
    #[arg(long, value_name = "SIZE", default_value = "1GiB", value_parser = sizes::parse, help_heading = "Resources")]
    pub(crate) memory: u64,

    /// Worker threads [default: one for each processor]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Resources")]
    threads: Option<u16>,

    /// Edge of the bricks in voxels, 8 to 1024 [default: from the memory]
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        help_heading = "Resources"
    )]
    pub(crate) brick: Option<i32>,
}

/// A run made ready.
pub(crate) struct Job {
    pub(crate) volume: Volume,
    pub(crate) binarizer: Binarizer,
    pub(crate) criterion: Criterion,
    /// The threshold, where it was found by Otsu's method.
    pub(crate) otsu: Option<f64>,
    /// Why the radius is what it is, where it was chosen from the data.
    pub(crate) radius_choice: Option<RadiusChoice>,
    pub(crate) method: ResolvedMethod,
    pub(crate) settings: Settings,
    pub(crate) plan: Plan,
    pub(crate) info: TableInfo,
}

/// The warning on a criterion that takes what is outside the surface of a level set.
fn outside_of_level_set(volume: &Volume, inside: &Inside) -> Option<String> {
    let taken_above = matches!(inside, Inside::Otsu | Inside::Given(Criterion::AtLeast(_)));
    (taken_above && volume.header.content == Content::LevelSet).then(|| {
        format!(
            "{}: is a level set, negative inside: values above a threshold are its outside, and \
             curvatures change their sign; without a criterion, what is below 0 is taken",
            volume.source.name
        )
    })
}

impl JobArgs {
    /// The settings of a run by a method, on this machine.
    fn settings(&self, lattice: &Lattice, method: &ResolvedMethod) -> Settings {
        let mut settings = Settings::new(lattice.clone());
        settings.adjacency = method.adjacency;
        settings.estimator = method.estimator;
        settings.refinement = method.refinement;
        settings.curvature = method.curvature;
        settings.radii = method.radii.iter().map(|r| r.voxels).collect();
        settings.extent = method.extent;
        settings.weights = method.weights;
        settings.field = method.field;
        settings.directions = method.directions;
        settings.quality = method.quality;
        settings.memory_bytes = self.resources.memory;
        settings.brick = self.resources.brick;
        if let Some(threads) = self.resources.threads {
            settings.threads = threads.into();
        }
        settings
    }

    /// Opens the input and settles everything before the first voxel is used.
    pub(crate) fn prepare(&self, style: Style, stop: &AtomicBool) -> Result<Job> {
        // Copies of inputs that are not read forward leave most of the memory to the run.
        let mut volume = self.input.open_within(self.resources.memory / 4)?;
        let lattice = input::lattice(&volume, self.method.closed)?;
        // Mistakes of the command line are found before a long pass over the data.
        let mut method = self.method.resolve(&lattice, volume.header.unit)?;
        let inside = self.criterion.inside(&volume.header, &self.input)?;
        if let Some(warning) = outside_of_level_set(&volume, &inside) {
            volume.header.warnings.push(warning);
        }
        let by_label = matches!(inside, Inside::Given(Criterion::Label(_)));
        if by_label && matches!(method.estimator, Estimator::Gradient { .. }) {
            return Err(usage(
                "--normals gradient has no meaning with --label: labels are names, and the step \
                 from one to another is no slope; take --normals ii or average, or the grey image \
                 the labels were made from with --threshold, --below or --range",
            ));
        }
        let given = self
            .method
            .normals_from()
            .map(|path| {
                NormalTable::open(path)
                    .map_err(|error| BadInput(format!("--normals-from: {error}")))
            })
            .transpose()?;
        let sink_bytes = self
            .output
            .sink_bytes(lattice.dims, self.resources.memory)?;
        let mut settings = self.settings(&lattice, &method);
        settings.given = given;
        if let Some(threads) = self.resources.threads {
            // What is done beside the stages (values, slices) keeps to the number too. A pool that
            // is there already is as good.
            let _ = rayon::ThreadPoolBuilder::new()
                .num_threads(threads.into())
                .build_global();
        }
        let mut plan = settings.plan(&Access::of(&volume), sink_bytes)?;
        if self.method.radius_is_auto() {
            if !settings.gives_errors() {
                return Err(usage(
                    "--radius auto compares what only --method default and refined compute, with the normals and weights \
                     that are theirs; give a radius",
                ));
            }
            // before any pass over the data
            let largest = self.method.with_radius(scale::largest_radius(&lattice));
            let largest = largest.resolve(&lattice, volume.header.unit)?;
            let plan = self
                .settings(&lattice, &largest)
                .plan(&Access::of(&volume), sink_bytes);
            plan.with_context(|| {
                format!("--radius auto tries radii up to {}", largest.radii[0].label)
            })?;
        }
        let (criterion, otsu) = match inside {
            Inside::Given(criterion) => (criterion, None),
            Inside::Otsu => {
                let threshold = values::otsu(&self.input, &volume, stop)?;
                (Criterion::AtLeast(Number::from(threshold)), Some(threshold))
            }
        };
        let radius_choice = if self.method.radius_is_auto() {
            let search = Search {
                input: &self.input,
                volume: &volume,
                lattice: &lattice,
                criterion,
                memory_bytes: self.resources.memory,
                style,
                stop,
            };
            let at = |voxels: f64| -> Result<ResolvedMethod> {
                let fixed = self.method.with_radius(voxels);
                fixed.resolve(&lattice, volume.header.unit)
            };
            let choice = search.choose(|voxels| Ok(self.settings(&lattice, &at(voxels)?)))?;
            method = at(choice.voxels)?;
            settings = self.settings(&lattice, &method);
            plan = settings.plan(&Access::of(&volume), sink_bytes)?;
            Some(choice)
        } else {
            None
        };
        let header = &volume.header;
        let info = TableInfo {
            dims: settings.lattice.dims,
            spacing: settings.lattice.spacing,
            unit: input::unit_name(&volume).to_owned(),
            first_index: header.first_index,
            origin: header.origin,
            direction: header.direction,
            radii: method.radii.clone(),
            directions: method.directions,
            errors: settings.gives_errors(),
            quality: method.quality,
            parameters: method.parameters(criterion),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            conventions: conventions::sentences(self.method.closed, method.curvature),
        };
        info.check()?;
        if let Some(given) = &mut settings.given {
            given.compare(&info);
        }
        let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, header.scaling);
        Ok(Job {
            binarizer,
            criterion,
            otsu,
            radius_choice,
            method,
            settings,
            plan,
            info,
            volume,
        })
    }
}
