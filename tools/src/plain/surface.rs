//! The boundary of a solid: surfels, the linels that join them, the umbrellas around pointels.
//!
//! In: a solid, whether it ends at the border of the image, and an adjacency. Out: flat
//! arrays. Guaranteed: surfels in the order of (kz, ky, kx); every linel sheet joins two
//! surfels or is open on one side (only on the border of an image that is not closed); the
//! corners of surfels around a pointel form umbrellas, which are cycles or, at open sides, chains.
//!
//! The frame of a surfel seen from outside, n pointing at the reader:
//!
//! ```text
//!              side 1 (+c)
//!        corner 1 --<-- corner 0
//!            |             |            sides and corners are numbered counter-clockwise;
//!  side 2 (-b) v     n     ^  side 0 (+b)     corner i lies between sides i and i+1;
//!            |             |            e_b x e_c = n
//!        corner 2 -->-- corner 3
//!              side 3 (-c)
//! ```

use super::solid::Solid;

/// How surfels join at a linel shared by four.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Adjacency {
    /// The two surfels of the same inner voxel join: the solid is 6-connected.
    Interior,
    /// The two surfels of the same outer voxel join: the solid is 26-connected.
    Exterior,
}

/// In place of the index of a neighbour where the surface is open.
pub const OPEN: u32 = u32::MAX;

/// An oriented surfel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Surfel {
    /// Khalimsky coordinates: exactly one is even.
    pub k: [i32; 3],
    /// The axis of the even coordinate.
    pub axis: usize,
    /// +1 or -1: the outward direction along `axis`.
    pub sign: i32,
}

impl Surfel {
    /// The voxel inside.
    pub fn inner(&self) -> [i32; 3] {
        self.voxel(-self.sign)
    }

    /// The voxel outside.
    pub fn outer(&self) -> [i32; 3] {
        self.voxel(self.sign)
    }

    fn voxel(&self, towards: i32) -> [i32; 3] {
        let mut k = self.k;
        k[self.axis] += towards;
        k.map(|k| (k - 1).div_euclid(2))
    }

    /// The outward trivial normal.
    pub fn normal(&self) -> [f64; 3] {
        let mut n = [0.0; 3];
        n[self.axis] = f64::from(self.sign);
        n
    }

    /// The unit steps across sides 0 to 3.
    pub fn steps(&self) -> [[i32; 3]; 4] {
        let next = (self.axis + 1) % 3;
        let last = (self.axis + 2) % 3;
        let (b, c) = if self.sign > 0 {
            (next, last)
        } else {
            (last, next)
        };
        let step = |axis: usize, sign: i32| {
            let mut t = [0; 3];
            t[axis] = sign;
            t
        };
        [step(b, 1), step(c, 1), step(b, -1), step(c, -1)]
    }

    /// Khalimsky coordinates of the linel of a side.
    pub fn linel(&self, side: usize) -> [i32; 3] {
        plus(self.k, self.steps()[side])
    }

    /// Khalimsky coordinates of the pointel of a corner.
    pub fn pointel(&self, corner: usize) -> [i32; 3] {
        let steps = self.steps();
        plus(plus(self.k, steps[corner]), steps[(corner + 1) % 4])
    }
}

/// Two surfels joined at a linel, or one and nothing at the border.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinelSheet {
    /// The surfel with the smaller index.
    pub first: u32,
    /// The side of `first` at this linel.
    pub side: usize,
    /// The other surfel, or [`OPEN`].
    pub second: u32,
}

/// The boundary of a solid.
#[derive(Clone, Debug)]
pub struct Surface {
    /// In the order of (kz, ky, kx).
    pub surfels: Vec<Surfel>,
    /// The surfel across each side, or [`OPEN`].
    pub neighbours: Vec<[u32; 4]>,
    /// The linel sheet at each side of a surfel.
    pub sheets_of: Vec<[u32; 4]>,
    /// All linel sheets, in the order of their first surfel and side.
    pub sheets: Vec<LinelSheet>,
    /// The umbrella at each corner of a surfel.
    pub umbrellas_of: Vec<[u32; 4]>,
    /// Surfels of umbrella i, counter-clockwise: `umbrella_members[umbrella_starts[i]..umbrella_starts[i + 1]]`.
    pub umbrella_starts: Vec<u32>,
    /// The surfels of all umbrellas, one after the other.
    pub umbrella_members: Vec<u32>,
    /// Is umbrella i a cycle? Else it is a chain that ends at open sides.
    pub umbrella_is_cycle: Vec<bool>,
    /// Surfels with (ky, kz) are `row_starts[kz * rows_y + ky]..` the next.
    row_starts: Vec<u32>,
    /// Number of values of ky and kz: 2 dim + 1.
    rows: [usize; 2],
}

