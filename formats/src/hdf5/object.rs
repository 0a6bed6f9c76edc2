//! Object headers: the messages that say what a group or dataset is.
//!
//! In: the address of an object. Out: its [`Object`], the messages of all blocks of its header.
//! Guaranteed: blocks are followed at most once, and all together have a bounded size.

use super::file::{Fields, File};
use crate::error::Error;

/// Kinds of messages that are looked at.
pub(super) mod kind {
    pub(in super::super) const DATASPACE: u16 = 0x01;
    pub(in super::super) const LINK_INFO: u16 = 0x02;
    pub(in super::super) const DATATYPE: u16 = 0x03;
    pub(in super::super) const OLD_FILL: u16 = 0x04;
    pub(in super::super) const FILL: u16 = 0x05;
    pub(in super::super) const LINK: u16 = 0x06;
    pub(in super::super) const EXTERNAL: u16 = 0x07;
    pub(in super::super) const LAYOUT: u16 = 0x08;
    pub(in super::super) const FILTERS: u16 = 0x0b;
    pub(in super::super) const ATTRIBUTE: u16 = 0x0c;
    pub(super) const CONTINUATION: u16 = 0x10;
    pub(in super::super) const SYMBOLS: u16 = 0x11;
    pub(in super::super) const ATTRIBUTE_INFO: u16 = 0x15;
}

/// One message.
pub(super) struct Message {
    pub(super) kind: u16,
    /// Whether the body only says where the message is.
    shared: bool,
    /// Address of the body.
    pub(super) address: u64,
    pub(super) body: Vec<u8>,
}

/// A group, dataset or named datatype.
pub(super) struct Object {
    pub(super) address: u64,
    pub(super) messages: Vec<Message>,
}

impl Object {
    pub(super) fn read(file: &File, address: u64) -> Result<Self, Error> {
        let mut messages = Vec::new();
        let start = file.describe(address, 4)?;
        if *start == *b"OHDR" {
            read_v2(file, address, &mut messages)?;
        } else {
            read_v1(file, address, &mut messages)?;
        }
        Ok(Self { address, messages })
    }

    /// Whether there is a message of the kind.
    pub(super) fn has(&self, kind: u16) -> bool {
        self.messages.iter().any(|message| message.kind == kind)
    }

    /// Messages of the kind, found where they are shared.
    pub(super) fn all(&self, file: &File, kind: u16) -> Result<Vec<Message>, Error> {
        self.messages
            .iter()
            .filter(|message| message.kind == kind)
            .map(|message| message.found(file))
            .collect()
    }

    /// The first message of the kind.
    pub(super) fn first(&self, file: &File, kind: u16) -> Result<Option<Message>, Error> {
        let message = self.messages.iter().find(|message| message.kind == kind);
        message.map(|message| message.found(file)).transpose()
    }
}

impl Message {
    /// A message kept elsewhere than in a header, for which `address` stands in errors.
    pub(super) fn of(kind: u16, address: u64, body: Vec<u8>) -> Self {
        Self {
            kind,
            shared: false,
            address,
            body,
        }
    }

    /// The fields of the body.
    pub(super) fn fields<'a>(&'a self, file: &'a File) -> Fields<'a> {
        file.fields(self.address, &self.body)
    }

    /// The message itself, of another object if it is shared.
    fn found(&self, file: &File) -> Result<Self, Error> {
        if self.shared {
            return shared(&mut self.fields(file), self.kind, file);
        }
        Ok(Self::of(self.kind, self.address, self.body.clone()))
    }
}

/// The message of the kind that a reference to a shared one names.
pub(super) fn shared(fields: &mut Fields<'_>, kind: u16, file: &File) -> Result<Message, Error> {
    let version = fields.u8()?;
    let place = fields.u8()?;
    match (version, place) {
        (1, _) => fields.skip(6)?,
        (2, _) | (3, 2) => {}
        (3, _) => return Err(fields.unsupported("a message shared through the heap of the file")),
        _ => return Err(fields.unsupported(format!("version {version} of shared messages"))),
    }
    let address = fields.address("a shared message")?;
    let object = Object::read(file, address)?;
    object
        .messages
        .into_iter()
        .find(|message| message.kind == kind && !message.shared)
        .ok_or_else(|| fields.invalid("a shared message is not where it should be"))
}

/// Blocks of one header, read in order.
struct Blocks {
    todo: Vec<(u64, u64)>,
    seen: Vec<u64>,
    bytes: u64,
}

impl Blocks {
    /// More than any header has: a message has at most 64 KiB, and many attributes or links are
    /// kept elsewhere.
    const MOST_BYTES: u64 = 16 << 20;
    const MOST: usize = 4096;

