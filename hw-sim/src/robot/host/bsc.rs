//! The BSC-LIKE link of serial host control as a value: bytes and time in, bytes and whole messages out.
//!
//! Half duplex, point to point. Whoever wants to send bids with ENQ, sends blocks that are acknowledged in turn with ACK1 and
//! ACK0, and ends with EOT. Both sides follow the same rules, so the controller receives a command and then bids for its
//! answer.

use std::collections::VecDeque;

use crate::robot::host::text;

mod block;

pub use block::{Block, BlockError, HEADER_BYTES, TEXT_BYTES_MAX, check_sum};
use block::{Item, Reader};

/// What one transmission carries: a header and the text of its blocks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// `hh,sss`, such as `01,000`.
    pub header: String,
    /// Text of each block, at most [`TEXT_BYTES_MAX`] bytes; at least one.
    pub blocks: Vec<Vec<u8>>,
}

impl Message {
    /// Message of one text, cut into blocks where it must be.
    pub fn new(header: &str, text: &[u8]) -> Self {
        let mut blocks: Vec<Vec<u8>> = text.chunks(TEXT_BYTES_MAX).map(<[u8]>::to_vec).collect();
        if blocks.is_empty() {
            blocks.push(Vec::new());
        }
        Self {
            header: header.to_owned(),
            blocks,
        }
    }

    /// Message of a file: its name and CR in a block of their own, then what it holds.
    pub fn file(header: &str, name: &str, content: &[u8]) -> Self {
        let mut message = Self::new(header, format!("{name}\r").as_bytes());
        message
            .blocks
            .extend(content.chunks(TEXT_BYTES_MAX).map(<[u8]>::to_vec));
        message
    }

    /// All blocks one after the other.
    pub fn text(&self) -> Vec<u8> {
        self.blocks.concat()
    }

    /// The block at `index` as it goes over the line.
    fn block_bytes(&self, index: usize) -> Vec<u8> {
        let block = Block {
            header: (index == 0).then(|| self.header.clone()),
            text: self.blocks[index].clone(),
            is_last: index + 1 == self.blocks.len(),
        };
        block.to_bytes()
    }
}

/// Time-outs and retries, the parameters RS034 to RS037.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// RS034, wait for a control character.
    pub timer_a_ns: u64,
    /// RS035, wait for text.
    pub timer_b_ns: u64,
    /// RS036, repetitions of a control character.
    pub control_retry_max: u32,
    /// RS037, repetitions of a block.
    pub text_retry_max: u32,
}

impl Default for Timing {
    /// Those of the DX100: 3 s, 20 s, 10 and 3.
    fn default() -> Self {
        Self {
            timer_a_ns: 3_000_000_000,
            timer_b_ns: 20_000_000_000,
            control_retry_max: 10,
            text_retry_max: 3,
        }
    }
}

/// What a side that bids does when the other bids, too. The sheet leaves open which side is the primary one; the controller
/// of this simulator insists, so that a host which yields, as the sheet has it, and the controller never both yield.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contention {
    /// Waits for the answer to its own bid.
    Insist,
    /// Serves the other first.
    Yield,
}

/// One end of the line.
#[derive(Clone, Debug)]
pub struct Link {
    timing: Timing,
    contention: Contention,
    reader: Reader,
    state: State,
    /// Messages to send, the one under way first.
    to_send: VecDeque<Message>,
    /// When timer A or B runs out.
    deadline_ns: Option<u64>,
    /// When a block that stopped in the middle, or is broken, is done with.
    quiet_ns: Option<u64>,
    outputs: VecDeque<LinkOutput>,
}

/// What a link wants done, and what it has to tell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LinkOutput {
    /// Bytes for the line.
    Bytes(Vec<u8>),
    /// A whole message has come.
    Message(Message),
    /// A message of ours is acknowledged to its last block.
    Sent,
    /// A message of ours is given up.
    Failed(Message),
    /// The other side broke the protocol, or the line did.
    Violation(String),
}

