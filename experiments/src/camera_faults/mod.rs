//! Whole runs against a camera that goes wrong, many times: nothing wrong may become data, and every run ends.

pub(crate) mod judge;
pub(crate) mod run;
pub(crate) mod setup;
mod sockets;
pub(crate) mod virtual_time;

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;
use std::time::Instant;

use clap::Args;
use hw_sim::blade::Builtin;
use hw_sim::camera::render::{Renderer, Surface};
use hw_sim::camera::trouble::Phase;
use rayon::prelude::*;
use run::{Darkroom, Ended, Outcome};
use setup::{Setup, Spans};

#[derive(Args)]
pub(crate) struct CameraFaultsArguments {
    /// Runs on virtual time, each with one to four faults.
    #[arg(long, default_value_t = 2000)]
    runs: u64,
    /// Seed of the first run; the others count on.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Runs over sockets instead, in real time.
    #[arg(long, value_name = "RUNS")]
    sockets: Option<u64>,
    /// Prints what comes of each fault at each phase, each alone in a run, instead.
    #[arg(long)]
    phases: bool,
    /// Prints what the run of `--seed` told, and no table.
    #[arg(long)]
    trace: bool,
}

/// What came of the runs in which one fault happened at one phase.
#[derive(Default)]
struct Row {
    met_count: u64,
    finished_count: u64,
    retaken_count: u64,
    reconnected_count: u64,
    fetched_count: u64,
    missing_count: u64,
    stopped: BTreeMap<&'static str, u64>,
}

/// What came of all runs.
#[derive(Default)]
struct Tally {
    /// What a row counts of its fault.
    happening: &'static str,
    run_count: u64,
    finished_count: u64,
    hung_count: u64,
    accepted_count: u64,
    wrong_count: usize,
    partial_count: usize,
    duplicate_count: usize,
    /// Runs that told something else when they were made again.
    unlike_count: u64,
    longest_ns: u64,
    rows: BTreeMap<(String, Option<Phase>), Row>,
    /// Seeds of the runs that stopped with each fault.
    stopped_seeds: BTreeMap<&'static str, Vec<u64>>,
    wrongs: Vec<(u64, String)>,
}

pub(crate) fn run(arguments: &CameraFaultsArguments) -> Result<(), Box<dyn Error>> {
    let renderer = Renderer::new(&Builtin::HptA.mesh(), Surface::matte())?;
    let darkroom = Darkroom::new(renderer);
    let mut out = std::io::stdout().lock();
    if arguments.trace {
        let setup = setup::draw(arguments.seed, ON_VIRTUAL_TIME);
        return trace(&mut out, &setup, &virtual_time::drive(&setup, &darkroom)?);
    }
    if arguments.phases {
        return each_alone(&mut out, &darkroom);
    }
    let since = Instant::now();
    let tally = match arguments.sockets {
        Some(run_count) => sockets::drive_all(arguments.seed, run_count, darkroom, |setup, outcome| {
            Tally::of(setup, outcome)
        })?
        .into_iter()
        .fold(Tally::default(), Tally::joined),
        None => (arguments.seed..arguments.seed + arguments.runs)
            .into_par_iter()
            .map(|seed| {
                let setup = setup::draw(seed, ON_VIRTUAL_TIME);
                let outcome = virtual_time::drive(&setup, &darkroom)?;
                let mut tally = Tally::of(&setup, &outcome);
                if seed.is_multiple_of(REPEATED_EVERY) {
                    let again = virtual_time::drive(&setup, &darkroom)?;
                    if outcome.told() != again.told() {
                        tally.unlike_count += 1;
                        tally
                            .wrongs
                            .push((seed, "told something else when made again".to_owned()));
                    }
                }
                Ok::<_, String>(tally)
            })
            .try_reduce(Tally::default, |one, other| Ok(one.joined(other)))?,
    };
    tally.print(&mut out, since.elapsed().as_secs_f64())?;
    if tally.wrongs.is_empty() {
        Ok(())
    } else {
        Err(format!("{} runs went wrong", tally.wrongs.len()).into())
    }
}

