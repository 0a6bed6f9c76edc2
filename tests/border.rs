use std::collections::HashMap;

use curvox::measure::ball::{Compensation, Extent, Weights};
use curvox::measure::field::Field;
use curvox::normal::vcm::Side;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{NamedMethod, Settings};
use curvox::sink::Flag;
use curvox_tools::plain::Solid;

use crate::common::{lattice, piped};

/// The voxels from plane `x` on.
fn cropped(solid: &Solid, x: i32) -> Solid {
    let dims = [solid.dims[0] - x as usize, solid.dims[1], solid.dims[2]];
    Solid::from_fn(dims, |p| solid.is_inside([p[0] + x, p[1], p[2]]))
}

#[test]
fn rows_without_the_border_flag_do_not_depend_on_the_crop() {
    // A wavy rod along x beside a ball: whatever goes on beyond the crop meets it squarely.
    let solid = Solid::from_fn([60, 40, 34], |[x, y, z]| {
        let rod = 7.0 + 1.5 * (f64::from(x) / 5.0).sin();
        let ball = [x - 44, y - 31, z - 16].map(|d| d * d).iter().sum::<i32>() <= 36;
        f64::from(y - 14).hypot(f64::from(z - 16)) <= rod || ball
    });
    let crop = 17;
    let ii = |radius| Estimator::IntegralInvariant {
        radius,
        orientation: Orientation::Moment,
    };
    for (estimator, radius, field) in [
        (ii(3.0), 3.0, Field::Constant),
        (ii(3.0), 2.0, Field::Constant),
        (ii(2.0), 4.0, Field::Constant),
        (
            Estimator::SurfaceAverage { radius: 3.0 },
            3.0,
            Field::Constant,
        ),
        (
            Estimator::VoronoiCovariance {
                voronoi_radius: 4.0,
                radius: 2.0,
                side: Side::Surface,
            },
            2.0,
            Field::Constant,
        ),
        (Estimator::Trivial, 3.0, Field::Constant),
        (ii(2.0), 4.0, Field::Interpolated),
        (Estimator::Trivial, 3.0, Field::Linear),
    ] {
        for weights in [
            Weights::Lumped,
            Weights::Sharp,
            Weights::Dgtal,
            Weights::Compensated(Compensation::Averaged),
        ] {
            for extent in [Extent::Connected, Extent::Whole] {
                let settings = |solid: &Solid| Settings {
                    estimator,
                    weights,
                    extent,
                    field,
                    quality: true,
                    radii: vec![radius],
                    ..Settings::new(lattice(solid, [1.0; 3], false))
                };
                let what = format!("{estimator:?} {weights:?} {extent:?} {field:?}");
                the_crop_does_not_show(&solid, crop, settings, &what);
            }
        }
    }
}

/// Compares the rows of a solid with those of a part of it, where they have no flag.
fn the_crop_does_not_show(
    solid: &Solid,
    crop: i32,
    settings: impl Fn(&Solid) -> Settings,
    what: &str,
) {
    let (all, _) = piped(solid, &settings(solid));
    let at: HashMap<_, _> = (0..all.len()).map(|i| (all.k_at(i), i)).collect();
    let part = cropped(solid, crop);
    let (rows, _) = piped(&part, &settings(&part));
    let mut compared = 0;
    for i in 0..rows.len() {
        if rows.curvatures[0].flags[i] & Flag::Border.bit() != 0 {
            continue;
        }
        let mut k = rows.k_at(i);
        k[0] += 2 * crop;
        let j = at[&k];
        let (a, b) = (&rows.curvatures[0], &all.curvatures[0]);
        let bits = |c: &curvox::sink::CurvatureColumns, i: usize| {
            let values = [c.mean[i], c.gaussian[i], c.k1[i], c.k2[i], c.quality[i]];
            let bars = [&c.mean_error, &c.gaussian_error].map(|e| e.get(i).map(|x| x.to_bits()));
            (values.map(f32::to_bits), bars)
        };
        assert_eq!(bits(a, i), bits(b, j), "{k:?} {what}");
        compared += 1;
    }
    assert!(compared > 300, "{compared} rows compared");
}

#[test]
fn refined_rows_without_the_border_flag_do_not_depend_on_the_crop() {
    let solid = Solid::from_fn([110, 34, 34], |[x, y, z]| {
        let rod = 9.0 + 2.0 * (f64::from(x) / 6.0).sin();
        f64::from(y - 17).hypot(f64::from(z) - 16.4) <= rod
    });
    let settings = |solid: &Solid| Settings {
        quality: true,
        ..Settings::new(lattice(solid, [1.0; 3], false)).with_method(NamedMethod::Refined, 2.5)
    };
    the_crop_does_not_show(&solid, 21, settings, "refined");
}

#[test]
fn a_solid_clear_of_the_border_has_no_row_flagged() {
    let solid = Solid::from_fn([17, 18, 19], |p| {
        p.map(|x| (x - 8) * (x - 8)).iter().sum::<i32>() <= 49
    });
    let open = Settings::new(lattice(&solid, [1.0; 3], false));
    let closed = Settings::new(lattice(&solid, [1.0; 3], true));
    let ((open, _), (closed, _)) = (piped(&solid, &open), piped(&solid, &closed));
    assert!(
        open.curvatures[0]
            .flags
            .iter()
            .all(|f| f & Flag::Border.bit() == 0)
    );
    assert_eq!(open.curvatures, closed.curvatures);
}
