//! Planes out of several files that hold equal shares of the voxels and must be decoded.
//!
//! In: a [`Parsed`] header and the paths. Out: [`ForwardVoxels`]. Guaranteed: one file is open at a time;
//! memory follows the planes that are asked for; each file is read to its end, so that its checksum is
//! verified; a file that holds too little is an error with its path.

use std::collections::VecDeque;
use std::fs::File;
use std::path::{Path, PathBuf};

use crate::error::Error;
use crate::forward::{decode, skip_lines, skip_to_voxels};
use crate::input::{Input, decompress, read_error};
use crate::parsed::{Encoding, Parsed, Start};
use crate::stream::look_behind;
use crate::volume::ForwardVoxels;

/// The planes of several files.
pub(crate) struct SharesVoxels {
    parsed: Parsed,
    paths: VecDeque<PathBuf>,
    /// Bytes of voxels in each file.
    share: u64,
    /// The file that is read, and what is left of its share.
    current: Option<(String, Input)>,
    left: u64,
    planes_left: u64,
    warnings: Vec<String>,
}

impl SharesVoxels {
    /// The volume of `parsed`, `share` bytes in each of `paths`.
    pub(crate) fn new(parsed: Parsed, paths: Vec<PathBuf>, share: u64) -> Self {
        Self {
            planes_left: parsed.header.dims[2],
            parsed,
            paths: paths.into(),
            share,
            current: None,
            left: 0,
            warnings: Vec::new(),
        }
    }

    /// Reads the current file to its end.
    fn close(&mut self) -> Result<(), Error> {
        /// Each of many files may have something to tell; the first tell enough.
        const WARNINGS_MOST: usize = 5;
        if let Some((name, mut input)) = self.current.take() {
            let found = look_behind(&mut input, &name, 0, self.share, 0)?;
            let room = WARNINGS_MOST.saturating_sub(self.warnings.len());
            self.warnings.extend(found.into_iter().take(room));
        }
        Ok(())
    }

    /// Opens the next file; false if there is none.
    fn next_file(&mut self) -> Result<bool, Error> {
        self.close()?;
        let Some(path) = self.paths.pop_front() else {
            return Ok(false);
        };
        let name = path.display().to_string();
        // Data whose encoding the header names is not to be decompressed by its looks.
        let raw = self.parsed.encoding == Encoding::Raw;
        let mut input = undecoded(&path, &name, raw, self.parsed.lines)?;
        // Offsets count from behind the lines.
        let lines_bytes = input.position();
        let offset = self.parsed.offset;
        self.parsed.offset = offset.saturating_add(lines_bytes);
        let decoded = decode(input, &self.parsed, &name);
        self.parsed.offset = offset;
        input = decoded?;
        if let Start::Bytes(skip) = self.parsed.start {
            skip_to_voxels(&mut input, skip, skip, &name)?;
        }
        self.left = self.share;
        self.current = Some((name, input));
        Ok(true)
    }
}

impl ForwardVoxels for SharesVoxels {
    fn read_planes(&mut self, count: u64, out: &mut Vec<u8>) -> Result<u64, Error> {
        out.clear();
        let count = count.min(self.planes_left);
        let plane = self.parsed.header.plane_bytes().unwrap_or(u64::MAX);
        let mut wanted = count.saturating_mul(plane);
        while wanted > 0 {
            if self.left == 0 && !self.next_file()? {
                break;
            }
            let Some((name, input)) = &mut self.current else {
                break;
            };
            let step = wanted.min(self.left);
            let found = input
                .append(step, out)
                .map_err(|e| read_error(name, input.position(), e))?;
            if found < step {
                let have = self.share - self.left + found;
                return Err(Error::invalid(
                    name.as_str(),
                    format!(
                        "the data ends early: {have} bytes of voxels found, {} expected",
                        self.share
                    ),
                )
                .at(input.position()));
            }
            self.left -= step;
            wanted -= step;
        }
        self.planes_left -= count;
        Ok(count)
    }

    fn finish(&mut self) -> Result<Vec<String>, Error> {
        if self.planes_left == 0 && self.left == 0 {
            self.close()?;
        }
        Ok(std::mem::take(&mut self.warnings))
    }
}

/// The bytes of a file from behind some lines on; `whole` if a compression of the whole file is to be
/// undone.
pub(crate) fn undecoded(path: &Path, name: &str, whole: bool, lines: u64) -> Result<Input, Error> {
    let file = File::open(path).map_err(|e| Error::io(name, "cannot be opened", e))?;
    let mut input = Input::new(file);
    if whole {
        input = decompress(input, name)?.0;
    }
    skip_lines(&mut input, lines, name)?;
    Ok(input)
}
