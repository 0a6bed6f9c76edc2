//! Eigenvectors of symmetric 3x3 matrices, with the same bits on every machine.
//!
//! | function | what it gives | how |
//! |---|---|---|
//! | [`eigen`] | all of any matrix | cyclic Jacobi rotations |
//! | [`eigenvector_near`] | one eigenvector, if it is well determined | Rayleigh quotient iteration |
//! | [`beside_penalty`] | the two eigenvectors across a direction that is penalised | a 2x2 problem |
//!
//! The last two take a fraction of the time and say where they do not hold; then the first is for them.
//! Only + - * / and square roots, which IEEE 754 rounds exactly.

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

/// An eigenvector found by [`eigenvector_near`].
#[derive(Clone, Copy, Debug)]
pub struct Near {
    /// Of unit length, sign arbitrary.
    pub vector: DVec3,
    /// Whether it belongs to the smallest eigenvalue.
    pub is_smallest: bool,
}

/// Steps after which [`eigenvector_near`] gives up; it takes 3 from 20 degrees off.
const MAX_STEPS: usize = 5;

/// What remains of an eigenvector's equation, relative to the trace, when it is found. Rounding alone
/// leaves a few 1e-16.
const RESIDUAL: f64 = 1e-15;

/// The product of the distances of an eigenvalue from the two others, relative to the squared trace, from
/// which on its eigenvector is well determined: both distances are then 1e-3 of the trace or more, and
/// [`RESIDUAL`] is an angle of 1e-12 at most.
const WELL_APART: f64 = 1e-3;

/// An eigenvector of a matrix with no negative eigenvalue, found from a nonzero vector near it: most often the
/// nearest one. `None` where the eigenvalue is not well apart from the others or no eigenvector is
/// found soon: then take [`eigen`].
///
/// Rayleigh quotient iteration (each step cubes the error) with the adjugate of m - l 1 instead of its inverse, which
/// it is but for a factor, and which stays bounded as l comes near an eigenvalue.
#[must_use]
pub fn eigenvector_near(m: &Symmetric, v: DVec3) -> Option<Near> {
    let trace = m.xx + m.yy + m.zz;
    if trace <= 0.0 {
        return None;
    }
    let unit = 1.0 / trace;
    let m = Symmetric::from_terms(m.terms().map(|term| term * unit));
    let Symmetric { xy, xz, yz, .. } = m;
    let mut v = v / v.length();
    for _ in 0..=MAX_STEPS {
        let image = m.times(v);
        let value = v.dot(image);
        let (a, b, c) = (m.xx - value, m.yy - value, m.zz - value);
        let (aa, bb, cc) = (b * c - yz * yz, a * c - xz * xz, a * b - xy * xy);
        if (image - value * v).length_squared() <= RESIDUAL * RESIDUAL {
            // The trace of the adjugate is the product of the distances to the other eigenvalues,
            // and the three eigenvalues add to 1.
            let apart = aa + bb + cc;
            return (apart.abs() >= WELL_APART).then_some(Near {
                vector: v,
                is_smallest: apart > 0.0 && value < 1.0 / 3.0,
            });
        }
        let adjugate = Symmetric {
            xx: aa,
            yy: bb,
            zz: cc,
            xy: xz * yz - xy * c,
            xz: xy * yz - xz * b,
            yz: xy * xz - a * yz,
        };
        let next = adjugate.times(v);
        v = next / next.length();
    }
    None
}

/// The largest term a matrix may have, relative to the penalty, for [`beside_penalty`]: its steps
/// gain a factor of the square of this, and two of them shall reach the last bits.
const SMALL_BESIDE_PENALTY: f64 = 1e-3;

/// Eigenvectors found by [`beside_penalty`].
#[derive(Clone, Copy, Debug)]
pub struct BesidePenalty {
    /// Whether the penalty is much larger than the matrix; otherwise the rest means nothing.
    pub holds: bool,
    /// Ascending.
    pub values: [f64; 2],
    /// Of unit length, signs arbitrary.
    pub vectors: [DVec3; 2],
}

