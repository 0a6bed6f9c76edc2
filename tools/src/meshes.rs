//! Polyhedra whose vertices lie on surfaces of known curvature, with the normals of those surfaces.
//!
//! Goes out: [`Polyhedron`]; faces are counter-clockwise seen from outside. The Schwarz lantern is that of
//! Lachaud, Romon, Thibert, *Corrected curvature measures*, section 3.3: its vertices lie on a
//! cylinder, its area grows without bound with m / n^2, its normals do not converge.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};
use glam::DVec3;

/// Vertices, faces, and the normals of the smooth surface.
#[derive(Clone, Debug)]
pub struct Polyhedron {
    /// Positions.
    pub vertices: Vec<DVec3>,
    /// Corners of each face, counter-clockwise seen from outside.
    pub faces: Vec<Vec<u32>>,
    /// The smooth surface's unit normal at each vertex.
    pub normals: Vec<DVec3>,
    /// For a lantern, the cylinder's unit normal above the middle of each face's horizontal edge.
    pub face_normals: Option<Vec<DVec3>>,
}

impl Polyhedron {
    /// As an OBJ file, with the normals of vertices, or those of faces where there are such and they are wanted.
    #[must_use]
    pub fn to_obj(&self, face_normals: bool) -> String {
        let mut out = String::new();
        let of_faces = self.face_normals.as_ref().filter(|_| face_normals);
        let mut lines = |keyword: &str, list: &[DVec3]| {
            for v in list {
                // Writing to a string cannot fail.
                let _ = writeln!(out, "{keyword} {} {} {}", v.x, v.y, v.z);
            }
        };
        lines("v", &self.vertices);
        lines("vn", of_faces.unwrap_or(&self.normals));
        for (f, face) in self.faces.iter().enumerate() {
            out.push('f');
            for &v in face {
                let normal = if of_faces.is_some() { f } else { v as usize };
                let _ = write!(out, " {}//{}", v + 1, normal + 1);
            }
            out.push('\n');
        }
        out
    }
}

/// Schwarz's lantern: m bands of 2 n triangles on a cylinder around z of a radius and a height. Each circle
/// of vertices is turned by pi / n against the one below.
///
/// # Panics
/// If n is below 3 or m is 0.
#[must_use]
pub fn lantern(m: u32, n: u32, radius: f64, height: f64) -> Polyhedron {
    assert!(n > 2 && m > 0);
    let direction = |half_steps: u32| {
        // Whole turns off first, so that the lantern closes to the last bit.
        let angle = PI * f64::from(half_steps % (2 * n)) / f64::from(n);
        DVec3::new(angle.cos(), angle.sin(), 0.0)
    };
    let (mut vertices, mut normals) = (Vec::new(), Vec::new());
    for band in 0..=m {
        let z = height * f64::from(band) / f64::from(m);
        for i in 0..n {
            let u = direction(2 * i + band % 2);
            normals.push(u);
            vertices.push(u * radius + DVec3::Z * z);
        }
    }
    let (mut faces, mut face_normals) = (Vec::new(), Vec::new());
    for band in 0..m {
        // The lower circle stands on even half steps where the band is even.
        let turn = band % 2;
        let lower = |i: u32| band * n + i % n;
        let upper = |i: u32| (band + 1) * n + i % n;
        for i in 0..n {
            // Half steps 2 i + turn and 2 i + turn + 2 below, 2 i + turn + 1 above.
            faces.push(vec![lower(i), lower(i + 1), upper(i + turn)]);
            face_normals.push(direction(2 * i + turn + 1));
            // 2 i + turn + 1 and + 3 above, 2 i + turn + 2 below.
            faces.push(vec![lower(i + 1), upper(i + 1 + turn), upper(i + turn)]);
            face_normals.push(direction(2 * i + turn + 2));
        }
    }
    Polyhedron {
        vertices,
        faces,
        normals,
        face_normals: Some(face_normals),
    }
}

