//! Curvature slices, read back with the exr crate.

use std::collections::{BTreeMap, HashMap};

use exr::prelude::*;
use tempfile::tempdir;

use super::*;

fn options(selection: &str) -> SliceOptions {
    SliceOptions {
        selection: selection.parse().unwrap(),
        palette: Palette::BlueRed,
        range: Some(0.3),
        budget_bytes: None,
    }
}

fn draw(
    info: &TableInfo,
    rows: &SurfelBatch,
    selection: &str,
    cuts: &[usize],
) -> tempfile::TempDir {
    let folder = tempdir().unwrap();
    let mut sink = SliceSink::create(folder.path(), info.clone(), &options(selection)).unwrap();
    send(&mut sink, rows, info, cuts);
    sink.finish().unwrap();
    folder
}

/// Width, height and the samples of each channel as `f32`.
fn channels(path: &Path) -> (usize, usize, BTreeMap<String, Vec<f32>>) {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .unwrap();
    let layer = image.layer_data;
    let list = layer.channel_data.list.iter();
    let samples = list.map(|c| (c.name.to_string(), c.sample_data.values_as_f32().collect()));
    (layer.size.0, layer.size.1, samples.collect())
}

/// Sum and number of H by inner voxel, the long way.
fn expected_h(rows: &SurfelBatch) -> HashMap<[i32; 3], (f64, u32, u32)> {
    let mut voxels = HashMap::new();
    for row in 0..rows.len() {
        let mut k = rows.k_at(row);
        let axis = (0..3).find(|&a| k[a] % 2 == 0).unwrap();
        k[axis] -= i32::from(rows.side[row]);
        let entry = voxels.entry(k.map(|c| (c - 1) / 2)).or_insert((0.0, 0, 0));
        entry.2 += 1;
        let h = rows.curvatures[0].mean[row];
        if h.is_finite() {
            entry.0 += f64::from(h);
            entry.1 += 1;
        }
    }
    voxels
}

#[test]
fn pixels_hold_the_mean_over_the_surfels_of_their_inner_voxel() {
    let info = info([23, 30, 26], 1, false);
    let rows = wavy_ball(&info);
    let expected = expected_h(&rows);
    for (axis, selection) in ["x=all", "y=all", "all"].into_iter().enumerate() {
        let folder = draw(&info, &rows, selection, &[17, 900]);
        let mut surfels = 0;
        for index in 0..info.dims[axis] {
            let name = SliceSink::file_name(axis, index);
            let (width, height, samples) =
                channels(&folder.path().join(SLICES_DIRECTORY).join(name));
            let [right, down] = [[1, 2], [0, 2], [0, 1]][axis];
            assert_eq!(
                [width, height],
                [right, down].map(|a| info.dims[a] as usize)
            );
            for v in 0..height {
                for u in 0..width {
                    let mut voxel = [index as i32; 3];
                    voxel[right] = u as i32;
                    voxel[down] = v as i32;
                    let (sum, finite, count) = expected.get(&voxel).copied().unwrap_or_default();
                    let at = v * width + u;
                    let mean = if finite > 0 {
                        (sum / f64::from(finite)) as f32
                    } else {
                        0.0
                    };
                    assert!((samples["curv.H"][at] - mean).abs() <= 1e-6 * mean.abs());
                    assert_eq!(samples["surf.count"][at], count as f32);
                    let n = ["X", "Y", "Z"].map(|a| samples[&format!("normal.{a}")][at]);
                    let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
                    assert!((length - if count > 0 { 1.0 } else { 0.0 }).abs() < 1e-5);
                    if count == 0 {
                        assert!(samples.values().all(|channel| channel[at] == 0.0));
                    }
                    surfels += count as usize;
                }
            }
        }
        assert_eq!(surfels, rows.len());
    }
}

#[test]
fn preview_has_no_alpha_and_the_colour_of_the_mean_curvature() {
    let info = info([40, 40, 40], 1, false);
    let rows = wavy_ball(&info);
    let folder = draw(&info, &rows, "z=20", &[]);
    let (_, _, samples) = channels(&folder.path().join("slices/z00020.exr"));
    let names: Vec<&str> = samples.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "B",
            "G",
            "R",
            "curv.G",
            "curv.H",
            "curv.area",
            "curv.k1",
            "curv.k2",
            "normal.X",
            "normal.Y",
            "normal.Z",
            "surf.count"
        ]
    );
    for at in 0..1600 {
        let colour = Palette::BlueRed.colour(samples["curv.H"][at], 0.3);
        let expected = if samples["surf.count"][at] > 0.0 {
            colour
        } else {
            [0.0; 3]
        };
        let found = ["R", "G", "B"].map(|c| samples[c][at]);
        assert!(
            found
                .iter()
                .zip(expected)
                .all(|(f, e)| (f - e).abs() < 1e-3)
        );
    }
}

