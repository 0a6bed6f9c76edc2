use std::sync::atomic::AtomicBool;

use curvox::Error;
use curvox::lattice::Lattice;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{Access, Progress, Settings, Source, run};
use curvox::shape::{Digitisation, GreyPlanes, Grid, Scanner, Sphere};
use curvox::sink::{Flag, SurfelBatch};
use curvox::volume::{Binarizer, Criterion};
use curvox_formats::{
    ByteOrder, DType, OpenOptions, RawLayout, Scaling, Unit, Volume, VoxelType, open, open_stream,
};
use glam::DVec3;
use proptest::prelude::*;
use tempfile::TempDir;

use crate::common::{Collected, Random, bits};

/// A grey image of `f32`.
#[derive(Clone, Debug)]
struct Image {
    dims: [usize; 3],
    values: Vec<f32>,
}

impl Image {
    fn from_fn(dims: [usize; 3], f: impl Fn([f64; 3]) -> f64) -> Self {
        let [nx, ny, nz] = dims;
        let mut values = Vec::new();
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    values.push(f([x as f64, y as f64, z as f64]) as f32);
                }
            }
        }
        Self { dims, values }
    }

    fn smooth_noise(dims: [usize; 3], seed: u64) -> Self {
        let mut random = Random(seed);
        let waves: Vec<[f64; 4]> = (0..6)
            .map(|_| [0; 4].map(|_| random.next() - 0.5))
            .collect();
        let mut image = Self::from_fn(dims, |p| {
            let wave = |w: &[f64; 4]| (p[0] * w[0] + p[1] * w[1] + p[2] * w[2] + 9.0 * w[3]).sin();
            waves.iter().map(wave).sum()
        });
        for value in &mut image.values {
            *value += (random.next() as f32 - 0.5) * 0.4;
        }
        image
    }

    /// Beyond the border, the nearest voxel.
    fn at(&self, p: [i32; 3]) -> f64 {
        let [x, y, z] = [0, 1, 2].map(|a| p[a].clamp(0, self.dims[a] as i32 - 1) as usize);
        self.values[(z * self.dims[1] + y) * self.dims[0] + x].into()
    }

    fn bytes(&self, order: ByteOrder) -> Vec<u8> {
        let bytes = |v: &f32| match order {
            ByteOrder::Little => v.to_le_bytes(),
            ByteOrder::Big => v.to_be_bytes(),
        };
        self.values.iter().flat_map(bytes).collect()
    }
}

fn options(dims: [usize; 3], dtype: DType) -> OpenOptions {
    OpenOptions {
        raw: Some(RawLayout {
            dims: dims.map(|n| n as u64),
            dtype,
            spacing: None,
            unit: Unit::Unknown,
            skip: 0,
        }),
        ..Default::default()
    }
}

fn stream(dims: [usize; 3], dtype: DType, bytes: Vec<u8>) -> Volume {
    open_stream(
        Box::new(std::io::Cursor::new(bytes)),
        "test",
        &options(dims, dtype),
    )
    .unwrap()
}

fn float_stream(image: &Image) -> Volume {
    let dtype = DType::little(VoxelType::F32);
    stream(image.dims, dtype, image.bytes(ByteOrder::Little))
}

fn tried(volume: Volume, criterion: Criterion, settings: &Settings) -> Result<SurfelBatch, Error> {
    let header = &volume.header;
    let plan = settings.plan(&Access::of(&volume), 0)?;
    let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, header.scaling);
    let mut rows = Collected::default();
    run(
        Source { volume, binarizer },
        settings,
        &plan,
        &mut [&mut rows],
        &Progress::default(),
        &AtomicBool::new(false),
    )?;
    Ok(rows.joined())
}

fn gradient(dims: [usize; 3], spacing: [f64; 3], sigma: f64) -> Settings {
    let lattice = Lattice::new(dims.map(|n| n as u64), spacing, false).unwrap();
    let mut settings = Settings::new(lattice);
    settings.estimator = Estimator::Gradient { sigma };
    settings.radii = vec![2.0];
    settings
}

fn normal(rows: &SurfelBatch, i: usize) -> [f64; 3] {
    [0, 1, 2].map(|a| rows.normal[a][i].into())
}

fn has(rows: &SurfelBatch, i: usize, flag: Flag) -> bool {
    rows.curvatures[0].flags[i] & flag.bit() != 0
}

