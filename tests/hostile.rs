//! The command on files that are broken, strange, or of other formats, and on the same volume in
//! many formats. Skips aloud where `CURVOX_TEST_DATA` is not set.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::command::{Ended, assert_not_complete, curvox, fed, finished, record, results};
use crate::reference::folder;

/// A run on a small file takes no longer, and no more memory.
const MAX_SECONDS: f64 = 20.0;
const MAX_BYTES: u64 = 300 << 20;

/// Exit codes.
const DONE: i32 = 0;
const USAGE: i32 = 2;
const BAD_INPUT: i32 = 3;

/// How a file is named on the command line.
#[derive(Clone, Copy, Debug, PartialEq)]
enum By {
    Path,
    Stdin,
}

fn run_on(path: &Path, by: By, options: &[&str], output: &Path) -> Ended {
    let mut command = curvox();
    command.arg("run");
    command.args(options).args(["--memory", "256MiB", "-o"]);
    command.arg(output).arg(match by {
        By::Path => path,
        By::Stdin => Path::new("-"),
    });
    let ended = match by {
        By::Path => finished(&mut command),
        By::Stdin => fed(&mut command, path),
    };
    assert!(ended.seconds < MAX_SECONDS, "{path:?}: {ended:?}");
    assert!(ended.peak_bytes < MAX_BYTES, "{path:?}: {ended:?}");
    ended
}

/// Runs on a file and checks the code, the message and what is left. Gives the summary, if there
/// is to be one.
fn check_by(path: &Path, by: By, expected: i32, options: &[&str]) -> Option<Value> {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    let ended = run_on(path, by, options, &output);
    assert_eq!(ended.code, Some(expected), "{path:?} by {by:?}: {ended:?}");
    let ended = ended.expect(expected);
    if expected == DONE {
        assert_eq!(record(&output)["state"], "complete");
        let summary = std::fs::read(output.join("summary.json")).unwrap();
        return Some(serde_json::from_slice(&summary).unwrap());
    }
    let name = match by {
        By::Path => path.to_str().unwrap(),
        By::Stdin => "standard input",
    };
    let message = ended.message();
    println!("{expected} {message}");
    assert!(message.starts_with(name), "{message}");
    // It says more than the name.
    assert!(message.len() > name.len() + 8, "{message}");
    assert_not_complete(&output);
    None
}

/// Does so by path and through a pipe, which must give the same. Gives the summaries.
fn check(path: &Path, expected: i32, options: &[&str]) -> Vec<Value> {
    let mut summaries = Vec::new();
    summaries.extend(check_by(path, By::Path, expected, options));
    if !path.is_dir() && !needs_another_file(path) {
        summaries.extend(check_by(path, By::Stdin, expected, options));
    }
    if let [by_path, by_stdin] = &summaries[..] {
        for key in ["exact", "radii", "rows", "spacing"] {
            assert_eq!(by_path[key], by_stdin[key], "{path:?} {key}");
        }
    }
    summaries
}

/// Header files whose voxels are elsewhere cannot come from a pipe.
fn needs_another_file(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| ["hdr", "nhdr", "mhd"].iter().any(|known| e == *known))
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// The files of hostile/broken that can be read; all others are refused.
const READABLE: &[&str] = &[
    "axes_permuted.mrc",
    "bomb.nii.gz",
    "cell_zero.mrc",
    "concat.nii.gz",
    "crlf_header.vol",
    "dims_small.vol",
    "gzip_named.nii",
    "not_gzip.nii.gz",
    "ok.mha",
    "ok.mrc",
    "ok.nii",
    "ok.npy",
    "ok.nrrd",
    "ok.tif",
    "ok_v2.vol",
    "ok_v3.vol",
    "sform_sheared.nii",
    "sform_singular.nii",
    "slope_nan.nii",
    "slope_zero.nii",
    "spacing_huge.nii",
    "spacing_inf.nii",
    "spacing_nan.nii",
    "spacing_nan.nrrd",
    "spacing_negative.mha",
    "spacing_negative.nii",
    "spacing_tiny.nii",
    "spacing_zero.nii",
    "spacing_zero.nrrd",
    "trailing.nii",
    "wrong_ext.nii",
];

