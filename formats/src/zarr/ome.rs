//! OME-Zarr: images as pyramids of arrays.
//!
//! In: the attributes of a group. Out: its `multiscales`, with axes, levels, scales and
//! translations. Read: versions 0.1 to 0.5, of which 0.1 and 0.2 have five axes without names
//! (t, c, z, y, x), 0.3 names without types, and none before 0.4 scales. Refused by name:
//! transformations other than scales and translations, and those kept in files of their own.

use serde_json::Value;

use crate::error::Error;
use crate::zarr::json::{Document, short};
use crate::zarr::space::Space;

/// An image at several sizes.
pub(crate) struct Multiscale {
    pub(crate) name: Option<String>,
    /// Names and units of the axes.
    axes: Vec<(String, Option<String>)>,
    pub(crate) levels: Vec<Level>,
    /// Of all levels.
    transforms: Value,
}

/// One array of the image.
pub(crate) struct Level {
    /// Key relative to the group.
    pub(crate) path: String,
    transforms: Value,
}

/// The attributes that OME-Zarr defines: all up to 0.4, those below `ome` since 0.5.
pub(crate) fn attributes(group: &Document) -> Document {
    match group.optional("ome") {
        Some(ome) if ome.is_object() => Document::new(&group.name, ome.clone()),
        _ => group.clone(),
    }
}

/// The images of a group.
pub(crate) fn multiscales(attributes: &Document) -> Result<Vec<Multiscale>, Error> {
    let Some(list) = attributes.optional("multiscales") else {
        return Ok(Vec::new());
    };
    let list = list
        .as_array()
        .ok_or_else(|| attributes.wrong("multiscales", list, "a list"))?;
    list.iter()
        .map(|value| multiscale(&Document::new(&attributes.name, value.clone())))
        .collect()
}

fn multiscale(document: &Document) -> Result<Multiscale, Error> {
    let axes = match document.optional("axes") {
        None => ["t", "c", "z", "y", "x"]
            .map(|name| (name.to_string(), None))
            .to_vec(),
        Some(list) => list
            .as_array()
            .ok_or_else(|| document.wrong("axes", list, "a list"))?
            .iter()
            .map(|axis| axis_of(document, axis))
            .collect::<Result<_, _>>()?,
    };
    for (i, (name, _)) in axes.iter().enumerate() {
        if axes[..i].iter().any(|(other, _)| other == name) {
            return Err(document.invalid(format!("there are two axes '{name}'")));
        }
    }
    let datasets = document.required("datasets")?;
    let list = datasets
        .as_array()
        .filter(|list| !list.is_empty())
        .ok_or_else(|| document.wrong("datasets", datasets, "a list of levels"))?;
    let mut levels = Vec::new();
    for value in list {
        let level = Document::new(&document.name, value.clone());
        levels.push(Level {
            path: level.text("path")?.trim_matches('/').to_string(),
            transforms: transforms(&level),
        });
    }
    let name = document.optional("name").and_then(Value::as_str);
    Ok(Multiscale {
        name: name.map(str::to_string),
        axes,
        levels,
        transforms: transforms(document),
    })
}

fn transforms(document: &Document) -> Value {
    document
        .optional("coordinateTransformations")
        .cloned()
        .unwrap_or_else(|| Value::Array(Vec::new()))
}

fn axis_of(document: &Document, axis: &Value) -> Result<(String, Option<String>), Error> {
    let name = axis.get("name").unwrap_or(axis).as_str();
    let name = name.ok_or_else(|| document.wrong("axes", axis, "an axis with a name"))?;
    // Names are free; only what kind an axis is tells time and channels apart.
    let name = match axis.get("type").and_then(Value::as_str) {
        Some("time") => "t",
        Some("channel") => "c",
        _ => name,
    };
    let unit = axis.get("unit").and_then(Value::as_str);
    Ok((name.to_string(), unit.map(str::to_string)))
}

impl Multiscale {
    /// The scale, translation and units of a level of `axes` axes.
    pub(crate) fn space(
        &self,
        document: &Document,
        level: &Level,
        axes: usize,
    ) -> Result<Space, Error> {
        if axes != self.axes.len() {
            return Err(document.invalid(format!(
                "{} axes are described, level '{}' has {axes}",
                self.axes.len(),
                level.path
            )));
        }
        let names: Vec<_> = self.axes.iter().map(|(name, _)| name.clone()).collect();
        for wanted in ["x", "y", "z"] {
            if !names.iter().any(|name| name.eq_ignore_ascii_case(wanted)) {
                return Err(document.unsupported(format!(
                    "the axes are {}: no axis is called {wanted}",
                    names.join(", ")
                )));
            }
        }
        let mut space = Space {
            axes: Some(names),
            units: self.axes.iter().map(|(_, unit)| unit.clone()).collect(),
            ..Space::new(axes)
        };
        for list in [&level.transforms, &self.transforms] {
            let list = list
                .as_array()
                .ok_or_else(|| document.wrong("coordinateTransformations", list, "a list"))?;
            for transform in list {
                apply(document, transform, &mut space)?;
            }
        }
        Ok(space)
    }

    /// The levels for print: numbers and paths.
    pub(crate) fn list_levels(&self) -> String {
        self.levels
            .iter()
            .enumerate()
            .map(|(i, level)| format!("{i} ({})", level.path))
            .collect::<Vec<_>>()
            .join(", ")
    }
}

/// Applies a transformation after those already in `space`.
fn apply(document: &Document, transform: &Value, space: &mut Space) -> Result<(), Error> {
    let axes = space.translation.len();
    let kind = transform.get("type").and_then(Value::as_str);
    let numbers = |key: &str| {
        let list = transform.get(key).and_then(Value::as_array);
        let numbers =
            list.and_then(|list| list.iter().map(Value::as_f64).collect::<Option<Vec<_>>>());
        numbers
            .filter(|numbers| numbers.len() == axes)
            .ok_or_else(|| {
                if transform.get("path").is_some() {
                    return document
                        .unsupported(format!("a {key} kept in another file is not read"));
                }
                document.invalid(format!(
                    "the transformation {} has no '{key}' of {axes} numbers",
                    short(transform)
                ))
            })
    };
    match kind {
        Some("identity") => {}
        Some("scale") => {
            let factors = numbers("scale")?;
            let scale = space.scale.get_or_insert_with(|| vec![1.0; axes]);
            for (axis, factor) in factors.iter().enumerate() {
                scale[axis] *= factor;
                space.translation[axis] *= factor;
            }
        }
        Some("translation") => {
            for (axis, shift) in numbers("translation")?.iter().enumerate() {
                space.translation[axis] += shift;
            }
        }
        _ => {
            return Err(document.unsupported(format!(
                "the coordinate transformation {} is not read; scale and translation are",
                kind.map_or_else(|| short(transform), |kind| format!("'{kind}'"))
            )));
        }
    }
    Ok(())
}
