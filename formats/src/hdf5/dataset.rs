//! A dataset as a volume: which of its axes are x, y and z, and its voxels.
//!
//! In: a dataset, and what the caller chose of further axes. Out: a volume. Contiguous and
//! compact datasets are plain bytes, mapped in place; chunks are found and decoded one by one;
//! where further axes lie between or behind x, y and z, voxels are picked out one by one.

use std::borrow::Cow;
use std::sync::Arc;

use super::attribute::{Attributes, numbers};
use super::file::File;
use super::filter;
use super::index::Index;
use super::message::{Chunking, Dataspace, Datatype, Filter, Layout, What, fill, filters};
use super::object::{Object, kind};
use crate::chunked::{ChunkedVoxels, Chunks};
use crate::codec::{CodecError, exactly};
use crate::error::Error;
use crate::header::{DType, Format, Header};
use crate::order::AxisOrder;
use crate::stored::StoredVoxels;
use crate::volume::RandomVoxels;

/// A dataset whose voxels are not looked at yet.
pub(super) struct Dataset {
    pub(super) path: String,
    pub(super) object: Object,
    pub(super) dims: Vec<u64>,
    pub(super) datatype: Datatype,
    space: Dataspace,
}

impl Dataset {
    /// The dataset that an object is, if it is one.
    pub(super) fn of(file: &File, object: Object, path: &str) -> Result<Option<Self>, Error> {
        let space = object.first(file, kind::DATASPACE)?;
        let datatype = Datatype::of(file, &object)?;
        let (Some(space), Some(datatype), true) = (space, datatype, object.has(kind::LAYOUT))
        else {
            return Ok(None);
        };
        let space = Dataspace::read(&mut space.fields(file))?;
        Ok(Some(Self {
            path: path.to_owned(),
            dims: space.dims.clone(),
            object,
            datatype,
            space,
        }))
    }

    /// Path, extents and type, as a list of datasets shows them.
    pub(super) fn describe(&self) -> String {
        let dims: Vec<_> = self.dims.iter().map(u64::to_string).collect();
        let what = match &self.datatype.what {
            What::Number(dtype) => dtype.to_string(),
            what => what.name().to_owned(),
        };
        match dims.as_slice() {
            [] => format!("{} ({what})", self.path),
            _ => format!("{} ({} {what})", self.path, dims.join(" x ")),
        }
    }

    /// The type of the voxels, if these are numbers.
    pub(super) fn dtype(&self) -> Option<DType> {
        match self.datatype.what {
            What::Number(dtype) => Some(dtype),
            _ => None,
        }
    }

    pub(super) fn attributes(&self, file: &File) -> Result<Attributes, Error> {
        Attributes::read(file, &self.object)
    }

    fn layout(&self, file: &File) -> Result<Layout, Error> {
        match self.object.first(file, kind::LAYOUT)? {
            Some(message) => Layout::read(&message, file),
            None => Err(self.invalid(file, "has no layout")),
        }
    }

    fn invalid(&self, file: &File, what: impl std::fmt::Display) -> Error {
        Error::invalid(file.name(), format!("dataset {} {what}", self.path))
            .at(file.place(self.object.address))
    }

    fn unsupported(&self, file: &File, what: impl std::fmt::Display) -> Error {
        Error::unsupported(file.name(), format!("dataset {} {what}", self.path))
    }

    /// The values of a dataset of at most one axis, as numbers: positions along an axis.
    pub(super) fn values(&self, file: &Arc<File>) -> Result<Option<Vec<f64>>, Error> {
        /// More than any axis has.
        const MOST: u64 = 1 << 20;
        let count = self.space.count().unwrap_or(u64::MAX);
        let (Some(dtype), 0..=1, 1..=MOST) = (self.dtype(), self.dims.len(), count) else {
            return Ok(None);
        };
        if self.object.has(kind::EXTERNAL) || matches!(self.layout(file)?, Layout::Virtual) {
            return Ok(None);
        }
        // One row of voxels; a single value is one of one.
        let row = Self {
            path: self.path.clone(),
            object: Object::read(file, self.object.address)?,
            dims: if self.dims.is_empty() {
                vec![1]
            } else {
                self.dims.clone()
            },
            datatype: self.datatype.clone(),
            space: self.space.clone(),
        };
        let selection = Selection {
            volume: [None, None, Some(0)],
            fixed: vec![0],
        };
        let voxels = row.voxels(
            file,
            &selection,
            &mut Header::new(Format::Hdf5, [count, 1, 1], dtype),
        )?;
        let mut bytes = Vec::new();
        voxels.read_box(&crate::header::Region::whole([count, 1, 1]), &mut bytes)?;
        Ok(Some(numbers(dtype, &bytes)))
    }

