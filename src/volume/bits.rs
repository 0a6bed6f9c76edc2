//! Voxels as bits: planes of the image, windows of planes, boxes cut out of a window.

use std::ops::Range;
use std::sync::Arc;

use super::squares::Squares;
use super::tiles::{Content, TileMap};

/// One plane of the image, one bit a voxel, x fastest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BitPlane(Held);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Held {
    /// All rows; each starts on a word, and bits past its last voxel are zero.
    Rows {
        words: Vec<u64>,
        words_per_row: usize,
        /// None once rows were handed out to be changed.
        squares: Option<Squares>,
    },
    /// A word for each row of each tile that the map keeps.
    Tiles { map: Arc<TileMap>, words: Vec<u64> },
}

impl BitPlane {
    /// A plane of `dims_x * dims_y` voxels, all outside.
    #[must_use]
    pub fn outside(dims_x: u32, dims_y: u32) -> Self {
        let words = vec![0; (dims_x as usize).div_ceil(64) * dims_y as usize];
        Self::from_rows(dims_x, words)
    }

    /// A plane from the words of its rows; bits past the last voxel of a row must be zero.
    #[must_use]
    pub fn from_rows(dims_x: u32, words: Vec<u64>) -> Self {
        let words_per_row = (dims_x as usize).div_ceil(64);
        debug_assert!(words.len().is_multiple_of(words_per_row));
        let squares = Some(Squares::of(dims_x, &words));
        Self(Held::Rows {
            words,
            words_per_row,
            squares,
        })
    }

    /// A plane in tiles, with a word for each row of each tile that is kept; bits beyond the image
    /// are zero.
    #[must_use]
    pub fn tiled(map: Arc<TileMap>, words: Vec<u64>) -> Self {
        debug_assert_eq!(words.len(), map.tiles() as usize * map.band());
        Self(Held::Tiles { map, words })
    }

    /// What is known of parts of the plane.
    fn layer(&self) -> Option<Layer<'_>> {
        match &self.0 {
            Held::Rows { squares, .. } => squares.as_ref().map(Layer::Rows),
            Held::Tiles { map, .. } => Some(Layer::Tiles(map)),
        }
    }

    /// Whether no voxel is inside, as far as that is known without looking at them.
    #[must_use]
    pub fn is_outside(&self) -> bool {
        match &self.0 {
            Held::Rows { squares, .. } => squares.as_ref().is_some_and(Squares::are_outside),
            Held::Tiles { .. } => false,
        }
    }

    /// The words of all rows of a plane that is not in tiles, to be used again; none of a plane in tiles.
    #[must_use]
    pub fn into_words(self) -> Vec<u64> {
        match self.0 {
            Held::Rows { words, .. } => words,
            Held::Tiles { .. } => Vec::new(),
        }
    }

    /// Memory held, without that of the map of a plane in tiles.
    #[must_use]
    pub fn bytes(&self) -> usize {
        match &self.0 {
            Held::Rows { words, .. } | Held::Tiles { words, .. } => size_of_val(&words[..]),
        }
    }

    /// The words `words` of row `y`, fewer where it ends; bits past the last voxel are zero.
    #[inline]
    fn span<'a>(&'a self, y: usize, words: Range<usize>, buffer: &'a mut Vec<u64>) -> &'a [u64] {
        match &self.0 {
            Held::Rows {
                words: all,
                words_per_row,
                ..
            } => {
                let row = &all[y * words_per_row..(y + 1) * words_per_row];
                &row[words.start.min(row.len())..words.end.min(row.len())]
            }
            Held::Tiles { map, words: kept } => {
                buffer.clear();
                let (band, row) = (map.band(), map.row_in_tile(y));
                for (tiles, content) in map.row(y as u32, words.start as u32..words.end as u32) {
                    match content {
                        Content::Uniform { inside: false, .. } => {
                            buffer.resize(buffer.len() + tiles.len(), 0);
                        }
                        Content::Uniform { inside: true, .. } => {
                            buffer.extend(tiles.map(|tile| map.mask(tile)));
                        }
                        Content::Tiles(first) => buffer.extend(
                            (first as usize..first as usize + tiles.len())
                                .map(|tile| kept[tile * band + row]),
                        ),
                    }
                }
                buffer
            }
        }
    }

    /// All rows of a plane that is not in tiles, to be filled; bits past the last voxel of a row
    /// must stay zero.
    ///
    /// # Panics
    /// If the plane is in tiles.
    pub fn rows_mut(&mut self) -> std::slice::ChunksExactMut<'_, u64> {
        match &mut self.0 {
            Held::Rows {
                words,
                words_per_row,
                squares,
            } => {
                *squares = None;
                words.chunks_exact_mut(*words_per_row)
            }
            Held::Tiles { .. } => panic!("a plane in tiles is made from its words"),
        }
    }
}

