//! What one DICOM file says about its image: one plane, or the frames of a multi-frame image.
//!
//! In: the bytes of a file. Out: [`Image`], or `None` if it is no DICOM file or has no pixels.
//! Only the header is read. Values that cannot be used (an empty or unreadable number) count as
//! absent, except where the size of the image rests on them.

use std::collections::HashMap;

use crate::bytes::FileBytes;
use crate::error::Error;

use super::element::{self, Binary, Element, Encoding, Until, Value, Visit, elements, items};
use super::place::Place;
use super::stream::Stream;
use super::syntax::Syntax;

/// More frames in one file than this are refused: each costs some hundred bytes of memory.
const MOST_FRAMES: i64 = 100_000;

/// What tells the volumes of one series apart, in the order in which it is tried: tags of data
/// sets and functional groups, and how their values are stored.
pub(super) const LABELS: [(&str, &[u32], Binary); 11] = [
    ("time", &[0x0020_0100], Binary::Text),
    ("time index", &[0x0020_9128], Binary::U32),
    ("segment", &[0x0062_000b], Binary::U16),
    ("stack", &[0x0020_9056], Binary::Text),
    ("echo time", &[0x0018_0081], Binary::Text),
    ("effective echo time", &[0x0018_9082], Binary::F64),
    ("b-value", &[0x0018_9087], Binary::F64),
    ("image type", &[0x0008_0008, 0x0008_9007], Binary::Text),
    ("acquisition", &[0x0020_0012], Binary::Text),
    ("trigger time", &[0x0018_1060], Binary::Text),
    // Of the files of multi-frame images, filled in by hand.
    ("instance", &[], Binary::Text),
];

/// Words, each stored once, as far as there is room: small deflated files can hold any number of
/// them.
#[derive(Debug, Default)]
pub(super) struct Words {
    numbers: HashMap<String, u32>,
    words: Vec<String>,
    bytes: usize,
}

impl Words {
    /// The number of a word, from 1; 0 stands for none, and for what there is no room for.
    fn number(&mut self, word: String) -> u32 {
        /// Far more than the words of any series.
        const MOST_BYTES: usize = 32 << 20;
        /// What a word takes beside its letters.
        const WORD_BYTES: usize = 96;
        if let Some(number) = self.numbers.get(&word) {
            return *number;
        }
        let bytes = self.bytes + 2 * word.len() + WORD_BYTES;
        let Ok(next) = u32::try_from(self.words.len() + 1) else {
            return 0;
        };
        if bytes > MOST_BYTES {
            return 0;
        }
        self.bytes = bytes;
        self.words.push(word.clone());
        self.numbers.insert(word, next);
        next
    }

    pub(super) fn word(&self, number: u32) -> &str {
        let index = (number as usize).wrapping_sub(1);
        self.words.get(index).map_or("none", String::as_str)
    }
}

/// What is known of one plane.
#[derive(Clone, Debug, Default)]
pub(super) struct Frame {
    /// Centre of the first voxel.
    pub(super) position: Option<[f64; 3]>,
    /// Direction of x, then of y.
    pub(super) orientation: Option<[f64; 6]>,
    /// Distance of rows (y), then of columns (x).
    pub(super) spacing: Option<[f64; 2]>,
    pub(super) thickness: Option<f64>,
    pub(super) between: Option<f64>,
    pub(super) slope: Option<f64>,
    pub(super) intercept: Option<f64>,
    pub(super) number: Option<i64>,
    /// Numbers of words, in the order of [`LABELS`].
    pub(super) labels: [u32; LABELS.len()],
}

/// How samples are numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum SampleKind {
    Unsigned,
    Signed,
    Float,
}

/// Where the pixels are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixels {
    /// Position in the (inflated) data of the first byte of the value.
    pub(super) at: u64,
    /// `None` for encapsulated fragments.
    pub(super) length: Option<u32>,
    pub(super) vr: [u8; 2],
    pub(super) encoding: Encoding,
    /// Where deflated data begins in the file.
    pub(super) deflated_at: Option<u64>,
}