#[test]
fn header_tells_axis_index_and_frame() {
    let info = info([20, 20, 20], 1, false);
    let folder = draw(&info, &wavy_ball(&info), "y=7", &[]);
    let meta = MetaData::read_from_file(folder.path().join("slices/y00007.exr"), true).unwrap();
    let other = &meta.headers[0].own_attributes.other;
    let text = |name: &str| match &other[&Text::from(name)] {
        AttributeValue::Text(text) => text.to_string(),
        value => panic!("{value:?}"),
    };
    assert_eq!(text("curvox.axis"), "y");
    assert_eq!(other[&Text::from("curvox.index")], AttributeValue::I32(7));
    assert_eq!(text("curvox.spacing"), "[0.5,0.5,1.0]");
    assert_eq!(text("curvox.unit"), "um");
    assert_eq!(text("curvox.version"), "0.1.0");
    assert!(text("curvox.sign").contains("H > 0"));
}

#[test]
fn cut_does_not_show() {
    let info = info([23, 30, 26], 1, false);
    let rows = wavy_ball(&info);
    let cuts: Vec<usize> = (0..rows.len()).step_by(101).collect();
    for selection in ["every:5", "x=3,15"] {
        let files = |cuts: &[usize]| files_below(draw(&info, &rows, selection, cuts).path());
        let whole = files(&[]);
        assert!(whole == files(&cuts));
        // Attributes are kept in a hash map by the writer below: try more than one order.
        assert!((0..4).all(|_| whole == files(&[])));
    }
}

#[test]
fn slices_across_z_appear_as_soon_as_rows_have_passed() {
    let info = info([40, 40, 40], 1, false);
    let rows = wavy_ball(&info);
    let folder = tempdir().unwrap();
    let mut sink = SliceSink::create(folder.path(), info.clone(), &options("all")).unwrap();
    let middle = rows.k[2].partition_point(|&kz| kz < 42);
    sink.write(&piece(&rows, &info, 0, middle)).unwrap();
    let names = || files_below(folder.path()).into_keys().collect::<Vec<_>>();
    // The last rows are at kz = 41, which touches voxel plane 20; plane 19 ends at kz = 40.
    assert_eq!(names().last().unwrap(), "slices/z00019.exr");
    sink.advance([0, 0], 43).unwrap();
    assert_eq!(names().last().unwrap(), "slices/z00020.exr");
    drop(sink);
    assert_eq!(names().len(), 21);
}

#[test]
fn surfels_of_a_closed_border_belong_to_the_border_voxels() {
    let info = info([4, 4, 4], 1, false);
    let mut rows = SurfelBatch::with_capacity(&info, 0);
    push_row(&mut rows, &info, [1, 1, 0], 2, -1, &mut Noise(1));
    push_row(&mut rows, &info, [8, 7, 7], 0, 1, &mut Noise(1));
    push_row(&mut rows, &info, [7, 7, 8], 2, 1, &mut Noise(1));
    let folder = draw(&info, &rows, "all", &[]);
    let count = |index: u32, at: usize| {
        let name = SliceSink::file_name(2, index);
        channels(&folder.path().join("slices").join(name)).2["surf.count"][at]
    };
    assert_eq!((count(0, 0), count(3, 15)), (1.0, 2.0));
}

#[test]
fn more_surfels_than_granted_are_an_error() {
    let info = info([40, 40, 40], 1, false);
    let folder = tempdir().unwrap();
    let options = SliceOptions {
        budget_bytes: Some(10_000),
        ..options("x=all")
    };
    let mut sink = SliceSink::create(folder.path(), info.clone(), &options).unwrap();
    let error = sink.write(&wavy_ball(&info)).unwrap_err().to_string();
    assert!(error.contains("choose fewer slices"), "{error}");
}

#[test]
fn memory_counts_open_slices() {
    let memory =
        |text: &str| SliceMemory::of([100, 100, 50], &text.parse().unwrap(), true).unwrap();
    let drawing = memory("z=0").bound_bytes - 100 * 100 * 3 * 80;
    assert_eq!(memory("all").bound_bytes - drawing, 2 * 100 * 100 * 3 * 80);
    assert_eq!(
        memory("x=all").bound_bytes - drawing,
        100 * 100 * 50 * 3 * 80
    );
    assert!(memory("x=all").expected_bytes < memory("x=all").bound_bytes / 10);
}
