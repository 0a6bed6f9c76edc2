//! FreeSurfer MGH.

use std::path::{Path, PathBuf};

use curvox_formats::{Format, OpenOptions, Unit, VoxelType, open};

use crate::shared::check_manifest;
use crate::support::{open_bytes, read_all, read_path, shared_data};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/mgh")
        .join(name)
}

#[test]
fn every_file_of_the_manifest_is_right() {
    let count = check_manifest(&["mgh"]);
    assert!(count.is_none_or(|count| count == 2), "{count:?}");
}

#[test]
fn a_file_of_two_frames_asks_for_one() {
    let Some(data) = shared_data() else { return };
    let path = data.join("real-headers/nibabel/test.mgz");
    let error = open(&path, &OpenOptions::default()).unwrap_err();
    assert!(error.message().contains("holds 2 volumes"), "{error}");
    let options = OpenOptions {
        frame: Some(1),
        ..OpenOptions::default()
    };
    let bytes = std::fs::read(&path).unwrap();
    for volume in [open(&path, &options), open_bytes(&bytes, &options)] {
        let (header, _, warnings) = read_all(volume.unwrap()).unwrap();
        assert_eq!((header.format, header.voxel), (Format::Mgh, VoxelType::F32));
        assert_eq!(header.dims, [3, 4, 5]);
        assert_eq!(header.spacing, Some([1.0; 3]));
        assert_eq!(header.unit, Unit::Millimetre);
        // As nibabel gives its affine, whose columns are no unit vectors here.
        let length = 14_f64.sqrt();
        let affine = [[1.0, 2.0, 3.0], [2.0, 3.0, 1.0], [3.0, 1.0, 2.0]];
        for (row, expected) in header.direction.iter().zip(affine) {
            for (found, expected) in row.iter().zip(expected) {
                assert!((found - expected / length).abs() < 1e-12, "{header:?}");
            }
        }
        assert_eq!(header.origin, [-13.0, -11.5, -11.5]);
        assert_eq!(warnings.len(), 2, "{warnings:?}");
    }
}

#[test]
fn turned_axes_have_their_directions() {
    let (header, _, _) = read_path(&fixture("turned.mgh")).unwrap();
    let expected = [[0.0, 0.6, -0.8], [0.0, 0.8, 0.6], [-1.0, 0.0, 0.0]];
    for (row, expected) in header.direction.iter().zip(expected) {
        for (found, expected) in row.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{header:?}");
        }
    }
}

#[test]
fn what_is_missing_is_said_and_what_follows_is_not() {
    for (name, word) in [
        ("i16.mgh", ""),
        ("tags.mgh", ""),
        ("bare.mgh", ""),
        ("gzip.mgz", ""),
        ("no_place.mgh", "goodRASFlag"),
        ("no_size.mgh", "voxel size"),
        ("no_directions.mgh", "no axis"),
    ] {
        let (_, _, warnings) = read_path(&fixture(name)).unwrap();
        let one = usize::from(!word.is_empty());
        assert_eq!(warnings.len(), one, "{name}: {warnings:?}");
        assert!(warnings.iter().all(|w| w.contains(word)), "{warnings:?}");
    }
}
