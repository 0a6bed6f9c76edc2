//! Sums around each face: the part of the surface that hangs together with it within a ball.
//!
//! Comes in: a surface, measures of its cells, a radius. Goes out: [`FaceSums`] for each face.
//!
//! **Which cells, and how much of them.** DGtal's shares, as `--weights dgtal` has them on digital
//! surfaces. Let rho be the radius and d distances from the centroid of the face asked. With d of the
//! corners and the centroid of a face, its share is 1 if all are at most rho, 0 if none is below, else
//! (rho - min) / (max - min); an edge has a share in the same way by its ends and its middle; a
//! vertex counts if d <= rho. Faces are reached from the face asked through edges that join two
//! faces, by way of faces of some share; edges and vertices count once if they are on such a face. So
//! a face larger than the ball counts in part, and its far edges not at all. With a constant field the
//! measures of such a ball are 0 or those of a few cells, not those of the surface: that is marked.
//!
//! Guaranteed: cells are added in an order that depends on the face asked alone, so sums have the
//! same bits for every number of threads.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use crate::curvature::Curvature;
use crate::error::Error;

use super::interpolated::FaceMeasure;
use super::measures::MeshMeasures;
use super::surface::{EdgeKind, MeshSurface};

/// Sums around a face.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaceSums {
    /// mu0, tensor, mu2 and mu_Omega.
    pub sum: FaceMeasure,
    /// Faces in the ball do not hang together with this one within it.
    pub several_sheets: bool,
    /// The part summed is closed: all of its edges join faces of it.
    pub island: bool,
    /// The ball cuts a border of the surface.
    pub border: bool,
    /// The ball cuts an edge of more than two faces, or of two of opposite orientation.
    pub non_manifold: bool,
    /// The ball holds no vertex, and the field is constant: mu2 is 0 since it lies on vertices, and mu1
    /// is that of parts of edges at best.
    pub no_vertex: bool,
}

impl FaceSums {
    /// The curvatures at the face, whose u is given; `None` where mu0 is not positive.
    #[must_use]
    pub fn curvature(&self, u: DVec3) -> Option<Curvature> {
        let sum = &self.sum;
        Curvature::from_measures(sum.mu0, &sum.tensor, sum.mu2, sum.omega, u, 1.0)
    }
}

/// Faces between two looks at the stop flag: some milliseconds of work.
const CHUNK: usize = 256;

/// Sums within a ball of `radius` around the centroid of every face. `done` counts the faces as they are done.
///
/// # Errors
/// [`Error::Stopped`] if `stop` is set meanwhile.
pub fn ball_sums(
    surface: &MeshSurface,
    measures: &MeshMeasures,
    radius: f64,
    done: &AtomicU64,
    stop: &AtomicBool,
) -> Result<Vec<FaceSums>, Error> {
    let grid = Grid::new(surface, radius);
    let faces = surface.faces();
    // Marks of all cells are made for each piece of work, so pieces should be few.
    let pieces = 8 * rayon::current_num_threads();
    let piece = faces.div_ceil(pieces).max(CHUNK);
    let mut out = vec![FaceSums::default(); faces];
    out.par_chunks_mut(piece)
        .enumerate()
        .try_for_each(|(number, out)| {
            let mut walk = Walk::new(surface, measures, radius);
            for (chunk, out) in out.chunks_mut(CHUNK).enumerate() {
                if stop.load(Ordering::Relaxed) {
                    return Err(Error::Stopped);
                }
                let first = number * piece + chunk * CHUNK;
                for (i, out) in out.iter_mut().enumerate() {
                    *out = walk.around(first + i, &grid);
                }
                done.fetch_add(out.len() as u64, Ordering::Relaxed);
            }
            Ok(())
        })?;
    Ok(out)
}

/// DGtal's share of a cell by the distances of some of its points.
fn share(radius: f64, nearest: f64, farthest: f64) -> f64 {
    if farthest <= radius {
        1.0
    } else if radius <= nearest {
        0.0
    } else {
        (radius - nearest) / (farthest - nearest)
    }
}

struct Walk<'a> {
    surface: &'a MeshSurface,
    measures: &'a MeshMeasures,
    radius: f64,
    /// The number of the walk that looked at each face, doubled; plus one if it took it.
    face_seen: Vec<u64>,
    edge_seen: Vec<u64>,
    umbrella_seen: Vec<u64>,
    epoch: u64,
    queue: Vec<u32>,
}

impl<'a> Walk<'a> {
    fn new(surface: &'a MeshSurface, measures: &'a MeshMeasures, radius: f64) -> Self {
        Self {
            surface,
            measures,
            radius,
            face_seen: vec![0; surface.faces()],
            edge_seen: vec![0; measures.edges.len()],
            umbrella_seen: vec![0; measures.umbrellas.len()],
            epoch: 0,
            queue: Vec::new(),
        }
    }

    /// Distances from `centre` of the nearest and the farthest of the centroid and corners of a face.
    fn face_extent(&self, face: usize, centre: DVec3) -> (f64, f64) {
        let d = self.surface.centroid[face].distance(centre);
        self.surface
            .corners(face)
            .map(|c| self.surface.place(c).distance(centre))
            .fold((d, d), |(near, far), d| (near.min(d), far.max(d)))
    }