/// An image and where it is.
#[derive(Debug)]
pub(super) struct Image {
    pub(super) place: Place,
    pub(super) syntax: Syntax,
    pub(super) instance_uid: String,
    pub(super) series_uid: String,
    pub(super) series_number: Option<i64>,
    pub(super) description: String,
    pub(super) modality: String,
    pub(super) columns: u16,
    pub(super) rows: u16,
    pub(super) samples: u16,
    pub(super) photometric: String,
    pub(super) allocated: u16,
    pub(super) stored: u16,
    pub(super) high_bit: u16,
    pub(super) kind: SampleKind,
    pub(super) padding: Option<i64>,
    pub(super) lossy: bool,
    pub(super) mosaic: bool,
    /// A lookup table stands where slope and intercept usually are.
    pub(super) lookup: bool,
    /// Pixel spacing was taken from an attribute that means something slightly different.
    pub(super) spacing_from: Option<&'static str>,
    /// Frames follow each other in time.
    pub(super) cine: bool,
    pub(super) pixels: Pixels,
    /// At least one.
    pub(super) frames: Vec<Frame>,
}

/// What a file turned out to be.
pub(super) enum Found {
    Image(Box<Image>),
    /// A DICOM file without pixels (a report, a plan, an index) and the series it is of.
    NoPixels(String),
    NotDicom,
}

/// Whether a file that begins with `head` is a DICOM file: with the preamble, or beginning with
/// elements of group 2 or 8 as they occur there.
pub(super) fn is_dicom(head: &[u8]) -> bool {
    start(head).is_some()
}

/// Where the first element is.
fn start(head: &[u8]) -> Option<u64> {
    const PREAMBLE: usize = 128;
    if head.get(PREAMBLE..PREAMBLE + 4) == Some(b"DICM") {
        return Some(PREAMBLE as u64 + 4);
    }
    let is_start = |at: usize| -> Option<(u16, usize)> {
        let head = head.get(at..at + 12)?;
        let word = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
        let (group, element) = (word(0), word(2));
        let known = match group {
            0x0002 => element <= 0x0102,
            0x0008 => element <= 0x0070,
            _ => false,
        };
        let explicit = [
            &b"UL"[..],
            b"OB",
            b"CS",
            b"UI",
            b"DA",
            b"TM",
            b"DT",
            b"SH",
            b"LO",
            b"SQ",
            b"PN",
        ]
        .contains(&&head[4..6]);
        let length = match (explicit, &head[4..6]) {
            (true, b"OB" | b"SQ") => {
                return (known && word(6) == 0).then_some((element, usize::MAX));
            }
            (true, _) => 8 + usize::from(word(6)),
            (false, _) if word(6) == 0 => 8 + usize::from(word(4)),
            _ => return None,
        };
        (known && length <= 8 + 256).then_some((element, at + length))
    };
    // Two elements in rising order: a single one would match too much.
    let (first, next) = is_start(0)?;
    if next == usize::MAX {
        return Some(0);
    }
    let (second, _) = is_start(next)?;
    (second > first || head.get(next) != head.first()).then_some(0)
}

/// Reads the header of a file.
pub(super) fn read(place: Place, bytes: FileBytes, words: &mut Words) -> Result<Found, Error> {
    /// The first elements of a file without preamble.
    const HEAD_BYTES: u64 = 1024;
    let head = bytes.read(0, bytes.len().min(HEAD_BYTES))?;
    let Some(start) = start(&head) else {
        return Ok(Found::NotDicom);
    };
    let (syntax_uid, at) = read_meta(&bytes, start)?;
    let syntax = Syntax::of(&syntax_uid);
    let deflated_at = matches!(syntax, Syntax::Deflated).then_some(at);
    let mut stream = if deflated_at.is_some() {
        Stream::inflated(bytes.clone(), at)
    } else {
        Stream::plain(bytes.clone(), at)
    };
    let encoding = if deflated_at.is_some() {
        Encoding::EXPLICIT
    } else {
        let mut head = [0; 8];
        if stream.read(&mut head)? < head.len() {
            return Ok(Found::NoPixels(String::new()));
        }
        stream = Stream::plain(bytes.clone(), at);
        Encoding::of_first(&head)
    };
    let mut draft = Draft::new(encoding, words);
    elements(&mut stream, encoding, Until::Data, 0, &mut |stream, e| {
        draft.element(stream, e)
    })?;
    bytes.check()?;
    draft.finish(place, syntax, deflated_at)
}