/// Those that are read although something is wrong, and what the summary says of it.
const WARNED: &[(&str, &str)] = &[
    ("axes_permuted.mrc", "gives no voxel size"),
    ("bomb.nii.gz", "67108864 bytes follow"),
    ("cell_zero.mrc", "gives no voxel size"),
    ("dims_small.vol", "6912 bytes follow"),
    ("not_gzip.nii.gz", "named as compressed"),
    ("ok.mrc", "gives no voxel size"),
    ("sform_sheared.nii", "sheared"),
    ("sform_singular.nii", "the sform is no transform"),
    ("slope_nan.nii", "scl_slope is NaN"),
    ("spacing_huge.nii", "pixdim[1]"),
    ("spacing_inf.nii", "pixdim[2]"),
    ("spacing_nan.nii", "pixdim[2]"),
    ("spacing_nan.nrrd", "spacings has NaN"),
    ("spacing_negative.mha", "an axis that runs backwards"),
    ("spacing_negative.nii", "the sign carries no meaning"),
    ("spacing_tiny.nii", "pixdim[1]"),
    ("spacing_zero.nii", "pixdim[2]"),
    ("spacing_zero.nrrd", "spacings has 0e0"),
    ("trailing.nii", "777 bytes follow"),
];

/// Those whose header asks for planes that the memory of these tests does not hold.
const BEYOND_MEMORY: [&str; 1] = ["dims_huge.nii"];

#[test]
fn every_broken_file_is_read_or_refused_in_one_line() {
    let Some(data) = folder("CURVOX_TEST_DATA", "broken files") else {
        return;
    };
    let folder = data.join("hostile/broken");
    let mut counts = [0; 2];
    let mut good = None;
    let mut all = names(&folder);
    // The control first: the others are compared with it.
    all.sort_by_key(|name| name != "ok.nii");
    for name in all {
        let path = folder.join(&name);
        let readable = READABLE.contains(&name.as_str());
        let expected = if readable { DONE } else { BAD_INPUT };
        if BEYOND_MEMORY.contains(&name.as_str()) {
            check_by(&path, By::Path, BAD_INPUT, &["--threshold", "1"]);
            // A pipe has no length to contradict the header: the plan refuses what it asks for.
            let folder = tempfile::tempdir().unwrap();
            let output = folder.path().join("out");
            let ended = run_on(&path, By::Stdin, &["--threshold", "1"], &output).expect(USAGE);
            println!("{USAGE} {}", ended.message());
            assert!(ended.message().contains("--memory"));
            assert!(!output.exists());
            counts[0] += 1;
            continue;
        }
        let summaries = check(&path, expected, &["--threshold", "1"]);
        counts[usize::from(readable)] += 1;
        for (by, summary) in [By::Path, By::Stdin].into_iter().zip(summaries) {
            let said = summary["warnings"].to_string();
            println!("0 {name}: {said}");
            let warned = WARNED.iter().find(|(warned, _)| *warned == name);
            // A pipe has no name that could be wrong.
            let warned = warned.filter(|_| by == By::Path || name != "not_gzip.nii.gz");
            for (_, word) in WARNED {
                let expected = warned.is_some_and(|(_, expected)| expected == word);
                assert_eq!(said.contains(*word), expected, "{name} {by:?}: {said}");
            }
            // What can be read has the voxels of the file it was made from.
            if name.contains(".nii") && !["bomb.nii.gz", "wrong_ext.nii"].contains(&name.as_str()) {
                let surfels = summary["exact"]["surfels"].clone();
                let good = good.get_or_insert_with(|| surfels.clone());
                assert_eq!(*good, surfels, "{name}");
            }
        }
    }
    println!("{} refused, {} read", counts[0], counts[1]);
    assert_eq!(counts[1], READABLE.len());
}

