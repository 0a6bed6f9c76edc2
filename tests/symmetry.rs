use std::collections::HashMap;

use curvox::khalimsky::Adjacency;
use curvox::measure::ball::{Compensation, Weights};
use curvox::measure::field::Field;
use curvox::normal::vcm::Side;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::Settings;
use curvox_tools::plain::Solid;

use crate::common::{blob, lattice, whole};

/// Axis `a` of the image becomes axis `to[a]`, mirrored where `flip[a]`.
#[derive(Clone, Copy, Debug)]
struct Motion {
    to: [usize; 3],
    flip: [bool; 3],
}

impl Motion {
    /// All 48: 24 rotations and their mirror images.
    fn all() -> Vec<Motion> {
        let orders = [
            [0, 1, 2],
            [0, 2, 1],
            [1, 0, 2],
            [1, 2, 0],
            [2, 0, 1],
            [2, 1, 0],
        ];
        (0..48)
            .map(|i| Motion {
                to: orders[i / 8],
                flip: [i & 1 != 0, i & 2 != 0, i & 4 != 0],
            })
            .collect()
    }

    /// Moves a coordinate that runs from 0 to `last` along each axis.
    fn place<T: Copy + Default + std::ops::Sub<Output = T>>(
        &self,
        p: [T; 3],
        last: [T; 3],
    ) -> [T; 3] {
        let mut out = [T::default(); 3];
        for a in 0..3 {
            out[self.to[a]] = if self.flip[a] { last[a] - p[a] } else { p[a] };
        }
        out
    }

    fn vector(&self, v: [f64; 3]) -> [f64; 3] {
        let mut out = [0.0; 3];
        for a in 0..3 {
            out[self.to[a]] = if self.flip[a] { -v[a] } else { v[a] };
        }
        out
    }

    /// Whether it changes the sense of rotation.
    fn mirrors(&self) -> bool {
        let odd = self.to[0] > self.to[1];
        let odd = odd ^ (self.to[0] > self.to[2]) ^ (self.to[1] > self.to[2]);
        odd ^ self.flip[0] ^ self.flip[1] ^ self.flip[2]
    }

    fn spacing(&self, v: [f64; 3]) -> [f64; 3] {
        let mut out = [0.0; 3];
        for a in 0..3 {
            out[self.to[a]] = v[a];
        }
        out
    }

    fn solid(&self, solid: &Solid) -> Solid {
        let last = solid.dims.map(|n| n as i32 - 1);
        let mut dims = [0; 3];
        for a in 0..3 {
            dims[self.to[a]] = solid.dims[a];
        }
        let mut moved = Solid {
            dims,
            inside: vec![false; solid.inside.len()],
        };
        for z in 0..=last[2] {
            for y in 0..=last[1] {
                for x in 0..=last[0] {
                    let to = moved.index(self.place([x, y, z], last));
                    moved.inside[to] = solid.is_inside([x, y, z]);
                }
            }
        }
        moved
    }
}

#[test]
fn moved_volumes_give_moved_values() {
    let solid = blob([30, 26, 22], 3);
    let ii = Estimator::IntegralInvariant {
        radius: 3.0,
        orientation: Orientation::Moment,
    };
    let average = Estimator::SurfaceAverage { radius: 3.0 };
    let default = Weights::Compensated(Compensation::Averaged);
    let refined = Weights::Compensated(Compensation::Refined);
    for (weights, estimator, field) in [
        (default, average, Field::Constant),
        (refined, average, Field::Constant),
        (Weights::Lumped, ii, Field::Constant),
        (Weights::Sharp, average, Field::Constant),
        (Weights::Dgtal, Estimator::Trivial, Field::Constant),
        (
            Weights::Lumped,
            Estimator::VoronoiCovariance {
                voronoi_radius: 7.0,
                radius: 2.5,
                side: Side::Surface,
            },
            Field::Constant,
        ),
        (Weights::Lumped, average, Field::Interpolated),
        (Weights::Dgtal, average, Field::Linear),
    ] {
        for (adjacency, spacing) in [
            (Adjacency::Interior, [1.0; 3]),
            (Adjacency::Exterior, [1.0, 0.8, 0.6]),
        ] {
            let settings = |solid: &Solid, spacing| Settings {
                adjacency,
                weights,
                estimator,
                field,
                quality: true,
                refinement: (weights == refined).then_some(2.5),
                ..Settings::new(lattice(solid, spacing, false))
            };
            let original = whole(&solid, &settings(&solid, spacing));
            let last = solid.dims.map(|n| 2 * n as i32);
            for motion in Motion::all() {
                let moved = motion.solid(&solid);
                let rows = whole(&moved, &settings(&moved, motion.spacing(spacing))).rows;
                assert_eq!(rows.len(), original.rows.len());
                let by_place: HashMap<_, _> = rows.iter().map(|r| (r.k, r)).collect();
                for row in &original.rows {
                    let there = by_place[&motion.place(row.k, last)];
                    let u = motion.vector(row.u.to_array());
                    for (u, v) in u.into_iter().zip(there.u.to_array()) {
                        assert!((u - v).abs() < 1e-9, "{motion:?} {:?}: {u} {v}", row.k);
                    }
                    let (Some(a), Some(b)) = (row.curvature, there.curvature) else {
                        assert!(row.curvature.is_none() && there.curvature.is_none());
                        continue;
                    };
                    // the smaller the area, the more rounding of its cells shows
                    let slack = 1e-9 / row.sums.mu0.min(1.0);
                    assert!(
                        (a.mean - b.mean).abs() < slack,
                        "{motion:?} {:?} H {} {} {weights:?} {:?} {:?}",
                        row.k,
                        a.mean,
                        b.mean,
                        row.sums,
                        there.sums
                    );
                    assert!(
                        (a.gaussian - b.gaussian).abs() < slack,
                        "{motion:?} {:?} G {} {} {weights:?} {estimator:?}",
                        row.k,
                        a.gaussian,
                        b.gaussian
                    );
                    // mu_Omega turns with a sense of rotation, which a mirror changes
                    let sign = if motion.mirrors() { -1.0 } else { 1.0 };
                    assert!(
                        (sign * a.quality - b.quality).abs() < slack,
                        "{motion:?} {:?} quality {} {}",
                        row.k,
                        a.quality,
                        b.quality
                    );
                    assert!((a.k1 - b.k1).abs() < 10.0 * slack);
                    assert!((a.k2 - b.k2).abs() < 10.0 * slack);
                }
            }
        }
    }
}
