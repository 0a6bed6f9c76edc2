//! Which axes of a NRRD array are space.
//!
//! In: sizes, kinds and directions of all axes, fastest first. Out: the three axes of the volume, and
//! how many volumes follow each other. An axis is of space if its kind says so (`domain`, `space`) or if
//! it has a space direction; axes nobody says anything about are, up to the third. Other axes may have one
//! sample, wherever they are. Those with more must be slower than the three, and are of times or of a
//! list; anything else, such as the colours or vectors of a voxel, is refused by the name of its kind.

use crate::error::Error;

use super::fields::Fields;

/// The most axes of an array, as in the library that defines the format.
const AXES_MOST: usize = 16;

/// The axes of the volume.
#[derive(Debug)]
pub(super) struct Axes {
    /// Number of all axes.
    pub(super) count: usize,
    /// The axes x, y, z among them.
    pub(super) space: [usize; 3],
    /// Their extents.
    pub(super) dims: [u64; 3],
    /// Sizes of all axes.
    pub(super) sizes: Vec<u64>,
    /// Volumes, one behind the other.
    pub(super) frames: u64,
    /// Directions of all axes, where the header has any; with three components.
    pub(super) directions: Option<Vec<Option<[f64; 3]>>>,
}

/// What is known of an axis.
#[derive(Clone, Debug, PartialEq)]
enum Role {
    Space,
    Unknown,
    /// Not space, but what this says.
    Other(String),
}

impl Axes {
    pub(super) fn read(
        fields: &Fields,
        warnings: &mut Vec<String>,
        file: &str,
    ) -> Result<Self, Error> {
        let dimension = fields.need("dimension", file)?;
        let count: usize = dimension.number(file, "a number from 1 to 16")?;
        if !(1..=AXES_MOST).contains(&count) {
            return Err(dimension.wrong(file, "a number from 1 to 16"));
        }
        if count < 3 {
            return Err(Error::unsupported(
                file,
                format!("dimension is {count}: an array of {count} axes; 3 of space expected"),
            )
            .at(dimension.at));
        }
        let sizes_field = fields.need("sizes", file)?;
        let expected = format!("{count} numbers of at least 1");
        let sizes: Result<Vec<u64>, _> = sizes_field
            .value
            .split_whitespace()
            .map(str::parse)
            .collect();
        let sizes = sizes
            .ok()
            .filter(|sizes| sizes.len() == count && !sizes.contains(&0))
            .ok_or_else(|| sizes_field.wrong(file, &expected))?;

        let directions = directions(fields, count, file)?;
        let mut roles = kinds(fields, count, warnings, file)?;
        for (axis, role) in roles.iter_mut().enumerate() {
            match directions.as_ref().map(|all| &all[axis]) {
                Some(Direction::None) if !matches!(role, Role::Other(_)) => {
                    *role = Role::Other("without a direction".into());
                }
                Some(Direction::Time) => *role = Role::Other("time".into()),
                Some(Direction::Space(_)) if *role == Role::Unknown => *role = Role::Space,
                _ => {}
            }
        }
        let space = space(&mut roles, &sizes, file)?;
        let mut frames = 1_u64;
        for (axis, role) in roles.iter().enumerate() {
            let Role::Other(kind) = role else { continue };
            if sizes[axis] == 1 {
                continue;
            }
            check_frames(axis, kind, sizes[axis], space[2], file)?;
            frames = frames
                .checked_mul(sizes[axis])
                .ok_or_else(|| sizes_field.wrong(file, "sizes of a file that can be"))?;
        }
        let directions = directions.map(|all| {
            let vector = |direction| match direction {
                Direction::Space(vector) => Some(vector),
                _ => None,
            };
            all.into_iter().map(vector).collect()
        });
        Ok(Self {
            count,
            space,
            dims: space.map(|axis| sizes[axis]),
            sizes,
            frames,
            directions,
        })
    }
}

/// What `kinds` says of each axis.
fn kinds(
    fields: &Fields,
    count: usize,
    warnings: &mut Vec<String>,
    file: &str,
) -> Result<Vec<Role>, Error> {
    let Some(field) = fields.find("kinds") else {
        return Ok(vec![Role::Unknown; count]);
    };
    let roles = field.texts(count, file)?.into_iter().map(|kind| {
        let word = kind.to_ascii_lowercase();
        if matches!(word.as_str(), "domain" | "space") {
            return Role::Space;
        }
        if matches!(word.as_str(), "" | "none" | "???") {
            return Role::Unknown;
        }
        if is_range_kind(&word) {
            return Role::Other(kind);
        }
        warnings.push(format!(
            "{file}: the kind '{kind}' of an axis is not known; it is ignored"
        ));
        Role::Unknown
    });
    Ok(roles.collect())
}

