//! Replay: the recorded inputs through the same controller and the same jobs, every output compared bit by bit.

use super::pool::Pool;
use super::recorded::Recorded;
use crate::controller::{Controller, Input, Output};
use crate::job::{FinishedJob, hex, sha256};
use crate::journal::{InputMemo, ReadError, Record, Recording, Topic, input_record, output_records, read_input};
use crate::plan::PlanError;
use crate::settings::SettingsError;
use crate::stamp::Stamp;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use thiserror::Error;

/// What a replay found.
#[derive(Debug, Clone, Serialize)]
pub struct ReplayReport {
    /// Whether every output was the same.
    pub identical: bool,
    /// Whether the recording has the end of its run.
    pub complete: bool,
    /// Inputs fed.
    pub input_count: usize,
    /// Outputs compared.
    pub output_count: usize,
    /// Jobs run again.
    pub job_count: usize,
    /// Version that recorded.
    pub recorded_by: String,
    /// Version that replays.
    pub replayed_by: String,
    /// The first difference.
    pub difference: Option<Difference>,
}

/// The first place where the replay leaves the recording.
#[derive(Debug, Clone, Serialize)]
pub struct Difference {
    /// Seconds since the run began.
    pub at_s: f64,
    /// Which topic.
    pub topic: String,
    /// What the recording has.
    pub recorded: String,
    /// What came of the replay.
    pub replayed: String,
    /// How many inputs had been fed.
    pub after_input_count: usize,
    /// The last of them, the latest at the end.
    pub inputs_before: Vec<String>,
}

/// Why a recording cannot be replayed at all.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// The file.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The recipe or station inside it.
    #[error("the recipe or station in the recording: {0}")]
    Settings(#[from] Box<SettingsError>),
    /// The plan.
    #[error("the plan of the recording: {0}")]
    Plan(#[from] PlanError),
    /// The run does not come out as it was recorded.
    #[error("the run comes out differently from {:.3} s on ({}): recorded {}, now {}", .0.at_s, .0.topic, .0.recorded, .0.replayed)]
    Differs(Box<Difference>),
}

/// A run as far as its recording goes, so that it can go on.
#[derive(Debug)]
pub struct Rebuilt {
    /// The run itself.
    pub controller: Controller,
    /// What follows from the last input and is not in the recording, whose end is missing.
    pub unwritten: Vec<Record>,
    /// Jobs whose end is not in the recording.
    pub done: BTreeMap<u32, FinishedJob>,
    /// When the last record was made.
    pub last: Stamp,
    /// The files that the run has put out last.
    pub files: BTreeMap<&'static str, Vec<u8>>,
}

/// Feeds a recording to the same code and compares. Stops at the first difference.
pub fn replay(recording: &Recording<'_>, pool: &Pool) -> Result<ReplayReport, ReplayError> {
    let mut unseen = |_: &Output| ();
    let mut replayer = feed(recording, pool, &mut unseen)?;
    if replayer.report.difference.is_none() {
        replayer.finish();
    }
    Ok(replayer.report)
}

/// Feeds a recording to the same code, so that the run can go on where the recording ends. `on_output` sees what follows.
///
/// # Errors
/// Also when anything differs from the recording: then this program is not the one to go on with it.
pub fn rebuild(
    recording: &Recording<'_>,
    pool: &Pool,
    on_output: &mut dyn FnMut(&Output),
) -> Result<Rebuilt, ReplayError> {
    let replayer = feed(recording, pool, on_output)?;
    match replayer.report.difference {
        Some(difference) => Err(ReplayError::Differs(Box::new(difference))),
        None => Ok(Rebuilt {
            controller: replayer.controller,
            unwritten: replayer.expected.into(),
            done: replayer.done,
            last: replayer.last,
            files: replayer.files,
        }),
    }
}

fn feed<'a>(
    recording: &Recording<'_>,
    pool: &'a Pool,
    on_output: &'a mut dyn FnMut(&Output),
) -> Result<Replayer<'a>, ReplayError> {
    let header = recording.header().clone();
    let Recorded { recipe, station, plan } = Recorded::read(recording)?;
    let recorded_by = header.version.clone();
    let mut replayer = Replayer {
        controller: Controller::new(header, &recipe, &station, plan),
        pool,
        on_output,
        start_unix_ns: recording.start_unix_ns(),
        expected: VecDeque::new(),
        done: BTreeMap::new(),
        inputs: VecDeque::new(),
        last: Stamp::START,
        files: BTreeMap::new(),
        report: ReplayReport {
            identical: false,
            complete: false,
            input_count: 0,
            output_count: 0,
            job_count: 0,
            recorded_by,
            replayed_by: env!("CARGO_PKG_VERSION").into(),
            difference: None,
        },
    };
    for record in recording.whole_records()? {
        if !replayer.take(record?) {
            break;
        }
    }
    Ok(replayer)
}

