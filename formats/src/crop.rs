//! A box cut out of a volume, as a volume.
//!
//! In: a volume, and a range of the file's own indices along each axis. Out: the volume of these
//! voxels, with its origin moved. A source that runs forward is read to its end all the same, so
//! that its checksums are verified.

use std::ops::Range;

use crate::error::Error;
use crate::header::{Header, Region};
use crate::volume::{ForwardVoxels, RandomVoxels, Volume, Voxels};

/// The voxels of `volume` within `region`; the volume itself, if that is all of it.
///
/// # Errors
///
/// If the region is empty or not all of it is within the volume.
pub(crate) fn crop(volume: Volume, region: &[Range<i64>; 3]) -> Result<Volume, Error> {
    let Volume {
        header,
        voxels,
        source,
    } = volume;
    let mut origin = [0; 3];
    let mut size = [0; 3];
    for a in 0..3 {
        let (first, dim) = (header.first_index[a], header.dims[a]);
        let from = u64::try_from(i128::from(region[a].start) - i128::from(first));
        let count = u64::try_from(i128::from(region[a].end) - i128::from(region[a].start));
        match (from, count) {
            (Ok(from), Ok(count @ 1..))
                if from.checked_add(count).is_some_and(|end| end <= dim) =>
            {
                (origin[a], size[a]) = (from, count);
            }
            _ => {
                let end = i128::from(first) + i128::from(dim);
                return Err(Error::unsupported(
                    &source.name,
                    format!(
                        "the region {}:{} along {} was asked for, but the volume has {first}:{end}",
                        region[a].start,
                        region[a].end,
                        ["x", "y", "z"][a],
                    ),
                ));
            }
        }
    }
    if size == header.dims {
        return Ok(Volume {
            header,
            voxels,
            source,
        });
    }
    let dims = header.dims;
    let voxel_bytes = header.voxel.bytes();
    let region = Region { origin, size };
    let header = cropped(header, &region);
    let voxels = match voxels {
        Voxels::Random(voxels) => Voxels::Random(Box::new(RandomCrop {
            voxels,
            dims,
            region,
            voxel_bytes,
            name: source.name.clone(),
        })),
        Voxels::Forward(voxels) => Voxels::Forward(Box::new(ForwardCrop {
            voxels,
            dims,
            region,
            voxel_bytes,
            read: 0,
            planes: Vec::new(),
        })),
    };
    Ok(Volume {
        header,
        voxels,
        source,
    })
}

fn cropped(mut header: Header, region: &Region) -> Header {
    let spacing = header.spacing.unwrap_or([1.0; 3]);
    for (row, origin) in header.origin.iter_mut().enumerate() {
        for a in 0..3 {
            *origin += header.direction[row][a] * spacing[a] * region.origin[a] as f64;
        }
    }
    for a in 0..3 {
        // Within the extents, which fit.
        header.first_index[a] += region.origin[a] as i64;
    }
    let [x, y, z] = header.dims;
    header
        .details
        .push(("cut out of", format!("{x} x {y} x {z} voxels")));
    header.dims = region.size;
    header
}

struct RandomCrop {
    voxels: Box<dyn RandomVoxels>,
    dims: [u64; 3],
    region: Region,
    voxel_bytes: usize,
    name: String,
}

impl RandomCrop {
    /// A box of the crop as one of the whole.
    fn moved(&self, region: &Region) -> Result<Region, Error> {
        region.check_inside(self.region.size, &self.name)?;
        Ok(Region {
            origin: [0, 1, 2].map(|a| region.origin[a] + self.region.origin[a]),
            size: region.size,
        })
    }
}

impl RandomVoxels for RandomCrop {
    fn read_box(&self, region: &Region, out: &mut Vec<u8>) -> Result<(), Error> {
        let moved = self.moved(region)?;
        if region.voxels() == Some(0) {
            return region.make_room(self.voxel_bytes, out, &self.name);
        }
        self.voxels.read_box(&moved, out)
    }

    fn planes(&self, z: u64, count: u64) -> Result<Option<&[u8]>, Error> {
        let [x, y, _] = self.region.size;
        let moved = self.moved(&Region {
            origin: [0, 0, z],
            size: [x, y, count],
        })?;
        if [x, y] != [self.dims[0], self.dims[1]] {
            return Ok(None);
        }
        self.voxels.planes(moved.origin[2], count)
    }

