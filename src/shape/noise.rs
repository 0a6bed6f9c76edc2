//! The noise of the papers: voxels near the boundary flip, the nearer the likelier.
//!
//! Lachaud, Romon, Thibert, *Corrected curvature measures*, section 6.1.6, after Kanungo et al.: a
//! voxel at discrete distance delta of its nearest boundary point (at least 1) changes phase with
//! probability p^delta. Here delta is made precise: **the Euclidean distance, in voxels, from the
//! centre of the voxel to the nearest centre of a voxel of the other phase**, in the image without
//! noise. It is 1 for a voxel that has a surfel. Voxels count as cubes whatever the spacing, and
//! outside the image there is no phase.
//!
//! DGtal's `KanungoNoise` documents this same p^delta and measures the same delta, but computes
//! p^(1 + delta): at a boundary voxel it flips with probability p^2. To compare with its pictures,
//! note that no p gives the same law (p^(1 + delta) falls as p^delta, from a lower start).
//!
//! **In:** planes of voxels in increasing z, each asked for once, 0 outside and anything else
//! inside: a [`Digitisation`](super::Digitisation), a file, a pipe. **Out:** the same planes with
//! noise, 0 or 1.
//!
//! **Guaranteed:** the noise of a voxel depends on p, the seed, its index (x, y, z) and the phases
//! around it alone: the same bytes for any range of planes, any thread count, any machine. A
//! voxel's draw does not depend on p: a voxel that flips at p flips at every larger p.
//!
//! **Not guaranteed:** flips rarer than 1e-9. A voxel whose p^delta is smaller never flips, so the
//! window of planes held in memory, one bit a voxel, ends at [`Noise::reach`] planes on each side:
//! 9 for p = 0.1, 29 for p = 0.5, 196 for p = 0.9.

use super::ShapeError;
use rayon::prelude::*;
use std::collections::VecDeque;
use std::ops::Range;

/// The largest probability: above it the window of planes would grow without bound.
pub const MAX_NOISE: f64 = 0.9;

/// The smallest probability of a flip that is drawn. Larger, the law would be cut visibly in an
/// image of 1e9 voxels; smaller, the window of planes grows for flips nobody will see.
const RAREST: f64 = 1e-9;

/// Draws are whole numbers below 2^53.
const DRAW_BITS: u32 = 53;

/// The law of a noise: its probability and seed.
#[derive(Debug, Clone)]
pub struct Noise {
    seed: u64,
    /// At d2 - 1: a draw below it flips a voxel of squared distance d2. Decreasing.
    thresholds: Vec<u64>,
    reach: usize,
    /// (dy, dz) of the rows within reach, the nearest first.
    rows: Vec<(i32, i32)>,
}

impl Noise {
    /// Noise of probability `p` at delta = 1. `p` = 0 changes nothing.
    ///
    /// # Errors
    /// If `p` is not from 0 to [`MAX_NOISE`].
    pub fn new(p: f64, seed: u64) -> Result<Self, ShapeError> {
        if !(0.0..=MAX_NOISE).contains(&p) {
            return Err(ShapeError::NoiseProbability {
                value: p,
                limit: MAX_NOISE,
            });
        }
        let mut thresholds = Vec::new();
        // libm's pow, not the system's: the same thresholds everywhere.
        for d2 in 1_u32.. {
            let probability = libm::pow(p, f64::from(d2).sqrt());
            if probability < RAREST {
                break;
            }
            // At most 2^53: exact.
            thresholds.push((probability * (1_u64 << DRAW_BITS) as f64).ceil() as u64);
        }
        let reach = thresholds.len().isqrt();
        // At most 197, by MAX_NOISE and RAREST.
        let r = reach as i32;
        let mut rows: Vec<(i32, i32)> = (-r..=r)
            .flat_map(|dz| (-r..=r).map(move |dy| (dy, dz)))
            .filter(|(dy, dz)| dy * dy + dz * dz <= r * r)
            .collect();
        rows.sort_by_key(|&(dy, dz)| (dy * dy + dz * dz, dz, dy));
        Ok(Noise {
            seed,
            thresholds,
            reach,
            rows,
        })
    }

