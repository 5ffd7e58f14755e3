//! The conversation with the controller, as a value: bytes and time in, bytes and events out.
//!
//! One ask or act is open at a time; a set towards the safe side has a slot of its own and waits for nothing. An ask is
//! repeated on time-out, a set until it is confirmed, an act is never repeated here: an unanswered act becomes
//! [`RobotEvent::Unanswered`] and the session asks what happened before it decides.

use super::command::{Command, Kind};
use super::hses::{self, Answer, Service};
use super::reply::{Refusal, Reply};
use crate::stamp::{Stamp, earlier};
use std::collections::VecDeque;

/// Times and bounds of the conversation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExchangeSettings {
    /// How long one answer may take, ms.
    pub answer_timeout_ms: u64,
    /// How often an ask is sent before it counts as unanswered.
    pub ask_attempts: u32,
    /// How often a set is repeated, ms.
    pub set_repeat_ms: u64,
    /// After how long an unconfirmed set is given up, ms.
    pub set_timeout_ms: u64,
}

/// A datagram to send, with what the shell must know about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagram {
    /// The bytes.
    pub bytes: Vec<u8>,
    /// An act leaves only when the record of what caused it is flushed.
    pub kind: Kind,
}

/// What came of a command, or of a datagram that fits none.
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
    /// The link has no way to say it; nothing was sent.
    Unsayable {
        /// What was to be said.
        command: Command,
        /// Why not.
        reason: String,
    },
    /// A datagram that is no answer to anything open; it is dropped.
    Dropped {
        /// Why.
        reason: String,
        /// Whether its bytes make no sense (rather than being late or foreign).
        malformed: bool,
    },
}

/// The conversation.
#[derive(Debug)]
pub struct Exchange {
    settings: ExchangeSettings,
    next_id: u8,
    open: Option<Open>,
    safe: Option<Open>,
    waiting: VecDeque<Command>,
    outbox: VecDeque<Datagram>,
    events: VecDeque<RobotEvent>,
}

#[derive(Debug)]
struct Open {
    command: Command,
    id: u8,
    service: Service,
    sent_count: u32,
    first_sent: Stamp,
    due: Stamp,
}

