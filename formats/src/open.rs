//! Which format a file has, and how its voxels will be read.
//!
//! In: a path or a stream, and [`OpenOptions`]. Out: a [`Volume`]. The content decides on format
//! and compression; a name only adds a warning. Uncompressed local files are mapped, files on
//! network file systems are read, everything else runs forward. What a format stores in an order
//! that cannot run forward is held in memory, up to a limit.
//!
//! A format module gives a [`Parsed`] header: what the volume is and where its voxels start. To
//! add a format, recognise it in `detect` and parse it here; chunked formats implement
//! [`RandomVoxels`](crate::RandomVoxels) themselves.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::detect::detect;
use crate::error::Error;
use crate::header::{DType, Format, Header, Unit, VoxelType, voxel_count};
use crate::input::{Compression, DEFLATE_MOST, Input, read_error};
use crate::map::{Fingerprint, GuardedMap};
use crate::stored::{AxisOrder, Bytes, StoredVoxels};
use crate::stream::{StreamVoxels, ends_early, look_behind, trailing};
use crate::volume::{SourceInfo, Volume, Voxels};
use crate::{nifti, npy, vol};

/// How the bytes of an uncompressed file are reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum IoMode {
    /// Mapped on local file systems, read on network file systems.
    #[default]
    Auto,
    /// Mapped.
    Map,
    /// Read at offsets. Slower, but a failing network is an error instead of a stall.
    Read,
}

/// The layout of a file without a header. Voxels are stored x fastest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawLayout {
    /// Voxels along x, y, z.
    pub dims: [u64; 3],
    /// Their type and byte order.
    pub dtype: DType,
    /// Edge lengths of a voxel in `unit`, if known.
    pub spacing: Option<[f64; 3]>,
    /// Unit of `spacing`.
    pub unit: Unit,
    /// Bytes before the first voxel.
    pub skip: u64,
}

/// How to open a volume.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// The format; `None` to recognise it.
    pub format: Option<Format>,
    /// The layout of a file without a header. When given, the file is taken as such.
    pub raw: Option<RawLayout>,
    /// How uncompressed files are read.
    pub io: IoMode,
    /// Which volume of a file with several, from 0.
    pub frame: Option<u64>,
    /// The most bytes held in memory for inputs that cannot run forward, for instance an array
    /// in Fortran order from a pipe.
    pub spool_limit_bytes: u64,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            format: None,
            raw: None,
            io: IoMode::Auto,
            frame: None,
            spool_limit_bytes: 256 << 20,
        }
    }
}

/// What a format module found out.
pub(crate) struct Parsed {
    pub(crate) header: Header,
    /// Offset of the first voxel in the (decompressed) file that holds the voxels.
    pub(crate) offset: u64,
    pub(crate) order: AxisOrder,
    /// The voxels are zlib data.
    pub(crate) zlib: bool,
    /// The voxels are in the first of these files that exists; empty for the same file.
    pub(crate) elsewhere: Vec<PathBuf>,
    /// The header says four bytes a voxel, but eight are as likely (see `vol`).
    pub(crate) maybe_eight_bytes: bool,
    /// How many volumes of the same size follow the one to be read.
    pub(crate) frames_behind: u64,
}

impl Parsed {
    pub(crate) fn new(header: Header, offset: u64) -> Self {
        Self {
            header,
            offset,
            order: AxisOrder::XFastest,
            zlib: false,
            elsewhere: Vec::new(),
            maybe_eight_bytes: false,
            frames_behind: 0,
        }
    }
}

/// What a format module is told.
pub(crate) struct Context<'a> {
    pub(crate) name: &'a str,
    pub(crate) path: Option<&'a Path>,
    pub(crate) options: &'a OpenOptions,
    /// Bytes of the file, where it is uncompressed and its length known.
    pub(crate) length: Option<u64>,
}

