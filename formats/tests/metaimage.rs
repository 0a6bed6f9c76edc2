//! MetaImage: what headers mean, and the files of the shared folder.

use curvox_formats::{ByteOrder, ErrorKind, Header, OpenOptions, Scaling, Unit, VoxelType};

use crate::nrrd::check_manifest;
use crate::support::{peak_bytes, read_bytes, read_path, shared_data};

/// A volume of 2 x 3 x 4 bytes.
fn small(fields: &str) -> Vec<u8> {
    let header = format!(
        "NDims = 3\nDimSize = 2 3 4\nElementType = MET_UCHAR\n{fields}ElementDataFile = LOCAL\n"
    );
    [header.into_bytes(), (0..24).collect()].concat()
}

fn header_of(file: &[u8]) -> Header {
    read_bytes(file, &OpenOptions::default()).unwrap().0
}

#[test]
fn every_file_of_the_manifest_gives_the_canonical_voxels_and_spacing() {
    check_manifest("metaimage", &["mha"], 11);
}

#[test]
fn broken_files_give_what_they_should() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("hostile/broken");
    let (header, _, warnings) = read_path(&folder.join("spacing_negative.mha")).unwrap();
    assert_eq!(header.spacing, Some([1.0; 3]));
    assert_eq!(header.direction[1][1], -1.0);
    assert!(
        warnings.len() == 1 && warnings[0].contains("backwards"),
        "{warnings:?}"
    );
    for (name, word) in [
        ("dims_lie.mha", "ends early"),
        ("missing.mhd", "gone.raw"),
        ("trunc_zlib.mha", "ends early"),
        ("bad_type.mha", "MET_WIDE"),
    ] {
        let (result, peak) = peak_bytes(|| read_path(&folder.join(name)));
        let error = result.unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Invalid);
        assert!(error.message().contains(word), "{error}");
        assert!(peak < 1 << 20, "{name}: {peak} bytes were held");
        let bytes = std::fs::read(folder.join(name)).unwrap();
        assert!(
            read_bytes(&bytes, &OpenOptions::default()).is_err(),
            "{name}"
        );
    }
}

#[test]
fn files_of_dgtal_have_the_header_their_program_wrote() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("real-headers/dgtal");
    let raw = std::fs::read(folder.join("lobsterCroped16b.raw")).unwrap();
    let (header, voxels, warnings) = read_path(&folder.join("lobsterCroped16b.mhd")).unwrap();
    assert_eq!((header.dims, header.voxel), ([51, 91, 31], VoxelType::U16));
    assert_eq!(header.byte_order, ByteOrder::Big);
    assert_eq!(
        (header.spacing, header.unit),
        (Some([1.0; 3]), Unit::Unknown)
    );
    assert!(voxels == raw && warnings.is_empty());
    let (header, voxels, warnings) = read_path(&folder.join("lobsterCropedB16b.mhd")).unwrap();
    assert_eq!(header.byte_order, ByteOrder::Little);
    assert_eq!(header.spacing, Some([0.5, 0.45, 0.55]));
    assert_eq!(header.origin, [11.3; 3]);
    assert_eq!(
        header.direction,
        [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    );
    assert!(voxels == raw && warnings.is_empty(), "{warnings:?}");
}

#[test]
fn rows_of_the_matrix_are_directions_of_axes() {
    // ITK puts voxel (1, 0, 0) of this one at (0, 0.5, 0).
    for field in ["TransformMatrix", "Rotation", "Orientation"] {
        let header = header_of(&small(&format!(
            "{field} = 0 1 0 0 0 1 1 0 0\nElementSpacing = 0.5 0.75 1.25\n"
        )));
        assert_eq!(
            header.direction,
            [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        );
        assert_eq!(header.spacing, Some([0.5, 0.75, 1.25]));
    }
    // And voxel (1, 0, 0) of this one at (1, 0, 0).
    let header = header_of(&small(
        "TransformMatrix = 2 0 0 0 1 0 0 0 1\nElementSpacing = 0.5 0.75 1.25\n",
    ));
    assert_eq!(header.spacing, Some([1.0, 0.75, 1.25]));
    assert!(
        header.warnings[0].contains("scales"),
        "{:?}",
        header.warnings
    );
    let header = header_of(&small("TransformMatrix = 0 0 0 0 0 0 0 0 0\n"));
    assert_eq!((header.spacing, header.warnings.len()), (None, 0));
}

#[test]
fn intensities_are_scaled_elements() {
    let header = header_of(&small(
        "ElementToIntensityFunctionSlope = 2\nElementToIntensityFunctionOffset = -1000\n",
    ));
    let expected = Scaling {
        slope: 2.0,
        intercept: -1000.0,
    };
    assert_eq!(header.scaling, Some(expected));
    for line in [
        "ElementToIntensityFunctionSlope = 0\n",
        "ElementToIntensityFunctionOffset = nan\n",
    ] {
        assert!(read_bytes(&small(line), &OpenOptions::default()).is_err());
    }
}

#[test]
fn every_type_of_element_is_known() {
    for (name, voxel) in [
        ("MET_CHAR", VoxelType::I8),
        ("MET_ASCII_CHAR", VoxelType::I8),
        ("MET_UCHAR", VoxelType::U8),
        ("MET_SHORT", VoxelType::I16),
        ("MET_USHORT", VoxelType::U16),
        ("MET_INT", VoxelType::I32),
        ("MET_UINT", VoxelType::U32),
        ("MET_LONG", VoxelType::I32),
        ("MET_ULONG", VoxelType::U32),
        ("MET_LONG_LONG", VoxelType::I64),
        ("MET_ULONG_LONG", VoxelType::U64),
        ("MET_FLOAT", VoxelType::F32),
        ("MET_DOUBLE", VoxelType::F64),
    ] {
        let mut file =
            format!("NDims = 3\nDimSize = 1 2 1\nElementType = {name}\nElementDataFile = local\n")
                .into_bytes();
        file.resize(file.len() + 2 * voxel.bytes(), 0);
        assert_eq!(header_of(&file).voxel, voxel, "{name}");
    }
}

#[test]
fn the_unit_is_unknown_unless_the_file_says_it() {
    let unit = |line: &str| header_of(&small(&format!("ElementSpacing = 1 1 1\n{line}"))).unit;
    assert_eq!(unit(""), Unit::Unknown);
    assert_eq!(unit("DistanceUnits = ?\n"), Unit::Unknown);
    assert_eq!(unit("DistanceUnits = mm\n"), Unit::Millimetre);
    assert_eq!(unit("DistanceUnits = um\n"), Unit::Micrometre);
    assert_eq!(unit("DistanceUnits = cm\n"), Unit::Centimetre);
}
