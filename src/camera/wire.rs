//! A3DP/1 frames: a byte stream to checked frames and back (`docs/protocols/camera.md`, section 2).

use thiserror::Error;

/// Bytes of the header.
pub const HEADER_BYTES: usize = 32;
/// The longest payload of a control message.
pub const CONTROL_PAYLOAD_MAX: usize = 65_536;
/// The longest payload of a FRAME_CHUNK.
pub const CHUNK_PAYLOAD_MAX: usize = 1_048_576;

const MAGIC: &[u8; 4] = b"A3DP";
const MAJOR: u8 = 1;
const FLAGS_KNOWN: u16 = 0b111;
const FRAME_CHUNK: u16 = 0x31;

/// Flag bit 0: this frame answers a request.
pub const FLAG_REPLY: u16 = 1;
/// Flag bit 1: this frame is an ERROR.
pub const FLAG_ERROR: u16 = 2;
/// Flag bit 2: this frame is the last of its group (FRAME_END).
pub const FLAG_LAST: u16 = 4;

/// One frame: heard, with header and payload checked, or to be said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireFrame<'a> {
    /// Message type.
    pub kind: u16,
    /// The request it answers, or 0.
    pub request_id: u32,
    /// Flag bits.
    pub flags: u16,
    /// The payload.
    pub payload: &'a [u8],
}

/// Why a byte stream is no longer believed. Each ends the connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum WireError {
    /// The stream is out of step.
    #[error("the magic is not A3DP")]
    Magic,
    /// The header's own CRC.
    #[error("the header CRC does not fit")]
    HeaderCrc,
    /// Another major version, or another header length.
    #[error("version {major} with a header of {header_len} bytes")]
    Version {
        /// Byte 4.
        major: u8,
        /// Byte 5.
        header_len: u8,
    },
    /// Reserved bytes or unknown flag bits are set.
    #[error("reserved bits are not 0")]
    Reserved,
    /// The payload is longer than its type may be.
    #[error("a payload of {stated} bytes where {max} are allowed")]
    TooLong {
        /// What the header says.
        stated: u32,
        /// The limit for this type.
        max: usize,
    },
    /// A frame is missing or came twice.
    #[error("sequence number {found} where {expected} belongs")]
    Sequence {
        /// The next in order.
        expected: u32,
        /// What came.
        found: u32,
    },
    /// The payload's CRC.
    #[error("the payload CRC does not fit")]
    PayloadCrc,
}

impl WireError {
    /// The protocol's error code (section 6 of the page).
    pub fn code(self) -> u16 {
        match self {
            Self::Magic => 101,
            Self::HeaderCrc => 102,
            Self::PayloadCrc => 103,
            Self::TooLong { .. } => 104,
            Self::Version { major: MAJOR, .. } => 108,
            Self::Version { .. } => 105,
            Self::Sequence { .. } => 107,
            Self::Reserved => 109,
        }
    }
}

/// Turns a byte stream into frames, which borrow their payloads from it.
///
/// Holds at most one frame's bytes beyond what it was given, and as much again that was read already.
#[derive(Debug, Default)]
pub struct FrameReader {
    bytes: Vec<u8>,
    start: usize,
    next_seq: u32,
}

impl FrameReader {
    /// Takes the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        // What was read goes only when it is the larger part, so that each byte moves at most once.
        if self.start >= self.bytes.len() - self.start {
            self.bytes.drain(..self.start);
            self.start = 0;
        }
        self.bytes.extend_from_slice(bytes);
    }

    /// The next whole frame, `None` until it is there. After an error the stream must not be read on.
    pub fn next_frame(&mut self) -> Result<Option<WireFrame<'_>>, WireError> {
        let bytes = &self.bytes[self.start..];
        if bytes.len() < HEADER_BYTES {
            return Ok(None);
        }
        let header = Header::check(&bytes[..HEADER_BYTES], self.next_seq)?;
        let end = HEADER_BYTES + header.payload_len;
        if bytes.len() < end {
            return Ok(None);
        }
        let payload = &bytes[HEADER_BYTES..end];
        if crc32c::crc32c(payload) != header.payload_crc {
            return Err(WireError::PayloadCrc);
        }
        self.start += end;
        self.next_seq = self.next_seq.wrapping_add(1);
        Ok(Some(WireFrame {
            kind: header.kind,
            request_id: header.request_id,
            flags: header.flags,
            payload,
        }))
    }
}

struct Header {
    kind: u16,
    payload_len: usize,
    request_id: u32,
    flags: u16,
    payload_crc: u32,
}

impl Header {
    /// Checks in the order of the page.
    fn check(bytes: &[u8], next_seq: u32) -> Result<Self, WireError> {
        let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let u32_at = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        if &bytes[0..4] != MAGIC {
            return Err(WireError::Magic);
        }
        if crc32c::crc32c(&bytes[..28]) != u32_at(28) {
            return Err(WireError::HeaderCrc);
        }
        let (major, header_len) = (bytes[4], bytes[5]);
        if major != MAJOR || usize::from(header_len) != HEADER_BYTES {
            return Err(WireError::Version { major, header_len });
        }
        let (kind, flags) = (u16_at(6), u16_at(20));
        if u16_at(22) != 0 || flags & !FLAGS_KNOWN != 0 {
            return Err(WireError::Reserved);
        }
        let max = if kind == FRAME_CHUNK {
            CHUNK_PAYLOAD_MAX
        } else {
            CONTROL_PAYLOAD_MAX
        };
        if u32_at(8) as usize > max {
            return Err(WireError::TooLong { stated: u32_at(8), max });
        }
        if u32_at(16) != next_seq {
            return Err(WireError::Sequence {
                expected: next_seq,
                found: u32_at(16),
            });
        }
        Ok(Self {
            kind,
            payload_len: u32_at(8) as usize,
            request_id: u32_at(12),
            flags,
            payload_crc: u32_at(24),
        })
    }
}

