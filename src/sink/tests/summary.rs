//! Totals.

use super::*;

fn summary_of(info: &TableInfo, rows: &SurfelBatch, cuts: &[usize]) -> Summary {
    let mut sink = SummarySink::new(info.clone()).unwrap();
    send(&mut sink, rows, info, cuts);
    let exact = ExactTotals {
        surfels: rows.len() as u64,
        closed: true,
        ..Default::default()
    };
    sink.summary(RunFacts {
        exact: Some(exact),
        warnings: vec!["a warning".into()],
        input: json!({"path": "scan.nii.gz"}),
        radius_choice: None,
    })
}

#[test]
fn totals_are_the_sums_of_the_rows() {
    let info = info([50, 50, 150], 2, false);
    let rows = wavy_ball(&info);
    let found = summary_of(&info, &rows, &[]);
    assert_eq!(found.rows, rows.len() as u64);
    let at = &rows.curvatures[1];
    let radius = &found.radii[1];
    let area: f64 = rows.area.iter().map(|&a| f64::from(a)).sum();
    assert!((radius.all.area - area).abs() < 1e-9 * area);
    let finite = (0..rows.len()).filter(|&row| at.mean[row].is_finite());
    let integral: f64 = finite
        .clone()
        .map(|row| f64::from(rows.area[row]) * f64::from(at.mean[row]))
        .sum();
    assert!((radius.all.integral_mean_curvature - integral).abs() < 1e-9 * integral.abs());
    let nan = rows.len() - finite.count();
    assert!(nan > 0);
    assert_eq!(radius.mean_curvature.not_finite, nan as u64);
    assert_eq!(radius.flags[7].name, "no_area");
    assert_eq!(radius.flags[7].rows, nan as u64);
    let border = at
        .flags
        .iter()
        .filter(|&&f| f & Flag::Border.bit() != 0)
        .count();
    assert_eq!(radius.flags[0].rows, border as u64);
    assert_eq!(radius.without_border.rows, (rows.len() - border) as u64);
    let max = at
        .k2
        .iter()
        .copied()
        .filter(|v| v.is_finite())
        .fold(f32::MIN, f32::max);
    assert_eq!(radius.k2.max, Some(max));
}

#[test]
fn histogram_holds_all_positive_area() {
    let info = info([50, 50, 60], 1, false);
    let rows = wavy_ball(&info);
    let found = summary_of(&info, &rows, &[]);
    let at = &rows.curvatures[0];
    let area: f64 = (0..rows.len())
        .filter(|&row| at.gaussian[row].is_finite() && rows.area[row] > 0.0)
        .map(|row| f64::from(rows.area[row]))
        .sum();
    let histogram = &found.radii[0].gaussian_curvature.histogram;
    let binned = histogram.below + histogram.above + histogram.area.iter().sum::<f64>();
    assert!((binned - area).abs() < 1e-9 * area);
    assert_eq!((histogram.low, histogram.high), (-16.0 / 9.0, 16.0 / 9.0));
}

#[test]
fn bin_holds_its_lower_end() {
    let info = info([4, 4, 4], 1, false);
    let mut rows = SurfelBatch::with_capacity(&info, 0);
    for (i, mean) in [-4.0 / 3.0, 0.0, 4.0 / 3.0, -2.0].into_iter().enumerate() {
        push_row(
            &mut rows,
            &info,
            [1 + 2 * i as i32, 1, 2],
            2,
            1,
            &mut Noise(1),
        );
        rows.area[i] = 1.0;
        rows.curvatures[0].mean[i] = mean;
    }
    // The ends are not exact in f32: one lies just outside, the other just inside or at the end.
    let found = summary_of(&info, &rows, &[]).radii[0]
        .mean_curvature
        .histogram
        .clone();
    assert_eq!(found.area[100], 1.0);
    assert_eq!(
        found.below + found.above + found.area.iter().sum::<f64>(),
        4.0
    );
}

#[test]
fn cut_and_column_order_do_not_show() {
    let info = info([50, 50, 150], 1, true);
    let rows = wavy_ball(&info);
    let text = |cuts: &[usize]| serde_json::to_string(&summary_of(&info, &rows, cuts)).unwrap();
    let cuts: Vec<usize> = (0..rows.len()).step_by(13).collect();
    assert_eq!(text(&[]), text(&cuts));
}

#[test]
fn summary_file_is_json_with_fixed_order_and_no_nan() {
    let info = info([20, 20, 20], 1, false);
    let empty = SurfelBatch::with_capacity(&info, 0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(SUMMARY_FILE);
    summary_of(&info, &empty, &[]).write(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.starts_with("{\n  \"format\": \"curvox summary 1\",\n  \"version\": \"0.1.0\","));
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(value["radii"][0]["k1"]["mean"].is_null());
    assert_eq!(value["exact"]["closed"], true);
    assert_eq!(value["warnings"][0], "a warning");
}

/// What lets a resumed run make up the totals of the parts it keeps.
#[test]
fn rows_read_back_give_the_same_summary() {
    let info = info([40, 40, 100], 1, true);
    let rows = wavy_ball(&info);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rows.parquet");
    let mut table = SingleSink::parquet_file(&path, info.clone()).unwrap();
    send(&mut table, &rows, &info, &[]);
    table.finish().unwrap();
    let mut sink = SummarySink::new(info.clone()).unwrap();
    for batch in OutputInfo::open(&path, Check::Footers).unwrap().into_rows() {
        sink.write(&batch.unwrap()).unwrap();
    }
    let mut direct = SummarySink::new(info.clone()).unwrap();
    send(&mut direct, &rows, &info, &[]);
    assert_eq!(
        sink.summary(RunFacts::default()),
        direct.summary(RunFacts::default())
    );
}

#[test]
fn the_median_error_bar_is_that_of_the_rows() {
    let without = info([50, 50, 150], 1, false);
    let found = summary_of(&without, &wavy_ball(&without), &[]);
    assert_eq!(found.radii[0].mean_curvature_error_median, None);
    let info = info([50, 50, 150], 2, true);
    let mut rows = wavy_ball(&info);
    // as short as error bars are, and longer
    for error in rows.curvatures[1].mean_error.iter_mut().step_by(2) {
        *error = f32::from_bits(error.to_bits() & 0xffff_0000);
    }
    let at = &rows.curvatures[1];
    let inner = (0..rows.len()).filter(|&i| at.flags[i] & crate::sink::Flag::Border.bit() == 0);
    let mut errors: Vec<f32> = inner.map(|i| at.mean_error[i]).collect();
    errors.sort_by(f32::total_cmp);
    let median = errors[(errors.len() - 1) / 2];
    for cuts in [vec![], vec![7, 500, 501]] {
        let found = summary_of(&info, &rows, &cuts);
        assert_eq!(found.radii[1].mean_curvature_error_median, Some(median));
    }
}
