//! Errors of every choice of normals, weights and ball on Goursat, against the truth.

use std::path::Path;

use anyhow::{Context, Result, ensure};

use crate::goursat;
use crate::npz::Table;
use crate::plain::{
    BallKind, Cells, Estimator, Orientation, Scale, Settings, Surface, Weights, measure, normals,
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
    fn between(found: impl Iterator<Item = f64>, truth: &[f64]) -> Self {
        let mut errors = Errors::default();
        for (value, truth) in found.zip(truth) {
            let error = (value - truth).abs();
            errors.l2 += error * error;
            // Not f64::max, which would hide a NaN.
            if !(error <= errors.linf) {
                errors.linf = error;
            }
        }
        errors.l2 = (errors.l2 / truth.len() as f64).sqrt();
        errors
    }
}

/// A choice and its errors of H, G, k1, k2.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Gridstep in world units.
    pub gridstep: f64,
    /// The normals, by a short name.
    pub normals: &'static str,
    /// How cells are weighted.
    pub weights: Weights,
    /// Which surfels of the ball count.
    pub ball: BallKind,
    /// Errors of H, G, k1, k2.
    pub errors: [Errors; 4],
}

/// The trials on Goursat at one gridstep, with r = rho = 3 h^(1/2); the truth comes from
/// `goursat_h<gridstep>.npz` in the folder `reference`.
///
/// # Errors
/// If the table cannot be read or does not describe this surface.
pub fn trials(reference: &Path, gridstep: f64) -> Result<Vec<Trial>> {
    let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz")))?;
    let (solid, origin) = goursat::digitised(gridstep);
    let radius_world = 3.0 * gridstep.sqrt();
    let base = Settings {
        count_sheets: false,
        ..Settings::new([gridstep; 3], radius_world)
    };
    let scale = Scale::new(base.spacing_world);
    let surface = Surface::new(&solid, base.closed, base.adjacency);
    let truth = truth(&table, &surface, origin)?;

    let mut trials = Vec::new();
    for (name, estimator) in [
        (
            "II moment",
            Estimator::IntegralInvariant {
                radius_world,
                orientation: Orientation::Moment,
            },
        ),
        (
            "II dgtal",
            Estimator::IntegralInvariant {
                radius_world,
                orientation: Orientation::Dgtal,
            },
        ),
        ("average", Estimator::SurfaceAverage { radius_world }),
    ] {
        let normals = normals::estimate(&solid, &surface, &scale, estimator);
        let cells = Cells::new(&surface, &normals.u, &scale);
        for weights in [Weights::Sharp, Weights::Lumped, Weights::Dgtal] {
            for ball in [BallKind::Connected, BallKind::Whole] {
                let settings = Settings {
                    weights,
                    ball,
                    ..base
                };
                let rows = measure(&surface, &normals, &cells, &scale, &settings);
                let column = |i: usize| {
                    rows.iter().map(move |row| {
                        let c = &row.curvature;
                        [c.mean, c.gaussian, c.k1, c.k2][i]
                    })
                };
                let errors = [0, 1, 2, 3].map(|i| Errors::between(column(i), &truth[i]));
                trials.push(Trial {
                    gridstep,
                    normals: name,
                    weights,
                    ball,
                    errors,
                });
            }
        }
    }
    Ok(trials)
}

/// True H, G, k1, k2 in the order of the surfels.
fn truth(table: &Table, surface: &Surface, origin: i32) -> Result<[Vec<f64>; 4]> {
    let (mean, gaussian) = (table.column("H_true")?, table.column("G_true")?);
    let places = table.triples("k")?;
    ensure!(
        places.len() == surface.len(),
        "the table has {} surfels, the shape {}",
        places.len(),
        surface.len()
    );
    let mut truth = [(); 4].map(|()| vec![f64::NAN; surface.len()]);
    for (row, place) in places.iter().enumerate() {
        let k = place.map(|k| k as i32 + 2 * origin);
        let surfel = surface
            .find(k)
            .with_context(|| format!("no surfel at {place:?}"))? as usize;
        let (h, g) = (mean[row], gaussian[row]);
        let spread = (h * h - g).max(0.0).sqrt();
        for (column, value) in [h, g, h - spread, h + spread].into_iter().enumerate() {
            truth[column][surfel] = value;
        }
    }
    Ok(truth)
}
