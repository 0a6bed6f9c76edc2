//! The part of the surface in a ball that is connected to a surfel: C(p).
//!
//! W(p) is the set of surfels whose centroid is in the closed ball around the centroid of p; C(p)
//! is what a breadth-first walk through split linels reaches from p without leaving W(p). The
//! test is in integers, so the set is the same whatever the box it was computed in.

use crate::lattice::Ball;

use super::index::Surfels;
use super::links::{Link, Links};

/// Scratch memory of walks over the surfels of one box.
#[derive(Clone, Debug, Default)]
pub struct Walker {
    stamp: Vec<u32>,
    epoch: u32,
    queue: Vec<u32>,
}

/// How the walk over C(p) ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rim {
    /// Some side of C(p) leads out of the ball.
    pub cut_by_ball: bool,
    /// Some side of C(p) is on the border of an open image.
    pub open: bool,
}

impl Rim {
    /// Of a part without a boundary.
    pub(crate) const CLOSED: Self = Self {
        cut_by_ball: false,
        open: false,
    };

    /// C(p) has no boundary: a closed surface within the ball.
    #[must_use]
    pub fn is_island(self) -> bool {
        !self.cut_by_ball && !self.open
    }
}

impl Walker {
    /// Walks over C(`start`), which is left in [`Self::part`], nearest in steps first. `ball` is in
    /// Khalimsky coordinates, and the box must cover all surfels in it.
    #[inline(always)]
    pub fn walk(&mut self, surfels: &Surfels, links: &Links, ball: &Ball, start: usize) -> Rim {
        let centre = surfels.list[start].k;
        self.walk_where(links, surfels.list.len(), start, |n| {
            ball.contains(displacement(surfels.list[n].k, centre))
        })
    }

    /// Walks over the surfels for which `belongs` holds and which are reached from `start` through
    /// such surfels. `belongs` is asked once for each surfel, `start` first.
    #[inline(always)]
    pub fn walk_where(
        &mut self,
        links: &Links,
        count: usize,
        start: usize,
        mut belongs: impl FnMut(usize) -> bool,
    ) -> Rim {
        if self.stamp.len() < count || self.epoch == u32::MAX {
            self.stamp.clear();
            self.stamp.resize(count, 0);
            self.epoch = 0;
        }
        self.epoch += 1;
        let epoch = self.epoch;
        let mut rim = Rim::CLOSED;
        self.queue.clear();
        self.stamp[start] = epoch;
        if belongs(start) {
            self.queue.push(start as u32);
        }
        let mut next = 0;
        while next < self.queue.len() {
            let i = self.queue[next] as usize;
            next += 1;
            for link in links.of[i] {
                let Some(n) = link.surfel() else {
                    if link == Link::BORDER {
                        rim.open = true;
                    } else {
                        rim.cut_by_ball = true;
                    }
                    continue;
                };
                if self.stamp[n] == epoch {
                    continue;
                }
                self.stamp[n] = epoch;
                if belongs(n) {
                    self.queue.push(n as u32);
                } else {
                    rim.cut_by_ball = true;
                }
            }
        }
        rim
    }

    /// The surfels of the last walk, in the order they were reached.
    #[inline]
    #[must_use]
    pub fn part(&self) -> &[u32] {
        &self.queue
    }
}

/// Displacement between two places of one box, in Khalimsky coordinates.
#[inline]
#[must_use]
pub fn displacement(to: [i16; 3], from: [i16; 3]) -> [i32; 3] {
    [
        i32::from(to[0]) - i32::from(from[0]),
        i32::from(to[1]) - i32::from(from[1]),
        i32::from(to[2]) - i32::from(from[2]),
    ]
}
