//! Names of slices: which there are, their order, and whether some are missing.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use crate::error::Error;

/// What is in a folder.
pub(super) struct List {
    /// Files that are not hidden, in natural order.
    pub(super) files: Vec<PathBuf>,
    /// Sub-folders and other entries that are not hidden.
    pub(super) others: Vec<PathBuf>,
}

/// The last part of a path, for messages.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name()
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

/// The entries of a folder.
pub(super) fn in_folder(folder: &Path) -> Result<List, Error> {
    let failed = |e| Error::io(folder.display().to_string(), "cannot be listed", e);
    let mut list = List {
        files: Vec::new(),
        others: Vec::new(),
    };
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if file_name(&path).starts_with('.') {
            continue;
        }
        if path.is_file() {
            list.files.push(path);
        } else {
            list.others.push(path);
        }
    }
    list.files
        .sort_by(|a, b| natural(&file_name(a), &file_name(b)));
    list.others.sort();
    Ok(list)
}

/// Whether a path that does not exist is a pattern. Only its last part may be one.
pub(crate) fn is_pattern(path: &Path) -> bool {
    file_name(path).contains(['*', '?'])
}

/// The files that a pattern matches, in natural order.
pub(super) fn matching(pattern: &Path) -> Result<Vec<PathBuf>, Error> {
    let folder = match pattern.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let wanted = file_name(pattern);
    let mut files = in_folder(folder)?.files;
    files.retain(|path| matches(wanted.as_bytes(), file_name(path).as_bytes()));
    if files.is_empty() {
        return Err(Error::unsupported(
            pattern.display().to_string(),
            "no file matches this pattern",
        ));
    }
    Ok(files)
}

/// Whether a name matches a pattern in which `*` is any text and `?` any byte.
fn matches(pattern: &[u8], name: &[u8]) -> bool {
    let (mut p, mut n) = (0, 0);
    // Where to go on when the text of the last `*` must be longer.
    let mut star: Option<(usize, usize)> = None;
    while n < name.len() {
        match pattern.get(p) {
            Some(b'*') => {
                star = Some((p + 1, n));
                p += 1;
            }
            Some(c) if *c == b'?' || *c == name[n] => {
                p += 1;
                n += 1;
            }
            _ => match &mut star {
                Some((behind, from)) => {
                    *from += 1;
                    (p, n) = (*behind, *from);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|c| *c == b'*')
}

/// A run of digits or of other letters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part<'a> {
    Number(&'a str),
    Text(&'a str),
}

/// A name cut where digits begin and end.
fn parts(name: &str) -> Vec<Part<'_>> {
    let mut parts = Vec::new();
    let mut rest = name;
    while let Some(first) = rest.bytes().next() {
        let digits = first.is_ascii_digit();
        let end = rest
            .bytes()
            .position(|b| b.is_ascii_digit() != digits)
            .unwrap_or(rest.len());
        let (part, behind) = rest.split_at(end);
        parts.push(if digits {
            Part::Number(part)
        } else {
            Part::Text(part)
        });
        rest = behind;
    }
    parts
}

/// Order of names in which digits count as numbers, of any length.
fn natural(a: &str, b: &str) -> Ordering {
    let value = |digits: &str| {
        let digits = digits.trim_start_matches('0');
        (digits.len(), digits.to_string())
    };
    let (left, right) = (parts(a), parts(b));
    for (x, y) in left.iter().zip(&right) {
        let order = match (x, y) {
            (Part::Number(x), Part::Number(y)) => value(x).cmp(&value(y)),
            (Part::Text(x), Part::Text(y)) => x.cmp(y),
            (Part::Number(_), Part::Text(_)) => Ordering::Less,
            (Part::Text(_), Part::Number(_)) => Ordering::Greater,
        };
        if order != Ordering::Equal {
            return order;
        }
    }
    left.len().cmp(&right.len()).then_with(|| a.cmp(b))
}

/// What is odd about the numbers of slices in order: gaps, or several numbers that change.
pub(super) fn doubts(paths: &[PathBuf]) -> Option<String> {
    let stems: Vec<String> = paths
        .iter()
        .map(|path| {
            path.file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    let first = parts(stems.first()?);
    let mut changing = None;
    for stem in &stems {
        let here = parts(stem);
        let alike = here.len() == first.len()
            && here
                .iter()
                .zip(&first)
                .all(|(a, b)| matches!((a, b), (Part::Number(_), Part::Number(_))) || a == b);
        if !alike {
            return Some(format!(
                "names of slices differ in more than numbers ({} and {}); they are in the order \
                 of their names",
                stems[0], stem
            ));
        }
        for (n, (a, b)) in here.iter().zip(&first).enumerate() {
            if a == b {
                continue;
            }
            if changing.is_some_and(|m| m != n) {
                return Some(format!(
                    "several numbers change in the names of slices ({} and {}): if they count \
                     channels or times, choose some with a pattern",
                    stems[0], stem
                ));
            }
            changing = Some(n);
        }
    }
    let changing = changing?;
    let numbers: Vec<u128> = stems
        .iter()
        .filter_map(|stem| match parts(stem).get(changing) {
            Some(Part::Number(digits)) => digits.parse().ok(),
            _ => None,
        })
        .collect();
    let steps = || {
        numbers
            .windows(2)
            .map(|pair| pair[1].saturating_sub(pair[0]))
    };
    let step = steps().min()?;
    let at = steps().position(|other| other != step)?;
    let gaps = steps().filter(|other| *other != step).count();
    Some(format!(
        "the numbers of slices have {gaps} gap{}, the first between {} and {}: slices may be \
         missing",
        if gaps == 1 { "" } else { "s" },
        file_name(&paths[at]),
        file_name(&paths[at + 1])
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_count_as_numbers_of_any_length() {
        let mut names = vec![
            "s_10",
            "s_2",
            "s_002",
            "t",
            "s_99999999999999999999999",
            "s",
            "1",
        ];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(
            names,
            [
                "1",
                "s",
                "s_002",
                "s_2",
                "s_10",
                "s_99999999999999999999999",
                "t"
            ]
        );
    }

    #[test]
    fn patterns_match_as_in_a_shell() {
        for (pattern, name, expected) in [
            ("slice_*.tif", "slice_10.tif", true),
            ("slice_*.tif", "slice_10.tiff", false),
            ("*", "a", true),
            ("*a*b*", "xxaxxabxx", true),
            ("*ab", "aab", true),
            ("a?c", "abc", true),
            ("a?c", "ac", false),
            ("a*", "", false),
        ] {
            assert_eq!(
                matches(pattern.as_bytes(), name.as_bytes()),
                expected,
                "{pattern} {name}"
            );
        }
    }

    #[test]
    fn gaps_and_mixed_numbers_are_told() {
        let doubt = |names: &[&str]| {
            let paths: Vec<PathBuf> = names.iter().map(PathBuf::from).collect();
            doubts(&paths)
        };
        assert_eq!(doubt(&["s1.tif", "s2.tif", "s3.tif"]), None);
        assert_eq!(doubt(&["s10.tif", "s20.tif", "s30.tif"]), None);
        let gap = doubt(&["s1.tif", "s2.tif", "s4.tif"]).unwrap();
        assert!(
            gap.contains("1 gap, the first between s2.tif and s4.tif"),
            "{gap}"
        );
        let mixed = doubt(&["z0c0.tif", "z0c1.tif", "z1c0.tif"]).unwrap();
        assert!(mixed.contains("several numbers"), "{mixed}");
        let names = doubt(&["a.tif", "b.tif"]).unwrap();
        assert!(names.contains("more than numbers"), "{names}");
    }
}
