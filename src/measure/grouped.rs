//! Sums of lumped measures over the balls around groups of surfels.
//!
//! Comes in: the surface of a box, lumped measures, which surfels are asked for. Goes out: for each the
//! sums of weight times measure over C(p) or W(p), as integers, in blocks ([`GroupBlock`]).
//!
//! Surfels of one block share their [`Vicinity`]. Of each of them against each candidate a loop over
//! vectors computes the weights; then the eight measures of a candidate, which are one vector or two or four, are multiplied by the weights
//! of several members at once and added to as many sums.
//!
//! Exact, so that no order shows: weights are integers of at most 16 binary digits, measures integers in double precision, and
//! sums are moved to wider integers before they could reach 2^53.

use crate::lattice::Ball;
use crate::simd::{LANES, Level, rounded};
use crate::surfel::squares::{Boxes, Cubes, Squares};
use crate::surfel::vicinity::{Candidates, Groups, Sort, Vicinity};
use crate::surfel::{Blocks, Rim};

use super::ball::Extent;
use super::cells::{Lumped, mark};
use super::fixed;
use super::mixture::{Each, TOGETHER};
use super::surface::Surface;

/// A weight of 1.
pub(super) const WEIGHT_ONE: f64 = 32768.0;

/// Candidates whose weights are computed at once.
const CHUNK: usize = 128;

/// Members of a group that are summed at once, at most.
const MOST_MEMBERS: usize = 8;

/// How the weights fall with the distance.
#[derive(Clone, Copy, Debug)]
pub(super) enum Falloff {
    /// 1 in the ball.
    Sharp,
    /// (1 - t)(1 - 2t) and 1 - t, with t the squared distance in units of these.
    Compensated([f64; 2]),
}

/// What is summed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Task<'a> {
    pub(super) surface: &'a Surface,
    pub(super) ball: &'a Ball,
    pub(super) extent: Extent,
    pub(super) falloff: Falloff,
    pub(super) lumped: &'a [Lumped],
    pub(super) omega: &'a [i64],
    pub(super) marks: &'a [u8],
    /// The surfels asked for.
    pub(super) starts: &'a [usize],
}

/// Sums around up to [`TOGETHER`] surfels, of weight times measure, by weight and measure, rounded once; see [`Falloff::unit`].
/// What follows the first `count` means nothing.
#[derive(Clone, Debug)]
pub(super) struct GroupBlock {
    pub(super) count: usize,
    /// Which of the surfels asked for it is.
    pub(super) number: Each<u32>,
    pub(super) measures: [[Each<f64>; 8]; 2],
    pub(super) omega: [Each<f64>; 2],
    pub(super) rim: Each<Rim>,
    pub(super) several_sheets: Each<bool>,
    /// Some surfel that was summed is [`mark::NEAR_CUT`].
    pub(super) near_cut: Each<bool>,
    /// How many were summed, at least 1, and how many of these are ridges.
    pub(super) summed: Each<f64>,
    pub(super) ridges: Each<f64>,
}

impl GroupBlock {
    /// Nothing.
    pub(super) fn new() -> Self {
        Self {
            count: 0,
            number: [0; TOGETHER],
            measures: [[[0.0; TOGETHER]; 8]; 2],
            omega: [[0.0; TOGETHER]; 2],
            rim: [Rim::CLOSED; TOGETHER],
            several_sheets: [false; TOGETHER],
            near_cut: [false; TOGETHER],
            summed: [1.0; TOGETHER],
            ridges: [0.0; TOGETHER],
        }
    }
}

/// Added and taken away again, it leaves the nearest integer, halves to even.
const ROUNDING: f64 = 1.5 * (1u64 << 52) as f64;

/// Binary digits that measures lose to have room for weights.
const DROPPED: f64 = 16384.0;

impl Falloff {
    /// What one in the sums is, of one in the measures.
    pub(super) fn unit(self) -> f64 {
        match self {
            Falloff::Sharp => 1.0,
            Falloff::Compensated(_) => WEIGHT_ONE / DROPPED,
        }
    }
}

