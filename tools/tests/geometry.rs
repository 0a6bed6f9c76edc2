//! What the measures of known shapes must be; symmetries; balls against brute force.

use std::f64::consts::PI;

use curvox_tools::plain::algebra::{dot, normalised};
use curvox_tools::plain::cells::{MU2_UNIT, QUARTER, UNIT};
use curvox_tools::plain::formula::triangle_area;
use curvox_tools::plain::surface::OPEN;
use curvox_tools::plain::{
    Adjacency, Ball, BallKind, Estimator, Orientation, Row, Scale, Settings, Solid, Surface, Walk,
    Weights, analyse,
};

use crate::volumes::{ball, estimators, noise, pear};

const WEIGHTS: [Weights; 3] = [Weights::Sharp, Weights::Lumped, Weights::Dgtal];

fn values(row: &Row) -> [f64; 5] {
    let c = &row.curvature;
    [c.mean, c.gaussian, c.k1, c.k2, row.area]
}

#[test]
fn ball_totals_are_4pi_8pi_4pi() {
    for spacing in [[1.0; 3], [0.5, 1.0, 0.8]] {
        let radius = 12.0;
        for estimator in &estimators(4.0)[1..] {
            let settings = Settings {
                normals: *estimator,
                ..Settings::new(spacing, 4.0)
            };
            let totals = analyse(&ball(radius, spacing), &settings).totals;
            let (mu0, mu1) = (totals.mu0 as f64 * UNIT, totals.mu1 as f64 * UNIT);
            assert!(
                (mu0 / (4.0 * PI * radius * radius) - 1.0).abs() < 0.02,
                "{mu0}"
            );
            assert!((mu1 / (8.0 * PI * radius) - 1.0).abs() < 0.02, "{mu1}");
            assert_eq!(totals.mu2, 8 * i128::from(QUARTER));
            assert_eq!(totals.absolute_lifts, 0);
        }
    }
}

#[test]
fn ball_has_curvatures_of_its_radius() {
    for spacing in [[1.0; 3], [0.5, 1.0, 0.8]] {
        for estimator in &estimators(5.0)[1..] {
            let settings = Settings {
                normals: *estimator,
                weights: Weights::Lumped,
                ..Settings::new(spacing, 5.0)
            };
            let rows = analyse(&ball(12.0, spacing), &settings).rows;
            let mean_of =
                |of: fn(&Row) -> f64| rows.iter().map(of).sum::<f64>() / rows.len() as f64;
            assert!((mean_of(|r| r.curvature.mean) * 12.0 - 1.0).abs() < 0.03);
            assert!((mean_of(|r| r.curvature.gaussian) * 144.0 - 1.0).abs() < 0.06);
            assert!(mean_of(|r| r.curvature.k1) * 12.0 > 0.6);
            assert!(rows.iter().all(|r| r.curvature.k1 <= r.curvature.k2));
            // The shape is a mixture of world lengths: the radius comes in no other unit.
            assert!(rows.iter().all(|r| r.flags == Default::default()));
        }
    }
}

#[test]
fn box_with_trivial_normals_has_its_area_edges_and_corners() {
    let spacing = [1.0, 0.5, 0.25];
    let solid = Solid::from_fn([9, 9, 9], |v| {
        (2..6).contains(&v[0]) && (1..7).contains(&v[1]) && (3..5).contains(&v[2])
    });
    let settings = Settings {
        normals: Estimator::Trivial,
        ..Settings::new(spacing, 2.0)
    };
    let analysis = analyse(&solid, &settings);
    let [a, b, c] = [4.0, 3.0, 0.5];
    let area = 2.0 * (a * b + b * c + c * a);
    assert_eq!(analysis.totals.mu0 as f64 * UNIT, area);
    assert_eq!(analysis.rows.iter().map(|r| r.area).sum::<f64>(), area);
    let mu1 = analysis.totals.mu1 as f64 * UNIT;
    assert!((mu1 - 4.0 * (a + b + c) * PI / 2.0).abs() < 1e-9);
    assert_eq!(analysis.totals.mu2, 8 * i128::from(QUARTER));
    let corners = analysis.cells.mu2.iter().filter(|&&mu2| mu2 != 0);
    assert!(corners.clone().all(|&mu2| mu2 == QUARTER) && corners.count() == 8);
}

#[test]
fn closed_box_filling_the_image_has_its_area() {
    let solid = Solid::from_fn([3, 4, 5], |_| true);
    let settings = Settings {
        closed: true,
        ..Settings::new([1.0; 3], 2.0)
    };
    let settings = Settings {
        normals: Estimator::Trivial,
        ..settings
    };
    let analysis = analyse(&solid, &settings);
    assert_eq!(analysis.totals.mu0 as f64 * UNIT, 94.0);
    assert!(
        analyse(
            &solid,
            &Settings {
                closed: false,
                ..settings
            }
        )
        .rows
        .is_empty()
    );
}