    fn check(&self) -> Result<(), Error> {
        self.voxels.check()
    }

    fn chunk(&self) -> Option<[u64; 3]> {
        self.voxels.chunk()
    }

    fn chunk_start(&self) -> [u64; 3] {
        let before = self.voxels.chunk_start();
        let shape = self.voxels.chunk().unwrap_or([1; 3]);
        [0, 1, 2].map(|a| (self.region.origin[a] + before[a]) % shape[a].max(1))
    }

    fn decode_bytes(&self) -> u64 {
        self.voxels.decode_bytes()
    }

    fn uniform(&self, region: &Region) -> Option<[u8; 8]> {
        self.voxels.uniform(&self.moved(region).ok()?)
    }

    fn release(&self, z_end: u64) {
        let z_end = z_end.min(self.region.size[2]);
        self.voxels.release(z_end + self.region.origin[2]);
    }
}

struct ForwardCrop {
    voxels: Box<dyn ForwardVoxels>,
    dims: [u64; 3],
    region: Region,
    voxel_bytes: usize,
    /// Planes of the whole that were read.
    read: u64,
    planes: Vec<u8>,
}

impl ForwardCrop {
    /// Reads some planes of the whole, up to plane `z`, and gives their number. However small the
    /// region is, no more is held than is worth a call, or one plane.
    fn step_to(&mut self, z: u64) -> Result<u64, Error> {
        const STEP_BYTES: u64 = 4 << 20;
        let plane = (self.dims[0] * self.dims[1] * self.voxel_bytes as u64).max(1);
        let count = (STEP_BYTES / plane).max(1).min(z.saturating_sub(self.read));
        if count == 0 {
            return Ok(0);
        }
        let found = self.voxels.read_planes(count, &mut self.planes)?;
        self.read += found;
        Ok(found)
    }

    /// Reads planes of the whole and drops them.
    fn skip_to(&mut self, z: u64) -> Result<(), Error> {
        while self.step_to(z)? > 0 {}
        Ok(())
    }
}

impl ForwardVoxels for ForwardCrop {
    fn read_planes(&mut self, count: u64, out: &mut Vec<u8>) -> Result<u64, Error> {
        out.clear();
        let (first, [_, ny, nz]) = (self.region.origin, self.region.size);
        self.skip_to(first[2])?;
        let row = self.dims[0] as usize * self.voxel_bytes;
        let from = first[0] as usize * self.voxel_bytes;
        let run = self.region.size[0] as usize * self.voxel_bytes;
        let end = (first[2] + nz).min(self.read.saturating_add(count));
        let mut all = 0;
        loop {
            let found = self.step_to(end)?;
            if found == 0 {
                return Ok(all);
            }
            all += found;
            for plane in self.planes.chunks_exact(row * self.dims[1] as usize) {
                let rows = plane.chunks_exact(row);
                for row in rows.skip(first[1] as usize).take(ny as usize) {
                    out.extend_from_slice(&row[from..from + run]);
                }
            }
        }
    }

