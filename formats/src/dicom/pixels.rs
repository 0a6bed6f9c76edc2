//! The voxels of a stack, plane by plane.
//!
//! In: images and the order of their planes. Out: [`Chunks`], one plane a chunk: little-endian
//! samples in the type of the header. Bits beyond BitsStored (overlays, garbage) are cut off and
//! the sign is extended; where planes have different slopes, samples become the values they
//! mean. Each plane's file is opened when it is needed and must not have changed.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use crate::bytes::FileBytes;
use crate::chunked::Chunks;
use crate::error::Error;
use crate::header::{ByteOrder, Scaling, VoxelType};

use super::codec::{CodecResult, Extents, jpeg, jpeg2000, jpegls, rle};
use super::fragments::Fragments;
use super::image::{Image, SampleKind};
use super::series::Plane;
use super::stream::Stream;
use super::syntax::{Codec, Syntax};

/// The planes of a volume, from first to last.
pub(super) struct Planes {
    pub(super) images: Vec<Image>,
    pub(super) planes: Vec<Plane>,
    /// Where planes have different scalings: the type of values.
    pub(super) values: Option<VoxelType>,
    /// Of files with several frames.
    pub(super) fragments: HashMap<usize, Fragments>,
    /// The deflated file that was read last, to go on from there.
    pub(super) inflating: Mutex<Option<(usize, Stream)>>,
}

/// How a plane's numbers are scaled.
pub(super) fn scaling(plane: Plane, images: &[Image]) -> Scaling {
    let frame = plane.frame(images);
    Scaling {
        // A slope of 0 was never filled in.
        slope: frame.slope.filter(|&slope| slope != 0.0).unwrap_or(1.0),
        intercept: frame.intercept.unwrap_or(0.0),
    }
}

/// The type of the stored samples of an image that was checked by [`check`].
pub(super) fn voxel_type(image: &Image) -> Option<VoxelType> {
    Some(match (image.allocated, image.kind) {
        (1, _) => VoxelType::Bool,
        (8, SampleKind::Unsigned) => VoxelType::U8,
        (8, SampleKind::Signed) => VoxelType::I8,
        (16, SampleKind::Unsigned) => VoxelType::U16,
        (16, SampleKind::Signed) => VoxelType::I16,
        (32, SampleKind::Unsigned) => VoxelType::U32,
        (32, SampleKind::Signed) => VoxelType::I32,
        (32, SampleKind::Float) => VoxelType::F32,
        (64, SampleKind::Float) => VoxelType::F64,
        _ => return None,
    })
}

/// Refuses images whose pixels are not read, and checks that native pixels are there.
pub(super) fn check(image: &Image) -> Result<(), Error> {
    let name = image.place.name();
    let unsupported = |what: String| Err(Error::unsupported(&name, what));
    if image.columns == 0 || image.rows == 0 {
        return Err(Error::invalid(
            &name,
            format!("the image has {} x {} pixels", image.columns, image.rows),
        ));
    }
    if image.samples != 1
        || !matches!(
            image.photometric.as_str(),
            "" | "MONOCHROME1" | "MONOCHROME2"
        )
    {
        return unsupported(format!(
            "colour images are not read: PhotometricInterpretation {}, {} samples a pixel",
            image.photometric, image.samples
        ));
    }
    if image.mosaic {
        return unsupported(
            "a Siemens mosaic has the planes of a volume side by side in one image, which is not \
             read: convert it first"
                .into(),
        );
    }
    if image.cine {
        return unsupported(format!(
            "its {} frames are points in time (FrameIncrementPointer), not planes of a volume",
            image.frames.len()
        ));
    }
    if voxel_type(image).is_none() {
        return unsupported(format!(
            "pixels of {} bits are not read (BitsAllocated 1, 8, 16 and 32 are)",
            image.allocated
        ));
    }
    let bits_fit = image.stored >= 1
        && image.stored <= image.allocated
        && image.high_bit < image.allocated
        && image.high_bit + 1 >= image.stored;
    if image.kind != SampleKind::Float && !bits_fit {
        return Err(Error::invalid(
            &name,
            format!(
                "bits contradict each other: {} allocated, {} stored, the highest is bit {}",
                image.allocated, image.stored, image.high_bit
            ),
        ));
    }
    match (&image.syntax, image.pixels.length) {
        (Syntax::Refused(syntax), _) => unsupported(format!("{syntax} is not read")),
        (Syntax::Encapsulated(_), None) => Ok(()),
        (Syntax::Encapsulated(_), Some(_)) => {
            Err(Error::invalid(&name, "compressed pixels are not in fragments").at(image.pixels.at))
        }
        (_, None) => Err(
            Error::invalid(&name, "pixels that are not compressed are in fragments")
                .at(image.pixels.at),
        ),
        (native, Some(length)) => {
            let expected = plane_bits(image)
                .saturating_mul(image.frames.len() as u64)
                .div_ceil(8);
            let found = match native {
                Syntax::Native => image.place.len().saturating_sub(image.pixels.at),
                _ => u64::MAX,
            };
            let found = found.min(length.into());
            if found >= expected {
                return Ok(());
            }
            Err(Error::invalid(
                &name,
                format!(
                    "the pixels end early: {found} bytes found, {expected} expected ({} x {} of \
                     {} bits, {} frames)",
                    image.columns,
                    image.rows,
                    image.allocated,
                    image.frames.len()
                ),
            )
            .at(image.pixels.at))
        }
    }
}

