//! The rows of a run in memory, the truth beside them, and what is measured on both.
//!
//! Errors are those of section 6.1.5 of the paper: over the surfels, against the curvature at the
//! point of the shape closest to the centroid. Left out, and counted, are surfels of specks that lie
//! wholly within their ball (flag `island`, which noise makes), rows that are not a number, and
//! centroids without a closest point.
//!
//! Angles are in degrees, of a normal to the true normal and of a principal direction as a line. A
//! direction is measured where it is one: not at umbilics, where |k2 - k1| R < [`UMBILIC`], R the
//! radius of the sphere that has as much area as the surface.

use std::path::Path;

use anyhow::{Result, ensure};
use curvox::shape::{by_spec, closest_point};
use curvox::sink::{Check, Flag, OutputInfo, SurfelBatch, TableInfo};
use glam::DVec3;

/// Below this, the product of k2 - k1 and the size of the shape counts as an umbilic. Larger leaves
/// out directions that are well defined; smaller measures noise.
pub const UMBILIC: f64 = 0.2;

/// All rows of a table.
pub struct Rows {
    /// What the table says about itself.
    pub info: TableInfo,
    /// The rows.
    pub batch: SurfelBatch,
}

impl Rows {
    /// Reads a table whole.
    ///
    /// # Errors
    /// If it cannot be read, or has no rows.
    pub fn read(path: &Path) -> Result<Self> {
        let output = OutputInfo::open(path, Check::Footers)?;
        output.ensure_complete()?;
        let info = output.table.clone();
        let count = usize::try_from(output.rows)?;
        let info = info.filter(|_| count > 0);
        let info = anyhow::Context::with_context(info, || format!("{}: no rows", path.display()))?;
        let mut batch = SurfelBatch::with_capacity(&info, count);
        for part in output.into_rows() {
            let part = part?;
            batch.extend_from(&part, 0..part.len());
        }
        Ok(Rows { info, batch })
    }

    /// Number of surfels.
    pub fn len(&self) -> usize {
        self.batch.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.batch.is_empty()
    }

    /// The centroid of a surfel in the world, from its integers.
    pub fn centroid(&self, row: usize) -> DVec3 {
        let k = self.batch.k_at(row);
        DVec3::from_array(
            [0, 1, 2]
                .map(|a| self.info.origin[a] + self.info.spacing[a] * 0.5 * f64::from(k[a] - 1)),
        )
    }

    fn normal(&self, row: usize) -> DVec3 {
        vector(&self.batch.normal, row)
    }

    /// Pairs of surfels that share a linel which no other surfel has.
    pub fn neighbours(&self) -> Vec<[u32; 2]> {
        let mut sides = Vec::with_capacity(4 * self.len());
        for row in 0..self.len() {
            let k = self.batch.k_at(row);
            for axis in (0..3).filter(|&axis| k[axis] & 1 == 1) {
                for step in [-1, 1] {
                    let mut linel = k;
                    linel[axis] += step;
                    // 21 bits hold images of a million voxels along an axis; a table of curvox has
                    // coordinates of at least 0.
                    let key = linel
                        .iter()
                        .fold(0_u64, |key, &k| key << 21 | (k as u64 & 0x1f_ffff));
                    sides.push((key, row as u32));
                }
            }
        }
        sides.sort_unstable();
        sides
            .chunk_by(|a, b| a.0 == b.0)
            .filter_map(|group| match group {
                [a, b] => Some([a.1, b.1]),
                _ => None,
            })
            .collect()
    }

    /// The surfels that another table of the same grid has too, of the same side: rows here and there.
    pub fn common(&self, other: &Rows) -> Vec<[usize; 2]> {
        let order = |rows: &Rows, row: usize| {
            let [x, y, z] = rows.batch.k_at(row);
            (z, y, x, rows.batch.side[row])
        };
        // Tables are in the order of (kz, ky, kx).
        let mut common = Vec::new();
        let (mut here, mut there) = (0, 0);
        while here < self.len() && there < other.len() {
            match order(self, here).cmp(&order(other, there)) {
                std::cmp::Ordering::Less => here += 1,
                std::cmp::Ordering::Greater => there += 1,
                std::cmp::Ordering::Equal => {
                    common.push([here, there]);
                    here += 1;
                    there += 1;
                }
            }
        }
        common
    }