/// Whether a kind (in lower case) is one of the specification that is not of space.
fn is_range_kind(word: &str) -> bool {
    const WORDS: [&str; 10] = [
        "time",
        "list",
        "point",
        "vector",
        "normal",
        "stub",
        "scalar",
        "complex",
        "quaternion",
        "gradient",
    ];
    // RGB-color, 3D-masked-symmetric-matrix, covariant-vector and their like.
    const ENDINGS: [&str; 8] = [
        "color", "vector", "gradient", "normal", "matrix", "tensor", "rgb", "rgba",
    ];
    WORDS.contains(&word) || word == "hsv" || ENDINGS.iter().any(|ending| word.ends_with(ending))
}

/// The direction of one axis.
enum Direction {
    None,
    Time,
    Space([f64; 3]),
}

fn directions(fields: &Fields, count: usize, file: &str) -> Result<Option<Vec<Direction>>, Error> {
    let Some(field) = fields.find("space directions") else {
        return Ok(None);
    };
    let vectors = field.vectors(file)?;
    if vectors.len() != count {
        return Err(field.wrong(file, &format!("{count} vectors")));
    }
    let time = has_time(fields);
    let directions: Result<_, _> = vectors
        .into_iter()
        .map(|vector| match vector.as_deref() {
            None => Ok(Direction::None),
            Some(v) if v.iter().all(|x| x.is_nan()) => Ok(Direction::None),
            Some([x, y, z]) if !time => Ok(Direction::Space([*x, *y, *z])),
            Some([x, y, z, t]) if time && *t == 0.0 => Ok(Direction::Space([*x, *y, *z])),
            Some([x, y, z, _]) if time && [*x, *y, *z] == [0.0; 3] => Ok(Direction::Time),
            Some(_) if time => {
                Err(field.wrong(file, "vectors of four numbers, either of space or of time,"))
            }
            Some(_) => Err(field.wrong(file, "vectors of three numbers")),
        })
        .collect();
    Ok(Some(directions?))
}

/// Whether the space of the header has time as its fourth axis.
pub(super) fn has_time(fields: &Fields) -> bool {
    fields.find("space").is_some_and(|space| {
        let space = space.value.to_ascii_lowercase();
        space.ends_with("time")
            || matches!(space.as_str(), "rast" | "last" | "lpst" | "scanner-xyzt")
    })
}

/// The three axes of space. Those that are too many become something else.
fn space(roles: &mut [Role], sizes: &[u64], file: &str) -> Result<[usize; 3], Error> {
    let mut axes: Vec<usize> = (0..roles.len())
        .filter(|axis| !matches!(roles[*axis], Role::Other(_)))
        .collect();
    while axes.len() > 3 {
        // A first axis of one sample is a stub that nobody named.
        let at = if sizes[axes[0]] == 1 {
            0
        } else {
            axes.len() - 1
        };
        let axis = axes.remove(at);
        roles[axis] = Role::Other(match roles[axis] {
            Role::Space => "domain".into(),
            _ => "unknown".into(),
        });
    }
    axes.as_slice().try_into().map_err(|_| {
        let others: Vec<_> = roles
            .iter()
            .enumerate()
            .filter_map(|(axis, role)| match role {
                Role::Other(kind) => Some(format!("axis {axis} is {kind}")),
                _ => None,
            })
            .collect();
        Error::unsupported(
            file,
            format!(
                "an array of {} axes, of which {} are of space ({}); 3 of space expected",
                roles.len(),
                axes.len(),
                others.join(", ")
            ),
        )
    })
}

/// Whether an axis can count volumes.
fn check_frames(axis: usize, kind: &str, size: u64, last: usize, file: &str) -> Result<(), Error> {
    let word = kind.to_ascii_lowercase();
    let countable = matches!(
        word.as_str(),
        "time" | "list" | "domain" | "unknown" | "stub" | "scalar" | "without a direction"
    );
    if axis > last && countable {
        return Ok(());
    }
    let why = if countable {
        "volumes must be stored one after the other, so only the slowest axes can count them"
    } else {
        "voxels of several values are not read"
    };
    Err(Error::unsupported(
        file,
        format!("axis {axis} has {size} samples and is {kind}, not of space: {why}"),
    ))
}