/// An icosahedron whose triangles were cut into four `levels` times, on a sphere.
#[must_use]
pub fn icosphere(levels: u32, radius: f64) -> Polyhedron {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let mut normals: Vec<DVec3> = Vec::new();
    for (a, b) in [
        (1.0, golden),
        (-1.0, golden),
        (1.0, -golden),
        (-1.0, -golden),
    ] {
        normals.push(DVec3::new(a, b, 0.0).normalize());
        normals.push(DVec3::new(0.0, a, b).normalize());
        normals.push(DVec3::new(b, 0.0, a).normalize());
    }
    // The faces are the triples of mutually nearest vertices.
    let near = |i: usize, j: usize| normals[i].dot(normals[j]) > 0.4;
    let mut faces = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                if near(i, j) && near(j, k) && near(i, k) {
                    let outward = normals[i].dot(normals[j].cross(normals[k])) > 0.0;
                    let [j, k] = if outward { [j, k] } else { [k, j] };
                    faces.push(vec![i as u32, j as u32, k as u32]);
                }
            }
        }
    }
    for _ in 0..levels {
        let mut middles = std::collections::BTreeMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                normals.push((normals[a as usize] + normals[b as usize]).normalize());
                normals.len() as u32 - 1
            })
        };
        let mut finer = Vec::with_capacity(4 * faces.len());
        for face in &faces {
            let (a, b, c) = (face[0], face[1], face[2]);
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([
                vec![a, ab, ca],
                vec![b, bc, ab],
                vec![c, ca, bc],
                vec![ab, bc, ca],
            ]);
        }
        faces = finer;
    }
    Polyhedron {
        vertices: normals.iter().map(|u| *u * radius).collect(),
        faces,
        normals,
        face_normals: None,
    }
}

