use std::f64::consts::PI;

use curvox::khalimsky::Adjacency;
use curvox::measure::ball::Weights;
use curvox::measure::cells::{Asked, CellMeasures, CellTotals, Keep, mark};
use curvox::measure::evaluate;
use curvox::measure::field::Field;
use curvox::measure::fixed::{LUMPED_SOLID_ANGLE, to_measure, to_solid_angle};
use curvox::measure::formula::spherical_triangle;
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::Settings;
use curvox::shape::{Cylinder, Goursat, ImplicitShape, Sphere, SurfaceTruth, Torus, closest_point};
use curvox_tools::plain::{self, Solid};
use glam::DVec3;

use crate::analytic::{Digitised, digitise, errors, paper};
use crate::common::{Random, asked, blob, lattice, noise, surface, whole, whole_with};

const FIELDS: [Field; 3] = [Field::Constant, Field::Interpolated, Field::Linear];

fn ii(radius: f64) -> Estimator {
    Estimator::IntegralInvariant {
        radius,
        orientation: Orientation::Moment,
    }
}

/// Measures of all cells of a solid with given normals.
fn cells(
    solid: &Solid,
    settings: &Settings,
    u: &[DVec3],
    asked: Asked,
) -> (CellMeasures, CellTotals) {
    let (surface, core) = surface(solid, settings);
    let marks = vec![0; surface.len()];
    evaluate(&surface, core, settings.lattice.edges(), u, &marks, asked)
}

/// The truth at the point of the shape that is closest to each surfel.
fn truths(shape: &impl ImplicitShape, d: &Digitised, settings: &Settings) -> Vec<SurfaceTruth> {
    let (surface, _) = surface(&d.solid, settings);
    (0..surface.len())
        .map(|i| {
            let place = d.place(surface.surfels.khalimsky(i));
            closest_point(shape, place).unwrap().truth
        })
        .collect()
}

/// Numbers to read.
fn brief(values: [f64; 3]) -> String {
    let [a, b, c] = values;
    format!("{a:.1e} {b:.1e} {c:.1e}")
}

fn normals_of(truths: &[SurfaceTruth]) -> Vec<DVec3> {
    truths.iter().map(|t| t.normal).collect()
}

#[test]
fn gauss_bonnet_holds_in_integers_for_all_normals_and_fields_of_unit_length() {
    let estimators = [
        ("trivial", Estimator::Trivial),
        ("ii", ii(2.5)),
        (
            "ii dgtal",
            Estimator::IntegralInvariant {
                radius: 2.5,
                orientation: Orientation::Trivial,
            },
        ),
        ("average", Estimator::SurfaceAverage { radius: 2.5 }),
    ];
    for (name, solid) in [
        ("noise 0.1", noise([20, 17, 18], 0.1, 1)),
        ("noise 0.5", noise([20, 17, 18], 0.5, 2)),
        ("blob", blob([40, 36, 30], 3)),
    ] {
        for adjacency in [Adjacency::Interior, Adjacency::Exterior] {
            for (normals, estimator) in estimators {
                for field in [Field::Constant, Field::Interpolated] {
                    let settings = Settings {
                        adjacency,
                        estimator,
                        field,
                        radii: vec![1.0],
                        ..Settings::new(lattice(&solid, [1.0, 0.8, 0.9], true))
                    };
                    let totals = whole(&solid, &settings).totals;
                    assert_eq!(
                        totals.euler_gauss_bonnet(),
                        Some(totals.euler_counted()),
                        "{name} {normals} {field:?}"
                    );
                    println!(
                        "{name}, {adjacency:?}, {normals}, {field:?}: sum|k| = {} of {} pointels, {} surfels",
                        totals.absolute_lifts,
                        totals.pointels,
                        totals.surfel_count()
                    );
                }
            }
        }
    }
}

