//! The DX200 as a value: datagrams and time go in, datagrams come out.

use core::net::SocketAddr;
use std::collections::VecDeque;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::checks::refuse_first;
use crate::fault::Fault;
use crate::robot::hses::{self, Refusal, Request};
use crate::robot::motion::Motion;
use crate::robot::order::{
    ALARM_PRESENT, HELD_BY_COMMAND, HELD_BY_PENDANT, INSTANCE_ALARM_RESET, INSTANCE_HOLD, INSTANCE_PULSES, MOVING,
    MoveOrder, NOT_REMOTE, SERVO_OFF, SERVO_REFUSED, SWITCH_ON, VALUE, WRONG_MODE, check_target, no_data, switch_value,
};
use crate::robot::pose::Pose;

/// What a controller is built with.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Where the arm stands at first.
    pub home: Pose,
    /// Lowest x, y, z a target may have, µm.
    pub workspace_min_um: [i32; 3],
    /// Highest x, y, z a target may have, µm.
    pub workspace_max_um: [i32; 3],
    /// Seconds of the robot in one second of the clock; positive.
    pub speed: f64,
    /// Seeds the loss of answers.
    pub seed: u64,
    /// What goes wrong; faults of the camera are ignored.
    pub faults: Vec<Fault>,
}

/// The simulated robot controller. It starts in play mode with command remote, servo off, standing at home.
#[derive(Clone, Debug)]
pub struct Controller {
    settings: Settings,
    is_playing: bool,
    is_remote: bool,
    is_servo_on: bool,
    is_held_by_command: bool,
    is_held_by_pendant: bool,
    is_estop_pressed: bool,
    is_silent: bool,
    alarms: Vec<Alarm>,
    pose: Pose,
    tool: i32,
    motion: Option<Motion>,
    incident: Option<(u64, Incident)>,
    accepted_move_count: u32,
    answer_count: u64,
    outputs: VecDeque<RobotOutput>,
}

/// What the controller wants done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RobotOutput {
    /// An answer, for the sender of the request alone.
    Datagram {
        /// Receiver.
        to: SocketAddr,
        /// Whole datagram.
        bytes: Vec<u8>,
    },
    /// A datagram that no client should have sent.
    Violation(String),
}

/// What a person at the cell does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Panel {
    /// Turns the key to play, or to teach.
    Play(bool),
    /// Sets or clears command remote.
    Remote(bool),
    /// Presses or releases the hold of the pendant.
    Hold(bool),
    /// Presses or releases the emergency stop.
    EmergencyStop(bool),
}

/// An alarm that is not reset yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Alarm {
    code: u32,
    raised_ns: u64,
}

/// What happens in the middle of a move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Incident {
    Alarm(u32),
    EmergencyStop,
}

/// Data of an answer, or the refusal.
type Reply = Result<Vec<u8>, Refusal>;

impl Controller {
    /// Controller at home.
    pub fn new(settings: Settings) -> Self {
        Self {
            is_playing: true,
            is_remote: !settings.faults.contains(&Fault::RemoteOff),
            is_servo_on: false,
            is_held_by_command: false,
            is_held_by_pendant: false,
            is_estop_pressed: settings.faults.contains(&Fault::ServoRefused),
            is_silent: false,
            alarms: Vec::new(),
            pose: settings.home,
            tool: TOOL_AT_START,
            motion: None,
            incident: None,
            accepted_move_count: 0,
            answer_count: 0,
            outputs: VecDeque::new(),
            settings,
        }
    }

    /// Takes one datagram. A malformed one is told and not answered.
    pub fn handle_datagram(&mut self, now_ns: u64, from: SocketAddr, datagram: &[u8]) {
        self.advance(now_ns);
        let request = match Request::parse(datagram) {
            Ok(request) => request,
            Err(malformed) => {
                self.outputs
                    .push_back(RobotOutput::Violation(format!("hses from {from}: {malformed}")));
                return;
            }
        };
        let bytes = match self.reply(now_ns, &request) {
            Ok(data) => request.done(&data),
            Err(refusal) => request.refused(refusal),
        };
        self.answer_count += 1;
        if !self.is_silent && !self.is_answer_lost() {
            self.outputs.push_back(RobotOutput::Datagram { to: from, bytes });
        }
    }

    /// Takes what a person does at the cell.
    pub fn handle_panel(&mut self, now_ns: u64, panel: Panel) {
        self.advance(now_ns);
        match panel {
            Panel::Play(is_playing) => self.is_playing = is_playing,
            Panel::Remote(is_remote) => self.is_remote = is_remote,
            Panel::Hold(is_held) => {
                self.is_held_by_pendant = is_held;
                if is_held {
                    self.slow_down(now_ns);
                }
            }
            Panel::EmergencyStop(is_pressed) => {
                self.is_estop_pressed = is_pressed;
                if is_pressed {
                    self.servo_off(now_ns);
                }
            }
        }
    }

