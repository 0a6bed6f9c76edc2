//! `curvox mesh`: from a mesh to curvatures of its faces.

use std::fmt::Write as _;
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Instant;

use anyhow::Result;
use clap::{Args, ValueEnum};
use curvox_formats::mesh::{Mesh, MeshFormat, open_mesh, read_mesh};
use serde_json::{Value, json};

use crate::error::Error;
use crate::measure::field::Field;
use crate::mesh::{Defects, Flip, MeshMeasures, MeshSurface, NormalField, NormalSource, ball_sums};
use crate::sink::{
    FACES_FILE, FaceTable, FaceTableInfo, MeshSummary, STDOUT, SinkError, prepare_mesh_output,
};

use super::exit::{self, BadInput, Usage, usage};
use super::method::FieldName;
use super::output::{Target, refuse_existing, target_of, where_to};
use super::progress::{self, Style};
use super::report::{flag_counts, number, place};
use super::run::refuse_input_as_output;
use super::{conventions, sizes};

/// The default radius, in mean edges: some forty triangles. Fewer, and the share of cells at the rim of
/// the ball shows in the curvatures of rough meshes; more blurs what meshes resolve.
const DEFAULT_RADIUS_EDGES: f64 = 3.0;

/// Balls of fewer mean edges hold so few cells that these show instead of the surface.
const SMALL_RADIUS_EDGES: f64 = 2.0;

/// Coordinates and sizes beyond this leave the range of numbers when they are multiplied.
const LARGEST: f64 = 1e60;

/// Arguments of `curvox mesh`.
#[derive(Args, Clone, Debug)]
pub(crate) struct MeshArgs {
    /// Mesh: .obj, .ply or .stl, perhaps compressed with gzip or zstd; - for standard input
    #[arg(value_name = "MESH")]
    input: PathBuf,

    /// Format: obj, ply, stl [default: by content, then by name]
    #[arg(long, value_name = "FORMAT", help_heading = "Input")]
    format: Option<MeshFormat>,

    /// Make vertices at exactly the same place one, as is always done for STL
    #[arg(long, help_heading = "Input")]
    merge: bool,

    /// Turn round: all, faces (the order of their corners), normals (those of the file) [default: all]
    #[arg(
        long,
        value_parser = flip_what,
        value_name = "WHAT",
        num_args = 0..=1,
        default_missing_value = "all",
        help_heading = "Input"
    )]
    flip: Option<FlipWhat>,

    /// Normals: auto (given, else vertices), given (by the file), faces (of the faces themselves), vertices
    ///
    /// vertices: means of the normals of the faces around each vertex, weighted by their angles. faces
    /// gives the normal cycle. The facet normals of STL are those of the faces, so auto takes vertices there.
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        default_value = "auto",
        value_name = "NAME",
        help_heading = "Method"
    )]
    normals: Normals,

    /// Field of normals: constant (on each face), interpolated (unit vectors), linear (not of length one)
    /// [default: interpolated where normals are those of vertices or corners, constant where they are those of faces]
    ///
    /// With constant, all curvature lies on edges and vertices, and H jumps by some percent with the radius as
    /// they enter the ball; interpolated spreads it over the faces. constant takes the mean of the corners where normals are those of vertices. interpolated and linear take
    /// the mean around vertices where normals are those of faces, and cut faces of more than three corners into
    /// triangles at their centroid, where the normal is the mean of the corners.
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "NAME",
        help_heading = "Method"
    )]
    field: Option<FieldName>,

    /// Radius of the balls the measures are summed over, in units of the mesh, or with % of the
    /// diagonal of its bounding box [default: 3 times the mean length of the edges]
    #[arg(
        long,
        value_name = "LENGTH",
        allow_hyphen_values = true,
        help_heading = "Method"
    )]
    radius: Option<Radius>,

    /// Give the principal directions too (columns d1x ... d2z)
    #[arg(long, help_heading = "Method")]
    directions: bool,

    /// Give the quality of the normals too (column quality: mu_Omega / mu0, 0 for the normals of a surface)
    #[arg(long, help_heading = "Method")]
    quality: bool,

    /// Where the results go: a directory (faces.parquet, summary.json), a file .parquet or .csv, or - for
    /// CSV on standard output
    #[arg(short, long, value_name = "OUT", help_heading = "Output")]
    output: Option<PathBuf>,

    /// Replace earlier results
    #[arg(long, help_heading = "Output")]
    overwrite: bool,

    /// Worker threads [default: one for each processor]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Resources")]
    threads: Option<u16>,

    /// No progress, no summary, no warnings on standard error
    #[arg(short, long, help_heading = "Messages")]
    quiet: bool,

    /// Progress and errors as JSON lines on standard error, the final summary as JSON on standard
    /// output (on standard error when the table goes to standard output)
    #[arg(long, help_heading = "Messages")]
    pub(crate) json: bool,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum FlipWhat {
    All,
    Faces,
    Normals,
}

