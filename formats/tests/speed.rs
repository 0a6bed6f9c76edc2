//! Figures, not checks, on one thread: run with `--release -- --ignored --nocapture speed`.

use curvox_formats::{DType, IoMode, OpenOptions, Region, VoxelType, Voxels, open};

use crate::mrc::{ORDERS, permuted};
use crate::support::{Folder, gzip, npy, transposed, vol, zstd};

/// A ball in weak noise: compresses like a scan, about 4 to 1.
fn scan(edge: u64) -> Vec<u8> {
    let mut state = 1_u32;
    let middle = edge as f64 / 2.0;
    let mut out = Vec::new();
    for z in 0..edge {
        for y in 0..edge {
            for x in 0..edge {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let [dx, dy, dz] = [x, y, z].map(|v| v as f64 - middle);
                let inside = (dx * dx + dy * dy + dz * dz).sqrt() < 0.4 * edge as f64;
                out.push(if inside { 180 } else { 20 } + (state >> 30) as u8);
            }
        }
    }
    out
}

/// Seconds this thread has run: a busy machine does not change them.
#[cfg(unix)]
fn cpu_seconds() -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the clock exists, and `time` is filled by the call.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Seconds all threads of this process have run.
#[cfg(unix)]
pub fn process_seconds() -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the clock exists, and `time` is filled by the call.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn resident_mib() -> f64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: f64 = text
        .split(' ')
        .nth(1)
        .and_then(|n| n.parse().ok())
        .unwrap_or(0.0);
    pages * 4096.0 / f64::from(1 << 20)
}

#[cfg(unix)]
#[test]
#[ignore = "prints figures"]
fn speed() {
    const EDGE: u64 = 400;
    let dims = [EDGE; 3];
    let voxels = scan(EDGE);
    let dtype = DType::little(VoxelType::U8);
    let plain = npy(dims, dtype, 1, false, &voxels);
    let stored = npy(dims, dtype, 1, true, &transposed(dims, 1, &voxels));
    let folder = Folder::new();
    let report = |what: &str, start: f64, peak: f64| {
        let seconds = cpu_seconds() - start;
        let rate = voxels.len() as f64 / 1e6 / seconds;
        println!("{what:<28} {rate:>8.0} MB per CPU second, resident peak +{peak:.0} MiB");
    };
    for (what, bytes) in [
        ("npy.gz forward", gzip(&plain)),
        ("npy.zst forward", zstd(&plain)),
        ("vol v3 forward", vol(dims, 3, &voxels)),
    ] {
        let path = folder.write(what, &bytes);
        drop(bytes);
        let base = resident_mib();
        let start = cpu_seconds();
        let mut planes = open(&path, &OpenOptions::default()).unwrap().into_forward();
        let (mut some, mut peak) = (Vec::new(), 0.0_f64);
        while planes.read_planes(16, &mut some).unwrap() > 0 {
            peak = peak.max(resident_mib() - base);
        }
        planes.finish().unwrap();
        report(what, start, peak);
    }
    let mut files = vec![("npy".to_string(), plain), ("npy fortran".into(), stored)];
    // What the voxels are does not matter.
    files.extend(ORDERS[1..].iter().map(|axes| {
        let letters: String = axes.iter().map(|axis| ["x", "y", "z"][*axis]).collect();
        (format!("mrc {letters}"), permuted(*axes, dims, 0, &voxels))
    }));
    for (what, bytes) in files {
        let path = folder.write(&what, &bytes);
        for io in [IoMode::Map, IoMode::Read] {
            let options = OpenOptions {
                io,
                ..Default::default()
            };
            let Voxels::Random(random) = open(&path, &options).unwrap().voxels else {
                panic!("a plain file is read at random")
            };
            for (name, boxes) in [("planes", false), ("boxes", true)] {
                let base = resident_mib();
                let start = cpu_seconds();
                let (mut sum, mut some, mut peak) = (0_u64, Vec::new(), 0.0_f64);
                for z in (0..EDGE).step_by(16) {
                    let add = |bytes: &[u8]| {
                        bytes
                            .chunks_exact(8)
                            .map(|c| u64::from_le_bytes(c.try_into().unwrap()))
                            .fold(0_u64, u64::wrapping_add)
                    };
                    let direct = if boxes {
                        None
                    } else {
                        random.planes(z, 16).unwrap()
                    };
                    if let Some(bytes) = direct {
                        sum = sum.wrapping_add(add(bytes));
                        random.check().unwrap();
                    } else {
                        let region = Region {
                            origin: [0, 0, z],
                            size: [EDGE, EDGE, 16],
                        };
                        random.read_box(&region, &mut some).unwrap();
                        sum = sum.wrapping_add(add(&some));
                    }
                    peak = peak.max(resident_mib() - base);
                    random.release(z + 16);
                }
                std::hint::black_box(sum);
                report(&format!("{what} {io:?} {name}"), start, peak);
            }
        }
    }
}

