//! Arrays and groups in a container, and the one that is meant.
//!
//! In: a store and the choices of the caller. Out: an array and its place in the world. A dataset
//! is named by its path below the container, or, where a group holds several images, by the
//! name or number of one. Guaranteed: what is not chosen and not the only one is an error that
//! lists what there is; the search for it looks at so many nodes at most.

use std::sync::Arc;

use crate::error::Error;
use crate::header::Format;
use crate::options::OpenOptions;
use crate::store::{Store, join};
use crate::zarr::array::{Array, shape_text};
use crate::zarr::json::{self, Document};
use crate::zarr::ome::{self, Multiscale};
use crate::zarr::space::Space;
use crate::zarr::{n5, v2, v3};

/// Groups within groups are looked at to this depth.
const MOST_DEPTH: usize = 8;

/// Nodes looked at in search of arrays; plates have more, and are not searched.
const MOST_NODES: usize = 500;

/// What a key stands for.
enum Node {
    Array(Box<Array>),
    /// Its attributes.
    Group(Document),
}

/// The array that is meant.
pub(crate) struct Found {
    pub(crate) array: Array,
    pub(crate) space: Space,
    /// Facts for print.
    pub(crate) details: Vec<(&'static str, String)>,
}

/// A container.
pub(crate) struct Tree<'a> {
    store: Arc<dyn Store>,
    format: Format,
    options: &'a OpenOptions,
}

impl<'a> Tree<'a> {
    pub(crate) fn new(store: Arc<dyn Store>, format: Format, options: &'a OpenOptions) -> Self {
        Self {
            store,
            format,
            options,
        }
    }

    /// Finds the array that is meant; `None` where there is no container.
    pub(crate) fn find(&self) -> Result<Option<Found>, Error> {
        let Some(root) = self.node("")? else {
            return Ok(None);
        };
        let wanted = match &self.options.dataset {
            Some(wanted) => Some(self.clean(wanted)?),
            None => None,
        };
        let wanted = wanted.as_deref().filter(|wanted| !wanted.is_empty());
        self.choose("", root, wanted, &mut Vec::new()).map(Some)
    }

    fn name(&self, key: &str) -> String {
        self.store.name(key)
    }

    /// A path without empty steps; one that leaves the container is refused unless allowed.
    fn clean(&self, path: &str) -> Result<String, Error> {
        let steps: Vec<_> = path
            .split('/')
            .filter(|step| !step.is_empty() && *step != ".")
            .collect();
        if !self.options.outside
            && steps
                .iter()
                .any(|step| *step == ".." || step.contains('\\'))
        {
            return Err(Error::unsupported(
                self.name(""),
                format!("the path '{path}' leaves the container; allow it with --allow-outside"),
            ));
        }
        Ok(steps.join("/"))
    }

    /// What is at a key, if anything.
    fn node(&self, key: &str) -> Result<Option<Node>, Error> {
        let read = |file: &str| json::read(&*self.store, &join(key, file));
        if self.format == Format::N5 {
            let Some(document) = read("attributes.json")? else {
                // Groups need no attributes.
                let below = self.store.children(key)?.unwrap_or_default();
                let empty = Document::new(&self.name(key), empty_object());
                return Ok((!below.is_empty()).then_some(Node::Group(empty)));
            };
            return Ok(Some(match n5::array(&document, key)? {
                Some(array) => Node::Array(Box::new(array)),
                None => Node::Group(document),
            }));
        }
        if let Some(document) = read("zarr.json")? {
            v3::check_version(&document)?;
            return match document.text("node_type")? {
                "array" => Ok(Some(Node::Array(Box::new(v3::array(&document, key)?)))),
                "group" => {
                    let mut attributes = v3::attributes(&document);
                    if let Some(consolidated) = document.optional("consolidated_metadata")
                        && let Some(object) = attributes.value.as_object_mut()
                    {
                        object.insert(CONSOLIDATED.into(), consolidated.clone());
                    }
                    Ok(Some(Node::Group(attributes)))
                }
                other => {
                    Err(document
                        .invalid(format!("'node_type' is '{other}', array or group expected")))
                }
            };
        }
        let attributes = |attributes: Option<Document>, file: &str| {
            attributes
                .unwrap_or_else(|| Document::new(&self.name(&join(key, file)), empty_object()))
        };
        if let Some(document) = read(".zarray")? {
            let attributes = attributes(read(".zattrs")?, ".zattrs");
            let array = v2::array(&document, key, attributes)?;
            return Ok(Some(Node::Array(Box::new(array))));
        }
        let group = read(".zgroup")?;
        if let Some(group) = &group {
            v2::check_version(group)?;
        }
        let found = read(".zattrs")?;
        if group.is_none() && found.is_none() {
            return Ok(None);
        }
        Ok(Some(Node::Group(attributes(found, ".zattrs"))))
    }

