//! Data elements (DICOM PS3.5, section 7): tag, value representation, length, value.
//!
//! In: a stream and its encoding. Out: each element to a visitor, sequences item by item.
//! Guaranteed: lengths are checked against the stream before anything is allocated, values that
//! are read are short, sequences are followed to a limited depth, and every step goes forward.
//! Writers' slips that are read: a representation that is no pair of letters (the length is then
//! taken as in implicit encoding), and unknown (UN) sequences in implicit encoding.

use crate::error::Error;
use crate::header::ByteOrder;

use super::stream::Stream;

/// Sequences within sequences beyond this are refused. Real files have some six.
const MOST_DEPTH: usize = 24;

/// The longest value that is read: offsets of the frames of a dose grid.
const MOST_VALUE_BYTES: u32 = 1 << 20;

const ITEM: u32 = 0xfffe_e000;
const ITEM_END: u32 = 0xfffe_e00d;
const SEQUENCE_END: u32 = 0xfffe_e0dd;

/// How elements are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Encoding {
    pub(super) explicit: bool,
    pub(super) order: ByteOrder,
}

impl Encoding {
    pub(super) const EXPLICIT: Self = Self {
        explicit: true,
        order: ByteOrder::Little,
    };

    const IMPLICIT: Self = Self {
        explicit: false,
        order: ByteOrder::Little,
    };

    /// The encoding of the first element of a data set, which has a small group number.
    pub(super) fn of_first(head: &[u8; 8]) -> Self {
        let (little, big) = (
            u16::from_le_bytes([head[0], head[1]]),
            u16::from_be_bytes([head[0], head[1]]),
        );
        Self {
            explicit: is_representation([head[4], head[5]]),
            order: if little <= big {
                ByteOrder::Little
            } else {
                ByteOrder::Big
            },
        }
    }

    pub(super) fn u16(self, bytes: [u8; 2]) -> u16 {
        match self.order {
            ByteOrder::Little => u16::from_le_bytes(bytes),
            ByteOrder::Big => u16::from_be_bytes(bytes),
        }
    }

    pub(super) fn u32(self, bytes: [u8; 4]) -> u32 {
        match self.order {
            ByteOrder::Little => u32::from_le_bytes(bytes),
            ByteOrder::Big => u32::from_be_bytes(bytes),
        }
    }

    fn f64(self, bytes: [u8; 8]) -> f64 {
        match self.order {
            ByteOrder::Little => f64::from_le_bytes(bytes),
            ByteOrder::Big => f64::from_be_bytes(bytes),
        }
    }
}

fn is_representation(vr: [u8; 2]) -> bool {
    vr.iter().all(u8::is_ascii_uppercase)
}

/// An element whose value comes next in the stream.
#[derive(Clone, Copy, Debug)]
pub(super) struct Element {
    /// Group in the high half.
    pub(super) tag: u32,
    pub(super) vr: [u8; 2],
    /// `None`: up to a delimiter.
    pub(super) length: Option<u32>,
    /// Where the element begins.
    pub(super) at: u64,
}

/// What a visitor did with an element.
pub(super) enum Visit {
    /// Nothing: the value is to be skipped.
    Pass,
    /// It read the value.
    Taken,
    /// It needs nothing more.
    Stop,
}

/// Where a run of elements ends.
#[derive(Clone, Copy, Debug)]
pub(super) enum Until {
    /// With the data.
    Data,
    /// At a position.
    Position(u64),
    /// At the delimiter of an item.
    Delimiter,
}