#[derive(Clone, Debug)]
enum State {
    Idle,
    /// ENQ is out.
    Bidding {
        control_retry_count: u32,
    },
    /// The block at `index` is out.
    Sending {
        index: usize,
        control_retry_count: u32,
        text_retry_count: u32,
    },
    Receiving(Receiving),
}

/// What has come since the other side's ENQ.
#[derive(Clone, Debug)]
struct Receiving {
    blocks: Vec<Block>,
    /// When we answered last, with ACK or NAK.
    answered_ns: u64,
}

impl Receiving {
    fn is_complete(&self) -> bool {
        self.blocks.last().is_some_and(|block| block.is_last)
    }

    /// Whether this block came before, and its acknowledgement got lost. Blocks have no numbers: a second first block and a
    /// block after the last one are repeated ones, and so is an equal one that comes as late as a time-out makes it.
    fn is_repeated(&self, now_ns: u64, block: &Block, timing: &Timing) -> bool {
        let is_late = now_ns.saturating_sub(self.answered_ns) >= timing.timer_a_ns / 2;
        self.blocks
            .last()
            .is_some_and(|last| *block == *last && (block.header.is_some() || block.is_last || is_late))
    }
}

impl Link {
    /// Idle end of a line.
    pub fn new(timing: Timing, contention: Contention) -> Self {
        Self {
            timing,
            contention,
            reader: Reader::default(),
            state: State::Idle,
            to_send: VecDeque::new(),
            deadline_ns: None,
            quiet_ns: None,
            outputs: VecDeque::new(),
        }
    }

    /// Sends a message as soon as the line is free.
    pub fn send(&mut self, now_ns: u64, message: Message) {
        self.to_send.push_back(message);
        self.bid(now_ns);
    }

    /// Takes a piece of what comes over the line, however it is cut.
    pub fn handle_bytes(&mut self, now_ns: u64, bytes: &[u8]) {
        self.handle_wake(now_ns);
        let mut noise_count = 0;
        for byte in bytes {
            match self.reader.read(*byte) {
                Some(Item::Noise) => noise_count += 1,
                Some(item) => self.handle_item(now_ns, item),
                None => (),
            }
        }
        if noise_count > 0 {
            self.violation(&format!("{noise_count} bytes that begin nothing"));
        }
        self.quiet_ns = self.reader.is_in_the_middle().then_some(now_ns + QUIET_NS);
        self.bid(now_ns);
    }

    /// Lets happen what is due.
    pub fn handle_wake(&mut self, now_ns: u64) {
        if self.quiet_ns.is_some_and(|quiet_ns| quiet_ns <= now_ns) {
            self.quiet_ns = None;
            if let Some(item) = self.reader.quiet() {
                self.handle_item(now_ns, item);
            }
        }
        if self.deadline_ns.is_some_and(|deadline_ns| deadline_ns <= now_ns) {
            self.deadline_ns = None;
            self.time_out(now_ns);
        }
        self.bid(now_ns);
    }

    /// When [`Link::handle_wake`] has something to do.
    pub fn wake_at(&self) -> Option<u64> {
        self.deadline_ns.into_iter().chain(self.quiet_ns).min()
    }

    /// Next thing to do or to tell.
    pub fn poll_output(&mut self) -> Option<LinkOutput> {
        self.outputs.pop_front()
    }

    /// Whether nothing is under way and nothing waits.
    pub fn is_idle(&self) -> bool {
        matches!(self.state, State::Idle) && self.to_send.is_empty()
    }

    fn bid(&mut self, now_ns: u64) {
        if self.is_idle() || !matches!(self.state, State::Idle) {
            return;
        }
        self.state = State::Bidding { control_retry_count: 0 };
        self.put(&[ENQ]);
        self.deadline_ns = Some(now_ns + self.timing.timer_a_ns);
    }

    fn handle_item(&mut self, now_ns: u64, item: Item) {
        match &self.state {
            State::Idle => self.item_when_idle(now_ns, item),
            State::Bidding { .. } => self.item_when_bidding(now_ns, item),
            State::Sending { .. } => self.item_when_sending(now_ns, item),
            State::Receiving(_) => self.item_when_receiving(now_ns, item),
        }
    }

