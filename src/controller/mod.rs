//! A run as a value: bytes, commands, finished jobs and time go in; bytes, jobs, events and files come out.
//!
//! The caller (the tokio shell, a test, or replay) follows one rule: hand over one [`Input`], then take outputs with
//! [`Controller::poll_output`] until there are none, then wait for the next input or for [`Controller::wake_at`].

mod backlog;
mod check;
mod evidence;
mod exchanges;
mod files;
mod header;
mod provenance;
mod reconstruct;

pub use backlog::{UnusedAttempt, ViewOutcome, ViewRecord};
pub use header::{Header, Simulation};
pub use provenance::Source;
pub use reconstruct::{Outside, Reconstructed, Reconstruction};

pub use crate::session::Command;

use crate::camera::CameraOutput;
use crate::event::{Ending, Event};
use crate::fault::{Fault, FaultCode};
use crate::geometry::PointCloud;
use crate::job::{FinishedJob, Job};
use crate::plan::Plan;
use crate::reconstruction::Model;
use crate::robot::RobotOutput;
use crate::session::{Session, SessionEvent, State};
use crate::settings::{Recipe, Station};
use crate::stamp::Stamp;
use backlog::Backlog;
use check::{GripCheck, Verdict};
use evidence::Evidence;
use nalgebra::Isometry3;
use provenance::Provenance;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::Arc;

/// Everything that can happen to a run.
#[derive(Debug, Clone)]
pub enum Input {
    /// The run begins. The first input of all.
    Begin,
    /// The time of [`Controller::wake_at`] has come.
    Wake,
    /// The robot's connection stands.
    RobotConnected,
    /// A datagram from the robot, or a piece of its stream.
    RobotBytes(Vec<u8>),
    /// The robot's connection did not come about or has ended.
    RobotClosed {
        /// The system's words.
        reason: String,
    },
    /// The network says that nothing listens at the robot's address.
    RobotUnreachable {
        /// The system's words.
        reason: String,
    },
    /// The camera's connection stands.
    CameraConnected,
    /// Bytes from the camera.
    CameraBytes(Vec<u8>),
    /// The camera's connection did not come about or has ended.
    CameraClosed {
        /// The system's words.
        reason: String,
    },
    /// A word of the operator.
    Operator(Command),
    /// A job has ended.
    JobDone {
        /// Which one.
        job_id: u32,
        /// What came of it.
        done: FinishedJob,
    },
    /// Another process goes on with the run, after everything before it has been fed to this controller.
    Restarted {
        /// Its version of bladescan.
        version: String,
    },
    /// Everything recorded before [`Output::Sync`] is on the disk.
    Synced {
        /// Which view's frame is kept by that.
        view_index: usize,
        /// Which attempt at it.
        attempt: u16,
    },
    /// Bytes that were put out for a device waited for the journal and will never leave.
    Withheld {
        /// For which.
        device: Device,
    },
    /// The journal cannot be written any more.
    JournalFailed {
        /// The system's words.
        reason: String,
    },
}

/// One of the two devices of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Device {
    /// The robot.
    Robot,
    /// The camera.
    Camera,
}

/// Everything that a run wants done.
#[derive(Debug, Clone)]
pub enum Output {
    /// Do something with the wire to the robot.
    Robot(RobotOutput),
    /// Do something with the camera's connection.
    Camera(CameraOutput),
    /// Run a job and hand its result back.
    Job {
        /// Its number.
        job_id: u32,
        /// What to do.
        job: Arc<Job>,
    },
    /// A frame has come: put everything recorded so far on the disk, then hand [`Input::Synced`] back.
    Sync {
        /// Which view's frame.
        view_index: usize,
        /// Which attempt at it.
        attempt: u16,
    },
    /// Something happened.
    Event(Event),
    /// The cloud of a view, for the recording.
    ViewCloud {
        /// Which view.
        view_index: usize,
        /// Camera frame, mm.
        cloud: Arc<PointCloud>,
    },
    /// Where a view lies, for the recording.
    ViewPose {
        /// Which view.
        view_index: usize,
        /// Its pose in the model.
        model_from_view: Isometry3<f64>,
    },
    /// The finished model, for the recording.
    Model(Arc<Model>),
    /// A file of the run.
    File {
        /// Its name in the run's folder.
        name: &'static str,
        /// Its content.
        bytes: Vec<u8>,
    },
}

