//! The grids of a file: what there is, which one is meant, and its contents.
//!
//! In: the bytes of a file, and the name or number asked for. Out: [`Grid`]. With an index in the
//! file only the grid that is chosen is read; a stream is walked over from grid to grid, as far
//! as their ends can be found.

use super::archive::{Descriptor, FileHeader, Metadata, version};
use super::cursor::Cursor;
use super::transform::{self, Transform};
use super::tree::{Tree, TreeReader};
use super::values::{Decoder, Layout, Value};
use crate::bytes::FileBytes;
use crate::error::Error;

/// More grids than any program writes.
const MOST_GRIDS: u32 = 1 << 16;

/// Names listed in a message; of more, the number is told.
const MOST_NAMES: usize = 32;

/// The grids of a file.
pub(super) struct Grids<'a> {
    file: &'a FileBytes,
    pub(super) header: FileHeader,
    grids: Vec<Descriptor>,
    /// Why further grids of a stream could not be listed.
    unlisted: Option<String>,
}

/// A grid without the values of its leaves.
pub(super) struct Grid {
    pub(super) metadata: Metadata,
    pub(super) transform: Transform,
    pub(super) layout: Layout,
    pub(super) tree: Tree,
}

/// What the bytes of a grid are.
struct Contents {
    metadata: Metadata,
    transform: Transform,
    /// Nothing where another grid has the tree.
    tree: Option<(Layout, Tree)>,
}

impl<'a> Grids<'a> {
    /// Reads the list of grids.
    pub(super) fn read(file: &'a FileBytes) -> Result<Self, Error> {
        const WHAT: &str = "the list of grids";
        let cursor = &mut Cursor::new(file, 0);
        let header = FileHeader::read(cursor)?;
        Metadata::read(cursor)?;
        let at = cursor.offset();
        let count = cursor.u32(WHAT)?;
        if count > MOST_GRIDS {
            return Err(cursor.invalid(
                at,
                format!("the file says it has {count} grids, at most {MOST_GRIDS} expected"),
            ));
        }
        let mut list = Self {
            file,
            header,
            grids: Vec::new(),
            unlisted: None,
        };
        for n in 0..count {
            let mut grid = Descriptor::read(cursor, &header)?;
            if header.has_offsets {
                cursor.skip(grid.end.saturating_sub(cursor.offset()), WHAT)?;
            } else if let Some(reason) = grid.kind.opaque().filter(|_| !grid.is_instance()) {
                list.unlisted = Some(format!(
                    "the file is a stream, in which {} grids behind \"{}\" cannot be found \
                     because that is {reason}",
                    count - n - 1,
                    grid.unique_name()
                ));
                list.grids.push(grid);
                break;
            } else {
                contents(cursor, &header, &grid)?;
                grid.end = cursor.offset();
            }
            list.grids.push(grid);
        }
        Ok(list)
    }

    /// All grids that could be listed.
    #[cfg(feature = "vdb-rs")]
    pub(super) fn all(&self) -> &[Descriptor] {
        &self.grids
    }

    /// Name and kind of each grid, for people.
    pub(super) fn list(&self) -> String {
        let names = self.grids.iter().take(MOST_NAMES);
        let mut names: Vec<_> = names
            .map(|grid| format!("{} ({})", grid.unique_name(), grid.kind.short()))
            .collect();
        if let Some(more @ 1..) = self.grids.len().checked_sub(MOST_NAMES) {
            names.push(format!("and {more} more"));
        }
        names.join(", ")
    }

    /// Why the list may be short.
    pub(super) fn unlisted(&self) -> Option<&str> {
        self.unlisted.as_deref()
    }

    /// An error that ends with the list.
    fn refused(&self, message: String) -> Error {
        let behind = self.unlisted.iter().map(|reason| format!("; {reason}"));
        Error::unsupported(
            self.file.name(),
            std::iter::once(message).chain(behind).collect::<String>(),
        )
    }

