//! Headers that say strange things.

use curvox_formats::{DType, ErrorKind, Format, OpenOptions, Scaling, Unit, VoxelType, open};

use crate::support::{Folder, Nifti, noise, npy_with, open_bytes, read_all, read_bytes, vol};

const DIMS: [u64; 3] = [3, 4, 5];
const VOXELS: usize = 60;

fn nifti(version: u8) -> Nifti {
    Nifti::new(version, DIMS, DType::little(VoxelType::U8))
}

fn header(nifti: &Nifti) -> curvox_formats::Header {
    open_bytes(&nifti.file(&noise(VOXELS)), &OpenOptions::default())
        .unwrap()
        .header
}

fn refusal(file: &[u8]) -> curvox_formats::Error {
    read_bytes(file, &OpenOptions::default()).unwrap_err()
}

#[test]
fn spacing_is_the_decimal_number_that_was_meant() {
    for version in [1, 2] {
        let mut file = nifti(version);
        file.pixdim(&[1.0, 3.2, 0.1, 1.5]);
        file.units(3);
        let header = header(&file);
        assert_eq!(header.spacing, Some([3.2, 0.1, 1.5]));
        assert_eq!(header.unit, Unit::Micrometre);
    }
}

#[test]
fn impossible_spacing_is_unknown_with_a_warning() {
    for bad in [0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e-30, 1e30] {
        for version in [1, 2] {
            let mut file = nifti(version);
            file.pixdim(&[1.0, 1.0, bad, 1.0]);
            file.units(2);
            let header = header(&file);
            assert_eq!(
                (header.spacing, header.unit),
                (None, Unit::Unknown),
                "{bad}"
            );
            assert!(
                header.warnings[0].contains("pixdim[2]"),
                "{:?}",
                header.warnings
            );
        }
    }
}

#[test]
fn negative_spacing_loses_its_sign_with_a_warning() {
    let mut file = nifti(1);
    file.pixdim(&[1.0, 1.0, -2.5, 1.0]);
    let header = header(&file);
    assert_eq!(header.spacing, Some([1.0, 2.5, 1.0]));
    assert_eq!(header.warnings.len(), 1);
}

