//! What a table of surfels says about itself: frame, units, conventions, parameters.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::batch::Flag;
use super::columns::column_descriptions;
use super::error::SinkError;

/// A radius of the measure balls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RadiusInfo {
    /// As the user wrote it, `3vx` or `12um`; names the columns when there are several radii.
    pub label: String,
    /// In voxels.
    pub voxels: f64,
    /// In world units.
    pub world: f64,
}

impl RadiusInfo {
    /// The ending of this radius's columns when there are several: `_3vx`, `_2_5vx`.
    #[must_use]
    pub fn suffix(&self) -> String {
        // A dot in a column name means nesting to many readers.
        let safe = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        format!("_{}", self.label.chars().map(safe).collect::<String>())
    }
}

/// All that is common to the rows of a run; written into the metadata of every file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableInfo {
    /// Voxels of the image along x, y, z.
    pub dims: [u32; 3],
    /// Edges of a voxel, in world units.
    pub spacing: [f64; 3],
    /// The world unit: `um`, `mm`, or `vx` when the image has none.
    pub unit: String,
    /// Index of voxel (0, 0, 0) in the file: not zero for a region of it, or where the file's own
    /// indices do not begin at 0.
    #[serde(default)]
    pub first_index: [i64; 3],
    /// World coordinates of the centre of voxel (0, 0, 0).
    pub origin: [f64; 3],
    /// Rows of the direction matrix: world = origin + direction * (spacing * index).
    pub direction: [[f64; 3]; 3],
    /// Radii of the measure balls, in the order of [`super::SurfelBatch::curvatures`].
    pub radii: Vec<RadiusInfo>,
    /// Whether the table has the principal directions d1, d2.
    pub directions: bool,
    /// Whether the table has the errors to expect of H and G.
    #[serde(default)]
    pub errors: bool,
    /// Whether the table has the quality of the normals, mu_Omega / mu0.
    pub quality: bool,
    /// Every parameter of the run that the rows depend on.
    pub parameters: Value,
    /// Version of curvox.
    pub version: String,
    /// Conventions in words, a sentence each.
    pub conventions: Vec<String>,
}

impl TableInfo {
    /// Checks what the columns need.
    ///
    /// # Errors
    ///
    /// If there is no radius, if one is not positive, if two radii would name the same columns, or if the image has no
    /// voxel or more than Khalimsky coordinates in 32 bits can number.
    pub fn check(&self) -> Result<(), SinkError> {
        if self.radii.is_empty() {
            return Err(SinkError::Unsupported("no measure radius was given".into()));
        }
        for (i, radius) in self.radii.iter().enumerate() {
            if self.radii[..i]
                .iter()
                .any(|other| other.suffix() == radius.suffix())
            {
                let label = &radius.label;
                return Err(SinkError::Unsupported(format!(
                    "radius {label} is given twice"
                )));
            }
        }
        if self
            .dims
            .iter()
            .any(|&d| d == 0 || d > (i32::MAX / 2) as u32)
        {
            let dims = self.dims;
            return Err(SinkError::Unsupported(format!(
                "an image of {dims:?} voxels: each dimension must lie between 1 and 2^30 - 1"
            )));
        }
        Ok(())
    }

    /// The key-value metadata of a table, sorted by key; values are text or JSON.
    #[must_use]
    pub fn metadata(&self) -> Vec<(String, String)> {
        let columns: Vec<_> = column_descriptions(self)
            .into_iter()
            .map(|(name, text)| json!({"name": name, "description": text}))
            .collect();
        let mut entries = vec![
            ("curvox.columns", json!(columns).to_string()),
            ("curvox.conventions", self.conventions.join("\n")),
            ("curvox.dims", json!(self.dims).to_string()),
            ("curvox.direction", json!(self.direction).to_string()),
            ("curvox.first_index", json!(self.first_index).to_string()),
            ("curvox.flags", flags_json()),
            ("curvox.origin", json!(self.origin).to_string()),
            ("curvox.parameters", self.parameters.to_string()),
            ("curvox.radii", json!(self.radii).to_string()),
            ("curvox.spacing", json!(self.spacing).to_string()),
            ("curvox.unit", self.unit.clone()),
            ("curvox.version", self.version.clone()),
        ];
        entries.sort_unstable();
        entries
            .into_iter()
            .map(|(key, value)| (key.to_owned(), value))
            .collect()
    }
}

/// Flag names with their bits, lowest first: `{"border":1,"several_sheets":2,…}`.
fn flags_json() -> String {
    let entries: Vec<String> = Flag::ALL
        .iter()
        .map(|flag| format!("\"{}\":{}", flag.name(), flag.bit()))
        .collect();
    format!("{{{}}}", entries.join(","))
}