#[test]
fn gauss_bonnet_holds_in_integers_for_random_normals() {
    let mut random = Random(5);
    for seed in 0..6 {
        let solid = noise([14, 13, 12], 0.1 + 0.15 * seed as f64, seed);
        let settings = Settings::new(lattice(&solid, [1.0; 3], true));
        let count = surface(&solid, &settings).0.len();
        let u: Vec<DVec3> = (0..count).map(|_| direction(&mut random)).collect();
        for field in [Field::Constant, Field::Interpolated] {
            let asked = Asked {
                field,
                keep: Keep::Lumped,
                quality: true,
            };
            let (measures, totals) = cells(&solid, &settings, &u, asked);
            assert_eq!(totals.euler_gauss_bonnet(), Some(totals.euler_counted()));
            assert_eq!(measures.omega.iter().sum::<i64>(), 0);
            let lifted = measures.marks.iter().filter(|&&m| m & mark::LIFTED != 0);
            assert!(totals.absolute_lifts > 0 && lifted.count() > 0);
            let share = totals.absolute_lifts as f64 / count as f64;
            println!("{field:?}: sum|k| / surfels = {share:.3}");
        }
    }
}

/// Totals over the truth, less 1: area, mu1, and mu2 less its truth in units of 4 pi.
fn off_by(d: &Digitised, settings: &Settings, u: &[DVec3], truth: [f64; 3]) -> [f64; 3] {
    let (_, totals) = cells(&d.solid, settings, u, asked(settings));
    let unit = settings.lattice.voxel_unit_world();
    [
        to_measure(totals.mu0) * unit * unit / truth[0] - 1.0,
        to_measure(totals.mu1) * unit / truth[1] - 1.0,
        (to_solid_angle(totals.mu2) - truth[2]) / (4.0 * PI),
    ]
}

#[test]
fn totals_of_sphere_torus_and_cylinder_converge() {
    let sphere = Sphere::new(4.0).unwrap();
    let torus = Torus::new(5.0, 2.0).unwrap();
    let cylinder = Cylinder::new(3.0, 4.0).unwrap();
    let closed = [
        (
            "sphere",
            &sphere as &dyn ImplicitShape,
            [64.0 * PI, 32.0 * PI, 4.0 * PI],
        ),
        ("torus", &torus, [40.0 * PI * PI, 20.0 * PI * PI, 0.0]),
    ];
    for h in [0.5, 0.25, 0.125] {
        let mut cases: Vec<_> = closed.to_vec();
        // the cylinder goes through the image, so it is as long as the image
        let d = digitise(cylinder, DVec3::splat(h));
        let length = d.solid.dims[2] as f64 * h;
        cases.push((
            "cylinder",
            &cylinder,
            [6.0 * PI * length, 2.0 * PI * length, 0.0],
        ));
        for (name, shape, truth) in cases {
            let d = digitise(shape, DVec3::splat(h));
            let mut settings = paper(&d, h);
            let exact = normals_of(&truths(&shape, &d, &settings));
            for field in FIELDS {
                settings.field = field;
                let found = off_by(&d, &settings, &exact, truth);
                println!(
                    "{name}, h = {h}, {field:?}, exact normals: {}",
                    brief(found)
                );
                // linear: u is shorter than 1 between pointels, by h^2 k^2 / 8 at most
                assert!(found[0].abs() < 0.1 * h, "area {}", found[0]);
                assert!(found[1].abs() < 0.1 * h, "mu1 {}", found[1]);
                let slack = if field == Field::Linear {
                    0.1 * h * h
                } else {
                    1e-12
                };
                assert!(found[2].abs() < slack, "mu2 {}", found[2]);
                if name != "cylinder" {
                    let u: Vec<DVec3> = whole(&d.solid, &settings)
                        .rows
                        .iter()
                        .map(|r| r.u)
                        .collect();
                    let found = off_by(&d, &settings, &u, truth);
                    println!("{name}, h = {h}, {field:?}, ii normals: {}", brief(found));
                    assert!(found[0].abs() < 0.15 * h && found[1].abs() < 0.15 * h);
                    assert!(found[2].abs() < slack.max(1e-12) * 2.0);
                }
            }
        }
    }
}

#[test]
fn mu_omega_is_zero_over_a_closed_surface_in_integers() {
    for (seed, closed) in [(1, true), (2, true), (3, true)] {
        let solid = noise([15, 12, 13], 0.3 * seed as f64, seed);
        for field in FIELDS {
            for estimator in [ii(2.0), Estimator::SurfaceAverage { radius: 2.0 }] {
                for keep in [Keep::Lumped, Keep::Cells] {
                    let settings = Settings {
                        estimator,
                        ..Settings::new(lattice(&solid, [1.0, 0.6, 0.8], closed))
                    };
                    let u: Vec<DVec3> = whole(&solid, &settings).rows.iter().map(|r| r.u).collect();
                    let asked = Asked {
                        field,
                        keep,
                        quality: true,
                    };
                    let (measures, totals) = cells(&solid, &settings, &u, asked);
                    assert_eq!(totals.border_linels, 0);
                    assert!(measures.omega.iter().any(|&x| x != 0));
                    assert_eq!(measures.omega.iter().sum::<i64>(), 0);
                }
            }
        }
    }
}