#[test]
fn sform_gives_origin_and_direction_but_never_spacing() {
    for version in [1, 2] {
        let mut file = nifti(version);
        file.codes(1, 1);
        file.pixdim(&[1.0, 2.0, 3.0, 4.0]);
        file.srow([
            [0.0, -6.0, 0.0, 10.0],
            [4.0, 0.0, 0.0, 20.0],
            [0.0, 0.0, -8.0, 30.0],
        ]);
        let header = header(&file);
        assert_eq!(header.spacing, Some([2.0, 3.0, 4.0]));
        assert_eq!(header.origin, [10.0, 20.0, 30.0]);
        assert_eq!(
            header.direction,
            [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
        );
        assert_eq!(header.warnings.len(), 1, "{:?}", header.warnings);
        assert!(header.warnings[0].contains("pixdim is used"));
    }
}

#[test]
fn qform_is_a_rotation_by_its_quaternion() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for version in [1, 2] {
        let mut file = nifti(version);
        file.codes(1, 0);
        // 90 degrees about z, and qfac -1 turns the third axis round.
        file.pixdim(&[-1.0, 1.0, 1.0, 1.0]);
        file.quaternion([0.0, 0.0, half], [1.0, 2.0, 3.0]);
        let header = header(&file);
        assert_eq!(header.origin, [1.0, 2.0, 3.0]);
        let expected = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]];
        for r in 0..3 {
            for c in 0..3 {
                assert!((header.direction[r][c] - expected[r][c]).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn a_singular_sform_falls_back_to_the_qform() {
    for rows in [
        [[0.0; 4]; 3],
        [
            [1.0, 1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ],
        [[f64::NAN; 4]; 3],
    ] {
        let mut file = nifti(1);
        file.codes(1, 1);
        file.srow(rows);
        file.quaternion([0.0; 3], [7.0, 8.0, 9.0]);
        let header = header(&file);
        assert_eq!(header.origin, [7.0, 8.0, 9.0]);
        assert_eq!(header.spacing, Some([1.0; 3]));
        assert_eq!(header.warnings.len(), 1);
    }
}

#[test]
fn scaling_is_none_when_the_slope_is_zero_or_no_number() {
    for version in [1, 2] {
        for (slope, intercept, expected) in [
            (
                2.0,
                -1024.0,
                Some(Scaling {
                    slope: 2.0,
                    intercept: -1024.0,
                }),
            ),
            (
                1.0,
                0.5,
                Some(Scaling {
                    slope: 1.0,
                    intercept: 0.5,
                }),
            ),
            (1.0, 0.0, None),
            (0.0, 55.0, None),
            (f64::NAN, 0.0, None),
            (1.0, f64::INFINITY, None),
        ] {
            let mut file = nifti(version);
            file.slope(slope, intercept);
            assert_eq!(header(&file).scaling, expected);
        }
    }
}

#[test]
fn several_frames_need_a_choice() {
    for version in [1, 2] {
        let mut file = nifti(version);
        file.dim(&[5, 3, 4, 5, 3, 2]);
        let voxels = noise(6 * VOXELS);
        let file = file.file(&voxels);
        let error = refusal(&file);
        assert_eq!(error.kind(), ErrorKind::Unsupported);
        assert!(error.message().contains("--frame N, 0 to 5"), "{error}");
        let folder = Folder::new();
        let path = folder.write("frames", &file);
        let packed = folder.write("frames.gz", &crate::support::gzip(&file));
        for frame in 0..6 {
            let options = OpenOptions {
                frame: Some(frame as u64),
                ..Default::default()
            };
            for path in [&path, &packed] {
                let (_, found, warnings) = read_all(open(path, &options).unwrap()).unwrap();
                assert!(found == voxels[frame * VOXELS..(frame + 1) * VOXELS]);
                assert_eq!(warnings, [""; 0]);
            }
        }
        let options = OpenOptions {
            frame: Some(6),
            ..Default::default()
        };
        assert!(open(&path, &options).is_err());
    }
}

#[test]
fn axes_of_size_one_are_no_frames() {
    let mut file = nifti(1);
    file.dim(&[7, 3, 4, 5, 1, 1, 1, 1]);
    assert_eq!(header(&file).dims, DIMS);
    // Beyond dim[0] the fields mean nothing.
    file.dim(&[3, 3, 4, 5, 0, -1, 9, 0]);
    assert_eq!(header(&file).dims, DIMS);
}

#[test]
fn a_frame_of_a_format_without_frames_is_an_error() {
    let options = OpenOptions {
        frame: Some(1),
        ..Default::default()
    };
    assert!(open_bytes(&vol(DIMS, 2, &noise(VOXELS)), &options).is_err());
    let options = OpenOptions {
        frame: Some(0),
        ..Default::default()
    };
    assert!(open_bytes(&vol(DIMS, 2, &noise(VOXELS)), &options).is_ok());
}

#[test]
fn nifti_voxels_that_are_no_numbers_are_refused_by_name() {
    for (code, word) in [
        (1, "bit"),
        (32, "complex"),
        (128, "colour"),
        (1536, "128-bit"),
        (1792, "complex"),
        (2048, "complex"),
        (2304, "colour"),
    ] {
        let mut file = nifti(1);
        file.i16(70, code);
        let error = refusal(&file.file(&noise(VOXELS)));
        assert_eq!(error.kind(), ErrorKind::Unsupported);
        assert!(error.message().contains(word), "{error}");
    }
    let mut file = nifti(1);
    file.i16(70, 1234);
    assert_eq!(
        refusal(&file.file(&noise(VOXELS))).kind(),
        ErrorKind::Invalid
    );
}

#[test]
fn voxel_offsets_must_be_whole_and_behind_the_header() {
    for (offset, good) in [
        (352.0, true),
        (0.0, true),
        (351.0, false),
        (352.5, false),
        (-1.0, false),
        (f32::NAN, false),
        (1e30, false),
    ] {
        let mut file = nifti(1);
        file.f32(108, offset);
        let found = read_bytes(&file.file(&noise(VOXELS)), &OpenOptions::default());
        assert_eq!(found.is_ok(), good, "{offset}");
    }
}

#[test]
fn cifti_is_refused_by_name() {
    let mut file = nifti(2);
    file.i32(504, 3001);
    assert!(
        refusal(&file.file(&noise(VOXELS)))
            .message()
            .contains("CIFTI")
    );
}

#[test]
fn a_missing_image_names_the_files_tried() {
    let folder = Folder::new();
    let path = folder.write("lonely.hdr", &nifti(1).pair().bytes);
    let error = open(&path, &OpenOptions::default()).unwrap_err();
    assert!(error.message().contains("lonely.img.gz"), "{error}");
}

#[test]
fn npy_headers_that_are_no_plain_array_are_refused() {
    for (text, word) in [
        (
            "{'descr': '<c8', 'fortran_order': False, 'shape': (3, 4, 5)}",
            "complex",
        ),
        (
            "{'descr': '|O', 'fortran_order': False, 'shape': (3, 4, 5)}",
            "unpickled",
        ),
        (
            "{'descr': [('a', '|u1')], 'fortran_order': False, 'shape': (3, 4, 5)}",
            "structured",
        ),
        (
            "{'descr': '|S3', 'fortran_order': False, 'shape': (3, 4, 5)}",
            "not a number",
        ),
        (
            "{'descr': '<f16', 'fortran_order': False, 'shape': (3, 4, 5)}",
            "<f16",
        ),
        (
            "{'descr': 'i4', 'fortran_order': False, 'shape': (3, 4, 5)}",
            "byte order",
        ),
        (
            "{'descr': '=i4', 'fortran_order': False, 'shape': (3, 4, 5)}",
            "byte order",
        ),
        (
            "{'descr': '|u1', 'fortran_order': False, 'shape': (4, 5)}",
            "2 axes",
        ),
        (
            "{'descr': '|u1', 'fortran_order': False, 'shape': (4, 5, 6, 3)}",
            "colour",
        ),
        (
            "{'descr': '|u1', 'fortran_order': False, 'shape': (3, 0, 5)}",
            "size 0",
        ),
        (
            "{'descr': '|u1', 'fortran_order': False, 'shape': (3, -4, 5)}",
            "-4",
        ),
        (
            "{'descr': '|u1', 'fortran_order': 0, 'shape': (3, 4, 5)}",
            "fortran_order is 0",
        ),
        ("{'descr': '|u1', 'fortran_order': False}", "no key 'shape'"),
        (
            "{'descr': '|u1', 'fortran_order': False, 'shape': (3, 4, 5), 'x': 1}",
            "unknown key",
        ),
        (
            "{'descr': '|u1', 'descr': '|u1', 'fortran_order': False, 'shape': (1,1,1)}",
            "twice",
        ),
        (
            "{'descr': '|u1', 'fortran_order': False, 'shape': (exit(7), 4, 5)}",
            "literal",
        ),
        ("(1, 2)", "dictionary"),
        (
            "{'descr': '|u1', 'fortran_order': False, 'shape': (1 << 60, 4, 5)}",
            "literal",
        ),
        (
            "{'descr': '<f8', 'fortran_order': False, 'shape': (9223372036854775807, 4, 5)}",
            "do not fit",
        ),
    ] {
        let error = refusal(&npy_with(1, text, &noise(500)));
        assert!(error.message().contains(word), "{text}: {error}");
    }
}

#[test]
fn vol_headers_with_a_line_missing_or_wrong_are_errors() {
    for (from, to, word) in [
        ("X: 3\n", "", "no X"),
        ("X: 3\n", "X: -3\n", "'-3'"),
        ("X: 3\n", "X: 3.5\n", "'3.5'"),
        ("X: 3\n", "X: 0\n", "at least 1"),
        ("X: 3\n", "X: 3\nX: 3\n", "twice"),
        ("Version: 2", "Version: 9", "Version is 9"),
        ("Voxel-Size: 1", "Voxel-Size: 2", "Voxel-Size is 2"),
        (".\n", "", "'.'"),
        ("X: 3\n", "X: 18446744073709551615\n", "do not fit"),
        ("X: 3\n", "X: 99999999999999999999\n", "whole number"),
    ] {
        let file = vol(DIMS, 2, &[]);
        let text = String::from_utf8(file).unwrap().replace(from, to);
        let error = refusal(&[text.as_bytes(), &[200; 4000]].concat());
        assert!(error.message().contains(word), "{to}: {error}");
    }
}

#[test]
fn the_format_can_be_forced_but_not_against_the_content() {
    let file = vol(DIMS, 2, &noise(VOXELS));
    let force = |format| {
        let options = OpenOptions {
            format: Some(format),
            ..Default::default()
        };
        read_bytes(&file, &options)
    };
    assert!(force(Format::Vol).is_ok());
    for format in [Format::Npy, Format::Nifti1, Format::Nifti2, Format::Raw] {
        assert!(force(format).is_err(), "{format}");
    }
}

#[test]
fn other_formats_are_refused_by_name() {
    for (bytes, name) in [
        (&b"<VTKFile type=\"ImageData\">"[..], "VTK XML"),
        (b"CDF\x01rest", "NetCDF"),
        (b"\xfd7zXZ\0rest", "xz"),
        (b"P2-3D\n9 9 9\n", "PGM3D"),
        (b"Please read me", "not recognised"),
        (b"short", "not recognised"),
    ] {
        let error = refusal(bytes);
        assert_eq!(error.kind(), ErrorKind::Unsupported);
        assert!(error.message().contains(name), "{error}");
    }
    assert!(refusal(b"").message().contains("empty"));
}
