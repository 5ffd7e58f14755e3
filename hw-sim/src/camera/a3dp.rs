//! A3DP frames: 32 bytes of header and a payload (`docs/protocols/camera.md`, section 2).

use thiserror::Error;

/// A frame whose header and payload are believed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawFrame {
    /// Message type.
    pub kind: u16,
    /// 0 = unsolicited.
    pub request_id: u32,
    /// Count of the frame in its direction.
    pub seq: u32,
    /// [`FLAG_REPLY`], [`FLAG_ERROR`], [`FLAG_LAST`].
    pub flags: u16,
    /// Fields of the message.
    pub payload: Vec<u8>,
}

/// Why a connection cannot go on. Each has its code of section 6.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum ProtocolError {
    /// The stream does not stand at a frame.
    #[error("no magic at the start of a frame")]
    Magic,
    /// The header is damaged.
    #[error("the header's CRC does not agree")]
    HeaderCrc,
    /// Another major version.
    #[error("major version {0} is not spoken")]
    Major(u8),
    /// Another size of header.
    #[error("a header of {0} bytes is not known")]
    HeaderLength(u8),
    /// Reserved bytes or unknown flags are set.
    #[error("reserved bytes or unknown flags are not 0")]
    Reserved,
    /// More than the message may have.
    #[error("a payload of {0} bytes is too long")]
    PayloadTooLong(u32),
    /// A frame is missing or came twice.
    #[error("frame {found} came where {expected} was due")]
    Sequence {
        /// Count that was due.
        expected: u32,
        /// Count that came.
        found: u32,
    },
    /// The payload is damaged.
    #[error("the payload's CRC does not agree")]
    PayloadCrc,
}

impl ProtocolError {
    /// Code of section 6.
    pub fn code(self) -> u16 {
        match self {
            Self::Magic => 101,
            Self::HeaderCrc => 102,
            Self::PayloadCrc => 103,
            Self::PayloadTooLong(_) => 104,
            Self::Major(_) => 105,
            Self::Sequence { .. } => 107,
            Self::HeaderLength(_) => 108,
            Self::Reserved => 109,
        }
    }
}

impl RawFrame {
    /// Bytes of the frame.
    pub fn to_bytes(&self) -> Vec<u8> {
        let header = Header {
            kind: self.kind,
            request_id: self.request_id,
            seq: self.seq,
            flags: self.flags,
        };
        header.frame_bytes([&self.payload, &[]], None)
    }
}

/// What a frame's header says beside length and check sums.
#[derive(Clone, Copy, Debug)]
pub(super) struct Header {
    pub(super) kind: u16,
    pub(super) request_id: u32,
    pub(super) seq: u32,
    pub(super) flags: u16,
}

/// What is wrong with the bytes of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Damage {
    /// The payload does not agree with its CRC.
    Payload,
    /// The header does not agree with its CRC.
    Header,
    /// The header claims one byte more than a chunk may have.
    Oversize,
    /// Only half of the frame is there.
    Cut,
}

impl Header {
    /// Bytes of a frame whose payload stands in two pieces: the one copy that is made of them.
    pub(super) fn frame_bytes(&self, payload: [&[u8]; 2], damage: Option<Damage>) -> Vec<u8> {
        let payload_len = payload[0].len() + payload[1].len();
        let stated_len = match damage {
            Some(Damage::Oversize) => CHUNK_PAYLOAD_MAX + 1,
            _ => payload_len as u32,
        };
        let mut payload_crc = crc32c::crc32c_append(crc32c::crc32c(payload[0]), payload[1]);
        payload_crc ^= u32::from(damage == Some(Damage::Payload));
        let mut bytes = Vec::with_capacity(HEADER_BYTES + payload_len);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&[MAJOR, HEADER_BYTES as u8]);
        bytes.extend_from_slice(&self.kind.to_le_bytes());
        bytes.extend_from_slice(&stated_len.to_le_bytes());
        bytes.extend_from_slice(&self.request_id.to_le_bytes());
        bytes.extend_from_slice(&self.seq.to_le_bytes());
        bytes.extend_from_slice(&self.flags.to_le_bytes());
        bytes.extend_from_slice(&[0, 0]);
        bytes.extend_from_slice(&payload_crc.to_le_bytes());
        let header_crc = crc32c::crc32c(&bytes) ^ u32::from(damage == Some(Damage::Header));
        bytes.extend_from_slice(&header_crc.to_le_bytes());
        bytes.extend_from_slice(payload[0]);
        bytes.extend_from_slice(payload[1]);
        if damage == Some(Damage::Cut) {
            bytes.truncate(bytes.len() / 2);
        }
        bytes
    }
}

