//! DGtal's numbers, if they are at hand.

use std::path::PathBuf;

use curvox_tools::agreement::{Comparison, compare};
use curvox_tools::npz::Table;
use curvox_tools::{goursat, vol};

/// The folder an environment variable names; says so if it is not set.
fn folder(variable: &str, test: &str) -> Option<PathBuf> {
    let folder = std::env::var_os(variable).map(PathBuf::from);
    if folder.is_none() {
        println!("SKIPPED: {test}: {variable} is not set");
    }
    folder
}

fn assert_clean_rows_agree(comparison: &Comparison) {
    for column in &comparison.columns {
        assert!(column.clean.rows > 0);
        assert_eq!(column.clean.beyond, 0, "{column:?}");
    }
}

#[test]
fn goursat_agrees_with_dgtal_on_every_row() {
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", "agreement with DGtal on Goursat") else {
        return;
    };
    for gridstep in [1.0, 0.5] {
        let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz"))).unwrap();
        let (solid, origin) = goursat::digitised(gridstep);
        let comparison = compare(&solid, gridstep, 2 * origin, &table).unwrap();
        assert_clean_rows_agree(&comparison);
        assert!(
            comparison
                .columns
                .iter()
                .all(|column| column.clean.rows == column.all.rows)
        );
    }
}

#[test]
fn dragon_agrees_with_dgtal_where_nothing_folds_drops_or_reverses() {
    let test = "agreement with DGtal on the dragon";
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", test) else {
        return;
    };
    let Some(data) = folder("CURVOX_TEST_DATA", test) else {
        return;
    };
    let table = Table::read(&reference.join("dragon128_h1.npz")).unwrap();
    let solid = vol::read(&data.join("vol-gallery/dragon-128.vol")).unwrap();
    // The file's first voxel has coordinate -1.
    assert_clean_rows_agree(&compare(&solid, 1.0, 2, &table).unwrap());
}
