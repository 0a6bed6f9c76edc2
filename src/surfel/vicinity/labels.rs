//! Labels of candidates, where searches do not tell what is connected to the members of a group; see [`super`].

use crate::simd::{LANES, Level, dot};

use super::super::blocks::{NONE, find, unite};
use super::super::squares::Squares;
use super::Vicinity;
use super::candidates::{NOWHERE, sixteen, sixteen_mut};

/// No side leads nearer to all members.
const NO_SIDE: u8 = 4;

/// Pairs of neighbours of different labels.
#[derive(Clone, Debug, Default)]
struct Edges {
    labels: Vec<[u32; 2]>,
    /// Coordinates of both, padded.
    k: [[Vec<f32>; 3]; 2],
}

/// Scratch memory of labelling.
#[derive(Debug, Default)]
pub(super) struct Labelling {
    /// By place, the side that leads nearer to all members, or [`NO_SIDE`] and above.
    sides: Vec<u8>,
    /// By candidate, numbered through the padded lists: its place or [`NONE`].
    places: Vec<u32>,
    parent: Vec<u32>,
    root: Vec<u32>,
    /// Which are in the balls of all members, sixteen a number.
    core: Vec<u16>,
    label: Vec<u32>,
    counts: Vec<u32>,
    /// Neighbours of different roots that are not both in the core.
    pending: Vec<[u32; 2]>,
    edges: Edges,
    /// Labels of the members.
    of_members: Vec<u32>,
    joined: Vec<u32>,
    /// The candidate at each place, else [`NONE`].
    slots: Vec<u32>,
    /// By old label, the new one.
    renamed: Vec<u32>,
}

