use super::curvox;

/// Levels of instructions that a machine may lack.
const LEVELS: [&str; 2] = ["avx2", "avx512"];

#[test]
fn the_instructions_of_the_processor_do_not_show() {
    let ct = concat!(env!("CARGO_MANIFEST_DIR"), "/samples/head-ct.nii.gz");
    for choice in [
        &["--radius", "3vx"][..],
        &["--radius", "4vx", "--normals", "ii", "--quality"],
        &["--radius", "3vx", "--spacing", "1,1,1.5", "--ball", "whole"],
    ] {
        let at = |level: &str| {
            let run = ["run", ct, "--threshold", "500", "-q", "-o", "-"];
            let mut run = curvox(&[&run[..], choice].concat());
            run.command.env("CURVOX_SIMD", level);
            run.end()
        };
        let expected = at("portable");
        assert_eq!(expected.code, 0, "{}", expected.err);
        assert!(expected.out.len() > 100_000);
        for level in LEVELS {
            let found = at(level);
            if found.code == 2 && found.err.contains("this machine has") {
                continue;
            }
            assert_eq!(found.code, 0, "{}", found.err);
            assert!(found.out == expected.out, "{level} {choice:?}");
        }
    }
}

#[test]
fn a_level_that_does_not_exist_is_a_mistake() {
    let mut run = curvox(&["info", "nothing.nii"]);
    run.command.env("CURVOX_SIMD", "sse9");
    let ended = run.end();
    assert_eq!(ended.code, 2);
    assert!(
        ended
            .err
            .contains("CURVOX_SIMD=sse9: expected portable, avx2 or avx512"),
        "{}",
        ended.err
    );
}