/// Bits of a plane: less than 2^38.
fn plane_bits(image: &Image) -> u64 {
    u64::from(image.columns) * u64::from(image.rows) * u64::from(image.allocated)
}

/// How the samples of a plane have to be put right.
#[derive(Clone, Copy, Debug)]
struct Bits {
    order: ByteOrder,
    /// Bits below the lowest one.
    shift: u32,
    stored: u32,
    signed: bool,
}

impl Planes {
    /// Bytes of memory that say where the planes are.
    pub(super) fn held_bytes(&self) -> u64 {
        let frames: usize = self.images.iter().map(|i| size_of_val(&*i.frames)).sum();
        let fragments: usize = self.fragments.values().map(Fragments::held_bytes).sum();
        let lists = size_of_val(&*self.images) + size_of_val(&*self.planes);
        (lists + frames + fragments) as u64
    }

    /// The samples of a plane as the file has them, and how they have to be put right.
    fn stored(&self, plane: Plane, out: &mut Vec<u8>) -> Result<Bits, Error> {
        let image = &self.images[plane.image];
        let bytes = image.place.bytes()?;
        let native = Bits {
            order: image.pixels.encoding.order,
            shift: u32::from(image.high_bit) + 1 - u32::from(image.stored),
            stored: image.stored.into(),
            signed: image.kind == SampleKind::Signed,
        };
        let bits = match image.syntax {
            Syntax::Encapsulated(codec) => {
                let found;
                let fragments = match self.fragments.get(&plane.image) {
                    Some(fragments) => fragments,
                    None => {
                        found = Fragments::find(image, &bytes)?;
                        &found
                    }
                };
                let data = fragments.read(&bytes, plane.frame)?;
                decode(image, codec, &data, native, out).map_err(|what| {
                    Error::invalid(
                        image.place.name(),
                        format!("frame {}: {what}", plane.frame + 1),
                    )
                    .at(image.pixels.at)
                })?
            }
            _ => {
                self.read_native(plane, &bytes, out)?;
                native
            }
        };
        bytes.check()?;
        Ok(bits)
    }

