//! A pipe gives what the file gives.

use std::io::Write;

use curvox_formats::{DType, ErrorKind, OpenOptions, VoxelType, Voxels, open, open_stream};

use crate::support::{Folder, Nifti, gzip, noise, npy, read_all, transposed, vol, zstd};

const DIMS: [u64; 3] = [9, 8, 11];

#[test]
fn a_pipe_gives_what_the_file_gives() {
    let dtype = DType::little(VoxelType::U8);
    let voxels = noise(9 * 8 * 11);
    let stored = transposed(DIMS, 1, &voxels);
    let folder = Folder::new();
    for file in [
        npy(DIMS, dtype, 1, false, &voxels),
        npy(DIMS, dtype, 1, true, &stored),
        vol(DIMS, 2, &voxels),
        vol(DIMS, 3, &voxels),
        Nifti::new(1, DIMS, dtype).file(&voxels),
        Nifti::new(2, DIMS, dtype).file(&voxels),
    ] {
        for bytes in [gzip(&file), zstd(&file), file] {
            let path = folder.write("volume", &bytes);
            let expected = read_all(open(&path, &OpenOptions::default()).unwrap()).unwrap();
            let (reader, mut writer) = std::io::pipe().unwrap();
            let sender = std::thread::spawn(move || writer.write_all(&bytes));
            let volume = open_stream(Box::new(reader), "<stdin>", &OpenOptions::default()).unwrap();
            assert!(!volume.source.re_readable && volume.source.path.is_none());
            let found = read_all(volume).unwrap();
            sender.join().unwrap().unwrap();
            assert_eq!(found, expected);
        }
    }
}

#[cfg(unix)]
#[test]
fn a_named_pipe_is_opened_as_a_stream() {
    use std::ffi::CString;
    use std::os::unix::ffi::OsStrExt;
    let folder = Folder::new();
    let path = folder.path("pipe");
    let name = CString::new(path.as_os_str().as_bytes()).unwrap();
    // SAFETY: `name` is a valid C string.
    assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
    let voxels = noise(9 * 8 * 11);
    let file = vol(DIMS, 3, &voxels);
    let to = path.clone();
    let sender = std::thread::spawn(move || std::fs::write(to, file));
    let volume = open(&path, &OpenOptions::default()).unwrap();
    assert!(!volume.source.re_readable);
    assert!(read_all(volume).unwrap().1 == voxels);
    sender.join().unwrap().unwrap();
}

#[test]
fn fortran_order_from_a_pipe_is_held_up_to_the_limit() {
    let dtype = DType::little(VoxelType::U8);
    let file = npy(DIMS, dtype, 1, true, &noise(9 * 8 * 11));
    let open = |limit| {
        let options = OpenOptions {
            spool_limit_bytes: limit,
            ..Default::default()
        };
        open_stream(
            Box::new(std::io::Cursor::new(file.clone())),
            "<stdin>",
            &options,
        )
    };
    assert!(matches!(open(792).unwrap().voxels, Voxels::Random(_)));
    let error = open(791).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    assert!(
        error.message().contains("792") && error.message().contains("791"),
        "{error}"
    );
}

#[test]
fn a_pair_needs_a_path() {
    let header = Nifti::new(1, DIMS, DType::little(VoxelType::U8))
        .pair()
        .bytes;
    let error = open_stream(
        Box::new(std::io::Cursor::new(header)),
        "<stdin>",
        &Default::default(),
    )
    .unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
}

/// A reader whose system fails after some bytes.
struct Failing(std::io::Cursor<Vec<u8>>);

impl std::io::Read for Failing {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        match self.0.read(out)? {
            0 => Err(std::io::Error::other("the network is down")),
            n => Ok(n),
        }
    }
}

#[test]
fn a_failure_of_the_system_is_told_from_damaged_data() {
    let voxels = noise(9 * 8 * 11);
    let dtype = DType::little(VoxelType::U8);
    let file = npy(DIMS, dtype, 1, false, &voxels);
    for mut bytes in [file.clone(), gzip(&file), zstd(&file)] {
        bytes.truncate(bytes.len() - 20);
        let cut = open_stream(
            Box::new(std::io::Cursor::new(bytes.clone())),
            "cut",
            &OpenOptions::default(),
        )
        .and_then(read_all)
        .unwrap_err();
        assert_eq!(cut.kind(), ErrorKind::Invalid, "{cut}");
        let failing = Failing(std::io::Cursor::new(bytes));
        let failed = open_stream(Box::new(failing), "failing", &OpenOptions::default())
            .and_then(read_all)
            .unwrap_err();
        assert_eq!(failed.kind(), ErrorKind::Io, "{failed}");
    }
}

#[test]
fn members_and_frames_one_behind_the_other_are_one_stream() {
    let voxels = noise(9 * 8 * 11);
    let file = vol(DIMS, 2, &voxels);
    let (a, b) = file.split_at(300);
    for pack in [gzip, zstd] {
        let mut bytes = pack(a);
        bytes.extend(pack(&[]));
        bytes.extend(pack(b));
        let (_, found, warnings) =
            crate::support::read_bytes(&bytes, &OpenOptions::default()).unwrap();
        assert!(found == voxels);
        assert_eq!(warnings, [""; 0]);
    }
}

#[test]
fn garbage_behind_compressed_data_is_a_warning() {
    let voxels = noise(9 * 8 * 11);
    let file = vol(DIMS, 2, &voxels);
    for mut bytes in [gzip(&file), zstd(&file), vol(DIMS, 3, &voxels)] {
        for tail in [&b"\0\0\0\0\0\0\0\0"[..], b"x", b"\x1f\x8bno header"] {
            let length = bytes.len();
            bytes.extend_from_slice(tail);
            let (_, found, warnings) =
                crate::support::read_bytes(&bytes, &OpenOptions::default()).unwrap();
            assert!(found == voxels);
            assert_eq!(warnings.len(), 1, "{warnings:?}");
            bytes.truncate(length);
        }
    }
}

#[test]
fn compressed_twice_is_refused() {
    let bytes = gzip(&gzip(&vol(DIMS, 2, &noise(9 * 8 * 11))));
    let error = crate::support::read_bytes(&bytes, &OpenOptions::default()).unwrap_err();
    assert!(error.message().contains("twice"), "{error}");
}
