//! Tests of the pictures, on tables made here.

use std::io::Read;
use std::path::Path;

use anyhow::Result;
use curvox::sink::{
    Check, CurvatureColumns, OutputInfo, Palette, RadiusInfo, SingleSink, SinkError, SurfelBatch,
    SurfelSink, TableInfo,
};
use flate2::Crc;
use flate2::read::ZlibDecoder;
use glam::DVec3;

use super::bar::number;
use super::png::predicted;
use super::*;

const RED: [u8; 3] = [255, 0, 0];
const WHITE: [u8; 3] = [255; 3];

fn info(edge: u32) -> TableInfo {
    TableInfo {
        dims: [edge; 3],
        spacing: [0.5, 0.5, 1.0],
        unit: "um".into(),
        first_index: [0; 3],
        origin: [7.0, 0.0, -2.0],
        direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        radii: vec![RadiusInfo {
            label: "3vx".into(),
            voxels: 3.0,
            world: 1.5,
        }],
        directions: false,
        errors: false,
        quality: false,
        parameters: Default::default(),
        version: "0.1.0".into(),
        conventions: Vec::new(),
    }
}

/// The surfels of a set of voxels in Khalimsky order, with the mean curvature that `value` gives
/// for the surfel's Khalimsky coordinates, and trivial normals.
fn surfels(
    info: &TableInfo,
    inside: impl Fn([i32; 3]) -> bool,
    value: impl Fn([i32; 3]) -> f32,
) -> SurfelBatch {
    let mut batch = SurfelBatch {
        curvatures: vec![CurvatureColumns::default()],
        ..SurfelBatch::default()
    };
    let last = 2 * i32::try_from(info.dims[0]).unwrap();
    for kz in 0..=last {
        for ky in 0..=last {
            for kx in 0..=last {
                let k = [kx, ky, kz];
                let even: Vec<usize> = (0..3).filter(|&a| k[a] % 2 == 0).collect();
                let [axis] = even[..] else { continue };
                let voxel = |step: i32| {
                    let mut p = k;
                    p[axis] += step;
                    p.map(|k| (k - 1).div_euclid(2))
                };
                let side = match (inside(voxel(-1)), inside(voxel(1))) {
                    (true, false) => 1,
                    (false, true) => -1,
                    _ => continue,
                };
                let mut normal = [0.0; 3];
                normal[axis] = f32::from(side);
                for a in 0..3 {
                    batch.k[a].push(k[a]);
                    let index = f64::from(k[a] - 1) / 2.0;
                    batch.position[a].push((info.origin[a] + info.spacing[a] * index) as f32);
                    batch.normal[a].push(normal[a]);
                }
                batch.side.push(side);
                batch.area.push(0.5);
                let at = &mut batch.curvatures[0];
                at.mean.push(value(k));
                for column in [&mut at.gaussian, &mut at.k1, &mut at.k2] {
                    column.push(0.0);
                }
                at.flags.push(0);
            }
        }
    }
    batch
}

/// A ball in the world: half as many voxels along z.
fn ball(edge: u32, value: impl Fn([i32; 3]) -> f32) -> (TableInfo, SurfelBatch) {
    let info = info(edge);
    let half = f64::from(edge) / 2.0;
    let batch = surfels(
        &info,
        |p| {
            let [x, y, z] = p.map(|i| f64::from(i) + 0.5 - half);
            x * x + y * y + 4.0 * z * z < (half - 1.0).powi(2)
        },
        value,
    );
    (info, batch)
}

fn options(view: &str) -> PictureOptions {
    PictureOptions {
        range: Some(0.5),
        view: view.parse().unwrap(),
        width: 200,
        ..PictureOptions::default()
    }
}

fn draw(info: &TableInfo, batch: &SurfelBatch, options: &PictureOptions) -> Result<Image> {
    let rows = || [Ok::<_, SinkError>(batch.clone())];
    draw_surfels(Path::new("table"), info, rows, options)
}

#[test]
fn ball_is_a_disc_from_everywhere() {
    let (info, batch) = ball(40, |_| 1.0);
    for view in ["x", "-y", "z", "1,-1.6,0.9"] {
        let image = draw(&info, &batch, &options(view)).unwrap();
        // The colour bar is below the scene, with white rows between.
        let row = |y: usize| (0..200).filter(|&x| image.pixel(x, y) != WHITE).count();
        let top = (0..200).find(|&y| row(y) > 0).unwrap();
        let bottom = (top..).find(|&y| row(y) == 0).unwrap();
        let height = (bottom - top) as f64;
        let widest = (top..bottom).map(row).max().unwrap() as f64;
        // The staircase: a voxel is 1/20 of the radius, twice that along z.
        assert!(
            (widest / height - 1.0).abs() < 0.12,
            "{view}: {widest} by {height}"
        );
        let area = (top..bottom).map(row).sum::<usize>() as f64;
        let disc = std::f64::consts::FRAC_PI_4 * widest * height;
        assert!((area / disc - 1.0).abs() < 0.08, "{view}: {area} of {disc}");
    }
}

