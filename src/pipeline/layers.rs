//! Planes of bits out of a volume that is decoded in pieces, a layer of planes at a time.
//!
//! ```text
//!    layer: some planes as thick as the pieces         task: a band of rows of it
//!    +------+------+------+------+
//!    | box 1 ----> | box 2 ----> |  <- band            read a box, pack its rows, next box
//!    +------+------+------+------+
//!    |      |      |      |      |  <- band, by another worker
//! ```
//!
//! Comes in: voxels anywhere, and the plan. Goes out: the planes of a layer. Guaranteed: a piece is
//! decoded once for each layer it is in; boxes end where pieces do. Where the plan has tiles,
//! voxels known to be uniform are neither read nor kept.
//!
//! Tasks run on the pool of all stages and never wait for another stage; a worker asks before each
//! box whether the run has been stopped.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use curvox_formats::{Header, RandomVoxels, Region};
use rayon::prelude::*;

use crate::error::Error;
use crate::volume::{Binarizer, BitPlane, GreyPlane, TILE_WIDTH, TileMap};

use super::chunks::ChunkPlan;
use super::reader::Plane;
use super::shared::Shared;
use super::stats::Clock;

/// Reads layers in order of z.
pub(super) struct LayerReader<'a> {
    voxels: &'a dyn RandomVoxels,
    header: &'a Header,
    binarizer: &'a Binarizer,
    shared: &'a Shared<'a>,
    clock: &'a Clock,
    plan: &'a ChunkPlan,
    /// The last layer without tiles, for those that say the same.
    uniform: Option<(Arc<TileMap>, Plane)>,
}

/// Planes of a layer while they are filled.
struct Filling {
    words: Vec<Vec<u64>>,
    /// The same planes as stored, or none.
    stored: Vec<Vec<u8>>,
}

/// A band of some planes of a layer: what to read, and where it goes.
struct Task<'a> {
    z: Range<u64>,
    rows: Range<u64>,
    columns: Vec<Range<u32>>,
    /// For each plane the words of the band.
    words: Vec<&'a mut [u64]>,
    /// The same as stored, or none.
    stored: Vec<&'a mut [u8]>,
    tiles: Option<Tiles>,
}

/// The tiles of a band, if planes are in tiles.
#[derive(Clone, Copy)]
struct Tiles {
    rows: usize,
    /// The row of a tile that the first row of the band is: not 0 where it begins before the volume.
    first_row: usize,
}

/// Buffers of a worker.
#[derive(Default)]
struct Buffers {
    stored: Vec<u8>,
    words: Vec<u64>,
}

impl<'a> LayerReader<'a> {
    pub(super) fn new(
        voxels: &'a dyn RandomVoxels,
        header: &'a Header,
        binarizer: &'a Binarizer,
        shared: &'a Shared<'a>,
        clock: &'a Clock,
        plan: &'a ChunkPlan,
    ) -> Self {
        Self {
            voxels,
            header,
            binarizer,
            shared,
            clock,
            plan,
            uniform: None,
        }
    }

    /// The layer that begins at plane `z`, and how many voxels are not a number.
    pub(super) fn read(&mut self, z: u64) -> Result<(Vec<Plane>, u64), Error> {
        let depth = self.header.dims[2];
        let end = self
            .plan
            .pieces
            .step_end(2, z, self.plan.layer_planes)
            .min(depth);
        if self.plan.tiles.is_some() {
            self.read_tiles(z..end)
        } else {
            self.read_rows(z..end)
        }
    }

    fn filling(&self, z: &Range<u64>, words: usize, voxels: usize) -> Filling {
        let count = (z.end - z.start) as usize;
        let bytes = voxels * self.header.voxel.bytes();
        let with_values = self.shared.kernels.normals.needs_grey();
        Filling {
            words: vec![vec![0; words]; count],
            stored: vec![vec![0; bytes]; if with_values { count } else { 0 }],
        }
    }

    /// Whole planes.
    fn read_rows(&self, z: Range<u64>) -> Result<(Vec<Plane>, u64), Error> {
        let [dims_x, dims_y, _] = self.shared.lattice.dims;
        let row_words = (dims_x as usize).div_ceil(64);
        let row_bytes = dims_x as usize * self.header.voxel.bytes();
        let mut filling = self.filling(
            &z,
            row_words * dims_y as usize,
            dims_x as usize * dims_y as usize,
        );
        let pieces = &self.plan.pieces;
        let mut tasks = Vec::new();
        let mut words: Vec<_> = filling.words.iter_mut().map(|p| &mut p[..]).collect();
        let mut stored: Vec<_> = filling.stored.iter_mut().map(|p| &mut p[..]).collect();
        let (mut words, mut stored) = (&mut words[..], &mut stored[..]);
        let mut from = z.start;
        while from < z.end {
            let to = pieces.step_end(2, from, pieces.shape[2]).min(z.end);
            let words = take(&mut words, (to - from) as usize);
            let count = stored.len().min(words.len());
            let stored = take(&mut stored, count);
            let mut y = 0;
            while y < u64::from(dims_y) {
                let end = pieces
                    .step_end(1, y, self.plan.band_rows)
                    .min(dims_y.into());
                let rows = (end - y) as usize;
                tasks.push(Task {
                    z: from..to,
                    rows: y..end,
                    columns: std::iter::once(0..dims_x).collect(),
                    words: words
                        .iter_mut()
                        .map(|p| take(p, rows * row_words))
                        .collect(),
                    stored: stored
                        .iter_mut()
                        .map(|p| take(p, rows * row_bytes))
                        .collect(),
                    tiles: None,
                });
                y = end;
            }
            from = to;
        }
        let nan = self.run(tasks, &z)?;
        let mut stored = filling.stored.into_iter();
        let planes = filling.words.into_iter().map(|words| Plane {
            bits: Arc::new(BitPlane::from_rows(dims_x, words)),
            stored: stored.next().map(|bytes| Arc::new(GreyPlane::Rows(bytes))),
        });
        Ok((planes.collect(), nan))
    }

