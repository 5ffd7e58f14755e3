//! The DX200 controller: meaning to bytes and back, without I/O.
//!
//! [`Command`] says what we want and [`Reply`] what came of it, whatever the link. [`hses`] turns them into datagrams,
//! [`host`] into text over TCP or a serial line; the bytes are fixed by `docs/protocols/`. [`Exchange`] is the conversation:
//! what is open, what is said again, what has remained without an answer.

mod command;
mod exchange;
mod file;
pub mod host;
pub mod hses;
mod output;
mod pose;
mod refusal;
mod reply;
mod variable;

pub use command::{AlarmClass, Command, Cycle, Kind, Move, MovePulses, Path, Speed};
pub use exchange::{Exchange, ExchangeSettings, Protocol, RobotEvent};
pub use file::{FILE_BYTES_MAX, FileCommand, FileContent, FileContentError, FileEnding, FileName, FileNameError};
pub use hses::values_max;
pub use output::RobotOutput;
pub use pose::WirePose;
pub use reply::{Alarm, ExecutingJob, Position, Refusal, Reply, ReplyError, Status, SystemInformation};
pub use variable::{Form, Frame, JobName, JobNameError, PositionVariable, Values, Variable, VariableKind};
