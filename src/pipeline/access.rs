//! How the voxels of a volume can be read, as far as the plan and the reader ask.
//!
//! Comes in: an open volume, of which no voxel is read. Goes out: the shape of the pieces in which
//! it is decoded, and, where its source knows that most of it is uniform, how much of each layer of
//! planes will have to be read and kept.
//!
//! A *layer* is some planes that are read together, so that each piece is decoded once; a *band*
//! some rows of it. Layers and bands end where pieces do.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use curvox_formats::{RandomVoxels, Region, Volume, Voxels};

use crate::sink::{PART_EDGE, PART_PLANES};
use crate::volume::{PieceGrid, TileMap};

/// Pieces along an axis that are asked for a first impression of a volume.
const SAMPLES: u64 = 8;

/// How the voxels of a volume can be read.
#[derive(Clone, Debug)]
pub struct Access {
    /// Bytes of a stored voxel.
    pub voxel_bytes: u64,
    /// Whether planes are read into a buffer (not mapped).
    pub buffered: bool,
    /// Memory that the reader holds as long as it is open.
    pub held_bytes: u64,
    /// Memory of each thread that decodes, beside the box it decodes into.
    pub decode_bytes: u64,
    /// The pieces in which voxels are decoded, if the volume can be read anywhere.
    pub pieces: Option<PieceGrid>,
    /// What is to be read, where most of the volume is known to be uniform.
    pub sparse: Option<Sparse>,
}

/// What is to be read of a volume that is mostly uniform.
#[derive(Clone, Debug)]
pub struct Sparse {
    /// Planes of a layer.
    pub(super) layer_planes: u64,
    /// The layers in which voxels differ, in order.
    pub(super) layers: Vec<SparseLayer>,
    /// Tiles in which voxels differ, in all layers.
    pub(super) tiles: u64,
    /// Columns of parts that can have surfels in one layer of parts, at most.
    pub(super) columns: u64,
}

/// A layer in which voxels differ.
#[derive(Clone, Debug)]
pub(super) struct SparseLayer {
    pub(super) z: Range<u64>,
    /// Tiles that are kept.
    pub(super) tiles: u64,
    /// Memory of the map.
    pub(super) map_bytes: u64,
}

impl Access {
    /// Of voxels that come once, forward.
    #[must_use]
    pub fn forward(voxel_bytes: u64) -> Self {
        Self {
            voxel_bytes,
            buffered: true,
            held_bytes: 0,
            decode_bytes: 0,
            pieces: None,
            sparse: None,
        }
    }

    /// Of an open volume.
    #[must_use]
    pub fn of(volume: &Volume) -> Self {
        let voxel_bytes = volume.header.voxel.bytes() as u64;
        let Voxels::Random(voxels) = &volume.voxels else {
            return Self {
                held_bytes: volume.source.held_bytes,
                ..Self::forward(voxel_bytes)
            };
        };
        let dims = volume.header.dims;
        let pieces = PieceGrid::of(voxels.as_ref());
        Self {
            voxel_bytes,
            buffered: !volume.source.mapped,
            held_bytes: volume.source.held_bytes,
            decode_bytes: voxels.decode_bytes(),
            pieces,
            sparse: pieces.and_then(|pieces| Sparse::of(voxels.as_ref(), dims, &pieces)),
        }
    }
}

