//! Gauss digitisation: the voxels whose centre lies in a shape, plane by plane.
//!
//! Voxel p (a triple of integers, of either sign) is centred at `spacing * (p + offset)` in the
//! world, and is inside iff F is at most 0 there. The image holds the voxels
//!
//! ```text
//!   floor(lo / spacing) - margin  <=  p  <=  ceil(hi / spacing) + margin     on each axis
//!   '------- lowest() -------'
//! ```
//!
//! for the bounding box (lo, hi) of the shape; its array index is i = p - lowest.

use super::{ImplicitShape, ShapeError};
use glam::DVec3;

/// Voxels added around the bounding box: what DGtal adds, and the reference data of this project.
pub const REFERENCE_MARGIN: u16 = 5;

/// The longest axis: the doubled coordinate 2i + 1 of a voxel then fits 31 bits.
pub const MAX_AXIS_VOXELS: usize = 1 << 30;

/// The largest plane: 64 GiB as bytes. A gridstep mistyped by some powers of ten is then an error,
/// not an attempt to allocate.
pub const MAX_PLANE_VOXELS: usize = 1 << 36;

/// The grid on which a shape is digitised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Edges of a voxel, in world units.
    pub spacing: DVec3,
    /// Position of the grid, in voxels, from -1 to 1 on each axis. Zero puts a voxel centre at the
    /// world's origin, where symmetric shapes have symmetric digitisations; another offset is a
    /// generic position.
    pub offset: DVec3,
    /// Voxels added on each side of the shape's bounding box.
    pub margin: u16,
}

impl Grid {
    /// Cubic voxels of edge `gridstep`, offset 0, the reference margin.
    pub fn cubic(gridstep: f64) -> Self {
        Grid::boxes(DVec3::splat(gridstep))
    }

    /// Voxels of edges `spacing`, offset 0, the reference margin.
    pub fn boxes(spacing: DVec3) -> Self {
        Grid {
            spacing,
            offset: DVec3::ZERO,
            margin: REFERENCE_MARGIN,
        }
    }
}

/// A shape seen through a grid: an image computed on demand, one plane at a time.
///
/// Planes are independent: any thread may ask for any of them, in any order.
#[derive(Debug, Clone)]
pub struct Digitisation<S> {
    shape: S,
    grid: Grid,
    lowest: [i64; 3],
    dims: [usize; 3],
    /// World abscissae of the voxels of a row.
    abscissae: Vec<f64>,
}

impl<S: ImplicitShape> Digitisation<S> {
    /// The shape on this grid.
    ///
    /// # Errors
    /// If the spacing is not finite and above 0, the offset not from -1 to 1, or the image has more
    /// than [`MAX_AXIS_VOXELS`] voxels along an axis or [`MAX_PLANE_VOXELS`] in a plane.
    pub fn new(shape: S, grid: Grid) -> Result<Self, ShapeError> {
        let bounds = shape.bounding_box();
        let mut lowest = [0; 3];
        let mut dims = [0; 3];
        for (i, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
            let (h, offset) = (grid.spacing[i], grid.offset[i]);
            if !(h > 0.0 && h.is_finite()) {
                return Err(ShapeError::Spacing { axis, value: h });
            }
            if !(-1.0..=1.0).contains(&offset) {
                return Err(ShapeError::Offset {
                    axis,
                    value: offset,
                });
            }
            let lo = (bounds.lo[i] / h).floor() - f64::from(grid.margin);
            let hi = (bounds.hi[i] / h).ceil() + f64::from(grid.margin);
            let voxels = hi - lo + 1.0;
            // Also refuses infinities, and ends that a float could not tell from their neighbours.
            let limit = MAX_AXIS_VOXELS;
            if !(voxels <= limit as f64 && lo.abs().max(hi.abs()) <= 2f64.powi(52)) {
                return Err(ShapeError::TooManyVoxels {
                    axis,
                    voxels,
                    limit,
                });
            }
            // Both are whole numbers, of at most 52 and 30 bits.
            lowest[i] = lo as i64;
            dims[i] = voxels as usize;
        }
        let [nx, ny, _] = dims;
        let limit = MAX_PLANE_VOXELS;
        if nx.checked_mul(ny).is_none_or(|voxels| voxels > limit) {
            return Err(ShapeError::PlaneTooLarge { nx, ny, limit });
        }
        let mut digitisation = Digitisation {
            shape,
            grid,
            lowest,
            dims,
            abscissae: Vec::new(),
        };
        digitisation.abscissae = (0..nx).map(|x| digitisation.world(0, x)).collect();
        Ok(digitisation)
    }

    /// The shape.
    pub fn shape(&self) -> &S {
        &self.shape
    }