    fn item_when_idle(&mut self, now_ns: u64, item: Item) {
        match item {
            Item::Enq => self.begin_receiving(now_ns),
            Item::Eot => (),
            other => self.violation(&format!("{other} on an idle line")),
        }
    }

    fn item_when_bidding(&mut self, now_ns: u64, item: Item) {
        match (item, self.contention) {
            (Item::Ack(0), _) => self.send_block(now_ns, 0),
            (Item::Nak, _) => self.bid_again(now_ns),
            (Item::Enq, Contention::Yield) => self.begin_receiving(now_ns),
            (Item::Enq, Contention::Insist) => (),
            (other, _) => self.violation(&format!("{other} in answer to ENQ")),
        }
    }

    fn item_when_sending(&mut self, now_ns: u64, item: Item) {
        let State::Sending { index, .. } = self.state else {
            return;
        };
        match item {
            Item::Ack(turn) if turn == turn_after(index + 1) => {
                if index + 1 < self.to_send[0].blocks.len() {
                    return self.send_block(now_ns, index + 1);
                }
                self.put(&[EOT]);
                self.to_send.pop_front();
                self.rest();
                self.outputs.push_back(LinkOutput::Sent);
            }
            // The acknowledgement of the block before: this one has not come.
            Item::Ack(_) | Item::Nak => self.send_block_again(now_ns),
            Item::Eot => {
                self.violation("EOT in the middle of our message");
                self.give_up();
            }
            other => self.violation(&format!("{other} in answer to a block")),
        }
    }

    fn item_when_receiving(&mut self, now_ns: u64, item: Item) {
        let State::Receiving(receiving) = &mut self.state else {
            return;
        };
        match item {
            // Our last acknowledgement got lost.
            Item::Enq => {
                let turn = turn_after(receiving.blocks.len());
                self.acknowledge(now_ns, turn);
            }
            Item::Block(block) => self.take_block(now_ns, block),
            Item::Broken(why) => {
                self.violation(&format!("a block that {why}"));
                self.answer(now_ns, &[NAK]);
            }
            Item::Eot => {
                let is_complete = receiving.is_complete();
                let blocks = std::mem::take(&mut receiving.blocks);
                self.rest();
                if is_complete {
                    self.outputs.push_back(LinkOutput::Message(message(blocks)));
                } else if !blocks.is_empty() {
                    self.violation("EOT before the last block");
                }
            }
            other => self.violation(&format!("{other} where a block was to come")),
        }
    }

    fn take_block(&mut self, now_ns: u64, block: Block) {
        let State::Receiving(receiving) = &mut self.state else {
            return;
        };
        if receiving.is_repeated(now_ns, &block, &self.timing) {
            let turn = turn_after(receiving.blocks.len());
            return self.acknowledge(now_ns, turn);
        }
        let is_first = receiving.blocks.is_empty();
        if block.header.is_some() != is_first || receiving.is_complete() || receiving.blocks.len() >= BLOCK_COUNT_MAX {
            self.violation("a block out of its place");
            return self.answer(now_ns, &[NAK]);
        }
        let has_control = block.text.iter().any(|byte| is_control(*byte));
        receiving.blocks.push(block);
        let turn = turn_after(receiving.blocks.len());
        if has_control {
            self.violation("control characters of the link in a text");
        }
        self.acknowledge(now_ns, turn);
    }

    fn time_out(&mut self, now_ns: u64) {
        match &mut self.state {
            State::Idle => (),
            State::Bidding { .. } => self.bid_again(now_ns),
            // Asks for the acknowledgement that has not come; the sheet leaves open whether the block is sent again instead.
            State::Sending {
                control_retry_count, ..
            } => {
                *control_retry_count += 1;
                if *control_retry_count > self.timing.control_retry_max {
                    return self.abort();
                }
                self.put(&[ENQ]);
                self.deadline_ns = Some(now_ns + self.timing.timer_a_ns);
            }
            State::Receiving(_) => {
                self.rest();
                self.violation("a message that stops in the middle");
            }
        }
    }