    /// Next thing to do.
    pub fn poll_output(&mut self) -> Option<RobotOutput> {
        self.outputs.pop_front()
    }

    /// Where the arm is, `base_from_tool`; exactly what it reports.
    pub fn pose(&mut self, now_ns: u64) -> Pose {
        self.advance(now_ns);
        self.motion.as_ref().map_or(self.pose, |motion| motion.pose(now_ns))
    }

    /// Whether the arm is moving.
    pub fn is_moving(&mut self, now_ns: u64) -> bool {
        self.advance(now_ns);
        self.motion.is_some()
    }

    /// Moves accepted so far.
    pub fn accepted_move_count(&self) -> u32 {
        self.accepted_move_count
    }

    /// Lets everything happen that is due: the incident of a fault first, then the end of the move.
    fn advance(&mut self, now_ns: u64) {
        if let Some((at_ns, incident)) = self.incident.filter(|(at_ns, _)| *at_ns <= now_ns) {
            self.incident = None;
            match incident {
                Incident::Alarm(code) => self.raise_alarm(at_ns, code),
                Incident::EmergencyStop => {
                    self.is_estop_pressed = true;
                    self.servo_off(at_ns);
                }
            }
        }
        if let Some(motion) = self.motion.take_if(|motion| motion.end_ns() <= now_ns) {
            self.pose = motion.pose(now_ns);
        }
    }

    fn reply(&mut self, now_ns: u64, request: &Request) -> Reply {
        check_target(request)?;
        match (request.command, request.instance) {
            (hses::COMMAND_ALARM, instance) => no_data(request).map(|()| self.alarm_data(instance)),
            (hses::COMMAND_STATUS, _) => no_data(request).map(|()| self.status_data()),
            (hses::COMMAND_POSITION, instance) => no_data(request).map(|()| self.position_data(now_ns, instance)),
            (hses::COMMAND_SYSTEM, _) => no_data(request).map(|()| {
                hses::system_data(
                    concat!("SIMULATED ", env!("CARGO_PKG_VERSION")),
                    "SIMULATED DX200",
                    "SIM",
                )
            }),
            (hses::COMMAND_RESET, instance) => self.reset(request, instance),
            (hses::COMMAND_SWITCH, INSTANCE_HOLD) => self.switch_hold(now_ns, request),
            (hses::COMMAND_SWITCH, _) => self.switch_servo(now_ns, request),
            (hses::COMMAND_MOVE, _) => self.accept_move(now_ns, request),
            _ => Err(Refusal::UndefinedCommand),
        }
    }

    fn status_data(&self) -> Vec<u8> {
        let bit = |is_set: bool, bit: u32| u32::from(is_set) << bit;
        let data_1 = bit(true, 2)
            | bit(self.motion.is_some(), 3)
            | bit(!self.is_playing, 5)
            | bit(self.is_playing, 6)
            | bit(self.is_remote, 7);
        let data_2 = bit(self.is_held_by_pendant, 1)
            | bit(self.is_held_by_command, 3)
            | bit(!self.alarms.is_empty(), 4)
            | bit(self.is_servo_on, 6);
        hses::status_data(data_1, data_2)
    }

    fn alarm_data(&self, instance: u16) -> Vec<u8> {
        match self.alarms.get(usize::from(instance) - 1) {
            Some(alarm) => hses::alarm_data(
                alarm.code,
                1,
                1,
                &controller_time(alarm.raised_ns),
                alarm_name(alarm.code),
            ),
            None => hses::alarm_data(0, 0, 0, "", ""),
        }
    }

    /// Instance 1 is the pulses, on a scale of the simulator's own; the other is the pose in the base.
    fn position_data(&mut self, now_ns: u64, instance: u16) -> Vec<u8> {
        let Pose {
            position_um: [x, y, z],
            turn_e4_deg: [rx, ry, rz],
        } = self.pose(now_ns);
        if instance == INSTANCE_PULSES {
            return hses::words_data(&[
                0,
                0,
                self.tool,
                0,
                0,
                x / 10,
                y / 10,
                z / 10,
                rx / 10,
                ry / 10,
                rz / 10,
                0,
                0,
            ]);
        }
        hses::words_data(&[16, FORM, self.tool, 0, 0, x, y, z, rx, ry, rz, 0, 0])
    }

    fn reset(&mut self, request: &Request, instance: u16) -> Reply {
        self.check_remote()?;
        if switch_value(request)? != 1 {
            return Err(Refusal::Failed(VALUE));
        }
        if instance == INSTANCE_ALARM_RESET {
            self.alarms.clear();
        }
        Ok(Vec::new())
    }