impl Exchange {
    /// A conversation in which nothing has been said.
    pub fn new(settings: ExchangeSettings) -> Self {
        Self {
            settings,
            next_id: 1,
            open: None,
            safe: None,
            waiting: VecDeque::new(),
            outbox: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// Says `command`. A set goes out at once; an ask or act waits until the open one has ended.
    pub fn say(&mut self, now: Stamp, command: Command) {
        if let Err(error) = hses::request(&command, 0) {
            let reason = error.to_string();
            return self.events.push_back(RobotEvent::Unsayable { command, reason });
        }
        match command.kind() {
            Kind::Set => {
                let open = self.send(now, command, None);
                self.safe = Some(open);
            }
            Kind::Ask | Kind::Order | Kind::Act if self.open.is_none() => {
                let open = self.send(now, command, None);
                self.open = Some(open);
            }
            Kind::Ask | Kind::Order | Kind::Act => {
                debug_assert!(self.waiting.len() < WAITING_MAX, "the session says one thing at a time");
                self.waiting.push_back(command);
            }
        }
    }

    /// Forgets every ask and act that has not been sent, and stops waiting for the open one (a late answer is dropped).
    pub fn forget_open(&mut self) {
        self.open = None;
        self.waiting.clear();
    }

    /// A datagram has come from the controller.
    pub fn handle_datagram(&mut self, now: Stamp, bytes: &[u8]) {
        let answer = match Answer::decode(bytes) {
            Ok(answer) => answer,
            Err(error) => return self.drop_datagram(error.to_string(), true),
        };
        let fits = |open: &Option<Open>| {
            open.as_ref()
                .is_some_and(|open| open.id == answer.id && open.service as u8 == answer.service)
        };
        let slot = if fits(&self.safe) {
            &mut self.safe
        } else if fits(&self.open) {
            &mut self.open
        } else {
            let (id, service) = (answer.id, answer.service);
            return self.drop_datagram(
                format!("answer {id} (service {service:#04x}) is late or foreign"),
                false,
            );
        };
        let open = slot.take().expect("the slot fitted, so it is taken");
        let command = open.command.clone();
        let event = if answer.status != 0 {
            RobotEvent::Refused {
                command,
                refusal: Refusal {
                    status: answer.status,
                    added_status: answer.added_status,
                },
            }
        } else {
            match hses::reply(&command, &answer) {
                Ok(reply) => RobotEvent::Answered { command, reply },
                Err(error) => {
                    // As good as no answer: ask again at the next wake, within the same bounds.
                    *slot = Some(Open { due: now, ..open });
                    return self.drop_datagram(format!("answer to {}: {error}", command.name()), true);
                }
            }
        };
        self.events.push_back(event);
        self.send_waiting(now);
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        if let Some(safe) = self.safe.take_if(|safe| safe.due <= now) {
            if now.ms_since(safe.first_sent) >= self.settings.set_timeout_ms {
                self.events.push_back(RobotEvent::Unanswered { command: safe.command });
            } else {
                let again = self.send(now, safe.command.clone(), Some(safe));
                self.safe = Some(again);
            }
        }
        if let Some(open) = self.open.take_if(|open| open.due <= now) {
            if open.command.kind().bears_repetition() && open.sent_count < self.settings.ask_attempts {
                let again = self.send(now, open.command.clone(), Some(open));
                self.open = Some(again);
            } else {
                self.events.push_back(RobotEvent::Unanswered { command: open.command });
                self.send_waiting(now);
            }
        }
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        earlier(
            self.open.as_ref().map(|open| open.due),
            self.safe.as_ref().map(|safe| safe.due),
        )
    }

    /// The next datagram to send.
    #[must_use]
    pub fn poll_transmit(&mut self) -> Option<Datagram> {
        self.outbox.pop_front()
    }

    /// The next event.
    #[must_use]
    pub fn poll_event(&mut self) -> Option<RobotEvent> {
        self.events.pop_front()
    }

    fn send_waiting(&mut self, now: Stamp) {
        if self.open.is_none()
            && let Some(command) = self.waiting.pop_front()
        {
            let open = self.send(now, command, None);
            self.open = Some(open);
        }
    }

    /// Queues one datagram; a repetition gets an id of its own, so that a late answer to the first is told apart.
    fn send(&mut self, now: Stamp, command: Command, before: Option<Open>) -> Open {
        let id = self.next_id;
        self.next_id = self.next_id.checked_add(1).unwrap_or(1);
        let kind = command.kind();
        let request = hses::request(&command, id).expect("say() lets only what can be said through");
        self.outbox.push_back(Datagram {
            bytes: request.encode(),
            kind,
        });
        let patience_ms = match kind {
            Kind::Set => self.settings.set_repeat_ms,
            Kind::Ask | Kind::Order | Kind::Act => self.settings.answer_timeout_ms,
        };
        Open {
            command,
            id,
            service: request.service,
            sent_count: before.as_ref().map_or(0, |before| before.sent_count) + 1,
            first_sent: before.map_or(now, |before| before.first_sent),
            due: now.plus_ms(patience_ms),
        }
    }

    fn drop_datagram(&mut self, reason: String, malformed: bool) {
        self.events.push_back(RobotEvent::Dropped { reason, malformed });
    }
}

/// More than this many unsent commands would be a bug of the session.
const WAITING_MAX: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::hses;

    const SETTINGS: ExchangeSettings = ExchangeSettings {
        answer_timeout_ms: 300,
        ask_attempts: 3,
        set_repeat_ms: 100,
        set_timeout_ms: 1000,
    };

    fn at(ms: u64) -> Stamp {
        Stamp::START.plus_ms(ms)
    }

    /// The page's answer `name`, given the id of the last request in `sent`.
    fn answer_to(sent: &Datagram, name: &str) -> Vec<u8> {
        let mut bytes = hses(name);
        bytes[11] = sent.bytes[11];
        bytes
    }

    fn drain(exchange: &mut Exchange) -> Vec<Datagram> {
        std::iter::from_fn(|| exchange.poll_transmit()).collect()
    }

    #[test]
    fn an_ask_is_repeated_and_then_counts_as_unanswered() {
        let mut exchange = Exchange::new(SETTINGS);
        exchange.say(at(0), Command::Status);
        assert_eq!(drain(&mut exchange).len(), 1);
        for ms in [300, 600] {
            assert_eq!(exchange.wake_at(), Some(at(ms)));
            exchange.handle_wake(at(ms));
            assert_eq!(drain(&mut exchange).len(), 1);
        }
        exchange.handle_wake(at(900));
        assert!(drain(&mut exchange).is_empty());
        assert_eq!(
            exchange.poll_event(),
            Some(RobotEvent::Unanswered {
                command: Command::Status
            })
        );
        assert_eq!(exchange.wake_at(), None);
    }

    #[test]
    fn an_unanswered_act_is_never_sent_twice() {
        let mut exchange = Exchange::new(SETTINGS);
        exchange.say(at(0), Command::ServoOn);
        assert_eq!(drain(&mut exchange).len(), 1);
        exchange.handle_wake(at(300));
        exchange.handle_wake(at(600));
        assert!(drain(&mut exchange).is_empty());
        assert_eq!(
            exchange.poll_event(),
            Some(RobotEvent::Unanswered {
                command: Command::ServoOn
            })
        );
    }

    #[test]
    fn what_no_frame_carries_is_never_sent_and_said_so() {
        let mut exchange = Exchange::new(SETTINGS);
        let all = Command::ReadSignals {
            first_group: 1,
            count: 500,
        };
        exchange.say(at(0), all.clone());
        assert!(drain(&mut exchange).is_empty());
        assert_eq!(exchange.wake_at(), None);
        assert!(matches!(exchange.poll_event(), Some(RobotEvent::Unsayable { command, .. }) if command == all));
        exchange.say(at(1), Command::Status);
        assert_eq!(drain(&mut exchange).len(), 1);
    }

    #[test]
    fn hold_waits_for_nothing_and_is_repeated_until_confirmed() {
        let mut exchange = Exchange::new(SETTINGS);
        exchange.say(at(0), Command::Status);
        exchange.say(at(1), Command::HoldOn);
        let sent = drain(&mut exchange);
        assert_eq!(sent.len(), 2);
        assert_eq!(sent[1].kind, Kind::Set);
        exchange.handle_wake(at(101));
        let again = drain(&mut exchange);
        assert_eq!(again.len(), 1);
        exchange.handle_datagram(at(110), &answer_to(&again[0], "ans_set_ok"));
        assert_eq!(
            exchange.poll_event(),
            Some(RobotEvent::Answered {
                command: Command::HoldOn,
                reply: Reply::Done
            })
        );
        exchange.handle_datagram(at(120), &answer_to(&sent[0], "ans_status_ready"));
        assert!(matches!(
            exchange.poll_event(),
            Some(RobotEvent::Answered {
                command: Command::Status,
                ..
            })
        ));
    }

    #[test]
    fn a_late_or_foreign_answer_is_dropped_with_an_event() {
        let mut exchange = Exchange::new(SETTINGS);
        exchange.say(at(0), Command::Status);
        let first = drain(&mut exchange);
        exchange.handle_wake(at(300));
        let second = drain(&mut exchange);
        exchange.handle_datagram(at(310), &answer_to(&first[0], "ans_status_ready"));
        assert!(matches!(
            exchange.poll_event(),
            Some(RobotEvent::Dropped { malformed: false, .. })
        ));
        exchange.handle_datagram(at(320), &answer_to(&second[0], "ans_status_ready"));
        assert!(matches!(exchange.poll_event(), Some(RobotEvent::Answered { .. })));
        exchange.handle_datagram(at(330), b"noise");
        assert!(matches!(
            exchange.poll_event(),
            Some(RobotEvent::Dropped { malformed: true, .. })
        ));
    }
}