fn at_least(t: f64) -> Criterion {
    Criterion::AtLeast(t.into())
}

/// Whether the window of sigma, ended at 3 of them, leaves the image.
fn leaves(dims: [usize; 3], edges: [f64; 3], k: [i32; 3], sigma: f64) -> bool {
    (0..3).any(|a| {
        let at = f64::from(k[a] - 1) / 2.0;
        let far = (3.0 * sigma / edges[a]).max(if k[a] % 2 == 0 { 0.5 } else { 1.0 });
        (at - far - 1e-9).ceil() < 0.0 || (at + far + 1e-9).floor() > dims[a] as f64 - 1.0
    })
}

#[test]
fn the_gradient_of_a_ramp_is_its_exact_direction_whatever_the_voxels() {
    for (spacing, sigma) in [
        ([1.0; 3], 1.0),
        ([1.0; 3], 0.3),
        ([0.5; 3], 2.3),
        ([1.0, 0.4, 2.0], 1.1),
        ([0.3, 1.0, 0.9], 1.5),
    ] {
        let dims = [40, 38, 42];
        let slope = [0.3, -0.7, 1.1];
        let image = Image::from_fn(dims, |p| {
            (0..3)
                .map(|a| slope[a] * spacing[a] * (p[a] - dims[a] as f64 / 2.0))
                .sum()
        });
        let settings = gradient(dims, spacing, sigma);
        let rows = tried(float_stream(&image), at_least(0.0), &settings).unwrap();
        let length = slope.iter().map(|s| s * s).sum::<f64>().sqrt();
        let mut inner = 0;
        for i in 0..rows.len() {
            assert!(!has(&rows, i, Flag::DegenerateNormal));
            let k = [0, 1, 2].map(|a| rows.k[a][i]);
            if leaves(dims, settings.lattice.edges(), k, sigma) {
                continue;
            }
            inner += 1;
            for (a, u) in normal(&rows, i).into_iter().enumerate() {
                // the values are f32
                assert!(
                    (u + slope[a] / length).abs() < 2e-6,
                    "{spacing:?} {k:?} {u}"
                );
            }
        }
        assert!(inner > 50, "{inner}");
    }
}

/// Whether a box of voxels leaves an image on a side where something inside lies on the border.
fn meets_border(image: &Image, lo: [i32; 3], hi: [i32; 3]) -> bool {
    let last = image.dims.map(|n| n as i32 - 1);
    (0..3).any(|a| {
        let sides = [(lo[a] < 0, 0), (hi[a] > last[a], last[a])];
        sides.into_iter().any(|(leaves, face)| {
            let (mut from, mut to) = (lo.map(|x| x.max(0)), hi);
            (0..3).for_each(|b| to[b] = to[b].min(last[b]));
            (from[a], to[a]) = (face, face);
            let rows = (from[2]..=to[2]).flat_map(|z| (from[1]..=to[1]).map(move |y| (y, z)));
            let mut voxels = rows.flat_map(|(y, z)| (from[0]..=to[0]).map(move |x| [x, y, z]));
            leaves && voxels.any(|p| image.at(p) >= 0.5)
        })
    })
}

