//! The text of a VTK file: words and lines, read forward.
//!
//! In: an input that stands somewhere in the text. Out: words, numbers and lines. Guaranteed: a
//! word or a line that does not end is an error before it takes memory.

use std::io::BufRead;
use std::str::FromStr;

use crate::error::Error;
use crate::input::Input;
use crate::parsed::Context;

/// Longest word and longest line. Names of arrays are the longest words; a title has 256 bytes by
/// the specification, and longer ones are written.
const MOST_WORD_BYTES: usize = 1024;
const MOST_LINE_BYTES: usize = 4096;

pub(super) struct Text<'a> {
    pub(super) input: &'a mut Input,
    pub(super) context: &'a Context<'a>,
    /// A word that was looked at and is still to come.
    ahead: Option<String>,
}

impl<'a> Text<'a> {
    pub(super) fn new(input: &'a mut Input, context: &'a Context<'a>) -> Self {
        Self {
            input,
            context,
            ahead: None,
        }
    }

    pub(super) fn position(&self) -> u64 {
        self.input.position()
    }

    pub(super) fn invalid(&self, message: String) -> Error {
        Error::invalid(self.context.name, message).at(self.position())
    }

    pub(super) fn unsupported(&self, message: String) -> Error {
        Error::unsupported(self.context.name, message).at(self.position())
    }

    fn failed(&self, error: std::io::Error) -> Error {
        self.context.read_error(self.input, error)
    }

    /// The next byte, consumed; `None` at the end.
    fn byte(&mut self) -> Result<Option<u8>, Error> {
        let byte = match self.input.fill_buf() {
            Ok(have) => have.first().copied(),
            Err(e) => return Err(self.failed(e)),
        };
        if byte.is_some() {
            self.input.consume(1);
        }
        Ok(byte)
    }

    /// The rest of the line, without its end. What a line of text cannot be is replaced.
    pub(super) fn line(&mut self) -> Result<String, Error> {
        let mut line = self.ahead.take().unwrap_or_default().into_bytes();
        loop {
            match self.byte()? {
                None if line.is_empty() => {
                    return Err(self.invalid("the header ends early".into()));
                }
                None | Some(b'\n') => break,
                Some(byte) => line.push(byte),
            }
            if line.len() > MOST_LINE_BYTES {
                return Err(self.invalid(format!(
                    "a line of the header is longer than {MOST_LINE_BYTES} bytes"
                )));
            }
        }
        if line.last() == Some(&b'\r') {
            line.pop();
        }
        Ok(String::from_utf8_lossy(&line).into_owned())
    }

    /// The next word, and the white space before it; `None` at the end.
    pub(super) fn next_word(&mut self) -> Result<Option<String>, Error> {
        if let Some(word) = self.ahead.take() {
            return Ok(Some(word));
        }
        let mut word = Vec::new();
        loop {
            let next = match self.input.fill_buf() {
                Ok(have) => have.first().copied(),
                Err(e) => return Err(self.failed(e)),
            };
            match next {
                Some(byte) if !byte.is_ascii_whitespace() => word.push(byte),
                // The white space behind a word stays: values may follow its line end.
                _ if !word.is_empty() => break,
                None => return Ok(None),
                Some(_) => {}
            }
            self.input.consume(1);
            if word.len() > MOST_WORD_BYTES {
                return Err(self.invalid(format!(
                    "a word of the header is longer than {MOST_WORD_BYTES} bytes"
                )));
            }
        }
        Ok(Some(String::from_utf8_lossy(&word).into_owned()))
    }

    /// The next word, which must be there.
    pub(super) fn word(&mut self) -> Result<String, Error> {
        match self.next_word()? {
            Some(word) => Ok(word),
            None => Err(self.invalid("the header ends early".into())),
        }
    }

    /// The next word, left where it is.
    pub(super) fn peek_word(&mut self) -> Result<Option<String>, Error> {
        self.ahead = self.next_word()?;
        Ok(self.ahead.clone())
    }

