//! NRRD: what headers mean, and the files of the shared folder.

use std::path::Path;

use curvox_formats::{
    ByteOrder, Error, ErrorKind, Header, IoMode, OpenOptions, Unit, VoxelType, open,
};
use serde_json::Value;

use crate::sha256::sha256;
use crate::support::{
    Folder, gzip, open_bytes, peak_bytes, read_all, read_bytes, read_path, shared_data,
};

/// A volume of 2 x 3 x 4 bytes.
fn small(fields: &str) -> Vec<u8> {
    let header =
        format!("NRRD0005\ntype: uint8\ndimension: 3\nsizes: 2 3 4\nencoding: raw\n{fields}\n");
    [header.into_bytes(), (0..24).collect()].concat()
}

fn header_of(file: &[u8]) -> Header {
    read_bytes(file, &OpenOptions::default()).unwrap().0
}

fn refusal(file: &[u8]) -> Error {
    read_bytes(file, &OpenOptions::default()).unwrap_err()
}

/// Voxels as the sums of the manifest want them.
fn canonical(header: &Header, mut voxels: Vec<u8>) -> Vec<u8> {
    if header.byte_order == ByteOrder::Big {
        voxels
            .chunks_exact_mut(header.voxel.bytes())
            .for_each(<[u8]>::reverse);
    }
    voxels
}

/// Reads the files of a format in the manifest every way there is.
pub fn check_manifest(format: &str, attached: &[&str], count: usize) {
    let Some(data) = shared_data() else { return };
    let text = std::fs::read(data.join("formats/manifest.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&text).unwrap();
    let mut found = 0;
    for entry in manifest.as_array().unwrap() {
        if entry["format"] != format {
            continue;
        }
        let path = data.join("formats").join(entry["path"].as_str().unwrap());
        let mut results = Vec::new();
        for io in [IoMode::Map, IoMode::Read] {
            let options = OpenOptions {
                io,
                ..OpenOptions::default()
            };
            results.push(read_all(open(&path, &options).unwrap()).unwrap());
        }
        let extension = path.extension().unwrap().to_str().unwrap();
        if attached.contains(&extension) {
            let bytes = std::fs::read(&path).unwrap();
            results.push(read_bytes(&bytes, &OpenOptions::default()).unwrap());
        }
        for (header, voxels, warnings) in results {
            assert_eq!(warnings, [""; 0], "{path:?}");
            let numbers = |key: &str| -> Vec<f64> {
                let all = entry[key].as_array().unwrap();
                all.iter().map(|n| n.as_f64().unwrap()).collect()
            };
            assert_eq!(header.dims.map(|n| n as f64).to_vec(), numbers("dims_xyz"));
            let spacing = header.spacing.unwrap().to_vec();
            assert_eq!(spacing, numbers("spacing_in_file"), "{path:?}");
            let sum = sha256(&canonical(&header, voxels));
            assert_eq!(entry["canonical_sha256"], sum, "{path:?}");
        }
        found += 1;
    }
    assert_eq!(found, count);
}

#[test]
fn every_file_of_the_manifest_gives_the_canonical_voxels_and_spacing() {
    check_manifest("nrrd", &["nrrd"], 15);
}

#[test]
fn broken_files_give_what_they_should() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("hostile/broken");
    for (name, word) in [
        ("spacing_nan.nrrd", "NaN"),
        ("spacing_zero.nrrd", "no voxel size"),
    ] {
        let (header, _, warnings) = read_path(&folder.join(name)).unwrap();
        assert_eq!(header.spacing, None);
        assert!(
            warnings.len() == 1 && warnings[0].contains(word),
            "{warnings:?}"
        );
    }
    for (name, kind, word) in [
        ("dims_lie.nrrd", ErrorKind::Invalid, "ends early"),
        ("missing_file.nhdr", ErrorKind::Invalid, "nowhere.raw"),
        ("escape.nhdr", ErrorKind::Unsupported, "outside"),
        ("unknown_encoding.nrrd", ErrorKind::Unsupported, "lzma9"),
        ("no_endian.nrrd", ErrorKind::Invalid, "endian"),
    ] {
        let (result, peak) = peak_bytes(|| read_path(&folder.join(name)));
        let error = result.unwrap_err();
        assert!(
            error.kind() == kind && error.message().contains(word),
            "{error}"
        );
        assert!(peak < 1 << 20, "{name}: {peak} bytes were held");
        let bytes = std::fs::read(folder.join(name)).unwrap();
        assert!(
            read_bytes(&bytes, &OpenOptions::default()).is_err(),
            "{name}"
        );
    }
}

#[test]
fn files_of_pynrrd_have_the_voxels_of_their_ball() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("real-headers/pynrrd");
    let ball = std::fs::read(folder.join("BallBinary30x30x30.raw")).unwrap();
    for (name, warnings_expected) in [
        ("BallBinary30x30x30.nhdr", 0),
        ("BallBinary30x30x30.nrrd", 0),
        ("BallBinary30x30x30_bz2.nrrd", 0),
        ("BallBinary30x30x30_gz.nrrd", 0),
        ("BallBinary30x30x30_gz_byteskip_minus_one.nrrd", 0),
        ("BallBinary30x30x30_gz_lineskip.nrrd", 0),
        ("BallBinary30x30x30_byteskip_minus_one.nhdr", 0),
        ("BallBinary30x30x30_byteskip_minus_one_nifti.nhdr", 0),
    ] {
        let (header, voxels, warnings) = read_path(&folder.join(name)).unwrap();
        assert_eq!(header.dims, [30; 3]);
        assert_eq!(header.voxel, VoxelType::I16);
        assert_eq!(header.spacing, Some([1.0; 3]));
        assert!(voxels == ball, "{name}");
        assert_eq!(warnings.len(), warnings_expected, "{name}: {warnings:?}");
    }
    // It takes the header of the NIfTI file for voxels, as it says.
    let name = "BallBinary30x30x30_nifti.nhdr";
    let (_, voxels, warnings) = read_path(&folder.join(name)).unwrap();
    assert!(voxels[352..] == ball[..ball.len() - 352]);
    assert!(warnings[0].contains("352 bytes follow"), "{warnings:?}");
    let (header, voxels, _) = read_path(&folder.join("test_simple4d_raw.nrrd")).unwrap();
    assert_eq!((header.dims, voxels.len()), ([1; 3], 8));
    assert_eq!(header.spacing, Some([1.5, 1.5, 1.0]));
    for (name, word) in [
        ("BallBinary30x30x30_byteskip_minus_five.nhdr", "-5"),
        ("test1d_ascii.nrrd", "1 axes"),
        ("test2d_ascii.nrrd", "2 axes"),
        ("test_customFields.nrrd", "1 axes"),
    ] {
        let error = read_path(&folder.join(name)).unwrap_err();
        assert!(error.message().contains(word), "{error}");
    }
}