    /// How many planes on each side the noise of a plane depends on (and rows, and columns).
    pub fn reach(&self) -> usize {
        self.reach
    }

    /// The number below 2^53 drawn for a voxel, given the key of its row.
    fn draw(row_key: u64, x: usize) -> u64 {
        scramble(row_key ^ x as u64) >> (u64::BITS - DRAW_BITS)
    }

    fn row_key(&self, y: usize, z: usize) -> u64 {
        scramble(scramble(scramble(self.seed) ^ z as u64) ^ y as u64)
    }

    /// The largest squared distance at which a voxel of this draw flips; 0 if it never does.
    fn flip_distance2(&self, draw: u64) -> usize {
        match self.thresholds.first() {
            Some(&first) if draw < first => self.thresholds.partition_point(|&t| draw < t),
            _ => 0,
        }
    }
}

/// The finaliser of SplitMix64 (Steele, Lea, Flood, *Fast splittable pseudorandom number
/// generators*, 2014) after one step of its counter: a bijection that mixes all bits.
pub(super) fn scramble(counter: u64) -> u64 {
    let z = counter.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A plane at one bit a voxel, each row in whole words.
struct BitPlane {
    words: Vec<u64>,
    /// For each row, the phase all its voxels have, if they have the same.
    uniform: Vec<Option<bool>>,
}

impl BitPlane {
    fn pack(plane: &[u8], nx: usize) -> Self {
        let mut words = Vec::with_capacity(plane.len() / nx * nx.div_ceil(64));
        let mut uniform = Vec::with_capacity(plane.len() / nx);
        for row in plane.chunks_exact(nx) {
            let mut inside = 0;
            for voxels in row.chunks(64) {
                let mut word = 0;
                for (bit, &voxel) in voxels.iter().enumerate() {
                    word |= u64::from(voxel != 0) << bit;
                }
                inside += word.count_ones() as usize;
                words.push(word);
            }
            uniform.push(match inside {
                0 => Some(false),
                n if n == nx => Some(true),
                _ => None,
            });
        }
        BitPlane { words, uniform }
    }

    /// Whether row `y` has a voxel of phase other than `phase` in the columns `from..=to`.
    fn has_other(
        &self,
        y: usize,
        words_per_row: usize,
        phase: bool,
        from: usize,
        to: usize,
    ) -> bool {
        if let Some(same) = self.uniform[y] {
            return same != phase;
        }
        let row = &self.words[y * words_per_row..(y + 1) * words_per_row];
        let same = if phase { u64::MAX } else { 0 };
        let (first, last) = (from / 64, to / 64);
        for (i, word) in row[first..=last].iter().enumerate() {
            let mut other = word ^ same;
            if i == 0 {
                other &= u64::MAX << (from % 64);
            }
            if first + i == last {
                other &= u64::MAX >> (63 - to % 64);
            }
            if other != 0 {
                return true;
            }
        }
        false
    }

    fn voxel(&self, x: usize, y: usize, words_per_row: usize) -> bool {
        self.words[y * words_per_row + x / 64] >> (x % 64) & 1 == 1
    }
}

/// Planes with noise, made from planes without, in one pass forward.
///
/// It holds a window of 2 [`Noise::reach`] + 1 planes at one bit a voxel, and one plane of bytes.
pub struct NoisyPlanes<F> {
    noise: Noise,
    dims: [usize; 3],
    source: F,
    window: VecDeque<BitPlane>,
    /// z of the first plane in `window`.
    window_start: usize,
    /// z of the next plane to give, and where to stop.
    planes: Range<usize>,
    scratch: Vec<u8>,
}

impl<F> NoisyPlanes<F> {
    /// The planes `planes` of an image of `dims` voxels.
    ///
    /// `source(z, out)` overwrites `out` with plane z of the image without noise, x fastest, 0 for
    /// outside. It is called once for each plane within reach of `planes`, in increasing order, and
    /// only as [`Self::next_plane`] needs it.
    ///
    /// # Panics
    /// If `planes` does not lie in `0..dims[2]`, or a plane has no voxel.
    pub fn new<E>(noise: Noise, dims: [usize; 3], planes: Range<usize>, source: F) -> Self
    where
        F: FnMut(usize, &mut Vec<u8>) -> Result<(), E>,
    {
        assert!(
            planes.start <= planes.end && planes.end <= dims[2],
            "planes {planes:?} of {}",
            dims[2]
        );
        assert!(dims[0] > 0 && dims[1] > 0, "planes without voxels");
        NoisyPlanes {
            window_start: planes.start.saturating_sub(noise.reach),
            noise,
            dims,
            source,
            window: VecDeque::new(),
            planes,
            scratch: Vec::new(),
        }
    }

    /// Overwrites `out` with the next plane, 0 outside and 1 inside, and returns its z; `None` after
    /// the last one.
    ///
    /// # Errors
    /// Those of the source. Asking again then asks the source for the same plane again.
    ///
    /// # Panics
    /// If the source gives a plane that has not `dims[0] * dims[1]` voxels.
    pub fn next_plane<E>(&mut self, out: &mut Vec<u8>) -> Result<Option<usize>, E>
    where
        F: FnMut(usize, &mut Vec<u8>) -> Result<(), E>,
    {
        let Some(z) = self.planes.clone().next() else {
            return Ok(None);
        };
        let [nx, ny, nz] = self.dims;
        let reach = self.noise.reach;
        while self.window_start + reach < z {
            self.window.pop_front();
            self.window_start += 1;
        }
        loop {
            let next = self.window_start + self.window.len();
            if next >= nz || next > z + reach {
                break;
            }
            (self.source)(next, &mut self.scratch)?;
            assert_eq!(self.scratch.len(), nx * ny, "voxels in plane {next}");
            self.window.push_back(BitPlane::pack(&self.scratch, nx));
        }
        out.clear();
        out.resize(nx * ny, 0);
        let this = &*self;
        let view = Window {
            noise: &this.noise,
            dims: this.dims,
            planes: &this.window,
            start: this.window_start,
        };
        out.par_chunks_exact_mut(nx)
            .enumerate()
            .for_each(|(y, row)| view.noisy_row(y, z, row));
        self.planes.start += 1;
        Ok(Some(z))
    }
}

/// What the rows of one plane share while they are made, on any thread.
struct Window<'a> {
    noise: &'a Noise,
    dims: [usize; 3],
    planes: &'a VecDeque<BitPlane>,
    start: usize,
}