impl<const LISTS: usize> Vicinity<'_, LISTS> {
    /// Labels the candidates if that is needed to tell which are connected to the members. `squares` are those of the ball.
    #[inline(always)]
    pub(crate) fn connect<L: Level, S: Squares>(&mut self, squares: S) {
        if self.passed.last() == Some(&true) {
            return;
        }
        // Which of those that passed had something excluded?
        let mut from = 0;
        for (passed, &to) in self.passed.iter_mut().zip(&self.excluded_to) {
            *passed &= to == from;
            from = to;
        }
        self.passed.resize(self.members.len(), false);
        self.excluded.clear();
        self.excluded_to.clear();
        self.descend::<L>();
        self.find_core::<L>();
        self.label();
        let Some(labels) = self.labels else {
            return;
        };
        self.alive.clear();
        self.alive.resize(self.members.len() * labels, 1);
        let limit = self.ball.limit as f64;
        for number in 0..self.members.len() {
            if self.passed[number] {
                continue;
            }
            let centre = self.relative(self.members[number] as usize);
            let centre = [L::all(centre[0]), L::all(centre[1]), L::all(centre[2])];
            let joined = &mut self.labelling.joined;
            joined.clear();
            joined.extend(0..labels as u32);
            let mut apart = labels;
            let Edges { labels: pairs, k } = &self.labelling.edges;
            for i in 0..pairs.len().div_ceil(LANES) {
                let mut inside = u16::MAX;
                for k in k {
                    let square = squares.of::<L>([
                        L::sub(L::load(sixteen(&k[0], i * LANES)), centre[0]),
                        L::sub(L::load(sixteen(&k[1], i * LANES)), centre[1]),
                        L::sub(L::load(sixteen(&k[2], i * LANES)), centre[2]),
                    ]);
                    inside &= L::bits(S::at_most::<L>(square, limit));
                }
                while inside != 0 {
                    let [a, b] = pairs[i * LANES + inside.trailing_zeros() as usize];
                    inside &= inside - 1;
                    let (a, b) = (find(joined, a), find(joined, b));
                    if a != b {
                        joined[a.max(b) as usize] = a.min(b);
                        apart -= 1;
                    }
                }
                if apart == 1 {
                    break;
                }
            }
            if apart == 1 {
                continue;
            }
            let own = find(joined, self.labelling.of_members[number]);
            for label in 0..labels {
                let alive = find(joined, label as u32) == own;
                self.alive[number * labels + label] = u32::from(alive);
            }
        }
    }

    /// Which side of each surfel leads nearer to all members.
    #[inline(always)]
    fn descend<L: Level>(&mut self) {
        let sides = &mut self.labelling.sides;
        sides.resize(self.blocks.chunks.len() * LANES, NO_SIDE);
        let descent = L::all(-self.descent);
        for run in &self.runs {
            for number in run.start / LANES..run.end.div_ceil(LANES) {
                let chunk = &self.blocks.chunks[number];
                let mut scaled = [L::all(0.0); 3];
                for a in 0..3 {
                    let d = L::sub(L::load_i16(&chunk.k[a]), L::all(self.middle[a]));
                    scaled[a] = L::mul(L::all(self.squares[a]), d);
                }
                let mut lowest = L::all(0.0);
                let mut changes = [lowest; 4];
                for (change, step) in changes.iter_mut().zip(&chunk.steps) {
                    let step = [
                        L::load_i8(&step[0]),
                        L::load_i8(&step[1]),
                        L::load_i8(&step[2]),
                    ];
                    *change = dot::<L>(step, scaled);
                    lowest = L::min(*change, lowest);
                }
                let hub = L::bits(L::at_most(descent, lowest));
                let mut best = [0u16; 4];
                for side in 0..4 {
                    best[side] = L::bits(L::at_most(changes[side], lowest));
                }
                let to = sixteen_mut(sides, number * LANES);
                for (i, to) in to.iter_mut().enumerate() {
                    let is = |bits: u16| (bits >> i & 1) as u8;
                    // the first of the best sides
                    let side =
                        (1 - is(best[0])) * (1 + (1 - is(best[1])) * (1 + (1 - is(best[2]))));
                    *to = side | (is(hub) * NO_SIDE);
                }
            }
        }
    }

    /// Numbers the candidates, and finds those that are in the balls of all members.
    #[inline(always)]
    fn find_core<L: Level>(&mut self) {
        let limit = L::all(self.limit * (1.0 - self.slack()));
        let work = &mut self.labelling;
        work.core.clear();
        work.places.clear();
        for list in &self.lists {
            for i in 0..list.padded() / LANES {
                let mut farthest = L::all(0.0);
                for (a, k) in [&list.x, &list.y, &list.z].into_iter().enumerate() {
                    let half = L::all(self.half[a]);
                    let d = L::sub(L::load(sixteen(k, i * LANES)), half);
                    let most = L::add(L::max(d, L::sub(L::all(0.0), d)), half);
                    let square = L::mul(L::all(self.squares[a]), L::mul(most, most));
                    farthest = L::add(farthest, square);
                }
                work.core.push(L::bits(L::at_most(farthest, limit)));
            }
            work.places.extend_from_slice(&list.place[..list.len]);
            work.places.resize(work.core.len() * LANES, NONE);
        }
    }

    /// Labels candidates by what connects them within the balls of all members, and takes those that have another
    /// label than most out of their lists.
    fn label(&mut self) {
        let blocks = self.blocks;
        let origin = self.origin;
        let work = &mut self.labelling;
        work.slots.resize(blocks.len(), NONE);
        for (slot, &place) in work.places.iter().enumerate() {
            if place != NONE {
                work.slots[place as usize] = slot as u32;
            }
        }
        work.parent.clear();
        for (own, &place) in work.places.iter().enumerate() {
            let mut lower = NONE;
            if place != NONE {
                let side = work.sides[place as usize];
                if side < NO_SIDE {
                    let across = blocks.across[side as usize][place as usize];
                    lower = work.slots[across as usize];
                }
            }
            work.parent
                .push(if lower == NONE { own as u32 } else { lower });
        }
        work.root.clear();
        for own in 0..work.places.len() as u32 {
            let root = find(&mut work.parent, own);
            work.root.push(root);
        }
        work.pending.clear();
        let is_core = |core: &[u16], c: usize| core[c / LANES] >> (c % LANES) & 1 == 1;
        for (own, &place) in work.places.iter().enumerate() {
            if place == NONE {
                continue;
            }
            for &across in blocks.earlier(place as usize) {
                let other = work.slots[across as usize];
                if other == NONE || work.root[other as usize] == work.root[own] {
                    continue;
                }
                if is_core(&work.core, own) && is_core(&work.core, other as usize) {
                    unite(&mut work.parent, work.root[own], work.root[other as usize]);
                } else {
                    work.pending.push([own as u32, other]);
                }
            }
        }
        // Number the labels, at the roots first.
        work.label.clear();
        work.label.resize(work.places.len(), NONE);
        work.counts.clear();
        for (own, &place) in work.places.iter().enumerate() {
            if place == NONE {
                continue;
            }
            let root = find(&mut work.parent, work.root[own]) as usize;
            if work.label[root] == NONE {
                work.label[root] = work.counts.len() as u32;
                work.counts.push(0);
            }
            let label = work.label[root];
            work.label[own] = label;
            work.counts[label as usize] += 1;
        }
        work.of_members.clear();
        for &member in &self.members {
            let slot = work.slots[member as usize] as usize;
            work.of_members.push(work.label[slot]);
        }
        for &place in &work.places {
            if place != NONE {
                work.slots[place as usize] = NONE;
            }
        }
        if work.counts.len() == 1 {
            return;
        }
        let label = &work.label;
        let labels = |pair: &[u32; 2]| pair.map(|slot| label[slot as usize]);
        work.pending.retain(|pair| {
            let [a, b] = labels(pair);
            a != b
        });
        work.edges.labels.clear();
        work.edges.labels.extend(work.pending.iter().map(labels));
        self.name_labels();
        let work = &mut self.labelling;
        // Edges of labels that nobody reaches have none.
        for (end, k) in work.edges.k.iter_mut().enumerate() {
            for (a, list) in k.iter_mut().enumerate() {
                list.clear();
                let kept = work.pending.iter().zip(&work.edges.labels);
                list.extend(
                    kept.filter(|(_, labels)| labels[0] != NONE)
                        .map(|(pair, _)| {
                            let place = work.places[pair[end] as usize] as usize;
                            (i32::from(blocks.k_at(place)[a]) - origin[a]) as f32
                        }),
                );
                list.resize(list.len().next_multiple_of(LANES), NOWHERE);
            }
        }
        work.edges.labels.retain(|labels| labels[0] != NONE);
        self.sort_by_label();
    }

    /// Numbers the labels that members can reach, that of the most candidates first.
    fn name_labels(&mut self) {
        let work = &mut self.labelling;
        let labels = work.counts.len();
        work.joined.clear();
        work.joined.extend(0..labels as u32);
        for &[a, b] in &work.edges.labels {
            unite(&mut work.joined, a, b);
        }
        work.renamed.clear();
        work.renamed.resize(labels, NONE);
        for &label in &work.of_members {
            let root = find(&mut work.joined, label);
            work.renamed[root as usize] = 0;
        }
        for label in 0..labels {
            let root = find(&mut work.joined, label as u32) as usize;
            work.renamed[label] = work.renamed[root];
        }
        let reached = |label: usize| work.renamed[label] == 0;
        let main = (0..labels)
            .filter(|&l| reached(l))
            .max_by_key(|&l| work.counts[l]);
        let mut next = 0;
        for label in 0..labels {
            if Some(label) != main && work.renamed[label] == 0 {
                next += 1;
                work.renamed[label] = next;
            }
        }
        for label in &mut work.of_members {
            *label = work.renamed[*label as usize];
        }
        let renamed = &work.renamed;
        for labels in &mut work.edges.labels {
            *labels = labels.map(|l| renamed[l as usize]);
        }
        self.labels = Some(next as usize + 1);
    }

    /// Leaves the candidates of the first label in their lists.
    fn sort_by_label(&mut self) {
        let work = &self.labelling;
        let mut first = 0;
        for (list, labelled) in self.lists.iter_mut().zip(&mut self.labelled) {
            let mut kept = 0;
            let end = first + list.padded();
            for at in 0..list.len {
                let label = work.renamed[work.label[first + at] as usize];
                let (k, place, tag) = (list.k(at), list.place[at], list.tag[at]);
                match label {
                    0 => {
                        list.set(kept, k, place, tag);
                        kept += 1;
                    }
                    NONE => self.apart.push(k, place, tag),
                    _ => labelled.push_labelled(k, place, tag, label),
                }
            }
            first = end;
            list.len = kept;
            list.pad();
            labelled.pad();
        }
        self.apart.pad();
    }
}
