//! What is in the folder, and what is known of it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::Value;

/// What should come out.
#[derive(Clone, Debug, Default)]
pub(super) struct Expected {
    /// Who says so.
    pub(super) by: String,
    pub(super) dims: Option<[u64; 3]>,
    /// Type of the canonical voxels, as in `i2`.
    pub(super) dtype: Option<String>,
    /// SHA-256 of the canonical voxels.
    pub(super) sha256: Option<String>,
    /// The spacing; `Some(None)` for a file that has none.
    pub(super) spacing: Option<Option<[f64; 3]>>,
    /// Whether the voxels are compared as stored, or scaled.
    pub(super) stored: bool,
}

/// A volume, or something that is none.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    /// Within the folder.
    pub(super) path: String,
    pub(super) expected: Option<Expected>,
    /// What is said of it: the case it is made for.
    pub(super) note: String,
    pub(super) frame: Option<u64>,
    /// Layout of a raw file.
    pub(super) raw: bool,
}

fn triple<T>(value: &Value, number: impl Fn(&Value) -> Option<T>) -> Option<[T; 3]> {
    let array = value.as_array()?;
    Some([
        number(array.first()?)?,
        number(array.get(1)?)?,
        number(array.get(2)?)?,
    ])
}

fn read_json(path: &Path) -> Result<Value> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    Ok(serde_json::from_slice(&bytes)?)
}

/// All files below a folder.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path.is_dir() {
            found.extend(files(&path)?);
        } else {
            found.push(path);
        }
    }
    Ok(found)
}

/// Every entry, so that each file of the folder is one or belongs to one; and files that hold bare
/// voxels to which a header beside them belongs.
pub(super) fn entries(
    data: &Path,
    facts: &BTreeMap<String, Value>,
) -> Result<(Vec<Entry>, Vec<String>)> {
    let mut entries: BTreeMap<String, Entry> = BTreeMap::new();
    let plain = |path: &str, note: &str| Entry {
        path: path.to_owned(),
        expected: None,
        note: note.to_owned(),
        frame: None,
        raw: false,
    };
    for one in read_json(&data.join("formats/manifest.json"))?
        .as_array()
        .context("the manifest is a list")?
    {
        let text = |key: &str| one[key].as_str().unwrap_or_default().to_owned();
        let path = format!("formats/{}", text("path").trim_end_matches('/'));
        let expected = Expected {
            by: "manifest".into(),
            dims: triple(&one["dims_xyz"], Value::as_u64),
            dtype: Some(text("dtype")),
            sha256: Some(text("canonical_sha256")),
            spacing: Some(triple(&one["spacing_in_file"], Value::as_f64)),
            stored: false,
        };
        let entry = Entry {
            expected: Some(expected),
            raw: text("format") == "raw",
            ..plain(&path, &text("quirk"))
        };
        entries.insert(path, entry);
    }
    let hostile = read_json(&data.join("hostile/expected.json"))?;
    for part in ["topology", "values", "broken"] {
        for (name, fact) in hostile[part].as_object().context("hostile cases")? {
            let path = format!("hostile/{part}/{}", name.trim_end_matches('/'));
            let note = fact["note"].as_str().unwrap_or_default();
            entries.insert(path.clone(), plain(&path, note));
        }
    }
    for (path, fact) in facts {
        let expected = Expected {
            by: fact["by"].as_str().unwrap_or_default().to_owned(),
            dims: triple(&fact["dims"], Value::as_u64),
            dtype: fact["dtype"].as_str().map(str::to_owned),
            sha256: fact["sha256"].as_str().map(str::to_owned),
            spacing: triple(&fact["spacing"], Value::as_f64).map(Some),
            stored: true,
        };
        let entry = Entry {
            expected: Some(expected),
            frame: fact["frame"].as_u64(),
            ..plain(path, "")
        };
        entries.insert(path.clone(), entry);
    }
    let parts = add_the_rest(data, &mut entries)?;
    Ok((entries.into_values().collect(), parts))
}

/// Files that no list names: each an entry, but for parts of folders that are one volume. Gives
/// files of bare voxels, which are no volumes by themselves.
fn add_the_rest(data: &Path, entries: &mut BTreeMap<String, Entry>) -> Result<Vec<String>> {
    const BARE: [&str; 4] = [".raw", ".zraw", ".raw.gz", ".img"];
    /// Folders whose folders are one volume each.
    const VOLUMES: [&str; 2] = ["dicom/", "ome-zarr-real/"];
    let mut added = BTreeSet::new();
    let mut parts = Vec::new();
    for file in files(data)? {
        let path = file
            .strip_prefix(data)?
            .to_string_lossy()
            .replace('\\', "/");
        if !path.contains('/') {
            // The folder's own notes and tools.
            continue;
        }
        let mut ancestors = Path::new(&path).ancestors();
        if ancestors.any(|a| entries.contains_key(a.to_string_lossy().as_ref())) {
            continue;
        }
        if BARE.iter().any(|end| path.ends_with(end)) {
            parts.push(path);
            continue;
        }
        let name = match VOLUMES.iter().find(|v| path.starts_with(*v)) {
            Some(_) => path.split('/').take(2).collect::<Vec<_>>().join("/"),
            None => path,
        };
        added.insert(name);
    }
    for path in added {
        let entry = Entry {
            path: path.clone(),
            expected: None,
            note: String::new(),
            frame: None,
            raw: false,
        };
        entries.insert(path, entry);
    }
    parts.sort();
    Ok(parts)
}
