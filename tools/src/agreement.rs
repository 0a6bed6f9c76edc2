//! Agreement of the plain reference with DGtal, row by row.
//!
//! Normals by integral invariants with DGtal's orientation, DGtal's ball and weights,
//! r = rho = 3 h^(1/2). DGtal differs by design where it *folds* (asin of the angle of a linel beyond
//! 90 degrees), *drops* (a linel of four surfels, a pointel of several umbrellas) or meets a *reversed*
//! normal; rows whose ball meets such a place are counted apart.

use std::collections::HashMap;

use anyhow::{Context, Result, ensure};

use crate::npz::Table;
use crate::plain::algebra::{Vector, dot};
use crate::plain::surface::OPEN;
use crate::plain::{
    Analysis, Ball, Estimator, Normals, Orientation, Scale, Settings, Solid, Surface, Walk,
    Weights, analyse, normals,
};

/// How far one column agrees.
#[derive(Clone, Debug)]
pub struct Column {
    /// Its name in the table.
    pub name: &'static str,
    /// What is asked of it.
    pub bound: f64,
    /// Over all rows.
    pub all: Agreement,
    /// Over the rows whose ball meets no place where DGtal differs by design.
    pub clean: Agreement,
}

/// The largest difference, and how many exceed the bound.
#[derive(Clone, Copy, Debug, Default)]
pub struct Agreement {
    /// Rows compared.
    pub rows: usize,
    /// The largest absolute difference.
    pub largest: f64,
    /// Rows whose difference exceeds the bound.
    pub beyond: usize,
}

impl Agreement {
    fn add(&mut self, difference: f64, bound: f64) {
        self.rows += 1;
        // In total order NaN is the largest: it is beyond every bound.
        if difference.total_cmp(&self.largest).is_gt() {
            self.largest = difference;
        }
        self.beyond += usize::from(difference.total_cmp(&bound).is_gt());
    }
}

/// The comparison with one table.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Surfels beside a linel whose normals differ by more than 90 degrees.
    pub folded: usize,
    /// Surfels at a linel of four surfels or a pointel of several umbrellas.
    pub dropped: usize,
    /// Surfels whose normal is opposite to the surface average.
    pub reversed: usize,
    /// Surfels of an umbrella with a lift.
    pub lifted: usize,
    /// Normals, H, G, k1, k2, d1, d2.
    pub columns: Vec<Column>,
}

/// Compares with the rows of `table`; `shift` is added to its Khalimsky coordinates.
///
/// # Errors
/// If the table lacks a column, or describes another surface.
pub fn compare(solid: &Solid, gridstep: f64, shift: i32, table: &Table) -> Result<Comparison> {
    let radius_world = 3.0 * gridstep.sqrt();
    let settings = Settings {
        normals: Estimator::IntegralInvariant {
            radius_world,
            orientation: Orientation::Dgtal,
        },
        weights: Weights::Dgtal,
        count_sheets: false,
        ..Settings::new([gridstep; 3], radius_world)
    };
    let analysis = analyse(solid, &settings);
    let places = table.triples("k")?;
    ensure!(
        places.len() == analysis.rows.len(),
        "the table has {} surfels, the shape {}",
        places.len(),
        analysis.rows.len()
    );
    let scale = Scale::new(settings.spacing_world);
    let suspects = Suspects::new(solid, &analysis, &scale, radius_world);
    let clean = suspects.clean_rows(&analysis.surface, &scale, radius_world);

    let (normal, d1, d2) = (
        table.triples("normal_II")?,
        table.triples("d1")?,
        table.triples("d2")?,
    );
    let (mean, gaussian) = (table.column("H_CNC")?, table.column("G_CNC")?);
    let (k1, k2) = (table.column("k1")?, table.column("k2")?);
    let names = ["normal_II", "H_CNC", "G_CNC", "k1", "k2", "d1", "d2"];
    // A direction is as good as k2 - k1 is large: their product with its difference is compared.
    let bounds = [1e-9, 1e-9, 1e-7, 1e-6, 1e-6, 1e-6, 1e-6];
    let mut columns: Vec<Column> = names
        .into_iter()
        .zip(bounds)
        .map(|(name, bound)| Column {
            name,
            bound,
            all: Agreement::default(),
            clean: Agreement::default(),
        })
        .collect();
    for (i, place) in places.iter().enumerate() {
        let k = place.map(|k| k as i32 + shift);
        let surfel = analysis
            .surface
            .find(k)
            .with_context(|| format!("no surfel at {place:?}"))?;
        let row = &analysis.rows[surfel as usize];
        let c = &row.curvature;
        let differences = [
            (0..3).fold(0.0, |most: f64, a| {
                most.max((row.u[a] - normal[i][a]).abs())
            }),
            (c.mean - mean[i]).abs(),
            (c.gaussian - gaussian[i]).abs(),
            (c.k1 - k1[i]).abs(),
            (c.k2 - k2[i]).abs(),
            line_difference(c.d1, d1[i]) * (c.k2 - c.k1),
            line_difference(c.d2, d2[i]) * (c.k2 - c.k1),
        ];
        for (column, difference) in columns.iter_mut().zip(differences) {
            column.all.add(difference, column.bound);
            if clean[surfel as usize] {
                column.clean.add(difference, column.bound);
            }
        }
    }
    let count = |marks: &[bool]| marks.iter().filter(|&&mark| mark).count();
    Ok(Comparison {
        folded: count(&suspects.folded),
        dropped: count(&suspects.dropped),
        reversed: count(&suspects.reversed),
        lifted: count(&suspects.lifted),
        columns,
    })
}

