//! The arm: getting it ready, sending it to a pose, holding it, letting it go.
//!
//! A value on top of [`robot::Exchange`](crate::robot::Exchange). It decides what to ask after an unanswered act (status,
//! then position) and whether the act is to be said anew; it never repeats a motion blindly. It moves the arm in one of two
//! ways: by moves of its own, or by numbered orders to a job on the controller (`docs/robot/README.md`).

mod job;
mod ready;
mod travel;

pub use job::JobSettings;

use crate::fault::{Fault, FaultCode};
use crate::robot::{
    Command, Exchange, ExchangeSettings, Kind, Refusal, Reply, RobotEvent, RobotOutput, Status, SystemInformation,
};
use crate::stamp::{Stamp, earlier};
use job::{Loading, Orders};
use nalgebra::Isometry3;
use ready::Readying;
use std::collections::VecDeque;
use travel::Travel;

/// Speeds, times and tolerances of the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmSettings {
    /// How the arm is moved.
    pub motion: Motion,
    /// Tool number, 0 to 63.
    pub tool: u8,
    /// Speed of the tool point, mm/s.
    pub speed_mm_s: f64,
    /// Speed of turns, rad/s.
    pub rotation_speed_rad_s: f64,
    /// Between two status questions while the arm moves, ms.
    pub poll_interval_ms: u64,
    /// How long after acceptance a move may take to show as running, ms.
    pub start_grace_ms: u64,
    /// The longest move, ms.
    pub move_timeout_ms: u64,
    /// Rest between standing still and arrival, ms.
    pub settle_ms: u64,
    /// How long servo power may take to come on, ms.
    pub servo_timeout_ms: u64,
    /// How far from the commanded position counts as there, mm.
    pub position_tolerance_mm: f64,
    /// How far from the commanded orientation counts as there, rad.
    pub rotation_tolerance_rad: f64,
    /// The conversation's own times.
    pub exchange: ExchangeSettings,
}

/// How the arm is moved.
#[derive(Debug, Clone, PartialEq)]
pub enum Motion {
    /// By moves that are sent one by one.
    Direct,
    /// By orders to a job on the controller.
    Job(JobSettings),
}

/// What the arm reports to the session.
#[derive(Debug, Clone, PartialEq)]
pub enum ArmEvent {
    /// Who answered, once, before anything is switched on.
    Identity(SystemInformation),
    /// Ready for moves.
    Ready,
    /// Standing at the commanded pose.
    Arrived {
        /// Where the controller says it stands.
        base_from_tool: Isometry3<f64>,
    },
    /// Somebody at the robot has put it on hold.
    HeldElsewhere,
    /// Our hold is confirmed and the arm stands.
    Held,
    /// Servo power is off again, or was never ours.
    Parked,
    /// The run cannot go on.
    Fault(Fault),
    /// A datagram was dropped.
    Dropped(String),
}

/// The arm.
#[derive(Debug)]
pub struct Arm {
    settings: ArmSettings,
    targets: Vec<Isometry3<f64>>,
    exchange: Exchange,
    /// The orders to the scan job, when it moves the arm.
    orders: Option<Orders>,
    state: State,
    timer: Option<Stamp>,
    heard: bool,
    /// Why the connection ended last, until something is heard again.
    lost: Option<String>,
    servo_is_ours: bool,
    garbled_in_a_row: u32,
    last_pose: Option<Isometry3<f64>>,
    events: VecDeque<ArmEvent>,
}

#[derive(Debug)]
enum State {
    Apart,
    Identifying,
    Readying(Readying),
    Locating,
    Loading(Loading),
    Standing,
    Travelling(Travel),
    Settling,
    ReadingAlarm,
    Holding {
        confirmed: bool,
    },
    /// Stands on our hold; the scan job is put back to its first line.
    Rewinding,
    Held,
    /// The scan job is told to end, before servo power goes.
    EndingJob,
    Parking,
    Over,
}