/// One run for each fault and phase.
fn each_alone(out: &mut impl Write, darkroom: &Darkroom) -> Result<(), Box<dyn Error>> {
    writeln!(
        out,
        "| fault | ends | connections | FETCH | retakes | views without a frame | run |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|")?;
    let outcomes = setup::each_alone(ON_VIRTUAL_TIME)
        .into_par_iter()
        .map(|setup| virtual_time::drive(&setup, darkroom).map(|outcome| (setup, outcome)))
        .collect::<Result<Vec<_>, _>>()?;
    let mut wrong_count = 0;
    for (setup, outcome) in outcomes {
        let wrongs = outcome.wrongs();
        wrong_count += wrongs.len();
        writeln!(
            out,
            "| {} | {:?} | {} | {} | {} | {} | {:.1} s |{}",
            setup.faults[0],
            outcome.ended,
            outcome.connect_count,
            outcome.fetch_count,
            outcome.retake_count,
            outcome.missing_count,
            outcome.end_ns as f64 * 1e-9,
            wrongs.join("; ")
        )?;
    }
    if wrong_count > 0 {
        return Err(format!("{wrong_count} things went wrong").into());
    }
    Ok(())
}

fn trace(out: &mut impl Write, setup: &Setup, outcome: &Outcome) -> Result<(), Box<dyn Error>> {
    let faults: Vec<String> = setup.faults.iter().map(ToString::to_string).collect();
    writeln!(out, "faults: {}", faults.join(" "))?;
    for (at_ns, event) in &outcome.events {
        writeln!(out, "{:10.4} s {event:?}", *at_ns as f64 * 1e-9)?;
    }
    let met: Vec<String> = outcome.met.iter().map(ToString::to_string).collect();
    writeln!(
        out,
        "{:?}, met: {}, {:?}",
        outcome.ended,
        met.join(" "),
        outcome.wrongs()
    )?;
    Ok(())
}

impl Tally {
    fn of(setup: &Setup, outcome: &Outcome) -> Self {
        let met = outcome
            .met
            .iter()
            .map(|fault| (fault.name().to_owned(), Some(fault.phase)));
        let of_run = setup.faults.iter().map(setup::row).filter(|(_, phase)| phase.is_none());
        let mut rows = BTreeMap::new();
        for key in met.chain(of_run) {
            let stopped = match outcome.ended {
                Ended::Fault(name) => BTreeMap::from([(name, 1)]),
                Ended::Hung => BTreeMap::from([("hung", 1)]),
                Ended::Finished => BTreeMap::new(),
            };
            let row = Row {
                met_count: 1,
                finished_count: u64::from(outcome.ended == Ended::Finished),
                retaken_count: outcome.retake_count,
                reconnected_count: outcome.connect_count.saturating_sub(1),
                fetched_count: outcome.fetch_count,
                missing_count: outcome.missing_count,
                stopped,
            };
            rows.insert(key, row);
        }
        let stopped_seeds = match outcome.ended {
            Ended::Fault(name) => BTreeMap::from([(name, vec![setup.seed])]),
            Ended::Finished | Ended::Hung => BTreeMap::new(),
        };
        let faults: Vec<String> = setup.faults.iter().map(ToString::to_string).collect();
        let about = |wrong: String| (setup.seed, format!("{wrong} ({})", faults.join(" ")));
        Self {
            happening: if outcome.met_is_known { "happened" } else { "was drawn" },
            run_count: 1,
            finished_count: u64::from(outcome.ended == Ended::Finished),
            hung_count: u64::from(outcome.ended == Ended::Hung),
            accepted_count: outcome.judge.accepted_count(),
            wrong_count: outcome.judge.wrong.len(),
            partial_count: outcome.judge.partial.len(),
            duplicate_count: outcome.judge.duplicate.len(),
            unlike_count: 0,
            longest_ns: outcome.end_ns,
            rows,
            stopped_seeds,
            wrongs: outcome.wrongs().into_iter().map(about).collect(),
        }
    }

    fn joined(mut self, other: Self) -> Self {
        self.happening = other.happening;
        self.run_count += other.run_count;
        self.finished_count += other.finished_count;
        self.hung_count += other.hung_count;
        self.accepted_count += other.accepted_count;
        self.wrong_count += other.wrong_count;
        self.partial_count += other.partial_count;
        self.duplicate_count += other.duplicate_count;
        self.unlike_count += other.unlike_count;
        self.longest_ns = self.longest_ns.max(other.longest_ns);
        for (key, row) in other.rows {
            self.rows.entry(key).or_default().add(row);
        }
        for (code, seeds) in other.stopped_seeds {
            self.stopped_seeds.entry(code).or_default().extend(seeds);
        }
        self.wrongs.extend(other.wrongs);
        self
    }