    /// What is known of the volume that `selection` leaves, apart from the world.
    pub(super) fn header(&self, file: &File, selection: &Selection) -> Result<Header, Error> {
        let Some(dtype) = self.dtype() else {
            let what = self.datatype.what.name();
            return Err(self.unsupported(file, format!("is a dataset of {what}, not of numbers")));
        };
        if self.dims.contains(&0) {
            return Err(self.invalid(
                file,
                format!("has no voxels: its extents are {:?}", self.dims),
            ));
        }
        let extent = |axis: Option<usize>| axis.map_or(1, |axis| self.dims[axis]);
        let [z, y, x] = selection.volume;
        let mut header = Header::new(Format::Hdf5, [extent(x), extent(y), extent(z)], dtype);
        header.details.push(("dataset", self.path.clone()));
        Ok(header)
    }

    /// The voxels of a volume that begins where `selection` says and has the extents of `header`,
    /// at most those of the dataset.
    pub(super) fn voxels(
        &self,
        file: &Arc<File>,
        selection: &Selection,
        header: &mut Header,
    ) -> Result<Box<dyn RandomVoxels>, Error> {
        if self.object.has(kind::EXTERNAL) {
            return Err(
                self.unsupported(file, "keeps its voxels in an external file: not read here")
            );
        }
        let bytes = header.voxel.bytes();
        let whole = self
            .dims
            .iter()
            .try_fold(bytes as u64, |n, d| n.checked_mul(*d))
            .ok_or_else(|| {
                self.invalid(file, format!("of extents {:?} is too large", self.dims))
            })?;
        let fill = fill(file, &self.object, bytes)?;
        let (address, held) = match self.layout(file)? {
            Layout::Virtual => {
                return Err(self.unsupported(
                    file,
                    "is a virtual dataset, whose voxels are in other files: not read here",
                ));
            }
            Layout::Chunked(chunking) => {
                return self.chunked(file, selection, header, chunking, fill);
            }
            Layout::Compact { address, bytes } => (Some(address), Some(bytes)),
            Layout::Contiguous { address } => (address, None),
        };
        if let Some(held) = held
            && held < whole
        {
            return Err(self.invalid(file, format!("has {held} bytes, {whole} expected")));
        }
        let Some(address) = address else {
            // Never written: everything is the fill value.
            /// Pieces of what is the same everywhere; only whoever insists decodes one.
            const EDGE: u64 = 64;
            let dims = self.dims.iter().map(|n| (*n).min(EDGE)).collect();
            let chunking = Chunking::empty(dims);
            return self.chunked(file, selection, header, chunking, fill);
        };
        // Reported now rather than by the read that meets the end.
        let place = file.place(address);
        if place
            .checked_add(whole)
            .is_none_or(|end| end > file.bytes().len())
        {
            return Err(self
                .invalid(
                    file,
                    format!(
                        "ends early: {whole} bytes expected at byte {place}, the file has {}",
                        file.bytes().len()
                    ),
                )
                .at(place));
        }
        header.details.push(("layout", "contiguous".into()));
        let strides = strides(&self.dims);
        let start = selection.start(&strides);
        let [nx, ny, _] = header.dims;
        let [z, y, x] = selection.strides(&strides);
        if let Some(order) = plain_order(header.dims, [x, y, z]) {
            let offset = place + start * bytes as u64;
            let bytes = file.bytes().clone();
            return Ok(Box::new(StoredVoxels::new(
                bytes,
                file.name(),
                offset,
                header,
                order,
            )));
        }
        let planes = Planes {
            file: Arc::clone(file),
            place,
            pick: Pick {
                start,
                strides: [z, y, x],
                size: [1, ny, nx],
                bytes,
            },
        };
        let chunk = [nx, ny, 1];
        Ok(Box::new(ChunkedVoxels::new(
            file.name(),
            header,
            chunk,
            Box::new(planes),
        )))
    }

