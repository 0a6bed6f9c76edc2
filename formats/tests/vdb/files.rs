use std::path::Path;

use curvox_formats::{
    Content, Error, ErrorKind, Header, OpenOptions, Region, Volume, Voxels, conformance, open,
};

use crate::sha256::sha256;
use crate::support::{peak_bytes, read_all, read_path, shared_data};

/// File, number of the grid, active voxels, extents, first index, and the first 16 digits of the
/// SHA-256 of the voxels (little-endian, x fastest) of the box around the active voxels, one voxel
/// wider. All from OpenVDB's library.
type Facts = (&'static str, u32, u64, [u64; 3], [i64; 3], &'static str);

#[rustfmt::skip]
const FACTS: &[Facts] = &[
    ("vdb-fixtures/bool.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "633bc46d177eff5a"),
    ("vdb-fixtures/double.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "d23b2faffd2bef05"),
    ("vdb-fixtures/empty.vdb", 0, 0, [1, 1, 1], [0, 0, 0], "e00e5eb9444182f3"),
    ("vdb-fixtures/float_bg7.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "4b46e45914af800b"),
    ("vdb-fixtures/fog_bloscmask.vdb", 0, 903_939, [121, 121, 121], [-54, -52, -50], "bdb13ab6de19a9f9"),
    ("vdb-fixtures/inactive_tile.vdb", 0, 1, [3, 3, 3], [499, -1, -1], "04c81787b6ac0336"),
    ("vdb-fixtures/instance.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "37e523b5e5347fc6"),
    ("vdb-fixtures/instance.vdb", 1, 5_334, [22, 22, 22], [-6, -1, -1], "37e523b5e5347fc6"),
    ("vdb-fixtures/int32.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "a7d065cd33c31caa"),
    ("vdb-fixtures/int64.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "9e31090ad14fa050"),
    ("vdb-fixtures/ls_blosc.vdb", 0, 270_638, [127, 127, 127], [-57, -55, -53], "d61317d1732d213d"),
    ("vdb-fixtures/ls_bloscmask.vdb", 0, 270_638, [127, 127, 127], [-57, -55, -53], "d61317d1732d213d"),
    ("vdb-fixtures/ls_half_bloscmask.vdb", 0, 270_638, [127, 127, 127], [-57, -55, -53], "3dc1c99fd0b77353"),
    ("vdb-fixtures/ls_mask.vdb", 0, 270_638, [127, 127, 127], [-57, -55, -53], "d61317d1732d213d"),
    ("vdb-fixtures/ls_none.vdb", 0, 270_638, [127, 127, 127], [-57, -55, -53], "d61317d1732d213d"),
    ("vdb-fixtures/ls_zipmask.vdb", 0, 270_638, [127, 127, 127], [-57, -55, -53], "d61317d1732d213d"),
    ("vdb-fixtures/mask.vdb", 0, 2, [102, 3, 3], [0, 1, 2], "baa27311d7e37171"),
    ("vdb-fixtures/meta.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "37e523b5e5347fc6"),
    ("vdb-fixtures/nostats.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "37e523b5e5347fc6"),
    ("vdb-fixtures/root_tile.vdb", 0, 68_719_476_737, [5003, 4098, 4098], [-1, -1, -1], ""),
    ("vdb-fixtures/samename.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "37e523b5e5347fc6"),
    ("vdb-fixtures/samename.vdb", 1, 5_334, [22, 22, 22], [-6, -1, -1], "b28604014d4fdb3a"),
    ("vdb-fixtures/stream.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "37e523b5e5347fc6"),
    ("vdb-fixtures/tf_affine.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "b28604014d4fdb3a"),
    ("vdb-fixtures/tf_scale.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "b28604014d4fdb3a"),
    ("vdb-fixtures/tf_scaletrans.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "b28604014d4fdb3a"),
    ("vdb-fixtures/tf_translate.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "b28604014d4fdb3a"),
    ("vdb-fixtures/tf_uniform.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "b28604014d4fdb3a"),
    ("vdb-fixtures/tf_uniformtrans.vdb", 0, 5_334, [22, 22, 22], [-6, -1, -1], "b28604014d4fdb3a"),
    ("vdb-fixtures/tiles_300.vdb", 0, 27_000_000, [302, 302, 302], [-1, -1, -1], "1d749831aa502231"),
    ("vdb/cube.vdb", 0, 1_452_218, [227, 227, 227], [-113, -113, -113], "a3b357a7e15a2262"),
    ("vdb/sphere.vdb", 0, 270_638, [127, 127, 127], [-63, -63, -63], "ae8af16f4aa08191"),
    ("formats/gm-mask/bool_blosc.vdb", 0, 134_713, [73, 92, 78], [2, 2, 0], "bd0b1b5a8b5799dd"),
    ("formats/gm-mask/bool_zip.vdb", 0, 134_713, [73, 92, 78], [2, 2, 0], "bd0b1b5a8b5799dd"),
    ("formats/gm-mask/fog_blosc.vdb", 0, 134_713, [73, 92, 78], [2, 2, 0], "5522f7e28a7375a7"),
    ("formats/gm-mask/fog_zip.vdb", 0, 134_713, [73, 92, 78], [2, 2, 0], "5522f7e28a7375a7"),
    ("formats/gm-mask/levelset_blosc.vdb", 0, 297_767, [79, 98, 82], [-1, -1, -1], "c6d8cda0202837d8"),
    ("formats/gm-mask/levelset_half.vdb", 0, 297_767, [79, 98, 82], [-1, -1, -1], "f6ee5e14d9a1463e"),
    ("formats/gm-mask/levelset_zip.vdb", 0, 297_767, [79, 98, 82], [-1, -1, -1], "c6d8cda0202837d8"),
    ("formats/head-ct/affine.vdb", 0, 322_338, [62, 65, 95], [1, 0, -1], "950fa050e0d552d0"),
    ("formats/head-ct/blosc.vdb", 0, 322_338, [62, 65, 95], [1, 0, -1], "950fa050e0d552d0"),
    ("formats/head-ct/empty_grid.vdb", 0, 0, [1, 1, 1], [0, 0, 0], "df3f619804a92fdb"),
    ("formats/head-ct/half.vdb", 0, 322_338, [62, 65, 95], [1, 0, -1], "88f057e7c0bbdbeb"),
    ("formats/head-ct/int32.vdb", 0, 322_338, [62, 65, 95], [1, 0, -1], "140130778b56e1e4"),
    ("formats/head-ct/mask.vdb", 0, 322_338, [62, 65, 95], [1, 0, -1], "950fa050e0d552d0"),
    ("formats/head-ct/multi.vdb", 2, 322_338, [62, 65, 95], [1, 0, -1], "950fa050e0d552d0"),
    ("formats/head-ct/multi.vdb", 0, 0, [1, 1, 1], [0, 0, 0], "df3f619804a92fdb"),
    ("formats/head-ct/none.vdb", 0, 322_338, [62, 65, 95], [1, 0, -1], "950fa050e0d552d0"),
    ("formats/head-ct/zip.vdb", 0, 322_338, [62, 65, 95], [1, 0, -1], "950fa050e0d552d0"),
];

fn number(dataset: u32) -> OpenOptions {
    named(&dataset.to_string())
}

fn named(dataset: &str) -> OpenOptions {
    OpenOptions {
        dataset: Some(dataset.to_owned()),
        ..OpenOptions::default()
    }
}

fn detail<'a>(header: &'a Header, name: &str) -> &'a str {
    let found = header.details.iter().find(|(n, _)| *n == name);
    found.map_or("", |(_, value)| value)
}

fn value(volume: &Volume, at: [i64; 3]) -> f32 {
    let Voxels::Random(voxels) = &volume.voxels else {
        panic!("boxes expected");
    };
    let region = Region {
        origin: [0, 1, 2].map(|a| (at[a] - volume.header.first_index[a]) as u64),
        size: [1; 3],
    };
    let mut out = Vec::new();
    voxels.read_box(&region, &mut out).unwrap();
    f32::from_le_bytes([out[0], out[1], out[2], out[3]])
}

#[test]
fn every_grid_has_the_voxels_that_the_library_gives() {
    let Some(data) = shared_data() else { return };
    let mut wrong = Vec::new();
    for &(file, grid, active, dims, first, sum) in FACTS {
        let volume = open(&data.join(file), &number(grid)).unwrap_or_else(|e| panic!("{e}"));
        let header = volume.header.clone();
        let mut found = (
            detail(&header, "active voxels").parse().unwrap(),
            header.dims,
            header.first_index,
            String::new(),
        );
        if !sum.is_empty() {
            let (_, voxels, _) = read_all(volume).unwrap_or_else(|e| panic!("{e}"));
            found.3 = sha256(&voxels)[..16].to_owned();
        }
        if found != (active, dims, first, sum.to_owned()) {
            wrong.push(format!("{file} {grid}: {found:?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_memory_of_a_tree_is_told() {
    let Some(data) = shared_data() else { return };
    for (file, leaves) in [
        ("formats/head-ct/none.vdb", 700),
        ("vdb-fixtures/empty.vdb", 0),
    ] {
        let volume = open(&data.join(file), &OpenOptions::default()).unwrap();
        let held = volume.source.held_bytes;
        let found: u64 = detail(&volume.header, "leaves").parse().unwrap();
        assert!(
            found >= leaves && held >= 4 * found,
            "{file}: {held}, {found} leaves"
        );
        assert!(held <= volume.source.length_bytes.unwrap() + (32 << 20));
    }
}

#[test]
fn every_small_grid_keeps_the_rules_of_readers() {
    let Some(data) = shared_data() else { return };
    for &(file, grid, _, dims, ..) in FACTS {
        if dims.iter().product::<u64>() < 100_000 {
            conformance::check(|| open(&data.join(file), &number(grid)))
                .unwrap_or_else(|e| panic!("{file}: {e}"));
        }
    }
}

#[test]
fn inactive_voxels_and_tiles_keep_their_values() {
    let Some(data) = shared_data() else { return };
    let fixtures = data.join("vdb-fixtures");
    let surface = open(&fixtures.join("ls_bloscmask.vdb"), &OpenOptions::default()).unwrap();
    assert_eq!(surface.header.content, Content::LevelSet);
    // The centre is inside, in an inactive tile or leaf; the corner is outside.
    assert_eq!(value(&surface, [6, 8, 10]), -1.5);
    assert_eq!(value(&surface, surface.header.first_index), 1.5);
    let fog = open(&fixtures.join("fog_bloscmask.vdb"), &OpenOptions::default()).unwrap();
    assert_eq!(fog.header.content, Content::Fog);
    assert_eq!(value(&fog, [6, 8, 10]), 1.0);

    let region = |region| OpenOptions {
        region: Some(region),
        ..OpenOptions::default()
    };
    let tile = open(
        &fixtures.join("inactive_tile.vdb"),
        &region([-10..600, -10..200, -10..200]),
    )
    .unwrap();
    assert_eq!(value(&tile, [0, 0, 0]), 5.0);
    assert_eq!(value(&tile, [127, 127, 127]), 5.0);
    assert_eq!(value(&tile, [128, 0, 0]), 0.0);
    assert_eq!(value(&tile, [500, 0, 0]), 2.0);

    let root = open(&fixtures.join("root_tile.vdb"), &OpenOptions::default()).unwrap();
    assert_eq!(value(&root, [4095, 4095, 4095]), 5.0);
    assert_eq!(value(&root, [4096, 0, 0]), 0.0);
    assert_eq!(value(&root, [5000, 0, 0]), 2.0);
    let Voxels::Random(voxels) = &root.voxels else {
        panic!("boxes expected");
    };
    let one = |origin, size| {
        let value = voxels.uniform(&Region { origin, size })?;
        Some(f32::from_le_bytes([value[0], value[1], value[2], value[3]]))
    };
    assert_eq!(one([1; 3], [4096; 3]), Some(5.0));
    assert_eq!(one([0, 0, 0], [5003, 4098, 1]), Some(0.0));
    assert_eq!(one([0; 3], [4096; 3]), None);
    assert_eq!(one([4097, 1, 1], [800, 4096, 4096]), Some(0.0));
}

#[test]
fn halves_differ_from_floats_by_their_precision_alone() {
    let Some(data) = shared_data() else { return };
    let floats = |name: &str| -> Vec<f32> {
        let (_, bytes, _) = read_path(&data.join("vdb-fixtures").join(name)).unwrap();
        let words = bytes.as_chunks::<4>().0;
        words.iter().map(|b| f32::from_le_bytes(*b)).collect()
    };
    let (whole, half) = (floats("ls_none.vdb"), floats("ls_half_bloscmask.vdb"));
    assert_eq!(whole.len(), half.len());
    assert!(whole != half);
    for (a, b) in whole.iter().zip(&half) {
        assert!((a - b).abs() <= a.abs() / 2048.0 + 1e-7, "{a} {b}");
    }
}

#[test]
fn spacing_origin_and_direction_follow_the_transform() {
    let Some(data) = shared_data() else { return };
    let (c, s) = (0.3_f64.cos(), 0.3_f64.sin());
    let straight = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let turned = [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]];
    for (name, spacing, zero, direction) in [
        ("tf_uniform", [0.5; 3], [0.0; 3], straight),
        ("tf_uniformtrans", [0.5; 3], [1.0, 2.0, 3.0], straight),
        ("tf_scale", [0.5, 0.5, 2.0], [0.0; 3], straight),
        ("tf_scaletrans", [0.5, 0.5, 2.0], [1.0, 2.0, 3.0], straight),
        ("tf_translate", [1.0; 3], [1.0, 2.0, 3.0], straight),
        ("tf_affine", [0.5; 3], [0.0; 3], turned),
    ] {
        let path = data.join(format!("vdb-fixtures/{name}.vdb"));
        let header = open(&path, &OpenOptions::default()).unwrap().header;
        let found = header.spacing.unwrap();
        for r in 0..3 {
            assert!((found[r] - spacing[r]).abs() < 1e-12, "{name} {found:?}");
            let mut origin = zero[r];
            for a in 0..3 {
                let wanted = direction[r][a];
                assert!(
                    (header.direction[r][a] - wanted).abs() < 1e-12,
                    "{name} {header:?}"
                );
                origin += header.direction[r][a] * spacing[a] * header.first_index[a] as f64;
            }
            assert!(
                (header.origin[r] - origin).abs() < 1e-9,
                "{name} {header:?}"
            );
        }
    }
}

fn refused(path: &Path, options: &OpenOptions) -> Error {
    open(path, options).expect_err(&path.display().to_string())
}

#[test]
fn what_is_not_read_is_refused_by_name() {
    let Some(data) = shared_data() else { return };
    for (file, kind, part) in [
        (
            "vdb-fixtures/vec3f.vdb",
            ErrorKind::Unsupported,
            "a grid of vectors (Tree_vec3s",
        ),
        (
            "vdb-fixtures/points.vdb",
            ErrorKind::Unsupported,
            "a grid of points",
        ),
        (
            "vdb-fixtures/tf_frustum.vdb",
            ErrorKind::Unsupported,
            "frustum",
        ),
        (
            "hostile/broken/trunc.vdb",
            ErrorKind::Invalid,
            "the file ends early: 100000 bytes",
        ),
        (
            "hostile/broken/magic.vdb",
            ErrorKind::Unsupported,
            "not recognised",
        ),
        (
            "hostile/broken/version_future.vdb",
            ErrorKind::Unsupported,
            "version 9999",
        ),
    ] {
        let error = refused(&data.join(file), &OpenOptions::default());
        assert_eq!(error.kind(), kind, "{error}");
        assert!(error.to_string().contains(part), "{error}");
    }
}

#[test]
fn grids_are_chosen_by_name_and_number() {
    let Some(data) = shared_data() else { return };
    let same = data.join("vdb-fixtures/samename.vdb");
    for options in [OpenOptions::default(), named("g"), named("h"), number(2)] {
        let error = refused(&same, &options);
        assert_eq!(error.kind(), ErrorKind::Unsupported);
        assert!(
            error.message().contains("g[0] (float), g[1] (float)"),
            "{error}"
        );
    }
    for (name, expected) in [("g[0]", 1.0), ("g[1]", 2.0), ("0", 1.0), ("1", 2.0)] {
        let volume = open(&same, &named(name)).unwrap();
        assert_eq!(value(&volume, [-4, 0, 0]), expected);
    }
    let instance = data.join("vdb-fixtures/instance.vdb");
    let grid = |name| open(&instance, &named(name)).unwrap();
    assert_eq!(grid("g").header.spacing, Some([0.5; 3]));
    assert_eq!(grid("h").header.spacing, Some([1.0; 3]));
    assert_eq!(
        read_all(grid("g")).unwrap().1,
        read_all(grid("h")).unwrap().1
    );
    let multi = data.join("formats/head-ct/multi.vdb");
    assert_eq!(
        open(&multi, &named("density")).unwrap().header.dims,
        [62, 65, 95]
    );
    assert!(refused(&multi, &named("vel")).message().contains("vectors"));
}

#[test]
fn the_same_volume_is_in_every_file() {
    let Some(data) = shared_data() else { return };
    let (_, reference, _) = read_path(&data.join("formats/head-ct/ref.npy")).unwrap();
    let reference: Vec<f64> = reference
        .as_chunks::<2>()
        .0
        .iter()
        .map(|b| f64::from(i16::from_le_bytes(*b)))
        .collect();
    let whole = OpenOptions {
        region: Some([0..64, 0..64, 0..93]),
        ..named("density")
    };
    for (name, off) in [
        ("none", 0.0),
        ("mask", 0.0),
        ("zip", 0.0),
        ("blosc", 0.0),
        ("half", 1.0),
        ("int32", 0.0),
        ("affine", 0.0),
        ("multi", 0.0),
    ] {
        let path = data.join(format!("formats/head-ct/{name}.vdb"));
        let (header, bytes, _) = read_all(open(&path, &whole).unwrap()).unwrap();
        assert_eq!(header.dims, [64, 64, 93]);
        let words = bytes.as_chunks::<4>().0;
        for (word, expected) in words.iter().zip(&reference) {
            let found = match name {
                "int32" => f64::from(i32::from_le_bytes(*word)),
                _ => f64::from(f32::from_le_bytes(*word)),
            };
            assert!(
                (found - expected).abs() <= off,
                "{name}: {found} {expected}"
            );
        }
    }
    let (_, mask, _) = read_path(&data.join("formats/gm-mask/ref.npy")).unwrap();
    let whole = OpenOptions {
        region: Some([0..77, 0..96, 0..80]),
        ..OpenOptions::default()
    };
    for name in ["zip", "blosc", "half"] {
        let path = data.join(format!("formats/gm-mask/levelset_{name}.vdb"));
        let (_, bytes, _) = read_all(open(&path, &whole).unwrap()).unwrap();
        let words = bytes.as_chunks::<4>().0.iter();
        let inside = words.map(|word| f32::from_le_bytes(*word) < 0.0);
        assert!(inside.eq(mask.iter().map(|m| *m != 0)), "{name}");
    }
}

#[test]
fn a_file_is_opened_in_little_memory() {
    let Some(data) = shared_data() else { return };
    let (volume, peak) =
        peak_bytes(|| open(&data.join("vdb/cube.vdb"), &OpenOptions::default()).unwrap());
    drop(volume);
    // 3.9 MB in the file, 24 MB of leaves decoded.
    assert!(peak < 1 << 20, "{peak}");
}

#[cfg(feature = "vdb-rs")]
#[test]
fn vdb_rs_agrees_where_it_is_taken() {
    let Some(data) = shared_data() else { return };
    let mut agreed = Vec::new();
    for &(file, grid, _, dims, ..) in FACTS {
        if dims.iter().product::<u64>() > 10_000_000 {
            continue;
        }
        let options = OpenOptions {
            format: Some(curvox_formats::Format::VdbRs),
            ..number(grid)
        };
        let theirs = match open(&data.join(file), &options) {
            Ok(volume) => read_all(volume).unwrap().1,
            Err(error) => {
                assert!(error.message().contains("does not read"), "{error}");
                continue;
            }
        };
        let (_, ours, _) = read_all(open(&data.join(file), &number(grid)).unwrap()).unwrap();
        assert!(ours == theirs, "{file}");
        agreed.push(file);
    }
    println!("{} files: {agreed:?}", agreed.len());
    assert!(agreed.len() >= 15, "{agreed:?}");
}
