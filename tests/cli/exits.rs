use super::{Place, ball, curvox};

#[test]
fn help_and_version_are_no_error() {
    for arguments in [
        &["--help"][..],
        &["--version"],
        &["run", "--help"],
        &["help", "plan"],
    ] {
        curvox(arguments).out();
    }
    let help = String::from_utf8(curvox(&["run", "--help"]).out()).unwrap();
    for word in ["3vx", "H > 0", "border", "130", "Exit codes", "Examples"] {
        assert!(help.contains(word), "{word}");
    }
}

#[test]
fn usage_errors_give_2() {
    let place = Place::with_ball();
    let ball = place.text("ball.nii");
    let out = place.text("out");
    for (wrong, expected) in [
        (&["--threshold", "1", "--radius", "3"][..], "3vx"),
        (
            &["--threshold", "1", "--radius", "64vx"],
            "--radius 64vx: a ball of measures of radius 64 voxels is too large for voxels of this \
             shape and these weights, expected at most 39.38",
        ),
        (
            &[
                "--threshold",
                "1",
                "--radius",
                "40vx",
                "--weights",
                "lumped",
            ],
            "expected at most 39.70",
        ),
        (
            &[
                "--threshold",
                "1",
                "--radius",
                "32vx",
                "--method",
                "refined",
            ],
            "--radius 32vx: --method refined takes up to 31.5 voxels",
        ),
        (
            &["--threshold", "1", "--method", "refined", "--normals", "ii"],
            "--normals average",
        ),
        (
            &[
                "--threshold",
                "1",
                "--method",
                "refined",
                "--normal-radius",
                "3vx",
            ],
            "no use",
        ),
        (
            &[
                "--threshold",
                "1",
                "--method",
                "refined",
                "--curvature",
                "ii",
            ],
            "--curvature measures",
        ),
        (
            &["--threshold", "1", "--radius", "40vx"],
            "--radius 40vx: a ball of measures of radius 40 voxels",
        ),
        (
            &["--threshold", "1", "--radius", "64vx", "--curvature", "ii"],
            "at most 63",
        ),
        (
            &["--threshold", "1", "--radius", "-3vx"],
            "not a length above 0",
        ),
        (&["--threshold", "1", "--normal-radius", "-3vx"], "above 0"),
        (&["--threshold", "1", "--sigma", "-1vx"], "above 0"),
        (&["--threshold", "1", "--voronoi-radius", "-1vx"], "above 0"),
        (&["--threshold", "1", "--spacing", "-1um"], "above 0"),
        (&["--threshold", "1", "--radius", "3um"], "--spacing"),
        (&["--threshold", "1", "--radius", "3vx,3vx"], "twice"),
        (&["--threshold", "1", "--memory", "1"], "1GiB"),
        (&["--threshold", "1", "--memory", "1MiB"], "--memory"),
        (&["--threshold", "1", "--threads", "0"], "--threads"),
        (&["--threshold", "1", "--brick", "3"], "8 to 1024"),
        (&["--threshold", "1", "--below", "2"], "cannot be used with"),
        (&["--threshold", "one"], "not a number"),
        (&["--range", "5..1"], "not a range"),
        (&["--threshold", "1", "--dims", "3,4,5"], "--dtype"),
        (&["--threshold", "1", "--slices", "z=99999"], "--slices"),
        (
            &[
                "--threshold",
                "1",
                "--normals",
                "trivial",
                "--normal-radius",
                "3vx",
            ],
            "no use",
        ),
        (
            &[
                "--threshold",
                "1",
                "--normals",
                "average",
                "--orientation",
                "dgtal",
            ],
            "ii",
        ),
        (
            &["--threshold", "1", "--voronoi-radius", "9vx"],
            "--normals vcm",
        ),
        (
            &[
                "--threshold",
                "1",
                "--normals",
                "vcm",
                "--normal-radius",
                "30vx",
            ],
            "by default 10/3",
        ),
        (
            &[
                "--threshold",
                "1",
                "--normals",
                "vcm",
                "--orientation",
                "moment",
            ],
            "surface or dgtal",
        ),
        (
            &["--threshold", "1", "--curvature", "ii", "--ball", "whole"],
            "--curvature measures",
        ),
        (&["--threshold", "1", "--to", "arrow"], "standard output"),
        (&[], "--otsu"),
    ] {
        let mut arguments = vec!["run", &ball, "-o", &out];
        arguments.extend(wrong);
        let said = curvox(&arguments).fails(2);
        assert!(said.contains(expected), "{wrong:?}: {said}");
    }
    let said = curvox(&["run", &ball, "--threshold", "1"]).fails(2);
    assert!(said.contains("-o DIR"), "{said}");
    assert_eq!(place.names(), ["ball.nii"]);
}

