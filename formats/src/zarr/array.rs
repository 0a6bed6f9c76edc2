//! What is known of an array in chunks before a chunk is read, for Zarr and N5 alike.

use crate::error::Error;
use crate::header::{DType, Format};
use crate::store::join;
use crate::zarr::chain::Chain;
use crate::zarr::json::Document;

/// The largest chunk that is decoded: the codecs of numcodecs stop there, too.
const MOST_CHUNK_BYTES: u64 = (1 << 31) - 1;

/// An array in chunks. Axes are in the order of the metadata, for N5 backwards, so that a plain
/// array ends with (z, y, x).
#[derive(Clone, Debug)]
pub(crate) struct Array {
    pub(crate) format: Format,
    /// Key of the array in its store.
    pub(crate) key: String,
    pub(crate) shape: Vec<u64>,
    /// Shape of what one object holds: a chunk, or a shard of chunks.
    pub(crate) grid: Vec<u64>,
    pub(crate) shard: Option<Shard>,
    pub(crate) dtype: DType,
    /// A voxel of a chunk that is not there, in the type and byte order of the voxels.
    pub(crate) fill: [u8; 8],
    pub(crate) keys: Keys,
    /// Axes of a decoded chunk from the slowest to the fastest.
    pub(crate) memory: Vec<usize>,
    pub(crate) chain: Chain,
    /// Names of the axes, where the metadata has them.
    pub(crate) axes: Option<Vec<String>>,
    /// Attributes of the user.
    pub(crate) attributes: Document,
}

/// Chunks within an object.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Shard {
    /// Shape of a chunk.
    pub(crate) inner: Vec<u64>,
    /// Chunks in a shard along each axis.
    pub(crate) count: Vec<u64>,
    /// Axes from the slowest to the fastest in the index.
    pub(crate) order: Vec<usize>,
    pub(crate) big_endian: bool,
    pub(crate) checksum: bool,
    pub(crate) at_end: bool,
}

impl Shard {
    /// Bytes of the index with its checksum; `None` when that does not fit.
    pub(crate) fn index_bytes(&self) -> Option<u64> {
        product(&self.count)?
            .checked_mul(16)?
            .checked_add(if self.checksum { 4 } else { 0 })
    }
}

/// How the key of an object is made of its place in the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Keys {
    /// `c/0/1/2`.
    Default { separator: char },
    /// `0.1.2`.
    Plain { separator: char },
    /// `2/1/0`, x first.
    N5,
}

impl Keys {
    pub(crate) fn key(self, array: &str, index: &[u64]) -> String {
        let numbers = |separator: &str, index: &mut dyn Iterator<Item = &u64>| {
            index
                .map(u64::to_string)
                .collect::<Vec<_>>()
                .join(separator)
        };
        let below = match self {
            Self::Default { separator } => {
                let separator = separator.to_string();
                format!("c{separator}{}", numbers(&separator, &mut index.iter()))
            }
            Self::Plain { separator } => numbers(&separator.to_string(), &mut index.iter()),
            Self::N5 => numbers("/", &mut index.iter().rev()),
        };
        join(array, &below)
    }
}

impl Array {
    /// Shape of what is decoded at once.
    pub(crate) fn chunk(&self) -> &[u64] {
        match &self.shard {
            Some(shard) => &shard.inner,
            None => &self.grid,
        }
    }

    /// Bytes of a decoded chunk.
    pub(crate) fn chunk_bytes(&self) -> u64 {
        // Checked by `check`.
        product(self.chunk()).unwrap_or(0) * self.dtype.voxel.bytes() as u64
    }

    /// Refuses shapes that contradict each other or that no memory holds.
    pub(crate) fn check(&self, document: &Document) -> Result<(), Error> {
        let axes = self.shape.len();
        if self.grid.len() != axes {
            return Err(document.invalid(format!(
                "chunks of {} axes in an array of {axes}",
                self.grid.len()
            )));
        }
        let bytes = product(self.chunk())
            .and_then(|voxels| voxels.checked_mul(self.dtype.voxel.bytes() as u64));
        if bytes.is_none_or(|bytes| bytes > MOST_CHUNK_BYTES) {
            return Err(document.unsupported(format!(
                "chunks of {} voxels of {} are more than the {MOST_CHUNK_BYTES} bytes read at once",
                shape_text(self.chunk()),
                self.dtype,
            )));
        }
        if let Some(shard) = &self.shard {
            let most = MOST_CHUNK_BYTES / 32;
            if shard.index_bytes().is_none_or(|bytes| bytes > most) {
                return Err(document.unsupported(format!(
                    "shards of {} chunks have an index of more than {most} bytes",
                    shape_text(&shard.count)
                )));
            }
        }
        Ok(())
    }
}

/// Product of extents, if it fits.
pub(crate) fn product(extents: &[u64]) -> Option<u64> {
    extents
        .iter()
        .try_fold(1_u64, |product, extent| product.checked_mul(*extent))
}

/// Extents for print, in the order of the metadata.
pub(crate) fn shape_text(shape: &[u64]) -> String {
    shape
        .iter()
        .map(u64::to_string)
        .collect::<Vec<_>>()
        .join(" x ")
}
