//! Tables in NumPy's .npz: a zip archive of .npy arrays, stored or deflated.
//!
//! Read: little-endian i1, i2, i4, f4, f8 in C order, as f64. Not read: zip64, encryption,
//! anything else. Sizes are checked against the file before they are used.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

/// No array of a table is larger, decompressed.
const MAX_ARRAY_BYTES: u64 = 1 << 30;

/// An array as f64.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Lengths along each axis; none for a scalar.
    pub shape: Vec<usize>,
    /// Values, last axis fastest.
    pub values: Vec<f64>,
}

/// Named arrays.
#[derive(Clone, Debug, Default)]
pub struct Table {
    arrays: BTreeMap<String, Array>,
}

impl Table {
    /// Reads a .npz file.
    ///
    /// # Errors
    /// If the file cannot be read or is not what this module reads.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        Self::parse(&bytes).with_context(|| path.display().to_string())
    }

    fn parse(bytes: &[u8]) -> Result<Self> {
        let mut table = Table::default();
        for entry in zip_entries(bytes)? {
            let data = entry.data(bytes).with_context(|| entry.name.clone())?;
            let array = npy(&data).with_context(|| entry.name.clone())?;
            let name = entry.name.strip_suffix(".npy").unwrap_or(&entry.name);
            table.arrays.insert(name.to_owned(), array);
        }
        Ok(table)
    }

    /// The array of this name, if there is one.
    pub fn find(&self, name: &str) -> Option<&Array> {
        self.arrays.get(name)
    }

    /// The values of the array of this name.
    ///
    /// # Errors
    /// If there is none.
    pub fn column(&self, name: &str) -> Result<&[f64]> {
        let array = self
            .find(name)
            .with_context(|| format!("there is no array {name}"))?;
        Ok(&array.values)
    }

    /// The rows of an (N, 3) array.
    ///
    /// # Errors
    /// If there is none of this name and shape.
    pub fn triples(&self, name: &str) -> Result<Vec<[f64; 3]>> {
        let array = self
            .find(name)
            .with_context(|| format!("there is no array {name}"))?;
        ensure!(
            array.shape.len() == 2 && array.shape[1] == 3,
            "{name}: expected shape (N, 3), found {:?}",
            array.shape
        );
        Ok(array
            .values
            .chunks_exact(3)
            .map(|row| [row[0], row[1], row[2]])
            .collect())
    }
}

struct ZipEntry {
    name: String,
    method: u64,
    compressed: usize,
    uncompressed: u64,
    local_header: usize,
}

/// The unsigned little-endian number of `width` bytes at `offset`.
fn number(bytes: &[u8], offset: usize, width: usize) -> Result<u64> {
    let field = part(bytes, offset, width)?;
    Ok(field
        .iter()
        .rev()
        .fold(0, |n, &byte| n << 8 | u64::from(byte)))
}

fn part(bytes: &[u8], offset: usize, length: usize) -> Result<&[u8]> {
    offset
        .checked_add(length)
        .and_then(|end| bytes.get(offset..end))
        .with_context(|| {
            format!(
                "{length} bytes expected at offset {offset}, the end is at {}",
                bytes.len()
            )
        })
}

fn size(bytes: &[u8], offset: usize, width: usize) -> Result<usize> {
    Ok(usize::try_from(number(bytes, offset, width)?)?)
}

/// The central directory, found from the end of the file.
fn zip_entries(bytes: &[u8]) -> Result<Vec<ZipEntry>> {
    let end = bytes
        .windows(4)
        .rposition(|w| w == b"PK\x05\x06")
        .context("not a zip archive")?;
    let count = number(bytes, end + 10, 2)?;
    let mut at = size(bytes, end + 16, 4)?;
    let mut entries = Vec::new();
    for _ in 0..count {
        ensure!(
            part(bytes, at, 4)? == b"PK\x01\x02",
            "no directory entry at offset {at}"
        );
        let name_length = size(bytes, at + 28, 2)?;
        entries.push(ZipEntry {
            method: number(bytes, at + 10, 2)?,
            compressed: size(bytes, at + 20, 4)?,
            uncompressed: number(bytes, at + 24, 4)?,
            local_header: size(bytes, at + 42, 4)?,
            name: String::from_utf8_lossy(part(bytes, at + 46, name_length)?).into_owned(),
        });
        at += 46 + name_length + size(bytes, at + 30, 2)? + size(bytes, at + 32, 2)?;
    }
    Ok(entries)
}

