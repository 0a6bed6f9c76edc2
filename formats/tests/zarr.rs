//! Zarr, OME-Zarr and N5: the shared volumes, hostile stores, speed.

use std::path::Path;

use curvox_formats::{
    Error, ErrorKind, Format, Header, OpenOptions, Region, Unit, Volume, Voxels, conformance, open,
};

use crate::sha256::sha256;
use crate::shared::check_manifest;
#[cfg(unix)]
use crate::speed::process_seconds;
use crate::support::{Folder, peak_bytes, read_all, shared_data};

fn level(level: u32) -> OpenOptions {
    OpenOptions {
        level: Some(level),
        ..OpenOptions::default()
    }
}

fn failure(path: &Path) -> Error {
    match open(path, &OpenOptions::default()).and_then(read_all) {
        Ok(_) => panic!("{}: an error was expected", path.display()),
        Err(error) => error,
    }
}

#[test]
fn every_store_of_the_manifest_gives_the_canonical_voxels_and_spacing() {
    let count = check_manifest(&["zarr", "ome-zarr"]);
    assert!(count.is_none_or(|count| count == 10), "{count:?}");
}

#[test]
fn the_manifest_has_units_and_second_levels() {
    let Some(data) = shared_data() else { return };
    for (store, spacing) in [
        ("head-ct/v2.ome.zarr", [6.4, 6.4, 3.0]),
        ("head-ct/v3.ome.zarr", [6.4, 6.4, 3.0]),
        ("gm-mask/v2.ome.zarr", [4.0; 3]),
        ("gm-mask/v3.ome.zarr", [4.0; 3]),
    ] {
        let path = data.join("formats").join(store);
        let header = open(&path, &level(1)).unwrap().header;
        assert_eq!(header.spacing, Some(spacing));
        assert_eq!(header.unit, Unit::Millimetre);
        let error = open(&path, &level(2)).unwrap_err().to_string();
        assert!(error.contains("there are 0 (0), 1 (1)"), "{error}");
        conformance::check(|| open(&path, &level(0))).unwrap();
    }
}

#[test]
fn stores_as_their_tools_wrote_them_are_read_right() {
    let Some(data) = shared_data() else { return };
    // Voxels as zarr-python reads them, with the axes turned to z, y, x.
    for (store, number, dims, spacing, origin, sum) in [
        (
            "mni152.ome.zarr",
            0,
            [51, 64, 53],
            [2.949_852_466_583_252; 3],
            [
                -74.656_340_420_246_12,
                -109.656_340_420_246_12,
                -70.656_340_420_246_12,
            ],
            "f0adf484b06884bd3a7efe096d45572c603bf446f1a15e3aac18612a7ff81e56",
        ),
        (
            "mni152.ome.zarr",
            2,
            [12, 16, 13],
            [11.799_409_866_333_008; 3],
            [
                -70.231_561_720_371_25,
                -105.231_561_720_371_25,
                -66.231_561_720_371_25,
            ],
            "ab2d8a357f28880aae09e56b62a2c845df7493b074e7d96afe96cb62652a0033",
        ),
        (
            "mni152_axial.ome.zarr",
            0,
            [207, 256, 1],
            [0.737_463_116_645_813; 3],
            [
                -75.762_535_095_214_84,
                -110.762_535_095_214_84,
                7.146_018_385_887_146,
            ],
            "244212b335b751901d292fe864623a43090a8682d2bb0026837d644980a5e257",
        ),
    ] {
        let path = data.join("ome-zarr-real").join(store);
        let volume = open(&path, &level(number)).unwrap();
        let (header, voxels, _) = read_all(volume).unwrap();
        assert_eq!(header.format, Format::Zarr);
        assert_eq!(header.dims, dims);
        assert_eq!(header.spacing, Some(spacing));
        assert_eq!(header.origin, origin);
        assert_eq!(header.unit, Unit::Unknown);
        assert_eq!(sha256(&voxels), sum, "{store}");
    }
}

