//! The first stage: stored planes to planes of bits, in order of z; where the normals are made from
//! values, the planes as stored go with them.
//!
//! A volume that is mapped or comes forward is packed some planes at a time; one that is decoded in
//! pieces, a layer of pieces at a time ([`super::layers`]). A layer is handed on in parts, and the next
//! one is read while the stages work on what they have.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use curvox_formats::{ForwardVoxels, Header, Region, Volume, Voxels};
use rayon::prelude::*;

use crate::error::Error;
use crate::volume::{Binarizer, BitPlane, GreyPlane};

use super::layers::LayerReader;
use super::shared::Shared;
use super::stats::{Clock, Wait, thread_time};

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

/// A plane of the image on its way to the normals.
#[derive(Clone, Debug)]
pub(super) struct Plane {
    pub(super) bits: Arc<BitPlane>,
    /// The plane as stored, if the normals ask for values.
    pub(super) stored: Option<Arc<GreyPlane>>,
}

/// Reads all planes and sends them in chunks.
pub(super) fn read(
    source: Source,
    shared: &Shared<'_>,
    clock: &Clock,
    out: Sender<Vec<Plane>>,
) -> Result<ReadCounts, Error> {
    let Source { volume, binarizer } = source;
    let Volume {
        header,
        voxels,
        source,
    } = volume;
    let mut counts = ReadCounts::default();
    if let (Voxels::Random(random), Some(plan)) = (&voxels, &shared.plan.chunks) {
        let mut layers =
            LayerReader::new(random.as_ref(), &header, &binarizer, shared, clock, plan);
        let mut z = 0;
        while z < header.dims[2] {
            let (planes, nan) = layers.read(z)?;
            z += planes.len() as u64;
            counts.nan += nan;
            shared.progress.planes_read.store(z, Ordering::Relaxed);
            let mut planes = planes.into_iter().peekable();
            while planes.peek().is_some() {
                let some = planes.by_ref().take(shared.plan.read_planes as usize);
                let some = some.collect();
                if shared.stopped() || clock.wait(Wait::Output, || out.send(some)).is_err() {
                    return Err(Error::Stopped);
                }
            }
            random.release(z);
        }
        random.check()?;
        return Ok(counts);
    }
    let mut packer = Packer::new(&header, &binarizer, shared, clock);
    let mut z = 0;
    let mut send = |bytes: &[u8], count: u64| {
        let (planes, nan) = packer.pack(bytes, count);
        z += count;
        counts.nan += nan;
        shared.progress.planes_read.store(z, Ordering::Relaxed);
        if shared.stopped() || clock.wait(Wait::Output, || out.send(planes)).is_err() {
            return Err(Error::Stopped);
        }
        Ok(z)
    };
    match voxels {
        Voxels::Forward(forward) => {
            let chunk = shared.plan.read_planes;
            let fetched = fetch(forward, header.dims[2], chunk, source.name);
            loop {
                match clock.wait(Wait::Input, || fetched.next(shared))? {
                    Fetched::Planes(count, bytes, time) => {
                        clock.add_work(time);
                        send(&bytes, count)?;
                        fetched.recycle(bytes);
                    }
                    Fetched::End(warnings) => {
                        counts.warnings = warnings;
                        return Ok(counts);
                    }
                }
            }
        }
        Voxels::Random(random) => {
            let [x, y, depth] = header.dims;
            let mut buffer = Vec::new();
            let mut next = 0;
            while next < depth {
                let count = shared.plan.read_planes.min(depth - next);
                if let Some(bytes) = random.planes(next, count)? {
                    // Packed first and believed after: only the check says the bytes were true.
                    let sent = send(bytes, count);
                    random.check()?;
                    next = sent?;
                } else {
                    let region = Region {
                        origin: [0, 0, next],
                        size: [x, y, count],
                    };
                    random.read_box(&region, &mut buffer)?;
                    next = send(&buffer, count)?;
                }
                random.release(next);
            }
            random.check()?;
            Ok(counts)
        }
    }
}

/// What comes from a thread that fetches planes.
enum Fetched {
    /// Planes as stored, how many, and the processor time they took.
    Planes(u64, Vec<u8>, Duration),
    /// All planes came and what follows them is sound, with warnings.
    End(Vec<String>),
}

/// The near end of a thread that fetches planes.
struct Fetching {
    full: Receiver<Result<Fetched, curvox_formats::Error>>,
    empty: Sender<Vec<u8>>,
}

