//! The measures of every cell, in fixed point.
//!
//! In: a surface, u per surfel, the scale. Out: mu0 on surfels and the tensor on linel sheets as
//! multiples of [`UNIT`]; mu2 on umbrellas as multiples of [`MU2_UNIT`]. Each is rounded once
//! (halves to even), so all sums are exact and do not depend on their order.
//!
//! mu2 is defined for any u, even where the paper's condition (iii) fails: with Q(f, g) the area
//! swept on the sphere from the trivial to the corrected normals of two joined surfels,
//!
//! ```text
//! L = (4 - d) pi/2 - sum of Q over the d linels of the umbrella,   mu2 = L - 4 pi k
//! ```
//!
//! k being the integer nearest to L / 4 pi. Q is antisymmetric, each linel belongs to two umbrellas,
//! so on a closed surface sum mu2 + 4 pi sum k = 2 pi (V - E + F), exactly.

use std::f64::consts::FRAC_PI_2;

use super::algebra::{Symmetric, Vector, dot};
use super::field::{self, Field};
use super::formula::{linel_tensor, swept_area};
use super::solid::Scale;
use super::sums::FixedSums;
use super::surface::{OPEN, Surface};

/// mu0 and tensors are integers times this.
pub const UNIT: f64 = 1.0 / (1u64 << 40) as f64;

/// A quarter turn in units of mu2.
pub const QUARTER: i64 = 1 << 44;

/// mu2 is an integer times this.
pub const MU2_UNIT: f64 = FRAC_PI_2 / QUARTER as f64;

/// The measures of all cells.
#[derive(Clone, Debug)]
pub struct Cells {
    /// Of each surfel: <u, n> area.
    pub mu0: Vec<i64>,
    /// Of each linel sheet, xx yy zz xy xz yz; 0 on the border of the image.
    pub tensor: Vec<[i64; 6]>,
    /// Half of it, rounded by itself: the share of each of the two surfels.
    pub half_tensor: Vec<[i64; 6]>,
    /// Of each umbrella; 0 if it is a chain.
    pub mu2: Vec<i64>,
    /// The lift k of each umbrella: not 0 where the corrected normals turn too far.
    pub lift: Vec<i64>,
    /// mu_Omega of each linel sheet; 0 on the border of the image.
    pub omega: Vec<i64>,
    /// Half of it, rounded by itself.
    pub half_omega: Vec<i64>,
    /// With a continuous field, all measures of each surfel; those above but mu0 are then 0.
    pub of_surfels: Option<Vec<FixedSums>>,
}

impl Cells {
    /// The measures of all cells of `surface` with corrected normals `u`, constant on each surfel or
    /// interpolated between pointels.
    pub fn with_field(surface: &Surface, u: &[Vector], scale: &Scale, field: Field) -> Self {
        if field == Field::Constant {
            return Cells::new(surface, u, scale);
        }
        let of_surfels = field::measures(surface, u, scale, field);
        let (linels, umbrellas) = (surface.sheets.len(), surface.umbrella_count());
        Cells {
            mu0: of_surfels.iter().map(|m| m.mu0).collect(),
            tensor: vec![[0; 6]; linels],
            half_tensor: vec![[0; 6]; linels],
            mu2: vec![0; umbrellas],
            lift: vec![0; umbrellas],
            omega: vec![0; linels],
            half_omega: vec![0; linels],
            of_surfels: Some(of_surfels),
        }
    }

    /// The measures of all cells of `surface` with corrected normals `u`, constant on each surfel.
    pub fn new(surface: &Surface, u: &[Vector], scale: &Scale) -> Self {
        let mut cells = Cells {
            mu0: Vec::with_capacity(surface.len()),
            tensor: Vec::with_capacity(surface.sheets.len()),
            half_tensor: Vec::with_capacity(surface.sheets.len()),
            mu2: Vec::with_capacity(surface.umbrella_count()),
            lift: Vec::with_capacity(surface.umbrella_count()),
            omega: Vec::with_capacity(surface.sheets.len()),
            half_omega: Vec::with_capacity(surface.sheets.len()),
            of_surfels: None,
        };
        for (surfel, &u) in surface.surfels.iter().zip(u) {
            cells
                .mu0
                .push(in_units(dot(u, surfel.normal()) * scale.area(surfel.axis)));
        }
        let mut swept = Vec::with_capacity(surface.sheets.len());
        for sheet in &surface.sheets {
            if sheet.second == OPEN {
                cells.tensor.push([0; 6]);
                cells.half_tensor.push([0; 6]);
                cells.omega.push(0);
                cells.half_omega.push(0);
                swept.push(0);
                continue;
            }
            let f = &surface.surfels[sheet.first as usize];
            let g = &surface.surfels[sheet.second as usize];
            let (u_f, u_g) = (u[sheet.first as usize], u[sheet.second as usize]);
            // The boundary of f runs along side i in the direction of side i + 1.
            let e = f.steps()[(sheet.side + 1) % 4].map(f64::from);
            let length = dot(scale.edges, e.map(f64::abs));
            let tensor: Symmetric = linel_tensor(e, u_f, u_g).map(|m| m * length);
            cells.tensor.push(tensor.map(in_units));
            cells.half_tensor.push(tensor.map(|m| in_units(0.5 * m)));
            let omega = length * (dot(e, u_f) - dot(e, u_g));
            cells.omega.push(in_units(omega));
            cells.half_omega.push(in_units(0.5 * omega));
            swept.push(
                (swept_area(f.normal(), g.normal(), u_g, u_f) / MU2_UNIT).round_ties_even() as i64,
            );
        }
        for umbrella in 0..surface.umbrella_count() as u32 {
            let (mu2, lift) = umbrella_mu2(surface, umbrella, &swept);
            cells.mu2.push(mu2);
            cells.lift.push(lift);
        }
        cells
    }
}

/// Areas of half the sphere up to this much more count as half the sphere, in units of mu2.
pub(super) const HALF_SPHERE_SLACK: i64 = 1 << 16;

/// mu2 and the lift k of an umbrella.
fn umbrella_mu2(surface: &Surface, umbrella: u32, swept: &[i64]) -> (i64, i64) {
    if !surface.umbrella_is_cycle[umbrella as usize] {
        return (0, 0);
    }
    let members = surface.umbrella(umbrella);
    let mut lifted = (4 - members.len() as i64) * QUARTER;
    for &f in members {
        // Counter-clockwise, the surfel after f lies across the side of the same number as the corner.
        let corner = surface.umbrellas_of[f as usize]
            .iter()
            .position(|&o| o == umbrella);
        let side = corner.expect("a member knows its umbrella");
        let sheet = surface.sheets_of[f as usize][side] as usize;
        lifted -= if surface.sheets[sheet].first == f {
            swept[sheet]
        } else {
            -swept[sheet]
        };
    }
    // An area of half the sphere could be + or - 2 pi: it is +, also if rounding made it a little more.
    let lift = (lifted + 4 * QUARTER - 1 - HALF_SPHERE_SLACK).div_euclid(8 * QUARTER);
    (lifted - lift * 8 * QUARTER, lift)
}

fn in_units(value: f64) -> i64 {
    (value / UNIT).round_ties_even() as i64
}

/// The integer nearest to a / b, half away from zero; b > 0.
pub(super) fn nearest_quotient(a: i64, b: i64) -> i64 {
    a.signum() * ((2 * a.abs() + b) / (2 * b))
}
