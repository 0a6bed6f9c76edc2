//! Groups: the links of an object, and the object a path leads to.
//!
//! In: the address of a group. Out: its links, from an old group's symbol table or from messages,
//! compact or in a heap. Links to other files are refused by name. Guaranteed: soft links that
//! lead in circles end.

use super::btree2::Tree2;
use super::file::File;
use super::heap::{FractalHeap, LocalHeap};
use super::object::{Message, Object, kind};
use crate::error::Error;

/// Where a link leads.
#[derive(Debug)]
pub(super) enum Target {
    /// To the object at an address.
    Hard(u64),
    /// To a path.
    Soft(String),
    /// Into another file, with this name.
    External(String),
}

/// A name in a group.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) name: String,
    pub(super) target: Target,
}

/// More links than this are not looked at.
pub(super) const MOST_LINKS: usize = 200_000;

/// Whether an object is a group.
pub(super) fn is_group(object: &Object) -> bool {
    [kind::SYMBOLS, kind::LINK_INFO, kind::LINK]
        .into_iter()
        .any(|kind| object.has(kind))
}

/// The links of a group, in the order they are kept in.
pub(super) fn links(file: &File, group: &Object) -> Result<Vec<Link>, Error> {
    let mut links = Vec::new();
    if let Some(message) = group.first(file, kind::SYMBOLS)? {
        symbols(file, &message, &mut links)?;
    }
    for message in group.all(file, kind::LINK)? {
        add(file, link(file, &message)?, &mut links)?;
    }
    if let Some(message) = group.first(file, kind::LINK_INFO)? {
        let mut fields = message.fields(file);
        fields.version("a link info message", 0)?;
        let flags = fields.u8()?;
        fields.skip(if flags & 1 != 0 { 8 } else { 0 })?;
        if let (Some(heap), Some(names)) = (fields.offset()?, fields.offset()?) {
            let heap = FractalHeap::open(file, heap)?;
            let tree = Tree2::open(file, names)?;
            // Behind the hash of the name is where the link is.
            tree.visit(file, |record| {
                let id = record.get(4..).unwrap_or_default();
                let message = Message::of(kind::LINK, message.address, heap.object(id)?);
                add(file, link(file, &message)?, &mut links)
            })?;
        }
    }
    Ok(links)
}

fn add(file: &File, link: Link, links: &mut Vec<Link>) -> Result<(), Error> {
    if links.len() >= MOST_LINKS {
        return Err(Error::unsupported(
            file.name(),
            format!("a group with more than {MOST_LINKS} links is not read here"),
        ));
    }
    links.push(link);
    Ok(())
}

/// A link message.
fn link(file: &File, message: &Message) -> Result<Link, Error> {
    let mut fields = message.fields(file);
    fields.version("a link message", 1)?;
    let flags = fields.u8()?;
    let how = if flags & 8 != 0 { fields.u8()? } else { 0 };
    fields.skip(if flags & 4 != 0 { 8 } else { 0 })?;
    fields.skip(if flags & 16 != 0 { 1 } else { 0 })?;
    let length = fields.uint(1 << (flags & 3))?;
    let name = fields.take(usize::try_from(length).unwrap_or(usize::MAX))?;
    let name = String::from_utf8_lossy(name).into_owned();
    let target = match how {
        0 => Target::Hard(fields.address("a linked object")?),
        1 => {
            let length = usize::from(fields.u16()?);
            Target::Soft(String::from_utf8_lossy(fields.take(length)?).into_owned())
        }
        64 => {
            let length = usize::from(fields.u16()?);
            // Flags, the file, the object in it.
            let text = fields.take(length)?.get(1..).unwrap_or_default();
            let other = text.split(|byte| *byte == 0).next().unwrap_or_default();
            Target::External(String::from_utf8_lossy(other).into_owned())
        }
        _ => Target::External(format!("a link of type {how}")),
    };
    Ok(Link { name, target })
}

