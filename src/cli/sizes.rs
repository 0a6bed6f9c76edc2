//! Sizes of memory, as typed and as printed: `1GiB`, `512 MiB`, `2GB`.

use super::exit::Usage;

const UNITS: [(&str, u64); 9] = [
    ("kib", 1 << 10),
    ("mib", 1 << 20),
    ("gib", 1 << 30),
    ("tib", 1 << 40),
    ("kb", 1_000),
    ("mb", 1_000_000),
    ("gb", 1_000_000_000),
    ("tb", 1_000_000_000_000),
    ("b", 1),
];

/// Reads a size; a bare number is an error.
pub(crate) fn parse(text: &str) -> Result<u64, Usage> {
    let fail = || {
        Usage(format!(
            "'{text}' is not a size; write a number and a unit: 512MiB, 1GiB, 2.5GB"
        ))
    };
    let lower = text.trim().to_ascii_lowercase();
    let (unit, factor) = UNITS
        .into_iter()
        .find(|(unit, _)| lower.ends_with(unit))
        .ok_or_else(fail)?;
    let number: f64 = lower[..lower.len() - unit.len()]
        .trim()
        .parse()
        .map_err(|_| fail())?;
    let bytes = number * factor as f64;
    // 2^60 is beyond any machine and keeps later sums within u64.
    if !(1.0..=(1u64 << 60) as f64).contains(&bytes) {
        return Err(fail());
    }
    Ok(bytes as u64)
}

/// A size for people.
pub(crate) fn show(bytes: u64) -> String {
    let mut value = bytes as f64;
    let mut unit = "B";
    for next in ["KiB", "MiB", "GiB", "TiB", "PiB"] {
        if value < 1024.0 {
            break;
        }
        value /= 1024.0;
        unit = next;
    }
    if unit == "B" {
        format!("{bytes} B")
    } else if value < 10.0 {
        format!("{value:.2} {unit}")
    } else {
        format!("{value:.1} {unit}")
    }
}

/// A count with its digits in groups of three.
pub(crate) fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::with_capacity(digits.len() * 4 / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn binary_and_decimal_units_differ() {
        assert_eq!(parse("1GiB").unwrap(), 1 << 30);
        assert_eq!(parse("1 GB").unwrap(), 1_000_000_000);
        assert_eq!(parse("1.5mib").unwrap(), 3 << 19);
        assert_eq!(parse("64KiB").unwrap(), 65536);
        for bad in ["1", "", "GiB", "-1GiB", "1e30GiB", "0MiB", "nanMiB", "1G"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn numbers_are_shown_for_people() {
        assert_eq!(show(1023), "1023 B");
        assert_eq!(show(3 << 19), "1.50 MiB");
        assert_eq!(show(100 << 30), "100.0 GiB");
        assert_eq!(count(1234567), "1 234 567");
        assert_eq!(count(12), "12");
    }
}