/// The transfer syntax of the file meta information at `start`, and where the data set begins.
fn read_meta(bytes: &FileBytes, start: u64) -> Result<(String, u64), Error> {
    let mut stream = Stream::plain(bytes.clone(), start);
    let mut uid = String::new();
    let mut end = start;
    while let Some(element) = element::next(&mut stream, Encoding::EXPLICIT)? {
        if element.tag >> 16 != 2 {
            break;
        }
        match (element.tag, element.length) {
            (0x0002_0010, _) => {
                uid = Value::read(&mut stream, Encoding::EXPLICIT, &element)?.text()
            }
            (_, Some(length)) => stream.skip(length.into(), "the file meta information")?,
            (_, None) => {
                return Err(Error::invalid(
                    bytes.name(),
                    "an element of the file meta information has no length",
                )
                .at(element.at));
            }
        }
        end = stream.position();
    }
    Ok((uid, end))
}

/// An image while its elements come in.
struct Draft<'a> {
    encoding: Encoding,
    words: &'a mut Words,
    texts: HashMap<u32, String>,
    rows: Option<u16>,
    columns: Option<u16>,
    samples: Option<u16>,
    allocated: Option<u16>,
    stored: Option<u16>,
    high_bit: Option<u16>,
    representation: Option<u16>,
    padding: Option<u16>,
    frame_count: Option<String>,
    increment: Option<u32>,
    imager_spacing: Option<[f64; 2]>,
    offsets: Option<Vec<f64>>,
    dose_scaling: Option<f64>,
    lookup: bool,
    /// What the data set says of all frames.
    common: Frame,
    /// What shared functional groups say of all frames.
    shared: Option<Frame>,
    per_frame: Vec<Frame>,
    pixels: Option<(Pixels, u32)>,
}

impl<'a> Draft<'a> {
    fn new(encoding: Encoding, words: &'a mut Words) -> Self {
        Self {
            encoding,
            words,
            texts: HashMap::new(),
            rows: None,
            columns: None,
            samples: None,
            allocated: None,
            stored: None,
            high_bit: None,
            representation: None,
            padding: None,
            frame_count: None,
            increment: None,
            imager_spacing: None,
            offsets: None,
            dose_scaling: None,
            lookup: false,
            common: Frame::default(),
            shared: None,
            per_frame: Vec::new(),
            pixels: None,
        }
    }

