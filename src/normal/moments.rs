//! Moments of the solid in balls of voxels, in exact integers.
//!
//! Comes in: the bits of a box, and voxels in it whose ball stays in the box. Goes out:
//! [`Moments`] about each of them: n = |X|, s = sum (q - c), S = sum (q - c)(q - c)^T over the voxels
//! X of the solid in the ball around c.
//!
//! A row of the ball is an interval along x, and the solid in a row is a list of runs: a run
//! [s, e) of positions from the centre adds, once cut to the interval,
//!
//! ```text
//!    sum 1 = e - s     sum (2x + 1) = e^2 - s^2     sum (x^2 + x) = ((e^3 - e) - (s^3 - s)) / 3
//! ```
//!
//! so no voxel is looked at. The runs of all rows in reach are found once for the voxels of
//! [`SEGMENT`] consecutive x, and laid out along y: [`LANES`] rows of a plane are one step.
//! A row that the solid crosses more often has its further runs in further layers, which the
//! whole plane then has: the time grows with the crossings in the densest row of a plane, and noise is
//! no special case.
//!
//! **Integers modulo 2^16.** Sums, differences and products modulo 2^16 are exact however often
//! something overflows, and so is a division by 3 without remainder. Only what a lane finally
//! holds must fit: the planes of the ball are taken in blocks small enough for that ([`Lane::holds`]).
//! Balls of flat voxels with very long rows are summed in 64 bits, by the same code.
//!
//! Guaranteed: exact, hence the same for every cut and on every machine.

use std::ops::{Add, Mul};

use crate::lattice::Ball;
use crate::simd::{Level, Work, dispatch};
use crate::volume::BitBox;

/// Rows of a plane summed in one step: what vectors of 256 bits hold of 16-bit numbers. With more,
/// balls of radius 3 to 7 would fill half of them.
const LANES: usize = 16;

/// Extent along x of the voxels that share the runs of their rows. With less, runs are found more
/// often than needed; with more, rows have more of them.
const SEGMENT: i32 = 16;

/// Moments of the solid in a ball about its centre, in voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Moments {
    pub(crate) count: i64,
    pub(crate) first: [i64; 3],
    /// xx, yy, zz, xy, xz, yz
    pub(crate) second: [i64; 6],
}

/// Moments in balls of one radius.
#[derive(Clone, Debug)]
pub(crate) struct MomentKernel {
    ball: Ball,
    lanes: Lanes,
}

#[derive(Clone, Debug)]
enum Lanes {
    Narrow(Vec<Column<i16>>),
    Wide(Vec<Column<i64>>),
}

impl MomentKernel {
    pub(crate) fn new(ball: Ball) -> Self {
        let lanes = match columns(&ball) {
            Some(narrow) => Lanes::Narrow(narrow),
            None => Lanes::Wide(columns(&ball).expect("64 bits hold the sums of any ball")),
        };
        Self { ball, lanes }
    }

    pub(crate) fn ball(&self) -> &Ball {
        &self.ball
    }

    /// The moments about each of `voxels`; `bits` must cover their balls.
    pub(crate) fn about(&self, bits: &BitBox, voxels: &[[i32; 3]]) -> Vec<Moments> {
        match &self.lanes {
            Lanes::Narrow(columns) => about(columns, &self.ball, bits, voxels),
            Lanes::Wide(columns) => about(columns, &self.ball, bits, voxels),
        }
    }
}

fn about<T: Lane>(
    columns: &[Column<T>],
    ball: &Ball,
    bits: &BitBox,
    voxels: &[[i32; 3]],
) -> Vec<Moments> {
    let lo = bits.lo()[0];
    let mut segments: Vec<Vec<u32>> = Vec::new();
    segments.resize_with((bits.size()[0] / SEGMENT + 1) as usize, Vec::new);
    for (i, c) in voxels.iter().enumerate() {
        segments[((c[0] - lo) / SEGMENT) as usize].push(i as u32);
    }
    let mut moments = vec![Moments::default(); voxels.len()];
    let mut runs = Runs::default();
    for members in segments.iter().filter(|members| !members.is_empty()) {
        dispatch(Segment {
            columns,
            ball,
            bits,
            voxels,
            members,
            runs: &mut runs,
            moments: &mut moments,
        });
    }
    moments
}

