//! The parts of the surface in the balls around the surfels of a group, found for all of them at once.
//!
//! Comes in: [`Blocks`], a ball, a group of neighbouring surfels on one component of the surface (its
//! *members*). Goes out: lists of *candidates*, which hold every surfel that is in the ball of some
//! member, in the form that loops over vectors read; and for each member which of them are connected to it within
//! its ball, so are in C(p) if they are in W(p).
//!
//! **Without walking.** A surfel is *descending* for the group if one of its neighbours is nearer to every point
//! of the box around the members. From a descending surfel in W(p) a path through W(p) leads to one that is not,
//! since squared distances are integers. Those that are not are the *hub*, a few around the group; if for a
//! member p each surfel of the hub in W(p) but p itself has a neighbour nearer to p, then every path ends at p, and W(p) = C(p) as far as
//! candidates go. On smooth surfaces that is so for every member. Elsewhere a short search from each that has none finds
//! a path through W(p) to something nearer, or that there is none, and then all that it saw is *excluded*: pieces
//! of bumps at the rim of the ball, say.
//!
//! **With labels.** Where searches are too short for some member, or there are too many, candidates are labelled by the
//! surfel that they descend to. For labels, surfels that are in the balls of all members (the *core*) also descend to neighbours
//! that are less far from the box around the members, which are in the core too. Labels are joined across linels between surfels of the
//! core. What is then left between different labels are *edges*: pairs of
//! neighbours that count for a member if both are in its ball. Those where what both descend to are neighbours
//! as well are not needed. For each edge it is written down which members it counts for, a bit for each, and so
//! all of them go over the edges at once, from their own labels to all that are connected to them. Labels that are connected to the same members are one *class*. Candidates whose labels are
//! connected to no member are *apart*: with those of other components, they only tell that there
//! are several sheets.
//!
//! Guaranteed: the same sets as [`super::Walker`] finds, exactly. Decisions that are not in integers (voxels
//! that are not cubes) are on the safe side: they only cost time.

mod candidates;
mod labels;
#[cfg(test)]
mod tests;

use std::ops::Range;

use crate::lattice::Ball;
use crate::simd::{LANES, Level, dot};

pub(crate) use candidates::Candidates;
use candidates::{NOWHERE, sixteen};
use labels::Labelling;

use super::blocks::{Blocks, Chunk, NONE};
use super::walk::{Rim, displacement};

/// Surfels that a search for a path looks at, at most.
const SEARCHED: usize = 48;

/// Surfels that all searches for a group look at, at most, for each candidate. With fewer, groups are labelled that a
/// few more searches would do for; with more, searches cost more than labels.
const SEARCHED_EACH: usize = 3;

/// Surfels of a ball that are excluded one by one, at most; with more, labels are quicker.
const MOST_EXCLUDED: usize = 256;

/// Slack of decisions in single precision, relative.
const SLACK: f32 = 1e-5;

/// Surfels of the hub.
#[derive(Clone, Debug, Default)]
struct Hub {
    len: usize,
    place: Vec<u32>,
    k: [Vec<f32>; 3],
    /// Displacements to the neighbours, by side and axis.
    steps: [[Vec<f32>; 3]; 4],
}

/// What a search finds.
#[derive(Clone, Copy, Debug)]
enum Search {
    /// A path leads nearer to the member, or it is not in its ball.
    Nearer,
    /// None does; what was seen is all that is connected to where it began.
    Separate,
    /// It was too short.
    Unknown,
}

/// What searches for a group saw.
#[derive(Debug)]
struct Seen {
    /// Places that the last search saw.
    places: [u32; SEARCHED],
    len: usize,
    /// By place, a bit: whether it is one of them. Between searches all are 0.
    bits: Vec<u64>,
    /// How many places all of them looked at.
    searched: usize,
}

impl Seen {
    /// Whether the search has not seen a place yet.
    #[inline(always)]
    fn is_new(&self, place: u32) -> bool {
        self.bits[place as usize / 64] >> (place % 64) & 1 == 0
    }

