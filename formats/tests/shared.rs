//! The shared folder: same volumes in many formats, broken files, real files.

use std::path::Path;

use curvox_formats::{
    ByteOrder, DType, ErrorKind, Format, Header, IoMode, OpenOptions, Unit, VoxelType, open,
};
use serde_json::Value;

use crate::sha256::sha256;
use crate::support::{open_bytes, peak_bytes, raw_options, read_all, read_path, shared_data};

/// Value of each voxel, scaled. Exact for what the tests compare: integers below 2^53.
fn values(header: &Header, voxels: &[u8]) -> Vec<f64> {
    let size = header.voxel.bytes();
    let scaling = header.scaling;
    voxels
        .chunks_exact(size)
        .map(|voxel| {
            let mut bytes = [0_u8; 8];
            bytes[..size].copy_from_slice(voxel);
            if header.byte_order == ByteOrder::Big {
                bytes[..size].reverse();
            }
            let [a, b, c, d, ..] = bytes;
            let stored = match header.voxel {
                VoxelType::Bool | VoxelType::U8 => f64::from(a),
                VoxelType::I8 => f64::from(a as i8),
                VoxelType::U16 => f64::from(u16::from_le_bytes([a, b])),
                VoxelType::I16 => f64::from(i16::from_le_bytes([a, b])),
                VoxelType::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
                VoxelType::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
                VoxelType::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
                VoxelType::F64 => f64::from_le_bytes(bytes),
                VoxelType::U64 => u64::from_le_bytes(bytes) as f64,
                VoxelType::I64 => i64::from_le_bytes(bytes) as f64,
                VoxelType::F16 => half(u16::from_le_bytes([a, b])),
            };
            scaling.map_or(stored, |s| s.slope * stored + s.intercept)
        })
        .collect()
}

/// A half precision number.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    sign * match exponent {
        0 => fraction * 2_f64.powi(-24),
        31 => f64::INFINITY,
        _ => (1.0 + fraction / 1024.0) * 2_f64.powi(exponent - 15),
    }
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn triple(value: &Value) -> Option<[f64; 3]> {
    let array = value.as_array()?;
    Some([array[0].as_f64()?, array[1].as_f64()?, array[2].as_f64()?])
}

#[test]
fn every_file_of_the_manifest_gives_the_canonical_voxels_and_spacing() {
    let count = check_manifest(&["npy", "raw", "vol", "nifti"]);
    assert!(count.is_none_or(|count| count == 30), "{count:?}");
}

/// Checks the files of the manifest that are of one of the formats: mapped, read, and from a
/// pipe. Gives their number; `None` where the folder is not there.
pub fn check_manifest(formats: &[&str]) -> Option<usize> {
    let data = shared_data()?;
    let manifest = json(&data.join("formats/manifest.json"));
    let mut count = 0;
    for entry in manifest.as_array().unwrap() {
        let text = |key: &str| entry[key].as_str().unwrap();
        if !formats.contains(&text("format")) {
            continue;
        }
        let path = data.join("formats").join(text("path"));
        let dims = triple(&entry["dims_xyz"]).unwrap().map(|n| n as u64);
        let stored = match text("dtype") {
            "i2" => VoxelType::I16,
            "u1" => VoxelType::U8,
            other => panic!("unknown type {other}"),
        };
        let options = match text("format") {
            "raw" => raw_options(dims, DType::little(stored)),
            _ => OpenOptions::default(),
        };
        let mut results = Vec::new();
        for io in [IoMode::Map, IoMode::Read] {
            let options = OpenOptions {
                io,
                ..options.clone()
            };
            results.push(read_all(open(&path, &options).unwrap()).unwrap());
        }
        if path.is_file() && path.extension().is_none_or(|e| e != "hdr") {
            let bytes = std::fs::read(&path).unwrap();
            results.push(read_all(open_bytes(&bytes, &options).unwrap()).unwrap());
        }
        for (header, voxels, _) in results {
            assert_eq!(header.dims, dims, "{path:?}");
            assert_eq!(
                header.spacing,
                triple(&entry["spacing_in_file"]),
                "{path:?}"
            );
            let canonical: Vec<u8> = values(&header, &voxels)
                .into_iter()
                .flat_map(|v| match stored {
                    VoxelType::U8 => vec![v as u8],
                    _ => (v as i16).to_le_bytes().to_vec(),
                })
                .collect();
            assert_eq!(sha256(&canonical), text("canonical_sha256"), "{path:?}");
        }
        count += 1;
    }
    Some(count)
}

