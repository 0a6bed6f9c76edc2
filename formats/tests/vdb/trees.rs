use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use curvox_formats::{ErrorKind, OpenOptions, Region, Voxels, open};
use proptest::prelude::*;

use super::writer::{Leaf, Lower, Model, Node, Root, Style, Upper, bytes, file, number};
use crate::support::{Folder, open_bytes, peak_bytes, read_all};

/// Random numbers, the same for the same seed (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    /// A node's cells: mostly of few values, so that every way to leave some out is taken.
    fn cells(&mut self, count: usize, background: i32) -> Vec<(i32, bool)> {
        let values = match self.below(7) {
            0 => vec![background],
            1 => vec![-background],
            2 => vec![3],
            3 => vec![background, -background],
            4 => vec![background, 3],
            5 => vec![3, 5],
            _ => vec![background, -background, 3, 5, 100],
        };
        let active = [0, 2, 50, 100][self.below(4)];
        (0..count)
            .map(|_| {
                let active = self.below(100) < active;
                let value = if active {
                    self.below(200) as i32 - 100
                } else {
                    values[self.below(values.len())]
                };
                (value, active)
            })
            .collect()
    }

    fn node<C>(
        &mut self,
        cells: usize,
        most: usize,
        background: i32,
        child: &mut dyn FnMut(&mut Self) -> C,
    ) -> Node<C> {
        let count = self.below(most + 1);
        Node {
            cells: self.cells(cells, background),
            children: (0..count)
                .map(|_| (self.below(cells), child(self)))
                .collect(),
        }
    }

    fn model(&mut self) -> Model {
        let background = [0, 7, -2][self.below(3)];
        let mut roots = BTreeMap::new();
        for _ in 0..self.below(4) {
            let place = [0; 3].map(|_: i32| self.below(4) as i32 - 2);
            let root = if self.below(4) == 0 {
                Root::Tile((self.below(20) as i32, self.below(2) == 0))
            } else {
                let upper: Upper = self.node(32768, 3, background, &mut |random| -> Lower {
                    random.node(4096, 4, background, &mut |random| -> Leaf {
                        random.cells(512, background)
                    })
                });
                Root::Upper(upper)
            };
            roots.insert(place, root);
        }
        Model { background, roots }
    }
}

const KINDS: [&str; 12] = [
    "float", "double", "half", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "bool", "mask",
];

fn style() -> impl Strategy<Value = Style> {
    let version = prop_oneof![213_u32..=225, Just(224)];
    let kind = prop_oneof![Just("float"), proptest::sample::select(KINDS.as_slice())];
    (version, 0..8_u32, kind, any::<bool>(), any::<bool>()).prop_map(
        |(version, flags, kind, half, stream)| Style {
            version,
            flags,
            kind,
            half,
            stream,
        },
    )
}

/// What a voxel of the model is in a grid of a kind.
fn expected(model: &Model, kind: &str, index: [i32; 3]) -> Vec<u8> {
    let (value, active) = model.cell(index);
    match kind {
        "mask" => vec![u8::from(active)],
        _ => bytes(kind, value),
    }
}

/// Indices near which something happens: corners of children and of leaves.
fn corners(model: &Model) -> Vec<[i32; 3]> {
    let mut found = vec![[0; 3]];
    for (place, root) in &model.roots {
        let origin = place.map(|i| i << 12);
        found.push(origin);
        found.push(origin.map(|i| i + 4095));
        let Root::Upper(upper) = root else { continue };
        for (n, lower) in &upper.children {
            let offset = [n >> 10, n >> 5 & 31, n & 31].map(|i| (i as i32) << 7);
            let origin: [i32; 3] = std::array::from_fn(|a| origin[a] + offset[a]);
            found.push(origin);
            for n in lower.children.keys() {
                let offset = [n >> 8, n >> 4 & 15, n & 15].map(|i| (i as i32) << 3);
                let leaf = std::array::from_fn(|a| origin[a] + offset[a]);
                found.extend([leaf, leaf.map(|i| i + 7)]);
            }
        }
    }
    found
}