/// What to turn round, as typed; the file may have been meant, since nothing need be said.
fn flip_what(text: &str) -> Result<FlipWhat, Usage> {
    FlipWhat::from_str(text, false).map_err(|_| {
        Usage(format!(
            "all, faces or normals can be turned round; if '{text}' is the mesh, name it before --flip, or write \
             --flip=all"
        ))
    })
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum Normals {
    Auto,
    Given,
    Faces,
    Vertices,
}

/// A radius as typed: `0.5`, or `2%`.
#[derive(Clone, Debug, PartialEq)]
struct Radius {
    number: f64,
    percent: bool,
    label: String,
}

impl FromStr for Radius {
    type Err = Usage;

    fn from_str(text: &str) -> Result<Self, Usage> {
        let text = text.trim();
        let digits = text.strip_suffix('%');
        let number: f64 = digits
            .unwrap_or(text)
            .trim()
            .parse()
            .ok()
            .filter(|r: &f64| *r > 0.0 && r.is_finite())
            .ok_or_else(|| {
                Usage(format!(
                    "'{text}' is not a radius; write a number in the units of the mesh (0.5), \
                     or a share of the diagonal of its bounding box (2%)"
                ))
            })?;
        Ok(Self {
            number,
            percent: digits.is_some(),
            label: text.to_owned(),
        })
    }
}

/// Examples and conventions.
pub(crate) fn long_help() -> String {
    format!(
        "Examples:\n  \
         curvox mesh bunny.ply -o out\n  \
         curvox mesh scan.obj.gz --radius 5% --directions -o faces.parquet\n  \
         curvox mesh part.stl --normals faces --radius 2.5 -o -\n  \
         curvox mesh lantern.obj --field constant --quality -o out\n\n{}\n\n{}",
        sentences()
            .iter()
            .fold("Conventions:".to_owned(), |all, s| format!("{all}\n  {s}")),
        conventions::EXIT_HELP
    )
}

/// The conventions of meshes.
fn sentences() -> Vec<String> {
    [
        "Faces are counter-clockwise seen from outside, as stored (--flip turns them round); normals point outward.",
        "A convex body has mean curvature H > 0; a sphere of radius R has H = 1/R and G = 1/R^2.",
        "H = mu1 / (2 mu0) and G = mu2 / mu0 of the ball; mu1 integrates to twice the integral of H; k1 <= k2.",
        conventions::PRINCIPAL,
        "Lengths are in the unit of the mesh, areas in its square, H, k1, k2 in its inverse, G in its inverse squared.",
        "The ball is around the centroid of a face; of the faces connected to it within the ball, each counts by \
         its share in it.",
        "With a constant field rows whose ball holds no vertex carry the flag `radius_too_small`: G is 0 there \
         by the method, and H comes from parts of edges or is 0.",
        "An edge has a measure only where exactly two faces meet in opposite directions; rows whose ball cuts \
         any other edge carry the flag `border` or `non_manifold`.",
    ]
    .map(String::from)
    .to_vec()
}

/// Runs.
pub(crate) fn run(args: &MeshArgs, verbose: bool, stop: &AtomicBool) -> Result<()> {
    let started = Instant::now();
    let Some(output) = &args.output else {
        return Err(where_to("faces.parquet, summary.json", "CSV"));
    };
    let target = target_of(output)?;
    let from_stdin = args.input == Path::new(STDOUT);
    if !from_stdin {
        // A name typed wrong is told before anything about the output, and found before a directory is made.
        fs::metadata(&args.input)
            .map_err(|e| curvox_formats::Error::io(args.name(), "cannot be opened", e))?;
    }
    refuse_input_as_output((!from_stdin).then_some(&args.input), &target)?;
    match &target {
        Target::Directory(path) => prepare_mesh_output(path, args.overwrite)?,
        Target::Parquet(path) | Target::Csv(path) => refuse_existing(path, args.overwrite)?,
        Target::Stdout | Target::Device(_) => {}
    }
    let mut mesh = if from_stdin {
        read_mesh(Box::new(io::stdin()), "standard input", args.format)?
    } else {
        open_mesh(&args.input, args.format)?
    };
    tracing::info!(
        vertices = mesh.vertices.len(),
        faces = mesh.faces(),
        format = mesh.format.name(),
        "read"
    );
    let merged = if args.merge {
        mesh.merge_equal_vertices()
    } else {
        0
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads.map_or(0, usize::from))
        .build()
        .map_err(|error| Error::Threads(error.to_string()))?;
    let result = pool.install(|| compute(args, &mesh, merged, verbose, stop))?;
    let (summary, table) = result;
    write(&target, &summary, &table)?;
    tell(args, &target, &summary, started.elapsed().as_secs_f64())
}

fn compute(
    args: &MeshArgs,
    mesh: &Mesh,
    merged: usize,
    verbose: bool,
    stop: &AtomicBool,
) -> Result<(MeshSummary, FaceTable)> {
    let flip = Flip {
        faces: matches!(args.flip, Some(FlipWhat::All | FlipWhat::Faces)),
        normals: matches!(args.flip, Some(FlipWhat::All | FlipWhat::Normals)),
    };
    let name = args.name();
    let surface = MeshSurface::new(mesh, flip);
    check_size(&surface, &name)?;
    let source = match args.normals {
        Normals::Auto => NormalSource::Auto,
        Normals::Given => NormalSource::Given,
        Normals::Faces => NormalSource::Faces,
        Normals::Vertices => NormalSource::Vertices,
    };
    let field = args
        .field
        .map_or_else(|| source.suitable_field(mesh), Field::from);
    let field = NormalField::new(mesh, &surface, source, field, flip).ok_or_else(|| {
        usage(format!(
            "{name} gives no normals; choose --normals vertices or --normals faces"
        ))
    })?;
    let (radius, label) = match &args.radius {
        None => (
            DEFAULT_RADIUS_EDGES * surface.mean_edge(),
            format!("{DEFAULT_RADIUS_EDGES} mean edges"),
        ),
        Some(r) if r.percent => (0.01 * r.number * surface.diagonal(), r.label.clone()),
        Some(r) => (r.number, r.label.clone()),
    };
    let measures = MeshMeasures::new(&surface, &field);
    let totals = measures.totals(&surface, &field);
    let style = Style::choose(args.quiet, args.json, verbose);
    let (done, faces) = (AtomicU64::new(0), surface.faces() as u64);
    let sums = progress::watched(
        |finished| progress::show_faces(style, &done, faces, finished),
        || ball_sums(&surface, &measures, radius, &done, stop),
    )?;
    let info = FaceTableInfo {
        radius_label: label.clone(),
        radius,
        directions: args.directions,
        quality: args.quality,
        parameters: args.parameters(&label, radius, &field),
        conventions: sentences(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    };
    let table = FaceTable::new(info.clone(), &surface, &field, &measures, &sums);
    let mut warnings = mesh.warnings.clone();
    warnings.extend(warnings_of(&surface, &field, totals.volume));
    warnings.extend(small_radius(radius / surface.mean_edge(), &field));
    let summary = MeshSummary {
        format: "curvox mesh summary 1",
        version: info.version,
        warnings,
        input: json!({
            "name": name,
            "format": mesh.format.name(),
            "vertices": mesh.vertices.len(),
            "faces": mesh.faces(),
            "vertices_merged": merged,
        }),
        rows: faces,
        edges: surface.edges.len() as u64,
        vertices: surface.closed_umbrella.len() as u64,
        mean_edge: surface.mean_edge(),
        diagonal: surface.diagonal(),
        defects: surface.defects,
        totals,
        radius: table.stats().clone(),
        conventions: info.conventions,
        parameters: info.parameters,
    };
    Ok((summary, table))
}

/// Refuses meshes without a face that is one, and sizes whose products are no numbers.
fn check_size(surface: &MeshSurface, name: &str) -> Result<()> {
    let bad = |what: String| Err(BadInput(format!("{name}: {what}")).into());
    if surface.faces() == 0 {
        return bad("no face has three different corners".into());
    }
    let diagonal = surface.diagonal();
    if !(1.0 / LARGEST..=LARGEST).contains(&diagonal) {
        return bad(format!(
            "the bounding box has a diagonal of {diagonal:e}; between {:e} and {LARGEST:e} was expected",
            1.0 / LARGEST
        ));
    }
    Ok(())
}

/// What the user should know about a radius, in mean edges.
fn small_radius(edges: f64, field: &NormalField) -> Option<String> {
    let what = if field.field == Field::Constant {
        "the faces show: measures of a constant field lie on edges and vertices, of which the balls hold few or \
         none, so H and G are those of the cells, not of the surface (flag `radius_too_small`: no vertex)"
    } else {
        "the faces show: rows give the curvature of a face and its neighbours, with all the noise of their normals"
    };
    (edges < SMALL_RADIUS_EDGES).then(|| {
        format!(
            "the radius is {} mean edges, and below {SMALL_RADIUS_EDGES} {what}",
            number(edges)
        )
    })
}

/// What the user should know about the mesh.
fn warnings_of(surface: &MeshSurface, field: &NormalField, volume: Option<f64>) -> Vec<String> {
    let d = &surface.defects;
    let mut warnings = Vec::new();
    let mut warn = |count: u64, one: &str, several: &str, rest: &str| {
        if count > 0 {
            let what = if count == 1 { one } else { several };
            warnings.push(format!("{} {what}{rest}", sizes::count(count)));
        }
    };
    warn(
        d.border_edges,
        "edge has one face",
        "edges have one face",
        ": the surface is open there, and rows near them are flagged `border`",
    );
    warn(
        d.non_manifold_edges,
        "edge has three faces or more",
        "edges have three faces or more",
        ": no measure lies there, and rows near are flagged `non_manifold`",
    );
    warn(
        d.inconsistent_edges,
        "edge has two faces of opposite orientation",
        "edges have two faces of opposite orientation",
        ": no measure lies there, and rows near are flagged `non_manifold`; orient the mesh first",
    );
    warn(
        d.collapsed_faces,
        "face has fewer than three different corners and is left out",
        "faces have fewer than three different corners and are left out",
        "",
    );
    warn(
        d.zero_area_faces,
        "face has no area",
        "faces have no area",
        "",
    );
    warn(
        d.duplicate_faces,
        "face has the vertices of an earlier one",
        "faces have the vertices of an earlier one",
        "",
    );
    warn(
        field.degenerate.iter().filter(|d| **d).count() as u64,
        "face lacks a normal and has its naive one",
        "faces lack a normal and have their naive one",
        ": flag `degenerate_normal`",
    );
    let opposed = (0..surface.faces())
        .filter(|&f| field.of_face[f].dot(surface.normal[f]) <= 0.0)
        .count();
    if 2 * opposed > surface.faces() {
        warnings.push(format!(
            "the normals point to the inner side of {opposed} of the {} faces: turn round either the faces \
             (--flip=faces) or the normals (--flip=normals)",
            surface.faces()
        ));
    } else {
        warn(
            opposed as u64,
            "face has normals that point to its inner side",
            "faces have normals that point to their inner side",
            ": flag `normal_opposed`",
        );
    }
    if volume.is_some_and(|v| v < 0.0) {
        warnings.push(
            "the volume inside is negative: the faces point inward, so H has the opposite sign; \
             --flip turns the mesh round"
                .into(),
        );
    }
    warnings
}

impl MeshArgs {
    fn name(&self) -> String {
        if self.input == Path::new(STDOUT) {
            "standard input".into()
        } else {
            self.input.display().to_string()
        }
    }

    /// All that the rows depend on beside the mesh.
    fn parameters(&self, label: &str, radius: f64, field: &NormalField) -> Value {
        let name = |value: Option<clap::builder::PossibleValue>| {
            value.map_or_else(String::new, |v| v.get_name().to_owned())
        };
        json!({
            "normals": name(self.normals.to_possible_value()),
            "normals_used": field.used.describe(),
            "field": name(FieldName::from(field.field).to_possible_value()),
            "radius": label,
            "radius_length": radius,
            "weights": "dgtal",
            "ball": "connected",
            "flip": self.flip.map(|flip| name(flip.to_possible_value())),
            "merge": self.merge,
            "directions": self.directions,
            "quality": self.quality,
        })
    }
}

fn write(target: &Target, summary: &MeshSummary, table: &FaceTable) -> Result<()> {
    match target {
        Target::Directory(path) => {
            table.write_parquet(&path.join(FACES_FILE))?;
            summary.write(path)?;
        }
        Target::Parquet(path) => table.write_parquet(path)?,
        Target::Csv(path) => table.write_csv_file(path)?,
        Target::Stdout => {
            let mut output = io::BufWriter::new(io::stdout().lock());
            table.write_csv(&mut output, Path::new("standard output"))?;
        }
        Target::Device(path) => {
            let file = OpenOptions::new()
                .write(true)
                .open(path)
                .map_err(|error| SinkError::io(path, "open", error))?;
            table.write_csv(&mut io::BufWriter::new(file), path)?;
        }
    }
    Ok(())
}

/// The end: a few lines, or JSON.
fn tell(args: &MeshArgs, target: &Target, summary: &MeshSummary, seconds: f64) -> Result<()> {
    if args.json {
        let line = json!({
            "event": "done",
            "output": place(target),
            "seconds": seconds,
            "summary": without_histograms(summary),
        });
        let line = format!("{line}\n");
        if *target == Target::Stdout {
            let _ = io::stderr().write_all(line.as_bytes());
        } else {
            exit::print(&line)?;
        }
    } else if !args.quiet {
        let mut text = String::new();
        // Writing to a string cannot fail; nobody may be reading what is said.
        let _ = write_text(&mut text, target, summary, seconds);
        let _ = io::stderr().write_all(text.as_bytes());
    }
    Ok(())
}

fn without_histograms(summary: &MeshSummary) -> Value {
    let mut summary = serde_json::to_value(summary).unwrap_or_default();
    for value in ["mean_curvature", "gaussian_curvature", "k1", "k2"] {
        if let Some(value) = summary["radius"][value].as_object_mut() {
            value.remove("histogram");
        }
    }
    summary
}

/// How the faces of a mesh hang together, in words.
fn kind_of(defects: &Defects) -> String {
    let kinds = [
        (defects.border_edges, "open"),
        (defects.non_manifold_edges, "not a manifold"),
        (defects.inconsistent_edges, "not consistently oriented"),
    ];
    let found: Vec<_> = kinds.into_iter().filter(|k| k.0 > 0).map(|k| k.1).collect();
    if found.is_empty() {
        "closed".into()
    } else {
        found.join(", ")
    }
}

fn write_text(
    out: &mut String,
    target: &Target,
    summary: &MeshSummary,
    seconds: f64,
) -> std::fmt::Result {
    let totals = &summary.totals;
    writeln!(out, "faces      {}", sizes::count(summary.rows))?;
    writeln!(
        out,
        "area       {} (of the faces themselves {})",
        number(totals.mu0),
        number(totals.naive_area)
    )?;
    writeln!(
        out,
        "totals     mu1 {}, mu2 {}, sum |mu_Omega| {}",
        number(totals.mu1),
        number(totals.mu2),
        number(totals.sum_abs_mu_omega)
    )?;
    writeln!(
        out,
        "Euler      V - E + F = {}, {}",
        totals.euler_counted,
        kind_of(&summary.defects)
    )?;
    let chi = totals.euler_gauss_bonnet;
    let chi = chi.map_or_else(String::new, |chi| format!(", Gauss-Bonnet gives {chi}"));
    let parameters = &summary.parameters;
    let text = |name: &str| parameters[name].as_str().unwrap_or_default();
    match text("field") {
        "constant" => writeln!(out, "lifts      sum|k| = {}{chi}", totals.sum_abs_k)?,
        "linear" => writeln!(
            out,
            "integral G {} (a linear field has no Gauss-Bonnet theorem)",
            number(totals.mu2)
        )?,
        _ => writeln!(out, "lifts      none: all measures lie on faces{chi}")?,
    }
    writeln!(
        out,
        "normals    {}; field {}",
        text("normals_used"),
        text("field")
    )?;
    let mean = |value: Option<f64>| value.map_or("none".into(), number);
    writeln!(
        out,
        "at {:<7} (radius {}) mean H {}, mean G {}",
        summary.radius.label,
        number(summary.radius.radius),
        mean(summary.radius.mean_curvature.mean),
        mean(summary.radius.gaussian_curvature.mean),
    )?;
    if let Some(quality) = summary.radius.quality_rms {
        writeln!(
            out,
            "  quality  {} (root mean square; 0 for the normals of a surface)",
            number(quality)
        )?;
    }
    flag_counts(out, &summary.radius.flags)?;
    for warning in &summary.warnings {
        writeln!(out, "warning    {warning}")?;
    }
    writeln!(out, "results    {}", place(target))?;
    writeln!(out, "time       {seconds:.2} s")
}