#[test]
fn hostile_stores_are_refused_before_anything_is_allocated() {
    let Some(data) = shared_data() else { return };
    for (store, kind, word) in [
        (
            "zarr_bad_json.zarr",
            ErrorKind::Invalid,
            ".zarray: is not JSON",
        ),
        ("zarr_v9.zarr", ErrorKind::Unsupported, "zarr_format is 9"),
        (
            "zarr_huge.zarr",
            ErrorKind::Unsupported,
            "more than the 2147483647 bytes",
        ),
        ("zarr_trunc_chunk.zarr", ErrorKind::Invalid, "0.0.0"),
    ] {
        let path = data.join("hostile/broken").join(store);
        let (error, peak) = peak_bytes(|| failure(&path));
        assert_eq!(error.kind(), kind, "{error}");
        assert!(error.to_string().contains(word), "{error}");
        assert!(peak < 1 << 20, "{store}: {peak} bytes");
    }
}

/// An array of version 3 of one byte a voxel.
fn array(folder: &Folder, dims: [u64; 3], chunk: u64, codecs: &str) {
    let [x, y, z] = dims;
    folder.write(
        "zarr.json",
        format!(
            r#"{{"zarr_format": 3, "node_type": "array", "shape": [{z}, {y}, {x}], "data_type":
            "uint8", "chunk_grid": {{"name": "regular", "configuration": {{"chunk_shape":
            [{chunk}, {chunk}, {chunk}]}}}}, "chunk_key_encoding": {{"name": "default",
            "configuration": {{"separator": "."}}}}, "fill_value": 7, "codecs": [{codecs}]}}"#
        )
        .as_bytes(),
    );
}

