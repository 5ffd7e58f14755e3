//! What we say to the controller and what it answers: meaning to fields and back (`docs/protocols/hses.md`, sections 2 to 4).

use super::pose::WirePose;
use super::wire::{Answer, Request, Service};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Something to say to the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Read the status bits.
    Status,
    /// Read the newest active alarm.
    Alarm,
    /// Read the cartesian position in the base frame.
    Position,
    /// Read what the controller is.
    SystemInformation,
    /// Stop the arm.
    HoldOn,
    /// Release a hold (does not move the arm by itself).
    HoldOff,
    /// Switch the servo power on.
    ServoOn,
    /// Switch the servo power off.
    ServoOff,
    /// Clear alarms whose cause is gone.
    AlarmReset,
    /// Clear errors.
    ErrorCancel,
    /// Start a straight move to an absolute pose.
    Move(Move),
}

/// How a command may be repeated (`ARCHITECTURE.md`, "asking, setting, acting").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Sent again on time-out.
    Ask,
    /// Towards the safe side: repeated until confirmed, waits for nothing.
    Set,
    /// Sent once.
    Act,
}

/// A straight move in the base frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Move {
    /// Where to.
    pub base_from_tool: WirePose,
    /// How fast.
    pub speed: Speed,
    /// Tool number, 0 to 63.
    pub tool: u8,
}

/// A speed in one of the controller's classes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Speed {
    /// Of the tool point, in 0.1 mm/s (class V).
    ToolPoint(u32),
    /// Of the turn, in 0.1 deg/s (class VR).
    Turn(u32),
}

/// What the controller answered.
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// To [`Command::Status`].
    Status(Status),
    /// To [`Command::Alarm`]; `None` when there is none.
    Alarm(Option<Alarm>),
    /// To [`Command::Position`].
    Position(Position),
    /// To [`Command::SystemInformation`].
    SystemInformation(SystemInformation),
    /// Carried out (for a move: accepted).
    Done,
}

/// The status bits of 0x72.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Status {
    /// Data 1.
    pub data_1: u32,
    /// Data 2.
    pub data_2: u32,
}

impl Status {
    /// The arm moves (or a job runs).
    pub fn running(self) -> bool {
        self.data_1 & 1 << 3 != 0
    }

    /// Play mode and command remote: acts are accepted.
    pub fn remote(self) -> bool {
        self.data_1 & 1 << 6 != 0 && self.data_1 & 1 << 7 != 0
    }

    /// Held at the pendant or by an external signal: nobody but a person there may release it.
    pub fn held_elsewhere(self) -> bool {
        self.data_2 & (1 << 1 | 1 << 2) != 0
    }

    /// Held by a command like ours.
    pub fn held_by_command(self) -> bool {
        self.data_2 & 1 << 3 != 0
    }

    /// An alarm is active.
    pub fn alarm(self) -> bool {
        self.data_2 & 1 << 4 != 0
    }

    /// An error is active.
    pub fn error(self) -> bool {
        self.data_2 & 1 << 5 != 0
    }

    /// Servo power is on.
    pub fn servo_on(self) -> bool {
        self.data_2 & 1 << 6 != 0
    }
}

/// One alarm record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Alarm {
    /// The alarm number.
    pub code: u32,
    /// Its sub-code.
    pub data: u32,
    /// When, as the controller writes it.
    pub time: String,
    /// Its name, as the controller writes it.
    pub name: String,
}

/// The cartesian position and the tool it is given for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Where the tool is.
    pub base_from_tool: WirePose,
    /// Which tool.
    pub tool: i32,
}

/// What the controller is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SystemInformation {
    /// Software version.
    pub software: String,
    /// Model.
    pub model: String,
}

impl SystemInformation {
    /// Whether the controller says that it is a simulated one.
    pub fn simulated(&self) -> bool {
        self.software.contains("SIMULATED") || self.model.contains("SIMULATED")
    }
}

/// The controller said no.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refusal {
    /// The status byte, not 0.
    pub status: u8,
    /// The added status.
    pub added_status: u16,
}

/// An answer that says yes but whose data make no sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ReplyError {
    /// Wrong number of data bytes.
    #[error("{found} data bytes where {expected} belong")]
    Length {
        /// How many the command's answer has.
        expected: usize,
        /// How many came.
        found: usize,
    },
    /// A position that is not cartesian in the base frame.
    #[error("position type {0} instead of 16 (base)")]
    PositionType(i32),
}

