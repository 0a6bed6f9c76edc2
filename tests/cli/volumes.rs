use super::{Place, curvox, read};

fn made(place: &Place, name: &str, arguments: &[&str]) -> Vec<u8> {
    let path = place.text(name);
    curvox(&[arguments, &["-o", &path]].concat()).out();
    read(&place.path(name))
}

#[test]
fn noise_on_a_volume_is_the_noise_of_its_shape() {
    let place = Place::with_ball();
    let ball = place.text("ball.nii");
    let shape = ["shape", "sphere:radius=9", "--gridstep", "0.5"];
    for (p, seed) in [("0.3", "7"), ("0.7", "1"), ("0", "4")] {
        let noise = ["--noise", p, "--seed", seed];
        let expected = curvox(&[&shape[..], &noise].concat()).out();
        let of_volume = [&["noise", &ball, "--threshold", "1"], &noise[..]].concat();
        assert!(made(&place, &format!("{p}.nii"), &of_volume) == expected);
        assert!(curvox(&of_volume).out() == expected);
        // The other way round, from a pipe: 0 is inside, so phases swap and flips stay.
        let from_pipe = [&["noise", "-", "--below", "1"], &noise[..]].concat();
        let swapped = curvox(&from_pipe)
            .input(&read(&place.path("ball.nii")))
            .out();
        let voxels = |file: &[u8]| file[352..].to_vec();
        let sum = voxels(&swapped)
            .into_iter()
            .zip(voxels(&expected))
            .all(|(a, b)| a + b == 1);
        assert!(sum, "{p}");
    }
}

#[test]
fn noise_keeps_the_world_where_the_format_can() {
    let place = Place::new();
    let shape = ["shape", "torus", "--gridstep", "0.5,0.6,0.7"];
    made(&place, "torus.nii", &shape);
    let torus = place.text("torus.nii");
    let asked = [
        "noise",
        &torus,
        "--threshold",
        "1",
        "--spacing",
        "1,2,3um",
        "--noise",
        "0.2",
    ];
    made(&place, "noisy.nii", &asked);
    let info = curvox(&["info", "--json", &place.text("noisy.nii")]).json();
    let text = info.to_string();
    assert!(text.contains("um"), "{text}");
    let nii = read(&place.path("noisy.nii"));
    for name in ["noisy.npy", "noisy.vol", "noisy.raw"] {
        let other = made(&place, name, &asked);
        assert!(other.ends_with(&nii[352..]), "{name}");
    }
    // Any type of voxel, any criterion.
    let grey = [
        "shape",
        "torus",
        "--gridstep",
        "0.5",
        "--partial",
        "--dtype",
        "f32",
    ];
    made(&place, "grey.nii", &grey);
    let grey = place.text("grey.nii");
    let from_grey = ["noise", &grey, "--range", "0.5..2", "--noise", "0.2"];
    let first = curvox(&from_grey).out();
    assert!(first == curvox(&from_grey).out());
    assert!(first != curvox(&[&from_grey[..], &["--seed", "2"]].concat()).out());
    assert!(
        !curvox(&["noise", &grey, "--otsu", "--noise", "0.1"])
            .out()
            .is_empty()
    );
}

#[test]
fn noise_that_cannot_be_made_is_refused() {
    let place = Place::with_ball();
    let ball = place.text("ball.nii");
    let noise = |more: &[&str]| curvox(&[&["noise", &ball], more].concat());
    for (more, code, word) in [
        (&["--noise", "0.2"][..], 2, "--threshold"),
        (&["--threshold", "1"], 2, "--noise"),
        (&["--threshold", "1", "--noise", "0.95"], 2, "0.9"),
        (
            &["--threshold", "1", "--noise", "0.1", "-o", "a.gz"],
            2,
            "gzip",
        ),
        (
            &[
                "--threshold",
                "1",
                "--noise",
                "0.1",
                "--overwrite",
                "-o",
                &ball,
            ],
            2,
            "input itself",
        ),
        (
            &["--threshold", "1", "--noise", "0.1", "-o", "/nowhere/a.nii"],
            1,
            "/nowhere",
        ),
    ] {
        let said = noise(more).fails(code);
        assert!(said.contains(word), "{said}");
    }
    let cut = read(&place.path("ball.nii"));
    std::fs::write(place.path("cut.nii"), &cut[..cut.len() - 100]).unwrap();
    let (from, to) = (place.text("cut.nii"), place.text("to.nii"));
    curvox(&[
        "noise",
        &from,
        "--threshold",
        "1",
        "--noise",
        "0.1",
        "-o",
        &to,
    ])
    .fails(3);
    assert!(!place.path("to.nii").exists());
}