#[test]
fn a_chunk_that_unpacks_to_more_than_its_shape_is_stopped() {
    let bomb = vec![0; 256 << 20];
    let zstd_bomb = zstd::bulk::compress(&bomb, 1).unwrap();
    let gzip_bomb = crate::support::gzip(&bomb);
    drop(bomb);
    for (codec, bytes) in [("zstd", zstd_bomb), ("gzip", gzip_bomb)] {
        let folder = Folder::new();
        array(
            &folder,
            [16; 3],
            16,
            &format!(r#"{{"name": "bytes"}}, {{"name": "{codec}"}}"#),
        );
        folder.write("c.0.0.0", &bytes);
        let (error, peak) = peak_bytes(|| failure(&folder.path("")));
        let text = error.to_string();
        assert!(text.contains("c.0.0.0"), "{text}");
        assert!(peak < 1 << 20, "{codec}: {peak} bytes");
    }
}

#[test]
fn a_volume_without_chunks_is_uniform_and_costs_nothing() {
    let folder = Folder::new();
    array(&folder, [1 << 20; 3], 256, r#"{"name": "bytes"}"#);
    let volume = open(&folder.path(""), &OpenOptions::default()).unwrap();
    let Voxels::Random(voxels) = &volume.voxels else {
        panic!("chunks are read at random")
    };
    let region = Region {
        origin: [1 << 19; 3],
        size: [2000; 3],
    };
    let value = voxels.uniform(&region).unwrap();
    assert_eq!(value[0], 7);
    let small = Region {
        origin: [300, 1000, 70_000],
        size: [3, 2, 2],
    };
    let mut out = Vec::new();
    voxels.read_box(&small, &mut out).unwrap();
    assert_eq!(out, [7; 12]);
}

#[cfg(unix)]
/// Reads all chunks with two threads, each every other layer of chunks.
fn in_layers(header: &Header, read: impl Fn(u64, &mut Vec<u8>) + Sync) {
    let layers = header.dims[2] / 64;
    std::thread::scope(|scope| {
        for first in 0..2 {
            let read = &read;
            scope.spawn(move || {
                let mut out = Vec::new();
                for layer in (first..layers).step_by(2) {
                    read(layer, &mut out);
                }
            });
        }
    });
}

/// Run with `--release -- --ignored --nocapture zarr_speed`.
#[cfg(unix)]
#[test]
#[ignore = "prints figures"]
fn zarr_speed() {
    const EDGE: u64 = 512;
    let folder = Folder::new();
    let codecs = r#"{"name": "bytes"}, {"name": "zstd", "configuration": {"level": 3}}"#;
    array(&folder, [EDGE; 3], 64, codecs);
    let count = EDGE / 64;
    let mut state = 1_u32;
    for place in 0..count.pow(3) {
        let [x, y, z] = [place % count, place / count % count, place / count / count];
        let mut voxels = Vec::with_capacity(64 * 64 * 64);
        for i in 0..64_u64.pow(3) {
            let at = [x * 64 + i % 64, y * 64 + i / 64 % 64, z * 64 + i / 4096];
            let far = at.map(|v| (v as f64 - EDGE as f64 / 2.0).powi(2));
            let inside = far.iter().sum::<f64>().sqrt() < 0.4 * EDGE as f64;
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            voxels.push(if inside { 180 } else { 20 } + (state >> 30) as u8);
        }
        let packed = zstd::bulk::compress(&voxels, 3).unwrap();
        folder.write(&format!("c.{z}.{y}.{x}"), &packed);
    }
    let volume: Volume = open(&folder.path(""), &OpenOptions::default()).unwrap();
    let header = volume.header.clone();
    let Voxels::Random(voxels) = &volume.voxels else {
        panic!("chunks are read at random")
    };
    let alone = |layer: u64, out: &mut Vec<u8>| {
        out.resize(64 * 64 * 64, 0);
        for y in 0..count {
            for x in 0..count {
                let path = folder.path("").join(format!("c.{layer}.{y}.{x}"));
                let packed = std::fs::read(path).unwrap();
                let bytes = zstd::bulk::decompress_to_buffer(&packed, out).unwrap();
                assert_eq!(bytes, 64 * 64 * 64);
            }
        }
    };
    let boxes = |layer: u64, out: &mut Vec<u8>| {
        let region = Region {
            origin: [0, 0, 64 * layer],
            size: [EDGE, EDGE, 64],
        };
        voxels.read_box(&region, out).unwrap();
    };
    let mut best = [[f64::INFINITY; 2]; 2];
    for _ in 0..5 {
        for (what, read) in [&alone as &(dyn Fn(u64, &mut Vec<u8>) + Sync), &boxes]
            .into_iter()
            .enumerate()
        {
            let (begin, cpu) = (std::time::Instant::now(), process_seconds());
            in_layers(&header, read);
            let seconds = [begin.elapsed().as_secs_f64(), process_seconds() - cpu];
            best[what] = [0, 1].map(|clock| best[what][clock].min(seconds[clock]));
        }
    }
    for (clock, name) in ["wall", "processor"].into_iter().enumerate() {
        let rate = |what: usize| (EDGE.pow(3) as f64) / 1e6 / best[what][clock];
        println!(
            "{name}: zstd alone {:.0} MB/s, zarr {:.0} MB/s, {:.2} times the time",
            rate(0),
            rate(1),
            rate(0) / rate(1)
        );
    }
}

#[test]
fn images_in_time_or_channels_are_no_volume() {
    let folder = tempfile::tempdir().unwrap();
    let dims = |names: &str| {
        let text = format!(
            r#"{{"zarr_format": 3, "node_type": "array", "shape": [3, 4, 5], "data_type": "uint8",
            "chunk_grid": {{"name": "regular", "configuration": {{"chunk_shape": [3, 4, 5]}}}},
            "chunk_key_encoding": {{"name": "default"}}, "fill_value": 0,
            "codecs": [{{"name": "bytes"}}], "dimension_names": {names}}}"#
        );
        std::fs::write(folder.path().join("zarr.json"), text).unwrap();
        let volume = open(folder.path(), &OpenOptions::default());
        volume.map(|volume| volume.header.dims)
    };
    assert_eq!(dims(r#"["z", "y", "x"]"#).unwrap(), [5, 4, 3]);
    assert_eq!(dims(r#"["x", "y", "z"]"#).unwrap(), [3, 4, 5]);
    assert_eq!(dims(r#"["a", "b", "c2"]"#).unwrap(), [5, 4, 3]);
    for names in [r#"["t", "y", "x"]"#, r#"["y", "x", "channel"]"#] {
        let error = dims(names).unwrap_err().to_string();
        assert!(error.contains("is none of x, y and z"), "{error}");
    }
}
