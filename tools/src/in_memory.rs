//! Whole runs over voxels in memory.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use curvox::pipeline::{Access, Progress, Settings, Source, run};
use curvox::sink::{SinkError, SurfelBatch, SurfelSink};
use curvox::volume::{Binarizer, Criterion};
use curvox_formats::{DType, OpenOptions, RawLayout, Unit, VoxelType, open_stream};

/// Keeps all rows.
#[derive(Default)]
pub struct Collected(pub Vec<SurfelBatch>);

impl Collected {
    /// All rows as one batch, whatever the cut.
    #[must_use]
    pub fn joined(self) -> SurfelBatch {
        let mut batches = self.0.into_iter();
        let mut all = batches.next().unwrap_or_default();
        for batch in batches {
            all.extend_from(&batch, 0..batch.len());
        }
        all.column = [0, 0];
        all
    }
}

impl SurfelSink for Collected {
    fn write(&mut self, batch: &SurfelBatch) -> Result<(), SinkError> {
        self.0.push(batch.clone());
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

/// The rows of a run over voxels stored one after the other, x fastest; the lattice of the settings has their number.
///
/// # Errors
/// If the voxels are not as many, or the run fails.
pub fn rows_of(
    stored: &[u8],
    voxel: VoxelType,
    criterion: Criterion,
    settings: &Settings,
) -> Result<Vec<SurfelBatch>> {
    let dtype = DType::little(voxel);
    let options = OpenOptions {
        raw: Some(RawLayout {
            dims: settings.lattice.dims.map(u64::from),
            dtype,
            spacing: None,
            unit: Unit::Unknown,
            skip: 0,
        }),
        ..Default::default()
    };
    let bytes = std::io::Cursor::new(stored.to_vec());
    let volume = open_stream(Box::new(bytes), "voxels", &options)?;
    let header = &volume.header;
    let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, None);
    let plan = settings.plan(&Access::forward(voxel.bytes() as u64), 0)?;
    let mut rows = Collected::default();
    run(
        Source { volume, binarizer },
        settings,
        &plan,
        &mut [&mut rows],
        &Progress::default(),
        &AtomicBool::new(false),
    )?;
    Ok(rows.0)
}

/// The places of rows, in order.
pub fn places(rows: &[SurfelBatch]) -> impl Iterator<Item = (&SurfelBatch, usize)> {
    rows.iter().flat_map(|b| (0..b.len()).map(move |i| (b, i)))
}
