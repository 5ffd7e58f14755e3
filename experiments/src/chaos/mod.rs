//! Whole runs in which anything may go wrong, carried by one process after the other: no kept frame is lost, nothing moves that
//! nobody decided on, every process ends, and what comes out is what an unbroken run gives.

mod disk;
mod draw;
mod judge;
mod network;
pub(crate) mod soak;
mod studio;
mod tally;
mod world;

use std::error::Error;
use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Instant;

use bladescan::journal::Recording;
use bladescan::run::{Pool, replay};
use clap::Args;
use studio::Studio;
use tally::Tally;
use world::Outcome;

#[derive(Args)]
pub(crate) struct ChaosArguments {
    /// Runs, each with one to four things that happen.
    #[arg(long, default_value_t = 200)]
    runs: u64,
    /// Seed of the first run; the others count on.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The run of this seed alone.
    #[arg(long)]
    only: Option<u64>,
    /// Tells what happens in the run of `--only`.
    #[arg(long, requires = "only")]
    trace: bool,
    /// Runs at the same time.
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Replays the recordings of so many runs at 1, 2 and 8 threads instead.
    #[arg(long)]
    replay: Option<u64>,
}

pub(crate) fn run(arguments: &ChaosArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let studio = Studio::new(&Pool::with_threads(1)?)?;
    if let Some(count) = arguments.replay {
        return replay_all(&mut out, &studio, arguments, count);
    }
    let since = Instant::now();
    let (first, count) = match arguments.only {
        Some(seed) => (seed, 1),
        None => (arguments.seed, arguments.runs),
    };
    let mut tally = Tally::default();
    for (seed, outcome) in drive_all(&studio, first, count, arguments.threads)? {
        if arguments.trace {
            tell(&mut out, &studio, seed, &outcome)?;
        }
        tally.add(&setup(&studio, seed), &outcome);
    }
    tally.print(&mut out, since.elapsed().as_secs_f64())?;
    match tally.wrong_count() {
        0 => Ok(()),
        count => Err(format!("{count} things that must not be").into()),
    }
}

fn setup(studio: &Studio, seed: u64) -> draw::Setup {
    draw::draw(seed, |view_count| studio.clean_ns(view_count))
}

/// The runs of so many seeds, in their order.
fn drive_all(
    studio: &Studio,
    first: u64,
    count: u64,
    thread_count: usize,
) -> Result<Vec<(u64, Outcome)>, Box<dyn Error>> {
    let next = AtomicU64::new(first);
    let work = || {
        let pool = Pool::with_threads(1).map_err(|error| error.to_string())?;
        let mut outcomes = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= first + count {
                return Ok(outcomes);
            }
            let mut outcome = world::drive(&setup(studio, seed), studio, &pool, None)
                .map_err(|error| format!("seed {seed}: {error}"))?;
            outcome.forget(count);
            outcomes.push((seed, outcome));
        }
    };
    let done: Vec<Result<Vec<(u64, Outcome)>, String>> = thread::scope(|scope| {
        let workers: Vec<_> = (0..thread_count).map(|_| scope.spawn(work)).collect();
        let joined = workers.into_iter().map(|worker| worker.join());
        joined
            .map(|done| done.unwrap_or_else(|_| Err("a run panicked".to_owned())))
            .collect()
    });
    let mut outcomes = Vec::new();
    for done in done {
        outcomes.extend(done?);
    }
    outcomes.sort_by_key(|(seed, _)| *seed);
    Ok(outcomes)
}

fn tell(out: &mut impl Write, studio: &Studio, seed: u64, outcome: &Outcome) -> Result<(), Box<dyn Error>> {
    writeln!(out, "{:#?}", setup(studio, seed))?;
    for (at_ns, words) in &outcome.story {
        writeln!(out, "{:10.4} s {words}", *at_ns as f64 * 1e-9)?;
    }
    writeln!(out, "{:?}\n", outcome.ended)?;
    Ok(())
}

/// Replays recordings at several numbers of threads.
fn replay_all(
    out: &mut impl Write,
    studio: &Studio,
    arguments: &ChaosArguments,
    count: u64,
) -> Result<(), Box<dyn Error>> {
    let pools = [1, 2, 8].map(Pool::with_threads);
    let (mut identical_count, mut input_count, mut job_count) = (0, 0, 0);
    for seed in arguments.seed..arguments.seed + count {
        let pool = pools[0].as_ref().map_err(|error| error.to_string())?;
        let outcome = world::drive(&setup(studio, seed), studio, pool, None)?;
        let recording = Recording::open(&outcome.recording)?;
        for pool in &pools {
            let pool = pool.as_ref().map_err(|error| error.to_string())?;
            let report = replay(&recording, pool)?;
            if !report.identical {
                let threads = pool.thread_count();
                return Err(format!("seed {seed} at {threads} threads: {:?}", report.difference).into());
            }
            identical_count += 1;
            input_count += report.input_count;
            job_count += report.job_count;
        }
    }
    writeln!(
        out,
        "{count} recordings, each replayed at 1, 2 and 8 threads: {identical_count} replays bit-identical; \
         {input_count} inputs fed, {job_count} jobs run again"
    )?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_happens_nothing_is_lost_and_nothing_moves_twice() {
        let studio = Studio::new(&Pool::with_threads(1).unwrap()).unwrap();
        for (seed, outcome) in drive_all(&studio, 1, 60, 2).unwrap() {
            assert!(outcome.wrongs.is_empty(), "seed {seed}: {:?}", outcome.wrongs);
        }
    }
}
