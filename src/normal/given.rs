//! Given normals: u out of a table, one row a surfel.
//!
//! Comes in: [`GivenNormals`], the rows of the surfels of a slab, each surfel once. Goes out: u of
//! the surfels of a brick, as given but for its length. The table is read and checked where
//! slabs are made; nothing is left here that could fail.
//!
//! Not guaranteed: that the normals belong to this surface beyond its places. A row is `cut` where
//! its surfel touches the border of an open image; what else the normals came from is unknown.

use glam::DVec3;

use crate::khalimsky::{Direction, OrientedSurfel, axis, sign};
use crate::lattice::Lattice;
use crate::surfel::Surfels;
use crate::volume::PlaneWindow;

use super::{Normals, touches_border};

/// A row of a table of normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GivenRow {
    /// Khalimsky coordinates of the surfel.
    pub k: [i32; 3],
    /// Outward sign along its even axis.
    pub side: i8,
    /// The file the row is from, by number.
    pub file: u32,
    /// Which row of the file, from 0.
    pub row: u64,
    /// Unit normal in the axes of the image.
    pub u: DVec3,
}

/// Memory of a row.
pub const ROW_BYTES: u64 = size_of::<GivenRow>() as u64;

/// The normals of some surfels, in Khalimsky order, each surfel at most once.
#[derive(Clone, Debug, Default)]
pub struct GivenNormals {
    rows: Vec<GivenRow>,
}

impl GivenNormals {
    /// Puts rows in order.
    ///
    /// # Errors
    /// Two rows of the same surfel, if there are any; which, does not depend on their order.
    pub fn new(mut rows: Vec<GivenRow>) -> Result<Self, [GivenRow; 2]> {
        rows.sort_unstable_by_key(|row| (order(row.k), row.file, row.row));
        match rows.windows(2).find(|pair| pair[0].k == pair[1].k) {
            Some(pair) => Err([pair[0], pair[1]]),
            None => Ok(Self { rows }),
        }
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The row of a surfel.
    #[must_use]
    pub fn find(&self, surfel: OrientedSurfel) -> Option<&GivenRow> {
        let k = order(surfel.khalimsky());
        let found = self.rows.binary_search_by_key(&k, |row| order(row.k));
        found.ok().map(|i| &self.rows[i])
    }
}

/// Khalimsky coordinates as they are ordered.
fn order(k: [i32; 3]) -> [i32; 3] {
    [k[2], k[1], k[0]]
}

/// The surfel of the image at Khalimsky coordinates, with its outward sign; `None` if there is
/// none. The planes beside it must be held.
#[must_use]
pub fn surfel_at(
    bits: &PlaneWindow,
    lattice: &Lattice,
    k: [i32; 3],
    side: i8,
) -> Option<OrientedSurfel> {
    let even: Vec<usize> = (0..3).filter(|&a| k[a] & 1 == 0).collect();
    let (&[a], 1 | -1) = (&even[..], side) else {
        return None;
    };
    let orientation = 2 * a as Direction + Direction::from(side < 0);
    let mut inner = k.map(|k| k >> 1);
    inner[a] -= i32::from(side > 0);
    let surfel = OrientedSurfel { inner, orientation };
    let outer = surfel.outer();
    debug_assert_eq!((axis(orientation), sign(orientation)), (a, i32::from(side)));
    let exists = |p: [i32; 3]| (0..3).all(|i| p[i] >= 0 && p[i] < lattice.dims[i] as i32);
    if !exists(inner) || !(lattice.closed || exists(outer)) {
        return None;
    }
    (bits.inside(inner) && !bits.inside(outer)).then_some(surfel)
}

pub(super) fn estimate(given: &GivenNormals, surfels: &Surfels, lattice: &Lattice) -> Normals {
    let mut normals = Normals::default();
    for i in 0..surfels.list.len() {
        let surfel = surfels.oriented(i);
        let row = given.find(surfel).expect("a normal for every surfel");
        normals.u.push(row.u);
        normals.degenerate.push(false);
        normals.cut.push(touches_border(surfel, lattice));
    }
    normals
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::surfel::{CellBox, SurfelIndex};
    use crate::volume::{BitBox, BitPlane};

    #[test]
    fn surfels_at_a_place_are_those_of_the_index() {
        let dims = [7, 5, 4];
        let inside = |x: u32, y: u32, z: u32| (x * 7 + y * 3 + z * 5 + x * y * z) % 5 < 2;
        let planes = (0..dims[2])
            .map(|z| {
                let mut plane = BitPlane::outside(dims[0], dims[1]);
                for (y, row) in plane.rows_mut().enumerate() {
                    row[0] = (0..dims[0])
                        .map(|x| u64::from(inside(x, y as u32, z)) << x)
                        .sum();
                }
                Arc::new(plane)
            })
            .collect();
        let window = PlaneWindow {
            dims,
            z0: 0,
            planes,
        };
        for closed in [false, true] {
            let lattice = Lattice::new(dims.map(u64::from), [1.0; 3], closed).unwrap();
            let cells = CellBox {
                lo: [0; 3],
                hi: lattice.cell_dims(),
            };
            let bits = BitBox::cut(&window, [-1; 3], cells.hi.map(|c| c + 1));
            let index = SurfelIndex::find(&bits, cells, &lattice);
            let surfels = Surfels::list(&index, &bits);
            let listed: Vec<_> = (0..surfels.list.len())
                .map(|i| surfels.oriented(i))
                .collect();
            let mut found = Vec::new();
            for kz in -3..12 {
                for ky in -3..14 {
                    for kx in -3..18 {
                        for side in [-1, 0, 1] {
                            found.extend(surfel_at(&window, &lattice, [kx, ky, kz], side));
                        }
                    }
                }
            }
            assert!(listed.len() > 100);
            assert_eq!(found, listed);
            for extreme in [[i32::MIN; 3], [i32::MAX, 1, 2], [i32::MIN, 1, 1]] {
                assert_eq!(surfel_at(&window, &lattice, extreme, 1), None);
            }
        }
    }

    #[test]
    fn two_rows_of_a_surfel_are_an_error_in_any_order() {
        let row = |k, row| GivenRow {
            k,
            side: 1,
            file: 0,
            row,
            u: DVec3::X,
        };
        let rows = vec![row([3, 3, 2], 5), row([1, 2, 3], 0), row([3, 3, 2], 1)];
        let [first, second] = GivenNormals::new(rows).unwrap_err();
        assert_eq!([first.row, second.row], [1, 5]);
        let given = GivenNormals::new(vec![row([3, 3, 4], 5), row([3, 3, 2], 1)]).unwrap();
        assert_eq!(given.len(), 2);
    }
}