struct Replayer<'a> {
    controller: Controller,
    pool: &'a Pool,
    on_output: &'a mut dyn FnMut(&Output),
    start_unix_ns: u64,
    /// What the replay says must come next.
    expected: VecDeque<Record>,
    /// Jobs done again whose end the recording has not reached yet.
    done: BTreeMap<u32, FinishedJob>,
    /// The last few inputs.
    inputs: VecDeque<Record>,
    /// When the last record was made.
    last: Stamp,
    files: BTreeMap<&'static str, Vec<u8>>,
    report: ReplayReport,
}

impl Replayer<'_> {
    /// Takes the next record; false at the first difference.
    fn take(&mut self, record: Record) -> bool {
        self.last = self.last.max(record.stamp);
        if !record.topic.is_input() {
            self.report.output_count += 1;
            return match self.expected.pop_front() {
                Some(expected) if expected == record => true,
                expected => self.differ(Some(&record), expected.as_ref()),
            };
        }
        // Outputs follow their input directly, so all of them must have come by now.
        if let Some(expected) = self.expected.pop_front() {
            return self.differ(None, Some(&expected));
        }
        let input = match read_input(&record) {
            Some(InputMemo::Whole(input)) => input,
            Some(InputMemo::JobDone { job_id, times }) => {
                let Some(done) = self.done.remove(&job_id) else {
                    return self.differ(Some(&record), None);
                };
                // How long it took is an input, what came of it is not: the record has its digest.
                let done = FinishedJob { times, ..done };
                let input = Input::JobDone { job_id, done };
                let again = input_record(record.stamp, &input);
                if again != record {
                    return self.differ(Some(&record), Some(&again));
                }
                input
            }
            None => return self.differ(Some(&record), None),
        };
        self.report.input_count += 1;
        if self.inputs.len() == INPUTS_SHOWN {
            self.inputs.pop_front();
        }
        self.controller.handle_input(record.stamp, input);
        while let Some(output) = self.controller.poll_output() {
            self.expected
                .extend(output_records(record.stamp, &output, self.start_unix_ns));
            (self.on_output)(&output);
            match output {
                Output::Job { job_id, job } => {
                    self.report.job_count += 1;
                    self.done.insert(job_id, self.pool.run(&job));
                }
                Output::File { name, bytes } => {
                    self.files.insert(name, bytes);
                }
                _ => {}
            }
        }
        self.inputs.push_back(record);
        true
    }

    /// What still follows from the last input was never written: its process was killed there.
    fn finish(&mut self) {
        self.report.complete = self.controller.is_over() && self.expected.is_empty();
        self.report.identical = true;
    }

    fn differ(&mut self, recorded: Option<&Record>, replayed: Option<&Record>) -> bool {
        let some = recorded.or(replayed);
        self.report.difference = Some(Difference {
            at_s: some.map_or(0.0, |record| record.stamp.seconds()),
            topic: some.map_or("", |record| record.topic.name()).into(),
            recorded: words(recorded),
            replayed: words(replayed),
            after_input_count: self.report.input_count,
            inputs_before: self.inputs.iter().map(|record| words(Some(record))).collect(),
        });
        false
    }
}

fn words(record: Option<&Record>) -> String {
    let Some(record) = record else {
        return "nothing".into();
    };
    let text = match record.topic {
        Topic::Input | Topic::Output | Topic::Event => String::from_utf8_lossy(&record.payload).into_owned(),
        _ => {
            let shown = &record.payload[..record.payload.len().min(BYTES_SHOWN)];
            let rest = if shown.len() < record.payload.len() {
                format!("..., sha256 {}", sha256(&record.payload))
            } else {
                String::new()
            };
            format!("{} bytes {}{rest}", record.payload.len(), hex(shown))
        }
    };
    format!("{} at {:.6} s: {text}", record.topic.name(), record.stamp.seconds())
}

const INPUTS_SHOWN: usize = 8;
const BYTES_SHOWN: usize = 64;
