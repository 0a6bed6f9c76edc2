//! Decoders of compressed pieces whose size is known beforehand: chunks, tiles, blocks.
//!
//! In: the bytes of one piece, and the most bytes it may decode to. Out: its bytes, in a buffer
//! that is replaced and keeps its capacity. Guaranteed: never more output than promised, whatever
//! the data says; memory follows the output that is really there, not sizes a header claims.
//! Not guaranteed: that the piece is as long as expected, which [`exactly`] checks.
//!
//! The compression itself is left to libraries (flate2, zstd, lz4_flex, snap, bzip2, crc32c).
//! What is ours is the containers around it ([`blosc`], numcodecs' and Java's frames of LZ4,
//! [`shuffle`]): the libraries there are bind C code, or decode to the end of the data whatever
//! the size of the chunk.

pub(crate) mod blosc;

mod blosclz;

mod lz4;

pub(crate) mod shuffle;

use std::io::Read;

use zstd::zstd_safe;

use crate::error::{Error, ErrorKind};

pub(crate) use lz4::{lz4_block, lz4_java, lz4_sized};

/// What is wrong with a compressed piece.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CodecError {
    kind: ErrorKind,
    message: String,
}

impl CodecError {
    /// The data contradicts its own format.
    pub(crate) fn damaged(message: impl Into<String>) -> Self {
        Self {
            kind: ErrorKind::Invalid,
            message: message.into(),
        }
    }

    /// The data may be fine, but is not decoded here.
    pub(crate) fn unsupported(message: impl Into<String>) -> Self {
        Self {
            kind: ErrorKind::Unsupported,
            message: message.into(),
        }
    }

    /// The same as an error about the file (or the piece of it) called `name`.
    pub(crate) fn of(self, name: &str) -> Error {
        Error::new(self.kind, name, self.message)
    }

    /// Whether the data is damaged or only not decoded here.
    pub(crate) fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// What is wrong, without the place.
    pub(crate) fn message(&self) -> &str {
        &self.message
    }
}

/// An error unless a piece decoded to `expected` bytes.
pub(crate) fn exactly(expected: usize, out: &[u8]) -> Result<(), CodecError> {
    if out.len() == expected {
        return Ok(());
    }
    Err(CodecError::damaged(format!(
        "{} bytes decoded, {expected} expected",
        out.len()
    )))
}

/// The error of a piece that would decode to more than it may.
pub(crate) fn too_much(what: &str, most: usize) -> CodecError {
    CodecError::damaged(format!(
        "the {what} data decodes to more than the {most} bytes expected"
    ))
}

/// Bytes to begin with for a piece of `compressed` bytes. Deflate reaches 1032 to 1; what packs
/// better grows as it decodes, so that a size which is only claimed is never allocated.
fn at_first(compressed: usize, most: usize) -> usize {
    most.min(compressed.saturating_mul(1032).max(1 << 16))
}

/// Reads a decoder to its end.
fn read_all(
    what: &str,
    decoder: impl Read,
    compressed: usize,
    most: usize,
    out: &mut Vec<u8>,
) -> Result<(), CodecError> {
    out.clear();
    // One byte more than wanted, so that reading to the end needs no further growth.
    out.reserve(at_first(compressed, most).saturating_add(1));
    let read = decoder
        .take((most as u64).saturating_add(1))
        .read_to_end(out);
    read.map_err(|e| {
        CodecError::damaged(format!(
            "the {what} data is damaged or cut after {} bytes: {e}",
            out.len()
        ))
    })?;
    if out.len() > most {
        out.clear();
        return Err(too_much(what, most));
    }
    Ok(())
}

/// Decodes a zlib stream.
pub(crate) fn zlib(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    let decoder = flate2::bufread::ZlibDecoder::new(data);
    read_all("zlib", decoder, data.len(), most, out)
}

/// Decodes gzip data, of one member or several.
pub(crate) fn gzip(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    let decoder = flate2::bufread::MultiGzDecoder::new(data);
    read_all("gzip", decoder, data.len(), most, out)
}

/// Decodes bzip2 data, of one stream or several.
pub(crate) fn bzip2(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    let decoder = bzip2::bufread::MultiBzDecoder::new(data);
    read_all("bzip2", decoder, data.len(), most, out)
}