/// Root mean square of a value of each row.
fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|x| x * x).sum::<f64>() / count).sqrt()
}

#[test]
fn quality_falls_with_the_gridstep_and_errors_of_the_fields_are_alike() {
    for exact in [false, true] {
        for field in FIELDS {
            let mut last = f64::INFINITY;
            for h in [1.0, 0.5, 0.25] {
                let d = digitise(Goursat, DVec3::splat(h));
                let mut settings = paper(&d, h);
                settings.field = field;
                settings.quality = true;
                let given = exact.then(|| normals_of(&truths(&Goursat, &d, &settings)));
                let whole = whole_with(&d.solid, &settings, given.as_deref());
                let of = |f: fn(&curvox::curvature::Curvature) -> f64| {
                    rms(whole.rows.iter().map(|r| f(r.curvature.as_ref().unwrap())))
                };
                let (quality, mean) = (of(|c| c.quality), of(|c| c.mean));
                let [of_mean, of_gaussian] = errors(&Goursat, &d, &whole.rows);
                let normals = if exact { "exact" } else { "ii" };
                println!(
                    "{normals} normals, {field:?}, h = {h}: quality {quality:.2e} (H {mean:.2e}), \
                     l2 of H {of_mean:.5}, of G {of_gaussian:.5}"
                );
                assert!(quality < last && quality < 0.05 * mean, "{quality} {last}");
                last = quality;
                // l2 of DGtal with constant, ii normals; exact ones are better
                let [bound, bound_g] = match h {
                    1.0 => [0.0308, 0.0112],
                    0.5 => [0.0269, 0.0092],
                    _ => [0.0102, 0.00425],
                };
                assert!(of_mean < 1.1 * bound && of_gaussian < 1.1 * bound_g);
            }
        }
    }
}

fn direction(random: &mut Random) -> DVec3 {
    loop {
        let v = DVec3::from_array([0; 3].map(|_| 2.0 * random.next() - 1.0));
        if (0.01..1.0).contains(&v.length_squared()) {
            return v.normalize();
        }
    }
}

/// Signed area of the fan of triangles from a centre to a closed polygon on the sphere.
fn fan(centre: DVec3, polygon: &[DVec3]) -> f64 {
    let next = polygon.iter().cycle().skip(1);
    polygon
        .iter()
        .zip(next)
        .map(|(&a, &b)| spherical_triangle(centre, a, b))
        .sum()
}

/// Definition 2.6 takes the mean normal u(p) as the centre of the fan above a vertex; Remark 2.7
/// says that the area does not depend on it.
#[test]
fn mu2_is_the_area_of_the_fan_from_any_centre_in_the_hemisphere() {
    let mut random = Random(11);
    for seed in 0..4 {
        let solid = noise([9, 9, 9], 0.4, seed);
        let settings = Settings::new(lattice(&solid, [1.0; 3], true));
        let plain = plain::Surface::new(&solid, true, plain::Adjacency::Interior);
        // all normals in an open hemisphere about a pole
        let pole = direction(&mut random);
        let u: Vec<DVec3> = (0..plain.len())
            .map(|_| (pole * 0.97 + direction(&mut random) * 0.95).normalize())
            .collect();
        let asked = Asked {
            field: Field::Constant,
            keep: Keep::Cells,
            quality: false,
        };
        let (measures, _) = cells(&solid, &settings, &u, asked);
        assert_eq!(measures.umbrellas.len(), plain.umbrella_count());
        let centres = |polygon: &[DVec3], random: &mut Random| {
            let mut centres = vec![pole, polygon.iter().sum::<DVec3>().normalize()];
            // near the pole, and anywhere else from which the whole polygon is in an open hemisphere
            centres.extend((0..6).map(|_| (pole + 0.15 * direction(random)).normalize()));
            centres.extend((0..20).map(|_| direction(random)));
            centres.retain(|c| polygon.iter().all(|v| c.dot(*v) > 0.01));
            assert!(centres.len() > 6);
            centres
        };
        for (umbrella, &mu2) in measures.umbrellas.iter().enumerate() {
            let members = plain.umbrella(umbrella as u32);
            let polygon: Vec<DVec3> = members.iter().map(|&f| u[f as usize]).collect();
            for centre in centres(&polygon, &mut random) {
                let area = fan(centre, &polygon);
                assert!((to_solid_angle(mu2.into()) - area).abs() < 1e-11);
            }
        }
        // the same for the quadrilateral of a surfel
        let asked = Asked {
            field: Field::Interpolated,
            keep: Keep::Lumped,
            quality: false,
        };
        let (measures, _) = cells(&solid, &settings, &u, asked);
        let plain_u: Vec<_> = u.iter().map(|u| u.to_array()).collect();
        let of_pointels = plain::field::pointel_normals(&plain, &plain_u);
        for (f, lump) in measures.lumped.iter().enumerate() {
            let corners = plain.umbrellas_of[f];
            let polygon = corners.map(|o| DVec3::from_array(of_pointels[o as usize]));
            for centre in centres(&polygon, &mut random) {
                let area = fan(centre, &polygon);
                let mu2 = lump[7] as f64 * LUMPED_SOLID_ANGLE;
                assert!((mu2 - area).abs() < 2e-11, "{mu2} {area}");
            }
        }
    }
}