/// What a broken file must give.
#[derive(Clone, Copy)]
enum Expect {
    /// Read without a warning.
    Fine,
    /// Read, with a warning that has this word.
    Warns(&'static str),
    /// Not read, with an error that has this word.
    Fails(ErrorKind, &'static str),
}

use Expect::{Fails, Fine, Warns};

const INVALID: ErrorKind = ErrorKind::Invalid;
const UNSUPPORTED: ErrorKind = ErrorKind::Unsupported;

/// hostile/broken, as its README says.
const BROKEN: &[(&str, Expect)] = &[
    ("ok.nii", Fine),
    (
        "trunc_header.nii",
        Fails(INVALID, "200 bytes found, 348 expected"),
    ),
    ("trunc_data.nii", Fails(INVALID, "ends early")),
    ("empty.nii", Fails(INVALID, "empty")),
    ("trailing.nii", Warns("777 bytes follow")),
    ("dims_lie.nii", Fails(INVALID, "ends early")),
    ("dims_huge.nii", Fails(INVALID, "ends early")),
    ("dims_negative.nii", Fails(INVALID, "dim[2] is -24")),
    ("dims_zero.nii", Fails(INVALID, "dim[2] is 0")),
    ("ndim9.nii", Fails(INVALID, "dim[0] is 9")),
    ("ndim0.nii", Fails(INVALID, "dim[0] is 0")),
    ("dim4_5.nii", Fails(UNSUPPORTED, "--frame N, 0 to 3")),
    ("spacing_zero.nii", Warns("pixdim[2]")),
    ("spacing_negative.nii", Warns("sign")),
    ("spacing_nan.nii", Warns("pixdim[2]")),
    ("spacing_inf.nii", Warns("pixdim[2]")),
    ("spacing_tiny.nii", Warns("pixdim[1]")),
    ("spacing_huge.nii", Warns("pixdim[1]")),
    ("sform_singular.nii", Warns("sform")),
    ("sform_sheared.nii", Warns("sheared")),
    ("datatype_bad.nii", Fails(INVALID, "datatype is 1234")),
    ("bitpix_mismatch.nii", Fails(INVALID, "bitpix is 8")),
    ("voxoffset_beyond.nii", Fails(INVALID, "ends early")),
    ("voxoffset_nan.nii", Fails(INVALID, "vox_offset is NaN")),
    ("slope_nan.nii", Warns("scl_slope is NaN")),
    ("slope_zero.nii", Fine),
    ("rgb24.nii", Fails(UNSUPPORTED, "colour")),
    ("magic_bad.nii", Fails(INVALID, "xx1")),
    ("trunc.nii.gz", Fails(INVALID, "ends early")),
    ("crc_bad.nii.gz", Fails(INVALID, "damaged")),
    ("not_gzip.nii.gz", Warns("named as compressed")),
    ("gzip_named.nii", Fine),
    ("concat.nii.gz", Fine),
    ("bomb.nii.gz", Warns("67108864 bytes follow the voxels")),
    ("ok_v3.vol", Fine),
    ("ok_v2.vol", Fine),
    ("dims_lie.vol", Fails(INVALID, "ends early")),
    ("dims_small.vol", Warns("6912 bytes follow")),
    ("trunc_v3.vol", Fails(INVALID, "ends early")),
    ("trunc_v2.vol", Fails(INVALID, "ends early")),
    ("no_dot.vol", Fails(INVALID, "'.'")),
    ("version9.vol", Fails(UNSUPPORTED, "Version is 9")),
    ("no_x.vol", Fails(INVALID, "no X")),
    ("neg_x.vol", Fails(INVALID, "'-24'")),
    ("crlf_header.vol", Fine),
    ("huge.vol", Fails(INVALID, "1152000000000")),
    ("ok.npy", Fine),
    ("trunc.npy", Fails(INVALID, "ends early")),
    ("shape_lie.npy", Fails(INVALID, "ends early")),
    ("header_code.npy", Fails(INVALID, "literal")),
    ("magic.npy", Fails(UNSUPPORTED, "not recognised")),
    ("plain.txt", Fails(UNSUPPORTED, "not recognised")),
    ("empty_folder", Fails(UNSUPPORTED, "folder")),
    ("ok.nrrd", Fine),
    ("ok.mha", Fine),
    ("ok.mrc", Warns("no voxel size")),
    ("no_such_file", Fails(ErrorKind::Io, "cannot be opened")),
];

#[test]
fn every_broken_file_gives_what_it_should_in_bounded_memory() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("hostile/broken");
    let good = read_path(&folder.join("ok.nii")).unwrap().1;
    for &(name, expect) in BROKEN {
        let path = folder.join(name);
        let (found, peak) = peak_bytes(|| read_path(&path));
        assert!(peak < 10 << 20, "{name}: {peak} bytes were held");
        match (found, expect) {
            (Ok((_, voxels, warnings)), Fine) => {
                assert_eq!(warnings, [""; 0], "{name}");
                if name.contains(".nii") {
                    assert!(voxels == good, "{name}");
                }
            }
            (Ok((_, voxels, warnings)), Warns(word)) => {
                assert_eq!(warnings.len(), 1, "{name}: {warnings:?}");
                assert!(warnings[0].contains(word), "{name}: {warnings:?}");
                if name.contains(".nii") {
                    assert!(voxels == good, "{name}");
                }
            }
            (Err(error), Fails(kind, word)) => {
                assert_eq!(error.kind(), kind, "{error}");
                assert!(error.message().contains(word), "{error}");
                assert!(error.to_string().contains(name) && !error.to_string().contains('\n'));
            }
            (found, _) => panic!("{name}: {:?}", found.map(|(header, _, w)| (header, w))),
        }
        // From a pipe: the same voxels, or an error as well.
        if let Ok(bytes) = std::fs::read(&path) {
            let piped = open_bytes(&bytes, &OpenOptions::default()).and_then(read_all);
            let direct = read_path(&path);
            assert_eq!(piped.is_ok(), direct.is_ok(), "{name}");
            if let (Ok(piped), Ok(direct)) = (piped, direct) {
                assert!(piped.1 == direct.1);
                assert_eq!(piped.0.spacing, direct.0.spacing);
            }
        }
    }
}

#[test]
fn the_choice_of_a_time_point_is_obeyed() {
    let Some(data) = shared_data() else { return };
    let path = data.join("hostile/broken/dim4_5.nii");
    let good = read_path(&data.join("hostile/broken/ok.nii")).unwrap().1;
    let mut all = Vec::new();
    for frame in 0..4 {
        let options = OpenOptions {
            frame: Some(frame),
            ..OpenOptions::default()
        };
        let (header, voxels, _) = read_all(open(&path, &options).unwrap()).unwrap();
        assert_eq!(header.dims, [24, 24, 6]);
        all.extend(voxels);
    }
    assert!(all == good);
}

#[test]
fn awkward_shapes_have_the_voxels_they_should() {
    let Some(data) = shared_data() else { return };
    let expected = json(&data.join("hostile/expected.json"));
    for (name, facts) in expected["topology"].as_object().unwrap() {
        let (header, voxels, warnings) =
            read_path(&data.join("hostile/topology").join(name)).unwrap();
        let facts = if facts["dims"].is_null() {
            &facts["per_label"]["1"]
        } else {
            facts
        };
        assert_eq!(
            Some(header.dims.map(|n| n as f64)),
            triple(&facts["dims"]),
            "{name}"
        );
        assert_eq!(warnings, [""; 0]);
        let labels = name.starts_with("labels");
        let inside = voxels
            .iter()
            .filter(|v| if labels { **v == 1 } else { **v > 0 })
            .count();
        assert_eq!(facts["voxels"].as_u64(), Some(inside as u64), "{name}");
    }
}

#[test]
fn strange_values_are_read_and_strange_types_refused() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("hostile/values");
    let inside = 4224;
    for name in [
        "ball_f32",
        "ball_f64",
        "ball_f16",
        "ball_i8",
        "ball_bool",
        "denormal",
        "negzero",
    ] {
        let (header, voxels, _) = read_path(&folder.join(format!("{name}.npy"))).unwrap();
        let count = values(&header, &voxels)
            .into_iter()
            .filter(|v| *v > 0.0)
            .count();
        assert_eq!(count, inside, "{name}");
    }
    let (_, voxels, _) = read_path(&folder.join("ball_u64.npy")).unwrap();
    let above = voxels
        .chunks_exact(8)
        .filter(|v| u64::from_le_bytes((*v).try_into().unwrap()) >= (1 << 63) + 3);
    assert_eq!(above.count(), inside);
    let (_, voxels, _) = read_path(&folder.join("ball_i64.npy")).unwrap();
    let above = voxels
        .chunks_exact(8)
        .filter(|v| i64::from_le_bytes((*v).try_into().unwrap()) == -(1 << 53) - 1);
    assert_eq!(above.count(), inside);
    for name in ["nan_voxels", "inf_voxels", "all_nan"] {
        read_path(&folder.join(format!("{name}.npy"))).unwrap();
    }
    for (name, word) in [
        ("complex64", "complex"),
        ("rgb", "colour"),
        ("zero_dim", "size 0"),
        ("two_d", "2 axes"),
        ("struct", "structured"),
        ("object_pickle", "unpickled"),
    ] {
        let error = read_path(&folder.join(format!("{name}.npy"))).unwrap_err();
        assert!(error.message().contains(word), "{error}");
    }
}

