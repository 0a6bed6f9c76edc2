//! The rows as a page.

use std::fmt::Write;

use super::list::Entry;
use super::read::{Facts, Outcome};

type Row = (Entry, Outcome);

/// What all rows come to, in one line.
pub(super) fn verdict(rows: &[Row]) -> String {
    let read: Vec<&Facts> = rows
        .iter()
        .filter_map(|(_, outcome)| match outcome {
            Outcome::Read(facts) => Some(&**facts),
            Outcome::Refused(_) | Outcome::Large(_) => None,
        })
        .collect();
    let count = |of: &dyn Fn(&Facts) -> Option<bool>| {
        let known: Vec<bool> = read.iter().filter_map(|facts| of(facts)).collect();
        let right = known.iter().filter(|right| **right).count();
        format!("{right} of {}", known.len())
    };
    let large = rows
        .iter()
        .filter(|(_, outcome)| matches!(outcome, Outcome::Large(_)))
        .count();
    format!(
        "{} entries: {} read, {} too large to be read whole here, {} refused. Voxels right: {} whose voxels are known from elsewhere. \
         Spacing right: {}. The same from a pipe: {}. The same by boxes: {}.",
        rows.len(),
        read.len(),
        large,
        rows.len() - read.len() - large,
        count(&|f| f.voxels_right),
        count(&|f| f.spacing_right),
        count(&|f| f.forward.as_ref().ok().copied()),
        count(&|f| f.boxes),
    )
}

/// The whole page.
pub(super) fn page(rows: &[Row], parts: &[String]) -> String {
    let mut page = String::from(
        "# What is read\n\n\
         Every file of a folder of test volumes, and what curvox makes of it. Made by `cargo run --release -p \
         curvox-tools --all-features -- formats DATA`.\n\n\
         *voxels* and *spacing*: as a manifest says, or as another program sees them (`by`); `-` where nobody else \
         says. *pipe*: read from standard input, the same voxels (`copied`: read that way, but by way of a copy). \
         *boxes*: any box can be read, the same voxels; `forward` where the voxels can only be read in order. *s/GB*: \
         seconds to read all voxels, for a gigabyte of file; *cat*: how many times as long as `read(2)` of the same \
         bytes takes. Small files show what opening costs.\n\n",
    );
    page.push_str(&verdict(rows));
    page.push_str("\n\n");
    let mut folder = "";
    for (entry, outcome) in rows {
        let here = entry.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        if here != folder {
            folder = here;
            let _ = write!(
                page,
                "\n## {folder}\n\n| file | format | voxels | type | spacing | voxels right | spacing right | by | pipe \
                 | boxes | s/GB | cat | the case |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|\n"
            );
        }
        let name = entry.path.rsplit('/').next().unwrap_or_default();
        let _ = match outcome {
            Outcome::Refused(message) => {
                let gap = "| ".repeat(10);
                let note = plain(&entry.note);
                writeln!(
                    page,
                    "| {name} | refused: {} {gap}| {note} |",
                    plain(message)
                )
            }
            Outcome::Large(header) => {
                let [x, y, z] = header.dims;
                let gap = "| ".repeat(8);
                writeln!(
                    page,
                    "| {name} | {} | {x} x {y} x {z} | too large to be read whole here {gap}| {} |",
                    header.format,
                    plain(&entry.note)
                )
            }
            Outcome::Read(facts) => {
                let note = plain(&entry.note);
                writeln!(page, "| {name} | {} | {note} |", cells(entry, facts))
            }
        };
    }
    let _ = write!(
        page,
        "\n## Bare voxels\n\nThese {} files belong to a header above, which was read with them: {}.\n",
        parts.len(),
        parts.join(", ")
    );
    page
}

/// Text that does not end a cell.
fn plain(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

fn cells(entry: &Entry, facts: &Facts) -> String {
    let header = &facts.header;
    let word = |right: Option<bool>| match right {
        None => "-",
        Some(true) => "yes",
        Some(false) => "**no**",
    };
    let [x, y, z] = header.dims;
    let spacing = header.spacing.map_or("none".to_owned(), |[x, y, z]| {
        let short = |s: f64| format!("{}", (s * 1e6).round() / 1e6);
        format!(
            "{} x {} x {} {}",
            short(x),
            short(y),
            short(z),
            header.unit.symbol()
        )
    });
    let pipe = match &facts.forward {
        Ok(true) if facts.boxes == Some(true) && !is_header_first(header) => "copied".to_owned(),
        Ok(right) => word(Some(*right)).to_owned(),
        Err(why) if why == "a folder" => why.clone(),
        Err(why) => format!("no: {}", plain(why)),
    };
    let boxes = match facts.boxes {
        None => "forward",
        right => word(right),
    };
    let [seconds, cat] = facts.seconds;
    let gigabytes = facts.bytes[0] as f64 / 1e9;
    [
        header.format.name().to_owned(),
        format!("{x} x {y} x {z}"),
        header.dtype().to_string(),
        spacing,
        word(facts.voxels_right).to_owned(),
        word(facts.spacing_right).to_owned(),
        entry.expected.as_ref().map_or("-", |e| &e.by).to_owned(),
        pipe,
        boxes.to_owned(),
        format!("{:.2}", seconds / gigabytes),
        format!("{:.1}", seconds / cat),
    ]
    .join(" | ")
}

/// Whether the format runs forward from a pipe.
fn is_header_first(header: &curvox_formats::Header) -> bool {
    curvox_formats::formats()
        .iter()
        .any(|info| info.format == header.format && info.forward)
}
