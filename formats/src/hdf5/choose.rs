//! Which dataset of a file is the volume, and which of its axes.
//!
//! In: a file and the caller's choices. Out: a dataset and its [`Selection`]. What the caller
//! names counts first, then what a convention names (Imaris, BigDataViewer, MINC 2, Data Exchange,
//! NeXus), then the only dataset that can be a volume. Where several are left, they are listed.

use std::collections::HashSet;
use std::sync::Arc;

use super::attribute::Attributes;
use super::convention;
use super::dataset::{Dataset, Selection};
use super::file::File;
use super::group::{self, MOST_LINKS, Target, find, is_group, links};
use super::object::Object;
use crate::error::Error;
use crate::options::OpenOptions;

/// Datasets shown in a list.
const MOST_SHOWN: usize = 30;

/// A file, its root group, and what the caller wants of it.
pub(super) struct Choice<'a> {
    pub(super) file: &'a Arc<File>,
    pub(super) root: u64,
    pub(super) options: &'a OpenOptions,
}

/// What a convention or the caller chose.
pub(super) struct Chosen {
    pub(super) dataset: Dataset,
    /// Whether frame, channel or level are already in the path.
    pub(super) settled: Settled,
}

/// Choices that a path answers.
#[derive(Clone, Copy, Default)]
pub(super) struct Settled {
    pub(super) frame: bool,
    pub(super) channel: bool,
    pub(super) level: bool,
}

