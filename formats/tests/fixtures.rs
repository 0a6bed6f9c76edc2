//! The small files beside the tests: what each must give.
//!
//! Each folder of `fixtures/` has an `expected.json`, a list with an entry a file. `voxels` is
//! `ramp`, `mask`, `mask01` or the sha256 of the voxels in canonical form (little-endian, x
//! fastest); `error` is a part of the message of a file that is refused.

use std::path::{Path, PathBuf};

use curvox_formats::{
    ByteOrder, Header, OpenOptions, Volume, VoxelType, conformance, open, open_stream,
};
use serde_json::Value;

use crate::sha256::sha256;

/// One entry of an `expected.json`.
pub struct Fixture {
    pub path: PathBuf,
    pub entry: Value,
}

impl Fixture {
    pub fn options(&self) -> OpenOptions {
        let number = |key: &str| self.entry[key].as_u64();
        OpenOptions {
            dataset: self.entry["dataset"].as_str().map(str::to_owned),
            channel: number("channel"),
            frame: number("frame"),
            level: number("level").map(|n| n as u32),
            outside: self.entry["outside"].as_bool().unwrap_or(false),
            format: self.entry["format"].as_str().map(|f| f.parse().unwrap()),
            ..OpenOptions::default()
        }
    }

    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    pub fn error(&self) -> Option<&str> {
        self.entry["error"].as_str()
    }

    /// Whether this build reads it: some need a feature.
    pub fn is_read_here(&self) -> bool {
        match self.entry["feature"].as_str() {
            Some(feature) => curvox_formats::formats()
                .iter()
                .all(|info| info.missing_feature != Some(feature)),
            None => true,
        }
    }
}

/// All fixtures of all formats.
pub fn all() -> Vec<Fixture> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    let mut folders: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_dir())
        .collect();
    folders.sort();
    let mut fixtures = Vec::new();
    for folder in folders {
        let text = std::fs::read(folder.join("expected.json"))
            .unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
        let entries: Vec<Value> = serde_json::from_slice(&text).unwrap();
        fixtures.extend(entries.into_iter().map(|entry| Fixture {
            path: folder.join(entry["path"].as_str().unwrap()),
            entry,
        }));
    }
    fixtures.retain(Fixture::is_read_here);
    fixtures
}

/// Voxels in canonical form: little-endian, x fastest.
fn canonical(header: &Header, mut voxels: Vec<u8>) -> Vec<u8> {
    if header.byte_order == ByteOrder::Big {
        voxels
            .chunks_exact_mut(header.voxel.bytes())
            .for_each(<[u8]>::reverse);
    }
    voxels
}

/// The voxels that most fixtures hold, 13 x 11 x 9.
fn expected_voxels(kind: &str, voxel: VoxelType) -> Option<Vec<u8>> {
    let value: fn(i32, i32, i32) -> i32 = match kind {
        "ramp" => |x, y, z| x + 16 * y + 256 * z - 1200,
        "mask" => |x, y, z| 255 * i32::from(in_ball(x, y, z)),
        "mask01" => |x, y, z| i32::from(in_ball(x, y, z)),
        _ => return None,
    };
    let mut out = Vec::new();
    for z in 0..9 {
        for y in 0..11 {
            for x in 0..13 {
                let value = value(x, y, z);
                match voxel {
                    VoxelType::U8 | VoxelType::Bool => out.push(value as u8),
                    VoxelType::I8 => out.push(value as i8 as u8),
                    VoxelType::I16 => out.extend((value as i16).to_le_bytes()),
                    VoxelType::U16 => out.extend((value as u16).to_le_bytes()),
                    VoxelType::I32 => out.extend(value.to_le_bytes()),
                    VoxelType::U32 => out.extend((value as u32).to_le_bytes()),
                    VoxelType::I64 => out.extend(i64::from(value).to_le_bytes()),
                    VoxelType::U64 => out.extend((value as u64).to_le_bytes()),
                    VoxelType::F32 => out.extend((value as f32).to_le_bytes()),
                    VoxelType::F64 => out.extend(f64::from(value).to_le_bytes()),
                    VoxelType::F16 => return None,
                }
            }
        }
    }
    Some(out)
}

