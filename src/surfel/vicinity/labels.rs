//! Labels of candidates, where searches do not tell what is connected to the members of a group; see [`super`].
//!
//! All but a few candidates are met only in loops that do not branch: what each descends to is written down by vectors, in an
//! array by place, and replaced by what that descends to until it is the number of a surfel of the hub; then each is compared with
//! its neighbours. What has branches are pairs of different numbers, which lie along a few lines.

use crate::simd::{LANES, Level};

use super::super::blocks::{Chunk, EDGE, NONE, find, unite};
use super::super::squares::Squares;
use super::Vicinity;
use super::candidates::{NOWHERE, sixteen, sixteen_from, sixteen_mut};
use super::{changes, lanes_of};

/// In [`Labelling::lower`] and [`Labelling::hub`], numbers of the hub are from here on.
const HUB: u32 = 1 << 31;

/// Members of a group, at most: surfels of a block of cells.
const MOST_MEMBERS: usize = 3 * (EDGE * EDGE * EDGE) as usize;

/// For each member a bit: whether a label is connected to it.
type Column = [u64; MOST_MEMBERS.div_ceil(64)];

/// Labels of two neighbours, and the members whose balls both are in.
#[derive(Clone, Copy, Debug)]
struct Edge {
    labels: [u32; 2],
    members: Column,
}

/// Scratch memory of labelling.
#[derive(Debug, Default)]
pub(super) struct Labelling {
    /// By place, for candidates the neighbour that they descend to, or [`HUB`] and a number of the hub.
    lower: Vec<u32>,
    /// By place, for candidates [`HUB`] and the number of the hub that they end at; else [`NONE`]. There are
    /// more than places, so that the last is of none. Between groups all are [`NONE`].
    hub: Vec<u32>,
    /// Places of the candidates, in their order.
    places: Vec<u32>,
    /// Joins what is joined within the balls of all members, by number of the hub.
    parent: Vec<u32>,
    /// By number of the hub: the label; later, the class of it, [`NONE`] if no member reaches it.
    label: Vec<u32>,
    /// Neighbours of different labels that are not both in the core.
    pending: Vec<[u32; 2]>,
    edges: Vec<Edge>,
    /// Labels of the members.
    of_members: Vec<u32>,
    /// Coordinates of the members, padded.
    centres: [Vec<f32>; 3],
    /// By label, which members are connected to it.
    columns: Vec<Column>,
    /// By label, what it is named at last.
    class: Vec<u32>,
    /// Labels that are connected to some members but not to all.
    mixed: Vec<u32>,
    /// The columns of the classes.
    classes: Vec<Column>,
}

