//! Metadata as JSON, with errors that name the file and the key.

use serde_json::Value;

use crate::error::Error;
use crate::store::{Part, Store};

/// More metadata than any container has; consolidated metadata of large plates takes some MiB.
const MOST_BYTES: u64 = 64 << 20;

/// A JSON document, or a part of it, and where it is from.
#[derive(Clone, Debug)]
pub(crate) struct Document {
    /// Name of the file.
    pub(crate) name: String,
    pub(crate) value: Value,
}

/// The document of that key, if there is one.
pub(crate) fn read(store: &dyn Store, key: &str) -> Result<Option<Document>, Error> {
    let mut bytes = Vec::new();
    if store
        .get(key, Part::All { most: MOST_BYTES }, &mut bytes)?
        .is_none()
    {
        return Ok(None);
    }
    let name = store.name(key);
    let value = parse(&bytes).map_err(|e| {
        Error::invalid(
            &name,
            format!("is not JSON: line {}, column {}: {e}", e.line(), e.column()),
        )
    })?;
    if !value.is_object() {
        return Err(Error::invalid(
            &name,
            format!("an object was expected, {} found", short(&value)),
        ));
    }
    Ok(Some(Document { name, value }))
}

/// Parses JSON, also with the NaN and Infinity that Python writes into it.
fn parse(bytes: &[u8]) -> Result<Value, serde_json::Error> {
    serde_json::from_slice(bytes).or_else(|e| match without_nan(bytes) {
        Some(mended) => serde_json::from_slice(&mended),
        None => Err(e),
    })
}

/// The text with bare NaN and Infinity in quotes, if there are any.
fn without_nan(bytes: &[u8]) -> Option<Vec<u8>> {
    const WORDS: [&[u8]; 3] = [b"-Infinity", b"Infinity", b"NaN"];
    let mut out = Vec::new();
    let (mut at, mut in_text, mut found) = (0, false, false);
    while let Some(&byte) = bytes.get(at) {
        let word = WORDS.iter().find(|word| bytes[at..].starts_with(word));
        match word {
            Some(word) if !in_text => {
                out.push(b'"');
                out.extend_from_slice(word);
                out.push(b'"');
                at += word.len();
                found = true;
                continue;
            }
            _ => {}
        }
        out.push(byte);
        at += 1;
        if in_text && byte == b'\\' {
            out.extend(bytes.get(at));
            at += 1;
        } else if byte == b'"' {
            in_text = !in_text;
        }
    }
    found.then_some(out)
}

/// A value for a message, cut where it is long.
pub(crate) fn short(value: &Value) -> String {
    const MOST: usize = 60;
    let text = value.to_string();
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text,
    }
}

impl Document {
    pub(crate) fn new(name: &str, value: Value) -> Self {
        Self {
            name: name.to_string(),
            value,
        }
    }

    /// The value of a key that must be there.
    pub(crate) fn required(&self, key: &str) -> Result<&Value, Error> {
        self.value
            .get(key)
            .ok_or_else(|| self.invalid(format!("has no '{key}'")))
    }

    /// The value of a key, unless it is missing or null.
    pub(crate) fn optional(&self, key: &str) -> Option<&Value> {
        self.value.get(key).filter(|value| !value.is_null())
    }

    /// A text that must be there.
    pub(crate) fn text(&self, key: &str) -> Result<&str, Error> {
        let value = self.required(key)?;
        value
            .as_str()
            .ok_or_else(|| self.wrong(key, value, "a text"))
    }

    /// Whole numbers that must be there, each at least `least`, one for each axis.
    pub(crate) fn extents(&self, key: &str, least: u64) -> Result<Vec<u64>, Error> {
        /// More axes than any array of pixels has.
        const MOST_AXES: usize = 32;
        let value = self.required(key)?;
        let wrong = || self.wrong(key, value, "whole numbers");
        let list = value.as_array().ok_or_else(wrong)?;
        if list.len() > MOST_AXES {
            return Err(self.unsupported(format!(
                "'{key}' has {} axes, at most {MOST_AXES} are read",
                list.len()
            )));
        }
        let mut extents = Vec::with_capacity(list.len());
        for item in list {
            let extent = item.as_u64().ok_or_else(wrong)?;
            if extent < least {
                return Err(self.invalid(format!(
                    "'{key}' is {}: an extent of {extent} holds nothing",
                    short(value)
                )));
            }
            extents.push(extent);
        }
        Ok(extents)
    }

    pub(crate) fn invalid(&self, message: impl Into<String>) -> Error {
        Error::invalid(&self.name, message)
    }

    pub(crate) fn unsupported(&self, message: impl Into<String>) -> Error {
        Error::unsupported(&self.name, message)
    }

    /// The error of a value of the wrong kind.
    pub(crate) fn wrong(&self, key: &str, value: &Value, expected: &str) -> Error {
        self.invalid(format!("'{key}' is {}, {expected} expected", short(value)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_json_does_not_have_are_read_as_python_writes_them() {
        let value = parse(br#"{"a": NaN, "b": [-Infinity, 1], "c": "NaN \" NaN"}"#).unwrap();
        assert_eq!(value["a"], "NaN");
        assert_eq!(value["b"][0], "-Infinity");
        assert_eq!(value["c"], "NaN \" NaN");
        assert!(parse(b"{\"a\": NaN").is_err());
    }
}
