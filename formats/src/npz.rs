//! NumPy `.npz` archives: zip archives whose members are `.npy` files.
//!
//! In: the bytes of the archive. Out: the volume of one member. The caller names the member, with
//! or without its extension, or gives its number; without a choice it is the only one that holds
//! a volume. A stored member is mapped where it lies, a deflated one runs forward.

use crate::bytes::FileBytes;
use crate::error::Error;
use crate::forward::forward;
use crate::header::Format;
use crate::npy;
use crate::parsed::{Context, Parsed, check_extents};
use crate::stored::StoredVoxels;
use crate::stream::{ends_early, trailing};
use crate::volume::{SourceInfo, Volume, Voxels};
use crate::zip::{self, Member};

const EXTENSION: &str = ".npy";

/// Whether content beginning with `head` is such an archive.
pub(crate) fn detect(head: &[u8]) -> bool {
    zip::first_name(head).is_some_and(|name| name.ends_with(EXTENSION.as_bytes()))
}

pub(crate) fn open(archive: FileBytes, context: &Context<'_>) -> Result<Volume, Error> {
    let member = choose(&archive, context)?;
    let name = format!("{}, member {}", context.name, stem(&member));
    let place = member.place(&archive)?;
    let (mut parsed, input) = header(&archive, &member, place, &name, context)?;
    check_extents(&parsed.header, &name)?;
    parsed.header.format = Format::Npz;
    parsed.header.details.push(("member", stem(&member).into()));
    let bytes = parsed.header.voxels_bytes().unwrap_or(u64::MAX);
    let available = member.bytes.saturating_sub(parsed.offset);
    if bytes > available || member.cannot_hold(bytes) {
        let plane = parsed.header.plane_bytes().unwrap_or(u64::MAX);
        return Err(ends_early(&name, member.bytes, available, bytes, plane));
    }
    if available > bytes {
        // Said now, and not again when the end is reached.
        parsed.footer = true;
        let end = parsed.offset + bytes;
        let warning = trailing(&name, end, available - bytes);
        parsed.header.warnings.push(warning);
    }
    if !member.is_stored() {
        parsed
            .header
            .details
            .push(("compression", "deflate".into()));
        let source = SourceInfo {
            compressed: true,
            ..archive.source()
        };
        let source = SourceInfo {
            mapped: false,
            ..source
        };
        return forward(parsed, input, &name, context.options, source);
    }
    let source = archive.source();
    let Parsed {
        header,
        offset,
        order,
        ..
    } = parsed;
    let voxels = StoredVoxels::new(archive, &name, place + offset, &header, order);
    Ok(Volume {
        header,
        voxels: Voxels::Random(Box::new(voxels)),
        source,
    })
}

/// The name of the array that a member holds.
fn stem(member: &Member) -> &str {
    member.name.strip_suffix(EXTENSION).unwrap_or(&member.name)
}

/// The header of the array in a member, and the member's bytes behind it.
fn header(
    archive: &FileBytes,
    member: &Member,
    place: u64,
    name: &str,
    context: &Context<'_>,
) -> Result<(Parsed, crate::input::Input), Error> {
    let mut input = member.read(archive, place);
    let inner = Context {
        name,
        path: None,
        options: context.options,
        length: None,
    };
    let parsed = npy::parse(&mut input, &inner)?;
    Ok((parsed, input))
}

/// The member to be read.
fn choose(archive: &FileBytes, context: &Context<'_>) -> Result<Member, Error> {
    /// Looking into more members than this takes too long; then one must be named.
    const MOST_LOOKED_INTO: usize = 1000;
    let name = context.name;
    let mut arrays = zip::members(archive)?;
    arrays.retain(|member| member.name.ends_with(EXTENSION));
    if arrays.is_empty() {
        return Err(Error::unsupported(name, "has no member that ends in .npy"));
    }
    if let Some(wanted) = &context.options.dataset {
        let named = |member: &&Member| stem(member) == wanted || member.name == *wanted;
        let numbered = || arrays.get(wanted.parse::<usize>().ok()?);
        return match arrays.iter().find(named).or_else(numbered) {
            Some(member) => Ok(member.clone()),
            None => Err(Error::unsupported(
                name,
                format!("there is no array '{wanted}'; there are: {}", list(&arrays)),
            )),
        };
    }
    if let [only] = &arrays[..] {
        return Ok(only.clone());
    }
    let several = |arrays: &[Member]| {
        Error::unsupported(
            name,
            format!(
                "has several arrays: {}; choose one with --dataset NAME",
                list(arrays)
            ),
        )
    };
    if arrays.len() > MOST_LOOKED_INTO {
        return Err(several(&arrays));
    }
    let volumes: Vec<_> = arrays
        .iter()
        .filter(|member| {
            let parsed = member
                .place(archive)
                .and_then(|place| header(archive, member, place, name, context));
            parsed.is_ok()
        })
        .cloned()
        .collect();
    match &volumes[..] {
        [only] => Ok(only.clone()),
        [] => Err(Error::unsupported(
            name,
            format!("no array is a volume of three axes: {}", list(&arrays)),
        )),
        volumes => Err(several(volumes)),
    }
}

/// Names of arrays, for a message.
fn list(arrays: &[Member]) -> String {
    const MOST_NAMES: usize = 30;
    let mut names: Vec<_> = arrays.iter().take(MOST_NAMES).map(stem).collect();
    let others = format!("{} others", arrays.len().saturating_sub(MOST_NAMES));
    if arrays.len() > MOST_NAMES {
        names.push(&others);
    }
    names.join(", ")
}
