//! Polyhedral surfaces: theorems of meshes, meshes with everything wrong, and digital surfaces as meshes.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::atomic::{AtomicBool, AtomicU64};

use curvox::curvature::Curvature;
use curvox::measure::ball::Weights;
use curvox::measure::field::Field;
use curvox::mesh::{
    EdgeKind, FaceSums, Flip, MeshMeasures, MeshSurface, MeshTotals, NormalField, NormalSource,
    ball_sums,
};
use curvox::normal::{Estimator, Orientation};
use curvox::pipeline::Settings;
use curvox_formats::mesh::Mesh;
use curvox_tools::meshes::{Polyhedron, globe, icosphere, lantern, torus};
use curvox_tools::plain::Solid;
use glam::{DMat3, DVec3};
use proptest::prelude::*;

use crate::common::{Random, blob, lattice, whole};

/// A mesh with the measures of its cells.
pub(crate) struct Measured {
    pub(crate) surface: MeshSurface,
    pub(crate) field: NormalField,
    pub(crate) measures: MeshMeasures,
    pub(crate) totals: MeshTotals,
}

impl Measured {
    fn of(mesh: &Mesh, source: NormalSource, field: Field) -> Self {
        let surface = MeshSurface::new(mesh, Flip::default());
        let field = NormalField::new(mesh, &surface, source, field, Flip::default()).unwrap();
        let measures = MeshMeasures::new(&surface, &field);
        let totals = measures.totals(&surface, &field);
        Self {
            surface,
            field,
            measures,
            totals,
        }
    }

    pub(crate) fn sums(&self, radius: f64) -> Vec<FaceSums> {
        ball_sums(
            &self.surface,
            &self.measures,
            radius,
            &AtomicU64::new(0),
            &AtomicBool::new(false),
        )
        .unwrap()
    }

    fn curvatures(&self, radius: f64) -> Vec<Curvature> {
        let sums = self.sums(radius);
        let at = |(f, s): (usize, &FaceSums)| s.curvature(self.field.of_face[f]).unwrap();
        sums.iter().enumerate().map(at).collect()
    }
}

fn file(polyhedron: &Polyhedron) -> Mesh {
    let arrays = |list: &[DVec3]| list.iter().map(|v| v.to_array()).collect::<Vec<_>>();
    let mut mesh = Mesh::from_faces(arrays(&polyhedron.vertices), &polyhedron.faces);
    if !polyhedron.normals.is_empty() {
        mesh.vertex_normals = Some(arrays(&polyhedron.normals));
    }
    mesh.face_normals = polyhedron.face_normals.as_ref().map(|n| arrays(n));
    mesh
}

pub(crate) fn measured(polyhedron: &Polyhedron, source: NormalSource, field: Field) -> Measured {
    Measured::of(&file(polyhedron), source, field)
}

const FIELDS: [Field; 3] = [Field::Constant, Field::Interpolated, Field::Linear];

/// The unit cube as six squares.
fn cube() -> Polyhedron {
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2));
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    Polyhedron {
        vertices: (0..8).map(corner).collect(),
        faces: faces.iter().map(|f| f.to_vec()).collect(),
        normals: Vec::new(),
        face_normals: None,
    }
}

fn cut_into_triangles(polyhedron: &Polyhedron) -> Polyhedron {
    let mut cut = polyhedron.clone();
    cut.faces = polyhedron
        .faces
        .iter()
        .flat_map(|f| (2..f.len()).map(|i| vec![f[0], f[i - 1], f[i]]))
        .collect();
    cut
}

fn near(found: f64, expected: f64, tolerance: f64) {
    assert!(
        (found - expected).abs() <= tolerance,
        "{found}, not {expected}"
    );
}