impl Choice<'_> {
    /// The dataset that is the volume.
    pub(super) fn choose(&self) -> Result<Chosen, Error> {
        if let Some(chosen) = convention::choose(self)? {
            return Ok(chosen);
        }
        let dataset = match &self.options.dataset {
            Some(path) => self.named(path)?,
            None => match convention::nexus(self, "/")? {
                Some(dataset) if volume_like(&dataset) => dataset,
                _ => self.only("/")?,
            },
        };
        Ok(Chosen {
            dataset,
            settled: Settled::default(),
        })
    }

    /// The object at a path.
    pub(super) fn object(&self, path: &str) -> Result<Option<(Object, String)>, Error> {
        find(self.file, self.root, path)
    }

    /// The dataset at a path, if there is one.
    pub(super) fn dataset(&self, path: &str) -> Result<Option<Dataset>, Error> {
        match self.object(path)? {
            Some((object, path)) if !is_group(&object) => Dataset::of(self.file, object, &path),
            _ => Ok(None),
        }
    }

    /// The attributes of the object at a path; none if there is no such object.
    pub(super) fn attributes(&self, path: &str) -> Result<Attributes, Error> {
        match self.object(path)? {
            Some((object, _)) => Attributes::read(self.file, &object),
            None => Ok(Attributes::default()),
        }
    }

    /// The objects that are linked in the group at a path, and their names, sorted.
    pub(super) fn members(&self, path: &str) -> Result<Vec<(String, u64)>, Error> {
        let mut members = Vec::new();
        if let Some((object, _)) = self.object(path)?
            && is_group(&object)
        {
            for link in links(self.file, &object)? {
                if let Target::Hard(address) = link.target {
                    members.push((link.name, address));
                }
            }
        }
        members.sort();
        Ok(members)
    }

    /// The names in the group at a path, sorted.
    pub(super) fn names(&self, path: &str) -> Result<Vec<String>, Error> {
        let mut names = match self.object(path)? {
            Some((object, _)) if is_group(&object) => {
                let links = links(self.file, &object)?;
                links.into_iter().map(|link| link.name).collect()
            }
            _ => Vec::new(),
        };
        names.sort();
        Ok(names)
    }

    /// The dataset that the caller named: by its path, by the path of a group it is the only
    /// volume of, or by the last part of its path.
    fn named(&self, path: &str) -> Result<Dataset, Error> {
        if let Some((object, found)) = self.object(path)? {
            if !is_group(&object) {
                let dataset = Dataset::of(self.file, object, &found)?;
                return dataset.ok_or_else(|| {
                    Error::unsupported(self.file.name(), format!("{path} is not a dataset"))
                });
            }
            return match convention::nexus(self, &found)? {
                Some(dataset) if volume_like(&dataset) => Ok(dataset),
                _ => self.only(&found),
            };
        }
        let all = self.all("/")?;
        let mut same: Vec<_> = all
            .iter()
            .filter(|listed| listed.path.rsplit('/').next() == Some(path))
            .collect();
        if let (Some(listed), true) = (same.pop(), same.is_empty())
            && let Some(dataset) = self.dataset(&listed.path)?
        {
            return Ok(dataset);
        }
        Err(Error::invalid(
            self.file.name(),
            format!("there is no dataset {path}; there are: {}", list(&all)),
        ))
    }

    /// The only volume under a path.
    fn only(&self, path: &str) -> Result<Dataset, Error> {
        let all = self.all(path)?;
        let volumes: Vec<_> = all.iter().filter(|listed| listed.volume).collect();
        match volumes.as_slice() {
            [] => {
                let near = all
                    .iter()
                    .find(|listed| listed.extents >= 3 && !listed.numbers);
                let what = match near {
                    Some(near) => format!("a 3-D dataset of {}", near.what),
                    None => "no 3-D dataset of numbers".into(),
                };
                Err(Error::unsupported(
                    self.file.name(),
                    format!("the file holds {what}; its datasets are: {}", list(&all)),
                ))
            }
            [only] => {
                let dataset = self.dataset(&only.path)?;
                dataset.ok_or_else(|| {
                    Error::invalid(self.file.name(), format!("{} is gone", only.path))
                })
            }
            several => {
                let shown: Vec<_> = several.iter().map(|listed| listed.text.clone()).collect();
                Err(Error::unsupported(
                    self.file.name(),
                    format!(
                        "the file holds {} volumes: {}; choose one with --dataset PATH",
                        several.len(),
                        shorten(shown)
                    ),
                ))
            }
        }
    }

    /// All datasets under a path, each once, by the names in their groups.
    fn all(&self, path: &str) -> Result<Vec<Listed>, Error> {
        let Some((top, top_path)) = self.object(path)? else {
            return Ok(Vec::new());
        };
        let mut found = Vec::new();
        let mut seen = HashSet::from([top.address]);
        let mut todo = vec![(top, top_path)];
        while let Some((object, path)) = todo.pop() {
            if !is_group(&object) {
                if let Some(dataset) = Dataset::of(self.file, object, &path)? {
                    found.push(self.listed(&dataset)?);
                }
                continue;
            }
            let mut links = links(self.file, &object)?;
            // The last is looked at first.
            links.sort_by(|a, b| b.name.cmp(&a.name));
            for group::Link { name, target } in links {
                // Where MATLAB keeps what other values refer to.
                let hidden = ["#refs#", "#subsystem#"].contains(&name.as_str());
                let Target::Hard(address) = target else {
                    continue;
                };
                if hidden || !seen.insert(address) {
                    continue;
                }
                if seen.len() > MOST_LINKS {
                    return Err(Error::unsupported(
                        self.file.name(),
                        format!(
                            "the file has more than {MOST_LINKS} objects: choose a dataset with \
                             --dataset PATH"
                        ),
                    ));
                }
                let path = format!("{}/{name}", path.trim_end_matches('/'));
                todo.push((Object::read(self.file, address)?, path));
            }
        }
        Ok(found)
    }

    fn listed(&self, dataset: &Dataset) -> Result<Listed, Error> {
        let mut volume = volume_like(dataset);
        if volume {
            // A picture in colour, and its palette, have three axes too.
            let class = dataset.attributes(self.file)?.text("CLASS");
            volume = !matches!(class.as_deref(), Some("IMAGE" | "PALETTE"));
        }
        Ok(Listed {
            path: dataset.path.clone(),
            text: dataset.describe(),
            what: dataset.datatype.what.name(),
            numbers: dataset.dtype().is_some(),
            extents: dataset.dims.len(),
            volume,
        })
    }
}

/// A dataset in a list.
struct Listed {
    path: String,
    text: String,
    what: &'static str,
    numbers: bool,
    extents: usize,
    volume: bool,
}

/// Whether a dataset can be a volume, by its type and extents.
fn volume_like(dataset: &Dataset) -> bool {
    dataset.dtype().is_some() && dataset.dims.len() >= 3 && !dataset.dims.contains(&0)
}

fn list(all: &[Listed]) -> String {
    if all.is_empty() {
        return "none".into();
    }
    shorten(all.iter().map(|listed| listed.text.clone()).collect())
}

