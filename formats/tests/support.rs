//! Files made in memory, temporary folders, and other tools of the tests.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::io::Write;
use std::path::{Path, PathBuf};

use curvox_formats::{
    ByteOrder, DType, Error, Header, OpenOptions, RawLayout, Unit, Volume, VoxelType, open,
    open_stream,
};

/// Counts what each thread holds, so that tests can bound it.
struct Counting;

thread_local! {
    static HELD: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

fn count(change: isize) {
    // A thread that is ending has no counters left; nothing is measured there.
    let _ = HELD.try_with(|held| {
        held.set(held.get() + change);
        let _ = PEAK.try_with(|peak| peak.set(peak.get().max(held.get())));
    });
}

// SAFETY: every call is handed to the system allocator unchanged; the counters do not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Old and new may live at once.
        count(size as isize);
        count(-(layout.size() as isize));
        // SAFETY: the caller's promises are passed on.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `work` and gives the most bytes this thread held meanwhile, beyond what it held before.
pub fn peak_bytes<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = HELD.get();
    PEAK.set(before);
    let result = work();
    (result, usize::try_from(PEAK.get() - before).unwrap_or(0))
}

/// A folder of files that vanishes with the test.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

/// Bytes without a pattern, the same each time.
pub fn noise(count: usize) -> Vec<u8> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    (0..count)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 32) as u8
        })
        .collect()
}

/// All voxels of a volume, and the warnings.
pub fn read_all(volume: Volume) -> Result<(Header, Vec<u8>, Vec<String>), Error> {
    let header = volume.header.clone();
    let mut warnings = header.warnings.clone();
    let mut planes = volume.into_forward();
    let (mut all, mut some) = (Vec::new(), Vec::new());
    while planes.read_planes(3, &mut some)? > 0 {
        all.extend_from_slice(&some);
    }
    warnings.extend(planes.finish()?);
    Ok((header, all, warnings))
}

pub fn read_path(path: &Path) -> Result<(Header, Vec<u8>, Vec<String>), Error> {
    read_all(open(path, &OpenOptions::default())?)
}

pub fn read_bytes(
    bytes: &[u8],
    options: &OpenOptions,
) -> Result<(Header, Vec<u8>, Vec<String>), Error> {
    read_all(open_bytes(bytes, options)?)
}

pub fn open_bytes(bytes: &[u8], options: &OpenOptions) -> Result<Volume, Error> {
    open_stream(
        Box::new(std::io::Cursor::new(bytes.to_vec())),
        "stream",
        options,
    )
}

/// A reader that gives a few bytes at a time, as a pipe may.
pub struct Drip(pub Vec<u8>, pub usize);

impl std::io::Read for Drip {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let n = out.len().min(1 + self.1 % 7).min(self.0.len() - self.1);
        out[..n].copy_from_slice(&self.0[self.1..self.1 + n]);
        self.1 += n;
        Ok(n)
    }
}

pub fn raw_options(dims: [u64; 3], dtype: DType) -> OpenOptions {
    let raw = RawLayout {
        dims,
        dtype,
        spacing: None,
        unit: Unit::Unknown,
        skip: 0,
    };
    OpenOptions {
        raw: Some(raw),
        ..OpenOptions::default()
    }
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::new(6));
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

pub fn zstd(bytes: &[u8]) -> Vec<u8> {
    let mut out = zstd::stream::write::Encoder::new(Vec::new(), 3).unwrap();
    out.include_checksum(true).unwrap();
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

pub fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::new(6));
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// The name NumPy has for a type.
pub fn descr(dtype: DType) -> String {
    let kind = match dtype.voxel {
        VoxelType::Bool => "b",
        VoxelType::F16 | VoxelType::F32 | VoxelType::F64 => "f",
        v if v.name().starts_with('u') => "u",
        _ => "i",
    };
    let order = match (dtype.voxel.bytes(), dtype.byte_order) {
        (1, _) => "|",
        (_, ByteOrder::Little) => "<",
        (_, ByteOrder::Big) => ">",
    };
    format!("{order}{kind}{}", dtype.voxel.bytes())
}

