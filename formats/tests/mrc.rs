//! MRC and CCP4 maps, and axes in any order.

use std::path::{Path, PathBuf};

use curvox_formats::{
    Error, ErrorKind, Format, Header, IoMode, OpenOptions, Unit, VoxelType, Voxels, conformance,
    open,
};
use proptest::prelude::*;

use crate::shared::check_manifest;
use crate::support::{
    Folder, gzip, noise, open_bytes, peak_bytes, read_all, read_bytes, read_path, shared_data,
};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/mrc")
        .join(name)
}

/// A header of the given mode, to be changed.
fn head(size: [i32; 3], mode: i32) -> Vec<u8> {
    let mut bytes = vec![0; 1024];
    for i in 0..3 {
        put(&mut bytes, 4 * i, size[i]);
        put(&mut bytes, 28 + 4 * i, size[i]);
        bytes[40 + 4 * i..44 + 4 * i].copy_from_slice(&(2.0 * size[i] as f32).to_le_bytes());
        bytes[52 + 4 * i..56 + 4 * i].copy_from_slice(&90_f32.to_le_bytes());
        put(&mut bytes, 64 + 4 * i, i as i32 + 1);
    }
    put(&mut bytes, 12, mode);
    put(&mut bytes, 88, 1);
    put(&mut bytes, 108, 20140);
    bytes[208..214].copy_from_slice(b"MAP DD");
    bytes
}

fn put(bytes: &mut [u8], at: usize, value: i32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}

/// The voxels of a file whose axes (fastest first) are stored in another order, x fastest.
fn in_order(axes: [usize; 3], dims: [u64; 3], voxel_bytes: usize, stored: &[u8]) -> Vec<u8> {
    let dims = dims.map(|n| n as usize);
    let mut stride = [0; 3];
    let mut step = voxel_bytes;
    for axis in axes {
        stride[axis] = step;
        step *= dims[axis];
    }
    let mut out = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let at = x * stride[0] + y * stride[1] + z * stride[2];
                out.extend_from_slice(&stored[at..at + voxel_bytes]);
            }
        }
    }
    out
}

const ORDERS: [[usize; 3]; 6] = [
    [0, 1, 2],
    [0, 2, 1],
    [1, 0, 2],
    [1, 2, 0],
    [2, 0, 1],
    [2, 1, 0],
];

/// Modes, and bytes of a voxel. Eight bytes are tested by NumPy's Fortran order.
const MODES: [(i32, usize); 3] = [(0, 1), (1, 2), (2, 4)];

fn permuted(axes: [usize; 3], dims: [u64; 3], mode: i32, voxels: &[u8]) -> Vec<u8> {
    let mut bytes = head(axes.map(|axis| dims[axis] as i32), mode);
    for (i, axis) in axes.into_iter().enumerate() {
        put(&mut bytes, 64 + 4 * i, axis as i32 + 1);
    }
    bytes.extend_from_slice(voxels);
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn axes_in_any_order_are_transposed(
        order in 0..6_usize,
        mode in 0..3_usize,
        dims in [1_u64..70, 1_u64..20, 1_u64..40],
        turn in 0..3_usize,
    ) {
        let (mode, voxel_bytes) = MODES[mode];
        let mut dims = dims;
        dims.rotate_left(turn);
        let axes = ORDERS[order];
        let stored = noise(dims.iter().product::<u64>() as usize * voxel_bytes);
        let file = permuted(axes, dims, mode, &stored);
        let expected = in_order(axes, dims, voxel_bytes, &stored);
        let folder = Folder::new();
        let path = folder.write("a.mrc", &file);
        for io in [IoMode::Map, IoMode::Read] {
            let options = OpenOptions { io, ..OpenOptions::default() };
            let again = || open(&path, &options);
            prop_assert_eq!(again().unwrap().header.dims, dims);
            prop_assert!(read_all(again().unwrap()).unwrap().1 == expected);
            conformance::check(again).map_err(TestCaseError::fail)?;
        }
        for bytes in [gzip(&file), file] {
            let (header, found, _) = read_bytes(&bytes, &OpenOptions::default()).unwrap();
            prop_assert_eq!(header.dims, dims);
            prop_assert!(found == expected);
        }
    }
}

