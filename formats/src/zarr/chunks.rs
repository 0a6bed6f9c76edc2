//! Chunks of an array, read and decoded one by one, as pieces of a volume.
//!
//! In: an array, its store, and the view that picks three axes of it. Out: [`Chunks`]. A chunk of
//! a shard is read alone; the index of a shard is read once, and kept as long as there is room.
//! Guaranteed: what is read of an object is bounded by what its codecs can make of a chunk; a
//! damaged chunk is an error that names its object, and its place there.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

use crate::chunked::Chunks;
use crate::codec;
use crate::error::Error;
use crate::store::{Part, Stamp, Store};
use crate::zarr::array::{Array, Keys, Shard, product};
use crate::zarr::n5;
use crate::zarr::view::View;

/// Bytes of shard indices that are kept. Less than the indices of a layer of shards, and they are
/// read again for every layer of chunks.
pub(crate) const KEPT_INDEX_BYTES: u64 = 64 << 20;

/// The chunks of a volume.
pub(crate) struct ArrayChunks {
    store: Arc<dyn Store>,
    array: Array,
    view: View,
    indices: Mutex<Indices>,
    /// Pairs of buffers, to be used again.
    spare: Mutex<Vec<[Vec<u8>; 2]>>,
}

/// Where the chunks of a shard are; `None` for one that is not there.
struct Index {
    stamp: Option<Stamp>,
    /// Offset and size.
    entries: Vec<(u64, u64)>,
}

/// An index that is being read by the first who needs it.
type Slot = Arc<Mutex<Option<Arc<Index>>>>;

/// The indices kept, by the places of their shards, and these places, the oldest first.
#[derive(Default)]
struct Indices {
    slots: HashMap<Vec<u64>, Slot>,
    order: VecDeque<Vec<u64>>,
}

/// Marks a chunk that is not in its shard.
const NOT_THERE: (u64, u64) = (u64::MAX, u64::MAX);

impl ArrayChunks {
    pub(crate) fn new(store: Arc<dyn Store>, array: Array, view: View) -> Self {
        Self {
            store,
            array,
            view,
            indices: Mutex::default(),
            spare: Mutex::default(),
        }
    }

    /// Shape of a piece of the volume: a chunk, or what there is of it where there is but one.
    pub(crate) fn piece(&self) -> [u64; 3] {
        let (chunk, dims) = (self.array.chunk(), &self.array.shape);
        self.view
            .axes
            .map(|axis| chunk[axis].min(dims[axis].max(1)))
    }

    /// Place in the grid of chunks of a piece of the volume.
    fn place(&self, index: [u64; 3]) -> Vec<u64> {
        let mut place = vec![0; self.array.shape.len()];
        for (axis, entry) in &self.view.fixed {
            place[*axis] = entry / self.array.chunk()[*axis];
        }
        for (axis, number) in self.view.axes.iter().zip(index) {
            place[*axis] = number;
        }
        place
    }

    /// Reads the encoded chunk, and gives the name of its object and the offset in it; `None`
    /// where it is not there.
    fn read(&self, place: &[u64], out: &mut Vec<u8>) -> Result<Option<(String, u64)>, Error> {
        let array = &self.array;
        let most = array.chain.encoded_most(array.chunk_bytes());
        let Some(shard) = &array.shard else {
            let key = array.keys.key(&array.key, place);
            let most = match array.keys {
                Keys::N5 => most.saturating_add(n5::HEADER_MOST),
                _ => most,
            };
            let found = self.store.get(&key, Part::All { most }, out)?;
            return Ok(found.map(|_| (self.store.name(&key), 0)));
        };
        let (outer, within) = split(shard, place);
        let key = array.keys.key(&array.key, &outer);
        let index = self.index(shard, &outer, &key)?;
        let entry = index.entries.get(within).copied().unwrap_or(NOT_THERE);
        if entry == NOT_THERE {
            return Ok(None);
        }
        let (offset, count) = entry;
        let name = self.store.name(&key);
        if count > most {
            return Err(Error::invalid(
                &name,
                format!(
                    "chunk {within} of the shard has {count} bytes, at most {most} are expected"
                ),
            )
            .at(offset));
        }
        let Some(stamp) = self.store.get(&key, Part::At { offset, count }, out)? else {
            return Err(changed(&name));
        };
        if index.stamp.as_ref().is_none_or(|read| read.differs(&stamp)) {
            return Err(changed(&name));
        }
        Ok(Some((name, offset)))
    }

