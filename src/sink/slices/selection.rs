//! Which slices of the image are drawn, as written on the command line.

use std::fmt;
use std::str::FromStr;

/// Slices across one axis: `z=10,20`, `every:8`, `x=all`, `3..40`.
///
/// `AXIS=` is x, y or z and may be left out for z. After it comes `all`, `every:N` (0, N, 2N, …),
/// or a list of indices and ranges: `A..B` stops before B, `A..=B` includes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SliceSelection {
    axis: usize,
    choice: Choice,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Choice {
    Every(u32),
    /// Ranges that include their ends, as written, in the order written.
    Ranges(Vec<(u32, u32)>),
}

/// Text that names no slices.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("slices {text:?}: {reason}; examples: z=10,20  every:8  x=all  3..40")]
pub struct SliceError {
    text: String,
    reason: String,
}

impl FromStr for SliceSelection {
    type Err = SliceError;

    fn from_str(text: &str) -> Result<Self, SliceError> {
        let fail = |reason: String| SliceError {
            text: text.to_owned(),
            reason,
        };
        // `..=` has an equals sign of its own.
        let equals = text.find('=').filter(|&at| !text[..at].ends_with(".."));
        let (axis, choice) = match equals {
            None => (2, text),
            Some(at) => {
                let axis = match text[..at].trim() {
                    "x" => 0,
                    "y" => 1,
                    "z" => 2,
                    other => return Err(fail(format!("found axis {other:?}, expected x, y or z"))),
                };
                (axis, &text[at + 1..])
            }
        };
        let choice = choice.trim();
        let choice = if choice == "all" {
            Choice::Every(1)
        } else if let Some(step) = choice.strip_prefix("every:") {
            match step.parse() {
                Ok(step) if step > 0 => Choice::Every(step),
                _ => {
                    return Err(fail(format!(
                        "found step {step:?}, expected a number from 1"
                    )));
                }
            }
        } else {
            let ranges: Result<_, _> = choice.split(',').map(|item| range(item.trim())).collect();
            Choice::Ranges(ranges.map_err(fail)?)
        };
        Ok(Self { axis, choice })
    }
}

/// Parses `A`, `A..B` or `A..=B`; gives the first and last index.
fn range(item: &str) -> Result<(u32, u32), String> {
    let number = |text: &str| {
        text.parse::<u32>()
            .map_err(|_| format!("found {text:?}, expected an index"))
    };
    let (first, last) = if let Some((first, last)) = item.split_once("..=") {
        (number(first)?, number(last)?)
    } else if let Some((first, end)) = item.split_once("..") {
        let last = number(end)?
            .checked_sub(1)
            .ok_or_else(|| format!("{item} is empty"))?;
        (number(first)?, last)
    } else {
        (number(item)?, number(item)?)
    };
    if first > last {
        Err(format!("{item} is empty"))
    } else {
        Ok((first, last))
    }
}

impl fmt::Display for SliceSelection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}=", self.axis_name())?;
        match &self.choice {
            Choice::Every(1) => f.write_str("all"),
            Choice::Every(step) => write!(f, "every:{step}"),
            Choice::Ranges(ranges) => {
                for (i, (first, last)) in ranges.iter().enumerate() {
                    let comma = if i > 0 { "," } else { "" };
                    match first == last {
                        true => write!(f, "{comma}{first}")?,
                        false => write!(f, "{comma}{first}..={last}")?,
                    }
                }
                Ok(())
            }
        }
    }
}

impl SliceSelection {
    /// The axis the slices are orthogonal to: 0, 1 or 2.
    #[must_use]
    pub fn axis(&self) -> usize {
        self.axis
    }

    /// The letter of the axis.
    #[must_use]
    pub fn axis_name(&self) -> char {
        ['x', 'y', 'z'][self.axis]
    }

    /// The chosen slices of an image, ascending, each once.
    ///
    /// # Errors
    ///
    /// If an index is beyond the image.
    pub fn indices(&self, dims: [u32; 3]) -> Result<Vec<u32>, SliceError> {
        let end = dims[self.axis];
        match &self.choice {
            Choice::Every(step) => Ok((0..end)
                .step_by(usize::try_from(*step).unwrap_or(usize::MAX))
                .collect()),
            Choice::Ranges(ranges) => {
                if let Some((_, last)) = ranges.iter().find(|(_, last)| *last >= end) {
                    let axis = self.axis_name();
                    return Err(SliceError {
                        text: self.to_string(),
                        reason: format!("found index {last}, expected below {end} ({axis})"),
                    });
                }
                let mut all: Vec<u32> = ranges.iter().flat_map(|&(a, b)| a..=b).collect();
                all.sort_unstable();
                all.dedup();
                Ok(all)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn indices(text: &str) -> Vec<u32> {
        text.parse::<SliceSelection>()
            .unwrap()
            .indices([5, 6, 30])
            .unwrap()
    }

    #[test]
    fn selections_name_their_slices() {
        assert_eq!(indices("z=10,20"), [10, 20]);
        assert_eq!(indices("every:8"), [0, 8, 16, 24]);
        assert_eq!(indices("x=all"), [0, 1, 2, 3, 4]);
        assert_eq!(indices("3..6"), [3, 4, 5]);
        assert_eq!(indices("3..=6"), [3, 4, 5, 6]);
        assert_eq!(indices("y=5,0..2,1"), [0, 1, 5]);
    }

    #[test]
    fn text_that_names_no_slices_is_an_error() {
        for text in [
            "", "w=1", "every:0", "every:x", "5..5", "..", "7..2", "1,,2", "-1", "z=", "0..0",
        ] {
            assert!(text.parse::<SliceSelection>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn index_beyond_the_image_is_an_error_that_names_the_limit() {
        let error = "z=30"
            .parse::<SliceSelection>()
            .unwrap()
            .indices([5, 6, 30])
            .unwrap_err();
        assert!(
            error
                .to_string()
                .contains("found index 30, expected below 30"),
            "{error}"
        );
    }

    #[test]
    fn selection_reads_back_what_it_writes() {
        for text in ["z=all", "x=every:3", "y=1,4..=9,12"] {
            assert_eq!(text.parse::<SliceSelection>().unwrap().to_string(), text);
        }
    }
}
