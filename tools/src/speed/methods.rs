//! The table of methods by radius.

use anyhow::Result;
use curvox::measure::ball::Extent;

use super::SpeedArgs;
use super::clock::{median, spread};
use super::runs::{self, Destination, Method};
use super::subject::Subject;
use super::walks::Plain;

/// A solid, ready for both.
struct Prepared {
    subject: Subject,
    plain: Plain,
}

/// Microseconds a surfel of one method at one radius on one solid, each as often as it was repeated.
#[derive(Default)]
struct Times {
    plain_normals: Vec<f64>,
    plain_sums: Vec<f64>,
    plain_rest: Vec<f64>,
    dropped: Vec<f64>,
    parquet: Vec<f64>,
    whole: Vec<f64>,
}

impl Times {
    fn add(
        &mut self,
        Prepared { subject, plain }: &Prepared,
        method: Method,
        radius: f64,
        sample: usize,
    ) -> Result<()> {
        let time = plain.time(method, radius, sample);
        self.plain_normals.push(time.normals);
        self.plain_sums.push(time.sums);
        self.plain_rest.push(time.rest);
        let connected = runs::settings(subject, method, Extent::Connected, radius)?;
        let whole = runs::settings(subject, method, Extent::Whole, radius)?;
        for (settings, destination, times) in [
            (&connected, Destination::Dropped, &mut self.dropped),
            (&whole, Destination::Dropped, &mut self.whole),
            (&connected, Destination::Parquet, &mut self.parquet),
        ] {
            times.push(runs::once(subject, settings, destination)?.microseconds());
        }
        Ok(())
    }

    fn all(&self) -> [&Vec<f64>; 6] {
        [
            &self.plain_normals,
            &self.plain_sums,
            &self.plain_rest,
            &self.dropped,
            &self.parquet,
            &self.whole,
        ]
    }
}

pub(super) fn print(args: &SpeedArgs) -> Result<()> {
    let mut subjects = vec![Subject::goursat(args.gridstep, 0.0)?];
    if args.noise > 0.0 {
        subjects.push(Subject::goursat(args.gridstep, args.noise)?);
    }
    let is_noisy = |i: usize| args.noise > 0.0 && i == 1;
    for spec in &args.volumes {
        subjects.push(Subject::of_file(spec)?);
    }
    let prepared: Vec<Prepared> = subjects
        .into_iter()
        .map(|subject| Prepared {
            plain: Plain::new(subject.solid()),
            subject,
        })
        .collect();
    println!(
        "Processor time, microseconds a surfel, one thread; plain: normals + sums + all else, walks on {} surfels.\n",
        args.sample
    );
    println!(
        "| solid | surfels | method | radius | plain | curvox | into Parquet | plain walks / curvox | all plain / curvox | \
         noise / smooth | whole ball | connected / whole |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut worst: f64 = 0.0;
    for &method in &args.methods {
        for &radius in &args.radii {
            let mut times: Vec<Times> = prepared.iter().map(|_| Times::default()).collect();
            for _ in 0..args.repeats {
                for (prepared, times) in prepared.iter().zip(&mut times) {
                    times.add(prepared, method, radius, args.sample)?;
                }
            }
            let smooth = median(&times[0].dropped);
            for (i, (prepared, times)) in prepared.iter().zip(&times).enumerate() {
                let [normals, sums, rest, dropped, parquet, whole] =
                    times.all().map(|times| median(times));
                worst = times
                    .all()
                    .map(|times| spread(times))
                    .into_iter()
                    .fold(worst, f64::max);
                let noise = if is_noisy(i) {
                    format!("{:.2}", dropped / smooth)
                } else {
                    String::new()
                };
                println!(
                    "| {} | {} | {} | {radius} | {normals:.2} + {sums:.2} + {rest:.2} | {dropped:.2} | {parquet:.2} | {:.1} | {:.1} | \
                     {noise} | {whole:.2} | {:.2} |",
                    prepared.subject.name,
                    prepared.plain.surfels(),
                    method.name(),
                    (normals + sums) / dropped,
                    (normals + sums + rest) / dropped,
                    dropped / whole,
                );
            }
        }
    }
    println!(
        "\nMedians of {}; largest less smallest over the median, at worst: {worst:.2}.\n",
        args.repeats
    );
    Ok(())
}