/// A run.
#[derive(Debug)]
pub struct Controller {
    provenance: Provenance,
    evidence: Evidence,
    plan: Plan,
    session: Session,
    backlog: Backlog,
    check: GripCheck,
    begun: bool,
    over: bool,
    /// Frames that have come and are not on the disk yet: view and attempt.
    unkept: VecDeque<(usize, u16)>,
    journal_failed: bool,
    outputs: VecDeque<Output>,
}

impl Controller {
    /// A run that has not begun.
    pub fn new(header: Header, recipe: &Recipe, station: &Station, plan: Plan) -> Self {
        Self {
            session: Session::new(recipe, station, plan.views(), header.run_id, header.seed),
            backlog: Backlog::new(recipe, station, plan.views(), header.seed),
            check: GripCheck::new(recipe, station, header.seed),
            provenance: Provenance::new(header, station),
            evidence: Evidence::default(),
            plan,
            begun: false,
            over: false,
            unkept: VecDeque::new(),
            journal_failed: false,
            outputs: VecDeque::new(),
        }
    }

    /// Something has happened.
    pub fn handle_input(&mut self, now: Stamp, input: Input) {
        if self.over && !matches!(input, Input::Restarted { .. }) {
            return;
        }
        let queued_count = self.outputs.len();
        self.evidence.note_input(now, &input, self.session.state());
        match input {
            Input::Begin => self.begin(now),
            Input::Wake => self.session.handle_wake(now),
            Input::RobotConnected => self.session.handle_robot_connected(now),
            Input::RobotBytes(bytes) => self.session.handle_robot_bytes(now, &bytes),
            Input::RobotClosed { reason } => self.session.handle_robot_closed(now, &reason),
            Input::RobotUnreachable { reason } => self.session.handle_robot_unreachable(now, &reason),
            Input::CameraConnected => self.session.handle_camera_connected(now),
            Input::CameraBytes(bytes) => self.session.handle_camera_bytes(now, &bytes),
            Input::CameraClosed { reason } => self.session.handle_camera_closed(now, &reason),
            Input::Operator(command) => self.handle_command(now, command),
            Input::Restarted { version } => self.restart(now, version),
            Input::JobDone { job_id, done } if self.check.owns(job_id) => self.handle_checked(now, done),
            Input::JobDone { job_id, done } => {
                if let Some(text) = self.backlog.handle_done(now, job_id, done) {
                    self.session.fault(now, Fault::new(FaultCode::JobPanicked, text));
                }
            }
            Input::Synced { view_index, attempt } => self.handle_synced((view_index, attempt)),
            Input::Withheld { device } => self.handle_withheld(now, device),
            Input::JournalFailed { reason } => {
                self.journal_failed = true;
                // Nothing will be kept any more.
                self.unkept.clear();
                self.session.fault(now, Fault::new(FaultCode::Journal, reason));
            }
        }
        self.proceed(now);
        self.note_outputs(now, queued_count);
        if self.session.is_over() && self.backlog.is_idle() && self.unkept.is_empty() {
            self.conclude(now);
        }
    }

    /// When [`Input::Wake`] is due.
    pub fn wake_at(&self) -> Option<Stamp> {
        if self.over { None } else { self.session.wake_at() }
    }

    /// The next thing to do.
    #[must_use]
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Whether the run is over and every output of it has been queued.
    pub fn is_over(&self) -> bool {
        self.over
    }

    /// How the run ended, or is about to.
    pub fn ending(&self) -> Option<&Ending> {
        self.session.ending()
    }

