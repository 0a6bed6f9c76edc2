//! The container of Blosc 1, as Zarr, N5, HDF5 and OpenVDB use it.
//!
//! ```text
//! 0 version | 1 version of the codec | 2 flags | 3 element size | 4 decoded | 8 block | 12 encoded
//! 16 starts of the blocks, 4 bytes each, then the blocks: (size, data) for each stream of a block
//! ```
//!
//! All numbers are little-endian. Flags: 1 bytes shuffled, 2 not compressed, 4 bits shuffled, 16
//! blocks not split, and from bit 5 the codec. A split block has one stream for each byte of an
//! element. A stream as long as what it stands for is not compressed.
//!
//! In: a container and the most bytes it may decode to. Out: its bytes. Guaranteed: every size in
//! it is checked against the container and against the promise before it is used. Refused: Blosc
//! 2, whose container is another one. Blosc's library is not taken because it is C and because
//! only the container is needed: the codecs inside are those of the rest of the crate.

use super::{CodecError, blosclz, lz4, shuffle, too_much};

const HEADER: usize = 16;

/// Largest element that is split into streams.
const SPLIT_MOST: usize = 16;

/// Least bytes of a stream of a split block.
const STREAM_LEAST: usize = 128;

/// What the header says.
struct Container<'a> {
    /// The container without what may lie behind it.
    data: &'a [u8],
    flags: u8,
    element: usize,
    decoded: usize,
    block: usize,
}

impl<'a> Container<'a> {
    fn parse(data: &'a [u8], most: usize) -> Result<Self, CodecError> {
        let Some(header) = data.first_chunk::<HEADER>() else {
            return Err(CodecError::damaged(format!(
                "{} bytes found, at least the {HEADER} of a Blosc header expected",
                data.len()
            )));
        };
        let field = |at: usize| {
            let bytes = [header[at], header[at + 1], header[at + 2], header[at + 3]];
            usize::try_from(u32::from_le_bytes(bytes)).unwrap_or(usize::MAX)
        };
        match header[0] {
            1 | 2 => {}
            3..=6 => {
                return Err(CodecError::unsupported(format!(
                    "container version {} of Blosc 2 is not read; Blosc 1 is",
                    header[0]
                )));
            }
            other => {
                return Err(CodecError::damaged(format!(
                    "the version of the Blosc container is {other}; 1 or 2 expected"
                )));
            }
        }
        let (decoded, block, encoded) = (field(4), field(8), field(12));
        if decoded > most {
            return Err(too_much("Blosc", most));
        }
        if encoded < HEADER || encoded > data.len() {
            return Err(CodecError::damaged(format!(
                "the Blosc header says {encoded} bytes, {} are there",
                data.len()
            )));
        }
        let element = usize::from(header[3]);
        if decoded > 0 && (block == 0 || block > decoded || element == 0) {
            return Err(CodecError::damaged(format!(
                "the Blosc header says blocks of {block} of {decoded} bytes, elements of {element}"
            )));
        }
        Ok(Self {
            data: &data[..encoded],
            flags: header[2],
            element,
            decoded,
            block,
        })
    }