    /// The index of a shard: kept, or read by whoever comes first.
    fn index(&self, shard: &Shard, outer: &[u64], key: &str) -> Result<Arc<Index>, Error> {
        let slot = {
            let mut kept = self.indices.lock().unwrap_or_else(PoisonError::into_inner);
            match kept.slots.get(outer) {
                Some(slot) => Arc::clone(slot),
                None => {
                    let bytes = shard.index_bytes().unwrap_or(u64::MAX).max(64);
                    let room = (KEPT_INDEX_BYTES / bytes).max(1);
                    while kept.order.len() as u64 >= room {
                        if let Some(oldest) = kept.order.pop_front() {
                            kept.slots.remove(&oldest);
                        }
                    }
                    let slot = Slot::default();
                    kept.slots.insert(outer.to_vec(), Arc::clone(&slot));
                    kept.order.push_back(outer.to_vec());
                    slot
                }
            }
        };
        let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(index) = &*slot {
            return Ok(Arc::clone(index));
        }
        let index = Arc::new(self.read_index(shard, key)?);
        *slot = Some(Arc::clone(&index));
        Ok(index)
    }

    fn read_index(&self, shard: &Shard, key: &str) -> Result<Index, Error> {
        let count = shard.index_bytes().unwrap_or(u64::MAX);
        let part = if shard.at_end {
            Part::Last { count }
        } else {
            Part::At { offset: 0, count }
        };
        let mut bytes = Vec::new();
        let Some(stamp) = self.store.get(key, part, &mut bytes)? else {
            return Ok(Index {
                stamp: None,
                entries: Vec::new(),
            });
        };
        let content = if shard.checksum {
            codec::crc32c(&bytes).map_err(|e| {
                let name = self.store.name(key);
                Error::invalid(name, format!("the index of the shard: {}", e.message()))
            })?
        } else {
            &bytes
        };
        let (numbers, _) = content.as_chunks::<8>();
        let number = |bytes: &[u8; 8]| {
            if shard.big_endian {
                u64::from_be_bytes(*bytes)
            } else {
                u64::from_le_bytes(*bytes)
            }
        };
        let (pairs, _) = numbers.as_chunks::<2>();
        let entries = pairs
            .iter()
            .map(|[offset, size]| (number(offset), number(size)))
            .collect();
        Ok(Index {
            stamp: Some(stamp),
            entries,
        })
    }

    /// Decodes the chunk in the first buffer and gives the shape it has.
    fn decode_chunk(
        &self,
        place: &[u64],
        [data, spare]: &mut [Vec<u8>; 2],
        name: &str,
    ) -> Result<Vec<u64>, Error> {
        let array = &self.array;
        let shape = match array.keys {
            Keys::N5 => n5::block(name, data, array, place)?,
            _ => array.chunk().to_vec(),
        };
        // Not more than a chunk, which was checked.
        let bytes = product(&shape).unwrap_or(0) * array.dtype.voxel.bytes() as u64;
        let bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
        array
            .chain
            .decode(bytes, data, spare)
            .map_err(|e| e.of(name))?;
        Ok(shape)
    }