    /// The grid called `asked` (or of that number), or the only one that is read.
    pub(super) fn choose(&self, asked: Option<&str>) -> Result<&Descriptor, Error> {
        let Some(asked) = asked else {
            return self.only();
        };
        let by_unique_name = self.grids.iter().find(|grid| grid.unique_name() == asked);
        let mut by_name = self.grids.iter().filter(|grid| grid.name() == asked);
        let by_number = || asked.parse().ok().and_then(|n: usize| self.grids.get(n));
        let found = match (by_unique_name, by_name.next(), by_name.next()) {
            (Some(grid), _, _) | (None, Some(grid), None) => grid,
            (None, Some(_), Some(_)) => {
                return Err(self.refused(format!(
                    "has several grids called {asked:?}: {}; choose one with --dataset NAME[N]",
                    self.list()
                )));
            }
            _ => by_number().ok_or_else(|| {
                self.refused(format!(
                    "has no grid {asked:?}; there are {}: {}",
                    self.grids.len(),
                    self.list()
                ))
            })?,
        };
        match found.kind.refusal() {
            None => Ok(found),
            Some(reason) => Err(Error::unsupported(
                self.file.name(),
                format!("the grid \"{}\" is {reason}", found.unique_name()),
            )),
        }
    }

    fn only(&self) -> Result<&Descriptor, Error> {
        let mut readable = self.grids.iter().filter(|g| g.kind.refusal().is_none());
        match (readable.next(), readable.next()) {
            // Behind what cannot be walked over there may be others.
            (Some(grid), None) if self.unlisted.is_none() => Ok(grid),
            (Some(_), _) => Err(self.refused(format!(
                "has several grids: {}; choose one with --dataset NAME",
                self.list()
            ))),
            (None, _) => Err(self.refused(match self.grids.first() {
                None => "has no grid".to_owned(),
                Some(grid) if self.grids.len() == 1 => format!(
                    "the only grid, \"{}\", is {}",
                    grid.unique_name(),
                    grid.kind.refusal().unwrap_or_default()
                ),
                Some(_) => format!(
                    "has no grid that is read: {}; grids of numbers, bool and mask with trees \
                     5_4_3 are",
                    self.list()
                ),
            })),
        }
    }

    /// Reads a grid.
    pub(super) fn load(&self, grid: &Descriptor) -> Result<Grid, Error> {
        let read = |grid: &Descriptor| {
            contents(&mut Cursor::new(self.file, grid.start), &self.header, grid)
        };
        let own = read(grid)?;
        let tree = match own.tree {
            Some(tree) => Some(tree),
            // What has the tree is no instance itself, so this ends.
            None => match self.grids.iter().find(|g| grid.shares_tree_of(g)) {
                Some(parent) if parent.kind == grid.kind => read(parent)?.tree,
                _ => None,
            },
        };
        let Some((layout, tree)) = tree else {
            return Err(Error::invalid(
                self.file.name(),
                format!(
                    "the grid \"{}\" shares the tree of \"{}\", but no grid of that name and kind \
                     has one",
                    grid.unique_name(),
                    grid.parent_name()
                ),
            )
            .at(grid.start));
        };
        Ok(Grid {
            metadata: own.metadata,
            transform: own.transform,
            layout,
            tree,
        })
    }
}

/// Reads a grid to its end.
fn contents(
    cursor: &mut Cursor<'_>,
    header: &FileHeader,
    grid: &Descriptor,
) -> Result<Contents, Error> {
    let compression = header.compression(cursor)?;
    let metadata = Metadata::read(cursor)?;
    // Old files have the transform between the nodes of the tree and the values of its leaves.
    let transform_first = header.version >= version::INSTANCES;
    let mut transform = None;
    if transform_first {
        transform = Some(transform::read(cursor, header.version)?);
    }
    let layout = Layout::new(&grid.kind, metadata.half, compression, header.version);
    let tree = match layout {
        Some(layout) if !grid.is_instance() => {
            let decoder = Decoder::new(layout, Value::default());
            let mut reader = TreeReader::new(cursor, decoder);
            let mut tree = reader.topology()?;
            if transform.is_none() {
                transform = Some(transform::read(reader.cursor(), header.version)?);
            }
            reader.locate_leaves(&mut tree)?;
            Some((layout, tree))
        }
        _ => None,
    };
    let Some(transform) = transform else {
        return Err(cursor.unsupported("an old grid whose transform cannot be found"));
    };
    Ok(Contents {
        metadata,
        transform,
        tree,
    })
}
