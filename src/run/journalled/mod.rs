//! No journal, no motion: a controller and its recording as one value, without I/O or clock of its own.
//!
//! | what | rule |
//! |---|---|
//! | an input | is recorded before it is handled |
//! | an output | is recorded before it is handed out |
//! | an act (what may move the arm or trigger the camera) | is handed out when its record has left the process, and waits for that in a queue |
//! | everything else, a hold above all | is handed out at once, past acts that wait |
//! | an act of the robot that waits when a hold, servo off or a newer act is said | never leaves |
//! | an act of the camera | what follows it on the connection waits behind it; it never leaves once the connection is closed |
//! | a frame | counts as taken when its record is on the disk ([`Output::Sync`]) |
//! | a record that cannot be written, an act or a frame that waits too long | the journal has failed: nothing more is recorded, no act leaves, the controller is told once |

use super::journal_file::JournalError;
use crate::camera::CameraOutput;
use crate::controller::{Controller, Device, Input, Output};
use crate::event::Event;
use crate::journal::{Record, Writer, input_record, output_records};
use crate::robot::{Kind, RobotOutput};
use crate::stamp::{Stamp, earlier};
use std::collections::VecDeque;
use std::io::{Seek, Write};

/// Where records go. Nothing here waits.
pub trait Journal {
    /// Takes a record.
    fn record(&mut self, record: Record) -> Result<(), JournalError>;

    /// Sees to it that everything taken so far leaves the process.
    fn flush(&mut self) -> Result<(), JournalError>;

    /// Sees to it that everything taken so far comes on the disk.
    fn sync(&mut self) -> Result<(), JournalError>;

    /// How far it has come; an error where it cannot go on.
    fn progress(&self) -> Result<Progress, JournalError>;
}

/// How far a journal has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Progress {
    /// Records that have left the process.
    pub flushed_count: u64,
    /// Records that are on the disk.
    pub synced_count: u64,
}

/// A writer journals at once, on the caller's thread. What it writes on is taken for the disk.
impl<W: Write + Seek> Journal for Writer<W> {
    fn record(&mut self, record: Record) -> Result<(), JournalError> {
        self.write(&record)
            .map_err(|error| JournalError::Write(error.to_string()))
    }

    fn flush(&mut self) -> Result<(), JournalError> {
        Self::flush(self).map_err(|error| JournalError::Write(error.to_string()))
    }

    fn sync(&mut self) -> Result<(), JournalError> {
        Journal::flush(self)
    }

    fn progress(&self) -> Result<Progress, JournalError> {
        Ok(Progress {
            flushed_count: self.flushed_count(),
            synced_count: self.flushed_count(),
        })
    }
}

/// A run and its recording. The rule of [`Controller`] holds: hand over an input, then take all outputs.
#[derive(Debug)]
pub struct Journalled<J> {
    controller: Controller,
    journal: J,
    start_unix_ns: u64,
    recorded_count: u64,
    has_failed: bool,
    /// What may only leave later, in the order in which it was put out.
    waiting: VecDeque<Waiting>,
    /// Bytes are missing in the camera's connection: nothing more makes sense there.
    camera_is_cut: bool,
    unsynced: VecDeque<Unsynced>,
    news: VecDeque<Input>,
    outputs: VecDeque<Output>,
}

#[derive(Debug)]
struct Waiting {
    device: Device,
    output: Output,
    /// How many records must have left before.
    record_count: u64,
    since: Stamp,
}

#[derive(Debug)]
struct Unsynced {
    view_index: usize,
    attempt: u16,
    /// How many records must be on the disk.
    record_count: u64,
    since: Stamp,
}

impl<J: Journal> Journalled<J> {
    /// A run that is recorded from its first input on. `start_unix_ns` dates the viewer's messages.
    pub fn new(controller: Controller, journal: J, start_unix_ns: u64) -> Self {
        // A recording that goes on has records already.
        let recorded_count = journal.progress().map_or(0, |progress| progress.flushed_count);
        Self {
            controller,
            journal,
            start_unix_ns,
            recorded_count,
            has_failed: false,
            waiting: VecDeque::new(),
            camera_is_cut: false,
            unsynced: VecDeque::new(),
            news: VecDeque::new(),
            outputs: VecDeque::new(),
        }
    }

    /// Something has happened.
    pub fn handle_input(&mut self, now: Stamp, input: Input) {
        self.take(now, input);
        self.go_on(now);
    }

    /// The time of [`Self::wake_at`] has come.
    pub fn handle_wake(&mut self, now: Stamp) {
        if self.controller.wake_at().is_some_and(|due| due <= now) {
            self.take(now, Input::Wake);
        }
        self.go_on(now);
    }

    /// The journal has come further, or has failed.
    pub fn handle_progress(&mut self, now: Stamp) {
        self.go_on(now);
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        if self.controller.is_over() {
            return None;
        }
        earlier(self.controller.wake_at(), self.slow_at())
    }

    /// The next thing to do. Acts come when they may leave; [`Output::Sync`] is done here.
    #[must_use]
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// The run.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// Where it is recorded.
    pub fn journal(&self) -> &J {
        &self.journal
    }

    /// Whether something waits for the journal.
    pub fn is_waiting(&self) -> bool {
        !self.waiting.is_empty() || !self.unsynced.is_empty()
    }

    /// Whether the recording ended before the run.
    pub fn has_failed(&self) -> bool {
        self.has_failed
    }

    /// The run and its recording, apart.
    pub fn into_parts(self) -> (Controller, J) {
        (self.controller, self.journal)
    }

