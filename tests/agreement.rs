use curvox::khalimsky::Adjacency;
use curvox::lattice::Lattice;
use curvox::measure::ball::{Compensation, Extent, Weights};
use curvox::measure::cells::mark;
use curvox::measure::field::Field;
use curvox::normal::vcm::Side;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::Settings;
use curvox::sink::Flag;
use curvox_tools::plain::{self, Cells, Normals, Scale, Solid, Surface, Totals};

use crate::common::{blob, lattice, noise, piped, whole};

/// The same settings for the plain reference. Lengths there are in world units.
fn plainly(settings: &Settings) -> plain::Settings {
    let unit = settings.lattice.voxel_unit_world();
    plain::Settings {
        spacing_world: settings.lattice.spacing,
        closed: settings.lattice.closed,
        adjacency: match settings.adjacency {
            Adjacency::Interior => plain::Adjacency::Interior,
            Adjacency::Exterior => plain::Adjacency::Exterior,
        },
        normals: match settings.estimator {
            Estimator::Trivial => plain::Estimator::Trivial,
            Estimator::IntegralInvariant {
                radius,
                orientation,
            } => plain::Estimator::IntegralInvariant {
                radius_world: radius * unit,
                orientation: match orientation {
                    Orientation::Moment => plain::Orientation::Moment,
                    Orientation::Trivial => plain::Orientation::Dgtal,
                },
            },
            Estimator::VoronoiCovariance {
                voronoi_radius,
                radius,
                side,
            } => plain::Estimator::VoronoiCovariance {
                voronoi_radius_world: voronoi_radius * unit,
                radius_world: radius * unit,
                ties: match side {
                    Side::Surface => plain::Ties::Shared,
                    Side::Dgtal => plain::Ties::Last,
                },
                orientation: match side {
                    Side::Surface => plain::Orientation::Surface,
                    Side::Dgtal => plain::Orientation::Dgtal,
                },
            },
            Estimator::SurfaceAverage { radius } => plain::Estimator::SurfaceAverage {
                radius_world: radius * unit,
            },
            Estimator::Gradient { .. } | Estimator::Given => {
                unreachable!("the plain reference knows no values and no tables")
            }
        },
        field: match settings.field {
            Field::Constant => plain::Field::Constant,
            Field::Interpolated => plain::Field::Interpolated,
            Field::Linear => plain::Field::Linear,
        },
        rho_world: settings.radii[0] * unit,
        weights: match settings.weights {
            Weights::Sharp => plain::Weights::Sharp,
            Weights::Lumped => plain::Weights::Lumped,
            Weights::Dgtal => plain::Weights::Dgtal,
            Weights::Compensated(of) => plain::Weights::Compensated {
                refined: of == Compensation::Refined,
            },
        },
        ball: match settings.extent {
            Extent::Connected => plain::BallKind::Connected,
            Extent::Whole => plain::BallKind::Whole,
        },
        count_sheets: settings.weights != Weights::Dgtal,
    }
}

/// Largest component difference.
fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max)
}

