//! Ctrl-C and termination signals.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};

use super::exit::INTERRUPTED;

/// How long an interrupted run may take to end before the process does: it may be waiting for a
/// pipe that gives nothing. Less would cut off slabs that are nearly done.
const GRACE: Duration = Duration::from_secs(5);

/// A flag that is set by the first Ctrl-C or termination signal; the second ends the process.
pub(crate) fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let exit = || std::process::exit(i32::from(INTERRUPTED));
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            exit();
        }
        std::thread::spawn(move || {
            std::thread::sleep(GRACE);
            exit();
        });
    })
    .context("cannot listen for Ctrl-C")?;
    Ok(stop)
}