#[test]
fn a_cube_with_naive_normals_has_its_normal_cycle() {
    let squares = cube();
    for cube in [&squares, &cut_into_triangles(&squares)] {
        let totals = measured(cube, NormalSource::Faces, Field::Constant).totals;
        near(totals.mu0, 6.0, 1e-14);
        // Twelve edges that turn by a quarter; corners that are an eighth of the sphere each.
        near(totals.mu1, 12.0 * FRAC_PI_2, 1e-13);
        near(totals.mu2, 4.0 * PI, 1e-13);
        near(totals.mu_omega, 0.0, 1e-14);
        near(totals.volume.unwrap(), 1.0, 1e-14);
        assert_eq!(totals.euler_counted, 2);
        assert_eq!(totals.euler_gauss_bonnet, Some(2));
        assert_eq!(totals.sum_abs_k, 0.0);
    }
    let corners = measured(&squares, NormalSource::Faces, Field::Constant).measures;
    for mu2 in corners.umbrellas {
        near(mu2, FRAC_PI_2, 1e-14);
    }
}

#[test]
fn spheres_have_their_totals_and_their_curvatures() {
    let radius = 2.0;
    for field in FIELDS {
        let mut last = [f64::INFINITY; 3];
        for levels in [2, 3, 4] {
            let sphere = measured(&icosphere(levels, radius), NormalSource::Given, field);
            let totals = &sphere.totals;
            if field != Field::Linear {
                near(totals.mu2, 4.0 * PI, 1e-10);
            }
            let errors = [
                (totals.mu0 / (4.0 * PI * radius * radius) - 1.0).abs(),
                (totals.mu1 / (8.0 * PI * radius) - 1.0).abs(),
                (totals.mu2 / (4.0 * PI) - 1.0).abs(),
            ];
            for (error, last) in errors.iter().zip(&last) {
                assert!(*error < 0.3 * last || *error < 1e-11, "{errors:?} {last:?}");
            }
            last = errors;
        }
        let sphere = measured(&icosphere(4, radius), NormalSource::Given, field);
        for c in sphere.curvatures(0.5) {
            near(c.mean, 1.0 / radius, 0.02);
            near(c.gaussian, 1.0 / (radius * radius), 0.03);
            near(c.k1, 1.0 / radius, 0.03);
            near(c.k2, 1.0 / radius, 0.03);
        }
    }
}

#[test]
fn a_linear_field_on_a_sphere_gives_its_curvatures_exactly() {
    // u = x / R at vertices and so in triangles: mu1 = 2 mu0 / R and mu2 = mu0 / R^2 on every face
    let radius = 3.0;
    let sphere = measured(&icosphere(2, radius), NormalSource::Given, Field::Linear);
    for c in sphere.curvatures(1.0) {
        near(c.mean, 1.0 / radius, 1e-13);
        near(c.gaussian, 1.0 / (radius * radius), 1e-13);
    }
    near(sphere.totals.sum_abs_mu_omega, 0.0, 1e-12);
}

#[test]
fn tori_have_their_totals_and_their_curvatures() {
    let (major, minor) = (3.0, 1.0);
    for field in FIELDS {
        let torus = torus(major, minor, 96, 40);
        for mesh in [&torus, &cut_into_triangles(&torus)] {
            let torus = measured(mesh, NormalSource::Given, field);
            let totals = &torus.totals;
            near(totals.mu0 / (4.0 * PI * PI * major * minor), 1.0, 6e-3);
            near(totals.mu1 / (4.0 * PI * PI * major), 1.0, 6e-3);
            near(totals.mu2, 0.0, 1e-3);
            assert_eq!(totals.euler_counted, 0);
            if field != Field::Linear {
                near(totals.mu2, 0.0, 1e-10);
                assert_eq!(totals.euler_gauss_bonnet, Some(0));
            }
            let tolerance = if field == Field::Constant { 0.1 } else { 0.06 };
            for (f, c) in torus.curvatures(0.35).into_iter().enumerate() {
                let p = torus.surface.centroid[f];
                let out = (p.x * p.x + p.y * p.y).sqrt() - major;
                let cos = out / (out * out + p.z * p.z).sqrt();
                let k1 = cos / (major + minor * cos);
                near(c.mean, 0.5 * (1.0 / minor + k1), tolerance);
                near(c.gaussian, k1 / minor, tolerance);
                near(c.k1, k1, tolerance);
                near(c.k2, 1.0 / minor, tolerance);
                let along = DVec3::new(-p.y, p.x, 0.0).normalize();
                assert!(c.d1.dot(along).abs() > 0.99);
            }
        }
    }
}