/// Gives `receive` the sums around all surfels that are asked for, in no particular order.
///
/// # Panics
/// If a surfel is asked for twice.
#[inline(always)]
pub(super) fn sum<L: Level>(task: &Task<'_>, receive: &mut dyn FnMut(&GroupBlock)) {
    let surface = task.surface;
    let blocks = Blocks::sort(
        surface.index.cells().size(),
        &surface.surfels,
        &surface.links,
    );
    if task.ball.metric.is_cubic() {
        Sums::new(task, &blocks, Cubes).run::<L>(receive);
    } else {
        Sums::new(task, &blocks, Boxes::of_ball(task.ball)).run::<L>(receive);
    }
}

/// The measures by place.
struct Sums<'a, S: Squares> {
    task: &'a Task<'a>,
    blocks: &'a Blocks,
    squares: S,
    /// Measures as integers in double precision.
    lumps: Vec<[f64; 8]>,
    omega: Vec<f64>,
    /// Whether each is a ridge, is [`mark::NEAR_CUT`], has a side on the border of an open image.
    tags: Vec<u32>,
    /// Candidates after which sums could be too large for double precision.
    most_added: usize,
}

/// What is counted of candidates around one member.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    /// Of W(p), as far as it was looked at.
    in_ball: u32,
    /// Of C(p).
    connected: u32,
    /// Ridges of C(p) and of W(p).
    ridges: u32,
    ridges_in_ball: u32,
    /// Surfels of C(p) and of W(p) with whose measures the border of the image has to do.
    near_cut: u32,
    near_cut_in_ball: u32,
    /// Surfels of C(p) with a side on the border of an open image.
    open: u32,
}

impl<'a, S: Squares> Sums<'a, S> {
    #[inline(always)]
    fn new(task: &'a Task<'a>, blocks: &'a Blocks, squares: S) -> Self {
        let scale = match task.falloff {
            Falloff::Sharp => 1.0,
            Falloff::Compensated(_) => 1.0 / DROPPED,
        };
        let mut lumps = Vec::with_capacity(blocks.len());
        let mut largest = 1.0f64;
        for &surfel in blocks.order() {
            let mut lump = [0.0; 8];
            for (x, &measure) in lump.iter_mut().zip(&task.lumped[surfel as usize]) {
                // halves to even, so that a mirror image has the same
                *x = (measure as f64 * scale + ROUNDING) - ROUNDING;
                largest = if x.abs() > largest { x.abs() } else { largest };
            }
            lumps.push(lump);
        }
        let omega = if task.omega.is_empty() {
            Vec::new()
        } else {
            let at =
                |&surfel: &u32| (task.omega[surfel as usize] as f64 * scale + ROUNDING) - ROUNDING;
            blocks.order().iter().map(at).collect()
        };
        let largest = omega.iter().fold(largest, |m, x: &f64| m.max(x.abs()));
        let mut tags: Vec<u32> = (blocks.order().iter().enumerate())
            .map(|(place, &surfel)| {
                let marks = task.marks[surfel as usize];
                u32::from(marks & mark::RIDGE != 0)
                    | u32::from(marks & mark::NEAR_CUT != 0) << 1
                    | u32::from(blocks.is_open(place)) << 2
            })
            .collect();
        tags.resize(blocks.len() + LANES, 0);
        let weight = match task.falloff {
            Falloff::Sharp => 1.0,
            Falloff::Compensated(_) => WEIGHT_ONE,
        };
        let most = (1u64 << 53) as f64 / (largest * weight);
        Self {
            task,
            blocks,
            squares,
            lumps,
            omega,
            tags,
            most_added: (most as usize).max(CHUNK),
        }
    }

