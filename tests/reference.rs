//! Production against numbers from elsewhere: DGtal's tables, the truth, and facts about volumes
//! that were counted without curvox. Skips aloud where the folders are not at hand:
//! `CURVOX_TEST_REFERENCE` (tables) and `CURVOX_TEST_DATA` (volumes).

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use curvox::khalimsky::Adjacency;
use curvox::lattice::Lattice;
use curvox::measure::ball::Weights;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::{Access, Outcome, Progress, Settings, Source, run};
use curvox::surfel::SurfelIndex;
use curvox::volume::{Binarizer, BitPlane, Criterion, PlaneWindow, SolidCounts};
use curvox_formats::{OpenOptions, Volume, open};
use curvox_tools::accuracy::KnownShape;
use curvox_tools::causes::Causes;
use curvox_tools::npz::Table;
use curvox_tools::plain::algebra::{Vector, dot, scaled};
use curvox_tools::plain::{self, Ball, Cells, Scale, Solid, Surface, Walk};
use curvox_tools::{dgtal, goursat, vol};
use serde_json::Value;

use crate::common::{Collected, FullRow, lattice, whole};

/// The folder an environment variable names; says so if it is not set.
pub(crate) fn folder(variable: &str, test: &str) -> Option<PathBuf> {
    let folder = std::env::var_os(variable).map(PathBuf::from);
    if folder.is_none() {
        println!("SKIPPED: {test}: {variable} is not set");
    }
    folder
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

// DGtal, surfel by surfel.

/// The columns compared and how near they must be. A direction is as good as k2 - k1 is large:
/// their product with its difference is compared.
const BOUNDS: [(&str, f64); 7] = [
    ("normal_II", 1e-9),
    ("H_CNC", 1e-9),
    ("G_CNC", 1e-7),
    ("k1", 1e-6),
    ("k2", 1e-6),
    ("d1", 1e-6),
    ("d2", 1e-6),
];

/// Normals that differ by more are others.
const SAME_NORMAL: f64 = 1e-9;

/// A surfel whose normal is this near to its plane has no sign that rounding does not decide.
const TIE: f64 = 1e-9;

/// Rows compared, and those beyond the bound.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Count {
    rows: usize,
    beyond: usize,
}

/// How production compares with a column.
#[derive(Clone, Copy, Debug, Default)]
struct Agreement {
    /// Rows whose ball has a cell where DGtal folds, drops or takes another normal.
    caused: Count,
    /// All others.
    clean: Count,
    /// The largest difference of these.
    largest: f64,
}

/// DGtal's method on a solid, in full precision: its normals (or those turned away from the first
/// moment), its weights, connected, r = rho = 3 h^(1/2).
fn paper(solid: &Solid, gridstep: f64, orientation: Orientation) -> Vec<FullRow> {
    let radius = 3.0 / gridstep.sqrt();
    let mut settings = Settings::new(lattice(solid, [gridstep; 3], false));
    settings.estimator = Estimator::IntegralInvariant {
        radius,
        orientation,
    };
    settings.weights = Weights::Dgtal;
    settings.radii = vec![radius];
    whole(solid, &settings).rows
}