#[test]
fn gradients_are_cut_where_the_solid_meets_the_border() {
    let (dims, spacing, sigma) = ([26, 30, 28], [1.0, 0.8, 0.9], 1.5);
    let settings = gradient(dims, spacing, sigma);
    let edges = settings.lattice.edges();
    let ball = |centre: [f64; 3]| {
        Image::from_fn(dims, |p| {
            let d = (0..3).map(|a| ((p[a] - centre[a]) * spacing[a]).powi(2));
            (0.5 + 9.0 - d.sum::<f64>().sqrt()).clamp(0.0, 1.0)
        })
    };
    // Clear of the border by a voxel or two, so that windows leave the image.
    let clear = ball([12.5, 14.5, 13.5]);
    let rows = tried(float_stream(&clear), at_least(0.5), &settings).unwrap();
    let mut left = 0;
    for i in 0..rows.len() {
        let k = [0, 1, 2].map(|a| rows.k[a][i]);
        left += usize::from(leaves(dims, edges, k, sigma));
        assert!(!has(&rows, i, Flag::Border), "{k:?}");
    }
    assert!(left > 100, "{left}");
    // Cut by the plane x = 0.
    let cut = ball([5.0, 14.5, 13.5]);
    let rows = tried(float_stream(&cut), at_least(0.5), &settings).unwrap();
    let (mut marked, mut unmarked) = (0, 0);
    for i in 0..rows.len() {
        let k = [0, 1, 2].map(|a| rows.k[a][i]);
        let window = |more: f64| {
            let far = |a: usize| {
                let least = if k[a] % 2 == 0 { 0.5 } else { 1.0 };
                (3.0 * sigma / edges[a]).max(least) + more / edges[a]
            };
            let at = |a: usize| f64::from(k[a] - 1) / 2.0;
            let lo = [0, 1, 2].map(|a| (at(a) - far(a) - 1e-9).ceil() as i32);
            (
                lo,
                [0, 1, 2].map(|a| (at(a) + far(a) + 1e-9).floor() as i32),
            )
        };
        let ((lo, hi), (near, far)) = (window(0.0), window(4.0));
        if meets_border(&cut, lo, hi) {
            assert!(has(&rows, i, Flag::Border), "{k:?}");
            marked += 1;
        }
        // Nor do the normals of those whose measures are summed see the border.
        if !meets_border(&cut, near, far) {
            assert!(!has(&rows, i, Flag::Border), "{k:?}");
            unmarked += 1;
        }
    }
    assert!(marked > 100 && unmarked > 100, "{marked} {unmarked}");
}

/// The gradient by its definition: every voxel with its weight.
fn by_definition(image: &Image, edges: [f64; 3], k: [i32; 3], sigma: f64) -> Option<[f64; 3]> {
    let taps = [0, 1, 2].map(|a| {
        let at = f64::from(k[a] - 1) / 2.0;
        let far = 3.0 * sigma / edges[a];
        let mut near: Vec<(i32, f64, f64)> = Vec::new();
        for i in (at - far - 2.0) as i32 - 2..(at + far + 3.0) as i32 + 2 {
            let d = f64::from(i) - at;
            if d.abs() <= far.max(1.0) * (1.0 + 1e-9) {
                let x = d * edges[a];
                near.push((i, x, (-x * x / (2.0 * sigma * sigma)).exp()));
            }
        }
        let sum: f64 = near.iter().map(|t| t.2).sum();
        let moment: f64 = near.iter().map(|t| t.1 * t.1 * t.2).sum();
        near.into_iter()
            .map(|(i, x, g)| (i, g / sum, x * g / moment))
            .collect::<Vec<_>>()
    });
    let mut g = [0.0; 3];
    for &(z, wz, dz) in &taps[2] {
        for &(y, wy, dy) in &taps[1] {
            for &(x, wx, dx) in &taps[0] {
                let v = image.at([x, y, z]);
                g[0] += v * dx * wy * wz;
                g[1] += v * wx * dy * wz;
                g[2] += v * wx * wy * dz;
            }
        }
    }
    let length = g.iter().map(|x| x * x).sum::<f64>().sqrt();
    (length > 0.0 && length.is_finite()).then(|| g.map(|x| x / length))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn normals_are_the_gradient_of_the_definition(
        seed: u64,
        dims in [3usize..20, 2usize..16, 2usize..16],
        spacing in [0.3f64..1.0, 0.3f64..1.0, 0.3f64..1.0],
        sigma in 0.4f64..1.7,
        which in 0usize..3,
    ) {
        let mut image = Image::smooth_noise(dims, seed);
        let count = image.values.len();
        image.values[seed as usize % count] = f32::NAN;
        let criterion = match which {
            0 => at_least(0.1),
            1 => Criterion::Below(0.1.into()),
            _ => Criterion::Between((-0.5).into(), 0.6.into()),
        };
        let settings = gradient(dims, spacing, sigma);
        let rows = tried(float_stream(&image), criterion, &settings).unwrap();
        let edges = settings.lattice.edges();
        let sigma_voxels = sigma;
        for i in 0..rows.len() {
            let k = [0, 1, 2].map(|a| rows.k[a][i]);
            let axis = (0..3).find(|&a| k[a] % 2 == 0).unwrap();
            let side = f64::from(rows.side[i]);
            let (mut inner, mut outer) = (k.map(|k| k >> 1), k.map(|k| k >> 1));
            if side > 0.0 { inner[axis] -= 1 } else { outer[axis] -= 1 }
            let step = image.at(outer) - image.at(inner);
            prop_assert!(step.is_nan() || which == 2 || (step < 0.0) == (which == 0));
            let expected = by_definition(&image, edges, k, sigma_voxels)
                .filter(|_| !step.is_nan())
                .map(|g| g.map(|x| x * step.signum()));
            let found = normal(&rows, i);
            match expected {
                Some(u) => {
                    prop_assert!(!has(&rows, i, Flag::DegenerateNormal));
                    for a in 0..3 {
                        prop_assert!((u[a] - found[a]).abs() < 1e-6, "{:?} {:?}", u, found);
                    }
                }
                None => {
                    prop_assert!(has(&rows, i, Flag::DegenerateNormal));
                    prop_assert_eq!(found[axis], side);
                }
            }
        }
    }

    #[test]
    fn the_cut_does_not_show_in_gradients(
        seed: u64,
        dims in [1usize..40, 1usize..30, 1usize..40],
        sigma in 0.4f64..2.5,
        closed: bool,
        brick in 8i32..30,
        threads in 1usize..8,
    ) {
        let image = Image::smooth_noise(dims, seed);
        let mut settings = gradient(dims, [1.0, 0.8, 0.9], sigma);
        settings.lattice.closed = closed;
        settings.threads = 1;
        let expected = tried(float_stream(&image), at_least(0.0), &settings).unwrap();
        settings.brick = Some(brick);
        settings.threads = threads;
        let rows = tried(float_stream(&image), at_least(0.0), &settings).unwrap();
        prop_assert!(bits(&rows) == bits(&expected));
        if closed {
            // On the closed border there is no step.
            for i in 0..rows.len() {
                let outermost = (0..3).any(|a| [0, 2 * dims[a] as i32].contains(&rows.k[a][i]));
                prop_assert!(!outermost || has(&rows, i, Flag::DegenerateNormal));
                prop_assert!(!has(&rows, i, Flag::Border));
            }
        }
    }
}

