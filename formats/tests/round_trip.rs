//! What is written is read back: every type, order, byte order, version and compression.

use curvox_formats::write::{VolumeWriter, WriteFormat, WriteSpec};
use curvox_formats::{
    DType, Error, Format, IoMode, OpenOptions, Unit, Volume, VoxelType, Voxels, conformance, open,
};

use crate::support::{
    Drip, Folder, Nifti, gzip, noise, npy, open_bytes, raw_options, read_all, transposed, vol, zstd,
};

const DIMS: [u64; 3] = [5, 4, 7];

type Packer = fn(&[u8]) -> Vec<u8>;

fn types() -> Vec<DType> {
    VoxelType::ALL
        .into_iter()
        .flat_map(|v| [DType::little(v), DType::big(v)])
        .collect()
}

/// Reads `file` in every way there is and compares it with `voxels`.
fn check(file: &[u8], options: &OpenOptions, dtype: DType, voxels: &[u8], what: &str) {
    let folder = Folder::new();
    for (suffix, bytes) in [
        ("", file.to_vec()),
        (".gz", gzip(file)),
        (".zst", zstd(file)),
    ] {
        let path = folder.write(&format!("volume{suffix}"), &bytes);
        for io in [IoMode::Auto, IoMode::Map, IoMode::Read] {
            let options = OpenOptions {
                io,
                ..options.clone()
            };
            let by_path = || open(&path, &options);
            compare(by_path, dtype, voxels, &format!("{what}{suffix}, {io:?}"));
        }
        let whole = || open_bytes(&bytes, options);
        compare(whole, dtype, voxels, &format!("{what}{suffix}, stream"));
        let drip = || {
            let drip = Drip(bytes.clone(), 0);
            curvox_formats::open_stream(Box::new(drip), "drip", options)
        };
        compare(drip, dtype, voxels, &format!("{what}{suffix}, drip"));
    }
}

fn compare(open: impl Fn() -> Result<Volume, Error>, dtype: DType, voxels: &[u8], what: &str) {
    let (header, found, warnings) = open()
        .and_then(read_all)
        .unwrap_or_else(|e| panic!("{what}: {e}"));
    assert_eq!(header.dims, DIMS, "{what}");
    assert_eq!(header.voxel, dtype.voxel, "{what}");
    if dtype.voxel.bytes() > 1 {
        assert_eq!(header.byte_order, dtype.byte_order, "{what}");
    }
    assert!(found == voxels, "{what}: voxels differ");
    assert_eq!(warnings, [""; 0], "{what}");
    conformance::check(open).unwrap_or_else(|e| panic!("{what}: {e}"));
}

fn voxels_of(dtype: DType) -> Vec<u8> {
    noise(DIMS.iter().product::<u64>() as usize * dtype.voxel.bytes())
}

#[test]
fn raw_is_read_in_every_type() {
    for dtype in types() {
        let voxels = voxels_of(dtype);
        check(
            &voxels,
            &raw_options(DIMS, dtype),
            dtype,
            &voxels,
            &format!("raw {dtype}"),
        );
    }
}

#[test]
fn raw_skips_what_it_is_told_to() {
    let dtype = DType::little(VoxelType::U16);
    let voxels = voxels_of(dtype);
    let mut options = raw_options(DIMS, dtype);
    options.raw.as_mut().unwrap().skip = 11;
    let mut file = vec![9; 11];
    file.extend_from_slice(&voxels);
    check(&file, &options, dtype, &voxels, "raw with skip");
}

#[test]
fn raw_voxels_that_look_like_gzip_are_read_as_they_are() {
    let dtype = DType::little(VoxelType::U8);
    let mut voxels = voxels_of(dtype);
    voxels[..4].copy_from_slice(&[0x1f, 0x8b, 8, 0]);
    let folder = Folder::new();
    let path = folder.write("a.raw", &voxels);
    let (_, found, _) = read_all(open(&path, &raw_options(DIMS, dtype)).unwrap()).unwrap();
    assert!(found == voxels);
}