/// Gauss points of two nodes on [-1, 1], of weight 1.
const NODES: [f64; 2] = [-0.577_350_269_189_625_8, 0.577_350_269_189_625_8];

/// A digitised shape with exact normals, and the integrals of its measures over the projection of each surfel.
struct Projected {
    d: Digitised,
    settings: Settings,
    surface: plain::Surface,
    u: Vec<DVec3>,
    /// Of each surfel: integrals of 1, 2 H, G over its projection, with sign.
    integrals: Vec<[f64; 3]>,
    /// Of each surfel, on its corners and centre: largest distance to the shape, largest difference of u from
    /// the shape's normal at the projection, largest |k|.
    bounds: Vec<[f64; 3]>,
}

impl Projected {
    /// The area element of the closest-point projection on a plane of normal n, at signed distance t, is
    /// <n(pi), n> / ((1 + t k1) (1 + t k2)); 2 x 2 Gauss points a surfel.
    fn of(shape: &impl ImplicitShape, h: f64) -> Self {
        let d = digitise(shape, DVec3::splat(h));
        let settings = paper(&d, h);
        let surface = plain::Surface::new(&d.solid, false, plain::Adjacency::Interior);
        let u = normals_of(&truths(shape, &d, &settings));
        let mut integrals = Vec::with_capacity(u.len());
        let mut bounds = Vec::with_capacity(u.len());
        for (surfel, &u) in surface.surfels.iter().zip(&u) {
            let n = DVec3::from_array(surfel.normal());
            let centre = d.place(surfel.k);
            let sides = [0, 1].map(|side| {
                let step = surfel.steps()[side].map(f64::from);
                DVec3::from_array(step) * 0.5 * h
            });
            let at = |p: f64, q: f64| closest_point(shape, centre + sides[0] * p + sides[1] * q);
            let mut sums = [0.0; 3];
            for p in NODES {
                for q in NODES {
                    let closest = at(p, q).unwrap();
                    let (t, truth) = (closest.signed_distance, closest.truth);
                    let stretch = (1.0 + t * truth.k1) * (1.0 + t * truth.k2);
                    let area = 0.25 * h * h * truth.normal.dot(n) / stretch;
                    sums[0] += area;
                    sums[1] += 2.0 * truth.mean_curvature * area;
                    sums[2] += truth.gaussian_curvature * area;
                }
            }
            integrals.push(sums);
            let mut bound = [0.0f64; 3];
            for (p, q) in [
                (0.0, 0.0),
                (1.0, 1.0),
                (-1.0, 1.0),
                (-1.0, -1.0),
                (1.0, -1.0),
            ] {
                let closest = at(p, q).unwrap();
                let truth = closest.truth;
                bound[0] = bound[0].max(closest.signed_distance.abs());
                bound[1] = bound[1].max((truth.normal - u).length());
                bound[2] = bound[2].max(truth.k1.abs()).max(truth.k2.abs());
            }
            bounds.push(bound);
        }
        Self {
            d,
            settings,
            surface,
            u,
            integrals,
            bounds,
        }
    }

