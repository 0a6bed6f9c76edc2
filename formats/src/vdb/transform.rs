//! From indices to the world: the maps of a grid.
//!
//! In: a cursor at the transform of a grid. Out: an affine map, or the name of one that is not
//! affine (a frustum). OpenVDB multiplies row vectors from the left, world = index * matrix, so
//! row `a` of the matrix is what axis `a` becomes and row 3 is the translation.

use super::archive::version;
use super::cursor::Cursor;
use crate::error::Error;
use crate::header::Header;
use crate::parsed::is_plausible_spacing;

/// What a transform is.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Transform {
    /// World = origin + sum of index\[a\] * axes\[a\].
    Affine {
        /// What a step along each axis of the index space is in the world.
        axes: [[f64; 3]; 3],
        /// World position of the centre of voxel (0, 0, 0).
        origin: [f64; 3],
    },
    /// Voxels whose size changes along the view of a camera.
    Frustum,
}

const WHAT: &str = "the transform of a grid";

/// Reads the transform of a grid, to its end.
pub(super) fn read(cursor: &mut Cursor<'_>, file_version: u32) -> Result<Transform, Error> {
    let at = cursor.offset();
    let kind = cursor.string(WHAT)?;
    if file_version < version::MAPS {
        return match kind.as_str() {
            "LinearTransform" => old_linear(cursor),
            _ => Err(cursor.unsupported(format!(
                "a transform of type {kind:?} of file version {file_version}; LinearTransform is \
                 read"
            ))),
        };
    }
    if kind == "NonlinearFrustumMap" {
        // A box, taper and depth, then the linear part, which is read over.
        triple(cursor)?;
        triple(cursor)?;
        cursor.f64(WHAT)?;
        cursor.f64(WHAT)?;
        let inner = cursor.string(WHAT)?;
        return match linear(cursor, &inner)? {
            Some(_) => Ok(Transform::Frustum),
            None => Err(unknown(cursor, at, &inner)),
        };
    }
    linear(cursor, &kind)?.ok_or_else(|| unknown(cursor, at, &kind))
}

fn unknown(cursor: &Cursor<'_>, at: u64, kind: &str) -> Error {
    cursor
        .unsupported(format!(
            "a transform of the unknown type \"{}\"",
            kind.escape_debug()
        ))
        .at(at)
}

fn triple(cursor: &mut Cursor<'_>) -> Result<[f64; 3], Error> {
    Ok([cursor.f64(WHAT)?, cursor.f64(WHAT)?, cursor.f64(WHAT)?])
}

/// One of the affine maps; `None` for a type that is none of them.
fn linear(cursor: &mut Cursor<'_>, kind: &str) -> Result<Option<Transform>, Error> {
    let (moved, scaled) = match kind {
        "ScaleMap" | "UniformScaleMap" => (false, true),
        "TranslationMap" => (true, false),
        "ScaleTranslateMap" | "UniformScaleTranslateMap" => (true, true),
        "AffineMap" | "UnitaryMap" => {
            let matrix = matrix(cursor)?;
            return affine(cursor, matrix).map(Some);
        }
        _ => return Ok(None),
    };
    let origin = if moved { triple(cursor)? } else { [0.0; 3] };
    let mut scale = [1.0; 3];
    if scaled {
        scale = triple(cursor)?;
        // Voxel size, inverse, square of the inverse, half of the inverse: all follow.
        for _ in 0..4 {
            triple(cursor)?;
        }
    }
    let [x, y, z] = scale;
    Ok(Some(Transform::Affine {
        axes: [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]],
        origin,
    }))
}

fn matrix(cursor: &mut Cursor<'_>) -> Result<[[f64; 4]; 4], Error> {
    let mut matrix = [[0.0; 4]; 4];
    for number in matrix.iter_mut().flatten() {
        *number = cursor.f64(WHAT)?;
    }
    Ok(matrix)
}

fn affine(cursor: &Cursor<'_>, rows: [[f64; 4]; 4]) -> Result<Transform, Error> {
    if rows.map(|row| row[3]) != [0.0, 0.0, 0.0, 1.0] {
        return Err(cursor.unsupported(
            "a transform whose matrix is not affine (its last column is not 0, 0, 0, 1)",
        ));
    }
    let [x, y, z, origin] = rows.map(|row| [row[0], row[1], row[2]]);
    Ok(Transform::Affine {
        axes: [x, y, z],
        origin,
    })
}

/// The only transform of old files that is read: a box of indices, then four matrices, of which
/// voxel to local and local to world matter.
fn old_linear(cursor: &mut Cursor<'_>) -> Result<Transform, Error> {
    cursor.skip(24, WHAT)?;
    let local_to_world = matrix(cursor)?;
    cursor.skip(128, WHAT)?;
    let voxel_to_local = matrix(cursor)?;
    cursor.skip(128, WHAT)?;
    let product = voxel_to_local.map(|row| {
        std::array::from_fn(|c| (0..4).map(|k| row[k] * local_to_world[k][c]).sum::<f64>())
    });
    affine(cursor, product)
}

impl Transform {
    /// Sets spacing, origin and direction of `header`, whose `first_index` is known. A transform
    /// that is no such thing is left out with a warning.
    pub(super) fn place(&self, header: &mut Header, name: &str) -> Result<(), Error> {
        /// Cosines below this come from rounding to single precision.
        const ROUNDING: f64 = 1e-3;
        let Self::Affine { axes, origin } = self else {
            return Err(Error::unsupported(
                name,
                "the grid has a frustum transform (NonlinearFrustumMap): its voxels are no boxes \
                 of one size, and are not read",
            ));
        };
        let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let lengths = axes.map(|axis| dot(axis, axis).sqrt());
        let finite = origin
            .iter()
            .chain(axes.iter().flatten())
            .all(|x| x.is_finite());
        if !finite || !lengths.iter().all(|length| is_plausible_spacing(*length)) {
            header.warnings.push(format!(
                "{name}: the transform of the grid is none (voxels of size {lengths:?}); it is \
                 ignored and the spacing is taken as unknown"
            ));
            header.set_index_origin([0.0; 3]);
            return Ok(());
        }
        let unit: [[f64; 3]; 3] = std::array::from_fn(|a| axes[a].map(|x| x / lengths[a]));
        let [x, y, z] = unit;
        let cross = [
            y[1] * z[2] - y[2] * z[1],
            y[2] * z[0] - y[0] * z[2],
            y[0] * z[1] - y[1] * z[0],
        ];
        if dot(x, cross).abs() < 1e-6 {
            header.warnings.push(format!(
                "{name}: the transform of the grid is singular; it is ignored and the spacing is \
                 taken as unknown"
            ));
            header.set_index_origin([0.0; 3]);
            return Ok(());
        }
        if [dot(x, y), dot(y, z), dot(z, x)]
            .iter()
            .any(|cosine| cosine.abs() > ROUNDING)
        {
            header.warnings.push(format!(
                "{name}: the axes of the grid are not orthogonal (sheared); voxels are taken as \
                 boxes of {lengths:?}"
            ));
        }
        // Indices of grids have 32 bits: the conversion is exact.
        let first = header.first_index.map(|i| i as f64);
        header.origin =
            std::array::from_fn(|r| (0..3).fold(origin[r], |sum, a| sum + first[a] * axes[a][r]));
        header.direction = std::array::from_fn(|r| std::array::from_fn(|a| unit[a][r]));
        header.spacing = Some(lengths);
        Ok(())
    }
}
