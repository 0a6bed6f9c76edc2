//! What a run leaves: the surfel table, curvature slices, totals.
//!
//! Comes in: [`SurfelBatch`]es, rows of consecutive surfels in Khalimsky order (kz, then ky, then
//! kx), each within one *column* of parts. Goes out: files. Every sink
//! receives the same batches in the same order whatever the bricks, threads and budget, but the
//! batches may be cut anywhere: a sink must not let the cut of the batches show in its bytes.

mod batch;
mod columns;
mod dataset;
mod error;
mod faces;
mod given;
mod info;
mod output;
mod parquet;
mod parts;
mod read;
mod run_record;
mod single;
mod slices;
mod summary;
#[cfg(test)]
mod tests;
mod whole_file;

pub use batch::{CurvatureColumns, Flag, FlagSet, SurfelBatch};
pub use columns::ROW_GROUP_ROWS;
pub use dataset::DatasetSink;
pub use error::SinkError;
pub use faces::{
    FACES_FILE, FaceTable, FaceTableInfo, MeshSummary, NON_MANIFOLD, RADIUS_TOO_SMALL, RowStats,
    prepare_mesh_output,
};
pub use given::{GIVEN_READ_BYTES, NormalRow, NormalTable};
pub use info::{RadiusInfo, TableInfo};
pub use output::{REPORT_FILE, SLICES_DIRECTORY, SUMMARY_FILE, SURFELS_DIRECTORY, prepare_output};
pub use parts::{PART_EDGE, PART_PLANES, Parts};
pub use read::{Check, OutputInfo, RowReader};
pub use run_record::{PartRecord, RUN_FILE, RunRecord, RunRecorder, RunState};
pub use single::{STDOUT, SingleSink};
pub use slices::{Palette, SliceError, SliceMemory, SliceOptions, SliceSelection, SliceSink};
pub use summary::{
    Distribution, ExactTotals, FlagCount, HISTOGRAM_BINS, HISTOGRAM_REACH, Histogram,
    RadiusSummary, RowTotals, RunFacts, Summary, SummarySink,
};

/// A receiver of the rows of a run.
///
/// [`SurfelSink::write`] any number of times, then [`SurfelSink::finish`] once. After an error a
/// sink refuses everything, so that nothing incomplete gets a name. A sink dropped before `finish`
/// leaves what is complete (whole parts, whole slices) and removes its temporary
/// files.
pub trait SurfelSink: Send {
    /// Takes the next rows of a column of parts.
    ///
    /// # Errors
    ///
    /// If the rows cannot be written, or break the order. The sink is of no further use then.
    fn write(&mut self, batch: &SurfelBatch) -> Result<(), SinkError>;

    /// Learns that no further row of this column will have a `kz` below the given one.
    ///
    /// Calling it is never needed for the result: it lets a sink close files earlier where a
    /// column has no surfels for a while.
    ///
    /// # Errors
    ///
    /// If what is complete cannot be written.
    fn advance(&mut self, column: [u32; 2], kz: i32) -> Result<(), SinkError> {
        let _ = (column, kz);
        Ok(())
    }

    /// Learns that there are no further rows, and completes all files.
    ///
    /// # Errors
    ///
    /// If what is left cannot be written.
    fn finish(&mut self) -> Result<(), SinkError>;
}
