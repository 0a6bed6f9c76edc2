//! Which squares of a plane hold voxels that are all alike, noted when the plane is made.
//!
//! Comes in: the words of all rows of a plane. Goes out: [`Squares`], a byte for each square of
//! [`EDGE`] voxels an edge. What has to look for a surface in a plane asks them first, so that voxels
//! far from any cost what it takes to pack them, and little more.

use std::ops::Range;

use crate::simd::{Level, Work, dispatch};

/// Edge of a square in voxels: a word of bits. Larger ones are seldom uniform near a surface; smaller
/// ones take longer to ask than the 64 words they stand for.
const EDGE: usize = 64;

/// What is in a square.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    Outside,
    Inside,
    Mixed,
}

/// The squares of a plane.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Squares {
    across: usize,
    /// What all squares have, or [`Content::Mixed`].
    all: Content,
    contents: Vec<Content>,
}

impl Squares {
    /// Of a plane of rows of `dims_x` voxels; bits past the last voxel of a row are zero.
    pub(super) fn of(dims_x: u32, words: &[u64]) -> Self {
        let across = (dims_x as usize).div_ceil(EDGE);
        let mut contents = Vec::with_capacity(words.len().div_ceil(EDGE));
        dispatch(Look {
            dims_x,
            words,
            contents: &mut contents,
        });
        let first = contents.first().copied().unwrap_or(Content::Outside);
        let same = contents.iter().all(|&content| content == first);
        Self {
            across,
            all: if same { first } else { Content::Mixed },
            contents,
        }
    }

    /// Whether all voxels are outside.
    pub(super) fn are_outside(&self) -> bool {
        self.all == Content::Outside
    }

    /// Whether all voxels of a box are inside, or outside, as far as the squares that it meets tell.
    pub(super) fn known(&self, x: &Range<u32>, y: &Range<u32>) -> Option<bool> {
        let mut found = self.all;
        if found == Content::Mixed {
            let [x, y] = [x, y]
                .map(|range| range.start as usize / EDGE..(range.end as usize).div_ceil(EDGE));
            found = self.contents[y.start * self.across + x.start];
            for band in y {
                let row = &self.contents[band * self.across..][x.clone()];
                if row.iter().any(|&content| content != found) {
                    return None;
                }
            }
        }
        match found {
            Content::Outside => Some(false),
            Content::Inside => Some(true),
            Content::Mixed => None,
        }
    }
}

/// Looks at all words.
struct Look<'a> {
    dims_x: u32,
    words: &'a [u64],
    contents: &'a mut Vec<Content>,
}

impl Work for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Level>(self) {
        let across = (self.dims_x as usize).div_ceil(EDGE);
        let last = !0 >> (across * EDGE - self.dims_x as usize);
        let (mut any, mut all) = (vec![0; across], vec![0; across]);
        for band in self.words.chunks(EDGE * across) {
            any.fill(0);
            all.fill(!0);
            for row in band.chunks_exact(across) {
                for ((any, all), word) in any.iter_mut().zip(&mut all).zip(row) {
                    *any |= word;
                    *all &= word;
                }
            }
            for (i, (&any, &all)) in any.iter().zip(&all).enumerate() {
                let whole = if i + 1 == across { last } else { !0 };
                self.contents.push(match (any, all) {
                    (0, _) => Content::Outside,
                    (_, all) if all == whole => Content::Inside,
                    _ => Content::Mixed,
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_tell_what_all_their_voxels_tell() {
        let dims = [150, 130];
        let across = 3;
        // A box of inside voxels, from nothing to everything.
        for (lo, hi) in [
            ([0, 0], [0, 0]),
            ([0, 0], [150, 130]),
            ([64, 0], [150, 64]),
            ([60, 70], [61, 71]),
            ([0, 64], [149, 130]),
        ] {
            let inside =
                |x: u32, y: u32| (lo[0]..hi[0]).contains(&x) && (lo[1]..hi[1]).contains(&y);
            let mut words = vec![0u64; across * dims[1] as usize];
            for y in 0..dims[1] {
                for x in 0..dims[0] {
                    words[y as usize * across + x as usize / 64] |=
                        u64::from(inside(x, y)) << (x % 64);
                }
            }
            let squares = Squares::of(dims[0], &words);
            for x in [0..1, 0..150, 64..150, 130..150, 0..64, 63..65] {
                for y in [0..130, 64..128, 128..130, 0..64, 100..101] {
                    let whole = |range: &Range<u32>, dims: u32| {
                        range.start / 64 * 64..(range.end.div_ceil(64) * 64).min(dims)
                    };
                    let (all_x, all_y) = (whole(&x, dims[0]), whole(&y, dims[1]));
                    let mut voxels = all_y.flat_map(|y| all_x.clone().map(move |x| (x, y)));
                    let first = inside(x.start, y.start);
                    let same = voxels.all(|(x, y)| inside(x, y) == first);
                    assert_eq!(squares.known(&x, &y), same.then_some(first), "{x:?} {y:?}");
                }
            }
        }
    }
}