#[test]
fn nearer_surfels_hide_farther_ones() {
    // The faces towards +x are red, those towards -x dark blue.
    let (info, batch) = ball(20, |k| if k[0] > 20 { 1.0 } else { -1.0 });
    for (view, red) in [("x", true), ("-x", false)] {
        let image = draw(&info, &batch, &options(view)).unwrap();
        let [r, g, b] = image.pixel(100, 100);
        assert_eq!((r > 150, b > 100), (red, !red), "{view}: {:?}", [r, g, b]);
        assert!(g < 10);
    }
}

#[test]
fn face_seen_straight_on_has_the_colour_of_its_value() {
    let info = info(3);
    let batch = surfels(&info, |p| p == [1, 1, 1], |_| 1.0);
    let image = draw(&info, &batch, &options("z")).unwrap();
    assert_eq!(image.pixel(100, 100), RED);
    assert_eq!(image.pixel(1, 1), WHITE);
    // Not a number is black, as is 0.
    for value in [f32::NAN, 0.0] {
        let batch = surfels(&info, |p| p == [1, 1, 1], |_| value);
        let image = draw(&info, &batch, &options("z")).unwrap();
        assert_eq!(image.pixel(100, 100), [0; 3]);
    }
}

#[test]
fn inner_side_of_a_cut_surface_is_grey() {
    let (mut info, mut batch) = ball(20, |_| 1.0);
    // Without its upper half, so that the eye above looks into the lower one.
    let keep: Vec<usize> = (0..batch.len()).filter(|&r| batch.k[2][r] < 20).collect();
    let mut lower = SurfelBatch::with_capacity(&info, keep.len());
    for &row in &keep {
        lower.extend_from(&batch, row..row + 1);
    }
    let is_grey = |[r, g, b]: [u8; 3]| r == g && g == b && r < 255;
    assert!(!is_grey(
        draw(&info, &batch, &options("z")).unwrap().pixel(100, 100)
    ));
    assert!(is_grey(
        draw(&info, &lower, &options("z")).unwrap().pixel(100, 100)
    ));
    // The same in a mirrored image.
    info.direction[0][0] = -1.0;
    for rows in [&mut batch, &mut lower] {
        rows.position[0].iter_mut().for_each(|x| *x = 14.0 - *x);
        rows.normal[0].iter_mut().for_each(|x| *x = -*x);
    }
    assert!(!is_grey(
        draw(&info, &batch, &options("z")).unwrap().pixel(100, 100)
    ));
    assert!(is_grey(
        draw(&info, &lower, &options("z")).unwrap().pixel(100, 100)
    ));
}

#[test]
fn z_is_up_and_views_are_right_handed() {
    for view in ["x", "-x", "y", "-y", "1,2,3", "-5,0,1e-3"] {
        let frame = view.parse::<View>().unwrap().frame();
        assert!((frame.right.cross(frame.up) - frame.eye).length() < 1e-12);
        assert!(frame.up.z > 0.0 && frame.right.z.abs() < 1e-12, "{view}");
    }
    let above = "z".parse::<View>().unwrap().frame();
    assert_eq!((above.right, above.up), (DVec3::X, DVec3::Y));
    for wrong in ["", "w", "1,2", "0,0,0", "1,2,3,4", "nan,0,1", "inf,0,0"] {
        assert!(wrong.parse::<View>().is_err(), "{wrong}");
    }
}

#[test]
fn batches_do_not_show() {
    let (info, batch) = ball(24, |k| (k[0] - 24) as f32 / 24.0);
    let whole = draw(&info, &batch, &PictureOptions::default()).unwrap();
    let rows = || {
        (0..batch.len()).step_by(100).map(|from| {
            let mut part = SurfelBatch::with_capacity(&info, 100);
            part.extend_from(&batch, from..batch.len().min(from + 100));
            Ok(part)
        })
    };
    let options = PictureOptions::default();
    let parts = draw_surfels(Path::new("table"), &info, rows, &options).unwrap();
    assert!(whole == parts);
    assert!(whole.to_png().unwrap() == parts.to_png().unwrap());
}