    /// Numbers of voxels along (x, y, z).
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// The voxel p at array index (0, 0, 0).
    pub fn lowest(&self) -> [i64; 3] {
        self.lowest
    }

    /// World position of the centre of the voxel at array index (0, 0, 0). The voxel at index i is
    /// centred at `origin + spacing * i`, up to rounding; [`Self::voxel_to_world`] is exact.
    pub fn origin(&self) -> DVec3 {
        self.voxel_to_world([0, 0, 0])
    }

    /// Edges of a voxel, in world units.
    pub fn spacing(&self) -> DVec3 {
        self.grid.spacing
    }

    /// World position of the centre of the voxel at this array index: where F is evaluated.
    pub fn voxel_to_world(&self, index: [usize; 3]) -> DVec3 {
        DVec3::new(
            self.world(0, index[0]),
            self.world(1, index[1]),
            self.world(2, index[2]),
        )
    }

    /// World position of a point in doubled coordinates of the array: voxel i is at 2i + 1, so a
    /// surfel's centroid is at its Khalimsky coordinates.
    pub fn khalimsky_to_world(&self, k: [i64; 3]) -> DVec3 {
        let world = |axis: usize| {
            // p = (k - 1)/2 + lowest, exact: halves of integers below 2^52.
            let p = 0.5 * (k[axis] - 1 + 2 * self.lowest[axis]) as f64;
            self.grid.spacing[axis] * (p + self.grid.offset[axis])
        };
        DVec3::new(world(0), world(1), world(2))
    }

    fn world(&self, axis: usize, index: usize) -> f64 {
        let p = self.lowest[axis] as f64 + index as f64;
        self.grid.spacing[axis] * (p + self.grid.offset[axis])
    }

    /// The plane at array index `z`, x fastest: 1 inside, 0 outside. `out` is overwritten.
    ///
    /// # Panics
    /// If `z` is not below `dims()[2]`.
    pub fn plane(&self, z: usize, out: &mut Vec<u8>) {
        assert!(z < self.dims[2], "plane {z} of {}", self.dims[2]);
        let mut values = vec![0.0; self.dims[0]];
        out.clear();
        out.reserve_exact(self.dims[0] * self.dims[1]);
        for y in 0..self.dims[1] {
            self.row_values(y, z, &mut values);
            out.extend(values.iter().map(|&value| u8::from(value <= 0.0)));
        }
    }

    /// F at the voxels of the plane at array index `z`, x fastest: a grey-level image whose level 0
    /// is the surface, below 0 inside. `out` is overwritten.
    ///
    /// # Panics
    /// If `z` is not below `dims()[2]`.
    pub fn plane_values(&self, z: usize, out: &mut Vec<f64>) {
        assert!(z < self.dims[2], "plane {z} of {}", self.dims[2]);
        let [nx, ny, _] = self.dims;
        out.clear();
        out.resize(nx * ny, 0.0);
        for (y, row) in out.chunks_exact_mut(nx).enumerate() {
            self.row_values(y, z, row);
        }
    }

    fn row_values(&self, y: usize, z: usize, out: &mut [f64]) {
        let (y, z) = (self.world(1, y), self.world(2, z));
        self.shape.values_along_x(&self.abscissae, y, z, out);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Goursat, NAMES, Sphere, by_name};
    use super::*;

    fn all_planes<S: ImplicitShape>(digitisation: &Digitisation<S>) -> Vec<Vec<u8>> {
        (0..digitisation.dims()[2])
            .map(|z| {
                let mut plane = Vec::new();
                digitisation.plane(z, &mut plane);
                plane
            })
            .collect()
    }

    /// Pairs of neighbours of which one is inside.
    fn surfel_count<S: ImplicitShape>(digitisation: &Digitisation<S>) -> usize {
        let nx = digitisation.dims()[0];
        let planes = all_planes(digitisation);
        let mut count = 0;
        for (z, plane) in planes.iter().enumerate() {
            for (i, &voxel) in plane.iter().enumerate() {
                let mut compare = |other: Option<&u8>| {
                    count += usize::from(other.is_some_and(|&other| other != voxel));
                };
                if (i + 1) % nx != 0 {
                    compare(plane.get(i + 1));
                }
                compare(plane.get(i + nx));
                compare(planes.get(z + 1).and_then(|next| next.get(i)));
            }
        }
        count
    }

    #[test]
    fn goursat_has_the_surfels_of_the_reference() {
        for (gridstep, dims, surfels) in [(1.0, 31, 2454), (0.5, 51, 9510), (0.25, 91, 37590)] {
            let digitisation = Digitisation::new(Goursat, Grid::cubic(gridstep)).unwrap();
            assert_eq!(digitisation.dims(), [dims; 3]);
            assert_eq!(surfel_count(&digitisation), surfels, "h = {gridstep}");
        }
    }

