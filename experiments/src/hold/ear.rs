//! What the simulated robot hears about holding, and when, by the simulator's clock.
//!
//! A datagram or a piece of a stream counts when it is read. The serial line has a speed: there a request counts when the EOT behind
//! it has come over the line, for only then the robot does what it says, and the line is free from the last EOT before it, of
//! either end.

use std::time::{Duration, Instant};

use bladescan::robot;
use hw_sim::cell::Input;
use hw_sim::robot::ports::{LineEnd, Passed, PortInput};
use hw_sim::shell::Seen;

/// What came to the robot.
#[derive(Debug)]
pub(super) enum Arrival {
    /// Hold on; where one thing is said at a time, with the end of what was said before.
    Hold {
        at: Instant,
        free_at: Option<Instant>,
        /// What passed on the serial line until then.
        steps: Vec<Step>,
    },
    /// Hold off.
    Release,
}

/// Bytes at one place of the serial line.
#[derive(Debug, Clone)]
pub(super) struct Step {
    /// When they were there: read from the host, or the last of them over the line.
    pub(super) at: Instant,
    /// How much later the simulator saw to it.
    pub(super) late: Duration,
    /// Where that is.
    pub(super) place: Place,
    pub(super) bytes: Vec<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// Written by the host, at the beginning of the line.
    FromHost,
    /// At the robot's end.
    AtRobot,
    /// At the host's end.
    AtHost,
}

/// Hears what is said to the robot about holding.
#[derive(Debug, Default)]
pub(super) struct Ear {
    stream: StreamEar,
    line: LineEar,
    steps: Vec<Step>,
}

impl Ear {
    pub(super) fn hear(&mut self, at: Instant, seen: Seen<'_>) -> Option<Arrival> {
        match seen {
            Seen::Input(Input::RobotDatagram { bytes, .. }) => datagram(at, bytes),
            Seen::Input(Input::RobotPort(PortInput::Bytes { bytes, .. })) => self.stream.hear(at, bytes),
            Seen::Input(Input::RobotPort(PortInput::Serial(bytes))) => {
                self.note(at, Place::FromHost, bytes);
                None
            }
            Seen::Input(_) => None,
            Seen::Passed(passed) => {
                let place = match passed.from {
                    LineEnd::Host => Place::AtRobot,
                    LineEnd::Robot => Place::AtHost,
                };
                self.note(at, place, &[passed.byte]);
                let mut arrival = self.line.hear(at, passed)?;
                let heard = std::mem::take(&mut self.steps);
                if let Arrival::Hold { steps, .. } = &mut arrival {
                    *steps = heard;
                }
                Some(arrival)
            }
        }
    }

    /// Characters that the simulator sees to together are one step.
    fn note(&mut self, at: Instant, place: Place, bytes: &[u8]) {
        let now = Instant::now();
        match self.steps.last_mut() {
            Some(step) if step.place == place && now - (step.at + step.late) < TOGETHER => {
                step.at = at;
                step.late = now.saturating_duration_since(at);
                step.bytes.extend(bytes);
            }
            _ => self.steps.push(Step {
                at,
                late: now.saturating_duration_since(at),
                place,
                bytes: bytes.to_vec(),
            }),
        }
        let surplus = self.steps.len().saturating_sub(STEPS_MAX);
        self.steps.drain(..surplus);
    }
}

/// Hears a stream.
#[derive(Debug, Default)]
struct StreamEar {
    /// The last bytes.
    tail: Vec<u8>,
    /// When the last piece came before the one that began what is being said.
    free_at: Option<Instant>,
    last: Option<Instant>,
}

impl StreamEar {
    fn hear(&mut self, at: Instant, bytes: &[u8]) -> Option<Arrival> {
        if bytes.starts_with(b"HOSTCTRL_REQUEST") {
            self.free_at = self.last;
        }
        self.last = Some(at);
        self.tail.extend(bytes);
        let has = |text: &[u8]| self.tail.windows(text.len()).any(|some| some == text);
        let arrival = if has(b"HOLD 2\r\n1\r") {
            Some(hold(at, self.free_at))
        } else {
            has(b"HOLD 2\r\n0\r").then_some(Arrival::Release)
        };
        if arrival.is_some() {
            self.tail.clear();
        }
        let surplus = self.tail.len().saturating_sub(TAIL_BYTES);
        self.tail.drain(..surplus);
        arrival
    }
}

/// Hears the serial line, character by character.
#[derive(Debug, Default)]
struct LineEar {
    from_host: Way,
    from_robot: Way,
    /// When the last EOT came.
    free_at: Option<Instant>,
}

/// One way of the line.
#[derive(Debug, Default)]
struct Way {
    said: Vec<u8>,
    /// Bytes of the check sum to come, which are no control characters.
    sum_left: usize,
}

impl LineEar {
    fn hear(&mut self, at: Instant, passed: Passed) -> Option<Arrival> {
        let way = match passed.from {
            LineEnd::Host => &mut self.from_host,
            LineEnd::Robot => &mut self.from_robot,
        };
        if way.sum_left > 0 {
            way.sum_left -= 1;
            return None;
        }
        match passed.byte {
            ETX => way.sum_left = SUM_BYTES,
            ENQ => way.said.clear(),
            EOT => {
                let said = std::mem::take(&mut way.said);
                let free_at = self.free_at.replace(at);
                if said.ends_with(b"HOLD 1\r") {
                    return Some(hold(at, free_at));
                }
                return said.ends_with(b"HOLD 0\r").then_some(Arrival::Release);
            }
            byte => way.said.push(byte),
        }
        None
    }
}

fn datagram(at: Instant, bytes: &[u8]) -> Option<Arrival> {
    let id = *bytes.get(11)?;
    let is = |command: robot::Command| robot::hses::request(&command, id).is_ok_and(|said| said.encode() == bytes);
    if is(robot::Command::HoldOn) {
        Some(hold(at, None))
    } else {
        is(robot::Command::HoldOff).then_some(Arrival::Release)
    }
}

fn hold(at: Instant, free_at: Option<Instant>) -> Arrival {
    Arrival::Hold {
        at,
        free_at,
        steps: Vec::new(),
    }
}

const ETX: u8 = 3;
const EOT: u8 = 4;
const ENQ: u8 = 5;
const SUM_BYTES: usize = 2;
const TAIL_BYTES: usize = 64;
const STEPS_MAX: usize = 48;
const TOGETHER: Duration = Duration::from_micros(200);
