//! One frame that came.

use crate::camera::wire::{FLAG_ERROR, FLAG_LAST, FLAG_REPLY};
use crate::stamp::Stamp;
use std::fmt;

/// A frame of the server, its header and checksums believed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Heard {
    /// When it came.
    pub at: Stamp,
    /// Message type.
    pub kind: u16,
    /// The request it answers, or 0.
    pub request_id: u32,
    /// Flag bits.
    pub flags: u16,
    /// The payload.
    pub payload: Vec<u8>,
}

impl Heard {
    /// Whether it answers a request.
    pub fn is_reply(&self) -> bool {
        self.flags & FLAG_REPLY != 0
    }

    /// What is wrong with its flags and its request id (section 2 of the page), if anything.
    pub(super) fn oddity(&self) -> Option<&'static str> {
        let has = |flag: u16| self.flags & flag != 0;
        let reply_kind = matches!(self.kind, 0x02 | 0x04 | 0x11 | 0x14 | 0x15 | 0x21 | 0x34 | 0x61);
        let told_kind = matches!(self.kind, 0x22 | 0x30..=0x32 | 0x52 | 0x60 | 0x7F);
        [
            (reply_kind && !has(FLAG_REPLY), "a reply without flag bit 0"),
            (told_kind && has(FLAG_REPLY), "flag bit 0 on what is no reply"),
            (
                (self.kind == 0x70) != has(FLAG_ERROR),
                "flag bit 1 belongs to ERROR alone",
            ),
            (
                (self.kind == 0x32) != has(FLAG_LAST),
                "flag bit 2 belongs to FRAME_END alone",
            ),
            (has(FLAG_REPLY) && self.request_id == 0, "a reply to request 0"),
            (
                !has(FLAG_REPLY) && self.request_id != 0 && self.kind != 0x60,
                "an unsolicited frame with a request id",
            ),
            (self.kind == 0x60 && self.request_id == 0, "a PING with request id 0"),
        ]
        .into_iter()
        .find_map(|(odd, text)| odd.then_some(text))
    }
}

impl fmt::Display for Heard {
    /// Name, request, flags and the first bytes of the payload.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", message_name(self.kind))?;
        if self.request_id != 0 {
            write!(f, " to request {}", self.request_id)?;
        }
        write!(f, ", flags {:#05b}, {} bytes", self.flags, self.payload.len())?;
        if !self.payload.is_empty() {
            write!(f, ":")?;
        }
        for four in self.payload[..self.payload.len().min(SHOWN_BYTES)].chunks(4) {
            write!(f, " ")?;
            for byte in four {
                write!(f, "{byte:02x}")?;
            }
        }
        if self.payload.len() > SHOWN_BYTES {
            write!(f, " ...")?;
        }
        Ok(())
    }
}

/// The page's name of a type, or its number.
pub fn message_name(kind: u16) -> String {
    let known = NAMES.iter().find(|(known, _)| *known == kind);
    known.map_or_else(|| format!("type {kind:#06x}"), |(_, name)| (*name).to_owned())
}

const SHOWN_BYTES: usize = 48;
const NAMES: &[(u16, &str)] = &[
    (0x01, "HELLO"),
    (0x02, "HELLO_OK"),
    (0x03, "GET_CAPS"),
    (0x04, "CAPS"),
    (0x10, "CONFIGURE"),
    (0x11, "CONFIGURED"),
    (0x12, "ARM"),
    (0x13, "DISARM"),
    (0x14, "ARMED"),
    (0x15, "DISARMED"),
    (0x20, "TRIGGER"),
    (0x21, "TRIGGER_OK"),
    (0x22, "EXPOSURE_DONE"),
    (0x30, "FRAME_BEGIN"),
    (0x31, "FRAME_CHUNK"),
    (0x32, "FRAME_END"),
    (0x33, "FETCH"),
    (0x34, "FETCH_OK"),
    (0x40, "ABORT"),
    (0x41, "ABORTED"),
    (0x50, "GET_STATUS"),
    (0x51, "STATUS"),
    (0x52, "EVENT"),
    (0x60, "PING"),
    (0x61, "PONG"),
    (0x70, "ERROR"),
    (0x7F, "BYE"),
];
