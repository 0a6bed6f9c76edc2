//! Meshes: every form of OBJ, PLY and STL, and damage to them.

use std::io::Cursor;

use curvox_formats::mesh::{Mesh, MeshFormat, read_mesh, recognise_mesh};
use curvox_formats::{Error, ErrorKind};
use proptest::prelude::*;

use crate::support::{gzip, peak_bytes, zstd};

fn read_as(bytes: &[u8], name: &str, format: Option<MeshFormat>) -> Result<Mesh, Error> {
    read_mesh(Box::new(Cursor::new(bytes.to_vec())), name, format)
}

fn read(bytes: &[u8]) -> Result<Mesh, Error> {
    read_as(bytes, "mesh", None)
}

#[track_caller]
fn error(bytes: &[u8], name: &str, words: &[&str]) {
    let error = read_as(bytes, name, None).unwrap_err();
    let text = error.to_string();
    for word in words {
        assert!(text.contains(word), "'{text}' does not say '{word}'");
    }
}

/// A tetrahedron.
const PLACES: [[f64; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [1.5, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.25, 1.0],
];
const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

fn tetrahedron() -> Mesh {
    Mesh::from_faces(PLACES.to_vec(), &FACES)
}

fn faces_of(mesh: &Mesh) -> Vec<Vec<u32>> {
    (0..mesh.faces())
        .map(|f| mesh.corners[mesh.face(f)].to_vec())
        .collect()
}

fn obj() -> String {
    let mut out = String::from("# a tetrahedron\nmtllib a.mtl\no thing\n");
    for p in PLACES {
        out += &format!("v {} {} {}\n", p[0], p[1], p[2]);
    }
    for f in FACES {
        out += &format!("f {} {} {}\n", f[0] + 1, f[1] + 1, f[2] + 1);
    }
    out
}

fn ascii_ply() -> String {
    let mut out = String::from(
        "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\n\
         property float y\nproperty float z\nelement face 4\nproperty list uchar int vertex_indices\n\
         end_header\n",
    );
    for p in PLACES {
        out += &format!("{} {} {}\n", p[0], p[1], p[2]);
    }
    for f in FACES {
        out += &format!("3 {} {} {}\n", f[0], f[1], f[2]);
    }
    out
}

/// Properties in a strange order, of strange types, with others between; faces before vertices.
fn binary_ply(big: bool) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut out = format!(
        "ply\r\nformat binary_{order}_endian 1.0\nobj_info x\nelement face 4\nproperty float nx\n\
         property list ushort double weights\nproperty list char uint16 vertex_index\n\
         property float32 ny\nproperty double nz\nelement edge 1\nproperty int8 a\n\
         element vertex 4\nproperty double z\nproperty uchar red\nproperty float quality\n\
         property float64 x\nproperty short y4\nproperty float y\nend_header\n"
    )
    .into_bytes();
    let mut put = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        if big {
            bytes.reverse();
        }
        out.extend(bytes);
    };
    for (i, f) in FACES.iter().enumerate() {
        put(&(i as f32).to_le_bytes());
        put(&(i as u16).to_le_bytes());
        (0..i).for_each(|_| put(&0.5f64.to_le_bytes()));
        put(&[3]);
        f.iter().for_each(|&v| put(&(v as u16).to_le_bytes()));
        put(&1f32.to_le_bytes());
        put(&2f64.to_le_bytes());
    }
    put(&[7]);
    for p in PLACES {
        put(&p[2].to_le_bytes());
        put(&[200]);
        put(&f32::NAN.to_le_bytes());
        put(&p[0].to_le_bytes());
        put(&[1, 2]);
        put(&(p[1] as f32).to_le_bytes());
    }
    out
}

fn triangles() -> impl Iterator<Item = [[f64; 3]; 3]> {
    FACES.iter().map(|f| f.map(|v| PLACES[v as usize]))
}

fn ascii_stl() -> String {
    let mut out = String::from("solid a thing with a name\n");
    for t in triangles() {
        out += "  facet normal 0 0 1e0\n    outer loop\n";
        for p in t {
            out += &format!("      vertex {} {} {}\n", p[0], p[1], p[2]);
        }
        out += "    endloop\n  endfacet\n";
    }
    out + "endsolid a thing with a name\n"
}