#[test]
fn planes_that_are_whole_run_forward_and_others_are_copied() {
    let dims = [40, 30, 20];
    let stored = noise(40 * 30 * 20 * 2);
    for axes in ORDERS {
        let file = permuted(axes, dims, 1, &stored);
        let forward = |limit| {
            let options = OpenOptions {
                spool_limit_bytes: limit,
                ..OpenOptions::default()
            };
            open_bytes(&file, &options)
        };
        let whole = axes[2] == 2;
        let volume = forward(1 << 20).unwrap();
        assert_eq!(matches!(volume.voxels, Voxels::Forward(_)), whole);
        assert_eq!(forward(100).is_ok(), whole);
        // A pipe of whole planes needs one of them in memory, not all.
        if whole {
            let file = permuted(axes, [300, 300, 60], 1, &noise(300 * 300 * 60 * 2));
            let ((), peak) = peak_bytes(|| {
                let cursor = std::io::Cursor::new(file.as_slice());
                // The copy that `open_bytes` makes would count.
                let leaked: &'static [u8] = Box::leak(cursor.into_inner().to_vec().into());
                let volume = curvox_formats::open_stream(
                    Box::new(leaked),
                    "stream",
                    &OpenOptions::default(),
                )
                .unwrap();
                let mut planes = volume.into_forward();
                let mut some = Vec::new();
                while planes.read_planes(1, &mut some).unwrap() > 0 {}
            });
            assert!(peak < file.len() + (1 << 20), "{peak}");
        }
    }
}

#[test]
fn every_file_of_the_manifest_is_right() {
    let count = check_manifest(&["mrc"]);
    assert!(count.is_none_or(|count| count == 7), "{count:?}");
}

#[test]
fn broken_files_give_what_they_should() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("hostile/broken");
    let good = read_path(&folder.join("ok.mrc")).unwrap();
    assert_eq!(good.0.voxel, VoxelType::I8);
    for (name, word) in [
        ("trunc.mrc", "ends early"),
        ("mode_bad.mrc", "mode is 77"),
        ("nsymbt_huge.mrc", "NSYMBT is 1073741824"),
        ("nx_negative.mrc", "NX is -24"),
        ("mode4_complex.mrc", "complex"),
    ] {
        let path = folder.join(name);
        let (found, peak) = peak_bytes(|| read_path(&path));
        assert!(found.unwrap_err().message().contains(word), "{name}");
        assert!(peak < 1 << 20, "{name}: {peak}");
        let bytes = std::fs::read(&path).unwrap();
        assert!(read_bytes(&bytes, &OpenOptions::default()).is_err());
    }
    let (header, voxels, warnings) = read_path(&folder.join("cell_zero.mrc")).unwrap();
    assert_eq!((header.spacing, header.unit), (None, Unit::Unknown));
    assert_eq!(warnings.len(), 1);
    assert!(voxels == good.1);
    let (header, voxels, _) = read_path(&folder.join("axes_permuted.mrc")).unwrap();
    assert!(voxels == in_order([2, 1, 0], header.dims, 1, &good.1));
}

#[test]
fn real_maps_have_their_cell_and_their_place() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("real-headers/mrcfile");
    let near = |found: [f64; 3], expected: [f64; 3]| {
        (0..3).all(|a| (found[a] - expected[a]).abs() < 1e-4 * expected[a].abs().max(1.0))
    };
    let mut all = Vec::new();
    for name in ["EMD-3001.map", "EMD-3001.map.bz2", "emd_3001.map.gz"] {
        let (header, voxels, warnings) = read_path(&folder.join(name)).unwrap();
        assert_eq!(header.format, Format::Mrc);
        assert_eq!(header.unit, Unit::Angstrom);
        // The columns of this map are z, and its sections y.
        assert_eq!(header.dims, [43, 25, 73]);
        assert!(near(header.spacing.unwrap(), [0.44825, 0.3925, 0.45875]));
        assert!(near(header.origin, [-21.0 * 0.44825, -12.0 * 0.3925, 0.0]));
        // The cell is monoclinic.
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("sheared"), "{warnings:?}");
        all.push(voxels);
    }
    assert!(all.iter().all(|one| *one == all[0]));
    let (header, _, _) = read_path(&folder.join("EMD-3197.map")).unwrap();
    assert_eq!(header.dims, [20; 3]);
    assert!(near(header.spacing.unwrap(), [11.4; 3]), "{header:?}");
}

fn warnings(name: &str) -> (Header, Vec<String>) {
    let (header, _, warnings) = read_path(&fixture(name)).unwrap();
    (header, warnings)
}

