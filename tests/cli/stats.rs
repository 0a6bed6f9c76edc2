use super::{Place, curvox};

fn arguments(place: &Place, stats: &str) -> [String; 9] {
    let [ball, out] = [place.text("ball.nii"), place.text("out")];
    [
        "run",
        &ball,
        "--threshold",
        "1",
        "-o",
        &out,
        "--overwrite",
        "-q",
        stats,
    ]
    .map(str::to_owned)
}

#[test]
fn stats_tell_of_every_stage_and_their_numbers_add_up() {
    let place = Place::with_ball();
    let file = place.text("stats.json");
    curvox(&arguments(&place, &format!("--stats={file}"))).out();
    let stats: serde_json::Value =
        serde_json::from_slice(&std::fs::read(place.path("stats.json")).unwrap()).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let stages = stats["stages"].as_array().unwrap();
    let names: Vec<_> = stages.iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["read", "normals", "cells", "sums", "sinks"]);
    let mut cpu = 0.0;
    for stage in stages {
        let parts = ["busy", "input", "memory", "output"];
        let parts = parts.map(|part| number(&stage[format!("{part}_seconds")]));
        let sum: f64 = parts.iter().sum();
        assert!((sum - number(&stage["seconds"])).abs() < 1e-6, "{stage}");
        assert!(number(&stage["seconds"]) <= number(&stats["seconds"]));
        cpu += number(&stage["cpu_seconds"]);
    }
    assert!((cpu - number(&stats["stages_cpu_seconds"])).abs() < 1e-6);
    assert!(cpu > 0.0);
    if let Some(process) = stats["cpu_seconds"].as_f64() {
        // the clocks of threads and of the process are not read at the same moment
        assert!(cpu <= process + 0.1, "{stats}");
    }
    assert_eq!(stats["voxels"], 47 * 47 * 47);
    assert_eq!(
        stats["surfels"],
        place.summary("out")["exact"]["surfels"],
        "{stats}"
    );
    let sinks = stats["sinks"].as_array().unwrap();
    let names: Vec<_> = sinks.iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["totals", "table"]);
    let part = std::fs::metadata(place.path("out/surfels/part-00000.parquet")).unwrap();
    assert_eq!(sinks[1]["bytes"], part.len());
    let memory = &stats["memory"];
    // High slabs take memory that surfels leave, so only the sums compare.
    let [mut most, mut planned] = [0.0; 2];
    for what in ["bits", "surfel"] {
        let of_this = number(&memory[format!("most_{what}_bytes")]);
        assert!(of_this > 0.0, "{what} {memory}");
        most += of_this;
        planned += number(&memory[format!("planned_{what}_bytes")]);
    }
    assert!(most <= planned, "{memory}");
    // Every surfel of so small a volume is in flight at once.
    assert_eq!(
        memory["most_surfel_bytes"].as_u64().unwrap(),
        stats["surfels"].as_u64().unwrap() * memory["bytes_per_surfel"].as_u64().unwrap()
    );
}

#[test]
fn stats_are_a_table_or_a_line_and_never_among_the_results() {
    let place = Place::with_ball();
    let table = curvox(&arguments(&place, "--stats")).end();
    assert_eq!(table.code, 0, "{}", table.err);
    for word in [
        "read",
        "sums",
        "waits",
        "GB/s",
        "ns a surfel",
        "in flight",
        "bytes a surfel",
    ] {
        assert!(table.err.contains(word), "{word}: {}", table.err);
    }
    let mut with_json = arguments(&place, "--stats").to_vec();
    with_json.push("--json".into());
    let lines = curvox(&with_json).end();
    let line = lines.err.lines().last().unwrap();
    let line: serde_json::Value = serde_json::from_str(line).unwrap();
    assert_eq!(line["event"], "stats");
    let refused = place.text("out/stats.json");
    let said = curvox(&arguments(&place, &format!("--stats={refused}"))).fails(2);
    assert!(said.contains("among the results"), "{said}");
    // The input is never written over, and another file only where that is asked for.
    let notes = place.text("notes.txt");
    std::fs::write(&notes, "mine").unwrap();
    let mut careful = arguments(&place, &format!("--stats={notes}")).to_vec();
    careful.retain(|argument| argument != "--overwrite");
    let said = curvox(&careful).fails(1);
    assert!(said.contains("notes.txt: exists already"), "{said}");
    assert_eq!(std::fs::read_to_string(&notes).unwrap(), "mine");
    let input = arguments(&place, "--stats")[1].clone();
    let before = std::fs::read(&input).unwrap();
    let said = curvox(&arguments(&place, &format!("--stats={input}"))).fails(2);
    assert!(said.contains("is an input"), "{said}");
    assert_eq!(std::fs::read(&input).unwrap(), before);
    // What cannot be written is said before the run.
    let nowhere = place.text("nowhere/stats.json");
    let said = curvox(&arguments(&place, &format!("--stats={nowhere}"))).fails(1);
    assert!(said.contains("cannot be written"), "{said}");
    // Without it nothing is said.
    assert_eq!(curvox(&arguments(&place, "-q")[..8]).end().err, "");
}
