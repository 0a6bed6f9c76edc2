//! Where a layer of planes holds voxels that differ, known before any voxel is read.
//!
//! A layer is cut into *tiles*, [`TILE_WIDTH`] voxels wide and a *band* of rows high, through all
//! its planes. Comes in: a source that knows of boxes in which all voxels are the same. Goes out: a
//! [`TileMap`], which tells for each tile that it is uniform, and with which value, or gives it a
//! number under which its voxels are kept.
//!
//! ```text
//!            tiles along x
//!   band 0   . . . . . . . . . .     one run of uniform tiles, which bands 0 and 1 share
//!   band 1   . . . . . . . . . .
//!   band 2   . . 0 1 2 . . . . .     three runs: uniform, tiles 0 to 2, uniform
//!   band 3   . . 3 # # 4 . . . .     five runs
//! ```
//!
//! Guaranteed: a map takes memory by its runs, not by its extents, and is found with as many
//! questions as the runs take to be closed in on by halving.

use std::ops::Range;

use curvox_formats::{RandomVoxels, Region};

/// Voxels of a tile along x: a word of bits.
pub const TILE_WIDTH: u32 = 64;

/// Rows of a band, if pieces are lower: tiles are about as high as they are wide.
const BAND_ROWS: u64 = 64;

/// Planes of a layer in tiles, if pieces are thinner, and at most. Thicker layers have more tiles
/// in which voxels differ; thinner ones ask the source more often.
const TILED_PLANES: Range<u64> = 16..128;

/// The pieces in which a volume is decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PieceGrid {
    /// Extents of a piece.
    pub shape: [u64; 3],
    /// Voxels of the first piece that lie before the volume.
    pub before: [u64; 3],
}

impl PieceGrid {
    /// The pieces of a source, if it has any.
    #[must_use]
    pub fn of(voxels: &dyn RandomVoxels) -> Option<Self> {
        let shape = voxels.chunk()?.map(|n| n.max(1));
        let before = voxels.chunk_start();
        Some(Self {
            shape,
            before: [0, 1, 2].map(|a| before[a] % shape[a]),
        })
    }

    /// Rows of a band, which ends where pieces do. The first band may have fewer, those that
    /// lie before the volume.
    #[must_use]
    pub fn band_rows(&self, dims: [u64; 3]) -> u64 {
        let rows = self.shape[1].saturating_mul(BAND_ROWS.div_ceil(self.shape[1]));
        rows.min(dims[1] + self.before[1])
    }

    /// Planes of a layer in tiles.
    #[must_use]
    pub fn tiled_planes(&self) -> u64 {
        let thickness = self.shape[2];
        if thickness < TILED_PLANES.start {
            thickness * TILED_PLANES.start.div_ceil(thickness)
        } else {
            thickness.min(TILED_PLANES.end)
        }
    }

    /// Where the step of at most `most` voxels along an axis that begins at `from` ends: where
    /// pieces do, if it can.
    #[must_use]
    pub fn step_end(&self, axis: usize, from: u64, most: u64) -> u64 {
        let (piece, before) = (self.shape[axis], self.before[axis]);
        let from = from + before;
        let end = if most >= piece {
            (from / piece)
                .saturating_add(most / piece)
                .saturating_mul(piece)
        } else {
            (from + most).min((from / piece + 1).saturating_mul(piece))
        };
        end - before
    }
}

/// What a run of tiles holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Voxels that are all the same.
    Uniform {
        /// The stored value, in the first bytes.
        value: [u8; 8],
        /// Whether it is inside.
        inside: bool,
    },
    /// Voxels that are kept, from the tile of this number on.
    Tiles(u32),
}

/// Tiles of a band from `first` to the next run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Run {
    first: u32,
    content: Content,
}

/// Bands from `first` to the next entry, which have the runs from `run` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Bands {
    first: u32,
    run: u32,
}

/// The tiles of a layer of planes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileMap {
    dims: [u32; 2],
    /// Rows of a band.
    band: u32,
    /// Rows of the first band that lie before the volume.
    before: u32,
    bands: Vec<Bands>,
    runs: Vec<Run>,
    tiles: u32,
}

/// The tiles of a band whose voxels are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BandTiles {
    /// Rows of the band.
    pub rows: Range<u32>,
    /// The voxels along x of each run of tiles.
    pub columns: Vec<Range<u32>>,
    /// Numbers of the tiles, which follow each other.
    pub tiles: Range<u32>,
}

