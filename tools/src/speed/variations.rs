//! Tables of growth, of threads, of bricks and memory, of empty space.

use std::hint::black_box;

use anyhow::Result;
use curvox::measure::ball::Extent;
use curvox::pipeline::Settings;

use super::SpeedArgs;
use super::clock::{median, timed};
use super::runs::{self, Destination, Finished, Method};
use super::subject::Subject;
use crate::paper::slopes::exponent;

/// Edges of bricks, in voxels; `None` is the plan's own choice.
const BRICKS: [Option<i32>; 6] = [None, Some(16), Some(32), Some(64), Some(128), Some(256)];

/// Memory allowed, in MiB.
const MEMORIES: [u64; 5] = [128, 256, 512, 1024, 4096];

/// Radius of the table of bricks and memory, in voxels: the default of the command.
const BRICK_RADIUS: f64 = 6.0;

/// Voxels of the empty volume along x, y, z: planes large enough that a brick is small beside them.
const EMPTY: [usize; 3] = [2048, 2048, 64];

fn connected(subject: &Subject, method: Method, radius: f64) -> Result<Settings> {
    runs::settings(subject, method, Extent::Connected, radius)
}

fn dropped(subject: &Subject, settings: &Settings) -> Result<Finished> {
    runs::once(subject, settings, Destination::Dropped)
}

pub(super) fn print_growth(args: &SpeedArgs) -> Result<()> {
    println!(
        "Goursat's surface at the paper's radius 3 h^(-1/2) voxels: processor time of whole runs, and the exponent b of \
         time ~ surfels^b from the line before.\n"
    );
    println!("| method | h | surfels | radius | us a surfel | b |");
    println!("|---|---|---|---|---|---|");
    let subjects: Result<Vec<Subject>> = (args.growth.iter())
        .map(|&gridstep| Subject::goursat(gridstep, 0.0))
        .collect();
    let subjects = subjects?;
    let radius = |gridstep: f64| 3.0 / gridstep.sqrt();
    for &method in &args.methods {
        let mut finished: Vec<Vec<Finished>> = vec![Vec::new(); subjects.len()];
        for _ in 0..args.repeats {
            for (i, subject) in subjects.iter().enumerate() {
                let settings = connected(subject, method, radius(args.growth[i]))?;
                finished[i].push(dropped(subject, &settings)?);
            }
        }
        // Surfels and seconds.
        let points: Vec<(f64, f64)> = finished
            .iter()
            .map(|runs| {
                let seconds: Vec<f64> = runs.iter().map(|run| run.time.cpu).collect();
                let surfels = runs.first().map_or(0, |run| run.surfels);
                (surfels as f64, median(&seconds))
            })
            .collect();
        for (i, (&gridstep, &(surfels, seconds))) in args.growth.iter().zip(&points).enumerate() {
            let b = i
                .checked_sub(1)
                .and_then(|before| exponent(&points[before..=i]));
            println!(
                "| {} | {gridstep} | {surfels} | {:.2} | {:.2} | {} |",
                method.name(),
                radius(gridstep),
                seconds / surfels * 1e6,
                b.map_or(String::new(), |b| format!("{b:.2}"))
            );
        }
        if let Some(b) = exponent(&points) {
            println!("| {} | all | | | | {b:.2} |", method.name());
        }
    }
    println!();
    Ok(())
}

pub(super) fn print_threads(args: &SpeedArgs) -> Result<()> {
    let subject = Subject::goursat(args.gridstep, 0.0)?;
    println!(
        "{}: seconds on the clock with one and two threads.\n",
        subject.name
    );
    println!("| method | radius | one | two | one / two |");
    println!("|---|---|---|---|---|");
    for &method in &args.methods {
        for &radius in &args.radii {
            let one = connected(&subject, method, radius)?;
            let two = Settings {
                threads: 2,
                ..one.clone()
            };
            let mut seconds = [Vec::new(), Vec::new()];
            for _ in 0..args.repeats {
                for (settings, seconds) in [&one, &two].into_iter().zip(&mut seconds) {
                    seconds.push(dropped(&subject, settings)?.time.wall);
                }
            }
            let [one, two] = seconds.map(|seconds| median(&seconds));
            println!(
                "| {} | {radius} | {one:.2} | {two:.2} | {:.2} |",
                method.name(),
                one / two
            );
        }
    }
    println!();
    Ok(())
}

pub(super) fn print_bricks(args: &SpeedArgs) -> Result<()> {
    let subject = Subject::goursat(args.gridstep, 0.0)?;
    println!(
        "{}, radius of {BRICK_RADIUS} voxels: processor time, microseconds a surfel.\n",
        subject.name
    );
    let names = BRICKS.map(|brick| match brick {
        Some(edge) => format!("bricks of {edge}"),
        None => "as planned".into(),
    });
    println!("| method | memory, MiB | {} |", names.join(" | "));
    println!("|---|---|{}", "---|".repeat(BRICKS.len()));
    for &method in &args.methods {
        let mut times = vec![[const { Vec::new() }; BRICKS.len()]; MEMORIES.len()];
        for _ in 0..args.repeats {
            for (memory, times) in MEMORIES.iter().zip(&mut times) {
                for (&brick, times) in BRICKS.iter().zip(times) {
                    let settings = Settings {
                        memory_bytes: memory << 20,
                        brick,
                        ..connected(&subject, method, BRICK_RADIUS)?
                    };
                    // Little memory does not hold large bricks: there is no number then.
                    if let Ok(finished) = dropped(&subject, &settings) {
                        times.push(finished.microseconds());
                    }
                }
            }
        }
        for (memory, times) in MEMORIES.iter().zip(&times) {
            let cells = times.each_ref().map(|times| match times.len() {
                0 => "-".into(),
                _ => format!("{:.2}", median(times)),
            });
            println!("| {} | {memory} | {} |", method.name(), cells.join(" | "));
        }
    }
    println!();
    Ok(())
}

pub(super) fn print_empty(args: &SpeedArgs) -> Result<()> {
    let subject = Subject::empty(EMPTY);
    let settings = connected(&subject, Method::Default, BRICK_RADIUS)?;
    // Written once before, so that the system has given its pages.
    let mut copy = vec![1u8; subject.stored.len()];
    let (mut copied, mut read) = (Vec::new(), Vec::new());
    for _ in 0..args.repeats {
        let ((), time) = timed(|| black_box(&mut copy).copy_from_slice(black_box(&subject.stored)));
        copied.push(time.cpu);
        read.push(dropped(&subject, &settings)?.time.cpu);
    }
    let gigabytes = subject.stored.len() as f64 * 1e-9;
    let [copied, read] = [copied, read].map(|seconds| median(&seconds));
    println!("Nothing in {EMPTY:?} bytes: processor seconds a gigabyte.\n");
    println!("| copied in memory | read, packed, searched | ratio |");
    println!("|---|---|---|");
    println!(
        "| {:.3} | {:.3} | {:.2} |\n",
        copied / gigabytes,
        read / gigabytes,
        read / copied
    );
    Ok(())
}