#[test]
fn what_was_guessed_is_said() {
    for (name, words) in [
        ("mode1.mrc", &[][..]),
        ("mode1_big.mrc", &[]),
        ("mode0_signed.mrc", &[]),
        ("extended.mrc", &[]),
        ("imod_unsigned.mrc", &[]),
        ("axes_zxy.mrc", &[]),
        ("statistics_unsigned.mrc", &["taken as unsigned"]),
        ("images.mrc", &["a stack of images"]),
        ("no_cell.mrc", &["no voxel size"]),
        ("no_axes.mrc", &["MAPC, MAPR and MAPS are 0"]),
        ("odd_stamp.mrc", &["00 00", "little-endian"]),
        ("odd_stamp_big.mrc", &["00 00", "big-endian"]),
        ("wrong_stamp.mrc", &["11 11", "little-endian"]),
        ("no_magic.mrc", &["no magic number"]),
        ("monoclinic.mrc", &["sheared"]),
        ("trailing.mrc", &["6 bytes follow"]),
    ] {
        let (_, warnings) = warnings(name);
        let one = usize::from(!words.is_empty());
        assert_eq!(warnings.len(), one, "{name}: {warnings:?}");
        for word in words {
            assert!(warnings[0].contains(word), "{name}: {warnings:?}");
        }
    }
}

#[test]
fn the_header_says_where_the_origin_is_from() {
    for (name, words) in [
        ("mode1.mrc", "ORIGIN"),
        ("imod_origin.mrc", "ORIGIN, with the sign of IMOD"),
        ("axes_yzx.mrc", "NXSTART, NYSTART, NZSTART"),
    ] {
        let (header, _) = warnings(name);
        assert_eq!(header.details, [("origin from", words.to_string())]);
    }
}

#[test]
fn a_cell_with_a_slant_has_oblique_axes_of_unit_length() {
    let (header, _) = warnings("monoclinic.mrc");
    let beta = 104_f64.to_radians();
    assert_eq!(header.direction.map(|row| row[0]), [1.0, 0.0, 0.0]);
    let z = header.direction.map(|row| row[2]);
    assert!((z[0] - beta.cos()).abs() < 1e-12 && (z[2] - beta.sin()).abs() < 1e-12);
}

#[test]
fn the_other_volumes_of_a_stack_are_no_surprise() {
    for frame in [0, 1] {
        let options = OpenOptions {
            frame: Some(frame),
            ..OpenOptions::default()
        };
        let path = fixture("stack.mrc");
        let bytes = std::fs::read(&path).unwrap();
        for volume in [open(&path, &options), open_bytes(&bytes, &options)] {
            let (_, voxels, warnings) = read_all(volume.unwrap()).unwrap();
            assert_eq!(warnings, [""; 0]);
            assert_eq!(voxels.iter().all(|b| *b == 0), frame == 0);
        }
    }
}

fn kind(found: Result<(Header, Vec<u8>, Vec<String>), Error>) -> Option<ErrorKind> {
    found.err().map(|e| e.kind())
}

#[test]
fn without_the_magic_only_a_plausible_header_counts() {
    let voxels = noise(7 * 6 * 5 * 2);
    let file = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = head([7, 6, 5], 1);
        bytes[208..216].fill(0);
        change(&mut bytes);
        bytes.extend_from_slice(&voxels);
        bytes
    };
    let found = |bytes: &[u8]| kind(read_bytes(bytes, &OpenOptions::default()));
    assert_eq!(found(&file(&|_| {})), None);
    // The field at this offset, with this value, is in no such file.
    for (at, value) in [
        (0, 0),
        (4, -6),
        (12, 5),
        (28, 0),
        (40, -1),
        (52, -1),
        (64, 4),
        (68, 1),
        (92, -1),
        (220, 11),
    ] {
        let bytes = file(&|bytes| put(bytes, at, value));
        let unsupported = Some(ErrorKind::Unsupported);
        assert_eq!(found(&bytes), unsupported, "{value} at {at}");
    }
    // Said to be one, it is refused with its reason.
    let options = OpenOptions {
        format: Some(Format::Mrc),
        ..OpenOptions::default()
    };
    let error = read_bytes(&file(&|b| put(b, 28, 0)), &options).unwrap_err();
    assert!(error.message().contains("MAP"), "{error}");
}

#[test]
fn huge_extents_are_refused_before_they_are_believed() {
    let bytes = head([i32::MAX, i32::MAX, i32::MAX], 2);
    let (error, peak) = peak_bytes(|| read_bytes(&bytes, &OpenOptions::default()).unwrap_err());
    assert_eq!(error.kind(), ErrorKind::Invalid);
    assert!(peak < 1 << 20);
    // A pipe that claims a plane of transposed voxels gives what it has, in the memory of that.
    let mut bytes = permuted([1, 0, 2], [1 << 20, 1 << 20, 3], 2, &noise(100));
    bytes.truncate(1100);
    let (error, peak) = peak_bytes(|| read_bytes(&bytes, &OpenOptions::default()).unwrap_err());
    assert!(error.message().contains("ends early"), "{error}");
    assert!(peak < 32 << 20, "{peak}");
}
