//! Lengths with a unit, as typed: `3vx`, `12um`, `0.8mm`.
//!
//! `vx` is the **longest edge of a voxel**: for cubic voxels the voxel itself. A bare number is an
//! error, because it could mean voxels or world units, and the result would be wrong by the ratio.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use curvox_formats::Unit;

use super::exit::{Usage, usage};

/// A length as typed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Length {
    number: f64,
    /// `None` for `vx`.
    unit: Option<Unit>,
    label: String,
}

/// Cuts a text where its number ends: `0.8mm` into `0.8` and `mm`.
fn split_unit(text: &str) -> (&str, &str) {
    let is_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | '+' | '-');
    let mut end = text.find(|c| !is_number(c)).unwrap_or(text.len());
    // An exponent: e or E with digits behind.
    let rest = &text[end..];
    if let Some(exponent) = rest.strip_prefix(['e', 'E']) {
        let digits = exponent.trim_start_matches(['+', '-']);
        let count = digits.bytes().take_while(u8::is_ascii_digit).count();
        if count > 0 {
            end += 1 + (exponent.len() - digits.len()) + count;
        }
    }
    (text[..end].trim(), text[end..].trim())
}

const UNITS: &str = "vx (voxels), nm, um, mm, cm, m or A";

impl FromStr for Length {
    type Err = Usage;

    fn from_str(text: &str) -> Result<Self, Usage> {
        let (digits, suffix) = split_unit(text.trim());
        let number: f64 = digits.parse().map_err(|_| {
            Usage(format!(
                "'{text}' is not a length; write a number and a unit: 3vx, 12um, 0.8mm"
            ))
        })?;
        if suffix.is_empty() {
            return Err(Usage(format!(
                "a bare number could mean voxels or world units; \
                 write {digits}vx for {digits} voxels, or {digits}um, {digits}mm, ... \
                 for a length in the world"
            )));
        }
        let unit = if suffix == "vx" {
            None
        } else {
            let unit = suffix
                .parse::<Unit>()
                .map_err(|_| Usage(format!("'{suffix}' is not a unit, expected {UNITS}")))?;
            if unit == Unit::Unknown {
                return Err(Usage(format!("'{suffix}' is not a unit, expected {UNITS}")));
            }
            Some(unit)
        };
        if !(number > 0.0 && number.is_finite()) {
            return Err(Usage(format!("'{text}' is not a length above 0")));
        }
        let label = format!("{digits}{}", unit.map_or("vx", Unit::symbol));
        Ok(Self {
            number,
            unit,
            label,
        })
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.label)
    }
}

impl Length {
    /// So many voxels, for defaults.
    pub(crate) fn voxels(number: f64) -> Self {
        Self {
            number,
            unit: None,
            label: format!("{number}vx"),
        }
    }

    /// So many times as long.
    pub(crate) fn times(&self, factor: f64) -> Self {
        // without the noise of the last digits
        let number = self.number * factor;
        let number = format!("{number:.11e}").parse().unwrap_or(number);
        let unit = self
            .unit
            .map_or_else(|| "vx".to_owned(), |unit| unit.to_string());
        Self {
            number,
            unit: self.unit,
            label: format!("{number}{unit}"),
        }
    }

    /// In voxel units, if it was typed in them.
    pub(crate) fn as_voxels(&self) -> Option<f64> {
        self.unit.is_none().then_some(self.number)
    }

    /// In voxel units, given the length of a voxel unit in the image's unit.
    ///
    /// # Errors
    /// If the length is in world units and the image's unit is not known.
    pub(crate) fn in_voxels(
        &self,
        flag: &str,
        voxel_unit_world: f64,
        world: Unit,
    ) -> anyhow::Result<f64> {
        let Some(unit) = self.unit else {
            return Ok(self.number);
        };
        match ratio(unit, world) {
            // Exact when the units are the same.
            Some(ratio) => Ok(self.number * ratio / voxel_unit_world),
            None => Err(usage(format!(
                "{flag} {self}: the image does not say the unit of its voxels, so a length in {unit} \
                 cannot be turned into voxels; write it in voxels (3vx), or give the voxel size with \
                 a unit (--spacing 0.5{unit})"
            ))),
        }
    }
}