    /// Takes an element of the data set.
    fn element(&mut self, stream: &mut Stream, e: &Element) -> Result<Visit, Error> {
        let encoding = self.encoding;
        match e.tag {
            0x7fe0_0008..=0x7fe0_0010 if matches!(e.tag & 0xffff, 8 | 9 | 0x10) => {
                let pixels = Pixels {
                    at: stream.position(),
                    length: e.length,
                    vr: e.vr,
                    encoding,
                    deflated_at: None,
                };
                self.pixels = Some((pixels, e.tag));
                return Ok(Visit::Stop);
            }
            0x5200_9229 | 0x5200_9230 => {
                let shared = e.tag == 0x5200_9229;
                items(stream, encoding, e, 1, &mut |stream, encoding, until| {
                    let mut frame = Frame::default();
                    group(stream, encoding, until, 1, self.words, &mut frame)?;
                    if shared {
                        self.shared = Some(frame);
                    } else if self.per_frame.len() as i64 >= MOST_FRAMES {
                        return Err(Error::unsupported(
                            stream.name(),
                            format!("more than {MOST_FRAMES} frames in one file are not read"),
                        )
                        .at(stream.position()));
                    } else {
                        self.per_frame.push(frame);
                    }
                    Ok(())
                })?;
                return Ok(Visit::Taken);
            }
            // Nuclear medicine has position and orientation per detector.
            0x0054_0022 => {
                items(stream, encoding, e, 1, &mut |stream, encoding, until| {
                    elements(stream, encoding, until, 1, &mut |stream, e| {
                        let known = matches!(e.tag, 0x0020_0032 | 0x0020_0037);
                        if known {
                            frame_element(stream, encoding, e, self.words, &mut self.common)?;
                        }
                        Ok(if known { Visit::Taken } else { Visit::Pass })
                    })
                })?;
                return Ok(Visit::Taken);
            }
            _ => {}
        }
        if frame_element(stream, encoding, e, self.words, &mut self.common)? {
            return Ok(Visit::Taken);
        }
        let mut value = || Value::read(stream, encoding, e);
        match e.tag {
            0x0008_0018 | 0x0008_0060 | 0x0008_103e | 0x0020_000e | 0x0020_0011 | 0x0028_0004
            | 0x0028_2110 => {
                let text = value()?.text();
                self.texts.insert(e.tag, text);
            }
            0x0018_1164 | 0x0018_2010 => {
                self.imager_spacing = pair(&value()?).or(self.imager_spacing);
            }
            0x0028_0002 => self.samples = value()?.u16(),
            0x0028_0008 => self.frame_count = Some(value()?.text()),
            0x0028_0009 => self.increment = value()?.tag(),
            0x0028_0010 => self.rows = value()?.u16(),
            0x0028_0011 => self.columns = value()?.u16(),
            0x0028_0100 => self.allocated = value()?.u16(),
            0x0028_0101 => self.stored = value()?.u16(),
            0x0028_0102 => self.high_bit = value()?.u16(),
            0x0028_0103 => self.representation = value()?.u16(),
            0x0028_0120 => self.padding = value()?.u16(),
            0x0028_3000 => {
                self.lookup = true;
                return Ok(Visit::Pass);
            }
            0x3004_000c => self.offsets = value()?.decimals(),
            0x3004_000e => self.dose_scaling = value()?.decimal(),
            _ => return Ok(Visit::Pass),
        }
        Ok(Visit::Taken)
    }

    fn text(&self, tag: u32) -> String {
        self.texts.get(&tag).cloned().unwrap_or_default()
    }

    /// The image, if there is one.
    fn finish(
        mut self,
        place: Place,
        syntax: Syntax,
        deflated_at: Option<u64>,
    ) -> Result<Found, Error> {
        let Some((mut pixels, pixel_tag)) = self.pixels else {
            return Ok(Found::NoPixels(self.text(0x0020_000e)));
        };
        pixels.deflated_at = deflated_at;
        let name = place.name();
        let needed = |value: Option<u16>, what: &str| {
            value.ok_or_else(|| Error::invalid(&name, format!("the image has no {what}")))
        };
        let count = self.frame_count(&name)?;
        let (allocated, kind) = match (pixel_tag, self.representation) {
            (0x7fe0_0008, _) => (32, SampleKind::Float),
            (0x7fe0_0009, _) => (64, SampleKind::Float),
            (_, Some(1)) => (needed(self.allocated, "BitsAllocated")?, SampleKind::Signed),
            _ => (
                needed(self.allocated, "BitsAllocated")?,
                SampleKind::Unsigned,
            ),
        };
        let stored = self.stored.unwrap_or(allocated);
        let padding = self.padding.map(|value| match kind {
            SampleKind::Signed => value.cast_signed().into(),
            _ => value.into(),
        });
        let mosaic = self
            .words
            .word(self.common.labels[IMAGE_TYPE])
            .contains("MOSAIC");
        let spacing_from = (self.common.spacing.is_none() && self.imager_spacing.is_some())
            .then_some("the imager or the scanner, not from the patient (PixelSpacing)");
        self.common.spacing = self.common.spacing.or(self.imager_spacing);
        self.common.slope = self.common.slope.or(self.dose_scaling);
        let time = matches!(self.increment, Some(0x0018_1063 | 0x0018_1065));
        let frames = self.frames(count, &name)?;
        let cine = time && count > 1 && frames[0].position.is_none();
        Ok(Found::Image(Box::new(Image {
            instance_uid: self.text(0x0008_0018),
            series_uid: self.text(0x0020_000e),
            series_number: self.text(0x0020_0011).parse().ok(),
            description: self.text(0x0008_103e),
            modality: self.text(0x0008_0060),
            columns: needed(self.columns, "Columns")?,
            rows: needed(self.rows, "Rows")?,
            samples: self.samples.unwrap_or(1),
            photometric: self.text(0x0028_0004),
            allocated,
            stored,
            high_bit: self.high_bit.unwrap_or(stored.wrapping_sub(1)),
            kind,
            padding,
            lossy: self.text(0x0028_2110) == "01" || syntax.is_lossy(),
            mosaic,
            lookup: self.lookup,
            spacing_from,
            cine,
            pixels,
            frames,
            syntax,
            place,
        })))
    }

