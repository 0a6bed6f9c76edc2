//! A volume in pieces that counts how often each is decoded, and knows where it is uniform.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex};

use curvox_formats::{
    ByteOrder, DType, Error, Format, Header, RandomVoxels, Region, SourceInfo, Volume, VoxelType,
    Voxels,
};

/// A box of voxels that are not all the background.
#[derive(Clone, Debug)]
pub(crate) struct Thing {
    pub(crate) lo: [u64; 3],
    pub(crate) size: [u64; 3],
    pub(crate) kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    /// All voxels have this value, and that is known.
    Solid(u8),
    /// A ball in the box, 100 at its centre and falling.
    Ball,
    /// Voxels of 0 to 255.
    Noise(u64),
}

/// Things in a background, decoded in pieces.
#[derive(Clone, Debug)]
pub(crate) struct Pieces {
    pub(crate) dims: [u64; 3],
    pub(crate) chunk: [u64; 3],
    /// Voxels of the first piece that lie before the volume.
    pub(crate) before: [u64; 3],
    pub(crate) background: u8,
    pub(crate) things: Vec<Thing>,
    /// Whether the source says where it is uniform.
    pub(crate) tells: bool,
    /// Values are stored in 16 bits, big-endian.
    pub(crate) wide: bool,
    pub(crate) decoded: Arc<Mutex<HashMap<[u64; 3], u32>>>,
}

fn hash(mut z: u64) -> u64 {
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}

impl Thing {
    fn range(&self, axis: usize) -> Range<u64> {
        self.lo[axis]..self.lo[axis] + self.size[axis]
    }

    fn value(&self, p: [u64; 3]) -> Option<u8> {
        if !(0..3).all(|a| self.range(a).contains(&p[a])) {
            return None;
        }
        match self.kind {
            Kind::Solid(value) => Some(value),
            Kind::Noise(seed) => Some(hash(p[0] + 1000 * p[1] + 1_000_000 * p[2] + seed) as u8),
            Kind::Ball => {
                let radius = *self.size.iter().min().unwrap() as f64 / 2.0;
                let d: f64 = (0..3)
                    .map(|a| {
                        let middle = self.lo[a] as f64 + (self.size[a] as f64 - 1.0) / 2.0;
                        (p[a] as f64 - middle).powi(2)
                    })
                    .sum();
                let value = 100.0 - 99.0 * d.sqrt() / radius;
                (value >= 1.0).then_some(value as u8)
            }
        }
    }

    fn meets(&self, region: &Region) -> bool {
        (0..3).all(|a| {
            let range = self.range(a);
            range.start < region.origin[a] + region.size[a] && region.origin[a] < range.end
        })
    }

    fn holds(&self, region: &Region) -> bool {
        (0..3).all(|a| {
            let range = self.range(a);
            range.start <= region.origin[a] && region.origin[a] + region.size[a] <= range.end
        })
    }
}

impl Pieces {
    pub(crate) fn new(dims: [u64; 3], chunk: [u64; 3], things: Vec<Thing>) -> Self {
        Self {
            dims,
            chunk,
            before: [0; 3],
            background: 0,
            things,
            tells: true,
            wide: false,
            decoded: Arc::default(),
        }
    }

    pub(crate) fn header(&self) -> Header {
        let dtype = if self.wide {
            DType {
                voxel: VoxelType::U16,
                byte_order: ByteOrder::Big,
            }
        } else {
            DType::little(VoxelType::U8)
        };
        Header::new(Format::Zarr, self.dims, dtype)
    }

    pub(crate) fn bytes(&self, region: &Region, out: &mut Vec<u8>) {
        out.clear();
        let things: Vec<_> = self
            .things
            .iter()
            .rev()
            .filter(|t| t.meets(region))
            .collect();
        let [xs, ys, zs] = [0, 1, 2].map(|a| region.origin[a]..region.origin[a] + region.size[a]);
        for z in zs {
            for y in ys.clone() {
                for x in xs.clone() {
                    if self.wide {
                        out.push(0);
                    }
                    let found = things.iter().find_map(|thing| thing.value([x, y, z]));
                    out.push(found.unwrap_or(self.background));
                }
            }
        }
    }

    pub(crate) fn volume(&self) -> Volume {
        Volume {
            header: self.header(),
            voxels: Voxels::Random(Box::new(self.clone())),
            source: SourceInfo::stream("pieces"),
        }
    }

    /// How often pieces were decoded: the least and the most, of those that were.
    pub(crate) fn counts(&self) -> Option<(u32, u32)> {
        let decoded = self.decoded.lock().unwrap();
        Some((*decoded.values().min()?, *decoded.values().max()?))
    }
}

impl RandomVoxels for Pieces {
    fn read_box(&self, region: &Region, out: &mut Vec<u8>) -> Result<(), Error> {
        assert!(region.is_inside(self.dims), "{region:?}");
        let [xs, ys, zs] = [0, 1, 2].map(|a| {
            (region.origin[a] + self.before[a]) / self.chunk[a]
                ..=(region.origin[a] + self.before[a] + region.size[a] - 1) / self.chunk[a]
        });
        for z in zs {
            for y in ys.clone() {
                for x in xs.clone() {
                    let piece = [x, y, z];
                    let from = |a: usize, n: u64| {
                        (n * self.chunk[a])
                            .saturating_sub(self.before[a])
                            .min(self.dims[a])
                    };
                    let origin = [0, 1, 2].map(|a| from(a, piece[a]));
                    let size = [0, 1, 2].map(|a| from(a, piece[a] + 1) - origin[a]);
                    if self.uniform(&Region { origin, size }).is_none() {
                        *self.decoded.lock().unwrap().entry(piece).or_default() += 1;
                    }
                }
            }
        }
        self.bytes(region, out);
        Ok(())
    }

    fn planes(&self, _: u64, _: u64) -> Result<Option<&[u8]>, Error> {
        Ok(None)
    }

    fn check(&self) -> Result<(), Error> {
        Ok(())
    }

    fn chunk(&self) -> Option<[u64; 3]> {
        Some(self.chunk)
    }

    fn chunk_start(&self) -> [u64; 3] {
        self.before
    }

    fn uniform(&self, region: &Region) -> Option<[u8; 8]> {
        if !self.tells {
            return None;
        }
        // As a source of pieces would: it knows of whole ones.
        let (mut origin, mut size) = ([0; 3], [0; 3]);
        for a in 0..3 {
            let (piece, before) = (self.chunk[a], self.before[a]);
            let end = region.origin[a] + region.size[a] + before;
            origin[a] = ((region.origin[a] + before) / piece * piece).saturating_sub(before);
            size[a] = (end.div_ceil(piece) * piece - before).min(self.dims[a]) - origin[a];
        }
        let region = &Region { origin, size };
        let value = match self.things.iter().rev().find(|t| t.meets(region)) {
            None => self.background,
            Some(thing) => match thing.kind {
                Kind::Solid(value) if thing.holds(region) => value,
                _ => return None,
            },
        };
        // What is behind the voxel says nothing.
        Some(if self.wide {
            [0, value, 9, 9, 9, 9, 9, 9]
        } else {
            [value, 8, 7, 6, 5, 4, 3, 2]
        })
    }
}
