//! The arrays of a VTK file, and which of them is the volume.
//!
//! In: the text behind the geometry. Out: the array that is read, with the text at its first
//! value. Arrays before it are skipped; those after it are not known. Guaranteed: skipping takes
//! no memory, and as long as there are bytes.

use crate::error::Error;
use crate::header::{DType, VoxelType, voxel_count};
use crate::parsed::{Context, Encoding, Parsed};
use crate::vtk::Grid;
use crate::vtk::text::Text;

/// Type of the values of an array.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Number(VoxelType),
    /// A `long`, of 8 bytes on most machines and 4 on others.
    Long(VoxelType),
    Bit,
    Text,
}

impl Kind {
    fn of(word: &str) -> Option<Self> {
        Some(match word.to_ascii_lowercase().as_str() {
            "bit" => Self::Bit,
            "unsigned_char" => Self::Number(VoxelType::U8),
            "char" | "signed_char" => Self::Number(VoxelType::I8),
            "unsigned_short" => Self::Number(VoxelType::U16),
            "short" => Self::Number(VoxelType::I16),
            "unsigned_int" => Self::Number(VoxelType::U32),
            // VTK writes its ids as int, whatever they are in memory.
            "int" | "vtkidtype" => Self::Number(VoxelType::I32),
            "unsigned_long" => Self::Long(VoxelType::U64),
            "long" => Self::Long(VoxelType::I64),
            "vtktypeuint64" => Self::Number(VoxelType::U64),
            "vtktypeint64" => Self::Number(VoxelType::I64),
            "float" => Self::Number(VoxelType::F32),
            "double" => Self::Number(VoxelType::F64),
            "string" | "utf8_string" => Self::Text,
            _ => return None,
        })
    }

    /// Type and byte order as they are given; text becomes little-endian numbers.
    pub(super) fn dtype(self, binary: bool) -> DType {
        let voxel = match self {
            Self::Number(voxel) | Self::Long(voxel) => voxel,
            Self::Bit | Self::Text => VoxelType::Bool,
        };
        if binary && voxel.bytes() > 1 {
            DType::big(voxel)
        } else {
            DType::little(voxel)
        }
    }

    pub(super) fn encoding(self, binary: bool) -> Encoding {
        match self {
            _ if !binary => Encoding::Text,
            Self::Bit => Encoding::Bits,
            _ => Encoding::Raw,
        }
    }

    pub(super) fn is_long(self) -> bool {
        matches!(self, Self::Long(_))
    }
}

/// Takes 4 bytes for a `long` where the file has no 8 for each.
pub(super) fn long_or_short(parsed: &mut Parsed, context: &Context<'_>) {
    let bytes = parsed.header.voxels_bytes();
    let (Some(length), Some(bytes)) = (context.length, bytes) else {
        return;
    };
    let available = length.saturating_sub(parsed.offset);
    if available >= bytes || available < bytes / 2 {
        return;
    }
    parsed.header.voxel = match parsed.header.voxel {
        VoxelType::U64 => VoxelType::U32,
        _ => VoxelType::I32,
    };
    parsed.header.warnings.push(format!(
        "{}: the type is long, and the file has 4 bytes for each value, not 8; 4 are read",
        context.name
    ));
}

/// The array that is read.
pub(super) struct Chosen {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// Whether the values lie in the cells, not at the points.
    pub(super) cells: bool,
}

/// An array as the file announces it.
struct Array {
    name: String,
    kind: Kind,
    components: u64,
    tuples: u64,
}

/// What is known of the arrays so far.
struct Search<'a> {
    wanted: Option<&'a str>,
    /// Names, and numbers of components, of the arrays that were passed.
    passed: Vec<(String, u64)>,
    /// Values one array has in the present part of the file.
    values: u64,
    cells: bool,
}