impl<const LISTS: usize> Vicinity<'_, LISTS> {
    /// Labels the candidates if that is needed to tell which are connected to the members. `squares` are those of the ball.
    #[inline(always)]
    pub(crate) fn connect<L: Level, S: Squares>(&mut self, squares: S) {
        if self.passed {
            return;
        }
        self.descend::<L>();
        self.sink();
        self.join();
        let labels = self.name_labels();
        if labels > 1 {
            self.list_edges::<L, S>(squares);
            self.reach_labels(labels);
            self.name_classes();
            self.sort_by_class::<L>();
        }
        let work = &mut self.labelling;
        for &place in &work.places {
            work.hub[place as usize] = NONE;
        }
    }

    /// Finds for each candidate a neighbour that is in all balls of members that it is in itself: the one nearest to the
    /// members or, in the core, to what of the box around them is farthest. Numbers those that have none.
    #[inline(always)]
    fn descend<L: Level>(&mut self) {
        let blocks = self.blocks;
        let component = blocks.component(self.members[0] as usize);
        let limit = L::all(self.limit * (1.0 + self.slack()));
        let descent = L::all(-self.descent);
        let mut work = std::mem::take(&mut self.labelling);
        let Labelling {
            lower, hub, places, ..
        } = &mut work;
        lower.resize(blocks.chunks.len() * LANES, NONE);
        hub.resize((blocks.chunks.len() + 1) * LANES, NONE);
        let mut count = 0;
        let mut numbers = 0;
        for run in &self.runs {
            if places.len() < count + run.len() + LANES {
                places.resize((count + run.len() + LANES).next_power_of_two(), NONE);
            }
            for number in run.start / LANES..run.end.div_ceil(LANES) {
                let chunk = &blocks.chunks[number];
                let from = number * LANES;
                let (nearest, scaled) = self.beyond_members::<L>(chunk);
                let mut kept = L::bits(L::at_most(nearest, limit)) & lanes_of(run, from);
                if kept == 0 {
                    continue;
                }
                kept &= L::bits(L::equal(&chunk.component, component));
                if kept == 0 {
                    continue;
                }
                let changes = changes::<L>(chunk, scaled);
                let mut lowest = L::all(0.0);
                for change in changes {
                    lowest = L::min(change, lowest);
                }
                let mut best = [
                    L::bits(L::at_most(changes[0], lowest)),
                    L::bits(L::at_most(changes[1], lowest)),
                    L::bits(L::at_most(changes[2], lowest)),
                ];
                let mut of_hub = kept & L::bits(L::at_most(descent, lowest));
                if of_hub != 0 {
                    let (inward, sides) = self.inward::<L>(chunk, of_hub);
                    of_hub &= !inward;
                    for i in 0..3 {
                        best[i] = (best[i] & !inward) | (sides[i] & inward);
                    }
                }
                let across = [
                    sixteen(&blocks.across[0], from),
                    sixteen(&blocks.across[1], from),
                    sixteen(&blocks.across[2], from),
                    sixteen(&blocks.across[3], from),
                ];
                let to = sixteen_mut(lower, from);
                let ends = sixteen_mut(hub, from);
                for i in 0..LANES {
                    let bit = 1 << i;
                    let mut place = across[3][i];
                    place = if best[2] & bit == 0 {
                        place
                    } else {
                        across[2][i]
                    };
                    place = if best[1] & bit == 0 {
                        place
                    } else {
                        across[1][i]
                    };
                    place = if best[0] & bit == 0 {
                        place
                    } else {
                        across[0][i]
                    };
                    to[i] = if kept & bit == 0 { to[i] } else { place };
                    ends[i] = if kept & bit == 0 { ends[i] } else { place };
                }
                while of_hub != 0 {
                    let lane = of_hub.trailing_zeros() as usize;
                    of_hub &= of_hub - 1;
                    to[lane] = HUB | numbers;
                    ends[lane] = HUB | numbers;
                    numbers += 1;
                }
                let mask = L::from_bits(kept);
                L::compress_u32(&sixteen_from(from), mask, sixteen_mut(places, count));
                count += kept.count_ones() as usize;
            }
        }
        places.truncate(count);
        if self.slack() > 0.0 {
            // what is a little nearer than a candidate may seem to be none
            for &place in places.iter() {
                let to = lower[place as usize];
                if to < HUB && hub[to as usize] == NONE {
                    lower[place as usize] = HUB | numbers;
                    hub[place as usize] = HUB | numbers;
                    numbers += 1;
                }
            }
        }
        work.parent.clear();
        work.parent.extend(0..numbers);
        self.labelling = work;
    }

    /// Which of some lanes are in the core and have a neighbour that the box around the members is less far from, so that it is
    /// in the core too, and for each of the first three sides whether it leads to the best.
    #[inline(always)]
    fn inward<L: Level>(&self, chunk: &Chunk, lanes: u16) -> (u16, [u16; 3]) {
        let zero = L::all(0.0);
        let mut from = zero;
        let mut to = [zero; 4];
        for a in 0..3 {
            let (square, half) = (L::all(self.squares[a]), L::all(self.half[a]));
            let d = L::sub(L::load_i16(&chunk.k[a]), L::all(self.middle[a]));
            let most = L::add(L::max(d, L::sub(zero, d)), half);
            from = L::add(from, L::mul(square, L::mul(most, most)));
            for (to, step) in to.iter_mut().zip(&chunk.steps) {
                let d = L::add(d, L::load_i8(&step[a]));
                let most = L::add(L::max(d, L::sub(zero, d)), half);
                *to = L::add(*to, L::mul(square, L::mul(most, most)));
            }
        }
        let in_core = L::bits(L::at_most(from, L::all(self.limit * (1.0 - self.slack()))));
        let lowest = L::min(L::min(to[0], to[1]), L::min(to[2], to[3]));
        // by enough that no way can close
        let least = L::mul(from, L::all(1.0 - 10.0 * self.slack()));
        let inward = lanes & in_core & !L::bits(L::at_most(least, lowest));
        let sides = [
            L::bits(L::at_most(to[0], lowest)),
            L::bits(L::at_most(to[1], lowest)),
            L::bits(L::at_most(to[2], lowest)),
        ];
        (inward, sides)
    }

    /// Replaces what each candidate descends to by the number of the hub that this ends at.
    #[inline(always)]
    fn sink(&mut self) {
        let Labelling { hub, places, .. } = &mut self.labelling;
        // Each pass at least halves what is left of the ways, and ends those that go with its order.
        let mut on_the_way = true;
        while on_the_way {
            on_the_way = false;
            for &place in places.iter() {
                on_the_way |= step_down(hub, place);
            }
            if !on_the_way {
                break;
            }
            on_the_way = false;
            for &place in places.iter().rev() {
                on_the_way |= step_down(hub, place);
            }
        }
    }

    /// Joins the hub by neighbours within the balls of all members, and lists other neighbours that differ.
    #[inline(always)]
    fn join(&mut self) {
        let limit = self.limit * (1.0 - self.slack());
        let mut work = std::mem::take(&mut self.labelling);
        let Labelling {
            lower,
            hub,
            places,
            parent,
            pending,
            ..
        } = &mut work;
        let last = hub.len() - 1;
        let [a, b, c, d] = &self.blocks.across;
        pending.clear();
        for &place in places.iter() {
            let at = place as usize;
            let own = hub[at];
            let across = [a[at], b[at], c[at], d[at]];
            let mut differ = 0u32;
            for side in 0..4 {
                let to = across[side];
                let other = hub[(to as usize).min(last)];
                let differs = (other != own) & (other != NONE) & (to < place);
                differ |= u32::from(differs) << side;
            }
            while differ != 0 {
                let to = across[differ.trailing_zeros() as usize];
                differ &= differ - 1;
                // Where what they descend to are neighbours too, these tell the same and are in more balls.
                let (below, below_to) = (lower[at], lower[to as usize]);
                if below < HUB
                    && (self.are_neighbours(below, to) || self.are_neighbours(below, below_to))
                    || below_to < HUB && self.are_neighbours(below_to, place)
                {
                    continue;
                }
                let (own, other) = (
                    find(parent, own ^ HUB),
                    find(parent, hub[to as usize] ^ HUB),
                );
                if own == other {
                    continue;
                }
                if self.farthest(place) <= limit && self.farthest(to) <= limit {
                    unite(parent, own, other);
                } else {
                    pending.push([place, to]);
                }
            }
        }
        self.labelling = work;
    }

    /// Whether two places are neighbours; the first must be one.
    #[inline(always)]
    fn are_neighbours(&self, place: u32, other: u32) -> bool {
        let [a, b, c, d] = &self.blocks.across;
        let at = place as usize;
        (a[at] == other) | (b[at] == other) | (c[at] == other) | (d[at] == other)
    }

    /// Squared distance of a place from the farthest point of the box around the members.
    #[inline(always)]
    fn farthest(&self, place: u32) -> f32 {
        let k = self.relative(place as usize);
        let mut farthest = 0.0;
        for a in 0..3 {
            let most = (k[a] - self.half[a]).abs() + self.half[a];
            farthest += self.squares[a] * (most * most);
        }
        farthest
    }

    /// Numbers the labels, and says how many there are.
    fn name_labels(&mut self) -> usize {
        let work = &mut self.labelling;
        work.label.clear();
        let mut labels = 0;
        for number in 0..work.parent.len() as u32 {
            // the root is the first of its label
            let root = find(&mut work.parent, number);
            if root == number {
                work.label.push(labels);
                labels += 1;
            } else {
                let label = work.label[root as usize];
                work.label.push(label);
            }
        }
        work.of_members.clear();
        for &member in &self.members {
            let number = work.hub[member as usize] ^ HUB;
            work.of_members.push(work.label[number as usize]);
        }
        labels as usize
    }

    /// Lists the edges between labels that are in the ball of some member.
    #[inline(always)]
    fn list_edges<L: Level, S: Squares>(&mut self, squares: S) {
        let limit = self.ball.limit as f64;
        let mut work = std::mem::take(&mut self.labelling);
        let Labelling {
            hub,
            label,
            pending,
            edges,
            centres,
            ..
        } = &mut work;
        for centres in centres.iter_mut() {
            centres.clear();
        }
        for &member in &self.members {
            let centre = self.relative(member as usize);
            for a in 0..3 {
                centres[a].push(centre[a]);
            }
        }
        let padded = self.members.len().next_multiple_of(LANES);
        for centres in centres.iter_mut() {
            centres.resize(padded, NOWHERE);
        }
        edges.clear();
        for &[one, other] in pending.iter() {
            let labels = [
                label[(hub[one as usize] ^ HUB) as usize],
                label[(hub[other as usize] ^ HUB) as usize],
            ];
            if labels[0] == labels[1] {
                continue;
            }
            let (p, q) = (self.relative(one as usize), self.relative(other as usize));
            let p = [L::all(p[0]), L::all(p[1]), L::all(p[2])];
            let q = [L::all(q[0]), L::all(q[1]), L::all(q[2])];
            let mut members = Column::default();
            let mut some = 0;
            for from in (0..padded).step_by(LANES) {
                let x = L::load(sixteen(&centres[0], from));
                let y = L::load(sixteen(&centres[1], from));
                let z = L::load(sixteen(&centres[2], from));
                let to_p = squares.of::<L>([L::sub(p[0], x), L::sub(p[1], y), L::sub(p[2], z)]);
                let to_q = squares.of::<L>([L::sub(q[0], x), L::sub(q[1], y), L::sub(q[2], z)]);
                let inside = L::bits(L::and(
                    S::at_most::<L>(to_p, limit),
                    S::at_most::<L>(to_q, limit),
                ));
                some |= inside;
                members[from / 64] |= u64::from(inside) << (from % 64);
            }
            if some != 0 {
                edges.push(Edge { labels, members });
            }
        }
        self.labelling = work;
    }

    /// Finds which labels are connected to each member, for all members at once: a bit of a column goes over the edges
    /// that have it.
    #[inline(always)]
    fn reach_labels(&mut self, labels: usize) {
        let Labelling {
            edges,
            columns,
            of_members,
            ..
        } = &mut self.labelling;
        columns.clear();
        columns.resize(labels, Column::default());
        for (number, &own) in of_members.iter().enumerate() {
            columns[own as usize][number / 64] |= 1 << (number % 64);
        }
        if of_members.len() <= 64 {
            spread::<1>(edges, columns);
        } else {
            spread::<{ MOST_MEMBERS.div_ceil(64) }>(edges, columns);
        }
    }

    /// Names labels: those that are connected to the same members have one name, 0 if that are all of them, and those
    /// connected to none have none.
    fn name_classes(&mut self) {
        let work = &mut self.labelling;
        let mut all = Column::default();
        for number in 0..self.members.len() {
            all[number / 64] |= 1 << (number % 64);
        }
        let columns = &work.columns;
        work.mixed.clear();
        work.class.clear();
        let mut some_have_all = false;
        for (label, column) in columns.iter().enumerate() {
            let mut class = NONE;
            if *column == all {
                class = 0;
                some_have_all = true;
            } else if *column != Column::default() {
                work.mixed.push(label as u32);
            }
            work.class.push(class);
        }
        work.mixed
            .sort_unstable_by_key(|&label| columns[label as usize]);
        work.classes.clear();
        if some_have_all {
            work.classes.push(all);
        }
        for &label in &work.mixed {
            let column = columns[label as usize];
            if work.classes.last() != Some(&column) {
                work.classes.push(column);
            }
            work.class[label as usize] = work.classes.len() as u32 - 1;
        }
        self.labels = None;
        self.alive.clear();
        if !work.mixed.is_empty() {
            self.labels = Some(work.classes.len());
            for number in 0..self.members.len() {
                for column in &work.classes {
                    let bits = column[number / 64] >> (number % 64);
                    self.alive.push((bits & 1) as u32);
                }
            }
        }
        for label in &mut work.label {
            if *label != NONE {
                *label = work.class[*label as usize];
            }
        }
    }

    /// Leaves the candidates of the first class in their lists.
    #[inline(always)]
    fn sort_by_class<L: Level>(&mut self) {
        let Labelling { hub, label, .. } = &self.labelling;
        if label.iter().all(|&class| class == 0) {
            return;
        }
        let last = label.len() - 1;
        for (list, labelled) in self.lists.iter_mut().zip(&mut self.labelled) {
            let len = list.len;
            list.clear();
            for from in (0..len).step_by(LANES) {
                let places = sixteen(&list.place, from);
                let mut classes = [0; LANES];
                for i in 0..LANES {
                    // what fills the list up may be no candidate
                    let number = (hub[places[i] as usize] ^ HUB) as usize;
                    classes[i] = label[number.min(last)];
                }
                let all = lanes_of(&(0..len), from);
                let main = L::bits(L::equal(&classes, 0)) & all;
                let apart = L::bits(L::equal(&classes, NONE)) & all;
                self.apart.move_from::<L>(list, from, &classes, apart);
                labelled.move_from::<L>(list, from, &classes, all & !main & !apart);
                list.keep::<L>(from, main);
            }
            list.pad();
            labelled.pad();
        }
        self.apart.pad();
    }
}