#[test]
fn what_cannot_be_drawn_is_an_error() {
    let (info, batch) = ball(8, |_| 1.0);
    let message = |batch: &SurfelBatch, options: &PictureOptions| {
        format!("{:#}", draw(&info, batch, options).unwrap_err())
    };
    let good = PictureOptions::default();
    assert_eq!(
        message(&SurfelBatch::with_capacity(&info, 0), &good),
        "table: there are no surfels to draw"
    );
    let mut broken = batch.clone();
    broken.position[1][5] = f32::INFINITY;
    assert!(message(&broken, &good).starts_with("table: row 5: position: found ["));
    let mut broken = batch.clone();
    broken.k[0][3] += 1;
    assert!(message(&broken, &good).contains("row 3: found ["));
    for (wrong, what) in [
        (
            PictureOptions {
                column: "area".into(),
                ..good.clone()
            },
            "column: found \"area\"",
        ),
        (
            PictureOptions {
                column: "k1_4vx".into(),
                ..good.clone()
            },
            "endings _3vx",
        ),
        (
            PictureOptions {
                range: Some(0.0),
                ..good.clone()
            },
            "range: found 0",
        ),
        (
            PictureOptions {
                range: Some(f32::NAN),
                ..good.clone()
            },
            "range: found NaN",
        ),
        (
            PictureOptions {
                width: 10,
                ..good.clone()
            },
            "size: found 10",
        ),
    ] {
        assert!(message(&batch, &wrong).contains(what), "{what}");
    }
}

#[test]
fn table_file_is_drawn_as_its_rows_are() {
    let (info, batch) = ball(16, |k| (k[1] - 16) as f32 / 16.0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.parquet");
    let mut sink = SingleSink::parquet_file(&path, info.clone()).unwrap();
    sink.write(&batch).unwrap();
    sink.finish().unwrap();
    let output = OutputInfo::open(&path, Check::Footers).unwrap();
    let table = output.table.clone().unwrap();
    let options = PictureOptions {
        column: "mean_curvature_3vx".into(),
        ..Default::default()
    };
    let read = draw_surfels(&path, &table, || output.clone().into_rows(), &options).unwrap();
    assert!(read == draw(&info, &batch, &options).unwrap());
}

/// Reads a PNG file of this encoder, checking all that a decoder checks.
fn decode(file: &[u8]) -> ([usize; 2], Vec<u8>) {
    let mut rest = file.strip_prefix(b"\x89PNG\r\n\x1a\n").unwrap();
    let mut chunks = Vec::new();
    while !rest.is_empty() {
        let length = u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize;
        let (kind, data) = (&rest[4..8], &rest[8..8 + length]);
        let mut crc = Crc::new();
        crc.update(&rest[4..8 + length]);
        let stored = &rest[8 + length..12 + length];
        assert_eq!(stored, crc.sum().to_be_bytes(), "{kind:?}");
        chunks.push((kind, data));
        rest = &rest[12 + length..];
    }
    let kinds: Vec<_> = chunks.iter().map(|c| c.0).collect();
    assert_eq!(kinds, [b"IHDR", b"IDAT", b"IEND"]);
    let header = chunks[0].1;
    let length = |at: usize| u32::from_be_bytes(header[at..at + 4].try_into().unwrap()) as usize;
    let size = [length(0), length(4)];
    assert_eq!(header[8..], [8, 2, 0, 0, 0]);
    let mut rows = Vec::new();
    ZlibDecoder::new(chunks[1].1)
        .read_to_end(&mut rows)
        .unwrap();
    let stride = 3 * size[0];
    assert_eq!(rows.len(), size[1] * (stride + 1));
    let mut pixels = vec![0; stride];
    for row in rows.chunks(stride + 1) {
        for (i, byte) in row[1..].iter().enumerate() {
            let above = pixels[pixels.len() - stride];
            let (left, upper_left) = match i {
                0..3 => (0, 0),
                _ => (pixels[pixels.len() - 3], pixels[pixels.len() - stride - 3]),
            };
            pixels.push(byte.wrapping_add(predicted(row[0], left, above, upper_left)));
        }
    }
    (size, pixels.split_off(stride))
}

#[test]
fn png_decodes_to_the_picture() {
    let (info, batch) = ball(12, |k| (k[2] - 12) as f32 / 12.0);
    let image = draw(&info, &batch, &PictureOptions::default()).unwrap();
    let file = image.to_png().unwrap();
    let (size, pixels) = decode(&file);
    assert_eq!(size, image.size());
    for (i, pixel) in pixels.chunks(3).enumerate() {
        assert_eq!(pixel, image.pixel(i % size[0], i / size[0]));
    }
    assert!(Image::white([0, 3]).to_png().is_err());
}

#[test]
fn slice_is_its_preview_in_squares() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("z00000.exr");
    exr::prelude::write_rgb_file(&path, 5, 3, |x, y| {
        (
            if x == 4 { 1.0_f32 } else { 0.0 },
            if y == 0 { 1.0_f32 } else { 0.0 },
            0.5_f32,
        )
    })
    .unwrap();
    let image = slice_preview(&path, 23).unwrap();
    assert_eq!(image.size(), [20, 12]);
    assert_eq!(image.pixel(0, 0), [0, 255, 188]);
    assert_eq!(image.pixel(19, 11), [255, 0, 188]);
    assert_eq!(image.pixel(15, 4), [0, 0, 188]);
    // Never smaller than the slice.
    assert_eq!(slice_preview(&path, 1).unwrap().size(), [5, 3]);

    let bytes = std::fs::read(&path).unwrap();
    for length in [0, 20, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let error = slice_preview(&path, 23).unwrap_err();
        assert!(format!("{error:#}").contains("z00000.exr"));
    }
}

