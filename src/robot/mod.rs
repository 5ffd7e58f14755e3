//! The DX200 controller over HSES: meaning to bytes and back, without I/O.
//!
//! [`Command`] says what we want, [`Exchange`] turns it into datagrams and answers into [`RobotEvent`]s. The bytes are
//! fixed by `docs/protocols/hses.md`.

mod command;
mod exchange;
mod pose;
mod wire;

pub use command::{Alarm, Command, Kind, Move, Position, Refusal, Reply, ReplyError, Speed, Status, SystemInformation};
pub use exchange::{Datagram, Exchange, ExchangeSettings, RobotEvent};
pub use pose::WirePose;
pub use wire::{Answer, DATA_BYTES_MAX, HEADER_BYTES, Request, Service, WireError};
