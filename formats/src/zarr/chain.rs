//! The codecs of an array, one behind the other.
//!
//! In: the encoded bytes of a chunk. Out: its voxels, exactly as many bytes as its shape has.
//! Guaranteed: what is between two codecs is bounded too, by what a compressor may add to data
//! that does not compress. Chunks are decoded here, not by the crate `zarrs`: its codecs read
//! gzip and zstd data to the end whatever the size of the chunk, and there is no delta filter.

use crate::codec::{self, CodecError, blosc, shuffle};
use crate::header::{ByteOrder, DType, VoxelType};

/// One codec.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Step {
    Zlib,
    Gzip,
    Bzip2,
    Zstd,
    /// A block behind its size, as numcodecs writes it.
    Lz4,
    /// A stream of Java's `LZ4BlockOutputStream`.
    Lz4Java,
    /// With the name of the codec inside, for print.
    Blosc(String),
    Crc32c,
    /// Bytes of elements of this size, shuffled.
    Shuffle(usize),
    Delta(Delta),
}

/// The numcodecs filter: each number less the one before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Delta {
    /// Type of the voxels, and of the stored differences.
    pub(crate) voxels: DType,
    pub(crate) stored: DType,
}

impl Step {
    fn name(&self) -> String {
        match self {
            Self::Zlib => "zlib".into(),
            Self::Gzip => "gzip".into(),
            Self::Bzip2 => "bzip2".into(),
            Self::Zstd => "zstd".into(),
            Self::Lz4 | Self::Lz4Java => "lz4".into(),
            Self::Blosc(inner) => format!("blosc ({inner})"),
            Self::Crc32c => "crc32c".into(),
            Self::Shuffle(_) => "shuffle".into(),
            Self::Delta(_) => "delta".into(),
        }
    }

    fn compresses(&self) -> bool {
        !matches!(self, Self::Crc32c | Self::Shuffle(_) | Self::Delta(_))
    }

    /// The most bytes this codec makes of `decoded` bytes.
    fn encoded_most(&self, decoded: u64) -> u64 {
        match self {
            Self::Shuffle(_) => decoded,
            Self::Crc32c => decoded.saturating_add(4),
            Self::Delta(delta) => {
                let [voxels, stored] = [delta.voxels, delta.stored].map(|t| t.voxel.bytes() as u64);
                (decoded / voxels).saturating_mul(stored)
            }
            // Small blocks of Blosc add the most, a few bytes to each 128.
            _ => decoded.saturating_add(decoded / 2).saturating_add(4096),
        }
    }
}

/// Codecs in the order in which they are undone.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Chain {
    pub(crate) steps: Vec<Step>,
}

impl Chain {
    /// The most bytes of a chunk of `decoded` bytes.
    pub(crate) fn encoded_most(&self, decoded: u64) -> u64 {
        self.steps
            .iter()
            .rev()
            .fold(decoded, |bytes, step| step.encoded_most(bytes))
    }

    pub(crate) fn compresses(&self) -> bool {
        self.steps.iter().any(Step::compresses)
    }

    /// Names in the order in which they were applied; "none" without any.
    pub(crate) fn describe(&self) -> String {
        if self.steps.is_empty() {
            return "none".into();
        }
        let names: Vec<_> = self.steps.iter().rev().map(Step::name).collect();
        names.join(", ")
    }

    /// Replaces the encoded bytes in `data` by the `decoded` bytes they stand for; `spare` is
    /// overwritten.
    pub(crate) fn decode(
        &self,
        decoded: usize,
        data: &mut Vec<u8>,
        spare: &mut Vec<u8>,
    ) -> Result<(), CodecError> {
        for (i, step) in self.steps.iter().enumerate() {
            let rest = &self.steps[i + 1..];
            let most = rest
                .iter()
                .rev()
                .fold(decoded as u64, |bytes, step| step.encoded_most(bytes));
            let most = usize::try_from(most).unwrap_or(usize::MAX);
            match step {
                Step::Zlib => codec::zlib(data, most, spare)?,
                Step::Gzip => codec::gzip(data, most, spare)?,
                Step::Bzip2 => codec::bzip2(data, most, spare)?,
                Step::Zstd => codec::zstd(data, most, spare)?,
                Step::Lz4 => codec::lz4_sized(data, most, spare)?,
                Step::Lz4Java => codec::lz4_java(data, most, spare)?,
                Step::Blosc(_) => blosc::decode(data, most, spare)?,
                Step::Crc32c => {
                    let content = codec::crc32c(data)?.len();
                    data.truncate(content);
                    continue;
                }
                Step::Shuffle(element) => {
                    spare.resize(data.len(), 0);
                    shuffle::unshuffle(*element, data, spare);
                }
                Step::Delta(delta) => delta.sum(data, spare),
            }
            std::mem::swap(data, spare);
        }
        codec::exactly(decoded, data)
    }
}