    /// The largest difference |u_i - u_j| of the normals of neighbours: the delta_u of section 5.
    pub fn normal_jump(&self, neighbours: &[[u32; 2]]) -> f64 {
        neighbours
            .iter()
            .map(|&[i, j]| (self.normal(i as usize) - self.normal(j as usize)).length())
            .fold(0.0, f64::max)
    }
}

fn vector(columns: &[Vec<f32>; 3], row: usize) -> DVec3 {
    DVec3::new(
        columns[0][row].into(),
        columns[1][row].into(),
        columns[2][row].into(),
    )
}

/// What is true at a surfel.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// H, G, k1, k2.
    pub values: [f64; 4],
    /// Unit normal, outward.
    pub normal: [f32; 3],
    /// Unit directions of k1 and k2.
    pub directions: [[f32; 3]; 2],
}

/// The truth at each row; none where the centroid has no closest point.
///
/// # Errors
/// If there is no such shape.
pub fn truth(shape: &str, rows: &Rows) -> Result<Vec<Option<Truth>>> {
    let shape = by_spec(shape)?;
    let single = |v: DVec3| v.as_vec3().to_array();
    Ok((0..rows.len())
        .map(|row| {
            let truth = closest_point(&shape, rows.centroid(row))?.truth;
            Some(Truth {
                values: [
                    truth.mean_curvature,
                    truth.gaussian_curvature,
                    truth.k1,
                    truth.k2,
                ],
                normal: single(truth.normal),
                directions: [truth.d1, truth.d2].map(single),
            })
        })
        .collect())
}

/// Errors of one quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// Root mean square.
    pub l2: f64,
    /// Largest.
    pub linf: f64,
    /// Half of the surfels have no more.
    pub median: f64,
    /// Surfels measured.
    pub count: usize,
}

impl Errors {
    /// Of absolute errors; what is not a number is left out.
    pub fn of(errors: impl Iterator<Item = f64>) -> Self {
        let mut all: Vec<f64> = errors.filter(|e| e.is_finite()).collect();
        let count = all.len();
        if count == 0 {
            return Errors {
                l2: f64::NAN,
                linf: f64::NAN,
                median: f64::NAN,
                count,
            };
        }
        let squares: f64 = all.iter().map(|e| e * e).sum();
        let linf = all.iter().copied().fold(0.0, f64::max);
        let (_, median, _) = all.select_nth_unstable_by(count / 2, f64::total_cmp);
        Errors {
            l2: (squares / count as f64).sqrt(),
            linf,
            median: *median,
            count,
        }
    }
}

/// What is measured at one radius of a run.
#[derive(Clone, Debug)]
pub struct AtRadius {
    /// The radius in voxels.
    pub voxels: f64,
    /// Errors of H, G, k1, k2; none where the truth is not known.
    pub values: Option<[Errors; 4]>,
    /// Errors of the directions of k1 and k2, in degrees, without umbilics.
    pub directions: Option<[Errors; 2]>,
    /// Root mean square of the differences of H, and of G, between neighbours.
    pub roughness: [f64; 2],
    /// Root mean square of the quality of the normals; none where it was not asked for.
    pub quality: Option<f64>,
}

/// What is measured on a run.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Number of surfels.
    pub surfels: usize,
    /// Surfels that errors leave out.
    pub left_out: usize,
    /// The largest difference of the normals of neighbours.
    pub normal_jump: f64,
    /// Errors of the normals in degrees; none where the truth is not known.
    pub normals: Option<Errors>,
    /// At each radius.
    pub at: Vec<AtRadius>,
}

impl Measured {
    /// Measures the rows of a run, with the truth at each row if it is known.
    ///
    /// # Errors
    /// If there are not as many truths as rows.
    pub fn of(rows: &Rows, truth: Option<&[Option<Truth>]>) -> Result<Self> {
        let neighbours = rows.neighbours();
        if let Some(truth) = truth {
            ensure!(
                truth.len() == rows.len(),
                "found {} rows, expected {}",
                rows.len(),
                truth.len()
            );
        }
        let mut at = Vec::new();
        let mut left_out = 0;
        for (i, radius) in rows.info.radii.iter().enumerate() {
            let judged = truth.map(|truth| judge(rows, i, truth));
            if let Some(judged) = &judged {
                left_out = left_out.max(rows.len() - judged.values[0].count);
            }
            let columns = &rows.batch.curvatures[i];
            let roughness = [&columns.mean, &columns.gaussian].map(|column| {
                let difference =
                    |&[a, b]: &[u32; 2]| f64::from((column[a as usize] - column[b as usize]).abs());
                Errors::of(neighbours.iter().map(difference)).l2
            });
            at.push(AtRadius {
                voxels: radius.voxels,
                values: judged.as_ref().map(|judged| judged.values),
                directions: judged.and_then(|judged| judged.directions),
                roughness,
                quality: (!columns.quality.is_empty())
                    .then(|| Errors::of(columns.quality.iter().map(|&q| f64::from(q))).l2),
            });
        }
        let normals = truth.map(|truth| {
            Errors::of(truth.iter().enumerate().filter_map(|(row, truth)| {
                let n = DVec3::from_array((*truth)?.normal.map(f64::from));
                let u = rows.normal(row);
                is_surface(rows, 0, row).then(|| n.angle_between(u).to_degrees())
            }))
        });
        Ok(Measured {
            surfels: rows.len(),
            left_out,
            normal_jump: rows.normal_jump(&neighbours),
            normals,
            at,
        })
    }
}

