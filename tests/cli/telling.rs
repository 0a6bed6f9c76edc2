use super::{Place, curvox};

#[test]
fn info_and_plan_write_nothing() {
    let place = Place::with_ball();
    let (ball, out) = (place.text("ball.nii"), place.text("out"));
    curvox(&["info", &ball]).out();
    curvox(&["info", "--values", &ball]).out();
    curvox(&["plan", &ball, "--threshold", "1"]).out();
    curvox(&["plan", &ball, "--threshold", "1", "-o", &out]).out();
    curvox(&[
        "plan",
        &ball,
        "--threshold",
        "1",
        "-o",
        &place.text("out.csv"),
    ])
    .out();
    assert_eq!(place.names(), ["ball.nii"]);
}

#[test]
fn info_of_a_volume_tells_its_header_and_values() {
    let place = Place::with_ball();
    let told = curvox(&["info", "--json", "--values", &place.text("ball.nii")]).json();
    assert_eq!(told["kind"], "volume");
    assert_eq!(told["format"], "nifti1");
    assert_eq!(told["dims"], serde_json::json!([47, 47, 47]));
    assert_eq!(told["spacing"], serde_json::json!([0.5, 0.5, 0.5]));
    assert_eq!(told["unit"], "unknown");
    assert_eq!((&told["min"], &told["max"]), (&0.0.into(), &1.0.into()));
    assert_eq!(told["otsu_threshold"], 1.0);
    curvox(&["info", "--values", "-"])
        .input(&super::ball())
        .fails(2);
    curvox(&["info", "-"]).input(&super::ball()).out();
}

#[test]
fn info_of_an_output_tells_its_state() {
    let place = Place::with_ball();
    let (ball, out) = (place.text("ball.nii"), place.text("out"));
    curvox(&["run", &ball, "--threshold", "1", "-o", &out, "-q"]).out();
    let told = curvox(&["info", "--json", "--check", &out]).json();
    assert_eq!(
        (&told["kind"], &told["state"]),
        (&"output".into(), &"complete".into())
    );
    assert_eq!(told["totals"]["surfels"], told["rows"]);
    assert_eq!(told["parameters"]["inside"], "value >= 1");
    let text = String::from_utf8(curvox(&["info", &out]).out()).unwrap();
    assert!(text.contains("mean_curvature"), "{text}");
    // A part cut short is found.
    let part = place.path("out/surfels/part-00000.parquet");
    let bytes = std::fs::read(&part).unwrap();
    std::fs::write(&part, &bytes[..bytes.len() - 1]).unwrap();
    let said = curvox(&["info", &out]).fails(3);
    assert!(said.contains("part-00000"), "{said}");
}

#[test]
fn normals_field_and_curvature_are_named_by_plan_and_run() {
    let place = Place::with_ball();
    let (ball, out) = (place.text("ball.nii"), place.text("out"));
    for (options, line) in [
        (
            &["--radius", "4vx"][..],
            "average of radius 4.8vx, field constant, curvature by measures",
        ),
        (
            &["--method", "refined"],
            "refined average of radius 7.2vx, field constant, curvature by measures",
        ),
        (
            &["--normals", "ii"],
            "ii of radius 6vx, field constant, curvature by measures",
        ),
        (
            &["--normals", "gradient", "--sigma", "2vx"],
            "gradient of sigma 2vx, field constant,",
        ),
        (
            &["--normals", "vcm", "--field", "linear"],
            "vcm of radius 6vx and Voronoi radius 20vx, field linear,",
        ),
        (
            &["--curvature", "ii", "--normals", "trivial"],
            "trivial, curvature by integral invariants",
        ),
    ] {
        let input = [&ball, "--threshold", "1"];
        let plan = curvox(&[&["plan"], &input[..], options].concat()).out();
        let plan = String::from_utf8(plan).unwrap();
        assert!(plan.contains(&format!("normals    {line}")), "{plan}");
        let into = ["-o", &out, "--overwrite"];
        let run = curvox(&[&["run"], &input[..], &into, options].concat()).end();
        assert!(
            run.err.contains(&format!("normals    {line}")),
            "{}",
            run.err
        );
    }
}

#[test]
fn the_plan_counts_what_the_run_finds() {
    let place = Place::with_ball();
    let (ball, out) = (place.text("ball.nii"), place.text("out"));
    let plan = curvox(&["plan", &ball, "--threshold", "1", "--json"]).json();
    curvox(&["run", &ball, "--threshold", "1", "-o", &out, "-q"]).out();
    let surfels = place.summary("out")["exact"]["surfels"].as_f64().unwrap();
    let estimated = plan["estimated_surfels"].as_f64().unwrap();
    assert!(
        (estimated / surfels - 1.0).abs() < 0.1,
        "{estimated} {surfels}"
    );
    assert_eq!(plan["plan"]["memory_bytes"], 1 << 30);
    // Settings that cannot run have no plan either.
    curvox(&["plan", &ball, "--threshold", "1", "--memory", "1MiB"]).fails(2);
    curvox(&["plan", "-", "--threshold", "1"])
        .input(&super::ball())
        .out();
}

#[test]
fn completions_and_manual_know_every_command() {
    let place = Place::new();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let text = String::from_utf8(curvox(&["completions", shell]).out()).unwrap();
        assert!(text.contains("normal-radius"), "{shell}");
    }
    let text = String::from_utf8(curvox(&["man"]).out()).unwrap();
    assert!(text.contains("130"), "{text}");
    curvox(&["man", "--out", &place.text("man")]).out();
    let mut pages: Vec<_> = std::fs::read_dir(place.path("man"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    pages.sort();
    assert!(
        pages.contains(&"curvox.1".to_owned()) && pages.contains(&"curvox-run.1".to_owned()),
        "{pages:?}"
    );
}

#[test]
fn shapes_are_listed_and_mistakes_in_them_explained() {
    let list = String::from_utf8(curvox(&["shape", "--list"]).out()).unwrap();
    assert!(list.contains("torus") && list.contains("major"), "{list}");
    for wrong in [
        &["shape", "cubes", "--gridstep", "1"][..],
        &["shape", "sphere:radius=-1", "--gridstep", "1"],
        &["shape", "sphere", "--gridstep", "0"],
        &["shape", "sphere", "--gridstep", "1,2"],
        &["shape", "sphere", "--gridstep", "1e-9"],
        &["shape", "sphere", "--gridstep", "1", "--noise", "2"],
        &["shape", "sphere", "--gridstep", "1", "-o", "ball.nii.gz"],
        &["shape", "sphere"],
    ] {
        curvox(wrong).fails(2);
    }
}

#[test]
fn shapes_are_the_same_in_every_format() {
    let place = Place::new();
    let gridstep = [
        "shape",
        "torus",
        "--gridstep",
        "0.5,0.5,1",
        "--noise",
        "0.3",
    ];
    let with = |more: &[&str]| {
        let mut arguments = gridstep.to_vec();
        arguments.extend(more);
        curvox(&arguments).out()
    };
    let raw = with(&["--to", "raw"]);
    for name in ["a.nii", "a.npy", "a.vol", "a.raw"] {
        with(&["-o", &place.text(name)]);
        assert!(super::read(&place.path(name)).ends_with(&raw), "{name}");
    }
    assert!(raw != with(&["--to", "raw", "--seed", "2"]));
}