    /// Reads uncompressed samples.
    fn read_native(&self, plane: Plane, bytes: &FileBytes, out: &mut Vec<u8>) -> Result<(), Error> {
        let image = &self.images[plane.image];
        let bits = plane_bits(image);
        let first = bits * plane.frame as u64;
        // Frames of single bits begin within a byte; words of 16 bits are kept whole.
        let words = image.allocated < 16;
        let start = if words { first / 16 * 2 } else { first / 8 };
        let end = (first + bits).div_ceil(8);
        let end = if words && image.pixels.length.is_some_and(|n| u64::from(n) > end) {
            end.next_multiple_of(2)
        } else {
            end
        };
        let too_large = || Error::unsupported(image.place.name(), "a plane does not fit memory");
        let count = usize::try_from(end - start).map_err(|_| too_large())?;
        match image.pixels.deflated_at {
            None => {
                let at = image.pixels.at + start;
                // A file may end with the last odd byte.
                let there = image.place.len().saturating_sub(at).min(count as u64);
                resize(out, there as usize).ok_or_else(too_large)?;
                bytes.read_into(at, out)?;
            }
            Some(at) => {
                let mut held = self
                    .inflating
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner);
                let from = image.pixels.at + start;
                let mut stream = match held.take() {
                    Some((of, stream)) if of == plane.image && stream.position() <= from => stream,
                    _ => Stream::inflated(bytes.clone(), at),
                };
                stream.skip(from - stream.position(), "the pixels")?;
                // In pieces: what is promised need not be there.
                const PIECE_BYTES: usize = 1 << 20;
                out.clear();
                while out.len() < count {
                    let before = out.len();
                    let now = (count - before).min(PIECE_BYTES);
                    out.try_reserve(now).map_err(|_| too_large())?;
                    out.resize(before + now, 0);
                    stream.read_all(&mut out[before..], "the pixels")?;
                }
                *held = Some((plane.image, stream));
            }
        }
        let swapped = image.pixels.encoding.order == ByteOrder::Big && &image.pixels.vr == b"OW";
        if words && swapped {
            for pair in out.as_chunks_mut::<2>().0 {
                pair.swap(0, 1);
            }
        }
        let skip = first - start * 8;
        if image.allocated == 8 {
            out.drain(..usize::try_from(skip / 8).unwrap_or(0).min(out.len()));
            out.truncate((bits / 8) as usize);
        } else if image.allocated == 1 {
            let packed = std::mem::take(out);
            let count = usize::try_from(bits).map_err(|_| too_large())?;
            out.try_reserve_exact(count).map_err(|_| too_large())?;
            let skip = skip as usize;
            out.extend((skip..skip + count).map(|bit| {
                let byte = packed.get(bit / 8).copied().unwrap_or(0);
                byte >> (bit % 8) & 1
            }));
        }
        Ok(())
    }
}

impl Chunks for Planes {
    fn decode(&self, index: [u64; 3], out: &mut Vec<u8>) -> Result<(), Error> {
        let plane = usize::try_from(index[2])
            .ok()
            .and_then(|z| self.planes.get(z).copied());
        let Some(plane) = plane else {
            out.clear();
            return Ok(());
        };
        let bits = self.stored(plane, out)?;
        let image = &self.images[plane.image];
        match image.allocated {
            8 => put_right::<1>(out, bits),
            16 => put_right::<2>(out, bits),
            32 if image.kind != SampleKind::Float => put_right::<4>(out, bits),
            32 if bits.order == ByteOrder::Big => swap::<4>(out),
            64 if bits.order == ByteOrder::Big => swap::<8>(out),
            _ => {}
        }
        if let Some(values) = self.values {
            let stored = std::mem::take(out);
            let samples = stored.len() / (usize::from(image.allocated) / 8).max(1);
            out.try_reserve_exact(samples.saturating_mul(values.bytes()))
                .map_err(|_| {
                    Error::unsupported(image.place.name(), "a plane does not fit memory")
                })?;
            scale(&stored, image, scaling(plane, &self.images), values, out);
        }
        Ok(())
    }
}

fn resize(out: &mut Vec<u8>, count: usize) -> Option<()> {
    out.clear();
    out.try_reserve_exact(count).ok()?;
    out.resize(count, 0);
    Some(())
}

