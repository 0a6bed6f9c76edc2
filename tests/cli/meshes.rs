//! `curvox mesh`, as a user runs it.

use std::f64::consts::PI;

use curvox_tools::meshes::{icosphere, lantern};

use super::{Place, curvox, read};

fn with_sphere() -> Place {
    let place = Place::new();
    std::fs::write(place.path("ball.obj"), icosphere(3, 2.0).to_obj(false)).unwrap();
    place
}

#[test]
fn a_sphere_has_its_curvature_in_every_output() {
    let place = with_sphere();
    let (mesh, out) = (place.text("ball.obj"), place.text("out"));
    let done = curvox(&["mesh", &mesh, "-o", &out, "--json"]).json();
    let totals = &done["summary"]["totals"];
    assert_eq!(totals["euler_counted"], 2);
    assert_eq!(totals["euler_gauss_bonnet"], 2);
    assert!((totals["mu2"].as_f64().unwrap() - 4.0 * PI).abs() < 1e-9);
    let summary = place.summary("out");
    assert_eq!(summary["format"], "curvox mesh summary 1");
    assert_eq!(summary["rows"], 1280);
    assert_eq!(summary["warnings"].as_array().unwrap().len(), 0);
    assert_eq!(summary["parameters"]["normals_used"], "given for corners");
    let mean = summary["radius"]["mean_curvature"]["mean"]
        .as_f64()
        .unwrap();
    assert!((mean - 0.5).abs() < 0.01, "{mean}");
    for name in ["faces.parquet", "summary.json"] {
        assert!(place.path("out").join(name).is_file());
    }
    let csv = curvox(&["mesh", &mesh, "-o", "-", "-q", "--directions", "--quality"]).out();
    let csv = String::from_utf8(csv).unwrap();
    assert_eq!(csv.lines().count(), 1281);
    assert_eq!(
        csv.lines().next().unwrap(),
        "face,x,y,z,nx,ny,nz,area,mean_curvature,gaussian_curvature,k1,k2,d1x,d1y,d1z,d2x,d2y,d2z,quality,flags"
    );
    // From a pipe, by content.
    let piped = curvox(&["mesh", "-", "-o", "-", "-q", "--directions", "--quality"])
        .input(&read(&place.path("ball.obj")))
        .out();
    assert_eq!(piped, csv.as_bytes());
}

#[test]
fn the_same_bytes_for_any_number_of_threads() {
    let place = with_sphere();
    let mesh = place.text("ball.obj");
    for threads in ["1", "3"] {
        let out = place.text(threads);
        curvox(&["mesh", &mesh, "-q", "--threads", threads, "-o", &out]).out();
    }
    for name in ["faces.parquet", "summary.json"] {
        let [a, b] = ["1", "3"].map(|threads| read(&place.path(threads).join(name)));
        assert!(a == b, "{name}");
    }
}

#[test]
fn the_lantern_has_the_area_of_its_cylinder() {
    let place = Place::new();
    let mesh = lantern(100, 20, 1.0, 1.0);
    std::fs::write(place.path("faces.obj"), mesh.to_obj(true)).unwrap();
    std::fs::write(place.path("vertices.obj"), mesh.to_obj(false)).unwrap();
    for (name, field) in [("faces", "constant"), ("vertices", "interpolated")] {
        let file = place.text(&format!("{name}.obj"));
        let out = place.text(name);
        let done = curvox(&[
            "mesh", &file, "--field", field, "--radius", "10%", "--json", "-o", &out,
        ]);
        let done = done.json();
        let totals = &done["summary"]["totals"];
        let value = |name: &str| totals[name].as_f64().unwrap();
        assert!((value("mu0") / (2.0 * PI) - 1.0).abs() < 0.01);
        assert!((value("mu1") / (2.0 * PI) - 1.0).abs() < 1e-12);
        assert!(value("mu2").abs() < 1e-12);
        assert!(value("naive_area") > 8.0);
        assert_eq!(totals["closed"], false);
        let warnings = done["summary"]["warnings"].to_string();
        assert!(warnings.contains("40 edges have one face"), "{warnings}");
    }
}

