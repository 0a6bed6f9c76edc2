//! The shared folder: same volumes in many formats, broken files, real files.