    fn has(&self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// A number of 4 bytes at an offset.
    fn number(&self, at: usize) -> Result<usize, CodecError> {
        self.data
            .get(at..)
            .and_then(|rest| rest.first_chunk::<4>())
            .and_then(|bytes| usize::try_from(u32::from_le_bytes(*bytes)).ok())
            .ok_or_else(|| {
                CodecError::damaged(format!(
                    "the Blosc data ends early: {} bytes, at least {} expected",
                    self.data.len(),
                    at.saturating_add(4)
                ))
            })
    }

    /// Decodes the streams of the block that starts at `start` into `out`.
    fn streams(
        &self,
        inner: &mut Inner,
        start: usize,
        out: &mut [u8],
        last_and_short: bool,
    ) -> Result<(), CodecError> {
        let element = self.element;
        let split = !self.has(16)
            && !last_and_short
            && element <= SPLIT_MOST
            && out.len() / element >= STREAM_LEAST;
        let count = if split { element } else { 1 };
        let stream_bytes = out.len() / count;
        let mut at = start;
        // What a split leaves over belongs to no stream: Blosc makes blocks multiples of an element.
        if stream_bytes * count != out.len() {
            return Err(CodecError::damaged(format!(
                "a Blosc block of {} bytes cannot be split into {count} streams",
                out.len()
            )));
        }
        for stream in out.chunks_exact_mut(stream_bytes.max(1)) {
            let size = self.number(at)?;
            at += 4;
            let end = at.checked_add(size).filter(|end| *end <= self.data.len());
            let Some(end) = end else {
                return Err(CodecError::damaged(format!(
                    "a Blosc stream of {size} bytes at {at} ends behind the {} bytes there are",
                    self.data.len()
                )));
            };
            let data = &self.data[at..end];
            if size == stream.len() {
                stream.copy_from_slice(data);
            } else {
                let decoded = inner.decode(data, stream)?;
                if decoded != stream.len() {
                    return Err(CodecError::damaged(format!(
                        "a Blosc stream decodes to {decoded} bytes, {} expected",
                        stream.len()
                    )));
                }
            }
            at = end;
        }
        Ok(())
    }
}

/// The codec inside, which keeps its working memory from block to block.
enum Inner {
    BloscLz,
    Lz4,
    Snappy(Box<snap::raw::Decoder>),
    Zlib(Box<flate2::Decompress>),
    Zstd(zstd::zstd_safe::DCtx<'static>),
}

impl Inner {
    fn new(flags: u8) -> Result<Self, CodecError> {
        Ok(match flags >> 5 {
            0 => Self::BloscLz,
            1 => Self::Lz4,
            2 => Self::Snappy(Box::default()),
            3 => Self::Zlib(Box::new(flate2::Decompress::new(true))),
            4 => Self::Zstd(zstd::zstd_safe::DCtx::create()),
            other => {
                return Err(CodecError::unsupported(format!(
                    "codec {other} of Blosc is not known"
                )));
            }
        })
    }

    /// Decodes into `out`, at most all of it, and gives the number of bytes.
    fn decode(&mut self, data: &[u8], out: &mut [u8]) -> Result<usize, CodecError> {
        let damaged = |codec: &str, error: &dyn std::fmt::Display| {
            CodecError::damaged(format!("the {codec} data in Blosc is damaged: {error}"))
        };
        match self {
            Self::BloscLz => blosclz::decode_into(data, out),
            Self::Lz4 => lz4::block_into(data, out),
            Self::Snappy(decoder) => decoder
                .decompress(data, out)
                .map_err(|e| damaged("Snappy", &e)),
            Self::Zlib(decoder) => {
                decoder.reset(true);
                match decoder.decompress(data, out, flate2::FlushDecompress::Finish) {
                    Ok(flate2::Status::StreamEnd) => {
                        Ok(usize::try_from(decoder.total_out()).unwrap_or(usize::MAX))
                    }
                    Ok(_) => Err(damaged("zlib", &"it does not end where it should")),
                    Err(e) => Err(damaged("zlib", &e)),
                }
            }
            Self::Zstd(context) => context
                .decompress(out, data)
                .map_err(|code| damaged("zstd", &zstd::zstd_safe::get_error_name(code))),
        }
    }
}

/// Decodes a container; `out` is replaced.
pub(crate) fn decode(data: &[u8], most: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    out.clear();
    let container = Container::parse(data, most)?;
    let decoded = container.decoded;
    if container.has(2) {
        let stored = container.data.get(HEADER..HEADER.saturating_add(decoded));
        let Some(stored) = stored else {
            return Err(CodecError::damaged(format!(
                "{decoded} bytes stored without compression expected, {} found",
                container.data.len() - HEADER
            )));
        };
        out.extend_from_slice(stored);
        return Ok(());
    }
    if decoded == 0 {
        return Ok(());
    }
    let block = container.block;
    let starts = decoded.div_ceil(block);
    if starts.saturating_mul(4) > container.data.len() - HEADER {
        return Err(CodecError::damaged(format!(
            "{starts} Blosc blocks do not fit {} bytes",
            container.data.len()
        )));
    }
    let mut inner = Inner::new(container.flags)?;
    let bytes_shuffled = container.has(1) && container.element > 1;
    let mut shuffled = Vec::new();
    for i in 0..starts {
        let start = container.number(HEADER + 4 * i)?;
        let before = out.len();
        let size = block.min(decoded - before);
        // Block by block: what a damaged container only claims is not allocated.
        out.resize(before + size, 0);
        let whole = &mut out[before..];
        let bits_shuffled = container.has(4) && size >= container.element;
        if !bytes_shuffled && !bits_shuffled {
            container.streams(&mut inner, start, whole, size < block)?;
            continue;
        }
        shuffled.resize(size, 0);
        container.streams(&mut inner, start, &mut shuffled, size < block)?;
        if bytes_shuffled {
            shuffle::unshuffle(container.element, &shuffled, whole);
        } else if (size / container.element).is_multiple_of(8) {
            shuffle::unshuffle_bits(container.element, &shuffled, whole);
        } else {
            whole.copy_from_slice(&shuffled);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What tools/fixtures/blosc_1.py packs.
    fn steps() -> Vec<u8> {
        let value = |i: i16| (i % 13 + 16 * (i / 13 % 11) + 256 * (i / 143) - 1200) & !31;
        let once: Vec<u8> = (0..13 * 11 * 9)
            .flat_map(|i| value(i).to_le_bytes())
            .collect();
        once.repeat(4)
    }

    fn containers() -> Vec<(String, Vec<u8>)> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/blosc");
        let mut all: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "blosc"))
            .map(|path| (path.display().to_string(), std::fs::read(&path).unwrap()))
            .collect();
        all.sort();
        assert!(all.len() >= 40);
        all
    }

