//! Whole small runs on virtual time whose disk goes wrong at every record: no act may leave unrecorded, the arm is held, the
//! run ends with the fault `journal`, and what is on the disk is the run up to there.

mod trouble;

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;
use std::time::Instant;

use bladescan::camera::CameraOutput;
use bladescan::controller::{Input, Output};
use bladescan::event::Event;
use bladescan::job::{FinishedJob, Job};
use bladescan::journal::{Recording, Topic, Writer};
use bladescan::robot::{self, Kind, RobotOutput};
use bladescan::run::{Pool, replay};
use bladescan::settings::Station;
use clap::Args;
use hw_sim::blade::Builtin;
use hw_sim::camera::render::{Renderer, Surface};
use rayon::prelude::*;
use trouble::{Disk, DiskJournal, Trouble};

use crate::camera_faults::run::{Darkroom, Ended, Outcome, RECIPE, controller, header};
use crate::camera_faults::setup::Setup;
use crate::camera_faults::virtual_time::{Around, START_UNIX_NS, drive_on};

#[derive(Args)]
pub(crate) struct DiskArguments {
    /// Seed of the run that is made again and again.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only every Nth record.
    #[arg(long, default_value_t = 1, value_name = "N")]
    every: usize,
    /// Of those, every Nth recording is replayed; all of them are compared with that of the good disk, which is.
    #[arg(long, default_value_t = 97, value_name = "N")]
    replay_every: usize,
}

/// One run and what it left.
struct Made {
    outcome: Outcome,
    bytes: Vec<u8>,
    offsets: Vec<u64>,
    /// What left for the devices: when, bytes, and what it was.
    left: Vec<Left>,
    /// When the journal had failed.
    failed_ns: Option<u64>,
    /// Whether the run was already on its way to its end then.
    was_ending: bool,
}

