//! Errors against the gridstep, and the exponents they follow.

use super::rows::Errors;

/// A quantity at several gridsteps, or another pair of positive numbers.
pub type Points = Vec<(f64, f64)>;

/// The exponent b of y = a x^b that fits the points best in logarithms (least squares).
///
/// None below two points, where all x are the same, or where a number is not positive.
pub fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let all: Vec<(f64, f64)> = points
        .iter()
        .map(|&(x, y)| (libm::log(x), libm::log(y)))
        .collect();
    if all.len() < 2 || all.iter().any(|(x, y)| !(x.is_finite() && y.is_finite())) {
        return None;
    }
    let count = all.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| all.iter().map(of).sum::<f64>() / count;
    let (x0, y0) = (mean(|p| p.0), mean(|p| p.1));
    let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
        all.iter().map(|&(x, y)| of(x - x0, y - y0)).sum()
    };
    let spread = sum(&|x, _| x * x);
    (spread > 0.0).then(|| sum(&|x, y| x * y) / spread)
}

/// The exponent over the last three points, which must be as many.
pub fn last_three(points: &[(f64, f64)]) -> Option<f64> {
    let from = points.len().checked_sub(3)?;
    exponent(&points[from..])
}

/// Errors of one estimator at falling gridsteps.
#[derive(Clone, Debug, Default)]
pub struct Curve {
    /// The estimator.
    pub name: String,
    /// Gridstep and errors.
    pub points: Vec<(f64, Errors)>,
}

/// A norm of errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Norm {
    /// Root mean square.
    L2,
    /// Largest.
    Linf,
}

impl Norm {
    /// Both, in the order of tables.
    pub const BOTH: [Norm; 2] = [Norm::L2, Norm::Linf];

    /// As it is written.
    pub fn name(self) -> &'static str {
        match self {
            Norm::L2 => "l2",
            Norm::Linf => "linf",
        }
    }

    /// Of errors.
    pub fn of(self, errors: &Errors) -> f64 {
        match self {
            Norm::L2 => errors.l2,
            Norm::Linf => errors.linf,
        }
    }
}

impl Curve {
    /// Gridstep and norm.
    pub fn norms(&self, norm: Norm) -> Points {
        let points = self.points.iter();
        points.map(|(h, errors)| (*h, norm.of(errors))).collect()
    }

    /// The norm at a gridstep.
    pub fn at(&self, gridstep: f64, norm: Norm) -> Option<f64> {
        let found = self.points.iter().find(|(h, _)| *h == gridstep);
        found.map(|(_, errors)| norm.of(errors))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_have_their_exponents() {
        for b in [-1.5, 0.0, 1.0 / 3.0, 2.0] {
            let points: Points = (0..5)
                .map(|i| 0.5_f64.powi(i))
                .map(|h| (h, 0.7 * h.powf(b)))
                .collect();
            assert!((exponent(&points).unwrap() - b).abs() < 1e-12);
            assert!((last_three(&points).unwrap() - b).abs() < 1e-12);
        }
    }

    #[test]
    fn last_three_do_not_see_the_first() {
        let points = [(1.0, 9.0), (0.5, 1.0), (0.25, 0.5), (0.125, 0.25)];
        assert!((last_three(&points).unwrap() - 1.0).abs() < 1e-12);
        assert!(exponent(&points).unwrap() > 1.5);
    }

    #[test]
    fn exponents_of_dgtal_are_those_of_its_table() {
        // H_CNC of Goursat, l2, h = 1 to 1/16: the slopes written beside are 0.80 and 0.76.
        let l2 = [0.03083, 0.02694, 0.01023, 0.00807, 0.00356];
        let points: Points = (0..5).map(|i| (0.5_f64.powi(i as i32), l2[i])).collect();
        assert_eq!(format!("{:.2}", exponent(&points).unwrap()), "0.80");
        assert_eq!(format!("{:.2}", last_three(&points).unwrap()), "0.76");
    }

    #[test]
    fn what_has_no_exponent_gives_none() {
        assert_eq!(exponent(&[(1.0, 1.0)]), None);
        assert_eq!(exponent(&[(1.0, 1.0), (1.0, 2.0)]), None);
        assert_eq!(exponent(&[(1.0, 1.0), (0.5, 0.0)]), None);
        assert_eq!(last_three(&[(1.0, 1.0), (0.5, 0.5)]), None);
    }
}
