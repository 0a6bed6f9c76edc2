//! Damage of any kind is an error, in bounded memory.

use std::sync::LazyLock;

use curvox_formats::{DType, ErrorKind, OpenOptions, VoxelType, open};
use proptest::prelude::*;

use crate::support::{
    Folder, Nifti, gzip, noise, npy, open_bytes, peak_bytes, read_all, transposed, vol, zstd,
};

const DIMS: [u64; 3] = [7, 6, 5];

/// One small file of each kind.
static FILES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let dtype = DType::little(VoxelType::I16);
    let bytes = 7 * 6 * 5;
    let (small, large) = (noise(bytes), noise(2 * bytes));
    let plain = vec![
        npy(DIMS, dtype, 1, false, &large),
        npy(DIMS, dtype, 3, true, &transposed(DIMS, 2, &large)),
        vol(DIMS, 2, &small),
        vol(DIMS, 3, &small),
        Nifti::new(1, DIMS, dtype).file(&large),
        Nifti::new(2, DIMS, DType::big(VoxelType::I16)).file(&large),
        [
            &b"X: 7\nY: 6\nZ: 5\nLvoxel-Size: 4\nVersion: 2\n.\n"[..],
            &noise(4 * bytes),
        ]
        .concat(),
    ];
    let packed: Vec<_> = plain.iter().flat_map(|f| [gzip(f), zstd(f)]).collect();
    [plain, packed].concat()
});

/// Opens and reads in both ways; damaged input may be an error, nothing else. A header made
/// large by a flipped bit must not be believed before the bytes are there.
fn survives(bytes: &[u8]) {
    /// Buffers of three layers (0.4 MB), one step of a growing plane (8 MB, twice while it
    /// moves), and a little.
    const MOST_BYTES: usize = 32 << 20;
    let (_, peak) = peak_bytes(|| {
        let options = OpenOptions {
            spool_limit_bytes: 1 << 20,
            ..Default::default()
        };
        let _ = open_bytes(bytes, &options).and_then(read_all);
        let folder = Folder::new();
        let path = folder.write("damaged", bytes);
        let _ = open(&path, &options).and_then(read_all);
    });
    assert!(peak < MOST_BYTES, "{peak} bytes were held");
}

/// `PROPTEST_CASES` asks for more.
fn config() -> ProptestConfig {
    const CASES: u32 = 600;
    let default = ProptestConfig::default();
    ProptestConfig {
        cases: default.cases.max(CASES),
        failure_persistence: None,
        ..default
    }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn a_cut_file_never_panics(which in 0..21_usize, keep in 0.0..1.0_f64) {
        let file = &FILES[which];
        let keep = (file.len() as f64 * keep) as usize;
        survives(&file[..keep]);
    }

    #[test]
    fn flipped_bits_never_panic(
        which in 0..21_usize,
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0..8_u8), 1..6),
    ) {
        let mut file = FILES[which].clone();
        for (at, bit) in flips {
            let at = at.index(file.len());
            file[at] ^= 1 << bit;
        }
        survives(&file);
    }

    #[test]
    fn changed_header_bytes_never_panic(
        which in 0..7_usize,
        changes in prop::collection::vec((0..360_usize, any::<u8>()), 1..6),
    ) {
        let mut file = FILES[which].clone();
        for (at, byte) in changes {
            if let Some(b) = file.get_mut(at) {
                *b = byte;
            }
        }
        survives(&file);
    }

    #[test]
    fn noise_behind_a_magic_number_never_panics(
        which in 0..21_usize,
        keep in 4..64_usize,
        rest in prop::collection::vec(any::<u8>(), 0..600),
    ) {
        survives(&[&FILES[which][..keep], &rest].concat());
    }
}

#[test]
fn every_cut_is_an_error() {
    for (which, file) in FILES.iter().enumerate() {
        // The cut longvol of 4 bytes a voxel, too, has voxels missing.
        for keep in 0..file.len() {
            let found = open_bytes(&file[..keep], &OpenOptions::default()).and_then(read_all);
            // A zstd frame cut at its checksum, a gzip member in its trailer: still an error.
            assert!(
                found.is_err(),
                "file {which} cut to {keep} of {} bytes",
                file.len()
            );
        }
    }
}

