//! Exit codes, and which error gives which.

use std::io::{self, Write};

use curvox_formats::ErrorKind;

use crate::error::Error;
use crate::lattice::LatticeError;
use crate::sink::SinkError;

/// All is written.
pub(crate) const DONE: u8 = 0;
/// The run failed, or the output could not be written.
pub(crate) const FAILED: u8 = 1;
/// The command line makes no sense, or asks for what cannot be.
pub(crate) const USAGE: u8 = 2;
/// The input is damaged, cut short, unreadable or of no known format.
pub(crate) const BAD_INPUT: u8 = 3;
/// Stopped by Ctrl-C or a termination signal.
pub(crate) const INTERRUPTED: u8 = 130;

/// A command line that cannot be followed; says what to write instead.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Usage(pub(crate) String);

/// An input that can be opened but not used.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct BadInput(pub(crate) String);

/// A [`Usage`] error.
pub(crate) fn usage(message: impl Into<String>) -> anyhow::Error {
    Usage(message.into()).into()
}

/// An error of writing a text to standard output.
pub(crate) fn stdout_error(source: io::Error) -> anyhow::Error {
    SinkError::io(std::path::Path::new("standard output"), "write", source).into()
}

/// Writes a text to standard output.
pub(crate) fn print(text: &str) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(stdout_error)
}

/// An error and its causes on one line; a cause that is told already is not told twice.
pub(crate) fn message(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        if text.is_empty() {
            text = cause;
        } else if !tells(&text, &cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

/// Whether a text says what a cause says, but for the system's number of it.
fn tells(text: &str, cause: &str) -> bool {
    let words = cause.split(" (os error").next().unwrap_or(cause);
    text.to_lowercase().contains(&words.to_lowercase())
}

/// The exit code of an error. 0 for a reader of a pipe that went away: it has all it wanted.
pub(crate) fn code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if cause.is::<Usage>() {
            return USAGE;
        }
        if cause.is::<BadInput>() {
            return BAD_INPUT;
        }
        if let Some(error) = cause.downcast_ref::<Error>() {
            return code_of_run(error);
        }
        if let Some(error) = cause.downcast_ref::<SinkError>() {
            return code_of_sink(error);
        }
        if let Some(error) = cause.downcast_ref::<curvox_formats::Error>() {
            return code_of_input(error);
        }
    }
    FAILED
}

fn code_of_run(error: &Error) -> u8 {
    match error {
        Error::Input(error) => code_of_input(error),
        Error::Sink(error) => code_of_sink(error),
        Error::Lattice(
            LatticeError::Radius(_) | LatticeError::Sigma { .. } | LatticeError::Ball { .. },
        )
        | Error::Plan(_) => USAGE,
        Error::Lattice(_) => BAD_INPUT,
        Error::Stopped => INTERRUPTED,
        _ => FAILED,
    }
}

fn code_of_input(error: &curvox_formats::Error) -> u8 {
    match error.kind() {
        ErrorKind::Cancelled => INTERRUPTED,
        _ => BAD_INPUT,
    }
}

fn code_of_sink(error: &SinkError) -> u8 {
    match error {
        SinkError::BrokenPipe { .. } => DONE,
        SinkError::Unsupported(_) => USAGE,
        // Only what `info` reads back can be damaged or incomplete.
        SinkError::Damaged { .. } | SinkError::Incomplete { .. } => BAD_INPUT,
        _ => FAILED,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_told_once() {
        let full = io::Error::other("disk on fire");
        let error = anyhow::Error::from(curvox_formats::Error::io("a.nii", "cannot be read", full));
        assert_eq!(message(&error), "a.nii: cannot be read: disk on fire");
        let error = error.context("first");
        assert_eq!(
            message(&error),
            "first: a.nii: cannot be read: disk on fire"
        );
    }

    #[test]
    fn codes_follow_the_kind_of_error_through_contexts() {
        let error = usage("no").context("while reading the arguments");
        assert_eq!(code(&error), USAGE);
        let input = curvox_formats::Error::invalid("a.npy", "cut");
        assert_eq!(code(&Error::Input(input).into()), BAD_INPUT);
        assert_eq!(code(&Error::Stopped.into()), INTERRUPTED);
        assert_eq!(
            code(&Error::Lattice(LatticeError::Radius(0.0)).into()),
            USAGE
        );
        let gone = stdout_error(io::ErrorKind::BrokenPipe.into());
        assert_eq!(code(&gone), DONE);
        let full = stdout_error(io::ErrorKind::StorageFull.into());
        assert_eq!(code(&full), FAILED);
        assert_eq!(code(&anyhow::anyhow!("else")), FAILED);
    }
}
