//! Host control: commands as text, over TCP (`docs/protocols/host_control.md`) or a serial line (`docs/protocols/bsc_like.md`).
//!
//! [`text`] turns a [`Command`](super::Command) into a name with data and an answer into a [`Reply`]. [`TcpLink`] and
//! [`SerialLink`] carry them: one transaction at a time, bytes and time in, bytes and events out. Both have the same verbs.
//!
//! Every transaction that [`say`](TcpLink::say) opens ends in exactly one of [`LinkEvent::Answered`],
//! [`LinkEvent::Refused`] and [`LinkEvent::Unanswered`], or for files [`LinkEvent::Saved`] and [`LinkEvent::Listed`]; one that
//! was given up ends in none.
//! The other events are told beside.

pub mod bsc;
mod link;
pub mod tcp;
pub mod text;

pub use bsc::{SerialLink, SerialSettings};
pub use link::HostLink;
pub use tcp::{TcpLink, TcpSettings};

use super::file::FileName;
use super::reply::{Refusal, Reply};
use thiserror::Error;

/// What came of a command, or of bytes that fit none.
#[derive(Debug, Clone, PartialEq)]
pub enum LinkEvent {
    /// Carried out, or data read. Ends the transaction.
    Answered(Reply),
    /// The controller said no. Ends the transaction.
    Refused(Refusal),
    /// No answer that makes sense, within the bounds. An act may have been carried out or not. Ends the transaction.
    Unanswered,
    /// The file that was asked for. Ends the transaction.
    Saved {
        /// Its name.
        name: FileName,
        /// Its bytes.
        content: Vec<u8>,
    },
    /// The names of the files that were asked for. Ends the transaction.
    Listed {
        /// In the controller's order.
        names: Vec<String>,
    },
    /// A file is on its way.
    Progress {
        /// Bytes acknowledged so far.
        done_bytes: usize,
        /// Bytes in all, where that is known.
        total_bytes: Option<usize>,
    },
    /// Bytes that are no answer to anything open; they are dropped.
    Dropped {
        /// Why.
        reason: String,
        /// Whether they make no sense (rather than being late or foreign).
        malformed: bool,
    },
    /// The connection could not be opened, or was closed by the other side.
    Lost {
        /// Why.
        reason: String,
    },
}

/// Why a link cannot say a command. Nothing has been sent.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum Unsupported {
    /// Host control has no such command.
    #[error("host control has no command for: {0}")]
    Command(&'static str),
    /// One command carries one variable.
    #[error("host control reads and writes one variable a command, not {count}")]
    Several {
        /// How many were wanted.
        count: usize,
    },
    /// A value that the text cannot carry.
    #[error("host control cannot say {field} {value}")]
    Value {
        /// Of which field.
        field: &'static str,
        /// Which value.
        value: String,
    },
    /// Moves by joints in percent, straight ones in mm/s or deg/s.
    #[error("host control has no such speed class for this way of moving")]
    Speed,
    /// A link move must name the arm's configuration, and none has been read yet: ask for the position first.
    #[error("the arm's configuration is not known: read the position first")]
    UnknownForm,
    /// There is no wire any more.
    #[error("the serial line has ended: {0}")]
    Ended(String),
    /// A text with a byte that the command or the line gives another meaning.
    #[error("host control cannot carry this text: {0:?}")]
    Text(String),
}
