//! What the writers of meshes refuse, as a user meets it.

use std::process::{Command, Output};

fn tools(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_curvox-tools"))
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn meshes_that_make_no_sense_are_refused_and_none_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).display().to_string();
    let (obj, ply) = (place("a.obj"), place("a.ply"));
    for (arguments, words) in [
        (
            &["icosphere", "--levels", "1", "--radius", "-1"][..],
            "above 0",
        ),
        (
            &["icosphere", "--levels", "1", "--radius", "nan"],
            "above 0",
        ),
        (
            &["lantern", "--m", "3", "--n", "3", "--height", "0"],
            "above 0",
        ),
        (
            &[
                "torus", "--major", "1", "--minor", "2", "--around", "9", "--across", "9",
            ],
            "not below --major",
        ),
        (&["icosphere", "--levels", "1", "-o", &ply], ".obj"),
    ] {
        let mut all = arguments.to_vec();
        if !all.contains(&"-o") {
            all.extend(["-o", &obj]);
        }
        let ended = tools(&all);
        let said = String::from_utf8_lossy(&ended.stderr);
        assert!(!ended.status.success() && said.contains(words), "{said}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let write = |levels: &str, more: &[&str]| {
        tools(&[&["icosphere", "--levels", levels, "-o", &obj], more].concat())
    };
    assert!(write("1", &[]).status.success());
    let first = std::fs::read(&obj).unwrap();
    let ended = write("0", &[]);
    assert!(String::from_utf8_lossy(&ended.stderr).contains("--overwrite"));
    assert!(!ended.status.success() && std::fs::read(&obj).unwrap() == first);
    assert!(write("0", &["--overwrite"]).status.success());
    assert!(std::fs::read(&obj).unwrap().len() < first.len());
}