    /// The array meant by a node, where `wanted` is a path or a name below it. `around` are the
    /// attributes of the groups it is in, the nearest first.
    fn choose(
        &self,
        key: &str,
        node: Node,
        wanted: Option<&str>,
        around: &mut Vec<Document>,
    ) -> Result<Found, Error> {
        let group = match node {
            Node::Array(array) => return self.plain(*array, wanted, around),
            Node::Group(group) => group,
        };
        let attributes = ome::attributes(&group);
        let images = ome::multiscales(&attributes)?;
        let Some(wanted) = wanted else {
            return match &images[..] {
                [] => self.only(key, group, &attributes, around),
                [image] => self.image(key, &attributes, image, self.options.level, None),
                _ => Err(Error::unsupported(
                    self.name(key),
                    format!(
                        "has several images: {}; choose one with --dataset NAME",
                        list_images(&images)
                    ),
                )),
            };
        };
        for image in &images {
            // A level by its path.
            let paths = image.levels.iter().map(|level| self.clean(&level.path));
            for (number, path) in paths.enumerate() {
                if path? == wanted {
                    let number = u32::try_from(number).unwrap_or(u32::MAX);
                    return self.image(key, &attributes, image, Some(number), Some(wanted));
                }
            }
        }
        let named = images.iter().enumerate().find(|(number, image)| {
            images.len() > 1
                && (image.name.as_deref() == Some(wanted) || number.to_string() == wanted)
        });
        if let Some((_, image)) = named {
            return self.image(key, &attributes, image, self.options.level, Some(wanted));
        }
        around.insert(0, group);
        // Not every step of a path need be a node.
        let ends = wanted.match_indices('/').map(|(end, _)| end);
        for end in ends.chain([wanted.len()]) {
            let below = join(key, &wanted[..end]);
            if let Some(node) = self.node(&below)? {
                let rest = wanted.get(end + 1..).filter(|rest| !rest.is_empty());
                return self.choose(&below, node, rest, around);
            }
        }
        let group = around.remove(0);
        let mut there = Vec::new();
        if !images.is_empty() {
            there.extend(images.iter().map(Multiscale::list_levels));
        }
        if let Ok(found) = self.search(key, &group) {
            there.extend(found.iter().map(Candidate::describe));
        }
        Err(Error::unsupported(
            self.name(key),
            format!(
                "has no dataset '{wanted}'; there is {}",
                if there.is_empty() {
                    "none that can be listed".to_string()
                } else {
                    there.join(", ")
                }
            ),
        ))
    }

    /// An array that is not known to be part of an image.
    fn plain(
        &self,
        array: Array,
        wanted: Option<&str>,
        around: &[Document],
    ) -> Result<Found, Error> {
        let name = self.name(&array.key);
        if let Some(wanted) = wanted {
            return Err(Error::unsupported(
                &name,
                format!("is an array; there is no dataset '{wanted}' in it"),
            ));
        }
        let chosen = n5::level(array.key.rsplit('/').next().unwrap_or_default());
        if let Some(level) = self.options.level.filter(|level| *level > 0)
            && chosen != Some(level)
        {
            return Err(Error::unsupported(
                &name,
                format!("level {level} was asked for, but this is one array without levels"),
            ));
        }
        let space = if self.format == Format::N5 {
            n5::space(&array, around)
        } else {
            Space::new(array.shape.len())
        };
        let details = if array.key.is_empty() {
            Vec::new()
        } else {
            vec![("dataset", array.key.clone())]
        };
        Ok(Found {
            array,
            space,
            details,
        })
    }

