//! Everything a server says.

use super::{
    Aborted, Bye, CameraError, CameraState, CameraStatus, Caps, Configured, DeviceEvent, ExposureDone, FetchOk,
    FrameBegin, FrameChunk, FrameEnd, Greeting, Pong, TriggerOk,
};
use crate::camera::payload::{Field, PayloadError, PayloadReader};

/// What a server says. The bytes of a chunk stay where they are.
#[derive(Debug, Clone, PartialEq)]
pub enum ServerMessage<'a> {
    /// Greeting accepted.
    HelloOk(Greeting),
    /// Capabilities.
    Caps(Caps),
    /// Settings in force.
    Configured(Configured),
    /// Armed.
    Armed {
        /// The state now.
        state: CameraState,
    },
    /// Disarmed.
    Disarmed {
        /// The state now.
        state: CameraState,
    },
    /// Trigger accepted, or known already.
    TriggerOk(TriggerOk),
    /// The part may move.
    ExposureDone(ExposureDone),
    /// A frame begins.
    FrameBegin(Box<FrameBegin>),
    /// A piece of it.
    FrameChunk(FrameChunk<'a>),
    /// A frame ends.
    FrameEnd(FrameEnd),
    /// A frame asked for is there or on its way.
    FetchOk(FetchOk),
    /// An acquisition was aborted.
    Aborted(Aborted),
    /// The camera's condition.
    Status(CameraStatus),
    /// Something happened.
    Event(DeviceEvent),
    /// The server wants a sign of life.
    Ping {
        /// Its clock.
        sender_ns: u64,
    },
    /// Answers a PING.
    Pong(Pong),
    /// Something went wrong.
    Error(CameraError),
    /// The server leaves.
    Bye(Bye),
}

impl<'a> ServerMessage<'a> {
    /// Type number.
    pub fn kind(&self) -> u16 {
        match self {
            Self::HelloOk(_) => 0x02,
            Self::Caps(_) => 0x04,
            Self::Configured(_) => 0x11,
            Self::Armed { .. } => 0x14,
            Self::Disarmed { .. } => 0x15,
            Self::TriggerOk(_) => 0x21,
            Self::ExposureDone(_) => 0x22,
            Self::FrameBegin(_) => 0x30,
            Self::FrameChunk(_) => 0x31,
            Self::FrameEnd(_) => 0x32,
            Self::FetchOk(_) => 0x34,
            Self::Aborted(_) => 0x41,
            Self::Status(_) => 0x51,
            Self::Event(_) => 0x52,
            Self::Ping { .. } => 0x60,
            Self::Pong(_) => 0x61,
            Self::Error(_) => 0x70,
            Self::Bye(_) => 0x7F,
        }
    }

    /// Appends the payload.
    pub fn encode(&self, payload: &mut Vec<u8>) {
        match self {
            Self::HelloOk(greeting) => greeting.write(payload),
            Self::Caps(caps) => caps.write(payload),
            Self::Configured(configured) => configured.write(payload),
            Self::Armed { state } | Self::Disarmed { state } => {
                state.write(payload);
                payload.extend_from_slice(&[0; 3]);
            }
            Self::TriggerOk(accepted) => accepted.write(payload),
            Self::ExposureDone(done) => done.write(payload),
            Self::FrameBegin(begin) => begin.write(payload),
            Self::FrameChunk(chunk) => chunk.write(payload),
            Self::FrameEnd(end) => end.write(payload),
            Self::FetchOk(found) => found.write(payload),
            Self::Aborted(aborted) => aborted.write(payload),
            Self::Status(status) => status.write(payload),
            Self::Event(event) => event.write(payload),
            Self::Ping { sender_ns } => sender_ns.write(payload),
            Self::Pong(pong) => pong.write(payload),
            Self::Error(error) => error.write(payload),
            Self::Bye(bye) => bye.write(payload),
        }
    }

    /// Reads a message; `Ok(None)` for a type that no server says.
    pub fn decode(kind: u16, payload: &'a [u8]) -> Result<Option<Self>, PayloadError> {
        let mut fields = PayloadReader::new(payload);
        let message = match kind {
            0x02 => Self::HelloOk(greeting(&mut fields)?),
            0x04 => Self::Caps(fields.field()?),
            0x11 => Self::Configured(fields.field()?),
            0x14 => Self::Armed {
                state: state(&mut fields)?,
            },
            0x15 => Self::Disarmed {
                state: state(&mut fields)?,
            },
            0x21 => Self::TriggerOk(fields.field()?),
            0x22 => Self::ExposureDone(fields.field()?),
            0x30 => Self::FrameBegin(Box::new(fields.field()?)),
            0x31 => Self::FrameChunk(FrameChunk::read(&mut fields)?),
            0x32 => Self::FrameEnd(fields.field()?),
            0x34 => Self::FetchOk(fields.field()?),
            0x41 => Self::Aborted(fields.field()?),
            0x51 => Self::Status(fields.field()?),
            0x52 => Self::Event(fields.field()?),
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

fn greeting(fields: &mut PayloadReader<'_>) -> Result<Greeting, PayloadError> {
    let greeting: Greeting = fields.field()?;
    let [major, minor] = greeting.version;
    if greeting.version != [1, 0] {
        return Err(PayloadError::Value {
            field: "the version (major * 256 + minor)",
            value: u64::from(major) * 256 + u64::from(minor),
        });
    }
    if greeting.frame_bytes_max > FRAME_BYTES_LIMIT {
        return Err(PayloadError::Value {
            field: "frame_bytes_max",
            value: greeting.frame_bytes_max,
        });
    }
    Ok(greeting)
}

fn state(fields: &mut PayloadReader<'_>) -> Result<CameraState, PayloadError> {
    let state = fields.field()?;
    fields.reserved(3)?;
    Ok(state)
}

/// No frame is larger than this.
pub const FRAME_BYTES_LIMIT: u64 = 64 << 20;
