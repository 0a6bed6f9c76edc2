use std::path::Path;
use std::sync::Arc;

use arrow_array::{
    ArrayRef, Float32Array, Float64Array, Int8Array, Int32Array, Int64Array, RecordBatch,
    UInt8Array, UInt16Array, UInt32Array, UInt64Array,
};
use curvox::sink::{Check, OutputInfo, SurfelBatch};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, GzipLevel, ZstdLevel};
use parquet::file::metadata::{ParquetMetaDataReader, ParquetMetaDataWriter};
use parquet::file::properties::{EnabledStatistics, WriterProperties};

use super::{Place, curvox, read};
use crate::common::{Collected, Random};

const BALL: [&str; 2] = ["--threshold", "1"];

/// Runs on the ball of a place with further options, into a single Parquet file.
fn run(place: &Place, name: &str, options: &[&str]) -> SurfelBatch {
    let (ball, out) = (place.text("ball.nii"), place.text(name));
    let arguments = [
        &["run", &ball, "-o", &out, "--quiet", "--overwrite"],
        &BALL[..],
        options,
    ];
    curvox(&arguments.concat()).out();
    rows(&place.path(name))
}

/// The same, which must fail with this code; what it said.
fn fails(place: &Place, options: &[&str], code: i32) -> String {
    let (ball, out) = (place.text("ball.nii"), place.text("never.parquet"));
    let arguments = [&["run", &ball, "-o", &out], &BALL[..], options];
    let said = curvox(&arguments.concat()).fails(code);
    assert!(!place.path("never.parquet").exists());
    said
}

fn rows(path: &Path) -> SurfelBatch {
    let info = OutputInfo::open(path, Check::Footers).unwrap();
    Collected(info.into_rows().map(Result::unwrap).collect()).joined()
}

/// A row of a table of normals.
#[derive(Clone, Copy)]
struct Row {
    k: [i32; 3],
    side: i8,
    normal: [f32; 3],
}

fn normals_of(rows: &SurfelBatch) -> Vec<Row> {
    (0..rows.len())
        .map(|i| Row {
            k: [0, 1, 2].map(|a| rows.k[a][i]),
            side: rows.side[i],
            normal: [0, 1, 2].map(|a| rows.normal[a][i]),
        })
        .collect()
}

fn write(path: &Path, columns: Vec<(&str, ArrayRef)>, statistics: bool, group: usize) {
    write_in(Compression::UNCOMPRESSED, path, columns, statistics, group);
}

fn write_in(
    codec: Compression,
    path: &Path,
    columns: Vec<(&str, ArrayRef)>,
    statistics: bool,
    group: usize,
) {
    let batch = RecordBatch::try_from_iter_with_nullable(
        columns.into_iter().map(|(name, array)| (name, array, true)),
    )
    .unwrap();
    let level = if statistics {
        EnabledStatistics::Chunk
    } else {
        EnabledStatistics::None
    };
    let properties = WriterProperties::builder()
        .set_max_row_group_row_count(Some(group))
        .set_statistics_enabled(level)
        .set_compression(codec)
        .build();
    let file = std::fs::File::create(path).unwrap();
    let mut writer = ArrowWriter::try_new(file, batch.schema(), Some(properties)).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
}

fn columns(rows: &[Row]) -> Vec<(&'static str, ArrayRef)> {
    let k = |a: usize| -> ArrayRef {
        Arc::new(Int32Array::from_iter_values(rows.iter().map(|r| r.k[a])))
    };
    let n = |a: usize| -> ArrayRef {
        Arc::new(Float32Array::from_iter_values(
            rows.iter().map(|r| r.normal[a]),
        ))
    };
    let side: ArrayRef = Arc::new(Int8Array::from_iter_values(rows.iter().map(|r| r.side)));
    vec![
        ("kx", k(0)),
        ("ky", k(1)),
        ("kz", k(2)),
        ("side", side),
        ("nx", n(0)),
        ("ny", n(1)),
        ("nz", n(2)),
    ]
}