#[test]
fn grey_shapes_have_their_surface_half_way() {
    let place = Place::new();
    let shape = ["shape", "sphere:radius=9", "--gridstep", "0.5", "--partial"];
    let mut surfels = Vec::new();
    for (dtype, threshold, levels) in [
        ("u8", "128", [64.0, 192.0]),
        ("u16", "32768", [16384.0, 49152.0]),
        ("f32", "0.5", [0.0, 1.0]),
    ] {
        let name = format!("{dtype}.nii");
        made(&place, &name, &[&shape[..], &["--dtype", dtype]].concat());
        let path = place.text(&name);
        let values = curvox(&["info", "--json", "--values", &path])
            .json()
            .to_string();
        for level in levels {
            assert!(values.contains(&format!("{level}")), "{values}");
        }
        let out = place.text(dtype);
        let asked = [
            "run",
            &path,
            "--threshold",
            threshold,
            "--normals",
            "gradient",
            "-o",
            &out,
        ];
        curvox(&[&asked[..], &["--radius", "5vx", "--quiet"]].concat()).out();
        let summary = place.summary(dtype);
        surfels.push(summary["rows"].clone());
        let all = &summary["radii"][0]["all"];
        let total = |name: &str| all[name].as_f64().unwrap();
        let mean = total("integral_mean_curvature") / total("area");
        assert!((mean * 9.0 - 1.0).abs() < 0.005, "{mean}");
        assert_eq!(summary["parameters"]["sigma"], "1.5vx");
    }
    assert_eq!(surfels[1], surfels[2]);
    let noisy = [
        &shape[..],
        &["--blur", "1vx", "--grey-noise", "0.1", "--seed", "3"],
    ]
    .concat();
    let first = curvox(&noisy).out();
    assert!(first == curvox(&noisy).out());
    for (more, word) in [
        (&["--blur", "1um"][..], "--blur"),
        (&["--blur", "20vx"], "blur"),
        (&["--grey-noise=-1"], "grey noise"),
        (&["--seed", "3"], "--grey-noise"),
        (&["--noise", "0.1"], "--noise"),
        (&["--dtype", "u16", "--to", "vol"], "vol"),
    ] {
        let said = curvox(&[&shape[..], more].concat()).fails(2);
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn no_half_of_a_volume_is_left() {
    let place = Place::with_ball();
    let whole = read(&place.path("ball.nii"));
    let path = place.text("noisy.nii");
    let asked = ["noise", "-", "--threshold", "1", "--noise", "0.1", "-o"];
    for before in [None, Some(b"what was there")] {
        if let Some(before) = before {
            std::fs::write(&path, before).unwrap();
        }
        let cut = curvox(&[&asked[..], &[&path, "--overwrite"]].concat());
        cut.input(&whole[..whole.len() - 1000]).fails(3);
        assert!(!place.path("noisy.nii").exists(), "{before:?}");
    }
}

#[test]
fn mistakes_are_named_by_the_command_and_option_they_are_of() {
    let place = Place::with_ball();
    let (ball, packed) = (place.text("ball.nii"), place.text("nn.nii.gz"));
    let noise = ["noise", &ball, "--threshold", "1", "-o", &packed];
    let text = curvox(&[&noise[..], &["--noise", "0.1"]].concat()).fails(2);
    assert!(
        text.contains("curvox noise") && text.contains("nn.nii.gz"),
        "{text}"
    );
    let text = curvox(&[&noise[..], &["--noise", "-0.1"]].concat()).fails(2);
    assert!(text.contains("noise probability is -0.1"), "{text}");
    for (options, word) in [
        (&["--gridstep", "0"][..], "--gridstep is 0 along x"),
        (&["--gridstep", "1,-1,1"], "--gridstep is -1 along y"),
        (
            &["--gridstep", "1", "--noise", "-0.1"],
            "noise probability is -0.1",
        ),
        (
            &["--gridstep", "1", "--partial", "--blur", "0.5mm"],
            "write it in voxels",
        ),
        (
            &["--gridstep", "1", "--partial", "--blur", "-1vx"],
            "above 0",
        ),
        (
            &["--gridstep", "1", "--partial", "--grey-noise", "-1"],
            "grey noise is -1",
        ),
        (&["--gridstep", "1", "-o", "a.nii.gz"], "curvox shape"),
    ] {
        let text = curvox(&[&["shape", "sphere"], options].concat()).fails(2);
        assert!(text.contains(word), "{text}");
        assert!(!text.contains("--spacing"), "{text}");
    }
}
