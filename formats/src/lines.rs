//! Lines of text headers.
//!
//! In: an [`Input`] that stands in a text header. Out: its lines, without their ends (LF or CR LF) and
//! without blanks behind, each with its offset. Guaranteed: no more than [`HEADER_MOST_BYTES`] are held
//! or read, whatever the file is. Text is UTF-8, or else Latin-1, which old programs wrote for the
//! micro sign.

use std::io::BufRead;

use crate::error::Error;
use crate::input::Input;
use crate::parsed::Context;

/// The longest header that is read. Lists of ten thousands of files need some megabytes; no header
/// needs more.
pub(crate) const HEADER_MOST_BYTES: u64 = 16 << 20;

/// One line and where it begins.
pub(crate) struct Line {
    pub(crate) text: String,
    pub(crate) at: u64,
}

/// The next line; `None` at the end of the input.
pub(crate) fn next_line(input: &mut Input, context: &Context<'_>) -> Result<Option<Line>, Error> {
    let at = input.position();
    let mut bytes = Vec::new();
    loop {
        let position = input.position();
        let some = match input.fill_buf() {
            Ok(some) => some,
            Err(e) => return Err(context.read_error(input, e)),
        };
        if some.is_empty() {
            if bytes.is_empty() {
                return Ok(None);
            }
            break;
        }
        let end = some.iter().position(|b| *b == b'\n');
        let count = end.unwrap_or(some.len());
        if position + count as u64 > HEADER_MOST_BYTES {
            return Err(Error::invalid(
                context.name,
                format!(
                    "the text header does not end within {HEADER_MOST_BYTES} bytes, the most that \
                     is read"
                ),
            )
            .at(at));
        }
        bytes.extend_from_slice(&some[..count]);
        input.consume(count + usize::from(end.is_some()));
        if end.is_some() {
            break;
        }
    }
    let text = String::from_utf8(bytes)
        .unwrap_or_else(|e| e.as_bytes().iter().map(|b| char::from(*b)).collect());
    Ok(Some(Line {
        text: text.trim_end().to_string(),
        at,
    }))
}