impl Search<'_> {
    /// Takes the array, or skips it. `preferred` is taken where the caller names none.
    fn take(
        &mut self,
        array: Array,
        preferred: bool,
        text: &mut Text<'_>,
        binary: bool,
    ) -> Result<Option<Chosen>, Error> {
        let taken = match self.wanted {
            Some(wanted) => array.name == wanted,
            None => preferred,
        };
        if !taken {
            skip_values(text, &array, binary)?;
            self.passed.push((array.name, array.components));
            return Ok(None);
        }
        let Array {
            name,
            kind,
            components,
            tuples,
        } = array;
        if components != 1 {
            return Err(text.unsupported(format!(
                "the array '{name}' has {components} components, 1 expected; --dataset NAME \
                 chooses another array"
            )));
        }
        if kind == Kind::Text {
            return Err(text.unsupported(format!("the array '{name}' holds text, not numbers")));
        }
        if tuples != self.values {
            return Err(text.invalid(format!(
                "the array '{name}' has {tuples} values, {} expected",
                self.values
            )));
        }
        Ok(Some(Chosen {
            name,
            kind,
            cells: self.cells,
        }))
    }

    /// The error of a search that found nothing.
    fn failed(&self, text: &Text<'_>) -> Error {
        const MOST_NAMES: usize = 30;
        let name = text.context.name;
        let mut names: Vec<_> = self
            .passed
            .iter()
            .take(MOST_NAMES)
            .map(|(name, components)| match components {
                1 => name.clone(),
                n => format!("{name} ({n} components)"),
            })
            .collect();
        if self.passed.len() > MOST_NAMES {
            names.push(format!("{} others", self.passed.len() - MOST_NAMES));
        }
        let names = names.join(", ");
        match self.wanted {
            _ if names.is_empty() => Error::invalid(name, "the data set has no array of values"),
            Some(wanted) => Error::unsupported(
                name,
                format!("there is no array '{wanted}'; there are: {names}"),
            ),
            None if self.passed.len() == 1 => Error::unsupported(
                name,
                format!("the only array is no volume of single numbers: {names}"),
            ),
            None => Error::unsupported(
                name,
                format!("has several arrays: {names}; choose one with --dataset NAME"),
            ),
        }
    }
}

/// Finds the array to be read.
pub(super) fn choose(text: &mut Text<'_>, grid: &Grid, binary: bool) -> Result<Chosen, Error> {
    let context = text.context;
    let mut search = Search {
        wanted: context.options.dataset.as_deref(),
        passed: Vec::new(),
        values: 0,
        cells: false,
    };
    while let Some(word) = text.next_word()? {
        let keyword = word.to_ascii_uppercase();
        let found = match keyword.as_str() {
            "POINT_DATA" | "CELL_DATA" => {
                search.cells = keyword == "CELL_DATA";
                search.values = values(text, grid, search.cells)?;
                None
            }
            "METADATA" => {
                text.skip_metadata()?;
                None
            }
            "LOOKUP_TABLE" => {
                let name = text.word()?;
                let table = Array {
                    name,
                    kind: Kind::Number(VoxelType::U8),
                    components: 4,
                    tuples: text.count()?,
                };
                text.line()?;
                skip_values(text, &table, binary)?;
                None
            }
            "FIELD" => field(text, binary, Some(&mut search))?,
            _ => {
                let Some(array) = attribute(&keyword, search.values, text, binary)? else {
                    return Err(text.invalid(format!("'{word}' is no keyword of arrays")));
                };
                search.take(array, keyword == "SCALARS", text, binary)?
            }
        };
        if let Some(chosen) = found {
            return Ok(chosen);
        }
    }
    Err(search.failed(text))
}

/// Number of values of each array that follows, which must be that of the grid.
fn values(text: &mut Text<'_>, grid: &Grid, cells: bool) -> Result<u64, Error> {
    let (what, expected) = if cells {
        ("CELL_DATA", grid.cells())
    } else {
        ("POINT_DATA", grid.points)
    };
    let found = text.count()?;
    if voxel_count(expected) == Some(found) {
        return Ok(found);
    }
    let [x, y, z] = expected;
    Err(text.invalid(format!(
        "{what} is {found}, but the grid has {x} x {y} x {z} values"
    )))
}