#[test]
fn real_files_have_the_header_their_programs_wrote() {
    let Some(data) = shared_data() else { return };
    let little = |v| DType::little(v);
    let big = |v| DType::big(v);
    for (name, dims, dtype, spacing, unit) in [
        (
            "dgtal/cat10.vol",
            [40, 40, 40],
            little(VoxelType::U8),
            None,
            Unit::Unknown,
        ),
        (
            "dgtal/cat10b.vol",
            [44, 44, 44],
            little(VoxelType::U8),
            None,
            Unit::Unknown,
        ),
        (
            "dgtal/lobsterCroped.vol",
            [51, 91, 31],
            little(VoxelType::U8),
            None,
            Unit::Unknown,
        ),
        (
            "dgtal/test.longvol",
            [16, 16, 16],
            little(VoxelType::U64),
            None,
            Unit::Unknown,
        ),
        (
            "dgtal/lobsterCroped2.nii.gz",
            [101, 101, 41],
            little(VoxelType::U8),
            Some([1.0; 3]),
            Unit::Millimetre,
        ),
        (
            "nibabel/anatomical.nii",
            [33, 41, 25],
            big(VoxelType::I16),
            Some([2.0; 3]),
            Unit::Millimetre,
        ),
        (
            "nibabel/reoriented_anat_moved.nii",
            [21, 26, 22],
            big(VoxelType::F32),
            Some([4.0; 3]),
            Unit::Millimetre,
        ),
        (
            "nibabel/resampled_anat_moved.nii",
            [17, 21, 3],
            big(VoxelType::F32),
            Some([4.0, 4.0, 8.0]),
            Unit::Millimetre,
        ),
        (
            "nibabel/standard.nii.gz",
            [4, 5, 7],
            little(VoxelType::U8),
            Some([1.0, 3.0, 2.0]),
            Unit::Unknown,
        ),
        (
            "pynrrd/BallBinary30x30x30.nii.gz",
            [30, 30, 30],
            little(VoxelType::I16),
            Some([1.0; 3]),
            Unit::Millimetre,
        ),
    ] {
        let (header, voxels, warnings) = read_path(&data.join("real-headers").join(name)).unwrap();
        assert_eq!((header.dims, header.dtype()), (dims, dtype), "{name}");
        assert_eq!((header.spacing, header.unit), (spacing, unit), "{name}");
        assert_eq!(Some(voxels.len() as u64), header.voxels_bytes());
        // The longvol says 4 bytes a voxel and holds 8.
        assert_eq!(
            warnings.len(),
            usize::from(header.format == Format::Longvol),
            "{warnings:?}"
        );
    }

    // The ball of pynrrd is there without a header, too: the voxels must be the same.
    let ball = data.join("real-headers/pynrrd");
    let raw = std::fs::read(ball.join("BallBinary30x30x30.raw")).unwrap();
    assert!(
        read_path(&ball.join("BallBinary30x30x30.nii.gz"))
            .unwrap()
            .1
            == raw
    );

    for (name, frames, dims) in [
        ("nibabel/example4d.nii.gz", 2, [128, 96, 24]),
        ("nibabel/example_nifti2.nii.gz", 2, [32, 20, 12]),
        ("nibabel/functional.nii", 20, [17, 21, 3]),
    ] {
        let path = data.join("real-headers").join(name);
        let error = open(&path, &OpenOptions::default()).unwrap_err();
        assert!(
            error.message().contains(&format!("0 to {}", frames - 1)),
            "{error}"
        );
        let options = OpenOptions {
            frame: Some(frames - 1),
            ..OpenOptions::default()
        };
        let (header, _, _) = read_all(open(&path, &options).unwrap()).unwrap();
        assert_eq!(header.dims, dims);
        assert_eq!(header.scaling.is_some(), name.contains("functional"));
    }

    for (name, word) in [
        ("nibabel/analyze.hdr", "analyze.img"),
        ("nibabel/nifti1.hdr", "nifti1.img"),
        ("nibabel/nifti2.hdr", "nifti2.img"),
        ("nibabel/row_major.dconn.nii", "CIFTI"),
    ] {
        let error = read_path(&data.join("real-headers").join(name)).unwrap_err();
        assert!(error.message().contains(word), "{error}");
    }
}

