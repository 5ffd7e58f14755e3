//! The arm: getting it ready, sending it to a pose, holding it, letting it go.
//!
//! A value on top of [`robot::Exchange`]. It decides what to ask after an unanswered act (status, then position) and
//! whether the act is to be said anew; it never repeats a motion blindly.

use crate::fault::{Fault, FaultCode};
use crate::robot::{
    Command, Datagram, Exchange, ExchangeSettings, Kind, Move, Path, Position, Reply, RobotEvent, Speed, Status,
    SystemInformation, WirePose,
};
use crate::stamp::{Stamp, earlier};
use nalgebra::Isometry3;
use std::collections::VecDeque;

/// Speeds, times and tolerances of the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmSettings {
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
    exchange: Exchange,
    state: State,
    timer: Option<Stamp>,
    heard: bool,
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
    Standing,
    Travelling(Travel),
    Settling,
    ReadingAlarm,
    Holding { confirmed: bool },
    Held,
    Parking,
    Over,
}

/// Things put right one after the other until the arm takes moves.
#[derive(Debug, Clone, Copy)]
struct Readying {
    since: Stamp,
    act_count: u32,
    /// Servo power has been asked for and may need time.
    servo_asked: bool,
}

#[derive(Debug)]
struct Travel {
    target: Isometry3<f64>,
    said: Move,
    accepted_at: Stamp,
    begun_at: Stamp,
    /// The controller has neither accepted nor refused the move for good.
    uncertain: bool,
    seen_running: bool,
    still_count: u32,
    attempt_count: u32,
}

impl Arm {
    /// An arm nobody has spoken to.
    pub fn new(settings: ArmSettings) -> Self {
        Self {
            exchange: Exchange::new(settings.exchange),
            settings,
            state: State::Apart,
            timer: None,
            heard: false,
            servo_is_ours: false,
            garbled_in_a_row: 0,
            last_pose: None,
            events: VecDeque::new(),
        }
    }

    /// Asks who is there; [`ArmEvent::Identity`] answers. Nothing is switched on.
    pub fn identify(&mut self, now: Stamp) {
        self.state = State::Identifying;
        self.exchange.say(now, Command::SystemInformation);
    }

    /// Releases a hold of ours, switches servo power on, and reports [`ArmEvent::Ready`].
    pub fn make_ready(&mut self, now: Stamp) {
        self.state = State::Readying(Readying {
            since: now,
            act_count: 0,
            servo_asked: false,
        });
        self.ask_status(now);
    }

    /// Starts a straight move to `base_from_tool` (mm). Only while the arm stands ready.
    pub fn move_to(&mut self, now: Stamp, base_from_tool: &Isometry3<f64>) {
        let from = self.last_pose.unwrap_or(*base_from_tool);
        let said = Move {
            base_from_tool: WirePose::from_isometry(base_from_tool),
            path: Path::Straight,
            speed: self.speed(&from, base_from_tool),
            tool: self.settings.tool,
        };
        self.state = State::Travelling(Travel {
            target: *base_from_tool,
            said,
            accepted_at: now,
            begun_at: now,
            uncertain: false,
            seen_running: false,
            still_count: 0,
            attempt_count: 1,
        });
        self.timer = None;
        self.exchange.say(now, Command::Move(said));
    }

    /// Stops the arm. Waits for nothing; [`ArmEvent::Held`] confirms.
    pub fn hold(&mut self, now: Stamp) {
        if matches!(
            self.state,
            State::Holding { .. } | State::Held | State::Parking | State::Over
        ) {
            return;
        }
        self.exchange.forget_open();
        self.timer = None;
        if self.heard {
            self.state = State::Holding { confirmed: false };
            self.exchange.say(now, Command::HoldOn);
        } else {
            // Nobody ever answered, so nothing was ever started.
            self.state = State::Held;
            self.events.push_back(ArmEvent::Held);
        }
    }

    /// Switches servo power off if it was switched on here; [`ArmEvent::Parked`] confirms.
    pub fn park(&mut self, now: Stamp) {
        self.exchange.forget_open();
        self.timer = None;
        if self.servo_is_ours {
            self.state = State::Parking;
            self.exchange.say(now, Command::ServoOff);
        } else {
            self.finish_parking();
        }
    }

    /// Whether a move would be taken now.
    pub fn is_standing(&self) -> bool {
        matches!(self.state, State::Standing)
    }

