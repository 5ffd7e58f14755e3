//! Blocks and control characters on the line.

use core::fmt;

use super::{DLE, ENQ, EOT, ETB, ETX, NAK, SOH, STX, text};

/// One block: what stands between SOH or STX and the check sum.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// `hh,sss`; in the first block of a message only.
    pub header: Option<String>,
    /// At most [`TEXT_BYTES_MAX`] bytes.
    pub text: Vec<u8>,
    /// Whether it ends in ETX, and not in ETB.
    pub is_last: bool,
}

/// Why a block is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockError {
    /// Check sum and bytes disagree.
    CheckSum,
    /// The header is not of the form `hh,sss` STX.
    Header,
    /// The text is longer than [`TEXT_BYTES_MAX`].
    Length,
    /// The line fell quiet before the block ended.
    Unfinished,
}

impl fmt::Display for BlockError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CheckSum => "does not agree with its check sum",
            Self::Header => "has no header of the form hh,sss",
            Self::Length => "is too long",
            Self::Unfinished => "stops in the middle",
        })
    }
}

impl Block {
    /// The block as it goes over the line.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(BLOCK_BYTES_MAX);
        if let Some(header) = &self.header {
            bytes.push(SOH);
            bytes.extend_from_slice(header.as_bytes());
        }
        bytes.push(STX);
        bytes.extend_from_slice(&self.text);
        bytes.push(if self.is_last { ETX } else { ETB });
        let sum = check_sum(&bytes[1..]);
        bytes.extend_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// Reads a whole block, from SOH or STX to the check sum.
    fn parse(bytes: &[u8]) -> Result<Self, BlockError> {
        let [start, inside @ .., end, low, high] = bytes else {
            return Err(BlockError::Unfinished);
        };
        if check_sum(&bytes[1..bytes.len() - 2]) != u16::from_le_bytes([*low, *high]) {
            return Err(BlockError::CheckSum);
        }
        let (header, content) = match *start {
            SOH => match inside.split_at_checked(HEADER_BYTES) {
                Some((header @ [_, _, b',', _, _, _], [STX, content @ ..])) if has_digits(header) => {
                    (Some(text(header)), content)
                }
                _ => return Err(BlockError::Header),
            },
            _ => (None, inside),
        };
        if content.len() > TEXT_BYTES_MAX {
            return Err(BlockError::Length);
        }
        Ok(Self {
            header,
            text: content.to_vec(),
            is_last: *end == ETX,
        })
    }
}

fn has_digits(header: &[u8]) -> bool {
    header.iter().all(|byte| byte.is_ascii_digit() || *byte == b',')
}

/// Sum of the bytes modulo 65536. In a block it covers everything after the leading SOH or STX up to ETB or ETX, those
/// included; its low byte is sent first.
pub fn check_sum(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(u16::from(*byte)))
}

/// What comes over the line, put together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Item {
    Enq,
    Eot,
    Nak,
    /// ACK0 or ACK1.
    Ack(u8),
    Block(Block),
    Broken(BlockError),
    /// A byte that begins nothing.
    Noise,
}

impl fmt::Display for Item {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Enq => f.write_str("ENQ"),
            Self::Eot => f.write_str("EOT"),
            Self::Nak => f.write_str("NAK"),
            Self::Ack(turn) => write!(f, "ACK{turn}"),
            Self::Block(_) => f.write_str("a block"),
            Self::Broken(why) => write!(f, "a block that {why}"),
            Self::Noise => f.write_str("a byte that begins nothing"),
        }
    }
}

/// Puts items together byte by byte.
#[derive(Clone, Debug, Default)]
pub(super) struct Reader {
    place: Place,
}

#[derive(Clone, Debug, Default)]
enum Place {
    #[default]
    Between,
    /// After DLE.
    Control,
    /// In a block.
    Inside(Vec<u8>),
    /// In the check sum, whose bytes may have any value; so many are to come.
    CheckSum(Vec<u8>, usize),
    /// After a broken block, whose end nobody knows: nothing counts until the line is quiet.
    Lost(BlockError),
}

impl Reader {
    pub(super) fn read(&mut self, byte: u8) -> Option<Item> {
        match std::mem::take(&mut self.place) {
            Place::Between => self.begin(byte),
            Place::Control => match byte {
                b'0' | b'1' => Some(Item::Ack(byte - b'0')),
                // WACK and RVI stand in no manual; a control character in its place is heard as itself.
                ENQ | EOT | NAK | DLE | SOH | STX => self.begin(byte),
                _ => Some(Item::Noise),
            },
            Place::Inside(mut bytes) => {
                bytes.push(byte);
                self.place = match byte {
                    ETX | ETB => Place::CheckSum(bytes, CHECK_SUM_BYTES),
                    _ if bytes.len() > BLOCK_BYTES_MAX - CHECK_SUM_BYTES => Place::Lost(BlockError::Length),
                    _ => Place::Inside(bytes),
                };
                None
            }
            Place::CheckSum(mut bytes, missing) => {
                bytes.push(byte);
                if missing > 1 {
                    self.place = Place::CheckSum(bytes, missing - 1);
                    return None;
                }
                match Block::parse(&bytes) {
                    Ok(block) => Some(Item::Block(block)),
                    Err(error) => {
                        self.place = Place::Lost(error);
                        None
                    }
                }
            }
            Place::Lost(error) => {
                self.place = Place::Lost(error);
                None
            }
        }
    }

    /// Whether something has begun that only more bytes, or a quiet line, end.
    pub(super) fn is_in_the_middle(&self) -> bool {
        !matches!(self.place, Place::Between)
    }

    /// Ends what had begun: the line is quiet.
    pub(super) fn quiet(&mut self) -> Option<Item> {
        match std::mem::take(&mut self.place) {
            Place::Between => None,
            Place::Control => Some(Item::Noise),
            Place::Inside(_) | Place::CheckSum(..) => Some(Item::Broken(BlockError::Unfinished)),
            Place::Lost(error) => Some(Item::Broken(error)),
        }
    }

    fn begin(&mut self, byte: u8) -> Option<Item> {
        match byte {
            ENQ => Some(Item::Enq),
            EOT => Some(Item::Eot),
            NAK => Some(Item::Nak),
            DLE => {
                self.place = Place::Control;
                None
            }
            SOH | STX => {
                self.place = Place::Inside(vec![byte]);
                None
            }
            _ => Some(Item::Noise),
        }
    }
}

/// Of a header, `hh,sss`.
pub const HEADER_BYTES: usize = 6;
/// Of the text of a block.
pub const TEXT_BYTES_MAX: usize = 256;
const CHECK_SUM_BYTES: usize = 2;
/// SOH, header, STX, text, ETX and check sum.
const BLOCK_BYTES_MAX: usize = 1 + HEADER_BYTES + 1 + TEXT_BYTES_MAX + 1 + CHECK_SUM_BYTES;
