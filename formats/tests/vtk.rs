//! Legacy VTK.

use std::path::{Path, PathBuf};

use curvox_formats::{ErrorKind, OpenOptions, Unit, open};

use crate::shared::check_manifest;
use crate::support::{Folder, peak_bytes, read_bytes, read_path};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/vtk")
        .join(name)
}

#[test]
fn every_file_of_the_manifest_is_right() {
    let count = check_manifest(&["vtk"]);
    assert!(count.is_none_or(|count| count == 2), "{count:?}");
}

#[test]
fn what_follows_the_array_is_no_surprise() {
    for (name, word) in [
        ("short.vtk", ""),
        ("metadata.vtk", ""),
        ("several.vtk", ""),
        ("several_ascii.vtk", ""),
        ("cells.vtk", ""),
        ("gzip.vtk.gz", ""),
        ("bit.vtk", ""),
        ("negative.vtk", "backwards"),
        ("zero_spacing.vtk", "no voxel size"),
        ("long4.vtk", "4 bytes"),
    ] {
        let (header, _, warnings) = read_path(&fixture(name)).unwrap();
        let one = usize::from(!word.is_empty());
        assert_eq!(warnings.len(), one, "{name}: {warnings:?}");
        assert!(warnings.iter().all(|w| w.contains(word)), "{warnings:?}");
        assert_eq!(header.unit, Unit::Unknown);
    }
}

#[test]
fn the_chosen_array_is_named() {
    for (dataset, details) in [
        (None, vec![("array", "the ramp")]),
        (Some("mask"), vec![("array", "mask")]),
    ] {
        let options = OpenOptions {
            dataset: dataset.map(str::to_string),
            ..OpenOptions::default()
        };
        let header = open(&fixture("several.vtk"), &options).unwrap().header;
        let found: Vec<_> = header.details.iter().map(|(k, v)| (*k, &v[..])).collect();
        assert_eq!(found, details);
    }
    let header = open(&fixture("cells.vtk"), &OpenOptions::default())
        .unwrap()
        .header;
    assert!(header.details.contains(&("values of", "cells".into())));
}

#[test]
fn an_axis_with_a_negative_spacing_points_backwards() {
    let (header, _, _) = read_path(&fixture("negative.vtk")).unwrap();
    assert_eq!(header.spacing, Some([0.5, 0.75, 1.25]));
    assert_eq!(header.direction[0], [-1.0, 0.0, 0.0]);
    assert_eq!(header.origin, [10.0, -20.0, 30.0]);
}

/// A header of structured points with the given lines.
fn file(lines: &str) -> Vec<u8> {
    format!("# vtk DataFile Version 3.0\nt\nBINARY\nDATASET STRUCTURED_POINTS\n{lines}")
        .into_bytes()
}

#[test]
fn endless_text_is_refused_in_little_memory() {
    let long = "x".repeat(1 << 20);
    for lines in [
        long.clone(),
        format!("DIMENSIONS 1 1 {long}"),
        format!("DIMENSIONS 2 2 2\nPOINT_DATA 8\nFIELD f 18446744073709551615\n{long} 1 1 int\n"),
        "DIMENSIONS 2 2 2\nPOINT_DATA 8\nFIELD f 2\na 1 18446744073709551615 string\n".into(),
        "DIMENSIONS 2 2 2\nPOINT_DATA 8\nFIELD f 2\na 9 18446744073709551615 double\n".into(),
        "DIMENSIONS 2 2 2\nPOINT_DATA 8\nFIELD f 2\na 1 2305843009213693951 double\n".into(),
        "DIMENSIONS 4294967296 4294967296 2\nPOINT_DATA 0\n".into(),
        "EXTENT -9223372036854775808 9223372036854775807 0 0 0 0\n".into(),
    ] {
        let bytes = file(&lines);
        let (error, peak) = peak_bytes(|| read_bytes(&bytes, &OpenOptions::default()).unwrap_err());
        assert_eq!(error.kind(), ErrorKind::Invalid, "{error}");
        assert!(
            error.to_string().len() < 6000,
            "{}",
            error.to_string().len()
        );
        // The stream itself is a copy of the bytes.
        assert!(peak < bytes.len() + (1 << 20), "{peak}");
    }
}

#[test]
fn huge_extents_are_refused_before_they_are_believed() {
    let lines = "DIMENSIONS 1000000 1000000 1000\nPOINT_DATA 1000000000000000\nSCALARS a int\n";
    let folder = Folder::new();
    let path = folder.write("huge.vtk", &file(lines));
    let (error, peak) = peak_bytes(|| read_path(&path).unwrap_err());
    assert!(error.message().contains("ends early"), "{error}");
    assert!(peak < 1 << 20);
}

#[test]
fn an_extent_moves_the_first_voxel_with_and_without_a_spacing() {
    for (spacing, step) in [("SPACING 2 3 4\n", [2.0, 3.0, 4.0]), ("", [1.0; 3])] {
        for (data, count, half) in [("POINT_DATA", 24, 0.0), ("CELL_DATA", 6, 0.5)] {
            let lines = format!(
                "EXTENT 5 6 -1 1 10 13\nORIGIN 100 200 300\n{spacing}{data} {count}\nSCALARS a \
                 unsigned_char\nLOOKUP_TABLE default\n"
            );
            let mut bytes = file(&lines);
            bytes.extend(vec![7; count]);
            let (header, voxels, _) = read_bytes(&bytes, &OpenOptions::default()).unwrap();
            assert_eq!(voxels.len(), count);
            assert_eq!(header.first_index, [5, -1, 10]);
            let expected = [
                100.0 + step[0] * (5.0 + half),
                200.0 + step[1] * (-1.0 + half),
                300.0 + step[2] * (10.0 + half),
            ];
            assert_eq!(header.origin, expected, "{lines}");
        }
    }
}