#[test]
fn every_name_of_a_type_is_known() {
    for (voxel, names) in [
        (VoxelType::I8, "signed char,int8,int8_t"),
        (VoxelType::U8, "uchar,unsigned char,uint8,uint8_t"),
        (
            VoxelType::I16,
            "short,short int,signed short,signed short int,int16,int16_t",
        ),
        (
            VoxelType::U16,
            "ushort,unsigned short,unsigned short int,uint16,uint16_t",
        ),
        (VoxelType::I32, "int,signed int,int32,int32_t"),
        (VoxelType::U32, "uint,unsigned int,uint32,uint32_t"),
        (
            VoxelType::I64,
            "longlong,long long,long long int,signed long long,signed long long int,int64,int64_t",
        ),
        (
            VoxelType::U64,
            "ulonglong,unsigned long long,unsigned long long int,uint64,uint64_t",
        ),
        (VoxelType::F32, "float,FLOAT"),
        (VoxelType::F64, "double,Double"),
    ] {
        for name in names.split(',') {
            let mut file = format!(
                "NRRD0003\ntype: {name}\ndimension: 3\nsizes: 2 1 1\nencoding: raw\nendian: big\n\n"
            )
            .into_bytes();
            file.resize(file.len() + 2 * voxel.bytes(), 0);
            assert_eq!(header_of(&file).voxel, voxel, "{name}");
        }
    }
}

#[test]
fn a_space_direction_gives_spacing_and_direction() {
    let header = header_of(&small(
        "space: right-anterior-superior\nspace directions: (0, 3, 4) (-2,0,0) (0,-0.8,0.6)\n\
         space origin: (1,2,3)\nspace units: \"mm\" \"mm\" \"mm\"\n",
    ));
    assert_eq!(header.spacing, Some([5.0, 2.0, 1.0]));
    assert_eq!(
        header.direction,
        [[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]]
    );
    assert_eq!(
        (header.origin, header.unit),
        ([1.0, 2.0, 3.0], Unit::Millimetre)
    );
    let space = header.details.iter().find(|(name, _)| *name == "space");
    assert_eq!(space.unwrap().1, "right-anterior-superior");
    assert_eq!(header.warnings, [""; 0]);
}

