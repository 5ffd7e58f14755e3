//! Everything a client says.

use super::{Arm, Bye, CameraError, Hello, Pong, Trigger, TriggerId};
use crate::camera::payload::{Field, PayloadError, PayloadReader};
use crate::camera::settings::CameraSettings;

/// What a client says.
#[derive(Debug, Clone, PartialEq)]
pub enum ClientMessage {
    /// The greeting.
    Hello(Hello),
    /// Asks for the capabilities.
    GetCaps,
    /// The complete settings.
    Configure(CameraSettings),
    /// Arms.
    Arm(Arm),
    /// Disarms.
    Disarm,
    /// Starts one acquisition.
    Trigger(Trigger),
    /// Asks for the frame of an acquisition that was triggered before.
    Fetch {
        /// Which acquisition.
        trigger_id: TriggerId,
    },
    /// Ends an acquisition.
    Abort {
        /// Which, or [`super::TRIGGER_ALL`].
        trigger_id: u64,
    },
    /// Asks for the condition.
    GetStatus,
    /// A sign of life.
    Ping {
        /// The client's clock.
        sender_ns: u64,
    },
    /// Answers a PING.
    Pong(Pong),
    /// Tells the server why it is no longer believed.
    Error(CameraError),
    /// Goodbye.
    Bye(Bye),
}

impl ClientMessage {
    /// Type number.
    pub fn kind(&self) -> u16 {
        match self {
            Self::Hello(_) => 0x01,
            Self::GetCaps => 0x03,
            Self::Configure(_) => 0x10,
            Self::Arm(_) => 0x12,
            Self::Disarm => 0x13,
            Self::Trigger(_) => 0x20,
            Self::Fetch { .. } => 0x33,
            Self::Abort { .. } => 0x40,
            Self::GetStatus => 0x50,
            Self::Ping { .. } => 0x60,
            Self::Pong(_) => 0x61,
            Self::Error(_) => 0x70,
            Self::Bye(_) => 0x7F,
        }
    }

    /// Appends the payload.
    pub fn encode(&self, payload: &mut Vec<u8>) {
        match self {
            Self::Hello(hello) => hello.write(payload),
            Self::GetCaps | Self::Disarm | Self::GetStatus => {}
            Self::Configure(settings) => payload.extend_from_slice(&settings.encode()),
            Self::Arm(arm) => arm.write(payload),
            Self::Trigger(trigger) => trigger.write(payload),
            Self::Fetch { trigger_id } => trigger_id.write(payload),
            Self::Abort { trigger_id } => trigger_id.write(payload),
            Self::Ping { sender_ns } => sender_ns.write(payload),
            Self::Pong(pong) => pong.write(payload),
            Self::Error(error) => error.write(payload),
            Self::Bye(bye) => bye.write(payload),
        }
    }

    /// Reads a message; `Ok(None)` for a type that no client says. [`PayloadError::Settings`] leaves the connection
    /// as it is, any other error ends it.
    pub fn decode(kind: u16, payload: &[u8]) -> Result<Option<Self>, PayloadError> {
        let mut fields = PayloadReader::new(payload);
        let message = match kind {
            0x01 => Self::Hello(fields.field()?),
            0x03 => Self::GetCaps,
            0x10 => Self::Configure(CameraSettings::decode(fields.rest())?),
            0x12 => Self::Arm(fields.field()?),
            0x13 => Self::Disarm,
            0x20 => Self::Trigger(fields.field()?),
            0x33 => Self::Fetch {
                trigger_id: fields.field()?,
            },
            0x40 => Self::Abort {
                trigger_id: fields.field()?,
            },
            0x50 => Self::GetStatus,
            0x60 => Self::Ping {
                sender_ns: fields.field()?,
            },
            0x61 => Self::Pong(fields.field()?),
            0x70 => Self::Error(fields.field()?),
            0x7F => Self::Bye(fields.field()?),
            _ => return Ok(None),
        };
        fields.end()?;
        Ok(Some(message))
    }
}
