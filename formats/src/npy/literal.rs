//! The few Python literals an `.npy` header is made of.
//!
//! In: text. Out: one [`Literal`], or the byte and the reason why it is none. Guaranteed: nothing
//! is evaluated, and neither depth nor size of the input can exhaust the stack.

use std::fmt;

/// A parsed literal.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Literal {
    Text(String),
    Int(i128),
    Bool(bool),
    None,
    Tuple(Vec<Literal>),
    List(Vec<Literal>),
    Dict(Vec<(Literal, Literal)>),
}

impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fn joined(items: &[Literal]) -> String {
            items
                .iter()
                .map(Literal::to_string)
                .collect::<Vec<_>>()
                .join(", ")
        }
        match self {
            Self::Text(text) => write!(f, "'{}'", text.escape_debug()),
            Self::Int(value) => write!(f, "{value}"),
            Self::Bool(true) => f.write_str("True"),
            Self::Bool(false) => f.write_str("False"),
            Self::None => f.write_str("None"),
            Self::Tuple(items) if items.len() == 1 => write!(f, "({},)", items[0]),
            Self::Tuple(items) => write!(f, "({})", joined(items)),
            Self::List(items) => write!(f, "[{}]", joined(items)),
            Self::Dict(_) => f.write_str("{...}"),
        }
    }
}

/// Where parsing stopped, and why.
pub(super) type Failure = (usize, String);

/// A structured dtype nests three deep; more than this is no header.
const MOST_DEPTH: usize = 16;

/// Parses `text`, which is one literal and white space around it.
pub(super) fn parse(text: &str) -> Result<Literal, Failure> {
    let mut parser = Parser {
        text: text.as_bytes(),
        at: 0,
    };
    let value = parser.value(0)?;
    parser.space();
    if parser.at < parser.text.len() {
        return parser.fail("something follows the literal");
    }
    Ok(value)
}

struct Parser<'a> {
    text: &'a [u8],
    at: usize,
}

