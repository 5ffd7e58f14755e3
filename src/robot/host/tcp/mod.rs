//! Host control over TCP, as a client (`docs/protocols/host_control.md`, sections 1 and 2).

mod lines;
#[cfg(test)]
mod tests;

use super::text::{self, Phrase};
use super::{HostLink, LinkEvent, Unsupported};
use crate::robot::command::{Command, Kind};
use crate::robot::output::RobotOutput;
use crate::robot::reply::{Refusal, Reply};
use crate::robot::variable::Form;
use crate::stamp::Stamp;
use lines::Lines;
use std::collections::VecDeque;

/// Times of the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TcpSettings {
    /// How long the opening of a connection may take, ms.
    pub connect_timeout_ms: u64,
    /// How long each line of the server may take, ms.
    pub answer_timeout_ms: u64,
    /// How long a command that was given up may still be answered before the connection is closed, ms.
    pub give_up_ms: u64,
}

/// The client. It opens a connection when there is something to say and keeps it as long as the server grants.
///
/// A transaction takes at most one opening and three lines (greeting, request, data). Whenever the two sides may disagree
/// about where they are (no answer in time, a line that makes no sense), the connection is closed.
#[derive(Debug)]
pub struct TcpLink {
    settings: TcpSettings,
    state: State,
    open: Option<Open>,
    lines: Lines,
    form: Option<Form>,
    outbox: VecDeque<RobotOutput>,
    events: VecDeque<LinkEvent>,
}

#[derive(Debug)]
enum State {
    Closed,
    Connecting {
        due: Stamp,
    },
    Greeting {
        due: Stamp,
    },
    Ready {
        greeting: String,
        /// How many commands the connection may still carry; `None` for any number.
        left: Option<u32>,
    },
}

#[derive(Debug)]
struct Open {
    command: Command,
    phrase: Phrase,
    step: Step,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// Nothing of it is sent.
    Waiting,
    /// Name and size are sent; the server is to agree.
    Requested { due: Stamp },
    /// Everything is sent; the answer is to come.
    Said { due: Stamp },
    /// As before, but nobody waits for it.
    GivenUp { due: Stamp },
}

impl TcpLink {
    /// A link without a connection.
    pub fn new(settings: TcpSettings) -> Self {
        Self {
            settings,
            state: State::Closed,
            open: None,
            lines: Lines::default(),
            form: None,
            outbox: VecDeque::new(),
            events: VecDeque::new(),
        }
    }
}

impl HostLink for TcpLink {
    fn is_idle(&self) -> bool {
        self.open.is_none()
    }

    fn say(&mut self, now: Stamp, command: &Command) -> Result<(), Unsupported> {
        debug_assert!(self.is_idle(), "one transaction at a time");
        self.open = Some(Open {
            command: command.clone(),
            phrase: text::phrase(command, self.form)?,
            step: Step::Waiting,
        });
        self.go_on(now);
        Ok(())
    }

    /// A command whose data have not been asked for yet is withheld by closing the connection. Of one that is wholly sent
    /// the answer is awaited for [`TcpSettings::give_up_ms`], because that is quicker than a new connection.
    fn give_up(&mut self, now: Stamp) {
        let Some(open) = &mut self.open else { return };
        match open.step {
            Step::Waiting => self.open = None,
            Step::Requested { .. } => {
                self.open = None;
                self.close();
            }
            Step::Said { due } => {
                let due = due.min(now.plus_ms(self.settings.give_up_ms));
                open.step = Step::GivenUp { due };
            }
            Step::GivenUp { .. } => {}
        }
    }

    /// No answer will come to what is given up. A request that left without its data ends with its connection.
    fn handle_withheld(&mut self, _now: Stamp) {
        let withheld = self.open.take_if(|open| matches!(open.step, Step::GivenUp { .. }));
        if withheld.is_some_and(|open| size(&open.phrase) > 0) {
            self.close();
        }
    }

    fn handle_connected(&mut self, now: Stamp) {
        if !matches!(self.state, State::Connecting { .. }) {
            return;
        }
        self.lines = Lines::default();
        self.state = State::Greeting {
            due: now.plus_ms(self.settings.answer_timeout_ms),
        };
        self.send(b"CONNECT Robot_access Keep-Alive:-1\r\n".to_vec(), Kind::Ask);
    }

    fn handle_closed(&mut self, _now: Stamp, reason: &str) {
        if !matches!(self.state, State::Closed) {
            self.state = State::Closed;
            self.lose(reason.to_owned());
        }
    }

    fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        for (at, &byte) in bytes.iter().enumerate() {
            if matches!(self.state, State::Closed | State::Connecting { .. }) {
                return self.drop_behind_the_end(&bytes[at..]);
            }
            match self.lines.push(byte) {
                Ok(None) => {}
                Ok(Some(line)) => self.handle_line(now, line),
                Err(lines::TooLong) => self.break_off("a line without an end".into()),
            }
        }
    }

    fn handle_wake(&mut self, now: Stamp) {
        if self.wake_at().is_none_or(|due| now < due) {
            return;
        }
        let given_up = matches!(
            self.open,
            Some(Open {
                step: Step::GivenUp { .. },
                ..
            })
        );
        match self.state {
            State::Connecting { .. } => {
                self.close();
                self.lose("no connection within the time".into());
            }
            State::Greeting { .. } => {
                self.close();
                self.lose("the server does not greet".into());
            }
            State::Closed | State::Ready { .. } => {
                self.close();
                self.open = None;
                if !given_up {
                    self.events.push_back(LinkEvent::Unanswered);
                }
            }
        }
    }

    fn wake_at(&self) -> Option<Stamp> {
        match (&self.state, self.open.as_ref().map(|open| open.step)) {
            (State::Connecting { due } | State::Greeting { due }, _) => Some(*due),
            (_, Some(Step::Requested { due } | Step::Said { due } | Step::GivenUp { due })) => Some(due),
            (_, Some(Step::Waiting) | None) => None,
        }
    }

    fn poll_output(&mut self) -> Option<RobotOutput> {
        self.outbox.pop_front()
    }

    fn poll_event(&mut self) -> Option<LinkEvent> {
        self.events.pop_front()
    }
}

impl TcpLink {
    /// Does what a waiting command needs next.
    fn go_on(&mut self, now: Stamp) {
        let Some(open) = &mut self.open else { return };
        if open.step != Step::Waiting {
            return;
        }
        match &self.state {
            State::Connecting { .. } | State::Greeting { .. } => {}
            State::Closed => {
                self.state = State::Connecting {
                    due: now.plus_ms(self.settings.connect_timeout_ms),
                };
                self.outbox.push_back(RobotOutput::Connect);
            }
            State::Ready { greeting, .. } if open.command == Command::SystemInformation => {
                let information = text::system_information(greeting);
                self.open = None;
                let reply = Reply::SystemInformation(information);
                self.events.push_back(LinkEvent::Answered(reply));
            }
            State::Ready { .. } => {
                let due = now.plus_ms(self.settings.answer_timeout_ms);
                let (name, kind) = (open.phrase.name, open.command.kind());
                open.step = match size(&open.phrase) {
                    0 => Step::Said { due },
                    _ => Step::Requested { due },
                };
                let request = format!("HOSTCTRL_REQUEST {name} {}\r\n", size(&open.phrase));
                self.send(request.into_bytes(), kind);
            }
        }
    }

    fn handle_line(&mut self, now: Stamp, line: String) {
        if matches!(self.state, State::Greeting { .. }) {
            return self.handle_greeting(now, line);
        }
        match self.open.as_ref().map(|open| open.step) {
            None | Some(Step::Waiting) => self.dropped(format!("the line {:?} fits nothing open", shown(&line)), false),
            Some(Step::Requested { .. }) => self.handle_agreement(now, &line),
            // The server agrees to a command without data in a line of its own, before the answer.
            Some(Step::Said { .. } | Step::GivenUp { .. }) if self.agrees(&line) => {}
            Some(Step::Said { .. } | Step::GivenUp { .. }) => self.handle_answer(&line),
        }
    }

    fn handle_greeting(&mut self, now: Stamp, line: String) {
        if !line.starts_with("OK:") {
            self.close();
            return self.lose(format!("the server refuses the connection: {:?}", shown(&line)));
        }
        let left = granted(&line);
        self.state = State::Ready { greeting: line, left };
        self.go_on(now);
    }

    /// The answer to name and size of a command with data.
    fn handle_agreement(&mut self, now: Stamp, line: &str) {
        if !self.agrees(line) {
            return self.handle_answer(line);
        }
        let due = now.plus_ms(self.settings.answer_timeout_ms);
        if let Some(open) = &mut self.open {
            open.step = Step::Said { due };
            let (data, kind) = (format!("{}\r", open.phrase.data), open.command.kind());
            self.send(data.into_bytes(), kind);
        }
    }

    /// Whether `line` is the server's agreement to the open command.
    fn agrees(&self, line: &str) -> bool {
        let name = line.strip_prefix("OK:").map(str::trim);
        self.open.as_ref().is_some_and(|open| name == Some(open.phrase.name))
    }

