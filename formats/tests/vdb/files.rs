use curvox_formats::{
    Content, ErrorKind, Header, OpenOptions, Region, Volume, VoxelType, Voxels, conformance, open,
};

use crate::sha256::sha256;
use crate::support::{peak_bytes, read_all, shared_data};

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
fn every_small_grid_keeps_the_rules_of_readers() {
    let Some(data) = shared_data() else { return };
    for &(file, grid, _, dims, ..) in FACTS {
        if dims.iter().product::<u64>() < 100_000 {
            conformance::check(|| open(&data.join(file), &number(grid)))
                .unwrap_or_else(|e| panic!("{file}: {e}"));
        }
    }
}
