//! Reads the columns of a NumPy `.npz` archive: enough for the reference data, in tests alone.

use flate2::read::DeflateDecoder;
use std::collections::HashMap;
use std::io::Read;
use std::path::Path;

/// A column as numbers, row after row, with its shape.
pub(super) struct Column {
    pub(super) shape: Vec<usize>,
    pub(super) values: Vec<f64>,
}

fn u16_at(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]))
}

fn u32_at(bytes: &[u8], at: usize) -> usize {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
}

/// All columns by name. Panics on anything unexpected: a test has no better answer.
pub(super) fn read_npz(path: &Path) -> HashMap<String, Column> {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    // The end of the central directory is the last 22 bytes when the archive has no comment.
    let end = bytes.len() - 22;
    assert_eq!(&bytes[end..end + 4], b"PK\x05\x06", "{}", path.display());
    let mut at = u32_at(&bytes, end + 16);
    let mut columns = HashMap::new();
    for _ in 0..u16_at(&bytes, end + 10) {
        assert_eq!(&bytes[at..at + 4], b"PK\x01\x02");
        let method = u16_at(&bytes, at + 10);
        let size = u32_at(&bytes, at + 20);
        let name_length = u16_at(&bytes, at + 28);
        let local = u32_at(&bytes, at + 42);
        let name = String::from_utf8(bytes[at + 46..at + 46 + name_length].to_vec()).unwrap();
        at += 46 + name_length + u16_at(&bytes, at + 30) + u16_at(&bytes, at + 32);
        let start = local + 30 + u16_at(&bytes, local + 26) + u16_at(&bytes, local + 28);
        let packed = &bytes[start..start + size];
        let mut npy = Vec::new();
        match method {
            0 => npy.extend_from_slice(packed),
            8 => {
                DeflateDecoder::new(packed).read_to_end(&mut npy).unwrap();
            }
            other => panic!("zip method {other} in {}", path.display()),
        }
        if let Some(column) = read_npy(&npy) {
            columns.insert(name.trim_end_matches(".npy").to_string(), column);
        }
    }
    columns
}

/// A column of numbers; `None` for texts.
fn read_npy(npy: &[u8]) -> Option<Column> {
    assert_eq!(&npy[..8], b"\x93NUMPY\x01\x00");
    let data = 10 + u16_at(npy, 8);
    let header = std::str::from_utf8(&npy[10..data]).unwrap();
    assert!(header.contains("'fortran_order': False"), "{header}");
    let field = |key: &str, open: char, close: char| {
        let rest = &header[header.find(key).unwrap() + key.len()..];
        let rest = &rest[rest.find(open).unwrap() + 1..];
        &rest[..rest.find(close).unwrap()]
    };
    let shape = field("'shape':", '(', ')')
        .split(',')
        .filter_map(|n| n.trim().parse().ok())
        .collect();
    let data = &npy[data..];
    let values = match field("'descr':", '\'', '\'') {
        "<f8" => data
            .chunks_exact(8)
            .map(|b| f64::from_le_bytes(b.try_into().unwrap()))
            .collect(),
        "<f4" => data
            .chunks_exact(4)
            .map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap())))
            .collect(),
        "<i2" => data
            .chunks_exact(2)
            .map(|b| f64::from(i16::from_le_bytes(b.try_into().unwrap())))
            .collect(),
        "|i1" => data.iter().map(|&b| f64::from(b as i8)).collect(),
        _ => return None,
    };
    Some(Column { shape, values })
}