#[test]
fn npy_is_read_in_every_type_order_and_version() {
    for dtype in types() {
        let voxels = voxels_of(dtype);
        for version in [1, 2, 3] {
            let file = npy(DIMS, dtype, version, false, &voxels);
            check(
                &file,
                &OpenOptions::default(),
                dtype,
                &voxels,
                &format!("npy {version} {dtype}"),
            );
        }
        let stored = transposed(DIMS, dtype.voxel.bytes(), &voxels);
        let file = npy(DIMS, dtype, 1, true, &stored);
        check(
            &file,
            &OpenOptions::default(),
            dtype,
            &voxels,
            &format!("npy fortran {dtype}"),
        );
    }
}

#[test]
fn vol_is_read_in_every_version() {
    let dtype = DType::little(VoxelType::U8);
    let voxels = voxels_of(dtype);
    for version in [1, 2, 3] {
        let file = vol(DIMS, version, &voxels);
        check(
            &file,
            &OpenOptions::default(),
            dtype,
            &voxels,
            &format!("vol {version}"),
        );
    }
}

#[test]
fn vol_without_a_version_has_its_extents_twice() {
    let dtype = DType::little(VoxelType::U8);
    let voxels = voxels_of(dtype);
    for big in [false, true] {
        let mut file = b"X: 5\nY: 4\nZ: 7\nVoxel-Size: 1\nInt-Endian: 0123\n.\n".to_vec();
        for n in [5_u32, 4, 7] {
            file.extend_from_slice(&if big {
                n.to_be_bytes()
            } else {
                n.to_le_bytes()
            });
        }
        file.push(b'\n');
        file.extend_from_slice(&voxels);
        check(
            &file,
            &OpenOptions::default(),
            dtype,
            &voxels,
            "vol without version",
        );
    }
}

#[test]
fn longvol_is_read_with_eight_bytes() {
    let dtype = DType::little(VoxelType::U64);
    let voxels = voxels_of(dtype);
    for version in [2, 3] {
        let mut file =
            format!("X: 5\nY: 4\nZ: 7\nLvoxel-Size: 8\nInt-Endian: 0123\nVersion: {version}\n.\n")
                .into_bytes();
        file.extend(if version == 3 {
            crate::support::zlib(&voxels)
        } else {
            voxels.clone()
        });
        check(
            &file,
            &OpenOptions::default(),
            dtype,
            &voxels,
            &format!("longvol {version}"),
        );
    }
}

#[test]
fn longvol_saying_four_bytes_is_decided_by_its_data() {
    let folder = Folder::new();
    for voxel in [VoxelType::U32, VoxelType::U64] {
        let voxels = voxels_of(DType::little(voxel));
        for version in [2, 3] {
            let mut file = format!(
                "X: 5\nY: 4\nZ: 7\nLvoxel-Size: 4\nInt-Endian: 0123\nVersion: {version}\n.\n"
            )
            .into_bytes();
            file.extend(if version == 3 {
                crate::support::zlib(&voxels)
            } else {
                voxels.clone()
            });
            for bytes in [file.clone(), gzip(&file)] {
                let path = folder.write("a.longvol", &bytes);
                let options = OpenOptions::default();
                for volume in [open(&path, &options), open_bytes(&bytes, &options)] {
                    let volume = volume.unwrap();
                    assert_eq!(volume.header.format, Format::Longvol);
                    assert_eq!(volume.header.voxel, voxel);
                    let (_, found, warnings) = read_all(volume).unwrap();
                    assert!(found == voxels);
                    assert_eq!(warnings.len(), usize::from(voxel == VoxelType::U64));
                }
            }
        }
    }
}