#[test]
fn mirrored_volume_has_mirrored_values() {
    let solid = pear();
    for spacing in [[1.0; 3], [1.0, 0.8, 0.9]] {
        for (i, estimator) in estimators(3.0).into_iter().enumerate() {
            for (j, weights) in WEIGHTS.into_iter().enumerate() {
                let settings = Settings {
                    normals: estimator,
                    weights,
                    ..Settings::new(spacing, 3.0)
                };
                let analysis = analyse(&solid, &settings);
                // All axes in turn, not each every time: that takes long.
                let axis = (i + j) % 3;
                let last = solid.dims[axis] as i32 - 1;
                let mirrored = Solid::from_fn(solid.dims, |mut voxel| {
                    voxel[axis] = last - voxel[axis];
                    solid.is_inside(voxel)
                });
                let mirrored = analyse(&mirrored, &settings);
                assert_eq!(mirrored.rows.len(), analysis.rows.len());
                for row in &analysis.rows {
                    let mut k = row.surfel.k;
                    k[axis] = 2 * solid.dims[axis] as i32 - k[axis];
                    let twin = &mirrored.rows[mirrored.surface.find(k).unwrap() as usize];
                    for (a, b) in values(row).into_iter().zip(values(twin)) {
                        assert!((a - b).abs() < 1e-9, "{settings:?} {row:?} {twin:?}");
                    }
                    assert_eq!(row.flags, twin.flags);
                    assert_eq!(row.members, twin.members);
                }
            }
        }
    }
}

#[test]
fn curvatures_scale_with_the_world_unit() {
    let solid = pear();
    for weights in WEIGHTS {
        let settings = Settings {
            weights,
            ..Settings::new([1.0, 0.5, 0.75], 3.0)
        };
        let small = analyse(&solid, &settings).rows;
        let settings = Settings {
            weights,
            ..Settings::new([8.0, 4.0, 6.0], 24.0)
        };
        let large = analyse(&solid, &settings).rows;
        for (small, large) in small.iter().zip(&large) {
            let expected = [8.0, 64.0, 8.0, 8.0, 1.0 / 64.0];
            for ((s, l), factor) in values(small).into_iter().zip(values(large)).zip(expected) {
                assert_eq!(s, l * factor);
            }
        }
    }
}

#[test]
fn ball_larger_than_the_surface_sums_to_the_totals() {
    let solid = ball(5.3, [1.0; 3]);
    for kind in [BallKind::Connected, BallKind::Whole] {
        for weights in WEIGHTS {
            let settings = Settings {
                rho_world: 60.0,
                weights,
                ball: kind,
                count_sheets: false,
                ..Settings::new([1.0; 3], 3.0)
            };
            let analysis = analyse(&solid, &settings);
            let totals = &analysis.totals;
            for row in analysis.rows.iter().step_by(37) {
                assert!((row.sums.mu0 - totals.mu0 as f64 * UNIT).abs() < 1e-8);
                assert!((row.sums.mu1() - totals.mu1 as f64 * UNIT).abs() < 1e-8);
                assert!((row.sums.mu2 - totals.mu2 as f64 * MU2_UNIT).abs() < 1e-8);
                if weights == Weights::Sharp {
                    assert_eq!(i128::from(row.fixed_sums.unwrap().mu2), totals.mu2);
                }
                assert_eq!(row.members, analysis.rows.len());
                assert!(row.flags.island && !row.flags.border);
            }
        }
    }
}

#[test]
fn mu2_is_the_papers_area_where_normals_are_close() {
    let settings = Settings::new([1.0; 3], 4.0);
    let analysis = analyse(&ball(10.0, [1.0; 3]), &settings);
    let surface = &analysis.surface;
    for umbrella in 0..surface.umbrella_count() as u32 {
        let u: Vec<_> = surface
            .umbrella(umbrella)
            .iter()
            .map(|&f| analysis.rows[f as usize].u)
            .collect();
        let mut sum = [0.0; 3];
        u.iter().for_each(|u| (0..3).for_each(|a| sum[a] += u[a]));
        let mean = normalised(sum);
        let fan: f64 = (0..u.len())
            .map(|i| triangle_area(mean, u[i], u[(i + 1) % u.len()]))
            .sum();
        assert!((fan - analysis.cells.mu2[umbrella as usize] as f64 * MU2_UNIT).abs() < 1e-11);
    }
}

