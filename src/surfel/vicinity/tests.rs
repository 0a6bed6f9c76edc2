//! The sets against those of a walk, on random solids, hairs and thin sheets.

use std::sync::Arc;

use proptest::prelude::*;

use super::super::squares::{Boxes, Cubes, Squares};
use super::super::walk::Walker;
use super::super::{CellBox, Links, SurfelIndex, Surfels};
use super::*;
use crate::khalimsky::Adjacency;
use crate::lattice::Lattice;
use crate::simd::{Work, at_every_level};
use crate::volume::{BitBox, BitPlane, PlaneWindow};

/// What of the candidates is in the ball of each member and counts, and how C(p) ends; by surfel.
struct Sets<'a, S> {
    blocks: &'a Blocks,
    ball: Ball,
    squares: S,
    most_searched: usize,
}

/// By surfel: C(p), its rim, and whether W(p) has more.
type Found = Vec<(usize, Vec<u32>, Rim, bool)>;

impl<S: Squares> Work for Sets<'_, S> {
    type Output = Found;

    #[inline(always)]
    fn run<L: Level>(self) -> Found {
        let Self {
            blocks,
            ball,
            squares,
            most_searched,
        } = self;
        let surfels = blocks.order();
        let mut found = Vec::new();
        let tags: Vec<u32> = (0..blocks.len() + LANES)
            .map(|place| u32::from(place < blocks.len() && blocks.is_open(place)))
            .collect();
        let near = ball.limit / 2;
        let mut vicinity = Vicinity::<2>::new(blocks, ball);
        vicinity.most_searched = most_searched;
        let groups = Groups::of(blocks, |_| true);
        for group in 0..groups.len() {
            let members = groups.members(group);
            vicinity.gather::<L>(members, &tags, Sort::Near(near));
            vicinity.connect::<L, S>(squares);
            for (m, &member) in members.iter().enumerate() {
                let centre = vicinity.relative(member as usize);
                let inside = |list: &Candidates, at: usize| {
                    let k = list.k(at);
                    let d = [0, 1, 2].map(|a| (k[a] - centre[a]) as i32);
                    ball.contains(d)
                };
                let connected = vicinity.connected(m);
                let (mut part, mut in_ball, mut open) = (Vec::new(), 0, 0);
                for (number, list) in vicinity.lists().iter().enumerate() {
                    for at in (0..list.len).filter(|&at| inside(list, at)) {
                        in_ball += 1;
                        if connected.main {
                            part.push(surfels[list.place[at] as usize]);
                            open += list
                                .tagged(at / LANES)
                                .map_or(0, |t| u32::from(t[0] >> (at % LANES) & 1));
                        }
                        // those far from all members are not near to one
                        let k = list.k(at);
                        let d = [0, 1, 2].map(|a| (k[a] - centre[a]) as i32);
                        assert!(number == 0 || ball.metric.squared(d) > near);
                    }
                }
                for list in vicinity.labelled() {
                    for at in (0..list.len).filter(|&at| inside(list, at)) {
                        in_ball += 1;
                        if connected.labels[list.label[at] as usize] == 1 {
                            part.push(surfels[list.place[at] as usize]);
                            open += list
                                .tagged(at / LANES)
                                .map_or(0, |t| u32::from(t[0] >> (at % LANES) & 1));
                        }
                    }
                }
                let apart = vicinity.apart();
                in_ball += (0..apart.len).filter(|&at| inside(apart, at)).count();
                for &place in vicinity.excluded(m) {
                    let surfel = surfels[place as usize];
                    let at = part.iter().position(|&q| q == surfel).expect("was counted");
                    part.swap_remove(at);
                    open -= tags[place as usize];
                }
                let open = open > 0;
                part.sort_unstable();
                let rim = vicinity.rim(m, part.len() as u32, open);
                let several = in_ball > part.len();
                found.push((surfels[member as usize] as usize, part, rim, several));
            }
        }
        found.sort_by_key(|f| f.0);
        found
    }
}

fn check(
    dims: [u32; 3],
    inside: &[bool],
    spacing: [f64; 3],
    radius: f64,
    closed: bool,
    adjacency: Adjacency,
) {
    let lattice = Lattice::new(dims.map(u64::from), spacing, closed).unwrap();
    let mut planes = Vec::new();
    for plane in inside.chunks((dims[0] * dims[1]) as usize) {
        let mut bits = BitPlane::outside(dims[0], dims[1]);
        for (row, out) in plane.chunks(dims[0] as usize).zip(bits.rows_mut()) {
            for (x, _) in row.iter().enumerate().filter(|(_, on)| **on) {
                out[x / 64] |= 1 << (x % 64);
            }
        }
        planes.push(Arc::new(bits));
    }
    let window = PlaneWindow {
        dims,
        z0: 0,
        planes,
    };
    let cells = CellBox {
        lo: [0; 3],
        hi: lattice.cell_dims(),
    };
    let bits = BitBox::cut(&window, [-1; 3], cells.hi.map(|c| c + 1));
    let index = SurfelIndex::find(&bits, cells, &lattice);
    let surfels = Surfels::list(&index, &bits);
    let links = Links::join(&index, &surfels, &bits, &lattice, adjacency);
    let blocks = Blocks::sort(cells.size(), &surfels, &links);
    let ball = lattice.metric().khalimsky_ball(radius).unwrap();
    // searches that are long enough, and so short that labels have to tell
    for most_searched in [SEARCHED, 1] {
        let levels = if ball.metric.is_cubic() {
            at_every_level(|| Sets {
                blocks: &blocks,
                ball,
                squares: Cubes,
                most_searched,
            })
        } else {
            at_every_level(|| Sets {
                blocks: &blocks,
                ball,
                squares: Boxes::of_ball(&ball),
                most_searched,
            })
        };
        for found in levels {
            compare(&surfels, &links, &ball, found);
        }
    }
}

