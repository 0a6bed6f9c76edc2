//! The lines of a NRRD header.
//!
//! In: the input, from its first byte. Out: the fields by their canonical names, values as they are
//! written, and the file names that follow `data file: LIST`. Each spelling of a field that the
//! specification knows is understood, in any case of letters; comments and key/value pairs are passed
//! over. A field that occurs twice is refused, one that nobody knows is warned about.

use crate::error::Error;
use crate::input::Input;
use crate::lines::{Line, next_line};
use crate::parsed::Context;

/// The first letters of every NRRD file; the version follows.
pub(crate) const MAGIC: &[u8] = b"NRRD0";

/// The fields of the specification. Those of two words may be written as one.
const FIELDS: [&str; 30] = [
    "content",
    "number",
    "type",
    "block size",
    "dimension",
    "space",
    "space dimension",
    "sizes",
    "spacings",
    "thicknesses",
    "axis mins",
    "axis maxs",
    "space directions",
    "centerings",
    "kinds",
    "labels",
    "units",
    "min",
    "max",
    "old min",
    "old max",
    "endian",
    "encoding",
    "line skip",
    "byte skip",
    "sample units",
    "space units",
    "space origin",
    "measurement frame",
    "data file",
];

/// One field.
pub(super) struct Field {
    name: &'static str,
    pub(super) value: String,
    pub(super) at: u64,
}

/// The header, read but not yet understood.
pub(super) struct Fields {
    fields: Vec<Field>,
    /// The names behind `data file: LIST`.
    pub(super) list: Vec<String>,
    /// The last digit of the first line.
    pub(super) version: char,
    pub(super) warnings: Vec<String>,
}

impl Fields {
    /// Reads the header up to the empty line that ends it, or to the end of the file if the voxels are
    /// in others.
    pub(super) fn read(input: &mut Input, context: &Context<'_>) -> Result<Self, Error> {
        let name = context.name;
        let magic = next_line(input, context)?.map_or(String::new(), |line| line.text);
        let version = match magic.strip_prefix("NRRD") {
            Some("00.01") => '0',
            Some(number) if number.len() == 4 && number.starts_with("000") => {
                number.chars().last().unwrap_or('?')
            }
            _ => '?',
        };
        if !('0'..='5').contains(&version) {
            let shown: String = magic.chars().take(16).collect();
            return Err(Error::unsupported(
                name,
                format!("the first line is '{shown}'; NRRD0001 to NRRD0005 expected"),
            )
            .at(0));
        }
        let mut header = Self {
            fields: Vec::new(),
            list: Vec::new(),
            version,
            warnings: Vec::new(),
        };
        let ended = loop {
            let Some(line) = next_line(input, context)? else {
                break false;
            };
            if line.text.is_empty() {
                break true;
            }
            if line.text.starts_with('#') {
                continue;
            }
            if header.take(&line, name)? {
                header.read_list(input, context)?;
                break true;
            }
        };
        if !ended && header.find("data file").is_none() {
            return Err(Error::invalid(
                name,
                "the header is not ended by an empty line, and no data file is named",
            )
            .at(input.position()));
        }
        Ok(header)
    }

    /// Takes one line. True if names of files follow.
    fn take(&mut self, line: &Line, name: &str) -> Result<bool, Error> {
        /// More are not worth telling.
        const WARNINGS_MOST: usize = 10;
        let text = &line.text;
        let Some((word, value)) = text.split_once(':') else {
            let shown: String = text.chars().take(40).collect();
            return Err(Error::invalid(
                name,
                format!(
                    "the header has a line that is no 'field: value', no 'key:=value' and no \
                     comment: '{shown}'"
                ),
            )
            .at(line.at));
        };
        if value.starts_with('=') {
            return Ok(false);
        }
        let Some(field) = canonical(word) else {
            // A key may have a colon itself.
            if !value.contains(":=") && self.warnings.len() < WARNINGS_MOST {
                let shown: String = word.chars().take(40).collect();
                self.warnings.push(format!(
                    "{name}: the header field '{shown}' is not known; it is ignored"
                ));
            }
            return Ok(false);
        };
        if self.find(field).is_some() {
            return Err(
                Error::invalid(name, format!("the header has the field '{field}' twice"))
                    .at(line.at),
            );
        }
        let value = value.trim().to_string();
        let list = field == "data file" && (value == "LIST" || value.starts_with("LIST "));
        self.fields.push(Field {
            name: field,
            value,
            at: line.at,
        });
        Ok(list)
    }

