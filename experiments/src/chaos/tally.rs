//! What came of all runs, as a table.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;

use super::draw::Setup;
use super::judge::Bar;
use super::world::{Ended, Outcome};
use crate::camera_faults::setup::row;

/// What came of the runs with one kind of thing.
#[derive(Default)]
struct Row {
    drawn_count: u64,
    met_count: u64,
    stopped: BTreeMap<String, u64>,
    overcome_count: u64,
    lost_count: u64,
}

/// What came of all runs.
#[derive(Default)]
pub(super) struct Tally {
    run_count: u64,
    finished_count: u64,
    whole_count: u64,
    compared_count: u64,
    given_up: Vec<u64>,
    process_count: u64,
    longest_ns: u64,
    rows: BTreeMap<String, Row>,
    bars: BTreeMap<Bar, u64>,
    wrongs: Vec<(u64, Bar, String)>,
}

impl Tally {
    pub(super) fn add(&mut self, setup: &Setup, outcome: &Outcome) {
        let is_finished = outcome.ended == Ended::Finished;
        self.run_count += 1;
        self.finished_count += u64::from(is_finished);
        self.whole_count += u64::from(is_finished && outcome.merged_all);
        self.compared_count += u64::from(outcome.compared);
        self.process_count += outcome.process_count;
        self.longest_ns = self.longest_ns.max(outcome.end_ns);
        if outcome.ended == Ended::GivenUp {
            self.given_up.push(setup.seed);
        }
        for name in drawn(setup) {
            self.rows.entry(name).or_default().drawn_count += 1;
        }
        let lost = outcome.wrongs.iter().filter(|(bar, _)| *bar == Bar::Lost).count() as u64;
        for (name, stopped_by) in &outcome.met {
            let row = self.rows.entry(name.clone()).or_default();
            row.met_count += 1;
            row.overcome_count += u64::from(is_finished && outcome.merged_all);
            row.lost_count += lost;
            for code in stopped_by {
                *row.stopped.entry(code.clone()).or_default() += 1;
            }
        }
        for (bar, about) in &outcome.wrongs {
            *self.bars.entry(*bar).or_default() += 1;
            self.wrongs.push((setup.seed, *bar, about.clone()));
        }
    }

    pub(super) fn wrong_count(&self) -> usize {
        self.wrongs.len()
    }

    pub(super) fn print(&self, out: &mut impl Write, took_s: f64) -> std::io::Result<()> {
        writeln!(
            out,
            "| what happens | drawn | met | stopped a process as | overcome | frames lost |"
        )?;
        writeln!(out, "|---|---|---|---|---|---|")?;
        for (name, row) in &self.rows {
            let stopped = row.stopped.iter().map(|(code, count)| format!("{code} {count}"));
            writeln!(
                out,
                "| {name} | {} | {} | {} | {} | {} |",
                row.drawn_count,
                row.met_count,
                stopped.collect::<Vec<_>>().join(", "),
                row.overcome_count,
                row.lost_count
            )?;
        }
        writeln!(
            out,
            "\n{} runs by {} processes: {} finished, {} of them with every view merged, {} compared with the unbroken run; \
             {} given up {:?}; longest run {:.0} s; {took_s:.1} s\n",
            self.run_count,
            self.process_count,
            self.finished_count,
            self.whole_count,
            self.compared_count,
            self.given_up.len(),
            self.given_up.iter().take(SEEDS_SHOWN).collect::<Vec<_>>(),
            self.longest_ns as f64 * 1e-9
        )?;
        writeln!(out, "| must not be | count |")?;
        writeln!(out, "|---|---|")?;
        for bar in Bar::ALL {
            let count = self.bars.get(&bar).copied().unwrap_or_default();
            writeln!(out, "| {} | {count} |", bar.name())?;
        }
        for (seed, bar, about) in self.wrongs.iter().take(WRONGS_SHOWN) {
            writeln!(
                out,
                "\nseed {seed}: {}: {about}\n  experiments chaos --only {seed} --trace",
                bar.name()
            )?;
        }
        Ok(())
    }
}

/// Names of what was drawn, each once.
fn drawn(setup: &Setup) -> BTreeSet<String> {
    let of_camera = setup
        .camera_faults
        .iter()
        .map(|fault| format!("camera: {}", row(fault).0));
    let others = setup
        .happenings
        .iter()
        .map(|happening| happening.kind.name().to_owned());
    of_camera.chain(others).collect()
}

const SEEDS_SHOWN: usize = 10;
const WRONGS_SHOWN: usize = 40;
