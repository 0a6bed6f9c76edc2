//! The cells where DGtal differs from the plain definitions, and the rows whose ball has one.
//!
//! In: the surface, DGtal's mesh of it, the corrected normals on both sides. Out: for each ball, the
//! set of causes among the cells that carry weight in it, apart for the columns of mu1 and of mu2. A cell is
//! marked by its shape and its normals, never by a number of a table.

use std::f64::consts::PI;

use crate::dgtal;
use crate::plain::algebra::{Vector, dot, norm};
use crate::plain::cells::MU2_UNIT;
use crate::plain::{Ball, Cells, Surface, Walk};

/// Why a cell, or the set of cells, is another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The walk crosses a linel of four surfels and counts more surfels.
    Walk,
    /// A surfel has another normal; at linels and pointels, one of their surfels has.
    Normal,
    /// A linel whose normals differ by more than 90 degrees.
    Fold,
    /// A linel of four surfels has no mu1.
    DroppedLinel,
    /// A pointel whose surfels do not chain has no mu2.
    DroppedPointel,
    /// The surfels around a pointel are chained otherwise than in one umbrella.
    Chain,
    /// The fan around the mean normal is a multiple of 4 pi away, as it can be where the normals
    /// do not lie on one side of their mean; or two normals in a row are opposite, so that no arc joins them.
    Fan,
}

impl Cause {
    /// All causes.
    pub const ALL: [Cause; 7] = [
        Cause::Walk,
        Cause::Normal,
        Cause::Fold,
        Cause::DroppedLinel,
        Cause::DroppedPointel,
        Cause::Chain,
        Cause::Fan,
    ];
}

/// A set of causes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CauseSet(u8);

impl CauseSet {
    /// Is the cause in the set?
    pub fn has(self, cause: Cause) -> bool {
        self.0 & (1 << cause as u8) != 0
    }

    /// Is there none?
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Is the cause the only one?
    pub fn is_only(self, cause: Cause) -> bool {
        self.0 == 1 << cause as u8
    }

    fn add_if(&mut self, condition: bool, cause: Cause) {
        self.0 |= u8::from(condition) << cause as u8;
    }

    fn add_all(&mut self, other: CauseSet) {
        self.0 |= other.0;
    }
}

/// The causes in one ball.
#[derive(Clone, Copy, Debug, Default)]
pub struct RowCauses {
    /// Why H, k1, k2 and the directions may differ.
    pub bending: CauseSet,
    /// Why G may differ.
    pub gaussian: CauseSet,
}

/// Normals whose sum is shorter are opposite: rounding decides where the arc between them runs.
const MIN_OPPOSITE_SUM: f64 = 1e-6;

/// The causes at every cell of a mesh.
#[derive(Clone, Debug)]
pub struct Causes {
    /// Surfels with another normal.
    pub normals: Vec<bool>,
    /// At each linel.
    pub linels: Vec<CauseSet>,
    /// At each pointel.
    pub pointels: Vec<CauseSet>,
    /// By how many times 4 pi the fan at each pointel exceeds mu2.
    pub turns: Vec<i64>,
    /// The largest difference of mu2 where the chain is the umbrella and no normals are opposite, modulo 4 pi.
    pub largest_remainder: f64,
}