impl Sparse {
    /// What is to be read, if at most half of the volume need be kept.
    fn of(voxels: &dyn RandomVoxels, dims: [u64; 3], pieces: &PieceGrid) -> Option<Self> {
        if !seems_sparse(voxels, dims, pieces.shape) {
            return None;
        }
        let [x, y, depth] = dims;
        let [Ok(nx), Ok(ny), Ok(nz)] = dims.map(u32::try_from) else {
            return None;
        };
        let band = pieces.band_rows(dims);
        let layer_planes = pieces.tiled_planes();
        let mut sparse = Self {
            layer_planes,
            layers: Vec::new(),
            tiles: 0,
            columns: 1,
        };
        let mut columns = Columns::new([nx, ny]);
        let (mut z, mut kept_rows) = (0, 0u128);
        while z < depth {
            let end = pieces.step_end(2, z, layer_planes).min(depth);
            let map = TileMap::find(
                [nx, ny, nz],
                pieces,
                z..end,
                |region| voxels.uniform(region),
                |_| false,
            );
            let tiles = u64::from(map.tiles());
            if tiles > 0 {
                sparse.tiles += tiles;
                sparse.layers.push(SparseLayer {
                    z: z..end,
                    tiles,
                    map_bytes: map.bytes(),
                });
                kept_rows += u128::from(tiles * band) * u128::from(end - z);
            }
            columns.add(map, z..end);
            z = end;
        }
        sparse.columns = columns.most_open();
        let rows = u128::from(x.div_ceil(64)) * u128::from(y) * u128::from(depth);
        (2 * kept_rows <= rows).then_some(sparse)
    }
}

/// Whether a quarter of some pieces all over the volume are known to be uniform.
fn seems_sparse(voxels: &dyn RandomVoxels, dims: [u64; 3], chunk: [u64; 3]) -> bool {
    let pieces = [0, 1, 2].map(|a| dims[a].div_ceil(chunk[a]));
    let samples = pieces.map(|n| n.min(SAMPLES));
    let mut uniform = 0;
    for n in 0..samples.iter().product() {
        let at = [
            n % samples[0],
            n / samples[0] % samples[1],
            n / samples[0] / samples[1],
        ];
        let origin = [0, 1, 2].map(|a| (2 * at[a] + 1) * pieces[a] / (2 * samples[a]) * chunk[a]);
        let size = [0, 1, 2].map(|a| chunk[a].min(dims[a] - origin[a]));
        uniform += u64::from(voxels.uniform(&Region { origin, size }).is_some());
    }
    4 * uniform >= samples.iter().product()
}

/// Counts the columns of parts that can have surfels in the same layer of parts.
struct Columns {
    plane: [u32; 2],
    /// The layer below.
    below: Option<TileMap>,
    /// Columns that can have surfels, for each layer of parts.
    open: BTreeMap<u64, BTreeSet<[u32; 2]>>,
}

impl Columns {
    fn new(plane: [u32; 2]) -> Self {
        Self {
            plane,
            below: None,
            open: BTreeMap::new(),
        }
    }

    /// Adds the next layer of planes.
    fn add(&mut self, map: TileMap, z: Range<u64>) {
        let counts = self.plane.map(|n| n.div_ceil(PART_EDGE));
        if counts != [1, 1] {
            let mut found = BTreeSet::new();
            self.split(&map, [0; 2], counts, &mut found);
            let planes = u64::from(PART_PLANES);
            if !found.is_empty() {
                for layer in z.start / planes..=z.end / planes {
                    self.open.entry(layer).or_default().extend(&found);
                }
            }
        }
        self.below = Some(map);
    }

    fn split(&self, map: &TileMap, lo: [u32; 2], hi: [u32; 2], found: &mut BTreeSet<[u32; 2]>) {
        let [x, y] = [0, 1].map(|a| {
            let from = (lo[a] * PART_EDGE).saturating_sub(1);
            from..(hi[a] * PART_EDGE + 1).min(self.plane[a])
        });
        let value = map.value(&x, &y);
        let below = self.below.as_ref().map(|below| below.value(&x, &y));
        if value.is_some() && below.is_none_or(|below| below == value) {
            return;
        }
        let size = [0, 1].map(|a| hi[a] - lo[a]);
        if size == [1, 1] {
            found.insert(lo);
            return;
        }
        let axis = usize::from(size[1] > 1);
        let (mut to, mut from) = (hi, lo);
        to[axis] = lo[axis] + size[axis] / 2;
        from[axis] = to[axis];
        self.split(map, lo, to, found);
        self.split(map, from, hi, found);
    }

    fn most_open(&self) -> u64 {
        let open = self.open.values().map(|columns| columns.len() as u64);
        open.max().unwrap_or(1)
    }
}
