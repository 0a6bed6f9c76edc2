//! A tree as a model, whose voxels are looked up one by one, and a writer of it.
//!
//! Values are small whole numbers, which every type holds, halves too.

use std::collections::BTreeMap;
use std::io::Write;

/// What is written, and how.
#[derive(Clone, Debug)]
pub struct Style {
    pub version: u32,
    /// 1 zip, 2 active mask, 4 Blosc.
    pub flags: u32,
    /// `float`, `bool`, ...
    pub kind: &'static str,
    pub half: bool,
    pub stream: bool,
}

impl Default for Style {
    fn default() -> Self {
        Self {
            version: 224,
            flags: 2,
            kind: "float",
            half: false,
            stream: false,
        }
    }
}

/// A value and whether it is active.
pub type Cell = (i32, bool);

/// A node with cells of its own and children.
#[derive(Clone, Debug)]
pub struct Node<C> {
    pub cells: Vec<Cell>,
    pub children: BTreeMap<usize, C>,
}

pub type Leaf = Vec<Cell>;
pub type Lower = Node<Leaf>;
pub type Upper = Node<Lower>;

#[derive(Clone, Debug)]
pub enum Root {
    Tile(Cell),
    Upper(Upper),
}

/// A whole tree, by cells of the root.
#[derive(Clone, Debug)]
pub struct Model {
    pub background: i32,
    pub roots: BTreeMap<[i32; 3], Root>,
}

/// Number of a cell in a node with 2^log2 cells along each axis.
pub fn number(index: [i32; 3], log2: u32, cell_log2: u32) -> usize {
    let part = |i: i32| (i >> cell_log2 & ((1 << log2) - 1)) as usize;
    (part(index[0]) << log2 | part(index[1])) << log2 | part(index[2])
}

impl Model {
    /// The voxel at an index.
    pub fn cell(&self, index: [i32; 3]) -> Cell {
        let upper = match self.roots.get(&index.map(|i| i >> 12)) {
            None => return (self.background, false),
            Some(Root::Tile(cell)) => return *cell,
            Some(Root::Upper(upper)) => upper,
        };
        let n = number(index, 5, 7);
        let Some(lower) = upper.children.get(&n) else {
            return upper.cells[n];
        };
        let n = number(index, 4, 3);
        match lower.children.get(&n) {
            None => lower.cells[n],
            Some(leaf) => leaf[number(index, 3, 0)],
        }
    }
}

/// Bytes of a value of a kind.
pub fn bytes(kind: &str, value: i32) -> Vec<u8> {
    match kind {
        "float" => (value as f32).to_le_bytes().to_vec(),
        "double" => f64::from(value).to_le_bytes().to_vec(),
        "half" => half(value).to_le_bytes().to_vec(),
        "int8" | "uint8" => vec![value as u8],
        "int16" | "uint16" => (value as u16).to_le_bytes().to_vec(),
        "int32" | "uint32" => (value as u32).to_le_bytes().to_vec(),
        "int64" | "uint64" => i64::from(value).to_le_bytes().to_vec(),
        "bool" | "mask" => vec![u8::from(value != 0)],
        "vec3s" => [value as f32; 3]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect(),
        other => panic!("no kind {other}"),
    }
}

/// A whole number below 2048 as a half float.
fn half(value: i32) -> u16 {
    let magnitude = value.unsigned_abs();
    if magnitude == 0 {
        return 0;
    }
    let exponent = magnitude.ilog2();
    let fraction = (magnitude << 10 >> exponent) & 0x3ff;
    ((value < 0) as u16) << 15 | ((exponent + 15) as u16) << 10 | fraction as u16
}

struct Writer<'a> {
    style: &'a Style,
    background: i32,
    out: Vec<u8>,
}

