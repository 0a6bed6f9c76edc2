//! TIFF files and folders of slices: the shared ones, and what small fixtures cannot show.

use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use curvox_formats::{
    ByteOrder, Error, ErrorKind, Header, IoMode, OpenOptions, Region, Unit, Voxels, conformance,
    open,
};

use crate::sha256::sha256;
use crate::support::{Folder, peak_bytes, read_all, read_path, shared_data};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures")
        .join(name)
}

/// Voxels in canonical form.
fn little(header: &Header, mut voxels: Vec<u8>) -> Vec<u8> {
    if header.byte_order == ByteOrder::Big {
        voxels
            .chunks_exact_mut(header.voxel.bytes())
            .for_each(<[u8]>::reverse);
    }
    voxels
}

fn message(result: Result<(Header, Vec<u8>, Vec<String>), Error>) -> String {
    match result {
        Ok((header, ..)) => panic!("read as {header:?}"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn every_shared_tiff_and_folder_gives_the_canonical_voxels_and_spacing() {
    let Some(data) = shared_data() else { return };
    let text = std::fs::read(data.join("formats/manifest.json")).unwrap();
    let manifest: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let mut count = 0;
    for entry in manifest.as_array().unwrap() {
        if !["tiff", "tiff-folder"].contains(&entry["format"].as_str().unwrap()) {
            continue;
        }
        let path = data.join("formats").join(entry["path"].as_str().unwrap());
        for io in [IoMode::Map, IoMode::Read] {
            let options = OpenOptions {
                io,
                ..OpenOptions::default()
            };
            let (header, voxels, warnings) = read_all(open(&path, &options).unwrap()).unwrap();
            let spacing = entry["spacing_in_file"].as_array().map(|s| {
                let number = |i: usize| s[i].as_f64().unwrap();
                [number(0), number(1), number(2)]
            });
            assert_eq!(header.spacing, spacing, "{path:?}");
            if spacing.is_some() {
                assert_eq!(header.unit, Unit::Millimetre, "{path:?}");
            }
            assert_eq!(warnings, [""; 0], "{path:?}");
            let expected = entry["canonical_sha256"].as_str().unwrap();
            assert_eq!(sha256(&little(&header, voxels)), expected, "{path:?}");
        }
        count += 1;
    }
    assert_eq!(count, 23);
}

#[test]
fn shared_broken_files_are_told_by_what_is_wrong() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("hostile/broken");
    for name in ["ok.tif", "wrong_ext.nii"] {
        let (header, voxels, warnings) = read_path(&folder.join(name)).unwrap();
        assert_eq!(header.dims, [24; 3]);
        assert_eq!((voxels.len(), warnings.len()), (13824, 0));
    }
    for (name, part) in [
        (
            "trunc.tif",
            "page 1 is said to be at byte 14080, but the file ends at byte 8949",
        ),
        (
            "ifd_loop.tif",
            "the chain of pages comes back to an earlier one",
        ),
        ("ifd_beyond.tif", "page 0 is said to be at byte 2147483647"),
        (
            "mixed_sizes.tif",
            "not one volume: page 0 has 24 x 24 pixels of u8 (8 bits), page 1 has",
        ),
        (
            "rgb.tif",
            "colour (RGB), 3 samples each; choose one with --channel N, 0 to 2",
        ),
        ("empty_folder", "is a folder in which no volume was found"),
    ] {
        let (found, peak) = peak_bytes(|| read_path(&folder.join(name)));
        let found = message(found);
        assert!(found.contains(part), "{found}");
        assert!(peak < 1 << 20, "{name}: {peak} bytes were held");
    }
}

/// One directory of a little-endian classic TIFF at byte 8: LONG entries but for the last ones.
fn directory(entries: &[(u16, u32)]) -> Vec<u8> {
    let mut out = b"II*\0\x08\0\0\0".to_vec();
    out.extend((entries.len() as u16).to_le_bytes());
    for (tag, value) in entries {
        out.extend(tag.to_le_bytes());
        out.extend(4_u16.to_le_bytes());
        out.extend(1_u32.to_le_bytes());
        out.extend(value.to_le_bytes());
    }
    out.extend([0; 4]);
    out
}

/// An ImageJ stack of one listed page; its planes begin at `start`.
fn imagej_head(extents: [u32; 2], images: u32, start: u32) -> Vec<u8> {
    let text = format!("ImageJ=1.53t\nimages={images}\nslices={images}\nloop=false\n\0");
    let mut head = directory(&[
        (256, extents[0]),
        (257, extents[1]),
        (258, 16),
        (259, 1),
        (262, 1),
        (270, 200),
        (273, start),
        (277, 1),
        (278, extents[1]),
        (279, extents[0] * extents[1] * 2),
    ]);
    // The description is text, elsewhere.
    let at = head
        .windows(2)
        .position(|w| w == 270_u16.to_le_bytes())
        .unwrap();
    head[at + 2..at + 4].copy_from_slice(&2_u16.to_le_bytes());
    head[at + 4..at + 8].copy_from_slice(&(text.len() as u32).to_le_bytes());
    head.resize(200, 0);
    head.extend(text.as_bytes());
    assert!(head.len() <= start as usize);
    head.resize(start as usize, 0);
    head
}

#[test]
fn an_imagej_stack_above_4_gib_shows_all_its_planes() {
    const SIDE: u32 = 4096;
    const IMAGES: u32 = 140;
    let folder = Folder::new();
    let path = folder.write("big.tif", &imagej_head([SIDE, SIDE], IMAGES, 512));
    let plane = u64::from(SIDE) * u64::from(SIDE) * 2;
    let length = 512 + plane * u64::from(IMAGES);
    assert!(length > 1 << 32);
    // A file with a hole: nothing is stored but what is written here.
    let mut file = File::options().write(true).open(&path).unwrap();
    file.set_len(length).unwrap();
    let mark = 512 + plane * 139 + 2 * (4096 * 7 + 5);
    file.seek(SeekFrom::Start(mark)).unwrap();
    file.write_all(&[0x34, 0x12]).unwrap();
    drop(file);
    for io in [IoMode::Map, IoMode::Read] {
        let options = OpenOptions {
            io,
            ..OpenOptions::default()
        };
        let volume = open(&path, &options).unwrap();
        assert_eq!(volume.header.dims, [4096, 4096, 140]);
        let Voxels::Random(voxels) = volume.voxels else {
            panic!("a file is read at random")
        };
        let region = Region {
            origin: [4, 7, 138],
            size: [3, 1, 2],
        };
        let mut out = Vec::new();
        let ((), peak) = peak_bytes(|| voxels.read_box(&region, &mut out).unwrap());
        assert_eq!(out, [0, 0, 0, 0, 0, 0, 0, 0, 0x34, 0x12, 0, 0]);
        assert!(peak < 1 << 20, "{peak} bytes were held");
    }
    File::options()
        .write(true)
        .open(&path)
        .unwrap()
        .set_len(length - 1)
        .unwrap();
    let found = open(&path, &OpenOptions::default()).unwrap_err();
    assert!(found.message().contains("139 whole planes"), "{found}");
}

#[test]
fn calibrated_values_of_imagej_are_a_scaling() {
    let mut file = imagej_head([2, 2], 2, 512);
    let text = b"ImageJ=1.53t\nimages=2\nslices=2\ncf=0\nc0=-32768.0\nc1=1.0\nvunit=HU\n\0";
    file[200..200 + text.len()].copy_from_slice(text);
    let at = file
        .windows(2)
        .position(|w| w == 270_u16.to_le_bytes())
        .unwrap();
    file[at + 4..at + 8].copy_from_slice(&(text.len() as u32).to_le_bytes());
    file.extend([7; 16]);
    let folder = Folder::new();
    let path = folder.write("signed.tif", &file);
    let (header, ..) = read_path(&path).unwrap();
    let scaling = header.scaling.unwrap();
    assert_eq!((scaling.slope, scaling.intercept), (1.0, -32768.0));
    assert_eq!(header.spacing, None);
}

#[test]
fn planes_that_no_page_lists_are_turned_round_as_the_listed_one() {
    let mut file = imagej_head([2, 2], 3, 512);
    let at = file
        .windows(2)
        .position(|w| w == 262_u16.to_le_bytes())
        .unwrap();
    file[at + 8] = 0;
    file.extend((0..24_u8).map(|n| !n));
    let folder = Folder::new();
    let path = folder.write("white.tif", &file);
    let (header, voxels, _) = read_path(&path).unwrap();
    assert_eq!(header.dims, [2, 2, 3]);
    assert!(voxels.into_iter().eq(0..24));
    conformance::check(|| open(&path, &OpenOptions::default())).unwrap();
}

#[test]
fn plain_pages_one_behind_the_other_are_mapped_without_a_copy() {
    for (name, zero_copy) in [
        ("tiff/stack.tif", true),
        ("tiff/imagej.tif", true),
        ("tiff/truncated.tif", true),
        ("tiff/separate.tif", false),
        ("tiff/zstd.tif", false),
    ] {
        let volume = open(&fixture(name), &OpenOptions::default()).unwrap();
        assert!(volume.source.mapped, "{name}");
        let Voxels::Random(voxels) = volume.voxels else {
            panic!("a file is read at random")
        };
        assert_eq!(voxels.planes(2, 3).unwrap().is_some(), zero_copy, "{name}");
    }
}

#[test]
fn white_as_0_is_turned_round_and_told() {
    let (header, ..) = read_path(&fixture("tiff/white.tif")).unwrap();
    assert!(
        header.details.iter().any(|(name, _)| *name == "white"),
        "{:?}",
        header.details
    );
}

#[test]
fn a_huge_tile_in_a_small_file_takes_no_memory() {
    // Deflate of 60000 x 60000 pixels of 8 bytes out of nothing, and the same uncompressed.
    for compression in [1, 5, 8, 32773, 50000] {
        let mut pages = directory(&[
            (256, 60000),
            (257, 60000),
            (258, 64),
            (259, compression),
            (262, 1),
            (322, 60000),
            (323, 60000),
            (324, 8),
            (325, 100),
        ]);
        // A second page, so that it is a volume.
        let second = pages.len() as u32;
        let link = pages.len() - 4;
        let entries = pages[8..].to_vec();
        pages[link..].copy_from_slice(&second.to_le_bytes());
        pages.extend(entries);
        let folder = Folder::new();
        let path = folder.write("huge.tif", &pages);
        let (found, peak) = peak_bytes(|| read_path(&path));
        let found = message(found);
        assert!(
            found.contains("cannot hold that") || found.contains("expected"),
            "{found}"
        );
        assert!(peak < 1 << 20, "{peak} bytes were held");
    }
}

#[test]
fn resolution_alone_gives_a_warning_and_no_spacing() {
    let text = directory(&[
        (256, 2),
        (257, 2),
        (258, 8),
        (259, 1),
        (262, 1),
        (273, 400),
        (278, 2),
        (279, 4),
        (282, 300),
        (283, 300),
        (296, 3),
    ]);
    let mut file = text;
    for tag in [282_u16, 283] {
        let at = file
            .windows(2)
            .position(|w| w == tag.to_le_bytes())
            .unwrap();
        file[at + 2..at + 4].copy_from_slice(&5_u16.to_le_bytes());
    }
    let second = file.len();
    let link = second - 4;
    let entries = file[8..].to_vec();
    file[link..].copy_from_slice(&(second as u32).to_le_bytes());
    file.extend(entries);
    assert!(file.len() <= 300);
    file.resize(300, 0);
    file.extend(100_u32.to_le_bytes());
    file.extend(1_u32.to_le_bytes());
    file.resize(404, 1);
    let folder = Folder::new();
    let (header, _, warnings) = read_path(&folder.write("cm.tif", &file)).unwrap();
    assert_eq!(header.spacing, None);
    assert!(
        warnings[0].contains("pixels are 0.1 x 0.1 mm"),
        "{warnings:?}"
    );
}

/// A copy of the fixture of TIFF slices.
fn slices() -> (Folder, Vec<u8>) {
    let folder = Folder::new();
    let from = fixture("slices/tif");
    let whole = read_path(&from).unwrap().1;
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        std::fs::copy(&path, folder.path(&name)).unwrap();
    }
    (folder, whole)
}

#[test]
fn a_pattern_takes_the_slices_it_matches_in_natural_order() {
    let (folder, whole) = slices();
    let (header, voxels, warnings) = read_path(&folder.path("slice_*.tif")).unwrap();
    assert_eq!(header.dims, [13, 11, 9]);
    assert_eq!(warnings, [""; 0]);
    assert!(voxels == whole);
    // slice_10 to slice_13
    let (header, voxels, _) = read_path(&folder.path("slice_??.tif")).unwrap();
    assert_eq!(header.dims, [13, 11, 4]);
    assert!(voxels == whole[5 * 286..]);
    let found = message(read_path(&folder.path("nothing_*.tif")));
    assert!(found.contains("no file matches"), "{found}");
    let found = message(read_path(&folder.path("*")));
    assert!(
        found.contains("notes.txt: matches the pattern, but"),
        "{found}"
    );
    conformance::check(|| open(&folder.path("slice_*.tif"), &OpenOptions::default())).unwrap();
}

#[test]
fn other_files_and_gaps_are_told() {
    let (folder, whole) = slices();
    let (_, _, warnings) = read_path(&folder.path("")).unwrap();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].contains("1 entries that are no slices are left out, notes.txt"));
    std::fs::remove_file(folder.path("slice_8.tif")).unwrap();
    std::fs::remove_file(folder.path("notes.txt")).unwrap();
    let (header, voxels, warnings) = read_path(&folder.path("")).unwrap();
    assert_eq!(header.dims, [13, 11, 8]);
    assert!(voxels[..3 * 286] == whole[..3 * 286] && voxels[3 * 286..] == whole[4 * 286..]);
    assert!(
        warnings[0].contains("1 gap, the first between slice_7.tif and slice_9.tif"),
        "{warnings:?}"
    );
}