    fn finish(&mut self) -> Result<Vec<String>, Error> {
        self.skip_to(self.dims[2])?;
        self.voxels.finish()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::bytes::FileBytes;
    use crate::conformance;
    use crate::header::{DType, Format, VoxelType};
    use crate::input::Input;
    use crate::order::AxisOrder;
    use crate::stored::StoredVoxels;
    use crate::stream::StreamVoxels;
    use crate::volume::SourceInfo;

    fn whole(dims: [u64; 3], forward: bool) -> Volume {
        let header = Header::new(Format::Raw, dims, DType::little(VoxelType::U16));
        let count = dims.iter().product::<u64>() as u16;
        let bytes: Vec<u8> = (0..count).flat_map(u16::to_le_bytes).collect();
        let voxels = if forward {
            let input = Input::new(std::io::Cursor::new(bytes));
            let order = AxisOrder::X_FASTEST;
            Voxels::Forward(Box::new(StreamVoxels::new(input, "n", &header, order, 0)))
        } else {
            let bytes = FileBytes::memory("n", bytes);
            let order = AxisOrder::X_FASTEST;
            Voxels::Random(Box::new(StoredVoxels::new(bytes, "n", 0, &header, order)))
        };
        Volume {
            header,
            voxels,
            source: SourceInfo::stream("n"),
        }
    }

    proptest! {
        #[test]
        fn a_region_is_the_voxels_at_its_indices(
            dims in [1_u64..9, 1_u64..9, 1_u64..9],
            cut in [(0_u64..9, 1_u64..9), (0_u64..9, 1_u64..9), (0_u64..9, 1_u64..9)],
            forward: bool,
        ) {
            let region = [0, 1, 2].map(|a| {
                let from = cut[a].0 % dims[a];
                from as i64..(from + cut[a].1).min(dims[a]) as i64
            });
            let open = || crop(whole(dims, forward), &region);
            conformance::check(open).map_err(TestCaseError::fail)?;
            let volume = open().unwrap();
            let size = volume.header.dims;
            let mut found = Vec::new();
            volume.into_forward().read_planes(u64::MAX, &mut found).unwrap();
            for (n, voxel) in found.chunks(2).enumerate() {
                let n = n as u64;
                let at = [n % size[0], n / size[0] % size[1], n / size[0] / size[1]];
                let at = [0, 1, 2].map(|a| at[a] + region[a].start as u64);
                let expected = (at[2] * dims[1] + at[1]) * dims[0] + at[0];
                prop_assert_eq!(voxel, (expected as u16).to_le_bytes());
            }
        }
    }

    #[test]
    fn a_small_region_of_large_planes_is_read_in_steps() {
        /// Planes of 1 MiB that remember how many were asked for at once.
        struct Wide {
            left: u64,
            most: std::sync::Arc<std::sync::atomic::AtomicU64>,
        }

        impl ForwardVoxels for Wide {
            fn read_planes(&mut self, count: u64, out: &mut Vec<u8>) -> Result<u64, Error> {
                let count = count.min(self.left);
                self.left -= count;
                let most = &self.most;
                most.fetch_max(count, std::sync::atomic::Ordering::Relaxed);
                out.clear();
                out.resize((count << 20) as usize, 7);
                Ok(count)
            }

            fn finish(&mut self) -> Result<Vec<String>, Error> {
                assert_eq!(self.left, 0);
                Ok(Vec::new())
            }
        }

        let most = std::sync::Arc::default();
        let header = Header::new(Format::Raw, [1024, 1024, 64], DType::little(VoxelType::U8));
        let volume = Volume {
            header,
            voxels: Voxels::Forward(Box::new(Wide {
                left: 64,
                most: std::sync::Arc::clone(&most),
            })),
            source: SourceInfo::stream("n"),
        };
        let mut voxels = crop(volume, &[3..5, 3..5, 1..51]).unwrap().into_forward();
        let mut out = Vec::new();
        assert_eq!(voxels.read_planes(u64::MAX, &mut out).unwrap(), 50);
        assert_eq!(out, [7; 4 * 50]);
        assert_eq!(voxels.read_planes(1, &mut out).unwrap(), 0);
        voxels.finish().unwrap();
        assert_eq!(most.load(std::sync::atomic::Ordering::Relaxed), 4);
    }

    #[test]
    fn another_spacing_moves_what_was_cut_out() {
        let mut volume = whole([4, 5, 6], false);
        volume.header.spacing = Some([0.1, 0.7, 0.3]);
        volume.header.direction = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let mut header = crop(volume, &[3..4, 2..5, 1..6]).unwrap().header;
        assert_eq!(header.index_origin(), [0.0; 3]);
        header.spacing = Some([2.0; 3]);
        header.set_index_origin([1.0, 0.0, 0.0]);
        assert_eq!(header.origin, [-3.0, 6.0, 2.0]);
    }

    #[test]
    fn a_region_beyond_the_volume_is_refused_with_the_extents() {
        for region in [[0..5, 0..3, 0..3], [0..3, -1..3, 0..3], [0..3, 0..3, 2..2]] {
            let error = crop(whole([4, 4, 4], false), &region).unwrap_err();
            assert!(error.to_string().contains("0:4"), "{error}");
        }
    }
}