fn shorten(mut shown: Vec<String>) -> String {
    let more = shown.len().saturating_sub(MOST_SHOWN);
    shown.truncate(MOST_SHOWN);
    let text = shown.join(", ");
    if more > 0 {
        format!("{text} and {more} more")
    } else {
        text
    }
}

/// Which axes a dataset has, by their letters or by their extents.
struct Axes {
    /// z, y, x.
    volume: [usize; 3],
    frame: Option<usize>,
    channel: Option<usize>,
}

impl Axes {
    /// `letters` are those of the axes, if the file gives them.
    fn of(dims: &[u64], letters: Option<&str>) -> Option<Self> {
        let letters = letters.filter(|letters| letters.len() == dims.len());
        let named = |letter: char| letters.and_then(|letters| letters.find(letter));
        if let (Some(z), Some(y), Some(x)) = (named('z'), named('y'), named('x')) {
            return Some(Self {
                volume: [z, y, x],
                frame: named('t'),
                channel: named('c'),
            });
        }
        let mut axes: Vec<usize> = (0..dims.len()).collect();
        while axes.len() > 3 && dims[axes[0]] == 1 {
            axes.remove(0);
        }
        while axes.len() > 3 && dims[axes[axes.len() - 1]] == 1 {
            axes.pop();
        }
        /// Colours, mostly: a last axis this short is not x.
        const FEW: u64 = 4;
        let few = |axis: usize| dims[axis] <= FEW;
        match axes[..] {
            [z, y, x] => Some(Self {
                volume: [z, y, x],
                frame: None,
                channel: None,
            }),
            [z, y, x, c] if few(c) && ![z, y, x].into_iter().any(few) => Some(Self {
                volume: [z, y, x],
                frame: None,
                channel: Some(c),
            }),
            [t, z, y, x] => Some(Self {
                volume: [z, y, x],
                frame: Some(t),
                channel: None,
            }),
            [t, c, z, y, x] => Some(Self {
                volume: [z, y, x],
                frame: Some(t),
                channel: Some(c),
            }),
            _ => None,
        }
    }
}

/// The part of a dataset that is the volume, with what the caller chose of further axes.
pub(super) fn select(
    choice: &Choice<'_>,
    chosen: &Chosen,
    letters: Option<&str>,
) -> Result<Selection, Error> {
    let dataset = &chosen.dataset;
    let refused = |what: String| {
        Error::unsupported(
            choice.file.name(),
            format!("dataset {} {what}", dataset.path),
        )
    };
    let dims = &dataset.dims;
    let Some(axes) = Axes::of(dims, letters) else {
        return Err(refused(format!(
            "has extents {dims:?}; a volume has 3, and at most frames and channels before them"
        )));
    };
    let mut fixed = vec![0; dims.len()];
    let options = choice.options;
    let further = [
        ("frame", axes.frame, options.frame, chosen.settled.frame),
        (
            "channel",
            axes.channel,
            options.channel,
            chosen.settled.channel,
        ),
    ];
    for (what, axis, wanted, settled) in further {
        let wanted = wanted.filter(|_| !settled);
        let count = axis.map_or(1, |axis| dims[axis]);
        let index = match wanted {
            None if count == 1 => 0,
            None => {
                return Err(refused(format!(
                    "has {count} {what}s: choose one with --{what} N, 0 to {}",
                    count - 1
                )));
            }
            Some(index) if index < count => index,
            Some(index) => {
                return Err(refused(format!(
                    "has {count} {what}s, 0 to {}: there is no {what} {index}",
                    count.saturating_sub(1)
                )));
            }
        };
        if let Some(axis) = axis {
            fixed[axis] = index;
        }
    }
    let level = options
        .level
        .filter(|level| *level > 0 && !chosen.settled.level);
    if let Some(level) = level {
        return Err(refused(format!("has one level: there is no level {level}")));
    }
    let used = |axis: usize| {
        axes.volume.contains(&axis) || [axes.frame, axes.channel].contains(&Some(axis))
    };
    if let Some(axis) = (0..dims.len()).find(|axis| dims[*axis] > 1 && !used(*axis)) {
        return Err(refused(format!(
            "has {} values along axis {axis}, which is none of x, y, z, t and c",
            dims[axis]
        )));
    }
    Ok(Selection {
        volume: axes.volume.map(Some),
        fixed,
    })
}
