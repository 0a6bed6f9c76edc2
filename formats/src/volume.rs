//! An open volume: its header, and its voxels by planes or by boxes.
//!
//! Every format ends here. A source that can only be read once, front to back, gives
//! [`ForwardVoxels`]; one that can be read anywhere gives [`RandomVoxels`]. Voxels are bytes in
//! the header's type and byte order, x fastest, whatever order the file has.

use std::path::PathBuf;

use crate::error::Error;
use crate::header::{Header, Region};

/// An open volume.
pub struct Volume {
    /// What the file says about the volume.
    pub header: Header,
    /// Its voxels.
    pub voxels: Voxels,
    /// Where it comes from.
    pub source: SourceInfo,
}

/// How the voxels of a volume can be read.
pub enum Voxels {
    /// Once, planes in order.
    Forward(Box<dyn ForwardVoxels>),
    /// Any box, in any order, from any thread.
    Random(Box<dyn RandomVoxels>),
}

/// Where a volume comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceInfo {
    /// Path of the file, or the name given to the stream.
    pub name: String,
    /// The file that holds the voxels (the `.img` of a pair); `None` for a stream.
    pub path: Option<PathBuf>,
    /// Whether the voxels are compressed in the file.
    pub compressed: bool,
    /// Whether the voxels are mapped into memory.
    pub mapped: bool,
    /// Whether opening it again gives the same voxels: true for files, false for pipes.
    pub re_readable: bool,
    /// Bytes of the file that holds the voxels, compressed if it is; `None` for a stream.
    pub length_bytes: Option<u64>,
    /// Bytes of memory that the reader holds as long as it is open: a copied stream, an index of
    /// chunks. Buffers of a single read are not counted.
    pub held_bytes: u64,
    /// Bytes of a stream that were copied to disk.
    pub spilled_bytes: u64,
}

impl SourceInfo {
    /// Of something that can only be read once and is known by a name.
    pub fn stream(name: &str) -> Self {
        Self {
            name: name.to_string(),
            path: None,
            compressed: false,
            mapped: false,
            re_readable: false,
            length_bytes: None,
            held_bytes: 0,
            spilled_bytes: 0,
        }
    }
}

/// Planes in order of z, x fastest, bytes in the header's byte order.
pub trait ForwardVoxels: Send {
    /// Replaces `out` by the next `count` planes, fewer only where the volume ends, and gives
    /// their number: 0 after the last plane. `out` keeps its capacity, so a reused buffer is not
    /// allocated again.
    ///
    /// # Errors
    ///
    /// If the data ends before the volume does, is damaged, or cannot be read. The reader is of
    /// no further use then.
    fn read_planes(&mut self, count: u64, out: &mut Vec<u8>) -> Result<u64, Error>;

    /// Looks at what follows the last plane, so that checksums are verified, and gives warnings
    /// (for instance on bytes that belong to no voxel). Compressed data carries its checksum at
    /// the end, so what was read is only trustworthy after this.
    ///
    /// # Errors
    ///
    /// If a checksum is wrong or the data behind the voxels is damaged.
    fn finish(&mut self) -> Result<Vec<String>, Error>;
}

/// Any box of voxels, in any order, from any thread.
pub trait RandomVoxels: Send + Sync {
    /// Replaces `out` by the voxels of `region`, x fastest.
    ///
    /// # Errors
    ///
    /// If the region leaves the volume, or the bytes cannot be read or changed since the volume
    /// was opened.
    fn read_box(&self, region: &Region, out: &mut Vec<u8>) -> Result<(), Error>;

    /// The stored bytes of planes `z..z + count`, without a copy, where the file is mapped and
    /// stores x fastest; `None` otherwise. Call [`RandomVoxels::check`] after using them: only
    /// then is it known that they were the file's.
    ///
    /// # Errors
    ///
    /// If the planes leave the volume, or the file changed since it was opened.
    fn planes(&self, z: u64, count: u64) -> Result<Option<&[u8]>, Error>;

    /// To be called after the bytes given by [`RandomVoxels::planes`] were used.
    ///
    /// # Errors
    ///
    /// If the file changed under the map meanwhile: what was computed from the bytes is wrong.
    fn check(&self) -> Result<(), Error>;

    /// The shape, along x, y, z, of the pieces in which the voxels are decoded; `None` where any
    /// box costs as much as its bytes. Reading a part of a piece decodes all of it.
    fn chunk(&self) -> Option<[u64; 3]> {
        None
    }