/// Compares a single brick with the plain reference; gives the number of surfels whose normals
/// differ, which happens only where eigenvectors tie.
fn agree(solid: &Solid, settings: &Settings) -> usize {
    let ours = whole(solid, settings);
    let asked = plainly(settings);
    let scale = Scale::new(asked.spacing_world);
    let surface = Surface::new(solid, asked.closed, asked.adjacency);
    assert_eq!(ours.rows.len(), surface.len());
    let theirs = plain::normals::estimate(solid, &surface, &scale, asked.normals);
    let mut ties = 0;
    for (i, row) in ours.rows.iter().enumerate() {
        assert_eq!(row.k, surface.surfels[i].k);
        if apart(row.u.to_array(), theirs.u[i]) > 1e-9 {
            ties += 1;
        }
        assert_eq!(row.marks & mark::DEGENERATE != 0, theirs.degenerate[i]);
    }
    // From here on the same normals, so that everything else must agree on every surfel.
    let normals = Normals {
        u: ours.rows.iter().map(|r| r.u.to_array()).collect(),
        degenerate: theirs.degenerate,
    };
    let cells = Cells::with_field(&surface, &normals.u, &scale, asked.field);
    let totals = Totals::new(solid, &surface, &cells);
    assert_eq!(ours.totals.surfel_count() as i64, totals.surfels);
    assert_eq!(ours.totals.linels as i64, totals.linels);
    assert_eq!(ours.totals.pointels as i64, totals.pointels);
    if settings.field == Field::Constant {
        assert_eq!(ours.totals.mu0, totals.mu0);
    }
    // a few units a cell
    let slack = 4 * (surface.len() as i128 + 1);
    assert!((ours.totals.mu0 - totals.mu0).abs() < slack);
    assert!((ours.totals.mu1 - totals.mu1).abs() < 10 * slack);
    assert_eq!(ours.solid.chi6, totals.solid.chi6);
    assert_eq!(ours.solid.chi26, totals.solid.chi26);
    assert_eq!(
        ours.solid.antipodal_inside as i64,
        totals.solid.antipodal_inside
    );
    assert_eq!(
        ours.solid.antipodal_outside as i64,
        totals.solid.antipodal_outside
    );
    let rows = plain::measure(&surface, &normals, &cells, &scale, &asked);
    // Compensated sums have measures rounded to 2^-26, and those here are some 2^-40 off.
    let exact = match settings.weights {
        Weights::Compensated(_) => 1e-7,
        _ => 1e-9,
    };
    for (row, plain) in ours.rows.iter().zip(&rows) {
        let place = row.k;
        assert!(
            (row.sums.mu0 - plain.sums.mu0).abs() < exact,
            "{place:?} mu0 {} {} {settings:?}",
            row.sums.mu0,
            plain.sums.mu0
        );
        for (a, b) in row.sums.tensor.terms().into_iter().zip(plain.sums.tensor) {
            assert!((a - b).abs() < exact, "{place:?} tensor {a} {b}");
        }
        assert!(
            (row.sums.mu2 - plain.sums.mu2).abs() < exact,
            "{place:?} mu2 {} {} {settings:?}",
            row.sums.mu2,
            plain.sums.mu2
        );
        let expected = if settings.quality {
            plain.sums.omega
        } else {
            0.0
        };
        assert!(
            (row.sums.omega - expected).abs() < exact,
            "{place:?} omega {} {expected} {settings:?}",
            row.sums.omega,
        );
        if settings.weights != Weights::Dgtal {
            assert_eq!(
                row.sums.rim.is_island(),
                plain.flags.island,
                "{place:?} island"
            );
            assert_eq!(row.sums.rim.open, plain.flags.border, "{place:?} border");
            assert_eq!(
                row.sums.several_sheets, plain.flags.several_sheets,
                "{place:?} sheets"
            );
        }
        assert_eq!(
            row.marks & mark::OPPOSED != 0,
            plain.flags.reversed,
            "{place:?} opposed"
        );
        match row.curvature {
            None => assert!(plain.curvature.mean.is_nan(), "{place:?}"),
            Some(c) => {
                // quotients by a small area amplify rounding
                let slack = exact / plain.sums.mu0.min(1.0);
                assert!((c.mean - plain.curvature.mean).abs() < slack, "{place:?} H");
                assert!(
                    (c.gaussian - plain.curvature.gaussian).abs() < slack,
                    "{place:?} G"
                );
                if settings.quality {
                    assert!((c.quality - plain.curvature.quality).abs() < slack);
                }
                assert!(
                    (c.k1 - plain.curvature.k1).abs() < slack * 10.0,
                    "{place:?} k1"
                );
                assert!(
                    (c.k2 - plain.curvature.k2).abs() < slack * 10.0,
                    "{place:?} k2"
                );
            }
        }
    }
    ties
}

fn settings(lattice: Lattice) -> Settings {
    Settings {
        threads: 2,
        quality: true,
        ..Settings::new(lattice)
    }
}

const ALL_WEIGHTS: [Weights; 4] = [
    Weights::Lumped,
    Weights::Sharp,
    Weights::Dgtal,
    Weights::Compensated(Compensation::Averaged),
];

