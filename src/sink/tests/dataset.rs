//! The dataset: parts, bytes, crashes, resumption, reading back.

use std::fs;
use std::io::{self, Write};
use std::sync::Arc;

use proptest::prelude::*;
use tempfile::tempdir;

use super::*;
use crate::sink::parquet::{Encoder, TableFormat};

fn record(folder: &Path, info: &TableInfo) -> Arc<RunRecorder> {
    let parts = Parts::new(info.dims).count();
    let recorder = RunRecorder::create(
        folder,
        "0.1.0",
        json!({"radius": "3vx"}),
        json!("scan"),
        parts,
    );
    Arc::new(recorder.unwrap())
}

/// Writes a whole run without slices and summary.
fn write_run(folder: &Path, info: &TableInfo, rows: &SurfelBatch, cuts: &[usize]) {
    let recorder = record(folder, info);
    let mut sink = DatasetSink::create(folder, info.clone(), Some(Arc::clone(&recorder))).unwrap();
    send(&mut sink, rows, info, cuts);
    sink.finish().unwrap();
    recorder.end(RunState::Complete, None).unwrap();
}

#[test]
fn what_is_written_reads_back() {
    for (radii, directions) in [(1, false), (1, true), (2, true)] {
        let info = info([70, 66, 130], radii, directions);
        let rows = wavy_ball(&info);
        let folder = tempdir().unwrap();
        write_run(folder.path(), &info, &rows, &[100, 2000]);
        let found = OutputInfo::open(folder.path(), Check::Checksums).unwrap();
        found.ensure_complete().unwrap();
        assert_eq!(found.rows, rows.len() as u64);
        assert_eq!(found.table.as_ref(), Some(&info));
        let names: Vec<&str> = found
            .columns
            .iter()
            .map(|(name, _)| name.as_str())
            .collect();
        assert_eq!(names[..5], ["kx", "ky", "kz", "side", "x"]);
        assert!(names.contains(&if radii == 1 { "flags" } else { "k2_4_5vx" }));
        let mut all = SurfelBatch::with_capacity(&info, 0);
        for batch in found.into_rows() {
            let batch = batch.unwrap();
            all.extend_from(&batch, 0..batch.len());
        }
        assert_same_rows(&all, &rows);
    }
}

#[test]
fn parts_hold_exactly_their_box() {
    let info = info([60, 60, 150], 1, false);
    let rows = wavy_ball(&info);
    let folder = tempdir().unwrap();
    write_run(folder.path(), &info, &rows, &[]);
    let run = RunRecord::read(folder.path()).unwrap();
    assert_eq!(run.parts.len(), 3);
    let parts = Parts::new(info.dims);
    let mut total = 0;
    for part in &run.parts {
        let Some(name) = &part.file else { continue };
        let path = folder.path().join(SURFELS_DIRECTORY).join(name);
        let found = OutputInfo::open(&path, Check::Footers).unwrap();
        for batch in found.into_rows() {
            let batch = batch.unwrap();
            total += batch.len();
            assert!((0..batch.len()).all(|row| parts.part_of(batch.k_at(row)) == part.part));
        }
    }
    assert_eq!(total, rows.len());
}

#[test]
fn parts_without_rows_are_listed_and_have_no_file() {
    let info = info([40, 40, 300], 1, false);
    let mut rows = SurfelBatch::with_capacity(&info, 0);
    push_row(&mut rows, &info, [3, 3, 260], 2, 1, &mut Noise(1));
    let folder = tempdir().unwrap();
    write_run(folder.path(), &info, &rows, &[]);
    let run = RunRecord::read(folder.path()).unwrap();
    let files: Vec<_> = run.parts.iter().map(|part| part.file.as_deref()).collect();
    assert_eq!(files, [None, None, Some("part-00002.parquet"), None, None]);
    assert_eq!(part_files(folder.path()).len(), 1);
}