/// The moments about some voxels of nearly the same x.
struct Segment<'a, T> {
    columns: &'a [Column<T>],
    ball: &'a Ball,
    bits: &'a BitBox,
    voxels: &'a [[i32; 3]],
    /// Which of them.
    members: &'a [u32],
    runs: &'a mut Runs<T>,
    moments: &'a mut [Moments],
}

impl<T: Lane> Work for Segment<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<L: Level>(self) {
        let (mut from, mut to) = ([i32::MAX; 3], [i32::MIN; 3]);
        for &i in self.members {
            let c = self.voxels[i as usize];
            for a in 0..3 {
                from[a] = from[a].min(c[a]);
                to[a] = to[a].max(c[a]);
            }
        }
        let reach = self.ball.reach();
        let x0 = from[0];
        for a in 0..3 {
            from[a] -= reach[a];
            to[a] += reach[a] + 1;
        }
        self.runs.find(self.bits, from, to, x0);
        for &i in self.members {
            let [x, y, z] = self.voxels[i as usize];
            let mut m = Moments::default();
            for column in self.columns {
                let row = (y + column.dy - from[1]) as usize;
                for block in &column.blocks {
                    let sums = block.sums(
                        self.runs,
                        row,
                        (z + block.dz - from[2]) as usize,
                        T::of(i64::from(x - x0)),
                    );
                    sums.add_to(&mut m, i64::from(column.dy), i64::from(block.middle));
                }
            }
            self.moments[i as usize] = m;
        }
    }
}

/// The runs of the solid in the rows of a box.
#[derive(Debug, Default)]
struct Runs<T> {
    /// For each plane the number of its first layer; and the number of all.
    first: Vec<usize>,
    /// Numbers in a layer: one for each row and some to read past the last.
    stride: usize,
    /// Of the run of each layer and row, its first position; an empty run is at 0.
    starts: Vec<T>,
    /// One past its last position.
    ends: Vec<T>,
}

impl<T: Lane> Runs<T> {
    /// Finds the runs of the voxels `from <= p < to`, at positions from `x0`.
    #[inline(always)]
    fn find(&mut self, bits: &BitBox, from: [i32; 3], to: [i32; 3], x0: i32) {
        self.stride = (to[1] - from[1]) as usize + LANES;
        self.first.clear();
        self.starts.clear();
        self.ends.clear();
        let width = to[0] - from[0];
        let at = (from[0] - bits.lo()[0]) as usize;
        for z in from[2]..to[2] {
            let base = self.starts.len();
            self.first.push(base / self.stride);
            for y in from[1]..to[1] {
                let words = bits.row(y, z);
                let row = base + (y - from[1]) as usize;
                // Where the next run goes; where the last one ends.
                let (mut slot, mut last) = (row, i32::MIN);
                let mut done = 0;
                while done < width {
                    let length = (width - done).min(64);
                    let window = BitBox::bits(words, at + done as usize);
                    let mut rest = window & (!0 >> (64 - length));
                    let origin = from[0] - x0 + done;
                    let mut passed = 0;
                    while rest != 0 {
                        let gap = rest.trailing_zeros();
                        rest >>= gap;
                        let run = rest.trailing_ones();
                        // twice, since a run may be the whole word
                        rest = rest >> (run - 1) >> 1;
                        let start = origin + (passed + gap) as i32;
                        passed += gap + run;
                        let end = origin + passed as i32;
                        if start == last {
                            // It goes on from the word before.
                            self.ends[slot - self.stride] = T::of(i64::from(end));
                        } else {
                            if slot >= self.starts.len() {
                                let layers = self.starts.len() + self.stride;
                                self.starts.resize(layers, T::of(0));
                                self.ends.resize(layers, T::of(0));
                            }
                            self.starts[slot] = T::of(i64::from(start));
                            self.ends[slot] = T::of(i64::from(end));
                            slot += self.stride;
                        }
                        last = end;
                    }
                    done += length;
                }
            }
        }
        self.first.push(self.starts.len() / self.stride);
    }
}

/// [`LANES`] consecutive rows of each plane of a ball.
#[derive(Clone, Debug)]
struct Column<T> {
    /// Displacement of the first row along y.
    dy: i32,
    /// All planes that have rows here.
    blocks: Vec<Block<T>>,
}

