//! Any bytes, from a pipe.
#![no_main]

use curvox_formats::open_stream;
use curvox_formats_fuzz::{look_into, options};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let reader = Box::new(std::io::Cursor::new(data.to_vec()));
    look_into(open_stream(reader, "fuzz", &options()));
});
