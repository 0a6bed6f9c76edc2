//! Agreement with DGtal, row by row, and the reason of every difference.
//!
//! Normals by integral invariants, DGtal's ball and weights, r = rho = 3 h^(1/2). DGtal differs by
//! design where it folds, drops or reverses. Two statements together say that this is all:
//!
//! * [`dgtal`], which folds and drops likewise, fed with the normals of the table, gives every row;
//! * the plain reference, by its own definitions and with its own normals, gives every row
//!   whose ball has none of the [`causes`](crate::causes).

use anyhow::{Context, Result, ensure};

use crate::causes::{Cause, Causes, RowCauses};
use crate::dgtal;
use crate::npz::Table;
use crate::plain::algebra::{Vector, dot, scaled};
use crate::plain::{
    Adjacency, Ball, Cells, Estimator, Normals, Orientation, Row, Scale, Settings, Solid, Surface,
    Walk, Weights, measure, normals,
};

/// How far two columns agree.
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

/// How far one column agrees.
#[derive(Clone, Debug)]
pub struct Column {
    /// Its name in the table.
    pub name: String,
    /// What is asked of it.
    pub bound: f64,
    /// DGtal's cells and walk, fed with the normals of the table: all rows.
    pub emulated: Agreement,
    /// The plain reference: the rows whose ball has a cause to differ.
    pub caused: Agreement,
    /// The plain reference: the rows without.
    pub clean: Agreement,
}

/// How often a cause was met.
#[derive(Clone, Copy, Debug)]
pub struct Tally {
    /// The cause.
    pub cause: Cause,
    /// Cells that have it.
    pub cells: usize,
    /// Rows whose ball has it.
    pub rows: usize,
    /// Those of them where a column differs.
    pub differ: usize,
    /// Those of them where it is the only cause.
    pub differ_alone: usize,
}

/// The comparison of one choice of normals with one set of columns.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// What is compared.
    pub name: &'static str,
    /// Normals, H, G, k1, k2, d1, d2, as far as the table has them.
    pub columns: Vec<Column>,
    /// Every cause.
    pub tallies: Vec<Tally>,
    /// Rows where G agrees though there are fans in the ball, because what they add cancels.
    pub cancelled: usize,
    /// Normals that differ, but only in sign.
    pub opposite_normals: usize,
    /// The largest difference of mu2 at a pointel whose chain is an umbrella, modulo 4 pi.
    pub largest_remainder: f64,
}

/// Which normals the plain reference takes, and which columns it meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Choice {
    /// DGtal's rule; the columns as they are.
    Dgtal,
    /// Away from the first moment; the columns as they are.
    Moment,
    /// DGtal's rule, then turned where the table says so; the columns that end in `_c`.
    Corrected,
}

/// A surfel whose normal is this near to its plane has no sign that rounding does not decide.
const TIE: f64 = 1e-9;

/// Normals that differ by more are others.
const SAME_NORMAL: f64 = 1e-9;

/// A shape and a table of it.
struct Case<'t> {
    surface: Surface,
    scale: Scale,
    gridstep: f64,
    radius_world: f64,
    table: &'t Table,
    /// The surfel of each row.
    order: Vec<u32>,
    mesh: dgtal::Mesh,
    /// Normals by DGtal's rule and away from the moment, per surfel.
    dgtal: Normals,
    moment: Normals,
}

/// Compares with the rows of `table`; `shift` is added to its Khalimsky coordinates.
///
/// # Errors
/// If the table lacks a column, or describes another surface.
pub fn compare(solid: &Solid, gridstep: f64, shift: i32, table: &Table) -> Result<Vec<Comparison>> {
    let radius_world = 3.0 * gridstep.sqrt();
    let scale = Scale::new([gridstep; 3]);
    let surface = Surface::new(solid, false, Adjacency::Interior);
    let places = table.triples("k")?;
    ensure!(
        places.len() == surface.len(),
        "the table has {} surfels, the shape {}",
        places.len(),
        surface.len()
    );
    let mut order = Vec::with_capacity(places.len());
    for place in &places {
        let k = place.map(|k| k as i32 + shift);
        let surfel = surface
            .find(k)
            .with_context(|| format!("no surfel at {place:?}"))?;
        order.push(surfel);
    }
    let mesh = dgtal::Mesh::new(order.iter().map(|&f| surface.surfels[f as usize]).collect());
    let by = |orientation| {
        let estimator = Estimator::IntegralInvariant {
            radius_world,
            orientation,
        };
        normals::estimate(solid, &surface, &scale, estimator)
    };
    let case = Case {
        dgtal: by(Orientation::Dgtal),
        moment: by(Orientation::Moment),
        surface,
        scale,
        gridstep,
        radius_world,
        table,
        order,
        mesh,
    };
    let mut comparisons = vec![case.compare(Choice::Dgtal)?, case.compare(Choice::Moment)?];
    if table.find("flip_c").is_some() {
        comparisons.push(case.compare(Choice::Corrected)?);
    }
    Ok(comparisons)
}