    pub(super) fn expect(&mut self, keyword: &str) -> Result<(), Error> {
        let word = self.word()?;
        if word.eq_ignore_ascii_case(keyword) {
            return Ok(());
        }
        Err(self.invalid(format!("'{word}' found, {keyword} expected")))
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T, Error> {
        let word = self.word()?;
        word.parse()
            .map_err(|_| self.invalid(format!("'{word}' found, {what} expected")))
    }

    /// A number of things.
    pub(super) fn count(&mut self) -> Result<u64, Error> {
        self.number("a whole number")
    }

    pub(super) fn index(&mut self) -> Result<i64, Error> {
        self.number("a whole number")
    }

    pub(super) fn real(&mut self) -> Result<f64, Error> {
        self.number("a number")
    }

    /// Skips bytes, all of which must be there.
    pub(super) fn skip(&mut self, bytes: u64) -> Result<(), Error> {
        let skipped = match self.input.skip(bytes) {
            Ok(skipped) => skipped,
            Err(e) => return Err(self.failed(e)),
        };
        if skipped < bytes {
            return Err(self.invalid(format!(
                "the data ends early: {skipped} bytes of an array found, {bytes} expected"
            )));
        }
        Ok(())
    }

    /// Skips words, all of which must be there.
    pub(super) fn skip_words(&mut self, count: u64) -> Result<(), Error> {
        let (mut done, mut inside) = (0, false);
        while done < count {
            let have = match self.input.fill_buf() {
                Ok(have) => have,
                Err(e) => return Err(self.context.read_error(self.input, e)),
            };
            if have.is_empty() {
                done += u64::from(inside);
                break;
            }
            let mut used = 0;
            for byte in have {
                let space = byte.is_ascii_whitespace();
                if space && inside {
                    done += 1;
                }
                inside = !space;
                if done == count {
                    break;
                }
                used += 1;
            }
            self.input.consume(used);
        }
        if done < count {
            return Err(self.invalid(format!(
                "the data ends early: {done} values of an array found, {count} expected"
            )));
        }
        Ok(())
    }

    /// Skips a string of a binary file. Its length stands before it, in 1, 2, 4 or 8 bytes as the
    /// two highest bits of the first say.
    pub(super) fn skip_string(&mut self) -> Result<(), Error> {
        let Some(first) = self.byte()? else {
            return Err(self.invalid("the data ends early".into()));
        };
        let more = match first >> 6 {
            3 => 0,
            2 => 1,
            1 => 3,
            _ => 7,
        };
        let mut length = u64::from(first & 0x3f);
        for _ in 0..more {
            let Some(byte) = self.byte()? else {
                return Err(self.invalid("the data ends early".into()));
            };
            length = length << 8 | u64::from(byte);
        }
        self.skip(length)
    }

    /// Skips a METADATA block, which ends with an empty line.
    pub(super) fn skip_metadata(&mut self) -> Result<(), Error> {
        self.line()?;
        while self.peek_byte()?.is_some() {
            if self.line()?.trim().is_empty() {
                break;
            }
        }
        Ok(())
    }

    fn peek_byte(&mut self) -> Result<Option<u8>, Error> {
        match self.input.fill_buf() {
            Ok(have) => Ok(have.first().copied()),
            Err(e) => Err(self.failed(e)),
        }
    }

    /// Whether the text goes on with `keyword` and white space; it stays where it is.
    pub(super) fn is_next(&mut self, keyword: &str) -> Result<bool, Error> {
        let count = keyword.len() + 1;
        let found = match self.input.peek(count) {
            Ok(head) => {
                head.len() == count
                    && head[..keyword.len()].eq_ignore_ascii_case(keyword.as_bytes())
                    && head[keyword.len()].is_ascii_whitespace()
            }
            Err(e) => return Err(self.failed(e)),
        };
        Ok(found)
    }

    /// Skips white space.
    pub(super) fn skip_space(&mut self) -> Result<(), Error> {
        while self.peek_byte()?.is_some_and(|b| b.is_ascii_whitespace()) {
            self.input.consume(1);
        }
        Ok(())
    }
}
