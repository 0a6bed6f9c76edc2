use super::{Place, ball, curvox, read};

/// The ball, its radius in voxels and the run's, so that H is near 1/9.
const METHOD: [&str; 4] = ["--threshold", "1", "--radius", "6vx"];

fn run(place: &Place, input: &str, out: &str, more: &[&str]) -> super::Ended {
    let (input, out) = (place.text(input), place.text(out));
    let mut arguments = vec!["run", &input, "-o", &out];
    arguments.extend(METHOD);
    arguments.extend(more);
    let ended = curvox(&arguments).end();
    assert_eq!(ended.code, 0, "{}", ended.err);
    ended
}

#[test]
fn a_shape_runs_through_a_pipe() {
    let place = Place::new();
    let out = place.text("out");
    let mut arguments = vec!["run", "-", "-o", &out];
    arguments.extend(METHOD);
    let ended = curvox(&arguments).input(&ball()).end();
    assert_eq!(ended.code, 0, "{}", ended.err);
    assert!(ended.out.is_empty());
    assert!(ended.err.contains("surfels"), "{}", ended.err);
    let summary = place.summary("out");
    let exact = &summary["exact"];
    assert_eq!(exact["euler_counted"], 2);
    assert_eq!(exact["euler_gauss_bonnet"], 2);
    assert_eq!(exact["closed"], true);
    let near = |value: &serde_json::Value, expected: f64| {
        let value = value.as_f64().unwrap();
        assert!(
            (value - expected).abs() < 0.02 * expected,
            "{value} {expected}"
        );
    };
    let pi = std::f64::consts::PI;
    near(&exact["mu0"], 4.0 * pi * 81.0);
    near(&exact["mu1"], 8.0 * pi * 9.0);
    near(&exact["mu2"], 4.0 * pi);
    near(&summary["radii"][0]["mean_curvature"]["mean"], 1.0 / 9.0);
    near(
        &summary["radii"][0]["gaussian_curvature"]["mean"],
        1.0 / 81.0,
    );
    assert_eq!(summary["radii"][0]["world"], 3.0);
    for name in ["run.json", "surfels/part-00000.parquet"] {
        assert!(place.path("out").join(name).exists(), "{name}");
    }
}

#[test]
fn resources_do_not_show_in_the_results() {
    let place = Place::with_ball();
    run(&place, "ball.nii", "a", &["--slices", "z=20"]);
    run(
        &place,
        "ball.nii",
        "b",
        &[
            "--slices",
            "z=20",
            "--threads",
            "1",
            "--memory",
            "200MiB",
            "--brick",
            "16",
            "--io",
            "read",
            "-q",
        ],
    );
    std::fs::rename(place.path("ball.nii"), place.path("other.nii")).unwrap();
    run(&place, "other.nii", "c", &["--slices", "z=20"]);
    for name in [
        "summary.json",
        "surfels/part-00000.parquet",
        "slices/z00020.exr",
    ] {
        let first = read(&place.path("a").join(name));
        assert!(first == read(&place.path("b").join(name)), "{name}");
        assert!(first == read(&place.path("c").join(name)), "{name}");
    }
}

#[test]
fn one_table_in_every_form() {
    let place = Place::with_ball();
    run(&place, "ball.nii", "out.csv", &["-q"]);
    run(&place, "ball.nii", "out.parquet", &["-q"]);
    let ball = place.text("ball.nii");
    let mut arguments = vec!["run", &ball, "-o", "-", "-q"];
    arguments.extend(METHOD);
    let stream = curvox(&arguments).out();
    assert!(stream == read(&place.path("out.csv")));
    arguments.extend(["--to", "arrow"]);
    assert!(curvox(&arguments).out().starts_with(&[0xff; 4]));
    let rows = stream.iter().filter(|&&b| b == b'\n').count() - 1;
    let told = curvox(&["info", "--json", &place.text("out.parquet")]).json();
    assert_eq!(told["rows"], rows);
    assert_eq!(place.names(), ["ball.nii", "out.csv", "out.parquet"]);
}