    #[test]
    fn voxels_exactly_on_the_surface_are_inside() {
        let digitisation = Digitisation::new(Sphere::new(5.0).unwrap(), Grid::cubic(1.0)).unwrap();
        let mut plane = Vec::new();
        digitisation.plane(10, &mut plane);
        assert_eq!(digitisation.lowest(), [-10; 3]);
        let at = |x: usize, y: usize| plane[y * 21 + x];
        // (3, 4, 0), (4, 3, 0) and (5, 0, 0) are on the sphere, (5, 1, 0) is not.
        assert_eq!(
            [at(13, 14), at(14, 13), at(15, 10), at(15, 11)],
            [1, 1, 1, 0]
        );
    }

    #[test]
    fn the_world_of_the_grid_is_reported() {
        let grid = Grid {
            spacing: DVec3::new(1.0, 0.5, 2.0),
            offset: DVec3::new(0.25, 0.0, -0.5),
            margin: 2,
        };
        let digitisation = Digitisation::new(Sphere::new(9.0).unwrap(), grid).unwrap();
        assert_eq!(digitisation.dims(), [23, 41, 15]);
        assert_eq!(digitisation.lowest(), [-11, -20, -7]);
        assert_eq!(digitisation.origin(), DVec3::new(-10.75, -10.0, -15.0));
        assert_eq!(digitisation.spacing(), grid.spacing);
        assert_eq!(
            digitisation.khalimsky_to_world([1, 3, 2]),
            DVec3::new(-10.75, -9.5, -14.0)
        );
    }

    #[test]
    fn voxels_are_the_sign_of_f_at_their_centres_for_every_shape_and_box_voxels() {
        for name in NAMES {
            let grid = Grid {
                spacing: DVec3::new(0.9, 1.3, 0.7),
                offset: DVec3::new(0.3, -0.9, 1.0),
                margin: 3,
            };
            let digitisation = Digitisation::new(by_name(name, &[]).unwrap(), grid).unwrap();
            let [nx, ny, nz] = digitisation.dims();
            let (mut plane, mut values) = (Vec::new(), Vec::new());
            let mut inside = 0;
            for z in 0..nz {
                digitisation.plane(z, &mut plane);
                digitisation.plane_values(z, &mut values);
                for y in 0..ny {
                    for x in 0..nx {
                        let value = digitisation
                            .shape()
                            .value(digitisation.voxel_to_world([x, y, z]));
                        assert_eq!(values[y * nx + x].to_bits(), value.to_bits(), "{name}");
                        assert_eq!(plane[y * nx + x], u8::from(value <= 0.0), "{name}");
                        inside += u32::from(plane[y * nx + x]);
                    }
                }
            }
            assert!(inside > 100, "{name}");
        }
    }

    #[test]
    fn bounded_shapes_do_not_touch_the_border() {
        for name in [
            "goursat",
            "sphere",
            "torus",
            "ellipsoid",
            "ellipsoid90",
            "rcube",
            "leopold",
        ] {
            let mut grid = Grid::cubic(0.7);
            grid.margin = 2;
            grid.offset = DVec3::new(1.0, -1.0, 0.5);
            let digitisation = Digitisation::new(by_name(name, &[]).unwrap(), grid).unwrap();
            let [nx, ny, nz] = digitisation.dims();
            for (z, plane) in all_planes(&digitisation).iter().enumerate() {
                for (i, &voxel) in plane.iter().enumerate() {
                    let (x, y) = (i % nx, i / nx);
                    let border = [(x, nx), (y, ny), (z, nz)]
                        .iter()
                        .any(|&(i, n)| i == 0 || i == n - 1);
                    assert!(voxel == 0 || !border, "{name} ({x}, {y}, {z})");
                }
            }
        }
    }

    #[test]
    fn grids_that_cannot_be_are_errors() {
        let new = |grid| Digitisation::new(Goursat, grid).map(|d| d.dims());
        for gridstep in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(
                new(Grid::cubic(gridstep)),
                Err(ShapeError::Spacing { .. })
            ));
        }
        for gridstep in [1e-9, 1e-300, f64::MIN_POSITIVE] {
            let error = new(Grid::cubic(gridstep));
            assert!(
                matches!(error, Err(ShapeError::TooManyVoxels { axis: 'x', .. })),
                "{error:?}"
            );
        }
        let error = new(Grid::cubic(1e-6));
        assert!(
            matches!(error, Err(ShapeError::PlaneTooLarge { .. })),
            "{error:?}"
        );
        let mut grid = Grid::cubic(1.0);
        grid.offset.y = 1.5;
        assert!(matches!(
            new(grid),
            Err(ShapeError::Offset { axis: 'y', .. })
        ));
    }
}
