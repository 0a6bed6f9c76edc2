//! What DGtal's cells and walk do on small solids.

use std::f64::consts::{FRAC_PI_2, PI};

use curvox_tools::causes::{Cause, Causes};
use curvox_tools::dgtal;
use curvox_tools::plain::algebra::Vector;
use curvox_tools::plain::{Adjacency, Ball, Cells, Scale, Solid, Surface, Surfel, Walk, Weights};

fn surface_of(voxels: &[[i32; 3]]) -> Surface {
    let solid = Solid::from_fn([6; 3], |voxel| voxels.contains(&voxel));
    Surface::new(&solid, false, Adjacency::Interior)
}

fn trivial(surface: &Surface) -> Vec<Vector> {
    surface.surfels.iter().map(Surfel::normal).collect()
}

fn order(surface: &Surface) -> Vec<u32> {
    (0..surface.len() as u32).collect()
}

fn causes(surface: &Surface, u: &[Vector]) -> (dgtal::Mesh, Causes) {
    let mesh = dgtal::Mesh::new(surface.surfels.clone());
    let causes = Causes::new(
        &mesh,
        u,
        &dgtal::Cells::new(&mesh, u),
        surface,
        &order(surface),
        &Cells::new(surface, u, &Scale::new([1.0; 3])),
        vec![false; surface.len()],
    );
    (mesh, causes)
}

#[test]
fn box_totals_are_those_of_the_definitions() {
    let surface = surface_of(&[[2, 2, 2], [3, 2, 2], [2, 3, 2], [3, 3, 2]]);
    let mesh = dgtal::Mesh::new(surface.surfels.clone());
    let cells = dgtal::Cells::new(&mesh, &trivial(&surface));
    let area: f64 = cells.mu0.iter().sum();
    let mu1: f64 = cells.mu1.iter().sum();
    let traces: f64 = cells.tensor.iter().map(|m| m[0] + m[1] + m[2]).sum();
    let mu2: f64 = cells.fans.iter().flatten().map(|fan| fan.mu2).sum();
    assert_eq!(area, 16.0);
    // Edges of a total length of 20, a quarter turn each.
    assert!((mu1 - 20.0 * FRAC_PI_2).abs() < 1e-12);
    assert!((traces - mu1).abs() < 1e-12);
    assert!((mu2 - 4.0 * PI).abs() < 1e-6);
}

#[test]
fn angle_beyond_90_degrees_is_folded_and_is_a_cause() {
    let surface = surface_of(&[[2, 2, 2]]);
    let mut u = trivial(&surface);
    let x = surface.surfels.iter().position(|s| s.normal()[0] == 1.0);
    let z = surface.surfels.iter().position(|s| s.normal()[2] == 1.0);
    let (x, z) = (x.unwrap(), z.unwrap());
    u[x] = [(PI / 6.0).cos(), 0.0, -(PI / 6.0).sin()];
    let (mesh, causes) = causes(&surface, &u);
    let shared = mesh.linels_of[x]
        .iter()
        .find(|l| mesh.linels_of[z].contains(l));
    let shared = *shared.unwrap() as usize;
    let mu1 = dgtal::Cells::new(&mesh, &u).mu1[shared];
    assert!(
        (mu1 - PI / 3.0).abs() < 1e-12,
        "{mu1} is not 60 of 120 degrees"
    );
    assert!(causes.linels[shared].has(Cause::Fold));
    assert_eq!(causes.cells_with(Cause::Fold), 1);
}

#[test]
fn linel_of_four_surfels_has_no_mu1_but_is_crossed() {
    let surface = surface_of(&[[2, 2, 2], [3, 3, 2]]);
    let u = trivial(&surface);
    let (mesh, causes) = causes(&surface, &u);
    let cells = dgtal::Cells::new(&mesh, &u);
    let of_four: Vec<usize> = (0..mesh.linels.len())
        .filter(|&l| mesh.linels[l].faces().count() == 4)
        .collect();
    assert_eq!(of_four.len(), 1);
    assert_eq!(cells.mu1[of_four[0]], 0.0);
    assert!(causes.linels[of_four[0]].has(Cause::DroppedLinel));

    let mut gathered = dgtal::Ball::new(&mesh, 3.0);
    gathered.gather(0);
    assert_eq!(gathered.faces.len(), 12);
    let ball = Ball::new(&Scale::new([1.0; 3]), 3.0, Weights::Dgtal);
    let mut walk = Walk::new(&surface);
    let row = causes.in_ball(&gathered, &order(&surface), &surface, &mut walk, &ball, 0);
    assert_eq!(walk.members.len(), 6);
    assert!(row.bending.has(Cause::Walk) && row.gaussian.has(Cause::Walk));
    assert!(row.bending.has(Cause::DroppedLinel) && !row.gaussian.has(Cause::DroppedLinel));
}

#[test]
fn pointel_of_two_umbrellas_has_no_mu2() {
    let surface = surface_of(&[[2, 2, 2], [3, 3, 3]]);
    let (mesh, causes) = causes(&surface, &trivial(&surface));
    let shared = mesh
        .faces_at
        .iter()
        .position(|faces| faces.len() == 6)
        .unwrap();
    assert!(mesh.chain(shared as u32).is_none());
    assert!(causes.pointels[shared].has(Cause::DroppedPointel));
    assert_eq!(causes.cells_with(Cause::DroppedPointel), 1);
}

#[test]
fn fan_can_be_multiples_of_4_pi_away_from_the_definition_and_nothing_else() {
    // The three neighbours of a voxel leave a pointel of six surfels.
    let surface = surface_of(&[[2, 2, 2], [3, 2, 2], [2, 3, 2], [2, 2, 3]]);
    let golden_angle = PI * (3.0 - 5f64.sqrt());
    let mut fans = 0;
    for shift in 0..100 {
        let u: Vec<Vector> = (0..surface.len())
            .map(|f| {
                // Points on a spiral over the sphere, far from each other for surfels in a row.
                let i = ((f * 37 + shift) % 100) as f64;
                let z: f64 = (i - 49.5) / 50.0;
                let radius = (1.0 - z * z).sqrt();
                let angle = golden_angle * i;
                [radius * angle.cos(), radius * angle.sin(), z]
            })
            .collect();
        let (_, causes) = causes(&surface, &u);
        assert!(causes.largest_remainder < 1e-6, "{shift}");
        fans += causes.cells_with(Cause::Fan);
    }
    assert!(fans > 0);
}