/// How many of unit `to` one of unit `from` is; `None` if either is not known.
pub(crate) fn ratio(from: Unit, to: Unit) -> Option<f64> {
    let power = |unit: Unit| {
        Some(match unit {
            Unit::Metre => 0,
            Unit::Centimetre => -2,
            Unit::Millimetre => -3,
            Unit::Micrometre => -6,
            Unit::Nanometre => -9,
            Unit::Angstrom => -10,
            _ => return None,
        })
    };
    // Powers of ten up to 22 are exact, so one rounding at most.
    let difference: i32 = power(from)? - power(to)?;
    let ten = 10f64.powi(difference.abs());
    Some(if difference < 0 { 1.0 / ten } else { ten })
}

/// A voxel size as typed: `1,1,2um`, `0.5mm`, or `1,1,2` where the unit is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spacing {
    /// Edges along x, y, z.
    pub(crate) edges: [f64; 3],
    /// Their unit.
    pub(crate) unit: Unit,
}

impl FromStr for Spacing {
    type Err = Usage;

    fn from_str(text: &str) -> Result<Self, Usage> {
        let fail = |why: String| Usage(format!("'{text}' is not a voxel size: {why}"));
        let mut edges = Vec::new();
        let mut unit = Unit::Unknown;
        for (i, item) in text.split(',').enumerate() {
            let (digits, suffix) = split_unit(item.trim());
            let edge: f64 = digits
                .parse()
                .ok()
                .filter(|edge: &f64| *edge > 0.0 && edge.is_finite())
                .ok_or_else(|| {
                    fail(format!(
                        "found '{item}', expected lengths above 0 as in 1,1,2um"
                    ))
                })?;
            edges.push(edge);
            if suffix.is_empty() {
                if unit != Unit::Unknown {
                    return Err(fail(
                        "write the unit once, at the end, as in 1,1,2um".into(),
                    ));
                }
                continue;
            }
            let found: Unit = suffix.parse().map_err(|_| {
                fail(format!(
                    "'{suffix}' is not a unit, expected nm, um, mm, cm, m or A"
                ))
            })?;
            if i > 0 && unit != Unit::Unknown && unit != found {
                return Err(fail(format!("it mixes {unit} and {found}")));
            }
            unit = found;
        }
        let edges = match edges[..] {
            [edge] => [edge; 3],
            [x, y, z] => [x, y, z],
            _ => {
                return Err(fail(format!(
                    "found {} numbers, expected 1 or 3",
                    edges.len()
                )));
            }
        };
        Ok(Self { edges, unit })
    }
}

/// Three whole numbers above 0, as typed: `512,512,300`.
pub(crate) fn dims(text: &str) -> Result<[u64; 3], Usage> {
    let numbers: Vec<u64> = text
        .split([',', 'x'])
        .map_while(|n| n.trim().parse().ok().filter(|&n| n > 0))
        .collect();
    match numbers[..] {
        [x, y, z] if text.split([',', 'x']).count() == 3 => Ok([x, y, z]),
        _ => Err(Usage(format!(
            "'{text}' is not three numbers of voxels X,Y,Z, as in 512,512,300"
        ))),
    }
}

/// A box of voxels in the indices of a file; ends are not included.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct IndexBox(pub(crate) [Range<i64>; 3]);

