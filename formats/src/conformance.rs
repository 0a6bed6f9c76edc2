//! What every reader must do, as a check that any reader can be put through.
//!
//! In: a way to open a volume, which is called several times. Out: nothing, or the first rule
//! that was broken. The rules:
//!
//! - the header is sane, and the same each time (a spacing is positive, directions are unit);
//! - planes read one by one, in twos and all at once are the same bytes, and nothing follows;
//! - boxes hold the same voxels as the planes: single voxels, rows, columns, corners, all;
//! - `planes` gives the same bytes where it gives any, and `release` takes nothing away;
//! - a box or planes beyond the extents are an error, and leave the reader usable;
//! - boxes read from several threads at once are right.

use crate::error::Error;
use crate::header::{Header, Region};
use crate::volume::{RandomVoxels, Volume, Voxels};

/// Puts a reader through the rules of this module. The volume must fit memory.
///
/// # Errors
///
/// The broken rule, in words.
pub fn check(open: impl Fn() -> Result<Volume, Error>) -> Result<(), String> {
    let failed = |e: Error| format!("failed: {e}");
    let first = open().map_err(failed)?;
    let header = first.header.clone();
    check_header(&header)?;
    let all = read_forward(first, u64::MAX)?;
    let expected = header.voxels_bytes().ok_or("the volume does not fit u64")?;
    if all.len() as u64 != expected {
        return Err(format!(
            "{} bytes of planes, {expected} expected",
            all.len()
        ));
    }
    for count in [1, 2] {
        let again = open().map_err(failed)?;
        if again.header != header {
            return Err("opened again, the header differs".into());
        }
        if read_forward(again, count)? != all {
            return Err(format!(
                "planes read {count} at a time differ from all at once"
            ));
        }
    }
    if let Voxels::Random(voxels) = open().map_err(failed)?.voxels {
        check_boxes(&*voxels, &header, &all)?;
    }
    Ok(())
}

fn check_header(header: &Header) -> Result<(), String> {
    if header.dims.contains(&0) {
        return Err(format!("an extent of {:?} is 0", header.dims));
    }
    if let Some(spacing) = header.spacing
        && !spacing.iter().all(|s| s.is_finite() && *s > 0.0)
    {
        return Err(format!("the spacing {spacing:?} is not positive"));
    }
    for axis in 0..3 {
        let length: f64 = header
            .direction
            .iter()
            .map(|row| row[axis] * row[axis])
            .sum();
        if (length - 1.0).abs() > 1e-6 {
            return Err(format!(
                "the direction of axis {axis} has length {}",
                length.sqrt()
            ));
        }
    }
    if !header.origin.iter().all(|x| x.is_finite()) {
        return Err(format!("the origin {:?} is not finite", header.origin));
    }
    if let Some(scaling) = header.scaling
        && !(scaling.slope.is_finite() && scaling.slope != 0.0 && scaling.intercept.is_finite())
    {
        return Err(format!("{scaling:?} is no scaling"));
    }
    Ok(())
}

fn read_forward(volume: Volume, count: u64) -> Result<Vec<u8>, String> {
    let failed = |e: Error| format!("planes: {e}");
    let plane = volume
        .header
        .plane_bytes()
        .ok_or("a plane does not fit u64")?;
    let mut voxels = volume.into_forward();
    let (mut all, mut some) = (Vec::new(), vec![1, 2, 3]);
    loop {
        let found = voxels.read_planes(count, &mut some).map_err(failed)?;
        if some.len() as u64 != found * plane {
            return Err(format!("{found} planes came with {} bytes", some.len()));
        }
        if found == 0 {
            break;
        }
        all.extend_from_slice(&some);
    }
    voxels.finish().map_err(failed)?;
    Ok(all)
}

fn check_boxes(voxels: &dyn RandomVoxels, header: &Header, all: &[u8]) -> Result<(), String> {
    let dims = header.dims;
    let regions = regions(dims);
    let check = |region: &Region| {
        let mut found = vec![7; 5];
        voxels
            .read_box(region, &mut found)
            .map_err(|e| format!("{region:?}: {e}"))?;
        if found != cut(all, dims, header.voxel.bytes(), region) {
            return Err(format!("{region:?}: the box differs from the planes"));
        }
        Ok(())
    };
    for region in &regions {
        check(region)?;
    }

    let plane = all.len() / dims[2] as usize;
    for (z, count) in [
        (0, dims[2]),
        (0, 1),
        (dims[2] - 1, 1),
        (dims[2] / 2, dims[2] - dims[2] / 2),
    ] {
        let found = voxels
            .planes(z, count)
            .map_err(|e| format!("planes {z}, {count}: {e}"))?;
        let (from, to) = (z as usize * plane, (z + count) as usize * plane);
        if found.is_some_and(|found| found != &all[from..to]) {
            return Err(format!("planes {z}, {count}: not the bytes read forward"));
        }
    }
    voxels.check().map_err(|e| format!("check: {e}"))?;
    voxels.release(dims[2]);
    voxels.release(u64::MAX);

    let mut out = Vec::new();
    for axis in 0..3 {
        for (origin, size) in [
            (dims[axis], 1),
            (0, dims[axis] + 1),
            (u64::MAX, 1),
            (1, u64::MAX),
        ] {
            let mut region = Region {
                origin: [0; 3],
                size: [1; 3],
            };
            region.origin[axis] = origin;
            region.size[axis] = size;
            if voxels.read_box(&region, &mut out).is_ok() {
                return Err(format!("{region:?}: beyond the extents, and no error"));
            }
        }
    }
    for (z, count) in [(dims[2], 1), (0, dims[2] + 1), (u64::MAX, 1), (1, u64::MAX)] {
        if voxels.planes(z, count).is_ok() {
            return Err(format!(
                "planes {z}, {count}: beyond the extents, and no error"
            ));
        }
    }

    let results: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| regions.iter().try_for_each(check)))
            .collect();
        threads.into_iter().map(|thread| thread.join()).collect()
    });
    for result in results {
        result.map_err(|_| "a thread panicked".to_string())??;
    }
    Ok(())
}

/// Boxes at the corners, edges and faces, inside, and the whole.
fn regions(dims: [u64; 3]) -> Vec<Region> {
    let spans = dims.map(|n| {
        let mut spans = vec![(0, 1), (0, n), (n - 1, 1), (n / 2, n - n / 2)];
        if n > 2 {
            spans.push((1, n - 2));
        }
        spans
    });
    let mut regions = vec![Region {
        origin: [0; 3],
        size: [0; 3],
    }];
    for &(x, sx) in &spans[0] {
        for &(y, sy) in &spans[1] {
            for &(z, sz) in &spans[2] {
                regions.push(Region {
                    origin: [x, y, z],
                    size: [sx, sy, sz],
                });
            }
        }
    }
    regions
}

/// The voxels of a region, taken one by one.
fn cut(all: &[u8], dims: [u64; 3], voxel_bytes: usize, region: &Region) -> Vec<u8> {
    let mut out = Vec::new();
    let [x, y, z] = region.origin;
    for k in z..z + region.size[2] {
        for j in y..y + region.size[1] {
            for i in x..x + region.size[0] {
                let voxel = ((k * dims[1] + j) * dims[0] + i) as usize * voxel_bytes;
                out.extend_from_slice(&all[voxel..voxel + voxel_bytes]);
            }
        }
    }
    out
}