#[test]
fn columns_may_alternate_and_bytes_stay_the_same() {
    // Rows on both sides of the border between two columns of parts.
    let info = info([8300, 3, 200], 1, false);
    let mut noise = Noise(3);
    let mut columns = [0, 1].map(|x| {
        let mut rows = SurfelBatch::with_capacity(&info, 0);
        rows.column = [x, 0];
        for kz in (1..399).step_by(2) {
            for kx in [
                16382 + 2 * x as i32,
                16386 + 2 * x as i32 - 4 * (1 - x as i32),
            ] {
                if rows.is_empty()
                    || (kz, kx) > (rows.k[2][rows.len() - 1], rows.k[0][rows.len() - 1])
                {
                    push_row(&mut rows, &info, [kx, 3, kz], 0, 1, &mut noise);
                }
            }
        }
        rows
    });
    columns[0].column = [0, 0];
    let write = |order: &[(usize, usize, usize)]| {
        let folder = tempdir().unwrap();
        let mut sink = DatasetSink::create(folder.path(), info.clone(), None).unwrap();
        for &(column, from, to) in order {
            let rows = &columns[column];
            sink.write(&piece(
                rows,
                &info,
                from.min(rows.len()),
                to.min(rows.len()),
            ))
            .unwrap();
        }
        sink.finish().unwrap();
        files_below(folder.path())
    };
    let end = usize::MAX;
    let one_after_the_other = write(&[(0, 0, end), (1, 0, end)]);
    assert!(
        one_after_the_other.len() == 8,
        "{:?}",
        one_after_the_other.keys()
    );
    assert!(one_after_the_other == write(&[(1, 0, 50), (0, 0, 120), (1, 50, end), (0, 120, end)]));
}

/// Row groups are long, so cuts are tried on a table of more than one.
#[test]
fn cut_does_not_show_across_row_groups() {
    let info = info([420, 420, 64], 1, false);
    let mut noise = Noise(5);
    let mut rows = SurfelBatch::with_capacity(&info, 0);
    for ky in (1..840).step_by(2) {
        for kx in (1..840).step_by(2) {
            push_row(&mut rows, &info, [kx, ky, 40], 2, 1, &mut noise);
        }
    }
    assert!(rows.len() > ROW_GROUP_ROWS + 1000);
    let write = |cuts: &[usize]| {
        let folder = tempdir().unwrap();
        let mut sink = DatasetSink::create(folder.path(), info.clone(), None).unwrap();
        send(&mut sink, &rows, &info, cuts);
        sink.finish().unwrap();
        files_below(folder.path())
    };
    let whole = write(&[]);
    let cuts: Vec<usize> = (0..rows.len()).step_by(977).collect();
    assert!(whole == write(&cuts));
    assert!(whole == write(&[ROW_GROUP_ROWS - 1, ROW_GROUP_ROWS, ROW_GROUP_ROWS + 1]));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]
    #[test]
    fn cut_does_not_show(cuts in prop::collection::vec(0_usize..12_000, 0..40)) {
        let info = info([30, 28, 140], 2, false);
        let rows = wavy_ball(&info);
        let write = |cuts: &[usize]| {
            let folder = tempdir().unwrap();
            let mut sink = DatasetSink::create(folder.path(), info.clone(), None).unwrap();
            send(&mut sink, &rows, &info, cuts);
            sink.finish().unwrap();
            (files_below(folder.path()), sink.parts_done())
        };
        prop_assert!(write(&[]) == write(&cuts));
    }
}

