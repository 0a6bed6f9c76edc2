//! The experiments of the paper, run with the `curvox` command: sections 5 and 6 of *Corrected
//! curvature measures*, figure by figure, and a few beyond.
//!
//! Comes in: a finest gridstep, and volumes if there are any at hand. Goes out: a folder with a page
//! `README.md`, a picture (`.svg`, or `.png` for coloured surfaces) and the numbers (`.csv`) of every
//! figure, and a folder of runs with a table and a record for every run.
//!
//! ```text
//!   figures -> runs wanted -> run_all: spawn curvox, read rows, truth, errors -> figures -> page
//!              (shared)       (kept in runs/)                                   (plots, words)
//! ```
//!
//! * [`runs`] makes runs as a user would; it and [`methods`] are the places that know options of `curvox`.
//! * [`rows`] reads their tables and measures errors against the truth at the closest point.
//! * [`study`] says what is asked, and makes all runs, several at a time.
//! * [`slopes`] fits exponents, [`dgtal`] holds DGtal's numbers, [`plot`] and [`page`] draw and write.
//! * [`subjects`] are digital shapes to look at, [`drawing`] colours them.
//! * The other modules each make a group of figures: they name the runs they want, and turn
//!   what was measured into a [`page::Section`].
//!
//! Guaranteed: words on the page follow from the numbers, or are true whatever the numbers are; what
//! could not be run is said, with the reason. Stopped at any moment, it goes on where it was. Not
//! guaranteed: times, which are those of the machine at that moment.

pub mod dgtal;
pub mod drawing;
pub mod methods;
pub mod page;
pub mod plot;
pub mod rows;
pub mod runs;
pub mod slopes;
pub mod study;
pub mod subjects;

pub mod convergence;
pub mod directions;
pub mod fields;
pub mod noise;
pub mod pictures;
pub mod rates;
pub mod shapes;
pub mod stability;
pub mod times;

mod command;

pub use command::PaperArgs;