    #[inline(always)]
    fn run<L: Level>(&self, receive: &mut dyn FnMut(&GroupBlock)) {
        let task = self.task;
        let mut missing = task.starts.len();
        let mut block = GroupBlock::new();
        let mut number = vec![u32::MAX; self.blocks.len()];
        for (n, &start) in task.starts.iter().enumerate() {
            number[self.blocks.place(start)] = n as u32;
        }
        let mut vicinity = Vicinity::<2>::new(self.blocks, *task.ball);
        let near = match task.falloff {
            Falloff::Sharp => task.ball.limit,
            Falloff::Compensated([_, robust]) => robust.floor() as i64,
        };
        let mut buffers = Buffers::default();
        let groups = Groups::of(self.blocks, |place| number[place] != u32::MAX);
        for group in 0..groups.len() {
            let members = groups.members(group);
            vicinity.gather::<L>(members, &self.tags, Sort::Near(near));
            vicinity.connect::<L, S>(self.squares);
            match (task.falloff, L::DOUBLES) {
                (Falloff::Sharp, 8) => self.add::<L, 8, 1>(&vicinity, &mut buffers),
                (Falloff::Sharp, 4) => self.add::<L, 4, 1>(&vicinity, &mut buffers),
                (Falloff::Sharp, _) => self.add::<L, 2, 1>(&vicinity, &mut buffers),
                (_, 8) => self.add::<L, 4, 2>(&vicinity, &mut buffers),
                (_, 4) => self.add::<L, 2, 2>(&vicinity, &mut buffers),
                _ => self.add::<L, 1, 2>(&vicinity, &mut buffers),
            }
            for (m, &place) in members.iter().enumerate() {
                block.number[block.count] = number[place as usize];
                self.finish(&vicinity, m, &buffers.members[m], &mut block);
                missing -= 1;
                if block.count == TOGETHER || missing == 0 {
                    receive(&block);
                    block.count = 0;
                }
            }
        }
        assert_eq!(missing, 0, "each start is in one group, once");
    }

    /// The sums around all members, with `K` weights, `P` members at once. The last one is taken again until
    /// there are a multiple of `P`.
    #[inline(always)]
    fn add<L: Level, const P: usize, const K: usize>(
        &self,
        vicinity: &Vicinity<'_, 2>,
        buffers: &mut Buffers,
    ) {
        let Buffers {
            weights,
            excluded,
            members,
        } = buffers;
        members.clear();
        let count = vicinity.members().len();
        for m in 0..count.next_multiple_of(P) {
            let place = vicinity.members()[m.min(count - 1)];
            members.push(Member {
                centre: vicinity.relative(place as usize),
                sums: [[0.0; 8]; 2],
                wide: [[0; 8]; 2],
                is_wide: false,
                omega: [0; 2],
                counts: Counts::default(),
            });
        }
        let whole = self.task.extent == Extent::Whole;
        let mut added = 0;
        let lists = vicinity.lists().iter().map(|list| (list, Kind::Main));
        let labelled = vicinity
            .labelled()
            .iter()
            .map(|list| (list, Kind::Labelled));
        let apart = [(vicinity.apart(), Kind::Apart)];
        for (number, (list, kind)) in lists.chain(labelled).chain(apart).enumerate() {
            if kind == Kind::Apart && !whole {
                for member in members.iter_mut() {
                    let all = Around {
                        list,
                        range: (0, list.padded()),
                        centre: member.centre,
                        counted: Counted::None,
                    };
                    self.look::<L>(&all, &mut member.counts);
                }
                continue;
            }
            let n = list.padded();
            // the second list is beyond the second weight's support
            let far = K == 2 && number == 1;
            let mut from = 0;
            while from < n {
                let to = (from + CHUNK).min(n);
                let places = &list.place[from..to];
                if added + places.len() > self.most_added {
                    widen(members);
                    added = 0;
                }
                added += places.len();
                // A chunk for all members, while its measures are at hand.
                let mut first = 0;
                while first < members.len() {
                    let some = &mut members[first..first + P];
                    let mut used = false;
                    for i in 0..P {
                        let connected = vicinity.connected((first + i).min(count - 1));
                        let counted = match kind {
                            Kind::Main if connected.main => Counted::All,
                            Kind::Main | Kind::Apart => Counted::None,
                            Kind::Labelled => Counted::Labels(connected.labels),
                        };
                        let of = Around {
                            list,
                            range: (from, to),
                            centre: some[i].centre,
                            counted,
                        };
                        let (weights, counts) = (&mut weights[i], &mut some[i].counts);
                        if self.weigh::<L, K>(&of, far, weights, counts) {
                            used = true;
                        } else {
                            *weights = [[0.0; CHUNK]; 2];
                        }
                    }
                    if used && far {
                        self.multiply::<L, P, 1>(places, weights, some);
                    } else if used {
                        self.multiply::<L, P, K>(places, weights, some);
                    }
                    first += P;
                }
                from = to;
            }
        }
        for m in 0..count {
            let member = &mut members[m];
            for places in vicinity.excluded(m).chunks(CHUNK) {
                excluded.clear();
                for &place in places {
                    let k = vicinity.relative(place as usize);
                    excluded.push(k, place, self.tags[place as usize]);
                }
                excluded.pad();
                let of = Around {
                    list: excluded,
                    range: (0, excluded.padded()),
                    centre: member.centre,
                    counted: Counted::All,
                };
                let mut less = Counts::default();
                self.weigh::<L, K>(&of, false, &mut weights[0], &mut less);
                let counts = &mut member.counts;
                counts.connected -= less.connected;
                counts.ridges -= less.ridges;
                counts.near_cut -= less.near_cut;
                counts.open -= less.open;
                if whole {
                    continue;
                }
                widen(std::slice::from_mut(member));
                for k in 0..K {
                    for (w, &place) in weights[0][k].iter().zip(places) {
                        for t in 0..8 {
                            member.sums[k][t] -= w * self.lumps[place as usize][t];
                        }
                        if let Some(omega) = self.omega.get(place as usize) {
                            member.omega[k] -= (w * omega) as i128;
                        }
                    }
                }
                widen(std::slice::from_mut(member));
            }
        }
    }