impl Arm {
    /// An arm nobody has spoken to, and the poses (`base_from_tool`, mm) that it may be sent to.
    pub fn new(settings: ArmSettings, targets: Vec<Isometry3<f64>>) -> Self {
        let orders = match &settings.motion {
            Motion::Direct => None,
            Motion::Job(job) => Some(Orders::new(job.clone())),
        };
        Self {
            exchange: Exchange::new(settings.exchange),
            settings,
            targets,
            orders,
            state: State::Apart,
            timer: None,
            heard: false,
            lost: None,
            servo_is_ours: false,
            garbled_in_a_row: 0,
            last_pose: None,
            events: VecDeque::new(),
        }
    }

    /// Another process speaks with the arm from here on. It knows nothing of where the arm stands; servo power that was switched
    /// on for the run is still the run's to switch off.
    pub fn restart(&mut self) {
        let targets = std::mem::take(&mut self.targets);
        *self = Self {
            servo_is_ours: self.servo_is_ours,
            heard: self.heard,
            ..Self::new(self.settings.clone(), targets)
        };
    }

    /// Asks who is there; [`ArmEvent::Identity`] answers. Nothing is switched on.
    pub fn identify(&mut self, now: Stamp) {
        self.state = State::Identifying;
        self.exchange.say(now, Command::SystemInformation);
    }

    /// Releases a hold of ours, switches servo power on, and reports [`ArmEvent::Ready`].
    pub fn make_ready(&mut self, now: Stamp) {
        self.state = State::Readying(Readying::begun(now));
        self.ask_status(now);
    }

    /// Stops the arm. Waits for nothing; [`ArmEvent::Held`] confirms.
    pub fn hold(&mut self, now: Stamp) {
        if matches!(
            self.state,
            State::Holding { .. } | State::Rewinding | State::Held | State::EndingJob | State::Parking | State::Over
        ) {
            return;
        }
        self.exchange.forget_open(now);
        self.timer = None;
        if self.heard {
            self.state = State::Holding { confirmed: false };
            self.exchange.say(now, Command::HoldOn);
        } else {
            // Nobody ever answered, so nothing was ever started.
            self.be_held();
        }
    }

    /// Ends the scan job and switches servo power off if either was begun here; [`ArmEvent::Parked`] confirms.
    pub fn park(&mut self, now: Stamp) {
        self.exchange.forget_open(now);
        self.timer = None;
        if let Some(end_of_job) = self.orders.as_ref().and_then(Orders::end_of_job) {
            self.state = State::EndingJob;
            self.exchange.say(now, end_of_job);
        } else {
            self.switch_servo_off(now);
        }
    }

    /// Whether a move would be taken now.
    pub fn is_standing(&self) -> bool {
        matches!(self.state, State::Standing)
    }