/// The ball with its axes turned in the world, by angles of cosines 0.6 and 0.28.
fn turned(ball: &[u8]) -> Vec<u8> {
    let mut turned = ball.to_vec();
    let rows = [
        [0.6, -0.8 * 0.28, 0.8 * 0.96],
        [0.8, 0.6 * 0.28, -0.6 * 0.96],
        [0.0, 0.96, 0.28],
    ];
    for (r, row) in rows.iter().enumerate() {
        for (c, cosine) in row.iter().enumerate() {
            // voxels of 0.5; the matrix of NIfTI begins at byte 280
            let at = 280 + 16 * r + 4 * c;
            turned[at..at + 4].copy_from_slice(&(0.5 * *cosine as f32).to_le_bytes());
        }
    }
    turned
}

#[test]
fn normals_given_back_give_the_same_curvatures() {
    let place = Place::with_ball();
    given_back(&place);
    let ball = turned(&read(&place.path("ball.nii")));
    std::fs::write(place.path("ball.nii"), ball).unwrap();
    given_back(&place);
}

fn given_back(place: &Place) {
    let first = run(place, "first.parquet", &["--radius", "4vx"]);
    let again = run(
        place,
        "again.parquet",
        &[
            "--radius",
            "4vx",
            "--normals-from",
            &place.text("first.parquet"),
        ],
    );
    assert_eq!(first.k, again.k);
    assert_eq!(first.side, again.side);
    // u is rounded to f32 in between: what follows differs by as much.
    let close = |a: &[f32], b: &[f32], bound: f32| {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= bound));
    };
    for a in 0..3 {
        close(&first.normal[a], &again.normal[a], 1.2e-7);
    }
    close(&first.area, &again.area, 1e-7);
    let (c, d) = (&first.curvatures[0], &again.curvatures[0]);
    close(&c.mean, &d.mean, 1e-6);
    close(&c.gaussian, &d.gaussian, 1e-6);
    close(&c.k1, &d.k1, 1e-6);
    close(&c.k2, &d.k2, 1e-6);
    assert_eq!(c.flags, d.flags);
}

#[test]
fn normals_in_any_order_type_and_cut_give_the_same_bytes() {
    let place = Place::with_ball();
    let first = run(&place, "first.parquet", &["--normals", "average"]);
    let mut given = normals_of(&first);
    let made = |table: &str, name: &str, options: &[&str]| {
        let table = place.text(table);
        run(
            &place,
            name,
            &[&["--normals-from", &table], options].concat(),
        );
        read(&place.path(name))
    };
    let expected = made("first.parquet", "a.parquet", &[]);
    assert!(
        made(
            "first.parquet",
            "b.parquet",
            &["--brick", "16", "--threads", "3"]
        ) == expected
    );
    assert!(
        made(
            "first.parquet",
            "c.parquet",
            &["--brick", "8", "--threads", "1"]
        ) == expected
    );

    // Sorted, in row groups of which few meet a slab.
    write(&place.path("groups.parquet"), columns(&given), true, 500);
    assert!(made("groups.parquet", "d.parquet", &["--brick", "8"]) == expected);

    // Out of order, without statistics, as i64 and f64, of any length, with columns of others.
    let mut random = Random(3);
    for i in (1..given.len()).rev() {
        given.swap(i, (random.next() * (i + 1) as f64) as usize);
    }
    let mut all = columns(&given);
    for (a, column) in ["kx", "ky", "kz"].into_iter().enumerate() {
        let k = given.iter().map(|r| i64::from(r.k[a]));
        all[a] = (column, Arc::new(Int64Array::from_iter_values(k)));
    }
    all[3].1 = Arc::new(Int64Array::from_iter_values(
        given.iter().map(|r| r.side.into()),
    ));
    for (a, column) in ["nx", "ny", "nz"].into_iter().enumerate() {
        let n = given.iter().map(|r| f64::from(r.normal[a]) * 0.25);
        all[4 + a] = (column, Arc::new(Float64Array::from_iter_values(n)));
    }
    all.reverse();
    all.push(("else", Arc::new(Int8Array::from(vec![0; given.len()]))));
    write(&place.path("shuffled.parquet"), all, false, 700);
    assert!(made("shuffled.parquet", "e.parquet", &["--brick", "16"]) == expected);

    // The directory of a run.
    let (ball, out) = (place.text("ball.nii"), place.text("out"));
    let ways = ["run", &ball, "-o", &out, "--normals", "average", "--quiet"];
    curvox(&[&ways[..], &BALL].concat()).out();
    assert!(made("out", "f.parquet", &[]) == expected);
    // Snappy is what most tools of tables write unless told otherwise.
    for codec in [
        Compression::SNAPPY,
        Compression::GZIP(GzipLevel::default()),
        Compression::LZ4,
        Compression::LZ4_RAW,
        Compression::ZSTD(ZstdLevel::default()),
    ] {
        let path = place.path("coded.parquet");
        write_in(codec, &path, columns(&given), true, 500);
        assert!(
            made("coded.parquet", "g.parquet", &[]) == expected,
            "{codec}"
        );
    }
}

