//! The surfels around a surfel: those connected to it inside a ball, or all.
//!
//! In: a surface, a centre, a rule that tells which surfels belong. Out: the members,
//! and how their set ends. No allocation from one walk to the next.

use super::solid::LatticeBall;
use super::surface::{OPEN, Surface, minus};

/// The members of one ball after another.
#[derive(Clone, Debug)]
pub struct Walk<'s> {
    surface: &'s Surface,
    /// Surfel i is a member if `marks[i] == round`.
    marks: Vec<u32>,
    round: u32,
    /// The members, the centre first if the ball is connected.
    pub members: Vec<u32>,
    /// Has a member an open side?
    pub meets_border: bool,
    /// Has a member a neighbour that does not belong?
    pub meets_rim: bool,
}

impl<'s> Walk<'s> {
    /// Room for the balls of `surface`.
    pub fn new(surface: &'s Surface) -> Self {
        Walk {
            surface,
            marks: vec![0; surface.len()],
            round: 0,
            members: Vec::with_capacity(surface.len()),
            meets_border: false,
            meets_rim: false,
        }
    }

    /// Is the surfel a member of the present ball?
    pub fn has(&self, surfel: u32) -> bool {
        self.marks[surfel as usize] == self.round
    }

    /// C(p): the surfels reached from `centre` through neighbours that belong.
    pub fn connected(&mut self, centre: u32, belongs: impl Fn(u32) -> bool) {
        self.clear();
        self.add(centre);
        let mut next = 0;
        while next < self.members.len() {
            let f = self.members[next] as usize;
            next += 1;
            for g in self.surface.neighbours[f] {
                if g == OPEN {
                    self.meets_border = true;
                } else if !self.has(g) {
                    if belongs(g) {
                        self.add(g);
                    } else {
                        self.meets_rim = true;
                    }
                }
            }
        }
    }

    /// W(p): all surfels that belong, of those within `reach` of `centre` along each axis.
    pub fn whole(&mut self, centre: u32, reach: [i32; 3], belongs: impl Fn(u32) -> bool) {
        self.clear();
        let surface = self.surface;
        for_each_within(surface, centre, reach, |g| {
            if belongs(g) {
                self.add(g);
            }
        });
    }

    fn clear(&mut self) {
        self.round += 1;
        self.members.clear();
        self.meets_border = false;
        self.meets_rim = false;
    }

    fn add(&mut self, surfel: u32) {
        self.marks[surfel as usize] = self.round;
        self.members.push(surfel);
    }
}

/// Calls `visit` with the surfels within `reach` of `centre` along each axis (Khalimsky coordinates).
pub fn for_each_within(
    surface: &Surface,
    centre: u32,
    reach: [i32; 3],
    mut visit: impl FnMut(u32),
) {
    let k = surface.surfels[centre as usize].k;
    for kz in k[2] - reach[2]..=k[2] + reach[2] {
        for ky in k[1] - reach[1]..=k[1] + reach[1] {
            let row = surface.row(ky, kz);
            let surfels = &surface.surfels[row.start as usize..row.end as usize];
            let skipped = surfels.partition_point(|s| s.k[0] < k[0] - reach[0]);
            for (i, s) in surfels.iter().enumerate().skip(skipped) {
                if s.k[0] > k[0] + reach[0] {
                    break;
                }
                visit(row.start + i as u32);
            }
        }
    }
}

/// Is the centroid of surfel `g` in the ball around the centroid of `centre`?
pub fn in_ball(surface: &Surface, ball: &LatticeBall, centre: u32, g: u32) -> bool {
    ball.has(minus(
        surface.surfels[g as usize].k,
        surface.surfels[centre as usize].k,
    ))
}

/// How far a ball extends along each axis.
pub fn ball_reach(ball: &LatticeBall) -> [i32; 3] {
    [0, 1, 2].map(|axis| ball.half_width(axis, 0).unwrap_or(0))
}
