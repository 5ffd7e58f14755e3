//! HSES datagrams: requests parsed, answers written. Little-endian throughout (`docs/protocols/hses.md`, section 1).

use thiserror::Error;

use crate::robot::alarms::Alarm;
use crate::robot::refused::Refused;

/// A well-formed request; what it asks for may still be refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Chosen by the client, repeated in the answer.
    pub id: u8,
    /// Command number, for example [`COMMAND_STATUS`].
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

/// Why a datagram is no request. It is not answered: nothing in it can be believed.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Malformed {
    /// Shorter than the header.
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
    /// 0x08.
    UndefinedCommand,
    /// 0x09.
    InvalidAttribute,
    /// 0x28.
    NoInstance,
    /// 0x1F with this added status.
    Failed(u16),
}

impl From<Refused> for Refusal {
    fn from(refused: Refused) -> Self {
        Self::Failed(refused.0)
    }
}

impl Request {
    /// Reads one datagram; every fixed field of the header is checked.
    pub fn parse(datagram: &[u8]) -> Result<Self, Malformed> {
        let Some((header, data)) = datagram.split_at_checked(HEADER_BYTES) else {
            return Err(Malformed::Short {
                byte_count: datagram.len(),
            });
        };
        let fields: [(&'static str, bool); 9] = [
            ("identifier", header[..4] == *b"YERC"),
            ("header size", u16_at(header, 4) == HEADER_BYTES as u16),
            ("reserve 1", header[8] == 3),
            ("division", header[9] == DIVISION_ROBOT),
            ("ACK", header[10] == 0),
            ("block number", header[12..16] == [0; 4]),
            ("reserve 2", header[16..24] == *b"99999999"),
            ("padding", header[30..32] == [0; 2]),
            ("data size", usize::from(u16_at(header, 6)) <= DATA_BYTES_MAX),
        ];
        if let Some((field, _)) = fields.into_iter().find(|(_, right)| !right) {
            return Err(Malformed::Field { field });
        }
        let stated = usize::from(u16_at(header, 6));
        if stated != data.len() {
            return Err(Malformed::DataSize {
                stated,
                found: data.len(),
            });
        }
        Ok(Self {
            id: header[11],
            command: u16_at(header, 24),
            instance: u16_at(header, 26),
            attribute: header[28],
            service: header[29],
            data: data.to_vec(),
        })
    }

    /// Answer that says the request is carried out, with its data.
    pub fn done(&self, data: &[u8]) -> Vec<u8> {
        self.answer(0, 0, 0, data)
    }

    /// Answer that refuses the request.
    pub fn refused(&self, refusal: Refusal) -> Vec<u8> {
        match refusal {
            Refusal::UndefinedCommand => self.answer(0x08, 0, 0, &[]),
            Refusal::InvalidAttribute => self.answer(0x09, 0, 0, &[]),
            Refusal::NoInstance => self.answer(0x28, 0, 0, &[]),
            Refusal::Failed(added) => self.answer(0x1F, 1, added, &[]),
        }
    }

    /// `added_words` counts the 16-bit words of the added status.
    fn answer(&self, status: u8, added_words: u8, added: u16, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + data.len());
        bytes.extend_from_slice(b"YERC");
        bytes.extend_from_slice(&(HEADER_BYTES as u16).to_le_bytes());
        bytes.extend_from_slice(&(data.len() as u16).to_le_bytes());
        bytes.extend_from_slice(&[3, DIVISION_ROBOT, 1, self.id]);
        bytes.extend_from_slice(&ANSWER_BLOCK.to_le_bytes());
        bytes.extend_from_slice(b"99999999");
        bytes.extend_from_slice(&[self.service | 0x80, status, added_words, 0]);
        bytes.extend_from_slice(&added.to_le_bytes());
        bytes.extend_from_slice(&[0, 0]);
        bytes.extend_from_slice(data);
        bytes
    }
}

/// The two words of a status answer; their bits as in section 3 of the page.
pub fn status_data(data_1: u32, data_2: u32) -> Vec<u8> {
    [data_1, data_2].into_iter().flat_map(u32::to_le_bytes).collect()
}

/// Data of an alarm answer, all 0 for none.
pub fn alarm_data(alarm: Option<&Alarm>) -> Vec<u8> {
    let Some(alarm) = alarm else { return vec![0; 60] };
    let mut bytes: Vec<u8> = [alarm.code, alarm.data, ALARM_TYPE]
        .into_iter()
        .flat_map(u32::to_le_bytes)
        .collect();
    push_text(&mut bytes, &alarm.time(), 16);
    push_text(&mut bytes, alarm.name(), 32);
    bytes
}

/// Data of a system information answer: 24, 16 and 8 bytes of text.
pub fn system_data(software: &str, model: &str, parameter_version: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(48);
    push_text(&mut bytes, software, 24);
    push_text(&mut bytes, model, 16);
    push_text(&mut bytes, parameter_version, 8);
    bytes
}

/// Data of 32-bit words.
pub fn words_data(words: &[i32]) -> Vec<u8> {
    words.iter().copied().flat_map(i32::to_le_bytes).collect()
}

/// Words of a request's data, or none where it has another size.
pub fn words<const N: usize>(data: &[u8]) -> Option<[i32; N]> {
    let (words, rest) = data.as_chunks::<4>();
    let words: &[[u8; 4]; N] = words.try_into().ok()?;
    rest.is_empty().then(|| words.map(i32::from_le_bytes))
}

