//! Damaged copies of the fixtures: no panic, no hang, no memory beyond the file and some slack.
//!
//! `CURVOX_MUTATIONS` says how many of each file; a long run takes 100 000 for each format. A
//! failure prints the file, and the number of the mutation, which is all that makes it.

use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use curvox_formats::{Error, OpenOptions, Region, Volume, Voxels, open, open_stream};

use crate::fixtures::{self, Fixture};
use crate::support::peak_bytes;

/// Random numbers, the same each time (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
}

/// Numbers that headers are not ready for.
const ODD: [u64; 12] = [
    0,
    1,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x7fff_ffff_ffff_ffff,
    0x8000_0000_0000_0000,
    u64::MAX,
];

/// Words that text headers are not ready for.
const WORDS: [&str; 8] = [
    "0",
    "-1",
    "1e300",
    "nan",
    "4294967296",
    "9223372036854775807",
    "99999999999999999999",
    "../x",
];

fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    let changes = 1 + random.below(4);
    for _ in 0..changes {
        if bytes.is_empty() {
            return;
        }
        // Headers are at the front, mostly.
        let reach = match random.below(3) {
            0 => bytes.len(),
            1 => bytes.len().min(1024),
            _ => bytes.len().min(128),
        };
        let at = random.below(reach);
        let run = 1 + random.below(16);
        let end = (at + run).min(bytes.len());
        match random.below(12) {
            0 | 1 => bytes[at] ^= 1 << random.below(8),
            2 | 3 => bytes[at] = random.next() as u8,
            4 => bytes.truncate(at),
            5 => drop(bytes.drain(at..end)),
            6 => {
                let noise: Vec<u8> = (0..run).map(|_| random.next() as u8).collect();
                bytes.splice(at..at, noise);
            }
            7 | 8 => {
                let number = ODD[random.below(ODD.len())];
                let width = [1, 2, 4, 8][random.below(4)];
                let little = number.to_le_bytes();
                for (i, byte) in little.iter().take(width).enumerate() {
                    let to = if random.0 & 1 == 0 { i } else { width - 1 - i };
                    if let Some(place) = bytes.get_mut(at + to) {
                        *place = *byte;
                    }
                }
            }
            9 => {
                let from = random.below(bytes.len());
                let piece: Vec<u8> = bytes[from..(from + run).min(bytes.len())].to_vec();
                for (to, byte) in piece.into_iter().enumerate() {
                    if let Some(place) = bytes.get_mut(at + to) {
                        *place = byte;
                    }
                }
            }
            _ => {
                // A number in a text, in place of another.
                let digits: Vec<usize> =
                    (0..reach).filter(|&i| bytes[i].is_ascii_digit()).collect();
                if let Some(&at) = digits.get(random.below(digits.len())) {
                    let word = WORDS[random.below(WORDS.len())];
                    bytes.splice(at..at + 1, word.bytes());
                }
            }
        }
    }
}

/// Reads a little of a volume, whatever size it claims.
fn look_into(opened: Result<Volume, Error>) -> Result<(), Error> {
    /// Planes beyond this are too large to be read whole here.
    const PLANE_BYTES: u64 = 1 << 20;
    let volume = opened?;
    let header = volume.header.clone();
    let Voxels::Random(voxels) = &volume.voxels else {
        let mut planes = volume.into_forward();
        let mut some = Vec::new();
        for _ in 0..16 {
            if header.plane_bytes().is_some_and(|n| n > PLANE_BYTES)
                || planes.read_planes(1, &mut some)? == 0
            {
                break;
            }
        }
        return planes.finish().map(|_| ());
    };
    let mut out = Vec::new();
    for part in 0..3 {
        let size = header.dims.map(|n| n.min(16));
        let origin = [0, 1, 2].map(|a| (header.dims[a] - size[a]) / 2 * part);
        voxels.read_box(&Region { origin, size }, &mut out)?;
        voxels.uniform(&Region { origin, size });
    }
    if header.plane_bytes().is_some_and(|n| n <= PLANE_BYTES) {
        for z in (0..header.dims[2]).take(16) {
            let [x, y, _] = header.dims;
            let region = Region {
                origin: [0, 0, z],
                size: [x, y, 1],
            };
            voxels.read_box(&region, &mut out)?;
        }
    }
    voxels.check()
}