#[test]
fn slices_that_change_or_vanish_meanwhile_are_errors_that_name_them() {
    let (folder, whole) = slices();
    let volume = open(&folder.path(""), &OpenOptions::default()).unwrap();
    let Voxels::Random(voxels) = volume.voxels else {
        panic!("a folder is read at random")
    };
    let plane = |z: u64, out: &mut Vec<u8>| {
        let region = Region {
            origin: [0, 0, z],
            size: [13, 11, 1],
        };
        voxels.read_box(&region, out)
    };
    let mut out = Vec::new();
    std::fs::remove_file(folder.path("slice_6.tif")).unwrap();
    let found = plane(1, &mut out).unwrap_err();
    assert_eq!(found.kind(), ErrorKind::Io);
    assert!(found.path().ends_with("slice_6.tif"), "{found}");
    File::options()
        .append(true)
        .open(folder.path("slice_7.tif"))
        .unwrap()
        .write_all(b"x")
        .unwrap();
    let found = plane(2, &mut out).unwrap_err();
    assert!(
        found.to_string().contains("slice_7.tif") && found.message().contains("grew"),
        "{found}"
    );
    plane(3, &mut out).unwrap();
    assert!(out == whole[3 * 286..4 * 286]);
}

#[test]
fn slices_of_an_ome_tiff_are_read_as_its_xml_says() {
    let folder = Folder::new();
    for name in ["split_a.ome.tif", "split_b.ome.tif"] {
        std::fs::copy(fixture("tiff").join(name), folder.path(name)).unwrap();
    }
    let (header, voxels, warnings) = read_path(&folder.path("")).unwrap();
    assert_eq!(header.dims, [13, 11, 9]);
    assert_eq!(header.spacing, Some([0.5, 0.75, 1.25]));
    assert!(voxels == read_path(&fixture("tiff/stack.tif")).unwrap().1);
    assert!(
        warnings[0].contains("OME-XML of split_a.ome.tif"),
        "{warnings:?}"
    );
    std::fs::remove_file(folder.path("split_b.ome.tif")).unwrap();
    let found = message(read_path(&folder.path("split_a.ome.tif")));
    assert!(
        found.contains("split_b.ome.tif: cannot be opened"),
        "{found}"
    );
}

