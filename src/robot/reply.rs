//! What the controller answers, whatever the link: meaning only, no bytes.

use super::pose::WirePose;
use super::variable::{Form, Values};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What the controller answered.
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// To [`Command::Status`](super::Command::Status).
    Status(Status),
    /// To [`Command::Alarm`](super::Command::Alarm) and the history; `None` when there is none of this index.
    Alarm(Option<Alarm>),
    /// To [`Command::Position`](super::Command::Position).
    Position(Position),
    /// To [`Command::Pulses`](super::Command::Pulses): S L U R B T E W.
    Pulses([i32; 8]),
    /// To [`Command::ExecutingJob`](super::Command::ExecutingJob).
    ExecutingJob(ExecutingJob),
    /// To [`Command::SystemInformation`](super::Command::SystemInformation).
    SystemInformation(SystemInformation),
    /// To [`Command::JobNames`](super::Command::JobNames), without extension.
    JobNames(Vec<String>),
    /// To [`Command::Read`](super::Command::Read).
    Values(Values),
    /// To [`Command::ReadSignals`](super::Command::ReadSignals), eight signals a byte.
    Signals(Vec<u8>),
    /// Carried out (for a move or a start: accepted).
    Done,
}

/// The status bits, which HSES (0x72) and host control (RSTATS) share.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Status {
    /// Data 1.
    pub data_1: u32,
    /// Data 2.
    pub data_2: u32,
}

impl Status {
    /// The arm moves, or a job runs.
    pub fn running(self) -> bool {
        self.data_1 & 1 << 3 != 0
    }

    /// Speeds are restricted (sources disagree on the bit's name): never as fast as commanded.
    pub fn speed_restricted(self) -> bool {
        self.data_1 & 1 << 4 != 0
    }

    /// Teach mode.
    pub fn teach(self) -> bool {
        self.data_1 & 1 << 5 != 0
    }

    /// Play mode.
    pub fn play(self) -> bool {
        self.data_1 & 1 << 6 != 0
    }

    /// Play mode and command remote: acts are accepted.
    pub fn remote(self) -> bool {
        self.play() && self.data_1 & 1 << 7 != 0
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
    /// When, as the controller writes it; empty where the link has no room for it.
    pub time: String,
    /// Its name, as the controller writes it; empty where the link has no room for it.
    pub name: String,
}

/// The cartesian position and the tool it is given for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Where the tool is.
    pub base_from_tool: WirePose,
    /// Which tool.
    pub tool: i32,
    /// The arm's configuration.
    pub form: Form,
}

/// The selected job and where in it the controller is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExecutingJob {
    /// Its name, without extension; empty when none is selected.
    pub name: String,
    /// Line, from 0.
    pub line: u32,
    /// Step, from 0.
    pub step: u32,
    /// Speed override in 0.01 %, where the link tells it.
    pub override_e2_percent: Option<u32>,
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
    /// The status byte of HSES, not 0; 0x1F on the other links.
    pub status: u8,
    /// The added status of HSES, or the interpreter's code of host control: one family of numbers.
    pub added_status: u16,
}

/// An answer that says yes but makes no sense.
#[derive(Debug, Clone, PartialEq, Error)]
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
    /// A value that its field cannot have.
    #[error("field {field} is {found}")]
    Field {
        /// Which field.
        field: &'static str,
        /// What it has, as text.
        found: String,
    },
    /// Wrong number of fields in a text answer.
    #[error("{found} fields where {expected} belong")]
    Fields {
        /// How many the command's answer has.
        expected: usize,
        /// How many came.
        found: usize,
    },
}
