//! The arm over a bad wire and in a bad cell, many times: nothing may move twice, arrive wrongly or hang.

#[path = "../../tests/wire/carry.rs"]
mod carry;
#[path = "../../tests/wire/draws.rs"]
mod draws;
#[path = "../../tests/wire/drive.rs"]
mod drive;
#[path = "../../tests/wire/phases.rs"]
mod phases;
#[allow(dead_code, reason = "the tests use the rest")]
#[path = "../../tests/wire/setup.rs"]
mod setup;

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;
use std::time::Instant;

use clap::{Args, ValueEnum};
use rayon::prelude::*;
use setup::{Ended, Link, Outcome, Way};

#[derive(Args)]
pub(crate) struct WireArguments {
    /// Runs of each link and way.
    #[arg(long, default_value_t = 1000)]
    runs: u64,
    /// Seed of the first run; the others count on.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only this link.
    #[arg(long)]
    link: Option<LinkArgument>,
    /// Only this way of moving.
    #[arg(long)]
    motion: Option<MotionArgument>,
    /// One line of JSON for each link and way instead of a table.
    #[arg(long)]
    json: bool,
    /// Prints what is noticed of each incident in each part of a run, how soon, as what, and no table of runs.
    #[arg(long)]
    phases: bool,
    /// Prints what the arm told in the run of `--seed`, and no table.
    #[arg(long)]
    trace: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum LinkArgument {
    Hses,
    HostControl,
    Serial,
}

#[derive(Clone, Copy, ValueEnum)]
enum MotionArgument {
    Direct,
    Job,
}

/// What came of the runs of one link and way.
#[derive(Default)]
struct Tally {
    run_count: u64,
    finished_count: u64,
    fault_counts: BTreeMap<&'static str, u64>,
    repeated_count: u64,
    moved_while_held_count: u64,
    wrong_arrival_count: u64,
    hung_count: u64,
    violation_count: u64,
    unlike_count: u64,
    longest_ns: u64,
    /// The first seeds of runs that went wrong, and how.
    wrong_seeds: Vec<(u64, String)>,
}

pub(crate) fn run(arguments: &WireArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let links = match arguments.link {
        None => vec![Link::Hses, Link::HostControl, Link::Serial],
        Some(LinkArgument::Hses) => vec![Link::Hses],
        Some(LinkArgument::HostControl) => vec![Link::HostControl],
        Some(LinkArgument::Serial) => vec![Link::Serial],
    };
    let ways = match arguments.motion {
        None => vec![Way::Direct, Way::Job],
        Some(MotionArgument::Direct) => vec![Way::Direct],
        Some(MotionArgument::Job) => vec![Way::Job],
    };
    let pairs = links.iter().flat_map(|link| ways.iter().map(|way| (*link, *way)));
    if arguments.phases {
        for (link, way) in pairs {
            writeln!(out, "\n{link:?} {way:?}\n")?;
            print_phases(&mut out, link, way)?;
        }
        return Ok(());
    }
    if arguments.trace {
        for (link, way) in pairs {
            trace(&mut out, link, way, arguments.seed)?;
        }
        return Ok(());
    }
    if !arguments.json {
        writeln!(
            out,
            "| link | motion | runs | finished | faults | repeated motions | moved while held | wrong arrivals | hangs | violations | other bytes for the same seed | longest run | time |"
        )?;
        writeln!(out, "|---|---|---|---|---|---|---|---|---|---|---|---|---|")?;
    }
    let mut wrong_count = 0;
    for (link, way) in pairs {
        let since = Instant::now();
        let tally = (arguments.seed..arguments.seed + arguments.runs)
            .into_par_iter()
            .map(|seed| Tally::of(link, way, seed))
            .reduce(Tally::default, Tally::joined);
        let took_s = since.elapsed().as_secs_f64();
        if arguments.json {
            writeln!(out, "{}", tally.json(link, way, arguments.seed))?;
        } else {
            writeln!(out, "{}", tally.row(link, way, took_s))?;
        }
        for (seed, what) in tally.wrong_seeds.iter().take(WRONG_SHOWN_MAX) {
            writeln!(out, "{link:?} {way:?} seed {seed}: {what}")?;
        }
        wrong_count += tally.wrong_seeds.len();
    }
    if wrong_count > 0 {
        return Err(format!("{wrong_count} runs went wrong").into());
    }
    Ok(())
}

fn print_phases(out: &mut impl Write, link: Link, way: Way) -> std::io::Result<()> {
    for phase in phases::phases(way) {
        let cells = phases::INCIDENTS.iter().map(|incident| {
            let seen = phases::incident_in(link, way, *phase, *incident);
            let after_ms = seen
                .after_ns
                .map_or(String::new(), |ns| format!(" {} ms", ns / 1_000_000));
            format!("{}{after_ms}, {:?}", seen.notice, seen.outcome.ended)
        });
        writeln!(out, "| {phase:?} | {} |", cells.collect::<Vec<_>>().join(" | "))?;
    }
    Ok(())
}

fn trace(out: &mut impl Write, link: Link, way: Way, seed: u64) -> std::io::Result<()> {
    let setup = draws::setup(link, way, seed);
    writeln!(out, "{setup:#?}")?;
    let outcome = drive::drive(&setup);
    for (at_ns, event) in &outcome.events {
        writeln!(out, "{:10.4} s {event:?}", *at_ns as f64 * 1e-9)?;
    }
    let events = Vec::new();
    writeln!(out, "{:#?}", Outcome { events, ..outcome })
}

impl Tally {
    fn of(link: Link, way: Way, seed: u64) -> Self {
        let setup = draws::setup(link, way, seed);
        let outcome = drive::drive(&setup);
        let is_repeated = seed.is_multiple_of(REPEATED_EVERY);
        let is_unlike = is_repeated && drive::drive(&setup).digest != outcome.digest;
        // Wrong bits that no check sum finds make words that nobody said.
        let is_violation = link != Link::Serial && !outcome.violations.is_empty();
        let mut wrong_seeds = Vec::new();
        if !outcome.is_sound() || is_violation || is_unlike {
            let Outcome {
                ended,
                repeated_count,
                moved_while_held_count,
                wrong_arrival_count,
                violations,
                ..
            } = &outcome;
            let what = format!(
                "{ended:?}, {repeated_count} repeated, {moved_while_held_count} moved while held, \
                 {wrong_arrival_count} wrong arrivals, {violations:?}, other bytes: {is_unlike}"
            );
            wrong_seeds.push((seed, what));
        }
        let fault_counts = match outcome.ended {
            Ended::Fault(name) => BTreeMap::from([(name, 1)]),
            Ended::Finished | Ended::Hung => BTreeMap::new(),
        };
        Self {
            run_count: 1,
            finished_count: u64::from(outcome.ended == Ended::Finished),
            fault_counts,
            repeated_count: u64::from(outcome.repeated_count),
            moved_while_held_count: u64::from(outcome.moved_while_held_count),
            wrong_arrival_count: u64::from(outcome.wrong_arrival_count),
            hung_count: u64::from(outcome.ended == Ended::Hung),
            violation_count: outcome.violations.len() as u64,
            unlike_count: u64::from(is_unlike),
            longest_ns: outcome.end_ns,
            wrong_seeds,
        }
    }

