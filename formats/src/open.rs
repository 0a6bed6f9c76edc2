//! Opening a volume: which reader gets what.
//!
//! In: a path or a stream, and [`OpenOptions`]. Out: a [`Volume`]. The content decides on format
//! and compression; a name only adds a warning. Uncompressed local files are mapped, files on
//! network file systems are read, everything else runs forward. What a format stores in an order
//! that cannot run forward is copied to memory, up to a limit, or to disk.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use crate::bytes::FileBytes;
use crate::crop::crop;
use crate::detect::detect;
use crate::error::Error;
use crate::forward::{copy, decode, forward};
use crate::header::{Format, voxel_count};
use crate::input::{Compression, DEFLATE_MOST, Input, decompress, read_error};
use crate::options::OpenOptions;
use crate::parsed::{Context, Elsewhere, Encoding, Parsed, Start, check_extents};
use crate::registry::{self, Entry, FOLDERS, READERS, Reader};
use crate::shares::{SharesVoxels, undecoded};
use crate::store::open_whole_url;
use crate::stored::StoredVoxels;
use crate::stream::{ends_early, trailing};
use crate::volume::{SourceInfo, Volume, Voxels};
use crate::{nifti, raw, slices, vol};

/// Opens the volume at `path`: a file, or a folder of a format that uses folders. For addresses
/// there is [`open_url`].
///
/// # Errors
///
/// If it cannot be read, is not of a known format, contradicts itself, is too short for what it
/// claims, or needs a choice ([`OpenOptions::frame`] and the others).
pub fn open(path: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    let volume = open_whole(path, options)?;
    match &options.region {
        None => Ok(volume),
        Some(region) => crop(volume, region),
    }
}

/// Opens the volume at an address: `http://`, `https://` or `s3://BUCKET/KEY`.
///
/// For S3, the region is that of `AWS_REGION` or the profile, the endpoint that of
/// `AWS_ENDPOINT_URL`, and the credentials those of `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`
/// and `AWS_SESSION_TOKEN`, or of the profile `AWS_PROFILE`; without any, requests are anonymous.
/// `CURVOX_HTTP_TIMEOUT` is how many seconds a silent server is waited for, 30 if not set.
///
/// # Errors
///
/// As [`open`], if the server does not answer or refuses to, and if this build was made without
/// the feature `remote`.
pub fn open_url(url: &str, options: &OpenOptions) -> Result<Volume, Error> {
    let volume = open_whole_url(url, options)?;
    match &options.region {
        None => Ok(volume),
        Some(region) => crop(volume, region),
    }
}

/// Opens the volume that `reader` gives; `name` stands for it in messages.
///
/// # Errors
///
/// As [`open`]. That the data is shorter than the header claims is only found by reading it.
pub fn open_stream(
    reader: Box<dyn Read + Send>,
    name: &str,
    options: &OpenOptions,
) -> Result<Volume, Error> {
    let volume = open_whole_stream(reader, name, options)?;
    match &options.region {
        None => Ok(volume),
        Some(region) => crop(volume, region),
    }
}