    /// Where the acquisition stands.
    pub fn state(&self) -> State {
        self.session.state()
    }

    /// What became of each planned view so far.
    pub fn views(&self) -> &[ViewRecord] {
        self.backlog.views()
    }

    /// The views that are still to be taken, in the order in which they will be.
    pub fn left(&self) -> Vec<usize> {
        self.session.left()
    }

    /// How many views must be merged for the run to count as done.
    pub fn merged_min_count(&self) -> usize {
        self.plan.merged_min_count()
    }

    fn begin(&mut self, now: Stamp) {
        if self.begun {
            return;
        }
        self.begun = true;
        self.outputs.push_back(Output::Event(Event::Started {
            recipe: self.provenance.header().recipe.clone(),
            station: self.provenance.header().station.clone(),
            view_count: self.plan.views().len(),
        }));
        self.session.begin(now);
    }

    /// Everything that was taken and decided stays; the conversations with the devices begin anew.
    fn restart(&mut self, now: Stamp, version: String) {
        self.over = false;
        self.begun = true;
        self.journal_failed = false;
        // Their records have just been read.
        for (view_index, attempt) in self.unkept.drain(..) {
            self.outputs
                .push_back(Output::Event(Event::FrameKept { view_index, attempt }));
        }
        let checked_view = self.check.restart();
        self.session.restart(checked_view);
        self.outputs.push_back(Output::Event(Event::Restarted {
            version,
            taken_count: self.backlog.taken_count(),
            left_count: self.session.left().len(),
        }));
        self.session.begin(now);
    }

    fn handle_checked(&mut self, now: Stamp, done: FinishedJob) {
        match self.check.handle_done(done) {
            None => {}
            Some(Verdict::Passed(event)) => {
                self.outputs.push_back(Output::Event(event));
                self.session.pass_check();
            }
            Some(Verdict::Moved(event, fault)) => {
                self.outputs.push_back(Output::Event(event));
                self.session.fault(now, fault);
            }
            Some(Verdict::Panicked(text)) => self.session.fault(now, Fault::new(FaultCode::JobPanicked, text)),
        }
    }

    /// Compares the view that was taken again as soon as that is possible, and does without where it never will be.
    fn check_on(&mut self) -> bool {
        let compare = self.check.compare(|| self.backlog.take_job_id());
        if let Some(compare) = compare {
            self.outputs.push_back(compare);
            return true;
        }
        let never = self.check.is_without_before() && self.backlog.is_idle();
        if never {
            self.check.give_up();
            let text = "the last view has no cloud to compare with: the grip is not checked".to_owned();
            self.outputs.push_back(Output::Event(Event::Noted { text }));
            self.session.pass_check();
        }
        never
    }

    fn handle_command(&mut self, now: Stamp, command: Command) {
        self.session.obey(now, command);
        self.session.handle_wake(now);
    }

    /// A frame is on the disk: from now on its view counts as taken.
    fn handle_synced(&mut self, synced: (usize, u16)) {
        if let Some(place) = self.unkept.iter().position(|frame| *frame == synced) {
            self.unkept.remove(place);
            let (view_index, attempt) = synced;
            self.outputs
                .push_back(Output::Event(Event::FrameKept { view_index, attempt }));
        }
    }

    fn handle_withheld(&mut self, now: Stamp, device: Device) {
        let name = match device {
            Device::Robot => "robot",
            Device::Camera => "camera",
        };
        let text = format!("what waited for the recording was not sent to the {name}");
        self.outputs.push_back(Output::Event(Event::Noted { text }));
        if device == Device::Robot {
            self.session.handle_robot_withheld(now);
        }
    }

