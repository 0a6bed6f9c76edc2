//! NumPy archives.

use std::path::{Path, PathBuf};

use curvox_formats::{ErrorKind, Format, IoMode, OpenOptions, Voxels, open};

use crate::shared::check_manifest;
use crate::support::{Folder, open_bytes, peak_bytes, read_all, read_path};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/npz")
        .join(name)
}

#[test]
fn every_file_of_the_manifest_is_right() {
    let count = check_manifest(&["npz"]);
    assert!(count.is_none_or(|count| count == 2), "{count:?}");
}

#[test]
fn stored_members_are_mapped_and_deflated_ones_run_forward() {
    for (name, mapped) in [
        ("stored.npz", true),
        ("zip64.npz", true),
        ("deflated.npz", false),
    ] {
        let volume = open(&fixture(name), &OpenOptions::default()).unwrap();
        assert_eq!(volume.source.mapped, mapped && cfg!(unix), "{name}");
        assert_eq!(volume.source.compressed, !mapped, "{name}");
        assert_eq!(matches!(volume.voxels, Voxels::Random(_)), mapped, "{name}");
        assert_eq!(volume.header.format, Format::Npz);
        let member = ("member", "volume".to_string());
        assert!(volume.header.details.contains(&member));
        let (_, _, warnings) = read_all(volume).unwrap();
        assert_eq!(warnings, [""; 0]);
    }
}

#[test]
fn a_member_that_is_cut_or_damaged_is_an_error() {
    let good = std::fs::read(fixture("deflated.npz")).unwrap();
    let folder = Folder::new();
    let path = folder.path("a.npz");
    for keep in 0..good.len() {
        assert!(open_bytes(&good[..keep], &OpenOptions::default()).is_err());
    }
    // Voxels begin after the headers of the member and of the array.
    let mut damaged = good.clone();
    damaged[300] ^= 4;
    std::fs::write(&path, &damaged).unwrap();
    for io in [IoMode::Map, IoMode::Read] {
        let options = OpenOptions {
            io,
            ..OpenOptions::default()
        };
        let found = open(&path, &options).and_then(read_all);
        assert_eq!(found.unwrap_err().kind(), ErrorKind::Invalid);
    }
}

#[test]
fn a_directory_of_impossible_size_is_refused() {
    let good = std::fs::read(fixture("stored.npz")).unwrap();
    let end = good.len() - 22;
    for (at, bytes) in [
        (10, &[0xfe, 0xff][..]),
        (12, &[0xff, 0xff, 0xff, 0x7f]),
        (16, &[0xff; 3]),
    ] {
        let mut file = good.clone();
        file[end + at..end + at + bytes.len()].copy_from_slice(bytes);
        let folder = Folder::new();
        let path = folder.write("a.npz", &file);
        let (error, peak) = peak_bytes(|| read_path(&path).unwrap_err());
        assert_eq!(error.kind(), ErrorKind::Invalid, "{error}");
        assert!(peak < 1 << 20, "{peak}");
    }
}
