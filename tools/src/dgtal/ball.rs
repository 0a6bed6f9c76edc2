//! DGtal's ball around a face, and the sums over it.

use crate::plain::algebra::{ENTRIES, Vector, eigen};

use super::cells::Cells;
use super::mesh::Mesh;

/// Curvatures in world units; k1 <= k2.
#[derive(Clone, Copy, Debug)]
pub struct Curvatures {
    /// Mean curvature.
    pub mean: f64,
    /// Gaussian curvature.
    pub gaussian: f64,
    /// The smaller principal curvature.
    pub k1: f64,
    /// The larger principal curvature.
    pub k2: f64,
    /// Unit direction of k1, up to sign.
    pub d1: Vector,
    /// Unit direction of k2, up to sign.
    pub d2: Vector,
}

/// The cells of one ball after another.
#[derive(Clone, Debug)]
pub struct Ball<'m> {
    mesh: &'m Mesh,
    radius: f64,
    round: u32,
    face_marks: Vec<u32>,
    linel_marks: Vec<u32>,
    pointel_marks: Vec<u32>,
    /// The faces of positive weight that were reached, the centre first, and their weights.
    pub faces: Vec<(u32, f64)>,
    /// Their linels of positive weight.
    pub linels: Vec<(u32, f64)>,
    /// Their pointels in the ball.
    pub pointels: Vec<u32>,
}

impl<'m> Ball<'m> {
    /// Room for balls of `radius` voxels.
    pub fn new(mesh: &'m Mesh, radius: f64) -> Self {
        Ball {
            mesh,
            radius,
            round: 0,
            face_marks: vec![0; mesh.surfels.len()],
            linel_marks: vec![0; mesh.linels.len()],
            pointel_marks: vec![0; mesh.pointels.len()],
            faces: Vec::new(),
            linels: Vec::new(),
            pointels: Vec::new(),
        }
    }

    /// Finds the cells of the ball around the centroid of face `centre`.
    pub fn gather(&mut self, centre: u32) {
        let mesh = self.mesh;
        let k = mesh.surfels[centre as usize].k;
        self.round += 1;
        self.faces.clear();
        self.linels.clear();
        self.pointels.clear();
        self.reach(k, centre);
        let mut next = 0;
        while next < self.faces.len() {
            let f = self.faces[next].0 as usize;
            next += 1;
            for linel in mesh.linels_of[f] {
                let at = &mesh.linels[linel as usize];
                if !self.is_new(linel, |ball| &mut ball.linel_marks) {
                    continue;
                }
                let weight = share(self.radius, k, &at.points());
                if weight > 0.0 {
                    self.linels.push((linel, weight));
                }
                for g in at.faces() {
                    self.reach(k, g);
                }
            }
            for pointel in mesh.corners[f] {
                if self.is_new(pointel, |ball| &mut ball.pointel_marks)
                    && distance(mesh.pointels[pointel as usize], k) <= self.radius
                {
                    self.pointels.push(pointel);
                }
            }
        }
    }

    fn reach(&mut self, centre: [i32; 3], f: u32) {
        if !self.is_new(f, |ball| &mut ball.face_marks) {
            return;
        }
        let surfel = &self.mesh.surfels[f as usize];
        let corners = self.mesh.corners[f as usize].map(|p| self.mesh.pointels[p as usize]);
        let [a, b, c, d] = corners;
        let weight = share(self.radius, centre, &[surfel.k, a, b, c, d]);
        if weight > 0.0 {
            self.faces.push((f, weight));
        }
    }

    fn is_new(&mut self, cell: u32, marks: impl Fn(&mut Self) -> &mut Vec<u32>) -> bool {
        let round = self.round;
        let mark = &mut marks(self)[cell as usize];
        std::mem::replace(mark, round) != round
    }

    /// Curvatures from the sums over the ball, whose centre has the corrected normal `u`.
    pub fn curvatures(&self, cells: &Cells, u: Vector, gridstep: f64) -> Curvatures {
        let mu0: f64 = self
            .faces
            .iter()
            .map(|&(f, weight)| weight * cells.mu0[f as usize])
            .sum();
        let mut mu1 = 0.0;
        let mut matrix = ENTRIES.map(|(i, j)| -1000.0 * mu0 * u[i] * u[j]);
        for &(linel, weight) in &self.linels {
            mu1 += weight * cells.mu1[linel as usize];
            (0..6).for_each(|e| matrix[e] += weight * cells.tensor[linel as usize][e]);
        }
        let mu2: f64 = self
            .pointels
            .iter()
            .filter_map(|&p| cells.fans[p as usize].as_ref())
            .map(|fan| fan.mu2)
            .sum();
        // The smallest eigenvalue belongs to u, where mu0 > 0.
        let ([_, smaller, larger], [_, d1, d2]) = eigen(matrix);
        Curvatures {
            mean: mu1 / (2.0 * mu0) / gridstep,
            gaussian: mu2 / mu0 / (gridstep * gridstep),
            k1: smaller / mu0 / gridstep,
            k2: larger / mu0 / gridstep,
            d1,
            d2,
        }
    }
}

/// The share of a cell by the distances of its points.
fn share(radius: f64, centre: [i32; 3], points: &[[i32; 3]]) -> f64 {
    let distances = points.iter().map(|&point| distance(point, centre));
    let nearest = distances.clone().fold(f64::INFINITY, f64::min);
    let farthest = distances.fold(0.0, f64::max);
    if farthest <= radius {
        1.0
    } else if radius <= nearest {
        0.0
    } else {
        (radius - nearest) / (farthest - nearest)
    }
}

/// In voxels, between Khalimsky coordinates.
fn distance(a: [i32; 3], b: [i32; 3]) -> f64 {
    let square: i32 = (0..3).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum();
    0.5 * f64::from(square).sqrt()
}
