//! HDF5: volumes of h5py and of others, read by boxes and by threads.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use curvox_formats::{IoMode, OpenOptions, RandomVoxels, Region, Unit, VoxelType, Voxels, open};
use serde_json::Value;

use crate::sha256::sha256;
use crate::support::shared_data;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/hdf5")
        .join(name)
}

fn random(path: &Path, options: &OpenOptions) -> (Vec<u8>, [u64; 3], Box<dyn RandomVoxels>) {
    let volume = open(path, options).unwrap_or_else(|e| panic!("{e}"));
    let dims = volume.header.dims;
    let Voxels::Random(voxels) = volume.voxels else {
        panic!("{}: not by boxes", path.display());
    };
    let mut all = Vec::new();
    voxels.read_box(&Region::whole(dims), &mut all).unwrap();
    (all, dims, voxels)
}

#[test]
fn threads_read_the_same_boxes_as_one() {
    for name in [
        "btree1-deep.h5",
        "btree2-gzip.h5",
        "extensible.h5",
        "fixed-array-paged.h5",
    ] {
        let (all, dims, voxels) = random(&fixture(name), &OpenOptions::default());
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    let mut out = Vec::new();
                    for z in 0..dims[2] {
                        let origin = [3, 2, z];
                        let size = [7, 5, 1];
                        voxels.read_box(&Region { origin, size }, &mut out).unwrap();
                        for y in 0..5 {
                            let at = (((z * dims[1] + 2 + y) * dims[0] + 3) * 2) as usize;
                            let row = &out[y as usize * 14..][..14];
                            assert_eq!(row, &all[at..at + 14], "{name}, plane {z}");
                        }
                    }
                });
            }
        });
    }
}

#[test]
fn files_that_are_read_give_what_mapped_files_give() {
    let read = OpenOptions {
        io: IoMode::Read,
        ..OpenOptions::default()
    };
    for name in [
        "contiguous-v0.h5",
        "gzip-v3.h5",
        "lzf.h5",
        "btree2.h5",
        "links-v3.h5",
    ] {
        let mapped = random(&fixture(name), &OpenOptions::default());
        assert_eq!(mapped.0, random(&fixture(name), &read).0, "{name}");
    }
}

#[test]
fn chunks_that_were_never_written_are_known_without_reading() {
    let (_, _, voxels) = random(&fixture("fill-v3.h5"), &OpenOptions::default());
    let region = |origin| Region {
        origin,
        size: [4, 4, 4],
    };
    assert_eq!(voxels.chunk(), Some([4, 4, 4]));
    let fill = voxels.uniform(&region([0, 0, 0])).unwrap();
    assert_eq!(fill[..2], (-7_i16).to_le_bytes());
    assert_eq!(voxels.uniform(&region([4, 4, 4])), None);
}

#[test]
fn contiguous_datasets_are_mapped_in_place() {
    let (all, dims, voxels) = random(&fixture("nexus.h5"), &OpenOptions::default());
    assert_eq!(voxels.planes(0, dims[2]).unwrap(), Some(&all[..]));
}

/// Voxels, canonical: little-endian, x fastest.
fn canonical(path: &Path) -> String {
    let volume = open(path, &OpenOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    let bytes = volume.header.voxel.bytes();
    let big = volume.header.byte_order == curvox_formats::ByteOrder::Big;
    let (mut all, _, _) = random(path, &OpenOptions::default());
    if big {
        all.chunks_exact_mut(bytes).for_each(<[u8]>::reverse);
    }
    sha256(&all)
}

#[test]
fn shared_files_give_their_voxels() {
    let Some(data) = shared_data() else { return };
    let text = std::fs::read(data.join("formats/manifest.json")).unwrap();
    let entries: Vec<Value> = serde_json::from_slice(&text).unwrap();
    let mut seen = 0;
    for entry in entries.iter().filter(|entry| entry["format"] == "hdf5") {
        let path = data.join("formats").join(entry["path"].as_str().unwrap());
        let header = open(&path, &OpenOptions::default()).unwrap().header;
        assert_eq!(
            canonical(&path),
            entry["canonical_sha256"],
            "{}",
            path.display()
        );
        match entry["spacing_in_file"].as_array() {
            None => assert_eq!(header.spacing, None),
            Some(expected) => {
                assert_eq!(header.unit, Unit::Micrometre);
                for (found, expected) in header.spacing.unwrap().iter().zip(expected) {
                    // The table says millimetres.
                    let expected = expected.as_f64().unwrap() * 1000.0;
                    assert!(
                        (found - expected).abs() < 1e-3,
                        "{found}, expected {expected}"
                    );
                }
            }
        }
        seen += 1;
    }
    assert!(seen >= 6, "{seen} files");
}

#[test]
fn files_of_others_are_read_or_refused_by_name() {
    let Some(data) = shared_data() else { return };
    let open = |name: &str| open(&data.join(name), &OpenOptions::default());
    let cat = open("real-headers/dgtal/cat10.h5").unwrap().header;
    assert_eq!((cat.dims, cat.voxel), ([40; 3], VoxelType::U8));
    let expected = HashMap::from([
        (
            "real-headers/dgtal/ex_image2.h5",
            "/image24bitpixel (149 x 227 x 3 u8)",
        ),
        ("hostile/broken/two_volumes.h5", "/b (24 x 24 x 24 f32le)"),
        ("hostile/broken/no_volume.h5", "no 3-D dataset"),
        ("hostile/broken/trunc.h5", "the file ends early"),
    ]);
    for (name, part) in expected {
        let message = open(name).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
    let minc = |name: &str| {
        open(&format!("real-headers/nibabel/{name}"))
            .unwrap()
            .header
    };
    let one = minc("minc2_1_scale.mnc");
    assert_eq!(one.dims, [20, 20, 10]);
    assert_eq!(one.spacing, Some([2.0; 3]));
    assert_eq!(one.origin, [-20.0, -20.0, -10.0]);
    assert!(one.scaling.is_some());
    assert_eq!(minc("minc2-no-att.mnc").spacing, None);
    // Each plane has its scale, so the values are no longer those stored.
    let planes = minc("minc2_baddim.mnc");
    assert_eq!((planes.dims, planes.voxel), ([10; 3], VoxelType::F32));
    assert!((planes.spacing.unwrap()[0] - 0.035).abs() < 1e-9);
    let small = data.join("real-headers/nibabel/small.mnc");
    let (all, dims, _) = random(&small, &OpenOptions::default());
    assert_eq!(dims, [29, 28, 18]);
    let values: Vec<f32> = all
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        .collect();
    // As nibabel reads it.
    let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64;
    assert!((mean - SMALL_MEAN).abs() < 1e-3, "{mean}");
}

/// Mean of the values of `small.mnc`.
const SMALL_MEAN: f64 = 31.212_795;