#[test]
fn what_is_odd_about_a_place_is_told() {
    for (fields, spacing, word) in [
        (
            "space: LPS\nspace directions: (1,0,0) (0,0,0) (0,0,1)\n",
            None,
            "length 0",
        ),
        (
            "space: LPS\nspace directions: (1,0,0) (1,0,0) (0,0,1)\n",
            Some([1.0; 3]),
            "in a plane",
        ),
        (
            "space: LPS\nspace directions: (1,0,0) (0.6,0.8,0) (0,0,1)\n",
            Some([1.0; 3]),
            "sheared",
        ),
        ("spacings: 1 -2 3\n", Some([1.0, 2.0, 3.0]), "backwards"),
        ("spacings: 1 inf 3\n", None, "no voxel size"),
        (
            "spacings: 1 1 2\nunits: \"mm\" \"mm\" \"parsec\"\n",
            Some([1.0, 1.0, 2.0]),
            "parsec",
        ),
        (
            "spacings: 1 1 2\nunits: \"mm\" \"mm\" \"\"\n",
            Some([1.0, 1.0, 2.0]),
            "not known",
        ),
        ("kinds: domain domain strange\n", None, "strange"),
        ("colour: blue\n", None, "'colour'"),
        (
            "spacings: 9 9 9\nspace: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n",
            Some([1.0; 3]),
            "directions are used",
        ),
    ] {
        let header = header_of(&small(fields));
        assert_eq!(header.spacing, spacing, "{fields}");
        let warnings = header.warnings;
        assert!(
            warnings.len() == 1 && warnings[0].contains(word),
            "{warnings:?}"
        );
    }
    let header = header_of(&small("spacings: 1 -2 3\n"));
    assert_eq!(header.direction[1], [0.0, -1.0, 0.0]);
}

#[test]
fn fields_may_be_written_in_any_way_the_specification_has() {
    let header = header_of(&small(
        "# a comment\nkey with : colon:=value\nSpacings: 1 2 3\nCENTERS: cell cell cell\n\
         content: a volume\nmin: 0\noldmax: 9\nold min: 1\nnumber: 24\nspacedimension: 3\n\
         measurement frame: (1,0,0) (0,1,0) (0,0,1)\nlabels: \"x\" \"y y\" \"\"\nblocksize: 3\n",
    ));
    assert_eq!(header.spacing, Some([1.0, 2.0, 3.0]));
    assert_eq!(header.warnings, [""; 0]);
    let latin = [b"NRRD0001\ntype: uchar\ndimension: 3\nsizes: 2 1 1\nencoding: raw\nspacings: 1 1 1\nunits: \"\xb5m\" \"\xb5m\" \"\xb5m\"\n\nab".as_slice()].concat();
    assert_eq!(header_of(&latin).unit, Unit::Micrometre);
}

#[test]
fn an_axis_that_is_not_of_space_is_refused_by_the_name_of_its_kind() {
    let file = |kinds: &str, sizes: &str| {
        format!(
            "NRRD0005\ntype: uint8\ndimension: 4\nsizes: {sizes}\nkinds: {kinds}\nencoding: raw\n\n\
             {}",
            "x".repeat(54)
        )
        .into_bytes()
    };
    for kind in [
        "vector",
        "3-vector",
        "RGB-color",
        "RGB",
        "list",
        "time",
        "covariant-vector",
        "3-gradient",
        "point",
        "3-normal",
        "HSV",
        "XYZ-color",
    ] {
        let error = refusal(&file(&format!("{kind} domain domain domain"), "3 2 3 3"));
        assert_eq!(error.kind(), ErrorKind::Unsupported);
        assert!(error.message().contains(kind), "{error}");
    }
    let error = refusal(&file("domain domain time domain", "3 2 3 3"));
    assert!(error.message().contains("time"), "{error}");
    let error = refusal(&file("domain domain domain RGB-color", "3 2 3 3"));
    assert!(error.message().contains("RGB-color"), "{error}");
    // One sample is no obstacle, wherever it is.
    for (kinds, sizes) in [
        ("stub domain domain domain", "1 2 3 9"),
        ("domain scalar domain domain", "2 1 3 9"),
        ("domain domain domain time", "2 3 9 1"),
        ("??? none ??? ???", "1 2 3 9"),
    ] {
        assert_eq!(header_of(&file(kinds, sizes)).dims, [2, 3, 9], "{kinds}");
    }
}