struct Left {
    at_ns: u64,
    bytes: Vec<u8>,
    what: What,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum What {
    Act,
    Safe,
    Other,
}

/// Jobs done once: the same in every run.
type Jobs = BTreeMap<(&'static str, usize), FinishedJob>;

/// One kind of trouble in the table.
#[derive(Default)]
struct Row {
    run_count: usize,
    faulted_count: usize,
    finished_count: usize,
    acted_count: usize,
    kept_count: usize,
    replayed_count: usize,
    end_ms_max: u64,
    wrongs: Vec<String>,
}

pub(crate) fn run(arguments: &DiskArguments) -> Result<(), Box<dyn Error>> {
    let since = Instant::now();
    let setup = Setup {
        faults: Vec::new(),
        piece_bytes_max: usize::MAX,
        seed: arguments.seed,
    };
    let darkroom = Darkroom::new(Renderer::new(&Builtin::HptA.mesh(), Surface::matte())?);
    let pool = Pool::new()?;
    let jobs = RefCell::new(Jobs::new());
    let good = make(&setup, &darkroom, Trouble::None, &|job| {
        let done = FinishedJob {
            times: Vec::new(),
            ..pool.run(job)
        };
        jobs.borrow_mut().insert((job.name(), job.view_index()), done.clone());
        done
    })?;
    let jobs = jobs.into_inner();
    let mut out = std::io::stdout().lock();
    let record_count = good.offsets.len() - 1;
    writeln!(
        out,
        "seed {}: the run on a good disk has {record_count} records, {} bytes, {:.1} s",
        arguments.seed,
        good.bytes.len(),
        good.outcome.end_ns as f64 * 1e-9
    )?;
    if good.offsets.last() != Some(&(good.bytes.len() as u64)) {
        return Err("the records are not where they were counted".into());
    }
    if good.outcome.ended != Ended::Finished || !replays(&good.bytes, &pool)? {
        return Err("the run on a good disk did not finish or does not replay".into());
    }
    let mut rows: BTreeMap<&'static str, Row> = BTreeMap::new();
    let judged: Vec<(&'static str, Row)> = troubles(&good.offsets, arguments.every)
        .into_par_iter()
        .enumerate()
        .map(|(index, (name, trouble))| {
            let replayed = index.is_multiple_of(arguments.replay_every);
            let row = make(&setup, &darkroom, trouble, &|job| {
                jobs.get(&(job.name(), job.view_index()))
                    .cloned()
                    .unwrap_or_else(|| pool.run(job))
            })
            .and_then(|made| judge(&good, trouble, &made, replayed.then_some(&pool)));
            let row = row.unwrap_or_else(|error| Row {
                wrongs: vec![error],
                ..Row::default()
            });
            (name, row)
        })
        .collect();
    for (name, row) in judged {
        let sum = rows.entry(name).or_default();
        sum.run_count += 1;
        sum.faulted_count += row.faulted_count;
        sum.finished_count += row.finished_count;
        sum.acted_count += row.acted_count;
        sum.kept_count += row.kept_count;
        sum.replayed_count += row.replayed_count;
        sum.end_ms_max = sum.end_ms_max.max(row.end_ms_max);
        sum.wrongs.extend(row.wrongs);
    }
    print(&mut out, &rows, since.elapsed().as_secs_f64())?;
    let wrong_count: usize = rows.values().map(|row| row.wrongs.len()).sum();
    if wrong_count > 0 {
        return Err(format!("{wrong_count} wrongs").into());
    }
    Ok(())
}

/// Every trouble at every record, by the name of its row.
fn troubles(offsets: &[u64], every: usize) -> Vec<(&'static str, Trouble)> {
    let mut troubles = Vec::new();
    for (index, pair) in offsets.windows(2).enumerate().step_by(every) {
        let (start, end) = (pair[0], pair[1]);
        let record = index as u64;
        let full = |byte_count| Trouble::Full { byte_count };
        let slow = |delay_ns| Trouble::SlowFlush { record, delay_ns };
        let late = |delay_ns| Trouble::SlowSync { record, delay_ns };
        troubles.extend([
            ("full before the record", full(start)),
            ("full after its first byte", full(start + 1)),
            ("full in its middle", full(start.midpoint(end))),
            ("full before its last byte", full(end - 1)),
            ("read-only before the record", Trouble::ReadOnly { byte_count: start }),
            ("flush 50 ms late", slow(50_000_000)),
            ("flush 5 s late", slow(5_000_000_000)),
            ("flush never", slow(NEVER_NS)),
            ("on the disk 3 s late", late(3_000_000_000)),
            ("on the disk never", late(NEVER_NS)),
        ]);
    }
    troubles
}

fn make(
    setup: &Setup,
    darkroom: &Darkroom,
    trouble: Trouble,
    do_job: &dyn Fn(&Job) -> FinishedJob,
) -> Result<Made, String> {
    let begun = |trouble| {
        let station = Station::BUILTIN_SIMULATED_TEXT;
        Writer::begin(Disk::new(trouble), &header(setup), START_UNIX_NS, RECIPE, station)
            .map_err(|error| error.to_string())
    };
    let begun_bytes = begun(Trouble::None)?.abandon().into_bytes().len() as u64;
    let (mut left, mut failed_ns, mut is_ending, mut was_ending) = (Vec::new(), None, false, false);
    let mut see = |at_ns: u64, output: &Output, has_failed: bool| {
        let (bytes, what) = match output {
            Output::Robot(RobotOutput::Bytes { bytes, kind }) if kind.waits_for_journal() => (bytes, What::Act),
            Output::Robot(RobotOutput::Bytes { bytes, kind: Kind::Set }) => (bytes, What::Safe),
            Output::Robot(RobotOutput::Bytes { bytes, .. }) => (bytes, What::Other),
            Output::Camera(CameraOutput::Bytes { bytes, act: true }) => (bytes, What::Act),
            Output::Event(event) => {
                let faulted = matches!(event, Event::Faulted { .. });
                if faulted && has_failed && failed_ns.is_none() {
                    failed_ns = Some(at_ns);
                    was_ending = is_ending;
                }
                return;
            }
            _ => return,
        };
        // Servo power goes off at the end of a run and nowhere else.
        is_ending |= what == What::Safe && !is_hold(bytes);
        left.push(Left {
            at_ns,
            bytes: bytes.clone(),
            what,
        });
    };
    let around = Around {
        setup,
        darkroom,
        finish: &|job_id, job| Input::JobDone {
            job_id,
            done: do_job(job),
        },
        see: &mut see,
    };
    let journal = DiskJournal::new(begun(trouble)?, trouble, begun_bytes);
    let (outcome, journal) = drive_on(around, controller(setup)?, journal)?;
    let offsets = journal.offsets.clone();
    Ok(Made {
        outcome,
        bytes: journal.into_bytes(),
        offsets,
        left,
        failed_ns,
        was_ending,
    })
}

/// What one run comes to, and everything wrong with it.
fn judge(good: &Made, trouble: Trouble, made: &Made, pool: Option<&Pool>) -> Result<Row, String> {
    let mut row = Row::default();
    let mut wrong = |text: String| row.wrongs.push(format!("{trouble:?}: {text}"));
    let recording = Recording::open(&made.bytes).map_err(|error| error.to_string())?;
    let records: Vec<_> = recording
        .records()
        .map_err(|error| error.to_string())?
        .map_while(Result::ok)
        .collect();
    // What must be in the file: acts that left, frames that were said to be kept.
    let mut sent = records
        .iter()
        .filter(|record| matches!(record.topic, Topic::RobotSent | Topic::CameraSent));
    let acts: Vec<&Left> = made.left.iter().filter(|left| left.what == What::Act).collect();
    for act in &acts {
        if !sent.any(|record| record.payload == act.bytes) {
            wrong(format!("an act left at {} ns without its record", act.at_ns));
        }
    }
    let kept = made.outcome.events.iter().filter_map(|(_, event)| match event {
        Event::FrameKept { view_index, attempt } => Some((*view_index, *attempt)),
        _ => None,
    });
    let mut kept_count = 0;
    for (view_index, attempt) in kept {
        kept_count += 1;
        let wanted = format!(r#""output":"sync","view_index":{view_index}"#);
        let sorted = format!(r#"{{"attempt":{attempt},{wanted}}}"#);
        let is_there = records
            .iter()
            .any(|record| record.topic == Topic::Output && record.payload == sorted.as_bytes());
        if !is_there {
            wrong(format!("view {view_index} was said to be kept and is not in the file"));
        }
    }
    if let Trouble::Full { byte_count } | Trouble::ReadOnly { byte_count } = trouble {
        let end = byte_count as usize;
        if good.bytes.get(..end) != Some(made.bytes.as_slice()) {
            wrong(format!(
                "{} bytes on the disk are not the run's first {end}",
                made.bytes.len()
            ));
        }
    }
    match (made.outcome.ended, made.failed_ns) {
        (Ended::Fault("journal"), Some(failed_ns)) => {
            row.faulted_count = 1;
            row.end_ms_max = (made.outcome.end_ns - failed_ns) / 1_000_000;
            if row.end_ms_max > END_MS_MAX {
                row.wrongs
                    .push(format!("{trouble:?}: ended {} ms after the failure", row.end_ms_max));
            }
            let mut after = made.left.iter().filter(|left| left.at_ns >= failed_ns);
            let is_held = after.any(|left| left.what == What::Safe);
            if !acts.is_empty() && !is_held && !made.was_ending {
                row.wrongs
                    .push(format!("{trouble:?}: the arm was not held after the failure"));
            }
        }
        (Ended::Finished, None) => row.finished_count = 1,
        (ended, failed_ns) => row
            .wrongs
            .push(format!("{trouble:?}: ended {ended:?}, journal failed at {failed_ns:?}")),
    }
    // A run is over with its last input: where that or what follows cannot be written, the caller tells.
    let input_count = |bytes: &[u8]| -> Result<usize, String> {
        let recording = Recording::open(bytes).map_err(|error| error.to_string())?;
        let records = recording.records().map_err(|error| error.to_string())?;
        Ok(records
            .map_while(Result::ok)
            .filter(|record| record.topic.is_input())
            .count())
    };
    let is_over = input_count(&made.bytes)? + 1 >= input_count(&good.bytes)?;
    let must_fail = matches!(trouble, Trouble::Full { .. } | Trouble::ReadOnly { .. }) && !is_over;
    if must_fail && row.faulted_count == 0 {
        row.wrongs.push(format!("{trouble:?}: the run did not notice its disk"));
    }
    row.wrongs.extend(
        made.outcome
            .violations
            .iter()
            .map(|text| format!("{trouble:?}: {text}")),
    );
    if let Some(pool) = pool {
        row.replayed_count = 1;
        if !replays(&made.bytes, pool)? {
            row.wrongs.push(format!("{trouble:?}: does not replay"));
        }
    }
    row.acted_count = usize::from(!acts.is_empty());
    row.kept_count = kept_count;
    Ok(row)
}

/// Whether a recording replays bit for bit as far as it goes. A torn last record is left out, as `recover` does.
fn replays(bytes: &[u8], pool: &Pool) -> Result<bool, String> {
    let recording = Recording::open(bytes).map_err(|error| error.to_string())?;
    let mut whole = Writer::begin(
        std::io::Cursor::new(Vec::new()),
        recording.header(),
        recording.start_unix_ns(),
        recording.recipe_text(),
        recording.station_text(),
    )
    .map_err(|error| error.to_string())?;
    let records = recording.records().map_err(|error| error.to_string())?;
    for record in records.map_while(Result::ok) {
        whole.write(&record).map_err(|error| error.to_string())?;
    }
    let whole = whole.finish().map_err(|error| error.to_string())?.into_inner();
    let recording = Recording::open(&whole).map_err(|error| error.to_string())?;
    let report = replay(&recording, pool).map_err(|error| error.to_string())?;
    Ok(report.identical)
}

fn is_hold(bytes: &[u8]) -> bool {
    let request = |id| robot::hses::request(&robot::Command::HoldOn, id);
    bytes
        .get(11)
        .is_some_and(|id| request(*id).is_ok_and(|hold| hold.encode() == bytes))
}

fn print(out: &mut impl Write, rows: &BTreeMap<&'static str, Row>, took_s: f64) -> Result<(), Box<dyn Error>> {
    writeln!(
        out,
        "| disk, from each record on | runs | fault journal | finished | after an act | frames kept | replayed | longest end | wrong |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|---|")?;
    for (name, row) in rows {
        writeln!(
            out,
            "| {name} | {} | {} | {} | {} | {} | {} | {} ms | {} |",
            row.run_count,
            row.faulted_count,
            row.finished_count,
            row.acted_count,
            row.kept_count,
            row.replayed_count,
            row.end_ms_max,
            row.wrongs.len()
        )?;
    }
    for wrong in rows.values().flat_map(|row| &row.wrongs).take(SHOWN_MAX) {
        writeln!(out, "wrong: {wrong}")?;
    }
    writeln!(out, "{took_s:.1} s")?;
    Ok(())
}

/// Longer than any run.
const NEVER_NS: u64 = 1_000_000_000_000_000;
/// From the failure to the end of the run, ms: a hold and the goodbyes.
const END_MS_MAX: u64 = 5000;
const SHOWN_MAX: usize = 20;