    fn chunked(
        &self,
        file: &Arc<File>,
        selection: &Selection,
        header: &mut Header,
        chunking: Chunking,
        fill: [u8; 8],
    ) -> Result<Box<dyn RandomVoxels>, Error> {
        /// As for HDF5 itself.
        const MOST_BYTES: u64 = u32::MAX as u64;
        let bytes = header.voxel.bytes();
        let chunk = &chunking.dims;
        let fits = chunk.len() == self.dims.len()
            && chunk
                .iter()
                .zip(&self.space.most)
                .all(|(n, most)| *n > 0 && most.is_none_or(|most| *n <= most.max(1)));
        let chunk_bytes = chunk
            .iter()
            .try_fold(bytes as u64, |n, d| n.checked_mul(*d))
            .filter(|n| fits && *n <= MOST_BYTES)
            .and_then(|n| usize::try_from(n).ok());
        let Some(chunk_bytes) = chunk_bytes else {
            return Err(self.invalid(
                file,
                format!("of extents {:?} has chunks of {chunk:?}", self.dims),
            ));
        };
        let filters = match self.object.first(file, kind::FILTERS)? {
            Some(message) => filters(&message, file)?,
            None => Vec::new(),
        };
        if let Some(unknown) = filters.iter().find(|filter| !filter::is_known(filter)) {
            return Err(self.unsupported(
                file,
                format!(
                    "is compressed with {}, which is not read here; h5repack can write it with \
                     another filter",
                    filter::name(unknown)
                ),
            ));
        }
        let index = Index::open(file, &chunking, &self.space, chunk_bytes as u64)?;
        let names: Vec<_> = filters.iter().map(filter::name).collect();
        if !names.is_empty() {
            header.details.push(("compression", names.join(", ")));
        }
        let [z, y, x] = selection.volume;
        let extent = |axis: Option<usize>| axis.map_or(1, |axis| chunk[axis]);
        let shape = [extent(x), extent(y), extent(z)];
        let [cx, cy, cz] = shape;
        header
            .details
            .push(("chunks", format!("{cx} x {cy} x {cz} ({})", index.name())));
        // Where the chosen planes of further axes are in their chunks.
        let within = Selection {
            volume: selection.volume,
            fixed: selection
                .fixed
                .iter()
                .zip(chunk)
                .map(|(at, n)| at % n)
                .collect(),
        };
        let strides = strides(chunk);
        let chunks = ChunkedDataset {
            numbers: selection
                .fixed
                .iter()
                .zip(chunk)
                .map(|(at, n)| at / n)
                .collect(),
            pick: Pick {
                start: within.start(&strides),
                strides: within.strides(&strides),
                size: [cz, cy, cx],
                bytes,
            },
            file: Arc::clone(file),
            path: self.path.clone(),
            dims: self.dims.clone(),
            volume: selection.volume,
            edges_unfiltered: chunking.edges_unfiltered,
            chunk: chunking.dims,
            chunk_bytes,
            index,
            filters,
            fill,
        };
        Ok(Box::new(ChunkedVoxels::new(
            file.name(),
            header,
            shape,
            Box::new(chunks),
        )))
    }
}

/// Values from one to the next along each axis.
fn strides(dims: &[u64]) -> Vec<u64> {
    let mut strides = vec![1; dims.len()];
    for axis in (1..dims.len()).rev() {
        strides[axis - 1] = strides[axis] * dims[axis];
    }
    strides
}

/// The order of the axes of voxels that lie one behind the other, if they do; strides are along x,
/// y, z, and that of an axis of extent 1 does not count.
fn plain_order(dims: [u64; 3], strides: [u64; 3]) -> Option<AxisOrder> {
    let orders = [
        [0, 1, 2],
        [0, 2, 1],
        [1, 0, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
    ];
    orders.into_iter().map(AxisOrder::of).find(|order| {
        let plain = order.strides(dims);
        (0..3).all(|a| dims[a] == 1 || plain[a] == strides[a])
    })
}

/// Which part of a dataset is the volume.
pub(super) struct Selection {
    /// Its axes z, y and x; one that is missing has extent 1.
    pub(super) volume: [Option<usize>; 3],
    /// For each axis of the dataset the index that was chosen; 0 for those of the volume.
    pub(super) fixed: Vec<u64>,
}

impl Selection {
    /// The value at index 0 of the volume.
    fn start(&self, strides: &[u64]) -> u64 {
        self.fixed.iter().zip(strides).map(|(at, n)| at * n).sum()
    }

    /// Strides along z, y and x.
    fn strides(&self, strides: &[u64]) -> [u64; 3] {
        self.volume.map(|axis| axis.map_or(1, |axis| strides[axis]))
    }
}

/// A box of voxels within values of more axes, or in another order.
struct Pick {
    /// The first, in values.
    start: u64,
    /// From one to the next along z, y and x.
    strides: [u64; 3],
    /// Extents along z, y and x.
    size: [u64; 3],
    bytes: usize,
}

impl Pick {
    /// Whether the box is all of `count` values, in order.
    fn is_all(&self, count: u64) -> bool {
        let [z, y, x] = self.size;
        let in_order = self.strides[2] == 1
            && (self.strides[1] == x || y == 1)
            && (self.strides[0] == x * y || z == 1);
        self.start == 0 && in_order && x * y * z == count
    }

    /// Replaces `out` by the voxels, from the box that begins `skip` values further; `read` gives
    /// some bytes behind so many others.
    fn copy<'a>(
        &self,
        skip: u64,
        read: impl Fn(u64, u64) -> Result<Cow<'a, [u8]>, Error>,
        out: &mut Vec<u8>,
    ) -> Result<(), Error> {
        let bytes = self.bytes as u64;
        let [sz, sy, sx] = self.strides;
        let [nz, ny, nx] = self.size;
        out.clear();
        for z in 0..nz {
            for y in 0..ny {
                let first = (self.start + skip + z * sz + y * sy) * bytes;
                let span = ((nx - 1) * sx + 1) * bytes;
                let row = read(first, span)?;
                if sx == 1 {
                    out.extend_from_slice(&row);
                } else {
                    let step = usize::try_from(sx * bytes).unwrap_or(usize::MAX);
                    for voxel in row.chunks(step) {
                        out.extend_from_slice(&voxel[..self.bytes]);
                    }
                }
            }
        }
        Ok(())
    }
}

