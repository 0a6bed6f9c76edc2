//! `curvox mesh`, as a user runs it.

use std::f64::consts::PI;

use curvox_tools::meshes::{icosphere, lantern};

use super::{Place, curvox, read};

/// Warnings and the report of a run, and how many rows carry a flag.
fn told(arguments: &[&str], flag: &str) -> (String, u64) {
    let place = Place::new();
    let out = place.text("out");
    let ended = curvox(&[&["mesh", "-o", &out], arguments].concat()).end();
    assert_eq!(ended.code, 0, "{}", ended.err);
    let summary = place.summary("out");
    let flags = summary["radius"]["flags"].as_array().unwrap();
    let found = flags.iter().find(|f| f["name"] == flag).unwrap();
    (ended.err, found["rows"].as_u64().unwrap())
}

#[test]
fn a_small_radius_is_told_and_its_rows_are_marked() {
    let place = with_sphere();
    let mesh = place.text("ball.obj");
    let flag = "radius_too_small";
    for radius in ["1%", "0.001"] {
        let (said, rows) = told(&[&mesh, "--radius", radius, "--field", "constant"], flag);
        assert!(
            said.contains("the faces show") && said.contains(flag),
            "{said}"
        );
        assert_eq!(rows, 1280);
        let (said, rows) = told(&[&mesh, "--radius", radius], flag);
        assert!(said.contains("the faces show"), "{said}");
        assert_eq!(rows, 0);
    }
    let (said, rows) = told(&[&mesh, "--radius", "10%", "--field", "constant"], flag);
    assert!(!said.contains("warning"), "{said}");
    assert_eq!(rows, 0);
}

#[test]
fn the_report_names_normals_field_and_lifts() {
    let place = with_sphere();
    let mesh = place.text("ball.obj");
    let report = |more: &[&str]| told(&[&[mesh.as_str()], more].concat(), "lifted").0;
    let said = report(&[]);
    assert!(
        said.contains("normals    given for corners; field interpolated"),
        "{said}"
    );
    assert!(said.contains("Gauss-Bonnet gives 2"), "{said}");
    let said = report(&["--normals", "faces"]);
    assert!(
        said.contains("naive normals of faces; field constant"),
        "{said}"
    );
    assert!(
        said.contains("lifts      sum|k| = 0, Gauss-Bonnet gives 2"),
        "{said}"
    );
    let said = report(&["--field", "linear"]);
    assert!(said.contains("no Gauss-Bonnet theorem"), "{said}");
}

#[test]
fn what_is_wrong_with_a_mesh_is_counted_in_good_english() {
    let place = Place::new();
    let vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n";
    let obj = place.text("a.obj");
    let said = |faces: &str| {
        std::fs::write(&obj, format!("{vertices}{faces}")).unwrap();
        told(&[&obj, "--normals", "faces"], "non_manifold").0
    };
    // A tetrahedron with a face turned over.
    let turned = said("f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 4 1\n");
    assert!(turned.contains(", not consistently oriented"), "{turned}");
    assert!(
        !turned.contains("open") && turned.contains("3 edges have two faces of"),
        "{turned}"
    );
    let repeated = said("f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\nf 1 1 2\n");
    assert!(
        repeated.contains("warning    1 face has fewer than three"),
        "{repeated}"
    );
    assert!(repeated.contains(", closed"), "{repeated}");
    let open = said("f 1 3 2\n");
    assert!(open.contains("V - E + F = 1, open"), "{open}");
}

#[test]
fn info_tells_of_meshes_and_of_what_mesh_left() {
    let place = with_sphere();
    let (mesh, out, table) = (
        place.text("ball.obj"),
        place.text("out"),
        place.text("t.parquet"),
    );
    let told = String::from_utf8(curvox(&["info", &mesh]).out()).unwrap();
    for words in ["mesh", "obj", "642", "1280", "of corners", "curvox mesh"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    for output in [&out, &table] {
        curvox(&["mesh", &mesh, "-q", "-o", output]).out();
        let told = curvox(&["info", "--json", output]).json();
        assert_eq!(told["kind"], "output of a mesh");
        assert_eq!(told["rows"], 1280);
        assert_eq!(told["parameters"]["field"], "interpolated");
        assert_eq!(told["radius"], told["parameters"]["radius_length"]);
    }
    let told = curvox(&["info", "--json", &out]).json();
    assert_eq!(told["totals"]["euler_counted"], 2);
    assert_eq!(told["input"]["faces"], 1280);
    curvox(&["info", "--check", &out]).fails(2);
    curvox(&["info", "--values", &mesh]).fails(2);
    // A mesh is no volume, and is told what to do with it.
    let said = curvox(&["run", &mesh, "--threshold", "1", "-o", &place.text("run")]).fails(3);
    assert!(
        said.contains("is a mesh (obj)") && said.contains("curvox mesh"),
        "{said}"
    );
    let said = curvox(&["mesh", &table, "-o", "-"]).fails(3);
    assert!(
        said.contains("not a mesh") && said.contains("Parquet"),
        "{said}"
    );
}

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
    assert!((mean - 0.5).abs() < 2e-3, "{mean}");
    assert_eq!(summary["parameters"]["field"], "interpolated");
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
    for flip in [&["--flip=faces"][..], &["--flip", "faces"]] {
        let (mu1, warnings) = run(&[&["@in.obj"], flip].concat());
        assert!(
            (mu1 / (8.0 * PI) - 1.0).abs() < 0.05 && warnings == "[]",
            "{mu1} {warnings}"
        );
    }
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
    let said = curvox(&["mesh", &mesh]).fails(2);
    assert!(said.contains("-o OUT.parquet"), "{said}");
    let said = curvox(&["mesh", &mesh, "-o", &place.text("out.vtp")]).fails(2);
    assert!(said.contains(".vtp is not a format"), "{said}");
    let said = run(&["--flip", &mesh]).fails(2);
    assert!(said.contains("before --flip"), "{said}");
    // Nothing was written so far; then nothing is replaced unasked.
    assert!(!place.path("out").join("faces.parquet").exists());
    run(&[&mesh, "-q"]).out();
    let said = run(&[&mesh]).fails(1);
    assert!(said.contains("--overwrite"), "{said}");
    let said = run(&[&place.text("nothere.obj")]).fails(3);
    assert!(said.contains("nothere.obj"), "{said}");
    run(&[&mesh, "-q", "--overwrite"]).out();
    std::fs::write(place.path("out").join("mine.txt"), "").unwrap();
    let said = run(&[&mesh, "--overwrite"]).fails(1);
    assert!(said.contains("mine.txt"), "{said}");
}
