//! Lines and words of text formats, with the place for messages.
//!
//! In: an [`Input`]. Out: line after line without its end, split at blanks. Guaranteed: a line
//! longer than [`MOST_LINE_BYTES`] is an error, so a file without line ends is not held in memory.

use std::io::BufRead;

use crate::error::Error;
use crate::input::{Input, read_error};

/// The longest line: a polygon of a million corners. More would let a binary file be taken as one line.
const MOST_LINE_BYTES: usize = 16 << 20;

/// A reader of lines.
pub(super) struct Lines<'a> {
    input: &'a mut Input,
    name: &'a str,
    line: Vec<u8>,
    number: u64,
    ended: bool,
}

impl<'a> Lines<'a> {
    pub(super) fn new(input: &'a mut Input, name: &'a str) -> Self {
        Self::after(input, name, 0)
    }

    /// Lines of an input of which some lines were read already.
    pub(super) fn after(input: &'a mut Input, name: &'a str, lines: u64) -> Self {
        Self {
            input,
            name,
            line: Vec::new(),
            number: lines,
            ended: true,
        }
    }

    /// Goes to the next line; false at the end of the input.
    pub(super) fn advance(&mut self) -> Result<bool, Error> {
        self.line.clear();
        loop {
            let at = self.input.position();
            let have = self
                .input
                .fill_buf()
                .map_err(|e| read_error(self.name, at, e))?;
            if have.is_empty() {
                if !self.line.is_empty() {
                    self.number += 1;
                    self.ended = false;
                }
                return Ok(!self.line.is_empty());
            }
            let end = have.iter().position(|&b| b == b'\n');
            self.line
                .extend_from_slice(&have[..end.unwrap_or(have.len())]);
            let used = end.map_or(have.len(), |end| end + 1);
            self.input.consume(used);
            if self.line.len() > MOST_LINE_BYTES {
                self.number += 1;
                return Err(self.invalid(format!(
                    "is longer than {MOST_LINE_BYTES} bytes: this is no text"
                )));
            }
            if end.is_some() {
                self.number += 1;
                self.ended = true;
                return Ok(true);
            }
        }
    }

    /// The line.
    pub(super) fn line(&self) -> &[u8] {
        &self.line
    }

    /// Joins the next line to this one, whose last byte is dropped; false at the end of the input.
    pub(super) fn join_next(&mut self) -> Result<bool, Error> {
        let mut before = std::mem::take(&mut self.line);
        while before.last().is_some_and(u8::is_ascii_whitespace) {
            before.pop();
        }
        before.pop();
        let more = self.advance()?;
        before.push(b' ');
        before.extend_from_slice(&self.line);
        self.line = before;
        Ok(more)
    }

    /// The words of the line.
    pub(super) fn words(&self) -> impl Iterator<Item = &[u8]> {
        words(&self.line)
    }

    /// Whether the last line read ended as a line does.
    pub(super) fn ended(&self) -> bool {
        self.ended
    }

    /// An error about this line.
    pub(super) fn invalid(&self, message: impl AsRef<str>) -> Error {
        let text = format!("line {}: {}", self.number, message.as_ref());
        Error::invalid(self.name, text)
    }

    /// A number, perhaps not finite.
    pub(super) fn any_number(&self, word: &[u8]) -> Result<f64, Error> {
        text(word)
            .parse()
            .map_err(|_| self.invalid(format!("'{}' is not a number", shown(word))))
    }

    /// Three numbers from words, perhaps not finite; `what` names them.
    pub(super) fn triple<'w>(
        &self,
        what: &str,
        mut words: impl Iterator<Item = &'w [u8]>,
    ) -> Result<[f64; 3], Error> {
        let mut out = [0.0; 3];
        for (i, x) in out.iter_mut().enumerate() {
            let word = words
                .next()
                .ok_or_else(|| self.invalid(format!("{what}: {i} numbers found, 3 expected")))?;
            *x = self.any_number(word)?;
        }
        Ok(out)
    }
}

/// The words of a line.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace)
        .filter(|w| !w.is_empty())
}

/// A word as text; what is no text parses as no number.
pub(super) fn text(word: &[u8]) -> &str {
    std::str::from_utf8(word).unwrap_or("")
}

/// A word for a message, not too much of it.
pub(super) fn shown(word: &[u8]) -> String {
    const MOST: usize = 40;
    let short = &word[..word.len().min(MOST)];
    String::from_utf8_lossy(short)
        .chars()
        .map(|c| if c.is_control() { '?' } else { c })
        .collect()
}