    fn new() -> Self {
        Self {
            todo: Vec::new(),
            seen: Vec::new(),
            bytes: 0,
        }
    }

    /// Notes the block that a continuation message names.
    fn add(&mut self, fields: &mut Fields<'_>) -> Result<(), Error> {
        let address = fields.address("a continued object header")?;
        let length = fields.length()?;
        self.bytes = self.bytes.saturating_add(length);
        if self.seen.contains(&address) {
            return Err(fields.invalid("an object header continues in a circle"));
        }
        if self.bytes > Self::MOST_BYTES || self.seen.len() >= Self::MOST {
            return Err(fields.invalid("an object header of more than 16 MiB"));
        }
        self.seen.push(address);
        self.todo.push((address, length));
        Ok(())
    }
}

fn read_v1(file: &File, address: u64, out: &mut Vec<Message>) -> Result<(), Error> {
    let prefix = file.describe(address, 16)?;
    let mut fields = file.fields(address, &prefix);
    fields.version("an object header", 1)?;
    fields.skip(7)?;
    let size = fields.u32()?;
    let mut blocks = Blocks::new();
    let mut next = Some((address.saturating_add(16), u64::from(size)));
    while let Some((address, length)) = next {
        let block = file.describe(address, length)?;
        let mut fields = file.fields(address, &block);
        while fields.left() >= 8 {
            let kind = fields.u16()?;
            let size = fields.u16()?;
            let flags = fields.u8()?;
            fields.skip(3)?;
            message(file, &mut fields, kind, size, flags, &mut blocks, out)?;
        }
        next = blocks.todo.pop();
    }
    Ok(())
}

fn read_v2(file: &File, address: u64, out: &mut Vec<Message>) -> Result<(), Error> {
    // Flags tell how long the rest of the prefix is.
    let start = file.describe(address, 6)?;
    let flags = start[5];
    let times = if flags & 0x20 != 0 { 16 } else { 0 };
    let limits = if flags & 0x10 != 0 { 4 } else { 0 };
    let width = 1_usize << (flags & 3);
    let prefix_bytes = 6 + times + limits + width;
    let prefix = file.describe(address, prefix_bytes as u64)?;
    let mut fields = file.fields(address, &prefix);
    fields.skip(4)?;
    fields.version("an object header", 2)?;
    fields.skip(1 + times + limits)?;
    let size = fields.uint(width)?;
    let whole = size
        .checked_add(prefix_bytes as u64 + 4)
        .ok_or_else(|| fields.invalid(format!("an object header of {size} bytes")))?;
    let order = if flags & 4 != 0 { 2 } else { 0 };
    let mut blocks = Blocks::new();
    let mut next = Some((address, whole, prefix_bytes));
    while let Some((address, length, skip)) = next {
        let block = file.describe(address, length)?;
        let mut fields = file.fields(address, &block);
        if skip == 4 {
            fields.magic(b"OCHK")?;
        } else {
            fields.skip(skip)?;
        }
        let mut end = fields.clone();
        let content = end
            .left()
            .checked_sub(4)
            .ok_or_else(|| end.invalid("a continued object header without content"))?;
        end.skip(content)?;
        end.checksum("object header")?;
        // Less than the head of a message is a gap.
        while fields.left() >= 4 + 4 + order {
            let kind = u16::from(fields.u8()?);
            let size = fields.u16()?;
            let flags = fields.u8()?;
            fields.skip(order)?;
            message(file, &mut fields, kind, size, flags, &mut blocks, out)?;
        }
        next = blocks
            .todo
            .pop()
            .map(|(address, length)| (address, length, 4));
    }
    Ok(())
}

/// Takes one message behind its head.
fn message(
    file: &File,
    fields: &mut Fields<'_>,
    kind: u16,
    size: u16,
    flags: u8,
    blocks: &mut Blocks,
    out: &mut Vec<Message>,
) -> Result<(), Error> {
    let position = fields.position();
    let body = fields.take(size.into())?;
    // Back from a place to an address.
    let address = position.saturating_sub(file.place(0));
    if kind == kind::CONTINUATION {
        return blocks.add(&mut file.fields(address, body));
    }
    // Fillers and what nobody here looks at are not kept.
    let known = [
        kind::DATASPACE,
        kind::LINK_INFO,
        kind::DATATYPE,
        kind::OLD_FILL,
        kind::FILL,
        kind::LINK,
        kind::EXTERNAL,
        kind::LAYOUT,
        kind::FILTERS,
        kind::ATTRIBUTE,
        kind::SYMBOLS,
        kind::ATTRIBUTE_INFO,
    ];
    if known.contains(&kind) {
        out.push(Message {
            kind,
            shared: flags & 2 != 0,
            address,
            body: body.to_vec(),
        });
    }
    Ok(())
}
