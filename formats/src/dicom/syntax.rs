//! Transfer syntaxes: how pixels are stored.

/// How pixels are stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Syntax {
    /// As they are.
    Native,
    /// As they are, in a data set that is deflated as a whole.
    Deflated,
    /// In fragments.
    Encapsulated(Codec),
    /// In a way that is not read; what it is called.
    Refused(String),
}

/// What fragments hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    Plain,
    Rle,
    /// Lossless or by DCT: the data says.
    Jpeg {
        lossy: bool,
    },
    JpegLs {
        lossy: bool,
    },
    Jpeg2000 {
        lossy: bool,
    },
}

impl Syntax {
    /// The syntax with a UID. A file without one is taken as native: its first element tells
    /// the encoding.
    pub(super) fn of(uid: &str) -> Self {
        const ROOT: &str = "1.2.840.10008.1.2";
        let Some(rest) = uid.strip_prefix(ROOT) else {
            return if uid.is_empty() {
                Self::Native
            } else {
                Self::Refused(format!("transfer syntax {uid}"))
            };
        };
        let named = |name: &str| Self::Refused(format!("{name} (transfer syntax {uid})"));
        match rest {
            "" | ".1" | ".2" => Self::Native,
            ".1.98" => Self::Encapsulated(Codec::Plain),
            ".1.99" => Self::Deflated,
            ".4.50" | ".4.51" => Self::Encapsulated(Codec::Jpeg { lossy: true }),
            ".4.57" | ".4.70" => Self::Encapsulated(Codec::Jpeg { lossy: false }),
            ".4.80" => Self::Encapsulated(Codec::JpegLs { lossy: false }),
            ".4.81" => Self::Encapsulated(Codec::JpegLs { lossy: true }),
            ".4.90" => Self::Encapsulated(Codec::Jpeg2000 { lossy: false }),
            ".4.91" => Self::Encapsulated(Codec::Jpeg2000 { lossy: true }),
            ".5" => Self::Encapsulated(Codec::Rle),
            ".4.92" | ".4.93" => named("JPEG 2000 part 2"),
            ".4.201" | ".4.202" | ".4.203" => named("high-throughput JPEG 2000"),
            ".4.110" | ".4.111" | ".4.112" => named("JPEG XL"),
            ".4.94" | ".4.95" => named("JPIP: pixels on a server"),
            rest if rest.starts_with(".4.10") => named("video"),
            rest if rest.starts_with(".4.") => named("a retired JPEG process"),
            _ => Self::Refused(format!("transfer syntax {uid}")),
        }
    }

    pub(super) fn is_lossy(&self) -> bool {
        matches!(
            self,
            Self::Encapsulated(
                Codec::Jpeg { lossy: true }
                    | Codec::JpegLs { lossy: true }
                    | Codec::Jpeg2000 { lossy: true }
            )
        )
    }

    /// The name of the compression in print.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Native => "none",
            Self::Deflated => "deflate",
            Self::Encapsulated(Codec::Plain) => "none, in fragments",
            Self::Encapsulated(Codec::Rle) => "RLE",
            Self::Encapsulated(Codec::Jpeg { lossy: true }) => "JPEG, lossy",
            Self::Encapsulated(Codec::Jpeg { lossy: false }) => "JPEG lossless",
            Self::Encapsulated(Codec::JpegLs { lossy: true }) => "JPEG-LS, near-lossless",
            Self::Encapsulated(Codec::JpegLs { lossy: false }) => "JPEG-LS lossless",
            Self::Encapsulated(Codec::Jpeg2000 { lossy: true }) => "JPEG 2000, lossy allowed",
            Self::Encapsulated(Codec::Jpeg2000 { lossy: false }) => "JPEG 2000 lossless",
            Self::Refused(name) => name,
        }
    }
}
