//! How far the run is: a bar on a terminal, JSON lines with `--json`, else nothing.

use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use serde_json::json;

use crate::pipeline::Progress;

use super::sizes;

/// Time between two looks.
const PERIOD: Duration = Duration::from_millis(100);

/// Looks between two JSON lines.
const LOOKS_PER_LINE: u32 = 10;

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Style {
    /// Not at all.
    None,
    /// A bar on standard error.
    Bar,
    /// A JSON line on standard error every second.
    Lines,
}

impl Style {
    /// The style that fits standard error and the options.
    pub(crate) fn choose(quiet: bool, json: bool, verbose: bool) -> Self {
        if quiet {
            Self::None
        } else if json {
            Self::Lines
        } else if !verbose && std::io::stderr().is_terminal() {
            Self::Bar
        } else {
            Self::None
        }
    }
}

impl Style {
    /// For what goes before the run: a bar, but no lines that would look like those of the run.
    pub(crate) fn of_bar(self) -> Self {
        if self == Self::Bar { self } else { Self::None }
    }
}

/// Shows progress until `done` is set; `planes` is the number of planes of the run.
pub(crate) fn show(style: Style, progress: &Progress, planes: u64, done: &AtomicBool) {
    let load = |n: &std::sync::atomic::AtomicU64| n.load(Ordering::Relaxed);
    let started = Instant::now();
    let bar = match style {
        Style::None => return,
        Style::Lines => ProgressBar::hidden(),
        Style::Bar => ProgressBar::new(planes),
    };
    let style_of_bar = ProgressStyle::with_template(
        "{wide_bar} {percent:>3}%  plane {pos}/{len}  {elapsed}  {msg}",
    );
    if let Ok(style) = style_of_bar {
        bar.set_style(style);
    }
    let mut look = 0u32;
    while !done.load(Ordering::Relaxed) {
        match style {
            Style::Bar => {
                let planes_done = load(&progress.planes_done);
                bar.set_position(planes_done);
                let surfels = sizes::count(load(&progress.surfels_found));
                // Before the first plane is done nothing is known of the speed.
                let left = if planes_done > 0 {
                    format!(", about {} left", HumanDuration(bar.eta()))
                } else {
                    String::new()
                };
                bar.set_message(format!("{surfels} surfels{left}"));
            }
            Style::Lines if look > 0 && look.is_multiple_of(LOOKS_PER_LINE) => {
                let line = json!({
                    "event": "progress",
                    "planes": planes,
                    "planes_read": load(&progress.planes_read),
                    "planes_done": load(&progress.planes_done),
                    "surfels_found": load(&progress.surfels_found),
                    "rows_done": load(&progress.rows_done),
                    "seconds": started.elapsed().as_secs_f64(),
                });
                // Nobody may be reading; the run goes on all the same.
                let _ = writeln!(std::io::stderr(), "{line}");
            }
            _ => {}
        }
        look += 1;
        std::thread::park_timeout(PERIOD);
    }
    bar.finish_and_clear();
}

/// Shows how many of `faces` are done until `done` is set.
pub(crate) fn show_faces(style: Style, faces_done: &AtomicU64, faces: u64, done: &AtomicBool) {
    let started = Instant::now();
    let bar = match style {
        Style::None => return,
        Style::Lines => ProgressBar::hidden(),
        Style::Bar => ProgressBar::new(faces),
    };
    let style_of_bar =
        ProgressStyle::with_template("{wide_bar} {percent:>3}%  face {pos}/{len}  {elapsed}");
    if let Ok(style) = style_of_bar {
        bar.set_style(style);
    }
    let mut look = 0u32;
    while !done.load(Ordering::Relaxed) {
        let faces_done = faces_done.load(Ordering::Relaxed);
        bar.set_position(faces_done);
        if style == Style::Lines && look > 0 && look.is_multiple_of(LOOKS_PER_LINE) {
            let line = json!({
                "event": "progress",
                "faces": faces,
                "faces_done": faces_done,
                "seconds": started.elapsed().as_secs_f64(),
            });
            // Nobody may be reading; the run goes on all the same.
            let _ = writeln!(std::io::stderr(), "{line}");
        }
        look += 1;
        std::thread::park_timeout(PERIOD);
    }
    bar.finish_and_clear();
}

/// Runs `work` while another thread runs `show`, which ends when its flag is set and it is unparked.
pub(crate) fn watched<T>(show: impl FnOnce(&AtomicBool) + Send, work: impl FnOnce() -> T) -> T {
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        /// Ends the watch, also when the work panics.
        struct End<'a>(&'a AtomicBool, std::thread::Thread);
        impl Drop for End<'_> {
            fn drop(&mut self) {
                self.0.store(true, Ordering::Relaxed);
                self.1.unpark();
            }
        }
        let watch = scope.spawn(|| show(&done));
        let end = End(&done, watch.thread().clone());
        let result = work();
        drop(end);
        result
    })
}