/// The eigenvalues of m - p u u^T other than the one near -p, ascending, and their unit eigenvectors, for a unit
/// vector u and a penalty p much larger than m.
///
/// In a basis t of the plane across u, with the terms of m along it and along u,
///
/// ```text
///    m = | A    g |     (A + g g^T / (p + l - c)) x = l x,     d = t x + u g.x / (p + l - c)
///        | g^T  c |
/// ```
///
/// where l on the left hardly matters: two steps from l of A find it.
///
/// There are no branches and no calls, so that a loop over many matrices becomes a loop over vectors of them.
#[inline(always)]
#[must_use]
pub fn beside_penalty(m: &Symmetric, u: DVec3, p: f64) -> BesidePenalty {
    let limit = SMALL_BESIDE_PENALTY * p;
    let holds = (m.xx.abs() <= limit)
        & (m.yy.abs() <= limit)
        & (m.zz.abs() <= limit)
        & (m.xy.abs() <= limit)
        & (m.xz.abs() <= limit)
        & (m.yz.abs() <= limit);
    let [t1, t2] = across(u);
    let (m1, m2, mu) = (m.times(t1), m.times(t2), m.times(u));
    let (a, b, d) = (t1.dot(m1), t1.dot(m2), t2.dot(m2));
    let (g1, g2, c) = (t1.dot(mu), t2.dot(mu), u.dot(mu));
    let in_plane = InPlane {
        basis: [t1, t2, u],
        terms: [a, b, d],
        beside: [g1, g2],
        beyond: p - c,
    };
    let (smaller, larger) = (in_plane.eigen(-1.0), in_plane.eigen(1.0));
    BesidePenalty {
        holds,
        values: [smaller.0, larger.0],
        vectors: [smaller.1, larger.1],
    }
}

/// A matrix in a basis of two vectors across a penalty and one along it.
struct InPlane {
    basis: [DVec3; 3],
    /// A: its terms 11, 12, 22.
    terms: [f64; 3],
    /// g.
    beside: [f64; 2],
    /// p - c.
    beyond: f64,
}

impl InPlane {
    /// The smaller (`side` -1) or larger (1) of the eigenvalues, and its unit eigenvector.
    #[inline(always)]
    fn eigen(&self, side: f64) -> (f64, DVec3) {
        let [a, b, d] = self.terms;
        let [g1, g2] = self.beside;
        let (middle, _, root) = spread(a, b, d);
        let value = middle + side * root;
        let far = 1.0 / (self.beyond + value);
        let (middle, _, root) = spread(a + g1 * g1 * far, b + g1 * g2 * far, d + g2 * g2 * far);
        let value = middle + side * root;
        let far = 1.0 / (self.beyond + value);
        let across = b + g1 * g2 * far;
        let (middle, half, root) = spread(a + g1 * g1 * far, across, d + g2 * g2 * far);
        let value = middle + side * root;
        // Of the larger eigenvalue; without cancellation.
        let falls = half >= 0.0;
        let x = if falls { half + root } else { across };
        let y = if falls { across } else { root - half };
        let x = if root == 0.0 { 1.0 } else { x };
        let y = if root == 0.0 { 0.0 } else { y };
        let (x, y) = if side > 0.0 { (x, y) } else { (-y, x) };
        let along = (g1 * x + g2 * y) / (self.beyond + value);
        let [t1, t2, u] = self.basis;
        let vector = t1 * x + t2 * y + u * along;
        (value, vector / vector.length())
    }
}

/// Half the trace, half the difference, and half the distance of the eigenvalues of
/// the matrix (a b), (b d).
#[inline(always)]
fn spread(a: f64, b: f64, d: f64) -> (f64, f64, f64) {
    let half = 0.5 * (a - d);
    (0.5 * (a + d), half, (half * half + b * b).sqrt())
}