    /// Sets of surfels: the whole surface, and what is in some balls and boxes about surfels.
    fn sets(&self, h: f64) -> Vec<(&'static str, Vec<bool>)> {
        let places: Vec<DVec3> = self
            .surface
            .surfels
            .iter()
            .map(|s| self.d.place(s.k))
            .collect();
        let mut sets = vec![("all", vec![true; places.len()])];
        for c in (0..places.len()).step_by(places.len() / 40) {
            let about = |inside: &dyn Fn(DVec3) -> bool| -> Vec<bool> {
                places.iter().map(|&p| inside(p - places[c])).collect()
            };
            let rho = 3.0 * h.sqrt();
            sets.push(("one surfel", about(&|v| v.length() < 0.1 * h)));
            sets.push(("ball 3 sqrt(h)", about(&|v| v.length() <= rho)));
            sets.push(("ball 6 sqrt(h)", about(&|v| v.length() <= 2.0 * rho)));
            sets.push((
                "box 3 sqrt(h)",
                about(&|v| v.abs().max_element() <= 0.5 * rho),
            ));
        }
        sets
    }
}

/// Corollary 4.5: for B a union of surfels, mu_k(B) is as near to the measure of the projection
/// of B on the shape as normals and positions are near. Printed: how far below the bound we are.
#[test]
fn stability_bound_of_corollary_4_5_holds_with_exact_normals() {
    for h in [1.0, 0.5] {
        let p = Projected::of(&Goursat, h);
        let asked = Asked {
            field: Field::Constant,
            keep: Keep::Cells,
            quality: false,
        };
        let (measures, totals) = cells(&p.d.solid, &p.settings, &p.u, asked);
        assert_eq!(totals.border_linels, 0);
        assert_eq!(measures.linels.len(), p.surface.sheets.len());
        let largest = |i: usize| p.bounds.iter().map(|b| b[i]).fold(0.0, f64::max);
        let (epsilon, eta) = (largest(0), largest(1));
        let turn = |sheet: &plain::surface::LinelSheet| {
            (p.u[sheet.first as usize] - p.u[sheet.second as usize]).length()
        };
        let delta = p.surface.sheets.iter().map(turn).fold(0.0, f64::max);
        println!("h = {h}: epsilon {epsilon:.3}, eta {eta:.3}, delta {delta:.3}");
        let mut worst = std::collections::BTreeMap::<&str, [f64; 3]>::new();
        for (name, set) in p.sets(h) {
            let has = |f: u32| set[f as usize];
            let mut found = [0.0; 3];
            let mut truth = [0.0; 3];
            let (mut surfels, mut rim, mut rho) = (0.0, 0.0, 0.0f64);
            for f in (0..set.len()).filter(|&f| set[f]) {
                surfels += 1.0;
                rho = rho.max(p.bounds[f][2]);
                found[0] += to_measure(measures.mu0[f].into()) * h * h;
                (0..3).for_each(|k| truth[k] += p.integrals[f][k]);
            }
            // B is closed: linels and pointels on its rim belong to it
            for (sheet, tensor) in p.surface.sheets.iter().zip(&measures.linels) {
                let sides = u32::from(has(sheet.first)) + u32::from(has(sheet.second));
                if sides > 0 {
                    let mu1: i64 = tensor[..3].iter().sum();
                    found[1] += to_measure(mu1.into()) * h;
                }
                rim += f64::from(u8::from(sides == 1));
            }
            for (umbrella, &mu2) in measures.umbrellas.iter().enumerate() {
                if p.surface.umbrella(umbrella as u32).iter().any(|&f| has(f)) {
                    found[2] += to_solid_angle(mu2.into());
                }
            }
            let angle = 2.0 * (0.5 * delta).asin();
            let bound = 4.0
                * (eta + epsilon)
                * ((1.0 + rho) / (1.0 - rho * epsilon)).powi(2)
                * (surfels * h * h
                    + rim * h
                    + 140.0 * delta * delta * surfels
                    + angle * (4.0 * surfels * h + 6.0 * rim));
            let worst = worst.entry(name).or_default();
            for k in 0..3 {
                let share = (found[k] - truth[k]).abs() / bound;
                assert!(
                    share < 1.0,
                    "{name} mu{k}: {} {} {bound}",
                    found[k],
                    truth[k]
                );
                worst[k] = worst[k].max(share);
            }
            if name == "all" {
                // pi is onto: the projection covers the shape once
                println!("totals {found:.5?}, of the shape {truth:.5?}");
                assert!((truth[2] / (4.0 * PI) - 1.0).abs() < 2e-2);
            }
        }
        for (name, shares) in worst {
            println!("h = {h}, {name}: at most {} of the bound", brief(shares));
        }
    }
}

