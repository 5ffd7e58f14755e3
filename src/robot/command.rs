//! What can be said to the controller, whatever the link: meaning only, no bytes.

use super::pose::WirePose;
use super::variable::{JobName, Values, Variable};

/// Something to say to the controller.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Read the status bits.
    Status,
    /// Read the active alarm of this index, 0 (newest) to 3.
    Alarm(u8),
    /// Read one entry of the alarm history.
    AlarmHistory {
        /// Whose alarms.
        class: AlarmClass,
        /// 0 (newest) to 99.
        index: u8,
    },
    /// Read the cartesian position of robot 1 in the base frame.
    Position,
    /// Read the axes of robot 1 in pulses.
    Pulses,
    /// Read which job is selected, and where in it the controller is.
    ExecutingJob,
    /// Read what the controller is.
    SystemInformation,
    /// Read the names of the jobs (host control; HSES has them as files).
    JobNames,
    /// Read variables of one kind, `count` of them from `first` on.
    Read {
        /// The first.
        first: Variable,
        /// How many, 1 or more; the most that one request carries depends on the link.
        count: u16,
    },
    /// Read groups of eight signals, from signal `10 * first_group` on.
    ReadSignals {
        /// Signal number divided by ten.
        first_group: u16,
        /// How many groups.
        count: u16,
    },
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
    /// Choose how far a started job runs.
    SetCycle(Cycle),
    /// Show a text on the pendant: at most 30 printable ASCII characters.
    ShowText(String),
    /// Select the job that a start runs, and the line it begins at.
    SelectJob {
        /// Its name, without extension.
        job: JobName,
        /// 0 to 9999.
        line: u32,
    },
    /// Delete a job (host control; HSES has it as a file).
    DeleteJob {
        /// Its name, without extension.
        job: JobName,
    },
    /// Start the selected job, or go on with a stopped one.
    StartJob,
    /// Write variables of one kind, from `first` on. Only for values that bear being written twice.
    Write {
        /// The first.
        first: Variable,
        /// What to write; of the same kind as `first`.
        values: Values,
    },
    /// Write the number of an order that a job on the controller carries out once: a motion may follow.
    Order {
        /// The double-precision integer variable that the job watches.
        variable: u16,
        /// What to write.
        value: i32,
    },
    /// Write groups of eight network inputs, from signal `10 * first_group` on.
    WriteSignals {
        /// Signal number divided by ten.
        first_group: u16,
        /// Bit n of a byte is the signal that ends in n.
        groups: Vec<u8>,
    },
    /// Start a move to an absolute pose.
    Move(Move),
    /// Start a move to absolute axis positions.
    MovePulses(MovePulses),
}

/// How a command may be repeated (`ARCHITECTURE.md`, "asking, setting, acting").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Sent again on time-out: nothing moves by it, and twice is as good as once.
    Ask,
    /// Towards the safe side: repeated until confirmed, waits for nothing.
    Set,
    /// Sent again on time-out like an ask, because twice does no more than once: a job on the controller carries out each
    /// number once, and is selected. But a motion may follow, so the record of what caused it comes first.
    Order,
    /// Sent once.
    Act,
}

impl Kind {
    /// Whether a time-out may be answered by saying it again.
    pub fn bears_repetition(self) -> bool {
        !matches!(self, Self::Act)
    }

    /// Whether it may only leave when the record of what caused it has left the process.
    pub fn waits_for_journal(self) -> bool {
        matches!(self, Self::Order | Self::Act)
    }
}

/// Whose alarms a history holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AlarmClass {
    /// Those that need the controller switched off and on.
    Major,
    /// Those that a reset clears.
    Minor,
    /// Raised by a job, of the system's numbers.
    UserSystem,
    /// Raised by a job, of the user's numbers.
    UserUser,
    /// Raised while off line.
    Offline,
}

/// How far a started job runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cycle {
    /// One instruction.
    Step,
    /// To its end, once.
    Once,
    /// Again and again.
    Continuous,
}

/// A move of robot 1 in the base frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Move {
    /// Where to.
    pub base_from_tool: WirePose,
    /// On which way.
    pub path: Path,
    /// How fast.
    pub speed: Speed,
    /// Tool number, 0 to 63.
    pub tool: u8,
}

/// A move of robot 1 by its axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MovePulses {
    /// Where to, S L U R B T E W; what the arm does not have stays 0.
    pub pulses: [i32; 8],
    /// On which way.
    pub path: Path,
    /// How fast.
    pub speed: Speed,
    /// Tool number, 0 to 63.
    pub tool: u8,
}

/// The way of a move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Path {
    /// The tool point on a straight line.
    Straight,
    /// Every axis from here to there, all together ("link" in the manuals).
    Link,
}

/// A speed in one of the controller's classes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Speed {
    /// Share of the fastest link move, in 0.01 %: 1 to 10,000. Only for [`Path::Link`].
    Link(u32),
    /// Of the tool point, in 0.1 mm/s (class V).
    ToolPoint(u32),
    /// Of the turn, in 0.1 deg/s (class VR).
    Turn(u32),
}

impl Command {
    /// How it may be repeated.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Status
            | Self::Alarm(_)
            | Self::AlarmHistory { .. }
            | Self::Position
            | Self::Pulses
            | Self::ExecutingJob
            | Self::SystemInformation
            | Self::JobNames
            | Self::Read { .. }
            | Self::ReadSignals { .. }
            | Self::ShowText(_)
            | Self::Write { .. } => Kind::Ask,
            Self::HoldOn | Self::ServoOff => Kind::Set,
            Self::Order { .. } | Self::SelectJob { .. } => Kind::Order,
            Self::HoldOff
            | Self::ServoOn
            | Self::AlarmReset
            | Self::ErrorCancel
            | Self::SetCycle(_)
            | Self::DeleteJob { .. }
            | Self::StartJob
            | Self::WriteSignals { .. }
            | Self::Move(_)
            | Self::MovePulses(_) => Kind::Act,
        }
    }

    /// Its name for people.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Status => "status",
            Self::Alarm(_) => "alarm",
            Self::AlarmHistory { .. } => "alarm history",
            Self::Position => "position",
            Self::Pulses => "axes",
            Self::ExecutingJob => "executing job",
            Self::SystemInformation => "system information",
            Self::JobNames => "names of jobs",
            Self::Read { .. } => "read variable",
            Self::ReadSignals { .. } => "read signals",
            Self::HoldOn => "hold on",
            Self::HoldOff => "hold off",
            Self::ServoOn => "servo on",
            Self::ServoOff => "servo off",
            Self::AlarmReset => "alarm reset",
            Self::ErrorCancel => "error cancel",
            Self::SetCycle(_) => "cycle",
            Self::ShowText(_) => "text on the pendant",
            Self::SelectJob { .. } => "job select",
            Self::DeleteJob { .. } => "deletion of a job",
            Self::StartJob => "job start",
            Self::Write { .. } => "write variable",
            Self::Order { .. } => "order to the job",
            Self::WriteSignals { .. } => "write signals",
            Self::Move(_) => "move",
            Self::MovePulses(_) => "move by axes",
        }
    }
}