    fn frame_count(&self, name: &str) -> Result<usize, Error> {
        let text = self.frame_count.as_deref().unwrap_or("");
        if text.is_empty() {
            return Ok(1);
        }
        match text.parse() {
            Ok(count @ 1..=MOST_FRAMES) => Ok(usize::try_from(count).unwrap_or(1)),
            Ok(count) if count > MOST_FRAMES => Err(Error::unsupported(
                name,
                format!("{count} frames in one file, at most {MOST_FRAMES} are read"),
            )),
            _ => Err(Error::invalid(
                name,
                format!("NumberOfFrames is '{text}', a number of at least 1 expected"),
            )),
        }
    }

    /// The frames, each with what holds for all of them.
    fn frames(&mut self, count: usize, name: &str) -> Result<Vec<Frame>, Error> {
        if !self.per_frame.is_empty() && self.per_frame.len() != count {
            return Err(Error::invalid(
                name,
                format!(
                    "{} frames are described, NumberOfFrames is {count}",
                    self.per_frame.len()
                ),
            ));
        }
        let common = match self.shared.take() {
            Some(shared) => shared.over(&self.common),
            None => self.common.clone(),
        };
        if count == 1 && self.per_frame.is_empty() {
            return Ok(vec![common]);
        }
        let described = !self.per_frame.is_empty();
        let mut frames: Vec<_> = if described {
            self.per_frame.iter().map(|f| f.over(&common)).collect()
        } else {
            vec![common.clone(); count]
        };
        // One position for many planes says nothing, unless a dose grid has their offsets.
        if !described {
            let offsets = match (&self.offsets, common.position, common.normal()) {
                (Some(offsets), Some(position), Some(normal)) => {
                    if offsets.len() != count {
                        return Err(Error::invalid(
                            name,
                            format!(
                                "GridFrameOffsetVector has {} offsets, NumberOfFrames is {count}",
                                offsets.len()
                            ),
                        ));
                    }
                    Some((offsets, position, normal))
                }
                _ => None,
            };
            for (i, frame) in frames.iter_mut().enumerate() {
                frame.position = offsets.map(|(offsets, position, normal)| {
                    let along = offsets[i] - offsets[0];
                    [0, 1, 2].map(|a| position[a] + along * normal[a])
                });
            }
        }
        let instance = self.words.number(self.text(0x0008_0018));
        for (number, frame) in (1..).zip(&mut frames) {
            frame.number = Some(number);
            frame.labels[INSTANCE] = instance;
        }
        Ok(frames)
    }
}

/// Places in [`LABELS`].
const IMAGE_TYPE: usize = 7;
const INSTANCE: usize = 10;

impl Frame {
    /// This frame, with what it does not say itself from `common`.
    fn over(&self, common: &Self) -> Self {
        let mut labels = self.labels;
        for (label, common) in labels.iter_mut().zip(common.labels) {
            if *label == 0 {
                *label = common;
            }
        }
        Self {
            position: self.position.or(common.position),
            orientation: self.orientation.or(common.orientation),
            spacing: self.spacing.or(common.spacing),
            thickness: self.thickness.or(common.thickness),
            between: self.between.or(common.between),
            slope: self.slope.or(common.slope),
            intercept: self.intercept.or(common.intercept),
            number: self.number.or(common.number),
            labels,
        }
    }