#[test]
fn a_run_cut_short_leaves_whole_parts_and_no_temporaries() {
    let info = info([60, 60, 150], 1, false);
    let rows = wavy_ball(&info);
    let folder = tempdir().unwrap();
    let recorder = record(folder.path(), &info);
    let mut sink =
        DatasetSink::create(folder.path(), info.clone(), Some(Arc::clone(&recorder))).unwrap();
    let middle = rows.k[2].partition_point(|&kz| kz < 200);
    sink.write(&piece(&rows, &info, 0, middle)).unwrap();
    let hidden = folder
        .path()
        .join(SURFELS_DIRECTORY)
        .join(".part-00001.parquet.partial");
    assert!(hidden.exists());
    drop(sink);
    assert!(!hidden.exists());
    let names: Vec<_> = files_below(folder.path()).into_keys().collect();
    assert_eq!(names, ["run.json", "surfels/part-00000.parquet"]);
    let found = OutputInfo::open(folder.path(), Check::Checksums).unwrap();
    let error = found.ensure_complete().unwrap_err().to_string();
    assert!(
        error.ends_with("the run is under way or was killed: 1 of 3 parts are done"),
        "{error}"
    );
}

#[test]
fn a_resumed_run_leaves_the_same_parts() {
    let info = info([60, 60, 150], 1, false);
    let rows = wavy_ball(&info);
    let whole = tempdir().unwrap();
    write_run(whole.path(), &info, &rows, &[]);
    let folder = tempdir().unwrap();
    let mut sink = DatasetSink::create(
        folder.path(),
        info.clone(),
        Some(record(folder.path(), &info)),
    )
    .unwrap();
    let middle = rows.k[2].partition_point(|&kz| kz < 280);
    sink.write(&piece(&rows, &info, 0, middle)).unwrap();
    sink.advance([0, 0], 260).unwrap();
    drop(sink);
    // Damage one of the two finished parts: it must be written anew.
    let first = folder.path().join("surfels/part-00000.parquet");
    let mut bytes = fs::read(&first).unwrap();
    bytes[1000] ^= 1;
    fs::write(&first, bytes).unwrap();
    let recorder = Arc::new(RunRecorder::resume(folder.path()).unwrap());
    let mut sink =
        DatasetSink::create(folder.path(), info.clone(), Some(Arc::clone(&recorder))).unwrap();
    assert_eq!(
        [0, 1, 2].map(|part| sink.is_kept(part)),
        [false, true, false]
    );
    send(&mut sink, &rows, &info, &[]);
    sink.finish().unwrap();
    recorder.end(RunState::Complete, None).unwrap();
    let surfels = |folder: &Path| files_below(&folder.join(SURFELS_DIRECTORY));
    assert!(surfels(whole.path()) == surfels(folder.path()));
    let parts = |folder: &Path| RunRecord::read(folder).unwrap().parts;
    assert_eq!(parts(whole.path()), parts(folder.path()));
}