impl Causes {
    /// The causes at the cells of `mesh`, face i of which is surfel `order[i]` of `surface`.
    ///
    /// `u` are DGtal's normals, `measures` its cells, `plain` the plain ones with the same normals.
    pub fn new(
        mesh: &dgtal::Mesh,
        u: &[Vector],
        measures: &dgtal::Cells,
        surface: &Surface,
        order: &[u32],
        plain: &Cells,
        normals: Vec<bool>,
    ) -> Self {
        let linels = mesh
            .linels
            .iter()
            .map(|linel| {
                let mut set = CauseSet::default();
                set.add_if(linel.faces().any(|f| normals[f as usize]), Cause::Normal);
                match linel.pair() {
                    None => set.add_if(true, Cause::DroppedLinel),
                    Some((f, g)) => {
                        set.add_if(dot(u[f as usize], u[g as usize]) < 0.0, Cause::Fold);
                    }
                }
                set
            })
            .collect();
        let mut turns_at = vec![0; mesh.pointels.len()];
        let mut largest_remainder = 0.0f64;
        let pointels = (0..mesh.pointels.len())
            .map(|pointel| {
                let mut set = CauseSet::default();
                let mut faces = mesh.faces_at[pointel].iter();
                set.add_if(faces.any(|&f| normals[f as usize]), Cause::Normal);
                let Some(fan) = &measures.fans[pointel] else {
                    set.add_if(true, Cause::DroppedPointel);
                    return set;
                };
                let chain: Vec<u32> = fan.faces.iter().map(|&f| order[f as usize]).collect();
                match umbrella_of(surface, mesh.pointels[pointel], &chain) {
                    None => set.add_if(true, Cause::Chain),
                    Some(umbrella) => {
                        let mu2 = plain.mu2[umbrella as usize] as f64 * MU2_UNIT;
                        let turns = ((fan.mu2 - mu2) / (4.0 * PI)).round();
                        turns_at[pointel] = turns as i64;
                        let is_opposite = has_opposites(&fan.faces, u);
                        set.add_if(turns != 0.0 || is_opposite, Cause::Fan);
                        if !is_opposite {
                            let remainder = (fan.mu2 - mu2 - 4.0 * PI * turns).abs();
                            largest_remainder = largest_remainder.max(remainder);
                        }
                    }
                }
                set
            })
            .collect();
        Causes {
            normals,
            linels,
            pointels,
            turns: turns_at,
            largest_remainder,
        }
    }

    /// The causes in the ball that `gathered` holds, around the face whose surfel is `centre`.
    pub fn in_ball(
        &self,
        gathered: &dgtal::Ball,
        order: &[u32],
        surface: &Surface,
        walk: &mut Walk,
        ball: &Ball,
        centre: u32,
    ) -> RowCauses {
        walk.connected(centre, |g| ball.has(surface, centre, g));
        let same_members = walk.members.len() == gathered.faces.len()
            && gathered
                .faces
                .iter()
                .all(|&(f, _)| walk.has(order[f as usize]));
        let mut both = CauseSet::default();
        both.add_if(!same_members, Cause::Walk);
        let other_normal = gathered
            .faces
            .iter()
            .any(|&(f, _)| self.normals[f as usize]);
        both.add_if(other_normal, Cause::Normal);
        let mut row = RowCauses {
            bending: both,
            gaussian: both,
        };
        for &(linel, _) in &gathered.linels {
            row.bending.add_all(self.linels[linel as usize]);
        }
        for &pointel in &gathered.pointels {
            row.gaussian.add_all(self.pointels[pointel as usize]);
        }
        row
    }

    /// How many cells have the cause; of [`Cause::Walk`], none.
    pub fn cells_with(&self, cause: Cause) -> usize {
        let sets = match cause {
            Cause::Normal => return self.normals.iter().filter(|&&other| other).count(),
            Cause::Fold | Cause::DroppedLinel => &self.linels,
            _ => &self.pointels,
        };
        sets.iter().filter(|set| set.has(cause)).count()
    }
}

/// Are two normals opposite, one after the other around a pointel?
fn has_opposites(faces: &[u32], u: &[Vector]) -> bool {
    let nexts = faces.iter().cycle().skip(1);
    faces.iter().zip(nexts).any(|(&f, &g)| {
        let (f, g) = (u[f as usize], u[g as usize]);
        norm([0, 1, 2].map(|a| f[a] + g[a])) < MIN_OPPOSITE_SUM
    })
}

/// The umbrella around `pointel` whose surfels in their cyclic order are `chain`.
fn umbrella_of(surface: &Surface, pointel: [i32; 3], chain: &[u32]) -> Option<u32> {
    let &first = chain.first()?;
    let surfel = &surface.surfels[first as usize];
    let corner = (0..4).find(|&corner| surfel.pointel(corner) == pointel)?;
    let umbrella = surface.umbrellas_of[first as usize][corner];
    let members = surface.umbrella(umbrella);
    let start = members.iter().position(|&f| f == first)?;
    let (before, after) = members.split_at(start);
    let is_cycle = surface.umbrella_is_cycle[umbrella as usize];
    (is_cycle && after.iter().chain(before).eq(chain)).then_some(umbrella)
}
