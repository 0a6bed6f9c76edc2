//! How programs lay out volumes in HDF5: which dataset is meant.
//!
//! In: a file. Out: the dataset a convention names for the frame, channel and level asked for.
//! Imaris and BigDataViewer keep each in a dataset of its own, MINC 2 its levels; Data Exchange
//! has one name for the volume; NeXus says by attributes which dataset to look at.

use super::attribute::Attributes;
use super::choose::{Choice, Chosen, Settled};
use super::dataset::Dataset;
use super::object::Object;
use crate::error::Error;

/// The dataset of a file laid out by one of the conventions, unless the caller names another.
pub(super) fn choose(choice: &Choice<'_>) -> Result<Option<Chosen>, Error> {
    let names = choice.names("/")?;
    let has = |name: &str| names.iter().any(|found| found == name);
    let dataset = choice.options.dataset.as_deref();
    if has("DataSetInfo") && names.iter().any(|name| name.starts_with("DataSet")) {
        // There may be several images: DataSet, DataSet1, and so on.
        let wanted = dataset.unwrap_or("DataSet").trim_matches('/');
        if wanted.starts_with("DataSet") && !wanted.contains('/') && has(wanted) {
            return imaris(choice, wanted).map(Some);
        }
    }
    let is_setup = |name: &str| numbered(name, 's');
    let setups = names.iter().any(|name| is_setup(name));
    let times = names.iter().any(|name| numbered(name, 't'));
    if setups && times && dataset.is_none_or(|name| is_setup(name.trim_matches('/'))) {
        return big_data_viewer(choice, &names).map(Some);
    }
    if has("minc-2.0") && dataset.is_none() {
        let level = choice.options.level.unwrap_or(0);
        let levels = choice.names("/minc-2.0/image")?;
        let path = format!("/minc-2.0/image/{level}/image");
        let dataset = found(choice, &path, "level", level.into(), &levels)?;
        let settled = Settled {
            level: true,
            ..Settled::default()
        };
        return Ok(Some(Chosen { dataset, settled }));
    }
    if has("exchange") && dataset.is_none() {
        let dataset = choice.dataset("/exchange/data")?;
        let volume = dataset.filter(|dataset| dataset.dtype().is_some() && dataset.dims.len() >= 3);
        return Ok(volume.map(|dataset| Chosen {
            dataset,
            settled: Settled::default(),
        }));
    }
    Ok(None)
}

/// Whether a name is a letter and digits.
fn numbered(name: &str, letter: char) -> bool {
    name.strip_prefix(letter)
        .is_some_and(|digits| digits.len() >= 2 && digits.bytes().all(|b| b.is_ascii_digit()))
}

/// The dataset at a path that a convention promises for number `n` of `there`.
fn found(
    choice: &Choice<'_>,
    path: &str,
    what: &str,
    n: u64,
    there: &[String],
) -> Result<Dataset, Error> {
    choice.dataset(path)?.ok_or_else(|| {
        Error::invalid(
            choice.file.name(),
            format!(
                "there is no {what} {n} ({path}); there are: {}",
                there.join(", ")
            ),
        )
    })
}

/// One of several; refused if it was not said which.
fn one_of<'a>(
    choice: &Choice<'_>,
    what: &str,
    wanted: Option<u64>,
    there: &'a [String],
) -> Result<&'a str, Error> {
    let count = there.len();
    let index = match wanted {
        None if count == 1 => 0,
        None => {
            return Err(Error::unsupported(
                choice.file.name(),
                format!(
                    "the file has {count} {what}s: choose one with --{what} N, 0 to {}",
                    count.saturating_sub(1)
                ),
            ));
        }
        Some(index) => usize::try_from(index).unwrap_or(usize::MAX),
    };
    there.get(index).map(String::as_str).ok_or_else(|| {
        Error::invalid(
            choice.file.name(),
            format!(
                "there is no {what} {index}; there are {count}: {}",
                there.join(", ")
            ),
        )
    })
}

/// Names such as `Channel 0`, by number.
fn with_numbers(names: Vec<String>, prefix: &str) -> Vec<String> {
    let number = |name: &str| name.strip_prefix(prefix)?.parse::<u64>().ok();
    let mut found: Vec<_> = names.into_iter().filter(|n| number(n).is_some()).collect();
    found.sort_by_key(|name| number(name));
    found
}