    /// A level of an image.
    fn image(
        &self,
        key: &str,
        attributes: &Document,
        image: &Multiscale,
        level: Option<u32>,
        dataset: Option<&str>,
    ) -> Result<Found, Error> {
        let number = level.unwrap_or(0);
        let chosen = usize::try_from(number).ok();
        let Some(level) = chosen.and_then(|number| image.levels.get(number)) else {
            return Err(Error::unsupported(
                self.name(key),
                format!(
                    "there is no level {number}; there are {}",
                    image.list_levels()
                ),
            ));
        };
        let below = join(key, &self.clean(&level.path)?);
        let array = match self.node(&below)? {
            Some(Node::Array(array)) => *array,
            Some(Node::Group(_)) => {
                return Err(Error::invalid(
                    self.name(&below),
                    "is a group; an array was expected as a level of the image",
                ));
            }
            None => {
                return Err(Error::invalid(
                    self.name(&below),
                    format!("level {number} of the image is not there"),
                ));
            }
        };
        let space = image.space(attributes, level, array.shape.len())?;
        let mut details = Vec::new();
        if !key.is_empty() || dataset.is_some() {
            details.push(("dataset", below));
        }
        details.push(("level", format!("{number} of {}", image.list_levels())));
        Ok(Found {
            array,
            space,
            details,
        })
    }

    /// The only array or image in a group that is not an image itself.
    fn only(
        &self,
        key: &str,
        group: Document,
        attributes: &Document,
        around: &mut Vec<Document>,
    ) -> Result<Found, Error> {
        if let Some(message) = collection(attributes) {
            return Err(Error::unsupported(self.name(key), message));
        }
        let mut found = self.search(key, &group)?;
        // Coordinates and tables beside the volume are not meant.
        if found.iter().any(Candidate::is_volume) {
            found.retain(Candidate::is_volume);
        }
        match &found[..] {
            [] => Err(Error::unsupported(
                self.name(key),
                "is a group in which no array was found",
            )),
            [one] => {
                let below = one.key().to_string();
                if let Candidate::Pyramid(_, levels) = one {
                    return self.pyramid(&below, levels, group, around);
                }
                let relative = below.strip_prefix(key).unwrap_or(&below);
                let relative = relative.trim_start_matches('/').to_string();
                self.choose(key, Node::Group(group), Some(&relative), around)
            }
            _ => Err(Error::unsupported(
                self.name(key),
                format!(
                    "has several arrays: {}; choose one with --dataset PATH",
                    found
                        .iter()
                        .map(Candidate::describe)
                        .collect::<Vec<_>>()
                        .join(", ")
                ),
            )),
        }
    }

    /// A level of the group of an N5 pyramid.
    fn pyramid(
        &self,
        key: &str,
        levels: &[u32],
        group: Document,
        around: &mut Vec<Document>,
    ) -> Result<Found, Error> {
        let level = self.options.level.unwrap_or(0);
        let list = || {
            let list: Vec<_> = levels.iter().map(u32::to_string).collect();
            list.join(", ")
        };
        if !levels.contains(&level) {
            return Err(Error::unsupported(
                self.name(key),
                format!("there is no level {level}; there are {}", list()),
            ));
        }
        around.insert(0, group);
        if !key.is_empty()
            && let Some(Node::Group(own)) = self.node(key)?
        {
            around.insert(0, own);
        }
        let below = join(key, &format!("s{level}"));
        let Some(Node::Array(array)) = self.node(&below)? else {
            return Err(Error::invalid(self.name(&below), "is no array"));
        };
        let mut found = self.plain(*array, None, around)?;
        found
            .details
            .push(("level", format!("{level} of {}", list())));
        Ok(found)
    }