    /// How many voxels of the first piece lie before voxel (0, 0, 0) along each axis, fewer than a
    /// piece has. Not 0 where the volume is cut out of a larger one.
    fn chunk_start(&self) -> [u64; 3] {
        [0; 3]
    }

    /// Bytes of memory that a read of one piece takes beside the box it is read into: the piece as
    /// it is stored and as it is decoded, which may be far more than the voxels of this volume
    /// where a piece goes on along further axes (times, channels).
    fn decode_bytes(&self) -> u64 {
        0
    }

    /// The value, as the bytes of one voxel (the first of the eight), that all voxels of `region`
    /// have, where that is known without reading them. `None` says nothing.
    fn uniform(&self, region: &Region) -> Option<[u8; 8]> {
        let _ = region;
        None
    }

    /// Says that planes before `z_end` are not needed for now, so that they do not count in this
    /// process's resident memory. They can be read again all the same.
    fn release(&self, z_end: u64) {
        let _ = z_end;
    }
}

impl Volume {
    /// The voxels as planes in order, whatever the source can do. Pieces are decoded once for all
    /// planes in them, as far as those take no more than 256 MiB together.
    pub fn into_forward(self) -> Box<dyn ForwardVoxels> {
        match self.voxels {
            Voxels::Forward(voxels) => voxels,
            Voxels::Random(voxels) => Box::new(InOrder::new(voxels, &self.header)),
        }
    }
}

/// Bytes of planes that are read together at most, so that a piece is decoded once for all of them.
const LAYER_BYTES: u64 = 256 << 20;

/// Random access read in order.
struct InOrder {
    voxels: Box<dyn RandomVoxels>,
    dims: [u64; 3],
    plane_bytes: u64,
    next: u64,
    /// The planes of a layer of pieces, from `layer_start` on; empty where voxels have no pieces.
    layer: Vec<u8>,
    layer_start: u64,
    layer_end: u64,
}

impl InOrder {
    fn new(voxels: Box<dyn RandomVoxels>, header: &Header) -> Self {
        Self {
            voxels,
            dims: header.dims,
            plane_bytes: header.plane_bytes().unwrap_or(u64::MAX),
            next: 0,
            layer: Vec::new(),
            layer_start: 0,
            layer_end: 0,
        }
    }

    fn read(&self, z: u64, count: u64, out: &mut Vec<u8>) -> Result<(), Error> {
        let [x, y, _] = self.dims;
        let region = Region {
            origin: [0, 0, z],
            size: [x, y, count],
        };
        self.voxels.read_box(&region, out)
    }

    /// Where planes from `z` on that are read together end: with the pieces they are in, or before
    /// where those are too large.
    fn end_of_layer(&self, z: u64, thickness: u64) -> u64 {
        let most = (LAYER_BYTES / self.plane_bytes.max(1)).max(1);
        let before = self.voxels.chunk_start()[2];
        let end = ((z + before) / thickness + 1).saturating_mul(thickness) - before;
        end.min(z + most).min(self.dims[2])
    }
}

impl ForwardVoxels for InOrder {
    fn read_planes(&mut self, count: u64, out: &mut Vec<u8>) -> Result<u64, Error> {
        out.clear();
        let count = count.min(self.dims[2] - self.next);
        let thickness = self.voxels.chunk().map_or(1, |chunk| chunk[2]);
        if count == 0 {
            return Ok(0);
        }
        if thickness <= 1 {
            self.read(self.next, count, out)?;
            self.next += count;
        } else {
            let end = self.next + count;
            while self.next < end {
                if self.next == self.layer_end {
                    let mut layer = std::mem::take(&mut self.layer);
                    let layer_end = self.end_of_layer(self.next, thickness);
                    self.read(self.next, layer_end - self.next, &mut layer)?;
                    (self.layer, self.layer_start, self.layer_end) = (layer, self.next, layer_end);
                }
                let until = end.min(self.layer_end);
                let place = |z: u64| ((z - self.layer_start) * self.plane_bytes) as usize;
                out.extend_from_slice(&self.layer[place(self.next)..place(until)]);
                self.next = until;
            }
        }
        self.voxels.release(self.next);
        Ok(count)
    }

    fn finish(&mut self) -> Result<Vec<String>, Error> {
        self.voxels.check()?;
        Ok(Vec::new())
    }
}

impl std::fmt::Debug for Volume {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let voxels = match self.voxels {
            Voxels::Forward(_) => "Forward",
            Voxels::Random(_) => "Random",
        };
        f.debug_struct("Volume")
            .field("header", &self.header)
            .field("voxels", &voxels)
            .field("source", &self.source)
            .finish()
    }
}