    fn bid_again(&mut self, now_ns: u64) {
        let State::Bidding { control_retry_count } = &mut self.state else {
            return;
        };
        *control_retry_count += 1;
        if *control_retry_count > self.timing.control_retry_max {
            return self.abort();
        }
        self.put(&[ENQ]);
        self.deadline_ns = Some(now_ns + self.timing.timer_a_ns);
    }

    fn begin_receiving(&mut self, now_ns: u64) {
        self.state = State::Receiving(Receiving {
            blocks: Vec::new(),
            answered_ns: now_ns,
        });
        self.acknowledge(now_ns, 0);
    }

    fn acknowledge(&mut self, now_ns: u64, turn: u8) {
        self.answer(now_ns, &[DLE, b'0' + turn]);
    }

    /// Answers the other side's block, or its ENQ, and waits for what comes next.
    fn answer(&mut self, now_ns: u64, bytes: &[u8]) {
        if let State::Receiving(receiving) = &mut self.state {
            receiving.answered_ns = now_ns;
        }
        self.put(bytes);
        self.deadline_ns = Some(now_ns + self.timing.timer_b_ns);
    }

    fn send_block(&mut self, now_ns: u64, index: usize) {
        self.state = State::Sending {
            index,
            control_retry_count: 0,
            text_retry_count: 0,
        };
        let bytes = self.to_send[0].block_bytes(index);
        self.put(&bytes);
        self.deadline_ns = Some(now_ns + self.timing.timer_a_ns);
    }

    fn send_block_again(&mut self, now_ns: u64) {
        let State::Sending {
            index,
            text_retry_count,
            ..
        } = &mut self.state
        else {
            return;
        };
        *text_retry_count += 1;
        if *text_retry_count > self.timing.text_retry_max {
            return self.abort();
        }
        let bytes = self.to_send[0].block_bytes(*index);
        self.put(&bytes);
        self.deadline_ns = Some(now_ns + self.timing.timer_a_ns);
    }

    fn abort(&mut self) {
        self.put(&[EOT]);
        self.give_up();
    }

    fn give_up(&mut self) {
        self.rest();
        if let Some(message) = self.to_send.pop_front() {
            self.outputs.push_back(LinkOutput::Failed(message));
        }
    }

    fn rest(&mut self) {
        self.state = State::Idle;
        self.deadline_ns = None;
    }

    fn put(&mut self, bytes: &[u8]) {
        self.outputs.push_back(LinkOutput::Bytes(bytes.to_vec()));
    }

    fn violation(&mut self, what: &str) {
        self.outputs.push_back(LinkOutput::Violation(what.to_owned()));
    }
}

fn message(blocks: Vec<Block>) -> Message {
    Message {
        header: blocks
            .first()
            .and_then(|block| block.header.clone())
            .unwrap_or_default(),
        blocks: blocks.into_iter().map(|block| block.text).collect(),
    }
}

/// Digit of the acknowledgement after this many blocks.
fn turn_after(block_count: usize) -> u8 {
    (block_count % 2) as u8
}

fn is_control(byte: u8) -> bool {
    matches!(byte, SOH | STX | EOT | ENQ | DLE | NAK)
}

const SOH: u8 = 0x01;
const STX: u8 = 0x02;
const ETX: u8 = 0x03;
const EOT: u8 = 0x04;
const ENQ: u8 = 0x05;
const DLE: u8 = 0x10;
const NAK: u8 = 0x15;
const ETB: u8 = 0x17;
/// A line without a byte for this long is quiet: what stopped in the middle will not go on. Far below timer A, so that the
/// other side has its NAK before it gives up waiting. Our choice; the sheet states none.
const QUIET_NS: u64 = 200_000_000;
/// Of one message: 4 MiB of text.
const BLOCK_COUNT_MAX: usize = 16_384;

#[cfg(test)]
#[path = "bsc_tests.rs"]
mod tests;
