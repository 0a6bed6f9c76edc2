//! Any bytes, as a file: mapped, read at offsets.
#![no_main]

use curvox_formats::open;
use curvox_formats_fuzz::{look_into, options};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let folder = tempfile::tempdir().expect("a folder for the file");
    let path = folder.path().join("fuzz");
    std::fs::write(&path, data).expect("the file is written");
    look_into(open(&path, &options()));
});