#[test]
fn production_agrees_with_the_plain_reference_on_noise() {
    let mut seed = 0;
    for p in [0.05, 0.5, 0.95] {
        for adjacency in [Adjacency::Interior, Adjacency::Exterior] {
            for closed in [false, true] {
                for weights in ALL_WEIGHTS {
                    for extent in [Extent::Connected, Extent::Whole] {
                        seed += 1;
                        let solid = noise([12, 9, 10], p, seed);
                        let mut s = settings(lattice(&solid, [0.5; 3], closed));
                        s.adjacency = adjacency;
                        s.weights = weights;
                        s.extent = extent;
                        s.radii = vec![2.2];
                        for estimator in [
                            Estimator::Trivial,
                            Estimator::SurfaceAverage { radius: 2.5 },
                            Estimator::VoronoiCovariance {
                                voronoi_radius: 3.0,
                                radius: 1.7,
                                side: Side::Surface,
                            },
                            Estimator::IntegralInvariant {
                                radius: 2.0,
                                orientation: Orientation::Moment,
                            },
                        ] {
                            s.estimator = estimator;
                            let ties = agree(&solid, &s);
                            let ii = matches!(estimator, Estimator::IntegralInvariant { .. });
                            assert!(ii || ties == 0, "{estimator:?}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn production_agrees_with_the_plain_reference_on_solids_and_box_voxels() {
    for (seed, spacing) in [[1.0; 3], [0.3, 0.3, 0.9], [1.0, 0.7, 0.45]]
        .into_iter()
        .enumerate()
    {
        let solid = blob([40, 36, 30], seed as u64);
        for weights in ALL_WEIGHTS {
            let mut s = settings(lattice(&solid, spacing, false));
            s.weights = weights;
            for estimator in [
                Estimator::Trivial,
                Estimator::SurfaceAverage { radius: 3.3 },
            ] {
                s.estimator = estimator;
                assert_eq!(agree(&solid, &s), 0, "{s:?}");
            }
            for side in [Side::Surface, Side::Dgtal] {
                if weights != Weights::Lumped {
                    continue;
                }
                s.estimator = Estimator::VoronoiCovariance {
                    voronoi_radius: 7.3,
                    radius: 2.6,
                    side,
                };
                assert_eq!(agree(&solid, &s), 0, "{s:?}");
            }
            for orientation in [Orientation::Moment, Orientation::Trivial] {
                let mut s = settings(lattice(&solid, spacing, false));
                s.weights = weights;
                s.estimator = Estimator::IntegralInvariant {
                    radius: 3.0,
                    orientation,
                };
                let ties = agree(&solid, &s);
                let share = ties as f64 / whole(&solid, &s).rows.len() as f64;
                assert!(share < 0.03, "{ties} normals differ");
            }
        }
    }
}

#[test]
fn production_agrees_with_the_plain_reference_for_continuous_fields() {
    let mut seed = 100;
    for field in [Field::Interpolated, Field::Linear] {
        for closed in [false, true] {
            for weights in ALL_WEIGHTS {
                for spacing in [[0.5; 3], [1.0, 0.7, 0.45]] {
                    seed += 1;
                    let solids = [noise([12, 9, 10], 0.4, seed), blob([24, 22, 20], seed)];
                    for solid in solids {
                        let mut s = settings(lattice(&solid, spacing, closed));
                        s.field = field;
                        s.weights = weights;
                        if seed % 2 == 0 {
                            s.adjacency = Adjacency::Exterior;
                            s.extent = Extent::Whole;
                        }
                        for estimator in [
                            Estimator::SurfaceAverage { radius: 2.5 },
                            Estimator::IntegralInvariant {
                                radius: 2.0,
                                orientation: Orientation::Moment,
                            },
                        ] {
                            s.estimator = estimator;
                            agree(&solid, &s);
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn voronoi_normals_agree_with_the_plain_reference_at_the_widest_radii() {
    let solid = Solid::from_fn([6, 5, 5], |p| {
        p.iter().all(|&x| (1..4).contains(&x)) || p[0] == 4 && p[1] > 2
    });
    for spacing in [[1.0; 3], [1.0, 0.8, 1.0]] {
        let mut s = settings(lattice(&solid, spacing, true));
        s.estimator = Estimator::VoronoiCovariance {
            voronoi_radius: 57.0,
            radius: 17.0,
            side: Side::Surface,
        };
        assert_eq!(agree(&solid, &s), 0);
    }
}

#[test]
fn the_pipeline_gives_the_rows_of_a_single_brick() {
    let solid = blob([75, 40, 70], 5);
    for (weights, field) in [
        (Weights::Lumped, Field::Constant),
        (Weights::Sharp, Field::Constant),
        (Weights::Dgtal, Field::Constant),
        (Weights::Sharp, Field::Interpolated),
        (Weights::Dgtal, Field::Interpolated),
        (Weights::Lumped, Field::Linear),
        (Weights::Compensated(Compensation::Refined), Field::Constant),
        (
            Weights::Compensated(Compensation::Averaged),
            Field::Interpolated,
        ),
    ] {
        let mut s = settings(lattice(&solid, [1.0, 1.0, 1.5], false));
        s.weights = weights;
        s.field = field;
        s.directions = true;
        let ours = whole(&solid, &s);
        let (rows, outcome) = piped(&solid, &s);
        assert_eq!(outcome.cells, ours.totals);
        assert_eq!(outcome.solid, ours.solid);
        assert_eq!(rows.len(), ours.rows.len());
        for (i, row) in ours.rows.iter().enumerate() {
            assert_eq!([rows.k[0][i], rows.k[1][i], rows.k[2][i]], row.k);
            let columns = &rows.curvatures[0];
            let Some(c) = row.curvature else {
                assert!(columns.mean[i].is_nan() && columns.k2[i].is_nan());
                assert!(columns.quality[i].is_nan());
                assert!(columns.flags[i] & Flag::NoArea.bit() != 0);
                continue;
            };
            assert_eq!(columns.mean[i], c.mean as f32);
            assert_eq!(columns.gaussian[i], c.gaussian as f32);
            assert_eq!(columns.k1[i], c.k1 as f32);
            assert_eq!(columns.k2[i], c.k2 as f32);
            assert_eq!(columns.quality[i], c.quality as f32);
            let sheets = columns.flags[i] & Flag::SeveralSheets.bit() != 0;
            assert_eq!(sheets, row.sums.several_sheets);
        }
    }
}