    /// The arrays and images below a group.
    fn search(&self, key: &str, group: &Document) -> Result<Vec<Candidate>, Error> {
        let mut found = Vec::new();
        let mut left = MOST_NODES;
        self.search_below(key, group, 0, &mut left, &mut found)?;
        Ok(found)
    }

    fn search_below(
        &self,
        key: &str,
        group: &Document,
        depth: usize,
        left: &mut usize,
        found: &mut Vec<Candidate>,
    ) -> Result<(), Error> {
        let Some(children) = self.store.children(key)? else {
            let paths = if group.optional("bioformats2raw.layout").is_some() {
                self.series(key)?
            } else {
                self.consolidated(key, group)?
            };
            return self.search_paths(key, &paths, found);
        };
        let before = found.len();
        for child in children {
            if *left == 0 {
                return Ok(());
            }
            *left -= 1;
            let below = join(key, &child);
            match self.node(&below)? {
                // A folder without metadata may hold arrays all the same.
                None if depth < MOST_DEPTH => {
                    let nothing = Document::new(&self.name(&below), empty_object());
                    self.search_below(&below, &nothing, depth + 1, left, found)?;
                }
                None => {}
                Some(Node::Array(array)) => {
                    found.push(Candidate::Array(below, array.shape.clone()));
                }
                Some(Node::Group(group)) => {
                    let attributes = ome::attributes(&group);
                    if !ome::multiscales(&attributes)?.is_empty() {
                        found.push(Candidate::Image(below));
                    } else if collection(&attributes).is_none() && depth < MOST_DEPTH {
                        self.search_below(&below, &group, depth + 1, left, found)?;
                    }
                }
            }
        }
        if self.format == Format::N5 {
            join_levels(key, before, found);
        }
        Ok(())
    }

    /// What is at paths that are known, sorted, where the store cannot list.
    fn search_paths(
        &self,
        key: &str,
        paths: &[String],
        found: &mut Vec<Candidate>,
    ) -> Result<(), Error> {
        for path in paths.iter().take(MOST_NODES) {
            let below = join(key, path);
            let in_image = found.iter().any(|candidate| {
                matches!(candidate, Candidate::Image(image)
                    if below.strip_prefix(image.as_str()).is_some_and(|b| b.starts_with('/')))
            });
            if in_image {
                continue;
            }
            match self.node(&below)? {
                Some(Node::Array(array)) => {
                    found.push(Candidate::Array(below, array.shape.clone()));
                }
                Some(Node::Group(group))
                    if !ome::multiscales(&ome::attributes(&group))?.is_empty() =>
                {
                    found.push(Candidate::Image(below));
                }
                Some(Node::Group(_)) | None => {}
            }
        }
        Ok(())
    }

    /// The images of bioformats2raw, which are numbered from 0, in a store that cannot list.
    fn series(&self, key: &str) -> Result<Vec<String>, Error> {
        let mut names = Vec::new();
        for number in 0..MOST_NODES {
            let name = number.to_string();
            if self.node(&join(key, &name))?.is_none() {
                break;
            }
            names.push(name);
        }
        Ok(names)
    }

    /// Paths below a group out of its consolidated metadata, for stores that cannot list.
    fn consolidated(&self, key: &str, group: &Document) -> Result<Vec<String>, Error> {
        let mut paths = Vec::new();
        if let Some(metadata) = group
            .optional(CONSOLIDATED)
            .and_then(|consolidated| consolidated.get("metadata"))
            .and_then(|metadata| metadata.as_object())
        {
            paths.extend(metadata.keys().cloned());
        } else if let Some(document) = json::read(&*self.store, &join(key, ".zmetadata"))?
            && let Some(metadata) = document.value.get("metadata").and_then(|m| m.as_object())
        {
            let nodes = metadata.keys().filter_map(|path| {
                path.strip_suffix("/.zarray")
                    .or_else(|| path.strip_suffix("/.zgroup"))
            });
            paths.extend(nodes.map(str::to_string));
        }
        let paths: Result<Vec<_>, _> = paths.iter().map(|path| self.clean(path)).collect();
        let mut paths = paths?;
        paths.retain(|path| !path.is_empty());
        paths.sort();
        if paths.is_empty() {
            return Err(Error::unsupported(
                self.name(key),
                "is a group, and what is in it cannot be listed here; choose an array with \
                 --dataset PATH",
            ));
        }
        Ok(paths)
    }
}