/// Reads the frames of one direction of a connection, whatever the pieces its bytes come in.
///
/// It never holds more than one longest frame and the piece last pushed. After an error it reads nothing any more.
#[derive(Clone, Debug, Default)]
pub struct Parser {
    buffer: Vec<u8>,
    next_seq: u32,
    is_broken: bool,
}

impl Parser {
    /// Takes the bytes that came next.
    pub fn handle_bytes(&mut self, bytes: &[u8]) {
        if !self.is_broken {
            self.buffer.extend_from_slice(bytes);
        }
    }

    /// Next whole frame, or what is wrong with the stream.
    pub fn poll_frame(&mut self) -> Option<Result<RawFrame, ProtocolError>> {
        let frame = self.next_frame().transpose()?;
        match &frame {
            Ok(frame) => {
                self.next_seq = self.next_seq.wrapping_add(1);
                self.buffer.drain(..HEADER_BYTES + frame.payload.len());
            }
            Err(_) => {
                self.is_broken = true;
                self.buffer = Vec::new();
            }
        }
        Some(frame)
    }

    /// The checks stand in the order of section 2.
    fn next_frame(&self) -> Result<Option<RawFrame>, ProtocolError> {
        let Some((header, rest)) = self.buffer.split_first_chunk::<HEADER_BYTES>() else {
            return Ok(None);
        };
        let kind = u16_at(header, 6);
        let payload_len = u32_at(header, 8);
        let seq = u32_at(header, 16);
        let flags = u16_at(header, 20);
        if &header[..4] != MAGIC {
            return Err(ProtocolError::Magic);
        }
        if crc32c::crc32c(&header[..28]) != u32_at(header, 28) {
            return Err(ProtocolError::HeaderCrc);
        }
        if header[4] != MAJOR {
            return Err(ProtocolError::Major(header[4]));
        }
        if usize::from(header[5]) != HEADER_BYTES {
            return Err(ProtocolError::HeaderLength(header[5]));
        }
        if u16_at(header, 22) != 0 || flags & !(FLAG_REPLY | FLAG_ERROR | FLAG_LAST) != 0 {
            return Err(ProtocolError::Reserved);
        }
        let payload_max = if kind == KIND_FRAME_CHUNK {
            CHUNK_PAYLOAD_MAX
        } else {
            CONTROL_PAYLOAD_MAX
        };
        if payload_len > payload_max {
            return Err(ProtocolError::PayloadTooLong(payload_len));
        }
        if seq != self.next_seq {
            return Err(ProtocolError::Sequence {
                expected: self.next_seq,
                found: seq,
            });
        }
        let Some(payload) = rest.get(..payload_len as usize) else {
            return Ok(None);
        };
        if crc32c::crc32c(payload) != u32_at(header, 24) {
            return Err(ProtocolError::PayloadCrc);
        }
        Ok(Some(RawFrame {
            kind,
            request_id: u32_at(header, 12),
            seq,
            flags,
            payload: payload.to_vec(),
        }))
    }
}

fn u16_at(header: &[u8; HEADER_BYTES], at: usize) -> u16 {
    u16::from_le_bytes([header[at], header[at + 1]])
}

fn u32_at(header: &[u8; HEADER_BYTES], at: usize) -> u32 {
    u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
}