/// Whole numbers as unsigned ones of some width.
fn unsigned(values: impl Iterator<Item = i32>, bits: usize) -> ArrayRef {
    let values: Vec<u64> = values.map(|k| u64::try_from(k).unwrap()).collect();
    match bits {
        8 => Arc::new(UInt8Array::from_iter_values(
            values.iter().map(|&k| k as u8),
        )),
        16 => Arc::new(UInt16Array::from_iter_values(
            values.iter().map(|&k| k as u16),
        )),
        32 => Arc::new(UInt32Array::from_iter_values(
            values.iter().map(|&k| k as u32),
        )),
        _ => Arc::new(UInt64Array::from(values)),
    }
}

#[test]
fn unsigned_columns_are_whole_numbers_too() {
    let place = Place::with_ball();
    let first = run(&place, "first.parquet", &[]);
    let given = normals_of(&first);
    let table = place.text("given.parquet");
    let again = ["--normals-from", &table, "--brick", "8"];
    write(&place.path("given.parquet"), columns(&given), true, 500);
    run(&place, "signed.parquet", &again);
    let expected = read(&place.path("signed.parquet"));
    let names = ["kx", "ky", "kz"];
    for bits in [8, 16, 32, 64] {
        let mut all = columns(&given);
        for a in 0..3 {
            all[a] = (names[a], unsigned(given.iter().map(|r| r.k[a]), bits));
        }
        write(&place.path("given.parquet"), all, true, 500);
        run(&place, "unsigned.parquet", &again);
        assert!(
            read(&place.path("unsigned.parquet")) == expected,
            "{bits} bits"
        );
    }
    // Of 32 bits, beyond those of signed ones: no surfel, and no trouble with the statistics.
    let mut all = columns(&given);
    let far = [[1, 1, u32::MAX], [u32::MAX, 1, 2]];
    for a in 0..3 {
        let k = given.iter().map(|r| r.k[a] as u32);
        let k = k.chain(far.map(|k| k[a]));
        all[a].1 = Arc::new(UInt32Array::from_iter_values(k));
    }
    let sides = given.iter().map(|r| r.side).chain([1; 2]);
    all[3].1 = Arc::new(Int8Array::from_iter_values(sides));
    for a in 0..3 {
        let n = given.iter().map(|r| r.normal[a]).chain([1.0; 2]);
        all[4 + a].1 = Arc::new(Float32Array::from_iter_values(n));
    }
    write(&place.path("given.parquet"), all, true, 100_000);
    run(&place, "unsigned.parquet", &again);
    assert!(read(&place.path("unsigned.parquet")) == expected);
    // A number that no signed one holds.
    let mut all = columns(&given);
    let mut k: Vec<u64> = given.iter().map(|r| r.k[0] as u64).collect();
    k[77] = u64::MAX;
    all[0].1 = Arc::new(UInt64Array::from(k));
    write(&place.path("given.parquet"), all, true, 100_000);
    let text = fails(&place, &again, 3);
    assert!(text.contains("row 77, column kx"), "{text}");
}

