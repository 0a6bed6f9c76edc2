//! Figures, on request: `cargo test --release -p curvox encode_cost -- --ignored --nocapture`.

use std::time::Instant;

use super::*;

#[test]
#[ignore = "prints figures; run it in release mode"]
fn encode_cost() {
    let info = info([440, 440, 440], 1, false);
    let rows = wavy_ball(&info);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let per_row = |start: Instant| start.elapsed().as_nanos() as f64 / rows.len() as f64;
    println!("{} rows", rows.len());

    let mut table = DatasetSink::create(folder.path(), info.clone(), None).unwrap();
    let start = Instant::now();
    pool.install(|| {
        send(&mut table, &rows, &info, &[]);
        table.finish().unwrap();
    });
    let bytes: u64 = table.parts_done().iter().map(|part| part.bytes).sum();
    let size = bytes as f64 / rows.len() as f64;
    println!(
        "table: {:.1} ns and {size:.2} bytes a row, one thread",
        per_row(start)
    );

    let mut summary = SummarySink::new(info.clone()).unwrap();
    let start = Instant::now();
    send(&mut summary, &rows, &info, &[]);
    println!("summary: {:.1} ns a row", per_row(start));

    let path = folder.path().join("rows.csv");
    let mut csv = SingleSink::csv_file(&path, info.clone()).unwrap();
    let start = Instant::now();
    send(&mut csv, &rows, &info, &[]);
    csv.finish().unwrap();
    let size = std::fs::metadata(&path).unwrap().len() as f64 / rows.len() as f64;
    println!("csv: {:.1} ns and {size:.1} bytes a row", per_row(start));

    let options = SliceOptions {
        selection: "all".parse().unwrap(),
        palette: Palette::BlueRed,
        range: None,
        budget_bytes: None,
    };
    let mut slices = SliceSink::create(folder.path(), info.clone(), &options).unwrap();
    let start = Instant::now();
    pool.install(|| {
        send(&mut slices, &rows, &info, &[]);
        slices.finish().unwrap();
    });
    println!(
        "slices: {:.1} ns a row, {:.2?} a slice",
        per_row(start),
        start.elapsed() / 440
    );

    let schema = columns::schema(&info);
    for (i, size) in column_sizes(folder.path()).into_iter().enumerate() {
        println!(
            "  {}: {:.2} bytes",
            schema.field(i).name(),
            size as f64 / rows.len() as f64
        );
    }
}

/// Compressed bytes of each column over all parts.
fn column_sizes(folder: &Path) -> Vec<i64> {
    use ::parquet::file::reader::{FileReader, SerializedFileReader};
    let mut sizes = Vec::new();
    for path in part_files(folder) {
        let reader = SerializedFileReader::new(std::fs::File::open(path).unwrap()).unwrap();
        for group in reader.metadata().row_groups() {
            sizes.resize(group.num_columns(), 0);
            for (size, column) in sizes.iter_mut().zip(group.columns()) {
                *size += column.compressed_size();
            }
        }
    }
    sizes
}
