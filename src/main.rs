//! The `curvox` binary.

fn main() {}
