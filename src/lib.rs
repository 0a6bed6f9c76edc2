//! Corrected curvature measures of huge 3D images, streamed brick by brick.
//!
//! A volume larger than memory goes in, plane by plane; the boundary surfels of the solid in it
//! come out, each with its normal and its mean, Gaussian and principal curvatures, by the
//! corrected curvature measures of Lachaud, Romon and Thibert (*Corrected curvature measures*,
//! Discrete & Computational Geometry, 2022).
//!
//! The rooms, in the order of the data:
//!
//! | room | what it does |
//! |---|---|
//! | [`khalimsky`], [`lattice`] | cells of the grid and how they meet; spacing, and what is in a ball |
//! | [`shape`] | implicit shapes of known curvature, digitised on demand: ground truth |
//! | [`volume`] | stored voxels to bits: what is inside |
//! | [`surfel`] | bits to surfels and how they join |
//! | [`normal`] | a unit normal for each surfel |
//! | [`measure`] | measures of cells, and their sums over balls |
//! | [`curvature`] | sums to curvatures, in world units |
//! | [`mesh`] | polyhedral surfaces: the same measures on meshes in memory |
//! | [`sink`] | tables, slices, totals |
//! | [`brick`] | how a volume is cut, and the exchange of halos |
//! | [`pipeline`] | the stages as threads, within a memory budget |
//!
//! ```
//! use std::sync::atomic::AtomicBool;
//! use curvox::lattice::Lattice;
//! use curvox::pipeline::{Access, Progress, Settings, Source, run};
//! use curvox::sink::{SinkError, SurfelBatch, SurfelSink};
//! use curvox::volume::{Binarizer, Criterion};
//! use curvox_formats::{OpenOptions, open_stream};
//!
//! /// Adds up the area.
//! struct Area(f64);
//! impl SurfelSink for Area {
//!     fn write(&mut self, rows: &SurfelBatch) -> Result<(), SinkError> {
//!         self.0 += rows.area.iter().map(|&a| f64::from(a)).sum::<f64>();
//!         Ok(())
//!     }
//!     fn finish(&mut self) -> Result<(), SinkError> {
//!         Ok(())
//!     }
//! }
//!
//! // a ball of radius 6 in 17^3 voxels, as a DGtal .vol
//! let mut file = b"X: 17\nY: 17\nZ: 17\nVersion: 2\n.\n".to_vec();
//! for i in 0..17i32 * 17 * 17 {
//!     let [x, y, z] = [i % 17 - 8, i / 17 % 17 - 8, i / 289 - 8];
//!     file.push(u8::from(x * x + y * y + z * z <= 36));
//! }
//! let volume = open_stream(Box::new(std::io::Cursor::new(file)), "ball", &OpenOptions::default())?;
//! let header = volume.header.clone();
//! let settings = Settings::new(Lattice::new(header.dims, [1.0; 3], false)?);
//! let plan = settings.plan(&Access::forward(1), 0)?;
//! let binarizer =
//!     Binarizer::new(Criterion::AtLeast(1.0.into()), header.voxel, header.byte_order, header.scaling);
//! let mut area = Area(0.0);
//! let outcome = run(
//!     Source { volume, binarizer },
//!     &settings,
//!     &plan,
//!     &mut [&mut area],
//!     &Progress::default(),
//!     &AtomicBool::new(false),
//! )?;
//! assert_eq!(outcome.cells.euler_gauss_bonnet(), Some(2));
//! let exact = 4.0 * std::f64::consts::PI * 36.0;
//! assert!((area.0 - exact).abs() < 0.1 * exact);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod elementary;

mod simd;

#[cfg(test)]
mod testing;

pub mod error;

pub mod khalimsky;

pub mod lattice;

pub mod shape;

pub mod symmetric;

pub mod volume;

pub mod surfel;

pub mod normal;

pub mod measure;

pub mod curvature;

pub mod mesh;

pub mod sink;

pub mod brick;

pub mod pipeline;

#[cfg(feature = "cli")]
pub mod cli;

pub use error::Error;
