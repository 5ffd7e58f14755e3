//! Acquisition: the arm steps through the planned poses, the camera takes a frame at each.
//!
//! What each state accepts, sends and ends with stands in `docs/run.md`.

mod arm;
mod camera_events;
mod commands;
mod devices;
mod frames;
mod identity;
mod restart;
mod retakes;
mod state;
mod warmth;
mod way;

pub use arm::{Arm, ArmEvent, ArmSettings, JobSettings, Motion};
pub use devices::{camera_settings, camera_times, exchange_settings};
pub use state::{Command, State};

use crate::camera::{self, CameraOutput, Capture, TriggerId};
use crate::event::{Ending, Event, HoldBy};
use crate::fault::{Fault, FaultCode};
use crate::plan::PlannedView;
use crate::robot::RobotOutput;
use crate::seed::Seed;
use crate::settings::{Recipe, Retakes, Station, Target as StationTarget};
use crate::stamp::{Stamp, earlier};
use commands::HoldAfter;
use devices::arm_settings;
use nalgebra::Isometry3;
use restart::Check;
use std::collections::VecDeque;
use std::sync::Arc;
use warmth::Warmth;
use way::Way;

/// A frame with the pose at which it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Captured {
    /// Which view.
    pub view_index: usize,
    /// Which attempt at it.
    pub attempt: u16,
    /// Where the controller said the arm stood, mm.
    pub base_from_tool: Isometry3<f64>,
    /// The frame.
    pub capture: Arc<Capture>,
}

/// What the session hands up.
#[derive(Debug, Clone, PartialEq)]
pub enum SessionEvent {
    /// For the journal and the console.
    Event(Event),
    /// For the reconstruction.
    Captured(Captured),
    /// A second look at a view after a restart: has the blade moved?
    Check(Captured),
    /// An attempt at a view that gave nothing usable; the view is taken again.
    Failed {
        /// Which view.
        view_index: usize,
        /// Which attempt at it.
        attempt: u16,
        /// Why.
        reason: String,
    },
    /// A planned view that will not come.
    Missing {
        /// Which view.
        view_index: usize,
        /// Why.
        reason: String,
    },
}

/// The acquisition of one run.
#[derive(Debug)]
pub struct Session {
    arm: Arm,
    camera: camera::Exchange,
    /// The camera's settings for each view, as its next attempt wants them.
    view_settings: Vec<camera::CameraSettings>,
    /// The exposures that recipes and this camera allow, µs.
    exposure_range_us: [u32; 2],
    way: Way,
    warmth: Warmth,
    wanted: Wanted,
    stage: Stage,
    robot_known: bool,
    camera_known: bool,
    targets: VecDeque<Target>,
    /// Exposed, but its frame is not here yet.
    awaited: Option<Standing>,
    /// Exposed, but the end of the run came before its frame.
    cut_off: Option<Target>,
    /// Exposed for a process before this one, and its frame not here yet.
    recalled: Option<Target>,
    check: Check,
    restart_count: u16,
    hold: Hold,
    /// A hold that is to come after a view.
    hold_after: Option<HoldAfter>,
    ending: Option<Ending>,
    arm_done: bool,
    camera_done: bool,
    parking: bool,
    failures_in_a_row: u32,
    /// Acquisitions that the camera did not carry through, one after the other.
    camera_failures_in_a_row: u32,
    events: VecDeque<SessionEvent>,
}

/// What recipe and station ask of the devices.
#[derive(Debug)]
struct Wanted {
    simulated: bool,
    optics: &'static str,
    stand_off_mm: f64,
    points_min: u32,
    retakes: Retakes,
}

/// A view to be taken, and which attempt at it that is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Target {
    /// Which view.
    pub view_index: usize,
    /// Which attempt, from 0.
    pub attempt: u16,
}

#[derive(Debug, Clone, Copy)]
struct Standing {
    target: Target,
    base_from_tool: Isometry3<f64>,
}

#[derive(Debug, Clone, Copy)]
enum Stage {
    Opening,
    ToTarget,
    Moving(Target),
    AtTarget(Standing),
    Exposing(Standing),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Hold {
    No,
    Asked,
    Held,
    Resuming,
}

impl Session {
    /// The acquisition of `plan`, not begun.
    pub fn new(recipe: &Recipe, station: &Station, plan: &[PlannedView], run_id: u64, seed: Seed) -> Self {
        let taken = plan.iter().filter(|view| !view.skipped);
        let targets = taken
            .map(|view| Target {
                view_index: view.index,
                attempt: 0,
            })
            .collect();
        let view_settings: Vec<_> = (0..plan.len()).map(|view| camera_settings(recipe, view)).collect();
        Self {
            arm: Arm::new(
                arm_settings(station),
                plan.iter().map(|view| view.base_from_tool).collect(),
            ),
            camera: camera::Exchange::new(camera_times(station), run_id, seed, view_settings.clone()),
            view_settings,
            exposure_range_us: [EXPOSURE_MIN_US, EXPOSURE_MAX_US],
            way: Way::new(plan, station.robot.step_angle_max_rad),
            warmth: Warmth::new(recipe.camera.warm_up),
            wanted: Wanted {
                simulated: !matches!(station.target, StationTarget::Cell { .. }),
                optics: recipe.camera.optics.name(),
                stand_off_mm: recipe.camera_from_fixture.translation.z,
                points_min: recipe.camera.points_min,
                retakes: recipe.retakes.clone(),
            },
            stage: Stage::Opening,
            robot_known: false,
            camera_known: false,
            targets,
            awaited: None,
            cut_off: None,
            recalled: None,
            check: Check::No,
            restart_count: 0,
            hold: Hold::No,
            hold_after: None,
            ending: None,
            arm_done: false,
            camera_done: false,
            parking: false,
            failures_in_a_row: 0,
            camera_failures_in_a_row: 0,
            events: VecDeque::new(),
        }
    }