#[test]
fn ticks_have_three_digits_at_most() {
    for (value, text) in [
        (0.3, "0.3"),
        (-1.0 / 9.6, "-0.104"),
        (0.0, "0"),
        (12345.0, "12300"),
        (1.25e-5, "1.25e-5"),
        (-4e9, "-4e9"),
    ] {
        assert_eq!(number(value), text);
    }
}

#[test]
fn errors_are_white_then_red_then_black() {
    let colours = ColourMap::Error { range: 0.05 };
    let expected = [
        (0.0, [1.0; 3]),
        (0.025, [1.0, 0.0, 0.0]),
        (-0.025, [1.0, 0.0, 0.0]),
        (0.05, [0.0; 3]),
        (9.0, [0.0; 3]),
        (f32::NAN, [0.0; 3]),
    ];
    for (value, colour) in expected {
        assert_eq!(colours.colour(value), colour, "{value}");
    }
}

#[test]
fn the_black_band_is_as_wide_as_asked() {
    let colours = ColourMap::Signed {
        palette: Palette::BlueRed,
        range: 0.05,
        band: 0.0005,
    };
    assert_eq!(colours.colour(0.0004), [0.0; 3]);
    assert!(colours.colour(0.0006).iter().all(|&channel| channel > 0.9));
    assert_eq!(colours.colour(0.05), [1.0, 0.0, 0.0]);
    assert_eq!(colours.ends(), [-0.05, 0.05]);
}

#[test]
fn sticks_show_on_the_side_of_the_eye() {
    let (info, batch) = ball(20, |_| 1.0);
    // Of the ball's highest and lowest place.
    let middle = [0, 1, 2].map(|a| info.origin[a] + info.spacing[a] * 9.5);
    let black = |height: f64| {
        let stick = Stick {
            centre: DVec3::from_array(middle) + DVec3::Z * height,
            direction: DVec3::X,
            length: 3.0,
        };
        let scene = Scene {
            path: Path::new("table"),
            info: &info,
            view: "z".parse().unwrap(),
            width: 200,
            sticks: &[stick],
        };
        let rows = || [Ok::<_, SinkError>(batch.clone())];
        let image = scene.draw(rows, |_, _, _| [1.0, 0.0, 0.0]).unwrap();
        let [width, height] = image.size();
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        pixels.filter(|&(x, y)| image.pixel(x, y) == [0; 3]).count()
    };
    assert!(black(5.0) > 50);
    assert_eq!(black(-5.0), 0);
}

#[test]
fn montage_holds_its_pictures_side_by_side() {
    let coloured = |colour: [u8; 3], size: [usize; 2]| {
        let mut image = Image::white(size);
        image.fill([0, 0], size, colour);
        image
    };
    let montage = Montage {
        columns: vec!["h = 0.5".into(), "h = 0.25".into()],
        rows: vec![
            (
                "H".into(),
                vec![
                    coloured([9, 0, 0], [200, 50]),
                    coloured([8, 0, 0], [200, 60]),
                ],
            ),
            ("G".into(), vec![coloured([7, 0, 0], [200, 40])]),
        ],
        bars: vec![Bar {
            colours: ColourMap::Error { range: 1.0 },
            title: "error".into(),
        }],
    };
    let image = montage.image();
    let [width, height] = image.size();
    assert_eq!(width, 400);
    let count = |red: u8| {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        pixels
            .filter(|&(x, y)| image.pixel(x, y) == [red, 0, 0])
            .count()
    };
    assert_eq!(
        [count(9), count(8), count(7)],
        [200 * 50, 200 * 60, 200 * 40]
    );
}