fn open_whole(path: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    let name = path.display().to_string();
    let cannot_open = |e| Error::io(&name, "cannot be opened", e);
    let metadata = match std::fs::metadata(path) {
        Err(e) if e.kind() == ErrorKind::NotFound && slices::is_pattern(path) => {
            registry::check_choices(Format::Slices, &name, options)?;
            let volume = slices::open_pattern(path, options)?;
            check_extents(&volume.header, &name)?;
            return Ok(volume);
        }
        metadata => metadata.map_err(cannot_open)?,
    };
    if metadata.is_dir() {
        return open_folder(path, &name, options);
    }
    let file = File::open(path).map_err(cannot_open)?;
    if !metadata.is_file() {
        return open_whole_stream(Box::new(file), &name, options);
    }
    // Opened by its voxels, a pair is found by its header, unless these are said to be raw.
    let raw = options.raw.is_some() || options.format == Some(Format::Raw);
    if !raw && let Some(header) = nifti::header_of_image(path) {
        return open_whole(&header, options);
    }
    let place = Place {
        name: &name,
        path,
        options,
    };
    let (mut input, compression, length) = place.begin(&file, raw::file_bytes(options))?;
    let plain_length = compression.is_none().then_some(length);
    let context = Context {
        name: &name,
        path: Some(path),
        options,
        length: plain_length,
    };
    let misnamed = compression.is_none() && has_extension(path, &["gz", "zst", "bz2"]);
    let warning = misnamed.then(|| format!("{name}: named as compressed, but it is not"));
    let mut volume = match choose(&mut input, &context)?.reader {
        Reader::Header(parse) => {
            let parsed = parse(&mut input, &context)?;
            check_extents(&parsed.header, &name)?;
            match parsed.elsewhere.clone() {
                Elsewhere::Here => place.finish(parsed, file, input, compression, length)?,
                Elsewhere::FirstOf(paths) => place.open_sibling(parsed, &paths)?,
                Elsewhere::Files(paths) => place.open_files(parsed, &paths)?,
            }
        }
        Reader::Bytes(read) => {
            let bytes = match compression {
                None => FileBytes::of_file(file, path, options.io)?,
                Some(_) => copy(&mut input, None, NEEDS_ALL, &name, options)?,
            };
            let (held, spilled) = (bytes.source().held_bytes, bytes.len());
            let mut volume = read(bytes, &context)?;
            check_extents(&volume.header, &name)?;
            if compression.is_some() {
                note_copy(&mut volume.source, held, spilled);
                volume.source.path = Some(path.to_path_buf());
                volume.source.re_readable = true;
                volume.source.length_bytes = Some(length);
            }
            volume
        }
        #[cfg(not(feature = "hdf5"))]
        Reader::Missing => return Err(Error::unsupported(&name, "is not read by this build")),
    };
    volume.header.warnings.extend(warning);
    Ok(volume)
}

const NEEDS_ALL: &str = "this format is not read front to back";

fn open_folder(path: &Path, name: &str, options: &OpenOptions) -> Result<Volume, Error> {
    let asked = options.format;
    let folder = FOLDERS.iter().find(|folder| match asked {
        Some(format) => folder.format == format,
        None => (folder.detect)(path),
    });
    let Some(folder) = folder else {
        let titles: Vec<_> = FOLDERS
            .iter()
            .map(|folder| registry::info(folder.format).title)
            .collect();
        return Err(Error::unsupported(
            name,
            if titles.is_empty() {
                "is a folder; a file was expected".to_string()
            } else {
                format!(
                    "is a folder in which no volume was found; expected {}",
                    titles.join(", ")
                )
            },
        ));
    };
    registry::check_choices(folder.format, name, options)?;
    let volume = (folder.open)(path, options)?;
    check_extents(&volume.header, name)?;
    Ok(volume)
}

pub(crate) fn open_whole_stream(
    reader: Box<dyn Read + Send>,
    name: &str,
    options: &OpenOptions,
) -> Result<Volume, Error> {
    let input = Input::new(reader);
    let (mut input, compression) = decompress(input, name)?;
    let context = Context {
        name,
        path: None,
        options,
        length: None,
    };
    let mut source = SourceInfo::stream(name);
    source.compressed = compression.is_some();
    match choose(&mut input, &context)?.reader {
        Reader::Header(parse) => {
            let parsed = parse(&mut input, &context)?;
            check_extents(&parsed.header, name)?;
            if parsed.elsewhere != Elsewhere::Here {
                return Err(Error::unsupported(
                    name,
                    "this header's voxels are in another file (.img); a pair cannot be read from \
                     a stream",
                ));
            }
            source.compressed |= parsed.encoding != Encoding::Raw;
            forward(parsed, input, name, options, source)
        }
        Reader::Bytes(read) => {
            let bytes = copy(&mut input, None, NEEDS_ALL, name, options)?;
            let (held, spilled) = (bytes.source().held_bytes, bytes.len());
            let mut volume = read(bytes, &context)?;
            check_extents(&volume.header, name)?;
            note_copy(&mut volume.source, held, spilled);
            volume.source.compressed |= source.compressed;
            Ok(volume)
        }
        #[cfg(not(feature = "hdf5"))]
        Reader::Missing => Err(Error::unsupported(name, "is not read by this build")),
    }
}