    /// Opens both conversations. Nothing is switched on before both devices have said who they are.
    pub fn begin(&mut self, now: Stamp) {
        self.arm.identify(now);
        self.camera.open(now);
    }

    /// Ends the run with a fault.
    pub fn fault(&mut self, now: Stamp, fault: Fault) {
        self.emit(Event::Faulted { fault: fault.clone() });
        self.end(now, Ending::Faulted { fault });
    }

    /// Takes views again, after all that are still to be taken.
    pub fn take_again(&mut self, targets: impl IntoIterator<Item = Target>) {
        self.targets.extend(targets);
    }

    /// Ends the run because all is done.
    pub fn finish(&mut self, now: Stamp) {
        self.end(now, Ending::Finished);
    }

    /// Whether every planned view has been taken or given up.
    pub fn is_acquired(&self) -> bool {
        self.targets.is_empty() && self.awaited.is_none() && self.check == Check::No
    }

    /// The views that are still to be taken, or whose frames are still to come.
    pub fn left(&self) -> Vec<usize> {
        let awaited = self.awaited.map(|standing| standing.target).or(self.cut_off);
        let all = awaited.iter().chain(&self.targets);
        all.filter(|target| !target.is_check())
            .map(|target| target.view_index)
            .collect()
    }

    /// How the run ends, once that is decided.
    pub fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    /// Whether both devices have been let go.
    pub fn is_over(&self) -> bool {
        self.ending.is_some() && self.arm_done && self.camera_done
    }

    /// Bytes have come from the robot: a datagram, or a piece of a stream.
    pub fn handle_robot_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        self.arm.handle_bytes(now, bytes);
        self.handle_events(now);
    }

    /// What was to move the robot was not sent and never will be.
    pub fn handle_robot_withheld(&mut self, now: Stamp) {
        self.arm.handle_withheld(now);
        self.handle_events(now);
    }

    /// The robot's connection stands.
    pub fn handle_robot_connected(&mut self, now: Stamp) {
        self.arm.handle_connected(now);
        self.handle_events(now);
    }

    /// The robot's connection did not come about or has ended.
    pub fn handle_robot_closed(&mut self, now: Stamp, reason: &str) {
        self.arm.handle_closed(now, reason);
        self.handle_events(now);
    }

    /// The network says that nothing listens at the robot's address.
    pub fn handle_robot_unreachable(&mut self, now: Stamp, reason: &str) {
        if self.ending.is_none() {
            self.fault(now, Fault::new(FaultCode::RobotUnreachable, reason));
        }
        self.handle_events(now);
    }

    /// The camera's connection stands.
    pub fn handle_camera_connected(&mut self, now: Stamp) {
        self.camera.handle_connected(now);
        self.handle_events(now);
    }