/// Appends text, cut at `field_bytes` and padded with NUL.
fn push_text(bytes: &mut Vec<u8>, text: &str, field_bytes: usize) {
    let start = bytes.len();
    bytes.extend(text.bytes().take(field_bytes));
    bytes.resize(start + field_bytes, 0);
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

/// Alarm reading.
pub const COMMAND_ALARM: u16 = 0x70;
/// Status reading.
pub const COMMAND_STATUS: u16 = 0x72;
/// Position reading.
pub const COMMAND_POSITION: u16 = 0x75;
/// Alarm reset and error cancel.
pub const COMMAND_RESET: u16 = 0x82;
/// Hold and servo.
pub const COMMAND_SWITCH: u16 = 0x83;
/// System information reading.
pub const COMMAND_SYSTEM: u16 = 0x89;
/// Move to a cartesian pose.
pub const COMMAND_MOVE: u16 = 0x8A;
/// Get all attributes.
pub const SERVICE_GET_ALL: u8 = 0x01;
/// Set all attributes.
pub const SERVICE_SET_ALL: u8 = 0x02;
/// Set one attribute.
pub const SERVICE_SET: u8 = 0x10;

const HEADER_BYTES: usize = 32;
const DATA_BYTES_MAX: usize = 479;
const DIVISION_ROBOT: u8 = 1;
/// Type of every alarm, as in the page's vector.
const ALARM_TYPE: u32 = 1;
const ANSWER_BLOCK: u32 = 0x8000_0000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::{HSES_PAGE, all, vector};

    #[test]
    fn every_request_of_the_page_is_read() {
        let requests: Vec<_> = all(HSES_PAGE)
            .into_iter()
            .filter(|(name, _)| name.starts_with("req_"))
            .collect();
        assert_eq!(requests.len(), 11);
        for (name, bytes) in requests {
            let request = Request::parse(&bytes).unwrap();
            assert_eq!(
                request.id,
                u8::from(name != "req_status" && name != "req_alarm_1"),
                "{name}"
            );
        }
    }

    #[test]
    fn the_move_of_the_page_has_its_fields() {
        let request = Request::parse(&vector(HSES_PAGE, "req_move_base_50mm_s")).unwrap();
        assert_eq!(
            (request.command, request.instance, request.attribute, request.service),
            (0x8A, 2, 1, 2)
        );
        let words: [i32; 26] = words(&request.data).unwrap();
        assert_eq!(
            words[..11],
            [1, 0, 1, 500, 16, 500_000, -250_000, 750_000, 1_800_000, 0, -900_000]
        );
        assert_eq!(words[15], 1);
    }

    #[test]
    fn every_damaged_header_byte_that_is_fixed_makes_it_malformed() {
        let good = vector(HSES_PAGE, "req_hold_on");
        let chosen_by_the_client = [11, 24, 25, 26, 27, 28, 29];
        for at in (0..32).filter(|at| !chosen_by_the_client.contains(at)) {
            let mut bad = good.clone();
            bad[at] ^= 0x40;
            assert!(Request::parse(&bad).is_err(), "byte {at}");
        }
    }

    #[test]
    fn a_cut_or_a_longer_datagram_is_malformed() {
        let mut bytes = vector(HSES_PAGE, "req_hold_on");
        for length in 0..bytes.len() {
            assert!(Request::parse(&bytes[..length]).is_err(), "{length}");
        }
        bytes.push(0);
        assert_eq!(Request::parse(&bytes), Err(Malformed::DataSize { stated: 4, found: 5 }));
    }

    #[test]
    fn the_answers_of_the_page_are_written_byte_for_byte() {
        let request = |service| Request {
            id: 1,
            command: 0,
            instance: 0,
            attribute: 0,
            service,
            data: Vec::new(),
        };
        let get = request(SERVICE_GET_ALL);
        let set = request(SERVICE_SET);
        let go = request(SERVICE_SET_ALL);
        let collision = Alarm {
            code: 4315,
            data: 1,
            raised_ns: 0,
        };
        let position = [16, 4, 1, 0, 0, 500_000, -250_000, 750_000, 1_800_000, 0, -900_000, 0, 0];
        for (name, bytes) in [
            ("ans_status_ready", get.done(&status_data(0xC4, 0x40))),
            ("ans_status_running", get.done(&status_data(0xCC, 0x40))),
            ("ans_status_hold_alarm", get.done(&status_data(0xC4, 0x18))),
            ("ans_set_ok", set.done(&[])),
            ("ans_move_refused_2010", go.refused(Refusal::Failed(0x2010))),
            ("ans_set_refused_2100", set.refused(Refusal::Failed(0x2100))),
            ("ans_servo_refused_3450", set.refused(Refusal::Failed(0x3450))),
            ("ans_undefined_command", get.refused(Refusal::UndefinedCommand)),
            ("ans_position", get.done(&words_data(&position))),
            ("ans_alarm_none", get.done(&alarm_data(None))),
            ("ans_alarm_4315", get.done(&alarm_data(Some(&collision)))),
            (
                "ans_system_information",
                get.done(&system_data("SIMULATED 0.1.0", "SIMULATED DX200", "SIM")),
            ),
            ("ans_move_accepted", go.done(&[])),
        ] {
            assert_eq!(bytes, vector(HSES_PAGE, name), "{name}");
        }
    }
}