    /// Appends what was summed around a member to a block.
    #[inline(always)]
    fn finish(
        &self,
        vicinity: &Vicinity<'_, 2>,
        m: usize,
        member: &Member,
        block: &mut GroupBlock,
    ) {
        let at = block.count;
        block.count += 1;
        let c = &member.counts;
        let (near_cut, summed, ridges) = match self.task.extent {
            Extent::Whole => (c.near_cut_in_ball, c.in_ball, c.ridges_in_ball),
            Extent::Connected => (c.near_cut, c.connected, c.ridges),
        };
        for k in 0..2 {
            for t in 0..8 {
                block.measures[k][t][at] = member.sums[k][t];
            }
            block.omega[k][at] = fixed::number(member.omega[k]);
        }
        if member.is_wide {
            for k in 0..2 {
                for t in 0..8 {
                    let sum = member.wide[k][t] + i128::from(member.sums[k][t] as i64);
                    block.measures[k][t][at] = fixed::number(sum);
                }
            }
        }
        block.rim[at] = vicinity.rim(m, c.connected, c.open > 0);
        block.several_sheets[at] = c.in_ball > c.connected;
        block.near_cut[at] = near_cut > 0;
        block.summed[at] = f64::from(summed.max(1));
        block.ridges[at] = f64::from(ridges);
    }

    /// Whether any of some candidates that do not count is in the ball.
    #[inline(always)]
    fn look<L: Level>(&self, around: &Around<'_>, counts: &mut Counts) {
        let Around {
            list,
            range: (from, to),
            centre,
            ..
        } = *around;
        let [x, y, z] = [&list.x, &list.y, &list.z].map(|x| x[from..to].as_chunks::<LANES>().0);
        let centre = [L::all(centre[0]), L::all(centre[1]), L::all(centre[2])];
        for i in 0..x.len() {
            if counts.in_ball > counts.connected {
                return;
            }
            let square = self.squares.of::<L>([
                L::sub(L::load(&x[i]), centre[0]),
                L::sub(L::load(&y[i]), centre[1]),
                L::sub(L::load(&z[i]), centre[2]),
            ]);
            let inside = S::at_most::<L>(square, self.task.ball.limit as f64);
            counts.in_ball += L::bits(inside).count_ones();
        }
    }