/// The links of an old group: a B-tree of nodes that name them.
fn symbols(file: &File, message: &Message, links: &mut Vec<Link>) -> Result<(), Error> {
    let mut fields = message.fields(file);
    let tree = fields.address("a group's B-tree")?;
    let heap = LocalHeap::open(file, fields.address("a group's heap")?)?;
    let offset = file.offset_bytes();
    let mut todo = vec![(tree, None)];
    while let Some((address, above)) = todo.pop() {
        let head_bytes = 8 + 2 * offset;
        let head = file.describe(address, head_bytes as u64)?;
        if head.starts_with(b"SNOD") {
            symbol_node(file, address, &heap, links)?;
            continue;
        }
        let mut fields = file.fields(address, &head);
        fields.magic(b"TREE")?;
        let kind = fields.u8()?;
        let level = fields.u8()?;
        if kind != 0 || above.is_some_and(|above| level >= above) {
            return Err(fields.invalid(format!(
                "a node of type {kind} and level {level} in the B-tree of a group"
            )));
        }
        let count = u64::from(fields.u16()?);
        let pair = (file.length_bytes() + offset) as u64;
        let body_address = address.saturating_add(head_bytes as u64);
        let body = file.describe(body_address, count * pair)?;
        let mut fields = file.fields(body_address, &body);
        for _ in 0..count {
            fields.length()?;
            todo.push((fields.address("a node of a B-tree")?, Some(level)));
        }
    }
    Ok(())
}

fn symbol_node(
    file: &File,
    address: u64,
    heap: &LocalHeap<'_>,
    links: &mut Vec<Link>,
) -> Result<(), Error> {
    let head = file.describe(address, 8)?;
    let mut fields = file.fields(address, &head);
    fields.magic(b"SNOD")?;
    fields.version("a node of symbols", 1)?;
    fields.skip(1)?;
    let count = u64::from(fields.u16()?);
    let entry = 2 * file.offset_bytes() as u64 + 24;
    let body_address = address.saturating_add(8);
    let body = file.describe(body_address, count * entry)?;
    let mut fields = file.fields(body_address, &body);
    for _ in 0..count {
        let name = fields.uint(file.offset_bytes())?;
        let object = fields.offset()?;
        let cached = fields.u32()?;
        fields.skip(4)?;
        let scratch = u64::from(fields.u32()?);
        fields.skip(12)?;
        let target = match (cached, object) {
            (2, _) => Target::Soft(heap.text(scratch)?),
            (_, Some(object)) => Target::Hard(object),
            (_, None) => continue,
        };
        let name = heap.text(name)?;
        add(file, Link { name, target }, links)?;
    }
    Ok(())
}

/// The object that a path from the root leads to, and its path without soft links; `None` if
/// there is none.
pub(super) fn find(file: &File, root: u64, path: &str) -> Result<Option<(Object, String)>, Error> {
    /// As for libhdf5.
    const MOST_SOFT: usize = 16;
    let parts = |path: &str| -> Vec<String> {
        let named = path.split('/').filter(|part| !matches!(*part, "" | "."));
        named.rev().map(str::to_owned).collect()
    };
    let mut todo = parts(path);
    let mut object = Object::read(file, root)?;
    let mut so_far = String::new();
    let mut soft = 0;
    while let Some(name) = todo.pop() {
        if !is_group(&object) {
            return Ok(None);
        }
        let links = links(file, &object)?;
        let Some(link) = links.into_iter().find(|link| link.name == name) else {
            return Ok(None);
        };
        match link.target {
            Target::Hard(address) => {
                object = Object::read(file, address)?;
                so_far = format!("{so_far}/{name}");
            }
            Target::Soft(to) => {
                soft += 1;
                if soft > MOST_SOFT {
                    return Err(Error::invalid(
                        file.name(),
                        format!("{path} leads through more than {MOST_SOFT} soft links"),
                    ));
                }
                if to.starts_with('/') {
                    object = Object::read(file, root)?;
                    so_far.clear();
                }
                todo.extend(parts(&to));
            }
            Target::External(other) => {
                return Err(Error::unsupported(
                    file.name(),
                    format!("{so_far}/{name} is in another file, {other}: open that one"),
                ));
            }
        }
    }
    if so_far.is_empty() {
        so_far.push('/');
    }
    Ok(Some((object, so_far)))
}
