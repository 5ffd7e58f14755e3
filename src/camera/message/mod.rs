//! Messages: everything clients and servers say, read and written (section 4 of the page).

mod client;
mod frame;
mod replies;
mod report;
mod requests;
mod server;
#[cfg(test)]
mod tests;

pub use client::ClientMessage;
pub use frame::{
    Component, ComponentEnd, ComponentKind, ExposureDone, FrameBegin, FrameChunk, FrameEnd, FrameFlags, FrameStatus,
};
pub use replies::{Aborted, AcquisitionPhase, Caps, Configured, FetchOk, FetchState, Greeting, Repeated, TriggerOk};
pub use report::{Bye, CameraError, CameraState, CameraStatus, DeviceEvent, Pong};
pub use requests::{Arm, Hello, Trigger};
pub use server::{FRAME_BYTES_LIMIT, ServerMessage};

use super::payload::{Field, PayloadError, PayloadReader};
use serde::{Deserialize, Serialize};

/// Names one acquisition: `view_index << 16 | attempt`, so that a retake is another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct TriggerId(pub u64);

impl TriggerId {
    /// The id of an attempt at a view.
    pub fn new(view_index: u32, attempt: u16) -> Self {
        Self(u64::from(view_index) << 16 | u64::from(attempt))
    }

    /// Which view.
    pub fn view_index(self) -> u32 {
        (self.0 >> 16) as u32
    }

    /// Which attempt, from 0.
    pub fn attempt(self) -> u16 {
        self.0 as u16
    }
}

impl Field for TriggerId {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        Ok(Self(fields.field()?))
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.0.write(bytes);
    }
}

/// The id that stands for "none" and "all".
pub const TRIGGER_ALL: u64 = u64::MAX;

/// The name of a type of message, as the page has it (section 4).
pub fn message_name(kind: u16) -> &'static str {
    match kind {
        0x01 => "HELLO",
        0x02 => "HELLO_OK",
        0x03 => "GET_CAPS",
        0x04 => "CAPS",
        0x10 => "CONFIGURE",
        0x11 => "CONFIGURED",
        0x12 => "ARM",
        0x13 => "DISARM",
        0x14 => "ARMED",
        0x15 => "DISARMED",
        0x20 => "TRIGGER",
        0x21 => "TRIGGER_OK",
        0x22 => "EXPOSURE_DONE",
        0x30 => "FRAME_BEGIN",
        0x31 => "FRAME_CHUNK",
        0x32 => "FRAME_END",
        0x33 => "FETCH",
        0x34 => "FETCH_OK",
        0x40 => "ABORT",
        0x41 => "ABORTED",
        0x50 => "GET_STATUS",
        0x51 => "STATUS",
        0x52 => "EVENT",
        0x60 => "PING",
        0x61 => "PONG",
        0x70 => "ERROR",
        0x7F => "BYE",
        _ => "unknown type",
    }
}