impl Delta {
    /// Whether sums of such differences are defined the same way everywhere.
    pub(crate) fn is_exact(self) -> bool {
        let [voxels, stored] = [self.voxels.voxel, self.stored.voxel];
        let whole = |t: VoxelType| !t.is_float() && t != VoxelType::Bool;
        (whole(voxels) && whole(stored))
            || (voxels == stored && matches!(voxels, VoxelType::F32 | VoxelType::F64))
    }

    /// Replaces `out` by the running sums.
    fn sum(self, data: &[u8], out: &mut Vec<u8>) {
        out.clear();
        let stored = data.chunks_exact(self.stored.voxel.bytes());
        match self.voxels.voxel {
            VoxelType::F32 => {
                let mut sum = 0.0_f32;
                for bytes in stored {
                    sum += f32::from_bits(number(bytes, self.stored) as u32);
                    put(sum.to_bits().into(), self.voxels, out);
                }
            }
            VoxelType::F64 => {
                let mut sum = 0.0_f64;
                for bytes in stored {
                    sum += f64::from_bits(number(bytes, self.stored));
                    put(sum.to_bits(), self.voxels, out);
                }
            }
            _ => {
                // Sums wrap, as those of the arrays they come from.
                let mut sum = 0_u64;
                for bytes in stored {
                    sum = sum.wrapping_add(number(bytes, self.stored));
                    put(sum, self.voxels, out);
                }
            }
        }
    }
}

/// The bits of a number of up to 8 bytes, a signed one continued to 64 bits.
fn number(bytes: &[u8], dtype: DType) -> u64 {
    let signed = matches!(
        dtype.voxel,
        VoxelType::I8 | VoxelType::I16 | VoxelType::I32 | VoxelType::I64
    );
    let shift = |value: u64, byte: &u8| value << 8 | u64::from(*byte);
    let value = match dtype.byte_order {
        ByteOrder::Little => bytes.iter().rev().fold(0, shift),
        ByteOrder::Big => bytes.iter().fold(0, shift),
    };
    let unused = 64 - 8 * bytes.len().clamp(1, 8) as u32;
    if signed {
        ((value << unused) as i64 >> unused) as u64
    } else {
        value
    }
}

/// Appends the lowest bytes of a number.
fn put(value: u64, dtype: DType, out: &mut Vec<u8>) {
    let count = dtype.voxel.bytes();
    match dtype.byte_order {
        ByteOrder::Little => out.extend_from_slice(&value.to_le_bytes()[..count]),
        ByteOrder::Big => out.extend_from_slice(&value.to_be_bytes()[8 - count..]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain(steps: Vec<Step>) -> Chain {
        Chain { steps }
    }

    #[test]
    fn differences_are_summed_in_the_type_and_byte_order_of_the_voxels() {
        let delta = Delta {
            voxels: DType::big(VoxelType::U16),
            stored: DType::little(VoxelType::I8),
        };
        assert!(delta.is_exact());
        let mut data = [5_i8, -3, 127, -1].map(|n| n as u8).to_vec();
        let steps = chain(vec![Step::Delta(delta)]);
        assert_eq!(steps.encoded_most(8), 4);
        steps.decode(8, &mut data, &mut Vec::new()).unwrap();
        assert_eq!(data, [0, 5, 0, 2, 0, 129, 0, 128]);
    }

    #[test]
    fn a_chunk_that_is_not_as_long_as_its_shape_is_an_error() {
        let mut data = vec![0; 7];
        assert!(chain(vec![]).decode(8, &mut data, &mut Vec::new()).is_err());
        data.push(0);
        chain(vec![]).decode(8, &mut data, &mut Vec::new()).unwrap();
    }
}