    #[inline(always)]
    fn push(&mut self, place: u32) {
        self.places[self.len] = place;
        self.len += 1;
        self.bits[place as usize / 64] |= 1 << (place % 64);
    }
}

/// Which candidates count for a member.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Connected<'a> {
    /// Whether those without a label do.
    pub(crate) main: bool,
    /// 1 for each label that does, else 0.
    pub(crate) labels: &'a [u32],
}

/// The candidates around one group after another. `LISTS` is into how many lists the caller sorts
/// them.
#[derive(Debug)]
pub(crate) struct Vicinity<'a, const LISTS: usize> {
    blocks: &'a Blocks,
    ball: Ball,
    /// Surfels that a search looks at, at most.
    most_searched: usize,
    /// Squared edges of a voxel and the squared radius in single precision.
    squares: [f32; 3],
    limit: f32,
    members: Vec<u32>,
    /// Khalimsky coordinates of what the candidates' are relative to.
    origin: [i32; 3],
    /// Middle of the box around the members, and half its extents.
    middle: [f32; 3],
    half: [f32; 3],
    descent: f32,
    lists: [Candidates; LISTS],
    /// Candidates of all labels but that of the most, by list.
    labelled: [Candidates; LISTS],
    apart: Candidates,
    hub: Hub,
    runs: Vec<Range<usize>>,
    /// Whether it is known without labels what is connected to each member.
    passed: bool,
    /// Scratch memory of searches.
    seen: Seen,
    /// Places of surfels in the ball of a member that are not connected to it, member by member.
    excluded: Vec<u32>,
    excluded_to: Vec<u32>,
    /// Whether candidates have labels, and how many there are.
    labels: Option<usize>,
    /// For each member, 1 for each label that is connected to it; the label of `lists` first.
    alive: Vec<u32>,
    labelling: Labelling,
}

/// Groups of surfels: each of one block and one component of the surface.
#[derive(Clone, Debug, Default)]
pub(crate) struct Groups {
    /// Places of the members, group by group.
    members: Vec<u32>,
    /// One past the last member of each group.
    ends: Vec<u32>,
}

impl Groups {
    /// Groups the surfels for whose places `is_member` holds.
    pub(crate) fn of(blocks: &Blocks, is_member: impl Fn(usize) -> bool) -> Self {
        let mut groups = Self::default();
        let mut rest: Vec<u32> = Vec::new();
        for run in blocks.blocks() {
            rest.clear();
            rest.extend(run.filter(|&p| is_member(p)).map(|p| p as u32));
            while let Some(&first) = rest.first() {
                let component = blocks.component(first as usize);
                rest.retain(|&p| {
                    let same = blocks.component(p as usize) == component;
                    if same {
                        groups.members.push(p);
                    }
                    !same
                });
                groups.ends.push(groups.members.len() as u32);
            }
        }
        groups
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Places of the members of a group.
    pub(crate) fn members(&self, group: usize) -> &[u32] {
        let from = if group == 0 { 0 } else { self.ends[group - 1] };
        &self.members[from as usize..self.ends[group] as usize]
    }
}

/// How candidates are sorted into lists.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Sort<'a> {
    /// The first list is of those that may be within this squared distance of some member, in
    /// the unit of the ball's limit.
    Near(i64),
    /// By the class of each place, below the number of lists.
    ByClass(&'a [u32]),
}

impl<'a, const LISTS: usize> Vicinity<'a, LISTS> {
    /// For balls around surfels of a box, which must cover all that is in them.
    #[must_use]
    pub(crate) fn new(blocks: &'a Blocks, ball: Ball) -> Self {
        let one = ball.metric.one() as f64;
        Self {
            blocks,
            ball,
            most_searched: SEARCHED,
            squares: ball.metric.weights.map(|w| (w as f64 / one) as f32),
            limit: (ball.limit as f64 / one) as f32,
            members: Vec::new(),
            origin: [0; 3],
            middle: [0.0; 3],
            half: [0.0; 3],
            descent: 0.0,
            lists: std::array::from_fn(|_| Candidates::default()),
            labelled: std::array::from_fn(|_| Candidates::default()),
            apart: Candidates::default(),
            hub: Hub::default(),
            runs: Vec::new(),
            passed: false,
            seen: Seen {
                places: [NONE; SEARCHED],
                len: 0,
                bits: vec![0; blocks.len().div_ceil(64)],
                searched: 0,
            },
            excluded: Vec::new(),
            excluded_to: Vec::new(),
            labels: None,
            alive: Vec::new(),
            labelling: Labelling::default(),
        }
    }