impl Case<'_> {
    fn compare(&self, choice: Choice) -> Result<Comparison> {
        let (surface, order) = (&self.surface, &self.order);
        // The table's side, by rows.
        let mut u = self.table.triples("normal_II")?;
        let mut flips = vec![1.0; u.len()];
        if choice == Choice::Corrected {
            flips.copy_from_slice(self.table.column("flip_c")?);
        }
        for (u, &flip) in u.iter_mut().zip(&flips) {
            *u = scaled(*u, flip);
        }
        let measures = dgtal::Cells::new(&self.mesh, &u);

        // Our side, by surfels.
        let mut own = match choice {
            Choice::Moment => self.moment.clone(),
            Choice::Dgtal | Choice::Corrected => self.dgtal.clone(),
        };
        for (&f, &flip) in order.iter().zip(&flips) {
            own.u[f as usize] = scaled(own.u[f as usize], flip);
        }
        let settings = Settings {
            weights: Weights::Dgtal,
            count_sheets: false,
            ..Settings::new([self.gridstep; 3], self.radius_world)
        };
        let own_cells = Cells::new(surface, &own.u, &self.scale);
        let rows = measure(surface, &own, &own_cells, &self.scale, &settings);

        let other_normals = order
            .iter()
            .zip(&flips)
            .map(|(&f, &flip)| {
                let f = f as usize;
                let by_rule = self.dgtal.u[f];
                dot(by_rule, surface.surfels[f].normal()).abs() < TIE
                    || difference(own.u[f], scaled(by_rule, flip)) > SAME_NORMAL
            })
            .collect();
        let mut u_by_surfel = vec![[0.0; 3]; u.len()];
        for (&f, &u) in order.iter().zip(&u) {
            u_by_surfel[f as usize] = u;
        }
        let causes = Causes::new(
            &self.mesh,
            &u,
            &measures,
            surface,
            order,
            &Cells::new(surface, &u_by_surfel, &self.scale),
            other_normals,
        );
        self.compare_rows(choice, &u, &measures, &rows, &causes)
    }

    fn compare_rows(
        &self,
        choice: Choice,
        u: &[Vector],
        measures: &dgtal::Cells,
        rows: &[Row],
        causes: &Causes,
    ) -> Result<Comparison> {
        let expected = Expected::new(self.table, choice == Choice::Corrected)?;
        let mut columns = expected.columns();
        let mut tallies = Cause::ALL.map(|cause| Tally {
            cause,
            cells: causes.cells_with(cause),
            rows: 0,
            differ: 0,
            differ_alone: 0,
        });
        let ball = Ball::new(
            &self.scale,
            self.radius_world / self.scale.unit_world,
            Weights::Dgtal,
        );
        let (mut cancelled, mut opposite_normals) = (0, 0);
        let mut walk = Walk::new(&self.surface);
        let mut gathered = dgtal::Ball::new(&self.mesh, self.radius_world / self.gridstep);
        for (i, &f) in self.order.iter().enumerate() {
            gathered.gather(i as u32);
            let emulated = gathered.curvatures(measures, u[i], self.gridstep);
            let of_row = causes.in_ball(&gathered, &self.order, &self.surface, &mut walk, &ball, f);
            let row = &rows[f as usize];
            let c = &row.curvature;
            let e = &emulated;
            let [plain, emulated] = [
                (row.u, c.mean, c.gaussian, [c.k1, c.k2], [c.d1, c.d2]),
                (u[i], e.mean, e.gaussian, [e.k1, e.k2], [e.d1, e.d2]),
            ]
            .map(|values| expected.differences(i, u[i], values));
            let turned = difference(scaled(row.u, -1.0), u[i]) <= SAME_NORMAL;
            opposite_normals += usize::from(turned);
            let turns = gathered.pointels.iter().map(|&p| causes.turns[p as usize]);
            let only_fans = of_row.gaussian.is_only(Cause::Fan);
            let agrees = plain[2].total_cmp(&columns[2].bound).is_le();
            cancelled += usize::from(only_fans && agrees && turns.sum::<i64>() == 0);
            let mut differs = [false; 2];
            for (j, column) in columns.iter_mut().enumerate() {
                column.emulated.add(emulated[j], column.bound);
                let is_caused = match j {
                    0 => causes.normals[i],
                    2 => !of_row.gaussian.is_empty(),
                    _ => !of_row.bending.is_empty(),
                };
                let agreement = if is_caused {
                    &mut column.caused
                } else {
                    &mut column.clean
                };
                agreement.add(plain[j], column.bound);
                if j > 0 {
                    differs[usize::from(j == 2)] |= plain[j].total_cmp(&column.bound).is_gt();
                }
            }
            tally(&mut tallies, of_row, differs);
        }
        Ok(Comparison {
            name: match choice {
                Choice::Dgtal => "normals by DGtal's rule",
                Choice::Moment => "normals away from the first moment",
                Choice::Corrected => "normals by DGtal's rule, corrected by flip_c",
            },
            columns,
            tallies: tallies.to_vec(),
            cancelled,
            opposite_normals,
            largest_remainder: causes.largest_remainder,
        })
    }
}