#[test]
fn nifti_is_read_in_every_type_version_and_byte_order() {
    for dtype in types() {
        if matches!(dtype.voxel, VoxelType::Bool | VoxelType::F16) {
            continue;
        }
        let voxels = voxels_of(dtype);
        for version in [1, 2] {
            let file = Nifti::new(version, DIMS, dtype).file(&voxels);
            let what = format!("nifti-{version} {dtype}");
            check(&file, &OpenOptions::default(), dtype, &voxels, &what);
        }
    }
}

#[test]
fn nifti_pairs_are_read_from_either_file_in_any_compression() {
    let dtype = DType::big(VoxelType::I16);
    let voxels = voxels_of(dtype);
    let packers: [(&str, Packer); 3] = [("", <[u8]>::to_vec), (".gz", gzip), (".zst", zstd)];
    for version in [1, 2] {
        let header = Nifti::new(version, DIMS, dtype).pair().bytes;
        for (h, pack_header) in packers {
            for (i, pack_image) in packers {
                let folder = Folder::new();
                let hdr = folder.write(&format!("a.b.hdr{h}"), &pack_header(&header));
                let img = folder.write(&format!("a.b.img{i}"), &pack_image(&voxels));
                for path in [&hdr, &img] {
                    let by_path = || open(path, &OpenOptions::default());
                    compare(by_path, dtype, &voxels, &format!("pair {h} {i}"));
                }
                let volume = open(&hdr, &OpenOptions::default()).unwrap();
                assert_eq!(volume.source.path.as_deref(), Some(&*img));
                assert_eq!(volume.source.compressed, !i.is_empty());
            }
        }
    }
}

#[test]
fn what_the_writers_write_is_read_back() {
    let folder = Folder::new();
    for format in [
        WriteFormat::Raw,
        WriteFormat::Npy,
        WriteFormat::Nifti,
        WriteFormat::Vol,
        WriteFormat::VolZlib,
    ] {
        for dtype in types() {
            let mut spec = WriteSpec::new(format, DIMS, dtype);
            spec.spacing = Some([0.5, 3.2, 1.25]);
            spec.unit = Unit::Micrometre;
            spec.origin = [1.0, -2.0, 3.5];
            spec.direction = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
            let voxels = voxels_of(dtype);
            let path = folder.path("written");
            let file = std::fs::File::create(&path).unwrap();
            let Ok(mut writer) = VolumeWriter::new(file, "written", &spec) else {
                let known = match format {
                    WriteFormat::Vol | WriteFormat::VolZlib => {
                        dtype.voxel == VoxelType::U8 || dtype == DType::little(VoxelType::U64)
                    }
                    WriteFormat::Nifti => dtype.voxel != VoxelType::F16,
                    _ => true,
                };
                assert!(!known, "{format:?} {dtype}");
                continue;
            };
            for plane in voxels.chunks(20 * dtype.voxel.bytes()) {
                writer.write_planes(plane).unwrap();
            }
            assert!(writer.write_planes(&[0]).is_err());
            writer.finish().unwrap();

            let options = match format {
                WriteFormat::Raw => raw_options(DIMS, dtype),
                _ => OpenOptions::default(),
            };
            let (header, found, warnings) = read_all(open(&path, &options).unwrap()).unwrap();
            assert_eq!(header.dims, DIMS);
            assert!(found == voxels, "{format:?} {dtype}");
            assert_eq!(warnings, [""; 0]);
            if format == WriteFormat::Nifti {
                assert_eq!(header.spacing, spec.spacing);
                assert_eq!(header.unit, spec.unit);
                assert_eq!(header.origin, spec.origin);
                assert_eq!(header.direction, spec.direction);
            }
        }
    }
}

