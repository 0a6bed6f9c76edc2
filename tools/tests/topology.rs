//! Theorems in integers, on noise: every configuration of voxels occurs.

use curvox_tools::plain::cells::QUARTER;
use curvox_tools::plain::surface::OPEN;
use curvox_tools::plain::{Adjacency, Cells, Scale, Solid, Surface, Totals, normals};

use crate::volumes::{estimators, noise};

const BOTH: [Adjacency; 2] = [Adjacency::Interior, Adjacency::Exterior];

fn noises() -> Vec<Solid> {
    let mut solids = Vec::new();
    for (i, p) in [0.05, 0.5, 0.95].into_iter().enumerate() {
        for seed in 0..3 {
            solids.push(noise([11, 9, 10], p, 100 * i as u64 + seed));
        }
    }
    solids
}

#[test]
fn mu2_and_lifts_sum_to_the_euler_characteristic_exactly() {
    for solid in noises() {
        for adjacency in BOTH {
            let surface = Surface::new(&solid, true, adjacency);
            for spacing in [[1.0; 3], [1.0, 0.7, 0.4]] {
                let scale = Scale::new(spacing);
                for estimator in estimators(2.0) {
                    let normals = normals::estimate(&solid, &surface, &scale, estimator);
                    let cells = Cells::new(&surface, &normals.u, &scale);
                    let totals = Totals::new(&solid, &surface, &cells);
                    // 4 pi is 8 quarters, 2 pi is 4.
                    let quarter = i128::from(QUARTER);
                    let left = totals.mu2 + 8 * quarter * i128::from(totals.lifts);
                    assert_eq!(
                        left,
                        4 * quarter * i128::from(totals.euler()),
                        "{estimator:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn euler_characteristic_of_the_surface_follows_from_the_solid() {
    for solid in noises() {
        for adjacency in BOTH {
            let surface = Surface::new(&solid, true, adjacency);
            let cells = Cells::new(
                &surface,
                &vec![[0.0, 0.0, 1.0]; surface.len()],
                &Scale::new([1.0; 3]),
            );
            let totals = Totals::new(&solid, &surface, &cells);
            let of_solid = totals.solid;
            let expected = match adjacency {
                Adjacency::Interior => 2 * of_solid.chi6 + 2 * of_solid.antipodal_outside,
                Adjacency::Exterior => 2 * of_solid.chi26 + 2 * of_solid.antipodal_inside,
            };
            assert_eq!(totals.euler(), expected, "{adjacency:?}");
        }
    }
}

#[test]
fn closed_surface_has_umbrellas_of_3_to_7_and_no_open_side() {
    for solid in noises() {
        for adjacency in BOTH {
            let surface = Surface::new(&solid, true, adjacency);
            for umbrella in 0..surface.umbrella_count() as u32 {
                assert!(surface.umbrella_is_cycle[umbrella as usize]);
                assert!((3..=7).contains(&surface.umbrella(umbrella).len()));
            }
            assert!((0..surface.len() as u32).all(|f| !surface.is_open(f)));
            assert_eq!(2 * surface.sheets.len(), 4 * surface.len());
            assert_eq!(surface.umbrella_members.len(), 4 * surface.len());
        }
    }
}

#[test]
fn every_linel_sheet_joins_two_surfels_that_run_along_it_in_opposite_directions() {
    for solid in noises() {
        for adjacency in BOTH {
            for closed in [true, false] {
                let surface = Surface::new(&solid, closed, adjacency);
                let mut met = vec![0; surface.sheets.len()];
                for f in 0..surface.len() {
                    for side in 0..4 {
                        met[surface.sheets_of[f][side] as usize] += 1;
                        let g = surface.neighbours[f][side];
                        if g == OPEN {
                            assert!(!closed);
                            continue;
                        }
                        let back = (0..4)
                            .find(|&s| {
                                surface.sheets_of[g as usize][s] == surface.sheets_of[f][side]
                            })
                            .expect("the neighbour has the same sheet");
                        assert_eq!(surface.neighbours[g as usize][back], f as u32);
                        let run = surface.surfels[f].steps()[(side + 1) % 4];
                        let run_back = surface.surfels[g as usize].steps()[(back + 1) % 4];
                        assert_eq!(run, run_back.map(|t| -t));
                    }
                }
                for (sheet, met) in surface.sheets.iter().zip(met) {
                    assert_eq!(met, if sheet.second == OPEN { 1 } else { 2 });
                }
            }
        }
    }
}

#[test]
fn open_sides_and_chains_are_those_on_the_border_of_the_image() {
    for solid in noises() {
        let surface = Surface::new(&solid, false, Adjacency::Interior);
        let on_border = |k: [i32; 3]| {
            (0..3).any(|a| k[a] % 2 == 0 && (k[a] == 0 || k[a] == 2 * solid.dims[a] as i32))
        };
        for f in 0..surface.len() {
            let surfel = surface.surfels[f];
            assert!(!on_border(surfel.k));
            for i in 0..4 {
                assert_eq!(surface.neighbours[f][i] == OPEN, on_border(surfel.linel(i)));
                let umbrella = surface.umbrellas_of[f][i] as usize;
                assert_eq!(
                    !surface.umbrella_is_cycle[umbrella],
                    on_border(surfel.pointel(i))
                );
            }
        }
    }
}

#[test]
fn surfels_are_sorted_and_found() {
    let solid = noise([7, 6, 5], 0.5, 7);
    let surface = Surface::new(&solid, true, Adjacency::Interior);
    let keys: Vec<_> = surface
        .surfels
        .iter()
        .map(|s| [s.k[2], s.k[1], s.k[0]])
        .collect();
    assert!(keys.is_sorted());
    for (f, s) in surface.surfels.iter().enumerate() {
        assert_eq!(surface.find(s.k), Some(f as u32));
        assert!(solid.is_inside(s.inner()) && !solid.is_inside(s.outer()));
    }
    assert_eq!(surface.find([1, 1, 1]), None);
    assert_eq!(surface.find([1, -2, 1]), None);
}
