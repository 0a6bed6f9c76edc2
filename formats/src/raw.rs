//! Voxels without a header: the caller knows the layout.

use crate::error::Error;
use crate::header::{Format, Header, voxel_count};
use crate::input::Input;
use crate::options::OpenOptions;
use crate::parsed::{Context, Parsed, is_plausible_spacing};

/// The layout the caller gave, as a header.
pub(crate) fn parse(_: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let Some(raw) = context.options.raw else {
        return Err(Error::unsupported(
            context.name,
            "a raw file has no header: its dimensions and voxel type must be given",
        ));
    };
    let mut header = Header::new(Format::Raw, raw.dims, raw.dtype);
    if let Some(spacing) = raw.spacing {
        if let Some(bad) = spacing.iter().find(|s| !is_plausible_spacing(**s)) {
            return Err(Error::invalid(
                context.name,
                format!("the given spacing {bad} is not a positive length"),
            ));
        }
        header.spacing = Some(spacing);
        header.unit = raw.unit;
    }
    Ok(Parsed::new(header, raw.skip))
}

/// Bytes of a plain file with the layout the caller gave.
pub(crate) fn file_bytes(options: &OpenOptions) -> Option<u64> {
    let raw = options.raw?;
    voxel_count(raw.dims)?
        .checked_mul(raw.dtype.voxel.bytes() as u64)?
        .checked_add(raw.skip)
}
