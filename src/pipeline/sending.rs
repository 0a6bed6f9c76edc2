//! The last stage: rows of planes of cells on their way to the sinks, by columns of parts.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::atomic::Ordering;

use crossbeam_channel::{Receiver, Sender};

use crate::brick::{BrickGrid, SlabWindow};
use crate::error::Error;
use crate::sink::{Parts, SinkError, SurfelBatch, SurfelSink};
use crate::surfel::CellBox;

use super::plan::COLUMN_BYTES;
use super::rows::{self, BrickRows};
use super::shared::Shared;
use super::stages::MeasureSlab;
use super::stats::{Clock, Wait};

/// What goes to the sinks.
pub(super) enum Rows {
    /// Rows of one plane of cells and column of parts.
    Batch(Box<SurfelBatch>),
    /// All rows below this plane of cells have been sent.
    Passed(i32),
}

/// The columns of parts that the bricks of a slab meet, in order, and the cells of each.
pub(super) fn columns_of(
    shared: &Shared<'_>,
    grid: &BrickGrid,
    numbers: &[usize],
) -> BTreeMap<[u32; 2], [Range<i32>; 2]> {
    let edge = crate::sink::PART_EDGE as i32;
    let last = Parts::new(shared.lattice.dims).columns().map(|n| n - 1);
    let mut columns = BTreeMap::new();
    for &number in numbers {
        let core = grid.core(number, &(0..1));
        // The last column takes the cells beyond the image, which own surfels of its border.
        let [x, y] = [0, 1].map(|a| {
            let of = |cell: i32| ((cell / edge) as u32).min(last[a]);
            of(core.lo[a])..=of(core.hi[a] - 1)
        });
        for cy in y {
            for cx in x.clone() {
                columns.entry([cy, cx]).or_insert_with(|| {
                    let column = [cx, cy];
                    [0, 1].map(|a| {
                        let lo = column[a] as i32 * edge;
                        let past = if column[a] == last[a] {
                            grid.cell_dims[a]
                        } else {
                            lo + edge
                        };
                        lo..past
                    })
                });
            }
        }
    }
    columns
}

/// Sends the rows of one plane of cells, column by column of the parts.
pub(super) fn send_plane(
    shared: &Shared<'_>,
    grid: &BrickGrid,
    window: &SlabWindow<MeasureSlab>,
    computed: &[BrickRows],
    columns: &BTreeMap<[u32; 2], [Range<i32>; 2]>,
    plane: i32,
    clock: &Clock,
    out: &Sender<Rows>,
) -> Result<(), ()> {
    let send = |rows| clock.wait(Wait::Output, || out.send(rows)).map_err(|_| ());
    for ([cy, cx], [x, y]) in columns {
        let cells = CellBox {
            lo: [x.start, y.start, plane],
            hi: [x.end, y.end, plane + 1],
        };
        let mut runs = Vec::new();
        window.for_each_run(
            grid,
            cells,
            |_, _, _| true,
            |_, at, run| runs.push((at, run)),
        );
        if runs.is_empty() {
            continue;
        }
        let count = runs.iter().map(|(_, run)| run.len()).sum();
        let mut batch = rows::empty_batch(shared, [*cx, *cy], count);
        for (at, run) in runs {
            computed[at].append_to(&mut batch, run, shared);
        }
        send(Rows::Batch(Box::new(batch)))?;
    }
    send(Rows::Passed(plane + 1))
}

/// Last stage: hands the rows to the sinks.
pub(super) fn sink(
    shared: &Shared<'_>,
    clock: &Clock,
    sink_clocks: &[Clock],
    input: Receiver<Rows>,
    sound: &Receiver<()>,
    sinks: &mut [&mut dyn SurfelSink],
) -> Result<(), Error> {
    fn each(
        sinks: &mut [&mut dyn SurfelSink],
        clocks: &[Clock],
        mut work: impl FnMut(&mut dyn SurfelSink) -> Result<(), SinkError>,
    ) -> Result<(), SinkError> {
        let mut clocked = sinks.iter_mut().zip(clocks);
        clocked.try_for_each(|(sink, clock)| clock.stage(|| work(*sink)))
    }
    let parts = Parts::new(shared.lattice.dims);
    // Columns with rows in a layer of parts. It is closed before the next one begins, so that only
    // columns of one layer are open.
    let mut open = BTreeSet::new();
    let mut layer = 0;
    let mut planes = 0;
    while let Ok(rows) = clock.wait(Wait::Input, || input.recv()) {
        if shared.stopped() {
            return Err(Error::Stopped);
        }
        match rows {
            Rows::Batch(batch) => {
                open.insert(batch.column);
                let more = (open.len() as u64).saturating_sub(shared.plan.open_columns);
                if more > 0 {
                    return Err(Error::TooScattered {
                        plane: planes as i32,
                        what: format!("{} columns of parts have rows", open.len()),
                        needed_bytes: shared.plan.memory_bytes + 8 * more * COLUMN_BYTES,
                    });
                }
                each(sinks, sink_clocks, |sink| sink.write(&batch))?;
                shared
                    .progress
                    .rows_done
                    .fetch_add(batch.len() as u64, Ordering::Relaxed);
            }
            Rows::Passed(plane) => {
                planes = plane as u64;
                shared.progress.planes_done.store(planes, Ordering::Relaxed);
                let kz = 2 * plane;
                if parts.layer_of(kz) > layer {
                    layer = parts.layer_of(kz);
                    for column in std::mem::take(&mut open) {
                        each(sinks, sink_clocks, |sink| sink.advance(column, kz))?;
                    }
                }
            }
        }
    }
    if shared.stopped() || planes != shared.lattice.cell_dims()[2] as u64 {
        return Err(Error::Stopped);
    }
    // A checksum behind the last plane can still be wrong.
    if clock.wait(Wait::Input, || sound.recv()).is_err() {
        return Err(Error::Stopped);
    }
    each(sinks, sink_clocks, |sink| sink.finish())?;
    Ok(())
}
