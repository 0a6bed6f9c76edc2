//! Errors of every choice of normals, weights and ball, against the truth.
//!
//! Goursat as the paper has it; a torus in general position; and a spherical shell two voxels
//! thick, where sheets are closer than the radius and the choices differ most.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, ensure};

use crate::goursat;
use crate::npz::Table;
use crate::plain::algebra::{Vector, dot, norm, normalised};
use crate::plain::{
    BallKind, Cells, Estimator, Orientation, Scale, Settings, Solid, Surface, Ties, Weights,
    measure, normals,
};

/// Errors of one quantity over all surfels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    /// Root mean square.
    pub l2: f64,
    /// Largest.
    pub linf: f64,
}

impl Errors {
    fn between(found: impl Iterator<Item = f64>, truth: impl Iterator<Item = f64>) -> Self {
        let mut errors = Errors::default();
        let mut count = 0;
        for (value, truth) in found.zip(truth) {
            let error = (value - truth).abs();
            errors.l2 += error * error;
            // In total order NaN is the largest; f64::max would hide it.
            if error.total_cmp(&errors.linf).is_gt() {
                errors.linf = error;
            }
            count += 1;
        }
        errors.l2 = (errors.l2 / f64::from(count)).sqrt();
        errors
    }
}

/// A choice, its errors and its cost.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The normals, by a short name.
    pub normals: &'static str,
    /// How cells are weighted.
    pub weights: Weights,
    /// Which surfels of the ball count.
    pub ball: BallKind,
    /// Errors of H, G, k1, k2.
    pub errors: [Errors; 4],
    /// Time of the normals and of the ball sums with curvatures, microseconds a surfel.
    pub microseconds: [f64; 2],
}

/// A solid whose true curvatures are known at each surfel.
#[derive(Clone, Debug)]
pub struct KnownShape {
    /// The digitisation.
    pub solid: Solid,
    /// The edge of a voxel in world units.
    pub gridstep: f64,
    /// Its boundary, open border, interior adjacency.
    pub surface: Surface,
    /// True H, G, k1, k2 at each surfel.
    pub truth: Vec<[f64; 4]>,
}

impl KnownShape {
    /// Goursat; the truth comes from `goursat_h<gridstep>.npz` in the folder `reference`.
    ///
    /// # Errors
    /// If the table cannot be read or does not describe this surface.
    pub fn goursat(reference: &Path, gridstep: f64) -> Result<Self> {
        let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz")))?;
        let (solid, origin) = goursat::digitised(gridstep);
        let mut shape = Self::new(solid, gridstep, |_| (f64::NAN, f64::NAN));
        let places = table.triples("k")?;
        let (mean, gaussian) = (table.column("H_true")?, table.column("G_true")?);
        let surfels = shape.surface.len();
        ensure!(
            places.len() == surfels,
            "the table has {} surfels, the shape {surfels}",
            places.len()
        );
        for (row, place) in places.iter().enumerate() {
            let k = place.map(|k| k as i32 + 2 * origin);
            let surfel = shape.surface.find(k);
            let surfel = surfel.with_context(|| format!("no surfel at {place:?}"))?;
            shape.truth[surfel as usize] = with_principal(mean[row], gaussian[row]);
        }
        Ok(shape)
    }

    /// A torus of radii 6 and 2.4 about an axis in general position.
    pub fn torus(gridstep: f64) -> Self {
        const MAJOR: f64 = 6.0;
        const MINOR: f64 = 2.4;
        let axis = normalised([1.0, 2.0, 3.0]);
        // Distance from the circle in the middle, and its part away from the axis.
        let place = |x: Vector| {
            let x = [x[0] - 0.13, x[1] - 0.27, x[2] - 0.41];
            let height = dot(x, axis);
            let away = (dot(x, x) - height * height).max(0.0).sqrt() - MAJOR;
            (away.hypot(height), away)
        };
        Self::new(
            digitised(gridstep, 9.0, |x| place(x).0 <= MINOR),
            gridstep,
            |x| {
                let (distance, away) = place(x);
                let cosine = away / distance;
                let around = cosine / (MAJOR + MINOR * cosine);
                (0.5 * (1.0 / MINOR + around), around / MINOR)
            },
        )
    }