    /// The tiles in which voxels can differ.
    fn read_tiles(&mut self, z: Range<u64>) -> Result<(Vec<Plane>, u64), Error> {
        let voxel_bytes = self.header.voxel.bytes();
        let map = TileMap::find(
            self.shared.lattice.dims,
            &self.plan.pieces,
            z.clone(),
            |region| {
                let mut value = self.voxels.uniform(region)?;
                value[voxel_bytes..].fill(0);
                Some(value)
            },
            |value| self.classified(value).0,
        );
        let count = (z.end - z.start) as usize;
        let nan_in_plane = |map: &TileMap| -> u64 {
            let not_numbers = map.uniform().filter(|&(_, value)| self.classified(value).1);
            not_numbers.map(|(voxels, _)| voxels).sum()
        };
        let nan = nan_in_plane(&map) * count as u64;
        if map.tiles() == 0 {
            let plane = match &self.uniform {
                Some((last, plane)) if **last == map => plane.clone(),
                _ => {
                    let map = Arc::new(map);
                    let plane = self.tiled(&map, Vec::new(), Some(Vec::new()));
                    self.uniform = Some((map, plane.clone()));
                    plane
                }
            };
            return Ok((vec![plane; count], nan));
        }
        let map = Arc::new(map);
        let rows = map.tiles() as usize * map.band();
        let mut filling = self.filling(&z, rows, rows * TILE_WIDTH as usize);
        let mut words: Vec<_> = filling.words.iter_mut().map(|p| &mut p[..]).collect();
        let mut stored: Vec<_> = filling.stored.iter_mut().map(|p| &mut p[..]).collect();
        let mut tasks = Vec::new();
        for kept in map.kept() {
            let rows = kept.tiles.len() * map.band();
            tasks.push(Task {
                z: z.clone(),
                rows: kept.rows.start.into()..kept.rows.end.into(),
                columns: kept.columns,
                words: words.iter_mut().map(|plane| take(plane, rows)).collect(),
                stored: stored
                    .iter_mut()
                    .map(|plane| take(plane, rows * TILE_WIDTH as usize * voxel_bytes))
                    .collect(),
                tiles: Some(Tiles {
                    rows: map.band(),
                    first_row: map.row_in_tile(kept.rows.start as usize),
                }),
            });
        }
        let read = self.run(tasks, &z)?;
        let mut stored = filling.stored.into_iter();
        let planes = filling
            .words
            .into_iter()
            .map(|words| self.tiled(&map, words, stored.next()));
        Ok((planes.collect(), nan + read))
    }

    fn tiled(&self, map: &Arc<TileMap>, words: Vec<u64>, stored: Option<Vec<u8>>) -> Plane {
        let stored = stored.filter(|_| self.shared.kernels.normals.needs_grey());
        Plane {
            bits: Arc::new(BitPlane::tiled(Arc::clone(map), words)),
            stored: stored.map(|bytes| {
                let map = Arc::clone(map);
                Arc::new(GreyPlane::Tiles { map, bytes })
            }),
        }
    }

    /// Whether a value is inside, and whether it is no number.
    fn classified(&self, value: [u8; 8]) -> (bool, bool) {
        let mut word = [0];
        let nan = self
            .binarizer
            .pack_row(&value[..self.header.voxel.bytes()], &mut word);
        (word != [0], nan > 0)
    }