impl Surface {
    /// The boundary of `solid`. If it is `closed`, surfels are made on the border of the image too.
    ///
    /// # Panics
    /// If there are 2^32 - 1 surfels or more.
    pub fn new(solid: &Solid, closed: bool, adjacency: Adjacency) -> Self {
        let surfels = boundary(solid, closed);
        assert!(surfels.len() < OPEN as usize, "too many surfels");
        let rows = [2 * solid.dims[1] + 1, 2 * solid.dims[2] + 1];
        let mut row_starts = vec![0; rows[0] * rows[1] + 1];
        for s in &surfels {
            row_starts[s.k[2] as usize * rows[0] + s.k[1] as usize + 1] += 1;
        }
        for row in 1..row_starts.len() {
            row_starts[row] += row_starts[row - 1];
        }
        let mut surface = Surface {
            neighbours: vec![[OPEN; 4]; surfels.len()],
            sheets_of: vec![[OPEN; 4]; surfels.len()],
            sheets: Vec::new(),
            umbrellas_of: vec![[OPEN; 4]; surfels.len()],
            umbrella_starts: vec![0],
            umbrella_members: Vec::new(),
            umbrella_is_cycle: Vec::new(),
            surfels,
            row_starts,
            rows,
        };
        surface.join_surfels(solid, closed, adjacency);
        surface.number_sheets();
        surface.number_umbrellas();
        surface
    }

    /// Number of surfels.
    pub fn len(&self) -> usize {
        self.surfels.len()
    }

    /// Is there no surfel?
    pub fn is_empty(&self) -> bool {
        self.surfels.is_empty()
    }

    /// Number of umbrellas.
    pub fn umbrella_count(&self) -> usize {
        self.umbrella_is_cycle.len()
    }

    /// The surfels of an umbrella, counter-clockwise around the outward direction.
    pub fn umbrella(&self, umbrella: u32) -> &[u32] {
        let i = umbrella as usize;
        &self.umbrella_members
            [self.umbrella_starts[i] as usize..self.umbrella_starts[i + 1] as usize]
    }

    /// Has the surfel a side on the border of the image, where the surface is open?
    pub fn is_open(&self, surfel: u32) -> bool {
        self.neighbours[surfel as usize].contains(&OPEN)
    }

    /// Indices of the surfels with this (ky, kz), in the order of kx.
    pub fn row(&self, ky: i32, kz: i32) -> std::ops::Range<u32> {
        if ky < 0 || kz < 0 || ky as usize >= self.rows[0] || kz as usize >= self.rows[1] {
            return 0..0;
        }
        let row = kz as usize * self.rows[0] + ky as usize;
        self.row_starts[row]..self.row_starts[row + 1]
    }

    /// Index of the surfel at `k`.
    pub fn find(&self, k: [i32; 3]) -> Option<u32> {
        let row = self.row(k[1], k[2]);
        let surfels = &self.surfels[row.start as usize..row.end as usize];
        let place = surfels.binary_search_by_key(&k[0], |s| s.k[0]).ok()?;
        Some(row.start + place as u32)
    }

    /// The side of surfel `g` at the linel `k`.
    fn side_at(&self, g: u32, k: [i32; 3]) -> usize {
        let g = &self.surfels[g as usize];
        (0..4)
            .find(|&side| g.linel(side) == k)
            .expect("neighbours share a linel")
    }

    /// The corner of surfel `g` at the pointel `k`.
    fn corner_at(&self, g: u32, k: [i32; 3]) -> usize {
        let g = &self.surfels[g as usize];
        (0..4)
            .find(|&corner| g.pointel(corner) == k)
            .expect("members share a pointel")
    }