    /// Slack for decisions that must not be wrong on one side; none where all is in integers.
    fn slack(&self) -> f32 {
        if self.ball.metric.is_cubic() {
            0.0
        } else {
            SLACK
        }
    }

    /// Gathers the candidates around a group. `tags`, by place, go with them.
    #[inline(always)]
    pub(crate) fn gather<L: Level>(&mut self, members: &[u32], tags: &[u32], sort: Sort<'_>) {
        self.members.clear();
        self.members.extend_from_slice(members);
        let (mut lo, mut hi) = ([i32::MAX; 3], [i32::MIN; 3]);
        for &place in members {
            let k = self.blocks.k_at(place as usize);
            for a in 0..3 {
                lo[a] = lo[a].min(i32::from(k[a]));
                hi[a] = hi[a].max(i32::from(k[a]));
            }
        }
        self.origin = lo;
        self.half = [0, 1, 2].map(|a| 0.5 * (hi[a] - lo[a]) as f32);
        self.middle = [0, 1, 2].map(|a| lo[a] as f32 + self.half[a]);
        let steepest = (0..3).map(|a| self.squares[a] * (4.0 * self.half[a] + 4.0));
        self.descent = 0.5 * steepest.fold(0.0, f32::max) * (1.0 + 100.0 * self.slack());
        for list in self.lists.iter_mut().chain(&mut self.labelled) {
            list.clear();
        }
        self.apart.clear();
        self.hub.len = 0;
        self.labels = None;
        let reach = [0, 1, 2].map(|a| self.ball.half_width(a, 0).unwrap_or(0));
        let from = [0, 1, 2].map(|a| lo[a] - reach[a]);
        let to = [0, 1, 2].map(|a| hi[a] + reach[a]);
        let near = match sort {
            Sort::Near(square) => (square as f64 / self.ball.metric.one() as f64) as f32,
            Sort::ByClass(_) => 0.0,
        };
        let component = self.blocks.component(members[0] as usize);
        self.blocks.runs(from, to, &mut self.runs);
        for number in 0..self.runs.len() {
            let run = self.runs[number].clone();
            self.take::<L>(run, component, near, tags, sort);
        }
        for list in &mut self.lists {
            list.pad();
        }
        self.apart.pad();
        self.pad_hub();
        self.pass_members::<L>();
    }

