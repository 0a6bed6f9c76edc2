//! What is measured: a solid in memory, one byte a voxel.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use curvox::lattice::Lattice;
use curvox::shape::{Digitisation, Goursat, Grid, Noise, NoisyPlanes};
use curvox::volume::{Binarizer, Criterion, Number};
use curvox_formats::{OpenOptions, open};

use crate::plain::Solid;

/// A solid in memory.
pub struct Subject {
    /// How tables call it.
    pub name: String,
    /// Voxels along x, y, z.
    pub dims: [usize; 3],
    /// 1 inside, 0 outside, x fastest. Shared, so that no run copies them.
    pub stored: Arc<[u8]>,
}

/// A volume on the command line: `PATH:THRESHOLD`.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeSpec {
    path: PathBuf,
    threshold: Number,
}

impl FromStr for VolumeSpec {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let Some((path, threshold)) = text.rsplit_once(':') else {
            bail!("'{text}' is not PATH:THRESHOLD");
        };
        Ok(Self {
            path: path.into(),
            threshold: threshold.parse()?,
        })
    }
}

impl Subject {
    /// Goursat's surface at a gridstep; with `noise` > 0, voxels beside the surface flip with that probability.
    ///
    /// # Errors
    /// If the gridstep or the noise cannot be used.
    pub fn goursat(gridstep: f64, noise: f64) -> Result<Self> {
        let digitisation = Digitisation::new(Goursat, Grid::cubic(gridstep))?;
        let dims = digitisation.dims();
        let mut stored = Vec::with_capacity(dims.iter().product());
        let source = |z: usize, out: &mut Vec<u8>| {
            digitisation.plane(z, out);
            Ok::<_, std::convert::Infallible>(())
        };
        let mut planes = NoisyPlanes::new(Noise::new(noise, 1)?, dims, 0..dims[2], source);
        let mut plane = Vec::new();
        while planes
            .next_plane::<std::convert::Infallible>(&mut plane)?
            .is_some()
        {
            stored.extend_from_slice(&plane);
        }
        let mut name = format!("Goursat, h = {gridstep}");
        if noise > 0.0 {
            name += &format!(", noise {noise}");
        }
        Ok(Self {
            name,
            dims,
            stored: stored.into(),
        })
    }

    /// A volume without a solid.
    pub fn empty(dims: [usize; 3]) -> Self {
        Self {
            name: "nothing".into(),
            dims,
            stored: vec![0; dims.iter().product()].into(),
        }
    }

    /// The voxels of a file at or above a threshold.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn of_file(spec: &VolumeSpec) -> Result<Self> {
        Self::read(spec).with_context(|| spec.path.display().to_string())
    }

    fn read(VolumeSpec { path, threshold }: &VolumeSpec) -> Result<Self> {
        let volume = open(path, &OpenOptions::default())?;
        let header = volume.header.clone();
        let dims = [0, 1, 2].map(|a| usize::try_from(header.dims[a]));
        let [nx, ny, nz] = dims;
        let dims = [nx?, ny?, nz?];
        let binarizer = Binarizer::new(
            Criterion::AtLeast(*threshold),
            header.voxel,
            header.byte_order,
            header.scaling,
        );
        let row_bytes = dims[0] * header.voxel.bytes();
        let mut words = vec![0u64; dims[0].div_ceil(64)];
        let (mut planes, mut bytes) = (volume.into_forward(), Vec::new());
        let mut stored = Vec::with_capacity(dims.iter().product());
        while planes.read_planes(1, &mut bytes)? > 0 {
            for row in bytes.chunks_exact(row_bytes) {
                binarizer.pack_row(row, &mut words);
                stored.extend((0..dims[0]).map(|x| (words[x / 64] >> (x % 64) & 1) as u8));
            }
        }
        let file = path.file_name().unwrap_or(path.as_os_str());
        Ok(Self {
            name: Path::new(file).display().to_string(),
            dims,
            stored: stored.into(),
        })
    }

    /// The same for the plain reference.
    pub fn solid(&self) -> Solid {
        Solid {
            dims: self.dims,
            inside: self.stored.iter().map(|&voxel| voxel != 0).collect(),
        }
    }

    /// Its grid. Voxels count as cubes: radii are in voxels.
    ///
    /// # Errors
    /// If it has too many voxels.
    pub fn lattice(&self) -> Result<Lattice> {
        Ok(Lattice::new(self.dims.map(|n| n as u64), [1.0; 3], false)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_volume_is_a_path_and_a_threshold() {
        let spec: VolumeSpec = "a:b/c.vol:1.5".parse().unwrap();
        assert_eq!(spec.path, Path::new("a:b/c.vol"));
        assert_eq!(spec.threshold, Number::from(1.5));
        assert!("c.vol".parse::<VolumeSpec>().is_err());
        assert!("c.vol:x".parse::<VolumeSpec>().is_err());
    }
}
