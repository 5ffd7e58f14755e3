//! What must not be, whatever happens to a run.

use std::collections::{BTreeMap, BTreeSet};

use bladescan::camera::CameraOutput;
use bladescan::controller::{Controller, Output, ViewOutcome};
use bladescan::event::{CHECK_ATTEMPT_FIRST, Event};
use bladescan::job::Job;
use bladescan::robot::RobotOutput;
use hw_sim::robot::pose::Pose;

use super::disk::Disk;
use crate::camera_faults::judge::Judge as FrameJudge;

/// Things of which there must be none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Bar {
    Lost,
    TakenAgain,
    WrongFrame,
    MovedTwice,
    MovedWhileHeld,
    MovedWhileExposed,
    LeftEarly,
    Hung,
    Unexplained,
    Differs,
    Recording,
    Protocol,
}

impl Bar {
    pub(super) const ALL: [Self; 12] = [
        Self::Lost,
        Self::TakenAgain,
        Self::WrongFrame,
        Self::MovedTwice,
        Self::MovedWhileHeld,
        Self::MovedWhileExposed,
        Self::LeftEarly,
        Self::Hung,
        Self::Unexplained,
        Self::Differs,
        Self::Recording,
        Self::Protocol,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Lost => "frame kept, but not used later",
            Self::TakenAgain => "view exposed again though its frame was kept",
            Self::WrongFrame => "frame as data that is not the one rendered for its trigger",
            Self::MovedTwice => "motion started twice for one decision",
            Self::MovedWhileHeld => "motion started while the operator was told that the arm is held",
            Self::MovedWhileExposed => "frame as data during whose exposure the arm moved",
            Self::LeftEarly => "act that left before its record, or after the journal had failed",
            Self::Hung => "process that does not end within its bound",
            Self::Unexplained => "fault that nothing met explains",
            Self::Differs => "finished run whose results are not those of the unbroken run",
            Self::Recording => "recording that does not open, go on or replay bit by bit",
            Self::Protocol => "message that breaks a protocol",
        }
    }
}

/// Watches a run over all its processes.
#[derive(Debug, Default)]
pub(super) struct Judge {
    frames: FrameJudge,
    /// The attempts whose frames count as taken.
    kept: BTreeSet<(usize, u16)>,
    /// Frames that have come, as far as the recording knows.
    arrived: BTreeSet<(usize, u16)>,
    /// How often the controller has decided to move the arm.
    decision_count: usize,
    /// Moves that the robot has begun for each decision.
    begun: BTreeMap<usize, u32>,
    is_held: bool,
    /// Whether the arm moved during the exposure of a trigger.
    moved: BTreeMap<u64, bool>,
    pub(super) wrongs: Vec<(Bar, String)>,
}

impl Judge {
    pub(super) fn wrong(&mut self, bar: Bar, about: impl Into<String>) {
        self.wrongs.push((bar, about.into()));
    }

    pub(super) fn frames(&mut self) -> &mut FrameJudge {
        &mut self.frames
    }

    /// The simulator has taken an exposure.
    pub(super) fn handle_exposure(&mut self, trigger_id: u64, moved: bool) {
        self.moved.insert(trigger_id, moved);
    }

    /// Another process goes on, from what the recording has.
    pub(super) fn handle_rebuilt(&mut self, arrived: BTreeSet<(usize, u16)>) {
        self.is_held = false;
        self.arrived = arrived;
        for (view_index, attempt) in self.kept.difference(&self.arrived).copied().collect::<Vec<_>>() {
            self.wrong(
                Bar::Lost,
                format!("view {view_index} attempt {attempt} is not in the recording"),
            );
        }
    }

    /// Something leaves the controller. `disk` is that of its recording, where it is a model.
    pub(super) fn handle_output(&mut self, output: &Output, disk: Option<&Disk>, journal_failed: bool) {
        match output {
            Output::Robot(RobotOutput::Bytes { bytes, kind }) if kind.waits_for_journal() => {
                self.handle_act("robot", bytes, disk, journal_failed);
            }
            Output::Camera(CameraOutput::Bytes { bytes, act: true }) => {
                self.handle_act("camera", bytes, disk, journal_failed);
            }
            Output::Event(event) => self.handle_event(event),
            Output::Job { job, .. } => {
                if let Job::Prepare {
                    view_index, capture, ..
                } = &**job
                {
                    self.frames.handle_accepted(*view_index, capture);
                    let trigger_id = capture.trigger_id.0;
                    if self.moved.get(&trigger_id) != Some(&false) {
                        self.wrong(Bar::MovedWhileExposed, format!("trigger {trigger_id:#x}"));
                    }
                }
            }
            _ => (),
        }
    }

