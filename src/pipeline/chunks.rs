//! How a volume in pieces is read within the memory allowed.
//!
//! Comes in: the shape of the pieces. Goes out: a [`ChunkPlan`]. Planes are read in layers as thick
//! as a piece, so that each piece is decoded once; the bits of a layer, 1/8 to 1/64 of its values, are
//! held until they are handed on. Where they do not fit, layers are thinner than pieces and
//! each piece is decoded again for each: the plan says how often.
//!
//! A task reads a band, the rows of some pieces, box by box along x. How many tasks run at once is
//! bounded by the memory of their boxes.

use serde::Serialize;

use crate::volume::{PieceGrid, TILE_WIDTH};

use super::access::{Access, Sparse};

/// Stored bytes of a box, if a piece is not larger. Larger ones only take memory; smaller ones
/// leave less to do between two questions to the source.
const BOX_BYTES: u64 = 4 << 20;

/// How a volume in pieces is read.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChunkPlan {
    /// Shape of the pieces in which voxels are decoded.
    pub shape: [u64; 3],
    /// The same, and where they begin.
    #[serde(skip)]
    pub pieces: PieceGrid,
    /// How often each piece is decoded.
    pub decoded_times: u64,
    /// Planes read before they are handed on.
    pub layer_planes: u64,
    /// Rows of a task.
    pub band_rows: u64,
    /// Columns of a box.
    pub box_columns: u64,
    /// Tasks at once.
    pub readers: usize,
    /// Tiles of 64 voxels by `band_rows` rows by `layer_planes` planes that are read, where the rest of the
    /// volume is known to be uniform.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tiles: Option<u64>,
    /// Memory for the index of surfels, where it depends on how they are scattered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub index_bytes: Option<u64>,
}

/// A plan to read pieces and what it takes.
pub(super) struct Reading {
    pub(super) plan: ChunkPlan,
    /// Memory of the boxes.
    pub(super) box_bytes: u64,
}

impl ChunkPlan {
    /// The plan for layers of some planes.
    pub(super) fn reading(
        access: &Access,
        pieces: PieceGrid,
        dims: [u64; 3],
        layer_planes: u64,
        threads: usize,
        memory_bytes: u64,
    ) -> Reading {
        let product = |extents: [u64; 3]| {
            let voxels = extents.into_iter().fold(1, u64::saturating_mul);
            voxels.saturating_mul(access.voxel_bytes)
        };
        let shape = pieces.shape;
        let band_rows = pieces.band_rows(dims);
        let thickness = if access.sparse.is_some() {
            layer_planes
        } else {
            layer_planes.min(shape[2])
        };
        let of_box =
            |columns: u64| product([columns.min(dims[0]), band_rows, thickness.min(dims[2])]);
        let across = (BOX_BYTES / of_box(shape[0]).max(1)).clamp(1, dims[0].div_ceil(shape[0]));
        let box_columns = across.saturating_mul(shape[0]);
        let task_bytes = of_box(box_columns).saturating_add(access.decode_bytes);
        let readers = (memory_bytes / 8 / task_bytes.max(1)).clamp(1, threads as u64);
        Reading {
            box_bytes: readers.saturating_mul(task_bytes),
            plan: Self {
                shape,
                pieces,
                decoded_times: shape[2].min(dims[2]).div_ceil(layer_planes).max(1),
                layer_planes,
                band_rows,
                box_columns,
                readers: readers as usize,
                tiles: access.sparse.as_ref().map(|sparse| sparse.tiles),
                index_bytes: None,
            },
        }
    }

    /// Thicknesses of layers that may be tried, the best first.
    pub(super) fn heights(
        access: &Access,
        pieces: PieceGrid,
        depth: u64,
        read_planes: u64,
    ) -> impl Iterator<Item = u64> {
        let piece = pieces.shape[2].min(depth);
        let best = match &access.sparse {
            Some(sparse) => sparse.layer_planes,
            // Several layers of thin pieces at a time, as planes would be read.
            None => piece * (read_planes / piece).max(1),
        };
        let fixed = access.sparse.is_some();
        std::iter::successors(Some(best), move |&planes| {
            (!fixed && planes > 1).then(|| {
                if planes > piece {
                    piece
                } else {
                    planes.div_ceil(2)
                }
            })
        })
    }
}

impl Sparse {
    /// Memory of `planes` consecutive planes at most, of which each row of a tile takes `row_bytes`.
    pub(super) fn window_bytes(&self, planes: u64, band_rows: u64, row_bytes: u64) -> u64 {
        let of_layer = |layer: &super::access::SparseLayer| {
            let tile = band_rows * row_bytes * (layer.z.end - layer.z.start);
            layer.tiles.saturating_mul(tile) + layer.map_bytes
        };
        let (mut most, mut held, mut first) = (0u64, 0u64, 0);
        for layer in &self.layers {
            held = held.saturating_add(of_layer(layer));
            while self.layers[first].z.end + planes <= layer.z.start {
                held -= of_layer(&self.layers[first]);
                first += 1;
            }
            most = most.max(held);
        }
        most
    }

    /// Bytes of a row of a tile as stored.
    pub(super) fn grey_row_bytes(voxel_bytes: u64) -> u64 {
        u64::from(TILE_WIDTH) * voxel_bytes
    }
}
