//! `curvox info`: what a volume or a mesh is, or what a run left.

use std::fmt::Write;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::Args;
use curvox_formats::mesh::{Mesh, open_mesh};
use curvox_formats::{Volume, Voxels};
use serde_json::{Value, json};

use crate::sink::{Check, FACES_FILE, OutputInfo, RUN_FILE};
use crate::volume::otsu::Values;

use super::exit::{self, usage};
use super::input::InputArgs;
use super::{sizes, values};

/// Arguments of `curvox info`.
#[derive(Args, Clone, Debug)]
pub(crate) struct InfoArgs {
    #[command(flatten)]
    input: InputArgs,

    /// Read all voxels too: smallest and largest value, mean, NaN, threshold of Otsu
    #[arg(long, help_heading = "Volumes")]
    values: bool,

    /// Check the checksum of every part of an output too
    #[arg(long, help_heading = "Outputs")]
    check: bool,

    /// Print JSON
    #[arg(long, help_heading = "Messages")]
    pub(crate) json: bool,
}

/// Tells.
pub(crate) fn run(args: &InfoArgs, stop: &AtomicBool) -> Result<()> {
    let told = if !args.input.is_stdin() && is_output(&args.input.input) {
        if args.values {
            return Err(usage(
                "--values is for volumes, and this is an output of curvox",
            ));
        }
        let check = if args.check {
            Check::Checksums
        } else {
            Check::Footers
        };
        let output = OutputInfo::open(&args.input.input, check)?;
        if args.check && output.is_of_mesh() {
            return Err(usage(
                "--check is for outputs of a run; those of a mesh have no checksums",
            ));
        }
        of_output(&output)
    } else {
        if args.check {
            return Err(usage("--check is for outputs of curvox, and this is none"));
        }
        if let Some(format) = args.input.mesh_format() {
            if args.values {
                return Err(usage("--values is for volumes, and this is a mesh"));
            }
            let mesh = open_mesh(&args.input.input, Some(format))?;
            return tell(args, of_mesh(&args.input.name(), &mesh));
        }
        let volume = args.input.open()?;
        let values = if args.values {
            if !volume.source.re_readable {
                return Err(usage(format!(
                    "--values reads the input twice, which {} does not allow; save it to a file first",
                    args.input.name()
                )));
            }
            Some(values::survey(&args.input, stop)?)
        } else {
            None
        };
        of_volume(&volume, values.as_ref())
    };
    tell(args, told)
}

fn tell(args: &InfoArgs, told: Fields) -> Result<()> {
    if args.json {
        exit::print(&format!("{:#}\n", as_json(told)))
    } else {
        exit::print(&as_text(&told))
    }
}

/// Whether a path is a directory of results or a Parquet file.
fn is_output(path: &Path) -> bool {
    if path.is_dir() {
        return [RUN_FILE, FACES_FILE]
            .iter()
            .any(|name| path.join(name).exists());
    }
    let mut magic = [0; 4];
    std::fs::File::open(path)
        .and_then(|mut file| std::io::Read::read_exact(&mut file, &mut magic))
        .is_ok_and(|()| magic == *b"PAR1")
}