#[test]
fn a_series_of_volumes_asks_which_and_takes_it() {
    let Some(data) = folder("CURVOX_TEST_DATA", "series of volumes") else {
        return;
    };
    let path = data.join("hostile/broken/dim4_5.nii");
    check(&path, BAD_INPUT, &["--threshold", "1"]);
    check(&path, DONE, &["--threshold", "1", "--frame", "3"]);
    check(&path, BAD_INPUT, &["--threshold", "1", "--frame", "4"]);
}

#[test]
fn strange_values_give_the_right_surface_and_strange_types_are_refused() {
    let Some(data) = folder("CURVOX_TEST_DATA", "strange values") else {
        return;
    };
    let folder = data.join("hostile/values");
    // More than 0: the smallest positive numbers, or 1.
    let positive = ["--threshold", "1e-45"];
    let one = ["--threshold", "1"];
    let [above, label] = [
        ["--threshold", "9223372036854775811"],
        ["--label", "-9007199254740993"],
    ];
    let mut seen = Vec::new();
    for (name, options) in [
        ("ball_f32", Some(positive)),
        ("ball_f64", Some(positive)),
        ("ball_f16", Some(positive)),
        ("ball_i8", Some(one)),
        ("ball_bool", Some(one)),
        ("ball_u64", Some(above)),
        ("ball_i64", Some(label)),
        ("denormal", Some(positive)),
        ("negzero", Some(positive)),
        ("nan_voxels", Some(positive)),
        ("inf_voxels", Some(positive)),
        ("all_nan", Some(positive)),
        ("complex64", None),
        ("rgb", None),
        ("zero_dim", None),
        ("two_d", None),
        ("struct", None),
        ("object_pickle", None),
    ] {
        let path = folder.join(format!("{name}.npy"));
        let code = if options.is_some() { DONE } else { BAD_INPUT };
        for summary in check(&path, code, &options.unwrap_or(one)) {
            let exact = &summary["exact"];
            let found = ["surfels", "inside_voxels", "nan_voxels"].map(|key| exact[key].as_u64());
            println!("{name}: {found:?} {}", summary["warnings"]);
            let nan = match name {
                "nan_voxels" => 26,
                "all_nan" => 512,
                _ => 0,
            };
            assert_eq!(found[2], Some(nan), "{name}");
            // Whoever has voxels that are no numbers is told.
            let told = summary["warnings"].to_string().contains("NaN");
            assert_eq!(told, nan > 0, "{name}");
            match name {
                "all_nan" => assert_eq!(found[..2], [Some(0), Some(0)]),
                "nan_voxels" | "inf_voxels" => {}
                _ => assert_eq!(found[..2], [Some(1896), Some(4224)], "{name}"),
            }
        }
        seen.push(format!("{name}.npy"));
    }
    seen.sort();
    assert_eq!(seen, names(&folder));
    let bool = folder.join("ball_bool.npy");
    // Truth needs no threshold; anything else does.
    assert_eq!(check(&bool, DONE, &[]).len(), 2);
    let output = tempfile::tempdir().unwrap();
    let output = output.path().join("out");
    let ended = run_on(&folder.join("ball_i8.npy"), By::Path, &[], &output).expect(USAGE);
    assert!(ended.stderr.contains("--threshold"));
}