/// Counts a copy of `bytes` bytes, `held` of them in memory.
fn note_copy(source: &mut SourceInfo, held: u64, bytes: u64) {
    source.held_bytes = source.held_bytes.max(held);
    source.spilled_bytes = bytes - held;
}

/// The reader of what `input` holds.
fn choose(input: &mut Input, context: &Context<'_>) -> Result<&'static Entry, Error> {
    let format = match (context.options.format, &context.options.raw) {
        (Some(format), _) => format,
        // A layout given for a file that has its own would read the header as voxels.
        (None, Some(_)) => match detect(input, context) {
            // Some formats have hardly a mark, which any voxels may happen to have.
            Ok(found) if !registry::is_weakly_marked(found) => {
                return Err(Error::unsupported(
                    context.name,
                    format!(
                        "the content is {found}, which says its own dimensions and type: leave \
                         out the raw layout, or ask for format raw to read it as bare voxels"
                    ),
                ));
            }
            _ => Format::Raw,
        },
        (None, None) => detect(input, context)?,
    };
    registry::check_choices(format, context.name, context.options)?;
    let info = registry::info(format);
    let entry = READERS.iter().find(|entry| entry.format == format);
    match (entry, info.missing_feature) {
        (Some(entry), None) => Ok(entry),
        (_, Some(feature)) => Err(Error::unsupported(
            context.name,
            format!(
                "{} is read by builds with the cargo feature '{feature}', which this one was \
                 made without: cargo install curvox --features {feature}",
                info.title
            ),
        )),
        (None, None) => Err(Error::unsupported(
            context.name,
            format!("{} is a folder, not a file", info.title),
        )),
    }
}

/// A file and how it is to be opened.
struct Place<'a> {
    name: &'a str,
    path: &'a Path,
    options: &'a OpenOptions,
}