/// Fields in the order they are told.
type Fields = Vec<(&'static str, Value)>;

fn of_volume(volume: &Volume, values: Option<&Values>) -> Fields {
    let (header, source) = (&volume.header, &volume.source);
    let access = match (&volume.voxels, source.mapped) {
        (Voxels::Random(_), true) => "mapped",
        (Voxels::Random(_), false) => "read at offsets",
        (Voxels::Forward(_), _) => "read once, forward",
    };
    let mut told = vec![
        ("kind", json!("volume")),
        ("name", json!(source.name)),
        ("format", json!(header.format.name())),
        ("content", json!(header.content.name())),
        ("dims", json!(header.dims)),
        (
            "first_index",
            if header.first_index == [0; 3] {
                Value::Null
            } else {
                json!(header.first_index)
            },
        ),
        ("dtype", json!(header.dtype().to_string())),
        ("spacing", json!(header.spacing)),
        ("unit", json!(header.unit.to_string())),
        ("origin", json!(header.origin)),
        ("direction", json!(header.direction)),
        (
            "scaling",
            json!(header.scaling.map(|s| [s.slope, s.intercept])),
        ),
        ("compressed", json!(source.compressed)),
        ("access", json!(access)),
        ("file_bytes", json!(source.length_bytes)),
        ("voxels_bytes", json!(header.voxels_bytes())),
        ("copied_bytes", positive(source.spilled_bytes)),
        ("held_bytes", positive(source.held_bytes)),
        (
            "details",
            Value::Object(
                header
                    .details
                    .iter()
                    .map(|(name, value)| ((*name).to_owned(), json!(value)))
                    .collect(),
            ),
        ),
        ("warnings", json!(header.warnings)),
    ];
    if let Some(values) = values {
        told.extend([
            ("min", json!(values.min)),
            ("max", json!(values.max)),
            ("mean", json!(values.mean)),
            ("nan_voxels", json!(values.nan)),
            ("infinite_voxels", json!(values.infinite)),
            ("otsu_threshold", json!(values.otsu)),
        ]);
    }
    told
}

/// Nothing for 0.
fn positive(n: u64) -> Value {
    if n == 0 { Value::Null } else { json!(n) }
}

fn of_mesh(name: &str, mesh: &Mesh) -> Fields {
    let normals: Vec<&str> = [
        (mesh.corner_normals.is_some(), "corners"),
        (mesh.vertex_normals.is_some(), "vertices"),
        (mesh.face_normals.is_some(), "faces"),
    ]
    .into_iter()
    .filter_map(|(given, of)| given.then_some(of))
    .collect();
    vec![
        ("kind", json!("mesh")),
        ("name", json!(name)),
        ("format", json!(mesh.format.name())),
        ("vertices", json!(mesh.vertices.len())),
        ("faces", json!(mesh.faces())),
        (
            "normals",
            json!(if normals.is_empty() {
                "none".to_owned()
            } else {
                format!("of {}", normals.join(" and "))
            }),
        ),
        ("warnings", json!(mesh.warnings)),
        ("curvatures", json!(format!("curvox mesh {name} -o out"))),
    ]
}

/// What `curvox mesh` left.
fn of_faces(output: &OutputInfo) -> Fields {
    let text = |key: &str| output.metadata.get(key);
    let value = |key: &str| text(key).and_then(|text| serde_json::from_str::<Value>(text).ok());
    let summary = output.summary.as_ref();
    let part_of = |field: &str| summary.map_or(Value::Null, |s| s[field].clone());
    let columns = columns_of(output);
    vec![
        ("kind", json!("output of a mesh")),
        ("name", json!(output.path)),
        ("version", json!(text("curvox.version"))),
        ("rows", json!(output.rows)),
        ("bytes", json!(output.bytes)),
        ("columns", json!(columns)),
        ("radius", json!(value("curvox.radius"))),
        ("parameters", json!(value("curvox.parameters"))),
        ("input", part_of("input")),
        ("totals", part_of("totals")),
        ("warnings", part_of("warnings")),
    ]
}

fn columns_of(output: &OutputInfo) -> Vec<Value> {
    output
        .columns
        .iter()
        .map(|(name, kind)| json!({"name": name, "type": kind}))
        .collect()
}

fn of_output(output: &OutputInfo) -> Fields {
    if output.is_of_mesh() {
        return of_faces(output);
    }
    let run = output.run.as_ref();
    let table = output.table.as_ref();
    let columns = columns_of(output);
    let part_of = |field: &str| {
        output
            .summary
            .as_ref()
            .map_or(Value::Null, |s| s[field].clone())
    };
    vec![
        ("kind", json!("output")),
        ("name", json!(output.path)),
        (
            "state",
            run.map_or_else(|| json!("single file"), |run| json!(run.state)),
        ),
        ("message", json!(run.and_then(|run| run.message.clone()))),
        ("version", json!(table.map(|t| &t.version))),
        ("input", run.map_or(Value::Null, |run| run.input.clone())),
        (
            "first_index",
            json!(table.map(|t| t.first_index).filter(|n| *n != [0; 3])),
        ),
        ("dims", json!(table.map(|t| t.dims))),
        ("spacing", json!(table.map(|t| t.spacing))),
        ("unit", json!(table.map(|t| &t.unit))),
        ("rows", json!(output.rows)),
        ("bytes", json!(output.bytes)),
        ("files", json!(output.files.len())),
        ("parts_done", json!(run.map(|run| run.parts.len()))),
        ("parts_total", json!(run.map(|run| run.parts_total))),
        ("columns", json!(columns)),
        ("radii", json!(table.map(|t| &t.radii))),
        ("parameters", json!(table.map(|t| &t.parameters))),
        ("totals", part_of("exact")),
        ("warnings", part_of("warnings")),
    ]
}

/// The fields as one JSON object.
fn as_json(told: Fields) -> Value {
    Value::Object(
        told.into_iter()
            .map(|(name, value)| (name.to_owned(), value))
            .collect(),
    )
}

/// One line a field; nested fields indented, empty ones left out.
fn as_text(told: &Fields) -> String {
    let mut text = String::new();
    lines(
        told.iter().map(|(name, value)| (*name, value)),
        0,
        &mut text,
    );
    text
}

fn lines<'a>(fields: impl Iterator<Item = (&'a str, &'a Value)>, indent: usize, out: &mut String) {
    for (name, value) in fields {
        let name = name.replace('_', " ");
        let pad = " ".repeat(indent);
        // Writing to a string cannot fail.
        let _ = match value {
            Value::Null => Ok(()),
            Value::Array(items) if items.is_empty() => Ok(()),
            Value::Object(inner) => {
                let done = writeln!(out, "{pad}{name}");
                let inner: Vec<_> = inner
                    .iter()
                    .map(|(name, value)| (name.as_str(), value))
                    .collect();
                lines(inner.into_iter(), indent + 2, out);
                done
            }
            Value::Array(items) if name == "columns" => {
                let names: Vec<_> = items.iter().filter_map(|c| c["name"].as_str()).collect();
                writeln!(out, "{pad}{name:<18} {}", names.join(" "))
            }
            Value::Array(items) if name == "radii" && items.iter().all(Value::is_object) => {
                items.iter().try_for_each(|radius| {
                    let text = |field: &str| radius[field].to_string();
                    writeln!(
                        out,
                        "{pad}{:<18} {} = {} voxels = {} in the world",
                        "radius",
                        radius["label"].as_str().unwrap_or_default(),
                        text("voxels"),
                        text("world")
                    )
                })
            }
            Value::Array(items) if items.iter().all(Value::is_string) => {
                let texts = items.iter().filter_map(Value::as_str);
                texts
                    .into_iter()
                    .try_for_each(|text| writeln!(out, "{pad}{name:<18} {text}"))
            }
            Value::String(text) => writeln!(out, "{pad}{name:<18} {text}"),
            Value::Number(n) if name.ends_with("bytes") => match n.as_u64() {
                Some(bytes) => writeln!(out, "{pad}{name:<18} {} ({bytes})", sizes::show(bytes)),
                None => writeln!(out, "{pad}{name:<18} {n}"),
            },
            other => writeln!(out, "{pad}{name:<18} {other}"),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_become_lines_and_empty_ones_none() {
        let told = vec![
            ("a_b", json!(1)),
            ("c", Value::Null),
            ("d", json!([])),
            ("e", json!({"f": "g"})),
            ("warnings", json!(["one", "two"])),
        ];
        let text = as_text(&told);
        let words: Vec<Vec<&str>> = text
            .lines()
            .map(|l| l.split_whitespace().collect())
            .collect();
        assert_eq!(
            words,
            [
                vec!["a", "b", "1"],
                vec!["e"],
                vec!["f", "g"],
                vec!["warnings", "one"],
                vec!["warnings", "two"]
            ]
        );
    }
}
