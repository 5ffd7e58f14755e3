//! What must hold of a run, however often it was killed.

use super::Results;
use super::proxy::Passed;
use bladescan::journal::{Recording, Topic};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// Something that must not be.
pub(super) struct Wrong(pub(super) String);

/// What was said to be kept before the program was killed: view and attempt.
#[derive(Debug, Default)]
pub(super) struct Snapshot {
    kept: BTreeSet<(u64, u64)>,
}

/// Counts over all runs.
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub(super) kill_count: u64,
    /// Kills before anything was recorded.
    pub(super) unbegun_count: u64,
    pub(super) wrong_count: usize,
    restart_count: usize,
    kept_count: usize,
    check_count: usize,
    fetched_count: usize,
    retaken_count: usize,
    act_count: usize,
    accepted_count: usize,
    same_count: usize,
}

impl Snapshot {
    /// Adds what the recording holds now; false if there is none that could be gone on with.
    pub(super) fn take(&mut self, path: &Path) -> bool {
        let Ok(bytes) = std::fs::read(path) else { return false };
        let Ok(recording) = Recording::open(&bytes) else {
            return false;
        };
        let Ok(events) = events(&recording) else { return false };
        self.kept.extend(keys(&events, "frame-kept"));
        true
    }
}

/// Looks at what a run has left.
pub(super) fn judge(
    dir: &Path,
    snapshot: &Snapshot,
    passed: &[Passed],
    unbroken: &Results,
    tally: &mut Tally,
) -> Result<Vec<Wrong>, Box<dyn std::error::Error>> {
    let mut wrongs = Vec::new();
    let mut wrong = |text: String| wrongs.push(Wrong(text));
    let bytes = std::fs::read(dir.join("run.mcap"))?;
    let recording = Recording::open(&bytes)?;
    let events = events(&recording)?;
    let arrived = keys(&events, "frame-arrived");
    for kept in snapshot.kept.iter().filter(|kept| !arrived.contains(kept)) {
        wrong(format!("frame {kept:?} was kept and is lost"));
    }
    let poses: Value = serde_json::from_slice(&std::fs::read(dir.join("poses.json"))?)?;
    let mut first_attempts = true;
    for view in poses["views"].as_array().into_iter().flatten() {
        first_attempts &= view["attempt"] == 0;
        let index = view["index"].as_u64().unwrap_or(u64::MAX);
        if view["status"] == "missing" && snapshot.kept.iter().any(|(view, _)| *view == index) {
            wrong(format!("view {index} was kept and is missing"));
        }
    }
    tally.kept_count += snapshot.kept.len();
    tally.restart_count += count(&events, "restarted");
    tally.check_count += count(&events, "grip-checked");
    tally.fetched_count += count(&events, "exposure-done").saturating_sub(count(&events, "triggered"));
    if first_attempts {
        tally.same_count += 1;
        if Results::read(dir)? != *unbroken {
            wrong("the result is not that of the unbroken run".into());
        }
    } else {
        tally.retaken_count += 1;
    }
    judge_motion(&recording, passed, tally, &mut wrong)?;
    let truth = [dir.join("truth.json"), dir.with_file_name("truth.json")];
    if let Some(truth) = truth.iter().find(|path| path.exists()) {
        let truth: Value = serde_json::from_slice(&std::fs::read(truth)?)?;
        for view in truth["views"].as_array().into_iter().flatten() {
            if view["moved_during_exposure"] == true {
                wrong(format!("the arm moved while view {} was exposed", view["view_index"]));
            }
        }
    }
    Ok(wrongs)
}

/// No motion without its record, none begun twice.
fn judge_motion(
    recording: &Recording<'_>,
    passed: &[Passed],
    tally: &mut Tally,
    wrong: &mut impl FnMut(String),
) -> Result<(), Box<dyn std::error::Error>> {
    let mut recorded = BTreeSet::new();
    for record in recording.records()? {
        let record = record?;
        if record.topic == Topic::RobotSent {
            recorded.insert(record.payload);
        }
    }
    let mut last_move: Option<&[u8]> = None;
    for event in passed {
        match event {
            Passed::Act(bytes) => {
                tally.act_count += 1;
                if !recorded.contains(bytes) {
                    wrong("an act reached the robot and is not in the recording".into());
                }
            }
            Passed::Accepted(bytes) => {
                tally.accepted_count += 1;
                let target = &bytes[PAYLOAD..];
                if last_move == Some(target) {
                    wrong("a motion to the same pose was begun twice".into());
                }
                last_move = Some(target);
            }
            Passed::Stopped | Passed::NewProcess => last_move = None,
        }
    }
    Ok(())
}

impl Tally {
    pub(super) fn print(&self, out: &mut impl std::io::Write, run_count: u64) -> std::io::Result<()> {
        let lines = [
            ("runs", run_count as usize),
            ("kills", self.kill_count as usize),
            ("  before anything was recorded", self.unbegun_count as usize),
            ("restarts in the final recordings", self.restart_count),
            ("frames kept before a kill", self.kept_count),
            ("checks of the grip", self.check_count),
            ("frames fetched after a restart", self.fetched_count),
            ("acts that passed to the robot", self.act_count),
            ("motions that it accepted", self.accepted_count),
            ("results equal to the unbroken run's", self.same_count),
            ("results with a view taken again", self.retaken_count),
            ("things that must not be", self.wrong_count),
        ];
        for (name, count) in lines {
            writeln!(out, "{name:38} {count:6}")?;
        }
        Ok(())
    }
}

fn events(recording: &Recording<'_>) -> Result<Vec<Value>, Box<dyn std::error::Error>> {
    let mut events = Vec::new();
    for record in recording.whole_records()? {
        let record = record?;
        if record.topic == Topic::Event {
            events.push(serde_json::from_slice(&record.payload)?);
        }
    }
    Ok(events)
}

fn count(events: &[Value], name: &str) -> usize {
    events.iter().filter(|event| event["event"] == name).count()
}

fn keys(events: &[Value], name: &str) -> BTreeSet<(u64, u64)> {
    let named = events.iter().filter(|event| event["event"] == name);
    named
        .filter_map(|event| Some((event["view_index"].as_u64()?, event["attempt"].as_u64()?)))
        .collect()
}

const PAYLOAD: usize = 32;
