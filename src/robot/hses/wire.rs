//! HSES frames: bytes to fields and back (`docs/protocols/hses.md`, section 1).

use thiserror::Error;

/// Bytes before the data of every frame.
pub const HEADER_BYTES: usize = 32;
/// The most data bytes one frame carries.
pub const DATA_BYTES_MAX: usize = 479;

const IDENTIFIER: &[u8; 4] = b"YERC";
const RESERVE_2: &[u8; 8] = b"99999999";
const ROBOT_DIVISION: u8 = 1;
const FILE_DIVISION: u8 = 2;
/// Marks the last block of a file, and every answer of the robot control port.
const LAST: u32 = 0x8000_0000;
/// Marks the service of an answer.
const ANSWERED: u8 = 0x80;

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

/// What a request to the file control port asks for; the controller's point of view, as in the manuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum FileService {
    /// Delete a file.
    Delete = 0x09,
    /// From us to the controller.
    Load = 0x15,
    /// From the controller to us.
    Save = 0x16,
    /// List the files of one ending.
    List = 0x32,
}

/// The block-number field: a number, and in its highest bit whether the block is the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block(pub u32);

/// One frame to the file control port: a request (block 0), a block of a file, or the acknowledgement of a block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileFrame {
    /// Chosen by us, the same through one transfer.
    pub id: u8,
    /// `Block(0)` for a request.
    pub block: Block,
    /// What to do.
    pub service: FileService,
    /// At most [`DATA_BYTES_MAX`] bytes; none in an acknowledgement.
    pub data: Vec<u8>,
}

/// One frame from the file control port: an answer, a block of a file, or the acknowledgement of a block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileAnswer {
    /// The id of the request it belongs to.
    pub id: u8,
    /// Which block.
    pub block: Block,
    /// The service of the request (without the answer bit).
    pub service: u8,
    /// 0 when all is well.
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
    /// Not an answer of the port that was asked.
    #[error("not an answer (division {division}, ACK {ack}, block {block:#010x}, service {service:#04x})")]
    NotAnAnswer {
        /// Byte 9.
        division: u8,
        /// Byte 10.
        ack: u8,
        /// Bytes 12 to 15.
        block: u32,
        /// Byte 24.
        service: u8,
    },
}

impl Request {
    /// The datagram.
    pub fn encode(&self) -> Vec<u8> {
        let [command, instance] = [self.command, self.instance].map(u16::to_le_bytes);
        let sub_header = [
            command[0],
            command[1],
            instance[0],
            instance[1],
            self.attribute,
            self.service as u8,
            0,
            0,
        ];
        frame([ROBOT_DIVISION, 0, self.id], 0, sub_header, &self.data)
    }
}

impl FileFrame {
    /// The datagram. A frame that goes on with a transfer (its block is not 0) carries the ACK mark.
    pub fn encode(&self) -> Vec<u8> {
        let ack = u8::from(self.block.0 != 0);
        let sub_header = [0, 0, 0, 0, 0, self.service as u8, 0, 0];
        frame([FILE_DIVISION, ack, self.id], self.block.0, sub_header, &self.data)
    }
}

impl Block {
    /// The block of this number, 1 and up.
    pub fn new(number: u32, last: bool) -> Self {
        Self(number & !LAST | if last { LAST } else { 0 })
    }

    /// Its number; 0 for an answer to the request itself.
    pub fn number(self) -> u32 {
        self.0 & !LAST
    }

    /// Whether it is marked as the last.
    pub fn is_last(self) -> bool {
        self.0 & LAST != 0
    }
}

impl Answer {
    /// Reads a datagram. The added status is read whenever the status is not 0, whatever its size byte says.
    ///
    /// # Errors
    ///
    /// The datagram is not an answer of the robot control port.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let (header, data) = Header::decode(bytes, ROBOT_DIVISION)?;
        if header.block != Block(LAST) {
            return Err(header.not_an_answer());
        }
        Ok(Self {
            id: header.id,
            service: header.service & !ANSWERED,
            status: header.status,
            added_status: header.added_status,
            data: data.to_vec(),
        })
    }
}

impl FileAnswer {
    /// Reads a datagram, as [`Answer::decode`] does.
    ///
    /// # Errors
    ///
    /// The datagram is not an answer of the file control port.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let (header, data) = Header::decode(bytes, FILE_DIVISION)?;
        Ok(Self {
            id: header.id,
            block: header.block,
            service: header.service & !ANSWERED,
            status: header.status,
            added_status: header.added_status,
            data: data.to_vec(),
        })
    }
}

/// Whether these bytes begin a frame.
pub fn is_frame(bytes: &[u8]) -> bool {
    bytes.starts_with(IDENTIFIER)
}

/// What the answers of both ports have before their data.
struct Header {
    division: u8,
    ack: u8,
    id: u8,
    block: Block,
    service: u8,
    status: u8,
    added_status: u16,
}

impl Header {
    /// The header of an answer of `division`, and its data.
    fn decode(bytes: &[u8], division: u8) -> Result<(Self, &[u8]), WireError> {
        let Some((head, data)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
            return Err(WireError::Short(bytes.len()));
        };
        if &head[0..4] != IDENTIFIER {
            return Err(WireError::Identifier);
        }
        let u16_at = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
        if usize::from(u16_at(4)) != HEADER_BYTES {
            return Err(WireError::HeaderSize(u16_at(4)));
        }
        if usize::from(u16_at(6)) != data.len() || data.len() > DATA_BYTES_MAX {
            return Err(WireError::DataSize {
                stated: u16_at(6),
                found: data.len(),
            });
        }
        let header = Self {
            division: head[9],
            ack: head[10],
            id: head[11],
            block: Block(u32::from_le_bytes([head[12], head[13], head[14], head[15]])),
            service: head[24],
            status: head[25],
            added_status: if head[25] == 0 { 0 } else { u16_at(28) },
        };
        if header.division != division || header.ack != 1 || header.service & ANSWERED == 0 {
            return Err(header.not_an_answer());
        }
        Ok((header, data))
    }

    fn not_an_answer(&self) -> WireError {
        WireError::NotAnAnswer {
            division: self.division,
            ack: self.ack,
            service: self.service,
            block: self.block.0,
        }
    }
}

/// A datagram; the data are at most [`DATA_BYTES_MAX`] bytes (`request` and `Files` hold that).
fn frame([division, ack, id]: [u8; 3], block: u32, sub_header: [u8; 8], data: &[u8]) -> Vec<u8> {
    debug_assert!(data.len() <= DATA_BYTES_MAX);
    let mut bytes = Vec::with_capacity(HEADER_BYTES + data.len());
    bytes.extend_from_slice(IDENTIFIER);
    bytes.extend_from_slice(&(HEADER_BYTES as u16).to_le_bytes());
    bytes.extend_from_slice(&(data.len() as u16).to_le_bytes());
    bytes.extend_from_slice(&[3, division, ack, id]);
    bytes.extend_from_slice(&block.to_le_bytes());
    bytes.extend_from_slice(RESERVE_2);
    bytes.extend_from_slice(&sub_header);
    bytes.extend_from_slice(data);
    bytes
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