#[test]
fn nifti_2_is_written_where_nifti_1_ends() {
    let spec = WriteSpec::new(
        WriteFormat::Nifti,
        [40_000, 1, 2],
        DType::little(VoxelType::U8),
    );
    let mut writer = VolumeWriter::new(Vec::new(), "long", &spec).unwrap();
    let voxels = noise(80_000);
    writer.write_planes(&voxels).unwrap();
    let file = writer.finish().unwrap();
    let volume = open_bytes(&file, &OpenOptions::default()).unwrap();
    assert_eq!(volume.header.format, Format::Nifti2);
    assert_eq!(volume.header.dims, [40_000, 1, 2]);
    assert!(read_all(volume).unwrap().1 == voxels);
}

#[test]
fn a_writer_with_voxels_missing_is_an_error() {
    let spec = WriteSpec::new(WriteFormat::Npy, DIMS, DType::little(VoxelType::U8));
    let mut writer = VolumeWriter::new(Vec::new(), "short", &spec).unwrap();
    writer.write_planes(&[0; 20]).unwrap();
    assert!(writer.finish().is_err());
    let nothing = WriteSpec::new(WriteFormat::Npy, [0, 1, 1], DType::little(VoxelType::U8));
    assert!(VolumeWriter::new(Vec::new(), "empty", &nothing).is_err());
}

#[test]
fn mapped_planes_come_without_a_copy() {
    let dtype = DType::little(VoxelType::I16);
    let voxels = voxels_of(dtype);
    let folder = Folder::new();
    let path = folder.write("a.npy", &npy(DIMS, dtype, 1, false, &voxels));
    let volume = open(
        &path,
        &OpenOptions {
            io: IoMode::Map,
            ..Default::default()
        },
    )
    .unwrap();
    assert!(volume.source.mapped && volume.source.re_readable && !volume.source.compressed);
    let Voxels::Random(random) = volume.voxels else {
        panic!("a mapped file reads at random")
    };
    assert_eq!(random.planes(2, 3).unwrap(), Some(&voxels[80..200]));
    let volume = open(
        &path,
        &OpenOptions {
            io: IoMode::Read,
            ..Default::default()
        },
    )
    .unwrap();
    assert!(!volume.source.mapped);
    let Voxels::Random(random) = volume.voxels else {
        panic!("a file reads at random")
    };
    assert_eq!(random.planes(2, 3).unwrap(), None);
}

#[test]
fn an_array_with_long_columns_is_transposed_whatever_the_gaps() {
    // Columns of 40 000 bytes: rows are read one by one, and together where a box takes all.
    let dims = [40, 3, 20_000];
    let dtype = DType::little(VoxelType::U16);
    let voxels = noise(2 * 40 * 3 * 20_000);
    let file = npy(dims, dtype, 1, true, &transposed(dims, 2, &voxels));
    let folder = Folder::new();
    let path = folder.write("long.npy", &file);
    for io in [IoMode::Map, IoMode::Read] {
        let options = OpenOptions {
            io,
            ..Default::default()
        };
        let Voxels::Random(random) = open(&path, &options).unwrap().voxels else {
            panic!("a plain file is read at random")
        };
        let mut out = Vec::new();
        for (z, count) in [(0, 20_000), (17, 5), (19_999, 1), (3, 19_000)] {
            let region = curvox_formats::Region {
                origin: [0, 0, z],
                size: [40, 3, count],
            };
            random.read_box(&region, &mut out).unwrap();
            let (from, to) = (z as usize * 240, (z + count) as usize * 240);
            assert!(out == voxels[from..to], "{io:?} {z} {count}");
        }
    }
}

#[test]
fn an_image_said_to_be_raw_is_read_as_such_beside_a_header() {
    let dtype = DType::little(VoxelType::U8);
    let voxels = voxels_of(dtype);
    let folder = Folder::new();
    folder.write("a.hdr", &Nifti::new(1, [7, 4, 5], dtype).pair().bytes);
    let path = folder.write("a.img", &voxels);
    assert_eq!(
        open(&path, &raw_options(DIMS, dtype)).unwrap().header.dims,
        DIMS
    );
    assert_eq!(
        open(&path, &OpenOptions::default()).unwrap().header.dims,
        [7, 4, 5]
    );
}
