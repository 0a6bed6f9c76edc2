//! The command when something fails around it: outputs that cannot be written, inputs that change
//! or end, pipes that break, signals. Needs no data but what it makes.

use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use parquet::file::reader::{FileReader, SerializedFileReader};

use crate::command::{
    Ended, Running, assert_not_complete, curvox, feed, files, finished, record, results, shell,
};

/// Exit codes.
const DONE: i32 = 0;
const FAILED: i32 = 1;
const USAGE: i32 = 2;
const BAD_INPUT: i32 = 3;
const INTERRUPTED: i32 = 130;

/// Edge of a plane of the volumes below.
const EDGE: usize = 64;

/// A raw volume of bytes: rods of square section along z, a plane of it.
fn plane(z: usize) -> Vec<u8> {
    let mut voxels = vec![0; EDGE * EDGE];
    if z % 32 == 31 {
        return voxels;
    }
    for (i, voxel) in voxels.iter_mut().enumerate() {
        let [x, y] = [i % EDGE, i / EDGE];
        *voxel = u8::from(x % 8 < 4 && y % 8 < 4);
    }
    voxels
}

/// Many surfels in a file of so many planes.
fn rods(folder: &Path, planes: usize) -> PathBuf {
    let path = folder.join("rods.raw");
    let voxels: Vec<u8> = (0..planes).flat_map(plane).collect();
    fs::write(&path, voxels).unwrap();
    path
}

/// A file without a surfel, of holes only, with planes of a mebibyte.
fn holes(folder: &Path, planes: u64) -> PathBuf {
    let path = folder.join("holes.raw");
    File::create(&path).unwrap().set_len(planes << 20).unwrap();
    path
}

/// The options for a raw volume.
fn raw(command: &mut Command, edge: usize, planes: u64) -> &mut Command {
    command
        .args(["--dtype", "u8", "--threshold", "1", "--memory", "256MiB"])
        .arg(format!("--dims={edge},{edge},{planes}"))
}

/// A run on rods.
fn run_on_rods(input: &Path, planes: u64) -> Command {
    let mut command = curvox();
    raw(command.arg("run").arg(input), EDGE, planes);
    command
}

#[test]
fn an_output_that_cannot_be_written_is_named_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let input = rods(folder.path(), 40);
    let file = folder.path().join("file");
    fs::write(&file, "precious").unwrap();
    for (output, code) in [
        // A file where a folder is needed.
        (file.join("out"), FAILED),
        (file.join("out.csv"), FAILED),
        (file.clone(), FAILED),
        (folder.path().join("missing/out.parquet"), FAILED),
        // A file system that takes no files, even of root.
        (PathBuf::from("/proc/curvox"), FAILED),
        (PathBuf::from("/proc/curvox.csv"), FAILED),
        // A directory of something else.
        (folder.path().to_owned(), FAILED),
        // A format that is not written.
        (folder.path().join("out.vtk"), USAGE),
    ] {
        let ended = finished(run_on_rods(&input, 40).arg("-o").arg(&output)).expect(code);
        println!("{code} {}", ended.stderr.trim_end());
        assert!(ended.message().contains(output.to_str().unwrap()));
        assert!(ended.stdout.is_empty());
    }
    // A message that cannot be written is no reason to fail.
    assert_eq!(fs::read(&file).unwrap(), b"precious");
    let left = files(folder.path());
    assert_eq!(left, [Path::new("file"), Path::new("rods.raw")]);
}