    /// A datagram has come.
    pub fn handle_datagram(&mut self, now: Stamp, bytes: &[u8]) {
        self.exchange.handle_datagram(now, bytes);
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
                _ => {}
            }
        }
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        earlier(self.exchange.wake_at(), self.timer)
    }

    /// The next datagram to send.
    #[must_use]
    pub fn poll_transmit(&mut self) -> Option<Datagram> {
        self.exchange.poll_transmit()
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
                    (self.heard, self.garbled_in_a_row) = (true, 0);
                    self.handle_reply(now, command, reply);
                }
                RobotEvent::Refused { command, refusal } => {
                    (self.heard, self.garbled_in_a_row) = (true, 0);
                    self.handle_refusal(now, command, refusal.added_status, refusal.words());
                }
                RobotEvent::Unanswered { command } | RobotEvent::Unsayable { command, .. } => {
                    self.handle_silence(now, command)
                }
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

    fn handle_reply(&mut self, now: Stamp, command: Command, reply: Reply) {
        match (command, reply) {
            (_, Reply::SystemInformation(system)) => {
                self.state = State::Apart;
                self.events.push_back(ArmEvent::Identity(system));
            }
            (_, Reply::Status(status)) => self.handle_status(now, status),
            (_, Reply::Position(position)) => self.handle_position(now, position),
            (_, Reply::Alarm(alarm)) => {
                let seen = match alarm {
                    Some(alarm) => format!("alarm {} {} (sub-code {})", alarm.code, alarm.name, alarm.data),
                    None => "the error bit is set, without an alarm".into(),
                };
                self.fault(FaultCode::RobotAlarm, seen);
            }
            (Command::Move(_), Reply::Done) => {
                if let State::Travelling(travel) = &mut self.state {
                    travel.accepted_at = now;
                    self.ask_status(now);
                }
            }
            (Command::HoldOn, Reply::Done) => {
                if let State::Holding { confirmed } = &mut self.state {
                    *confirmed = true;
                    self.ask_status(now);
                }
            }
            (Command::ServoOff, Reply::Done) => self.finish_parking(),
            (Command::ServoOn, Reply::Done) => {
                if let State::Readying(readying) = &mut self.state {
                    readying.servo_asked = true;
                }
                self.ask_status(now);
            }
            (Command::HoldOff, Reply::Done) => self.ask_status(now),
            // Asked for by nobody here.
            (_, Reply::Done | Reply::Pulses(_) | Reply::ExecutingJob(_) | Reply::Values(_) | Reply::Signals(_)) => {}
        }
    }

    fn handle_status(&mut self, now: Stamp, status: Status) {
        let travelling = matches!(self.state, State::Travelling(_));
        if (travelling || self.is_standing()) && !self.watch(now, status) {
            return;
        }
        match self.state {
            State::Readying(readying) => self.decide_readying(now, status, readying),
            State::Standing => self.timer = Some(now.plus_ms(IDLE_POLL_MS)),
            State::Travelling(_) => self.follow(now, status),
            State::Holding { confirmed: true } if status.running() => self.poll_later(now),
            State::Holding { confirmed: true } => {
                self.state = State::Held;
                self.events.push_back(ArmEvent::Held);
            }
            _ => {}
        }
    }

    /// One thing at a time is put right, then the status is read anew.
    fn decide_readying(&mut self, now: Stamp, status: Status, readying: Readying) {
        let late =
            now.ms_since(readying.since) >= self.settings.servo_timeout_ms || readying.act_count >= READYING_ACTS_MAX;
        let act = if status.alarm() || status.error() {
            return self.read_alarm(now);
        } else if !status.remote() {
            return self.fault(FaultCode::RobotNotRemote, "play mode with command remote is not set");
        } else if status.held_elsewhere() {
            // Only a person there can release it: hold here as well until then.
            return self.events.push_back(ArmEvent::HeldElsewhere);
        } else if status.held_by_command() {
            Some(Command::HoldOff)
        } else if status.running() {
            None
        } else if !status.servo_on() {
            Some(Command::ServoOn)
        } else {
            self.state = State::Locating;
            return self.exchange.say(now, Command::Position);
        };
        if late {
            let seen = match act {
                None => "the arm does not come to rest".to_owned(),
                Some(act) => format!("{} has no effect", act.name()),
            };
            return self.fault(FaultCode::RobotServo, seen);
        }
        match act {
            // A servo that is on its way needs time, not another switch-on.
            Some(Command::ServoOn) if readying.servo_asked => self.poll_later(now),
            Some(act) => {
                self.state = State::Readying(Readying {
                    act_count: readying.act_count + 1,
                    ..readying
                });
                // Ours from the asking on: the answer may get lost.
                self.servo_is_ours |= act == Command::ServoOn;
                self.exchange.say(now, act);
            }
            None => self.poll_later(now),
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

    fn follow(&mut self, now: Stamp, status: Status) {
        let State::Travelling(travel) = &mut self.state else {
            return;
        };
        if status.running() {
            travel.seen_running = true;
            travel.still_count = 0;
        } else {
            travel.still_count += 1;
        }
        if travel.still_count >= STILL_COUNT {
            return self.exchange.say(now, Command::Position);
        }
        if now.ms_since(travel.begun_at) >= self.settings.move_timeout_ms {
            let seen = format!("the move has not ended after {} ms", self.settings.move_timeout_ms);
            return self.fault(FaultCode::RobotLate, seen);
        }
        self.poll_later(now);
    }

    fn handle_position(&mut self, now: Stamp, position: Position) {
        let base_from_tool = position.base_from_tool.to_isometry();
        let settings = self.settings;
        match &mut self.state {
            State::Locating => {
                self.last_pose = Some(base_from_tool);
                self.state = State::Standing;
                self.timer = Some(now.plus_ms(IDLE_POLL_MS));
                self.events.push_back(ArmEvent::Ready);
            }
            State::Travelling(travel) => {
                let away_mm = (base_from_tool.translation.vector - travel.target.translation.vector).norm();
                let away_rad = base_from_tool.rotation.angle_to(&travel.target.rotation);
                // A position given for another tool says nothing about ours; it is normal before the first move.
                let right_tool = position.tool == i32::from(settings.tool);
                let near = away_mm <= settings.position_tolerance_mm && away_rad <= settings.rotation_tolerance_rad;
                self.last_pose = Some(base_from_tool);
                if right_tool && near {
                    self.state = State::Settling;
                    self.timer = Some(now.plus_ms(settings.settle_ms));
                } else if !travel.seen_running && now.ms_since(travel.accepted_at) < settings.start_grace_ms {
                    travel.still_count = 0;
                    self.poll_later(now);
                } else if travel.uncertain && travel.attempt_count < MOVE_ATTEMPTS_MAX {
                    // It stands, and not where the move would have taken it: the move was never begun. The pose is
                    // absolute, so saying it anew cannot take the arm anywhere else.
                    travel.attempt_count += 1;
                    travel.uncertain = false;
                    travel.still_count = 0;
                    travel.accepted_at = now;
                    let said = travel.said;
                    self.exchange.say(now, Command::Move(said));
                } else {
                    let seen = if right_tool {
                        let away_deg = away_rad.to_degrees();
                        format!("it stands {away_mm:.3} mm and {away_deg:.4}° from the target")
                    } else {
                        let (found, wanted) = (position.tool, settings.tool);
                        format!("the position is given for tool {found} instead of {wanted}")
                    };
                    self.fault(FaultCode::RobotElsewhere, seen);
                }
            }
            _ => {}
        }
    }

    fn handle_refusal(&mut self, now: Stamp, command: Command, added_status: u16, words: String) {
        match (command, &mut self.state) {
            (Command::HoldOn, _) => self.fault(FaultCode::RobotNotHeld, format!("hold refused: {words}")),
            (Command::ServoOff, _) => self.finish_parking(),
            (_, State::Held | State::Holding { .. } | State::Parking | State::Over) => {}
            (Command::Move(_), State::Travelling(travel)) if added_status == STILL_MOVING => {
                travel.uncertain = true;
                self.ask_status(now);
            }
            (Command::Move(_) | Command::ServoOn, _) if added_status == ALARM_PRESENT => self.read_alarm(now),
            (Command::ServoOn, _) => self.fault(FaultCode::RobotServo, words),
            (Command::Alarm(_), _) => self.fault(FaultCode::RobotAlarm, format!("the alarm cannot be read: {words}")),
            (command, _) => self.fault(FaultCode::RobotRefused, format!("{}: {words}", command.name())),
        }
    }

    fn handle_silence(&mut self, now: Stamp, command: Command) {
        match (command.kind(), command, &mut self.state) {
            (_, Command::HoldOn, _) => {
                let timeout_ms = self.settings.exchange.set_timeout_ms;
                let seen = format!("no confirmation within {timeout_ms} ms: press the emergency stop");
                self.fault(FaultCode::RobotNotHeld, seen);
            }
            (_, Command::ServoOff, _) => self.finish_parking(),
            (Kind::Act, Command::Move(_), State::Travelling(travel)) => {
                travel.uncertain = true;
                self.ask_status(now);
            }
            (Kind::Act, _, State::Readying(_)) => self.ask_status(now),
            (_, Command::Alarm(_), _) => self.fault(
                FaultCode::RobotAlarm,
                "an alarm is active; its number could not be read",
            ),
            (_, _, State::Held | State::Parking | State::Over) => {}
            (_, command, _) => {
                let attempts = self.settings.exchange.ask_attempts;
                self.fault(
                    FaultCode::RobotSilent,
                    format!("{}: no answer to {attempts} questions", command.name()),
                );
            }
        }
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

    /// Class VR when the turn takes longer than the way, else class V; at least one unit.
    fn speed(&self, from: &Isometry3<f64>, to: &Isometry3<f64>) -> Speed {
        let way_s = (to.translation.vector - from.translation.vector).norm() / self.settings.speed_mm_s;
        let turn_s = from.rotation.angle_to(&to.rotation) / self.settings.rotation_speed_rad_s;
        let tenths = |value: f64| (value * 10.0).round().max(1.0) as u32;
        if turn_s > way_s {
            Speed::Turn(tenths(self.settings.rotation_speed_rad_s.to_degrees()))
        } else {
            Speed::ToolPoint(tenths(self.settings.speed_mm_s))
        }
    }
}

const IDLE_POLL_MS: u64 = 500;
const STILL_COUNT: u32 = 2;
const GARBLED_MAX: u32 = 3;
const READYING_ACTS_MAX: u32 = 5;
const MOVE_ATTEMPTS_MAX: u32 = 3;
const STILL_MOVING: u16 = 0x2010;
const ALARM_PRESENT: u16 = 0x2060;