/// Compares production with every row of a table; `shift` is added to its Khalimsky coordinates.
fn compare(
    solid: &Solid,
    gridstep: f64,
    shift: i32,
    table: &Table,
    orientation: Orientation,
) -> [Agreement; 7] {
    let rows = paper(solid, gridstep, orientation);
    let surface = Surface::new(solid, false, plain::Adjacency::Interior);
    let scale = Scale::new([gridstep; 3]);
    let places = table.triples("k").unwrap();
    assert_eq!(places.len(), rows.len());
    assert_eq!(places.len(), surface.len());
    let order: Vec<u32> = places
        .iter()
        .map(|place| surface.find(place.map(|k| k as i32 + shift)).unwrap())
        .collect();
    let row = |i: usize| {
        let f = order[i] as usize;
        assert_eq!(rows[f].k, surface.surfels[f].k);
        &rows[f]
    };

    // Where DGtal differs by design: cells judged by their shape and DGtal's own normals.
    let u = table.triples("normal_II").unwrap();
    let mesh = dgtal::Mesh::new(order.iter().map(|&f| surface.surfels[f as usize]).collect());
    let other_normals = (0..u.len())
        .map(|i| {
            let own = row(i).u.to_array();
            let by_rule = dot(own, surface.surfels[order[i] as usize].normal()).abs() < TIE;
            by_rule || difference(own, u[i]) > SAME_NORMAL
        })
        .collect();
    let mut u_by_surfel = vec![[0.0; 3]; u.len()];
    for (&f, &u) in order.iter().zip(&u) {
        u_by_surfel[f as usize] = u;
    }
    let causes = Causes::new(
        &mesh,
        &u,
        &dgtal::Cells::new(&mesh, &u),
        &surface,
        &order,
        &Cells::new(&surface, &u_by_surfel, &scale),
        other_normals,
    );

    let [mean, gaussian, k1, k2] =
        ["H_CNC", "G_CNC", "k1", "k2"].map(|name| table.column(name).unwrap());
    let directions = ["d1", "d2"].map(|name| table.triples(name).unwrap());
    let radius = 3.0 / gridstep.sqrt();
    let ball = Ball::new(&scale, radius, plain::Weights::Dgtal);
    let mut walk = Walk::new(&surface);
    let mut gathered = dgtal::Ball::new(&mesh, radius);
    let mut found = [Agreement::default(); 7];
    for i in 0..u.len() {
        gathered.gather(i as u32);
        let of_row = causes.in_ball(&gathered, &order, &surface, &mut walk, &ball, order[i]);
        let own = row(i);
        let mut differences = [f64::NAN; 7];
        differences[0] = difference(own.u.to_array(), u[i]);
        if let Some(c) = own.curvature {
            differences[1] = (c.mean - mean[i]).abs();
            differences[2] = (c.gaussian - gaussian[i]).abs();
            differences[3] = (c.k1 - k1[i]).abs();
            differences[4] = (c.k2 - k2[i]).abs();
            for (j, d) in [c.d1, c.d2].into_iter().enumerate() {
                let expected = directions[j][i];
                let sign = dot(d.to_array(), expected).signum();
                differences[5 + j] =
                    difference(d.to_array(), scaled(expected, sign)) * (c.k2 - c.k1);
            }
        }
        for (j, agreement) in found.iter_mut().enumerate() {
            let is_caused = match j {
                0 => causes.normals[i],
                2 => !of_row.gaussian.is_empty(),
                _ => !of_row.bending.is_empty(),
            };
            let count = if is_caused {
                &mut agreement.caused
            } else {
                &mut agreement.clean
            };
            count.rows += 1;
            // In total order NaN is the largest: it is beyond every bound.
            count.beyond += usize::from(differences[j].total_cmp(&BOUNDS[j].1).is_gt());
            if !is_caused && differences[j].total_cmp(&agreement.largest).is_gt() {
                agreement.largest = differences[j];
            }
        }
    }
    let (mut others, mut opposite) = (0, 0);
    for i in (0..u.len()).filter(|&i| causes.normals[i]) {
        others += 1;
        let own = row(i).u.to_array();
        opposite += usize::from(difference(scaled(own, -1.0), u[i]) <= SAME_NORMAL);
        // DGtal's rule leaves nothing open but the sign of normals in the plane of their surfel.
        let trivial = surface.surfels[order[i] as usize].normal();
        let is_tie = dot(own, trivial).abs() < TIE && dot(u[i], trivial).abs() < TIE;
        assert!(orientation != Orientation::Trivial || is_tie);
    }
    println!("{others} normals are others, {opposite} of them opposite");
    for ((name, bound), a) in BOUNDS.iter().zip(&found) {
        println!(
            "{name}: without a cause {} of {} differ, largest {:.1e} (bound {bound:.0e}); with a cause {} of {}",
            a.clean.beyond, a.clean.rows, a.largest, a.caused.beyond, a.caused.rows
        );
    }
    found
}

/// Largest difference of the coordinates.
fn difference(a: Vector, b: Vector) -> f64 {
    (0..3)
        .map(|i| (a[i] - b[i]).abs())
        .max_by(f64::total_cmp)
        .unwrap_or(f64::NAN)
}

#[test]
fn every_row_of_goursat_is_dgtal_s() {
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", "DGtal's rows of Goursat") else {
        return;
    };
    for gridstep in [1.0, 0.5, 0.25] {
        let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz"))).unwrap();
        let (solid, origin) = goursat::digitised(gridstep);
        for orientation in [Orientation::Trivial, Orientation::Moment] {
            println!("Goursat, h = {gridstep}, {orientation:?}");
            for a in compare(&solid, gridstep, 2 * origin, &table, orientation) {
                assert_eq!(a.clean.beyond, 0);
                assert_eq!(a.caused.beyond, 0);
            }
        }
    }
}