#[test]
fn a_full_device_is_an_error_for_tables_and_summaries_but_not_for_messages() {
    if !Path::new("/dev/full").exists() {
        println!("SKIPPED: full devices: there is no /dev/full");
        return;
    }
    let full = || OpenOptions::new().write(true).open("/dev/full").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let input = rods(folder.path(), 40);
    let of = |script: &str, options: &[&str]| {
        let mut command = shell(script);
        raw(command.arg("run").arg(&input), EDGE, 40).args(options);
        finished(&mut command)
    };
    for options in [&["-o", "-"][..], &["-o", "-", "--to", "arrow"]] {
        let ended = of(r#"exec "$CURVOX" "$@" > /dev/full"#, options).expect(FAILED);
        println!("{}", ended.stderr.trim_end());
        assert!(ended.message().contains("standard output"));
    }
    let ended = of(r#"exec "$CURVOX" "$@""#, &["-o", "/dev/full"]).expect(FAILED);
    println!("{}", ended.stderr.trim_end());
    assert!(ended.message().contains("/dev/full"));

    // The results are there, the summary was not delivered.
    let output = folder.path().join("json");
    let output = output.to_str().unwrap();
    let ended = of(
        r#"exec "$CURVOX" "$@" > /dev/full"#,
        &["--json", "-o", output],
    );
    let ended = ended.expect(FAILED);
    println!("{}", ended.stderr.trim_end());
    assert_eq!(record(Path::new(output))["state"], "complete");

    // Nobody hears the report; the results are the same.
    let output = folder.path().join("deaf");
    let mut command = run_on_rods(&input, 40);
    command.arg("-o").arg(&output).stderr(full());
    let status = command.stdin(Stdio::null()).status().unwrap();
    assert_eq!(status.code(), Some(DONE));
    results(&output);
}

/// Checks what is left where there was no room for more.
fn check_full_disk(ended: Ended, output: &Path) {
    let ended = ended.expect(FAILED);
    let message = ended.message();
    println!("{message}");
    assert!(message.contains(output.to_str().unwrap()), "{message}");
    let is_file = output.extension().is_some();
    if is_file {
        assert!(!output.exists());
    } else {
        assert_not_complete(output);
        check_parts(output);
    }
    let around = output.parent().unwrap();
    for file in files(around) {
        assert!(!file.to_str().unwrap().ends_with(".partial"), "{file:?}");
    }
}

/// Checks that each part on record can be read, and that there are no others; gives their rows.
fn check_parts(output: &Path) -> u64 {
    let folder = output.join("surfels");
    if !folder.exists() {
        return 0;
    }
    let record = record(output);
    let parts = record["parts"].as_array().unwrap();
    let mut on_record = Vec::new();
    let mut sum = 0;
    for part in parts {
        let Some(name) = part["file"].as_str() else {
            continue;
        };
        on_record.push(PathBuf::from(name));
        let file = File::open(folder.join(name)).unwrap();
        let reader = SerializedFileReader::new(file).unwrap();
        let rows = reader.get_row_iter(None).unwrap();
        let rows = rows.inspect(|row| assert!(row.is_ok())).count() as u64;
        assert_eq!(Some(rows), part["rows"].as_u64());
        sum += rows;
    }
    let found = files(&folder);
    // A part may be complete and not on record: the record had no room.
    for name in &on_record {
        assert!(found.contains(name), "{name:?} is on record and missing");
    }
    // Hidden files were left by a kill, and are no part.
    let hidden = |name: &PathBuf| name.to_str().unwrap().starts_with('.');
    for name in found.iter().filter(|name| !hidden(name)) {
        let file = File::open(folder.join(name)).unwrap();
        SerializedFileReader::new(file).unwrap();
    }
    sum
}

/// The outputs that fill a disk, by their names.
const OUTPUTS: [(&str, &[&str]); 4] = [
    ("out", &[]),
    ("sliced", &["--slices", "all"]),
    ("out.csv", &[]),
    ("out.parquet", &[]),
];

#[test]
fn files_that_may_not_grow_end_the_run_without_debris() {
    let folder = tempfile::tempdir().unwrap();
    let planes = 300;
    let input = rods(folder.path(), planes as usize);
    for (name, options) in OUTPUTS {
        let place = folder.path().join(format!("at-{name}"));
        fs::create_dir(&place).unwrap();
        let output = place.join(name);
        // At most 64 blocks of 512 or 1024 bytes; beyond, an error instead of a signal.
        let mut command = shell(r#"trap "" XFSZ; ulimit -f 64 && exec "$CURVOX" "$@""#);
        raw(command.arg("run").arg(&input), EDGE, planes).args(options);
        check_full_disk(finished(command.arg("-o").arg(&output)), &output);
    }
}

/// A small disk, as long as it lives.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// `None` where mounting is not allowed.
    fn mount(at: &Path) -> Option<Self> {
        fs::create_dir(at).unwrap();
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", "size=256k", "tmpfs"]);
        let mounted = mount.arg(at).stderr(Stdio::null()).status();
        mounted
            .is_ok_and(|s| s.success())
            .then(|| Self(at.to_owned()))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_full_disk_ends_the_run_without_debris() {
    let folder = tempfile::tempdir().unwrap();
    let planes = 300;
    let input = rods(folder.path(), planes as usize);
    for (name, options) in OUTPUTS {
        let place = folder.path().join(format!("disk-{name}"));
        let Some(disk) = SmallDisk::mount(&place) else {
            println!("SKIPPED: full disk: mounting a tmpfs is not allowed");
            return;
        };
        let output = disk.0.join(name);
        let mut command = run_on_rods(&input, planes);
        let ended = finished(command.args(options).arg("-o").arg(&output));
        check_full_disk(ended, &output);
    }
}

/// Starts a run on holes and waits until it is at work.
fn started_on_holes(input: &Path, planes: u64, io: &str, output: &Path) -> Running {
    let mut command = curvox();
    raw(command.arg("run").arg(input), 1024, planes);
    command.args(["--io", io, "-o"]).arg(output);
    let mut run = Running::start(command.stdin(Stdio::null()));
    assert!(run.wait_until(|| output.join("run.json").exists()));
    run
}

#[test]
fn an_input_that_shrinks_under_the_run_is_an_error_and_no_crash() {
    let folder = tempfile::tempdir().unwrap();
    let planes = 32 << 10;
    for io in ["map", "read"] {
        let input = holes(folder.path(), planes);
        let output = folder.path().join(io);
        let mut run = started_on_holes(&input, planes, io, &output);
        std::thread::sleep(Duration::from_millis(50));
        assert!(run.is_running(), "the file is too small to be caught");
        OpenOptions::new()
            .write(true)
            .open(&input)
            .unwrap()
            .set_len(1 << 20)
            .unwrap();
        let ended = run.end();
        println!("{io}: {}", ended.stderr.trim_end());
        assert_eq!(ended.signal, None, "{ended:?}");
        let ended = ended.expect(BAD_INPUT);
        assert!(ended.message().contains(input.to_str().unwrap()));
        assert_not_complete(&output);
        assert_eq!(record(&output)["state"], "failed");
        assert_eq!(record(&output)["message"].as_str(), Some(ended.message()));
    }
}

#[test]
fn an_input_that_is_written_to_under_the_run_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let planes = 2 << 10;
    for io in ["map", "read"] {
        let input = holes(folder.path(), planes);
        let output = folder.path().join(io);
        // Times of files may have steps of some milliseconds.
        std::thread::sleep(Duration::from_millis(50));
        let mut run = started_on_holes(&input, planes, io, &output);
        let mut file = OpenOptions::new().write(true).open(&input).unwrap();
        file.write_all(&[1; 5]).unwrap();
        println!("{io}: at work when it was written to: {}", run.is_running());
        let ended = run.end().expect(BAD_INPUT);
        println!("{}", ended.message());
        assert!(ended.message().contains(input.to_str().unwrap()));
        assert_not_complete(&output);
    }
}

#[test]
fn an_input_that_is_removed_under_the_run_is_read_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let planes = 1 << 10;
    for io in ["map", "read"] {
        let input = holes(folder.path(), planes);
        let output = folder.path().join(io);
        let mut run = started_on_holes(&input, planes, io, &output);
        fs::remove_file(&input).unwrap();
        println!("{io}: at work when it was removed: {}", run.is_running());
        let ended = run.end().expect(DONE);
        println!("{}", ended.stderr.trim_end());
        results(&output);
    }
}

#[test]
fn standard_input_that_ends_early_says_where() {
    let folder = tempfile::tempdir().unwrap();
    for (sent, rest) in [(0, 0), (0, 100), (33, 0), (70, 2000), (299, 4095)] {
        let output = folder.path().join(format!("out{sent}-{rest}"));
        let mut command = run_on_rods(Path::new("-"), 300);
        command.arg("-o").arg(&output).stdin(Stdio::piped());
        let mut run = Running::start(&mut command);
        let mut stdin = run.stdin();
        for z in 0..sent {
            assert!(feed(&mut stdin, &plane(z)));
        }
        let _ = feed(&mut stdin, &plane(sent)[..rest]);
        drop(stdin);
        let ended = run.end().expect(BAD_INPUT);
        let message = ended.message();
        println!("{message}");
        assert!(message.contains("standard input"), "{message}");
        if sent > 0 {
            let [sent, all] = [sent, 300].map(|n| format!("{n}"));
            assert!(message.contains(&sent), "{message}");
            assert!(message.contains(&all), "{message}");
        }
        assert_not_complete(&output);
        if output.exists() {
            check_parts(&output);
        }
    }
    // Longer than it should be: read, with a warning.
    let output = folder.path().join("longer");
    let mut command = run_on_rods(Path::new("-"), 300);
    command.arg("-o").arg(&output).stdin(Stdio::piped());
    let mut run = Running::start(&mut command);
    let mut stdin = run.stdin();
    for z in 0..301 {
        feed(&mut stdin, &plane(z));
    }
    drop(stdin);
    let ended = run.end().expect(DONE);
    println!("{}", ended.stderr.trim_end());
    assert!(ended.stderr.contains("4096 bytes follow"), "{ended:?}");
}

/// A run on a pipe that was given enough for its first part to be there, and has more to come.
fn in_the_middle(output: &Path, planes: u64) -> (Running, std::process::ChildStdin) {
    let mut command = run_on_rods(Path::new("-"), planes);
    command.arg("-o").arg(output).stdin(Stdio::piped());
    // Slabs are as thick as memory allows; parts must come before all is read.
    command.args(["--brick", "16", "--threads", "2"]);
    let mut run = Running::start(&mut command);
    let mut stdin = run.stdin();
    let part = output.join("surfels/part-00001.parquet");
    let mut z = 0;
    while !part.exists() {
        assert!((z as u64) < planes, "no part before the end of the input");
        assert!(feed(&mut stdin, &plane(z)), "gone");
        z += 1;
        if z % 64 == 0 {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    println!("the second part was there after {z} planes");
    assert!(run.is_running());
    (run, stdin)
}

#[test]
fn an_interrupted_run_leaves_whole_parts_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let planes = 4000;
    for signal in ["INT", "TERM"] {
        let output = folder.path().join(signal);
        let (run, mut stdin) = in_the_middle(&output, planes);
        run.signal(signal);
        // The other end of the pipe goes on for a while, as if it had not heard.
        let other_end = std::thread::spawn(move || {
            let mut z = 0;
            while feed(&mut stdin, &plane(z)) {
                z += 1;
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        let ended = run.end();
        other_end.join().unwrap();
        println!(
            "{signal}: {:.1} s, {}",
            ended.seconds,
            ended.stderr.trim_end()
        );
        let ended = ended.expect(INTERRUPTED);
        assert!(ended.seconds < 15.0);
        assert!(ended.stderr.lines().count() <= 1, "{ended:?}");
        assert_not_complete(&output);
        let rows = check_parts(&output);
        println!("{rows} rows in whole parts");
        assert!(rows > 0);
    }
}

#[test]
fn an_interrupted_run_leaves_no_part_of_a_single_file() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["out.csv", "out.parquet"] {
        let output = folder.path().join(name);
        let mut command = run_on_rods(Path::new("-"), 4000);
        command.arg("-o").arg(&output).stdin(Stdio::piped());
        command.args(["--brick", "16"]);
        let mut run = Running::start(&mut command);
        let mut stdin = run.stdin();
        for z in 0..200 {
            feed(&mut stdin, &plane(z));
        }
        assert!(run.wait_until(|| !files(folder.path()).is_empty()));
        run.signal("INT");
        // A pipe that gives nothing more would be waited for.
        drop(stdin);
        run.end().expect(INTERRUPTED);
        assert_eq!(files(folder.path()), [""; 0].map(Path::new));
    }
}

#[test]
fn a_killed_run_leaves_whole_parts_and_can_be_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    let (run, stdin) = in_the_middle(&output, 4000);
    run.signal("KILL");
    let ended = run.end();
    drop(stdin);
    assert_eq!(ended.signal, Some(9));
    assert_eq!(record(&output)["state"], "running");
    assert!(check_parts(&output) > 0);
    // What is left is recognised, and removed when asked to.
    let input = rods(folder.path(), 40);
    let of = |options: &[&str]| {
        let mut command = run_on_rods(&input, 40);
        finished(command.arg("-o").arg(&output).args(options))
    };
    let refused = of(&[]).expect(FAILED);
    println!("{}", refused.message());
    assert!(refused.message().contains("--overwrite"));
    of(&["--overwrite"]).expect(DONE);
    results(&output);
    let debris = files(&output)
        .into_iter()
        .filter(|file| file.to_str().unwrap().ends_with(".partial"));
    assert_eq!(debris.count(), 0);
}

#[test]
fn a_reader_that_goes_away_ends_the_run_quietly() {
    let folder = tempfile::tempdir().unwrap();
    let planes = 600;
    let input = rods(folder.path(), planes as usize);
    for options in [
        &["-o", "-"][..],
        &["-o", "-", "--to", "arrow"],
        &["-o", "-", "--json"],
    ] {
        let mut command = run_on_rods(&input, planes);
        command.args(options).stdin(Stdio::null());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut reader = BufReader::new(child.stdout.take().unwrap());
        let mut line = Vec::new();
        reader.read_until(b'\n', &mut line).unwrap();
        drop(reader);
        let ended = Running::of(child).end();
        println!("{options:?}: {:?} {}", ended.code, ended.stderr.trim_end());
        let ended = ended.expect(DONE);
        assert!(!ended.stderr.contains("error"), "{ended:?}");
        assert!(!ended.stderr.contains("roken pipe"), "{ended:?}");
    }
    // The same in a shell, where the other end is `head`.
    let mut command = shell(r#""$CURVOX" "$@" -o - | head -n 1"#);
    raw(command.arg("run").arg(&input), EDGE, planes);
    let ended = finished(&mut command).expect(DONE);
    assert!(ended.stdout.starts_with(b"kx,ky,kz,side,"), "{ended:?}");
    assert_eq!(ended.stdout.iter().filter(|&&b| b == b'\n').count(), 1);
    assert_eq!(ended.stderr, "");
}

#[test]
fn an_existing_output_is_refused_and_replaced_only_when_asked_to() {
    let folder = tempfile::tempdir().unwrap();
    let input = rods(folder.path(), 200);
    for name in ["out", "out.csv", "out.parquet"] {
        let output = folder.path().join(name);
        let of = |planes: u64, options: &[&str]| {
            let mut command = run_on_rods(&input, planes);
            finished(command.arg("-o").arg(&output).args(options))
        };
        let all_bytes = || {
            if output.is_dir() {
                let files = files(&output).into_iter();
                files
                    .map(|file| (file.clone(), fs::read(output.join(file)).unwrap()))
                    .collect()
            } else {
                vec![(output.clone(), fs::read(&output).unwrap())]
            }
        };
        of(200, &[]).expect(DONE);
        let before = all_bytes();
        let ended = of(70, &[]).expect(FAILED);
        println!("{}", ended.message());
        assert!(ended.message().contains(output.to_str().unwrap()));
        assert!(ended.message().contains("--overwrite"));
        assert!(all_bytes() == before, "{name} was changed");
        of(70, &["--overwrite"]).expect(DONE);
        let after = all_bytes();
        assert!(after != before);
        // As if nothing had been there.
        if name == "out" {
            let fresh = folder.path().join("fresh");
            let mut command = run_on_rods(&input, 70);
            finished(command.arg("-o").arg(&fresh)).expect(DONE);
            assert!(results(&output) == results(&fresh));
            assert_eq!(files(&output), files(&fresh));
        }
    }
    // What curvox did not write is not removed, whatever is asked.
    let other = folder.path().join("other");
    fs::create_dir(&other).unwrap();
    let mut file = File::create(other.join("thesis.txt")).unwrap();
    file.write_all(b"years").unwrap();
    let mut command = run_on_rods(&input, 200);
    let ended = finished(command.arg("--overwrite").arg("-o").arg(&other)).expect(FAILED);
    println!("{}", ended.message());
    assert_eq!(files(&other), [Path::new("thesis.txt")]);
}
