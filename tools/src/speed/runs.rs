//! Whole runs of `curvox` over voxels in memory.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::ValueEnum;
use curvox::measure::ball::{Compensation, Extent, Weights};
use curvox::normal::refine::FIRST_RADIUS;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{Access, Progress, Settings, Source, run};
use curvox::sink::{
    DatasetSink, RadiusInfo, SinkError, SurfelBatch, SurfelSink, TableInfo, prepare_output,
};
use curvox::volume::{Binarizer, Criterion};
use curvox_formats::{DType, OpenOptions, RawLayout, Unit, VoxelType, open_stream};
use serde_json::json;

use super::clock::{Time, timed};
use super::subject::Subject;

/// The methods that are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Averages of the surface, compensated weights.
    Default,
    /// Integral invariants, lumped weights.
    #[value(name = "ii")]
    Invariants,
}

impl Method {
    /// How tables call it.
    pub fn name(self) -> &'static str {
        match self {
            Method::Default => "default",
            Method::Invariants => "II normals, lumped",
        }
    }

    /// Radius of its normals where that of its sums is `radius`.
    pub fn normal_radius(self, radius: f64) -> f64 {
        match self {
            Method::Default => FIRST_RADIUS * radius,
            Method::Invariants => radius,
        }
    }
}

/// Where the rows go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Destination {
    /// Nowhere: they are made and dropped.
    Dropped,
    /// A table of Parquet files in a temporary folder.
    Parquet,
}

/// Takes rows and forgets them.
struct Dropped;

impl SurfelSink for Dropped {
    fn write(&mut self, _: &SurfelBatch) -> Result<(), SinkError> {
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

/// One worker thread, the command's own memory.
///
/// # Errors
/// If the volume is too large for a grid.
pub fn settings(
    subject: &Subject,
    method: Method,
    extent: Extent,
    radius: f64,
) -> Result<Settings> {
    let normal_radius = method.normal_radius(radius);
    let (estimator, weights) = match method {
        Method::Default => (
            Estimator::SurfaceAverage {
                radius: normal_radius,
            },
            Weights::Compensated(Compensation::Averaged),
        ),
        Method::Invariants => (
            Estimator::IntegralInvariant {
                radius: normal_radius,
                orientation: Orientation::Moment,
            },
            Weights::Lumped,
        ),
    };
    Ok(Settings {
        estimator,
        weights,
        extent,
        radii: vec![radius],
        threads: 1,
        ..Settings::new(subject.lattice()?)
    })
}

/// What a run took, and how many surfels it met.
#[derive(Clone, Copy, Debug)]
pub struct Finished {
    /// Of the whole run, from the opened voxels to the last row.
    pub time: Time,
    /// How many.
    pub surfels: u64,
}

impl Finished {
    /// Processor time, microseconds a surfel.
    pub fn microseconds(&self) -> f64 {
        self.time.cpu * 1e6 / self.surfels.max(1) as f64
    }
}

/// Makes one run.
///
/// # Errors
/// If the settings have no plan, or the run fails.
pub fn once(subject: &Subject, settings: &Settings, destination: Destination) -> Result<Finished> {
    let dims = subject.dims.map(|n| n as u64);
    let layout = RawLayout {
        dims,
        dtype: DType::little(VoxelType::U8),
        spacing: None,
        unit: Unit::Unknown,
        skip: 0,
    };
    let options = OpenOptions {
        raw: Some(layout),
        ..Default::default()
    };
    let bytes = std::io::Cursor::new(subject.stored.clone());
    let volume = open_stream(Box::new(bytes), &subject.name, &options)?;
    let criterion = Criterion::AtLeast(1i128.into());
    let binarizer = Binarizer::new(criterion, VoxelType::U8, volume.header.byte_order, None);
    let source = Source { volume, binarizer };

    let folder = tempfile::tempdir()?;
    let (mut sink, sink_bytes): (Box<dyn SurfelSink>, u64) = match destination {
        Destination::Dropped => (Box::new(Dropped), 0),
        Destination::Parquet => {
            let info = table_info(settings)?;
            prepare_output(folder.path(), false)?;
            let bytes = DatasetSink::memory_bytes(&info);
            let sink = DatasetSink::create(folder.path(), info, None)?;
            (Box::new(sink), bytes)
        }
    };
    let plan = settings.plan(&Access::forward(1), sink_bytes)?;
    let (outcome, time) = timed(|| {
        run(
            source,
            settings,
            &plan,
            &mut [sink.as_mut()],
            &Progress::default(),
            &AtomicBool::new(false),
        )
    });
    Ok(Finished {
        time,
        surfels: outcome?.cells.surfel_count(),
    })
}

fn table_info(settings: &Settings) -> Result<TableInfo> {
    let dims = settings.lattice.dims;
    let [nx, ny, nz] = dims.map(u32::try_from);
    let radii = settings.radii.iter().map(|&radius| RadiusInfo {
        label: format!("{radius}vx"),
        voxels: radius,
        world: radius,
    });
    Ok(TableInfo {
        dims: [nx?, ny?, nz?],
        spacing: [1.0; 3],
        unit: "vx".into(),
        first_index: [0; 3],
        origin: [0.0; 3],
        direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        radii: radii.collect(),
        directions: settings.directions,
        errors: settings.gives_errors(),
        quality: settings.quality,
        parameters: json!({}),
        version: env!("CARGO_PKG_VERSION").into(),
        conventions: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_with_and_without_a_table_meet_the_surfels_of_the_reference() {
        let subject = Subject::goursat(1.0, 0.0).unwrap();
        for method in [Method::Default, Method::Invariants] {
            let settings = settings(&subject, method, Extent::Connected, 3.0).unwrap();
            for destination in [Destination::Dropped, Destination::Parquet] {
                let finished = once(&subject, &settings, destination).unwrap();
                assert_eq!(finished.surfels, 2454);
                assert!(finished.microseconds() > 0.0);
            }
        }
    }
}
