//! A minimal reader of DGtal's .vol (versions 2 and 3): enough for the volumes to compare with.

use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, ensure};

use crate::plain::Solid;

/// No volume to compare with is larger, in voxels.
const MAX_VOXELS: usize = 1 << 30;

/// The voxels of value > 0.
///
/// # Errors
/// If the file cannot be read, or is not an 8-bit .vol of the size its header tells.
pub fn read(path: &Path) -> Result<Solid> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    parse(&bytes).with_context(|| path.display().to_string())
}

fn parse(bytes: &[u8]) -> Result<Solid> {
    const END: &[u8] = b"\n.\n";
    let end = bytes
        .windows(END.len())
        .position(|w| w == END)
        .context("the header has no end")?;
    let header = std::str::from_utf8(&bytes[..end]).context("the header is not text")?;
    let field = |key: &str| {
        header
            .lines()
            .find_map(|line| line.split_once(':').filter(|(name, _)| name.trim() == key))
            .map(|(_, value)| value.trim())
    };
    let length = |key: &str| -> Result<usize> {
        let value = field(key).with_context(|| format!("the header has no {key}"))?;
        value.parse().with_context(|| format!("{key}: {value}"))
    };
    let dims = [length("X")?, length("Y")?, length("Z")?];
    let count = dims
        .iter()
        .try_fold(1usize, |n, &m| n.checked_mul(m))
        .filter(|&n| n <= MAX_VOXELS)
        .with_context(|| format!("{dims:?} voxels are too many"))?;
    if let Some(width) = field("Voxel-Size") {
        ensure!(width == "1", "expected voxels of 1 byte, found {width}");
    }
    let stored = &bytes[end + END.len()..];
    let mut data = Vec::new();
    if field("Version") == Some("3") {
        flate2::read::ZlibDecoder::new(stored)
            .take(count as u64 + 1)
            .read_to_end(&mut data)?;
    } else {
        data.extend_from_slice(stored);
    }
    ensure!(
        data.len() == count,
        "expected {count} voxels, found {}",
        data.len()
    );
    Ok(Solid {
        dims,
        inside: data.into_iter().map(|value| value > 0).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uncompressed_volume_is_read_and_a_short_one_is_an_error() {
        let file = b"X: 2\nY: 1\nZ: 2\nVersion: 2\n.\n\x00\x01\x02\x00";
        let solid = parse(file).unwrap();
        assert_eq!(solid.dims, [2, 1, 2]);
        assert_eq!(solid.inside, [false, true, true, false]);
        for end in 0..file.len() {
            assert!(parse(&file[..end]).is_err());
        }
    }
}
