//! The surface as DGtal's `SurfaceMesh`: faces, and what they share.

use std::collections::HashMap;

use crate::plain::Surfel;

/// A linel and the faces on its two sides.
#[derive(Clone, Debug, Default)]
pub struct Linel {
    /// Khalimsky coordinates.
    pub k: [i32; 3],
    /// Its ends, the pointel of smaller number first.
    pub ends: [u32; 2],
    /// The unit direction from its first end to its second.
    pub direction: [i32; 3],
    /// Faces whose boundary runs along it in this direction.
    pub left: Vec<u32>,
    /// Faces whose boundary runs against it.
    pub right: Vec<u32>,
}

impl Linel {
    /// The face on its left and the one on its right, if there is just one each.
    pub fn pair(&self) -> Option<(u32, u32)> {
        match (&self.left[..], &self.right[..]) {
            (&[left], &[right]) => Some((left, right)),
            _ => None,
        }
    }

    /// All its faces.
    pub fn faces(&self) -> impl Iterator<Item = u32> {
        self.left.iter().chain(&self.right).copied()
    }

    /// Its middle and its two ends.
    pub fn points(&self) -> [[i32; 3]; 3] {
        let end = |sign: i32| [0, 1, 2].map(|a| self.k[a] + sign * self.direction[a]);
        [self.k, end(-1), end(1)]
    }
}

/// Faces, linels and pointels; cells of equal coordinates are one.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// The faces, in the order given.
    pub surfels: Vec<Surfel>,
    /// Khalimsky coordinates of the pointels.
    pub pointels: Vec<[i32; 3]>,
    /// The pointels of each face, counter-clockwise seen from outside.
    pub corners: Vec<[u32; 4]>,
    /// The faces at each pointel, in their order.
    pub faces_at: Vec<Vec<u32>>,
    /// The linels.
    pub linels: Vec<Linel>,
    /// The linel at each side of a face.
    pub linels_of: Vec<[u32; 4]>,
}

impl Mesh {
    /// The mesh of these faces.
    pub fn new(surfels: Vec<Surfel>) -> Self {
        let mut pointels: Vec<[i32; 3]> = Vec::new();
        let mut faces_at: Vec<Vec<u32>> = Vec::new();
        let mut linels: Vec<Linel> = Vec::new();
        let mut corners = Vec::with_capacity(surfels.len());
        let mut linels_of = Vec::with_capacity(surfels.len());
        let mut pointel_at: HashMap<[i32; 3], u32> = HashMap::new();
        let mut linel_at: HashMap<[i32; 3], u32> = HashMap::new();
        for (f, surfel) in (0u32..).zip(&surfels) {
            let mut numbers = [0; 4];
            for corner in corners_in_order(surfel) {
                let k = surfel.pointel(corner);
                let pointel = *pointel_at.entry(k).or_insert_with(|| {
                    pointels.push(k);
                    faces_at.push(Vec::new());
                    pointels.len() as u32 - 1
                });
                faces_at[pointel as usize].push(f);
                numbers[corner] = pointel;
            }
            corners.push(numbers);
        }
        for (f, (surfel, corners)) in (0u32..).zip(surfels.iter().zip(&corners)) {
            let steps = surfel.steps();
            linels_of.push([0, 1, 2, 3].map(|side| {
                // The boundary runs along a side in the direction of the next.
                let (from, to) = (corners[(side + 3) % 4], corners[side]);
                let is_left = from < to;
                let k = surfel.linel(side);
                let linel = *linel_at.entry(k).or_insert_with(|| {
                    let sign = if is_left { 1 } else { -1 };
                    linels.push(Linel {
                        k,
                        ends: [from.min(to), from.max(to)],
                        direction: steps[(side + 1) % 4].map(|step| sign * step),
                        ..Linel::default()
                    });
                    linels.len() as u32 - 1
                });
                let at = &mut linels[linel as usize];
                if is_left { &mut at.left } else { &mut at.right }.push(f);
                linel
            }));
        }
        Mesh {
            surfels,
            pointels,
            corners,
            faces_at,
            linels,
            linels_of,
        }
    }

    /// The faces around a pointel, counter-clockwise, if they can be chained; else none.
    ///
    /// From the first face in order, each time to the first of those left, in their present order, which
    /// shares the linel where the last one ends. Whether the chain closes is not asked. At a linel of
    /// four faces there is a choice, so whether such a pointel is dropped depends on the order of the faces.
    pub fn chain(&self, pointel: u32) -> Option<Vec<u32>> {
        // Each face with the pointels after and before this one on its boundary.
        let mut chain: Vec<(u32, u32, u32)> = self.faces_at[pointel as usize]
            .iter()
            .map(|&f| {
                let corners = self.corners[f as usize];
                let at = corners.iter().position(|&p| p == pointel).unwrap_or(0);
                (f, corners[(at + 1) % 4], corners[(at + 3) % 4])
            })
            .collect();
        for i in 1..chain.len() {
            let (_, _, before) = chain[i - 1];
            let next = (i..chain.len()).find(|&j| chain[j].1 == before)?;
            chain.swap(i, next);
        }
        Some(chain.into_iter().map(|(f, _, _)| f).collect())
    }
}

/// The corners of a face as DGtal visits them: counter-clockwise seen from outside, from the lower end of both
/// axes of the face or, if that would run the other way round, from the upper end of the first.
///
/// It numbers the pointels, and the numbers tell on which side of a linel a face is.
fn corners_in_order(surfel: &Surfel) -> [usize; 4] {
    let (first_axis, second_axis) = [(1, 2), (0, 2), (0, 1)][surfel.axis];
    // e_0 x e_2 points against e_1; the two other products point along the axis.
    let turns = if surfel.axis == 1 { -1 } else { 1 };
    let towards = surfel.sign * turns;
    let start = (0..4).find(|&corner| {
        let k = surfel.pointel(corner);
        k[first_axis] - surfel.k[first_axis] == towards && k[second_axis] < surfel.k[second_axis]
    });
    let start = start.unwrap_or(0);
    [0, 1, 2, 3].map(|corner| (start + corner) % 4)
}