/// The files of real-headers that can be read as they are.
const REAL: &[&str] = &[
    "dgtal/cat10.h5",
    "dgtal/cat10.vol",
    "dgtal/cat10b.vol",
    "dgtal/lobsterCroped.vol",
    "dgtal/lobsterCroped16b.mhd",
    "dgtal/lobsterCroped2.nii.gz",
    "dgtal/lobsterCropedB16b.mhd",
    "dgtal/test.longvol",
    "mrcfile/EMD-3001.map",
    "mrcfile/EMD-3001.map.bz2",
    "mrcfile/EMD-3197.map",
    "mrcfile/emd_3001.map.gz",
    "nibabel/anatomical.nii",
    "nibabel/minc2-no-att.mnc",
    "nibabel/minc2_1_scale.mnc",
    "nibabel/minc2_baddim.mnc",
    "nibabel/reoriented_anat_moved.nii",
    "nibabel/resampled_anat_moved.nii",
    "nibabel/small.mnc",
    "nibabel/standard.nii.gz",
    "pydicom/eCT_Supplemental.dcm",
    "pydicom/emri_small.dcm",
    "pydicom/emri_small_RLE.dcm",
    "pydicom/emri_small_big_endian.dcm",
    "pydicom/emri_small_jpeg_2k_lossless.dcm",
    "pydicom/emri_small_jpeg_ls_lossless.dcm",
    "pydicom/liver.dcm",
    "pydicom/liver_expb.dcm",
    "pydicom/rtdose.dcm",
    "pydicom/rtdose_rle.dcm",
    "pynrrd/BallBinary30x30x30.nhdr",
    "pynrrd/BallBinary30x30x30.nii.gz",
    "pynrrd/BallBinary30x30x30.nrrd",
    "pynrrd/BallBinary30x30x30_byteskip_minus_one.nhdr",
    "pynrrd/BallBinary30x30x30_byteskip_minus_one_nifti.nhdr",
    "pynrrd/BallBinary30x30x30_bz2.nrrd",
    "pynrrd/BallBinary30x30x30_gz.nrrd",
    "pynrrd/BallBinary30x30x30_gz_byteskip_minus_one.nrrd",
    "pynrrd/BallBinary30x30x30_gz_lineskip.nrrd",
    "pynrrd/BallBinary30x30x30_nifti.nhdr",
    "pynrrd/test_simple4d_raw.nrrd",
];

#[test]
fn every_real_file_is_read_or_refused_in_one_line() {
    let Some(data) = folder("CURVOX_TEST_DATA", "real headers") else {
        return;
    };
    let folder = data.join("real-headers");
    let mut counts = [0; 2];
    for set in names(&folder) {
        for name in names(&folder.join(&set)) {
            let name = format!("{set}/{name}");
            let readable = REAL.contains(&name.as_str());
            let expected = if readable { DONE } else { BAD_INPUT };
            // A small ball, for this is about reading, and some have voxels ten times as long as wide.
            let options = ["--threshold", "1", "--radius", "2vx"];
            check(&folder.join(&name), expected, &options);
            counts[usize::from(readable)] += 1;
        }
    }
    println!("{} refused, {} read", counts[0], counts[1]);
}

#[test]
fn formats_that_are_not_read_are_refused_by_name() {
    let Some(data) = folder("CURVOX_TEST_DATA", "formats that are not read") else {
        return;
    };
    let output = tempfile::tempdir().unwrap();
    let output = output.path().join("out");
    for (path, name) in [
        ("real-headers/dgtal/cat10.pgm3d", "PGM3D"),
        ("real-headers/dgtal/ascii_ball.pgm3d", "PGM3D"),
        ("real-headers/nibabel/tiny.mnc", "NetCDF"),
        ("real-headers/nibabel/tinypet.v", "ECAT"),
        ("real-headers/nibabel/row_major.dconn.nii", "CIFTI"),
        ("real-headers/nibabel/scaled+tlrc.HEAD", "not recognised"),
        ("real-headers/pydicom/rtplan.dcm", "no pixels"),
        ("vdb-fixtures/vec3f.vdb", "vec3"),
        ("vdb-fixtures/points.vdb", "point"),
        ("hostile/broken/empty_folder", "folder"),
    ] {
        let path = data.join(path);
        let ended = run_on(&path, By::Path, &["--threshold", "1"], &output).expect(BAD_INPUT);
        let message = ended.message();
        println!("{message}");
        let said = message.strip_prefix(path.to_str().unwrap());
        assert!(said.is_some_and(|said| said.contains(name)), "{message}");
        assert!(!output.exists());
    }
}

/// Options for a file of the manifest.
fn options_of(entry: &Value) -> Vec<String> {
    if entry["format"] != "raw" {
        return Vec::new();
    }
    let dims = entry["dims_xyz"].as_array().unwrap();
    let dims: Vec<String> = dims.iter().map(ToString::to_string).collect();
    let dtype = match entry["dtype"].as_str().unwrap() {
        "i2" => "i16le",
        "u1" => "u8",
        other => panic!("unknown type {other}"),
    };
    vec![
        format!("--dims={}", dims.join(",")),
        format!("--dtype={dtype}"),
    ]
}