/// Two unit vectors across a unit vector and each other. Duff and others, *Building an orthonormal
/// basis, revisited* (2017).
#[inline(always)]
fn across(u: DVec3) -> [DVec3; 2] {
    let sign = 1f64.copysign(u.z);
    let a = -1.0 / (sign + u.z);
    let b = u.x * u.y * a;
    [
        DVec3::new(1.0 + sign * u.x * u.x * a, sign * b, -sign * u.x),
        DVec3::new(b, sign + u.y * u.y * a, -u.y),
    ]
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
    #[inline(always)]
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
    #[inline(always)]
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

    /// This matrix times a number.
    #[inline(always)]
    #[must_use]
    pub(crate) fn scaled(&self, x: f64) -> Self {
        Self {
            xx: self.xx * x,
            yy: self.yy * x,
            zz: self.zz * x,
            xy: self.xy * x,
            xz: self.xz * x,
            yz: self.yz * x,
        }
    }

    /// This matrix times a vector.
    #[inline(always)]
    #[must_use]
    pub fn times(&self, v: DVec3) -> DVec3 {
        DVec3::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
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

    /// Numbers from -1/2 to 1/2.
    fn numbers() -> impl FnMut() -> f64 {
        let mut number = crate::testing::numbers(1);
        move || 0.5 * number()
    }

    /// The matrix of some eigenvalues in a random frame.
    fn with_values(values: [f64; 3], mut random: impl FnMut() -> f64) -> Symmetric {
        let a = DVec3::new(random(), random(), random()).normalize();
        let [b, c] = across(a);
        let sum = |m: Symmetric, n: Symmetric| m.zip(&n, |m, n| m + n);
        [a, b, c]
            .into_iter()
            .zip(values)
            .map(|(v, value)| Symmetric::outer(v, value * v))
            .fold(Symmetric::default(), sum)
    }

    #[test]
    fn a_near_eigenvector_is_that_of_jacobi() {
        let mut random = numbers();
        let (mut found, mut tried) = (0, 0);
        for n in 0..3000 {
            let scale = [1.0, 1e9, 1e-6][n % 3];
            let values =
                [0.1 + 0.1 * random(), 0.5 + 0.2 * random(), 0.9].map(|value: f64| value * scale);
            let m = with_values(values, &mut random);
            let e = eigen(&m);
            for i in 0..3 {
                let off = DVec3::new(random(), random(), random());
                let Some(near) = eigenvector_near(&m, 17.0 * e.vectors[i] + 6.0 * off) else {
                    continue;
                };
                let which = (0..3)
                    .find(|&i| 1.0 - near.vector.dot(e.vectors[i]).abs() < 1e-14)
                    .expect("one of Jacobi's");
                assert!(near.vector.cross(e.vectors[which]).length() < 1e-12);
                assert_eq!(near.is_smallest, which == 0);
                tried += 1;
                found += usize::from(which == i);
            }
        }
        assert!(tried > 8900 && found > 8900, "{found} of {tried}");
    }

    #[test]
    fn no_near_eigenvector_where_two_eigenvalues_nearly_agree() {
        let mut random = numbers();
        for gap in [0.0, 1e-9, 1e-4] {
            for _ in 0..100 {
                let m = with_values([0.2, 0.2 + gap, 0.9], &mut random);
                let v = eigen(&m).vectors[0];
                assert!(eigenvector_near(&m, v).is_none());
            }
        }
        assert!(eigenvector_near(&Symmetric::default(), DVec3::X).is_none());
    }

    #[test]
    fn eigenvectors_beside_a_penalty_are_those_of_jacobi() {
        let mut random = numbers();
        for n in 0..3000 {
            let size = [1.0, 1e-3, 1e-9][n % 3];
            let m = Symmetric::from_terms([0; 6].map(|_| size * random()));
            let u = DVec3::new(random(), random(), random()).normalize();
            let BesidePenalty {
                holds,
                values,
                vectors,
            } = beside_penalty(&m, u, 1000.0);
            assert!(holds);
            let penalised = m.zip(&Symmetric::outer(u, u), |m, uu| m - 1000.0 * uu);
            let e = eigen(&penalised);
            assert!(values[0] <= values[1]);
            for i in 0..2 {
                assert!((values[i] - e.values[i + 1]).abs() < 2e-12);
                let residual = penalised.times(vectors[i]) - values[i] * vectors[i];
                assert!(residual.length() < 1e-12, "{residual}");
                // Across u the penalty has no part, so that nothing is lost against it.
                let residual = u.cross(m.times(vectors[i]) - values[i] * vectors[i]);
                assert!(residual.length() < 1e-14 * size, "{residual}");
                assert!((vectors[i].length() - 1.0).abs() < 1e-14);
            }
            assert!(vectors[0].dot(vectors[1]).abs() < 1e-11);
        }
    }

    #[test]
    fn beside_a_penalty_umbilics_and_planes_have_directions() {
        for u in [DVec3::X, -DVec3::Y, DVec3::Z, -DVec3::Z] {
            for value in [0.0, 0.1] {
                let m = Symmetric {
                    xx: value,
                    yy: value,
                    zz: value,
                    ..Default::default()
                };
                let found = beside_penalty(&m, u, 1000.0);
                let [d1, d2] = found.vectors;
                assert!(found.holds);
                assert_eq!(found.values, [value; 2]);
                assert_eq!([d1.length(), d2.length(), d1.dot(d2)], [1.0, 1.0, 0.0]);
                assert_eq!([d1.dot(u), d2.dot(u)], [0.0; 2]);
            }
        }
        let large = Symmetric {
            xx: 2.0,
            ..Default::default()
        };
        assert!(!beside_penalty(&large, DVec3::Z, 1000.0).holds);
        let nothing = Symmetric {
            xy: f64::NAN,
            ..Default::default()
        };
        assert!(!beside_penalty(&nothing, DVec3::Z, 1000.0).holds);
    }

    #[test]
    fn eigenvectors_are_orthonormal_and_satisfy_their_equation() {
        let mut random = numbers();
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