#[test]
fn pipes_maps_and_reads_give_the_same_bytes_within_any_memory() {
    let dims = [90, 80, 130];
    let image = Image::smooth_noise(dims, 4);
    let dtype = DType::little(VoxelType::F32);
    let mut settings = gradient(dims, [1.0; 3], 1.5);
    let expected = bits(&tried(float_stream(&image), at_least(0.5), &settings).unwrap());
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("image.raw");
    std::fs::write(&path, image.bytes(ByteOrder::Little)).unwrap();
    for memory_mib in [110, 128, 200, 1024] {
        settings.memory_bytes = memory_mib << 20;
        let volume = open(&path, &options(dims, dtype)).unwrap();
        match tried(volume, at_least(0.5), &settings) {
            Ok(rows) => assert!(bits(&rows) == expected, "{memory_mib} MiB"),
            Err(Error::TooDense { .. } | Error::Plan(_)) => assert!(memory_mib < 200),
            Err(other) => panic!("{other}"),
        }
    }
}

/// Rows of an image that is one ramp plus a bump, stored as `i16`.
fn stored_as_i16(order: ByteOrder, scaling: Option<Scaling>, criterion: Criterion) -> SurfelBatch {
    let dims = [24, 22, 20];
    let image = Image::from_fn(dims, |p| {
        let d2: f64 = p.iter().map(|x| (x - 10.3) * (x - 10.3)).sum();
        (900.0 - 8.0 * d2).round()
    });
    let stored = |v: &f32| match order {
        ByteOrder::Little => (*v as i16).to_le_bytes(),
        ByteOrder::Big => (*v as i16).to_be_bytes(),
    };
    let bytes = image.values.iter().flat_map(stored).collect();
    let dtype = DType {
        voxel: VoxelType::I16,
        byte_order: order,
    };
    let mut volume = stream(dims, dtype, bytes);
    volume.header.scaling = scaling;
    tried(volume, criterion, &gradient(dims, [1.0; 3], 1.2)).unwrap()
}