/// An `.npy` file of the given version and header text.
pub fn npy_with(version: u8, text: &str, voxels: &[u8]) -> Vec<u8> {
    let mut file = b"\x93NUMPY".to_vec();
    file.extend_from_slice(&[version, 0]);
    let length = text.len() as u32;
    if version == 1 {
        file.extend_from_slice(&(length as u16).to_le_bytes());
    } else {
        file.extend_from_slice(&length.to_le_bytes());
    }
    file.extend_from_slice(text.as_bytes());
    file.extend_from_slice(voxels);
    file
}

pub fn npy(dims: [u64; 3], dtype: DType, version: u8, fortran: bool, voxels: &[u8]) -> Vec<u8> {
    let [x, y, z] = dims;
    let order = if fortran { "True" } else { "False" };
    let text = format!(
        "{{'descr': '{}', 'fortran_order': {order}, 'shape': ({z}, {y}, {x}), }}\n",
        descr(dtype)
    );
    npy_with(version, &text, voxels)
}

/// Voxels stored x fastest, in the order with z fastest.
pub fn transposed(dims: [u64; 3], voxel_bytes: usize, voxels: &[u8]) -> Vec<u8> {
    let [nx, ny, nz] = dims.map(|n| n as usize);
    let mut out = Vec::new();
    for x in 0..nx {
        for y in 0..ny {
            for z in 0..nz {
                let at = ((z * ny + y) * nx + x) * voxel_bytes;
                out.extend_from_slice(&voxels[at..at + voxel_bytes]);
            }
        }
    }
    out
}

pub fn vol(dims: [u64; 3], version: u8, voxels: &[u8]) -> Vec<u8> {
    let [x, y, z] = dims;
    let mut file = format!(
        "X: {x}\nY: {y}\nZ: {z}\nVoxel-Size: 1\nAlpha-Color: 0\nVoxel-Endian: 0\nInt-Endian: \
         0123\nVersion: {version}\n.\n"
    )
    .into_bytes();
    file.extend(if version == 3 {
        zlib(voxels)
    } else {
        voxels.to_vec()
    });
    file
}

/// A NIfTI header, to be changed field by field.
pub struct Nifti {
    pub bytes: Vec<u8>,
    pub version: u8,
    pub order: ByteOrder,
}

impl Nifti {
    pub fn new(version: u8, dims: [u64; 3], dtype: DType) -> Self {
        let order = dtype.byte_order;
        let size = if version == 1 { 352 } else { 544 };
        let mut header = Self {
            bytes: vec![0; size],
            version,
            order,
        };
        let code: i16 = match dtype.voxel {
            VoxelType::U8 => 2,
            VoxelType::I16 => 4,
            VoxelType::I32 => 8,
            VoxelType::F32 => 16,
            VoxelType::F64 => 64,
            VoxelType::I8 => 256,
            VoxelType::U16 => 512,
            VoxelType::U32 => 768,
            VoxelType::I64 => 1024,
            VoxelType::U64 => 1280,
            other => panic!("NIfTI has no {other}"),
        };
        if version == 1 {
            header.i32(0, 348);
            header.i16(70, code);
            header.i16(72, dtype.voxel.bytes() as i16 * 8);
            header.f32(108, 352.0);
            header.bytes[344..348].copy_from_slice(b"n+1\0");
        } else {
            header.i32(0, 540);
            header.i16(12, code);
            header.i16(14, dtype.voxel.bytes() as i16 * 8);
            header.i64(168, 544);
            header.bytes[4..12].copy_from_slice(b"n+2\0\r\n\x1a\n");
        }
        header.dim(&[3, dims[0] as i64, dims[1] as i64, dims[2] as i64]);
        header.pixdim(&[1.0, 1.0, 1.0, 1.0]);
        header
    }

