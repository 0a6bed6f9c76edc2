//! Processor time a surfel of whole runs in memory, beside plain walks over the surface.
//!
//! In: Goursat's surface, smooth and with noise, and volumes by path. Out: Markdown tables on the standard output.
//!
//! Everything of a table is measured in this process, one after the other, in turns: repeats of a case lie as far apart
//! as they can, so that what else runs on the machine meets all cases alike, and medians of processor time are told.
//! The table of methods ends with how far the repeats of its worst case differed.
//!
//! * [`Table::Methods`]: the plain reference ([`walks`]), runs whose rows are dropped, and runs into a Parquet table,
//!   by method and radius; what noise costs, and what connected balls cost above whole ones.
//! * [`Table::Growth`]: runs at the paper's radius 3 h^(-1/2) voxels, and the exponent of their time over surfels.
//! * [`Table::Threads`]: two threads against one, on the clock.
//! * [`Table::Bricks`]: the same run with other bricks and within less memory.
//! * [`Table::Empty`]: a volume without a solid, against a copy of its bytes.
//! * [`Table::Dense`]: sheets, hairs and volumes by path against a smooth surface.
//!
//! Not guaranteed: that numbers of two runs of this command compare; set a ratio against a ratio.

pub mod clock;
pub mod runs;
pub mod subject;
pub mod walks;

mod dense;
mod methods;
mod variations;

use anyhow::Result;
use clap::{Args, ValueEnum};

use runs::Method;
use subject::VolumeSpec;

/// What can be measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Table {
    /// Methods by radius, beside the plain reference.
    Methods,
    /// Growth with the number of surfels.
    Growth,
    /// Two threads against one.
    Threads,
    /// Bricks and memory.
    Bricks,
    /// Empty space against a copy in memory.
    Empty,
    /// Sheets and hairs, closer together than the ball.
    Dense,
}

/// Options of `speed`.
#[derive(Args, Clone, Debug)]
pub struct SpeedArgs {
    /// Radii of the balls, in voxels
    #[arg(long, value_delimiter = ',', default_value = "3,6,12,17")]
    radii: Vec<f64>,

    /// Methods
    #[arg(long, value_enum, value_delimiter = ',', default_value = "default,ii")]
    methods: Vec<Method>,

    /// Gridstep of Goursat's surface; 0.08 has 369 thousand surfels
    #[arg(long, default_value_t = 0.08)]
    gridstep: f64,

    /// Probability that a voxel beside the surface flips, for the noisy one; 0 leaves it out
    #[arg(long, default_value_t = 0.1)]
    noise: f64,

    /// Repeats of each case, of which medians are told
    #[arg(long, default_value_t = 3)]
    repeats: usize,

    /// Surfels on which the walks of the plain reference are timed
    #[arg(long, default_value_t = 32768)]
    sample: usize,

    /// Volumes to measure too: voxels at or above the threshold are inside
    #[arg(long, value_delimiter = ',', value_name = "PATH:THRESHOLD")]
    volumes: Vec<VolumeSpec>,

    /// Gridsteps of the table of growth
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "0.25,0.125,0.0625,0.03125"
    )]
    growth: Vec<f64>,

    /// Which tables to make
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "methods,growth,threads,bricks,empty,dense"
    )]
    tables: Vec<Table>,

    /// One repeat, a gridstep of at least 1/8: an impression in a minute
    #[arg(long)]
    quick: bool,
}

impl SpeedArgs {
    /// Measures and prints.
    ///
    /// # Errors
    /// If a volume cannot be read, or a run fails.
    pub fn run(mut self) -> Result<()> {
        if self.quick {
            const COARSEST: f64 = 0.125;
            self.repeats = 1;
            self.sample = self.sample.min(4096);
            self.gridstep = self.gridstep.max(COARSEST);
            self.growth.retain(|&h| h >= COARSEST);
        }
        for table in &self.tables {
            match table {
                Table::Methods => methods::print(&self)?,
                Table::Growth => variations::print_growth(&self)?,
                Table::Threads => variations::print_threads(&self)?,
                Table::Bricks => variations::print_bricks(&self)?,
                Table::Empty => variations::print_empty(&self)?,
                Table::Dense => dense::print(&self)?,
            }
        }
        Ok(())
    }
}