fn in_ball(x: i32, y: i32, z: i32) -> bool {
    (x - 6).pow(2) + (y - 5).pow(2) + (z - 4).pow(2) < 16
}

fn read(volume: Volume) -> (Header, Vec<u8>) {
    let header = volume.header.clone();
    let mut planes = volume.into_forward();
    let (mut all, mut some) = (Vec::new(), Vec::new());
    while planes.read_planes(2, &mut some).unwrap() > 0 {
        all.extend_from_slice(&some);
    }
    planes.finish().unwrap();
    (header, all)
}

fn check_voxels(fixture: &Fixture, header: &Header, voxels: Vec<u8>) {
    let name = fixture.name();
    let voxels = canonical(header, voxels);
    let kind = fixture.entry["voxels"].as_str().unwrap();
    match expected_voxels(kind, header.voxel) {
        Some(expected) => {
            assert_eq!(header.dims, [13, 11, 9], "{name}");
            assert!(voxels == expected, "{name}: other voxels than expected");
        }
        None => assert_eq!(sha256(&voxels), kind, "{name}"),
    }
}

fn check_numbers(name: &str, what: &str, found: &[f64], expected: &Value) {
    let Some(expected) = expected.as_array() else {
        return;
    };
    for (found, expected) in found.iter().zip(expected) {
        let expected = expected.as_f64().unwrap();
        assert!(
            (found - expected).abs() <= 1e-6 * expected.abs().max(1e-3),
            "{name}: {what} {found}, expected {expected}"
        );
    }
}

#[test]
fn every_fixture_gives_what_is_expected_of_it() {
    let fixtures = all();
    assert!(!fixtures.is_empty());
    for fixture in &fixtures {
        let name = fixture.name();
        let opened = open(&fixture.path, &fixture.options());
        if let Some(part) = fixture.error() {
            let message = match opened {
                Err(error) => error.to_string(),
                // What a header promises may only be missed while reading.
                Ok(volume) => {
                    let mut planes = volume.into_forward();
                    let mut some = Vec::new();
                    let error = loop {
                        match planes.read_planes(1, &mut some) {
                            Ok(0) => break planes.finish().err(),
                            Ok(_) => {}
                            Err(error) => break Some(error),
                        }
                    };
                    error
                        .unwrap_or_else(|| panic!("{name}: read without an error"))
                        .to_string()
                }
            };
            assert!(message.contains(part), "{name}: {message}");
            continue;
        }
        let volume = opened.unwrap_or_else(|e| panic!("{e}"));
        let (header, voxels) = read(volume);
        if let Some(dtype) = fixture.entry["dtype"].as_str() {
            assert_eq!(header.voxel.name(), dtype, "{name}");
        }
        let spacing = &fixture.entry["spacing"];
        if spacing.is_null() {
            assert_eq!(header.spacing, None, "{name}");
        } else {
            let found = header
                .spacing
                .unwrap_or_else(|| panic!("{name}: no spacing"));
            check_numbers(&name, "spacing", &found, spacing);
        }
        if let Some(unit) = fixture.entry["unit"].as_str() {
            assert_eq!(header.unit.symbol(), unit, "{name}");
        }
        check_numbers(&name, "origin", &header.origin, &fixture.entry["origin"]);
        check_voxels(fixture, &header, voxels);
        conformance::check(|| open(&fixture.path, &fixture.options()))
            .unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}

#[test]
fn fixtures_that_run_forward_give_the_same_from_a_pipe() {
    for fixture in all() {
        if fixture.entry["forward"] != true {
            continue;
        }
        let name = fixture.name();
        let bytes = std::fs::read(&fixture.path).unwrap();
        let stream = || {
            open_stream(
                Box::new(std::io::Cursor::new(bytes.clone())),
                "pipe",
                &fixture.options(),
            )
        };
        let volume = stream().unwrap_or_else(|e| panic!("{name}: {e}"));
        let (header, voxels) = read(volume);
        check_voxels(&fixture, &header, voxels);
        conformance::check(stream).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}
