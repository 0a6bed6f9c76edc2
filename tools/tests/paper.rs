//! The experiments of the paper, at their quick size, as a user runs them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use tempfile::TempDir;

fn paper(folder: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_curvox-tools"))
        .args(["paper", "--quick", "-o"])
        .arg(folder)
        .args(more)
        .output()
        .unwrap()
}

/// The folder of a quick run of everything, made once.
fn quick() -> &'static Path {
    static FOLDER: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("paper");
        let output = paper(&path, &[]);
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        (folder, path)
    });
    path
}

fn text(folder: &Path, name: &str) -> String {
    std::fs::read_to_string(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

#[test]
fn every_figure_has_its_files_and_the_page_shows_them() {
    let folder = quick();
    let page = text(folder, "README.md");
    let mut pictures = 0;
    for piece in page.split("](").skip(1) {
        let Some((target, _)) = piece.split_once(')') else {
            continue;
        };
        if let Some(heading) = target.strip_prefix('#') {
            assert!(!heading.is_empty());
            continue;
        }
        let bytes = std::fs::read(folder.join(target)).unwrap_or_else(|e| panic!("{target}: {e}"));
        if target.ends_with(".svg") {
            let drawn = String::from_utf8(bytes).unwrap();
            assert!(drawn.starts_with("<svg") && drawn.trim_end().ends_with("</svg>"));
            assert!(
                drawn.contains("circle") || drawn.contains("rect"),
                "{target}"
            );
            pictures += 1;
        } else if target.ends_with(".png") {
            assert!(
                bytes.starts_with(b"\x89PNG\r\n\x1a\n") && bytes.len() > 2000,
                "{target}"
            );
            pictures += 1;
        } else {
            assert!(target.ends_with(".csv"), "{target}");
            assert!(
                bytes.iter().filter(|&&b| b == b'\n').count() > 1,
                "{target}"
            );
        }
    }
    for number in [4, 5, 6, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20] {
        assert!(page.contains(&format!("## Figure {number}: ")), "{number}");
        assert!(
            folder.join(format!("figure{number:02}.csv")).is_file(),
            "{number}"
        );
    }
    // One for each figure, one more for figure 10, and those beyond the paper.
    assert_eq!(pictures, 16 + 1 + 2);
    for unknown in ["NaN", "| inf |", "| -inf |"] {
        assert!(!page.contains(unknown), "{unknown}: {page}");
    }
}

/// (estimator, gridstep, norm) to curvox's and DGtal's error.
fn errors(csv: &str) -> BTreeMap<(String, String, String), (f64, f64)> {
    let lines = csv.lines().skip(1);
    let compared = lines.filter_map(|line| {
        // The names that have a comma are quoted, and are not asked for.
        let cells: Vec<&str> = line.split(',').collect();
        let [name, gridstep, norm, ours, theirs] = cells[..] else {
            return None;
        };
        let key = [name, gridstep, norm].map(str::to_owned).into();
        Some((key, (ours.parse().ok()?, theirs.parse().ok()?)))
    });
    compared.collect()
}

#[test]
fn errors_on_goursat_are_near_those_of_dgtal() {
    for (file, figure) in [("figure08.csv", "H"), ("figure14.csv", "G")] {
        let errors = errors(&text(quick(), file));
        for (name, bound) in [
            ("ii", 0.10),
            ("paper ii", 0.01),
            ("vcm", 0.15),
            ("paper vcm", 0.03),
            ("paper trivial", 0.02),
        ] {
            for gridstep in ["1", "0.5", "0.25"] {
                for norm in ["l2", "linf"] {
                    let key = [name, gridstep, norm].map(str::to_owned).into();
                    let (ours, theirs) = errors[&key];
                    let apart = (ours / theirs - 1.0).abs();
                    assert!(apart < bound, "{figure} {key:?}: {ours} for {theirs}");
                }
            }
        }
    }
}

#[test]
fn fields_differ_little_and_quality_is_better_at_a_quarter_than_at_one() {
    let csv = text(quick(), "fields.csv");
    let mut values: BTreeMap<[&str; 4], f64> = BTreeMap::new();
    for line in csv.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        values.insert(
            [cells[0], cells[1], cells[2], cells[3]],
            cells[4].parse().unwrap(),
        );
    }
    for normals in ["ii", "vcm"] {
        for gridstep in ["1", "0.5", "0.25"] {
            for what in ["l2 error of H", "l2 error of G"] {
                let of = |field| values[&[what, normals, field, gridstep]];
                for field in ["interpolated", "linear"] {
                    let ratio = of(field) / of("constant");
                    assert!(
                        (0.8..1.25).contains(&ratio),
                        "{what} {normals} {field}: {ratio}"
                    );
                }
            }
        }
        for field in ["constant", "interpolated", "linear"] {
            let of = |gridstep| values[&["rms quality", normals, field, gridstep]];
            assert!(of("0.25") < 0.7 * of("1"), "{normals} {field}");
        }
    }
}

#[test]
fn the_page_says_nothing_of_the_machine() {
    let page = text(quick(), "README.md");
    let folder = quick().display().to_string();
    let home = env!("CARGO_MANIFEST_DIR");
    for unwanted in [folder.as_str(), home, "/tmp", "/home"] {
        assert!(!page.contains(unwanted), "{unwanted}");
    }
}

#[test]
fn runs_that_are_there_are_not_repeated() {
    let folder = tempfile::tempdir().unwrap();
    let more = ["--figure", "5", "--finest", "1"];
    let told = |output: &Output| String::from_utf8_lossy(&output.stderr).into_owned();
    let first = paper(folder.path(), &more);
    assert!(first.status.success(), "{}", told(&first));
    assert!(!told(&first).contains("there already"));
    let page = text(folder.path(), "README.md");
    let second = paper(folder.path(), &more);
    assert_eq!(
        told(&second).matches("there already").count(),
        told(&second).matches("processor").count()
    );
    assert!(told(&second).contains("there already"));
    assert_eq!(text(folder.path(), "README.md"), page);

    // A run that was killed between its table and its record is made again.
    let runs = folder.path().join("runs");
    for entry in std::fs::read_dir(&runs).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "json") {
            std::fs::remove_file(path).unwrap();
        }
    }
    let third = paper(folder.path(), &more);
    assert!(third.status.success() && !told(&third).contains("there already"));
}

#[test]
fn what_cannot_be_asked_is_an_error_that_says_what_can() {
    let folder = tempfile::tempdir().unwrap();
    for (more, expected) in [
        (vec!["--figure", "7"], "figure: found 7, expected one of"),
        (vec!["--finest", "2"], "finest gridstep: found 2"),
        (
            vec!["--volume", "dragon=/none.vol:1"],
            "/none.vol: expected a volume",
        ),
        (vec!["--volume", "dragon"], "expected NAME=PATH:H"),
    ] {
        let output = paper(folder.path(), &more);
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            !output.status.success() && told.contains(expected),
            "{told}"
        );
    }
}