/// Ends the test binary if one file takes far too long, for a test cannot be interrupted.
fn watch(now: &'static AtomicU64) {
    std::thread::spawn(move || {
        let mut last = (now.load(Ordering::Relaxed), Instant::now());
        loop {
            std::thread::sleep(Duration::from_secs(1));
            let number = now.load(Ordering::Relaxed);
            if number == u64::MAX {
                return;
            }
            if number != last.0 {
                last = (number, Instant::now());
            } else if last.1.elapsed() > Duration::from_secs(60) {
                let _ = writeln!(std::io::stderr(), "mutation {number} hangs");
                std::process::abort();
            }
        }
    });
}

/// Files of a fixture: itself, or those of its folder.
fn files(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_path_buf()];
    }
    let mut found = Vec::new();
    let mut folders = vec![path.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// A copy of a fixture, in which one file is changed at a time.
struct Copy {
    folder: tempfile::TempDir,
    /// What is opened.
    target: PathBuf,
    /// Each file: its place, its bytes.
    files: Vec<(PathBuf, Vec<u8>)>,
    bytes: usize,
}

impl Copy {
    fn of(fixture: &Fixture) -> Self {
        let folder = tempfile::tempdir().unwrap();
        // A header may name files beside it, so they come along.
        let base = fixture.path.parent().unwrap();
        let mut own = files(&fixture.path);
        let beside = fixture.entry["files"].as_array();
        for name in beside.into_iter().flatten() {
            own.push(base.join(name.as_str().unwrap()));
        }
        let files: Vec<_> = own
            .iter()
            .map(|path| {
                let to = folder.path().join(path.strip_prefix(base).unwrap());
                std::fs::create_dir_all(to.parent().unwrap()).unwrap();
                let bytes = std::fs::read(path).unwrap();
                std::fs::write(&to, &bytes).unwrap();
                (to, bytes)
            })
            .collect();
        Self {
            target: folder.path().join(fixture.path.file_name().unwrap()),
            bytes: files.iter().map(|(_, bytes)| bytes.len()).sum(),
            folder,
            files,
        }
    }
}

/// One mutation of a fixture; a message says what rule it broke.
fn run_one(copy: &Copy, fixture: &Fixture, number: u64) -> Result<(), String> {
    const SLACK_BYTES: usize = 64 << 20;
    const MOST: Duration = Duration::from_secs(2);
    let mut random = Random(number);
    let (place, original) = &copy.files[random.below(copy.files.len())];
    let mut bytes = original.clone();
    mutate(&mut bytes, &mut random);
    std::fs::write(place, &bytes).unwrap();
    let limit = copy.bytes.max(bytes.len()) + SLACK_BYTES;
    let options = OpenOptions {
        spool_limit_bytes: 1 << 20,
        ..fixture.options()
    };
    let begin = Instant::now();
    let (result, peak) = peak_bytes(|| {
        catch_unwind(AssertUnwindSafe(|| {
            // Errors are fine, and so is a file that is still read.
            let _ = look_into(open(&copy.target, &options));
            if copy.files.len() == 1 && copy.target.is_file() {
                let stream = Box::new(std::io::Cursor::new(bytes.clone()));
                let _ = look_into(open_stream(stream, "pipe", &options));
            }
        }))
    });
    let took = begin.elapsed();
    std::fs::write(place, original).unwrap();
    if result.is_err() {
        Err("panicked".into())
    } else if took > MOST {
        Err(format!("took {took:?}"))
    } else if peak > limit {
        Err(format!("held {peak} bytes, at most {limit} expected"))
    } else {
        Ok(())
    }
}

#[test]
fn damaged_files_are_errors_and_nothing_worse() {
    static NOW: AtomicU64 = AtomicU64::new(0);
    let count: u64 = std::env::var("CURVOX_MUTATIONS")
        .map(|text| text.parse().expect("CURVOX_MUTATIONS is a number"))
        .unwrap_or(60);
    let only = std::env::var("CURVOX_MUTATED").unwrap_or_default();
    watch(&NOW);
    let mut failures = Vec::new();
    let mut done = 0_u64;
    for fixture in fixtures::all() {
        if fixture.error().is_some() || !fixture.name().contains(&only) {
            continue;
        }
        let copy = Copy::of(&fixture);
        assert!(copy.folder.path().is_dir());
        for number in 0..count {
            NOW.store(done, Ordering::Relaxed);
            if let Err(rule) = run_one(&copy, &fixture, number) {
                failures.push(format!("{}, mutation {number}: {rule}", fixture.name()));
            }
            done += 1;
        }
    }
    NOW.store(u64::MAX, Ordering::Relaxed);
    println!("{done} damaged files");
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