/// Number of active voxels, and first and last index of the box around them.
fn active(model: &Model) -> (u64, Option<[[i64; 3]; 2]>) {
    let mut count = 0;
    let mut bounds: Option<[[i64; 3]; 2]> = None;
    let mut add = |origin: [i64; 3], log2: u32| {
        count += 1_u64 << (3 * log2);
        let last = origin.map(|i| i + (1 << log2) - 1);
        let [low, high] = bounds.get_or_insert([origin, last]);
        for a in 0..3 {
            low[a] = low[a].min(origin[a]);
            high[a] = high[a].max(last[a]);
        }
    };
    let place = |origin: [i64; 3], n: usize, log2: u32, cell_log2: u32| -> [i64; 3] {
        let mask = (1 << log2) - 1;
        let cell = [n >> (2 * log2), n >> log2 & mask, n & mask];
        std::array::from_fn(|a| origin[a] + ((cell[a] as i64) << cell_log2))
    };
    for (cell, root) in &model.roots {
        let origin = cell.map(|i| i64::from(i) << 12);
        let upper = match root {
            Root::Tile((_, true)) => {
                add(origin, 12);
                continue;
            }
            Root::Tile(_) => continue,
            Root::Upper(upper) => upper,
        };
        for (n, cell) in upper.cells.iter().enumerate() {
            let origin = place(origin, n, 5, 7);
            let Some(lower) = upper.children.get(&n) else {
                if cell.1 {
                    add(origin, 7);
                }
                continue;
            };
            for (n, cell) in lower.cells.iter().enumerate() {
                let origin = place(origin, n, 4, 3);
                match lower.children.get(&n) {
                    None if cell.1 => add(origin, 3),
                    None => {}
                    Some(leaf) => {
                        for n in (0..512).filter(|n| leaf[*n].1) {
                            add(place(origin, n, 3, 0), 0);
                        }
                    }
                }
            }
        }
    }
    (count, bounds)
}

fn check(style: &Style, model: &Model, random: &mut Random) -> Result<(), TestCaseError> {
    let grid = file(style, &[("g", Ok(model))]);
    // The box around the active voxels, one voxel wider.
    let (count, bounds) = active(model);
    let open = |region| {
        let options = OpenOptions {
            region,
            ..OpenOptions::default()
        };
        open_bytes(&grid, &options).map_err(|e| TestCaseError::fail(format!("{style:?}: {e}")))
    };
    let header = open(None)?.header;
    let [low, high] = bounds.unwrap_or([[1; 3], [-1; 3]]);
    prop_assert_eq!(header.first_index, low.map(|i| i - 1));
    prop_assert_eq!(
        header.dims,
        [0, 1, 2].map(|a| (high[a] - low[a] + 3) as u64)
    );
    let told = header
        .details
        .iter()
        .find(|(name, _)| *name == "active voxels");
    prop_assert_eq!(told.unwrap().1.clone(), count.to_string());
    prop_assert_eq!(header.spacing, Some([0.5, 0.75, 1.25]));
    prop_assert_eq!(
        header.origin[1],
        -20.0 + 0.75 * header.first_index[1] as f64
    );

    // Boxes anywhere, beyond all nodes, too.
    let all = [-20_000_i64..20_000, -20_000..20_000, -20_000..20_000];
    let volume = open(Some(all))?;
    let Voxels::Random(voxels) = &volume.voxels else {
        panic!("boxes expected");
    };
    let corners = corners(model);
    let mut out = Vec::new();
    for round in 0..40 {
        let corner = corners[random.below(corners.len())];
        let most = if round < 4 { 70 } else { 12 };
        let size = [0; 3].map(|_: i32| 1 + random.below(most) as i32);
        let from: [i32; 3] =
            std::array::from_fn(|a| corner[a] - random.below(size[a] as usize + 1) as i32);
        let region = Region {
            origin: from.map(|i| (i + 20_000) as u64),
            size: size.map(|n| n as u64),
        };
        voxels
            .read_box(&region, &mut out)
            .map_err(|e| TestCaseError::fail(format!("{style:?}: {e}")))?;
        let mut wanted = Vec::new();
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let index = [from[0] + x, from[1] + y, from[2] + z];
                    wanted.extend(expected(model, style.kind, index));
                }
            }
        }
        prop_assert!(out == wanted, "{:?}: {:?} {:?}", style, from, size);
        if let Some(value) = voxels.uniform(&region) {
            let one = &value[..header.voxel.bytes()];
            let same = wanted.chunks_exact(one.len()).all(|voxel| voxel == one);
            prop_assert!(same, "{:?}: {:?} {:?}", style, from, size);
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn random_trees_read_back_in_every_version_and_compression(
        style in style(),
        seed in any::<u64>(),
    ) {
        let mut random = Random(seed);
        let model = random.model();
        check(&style, &model, &mut random)?;
    }
}

/// A leaf of one value in a tree that is empty else.
fn lone(index: [i32; 3], background: i32, value: i32) -> Root {
    let empty = (background, false);
    let lower = Node {
        cells: vec![empty; 4096],
        children: BTreeMap::from([(number(index, 4, 3), vec![(value, true); 512])]),
    };
    Root::Upper(Node {
        cells: vec![empty; 32768],
        children: BTreeMap::from([(number(index, 5, 7), lower)]),
    })
}