    /// A container of one block of one stream.
    fn container(codec: u8, packed: &[u8], decoded: usize) -> Vec<u8> {
        let mut data = vec![2, 1, codec << 5 | 16, 1];
        for number in [decoded, decoded, 24 + packed.len(), 20, packed.len()] {
            data.extend((number as u32).to_le_bytes());
        }
        data.extend(packed);
        data
    }

    #[test]
    fn containers_of_the_library_decode_with_every_codec_and_shuffle() {
        let mut out = Vec::new();
        for (name, data) in containers() {
            decode(&data, steps().len(), &mut out).unwrap_or_else(|e| panic!("{name}: {e:?}"));
            assert!(out == steps(), "{name}");
            assert!(
                decode(&data, steps().len() - 1, &mut out).is_err(),
                "{name}"
            );
        }
    }

    #[test]
    fn snappy_is_decoded_too() {
        let packed = snap::raw::Encoder::new().compress_vec(&steps()).unwrap();
        let mut out = Vec::new();
        let data = container(2, &packed, steps().len());
        decode(&data, 1 << 20, &mut out).unwrap();
        assert_eq!(out, steps());
    }

    #[test]
    fn blosc_2_is_refused_by_name() {
        let mut data = container(1, b"", 0);
        data[0] = 5;
        let error = decode(&data, 100, &mut Vec::new()).unwrap_err();
        assert!(error.message().contains("Blosc 2"));
    }

    #[test]
    fn damaged_containers_are_errors_or_bytes_but_no_panic() {
        let mut out = Vec::new();
        for (_, data) in containers() {
            for at in 0..data.len() {
                let _ = decode(&data[..at], steps().len(), &mut out);
                for flip in [1, 0x80, 0xff] {
                    let mut damaged = data.clone();
                    damaged[at] ^= flip;
                    if decode(&damaged, steps().len(), &mut out).is_ok() {
                        assert!(out.len() <= steps().len());
                    }
                }
            }
        }
    }

    #[test]
    fn what_a_container_only_claims_is_not_allocated() {
        let mut data = container(1, b"nothing", 1 << 30);
        data[8..12].copy_from_slice(&4096_u32.to_le_bytes());
        let mut out = Vec::new();
        assert!(decode(&data, usize::MAX, &mut out).is_err());
        assert!(out.capacity() < 1 << 20);
    }
}