/// `differs`: a column of mu1, G.
fn tally(tallies: &mut [Tally], causes: RowCauses, differs: [bool; 2]) {
    let sets = [causes.bending, causes.gaussian];
    for tally in tallies {
        let [bending, gaussian] = sets.map(|set| set.has(tally.cause));
        let alone = sets.map(|set| set.is_only(tally.cause));
        tally.rows += usize::from(bending || gaussian);
        tally.differ += usize::from(bending && differs[0] || gaussian && differs[1]);
        tally.differ_alone += usize::from(alone[0] && differs[0] || alone[1] && differs[1]);
    }
}

/// Normal, H, G, principal curvatures, principal directions.
type Values = (Vector, f64, f64, [f64; 2], [Vector; 2]);

/// The columns of a table.
struct Expected<'t> {
    suffix: &'static str,
    mean: &'t [f64],
    gaussian: &'t [f64],
    k1: &'t [f64],
    k2: &'t [f64],
    directions: Option<[Vec<Vector>; 2]>,
}

impl<'t> Expected<'t> {
    fn new(table: &'t Table, corrected: bool) -> Result<Self> {
        let suffix = if corrected { "_c" } else { "" };
        let column = |name: &str| table.column(&format!("{name}{suffix}"));
        Ok(Expected {
            suffix,
            mean: column("H_CNC")?,
            gaussian: column("G_CNC")?,
            k1: column("k1")?,
            k2: column("k2")?,
            directions: if corrected {
                None
            } else {
                Some([table.triples("d1")?, table.triples("d2")?])
            },
        })
    }

    fn columns(&self) -> Vec<Column> {
        // A direction is as good as k2 - k1 is large: their product with its difference is compared.
        let bounds = [
            ("normal_II", 1e-9),
            ("H_CNC", 1e-9),
            ("G_CNC", 1e-7),
            ("k1", 1e-6),
            ("k2", 1e-6),
            ("d1", 1e-6),
            ("d2", 1e-6),
        ];
        let count = if self.directions.is_some() { 7 } else { 5 };
        bounds[..count]
            .iter()
            .map(|&(name, bound)| Column {
                name: format!("{name}{}", self.suffix),
                bound,
                emulated: Agreement::default(),
                caused: Agreement::default(),
                clean: Agreement::default(),
            })
            .collect()
    }

    /// The differences of a row from what the table has, in the order of the columns; `u` is its normal.
    fn differences(&self, row: usize, u: Vector, values: Values) -> Vec<f64> {
        let (normal, mean, gaussian, [k1, k2], d) = values;
        let mut differences = vec![
            difference(normal, u),
            (mean - self.mean[row]).abs(),
            (gaussian - self.gaussian[row]).abs(),
            (k1 - self.k1[row]).abs(),
            (k2 - self.k2[row]).abs(),
        ];
        if let Some(directions) = &self.directions {
            for (d, column) in d.into_iter().zip(directions) {
                let expected = column[row];
                let sign = if dot(d, expected) < 0.0 { -1.0 } else { 1.0 };
                differences.push(difference(d, scaled(expected, sign)) * (k2 - k1));
            }
        }
        differences
    }
}

/// Largest difference of the coordinates.
fn difference(a: Vector, b: Vector) -> f64 {
    (0..3).fold(0.0, |most: f64, i| most.max((a[i] - b[i]).abs()))
}