/// An attribute: one array with a keyword of its own. `None` for other keywords.
fn attribute(
    keyword: &str,
    tuples: u64,
    text: &mut Text<'_>,
    binary: bool,
) -> Result<Option<Array>, Error> {
    let components = match keyword {
        "SCALARS" | "COLOR_SCALARS" | "TEXTURE_COORDINATES" => 0,
        "GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS" => 1,
        "VECTORS" | "NORMALS" => 3,
        "TENSORS6" => 6,
        "TENSORS" => 9,
        _ => return Ok(None),
    };
    let mut array = Array {
        name: name(text)?,
        kind: Kind::Number(VoxelType::U8),
        components,
        tuples,
    };
    match keyword {
        "COLOR_SCALARS" => array.components = text.count()?,
        "TEXTURE_COORDINATES" => {
            array.components = text.count()?;
            array.kind = kind(text)?;
        }
        _ => array.kind = kind(text)?,
    }
    let rest = text.line()?;
    if keyword == "SCALARS" {
        array.components = match rest.trim() {
            "" => 1,
            number => number.parse().map_err(|_| {
                text.invalid(format!("'{number}' found, a number of components expected"))
            })?,
        };
        // Without it the values follow. In binary they may look like white space.
        if !binary {
            text.skip_space()?;
        }
        if text.is_next("LOOKUP_TABLE")? {
            text.line()?;
        }
    }
    Ok(Some(array))
}

/// A field: a number of arrays, each with a line of its own.
fn field(
    text: &mut Text<'_>,
    binary: bool,
    mut search: Option<&mut Search<'_>>,
) -> Result<Option<Chosen>, Error> {
    text.word()?;
    let count = text.count()?;
    let mut done = 0;
    while done < count {
        let name = name(text)?;
        match name.as_str() {
            "METADATA" => {
                text.skip_metadata()?;
                continue;
            }
            "NULL_ARRAY" => {
                done += 1;
                continue;
            }
            _ => {}
        }
        let array = Array {
            name,
            components: text.count()?,
            tuples: text.count()?,
            kind: kind(text)?,
        };
        text.line()?;
        done += 1;
        match &mut search {
            Some(search) => {
                let only = count == 1 && search.passed.is_empty() && array.components == 1;
                if let Some(chosen) = search.take(array, only, text, binary)? {
                    return Ok(Some(chosen));
                }
            }
            None => skip_values(text, &array, binary)?,
        }
    }
    Ok(None)
}

/// Skips a field that belongs to the data set as a whole.
pub(super) fn skip_field(text: &mut Text<'_>, binary: bool) -> Result<(), Error> {
    field(text, binary, None).map(|_| ())
}

fn kind(text: &mut Text<'_>) -> Result<Kind, Error> {
    let word = text.word()?;
    Kind::of(&word)
        .ok_or_else(|| text.unsupported(format!("arrays of the type '{word}' are not read")))
}

/// The name of an array, in which VTK writes white space and the like as %20.
fn name(text: &mut Text<'_>) -> Result<String, Error> {
    let word = text.word()?;
    let mut bytes = Vec::with_capacity(word.len());
    let mut rest = word.as_bytes();
    while let [first, others @ ..] = rest {
        let code = others
            .get(..2)
            .filter(|_| *first == b'%')
            .and_then(|code| std::str::from_utf8(code).ok())
            .and_then(|code| u8::from_str_radix(code, 16).ok());
        match code {
            Some(code) => {
                bytes.push(code);
                rest = &others[2..];
            }
            None => {
                bytes.push(*first);
                rest = others;
            }
        }
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn skip_values(text: &mut Text<'_>, array: &Array, binary: bool) -> Result<(), Error> {
    let Some(count) = array.components.checked_mul(array.tuples) else {
        return Err(text.invalid(format!(
            "the array '{}' has {} x {} values, which no file holds",
            array.name, array.tuples, array.components
        )));
    };
    match (array.kind, binary) {
        (Kind::Text, true) => (0..count).try_for_each(|_| text.skip_string()),
        (Kind::Text, false) => (0..count).try_for_each(|_| text.line().map(|_| ())),
        (_, false) => text.skip_words(count),
        (Kind::Bit, true) => text.skip(count.div_ceil(8)),
        (Kind::Number(voxel) | Kind::Long(voxel), true) => {
            text.skip(count.saturating_mul(voxel.bytes() as u64))
        }
    }
}