    /// Hold on works in any mode and without command remote: a stop needs no permission.
    fn switch_hold(&mut self, now_ns: u64, request: &Request) -> Reply {
        match switch_value(request)? {
            SWITCH_ON => {
                self.is_held_by_command = true;
                self.slow_down(now_ns);
            }
            _ => {
                self.check_remote()?;
                self.is_held_by_command = false;
            }
        }
        Ok(Vec::new())
    }

    fn switch_servo(&mut self, now_ns: u64, request: &Request) -> Reply {
        self.check_remote()?;
        match switch_value(request)? {
            SWITCH_ON => {
                self.check_no_alarm()?;
                if self.is_estop_pressed {
                    return Err(Refusal::Failed(SERVO_REFUSED));
                }
                self.is_servo_on = true;
            }
            _ => self.servo_off(now_ns),
        }
        Ok(Vec::new())
    }

    fn accept_move(&mut self, now_ns: u64, request: &Request) -> Reply {
        self.check_remote()?;
        refuse_first([
            (!self.is_playing, Refusal::Failed(WRONG_MODE)),
            (!self.alarms.is_empty(), Refusal::Failed(ALARM_PRESENT)),
            (self.is_held_by_pendant, Refusal::Failed(HELD_BY_PENDANT)),
            (self.is_held_by_command, Refusal::Failed(HELD_BY_COMMAND)),
            (!self.is_servo_on, Refusal::Failed(SERVO_OFF)),
            (self.motion.is_some(), Refusal::Failed(MOVING)),
        ])?;
        let order = MoveOrder::read(request, &self.settings)?;
        self.begin_move(now_ns, order);
        Ok(Vec::new())
    }

    fn begin_move(&mut self, now_ns: u64, order: MoveOrder) {
        let move_index = self.accepted_move_count;
        self.accepted_move_count += 1;
        self.tool = order.tool;
        let mut target = order.target;
        for fault in &self.settings.faults {
            match *fault {
                Fault::Elsewhere { distance_mm, view } if view == move_index => {
                    target.position_um[2] += (distance_mm * 1000.0).round() as i32;
                }
                Fault::RobotSilent { view } if view == move_index => self.is_silent = true,
                _ => (),
            }
        }
        let motion = Motion::new(now_ns, self.pose, target, order.rate, self.settings.speed);
        self.incident = self.settings.faults.iter().find_map(|fault| match *fault {
            Fault::RobotAlarm { code, view } if view == move_index => Some((motion.middle_ns(), Incident::Alarm(code))),
            Fault::Estop { view } if view == move_index => Some((motion.middle_ns(), Incident::EmergencyStop)),
            _ => None,
        });
        self.motion = Some(motion);
    }

    fn raise_alarm(&mut self, now_ns: u64, code: u32) {
        self.alarms.insert(
            0,
            Alarm {
                code,
                raised_ns: now_ns,
            },
        );
        self.alarms.truncate(ALARM_COUNT_MAX);
        self.servo_off(now_ns);
    }

    fn slow_down(&mut self, now_ns: u64) {
        if let Some(motion) = &mut self.motion {
            motion.stop(now_ns);
        }
    }

    /// The brakes fall at once: no ramp.
    fn servo_off(&mut self, now_ns: u64) {
        self.is_servo_on = false;
        if let Some(motion) = self.motion.take() {
            self.pose = motion.pose(now_ns);
        }
    }

    fn check_remote(&self) -> Result<(), Refusal> {
        refuse_first([(!self.is_remote, Refusal::Failed(NOT_REMOTE))])
    }

    fn check_no_alarm(&self) -> Result<(), Refusal> {
        refuse_first([(!self.alarms.is_empty(), Refusal::Failed(ALARM_PRESENT))])
    }

    /// Drawn from the seed and the count of the answer.
    fn is_answer_lost(&self) -> bool {
        self.settings.faults.iter().any(|fault| match fault {
            Fault::AnswerLost { fraction } => {
                let mut rng = ChaCha8Rng::seed_from_u64(self.settings.seed);
                rng.set_stream(self.answer_count);
                (rng.next_u32() as f64) < fraction * (f64::from(u32::MAX) + 1.0)
            }
            _ => false,
        })
    }
}

/// "YYYY/MM/DD HH:MM" of a calendar that begins when the cell does.
fn controller_time(now_ns: u64) -> String {
    let minutes = 3 * 60 + 4 + now_ns / 60_000_000_000;
    format!(
        "2026/01/{:02} {:02}:{:02}",
        (2 + minutes / 1440).min(31),
        minutes / 60 % 24,
        minutes % 60
    )
}

fn alarm_name(code: u32) -> &'static str {
    match code {
        4315 => "COLLISION DETECT",
        _ => "SIMULATED ALARM",
    }
}

const TOOL_AT_START: i32 = 1;
/// Arm configuration that the position answer states: the one of the page's vector.
const FORM: i32 = 4;
const ALARM_COUNT_MAX: usize = 4;

#[cfg(test)]
#[path = "controller_tests.rs"]
mod tests;