/// Consecutive planes of the image, shared. Planes below 0 and from `dims[2]` on are outside.
#[derive(Clone, Debug)]
pub struct PlaneWindow {
    /// Extents of the image.
    pub dims: [u32; 3],
    /// Index of the first plane held.
    pub z0: i32,
    /// The planes held.
    pub planes: Vec<Arc<BitPlane>>,
}

impl PlaneWindow {
    /// The words `words` of row `y` of plane `z`, fewer or none where the image has ended. Of a
    /// plane in tiles they are put together in `buffer`.
    ///
    /// # Panics
    /// If the plane is part of the image but not held: a stage declared too short a reach.
    #[inline]
    #[must_use]
    pub fn span<'a>(
        &'a self,
        [y, z]: [i32; 2],
        words: Range<usize>,
        buffer: &'a mut Vec<u64>,
    ) -> &'a [u64] {
        if y < 0 || z < 0 || y >= self.dims[1] as i32 || z >= self.dims[2] as i32 {
            return &[];
        }
        let plane = self.plane(z).expect("plane within the declared reach");
        plane.span(y as usize, words, buffer)
    }

    fn plane(&self, z: i32) -> Option<&BitPlane> {
        let plane = usize::try_from(z - self.z0)
            .ok()
            .and_then(|i| self.planes.get(i));
        plane.map(|plane| &**plane)
    }

    /// Whether voxel `p` is inside; none is beyond the image.
    ///
    /// # Panics
    /// As [`Self::span`].
    #[must_use]
    pub fn inside(&self, p: [i32; 3]) -> bool {
        let Ok(x) = usize::try_from(p[0]) else {
            return false;
        };
        let mut buffer = Vec::new();
        let word = self.span([p[1], p[2]], x / 64..x / 64 + 1, &mut buffer);
        word.first().is_some_and(|word| word >> (x % 64) & 1 == 1)
    }

    /// Cuts the cells `lo <= c < hi` of the planes `z` into rectangles, each with what is known of
    /// the voxels around its cells, before any is looked at: the voxels from one before the first
    /// cell on, along each axis. `Some` says that they are all inside, or all outside. `None` says
    /// nothing; where that is known of other parts of the planes, such a rectangle is some squares
    /// beside each other of a grid of `grain` cells, which begins at `lo`.
    ///
    /// Voxels beyond the image are outside with `border`, and otherwise left out.
    pub fn rectangles(
        &self,
        lo: [i32; 2],
        hi: [i32; 2],
        z: Range<i32>,
        grain: i32,
        border: bool,
        found: &mut impl FnMut([i32; 2], [i32; 2], Option<bool>),
    ) {
        let layers = self.layers(z.start - 1..z.end, border);
        // Squares of unknown content come from left to right, and are joined as far as they touch.
        let mut joined: Option<[[i32; 2]; 2]> = None;
        self.split(&layers, [lo, hi], grain, border, &mut |lo, hi, known| {
            if known.is_some() {
                return found(lo, hi, known);
            }
            match &mut joined {
                Some([from, to]) if [to[0], from[1], to[1]] == [lo[0], lo[1], hi[1]] => {
                    to[0] = hi[0];
                }
                _ => {
                    if let Some([from, to]) = joined.replace([lo, hi]) {
                        found(from, to, None);
                    }
                }
            }
        });
        if let Some([from, to]) = joined {
            found(from, to, None);
        }
    }

    /// What is known of the planes `z`; `None` if nothing is known of one.
    fn layers(&self, z: Range<i32>, border: bool) -> Option<Layers<'_>> {
        let held = z.start.max(0)..z.end.min(self.dims[2] as i32);
        let mut planes: Vec<Layer<'_>> = Vec::new();
        for at in held.clone() {
            let layer = self.plane(at)?.layer()?;
            let again = match (planes.last(), &layer) {
                (Some(Layer::Tiles(last)), Layer::Tiles(map)) => std::ptr::eq(*last, *map),
                _ => false,
            };
            if !again {
                planes.push(layer);
            }
        }
        Some(Layers {
            planes,
            leaves: border && held != z,
        })
    }

    fn split(
        &self,
        layers: &Option<Layers<'_>>,
        [lo, hi]: [[i32; 2]; 2],
        grain: i32,
        border: bool,
        found: &mut impl FnMut([i32; 2], [i32; 2], Option<bool>),
    ) {
        if lo[0] >= hi[0] || lo[1] >= hi[1] {
            return;
        }
        let Some(known) = layers else {
            return found(lo, hi, None);
        };
        if let Some(inside) = self.known(known, lo, hi, border) {
            return found(lo, hi, Some(inside));
        }
        let squares = [0, 1].map(|a| (hi[a] - lo[a] - 1) / grain + 1);
        let axis = usize::from(squares[1] > 1);
        if squares[axis] == 1 {
            return found(lo, hi, None);
        }
        let middle = lo[axis] + squares[axis] / 2 * grain;
        let (mut to, mut from) = (hi, lo);
        to[axis] = middle;
        from[axis] = middle;
        self.split(layers, [lo, to], grain, border, found);
        self.split(layers, [from, hi], grain, border, found);
    }

    /// Whether all voxels around the cells `lo <= c < hi` are known to be inside, or outside.
    fn known(&self, layers: &Layers<'_>, lo: [i32; 2], hi: [i32; 2], border: bool) -> Option<bool> {
        let from = lo.map(|c| (c - 1).max(0));
        let to = [0, 1].map(|a| hi[a].min(self.dims[a] as i32));
        let leaves = (0..2).any(|a| from[a] != lo[a] - 1 || to[a] != hi[a]);
        let mut all = (layers.leaves || border && leaves).then_some(false);
        if from[0] < to[0] && from[1] < to[1] {
            let [x, y] = [0, 1].map(|a| from[a] as u32..to[a] as u32);
            for layer in &layers.planes {
                let here = layer.known(&x, &y)?;
                if *all.get_or_insert(here) != here {
                    return None;
                }
            }
        }
        Some(all.unwrap_or(false))
    }

    /// The planes `z` in `range` that exist, as a window of their own.
    #[must_use]
    pub fn narrowed(&self, range: std::ops::Range<i32>) -> PlaneWindow {
        let end = self.z0 + self.planes.len() as i32;
        let from = range.start.clamp(self.z0, end);
        let to = range.end.clamp(from, end);
        PlaneWindow {
            dims: self.dims,
            z0: from,
            planes: self.planes[(from - self.z0) as usize..(to - self.z0) as usize].to_vec(),
        }
    }
}