#[test]
fn columns_of_several_radii_carry_them() {
    let place = Place::with_ball();
    let ball = place.text("ball.nii");
    let table = curvox(&[
        "run",
        &ball,
        "--threshold",
        "1",
        "-o",
        "-",
        "-q",
        "--radius",
        "3vx,6vx",
        "--directions",
        "--quality",
    ])
    .out();
    let header = String::from_utf8(table)
        .unwrap()
        .lines()
        .next()
        .unwrap()
        .to_owned();
    for column in [
        "mean_curvature_3vx",
        "gaussian_curvature_6vx",
        "d1x_3vx",
        "d2z_6vx",
        "quality_3vx",
        "quality_6vx",
        "flags_6vx",
    ] {
        assert!(header.split(',').any(|c| c == column), "{header}");
    }
}

#[test]
fn fields_and_quality_are_told() {
    let place = Place::with_ball();
    for (field, gauss_bonnet) in [
        ("constant", serde_json::json!(2)),
        ("interpolated", serde_json::json!(2)),
        ("linear", serde_json::Value::Null),
    ] {
        let out = format!("out-{field}");
        let more = ["--field", field, "--quality", "--weights", "sharp"];
        let ended = run(&place, "ball.nii", &out, &more);
        let told = String::from_utf8(ended.out).unwrap() + &ended.err;
        assert_eq!(told.contains("sum|k| = 0"), field != "linear", "{told}");
        assert!(told.contains("quality"), "{told}");
        let summary = place.summary(&out);
        assert_eq!(summary["exact"]["euler_gauss_bonnet"], gauss_bonnet);
        assert_eq!(summary["exact"]["sum_abs_k"], 0);
        let radius = &summary["radii"][0];
        let (quality, mean) = (&radius["quality_rms"], &radius["mean_curvature"]["mean"]);
        assert!(quality.as_f64().unwrap() < 0.05 * mean.as_f64().unwrap());
        let info = curvox(&["info", "--json", &place.text(&out)]).json();
        assert_eq!(info["parameters"]["field"], field);
        let columns: Vec<_> = info["columns"].as_array().unwrap().to_vec();
        assert!(columns.iter().any(|c| c["name"] == "quality"));
    }
    let plain = run(&place, "ball.nii", "plain", &[]);
    assert!(!String::from_utf8(plain.out).unwrap().contains("quality"));
    assert!(place.summary("plain")["radii"][0]["quality_rms"].is_null());
}

#[test]
fn json_is_for_machines() {
    let place = Place::with_ball();
    let ended = run(&place, "ball.nii", "out", &["--json"]);
    let done: serde_json::Value = serde_json::from_slice(&ended.out).unwrap();
    assert_eq!(done["event"], "done");
    assert_eq!(done["summary"]["exact"]["euler_counted"], 2);
    assert!(done["summary"]["radii"][0]["mean_curvature"]["histogram"].is_null());
    for line in ended.err.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(line["event"], "progress");
    }
    // The table takes standard output: the summary goes to standard error.
    let ball = place.text("ball.nii");
    let ended = curvox(&["run", &ball, "--threshold", "1", "-o", "-", "--json"]).end();
    assert!(ended.out.starts_with(b"kx,ky,kz"));
    assert!(
        ended
            .err
            .lines()
            .last()
            .unwrap()
            .contains("\"event\":\"done\"")
    );
}

#[test]
fn quiet_says_nothing() {
    let place = Place::with_ball();
    let ended = run(&place, "ball.nii", "out", &["-q"]);
    assert_eq!((ended.out.len(), ended.err.as_str()), (0, ""));
}

#[test]
fn slices_are_drawn_across_the_axis_asked() {
    let place = Place::with_ball();
    run(
        &place,
        "ball.nii",
        "a",
        &["--slices", "20,21", "--axis", "x", "-q"],
    );
    run(&place, "ball.nii", "b", &["--slices", "x=20..22", "-q"]);
    for name in ["x00020.exr", "x00021.exr"] {
        let [a, b] = ["a", "b"].map(|out| read(&place.path(out).join("slices").join(name)));
        assert!(a == b, "{name}");
    }
    let (ball, out) = (place.text("ball.nii"), place.text("c.csv"));
    curvox(&[
        "run",
        &ball,
        "--threshold",
        "1",
        "-o",
        &out,
        "--slices",
        "all",
    ])
    .fails(2);
}