/// Largest difference of the coordinates of two unit vectors, up to sign.
fn line_difference(a: Vector, b: Vector) -> f64 {
    let sign = if dot(a, b) < 0.0 { -1.0 } else { 1.0 };
    (0..3).fold(0.0, |most: f64, i| most.max((a[i] - sign * b[i]).abs()))
}

/// Surfels where DGtal differs by design.
struct Suspects {
    folded: Vec<bool>,
    dropped: Vec<bool>,
    reversed: Vec<bool>,
    lifted: Vec<bool>,
}

impl Suspects {
    fn new(solid: &Solid, analysis: &Analysis, scale: &Scale, radius_world: f64) -> Self {
        let surface = &analysis.surface;
        let average = Estimator::SurfaceAverage { radius_world };
        let Normals { u: average, .. } = normals::estimate(solid, surface, scale, average);

        // Pointels and linels met more than once are shared by several umbrellas or sheets.
        let mut umbrellas_at: HashMap<[i32; 3], u32> = HashMap::new();
        for umbrella in 0..surface.umbrella_count() as u32 {
            *umbrellas_at.entry(pointel(surface, umbrella)).or_default() += 1;
        }
        let mut sheets_at: HashMap<[i32; 3], u32> = HashMap::new();
        for sheet in &surface.sheets {
            let linel = surface.surfels[sheet.first as usize].linel(sheet.side);
            *sheets_at.entry(linel).or_default() += 1;
        }
        // A shared linel also breaks the umbrellas at its ends, whatever they are here.
        let mut broken: HashMap<[i32; 3], bool> = HashMap::new();
        for (linel, _) in sheets_at.iter().filter(|&(_, &count)| count > 1) {
            for axis in (0..3).filter(|&axis| linel[axis] % 2 != 0) {
                for sign in [-1, 1] {
                    let mut end = *linel;
                    end[axis] += sign;
                    broken.insert(end, true);
                }
            }
        }

        let mut suspects = Suspects {
            folded: Vec::new(),
            dropped: Vec::new(),
            reversed: Vec::new(),
            lifted: Vec::new(),
        };
        for (f, surfel) in surface.surfels.iter().enumerate() {
            let u = analysis.rows[f].u;
            let neighbours = surface.neighbours[f].iter().filter(|&&g| g != OPEN);
            suspects.folded.push(
                neighbours
                    .into_iter()
                    .any(|&g| dot(u, analysis.rows[g as usize].u) < 0.0),
            );
            suspects.dropped.push((0..4).any(|corner| {
                let pointel = surfel.pointel(corner);
                umbrellas_at[&pointel] > 1 || broken.contains_key(&pointel)
            }));
            suspects.reversed.push(dot(u, average[f]) < 0.0);
            suspects.lifted.push(analysis.rows[f].flags.lift);
        }
        suspects
    }

    /// The rows whose ball meets no suspect.
    fn clean_rows(&self, surface: &Surface, scale: &Scale, radius_world: f64) -> Vec<bool> {
        let ball = Ball::new(scale, radius_world / scale.unit_world, Weights::Dgtal);
        let mut walk = Walk::new(surface);
        let is_suspect = |f: u32| {
            let f = f as usize;
            self.folded[f] || self.dropped[f] || self.reversed[f] || self.lifted[f]
        };
        (0..surface.len() as u32)
            .map(|p| {
                walk.connected(p, |g| ball.has(surface, p, g));
                !walk.members.iter().any(|&f| is_suspect(f))
            })
            .collect()
    }
}

/// Khalimsky coordinates of the pointel of an umbrella.
fn pointel(surface: &Surface, umbrella: u32) -> [i32; 3] {
    let f = surface.umbrella(umbrella)[0] as usize;
    let corner = surface.umbrellas_of[f].iter().position(|&o| o == umbrella);
    surface.surfels[f].pointel(corner.expect("a member knows its umbrella"))
}