impl TileMap {
    /// Finds the tiles of planes `z`. `uniform` gives the value of a box, if it has only one and
    /// that is known; `inside` tells whether a value is inside.
    #[must_use]
    pub fn find(
        dims: [u32; 3],
        pieces: &PieceGrid,
        z: Range<u64>,
        uniform: impl Fn(&Region) -> Option<[u8; 8]>,
        inside: impl Fn([u8; 8]) -> bool,
    ) -> Self {
        // Extents fit 32 bits, and a piece that is longer counts as far as the volume goes.
        let band = pieces.band_rows(dims.map(u64::from)) as u32;
        let before = pieces.before[1] as u32;
        let dims = [dims[0], dims[1]];
        let mut map = Self {
            dims,
            band,
            before,
            bands: Vec::new(),
            runs: Vec::new(),
            tiles: 0,
        };
        let content = |x: Range<u32>, bands: Range<u32>| {
            let row = |band_number: u32| (band_number * band).saturating_sub(before);
            let lo = [x.start * TILE_WIDTH, row(bands.start)];
            let hi = [x.end * TILE_WIDTH, row(bands.end)];
            let size = [0, 1].map(|a| u64::from(hi[a].min(dims[a]) - lo[a]));
            let region = Region {
                origin: [lo[0].into(), lo[1].into(), z.start],
                size: [size[0], size[1], z.end - z.start],
            };
            uniform(&region).map(|value| Content::Uniform {
                value,
                inside: inside(value),
            })
        };
        map.split_bands(0..(dims[1] + before).div_ceil(band), &content);
        map
    }

    fn split_bands(
        &mut self,
        bands: Range<u32>,
        content: &impl Fn(Range<u32>, Range<u32>) -> Option<Content>,
    ) {
        let across = self.dims[0].div_ceil(TILE_WIDTH);
        let run = self.runs.len() as u32;
        let count = bands.end - bands.start;
        if let Some(content) = content(0..across, bands.clone()) {
            let only = Run { first: 0, content };
            let repeated = self
                .bands
                .last()
                .is_some_and(|last| self.runs[last.run as usize..] == [only]);
            if !repeated {
                self.bands.push(Bands {
                    first: bands.start,
                    run,
                });
                self.runs.push(only);
            }
        } else if count > 1 {
            let middle = bands.start + count / 2;
            self.split_bands(bands.start..middle, content);
            self.split_bands(middle..bands.end, content);
        } else {
            self.bands.push(Bands {
                first: bands.start,
                run,
            });
            self.split_columns(run as usize, 0..across, &|x| content(x, bands.clone()));
        }
    }

    /// Adds the runs of one band, which begin at `from`.
    fn split_columns(
        &mut self,
        from: usize,
        x: Range<u32>,
        content: &impl Fn(Range<u32>) -> Option<Content>,
    ) {
        let count = x.end - x.start;
        let found = match content(x.clone()) {
            Some(content) => content,
            None if count == 1 => Content::Tiles(self.tiles),
            None => {
                let middle = x.start + count / 2;
                self.split_columns(from, x.start..middle, content);
                self.split_columns(from, middle..x.end, content);
                return;
            }
        };
        let goes_on = match (self.runs[from..].last(), found) {
            (Some(last), Content::Uniform { .. }) => last.content == found,
            (Some(last), Content::Tiles(_)) => matches!(last.content, Content::Tiles(_)),
            (None, _) => false,
        };
        if !goes_on {
            self.runs.push(Run {
                first: x.start,
                content: found,
            });
        }
        if matches!(found, Content::Tiles(_)) {
            self.tiles += 1;
        }
    }

    /// Rows of a tile.
    #[must_use]
    pub fn band(&self) -> usize {
        self.band as usize
    }

    /// The row of its tile that row `y` is.
    #[must_use]
    pub fn row_in_tile(&self, y: usize) -> usize {
        (y + self.before as usize) % self.band as usize
    }

    /// The first row of a band that is in the volume.
    fn first_row(&self, band: u32) -> u32 {
        (band * self.band).saturating_sub(self.before)
    }

    /// Number of tiles whose voxels are kept.
    #[must_use]
    pub fn tiles(&self) -> u32 {
        self.tiles
    }

