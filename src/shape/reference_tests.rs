//! Goursat against the reference data, when the variable CURVOX_TEST_REFERENCE names its folder.

use super::npz::read_npz;
use super::{Digitisation, Goursat, Grid, closest_point};
use std::collections::HashSet;
use std::path::PathBuf;

#[test]
fn goursat_has_the_surfels_and_the_truth_of_the_reference() {
    let Some(folder) = std::env::var_os("CURVOX_TEST_REFERENCE").map(PathBuf::from) else {
        println!("SKIPPED: reference comparison, CURVOX_TEST_REFERENCE is not set");
        return;
    };
    for (gridstep, file) in [
        (1.0, "goursat_h1.npz"),
        (0.5, "goursat_h0.5.npz"),
        (0.25, "goursat_h0.25.npz"),
    ] {
        let columns = read_npz(&folder.join(file));
        let k = &columns["k"];
        assert_eq!(k.shape[1], 3);
        let digitisation = Digitisation::new(Goursat, Grid::cubic(gridstep)).unwrap();
        let lowest = digitisation.lowest();
        // The reference doubles voxel p, the array doubles the index p - lowest.
        let own: Vec<[i64; 3]> = k
            .values
            .chunks_exact(3)
            .map(|k| std::array::from_fn(|axis| k[axis] as i64 - 2 * lowest[axis]))
            .collect();

        let [nx, ny, nz] = digitisation.dims();
        let mut image = Vec::new();
        let mut plane = Vec::new();
        for z in 0..nz {
            digitisation.plane(z, &mut plane);
            image.extend_from_slice(&plane);
        }
        let mut surfels = HashSet::new();
        for (i, &voxel) in image.iter().enumerate() {
            let index = [i % nx, i / nx % ny, i / nx / ny];
            for (axis, stride) in [(0, 1), (1, nx), (2, nx * ny)] {
                if index[axis] + 1 < [nx, ny, nz][axis] && image[i + stride] != voxel {
                    let mut surfel = index.map(|i| 2 * i as i64 + 1);
                    surfel[axis] += 1;
                    surfels.insert(surfel);
                }
            }
        }
        assert_eq!(surfels.len(), own.len());
        assert!(own.iter().all(|surfel| surfels.contains(surfel)), "{file}");

        let (mut worst_h, mut worst_g, mut worst_residual) = (0.0_f64, 0.0_f64, 0.0_f64);
        for (i, &surfel) in own.iter().enumerate() {
            let centroid = digitisation.khalimsky_to_world(surfel);
            for axis in 0..3 {
                let expected = 0.5 * (k.values[3 * i + axis] - 1.0) * gridstep;
                assert_eq!(centroid[axis], expected);
            }
            let closest = closest_point(&Goursat, centroid).unwrap();
            worst_residual = worst_residual.max(closest.residual);
            let truth = closest.truth;
            worst_h = worst_h.max((truth.mean_curvature - columns["H_true"].values[i]).abs());
            worst_g = worst_g.max((truth.gaussian_curvature - columns["G_true"].values[i]).abs());
        }
        println!("{file}: residual {worst_residual:.1e}, H {worst_h:.1e}, G {worst_g:.1e}");
        assert!(
            worst_residual < 1e-12 && worst_h < 1e-9 && worst_g < 1e-9,
            "{file}"
        );
    }
}