impl Command {
    /// How it may be repeated.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Status | Self::Alarm | Self::Position | Self::SystemInformation => Kind::Ask,
            Self::HoldOn | Self::ServoOff => Kind::Set,
            Self::HoldOff | Self::ServoOn | Self::AlarmReset | Self::ErrorCancel | Self::Move(_) => Kind::Act,
        }
    }

    /// Its name for people.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Status => "status",
            Self::Alarm => "alarm",
            Self::Position => "position",
            Self::SystemInformation => "system information",
            Self::HoldOn => "hold on",
            Self::HoldOff => "hold off",
            Self::ServoOn => "servo on",
            Self::ServoOff => "servo off",
            Self::AlarmReset => "alarm reset",
            Self::ErrorCancel => "error cancel",
            Self::Move(_) => "move",
        }
    }

    /// The request with the given id.
    pub fn request(&self, id: u8) -> Request {
        let (command, instance, attribute, service, data) = match self {
            Self::Alarm => (0x70, 1, 0, Service::GetAll, vec![]),
            Self::Status => (0x72, 1, 0, Service::GetAll, vec![]),
            Self::Position => (0x75, 101, 0, Service::GetAll, vec![]),
            Self::SystemInformation => (0x89, 11, 0, Service::GetAll, vec![]),
            Self::AlarmReset => (0x82, 1, 1, Service::SetOne, word(1)),
            Self::ErrorCancel => (0x82, 2, 1, Service::SetOne, word(1)),
            Self::HoldOn => (0x83, 1, 1, Service::SetOne, word(1)),
            Self::HoldOff => (0x83, 1, 1, Service::SetOne, word(2)),
            Self::ServoOn => (0x83, 2, 1, Service::SetOne, word(1)),
            Self::ServoOff => (0x83, 2, 1, Service::SetOne, word(2)),
            Self::Move(target) => (0x8A, 2, 1, Service::SetAll, target.encode()),
        };
        Request {
            id,
            command,
            instance,
            attribute,
            service,
            data,
        }
    }

    /// Reads the data of a positive answer to this command.
    pub fn reply(&self, answer: &Answer) -> Result<Reply, ReplyError> {
        let data = answer.data.as_slice();
        let length = |expected: usize| match data.len() == expected {
            true => Ok(()),
            false => Err(ReplyError::Length {
                expected,
                found: data.len(),
            }),
        };
        Ok(match self {
            Self::Status => {
                length(8)?;
                Reply::Status(Status {
                    data_1: u32_at(data, 0),
                    data_2: u32_at(data, 4),
                })
            }
            Self::Alarm => {
                length(60)?;
                Reply::Alarm((u32_at(data, 0) != 0).then(|| Alarm {
                    code: u32_at(data, 0),
                    data: u32_at(data, 4),
                    time: text(&data[12..28]),
                    name: text(&data[28..60]),
                }))
            }
            Self::Position => Reply::Position(position(data)?),
            Self::SystemInformation => {
                length(48)?;
                Reply::SystemInformation(SystemInformation {
                    software: text(&data[0..24]),
                    model: text(&data[24..40]),
                })
            }
            _ => Reply::Done,
        })
    }
}

impl Move {
    /// 26 × i32, section 4 of the page.
    fn encode(&self) -> Vec<u8> {
        let (class, speed) = match self.speed {
            Speed::ToolPoint(speed) => (1, speed),
            Speed::Turn(speed) => (2, speed),
        };
        let mut words = [0i32; 26];
        words[0] = 1;
        words[2] = class;
        words[3] = speed as i32;
        words[4] = BASE_COORDINATE;
        words[5..8].copy_from_slice(&self.base_from_tool.position_um);
        words[8..11].copy_from_slice(&self.base_from_tool.rotation_e4_deg);
        words[15] = i32::from(self.tool);
        words.iter().flat_map(|word| word.to_le_bytes()).collect()
    }
}

impl Refusal {
    /// What it means and what to do, in one line.
    pub fn words(self) -> String {
        match self.added_status {
            0x2010 => "the robot is moving (2010): wait until it stands".into(),
            0x2020 => "held at the pendant (2020): release the hold there".into(),
            0x2030 => "held at the panel (2030): release the hold there".into(),
            0x2040 => "held by an external signal (2040): release it".into(),
            0x2050 => "held by command (2050): resume the run".into(),
            0x2060 => "an error or alarm is present (2060): remove its cause and reset".into(),
            0x2070 => "servo power is off (2070): switch it on".into(),
            0x2080 => "wrong mode (2080): turn the mode key to PLAY/REMOTE".into(),
            0x2100 => "command remote is not set (2100): turn the key to REMOTE and set CMD REMOTE SEL (#82015)".into(),
            0x3450 => "servo power cannot be switched on (3450): release the emergency stop, close the doors".into(),
            0xB004 => "a value is out of range (B004): the pose lies outside the robot's workspace".into(),
            0xB009 | 0xB00A => "the speed is refused (B009/B00A): check the station's speeds".into(),
            0xB00D => "the tool number is refused (B00D): check the station's tool".into(),
            0xA000 => "the controller does not know this command (A000)".into(),
            0xD8F1 | 0xE444 | 0xD8FA | 0xFFF6 => format!("the controller is busy ({:04X})", self.added_status),
            0 => match self.status {
                0x08 => "the controller does not know this command (status 08)".into(),
                0x09 => "the controller does not know this attribute (status 09)".into(),
                0x28 => "the controller does not know this instance (status 28)".into(),
                status => format!("refused with status {status:02X} and no reason"),
            },
            added => format!("refused with {added:04X} (status {:02X})", self.status),
        }
    }
}