    /// A spherical shell of outer radius 8, two voxels thick.
    pub fn shell(gridstep: f64) -> Self {
        const OUTER: f64 = 8.0;
        let inner = OUTER - 2.0 * gridstep;
        let radius = |x: Vector| norm([x[0] - 0.13, x[1] - 0.27, x[2] - 0.41]);
        let solid = digitised(gridstep, 9.0, |x| radius(x) <= OUTER && radius(x) > inner);
        Self::new(solid, gridstep, |x| {
            if radius(x) > 0.5 * (inner + OUTER) {
                (1.0 / OUTER, 1.0 / (OUTER * OUTER))
            } else {
                (-1.0 / inner, 1.0 / (inner * inner))
            }
        })
    }

    /// `truth` gives H and G at the centroid of a surfel, relative to the middle of the image.
    fn new(solid: Solid, gridstep: f64, truth: impl Fn(Vector) -> (f64, f64)) -> Self {
        let base = Settings::new([gridstep; 3], 1.0);
        let surface = Surface::new(&solid, base.closed, base.adjacency);
        let truth = surface.surfels.iter().map(|surfel| {
            let x =
                [0, 1, 2].map(|a| 0.5 * gridstep * f64::from(surfel.k[a] - solid.dims[a] as i32));
            let (mean, gaussian) = truth(x);
            with_principal(mean, gaussian)
        });
        let truth = truth.collect();
        KnownShape {
            solid,
            gridstep,
            surface,
            truth,
        }
    }

    /// Every choice, with r = rho = 3 h^(1/2).
    pub fn trials(&self) -> Vec<Trial> {
        let radius_world = 3.0 * self.gridstep.sqrt();
        let base = Settings {
            count_sheets: false,
            ..Settings::new([self.gridstep; 3], radius_world)
        };
        let scale = Scale::new(base.spacing_world);
        let invariant = |orientation| Estimator::IntegralInvariant {
            radius_world,
            orientation,
        };
        let mut trials = Vec::new();
        for (name, estimator) in [
            ("II moment", invariant(Orientation::Moment)),
            ("II dgtal", invariant(Orientation::Dgtal)),
            (
                "VCM",
                Estimator::VoronoiCovariance {
                    voronoi_radius_world: radius_world * 10.0 / 3.0,
                    radius_world,
                    ties: Ties::Shared,
                    orientation: Orientation::Surface,
                },
            ),
            ("average", Estimator::SurfaceAverage { radius_world }),
        ] {
            let start = Instant::now();
            let normals = normals::estimate(&self.solid, &self.surface, &scale, estimator);
            let normals_time = self.microseconds_since(start);
            let cells = Cells::new(&self.surface, &normals.u, &scale);
            for weights in [Weights::Sharp, Weights::Lumped, Weights::Dgtal] {
                for ball in [BallKind::Connected, BallKind::Whole] {
                    let settings = Settings {
                        weights,
                        ball,
                        ..base
                    };
                    let start = Instant::now();
                    let rows = measure(&self.surface, &normals, &cells, &scale, &settings);
                    let microseconds = [normals_time, self.microseconds_since(start)];
                    let errors = [0, 1, 2, 3].map(|i| {
                        let found = rows.iter().map(|row| {
                            let c = &row.curvature;
                            [c.mean, c.gaussian, c.k1, c.k2][i]
                        });
                        Errors::between(found, self.truth.iter().map(|truth| truth[i]))
                    });
                    trials.push(Trial {
                        normals: name,
                        weights,
                        ball,
                        errors,
                        microseconds,
                    });
                }
            }
        }
        trials
    }

    fn microseconds_since(&self, start: Instant) -> f64 {
        start.elapsed().as_secs_f64() * 1e6 / self.surface.len() as f64
    }
}

/// The Gauss digitisation of a shape in [-half_box, half_box]^3, the origin in the middle.
fn digitised(gridstep: f64, half_box: f64, inside: impl Fn(Vector) -> bool) -> Solid {
    let origin = (half_box / gridstep).ceil() as i32 + 2;
    Solid::from_fn([2 * origin as usize + 1; 3], |voxel| {
        inside(voxel.map(|i| f64::from(i - origin) * gridstep))
    })
}

/// H, G and the principal curvatures that go with them.
fn with_principal(mean: f64, gaussian: f64) -> [f64; 4] {
    let spread = (mean * mean - gaussian).max(0.0).sqrt();
    [mean, gaussian, mean - spread, mean + spread]
}
