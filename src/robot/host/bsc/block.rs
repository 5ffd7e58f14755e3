//! Blocks of the serial line: text between control characters, with a sum (`docs/protocols/bsc_like.md`, section 2).

use thiserror::Error;

pub(super) const SOH: u8 = 0x01;
pub(super) const STX: u8 = 0x02;
const ETX: u8 = 0x03;
pub(super) const EOT: u8 = 0x04;
pub(super) const ENQ: u8 = 0x05;
pub(super) const DLE: u8 = 0x10;
pub(super) const NAK: u8 = 0x15;
const ETB: u8 = 0x17;

/// The most text bytes of one block.
pub const TEXT_BYTES_MAX: usize = 256;
const HEADER_BYTES: usize = 6;

/// What a transmission is about: two digits, comma, three digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header(pub [u8; HEADER_BYTES]);

impl Header {
    /// A command to the controller.
    pub const COMMAND: Self = Self(*b"01,000");
    /// Its result: four digits.
    pub const RESULT: Self = Self(*b"90,000");
    /// Its answer with data.
    pub const DATA: Self = Self(*b"90,001");
    /// A job as text, in either direction.
    pub const JOB: Self = Self(*b"02,001");
    /// A request for a job.
    pub const JOB_REQUEST: Self = Self(*b"02,051");
}

/// One block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// Only the first block of a transmission has one.
    pub header: Option<Header>,
    /// At most [`TEXT_BYTES_MAX`] bytes.
    pub text: Vec<u8>,
    /// Whether it ends the transmission (ETX) or more follow (ETB).
    pub last: bool,
}

/// Why what came is no block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum BlockError {
    /// The sum is another.
    #[error("the block's sum is {found:04X} instead of {computed:04X}")]
    Sum {
        /// What the block says.
        found: u16,
        /// What its bytes come to.
        computed: u16,
    },
    /// No STX behind the header.
    #[error("the block's header does not end in STX")]
    Header,
    /// More than [`TEXT_BYTES_MAX`].
    #[error("the block's text has {0} bytes")]
    Length(usize),
}

/// The sum of `bytes`, which are those behind the leading SOH or STX, up to and with ETB or ETX.
pub fn sum(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |sum, &byte| sum.wrapping_add(u16::from(byte)))
}

impl Block {
    /// Its bytes.
    pub fn encode(&self) -> Vec<u8> {
        debug_assert!(self.text.len() <= TEXT_BYTES_MAX && carries(&self.text));
        let mut bytes = Vec::with_capacity(self.text.len() + HEADER_BYTES + 5);
        if let Some(Header(header)) = self.header {
            bytes.push(SOH);
            bytes.extend_from_slice(&header);
        }
        bytes.push(STX);
        bytes.extend_from_slice(&self.text);
        bytes.push(if self.last { ETX } else { ETB });
        bytes.extend_from_slice(&sum(&bytes[1..]).to_le_bytes());
        bytes
    }
}

/// Whether a block can carry `text`: none of its bytes is a control character of the line.
pub fn carries(text: &[u8]) -> bool {
    !text
        .iter()
        .any(|byte| matches!(*byte, SOH | STX | ETX | EOT | ENQ | DLE | NAK | ETB))
}

/// The blocks of a transmission: `lead` in a block of its own if there is one, then `text`.
///
/// No block equals the one before, since a receiver can only take it for a repetition.
pub fn blocks(header: Header, lead: Option<&[u8]>, text: &[u8]) -> Vec<Block> {
    let mut parts: Vec<&[u8]> = lead.into_iter().collect();
    let mut rest = text;
    while !rest.is_empty() || parts.is_empty() {
        let whole = rest.len().min(TEXT_BYTES_MAX);
        let repeats = parts.last() == Some(&&rest[..whole]);
        let (part, behind) = rest.split_at(if repeats { whole - 1 } else { whole });
        parts.push(part);
        rest = behind;
    }
    let last = parts.len() - 1;
    let block = |(index, text): (usize, &&[u8])| Block {
        header: (index == 0).then_some(header),
        text: text.to_vec(),
        last: index == last,
    };
    parts.iter().enumerate().map(block).collect()
}

/// Takes one block after the other out of a stream of bytes.
#[derive(Debug, Default)]
pub struct BlockReader {
    /// Behind the leading SOH or STX; bounded, what is beyond is only counted.
    bytes: Vec<u8>,
    beyond: usize,
    sum: u16,
    place: Place,
}

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
enum Place {
    #[default]
    Outside,
    /// In the header, this many bytes of it and its STX to come.
    Header(usize),
    Text,
    /// Behind ETX or ETB, before the two bytes of the sum.
    Low,
    High(u8),
}

impl BlockReader {
    /// Whether a block has begun and not ended.
    pub fn is_inside(&self) -> bool {
        self.place != Place::Outside
    }

    /// Forgets a block that has begun.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Takes one byte; gives the block that it ends. Bytes outside of a block that do not begin one do nothing.
    ///
    /// A SOH or STX where none can stand begins a block anew: the sender has given up the one before.
    pub fn push(&mut self, byte: u8) -> Option<Result<Block, BlockError>> {
        match (self.place, byte) {
            (Place::Outside | Place::Header(1..) | Place::Text, SOH) => self.begin(Place::Header(HEADER_BYTES + 1)),
            (Place::Outside | Place::Text, STX) => self.begin(Place::Text),
            (Place::Outside, _) => {}
            (Place::Low, low) => self.place = Place::High(low),
            (Place::High(low), high) => return Some(self.end(u16::from_le_bytes([low, high]))),
            (Place::Text, ETX | ETB) => {
                self.take(byte);
                self.place = Place::Low;
            }
            (Place::Text, _) => self.take(byte),
            (Place::Header(left), _) => {
                self.take(byte);
                self.place = if left > 1 { Place::Header(left - 1) } else { Place::Text };
            }
        }
        None
    }

