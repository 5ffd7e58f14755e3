//! The line's two roles: sending blocks and receiving them (`docs/protocols/bsc_like.md`, section 3).

use super::SerialSettings;
use super::block::{Block, BlockReader, DLE, ENQ, EOT, Header, NAK, SOH, STX};
use crate::robot::command::Kind;
use crate::robot::file::FILE_BYTES_MAX;
use crate::stamp::{Stamp, earlier};
use std::collections::VecDeque;

/// What the line has to tell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum LineEvent {
    /// Every block is acknowledged, and the end is sent.
    Sent,
    /// The last block is sent, and nobody knows whether it was taken.
    Unsettled,
    /// The other side has not taken the whole transmission, so none of it counts.
    NotSent,
    /// This many text bytes of the transmission are acknowledged, by either side.
    Progress(usize),
    /// A whole transmission has come.
    Delivered(Transmission),
    /// Bytes that do nothing.
    Noise { reason: String, malformed: bool },
}

/// The text of all blocks of a transmission, joined.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Transmission {
    pub(super) header: Header,
    pub(super) text: Vec<u8>,
}

#[derive(Debug)]
pub(super) struct Line {
    settings: SerialSettings,
    state: State,
    outgoing: Option<Outgoing>,
    reader: BlockReader,
    last_byte: Stamp,
    after_dle: bool,
    /// What is being received is not wanted any more.
    unwanted: bool,
    pub(super) outbox: VecDeque<(Vec<u8>, Kind)>,
    pub(super) events: VecDeque<LineEvent>,
}

#[derive(Debug)]
struct Outgoing {
    blocks: Vec<Block>,
    kind: Kind,
    /// ENQ sent so far, over all attempts.
    asked_count: u32,
}

#[derive(Debug)]
enum State {
    Idle,
    /// ENQ is sent, ACK0 is to come.
    Asking {
        due: Stamp,
    },
    /// Block `index` is sent, its acknowledgement is to come.
    Sending {
        index: usize,
        nak_count: u32,
        silence_count: u32,
        due: Stamp,
    },
    Receiving(Receiving),
}

#[derive(Debug)]
struct Receiving {
    previous: Option<Block>,
    text: Vec<u8>,
    header: Option<Header>,
    block_count: usize,
    due: Stamp,
}

impl Receiving {
    fn is_complete(&self) -> bool {
        self.previous.as_ref().is_some_and(|block| block.last)
    }
}

enum Control {
    Enq,
    Eot,
    Nak,
    Ack(usize),
}

