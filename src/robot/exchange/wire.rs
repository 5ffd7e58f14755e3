//! What carries the conversation: datagrams of HSES, or a link of host control.

use super::one_by_one::OneByOne;
use super::{ExchangeSettings, Protocol, RobotOutput, Slot};
use crate::robot::command::Command;
use crate::robot::host::{HostLink, LinkEvent, SerialLink, SerialSettings, TcpLink, TcpSettings};
use crate::robot::hses::{self, Answer};
use crate::robot::reply::{Refusal, Reply};
use crate::stamp::Stamp;
use std::collections::VecDeque;

/// What carries the conversation.
#[derive(Debug)]
pub(super) struct Wire {
    carrier: Carrier,
    outbox: VecDeque<RobotOutput>,
    heard: VecDeque<Heard>,
}

#[derive(Debug)]
enum Carrier {
    /// Any number of requests at once, told apart by their ids.
    Hses { next_id: u8 },
    /// One transaction at a time: that of the slot being served.
    Host {
        link: Box<dyn HostLink>,
        serving: Option<Serving>,
    },
}

/// The slot whose command is on its way.
#[derive(Debug)]
struct Serving {
    slot: Slot,
    parts: OneByOne,
}

/// What has come over the wire.
#[derive(Debug)]
pub(super) enum Heard {
    Of(Slot, Outcome),
    Dropped { reason: String, malformed: bool },
    Lost { reason: String },
}

/// How something said has ended.
#[derive(Debug)]
pub(super) enum Outcome {
    Answered(Reply),
    Refused(Refusal),
    Silent,
}

impl Wire {
    pub(super) fn new(settings: &ExchangeSettings) -> Self {
        let host = |link| Carrier::Host { link, serving: None };
        let carrier = match settings.protocol {
            Protocol::Hses => Carrier::Hses { next_id: 1 },
            Protocol::HostControl => host(Box::new(TcpLink::new(TcpSettings {
                connect_timeout_ms: settings.answer_timeout_ms.max(CONNECT_MS_MIN),
                answer_timeout_ms: settings.answer_timeout_ms.max(LINE_MS_MIN),
                give_up_ms: settings.answer_timeout_ms,
            }))),
            Protocol::Serial => host(Box::new(SerialLink::new(SerialSettings {
                timer_a_ms: settings.answer_timeout_ms.max(LINE_MS_MIN),
                retry_1: SERIAL_RETRIES,
                answer_timeout_ms: settings.answer_timeout_ms.max(SERIAL_ANSWER_MS_MIN),
                ..SerialSettings::default()
            }))),
        };
        Self {
            carrier,
            outbox: VecDeque::new(),
            heard: VecDeque::new(),
        }
    }

    /// Whether something can be sent now.
    pub(super) fn is_free(&self) -> bool {
        match &self.carrier {
            Carrier::Hses { .. } => true,
            Carrier::Host { link, serving } => serving.is_none() && link.is_idle(),
        }
    }

    /// Whether the conversation, not the wire, sees to it that an answer comes in time.
    pub(super) fn is_timed_here(&self) -> bool {
        matches!(self.carrier, Carrier::Hses { .. })
    }

    /// Rest before something is said again. A connection that is refused at once must not be asked for again at once.
    pub(super) fn pause_ms(&self) -> u64 {
        match &self.carrier {
            Carrier::Hses { .. } => 0,
            Carrier::Host { .. } => HOST_PAUSE_MS,
        }
    }

    /// Sends `command` for `slot`; the id under which HSES answers. A repetition gets an id of its own, so that a late
    /// answer to the first is told apart.
    pub(super) fn send(&mut self, now: Stamp, slot: Slot, command: &Command) -> Result<u8, String> {
        match &mut self.carrier {
            Carrier::Hses { next_id } => {
                let id = *next_id;
                let request = hses::request(command, id).map_err(|error| error.to_string())?;
                *next_id = id.checked_add(1).unwrap_or(1);
                self.outbox.push_back(RobotOutput::Bytes {
                    bytes: request.encode(),
                    kind: command.kind(),
                });
                Ok(id)
            }
            Carrier::Host { link, serving } => {
                let mut parts = OneByOne::new(command);
                let part = parts.next().ok_or("nothing to read or write")?;
                link.say(now, &part).map_err(|error| error.to_string())?;
                *serving = Some(Serving { slot, parts });
                Ok(0)
            }
        }
    }

    /// Stops waiting for what is open.
    pub(super) fn give_up(&mut self, now: Stamp) {
        if let Carrier::Host { link, serving } = &mut self.carrier {
            link.give_up(now);
            *serving = None;
        }
    }

    pub(super) fn handle_withheld(&mut self, now: Stamp) {
        self.host(now, |link| link.handle_withheld(now));
    }