/// Where the consolidated metadata of a group is kept among its attributes.
const CONSOLIDATED: &str = "consolidated_metadata";

fn empty_object() -> serde_json::Value {
    serde_json::Value::Object(serde_json::Map::new())
}

/// What a group of several images is, and how one of them is chosen.
fn collection(attributes: &Document) -> Option<String> {
    let list = |values: Option<&serde_json::Value>, key: &str| {
        const MOST: usize = 6;
        let values = values.and_then(|values| values.as_array());
        let values = values.map_or(&[][..], Vec::as_slice);
        let mut names: Vec<_> = values
            .iter()
            .filter_map(|value| value.get(key).unwrap_or(value).as_str())
            .take(MOST)
            .collect();
        if values.len() > MOST {
            names.push("...");
        }
        names.join(", ")
    };
    if let Some(plate) = attributes.optional("plate") {
        return Some(format!(
            "is a plate of wells ({}); choose an image with --dataset ROW/COLUMN/FIELD",
            list(plate.get("wells"), "path")
        ));
    }
    if let Some(well) = attributes.optional("well") {
        return Some(format!(
            "is a well of images ({}); choose one with --dataset PATH",
            list(well.get("images"), "path")
        ));
    }
    if let Some(labels) = attributes.optional("labels") {
        return Some(format!(
            "is a group of labels ({}); choose one with --dataset NAME",
            list(Some(labels), "")
        ));
    }
    None
}

/// What a search found.
enum Candidate {
    Array(String, Vec<u64>),
    Image(String),
    /// A group of the levels of an N5 pyramid.
    Pyramid(String, Vec<u32>),
}

impl Candidate {
    fn key(&self) -> &str {
        match self {
            Self::Array(key, _) | Self::Image(key) | Self::Pyramid(key, _) => key,
        }
    }

    fn is_volume(&self) -> bool {
        match self {
            Self::Array(_, shape) => shape.len() >= 3,
            Self::Image(_) | Self::Pyramid(..) => true,
        }
    }

    fn describe(&self) -> String {
        match self {
            Self::Array(key, shape) => format!("{key} ({})", shape_text(shape)),
            Self::Image(key) => format!("{key} (image)"),
            Self::Pyramid(key, levels) => format!("{key} ({} levels)", levels.len()),
        }
    }
}

/// Puts the arrays s0, s1, ... of one group together, if they begin with s0 and nothing else is
/// there.
fn join_levels(key: &str, before: usize, found: &mut Vec<Candidate>) {
    let levels: Option<Vec<_>> = found[before..]
        .iter()
        .map(|candidate| match candidate {
            Candidate::Array(below, _) => {
                let (group, name) = below.rsplit_once('/').unwrap_or(("", below));
                n5::level(name).filter(|_| group == key)
            }
            _ => None,
        })
        .collect();
    let Some(mut levels) = levels else { return };
    levels.sort_unstable();
    if levels.first() == Some(&0) {
        found.truncate(before);
        found.push(Candidate::Pyramid(key.to_string(), levels));
    }
}

/// Names or numbers of images.
fn list_images(images: &[Multiscale]) -> String {
    images
        .iter()
        .enumerate()
        .map(|(number, image)| match &image.name {
            Some(name) => format!("{number} ({name})"),
            None => number.to_string(),
        })
        .collect::<Vec<_>>()
        .join(", ")
}
