//! DGtal's measures of cells, for a constant u per face, in voxels.
//!
//! A triangle whose corners lie on one great circle is not always thin by DGtal's measure. Then the signs of
//! quantities near 0 decide between an area of 0 and one of 2 pi, so operations here keep
//! DGtal's order: quotients are not products with a reciprocal.

use std::f64::consts::TAU;

use crate::plain::algebra::{ENTRIES, Symmetric, Vector, cross, determinant, dot, norm, scaled};

use super::mesh::{Linel, Mesh};

/// Normals with a smaller sine between them are taken as equal, a smaller mean of normals as none.
const MIN_SINE: f64 = 1e-10;

/// Spherical triangles with a shorter side, or flatter by this measure, are left out.
const MIN_SIDE: f64 = 1e-8;

/// mu2 of a pointel.
#[derive(Clone, Debug)]
pub struct Fan {
    /// The faces around the pointel as they were chained.
    pub faces: Vec<u32>,
    /// The area of the fan.
    pub mu2: f64,
}

/// The measures of all cells.
#[derive(Clone, Debug)]
pub struct Cells {
    /// Of each face: <u, n>.
    pub mu0: Vec<f64>,
    /// Of each linel: mu1, *twice* the integral of the mean curvature.
    pub mu1: Vec<f64>,
    /// Of each linel: the symmetric part of minus muXY, positive on convex shapes.
    pub tensor: Vec<Symmetric>,
    /// Of each pointel; none where the faces do not chain, which counts as 0.
    pub fans: Vec<Option<Fan>>,
}

impl Cells {
    /// The measures of the cells of `mesh` with corrected normals `u`.
    pub fn new(mesh: &Mesh, u: &[Vector]) -> Self {
        let (mu1, tensor) = mesh.linels.iter().map(|l| linel_measures(l, u)).unzip();
        Cells {
            mu0: mesh
                .surfels
                .iter()
                .zip(u)
                .map(|(surfel, &u)| dot(surfel.normal(), u))
                .collect(),
            mu1,
            tensor,
            fans: (0..mesh.pointels.len() as u32)
                .map(|pointel| {
                    let faces = mesh.chain(pointel)?;
                    let normals: Vec<Vector> = faces.iter().map(|&f| u[f as usize]).collect();
                    let mu2 = fan_area(&normals);
                    Some(Fan { faces, mu2 })
                })
                .collect(),
        }
    }
}

/// mu1 and the tensor of a linel; 0 if it has not one face on each side.
fn linel_measures(linel: &Linel, u: &[Vector]) -> (f64, Symmetric) {
    let nothing = (0.0, [0.0; 6]);
    let Some((left, right)) = linel.pair() else {
        return nothing;
    };
    let (u_left, u_right) = (u[left as usize], u[right as usize]);
    let c = cross(u_right, u_left);
    let sine = norm(c).min(1.0);
    if sine < MIN_SINE {
        return nothing;
    }
    let e1 = divided(c, sine);
    // Never more than 90 degrees: this is the fold. A folded tensor depends on which face is left.
    let psi = sine.asin();
    let e = linel.direction.map(f64::from);
    // u_right turns by psi about e1: v = cos u_right + sin w. Minus muXY is minus the integral
    // of (e x v) (x) (e1 x v), where e x v = cos a + sin b and e1 x v = cos w - sin u_right.
    let w = cross(e1, u_right);
    let a = cross(e, u_right);
    let b = cross(e, w);
    let cos_cos = 0.5 * psi + 0.25 * (2.0 * psi).sin();
    let sin_sin = 0.5 * psi - 0.25 * (2.0 * psi).sin();
    let sin_cos = 0.5 * psi.sin() * psi.sin();
    let tensor = ENTRIES.map(|(i, j)| {
        let symmetric = |x: Vector, y: Vector| 0.5 * (x[i] * y[j] + x[j] * y[i]);
        sin_cos * (symmetric(a, u_right) - symmetric(b, w)) + sin_sin * symmetric(b, u_right)
            - cos_cos * symmetric(a, w)
    });
    (-psi * dot(e, e1), tensor)
}

/// The area of the fan of triangles from the mean normal.
fn fan_area(normals: &[Vector]) -> f64 {
    let mut mean = [0.0; 3];
    for u in normals {
        (0..3).for_each(|a| mean[a] += u[a]);
    }
    if norm(mean) < MIN_SINE {
        return 0.0;
    }
    let mean = divided(mean, norm(mean));
    let nexts = normals.iter().cycle().skip(1);
    normals
        .iter()
        .zip(nexts)
        .map(|(&u, &next)| triangle_area(mean, u, next))
        .sum()
}

/// The signed area of a spherical triangle by its angles; 0 if it is thin.
fn triangle_area(a: Vector, b: Vector, c: Vector) -> f64 {
    let [a, b, c] = [a, b, c].map(|x| divided(x, norm(x)));
    let side = |x: Vector, y: Vector| norm([0, 1, 2].map(|i| x[i] - y[i]));
    let mut sides = [side(a, b), side(a, c), side(b, c)];
    sides.sort_by(f64::total_cmp);
    if sides[0] < MIN_SIDE || (sides[2] - sides[1] - sides[0]).abs() < MIN_SIDE {
        return 0.0;
    }
    // The corners of the polar triangle: its sides are pi minus the angles.
    let polar = |x: Vector, y: Vector, towards: Vector| {
        let p = cross(x, y);
        let length = norm(p);
        (length > MIN_SIDE).then(|| {
            let sign = if dot(p, towards) < 0.0 { -1.0 } else { 1.0 };
            scaled(divided(p, length), sign)
        })
    };
    let (Some(pa), Some(pb), Some(pc)) = (polar(b, c, a), polar(c, a, b), polar(a, b, c)) else {
        return 0.0;
    };
    let angles = [(pb, pc), (pc, pa), (pa, pb)].map(|(x, y)| dot(x, y).clamp(-1.0, 1.0).acos());
    if angles.contains(&0.0) {
        return 0.0;
    }
    let area = TAU - angles[0] - angles[1] - angles[2];
    let size = |x: Vector| x.iter().map(|x| x.abs()).sum::<f64>();
    let from_a = |x: Vector| [0, 1, 2].map(|i| x[i] - a[i]);
    let plane = cross(from_a(b), from_a(c));
    if size([0, 1, 2].map(|i| a[i] + b[i] + c[i])) <= MIN_SIDE || size(plane) <= MIN_SIDE {
        return 0.0;
    }
    if determinant(a, b, c) < 0.0 {
        -area
    } else {
        area
    }
}

fn divided(a: Vector, by: f64) -> Vector {
    a.map(|x| x / by)
}