    fn edge_extent(&self, c: usize, centre: DVec3) -> (f64, f64) {
        let (p, q) = (
            self.surface.place(c),
            self.surface.place(self.surface.after(c)),
        );
        [p, q, (p + q) * 0.5]
            .map(|x| x.distance(centre))
            .into_iter()
            .fold((f64::INFINITY, 0.0), |(near, far), d| {
                (near.min(d), far.max(d))
            })
    }

    /// Looks at a face for the first time in this walk; queues it if it has a share.
    fn look(&mut self, face: usize, centre: DVec3, sums: &mut FaceSums) -> bool {
        if self.face_seen[face] >= 2 * self.epoch {
            return self.face_seen[face] > 2 * self.epoch;
        }
        let (near, far) = self.face_extent(face, centre);
        let share = share(self.radius, near, far);
        let taken = share > 0.0;
        self.face_seen[face] = 2 * self.epoch + u64::from(taken);
        if taken {
            sums.sum.add(&self.measures.faces[face], share);
            self.queue.push(face as u32);
        }
        taken
    }

    fn around(&mut self, face: usize, grid: &Grid) -> FaceSums {
        self.epoch += 1;
        self.queue.clear();
        let centre = self.surface.centroid[face];
        let mut sums = FaceSums {
            island: true,
            // All of mu2 lies on faces where umbrellas have none.
            no_vertex: !self.umbrella_seen.is_empty(),
            ..FaceSums::default()
        };
        if !self.look(face, centre, &mut sums) {
            // Its corners are all at its centroid.
            return sums;
        }
        let mut next = 0;
        while let Some(&at) = self.queue.get(next) {
            next += 1;
            for c in self.surface.corners(at as usize) {
                self.take_edge(c, centre, &mut sums);
                self.take_umbrella(c, centre, &mut sums);
                let Some(across) = self.surface.across(c) else {
                    sums.island = false;
                    if self.edge_extent(c, centre).0 < self.radius {
                        match self.surface.kind[c] {
                            EdgeKind::Border => sums.border = true,
                            _ => sums.non_manifold = true,
                        }
                    }
                    continue;
                };
                let neighbour = self.surface.face_of[across] as usize;
                sums.island &= self.look(neighbour, centre, &mut sums);
            }
        }
        let taken = 2 * self.epoch + 1;
        sums.several_sheets = grid.any_within(self.surface, centre, self.radius, |face| {
            self.face_seen[face] != taken
        });
        sums
    }

    fn take_edge(&mut self, c: usize, centre: DVec3, sums: &mut FaceSums) {
        let number = self.surface.edge_of[c] as usize;
        if self.edge_seen.is_empty() || self.edge_seen[number] == self.epoch {
            return;
        }
        self.edge_seen[number] = self.epoch;
        let (near, far) = self.edge_extent(c, centre);
        let share = share(self.radius, near, far);
        if share > 0.0 {
            let edge = &self.measures.edges[number];
            let tensor = &mut sums.sum.tensor;
            *tensor = tensor.zip(&edge.tensor, |a, b| a + share * b);
            sums.sum.omega += share * edge.omega;
        }
    }

    fn take_umbrella(&mut self, c: usize, centre: DVec3, sums: &mut FaceSums) {
        let number = self.surface.umbrella_of[c] as usize;
        if self.umbrella_seen.is_empty() || self.umbrella_seen[number] == self.epoch {
            return;
        }
        self.umbrella_seen[number] = self.epoch;
        if self.surface.place(c).distance(centre) <= self.radius {
            sums.sum.mu2 += self.measures.umbrellas[number];
            sums.no_vertex = false;
        }
    }
}

/// Faces by the cube their centroid is in; cubes have the radius for an edge.
struct Grid {
    low: DVec3,
    edge: f64,
    /// Cube as (z, y, x), and face; sorted.
    faces: Vec<([i64; 3], u32)>,
}

impl Grid {
    fn new(surface: &MeshSurface, radius: f64) -> Self {
        let low = surface
            .centroid
            .iter()
            .fold(DVec3::INFINITY, |low, &c| low.min(c));
        let mut grid = Self {
            low,
            edge: radius,
            faces: Vec::new(),
        };
        grid.faces = (0..surface.faces())
            .map(|face| (grid.cube(surface.centroid[face]), face as u32))
            .collect();
        grid.faces.par_sort_unstable();
        grid
    }

    fn cube(&self, place: DVec3) -> [i64; 3] {
        // A cast saturates; one less leaves room for the neighbours.
        let d = ((place - self.low) / self.edge).floor();
        [d.z, d.y, d.x].map(|x| (x as i64).min(i64::MAX - 1))
    }

    /// Whether a face with its centroid nearer than `radius` satisfies a condition.
    fn any_within(
        &self,
        surface: &MeshSurface,
        centre: DVec3,
        radius: f64,
        mut condition: impl FnMut(usize) -> bool,
    ) -> bool {
        let [z, y, x] = self.cube(centre);
        (z - 1..=z + 1).any(|z| {
            (y - 1..=y + 1).any(|y| {
                let from = self.faces.partition_point(|f| f.0 < [z, y, x - 1]);
                self.faces[from..]
                    .iter()
                    .take_while(|f| f.0 <= [z, y, x + 1])
                    .map(|f| f.1 as usize)
                    .any(|f| surface.centroid[f].distance(centre) < radius && condition(f))
            })
        })
    }
}