/// Whether a row is of the surface rather than of a speck.
fn is_surface(rows: &Rows, radius: usize, row: usize) -> bool {
    rows.batch.curvatures[radius].flags[row] & Flag::Island.bit() == 0
}

struct Judged {
    values: [Errors; 4],
    directions: Option<[Errors; 2]>,
}

fn judge(rows: &Rows, radius: usize, truth: &[Option<Truth>]) -> Judged {
    let columns = &rows.batch.curvatures[radius];
    let known = || {
        let all = truth.iter().enumerate();
        all.filter_map(|(row, truth)| Some((row, (*truth)?)))
            .filter(|&(row, _)| is_surface(rows, radius, row))
    };
    let found = [&columns.mean, &columns.gaussian, &columns.k1, &columns.k2];
    let values = [0, 1, 2, 3].map(|i| {
        Errors::of(known().filter_map(|(row, truth)| {
            let value = found[i].get(row)?;
            Some((f64::from(*value) - truth.values[i]).abs())
        }))
    });
    let has_directions = columns.d1[0].len() == rows.len();
    let directions = has_directions.then(|| {
        let area: f64 = rows.batch.area.iter().map(|&a| f64::from(a)).sum();
        let size = (area.max(0.0) / (4.0 * std::f64::consts::PI)).sqrt();
        let found = [&columns.d1, &columns.d2];
        [0, 1].map(|i| {
            Errors::of(known().filter_map(|(row, truth)| {
                if (truth.values[3] - truth.values[2]) * size < UMBILIC {
                    return None;
                }
                let d = DVec3::from_array(truth.directions[i].map(f64::from));
                let found = vector(found[i], row);
                // Of lines: at most a right angle.
                let cosine = d.dot(found).abs();
                Some(d.cross(found).length().atan2(cosine).to_degrees())
            }))
        })
    });
    Judged { values, directions }
}

#[cfg(test)]
mod tests {
    use super::*;
    use curvox::sink::{CurvatureColumns, RadiusInfo};

    /// The surfels of one voxel at the origin, of unit edge, with trivial normals.
    fn one_voxel() -> Rows {
        let info = TableInfo {
            errors: false,
            quality: false,
            dims: [1; 3],
            spacing: [1.0; 3],
            unit: "vx".into(),
            first_index: [0; 3],
            origin: [0.0; 3],
            direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            radii: vec![RadiusInfo {
                label: "3vx".into(),
                voxels: 3.0,
                world: 3.0,
            }],
            directions: true,
            parameters: Default::default(),
            version: "0.1.0".into(),
            conventions: Vec::new(),
        };
        let mut batch = SurfelBatch {
            curvatures: vec![CurvatureColumns::default()],
            ..SurfelBatch::default()
        };
        for axis in 0..3 {
            for side in [-1_i8, 1] {
                let k = [0, 1, 2].map(|a| 1 + i32::from(a == axis) * i32::from(side));
                for a in 0..3 {
                    batch.k[a].push(k[a]);
                    batch.position[a].push((k[a] - 1) as f32 / 2.0);
                    batch.normal[a].push((k[a] - 1) as f32);
                }
                batch.side.push(side);
                batch.area.push(1.0);
                let at = &mut batch.curvatures[0];
                for column in [&mut at.mean, &mut at.gaussian, &mut at.k1, &mut at.k2] {
                    column.push(2.0);
                }
                for (d1, d2) in at.d1.iter_mut().zip(&mut at.d2) {
                    d1.push(0.0);
                    d2.push(0.0);
                }
                at.d1[(axis + 1) % 3][batch.side.len() - 1] = 1.0;
                at.d2[(axis + 2) % 3][batch.side.len() - 1] = 1.0;
                at.flags.push(0);
            }
        }
        Rows { info, batch }
    }