/// The next element; `None` where the data ends.
pub(super) fn next(stream: &mut Stream, encoding: Encoding) -> Result<Option<Element>, Error> {
    let at = stream.position();
    let mut head = [0; 8];
    let found = stream.read(&mut head)?;
    if head[..found].iter().all(|&byte| byte == 0) && found < head.len() {
        // The end, or padding before it.
        return Ok(None);
    }
    if found < head.len() {
        return Err(Error::invalid(stream.name(), "the file ends within an element").at(at));
    }
    let [a, b, c, d, e, f, g, h] = head;
    let tag = (u32::from(encoding.u16([a, b])) << 16) | u32::from(encoding.u16([c, d]));
    let vr = [e, f];
    let is_delimiter = tag >> 16 == 0xfffe;
    let (vr, length) = if !encoding.explicit || is_delimiter || !is_representation(vr) {
        ([0, 0], encoding.u32([e, f, g, h]))
    } else if matches!(
        &vr,
        b"OB"
            | b"OD"
            | b"OF"
            | b"OL"
            | b"OV"
            | b"OW"
            | b"SQ"
            | b"SV"
            | b"UC"
            | b"UN"
            | b"UR"
            | b"UT"
            | b"UV"
    ) {
        let mut length = [0; 4];
        stream.read_all(&mut length, "the length of an element")?;
        (vr, encoding.u32(length))
    } else {
        (vr, u32::from(encoding.u16([g, h])))
    };
    Ok(Some(Element {
        tag,
        vr,
        length: (length != u32::MAX).then_some(length),
        at,
    }))
}

/// Shows the elements up to `until` to `visit`.
pub(super) fn elements(
    stream: &mut Stream,
    encoding: Encoding,
    until: Until,
    depth: usize,
    visit: &mut dyn FnMut(&mut Stream, &Element) -> Result<Visit, Error>,
) -> Result<(), Error> {
    loop {
        if let Until::Position(end) = until
            && stream.position() >= end
        {
            return Ok(());
        }
        let Some(element) = next(stream, encoding)? else {
            return match until {
                Until::Data => Ok(()),
                _ => Err(
                    Error::invalid(stream.name(), "the file ends within an item")
                        .at(stream.position()),
                ),
            };
        };
        if element.tag == ITEM_END && matches!(until, Until::Delimiter) {
            return Ok(());
        }
        match visit(stream, &element)? {
            Visit::Pass => skip(stream, encoding, &element, depth)?,
            Visit::Taken => {}
            Visit::Stop => return Ok(()),
        }
    }
}

/// Shows the items of a sequence to `visit`, which reads each to its end.
pub(super) fn items(
    stream: &mut Stream,
    encoding: Encoding,
    sequence: &Element,
    depth: usize,
    visit: &mut dyn FnMut(&mut Stream, Encoding, Until) -> Result<(), Error>,
) -> Result<(), Error> {
    if depth > MOST_DEPTH {
        return Err(Error::invalid(
            stream.name(),
            format!("more than {MOST_DEPTH} sequences within each other"),
        )
        .at(sequence.at));
    }
    // A sequence of unknown representation is in implicit encoding (PS3.5, 6.2.2).
    let encoding = if &sequence.vr == b"UN" {
        Encoding::IMPLICIT
    } else {
        encoding
    };
    let start = stream.position();
    let end = sequence.length.map(|length| start + u64::from(length));
    if let (Some(length), Some(remaining)) = (sequence.length, stream.remaining())
        && u64::from(length) > remaining
    {
        return Err(Error::invalid(
            stream.name(),
            format!("the file ends within a sequence: {remaining} bytes found, {length} expected"),
        )
        .at(start));
    }
    while end.is_none_or(|end| stream.position() < end) {
        let Some(item) = next(stream, encoding)? else {
            return Err(Error::invalid(stream.name(), "the file ends within a sequence").at(start));
        };
        match (item.tag, item.length) {
            (ITEM, Some(length)) => {
                let end = stream.position() + u64::from(length);
                visit(stream, encoding, Until::Position(end))?;
            }
            (ITEM, None) => visit(stream, encoding, Until::Delimiter)?,
            (SEQUENCE_END, _) => return Ok(()),
            (tag, _) => {
                return Err(Error::invalid(
                    stream.name(),
                    format!("an item of a sequence was expected, {} found", Tag(tag)),
                )
                .at(item.at));
            }
        }
    }
    Ok(())
}

