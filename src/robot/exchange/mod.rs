//! The conversation with the controller, as a value: bytes and time in, bytes and events out.
//!
//! One ask or act is open at a time; a set towards the safe side has a slot of its own and goes first. An ask is repeated on
//! time-out, a set until it is confirmed, an act is never repeated here: an unanswered act becomes
//! [`RobotEvent::Unanswered`] and the session asks what happened before it decides.
//!
//! HSES carries both slots at once. Host control carries one transaction at a time: there a set goes next, and
//! [`Exchange::forget_open`] cuts short what is open.

mod one_by_one;
mod wire;

use super::command::{Command, Kind};
use super::output::RobotOutput;
use super::reply::{Refusal, Reply};
use crate::stamp::{Stamp, earlier};
use std::collections::VecDeque;
use wire::{Heard, Outcome, Wire};

/// Times and bounds of the conversation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExchangeSettings {
    /// What is spoken.
    pub protocol: Protocol,
    /// How long one answer may take, ms.
    pub answer_timeout_ms: u64,
    /// How often an ask is sent before it counts as unanswered.
    pub ask_attempts: u32,
    /// How often a set is repeated, ms.
    pub set_repeat_ms: u64,
    /// After how long an unconfirmed set is given up, ms.
    pub set_timeout_ms: u64,
}

/// What is spoken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// High-Speed Ethernet Server: datagrams.
    Hses,
    /// Host control over a TCP connection.
    HostControl,
    /// Host control over a serial line.
    Serial,
}

/// What came of a command, or of bytes that fit none.
#[derive(Debug, Clone, PartialEq)]
pub enum RobotEvent {
    /// Carried out, or data read.
    Answered {
        /// What was said.
        command: Command,
        /// What was answered.
        reply: Reply,
    },
    /// The controller said no.
    Refused {
        /// What was said.
        command: Command,
        /// Why not.
        refusal: Refusal,
    },
    /// No answer within the bounds.
    Unanswered {
        /// What was said.
        command: Command,
    },
    /// What is spoken here has no words for it; nothing was sent.
    Unsayable {
        /// What was to be said.
        command: Command,
        /// Why not.
        reason: String,
    },
    /// Bytes that are no answer to anything open; they are dropped.
    Dropped {
        /// Why.
        reason: String,
        /// Whether its bytes make no sense (rather than being late or foreign).
        malformed: bool,
    },
    /// The connection could not be opened, or was closed by the other side. It is opened again for the next thing said.
    Lost {
        /// Why.
        reason: String,
    },
}

/// The conversation.
#[derive(Debug)]
pub struct Exchange {
    settings: ExchangeSettings,
    wire: Wire,
    open: Option<Said>,
    safe: Option<Said>,
    waiting: VecDeque<Command>,
    events: VecDeque<RobotEvent>,
}

/// One of the two things that can be open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Slot {
    Safe,
    Open,
}

#[derive(Debug)]
struct Said {
    command: Command,
    phase: Phase,
    sent_count: u32,
    first_said: Stamp,
}

#[derive(Debug, Clone, Copy)]
enum Phase {
    /// Goes out from this time on, as soon as the wire is free.
    Due(Stamp),
    /// On its way. HSES: with this id, and until then; host control keeps its own time.
    Sent { id: u8, until: Option<Stamp> },
}