#[test]
fn meshes_turned_inside_out_are_told_and_turned() {
    let place = Place::new();
    let mut mesh = icosphere(2, 1.0);
    mesh.faces.iter_mut().for_each(|f| f.reverse());
    let obj = mesh.to_obj(false);
    std::fs::write(place.path("in.obj"), &obj).unwrap();
    let bare: String = obj
        .lines()
        .filter(|l| !l.starts_with("vn"))
        .map(|l| {
            let words: Vec<_> = l.split(' ').map(|w| w.split('/').next().unwrap()).collect();
            words.join(" ") + "\n"
        })
        .collect();
    std::fs::write(place.path("bare.obj"), bare).unwrap();
    let run = |arguments: &[&str]| {
        let out = place.text("out");
        let mut all = vec!["mesh", "-o", &out, "--overwrite", "--json"];
        let files: Vec<String> = arguments
            .iter()
            .map(|a| a.replace('@', &place.text("")))
            .collect();
        all.extend(files.iter().map(String::as_str));
        let done = curvox(&all).json();
        let mu1 = done["summary"]["totals"]["mu1"].as_f64().unwrap();
        (mu1, done["summary"]["warnings"].to_string())
    };
    let (_, warnings) = run(&["@in.obj"]);
    assert!(warnings.contains("volume inside is negative"), "{warnings}");
    assert!(warnings.contains("--flip=faces"), "{warnings}");
    let (mu1, warnings) = run(&["@in.obj", "--flip=faces"]);
    assert!(
        (mu1 / (8.0 * PI) - 1.0).abs() < 0.05 && warnings == "[]",
        "{mu1} {warnings}"
    );
    let (mu1, warnings) = run(&["@bare.obj"]);
    assert!(mu1 < 0.0 && warnings.contains("volume"), "{mu1} {warnings}");
    let (mu1, warnings) = run(&["@bare.obj", "--flip"]);
    assert!(
        (mu1 / (8.0 * PI) - 1.0).abs() < 0.05 && warnings == "[]",
        "{mu1} {warnings}"
    );
}

#[test]
fn mistakes_have_their_exit_codes() {
    let place = with_sphere();
    let (mesh, out) = (place.text("ball.obj"), place.text("out"));
    std::fs::write(place.path("cut.obj"), "v 0 0 0\nv 1 0 0\nf 1 2 3\n").unwrap();
    std::fs::write(place.path("point.obj"), "v 1 1 1\nf 1 1 1\n").unwrap();
    std::fs::write(
        place.path("huge.obj"),
        "v 0 0 0\nv 1e99 0 0\nv 0 1 0\nf 1 2 3\n",
    )
    .unwrap();
    std::fs::write(
        place.path("bare.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    )
    .unwrap();
    let run = |arguments: &[&str]| {
        let mut all = vec!["mesh", "-o", &out];
        all.extend(arguments);
        curvox(&all)
    };
    for (name, words) in [
        ("cut.obj", "line 3"),
        ("missing.obj", "cannot be opened"),
        ("point.obj", "three different corners"),
        ("huge.obj", "diagonal"),
    ] {
        let said = run(&[&place.text(name), "--overwrite"]).fails(3);
        assert!(said.contains(words) && said.contains(name), "{said}");
    }
    for arguments in [
        &[mesh.as_str(), "--radius", "0"][..],
        &[&mesh, "--radius", "2mm"],
        &[&mesh, "--normals", "ii"],
        &[&mesh, "--format", "off"],
    ] {
        run(arguments).fails(2);
    }
    let said = run(&[&place.text("bare.obj"), "--normals", "given"]).fails(2);
    assert!(said.contains("gives no normals"), "{said}");
    curvox(&["mesh", &mesh]).fails(2);
    // Nothing was written so far; then nothing is replaced unasked.
    assert!(!place.path("out").join("faces.parquet").exists());
    run(&[&mesh, "-q"]).out();
    let said = run(&[&mesh]).fails(1);
    assert!(said.contains("--overwrite"), "{said}");
    run(&[&mesh, "-q", "--overwrite"]).out();
    std::fs::write(place.path("out").join("mine.txt"), "").unwrap();
    let said = run(&[&mesh, "--overwrite"]).fails(1);
    assert!(said.contains("mine.txt"), "{said}");
}