/// Some consecutive planes of a column.
#[derive(Clone, Debug)]
struct Block<T> {
    /// Displacement of the first plane along z.
    dz: i32,
    /// Of a plane in their middle, about which they are summed.
    middle: i32,
    /// For each plane the first position and one past the last, of each row; equal where the ball
    /// has no row.
    planes: Vec<[[T; LANES]; 2]>,
}

/// The columns of a ball; none if its rows are too long for the integers.
fn columns<T: Lane>(ball: &Ball) -> Option<Vec<Column<T>>> {
    let [_, ry, rz] = ball.reach();
    let half_widths = |dy: i32, dz: i32| -> [Option<i32>; LANES] {
        std::array::from_fn(|lane| {
            let used = ball.metric.squared([0, dy + lane as i32, dz]);
            ball.half_width(0, used)
        })
    };
    let middle = |from: i32, to: i32| (from + to).div_euclid(2);
    let mut columns = Vec::new();
    for dy in (-ry..=ry).step_by(LANES) {
        let mut blocks: Vec<Block<T>> = Vec::new();
        let mut widths: Vec<[Option<i32>; LANES]> = Vec::new();
        for dz in -rz..=rz {
            let plane = half_widths(dy, dz);
            if plane.iter().all(Option::is_none) {
                continue;
            }
            let bounds = [0, 1].map(|side| {
                plane.map(|w| {
                    let w = w.map(i64::from);
                    T::of(w.map_or(0, |w| if side == 0 { -w } else { w + 1 }))
                })
            });
            widths.push(plane);
            if let Some(block) = blocks.last_mut()
                && T::holds(&widths, middle(block.dz, dz) - block.dz)
            {
                block.middle = middle(block.dz, dz);
                block.planes.push(bounds);
            } else {
                widths = vec![plane];
                if !T::holds(&widths, 0) {
                    return None;
                }
                blocks.push(Block {
                    dz,
                    middle: dz,
                    planes: vec![bounds],
                });
            }
        }
        columns.push(Column { dy, blocks });
    }
    Some(columns)
}

/// What a block adds, about its first row and its middle plane: sums over its voxels of the solid.
struct Sums<W> {
    /// of 1, j, j^2, with j the number of the row
    n: [W; 3],
    /// of z, z j
    z: [W; 2],
    zz: W,
    /// of 2x + 1, (2x + 1) j
    q: [W; 2],
    /// of (2x + 1) z
    qz: W,
    /// of x^2 + x
    xx: W,
}

impl<T: Lane> Block<T> {
    /// Sums about a voxel whose first row here is `row`, in the planes from `plane` on, at position `x`.
    #[inline(always)]
    fn sums(&self, runs: &Runs<T>, row: usize, plane: usize, x: T) -> Sums<T::Wide> {
        let zero = [T::of(0); LANES];
        // Of n and of 2x + 1: sums, and sums of those after each plane, which weigh a plane with
        // the number k of planes from it to the last.
        let (mut n, mut nk, mut nkk) = (zero, zero, zero);
        let (mut q, mut qk) = (zero, zero);
        let mut cubes = zero;
        for (bounds, layers) in self.planes.iter().zip(runs.first[plane..].windows(2)) {
            let [low, high] = bounds;
            for layer in layers[0]..layers[1] {
                let at = layer * runs.stride + row;
                let starts: &[T; LANES] = lanes(&runs.starts, at);
                let ends: &[T; LANES] = lanes(&runs.ends, at);
                for j in 0..LANES {
                    let s = starts[j].minus(x).max(low[j]);
                    let e = ends[j].minus(x).min(high[j]).max(s);
                    let (ss, ee) = (s.times(s), e.times(e));
                    n[j] = n[j].plus(e.minus(s));
                    q[j] = q[j].plus(ee.minus(ss));
                    cubes[j] = cubes[j].plus(ee.times(e).minus(ss.times(s)));
                }
            }
            for j in 0..LANES {
                nk[j] = nk[j].plus(n[j]);
                nkk[j] = nkk[j].plus(nk[j]);
                qk[j] = qk[j].plus(q[j]);
            }
        }
        // z = last - k
        let last = T::of(self.planes.len() as i64 - i64::from(self.middle - self.dz));
        let [mut z, mut zz, mut qz, mut xx] = [zero; 4];
        for j in 0..LANES {
            z[j] = last.times(n[j]).minus(nk[j]);
            // The squares of k: k^2 = 2 (k (k + 1) / 2) - k.
            let kk = nkk[j].plus(nkk[j]).minus(nk[j]);
            zz[j] = last.times(z[j].minus(nk[j])).plus(kk);
            qz[j] = last.times(q[j]).minus(qk[j]);
            xx[j] = cubes[j].minus(n[j]).third();
        }
        let (n, zz, xx) = (unsigned(&n), unsigned(&zz), unsigned(&xx));
        let (z, q, qz) = (signed(&z), signed(&q), signed(&qz));
        Sums {
            n: [sum(&n, 0), sum(&n, 1), sum(&n, 2)],
            z: [sum(&z, 0), sum(&z, 1)],
            zz: sum(&zz, 0),
            q: [sum(&q, 0), sum(&q, 1)],
            qz: sum(&qz, 0),
            xx: sum(&xx, 0),
        }
    }
}