#[test]
fn rows_of_the_dragon_differ_from_dgtal_s_where_there_is_a_cause() {
    let test = "DGtal's rows of the dragon";
    let (Some(reference), Some(data)) = (
        folder("CURVOX_TEST_REFERENCE", test),
        folder("CURVOX_TEST_DATA", test),
    ) else {
        return;
    };
    let table = Table::read(&reference.join("dragon128_h1.npz")).unwrap();
    let solid = vol::read(&data.join("vol-gallery/dragon-128.vol")).unwrap();
    for orientation in [Orientation::Trivial, Orientation::Moment] {
        println!("dragon, {orientation:?}");
        // The file's first voxel has coordinate -1.
        for a in compare(&solid, 1.0, 2, &table, orientation) {
            assert!(a.clean.rows > 0);
            assert_eq!(a.clean.beyond, 0);
            // The causes are no excuse: nearly every row that has one differs.
            let agree = a.caused.rows - a.caused.beyond;
            assert!(32 * agree <= a.caused.rows, "{a:?}");
        }
    }
}

// The truth.

/// l2 and linf of the differences from the truth.
fn errors(values: impl Iterator<Item = f64>, truth: impl Iterator<Item = f64>) -> [f64; 2] {
    let (mut squares, mut largest, mut count) = (0.0, 0.0f64, 0u32);
    for (value, truth) in values.zip(truth) {
        let error = (value - truth).abs();
        assert!(error.is_finite());
        squares += error * error;
        largest = largest.max(error);
        count += 1;
    }
    [(squares / f64::from(count)).sqrt(), largest]
}

/// How much worse than DGtal's an error of the default method may be.
const NOT_WORSE: f64 = 1.05;

/// The one error that is: the largest of H on the coarsest grid, at 1.073 times DGtal's.
const WORSE: ((f64, &str, &str), f64) = ((1.0, "H_CNC", "linf"), 1.08);

#[test]
fn errors_of_the_default_method_are_not_worse_than_dgtal_s() {
    let Some(reference) = folder("CURVOX_TEST_REFERENCE", "errors on Goursat") else {
        return;
    };
    println!("| h | weights | quantity | curvox l2 / linf | DGtal l2 / linf | ratios |");
    println!("|---|---|---|---|---|---|");
    let mut worse = Vec::new();
    for gridstep in [1.0, 0.5, 0.25] {
        let table = Table::read(&reference.join(format!("goursat_h{gridstep}.npz"))).unwrap();
        let shape = KnownShape::goursat(&reference, gridstep).unwrap();
        let (_, origin) = goursat::digitised(gridstep);
        let places = table.triples("k").unwrap();
        let of_row = |i: usize| {
            let place = places[i].map(|k| k as i32 + 2 * origin);
            shape.surface.find(place).unwrap() as usize
        };
        for weights in [Weights::Lumped, Weights::Sharp] {
            let radius = 3.0 / gridstep.sqrt();
            let mut settings = Settings::new(lattice(&shape.solid, [gridstep; 3], false));
            settings.estimator = Estimator::IntegralInvariant {
                radius,
                orientation: Orientation::Moment,
            };
            settings.radii = vec![radius];
            settings.weights = weights;
            let rows = whole(&shape.solid, &settings).rows;
            for (j, name) in ["H_CNC", "G_CNC", "k1", "k2"].into_iter().enumerate() {
                let own = rows.iter().map(|row| {
                    let c = row.curvature.unwrap();
                    [c.mean, c.gaussian, c.k1, c.k2][j]
                });
                let own = errors(own, shape.truth.iter().map(|truth| truth[j]));
                let theirs = table.column(name).unwrap().iter().copied();
                let truth = (0..places.len()).map(|i| shape.truth[of_row(i)][j]);
                let theirs = errors(theirs, truth);
                let ratios = [0, 1].map(|norm| own[norm] / theirs[norm]);
                println!(
                    "| {gridstep} | {weights:?} | {name} | {:.5} / {:.5} | {:.5} / {:.5} | {:.3} / {:.3} |",
                    own[0], own[1], theirs[0], theirs[1], ratios[0], ratios[1]
                );
                // Other weights are there to compare with.
                let is_default = weights == Weights::Lumped;
                for (norm, ratio) in ["l2", "linf"].into_iter().zip(ratios) {
                    let known = (gridstep, name, norm) == WORSE.0;
                    let bound = if known { WORSE.1 } else { NOT_WORSE };
                    if is_default && ratio > bound {
                        worse.push(format!("{norm} of {name} at h = {gridstep}: {ratio}"));
                    }
                }
            }
        }
    }
    assert!(worse.is_empty(), "{worse:#?}");
}

