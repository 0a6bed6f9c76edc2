//! Cells of the cubical grid in Khalimsky (doubled) coordinates, and how they meet.
//!
//! Voxel `p` is the cell `2p + 1`. A coordinate is odd where the cell extends along that axis and
//! even where it does not: voxels have three odd coordinates, surfels one even, linels two even,
//! pointels three even.
//!
//! ```text
//!          K = 0   1   2   3   4          the image border is at K = 0 and K = 2 * dim
//!              +---+---+---+---+
//!              | voxel | voxel |
//!              |   0   |   1   |
//!              +-------+-------+          the surfel between voxels 0 and 1 has K = 2
//! ```
//!
//! A surfel is *oriented*: it has an inner voxel (inside the solid) and an outer voxel. Its four
//! sides (linels) are numbered counter-clockwise as seen from outside; corner `j` is the pointel
//! where side `j` ends and side `j + 1` begins.

/// A direction along an axis: `2 * axis`, plus one if negative. Also the orientation of a surfel,
/// the direction from its inner to its outer voxel.
pub type Direction = u8;

/// The axis of a direction: 0, 1 or 2.
#[inline]
#[must_use]
pub const fn axis(direction: Direction) -> usize {
    (direction >> 1) as usize
}

/// +1 or -1.
#[inline]
#[must_use]
pub const fn sign(direction: Direction) -> i32 {
    1 - 2 * (direction & 1) as i32
}

/// The direction the other way.
#[inline]
#[must_use]
pub const fn opposite(direction: Direction) -> Direction {
    direction ^ 1
}

/// The unit step along a direction.
#[inline]
#[must_use]
pub const fn step(direction: Direction) -> [i32; 3] {
    let mut step = [0; 3];
    step[axis(direction)] = sign(direction);
    step
}

/// `SIDES[o][j]`: the direction in which side `j` of a surfel of orientation `o` lies, from its
/// centre. Counter-clockwise as seen from outside, so side `j` is traversed in the direction
/// `SIDES[o][(j + 1) % 4]`.
pub const SIDES: [[Direction; 4]; 6] = {
    let mut sides = [[0; 4]; 6];
    let mut o = 0;
    while o < 6 {
        let a = axis(o as Direction) as u8;
        let (b, c) = if sign(o as Direction) > 0 {
            ((a + 1) % 3, (a + 2) % 3)
        } else {
            ((a + 2) % 3, (a + 1) % 3)
        };
        sides[o] = [2 * b, 2 * c, 2 * b + 1, 2 * c + 1];
        o += 1;
    }
    sides
};

/// `SIDE_TOWARDS[o][d]`: which side of a surfel of orientation `o` lies in direction `d`, the
/// inverse of [`SIDES`]; 4 where `d` is along the surfel's own axis.
pub const SIDE_TOWARDS: [[u8; 6]; 6] = {
    let mut inverse = [[4; 6]; 6];
    let mut o = 0;
    while o < 6 {
        let mut j = 0;
        while j < 4 {
            inverse[o][SIDES[o][j] as usize] = j as u8;
            j += 1;
        }
        o += 1;
    }
    inverse
};

/// Which surfels join at a linel shared by four.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Adjacency {
    /// The surfels of one inside voxel join: the solid is 6-connected, the outside 26-connected.
    #[default]
    Interior,
    /// The surfels of one outside voxel join: the outside is 6-connected, the solid 26-connected.
    Exterior,
}

/// How the surfel on the other side of a linel lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Around the inner voxel: the solid is convex here.
    Convex,
    /// In the same plane.
    Flat,
    /// Around the outer voxel: the solid is concave here.
    Concave,
}

impl Adjacency {
    /// The surfel that continues a surfel `(p | q)` across the side `t`, given whether the voxels
    /// `p + t` and `q + t` are inside.
    #[inline]
    #[must_use]
    pub const fn turn(self, inner_beside: bool, outer_beside: bool) -> Turn {
        match (self, inner_beside, outer_beside) {
            (Adjacency::Interior, false, _) | (Adjacency::Exterior, false, false) => Turn::Convex,
            (_, true, true) | (Adjacency::Exterior, false, true) => Turn::Concave,
            (_, true, false) => Turn::Flat,
        }
    }
}

/// An oriented surfel by its inner voxel and orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OrientedSurfel {
    /// The inside voxel.
    pub inner: [i32; 3],
    /// From the inner to the outer voxel.
    pub orientation: Direction,
}

impl OrientedSurfel {
    /// The outside voxel.
    #[inline]
    #[must_use]
    pub fn outer(self) -> [i32; 3] {
        moved(self.inner, self.orientation)
    }

    /// Khalimsky coordinates.
    #[inline]
    #[must_use]
    pub fn khalimsky(self) -> [i32; 3] {
        let mut k = self.inner.map(|p| 2 * p + 1);
        k[axis(self.orientation)] += sign(self.orientation);
        k
    }

    /// The voxel cell `floor(K / 2)` that owns the surfel: of its two voxels the one with the
    /// larger coordinate.
    #[inline]
    #[must_use]
    pub fn cell(self) -> [i32; 3] {
        let mut cell = self.inner;
        cell[axis(self.orientation)] += i32::from(self.orientation & 1 == 0);
        cell
    }

    /// The surfel that continues this one across side `t` by the given turn, and the direction of
    /// the shared linel from the centre of that surfel.
    #[inline]
    #[must_use]
    pub fn across(self, t: Direction, turn: Turn) -> (OrientedSurfel, Direction) {
        let o = self.orientation;
        match turn {
            Turn::Convex => (
                OrientedSurfel {
                    inner: self.inner,
                    orientation: t,
                },
                o,
            ),
            Turn::Flat => (
                OrientedSurfel {
                    inner: moved(self.inner, t),
                    orientation: o,
                },
                opposite(t),
            ),
            Turn::Concave => (
                OrientedSurfel {
                    inner: moved(self.outer(), t),
                    orientation: opposite(t),
                },
                opposite(o),
            ),
        }
    }
}

/// The voxel one step from `p`.
#[inline]
#[must_use]
pub fn moved(mut p: [i32; 3], direction: Direction) -> [i32; 3] {
    p[axis(direction)] += sign(direction);
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_turn_counter_clockwise_around_the_orientation() {
        for o in 0..6u8 {
            for j in 0..4 {
                let from = step(SIDES[o as usize][j]);
                let to = step(SIDES[o as usize][(j + 1) % 4]);
                let cross = [
                    from[1] * to[2] - from[2] * to[1],
                    from[2] * to[0] - from[0] * to[2],
                    from[0] * to[1] - from[1] * to[0],
                ];
                assert_eq!(cross, step(o));
            }
        }
    }

    #[test]
    fn crossing_a_linel_and_back_returns_to_the_surfel() {
        let surfel = OrientedSurfel {
            inner: [5, 6, 7],
            orientation: 3,
        };
        for t in SIDES[3] {
            for turn in [Turn::Convex, Turn::Flat, Turn::Concave] {
                let (beyond, back) = surfel.across(t, turn);
                assert_eq!(beyond.across(back, turn).0, surfel);
            }
        }
    }
}
