//! Analyze 7.5.

use std::path::{Path, PathBuf};

use curvox_formats::{Format, OpenOptions, Scaling, Unit, open};

use crate::support::{open_bytes, read_path, shared_data};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/analyze")
        .join(name)
}

#[test]
fn sides_are_said_to_be_unknown() {
    let (header, _, warnings) = read_path(&fixture("i16.hdr")).unwrap();
    assert_eq!(header.format, Format::Analyze);
    assert_eq!(header.unit, Unit::Millimetre);
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].contains("left-right orientation is not stated by Analyze"));
}

#[test]
fn the_factor_of_spm_counts_and_its_origin_does_not() {
    let (header, _, warnings) = read_path(&fixture("spm.hdr")).unwrap();
    let half = Scaling {
        slope: 0.5,
        intercept: 0.0,
    };
    assert_eq!(header.scaling, Some(half));
    assert_eq!(header.origin, [0.0; 3]);
    assert!(warnings.iter().any(|w| w.contains("funused1 is 0.5")));
    let details = vec![("originator", "[4, 5, 6], not used as an origin".to_string())];
    assert_eq!(header.details, details);
}

#[test]
fn a_header_alone_names_what_is_missing() {
    let Some(data) = shared_data() else { return };
    let path = data.join("real-headers/nibabel/analyze.hdr");
    let error = open(&path, &OpenOptions::default()).unwrap_err();
    assert!(error.message().contains("analyze.img"), "{error}");
    let bytes = std::fs::read(path).unwrap();
    let error = open_bytes(&bytes, &OpenOptions::default()).unwrap_err();
    assert!(error.message().contains(".img"), "{error}");
}