/// Fetches planes ahead in a thread of its own, so that decompression overlaps with the rest.
///
/// The thread is not joined: a read from a pipe that gives nothing cannot be interrupted, and a
/// run that is asked to stop must not wait for it. It ends when its channels close.
fn fetch(mut voxels: Box<dyn ForwardVoxels>, depth: u64, chunk: u64, name: String) -> Fetching {
    let (full_out, full) = bounded(1);
    let (empty, empty_in) = bounded::<Vec<u8>>(2);
    std::thread::spawn(move || {
        let mut z = 0;
        let mut time = thread_time();
        while z < depth {
            let mut bytes = empty_in.try_recv().unwrap_or_default();
            let fetched = match voxels.read_planes(chunk.min(depth - z), &mut bytes) {
                // Readers say how far they came; 0 would be a broken reader.
                Ok(0) => Err(curvox_formats::Error::invalid(
                    &name,
                    format!("the voxels end after {z} planes, expected {depth}"),
                )),
                Ok(count) => {
                    z += count;
                    let before = std::mem::replace(&mut time, thread_time());
                    Ok(Fetched::Planes(count, bytes, time.saturating_sub(before)))
                }
                Err(error) => Err(error),
            };
            let failed = fetched.is_err();
            if full_out.send(fetched).is_err() || failed {
                return;
            }
        }
        // Nobody listens any more only if the run has ended.
        let _ = full_out.send(voxels.finish().map(Fetched::End));
    });
    Fetching { full, empty }
}

impl Fetching {
    fn next(&self, shared: &Shared<'_>) -> Result<Fetched, Error> {
        loop {
            match self.full.recv_timeout(Duration::from_millis(50)) {
                Ok(fetched) => return Ok(fetched?),
                Err(RecvTimeoutError::Timeout) if shared.stopped() => return Err(Error::Stopped),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Error::Threads("the reading thread ended early".into()));
                }
            }
        }
    }

    fn recycle(&self, bytes: Vec<u8>) {
        // A full channel means there are buffers enough.
        let _ = self.empty.try_send(bytes);
    }
}

/// Packs stored planes.
struct Packer<'a> {
    header: &'a Header,
    binarizer: &'a Binarizer,
    shared: &'a Shared<'a>,
    clock: &'a Clock,
    /// The plane without a voxel inside, which is the same wherever there is one.
    outside: Arc<BitPlane>,
    /// Words of planes that were not kept.
    spare: Vec<Vec<u64>>,
}

impl<'a> Packer<'a> {
    fn new(
        header: &'a Header,
        binarizer: &'a Binarizer,
        shared: &'a Shared<'a>,
        clock: &'a Clock,
    ) -> Self {
        let [dims_x, dims_y, _] = shared.lattice.dims;
        Self {
            header,
            binarizer,
            shared,
            clock,
            outside: Arc::new(BitPlane::outside(dims_x, dims_y)),
            spare: Vec::new(),
        }
    }

    /// Packs `count` planes, some rows a task, and counts what is not a number.
    fn pack(&mut self, bytes: &[u8], count: u64) -> (Vec<Plane>, u64) {
        let [dims_x, dims_y, _] = self.shared.lattice.dims;
        let row_bytes = dims_x as usize * self.header.voxel.bytes();
        let plane_bytes = row_bytes * dims_y as usize;
        let row_words = (dims_x as usize).div_ceil(64);
        // enough rows to be worth a task
        let task_rows = (1 << 17) / row_bytes.max(1) + 1;
        let with_values = self.shared.kernels.normals.needs_grey();
        let (binarizer, clock) = (self.binarizer, self.clock);
        let mut words: Vec<_> = (0..count)
            .map(|_| self.spare.pop())
            .map(|words| words.unwrap_or_else(|| vec![0; row_words * dims_y as usize]))
            .collect();
        let (packed, nan) = self.shared.pool.install(|| {
            let tasks = words.iter_mut().zip(bytes.chunks_exact(plane_bytes));
            let tasks: Vec<_> = tasks
                .flat_map(|(words, stored)| {
                    let rows = words.chunks_mut(task_rows * row_words);
                    rows.zip(stored.chunks(task_rows * row_bytes))
                })
                .collect();
            let nan = tasks
                .into_par_iter()
                .map(|(out, stored)| {
                    let rows = out.chunks_exact_mut(row_words);
                    let rows = rows.zip(stored.chunks_exact(row_bytes));
                    let rows = rows.map(|(out, row)| binarizer.pack_row(row, out));
                    clock.work(|| rows.sum::<u64>())
                })
                .sum();
            let packed: Vec<_> = words
                .into_par_iter()
                .zip(bytes.par_chunks_exact(plane_bytes))
                .map(|(words, stored)| {
                    clock.work(|| {
                        // A copy even of what is mapped: the map may be let go, and is only checked
                        // after it was used.
                        let stored =
                            with_values.then(|| Arc::new(GreyPlane::Rows(stored.to_vec())));
                        (BitPlane::from_rows(dims_x, words), stored)
                    })
                })
                .collect();
            (packed, nan)
        });
        let planes = packed.into_iter().map(|(plane, stored)| Plane {
            bits: if plane.is_outside() {
                self.spare.push(plane.into_words());
                Arc::clone(&self.outside)
            } else {
                Arc::new(plane)
            },
            stored,
        });
        (planes.collect(), nan)
    }
}
