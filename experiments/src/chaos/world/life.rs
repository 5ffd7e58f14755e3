//! The life of a process: how it begins, what it leaves behind, and how the next one takes the run up.

use std::collections::BTreeSet;

use bladescan::controller::{Controller, Input, Output};
use bladescan::event::{Ending, Event};
use bladescan::job::FinishedJob;
use bladescan::journal::Recording;
use bladescan::run::{Beginning, JournalFile, Journalled, Rebuilt, RecordingFile, rebuild, replay};
use bladescan::stamp::Stamp;
use hw_sim::cell::{self, Cell};
use hw_sim::fault::Fault;
use rand::RngExt;

use super::super::disk::{Cut, Disk, DiskJournal, RunJournal};
use super::super::draw::{Happening, UNBROKEN_SEED, VIEW_COUNT_MAX, When};
use super::super::judge::Bar;
use super::super::network::LATENCY_NS;
use super::super::studio::START_UNIX_NS;
use super::{Delivery, Process, Sudden, World};
use crate::camera_line::Passing;

impl World<'_> {
    /// A process is there from now on.
    pub(super) fn begun(&mut self, run: Journalled<RunJournal>, disk: Disk) -> Process {
        self.process += 1;
        self.end = None;
        let (now_ns, active_ns) = (self.now_ns, self.active_ns);
        disk.advance(now_ns);
        let of_before = self
            .wire
            .extract_if(.., |_, delivery| matches!(delivery, Delivery::Happening(..)));
        let of_before = of_before.filter_map(|(_, delivery)| match delivery {
            Delivery::Happening(_, happening) => Some(happening),
            _ => None,
        });
        self.to_come.extend(of_before.collect::<Vec<Happening>>());
        let event_count = self.event_count;
        let is_due = |happening: &mut Happening| match happening.when {
            When::At(_) => true,
            When::After(event, _) => event < event_count,
        };
        for happening in self.to_come.extract_if(.., is_due).collect::<Vec<_>>() {
            let late_ns = match happening.when {
                When::At(at_ns) => at_ns.saturating_sub(active_ns),
                When::After(_, late_ns) => late_ns,
            };
            self.send(late_ns, Delivery::Happening(self.process, happening));
        }
        Process {
            run,
            disk,
            began_ns: now_ns,
        }
    }

    /// The process is gone: what is left of its file.
    pub(super) fn file_of(&mut self, process: Process) -> (Vec<u8>, Controller) {
        self.active_ns += self.now_ns - process.began_ns;
        if let Some(connection) = self.camera.take() {
            self.send(
                LATENCY_NS,
                Delivery::Camera(Passing::ToCamera(cell::Input::CameraClosed { connection })),
            );
        }
        let torn_fraction = if self.chance.random() {
            0.0
        } else {
            self.chance.random()
        };
        let (controller, journal) = process.run.into_parts();
        let file = match self.end {
            Some(Sudden::PowerCut) => {
                self.switch_cell_on_anew();
                process.disk.cut(Cut::Power, torn_fraction)
            }
            Some(Sudden::Kill | Sudden::Hang) => process.disk.cut(Cut::Kill, torn_fraction),
            None if core::mem::take(&mut self.ends_abruptly) => process.disk.cut(Cut::Kill, torn_fraction),
            None => finished(journal),
        };
        (file, controller)
    }

    fn switch_cell_on_anew(&mut self) {
        let happened = self.cell.met_camera_faults();
        let is_over = |fault: &Fault| !matches!(fault, Fault::Camera(fault) if !happened.contains(fault));
        self.faults.retain(|fault| !is_over(fault));
        self.boot_id += 1;
        self.cell = Cell::new(self.studio.scene(self.faults.clone(), self.boot_id));
    }

    /// The operator looks at what has happened, has it put right, and takes the run up again.
    pub(super) fn wait_to_take_up(&mut self, ending: Option<&Ending>) {
        let is_of_camera =
            |ending: &Ending| matches!(ending, Ending::Faulted { fault } if fault.code.name().starts_with("camera"));
        if ending.is_some_and(is_of_camera) {
            self.switch_cell_on_anew();
        }
        let pause_ns = self.chance.random_range(TAKEN_UP_NS);
        self.idle(pause_ns);
    }

    pub(super) fn rebuilt(&mut self, recording: &[u8]) -> Result<Rebuilt, String> {
        let recording = Recording::open(recording).map_err(|error| error.to_string())?;
        let mut arrived = BTreeSet::new();
        let mut see = |output: &Output| {
            if let Output::Event(Event::FrameArrived {
                view_index, attempt, ..
            }) = output
            {
                arrived.insert((*view_index, *attempt));
            }
        };
        let rebuilt = rebuild(&recording, self.pool, &mut see).map_err(|error| error.to_string())?;
        self.judge.handle_rebuilt(arrived);
        Ok(rebuilt)
    }

    pub(super) fn taken_up(&mut self, recording: &[u8], rebuilt: Rebuilt) -> Result<(Process, Beginning), String> {
        let recording = Recording::open(recording).map_err(|error| error.to_string())?;
        let disk = Disk::default();
        let journal = match self.folder {
            None => {
                let writer = recording
                    .copied(disk.clone(), &rebuilt.unwritten)
                    .map_err(|error| error.to_string())?;
                let record_count = writer.flushed_count();
                RunJournal::Model(Box::new(DiskJournal::new(writer, disk.clone(), record_count)))
            }
            Some(folder) => {
                let file = RecordingFile::open(&folder.join("run.mcap")).map_err(|error| error.to_string())?;
                let journal = JournalFile::resume(file, &recording, &rebuilt.unwritten);
                RunJournal::File(journal.map_err(|error| error.to_string())?)
            }
        };
        let run = Journalled::new(rebuilt.controller, journal, START_UNIX_NS);
        self.now_ns = self.now_ns.max(rebuilt.last.ns + 1);
        let done = rebuilt.done.into_iter().map(|(job_id, done)| {
            let done = FinishedJob {
                times: Vec::new(),
                ..done
            };
            (job_id, done)
        });
        let version = env!("CARGO_PKG_VERSION").to_owned();
        let beginning = Beginning {
            input: Input::Restarted { version },
            at: Stamp { ns: self.now_ns },
            done: done.collect(),
        };
        Ok((self.begun(run, disk), beginning))
    }

    /// Whether there was something to compare with.
    pub(super) fn compare(&mut self, attempts: &[u16]) -> Result<bool, String> {
        let is_long = attempts.len() > VIEW_COUNT_MAX && attempts.iter().any(|attempt| *attempt > 0);
        let is_unbroken = self.setup.seed == UNBROKEN_SEED || is_long;
        if is_unbroken || attempts.iter().any(|attempt| *attempt > ATTEMPT_MAX) {
            return Ok(false);
        }
        let unbroken = self.studio.unbroken(attempts, self.pool)?;
        for name in ["poses.json", "model.ply"] {
            if self.files.get(name) != unbroken.get(name) {
                self.judge.wrong(Bar::Differs, format!("{name}, attempts {attempts:?}"));
            }
        }
        Ok(true)
    }

    pub(super) fn check_replay(&mut self, recording: &[u8]) {
        if !self.setup.is_replayed {
            return;
        }
        let report = Recording::open(recording)
            .map_err(|error| error.to_string())
            .and_then(|recording| replay(&recording, self.pool).map_err(|error| error.to_string()));
        match report {
            Ok(report) if report.identical => (),
            Ok(report) => self
                .judge
                .wrong(Bar::Recording, format!("replay: {:?}", report.difference)),
            Err(error) => self.judge.wrong(Bar::Recording, error),
        }
    }
}

/// Ends a recording and reads it.
fn finished(journal: RunJournal) -> Vec<u8> {
    match journal {
        RunJournal::Model(journal) => journal.finish(),
        RunJournal::File(journal) => {
            let path = journal.finish().ok();
            path.and_then(|path| std::fs::read(path).ok()).unwrap_or_default()
        }
    }
}

/// Between the end of a process and the next one.
const TAKEN_UP_NS: core::ops::Range<u64> = 500_000_000..15_000_000_000;
/// Attempts at a view that a run without other things can be made with.
const ATTEMPT_MAX: u16 = 2;
