//! DICOM: the shared series, and slices made here with one thing changed at a time.

use std::path::Path;

use curvox_formats::{OpenOptions, Region, VoxelType, Voxels, conformance, open};

use crate::sha256::sha256;
use crate::support::{Folder, read_path, shared_data};

/// A slice in explicit little-endian encoding, to be changed element by element.
#[derive(Clone)]
struct Slice {
    elements: std::collections::BTreeMap<u32, (&'static [u8; 2], Vec<u8>)>,
    preamble: bool,
}

impl Slice {
    /// Slice `z` of a volume of 3 x 2 voxels a plane, 0.5 x 0.25 x 2 mm.
    fn new(z: i32) -> Self {
        let mut slice = Self {
            elements: Default::default(),
            preamble: true,
        };
        slice
            .text(0x0008_0018, b"UI", &format!("1.2.3.{z}"))
            .text(0x0008_0060, b"CS", "CT")
            .text(0x0020_000e, b"UI", "1.2.3")
            .text(0x0020_0013, b"IS", &z.to_string())
            .text(0x0020_0037, b"DS", "1\\0\\0\\0\\1\\0")
            .at([-10.0, 5.5, f64::from(2 * z)])
            .u16(0x0028_0002, 1)
            .text(0x0028_0004, b"CS", "MONOCHROME2")
            .u16(0x0028_0010, 2)
            .u16(0x0028_0011, 3)
            .text(0x0028_0030, b"DS", "0.25\\0.5")
            .u16(0x0028_0100, 16)
            .u16(0x0028_0101, 16)
            .u16(0x0028_0102, 15)
            .u16(0x0028_0103, 1)
            .pixels([0, 1, 2, 3, 4, 5].map(|i| (10 * z + i - 7) as u16));
        slice
    }

    fn put(&mut self, tag: u32, vr: &'static [u8; 2], mut value: Vec<u8>) -> &mut Self {
        if value.len() % 2 == 1 {
            value.push(if vr == b"UI" { 0 } else { b' ' });
        }
        self.elements.insert(tag, (vr, value));
        self
    }

    fn text(&mut self, tag: u32, vr: &'static [u8; 2], text: &str) -> &mut Self {
        self.put(tag, vr, text.as_bytes().to_vec())
    }

    fn u16(&mut self, tag: u32, value: u16) -> &mut Self {
        self.put(tag, b"US", value.to_le_bytes().to_vec())
    }

    fn at(&mut self, [x, y, z]: [f64; 3]) -> &mut Self {
        self.text(0x0020_0032, b"DS", &format!("{x}\\{y}\\{z}"))
    }

    fn pixels(&mut self, samples: [u16; 6]) -> &mut Self {
        self.put(
            0x7fe0_0010,
            b"OW",
            samples.iter().flat_map(|s| s.to_le_bytes()).collect(),
        )
    }

    fn without(&mut self, tag: u32) -> &mut Self {
        self.elements.remove(&tag);
        self
    }

