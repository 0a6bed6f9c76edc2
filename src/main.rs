//! The `curvox` binary.

fn main() -> std::process::ExitCode {
    curvox::cli::main()
}