#[inline(always)]
fn unsigned<T: Lane>(values: &[T; LANES]) -> [T::Wide; LANES] {
    let mut wide = [T::Wide::from(0); LANES];
    for j in 0..LANES {
        wide[j] = values[j].unsigned();
    }
    wide
}

#[inline(always)]
fn signed<T: Lane>(values: &[T; LANES]) -> [T::Wide; LANES] {
    let mut wide = [T::Wide::from(0); LANES];
    for j in 0..LANES {
        wide[j] = values[j].signed();
    }
    wide
}

/// The sum of values times the powers of their numbers.
#[inline(always)]
fn sum<W: Wide>(values: &[W; LANES], power: u32) -> W {
    let mut total = W::from(0);
    for j in 0..LANES {
        total = total + values[j] * W::from((j as i32).pow(power));
    }
    total
}

impl<W: Wide> Sums<W> {
    /// Adds these sums to moments, with the displacements of what they are about.
    #[inline(always)]
    fn add_to(&self, m: &mut Moments, dy: i64, dz: i64) {
        let [n, nj, njj] = self.n.map(Into::into);
        let [nz, nzj] = self.z.map(Into::into);
        let [q, qj] = self.q.map(Into::into);
        let (nzz, qz, xx): (i64, i64, i64) = (self.zz.into(), self.qz.into(), self.xx.into());
        // sums of x, x j, x z
        let (x, xj, xz) = ((q - n) / 2, (qj - nj) / 2, (qz - nz) / 2);
        m.count += n;
        m.first[0] += x;
        m.first[1] += dy * n + nj;
        m.first[2] += dz * n + nz;
        m.second[0] += xx - x;
        m.second[1] += dy * (dy * n + 2 * nj) + njj;
        m.second[2] += dz * (dz * n + 2 * nz) + nzz;
        m.second[3] += dy * x + xj;
        m.second[4] += dz * x + xz;
        m.second[5] += dy * (dz * n + nz) + dz * nj + nzj;
    }
}

#[inline(always)]
fn lanes<T>(of: &[T], at: usize) -> &[T; LANES] {
    of[at..at + LANES].try_into().expect("as many as asked")
}

/// Integers that do not overflow.
trait Wide: Copy + From<i32> + Into<i64> + Add<Output = Self> + Mul<Output = Self> {}

impl Wide for i32 {}
impl Wide for i64 {}

/// Integers modulo a power of two. Comparisons are those of signed numbers.
trait Lane: Copy + Default + Ord {
    /// Holds sums over [`LANES`] lanes, with weights up to [`LANES`] squared.
    type Wide: Wide;

    /// A number modulo the power.
    fn of(value: i64) -> Self;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    /// The third of a multiple of 3.
    fn third(self) -> Self;
    fn signed(self) -> Self::Wide;
    fn unsigned(self) -> Self::Wide;

    /// Whether the sums of any solid fit in planes of these half-widths, about plane `middle`.
    fn holds(planes: &[[Option<i32>; LANES]], middle: i32) -> bool;
}

impl Lane for i16 {
    type Wide = i32;