/// Replaces what a candidate descends to by what that descends to; whether this is a place again.
#[inline(always)]
fn step_down(hub: &mut [u32], place: u32) -> bool {
    let to = hub[place as usize];
    let from = if to < HUB { to } else { place };
    let to = hub[from as usize];
    hub[place as usize] = to;
    to < HUB
}

/// Carries the bits of columns over edges until nothing changes, of the first words of each: most groups have no more
/// members than a word has bits.
#[inline(always)]
fn spread<const WORDS: usize>(edges: &[Edge], columns: &mut [Column]) {
    // to and fro, since edges are about in the order of places
    while spread_once::<WORDS>(edges.iter(), columns)
        && spread_once::<WORDS>(edges.iter().rev(), columns)
    {}
}

/// Carries the bits of columns over each edge once; whether any is new.
#[inline(always)]
fn spread_once<'a, const WORDS: usize>(
    edges: impl Iterator<Item = &'a Edge>,
    columns: &mut [Column],
) -> bool {
    let mut new = 0;
    for edge in edges {
        let [a, b] = [edge.labels[0] as usize, edge.labels[1] as usize];
        for word in 0..WORDS {
            let (of_a, of_b) = (columns[a][word], columns[b][word]);
            let differ = (of_a ^ of_b) & edge.members[word];
            columns[a][word] = of_a | differ;
            columns[b][word] = of_b | differ;
            new |= differ;
        }
    }
    new != 0
}
