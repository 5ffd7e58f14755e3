//! A day of blades, one after the other, in one process: does memory grow, do files stay open?

use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use bladescan::run::Pool;
use clap::Args;
use hw_sim::fault::Fault;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::draw::{Happening, Kind, Setup, When};
use super::studio::{Studio, unbroken_setup};
use super::world::{self, Ended};

#[derive(Args)]
pub(crate) struct SoakArguments {
    /// Hours of the cell's time.
    #[arg(long, default_value_t = 24.0)]
    hours: f64,
    /// Seed of the first run; the others count on.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Views of a blade.
    #[arg(long, default_value_t = 36)]
    views: usize,
}

/// What the process holds after a run.
struct Sample {
    run_count: u64,
    hours: f64,
    resident_kb: f64,
    file_count: f64,
}

pub(crate) fn run(arguments: &SoakArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let since = Instant::now();
    let pool = Pool::with_threads(1)?;
    let studio = Studio::new(&pool)?;
    let folder = std::env::temp_dir().join(format!("bladescan-soak-{}", std::process::id()));
    let clean = world::drive(&unbroken_setup(&vec![0; arguments.views]), &studio, &pool, None)?;
    studio.unbroken(&vec![0; arguments.views], &pool)?;
    studio.complete();
    let (mut samples, mut hours, mut process_count, mut finished_count, mut wrongs) =
        (Vec::new(), 0.0, 0, 0, Vec::new());
    while hours < arguments.hours {
        let run_count = samples.len() as u64;
        let setup = draw(arguments.seed + run_count, arguments.views, clean.end_ns);
        fs::create_dir_all(&folder)?;
        let outcome = world::drive(&setup, &studio, &pool, Some(&folder));
        fs::remove_dir_all(&folder)?;
        let outcome = outcome?;
        hours += (outcome.end_ns as f64 * 1e-9 + BLADE_CHANGE_S) / 3600.0;
        process_count += outcome.process_count;
        finished_count += u64::from(outcome.ended == Ended::Finished);
        wrongs.extend(
            outcome
                .wrongs
                .into_iter()
                .map(|(bar, about)| (setup.seed, bar.name(), about)),
        );
        samples.push(held(run_count + 1, hours)?);
        if let Some(sample) = samples.last().filter(|_| run_count.is_multiple_of(SHOWN_EVERY)) {
            writeln!(
                out,
                "{} runs, {:.2} h: {:.0} kB resident, {} files open; {:.0} s",
                sample.run_count,
                sample.hours,
                sample.resident_kb,
                sample.file_count,
                since.elapsed().as_secs_f64()
            )?;
        }
    }
    writeln!(
        out,
        "{} runs of {} views by {process_count} processes, {finished_count} finished; {} wrong {:?}",
        samples.len(),
        arguments.views,
        wrongs.len(),
        wrongs.iter().take(5).collect::<Vec<_>>()
    )?;
    let steady = &samples[samples.len() / 2..];
    print_slope(&mut out, "resident memory, kB", steady, |sample| sample.resident_kb)?;
    print_slope(&mut out, "open files", steady, |sample| sample.file_count)?;
    match wrongs.len() {
        0 => Ok(()),
        count => Err(format!("{count} things that must not be").into()),
    }
}

/// Now and then something happens to a run, and a retake is needed.
fn draw(seed: u64, view_count: usize, clean_ns: u64) -> Setup {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut setup = Setup {
        seed,
        is_replayed: seed.is_multiple_of(REPLAYED_EVERY),
        ..unbroken_setup(&vec![0; view_count])
    };
    for (kind, fraction) in HAPPENINGS {
        if chance.random::<f64>() < fraction {
            setup.happenings.push(Happening {
                kind,
                when: When::At(chance.random_range(0..clean_ns)),
                span_ns: chance.random_range(200_000_000..5_000_000_000),
                size: chance.random(),
            });
        }
    }
    if chance.random::<f64>() < RETAKE_FRACTION {
        let fault = format!("missed-trigger@{}", chance.random_range(0..view_count));
        setup.camera_faults.extend(fault.parse::<Fault>());
    }
    setup
}

fn held(run_count: u64, hours: f64) -> Result<Sample, Box<dyn Error>> {
    let pages: f64 = fs::read_to_string("/proc/self/statm")?
        .split_whitespace()
        .nth(1)
        .ok_or("statm has no second number")?
        .parse()?;
    Ok(Sample {
        run_count,
        hours,
        resident_kb: pages * PAGE_KB,
        file_count: fs::read_dir(Path::new("/proc/self/fd"))?.count() as f64,
    })
}

/// Least squares, with the standard error of the slope.
fn print_slope(
    out: &mut impl Write,
    name: &str,
    samples: &[Sample],
    value: impl Fn(&Sample) -> f64,
) -> std::io::Result<()> {
    let count = samples.len() as f64;
    let mean_x = samples.iter().map(|sample| sample.run_count as f64).sum::<f64>() / count;
    let mean_y = samples.iter().map(&value).sum::<f64>() / count;
    let (mut xx, mut xy) = (0.0, 0.0);
    for sample in samples {
        let x = sample.run_count as f64 - mean_x;
        xx += x * x;
        xy += x * (value(sample) - mean_y);
    }
    let slope = xy / xx;
    let rest = |sample: &Sample| value(sample) - mean_y - slope * (sample.run_count as f64 - mean_x);
    let noise = samples.iter().map(|sample| rest(sample).powi(2)).sum::<f64>() / (count - 2.0);
    let hours = samples.last().map_or(0.0, |last| last.hours) - samples.first().map_or(0.0, |first| first.hours);
    let per_day = (count - 1.0) / hours * 24.0;
    writeln!(
        out,
        "{name}: {mean_y:.1} on average, {slope:+.4} ± {:.4} a run, {:+.1} ± {:.1} a day; scatter {:.1}",
        (noise / xx).sqrt(),
        slope * per_day,
        (noise / xx).sqrt() * per_day,
        noise.sqrt()
    )
}

/// How often a thing happens to a run.
const HAPPENINGS: [(Kind, f64); 7] = [
    (Kind::Hold, 0.2),
    (Kind::HoldAfterView, 0.1),
    (Kind::Alarm, 0.02),
    (Kind::Door, 0.02),
    (Kind::RobotPower, 0.01),
    (Kind::PendantHold, 0.05),
    (Kind::Abort, 0.02),
];
const RETAKE_FRACTION: f64 = 0.05;
/// How long it takes to put the next blade in.
const BLADE_CHANGE_S: f64 = 300.0;
const SHOWN_EVERY: u64 = 50;
/// A replay does all jobs again, which takes longer than the run.
const REPLAYED_EVERY: u64 = 100;
const PAGE_KB: f64 = 4.0;
