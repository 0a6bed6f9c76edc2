//! Bytes read forward, through at most a few layers of decompression.
//!
//! In: any reader. Out: [`Input`], a buffered reader with a look ahead, over plain bytes or over
//! gzip, zstd, bzip2 or zlib data. Guaranteed: memory is bounded whatever the bytes say (one buffer a
//! layer, zstd windows up to 128 MiB); concatenated gzip members and zstd frames are one stream;
//! checksums are verified where the data carries them, by reading to the end; bytes behind the
//! compressed data are noted, not an error. Not guaranteed: that the end is ever reached, a
//! stream may be endless.

use std::fmt;
use std::io::{self, BufRead, Read};

use bzip2::bufread::BzDecoder;
use flate2::bufread::{GzDecoder, ZlibDecoder};

use crate::error::Error;

/// A whole-stream compression, recognised from its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Compression {
    Gzip,
    Zstd,
    Bzip2,
}

impl Compression {
    /// Bytes [`Compression::detect`] wants to see.
    pub(crate) const MAGIC_BYTES: usize = 10;

    /// The compression that data beginning with `head` has, if any.
    pub(crate) fn detect(head: &[u8]) -> Option<Self> {
        match head {
            // Method 8 is the only one there is; the upper flag bits are reserved and zero.
            [0x1f, 0x8b, 8, flags, ..] if flags & 0xe0 == 0 => Some(Self::Gzip),
            [0x28, 0xb5, 0x2f, 0xfd, ..] | [0x50..=0x5f, 0x2a, 0x4d, 0x18, ..] => Some(Self::Zstd),
            // A size of blocks, and the number that begins a block, or ends a stream without any.
            [b'B', b'Z', b'h', b'1'..=b'9', rest @ ..]
                if rest.starts_with(&[0x31, 0x41, 0x59, 0x26, 0x53, 0x59])
                    || rest.starts_with(&[0x17, 0x72, 0x45, 0x38, 0x50, 0x90]) =>
            {
                Some(Self::Bzip2)
            }
            _ => None,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Gzip => "gzip",
            Self::Zstd => "zstd",
            Self::Bzip2 => "bzip2",
        }
    }
}

/// The most bytes one byte of deflate data can stand for: 258 bytes in two bits.
pub(crate) const DEFLATE_MOST: u64 = 1032;

/// Marks an error of the system, so that it is not taken for damaged data on its way up.
#[derive(Debug)]
struct SystemError(io::Error);

impl fmt::Display for SystemError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for SystemError {}

/// Marks voxels written as text that are none, so that they are not taken for damaged compression.
#[derive(Debug)]
pub(crate) struct TextError(pub(crate) String);

impl fmt::Display for TextError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for TextError {}

/// One layer: bytes, and afterwards what was noticed on the way.
pub(crate) trait Layer: Read + Send {
    fn notes(&mut self) -> Vec<String> {
        Vec::new()
    }
}

/// The lowest layer: retries interrupted reads and marks the system's errors.
struct System<R>(R);

impl<R: Read> Read for System<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            match self.0.read(out) {
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(io::Error::new(e.kind(), SystemError(e))),
                Ok(n) => return Ok(n),
            }
        }
    }
}

impl<R: Read + Send> Layer for System<R> {}

/// How many bytes a layer asks of the one below.
const BUFFER_BYTES: usize = 128 * 1024;

/// A forward reader with a look ahead.
pub(crate) struct Input {
    layer: Box<dyn Layer>,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    position: u64,
}

impl Input {
    /// Plain bytes of `reader`.
    pub(crate) fn new(reader: impl Read + Send + 'static) -> Self {
        Self::over(Box::new(System(reader)))
    }

    /// Bytes that `layer` gives.
    pub(crate) fn over(layer: Box<dyn Layer>) -> Self {
        Self {
            layer,
            buffer: vec![0; BUFFER_BYTES],
            start: 0,
            end: 0,
            position: 0,
        }
    }

    /// What the rest of this input decompresses to.
    pub(crate) fn decompressed(self, compression: Compression) -> io::Result<Self> {
        Ok(Self::over(match compression {
            Compression::Gzip => Box::new(Members::<Gzip>::begin(self)?),
            Compression::Zstd => Box::new(Members::<Zstd>::begin(self)?),
            Compression::Bzip2 => Box::new(Members::<Bzip2>::begin(self)?),
        }))
    }

    /// The rest of this input, taken as zlib data (RFC 1950).
    pub(crate) fn zlib(self) -> io::Result<Self> {
        Ok(Self::over(Box::new(Members::<Zlib>::begin(self)?)))
    }

    /// The rest of this input, one byte for each bit, the highest bit of a byte first.
    pub(crate) fn bits(self) -> Self {
        Self::over(Box::new(Bits { input: self }))
    }