/// Planes of a contiguous dataset with further axes between or behind those of the volume.
struct Planes {
    file: Arc<File>,
    place: u64,
    pick: Pick,
}

impl Chunks for Planes {
    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
        let bytes = self.file.bytes();
        let skip = index[2] * self.pick.strides[0];
        // Within the dataset, all of which is in the file.
        let read = |at, count| bytes.read(self.place + at, count);
        self.pick.copy(skip, read, out)
    }

    fn check(&self) -> Result<(), Error> {
        self.file.bytes().check()
    }
}

/// A dataset in chunks.
struct ChunkedDataset {
    file: Arc<File>,
    path: String,
    dims: Vec<u64>,
    volume: [Option<usize>; 3],
    /// For each axis the number of the chunk; replaced for axes of the volume.
    numbers: Vec<u64>,
    chunk: Vec<u64>,
    chunk_bytes: usize,
    index: Index,
    filters: Vec<Filter>,
    edges_unfiltered: bool,
    fill: [u8; 8],
    pick: Pick,
}

impl ChunkedDataset {
    /// The number along each axis of piece `index`.
    fn numbers(&self, index: [u64; 3]) -> Vec<u64> {
        let mut numbers = self.numbers.clone();
        for (axis, at) in self.volume.into_iter().zip([index[2], index[1], index[0]]) {
            if let Some(axis) = axis {
                numbers[axis] = at;
            }
        }
        numbers
    }

    fn passes_the_end(&self, numbers: &[u64]) -> bool {
        let axes = numbers.iter().zip(&self.chunk).zip(&self.dims);
        axes.into_iter().any(|((number, chunk), dim)| {
            number
                .checked_add(1)
                .and_then(|n| n.checked_mul(*chunk))
                .is_none_or(|end| end > *dim)
        })
    }
}

impl Chunks for ChunkedDataset {
    fn whole_bytes(&self) -> Option<u64> {
        Some(self.chunk_bytes as u64)
    }

    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
        let numbers = self.numbers(index);
        let Some(stored) = self.index.find(&self.file, &numbers)? else {
            let [z, y, x] = self.pick.size;
            let count = usize::try_from(x * y * z).unwrap_or(usize::MAX);
            *out = self.fill[..self.pick.bytes].repeat(count);
            return Ok(());
        };
        let bytes = stored.bytes.unwrap_or(self.chunk_bytes as u64);
        let data = self.file.read(stored.address, bytes)?;
        let plain = self.edges_unfiltered && self.passes_the_end(&numbers);
        let filters = if plain { &[] } else { &self.filters[..] };
        let all = self
            .pick
            .is_all((self.chunk_bytes / self.pick.bytes) as u64);
        let mut whole = Vec::new();
        let target = if all { &mut *out } else { &mut whole };
        let failed = |e: CodecError| {
            let error = e.of(self.file.name());
            let what = format!("chunk {numbers:?} of {}: {}", self.path, error.message());
            Error::new(error.kind(), self.file.name(), what).at(self.file.place(stored.address))
        };
        if filters.is_empty() {
            exactly(self.chunk_bytes, &data).map_err(failed)?;
            target.clear();
            target.extend_from_slice(&data);
        } else {
            filter::undo(
                filters,
                stored.without,
                data,
                self.chunk_bytes,
                self.pick.bytes,
                target,
            )
            .map_err(failed)?;
        }
        if all {
            return Ok(());
        }
        // The box lies within the chunk.
        let read = |at: u64, count: u64| {
            let (at, count) = (at as usize, count as usize);
            Ok(Cow::Borrowed(&whole[at..at + count]))
        };
        self.pick.copy(0, read, out)
    }

    fn uniform(&self, index: [u64; 3]) -> Option<[u8; 8]> {
        match self.index.find(&self.file, &self.numbers(index)) {
            Ok(None) => Some(self.fill),
            _ => None,
        }
    }

    fn check(&self) -> Result<(), Error> {
        self.file.bytes().check()
    }
}
