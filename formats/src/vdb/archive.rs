//! The file around the grids: header, metadata, and one descriptor a grid.
//!
//! In: a cursor at the first byte. Out: the version, and the grids with their places in the file.
//! A file written as a stream has no places: its grids are then walked one after the other (by
//! the caller, who knows how).

use super::cursor::Cursor;
use super::values::Kind;
use crate::error::Error;

/// The first bytes of a file.
const MAGIC: &[u8] = b" BDV\0\0\0\0";

/// The oldest version read: the first whose root is a map.
const OLDEST: u32 = 213;
/// The newest version read: the first with grids of half floats.
const NEWEST: u32 = 225;

/// Versions of the format that changed what is read here, by what they brought.
pub(super) mod version {
    /// Internal nodes keep tile values together, compressed, before their children.
    pub(crate) const INTERNAL_COMPRESSION: u32 = 214;
    /// Grids share trees; the transform comes before the tree.
    pub(crate) const INSTANCES: u32 = 216;
    /// Leaves of bool grids are two bit masks.
    pub(crate) const BOOL_LEAVES: u32 = 217;
    /// The identifier of a file is text.
    pub(crate) const TEXT_UUID: u32 = 218;
    /// Transforms are maps of several types.
    pub(crate) const MAPS: u32 = 219;
    /// A flag of the file says whether values are compressed.
    pub(crate) const COMPRESSION_FLAG: u32 = 220;
    /// Compression is said by each grid; nodes leave out inactive values.
    pub(crate) const NODE_MASKS: u32 = 222;
}

/// Which scheme compresses the values of nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    None,
    Zip,
    Blosc,
}

/// How the values of nodes are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Compression {
    pub(super) codec: Codec,
    /// Inactive values of nodes with at most two of them are left out.
    pub(super) active_mask: bool,
}

impl std::fmt::Display for Compression {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match (self.codec, self.active_mask) {
            (Codec::None, false) => "none",
            (Codec::None, true) => "active mask",
            (Codec::Zip, false) => "zip",
            (Codec::Zip, true) => "zip, active mask",
            (Codec::Blosc, false) => "blosc",
            (Codec::Blosc, true) => "blosc, active mask",
        })
    }
}

/// What the first bytes of the file say.
#[derive(Clone, Copy, Debug)]
pub(super) struct FileHeader {
    pub(super) version: u32,
    /// Library that wrote the file: major and minor number.
    pub(super) library: [u32; 2],
    /// Descriptors say where grids are.
    pub(super) has_offsets: bool,
    /// How values are compressed where grids do not say it.
    compression: Compression,
}

impl FileHeader {
    /// Reads the header.
    pub(super) fn read(cursor: &mut Cursor<'_>) -> Result<Self, Error> {
        const WHAT: &str = "the header";
        let magic = cursor.take(MAGIC.len(), WHAT)?;
        if magic != MAGIC {
            let message = format!(
                "not an OpenVDB file: it begins with \"{}\", \"{}\" expected",
                magic.escape_ascii(),
                MAGIC.escape_ascii()
            );
            return Err(cursor.invalid(0, message));
        }
        let version = cursor.u32(WHAT)?;
        if !(OLDEST..=NEWEST).contains(&version) {
            return Err(cursor
                .unsupported(format!(
                    "OpenVDB file version {version}; versions {OLDEST} to {NEWEST} are read"
                ))
                .at(8));
        }
        let library = [cursor.u32(WHAT)?, cursor.u32(WHAT)?];
        let has_offsets = cursor.u8(WHAT)? != 0;
        let zipped = match version {
            version::COMPRESSION_FLAG..version::NODE_MASKS => cursor.u8(WHAT)? != 0,
            _ => true,
        };
        // 32 digits and 4 hyphens.
        let uuid = if version >= version::TEXT_UUID {
            36
        } else {
            16
        };
        cursor.skip(uuid, WHAT)?;
        let codec = if zipped { Codec::Zip } else { Codec::None };
        Ok(Self {
            version,
            library,
            has_offsets,
            compression: Compression {
                codec,
                active_mask: false,
            },
        })
    }

    /// The compression of the grid at whose start the cursor is.
    pub(super) fn compression(&self, cursor: &mut Cursor<'_>) -> Result<Compression, Error> {
        if self.version < version::NODE_MASKS {
            return Ok(self.compression);
        }
        let at = cursor.offset();
        let flags = cursor.u32("the compression flags of a grid")?;
        if flags & !7 != 0 {
            return Err(cursor.invalid(
                at,
                format!("compression flags {flags:#x}, at most 0x7 expected"),
            ));
        }
        Ok(Compression {
            // Blosc goes first where both are set, as in OpenVDB.
            codec: match (flags & 4 != 0, flags & 1 != 0) {
                (true, _) => Codec::Blosc,
                (false, true) => Codec::Zip,
                (false, false) => Codec::None,
            },
            active_mask: flags & 2 != 0,
        })
    }
}

/// The metadata that matter.
#[derive(Clone, Debug, Default)]
pub(super) struct Metadata {
    /// What the values mean: "level set", "fog volume", ...
    pub(super) class: String,
    /// The program that made the grid.
    pub(super) creator: String,
    /// Real numbers are stored as half floats. The type of the grid says so, too, but this is
    /// what OpenVDB goes by.
    pub(super) half: bool,
}

