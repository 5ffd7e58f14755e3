//! HSES: the High-Speed Ethernet Server. Here its datagrams; the robot port's commands and the file port are in the modules
//! below. Little-endian throughout.

mod commands;
mod files;
mod plural;
mod records;

pub(super) use commands::is_read;
pub(super) use files::FileLink;

use thiserror::Error;

use crate::robot::refused::Refused;

/// Port of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Port {
    /// 10040: commands.
    Robot,
    /// 10041: files.
    File,
}

/// A well-formed datagram of a client; what it asks for may still be refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Port that it came to.
    pub port: Port,
    /// Whether it goes on with a transfer: ACK 1, file port only.
    pub is_continuation: bool,
    /// Chosen by the client, repeated in the answer.
    pub id: u8,
    /// 0; in a transfer that of the block, the last with [`LAST_BLOCK`].
    pub block: u32,
    /// Command number.
    pub command: u16,
    /// Instance within the command.
    pub instance: u16,
    /// Attribute, 0 for all.
    pub attribute: u8,
    /// Service, for example [`SERVICE_GET_ALL`].
    pub service: u8,
    /// Data after the header, 0 to 479 bytes.
    pub data: Vec<u8>,
}

/// Why a datagram is no request.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Malformed {
    /// Shorter than the header. It is not answered: nothing in it can be believed.
    #[error("{byte_count} bytes are less than a header")]
    Short {
        /// Size of the datagram.
        byte_count: usize,
    },
    /// A fixed field of the header has another value.
    #[error("header field {field} is wrong")]
    Field {
        /// Name of the field as on the protocol page.
        field: &'static str,
    },
    /// The data size is over the limit or not that of the datagram.
    #[error("data size {stated} is stated, {found} bytes came")]
    DataSize {
        /// Size in the header.
        stated: usize,
        /// Bytes after the header.
        found: usize,
    },
}

/// Why a well-formed request is not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// 0x08, or A000.
    UndefinedCommand,
    /// 0x09, or A002.
    InvalidAttribute,
    /// 0x28, or A001.
    NoInstance,
    /// 0x1F with this added status.
    Failed(u16),
}

impl From<Refused> for Refusal {
    fn from(refused: Refused) -> Self {
        Self::Failed(refused.0)
    }
}

impl Malformed {
    /// Added status of the answer. The sheet names one for these fields alone: wrong reserves and paddings are not
    /// answered.
    fn refused(self) -> Option<Refused> {
        match self {
            Self::Field {
                field: FIELD_IDENTIFIER,
            } => Some(Refused(0xE4A6)),
            Self::Field {
                field: FIELD_HEADER_SIZE,
            } => Some(Refused(0xE4A5)),
            Self::Field { field: FIELD_DIVISION } => Some(Refused(0xE4A3)),
            Self::Field { field: FIELD_ACK } => Some(Refused(0xE4A2)),
            Self::Field { field: FIELD_BLOCK } => Some(Refused(0xE4A1)),
            Self::DataSize { stated, found } if stated.max(found) > DATA_BYTES_MAX => Some(Refused(0xE49E)),
            Self::DataSize { .. } => Some(Refused(0xE4A7)),
            Self::Field { .. } | Self::Short { .. } => None,
        }
    }
}