    fn handle_answer(&mut self, line: &str) {
        let Some(open) = &self.open else { return };
        if line.starts_with("NG:") {
            let reason = format!("{} is refused: {:?}", open.command.name(), shown(line));
            self.end(LinkEvent::Refused(refusal(0)));
            self.close();
            return self.lose(reason);
        }
        if line.starts_with("ERROR:") {
            return self.end(LinkEvent::Refused(refusal(text::refusal_code(line))));
        }
        if matches!(open.step, Step::Requested { .. }) || line.starts_with("OK:") {
            return self.break_off(format!("{:?} is no agreement to {}", shown(line), open.phrase.name));
        }
        match self.read(line) {
            Ok(event) => self.end(event),
            Err(reason) => self.break_off(reason),
        }
    }

    fn read(&mut self, line: &str) -> Result<LinkEvent, String> {
        let command = match &self.open {
            Some(open) => &open.command,
            None => return Err("nothing is open".into()),
        };
        if !text::expects_data(command) {
            return match text::result_code(line) {
                Some(0) => Ok(LinkEvent::Answered(Reply::Done)),
                Some(code) => Ok(LinkEvent::Refused(refusal(code))),
                None => Err(format!("answer to {}: {:?} is no result", command.name(), shown(line))),
            };
        }
        let reply = text::reply(command, line).map_err(|error| format!("answer to {}: {error}", command.name()))?;
        if *command == Command::Position {
            self.form = text::form(line).or(self.form);
        }
        Ok(LinkEvent::Answered(reply))
    }

    /// Ends the open transaction, and the connection if that was its last command.
    fn end(&mut self, event: LinkEvent) {
        match self.open.take() {
            Some(Open {
                command,
                step: Step::GivenUp { .. },
                ..
            }) => {
                self.dropped(
                    format!("the answer to {} came after it was given up", command.name()),
                    false,
                );
            }
            Some(_) => self.events.push_back(event),
            None => {}
        }
        if let State::Ready { left: Some(left), .. } = &mut self.state {
            *left = left.saturating_sub(1);
            if *left == 0 {
                self.close();
            }
        }
    }

    /// The two sides no longer agree on where they are.
    fn break_off(&mut self, reason: String) {
        self.close();
        self.dropped(reason, true);
        self.fail_open();
    }

    fn lose(&mut self, reason: String) {
        self.events.push_back(LinkEvent::Lost { reason });
        self.fail_open();
    }

    fn fail_open(&mut self) {
        if let Some(open) = self.open.take()
            && !matches!(open.step, Step::GivenUp { .. })
        {
            self.events.push_back(LinkEvent::Unanswered);
        }
    }

    fn close(&mut self) {
        if !matches!(self.state, State::Closed) {
            self.state = State::Closed;
            self.outbox.push_back(RobotOutput::Close);
        }
    }

    fn send(&mut self, bytes: Vec<u8>, kind: Kind) {
        self.outbox.push_back(RobotOutput::Bytes { bytes, kind });
    }

    /// The LF of the line that closed the connection is no event.
    fn drop_behind_the_end(&mut self, bytes: &[u8]) {
        if bytes != b"\n" {
            self.dropped(format!("{} bytes came without a connection", bytes.len()), false);
        }
    }

    fn dropped(&mut self, reason: String, malformed: bool) {
        self.events.push_back(LinkEvent::Dropped { reason, malformed });
    }
}

/// Bytes of the data with their closing CR; 0 when there are none.
fn size(phrase: &Phrase) -> usize {
    match phrase.data.len() {
        0 => 0,
        length => length + 1,
    }
}

/// How many commands the greeting grants; `None` for any number. Of a count of two or more, one is left unused, because
/// nothing says whether the server counts as we do.
fn granted(greeting: &str) -> Option<u32> {
    let Some((_, count)) = greeting.split_once("Keep-Alive:") else {
        return Some(1);
    };
    match count.trim().trim_end_matches('.').parse::<i64>() {
        Ok(-1) => None,
        Ok(count @ 2..=0x7FFF) => Some(count as u32 - 1),
        Ok(_) | Err(_) => Some(1),
    }
}

fn refusal(code: u16) -> Refusal {
    Refusal {
        status: 0x1F,
        added_status: code,
    }
}

/// The beginning of a line, for people.
fn shown(line: &str) -> String {
    line.chars().take(SHOWN_CHARS_MAX).collect()
}

const SHOWN_CHARS_MAX: usize = 80;