/// Numbers outgoing frames and adds the checksums.
#[derive(Debug, Default)]
pub struct FrameWriter {
    next_seq: u32,
}

impl FrameWriter {
    /// The bytes of one frame.
    pub fn write(&mut self, frame: &WireFrame<'_>) -> Vec<u8> {
        self.write_with(frame.kind, frame.request_id, frame.flags, |payload| {
            payload.extend_from_slice(frame.payload);
        })
    }

    /// The bytes of one frame whose payload is appended in place.
    pub fn write_with(
        &mut self,
        kind: u16,
        request_id: u32,
        flags: u16,
        append_payload: impl FnOnce(&mut Vec<u8>),
    ) -> Vec<u8> {
        let mut bytes = vec![0; HEADER_BYTES];
        append_payload(&mut bytes);
        let (header, payload) = bytes.split_at_mut(HEADER_BYTES);
        header[0..4].copy_from_slice(MAGIC);
        header[4..6].copy_from_slice(&[MAJOR, HEADER_BYTES as u8]);
        header[6..8].copy_from_slice(&kind.to_le_bytes());
        header[8..12].copy_from_slice(&(payload.len() as u32).to_le_bytes());
        header[12..16].copy_from_slice(&request_id.to_le_bytes());
        header[16..20].copy_from_slice(&self.next_seq.to_le_bytes());
        header[20..22].copy_from_slice(&flags.to_le_bytes());
        header[24..28].copy_from_slice(&crc32c::crc32c(payload).to_le_bytes());
        let header_crc = crc32c::crc32c(&header[..28]);
        header[28..32].copy_from_slice(&header_crc.to_le_bytes());
        self.next_seq = self.next_seq.wrapping_add(1);
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::a3dp;

    fn read_one(bytes: &[u8], next_seq: u32) -> Result<(), WireError> {
        let mut reader = FrameReader {
            next_seq,
            ..FrameReader::default()
        };
        reader.push(bytes);
        reader.next_frame().map(|_| ())
    }

    #[test]
    fn a_frame_of_the_page_reads_back_byte_for_byte_however_it_is_cut() {
        let bytes = a3dp("trigger");
        for cut in 0..bytes.len() {
            let mut reader = FrameReader {
                next_seq: 4,
                ..FrameReader::default()
            };
            reader.push(&bytes[..cut]);
            assert_eq!(reader.next_frame(), Ok(None), "cut at {cut}");
            reader.push(&bytes[cut..]);
            let frame = reader.next_frame().unwrap().unwrap();
            assert_eq!(FrameWriter { next_seq: 4 }.write(&frame), bytes);
        }
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        let bytes = a3dp("trigger");
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut bad = bytes.clone();
                bad[at] ^= 1 << bit;
                assert!(read_one(&bad, 4).is_err(), "byte {at} bit {bit}");
            }
        }
    }

    #[test]
    fn a_gap_in_the_sequence_is_an_error() {
        let found = read_one(&a3dp("trigger"), 3);
        assert_eq!(found, Err(WireError::Sequence { expected: 3, found: 4 }));
    }

    #[test]
    fn a_long_payload_is_refused_before_it_is_waited_for() {
        let mut writer = FrameWriter::default();
        let mut header = writer.write(&WireFrame {
            kind: 0x31,
            request_id: 0,
            flags: 0,
            payload: &vec![0; CHUNK_PAYLOAD_MAX + 1],
        });
        header.truncate(HEADER_BYTES);
        assert!(matches!(read_one(&header, 0), Err(WireError::TooLong { .. })));
    }

    #[test]
    fn a_stream_in_pieces_of_any_size_gives_every_frame_and_keeps_little() {
        let mut writer = FrameWriter::default();
        let stream: Vec<u8> = (0..40u32)
            .flat_map(|index| {
                writer.write(&WireFrame {
                    kind: 0x31,
                    request_id: index,
                    flags: 0,
                    payload: &vec![index as u8; 1 + index as usize * 37],
                })
            })
            .collect();
        for size in [1, 31, 500, 4096, stream.len()] {
            let mut reader = FrameReader::default();
            let mut found = 0;
            for piece in stream.chunks(size) {
                reader.push(piece);
                while let Some(frame) = reader.next_frame().unwrap() {
                    assert_eq!(
                        (frame.request_id, frame.payload.len()),
                        (found, 1 + found as usize * 37)
                    );
                    found += 1;
                }
                assert!(reader.bytes.len() <= 2 * (HEADER_BYTES + 40 * 37 + size));
            }
            assert_eq!(found, 40, "pieces of {size}");
        }
    }
}