fn binary_stl(header: &[u8]) -> Vec<u8> {
    let mut out = header.to_vec();
    out.resize(80, b' ');
    out.extend(4u32.to_le_bytes());
    for t in triangles() {
        for x in [[0.0, f64::NAN, 1.0], t[0], t[1], t[2]].iter().flatten() {
            out.extend((*x as f32).to_le_bytes());
        }
        out.extend([0xff, 0x1f]);
    }
    out
}

fn files() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("a.obj", obj().into_bytes()),
        ("a.ply", ascii_ply().into_bytes()),
        ("b.ply", binary_ply(false)),
        ("c.ply", binary_ply(true)),
        ("a.stl", ascii_stl().into_bytes()),
        ("b.stl", binary_stl(b"made by a program")),
        ("c.stl", binary_stl(b"solid, although it is binary")),
    ]
}

#[test]
fn every_format_gives_the_same_mesh() {
    let expected = tetrahedron();
    for (name, bytes) in files() {
        for packed in [bytes.clone(), gzip(&bytes), zstd(&bytes)] {
            // By content alone, too.
            for name in [name, "mesh"] {
                let mesh = read_as(&packed, name, None).unwrap();
                if mesh.format == MeshFormat::Stl {
                    let places = |m: &Mesh| -> Vec<[f64; 3]> {
                        m.corners.iter().map(|&v| m.vertices[v as usize]).collect()
                    };
                    assert_eq!(places(&mesh), places(&expected), "{name}");
                    assert_eq!(mesh.vertices.len(), 4, "{name}");
                } else {
                    assert_eq!(mesh.vertices, expected.vertices, "{name}");
                    assert_eq!(mesh.corners, expected.corners, "{name}");
                }
                assert_eq!(mesh.face_from, expected.face_from, "{name}");
                assert!(mesh.warnings.is_empty(), "{name}: {:?}", mesh.warnings);
            }
        }
    }
}

#[test]
fn normals_are_read_where_they_are() {
    assert_eq!(read(obj().as_bytes()).unwrap().corner_normals, None);
    for big in [false, true] {
        let mesh = read(&binary_ply(big)).unwrap();
        let expected = (0..4).map(|i| [f64::from(i), 1.0, 2.0]).collect::<Vec<_>>();
        assert_eq!(mesh.face_normals, Some(expected));
        assert_eq!(mesh.vertex_normals, None);
    }
    // NaN stands for none.
    let mesh = read(&binary_stl(b"")).unwrap();
    assert_eq!(mesh.face_normals, Some(vec![[0.0; 3]; 4]));
    let mesh = read(ascii_stl().as_bytes()).unwrap();
    assert_eq!(mesh.face_normals, Some(vec![[0.0, 0.0, 1.0]; 4]));
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float nz\nproperty float x\n\
               property float y\nproperty float z\nproperty float nx\nproperty float ny\n\
               element face 1\nproperty list uint8 int32 vertex_indices\nend_header\n\
               1 0 0 0 2 3\n4 1 0 0 5 6\nnan 0 1 0 8 9\n3 0 1 2\n";
    assert_eq!(
        read(ply.as_bytes()).unwrap().vertex_normals,
        Some(vec![[2.0, 3.0, 1.0], [5.0, 6.0, 4.0], [0.0; 3]])
    );
}