    pub fn put<const N: usize>(&mut self, at: usize, mut little: [u8; N]) {
        if self.order == ByteOrder::Big {
            little.reverse();
        }
        self.bytes[at..at + N].copy_from_slice(&little);
    }

    pub fn i16(&mut self, at: usize, value: i16) {
        self.put(at, value.to_le_bytes());
    }

    pub fn i32(&mut self, at: usize, value: i32) {
        self.put(at, value.to_le_bytes());
    }

    pub fn i64(&mut self, at: usize, value: i64) {
        self.put(at, value.to_le_bytes());
    }

    pub fn f32(&mut self, at: usize, value: f32) {
        self.put(at, value.to_le_bytes());
    }

    pub fn f64(&mut self, at: usize, value: f64) {
        self.put(at, value.to_le_bytes());
    }

    pub fn dim(&mut self, dim: &[i64]) {
        for (i, n) in dim.iter().enumerate() {
            if self.version == 1 {
                self.i16(40 + 2 * i, *n as i16);
            } else {
                self.i64(16 + 8 * i, *n);
            }
        }
    }

    pub fn pixdim(&mut self, pixdim: &[f64]) {
        for (i, s) in pixdim.iter().enumerate() {
            if self.version == 1 {
                self.f32(76 + 4 * i, *s as f32);
            } else {
                self.f64(104 + 8 * i, *s);
            }
        }
    }

    pub fn slope(&mut self, slope: f64, intercept: f64) {
        if self.version == 1 {
            self.f32(112, slope as f32);
            self.f32(116, intercept as f32);
        } else {
            self.f64(176, slope);
            self.f64(184, intercept);
        }
    }

    pub fn units(&mut self, code: u8) {
        if self.version == 1 {
            self.bytes[123] = code;
        } else {
            self.i32(500, code.into());
        }
    }

    pub fn codes(&mut self, qform: i16, sform: i16) {
        if self.version == 1 {
            self.i16(252, qform);
            self.i16(254, sform);
        } else {
            self.i32(344, qform.into());
            self.i32(348, sform.into());
        }
    }

    pub fn srow(&mut self, rows: [[f64; 4]; 3]) {
        for (r, row) in rows.iter().enumerate() {
            for (c, value) in row.iter().enumerate() {
                if self.version == 1 {
                    self.f32(280 + 16 * r + 4 * c, *value as f32);
                } else {
                    self.f64(400 + 32 * r + 8 * c, *value);
                }
            }
        }
    }

    pub fn quaternion(&mut self, bcd: [f64; 3], offset: [f64; 3]) {
        for i in 0..3 {
            if self.version == 1 {
                self.f32(256 + 4 * i, bcd[i] as f32);
                self.f32(268 + 4 * i, offset[i] as f32);
            } else {
                self.f64(352 + 8 * i, bcd[i]);
                self.f64(376 + 8 * i, offset[i]);
            }
        }
    }

    /// Makes it the header of a pair.
    pub fn pair(mut self) -> Self {
        if self.version == 1 {
            self.bytes[344..348].copy_from_slice(b"ni1\0");
            self.f32(108, 0.0);
        } else {
            self.bytes[4..8].copy_from_slice(b"ni2\0");
            self.i64(168, 0);
        }
        self
    }

    pub fn file(&self, voxels: &[u8]) -> Vec<u8> {
        let mut file = self.bytes.clone();
        file.extend_from_slice(voxels);
        file
    }
}

/// The shared folder of volumes, if the environment names it.
pub fn shared_data() -> Option<PathBuf> {
    let folder = std::env::var_os("CURVOX_TEST_DATA").map(PathBuf::from);
    if folder.is_none() {
        println!("SKIPPED: the shared volumes are not there, CURVOX_TEST_DATA is not set");
    }
    folder
}
