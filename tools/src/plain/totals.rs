//! Totals of a surface and the Euler characteristics of a solid, in exact integers.

use super::cells::Cells;
use super::solid::Solid;
use super::surface::Surface;

/// Totals of a surface. Those of chains and open sides are counted, but carry no mu1 or mu2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// F.
    pub surfels: i64,
    /// E: linel sheets, those on the border of the image too.
    pub linels: i64,
    /// V: umbrellas, cycles and chains.
    pub pointels: i64,
    /// Sum of mu0 in units of 2^-40.
    pub mu0: i128,
    /// Sum of mu1 in units of 2^-40.
    pub mu1: i128,
    /// Sum of mu2 in units of (pi/2) 2^-44.
    pub mu2: i128,
    /// Sum of the lifts k.
    pub lifts: i64,
    /// Sum of |k|.
    pub absolute_lifts: i64,
    /// Euler characteristics of the solid.
    pub solid: SolidTotals,
}

impl Totals {
    /// The totals of a surface and of the solid it bounds.
    pub fn new(solid: &Solid, surface: &Surface, cells: &Cells) -> Self {
        let of_surfels = || cells.of_surfels.iter().flatten();
        let trace = |m: &[i64; 6]| m[..3].iter().map(|&d| i128::from(d)).sum::<i128>();
        Totals {
            surfels: surface.len() as i64,
            linels: surface.sheets.len() as i64,
            pointels: surface.umbrella_count() as i64,
            mu0: cells.mu0.iter().map(|&m| i128::from(m)).sum(),
            mu1: cells
                .tensor
                .iter()
                .chain(of_surfels().map(|m| &m.tensor))
                .map(trace)
                .sum(),
            mu2: cells
                .mu2
                .iter()
                .chain(of_surfels().map(|m| &m.mu2))
                .map(|&m| i128::from(m))
                .sum(),
            lifts: cells.lift.iter().sum(),
            absolute_lifts: cells.lift.iter().map(|k| k.abs()).sum(),
            solid: SolidTotals::new(solid),
        }
    }

    /// V - E + F of the split surface.
    pub fn euler(&self) -> i64 {
        self.pointels - self.linels + self.surfels
    }
}

/// Euler characteristics of a solid; voxels outside of the image are outside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SolidTotals {
    /// Of the solid with 6-neighbours joined: the open cells.
    pub chi6: i64,
    /// Of the solid with 26-neighbours joined: the union of closed voxels.
    pub chi26: i64,
    /// B: blocks of 2x2x2 voxels whose only two outside voxels are antipodal.
    pub antipodal_outside: i64,
    /// A: blocks of 2x2x2 voxels whose only two inside voxels are antipodal.
    pub antipodal_inside: i64,
}

impl SolidTotals {
    /// Each cell of the grid is inside the open complex if all voxels around it are inside, and
    /// in the closed complex if one of them is. A block around a pointel looks at the eight
    /// voxels `p - {0,1}^3`, hence at the pointel, three linels, three surfels, one voxel.
    pub fn new(solid: &Solid) -> Self {
        let mut totals = SolidTotals::default();
        let [nx, ny, nz] = solid.dims.map(|n| n as i32);
        for z in 0..=nz {
            for y in 0..=ny {
                for x in 0..=nx {
                    totals.add_block(solid, [x, y, z]);
                }
            }
        }
        totals
    }

    fn add_block(&mut self, solid: &Solid, [x, y, z]: [i32; 3]) {
        // Bit d of a corner number: one step back along axis d.
        let corner = |bits: i32| [x - (bits & 1), y - (bits >> 1 & 1), z - (bits >> 2 & 1)];
        let inside: [bool; 8] = std::array::from_fn(|bits| solid.is_inside(corner(bits as i32)));
        // `cell` is the set of axes along which the cell is flat: its voxels are the subsets.
        for cell in 0..8usize {
            let mut around = (0..8usize)
                .filter(|bits| bits & !cell == 0)
                .map(|bits| inside[bits]);
            let flat = cell.count_ones();
            if around.clone().all(|inside| inside) {
                // Dually, voxels are points, surfels edges, linels faces, pointels volumes.
                self.chi6 += if flat % 2 == 0 { 1 } else { -1 };
            }
            if around.any(|inside| inside) {
                self.chi26 += if flat % 2 == 1 { 1 } else { -1 };
            }
        }
        let count = inside.iter().filter(|&&inside| inside).count();
        let antipodal =
            |value: bool| (0..4).any(|bits| inside[bits] == value && inside[7 - bits] == value);
        self.antipodal_outside += i64::from(count == 6 && antipodal(false));
        self.antipodal_inside += i64::from(count == 2 && antipodal(true));
    }
}