impl Writer<'_> {
    fn u32(&mut self, value: u32) {
        self.out.extend(value.to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.u32(text.len() as u32);
        self.out.extend(text.as_bytes());
    }

    fn value(&mut self, value: i32) {
        self.out.extend(bytes(self.style.kind, value));
    }

    fn origin(&mut self, origin: [i32; 3]) {
        origin.map(|i| self.out.extend(i.to_le_bytes()));
    }

    fn mask(&mut self, bits: impl IntoIterator<Item = bool>) {
        let mut bits = bits.into_iter();
        while let Some(first) = bits.next() {
            let rest = (1..8).map(|i| u8::from(bits.next().unwrap_or(false)) << i);
            let byte = rest.fold(u8::from(first), |byte, bit| byte | bit);
            self.out.push(byte);
        }
    }

    fn negative(&self) -> Vec<u8> {
        match self.style.kind {
            "bool" | "mask" => bytes(self.style.kind, i32::from(self.background == 0)),
            kind => bytes(kind, -self.background),
        }
    }

    /// Stored values, compressed as a file of this style has them.
    fn stored(&mut self, values: &[i32]) {
        let halved = self.style.half && matches!(self.style.kind, "float" | "double" | "vec3s");
        let per_value = if self.style.kind == "vec3s" { 3 } else { 1 };
        let data: Vec<u8> = values
            .iter()
            .flat_map(|v| match halved {
                true => half(*v).to_le_bytes().repeat(per_value),
                false => bytes(self.style.kind, *v),
            })
            .collect();
        let zip = match self.style.version {
            222.. => self.style.flags & 1 != 0,
            220.. => self.style.flags & 1 != 0,
            _ => true,
        };
        let blosc = self.style.version >= 222 && self.style.flags & 4 != 0;
        if !zip && !blosc || halved && values.is_empty() {
            self.out.extend(data);
            return;
        }
        let packed = if blosc {
            // A container whose content is not compressed.
            let mut packed = vec![2, 1, 2, 4];
            for number in [data.len(), data.len(), data.len() + 16] {
                packed.extend((number as u32).to_le_bytes());
            }
            packed.extend(&data);
            packed
        } else {
            let mut encoder =
                flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
            encoder.write_all(&data).unwrap();
            encoder.finish().unwrap()
        };
        // What does not shrink is left as it is, mostly.
        if packed.len() < data.len() || blosc && data.len() % 3 > 0 {
            self.out.extend((packed.len() as i64).to_le_bytes());
            self.out.extend(packed);
        } else {
            self.out.extend((-(data.len() as i64)).to_le_bytes());
            self.out.extend(data);
        }
    }

    /// The values of a node; `is_tile` says which cells have one.
    fn values(&mut self, cells: &[Cell], is_tile: &dyn Fn(usize) -> bool) {
        if self.style.version < 222 {
            let tiles: Vec<i32> = (0..cells.len())
                .filter(|n| is_tile(*n))
                .map(|n| cells[n].0)
                .collect();
            return self.stored(&tiles);
        }
        let kind = self.style.kind;
        if self.style.flags & 2 == 0 {
            self.out.push(6);
            let all: Vec<i32> = cells.iter().map(|cell| cell.0).collect();
            return self.stored(&all);
        }
        let mut inactive: Vec<i32> = Vec::new();
        for (n, (value, active)) in cells.iter().enumerate() {
            if !active
                && is_tile(n)
                && !inactive
                    .iter()
                    .any(|v| bytes(kind, *v) == bytes(kind, *value))
            {
                inactive.push(*value);
            }
        }
        let background = bytes(kind, self.background);
        let is_background = |v: &i32| bytes(kind, *v) == background;
        let is_negative = |v: &i32| bytes(kind, *v) == self.negative();
        // The value that is not the background first.
        if inactive.len() == 2 && is_background(&inactive[0]) {
            inactive.swap(0, 1);
        }
        let case = match inactive.as_slice() {
            [] => 0,
            [one] if is_background(one) => 0,
            [one] if is_negative(one) => 1,
            [_] => 2,
            [first, second] if is_background(second) && is_negative(first) => 3,
            [_, second] if is_background(second) => 4,
            [_, _] => 5,
            _ => 6,
        };
        self.out.push(case);
        if matches!(case, 2 | 4 | 5) {
            self.value(inactive[0]);
        }
        if case == 5 {
            self.value(inactive[1]);
        }
        if matches!(case, 3..=5) {
            let second = bytes(kind, inactive[1]);
            self.mask(
                cells
                    .iter()
                    .map(|(v, active)| !active && bytes(kind, *v) == second),
            );
        }
        let stored: Vec<i32> = match case {
            6 => cells.iter().map(|cell| cell.0).collect(),
            _ => cells
                .iter()
                .filter(|cell| cell.1)
                .map(|cell| cell.0)
                .collect(),
        };
        self.stored(&stored);
    }

    /// Masks, tiles and the topology of children of a node.
    fn node<C>(&mut self, node: &Node<C>, child: &dyn Fn(&mut Self, &C)) {
        let is_tile = |n: usize| !node.children.contains_key(&n);
        self.mask((0..node.cells.len()).map(|n| !is_tile(n)));
        self.mask((0..node.cells.len()).map(|n| is_tile(n) && node.cells[n].1));
        if self.style.version < 214 {
            for (n, (value, _)) in node.cells.iter().enumerate() {
                match node.children.get(&n) {
                    Some(inner) => child(self, inner),
                    None => self.value(*value),
                }
            }
            return;
        }
        // Cells of children are stored as inactive zeros.
        let cells: Vec<Cell> = (0..node.cells.len())
            .map(|n| {
                if is_tile(n) {
                    node.cells[n]
                } else {
                    (0, false)
                }
            })
            .collect();
        self.values(&cells, &is_tile);
        node.children.values().for_each(|inner| child(self, inner));
    }

    fn topology(&mut self, model: &Model) {
        self.u32(1);
        self.value(model.background);
        let tiles = model
            .roots
            .values()
            .filter(|root| matches!(root, Root::Tile(_)));
        let tiles = tiles.count();
        self.u32(tiles as u32);
        self.u32((model.roots.len() - tiles) as u32);
        for (place, root) in &model.roots {
            if let Root::Tile((value, active)) = root {
                self.origin(place.map(|i| i << 12));
                self.value(*value);
                self.out.push(u8::from(*active));
            }
        }
        for (place, root) in &model.roots {
            if let Root::Upper(upper) = root {
                self.origin(place.map(|i| i << 12));
                self.node(upper, &|writer, lower| {
                    writer.node(lower, &|writer, leaf: &Leaf| {
                        writer.mask(leaf.iter().map(|cell| cell.1));
                    });
                });
            }
        }
    }

    fn leaf(&mut self, leaf: &Leaf, origin: [i32; 3]) {
        self.mask(leaf.iter().map(|cell| cell.1));
        let all: Vec<i32> = leaf.iter().map(|cell| cell.0).collect();
        match self.style.kind {
            "mask" => self.origin(origin),
            "bool" if self.style.version >= 217 => {
                self.origin(origin);
                self.mask(leaf.iter().map(|cell| cell.0 != 0));
            }
            _ if self.style.version < 222 => {
                self.origin(origin);
                // Two buffers, of which the second is of no use.
                self.out.push(2);
                self.stored(&all);
                self.stored(&[5; 512]);
            }
            _ => self.values(leaf, &|_| true),
        }
    }

    fn leaves(&mut self, model: &Model) {
        let place = |origin: [i32; 3], n: usize, log2: u32, cell_log2: u32| -> [i32; 3] {
            let mask = (1 << log2) - 1;
            let cell = [n >> (2 * log2), n >> log2 & mask, n & mask];
            std::array::from_fn(|a| origin[a] + ((cell[a] as i32) << cell_log2))
        };
        for (cell, root) in &model.roots {
            let Root::Upper(upper) = root else { continue };
            for (n, lower) in &upper.children {
                let origin = place(cell.map(|i| i << 12), *n, 5, 7);
                for (n, leaf) in &lower.children {
                    self.leaf(leaf, place(origin, *n, 4, 3));
                }
            }
        }
    }

    /// Voxels of 0.5 x 0.75 x 1.25, the voxel (0, 0, 0) at (10, -20, 30).
    fn transform(&mut self) {
        let (scale, origin) = ([0.5, 0.75, 1.25], [10.0, -20.0, 30.0]);
        let mut numbers: Vec<f64> = Vec::new();
        let matrix = |scale: [f64; 3], origin: [f64; 3]| {
            let mut matrix = [0.0; 16];
            for a in 0..3 {
                matrix[5 * a] = scale[a];
                matrix[12 + a] = origin[a];
            }
            matrix[15] = 1.0;
            matrix
        };
        if self.style.version < 219 {
            self.text("LinearTransform");
            self.origin([0; 3]);
            self.origin([100; 3]);
            for (scale, origin) in [
                ([2.0; 3], origin),
                ([9.0; 3], [9.0; 3]),
                (scale.map(|s| s / 2.0), [0.0; 3]),
                ([9.0; 3], [9.0; 3]),
            ] {
                numbers.extend(matrix(scale, origin));
            }
        } else {
            self.text("ScaleTranslateMap");
            numbers.extend(origin);
            for _ in 0..5 {
                numbers.extend(scale);
            }
        }
        self.out
            .extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
    }

    fn grid(&mut self, model: &Model, instance: bool) {
        if self.style.version >= 222 {
            self.u32(self.style.flags);
        }
        self.u32(3);
        self.text("is_saved_as_half_float");
        self.text("bool");
        self.text(if self.style.half { "\u{1}" } else { "\0" });
        self.text("class");
        self.text("string");
        self.text("level set");
        self.text("is_local_space");
        self.text("bool");
        self.text("\0");
        let transform_first = self.style.version >= 216;
        if transform_first {
            self.transform();
        }
        if !instance {
            self.topology(model);
        }
        if !transform_first {
            self.transform();
        }
        if !instance {
            self.leaves(model);
        }
    }
}