/// OpenVDB files of the same volumes, which no manifest lists: the file, its region in place of
/// the box of what is active, and what is inside.
const SPARSE: [(&str, &[&str]); 14] = [
    ("head-ct/none.vdb", &["--threshold=1150"]),
    ("head-ct/mask.vdb", &["--threshold=1150"]),
    ("head-ct/zip.vdb", &["--threshold=1150"]),
    ("head-ct/blosc.vdb", &["--threshold=1150"]),
    ("head-ct/int32.vdb", &["--threshold=1150"]),
    ("head-ct/affine.vdb", &["--threshold=1150"]),
    (
        "head-ct/multi.vdb",
        &["--threshold=1150", "--dataset=density"],
    ),
    ("gm-mask/fog_zip.vdb", &["--threshold=0.5"]),
    ("gm-mask/fog_blosc.vdb", &["--threshold=0.5"]),
    ("gm-mask/bool_zip.vdb", &[]),
    ("gm-mask/bool_blosc.vdb", &[]),
    ("gm-mask/levelset_zip.vdb", &[]),
    ("gm-mask/levelset_blosc.vdb", &[]),
    ("gm-mask/levelset_half.vdb", &[]),
];

/// The columns that do not depend on where the image lies in the world.
fn without_place(csv: &[u8]) -> Vec<Vec<&[u8]>> {
    const PLACES: [&[u8]; 6] = [b"x", b"y", b"z", b"nx", b"ny", b"nz"];
    let mut lines = csv.split(|&b| b == b'\n');
    let columns: Vec<&[u8]> = lines.next().unwrap().split(|&b| b == b',').collect();
    assert!(columns.contains(&&b"mean_curvature"[..]));
    lines
        .map(|line| {
            let values = line.split(|&b| b == b',').zip(&columns);
            values
                .filter(|(_, column)| !PLACES.contains(*column))
                .map(|(value, _)| value)
                .collect()
        })
        .collect()
}

