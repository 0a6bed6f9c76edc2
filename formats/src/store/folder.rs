//! A folder as a place with objects: keys are paths of files below it.

use std::fs::{self, File, Metadata};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::{Part, Stamp, Store};
use crate::error::Error;

/// A folder on disk.
pub(crate) struct Folder {
    root: PathBuf,
}

impl Folder {
    pub(crate) fn new(root: &Path) -> Self {
        Self {
            root: root.to_path_buf(),
        }
    }

    fn path(&self, key: &str) -> PathBuf {
        let mut path = self.root.clone();
        // Piece by piece, so that no key is taken for an absolute path.
        path.extend(key.split('/').filter(|name| !name.is_empty()));
        path
    }
}

/// Whether there is no file, as against one that cannot be read.
fn is_missing(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory
    )
}

fn stamp(metadata: &Metadata) -> Stamp {
    let time = metadata.modified().ok();
    Stamp(time.map(|time| format!("{} {time:?}", metadata.len())))
}

impl Store for Folder {
    fn name(&self, key: &str) -> String {
        self.path(key).display().to_string()
    }

    fn get(&self, key: &str, part: Part, out: &mut Vec<u8>) -> Result<Option<Stamp>, Error> {
        out.clear();
        let path = self.path(key);
        let failed = |e| Error::io(path.display().to_string(), "cannot be read", e);
        let metadata = match fs::metadata(&path) {
            Ok(metadata) => metadata,
            Err(e) if is_missing(&e) => return Ok(None),
            Err(e) => return Err(failed(e)),
        };
        // A pipe of that name would never end, or never begin.
        if !metadata.is_file() {
            return Err(Error::invalid(
                path.display().to_string(),
                "is not a file; a file was expected",
            ));
        }
        let mut file = match File::open(&path) {
            Ok(file) => file,
            Err(e) if is_missing(&e) => return Ok(None),
            Err(e) => return Err(failed(e)),
        };
        let length = metadata.len();
        part.check(&path.display().to_string(), length)?;
        let (offset, count) = match part {
            Part::All { .. } => (0, length),
            Part::At { offset, count } => (offset, count),
            Part::Last { count } => (length - count, count),
        };
        if offset > 0 {
            file.seek(SeekFrom::Start(offset)).map_err(failed)?;
        }
        out.reserve(usize::try_from(count).unwrap_or(0));
        let found = (&file).take(count).read_to_end(out).map_err(failed)? as u64;
        if found < count {
            return Err(Error::invalid(
                path.display().to_string(),
                format!("became shorter while it was read: {found} bytes found, {count} expected"),
            )
            .at(offset));
        }
        let stamp = self::stamp(&metadata);
        if stamp.differs(&self::stamp(&file.metadata().map_err(failed)?)) {
            return Err(Error::invalid(
                path.display().to_string(),
                "the file was written to while it was being read",
            ));
        }
        Ok(Some(stamp))
    }

    fn lacks(&self, key: &str) -> bool {
        matches!(fs::symlink_metadata(self.path(key)), Err(e) if is_missing(&e))
    }

    fn children(&self, key: &str) -> Result<Option<Vec<String>>, Error> {
        let path = self.path(key);
        let failed = |e| Error::io(path.display().to_string(), "cannot be listed", e);
        let entries = match fs::read_dir(&path) {
            Ok(entries) => entries,
            Err(e) if is_missing(&e) => return Ok(Some(Vec::new())),
            Err(e) => return Err(failed(e)),
        };
        let mut names = Vec::new();
        for entry in entries {
            let entry = entry.map_err(failed)?;
            if entry.path().is_dir()
                && let Ok(name) = entry.file_name().into_string()
            {
                names.push(name);
            }
        }
        names.sort();
        Ok(Some(names))
    }
}