    fn print(&self, out: &mut impl Write, took_s: f64) -> std::io::Result<()> {
        writeln!(
            out,
            "| fault | phase | runs in which it {} | finished | reconnected | FETCH | retaken | views without a frame | stopped with |",
            self.happening
        )?;
        writeln!(out, "|---|---|---|---|---|---|---|---|---|")?;
        for ((name, phase), row) in &self.rows {
            let stopped = row.stopped.iter().map(|(code, count)| format!("{code} {count}"));
            writeln!(
                out,
                "| {name} | {} | {} | {} | {} | {} | {} | {} | {} |",
                phase.map_or("", Phase::name),
                row.met_count,
                row.finished_count,
                row.reconnected_count,
                row.fetched_count,
                row.retaken_count,
                row.missing_count,
                stopped.collect::<Vec<_>>().join(", ")
            )?;
        }
        writeln!(
            out,
            "\n{} runs, {} finished, {} stopped with a named fault, {} hung; {} frames taken as data: {} wrong, {} partial, {} duplicate; \
             {} unlike when made again; longest run {:.1} s; {took_s:.1} s",
            self.run_count,
            self.finished_count,
            self.run_count - self.finished_count - self.hung_count,
            self.hung_count,
            self.accepted_count,
            self.wrong_count,
            self.partial_count,
            self.duplicate_count,
            self.unlike_count,
            self.longest_ns as f64 * 1e-9
        )?;
        for (code, seeds) in &self.stopped_seeds {
            let first: Vec<String> = seeds.iter().take(SEEDS_SHOWN_MAX).map(ToString::to_string).collect();
            writeln!(
                out,
                "{code}: {} runs, the first with seeds {}",
                seeds.len(),
                first.join(", ")
            )?;
        }
        for (seed, wrong) in self.wrongs.iter().take(WRONG_SHOWN_MAX) {
            writeln!(out, "seed {seed}: {wrong}")?;
        }
        Ok(())
    }
}

impl Row {
    fn add(&mut self, other: Self) {
        self.met_count += other.met_count;
        self.finished_count += other.finished_count;
        self.retaken_count += other.retaken_count;
        self.reconnected_count += other.reconnected_count;
        self.fetched_count += other.fetched_count;
        self.missing_count += other.missing_count;
        for (code, count) in other.stopped {
            *self.stopped.entry(code).or_default() += count;
        }
    }
}

/// Spans as long as real ones.
const ON_VIRTUAL_TIME: Spans = Spans {
    reset_s: 35.0,
    other_max_s: 12.0,
};
const WRONG_SHOWN_MAX: usize = 20;
const SEEDS_SHOWN_MAX: usize = 8;
/// Every such run is made twice.
const REPEATED_EVERY: u64 = 20;

#[cfg(test)]
mod tests {
    use super::*;

    fn darkroom() -> Darkroom {
        Darkroom::new(Renderer::new(&Builtin::HptA.mesh(), Surface::matte()).unwrap())
    }

    #[test]
    fn each_fault_alone_is_overcome_or_stops_the_run_by_name() {
        let darkroom = darkroom();
        for setup in setup::each_alone(ON_VIRTUAL_TIME) {
            let outcome = virtual_time::drive(&setup, &darkroom).unwrap();
            assert!(
                outcome.wrongs().is_empty(),
                "{}: {:?}",
                setup.faults[0],
                outcome.wrongs()
            );
            let fault = setup.faults[0].to_string();
            let expected = match fault.split(['@', '=']).next() {
                Some("camera-broken") => None,
                Some("config-echo") => Some(Ended::Fault("camera-settings")),
                Some("controller-busy") if !fault.contains('=') => Some(Ended::Fault("camera-refused")),
                _ => Some(Ended::Finished),
            };
            match expected {
                Some(expected) => assert_eq!(outcome.ended, expected, "{fault}"),
                None => assert!(matches!(outcome.ended, Ended::Fault(_)), "{fault}"),
            }
            let happens_at_a_trigger = setup::row(&setup.faults[0]).1.is_some();
            assert_eq!(outcome.met.len(), usize::from(happens_at_a_trigger), "{fault}");
        }
    }

    #[test]
    fn seeded_runs_with_several_faults_take_no_wrong_frame_and_end() {
        let darkroom = darkroom();
        for seed in 1..=60 {
            let setup = setup::draw(seed, ON_VIRTUAL_TIME);
            let outcome = virtual_time::drive(&setup, &darkroom).unwrap();
            assert!(outcome.wrongs().is_empty(), "seed {seed}: {:?}", outcome.wrongs());
        }
    }
}
