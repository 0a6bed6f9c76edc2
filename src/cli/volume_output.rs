//! A volume that a command writes: where to, in which format, and what happens when it fails.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, ValueEnum};
use curvox_formats::write::{VolumeWriter, WriteFormat, WriteSpec};

use crate::sink::{STDOUT, SinkError};

use super::exit::usage;

/// Options of a volume to write.
#[derive(Args, Clone, Debug)]
pub(crate) struct VolumeOutputArgs {
    /// File to write, or - for standard output
    #[arg(short, long, value_name = "FILE", default_value = STDOUT)]
    output: PathBuf,

    /// Format: nii, npy, vol, raw; nii alone carries the voxel size [default: from the name, else nii]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "FORMAT")]
    to: Option<To>,

    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq)]
enum To {
    Nii,
    Npy,
    Vol,
    Raw,
}

/// Takes voxels, as they are to be stored.
pub(crate) type Put<'a> = dyn FnMut(&[u8]) -> Result<()> + 'a;

impl VolumeOutputArgs {
    /// The file to write; `None` for standard output.
    pub(crate) fn file(&self) -> Option<&Path> {
        Some(self.output.as_path()).filter(|path| *path != Path::new(STDOUT))
    }

    /// The format asked of a command, or that of the name.
    ///
    /// # Errors
    /// If the name is not that of a format that is written.
    pub(crate) fn format(&self, command: &str) -> Result<WriteFormat> {
        let ending = self
            .output
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        let to = match (self.to, ending.as_deref()) {
            (Some(to), _) => to,
            (None, Some("nii") | None) => To::Nii,
            (None, Some("npy")) => To::Npy,
            (None, Some("vol")) => To::Vol,
            (None, Some("raw")) => To::Raw,
            (None, Some("gz")) => {
                return Err(usage(format!(
                    "compressed volumes are not written; pipe through gzip: curvox {command} ... | gzip > {}",
                    self.output.display()
                )));
            }
            (None, Some(other)) => {
                return Err(usage(format!(
                    "-o {}: .{other} is not a format that is written; say --to nii, npy, vol or raw",
                    self.output.display()
                )));
            }
        };
        Ok(match to {
            To::Nii => WriteFormat::Nifti,
            To::Npy => WriteFormat::Npy,
            To::Vol => WriteFormat::Vol,
            To::Raw => WriteFormat::Raw,
        })
    }

    /// Writes a volume: `planes` hands its voxels to what it is given, in order.
    ///
    /// # Errors
    /// If the file exists or cannot be written, standard output is a terminal, the format cannot
    /// hold the volume, or `planes` fails. A file, new or replaced, is removed then.
    pub(crate) fn write(
        &self,
        volume: &WriteSpec,
        planes: impl FnOnce(&mut Put<'_>) -> Result<()>,
    ) -> Result<()> {
        let path = &self.output;
        if self.file().is_none() {
            if io::stdout().is_terminal() {
                return Err(usage(
                    "a volume is binary and standard output is a terminal; \
                     give a file (-o ball.nii) or pipe it on, as into curvox run - --threshold 1 -o out",
                ));
            }
            return write_to(io::stdout().lock(), path, volume, planes);
        }
        let is_special = is_special(path);
        let made = OpenOptions::new()
            .write(true)
            .create(true)
            .create_new(!self.overwrite && !is_special)
            .truncate(self.overwrite)
            .open(path);
        let file: File = made.map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => SinkError::Occupied {
                path: path.clone(),
                found: "exists already".into(),
                advice: "use --overwrite to replace it",
            },
            _ => SinkError::io(path, "create", error),
        })?;
        let out = BufWriter::with_capacity(1 << 18, file);
        let result = write_to(out, path, volume, planes);
        if result.is_err() && !is_special {
            // A file cut short would look like a damaged volume.
            let _ = std::fs::remove_file(path);
        }
        result
    }
}

fn write_to(
    out: impl Write,
    path: &Path,
    volume: &WriteSpec,
    planes: impl FnOnce(&mut Put<'_>) -> Result<()>,
) -> Result<()> {
    let failed = |error: curvox_formats::Error| write_error(path, error);
    let name = path.display().to_string();
    let mut writer = VolumeWriter::new(out, &name, volume).map_err(failed)?;
    planes(&mut |bytes| writer.write_planes(bytes).map_err(failed))?;
    writer.finish().map_err(failed)?;
    Ok(())
}

/// Whether a path is a device or a pipe, which is there already and cannot be replaced.
fn is_special(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir())
}

/// An error of writing, as an output's; the library of formats has one kind of error for both.
fn write_error(path: &Path, error: curvox_formats::Error) -> anyhow::Error {
    use std::error::Error as _;
    let source = error.source().and_then(|s| s.downcast_ref::<io::Error>());
    match source {
        Some(source) => {
            let source = io::Error::new(source.kind(), source.to_string());
            SinkError::io(path, "write", source).into()
        }
        None => usage(error.to_string()),
    }
}