/// Root mean square error of H on a ball of radius 9 at gridstep 1/2, blurred by a voxel, with noise.
fn error_on_a_ball(estimator: Estimator, noise: f64) -> f64 {
    let mut grid = Grid::cubic(0.5);
    grid.offset = DVec3::new(0.3, -0.2, 0.4);
    let digitisation = Digitisation::new(Sphere::new(9.0).unwrap(), grid).unwrap();
    let scanner = Scanner {
        blur: 1.0,
        noise,
        seed: 2,
    };
    let mut planes = GreyPlanes::new(&digitisation, scanner).unwrap();
    let (mut values, mut plane) = (Vec::new(), Vec::new());
    while planes.next_plane(&mut plane) {
        values.extend(plane.iter().map(|&v| v as f32));
    }
    let dims = digitisation.dims();
    let mut settings = gradient(dims, [0.5; 3], 1.5);
    settings.estimator = estimator;
    settings.radii = vec![3.0 / 0.5f64.sqrt()];
    let rows = tried(
        float_stream(&Image { dims, values }),
        at_least(0.5),
        &settings,
    )
    .unwrap();
    let errors = rows.curvatures[0].mean.iter();
    let sum: f64 = errors.map(|&h| (f64::from(h) - 1.0 / 9.0).powi(2)).sum();
    (sum / rows.len() as f64).sqrt()
}

#[test]
fn on_grey_images_gradients_halve_the_errors_of_integral_invariants() {
    for noise in [0.0, 0.05] {
        let radius = 3.0 / 0.5f64.sqrt();
        let of_bits = error_on_a_ball(
            Estimator::IntegralInvariant {
                radius,
                orientation: Orientation::Moment,
            },
            noise,
        );
        let of_values = error_on_a_ball(Estimator::Gradient { sigma: 1.5 }, noise);
        // .0056 and .0008 without noise, .0060 and .0020 with it
        assert!(of_values < 0.5 * of_bits, "{of_values} {of_bits}");
        assert!(of_bits < 0.008, "{of_bits}");
    }
}

#[test]
fn byte_order_and_scaling_are_honoured() {
    let plain = stored_as_i16(ByteOrder::Little, None, at_least(400.0));
    assert!(plain.len() > 500);
    assert!((0..plain.len()).all(|i| !has(&plain, i, Flag::DegenerateNormal)));
    let big = stored_as_i16(ByteOrder::Big, None, at_least(400.0));
    assert!(bits(&big) == bits(&plain));
    // A negative slope turns the values over: the same solid is now what lies below.
    let scaling = Scaling {
        slope: -0.5,
        intercept: 10.0,
    };
    let below = Criterion::Between((-1e9).into(), (-190.0).into());
    let turned = stored_as_i16(ByteOrder::Little, Some(scaling), below);
    assert_eq!(turned.k, plain.k);
    for a in 0..3 {
        for (u, v) in turned.normal[a].iter().zip(&plain.normal[a]) {
            assert!((u - v).abs() < 1e-6);
        }
    }
    // And with a threshold the solid is the outside of the ball, its normals the other way.
    let hollow = stored_as_i16(ByteOrder::Little, Some(scaling), at_least(-189.9));
    assert_eq!(hollow.k, plain.k);
    for a in 0..3 {
        for (u, v) in hollow.normal[a].iter().zip(&plain.normal[a]) {
            assert!((u + v).abs() < 1e-6);
        }
    }
}

#[test]
fn values_take_memory_that_the_plan_counts() {
    let lattice = Lattice::new([4096, 4096, 500], [1.0; 3], false).unwrap();
    let mut settings = Settings::new(lattice);
    let bits_alone = settings.plan(&Access::forward(2), 0).unwrap();
    assert_eq!(bits_alone.grey_bytes, 0);
    settings.estimator = Estimator::Gradient { sigma: 1.5 };
    settings.memory_bytes = 2 << 30;
    let plan = settings.plan(&Access::forward(2), 0).unwrap();
    let plane = 4096 * 4096 * 2;
    let reach = u64::try_from(plan.normal_reach[2]).unwrap();
    assert!(plan.grey_bytes >= (plan.slab_planes as u64 + 2 * reach) * plane);
    assert!(plan.fixed_bytes + plan.grey_bytes + plan.bits_bytes + plan.read_bytes < 2 << 30);
    settings.memory_bytes = 400 << 20;
    let refused = settings
        .plan(&Access::forward(2), 0)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("grey values") && refused.contains("--memory"),
        "{refused}"
    );
}
