//! One entry, read and timed.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;

use curvox_formats::{
    ByteOrder, DType, Error, Header, OpenOptions, RawLayout, Region, SourceInfo, Unit, VoxelType,
    Voxels, open, open_stream,
};
use half::f16;
use sha2::{Digest, Sha256};

use super::list::{Entry, Expected};

/// What came of an entry.
#[derive(Clone, Debug)]
pub(super) enum Outcome {
    /// Refused, with the message.
    Refused(String),
    /// Opened, but too large to be read whole.
    Large(Box<Header>),
    /// Read.
    Read(Box<Facts>),
}

/// What was read.
#[derive(Clone, Debug)]
pub(super) struct Facts {
    pub(super) header: Header,
    /// `None` where nobody else says what is right.
    pub(super) voxels_right: Option<bool>,
    pub(super) spacing_right: Option<bool>,
    /// From a pipe: the same voxels.
    pub(super) forward: Result<bool, String>,
    /// By boxes: the same voxels; `None` if it only runs forward.
    pub(super) boxes: Option<bool>,
    /// Seconds to read all planes, and to read the files.
    pub(super) seconds: [f64; 2],
    /// Bytes of the files, and of the voxels.
    pub(super) bytes: [u64; 2],
}

/// Reads an entry in every way there is.
pub(super) fn read(data: &Path, entry: &Entry, repeat: usize) -> Outcome {
    /// Held several times over while it is compared.
    const MOST_BYTES: u64 = 2 << 30;
    if let Ok(volume) = open(&data.join(&entry.path), &options(entry))
        && volume.header.voxels_bytes().is_none_or(|n| n > MOST_BYTES)
    {
        return Outcome::Large(Box::new(volume.header));
    }
    match try_read(data, entry, repeat) {
        Ok(facts) => Outcome::Read(Box::new(facts)),
        Err(error) => {
            let text = error.to_string();
            // The folder is nobody's business.
            Outcome::Refused(text.replace(&format!("{}/", data.display()), ""))
        }
    }
}

fn options(entry: &Entry) -> OpenOptions {
    let raw = entry.expected.as_ref().filter(|_| entry.raw).map(|e| {
        let voxel = e.dtype.as_deref().and_then(voxel_type);
        RawLayout {
            dims: e.dims.unwrap_or([1; 3]),
            dtype: DType::little(voxel.unwrap_or(VoxelType::U8)),
            spacing: None,
            unit: Unit::Unknown,
            skip: 0,
        }
    });
    OpenOptions {
        raw,
        frame: entry.frame,
        ..OpenOptions::default()
    }
}

fn try_read(data: &Path, entry: &Entry, repeat: usize) -> Result<Facts, Error> {
    let path = data.join(&entry.path);
    let options = options(entry);
    let (header, voxels, source) = planes(&path, &options)?;
    let mut times = Vec::new();
    for _ in 0..repeat {
        let begin = Instant::now();
        planes(&path, &options)?;
        times.push(begin.elapsed().as_secs_f64());
    }
    let files = files_of(&path, &source);
    let mut plain = Vec::new();
    for _ in 0..repeat {
        plain.push(cat(&files));
    }
    let forward = match std::fs::File::open(&path).ok().filter(|_| path.is_file()) {
        None => Err("a folder".to_owned()),
        Some(file) => open_stream(Box::new(file), "pipe", &options)
            .and_then(|volume| {
                let mut planes = volume.into_forward();
                drain(&mut *planes)
            })
            .map(|piped| piped == voxels)
            .map_err(|error| error.message().to_owned()),
    };
    let boxes = match open(&path, &options)?.voxels {
        Voxels::Forward(_) => None,
        Voxels::Random(random) => {
            let mut out = Vec::new();
            random.read_box(&Region::whole(header.dims), &mut out)?;
            Some(out == voxels)
        }
    };
    let expected = entry.expected.as_ref();
    Ok(Facts {
        voxels_right: expected.and_then(|e| voxels_right(e, &header, &voxels)),
        spacing_right: expected.and_then(|e| spacing_right(e, &header)),
        forward,
        boxes,
        seconds: [median(times), median(plain)],
        bytes: [
            files
                .iter()
                .filter_map(|f| Some(f.metadata().ok()?.len()))
                .sum(),
            voxels.len() as u64,
        ],
        header,
    })
}

fn planes(path: &Path, options: &OpenOptions) -> Result<(Header, Vec<u8>, SourceInfo), Error> {
    let volume = open(path, options)?;
    let (header, source) = (volume.header.clone(), volume.source.clone());
    let voxels = drain(&mut *volume.into_forward())?;
    Ok((header, voxels, source))
}

fn drain(planes: &mut dyn curvox_formats::ForwardVoxels) -> Result<Vec<u8>, Error> {
    let mut all = Vec::new();
    planes.read_planes(u64::MAX, &mut all)?;
    planes.finish()?;
    Ok(all)
}

