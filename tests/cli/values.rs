use serde_json::Value;

use super::{Place, curvox};

/// A raw ball of u16, 100 outside and 900 inside, 31 voxels wide.
fn raw_ball(place: &Place, big: bool) -> String {
    let mut bytes = vec![0xab; 5];
    for i in 0..31i32 * 31 * 31 {
        let [x, y, z] = [i % 31 - 15, i / 31 % 31 - 15, i / 961 - 15];
        let value: u16 = if x * x + y * y + z * z <= 144 {
            900
        } else {
            100
        };
        bytes.extend(if big {
            value.to_be_bytes()
        } else {
            value.to_le_bytes()
        });
    }
    std::fs::write(place.path("ball.raw"), bytes).unwrap();
    place.text("ball.raw")
}

fn summary_of(place: &Place, input: &str, more: &[&str]) -> Value {
    let out = place.text("out");
    let mut arguments = vec!["run", input, "-o", &out, "-q", "--overwrite"];
    arguments.extend(more);
    curvox(&arguments).out();
    place.summary("out")
}

const RAW: [&str; 6] = ["--dims", "31,31,31", "--dtype", "u16be", "--skip", "5"];

#[test]
fn a_radius_is_the_same_in_every_unit() {
    let place = Place::new();
    let input = raw_ball(&place, true);
    // 0.05 mm voxels: 4 voxels are 0.2 mm or 200 um
    let mean = |spacing: &str, radius: &str| {
        let mut more = RAW.to_vec();
        more.extend([
            "--threshold",
            "500",
            "--spacing",
            spacing,
            "--radius",
            radius,
        ]);
        let summary = summary_of(&place, &input, &more);
        let radius = &summary["radii"][0];
        (
            radius["voxels"].as_f64().unwrap(),
            radius["mean_curvature"]["mean"].as_f64().unwrap(),
            summary["unit"].as_str().unwrap().to_owned(),
        )
    };
    let (voxels, curvature, unit) = mean("0.05mm", "4vx");
    assert_eq!((voxels, unit.as_str()), (4.0, "mm"));
    assert!((curvature * 0.6 - 1.0).abs() < 0.05, "{curvature}");
    for radius in ["0.2mm", "200um", "2e-4m", "0.02cm"] {
        let (other, same, _) = mean("0.05mm", radius);
        assert!((other - 4.0).abs() < 1e-9, "{radius}");
        assert!((same / curvature - 1.0).abs() < 1e-6, "{radius}");
    }
    let (_, in_um, unit) = mean("50um", "0.2mm");
    assert_eq!(unit, "um");
    assert!((in_um * 1000.0 / curvature - 1.0).abs() < 1e-6, "{in_um}");
}

#[test]
fn without_a_voxel_size_lengths_are_in_voxels() {
    let place = Place::new();
    let input = raw_ball(&place, true);
    let mut more = RAW.to_vec();
    more.extend(["--threshold", "500"]);
    let summary = summary_of(&place, &input, &more);
    assert_eq!(summary["unit"], "vx");
    more.extend(["--radius", "3um"]);
    let out = place.text("out");
    let mut arguments = vec!["run", &input, "-o", &out];
    arguments.extend(more);
    assert!(curvox(&arguments).fails(2).contains("--spacing"));
}

#[test]
fn every_criterion_finds_the_same_ball() {
    let place = Place::new();
    let input = raw_ball(&place, true);
    let surfels = |criterion: &[&str]| {
        let mut more = RAW.to_vec();
        more.extend(criterion);
        summary_of(&place, &input, &more)["exact"].clone()
    };
    let expected = surfels(&["--threshold", "500"]);
    assert!(expected["surfels"].as_u64().unwrap() > 2000);
    for same in [
        &["--range", "800..1000"][..],
        &["--label", "900"],
        &["--otsu"],
    ] {
        assert_eq!(surfels(same), expected, "{same:?}");
    }
    // The outside: the same surface seen from the other side, open at the border of the image.
    let outside = surfels(&["--below", "500"]);
    assert_eq!(outside["surfels"], expected["surfels"]);
    assert!(outside["mu1"].as_f64().unwrap() < 0.0);
}

#[test]
fn the_threshold_of_otsu_is_reported() {
    let place = Place::new();
    let input = raw_ball(&place, true);
    let out = place.text("out");
    let mut arguments = vec!["run", &input, "-o", &out, "--otsu"];
    arguments.extend(RAW);
    let ended = curvox(&arguments).end();
    assert!(ended.err.contains("900 (Otsu)"), "{}", ended.err);
    assert_eq!(place.summary("out")["parameters"]["inside"], "value >= 900");
    assert_eq!(place.summary("out")["input"]["threshold_by_otsu"], true);
}

#[test]
fn the_paper_is_a_choice_of_options() {
    let place = Place::with_ball();
    let input = place.text("ball.nii");
    let paper = summary_of(&place, &input, &["--threshold", "1", "--method", "paper"]);
    let same = summary_of(
        &place,
        &input,
        &[
            "--threshold",
            "1",
            "--normals",
            "ii",
            "--orientation",
            "dgtal",
            "--weights",
            "dgtal",
            "--ball",
            "connected",
        ],
    );
    assert_eq!(paper, same);
    assert_eq!(paper["parameters"]["weights"], "dgtal");
    let overridden = summary_of(
        &place,
        &input,
        &[
            "--threshold",
            "1",
            "--method",
            "paper",
            "--weights",
            "sharp",
        ],
    );
    assert_eq!(overridden["parameters"]["weights"], "sharp");
    assert_eq!(overridden["parameters"]["orientation"], "dgtal");
}

#[test]
fn bool_voxels_need_no_threshold() {
    let place = Place::new();
    let mut bytes = vec![0u8; 1000];
    bytes[555] = 1;
    std::fs::write(place.path("one.raw"), bytes).unwrap();
    let input = place.text("one.raw");
    let summary = summary_of(&place, &input, &["--dims", "10,10,10", "--dtype", "bool"]);
    assert_eq!(summary["exact"]["surfels"], 6);
    assert_eq!(summary["exact"]["euler_counted"], 2);
}

#[test]
fn warnings_tell_what_to_look_at() {
    let place = Place::new();
    let slab = place.text("plane.nii");
    curvox(&["shape", "plane", "--gridstep", "1", "-o", &slab]).out();
    let warned = |summary: &Value, word: &str| {
        let warnings = summary["warnings"].as_array().unwrap();
        warnings.iter().any(|w| w.as_str().unwrap().contains(word))
    };
    let open = summary_of(&place, &slab, &["--threshold", "1"]);
    assert!(warned(&open, "--closed"), "{}", open["warnings"]);
    let closed = summary_of(&place, &slab, &["--threshold", "1", "--closed"]);
    assert!(!warned(&closed, "--closed"), "{}", closed["warnings"]);
    assert_eq!(closed["exact"]["euler_counted"], 2);
    let empty = summary_of(&place, &slab, &["--threshold", "2"]);
    assert!(
        warned(&empty, "no voxel is inside"),
        "{}",
        empty["warnings"]
    );
    let small = summary_of(&place, &slab, &["--threshold", "1", "--radius", "1.5vx"]);
    assert!(warned(&small, "below 2 voxels"), "{}", small["warnings"]);
}

#[test]
fn conventions_are_in_the_summary() {
    let place = Place::with_ball();
    let summary = summary_of(&place, &place.text("ball.nii"), &["--threshold", "1"]);
    let text = summary["conventions"].to_string();
    for word in ["outward", "H > 0", "open", "2p+1"] {
        assert!(text.contains(word), "{word}");
    }
}
