//! Units of length as ImageJ and OME write them.

use crate::header::Unit;

/// A unit and the factor that lengths are to be multiplied with; `None` for what is no length
/// ("pixel", "reference frame") or not known.
pub(super) fn length(text: &str) -> Option<(Unit, f64)> {
    let text = text.trim();
    if let Ok(unit) = text.parse::<Unit>() {
        return (unit != Unit::Unknown).then_some((unit, 1.0));
    }
    Some(match text.to_lowercase().as_str() {
        // Lower case turns the micro sign into itself and the Greek capital into mu.
        "um" | "\u{b5}m" | "\u{3bc}m" | "micron" | "microns" | "micrometer" | "micrometers"
        | "micrometre" | "micrometres" | "\u{b5}" | "\u{3bc}" => (Unit::Micrometre, 1.0),
        "nm" | "nanometer" | "nanometers" | "nanometre" | "nanometres" => (Unit::Nanometre, 1.0),
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => {
            (Unit::Millimetre, 1.0)
        }
        "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => {
            (Unit::Centimetre, 1.0)
        }
        "m" | "meter" | "meters" | "metre" | "metres" => (Unit::Metre, 1.0),
        "dm" => (Unit::Metre, 0.1),
        "km" => (Unit::Metre, 1e3),
        "pm" => (Unit::Nanometre, 1e-3),
        "\u{e5}" | "angstrom" | "angstroms" => (Unit::Angstrom, 1.0),
        "in" | "inch" | "inches" => (Unit::Millimetre, 25.4),
        "ft" => (Unit::Millimetre, 304.8),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_micro_signs_and_words_are_micrometres() {
        for text in [
            "um",
            "\u{b5}m",
            "\u{3bc}m",
            "micron",
            "Microns",
            " micrometer ",
        ] {
            assert_eq!(length(text), Some((Unit::Micrometre, 1.0)), "{text}");
        }
        assert_eq!(length("inch"), Some((Unit::Millimetre, 25.4)));
        assert_eq!(length("\u{c5}"), Some((Unit::Angstrom, 1.0)));
        for text in ["pixel", "", "reference frame", "furlong"] {
            assert_eq!(length(text), None, "{text}");
        }
    }
}
