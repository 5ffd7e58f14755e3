//! What the conversation wants done and what it reports.

use crate::camera::capture::Capture;
use crate::camera::message::{CameraError, CameraStatus, Caps, Configured, Greeting, TriggerId};
use std::sync::Arc;

/// Times of the conversation, ms (section 3 of the page).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExchangeSettings {
    /// TCP connect.
    pub connect_timeout_ms: u64,
    /// Any request but TRIGGER.
    pub reply_timeout_ms: u64,
    /// Beyond what the camera predicts and the transfer takes at 20 MB/s.
    pub frame_timeout_extra_ms: u64,
    /// Between two signs of life of ours.
    pub ping_interval_ms: u64,
    /// Without any byte from the camera.
    pub dead_after_ms: u64,
}

/// What the shell must do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraOutput {
    /// Open the TCP connection.
    Connect,
    /// Send these bytes.
    Bytes {
        /// What to send.
        bytes: Vec<u8>,
        /// Whether they start an exposure: then the record of what caused them is flushed first.
        act: bool,
    },
    /// Close the connection after what was sent.
    Close,
}

/// What came of it.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraEvent {
    /// Greeted, configured and armed.
    Ready(Box<Opened>),
    /// The exposure is over: the robot may move.
    ExposureDone {
        /// Of which acquisition.
        trigger_id: TriggerId,
    },
    /// A complete frame.
    Frame(Arc<Capture>),
    /// This acquisition gave no frame; the connection lives.
    Failed {
        /// Which acquisition.
        trigger_id: TriggerId,
        /// Why, in words.
        reason: String,
        /// Whether another attempt may help.
        retryable: bool,
    },
    /// Its condition, once a second.
    Status(CameraStatus),
    /// Something worth recording that changes nothing.
    Note(String),
    /// The connection is over, or of no use.
    Lost(Trouble),
    /// It is over because we said goodbye.
    Left,
}

/// What the opening has shown.
#[derive(Debug, Clone, PartialEq)]
pub struct Opened {
    /// Who it is.
    pub greeting: Greeting,
    /// What it can do.
    pub caps: Caps,
    /// What is in force.
    pub configured: Configured,
}

/// Why the camera cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Trouble {
    /// No connection came about.
    Unreachable(String),
    /// The connection ended without goodbye.
    Closed(String),
    /// Nothing heard for too long, or no reply to a request.
    Silent(String),
    /// The other side broke the protocol.
    Protocol(String),
    /// The settings in force are not those we asked for.
    Echo(String),
    /// The camera refused the session, the settings or to be armed.
    Refused(CameraError),
}
