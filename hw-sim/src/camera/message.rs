//! A3DP messages by type (`docs/protocols/camera.md`, section 4).

use thiserror::Error;

use crate::camera::fields::{Field, FieldError, Rest, Zero};
pub use crate::camera::payload::*;

/// Payload of a message.
#[derive(Clone, Debug, PartialEq)]
#[allow(
    missing_docs,
    reason = "each variant is the message of its name on the protocol page"
)]
pub enum Message {
    Hello(Hello),
    HelloOk(HelloOk),
    GetCaps,
    Caps(Caps),
    /// Tag-length-value records, not read yet.
    Configure(Rest),
    Configured(Configured),
    Arm(Arm),
    Disarm,
    Armed(StateNow),
    Disarmed(StateNow),
    Trigger(Trigger),
    TriggerOk(TriggerOk),
    ExposureDone(ExposureDone),
    FrameBegin(FrameBegin),
    FrameChunk(FrameChunk),
    FrameEnd(FrameEnd),
    /// Trigger id.
    Fetch(u64),
    FetchOk(FetchOk),
    /// Trigger id, or [`NO_TRIGGER`] for all.
    Abort(u64),
    Aborted(Aborted),
    GetStatus,
    Status(Status),
    Event(Event),
    /// Clock of the sender, ns.
    Ping(u64),
    Pong(Pong),
    Error(ErrorReport),
    Bye(Bye),
}

/// Why a believed frame is no message.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum MessageError {
    /// No message has this type.
    #[error("type {0:#06x} is not known")]
    UnknownType(u16),
    /// The payload is not that of the type.
    #[error("type {kind:#06x}: {cause}")]
    Payload {
        /// Message type.
        kind: u16,
        /// What is wrong.
        cause: FieldError,
    },
}

/// Generates reading and writing from one table, so that neither can know a type that the other does not.
macro_rules! message_table {
    ($($kind:literal => $name:ident $(($field:ident))?,)*) => {
        impl Message {
            /// Reads the payload of a message type.
            pub fn read(kind: u16, payload: &[u8]) -> Result<Self, MessageError> {
                match kind {
                    $($kind => {
                        message_table!(@read $name payload $($field)?)
                            .map_err(|cause| MessageError::Payload { kind, cause })
                    })*
                    _ => Err(MessageError::UnknownType(kind)),
                }
            }

            /// Message type.
            pub fn kind(&self) -> u16 {
                match self { $(message_table!(@pattern $name _ignored $($field)?) => $kind,)* }
            }

            /// Bytes of the payload.
            pub fn to_payload(&self) -> Vec<u8> {
                match self { $(message_table!(@bind $name $($field)?) => message_table!(@write $($field)?),)* }
            }
        }
    };
    (@read $name:ident $payload:ident) => { Empty::read_whole($payload).map(|_| Self::$name) };
    (@read $name:ident $payload:ident $field:ident) => { Field::read_whole($payload).map(Self::$name) };
    (@pattern $name:ident $ignored:ident) => { Self::$name };
    (@pattern $name:ident $ignored:ident $field:ident) => { Self::$name(_) };
    (@bind $name:ident) => { Self::$name };
    (@bind $name:ident $field:ident) => { Self::$name($field) };
    (@write) => { Vec::new() };
    (@write $field:ident) => { Field::to_payload($field) };
}

type Empty = Zero<0>;

message_table! {
    0x0001 => Hello(payload),
    0x0002 => HelloOk(payload),
    0x0003 => GetCaps,
    0x0004 => Caps(payload),
    0x0010 => Configure(payload),
    0x0011 => Configured(payload),
    0x0012 => Arm(payload),
    0x0013 => Disarm,
    0x0014 => Armed(payload),
    0x0015 => Disarmed(payload),
    0x0020 => Trigger(payload),
    0x0021 => TriggerOk(payload),
    0x0022 => ExposureDone(payload),
    0x0030 => FrameBegin(payload),
    0x0031 => FrameChunk(payload),
    0x0032 => FrameEnd(payload),
    0x0033 => Fetch(payload),
    0x0034 => FetchOk(payload),
    0x0040 => Abort(payload),
    0x0041 => Aborted(payload),
    0x0050 => GetStatus,
    0x0051 => Status(payload),
    0x0052 => Event(payload),
    0x0060 => Ping(payload),
    0x0061 => Pong(payload),
    0x0070 => Error(payload),
    0x007F => Bye(payload),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::{CAMERA_PAGE, all, vector};

    #[test]
    fn every_message_of_the_page_is_read_and_written_byte_for_byte() {
        let vectors = all(CAMERA_PAGE);
        assert_eq!(vectors.len(), 29);
        for (name, bytes) in vectors {
            let kind = u16::from_le_bytes([bytes[6], bytes[7]]);
            let message = Message::read(kind, &bytes[32..]).unwrap();
            assert_eq!(message.kind(), kind, "{name}");
            assert_eq!(message.to_payload(), bytes[32..], "{name}");
        }
    }

    #[test]
    fn a_longer_or_a_shorter_payload_is_malformed() {
        for name in ["hello", "get_caps", "arm", "trigger", "abort", "ping", "bye"] {
            let bytes = vector(CAMERA_PAGE, name);
            let kind = u16::from_le_bytes([bytes[6], bytes[7]]);
            let mut payload = bytes[32..].to_vec();
            payload.push(0);
            let malformed = Err(MessageError::Payload {
                kind,
                cause: FieldError::Malformed,
            });
            assert_eq!(Message::read(kind, &payload), malformed, "{name}");
            if payload.len() > 1 {
                assert_eq!(Message::read(kind, &payload[..payload.len() - 2]), malformed, "{name}");
            }
        }
    }

    #[test]
    fn the_fields_of_a_trigger_stand_where_the_page_says() {
        let bytes = vector(CAMERA_PAGE, "trigger");
        let Message::Trigger(trigger) = Message::read(0x20, &bytes[32..]).unwrap() else {
            panic!()
        };
        assert_eq!(
            (trigger.trigger_id, trigger.view_id, trigger.config_id),
            (5 << 16 | 1, 5, 77)
        );
        assert_eq!((trigger.deadline_ms, trigger.tag.0.as_str()), (15_000, "view 5"));
    }
}