#[cfg(unix)]
#[test]
fn a_link_out_of_the_folder_is_followed_only_when_allowed() {
    let folder = Folder::new();
    let elsewhere = Folder::new();
    let voxels: Vec<u8> = (0..24).collect();
    let secret = elsewhere.write("secret.raw", &voxels);
    std::os::unix::fs::symlink(&secret, folder.path("link.raw")).unwrap();
    let header = |named: &str| {
        format!(
            "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 3 4\nencoding: raw\ndata file: {named}\n"
        )
    };
    for named in ["link.raw", secret.to_str().unwrap(), "../x.raw"] {
        let path = folder.write("head.nhdr", header(named).as_bytes());
        let error = read_path(&path).unwrap_err();
        assert!(error.message().contains("outside"), "{error}");
        let options = OpenOptions {
            outside: true,
            ..OpenOptions::default()
        };
        let allowed = open(&path, &options).and_then(read_all);
        assert_eq!(allowed.is_ok(), named != "../x.raw");
    }
    // A folder or a device is no file of voxels.
    std::fs::create_dir(folder.path("folder")).unwrap();
    let path = folder.write("head.nhdr", header("folder").as_bytes());
    assert!(read_path(&path).is_err());
    let path = folder.write("head.nhdr", header("/dev/zero").as_bytes());
    assert!(read_path(&path).is_err());
}

#[test]
fn a_detached_header_cannot_be_read_from_a_pipe() {
    let header =
        b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 3 4\nencoding: raw\ndata file: x.raw\n";
    let error = refusal(header);
    assert!(error.message().contains("from a stream"), "{error}");
}

#[test]
fn bombs_and_endless_headers_are_held_in_bounded_memory() {
    let head = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 64 64 64\nencoding: gzip\n";
    let bomb = gzip(&vec![0; 100 << 20]);
    let folder = Folder::new();
    for skip in ["", "byte skip: 1000000\n", "byte skip: -1\n"] {
        let file = [head.as_bytes(), skip.as_bytes(), b"\n", &bomb].concat();
        let path = folder.write("bomb.nrrd", &file);
        let (result, peak) = peak_bytes(|| read_path(&path));
        let (_, voxels, _) = result.unwrap();
        assert_eq!(voxels.len(), 64 * 64 * 64);
        assert!(peak < 8 << 20, "{peak} bytes were held");
    }
    for line in ["key:=value\n", "# comment\n", "unknown: field\n", "x"] {
        let mut endless = b"NRRD0004\n".to_vec();
        endless.extend(line.repeat((40 << 20) / line.len()).into_bytes());
        let volume = || open_bytes(&endless, &OpenOptions::default()).map(|_| ());
        let (result, peak) = peak_bytes(volume);
        assert!(
            result
                .unwrap_err()
                .message()
                .contains("does not end within")
        );
        // The stream itself is held once.
        assert!(
            peak < endless.len() + (50 << 20),
            "{line}: {peak} bytes were held"
        );
    }
}

#[test]
fn a_checksum_of_each_compressed_file_is_verified() {
    let folder = Folder::new();
    let header = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 4 2\nencoding: gzip\n\
                  data file: s%d.gz 0 1 1\n";
    let path = folder.write("head.nhdr", header.as_bytes());
    for damaged in [None, Some(0), Some(1)] {
        for i in 0..2 {
            let mut bytes = gzip(&[i; 16]);
            let end = bytes.len();
            if damaged == Some(i) {
                bytes[end - 6] ^= 1;
            }
            folder.write(&format!("s{i}.gz"), &bytes);
        }
        let result = read_path(&path);
        match damaged {
            None => assert_eq!(result.unwrap().1, [[0; 16], [1; 16]].concat()),
            Some(i) => {
                let error = result.unwrap_err();
                assert!(
                    Path::new(error.path()).ends_with(format!("s{i}.gz")),
                    "{error}"
                );
            }
        }
    }
}