    /// Memory of the map.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        (self.bands.len() * size_of::<Bands>() + self.runs.len() * size_of::<Run>()) as u64
    }

    /// Tiles along x.
    fn across(&self) -> u32 {
        self.dims[0].div_ceil(TILE_WIDTH)
    }

    /// The bits of a tile's row that are voxels of the image.
    #[must_use]
    pub fn mask(&self, tile: u32) -> u64 {
        match self.dims[0] - tile * TILE_WIDTH {
            voxels if voxels < TILE_WIDTH => (1 << voxels) - 1,
            _ => !0,
        }
    }

    /// Number of the entry that holds row `y`.
    fn entry(&self, y: u32) -> usize {
        let band = (y + self.before) / self.band;
        self.bands.partition_point(|b| b.first <= band) - 1
    }

    fn runs_of(&self, entry: usize) -> &[Run] {
        let end = self
            .bands
            .get(entry + 1)
            .map_or(self.runs.len(), |next| next.run as usize);
        &self.runs[self.bands[entry].run as usize..end]
    }

    /// The runs of row `y` that meet the tiles `x`, cut to them: their tiles and what they hold.
    pub fn row(&self, y: u32, x: Range<u32>) -> impl Iterator<Item = (Range<u32>, Content)> + '_ {
        let runs = self.runs_of(self.entry(y));
        let first = runs.partition_point(|run| run.first <= x.start).max(1) - 1;
        let across = self.across();
        (first..runs.len())
            .map(move |i| {
                let end = runs.get(i + 1).map_or(across, |next| next.first);
                let from = runs[i].first.max(x.start);
                let content = match runs[i].content {
                    Content::Tiles(number) => Content::Tiles(number + from - runs[i].first),
                    uniform => uniform,
                };
                (from..end.min(x.end), content)
            })
            .take_while(|(x, _)| !x.is_empty())
    }

    /// The bands that keep voxels, in order.
    pub fn kept(&self) -> impl Iterator<Item = BandTiles> + '_ {
        (0..self.bands.len()).filter_map(|entry| {
            let runs = self.runs_of(entry);
            let across = self.across();
            let mut columns = Vec::new();
            let mut tiles: Option<Range<u32>> = None;
            for (i, run) in runs.iter().enumerate() {
                let Content::Tiles(number) = run.content else {
                    continue;
                };
                let end = runs.get(i + 1).map_or(across, |next| next.first);
                columns.push(run.first * TILE_WIDTH..(end * TILE_WIDTH).min(self.dims[0]));
                let from = tiles.map_or(number, |tiles| tiles.start);
                tiles = Some(from..number + (end - run.first));
            }
            let band = self.bands[entry].first;
            Some(BandTiles {
                rows: self.first_row(band)..self.first_row(band + 1).min(self.dims[1]),
                columns,
                tiles: tiles?,
            })
        })
    }

    /// The uniform boxes of the layer: their voxels in a plane, and their value.
    pub fn uniform(&self) -> impl Iterator<Item = (u64, [u8; 8])> + '_ {
        (0..self.bands.len()).flat_map(move |entry| {
            let runs = self.runs_of(entry);
            let end = self
                .bands
                .get(entry + 1)
                .map_or(self.dims[1], |next| self.first_row(next.first));
            let rows = u64::from(end - self.first_row(self.bands[entry].first));
            runs.iter().enumerate().filter_map(move |(i, run)| {
                let end = runs.get(i + 1).map_or(self.across(), |next| next.first);
                let columns = (end * TILE_WIDTH).min(self.dims[0]) - run.first * TILE_WIDTH;
                match run.content {
                    Content::Uniform { value, .. } => Some((rows * u64::from(columns), value)),
                    Content::Tiles(_) => None,
                }
            })
        })
    }

    /// Whether the voxels of columns `x` and rows `y`, which must not be empty, are all inside
    /// or all outside; `None` if the map does not tell.
    #[must_use]
    pub fn known(&self, x: &Range<u32>, y: &Range<u32>) -> Option<bool> {
        self.common(x, y, |_, inside| inside)
    }

    /// The value of all voxels of columns `x` and rows `y`, which must not be empty, if the map
    /// tells that there is only one.
    #[must_use]
    pub fn value(&self, x: &Range<u32>, y: &Range<u32>) -> Option<[u8; 8]> {
        self.common(x, y, |value, _| value)
    }

    fn common<K: PartialEq>(
        &self,
        x: &Range<u32>,
        y: &Range<u32>,
        key: impl Fn([u8; 8], bool) -> K,
    ) -> Option<K> {
        let x = x.start / TILE_WIDTH..(x.end - 1) / TILE_WIDTH + 1;
        let mut all = None;
        for entry in self.entry(y.start)..=self.entry(y.end - 1) {
            let first_row = self.first_row(self.bands[entry].first);
            for (_, content) in self.row(first_row, x.clone()) {
                let Content::Uniform { value, inside } = content else {
                    return None;
                };
                let here = key(value, inside);
                match &all {
                    None => all = Some(here),
                    Some(other) if *other == here => {}
                    Some(_) => return None,
                }
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Boxes of 5 x 7 voxels, each with one of two values, or with voxels that differ.
    fn value(seed: u64, x: u64, y: u64) -> Option<u8> {
        let mut hash = (x / 5 * 31 + y / 7)
            .wrapping_add(seed)
            .wrapping_mul(0x9e37_79b9_7f4a_7c15);
        hash ^= hash >> 29;
        [None, Some(0), Some(0), Some(0), Some(1)]
            [(hash.wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as usize % 5]
    }

    fn uniform(seed: u64, region: &Region) -> Option<[u8; 8]> {
        let mut all = None;
        for y in region.origin[1]..region.origin[1] + region.size[1] {
            for x in region.origin[0]..region.origin[0] + region.size[0] {
                let here = value(seed, x, y)?;
                if *all.get_or_insert(here) != here {
                    return None;
                }
            }
        }
        all.map(|v| [v, 0, 0, 0, 0, 0, 0, 0])
    }

    proptest! {
        #[test]
        fn a_map_tells_of_each_voxel_what_the_source_knows(
            seed: u64,
            dims in [1u32..400, 1u32..200],
            piece in 1u64..90,
            before in 0u64..90,
        ) {
            let pieces = PieceGrid {
                shape: [10, piece, 4],
                before: [3, before % piece, 2],
            };
            let before = pieces.before[1] as u32;
            let map = TileMap::find(
                [dims[0], dims[1], 9], &pieces, 0..3, |r| uniform(seed, r), |v| v[0] == 1,
            );
            let band = map.band() as u32;
            let mut numbers = Vec::new();
            for y in 0..dims[1] {
                let mut next = 0;
                for (x, content) in map.row(y, 0..dims[0].div_ceil(64)) {
                    prop_assert_eq!(x.start, next);
                    next = x.end;
                    for tile in x.clone() {
                        let in_band = (y + before) / band;
                        let lo = [tile * 64, (in_band * band).saturating_sub(before)];
                        let hi = [
                            (lo[0] + 64).min(dims[0]),
                            ((in_band + 1) * band - before).min(dims[1]),
                        ];
                        let region = Region {
                            origin: [lo[0].into(), lo[1].into(), 0],
                            size: [(hi[0] - lo[0]).into(), (hi[1] - lo[1]).into(), 3],
                        };
                        let known = uniform(seed, &region);
                        match content {
                            Content::Uniform { value, inside } => {
                                prop_assert_eq!(known, Some(value));
                                prop_assert_eq!(inside, value[0] == 1);
                            }
                            Content::Tiles(number) => {
                                prop_assert_eq!(known, None);
                                if y == lo[1] {
                                    numbers.push(number + tile - x.start);
                                }
                            }
                        }
                        let part = map.known(&(lo[0]..hi[0]), &(y..y + 1));
                        prop_assert_eq!(part, known.map(|v| v[0] == 1));
                    }
                }
                prop_assert_eq!(next, dims[0].div_ceil(64));
            }
            prop_assert_eq!(numbers, (0..map.tiles()).collect::<Vec<_>>());
            let kept: u64 = map.kept().flat_map(|b| {
                let rows = u64::from(b.rows.end - b.rows.start);
                b.columns.into_iter().map(move |x| rows * u64::from(x.end - x.start))
            }).sum();
            let same: u64 = map.uniform().map(|(n, _)| n).sum();
            prop_assert_eq!(kept + same, u64::from(dims[0]) * u64::from(dims[1]));
            let counted: u32 = map.kept().map(|b| b.tiles.end - b.tiles.start).sum();
            prop_assert_eq!(counted, map.tiles());
        }
    }
}