    /// Bytes consumed so far.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// The next `count` bytes without consuming them, fewer only at the end. `count` is at most
    /// the size of the buffer.
    pub(crate) fn peek(&mut self, count: usize) -> io::Result<&[u8]> {
        debug_assert!(count <= BUFFER_BYTES);
        if self.end - self.start < count {
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
            while self.end < count {
                let n = self.layer.read(&mut self.buffer[self.end..])?;
                if n == 0 {
                    break;
                }
                self.end += n;
            }
        }
        let have = (self.end - self.start).min(count);
        Ok(&self.buffer[self.start..self.start + have])
    }

    /// Reads until `out` is full or the input ends; gives the number of bytes.
    pub(crate) fn read_up_to(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut done = 0;
        while done < out.len() {
            match self.read(&mut out[done..])? {
                0 => break,
                n => done += n,
            }
        }
        Ok(done)
    }

    /// Appends up to `count` bytes to `out`, fewer only at the end. `out` grows with the bytes
    /// that are really there, not with `count`.
    pub(crate) fn append(&mut self, count: u64, out: &mut Vec<u8>) -> io::Result<u64> {
        /// Room made before anything was read; smaller steps only cost calls.
        const STEP_BYTES: u64 = 8 << 20;
        /// Room is made for this part of what is there, at least: more would be memory that
        /// nobody counted, less would copy large inputs many times.
        const PART: u64 = 8;
        let mut done = 0;
        while done < count {
            // Never beyond `count`: the caller's budget counts capacity, too.
            let step = (count - done).min(STEP_BYTES.max(done / PART));
            let step = usize::try_from(step).unwrap_or(usize::MAX);
            let before = out.len();
            out.try_reserve_exact(step).map_err(|_| {
                let e = io::Error::new(io::ErrorKind::OutOfMemory, "memory is exhausted");
                io::Error::new(e.kind(), SystemError(e))
            })?;
            out.resize(before + step, 0);
            let n = match self.read_up_to(&mut out[before..]) {
                Ok(n) => n,
                Err(e) => {
                    out.truncate(before);
                    return Err(e);
                }
            };
            out.truncate(before + n);
            done += n as u64;
            if n < step {
                break;
            }
        }
        Ok(done)
    }

    /// Skips up to `count` bytes; gives how many there were.
    pub(crate) fn skip(&mut self, count: u64) -> io::Result<u64> {
        let mut done = 0;
        while done < count {
            let have = self.fill_buf()?.len();
            if have == 0 {
                break;
            }
            let step = usize::try_from(count - done)
                .unwrap_or(usize::MAX)
                .min(have);
            self.consume(step);
            done += step as u64;
        }
        Ok(done)
    }

    /// What the layers noticed so far, for instance bytes behind the compressed data.
    pub(crate) fn notes(&mut self) -> Vec<String> {
        self.layer.notes()
    }
}

impl Read for Input {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        // Large reads of an empty buffer go straight to the layer: one copy less.
        if self.start == self.end && out.len() >= BUFFER_BYTES {
            let n = self.layer.read(out)?;
            self.position += n as u64;
            return Ok(n);
        }
        let have = self.fill_buf()?;
        let n = have.len().min(out.len());
        out[..n].copy_from_slice(&have[..n]);
        self.consume(n);
        Ok(n)
    }
}

impl BufRead for Input {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.start == self.end {
            self.start = 0;
            self.end = 0;
            self.end = self.layer.read(&mut self.buffer)?;
        }
        Ok(&self.buffer[self.start..self.end])
    }

    fn consume(&mut self, count: usize) {
        let count = count.min(self.end - self.start);
        self.start += count;
        self.position += count as u64;
    }
}

/// Bits as bytes 0 and 1.
struct Bits {
    input: Input,
}

impl Read for Bits {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let have = self.input.fill_buf()?;
        // The layer above asks for whole buffers, so there is room for at least one byte.
        let count = have.len().min(out.len() / 8);
        for (bits, byte) in out.chunks_exact_mut(8).zip(have) {
            for (at, bit) in bits.iter_mut().enumerate() {
                *bit = byte >> (7 - at) & 1;
            }
        }
        self.input.consume(count);
        Ok(8 * count)
    }
}

impl Layer for Bits {
    fn notes(&mut self) -> Vec<String> {
        self.input.notes()
    }
}

/// A decoder of one member (frame) of a compressed stream.
trait Member: Read + Send + Sized {
    const NAME: &'static str;
    fn begin(input: Input) -> io::Result<Self>;
    fn end(self) -> Input;
    fn input(&mut self) -> &mut Input;
    /// Whether data beginning with `head`, behind one member, is another one.
    fn is_member(head: &[u8]) -> bool;
}

type Gzip = GzDecoder<Input>;
type Bzip2 = BzDecoder<Input>;
type Zlib = ZlibDecoder<Input>;
type Zstd = zstd::stream::read::Decoder<'static, Input>;

impl Member for Gzip {
    const NAME: &'static str = "gzip";

    fn begin(input: Input) -> io::Result<Self> {
        Ok(GzDecoder::new(input))
    }

