//! Folders of a few files: the first byte says which format, then metadata and pieces, each with
//! its length before it.
#![no_main]

use curvox_formats::open;
use curvox_formats_fuzz::{look_into, options};
use libfuzzer_sys::fuzz_target;

/// The next piece of the input, with two bytes of length before it.
fn piece<'a>(data: &mut &'a [u8]) -> &'a [u8] {
    let Some((length, rest)) = data.split_first_chunk::<2>() else {
        return std::mem::take(data);
    };
    let length = usize::from(u16::from_le_bytes(*length)).min(rest.len());
    let (piece, rest) = rest.split_at(length);
    *data = rest;
    piece
}

fuzz_target!(|data: &[u8]| {
    let Some((kind, mut rest)) = data.split_first() else {
        return;
    };
    let names: &[&str] = match kind % 6 {
        0 => &[".zarray", "0.0.0", "0.0.1"],
        1 => &["zarr.json", "c/0/0/0", "c/0/0/1"],
        2 => &["zarr.json", "0/zarr.json", "0/c/0/0/0"],
        3 => &["attributes.json", "0/0/0", "1/0/0"],
        4 => &["a1.tif", "a2.tif", "a10.tif"],
        _ => &["1.dcm", "2.dcm", "3.dcm"],
    };
    let folder = tempfile::tempdir().expect("a folder for the files");
    for name in names {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("below the folder")).expect("a folder");
        std::fs::write(&path, piece(&mut rest)).expect("the file is written");
    }
    look_into(open(folder.path(), &options()));
});
