//! Small writers.
