//! Which format a file has, by its content.
//!
//! In: the first bytes, decompressed. Out: a format that is read here, or an error that names
//! the one the content looks like. Names and extensions are not consulted.

use crate::error::Error;
use crate::header::Format;
use crate::input::{Compression, Input, read_error};
use crate::parsed::Context;
use crate::registry::{READERS, formats};

/// Formats that are recognised in order to be refused by name: (offset, magic, name).
const OTHER_FORMATS: &[(usize, &[u8], &str)] = &[
    (0, b"PK\x03\x04", "zip"),
    (0, b"ObjectType", "a MetaIO object"),
    (0, b"<?xml", "XML"),
    (0, b"<VTKFile", "VTK XML"),
    (0, b"CDF\x01", "NetCDF (or MINC 1)"),
    (0, b"CDF\x02", "NetCDF"),
    (0, b"MATRIX7", "ECAT 7"),
    (0, b"PAR1", "Parquet"),
    (0, b"\xfd7zXZ\0", "xz"),
    (0, b"P3D", "PGM3D"),
    (0, b"P2", "PGM3D"),
    (0, b"P5", "PGM3D"),
];

/// The format of volumes that content begins like.
fn volume(head: &[u8]) -> Option<Format> {
    READERS
        .iter()
        .find(|entry| (entry.detect)(head))
        .map(|entry| entry.format)
}

/// The name of the format that is not read, by magic numbers of at least some bytes.
fn other(head: &[u8], least_bytes: usize) -> Option<&'static str> {
    OTHER_FORMATS
        .iter()
        .filter(|(_, magic, _)| magic.len() >= least_bytes)
        .find(|(offset, magic, _)| head.get(*offset..).is_some_and(|h| h.starts_with(magic)))
        .map(|(_, _, name)| *name)
}

/// What content begins like, if not like a mesh. Magic numbers of two or three letters do not count: the
/// free text that a binary STL begins with may have them.
pub(crate) fn looks_like_no_mesh(head: &[u8]) -> Option<String> {
    volume(head)
        .map(|format| format.name().to_owned())
        .or_else(|| other(head, 4).map(str::to_owned))
}

/// The format of the content, or an error that says what it looks like.
pub(crate) fn detect(input: &mut Input, context: &Context<'_>) -> Result<Format, Error> {
    /// Enough for every magic number, and for the first lines of a text header.
    const HEAD_BYTES: usize = 1024;
    let head = input
        .peek(HEAD_BYTES)
        .map_err(|e| read_error(context.name, 0, e))?;
    if let Some(format) = volume(head) {
        return Ok(format);
    }
    if let Some(name) = other(head, 1) {
        return Err(Error::unsupported(
            context.name,
            format!("the content looks like {name}, which is not read here"),
        ));
    }
    if Compression::detect(head).is_some() {
        return Err(Error::unsupported(context.name, "is compressed twice"));
    }
    let titles: Vec<_> = formats()
        .iter()
        .filter(|info| info.format != Format::Raw && info.missing_feature.is_none())
        .map(|info| info.title)
        .collect();
    let shown: Vec<_> = head.iter().take(8).map(|b| format!("{b:02x}")).collect();
    Err(Error::unsupported(
        context.name,
        format!(
            "the format is not recognised (first bytes {}); expected {}; of a file without \
             header, give dimensions and type (--dims, --dtype)",
            shown.join(" "),
            titles.join(", ")
        ),
    ))
}