/// A file of grids: name (unique), and tree or the name of the grid that has it.
pub fn file(style: &Style, grids: &[(&str, Result<&Model, &str>)]) -> Vec<u8> {
    let mut writer = Writer {
        style,
        background: 0,
        out: b" BDV\0\0\0\0".to_vec(),
    };
    writer.u32(style.version);
    writer.u32(10);
    writer.u32(0);
    writer.out.push(u8::from(!style.stream));
    if (220..222).contains(&style.version) {
        writer.out.push(u8::from(style.flags & 1 != 0));
    }
    let uuid = b"0a1b2c3d-0a1b-2c3d-4e5f-0a1b2c3d4e5f";
    let uuid_bytes = if style.version >= 218 { 36 } else { 16 };
    writer.out.extend(&uuid[..uuid_bytes]);
    writer.u32(1);
    writer.text("creator");
    writer.text("string");
    writer.text("tests");
    writer.u32(grids.len() as u32);
    for (name, content) in grids {
        writer.text(name);
        let half = if style.half { "_HalfFloat" } else { "" };
        writer.text(&format!("Tree_{}_5_4_3{half}", style.kind));
        if style.version >= 216 {
            writer.text(content.err().unwrap_or_default());
        }
        let places = writer.out.len();
        writer.out.extend([0; 24]);
        let start = writer.out.len() as u64;
        let none = Model {
            background: 0,
            roots: BTreeMap::new(),
        };
        let model = content.unwrap_or(&none);
        writer.background = model.background;
        writer.grid(model, content.is_err());
        if !style.stream {
            let end = writer.out.len() as u64;
            for (i, place) in [start, start, end].into_iter().enumerate() {
                writer.out[places + 8 * i..][..8].copy_from_slice(&place.to_le_bytes());
            }
        }
    }
    writer.out
}