    /// Sorts the candidates of a run of places into the lists, and finds those of the hub.
    #[inline(always)]
    fn take<L: Level>(
        &mut self,
        run: Range<usize>,
        component: u32,
        near: f32,
        tags: &[u32],
        sort: Sort<'_>,
    ) {
        for candidates in &mut self.lists {
            candidates.make_room(run.len() + LANES);
        }
        let slack = 1.0 + self.slack();
        let (limit, near) = (L::all(self.limit * slack), L::all(near * slack));
        let descent = L::all(-self.descent);
        let zero = L::all(0.0);
        let blocks = self.blocks;
        for number in run.start / LANES..run.end.div_ceil(LANES) {
            let chunk = &blocks.chunks[number];
            let from = number * LANES;
            let (nearest, scaled) = self.beyond_members::<L>(chunk);
            let mut kept = L::bits(L::at_most(nearest, limit)) & lanes_of(&run, from);
            if kept == 0 {
                continue;
            }
            let mut k = [zero; 3];
            for a in 0..3 {
                k[a] = L::sub(L::load_i16(&chunk.k[a]), L::all(self.origin[a] as f32));
            }
            let same = L::bits(L::equal(&chunk.component, component));
            let tags = sixteen(tags, from);
            let apart = kept & !same;
            if apart != 0 {
                self.apart.make_room(LANES);
                self.apart.take::<L>(k, from, tags, apart);
            }
            kept &= same;
            let mut lowest = zero;
            for change in changes::<L>(chunk, scaled) {
                lowest = L::min(change, lowest);
            }
            let mut hub = kept & L::bits(L::at_most(descent, lowest));
            while hub != 0 {
                let lane = hub.trailing_zeros() as usize;
                hub &= hub - 1;
                self.push_hub(chunk, lane, from + lane);
            }
            match sort {
                Sort::Near(_) => {
                    let near = L::bits(L::at_most(nearest, near));
                    self.lists[0].take::<L>(k, from, tags, kept & near);
                    self.lists[1].take::<L>(k, from, tags, kept & !near);
                }
                Sort::ByClass(classes) => {
                    let classes = sixteen(classes, from);
                    for (class, list) in self.lists.iter_mut().enumerate() {
                        let of_class = L::bits(L::equal(classes, class as u32));
                        list.take::<L>(k, from, tags, kept & of_class);
                    }
                }
            }
        }
    }

    /// Squared distances of a chunk from the box around the members, and displacements from its middle times the squared
    /// edges of a voxel.
    #[inline(always)]
    fn beyond_members<L: Level>(&self, chunk: &Chunk) -> (L::F, [L::F; 3]) {
        let zero = L::all(0.0);
        let mut nearest = zero;
        let mut scaled = [zero; 3];
        for a in 0..3 {
            let d = L::sub(L::load_i16(&chunk.k[a]), L::all(self.middle[a]));
            let size = L::max(d, L::sub(zero, d));
            let beyond = L::max(L::sub(size, L::all(self.half[a])), zero);
            let square = L::all(self.squares[a]);
            nearest = L::add(nearest, L::mul(square, L::mul(beyond, beyond)));
            scaled[a] = L::mul(square, d);
        }
        (nearest, scaled)
    }

    fn push_hub(&mut self, chunk: &Chunk, lane: usize, place: usize) {
        let at = self.hub.len;
        if self.hub.k[0].len() < at + LANES {
            let room = (at + LANES).next_power_of_two();
            let lists = self.hub.k.iter_mut();
            for list in lists.chain(self.hub.steps.iter_mut().flatten()) {
                list.resize(room, 0.0);
            }
        }
        self.hub.place.truncate(at);
        self.hub.place.push(place as u32);
        for a in 0..3 {
            self.hub.k[a][at] = (i32::from(chunk.k[a][lane]) - self.origin[a]) as f32;
            for side in 0..4 {
                self.hub.steps[side][a][at] = f32::from(chunk.steps[side][a][lane]);
            }
        }
        self.hub.len += 1;
    }

    fn pad_hub(&mut self) {
        let end = self.hub.len.next_multiple_of(LANES);
        for list in &mut self.hub.k {
            list.resize(list.len().max(end), NOWHERE);
            list[self.hub.len..end].fill(NOWHERE);
        }
        for list in self.hub.steps.iter_mut().flatten() {
            list.resize(list.len().max(end), 0.0);
        }
    }

    /// Surfels that searches for a group look at, at most.
    fn most_work(&self) -> usize {
        let mut candidates = 0;
        for list in &self.lists {
            candidates += list.len;
        }
        SEARCHED_EACH * candidates
    }

