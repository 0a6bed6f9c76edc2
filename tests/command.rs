//! The built `curvox`, run as a user runs it, and what it left.

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// No run of a test takes longer unless it hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// A command that ended.
#[derive(Debug)]
pub(crate) struct Ended {
    /// Exit code; `None` if a signal ended it.
    pub(crate) code: Option<i32>,
    /// The signal that ended it.
    pub(crate) signal: Option<i32>,
    pub(crate) stdout: Vec<u8>,
    pub(crate) stderr: String,
    pub(crate) seconds: f64,
    /// The most memory it held resident, as last seen; 0 if never.
    pub(crate) peak_bytes: u64,
}

impl Ended {
    /// The one line that says what went wrong.
    pub(crate) fn message(&self) -> &str {
        let line = self.stderr.strip_suffix('\n').unwrap_or(&self.stderr);
        assert!(!line.contains('\n'), "more than one line: {self:?}");
        line.strip_prefix("curvox: ")
            .unwrap_or_else(|| panic!("no message of curvox: {self:?}"))
    }

    /// Checks the exit code, and that nothing panicked or was killed.
    #[track_caller]
    pub(crate) fn expect(self, code: i32) -> Self {
        assert!(!self.stderr.contains("panicked"), "{self:?}");
        assert_eq!(self.code, Some(code), "{self:?}");
        self
    }
}

/// The command line up to the options.
pub(crate) fn curvox() -> Command {
    Command::new(env!("CARGO_BIN_EXE_curvox"))
}

/// A command in `sh`, where `"$CURVOX"` is the program and `"$@"` are its arguments.
pub(crate) fn shell(script: &str) -> Command {
    let mut command = Command::new("sh");
    command.env("CURVOX", env!("CARGO_BIN_EXE_curvox"));
    command.args(["-c", script, "sh"]);
    command
}

/// Runs a command to its end, with nothing on its standard input.
pub(crate) fn finished(command: &mut Command) -> Ended {
    command.stdin(Stdio::null());
    Running::start(command).end()
}

/// Runs a command to its end, with a file as its standard input.
pub(crate) fn fed(command: &mut Command, path: &Path) -> Ended {
    command.stdin(File::open(path).unwrap());
    Running::start(command).end()
}

/// A command at work. Its outputs are collected, unless they are set already.
pub(crate) struct Running {
    child: Child,
    started: Instant,
    collected: [Option<std::thread::JoinHandle<Vec<u8>>>; 2],
    peak_bytes: u64,
}

fn collect(from: impl Read + Send + 'static) -> std::thread::JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let (mut from, mut all) = (from, Vec::new());
        from.read_to_end(&mut all).unwrap();
        all
    })
}

impl Running {
    /// Starts a command whose standard input is as it was set.
    pub(crate) fn start(command: &mut Command) -> Self {
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        Self::of(command.spawn().unwrap())
    }

    /// Takes over a command whose standard output may be read elsewhere.
    pub(crate) fn of(mut child: Child) -> Self {
        let collected = [
            child.stdout.take().map(collect),
            child.stderr.take().map(collect),
        ];
        Running {
            child,
            started: Instant::now(),
            collected,
            peak_bytes: 0,
        }
    }

    pub(crate) fn stdin(&mut self) -> ChildStdin {
        self.child.stdin.take().unwrap()
    }

    /// Sends a signal: `INT`, `TERM`, `KILL`.
    pub(crate) fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args(["-s", name, &id]).status();
        assert!(sent.unwrap().success());
    }

    /// Whether the command is still at work.
    pub(crate) fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Waits until `happened`; false if the command ended before.
    pub(crate) fn wait_until(&mut self, happened: impl Fn() -> bool) -> bool {
        while !happened() {
            if !self.is_running() {
                return false;
            }
            assert!(self.started.elapsed() < PATIENCE, "nothing happened");
            std::thread::sleep(Duration::from_millis(1));
        }
        true
    }

    /// Waits for the end. A command that hangs is killed and fails the test.
    pub(crate) fn end(mut self) -> Ended {
        let status = loop {
            if let Some(peak) = peak_bytes(self.child.id()) {
                self.peak_bytes = self.peak_bytes.max(peak);
            }
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            if self.started.elapsed() > PATIENCE {
                self.child.kill().unwrap();
                panic!("hangs: {:?}", self.child);
            }
            std::thread::sleep(Duration::from_millis(2));
        };
        let [stdout, stderr] = self
            .collected
            .map(|output| output.map_or_else(Vec::new, |o| o.join().unwrap()));
        Ended {
            code: status.code(),
            signal: status.signal(),
            stdout,
            stderr: String::from_utf8(stderr).unwrap(),
            seconds: self.started.elapsed().as_secs_f64(),
            peak_bytes: self.peak_bytes,
        }
    }
}

/// The most memory a process held resident so far, where the system tells.
fn peak_bytes(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    // Until it has become the command, the new process shows the memory of this one.
    if status.lines().next() != Some("Name:\tcurvox") {
        return None;
    }
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes << 10)
}

/// Writes, unless nobody reads any more.
pub(crate) fn feed(to: &mut impl Write, bytes: &[u8]) -> bool {
    to.write_all(bytes).is_ok()
}

/// `run.json` of an output directory.
pub(crate) fn record(output: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(output.join("run.json")).unwrap()).unwrap()
}

/// All files below a folder, by their paths in it, in order.
pub(crate) fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(at) = folders.pop() {
        for entry in std::fs::read_dir(at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(path.strip_prefix(folder).unwrap().to_owned());
            }
        }
    }
    found.sort();
    found
}

/// Checks that an output, if there is any, does not pass for a complete one.
#[track_caller]
pub(crate) fn assert_not_complete(output: &Path) {
    if !output.exists() {
        return;
    }
    for file in files(output) {
        let name = file.display().to_string();
        assert!(!name.ends_with(".partial"), "{name} was left");
        assert_ne!(name, "summary.json");
    }
    if output.join("run.json").exists() {
        assert_ne!(record(output)["state"], "complete");
    }
}

/// The results of a run that must not depend on how it was run: checksums of the parts, and the
/// bytes of the totals and the slices.
pub(crate) fn results(output: &Path) -> (Value, Vec<(PathBuf, Vec<u8>)>) {
    let record = record(output);
    assert_eq!(record["state"], "complete");
    let parts = record["parts"].clone();
    assert_eq!(
        Some(parts.as_array().unwrap().len() as u64),
        record["parts_total"].as_u64()
    );
    let others = files(output)
        .into_iter()
        .filter(|file| !file.starts_with("surfels") && file != Path::new("run.json"))
        .map(|file| {
            let bytes = std::fs::read(output.join(&file)).unwrap();
            (file, bytes)
        })
        .collect();
    (parts, others)
}