#[test]
fn mu_omega_of_exact_normals_vanishes_with_the_mesh_size() {
    // On a sphere symmetry hides it; a torus has unequal curvatures.
    for field in FIELDS {
        let mean = [16, 32, 64].map(|n| {
            let torus = measured(
                &cut_into_triangles(&torus(3.0, 1.0, 3 * n, n)),
                NormalSource::Given,
                field,
            );
            near(torus.totals.mu_omega, 0.0, 1e-9);
            let curvatures = torus.curvatures(0.4);
            let quality = curvatures.iter().map(|c| c.quality.abs()).sum::<f64>();
            quality / curvatures.len() as f64
        });
        // At least linear in the mesh size.
        assert!(
            mean[1] < 0.6 * mean[0] && mean[2] < 0.6 * mean[1],
            "{field:?} {mean:?}"
        );
        assert!(mean[2] < 0.03, "{field:?} {mean:?}");
    }
}

#[test]
fn mu_omega_finds_a_field_that_turns() {
    let mut swirl = icosphere(3, 1.0);
    for (u, x) in swirl.normals.iter_mut().zip(&swirl.vertices) {
        *u = (*u + 0.3 * DVec3::Z.cross(*x)).normalize();
    }
    for field in FIELDS {
        let swirl = measured(&swirl, NormalSource::Given, field);
        let curvatures = swirl.curvatures(0.4);
        let most = curvatures
            .iter()
            .map(|c| c.quality.abs())
            .fold(0.0, f64::max);
        assert!(most > 0.3, "{field:?} {most}");
    }
}

#[test]
fn without_given_normals_means_around_vertices_do() {
    for field in FIELDS {
        let mut sphere = globe(2.0, 48, 24);
        sphere.normals.clear();
        let sphere = measured(&sphere, NormalSource::Auto, field);
        near(sphere.totals.mu0 / (16.0 * PI), 1.0, 0.01);
        near(sphere.totals.mu1 / (16.0 * PI), 1.0, 0.01);
        near(sphere.totals.mu2 / (4.0 * PI), 1.0, 0.01);
        for c in sphere.curvatures(0.8) {
            near(c.mean, 0.5, 0.03);
        }
    }
}

#[test]
fn a_digital_surface_as_a_mesh_has_the_numbers_of_the_volume() {
    let dims = [26, 24, 22];
    let solid = smooth_blob(dims);
    for (spacing, radius) in [([1.0; 3], 3.0), ([1.0, 1.0, 0.6], 2.5)] {
        let mut settings = Settings::new(lattice(&solid, spacing, true));
        settings.radii = vec![radius];
        settings.weights = Weights::Dgtal;
        settings.estimator = Estimator::IntegralInvariant {
            radius: 3.0,
            orientation: Orientation::Moment,
        };
        let volume = whole(&solid, &settings);
        let mesh = quadrangles(
            &solid,
            spacing,
            &volume.rows.iter().map(|r| (r.k, r.u)).collect::<Vec<_>>(),
        );
        let mesh = Measured::of(&mesh, NormalSource::Given, Field::Constant);
        let defects = mesh.surface.defects;
        assert_eq!(
            (
                defects.border_edges,
                defects.non_manifold_edges,
                defects.non_manifold_vertices
            ),
            (0, 0, 0)
        );
        let euler = volume.totals.euler_gauss_bonnet().unwrap();
        assert_eq!(i128::from(mesh.totals.euler_counted), euler);
        assert_eq!(mesh.totals.euler_gauss_bonnet.map(i128::from), Some(euler));
        assert_eq!(mesh.totals.sum_k, volume.totals.lifts as f64);
        let sums = mesh.sums(radius);
        let mut several = 0;
        for (f, (sums, row)) in sums.iter().zip(&volume.rows).enumerate() {
            near(sums.sum.mu0, row.sums.mu0, 1e-9);
            near(sums.sum.mu2, row.sums.mu2, 1e-9);
            for (a, b) in sums.sum.tensor.terms().iter().zip(row.sums.tensor.terms()) {
                near(*a, b, 1e-9);
            }
            let c = sums.curvature(mesh.field.of_face[f]).unwrap();
            let d = row.curvature.unwrap();
            near(c.mean, d.mean, 1e-9);
            near(c.gaussian, d.gaussian, 1e-9);
            near(c.k1, d.k1, 1e-8);
            near(c.k2, d.k2, 1e-8);
            several += usize::from(sums.several_sheets);
        }
        assert!(several < sums.len() / 2);
    }
}