#[test]
fn a_short_file_says_how_much_of_it_is_there() {
    let dtype = DType::little(VoxelType::U8);
    let folder = Folder::new();
    let mut file = npy([10, 10, 10], dtype, 1, false, &noise(1000));
    file.truncate(file.len() - 255);
    let path = folder.write("short.npy", &file);
    for error in [
        open(&path, &OpenOptions::default()).unwrap_err(),
        open_bytes(&file, &OpenOptions::default())
            .and_then(read_all)
            .unwrap_err(),
        open_bytes(&gzip(&file), &OpenOptions::default())
            .and_then(read_all)
            .unwrap_err(),
    ] {
        assert_eq!(error.kind(), ErrorKind::Invalid);
        for word in ["745 bytes", "7 whole planes", "1000", "10 planes"] {
            assert!(error.message().contains(word), "{error}");
        }
        assert!(error.offset().is_some());
    }
}

#[test]
fn a_wrong_checksum_is_an_error() {
    let file = vol(DIMS, 2, &noise(210));
    let mut packed = gzip(&file);
    let length = packed.len();
    packed[length - 8] ^= 1;
    let mut frame = zstd(&file);
    let length = frame.len();
    frame[length - 1] ^= 1;
    let mut zlib = vol(DIMS, 3, &noise(210));
    let length = zlib.len();
    zlib[length - 1] ^= 1;
    for bytes in [packed, frame, zlib] {
        let error = open_bytes(&bytes, &OpenOptions::default())
            .and_then(read_all)
            .unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Invalid);
        assert!(error.message().contains("damaged"), "{error}");
    }
}

#[test]
fn a_claim_of_tebibytes_is_refused_before_it_is_believed() {
    let dims = [32767; 3];
    let file = Nifti::new(1, dims, DType::little(VoxelType::I16)).file(&noise(100));
    let folder = Folder::new();
    for (name, bytes) in [("a.nii", file.clone()), ("a.nii.gz", gzip(&file))] {
        let path = folder.write(name, &bytes);
        let (error, peak) = peak_bytes(|| open(&path, &OpenOptions::default()).unwrap_err());
        assert_eq!(error.kind(), ErrorKind::Invalid);
        assert!(peak < 1 << 20, "{peak}");
    }
    // A stream shows what it has only when it is read.
    let (error, peak) = peak_bytes(|| {
        let volume = open_bytes(&file, &OpenOptions::default()).unwrap();
        let mut planes = volume.into_forward();
        planes.read_planes(u64::MAX, &mut Vec::new()).unwrap_err()
    });
    assert_eq!(error.kind(), ErrorKind::Invalid);
    assert!(peak < 32 << 20, "{peak}");
}

#[test]
fn a_bomb_behind_the_voxels_stays_in_bounded_memory() {
    let mut file = vol(DIMS, 2, &noise(210));
    file.resize(file.len() + (66 << 20), 0);
    for bytes in [gzip(&file), zstd(&file)] {
        let ((_, found, warnings), peak) = peak_bytes(|| {
            open_bytes(&bytes, &OpenOptions::default())
                .and_then(read_all)
                .unwrap()
        });
        assert!(found == noise(210));
        assert_eq!(warnings.len(), 1);
        assert!(warnings[0].contains("not verified"), "{warnings:?}");
        assert!(peak < 4 << 20, "{peak}");
    }
}

#[test]
fn a_zstd_window_beyond_the_limit_is_refused() {
    // A frame header asking for a window of 2 GiB (--long=31).
    let bytes = [0x28, 0xb5, 0x2f, 0xfd, 0x00, 0xa8, 0x01, 0x00, 0x00];
    let error = open_bytes(&bytes, &OpenOptions::default()).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Invalid);
}
