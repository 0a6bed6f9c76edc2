//! Vectors and symmetric matrices of three dimensions, as plain arrays.

/// A vector of space.
pub type Vector = [f64; 3];

/// A symmetric 3x3 matrix: xx, yy, zz, xy, xz, yz.
pub type Symmetric = [f64; 6];

/// Row and column of each entry of a [`Symmetric`].
pub const ENTRIES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

/// Scalar product.
pub fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
pub fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// `factor * a`.
pub fn scaled(a: Vector, factor: f64) -> Vector {
    a.map(|x| x * factor)
}

/// Euclidean length.
pub fn norm(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

/// `a` with unit length; the caller knows that it is not zero.
pub fn normalised(a: Vector) -> Vector {
    scaled(a, 1.0 / norm(a))
}

/// Determinant of the matrix with rows `a`, `b`, `c`.
pub fn determinant(a: Vector, b: Vector, c: Vector) -> f64 {
    dot(a, cross(b, c))
}

/// Eigenvalues in ascending order, and their unit eigenvectors, by Jacobi rotations.
pub fn eigen(matrix: Symmetric) -> ([f64; 3], [Vector; 3]) {
    let mut a = [[0.0; 3]; 3];
    for (entry, (row, column)) in ENTRIES.into_iter().enumerate() {
        a[row][column] = matrix[entry];
        a[column][row] = matrix[entry];
    }
    // Column j of v is the eigenvector of a[j][j].
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    // Convergence is quadratic: six sweeps suffice in practice, thirty is a bound.
    for _ in 0..30 {
        if a[0][1] == 0.0 && a[0][2] == 0.0 && a[1][2] == 0.0 {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
            let cosine = 1.0 / t.hypot(1.0);
            let sine = t * cosine;
            for i in 0..3 {
                (a[i][p], a[i][q]) = (
                    cosine * a[i][p] - sine * a[i][q],
                    sine * a[i][p] + cosine * a[i][q],
                );
            }
            for i in 0..3 {
                (a[p][i], a[q][i]) = (
                    cosine * a[p][i] - sine * a[q][i],
                    sine * a[p][i] + cosine * a[q][i],
                );
                (v[i][p], v[i][q]) = (
                    cosine * v[i][p] - sine * v[i][q],
                    sine * v[i][p] + cosine * v[i][q],
                );
            }
            // The rotation was chosen to make it vanish; rounding would leave a speck.
            a[p][q] = 0.0;
            a[q][p] = 0.0;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    (
        order.map(|j| a[j][j]),
        order.map(|j| normalised([v[0][j], v[1][j], v[2][j]])),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_diagonalise_the_matrix() {
        for m in [
            [2.0, 3.0, -1.0, 0.5, -0.25, 1.0],
            [1.0, 1.0, 1.0, 0.0, 0.0, 0.0],
            [1.0, 1.0, 1.0, 1.0, 1.0, 1.0],
            [0.0; 6],
            [-4e5, 1.0, 2.0, 3.0, 1e-3, 7.0],
        ] {
            let (values, vectors) = eigen(m);
            assert!(values[0] <= values[1] && values[1] <= values[2]);
            let size = m.iter().fold(1.0f64, |s, x| s.max(x.abs()));
            for (entry, (i, j)) in ENTRIES.into_iter().enumerate() {
                let sum: f64 = (0..3)
                    .map(|e| values[e] * vectors[e][i] * vectors[e][j])
                    .sum();
                assert!((sum - m[entry]).abs() < 1e-13 * size, "{m:?}");
            }
        }
    }
}