    fn end(self) -> Input {
        self.into_inner()
    }

    fn input(&mut self) -> &mut Input {
        self.get_mut()
    }

    fn is_member(head: &[u8]) -> bool {
        Compression::detect(head) == Some(Compression::Gzip)
    }
}

impl Member for Zlib {
    const NAME: &'static str = "zlib";

    fn begin(input: Input) -> io::Result<Self> {
        Ok(ZlibDecoder::new(input))
    }

    fn end(self) -> Input {
        self.into_inner()
    }

    fn input(&mut self) -> &mut Input {
        self.get_mut()
    }

    fn is_member(_: &[u8]) -> bool {
        false
    }
}

impl Member for Zstd {
    const NAME: &'static str = "zstd";

    fn begin(input: Input) -> io::Result<Self> {
        // A window is allocated as the data asks. 2^27 is the limit of the zstd tool, too;
        // larger would let a small file take gigabytes, smaller would refuse `zstd --ultra -22`.
        const WINDOW_LOG_MAX: u32 = 27;
        let mut decoder = zstd::stream::read::Decoder::with_buffer(input)?.single_frame();
        decoder.window_log_max(WINDOW_LOG_MAX)?;
        Ok(decoder)
    }

    fn end(self) -> Input {
        self.finish()
    }

    fn input(&mut self) -> &mut Input {
        self.get_mut()
    }

    fn is_member(head: &[u8]) -> bool {
        Compression::detect(head) == Some(Compression::Zstd)
    }
}

impl Member for Bzip2 {
    const NAME: &'static str = "bzip2";

    fn begin(input: Input) -> io::Result<Self> {
        Ok(BzDecoder::new(input))
    }

    fn end(self) -> Input {
        self.into_inner()
    }

    fn input(&mut self) -> &mut Input {
        self.get_mut()
    }

    fn is_member(head: &[u8]) -> bool {
        Compression::detect(head) == Some(Compression::Bzip2)
    }
}

/// Members one behind the other, as one stream.
struct Members<M> {
    member: Option<M>,
    rest: Option<Input>,
    notes: Vec<String>,
}

impl<M: Member> Members<M> {
    fn begin(input: Input) -> io::Result<Self> {
        Ok(Self {
            member: Some(M::begin(input)?),
            rest: None,
            notes: Vec::new(),
        })
    }
}

impl<M: Member> Read for Members<M> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if out.is_empty() {
            return Ok(0);
        }
        while let Some(member) = &mut self.member {
            let n = member.read(out)?;
            if n > 0 {
                return Ok(n);
            }
            let Some(member) = self.member.take() else {
                break;
            };
            let mut input = member.end();
            let head = input.peek(Compression::MAGIC_BYTES)?;
            if M::is_member(head) {
                self.member = Some(M::begin(input)?);
            } else {
                if !head.is_empty() {
                    self.notes.push(format!(
                        "bytes follow the {} data at byte {}; they are ignored",
                        M::NAME,
                        input.position()
                    ));
                }
                self.rest = Some(input);
            }
        }
        Ok(0)
    }
}

impl<M: Member> Layer for Members<M> {
    fn notes(&mut self) -> Vec<String> {
        let mut notes = std::mem::take(&mut self.notes);
        if let Some(input) = self.member.as_mut().map(M::input).or(self.rest.as_mut()) {
            notes.extend(input.notes());
        }
        notes
    }
}

/// The error that a failed read of an [`Input`] is, `offset` bytes into it.
pub(crate) fn read_error(name: &str, offset: u64, error: io::Error) -> Error {
    if error
        .get_ref()
        .is_some_and(|inner| inner.is::<SystemError>())
    {
        return Error::io(name, "cannot be read", error).at(offset);
    }
    if let Some(text) = error.get_ref().filter(|inner| inner.is::<TextError>()) {
        return Error::invalid(name, text.to_string());
    }
    if error.kind() == io::ErrorKind::UnexpectedEof {
        return Error::invalid(name, "the compressed data ends early: the file was cut").at(offset);
    }
    Error::invalid(name, format!("the compressed data is damaged: {error}")).at(offset)
}

/// Undoes one compression, if there is one.
pub(crate) fn decompress(
    mut input: Input,
    name: &str,
) -> Result<(Input, Option<Compression>), Error> {
    let failed = |e| read_error(name, 0, e);
    let head = input.peek(Compression::MAGIC_BYTES).map_err(failed)?;
    if head.is_empty() {
        return Err(Error::invalid(name, "is empty: 0 bytes"));
    }
    let Some(compression) = Compression::detect(head) else {
        return Ok((input, None));
    };
    let mut input = input.decompressed(compression).map_err(failed)?;
    let head = input.peek(Compression::MAGIC_BYTES).map_err(failed)?;
    if head.is_empty() {
        return Err(Error::invalid(
            name,
            format!("the {} data is empty", compression.name()),
        ));
    }
    Ok((input, Some(compression)))
}