// Facts about volumes.

/// A volume and what is inside of it.
fn source(path: &Path, criterion: Criterion) -> Source {
    let volume = open(path, &OpenOptions::default()).unwrap();
    let header = &volume.header;
    let binarizer = Binarizer::new(criterion, header.voxel, header.byte_order, header.scaling);
    Source { volume, binarizer }
}

fn not_zero() -> Criterion {
    Criterion::AtLeast(1i128.into())
}

/// All of a volume as bits.
fn bits(Source { volume, binarizer }: Source) -> PlaneWindow {
    let dims = volume.header.dims.map(|n| u32::try_from(n).unwrap());
    let row_bytes = dims[0] as usize * volume.header.voxel.bytes();
    let mut voxels = Volume::into_forward(volume);
    let (mut planes, mut stored) = (Vec::new(), Vec::new());
    while voxels.read_planes(1, &mut stored).unwrap() > 0 {
        let mut plane = BitPlane::outside(dims[0], dims[1]);
        for (row, out) in stored.chunks(row_bytes).zip(plane.rows_mut()) {
            binarizer.pack_row(row, out);
        }
        planes.push(Arc::new(plane));
    }
    assert_eq!(voxels.finish().unwrap(), [""; 0]);
    PlaneWindow {
        dims,
        z0: 0,
        planes,
    }
}

/// Surfels of all planes, counted without an index.
fn surfels(window: &PlaneWindow, closed: bool) -> u64 {
    let dims = window.dims.map(u64::from);
    let lattice = Lattice::new(dims, [1.0; 3], closed).unwrap();
    (0..=window.dims[2] as i32)
        .map(|z| SurfelIndex::count_plane(window, z, &lattice))
        .sum()
}

#[test]
fn volumes_of_the_gallery_have_the_surfels_and_voxels_they_should() {
    /// Larger ones would take long.
    const MAX_VOXELS: u64 = 260 * 260 * 260;
    let Some(data) = folder("CURVOX_TEST_DATA", "surfel counts of the gallery") else {
        return;
    };
    let facts = json(&data.join("vol-gallery/facts.json"));
    let mut count = 0;
    for (name, facts) in facts.as_object().unwrap() {
        let dims: Vec<u64> = serde_json::from_value(facts["dims"].clone()).unwrap();
        if dims.iter().product::<u64>() > MAX_VOXELS {
            continue;
        }
        let window = bits(source(&data.join("vol-gallery").join(name), not_zero()));
        let mut solid = SolidCounts::default();
        for z in 0..=window.dims[2] as i32 {
            solid.add(&SolidCounts::of_plane(&window, z));
        }
        let fact = |key: &str| facts[key].as_i64().unwrap();
        assert_eq!(solid.voxels as i64, fact("voxels"), "{name}");
        assert_eq!(solid.chi6, fact("euler_solid_6"), "{name}");
        assert_eq!(solid.chi26, fact("euler_solid_26"), "{name}");
        assert_eq!(
            surfels(&window, false) as i64,
            fact("surfels_interior"),
            "{name}"
        );
        assert_eq!(surfels(&window, true) as i64, fact("surfels"), "{name}");
        count += 1;
    }
    println!("{count} volumes of the gallery");
    assert_eq!(count, 34);
}

/// Runs the pipeline on a volume, without keeping rows; gives their number as well.
fn piped(path: &Path, criterion: Criterion, settings: &Settings) -> (u64, Outcome) {
    let source = source(path, criterion);
    let plan = settings.plan(&Access::forward(8), 0).unwrap();
    let mut rows = Collected::default();
    let progress = Progress::default();
    let stop = AtomicBool::new(false);
    let outcome = run(source, settings, &plan, &mut [&mut rows], &progress, &stop).unwrap();
    (rows.0.iter().map(|batch| batch.len() as u64).sum(), outcome)
}

