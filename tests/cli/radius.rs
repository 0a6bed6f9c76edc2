use serde_json::Value;

use super::{Place, curvox};

/// A sphere of 20 voxels off the grid.
fn sphere(place: &Place) -> String {
    let ball = place.text("sphere.nii");
    let shape = ["shape", "sphere:radius=20", "--gridstep", "1"];
    let where_to = ["--offset", "0.31,-0.17,0.43", "-o", &ball];
    curvox(&[&shape[..], &where_to].concat()).out();
    ball
}

/// The same with noise of the papers.
fn noisy_sphere(place: &Place, probability: &str) -> String {
    let noisy = place.text("noisy.nii");
    let noise = ["noise", &sphere(place), "--threshold", "1", "--noise"];
    curvox(&[&noise[..], &[probability, "-o", &noisy]].concat()).out();
    noisy
}

/// Root mean square error of H in percent, and the shares within one and two error bars.
fn errors(csv: &[u8]) -> [f64; 3] {
    let text = std::str::from_utf8(csv).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let (mean, bar) = (column("mean_curvature"), column("mean_curvature_error"));
    let (mut squares, mut within, mut count) = (0.0, [0.0; 2], 0.0);
    for line in lines {
        let values: Vec<&str> = line.split(',').collect();
        let [h, bar] = [mean, bar].map(|i| values[i].parse::<f64>().unwrap());
        assert!(h > 0.0 && bar > 0.0);
        let error = (h - 0.05).abs();
        squares += error * error;
        within[0] += f64::from(u8::from(error <= bar));
        within[1] += f64::from(u8::from(error <= 2.0 * bar));
        count += 1.0;
    }
    let rms: f64 = squares / count;
    [
        rms.sqrt() * 20.0 * 100.0,
        within[0] / count,
        within[1] / count,
    ]
}

fn summary(place: &Place, name: &str) -> Value {
    let text = std::fs::read(place.path(name).join("summary.json")).unwrap();
    serde_json::from_slice(&text).unwrap()
}

#[test]
fn a_newcomers_sphere_has_its_curvature_at_the_default_radius_and_with_auto() {
    let place = Place::with_ball();
    let ball = sphere(&place);
    for (options, percent) in [
        (&[][..], 2.0),
        (&["--radius", "auto"], 1.0),
        (&["--method", "refined"], 2.0),
    ] {
        let run = [
            &["run", &ball, "--threshold", "1", "-q", "-o", "-"],
            options,
        ]
        .concat();
        let [rms, one, two] = errors(&curvox(&run).out());
        println!("{options:?}: {rms:.2} %, {one:.2} within one bar, {two:.2} within two");
        assert!(rms < percent && one > 0.55 && two > 0.9);
    }
}

#[test]
fn the_radius_that_is_chosen_depends_on_the_voxels_alone() {
    let place = Place::with_ball();
    let noisy = noisy_sphere(&place, "0.3");
    let run = |radius: &str, out: &str, options: &[&str]| {
        let run = [
            "run",
            &noisy,
            "--threshold",
            "1",
            "-q",
            "--radius",
            radius,
            "-o",
            out,
        ];
        curvox(&[&run[..], options].concat()).out();
    };
    let rows =
        |name: &str| std::fs::read(place.path(name).join("surfels/part-00000.parquet")).unwrap();
    let mut expected: Option<(Value, Vec<u8>)> = None;
    for (i, options) in [
        &["--threads", "1"][..],
        &["--memory", "400MiB", "--brick", "24"],
        &["--io", "read"],
    ]
    .iter()
    .enumerate()
    {
        let name = format!("out{i}");
        let out = place.text(&name);
        run("auto", &out, options);
        let choice = summary(&place, &name)["radius_choice"].clone();
        let rows = rows(&name);
        match &expected {
            None => expected = Some((choice, rows)),
            Some(expected) => assert!(*expected == (choice, rows), "{options:?}"),
        }
    }
    let choice = expected.unwrap().0;
    println!("{choice}");
    assert!(choice["voxels"].as_f64().unwrap() >= 6.0, "{choice}");
    // The same rows as with that radius typed in.
    let radius = format!("{}vx", choice["voxels"].as_f64().unwrap());
    run(&radius, &place.text("typed"), &[]);
    assert!(rows("out0") == rows("typed"));
    assert!(summary(&place, "typed")["radius_choice"].is_null());
}

#[test]
fn a_large_volume_is_sampled() {
    let place = Place::with_ball();
    let big = place.text("big.nii");
    curvox(&["shape", "goursat", "--gridstep", "0.14", "-o", &big]).out();
    let plan = [
        "plan",
        &big,
        "--threshold",
        "1",
        "--radius",
        "auto",
        "--json",
    ];
    let choice = curvox(&plan).json()["radius_choice"].clone();
    println!("{choice}");
    assert_eq!(choice["cubes"], 8);
    assert!(choice["surfels"].as_u64().unwrap() > 100_000);
    // the paper's rule says 8 voxels
    assert!((5.0..=10.0).contains(&choice["voxels"].as_f64().unwrap()));
    let first = &choice["tried"][0];
    assert!(first["surfels"].as_u64().unwrap() < 60_000);
}

