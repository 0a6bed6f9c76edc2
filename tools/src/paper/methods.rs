//! Methods of estimating curvatures: which, at which radii, and what options of `curvox` they are.
//!
//! Lengths are typed in voxels (`vx`), since shapes carry no unit.

/// Methods of estimating curvatures that the figures compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Estimator {
    /// Corrected measures, normals by digital integral invariants, lumped sums.
    Ii,
    /// The same as the paper's authors compute it: `--method paper`.
    Paper,
    /// Corrected measures, normals by Voronoi covariance.
    Vcm,
    /// The same with orientation and weights of the paper's authors.
    VcmPaper,
    /// Corrected measures, normals by averaging the surface.
    Average,
    /// Trivial normals: the normal cycle.
    Trivial,
    /// The same with weights of the paper's authors.
    TrivialPaper,
    /// Plain digital integral invariants, without measures.
    PlainIi,
}

impl Estimator {
    /// A short name for tables and files.
    pub fn name(self) -> &'static str {
        match self {
            Estimator::Ii => "ii",
            Estimator::Paper => "paper ii",
            Estimator::Vcm => "vcm",
            Estimator::VcmPaper => "paper vcm",
            Estimator::Average => "average",
            Estimator::Trivial => "trivial",
            Estimator::TrivialPaper => "paper trivial",
            Estimator::PlainIi => "plain II",
        }
    }

    /// The name in a sentence.
    pub fn phrase(self) -> &'static str {
        match self {
            Estimator::Ii => "corrected measures, u = II",
            Estimator::Paper => "corrected measures, u = II, as DGtal computes them",
            Estimator::Vcm => "corrected measures, u = VCM",
            Estimator::VcmPaper => "corrected measures, u = VCM, as DGtal computes them",
            Estimator::Average => "corrected measures, u = average of the surface",
            Estimator::Trivial => "normal cycle (u = n)",
            Estimator::TrivialPaper => "normal cycle, as DGtal computes it",
            Estimator::PlainIi => "plain integral invariants",
        }
    }

    fn has_trivial_normals(self) -> bool {
        matches!(
            self,
            Estimator::Trivial | Estimator::TrivialPaper | Estimator::PlainIi
        )
    }

    fn options(self) -> &'static [&'static str] {
        match self {
            Estimator::Ii => &["--normals", "ii"],
            Estimator::Paper => &["--method", "paper"],
            Estimator::Vcm => &["--normals", "vcm"],
            Estimator::VcmPaper => &["--method", "paper", "--normals", "vcm"],
            Estimator::Average => &["--normals", "average", "--weights", "lumped"],
            Estimator::Trivial => &["--normals", "trivial"],
            Estimator::TrivialPaper => &["--method", "paper", "--normals", "trivial"],
            // It needs no normals; trivial ones take no time.
            Estimator::PlainIi => &["--curvature", "ii", "--normals", "trivial"],
        }
    }
}

/// How normals go on between surfels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Field {
    /// Constant on each surfel.
    Constant,
    /// Between pointels, of unit length.
    Interpolated,
    /// Between pointels, not of unit length.
    Linear,
}

impl Field {
    /// All, the default first.
    pub const ALL: [Field; 3] = [Field::Constant, Field::Interpolated, Field::Linear];

    /// As `curvox` calls it.
    pub fn name(self) -> &'static str {
        match self {
            Field::Constant => "constant",
            Field::Interpolated => "interpolated",
            Field::Linear => "linear",
        }
    }
}

/// An estimator with its radii, in voxels.
#[derive(Clone, Debug, PartialEq)]
pub struct Method {
    /// How.
    pub estimator: Estimator,
    /// Radius r of the normals; none where there are none to estimate.
    pub normal_radius: Option<f64>,
    /// Radii rho of the measures, or r' of plain integral invariants.
    pub radii: Vec<f64>,
    /// Normals between surfels, with the quality of the field; none is curvox's default without it.
    pub field: Option<Field>,
}

/// `constant` h^`exponent` in voxels of edge h.
fn in_voxels(constant: f64, exponent: f64, gridstep: f64) -> f64 {
    // A square root is exact where it can be, so that 3 h^(1/2) is 6 voxels at h = 1/4.
    if exponent == 0.5 {
        constant / gridstep.sqrt()
    } else {
        constant * libm::pow(gridstep, exponent - 1.0)
    }
}

impl Method {
    /// Corrected measures with r = k h^`exponent` and rho = m h^`exponent` for each m.
    pub fn corrected(
        estimator: Estimator,
        gridstep: f64,
        exponent: f64,
        normals: f64,
        measures: &[f64],
    ) -> Self {
        let voxels = |constant| in_voxels(constant, exponent, gridstep);
        Method {
            estimator,
            normal_radius: (!estimator.has_trivial_normals()).then(|| voxels(normals)),
            radii: measures.iter().map(|&m| voxels(m)).collect(),
            field: None,
        }
    }

    /// The radii of section 6.1: r = rho = 3 h^(1/2).
    pub fn of_paper(estimator: Estimator, gridstep: f64) -> Self {
        Self::corrected(estimator, gridstep, 0.5, 3.0, &[3.0])
    }

    /// Plain integral invariants with r' = k' h^`exponent` for each k'.
    pub fn plain(gridstep: f64, exponent: f64, constants: &[f64]) -> Self {
        Method {
            estimator: Estimator::PlainIi,
            normal_radius: None,
            radii: constants
                .iter()
                .map(|&k| in_voxels(k, exponent, gridstep))
                .collect(),
            field: None,
        }
    }

    /// The same with a field, and its quality.
    #[must_use]
    pub fn with(self, field: Field) -> Self {
        Method {
            field: Some(field),
            ..self
        }
    }

    /// The options of `curvox run`.
    pub fn options(&self) -> Vec<String> {
        let mut options: Vec<String> = Vec::new();
        options.extend(self.estimator.options().iter().map(ToString::to_string));
        if let Some(radius) = self.normal_radius {
            options.extend(["--normal-radius".into(), format!("{radius}vx")]);
        }
        let radii: Vec<_> = self.radii.iter().map(|r| format!("{r}vx")).collect();
        options.extend(["--radius".into(), radii.join(",")]);
        // They would double the tables of many radii, where nobody asks for them.
        if self.estimator != Estimator::PlainIi && self.radii.len() == 1 {
            options.push("--directions".into());
        }
        if let Some(field) = self.field {
            options.extend(["--quality", "--field", field.name()].map(String::from));
        }
        options
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radii_are_those_of_the_paper() {
        let method = Method::of_paper(Estimator::Ii, 0.25);
        assert_eq!(method.normal_radius, Some(6.0));
        assert_eq!(method.radii, [6.0]);
        // 6 (1/8)^(1/3) = 3 units are 24 voxels.
        let plain = Method::plain(0.125, 1.0 / 3.0, &[6.0]);
        assert!((plain.radii[0] - 24.0).abs() < 1e-12);
        let trivial = Method::of_paper(Estimator::Trivial, 1.0);
        assert!(!trivial.options().contains(&"--normal-radius".to_owned()));
    }
}