    pub(super) fn handle_connected(&mut self, now: Stamp) {
        self.host(now, |link| link.handle_connected(now));
    }

    pub(super) fn handle_closed(&mut self, now: Stamp, reason: &str) {
        self.host(now, |link| link.handle_closed(now, reason));
    }

    /// `sent` is what is on its way in the two slots, the safe one first, with its ids.
    pub(super) fn handle_bytes(&mut self, now: Stamp, bytes: &[u8], sent: [Option<(&Command, u8)>; 2]) {
        if self.is_timed_here() {
            self.handle_datagram(bytes, sent);
        } else {
            self.host(now, |link| link.handle_bytes(now, bytes));
        }
    }

    pub(super) fn handle_wake(&mut self, now: Stamp) {
        self.host(now, |link| link.handle_wake(now));
    }

    pub(super) fn wake_at(&self) -> Option<Stamp> {
        match &self.carrier {
            Carrier::Hses { .. } => None,
            Carrier::Host { link, .. } => link.wake_at(),
        }
    }

    pub(super) fn poll_output(&mut self) -> Option<RobotOutput> {
        if let Carrier::Host { link, .. } = &mut self.carrier {
            return link.poll_output();
        }
        self.outbox.pop_front()
    }

    pub(super) fn poll_heard(&mut self) -> Option<Heard> {
        self.heard.pop_front()
    }

    fn handle_datagram(&mut self, bytes: &[u8], sent: [Option<(&Command, u8)>; 2]) {
        let answer = match Answer::decode(bytes) {
            Ok(answer) => answer,
            Err(error) => return self.drop_bytes(error.to_string(), true),
        };
        let fits = |(command, id): &(&Command, u8)| {
            *id == answer.id && hses::request(command, *id).is_ok_and(|request| request.service as u8 == answer.service)
        };
        let fitting = [Slot::Safe, Slot::Open]
            .into_iter()
            .zip(sent)
            .find_map(|(slot, sent)| sent.filter(fits).map(|(command, _)| (slot, command)));
        let Some((slot, command)) = fitting else {
            let (id, service) = (answer.id, answer.service);
            return self.drop_bytes(
                format!("answer {id} (service {service:#04x}) is late or foreign"),
                false,
            );
        };
        let outcome = if answer.status != 0 {
            Outcome::Refused(Refusal {
                status: answer.status,
                added_status: answer.added_status,
            })
        } else {
            match hses::reply(command, &answer) {
                Ok(reply) => Outcome::Answered(reply),
                Err(error) => {
                    // As good as no answer: said again, within the same bounds.
                    self.drop_bytes(format!("answer to {}: {error}", command.name()), true);
                    Outcome::Silent
                }
            }
        };
        self.heard.push_back(Heard::Of(slot, outcome));
    }

    /// Lets the link of host control do something, and takes what it has heard.
    fn host(&mut self, now: Stamp, act: impl FnOnce(&mut dyn HostLink)) {
        let Carrier::Host { link, serving } = &mut self.carrier else {
            return;
        };
        act(link.as_mut());
        while let Some(event) = link.poll_event() {
            let outcome = match event {
                LinkEvent::Answered(reply) => {
                    let Some(Serving { parts, .. }) = serving else { continue };
                    match (parts.take(reply), parts.next()) {
                        (Some(whole), _) => Outcome::Answered(whole),
                        // What was said of the first part can be said of the others.
                        (None, Some(part)) if link.say(now, &part).is_ok() => continue,
                        (None, _) => Outcome::Silent,
                    }
                }
                LinkEvent::Refused(refusal) => Outcome::Refused(refusal),
                LinkEvent::Unanswered => Outcome::Silent,
                LinkEvent::Dropped { reason, malformed } => {
                    self.heard.push_back(Heard::Dropped { reason, malformed });
                    continue;
                }
                LinkEvent::Lost { reason } => {
                    self.heard.push_back(Heard::Lost { reason });
                    continue;
                }
                // Files are not part of this conversation.
                LinkEvent::Saved { .. } | LinkEvent::Listed { .. } | LinkEvent::Progress { .. } => continue,
            };
            if let Some(Serving { slot, .. }) = serving.take() {
                self.heard.push_back(Heard::Of(slot, outcome));
            }
        }
    }

    fn drop_bytes(&mut self, reason: String, malformed: bool) {
        self.heard.push_back(Heard::Dropped { reason, malformed });
    }
}

const HOST_PAUSE_MS: u64 = 100;
const CONNECT_MS_MIN: u64 = 1000;
const LINE_MS_MIN: u64 = 1000;
/// The exchange asks again as well.
const SERIAL_RETRIES: u32 = 2;
const SERIAL_ANSWER_MS_MIN: u64 = 3000;