#[test]
fn connected_ball_does_not_see_a_neighbouring_sheet() {
    // Two slabs across the image, one voxel apart.
    let slabs = Solid::from_fn([16, 16, 16], |v| {
        (4..7).contains(&v[2]) || (8..11).contains(&v[2])
    });
    let one = Solid::from_fn([16, 16, 16], |v| (4..7).contains(&v[2]));
    let settings = Settings {
        normals: Estimator::SurfaceAverage { radius_world: 3.0 },
        ..Settings::new([1.0; 3], 3.5)
    };
    let both = analyse(&slabs, &settings);
    let alone = analyse(&one, &settings);
    let k = [17, 17, 14];
    let row = &both.rows[both.surface.find(k).unwrap() as usize];
    let row_alone = &alone.rows[alone.surface.find(k).unwrap() as usize];
    assert_eq!(row.u, [0.0, 0.0, 1.0]);
    assert_eq!(row.fixed_sums, row_alone.fixed_sums);
    assert!(row.flags.several_sheets);
    assert_eq!(row.curvature.mean, 0.0);
    // Away from the border nothing is open, near it all is flagged.
    for row in &both.rows {
        let k = row.surfel.k;
        let gap = [k[0], k[1], 32 - k[0], 32 - k[1]]
            .into_iter()
            .min()
            .unwrap();
        assert_eq!(row.flags.border, gap <= 7, "{k:?}");
    }
}

#[test]
fn single_voxel_is_an_island_with_trivial_average() {
    let solid = Solid::from_fn([5, 5, 5], |v| v == [2, 2, 2]);
    let [trivial, moment, _, average] = estimators(3.0);
    for estimator in [trivial, moment, average] {
        let settings = Settings {
            normals: estimator,
            ..Settings::new([1.0; 3], 3.0)
        };
        let analysis = analyse(&solid, &settings);
        assert_eq!(analysis.rows.len(), 6);
        for row in &analysis.rows {
            assert!(row.flags.island && !row.flags.several_sheets && !row.flags.reversed);
            assert!(
                (dot(row.u, row.surfel.normal()) - 1.0).abs() < 1e-15,
                "{estimator:?}"
            );
            let degenerate = matches!(estimator, Estimator::SurfaceAverage { .. });
            assert_eq!(row.flags.degenerate, degenerate);
            assert!((row.curvature.mean - 12.0 * PI / 2.0 / 12.0).abs() < 1e-9);
            assert!((row.curvature.gaussian - 4.0 * PI / 6.0).abs() < 1e-9);
        }
    }
}

#[test]
fn in_a_narrow_gap_the_moment_finds_the_normal_and_the_smallest_eigenvalue_does_not() {
    let solid = Solid::from_fn([21, 21, 21], |v| v[2] != 10);
    let radius_world = 4.0;
    let u = |orientation| {
        let settings = Settings {
            normals: Estimator::IntegralInvariant {
                radius_world,
                orientation,
            },
            ..Settings::new([1.0; 3], radius_world)
        };
        let analysis = analyse(&solid, &settings);
        analysis.rows[analysis.surface.find([21, 21, 20]).unwrap() as usize].u
    };
    assert!((u(Orientation::Moment)[2] - 1.0).abs() < 1e-14);
    assert!(u(Orientation::Dgtal)[2].abs() < 1e-14);
}

#[test]
fn walks_find_what_brute_force_finds() {
    for (spacing, rho) in [([1.0; 3], 3.2), ([1.0, 0.6, 0.35], 2.3)] {
        let scale = Scale::new(spacing);
        let surface = Surface::new(&noise([10, 11, 12], 0.5, 3), false, Adjacency::Interior);
        for weights in [Weights::Sharp, Weights::Dgtal] {
            let ball = Ball::new(&scale, rho, weights);
            let mut walk = Walk::new(&surface);
            for p in (0..surface.len() as u32).step_by(41) {
                let all: Vec<u32> = (0..surface.len() as u32)
                    .filter(|&g| ball.has(&surface, p, g))
                    .collect();
                walk.whole(p, ball.reach(), |g| ball.has(&surface, p, g));
                assert_eq!(walk.members, all);

                let mut reached = vec![false; surface.len()];
                reached[p as usize] = true;
                loop {
                    let next = all.iter().find(|&&g| {
                        !reached[g as usize]
                            && surface.neighbours[g as usize]
                                .iter()
                                .any(|&f| f != OPEN && reached[f as usize])
                    });
                    match next {
                        Some(&g) => reached[g as usize] = true,
                        None => break,
                    }
                }
                walk.connected(p, |g| ball.has(&surface, p, g));
                walk.members.sort_unstable();
                let reached: Vec<u32> = (0..surface.len() as u32)
                    .filter(|&g| reached[g as usize])
                    .collect();
                assert_eq!(walk.members, reached);
            }
        }
    }
}