#[test]
fn nothing_in_the_folder_makes_a_reader_panic() {
    let Some(data) = shared_data() else { return };
    let mut folders = vec![
        data.join("hostile"),
        data.join("real-headers"),
        data.join("formats"),
    ];
    let mut count = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let _ = read_path(&path);
                count += 1;
            }
        }
    }
    assert!(count > 300, "{count}");
}

#[test]
fn the_gallery_has_the_inside_voxels_its_facts_state() {
    let Some(data) = shared_data() else { return };
    // Without optimisation decompression is slow: small ones only.
    let most = if cfg!(debug_assertions) {
        1 << 20
    } else {
        1 << 28
    };
    let facts = json(&data.join("vol-gallery/facts.json"));
    let mut count = 0;
    for (name, facts) in facts.as_object().unwrap() {
        let dims = triple(&facts["dims"]).unwrap();
        let Some(sum) = facts["sha256_voxels_nonzero"].as_str() else {
            continue;
        };
        if dims.iter().product::<f64>() > f64::from(most) {
            continue;
        }
        let (header, voxels, _) = read_path(&data.join("vol-gallery").join(name)).unwrap();
        assert_eq!(header.dims.map(|n| n as f64), dims, "{name}");
        let bits: Vec<u8> = voxels
            .chunks(8)
            .map(|chunk| {
                chunk
                    .iter()
                    .enumerate()
                    .fold(0, |bits, (i, v)| bits | u8::from(*v != 0) << i)
            })
            .collect();
        assert_eq!(sha256(&bits), sum, "{name}");
        count += 1;
    }
    assert!(count > 10, "{count}");
}

#[test]
fn real_volumes_are_read_whole() {
    let Some(data) = shared_data() else { return };
    for (name, dims, spacing) in [
        ("fuel.nii.gz", [64, 33, 32], Some([1.0; 3])),
        ("stroke-t1.nii.gz", [124, 160, 140], Some([1.0; 3])),
        ("engine-ct.nii.gz", [256, 256, 128], Some([1.0; 3])),
        ("ch2bet.nii.gz", [181, 217, 181], Some([1.0; 3])),
        ("bigbrain-labels.nii.gz", [310, 374, 317], Some([0.5; 3])),
        ("lobster.vol", [301, 324, 56], None),
        ("Al.100.vol", [100, 100, 100], None),
    ] {
        if cfg!(debug_assertions) && name.starts_with("bigbrain") {
            continue;
        }
        let (header, _, warnings) = read_path(&data.join("volumes").join(name)).unwrap();
        assert_eq!((header.dims, header.spacing), (dims, spacing), "{name}");
        assert_eq!(warnings, [""; 0], "{name}");
    }
}