    /// One input: recorded, handled, and all that follows from it recorded and put out.
    fn take(&mut self, now: Stamp, input: Input) {
        if !self.has_failed {
            self.record(input_record(now, &input));
        }
        self.controller.handle_input(now, input);
        while let Some(output) = self.controller.poll_output() {
            if !self.has_failed {
                for record in output_records(now, &output, self.start_unix_ns) {
                    self.record(record);
                }
            }
            self.put_out(now, output);
        }
    }

    /// After the first failure nothing more is recorded: a recording has an end, never a gap.
    fn record(&mut self, record: Record) {
        if self.has_failed {
            return;
        }
        match self.journal.record(record) {
            Ok(()) => self.recorded_count += 1,
            Err(error) => self.fail(&error),
        }
    }

    fn put_out(&mut self, now: Stamp, output: Output) {
        match &output {
            Output::Robot(RobotOutput::Bytes { kind, .. }) if kind.waits_for_journal() => {
                // It waits on from where the older began, or a disk that is too slow would never be noticed.
                let since = self.withhold(Device::Robot).unwrap_or(now);
                return self.wait(since, Device::Robot, output);
            }
            Output::Robot(RobotOutput::Bytes { kind: Kind::Set, .. })
            | Output::Robot(RobotOutput::Connect | RobotOutput::Close)
            | Output::Event(Event::HoldAsked { .. }) => {
                self.withhold(Device::Robot);
            }
            Output::Camera(CameraOutput::Bytes { .. }) if self.camera_is_cut => return,
            // Its messages are numbered: none overtakes another.
            Output::Camera(CameraOutput::Bytes { act, .. }) if *act || self.something_waits_for(Device::Camera) => {
                return self.wait(now, Device::Camera, output);
            }
            Output::Camera(CameraOutput::Close) => {
                self.withhold(Device::Camera);
            }
            Output::Camera(CameraOutput::Connect) => {
                self.withhold(Device::Camera);
                self.camera_is_cut = false;
            }
            Output::Sync { view_index, attempt } => return self.sync(now, *view_index, *attempt),
            _ => {}
        }
        self.outputs.push_back(output);
    }

    fn wait(&mut self, since: Stamp, device: Device, output: Output) {
        if self.has_failed {
            self.camera_is_cut |= device == Device::Camera;
            return;
        }
        self.waiting.push_back(Waiting {
            device,
            output,
            record_count: self.recorded_count,
            since,
        });
    }

    fn something_waits_for(&self, device: Device) -> bool {
        self.waiting.iter().any(|waiting| waiting.device == device)
    }

    /// What waits for this device never leaves; the recording says that it was put out, so it says this as well.
    /// Since when the first of it waited.
    fn withhold(&mut self, device: Device) -> Option<Stamp> {
        let first = self.waiting.iter().find(|waiting| waiting.device == device)?;
        let since = first.since;
        self.waiting.retain(|waiting| waiting.device != device);
        self.news.push_back(Input::Withheld { device });
        Some(since)
    }

    fn sync(&mut self, now: Stamp, view_index: usize, attempt: u16) {
        if self.has_failed {
            return;
        }
        match self.journal.sync() {
            Ok(()) => self.unsynced.push_back(Unsynced {
                view_index,
                attempt,
                record_count: self.recorded_count,
                since: now,
            }),
            Err(error) => self.fail(&error),
        }
    }

    /// Lets the journal go on, and does what follows from how far it has come.
    fn go_on(&mut self, now: Stamp) {
        loop {
            self.watch_journal(now);
            let Some(input) = self.news.pop_front() else { return };
            self.take(now, input);
        }
    }

    fn watch_journal(&mut self, now: Stamp) {
        if self.has_failed {
            return;
        }
        let progress = self.journal.flush().and_then(|()| self.journal.progress());
        match progress {
            Ok(progress) => self.let_go(progress),
            Err(error) => return self.fail(&error),
        }
        if self.slow_at().is_some_and(|at| at <= now) {
            self.fail(&JournalError::Slow);
        }
    }

    fn let_go(&mut self, progress: Progress) {
        let may_leave = |waiting: &mut Waiting| waiting.record_count <= progress.flushed_count;
        while let Some(waiting) = self.waiting.pop_front_if(may_leave) {
            self.outputs.push_back(waiting.output);
        }
        let is_kept = |unsynced: &mut Unsynced| unsynced.record_count <= progress.synced_count;
        while let Some(Unsynced {
            view_index, attempt, ..
        }) = self.unsynced.pop_front_if(is_kept)
        {
            self.news.push_back(Input::Synced { view_index, attempt });
        }
    }

    /// When what waits longest has waited too long.
    fn slow_at(&self) -> Option<Stamp> {
        let longest = self.waiting.iter().map(|waiting| waiting.since).min();
        let act = longest.map(|since| since.plus_ms(FLUSH_MS_MAX));
        let frame = self
            .unsynced
            .front()
            .map(|unsynced| unsynced.since.plus_ms(SYNC_MS_MAX));
        earlier(act, frame)
    }

    fn fail(&mut self, error: &JournalError) {
        if self.has_failed {
            return;
        }
        self.has_failed = true;
        self.camera_is_cut |= self.something_waits_for(Device::Camera);
        self.waiting.clear();
        self.unsynced.clear();
        self.news.clear();
        let reason = error.to_string();
        self.news.push_back(Input::JournalFailed { reason });
    }
}

/// An act that waits this long for the record of what caused it has met a disk that is too slow.
const FLUSH_MS_MAX: u64 = 1000;
/// A frame that waits this long for the disk has met one that is too slow.
const SYNC_MS_MAX: u64 = 10_000;

#[cfg(test)]
mod tests;