/// A box `X0:X1,Y0:Y1,Z0:Z1`.
pub(crate) fn region(text: &str) -> Result<IndexBox, Usage> {
    let ranges: Vec<Range<i64>> = text
        .split(',')
        .map_while(|range| {
            let (start, end) = range.split_once(':')?;
            let (start, end) = (start.trim().parse().ok()?, end.trim().parse().ok()?);
            (start < end).then_some(start..end)
        })
        .collect();
    match <[Range<i64>; 3]>::try_from(ranges) {
        Ok(ranges) if text.split(',').count() == 3 => Ok(IndexBox(ranges)),
        _ => Err(Usage(format!(
            "'{text}' is not a box X0:X1,Y0:Y1,Z0:Z1 with each start below its end, as in \
             0:512,100:300,20:80"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_is_three_ranges_that_are_not_empty() {
        assert_eq!(
            region("0:64, 10:74,-5:20").unwrap(),
            IndexBox([0..64, 10..74, -5..20])
        );
        for wrong in [
            "",
            "0:1,0:1",
            "0:1,0:1,0:1,0:1",
            "0:1,0:1,1:1",
            "0:1,a:2,0:1",
            "1,2,3",
        ] {
            assert!(region(wrong).is_err(), "{wrong}");
        }
    }

    fn length(text: &str) -> Length {
        text.parse().unwrap()
    }

    #[test]
    fn a_bare_number_is_an_error_that_shows_both_ways() {
        let message = "3".parse::<Length>().unwrap_err().to_string();
        assert!(
            message.contains("3vx") && message.contains("3um"),
            "{message}"
        );
        for bad in [
            "",
            "vx",
            "3 parsecs",
            "-1vx",
            "0vx",
            "nanvx",
            "1e400mm",
            "3unknown",
            "infum",
        ] {
            assert!(bad.parse::<Length>().is_err(), "{bad}");
        }
    }

    #[test]
    fn lengths_convert_between_units() {
        // voxels of 0.05 mm, radius of 150 um: 3 voxels
        let voxels =
            |text: &str, edge, unit| length(text).in_voxels("--radius", edge, unit).unwrap();
        assert!((voxels("150um", 0.05, Unit::Millimetre) - 3.0).abs() < 1e-12);
        assert!((voxels("0.15mm", 50.0, Unit::Micrometre) - 3.0).abs() < 1e-12);
        assert!((voxels("30A", 1.0, Unit::Nanometre) - 3.0).abs() < 1e-12);
        assert!((voxels("1.5e-1mm", 0.05, Unit::Millimetre) - 3.0).abs() < 1e-12);
        assert_eq!(voxels("3vx", 0.05, Unit::Unknown), 3.0);
        assert_eq!(voxels("12\u{b5}m", 1.0, Unit::Micrometre), 12.0);
        let error = length("12um")
            .in_voxels("--radius", 1.0, Unit::Unknown)
            .unwrap_err();
        assert!(error.to_string().contains("--spacing"), "{error}");
    }

    #[test]
    fn labels_are_as_typed_with_plain_symbols() {
        assert_eq!(length("12\u{3bc}m").to_string(), "12um");
        assert_eq!(length(" 2.50 vx").to_string(), "2.50vx");
        assert_eq!(Length::voxels(3.0), length("3vx"));
    }

    #[test]
    fn spacings_have_one_or_three_edges_and_one_unit() {
        let spacing = |text: &str| text.parse::<Spacing>().map(|s| (s.edges, s.unit));
        assert_eq!(
            spacing("1,1,2um").unwrap(),
            ([1.0, 1.0, 2.0], Unit::Micrometre)
        );
        assert_eq!(
            spacing("1um,1um,2um").unwrap(),
            ([1.0, 1.0, 2.0], Unit::Micrometre)
        );
        assert_eq!(spacing("0.5mm").unwrap(), ([0.5; 3], Unit::Millimetre));
        assert_eq!(spacing("1,1,2").unwrap(), ([1.0, 1.0, 2.0], Unit::Unknown));
        for bad in [
            "",
            "1,2",
            "1um,1,1",
            "1um,1mm,1um",
            "0,1,1",
            "1,1,1vx",
            "a",
            "1,,1",
        ] {
            assert!(spacing(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn extents_are_three_numbers() {
        assert_eq!(dims("3,4,5").unwrap(), [3, 4, 5]);
        assert_eq!(dims("3x4x5").unwrap(), [3, 4, 5]);
        for bad in ["3,4", "3,4,0", "3,4,5,6", "3,-4,5", "a"] {
            assert!(dims(bad).is_err(), "{bad}");
        }
    }
}