/// Corollary 4.4: the same for a continuous field, whose measures are on surfels alone.
#[test]
fn stability_bound_of_corollary_4_4_holds_for_the_interpolated_field() {
    let h = 0.5;
    let p = Projected::of(&Goursat, h);
    let asked = Asked {
        field: Field::Interpolated,
        keep: Keep::Lumped,
        quality: false,
    };
    let (measures, _) = cells(&p.d.solid, &p.settings, &p.u, asked);
    let plain_u: Vec<_> = p.u.iter().map(|u| u.to_array()).collect();
    let of_pointels = plain::field::pointel_normals(&p.surface, &plain_u);
    let corners = |f: usize| p.surface.umbrellas_of[f].map(|o| of_pointels[o as usize]);
    // Lipschitz constant: the larger side of each pair, over the shortest length of the bilinear vector
    let (mut lipschitz, mut eta, mut epsilon) = (0.0f64, 0.0f64, 0.0f64);
    for f in 0..p.surface.len() {
        let c = corners(f).map(DVec3::from_array);
        let side = (0..4).map(|i| (c[i] - c[(i + 1) % 4]).length());
        let across = (0..4).map(|i| (c[i] - c[(i + 2) % 4]).length());
        let spread = across.fold(0.0, f64::max);
        lipschitz = lipschitz.max(2f64.sqrt() * side.fold(0.0, f64::max) / h / (1.0 - spread));
        // on the surfel u is within `spread` of any corner
        eta = eta.max(p.bounds[f][1] + spread + (c[0] - p.u[f]).length());
        epsilon = epsilon.max(p.bounds[f][0]);
    }
    let mut worst = [0.0f64; 3];
    for (name, set) in p.sets(h) {
        let (mut found, mut truth) = ([0.0; 3], [0.0; 3]);
        let (mut area, mut rho) = (0.0, 0.0f64);
        for f in (0..set.len()).filter(|&f| set[f]) {
            let lump = &measures.lumped[f];
            found[0] += to_measure(lump[0].into()) * h * h;
            found[1] += to_measure((lump[1] + lump[2] + lump[3]).into()) * h;
            found[2] += lump[7] as f64 * LUMPED_SOLID_ANGLE;
            (0..3).for_each(|k| truth[k] += p.integrals[f][k]);
            area += h * h;
            rho = rho.max(p.bounds[f][2]);
        }
        let has = |f: u32| set[f as usize];
        let sheets = p.surface.sheets.iter();
        let rim = sheets.filter(|s| has(s.first) != has(s.second)).count() as f64 * h;
        let bound = 4.0
            * (eta + epsilon)
            * ((1.0 + rho) / (1.0 - rho * epsilon)).powi(2)
            * (1.0 + lipschitz * lipschitz)
            * (area + rim);
        for k in 0..3 {
            let share = (found[k] - truth[k]).abs() / bound;
            assert!(
                share < 1.0,
                "{name} mu{k}: {} {} {bound}",
                found[k],
                truth[k]
            );
            worst[k] = worst[k].max(share);
        }
    }
    println!(
        "L {lipschitz:.3}, eta {eta:.3}: at most {} of the bound",
        brief(worst)
    );
}

#[test]
fn sharp_weights_of_a_continuous_field_are_lumped_ones() {
    let solid = blob([26, 24, 22], 9);
    for field in [Field::Interpolated, Field::Linear] {
        let of = |weights| {
            let settings = Settings {
                weights,
                field,
                ..Settings::new(lattice(&solid, [1.0, 1.0, 0.7], false))
            };
            whole(&solid, &settings).rows
        };
        for (a, b) in of(Weights::Sharp).iter().zip(&of(Weights::Lumped)) {
            assert_eq!(a.curvature, b.curvature);
            assert_eq!(a.sums.cut, b.sums.cut);
        }
    }
}
