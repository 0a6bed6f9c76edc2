//! The first stage: stored planes to planes of bits, in order of z.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crossbeam_channel::Sender;
use curvox_formats::{Header, Volume, Voxels};
use rayon::prelude::*;

use crate::error::Error;
use crate::volume::{Binarizer, BitPlane};

use super::run::Shared;

/// Where voxels come from, and which are inside.
pub struct Source {
    /// The open volume.
    pub volume: Volume,
    /// What is inside.
    pub binarizer: Binarizer,
}

/// What the reader learned on the way.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReadCounts {
    /// Voxels that are not a number, and so outside.
    pub nan: u64,
    /// What the format found to say after the last plane.
    pub warnings: Vec<String>,
}

/// Reads all planes and sends them in chunks.
pub(super) fn read(
    source: Source,
    shared: &Shared<'_>,
    out: Sender<Vec<Arc<BitPlane>>>,
) -> Result<ReadCounts, Error> {
    let Source { volume, binarizer } = source;
    let depth = volume.header.dims[2];
    let mut counts = ReadCounts::default();
    let mut buffer = Vec::new();
    let mut z = 0;
    let mut voxels = volume.voxels;
    while z < depth {
        if shared.stopped() {
            return Err(Error::Stopped);
        }
        let mut count = shared.plan.read_planes.min(depth - z);
        let (planes, nan) = match &mut voxels {
            Voxels::Forward(forward) => {
                // The reader's own errors say how far it came; 0 would be a broken reader.
                count = forward.read_planes(count, &mut buffer)?;
                if count == 0 {
                    return Err(curvox_formats::Error::invalid(
                        &volume.source.name,
                        format!("the voxels end after {z} planes, expected {depth}"),
                    )
                    .into());
                }
                pack(&buffer, count, &volume.header, &binarizer, shared)
            }
            Voxels::Random(random) => {
                if let Some(bytes) = random.planes(z, count)? {
                    let packed = pack(bytes, count, &volume.header, &binarizer, shared);
                    random.check()?;
                    random.release(z + count);
                    packed
                } else {
                    let [x, y, _] = volume.header.dims;
                    let region = curvox_formats::Region {
                        origin: [0, 0, z],
                        size: [x, y, count],
                    };
                    random.read_box(&region, &mut buffer)?;
                    random.release(z + count);
                    pack(&buffer, count, &volume.header, &binarizer, shared)
                }
            }
        };
        z += count;
        counts.nan += nan;
        shared.progress.planes_read.store(z, Ordering::Relaxed);
        if out.send(planes).is_err() {
            return Err(Error::Stopped);
        }
    }
    drop(out);
    match &mut voxels {
        Voxels::Forward(forward) => counts.warnings = forward.finish()?,
        Voxels::Random(random) => random.check()?,
    }
    Ok(counts)
}

/// Packs stored planes, rows in parallel.
fn pack(
    bytes: &[u8],
    count: u64,
    header: &Header,
    binarizer: &Binarizer,
    shared: &Shared<'_>,
) -> (Vec<Arc<BitPlane>>, u64) {
    let [dims_x, dims_y, _] = shared.lattice.dims;
    let row_bytes = dims_x as usize * header.voxel.bytes();
    let plane_bytes = row_bytes * dims_y as usize;
    // enough rows to be worth a task
    let rows_per_task = (1 << 16) / row_bytes.max(1) + 1;
    shared.pool.install(|| {
        let packed: Vec<_> = (0..count as usize)
            .into_par_iter()
            .map(|p| {
                let stored = &bytes[p * plane_bytes..(p + 1) * plane_bytes];
                let mut plane = BitPlane::outside(dims_x, dims_y);
                let nan: u64 = plane
                    .par_rows_mut()
                    .zip(stored.par_chunks_exact(row_bytes))
                    .with_min_len(rows_per_task)
                    .map(|(out, row)| binarizer.pack_row(row, out))
                    .sum();
                (Arc::new(plane), nan)
            })
            .collect();
        let nan = packed.iter().map(|(_, nan)| nan).sum();
        (packed.into_iter().map(|(plane, _)| plane).collect(), nan)
    })
}