impl ZipEntry {
    fn data(&self, bytes: &[u8]) -> Result<Vec<u8>> {
        let at = self.local_header;
        ensure!(
            part(bytes, at, 4)? == b"PK\x03\x04",
            "no local header at offset {at}"
        );
        let start = at + 30 + size(bytes, at + 26, 2)? + size(bytes, at + 28, 2)?;
        let stored = part(bytes, start, self.compressed)?;
        ensure!(
            self.uncompressed <= MAX_ARRAY_BYTES,
            "{} bytes are too many",
            self.uncompressed
        );
        let mut data = Vec::new();
        match self.method {
            0 => data.extend_from_slice(stored),
            8 => {
                let mut decoder =
                    flate2::read::DeflateDecoder::new(stored).take(self.uncompressed + 1);
                decoder.read_to_end(&mut data)?;
            }
            other => bail!("compression method {other} is not read"),
        }
        ensure!(
            data.len() as u64 == self.uncompressed,
            "expected {} bytes, found {}",
            self.uncompressed,
            data.len()
        );
        Ok(data)
    }
}

/// One .npy array: magic, version, a Python dictionary as text, then the values.
fn npy(bytes: &[u8]) -> Result<Array> {
    ensure!(part(bytes, 0, 6)? == b"\x93NUMPY", "not a .npy array");
    let (start, width) = if bytes.get(6) == Some(&1) {
        (10, 2)
    } else {
        (12, 4)
    };
    let length = size(bytes, 8, width)?;
    let header = std::str::from_utf8(part(bytes, start, length)?)?;
    let after = |key: &str| {
        let place = header
            .find(key)
            .with_context(|| format!("the header has no {key}"))?;
        Ok::<&str, anyhow::Error>(&header[place + key.len()..])
    };
    let kind = after("'descr': '")?.split('\'').next().unwrap_or_default();
    ensure!(
        after("'fortran_order': ")?.starts_with("False"),
        "Fortran order is not read"
    );
    let shape: Vec<usize> = after("'shape': (")?
        .split(')')
        .next()
        .unwrap_or_default()
        .split(',')
        .map(str::trim)
        .filter(|n| !n.is_empty())
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    let data = &bytes[start + length..];
    let values: Vec<f64> = match kind {
        "|i1" => data.iter().map(|&b| f64::from(b.cast_signed())).collect(),
        "<i2" => data
            .as_chunks()
            .0
            .iter()
            .map(|&b| f64::from(i16::from_le_bytes(b)))
            .collect(),
        "<i4" => data
            .as_chunks()
            .0
            .iter()
            .map(|&b| f64::from(i32::from_le_bytes(b)))
            .collect(),
        "<f4" => data
            .as_chunks()
            .0
            .iter()
            .map(|&b| f64::from(f32::from_le_bytes(b)))
            .collect(),
        "<f8" => data
            .as_chunks()
            .0
            .iter()
            .map(|&b| f64::from_le_bytes(b))
            .collect(),
        other => bail!("values of type {other} are not read"),
    };
    let count = shape
        .iter()
        .try_fold(1usize, |n, &m| n.checked_mul(m))
        .context("shape overflows")?;
    ensure!(
        values.len() == count,
        "shape {shape:?} does not match {} values",
        values.len()
    );
    Ok(Array { shape, values })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A zip archive of one stored array [[1, 2, 3], [4, 5, 6]] of i2.
    fn archive() -> Vec<u8> {
        let header = "{'descr': '<i2', 'fortran_order': False, 'shape': (2, 3), }\n";
        let mut array = b"\x93NUMPY\x01\x00".to_vec();
        array.extend((header.len() as u16).to_le_bytes());
        array.extend(header.as_bytes());
        (1..=6i16).for_each(|i| array.extend(i.to_le_bytes()));
        let length = (array.len() as u32).to_le_bytes();
        let mut zip = b"PK\x03\x04".to_vec();
        zip.extend([0; 22]);
        zip.extend([5, 0, 0, 0]);
        zip.extend(b"k.npy");
        zip.extend(&array);
        let directory = zip.len() as u32;
        zip.extend(b"PK\x01\x02");
        zip.extend([0; 16]);
        zip.extend(length);
        zip.extend(length);
        zip.extend([5, 0]);
        zip.extend([0; 16]);
        zip.extend(b"k.npy");
        zip.extend(b"PK\x05\x06");
        zip.extend([0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0, 0]);
        zip.extend(directory.to_le_bytes());
        zip.extend([0, 0]);
        zip
    }

    #[test]
    fn stored_array_is_read() {
        let table = Table::parse(&archive()).unwrap();
        assert_eq!(
            table.triples("k").unwrap(),
            [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
        );
        assert!(table.column("missing").is_err());
    }

    #[test]
    fn truncated_or_altered_archive_is_an_error_not_a_panic() {
        let good = archive();
        for length in 0..good.len() - 2 {
            assert!(Table::parse(&good[..length]).is_err(), "{length}");
        }
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 0xff;
            let _ = Table::parse(&bad);
        }
    }
}