/// Decodes zstd data, of one frame or several; checksums of frames are verified.
///
/// The output itself is the window, so a frame that asks for a large one costs nothing.
pub(crate) fn zstd(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    out.clear();
    let claimed = match zstd_safe::get_frame_content_size(data) {
        Ok(Some(bytes)) => usize::try_from(bytes).unwrap_or(usize::MAX),
        Ok(None) => most,
        Err(_) => return Err(CodecError::damaged("the data is not zstd data")),
    };
    let mut context = zstd_safe::DCtx::create();
    let mut room = at_first(data.len(), most.min(claimed.max(1)));
    loop {
        let mut sized = Sized {
            bytes: std::mem::take(out),
            room,
        };
        let result = sized.decode(&mut context, data);
        *out = sized.bytes;
        match result {
            Ok(()) => return Ok(()),
            Err(code) => {
                out.clear();
                let name = zstd_safe::get_error_name(code);
                if name != TOO_SMALL {
                    return Err(CodecError::damaged(format!(
                        "the zstd data is damaged or cut: {name}"
                    )));
                }
                if room >= most {
                    return Err(too_much("zstd", most));
                }
                room = room.saturating_mul(8).min(most);
            }
        }
    }
}

/// What zstd calls an output that is too small.
const TOO_SMALL: &str = "Destination buffer is too small";

/// A buffer of which only the first `room` bytes may be filled.
struct Sized {
    bytes: Vec<u8>,
    room: usize,
}

impl Sized {
    fn decode(
        &mut self,
        context: &mut zstd_safe::DCtx<'_>,
        data: &[u8],
    ) -> Result<(), zstd_safe::ErrorCode> {
        self.bytes.resize(self.room, 0);
        let decoded = context.decompress(self.bytes.as_mut_slice(), data)?;
        self.bytes.truncate(decoded);
        Ok(())
    }
}

/// Takes the last four bytes as the CRC-32C of those before them, little-endian, and gives those.
pub(crate) fn crc32c(data: &[u8]) -> Result<&[u8], CodecError> {
    let Some((content, stored)) = data.split_last_chunk::<4>() else {
        return Err(CodecError::damaged(format!(
            "{} bytes found, at least the 4 of a CRC-32C expected",
            data.len()
        )));
    };
    let (found, stored) = (::crc32c::crc32c(content), u32::from_le_bytes(*stored));
    if found != stored {
        return Err(CodecError::damaged(format!(
            "its CRC-32C is {found:08x}, {stored:08x} is stored"
        )));
    }
    Ok(content)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn packed(name: &str, data: &[u8]) -> Vec<u8> {
        let level = flate2::Compression::default();
        match name {
            "zlib" => {
                let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), level);
                encoder.write_all(data).unwrap();
                encoder.finish().unwrap()
            }
            "gzip" => {
                let mut encoder = flate2::write::GzEncoder::new(Vec::new(), level);
                encoder.write_all(data).unwrap();
                encoder.finish().unwrap()
            }
            "bzip2" => {
                let mut encoder =
                    bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
                encoder.write_all(data).unwrap();
                encoder.finish().unwrap()
            }
            _ => {
                let mut encoder = zstd::Encoder::new(Vec::new(), 1).unwrap();
                encoder.write_all(data).unwrap();
                encoder.finish().unwrap()
            }
        }
    }

    type Decoder = fn(&[u8], usize, &mut Vec<u8>) -> Result<(), CodecError>;
    const DECODERS: [(&str, Decoder); 4] = [
        ("zlib", zlib),
        ("gzip", gzip),
        ("bzip2", bzip2),
        ("zstd", super::zstd),
    ];

    #[test]
    fn a_piece_decodes_to_its_bytes_and_never_to_more_than_promised() {
        let ramp: Vec<u8> = (0..100_000_u32).map(|i| (i % 251) as u8).collect();
        let zeros = vec![0; 3_000_000];
        for (name, decode) in DECODERS {
            for data in [&ramp, &zeros] {
                let piece = packed(name, data);
                let mut out = vec![7; 5];
                decode(&piece, data.len(), &mut out).unwrap();
                assert!(&out == data, "{name}");
                let error = decode(&piece, data.len() - 1, &mut out).unwrap_err();
                assert!(error.message().contains("more than"), "{name}: {error:?}");
                assert!(out.is_empty());
                let error = decode(&piece[..piece.len() / 2], data.len(), &mut out).unwrap_err();
                assert!(error.message().contains(name), "{error:?}");
            }
        }
    }

    #[test]
    fn several_frames_are_one_piece() {
        for (name, decode) in DECODERS.into_iter().filter(|(name, _)| *name != "zlib") {
            let two = [packed(name, b"one, "), packed(name, b"two")].concat();
            let mut out = Vec::new();
            decode(&two, 100, &mut out).unwrap();
            assert_eq!(out, b"one, two", "{name}");
        }
    }

    #[test]
    fn a_checksum_of_the_content_is_verified_and_taken_off() {
        // The check value of CRC-32C.
        let mut data = b"123456789".to_vec();
        data.extend(0xe306_9283_u32.to_le_bytes());
        assert_eq!(crc32c(&data).unwrap(), b"123456789");
        data[0] ^= 1;
        assert!(crc32c(&data).is_err());
        assert!(crc32c(&data[..3]).is_err());
    }
}