/// `DataSet/ResolutionLevel L/TimePoint T/Channel C/Data`.
fn imaris(choice: &Choice<'_>, image: &str) -> Result<Chosen, Error> {
    let mut path = format!("/{image}");
    let options = choice.options;
    let parts = [
        (
            "level",
            "ResolutionLevel ",
            Some(u64::from(options.level.unwrap_or(0))),
        ),
        ("frame", "TimePoint ", options.frame),
        ("channel", "Channel ", options.channel),
    ];
    for (what, prefix, wanted) in parts {
        let there = with_numbers(choice.names(&path)?, prefix);
        let one = one_of(choice, what, wanted, &there)?;
        path = format!("{path}/{one}");
    }
    let names = choice.names(&path)?;
    let dataset = found(choice, &format!("{path}/Data"), "dataset", 0, &names)?;
    Ok(Chosen {
        dataset,
        settled: ALL,
    })
}

const ALL: Settled = Settled {
    frame: true,
    channel: true,
    level: true,
};

/// `t00000/s00/L/cells`: a point in time, a setup (of channel, angle and so on), a level.
fn big_data_viewer(choice: &Choice<'_>, names: &[String]) -> Result<Chosen, Error> {
    let options = choice.options;
    let times: Vec<_> = names.iter().filter(|n| numbered(n, 't')).cloned().collect();
    let time = one_of(choice, "frame", options.frame, &times)?;
    let there = choice.names(&format!("/{time}"))?;
    let setups: Vec<_> = there.into_iter().filter(|n| numbered(n, 's')).collect();
    let setup = match options.dataset.as_deref() {
        Some(name) => {
            let name = name.trim_matches('/');
            let known = setups.iter().find(|setup| *setup == name);
            known.map(String::as_str).ok_or_else(|| {
                Error::invalid(
                    choice.file.name(),
                    format!("there is no setup {name}; there are: {}", setups.join(", ")),
                )
            })?
        }
        None => one_of(choice, "channel", options.channel, &setups)?,
    };
    let path = format!("/{time}/{setup}");
    let level = u64::from(options.level.unwrap_or(0));
    let levels = with_numbers(choice.names(&path)?, "");
    let level = one_of(choice, "level", Some(level), &levels)?;
    let dataset = found(
        choice,
        &format!("{path}/{level}/cells"),
        "level",
        0,
        &levels,
    )?;
    Ok(Chosen {
        dataset,
        settled: ALL,
    })
}

/// The signal that a NeXus file names, from the group at `path`: groups name the next with
/// `default`, the last names the dataset with `signal`; older files mark the dataset itself.
pub(super) fn nexus(choice: &Choice<'_>, path: &str) -> Result<Option<Dataset>, Error> {
    /// Deeper than any such file; a group may name itself.
    const MOST_DEPTH: usize = 16;
    /// Groups with more members than this are not looked through.
    const MOST_MEMBERS: usize = 1000;
    let mut path = path.to_owned();
    for _ in 0..MOST_DEPTH {
        let group = choice.attributes(&path)?;
        let below = |name: &str| format!("{}/{name}", path.trim_end_matches('/'));
        if let Some(signal) = group.text("signal") {
            return choice.dataset(&below(&signal));
        }
        if let Some(next) = group.text("default") {
            path = below(&next);
            continue;
        }
        let class = group.text("NX_class");
        let members = choice.members(&path)?;
        if members.len() > MOST_MEMBERS {
            return Ok(None);
        }
        let attributes = |address| -> Result<Attributes, Error> {
            Attributes::read(choice.file, &Object::read(choice.file, address)?)
        };
        if class.as_deref() == Some("NXdata") {
            for (name, address) in members {
                if attributes(address)?.number("signal") == Some(1.0) {
                    return choice.dataset(&below(&name));
                }
            }
            return Ok(None);
        }
        let wanted = match class.as_deref() {
            None | Some("NXroot") => "NXentry",
            Some("NXentry") => "NXdata",
            _ => return Ok(None),
        };
        let mut next = Vec::new();
        for (name, address) in members {
            if attributes(address)?.text("NX_class").as_deref() == Some(wanted) {
                next.push(below(&name));
            }
        }
        match next.pop() {
            Some(only) if next.is_empty() => path = only,
            _ => return Ok(None),
        }
    }
    Ok(None)
}
