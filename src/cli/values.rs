//! A look at all values of the input.

use std::sync::atomic::AtomicBool;

use anyhow::Result;

use crate::volume::otsu::{self, Values};

use super::input::InputArgs;

/// Reads the whole input, twice where its values are not 8 or 16 bits wide.
pub(crate) fn survey(input: &InputArgs, stop: &AtomicBool) -> Result<Values> {
    let options = || input.open();
    otsu::survey(options, stop)
}
