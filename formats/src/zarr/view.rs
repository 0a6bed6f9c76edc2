//! Three axes out of an array of any number.
//!
//! In: an array, the names of its axes where these are known, and the choice of a frame and a
//! channel. Out: which axis is x, y and z, and where the others stand. Axes with these names may
//! stand in any order; without them the last three axes are z, y, x. Of the others, t (or time) is
//! chosen as the frame, c (or channel) as the channel, and the rest must have one entry.

use crate::error::Error;
use crate::options::OpenOptions;
use crate::zarr::array::{Array, shape_text};

/// Where a volume lies in an array.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct View {
    /// The axes of the array that are x, y and z.
    pub(crate) axes: [usize; 3],
    /// The other axes, and the one entry taken of each.
    pub(crate) fixed: Vec<(usize, u64)>,
}

impl View {
    pub(crate) fn new(
        name: &str,
        array: &Array,
        axes: Option<&[String]>,
        options: &OpenOptions,
    ) -> Result<Self, Error> {
        let names = axes.unwrap_or(&[]);
        let count = array.shape.len();
        let xyz = match spatial(names) {
            Some(xyz) => xyz,
            None if count >= 3 => {
                // A series of images in time is no volume.
                let last = names.get(count - 3..).unwrap_or_default();
                if let Some(other) = last.iter().find(|name| further(name).is_some()) {
                    return Err(Error::unsupported(
                        name,
                        format!(
                            "the axes are {}: '{other}' is none of x, y and z",
                            names.join(", ")
                        ),
                    ));
                }
                [count - 1, count - 2, count - 3]
            }
            None => {
                return Err(Error::unsupported(
                    name,
                    format!(
                        "an array of {} axes ({}); a volume has three",
                        count,
                        shape_text(&array.shape)
                    ),
                ));
            }
        };
        let mut fixed = Vec::new();
        let mut asked = [("frame", options.frame), ("channel", options.channel)];
        for axis in (0..count).filter(|axis| !xyz.contains(axis)) {
            let extent = array.shape[axis];
            let label = names.get(axis).map(String::as_str);
            let entry = match label.and_then(further) {
                Some(which) => entry(name, asked[which].0, asked[which].1.take(), extent)?,
                None if extent == 1 => 0,
                None => {
                    let what = label.map_or_else(
                        || format!("axis {axis}, which has no name,"),
                        |label| format!("axis '{label}'"),
                    );
                    return Err(Error::unsupported(
                        name,
                        format!(
                            "an array of {}: {what} has {extent} entries; a volume has the axes \
                             z, y, x, and t and c if named so",
                            shape_text(&array.shape)
                        ),
                    ));
                }
            };
            fixed.push((axis, entry));
        }
        for (what, wanted) in asked {
            if let Some(wanted) = wanted.filter(|wanted| *wanted > 0) {
                return Err(Error::unsupported(
                    name,
                    format!("{what} {wanted} was asked for, but the array has no axis of {what}s"),
                ));
            }
        }
        Ok(Self { axes: xyz, fixed })
    }

    /// Extents along x, y, z.
    pub(crate) fn pick(&self, extents: &[u64]) -> [u64; 3] {
        self.axes.map(|axis| extents[axis])
    }
}

/// Whether an axis of that name is one of frames (0) or channels (1).
fn further(name: &str) -> Option<usize> {
    match name.to_ascii_lowercase().as_str() {
        "t" | "time" => Some(0),
        "c" | "channel" => Some(1),
        _ => None,
    }
}

/// The axes called x, y and z.
fn spatial(names: &[String]) -> Option<[usize; 3]> {
    let find = |wanted: &str| {
        let mut places = (0..names.len()).filter(|i| names[*i].eq_ignore_ascii_case(wanted));
        places.next().filter(|_| places.next().is_none())
    };
    Some([find("x")?, find("y")?, find("z")?])
}

/// The entry chosen of an axis of frames or channels.
fn entry(name: &str, what: &str, wanted: Option<u64>, extent: u64) -> Result<u64, Error> {
    match wanted {
        None if extent == 1 => Ok(0),
        None => Err(Error::unsupported(
            name,
            format!(
                "has {extent} {what}s; choose one with --{what} 0 to {}",
                extent.max(1) - 1
            ),
        )),
        Some(wanted) if wanted < extent => Ok(wanted),
        Some(wanted) => Err(Error::unsupported(
            name,
            format!("{what} {wanted} was asked for, but there are {extent}, counted from 0"),
        )),
    }
}
