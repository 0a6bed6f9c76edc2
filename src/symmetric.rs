//! Eigenvectors of symmetric 3x3 matrices, with the same bits on every machine.
//!
//! Cyclic Jacobi rotations: only + - * / and square roots, which IEEE 754 rounds exactly.

use glam::{DMat3, DVec3};

/// Eigenvalues in ascending order and their unit eigenvectors.
#[derive(Clone, Copy, Debug)]
pub struct Eigen {
    /// Ascending.
    pub values: [f64; 3],
    /// `vectors[i]` belongs to `values[i]`; orthonormal, signs arbitrary.
    pub vectors: [DVec3; 3],
}

/// Sweeps after which Jacobi has converged to the last bit on every matrix; it takes 3 to 5.
const MAX_SWEEPS: usize = 16;

/// Eigenvectors of the symmetric matrix with rows (xx xy xz), (xy yy yz), (xz yz zz).
#[must_use]
pub fn eigen(m: &Symmetric) -> Eigen {
    let mut a = [[m.xx, m.xy, m.xz], [m.xy, m.yy, m.yz], [m.xz, m.yz, m.zz]];
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..MAX_SWEEPS {
        let size = a[0][0].abs() + a[1][1].abs() + a[2][2].abs();
        let off = a[0][1].abs() + a[0][2].abs() + a[1][2].abs();
        // Convergence is quadratic: what is left would not change the last bits of the values.
        if off <= 1e-16 * size {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q].abs() <= 1e-17 * size {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            let apq = a[p][q];
            a[p][p] -= t * apq;
            a[q][q] += t * apq;
            a[p][q] = 0.0;
            a[q][p] = 0.0;
            let r = 3 - p - q;
            let (arp, arq) = (a[r][p], a[r][q]);
            a[r][p] = c * arp - s * arq;
            a[p][r] = a[r][p];
            a[r][q] = s * arp + c * arq;
            a[q][r] = a[r][q];
            for row in &mut v {
                let (vp, vq) = (row[p], row[q]);
                row[p] = c * vp - s * vq;
                row[q] = s * vp + c * vq;
            }
        }
    }
    let mut order = [0, 1, 2];
    if a[order[1]][order[1]] < a[order[0]][order[0]] {
        order.swap(0, 1);
    }
    if a[order[2]][order[2]] < a[order[1]][order[1]] {
        order.swap(1, 2);
    }
    if a[order[1]][order[1]] < a[order[0]][order[0]] {
        order.swap(0, 1);
    }
    Eigen {
        values: order.map(|i| a[i][i]),
        vectors: order.map(|i| DVec3::new(v[0][i], v[1][i], v[2][i])),
    }
}

/// A symmetric 3x3 matrix by its six terms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[allow(missing_docs)]
pub struct Symmetric {
    pub xx: f64,
    pub yy: f64,
    pub zz: f64,
    pub xy: f64,
    pub xz: f64,
    pub yz: f64,
}

impl Symmetric {
    /// The symmetric part of `a` times the transpose of `b`.
    #[must_use]
    pub fn outer(a: DVec3, b: DVec3) -> Self {
        Self {
            xx: a.x * b.x,
            yy: a.y * b.y,
            zz: a.z * b.z,
            xy: 0.5 * (a.x * b.y + a.y * b.x),
            xz: 0.5 * (a.x * b.z + a.z * b.x),
            yz: 0.5 * (a.y * b.z + a.z * b.y),
        }
    }

    /// The terms in the order xx, yy, zz, xy, xz, yz.
    #[must_use]
    pub fn terms(&self) -> [f64; 6] {
        [self.xx, self.yy, self.zz, self.xy, self.xz, self.yz]
    }

    /// The matrix of terms in the order xx, yy, zz, xy, xz, yz.
    #[must_use]
    pub fn from_terms(t: [f64; 6]) -> Self {
        Self {
            xx: t[0],
            yy: t[1],
            zz: t[2],
            xy: t[3],
            xz: t[4],
            yz: t[5],
        }
    }

    /// Term by term `f(self, other)`.
    #[must_use]
    pub fn zip(&self, other: &Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let (a, b) = (self.terms(), other.terms());
        Self::from_terms([0, 1, 2, 3, 4, 5].map(|i| f(a[i], b[i])))
    }

    /// As a full matrix.
    #[must_use]
    pub fn to_mat3(&self) -> DMat3 {
        DMat3::from_cols_array(&[
            self.xx, self.xy, self.xz, self.xy, self.yy, self.yz, self.xz, self.yz, self.zz,
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_are_orthonormal_and_satisfy_their_equation() {
        let mut seed = 1u64;
        let mut random = || {
            seed = seed
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        for n in 0..2000 {
            let scale = if n % 3 == 0 { 1e6 } else { 1.0 };
            let m = Symmetric::from_terms([0; 6].map(|_| scale * random()));
            let e = eigen(&m);
            assert!(e.values[0] <= e.values[1] && e.values[1] <= e.values[2]);
            for i in 0..3 {
                let residual = m.to_mat3() * e.vectors[i] - e.values[i] * e.vectors[i];
                assert!(residual.length() <= 1e-14 * scale * 4.0, "{residual}");
                for j in 0..3 {
                    let expected = if i == j { 1.0 } else { 0.0 };
                    assert!((e.vectors[i].dot(e.vectors[j]) - expected).abs() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn diagonal_and_zero_matrices_keep_the_axes() {
        let e = eigen(&Symmetric {
            xx: 3.0,
            yy: 1.0,
            zz: 2.0,
            ..Default::default()
        });
        assert_eq!(e.values, [1.0, 2.0, 3.0]);
        assert_eq!(e.vectors, [DVec3::Y, DVec3::Z, DVec3::X]);
        assert_eq!(
            eigen(&Symmetric::default()).vectors,
            [DVec3::X, DVec3::Y, DVec3::Z]
        );
    }
}
