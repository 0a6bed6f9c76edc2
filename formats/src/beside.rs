//! Files that a header names.
//!
//! In: names as they are written in a header, single, in a list, or as a pattern with a number. Out:
//! paths of files that exist, and which of them hold the volume to be read. Guaranteed: names are
//! followed as [`Context::beside`] allows; no more than [`FILES_MOST`] are looked for; files that are
//! missing are told together, in one error.

use std::path::PathBuf;

use crate::error::Error;
use crate::parsed::{Context, Elsewhere, Parsed, Start};

/// The most files of one volume. A header of some bytes can claim any number of them, and each is
/// looked for.
const FILES_MOST: u64 = 1 << 17;

/// The paths of the files called `names` in a header.
pub(crate) fn files(names: &[String], context: &Context<'_>) -> Result<Vec<PathBuf>, Error> {
    /// More that are missing are not counted: looking for each takes time.
    const MISSING_MOST: usize = 1000;
    check_count(names.len() as u64, context)?;
    let (mut paths, mut missing) = (Vec::new(), Vec::new());
    for name in names {
        let path = context.beside(name)?;
        if path.is_file() {
            paths.push(path);
        } else {
            missing.push(path.display().to_string());
        }
        if missing.len() >= MISSING_MOST {
            break;
        }
    }
    if missing.is_empty() {
        return Ok(paths);
    }
    let count = match missing.len() {
        MISSING_MOST => format!("{MISSING_MOST} or more"),
        count => count.to_string(),
    };
    missing.truncate(3);
    let which = missing.join(", ");
    Err(Error::invalid(
        context.name,
        match names.len() {
            1 => format!("the voxels are in another file, which is missing: {which}"),
            all => format!("the voxels are in {all} files, of which {count} are missing: {which}"),
        },
    ))
}

/// Says where the volume `frame` of `frames` is, when `paths` hold equal shares of all of them.
pub(crate) fn share(
    parsed: &mut Parsed,
    paths: Vec<PathBuf>,
    frame: u64,
    frames: u64,
    name: &str,
) -> Result<(), Error> {
    let files = paths.len() as u64;
    let bytes = parsed.header.voxels_bytes().unwrap_or(u64::MAX);
    let mine = |first: u64, count: u64| paths.into_iter().skip(first as usize).take(count as usize);
    parsed.elsewhere = if files > 0 && files.is_multiple_of(frames) {
        let count = files / frames;
        let mine: Vec<_> = mine(frame * count, count).collect();
        parsed.frames_behind = 0;
        // One file can be mapped.
        if count == 1 {
            Elsewhere::FirstOf(mine)
        } else {
            Elsewhere::Files(mine)
        }
    } else if files > 0 && frames.is_multiple_of(files) {
        let count = frames / files;
        parsed.frames_behind = count - 1 - frame % count;
        if let Start::Bytes(skip) = &mut parsed.start {
            *skip = skip.saturating_add((frame % count).saturating_mul(bytes));
        }
        Elsewhere::FirstOf(mine(frame / count, 1).collect())
    } else {
        return Err(Error::unsupported(
            name,
            format!("{frames} volumes in {files} files: neither number divides the other"),
        ));
    };
    Ok(())
}

/// Refuses more files than are looked for.
pub(crate) fn check_count(count: u64, context: &Context<'_>) -> Result<(), Error> {
    if count > FILES_MOST {
        return Err(Error::unsupported(
            context.name,
            format!("the header names {count} files; at most {FILES_MOST} are read"),
        ));
    }
    Ok(())
}

/// A name with one number in it, as `slice%03d.raw`.
pub(crate) struct Pattern<'a> {
    before: &'a str,
    zeros: bool,
    width: usize,
    after: &'a str,
}

impl<'a> Pattern<'a> {
    /// The pattern in `text`: a percent sign, digits, and `d`, `i` or `u`. `None` if there is none.
    pub(crate) fn parse(text: &'a str) -> Option<Self> {
        /// Wider than any number; longer names than this no file system has.
        const WIDTH_MOST: usize = 100;
        let (before, rest) = text.split_once('%')?;
        let end = rest.find(|c: char| !c.is_ascii_digit())?;
        let (digits, rest) = rest.split_at(end);
        let after = rest.strip_prefix(['d', 'i', 'u'])?;
        let width = match digits {
            "" => 0,
            digits => digits.parse().ok().filter(|width| *width <= WIDTH_MOST)?,
        };
        Some(Self {
            before,
            zeros: digits.starts_with('0'),
            width,
            after,
        })
    }

    /// The name with the number.
    pub(crate) fn name(&self, number: i64) -> String {
        let Self {
            before,
            zeros,
            width,
            after,
        } = self;
        if *zeros {
            format!("{before}{number:0width$}{after}")
        } else {
            format!("{before}{number:width$}{after}")
        }
    }
}

/// How many numbers there are from `first` to `last` in steps of `step`; `None` when the steps never
/// get there.
pub(crate) fn steps(first: i64, last: i64, step: i64) -> Option<u64> {
    let distance = i128::from(last) - i128::from(first);
    if step == 0 || distance.signum() * i128::from(step.signum()) < 0 {
        return None;
    }
    u64::try_from(distance / i128::from(step) + 1).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_pads_its_number_as_printf_does() {
        let name = |text, number| Pattern::parse(text).map(|p| p.name(number));
        assert_eq!(name("a%03d.raw", 7).as_deref(), Some("a007.raw"));
        assert_eq!(name("a%03d.raw", 1234).as_deref(), Some("a1234.raw"));
        assert_eq!(name("%d", 5).as_deref(), Some("5"));
        assert_eq!(name("x%3dy", 5).as_deref(), Some("x  5y"));
        assert_eq!(name("x%04iy", -5).as_deref(), Some("x-005y"));
        for text in [
            "a.raw",
            "a%",
            "a%3",
            "a%s",
            "a%999999999999999999999d",
            "%n",
        ] {
            assert_eq!(name(text, 1), None, "{text}");
        }
    }

    #[test]
    fn steps_are_counted_both_ways_and_must_arrive() {
        assert_eq!(steps(0, 92, 1), Some(93));
        assert_eq!(steps(1, 10, 4), Some(3));
        assert_eq!(steps(10, 1, -3), Some(4));
        assert_eq!(steps(5, 5, 1), Some(1));
        assert_eq!(steps(1, 10, 0), None);
        assert_eq!(steps(1, 10, -1), None);
        assert_eq!(steps(i64::MIN, i64::MAX, 1), None);
    }
}
