//! OpenVDB: what OpenVDB's own library reads from the same files, trees made here at random,
//! every version and way to store values, choices, regions, and what is refused.

/// A writer of small files, in every version and with every compression.
mod writer;

/// The shared files against what OpenVDB's library (10.0.1) says they hold.
mod files;

/// Trees made at random, written and read back.
mod trees;
