//! Files that change while they are mapped.

use std::fs::OpenOptions as FileOptions;

use curvox_formats::{DType, IoMode, OpenOptions, RandomVoxels, Region, VoxelType, Voxels, open};

use crate::support::{Folder, noise, npy, transposed};

const DIMS: [u64; 3] = [64, 64, 64];

fn mapped(folder: &Folder, io: IoMode, fortran: bool) -> Box<dyn RandomVoxels> {
    let mut voxels = noise(64 * 64 * 64);
    if fortran {
        voxels = transposed(DIMS, 1, &voxels);
    }
    let path = folder.write(
        "a.npy",
        &npy(DIMS, DType::little(VoxelType::U8), 1, fortran, &voxels),
    );
    let volume = open(
        &path,
        &OpenOptions {
            io,
            ..Default::default()
        },
    )
    .unwrap();
    assert_eq!(volume.source.mapped, io == IoMode::Map);
    match volume.voxels {
        Voxels::Random(voxels) => voxels,
        Voxels::Forward(_) => panic!("a plain file is read at random"),
    }
}

fn cut(folder: &Folder, length: u64) {
    FileOptions::new()
        .write(true)
        .open(folder.path("a.npy"))
        .unwrap()
        .set_len(length)
        .unwrap();
}

#[test]
fn a_file_cut_before_an_access_is_an_error() {
    for io in [IoMode::Map, IoMode::Read] {
        for fortran in [false, true] {
            let folder = Folder::new();
            let voxels = mapped(&folder, io, fortran);
            let mut out = Vec::new();
            voxels.read_box(&Region::whole(DIMS), &mut out).unwrap();
            voxels.check().unwrap();
            cut(&folder, 5000);
            let error = voxels.read_box(&Region::whole(DIMS), &mut out).unwrap_err();
            assert!(error.message().contains("shrank"), "{error}");
            assert!(voxels.check().is_err());
            if !fortran && io == IoMode::Map {
                assert!(voxels.planes(0, 1).is_err());
            }
        }
    }
}

#[cfg(unix)]
#[test]
fn a_file_cut_between_access_and_use_is_an_error_not_a_crash() {
    let folder = Folder::new();
    let voxels = mapped(&folder, IoMode::Map, false);
    let planes = voxels
        .planes(0, 64)
        .unwrap()
        .expect("a mapped file gives its planes");
    cut(&folder, 5000);
    // Pages beyond the new end are gone; the guard puts zeros there.
    let sum: u64 = planes.iter().map(|b| u64::from(*b)).sum();
    assert!(sum > 0);
    assert!(planes[200_000..].iter().all(|b| *b == 0));
    let error = voxels.check().unwrap_err();
    assert!(error.message().contains("shrank"), "{error}");
    // Even if the file grows back, what was read is not what was there.
    cut(&folder, 64 * 64 * 64 + 128);
    assert!(voxels.check().is_err());
    assert!(voxels.planes(0, 1).is_err());
}

#[cfg(unix)]
#[test]
fn threads_reading_a_file_that_is_cut_all_get_an_error() {
    let folder = Folder::new();
    let voxels = mapped(&folder, IoMode::Map, false);
    std::thread::scope(|scope| {
        let readers: Vec<_> = (0..4)
            .map(|_| {
                scope.spawn(|| {
                    let mut out = Vec::new();
                    loop {
                        if let Err(e) = voxels.read_box(&Region::whole(DIMS), &mut out) {
                            return e;
                        }
                    }
                })
            })
            .collect();
        std::thread::sleep(std::time::Duration::from_millis(20));
        cut(&folder, 10_000);
        for reader in readers {
            assert!(reader.join().unwrap().message().contains("file"));
        }
    });
}

#[test]
fn a_file_rewritten_under_the_map_is_an_error() {
    for io in [IoMode::Map, IoMode::Read] {
        let folder = Folder::new();
        let voxels = mapped(&folder, io, false);
        voxels.check().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(20));
        let bytes = std::fs::read(folder.path("a.npy")).unwrap();
        std::fs::write(folder.path("a.npy"), &bytes).unwrap();
        assert!(voxels.check().is_err());
    }
}

#[cfg(unix)]
#[test]
fn a_file_replaced_by_another_is_an_error() {
    for io in [IoMode::Map, IoMode::Read] {
        let folder = Folder::new();
        let voxels = mapped(&folder, io, false);
        std::fs::rename(folder.path("a.npy"), folder.path("b.npy")).unwrap();
        voxels.check().unwrap();
        std::fs::copy(folder.path("b.npy"), folder.path("a.npy")).unwrap();
        let error = voxels.check().unwrap_err();
        assert!(error.message().contains("replaced"), "{error}");
    }
}

#[test]
fn released_planes_are_read_again_all_the_same() {
    let folder = Folder::new();
    let voxels = mapped(&folder, IoMode::Map, false);
    let (mut before, mut after) = (Vec::new(), Vec::new());
    voxels.read_box(&Region::whole(DIMS), &mut before).unwrap();
    for z in [0, 1, 63, 64, 65, u64::MAX] {
        voxels.release(z);
    }
    voxels.read_box(&Region::whole(DIMS), &mut after).unwrap();
    assert!(before == after);
    voxels.check().unwrap();
}

/// Faults in a map that is not ours. Run in a process of its own by the test below.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "ends the program"]
fn fault_elsewhere() {
    let folder = Folder::new();
    let _guarded = mapped(&folder, IoMode::Map, false);
    let path = folder.write("other", &noise(8192));
    let file = FileOptions::new()
        .read(true)
        .write(true)
        .open(path)
        .unwrap();
    // SAFETY: cutting the file under this map is the very point: the fault must end the program.
    let map = unsafe { memmap2::Mmap::map(&file).unwrap() };
    file.set_len(0).unwrap();
    println!("{}", map[5000]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_fault_in_a_foreign_map_still_ends_the_program() {
    use std::os::unix::process::ExitStatusExt;
    let status = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "guard::fault_elsewhere", "--ignored"])
        .output()
        .unwrap()
        .status;
    assert_eq!(status.signal(), Some(libc::SIGBUS), "{status:?}");
}