    fn read_list(&mut self, input: &mut Input, context: &Context<'_>) -> Result<(), Error> {
        while let Some(line) = next_line(input, context)? {
            if line.text.is_empty() {
                break;
            }
            crate::beside::check_count(self.list.len() as u64 + 1, context)?;
            self.list.push(line.text);
        }
        Ok(())
    }

    pub(super) fn find(&self, name: &str) -> Option<&Field> {
        self.fields.iter().find(|field| field.name == name)
    }

    /// A field without which nothing can be read.
    pub(super) fn need(&self, name: &str, file: &str) -> Result<&Field, Error> {
        self.find(name)
            .ok_or_else(|| Error::invalid(file, format!("the header has no field '{name}'")))
    }
}

/// The canonical name of a field.
fn canonical(word: &str) -> Option<&'static str> {
    let word = word.trim().to_ascii_lowercase();
    if word == "centers" {
        return Some("centerings");
    }
    FIELDS
        .into_iter()
        .find(|field| *field == word || field.replace(' ', "") == word)
}

impl Field {
    /// The error that this field is wrong.
    pub(super) fn wrong(&self, file: &str, expected: &str) -> Error {
        let shown: String = self.value.chars().take(60).collect();
        Error::invalid(
            file,
            format!("{} is '{shown}'; {expected} expected", self.name),
        )
        .at(self.at)
    }

    /// The value as one number.
    pub(super) fn number<T: std::str::FromStr>(
        &self,
        file: &str,
        expected: &str,
    ) -> Result<T, Error> {
        self.value.parse().map_err(|_| self.wrong(file, expected))
    }

    /// The value as `count` numbers.
    pub(super) fn numbers(&self, count: usize, file: &str) -> Result<Vec<f64>, Error> {
        let numbers: Option<Vec<f64>> = words(&self.value).map(float).collect();
        numbers
            .filter(|numbers| numbers.len() == count)
            .ok_or_else(|| self.wrong(file, &format!("{count} numbers")))
    }

    /// The value as `count` words, which may be in double quotes.
    pub(super) fn texts(&self, count: usize, file: &str) -> Result<Vec<String>, Error> {
        let mut texts = Vec::new();
        let mut rest = self.value.trim_start();
        while !rest.is_empty() {
            let (text, behind) = match rest.strip_prefix('"') {
                Some(quoted) => quoted
                    .split_once('"')
                    .ok_or_else(|| self.wrong(file, "a closing quote"))?,
                None => rest.split_once([' ', '\t']).unwrap_or((rest, "")),
            };
            texts.push(text.trim().to_string());
            rest = behind.trim_start();
        }
        if texts.len() != count {
            return Err(self.wrong(file, &format!("{count} words")));
        }
        Ok(texts)
    }

    /// The value as vectors `(1,0,0)` or `none`.
    pub(super) fn vectors(&self, file: &str) -> Result<Vec<Option<Vec<f64>>>, Error> {
        let wrong = || self.wrong(file, "vectors such as (1,0,0), or none,");
        let mut vectors = Vec::new();
        let mut rest = self.value.trim_start();
        while !rest.is_empty() {
            if let Some(behind) = rest.strip_prefix("none") {
                vectors.push(None);
                rest = behind.trim_start();
                continue;
            }
            let (inner, behind) = rest
                .strip_prefix('(')
                .and_then(|inner| inner.split_once(')'))
                .ok_or_else(wrong)?;
            let vector: Option<Vec<f64>> = inner.split(',').map(|n| float(n.trim())).collect();
            vectors.push(Some(vector.ok_or_else(wrong)?));
            rest = behind.trim_start();
        }
        Ok(vectors)
    }
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split([' ', '\t', ',']).filter(|word| !word.is_empty())
}

/// A number as C programs write it.
fn float(text: &str) -> Option<f64> {
    text.parse().ok()
}