/// Bytes that are not zero: something that looks at every byte.
fn count(bytes: &[u8]) -> usize {
    bytes
        .chunks(255)
        .map(|run| usize::from(run.iter().fold(0_u8, |n, b| n + u8::from(*b != 0))))
        .sum()
}

/// Plain files, mapped and read at offsets, against `read(2)` of the same bytes, in wall time from
/// the page cache. All look at every byte.
#[cfg(unix)]
#[test]
#[ignore = "figures, not a check"]
fn speed_of_plain_files_against_a_read() {
    use std::io::Read;
    use std::time::Instant;

    const EDGE: usize = 640;
    const ROUNDS: usize = 9;
    let folder = Folder::new();
    let voxels = scan(EDGE as u64);
    let nrrd = format!(
        "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {EDGE} {EDGE} {EDGE}\nencoding: raw\n\n"
    );
    let mut mrc = vec![0; 1024];
    for (word, value) in [
        (0, EDGE as i32),
        (1, EDGE as i32),
        (2, EDGE as i32),
        (3, 0),
        (7, EDGE as i32),
        (8, EDGE as i32),
        (9, EDGE as i32),
        (16, 1),
        (17, 2),
        (18, 3),
    ] {
        mrc[4 * word..4 * word + 4].copy_from_slice(&i32::to_le_bytes(value));
    }
    mrc[208..212].copy_from_slice(b"MAP ");
    mrc[212..214].copy_from_slice(&[0x44, 0x44]);
    let nifti = crate::support::Nifti::new(1, [EDGE as u64; 3], DType::little(VoxelType::U8));
    let files = [
        ("raw", voxels.clone()),
        ("nifti", nifti.file(&voxels)),
        ("mrc", [&mrc[..], &voxels].concat()),
        ("nrrd", [nrrd.as_bytes(), &voxels].concat()),
    ];
    let raw = crate::support::raw_options([EDGE as u64; 3], DType::little(VoxelType::U8));
    let median = |mut times: Vec<f64>| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    };
    for (name, bytes) in &files {
        let path = folder.write(name, bytes);
        let mut times = [const { Vec::new() }; 3];
        for _ in 0..ROUNDS {
            let begin = Instant::now();
            let mut file = std::fs::File::open(&path).unwrap();
            let mut buffer = vec![0; 4 << 20];
            let mut expected = 0;
            loop {
                let n = file.read(&mut buffer).unwrap();
                if n == 0 {
                    break;
                }
                expected += count(&buffer[..n]);
            }
            times[0].push(begin.elapsed().as_secs_f64());
            for (times, io) in times[1..].iter_mut().zip([IoMode::Map, IoMode::Read]) {
                let base = if *name == "raw" {
                    raw.clone()
                } else {
                    OpenOptions::default()
                };
                let begin = Instant::now();
                let volume = open(&path, &OpenOptions { io, ..base }).unwrap();
                let depth = volume.header.dims[2];
                let Voxels::Random(voxels) = volume.voxels else {
                    panic!("{name} runs forward only");
                };
                let (mut found, mut buffer) = (0, Vec::new());
                for z in (0..depth).step_by(10) {
                    let planes = 10.min(depth - z);
                    if let Some(bytes) = voxels.planes(z, planes).unwrap() {
                        found += count(bytes);
                    } else {
                        let region = Region {
                            origin: [0, 0, z],
                            size: [EDGE as u64, EDGE as u64, planes],
                        };
                        voxels.read_box(&region, &mut buffer).unwrap();
                        found += count(&buffer);
                    }
                    voxels.release(z + planes);
                }
                voxels.check().unwrap();
                times.push(begin.elapsed().as_secs_f64());
                // The header is looked at by the read alone.
                assert!(found.abs_diff(expected) <= 2048);
            }
        }
        let [read, mapped, offsets] = times.map(median);
        println!(
            "{name:<6} read(2) {:.3} s, mapped {:.2}, at offsets {:.2} times as long",
            read,
            mapped / read,
            offsets / read
        );
    }
}