impl Place<'_> {
    /// The bytes of `file`, decompressed, their compression, and the length of the file. A file
    /// of exactly `plain` bytes is not compressed, whatever its first voxels look like.
    fn begin(
        &self,
        file: &File,
        plain: Option<u64>,
    ) -> Result<(Input, Option<Compression>, u64), Error> {
        let cannot_open = |e| Error::io(self.name, "cannot be opened", e);
        let length = file.metadata().map_err(cannot_open)?.len();
        let input = Input::new(file.try_clone().map_err(cannot_open)?);
        if plain == Some(length) {
            return Ok((input, None, length));
        }
        let (input, compression) = decompress(input, self.name)?;
        Ok((input, compression, length))
    }

    /// Opens the voxels of a header that keeps them in one other file.
    fn open_sibling(&self, mut parsed: Parsed, paths: &[PathBuf]) -> Result<Volume, Error> {
        let Some(path) = paths.iter().find(|p| p.is_file()) else {
            let tried: Vec<_> = paths.iter().map(|p| p.display().to_string()).collect();
            return Err(Error::invalid(
                self.name,
                format!(
                    "the voxels are in another file, which is missing: {}",
                    tried.join(", ")
                ),
            ));
        };
        let name = path.display().to_string();
        let place = Place {
            name: &name,
            path,
            options: self.options,
        };
        let file = File::open(path).map_err(|e| Error::io(&name, "cannot be opened", e))?;
        place.pass_lines(&mut parsed, path)?;
        let plain = match (parsed.encoding, parsed.start) {
            (Encoding::Raw, Start::Bytes(skip)) => parsed
                .header
                .voxels_bytes()
                .and_then(|n| n.checked_add(parsed.offset)?.checked_add(skip)),
            _ => None,
        };
        let encoded = parsed.encoding != Encoding::Raw;
        let (input, compression, length) = if encoded {
            // The header says how the bytes are encoded, and looks of them do not count.
            let again = file
                .try_clone()
                .map_err(|e| Error::io(&name, "cannot be opened", e))?;
            let length = file
                .metadata()
                .map_err(|e| Error::io(&name, "cannot be opened", e))?
                .len();
            (Input::new(again), None, length)
        } else {
            place.begin(&file, plain)?
        };
        place.finish(parsed, file, input, compression, length)
    }

    /// Opens the voxels of a header that keeps equal shares of them in several files.
    fn open_files(&self, parsed: Parsed, paths: &[PathBuf]) -> Result<Volume, Error> {
        let missing: Vec<_> = paths.iter().filter(|p| !p.is_file()).collect();
        if let Some(first) = missing.first() {
            return Err(Error::invalid(
                self.name,
                format!(
                    "the voxels are in {} files, {} of which are missing; the first is {}",
                    paths.len(),
                    missing.len(),
                    first.display()
                ),
            ));
        }
        let bytes = parsed.header.voxels_bytes().unwrap_or(u64::MAX);
        let files = paths.len() as u64;
        if files == 0 || !bytes.is_multiple_of(files) {
            return Err(Error::invalid(
                self.name,
                format!("{bytes} bytes of voxels cannot be {files} files of the same size"),
            ));
        }
        let share = bytes / files;
        if parsed.encoding != Encoding::Raw || parsed.lines > 0 {
            return Ok(self.read_files(parsed, paths, share));
        }
        let joined = FileBytes::joined(self.name, paths, share, |path, length| {
            let from = match parsed.start {
                Start::Bytes(skip) => Some(parsed.offset.saturating_add(skip)),
                Start::FromEnd => length.checked_sub(share),
            };
            from.filter(|from| from.checked_add(share).is_some_and(|end| end <= length))
                .ok_or_else(|| {
                    Error::invalid(
                        path.display().to_string(),
                        format!(
                            "the file has {length} bytes, expected {share} bytes of voxels{}",
                            match parsed.offset {
                                0 => String::new(),
                                n => format!(" behind {n} others"),
                            }
                        ),
                    )
                    .at(length)
                })
        })?;
        let mut source = joined.source();
        source.name = self.name.to_string();
        source.length_bytes = Some(bytes);
        let Parsed { header, order, .. } = parsed;
        let voxels = StoredVoxels::new(joined, self.name, 0, &header, order);
        Ok(Volume {
            header,
            voxels: Voxels::Random(Box::new(voxels)),
            source,
        })
    }

    /// The voxels of files that must be decoded, one after the other.
    fn read_files(&self, parsed: Parsed, paths: &[PathBuf], share: u64) -> Volume {
        let source = SourceInfo {
            path: paths.first().cloned(),
            compressed: parsed.encoding != Encoding::Raw,
            re_readable: true,
            ..SourceInfo::stream(self.name)
        };
        let header = parsed.header.clone();
        let voxels = SharesVoxels::new(parsed, paths.to_vec(), share);
        Volume {
            header,
            voxels: Voxels::Forward(Box::new(voxels)),
            source,
        }
    }

    /// Counts the lines that are to be passed as bytes.
    fn pass_lines(&self, parsed: &mut Parsed, path: &Path) -> Result<(), Error> {
        if parsed.lines > 0 {
            let input = undecoded(
                path,
                self.name,
                parsed.encoding == Encoding::Raw,
                parsed.lines,
            )?;
            parsed.offset = parsed.offset.saturating_add(input.position());
            parsed.lines = 0;
        }
        Ok(())
    }

    /// Finds the voxels at the end of decoded data: by decoding it, which takes no memory.
    fn find_from_end(&self, parsed: &mut Parsed, whole: bool) -> Result<(), Error> {
        let input = undecoded(self.path, self.name, whole, 0)?;
        let mut input = decode(input, parsed, self.name)?;
        let found = input
            .skip(u64::MAX)
            .map_err(|e| read_error(self.name, input.position(), e))?;
        let bytes = parsed.header.voxels_bytes().unwrap_or(u64::MAX);
        let start = found.checked_sub(bytes).ok_or_else(|| {
            let plane = parsed.header.plane_bytes().unwrap_or(u64::MAX);
            ends_early(self.name, found, found, bytes, plane)
        })?;
        parsed.start = Start::Bytes(start);
        Ok(())
    }

    /// The volume, once it is known where its voxels are.
    fn finish(
        &self,
        mut parsed: Parsed,
        file: File,
        input: Input,
        compression: Option<Compression>,
        length: u64,
    ) -> Result<Volume, Error> {
        let encoded = parsed.encoding != Encoding::Raw;
        if compression.is_some() || encoded {
            let source = SourceInfo {
                path: Some(self.path.to_path_buf()),
                compressed: true,
                re_readable: true,
                length_bytes: Some(length),
                ..SourceInfo::stream(self.name)
            };
            self.check_ratio(&parsed, compression, length)?;
            if parsed.start == Start::FromEnd {
                self.find_from_end(&mut parsed, compression.is_some())?;
            }
            if parsed.maybe_eight_bytes {
                self.count_voxel_bytes(&mut parsed)?;
            }
            return forward(parsed, input, self.name, self.options, source);
        }
        drop(input);
        let behind = parsed.bytes_behind();
        let Parsed {
            mut header,
            offset,
            start,
            order,
            ..
        } = parsed;
        let bytes = header.voxels_bytes().unwrap_or(u64::MAX);
        let offset = match start {
            Start::Bytes(skip) => offset.saturating_add(skip),
            Start::FromEnd => offset.max(length.saturating_sub(bytes)),
        };
        let available = length.saturating_sub(offset);
        if available < bytes {
            let plane = header.plane_bytes().unwrap_or(u64::MAX);
            return Err(ends_early(self.name, length, available, bytes, plane));
        }
        // Checked by the format: all frames together fit `u64`.
        let used = bytes.saturating_add(behind);
        if available > used {
            header
                .warnings
                .push(trailing(self.name, offset + used, available - used));
        }
        let bytes = FileBytes::of_file(file, self.path, self.options.io)?;
        let source = bytes.source();
        let voxels = StoredVoxels::new(bytes, self.name, offset, &header, order);
        Ok(Volume {
            header,
            voxels: Voxels::Random(Box::new(voxels)),
            source,
        })
    }

    /// Refuses a volume that its compressed bytes cannot possibly hold.
    fn check_ratio(
        &self,
        parsed: &Parsed,
        compression: Option<Compression>,
        length: u64,
    ) -> Result<(), Error> {
        let raw = parsed.encoding == Encoding::Raw;
        let deflated = matches!(parsed.encoding, Encoding::Zlib | Encoding::Gzip);
        let single = match compression {
            Some(Compression::Gzip) => raw,
            Some(Compression::Zstd | Compression::Bzip2) => false,
            None => deflated,
        };
        let bytes = parsed.header.voxels_bytes().unwrap_or(u64::MAX);
        if single && bytes / DEFLATE_MOST > length {
            return Err(Error::invalid(
                self.name,
                format!(
                    "the header claims {bytes} bytes of voxels, but the {length} bytes of this \
                     file can hold at most {DEFLATE_MOST} times as many"
                ),
            ));
        }
        Ok(())
    }

    /// Decides between four and eight bytes a voxel by counting what the file holds.
    fn count_voxel_bytes(&self, parsed: &mut Parsed) -> Result<(), Error> {
        let file =
            File::open(self.path).map_err(|e| Error::io(self.name, "cannot be opened", e))?;
        let (mut input, _) = decompress(Input::new(file), self.name)?;
        let failed = |input: &Input, e| read_error(self.name, input.position(), e);
        input.skip(parsed.offset).map_err(|e| failed(&input, e))?;
        if parsed.encoding == Encoding::Zlib {
            input = input
                .zlib()
                .map_err(|e| read_error(self.name, parsed.offset, e))?;
        }
        let eight = voxel_count(parsed.header.dims).and_then(|n| n.checked_mul(8));
        let Some(eight) = eight else { return Ok(()) };
        let found = input.skip(eight).map_err(|e| failed(&input, e))?;
        if found == eight {
            vol::take_eight_bytes(&mut parsed.header, self.name);
        }
        parsed.maybe_eight_bytes = false;
        Ok(())
    }
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension()
        .and_then(|e| e.to_str())
        .is_some_and(|e| extensions.iter().any(|known| e.eq_ignore_ascii_case(known)))
}
