//! HSES frames: bytes to fields and back (`docs/protocols/hses.md`, section 1).

use thiserror::Error;

/// Bytes before the data of every frame.
pub const HEADER_BYTES: usize = 32;
/// The most data bytes one frame carries.
pub const DATA_BYTES_MAX: usize = 479;

const IDENTIFIER: &[u8; 4] = b"YERC";
const RESERVE_2: &[u8; 8] = b"99999999";
const ROBOT_DIVISION: u8 = 1;
const ANSWER_BLOCK: u32 = 0x8000_0000;

/// What a request asks the controller to do with an attribute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Service {
    /// Get all attributes.
    GetAll = 0x01,
    /// Set all attributes.
    SetAll = 0x02,
    /// Get one attribute.
    GetOne = 0x0E,
    /// Set one attribute.
    SetOne = 0x10,
    /// Read several in a row.
    ReadMany = 0x33,
    /// Write several in a row.
    WriteMany = 0x34,
}

/// One request to the robot control port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    /// Chosen by us, repeated in the answer.
    pub id: u8,
    /// Which command.
    pub command: u16,
    /// Which instance of it.
    pub instance: u16,
    /// Which attribute; 0 for "all".
    pub attribute: u8,
    /// What to do.
    pub service: Service,
    /// At most [`DATA_BYTES_MAX`] bytes.
    pub data: Vec<u8>,
}

/// One answer from the robot control port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// The id of the request it answers.
    pub id: u8,
    /// The service of the request (without the answer bit).
    pub service: u8,
    /// 0 when the request was carried out.
    pub status: u8,
    /// Why not, when `status` is not 0.
    pub added_status: u16,
    /// The data.
    pub data: Vec<u8>,
}

/// Why a datagram is not an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum WireError {
    /// Shorter than a header.
    #[error("{0} bytes are too few for a header of 32")]
    Short(usize),
    /// The first four bytes are not YERC.
    #[error("the identifier is not YERC")]
    Identifier,
    /// The header's length field is not 32.
    #[error("header size {0} instead of 32")]
    HeaderSize(u16),
    /// The data size field and the datagram disagree.
    #[error("data size field says {stated}, the datagram has {found}")]
    DataSize {
        /// What the field says.
        stated: u16,
        /// What follows the header.
        found: usize,
    },
    /// Not a robot-division answer frame.
    #[error("not an answer of the robot division (division {division}, ACK {ack}, service {service:#04x})")]
    NotAnAnswer {
        /// Byte 9.
        division: u8,
        /// Byte 10.
        ack: u8,
        /// Byte 24.
        service: u8,
    },
}

impl Request {
    /// The datagram.
    pub fn encode(&self) -> Vec<u8> {
        debug_assert!(self.data.len() <= DATA_BYTES_MAX);
        let mut bytes = Vec::with_capacity(HEADER_BYTES + self.data.len());
        bytes.extend_from_slice(IDENTIFIER);
        bytes.extend_from_slice(&(HEADER_BYTES as u16).to_le_bytes());
        bytes.extend_from_slice(&(self.data.len() as u16).to_le_bytes());
        bytes.extend_from_slice(&[3, ROBOT_DIVISION, 0, self.id]);
        bytes.extend_from_slice(&0u32.to_le_bytes());
        bytes.extend_from_slice(RESERVE_2);
        bytes.extend_from_slice(&self.command.to_le_bytes());
        bytes.extend_from_slice(&self.instance.to_le_bytes());
        bytes.extend_from_slice(&[self.attribute, self.service as u8, 0, 0]);
        bytes.extend_from_slice(&self.data);
        bytes
    }
}

impl Answer {
    /// Reads a datagram. The added status is read whenever the status is not 0, whatever its size byte says.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        if bytes.len() < HEADER_BYTES {
            return Err(WireError::Short(bytes.len()));
        }
        if &bytes[0..4] != IDENTIFIER {
            return Err(WireError::Identifier);
        }
        let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        if usize::from(u16_at(4)) != HEADER_BYTES {
            return Err(WireError::HeaderSize(u16_at(4)));
        }
        let found = bytes.len() - HEADER_BYTES;
        if usize::from(u16_at(6)) != found || found > DATA_BYTES_MAX {
            return Err(WireError::DataSize {
                stated: u16_at(6),
                found,
            });
        }
        let block = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]);
        let (division, ack, service) = (bytes[9], bytes[10], bytes[24]);
        if division != ROBOT_DIVISION || ack != 1 || service & 0x80 == 0 || block != ANSWER_BLOCK {
            return Err(WireError::NotAnAnswer { division, ack, service });
        }
        let status = bytes[25];
        Ok(Self {
            id: bytes[11],
            service: service & 0x7F,
            status,
            added_status: if status == 0 { 0 } else { u16_at(28) },
            data: bytes[HEADER_BYTES..].to_vec(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::hses;

    #[test]
    fn answers_of_the_page_decode() {
        let ready = Answer::decode(&hses("ans_status_ready")).unwrap();
        assert_eq!((ready.id, ready.service, ready.status), (1, 0x01, 0));
        assert_eq!(ready.data, [0xC4, 0, 0, 0, 0x40, 0, 0, 0]);
        let refused = Answer::decode(&hses("ans_move_refused_2010")).unwrap();
        assert_eq!((refused.status, refused.added_status), (0x1F, 0x2010));
        let undefined = Answer::decode(&hses("ans_undefined_command")).unwrap();
        assert_eq!(undefined.status, 0x08);
    }

    #[test]
    fn every_cut_and_every_flipped_header_byte_that_matters_is_refused() {
        let good = hses("ans_status_ready");
        for length in 0..good.len() {
            assert!(Answer::decode(&good[..length]).is_err(), "cut to {length}");
        }
        for at in [0, 4, 6, 9, 10, 15, 24] {
            let mut bad = good.clone();
            bad[at] ^= 0x80;
            assert!(Answer::decode(&bad).is_err(), "byte {at} flipped");
        }
    }
}