    /// Whether each member is sure to be connected to all candidates in its ball.
    #[inline(always)]
    fn pass_members<L: Level>(&mut self) {
        self.passed = true;
        let most = self.most_work();
        self.excluded.clear();
        self.excluded_to.clear();
        let mut seen = Seen {
            bits: std::mem::take(&mut self.seen.bits),
            searched: 0,
            ..self.seen
        };
        let n = self.hub.len.next_multiple_of(LANES);
        let k = [0, 1, 2].map(|a| self.hub.k[a][..n].as_chunks::<LANES>().0);
        let steps = [0, 1, 2, 3]
            .map(|side| [0, 1, 2].map(|a| self.hub.steps[side][a][..n].as_chunks::<LANES>().0));
        let squares = self.squares.map(L::all);
        let limit = L::all(self.limit * (1.0 + self.slack()));
        let slack = L::all(-100.0 * self.slack());
        // less than any square that is not zero
        let least = L::all(1e-9);
        for number in 0..self.members.len() {
            let p = self.relative(self.members[number] as usize).map(L::all);
            let first = self.excluded.len();
            let mut known = true;
            for i in 0..k[0].len() {
                if !known {
                    break;
                }
                let d = [
                    L::sub(L::load(&k[0][i]), p[0]),
                    L::sub(L::load(&k[1][i]), p[1]),
                    L::sub(L::load(&k[2][i]), p[2]),
                ];
                let squared = dot::<L>(
                    squares,
                    [L::mul(d[0], d[0]), L::mul(d[1], d[1]), L::mul(d[2], d[2])],
                );
                let twice = [L::add(d[0], d[0]), L::add(d[1], d[1]), L::add(d[2], d[2])];
                let mut lowest = L::all(0.0);
                for step in &steps {
                    let s = [
                        L::load(&step[0][i]),
                        L::load(&step[1][i]),
                        L::load(&step[2][i]),
                    ];
                    let change = dot::<L>(
                        squares,
                        [
                            L::mul(s[0], L::add(twice[0], s[0])),
                            L::mul(s[1], L::add(twice[1], s[1])),
                            L::mul(s[2], L::add(twice[2], s[2])),
                        ],
                    );
                    lowest = L::min(change, lowest);
                }
                let in_ball = L::and(L::at_most(squared, limit), L::at_most(least, squared));
                let mut stuck = L::bits(L::and(in_ball, L::at_most(slack, lowest)));
                while stuck != 0 && known {
                    let at = i * LANES + stuck.trailing_zeros() as usize;
                    stuck &= stuck - 1;
                    let place = self.hub.place[at];
                    if self.excluded[first..].contains(&place) {
                        continue;
                    }
                    let found = self.search(place, self.members[number], &mut seen);
                    known = seen.searched <= most;
                    match found {
                        Search::Nearer => {}
                        Search::Separate => {
                            self.excluded.extend_from_slice(&seen.places[..seen.len]);
                        }
                        Search::Unknown => known = false,
                    }
                    known &= self.excluded.len() - first <= MOST_EXCLUDED;
                }
            }
            self.excluded_to.push(self.excluded.len() as u32);
            if !known {
                // Labels are needed, and answer for all.
                self.passed = false;
                self.excluded.clear();
                self.excluded_to.clear();
                break;
            }
        }
        self.seen = seen;
    }

    /// Looks for a path from a surfel, through others in the ball of a member, to one that is nearer to the member. Where
    /// there is none, all that is connected to the surfel was seen, and is not connected to the member.
    #[inline(always)]
    fn search(&self, from: u32, member: u32, seen: &mut Seen) -> Search {
        seen.len = 0;
        seen.push(from);
        let found = self.search_on(member, seen);
        for &place in &seen.places[..seen.len] {
            seen.bits[place as usize / 64] = 0;
        }
        found
    }

    /// The same, from the first place that was seen.
    #[inline(always)]
    fn search_on(&self, member: u32, seen: &mut Seen) -> Search {
        let centre = self.blocks.k_at(member as usize);
        let metric = self.ball.metric;
        let k = self.blocks.k_at(seen.places[0] as usize);
        let least = metric.squared(displacement(k, centre));
        if least > self.ball.limit {
            // it only seemed to be in the ball, in single precision
            return Search::Nearer;
        }
        let mut next = 0;
        while next < seen.len {
            seen.searched += 1;
            for side in &self.blocks.across {
                let place = side[seen.places[next] as usize];
                if place == NONE || !seen.is_new(place) {
                    continue;
                }
                let k = self.blocks.k_at(place as usize);
                let square = metric.squared(displacement(k, centre));
                if square < least {
                    return Search::Nearer;
                }
                if square <= self.ball.limit {
                    if seen.len == self.most_searched {
                        return Search::Unknown;
                    }
                    seen.push(place);
                }
            }
            next += 1;
        }
        Search::Separate
    }