impl Parser<'_> {
    fn fail<T>(&self, message: impl Into<String>) -> Result<T, Failure> {
        Err((self.at, message.into()))
    }

    fn peek(&self) -> Option<u8> {
        self.text.get(self.at).copied()
    }

    fn space(&mut self) {
        // Some writers pad with zero bytes instead of spaces.
        while matches!(self.peek(), Some(b' ' | b'\t' | b'\r' | b'\n' | 0)) {
            self.at += 1;
        }
    }

    fn take(&mut self, wanted: u8) -> bool {
        self.space();
        let found = self.peek() == Some(wanted);
        self.at += usize::from(found);
        found
    }

    fn word(&mut self, word: &str) -> bool {
        let rest = &self.text[self.at..];
        let ends = |b: Option<&u8>| !b.is_some_and(|b| b.is_ascii_alphanumeric() || *b == b'_');
        let found = rest.starts_with(word.as_bytes()) && ends(rest.get(word.len()));
        if found {
            self.at += word.len();
        }
        found
    }

    fn value(&mut self, depth: usize) -> Result<Literal, Failure> {
        if depth > MOST_DEPTH {
            return self.fail("nested too deep");
        }
        self.space();
        match self.peek() {
            Some(b'{') => self.dict(depth),
            Some(b'(') => {
                self.at += 1;
                let (mut items, comma) = self.items(b')', depth)?;
                // (x) is x in brackets, (x,) a tuple.
                match items.pop() {
                    Some(only) if items.is_empty() && !comma => Ok(only),
                    Some(last) => {
                        items.push(last);
                        Ok(Literal::Tuple(items))
                    }
                    None => Ok(Literal::Tuple(items)),
                }
            }
            Some(b'[') => {
                self.at += 1;
                Ok(Literal::List(self.items(b']', depth)?.0))
            }
            Some(b'\'' | b'"') => self.string(),
            Some(b'-' | b'0'..=b'9') => self.int(),
            _ if self.word("True") => Ok(Literal::Bool(true)),
            _ if self.word("False") => Ok(Literal::Bool(false)),
            _ if self.word("None") => Ok(Literal::None),
            _ => self.fail("a string, number, True, False, tuple, list or dictionary expected"),
        }
    }

    /// Items up to `close`; and whether a comma stood behind the last one.
    fn items(&mut self, close: u8, depth: usize) -> Result<(Vec<Literal>, bool), Failure> {
        let mut items = Vec::new();
        let mut comma = false;
        while !self.take(close) {
            if !items.is_empty() && !comma {
                return self.fail("a comma expected");
            }
            items.push(self.value(depth + 1)?);
            comma = self.take(b',');
        }
        Ok((items, comma))
    }

    fn dict(&mut self, depth: usize) -> Result<Literal, Failure> {
        self.at += 1;
        let mut entries = Vec::new();
        let mut comma = true;
        while !self.take(b'}') {
            if !comma {
                return self.fail("a comma expected");
            }
            let key = self.value(depth + 1)?;
            if !self.take(b':') {
                return self.fail("a colon expected");
            }
            entries.push((key, self.value(depth + 1)?));
            comma = self.take(b',');
        }
        Ok(Literal::Dict(entries))
    }

    fn string(&mut self) -> Result<Literal, Failure> {
        let quote = self.text[self.at];
        let start = self.at + 1;
        let Some(length) = self.text[start..].iter().position(|b| *b == quote) else {
            return self.fail("the string does not end");
        };
        let bytes = &self.text[start..start + length];
        // No key or dtype needs an escape; refusing them leaves nothing to get wrong.
        if bytes.iter().any(|b| *b == b'\\' || *b == b'\n') {
            return self.fail("an escape or line end in a string");
        }
        self.at = start + length + 1;
        // Cut at ASCII quotes out of valid UTF-8, so valid again.
        Ok(Literal::Text(String::from_utf8_lossy(bytes).into_owned()))
    }

    fn int(&mut self) -> Result<Literal, Failure> {
        let start = self.at;
        if self.peek() == Some(b'-') {
            self.at += 1;
        }
        while matches!(self.peek(), Some(b'0'..=b'9')) {
            self.at += 1;
        }
        let digits = std::str::from_utf8(&self.text[start..self.at]).unwrap_or_default();
        let Ok(value) = digits.parse() else {
            self.at = start;
            return self.fail("not a whole number");
        };
        // Python 2 wrote long numbers as 512L.
        if self.peek() == Some(b'L') {
            self.at += 1;
        }
        if self
            .peek()
            .is_some_and(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'.')
        {
            return self.fail("a whole number expected");
        }
        Ok(Literal::Int(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_numpy_header_is_read() {
        let found =
            parse("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4L, 5), }   \n").unwrap();
        let Literal::Dict(entries) = found else {
            panic!("not a dictionary")
        };
        assert_eq!(
            entries[0],
            (Literal::Text("descr".into()), Literal::Text("<f4".into()))
        );
        assert_eq!(entries[2].1.to_string(), "(3, 4, 5)");
    }

    #[test]
    fn brackets_alone_make_no_tuple() {
        assert_eq!(parse("(7)"), Ok(Literal::Int(7)));
        assert_eq!(parse("(7,)"), Ok(Literal::Tuple(vec![Literal::Int(7)])));
        assert_eq!(parse("()"), Ok(Literal::Tuple(vec![])));
    }

    #[test]
    fn code_is_not_a_literal() {
        for text in [
            "exit(7)",
            "{'a': exit(7)}",
            "__import__('os')",
            "1+1",
            "1.5",
            "Truest",
            "{'a': 1",
            "{'a' 1}",
            "{,}",
            "'a\\x41'",
            "[1 2]",
            "(,)",
            "'open",
            "-",
            "",
            "1 1",
        ] {
            assert!(parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn deep_nesting_is_an_error_not_a_stack_overflow() {
        assert!(parse(&"(".repeat(1 << 20)).is_err());
        assert!(parse(&"{'a':".repeat(1 << 18)).is_err());
    }
}