fn word(value: u32) -> Vec<u8> {
    value.to_le_bytes().to_vec()
}

fn u32_at(data: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]])
}

fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}

fn position(data: &[u8]) -> Result<Position, ReplyError> {
    if !matches!(data.len(), 44 | 48 | 52) {
        return Err(ReplyError::Length {
            expected: 52,
            found: data.len(),
        });
    }
    let word = |index: usize| u32_at(data, index * 4) as i32;
    if word(0) != BASE_COORDINATE {
        return Err(ReplyError::PositionType(word(0)));
    }
    Ok(Position {
        base_from_tool: WirePose {
            position_um: [word(5), word(6), word(7)],
            rotation_e4_deg: [word(8), word(9), word(10)],
        },
        tool: word(2),
    })
}

const BASE_COORDINATE: i32 = 16;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::hses;

    const PAGE_POSE: WirePose = WirePose {
        position_um: [500_000, -250_000, 750_000],
        rotation_e4_deg: [1_800_000, 0, -900_000],
    };

    #[test]
    fn requests_equal_the_vectors_of_the_page() {
        let target = Command::Move(Move {
            base_from_tool: PAGE_POSE,
            speed: Speed::ToolPoint(500),
            tool: 1,
        });
        for (command, id, name) in [
            (Command::Status, 0, "req_status"),
            (Command::Alarm, 0, "req_alarm_1"),
            (Command::Position, 1, "req_position"),
            (Command::HoldOn, 1, "req_hold_on"),
            (Command::HoldOff, 1, "req_hold_off"),
            (Command::ServoOn, 1, "req_servo_on"),
            (Command::ServoOff, 1, "req_servo_off"),
            (Command::AlarmReset, 1, "req_alarm_reset"),
            (Command::ErrorCancel, 1, "req_error_cancel"),
            (Command::SystemInformation, 1, "req_system_information"),
            (target, 1, "req_move_base_50mm_s"),
        ] {
            assert_eq!(command.request(id).encode(), hses(name), "{name}");
        }
    }

    #[test]
    fn answers_of_the_page_mean_what_they_say() {
        let reply = |command: Command, name: &str| command.reply(&Answer::decode(&hses(name)).unwrap()).unwrap();
        let Reply::Status(ready) = reply(Command::Status, "ans_status_ready") else {
            panic!()
        };
        assert!(ready.remote() && ready.servo_on() && !ready.running() && !ready.alarm());
        let Reply::Status(held) = reply(Command::Status, "ans_status_hold_alarm") else {
            panic!()
        };
        assert!(held.held_by_command() && held.alarm() && !held.servo_on() && !held.held_elsewhere());
        assert_eq!(reply(Command::Alarm, "ans_alarm_none"), Reply::Alarm(None));
        let Reply::Alarm(Some(alarm)) = reply(Command::Alarm, "ans_alarm_4315") else {
            panic!()
        };
        assert_eq!((alarm.code, alarm.name.as_str()), (4315, "COLLISION DETECT"));
        let Reply::Position(position) = reply(Command::Position, "ans_position") else {
            panic!()
        };
        assert_eq!((position.base_from_tool, position.tool), (PAGE_POSE, 1));
        let Reply::SystemInformation(system) = reply(Command::SystemInformation, "ans_system_information") else {
            panic!()
        };
        assert!(system.simulated());
    }

    #[test]
    fn data_of_the_wrong_length_are_an_error_not_a_panic() {
        let mut answer = Answer::decode(&hses("ans_status_ready")).unwrap();
        for command in [
            Command::Status,
            Command::Alarm,
            Command::Position,
            Command::SystemInformation,
        ] {
            for length in 0..120 {
                answer.data = vec![0; length];
                let _ = command.reply(&answer);
            }
        }
        answer.data = vec![0; 7];
        assert_eq!(
            Command::Status.reply(&answer),
            Err(ReplyError::Length { expected: 8, found: 7 })
        );
    }
}
