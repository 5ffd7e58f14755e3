//! What the conversation wants done and what it reports.

use super::clock::ClockEstimate;
use crate::camera::capture::Capture;
use crate::camera::message::{CameraError, CameraStatus, Caps, Configured, Greeting, TriggerId};
use crate::stamp::Stamp;
use std::fmt;
use std::sync::Arc;

/// Times of the conversation, ms (section 3.7 of the page).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExchangeSettings {
    /// TCP connect.
    pub connect_timeout_ms: u64,
    /// Any request but TRIGGER.
    pub reply_timeout_ms: u64,
    /// Beyond one and a half times what the camera predicts, and the transfer at 20 MB/s.
    pub frame_timeout_extra_ms: u64,
    /// Between two signs of life of ours.
    pub ping_interval_ms: u64,
    /// Without any byte from the camera.
    pub dead_after_ms: u64,
    /// How long a lost connection is tried again.
    pub reconnect_timeout_ms: u64,
    /// How long a camera that is too hot or in use by another program is waited for.
    pub device_timeout_ms: u64,
}

/// What the shell must do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraOutput {
    /// Open a TCP connection. Nothing that comes from an older one is handed over any more.
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
    /// Greeted, configured and armed for the first time.
    Ready(Box<Opened>),
    /// The exposure is over: the robot may move.
    ExposureDone {
        /// Of which acquisition.
        trigger_id: TriggerId,
        /// When it was over by the camera's clock, in the run's time; `None` before the clocks were compared.
        ended: Option<Stamp>,
    },
    /// A complete frame.
    Frame(Arc<Capture>),
    /// The frame of this acquisition, which is on its way, was taken before the camera was warm.
    Cold {
        /// Which acquisition.
        trigger_id: TriggerId,
    },
    /// The device could not take this trigger. Nothing was exposed; once armed again, the same may be triggered again.
    TriggerRefused {
        /// Which acquisition.
        trigger_id: TriggerId,
        /// Why, in words.
        reason: String,
    },
    /// This acquisition gave no frame; the conversation goes on.
    Failed {
        /// Which acquisition.
        trigger_id: TriggerId,
        /// Why, in words.
        reason: String,
        /// Whether another attempt may help.
        retryable: bool,
        /// The camera's error code, where it sent one.
        code: Option<u16>,
    },
    /// The connection is lost and being opened again.
    Away {
        /// Why.
        reason: String,
        /// How long that is tried.
        within_ms: u64,
    },
    /// The connection stands again.
    Back {
        /// How long it was gone.
        away_ms: u64,
        /// Whether the bridge was started anew meanwhile: then what was open is lost.
        restarted: bool,
        /// The acquisition whose frame is asked for.
        fetched: Option<TriggerId>,
    },
    /// The bridge answers, but its camera cannot be used at the moment.
    Waiting {
        /// Why.
        reason: String,
        /// How long it is waited for.
        within_ms: u64,
    },
    /// After waiting or an outage: armed again.
    Rearmed,
    /// Its condition, once a second.
    Status(CameraStatus),
    /// How its clock stands to the run's.
    Clock(ClockEstimate),
    /// Something worth recording that changes nothing.
    Note(String),
    /// The camera is given up.
    Lost(Trouble),
    /// The connection is over because we said goodbye.
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
    /// The connection ended.
    Closed(String),
    /// Nothing heard for too long, or no reply to a request.
    Silent(String),
    /// The other side broke the protocol.
    Protocol(String),
    /// The settings in force are not those we asked for, or the camera does not offer them.
    Settings(String),
    /// The camera refused the session, the settings or to be armed.
    Refused(CameraError),
    /// Another connection has taken this one's place.
    Replaced(String),
    /// After a lost connection, another camera answered.
    Another(String),
    /// The bridge answers, but its camera could not be used for too long, or needs a person.
    NotReady(String),
}

impl Trouble {
    /// Whether opening the connection again may help.
    pub(super) fn may_pass(&self) -> bool {
        match self {
            Self::Unreachable(_) | Self::Closed(_) | Self::Silent(_) | Self::Protocol(_) => true,
            Self::Refused(error) => error.code == crate::camera::code::CONTROLLER_BUSY,
            Self::Settings(_) | Self::Replaced(_) | Self::Another(_) | Self::NotReady(_) => false,
        }
    }

    /// The same trouble with more to say about it.
    pub(super) fn with(self, more: &str) -> Self {
        match self {
            Self::Unreachable(seen) => Self::Unreachable(seen + more),
            Self::Closed(seen) => Self::Closed(seen + more),
            Self::Silent(seen) => Self::Silent(seen + more),
            Self::Protocol(seen) => Self::Protocol(seen + more),
            Self::Settings(seen) => Self::Settings(seen + more),
            Self::Replaced(seen) => Self::Replaced(seen + more),
            Self::Another(seen) => Self::Another(seen + more),
            Self::NotReady(seen) => Self::NotReady(seen + more),
            Self::Refused(error) => Self::Refused(CameraError {
                text: error.text + more,
                ..error
            }),
        }
    }
}

impl fmt::Display for Trouble {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable(seen)
            | Self::Closed(seen)
            | Self::Silent(seen)
            | Self::Protocol(seen)
            | Self::Settings(seen)
            | Self::Replaced(seen)
            | Self::Another(seen)
            | Self::NotReady(seen) => out.write_str(seen),
            Self::Refused(error) => write!(out, "camera error {}: {}", error.code, error.text),
        }
    }
}