/// Gauss-Bonnet in integers, and V - E + F as the voxels have it.
fn check_euler(outcome: &Outcome, adjacency: Adjacency, name: &str) {
    let (cells, solid) = (&outcome.cells, &outcome.solid);
    assert_eq!(cells.border_linels, 0, "{name}");
    let counted = cells.euler_counted();
    assert_eq!(cells.euler_gauss_bonnet(), Some(counted), "{name}");
    let expected = match adjacency {
        Adjacency::Interior => 2 * (solid.chi6 + solid.antipodal_outside as i64),
        Adjacency::Exterior => 2 * (solid.chi26 + solid.antipodal_inside as i64),
    };
    assert_eq!(counted, i128::from(expected), "{name}");
}

/// Checks the counts of a solid in a volume, open and closed, and Euler's law on the closed one.
fn check_facts(path: &Path, criterion: Criterion, facts: &Value) {
    let name = path.display().to_string();
    let dims: Vec<u64> = serde_json::from_value(facts["dims"].clone()).unwrap();
    let dims = [dims[0], dims[1], dims[2]];
    let fact = |key: &str| facts[key].as_i64().unwrap();
    let estimators = [
        Estimator::Trivial,
        Estimator::IntegralInvariant {
            radius: 3.0,
            orientation: Orientation::Moment,
        },
        Estimator::IntegralInvariant {
            radius: 3.0,
            orientation: Orientation::Trivial,
        },
        Estimator::SurfaceAverage { radius: 3.0 },
    ];
    for closed in [false, true] {
        let mut settings = Settings::new(Lattice::new(dims, [1.0; 3], closed).unwrap());
        settings.brick = Some(16);
        let surfels = fact(if closed {
            "surfels"
        } else {
            "surfels_interior"
        });
        for adjacency in [Adjacency::Interior, Adjacency::Exterior] {
            settings.adjacency = adjacency;
            for estimator in estimators {
                settings.estimator = estimator;
                let (rows, outcome) = piped(path, criterion, &settings);
                assert_eq!(rows as i64, surfels, "{name}");
                assert_eq!(outcome.cells.surfel_count(), rows, "{name}");
                assert_eq!(outcome.solid.voxels as i64, fact("voxels"), "{name}");
                assert_eq!(outcome.solid.chi6, fact("euler_solid_6"), "{name}");
                assert_eq!(outcome.solid.chi26, fact("euler_solid_26"), "{name}");
                if closed {
                    for (axis, found) in outcome.cells.surfels.iter().enumerate() {
                        let expected = facts["surfels_xyz"][axis].as_u64();
                        assert_eq!(Some(*found), expected, "{name}");
                    }
                    check_euler(&outcome, adjacency, &name);
                }
            }
        }
    }
}

#[test]
fn awkward_solids_have_the_counts_they_should() {
    let Some(data) = folder("CURVOX_TEST_DATA", "counts of awkward solids") else {
        return;
    };
    let folder = data.join("hostile/topology");
    let expected = json(&data.join("hostile/expected.json"));
    let expected = expected["topology"].as_object().unwrap();
    let mut count = 0;
    for (name, facts) in expected {
        let path = folder.join(name);
        if let Some(labels) = facts["per_label"].as_object() {
            for (label, facts) in labels {
                check_facts(&path, Criterion::Label(label.parse().unwrap()), facts);
                count += 1;
            }
        } else {
            check_facts(&path, not_zero(), facts);
            count += 1;
        }
    }
    println!("{count} awkward solids");
    assert_eq!(count, 33);
}

#[test]
fn a_folded_sheet_has_the_counts_it_should() {
    let Some(data) = folder("CURVOX_TEST_DATA", "counts of a grey-matter mask") else {
        return;
    };
    let path = data.join("formats/gm-mask/ref.npy");
    for adjacency in [Adjacency::Interior, Adjacency::Exterior] {
        let dims = [77, 96, 80];
        let mut settings = Settings::new(Lattice::new(dims, [2.0; 3], true).unwrap());
        settings.adjacency = adjacency;
        let (rows, outcome) = piped(&path, not_zero(), &settings);
        assert_eq!(rows, 128_784);
        assert_eq!(outcome.solid.voxels, 134_713);
        assert_eq!(outcome.solid.chi6, -376);
        assert_eq!(outcome.solid.chi26, -244);
        check_euler(&outcome, adjacency, "gm-mask");
    }
}