    /// Carries everything as far as it goes without another input.
    fn proceed(&mut self, now: Stamp) {
        loop {
            let waiting_count = self.backlog.waiting_count().max(self.unkept.len());
            self.session.advance(now, waiting_count);
            let mut moved = self.take_session_outputs(now);
            if self.begun && self.session.is_acquired() && self.unkept.is_empty() {
                moved |= self.take_again_or_finish(now);
            }
            moved |= self.take_backlog_outputs();
            moved |= self.check_on();
            if !moved {
                break;
            }
        }
    }

    /// What is new in the queue is seen by those who only watch.
    fn note_outputs(&mut self, now: Stamp, queued_count: usize) {
        for output in self.outputs.iter().skip(queued_count) {
            if let Output::Event(event) = output {
                self.provenance.note(event);
            }
            self.evidence.note_output(now, output);
        }
    }

    /// Every view is taken: those that the recipe wants again are, once all are decided, or the run ends. A hold is seen
    /// through first.
    fn take_again_or_finish(&mut self, now: Stamp) -> bool {
        if matches!(self.session.state(), State::Holding | State::Ending | State::Over) || self.backlog.may_want_more()
        {
            return false;
        }
        let targets = self.backlog.take_again();
        if !targets.is_empty() {
            self.session.take_again(targets);
            return true;
        }
        self.session.finish(now);
        self.session.handle_wake(now);
        true
    }

    fn take_session_outputs(&mut self, now: Stamp) -> bool {
        let before = self.outputs.len();
        let mut captured = false;
        while let Some(output) = self.session.poll_robot() {
            self.outputs.push_back(Output::Robot(output));
        }
        while let Some(output) = self.session.poll_camera() {
            self.outputs.push_back(Output::Camera(output));
        }
        while let Some(event) = self.session.poll_event() {
            match event {
                SessionEvent::Event(event) => self.outputs.push_back(Output::Event(event)),
                SessionEvent::Check(view) => {
                    let job_id = self.backlog.take_job_id();
                    let prepare = self.check.begin(job_id, &view);
                    self.outputs.push_back(prepare);
                }
                SessionEvent::Captured(view) => {
                    captured = true;
                    self.check.remember(&view);
                    self.keep(view.view_index, view.attempt);
                    self.backlog.add(now, view);
                }
                SessionEvent::Failed {
                    view_index,
                    attempt,
                    reason,
                } => self.backlog.note_failed(view_index, attempt, reason),
                SessionEvent::Missing { view_index, reason } => {
                    self.backlog.give_up(view_index, &reason);
                    self.outputs
                        .push_back(Output::Event(Event::ViewMissing { view_index, reason }));
                }
            }
        }
        captured || self.outputs.len() > before
    }

    fn keep(&mut self, view_index: usize, attempt: u16) {
        if !self.journal_failed {
            self.unkept.push_back((view_index, attempt));
            self.outputs.push_back(Output::Sync { view_index, attempt });
        }
    }

    fn take_backlog_outputs(&mut self) -> bool {
        let before = self.outputs.len();
        while let Some(output) = self.backlog.poll_output() {
            if let Output::ViewCloud { view_index, cloud } = &output {
                self.check.remember_cloud(*view_index, cloud);
            }
            self.outputs.push_back(output);
        }
        self.outputs.len() > before
    }

    fn conclude(&mut self, now: Stamp) {
        self.over = true;
        let ending = self
            .session
            .ending()
            .cloned()
            .expect("a session that is over has an ending");
        let model = self.backlog.model();
        if !model.is_empty() {
            self.outputs.push_back(Output::Model(model.clone()));
        }
        let decided = files::Decided {
            provenance: &self.provenance,
            backlog: &self.backlog,
            ending: &ending,
            merged_min_count: self.plan.merged_min_count(),
        };
        let mut files = decided.files(now);
        let evidence = self.evidence.take(&ending, &self.provenance.value());
        files.extend(evidence.map(|value| ("fault.json", files::text(&value))));
        for (name, bytes) in files {
            self.outputs.push_back(Output::File { name, bytes });
        }
        self.outputs.push_back(Output::Event(Event::Ended { ending }));
    }
}