    /// Bytes have come from the camera.
    pub fn handle_camera_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        self.camera.handle_bytes(now, bytes);
        self.handle_events(now);
    }

    /// The camera's connection did not come about or has ended.
    pub fn handle_camera_closed(&mut self, now: Stamp, reason: &str) {
        self.camera.handle_closed(now, reason);
        self.handle_events(now);
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        self.arm.handle_wake(now);
        self.camera.handle_wake(now);
        self.watch_warmth(now);
        self.handle_events(now);
    }

    /// Does what can be done now. `backlog_count` views are waiting to be registered.
    pub fn advance(&mut self, now: Stamp, backlog_count: usize) {
        if self.ending.is_none() && self.hold == Hold::No {
            self.hold_if_due(now);
        }
        if self.ending.is_some() || self.hold != Hold::No || self.check == Check::Judging {
            return;
        }
        if let Some(target) = self.targets.front() {
            // Set while the arm is on its way; the camera does it as soon as it has no frame to send any more.
            self.camera.want(now, self.view_settings[target.view_index]);
        }
        match self.stage {
            Stage::Opening | Stage::Moving(_) | Stage::Exposing(_) => {}
            Stage::ToTarget => {
                if let Some(&target) = self.targets.front()
                    && self.arm.is_standing()
                    && backlog_count < BACKLOG_MAX
                    && self.may_go_on()
                {
                    self.stage = Stage::Moving(target);
                    self.arm.move_to(now, self.way.leave_for(target.view_index));
                    self.emit(Event::MoveStarted {
                        view_index: target.view_index,
                        attempt: target.attempt,
                    });
                }
            }
            Stage::AtTarget(standing) => {
                if self.targets.front() != Some(&standing.target) {
                    // The frame before this one failed and is taken again first.
                    self.stage = Stage::ToTarget;
                    return self.advance(now, backlog_count);
                }
                if self.awaited.is_none() && self.camera.is_armed() && self.warmth.is_enough() {
                    let Target { view_index, attempt } = standing.target;
                    self.stage = Stage::Exposing(standing);
                    self.camera.trigger(now, TriggerId::new(view_index as u32, attempt));
                    self.emit(Event::Triggered { view_index, attempt });
                }
            }
        }
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        let camera = earlier(self.camera.wake_at(), self.warmth.wake_at());
        earlier(self.arm.wake_at(), camera)
    }

    /// The next thing to do for the robot.
    #[must_use]
    pub fn poll_robot(&mut self) -> Option<RobotOutput> {
        self.arm.poll_output()
    }

    /// The next thing to do for the camera.
    #[must_use]
    pub fn poll_camera(&mut self) -> Option<CameraOutput> {
        self.camera.poll_output()
    }

    /// The next event.
    #[must_use]
    pub fn poll_event(&mut self) -> Option<SessionEvent> {
        self.events.pop_front()
    }

    fn handle_events(&mut self, now: Stamp) {
        loop {
            if let Some(event) = self.arm.poll_event() {
                self.handle_arm_event(now, event);
            } else if let Some(event) = self.camera.poll_event() {
                self.handle_camera_event(now, event);
            } else {
                return;
            }
        }
    }

    fn handle_arm_event(&mut self, now: Stamp, event: ArmEvent) {
        match event {
            ArmEvent::Identity(system) => self.handle_identity(now, &system),
            ArmEvent::Ready => {
                if self.hold == Hold::Resuming {
                    self.hold = Hold::No;
                    // Somebody may have moved the arm by hand meanwhile.
                    self.interrupt();
                    self.emit(Event::Resumed);
                } else {
                    self.emit(Event::RobotReady);
                }
                if matches!(self.stage, Stage::Opening) {
                    self.stage = Stage::ToTarget;
                }
            }
            ArmEvent::Arrived { base_from_tool } => {
                if let Stage::Moving(target) = self.stage {
                    if self.way.arrive() != Some(target.view_index) {
                        return self.arm.move_to(now, self.way.leave_for(target.view_index));
                    }
                    self.stage = Stage::AtTarget(Standing { target, base_from_tool });
                    self.emit(Event::Arrived {
                        view_index: target.view_index,
                        attempt: target.attempt,
                    });
                }
            }
            ArmEvent::HeldElsewhere => self.hold(now, HoldBy::Robot),
            ArmEvent::Held if self.ending.is_some() => self.park(now),
            ArmEvent::Held => {
                self.hold = Hold::Held;
                self.emit(Event::Held);
            }
            ArmEvent::Parked => self.arm_done = true,
            ArmEvent::Fault(fault) => {
                // While the arm is being held or let go, no confirmation will come any more that could end the run.
                let letting_go = self.ending.is_some() || self.hold == Hold::Asked;
                self.fault(now, fault);
                if letting_go {
                    self.park(now);
                }
            }
            ArmEvent::Dropped(reason) => self.emit(Event::DatagramDropped { reason }),
        }
    }

    /// Lets both devices go. The first ending counts, but no fault is lost in a run that had only to be wound up.
    fn end(&mut self, now: Stamp, ending: Ending) {
        match (&self.ending, &ending) {
            (None, _) => {}
            (Some(Ending::Finished), Ending::Faulted { .. }) => {
                self.ending = Some(ending);
                return;
            }
            (Some(_), _) => return,
        }
        let finished = ending == Ending::Finished;
        self.ending = Some(ending);
        self.hold_after = None;
        self.give_up_exposed();
        self.camera.leave(now);
        self.camera_done = self.camera_done || self.camera.is_over();
        if finished || self.hold == Hold::Held {
            self.park(now);
        } else if self.hold != Hold::Asked {
            self.emit(Event::HoldAsked { by: HoldBy::Ending });
            self.arm.hold(now);
        }
    }

    fn park(&mut self, now: Stamp) {
        if !self.parking {
            self.parking = true;
            self.arm.park(now);
        }
    }

    /// Forgets a move or an arrival: after the hold the arm is sent anew.
    fn interrupt(&mut self) {
        if let Stage::Moving(_) | Stage::AtTarget(_) = self.stage {
            self.stage = Stage::ToTarget;
        }
    }

    fn emit(&mut self, event: Event) {
        self.events.push_back(SessionEvent::Event(event));
    }

    fn note(&mut self, text: impl Into<String>) {
        self.emit(Event::Noted { text: text.into() });
    }
}

/// Captured but unregistered views that stop the robot from going on: memory stays bounded.
const BACKLOG_MAX: usize = 4;
/// The exposures that recipes allow.
const EXPOSURE_MIN_US: u32 = 10;
const EXPOSURE_MAX_US: u32 = 50_000;
/// Views without a frame, or failed acquisitions of the camera, one after the other, that end the run.
const FAILURES_MAX: u32 = 3;
