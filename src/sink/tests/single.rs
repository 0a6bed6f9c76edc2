//! Single files and streams.

use std::io::{self, Write};
use std::sync::{Arc, Mutex};

use arrow_ipc::reader::StreamReader;
use tempfile::tempdir;

use super::*;

/// A writer whose bytes can be looked at afterwards.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A pipe whose reader has gone.
struct Gone;

impl Write for Gone {
    fn write(&mut self, _: &[u8]) -> io::Result<usize> {
        Err(io::Error::from(io::ErrorKind::BrokenPipe))
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn csv_parses_back_to_the_same_values() {
    let info = info([24, 24, 24], 2, true);
    let rows = wavy_ball(&info);
    let output = Shared::default();
    let mut sink = SingleSink::csv_stream(output.clone(), Path::new(STDOUT), info.clone()).unwrap();
    send(&mut sink, &rows, &info, &[1, 7, 500]);
    sink.finish().unwrap();
    let text = String::from_utf8(output.0.lock().unwrap().clone()).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let (kz, nx, k1, d2z) = (at("kz"), at("nx"), at("k1_4_5vx"), at("d2z_3vx"));
    let (quality, flags) = (at("quality_4_5vx"), at("flags_4_5vx"));
    let mut count = 0;
    for (row, line) in lines.enumerate() {
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(cells.len(), names.len());
        let float = |column: usize| cells[column].parse::<f32>().unwrap().to_bits();
        assert_eq!(cells[kz].parse::<i32>().unwrap(), rows.k[2][row]);
        assert_eq!(float(nx), rows.normal[0][row].to_bits());
        assert_eq!(float(k1), rows.curvatures[1].k1[row].to_bits());
        assert_eq!(float(d2z), rows.curvatures[0].d2[2][row].to_bits());
        assert_eq!(float(quality), rows.curvatures[1].quality[row].to_bits());
        assert_eq!(cells[flags], rows.curvatures[1].flags[row].to_string());
        count += 1;
    }
    assert_eq!(count, rows.len());
}

#[test]
fn csv_without_rows_has_a_header() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("out.csv");
    let mut sink = SingleSink::csv_file(&path, info([4, 4, 4], 1, false)).unwrap();
    sink.finish().unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.starts_with("kx,ky,kz,side,x,y,z,nx,ny,nz,area,mean_curvature,"));
    assert_eq!(text.lines().count(), 1);
}

#[test]
fn single_parquet_reads_back_and_hides_the_cut() {
    let info = info([40, 40, 140], 1, true);
    let rows = wavy_ball(&info);
    let folder = tempdir().unwrap();
    let write = |name: &str, cuts: &[usize]| {
        let path = folder.path().join(name);
        let mut sink = SingleSink::parquet_file(&path, info.clone()).unwrap();
        send(&mut sink, &rows, &info, cuts);
        assert!(!path.exists());
        sink.finish().unwrap();
        path
    };
    let path = write("a.parquet", &[]);
    assert!(std::fs::read(&path).unwrap() == std::fs::read(write("b.parquet", &[5, 999])).unwrap());
    let mut all = SurfelBatch::with_capacity(&info, 0);
    for batch in OutputInfo::open(&path, Check::Footers).unwrap().into_rows() {
        let batch = batch.unwrap();
        all.extend_from(&batch, 0..batch.len());
    }
    assert_same_rows(&all, &rows);
}

#[test]
fn arrow_stream_reads_back_with_metadata() {
    let info = info([40, 40, 40], 1, false);
    let rows = wavy_ball(&info);
    let bytes = |cuts: &[usize]| {
        let output = Shared::default();
        let mut sink =
            SingleSink::arrow_stream(output.clone(), Path::new(STDOUT), info.clone()).unwrap();
        send(&mut sink, &rows, &info, cuts);
        sink.finish().unwrap();
        output.0.lock().unwrap().clone()
    };
    let stream = bytes(&[3, 400]);
    assert!(stream == bytes(&[]));
    let reader = StreamReader::try_new(stream.as_slice(), None).unwrap();
    assert_eq!(reader.schema().metadata()["curvox.unit"], "um");
    assert_eq!(
        reader.map(|batch| batch.unwrap().num_rows()).sum::<usize>(),
        rows.len()
    );
}

#[test]
fn a_reader_that_goes_away_is_told_from_a_failure() {
    let info = info([60, 60, 60], 1, false);
    let rows = wavy_ball(&info);
    let sinks = [
        SingleSink::csv_stream(Gone, Path::new(STDOUT), info.clone()),
        SingleSink::arrow_stream(Gone, Path::new(STDOUT), info.clone()),
    ];
    for sink in sinks {
        let result = sink.and_then(|mut sink| {
            sink.write(&rows)?;
            sink.finish()
        });
        assert!(result.unwrap_err().is_broken_pipe());
    }
}

#[cfg(target_os = "linux")]
#[test]
fn full_device_is_an_error_not_a_panic() {
    let info = info([60, 60, 60], 1, false);
    let rows = wavy_ball(&info);
    let path = Path::new("/dev/full");
    for sink in [
        SingleSink::csv_file(path, info.clone()),
        SingleSink::parquet_file(path, info.clone()),
    ] {
        let result = sink.and_then(|mut sink| {
            sink.write(&rows)?;
            sink.finish()
        });
        assert_eq!(
            result.unwrap_err().to_string(),
            "/dev/full: no space left on device"
        );
    }
}

#[test]
fn unwritable_place_is_an_error_with_its_path() {
    let path = Path::new("/nowhere/at/all.csv");
    let error = SingleSink::csv_file(path, info([4, 4, 4], 1, false))
        .err()
        .unwrap();
    assert!(
        error
            .to_string()
            .starts_with("/nowhere/at/all.csv: cannot create: "),
        "{error}"
    );
}

#[test]
fn dropped_file_leaves_nothing() {
    let info = info([30, 30, 30], 1, false);
    let folder = tempdir().unwrap();
    for name in ["a.csv", "a.parquet"] {
        let path = folder.path().join(name);
        let mut sink = match name {
            "a.csv" => SingleSink::csv_file(&path, info.clone()).unwrap(),
            _ => SingleSink::parquet_file(&path, info.clone()).unwrap(),
        };
        sink.write(&wavy_ball(&info)).unwrap();
    }
    assert!(files_below(folder.path()).is_empty());
}

#[test]
fn image_wider_than_a_column_of_parts_needs_the_dataset() {
    let info = info([8193, 4, 4], 1, false);
    let error = SingleSink::csv_stream(Gone, Path::new(STDOUT), info)
        .err()
        .unwrap();
    assert!(error.to_string().contains("too wide for a single table"));
}