/// A torus around z of quadrangles: `around` times `across` of them.
///
/// # Panics
/// If a count is below 3.
#[must_use]
pub fn torus(major: f64, minor: f64, around: u32, across: u32) -> Polyhedron {
    assert!(around > 2 && across > 2);
    let (mut vertices, mut normals, mut faces) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..around {
        let (sin, cos) = (TAU * f64::from(i) / f64::from(around)).sin_cos();
        let out = DVec3::new(cos, sin, 0.0);
        for j in 0..across {
            let (sin, cos) = (TAU * f64::from(j) / f64::from(across)).sin_cos();
            let u = out * cos + DVec3::Z * sin;
            normals.push(u);
            vertices.push(out * major + u * minor);
            let at = |i: u32, j: u32| i % around * across + j % across;
            faces.push(vec![at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    Polyhedron {
        vertices,
        faces,
        normals,
        face_normals: None,
    }
}

/// A sphere of quadrangles between circles of latitude, with triangles at its poles.
///
/// # Panics
/// If a count is below 3.
#[must_use]
pub fn globe(radius: f64, around: u32, bands: u32) -> Polyhedron {
    assert!(around > 2 && bands > 2);
    let (mut normals, mut faces) = (vec![-DVec3::Z], Vec::new());
    for band in 1..bands {
        let (height, width) = (PI * (f64::from(band) / f64::from(bands) - 0.5)).sin_cos();
        for i in 0..around {
            let (sin, cos) = (TAU * f64::from(i) / f64::from(around)).sin_cos();
            normals.push(DVec3::new(width * cos, width * sin, height));
        }
    }
    normals.push(DVec3::Z);
    let top = normals.len() as u32 - 1;
    let at = |band: u32, i: u32| 1 + (band - 1) * around + i % around;
    for i in 0..around {
        faces.push(vec![0, at(1, i + 1), at(1, i)]);
        for band in 1..bands - 1 {
            faces.push(vec![
                at(band, i),
                at(band, i + 1),
                at(band + 1, i + 1),
                at(band + 1, i),
            ]);
        }
        faces.push(vec![at(bands - 1, i), at(bands - 1, i + 1), top]);
    }
    Polyhedron {
        vertices: normals.iter().map(|u| *u * radius).collect(),
        faces,
        normals,
        face_normals: None,
    }
}

/// The subcommands that write polyhedra, with their normals, as OBJ files.
#[derive(Subcommand, Clone, Debug)]
pub enum MeshCommand {
    /// Write Schwarz's lantern: m bands of 2 n triangles with their vertices on a cylinder around z
    Lantern {
        /// Bands
        #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000))]
        m: u32,
        /// Vertices of a circle
        #[arg(long, value_parser = clap::value_parser!(u32).range(3..=10_000))]
        n: u32,
        /// Radius of the cylinder
        #[arg(long, default_value_t = 1.0, value_parser = length, allow_hyphen_values = true)]
        radius: f64,
        /// Height of the cylinder
        #[arg(long, default_value_t = 1.0, value_parser = length, allow_hyphen_values = true)]
        height: f64,
        /// Give the cylinder's normals at the middles of the horizontal edges to faces, in place of
        /// those at vertices
        #[arg(long)]
        face_normals: bool,
        /// Where to write.
        #[command(flatten)]
        output: Output,
    },
    /// Write an icosahedron cut finer, on a sphere
    Icosphere {
        /// How often each triangle was cut into four
        #[arg(long, value_parser = clap::value_parser!(u32).range(0..=9))]
        levels: u32,
        /// Radius of the sphere
        #[arg(long, default_value_t = 1.0, value_parser = length, allow_hyphen_values = true)]
        radius: f64,
        /// Where to write.
        #[command(flatten)]
        output: Output,
    },
    /// Write a torus of quadrangles
    Torus {
        /// Radius of the circle in the middle of the tube
        #[arg(long, default_value_t = 2.0, value_parser = length, allow_hyphen_values = true)]
        major: f64,
        /// Radius of the tube, smaller than that of the circle
        #[arg(long, default_value_t = 1.0, value_parser = length, allow_hyphen_values = true)]
        minor: f64,
        /// Quadrangles around the axis
        #[arg(long, value_parser = clap::value_parser!(u32).range(3..=10_000))]
        around: u32,
        /// Quadrangles around the tube
        #[arg(long, value_parser = clap::value_parser!(u32).range(3..=10_000))]
        across: u32,
        /// Where to write.
        #[command(flatten)]
        output: Output,
    },
}

/// Where to write.
#[derive(Args, Clone, Debug)]
pub struct Output {
    /// The OBJ file to write
    #[arg(short, long, value_name = "FILE.obj")]
    output: PathBuf,
    /// Replace a file that is there
    #[arg(long)]
    overwrite: bool,
}

impl Output {
    fn write(&self, text: &str) -> Result<()> {
        let path = &self.output;
        let is_obj = path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("obj"));
        ensure!(
            is_obj,
            "{}: the name of an OBJ file ends in .obj",
            path.display()
        );
        let mut options = OpenOptions::new();
        options.write(true);
        if self.overwrite {
            options.create(true).truncate(true);
        } else {
            options.create_new(true);
        }
        options
            .open(path)
            .and_then(|mut file| file.write_all(text.as_bytes()))
            .with_context(|| match path.exists() && !self.overwrite {
                true => format!("{} (--overwrite replaces it)", path.display()),
                false => path.display().to_string(),
            })
    }
}

/// A length of a shape.
fn length(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|length: &f64| *length > 0.0 && length.is_finite())
        .ok_or_else(|| format!("'{text}' is not a length above 0"))
}

impl MeshCommand {
    /// Writes the file.
    ///
    /// # Errors
    /// If the radii make no torus, the name does not end in .obj, or the file is there or cannot be written.
    pub fn run(self) -> Result<()> {
        let (mesh, face_normals, output) = match self {
            Self::Lantern {
                m,
                n,
                radius,
                height,
                face_normals,
                output,
            } => (lantern(m, n, radius, height), face_normals, output),
            Self::Icosphere {
                levels,
                radius,
                output,
            } => (icosphere(levels, radius), false, output),
            Self::Torus {
                major,
                minor,
                around,
                across,
                output,
            } => {
                ensure!(
                    minor < major,
                    "--minor {minor} is not below --major {major}: the torus would cut itself"
                );
                (torus(major, minor, around, across), false, output)
            }
        };
        output.write(&mesh.to_obj(face_normals))
    }
}