#[test]
fn files_outside_the_folder_are_read_only_if_allowed() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("inner")).unwrap();
    let path = folder.path("inner/outside.ome.tif");
    std::fs::copy(fixture("tiff/outside.ome.tif"), &path).unwrap();
    std::fs::copy(fixture("tiff/stack.tif"), folder.path("stack.tif")).unwrap();
    let found = message(read_path(&path));
    assert!(found.contains("outside its folder"), "{found}");
    let options = OpenOptions {
        outside: true,
        ..OpenOptions::default()
    };
    let (_, voxels, _) = read_all(open(&path, &options).unwrap()).unwrap();
    assert!(voxels == read_path(&fixture("tiff/stack.tif")).unwrap().1);
}

#[test]
fn many_files_of_one_ome_tiff_need_few_handles() {
    let folder = Folder::new();
    let plane = |name: &str| {
        let mut data = String::new();
        for z in 0..40 {
            data += &format!(
                "<TiffData FirstZ=\"{z}\" IFD=\"0\" PlaneCount=\"1\"><UUID FileName=\"p{z}.tif\">{z}\
                 </UUID></TiffData>"
            );
        }
        format!(
            "<OME UUID=\"{name}\"><Image ID=\"I\"><Pixels DimensionOrder=\"XYZCT\" SizeX=\"2\" \
             SizeY=\"2\" SizeZ=\"40\" SizeC=\"1\" SizeT=\"1\">{data}</Pixels></Image></OME>\0"
        )
    };
    for z in 0..40_u8 {
        let text = plane(&z.to_string());
        let mut file = directory(&[
            (256, 2),
            (257, 2),
            (258, 8),
            (259, 1),
            (262, 1),
            (270, 200),
            (273, 150),
            (278, 2),
            (279, 4),
        ]);
        let at = file
            .windows(2)
            .position(|w| w == 270_u16.to_le_bytes())
            .unwrap();
        file[at + 2..at + 4].copy_from_slice(&2_u16.to_le_bytes());
        file[at + 4..at + 8].copy_from_slice(&(text.len() as u32).to_le_bytes());
        assert!(file.len() <= 150);
        file.resize(150, 0);
        file.extend([z; 4]);
        file.resize(200, 0);
        file.extend(text.as_bytes());
        folder.write(&format!("p{z}.tif"), &file);
    }
    let expected: Vec<u8> = (0..40).flat_map(|z| [z; 4]).collect();
    for name in ["p0.tif", "p39.tif"] {
        let (header, voxels, _) = read_path(&folder.path(name)).unwrap();
        assert_eq!(header.dims, [2, 2, 40]);
        assert!(voxels == expected);
    }
}