impl Exchange {
    /// A conversation in which nothing has been said.
    pub fn new(settings: ExchangeSettings) -> Self {
        Self {
            wire: Wire::new(&settings),
            settings,
            open: None,
            safe: None,
            waiting: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// Says `command`. A set goes before everything else; an ask or act waits until the open one has ended.
    pub fn say(&mut self, now: Stamp, command: Command) {
        if command.kind() == Kind::Set {
            self.safe = Some(Said::new(now, command));
        } else if self.open.is_none() {
            self.open = Some(Said::new(now, command));
        } else {
            debug_assert!(self.waiting.len() < WAITING_MAX, "the session says one thing at a time");
            self.waiting.push_back(command);
        }
        self.go_on(now);
    }

    /// Forgets every ask and act that has not been sent, and stops waiting for the open one (a late answer is dropped).
    pub fn forget_open(&mut self, now: Stamp) {
        if self.open.take().is_some_and(|open| open.is_sent()) {
            self.wire.give_up(now);
        }
        self.waiting.clear();
    }

    /// Bytes of an act were not sent and never will be.
    pub fn handle_withheld(&mut self, now: Stamp) {
        self.wire.handle_withheld(now);
        self.hear(now);
    }

    /// The connection stands.
    pub fn handle_connected(&mut self, now: Stamp) {
        self.wire.handle_connected(now);
        self.hear(now);
    }

    /// The connection did not come about or has ended.
    pub fn handle_closed(&mut self, now: Stamp, reason: &str) {
        self.wire.handle_closed(now, reason);
        self.hear(now);
    }

    /// A datagram has come from the controller, or a piece of a stream.
    pub fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        let sent = [&self.safe, &self.open].map(|said| said.as_ref().and_then(Said::sent));
        self.wire.handle_bytes(now, bytes, sent);
        self.hear(now);
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        self.wire.handle_wake(now);
        self.hear(now);
        for slot in [Slot::Safe, Slot::Open] {
            if self.slot(slot).as_ref().is_some_and(|said| said.is_over_time(now)) {
                self.end(now, slot, Outcome::Silent);
            }
        }
        if let Some(safe) = &self.safe
            && self.is_given_up(now, safe)
        {
            if safe.is_sent() {
                self.wire.give_up(now);
            }
            self.end(now, Slot::Safe, Outcome::Silent);
        }
        self.go_on(now);
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        if !self.events.is_empty() {
            // Something said in answer to an event could not be said: nothing else would ever ask for that news.
            return Some(Stamp::START);
        }
        let wire_is_free = self.wire.is_free();
        let of = |said: &Option<Said>| match said.as_ref()?.phase {
            Phase::Due(at) => wire_is_free.then_some(at),
            Phase::Sent { until, .. } => until,
        };
        let given_up = self
            .safe
            .as_ref()
            .map(|safe| safe.first_said.plus_ms(self.settings.set_timeout_ms));
        [of(&self.safe), of(&self.open), given_up, self.wire.wake_at()]
            .into_iter()
            .fold(None, earlier)
    }

    /// The next thing to do with the wire.
    #[must_use]
    pub fn poll_output(&mut self) -> Option<RobotOutput> {
        self.wire.poll_output()
    }

    /// The next event.
    #[must_use]
    pub fn poll_event(&mut self) -> Option<RobotEvent> {
        self.events.pop_front()
    }

    /// Takes what the wire has heard, then sends what is due.
    fn hear(&mut self, now: Stamp) {
        while let Some(heard) = self.wire.poll_heard() {
            match heard {
                Heard::Of(slot, outcome) => self.end(now, slot, outcome),
                Heard::Dropped { reason, malformed } => {
                    self.events.push_back(RobotEvent::Dropped { reason, malformed });
                }
                Heard::Lost { reason } => self.events.push_back(RobotEvent::Lost { reason }),
            }
        }
        self.go_on(now);
    }

    /// What is open in `slot` has come to `outcome`: told, or said again.
    fn end(&mut self, now: Stamp, slot: Slot, outcome: Outcome) {
        let Some(said) = self.slot(slot).take() else { return };
        let command = said.command.clone();
        let event = match outcome {
            Outcome::Answered(reply) => RobotEvent::Answered { command, reply },
            Outcome::Refused(refusal) => RobotEvent::Refused { command, refusal },
            Outcome::Silent if self.is_said_again(now, &said) => {
                let phase = Phase::Due(now.plus_ms(self.wire.pause_ms()));
                *self.slot(slot) = Some(Said { phase, ..said });
                return;
            }
            Outcome::Silent => RobotEvent::Unanswered { command },
        };
        self.events.push_back(event);
    }

    fn is_said_again(&self, now: Stamp, said: &Said) -> bool {
        match said.command.kind() {
            Kind::Act => false,
            Kind::Ask | Kind::Order => said.sent_count < self.settings.ask_attempts,
            Kind::Set => !self.is_given_up(now, said),
        }
    }

    fn is_given_up(&self, now: Stamp, set: &Said) -> bool {
        now.ms_since(set.first_said) >= self.settings.set_timeout_ms
    }

    /// Sends what is due, the set first, and takes the next that waits when nothing is open.
    fn go_on(&mut self, now: Stamp) {
        self.send_due(now, Slot::Safe);
        loop {
            if self.open.is_none()
                && let Some(command) = self.waiting.pop_front()
            {
                self.open = Some(Said::new(now, command));
            }
            self.send_due(now, Slot::Open);
            // What could not be said makes room for the next.
            if self.open.is_some() || self.waiting.is_empty() {
                return;
            }
        }
    }

    fn send_due(&mut self, now: Stamp, slot: Slot) {
        if !self.wire.is_free() {
            return;
        }
        let Some(mut said) = self.slot(slot).take_if(|said| said.is_due(now)) else {
            return;
        };
        match self.wire.send(now, slot, &said.command) {
            Ok(id) => {
                said.sent_count += 1;
                let patience_ms = match said.command.kind() {
                    Kind::Set => self.settings.set_repeat_ms,
                    Kind::Ask | Kind::Order | Kind::Act => self.settings.answer_timeout_ms,
                };
                let until = self.wire.is_timed_here().then(|| now.plus_ms(patience_ms));
                said.phase = Phase::Sent { id, until };
                *self.slot(slot) = Some(said);
            }
            Err(reason) => self.events.push_back(RobotEvent::Unsayable {
                command: said.command,
                reason,
            }),
        }
    }

    fn slot(&mut self, slot: Slot) -> &mut Option<Said> {
        match slot {
            Slot::Safe => &mut self.safe,
            Slot::Open => &mut self.open,
        }
    }
}

impl Said {
    fn new(now: Stamp, command: Command) -> Self {
        Self {
            command,
            phase: Phase::Due(now),
            sent_count: 0,
            first_said: now,
        }
    }

    fn is_due(&self, now: Stamp) -> bool {
        matches!(self.phase, Phase::Due(at) if at <= now)
    }

    fn is_sent(&self) -> bool {
        matches!(self.phase, Phase::Sent { .. })
    }

    fn is_over_time(&self, now: Stamp) -> bool {
        matches!(self.phase, Phase::Sent { until: Some(until), .. } if until <= now)
    }

    /// What is on its way, and under which id.
    fn sent(&self) -> Option<(&Command, u8)> {
        match self.phase {
            Phase::Sent { id, .. } => Some((&self.command, id)),
            Phase::Due(_) => None,
        }
    }
}

/// More than this many unsent commands would be a bug of the session.
const WAITING_MAX: usize = 8;

#[cfg(test)]
mod tests;