    /// Coordinates of a place as those of the candidates are.
    #[inline]
    #[must_use]
    pub(crate) fn relative(&self, place: usize) -> [f32; 3] {
        let k = self.blocks.k_at(place);
        [
            (i32::from(k[0]) - self.origin[0]) as f32,
            (i32::from(k[1]) - self.origin[1]) as f32,
            (i32::from(k[2]) - self.origin[2]) as f32,
        ]
    }

    /// The members of the group, as places.
    #[must_use]
    pub(crate) fn members(&self) -> &[u32] {
        &self.members
    }

    /// Candidates that count alike for a member: see [`Connected::main`].
    #[must_use]
    pub(crate) fn lists(&self) -> &[Candidates; LISTS] {
        &self.lists
    }

    /// Candidates that count by their label: see [`Connected::labels`].
    #[must_use]
    pub(crate) fn labelled(&self) -> &[Candidates; LISTS] {
        &self.labelled
    }

    /// Candidates that are connected to no member.
    #[must_use]
    pub(crate) fn apart(&self) -> &Candidates {
        &self.apart
    }

    /// Which candidates are connected to a member, if they are in its ball.
    #[must_use]
    pub(crate) fn connected(&self, member: usize) -> Connected<'_> {
        match self.labels {
            None => Connected {
                main: true,
                labels: &[],
            },
            Some(n) => {
                let labels = &self.alive[member * n..][..n];
                Connected {
                    main: labels[0] == 1,
                    labels,
                }
            }
        }
    }

    /// Places of candidates in the ball of a member that are not connected to it, although [`Self::connected`] says so.
    #[inline(always)]
    pub(crate) fn excluded(&self, member: usize) -> &[u32] {
        if self.excluded.is_empty() {
            return &[];
        }
        let from = if member == 0 {
            0
        } else {
            self.excluded_to[member - 1]
        };
        &self.excluded[from as usize..self.excluded_to[member] as usize]
    }

    /// How C(p) of a member ends, given how many surfels it has and whether one of them has a side on the
    /// border of an open image: it has an end in the ball unless it is a whole component.
    #[must_use]
    pub(crate) fn rim(&self, member: usize, count: u32, open: bool) -> Rim {
        let component = self.blocks.component(self.members[member] as usize);
        let component = &self.blocks.components[component as usize];
        Rim {
            cut_by_ball: count != component.size || component.goes_on,
            open,
        }
    }
}

/// Half of what the steps across the sides of a chunk change of the squared distance from the middle of the members,
/// but for the squares of the steps: 2 (q - c).s + 2 half.|s| + |s|^2 < 0 for a step s that leads nearer to all points
/// of the box, which is so if (q - c).s is below what the steepest step asks for.
#[inline(always)]
fn changes<L: Level>(chunk: &Chunk, scaled: [L::F; 3]) -> [L::F; 4] {
    let mut changes = [L::all(0.0); 4];
    for (change, step) in changes.iter_mut().zip(&chunk.steps) {
        let step = [
            L::load_i8(&step[0]),
            L::load_i8(&step[1]),
            L::load_i8(&step[2]),
        ];
        *change = dot::<L>(step, scaled);
    }
    changes
}

/// Which of the sixteen places from `from` on are of a run.
#[inline(always)]
fn lanes_of(run: &Range<usize>, from: usize) -> u16 {
    let mut lanes = u16::MAX;
    if from < run.start {
        lanes &= u16::MAX << (run.start - from);
    }
    if run.end < from + LANES {
        lanes &= (1 << (run.end - from)) - 1;
    }
    lanes
}
