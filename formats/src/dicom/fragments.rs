//! Which fragments of encapsulated pixel data hold which frame (DICOM PS3.5, annex A.4).
//!
//! In: where the pixel data begins. Out: the place of each fragment, by frames. One fragment a
//! frame needs no table; several are told apart by the basic offset table, or without one by the
//! marker that begins a frame of the JPEG family.

use crate::bytes::FileBytes;
use crate::error::Error;

use super::element::{self, Encoding};
use super::image::Image;
use super::stream::Stream;
use super::syntax::{Codec, Syntax};

/// More fragments than this in one file are refused: each costs 16 bytes of memory.
const MOST_FRAGMENTS: usize = 1 << 20;

/// Fragments of one file.
#[derive(Debug)]
pub(super) struct Fragments {
    /// Place and length.
    fragments: Vec<(u64, u32)>,
    /// For each frame its first fragment, and one behind the last of all.
    starts: Vec<usize>,
}

impl Fragments {
    /// Finds the fragments of an image.
    pub(super) fn find(image: &Image, bytes: &FileBytes) -> Result<Self, Error> {
        const ITEM: u32 = 0xfffe_e000;
        const SEQUENCE_END: u32 = 0xfffe_e0dd;
        let invalid = |at: u64, what: String| Error::invalid(bytes.name(), what).at(at);
        let mut stream = Stream::plain(bytes.clone(), image.pixels.at);
        let mut fragments = Vec::new();
        let mut table = None;
        // The delimiter at the end is missing from some files that are whole.
        while let Some(item) = element::next(&mut stream, Encoding::EXPLICIT)? {
            match (item.tag, item.length) {
                (SEQUENCE_END, _) => break,
                (ITEM, Some(length)) => {
                    let at = stream.position();
                    stream.skip(length.into(), "a fragment of the pixel data")?;
                    if table.is_none() {
                        table = Some((at, length));
                    } else if fragments.len() >= MOST_FRAGMENTS {
                        return Err(Error::unsupported(
                            bytes.name(),
                            format!("more than {MOST_FRAGMENTS} fragments of pixel data"),
                        ));
                    } else {
                        fragments.push((at, length));
                    }
                }
                _ => {
                    return Err(invalid(
                        item.at,
                        "a fragment of the pixel data was expected".into(),
                    ));
                }
            }
        }
        let frames = image.frames.len();
        let (table_at, table_length) = table.unwrap_or((image.pixels.at, 0));
        let mut starts: Vec<usize> = if frames == 1 {
            vec![0]
        } else if fragments.len() == frames {
            (0..frames).collect()
        } else if table_length as usize / 4 == frames {
            let table = bytes.read(table_at, table_length.into())?;
            let base = table_at + u64::from(table_length);
            let mut starts = Vec::with_capacity(frames);
            for entry in table.as_chunks::<4>().0 {
                // Offsets point at the header of the item.
                let at = base + u64::from(u32::from_le_bytes(*entry)) + 8;
                match fragments.binary_search_by_key(&at, |(at, _)| *at) {
                    Ok(found) => starts.push(found),
                    Err(_) => {
                        return Err(invalid(
                            table_at,
                            "the basic offset table points beside the fragments".into(),
                        ));
                    }
                }
            }
            starts
        } else {
            first_fragments(image, bytes, &fragments)?
        };
        if starts.len() != frames || !starts.is_sorted() || fragments.is_empty() {
            return Err(invalid(
                image.pixels.at,
                format!(
                    "{} fragments of pixel data cannot be the {frames} frames",
                    fragments.len()
                ),
            ));
        }
        starts.push(fragments.len());
        Ok(Self { fragments, starts })
    }

    /// Bytes of memory of the table.
    pub(super) fn held_bytes(&self) -> usize {
        size_of_val(&*self.fragments) + size_of_val(&*self.starts)
    }

    /// The bytes of a frame, joined.
    pub(super) fn read(&self, bytes: &FileBytes, frame: usize) -> Result<Vec<u8>, Error> {
        let range = match self.starts.get(frame..frame + 2) {
            Some(&[start, end]) => start..end,
            _ => 0..0,
        };
        let fragments = self.fragments.get(range).unwrap_or_default();
        let total: u64 = fragments.iter().map(|(_, length)| u64::from(*length)).sum();
        // Each was found within the file, and they do not overlap.
        let mut data = Vec::with_capacity(usize::try_from(total.min(bytes.len())).unwrap_or(0));
        for &(at, length) in fragments {
            data.extend_from_slice(&bytes.read(at, length.into())?);
        }
        Ok(data)
    }
}

/// The fragments with which a frame begins, by their first bytes.
fn first_fragments(
    image: &Image,
    bytes: &FileBytes,
    fragments: &[(u64, u32)],
) -> Result<Vec<usize>, Error> {
    let marker: &[u8] = match image.syntax {
        Syntax::Encapsulated(Codec::Jpeg { .. } | Codec::JpegLs { .. }) => &[0xff, 0xd8],
        Syntax::Encapsulated(Codec::Jpeg2000 { .. }) => &[0xff, 0x4f],
        _ => return Ok(Vec::new()),
    };
    let mut starts = Vec::new();
    for (i, &(at, length)) in fragments.iter().enumerate() {
        if length >= 2 && *bytes.read(at, 2)? == *marker {
            starts.push(i);
        }
    }
    Ok(starts)
}