impl Line {
    pub(super) fn new(settings: SerialSettings) -> Self {
        Self {
            settings,
            state: State::Idle,
            outgoing: None,
            reader: BlockReader::default(),
            last_byte: Stamp::START,
            after_dle: false,
            unwanted: false,
            outbox: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    pub(super) fn is_idle(&self) -> bool {
        matches!(self.state, State::Idle)
    }

    /// Whether a block of the outgoing transmission has left.
    pub(super) fn is_sending(&self) -> bool {
        matches!(self.state, State::Sending { .. })
    }

    /// Sends a transmission, as soon as the line is free.
    pub(super) fn send(&mut self, now: Stamp, blocks: Vec<Block>, kind: Kind) {
        self.outgoing = Some(Outgoing {
            blocks,
            kind,
            asked_count: 0,
        });
        if self.is_idle() {
            self.ask(now);
        }
    }

    /// Ends what is being sent, and what is being received as soon as the line allows.
    pub(super) fn stop(&mut self, now: Stamp) {
        match &self.state {
            State::Idle => {}
            State::Asking { .. } | State::Sending { .. } => {
                self.transmit(vec![EOT]);
                self.state = State::Idle;
            }
            State::Receiving(receiving) if receiving.is_complete() => self.state = State::Idle,
            State::Receiving(_) => self.unwanted = true,
        }
        self.outgoing = None;
        self.settle(now);
    }

    pub(super) fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        if self.reader.is_inside() && now.ms_since(self.last_byte) >= self.settings.gap_ms {
            self.handle_gap();
        }
        let mut idle_count = 0usize;
        for &byte in bytes {
            self.last_byte = now;
            // Blocks that nobody announced are read as well, lest their bytes be taken for control characters.
            if self.reader.is_inside() || matches!(byte, SOH | STX) {
                self.after_dle = false;
                match self.reader.push(byte) {
                    None => {}
                    Some(Ok(block)) => self.handle_block(now, block),
                    Some(Err(error)) => self.refuse_block(error.to_string()),
                }
                continue;
            }
            let after_dle = std::mem::take(&mut self.after_dle);
            match byte {
                b'0' | b'1' if after_dle => self.handle_control(now, Control::Ack(usize::from(byte - b'0'))),
                ENQ => self.handle_control(now, Control::Enq),
                EOT => self.handle_control(now, Control::Eot),
                NAK => self.handle_control(now, Control::Nak),
                DLE => self.after_dle = true,
                _ => idle_count += 1,
            }
        }
        if idle_count > 0 {
            self.noise(format!("{idle_count} bytes stand outside of a block"), true);
        }
    }

    pub(super) fn handle_wake(&mut self, now: Stamp) {
        if self.gap_due().is_some_and(|due| due <= now) {
            self.handle_gap();
        }
        match &self.state {
            State::Asking { due } if *due <= now => self.ask(now),
            State::Sending { due, .. } if *due <= now => self.handle_silence(now),
            State::Receiving(receiving) if receiving.due <= now => self.end_receiving(now),
            _ => {}
        }
    }

    pub(super) fn wake_at(&self) -> Option<Stamp> {
        let due = match &self.state {
            State::Idle => None,
            State::Asking { due } | State::Sending { due, .. } => Some(*due),
            State::Receiving(receiving) => Some(receiving.due),
        };
        earlier(due, self.gap_due())
    }

    fn gap_due(&self) -> Option<Stamp> {
        let inside = self.reader.is_inside();
        inside.then(|| self.last_byte.plus_ms(self.settings.gap_ms))
    }

    /// Sends ENQ for what is to be sent, at most as often as the settings say.
    fn ask(&mut self, now: Stamp) {
        let Some(outgoing) = &mut self.outgoing else {
            self.state = State::Idle;
            return;
        };
        if outgoing.asked_count > self.settings.retry_1 {
            self.transmit(vec![EOT]);
            return self.end_sending(now, LineEvent::NotSent);
        }
        outgoing.asked_count += 1;
        self.transmit(vec![ENQ]);
        self.state = State::Asking {
            due: now.plus_ms(self.settings.timer_a_ms),
        };
    }

    fn handle_control(&mut self, now: Stamp, control: Control) {
        match (&mut self.state, control) {
            (State::Asking { .. }, Control::Ack(0)) => self.send_block(now, 0),
            (State::Asking { .. }, Control::Nak) => self.ask(now),
            // The other side wants to send as well: it goes first, and we ask again behind it.
            (State::Idle | State::Asking { .. }, Control::Enq) => self.start_receiving(now),
            (State::Sending { index, .. }, Control::Ack(number)) if number == (*index + 1) % 2 => {
                let index = *index;
                self.handle_acknowledged(now, index);
            }
            (State::Sending { .. }, Control::Nak) => self.handle_nak(now),
            (State::Sending { index, .. }, Control::Eot) => {
                let index = *index;
                let event = self.outcome_unknown(index);
                self.end_sending(now, event);
            }
            (State::Receiving(receiving), Control::Enq) => {
                // Our answer to its ENQ was lost, or its EOT.
                if receiving.block_count > 0 {
                    self.deliver();
                }
                self.start_receiving(now);
            }
            (State::Receiving(_), Control::Eot) => self.end_receiving(now),
            // It has yielded as we have, so the line is ours.
            (State::Receiving(receiving), Control::Ack(0)) if receiving.block_count == 0 && self.outgoing.is_some() => {
                self.send_block(now, 0);
            }
            (_, control) => self.noise(format!("{} fits nothing", control.name()), false),
        }
    }

    fn send_block(&mut self, now: Stamp, index: usize) {
        self.state = State::Sending {
            index,
            nak_count: 0,
            silence_count: 0,
            due: now.plus_ms(self.settings.timer_a_ms),
        };
        self.transmit_block(index);
    }

    fn transmit_block(&mut self, index: usize) {
        let bytes = self.outgoing.as_ref().map(|outgoing| outgoing.blocks[index].encode());
        let bytes = bytes.expect("a block is only sent while there is something to send");
        let kind = self.outgoing.as_ref().map_or(Kind::Ask, |outgoing| outgoing.kind);
        self.outbox.push_back((bytes, kind));
    }

    fn handle_acknowledged(&mut self, now: Stamp, index: usize) {
        let Some(outgoing) = &self.outgoing else { return };
        let done = outgoing.blocks[..=index].iter().map(|block| block.text.len()).sum();
        let more = index + 1 < outgoing.blocks.len();
        self.events.push_back(LineEvent::Progress(done));
        if more {
            self.send_block(now, index + 1);
        } else {
            self.transmit(vec![EOT]);
            self.end_sending(now, LineEvent::Sent);
        }
    }

    /// The block was not taken, so it may be sent again whatever it says.
    fn handle_nak(&mut self, now: Stamp) {
        let State::Sending {
            index, nak_count, due, ..
        } = &mut self.state
        else {
            return;
        };
        if *nak_count < self.settings.retry_2 {
            *nak_count += 1;
            *due = now.plus_ms(self.settings.timer_a_ms);
            let index = *index;
            self.transmit_block(index);
        } else {
            self.transmit(vec![EOT]);
            self.end_sending(now, LineEvent::NotSent);
        }
    }

    /// The block may have been taken: it is sent again only if its command bears that.
    fn handle_silence(&mut self, now: Stamp) {
        let State::Sending {
            index,
            silence_count,
            due,
            ..
        } = &mut self.state
        else {
            return;
        };
        let index = *index;
        let bears = self
            .outgoing
            .as_ref()
            .is_some_and(|outgoing| outgoing.kind.bears_repetition());
        if bears && *silence_count < self.settings.retry_2 {
            *silence_count += 1;
            *due = now.plus_ms(self.settings.timer_a_ms);
            self.transmit_block(index);
        } else {
            let event = self.outcome_unknown(index);
            self.transmit(vec![EOT]);
            self.end_sending(now, event);
        }
    }

    /// Without its last block a transmission counts for nothing.
    fn outcome_unknown(&self, index: usize) -> LineEvent {
        let count = self.outgoing.as_ref().map_or(0, |outgoing| outgoing.blocks.len());
        if index + 1 == count {
            LineEvent::Unsettled
        } else {
            LineEvent::NotSent
        }
    }

    fn end_sending(&mut self, now: Stamp, event: LineEvent) {
        self.outgoing = None;
        self.state = State::Idle;
        self.events.push_back(event);
        self.settle(now);
    }

    fn start_receiving(&mut self, now: Stamp) {
        self.reader.reset();
        self.unwanted = false;
        self.state = State::Receiving(Receiving {
            previous: None,
            text: Vec::new(),
            header: None,
            block_count: 0,
            due: now.plus_ms(self.settings.timer_b_ms),
        });
        self.acknowledge(0);
    }

    fn handle_block(&mut self, now: Stamp, block: Block) {
        let State::Receiving(receiving) = &mut self.state else {
            return self.noise("a block that nobody announced".into(), false);
        };
        if receiving.previous.as_ref() == Some(&block) {
            let number = receiving.block_count % 2;
            return self.acknowledge(number);
        }
        let first = receiving.block_count == 0;
        if receiving.is_complete() || block.header.is_some() != first {
            return self.refuse_block("a block where none of its kind belongs".into());
        }
        if self.unwanted && !block.last || receiving.text.len() + block.text.len() > TRANSMISSION_BYTES_MAX {
            receiving.previous = None;
            self.transmit(vec![EOT]);
            return self.end_receiving(now);
        }
        if let Some(header) = block.header {
            receiving.header = Some(header);
        }
        receiving.text.extend_from_slice(&block.text);
        receiving.block_count += 1;
        // Behind the last block only EOT is to come, which is a control character.
        receiving.due = now.plus_ms(match block.last {
            true => self.settings.timer_a_ms,
            false => self.settings.timer_b_ms,
        });
        let (number, done) = (receiving.block_count % 2, receiving.text.len());
        receiving.previous = Some(block);
        self.acknowledge(number);
        self.events.push_back(LineEvent::Progress(done));
    }

    fn refuse_block(&mut self, reason: String) {
        let receiving = matches!(self.state, State::Receiving(_));
        self.noise(reason, true);
        if receiving {
            self.transmit(vec![NAK]);
        }
    }

    /// A block has stopped in its middle.
    fn handle_gap(&mut self) {
        self.reader.reset();
        self.refuse_block("a block stops in its middle".into());
    }

    fn end_receiving(&mut self, now: Stamp) {
        self.deliver();
        self.settle(now);
    }

    /// Ends receiving and tells what has come, if it is whole.
    fn deliver(&mut self) {
        if let State::Receiving(receiving) = std::mem::replace(&mut self.state, State::Idle) {
            let complete = receiving.is_complete();
            match receiving.header {
                Some(header) if complete => self.events.push_back(LineEvent::Delivered(Transmission {
                    header,
                    text: receiving.text,
                })),
                _ => self.noise("a transmission ends before its last block".into(), false),
            }
        }
    }

    /// The line is free: asks for what waits.
    fn settle(&mut self, now: Stamp) {
        if self.is_idle() {
            self.reader.reset();
            if self.outgoing.is_some() {
                self.ask(now);
            }
        }
    }

    fn acknowledge(&mut self, number: usize) {
        self.outbox.push_back((vec![DLE, b'0' + number as u8], Kind::Ask));
    }

    /// A control character does nothing by itself: what acts is a block. None waits, least of all the end that makes room for
    /// a hold.
    fn transmit(&mut self, bytes: Vec<u8>) {
        self.outbox.push_back((bytes, Kind::Ask));
    }

    fn noise(&mut self, reason: String, malformed: bool) {
        self.events.push_back(LineEvent::Noise { reason, malformed });
    }
}

impl Control {
    fn name(&self) -> &'static str {
        match self {
            Self::Enq => "ENQ",
            Self::Eot => "EOT",
            Self::Nak => "NAK",
            Self::Ack(0) => "ACK0",
            Self::Ack(_) => "ACK1",
        }
    }
}

/// The most text bytes that a transmission may bring: a file and its name.
const TRANSMISSION_BYTES_MAX: usize = FILE_BYTES_MAX + 64;
