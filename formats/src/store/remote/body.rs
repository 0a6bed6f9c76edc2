//! An object read forward, and taken up again where the connection broke.

use std::io::{self, Read};
use std::sync::Arc;

use ureq::http::Response;
use ureq::{Body, BodyReader};

use super::objects::{Objects, stamp};
use crate::store::Stamp;

/// Breaks in a row, without a byte between them, after which it is given up.
const MOST_BREAKS: u32 = 3;

/// The bytes of an object, in order.
pub(super) struct Streamed {
    objects: Arc<Objects>,
    reader: BodyReader<'static>,
    position: u64,
    length: Option<u64>,
    stamp: Stamp,
    breaks: u32,
}

impl Streamed {
    pub(super) fn new(objects: Arc<Objects>, response: Response<Body>) -> Self {
        Self {
            objects,
            length: response.body().content_length(),
            stamp: stamp(&response),
            reader: response.into_body().into_reader(),
            position: 0,
            breaks: 0,
        }
    }

    /// Asks for the rest.
    fn resume(&mut self, why: io::Error) -> io::Result<()> {
        self.breaks += 1;
        if self.breaks > MOST_BREAKS {
            return Err(why);
        }
        let response = self
            .objects
            .resume(self.position)
            .map_err(|e| io::Error::other(e.message().to_string()))?;
        if self.stamp.differs(&stamp(&response)) {
            return Err(io::Error::other("the object changed while it was read"));
        }
        self.reader = response.into_body().into_reader();
        Ok(())
    }
}

impl Read for Streamed {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            match self.reader.read(out) {
                Ok(0)
                    if !out.is_empty()
                        && self.length.is_some_and(|length| self.position < length) =>
                {
                    let message = format!("the answer breaks off at byte {}", self.position);
                    self.resume(io::Error::other(message))?;
                }
                Ok(count) => {
                    self.position += count as u64;
                    if count > 0 {
                        self.breaks = 0;
                    }
                    return Ok(count);
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => self.resume(e)?,
            }
        }
    }
}