    /// Bytes have come.
    pub fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        self.exchange.handle_bytes(now, bytes);
        self.handle_exchange_events(now);
    }

    /// Bytes of an act were not sent and never will be.
    pub fn handle_withheld(&mut self, now: Stamp) {
        self.exchange.handle_withheld(now);
        self.handle_exchange_events(now);
    }

    /// The connection stands.
    pub fn handle_connected(&mut self, now: Stamp) {
        self.exchange.handle_connected(now);
        self.handle_exchange_events(now);
    }

    /// The connection did not come about or has ended.
    pub fn handle_closed(&mut self, now: Stamp, reason: &str) {
        self.exchange.handle_closed(now, reason);
        self.handle_exchange_events(now);
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        self.exchange.handle_wake(now);
        self.handle_exchange_events(now);
        if self.timer.take_if(|due| *due <= now).is_some() {
            match &self.state {
                State::Settling => {
                    self.state = State::Standing;
                    self.timer = Some(now.plus_ms(IDLE_POLL_MS));
                    let base_from_tool = self.last_pose.expect("a pose was read before settling");
                    self.events.push_back(ArmEvent::Arrived { base_from_tool });
                }
                State::Readying(_) | State::Standing | State::Travelling(_) | State::Holding { .. } => {
                    self.ask_status(now);
                }
                State::Loading(_) => self.look_whether_the_job_waits(now),
                _ => {}
            }
        }
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        earlier(self.exchange.wake_at(), self.timer)
    }

    /// The next thing to do with the wire.
    #[must_use]
    pub fn poll_output(&mut self) -> Option<RobotOutput> {
        self.exchange.poll_output()
    }

    /// The next event.
    #[must_use]
    pub fn poll_event(&mut self) -> Option<ArmEvent> {
        self.events.pop_front()
    }

    fn handle_exchange_events(&mut self, now: Stamp) {
        while let Some(event) = self.exchange.poll_event() {
            match event {
                RobotEvent::Answered { command, reply } => {
                    (self.heard, self.garbled_in_a_row, self.lost) = (true, 0, None);
                    self.handle_reply(now, &command, reply);
                }
                RobotEvent::Refused { command, refusal } => {
                    (self.heard, self.garbled_in_a_row) = (true, 0);
                    self.handle_refusal(now, &command, refusal);
                }
                RobotEvent::Unsayable { command, reason } => self.handle_unsayable(now, &command, &reason),
                RobotEvent::Lost { reason } => {
                    self.events
                        .push_back(ArmEvent::Dropped(format!("connection lost: {reason}")));
                    self.lost = Some(reason);
                }
                RobotEvent::Unanswered { command } => self.handle_silence(now, &command),
                RobotEvent::Dropped { reason, malformed } => {
                    self.garbled_in_a_row = if malformed { self.garbled_in_a_row + 1 } else { 0 };
                    self.events.push_back(ArmEvent::Dropped(reason.clone()));
                    if self.garbled_in_a_row == GARBLED_MAX {
                        self.fault(FaultCode::RobotGarbled, reason);
                    }
                }
            }
        }
    }

    fn handle_reply(&mut self, now: Stamp, command: &Command, reply: Reply) {
        match (command, reply) {
            (_, Reply::SystemInformation(system)) => {
                self.state = State::Apart;
                self.events.push_back(ArmEvent::Identity(system));
            }
            (_, Reply::Status(status)) => self.handle_status(now, status),
            (_, Reply::Position(position)) => self.handle_position(now, &position),
            (_, Reply::Alarm(alarm)) => {
                let seen = match alarm {
                    Some(alarm) => format!("alarm {} {} (sub-code {})", alarm.code, alarm.name, alarm.data),
                    None => "the error bit is set, without an alarm".into(),
                };
                self.fault(FaultCode::RobotAlarm, seen);
            }
            (_, Reply::Values(values)) => self.handle_values(now, &values),
            (_, Reply::ExecutingJob(job)) => self.handle_executing_job(now, &job),
            (_, Reply::Done) => self.handle_done(now, command),
            // Asked for by nobody here.
            (_, Reply::Pulses(_) | Reply::Signals(_) | Reply::JobNames(_)) => {}
        }
    }

    fn handle_done(&mut self, now: Stamp, command: &Command) {
        match (command, &mut self.state) {
            (Command::Move(_) | Command::Order { .. }, State::Travelling(travel)) => {
                travel.accepted_at = now;
                self.ask_status(now);
            }
            // A beat: the next look at the job follows.
            (Command::Write { .. }, State::Travelling(_)) => self.poll_later(now),
            (_, State::Loading(_)) => self.load_on(now),
            (Command::HoldOn, State::Holding { confirmed }) => {
                *confirmed = true;
                self.ask_status(now);
            }
            (Command::ServoOff, _) => self.finish_parking(),
            (Command::ServoOn, State::Readying(readying)) => {
                readying.servo_asked = true;
                self.ask_status(now);
            }
            (Command::HoldOff, State::Readying(_)) => self.ask_status(now),
            (Command::Write { .. }, State::Readying(_)) => self.poll_later(now),
            (Command::Write { .. }, State::EndingJob) => self.switch_servo_off(now),
            (_, State::Rewinding) => self.be_held(),
            _ => {}
        }
    }

    fn handle_status(&mut self, now: Stamp, status: Status) {
        let travelling = matches!(self.state, State::Travelling(_));
        if (travelling || self.is_standing()) && !self.watch(now, status) {
            return;
        }
        match self.state {
            State::Readying(readying) => self.decide_readying(now, status, readying),
            State::Loading(_) => self.handle_status_of_job(now, status),
            State::Standing => self.stand(now, status),
            State::Travelling(_) => self.follow(now, status),
            State::Holding { confirmed: true } if status.running() => self.poll_later(now),
            State::Holding { confirmed: true } => self.rewind(now),
            _ => {}
        }
    }

    /// Nothing is on its way: the state is looked at now and then, and the scan job hears that somebody is here.
    fn stand(&mut self, now: Stamp, status: Status) {
        self.timer = Some(now.plus_ms(IDLE_POLL_MS));
        if let Some(orders) = &mut self.orders {
            if status.running() {
                let beat = orders.beat();
                self.exchange.say(now, beat);
            } else {
                self.fault(FaultCode::RobotJob, "the scan job has stopped by itself");
            }
        }
    }

    /// Whether all is well; otherwise it has been reported.
    fn watch(&mut self, now: Stamp, status: Status) -> bool {
        if status.alarm() || status.error() {
            self.read_alarm(now);
        } else if !status.remote() {
            self.fault(
                FaultCode::RobotNotRemote,
                "play mode or command remote went off during the run",
            );
        } else if status.held_elsewhere() || status.held_by_command() {
            self.events.push_back(ArmEvent::HeldElsewhere);
        } else if !status.servo_on() {
            self.fault(FaultCode::RobotServo, "servo power went off during the run");
        } else {
            return true;
        }
        false
    }

    fn handle_refusal(&mut self, now: Stamp, command: &Command, refusal: Refusal) {
        let words = refusal.words();
        match (command, &mut self.state) {
            (Command::HoldOn, _) => self.fault(FaultCode::RobotNotHeld, format!("hold refused: {words}")),
            (Command::ServoOff, _) => self.finish_parking(),
            (_, State::EndingJob) => self.switch_servo_off(now),
            (_, State::Rewinding) => self.be_held(),
            (_, State::Held | State::Holding { .. } | State::Parking | State::Over) => {}
            (Command::Move(_), State::Travelling(travel)) if refusal.added_status == STILL_MOVING => {
                travel.uncertain = true;
                self.ask_status(now);
            }
            // The start came twice, or nothing stands still yet; the next look finds out.
            (Command::StartJob, State::Loading(_)) if refusal.added_status == STILL_MOVING => self.load_on(now),
            (Command::Alarm(_), _) => self.fault(FaultCode::RobotAlarm, format!("the alarm cannot be read: {words}")),
            (_, _) if refusal.added_status == ALARM_PRESENT => self.read_alarm(now),
            (_, _) if HELD_BY_SOMEBODY.contains(&refusal.added_status) => {
                self.events.push_back(ArmEvent::HeldElsewhere);
            }
            (_, _) if refusal.added_status == NOT_REMOTE => self.fault(FaultCode::RobotNotRemote, words),
            (Command::ServoOn, _) => self.fault(FaultCode::RobotServo, words),
            (_, _) if refusal.added_status == SERVO_IS_OFF => self.fault(FaultCode::RobotServo, words),
            (Command::SelectJob { job, .. }, _) if refusal.added_status == NO_SUCH_JOB => {
                let seen = format!("the scan job {job} is not on the controller: put it there (docs/robot)");
                self.fault(FaultCode::RobotJob, seen);
            }
            (command, _) => self.fault(FaultCode::RobotRefused, format!("{}: {words}", command.name())),
        }
    }

    fn handle_unsayable(&mut self, now: Stamp, command: &Command, reason: &str) {
        let code = match (command, &self.state, &self.lost) {
            // Letting go ends without a word where there is no wire.
            (Command::ServoOff, _, _) | (_, State::EndingJob, _) => return self.handle_silence(now, command),
            (Command::HoldOn, _, _) => FaultCode::RobotNotHeld,
            (_, _, Some(_)) => FaultCode::RobotUnreachable,
            (_, _, None) => FaultCode::RobotRefused,
        };
        self.fault(code, format!("{}: {reason}", command.name()));
    }

    fn handle_silence(&mut self, now: Stamp, command: &Command) {
        match (command.kind(), command, &mut self.state) {
            (_, Command::HoldOn, _) => {
                let timeout_ms = self.settings.exchange.set_timeout_ms;
                let seen = format!("no confirmation within {timeout_ms} ms: press the emergency stop");
                self.fault(FaultCode::RobotNotHeld, seen);
            }
            (_, Command::ServoOff, _) => self.finish_parking(),
            (_, _, State::EndingJob) => self.switch_servo_off(now),
            (_, _, State::Rewinding) => self.be_held(),
            (Kind::Act, Command::Move(_), State::Travelling(travel)) => {
                travel.uncertain = true;
                self.ask_status(now);
            }
            (Kind::Act, _, State::Readying(readying)) => {
                readying.is_unanswered = true;
                self.ask_status(now);
            }
            // The step after an act of loading finds out what came of it.
            (Kind::Act, _, State::Loading(_)) => self.load_on(now),
            (_, Command::Alarm(_), _) => self.fault(
                FaultCode::RobotAlarm,
                "an alarm is active; its number could not be read",
            ),
            (_, _, State::Held | State::Parking | State::Over) => {}
            (_, _, _) if self.lost.is_some() => {
                let seen = self.lost.take().unwrap_or_default();
                self.fault(FaultCode::RobotUnreachable, seen);
            }
            (_, command, _) => {
                let attempts = self.settings.exchange.ask_attempts;
                self.fault(
                    FaultCode::RobotSilent,
                    format!("{}: no answer to {attempts} questions", command.name()),
                );
            }
        }
    }

    /// The arm stands on our hold. A start that comes late must not go on with an interrupted move of the scan job, so
    /// the job is put back before anybody relies on the hold. If that fails the hold stands all the same.
    fn rewind(&mut self, now: Stamp) {
        match self.orders.as_ref().and_then(Orders::rewinding) {
            Some(rewinding) => {
                self.state = State::Rewinding;
                self.exchange.say(now, rewinding);
            }
            None => self.be_held(),
        }
    }

    fn be_held(&mut self) {
        self.state = State::Held;
        self.events.push_back(ArmEvent::Held);
    }

    fn read_alarm(&mut self, now: Stamp) {
        self.state = State::ReadingAlarm;
        self.timer = None;
        self.exchange.say(now, Command::Alarm(0));
    }

    fn ask_status(&mut self, now: Stamp) {
        self.timer = None;
        self.exchange.say(now, Command::Status);
    }

    fn poll_later(&mut self, now: Stamp) {
        self.timer = Some(now.plus_ms(self.settings.poll_interval_ms));
    }

    fn switch_servo_off(&mut self, now: Stamp) {
        if self.servo_is_ours {
            self.state = State::Parking;
            self.exchange.say(now, Command::ServoOff);
        } else {
            self.finish_parking();
        }
    }

    fn finish_parking(&mut self) {
        if !matches!(self.state, State::Over) {
            self.state = State::Over;
            self.events.push_back(ArmEvent::Parked);
        }
    }

    fn fault(&mut self, code: FaultCode, seen: impl Into<String>) {
        if code == FaultCode::RobotNotHeld {
            self.state = State::Held;
        }
        self.events.push_back(ArmEvent::Fault(Fault::new(code, seen)));
    }
}

const IDLE_POLL_MS: u64 = 500;
const GARBLED_MAX: u32 = 3;
const STILL_MOVING: u16 = 0x2010;
const ALARM_PRESENT: u16 = 0x2060;
const SERVO_IS_OFF: u16 = 0x2070;
const NOT_REMOTE: u16 = 0x2100;
const NO_SUCH_JOB: u16 = 0x4040;
/// Hold by pendant, panel or an external signal.
const HELD_BY_SOMEBODY: [u16; 3] = [0x2020, 0x2030, 0x2040];