    #[test]
    fn a_voxel_has_twelve_pairs_of_neighbours_at_right_angles() {
        let rows = one_voxel();
        let neighbours = rows.neighbours();
        assert_eq!(neighbours.len(), 12);
        let jump = rows.normal_jump(&neighbours);
        assert!((jump - 2_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn linels_of_four_surfels_join_no_neighbours() {
        let mut rows = one_voxel();
        // Another voxel across an edge: (1, 1, 0).
        let other = one_voxel();
        rows.batch.extend_from(&other.batch, 0..6);
        for row in 6..12 {
            rows.batch.k[0][row] += 2;
            rows.batch.k[1][row] += 2;
        }
        assert_eq!(rows.neighbours().len(), 11 + 11);
    }

    #[test]
    fn errors_of_a_voxel_are_those_of_a_sphere_around_it() {
        let mut rows = one_voxel();
        let truth = truth("sphere:radius=0.5", &rows).unwrap();
        let measured = Measured::of(&rows, Some(&truth)).unwrap();
        let [mean, gaussian, k1, _] = measured.at[0].values.unwrap();
        // H = 2, G = 4, and the voxel has 2 for all.
        assert!(mean.linf < 1e-9 && k1.l2 < 1e-9);
        assert!((gaussian.l2 - 2.0).abs() < 1e-9);
        assert!(measured.normals.unwrap().linf < 1e-6);
        // All of it is an umbilic.
        assert_eq!(measured.at[0].directions.unwrap()[0].count, 0);
        assert_eq!(measured.left_out, 0);

        rows.batch.curvatures[0].flags[0] = Flag::Island.bit();
        rows.batch.curvatures[0].mean[1] = f32::NAN;
        let measured = Measured::of(&rows, Some(&truth)).unwrap();
        assert_eq!(measured.left_out, 2);
        assert!(measured.at[0].values.unwrap()[0].linf < 1e-9);
    }

    #[test]
    fn tables_share_the_surfels_of_one_place_and_side() {
        let mut rows = one_voxel();
        // In the order of tables.
        let order = [4, 2, 0, 1, 3, 5];
        let all = rows.batch.clone();
        rows.batch = SurfelBatch::with_capacity(&rows.info, 6);
        for row in order {
            rows.batch.extend_from(&all, row..row + 1);
        }
        let mut other = Rows {
            info: rows.info.clone(),
            batch: SurfelBatch::with_capacity(&rows.info, 5),
        };
        other.batch.extend_from(&rows.batch, 1..6);
        other.batch.side[2] = -other.batch.side[2];
        assert_eq!(rows.common(&other), [[1, 0], [2, 1], [4, 3], [5, 4]]);
    }

    #[test]
    fn directions_are_lines() {
        let mut rows = one_voxel();
        let truth: Vec<Option<Truth>> = (0..6)
            .map(|row| {
                let columns = &rows.batch.curvatures[0];
                Some(Truth {
                    values: [2.0, 3.0, 1.0, 3.0],
                    normal: [0, 1, 2].map(|a| rows.batch.normal[a][row]),
                    directions: [&columns.d1, &columns.d2].map(|d| [0, 1, 2].map(|a| d[a][row])),
                })
            })
            .collect();
        for column in &mut rows.batch.curvatures[0].d1 {
            column.iter_mut().for_each(|x| *x = -*x);
        }
        let measured = Measured::of(&rows, Some(&truth)).unwrap();
        let [d1, d2] = measured.at[0].directions.unwrap();
        assert!(d1.linf < 1e-6 && d2.linf < 1e-6);
        let columns = &mut rows.batch.curvatures[0];
        columns.d1 = columns.d2.clone();
        let measured = Measured::of(&rows, Some(&truth)).unwrap();
        assert!((measured.at[0].directions.unwrap()[0].median - 90.0).abs() < 1e-6);
    }

    #[test]
    fn errors_leave_out_what_is_no_number() {
        let errors = Errors::of([3.0, f64::NAN, 4.0, 0.0, f64::INFINITY].into_iter());
        assert_eq!((errors.linf, errors.median, errors.count), (4.0, 3.0, 3));
        assert!((errors.l2 - (25.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!(Errors::of(std::iter::empty()).l2.is_nan());
    }
}
