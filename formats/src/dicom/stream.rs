//! The bytes of a data set from front to back, plain or deflated.
//!
//! In: the bytes of a file. Out: reads and skips with a position in the (inflated) data. A plain
//! file is read in small pieces and skipped by seeking; a deflated one is inflated as far as
//! asked for and never held.

use std::io::{self, BufReader, Read};

use flate2::bufread::DeflateDecoder;

use crate::bytes::FileBytes;
use crate::error::Error;

/// Bytes read ahead of what is asked for: headers are read in pieces of a few bytes.
const AHEAD_BYTES: u64 = 4096;

/// A data set being read.
pub(super) struct Stream {
    bytes: FileBytes,
    at: u64,
    kind: Kind,
}

enum Kind {
    Plain { held: Vec<u8>, held_at: u64 },
    Inflated(Box<DeflateDecoder<BufReader<Forward>>>),
}

/// The bytes of a file as a reader.
struct Forward {
    bytes: FileBytes,
    at: u64,
}

impl Read for Forward {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let count = (self.bytes.len().saturating_sub(self.at)).min(out.len() as u64) as usize;
        self.bytes
            .read_into(self.at, &mut out[..count])
            .map_err(io::Error::other)?;
        self.at += count as u64;
        Ok(count)
    }
}

impl Stream {
    pub(super) fn plain(bytes: FileBytes, at: u64) -> Self {
        let kind = Kind::Plain {
            held: Vec::new(),
            held_at: at,
        };
        Self { bytes, at, kind }
    }

    /// The data that is deflated from byte `at` on; its positions count from 0.
    pub(super) fn inflated(bytes: FileBytes, at: u64) -> Self {
        let forward = BufReader::new(Forward {
            bytes: bytes.clone(),
            at,
        });
        Self {
            bytes,
            at: 0,
            kind: Kind::Inflated(Box::new(DeflateDecoder::new(forward))),
        }
    }

    pub(super) fn name(&self) -> &str {
        self.bytes.name()
    }

    pub(super) fn position(&self) -> u64 {
        self.at
    }

    /// Bytes that follow, where that is known.
    pub(super) fn remaining(&self) -> Option<u64> {
        match self.kind {
            Kind::Plain { .. } => Some(self.bytes.len().saturating_sub(self.at)),
            Kind::Inflated(_) => None,
        }
    }

    /// Fills `out`, less only where the data ends, and gives how much.
    pub(super) fn read(&mut self, out: &mut [u8]) -> Result<usize, Error> {
        let count = match &mut self.kind {
            Kind::Plain { held, held_at } => {
                let rest = self.bytes.len().saturating_sub(self.at);
                let count = rest.min(out.len() as u64) as usize;
                if let Some(slice) = self.bytes.slice(self.at, count as u64)? {
                    out[..count].copy_from_slice(slice);
                } else {
                    let from = |held_at: u64| usize::try_from(self.at.checked_sub(held_at)?).ok();
                    let within = |held: &[u8], held_at: u64| {
                        from(held_at).is_some_and(|from| from + count <= held.len())
                    };
                    if !within(held, *held_at) {
                        let ahead = rest.min(AHEAD_BYTES.max(count as u64));
                        *held = self.bytes.read(self.at, ahead)?.into_owned();
                        *held_at = self.at;
                    }
                    let from = from(*held_at).unwrap_or(0);
                    out[..count].copy_from_slice(&held[from..from + count]);
                }
                count
            }
            Kind::Inflated(decoder) => {
                let mut count = 0;
                while count < out.len() {
                    match decoder.read(&mut out[count..]) {
                        Ok(0) => break,
                        Ok(n) => count += n,
                        Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                        Err(e) => {
                            return Err(Error::invalid(
                                self.bytes.name(),
                                format!("the deflated data set is damaged: {e}"),
                            )
                            .at(self.at + count as u64));
                        }
                    }
                }
                count
            }
        };
        self.at += count as u64;
        Ok(count)
    }

    /// Fills `out`, or an error that says what ends early.
    pub(super) fn read_all(&mut self, out: &mut [u8], what: &str) -> Result<(), Error> {
        let start = self.at;
        let found = self.read(out)?;
        if found < out.len() {
            return Err(self.early(start, found as u64, out.len() as u64, what));
        }
        Ok(())
    }

    /// Goes `count` bytes on.
    pub(super) fn skip(&mut self, count: u64, what: &str) -> Result<(), Error> {
        let start = self.at;
        if let Some(remaining) = self.remaining() {
            if remaining < count {
                return Err(self.early(start, remaining, count, what));
            }
            self.at += count;
            return Ok(());
        }
        let mut buffer = [0; AHEAD_BYTES as usize];
        let mut left = count;
        while left > 0 {
            let now = left.min(AHEAD_BYTES) as usize;
            let found = self.read(&mut buffer[..now])?;
            if found == 0 {
                return Err(self.early(start, count - left, count, what));
            }
            left -= found as u64;
        }
        Ok(())
    }

    fn early(&self, start: u64, found: u64, expected: u64, what: &str) -> Error {
        Error::invalid(
            self.name(),
            format!("the file ends within {what}: {found} bytes found, {expected} expected"),
        )
        .at(start)
    }
}