/// Has the footer of a table name Brotli, whose writer is not here, as the codec of its last group.
fn name_brotli_in_last_group(path: &Path) {
    let mut bytes = read(path);
    let metadata = ParquetMetaDataReader::new()
        .parse_and_finish(&std::fs::File::open(path).unwrap())
        .unwrap();
    let mut groups = metadata.row_groups().to_vec();
    assert!(groups.len() > 1);
    let last = groups.pop().unwrap();
    let columns = last.columns().iter().map(|column| {
        let codec = Compression::BROTLI(Default::default());
        let column = column.clone().into_builder().set_compression(codec);
        column.build().unwrap()
    });
    let columns = columns.collect();
    let last = last.into_builder().set_column_metadata(columns);
    groups.push(last.build().unwrap());
    let changed = metadata.into_builder().set_row_groups(groups).build();
    let size = u32::from_le_bytes(*bytes[..bytes.len() - 4].last_chunk().unwrap());
    bytes.truncate(bytes.len() - 8 - size as usize);
    ParquetMetaDataWriter::new(&mut bytes, &changed)
        .finish()
        .unwrap();
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_codec_that_is_not_read_is_refused_before_anything_is_written() {
    let place = Place::with_ball();
    let first = run(&place, "first.parquet", &[]);
    let given = normals_of(&first);
    let path = place.path("given.parquet");
    write(&path, columns(&given), true, 1000);
    name_brotli_in_last_group(&path);
    let (ball, table) = (place.text("ball.nii"), place.text("given.parquet"));
    let options = ["--normals-from", &table, "--threshold", "1"];
    let text = curvox(&[&["plan", &ball], &options[..]].concat()).fails(3);
    assert!(text.contains("compressed with brotli"), "{text}");
    let before = read(&place.path("first.parquet"));
    let out = place.text("first.parquet");
    let again = ["run", &ball, "--overwrite", "-o", &out];
    curvox(&[&again, &options[..]].concat()).fails(3);
    assert!(read(&place.path("first.parquet")) == before);
}

#[test]
fn a_table_that_is_no_parquet_is_refused_by_what_it_begins_with() {
    let place = Place::with_ball();
    let (ball, csv) = (place.text("ball.nii"), place.text("first.csv"));
    let asked = ["run", &ball, "--threshold", "1", "--quiet", "-o", &csv];
    curvox(&asked).out();
    let text = fails(&place, &["--normals-from", &csv], 3);
    assert!(text.contains("Parquet") && text.contains("CSV"), "{text}");
    std::fs::write(place.path("none.csv"), b"").unwrap();
    let text = fails(&place, &["--normals-from", &place.text("none.csv")], 3);
    assert!(text.contains("Parquet"), "{text}");
}

/// Replaces the ball by itself with noise, its first axis towards -x of the world if asked.
fn noisy(place: &Place, is_mirrored: bool) {
    let ball = place.text("ball.nii");
    let noise = ["noise", &ball, "--threshold", "1", "--noise", "0.2"];
    let mut noisy = curvox(&noise).out();
    if is_mirrored {
        noisy[280..284].copy_from_slice(&(-0.5f32).to_le_bytes());
    }
    std::fs::write(place.path("ball.nii"), noisy).unwrap();
}

#[test]
fn the_sign_of_the_quality_is_that_of_the_world() {
    let rows = [false, true].map(|is_mirrored| {
        let place = Place::with_ball();
        noisy(&place, is_mirrored);
        let options = ["--quality", "--normals", "ii", "--radius", "3vx"];
        run(&place, "rows.parquet", &options)
    });
    let [a, b] = rows.each_ref().map(|rows| &rows.curvatures[0]);
    // Rows without area have no values.
    let same = |a: f32, b: f32| a == b || a.is_nan() && b.is_nan();
    assert!(a.mean.iter().zip(&b.mean).all(|(a, b)| same(*a, *b)));
    assert!(a.quality.iter().any(|q| *q > 0.05));
    assert!(a.quality.iter().zip(&b.quality).all(|(a, b)| same(*a, -b)));
}

#[test]
fn what_is_said_of_opposed_normals_is_about_those_asked_for() {
    let place = Place::with_ball();
    noisy(&place, false);
    let (ball, out) = (place.text("ball.nii"), place.text("out.parquet"));
    let asked = ["run", &ball, "--threshold", "1", "-o", &out, "--overwrite"];
    for (normals, helps) in [("gradient", "--sigma"), ("ii", "normal radius")] {
        let said = curvox(&[&asked[..], &["--normals", normals]].concat())
            .end()
            .err;
        assert!(said.contains("`normal_opposed`"), "{said}");
        for other in ["--sigma", "normal radius"] {
            assert_eq!(said.contains(other), helps == other, "{said}");
        }
    }
}

/// What a run says at its end.
fn said(place: &Place, options: &[&str]) -> String {
    let (ball, out) = (place.text("ball.nii"), place.text("said.parquet"));
    let asked = ["run", &ball, "-o", &out, "--overwrite"];
    let ended = curvox(&[&asked[..], &BALL, options].concat()).end();
    assert_eq!(ended.code, 0, "{}", ended.err);
    ended.err
}

#[test]
fn normals_that_are_reversed_or_missing_are_said_with_the_reason() {
    let place = Place::with_ball();
    let first = run(&place, "first.parquet", &[]);
    let mut given = normals_of(&first);
    for row in &mut given {
        row.normal = row.normal.map(|x| -x);
    }
    write(&place.path("in.parquet"), columns(&given), true, 100_000);
    let text = said(&place, &["--normals-from", &place.text("in.parquet")]);
    assert!(text.contains("reverse them"), "{text}");
    let text = said(&place, &["--normals-from", &place.text("first.parquet")]);
    assert!(!text.contains("reverse them"), "{text}");

    // The ball is smaller than the ball of its normals.
    let wide = ["--normals", "average", "--normal-radius", "38vx"];
    let text = said(&place, &wide);
    assert!(
        text.contains("`degenerate_normal`") && text.contains("island"),
        "{text}"
    );
    // All outside of the small range is inside, so the border is closed by caps.
    let outside = ["--normals", "gradient", "--closed", "--radius", "2vx"];
    let (ball, out) = (place.text("ball.nii"), place.text("out.parquet"));
    let asked = ["run", &ball, "-o", &out, "--below", "1"];
    let text = curvox(&[&asked[..], &outside].concat()).end().err;
    assert!(
        text.contains("`degenerate_normal`") && text.contains("--closed"),
        "{text}"
    );
    assert!(text.contains("looks like a mask"), "{text}");
    let text = said(&place, &["--closed"]);
    assert!(!text.contains("`degenerate_normal`"), "{text}");
    assert!(!text.contains("mask"), "{text}");
}

#[test]
fn gradients_of_a_mask_are_warned_of_and_those_of_grey_values_are_not() {
    let place = Place::with_ball();
    let text = said(&place, &["--normals", "gradient"]);
    assert!(
        text.contains("is 1 inside every surfel and 0 outside"),
        "{text}"
    );
    let (grey, out) = (place.text("grey.nii"), place.text("grey.parquet"));
    let shape = ["shape", "sphere:radius=9", "--gridstep", "0.5", "--partial"];
    curvox(&[&shape[..], &["-o", &grey]].concat()).out();
    let asked = ["run", &grey, "--threshold", "32768", "-o", &out];
    let ended = curvox(&[&asked[..], &["--normals", "gradient"]].concat()).end();
    assert_eq!(ended.code, 0, "{}", ended.err);
    assert!(!ended.err.contains("mask"), "{}", ended.err);
    assert!(
        ended.err.contains("gradient of sigma 1.5vx"),
        "{}",
        ended.err
    );
}

#[test]
fn a_table_of_another_threshold_or_grid_says_so_where_a_row_is_missing() {
    let place = Place::with_ball();
    let (other, table) = (place.text("other.nii"), place.text("other.parquet"));
    let shape = [
        "shape",
        "sphere:radius=9",
        "--gridstep",
        "0.6",
        "-o",
        &other,
    ];
    curvox(&shape).out();
    curvox(&["run", &other, "--range", "1..1", "--quiet", "-o", &table]).out();
    let text = fails(&place, &["--normals-from", &table], 3);
    for word in [
        "found no row (",
        "the table has",
        "dims",
        "spacing",
        "inside",
    ] {
        assert!(text.contains(word), "{word}: {text}");
    }
    assert!(!text.contains("closed"), "{text}");
    // Without metadata of an image.
    let rows = normals_of(&rows(&place.path("other.parquet")));
    write(&place.path("other.parquet"), columns(&rows), true, 100_000);
    let text = fails(&place, &["--normals-from", &table], 3);
    assert!(text.contains("of another image or threshold"), "{text}");
}

#[test]
fn rows_of_no_surfel_are_counted() {
    let place = Place::with_ball();
    let first = run(&place, "first.parquet", &[]);
    let mut given = normals_of(&first);
    let n = [1.0, 0.0, 0.0];
    let side = -given[7].side;
    given.push(Row { side, ..given[7] });
    for k in [
        [1, 1, 1],
        [2, 2, 1],
        [-4, 1, 1],
        [1, 1, 4000],
        [3, 3, 2],
        [i32::MAX, 1, 3],
    ] {
        given.push(Row {
            k,
            side: 1,
            normal: n,
        });
    }
    write(&place.path("more.parquet"), columns(&given), true, 100_000);
    let (ball, more, out) = (
        place.text("ball.nii"),
        place.text("more.parquet"),
        place.text("out"),
    );
    let asked = [
        "run",
        &ball,
        "-o",
        &out,
        "--normals-from",
        &more,
        "--brick",
        "8",
    ];
    let ended = curvox(&[&asked[..], &BALL].concat()).end();
    assert_eq!(ended.code, 0, "{}", ended.err);
    assert_eq!(
        ended.err.matches("7 rows of the given normals").count(),
        1,
        "{}",
        ended.err
    );
}

#[test]
fn bad_tables_are_errors_that_say_where() {
    let place = Place::with_ball();
    let first = run(&place, "first.parquet", &[]);
    let given = normals_of(&first);
    let path = place.text("bad.parquet");
    let said = |columns: Vec<(&str, ArrayRef)>| {
        write(&place.path("bad.parquet"), columns, true, 1000);
        let said = fails(&place, &["--normals-from", &path, "--brick", "16"], 3);
        assert!(said.contains("bad.parquet"), "{said}");
        said
    };
    let changed = |change: &dyn Fn(&mut Vec<Row>)| {
        let mut rows = given.clone();
        change(&mut rows);
        said(columns(&rows))
    };
    let [x, y, z] = given[1234].k;

    let text = changed(&|rows| {
        rows.remove(1234);
    });
    assert!(
        text.contains(&format!("surfel {x} {y} {z} of side")),
        "{text}"
    );
    let text = changed(&|rows| rows.push(rows[1234]));
    let twice = format!("row {}: found surfel {x} {y} {z}", given.len());
    assert!(
        text.contains(&twice) && text.contains("row 1234 of"),
        "{text}"
    );
    for bad in [[0.0; 3], [f32::NAN, 0.0, 1.0], [f32::INFINITY, 0.0, 1.0]] {
        let text = changed(&|rows| rows[1234].normal = bad);
        assert!(text.contains("row 1234: found the normal ("), "{text}");
    }
    let text = changed(&|rows| rows[1234].side = 0);
    assert!(text.contains("row 1234: found side 0"), "{text}");
    let text = changed(&Vec::clear);
    assert!(text.contains("found no row"), "{text}");

    let all = columns(&given);
    for i in 0..all.len() {
        let mut fewer = all.clone();
        let (name, _) = fewer.remove(i);
        let text = said(fewer);
        assert!(
            text.contains(&format!("column {name}: found none")),
            "{text}"
        );
        let mut nulls = all.clone();
        let there = |row: usize| row != 2345;
        nulls[i].1 = match i {
            0..3 => {
                let k = |(row, r): (usize, &Row)| there(row).then_some(r.k[i]);
                Arc::new(given.iter().enumerate().map(k).collect::<Int32Array>())
            }
            3 => {
                let side = |(row, r): (usize, &Row)| there(row).then_some(r.side);
                Arc::new(given.iter().enumerate().map(side).collect::<Int8Array>())
            }
            _ => {
                let n = |(row, r): (usize, &Row)| there(row).then_some(r.normal[i - 4]);
                Arc::new(given.iter().enumerate().map(n).collect::<Float32Array>())
            }
        };
        let text = said(nulls);
        assert!(text.contains(&format!("row 2345, column {name}")), "{text}");
        let mut other = all.clone();
        let words = (0..given.len()).map(|_| Some("one"));
        other[i].1 = Arc::new(words.collect::<arrow_array::StringArray>());
        assert!(said(other).contains(&format!("column {name}: found Utf8")));
    }

    let whole = read(&place.path("first.parquet"));
    std::fs::write(place.path("cut.parquet"), &whole[..whole.len() / 2]).unwrap();
    fails(&place, &["--normals-from", &place.text("cut.parquet")], 3);
    let text = fails(&place, &["--normals-from", &place.text("none.parquet")], 3);
    assert!(text.contains("none.parquet"), "{text}");
    fails(&place, &["--normals-from", &place.text("ball.nii")], 3);
    fails(
        &place,
        &["--normals-from", place.path("").to_str().unwrap()],
        3,
    );
}

#[test]
fn the_table_of_normals_is_not_written_over() {
    let place = Place::with_ball();
    let (ball, out) = (place.text("ball.nii"), place.text("out"));
    let asked = ["run", &ball, "--quiet", "--overwrite", "-o", &out];
    let asked = [&asked[..], &BALL].concat();
    curvox(&asked).out();
    let part = place.text("out/surfels/part-00000.parquet");
    let before = read(Path::new(&part));
    for table in [&out, &part] {
        let said = curvox(&[&asked[..], &["--normals-from", table]].concat()).fails(2);
        assert!(said.contains("--normals-from"), "{said}");
        assert!(read(Path::new(&part)) == before);
    }
}

#[test]
fn a_table_of_another_image_is_an_error() {
    let place = Place::with_ball();
    let ball = place.text("ball.nii");
    // Nothing is inside: a table without a row, and a directory without a part.
    for name in ["none.parquet", "none"] {
        let none = place.text(name);
        curvox(&["run", &ball, "--threshold", "2", "--quiet", "-o", &none]).out();
        let said = fails(&place, &["--normals-from", &none], 3);
        assert!(said.contains("found no row"), "{said}");
        let (out, again) = (
            place.text(&format!("{name}.csv")),
            ["--normals-from", &none],
        );
        let asked = ["run", &ball, "--threshold", "2", "--quiet", "-o", &out];
        curvox(&[&asked[..], &again].concat()).out();
    }
}

#[test]
fn options_of_other_normals_are_mistakes() {
    let place = Place::with_ball();
    for (options, word) in [
        (&["--normals", "given"][..], "--normals-from"),
        (
            &["--normals", "ii", "--normals-from", "a.parquet"],
            "--normals-from",
        ),
        (
            &["--normals", "gradient", "--normal-radius", "3vx"],
            "--normal-radius",
        ),
        (&["--sigma", "1vx"], "--sigma"),
        (&["--normals", "gradient", "--sigma", "0.1vx"], "0.3"),
        (&["--normals", "gradient", "--sigma", "30vx"], "--sigma"),
        (&["--normals", "gradient", "--sigma", "1um"], "--spacing"),
    ] {
        let text = fails(&place, options, 2);
        assert!(text.contains(word), "{text}");
    }
    let ball = place.text("ball.nii");
    let asked = [
        "run",
        &ball,
        "--label",
        "1",
        "--normals",
        "gradient",
        "-o",
        "never",
    ];
    let text = curvox(&asked).fails(2);
    assert!(text.contains("--label"), "{text}");
}
