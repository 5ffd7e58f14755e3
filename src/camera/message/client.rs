//! What the client sends.

use super::{TRIGGER_ALL, TriggerId};
use crate::camera::payload::put_str8;
use crate::camera::settings::CameraSettings;

/// What the client sends.
#[derive(Debug, Clone, PartialEq)]
pub enum ClientMessage {
    /// The greeting.
    Hello {
        /// Names the run; not 0.
        run_id: u64,
        /// Who we are.
        client_name: String,
    },
    /// Asks for the capabilities.
    GetCaps,
    /// The complete settings.
    Configure(CameraSettings),
    /// Arms for software triggers.
    Arm {
        /// The settings in force.
        config_id: u32,
    },
    /// Disarms.
    Disarm,
    /// Starts one acquisition.
    Trigger {
        /// Its name.
        trigger_id: TriggerId,
        /// The settings in force.
        config_id: u32,
        /// How long the frame is wanted, ms.
        deadline_ms: u32,
        /// For the server's log.
        tag: String,
    },
    /// Ends whatever acquisition is in flight.
    AbortAll,
    /// A sign of life.
    Ping {
        /// Our clock.
        sender_ns: u64,
    },
    /// Answers a PING.
    Pong {
        /// The server's clock, echoed.
        sender_ns: u64,
        /// Our clock.
        host_ns: u64,
    },
    /// Tells the server why we stop believing it.
    Error {
        /// The protocol's error code.
        code: u16,
        /// In words.
        text: String,
    },
    /// Goodbye.
    Bye {
        /// 1 done, 3 protocol error, 4 time-out.
        reason: u16,
        /// In words.
        text: String,
    },
}

impl ClientMessage {
    /// Type number and payload.
    pub fn encode(&self) -> (u16, Vec<u8>) {
        let mut payload = Vec::new();
        let kind = match self {
            Self::Hello { run_id, client_name } => {
                payload.extend_from_slice(&[1, 0, 1, 0, 1, 0, 0, 0]);
                payload.extend_from_slice(&run_id.to_le_bytes());
                put_str8(&mut payload, client_name);
                0x01
            }
            Self::GetCaps => 0x03,
            Self::Configure(settings) => {
                payload = settings.encode();
                0x10
            }
            Self::Arm { config_id } => {
                payload.extend_from_slice(&[1, 0, 0, 0]);
                payload.extend_from_slice(&config_id.to_le_bytes());
                0x12
            }
            Self::Disarm => 0x13,
            Self::Trigger {
                trigger_id,
                config_id,
                deadline_ms,
                tag,
            } => {
                payload.extend_from_slice(&trigger_id.0.to_le_bytes());
                payload.extend_from_slice(&trigger_id.view_index().to_le_bytes());
                payload.extend_from_slice(&config_id.to_le_bytes());
                payload.extend_from_slice(&deadline_ms.to_le_bytes());
                put_str8(&mut payload, tag);
                0x20
            }
            Self::AbortAll => {
                payload.extend_from_slice(&TRIGGER_ALL.to_le_bytes());
                0x40
            }
            Self::Ping { sender_ns } => {
                payload.extend_from_slice(&sender_ns.to_le_bytes());
                0x60
            }
            Self::Pong { sender_ns, host_ns } => {
                for value in [*sender_ns, 0, *host_ns] {
                    payload.extend_from_slice(&value.to_le_bytes());
                }
                0x61
            }
            Self::Error { code, text } => {
                payload.extend_from_slice(&0u32.to_le_bytes());
                payload.extend_from_slice(&TRIGGER_ALL.to_le_bytes());
                payload.extend_from_slice(&code.to_le_bytes());
                payload.extend_from_slice(&[0, 0]);
                payload.extend_from_slice(&[0; 8]);
                payload.extend_from_slice(&(text.len() as u16).to_le_bytes());
                payload.extend_from_slice(text.as_bytes());
                0x70
            }
            Self::Bye { reason, text } => {
                payload.extend_from_slice(&reason.to_le_bytes());
                put_str8(&mut payload, text);
                0x7F
            }
        };
        (kind, payload)
    }
}