    /// `bytes` keeps a SOH in front where there is a header, so that both kinds are told apart at the end.
    fn begin(&mut self, place: Place) {
        self.reset();
        self.place = place;
        self.bytes.push(if place == Place::Text { STX } else { SOH });
    }

    fn take(&mut self, byte: u8) {
        self.sum = self.sum.wrapping_add(u16::from(byte));
        if self.bytes.len() < BLOCK_BYTES_MAX {
            self.bytes.push(byte);
        } else {
            self.beyond += 1;
        }
    }

    fn end(&mut self, found: u16) -> Result<Block, BlockError> {
        let Self { bytes, beyond, sum, .. } = std::mem::take(self);
        if found != sum {
            return Err(BlockError::Sum { found, computed: sum });
        }
        let (header, text) = match bytes.as_slice() {
            [SOH, header @ ..] => match header.split_first_chunk() {
                Some((header, [STX, text @ ..])) => (Some(Header(*header)), text),
                _ => return Err(BlockError::Header),
            },
            [_, text @ ..] => (None, text),
            [] => return Err(BlockError::Header),
        };
        let length = text.len() + beyond - 1;
        if length > TEXT_BYTES_MAX {
            return Err(BlockError::Length(length));
        }
        Ok(Block {
            header,
            text: text[..length].to_vec(),
            last: text[length] == ETX,
        })
    }
}

/// SOH, header, STX, text, and ETX or ETB.
const BLOCK_BYTES_MAX: usize = 1 + HEADER_BYTES + 1 + TEXT_BYTES_MAX + 1;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::bsc;

    fn read(bytes: &[u8]) -> Vec<Result<Block, BlockError>> {
        let mut reader = BlockReader::default();
        bytes.iter().filter_map(|&byte| reader.push(byte)).collect()
    }

    #[test]
    fn the_sum_of_the_manuals_example_is_01db() {
        assert_eq!(sum(&bsc("sum_example")), 0x01DB);
    }

    #[test]
    fn blocks_of_the_page_are_written_and_read() {
        for (name, header, text, last) in [
            ("cmd_rstats", Some(Header::COMMAND), "RSTATS\r", true),
            ("cmd_hold_on", Some(Header::COMMAND), "HOLD 1\r", true),
            ("ans_ok", Some(Header::RESULT), "0000\r", true),
            ("ans_status_ready", Some(Header::DATA), "196,64\r", true),
            ("job_put_first", Some(Header::JOB), "SCAN1.JBI\r", false),
            ("job_put_last", None, "/JOB\r\n//NAME SCAN1\r\nEND\r\n", true),
            ("job_get", Some(Header::JOB_REQUEST), "SCAN1.JBI\r", true),
        ] {
            let block = Block {
                header,
                text: text.into(),
                last,
            };
            assert_eq!(block.encode(), bsc(name), "{name}");
            assert_eq!(read(&bsc(name)), [Ok(block)], "{name}");
        }
    }

    #[test]
    fn every_changed_bit_of_a_block_is_noticed_or_leaves_no_block() {
        let good = bsc("cmd_rstats");
        let block = read(&good);
        for at in 0..good.len() {
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[at] ^= 1 << bit;
                assert_ne!(read(&bad), block, "byte {at} bit {bit}");
            }
        }
    }

    #[test]
    fn a_block_that_begins_inside_of_another_replaces_it() {
        let mut bytes = bsc("cmd_rstats")[..12].to_vec();
        bytes.extend(bsc("cmd_hold_on"));
        assert_eq!(read(&bytes), read(&bsc("cmd_hold_on")));
    }

    #[test]
    fn a_text_of_257_bytes_is_refused_and_one_of_256_is_not() {
        for (length, good) in [(256, true), (257, false), (100_000, false)] {
            let mut bytes = vec![STX];
            bytes.resize(1 + length, b'A');
            bytes.push(ETX);
            bytes.extend(sum(&bytes[1..]).to_le_bytes());
            let mut reader = BlockReader::default();
            let blocks: Vec<_> = bytes.iter().filter_map(|&byte| reader.push(byte)).collect();
            assert_eq!(blocks.len(), 1);
            assert_eq!(blocks[0].is_ok(), good, "{length}");
            assert!(reader.bytes.capacity() <= 2 * BLOCK_BYTES_MAX);
        }
    }

    #[test]
    fn a_long_text_is_cut_into_blocks_that_differ_from_their_neighbours() {
        for length in [0, 1, 255, 256, 257, 500, 512, 513, 1024, 1025] {
            let text = vec![b'X'; length];
            let blocks = blocks(Header::JOB, Some(b"SCAN1.JBI\r"), &text);
            let joined: Vec<u8> = blocks[1..].iter().flat_map(|block| block.text.clone()).collect();
            assert_eq!(joined, text);
            assert!(blocks.iter().all(|block| block.text.len() <= TEXT_BYTES_MAX));
            assert!(blocks.windows(2).all(|pair| pair[0].text != pair[1].text), "{length}");
            let last_count = blocks.iter().filter(|block| block.last).count();
            assert!(last_count == 1 && blocks.last().unwrap().last && blocks[0].header.is_some());
        }
    }
}
