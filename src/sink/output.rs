//! The output directory: which places a run may write to.
//!
//! Comes in: the path the user gave. Goes out: an existing directory without files of an earlier
//! run. Files that curvox did not write are never removed, and a directory that holds any without
//! being a curvox output is refused.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::error::SinkError;
use super::run_record::{RUN_FILE, RunRecord};
use super::whole_file::{PARTIAL, temporary_of};

/// Name of the table inside the output directory.
pub const SURFELS_DIRECTORY: &str = "surfels";
/// Name of the folder of slices inside the output directory.
pub const SLICES_DIRECTORY: &str = "slices";
/// Name of the totals inside the output directory.
pub const SUMMARY_FILE: &str = "summary.json";
/// Name of the report inside the output directory.
pub const REPORT_FILE: &str = "report.html";

/// Makes `path` a directory that a run may write to.
///
/// It is created if missing. With `overwrite`, the files of an earlier run there are removed:
/// table, slices, totals, report and record, and nothing else.
///
/// # Errors
///
/// If `path` is a file; if it is not empty and no curvox output, whatever `overwrite` says; if it
/// is a curvox output and `overwrite` is false; or if the system refuses.
pub fn prepare_output(path: &Path, overwrite: bool) -> Result<(), SinkError> {
    match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return fs::create_dir_all(path)
                .map_err(|source| SinkError::io(path, "create the directory", source));
        }
        Err(source) => return Err(SinkError::io(path, "look at", source)),
        Ok(found) if !found.is_dir() => {
            return Err(SinkError::Occupied {
                path: path.to_owned(),
                found: "is a file, not a directory".into(),
                advice: "choose another place, or end the name in .parquet or .csv",
            });
        }
        Ok(_) => {}
    }
    if entries(path)?.is_empty() {
        return Ok(());
    }
    match RunRecord::read(path) {
        Ok(record) if !overwrite => {
            let parts = record.parts.len();
            Err(SinkError::Occupied {
                path: path.to_owned(),
                found: format!(
                    "holds the output of a run ({:?}, {parts} parts)",
                    record.state
                ),
                advice: "use --overwrite to replace it",
            })
        }
        Ok(_) => clear(path),
        Err(_) => Err(SinkError::Occupied {
            path: path.to_owned(),
            found: "is not empty and is not the output of a curvox run".into(),
            advice: "choose an empty or new directory",
        }),
    }
}

/// Removes the files of an earlier run; the record last, so that a killed removal can be repeated.
fn clear(path: &Path) -> Result<(), SinkError> {
    for (folder, is_ours) in [
        (SURFELS_DIRECTORY, is_part as fn(&str) -> bool),
        (SLICES_DIRECTORY, is_slice as fn(&str) -> bool),
    ] {
        let folder = path.join(folder);
        if !folder.is_dir() {
            continue;
        }
        for entry in entries(&folder)? {
            let name = entry.file_name().unwrap_or_default().to_string_lossy();
            if is_ours(final_name(&name)) {
                remove(&entry)?;
            }
        }
        // Stays when it holds something else.
        let _ = fs::remove_dir(&folder);
    }
    for name in [SUMMARY_FILE, REPORT_FILE, RUN_FILE] {
        let file = path.join(name);
        remove(&temporary_of(&file))?;
        remove(&file)?;
    }
    Ok(())
}

/// The name a temporary file would get.
fn final_name(name: &str) -> &str {
    name.strip_prefix('.')
        .and_then(|n| n.strip_suffix(PARTIAL))
        .unwrap_or(name)
}

fn is_part(name: &str) -> bool {
    digits_between(name, "part-", ".parquet")
}

fn is_slice(name: &str) -> bool {
    ["x", "y", "z"]
        .iter()
        .any(|axis| digits_between(name, axis, ".exr"))
}

fn digits_between(name: &str, start: &str, end: &str) -> bool {
    name.strip_prefix(start)
        .and_then(|rest| rest.strip_suffix(end))
        .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()))
}

fn entries(path: &Path) -> Result<Vec<PathBuf>, SinkError> {
    let list = fs::read_dir(path).map_err(|source| SinkError::io(path, "list", source))?;
    list.map(|entry| entry.map(|e| e.path()))
        .collect::<Result<_, _>>()
        .map_err(|source| SinkError::io(path, "list", source))
}

fn remove(path: &Path) -> Result<(), SinkError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(SinkError::io(path, "remove", error))
        }
        _ => Ok(()),
    }
}

/// Makes a folder inside the output directory, if it is not there.
pub(crate) fn make_folder(path: &Path) -> Result<(), SinkError> {
    fs::create_dir_all(path).map_err(|source| SinkError::io(path, "create the directory", source))
}