/// Decodes a compressed frame.
fn decode(
    image: &Image,
    codec: Codec,
    data: &[u8],
    native: Bits,
    out: &mut Vec<u8>,
) -> CodecResult<Bits> {
    let extents = Extents {
        columns: image.columns.into(),
        rows: image.rows.into(),
    };
    let sample_bytes = usize::from(image.allocated) / 8;
    let little = Bits {
        order: ByteOrder::Little,
        ..native
    };
    let mut samples = Vec::new();
    let precision = match codec {
        Codec::Plain => {
            let count = extents.samples() * sample_bytes;
            let plane = data.get(..count).filter(|_| sample_bytes > 0);
            let plane = plane
                .ok_or_else(|| format!("{} bytes of pixels found, {count} expected", data.len()))?;
            out.clear();
            out.extend_from_slice(plane);
            return Ok(little);
        }
        Codec::Rle => {
            rle::decode(data, extents, sample_bytes, out)?;
            return Ok(little);
        }
        Codec::Jpeg { .. } => jpeg::decode(data, extents, &mut samples)?,
        Codec::JpegLs { .. } => jpegls::decode(data, extents, &mut samples)?,
        Codec::Jpeg2000 { .. } => jpeg2000::decode(data, extents, &mut samples)?,
    };
    if image.kind == SampleKind::Float || sample_bytes == 0 {
        return Err(format!(
            "samples of {} bits cannot be compressed so",
            image.allocated
        ));
    }
    resize(out, samples.len() * sample_bytes).ok_or("the frame does not fit memory")?;
    for (to, sample) in out.chunks_exact_mut(sample_bytes).zip(&samples) {
        for (byte, from) in to.iter_mut().zip(sample.to_le_bytes()) {
            *byte = from;
        }
    }
    // These codecs have no bits below the stored ones, and may have fewer. With loss they may
    // pass the highest stored value a little, which must not make it a low one.
    let stored = if image.syntax.is_lossy() && !native.signed {
        u32::from(image.allocated)
    } else {
        native.stored.min(precision.into())
    };
    Ok(Bits {
        shift: 0,
        stored,
        ..little
    })
}

/// Makes samples of `B` bytes little-endian, cuts off what is not stored, extends the sign.
fn put_right<const B: usize>(out: &mut [u8], bits: Bits) {
    let width = 8 * B as u32;
    if bits.stored == width && (bits.order == ByteOrder::Little || B == 1) {
        return;
    }
    let up = 32 - bits.stored;
    for sample in out.as_chunks_mut::<B>().0 {
        let mut word = [0; 4];
        word[..B].copy_from_slice(sample);
        if bits.order == ByteOrder::Big {
            word[..B].reverse();
        }
        let word = (u32::from_le_bytes(word) >> bits.shift) << up;
        let value = if bits.signed {
            (word.cast_signed() >> up).cast_unsigned()
        } else {
            word >> up
        };
        sample.copy_from_slice(&value.to_le_bytes()[..B]);
    }
}

fn swap<const B: usize>(out: &mut [u8]) {
    for sample in out.as_chunks_mut::<B>().0 {
        sample.reverse();
    }
}

/// Appends the values that stored samples mean.
fn scale(stored: &[u8], image: &Image, by: Scaling, values: VoxelType, out: &mut Vec<u8>) {
    let mut push = |sample: f64| {
        let value = by.slope * sample + by.intercept;
        if values == VoxelType::F32 {
            out.extend_from_slice(&(value as f32).to_le_bytes());
        } else {
            out.extend_from_slice(&value.to_le_bytes());
        }
    };
    match (image.allocated, image.kind) {
        (8, SampleKind::Signed) => stored.iter().for_each(|&b| push(b.cast_signed().into())),
        (8 | 1, _) => stored.iter().for_each(|&b| push(b.into())),
        (16, kind) => stored.as_chunks().0.iter().for_each(|&b| {
            push(match kind {
                SampleKind::Signed => i16::from_le_bytes(b).into(),
                _ => u16::from_le_bytes(b).into(),
            });
        }),
        (32, kind) => stored.as_chunks().0.iter().for_each(|&b| {
            push(match kind {
                SampleKind::Signed => i32::from_le_bytes(b).into(),
                SampleKind::Unsigned => u32::from_le_bytes(b).into(),
                SampleKind::Float => f32::from_le_bytes(b).into(),
            });
        }),
        _ => stored
            .as_chunks()
            .0
            .iter()
            .for_each(|&b| push(f64::from_le_bytes(b))),
    }
}