#[test]
fn damaged_and_missing_parts_are_errors_with_their_place() {
    let info = info([60, 60, 100], 1, false);
    let folder = tempdir().unwrap();
    write_run(folder.path(), &info, &wavy_ball(&info), &[]);
    let path = folder.path().join("surfels/part-00001.parquet");
    let bytes = fs::read(&path).unwrap();
    let open = |check| {
        OutputInfo::open(folder.path(), check)
            .unwrap_err()
            .to_string()
    };

    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(open(Check::Footers).contains("part-00001.parquet: size: found"));
    let alone = OutputInfo::open(&path, Check::Footers)
        .unwrap_err()
        .to_string();
    assert!(
        alone.contains("part-00001.parquet: footer: found"),
        "{alone}"
    );

    let mut changed = bytes.clone();
    changed[bytes.len() / 3] ^= 0x40;
    fs::write(&path, &changed).unwrap();
    assert!(open(Check::Checksums).contains("part-00001.parquet: checksum: found another"));

    fs::remove_file(&path).unwrap();
    assert!(open(Check::Footers).contains("part-00001.parquet: cannot open"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn damaged_file_is_an_error_not_a_panic(at in 0.0_f64..1.0, bit in 0_u8..8, cut in any::<bool>()) {
        let info = info([16, 16, 16], 1, false);
        let format = TableFormat::new(&info).unwrap();
        let mut encoder = Encoder::new(Vec::new(), &format, &info).unwrap();
        let rows = wavy_ball(&info);
        encoder.push(&rows, 0..rows.len()).unwrap();
        let (mut bytes, _) = encoder.finish().unwrap();
        let at = (at * bytes.len() as f64) as usize;
        if cut { bytes.truncate(at) } else { bytes[at] ^= 1 << bit }
        let folder = tempdir().unwrap();
        let path = folder.path().join("part.parquet");
        fs::write(&path, bytes).unwrap();
        if let Ok(found) = OutputInfo::open(&path, Check::Footers) {
            // A flipped bit may hit a value; then there are rows. What must not happen is a panic.
            found.into_rows().take_while(Result::is_ok).for_each(drop);
        }
    }
}

/// Fails like a full disk after some bytes.
struct FullDisk {
    room: usize,
}

impl Write for FullDisk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.room == 0 {
            return Err(io::Error::from(io::ErrorKind::StorageFull));
        }
        let written = bytes.len().min(self.room);
        self.room -= written;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn full_disk_is_an_error_that_says_what_is_complete() {
    let info = info([40, 40, 40], 1, false);
    let rows = wavy_ball(&info);
    let format = TableFormat::new(&info).unwrap();
    for room in [0, 3, 1000, 20_000] {
        let result = Encoder::new(FullDisk { room }, &format, &info).and_then(|mut encoder| {
            encoder.push(&rows, 0..rows.len())?;
            encoder.finish().map(drop)
        });
        let path = Path::new("out/surfels/part-00003.parquet");
        let error = SinkError::parquet(path, "write", result.unwrap_err())
            .with_note("the parts before it are complete");
        let expected = "out/surfels/part-00003.parquet: no space left on device; \
                        the parts before it are complete";
        assert_eq!(error.to_string(), expected);
    }
}

#[test]
fn rows_out_of_order_or_place_are_refused() {
    let info = info([9000, 40, 40], 1, false);
    let folder = tempdir().unwrap();
    let row = |k: [i32; 3], column| {
        let mut rows = SurfelBatch::with_capacity(&info, 0);
        push_row(&mut rows, &info, k, 0, 1, &mut Noise(1));
        rows.column = column;
        rows
    };
    let sink = || DatasetSink::create(folder.path(), info.clone(), None).unwrap();
    let mut order = sink();
    order.write(&row([4, 3, 3], [0, 0])).unwrap();
    assert!(order.write(&row([2, 3, 3], [0, 0])).is_err());
    assert!(sink().write(&row([4, 3, 3], [1, 0])).is_err());
    assert!(sink().write(&row([4, 3, 3], [0, 7])).is_err());
    let mut ragged = row([4, 3, 3], [0, 0]);
    ragged.curvatures[0].k1.clear();
    assert!(sink().write(&ragged).is_err());
}

#[test]
fn only_an_empty_place_or_an_old_output_is_written_to() {
    let parent = tempdir().unwrap();
    let place = parent.path().join("deep/out");
    prepare_output(&place, false).unwrap();
    assert!(place.is_dir());
    prepare_output(&place, false).unwrap();

    let info = info([40, 40, 100], 1, false);
    write_run(&place, &info, &wavy_ball(&info), &[]);
    fs::write(
        place.join("surfels/.part-00009.parquet.partial"),
        "left by a kill",
    )
    .unwrap();
    fs::write(place.join("surfels/notes.txt"), "mine").unwrap();
    fs::write(place.join(SUMMARY_FILE), "{}").unwrap();
    let error = prepare_output(&place, false).unwrap_err().to_string();
    assert!(
        error.contains("holds the output of a run") && error.contains("--overwrite"),
        "{error}"
    );
    prepare_output(&place, true).unwrap();
    assert_eq!(
        files_below(&place).into_keys().collect::<Vec<_>>(),
        ["surfels/notes.txt"]
    );

    let error = prepare_output(&place, true).unwrap_err().to_string();
    assert!(error.contains("not the output of a curvox run"), "{error}");
    let error = prepare_output(&place.join("surfels/notes.txt"), true)
        .unwrap_err()
        .to_string();
    assert!(error.contains("is a file"), "{error}");
}