impl Context<'_> {
    /// The next `count` bytes of a header, or an error that says how many there were.
    pub(crate) fn header_bytes(&self, input: &mut Input, count: usize) -> Result<Vec<u8>, Error> {
        let start = input.position();
        let mut bytes = Vec::new();
        input
            .append(count as u64, &mut bytes)
            .map_err(|e| self.read_error(input, e))?;
        if bytes.len() < count {
            return Err(Error::invalid(
                self.name,
                format!(
                    "the header ends early: {} bytes found, {count} expected",
                    bytes.len()
                ),
            )
            .at(start));
        }
        Ok(bytes)
    }

    /// The error a failed read of the header is.
    pub(crate) fn read_error(&self, input: &Input, error: std::io::Error) -> Error {
        read_error(self.name, input.position(), error)
    }
}

/// Opens the volume in the file at `path`.
///
/// # Errors
///
/// If the file cannot be read, is not of a known format, contradicts itself, is too short for
/// what it claims, or needs a choice ([`OpenOptions::frame`]).
pub fn open(path: &Path, options: &OpenOptions) -> Result<Volume, Error> {
    let name = path.display().to_string();
    let cannot_open = |e| Error::io(&name, "cannot be opened", e);
    let metadata = std::fs::metadata(path).map_err(cannot_open)?;
    if metadata.is_dir() {
        return Err(Error::unsupported(
            &name,
            "is a folder; a file was expected",
        ));
    }
    let file = File::open(path).map_err(cannot_open)?;
    if !metadata.is_file() {
        return open_stream(Box::new(file), &name, options);
    }
    // Opened by its voxels, a pair is found by its header, unless these are said to be raw.
    let raw = options.raw.is_some() || options.format == Some(Format::Raw);
    if !raw && let Some(header) = nifti::header_of_image(path) {
        return open(&header, options);
    }
    let place = Place {
        name: &name,
        path,
        options,
    };
    let (mut input, compression, length) = place.begin(&file, raw_bytes(options))?;
    let plain_length = compression.is_none().then_some(length);
    let context = Context {
        name: &name,
        path: Some(path),
        options,
        length: plain_length,
    };
    let mut parsed = parse(&mut input, &context)?;
    check_extents(&parsed.header, &name)?;
    if compression.is_none() && has_extension(path, &["gz", "zst"]) {
        parsed
            .header
            .warnings
            .push(format!("{name}: named as compressed, but it is not"));
    }
    if !parsed.elsewhere.is_empty() {
        return place.open_sibling(parsed);
    }
    place.finish(parsed, file, input, compression, length)
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
    let input = Input::new(reader);
    let (mut input, compression) = decompress(input, name)?;
    let context = Context {
        name,
        path: None,
        options,
        length: None,
    };
    let parsed = parse(&mut input, &context)?;
    check_extents(&parsed.header, name)?;
    if !parsed.elsewhere.is_empty() {
        return Err(Error::unsupported(
            name,
            "this header's voxels are in another file (.img); a pair cannot be read from a stream",
        ));
    }
    let source = SourceInfo {
        name: name.to_string(),
        path: None,
        compressed: compression.is_some() || parsed.zlib,
        mapped: false,
        re_readable: false,
        length_bytes: None,
    };
    forward(parsed, input, name, options, source)
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

    /// Opens the voxels of a header that keeps them in another file.
    fn open_sibling(&self, parsed: Parsed) -> Result<Volume, Error> {
        let Some(path) = parsed.elsewhere.iter().find(|p| p.is_file()) else {
            let tried: Vec<_> = parsed
                .elsewhere
                .iter()
                .map(|p| p.display().to_string())
                .collect();
            return Err(Error::invalid(
                self.name,
                format!(
                    "the voxels are in another file, which is missing: {}",
                    tried.join(", ")
                ),
            ));
        };
        let path = path.clone();
        let name = path.display().to_string();
        let place = Place {
            name: &name,
            path: &path,
            options: self.options,
        };
        let file = File::open(&path).map_err(|e| Error::io(&name, "cannot be opened", e))?;
        let plain = parsed
            .header
            .voxels_bytes()
            .and_then(|n| n.checked_add(parsed.offset));
        let (input, compression, length) = place.begin(&file, plain)?;
        place.finish(parsed, file, input, compression, length)
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
        let mut source = SourceInfo {
            name: self.name.to_string(),
            path: Some(self.path.to_path_buf()),
            compressed: compression.is_some() || parsed.zlib,
            mapped: false,
            re_readable: true,
            length_bytes: Some(length),
        };
        if source.compressed {
            self.check_ratio(&parsed, compression, length)?;
            if parsed.maybe_eight_bytes {
                self.count_voxel_bytes(&mut parsed)?;
            }
            return forward(parsed, input, self.name, self.options, source);
        }
        drop(input);
        let Parsed {
            mut header,
            offset,
            order,
            frames_behind,
            ..
        } = parsed;
        let bytes = header.voxels_bytes().unwrap_or(u64::MAX);
        let available = length.saturating_sub(offset);
        if available < bytes {
            let plane = header.plane_bytes().unwrap_or(u64::MAX);
            return Err(ends_early(self.name, length, available, bytes, plane));
        }
        // Checked by the format: all frames together fit `u64`.
        let used = bytes.saturating_mul(frames_behind.saturating_add(1));
        if available > used {
            header
                .warnings
                .push(trailing(self.name, offset + used, available - used));
        }
        let bytes = self.reach(file)?;
        source.mapped = matches!(bytes, Bytes::Map(_));
        let voxels = StoredVoxels::new(bytes, self.name, offset, &header, order);
        Ok(Volume {
            header,
            voxels: Voxels::Random(Box::new(voxels)),
            source,
        })
    }

    /// The bytes of the file, mapped or to be read.
    fn reach(&self, file: File) -> Result<Bytes, Error> {
        let failed = |e| Error::io(self.name, "cannot be read", e);
        let map = match self.options.io {
            IoMode::Map => true,
            IoMode::Read => false,
            IoMode::Auto => !is_remote(&file),
        };
        // Address space can be short (32 bits) and guards can run out: then read.
        if map && let Ok(Some(map)) = GuardedMap::new(file.try_clone().map_err(failed)?, self.path)
        {
            return Ok(Bytes::Map(map));
        }
        let fingerprint = Fingerprint::of(&file.metadata().map_err(failed)?);
        Ok(Bytes::File {
            file,
            path: self.path.to_path_buf(),
            fingerprint,
        })
    }

    /// Refuses a volume that its compressed bytes cannot possibly hold.
    fn check_ratio(
        &self,
        parsed: &Parsed,
        compression: Option<Compression>,
        length: u64,
    ) -> Result<(), Error> {
        let single = match compression {
            Some(Compression::Gzip) => !parsed.zlib,
            Some(Compression::Zstd) => false,
            None => parsed.zlib,
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
        if parsed.zlib {
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

/// The volume of an input that runs forward.
fn forward(
    parsed: Parsed,
    mut input: Input,
    name: &str,
    options: &OpenOptions,
    source: SourceInfo,
) -> Result<Volume, Error> {
    let Parsed {
        mut header,
        offset,
        order,
        zlib,
        maybe_eight_bytes,
        frames_behind,
        ..
    } = parsed;
    let skip = offset.saturating_sub(input.position());
    let skipped = input
        .skip(skip)
        .map_err(|e| read_error(name, input.position(), e))?;
    if skipped < skip {
        return Err(Error::invalid(
            name,
            format!(
                "the data ends before the first voxel: {} bytes found, the voxels start at byte \
                 {offset}",
                input.position()
            ),
        )
        .at(input.position()));
    }
    if zlib {
        input = input.zlib().map_err(|e| read_error(name, offset, e))?;
    }
    if order == AxisOrder::XFastest && !maybe_eight_bytes {
        let voxels = StreamVoxels::new(input, name, &header, frames_behind);
        return Ok(Volume {
            header,
            voxels: Voxels::Forward(Box::new(voxels)),
            source,
        });
    }

    let why = if maybe_eight_bytes {
        "the size of a voxel is only known at the end of the stream"
    } else {
        "the array is stored with z fastest (Fortran order)"
    };
    let mut bytes = header.voxels_bytes().unwrap_or(u64::MAX);
    if maybe_eight_bytes {
        bytes = bytes.saturating_mul(2);
    }
    if bytes > options.spool_limit_bytes {
        return Err(Error::unsupported(
            name,
            format!(
                "{why}, so its {bytes} bytes of voxels would have to be held in memory, more than \
                 the limit of {}: uncompress it to a file first",
                options.spool_limit_bytes
            ),
        ));
    }
    let mut held = Vec::new();
    input
        .append(bytes, &mut held)
        .map_err(|e| read_error(name, input.position(), e))?;
    let found = held.len() as u64;
    if maybe_eight_bytes && found == bytes {
        vol::take_eight_bytes(&mut header, name);
    }
    let bytes = header.voxels_bytes().unwrap_or(u64::MAX);
    if found < bytes {
        let plane = header.plane_bytes().unwrap_or(u64::MAX);
        return Err(ends_early(name, input.position(), found, bytes, plane));
    }
    held.truncate(usize::try_from(bytes).unwrap_or(usize::MAX));
    header
        .warnings
        .extend(look_behind(&mut input, name, found - bytes, bytes, 0)?);
    let voxels = StoredVoxels::new(Bytes::Memory(held), name, 0, &header, order);
    Ok(Volume {
        header,
        voxels: Voxels::Random(Box::new(voxels)),
        source,
    })
}

/// Undoes one compression, if there is one.
pub(crate) fn decompress(
    mut input: Input,
    name: &str,
) -> Result<(Input, Option<Compression>), Error> {
    let failed = |e| read_error(name, 0, e);
    let head = input.peek(Compression::MAGIC_BYTES).map_err(failed)?;
    if head.is_empty() {
        return Err(Error::invalid(name, "is empty: 0 bytes"));
    }
    let Some(compression) = Compression::detect(head) else {
        return Ok((input, None));
    };
    let mut input = input.decompressed(compression).map_err(failed)?;
    let head = input.peek(Compression::MAGIC_BYTES).map_err(failed)?;
    if head.is_empty() {
        return Err(Error::invalid(
            name,
            format!("the {} data is empty", compression.name()),
        ));
    }
    Ok((input, Some(compression)))
}

/// Bytes of a plain file with the layout the caller gave.
fn raw_bytes(options: &OpenOptions) -> Option<u64> {
    let raw = options.raw?;
    voxel_count(raw.dims)?
        .checked_mul(raw.dtype.voxel.bytes() as u64)?
        .checked_add(raw.skip)
}

/// Reads the header: of the format asked for, of a raw layout if given, else of what is found.
fn parse(input: &mut Input, context: &Context<'_>) -> Result<Parsed, Error> {
    let format = match (context.options.format, &context.options.raw) {
        (Some(format), _) => format,
        // A layout given for a file that has its own would read the header as voxels.
        (None, Some(_)) => match detect(input, context) {
            Ok(found) => {
                return Err(Error::unsupported(
                    context.name,
                    format!(
                        "the content is {found}, which says its own dimensions and type: leave \
                         out the raw layout, or ask for format raw to read it as bare voxels"
                    ),
                ));
            }
            Err(_) => Format::Raw,
        },
        (None, None) => detect(input, context)?,
    };
    let parsed = match format {
        Format::Raw => parse_raw(context)?,
        Format::Npy => npy::parse(input, context)?,
        Format::Vol | Format::Longvol => vol::parse(input, context)?,
        Format::Nifti1 | Format::Nifti2 => nifti::parse(input, context)?,
    };
    if let Some(frame) = context.options.frame
        && frame > 0
        && !matches!(format, Format::Nifti1 | Format::Nifti2)
    {
        return Err(Error::unsupported(
            context.name,
            format!("frame {frame} was asked for, but a {format} file holds one volume"),
        ));
    }
    Ok(parsed)
}

fn parse_raw(context: &Context<'_>) -> Result<Parsed, Error> {
    let Some(raw) = context.options.raw else {
        return Err(Error::unsupported(
            context.name,
            "a raw file has no header: its dimensions and voxel type must be given",
        ));
    };
    let mut header = Header::new(Format::Raw, raw.dims, raw.dtype);
    if let Some(spacing) = raw.spacing {
        if let Some(bad) = spacing.iter().find(|s| !is_plausible_spacing(**s)) {
            return Err(Error::invalid(
                context.name,
                format!("the given spacing {bad} is not a positive length"),
            ));
        }
        header.spacing = Some(spacing);
        header.unit = raw.unit;
    }
    Ok(Parsed::new(header, raw.skip))
}

/// Whether a number can be the edge of a voxel in any unit. Beyond the bounds (an atomic nucleus
/// in metres; a light year in millimetres is 1e19) lie only fields that were never filled in.
pub(crate) fn is_plausible_spacing(spacing: f64) -> bool {
    const BOUNDS: std::ops::RangeInclusive<f64> = 1e-15..=1e15;
    BOUNDS.contains(&spacing)
}

/// Refuses extents that no memory or file can have.
fn check_extents(header: &Header, name: &str) -> Result<(), Error> {
    let [x, y, z] = header.dims;
    if x == 0 || y == 0 || z == 0 {
        return Err(Error::invalid(
            name,
            format!("the volume has {x} x {y} x {z} voxels; each extent must be at least 1"),
        ));
    }
    // Signed, as offsets in files are; a factor of two stays for intermediate sums.
    const MOST_BYTES: u64 = u64::MAX >> 2;
    if header.voxels_bytes().is_none_or(|bytes| bytes > MOST_BYTES) {
        return Err(Error::invalid(
            name,
            format!(
                "{x} x {y} x {z} voxels of {} do not fit any file",
                header.voxel
            ),
        ));
    }
    Ok(())
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension()
        .and_then(|e| e.to_str())
        .is_some_and(|e| extensions.iter().any(|known| e.eq_ignore_ascii_case(known)))
}

/// Whether a file is on a network file system, where a lost server would stall a map.
#[cfg(target_os = "linux")]
fn is_remote(file: &File) -> bool {
    use std::os::fd::AsRawFd;
    /// Magic numbers of statfs(2): NFS, SMB, CIFS, SMB2, FUSE, Lustre, 9P, AFS, Ceph, GPFS.
    const REMOTE: [u32; 10] = [
        0x6969,
        0x517b,
        0xff53_4d42,
        0xfe53_4d42,
        0x6573_5546,
        0x0bd0_0bd0,
        0x0102_1997,
        0x5346_414f,
        0x00c3_6400,
        0x4750_4653,
    ];
    // SAFETY: statfs is a plain C struct for which all zeros is valid; fstatfs fills it for an
    // open descriptor.
    let kind = unsafe {
        let mut about: libc::statfs = std::mem::zeroed();
        if libc::fstatfs(file.as_raw_fd(), &mut about) != 0 {
            return false;
        }
        about.f_type
    };
    // The field's width and sign differ between targets; the numbers have 32 bits.
    REMOTE.contains(&(kind as u32))
}

#[cfg(not(target_os = "linux"))]
fn is_remote(_: &File) -> bool {
    false
}

/// A voxel type of the given kind and size, for formats that state them apart.
pub(crate) fn voxel_type(kind: u8, bytes: u64) -> Option<VoxelType> {
    Some(match (kind, bytes) {
        (b'b', 1) => VoxelType::Bool,
        (b'u', 1) => VoxelType::U8,
        (b'u', 2) => VoxelType::U16,
        (b'u', 4) => VoxelType::U32,
        (b'u', 8) => VoxelType::U64,
        (b'i', 1) => VoxelType::I8,
        (b'i', 2) => VoxelType::I16,
        (b'i', 4) => VoxelType::I32,
        (b'i', 8) => VoxelType::I64,
        (b'f', 2) => VoxelType::F16,
        (b'f', 4) => VoxelType::F32,
        (b'f', 8) => VoxelType::F64,
        _ => return None,
    })
}