/// A union of balls, so large that its surface does not touch itself.
fn smooth_blob(dims: [usize; 3]) -> Solid {
    Solid::from_fn(dims, |p| {
        [[10.3, 11.2, 10.1, 7.2], [15.9, 12.4, 11.7, 6.1]]
            .iter()
            .any(|b| {
                let d = [0, 1, 2].map(|a| f64::from(p[a]) - b[a]);
                d.iter().map(|x| x * x).sum::<f64>() < b[3] * b[3]
            })
    })
}

/// Surfels as squares in the order given, with their normals as those of faces.
fn quadrangles(solid: &Solid, spacing: [f64; 3], rows: &[([i32; 3], DVec3)]) -> Mesh {
    let mut numbers = std::collections::HashMap::new();
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for (k, _) in rows {
        let axis = (0..3).find(|&a| k[a] % 2 == 0).unwrap();
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut below = *k;
        below[axis] -= 1;
        // Outward along the axis if the voxel below is inside.
        let at = |a: usize| usize::try_from((below[a] - 1) / 2).unwrap_or(usize::MAX);
        let place = [at(0), at(1), at(2)];
        let inside = below.iter().all(|&x| x > 0)
            && (0..3).all(|a| place[a] < solid.dims[a])
            && solid.inside[place[0] + solid.dims[0] * (place[1] + solid.dims[1] * place[2])];
        let mut corners: Vec<u32> = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
            .into_iter()
            .map(|(db, dc)| {
                let mut p = *k;
                p[b] += db;
                p[c] += dc;
                *numbers.entry(p).or_insert_with(|| {
                    vertices.push([0, 1, 2].map(|a| 0.5 * f64::from(p[a]) * spacing[a]));
                    vertices.len() as u32 - 1
                })
            })
            .collect();
        if !inside {
            corners.reverse();
        }
        faces.push(corners);
    }
    let mut mesh = Mesh::from_faces(vertices, &faces);
    mesh.face_normals = Some(rows.iter().map(|(_, u)| u.to_array()).collect());
    mesh
}

#[test]
fn noisy_digital_surfaces_obey_gauss_bonnet_as_meshes_do() {
    for seed in 0..6 {
        let solid = blob([14, 13, 12], seed);
        let mut settings = Settings::new(lattice(&solid, [1.0; 3], true));
        settings.weights = Weights::Dgtal;
        settings.estimator = Estimator::IntegralInvariant {
            radius: 3.0,
            orientation: Orientation::Trivial,
        };
        let volume = whole(&solid, &settings);
        let rows: Vec<_> = volume.rows.iter().map(|r| (r.k, r.u)).collect();
        let mesh = Measured::of(
            &quadrangles(&solid, [1.0; 3], &rows),
            NormalSource::Given,
            Field::Constant,
        );
        if mesh.totals.closed {
            assert_eq!(
                mesh.totals.euler_gauss_bonnet,
                Some(mesh.totals.euler_counted)
            );
        } else {
            // Where four surfels meet a mesh is not a manifold, and says so.
            assert!(mesh.surface.defects.non_manifold_edges > 0);
            assert!(mesh.sums(2.0).iter().any(|s| s.non_manifold));
        }
    }
}