#[test]
fn corners_of_obj_have_all_forms() {
    let text = "v 0 0 0 1.0\nv 1 0 0\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\nvt 0 0\nvt 1 0\n\
                vn 0 0 1\nvn 0 1 0\n\
                f 1 2 3 4\nf 1/1 2/2 3/1\nf 1//1 2//2 3//-1\nf -4/1/1 -3/-1/-2 -2//2\n\
                f 1 2 \\\n 3\nusemtl x\ns off\nl 1 2\nf 1/ 2/ 3/\n";
    let mesh = read(text.as_bytes()).unwrap();
    assert_eq!(
        faces_of(&mesh),
        [
            vec![0, 1, 2, 3],
            vec![0, 1, 2],
            vec![0, 1, 2],
            vec![0, 1, 2],
            vec![0, 1, 2],
            vec![0, 1, 2]
        ]
    );
    let (up, back, none) = ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0; 3]);
    let normals = mesh.corner_normals.unwrap();
    assert_eq!(normals[..7], [none; 7]);
    assert_eq!(normals[7..13], [up, back, back, up, up, back]);
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
    let mesh = read(b"v 0 0 0\r\nv 1 0 0\r\nv 0 1 0\r\nsurf x\r\nf 1 2 3").unwrap();
    assert!(mesh.warnings.iter().any(|w| w.contains("'surf' (1)")));
    assert!(mesh.warnings.iter().any(|w| w.contains("line end")));
}

#[test]
fn equal_places_become_one_vertex_and_keep_their_normals() {
    let mut mesh = Mesh::from_faces(
        vec![
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [-0.0; 3],
            [0.0, 0.0, 1.0],
        ],
        &[[0, 1, 2], [3, 4, 1]],
    );
    mesh.vertex_normals = Some((0..5).map(|i| [f64::from(i), 0.0, 1.0]).collect());
    assert_eq!(mesh.merge_equal_vertices(), 1);
    assert_eq!(mesh.vertices.len(), 4);
    assert_eq!(faces_of(&mesh), [[0, 1, 2], [0, 3, 1]]);
    let first: Vec<f64> = mesh.corner_normals.unwrap().iter().map(|n| n[0]).collect();
    assert_eq!(first, [0.0, 1.0, 2.0, 3.0, 4.0, 1.0]);
}