    /// Replaces `out` by the view's part of a decoded chunk of the given shape, which holds all
    /// of the array that lies in the chunk.
    fn gather(&self, data: &mut Vec<u8>, shape: &[u64], out: &mut Vec<u8>) {
        let bytes = self.array.dtype.voxel.bytes();
        let mut stride = vec![0_u64; shape.len()];
        let mut step = 1;
        for &axis in self.array.memory.iter().rev() {
            stride[axis] = step;
            // Not more than a chunk's voxels.
            step *= shape[axis];
        }
        let base = self.view.fixed.iter().fold(0, |base, (axis, entry)| {
            base + entry % self.array.chunk()[*axis] * stride[*axis]
        });
        let piece = self.piece();
        let held = self.view.pick(shape);
        let size = [0, 1, 2].map(|a| held[a].min(piece[a]));
        let steps = self.view.pick(&stride);
        if base == 0
            && size == piece
            && steps == [1, piece[0], piece[0] * piece[1]]
            && data.len() as u64 == piece[0] * piece[1] * piece[2] * bytes as u64
        {
            std::mem::swap(data, out);
            return;
        }
        // All within a chunk that is in memory, so the casts are exact.
        let [px, py, pz] = piece.map(|n| n as usize);
        let [nx, ny, nz] = size.map(|n| n as usize);
        let [sx, sy, sz] = steps.map(|n| n as usize * bytes);
        let base = base as usize * bytes;
        out.clear();
        out.resize(px * py * pz * bytes, 0);
        for z in 0..nz {
            for y in 0..ny {
                let from = &data[base + z * sz + y * sy..];
                let to = (z * py + y) * px * bytes;
                let to = &mut out[to..to + nx * bytes];
                if sx == bytes {
                    to.copy_from_slice(&from[..nx * bytes]);
                } else {
                    match bytes {
                        1 => spread::<1>(from, sx, to),
                        2 => spread::<2>(from, sx, to),
                        4 => spread::<4>(from, sx, to),
                        _ => spread::<8>(from, sx, to),
                    }
                }
            }
        }
    }
}

/// Copies voxels of `N` bytes that stand `step` bytes apart.
fn spread<const N: usize>(from: &[u8], step: usize, to: &mut [u8]) {
    let (to, _) = to.as_chunks_mut::<N>();
    for (voxel, from) in to.iter_mut().zip(from.chunks(step)) {
        if let Some(from) = from.first_chunk::<N>() {
            *voxel = *from;
        }
    }
}

/// The place of the shard of a chunk, and the number of the chunk in its index.
fn split(shard: &Shard, place: &[u64]) -> (Vec<u64>, usize) {
    let outer = place.iter().zip(&shard.count).map(|(p, n)| p / n).collect();
    let within = shard.order.iter().fold(0, |number, &axis| {
        number * shard.count[axis] + place[axis] % shard.count[axis]
    });
    (outer, usize::try_from(within).unwrap_or(usize::MAX))
}

fn changed(name: &str) -> Error {
    Error::invalid(
        name,
        "changed while it was read: its index is of another version",
    )
}

impl Chunks for ArrayChunks {
    fn whole_bytes(&self) -> Option<u64> {
        product(self.array.chunk())?.checked_mul(self.array.dtype.voxel.bytes() as u64)
    }

    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
        let place = self.place(index);
        let mut buffers = self
            .spare
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop()
            .unwrap_or_default();
        match self.read(&place, &mut buffers[0])? {
            None => {
                let voxel = &self.array.fill[..self.array.dtype.voxel.bytes()];
                let count = product(&self.piece()).unwrap_or(0);
                out.clear();
                out.extend(voxel.iter().cycle().take(count as usize * voxel.len()));
            }
            Some((name, offset)) => {
                let failed = |e: Error| if offset > 0 { e.at(offset) } else { e };
                let shape = self
                    .decode_chunk(&place, &mut buffers, &name)
                    .map_err(failed)?;
                self.gather(&mut buffers[0], &shape, out);
            }
        }
        self.spare
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(buffers);
        Ok(())
    }

    fn uniform(&self, index: [u64; 3]) -> Option<[u8; 8]> {
        let place = self.place(index);
        let missing = match &self.array.shard {
            None => {
                let key = self.array.keys.key(&self.array.key, &place);
                self.store.lacks(&key)
            }
            Some(shard) => {
                let (outer, within) = split(shard, &place);
                let key = self.array.keys.key(&self.array.key, &outer);
                // What is wrong with an index is said when the chunk is decoded.
                let index = self.index(shard, &outer, &key).ok()?;
                let entry = index.entries.get(within).copied();
                entry.is_none_or(|entry| entry == NOT_THERE)
            }
        };
        missing.then_some(self.array.fill)
    }
}
