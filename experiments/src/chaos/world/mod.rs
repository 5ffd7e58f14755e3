//! One run on virtual time, over all the processes that carry it: controller, recording, cell, and the people about them.

mod happen;
mod life;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use bladescan::camera::CameraOutput;
use bladescan::controller::{Command, Controller, Input, Output, ViewRecord};
use bladescan::event::{Ending, Event};
use bladescan::robot::RobotOutput;
use bladescan::run::{Beginning, Journalled, Pool};
use bladescan::stamp::Stamp;
use hw_sim::cell::{self, Cell};
use hw_sim::fault::Fault;
use hw_sim::robot::controller::Panel;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::disk::{Disk, RunJournal, Times};
use super::draw::{Happening, Kind, Setup, When};
use super::judge::{Bar, Judge, is_move};
use super::network::{LATENCY_NS, Network};
use super::studio::{Files, START_UNIX_NS, Studio};
use crate::camera_line::{CameraLine, Passing, pieces};

/// How a run came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Ended {
    Finished,
    /// Given up by the operator, after as often as he takes a run up again.
    GivenUp,
    Hung,
}

/// What is seen of a run.
pub(super) struct Outcome {
    pub(super) ended: Ended,
    pub(super) end_ns: u64,
    pub(super) process_count: u64,
    pub(super) files: Files,
    /// What was met, and what its process was then stopped by, if it was.
    pub(super) met: Vec<(String, BTreeSet<String>)>,
    pub(super) merged_all: bool,
    /// Whether the results were compared with those of an unbroken run.
    pub(super) compared: bool,
    pub(super) wrongs: Vec<(Bar, String)>,
    pub(super) recording: Vec<u8>,
    pub(super) story: Vec<(u64, String)>,
}

impl Outcome {
    /// Of many runs only what is counted is remembered.
    pub(super) fn forget(&mut self, run_count: u64) {
        if run_count > 1 {
            (self.recording, self.story, self.files) = (Vec::new(), Vec::new(), Files::new());
        }
    }
}

/// Runs `setup` to its end. It is recorded in `folder`, or on the model of a disk.
pub(super) fn drive(setup: &Setup, studio: &Studio, pool: &Pool, folder: Option<&Path>) -> Result<Outcome, String> {
    let mut world = World {
        setup,
        studio,
        pool,
        folder,
        cell: Cell::new(studio.scene(setup.camera_faults.clone(), 1)),
        boot_id: 1,
        faults: setup.camera_faults.clone(),
        now_ns: 0,
        active_ns: 0,
        wire: BTreeMap::new(),
        delivery_count: 0,
        process: 0,
        camera: CameraLine::default(),
        network: Network::new(setup.seed),
        chance: ChaCha8Rng::seed_from_u64(setup.seed ^ CHANCE_SALT),
        to_come: setup.happenings.clone(),
        event_count: 0,
        met: BTreeMap::new(),
        ends_abruptly: setup.ends_abruptly,
        end: None,
        judge: Judge::default(),
        files: Files::new(),
        story: Vec::new(),
    };
    world.run()
}

/// What may be on its way.
enum Delivery {
    /// From the process of this number; a move with the decision it belongs to.
    ToRobot(u64, Vec<u8>, Option<usize>),
    FromRobot(u64, Vec<u8>),
    Camera(Passing),
    /// For the process of this number.
    ToController(u64, Input),
    Panel(Panel),
    Happening(u64, Happening),
    /// The disk is itself again.
    DiskWell(u64),
}

/// How a process ends without having finished its run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sudden {
    Kill,
    PowerCut,
    Hang,
}

/// What a happening was met by, and until when it lasts.
struct Met {
    until_ns: u64,
    kind: Kind,
    stopped_by: BTreeSet<String>,
    in_process: u64,
}

/// A process: the run as it carries it, and its file.
struct Process {
    run: Journalled<RunJournal>,
    disk: Disk,
    began_ns: u64,
}

struct World<'a> {
    setup: &'a Setup,
    studio: &'a Studio,
    pool: &'a Pool,
    folder: Option<&'a Path>,
    cell: Cell,
    boot_id: u64,
    /// Faults of the camera that may still happen.
    faults: Vec<Fault>,
    now_ns: u64,
    /// How long processes have carried the run, until the one at work began.
    active_ns: u64,
    wire: BTreeMap<(u64, u64), Delivery>,
    delivery_count: u64,
    /// Number of the process at work, or of the last one.
    process: u64,
    camera: CameraLine,
    network: Network,
    chance: ChaCha8Rng,
    to_come: Vec<Happening>,
    event_count: usize,
    met: BTreeMap<String, Met>,
    /// Whether the next process that sees its run to the end is killed before the end of its recording.
    ends_abruptly: bool,
    end: Option<Sudden>,
    judge: Judge,
    files: Files,
    story: Vec<(u64, String)>,
}