    /// Does all tasks of a layer, as many at once as the plan says.
    fn run(&self, tasks: Vec<Task<'_>>, z: &Range<u64>) -> Result<u64, Error> {
        let total = tasks.len().max(1) as u64;
        let waiting = Mutex::new(tasks.into_iter());
        let done = AtomicU64::new(0);
        let work = |_| {
            let mut buffers = Buffers::default();
            let mut nan = 0;
            loop {
                let mut tasks = waiting.lock().unwrap_or_else(PoisonError::into_inner);
                let Some(task) = tasks.next() else {
                    return Ok(nan);
                };
                drop(tasks);
                match self.clock.work(|| self.work_on(task, &mut buffers)) {
                    Ok(found) => nan += found,
                    Err(error) => {
                        // Nobody needs the others any more.
                        let mut tasks = waiting.lock().unwrap_or_else(PoisonError::into_inner);
                        *tasks = Vec::new().into_iter();
                        return Err(error);
                    }
                }
                let part = (done.fetch_add(1, Ordering::Relaxed) + 1) * (z.end - z.start) / total;
                let read = &self.shared.progress.planes_read;
                read.fetch_max(z.start + part, Ordering::Relaxed);
            }
        };
        self.shared.pool.install(|| {
            (0..self.plan.readers)
                .into_par_iter()
                .with_max_len(1)
                .map(work)
                .try_reduce(|| 0, |a, b| Ok(a + b))
        })
    }

    /// Reads the boxes of a task, packs their rows, and gives the number of NaNs met.
    fn work_on(&self, mut task: Task<'_>, buffers: &mut Buffers) -> Result<u64, Error> {
        let width = u64::from(TILE_WIDTH);
        let mut nan = 0;
        let mut tiles_before = 0;
        for columns in task.columns.clone() {
            let columns = u64::from(columns.start)..u64::from(columns.end);
            let mut x = columns.start;
            while x < columns.end {
                if self.shared.stopped() {
                    return Err(Error::Stopped);
                }
                let wide = self.plan.box_columns;
                let end = self.plan.pieces.step_end(0, x, wide).min(columns.end);
                let rows = task.rows.end - task.rows.start;
                let region = Region {
                    origin: [x, task.rows.start, task.z.start],
                    size: [end - x, rows, task.z.end - task.z.start],
                };
                self.voxels.read_box(&region, &mut buffers.stored)?;
                let row_bytes = (end - x) as usize * self.header.voxel.bytes();
                for (i, row) in buffers.stored.chunks_exact(row_bytes).enumerate() {
                    let at = [i / rows as usize, i % rows as usize];
                    let first = (columns.start / width) as usize;
                    let place = Place {
                        x: x as usize,
                        first_word: first - tiles_before,
                    };
                    nan += self.put(&mut task, at, place, row, &mut buffers.words);
                }
                x = end;
            }
            tiles_before += (columns.end.div_ceil(width) - columns.start / width) as usize;
        }
        Ok(nan)
    }

    /// Puts a row of a box where it belongs: row `row` of the band, in plane `plane` of the task.
    fn put(
        &self,
        task: &mut Task<'_>,
        [plane, row]: [usize; 2],
        place: Place,
        stored: &[u8],
        words: &mut Vec<u64>,
    ) -> u64 {
        let voxel_bytes = self.header.voxel.bytes();
        let (first, shift) = (place.x / 64, place.x % 64);
        let count = (stored.len() / voxel_bytes).div_ceil(64);
        let dims_x = self.shared.lattice.dims[0] as usize;
        let out = &mut *task.words[plane];
        if let Some(values) = task.stored.get_mut(plane) {
            match task.tiles {
                None => {
                    let at = (row * dims_x + place.x) * voxel_bytes;
                    values[at..at + stored.len()].copy_from_slice(stored);
                }
                Some(tiles) => {
                    let row = tiles.first_row + row;
                    let tile_bytes = TILE_WIDTH as usize * voxel_bytes;
                    let mut rest = stored;
                    let (mut tile, mut x) = (first - place.first_word, shift);
                    while !rest.is_empty() {
                        let part = rest.len().min((TILE_WIDTH as usize - x) * voxel_bytes);
                        let (now, later) = rest.split_at(part);
                        let at = (tile * tiles.rows + row) * tile_bytes + x * voxel_bytes;
                        values[at..at + part].copy_from_slice(now);
                        (rest, tile, x) = (later, tile + 1, 0);
                    }
                }
            }
        }
        let row_words = dims_x.div_ceil(64);
        if shift == 0 && task.tiles.is_none() {
            let out = &mut out[row * row_words + first..][..count];
            return self.binarizer.pack_row(stored, out);
        }
        words.clear();
        words.resize(count, 0);
        let nan = self.binarizer.pack_row(stored, words);
        let mut or = |word: usize, bits: u64| {
            if bits != 0 {
                out[match task.tiles {
                    None => row * row_words + word,
                    Some(tiles) => (word - place.first_word) * tiles.rows + tiles.first_row + row,
                }] |= bits;
            }
        };
        for (i, &bits) in words.iter().enumerate() {
            or(first + i, bits << shift);
            // shifting twice makes a shift of 0 give nothing to the next word
            or(first + i + 1, (bits >> 1) >> (63 - shift));
        }
        nan
    }
}

/// Where the rows of a box belong.
#[derive(Clone, Copy)]
struct Place {
    /// First voxel.
    x: usize,
    /// The word that is in tile 0 of the band, if the tiles between were kept too.
    first_word: usize,
}

/// Takes the first `count` of a slice off it.
fn take<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, others) = std::mem::take(rest).split_at_mut(count);
    *rest = others;
    first
}