    /// The robot accepts a move of this decision, from this pose.
    pub(super) fn handle_accepted_move(&mut self, decision: usize, from: &Pose, datagram: &[u8]) {
        if is_at_target(from, datagram) {
            return;
        }
        let begun = self.begun.entry(decision).or_default();
        *begun += 1;
        if *begun > 1 {
            self.wrong(Bar::MovedTwice, format!("decision {decision}"));
        }
        if self.is_held {
            self.wrong(Bar::MovedWhileHeld, format!("decision {decision}"));
        }
    }

    /// The decision that a move belongs to that is sent now.
    pub(super) fn decision(&self) -> usize {
        self.decision_count
    }

    /// Another run of the same views, by its attempts, would give the same; `None` if a view has no frame.
    pub(super) fn attempts(controller: &Controller) -> Option<Vec<u16>> {
        let views = controller.views();
        let has_frames = views
            .iter()
            .all(|view| !matches!(view.outcome, ViewOutcome::Missing { .. }));
        has_frames.then(|| views.iter().map(|view| view.attempt).collect())
    }

    /// A process has seen its run to an end.
    pub(super) fn handle_end(&mut self, controller: &Controller) {
        for (view_index, attempt) in self.kept.clone() {
            let view = &controller.views()[view_index];
            if view.attempt < attempt || matches!(view.outcome, ViewOutcome::Missing { .. }) {
                let used = (view.attempt, &view.outcome);
                self.wrong(
                    Bar::Lost,
                    format!("view {view_index} attempt {attempt} was kept, now {used:?}"),
                );
            }
        }
    }

    pub(super) fn into_wrongs(mut self) -> Vec<(Bar, String)> {
        let frames = core::mem::take(&mut self.frames);
        let of_frames = [frames.wrong, frames.partial].concat();
        self.wrongs
            .extend(of_frames.into_iter().map(|about| (Bar::WrongFrame, about)));
        self.wrongs
    }

    fn handle_act(&mut self, device: &str, bytes: &[u8], disk: Option<&Disk>, journal_failed: bool) {
        if journal_failed {
            self.wrong(
                Bar::LeftEarly,
                format!("for the {device}, after the journal had failed"),
            );
        } else if disk.is_some_and(|disk| !disk.has_left(bytes)) {
            self.wrong(Bar::LeftEarly, format!("for the {device}, before its record"));
        }
    }

    fn handle_event(&mut self, event: &Event) {
        match *event {
            Event::MoveStarted { .. } => self.decision_count += 1,
            Event::FrameKept { view_index, attempt } if attempt < CHECK_ATTEMPT_FIRST => {
                self.kept.insert((view_index, attempt));
            }
            Event::Triggered { view_index, attempt }
                if attempt < CHECK_ATTEMPT_FIRST && self.kept.iter().any(|(kept, _)| *kept == view_index) =>
            {
                self.wrong(Bar::TakenAgain, format!("view {view_index} attempt {attempt}"));
            }
            Event::Held => self.is_held = true,
            Event::Resumed | Event::Restarted { .. } => self.is_held = false,
            _ => (),
        }
    }
}

/// Whether the datagram of a move sends the arm to where it stands.
fn is_at_target(from: &Pose, datagram: &[u8]) -> bool {
    let word = |index: usize| {
        let at = POSE_OFFSET + 4 * index;
        datagram
            .get(at..at + 4)
            .map_or(0, |bytes| i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    };
    let near = |have: i32, index: usize, within: i32| (have - word(index)).abs() <= within;
    (0..3).all(|axis| near(from.position_um[axis], axis, WITHIN_UM))
        && (0..3).all(|axis| near(from.turn_e4_deg[axis], 3 + axis, WITHIN_E4_DEG))
}

/// Whether a datagram orders a cartesian move.
pub(super) fn is_move(datagram: &[u8]) -> bool {
    datagram.get(24..26) == Some(&MOVE_CARTESIAN)
}

const MOVE_CARTESIAN: [u8; 2] = [0x8A, 0];
/// The header, and five words before the pose.
const POSE_OFFSET: usize = 32 + 20;
const WITHIN_UM: i32 = 10;
const WITHIN_E4_DEG: i32 = 10;
