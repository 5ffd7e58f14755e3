//! What either side says by itself: condition, events, errors, signs of life, goodbye.

use crate::camera::payload::{Field, PayloadError, PayloadReader, payload_codes, payload_struct, put_str16};
use serde::{Deserialize, Serialize};

payload_codes! {
    /// States of the server (3.1).
    CameraState, "a state" {
        /// No device is connected to the bridge.
        Offline = 0,
        /// Nothing is armed.
        Idle = 1,
        /// A trigger is taken.
        Armed = 2,
        /// Patterns are projected: the part must not move.
        Exposing = 3,
        /// Points are computed: the part may move.
        Reconstructing = 4,
        /// The frame is on its way.
        Sending = 5,
        /// The device does not work and will not by itself.
        Fault = 6,
        /// The device starts anew; it comes back without settings.
        Resetting = 7,
    }
}

payload_struct! {
    /// The camera's condition: STATUS (4.13).
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    CameraStatus {
        /// What it does.
        state: CameraState;
        /// Triggers accepted and not done.
        queue_count: u8, pad 2;
        /// Projector, camera 1, camera 2, board; `None` if unknown.
        temperature_c: [Option<f32>; 4];
        /// How long it has been warming up, s.
        warm_up_done_s: u32;
        /// How long it should, s.
        warm_up_required_s: u32;
        /// Triggers accepted since the bridge started.
        trigger_count: u32;
        /// Frames completed since then.
        frame_count: u32;
        /// Triggers missed since then.
        missed_count: u32;
        /// Time-outs of the vendor's software since then.
        vendor_timeout_count: u32;
        /// Packets lost between camera and bridge since then.
        lost_packet_count: u32;
        /// Speed of that link, Mbit/s.
        link_mbit_s: u32;
        /// Code of the last error; 0 = none.
        last_error: u16, pad 2;
    }
}

/// Something happened: EVENT (4.14).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceEvent {
    /// What: a constant of this type.
    pub code: u16,
    /// The acquisition it is about, or [`super::TRIGGER_ALL`].
    pub trigger_id: u64,
    /// Device clock, ns.
    pub device_ns: u64,
    /// How long a pause or a reset lasts, ms; 0 = unknown.
    pub duration_ms: u32,
    /// In words.
    pub text: String,
}

impl DeviceEvent {
    /// A trigger was missed.
    pub const MISSED_TRIGGER: u16 = 1;
    /// The device is too hot.
    pub const OVER_TEMPERATURE: u16 = 2;
    /// The device is gone, or starts anew.
    pub const DEVICE_LOST: u16 = 3;
    /// The device is back.
    pub const DEVICE_BACK: u16 = 4;
    /// The device pauses to cool down.
    pub const COOLDOWN_PAUSE: u16 = 5;
    /// Other settings are in force.
    pub const CONFIG_CHANGED: u16 = 6;
}

impl Field for DeviceEvent {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        let code = fields.field()?;
        fields.reserved(2)?;
        Ok(Self {
            code,
            trigger_id: fields.field()?,
            device_ns: fields.field()?,
            duration_ms: fields.field()?,
            text: fields.str16()?,
        })
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.code.write(bytes);
        bytes.extend_from_slice(&[0; 2]);
        self.trigger_id.write(bytes);
        self.device_ns.write(bytes);
        self.duration_ms.write(bytes);
        put_str16(bytes, &self.text, TEXT_BYTES_MAX);
    }
}

/// Something went wrong: ERROR (4.15).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraError {
    /// The request it refuses, or 0.
    pub about_request_id: u32,
    /// The acquisition it ends, or [`super::TRIGGER_ALL`].
    pub trigger_id: u64,
    /// Code of section 6, see [`crate::camera::code`].
    pub code: u16,
    /// Where the acquisition was.
    pub phase: super::AcquisitionPhase,
    /// Trying again may help.
    pub retryable: bool,
    /// After so long, ms; 0 = at once.
    pub retry_after_ms: u32,
    /// The vendor's own number; 0 = none.
    pub vendor_code: i32,
    /// In words; at most 512 bytes.
    pub text: String,
}

impl Field for CameraError {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        let error = Self {
            about_request_id: fields.field()?,
            trigger_id: fields.field()?,
            code: fields.field()?,
            phase: fields.field()?,
            retryable: fields.field()?,
            retry_after_ms: fields.field()?,
            vendor_code: fields.field()?,
            text: fields.str16()?,
        };
        if error.text.len() > usize::from(TEXT_BYTES_MAX) {
            return Err(PayloadError::Value {
                field: "the length of an error's text",
                value: error.text.len() as u64,
            });
        }
        Ok(error)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.about_request_id.write(bytes);
        self.trigger_id.write(bytes);
        self.code.write(bytes);
        self.phase.write(bytes);
        self.retryable.write(bytes);
        self.retry_after_ms.write(bytes);
        self.vendor_code.write(bytes);
        put_str16(bytes, &self.text, TEXT_BYTES_MAX);
    }
}

payload_struct! {
    /// The answer to a PING.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    Pong {
        /// The asker's clock, echoed.
        sender_ns: u64;
        /// The device's clock; 0 from a client.
        device_ns: u64;
        /// The answerer's own clock.
        host_ns: u64;
    }
}

payload_struct! {
    /// Goodbye.
    #[derive(Debug, Clone, PartialEq, Eq)]
    Bye {
        /// Why: a constant of this type.
        reason: u16;
        /// In words.
        text: String;
    }
}

impl Bye {
    /// The work is done.
    pub const DONE: u16 = 1;
    /// The server shuts down.
    pub const SHUTTING_DOWN: u16 = 2;
    /// The other side broke the protocol.
    pub const PROTOCOL: u16 = 3;
    /// The other side was silent.
    pub const TIMEOUT: u16 = 4;
    /// The role is taken.
    pub const REFUSED: u16 = 5;
    /// Another connection of the same run took the place.
    pub const REPLACED: u16 = 6;
}

/// The longest text of an error or an event.
const TEXT_BYTES_MAX: u16 = 512;