#[test]
fn small_objects_far_apart_cost_little() {
    let places = [
        [-50_000, -50_000, -50_000],
        [0, 0, 0],
        [49_992, 49_992, 49_992],
    ];
    let model = Model {
        background: -3,
        roots: places
            .into_iter()
            .map(|index: [i32; 3]| (index.map(|i| i >> 12), lone(index, -3, 4)))
            .collect(),
    };
    let bytes = file(&Style::default(), &[("g", Ok(&model))]);
    let folder = Folder::new();
    let begin = Instant::now();
    let path = folder.write("far.vdb", &bytes);
    let (volume, peak) = peak_bytes(|| open(&path, &OpenOptions::default()).unwrap());
    assert!(peak < 1 << 20, "{peak}");
    let header = volume.header;
    assert_eq!(header.dims, [100_002; 3]);
    let Voxels::Random(voxels) = volume.voxels else {
        panic!("boxes expected");
    };
    // Slabs of 64 planes: all of them, and those that have something in tiles of 1024^2.
    let (mut filled, mut out) = (0, Vec::new());
    for z in (0..100_002).step_by(64) {
        let slab = Region {
            origin: [0, 0, z],
            size: [100_002, 100_002, 64.min(100_002 - z)],
        };
        if voxels.uniform(&slab).is_some() {
            continue;
        }
        for y in (0..100_002).step_by(1024) {
            for x in (0..100_002).step_by(1024) {
                let tile = Region {
                    origin: [x, y, z],
                    size: [1024.min(100_002 - x), 1024.min(100_002 - y), slab.size[2]],
                };
                if voxels.uniform(&tile).is_none() {
                    voxels.read_box(&tile, &mut out).unwrap();
                    let words = out.as_chunks::<4>().0.iter();
                    filled += words.filter(|v| f32::from_le_bytes(**v) == 4.0).count();
                }
            }
        }
    }
    assert_eq!(filled, 3 * 512);
    assert!(
        begin.elapsed() < Duration::from_secs(10),
        "{:?}",
        begin.elapsed()
    );
}

#[test]
fn grids_of_a_stream_are_found_one_behind_the_other() {
    let model = |value| Model {
        background: 0,
        roots: BTreeMap::from([([0; 3], lone([8, 8, 8], 0, value))]),
    };
    let (one, two) = (model(1), model(2));
    for stream in [false, true] {
        for kind in ["double", "vec3s"] {
            let style = Style {
                stream,
                kind,
                half: true,
                flags: 5,
                ..Style::default()
            };
            let bytes = file(
                &style,
                &[
                    ("a", Ok(&one)),
                    ("b", Ok(&two)),
                    ("b\u{1e}1", Err("a")),
                    ("c", Err("x")),
                ],
            );
            let open = |name: &str| {
                let options = OpenOptions {
                    dataset: Some(name.into()),
                    ..OpenOptions::default()
                };
                open_bytes(&bytes, &options)
            };
            if kind == "vec3s" {
                let error = open("b[1]").unwrap_err();
                assert!(
                    error.message().contains("vectors (Tree_vec3s_5_4_3)"),
                    "{error}"
                );
                continue;
            }
            for (name, value) in [("a", 1.0_f64), ("b", 2.0), ("b[1]", 1.0), ("2", 1.0)] {
                let (header, voxels, _) = read_all(open(name).unwrap()).unwrap();
                assert_eq!(header.dims, [10; 3]);
                assert_eq!(voxels[(111 * 8)..(112 * 8)], value.to_le_bytes(), "{name}");
            }
            let error = open("c").unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Invalid);
            assert!(
                error.message().contains("shares the tree of \"x\""),
                "{error}"
            );
        }
    }
}

#[test]
fn a_region_may_lie_anywhere() {
    let model = Model {
        background: 5,
        roots: BTreeMap::from([([0; 3], lone([0; 3], 5, 1))]),
    };
    let bytes = file(&Style::default(), &[("g", Ok(&model))]);
    let open = |region| {
        let options = OpenOptions {
            region: Some(region),
            ..OpenOptions::default()
        };
        open_bytes(&bytes, &options)
    };
    let volume = open([-3..5, 1 << 32..(1 << 32) + 2, 0..1]).unwrap();
    assert_eq!(volume.header.first_index, [-3, 1 << 32, 0]);
    assert_eq!(
        volume.header.origin,
        [8.5, -20.0 + 0.75 * 2_f64.powi(32), 30.0]
    );
    let (_, voxels, _) = read_all(volume).unwrap();
    assert_eq!(voxels, 5.0_f32.to_le_bytes().repeat(16));
    let (_, voxels, _) = read_all(open([-1..1, 0..1, 0..1]).unwrap()).unwrap();
    assert_eq!(voxels, [5.0_f32, 1.0].map(f32::to_le_bytes).concat());
    for region in [[0..0, 0..1, 0..1], [0..1, 0..1, i64::MIN..i64::MAX]] {
        assert_eq!(open(region).unwrap_err().kind(), ErrorKind::Unsupported);
    }
}