impl Metadata {
    /// Reads the metadata of a file or a grid.
    pub(super) fn read(cursor: &mut Cursor<'_>) -> Result<Self, Error> {
        const WHAT: &str = "the metadata";
        let mut found = Self::default();
        let count = cursor.u32(WHAT)?;
        // Each has at least three lengths, so a wrong count ends at the end of the file.
        for _ in 0..count {
            let name = cursor.string(WHAT)?;
            let kind = cursor.string(WHAT)?;
            let bytes = cursor.u32(WHAT)?;
            let wanted = matches!(
                name.as_str(),
                "class" | "creator" | "is_saved_as_half_float"
            );
            if !wanted {
                cursor.skip(u64::from(bytes), WHAT)?;
                continue;
            }
            let value = cursor.take(bytes as usize, WHAT)?;
            match (name.as_str(), kind.as_str()) {
                ("class", "string") => found.class = plain(&String::from_utf8_lossy(value)),
                ("creator", "string") => found.creator = plain(&String::from_utf8_lossy(value)),
                ("is_saved_as_half_float", _) => found.half = value.iter().any(|byte| *byte != 0),
                _ => {}
            }
        }
        Ok(found)
    }
}

/// Text without control characters, for people.
fn plain(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() { '?' } else { c })
        .collect()
}

/// What stands between a name and its number where several grids have that name.
const SEPARATOR: char = '\u{1e}';

/// Added to the type of a grid whose values are stored as half floats.
const HALF_SUFFIX: &str = "_HalfFloat";

/// A unique name as OpenVDB shows it.
fn numbered(unique: &str) -> String {
    match unique.split_once(SEPARATOR) {
        None => plain(unique),
        Some((name, number)) => format!("{}[{}]", plain(name), plain(number)),
    }
}

/// One grid of the file.
#[derive(Clone, Debug)]
pub(super) struct Descriptor {
    /// Name of the grid in this file, a number behind [`SEPARATOR`] where several have it.
    unique: String,
    /// Type of the values and shape of the tree.
    pub(super) kind: Kind,
    /// Unique name of the grid that has the tree, empty if this one does.
    parent: String,
    /// Offset of the grid itself, which begins with its compression flags.
    pub(super) start: u64,
    /// Offset of the values of its leaves, as the file says; it is where the topology ends.
    #[cfg(feature = "vdb-rs")]
    pub(super) leaves: i64,
    /// Offset of the next descriptor.
    pub(super) end: u64,
}

impl Descriptor {
    /// Reads a descriptor. In a stream its places are unknown: `start` is where it ends, and the
    /// caller finds `end`.
    pub(super) fn read(cursor: &mut Cursor<'_>, header: &FileHeader) -> Result<Self, Error> {
        const WHAT: &str = "the descriptor of a grid";
        let unique = cursor.string(WHAT)?;
        let written = cursor.string(WHAT)?;
        let parent = if header.version >= version::INSTANCES {
            cursor.string(WHAT)?
        } else {
            String::new()
        };
        let (tree, half) = match written.strip_suffix(HALF_SUFFIX) {
            Some(tree) => (tree, true),
            None => (written.as_str(), false),
        };
        let kind = Kind::of(&plain(tree), half);
        let at = cursor.offset();
        let places = [cursor.i64(WHAT)?, cursor.i64(WHAT)?, cursor.i64(WHAT)?];
        let (mut start, mut end) = (cursor.offset(), cursor.offset());
        if header.has_offsets {
            let length = cursor.file_bytes();
            // A grid begins behind its descriptor and ends in the file, so that a chain of
            // descriptors has an end, too.
            let [first, _, last] = places.map(u64::try_from);
            match (first, last) {
                (Ok(first), Ok(last)) if first >= start && last >= first && last <= length => {
                    (start, end) = (first, last);
                }
                (Ok(_), Ok(last)) if last > length => {
                    return Err(cursor.invalid(
                        length,
                        format!(
                            "the file ends early: {length} bytes found, {last} expected, where \
                             the grid \"{}\" ends",
                            plain(&unique)
                        ),
                    ));
                }
                _ => {
                    return Err(cursor.invalid(
                        at,
                        format!(
                            "the grid \"{}\" is said to be at bytes {} to {}; {start} to {length} \
                             expected",
                            plain(&unique),
                            places[0],
                            places[2],
                        ),
                    ));
                }
            }
        }
        Ok(Self {
            unique,
            kind,
            parent,
            start,
            #[cfg(feature = "vdb-rs")]
            leaves: places[1],
            end,
        })
    }

    /// Name of the grid, which others of the file may have, too.
    pub(super) fn name(&self) -> String {
        plain(self.unique.split(SEPARATOR).next().unwrap_or_default())
    }

    /// Name of the grid that no other grid of the file has: `density`, or `density[1]`.
    pub(super) fn unique_name(&self) -> String {
        numbered(&self.unique)
    }

    /// The unique name as it is in the file.
    #[cfg(feature = "vdb-rs")]
    pub(super) fn raw_name(&self) -> &str {
        &self.unique
    }

    /// Whether the tree is that of another grid.
    pub(super) fn is_instance(&self) -> bool {
        !self.parent.is_empty()
    }

    /// Whether `other` has the tree of this instance.
    pub(super) fn shares_tree_of(&self, other: &Self) -> bool {
        self.parent == other.unique && !other.is_instance()
    }

    /// Name of the grid that has the tree, for people.
    pub(super) fn parent_name(&self) -> String {
        numbered(&self.parent)
    }
}