    /// Unit vector across the plane, right-handed with the directions of x and y.
    pub(super) fn normal(&self) -> Option<[f64; 3]> {
        let [ax, ay, az, bx, by, bz] = self.orientation?;
        let normal = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
        let length = normal.iter().map(|n| n * n).sum::<f64>().sqrt();
        // Directions of length one at a right angle; text has few digits.
        ((length - 1.0).abs() < 1e-2).then(|| normal.map(|n| n / length))
    }
}

/// Reads a functional group: the macros that place a frame, tell its values, or tell it apart.
fn group(
    stream: &mut Stream,
    encoding: Encoding,
    until: Until,
    depth: usize,
    words: &mut Words,
    frame: &mut Frame,
) -> Result<(), Error> {
    /// Plane position and orientation, pixel measures, value transformation, frame content,
    /// frame types of MR, CT and PET, echo, diffusion, segment.
    const MACROS: [u32; 11] = [
        0x0020_9113,
        0x0020_9116,
        0x0028_9110,
        0x0028_9145,
        0x0020_9111,
        0x0018_9226,
        0x0018_9329,
        0x0018_9751,
        0x0018_9114,
        0x0018_9117,
        0x0062_000a,
    ];
    elements(stream, encoding, until, depth, &mut |stream, e| {
        if !MACROS.contains(&e.tag) {
            return Ok(Visit::Pass);
        }
        items(
            stream,
            encoding,
            e,
            depth + 1,
            &mut |stream, encoding, until| {
                elements(stream, encoding, until, depth + 1, &mut |stream, e| {
                    Ok(if frame_element(stream, encoding, e, words, frame)? {
                        Visit::Taken
                    } else {
                        Visit::Pass
                    })
                })
            },
        )?;
        Ok(Visit::Taken)
    })
}

/// Takes an element that says something of a frame, and says whether it was one.
fn frame_element(
    stream: &mut Stream,
    encoding: Encoding,
    e: &Element,
    words: &mut Words,
    frame: &mut Frame,
) -> Result<bool, Error> {
    let mut value = || Value::read(stream, encoding, e);
    match e.tag {
        0x0020_0032 => frame.position = value()?.decimals().and_then(|v| v.try_into().ok()),
        0x0020_0037 => frame.orientation = value()?.decimals().and_then(|v| v.try_into().ok()),
        0x0028_0030 => frame.spacing = pair(&value()?),
        0x0018_0050 => frame.thickness = value()?.decimal(),
        0x0018_0088 => frame.between = value()?.decimal(),
        0x0028_1052 => frame.intercept = value()?.decimal(),
        0x0028_1053 => frame.slope = value()?.decimal(),
        0x0020_0013 => frame.number = value()?.integer(),
        tag => {
            let label = LABELS.iter().position(|(_, tags, _)| tags.contains(&tag));
            let Some(label) = label else {
                return Ok(false);
            };
            if let Some(word) = value()?.label(LABELS[label].2) {
                frame.labels[label] = words.number(word);
            }
        }
    }
    Ok(true)
}

fn pair(value: &Value) -> Option<[f64; 2]> {
    value.decimals()?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_kept_once_and_as_far_as_there_is_room() {
        let mut words = Words::default();
        assert_eq!(words.number("a".into()), 1);
        assert_eq!(words.number("b".into()), 2);
        assert_eq!(words.number("a".into()), 1);
        assert_eq!((words.word(2), words.word(0)), ("b", "none"));
        let long = |n: usize| format!("{n}").repeat(1 << 19);
        let kept = (10..99).filter(|n| words.number(long(*n)) > 0).count();
        assert_eq!(kept, 15);
        assert_eq!(words.word(words.numbers[&long(13)]), long(13));
    }
}
