//! Tools around `curvox`: the oracle it is tested against, and the experiments
//! that chose its defaults.
//!
//! * [`plain`] computes every measure by its definition, in scalar code, with the whole
//!   volume in memory. It does not use the `curvox` crate.
//! * [`goursat`], [`vol`] and [`npz`] bring in shapes and tables to compare with.
//! * [`dgtal`] repeats DGtal's cell measures and walk, and [`causes`] names the cells where they
//!   differ from the plain ones.
//! * [`agreement`] compares the plain reference with DGtal, [`accuracy`] with the truth.
//! * [`formats`] reads every file of a folder of test data and tables what became of it.
//! * [`grey`] compares normals from grey values with normals from bits.
//! * [`in_memory`] makes whole runs over voxels in memory.
//! * [`meshes`] makes polyhedra of known curvature: Schwarz lanterns, spheres, tori.
//! * [`methods`] tables the errors of the named methods on [`moved`] shapes.
//! * [`picture`] draws what a run of `curvox` left.
//! * [`paper`] repeats the experiments of the paper with the `curvox` command.
//! * [`speed`] measures processor time a surfel of whole runs, beside plain walks.

pub mod plain;

pub mod goursat;
pub mod npz;
pub mod vol;

pub mod dgtal;

pub mod causes;

pub mod accuracy;
pub mod agreement;

pub mod formats;
pub mod grey;
pub mod in_memory;
pub mod meshes;
pub mod methods;
pub mod moved;

pub mod picture;

pub mod paper;

pub mod random;

pub mod speed;
