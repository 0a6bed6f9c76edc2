use std::ffi::OsStr;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

/// What goes wrong, and the exit code it gives.
mod exits;
/// `CURVOX_SIMD`.
mod levels;
/// `curvox mesh`.
mod meshes;
/// Normals given in a table, or made of grey values.
mod normals;
/// Outputs of `run`: a directory, a file, a stream.
mod outputs;
/// `--radius auto`, the default radius and error bars.
mod radius;
/// `run --stats`.
mod stats;
/// What `info`, `plan`, `completions` and `man` tell.
mod telling;
/// Units of lengths, thresholds, conventions of the numbers.
mod values;
/// Volumes that `noise` and `shape` write.
mod volumes;

/// The binary, with its output caught.
pub(crate) struct Curvox {
    command: Command,
    input: Vec<u8>,
}

/// How it ended.
pub(crate) struct Ended {
    pub(crate) code: i32,
    pub(crate) out: Vec<u8>,
    pub(crate) err: String,
}

pub(crate) fn curvox<S: AsRef<OsStr>>(arguments: &[S]) -> Curvox {
    let mut command = Command::new(env!("CARGO_BIN_EXE_curvox"));
    command.args(arguments);
    Curvox {
        command,
        input: Vec::new(),
    }
}

impl Curvox {
    pub(crate) fn input(mut self, bytes: &[u8]) -> Self {
        self.input = bytes.to_vec();
        self
    }

    pub(crate) fn end(mut self) -> Ended {
        let mut child = self
            .command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stdin = child.stdin.take().unwrap();
        let input = self.input;
        // The child may end before it has read all.
        let feed = std::thread::spawn(move || drop(stdin.write_all(&input)));
        let Output {
            status,
            stdout,
            stderr,
        } = child.wait_with_output().unwrap();
        feed.join().unwrap();
        Ended {
            code: status.code().unwrap(),
            out: stdout,
            err: String::from_utf8(stderr).unwrap(),
        }
    }

    /// Its standard output, after a good end.
    pub(crate) fn out(self) -> Vec<u8> {
        let ended = self.end();
        assert_eq!(ended.code, 0, "{}", ended.err);
        ended.out
    }

    /// Its standard output as JSON, after a good end.
    pub(crate) fn json(self) -> serde_json::Value {
        serde_json::from_slice(&self.out()).unwrap()
    }

    /// What it said, after an end with this code; never a panic.
    pub(crate) fn fails(self, code: i32) -> String {
        let ended = self.end();
        assert_eq!(ended.code, code, "{}", ended.err);
        assert!(!ended.err.contains("panicked"), "{}", ended.err);
        ended.err
    }
}

/// A folder with a ball of radius 9 in voxels of 0.5, as `ball.nii`.
pub(crate) struct Place {
    folder: TempDir,
}

impl Place {
    pub(crate) fn new() -> Self {
        Self {
            folder: TempDir::new().unwrap(),
        }
    }

    pub(crate) fn with_ball() -> Self {
        let place = Self::new();
        std::fs::write(place.path("ball.nii"), ball()).unwrap();
        place
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// Names of everything in the folder, sorted.
    pub(crate) fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    pub(crate) fn summary(&self, name: &str) -> serde_json::Value {
        let text = std::fs::read_to_string(self.path(name).join("summary.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    }
}

/// A ball of radius 9 with gridstep 0.5, as NIfTI without a unit.
pub(crate) fn ball() -> Vec<u8> {
    curvox(&["shape", "sphere:radius=9", "--gridstep", "0.5"]).out()
}

pub(crate) fn read(path: &Path) -> Vec<u8> {
    let mut bytes = Vec::new();
    std::fs::File::open(path)
        .unwrap()
        .read_to_end(&mut bytes)
        .unwrap();
    bytes
}