/// Set in every reply.
pub const FLAG_REPLY: u16 = 1;
/// Set in every ERROR.
pub const FLAG_ERROR: u16 = 2;
/// Set in FRAME_END alone.
pub const FLAG_LAST: u16 = 4;
/// Longest payload but that of a FRAME_CHUNK.
pub const CONTROL_PAYLOAD_MAX: u32 = 65_536;
/// Longest payload of a FRAME_CHUNK.
pub const CHUNK_PAYLOAD_MAX: u32 = 1_048_576;

const MAGIC: &[u8; 4] = b"A3DP";
const MAJOR: u8 = 1;
const HEADER_BYTES: usize = 32;
/// Type of FRAME_CHUNK.
pub(super) const KIND_FRAME_CHUNK: u16 = 0x0031;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::{CAMERA_PAGE, all, vector};

    fn read(bytes: &[u8]) -> Option<Result<RawFrame, ProtocolError>> {
        let mut parser = Parser::default();
        parser.handle_bytes(bytes);
        parser.poll_frame()
    }

    /// Changes the header and makes its CRC agree again.
    fn with_header(name: &str, change: impl Fn(&mut [u8])) -> Vec<u8> {
        let mut bytes = vector(CAMERA_PAGE, name);
        change(&mut bytes[..28]);
        let crc = crc32c::crc32c(&bytes[..28]);
        bytes[28..32].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    #[test]
    fn every_frame_of_the_page_is_read_and_written_byte_for_byte() {
        for (name, bytes) in all(CAMERA_PAGE) {
            let seq = u32::from_le_bytes(bytes[16..20].try_into().unwrap());
            let mut parser = Parser {
                next_seq: seq,
                ..Parser::default()
            };
            for byte in &bytes[..bytes.len() - 1] {
                parser.handle_bytes(&[*byte]);
                assert_eq!(parser.poll_frame(), None, "{name}");
            }
            parser.handle_bytes(&bytes[bytes.len() - 1..]);
            assert_eq!(parser.poll_frame().unwrap().unwrap().to_bytes(), bytes, "{name}");
            assert_eq!(parser.poll_frame(), None);
        }
    }

    #[test]
    fn each_damage_has_its_code_and_the_first_in_the_order_of_the_page_counts() {
        let hello = vector(CAMERA_PAGE, "hello");
        let flipped = |at: usize| {
            let mut bytes = hello.clone();
            bytes[at] ^= 1;
            bytes
        };
        for (bytes, code) in [
            (flipped(0), 101),
            (flipped(16), 102),
            (flipped(40), 103),
            (with_header("hello", |header| header[4] = 2), 105),
            (with_header("hello", |header| header[5] = 33), 108),
            (with_header("hello", |header| header[20] = 8), 109),
            (with_header("hello", |header| header[22] = 1), 109),
            (
                with_header("hello", |header| {
                    header[8..12].copy_from_slice(&65_537_u32.to_le_bytes())
                }),
                104,
            ),
            (with_header("hello", |header| header[16] = 1), 107),
            (with_header("hello", |header| (header[4], header[20]) = (2, 8)), 105),
        ] {
            assert_eq!(read(&bytes).unwrap().unwrap_err().code(), code);
        }
    }

    #[test]
    fn a_chunk_may_be_longer_and_is_refused_before_its_payload_comes() {
        let header = |len: u32| {
            with_header("frame_chunk_0", |header| {
                header[8..12].copy_from_slice(&len.to_le_bytes());
                header[16] = 0;
            })
        };
        assert_eq!(read(&header(1_048_576)[..32]), None);
        assert_eq!(
            read(&header(1_048_577)[..32]),
            Some(Err(ProtocolError::PayloadTooLong(1_048_577)))
        );
    }

    #[test]
    fn nothing_is_read_after_an_error() {
        let mut parser = Parser::default();
        parser.handle_bytes(&[0; 32]);
        assert_eq!(parser.poll_frame(), Some(Err(ProtocolError::Magic)));
        parser.handle_bytes(&vector(CAMERA_PAGE, "hello"));
        assert_eq!(parser.poll_frame(), None);
    }
}
