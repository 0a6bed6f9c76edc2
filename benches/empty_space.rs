//! How long does empty space take, by type of voxel, against a copy of the same bytes in memory?
//!
//! A file of 1 GiB without an inside voxel is run over, mapped and in the page cache, with one worker.
//! Processor time of all stages is compared with that of a copy of 1 GiB from one buffer that
//! is in memory to another. Each is the least of some tries.

use std::io::Write;
use std::sync::atomic::AtomicBool;

use curvox::lattice::Lattice;
use curvox::pipeline::{Access, Progress, Settings, Source, run};
use curvox::volume::{Binarizer, Criterion};
use curvox_formats::{DType, OpenOptions, RawLayout, Unit, VoxelType, open};

const BYTES: usize = 1 << 30;
const TRIES: usize = 5;

fn main() {
    let (from, mut to) = (vec![1u8; BYTES], vec![2u8; BYTES]);
    let copy = least(|| {
        let before = clock();
        to.copy_from_slice(std::hint::black_box(&from));
        std::hint::black_box(&mut to);
        clock() - before
    });
    drop((from, to));
    println!("copy       {:6.2} GB/s", speed(copy));
    let mut file = tempfile::NamedTempFile::with_suffix(".raw").unwrap();
    let zeros = vec![0; 1 << 20];
    for _ in 0..BYTES / zeros.len() {
        file.write_all(&zeros).unwrap();
    }
    file.flush().unwrap();
    for (voxel, name) in [
        (VoxelType::U8, "u8"),
        (VoxelType::U16, "u16"),
        (VoxelType::F32, "f32"),
    ] {
        let dims = [2048, 1024, (BYTES / (2048 * 1024 * voxel.bytes())) as u64];
        let options = OpenOptions {
            raw: Some(RawLayout {
                dims,
                dtype: DType::little(voxel),
                spacing: None,
                unit: Unit::Unknown,
                skip: 0,
            }),
            ..Default::default()
        };
        let settings = Settings {
            threads: 1,
            ..Settings::new(Lattice::new(dims, [1.0; 3], false).unwrap())
        };
        let seconds = least(|| {
            let volume = open(file.path(), &options).unwrap();
            let header = &volume.header;
            let criterion = Criterion::AtLeast(1i128.into());
            let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, None);
            let plan = settings.plan(&Access::of(&volume), 0).unwrap();
            let progress = Progress {
                measured: true,
                ..Progress::default()
            };
            let (source, stop) = (Source { volume, binarizer }, AtomicBool::new(false));
            let outcome = run(source, &settings, &plan, &mut [], &progress, &stop).unwrap();
            let stages = outcome.stats.unwrap().stages;
            stages.iter().map(|stage| stage.cpu_seconds).sum()
        });
        let times = seconds / copy;
        println!("{name:<10} {:6.2} GB/s, {times:.2} copies", speed(seconds));
    }
}

/// Processor time of this process, in seconds.
#[cfg(unix)]
fn clock() -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `time` is a timespec that the call fills.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Time that passed, in seconds, for want of a better clock.
#[cfg(not(unix))]
fn clock() -> f64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START
        .get_or_init(std::time::Instant::now)
        .elapsed()
        .as_secs_f64()
}

fn least(mut once: impl FnMut() -> f64) -> f64 {
    (0..TRIES).map(|_| once()).fold(f64::INFINITY, f64::min)
}

fn speed(seconds: f64) -> f64 {
    BYTES as f64 * 1e-9 / seconds
}