#[test]
fn bad_inputs_give_3_and_name_the_place() {
    let place = Place::new();
    let whole = ball();
    std::fs::write(place.path("cut.nii"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(place.path("empty"), b"").unwrap();
    std::fs::write(place.path("text"), b"not a volume at all, just words").unwrap();
    std::fs::write(place.path("pair.hdr"), [0; 348]).unwrap();
    for name in ["cut.nii", "empty", "text", "pair.hdr", "missing", "."] {
        let (input, out) = (place.text(name), place.text("out"));
        let said = curvox(&["run", &input, "--threshold", "1", "-o", &out]).fails(3);
        assert!(said.contains(&input), "{said}");
        assert!(!place.path("out").exists(), "{name}");
    }
}

#[test]
fn standard_input_closed_early_is_a_bad_input() {
    let place = Place::new();
    let out = place.text("out");
    let arguments = ["run", "-", "--threshold", "1", "-o", &out];
    curvox(&arguments).fails(3);
    let whole = ball();
    let said = curvox(&arguments).input(&whole[..whole.len() - 1]).fails(3);
    assert!(said.contains("standard input"), "{said}");
    let record = std::fs::read_to_string(place.path("out/run.json")).unwrap();
    assert!(record.contains("\"failed\""), "{record}");
    assert!(!place.path("out/summary.json").exists());
}

#[test]
fn the_threshold_of_otsu_needs_a_file() {
    let place = Place::new();
    let out = place.text("out");
    let said = curvox(&["run", "-", "--otsu", "-o", &out])
        .input(&ball())
        .fails(2);
    assert!(said.contains("twice"), "{said}");
    std::fs::write(place.path("flat.vol"), flat_vol()).unwrap();
    let flat = place.text("flat.vol");
    let said = curvox(&["run", &flat, "--otsu", "-o", &out]).fails(3);
    assert!(said.contains("only 7"), "{said}");
}

fn flat_vol() -> Vec<u8> {
    let mut bytes = b"X: 9\nY: 9\nZ: 9\nVersion: 2\n.\n".to_vec();
    bytes.extend([7; 729]);
    bytes
}

#[test]
#[cfg(target_os = "linux")]
fn outputs_that_cannot_be_written_give_1() {
    let place = Place::with_ball();
    let ball = place.text("ball.nii");
    let inside_a_file = format!("{ball}/out");
    for out in [
        "/dev/full",
        "/proc/out",
        "/proc/out.csv",
        "/proc/out.parquet",
        &inside_a_file,
    ] {
        let said = curvox(&["run", &ball, "--threshold", "1", "-o", out]).fails(1);
        assert!(said.contains(out), "{said}");
    }
    let said = curvox(&["shape", "sphere", "--gridstep", "1", "-o", "/dev/full"]).fails(1);
    assert!(said.contains("no space left"), "{said}");
    curvox(&["run", &ball, "--threshold", "1", "-o", "/dev/null"]).out();
}

#[test]
fn what_is_there_is_not_replaced_unasked() {
    let place = Place::with_ball();
    let ball = place.text("ball.nii");
    for name in ["out", "out.csv", "out.parquet"] {
        let out = place.text(name);
        let arguments = ["run", &ball, "--threshold", "1", "-q", "-o", &out];
        curvox(&arguments).out();
        let said = curvox(&arguments).fails(1);
        assert!(said.contains("--overwrite"), "{said}");
        let mut again = arguments.to_vec();
        again.push("--overwrite");
        curvox(&again).out();
    }
    // A folder of other things is never cleared.
    std::fs::create_dir(place.path("mine")).unwrap();
    std::fs::write(place.path("mine/notes"), b"precious").unwrap();
    let mine = place.text("mine");
    curvox(&["run", &ball, "--threshold", "1", "-o", &mine, "--overwrite"]).fails(1);
    assert!(place.path("mine/notes").exists());
    let said = curvox(&["shape", "sphere", "--gridstep", "1", "-o", &ball]).fails(1);
    assert!(said.contains("--overwrite"), "{said}");
}

#[test]
#[cfg(unix)]
fn a_reader_that_goes_away_ends_the_run_quietly() {
    use std::process::{Command, Stdio};
    let place = Place::with_ball();
    let mut child = Command::new(env!("CARGO_BIN_EXE_curvox"))
        .args([
            "run",
            &place.text("ball.nii"),
            "--threshold",
            "1",
            "-o",
            "-",
            "-q",
        ])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let ended = child.wait_with_output().unwrap();
    assert_eq!(ended.status.code(), Some(0));
    assert_eq!(String::from_utf8(ended.stderr).unwrap(), "");
}

#[test]
#[cfg(unix)]
fn an_interrupt_ends_a_run_with_130() {
    use std::io::Write;
    use std::process::{Command, Stdio};
    let place = Place::new();
    let mut child = Command::new(env!("CARGO_BIN_EXE_curvox"))
        .args(["run", "-", "--threshold", "1", "-o", &place.text("out")])
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Some planes, then nothing: the run waits.
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(&ball()[..20_000]).unwrap();
    stdin.flush().unwrap();
    while !place.path("out/run.json").exists() {
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    let id = child.id().to_string();
    let signal = |name: &str| {
        assert!(
            Command::new("kill")
                .args([name, &id])
                .status()
                .unwrap()
                .success()
        );
    };
    signal("-INT");
    std::thread::sleep(std::time::Duration::from_millis(200));
    drop(stdin);
    let ended = child.wait_with_output().unwrap();
    assert_eq!(ended.status.code(), Some(130));
    assert!(!place.path("out/summary.json").exists());
}

#[test]
fn errors_are_json_where_asked() {
    let ended = curvox(&[
        "run",
        "missing.nii",
        "--threshold",
        "1",
        "-o",
        "-",
        "--json",
    ])
    .end();
    assert_eq!(ended.code, 3);
    let line: serde_json::Value = serde_json::from_str(ended.err.lines().last().unwrap()).unwrap();
    assert_eq!(
        (&line["event"], &line["code"]),
        (&"error".into(), &3.into())
    );
}
