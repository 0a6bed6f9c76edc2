//! Files that a header names.
//!
//! In: names as they are written in a header, single, in a list, or as a pattern with a number. Out:
//! paths of files that exist. A name is meant relative to the folder of the header. Guaranteed: the
//! files are regular files below that folder (links resolved), unless the caller allowed others
//! ([`OpenOptions::outside`](crate::OpenOptions)); no more than [`FILES_MOST`] are looked for; files that
//! are missing are told together, in one error.

use std::path::{Component, Path, PathBuf};

use crate::error::Error;
use crate::open::Context;

/// The most files of one volume. A header of some bytes can claim any number of them, and each is
/// looked for.
const FILES_MOST: u64 = 1 << 17;

/// The paths of the files called `names` in a header.
pub(crate) fn files(
    names: &[String],
    context: &Context<'_>,
) -> Result<Vec<PathBuf>, Error> {
    let Some(header) = context.path else {
        return Err(Error::unsupported(
            context.name,
            "this header's voxels are in other files, which cannot be found from a stream",
        ));
    };
    check_count(names.len() as u64, context)?;
    let folder = match header.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    let canonical = std::fs::canonicalize(folder)
        .map_err(|e| Error::io(context.name, "the folder of the header cannot be read", e))?;
    let (mut paths, mut missing, mut examples) = (Vec::new(), 0_u64, Vec::new());
    for name in names {
        let path = find(folder, name);
        let real = std::fs::canonicalize(&path);
        let inside = match &real {
            Ok(real) => real.starts_with(&canonical),
            Err(_) => stays_below(Path::new(name)),
        };
        if !inside && !context.options.outside {
            return Err(Error::unsupported(
                context.name,
                format!(
                    "the header names the file '{name}', which is outside of the header's folder; \
                     that is only followed when allowed (--outside)"
                ),
            ));
        }
        if path.is_file() {
            paths.push(path);
        } else {
            missing += 1;
            if examples.len() < 3 {
                examples.push(path.display().to_string());
            }
        }
    }
    if missing > 0 {
        let more = if missing > examples.len() as u64 {
            ", ..."
        } else {
            ""
        };
        let all = missing + paths.len() as u64;
        return Err(Error::invalid(
            context.name,
            format!(
                "the voxels are in other files, of which {missing} of {all} are missing: {}{more}",
                examples.join(", ")
            ),
        ));
    }
    Ok(paths)
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

/// The path that `name` stands for. Headers written on Windows may separate folders by backslashes.
fn find(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(name);
    if name.contains('\\') && !path.exists() {
        return folder.join(name.replace('\\', "/"));
    }
    path
}

/// Whether a relative path never climbs above where it starts, by its words alone.
fn stays_below(path: &Path) -> bool {
    let mut depth = 0_u32;
    for component in path.components() {
        match component {
            Component::Normal(_) => depth += 1,
            Component::CurDir => {}
            Component::ParentDir if depth > 0 => depth -= 1,
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return false,
        }
    }
    true
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
        for text in ["a.raw", "a%", "a%3", "a%s", "a%999999999999999999999d", "%n"] {
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

    #[test]
    fn a_name_that_climbs_out_is_seen_by_its_words() {
        for name in ["a.raw", "./a.raw", "b/a.raw", "b/../a.raw"] {
            assert!(stays_below(Path::new(name)), "{name}");
        }
        for name in ["../a.raw", "b/../../a.raw", "/etc/a.raw", ".."] {
            assert!(!stays_below(Path::new(name)), "{name}");
        }
    }
}
