//! What the tables do not show: how much errors vary with the position of the grid, and how far a voxel is felt.

use std::fmt::Write as _;

use anyhow::Result;
use curvox::volume::Criterion;
use curvox_formats::VoxelType;

use crate::in_memory::{places, rows_of};

use super::METHODS;
use super::case::{Case, Task};

/// Positions that are compared.
const POSITIONS: std::ops::RangeInclusive<u64> = 1..=12;

/// Voxels that are flipped.
const FLIPS: usize = 24;

/// Errors of one shape in many positions.
pub(super) fn positions(csv: &mut String) -> Result<String> {
    let mut text = String::from(
        "\n## Spread over positions\n\nl2 and linf of H and G on the ellipsoid of DGtal, h = 1/2, in twelve general positions \
         (orientation and sub-voxel offset): least, median, largest. The 24 rotations of a grid and its mirror images change no \
         value, bit by bit (`tests/symmetry.rs`).\n\n| method | H l2 | H linf | G l2 | G linf |\n|---|---|---|---|---|\n",
    );
    let mut found: Vec<[Vec<f64>; 4]> = vec![Default::default(); METHODS.len()];
    for position in POSITIONS {
        let task = Task {
            shape: "ellipsoid90",
            gridstep: 0.5,
            position,
            noise: 0.0,
            flat: false,
            radius: None,
        };
        for (found, trial) in found.iter_mut().zip(Case::new(task)?.trials(csv)?) {
            let errors = trial.errors[..2].iter().flatten();
            found.iter_mut().zip(errors).for_each(|(f, e)| f.push(*e));
        }
    }
    for ((name, ..), found) in METHODS.iter().zip(&mut found) {
        let _ = write!(text, "| {name} |");
        for errors in found {
            errors.sort_by(f64::total_cmp);
            let [least, median, largest] =
                [0, errors.len() / 2, errors.len() - 1].map(|i| errors[i]);
            let _ = write!(text, " {least:.4}, {median:.4}, {largest:.4} |");
        }
        let _ = writeln!(text);
    }
    Ok(text)
}

/// How far from a flipped voxel rows change.
pub(super) fn reach() -> Result<String> {
    let mut text = String::from(
        "\n## Reach\n\nOn Goursat's surface, h = 1/4, general position, radius 3 voxels, single voxels on the surface were flipped one after the \
         other: the largest distance from the voxel's centre at which a surfel that was there before and after changed any of its values.\n\n\
         | method | voxels | radii |\n|---|---|---|\n",
    );
    let case = Case::new(Task {
        shape: "goursat",
        gridstep: 0.25,
        position: 1,
        noise: 0.0,
        flat: false,
        radius: None,
    })?;
    let inside = || Criterion::AtLeast(1i128.into());
    let radius = 3.0;
    for (name, method, oriented) in METHODS {
        let settings = case.settings(method, oriented, 0.25 * radius)?;
        let before = rows_of(case.stored(), VoxelType::U8, inside(), &settings)?;
        let values = |rows: &[curvox::sink::SurfelBatch]| {
            places(rows)
                .map(|(b, i)| {
                    let at = &b.curvatures[0];
                    let floats = [at.mean[i], at.gaussian[i], at.k1[i], at.k2[i]];
                    let normal = [0, 1, 2].map(|a| b.normal[a][i].to_bits());
                    let k = [b.k[0][i], b.k[1][i], b.k[2][i]];
                    ((k, b.side[i]), (floats.map(f32::to_bits), normal))
                })
                .collect::<std::collections::BTreeMap<_, _>>()
        };
        let base = values(&before);
        let [nx, ny, _] = settings.lattice.dims.map(|n| n as usize);
        let mut farthest = 0.0f64;
        let step = base.len() / FLIPS;
        for ((k, side), _) in base.iter().step_by(step.max(1)) {
            // the voxel on the inner side of the surfel
            let voxel = [0, 1, 2].map(|a| {
                let inner = if k[a] % 2 == 0 {
                    k[a] - i32::from(*side)
                } else {
                    k[a]
                };
                ((inner - 1) / 2) as usize
            });
            let mut stored = case.stored().to_vec();
            stored[(voxel[2] * ny + voxel[1]) * nx + voxel[0]] ^= 1;
            let after = values(&rows_of(&stored, VoxelType::U8, inside(), &settings)?);
            for (place, values) in &after {
                if base.get(place).is_some_and(|b| b != values) {
                    let d =
                        [0, 1, 2].map(|a| 0.5 * f64::from(place.0[a]) - (voxel[a] as f64 + 0.5));
                    farthest = farthest.max(d.iter().map(|x| x * x).sum::<f64>().sqrt());
                }
            }
        }
        let _ = writeln!(
            text,
            "| {name} | {farthest:.1} | {:.2} |",
            farthest / radius
        );
    }
    Ok(text)
}