    #[inline(always)]
    fn of(value: i64) -> Self {
        value as i16
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.wrapping_add(other)
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.wrapping_sub(other)
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.wrapping_mul(other)
    }
    #[inline(always)]
    fn third(self) -> Self {
        // 3 * 0xAAAB = 1 modulo 2^16
        self.wrapping_mul(0xAAAB_u16 as i16)
    }
    #[inline(always)]
    fn signed(self) -> i32 {
        i32::from(self)
    }
    #[inline(always)]
    fn unsigned(self) -> i32 {
        i32::from(self as u16)
    }

    fn holds(planes: &[[Option<i32>; LANES]], middle: i32) -> bool {
        (0..LANES).all(|lane| {
            // The largest sums: of 1, z^2, x^2 + x; of z on one side; of 2x + 1; of (2x + 1) z.
            let (mut count, mut zz, mut xx) = (0i64, 0i64, 0i64);
            let mut z_beside = [0i64; 2];
            let (mut q, mut qz) = (0i64, 0i64);
            for (plane, widths) in planes.iter().enumerate() {
                let Some(w) = widths[lane].map(i64::from) else {
                    continue;
                };
                // Positions from another centre of the segment are cut in the same integers.
                if w >= i64::from(i16::MAX / 4) {
                    return false;
                }
                let z = plane as i64 - i64::from(middle);
                let n = 2 * w + 1;
                count += n;
                zz += z * z * n;
                xx += w * (w + 1) * n / 3;
                z_beside[usize::from(z < 0)] += z.abs() * n;
                q += (w + 1) * (w + 1);
                qz += z.abs() * (w + 1) * (w + 1);
            }
            let signed = i64::from(i16::MAX);
            let unsigned = i64::from(u16::MAX);
            [count, zz, xx].iter().all(|&sum| sum <= unsigned)
                && [z_beside[0], z_beside[1], q, qz]
                    .iter()
                    .all(|&sum| sum <= signed)
        })
    }
}

impl Lane for i64 {
    type Wide = i64;

    #[inline(always)]
    fn of(value: i64) -> Self {
        value
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.wrapping_add(other)
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.wrapping_sub(other)
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.wrapping_mul(other)
    }
    #[inline(always)]
    fn third(self) -> Self {
        // 3 * 0xAAAA_AAAA_AAAA_AAAB = 1 modulo 2^64
        self.wrapping_mul(0xAAAA_AAAA_AAAA_AAAB_u64 as i64)
    }
    #[inline(always)]
    fn signed(self) -> i64 {
        self
    }
    #[inline(always)]
    fn unsigned(self) -> i64 {
        self
    }

    /// Displacements are at most 63 * 256, so that even the sum of their squares over a whole
    /// cube fits.
    fn holds(_: &[[Option<i32>; LANES]], _: i32) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Lattice;
    use crate::volume::{BitPlane, PlaneWindow};
    use proptest::prelude::*;
    use std::sync::Arc;

    fn window(dims: [u32; 3], inside: impl Fn([i32; 3]) -> bool) -> PlaneWindow {
        let planes = (0..dims[2])
            .map(|z| {
                let mut plane = BitPlane::outside(dims[0], dims[1]);
                for (y, row) in plane.rows_mut().enumerate() {
                    for x in 0..dims[0] as usize {
                        let bit = inside([x as i32, y as i32, z as i32]);
                        row[x / 64] |= u64::from(bit) << (x % 64);
                    }
                }
                Arc::new(plane)
            })
            .collect();
        PlaneWindow {
            dims,
            z0: 0,
            planes,
        }
    }

    /// A number for each voxel that depends on it in no simple way.
    fn scattered([x, y, z]: [i32; 3], seed: u64) -> u64 {
        let mut s = (x as u64) << 42 ^ (y as u64) << 21 ^ z as u64 ^ seed << 50;
        for _ in 0..3 {
            s = s
                .wrapping_add(0x9E37_79B9_7F4A_7C15)
                .wrapping_mul(0xBF58_476D_1CE4_E5B9);
            s ^= s >> 31;
        }
        s
    }

    /// By looking at every voxel of the ball.
    fn counted(ball: &Ball, bits: &BitBox, c: [i32; 3]) -> Moments {
        let mut m = Moments::default();
        let r = ball.reach();
        for z in -r[2]..=r[2] {
            for y in -r[1]..=r[1] {
                for x in -r[0]..=r[0] {
                    let d = [x, y, z];
                    if ball.contains(d) && bits.inside([0, 1, 2].map(|a| c[a] + d[a])) {
                        let d = d.map(i64::from);
                        m.count += 1;
                        for a in 0..3 {
                            m.first[a] += d[a];
                            m.second[a] += d[a] * d[a];
                        }
                        m.second[3] += d[0] * d[1];
                        m.second[4] += d[0] * d[2];
                        m.second[5] += d[1] * d[2];
                    }
                }
            }
        }
        m
    }

