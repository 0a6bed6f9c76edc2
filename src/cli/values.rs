//! A look at all values of the input.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use curvox_formats::Volume;

use crate::volume::otsu::{self, Values};

use super::exit::{BadInput, usage};
use super::input::InputArgs;

/// Reads the whole input, twice where its values are not 8 or 16 bits wide.
pub(crate) fn survey(input: &InputArgs, stop: &AtomicBool) -> Result<Values> {
    let options = || input.open();
    otsu::survey(options, stop)
}

/// The threshold of Otsu of the input, which has been opened as `volume` to be read again.
///
/// # Errors
/// If the input can be read only once, or has not two values to tell apart.
pub(crate) fn otsu(input: &InputArgs, volume: &Volume, stop: &AtomicBool) -> Result<f64> {
    if !volume.source.re_readable {
        return Err(usage(format!(
            "--otsu reads the input twice, which {} does not allow; \
             save it to a file first, or give --threshold",
            input.name()
        )));
    }
    let found = survey(input, stop)?;
    found.otsu.ok_or_else(|| {
        BadInput(format!(
            "{}: --otsu needs two different values, and the image has {}",
            input.name(),
            match found.min {
                Some(value) => format!("only {value}"),
                None => "no finite value".into(),
            }
        ))
        .into()
    })
}