impl World<'_> {
    fn run(&mut self) -> Result<Outcome, String> {
        let (mut process, mut beginning) = self.first()?;
        let mut taken_up_count = 0;
        loop {
            self.carry(&mut process, beginning);
            let ending = self.look_at_end(&process);
            if self.end == Some(Sudden::Hang) {
                let last = self.story.last().map_or_else(String::new, |(_, text)| text.clone());
                let about = format!("process {}, after {last}", self.process);
                self.judge.wrong(Bar::Hung, about);
                return Ok(self.outcome(Ended::Hung, false, false, Vec::new()));
            }
            let is_seen_through = ending == Some(Ending::Finished) && !self.ends_abruptly;
            let has_failed = process.disk.has_failed();
            let (recording, controller) = self.file_of(process);
            if is_seen_through && !has_failed {
                self.check_replay(&recording);
                return self.concluded(Ended::Finished, &controller, recording);
            }
            let rebuilt = match self.rebuilt(&recording) {
                Ok(rebuilt) => rebuilt,
                Err(error) => {
                    self.judge.wrong(Bar::Recording, error);
                    return Ok(self.outcome(Ended::Hung, false, false, recording));
                }
            };
            let is_finished = rebuilt.controller.is_over() && rebuilt.controller.ending() == Some(&Ending::Finished);
            if is_finished || taken_up_count == TAKEN_UP_MAX {
                self.check_replay(&recording);
                self.files = rebuilt.files;
                let ended = if is_finished { Ended::Finished } else { Ended::GivenUp };
                return self.concluded(ended, &rebuilt.controller, recording);
            }
            taken_up_count += 1;
            self.wait_to_take_up(ending.as_ref());
            (process, beginning) = self.taken_up(&recording, rebuilt)?;
        }
    }

    fn first(&mut self) -> Result<(Process, Beginning), String> {
        let (journal, disk) = self.studio.journal(self.setup, self.folder)?;
        let run = Journalled::new(self.studio.controller(self.setup)?, journal, START_UNIX_NS);
        Ok((self.begun(run, disk), Beginning::default()))
    }

    /// How the process has ended its run, if it has.
    fn look_at_end(&mut self, process: &Process) -> Option<Ending> {
        self.note_met_camera();
        let controller = process.run.controller();
        let ending = controller.ending().filter(|_| controller.is_over()).cloned();
        let (number, end) = (self.process, self.end);
        self.tell(|| format!("process {number} ends: {end:?} {ending:?}"));
        self.handle_ending(process.began_ns, ending.as_ref());
        if ending.is_some() {
            self.judge.handle_end(controller);
        }
        ending
    }

    fn concluded(&mut self, ended: Ended, controller: &Controller, recording: Vec<u8>) -> Result<Outcome, String> {
        self.judge.handle_end(controller);
        let attempts = Judge::attempts(controller).filter(|_| ended == Ended::Finished);
        let compared = match attempts {
            Some(attempts) => self.compare(&attempts)?,
            None => false,
        };
        let merged = |view: &ViewRecord| view.model_from_view().is_some();
        let merged_all = controller.views().iter().all(merged);
        Ok(self.outcome(ended, compared, merged_all, recording))
    }

    fn outcome(&mut self, ended: Ended, compared: bool, merged_all: bool, recording: Vec<u8>) -> Outcome {
        let judge = core::mem::take(&mut self.judge);
        let met = core::mem::take(&mut self.met);
        Outcome {
            ended,
            end_ns: self.now_ns,
            process_count: self.process,
            files: core::mem::take(&mut self.files),
            met: met.into_iter().map(|(name, met)| (name, met.stopped_by)).collect(),
            merged_all,
            compared,
            wrongs: judge.into_wrongs(),
            recording,
            story: core::mem::take(&mut self.story),
        }
    }

    /// Carries the run on until it is over or the process ends.
    fn carry(&mut self, process: &mut Process, beginning: Beginning) {
        for (job_id, done) in beginning.done {
            let done = Input::JobDone { job_id, done };
            self.send(0, Delivery::ToController(self.process, done));
        }
        self.tell_run(process, beginning.input);
        while !process.run.controller().is_over() && self.end.is_none() {
            self.wait_for_file(process);
            let next = [
                self.wire.keys().next().map(|(at_ns, _)| *at_ns),
                process.run.wake_at().map(|stamp| stamp.ns),
                self.cell.wake_at(),
                process.disk.wake_at(),
            ];
            let next_ns = next.into_iter().flatten().min();
            let is_late = next_ns.is_none_or(|next_ns| next_ns > process.began_ns + PROCESS_NS_MAX);
            if is_late {
                self.end = Some(Sudden::Hang);
                return;
            }
            self.now_ns = next_ns.unwrap_or_default().max(self.now_ns);
            let now_ns = self.now_ns;
            if process.disk.wake_at().is_some_and(|at_ns| at_ns <= now_ns) {
                process.disk.advance(now_ns);
                process.run.handle_progress(Stamp { ns: now_ns });
                self.carry_out(process);
            } else if let Some(delivery) = self.due() {
                self.deliver(delivery, Some(process));
            } else if self.cell.wake_at().is_some_and(|at_ns| at_ns <= now_ns) {
                self.ask_cell(cell::Input::Wake);
            } else {
                process.disk.advance(now_ns);
                process.run.handle_wake(Stamp { ns: now_ns });
                self.carry_out(process);
            }
        }
    }

    /// A real file takes real time, in which nothing else happens.
    fn wait_for_file(&mut self, process: &mut Process) {
        let since = Instant::now();
        while self.folder.is_some() && process.run.is_waiting() && since.elapsed() < FILE_TIME_MAX {
            thread::sleep(FILE_PAUSE);
            process.run.handle_progress(Stamp { ns: self.now_ns });
            self.carry_out(process);
        }
    }

    /// The world goes on without a process.
    fn idle(&mut self, span_ns: u64) {
        let until_ns = self.now_ns + span_ns;
        loop {
            let wire = self.wire.keys().next().map(|(at_ns, _)| *at_ns);
            let next = wire.into_iter().chain(self.cell.wake_at()).min();
            let Some(next_ns) = next.filter(|next_ns| *next_ns <= until_ns) else {
                break;
            };
            self.now_ns = next_ns.max(self.now_ns);
            match self.due() {
                Some(delivery) => self.deliver(delivery, None),
                None => self.ask_cell(cell::Input::Wake),
            }
        }
        self.now_ns = until_ns;
    }

    fn due(&mut self) -> Option<Delivery> {
        let first = self.wire.first_entry()?;
        (first.key().0 <= self.now_ns).then(|| first.remove())
    }

    fn deliver(&mut self, delivery: Delivery, process: Option<&mut Process>) {
        let number = if process.is_some() { self.process } else { 0 };
        match (delivery, process) {
            (Delivery::ToRobot(from, bytes, decision), _) => self.tell_robot(from, bytes, decision),
            (Delivery::Camera(Passing::ToCamera(input)), _) => self.ask_cell(input),
            (Delivery::Panel(panel), _) => {
                self.tell(|| format!("panel: {panel:?}"));
                self.ask_cell(cell::Input::Panel(panel));
            }
            (Delivery::FromRobot(to, bytes), Some(process)) if to == number => {
                self.tell_run(process, Input::RobotBytes(bytes));
            }
            (Delivery::Camera(Passing::FromCamera(connection, input)), Some(process))
                if self.camera.hears(connection, &input) =>
            {
                self.tell_run(process, input);
            }
            (Delivery::ToController(to, input), Some(process)) if to == number => self.tell_run(process, input),
            (Delivery::Happening(of, happening), Some(process)) if of == number => self.befall(process, happening),
            (Delivery::Happening(_, happening), _) => self.to_come.push(happening),
            (Delivery::DiskWell(of), Some(process)) if of == number => process.disk.set_times(Times::default()),
            _ => (),
        }
    }

    fn tell_run(&mut self, process: &mut Process, input: Input) {
        process.disk.advance(self.now_ns);
        process.run.handle_input(Stamp { ns: self.now_ns }, input);
        self.carry_out(process);
    }

    fn carry_out(&mut self, process: &mut Process) {
        while let Some(output) = process.run.poll_output() {
            let disk = Some(&process.disk).filter(|_| self.folder.is_none());
            self.judge.handle_output(&output, disk, process.run.has_failed());
            match output {
                Output::Robot(RobotOutput::Bytes { bytes, .. }) => {
                    let decision = is_move(&bytes).then(|| self.judge.decision());
                    for late_ns in self.network.carry(self.now_ns) {
                        self.send(late_ns, Delivery::ToRobot(self.process, bytes.clone(), decision));
                    }
                    self.note_met_network();
                }
                Output::Camera(output) => self.do_with_camera(output),
                Output::Job { job_id, job } => {
                    let done = self.studio.finished(&job, self.pool);
                    let done = Input::JobDone { job_id, done };
                    self.send(self.setup.job_ns, Delivery::ToController(self.process, done));
                }
                Output::Event(event) => self.see(&event),
                Output::File { name, bytes } => {
                    self.files.insert(name, bytes);
                }
                _ => (),
            }
        }
    }

    fn see(&mut self, event: &Event) {
        if matches!(event, Event::CameraCondition { .. }) {
            return;
        }
        self.tell(|| event.words());
        let count = self.event_count;
        self.event_count += 1;
        let due: Vec<Happening> = self
            .to_come
            .extract_if(
                ..,
                |happening| matches!(happening.when, When::After(event, _) if event == count),
            )
            .collect();
        for happening in due {
            if let When::After(_, late_ns) = happening.when {
                self.send(late_ns, Delivery::Happening(self.process, happening));
            }
        }
        if matches!(event, Event::Held) {
            let pause_ns = self.chance.random_range(HELD_NS);
            let is_step = self.chance.random::<f64>() < STEP_FRACTION;
            let word = if is_step { Command::Step } else { Command::Resume };
            self.send(pause_ns, Delivery::ToController(self.process, Input::Operator(word)));
        }
    }

    fn do_with_camera(&mut self, output: CameraOutput) {
        for (latency_count, passing) in self.camera.handle_output(output) {
            self.send(latency_count * LATENCY_NS, Delivery::Camera(passing));
        }
    }

    fn tell_robot(&mut self, from: u64, bytes: Vec<u8>, decision: Option<usize>) {
        let robot = self.cell.robot();
        let (pose, before) = (robot.pose(self.now_ns), robot.accepted_move_count());
        let address = ([127, 0, 0, 1], FIRST_PORT + from as u16).into();
        self.ask_cell(cell::Input::RobotDatagram {
            from: address,
            bytes: bytes.clone(),
        });
        if let Some(decision) = decision
            && self.cell.robot().accepted_move_count() > before
        {
            self.judge.handle_accepted_move(decision, &pose, &bytes);
        }
    }

    fn ask_cell(&mut self, input: cell::Input) {
        self.cell.handle_input(self.now_ns, input);
        while let Some(output) = self.cell.poll_output() {
            match output {
                cell::Output::RobotDatagram { to, bytes } => {
                    let process = u64::from(to.port() - FIRST_PORT);
                    for late_ns in self.network.carry(self.now_ns) {
                        self.send(late_ns, Delivery::FromRobot(process, bytes.clone()));
                    }
                    self.note_met_network();
                }
                cell::Output::CameraBytes { connection, bytes } => self.carry_pieces(connection, &bytes),
                cell::Output::CameraClose { connection } => {
                    let reason = "the camera closed the connection".to_owned();
                    let closed = Input::CameraClosed { reason };
                    self.send(LATENCY_NS, Delivery::Camera(Passing::FromCamera(connection, closed)));
                }
                cell::Output::Render(job) => {
                    let frame = self.studio.frame(&job);
                    self.judge.frames().handle_rendered(job.draws.trigger_id, &frame);
                    self.ask_cell(cell::Input::Rendered { job: job.job, frame });
                }
                cell::Output::Violation(text) => self.judge.wrong(Bar::Protocol, text),
                cell::Output::RobotPort(output) => {
                    self.judge
                        .wrong(Bar::Protocol, format!("nobody is at this port: {output:?}"));
                }
                cell::Output::TruthGrew => {
                    if let Some(view) = self.cell.truth().views.last() {
                        self.judge.handle_exposure(view.trigger_id, view.moved_during_exposure);
                    }
                }
            }
        }
    }

    fn carry_pieces(&mut self, connection: u64, bytes: &[u8]) {
        for piece in pieces(bytes, self.setup.piece_bytes_max, &mut self.chance) {
            let input = Input::CameraBytes(piece.to_vec());
            self.send(LATENCY_NS, Delivery::Camera(Passing::FromCamera(connection, input)));
        }
    }

    fn send(&mut self, latency_ns: u64, delivery: Delivery) {
        self.delivery_count += 1;
        self.wire
            .insert((self.now_ns + latency_ns, self.delivery_count), delivery);
    }

    fn tell(&mut self, words: impl FnOnce() -> String) {
        self.story.push((self.now_ns, words()));
    }
}

const CHANCE_SALT: u64 = 0x5EED;
const FIRST_PORT: u16 = 5000;
/// How often the operator takes a run up again.
const TAKEN_UP_MAX: u32 = 6;
/// Longer than a real file may take.
const FILE_TIME_MAX: Duration = Duration::from_secs(30);
const FILE_PAUSE: Duration = Duration::from_micros(20);
/// No process may take longer: four things of the longest kind, each waited for as long as the station allows.
const PROCESS_NS_MAX: u64 = 900_000_000_000;
/// Between a hold and the word after it.
const HELD_NS: core::ops::Range<u64> = 300_000_000..6_000_000_000;
const STEP_FRACTION: f64 = 0.15;