#[test]
fn the_same_volume_in_other_formats_gives_the_same_rows() {
    let Some(data) = folder("CURVOX_TEST_DATA", "one volume in many formats") else {
        return;
    };
    let formats = data.join("formats");
    let manifest = std::fs::read(formats.join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    let manifest = manifest.as_array().unwrap();
    for (set, threshold, spacing, region, least) in [
        (
            "head-ct",
            "--threshold=1150",
            "3.2,3.2,1.5mm",
            "0:64,0:64,0:93",
            60,
        ),
        ("gm-mask", "--threshold=128", "2mm", "0:77,0:96,0:80", 50),
    ] {
        let reference = format!("{set}/ref.npy");
        let entry = manifest.iter().find(|e| e["path"] == reference).unwrap();
        let voxels = &entry["canonical_sha256"];
        let same = manifest.iter().filter(|e| {
            let path = e["path"].as_str().unwrap();
            path.starts_with(set) && e["canonical_sha256"] == *voxels
        });
        let mut files: Vec<(String, Vec<String>)> = same
            .map(|entry| {
                let mut options = options_of(entry);
                options.push(threshold.to_owned());
                (entry["path"].as_str().unwrap().to_owned(), options)
            })
            .collect();
        for (path, options) in SPARSE.iter().filter(|(path, _)| path.starts_with(set)) {
            let mut options: Vec<String> = options.iter().map(ToString::to_string).collect();
            options.push(format!("--region={region}"));
            files.push((path.to_string(), options));
        }
        // Files by where they place the image in the world, for rows hold world coordinates, and
        // by what is inside, which is in the metadata.
        let mut places: Vec<(Value, Value, String)> = Vec::new();
        let mut table: Option<Vec<u8>> = None;
        for (path, options) in &files {
            let path = formats.join(path.trim_end_matches('/'));
            let folder = tempfile::tempdir().unwrap();
            let output = folder.path().join("out");
            let mut arguments = vec!["--spacing", spacing, "--radius", "3vx"];
            arguments.extend(options.iter().map(String::as_str));
            run_on(&path, By::Path, &arguments, &output).expect(DONE);
            let summary = std::fs::read(output.join("summary.json")).unwrap();
            let summary: Value = serde_json::from_slice(&summary).unwrap();
            let inside = &summary["parameters"];
            let place = serde_json::json!([summary["origin"], summary["direction"], inside]);
            let parts = record(&output)["parts"].clone();
            if let Some((_, expected, first)) = places.iter().find(|(p, ..)| *p == place) {
                assert_eq!(*expected, parts, "{path:?} and {first}");
                continue;
            }
            println!("{set}: {path:?} is placed at {place}");
            places.push((place, parts, path.display().to_string()));
            // The same image elsewhere: everything but the place.
            let mut command = curvox();
            command.arg("run").arg(&path).args(&arguments);
            let csv = finished(command.args(["-q", "-o", "-"]))
                .expect(DONE)
                .stdout;
            match &table {
                None => table = Some(csv),
                Some(table) => {
                    assert!(without_place(table) == without_place(&csv), "{path:?}");
                }
            }
        }
        println!("{set}: {} files, {} places", files.len(), places.len());
        assert!(files.len() >= least && places.len() < files.len());
    }
}

/// Ways to run that must not show in the results.
fn ways(path: &Path, least_memory: &str) -> Vec<(String, Command)> {
    let of = |name: &str, options: &[&str], by: By| {
        let mut command = curvox();
        command.arg("run").args(options);
        match by {
            By::Path => command.arg(path),
            By::Stdin => command.arg("-").stdin(std::fs::File::open(path).unwrap()),
        };
        (name.to_owned(), command)
    };
    let mut ways = vec![
        of("plain", &[], By::Path),
        of("map", &["--io", "map"], By::Path),
        of("read", &["--io", "read"], By::Path),
        of("pipe", &[], By::Stdin),
    ];
    for (option, values) in [
        ("--brick", &["16", "32", "64", "100"][..]),
        ("--memory", &[least_memory, "256MiB", "1GiB"]),
        ("--threads", &["1", "2", "7"]),
    ] {
        for value in values {
            ways.push(of(&format!("{option} {value}"), &[option, value], By::Path));
        }
    }
    ways
}

#[test]
fn how_a_run_is_done_does_not_show() {
    let Some(data) = folder("CURVOX_TEST_DATA", "the same bytes whatever the way") else {
        return;
    };
    for (path, threshold, least_memory, options) in [
        (
            "formats/head-ct/plain.nii",
            "500",
            "128MiB",
            &["--directions", "--radius", "3vx"][..],
        ),
        (
            "formats/head-ct/plain.nii",
            "1150",
            // Two radii and measures cell by cell need more.
            "160MiB",
            &[
                "--radius", "2vx,4vx", "--method", "paper", "--slices", "x=30..34",
            ],
        ),
        ("volumes/lobster.vol", "40", "128MiB", &["--radius", "3vx"]),
    ] {
        let path: PathBuf = data.join(path);
        let mut expected = None;
        for (name, mut command) in ways(&path, least_memory) {
            let folder = tempfile::tempdir().unwrap();
            let output = folder.path().join("out");
            command.args(["--threshold", threshold, "-o"]);
            command.arg(&output).args(options);
            let ended = crate::command::Running::start(&mut command).end();
            println!(
                "{path:?} {name}: {:.1} s, {} MiB",
                ended.seconds,
                ended.peak_bytes >> 20
            );
            ended.expect(DONE);
            let found = results(&output);
            assert!(!found.1.is_empty(), "{name}");
            let (parts, others) = expected.get_or_insert_with(|| found.clone());
            assert_eq!(*parts, found.0, "{name}");
            for (a, b) in others.iter().zip(&found.1) {
                assert!(a == b, "{name}: {:?} differs from {:?}", a.0, b.0);
            }
            assert_eq!(others.len(), found.1.len());
        }
    }
}