/// Compares with walks.
fn compare(surfels: &Surfels, links: &Links, ball: &Ball, found: Found) {
    assert_eq!(found.len(), surfels.list.len());
    let mut walker = Walker::default();
    for (start, part, rim, several) in found {
        let expected = walker.walk(surfels, links, ball, start);
        let mut reached = walker.part().to_vec();
        reached.sort_unstable();
        assert_eq!(part, reached, "C of surfel {start}");
        assert_eq!(rim, expected, "rim of surfel {start}");
        let centre = surfels.list[start].k;
        let in_ball = (surfels.list.iter())
            .filter(|q| ball.contains(super::super::walk::displacement(q.k, centre)))
            .count();
        assert_eq!(several, in_ball > reached.len(), "sheets at surfel {start}");
    }
}

/// A solid with holes, handles, islands and walls: random where `share` says, a ball elsewhere.
fn solid(dims: [u32; 3], seed: u64, share: u64) -> Vec<bool> {
    let mut state = seed | 1;
    let mut random = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) % 100
    };
    let mut inside = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let [x, y, z] = [x, y, z].map(|c| f64::from(c) + 0.3);
                let middle = dims.map(|n| f64::from(n) / 2.0);
                let d = (x - middle[0]).hypot(y - middle[1]).hypot(z - middle[2]);
                let sheet = ((d / 2.5) as u64).is_multiple_of(2);
                inside.push(if random() < share {
                    random() < 50
                } else {
                    sheet
                });
            }
        }
    }
    inside
}

/// A gyroid: one sheet that comes near itself again and again.
fn folds(dims: [u32; 3], period: f64) -> Vec<bool> {
    let turn = std::f64::consts::TAU / period;
    let mut inside = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let [x, y, z] = [x, y, z].map(|c| f64::from(c) * turn);
                let g = x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos();
                inside.push(g > 0.0);
            }
        }
    }
    inside
}

/// Random walks, one voxel thick.
fn hairball(dims: [u32; 3], seed: u64, hairs: usize) -> Vec<bool> {
    let mut state = seed | 1;
    let mut random = |below: u32| {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as u32 % below
    };
    let mut inside = vec![false; dims.iter().product::<u32>() as usize];
    for _ in 0..hairs {
        let mut at = dims.map(&mut random);
        let (mut a, mut up) = (0, true);
        for _ in 0..40 {
            if random(4) == 0 {
                (a, up) = (random(3) as usize, random(2) == 0);
            }
            at[a] = if up {
                at[a] + 1
            } else {
                at[a].saturating_sub(1)
            }
            .min(dims[a] - 1);
            inside[((at[2] * dims[1] + at[1]) * dims[0] + at[0]) as usize] = true;
        }
    }
    inside
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn sets_are_those_of_a_walk(
        dims in [3u32..22, 3u32..18, 3u32..14],
        seed in any::<u64>(),
        share in prop::sample::select(vec![0u64, 3, 10, 30, 100]),
        radius in 1.0f64..9.0,
        spacing in prop::sample::select(vec![[1.0; 3], [1.0; 3], [1.0, 0.7, 1.4], [0.25, 1.0, 1.0], [1.0, 1.0, 0.01]]),
        closed in any::<bool>(),
        exterior in any::<bool>(),
    ) {
        let adjacency = if exterior { Adjacency::Exterior } else { Adjacency::Interior };
        check(dims, &solid(dims, seed, share), spacing, radius, closed, adjacency);
    }
    #[test]
    fn sets_among_hairs_and_thin_sheets_are_those_of_a_walk(
        dims in [8u32..26, 8u32..22, 8u32..18],
        seed in any::<u64>(),
        hairs in prop::sample::select(vec![0usize, 6, 20, 60]),
        period in 2.5f64..9.0,
        radius in 2.0f64..10.0,
        spacing in prop::sample::select(vec![[1.0; 3], [1.0; 3], [1.0, 0.7, 1.4]]),
        exterior in any::<bool>(),
    ) {
        let adjacency = if exterior { Adjacency::Exterior } else { Adjacency::Interior };
        let inside = if hairs == 0 { folds(dims, period) } else { hairball(dims, seed, hairs) };
        check(dims, &inside, spacing, radius, true, adjacency);
    }
}