/// A closed mesh torn about, with random normals: a sphere or a torus, of triangles or quadrangles
/// that are not planar.
fn crumpled(seed: u64, amount: f64) -> Polyhedron {
    let mut random = Random(seed);
    let mut mesh = match seed % 3 {
        0 => icosphere(1, 1.0),
        1 => torus(2.0, 0.7, 7, 5),
        _ => globe(1.0, 6, 5),
    };
    let mut vector = || DVec3::new(random.next(), random.next(), random.next()) - 0.5;
    for v in &mut mesh.vertices {
        *v += vector() * amount;
    }
    mesh.face_normals = Some(
        mesh.faces
            .iter()
            .map(|_| vector().normalize_or(DVec3::Z))
            .collect(),
    );
    mesh.normals.clear();
    mesh
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn gauss_bonnet_holds_on_closed_meshes_whatever_the_normals(
        seed in any::<u64>(),
        amount in 0.0..1.5_f64,
    ) {
        let mesh = crumpled(seed, amount);
        for source in [NormalSource::Given, NormalSource::Faces, NormalSource::Vertices] {
            let totals = measured(&mesh, source, Field::Constant).totals;
            let euler = totals.mu2 / TAU + 2.0 * totals.sum_k;
            prop_assert!((euler - totals.euler_counted as f64).abs() < 1e-9, "{euler} {totals:?}");
            prop_assert_eq!(totals.euler_gauss_bonnet, Some(totals.euler_counted));
            prop_assert!(totals.mu_omega.abs() < 1e-11);
        }
    }

    #[test]
    fn mu2_is_the_area_of_the_spherical_polygon(seed in any::<u64>()) {
        // Normals in a hemisphere: the fan from their mean is the paper's definition.
        let mut mesh = crumpled(seed, 0.3);
        mesh.face_normals = None;
        let mesh = measured(&mesh, NormalSource::Vertices, Field::Constant);
        for c in 0..mesh.surface.vertex_of.len() {
            let (mut at, mut around) = (c, Vec::new());
            loop {
                around.push(mesh.field.of_face[mesh.surface.face_of[at] as usize]);
                at = mesh.surface.across(mesh.surface.before(at)).unwrap();
                if at == c { break; }
            }
            let mean = around.iter().sum::<DVec3>().normalize();
            if around.iter().any(|u| u.dot(mean) < 0.3) { continue; }
            let area: f64 = (0..around.len())
                .map(|i| curvox::measure::formula::spherical_triangle(
                    mean, around[i], around[(i + 1) % around.len()]))
                .sum();
            let mu2 = mesh.measures.umbrellas[mesh.surface.umbrella_of[c] as usize];
            prop_assert!((mu2 - area).abs() < 1e-10, "{mu2} {area}");
        }
    }

    #[test]
    fn turned_meshes_have_turned_results(seed in any::<u64>(), angle in 0.1..3.0_f64) {
        let mesh = crumpled(seed, 0.4);
        let axis = DVec3::new(0.3, -0.5, 0.8).normalize();
        let turn = DMat3::from_axis_angle(axis, angle);
        let mut turned = mesh.clone();
        for v in &mut turned.vertices { *v = turn * *v; }
        for v in turned.face_normals.iter_mut().flatten() { *v = turn * *v; }
        for field in FIELDS {
            let (a, b) = (
                measured(&mesh, NormalSource::Given, field),
                measured(&turned, NormalSource::Given, field),
            );
            for (s, t) in a.sums(0.9).iter().zip(b.sums(0.9)) {
                prop_assert!((s.sum.mu0 - t.sum.mu0).abs() < 1e-9);
                prop_assert!((s.sum.mu1() - t.sum.mu1()).abs() < 1e-9);
                prop_assert!((s.sum.omega - t.sum.omega).abs() < 1e-9);
                let gap = (s.sum.mu2 - t.sum.mu2) / (2.0 * TAU);
                // Rounding may decide a lift of half a sphere.
                prop_assert!((gap - gap.round()).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn a_larger_radius_takes_more_and_a_huge_one_all() {
    let mesh = measured(&crumpled(4, 0.2), NormalSource::Vertices, Field::Constant);
    for sums in mesh.sums(100.0) {
        near(sums.sum.mu0, mesh.totals.mu0, 1e-11);
        near(sums.sum.mu1(), mesh.totals.mu1, 1e-11);
        near(sums.sum.mu2, mesh.totals.mu2, 1e-11);
        assert!(sums.island && !sums.several_sheets && !sums.border);
    }
    // A ball within a face holds its share of it, and no edge.
    for (f, sums) in mesh.sums(1e-3).iter().enumerate() {
        assert!(sums.sum.mu0.abs() < 0.1 * mesh.measures.faces[f].mu0.abs());
        near(sums.sum.mu1(), 0.0, 0.0);
        assert!(sums.no_vertex);
    }
    assert!(mesh.sums(100.0).iter().all(|sums| !sums.no_vertex));
    // An interpolated field has its measures on the faces, and the ball its part of them.
    let sphere = measured(&icosphere(3, 2.0), NormalSource::Given, Field::Interpolated);
    assert!(sphere.sums(1e-3).iter().all(|sums| !sums.no_vertex));
    for c in sphere.curvatures(1e-3) {
        near(c.mean, 0.5, 2e-3);
    }
}

#[test]
fn normals_of_vertices_are_interpolated_unless_asked_otherwise() {
    let suitable = |mesh: &Mesh, source: NormalSource| source.suitable_field(mesh);
    let (sphere, lantern) = (file(&icosphere(1, 1.0)), file(&lantern(4, 5, 1.0, 1.0)));
    let mut of_faces = lantern.clone();
    of_faces.vertex_normals = None;
    let mut bare = sphere.clone();
    bare.vertex_normals = None;
    // As OBJ has the normals of faces: at each of their corners.
    let mut repeated = bare.clone();
    repeated.corner_normals = Some(
        (0..bare.corners.len())
            .map(|c| [0.0, (c / 3) as f64, 1.0])
            .collect(),
    );
    let mut of_corners = repeated.clone();
    of_corners.corner_normals.as_mut().unwrap()[1] = [1.0, 0.0, 0.0];
    for (mesh, source, field) in [
        (&sphere, NormalSource::Auto, Field::Interpolated),
        (&sphere, NormalSource::Given, Field::Interpolated),
        (&sphere, NormalSource::Faces, Field::Constant),
        (&lantern, NormalSource::Given, Field::Interpolated),
        (&of_faces, NormalSource::Given, Field::Constant),
        (&of_faces, NormalSource::Auto, Field::Constant),
        (&of_faces, NormalSource::Vertices, Field::Interpolated),
        (&bare, NormalSource::Auto, Field::Interpolated),
        (&repeated, NormalSource::Auto, Field::Constant),
        (&of_corners, NormalSource::Auto, Field::Interpolated),
    ] {
        assert_eq!(suitable(mesh, source), field, "{source:?}");
    }
}

#[test]
fn sheets_that_do_not_hang_together_are_not_summed() {
    let mut two = icosphere(2, 1.0);
    let inner = icosphere(2, 0.9);
    let first = two.vertices.len() as u32;
    let faces = two.faces.len();
    two.vertices.extend(inner.vertices);
    two.normals.extend(inner.normals.iter().map(|n| -n));
    // Turned inside out: the shell between two spheres.
    two.faces.extend(
        inner
            .faces
            .iter()
            .map(|f| f.iter().rev().map(|v| v + first).collect::<Vec<_>>()),
    );
    let shell = measured(&two, NormalSource::Given, Field::Constant);
    assert_eq!(shell.totals.euler_counted, 4);
    let alone = measured(&icosphere(2, 1.0), NormalSource::Given, Field::Constant);
    let (sums, expected) = (shell.sums(0.5), alone.sums(0.5));
    for (a, b) in sums[..faces].iter().zip(&expected) {
        assert!(a.several_sheets && !b.several_sheets);
        assert_eq!(a.sum, b.sum);
    }
    for (f, sums) in sums.iter().enumerate().skip(faces) {
        assert!(sums.curvature(shell.field.of_face[f]).unwrap().mean < -1.0);
    }
}

#[test]
fn an_edge_of_three_faces_has_no_measure_and_is_told() {
    // Three half-planes of triangles around the z axis.
    let vertices = vec![
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 0.5],
        [-0.5, 0.8, 0.5],
        [-0.5, -0.8, 0.5],
    ];
    let mesh = Mesh::from_faces(vertices, &[[0, 1, 2], [0, 1, 3], [1, 0, 4]]);
    let fan = Measured::of(&mesh, NormalSource::Faces, Field::Constant);
    assert_eq!(fan.surface.defects.non_manifold_edges, 1);
    assert_eq!(fan.surface.defects.border_edges, 6);
    assert_eq!(fan.totals.mu1, 0.0);
    assert!(fan.sums(1.0).iter().all(|s| s.non_manifold && s.border));
}

#[test]
fn faces_turned_over_are_told() {
    let mut wrong = icosphere(1, 1.0);
    wrong.faces[7].reverse();
    let wrong = measured(&wrong, NormalSource::Faces, Field::Constant);
    assert_eq!(wrong.surface.defects.inconsistent_edges, 3);
    assert!(!wrong.totals.closed);
    let kinds = &wrong.surface.kind;
    assert_eq!(
        kinds
            .iter()
            .filter(|k| **k == EdgeKind::Inconsistent)
            .count(),
        6
    );
    // All turned over is consistent: the volume tells.
    let mesh = file(&icosphere(2, 1.0));
    let flip = Flip {
        faces: true,
        normals: true,
    };
    let surface = MeshSurface::new(&mesh, flip);
    assert!(surface.volume() < 0.0 && surface.is_closed());
    let field =
        NormalField::new(&mesh, &surface, NormalSource::Given, Field::Constant, flip).unwrap();
    let totals = MeshMeasures::new(&surface, &field).totals(&surface, &field);
    let right = measured(&icosphere(2, 1.0), NormalSource::Given, Field::Constant).totals;
    near(totals.mu0, right.mu0, 1e-12);
    near(totals.mu1, -right.mu1, 1e-12);
    near(totals.mu2, right.mu2, 1e-12);
}

#[test]
fn vertices_where_the_surface_touches_itself_are_taken_apart() {
    // Two tetrahedra that share a vertex: two spheres.
    let vertices = vec![
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 1.0],
        [0.0, 1.0, 1.0],
        [-1.0, -1.0, 1.0],
        [1.0, 0.0, -1.0],
        [0.0, 1.0, -1.0],
        [-1.0, -1.0, -1.0],
    ];
    let faces = [
        [0, 2, 1],
        [0, 3, 2],
        [0, 1, 3],
        [1, 2, 3],
        [0, 4, 5],
        [0, 5, 6],
        [0, 6, 4],
        [4, 6, 5],
    ];
    let hourglass = Measured::of(
        &Mesh::from_faces(vertices, &faces),
        NormalSource::Faces,
        Field::Constant,
    );
    assert_eq!(hourglass.surface.defects.non_manifold_vertices, 1);
    assert_eq!(hourglass.totals.euler_counted, 4);
    near(hourglass.totals.mu2, 8.0 * PI, 1e-12);
    assert!(hourglass.totals.volume.unwrap() > 0.0);
}

#[test]
fn collapsed_faces_are_left_out_and_their_neighbours_meet() {
    let mut mesh = cut_into_triangles(&cube());
    // Cut the edge 0-1 of the cube open with a face of no extent.
    mesh.faces.push(vec![0, 1, 1]);
    mesh.faces.push(vec![5, 5, 5]);
    let quad = vec![2, 3, 3, 7, 7, 6];
    // In the place of the two triangles of that side: a square with repeated corners.
    let side = cube().faces[3].clone();
    mesh.faces.retain(|f| !f.iter().all(|v| side.contains(v)));
    let mut turned = quad;
    turned.reverse();
    mesh.faces.push(turned);
    let mesh = measured(&mesh, NormalSource::Faces, Field::Constant);
    assert_eq!(mesh.surface.defects.collapsed_faces, 2);
    assert!(mesh.totals.closed, "{:?}", mesh.surface.defects);
    near(mesh.totals.mu1, 6.0 * PI, 1e-12);
    near(mesh.totals.mu2, 4.0 * PI, 1e-12);
}

#[test]
fn faces_without_area_and_folds_keep_gauss_bonnet() {
    // A lamina: one polygon from both sides; a fold of half a turn at each edge.
    let pentagon: Vec<[f64; 3]> = (0..5)
        .map(|i| {
            let angle = TAU * f64::from(i) / 5.0;
            [angle.cos(), angle.sin(), 0.0]
        })
        .collect();
    let faces = [vec![0, 1, 2, 3, 4], vec![4, 3, 2, 1, 0]];
    let mut mesh = Mesh::from_faces(pentagon, &faces);
    for tilted in [false, true] {
        if tilted {
            mesh.face_normals = Some(vec![[0.2, 0.1, 1.0], [0.3, 0.1, -1.0]]);
        }
        let lamina = Measured::of(&mesh, NormalSource::Auto, Field::Constant);
        assert_eq!(lamina.surface.defects.duplicate_faces, 1);
        assert_eq!(
            lamina.totals.euler_gauss_bonnet,
            Some(2),
            "{:?}",
            lamina.totals
        );
    }
    // A cube with a needle of no area in an edge: vertex 8 lies on the edge 0-1, on one side only.
    let mut needle = cut_into_triangles(&cube());
    needle.vertices.push(DVec3::new(0.4, 0.0, 0.0));
    let at = needle
        .faces
        .iter()
        .position(|f| (0..3).any(|i| f[i] == 0 && f[(i + 1) % 3] == 1))
        .unwrap();
    let face = needle.faces.remove(at);
    let i = (0..3).find(|&i| face[i] == 0).unwrap();
    let apex = face[(i + 2) % 3];
    needle.faces.push(vec![0, 8, apex]);
    needle.faces.push(vec![8, 1, apex]);
    needle.faces.push(vec![0, 1, 8]);
    let needle = measured(&needle, NormalSource::Vertices, Field::Constant);
    assert_eq!(needle.surface.defects.zero_area_faces, 1);
    assert_eq!(
        needle.totals.euler_gauss_bonnet,
        Some(2),
        "{:?}",
        needle.totals
    );
    assert!(needle.totals.mu1.is_finite());
    assert!(needle.sums(0.7).iter().all(|s| s.sum.mu0.is_finite()));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let mesh = crumpled(7, 0.3);
    let mut finer = mesh.clone();
    finer.vertices.extend(icosphere(4, 0.5).vertices);
    let first = mesh.vertices.len() as u32;
    let sphere = icosphere(4, 0.5).faces;
    finer
        .faces
        .extend(sphere.iter().map(|f| f.iter().map(|v| v + first).collect()));
    finer.face_normals = None;
    let run = |threads: usize| {
        let pool = rayon_pool(threads);
        pool.install(|| measured(&finer, NormalSource::Vertices, Field::Interpolated).sums(0.2))
    };
    assert_eq!(run(1), run(3));
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
}