#[test]
fn mistakes_are_named_with_their_place() {
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    for (line, words) in [
        ("f 1 2 4\n", &["line 4", "index 4", "3 vertices"][..]),
        ("f 1 2 0\n", &["line 4", "index 0"]),
        ("f 1 2 -4\n", &["line 4", "index -4"]),
        ("f 1//1 2//1 3//1\n", &["line 4", "index 1", "0 normals"]),
        ("f 1 2\n", &["line 4", "2 corners"]),
        ("f 1 2 x\n", &["line 4", "'x'"]),
        ("f 1/a 2/1 3/1\n", &["line 4", "1/a"]),
        ("f 1/1/1/1 2 3\n", &["line 4", "slashes"]),
        ("v 1 2\n", &["line 4", "2 numbers"]),
        ("v 1 2 nan\n", &["line 4", "not finite"]),
        ("v 1 2 1e999\n", &["line 4", "not finite"]),
        ("v 1 2 3,5\n", &["line 4", "'3,5'"]),
        ("# nothing more\n", &["no faces", "3 vertices"]),
    ] {
        error(format!("{obj}{line}").as_bytes(), "a.obj", words);
    }
    let ply = ascii_ply();
    for (from, to, words) in [
        ("3 0 2 1", "3 0 2 4", &["face 0", "vertex 4"][..]),
        ("3 0 2 1", "2 0 2", &["line 15", "2 corners"]),
        ("3 0 2 1", "3 0 2", &["line 15", "fewer values"]),
        ("3 0 2 1", "3 0 2 1 1", &["line 15", "more values"]),
        ("3 0 2 1", "3 0 -2 1", &["line 15", "-2"]),
        ("3 0 2 1", "3 0 2 1.5", &["line 15", "'1.5'"]),
        ("1.5 0 0", "inf 0 0", &["line 12", "not finite"]),
        ("element face 4", "element face 5", &["ends before"]),
        ("element vertex 4", "element vertex 4000000000", &["line"]),
        ("element vertex 4", "element vertex -4", &["line 4", "'-4'"]),
        ("element vertex 4", "element point 4", &["'vertex'"]),
        ("property float z\n", "", &["x, y and z"]),
        ("property float z", "property float y", &["line 7", "twice"]),
        ("property float z", "property half z", &["line 7", "'half'"]),
        ("uchar int", "float int", &["line 9", "integer"]),
        ("vertex_indices", "other", &["vertex_indices"]),
        ("ascii 1.0", "ascii 2.0", &["line 2"]),
        ("format ascii 1.0\n", "", &["format"]),
        ("end_header\n", "", &["not understood"]),
        ("element face 4", "element tristrips 4", &["strips"]),
    ] {
        let broken = ply.replacen(from, to, 1);
        assert_ne!(broken, ply);
        error(broken.as_bytes(), "a.ply", words);
    }
    let stl = ascii_stl();
    for (from, to, words) in [
        ("vertex 0 0 0", "vertex 0 0 x", &["line 4", "'x'"][..]),
        ("vertex 0 0 0", "vertex 0 0 inf", &["line 4", "finite"]),
        (
            "    endloop",
            "    vertex 1 1 1\n    endloop",
            &["line 7", "endloop"],
        ),
        ("endsolid a thing with a name\n", "", &["ends", "endsolid"]),
        ("facet", "face", &["line 2", "'face'"]),
    ] {
        let broken = stl.replacen(from, to, 1);
        assert_ne!(broken, stl);
        error(broken.as_bytes(), "a.stl", words);
    }
    let mut binary = binary_stl(b"");
    binary.truncate(200);
    error(
        &binary,
        "a.stl",
        &["4 triangles", "284 bytes", "200 bytes", "byte 80"],
    );
    error(
        &binary_stl(b"solid, although it is binary")[..200],
        "a.stl",
        &["4 triangles", "200 bytes"],
    );
    let mut nifti = vec![0; 400];
    nifti[..4].copy_from_slice(&348i32.to_le_bytes());
    for name in ["a.stl", "a.nii"] {
        error(&nifti, name, &["not a mesh", "looks like analyze"]);
    }
    error(b"PAR1.......", "a.obj", &["not a mesh", "Parquet"]);
    // A short magic number may begin the free text of an STL.
    assert_eq!(read(&binary_stl(b"P5 made it")).unwrap().faces(), 4);
    let mut binary = binary_stl(b"");
    binary[96..100].copy_from_slice(&f32::INFINITY.to_le_bytes());
    error(&binary, "a.stl", &["byte 96", "triangle 0", "not finite"]);
    let mut binary = binary_ply(false);
    binary.truncate(binary.len() - 3);
    error(&binary, "a.ply", &["byte", "ends before"]);
    error(b"", "a.obj", &["empty"]);
    error(
        b"what is this",
        "mesh",
        &["not recognised", "OBJ, PLY or STL"],
    );
    let wrong = read_as(obj.as_bytes(), "a.obj", Some(MeshFormat::Ply)).unwrap_err();
    assert!(wrong.to_string().contains("begins with 'ply'"), "{wrong}");
}

#[test]
fn meshes_are_recognised_without_being_read() {
    let folder = tempfile::tempdir().unwrap();
    let recognised = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        recognise_mesh(&path)
    };
    for (name, bytes) in files() {
        let format = read_as(&bytes, name, None).unwrap().format;
        assert_eq!(recognised(name, &bytes), Some(format), "{name}");
        let name = format!("{name}.gz");
        assert_eq!(recognised(&name, &gzip(&bytes)), Some(format), "{name}");
    }
    assert_eq!(recognised("x", obj().as_bytes()), Some(MeshFormat::Obj));
    assert_eq!(recognised("x", &[0; 200]), None);
    assert_eq!(recognised("a.stl", b"\x93NUMPY....."), None);
    assert_eq!(recognise_mesh(folder.path()), None);
}

#[test]
fn what_follows_the_mesh_is_told() {
    for (name, mut bytes) in files()
        .into_iter()
        .skip(1)
        .take(3)
        .chain([("b.stl", binary_stl(b""))])
    {
        bytes.extend(b"more\n");
        let mesh = read_as(&bytes, name, None).unwrap();
        assert_eq!(mesh.warnings.len(), 1, "{name}");
        assert!(mesh.warnings[0].contains("ignored"), "{name}");
    }
}