/// Goes behind the value of an element.
fn skip(
    stream: &mut Stream,
    encoding: Encoding,
    element: &Element,
    depth: usize,
) -> Result<(), Error> {
    match element.length {
        Some(length) => stream.skip(length.into(), &format!("the value of {}", Tag(element.tag))),
        None => items(
            stream,
            encoding,
            element,
            depth + 1,
            &mut |stream, encoding, until| match until {
                Until::Position(end) => {
                    let count = end.saturating_sub(stream.position());
                    stream.skip(count, "an item")
                }
                _ => elements(stream, encoding, until, depth + 1, &mut |_, _| {
                    Ok(Visit::Pass)
                }),
            },
        ),
    }
}

/// A tag in print.
pub(super) struct Tag(pub(super) u32);

impl std::fmt::Display for Tag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "element ({:04x},{:04x})", self.0 >> 16, self.0 & 0xffff)
    }
}

/// The value of an element, of limited length.
pub(super) struct Value {
    bytes: Vec<u8>,
    encoding: Encoding,
}

impl Value {
    pub(super) fn read(
        stream: &mut Stream,
        encoding: Encoding,
        element: &Element,
    ) -> Result<Self, Error> {
        let what = || format!("the value of {}", Tag(element.tag));
        let length = element.length.filter(|&n| n <= MOST_VALUE_BYTES);
        let Some(length) = length else {
            return Err(Error::invalid(
                stream.name(),
                format!("{} is longer than {MOST_VALUE_BYTES} bytes", what()),
            )
            .at(element.at));
        };
        if let Some(remaining) = stream.remaining()
            && remaining < length.into()
        {
            // Says what is missing.
            stream.skip(length.into(), &what())?;
        }
        let mut bytes = vec![0; length as usize];
        stream.read_all(&mut bytes, &what())?;
        Ok(Self { bytes, encoding })
    }

    /// As text, without padding. Bytes that are not UTF-8 are taken as Latin-1.
    pub(super) fn text(&self) -> String {
        let text = match std::str::from_utf8(&self.bytes) {
            Ok(text) => text.to_string(),
            Err(_) => self.bytes.iter().map(|&byte| char::from(byte)).collect(),
        };
        text.trim_matches(|c: char| c.is_whitespace() || c == '\0' || c.is_control())
            .to_string()
    }

    /// As decimal numbers in text; `None` if one of them is not a finite number.
    pub(super) fn decimals(&self) -> Option<Vec<f64>> {
        self.text()
            .split('\\')
            .map(|number| number.trim().parse().ok().filter(|n: &f64| n.is_finite()))
            .collect()
    }

    pub(super) fn decimal(&self) -> Option<f64> {
        self.decimals()?.first().copied()
    }

    pub(super) fn integer(&self) -> Option<i64> {
        self.text().split('\\').next()?.trim().parse().ok()
    }

    pub(super) fn u16(&self) -> Option<u16> {
        let bytes = self.bytes.get(..2)?.try_into().ok()?;
        Some(self.encoding.u16(bytes))
    }

    pub(super) fn u32(&self) -> Option<u32> {
        let bytes = self.bytes.get(..4)?.try_into().ok()?;
        Some(self.encoding.u32(bytes))
    }

    /// A tag as a value.
    pub(super) fn tag(&self) -> Option<u32> {
        let &[a, b, c, d, ..] = self.bytes.as_slice() else {
            return None;
        };
        Some((u32::from(self.encoding.u16([a, b])) << 16) | u32::from(self.encoding.u16([c, d])))
    }

    /// A double precision number.
    pub(super) fn f64(&self) -> Option<f64> {
        let bytes = self.bytes.get(..8)?.try_into().ok()?;
        Some(self.encoding.f64(bytes)).filter(|n| n.is_finite())
    }

    /// The value as a word that tells images apart: numbers in print, text as it is.
    pub(super) fn label(&self, kind: Binary) -> Option<String> {
        match kind {
            Binary::Text => Some(self.text()).filter(|text| !text.is_empty()),
            Binary::U16 => self.u16().map(|n| n.to_string()),
            Binary::U32 => self.u32().map(|n| n.to_string()),
            Binary::F64 => self.f64().map(|n| n.to_string()),
        }
    }
}

/// How a value is stored.
#[derive(Clone, Copy, Debug)]
pub(super) enum Binary {
    Text,
    U16,
    U32,
    F64,
}