    /// Compares the moments about `voxels` with counting; gives whether they took 16 bits.
    fn check(window: &PlaneWindow, spacing: [f64; 3], radius: f64, voxels: &[[i32; 3]]) -> bool {
        let lattice = Lattice::new(window.dims.map(u64::from), spacing, false).unwrap();
        let kernel = MomentKernel::new(lattice.metric().voxel_ball(radius).unwrap());
        let r = kernel.ball().reach();
        let least = |a: usize| voxels.iter().map(|c| c[a]).min().unwrap();
        let most = |a: usize| voxels.iter().map(|c| c[a]).max().unwrap();
        let lo = [0, 1, 2].map(|a| least(a) - r[a]);
        let hi = [0, 1, 2].map(|a| most(a) + r[a] + 1);
        let bits = BitBox::cut(window, lo, hi);
        for (c, m) in voxels.iter().zip(kernel.about(&bits, voxels)) {
            assert_eq!(
                m,
                counted(kernel.ball(), &bits, *c),
                "about {c:?}, radius {radius}"
            );
        }
        matches!(kernel.lanes, Lanes::Narrow(_))
    }

    #[test]
    fn balls_of_every_size_and_shape_are_summed_exactly() {
        let dims = [150, 19, 18];
        let voxels = [[75, 4, 4], [1, 0, 7], [149, 18, 0], [76, 9, 8], [90, 9, 8]];
        let solids: [fn([i32; 3]) -> bool; 4] = [
            |p| scattered(p, 1) & 1 == 1,
            |p| scattered(p, 2) & 31 != 0,
            |_| true,
            |[x, y, z]| 2 * x + 5 * y - 3 * z > 170,
        ];
        for inside in solids {
            let window = window(dims, inside);
            for (radius, spacing, narrow) in [
                (0.5, [1.0; 3], true),
                (3.0, [1.0; 3], true),
                (12.0, [1.0; 3], true),
                (16.97, [1.0; 3], true),
                (23.0, [1.0; 3], true),
                (31.0, [1.0; 3], true),
                (45.0, [1.0; 3], true),
                (50.0, [1.0; 3], false),
                (2.5, [1.0, 0.6, 0.8], true),
                (5.0, [0.1, 1.0, 0.9], false),
                (4.0, [1.0, 0.03, 0.2], true),
                (3.0, [0.9, 1.0, 0.02], true),
                (3.0, [0.01, 1.0, 1.0], false),
            ] {
                assert_eq!(check(&window, spacing, radius, &voxels), narrow, "{radius}");
            }
        }
    }

    /// The largest sums: a half-space through the centre along any two axes, and all of the ball.
    #[test]
    fn no_solid_overflows_a_lane() {
        let dims = [131; 3];
        let voxels = [[65; 3]];
        let solids: [fn([i32; 3]) -> bool; 7] = [
            |_| true,
            |[x, _, _]| x >= 65,
            |[x, _, _]| x < 65,
            |[_, _, z]| z >= 65,
            |[_, _, z]| z < 65,
            |[x, _, z]| (x >= 65) == (z >= 65),
            |[x, _, z]| (x >= 65) == (z < 65),
        ];
        for inside in solids {
            let window = window(dims, inside);
            for radius in 1..=46 {
                check(&window, [1.0; 3], f64::from(radius), &voxels);
            }
            check(&window, [1.0; 3], 63.0, &voxels);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn moments_are_those_of_counting_voxels(
            seed in 0..1000u64,
            density in 1..64u64,
            radius in 0.5..9.0f64,
            edges in [0.2..1.0f64, 0.2..1.0f64, 0.2..1.0f64],
            cubic: bool,
            voxels in prop::collection::vec([0..70i32, 0..20i32, 0..20i32], 1..40),
        ) {
            let window = window([70, 20, 20], |p| scattered(p, seed) % 64 < density);
            check(&window, if cubic { [1.0; 3] } else { edges }, radius, &voxels);
        }
    }
}
