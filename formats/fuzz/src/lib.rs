//! What the fuzz targets share: a look into a volume that may claim to be of any size.

use curvox_formats::{Error, OpenOptions, Region, Volume, Voxels};

/// Options with a small limit for copies.
pub fn options() -> OpenOptions {
    OpenOptions {
        spool_limit_bytes: 1 << 20,
        ..OpenOptions::default()
    }
}

/// Reads a few boxes, or a few planes. Any error is fine; a panic, a hang or a huge allocation is
/// what is looked for.
pub fn look_into(opened: Result<Volume, Error>) {
    const PLANE_BYTES: u64 = 1 << 20;
    let Ok(volume) = opened else { return };
    let header = volume.header.clone();
    match volume.voxels {
        Voxels::Random(voxels) => {
            let mut out = Vec::new();
            for part in 0..3 {
                let size = header.dims.map(|n| n.min(16));
                let origin = [0, 1, 2].map(|a| (header.dims[a] - size[a]) / 2 * part);
                let region = Region { origin, size };
                let _ = voxels.uniform(&region);
                if voxels.read_box(&region, &mut out).is_err() {
                    return;
                }
            }
        }
        Voxels::Forward(mut planes) => {
            let mut out = Vec::new();
            for _ in 0..16 {
                let large = header.plane_bytes().is_none_or(|n| n > PLANE_BYTES);
                if large || planes.read_planes(1, &mut out).unwrap_or(0) == 0 {
                    break;
                }
            }
            let _ = planes.finish();
        }
    }
}