    fn joined(mut self, other: Self) -> Self {
        self.run_count += other.run_count;
        self.finished_count += other.finished_count;
        for (name, count) in other.fault_counts {
            *self.fault_counts.entry(name).or_default() += count;
        }
        self.repeated_count += other.repeated_count;
        self.moved_while_held_count += other.moved_while_held_count;
        self.wrong_arrival_count += other.wrong_arrival_count;
        self.hung_count += other.hung_count;
        self.violation_count += other.violation_count;
        self.unlike_count += other.unlike_count;
        self.longest_ns = self.longest_ns.max(other.longest_ns);
        self.wrong_seeds.extend(other.wrong_seeds);
        self
    }

    fn row(&self, link: Link, way: Way, took_s: f64) -> String {
        let faults = self.fault_counts.iter().map(|(name, count)| format!("{name} {count}"));
        let Self {
            run_count,
            finished_count,
            repeated_count,
            moved_while_held_count,
            wrong_arrival_count,
            ..
        } = self;
        let Self {
            hung_count,
            violation_count,
            unlike_count,
            longest_ns,
            ..
        } = self;
        format!(
            "| {link:?} | {way:?} | {run_count} | {finished_count} | {} | {repeated_count} | {moved_while_held_count} | \
             {wrong_arrival_count} | {hung_count} | {violation_count} | {unlike_count} | {:.1} s | {took_s:.1} s |",
            faults.collect::<Vec<_>>().join(", "),
            *longest_ns as f64 * 1e-9
        )
    }

    fn json(&self, link: Link, way: Way, seed: u64) -> serde_json::Value {
        serde_json::json!({
            "link": format!("{link:?}"),
            "motion": format!("{way:?}"),
            "seed": seed,
            "runs": self.run_count,
            "finished": self.finished_count,
            "faults": self.fault_counts,
            "repeated": self.repeated_count,
            "moved_while_held": self.moved_while_held_count,
            "wrong_arrivals": self.wrong_arrival_count,
            "hung": self.hung_count,
            "violations": self.violation_count,
            "unlike": self.unlike_count,
            "longest_s": self.longest_ns as f64 * 1e-9,
            "wrong_seeds": self.wrong_seeds.iter().map(|(seed, _)| seed).collect::<Vec<_>>(),
        })
    }
}

/// Every such run is made twice and compared byte by byte.
const REPEATED_EVERY: u64 = 20;
const WRONG_SHOWN_MAX: usize = 20;