#[test]
fn samples_of_a_region_are_those_of_the_voxels_in_it() {
    let place = Place::with_ball();
    let goursat = ["shape", "goursat", "--gridstep", "0.14"];
    let choice = |name: &str, options: &[&str], margin: &str| {
        let path = place.text(name);
        curvox(&[&goursat[..], &["--margin", margin, "-o", &path]].concat()).out();
        let plan = [
            "plan",
            &path,
            "--threshold",
            "1",
            "--radius",
            "auto",
            "--json",
        ];
        curvox(&[&plan[..], options].concat()).json()["radius_choice"].clone()
    };
    let whole = choice("whole.nii", &[], "5");
    let told = curvox(&["info", "--json", &place.text("whole.nii")]).json();
    let [x, y, z] = [0, 1, 2].map(|a| told["dims"][a].as_u64().unwrap() + 7);
    let region = format!("--region=7:{x},7:{y},7:{z}");
    let part = choice(
        "wide.nii",
        &[&region, "--memory", "400MiB", "--threads", "1"],
        "12",
    );
    assert_eq!(whole, part);
    assert_eq!(whole["cubes"], 8);
}

#[test]
fn a_body_that_fits_in_the_ball_does_not_choose_it() {
    let place = Place::with_ball();
    let body = place.text("body.nii");
    let shape = ["shape", "ellipsoid:a=6.8,b=4.5,c=3.2", "--gridstep", "1"];
    let where_to = ["--offset", "0.31,-0.17,0.43", "-o", &body];
    curvox(&[&shape[..], &where_to].concat()).out();
    let plan = [
        "plan",
        &body,
        "--threshold",
        "1",
        "--radius",
        "auto",
        "--json",
    ];
    let choice = curvox(&plan).json()["radius_choice"].clone();
    assert_eq!(choice["voxels"], 3.0, "{choice}");
    assert!(
        choice["reason"]
            .as_str()
            .unwrap()
            .contains("smaller than the ball")
    );
}

#[test]
fn radii_that_do_not_fit_the_memory_are_refused_at_once() {
    let place = Place::with_ball();
    let ball = sphere(&place);
    let out = place.text("out");
    let run = [
        "run",
        &ball,
        "--threshold",
        "1",
        "--radius",
        "auto",
        "--memory",
        "200MiB",
    ];
    let said = curvox(&[&run[..], &["-o", &out]].concat()).fails(2);
    assert!(
        said.contains("up to 12vx") && said.contains("--memory"),
        "{said}"
    );
}

#[test]
fn islands_have_no_error_bars() {
    let place = Place::with_ball();
    let noisy = noisy_sphere(&place, "0.1");
    let csv = curvox(&["run", &noisy, "--threshold", "1", "-q", "-o", "-"]).out();
    let text = String::from_utf8(csv).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let (flags, bar) = (column("flags"), column("mean_curvature_error"));
    let mut islands = 0;
    for line in lines {
        let values: Vec<&str> = line.split(',').collect();
        let flags: u16 = values[flags].parse().unwrap();
        // island and degenerate_normal
        let is_none = flags & (4 | 64) != 0;
        islands += u32::from(is_none);
        assert_eq!(
            values[bar].parse::<f64>().unwrap().is_nan(),
            is_none,
            "{line}"
        );
    }
    assert!(islands > 100);
}

#[test]
fn what_cannot_choose_a_radius_says_so() {
    let place = Place::with_ball();
    let ball = place.text("ball.nii");
    let out = place.text("out");
    let auto = ["--threshold", "1", "--radius", "auto", "-o", &out];
    let said = curvox(&[&["run", "-"], &auto[..]].concat())
        .input(&super::ball())
        .fails(2);
    assert!(said.contains("several times"), "{said}");
    for options in [
        &["--method", "paper"][..],
        &["--normals", "ii"],
        &["--normals", "gradient"],
        &["--weights", "lumped"],
    ] {
        let said = curvox(&[&["run", &ball], &auto[..], options].concat()).fails(2);
        assert!(said.contains("--radius auto"), "{said}");
    }
    let both = [
        "run",
        &ball,
        "--threshold",
        "1",
        "--radius",
        "3vx,auto",
        "-o",
        &out,
    ];
    assert!(curvox(&both).fails(2).contains("one radius"));
    assert_eq!(place.names(), ["ball.nii"]);
    // Nothing to look at: the default.
    let nothing = [
        "run",
        &ball,
        "--threshold",
        "2",
        "--radius",
        "auto",
        "-q",
        "-o",
        &out,
    ];
    curvox(&nothing).out();
    let choice = summary(&place, "out")["radius_choice"].clone();
    assert_eq!(choice["voxels"], 6.0);
    assert!(choice["reason"].as_str().unwrap().contains("default"));
}
