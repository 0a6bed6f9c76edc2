//! Given normals on their way from a table to the surfels of a slab.
//!
//! Comes in: the table, the bits of the planes around a slab. Goes out: a row for each surfel of
//! the slab, normals in the axes of the image, and how many rows of these planes belong to no
//! surfel. Rows are matched with the bits as they are read, so that what is kept is never more
//! than one row a surfel, whatever the table holds.
//!
//! A surfel without a row, and one with two, are errors. Rows without a surfel are only counted:
//! a table made at another threshold has them.

use std::ops::Range;

use glam::{DMat3, DVec3};

use crate::brick::BrickGrid;
use crate::error::Error;
use crate::khalimsky::{OrientedSurfel, sign};
use crate::normal::given::{GivenNormals, GivenRow, surfel_at};
use crate::sink::{NormalRow, NormalTable, SinkError};
use crate::surfel::{SurfelIndex, Surfels};
use crate::volume::{BitBox, PlaneWindow};

use super::shared::Shared;

/// The normals given for a slab, whose surfels are in `bricks`, and the number of rows without a
/// surfel; `None` if normals are not given.
pub(super) fn of_slab(
    shared: &Shared<'_>,
    bits: &PlaneWindow,
    grid: &BrickGrid,
    z: Range<i32>,
    bricks: &[usize],
    surfels: u64,
) -> Result<Option<(GivenNormals, u64)>, Error> {
    let Some(table) = &shared.settings.given else {
        return Ok(None);
    };
    let lattice = shared.lattice;
    let [a, b, c] = lattice.direction.map(DVec3::from_array);
    let to_image = DMat3::from_cols(a, b, c).inverse();
    // The first and the last slab take the rows that lie beyond the image, so that each is counted.
    let from = if z.start == 0 {
        i64::MIN
    } else {
        2 * i64::from(z.start)
    };
    let to = if z.end == grid.cell_dims[2] {
        i64::MAX
    } else {
        2 * i64::from(z.end)
    };
    let mut rows: Vec<GivenRow> = Vec::with_capacity(surfels as usize);
    let mut unmatched = 0;
    let mut seen = 0u64;
    table.for_each(from..to, |row: NormalRow| -> Result<(), Error> {
        seen += 1;
        if seen.is_multiple_of(1 << 16) && shared.stopped() {
            return Err(Error::Stopped);
        }
        let k = row.k.map(|k| i32::try_from(k).ok());
        let surfel = match k {
            [Some(x), Some(y), Some(z)] => surfel_at(bits, lattice, [x, y, z], row.side),
            _ => None,
        };
        let Some(surfel) = surfel else {
            unmatched += 1;
            return Ok(());
        };
        let u = to_image * row.normal;
        let u = u / u.abs().max_element();
        if !u.is_finite() {
            return Err(SinkError::Unsupported(
                "given normals cannot be turned into the axes of this image, which lie in a plane"
                    .into(),
            )
            .into());
        }
        rows.push(GivenRow {
            k: surfel.khalimsky(),
            side: row.side,
            file: row.file,
            row: row.row,
            u: u.normalize(),
        });
        if rows.len() as u64 > surfels {
            // More rows than surfels: one of them has two.
            GivenNormals::new(std::mem::take(&mut rows)).map_err(|pair| twice(table, pair))?;
        }
        Ok(())
    })?;
    let given = GivenNormals::new(rows).map_err(|pair| twice(table, pair))?;
    if given.len() as u64 != surfels
        && let Some(surfel) = first_without(shared, bits, grid, &z, bricks, &given)
    {
        return Err(SinkError::Damaged {
            path: table.path().to_owned(),
            place: name(surfel.khalimsky(), sign(surfel.orientation)),
            found: format!(
                "no row ({} of the {surfels} surfels of these planes have one, and {unmatched} rows there \
                 are of none; the table has {} rows)",
                given.len(),
                table.rows()
            ),
            expected: match table.differences() {
                [] => "a normal for every surfel; the table may be of another image or threshold".into(),
                all => format!(
                    "a normal for every surfel; the table is of another image: {}",
                    all.join("; ")
                ),
            },
        }
        .into());
    }
    Ok(Some((given, unmatched)))
}

/// The first surfel of a slab, brick by brick, that has no row.
fn first_without(
    shared: &Shared<'_>,
    bits: &PlaneWindow,
    grid: &BrickGrid,
    z: &Range<i32>,
    bricks: &[usize],
    given: &GivenNormals,
) -> Option<OrientedSurfel> {
    bricks.iter().find_map(|&number| {
        let core = grid.core(number, z);
        let bits = BitBox::cut(bits, core.lo.map(|c| c - 1), core.hi.map(|c| c + 1));
        let index = SurfelIndex::find(&bits, core, shared.lattice);
        let surfels = Surfels::list(&index, &bits);
        (0..surfels.list.len())
            .map(|i| surfels.oriented(i))
            .find(|&surfel| given.find(surfel).is_none())
    })
}

/// The error of a surfel with two rows.
fn twice(table: &NormalTable, [first, second]: [GivenRow; 2]) -> Error {
    SinkError::Damaged {
        path: table.file(second.file).to_owned(),
        place: format!("row {}", second.row),
        found: format!(
            "{}, which row {} of {} gave before",
            name(second.k, second.side.into()),
            first.row,
            table.file(first.file).display()
        ),
        expected: "each surfel once".into(),
    }
    .into()
}

fn name(k: [i32; 3], side: i32) -> String {
    format!("surfel {} {} {} of side {side:+}", k[0], k[1], k[2])
}