impl Request {
    /// Reads one datagram; every fixed field of the header is checked.
    pub fn parse(port: Port, datagram: &[u8]) -> Result<Self, Malformed> {
        let Some((header, data)) = datagram.split_at_checked(HEADER_BYTES) else {
            return Err(Malformed::Short {
                byte_count: datagram.len(),
            });
        };
        let is_continuation = port == Port::File && header[10] == 1;
        let block = u32::from_le_bytes([header[12], header[13], header[14], header[15]]);
        let fields: [(&'static str, bool); 7] = [
            (FIELD_IDENTIFIER, header[..4] == *b"YERC"),
            (FIELD_HEADER_SIZE, u16_at(header, 4) == HEADER_BYTES as u16),
            ("reserve 1", header[8] == 3),
            (FIELD_DIVISION, header[9] == division(port)),
            (FIELD_ACK, header[10] == 0 || is_continuation),
            (
                FIELD_BLOCK,
                (block & !LAST_BLOCK != 0) == is_continuation && (block == 0 || is_continuation),
            ),
            ("reserve 2", header[16..24] == *b"99999999"),
        ];
        if let Some((field, _)) = fields.into_iter().find(|(_, right)| !right) {
            return Err(Malformed::Field { field });
        }
        let stated = usize::from(u16_at(header, 6));
        if stated != data.len() || stated > DATA_BYTES_MAX {
            return Err(Malformed::DataSize {
                stated,
                found: data.len(),
            });
        }
        if header[30..32] != [0; 2] {
            return Err(Malformed::Field { field: "padding" });
        }
        Ok(Self {
            port,
            is_continuation,
            id: header[11],
            block,
            command: u16_at(header, 24),
            instance: u16_at(header, 26),
            attribute: header[28],
            service: header[29],
            data: data.to_vec(),
        })
    }

    /// Answer to a datagram that is no request, where the sheet has a code for what is wrong. What
    /// may be an answer, with ACK 1 and a block number, is never answered: two controllers would not come to an end.
    pub fn answer_malformed(port: Port, datagram: &[u8], malformed: Malformed) -> Option<Vec<u8>> {
        let refused = malformed.refused()?;
        let header = datagram.get(..HEADER_BYTES)?;
        if header[10] == 1 && header[12..16] != [0; 4] {
            return None;
        }
        let answer = Answer {
            port,
            id: header[11],
            block: ANSWER_BLOCK,
            service: header[29],
        };
        Some(answer.bytes(0x1F, Some(refused.0), &[]))
    }

    /// Answer that says the request is carried out, with its data.
    pub fn done(&self, data: &[u8]) -> Vec<u8> {
        self.answer().bytes(0, None, data)
    }

    /// Answer that refuses the request. The sources have two forms of the first three; `in_added_status` takes the second.
    pub fn refused(&self, refusal: Refusal, in_added_status: bool) -> Vec<u8> {
        let (status, added) = match (refusal, in_added_status) {
            (Refusal::UndefinedCommand, false) => (0x08, None),
            (Refusal::InvalidAttribute, false) => (0x09, None),
            (Refusal::NoInstance, false) => (0x28, None),
            (Refusal::UndefinedCommand, true) => (0x1F, Some(Refused::NO_COMMAND.0)),
            (Refusal::InvalidAttribute, true) => (0x1F, Some(Refused::NO_ATTRIBUTE.0)),
            (Refusal::NoInstance, true) => (0x1F, Some(Refused::NO_INSTANCE.0)),
            (Refusal::Failed(added), _) => (0x1F, Some(added)),
        };
        self.answer().bytes(status, added, &[])
    }

    /// The sheet's answers to requests of the file port: block 0 for those that are done or refused.
    fn answer(&self) -> Answer {
        Answer {
            port: self.port,
            id: self.id,
            block: match self.port {
                Port::Robot => ANSWER_BLOCK,
                Port::File => self.block,
            },
            service: self.service,
        }
    }
}

/// What an answer repeats of its request.
#[derive(Clone, Copy, Debug)]
struct Answer {
    port: Port,
    id: u8,
    block: u32,
    service: u8,
}

impl Answer {
    /// The size of the added status counts its 16-bit words: 0 without, 1 with one. A public imitation always says 2; live
    /// controllers were seen to say 0 and 1.
    fn bytes(self, status: u8, added: Option<u16>, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + data.len());
        bytes.extend_from_slice(b"YERC");
        bytes.extend_from_slice(&(HEADER_BYTES as u16).to_le_bytes());
        bytes.extend_from_slice(&(data.len() as u16).to_le_bytes());
        bytes.extend_from_slice(&[3, division(self.port), 1, self.id]);
        bytes.extend_from_slice(&self.block.to_le_bytes());
        bytes.extend_from_slice(b"99999999");
        bytes.extend_from_slice(&[self.service | ANSWER_BIT, status, u8::from(added.is_some()), 0]);
        bytes.extend_from_slice(&added.unwrap_or(0).to_le_bytes());
        bytes.extend_from_slice(&[0, 0]);
        bytes.extend_from_slice(data);
        bytes
    }
}

/// Words of a request's data, or none where it has another size.
fn words<const N: usize>(data: &[u8]) -> Option<[i32; N]> {
    let (words, rest) = data.as_chunks::<4>();
    let words: &[[u8; 4]; N] = words.try_into().ok()?;
    rest.is_empty().then(|| words.map(i32::from_le_bytes))
}

/// Text, cut at `field_bytes` and padded with NUL.
fn text(text: &str, field_bytes: usize) -> Vec<u8> {
    let mut bytes: Vec<u8> = text.bytes().take(field_bytes).collect();
    bytes.resize(field_bytes, 0);
    bytes
}

fn division(port: Port) -> u8 {
    match port {
        Port::Robot => 1,
        Port::File => 2,
    }
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

/// Get one attribute.
pub const SERVICE_GET: u8 = 0x0E;
/// Get all attributes.
pub const SERVICE_GET_ALL: u8 = 0x01;
/// Set one attribute.
pub const SERVICE_SET: u8 = 0x10;
/// Set all attributes.
pub const SERVICE_SET_ALL: u8 = 0x02;
/// Read several.
pub const SERVICE_READ_PLURAL: u8 = 0x33;
/// Write several.
pub const SERVICE_WRITE_PLURAL: u8 = 0x34;
/// Mark of the last block of a transfer.
pub const LAST_BLOCK: u32 = 0x8000_0000;
/// Most bytes of data in a datagram.
pub const DATA_BYTES_MAX: usize = 479;

const HEADER_BYTES: usize = 32;
const ANSWER_BLOCK: u32 = 0x8000_0000;
const ANSWER_BIT: u8 = 0x80;
const FIELD_IDENTIFIER: &str = "identifier";
const FIELD_HEADER_SIZE: &str = "header size";
const FIELD_DIVISION: &str = "division";
const FIELD_ACK: &str = "ACK";
const FIELD_BLOCK: &str = "block number";

#[cfg(test)]
mod tests;