    /// Weights of some candidates around one member; whether any can be other than 0.
    #[inline(always)]
    fn weigh<L: Level, const K: usize>(
        &self,
        around: &Around<'_>,
        far: bool,
        weights: &mut [[f64; CHUNK]; 2],
        counts: &mut Counts,
    ) -> bool {
        match around.counted {
            Counted::All => self.weigh_those::<L, K, ALL>(around, far, weights, counts),
            Counted::None if self.task.extent == Extent::Connected => {
                self.look::<L>(around, counts);
                false
            }
            Counted::None => self.weigh_those::<L, K, NONE>(around, far, weights, counts),
            Counted::Labels(_) => self.weigh_those::<L, K, LABELS>(around, far, weights, counts),
        }
    }

    /// The same, compiled for each way candidates count.
    #[inline(always)]
    fn weigh_those<L: Level, const K: usize, const COUNTED: u8>(
        &self,
        around: &Around<'_>,
        far: bool,
        weights: &mut [[f64; CHUNK]; 2],
        counts: &mut Counts,
    ) -> bool {
        let Around {
            list,
            range: (from, to),
            centre,
            counted: how,
        } = *around;
        let [x, y, z] = [&list.x, &list.y, &list.z].map(|x| x[from..to].as_chunks::<LANES>().0);
        let label = list.label[from..to].as_chunks::<LANES>().0;
        let (w0, w1) = weights.split_at_mut(1);
        let w0 = w0[0].as_chunks_mut::<LANES>().0;
        let w1 = w1[0].as_chunks_mut::<LANES>().0;
        let centre = [L::all(centre[0]), L::all(centre[1]), L::all(centre[2])];
        let limit = self.task.ball.limit as f64;
        let per = match self.task.falloff {
            Falloff::Sharp => [1.0; 2],
            Falloff::Compensated(squared) => [1.0 / squared[0], 1.0 / squared[1]],
        };
        let one = L::all(1.0);
        let weight_one = L::all(WEIGHT_ONE as f32);
        let whole = self.task.extent == Extent::Whole;
        let (mut in_ball, mut connected) = (0, 0);
        for i in 0..x.len() {
            let square = self.squares.of::<L>([
                L::sub(L::load(&x[i]), centre[0]),
                L::sub(L::load(&y[i]), centre[1]),
                L::sub(L::load(&z[i]), centre[2]),
            ]);
            let inside = S::at_most::<L>(square, limit);
            let counted = match (COUNTED, how) {
                (ALL, _) => inside,
                (LABELS, Counted::Labels(labels)) => {
                    L::and(inside, L::looked_up(&label[i], labels))
                }
                _ => L::mask(false),
            };
            let (bits_inside, bits_counted) = (L::bits(inside), L::bits(counted));
            in_ball += bits_inside.count_ones();
            connected += bits_counted.count_ones();
            if let Some(tagged) = list.tagged(from / LANES + i) {
                counts.ridges += (bits_counted & tagged[0]).count_ones();
                counts.ridges_in_ball += (bits_inside & tagged[0]).count_ones();
                counts.near_cut += (bits_counted & tagged[1]).count_ones();
                counts.near_cut_in_ball += (bits_inside & tagged[1]).count_ones();
                counts.open += (bits_counted & tagged[2]).count_ones();
            }
            let summed = if whole { inside } else { counted };
            // Beyond the ball the weights are 0 by themselves.
            let store = |w: L::F, to: &mut [f64; LANES]| {
                if COUNTED == ALL {
                    L::store(w, to);
                } else {
                    L::store_chosen(w, summed, to);
                }
            };
            if K == 1 {
                L::store_chosen(one, summed, &mut w0[i]);
            } else {
                let t = L::min(S::scaled::<L>(square, per[0]), one);
                let w = L::mul(L::sub(one, t), L::sub(one, L::add(t, t)));
                store(rounded::<L>(L::mul(w, weight_one)), &mut w0[i]);
                if !far {
                    let t = L::min(S::scaled::<L>(square, per[1]), one);
                    let w = L::mul(L::sub(one, t), weight_one);
                    store(rounded::<L>(w), &mut w1[i]);
                }
            }
        }
        counts.in_ball += in_ball;
        counts.connected += connected;
        (if whole { in_ball } else { connected }) > 0
    }