impl Window<'_> {
    fn noisy_row(&self, y: usize, z: usize, row: &mut [u8]) {
        let words_per_row = self.dims[0].div_ceil(64);
        let plane = &self.planes[z - self.start];
        let key = self.noise.row_key(y, z);
        for (x, voxel) in row.iter_mut().enumerate() {
            let phase = plane.voxel(x, y, words_per_row);
            let distance2 = self.noise.flip_distance2(Noise::draw(key, x));
            // Most voxels stop here: the draw alone says that they keep their phase.
            let flips = distance2 > 0 && self.has_other_within(distance2, phase, [x, y, z]);
            *voxel = u8::from(phase != flips);
        }
    }

    /// Whether a voxel of the other phase lies within a squared distance.
    fn has_other_within(&self, distance2: usize, phase: bool, [x, y, z]: [usize; 3]) -> bool {
        let [nx, ny, nz] = self.dims;
        let words_per_row = nx.div_ceil(64);
        for &(dy, dz) in &self.noise.rows {
            let row2 = (dy * dy + dz * dz).unsigned_abs() as usize;
            if row2 > distance2 {
                break;
            }
            let (Some(y), Some(z)) = (
                y.checked_add_signed(dy as isize),
                z.checked_add_signed(dz as isize),
            ) else {
                continue;
            };
            if y >= ny || z >= nz {
                continue;
            }
            let half_width = (distance2 - row2).isqrt();
            let (from, to) = (x.saturating_sub(half_width), (x + half_width).min(nx - 1));
            let plane = &self.planes[z - self.start];
            if plane.has_other(y, words_per_row, phase, from, to) {
                return true;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Digitisation, Goursat, Grid, ImplicitShape};
    use super::*;
    use std::convert::Infallible;

    /// The planes `range` of an image, with noise.
    fn noisy(noise: &Noise, dims: [usize; 3], image: &[u8], range: Range<usize>) -> Vec<u8> {
        let size = dims[0] * dims[1];
        let mut asked = range.start.saturating_sub(noise.reach());
        let last = (range.end + noise.reach()).min(dims[2]);
        let mut planes = NoisyPlanes::new(noise.clone(), dims, range.clone(), |z, out| {
            assert_eq!(z, asked, "planes are asked for once and in order");
            assert!(z < last);
            asked += 1;
            out.clear();
            out.extend_from_slice(&image[z * size..(z + 1) * size]);
            Ok::<(), Infallible>(())
        });
        let (mut all, mut plane) = (Vec::new(), Vec::new());
        for expected in range {
            let Ok(z) = planes.next_plane(&mut plane);
            assert_eq!(z, Some(expected));
            all.extend_from_slice(&plane);
        }
        let Ok(end) = planes.next_plane(&mut plane);
        assert_eq!(end, None);
        all
    }

    fn image_of<S: ImplicitShape>(shape: S, gridstep: f64) -> ([usize; 3], Vec<u8>) {
        let digitisation = Digitisation::new(shape, Grid::cubic(gridstep)).unwrap();
        let (mut image, mut plane) = (Vec::new(), Vec::new());
        for z in 0..digitisation.dims()[2] {
            digitisation.plane(z, &mut plane);
            image.extend_from_slice(&plane);
        }
        (digitisation.dims(), image)
    }

    #[test]
    fn noise_is_what_its_definition_says_voxel_by_voxel() {
        // Rows longer than a word, and blobs of both phases.
        let dims = [70, 7, 8];
        let image: Vec<u8> = (0..dims.iter().product::<usize>())
            .map(|i| u8::from(scramble((i / 23) as u64 ^ 5).is_multiple_of(3)) * 7)
            .collect();
        let indices: Vec<[usize; 3]> = (0..image.len())
            .map(|i| [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]])
            .collect();
        let distance2 = |a: [usize; 3], b: [usize; 3]| -> usize {
            (0..3).map(|k| a[k].abs_diff(b[k]).pow(2)).sum()
        };
        let nearest2: Vec<usize> = (0..image.len())
            .map(|i| {
                let others = (0..image.len()).filter(|&j| (image[j] == 0) != (image[i] == 0));
                others
                    .map(|j| distance2(indices[i], indices[j]))
                    .min()
                    .unwrap()
            })
            .collect();
        assert!(nearest2.iter().any(|&d2| d2 > 4));
        for p in [0.05, 0.3, 0.6] {
            let noise = Noise::new(p, 42).unwrap();
            let result = noisy(&noise, dims, &image, 0..dims[2]);
            for (i, [x, y, z]) in indices.iter().copied().enumerate() {
                let draw = Noise::draw(noise.row_key(y, z), x) as f64 / 2f64.powi(53);
                let flips = draw < p.powf((nearest2[i] as f64).sqrt());
                let expected = u8::from((image[i] != 0) != flips);
                assert_eq!(result[i], expected, "p {p}, voxel ({x}, {y}, {z})");
            }
        }
    }

    #[test]
    fn the_cut_into_ranges_of_planes_does_not_show() {
        let (dims, image) = image_of(Goursat, 0.5);
        let noise = Noise::new(0.5, 7).unwrap();
        let whole = noisy(&noise, dims, &image, 0..dims[2]);
        for cuts in [
            vec![0, 1, 2, 25, 51],
            vec![0, 26, 26, 51],
            (0..=51).collect(),
        ] {
            let pieces: Vec<u8> = cuts
                .windows(2)
                .flat_map(|cut| noisy(&noise, dims, &image, cut[0]..cut[1]))
                .collect();
            assert!(pieces == whole, "{cuts:?}");
        }
    }

    #[test]
    fn thread_count_does_not_show() {
        let (dims, image) = image_of(Goursat, 0.5);
        let noise = Noise::new(0.4, 3).unwrap();
        let whole = noisy(&noise, dims, &image, 0..dims[2]);
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            assert!(pool.install(|| noisy(&noise, dims, &image, 0..dims[2])) == whole);
        }
    }

    #[test]
    fn flips_at_depth_delta_have_rate_p_to_the_delta() {
        // A half space: the voxel of column x is at distance 32 - x or x - 31 of the other phase.
        let dims = [64, 100, 100];
        let row: Vec<u8> = (0..64).map(|x| u8::from(x < 32)).collect();
        let image = row.repeat(dims[1] * dims[2]);
        for p in [0.1, 0.5] {
            let result = noisy(&Noise::new(p, 1).unwrap(), dims, &image, 0..dims[2]);
            for delta in 1..=5 {
                for (x, side) in [(32 - delta, "inside"), (31 + delta, "outside")] {
                    let count = 10_000;
                    let flips = (0..count)
                        .filter(|i| result[i * 64 + x] != image[x])
                        .count();
                    let mean = f64::from(count as u32) * p.powi(delta as i32);
                    let deviation = (flips as f64 - mean) / mean.sqrt();
                    assert!(
                        deviation.abs() < 4.0,
                        "p {p} {side} {delta}: {flips} for {mean}"
                    );
                }
            }
        }
    }

    #[test]
    fn draws_of_neighbours_and_seeds_are_unrelated() {
        let noises = [9, 10].map(|seed| Noise::new(0.5, seed).unwrap());
        let flipped = |seed: usize, x: usize, y: usize, z: usize| {
            Noise::draw(noises[seed].row_key(y, z), x) >> 52
        };
        let count = 4000;
        for step in [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]] {
            let equal = (0..count)
                .filter(|&i| {
                    let (x, y, z) = (i % 20, i / 20 % 20, i / 400);
                    flipped(0, x, y, z) == flipped(step[3], x + step[0], y + step[1], z + step[2])
                })
                .count();
            // 5 deviations of 31.6
            assert!(equal.abs_diff(count / 2) < 160, "{step:?}: {equal}");
        }
    }

    #[test]
    fn zero_changes_nothing_and_more_noise_keeps_the_flips_of_less() {
        let (dims, image) = image_of(Goursat, 1.0);
        let with = |p| noisy(&Noise::new(p, 11).unwrap(), dims, &image, 0..dims[2]);
        assert_eq!(with(0.0), image);
        let (less, more) = (with(0.2), with(0.5));
        let flips = |noisy: &[u8]| noisy.iter().zip(&image).filter(|(a, b)| a != b).count();
        assert!(0 < flips(&less) && flips(&less) < flips(&more));
        for i in 0..image.len() {
            assert!(less[i] == image[i] || more[i] != image[i]);
        }
    }

    #[test]
    fn an_image_of_one_phase_keeps_it() {
        for voxel in [0, 1] {
            let image = vec![voxel; 20 * 20 * 20];
            let noise = Noise::new(0.9, 1).unwrap();
            assert_eq!(noisy(&noise, [20; 3], &image, 0..20), image);
        }
    }

    #[test]
    fn reach_is_what_the_page_says_and_probabilities_out_of_range_are_errors() {
        for (p, reach) in [(0.0, 0), (1e-10, 0), (0.1, 9), (0.5, 29), (0.9, 196)] {
            assert_eq!(Noise::new(p, 0).unwrap().reach(), reach, "p = {p}");
        }
        for p in [-0.1, 0.95, 1.0, f64::NAN, f64::INFINITY] {
            let error = Noise::new(p, 0).unwrap_err();
            assert!(matches!(error, ShapeError::NoiseProbability { .. }));
        }
    }

    #[test]
    fn an_error_of_the_source_comes_out_and_can_be_tried_again() {
        let noise = Noise::new(0.1, 0).unwrap();
        let mut broken = true;
        let mut planes = NoisyPlanes::new(noise, [4, 4, 4], 0..4, |z, out: &mut Vec<u8>| {
            if z == 2 && std::mem::take(&mut broken) {
                return Err("plane 2 is damaged");
            }
            out.clear();
            out.resize(16, 1);
            Ok(())
        });
        let mut plane = Vec::new();
        assert_eq!(planes.next_plane(&mut plane), Err("plane 2 is damaged"));
        assert_eq!(planes.next_plane(&mut plane), Ok(Some(0)));
        assert_eq!(plane, [1; 16]);
    }
}