    fn file(&self) -> Vec<u8> {
        let mut file = Vec::new();
        if self.preamble {
            file.resize(128, 0);
            file.extend(b"DICM");
            element(&mut file, 0x0002_0010, b"UI", b"1.2.840.10008.1.2.1\0");
        }
        for (&tag, (vr, value)) in &self.elements {
            element(&mut file, tag, vr, value);
        }
        file
    }
}

fn element(file: &mut Vec<u8>, tag: u32, vr: &[u8; 2], value: &[u8]) {
    file.extend(((tag >> 16) as u16).to_le_bytes());
    file.extend((tag as u16).to_le_bytes());
    file.extend(vr);
    if matches!(vr, b"OW" | b"OB" | b"SQ" | b"UN") {
        file.extend([0, 0]);
        file.extend((value.len() as u32).to_le_bytes());
    } else {
        file.extend((value.len() as u16).to_le_bytes());
    }
    file.extend(value);
}

/// A folder of `count` slices, each changed by `change`.
fn series(count: i32, change: impl Fn(i32, &mut Slice)) -> Folder {
    let folder = Folder::new();
    for z in 0..count {
        let mut slice = Slice::new(z);
        change(z, &mut slice);
        // Names in another order than positions.
        folder.write(&format!("IM{}", 9 - z), &slice.file());
    }
    folder
}

fn samples(bytes: &[u8]) -> Vec<i16> {
    let words = bytes.as_chunks().0;
    words.iter().map(|&b| i16::from_le_bytes(b)).collect()
}

fn error_of(folder: &Folder) -> String {
    match read_path(&folder.path("")) {
        Err(error) => error.to_string(),
        Ok((header, _, _)) => panic!("read: {header:?}"),
    }
}

#[test]
fn slices_are_sorted_by_position_and_spacing_is_columns_then_rows() {
    let folder = series(4, |_, _| {});
    let (header, voxels, warnings) = read_path(&folder.path("")).unwrap();
    assert_eq!(header.dims, [3, 2, 4]);
    assert_eq!(header.spacing, Some([0.5, 0.25, 2.0]));
    assert_eq!(header.unit.symbol(), "mm");
    assert_eq!(header.origin, [-10.0, 5.5, 0.0]);
    assert_eq!(warnings, [""; 0]);
    let expected: Vec<_> = (0..4)
        .flat_map(|z| (0..6).map(move |i| 10 * z + i - 7))
        .collect();
    assert_eq!(samples(&voxels), expected);
    conformance::check(|| open(&folder.path(""), &OpenOptions::default())).unwrap();
}

#[test]
fn files_without_preamble_and_files_beside_the_series_do_no_harm() {
    let folder = series(3, |_, slice| slice.preamble = false);
    folder.write("README.txt", b"hello");
    folder.write("empty", b"");
    folder.write("DICOMDIR", &Slice::new(70).file());
    let mut report = Slice::new(9);
    report.without(0x7fe0_0010).text(0x0020_000e, b"UI", "7.7");
    folder.write("report", &report.file());
    let (header, _, warnings) = read_path(&folder.path("")).unwrap();
    assert_eq!(header.dims, [3, 2, 3]);
    assert!(
        warnings
            .iter()
            .any(|w| w.contains("2 files that are not DICOM")),
        "{warnings:?}"
    );
    assert!(
        warnings
            .iter()
            .any(|w| w.contains("1 DICOM files without pixels")),
        "{warnings:?}"
    );
}

#[test]
fn a_scout_beside_the_only_volume_is_left_out_with_a_warning() {
    let folder = series(3, |_, _| {});
    let mut scout = Slice::new(5);
    scout.text(0x0020_000e, b"UI", "9.9");
    folder.write("scout", &scout.file());
    let (header, _, warnings) = read_path(&folder.path("")).unwrap();
    assert_eq!(header.dims[2], 3);
    assert!(warnings[0].contains("left out"), "{warnings:?}");
    // A plane across the others in the same series is none of them, too.
    scout
        .text(0x0020_000e, b"UI", "1.2.3")
        .text(0x0020_0037, b"DS", "0\\1\\0\\0\\0\\1");
    folder.write("scout", &scout.file());
    assert_eq!(read_path(&folder.path("")).unwrap().0.dims[2], 3);
}

#[test]
fn uneven_steps_are_warned_about_below_a_hundredth_and_refused_above() {
    let moved = |by: f64| {
        series(4, move |z, slice| {
            if z == 3 {
                slice.at([-10.0, 5.5, 6.0 + by]);
            }
        })
    };
    let (header, _, warnings) = read_path(&moved(0.018).path("")).unwrap();
    assert!(
        warnings[0].contains("differs by up to 0.90 %"),
        "{warnings:?}"
    );
    assert_eq!(header.spacing.unwrap()[2], 2.006);
    assert_eq!(read_path(&moved(0.001).path("")).unwrap().2, [""; 0]);
    let message = error_of(&moved(0.03));
    assert!(message.contains("IM7 and IM6 are 2.03"), "{message}");
    let message = error_of(&moved(4.0));
    assert!(message.contains("2 planes are missing"), "{message}");
}

#[test]
fn a_tilted_gantry_is_refused_with_its_angle() {
    let tilted = |degrees: f64| {
        series(4, move |z, slice| {
            let z = f64::from(2 * z);
            slice.at([-10.0, 5.5 + z * degrees.to_radians().tan(), z]);
        })
    };
    assert!(error_of(&tilted(12.5)).contains("12.500 degrees (gantry tilt)"));
    let (_, _, warnings) = read_path(&tilted(0.05).path("")).unwrap();
    assert!(warnings[0].contains("0.050 degrees"), "{warnings:?}");
    assert_eq!(read_path(&tilted(0.001).path("")).unwrap().2, [""; 0]);
}

#[test]
fn a_plane_beside_the_others_is_refused() {
    let folder = series(4, |z, slice| {
        if z == 1 {
            slice.at([-9.0, 5.5, 2.0]);
        }
    });
    assert!(error_of(&folder).contains("beside the line"));
}

#[test]
fn points_in_time_are_volumes_to_choose_from() {
    let folder = series(6, |z, slice| {
        slice
            .at([0.0, 0.0, f64::from(z % 3)])
            .text(0x0020_0100, b"IS", &(z / 3 + 1).to_string())
            // Differs from slice to slice, so it tells nothing.
            .text(0x0018_1060, b"DS", &(7 * z).to_string());
    });
    let message = error_of(&folder);
    assert!(
        message.contains("(time 1)") && message.contains("(time 2)"),
        "{message}"
    );
    for frame in 0..2 {
        let options = OpenOptions {
            frame: Some(frame),
            ..OpenOptions::default()
        };
        let volume = open(&folder.path(""), &options).unwrap();
        assert_eq!(volume.header.dims[2], 3);
        let mut out = Vec::new();
        volume.into_forward().read_planes(1, &mut out).unwrap();
        assert_eq!(samples(&out)[0], 30 * frame as i16 - 7);
    }
    let options = OpenOptions {
        frame: Some(2),
        ..OpenOptions::default()
    };
    assert!(open(&folder.path(""), &options).is_err());
}

#[test]
fn planes_without_positions_are_in_the_order_of_their_numbers_with_a_warning() {
    let folder = series(3, |z, slice| {
        slice
            .without(0x0020_0032)
            .without(0x0020_0037)
            .text(0x0020_0013, b"IS", &(30 - 10 * z).to_string())
            .text(0x0018_0050, b"DS", "4")
            .text(0x0018_0088, b"DS", "3");
    });
    let (header, voxels, warnings) = read_path(&folder.path("")).unwrap();
    assert_eq!(header.spacing, Some([0.5, 0.25, 3.0]));
    assert_eq!(samples(&voxels)[0], 13);
    assert!(warnings[0].contains("InstanceNumber"), "{warnings:?}");
    assert!(
        warnings[1].contains("numbers are missing between"),
        "{warnings:?}"
    );
    let folder = series(3, |_, slice| {
        slice.without(0x0020_0032).without(0x0020_0013);
    });
    assert!(error_of(&folder).contains("not known"));
}

#[test]
fn stored_bits_are_cut_out_and_their_sign_is_extended() {
    // 10 bits in bits 4 to 13, garbage around them.
    let folder = series(2, |_, slice| {
        slice
            .u16(0x0028_0101, 10)
            .u16(0x0028_0102, 13)
            .pixels([0xc00f, 0xdfff, 0x6000, 0x0010, 0x3ff0, 0xdff0]);
    });
    let (header, voxels, _) = read_path(&folder.path("")).unwrap();
    assert_eq!(header.voxel, VoxelType::I16);
    assert_eq!(samples(&voxels)[..6], [0, 511, -512, 1, -1, 511]);
    let folder = series(2, |_, slice| {
        slice.u16(0x0028_0101, 17);
    });
    assert!(error_of(&folder).contains("bits contradict"));
}

#[test]
fn one_scaling_stays_beside_the_voxels_and_several_are_applied() {
    let folder = series(2, |_, slice| {
        slice
            .text(0x0028_1052, b"DS", "-1024")
            .text(0x0028_1053, b"DS", "2.5")
            .text(0x0028_0004, b"CS", "MONOCHROME1");
    });
    let (header, _, warnings) = read_path(&folder.path("")).unwrap();
    let scaling = header.scaling.unwrap();
    assert_eq!((scaling.slope, scaling.intercept), (2.5, -1024.0));
    assert!(warnings[0].contains("MONOCHROME1"), "{warnings:?}");
    let folder = series(2, |z, slice| {
        slice.text(0x0028_1053, b"DS", &(z + 1).to_string());
    });
    let (header, voxels, warnings) = read_path(&folder.path("")).unwrap();
    assert_eq!((header.voxel, header.scaling), (VoxelType::F32, None));
    assert_eq!(voxels[24..28], 6.0_f32.to_le_bytes());
    assert!(warnings[0].contains("as f32"), "{warnings:?}");
}

#[test]
fn what_is_no_grey_image_is_refused_by_name() {
    type Change = fn(&mut Slice);
    let cases: [(Change, &str); 6] = [
        (
            |s| drop(s.text(0x0028_0004, b"CS", "PALETTE COLOR")),
            "PALETTE COLOR",
        ),
        (|s| drop(s.u16(0x0028_0002, 3)), "3 samples a pixel"),
        (
            |s| drop(s.text(0x0008_0008, b"CS", "ORIGINAL\\MOSAIC")),
            "Siemens mosaic",
        ),
        (|s| drop(s.u16(0x0028_0100, 12)), "BitsAllocated"),
        (|s| drop(s.u16(0x0028_0010, 0)), "3 x 0 pixels"),
        (|s| drop(s.without(0x0028_0010)), "no Rows"),
    ];
    for (change, part) in cases {
        let message = error_of(&series(2, |_, slice| change(slice)));
        assert!(message.contains(part), "{part}: {message}");
    }
}

#[test]
fn a_file_that_changes_while_the_series_is_read_is_an_error() {
    let folder = series(3, |_, _| {});
    let volume = open(&folder.path(""), &OpenOptions::default()).unwrap();
    let Voxels::Random(voxels) = volume.voxels else {
        panic!("random access expected");
    };
    let mut out = Vec::new();
    let whole = Region::whole(volume.header.dims);
    voxels.read_box(&whole, &mut out).unwrap();
    let mut longer = Slice::new(1).file();
    longer.extend([0; 4]);
    folder.write("IM8", &longer);
    let error = voxels.read_box(&whole, &mut out).unwrap_err();
    assert!(error.path().ends_with("IM8"), "{error}");
    std::fs::remove_file(folder.path("IM8")).unwrap();
    assert!(voxels.read_box(&whole, &mut out).is_err());
}

#[test]
fn a_damaged_slice_is_named() {
    let folder = series(3, |_, _| {});
    let file = Slice::new(1).file();
    folder.write("IM8", &file[..file.len() - 1]);
    let message = error_of(&folder);
    assert!(
        message.contains("IM8") && message.contains("11 bytes found, 12 expected"),
        "{message}"
    );
    folder.write("IM8", &file[..file.len() - 24]);
    let message = error_of(&folder);
    assert!(
        message.contains("IM8") && message.contains("no pixels"),
        "{message}"
    );
    folder.write("IM8", &file[..300]);
    assert!(error_of(&folder).contains("IM8"));
}

#[test]
fn the_shared_series_are_read_right() {
    let Some(data) = shared_data() else { return };
    let manifest = std::fs::read(data.join("formats/manifest.json")).unwrap();
    let manifest: serde_json::Value = serde_json::from_slice(&manifest).unwrap();
    let mut count = 0;
    for entry in manifest.as_array().unwrap() {
        if entry["format"] != "dicom" {
            continue;
        }
        let path = data.join("formats").join(entry["path"].as_str().unwrap());
        let (header, voxels, warnings) = read_path(&path).unwrap();
        let spacing: Vec<_> = entry["spacing_in_file"].as_array().unwrap().clone();
        assert_eq!(
            header
                .spacing
                .unwrap()
                .map(serde_json::Value::from)
                .to_vec(),
            spacing
        );
        assert_eq!(warnings, [""; 0], "{path:?}");
        let intercept = header.scaling.map_or(0, |s| s.intercept as i32);
        let canonical: Vec<u8> = voxels
            .as_chunks()
            .0
            .iter()
            .map(|&b| match header.voxel {
                VoxelType::U16 => i32::from(u16::from_le_bytes(b)),
                _ => i32::from(i16::from_le_bytes(b)),
            })
            .flat_map(|v| ((v + intercept) as i16).to_le_bytes())
            .collect();
        assert_eq!(
            sha256(&canonical),
            entry["canonical_sha256"].as_str().unwrap(),
            "{path:?}"
        );
        count += 1;
    }
    assert_eq!(count, 5);
}

/// Sums of the voxels as pydicom 3.0 gives them, in the order of positions.
#[test]
fn real_files_are_read_right() {
    let Some(data) = shared_data() else { return };
    let check = |path: &str, dims: [u64; 3], spacing: Option<[f64; 3]>, sum: &str| {
        let (header, voxels, _) = read_path(&data.join(path)).unwrap();
        assert_eq!(header.dims, dims, "{path}");
        assert_eq!(header.spacing, spacing, "{path}");
        assert_eq!(sha256(&voxels), sum, "{path}");
    };
    check(
        "dicom/adc-20",
        [256, 256, 20],
        Some([0.7031, 0.7031, 3.0]),
        "20090db431f461969dc713844974afda2db5eb9dd8405dd54436d189e8c507cd",
    );
    check(
        "dicom/secondary-capture-129",
        [129, 128, 129],
        None,
        "9737b4ef39993ae0ace1aac15b053e54d9067335ac0c5859007d7dc3a375cf6c",
    );
    let emri = "9719c5d0f62ce971a1039c9cd73a6785427f4f80a1d3b6969cb9ffc425fba054";
    for name in [
        "",
        "_RLE",
        "_big_endian",
        "_jpeg_2k_lossless",
        "_jpeg_ls_lossless",
    ] {
        check(
            &format!("real-headers/pydicom/emri_small{name}.dcm"),
            [64, 64, 10],
            None,
            emri,
        );
    }
    let path = "real-headers/pydicom/eCT_Supplemental.dcm";
    check(
        path,
        [512, 512, 2],
        Some([0.388672, 0.388672, 10.0]),
        "8488252af99ad947015de14e93b40d93f09c886598d577d7300f1e6d6ed8fb21",
    );
    let liver = "86ceb97b138085d01b005c48e893bb4348fcdcf6a9c5c73c54d4efaa0288a1f2";
    for name in ["liver", "liver_expb"] {
        let path = format!("real-headers/pydicom/{name}.dcm");
        check(&path, [512, 512, 3], Some([0.810547, 0.810547, 1.0]), liver);
    }
    for name in ["rtdose", "rtdose_rle"] {
        let path = format!("real-headers/pydicom/{name}.dcm");
        check(
            &path,
            [10, 10, 15],
            Some([10.0, 10.0, 5.0]),
            "e30a4288ac22902293b3b0144d9cd7866d43a96e2e5cf3ec59c6f78595c3a125",
        );
    }
    let refused = [
        ("CT_small", "name the folder"),
        ("MR_small", "name the folder"),
        ("MR_small_RLE", "name the folder"),
        ("MR_small_bigendian", "name the folder"),
        ("MR_small_implicit", "name the folder"),
        ("MR_small_jp2klossless", "name the folder"),
        ("MR_small_jpeg_ls_lossless", "name the folder"),
        ("MR_small_padded", "name the folder"),
        ("MR_truncated", "name the folder"),
        ("image_dfl", "name the folder"),
        ("badVR", "NumberOfFrames is '1A'"),
        ("rtplan", "no pixels"),
        ("no_meta", "not recognised"),
        ("../nibabel/csa_slice_norm", "no pixels"),
        ("../nibabel/decimal_rescale", "name the folder"),
        ("../nibabel/slicethickness_empty_string", "name the folder"),
    ];
    for (name, part) in refused {
        let path = data.join(format!("real-headers/pydicom/{name}.dcm"));
        let message = refusal(&path);
        assert!(message.contains(part), "{name}: {message}");
    }
}

fn refusal(path: &Path) -> String {
    match open(path, &OpenOptions::default()) {
        Err(error) => error.to_string(),
        Ok(volume) => panic!("read: {volume:?}"),
    }
}