#[test]
fn every_cut_is_an_error_or_is_told() {
    for (name, file) in files() {
        let whole = read_as(&file, name, None).unwrap();
        for keep in 0..file.len() {
            let Ok(cut) = read_as(&file[..keep], name, None) else {
                continue;
            };
            // Only text formats can seem whole. STL may lose the end of its last line, which says nothing;
            // OBJ has no count, so cut at the end of a line it is a smaller file.
            match cut.format {
                MeshFormat::Obj => {
                    let at_line_end = file[keep - 1] == b'\n';
                    assert_eq!(cut.warnings.is_empty(), at_line_end, "{keep}");
                }
                MeshFormat::Ply => {
                    assert_eq!(cut.warnings.len(), 1, "{name} {keep}");
                    assert!(file.len() - keep < 2, "{name} {keep}");
                }
                _ => assert_eq!(cut.corners, whole.corners, "{name} {keep}"),
            }
        }
        // Compressed, the end is known.
        let packed = gzip(&file);
        for keep in 0..packed.len() {
            assert!(
                read_as(&packed[..keep], name, None).is_err(),
                "{name} {keep}"
            );
        }
    }
}

#[test]
fn claims_of_billions_are_not_believed() {
    let header = |vertices: u64, faces: u64| {
        format!(
            "ply\nformat binary_little_endian 1.0\nelement nothing 4000000000\n\
             element vertex {vertices}\nproperty float x\n\
             property float y\nproperty float z\nelement face {faces}\n\
             property list uint uint vertex_indices\nend_header\n"
        )
        .into_bytes()
    };
    let mut long_list = header(0, 1);
    long_list.extend(u32::MAX.to_le_bytes());
    long_list.extend([0; 100]);
    let mut stl = vec![0; 80];
    stl.extend(u32::MAX.to_le_bytes());
    for bytes in [
        header(4_000_000_000, 4_000_000_000),
        header(1 << 60, 3),
        long_list,
        stl,
    ] {
        let (found, peak) = peak_bytes(|| read(&bytes));
        assert_ne!(found.unwrap_err().kind(), ErrorKind::Io);
        assert!(peak < 16 << 20, "{peak}");
    }
}

#[test]
fn an_endless_input_is_not_held_in_memory() {
    for format in [None, Some(MeshFormat::Stl), Some(MeshFormat::Obj)] {
        let (found, peak) = peak_bytes(|| read_mesh(Box::new(std::io::repeat(0)), "zeros", format));
        assert!(found.is_err());
        assert!(peak < 64 << 20, "{peak}");
    }
}

fn config() -> ProptestConfig {
    ProptestConfig {
        cases: ProptestConfig::default().cases.max(600),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

const FORMATS: [MeshFormat; 3] = [MeshFormat::Obj, MeshFormat::Ply, MeshFormat::Stl];

proptest! {
    #![proptest_config(config())]

    #[test]
    fn noise_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = read(&bytes);
        for format in FORMATS {
            let _ = read_as(&bytes, "noise", Some(format));
        }
    }

    #[test]
    fn words_in_any_order_never_panic(
        words in prop::collection::vec(prop::sample::select(vec![
            "v", "vn", "f", "1", "-1", "0", "3", "1//1", "nan", "1e400", "\\", "\n", "\n", "solid", "facet",
            "normal", "outer", "loop", "vertex", "endloop", "endfacet", "endsolid", "ply", "format", "ascii",
            "binary_little_endian", "1.0", "element", "face", "property", "list", "uchar", "int", "float",
            "x", "y", "z", "nx", "vertex_indices", "end_header\n",
        ]), 0..60),
    ) {
        let text = words.join(" ");
        for format in FORMATS {
            let _ = read_as(text.as_bytes(), "words", Some(format));
        }
    }

    #[test]
    fn changed_bytes_never_panic(
        which in 0..7_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let (name, mut bytes) = files().swap_remove(which);
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(mesh) = read_as(&bytes, name, None) {
            prop_assert!(mesh.corners.iter().all(|&v| (v as usize) < mesh.vertices.len()));
            prop_assert!(mesh.vertices.iter().flatten().all(|x| x.is_finite()));
            prop_assert!((0..mesh.faces()).all(|f| mesh.face(f).len() > 2));
        }
    }
}
