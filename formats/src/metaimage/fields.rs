//! The lines of a MetaImage header.
//!
//! In: the input, from its first byte. Out: the fields that matter, values as they are written. The header
//! ends with the line `ElementDataFile`. Fields that are not known are passed over, as in the library that
//! defines the format.

use crate::error::Error;
use crate::input::Input;
use crate::lines::next_line;
use crate::parsed::Context;

/// The fields that matter.
const FIELDS: [&str; 25] = [
    "ObjectType",
    "NDims",
    "FileFormatVersion",
    "DimSize",
    "HeaderSize",
    "ElementType",
    "ElementNumberOfChannels",
    "ElementSpacing",
    "ElementSize",
    "ElementByteOrderMSB",
    "BinaryDataByteOrderMSB",
    "BinaryData",
    "CompressedData",
    "ElementToIntensityFunctionSlope",
    "ElementToIntensityFunctionOffset",
    "Offset",
    "Position",
    "Origin",
    "ImagePosition",
    "Orientation",
    "Rotation",
    "TransformMatrix",
    "DistanceUnits",
    "AnatomicalOrientation",
    "ElementDataFile",
];

/// One field.
pub(super) struct Field {
    name: &'static str,
    pub(super) value: String,
    pub(super) at: u64,
}

/// The header, read but not yet understood.
pub(super) struct Fields(Vec<Field>);

/// Whether content that begins with `head` is a MetaIO object with dimensions: `NDims` stands behind
/// nothing but fields.
pub(crate) fn detect(head: &[u8]) -> bool {
    for line in head.split(|b| *b == b'\n') {
        let line = line.trim_ascii();
        if line.is_empty() {
            continue;
        }
        let Some(end) = line.iter().position(|b| matches!(b, b'=' | b':')) else {
            return false;
        };
        let key = line[..end].trim_ascii();
        if key.eq_ignore_ascii_case(b"NDims") {
            return true;
        }
        if key.is_empty() || !key.iter().all(|b| b.is_ascii_alphanumeric() || *b == b'_') {
            return false;
        }
    }
    false
}

impl Fields {
    /// Reads the header, up to the line end behind `ElementDataFile`.
    pub(super) fn read(input: &mut Input, context: &Context<'_>) -> Result<Self, Error> {
        let name = context.name;
        let mut fields = Self(Vec::new());
        while let Some(line) = next_line(input, context)? {
            let text = line.text.trim_start();
            if text.is_empty() {
                continue;
            }
            let Some((word, value)) = text.split_once(['=', ':']) else {
                let shown: String = text.chars().take(40).collect();
                return Err(Error::invalid(
                    name,
                    format!("the header has a line that is no 'field = value': '{shown}'"),
                )
                .at(line.at));
            };
            let word = word.trim();
            let Some(known) = FIELDS.into_iter().find(|f| f.eq_ignore_ascii_case(word)) else {
                continue;
            };
            if fields.find(known).is_some() {
                return Err(Error::invalid(
                    name,
                    format!("the header has the field {known} twice"),
                )
                .at(line.at));
            }
            fields.0.push(Field {
                name: known,
                value: value.trim().to_string(),
                at: line.at,
            });
            if known == "ElementDataFile" {
                return Ok(fields);
            }
        }
        Err(
            Error::invalid(name, "the header ends without the line ElementDataFile")
                .at(input.position()),
        )
    }

    pub(super) fn find(&self, name: &str) -> Option<&Field> {
        self.0.iter().find(|field| field.name == name)
    }

    /// The last of these that the header has.
    pub(super) fn last_of(&self, names: &[&str]) -> Option<&Field> {
        names.iter().rev().find_map(|name| self.find(name))
    }

    /// A field without which nothing can be read.
    pub(super) fn need(&self, name: &str, file: &str) -> Result<&Field, Error> {
        self.find(name)
            .ok_or_else(|| Error::invalid(file, format!("the header has no field {name}")))
    }

    /// A field that says yes or no. What does not begin like yes is no.
    pub(super) fn is_true(&self, name: &str, default: bool) -> bool {
        self.find(name).map_or(default, |field| {
            field.value.starts_with(['T', 't', '1', 'Y', 'y'])
        })
    }
}

impl Field {
    pub(super) fn name(&self) -> &'static str {
        self.name
    }

    /// The error that this field is wrong.
    pub(super) fn wrong(&self, file: &str, expected: &str) -> Error {
        let shown: String = self.value.chars().take(60).collect();
        Error::invalid(
            file,
            format!("{} is '{shown}'; {expected} expected", self.name),
        )
        .at(self.at)
    }

    /// The value as at least `count` numbers.
    pub(super) fn numbers(&self, count: usize, file: &str) -> Result<Vec<f64>, Error> {
        let numbers: Result<Vec<f64>, _> = self.value.split_whitespace().map(str::parse).collect();
        numbers
            .ok()
            .filter(|numbers| numbers.len() >= count)
            .ok_or_else(|| self.wrong(file, &format!("{count} numbers")))
    }
}