/// The files that a volume is read from, as far as a path tells.
fn files_of(path: &Path, source: &SourceInfo) -> Vec<PathBuf> {
    let mut found = Vec::new();
    if path.is_dir() {
        let mut folders = vec![path.to_path_buf()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let path = entry.path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    found.push(path);
                }
            }
        }
    } else {
        found.push(path.to_path_buf());
        found.extend(source.path.clone().filter(|other| other != path));
    }
    found
}

fn cat(files: &[PathBuf]) -> f64 {
    let begin = Instant::now();
    let mut buffer = vec![0; 128 << 10];
    for file in files {
        if let Ok(mut file) = std::fs::File::open(file) {
            while file.read(&mut buffer).is_ok_and(|n| n > 0) {}
        }
    }
    begin.elapsed().as_secs_f64()
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
}

fn voxel_type(name: &str) -> Option<VoxelType> {
    Some(match name {
        "b1" => VoxelType::Bool,
        "u1" => VoxelType::U8,
        "i1" => VoxelType::I8,
        "u2" => VoxelType::U16,
        "i2" => VoxelType::I16,
        "u4" => VoxelType::U32,
        "i4" => VoxelType::I32,
        "u8" => VoxelType::U64,
        "i8" => VoxelType::I64,
        "f2" => VoxelType::F16,
        "f4" => VoxelType::F32,
        "f8" => VoxelType::F64,
        _ => return None,
    })
}

fn voxels_right(expected: &Expected, header: &Header, voxels: &[u8]) -> Option<bool> {
    let sha256 = expected.sha256.as_ref()?;
    if let Some(dims) = expected.dims
        && dims != header.dims
    {
        return Some(false);
    }
    let wanted = expected.dtype.as_deref().and_then(voxel_type)?;
    let canonical = if wanted == header.voxel && (expected.stored || header.scaling.is_none()) {
        little(header, voxels)
    } else {
        cast(header, voxels, wanted)
    };
    let found: String = Sha256::digest(&canonical)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    Some(found == *sha256)
}

fn little(header: &Header, voxels: &[u8]) -> Vec<u8> {
    let mut out = voxels.to_vec();
    if header.byte_order == ByteOrder::Big {
        out.chunks_exact_mut(header.voxel.bytes())
            .for_each(<[u8]>::reverse);
    }
    out
}

/// Values, scaled, as another type. Exact where they are whole and below 2^53.
fn cast(header: &Header, voxels: &[u8], wanted: VoxelType) -> Vec<u8> {
    let size = header.voxel.bytes();
    let voxels = little(header, voxels);
    voxels
        .chunks_exact(size)
        .flat_map(|voxel| {
            let mut bytes = [0; 8];
            bytes[..size].copy_from_slice(voxel);
            let [a, b, c, d, ..] = bytes;
            let stored = match header.voxel {
                VoxelType::Bool | VoxelType::U8 => f64::from(a),
                VoxelType::I8 => f64::from(a as i8),
                VoxelType::U16 => f64::from(u16::from_le_bytes([a, b])),
                VoxelType::I16 => f64::from(i16::from_le_bytes([a, b])),
                VoxelType::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
                VoxelType::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
                VoxelType::U64 => u64::from_le_bytes(bytes) as f64,
                VoxelType::I64 => i64::from_le_bytes(bytes) as f64,
                VoxelType::F16 => f16::from_le_bytes([a, b]).to_f64(),
                VoxelType::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
                VoxelType::F64 => f64::from_le_bytes(bytes),
            };
            let value = header
                .scaling
                .map_or(stored, |s| s.slope * stored + s.intercept);
            match wanted {
                VoxelType::Bool | VoxelType::U8 => vec![value as u8],
                VoxelType::I8 => (value as i8).to_le_bytes().to_vec(),
                VoxelType::U16 => (value as u16).to_le_bytes().to_vec(),
                VoxelType::I16 => (value as i16).to_le_bytes().to_vec(),
                VoxelType::U32 => (value as u32).to_le_bytes().to_vec(),
                VoxelType::I32 => (value as i32).to_le_bytes().to_vec(),
                VoxelType::U64 => (value as u64).to_le_bytes().to_vec(),
                VoxelType::I64 => (value as i64).to_le_bytes().to_vec(),
                VoxelType::F16 => f16::from_f64(value).to_le_bytes().to_vec(),
                VoxelType::F32 => (value as f32).to_le_bytes().to_vec(),
                VoxelType::F64 => value.to_le_bytes().to_vec(),
            }
        })
        .collect()
}

/// Whether the spacing is the one expected, in the unit of the file or in millimetres.
fn spacing_right(expected: &Expected, header: &Header) -> Option<bool> {
    Some(match (expected.spacing?, header.spacing) {
        (None, None) => true,
        (Some(expected), Some(found)) => {
            let millimetres = header.unit.metres().map_or(1.0, |metres| metres * 1e3);
            [1.0, millimetres].into_iter().any(|unit| {
                (0..3).all(|a| {
                    let expected = f64::abs(expected[a]);
                    (found[a] * unit - expected).abs() <= 1e-5 * expected
                })
            })
        }
        _ => false,
    })
}