/// What is known of parts of one plane, or of planes with one map.
enum Layer<'a> {
    Rows(&'a Squares),
    Tiles(&'a TileMap),
}

impl Layer<'_> {
    /// Whether all voxels of a box are known to be inside, or outside.
    fn known(&self, x: &Range<u32>, y: &Range<u32>) -> Option<bool> {
        match self {
            Layer::Rows(squares) => squares.known(x, y),
            Layer::Tiles(map) => map.known(x, y),
        }
    }
}

/// What is known of some planes.
struct Layers<'a> {
    /// Each map once, as far as planes with the same follow each other.
    planes: Vec<Layer<'a>>,
    /// Whether planes beyond the image count, which are outside.
    leaves: bool,
}

/// A box of voxels as bits, with the outside of the image filled with zeros.
#[derive(Clone, Debug, Default)]
pub struct BitBox {
    lo: [i32; 3],
    size: [i32; 3],
    words_per_row: usize,
    words: Vec<u64>,
}

impl BitBox {
    /// Cuts the voxels `lo <= p < hi` out of a window.
    #[must_use]
    pub fn cut(window: &PlaneWindow, lo: [i32; 3], hi: [i32; 3]) -> Self {
        let size = [0, 1, 2].map(|a| hi[a] - lo[a]);
        // One word more than the voxels need lets `bits` read two words without a test.
        let words_per_row = (size[0] as usize).div_ceil(64) + 1;
        let mut words = vec![0; words_per_row * (size[1] * size[2]) as usize];
        let across = [lo[0], hi[0] + 63].map(|x| x.max(0) as usize / 64);
        // The word that the first voxel is in, among those asked for, and its bit.
        let first = lo[0].div_euclid(64) - across[0] as i32;
        let shift = lo[0].rem_euclid(64) as u32;
        let (last, room) = (words_per_row - 1, size[0] % 64);
        let mut buffer = Vec::new();
        let rows = (lo[2]..hi[2]).flat_map(|z| (lo[1]..hi[1]).map(move |y| [y, z]));
        for ([y, z], out) in rows.zip(words.chunks_exact_mut(words_per_row)) {
            let source = window.span([y, z], across[0]..across[1], &mut buffer);
            if source.is_empty() {
                continue;
            }
            let mut next = first;
            let mut fetch = || {
                let word = usize::try_from(next).ok().and_then(|i| source.get(i));
                next += 1;
                word.copied().unwrap_or(0)
            };
            let mut low = fetch();
            for word in &mut out[..last] {
                let high = fetch();
                // shifting twice makes a shift of 0 take nothing from the next word
                *word = low >> shift | (high << 1) << (63 - shift);
                low = high;
            }
            if room > 0 {
                out[last - 1] &= (1 << room) - 1;
            }
        }
        Self {
            lo,
            size,
            words_per_row,
            words,
        }
    }