    fn join_surfels(&mut self, solid: &Solid, closed: bool, adjacency: Adjacency) {
        for f in 0..self.len() {
            let surfel = self.surfels[f];
            for (side, t) in surfel.steps().into_iter().enumerate() {
                let (p, q) = (surfel.inner(), surfel.outer());
                // A side on the border of the image is open: what lies beyond is unknown.
                if !closed && !solid.has(plus(p, t)) {
                    continue;
                }
                let k = across(solid, adjacency, p, q, t);
                self.neighbours[f][side] = self.find(k).expect("the neighbour is a surfel");
            }
        }
    }

    fn number_sheets(&mut self) {
        for f in 0..self.len() as u32 {
            for side in 0..4 {
                let g = self.neighbours[f as usize][side];
                if g < f {
                    continue;
                }
                let sheet = self.sheets.len() as u32;
                self.sheets.push(LinelSheet {
                    first: f,
                    side,
                    second: g,
                });
                self.sheets_of[f as usize][side] = sheet;
                if g != OPEN {
                    let back = self.side_at(g, self.surfels[f as usize].linel(side));
                    self.sheets_of[g as usize][back] = sheet;
                }
            }
        }
    }

    fn number_umbrellas(&mut self) {
        for f in 0..self.len() as u32 {
            for corner in 0..4 {
                if self.umbrellas_of[f as usize][corner] == OPEN {
                    self.add_umbrella(f, corner);
                }
            }
        }
    }

    /// Around the pointel of corner i, the next surfel counter-clockwise lies across side i,
    /// the one before across side i + 1.
    fn add_umbrella(&mut self, f: u32, corner: usize) {
        let pointel = self.surfels[f as usize].pointel(corner);
        let (mut first, mut first_corner) = (f, corner);
        let is_cycle = loop {
            let before = self.neighbours[first as usize][(first_corner + 1) % 4];
            if before == OPEN {
                break false;
            }
            if before == f {
                (first, first_corner) = (f, corner);
                break true;
            }
            (first, first_corner) = (before, self.corner_at(before, pointel));
        };
        let umbrella = self.umbrella_is_cycle.len() as u32;
        let (mut g, mut g_corner) = (first, first_corner);
        loop {
            self.umbrella_members.push(g);
            self.umbrellas_of[g as usize][g_corner] = umbrella;
            g = self.neighbours[g as usize][g_corner];
            if g == OPEN || g == first {
                break;
            }
            g_corner = self.corner_at(g, pointel);
        }
        self.umbrella_starts
            .push(self.umbrella_members.len() as u32);
        self.umbrella_is_cycle.push(is_cycle);
    }
}

/// All surfels, in the order of (kz, ky, kx).
fn boundary(solid: &Solid, closed: bool) -> Vec<Surfel> {
    let mut surfels = Vec::new();
    let [nx, ny, nz] = solid.dims.map(|n| n as i32);
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let p = [x, y, z];
                if !solid.is_inside(p) {
                    continue;
                }
                for axis in 0..3 {
                    for sign in [-1, 1] {
                        let mut q = p;
                        q[axis] += sign;
                        if !solid.is_inside(q) && (closed || solid.has(q)) {
                            surfels.push(Surfel {
                                k: between(p, q),
                                axis,
                                sign,
                            });
                        }
                    }
                }
            }
        }
    }
    surfels.sort_by_key(|s| [s.k[2], s.k[1], s.k[0]]);
    surfels
}

/// Khalimsky coordinates of the neighbour of surfel (p | q) across the side in direction `t`.
fn across(solid: &Solid, adjacency: Adjacency, p: [i32; 3], q: [i32; 3], t: [i32; 3]) -> [i32; 3] {
    let (pt, qt) = (plus(p, t), plus(q, t));
    let (p_goes_on, q_is_met) = (solid.is_inside(pt), solid.is_inside(qt));
    let turns_inwards = match adjacency {
        Adjacency::Interior => q_is_met && p_goes_on,
        Adjacency::Exterior => q_is_met,
    };
    if turns_inwards {
        between(qt, q)
    } else if p_goes_on {
        between(pt, qt)
    } else {
        between(p, pt)
    }
}

/// Khalimsky coordinates of the surfel between two neighbouring voxels.
fn between(p: [i32; 3], q: [i32; 3]) -> [i32; 3] {
    [p[0] + q[0] + 1, p[1] + q[1] + 1, p[2] + q[2] + 1]
}

pub(super) fn plus(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(super) fn minus(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}