    /// Adds measures times weights to the sums of some members.
    #[inline(always)]
    fn multiply<L: Level, const P: usize, const K: usize>(
        &self,
        places: &[u32],
        weights: &[[[f64; CHUNK]; 2]; MOST_MEMBERS],
        members: &mut [Member],
    ) {
        let mut sums = [[[0.0f64; 8]; P]; K];
        for k in 0..K {
            for i in 0..P {
                sums[k][i] = members[i].sums[k];
            }
        }
        for (q, &place) in places.iter().enumerate() {
            let lump = &self.lumps[place as usize];
            for k in 0..K {
                for i in 0..P {
                    let w = weights[i][k][q];
                    for t in 0..8 {
                        sums[k][i][t] = L::multiply_add(w, lump[t], sums[k][i][t]);
                    }
                }
            }
        }
        for k in 0..K {
            for i in 0..P {
                members[i].sums[k] = sums[k][i];
            }
        }
        if self.omega.is_empty() {
            return;
        }
        for k in 0..K {
            for i in 0..P {
                let mut sum = 0.0;
                for (w, &place) in weights[i][k].iter().zip(places) {
                    sum += w * self.omega[place as usize];
                }
                members[i].omega[k] += sum as i128;
            }
        }
    }
}

/// What is summed around one member.
struct Member {
    centre: [f32; 3],
    sums: [[f64; 8]; 2],
    /// What `sums` was before it could become inexact.
    wide: [[i128; 8]; 2],
    is_wide: bool,
    omega: [i128; 2],
    counts: Counts,
}

/// What kind of candidates a list holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Main,
    Labelled,
    Apart,
}

/// Some candidates around one member.
#[derive(Clone, Copy)]
struct Around<'a> {
    list: &'a Candidates,
    range: (usize, usize),
    centre: [f32; 3],
    counted: Counted<'a>,
}

/// Which candidates in the ball are connected to the member.
#[derive(Clone, Copy)]
enum Counted<'a> {
    All,
    None,
    /// Those of labels for which this is 1.
    Labels(&'a [u32]),
}

// The same as parameters of code that is compiled for each.
const ALL: u8 = 0;
const NONE: u8 = 1;
const LABELS: u8 = 2;

/// Scratch memory.
struct Buffers {
    /// Weights of the candidates of a chunk, by member and weight.
    weights: Box<[[[f64; CHUNK]; 2]; MOST_MEMBERS]>,
    /// What is taken away again.
    excluded: Candidates,
    members: Vec<Member>,
}

impl Default for Buffers {
    fn default() -> Self {
        Self {
            weights: Box::new([[[0.0; CHUNK]; 2]; MOST_MEMBERS]),
            excluded: Candidates::default(),
            members: Vec::new(),
        }
    }
}

/// Moves sums to wide integers.
fn widen(members: &mut [Member]) {
    for member in members {
        member.is_wide = true;
        for (sums, wide) in member.sums.iter_mut().zip(&mut member.wide) {
            for (sum, wide) in sums.iter_mut().zip(wide) {
                // below 2^53, so i64 holds it
                *wide += i128::from(*sum as i64);
                *sum = 0.0;
            }
        }
    }
}