    /// First voxel of the box.
    #[must_use]
    pub fn lo(&self) -> [i32; 3] {
        self.lo
    }

    /// Extents of the box.
    #[must_use]
    pub fn size(&self) -> [i32; 3] {
        self.size
    }

    /// The words of the row at `y`, `z` (image coordinates); bit 0 is the voxel `lo[0]`. The last
    /// word is a guard and holds no voxel.
    #[inline]
    #[must_use]
    pub fn row(&self, y: i32, z: i32) -> &[u64] {
        let row = ((z - self.lo[2]) * self.size[1] + (y - self.lo[1])) as usize;
        &self.words[row * self.words_per_row..(row + 1) * self.words_per_row]
    }

    /// Whether a voxel of the box is inside the solid.
    #[inline]
    #[must_use]
    pub fn inside(&self, p: [i32; 3]) -> bool {
        let x = (p[0] - self.lo[0]) as usize;
        self.row(p[1], p[2])[x / 64] >> (x % 64) & 1 == 1
    }

    /// The number of the bit of a voxel among all bits of the box, and how far the next one along each axis is.
    #[inline]
    #[must_use]
    pub fn bit(&self, p: [i32; 3]) -> (usize, [isize; 3]) {
        let [x, y, z] = [0, 1, 2].map(|a| (p[a] - self.lo[a]) as usize);
        let row = 64 * self.words_per_row;
        let plane = row * self.size[1] as usize;
        let strides = [1, row as isize, plane as isize];
        (z * plane + y * row + x, strides)
    }

    /// The bit of this number: 1 if the voxel is inside the solid.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, bit: usize) -> usize {
        (self.words[bit / 64] >> (bit % 64) & 1) as usize
    }

    /// Up to 64 voxels of a row from `x` on, bit 0 being `x`.
    #[inline]
    #[must_use]
    pub fn bits(row: &[u64], x: usize) -> u64 {
        let (at, shift) = (x / 64, x % 64);
        // shifting twice makes a shift of 0 contribute nothing from the next word
        row[at] >> shift | (row[at + 1] << 1) << (63 - shift)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Voxels half of which are inside, as they fall.
    pub(crate) fn scattered(dims: [u32; 3], mut seed: u64) -> PlaneWindow {
        let planes = (0..dims[2]).map(|_| {
            let mut plane = BitPlane::outside(dims[0], dims[1]);
            for row in plane.rows_mut() {
                for x in 0..dims[0] as usize {
                    seed =
                        (seed.wrapping_mul(6364136223846793005)).wrapping_add(1442695040888963407);
                    row[x / 64] |= (seed >> 63) << (x % 64);
                }
            }
            Arc::new(plane)
        });
        PlaneWindow {
            dims,
            z0: 0,
            planes: planes.collect(),
        }
    }

    #[test]
    fn a_box_holds_the_voxels_of_the_window_and_zeros_around() {
        let dims = [131, 5, 4];
        let inside = |x: i32, y: i32, z: i32| (x * 7 + y * 3 + z * 5 + x * y) % 3 == 0;
        let planes = (0..4)
            .map(|z| {
                let mut plane = BitPlane::outside(dims[0], dims[1]);
                for (y, row) in plane.rows_mut().enumerate() {
                    for x in 0..131 {
                        row[x / 64] |= u64::from(inside(x as i32, y as i32, z)) << (x % 64);
                    }
                }
                Arc::new(plane)
            })
            .collect();
        let window = PlaneWindow {
            dims,
            z0: 0,
            planes,
        };
        for lo in [[-3, -2, -1], [0, 0, 0], [60, 1, 2], [64, 0, 1], [126, 3, 3]] {
            let hi = [lo[0] + 75, lo[1] + 4, lo[2] + 3];
            let cut = BitBox::cut(&window, lo, hi);
            for z in lo[2]..hi[2] {
                for y in lo[1]..hi[1] {
                    for x in lo[0]..hi[0] {
                        let within =
                            (0..131).contains(&x) && (0..5).contains(&y) && (0..4).contains(&z);
                        assert_eq!(cut.inside([x, y, z]), within && inside(x, y, z));
                    }
                    let row = cut.row(y, z);
                    for x in 0..11 {
                        let bits = BitBox::bits(row, x);
                        assert_eq!(bits & 1 == 1, cut.inside([lo[0] + x as i32, y, z]));
                        assert_eq!(
                            bits >> 63 & 1 == 1,
                            cut.inside([lo[0] + x as i32 + 63, y, z])
                        );
                    }
                }
            }
        }
    }
}
