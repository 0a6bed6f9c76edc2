//! Tests of the sinks as a whole. Rows are made here: a wavy ball with plausible values.

mod dataset;
mod measure;
mod single;
mod slices;
mod summary;

use std::path::Path;

use serde_json::json;

use super::*;

/// A table of an image of `dims` voxels with `radii` measure radii.
fn info(dims: [u32; 3], radii: usize, directions: bool) -> TableInfo {
    let radii = [("3vx", 3.0), ("4.5vx", 4.5)][..radii].iter();
    TableInfo {
        dims,
        spacing: [0.5, 0.5, 1.0],
        unit: "um".into(),
        first_index: [0; 3],
        origin: [10.0, -3.0, 0.25],
        direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        radii: radii
            .map(|&(label, voxels)| RadiusInfo {
                label: label.into(),
                voxels,
                world: voxels / 2.0,
            })
            .collect(),
        directions,
        // all columns that are not always there
        quality: directions,
        errors: directions,
        parameters: json!({"threshold": 0.5, "normals": "average"}),
        version: "0.1.0".into(),
        conventions: vec![
            "Normals point outward.".into(),
            "A convex body has H > 0.".into(),
        ],
    }
}

/// Numbers that look random and are the same everywhere.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Between -1 and 1.
    fn signed(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

/// All surfels of a wavy ball that fills the image, in Khalimsky order, as one batch.
fn wavy_ball(info: &TableInfo) -> SurfelBatch {
    let dims = info.dims.map(i64::from);
    let wave: Vec<Vec<f32>> = dims
        .iter()
        .map(|&d| (-1..=d).map(|i| (i as f32 * 0.27).sin()).collect())
        .collect();
    let radius = 0.44 * dims.into_iter().min().unwrap() as f32;
    let inside = |p: [i64; 3]| {
        if (0..3).any(|a| p[a] < 0 || p[a] >= dims[a]) {
            return false;
        }
        let mut d2 = 0.0;
        let mut w = 0.12;
        for a in 0..3 {
            let c = p[a] as f32 - 0.5 * dims[a] as f32;
            d2 += c * c;
            w *= wave[a][(p[a] + 1) as usize];
        }
        d2 < radius * radius * (1.0 + w)
    };
    let mut noise = Noise(7);
    let mut rows = SurfelBatch::with_capacity(info, 0);
    // Khalimsky coordinates of surfels between voxels of the image, slowest first.
    for kz in 1..2 * dims[2] {
        for ky in 1..2 * dims[1] {
            if kz % 2 == 0 && ky % 2 == 0 {
                continue;
            }
            let step = if kz % 2 == 0 || ky % 2 == 0 { 2 } else { 1 };
            for kx in (if step == 2 { 1 } else { 2 }..2 * dims[0]).step_by(2) {
                let k = [kx, ky, kz];
                let axis = (0..3).find(|&a| k[a] % 2 == 0).unwrap();
                let voxel = |end: i64| {
                    let mut p = k.map(|c| (c - 1) / 2);
                    p[axis] = k[axis] / 2 - 1 + end;
                    p
                };
                let (low, high) = (inside(voxel(0)), inside(voxel(1)));
                if low != high {
                    let side = if low { 1 } else { -1 };
                    push_row(&mut rows, info, k.map(|c| c as i32), axis, side, &mut noise);
                }
            }
        }
    }
    rows
}

fn push_row(
    rows: &mut SurfelBatch,
    info: &TableInfo,
    k: [i32; 3],
    axis: usize,
    side: i8,
    noise: &mut Noise,
) {
    let mut n = [0.0_f32; 3];
    let mut length = 0.0;
    for a in 0..3 {
        let index = 0.5 * (f64::from(k[a]) - 1.0);
        rows.k[a].push(k[a]);
        rows.position[a].push((info.origin[a] + info.spacing[a] * index) as f32);
        n[a] = (index as f32 - 0.5 * info.dims[a] as f32) + 0.3 * noise.signed();
        length += n[a] * n[a];
    }
    let length = length.sqrt().max(1e-3);
    for a in 0..3 {
        rows.normal[a].push(n[a] / length);
    }
    rows.side.push(side);
    rows.area.push(0.25 * n[axis] / length * f32::from(side));
    for (at, radius) in rows.curvatures.iter_mut().zip(&info.radii) {
        let wave = (k[0] as f32 * 0.13).sin() * (k[1] as f32 * 0.11).cos();
        let scale = 0.2 / radius.world as f32;
        let mean = scale * (1.0 + wave + 0.05 * noise.signed());
        let half = scale * (0.3 + 0.05 * noise.signed()).abs();
        let none = noise.next().is_multiple_of(997);
        at.mean.push(if none { f32::NAN } else { mean });
        at.gaussian.push(if none {
            f32::NAN
        } else {
            mean * mean - half * half
        });
        at.k1.push(if none { f32::NAN } else { mean - half });
        at.k2.push(if none { f32::NAN } else { mean + half });
        if info.directions {
            for a in 0..3 {
                at.d1[a].push(noise.signed());
                at.d2[a].push(noise.signed());
            }
        }
        if info.quality {
            at.quality.push(0.1 * noise.signed());
        }
        if info.errors {
            at.mean_error.push(0.01 * noise.signed().abs());
            at.gaussian_error.push(0.02 * noise.signed().abs());
        }
        let border = if k[2] < 12 { Flag::Border.bit() } else { 0 };
        at.flags
            .push(if none { Flag::NoArea.bit() } else { 0 } | border);
    }
}

/// The rows `from..to` of a batch, as a batch.
fn piece(rows: &SurfelBatch, info: &TableInfo, from: usize, to: usize) -> SurfelBatch {
    let mut piece = SurfelBatch::with_capacity(info, 0);
    piece.column = rows.column;
    piece.extend_from(rows, from..to);
    piece
}

/// Sends rows in pieces that end at `cuts`.
fn send(sink: &mut dyn SurfelSink, rows: &SurfelBatch, info: &TableInfo, cuts: &[usize]) {
    let mut cuts: Vec<usize> = cuts.iter().map(|&cut| cut.min(rows.len())).collect();
    cuts.push(rows.len());
    cuts.sort_unstable();
    let mut from = 0;
    for to in cuts {
        sink.write(&piece(rows, info, from, to)).unwrap();
        from = to;
    }
}

/// All files below a folder with their bytes, names relative to it.
fn files_below(folder: &Path) -> std::collections::BTreeMap<String, Vec<u8>> {
    let mut files = std::collections::BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(here) = folders.pop() {
        for entry in std::fs::read_dir(&here).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                files.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    files
}

/// Whether two batches hold the same values, NaN counting as equal to NaN.
fn assert_same_rows(a: &SurfelBatch, b: &SurfelBatch) {
    fn bits(columns: &[Vec<f32>]) -> Vec<Vec<u32>> {
        columns
            .iter()
            .map(|c| c.iter().map(|v| v.to_bits()).collect())
            .collect()
    }
    assert_eq!(a.k, b.k);
    assert_eq!(a.side, b.side);
    assert_eq!(bits(&a.position), bits(&b.position));
    assert_eq!(bits(&a.normal), bits(&b.normal));
    assert_eq!(
        bits(std::slice::from_ref(&a.area)),
        bits(std::slice::from_ref(&b.area))
    );
    assert_eq!(a.curvatures.len(), b.curvatures.len());
    for (a, b) in a.curvatures.iter().zip(&b.curvatures) {
        let values = |c: &CurvatureColumns| {
            bits(&[
                c.mean.clone(),
                c.gaussian.clone(),
                c.k1.clone(),
                c.k2.clone(),
                c.quality.clone(),
                c.mean_error.clone(),
                c.gaussian_error.clone(),
            ])
        };
        assert_eq!(values(a), values(b));
        assert_eq!(bits(&a.d1), bits(&b.d1));
        assert_eq!(bits(&a.d2), bits(&b.d2));
        assert_eq!(a.flags, b.flags);
    }
}

/// The Parquet files of a dataset, in order.
fn part_files(folder: &Path) -> Vec<std::path::PathBuf> {
    let names = files_below(&folder.join(SURFELS_DIRECTORY)).into_keys();
    names
        .map(|name| folder.join(SURFELS_DIRECTORY).join(name))
        .collect()
}
